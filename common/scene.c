#include "common/scene.h"

#include "common/arena.h"
#include "common/effects.h"
#include "common/err.h"
#include "common/finite.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define RESOLUTION_MAX  65536
#define PICTURE_MAX     (1 << 20) /* texels of a side */
#define ENVIRONMENT_MAX (1 << 28) /* texels of an environment */
#define INSTANCE_MAX    (1 << 26) /* an offset into the array fits 32 bits */

struct scene *scene_new(void)
{
    struct scene *scene = calloc(1, sizeof(*scene));
    if (scene == NULL)
        return NULL;
    scene->arena = arena_new();
    if (scene->arena == NULL) {
        free(scene);
        return NULL;
    }
    struct scene_settings *settings = &scene->settings;
    settings->camera = (struct camera){ .kind = CAMERA_PERSPECTIVE,
                                        .right = { 1, 0, 0 },
                                        .up = { 0, 1, 0 },
                                        .forward = { 0, 0, 1 },
                                        .screen = { -1, 1, -1, 1 },
                                        .focal_distance = INFINITY };
    settings->width = settings->height = 1;
    settings->crop[1] = settings->crop[3] = 1;
    settings->filter = (struct filter_spec){ .kind = FILTER_BOX, .radius = { 0.5f, 0.5f } };
    settings->sampler = SAMPLER_SOBOL;
    settings->max_depth = SCENE_NONE;
    settings->shutter[1] = 1;
    settings->sky_light = SCENE_NONE;
    return scene;
}

void scene_free(struct scene *scene)
{
    if (scene == NULL)
        return;
    arena_free(scene->arena);
    free(scene);
}

static bool check_camera(const struct camera *camera, struct err *err)
{
    if (camera->kind > CAMERA_ORTHOGRAPHIC)
        return err_set(err, ERR_SCENE, "unknown camera kind %u", camera->kind);
    if (!finite_all(camera->position, 3) || !finite_all(camera->right, 3) ||
        !finite_all(camera->up, 3) || !finite_all(camera->forward, 3) ||
        !finite_all(camera->screen, 4))
        return err_set(err, ERR_SCENE, "the camera has a number that is not finite");
    if (!(camera->lens_radius >= 0) || !isfinite(camera->lens_radius))
        return err_set(err, ERR_SCENE, "the lens radius is %g", camera->lens_radius);
    if (camera->lens_radius > 0 && !(camera->focal_distance > 0))
        return err_set(err, ERR_SCENE, "the focal distance is %g", camera->focal_distance);
    return true;
}

