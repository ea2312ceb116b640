#include "master/pbrt_materials.h"

#include "common/arena.h"
#include "master/albedo.h"
#include "master/pbrt_color.h"
#include "master/pbrt_reader.h"
#include "master/spectrum.h"

#include <math.h>
#include <string.h>

#define COUNT(a)    (sizeof(a) / sizeof((a)[0]))
#define MIX_DEPTH   32   /* of mixes in mixes */
#define ALPHA_LEAST 1e-4 /* of one axis when the other is rough: as pbrt */

static const struct pbrt_name kinds[] = {
    { "diffuse", MATERIAL_DIFFUSE, NAME_OURS, NULL },
    { "mixture", MATERIAL_MIXTURE, NAME_OURS, NULL },
    { "conductor", MATERIAL_CONDUCTOR, NAME_OURS, NULL },
    { "dielectric", MATERIAL_DIELECTRIC, NAME_OURS, NULL },
    { "coateddiffuse", MATERIAL_COAT, NAME_OURS, NULL },
    { "mix", MATERIAL_MIX, NAME_OURS, NULL },
    { "coatedconductor", MATERIAL_COATED_CONDUCTOR, NAME_OURS, NULL },
    { "diffusetransmission", MATERIAL_DIFFUSE_TRANSMISSION, NAME_OURS, NULL },
    { "thindielectric", MATERIAL_THIN_DIELECTRIC, NAME_OURS, NULL },
    { "interface", MATERIAL_KINDS, NAME_OURS, NULL },
    { "", MATERIAL_KINDS, NAME_OURS, NULL },
    { "hair", 0, NAME_LATER, NULL },
    { "measured", 0, NAME_LATER, NULL },
    { "subsurface", 0, NAME_LATER, NULL },
    { "disney", 0, NAME_OLD, "pbrt-v4 has no such material" },
    { "fourier", 0, NAME_OLD, "in pbrt-v4 there is \"measured\"" },
    { "glass", 0, NAME_OLD, "in pbrt-v4 it is \"dielectric\"" },
    { "kdsubsurface", 0, NAME_OLD, "in pbrt-v4 it is \"subsurface\"" },
    { "matte", 0, NAME_OLD, "in pbrt-v4 it is \"diffuse\"" },
    { "metal", 0, NAME_OLD, "in pbrt-v4 it is \"conductor\"" },
    { "mirror", 0, NAME_OLD, "in pbrt-v4 it is \"conductor\"" },
    { "none", 0, NAME_OLD, "in pbrt-v4 it is \"interface\"" },
    { "plastic", 0, NAME_OLD, "in pbrt-v4 it is \"coateddiffuse\"" },
    { "substrate", 0, NAME_OLD, "in pbrt-v4 it is \"coateddiffuse\"" },
    { "translucent", 0, NAME_OLD, "in pbrt-v4 it is \"diffusetransmission\"" },
    { "uber", 0, NAME_OLD, "in pbrt-v4 there is \"coateddiffuse\"" },
};

struct pbrt_material {
    struct material material;
    double coat_thickness;
    uint32_t mixes[2]; /* index in `mix_names`, for MATERIAL_MIX */
    uint32_t in_scene; /* index among the scene's materials, or SCENE_NONE */
    bool busy;         /* being resolved: a mix that meets itself */
    struct source_pos pos;
};

struct pbrt_material_name {
    const char *text;
    size_t length;
    uint32_t definition;
};

/* --- Parameters --------------------------------------------------------------------------- */

static void to_float(const double from[3], float to[3])
{
    for (int i = 0; i < 3; i++)
        to[i] = (float)from[i];
}

static void read_reflectance(struct pbrt_params *params, const char *name, double otherwise,
                             float color[3])
{
    double rgb[3] = { otherwise, otherwise, otherwise };
    pbrt_color(params, name, COLOR_REFLECTANCE, rgb);
    to_float(rgb, color);
}

/* GGX widths: pbrt's remapping is a square root, and small roughness is none */
static const char *const roughness_names[3] = { "roughness", "uroughness", "vroughness" };
static const char *const interface_names[3] = { "interface.roughness", "interface.uroughness",
                                                "interface.vroughness" };
static const char *const conductor_names[3] = { "conductor.roughness", "conductor.uroughness",
                                                "conductor.vroughness" };

