#include "master/gltf_materials.h"

#include "common/elem.h"
#include "master/gltf_reader.h"

#include <math.h>
#include <string.h>

#define BRIGHT     1e12 /* the most that anything emits */
#define CLEAR_IOR  1.5
#define PANE_ALPHA 0.01 /* below it, a rough pane looks smooth */
#define DARKEST    1e-6 /* of what comes through the attenuation distance */

enum { RED = 0, GREEN = 1, BLUE = 2, ALPHA = 3 };

/* A number, and its texture with the number multiplied in, or 0 */
struct knob {
    double value; /* where there is no texture; else about its mean */
    uint32_t texture;
};

/* What a material looks like, before it is one of ours */
struct look {
    struct gltf_item item;
    uint32_t set;
    double base[3], base_alpha; /* factors alone */
    uint32_t base_texture;      /* with the factors and the vertices' colours, or 0 */
    struct gltf_texture base_image;
    struct knob metallic, alpha; /* alpha: GGX width */
    struct knob transmission, clear;
    double clear_alpha;
    double sheen[3];        /* black: there is none */
    uint32_t sheen_texture; /* with the factors, or 0 */
    struct knob sheen_alpha;
    double ior, reflected; /* of the dielectric: F0 = reflected times that of its index */
    bool thick, unlit, colored;
    double absorbed[3]; /* inside of thick glass, per unit of length of the world */
    uint32_t normal;
    double normal_scale;
};

bool gltf_materials_start(struct gltf_reader *reader)
{
    size_t count = 2 * gltf_json_count(reader, "materials") + 2;
    struct growing *surfaces = &reader->materials.surfaces;
    struct gltf_surface *all = growing_add(surfaces, count, sizeof(*all));
    if (all == NULL)
        return gltf_report_no_memory(reader);
    memset(all, 0, count * sizeof(*all));
    return true;
}

void gltf_materials_free(struct gltf_materials *materials)
{
    growing_free(&materials->surfaces);
    scene_coats_free(&materials->coats);
}

static bool none_of(const struct knob *share)
{
    return share->texture == 0 && share->value <= 0;
}

static bool all_of(const struct knob *share)
{
    return share->texture == 0 && share->value >= 1;
}

/* --- Reading ------------------------------------------------------------------------------ */

/* A texture of the material; all of them should lie on the same coordinates */
static bool read_texture(struct gltf_reader *reader, struct look *look,
                         const struct gltf_item *item, const char *name, bool colors,
                         struct gltf_texture *texture)
{
    if (!gltf_textures_read(reader, item, name, colors, texture))
        return false;
    if (!texture->there)
        return true;
    if (look->set == SCENE_NONE)
        look->set = texture->set;
    if (look->set != texture->set)
        gltf_report_note(reader, texture->where,
                         "a second set of texture coordinates in one material: the first is used");
    return true;
}

/* A factor and a channel of a texture that it scales */
static bool read_knob(struct gltf_reader *reader, struct look *look, const struct gltf_item *item,
                      const char *factor, double otherwise, const char *texture, uint32_t channel,
                      struct knob *knob)
{
    struct gltf_texture image;
    knob->value = gltf_json_number(reader, item, factor, otherwise, 0, 1);
    if (reader->failed || !read_texture(reader, look, item, texture, false, &image))
        return false;
    if (!image.there || knob->value == 0)
        return true;
    if (!gltf_textures_image(reader, &image, channel, &knob->texture))
        return false;
    if (knob->texture == 0)
        return true; /* an alpha of 1 */
    double mean[4], scale[3] = { knob->value, knob->value, knob->value };
    gltf_textures_mean(reader, &image, mean);
    knob->value *= mean[channel];
    return gltf_textures_scale(reader, &knob->texture, scale);
}