static bool check_settings(const struct scene *scene, struct err *err)
{
    const struct scene_settings *settings = &scene->settings;
    const uint32_t *crop = settings->crop;

    if (settings->width < 1 || settings->width > RESOLUTION_MAX || settings->height < 1 ||
        settings->height > RESOLUTION_MAX)
        return err_set(err, ERR_SCENE, "a resolution of %ux%u is outside 1..%d", settings->width,
                       settings->height, RESOLUTION_MAX);
    if (crop[0] >= crop[1] || crop[1] > settings->width || crop[2] >= crop[3] ||
        crop[3] > settings->height)
        return err_set(err, ERR_SCENE, "the crop window [%u, %u) x [%u, %u) is not inside %ux%u",
                       crop[0], crop[1], crop[2], crop[3], settings->width, settings->height);
    if (!check_camera(&settings->camera, err))
        return false;

    const struct filter_spec *filter = &settings->filter;
    const float numbers[] = { filter->radius[0], filter->radius[1], filter->sigma,
                              filter->b,         filter->c,         filter->tau };
    if (filter->kind > FILTER_SINC || !finite_all(numbers, 6) || !(filter->radius[0] > 0) ||
        !(filter->radius[1] > 0))
        return err_set(err, ERR_SCENE, "the reconstruction filter is not valid");
    if (filter->kind == FILTER_GAUSSIAN && !(filter->sigma > 0))
        return err_set(err, ERR_SCENE, "the gaussian filter's sigma is %g", filter->sigma);
    if (filter->kind == FILTER_SINC &&
        !(filter->tau >= 1 && filter->radius[0] <= FILTER_SINC_RADIUS &&
          filter->radius[1] <= FILTER_SINC_RADIUS))
        return err_set(err, ERR_SCENE, "the sinc filter's tau is %g, its radius %g x %g",
                       filter->tau, filter->radius[0], filter->radius[1]);

    if (!finite_all(settings->shutter, 2) || !(settings->shutter[0] <= settings->shutter[1]))
        return err_set(err, ERR_SCENE, "the shutter is open from %g to %g", settings->shutter[0],
                       settings->shutter[1]);
    if (settings->camera_motion > scene->motion_count)
        return err_set(err, ERR_SCENE, "the camera: no motion %u", settings->camera_motion);
    if (settings->camera_medium > scene->medium_count)
        return err_set(err, ERR_SCENE, "the camera: no medium %u", settings->camera_medium);
    if (settings->sampler >= SAMPLER_COUNT)
        return err_set(err, ERR_SCENE, "unknown sampler kind %u", settings->sampler);
    if (!finite_all(settings->sky, 3))
        return err_set(err, ERR_SCENE, "the sky's radiance is not finite");
    for (int axis = 0; axis < 3; axis++)
        if (!isfinite(settings->center[axis]))
            return err_set(err, ERR_SCENE, "the centre of the scene is not finite");
    if (!finite_all(settings->bounds_min, 3) || !finite_all(settings->bounds_max, 3))
        return err_set(err, ERR_SCENE, "the bounds of the scene are not finite");
    if (settings->sky_light != SCENE_NONE &&
        (settings->sky_light >= scene->light_count ||
         scene->lights[settings->sky_light].kind != LIGHT_SKY ||
         scene->lights[settings->sky_light].environment != 0))
        return err_set(err, ERR_SCENE, "the sky's light is not a light of the sky");
    return true;
}

static bool check_mesh(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct mesh *mesh = &scene->meshes[index];
    uint64_t triangles_end = (uint64_t)mesh->first_triangle + mesh->triangle_count;
    uint64_t vertices_end = (uint64_t)mesh->first_vertex + mesh->vertex_count;

    if (triangles_end > scene->triangle_count || vertices_end > scene->vertex_count)
        return err_set(err, ERR_SCENE, "mesh %u reaches beyond the arrays", index);
    if (mesh->material != SCENE_NONE && mesh->material >= scene->material_count)
        return err_set(err, ERR_SCENE, "mesh %u: no material %u", index, mesh->material);

    const uint32_t *corner = scene->triangles + 3 * (size_t)mesh->first_triangle;
    uint32_t outside = 0; /* no branch: of a large mesh there are millions */
    for (size_t i = 0; i < 3 * (size_t)mesh->triangle_count; i++)
        outside |= corner[i] - mesh->first_vertex >= mesh->vertex_count;
    if (outside != 0)
        return err_set(err, ERR_SCENE, "mesh %u: a vertex index is out of range", index);

    uint32_t first_normal = mesh->first_vertex + mesh->normal_shift;
    if ((mesh->flags & MESH_NORMALS) &&
        (uint64_t)first_normal + mesh->vertex_count > scene->normal_count)
        return err_set(err, ERR_SCENE, "mesh %u: normals are missing", index);
    uint32_t first_uv = mesh->first_vertex + mesh->uv_shift;
    if ((mesh->flags & MESH_UVS) && (uint64_t)first_uv + mesh->vertex_count > scene->uv_count)
        return err_set(err, ERR_SCENE, "mesh %u: texture coordinates are missing", index);
    if ((mesh->flags & MESH_NORMALS) && !scene->settings.has_normals)
        return err_set(err, ERR_SCENE, "mesh %u has normals and the scene says none has", index);
    uint32_t first_color = mesh->first_vertex + mesh->color_shift;
    if ((mesh->flags & MESH_COLORS) &&
        (uint64_t)first_color + mesh->vertex_count > scene->color_count)
        return err_set(err, ERR_SCENE, "mesh %u: vertex colours are missing", index);
    if (mesh->alpha > scene->texture_count)
        return err_set(err, ERR_SCENE, "mesh %u: no texture %u", index, mesh->alpha);
    if (mesh->inside > scene->medium_count || mesh->outside > scene->medium_count)
        return err_set(err, ERR_SCENE, "mesh %u: no media %u and %u", index, mesh->inside,
                       mesh->outside);
    if (mesh->first_emissive != SCENE_NONE &&
        (uint64_t)mesh->first_emissive + mesh->triangle_count > scene->triangle_light_count)
        return err_set(err, ERR_SCENE, "mesh %u: its triangles' lights are missing", index);
    return true;
}