static void read_roughness(struct pbrt_params *params, const char *const names[3], float alpha[2])
{
    double both = pbrt_params_float(params, names[0], 0);
    double axes[2] = { pbrt_params_float(params, names[1], both),
                       pbrt_params_float(params, names[2], both) };
    bool remap = pbrt_params_bool(params, "remaproughness", true);
    for (int i = 0; i < 2; i++) {
        if (!(axes[i] >= 0 && axes[i] <= 100)) {
            pbrt_params_fail(params, NULL, "a roughness of %g is outside 0 to 100", axes[i]);
            return;
        }
        axes[i] = remap ? sqrt(axes[i]) : axes[i];
    }
    bool smooth = axes[0] < ALPHA_SMOOTH && axes[1] < ALPHA_SMOOTH;
    for (int i = 0; i < 2; i++)
        alpha[i] = smooth ? 0 : (float)fmax(axes[i], ALPHA_LEAST);
}

/* An index of refraction: a number, or a spectrum's mean */
static float read_ior(struct pbrt_params *params, const char *name)
{
    double rgb[3] = { 1.5, 1.5, 1.5 };
    if (pbrt_color(params, name, COLOR_INDEX, rgb) && (rgb[0] != rgb[1] || rgb[1] != rgb[2]))
        pbrt_report_note(params->reader, &params->pos,
                         "one index of refraction is used for all colours");
    double ior = (rgb[0] + rgb[1] + rgb[2]) / 3;
    if (!params->failed && !(ior >= 0.1 && ior <= 10))
        pbrt_params_fail(params, pbrt_params_find(params, name),
                         "an index of refraction of %g is outside .1 to 10", ior);
    return (float)ior;
}

static void read_metal(struct pbrt_params *params, const char *eta_name, const char *k_name,
                       struct material *material)
{
    double reflectance[3], eta[3], k[3];
    bool has_reflectance = pbrt_color(params, "reflectance", COLOR_REFLECTANCE, reflectance);
    bool has_eta = pbrt_color(params, eta_name, COLOR_INDEX, eta);
    bool has_k = pbrt_color(params, k_name, COLOR_INDEX, k);
    if (has_reflectance && (has_eta || has_k)) {
        pbrt_params_fail(params, pbrt_params_find(params, "reflectance"),
                         "a conductor has either reflectance or eta and k");
        return;
    }
    double copper_eta[3], copper_k[3];
    spectrum_metal("metal-Cu-eta", copper_eta);
    spectrum_metal("metal-Cu-k", copper_k);
    for (int c = 0; c < 3; c++) {
        if (has_reflectance) {
            /* The k that reflects r at normal incidence, for eta 1; never quite all of it */
            double r = fmin(reflectance[c], 0.9999);
            material->eta[c] = 1;
            material->k[c] = (float)(2 * sqrt(r) / sqrt(1 - r));
        } else {
            material->eta[c] = (float)(has_eta ? eta[c] : copper_eta[c]);
            material->k[c] = (float)(has_k ? k[c] : copper_k[c]);
        }
        if (!params->failed && !(material->eta[c] > 0))
            pbrt_params_fail(params, pbrt_params_find(params, eta_name), "a conductor's eta of %g",
                             material->eta[c]);
    }
}

/* What both coats have between interface and base */
static void read_layer(struct pbrt_params *params, struct pbrt_material *definition)
{
    definition->coat_thickness = pbrt_params_float(params, "thickness", 0.01);
    if (!(definition->coat_thickness >= 0 && definition->coat_thickness < 1e6))
        pbrt_params_fail(params, pbrt_params_find(params, "thickness"), "a thickness of %g",
                         definition->coat_thickness);
    double albedo[3] = { 0, 0, 0 };
    if (pbrt_color(params, "albedo", COLOR_REFLECTANCE, albedo) &&
        (albedo[0] > 0 || albedo[1] > 0 || albedo[2] > 0) && !params->failed)
        params->failed = !pbrt_report_later(params->reader, &params->pos,
                                            "a coat with a medium that scatters (\"albedo\")");
    pbrt_params_float(params, "g", 0); /* of that medium */
    pbrt_params_ignore(params, "maxdepth");
    pbrt_params_ignore(params, "nsamples"); /* of a walk that we do not take */
}

static void read_coat(struct pbrt_params *params, struct pbrt_material *definition)
{
    struct material *material = &definition->material;
    read_reflectance(params, "reflectance", 0.5, material->reflectance);
    read_roughness(params, roughness_names, material->alpha);
    material->ior = read_ior(params, "eta");
    read_layer(params, definition);
}