/* Its texture's mean in place of a texture that cannot be used */
static bool read_mean(struct gltf_reader *reader, struct look *look, const struct gltf_item *item,
                      const char *factor, double otherwise, const char *texture, uint32_t channel,
                      double *value)
{
    struct knob knob = { 0 };
    if (!read_knob(reader, look, item, factor, otherwise, texture, channel, &knob))
        return false;
    if (knob.texture != 0)
        gltf_report_note(reader, item->where, "\"%s\" stands for its mean", texture);
    *value = knob.value;
    return true;
}

static bool read_base(struct gltf_reader *reader, struct look *look, const struct gltf_item *item,
                      const char *factor, const char *texture)
{
    double rgba[4] = { 1, 1, 1, 1 };
    gltf_json_numbers(reader, item, factor, 0, 1, rgba, 4);
    memcpy(look->base, rgba, sizeof(look->base));
    look->base_alpha = rgba[3];
    return !reader->failed && read_texture(reader, look, item, texture, true, &look->base_image);
}

/* The base colour's tree: picture times factor times the vertices' colours */
static bool make_base(struct gltf_reader *reader, struct look *look)
{
    uint32_t colors = 0;
    return gltf_textures_image(reader, &look->base_image, SCENE_NONE, &look->base_texture) &&
           (!look->colored || gltf_textures_colors(reader, SCENE_NONE, &colors)) &&
           gltf_textures_product(reader, &look->base_texture, colors) &&
           (look->base_texture == 0 ||
            gltf_textures_scale(reader, &look->base_texture, look->base));
}

/* glTF's roughness is the square root of the width: also in a texture, by its own square */
static bool square(struct gltf_reader *reader, struct knob *roughness)
{
    roughness->value *= roughness->value;
    return roughness->texture == 0 ||
           gltf_textures_product(reader, &roughness->texture, roughness->texture);
}

static bool read_metallic_roughness(struct gltf_reader *reader, struct look *look)
{
    struct gltf_item item = gltf_json_child(reader, &look->item, "pbrMetallicRoughness");
    static const char both[] = "metallicRoughnessTexture";
    return !reader->failed &&
           read_base(reader, look, &item, "baseColorFactor", "baseColorTexture") &&
           read_knob(reader, look, &item, "metallicFactor", 1, both, BLUE, &look->metallic) &&
           read_knob(reader, look, &item, "roughnessFactor", 1, both, GREEN, &look->alpha) &&
           square(reader, &look->alpha);
}

static double brightness(const double rgb[3])
{
    return sqrt(0.299 * rgb[0] * rgb[0] + 0.587 * rgb[1] * rgb[1] + 0.114 * rgb[2] * rgb[2]);
}

/* The metalness at which base colour m gives this diffuse and this specular colour */
static double metallic_of(double diffuse, double specular, double not_specular)
{
    const double dielectric = 0.04;
    if (specular <= dielectric)
        return 0;
    double b = diffuse * not_specular / (1 - dielectric) + specular - 2 * dielectric;
    double c = dielectric - specular;
    double root = sqrt(fmax(0, b * b - 4 * dielectric * c));
    return fmin(1, fmax(0, (root - b) / (2 * dielectric)));
}

/* The retired extension, by its factors; its diffuse picture stays a picture */
static bool read_specular_glossiness(struct gltf_reader *reader, struct look *look,
                                     const struct gltf_item *item)
{
    double specular[3] = { 1, 1, 1 };
    gltf_report_note(reader, item->where,
                     "it is turned into metallic-roughness, which cannot say all of it");
    if (!read_base(reader, look, item, "diffuseFactor", "diffuseTexture"))
        return false;
    gltf_json_numbers(reader, item, "specularFactor", 0, 1, specular, 3);
    double gloss = gltf_json_number(reader, item, "glossinessFactor", 1, 0, 1);
    if (gltf_json_has(item, "specularGlossinessTexture"))
        gltf_report_note(reader, item->where, "\"specularGlossinessTexture\" is left out");

    double strongest = fmax(specular[0], fmax(specular[1], specular[2]));
    double metallic = metallic_of(brightness(look->base), brightness(specular), 1 - strongest);
    metallic = metallic > 1 - 1e-6 ? 1 : metallic; /* rounding needs no second material */
    for (int c = 0; c < 3; c++) {
        double diffuse = look->base[c] * (1 - strongest) / (0.96 * fmax(1 - metallic, 1e-6));
        double metal = (specular[c] - 0.04 * (1 - metallic)) / fmax(metallic, 1e-6);
        double share = metallic * metallic;
        look->base[c] = fmin(1, fmax(0, diffuse * (1 - share) + metal * share));
    }
    look->metallic.value = metallic;
    look->alpha.value = (1 - gloss) * (1 - gloss);
    return !reader->failed;
}