static bool check_quadric(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct quadric *quadric = &scene->quadrics[index];
    const float sizes[] = { quadric->radius, quadric->inner_radius, quadric->z_min,
                            quadric->z_max,  quadric->phi_max,      quadric->world_radius };

    if (quadric->kind > QUADRIC_DISK)
        return err_set(err, ERR_SCENE, "quadric %u: unknown kind %u", index, quadric->kind);
    if (!finite_all(quadric->center, 3) || !finite_all(quadric->to_world, 9) ||
        !finite_all(quadric->to_object, 9) || !finite_all(sizes, 6) || !(quadric->radius > 0))
        return err_set(err, ERR_SCENE, "quadric %u has a number that is not valid", index);
    if (quadric->material != SCENE_NONE && quadric->material >= scene->material_count)
        return err_set(err, ERR_SCENE, "quadric %u: no material %u", index, quadric->material);
    if (quadric->light != SCENE_NONE && quadric->light >= scene->light_count)
        return err_set(err, ERR_SCENE, "quadric %u: no light %u", index, quadric->light);
    if (quadric->alpha > scene->texture_count)
        return err_set(err, ERR_SCENE, "quadric %u: no texture %u", index, quadric->alpha);
    if (quadric->inside > scene->medium_count || quadric->outside > scene->medium_count)
        return err_set(err, ERR_SCENE, "quadric %u: no media %u and %u", index, quadric->inside,
                       quadric->outside);
    return true;
}

/* Is b the inverse of a? As far as the rounding of both lets one see. */
static bool are_inverse(const float a[12], const float b[12])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 4; j++) {
            double sum = j == 3 ? b[4 * i + 3] : 0, size = fabs(sum) + (i == j);
            for (int k = 0; k < 3; k++) {
                sum += (double)b[4 * i + k] * a[4 * k + j];
                size += fabs((double)b[4 * i + k] * a[4 * k + j]);
            }
            if (!(fabs(sum - (i == j)) <= 1e-5 * size))
                return false;
        }
    return true;
}

static bool check_instance(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct instance *instance = &scene->instances[index];
    if (instance->group >= scene->group_count)
        return err_set(err, ERR_SCENE, "instance %u: no group %u", index, instance->group);
    if (instance->motion > scene->motion_count)
        return err_set(err, ERR_SCENE, "instance %u: no motion %u", index, instance->motion);
    if (instance->motion != 0)
        return true;
    if (!finite_all(instance->to_world, 12) || !finite_all(instance->to_object, 12))
        return err_set(err, ERR_SCENE, "instance %u has a number that is not finite", index);
    if (!are_inverse(instance->to_world, instance->to_object))
        return err_set(err, ERR_SCENE, "instance %u: its two transforms are not inverse", index);
    return true;
}

static bool check_motion(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct motion *motion = &scene->motions[index];
    if (!finite_all(&motion->translation[0][0], 6) || !finite_all(&motion->rotation[0][0], 8) ||
        !finite_all(&motion->stretch[0][0], 18) || !(motion->angle >= 0 && motion->angle < 1.6f))
        return err_set(err, ERR_SCENE, "motion %u has a number that is not valid", index);
    return true;
}