static void read_coated_conductor(struct pbrt_params *params, struct pbrt_material *definition)
{
    struct material *material = &definition->material;
    read_metal(params, "conductor.eta", "conductor.k", material);
    read_roughness(params, interface_names, material->alpha);
    read_roughness(params, conductor_names, material->base_alpha);
    material->ior = read_ior(params, "interface.eta");
    read_layer(params, definition);
}

/* Reflectance and transmittance, both times "scale"; pbrt lets their sum exceed one, and so do we,
 * but not without a word */
static void read_sheet(struct pbrt_params *params, struct material *material)
{
    read_reflectance(params, "reflectance", 0.25, material->reflectance);
    read_reflectance(params, "transmittance", 0.25, material->specular);
    double scale = pbrt_params_float(params, "scale", 1);
    if (!(scale >= 0 && scale <= 1e6))
        pbrt_params_fail(params, pbrt_params_find(params, "scale"), "a scale of %g", scale);
    bool textured = material->texture[SLOT_REFLECTANCE] != 0 ||
                    material->texture[SLOT_SPECULAR] != 0;
    if (scale != 1 && textured && !params->failed)
        params->failed = !pbrt_report_later(params->reader, &params->pos,
                                            "\"scale\" of a sheet with textures");
    float most = 0;
    for (int c = 0; c < 3; c++) {
        material->reflectance[c] = (float)fmin(scale * (double)material->reflectance[c], 1);
        material->specular[c] = (float)fmin(scale * (double)material->specular[c], 1);
        most = fmaxf(most, material->reflectance[c] + material->specular[c]);
    }
    if (most > 1 + 1e-6f)
        pbrt_report_note(params->reader, &params->pos,
                         "reflectance + transmittance is %g: more than is received", (double)most);
}

static void read_mix(struct pbrt_params *params, struct pbrt_material *definition)
{
    struct pbrt_reader *reader = params->reader;
    size_t count;
    const struct pbrt_token *names = pbrt_params_strings(params, "materials", &count);
    double amount = pbrt_params_float(params, "amount", 0.5);
    if (!params->failed && (names == NULL || count != 2))
        pbrt_params_fail(params, pbrt_params_find(params, "materials"),
                         "a mix wants \"string materials\" with two names");
    if (!(amount >= 0 && amount <= 1))
        pbrt_params_fail(params, pbrt_params_find(params, "amount"),
                         "an amount of %g is outside 0 to 1", amount);
    definition->material.mix_amount = (float)amount;
    if (params->failed)
        return;
    struct pbrt_token *copies = growing_add(&reader->materials.mix_names, 2, sizeof(*copies));
    if (copies == NULL) {
        params->failed = true;
        pbrt_report_no_memory(reader);
        return;
    }
    for (int i = 0; i < 2; i++) {
        copies[i] = names[i];
        definition->mixes[i] = (uint32_t)(reader->materials.mix_names.count - 2 + (size_t)i);
    }
}

/* --- Textures in place of numbers --------------------------------------------------------- */

static void take_roughness(struct pbrt_params *params, const char *const names[3],
                           struct material *material)
{
    uint32_t *slots = material->texture + SLOT_ROUGHNESS_U;
    uint32_t both = pbrt_textures_take(params, names[0], false);
    for (int i = 0; i < 2; i++)
        slots[i] = pbrt_params_find(params, names[i + 1]) != NULL
                       ? pbrt_textures_take(params, names[i + 1], false)
                       : both;
    if ((slots[0] != 0 || slots[1] != 0) && pbrt_params_bool(params, "remaproughness", true))
        material->flags |= MATERIAL_REMAP;
}