static bool read_normal(struct gltf_reader *reader, struct look *look)
{
    struct gltf_texture texture;
    struct gltf_item info = gltf_json_child(reader, &look->item, "normalTexture");
    look->normal_scale = gltf_json_number(reader, &info, "scale", 1, -1e3, 1e3);
    return !reader->failed &&
           read_texture(reader, look, &look->item, "normalTexture", false, &texture) &&
           gltf_textures_image(reader, &texture, SCENE_NONE, &look->normal);
}

/* What the dielectric reflects: its index, and how much "specular" takes from that */
static bool read_dielectric(struct gltf_reader *reader, struct look *look)
{
    struct gltf_item ior = gltf_json_extension(reader, &look->item, "KHR_materials_ior");
    struct gltf_item specular = gltf_json_extension(reader, &look->item, "KHR_materials_specular");
    look->ior = gltf_json_number(reader, &ior, "ior", 1.5, 0, 100);
    look->reflected = 1;
    if (look->ior < 1 || look->ior > 10) {
        gltf_report_note(reader, ior.where, "an index of refraction outside of 1 to 10 is cut");
        look->ior = look->ior > 1 || look->ior == 0 ? 10 : 1;
    }
    if (specular.json == NULL)
        return !reader->failed;
    double rgb[3] = { 1, 1, 1 };
    if (!read_mean(reader, look, &specular, "specularFactor", 1, "specularTexture", ALPHA,
                   &look->reflected))
        return false;
    gltf_json_numbers(reader, &specular, "specularColorFactor", 0, 1e3, rgb, 3);
    look->reflected *= (rgb[0] + rgb[1] + rgb[2]) / 3;
    if (look->reflected != 0)
        gltf_report_note(reader, specular.where,
                         "how much is reflected becomes another index of refraction, in no colour");
    return !reader->failed;
}

/* What is inside of glass, if it has an inside */
static void read_volume(struct gltf_reader *reader, struct look *look)
{
    struct gltf_item item = gltf_json_extension(reader, &look->item, "KHR_materials_volume");
    double rgb[3] = { 1, 1, 1 };
    look->thick = gltf_json_number(reader, &item, "thicknessFactor", 0, 0, 1e30) > 0;
    if (!gltf_json_has(&item, "attenuationDistance"))
        return;
    double distance = gltf_json_number(reader, &item, "attenuationDistance", 1, 0, 1e30);
    gltf_json_numbers(reader, &item, "attenuationColor", 0, 1, rgb, 3);
    if (!look->thick || !(distance > 1e-20))
        gltf_report_note(reader, item.where,
                         "what is inside of glass is clear without a thickness and a distance");
    else
        for (int c = 0; c < 3; c++)
            look->absorbed[c] = -elem_log(fmax(rgb[c], DARKEST)) / distance;
}

static bool read_transmission(struct gltf_reader *reader, struct look *look)
{
    struct gltf_item item = gltf_json_extension(reader, &look->item, "KHR_materials_transmission");
    read_volume(reader, look);
    return !reader->failed && read_knob(reader, look, &item, "transmissionFactor", 0,
                                        "transmissionTexture", RED, &look->transmission);
}