static bool check_medium(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct medium *medium = &scene->media[index];
    bool good = fabsf(medium->g) <= 1;
    for (int c = 0; c < 3; c++)
        good = good && medium->sigma_a[c] >= 0 && medium->sigma_s[c] >= 0 && medium->Le[c] >= 0 &&
               isfinite(medium->sigma_a[c] + medium->sigma_s[c]) && isfinite(medium->Le[c]);
    return good || err_set(err, ERR_SCENE, "medium %u has a number that is not valid", index);
}

/* Behind the shapes of no group come those of the groups, in order and without gaps */
static bool check_groups(const struct scene *scene, struct err *err)
{
    if (scene->instance_count > INSTANCE_MAX)
        return err_set(err, ERR_SCENE, "%u instances; %d are possible", scene->instance_count,
                       INSTANCE_MAX);
    uint64_t mesh = 0, quadric = 0;
    for (uint32_t i = 0; i < scene->group_count; i++) {
        const struct group *group = &scene->groups[i];
        if (i > 0 && (group->first_mesh != mesh || group->first_quadric != quadric))
            return err_set(err, ERR_SCENE, "group %u does not follow the one before", i);
        mesh = (uint64_t)group->first_mesh + group->mesh_count;
        quadric = (uint64_t)group->first_quadric + group->quadric_count;
        if (mesh > scene->mesh_count || quadric > scene->quadric_count)
            return err_set(err, ERR_SCENE, "group %u reaches beyond the arrays", i);
        for (uint64_t k = group->first_mesh; k < mesh; k++)
            if (scene->meshes[k].first_emissive != SCENE_NONE)
                return err_set(err, ERR_SCENE, "a mesh of group %u emits", i);
        for (uint64_t k = group->first_quadric; k < quadric; k++)
            if (scene->quadrics[k].light != SCENE_NONE)
                return err_set(err, ERR_SCENE, "a quadric of group %u emits", i);
    }
    if (scene->group_count > 0 && (mesh != scene->mesh_count || quadric != scene->quadric_count))
        return err_set(err, ERR_SCENE, "shapes follow behind the last group");
    return true;
}

static bool check_picture(const struct scene *scene, uint32_t index, struct err *err)
{
    static const unsigned texel_size[] = { 1, 1, 2, 4 };
    const struct scene_picture *picture = &scene->pictures[index];

    if (picture->texel > TEXEL_FLOAT || picture->channels < 1 || picture->channels > 4 ||
        picture->width < 1 || picture->width > PICTURE_MAX || picture->height < 1 ||
        picture->height > PICTURE_MAX || picture->levels < 1 || picture->levels > 32)
        return err_set(err, ERR_SCENE, "picture %u: its shape is not valid", index);
    uint64_t bytes = 0;
    for (uint32_t level = 0; level < picture->levels; level++) {
        uint64_t width = picture->width >> level, height = picture->height >> level;
        bytes += (width > 0 ? width : 1) * (height > 0 ? height : 1);
    }
    bytes *= picture->channels * texel_size[picture->texel];
    if (bytes > ((uint64_t)scene->texel_block_count - picture->first_block) * TEXEL_BLOCK ||
        picture->first_block > scene->texel_block_count)
        return err_set(err, ERR_SCENE, "picture %u reaches beyond the texels", index);
    return true;
}

/* Rows at right angles and of unit length */
static bool is_rotation(const float m[9])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j <= i; j++) {
            float dot = m[3 * i] * m[3 * j] + m[3 * i + 1] * m[3 * j + 1] +
                        m[3 * i + 2] * m[3 * j + 2];
            if (!(fabsf(dot - (i == j)) < 1e-5f))
                return false;
        }
    return true;
}

