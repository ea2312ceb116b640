#include "common/effects.h"

#include "common/scene.h"

#include <stdio.h>
#include <string.h>

static uint32_t roughness_effects(const struct material *material)
{
    const float *alpha = material->alpha, *base = material->base_alpha;
    const uint32_t *texture = material->texture;
    uint32_t mask = 0;
    if (alpha[0] >= ALPHA_SMOOTH || alpha[1] >= ALPHA_SMOOTH || texture[SLOT_ROUGHNESS_U] != 0 ||
        texture[SLOT_ROUGHNESS_V] != 0 || base[0] >= ALPHA_SMOOTH || base[1] >= ALPHA_SMOOTH)
        mask |= FX_ROUGH;
    if (alpha[0] != alpha[1] || base[0] != base[1] ||
        texture[SLOT_ROUGHNESS_U] != texture[SLOT_ROUGHNESS_V])
        mask |= FX_ANISOTROPIC;
    return mask;
}

static uint32_t material_effects(const struct material *material)
{
    uint32_t mask = 0;
    for (int slot = 0; slot < MATERIAL_SLOTS; slot++)
        if (material->texture[slot] != 0)
            mask |= slot == SLOT_NORMAL || slot == SLOT_BUMP ? FX_TEXTURE | FX_BUMP : FX_TEXTURE;
    if (material->flags & MATERIAL_SHEEN)
        mask |= FX_SHEEN;
    switch (material->kind) {
    case MATERIAL_MIXTURE:
        return mask | FX_MIXTURE;
    case MATERIAL_CONDUCTOR:
        return mask | FX_CONDUCTOR | roughness_effects(material);
    case MATERIAL_DIELECTRIC:
        return mask | FX_DIELECTRIC | roughness_effects(material);
    case MATERIAL_COAT:
        return mask | FX_COAT | roughness_effects(material);
    case MATERIAL_COATED_CONDUCTOR:
        return mask | FX_COATED_CONDUCTOR | roughness_effects(material);
    case MATERIAL_THIN_DIELECTRIC:
    case MATERIAL_DIFFUSE_TRANSMISSION:
        return mask | FX_THIN;
    case MATERIAL_MIX:
        return mask | FX_MIX;
    case MATERIAL_UNLIT:
        return mask | FX_TEXTURE;
    default:
        return mask; /* diffuse is what every kernel has */
    }
}

static uint32_t light_effects(const struct light *light)
{
    uint32_t mask = light->environment != 0 ? FX_ENVIRONMENT : 0;
    if (light->texture != 0)
        mask |= FX_TEXTURE;
    if (light->flags & LIGHT_UNSEEN)
        mask |= FX_DELTA_LIGHT; /* light sampling alone finds it */
    switch (light->kind) {
    case LIGHT_POLYGON:
        return mask | FX_POLYGON_LIGHT | (light->corner_count > 4 ? FX_WIDE_POLYGON : 0);
    case LIGHT_SPHERE:
        return mask | FX_SPHERE_LIGHT;
    case LIGHT_DISK:
        return mask | FX_DISK_LIGHT;
    case LIGHT_SKY:
        return mask != 0 ? mask : FX_SKY;
    default:
        return mask | FX_DELTA_LIGHT;
    }
}

uint32_t scene_effects(const struct scene *scene)
{
    const struct scene_settings *settings = &scene->settings;
    const struct filter_spec *filter = &settings->filter;
    uint32_t mask = 0;

    if (scene->triangle_count > 0)
        mask |= FX_MESH;
    if (scene->quadric_count > 0)
        mask |= FX_QUADRIC;
    for (uint32_t i = 0; i < scene->mesh_count; i++)
        mask |= (scene->meshes[i].flags & MESH_NORMALS ? FX_SMOOTH_NORMALS : 0) |
                (scene->meshes[i].alpha != 0 ? FX_TEXTURE : 0);
    for (uint32_t i = 0; i < scene->quadric_count; i++)
        mask |= scene->quadrics[i].alpha != 0 ? FX_TEXTURE : 0;
    if (scene->instance_count > 0)
        mask |= FX_INSTANCE;
    if (scene->motion_count > 0)
        mask |= FX_MOTION;
    if (scene->medium_count > 0)
        mask |= FX_MEDIUM;
    if (settings->camera.lens_radius > 0)
        mask |= FX_LENS;
    if (settings->camera.kind == CAMERA_ORTHOGRAPHIC)
        mask |= FX_ORTHOGRAPHIC;
    for (uint32_t i = 0; i < scene->material_count; i++)
        mask |= material_effects(&scene->materials[i]);
    for (uint32_t i = 0; i < scene->light_count; i++)
        mask |= light_effects(&scene->lights[i]);
    if (scene->light_count > 1)
        mask |= FX_MANY_LIGHTS;
    uint32_t finite = 0;
    for (uint32_t i = 0; i < scene->light_count; i++)
        finite += scene->lights[i].kind != LIGHT_DISTANT && scene->lights[i].kind != LIGHT_SKY;
    if (finite > LIGHT_TREE_ABOVE)
        mask |= FX_LIGHT_TREE;
    if (settings->sampler != SAMPLER_SOBOL)
        mask |= FX_SAMPLER_ANY;
    if (filter->kind != FILTER_BOX || filter->radius[0] != 0.5f || filter->radius[1] != 0.5f)
        mask |= FX_FILTER_ANY;
    return mask;
}

const char *effects_text(uint32_t mask, char *text, size_t capacity)
{
    static const struct {
        uint32_t bit;
        const char *printed;
    } names[] = {
#define X(name, bit, printed, meaning) { FX_##name, printed },
        EFFECT_MAP(X)
#undef X
    };
    if (capacity == 0)
        return text;
    text[0] = '\0';
    size_t length = 0;
    for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); i++) {
        if (!(mask & names[i].bit) || length >= capacity)
            continue;
        int wanted = snprintf(text + length, capacity - length, "%s%s", length > 0 ? ", " : "",
                              names[i].printed);
        length += wanted > 0 ? (size_t)wanted : 0;
    }
    return text;
}