static bool read_clearcoat(struct gltf_reader *reader, struct look *look)
{
    struct gltf_item item = gltf_json_extension(reader, &look->item, "KHR_materials_clearcoat");
    double roughness = 0;
    if (item.json == NULL)
        return !reader->failed;
    if (!read_knob(reader, look, &item, "clearcoatFactor", 0, "clearcoatTexture", RED,
                   &look->clear) ||
        !read_mean(reader, look, &item, "clearcoatRoughnessFactor", 0, "clearcoatRoughnessTexture",
                   GREEN, &roughness))
        return false;
    look->clear_alpha = roughness * roughness;
    if (!none_of(&look->clear))
        gltf_report_note(reader, item.where,
                         "a clear coat takes the place of a dielectric's own gloss");
    if (gltf_json_has(&item, "clearcoatNormalTexture"))
        gltf_report_note(reader, item.where, "the coat has the normals of what is below");
    return true;
}

static bool has_sheen(const struct look *look)
{
    return look->sheen[0] > 0 || look->sheen[1] > 0 || look->sheen[2] > 0;
}

static bool read_sheen(struct gltf_reader *reader, struct look *look)
{
    struct gltf_item item = gltf_json_extension(reader, &look->item, "KHR_materials_sheen");
    struct gltf_texture image;
    gltf_json_numbers(reader, &item, "sheenColorFactor", 0, 1, look->sheen, 3);
    if (reader->failed || !has_sheen(look))
        return !reader->failed;
    if (!none_of(&look->clear))
        gltf_report_note(reader, item.where, "a sheen lies on a clear coat, not below it");
    return read_texture(reader, look, &item, "sheenColorTexture", true, &image) &&
           gltf_textures_image(reader, &image, SCENE_NONE, &look->sheen_texture) &&
           (look->sheen_texture == 0 ||
            gltf_textures_scale(reader, &look->sheen_texture, look->sheen)) &&
           read_knob(reader, look, &item, "sheenRoughnessFactor", 0, "sheenRoughnessTexture", ALPHA,
                     &look->sheen_alpha) &&
           square(reader, &look->sheen_alpha);
}

static void note_left_out(struct gltf_reader *reader, const struct look *look)
{
    static const char *const names[] = { "KHR_materials_iridescence", "KHR_materials_anisotropy",
                                         "KHR_materials_dispersion",
                                         "KHR_materials_diffuse_transmission" };
    for (size_t i = 0; i < sizeof(names) / sizeof(names[0]); i++)
        if (gltf_json_extension(reader, &look->item, names[i]).json != NULL)
            gltf_report_note(reader, look->item.where, "%s is left out", names[i]);
    if (gltf_json_has(&look->item, "occlusionTexture"))
        gltf_report_note(reader, look->item.where,
                         "occlusion textures are not used: light is traced");
}

static bool read_look(struct gltf_reader *reader, struct look *look)
{
    struct gltf_item old = gltf_json_extension(reader, &look->item,
                                               "KHR_materials_pbrSpecularGlossiness");
    struct gltf_item unlit = gltf_json_extension(reader, &look->item, "KHR_materials_unlit");
    bool good = old.json != NULL && !gltf_json_has(&look->item, "pbrMetallicRoughness")
                    ? read_specular_glossiness(reader, look, &old)
                    : read_metallic_roughness(reader, look);
    if (!good || !make_base(reader, look) || !read_normal(reader, look) ||
        !read_dielectric(reader, look) || !read_transmission(reader, look) ||
        !read_clearcoat(reader, look) || !read_sheen(reader, look))
        return false;
    note_left_out(reader, look);
    look->unlit = unlit.json != NULL;
    if (look->unlit)
        gltf_report_note(
            reader, unlit.where,
            "an unlit material is seen by the camera and in mirrors, and lights nothing");
    return !reader->failed;
}

/* --- Into the scene ----------------------------------------------------------------------- */