static bool check_environment(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct environment *environment = &scene->environments[index];
    if (environment->picture >= scene->picture_count)
        return err_set(err, ERR_SCENE, "environment %u: no picture %u", index,
                       environment->picture);
    const struct scene_picture *picture = &scene->pictures[environment->picture];
    if (environment->layout > ENVIRONMENT_PROJECTION ||
        (environment->layout == ENVIRONMENT_SQUARE && picture->width != picture->height) ||
        (uint64_t)picture->width * picture->height > ENVIRONMENT_MAX)
        return err_set(err, ERR_SCENE, "environment %u: the shape of its picture is not valid",
                       index);
    const float *scale = environment->scale;
    if (!finite_all(environment->to_light, 9) || !finite_all(scale, 3) ||
        !(scale[0] >= 0 && scale[1] >= 0 && scale[2] >= 0))
        return err_set(err, ERR_SCENE, "environment %u has a number that is not valid", index);
    if (environment->layout != ENVIRONMENT_PROJECTION && !is_rotation(environment->to_light))
        return err_set(err, ERR_SCENE, "environment %u is not turned by a rotation", index);
    if (environment->light >= scene->light_count ||
        scene->lights[environment->light].environment != index + 1)
        return err_set(err, ERR_SCENE, "environment %u and its light do not know each other",
                       index);
    return true;
}

static bool check_texture(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct texture *texture = &scene->textures[index];
    const float others[] = { texture->scale, texture->variation, texture->omega };

    if (texture->kind >= TEXTURE_KINDS || texture->mapping > MAPPING_POINT ||
        texture->wrap[0] > WRAP_MIRROR || texture->wrap[1] > WRAP_MIRROR ||
        (texture->channel > 3 && texture->channel != SCENE_NONE))
        return err_set(err, ERR_SCENE, "texture %u is not valid", index);
    if (!finite_all(&texture->value[0][0], 12) || !finite_all(texture->map, 12) ||
        !finite_all(others, 3) || texture->octaves > 64)
        return err_set(err, ERR_SCENE, "texture %u has a number that is not valid", index);
    if (texture->kind == TEXTURE_IMAGE && texture->picture >= scene->picture_count)
        return err_set(err, ERR_SCENE, "texture %u: no picture %u", index, texture->picture);
    /* Earlier textures only, so that none can contain itself */
    for (int i = 0; i < 3; i++)
        if (texture->child[i] > index)
            return err_set(err, ERR_SCENE, "texture %u is made of one that is not before it",
                           index);
    return true;
}

static bool check_material(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct material *material = &scene->materials[index];

    if (material->kind >= MATERIAL_KINDS)
        return err_set(err, ERR_SCENE, "material %u: unknown kind %u", index, material->kind);
    for (int slot = 0; slot < MATERIAL_SLOTS; slot++)
        if (material->texture[slot] > scene->texture_count)
            return err_set(err, ERR_SCENE, "material %u: no texture %u", index,
                           material->texture[slot]);
    const float others[] = { material->ior,          material->alpha[0],
                             material->alpha[1],     material->mix_amount,
                             material->coat_inner,   material->coat_scale,
                             material->normal_scale, material->base_alpha[0],
                             material->base_alpha[1] };
    if (!finite_all(material->reflectance, 3) || !finite_all(material->specular, 3) ||
        !finite_all(material->eta, 3) || !finite_all(material->k, 3) || !finite_all(others, 9))
        return err_set(err, ERR_SCENE, "material %u has a number that is not finite", index);
    uint32_t kind = material->kind;
    bool coat = kind == MATERIAL_COAT || kind == MATERIAL_COATED_CONDUCTOR;
    bool glass = kind == MATERIAL_DIELECTRIC || kind == MATERIAL_THIN_DIELECTRIC;
    if ((coat || glass) && !(material->ior > 0))
        return err_set(err, ERR_SCENE, "material %u: an index of refraction of %g", index,
                       material->ior);
    uint64_t rows = kind == MATERIAL_COATED_CONDUCTOR ? COAT_METAL_ROWS : 1;
    if (material->flags & MATERIAL_COATS)
        rows = rows * COAT_ALPHAS + 1;
    if (coat && material->coat_table + rows > scene->coat_table_count)
        return err_set(err, ERR_SCENE, "material %u: no coat table %u", index,
                       material->coat_table);
    const float *sheen = material->sheen;
    if (material->flags & MATERIAL_SHEEN) {
        if (kind == MATERIAL_MIX || kind == MATERIAL_UNLIT)
            return err_set(err, ERR_SCENE, "material %u cannot have a sheen", index);
        for (int c = 0; c < 3; c++)
            if (!(sheen[c] >= 0 && sheen[c] <= 1))
                return err_set(err, ERR_SCENE, "material %u: a sheen of %g", index, sheen[c]);
        if (!(material->sheen_alpha >= SHEEN_ALPHA_LEAST && material->sheen_alpha <= 1))
            return err_set(err, ERR_SCENE, "material %u: a sheen of width %g", index,
                           material->sheen_alpha);
        if ((uint64_t)material->sheen_table + SHEEN_ROWS > scene->coat_table_count)
            return err_set(err, ERR_SCENE, "material %u: no table %u of a sheen", index,
                           material->sheen_table);
    }
    /* Earlier materials only, so that no mix can contain itself */
    if (material->kind == MATERIAL_MIX && (material->mix[0] >= index || material->mix[1] >= index))
        return err_set(err, ERR_SCENE, "material %u mixes materials that are not before it", index);
    return true;
}