/* Fill the slots, as definitions for now, and leave to the readers of numbers what is a number */
static void take_textures(struct pbrt_params *params, struct material *material)
{
    static const struct {
        uint32_t kind, slot;
        const char *name;
        bool spectrum;
    } rows[] = {
        { MATERIAL_DIFFUSE, SLOT_REFLECTANCE, "reflectance", true },
        { MATERIAL_MIXTURE, SLOT_REFLECTANCE, "diffuse", true },
        { MATERIAL_MIXTURE, SLOT_SPECULAR, "specular", true },
        { MATERIAL_CONDUCTOR, SLOT_REFLECTANCE, "reflectance", true },
        { MATERIAL_CONDUCTOR, SLOT_ETA, "eta", true },
        { MATERIAL_CONDUCTOR, SLOT_K, "k", true },
        { MATERIAL_COAT, SLOT_REFLECTANCE, "reflectance", true },
        { MATERIAL_COATED_CONDUCTOR, SLOT_REFLECTANCE, "reflectance", true },
        { MATERIAL_COATED_CONDUCTOR, SLOT_ETA, "conductor.eta", true },
        { MATERIAL_COATED_CONDUCTOR, SLOT_K, "conductor.k", true },
        { MATERIAL_DIFFUSE_TRANSMISSION, SLOT_REFLECTANCE, "reflectance", true },
        { MATERIAL_DIFFUSE_TRANSMISSION, SLOT_SPECULAR, "transmittance", true },
        { MATERIAL_MIX, SLOT_AMOUNT, "amount", false },
    };
    for (size_t i = 0; i < COUNT(rows); i++)
        if (rows[i].kind == material->kind)
            material->texture[rows[i].slot] = pbrt_textures_take(params, rows[i].name,
                                                                 rows[i].spectrum);
    if (material->kind == MATERIAL_CONDUCTOR || material->kind == MATERIAL_DIELECTRIC ||
        material->kind == MATERIAL_COAT)
        take_roughness(params, roughness_names, material);
    bool coated = material->kind == MATERIAL_COATED_CONDUCTOR;
    if (coated)
        take_roughness(params, interface_names, material);

    const uint32_t *slots = material->texture;
    if ((material->kind != MATERIAL_CONDUCTOR && !coated) || slots[SLOT_REFLECTANCE] == 0)
        return;
    const char *eta = coated ? "conductor.eta" : "eta", *k = coated ? "conductor.k" : "k";
    material->flags |= MATERIAL_METAL;
    if (slots[SLOT_ETA] != 0 || slots[SLOT_K] != 0 || pbrt_params_find(params, eta) != NULL ||
        pbrt_params_find(params, k) != NULL)
        pbrt_params_fail(params, NULL, "a conductor has either reflectance or eta and k");
}

/* Bumps and normal maps, which any surface may have; a mix takes those of its two */
static void take_bumps(struct pbrt_params *params, struct material *material)
{
    uint32_t normal = pbrt_textures_normal_map(params, "normalmap");
    uint32_t bump = pbrt_textures_take(params, "displacement", false);
    pbrt_params_float(params, "displacement", 0); /* the same everywhere: no slope */
    if (material->kind != MATERIAL_MIX) {
        material->texture[SLOT_NORMAL] = normal;
        material->texture[SLOT_BUMP] = bump;
    } else if (normal != 0 || bump != 0) {
        pbrt_report_note(params->reader, &params->pos,
                         "a mix has no bumps but those of its materials");
    }
    const struct pbrt_param *old = pbrt_params_find(params, "bumpmap");
    if (old != NULL)
        pbrt_params_fail(params, old,
                         "\"bumpmap\" is of pbrt-v3: in pbrt-v4 it is \"texture displacement\"");
}

static void read_material(struct pbrt_params *params, struct pbrt_material *definition)
{
    struct material *material = &definition->material;
    take_textures(params, material);
    switch (material->kind) {
    case MATERIAL_DIFFUSE:
        read_reflectance(params, "reflectance", 0.5, material->reflectance);
        break;
    case MATERIAL_MIXTURE:
        read_reflectance(params, "diffuse", 0.25, material->reflectance);
        read_reflectance(params, "specular", 0.25, material->specular);
        for (int c = 0; c < 3; c++)
            if (material->reflectance[c] + material->specular[c] > 1 + 1e-6f)
                pbrt_params_fail(params, NULL,
                                 "diffuse + specular is %g: a mixture cannot return more than it "
                                 "receives",
                                 material->reflectance[c] + material->specular[c]);
        break;
    case MATERIAL_CONDUCTOR:
        read_metal(params, "eta", "k", material);
        read_roughness(params, roughness_names, material->alpha);
        break;
    case MATERIAL_DIELECTRIC:
        material->ior = read_ior(params, "eta");
        read_roughness(params, roughness_names, material->alpha);
        break;
    case MATERIAL_COAT:
        read_coat(params, definition);
        break;
    case MATERIAL_COATED_CONDUCTOR:
        read_coated_conductor(params, definition);
        break;
    case MATERIAL_THIN_DIELECTRIC:
        material->ior = read_ior(params, "eta");
        break;
    case MATERIAL_DIFFUSE_TRANSMISSION:
        read_sheet(params, material);
        break;
    case MATERIAL_KINDS: /* an interface: nothing to read */
        break;
    default:
        read_mix(params, definition);
    }
    take_bumps(params, material);
}

/* --- Definitions -------------------------------------------------------------------------- */