static bool add(struct gltf_reader *reader, const struct look *look, struct material *material,
                uint32_t *index)
{
    if (material->kind != MATERIAL_MIX && material->kind != MATERIAL_UNLIT) {
        material->texture[SLOT_NORMAL] = look->normal;
        material->normal_scale = (float)look->normal_scale;
        if (look->normal != 0 && look->normal_scale != 1)
            material->flags |= MATERIAL_NORMAL_SCALED;
        if (has_sheen(look)) {
            material->texture[SLOT_SHEEN] = look->sheen_texture;
            material->texture[SLOT_SHEEN_ALPHA] = look->sheen_alpha.texture;
            if (!scene_coats_add_sheen(&reader->materials.coats, reader->build, material,
                                       look->sheen, look->sheen_alpha.value, reader->err))
                return gltf_report_wrap(reader, look->item.where);
        }
    }
    struct material *added = growing_add(&reader->build->materials, 1, sizeof(*added));
    if (added == NULL)
        return gltf_report_no_memory(reader);
    *added = *material;
    *index = (uint32_t)(reader->build->materials.count - 1);
    return true;
}

static float width(double alpha)
{
    return alpha < ALPHA_SMOOTH ? 0 : (float)alpha;
}

static void set_reflectance(const struct look *look, struct material *material)
{
    for (int c = 0; c < 3; c++)
        material->reflectance[c] = (float)look->base[c];
    material->texture[SLOT_REFLECTANCE] = look->base_texture;
}

static void set_alpha(const struct knob *alpha, struct material *material)
{
    material->alpha[0] = material->alpha[1] = width(alpha->value);
    material->texture[SLOT_ROUGHNESS_U] = material->texture[SLOT_ROUGHNESS_V] = alpha->texture;
}

static bool add_unlit(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    struct material material = { .kind = MATERIAL_UNLIT };
    set_reflectance(look, &material);
    return add(reader, look, &material, index);
}

static bool add_diffuse(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    struct material material = { .kind = MATERIAL_DIFFUSE };
    set_reflectance(look, &material);
    return add(reader, look, &material, index);
}

/* Reflectance at normal incidence, through the k that gives it for eta 1; never quite all */
static void set_metal(const struct look *look, struct material *material)
{
    set_reflectance(look, material);
    material->flags |= MATERIAL_METAL;
    for (int c = 0; c < 3; c++) {
        double r = fmin(look->base[c], 0.9999);
        material->eta[c] = 1;
        material->k[c] = (float)(2 * sqrt(r) / sqrt(1 - r));
    }
}

static bool add_metal(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    struct material material = { .kind = MATERIAL_CONDUCTOR };
    set_metal(look, &material);
    set_alpha(&look->alpha, &material);
    return add(reader, look, &material, index);
}

static bool add_coated(struct gltf_reader *reader, const struct look *look,
                       struct material *material, uint32_t *index)
{
    struct scene_coats *coats = &reader->materials.coats;
    if (!scene_coats_add(coats, reader->build, material, 0, reader->err))
        return gltf_report_wrap(reader, look->item.where);
    if (coats->similar)
        gltf_report_note(reader, look->item.where, SCENE_COATS_SIMILAR);
    return add(reader, look, material, index);
}

/* The index of refraction that reflects so much at normal incidence */
static double index_of(const struct look *look)
{
    double root = (look->ior - 1) / (look->ior + 1);
    double f0 = fmin(0.9 * 0.9, root * root * look->reflected);
    return (1 + sqrt(f0)) / (1 - sqrt(f0));
}

static bool add_coat(struct gltf_reader *reader, const struct look *look, const struct knob *alpha,
                     double ior, uint32_t *index)
{
    struct material material = { .kind = MATERIAL_COAT, .ior = (float)ior };
    if (material.ior < 1.001f)
        return add_diffuse(reader, look, index);
    set_reflectance(look, &material);
    set_alpha(alpha, &material);
    return add_coated(reader, look, &material, index);
}

/* `share` of *index becomes `other`; all or nothing needs no mix */
static bool mix(struct gltf_reader *reader, const struct look *look, const struct knob *share,
                uint32_t other, uint32_t *index)
{
    struct material material = { .kind = MATERIAL_MIX,
                                 .mix = { *index, other },
                                 .mix_amount = (float)share->value };
    material.texture[SLOT_AMOUNT] = share->texture;
    return add(reader, look, &material, index);
}