static bool check_light(const struct scene *scene, uint32_t index, struct err *err)
{
    const struct light *light = &scene->lights[index];
    const float others[] = { light->cos_falloff_start, light->cos_falloff_end, light->area,
                             light->pick, light->texture_scale };
    bool portal = light->kind == LIGHT_SKY && light->corner_count != 0;

    if (light->kind >= LIGHT_KINDS)
        return err_set(err, ERR_SCENE, "light %u: unknown kind %u", index, light->kind);
    if (!finite_all(light->radiance, 3) || !finite_all(light->position, 3) ||
        !finite_all(light->direction, 3) || !finite_all(light->normal, 3) || !finite_all(others, 5))
        return err_set(err, ERR_SCENE, "light %u has a number that is not finite", index);
    if (!(light->pick > 0) || light->pick > 1)
        return err_set(err, ERR_SCENE, "light %u is chosen with probability %g", index,
                       light->pick);
    if ((light->kind == LIGHT_POLYGON || portal) &&
        (light->corner_count < 3 || light->corner_count > POLYGON_MAX ||
         (uint64_t)light->first_corner + light->corner_count > scene->light_corner_count))
        return err_set(err, ERR_SCENE, "light %u: its corners are not valid", index);
    if ((light->kind == LIGHT_SPHERE || light->kind == LIGHT_DISK) &&
        (light->quadric >= scene->quadric_count || scene->quadrics[light->quadric].light != index))
        return err_set(err, ERR_SCENE, "light %u and its quadric do not know each other", index);
    if (light->environment != 0) {
        uint32_t environment = light->environment - 1;
        if (environment >= scene->environment_count ||
            scene->environments[environment].light != index)
            return err_set(err, ERR_SCENE, "light %u and its environment do not know each other",
                           index);
        bool projected = scene->environments[environment].layout == ENVIRONMENT_PROJECTION;
        if (light->kind != LIGHT_POINT && (light->kind != LIGHT_SKY || projected))
            return err_set(err, ERR_SCENE, "light %u cannot have its environment", index);
    }
    if (portal && (light->corner_count != 4 || light->environment == 0))
        return err_set(err, ERR_SCENE, "light %u cannot have its portal", index);
    if ((light->kind <= LIGHT_DISK || portal) && !(light->area > 0))
        return err_set(err, ERR_SCENE, "light %u has no area", index);
    if (light->texture > scene->texture_count)
        return err_set(err, ERR_SCENE, "light %u: no texture %u", index, light->texture);
    if (light->texture != 0 && light->kind > LIGHT_DISK)
        return err_set(err, ERR_SCENE, "light %u cannot have a texture", index);
    if (light->texture != 0 && light->kind == LIGHT_POLYGON && light->corner_count != 3)
        return err_set(err, ERR_SCENE, "light %u has a texture, and is no triangle", index);
    if ((light->flags & LIGHT_UNSEEN) && light->kind > LIGHT_DISK)
        return err_set(err, ERR_SCENE, "light %u has no shape that could be unseen", index);
    return true;
}

