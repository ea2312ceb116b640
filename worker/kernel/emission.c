#include "worker/kernel/emission.h"

#include "common/err.h"
#include "worker/kernel/alpha.h"
#include "worker/kernel/surface_point.h"

#include <stdlib.h>

#define BRIGHTEST 1e30f /* of a texel and of all that it is multiplied by */

/* Does any light have a texture, or a shape that is there in part? */
static bool is_needed(const struct scene *scene)
{
    for (uint32_t i = 0; i < scene->light_count; i++)
        if (scene->lights[i].texture != 0)
            return true;
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        if (scene->meshes[i].first_emissive != SCENE_NONE && scene->meshes[i].alpha != 0)
            return true;
    for (uint32_t i = 0; i < scene->quadric_count; i++)
        if (scene->quadrics[i].light != SCENE_NONE && scene->quadrics[i].alpha != 0)
            return true;
    return false;
}

bool emission_open(struct kernel_scene *ks, struct err *err)
{
    const struct scene *scene = ks->scene;
    if (!is_needed(scene))
        return true;
    ks->emission = calloc((size_t)scene->light_count + 1, sizeof(*ks->emission));
    if (ks->emission == NULL)
        return err_set(err, ERR_MEMORY, "no memory for %u lights", scene->light_count);
    for (uint32_t i = 0; i < scene->mesh_count; i++) {
        const struct mesh *mesh = &scene->meshes[i];
        if (mesh->first_emissive == SCENE_NONE)
            continue;
        for (uint32_t t = 0; t < mesh->triangle_count; t++) {
            uint32_t light = scene->triangle_light[mesh->first_emissive + t];
            if (light != SCENE_NONE && (mesh->alpha != 0 || scene->lights[light].texture != 0))
                ks->emission[light] = (struct emission){ .mesh = mesh, .prim = t };
        }
    }
    for (uint32_t i = 0; i < scene->quadric_count; i++) {
        const struct quadric *quadric = &scene->quadrics[i];
        uint32_t light = quadric->light;
        if (light != SCENE_NONE && (quadric->alpha != 0 || scene->lights[light].texture != 0))
            ks->emission[light] = (struct emission){ .quadric = quadric };
    }
    return true;
}

void emission_close(struct kernel_scene *ks)
{
    free(ks->emission);
    ks->emission = NULL;
}

void emission_seen(const struct kernel_scene *ks, uint32_t light, const struct texture_point *point,
                   float rgb[3])
{
    const struct light *of = &ks->scene->lights[light];
    if (of->texture == 0)
        return;
    texture_at(ks->textures, of->texture - 1, point, rgb);
    for (int c = 0; c < 3; c++) {
        float value = rgb[c] * of->texture_scale;
        rgb[c] = value > 0 ? (value < BRIGHTEST ? value : BRIGHTEST) : 0;
    }
}

void emission_sampled(const struct kernel_scene *ks, uint32_t light, const float p[3],
                      const float to[3], float rgb[3])
{
    const struct emission *of = &ks->emission[light];
    struct texture_point point;
    uint32_t alpha;
    if (of->mesh != NULL) {
        surface_point_triangle(ks->scene, of->mesh, of->prim, p, to, &point);
        alpha = of->mesh->alpha;
    } else if (of->quadric != NULL) {
        surface_point_quadric(of->quadric, p, to, 1, &point);
        alpha = of->quadric->alpha;
    } else {
        return;
    }
    emission_seen(ks, light, &point, rgb);
    float share = alpha_share(ks->textures, alpha, &point);
    for (int c = 0; c < 3; c++)
        rgb[c] *= share;
}