/* The clear coat's own, smooth or rough */
static struct knob clear_alpha(const struct look *look)
{
    return (struct knob){ .value = look->clear_alpha };
}

/* A diffuse base below one coat, which is the clear one for its share */
static bool add_dielectric(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    const struct knob clear = clear_alpha(look);
    uint32_t other = 0;
    if (!add_coat(reader, look, &look->alpha, index_of(look), index))
        return false;
    if (none_of(&look->clear))
        return true;
    return add_coat(reader, look, &clear, CLEAR_IOR, &other) &&
           mix(reader, look, &look->clear, other, index);
}

/* Metal, below a coat for the clear one's share */
static bool add_metals(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    const struct knob clear = clear_alpha(look);
    struct material coated = { .kind = MATERIAL_COATED_CONDUCTOR, .ior = (float)CLEAR_IOR };
    uint32_t other = 0;
    if (!add_metal(reader, look, index))
        return false;
    if (none_of(&look->clear))
        return true;
    set_metal(look, &coated);
    set_alpha(&clear, &coated);
    coated.base_alpha[0] = coated.base_alpha[1] = width(look->alpha.value);
    return add_coated(reader, look, &coated, &other) &&
           mix(reader, look, &look->clear, other, index);
}

/* A closed body of glass where it has a thickness, else a pane; both tint what goes through */
static bool add_glass(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    struct material material = { .kind = look->thick ? MATERIAL_DIELECTRIC
                                                     : MATERIAL_THIN_DIELECTRIC,
                                 .flags = MATERIAL_TINTED,
                                 .ior = (float)index_of(look) };
    for (int c = 0; c < 3; c++)
        material.specular[c] = (float)look->base[c];
    material.texture[SLOT_SPECULAR] = look->base_texture;
    if (look->thick)
        set_alpha(&look->alpha, &material);
    else if (look->alpha.texture != 0 || look->alpha.value > PANE_ALPHA)
        gltf_report_note(reader, look->item.where, "a pane of rough glass is taken as smooth");
    return add(reader, look, &material, index);
}

/* What is not metal: opaque, and glass for the share that lets light through */
static bool add_not_metal(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    uint32_t glass = 0;
    if (all_of(&look->transmission))
        return add_glass(reader, look, index);
    if (!add_dielectric(reader, look, index) || none_of(&look->transmission))
        return !reader->failed;
    return add_glass(reader, look, &glass) && mix(reader, look, &look->transmission, glass, index);
}

static bool add_material(struct gltf_reader *reader, const struct look *look, uint32_t *index)
{
    uint32_t metal = 0;
    if (look->unlit)
        return add_unlit(reader, look, index);
    if (none_of(&look->metallic))
        return add_not_metal(reader, look, index);
    if (all_of(&look->metallic))
        return add_metals(reader, look, index);
    return add_not_metal(reader, look, index) && add_metals(reader, look, &metal) &&
           mix(reader, look, &look->metallic, metal, index);
}

/* --- Alpha and emission ------------------------------------------------------------------- */

static bool make_alpha(struct gltf_reader *reader, const struct look *look, uint32_t *alpha)
{
    const char *mode = gltf_json_text(reader, &look->item, "alphaMode");
    double cutoff = gltf_json_number(reader, &look->item, "alphaCutoff", 0.5, 0, 1e3);
    double factor[3] = { look->base_alpha, look->base_alpha, look->base_alpha };
    uint32_t colors = 0;
    *alpha = 0;
    if (reader->failed || mode == NULL || strcmp(mode, "OPAQUE") == 0)
        return !reader->failed;
    bool mask = strcmp(mode, "MASK") == 0;
    if (!mask && strcmp(mode, "BLEND") != 0)
        return gltf_report_error(reader, look->item.where, "there is no alpha mode \"%s\"", mode);
    if (!gltf_textures_image(reader, &look->base_image, ALPHA, alpha) ||
        (look->colored && !gltf_textures_colors(reader, ALPHA, &colors)) ||
        !gltf_textures_product(reader, alpha, colors))
        return false;
    if (*alpha == 0) {
        double whole = mask ? factor[0] >= cutoff : factor[0];
        return whole >= 1 || gltf_textures_constant(reader, whole, alpha);
    }
    return gltf_textures_scale(reader, alpha, factor) &&
           (!mask || gltf_textures_step(reader, alpha, cutoff));
}