static bool check_arrays(const struct scene *scene, struct err *err)
{
#define X(member, count, type, per)                \
    if (scene->count > 0 && scene->member == NULL) \
        return err_set(err, ERR_SCENE, "the array " #member " is missing");
    SCENE_ARRAYS(X)
#undef X
    if (!finite_all(scene->positions, 3 * (size_t)scene->vertex_count))
        return err_set(err, ERR_SCENE, "a vertex position is not finite");
    if (!finite_all(scene->normals, 3 * (size_t)scene->normal_count))
        return err_set(err, ERR_SCENE, "a vertex normal is not finite");
    if (!finite_all(scene->light_corners, 3 * (size_t)scene->light_corner_count))
        return err_set(err, ERR_SCENE, "a corner of a light is not finite");
    if (!finite_all(scene->coat_tables, COAT_TABLE_LEN * (size_t)scene->coat_table_count))
        return err_set(err, ERR_SCENE, "a coat's table is not finite");
    if (!finite_all(scene->uvs, 2 * (size_t)scene->uv_count))
        return err_set(err, ERR_SCENE, "a texture coordinate is not finite");
    if (!finite_all(scene->colors, 4 * (size_t)scene->color_count))
        return err_set(err, ERR_SCENE, "a vertex colour is not finite");
    for (uint32_t i = 0; i < scene->triangle_light_count; i++)
        if (scene->triangle_light[i] != SCENE_NONE &&
            scene->triangle_light[i] >= scene->light_count)
            return err_set(err, ERR_SCENE, "a triangle emits as light %u, and there is none",
                           scene->triangle_light[i]);
    return true;
}

bool scene_check(const struct scene *scene, struct err *err)
{
    if (!check_arrays(scene, err) || !check_settings(scene, err))
        return false;
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        if (!check_mesh(scene, i, err))
            return false;
    for (uint32_t i = 0; i < scene->quadric_count; i++)
        if (!check_quadric(scene, i, err))
            return false;
    if (!check_groups(scene, err))
        return false;
    for (uint32_t i = 0; i < scene->instance_count; i++)
        if (!check_instance(scene, i, err))
            return false;
    for (uint32_t i = 0; i < scene->motion_count; i++)
        if (!check_motion(scene, i, err))
            return false;
    for (uint32_t i = 0; i < scene->medium_count; i++)
        if (!check_medium(scene, i, err))
            return false;
    for (uint32_t i = 0; i < scene->picture_count; i++)
        if (!check_picture(scene, i, err))
            return false;
    for (uint32_t i = 0; i < scene->environment_count; i++)
        if (!check_environment(scene, i, err))
            return false;
    for (uint32_t i = 0; i < scene->texture_count; i++)
        if (!check_texture(scene, i, err))
            return false;
    for (uint32_t i = 0; i < scene->material_count; i++)
        if (!check_material(scene, i, err))
            return false;
    double picks = 0;
    for (uint32_t i = 0; i < scene->light_count; i++) {
        if (!check_light(scene, i, err))
            return false;
        picks += scene->lights[i].pick;
    }
    if (scene->light_count > 0 && fabs(picks - 1) > 1e-3)
        return err_set(err, ERR_SCENE, "the lights are chosen with probability %g in all", picks);
    if (scene->settings.effects != scene_effects(scene))
        return err_set(err, ERR_SCENE, "the effect mask is %#x and should be %#x",
                       scene->settings.effects, scene_effects(scene));
    return true;
}