static bool add_definition(struct pbrt_reader *reader, const struct pbrt_material *definition,
                           uint32_t *index)
{
    *index = (uint32_t)reader->materials.definitions.count;
    struct pbrt_material *added = growing_add(&reader->materials.definitions, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = *definition;
    return true;
}

static struct pbrt_material grey_diffuse(const struct source_pos *pos)
{
    return (struct pbrt_material){ .material = { .kind = MATERIAL_DIFFUSE,
                                                 .reflectance = { 0.5f, 0.5f, 0.5f } },
                                   .in_scene = SCENE_NONE,
                                   .pos = *pos };
}

/* The parameters just read, as a material of kind `type` */
static bool parse(struct pbrt_reader *reader, const struct pbrt_token *type, uint32_t *index)
{
    const struct pbrt_name *found;
    if (!pbrt_names_choose(reader, "material", kinds, COUNT(kinds), type, &found))
        return false;
    struct pbrt_material definition = grey_diffuse(&type->pos);
    if (found != NULL) {
        definition.material = (struct material){ .kind = (uint32_t)found->value };
        read_material(&reader->params, &definition);
        if (!pbrt_params_done(&reader->params))
            return false;
    }
    return add_definition(reader, &definition, index);
}

bool pbrt_materials_start(struct pbrt_reader *reader)
{
    const struct source_pos nowhere = { "", 0, 0 };
    struct pbrt_material definition = grey_diffuse(&nowhere);
    return add_definition(reader, &definition, &reader->state.material);
}

void pbrt_materials_free(struct pbrt_materials *materials)
{
    growing_free(&materials->definitions);
    growing_free(&materials->names);
    growing_free(&materials->mix_names);
    scene_coats_free(&materials->coats);
}

bool pbrt_materials_set(struct pbrt_reader *reader, const struct pbrt_token *type)
{
    return parse(reader, type, &reader->state.material);
}

static const struct pbrt_material_name *find_name(const struct pbrt_reader *reader,
                                                  const struct pbrt_token *name)
{
    const struct pbrt_material_name *names = reader->materials.names.data;
    for (size_t i = 0; i < reader->materials.names.count; i++)
        if (names[i].length == name->length && memcmp(names[i].text, name->text, name->length) == 0)
            return &names[i];
    return NULL;
}

static bool no_such_material(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    const struct pbrt_material_name *names = reader->materials.names.data;
    if (reader->materials.names.count == 0)
        return pbrt_report_error(reader, &name->pos, "no material \"%.*s\": none has been named",
                                 (int)name->length, name->text);

    /* The first few hundred are enough to be helpful */
    char texts[256][48];
    const char *list[256];
    size_t count = reader->materials.names.count < 256 ? reader->materials.names.count : 256;
    for (size_t i = 0; i < count; i++) {
        size_t length = names[i].length < sizeof(texts[i]) ? names[i].length : sizeof(texts[i]) - 1;
        memcpy(texts[i], names[i].text, length);
        texts[i][length] = '\0';
        list[i] = texts[i];
    }
    return pbrt_report_error(reader, &name->pos, "no material \"%.*s\"; the nearest is \"%s\"",
                             (int)name->length, name->text,
                             pbrt_names_nearest_of(list, count, name->text, name->length));
}

bool pbrt_materials_define(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    const struct pbrt_token *type = pbrt_params_string(&reader->params, "type");
    if (type == NULL) {
        if (!reader->params.failed)
            pbrt_params_fail(&reader->params, NULL, "a named material wants \"string type\"");
        return false;
    }
    if (find_name(reader, name) != NULL)
        return pbrt_report_error(reader, &name->pos, "material \"%.*s\" is defined twice",
                                 (int)name->length, name->text);
    uint32_t definition;
    struct pbrt_token type_copy = *type;
    if (!parse(reader, &type_copy, &definition))
        return false;
    struct pbrt_material_name *added = growing_add(&reader->materials.names, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = (struct pbrt_material_name){ name->text, name->length, definition };
    return true;
}

bool pbrt_materials_use(struct pbrt_reader *reader, const struct pbrt_token *name)
{
    const struct pbrt_material_name *found = find_name(reader, name);
    if (found == NULL)
        return no_such_material(reader, name);
    reader->state.material = found->definition;
    return true;
}

/* --- Into the scene ----------------------------------------------------------------------- */

static bool resolve_coat(struct pbrt_reader *reader, const struct pbrt_material *definition,
                         struct material *material)
{
    struct scene_coats *coats = &reader->materials.coats;
    if (!scene_coats_add(coats, reader->build, material, definition->coat_thickness, reader->err))
        return false;
    if (coats->similar)
        pbrt_report_note(reader, &definition->pos, SCENE_COATS_SIMILAR);
    return true;
}

static bool resolve(struct pbrt_reader *reader, uint32_t index, int depth, uint32_t *in_scene)
{
    struct pbrt_material *definition = (struct pbrt_material *)reader->materials.definitions.data +
                                       index;
    if (definition->in_scene != SCENE_NONE) {
        *in_scene = definition->in_scene;
        return true;
    }
    if (definition->busy || depth == MIX_DEPTH)
        return pbrt_report_error(reader, &definition->pos, "%s",
                                 definition->busy ? "this mix contains itself"
                                                  : "too many mixes inside each other");
    if (definition->material.kind == MATERIAL_KINDS) {
        if (depth > 0)
            return pbrt_report_error(reader, &definition->pos,
                                     "an interface is not there, and cannot be part of a mix");
        *in_scene = SCENE_NONE;
        return true;
    }
    definition->busy = true;
    struct material material = definition->material;
    if ((material.kind == MATERIAL_COAT || material.kind == MATERIAL_COATED_CONDUCTOR) &&
        !resolve_coat(reader, definition, &material))
        return false;
    for (int i = 0; material.kind == MATERIAL_MIX && i < 2; i++) {
        const struct pbrt_token *name = (struct pbrt_token *)reader->materials.mix_names.data +
                                        definition->mixes[i];
        const struct pbrt_material_name *found = find_name(reader, name);
        if (found == NULL)
            return no_such_material(reader, name);
        if (!resolve(reader, found->definition, depth + 1, &material.mix[i]))
            return false;
    }
    for (int slot = 0; slot < MATERIAL_SLOTS; slot++)
        if (!pbrt_textures_resolve(reader, &material.texture[slot]))
            return false;
    struct material *added = growing_add(&reader->build->materials, 1, sizeof(*added));
    if (added == NULL)
        return pbrt_report_no_memory(reader);
    *added = material;
    definition->busy = false;
    definition->in_scene = *in_scene = (uint32_t)(reader->build->materials.count - 1);
    return true;
}

bool pbrt_materials_resolve(struct pbrt_reader *reader, uint32_t *in_scene)
{
    return resolve(reader, reader->state.material, 0, in_scene);
}

/* What is left of a material when its surface is diffuse: textures that are its colour, or much
 * like it, stay that, and bumps stay bumps */
static void make_diffuse(const struct pbrt_reader *reader, struct material *material)
{
    struct material diffuse = { .kind = MATERIAL_DIFFUSE,
                                .flags = material->flags & MATERIAL_NORMAL_SCALED,
                                .normal_scale = material->normal_scale };
    double albedo[3];
    if (material->kind == MATERIAL_MIX)
        return;
    albedo_of(material, reader->build->coat_tables.data, albedo);
    to_float(albedo, diffuse.reflectance);
    static const enum material_slot kept[] = { SLOT_REFLECTANCE, SLOT_NORMAL, SLOT_BUMP };
    for (size_t i = 0; i < COUNT(kept); i++)
        diffuse.texture[kept[i]] = material->texture[kept[i]];
    *material = diffuse;
}

static void force_diffuse(struct pbrt_reader *reader)
{
    struct material *materials = reader->build->materials.data;
    for (size_t i = 0; i < reader->build->materials.count; i++)
        make_diffuse(reader, &materials[i]);
}

bool pbrt_materials_finish(struct pbrt_reader *reader)
{
    struct scene *scene = reader->build->scene;
    size_t count = reader->materials.names.count;
    const struct pbrt_material_name *names = reader->materials.names.data;
    const struct pbrt_material *definitions = reader->materials.definitions.data;
    if (reader->materials.diffuse)
        force_diffuse(reader);
    scene->material_names = arena_alloc(scene->arena, count, sizeof(*scene->material_names));
    if (scene->material_names == NULL)
        return pbrt_report_no_memory(reader);
    for (size_t i = 0; i < count; i++) {
        uint32_t index = definitions[names[i].definition].in_scene;
        if (index == SCENE_NONE)
            continue;
        const char *text = arena_text(scene->arena, names[i].text, names[i].length);
        if (text == NULL)
            return pbrt_report_no_memory(reader);
        scene->material_names[scene->material_name_count++] = (struct scene_name){ index, text };
    }
    return true;
}