static bool make_emitter(struct gltf_reader *reader, struct look *look, uint32_t *emitter)
{
    double rgb[3] = { 0, 0, 0 };
    uint32_t tree = 0;
    struct gltf_texture texture;
    struct gltf_item item = gltf_json_extension(reader, &look->item,
                                                "KHR_materials_emissive_strength");
    *emitter = SCENE_NONE;
    gltf_json_numbers(reader, &look->item, "emissiveFactor", 0, BRIGHT, rgb, 3);
    double strength = gltf_json_number(reader, &item, "emissiveStrength", 1, 0, BRIGHT);
    bool both = gltf_json_bool(reader, &look->item, "doubleSided", false);
    if (reader->failed)
        return false;
    if (strength == 0 || (rgb[0] == 0 && rgb[1] == 0 && rgb[2] == 0) || look->unlit)
        return true;
    for (int c = 0; c < 3; c++)
        rgb[c] *= strength;
    if (!read_texture(reader, look, &look->item, "emissiveTexture", true, &texture) ||
        !gltf_textures_image(reader, &texture, SCENE_NONE, &tree))
        return false;
    if (tree != 0) {
        if (!gltf_textures_scale(reader, &tree, rgb))
            return false;
        rgb[0] = rgb[1] = rgb[2] = 1;
    }
    struct emitter *added = growing_add(&reader->build->emitters, 1, sizeof(*added));
    if (added == NULL)
        return gltf_report_no_memory(reader);
    *added = (struct emitter){ .two_sided = both,
                               .texture = tree,
                               .pos = { reader->report.path, 0, 0 } };
    memcpy(added->radiance, rgb, sizeof(rgb));
    *emitter = (uint32_t)(reader->build->emitters.count - 1);
    return true;
}

/* --- Surfaces ----------------------------------------------------------------------------- */

/* The medium inside of thick glass; 0 where it is clear, or where nothing gets in */
static bool make_inside(struct gltf_reader *reader, const struct look *look, uint32_t *inside)
{
    *inside = 0;
    bool clear = look->absorbed[0] == 0 && look->absorbed[1] == 0 && look->absorbed[2] == 0;
    if (clear || look->unlit || none_of(&look->transmission) || all_of(&look->metallic))
        return true;
    struct medium *added = growing_add(&reader->build->media, 1, sizeof(*added));
    if (added == NULL)
        return gltf_report_no_memory(reader);
    *added = (struct medium){ .g = 0 };
    for (int c = 0; c < 3; c++)
        added->sigma_a[c] = (float)look->absorbed[c];
    *inside = (uint32_t)reader->build->media.count;
    return true;
}

static bool make_surface(struct gltf_reader *reader, struct look *look,
                         struct gltf_surface *surface)
{
    if (!read_look(reader, look) || !add_material(reader, look, &surface->material) ||
        !make_alpha(reader, look, &surface->alpha) ||
        !make_inside(reader, look, &surface->inside) ||
        !make_emitter(reader, look, &surface->emitter))
        return false;
    surface->set = look->set;
    return surface->done = true;
}

bool gltf_materials_use(struct gltf_reader *reader, uint32_t index, bool colored,
                        const struct gltf_item *from, struct gltf_surface *surface)
{
    struct look look = { .colored = colored, .set = SCENE_NONE };
    size_t place = gltf_json_count(reader, "materials");
    if (index != SCENE_NONE) {
        if (!gltf_json_find(reader, "materials", index, from, &look.item))
            return false;
        place = index;
    }
    struct gltf_surface *known = (struct gltf_surface *)reader->materials.surfaces.data +
                                 2 * place + colored;
    if (!known->done && !make_surface(reader, &look, known))
        return false;
    *surface = *known;
    return true;
}
