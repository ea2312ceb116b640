/* Goal: a glTF file becomes the scene that glTF means by it, real files are read without leniency,
 * and what is wrong, hostile or approximated is said. */
#include "common/effects.h"
#include "master/gltf.h"
#include "tests/reader_text.h"
#include "tests/scratch.h"

#include <glob.h>
#include <math.h>
#include <openssl/evp.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/stat.h>

#include <cmocka.h>

#define PI 3.14159265358979323846

/* 2 x 2: red, green with alpha 0; blue, white with alpha 128 */
#define PNG_2X2                                                                              \
    "iVBORw0KGgoAAAANSUhEUgAAAAIAAAACCAYAAABytg0kAAAAFElEQVR42mP4z8DwHwhB4D8INAAAP1MIeYCuwN" \
    "YAAAAASUVORK5CYII="

/* --- Files made here ---------------------------------------------------------------------- */

static struct {
    unsigned char bytes[8192];
    size_t size;
    char views[4096], accessors[8192];
    unsigned count;
} made;

static void start(void)
{
    memset(&made, 0, sizeof(made));
}

/* An accessor of these bytes; `more` is further JSON, beginning with a comma */
static unsigned add(const void *bytes, size_t size, unsigned type, size_t count, const char *shape,
                    const char *more)
{
    const char *comma = made.count > 0 ? "," : "";
    memcpy(made.bytes + made.size, bytes, size);
    size_t v = strlen(made.views), a = strlen(made.accessors);
    snprintf(made.views + v, sizeof(made.views) - v,
             "%s{\"buffer\":0,\"byteOffset\":%zu,\"byteLength\":%zu}", comma, made.size, size);
    snprintf(made.accessors + a, sizeof(made.accessors) - a,
             "%s{\"bufferView\":%u,\"componentType\":%u,\"count\":%zu,\"type\":\"%s\"%s}", comma,
             made.count, type, count, shape, more);
    made.size += (size + 3) / 4 * 4;
    return made.count++;
}

static unsigned add_floats(const float *values, size_t count, unsigned components)
{
    static const char *const shapes[] = { "", "SCALAR", "VEC2", "VEC3", "VEC4" };
    return add(values, count * components * sizeof(float), 5126, count, shapes[components], "");
}

static const float corner[9] = { 0, 0, 0, 1, 0, 0, 0, 1, 0 };

/* Accessor 0 is the triangle (0,0,0) (1,0,0) (0,1,0), as the mesh below wants it */
static void start_triangle(void)
{
    start();
    add_floats(corner, 3, 3);
}
#define MESH "\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}}]}]"
#define SHOW "\"nodes\":[{\"mesh\":0}]"

/* The file with the accessors made so far, and the rest of it; in a buffer of its own */
static const char *document_of(const char *rest, const char *asset)
{
    static char text[65536], base64[16384];
    EVP_EncodeBlock((unsigned char *)base64, made.bytes, (int)made.size);
    snprintf(text, sizeof(text),
             "{\"asset\":{\"version\":\"2.0\"%s},\"buffers\":[{\"byteLength\":%zu,\"uri\":"
             "\"data:application/octet-stream;base64,%s\"}],\"bufferViews\":[%s],"
             "\"accessors\":[%s],%s}",
             asset, made.size, base64, made.views, made.accessors, rest);
    return text;
}

static struct scene *read_document(const char *rest, const struct gltf_options *options,
                                   struct scene_notes *notes, struct err *err)
{
    const char *text = document_of(rest, "");
    return gltf_read_bytes(text, strlen(text), NULL, options, notes, err);
}

static struct scene *scene_of(const char *rest)
{
    struct err err = { .text = "" };
    struct scene *scene = read_document(rest, NULL, NULL, &err);
    if (scene == NULL)
        fail_msg("%s\nin: %s", err.text, rest);
    return scene;
}

static void expect_note(const char *rest, const char *text)
{
    struct err err = { .text = "" };
    struct scene_notes notes;
    struct scene *scene = read_document(rest, NULL, &notes, &err);
    if (scene == NULL)
        fail_msg("%s", err.text);
    if (!notes_saying(&notes, text))
        fail_msg("no note says \"%s\"; the first is: %s", text,
                 notes.count > 0 ? notes.lines[0] : "none");
    scene_notes_free(&notes);
    scene_free(scene);
}

/* Where the first mesh's vertex is in the world, instance or not */
static void world_vertex(const struct scene *scene, uint32_t vertex, double world[3])
{
    for (unsigned axis = 0; axis < 3; axis++)
        world[axis] = scene->positions[3 * vertex + axis] + scene->settings.center[axis];
}

static void expect_vertex(const struct scene *scene, uint32_t vertex, double x, double y, double z)
{
    double world[3];
    world_vertex(scene, vertex, world);
    EXPECT_NEAR(world[0], x, 1e-5);
    EXPECT_NEAR(world[1], y, 1e-5);
    EXPECT_NEAR(world[2], z, 1e-5);
}

/* --- Nodes -------------------------------------------------------------------------------- */

static void nodes_put_meshes_where_they_belong(void **state)
{
    (void)state;
    static const struct {
        const char *nodes;
        double p[3]; /* where (1, 0, 0) goes */
    } rows[] = {
        { "{\"mesh\":0}", { 1, 0, 0 } },
        { "{\"mesh\":0,\"translation\":[1,2,3]}", { 2, 2, 3 } },
        { "{\"mesh\":0,\"scale\":[2,3,4]}", { 2, 0, 0 } },
        { "{\"mesh\":0,\"rotation\":[0,0,0.70710678,0.70710678]}", { 0, 1, 0 } },
        { "{\"mesh\":0,\"rotation\":[0,0,3,3]}", { 0, 1, 0 } },
        { "{\"mesh\":0,\"translation\":[5,0,0],\"rotation\":[0,1,0,0],\"scale\":[2,2,2]}",
          { 3, 0, 0 } },
        { "{\"mesh\":0,\"matrix\":[0,1,0,0,-1,0,0,0,0,0,1,0,7,8,9,1]}", { 7, 9, 9 } },
        { "{\"translation\":[1,0,0],\"children\":[1]},{\"mesh\":0,\"scale\":[2,2,2]}",
          { 3, 0, 0 } },
        { "{\"mesh\":0,\"scale\":[2,2,2]},{\"translation\":[1,0,0],\"children\":[0]}",
          { 3, 0, 0 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[600];
        start_triangle();
        snprintf(rest, sizeof(rest), MESH ",\"nodes\":[%s]", rows[i].nodes);
        struct scene *scene = scene_of(rest);
        expect_vertex(scene, 1, rows[i].p[0], rows[i].p[1], rows[i].p[2]);
        scene_free(scene);
    }
}

static void only_the_chosen_scene_is_shown(void **state)
{
    (void)state;
    static const char rest[] = MESH
        ",\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[9,0,0]}],"
        "\"scenes\":[{\"nodes\":[0]},{\"nodes\":[1]}],\"scene\":1";
    start_triangle();
    struct scene *scene = scene_of(rest);
    expect_vertex(scene, 0, 9, 0, 0);
    assert_int_equal(scene->triangle_count, 1);
    scene_free(scene);
    expect_note(rest, "2 scenes; this is number 1");
}

static void mirrored_meshes_keep_their_outside(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(MESH ",\"nodes\":[{\"mesh\":0,\"scale\":[-1,1,1]}]");
    assert_int_equal(scene->meshes[0].flags, MESH_FLIP_NORMAL);
    scene_free(scene);
    expect_note(MESH ",\"nodes\":[{\"mesh\":0,\"scale\":[0,1,1]}]", "scaled to nothing");
}

static void shared_meshes_stand_in_all_their_places(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(MESH
                                   ",\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[0,0,10]},"
                                   "{\"mesh\":0,\"translation\":[0,0,20]}]");
    EXPECT_NEAR(scene->settings.bounds_max[2] + scene->settings.center[2], 20, 1e-5);
    EXPECT_NEAR(scene->settings.bounds_min[2] + scene->settings.center[2], 0, 1e-5);
    assert_int_equal(scene->triangle_count, 1);
    assert_int_equal(scene->instance_count, 3);
    scene_free(scene);

    /* What emits is copied, so that each light knows where it is */
    scene = scene_of("\"materials\":[{\"emissiveFactor\":[1,1,1]}],\"meshes\":[{\"primitives\":["
                     "{\"material\":0,\"attributes\":{\"POSITION\":0}}]}],\"nodes\":"
                     "[{\"mesh\":0},{\"mesh\":0,\"translation\":[0,0,10]}]");
    assert_int_equal(scene->light_count, 2);
    scene_free(scene);

    /* The same by EXT_mesh_gpu_instancing */
    static const float moves[6] = { 0, 0, 3, 0, 0, 8 };
    unsigned list = add_floats(moves, 2, 3);
    char rest[400];
    snprintf(rest, sizeof(rest),
             MESH ",\"nodes\":[{\"mesh\":0,\"extensions\":{\"EXT_mesh_gpu_instancing\":"
                  "{\"attributes\":{\"TRANSLATION\":%u}}}}]",
             list);
    scene = scene_of(rest);
    EXPECT_NEAR(scene->settings.bounds_min[2] + scene->settings.center[2], 3, 1e-5);
    EXPECT_NEAR(scene->settings.bounds_max[2] + scene->settings.center[2], 8, 1e-5);
    scene_free(scene);
}

/* --- Meshes ------------------------------------------------------------------------------- */

static void strips_fans_and_lists_become_triangles(void **state)
{
    (void)state;
    static const float five[15] = { 0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0, 0, 2, 0 };
    static const uint8_t bytes[6] = { 2, 0, 1, 3, 2, 1 };
    static const struct {
        const char *more;
        uint32_t count, corners[9];
    } rows[] = {
        { ",\"mode\":5", 3, { 0, 1, 2, 1, 3, 2, 2, 3, 4 } },
        { ",\"mode\":6", 3, { 0, 1, 2, 0, 2, 3, 0, 3, 4 } },
        { "", 1, { 0, 1, 2 } },
        { ",\"indices\":1", 2, { 2, 0, 1, 3, 2, 1 } },
        { ",\"indices\":1,\"mode\":4", 2, { 2, 0, 1, 3, 2, 1 } },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[400];
        start();
        add_floats(five, 5, 3);
        add(bytes, 6, 5121, 6, "SCALAR", "");
        snprintf(rest, sizeof(rest),
                 SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0}%s}]}]",
                 rows[i].more);
        struct scene *scene = scene_of(rest);
        assert_int_equal(scene->triangle_count, rows[i].count);
        assert_memory_equal(scene->triangles, rows[i].corners, 12 * rows[i].count);
        scene_free(scene);
    }
}

static void points_and_lines_are_left_out_and_said(void **state)
{
    (void)state;
    start_triangle();
    expect_note(SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":1},"
                     "{\"attributes\":{\"POSITION\":0},\"mode\":0}]}]",
                "points and lines are left out (2 times)");
}

static void accessors_may_be_interleaved_normalised_and_sparse(void **state)
{
    (void)state;
    /* Interleaved: position, then four bytes of something else */
    static const float with_gaps[12] = { 0, 0, 0, -1, 1, 0, 0, -1, 0, 1, 0, -1 };
    start();
    add(with_gaps, sizeof(with_gaps), 5126, 3, "VEC3", "");
    char *stride = strstr(made.views, "}");
    snprintf(stride, 40, ",\"byteStride\":16}");
    struct scene *scene = scene_of(MESH "," SHOW);
    expect_vertex(scene, 2, 0, 1, 0);
    scene_free(scene);

    /* 16-bit positions that stand for fractions, as KHR_mesh_quantization has them */
    static const int16_t fractions[12] = { 0, 0, 0, 0, 32767, 0, 0, 0, 0, -32768, 0, 0 };
    start();
    add(fractions, sizeof(fractions), 5122, 3, "VEC3", ",\"normalized\":true");
    stride = strstr(made.views, "}");
    snprintf(stride, 40, ",\"byteStride\":8}");
    scene = scene_of("\"extensionsRequired\":[\"KHR_mesh_quantization\"]," MESH "," SHOW);
    expect_vertex(scene, 1, 1, 0, 0);
    expect_vertex(scene, 2, 0, -1, 0);
    scene_free(scene);

    /* Zeros, with the second and third element replaced */
    static const uint16_t which[2] = { 1, 2 };
    static const float what[6] = { 4, 0, 0, 0, 5, 0 };
    start();
    add(which, sizeof(which), 5123, 2, "SCALAR", "");
    add(what, sizeof(what), 5126, 2, "VEC3", "");
    size_t length = strlen(made.accessors);
    snprintf(made.accessors + length, sizeof(made.accessors) - length,
             ",{\"componentType\":5126,\"count\":3,\"type\":\"VEC3\",\"sparse\":{\"count\":2,"
             "\"indices\":{\"bufferView\":0,\"componentType\":5123},"
             "\"values\":{\"bufferView\":1}}}");
    scene = scene_of(SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":2}}]}]");
    expect_vertex(scene, 0, 0, 0, 0);
    expect_vertex(scene, 1, 4, 0, 0);
    expect_vertex(scene, 2, 0, 5, 0);
    scene_free(scene);
}

static void vertex_colours_tint_the_base_colour(void **state)
{
    (void)state;
    static const uint8_t rgb[12] = { 255, 0, 0, 0, 0, 255, 0, 0, 51, 0, 255, 0 };
    start_triangle();
    add(rgb, sizeof(rgb), 5121, 3, "VEC3", ",\"normalized\":true");
    char *stride = strstr(strstr(made.views, "},") + 2, "}");
    snprintf(stride, 40, ",\"byteStride\":4}");
    static const char rest[] = SHOW
        ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,0.5,1,1],"
        "\"metallicFactor\":0}}],\"meshes\":[{\"primitives\":[{\"material\":0,"
        "\"attributes\":{\"POSITION\":0,\"COLOR_0\":1}}]}]";
    struct scene *scene = scene_of(rest);
    assert_true(scene->meshes[0].flags & MESH_COLORS);
    const float want[12] = { 1, 0, 0, 1, 0, 1, 0, 1, 0.2f, 0, 1, 1 };
    assert_memory_equal(scene->colors, want, sizeof(want));
    uint32_t top = scene->materials[0].texture[SLOT_REFLECTANCE];
    assert_int_not_equal(top, 0);
    assert_int_equal(scene->textures[top - 1].kind, TEXTURE_SCALE);
    EXPECT_NEAR(scene->textures[top - 1].value[1][1], 0.5, 0);
    uint32_t child = scene->textures[top - 1].child[0];
    assert_int_equal(scene->textures[child - 1].kind, TEXTURE_VERTEX_COLOR);
    scene_free(scene);

    /* Copies of what emits, one for each place, have them too */
    static const char twice[] =
        "\"nodes\":[{\"mesh\":0},{\"mesh\":0,\"translation\":[0,0,10]}],"
        "\"materials\":[{\"emissiveFactor\":[1,1,1]}],\"meshes\":[{\"primitives\":[{\"material\":0,"
        "\"attributes\":{\"POSITION\":0,\"COLOR_0\":1}}]}]";
    scene = scene_of(twice);
    assert_int_equal(scene->mesh_count, 2);
    for (uint32_t i = 0; i < 2; i++) {
        const struct mesh *mesh = &scene->meshes[i];
        assert_true(mesh->flags & MESH_COLORS);
        uint32_t first = mesh->first_vertex + mesh->color_shift;
        assert_memory_equal(scene->colors + 4 * (size_t)first, want, sizeof(want));
    }
    scene_free(scene);
}

/* --- Materials ---------------------------------------------------------------------------- */

#define WITH_MATERIAL(text)                                                          \
    SHOW ",\"materials\":[{" text "}],\"meshes\":[{\"primitives\":[{\"material\":0," \
         "\"attributes\":{\"POSITION\":0,\"TEXCOORD_0\":1}}]}],"                     \
         "\"textures\":[{\"source\":0,\"sampler\":0}],"                              \
         "\"samplers\":[{\"wrapS\":33071,\"wrapT\":33648,\"magFilter\":9728}],"      \
         "\"images\":[{\"uri\":\"data:image/png;base64," PNG_2X2 "\"}]"

/* The triangle with texture coordinates */
static void start_textured(void)
{
    static const float uvs[6] = { 0, 0, 1, 0, 0, 0.25f };
    start_triangle();
    add_floats(uvs, 3, 2);
}

static const struct material *material_of(const struct scene *scene)
{
    return &scene->materials[scene->meshes[0].material];
}

static void metalness_chooses_between_coat_metal_and_a_mix(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        uint32_t kind;
        double alpha;
    } rows[] = {
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.5}", MATERIAL_COAT,
          0.25 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":1,\"roughnessFactor\":0.2}",
          MATERIAL_CONDUCTOR, 0.04 },
        { "\"pbrMetallicRoughness\":{\"roughnessFactor\":0.01}", MATERIAL_CONDUCTOR, 0 },
        { "\"name\":\"all defaults\"", MATERIAL_CONDUCTOR, 1 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0.25}", MATERIAL_MIX, 0 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":"
          "{\"KHR_materials_unlit\":{}}",
          MATERIAL_UNLIT, 0 },
        { "\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":"
          "{\"KHR_materials_specular\":{\"specularFactor\":0}}",
          MATERIAL_DIFFUSE, 0 },
        { "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":{\"specularFactor\":[0,0,0],"
          "\"glossinessFactor\":0.5}}",
          MATERIAL_COAT, 0.25 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest), WITH_MATERIAL("%s"), rows[i].text);
        struct scene *scene = scene_of(rest);
        assert_int_equal(material_of(scene)->kind, rows[i].kind);
        EXPECT_NEAR(material_of(scene)->alpha[0], rows[i].alpha, 1e-7);
        if (rows[i].kind == MATERIAL_MIX) {
            EXPECT_NEAR(material_of(scene)->mix_amount, 0.25, 0);
            const uint32_t *mix = material_of(scene)->mix;
            assert_int_equal(scene->materials[mix[0]].kind, MATERIAL_COAT);
            assert_int_equal(scene->materials[mix[1]].kind, MATERIAL_CONDUCTOR);
        }
        scene_free(scene);
    }
}

static void a_metal_reflects_its_base_colour(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"baseColorFactor\":[0.25,0.5,0.9,1]}"));
    const struct material *metal = material_of(scene);
    assert_true(metal->flags & MATERIAL_METAL);
    for (unsigned c = 0; c < 3; c++) {
        double n = metal->eta[c], k2 = (double)metal->k[c] * metal->k[c];
        EXPECT_NEAR(((n - 1) * (n - 1) + k2) / ((n + 1) * (n + 1) + k2), metal->reflectance[c],
                    1e-6);
    }
    EXPECT_NEAR(metal->reflectance[1], 0.5, 0);
    scene_free(scene);
}

static void glass_is_thin_without_a_volume_and_tinted(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0,"
                      "\"baseColorFactor\":[1,0.5,0.25,1]},\"extensions\":{"
                      "\"KHR_materials_transmission\":{\"transmissionFactor\":1}}"));
    assert_int_equal(material_of(scene)->kind, MATERIAL_THIN_DIELECTRIC);
    assert_int_equal(material_of(scene)->flags, MATERIAL_TINTED);
    EXPECT_NEAR(material_of(scene)->specular[2], 0.25, 0);
    EXPECT_NEAR(material_of(scene)->ior, 1.5, 1e-6);
    scene_free(scene);
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"roughnessFactor\":0.5},"
                      "\"extensions\":{\"KHR_materials_transmission\":"
                      "{\"transmissionFactor\":0.75},\"KHR_materials_volume\":"
                      "{\"thicknessFactor\":0.1}}"));
    const struct material *mix = material_of(scene);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    EXPECT_NEAR(mix->mix_amount, 0.75, 0);
    assert_int_equal(scene->materials[mix->mix[0]].kind, MATERIAL_COAT);
    assert_int_equal(scene->materials[mix->mix[1]].kind, MATERIAL_DIELECTRIC);
    EXPECT_NEAR(scene->materials[mix->mix[1]].alpha[0], 0.25, 0);
    assert_int_equal(scene->medium_count, 0);
    scene_free(scene);
}

static void thick_glass_absorbs_on_the_way_through(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"extensions\":{\"KHR_materials_transmission\":{\"transmissionFactor\":1},"
                      "\"KHR_materials_volume\":{\"thicknessFactor\":0.1,"
                      "\"attenuationDistance\":2,\"attenuationColor\":[1,0.5,0]}},"
                      "\"pbrMetallicRoughness\":{\"metallicFactor\":0}"));
    assert_int_equal(scene->medium_count, 1);
    assert_int_equal(scene->meshes[0].inside, 1);
    assert_int_equal(scene->meshes[0].outside, 0);
    EXPECT_NEAR(scene->media[0].sigma_a[0], 0, 0);
    EXPECT_NEAR(scene->media[0].sigma_a[1], log(2) / 2, 1e-6);
    EXPECT_NEAR(scene->media[0].sigma_a[2], log(1e6) / 2, 1e-5);
    scene_free(scene);
}

static void clear_coats_lie_over_their_share(void **state)
{
    (void)state;
    static const struct {
        const char *metallic;
        uint32_t kind;
    } rows[] = { { "0", MATERIAL_COAT }, { "1", MATERIAL_COATED_CONDUCTOR } };
    for (int i = 0; i < 2; i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest),
                 WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":%s,"
                               "\"roughnessFactor\":0.5},\"extensions\":{"
                               "\"KHR_materials_clearcoat\":{\"clearcoatFactor\":0.5,"
                               "\"clearcoatRoughnessFactor\":0.2}}"),
                 rows[i].metallic);
        struct scene *scene = scene_of(rest);
        const struct material *mix = material_of(scene);
        assert_int_equal(mix->kind, MATERIAL_MIX);
        EXPECT_NEAR(mix->mix_amount, 0.5, 0);
        const struct material *coated = &scene->materials[mix->mix[1]];
        assert_int_equal(coated->kind, rows[i].kind);
        EXPECT_NEAR(coated->alpha[0], 0.04, 1e-7);
        EXPECT_NEAR(coated->base_alpha[0], i == 1 ? 0.25 : 0, 0);
        EXPECT_NEAR(scene->materials[mix->mix[0]].alpha[0], 0.25, 0);
        scene_free(scene);
    }
}

static void a_sheen_lies_over_every_part_of_a_material(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0.25},\"extensions\":{"
                      "\"KHR_materials_sheen\":{\"sheenColorFactor\":[0.5,0.25,1],"
                      "\"sheenRoughnessFactor\":0.5}}"));
    const struct material *mix = material_of(scene);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    assert_false(mix->flags & MATERIAL_SHEEN);
    for (int i = 0; i < 2; i++) {
        const struct material *part = &scene->materials[mix->mix[i]];
        assert_true(part->flags & MATERIAL_SHEEN);
        EXPECT_NEAR(part->sheen[0], 0.5, 0);
        EXPECT_NEAR(part->sheen[1], 0.25, 0);
        EXPECT_NEAR(part->sheen[2], 1, 0);
        EXPECT_NEAR(part->sheen_alpha, 0.25, 0);
        assert_int_equal(part->sheen_table, scene->materials[mix->mix[0]].sheen_table);
        assert_true(part->coat_table < part->sheen_table ||
                    part->coat_table >= part->sheen_table + SHEEN_ROWS ||
                    part->kind == MATERIAL_CONDUCTOR);
    }
    assert_true(scene->settings.effects & FX_SHEEN);
    /* At the width of a row, straight from above and from the side, fibres send little and much */
    const float *rows = scene->coat_tables +
                        (size_t)scene->materials[mix->mix[0]].sheen_table * COAT_TABLE_LEN;
    const float *half = rows + (45 - SHEEN_FIRST) * COAT_TABLE_LEN; /* (45 / 64)^2 = .494 */
    assert_true(half[COAT_TABLE_LEN - 1] < 0.05f && half[8] > 0.75f && half[8] < 0.85f);
    scene_free(scene);

    /* Colours are sRGB, roughness is an alpha of its own square; both with their factors */
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":{"
                      "\"KHR_materials_sheen\":{\"sheenColorFactor\":[0.5,0.25,1],"
                      "\"sheenRoughnessFactor\":0.5,\"sheenColorTexture\":{\"index\":0},"
                      "\"sheenRoughnessTexture\":{\"index\":0}}}"));
    const struct material *cloth = material_of(scene);
    const struct texture *color = &scene->textures[cloth->texture[SLOT_SHEEN] - 1];
    assert_int_equal(color->kind, TEXTURE_SCALE);
    EXPECT_NEAR(color->value[1][1], 0.25, 0);
    const struct texture *image = &scene->textures[color->child[0] - 1];
    assert_int_equal(scene->pictures[image->picture].texel, TEXEL_U8_SRGB);
    assert_int_equal(image->channel, SCENE_NONE);
    const struct texture *square = &scene->textures[cloth->texture[SLOT_SHEEN_ALPHA] - 1];
    assert_int_equal(square->child[0], square->child[1]);
    const struct texture *rough = &scene->textures[square->child[0] - 1];
    EXPECT_NEAR(rough->value[1][0], 0.5, 0);
    image = &scene->textures[rough->child[0] - 1];
    assert_int_equal(image->channel, 3);
    assert_int_equal(scene->pictures[image->picture].texel, TEXEL_U8);
    scene_free(scene);

    static const char *const none[] = { "\"KHR_materials_sheen\":{\"sheenRoughnessFactor\":1}",
                                        "\"KHR_materials_unlit\":{},\"KHR_materials_sheen\":{"
                                        "\"sheenColorFactor\":[1,1,1]}" };
    for (int i = 0; i < 2; i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest),
                 WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},"
                               "\"extensions\":{%s}"),
                 none[i]);
        scene = scene_of(rest);
        assert_false(material_of(scene)->flags & MATERIAL_SHEEN);
        assert_false(scene->settings.effects & FX_SHEEN);
        scene_free(scene);
    }
    start_textured();
    scene = scene_of(WITH_MATERIAL("\"extensions\":{\"KHR_materials_sheen\":{"
                                   "\"sheenColorFactor\":[1,1,1]}}"));
    EXPECT_NEAR(material_of(scene)->sheen_alpha, SHEEN_ALPHA_LEAST, 0);
    scene_free(scene);
}

static void the_index_and_specular_decide_what_a_dielectric_reflects(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":{"
                      "\"KHR_materials_ior\":{\"ior\":2}}"));
    EXPECT_NEAR(material_of(scene)->ior, 2, 1e-6);
    scene_free(scene);
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0},\"extensions\":{"
                      "\"KHR_materials_specular\":{\"specularFactor\":0.25}}"));
    double root = (material_of(scene)->ior - 1) / (material_of(scene)->ior + 1);
    EXPECT_NEAR(root * root, 0.04 * 0.25, 1e-6);
    scene_free(scene);
}

static void textures_are_placed_as_gltf_places_them(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"baseColorTexture\":"
                      "{\"index\":0}}"));
    EXPECT_NEAR(scene->uvs[1], 1, 0); /* v upwards */
    EXPECT_NEAR(scene->uvs[5], 0.75, 0);
    const struct texture *image =
        &scene->textures[material_of(scene)->texture[SLOT_REFLECTANCE] - 1];
    assert_int_equal(image->kind, TEXTURE_IMAGE);
    assert_int_equal(image->channel, SCENE_NONE);
    assert_int_equal(image->wrap[0], WRAP_CLAMP);
    assert_int_equal(image->wrap[1], WRAP_MIRROR);
    assert_true(image->flags & TEXTURE_NEAREST);
    const float plain[6] = { 1, 0, 0, 0, 1, 0 };
    for (int i = 0; i < 6; i++)
        EXPECT_NEAR(image->map[i], plain[i], 1e-6);
    assert_int_equal(scene->pictures[image->picture].texel, TEXEL_U8_SRGB);
    scene_free(scene);

    /* Scale by (2, 3), turn by 90 degrees, move by (.1, .2): u' = 3 v + .1, v' = -2 u + .2 */
    scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"metallicFactor\":0,\"baseColorTexture\":"
                      "{\"index\":0,\"extensions\":{\"KHR_texture_transform\":{\"scale\":[2,3],"
                      "\"rotation\":1.5707963267948966,\"offset\":[0.1,0.2]}}}}"));
    image = &scene->textures[material_of(scene)->texture[SLOT_REFLECTANCE] - 1];
    double u = 0.3, v = 0.4; /* glTF's */
    EXPECT_NEAR(image->map[0] * u + image->map[1] * (1 - v) + image->map[2], 3 * v + 0.1, 1e-6);
    EXPECT_NEAR(image->map[3] * u + image->map[4] * (1 - v) + image->map[5], 1 - (-2 * u + 0.2),
                1e-6);
    scene_free(scene);
}

static void metalness_and_roughness_come_from_their_channels(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"pbrMetallicRoughness\":{\"roughnessFactor\":0.5,"
                      "\"metallicRoughnessTexture\":{\"index\":0}},"
                      "\"normalTexture\":{\"index\":0,\"scale\":0.5}"));
    const struct material *mix = material_of(scene);
    assert_int_equal(mix->kind, MATERIAL_MIX);
    assert_int_equal(scene->textures[mix->texture[SLOT_AMOUNT] - 1].channel, 2);
    for (int i = 0; i < 2; i++) {
        const struct material *part = &scene->materials[mix->mix[i]];
        /* Its own square: (0.5 green) (0.5 green) */
        const struct texture *square = &scene->textures[part->texture[SLOT_ROUGHNESS_U] - 1];
        assert_int_equal(square->kind, TEXTURE_SCALE);
        assert_int_equal(square->child[0], square->child[1]);
        const struct texture *half = &scene->textures[square->child[0] - 1];
        EXPECT_NEAR(half->value[1][0], 0.5, 0);
        assert_int_equal(scene->textures[half->child[0] - 1].channel, 1);
        assert_int_equal(part->texture[SLOT_ROUGHNESS_V], part->texture[SLOT_ROUGHNESS_U]);
        assert_int_not_equal(part->texture[SLOT_NORMAL], 0);
        EXPECT_NEAR(part->normal_scale, 0.5, 0);
        assert_true(part->flags & MATERIAL_NORMAL_SCALED);
    }
    for (uint32_t i = 0; i < scene->picture_count; i++)
        assert_int_equal(scene->pictures[i].texel, TEXEL_U8);
    assert_int_equal(scene->picture_count, 1);
    scene_free(scene);
}

static void alpha_modes_cut_holes(void **state)
{
    (void)state;
    static const struct {
        const char *text;
        int kind; /* of the texture; -1 for none */
        double value;
    } rows[] = {
        { "\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.5]}", -1, 0 },
        { "\"alphaMode\":\"OPAQUE\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
          -1, 0 },
        { "\"alphaMode\":\"BLEND\"", -1, 0 },
        { "\"alphaMode\":\"BLEND\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.25]}",
          TEXTURE_CONSTANT, 0.25 },
        { "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.25]}",
          TEXTURE_CONSTANT, 0 },
        { "\"alphaMode\":\"MASK\",\"pbrMetallicRoughness\":{\"baseColorFactor\":[1,1,1,0.5]}", -1,
          0 },
        { "\"alphaMode\":\"BLEND\",\"pbrMetallicRoughness\":{\"baseColorTexture\":{\"index\":0}}",
          TEXTURE_IMAGE, 0 },
        { "\"alphaMode\":\"MASK\",\"alphaCutoff\":0.3,\"pbrMetallicRoughness\":"
          "{\"baseColorTexture\":{\"index\":0}}",
          TEXTURE_STEP, 0 },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest), WITH_MATERIAL("%s"), rows[i].text);
        struct scene *scene = scene_of(rest);
        uint32_t alpha = scene->meshes[0].alpha;
        assert_int_equal(alpha != 0, rows[i].kind >= 0);
        const struct texture *texture = alpha != 0 ? &scene->textures[alpha - 1] : NULL;
        if (texture != NULL) {
            assert_int_equal(texture->kind, rows[i].kind);
            EXPECT_NEAR(texture->value[0][0], rows[i].value, 0);
        }
        if (rows[i].kind == TEXTURE_IMAGE)
            assert_int_equal(texture->channel, 3);
        if (rows[i].kind == TEXTURE_STEP)
            EXPECT_NEAR(texture->value[1][0], 0.3, 1e-7);
        scene_free(scene);
    }
}

static void emissive_surfaces_are_lights(void **state)
{
    (void)state;
    start_textured();
    struct scene *scene = scene_of(
        WITH_MATERIAL("\"emissiveFactor\":[1,0.5,0.25],\"doubleSided\":true,\"extensions\":"
                      "{\"KHR_materials_emissive_strength\":{\"emissiveStrength\":8}}"));
    assert_int_equal(scene->light_count, 1);
    assert_int_equal(scene->lights[0].kind, LIGHT_POLYGON);
    assert_int_equal(scene->lights[0].flags, LIGHT_TWO_SIDED);
    EXPECT_NEAR(scene->lights[0].radiance[0], 8, 0);
    EXPECT_NEAR(scene->lights[0].radiance[2], 2, 0);
    scene_free(scene);

    /* A picture: what it shows, times the factor, and about its mean */
    scene = scene_of(WITH_MATERIAL("\"emissiveFactor\":[0.5,1,1],\"emissiveTexture\":{\"index\":0},"
                                   "\"extensions\":{\"KHR_materials_emissive_strength\":"
                                   "{\"emissiveStrength\":4}}"));
    const struct light *light = &scene->lights[0];
    assert_int_equal(light->flags, 0);
    EXPECT_NEAR(light->texture_scale, 1, 0);
    const struct texture *product = &scene->textures[light->texture - 1];
    assert_int_equal(product->kind, TEXTURE_SCALE);
    assert_int_equal(scene->textures[product->child[0] - 1].kind, TEXTURE_IMAGE);
    EXPECT_NEAR(product->value[1][0], 2, 0);
    EXPECT_NEAR(product->value[1][1], 4, 0);
    EXPECT_NEAR(light->radiance[0], 1, 1);
    EXPECT_NEAR(light->radiance[1], 2, 2);
    scene_free(scene);

    /* What is unlit shows itself and emits nothing */
    scene = scene_of(WITH_MATERIAL("\"emissiveFactor\":[1,1,1],\"extensions\":"
                                   "{\"KHR_materials_unlit\":{}}"));
    assert_int_equal(scene->meshes[0].first_emissive, SCENE_NONE);
    scene_free(scene);
}

static void what_is_approximated_is_said_and_counted(void **state)
{
    (void)state;
    static const char *const rows[][2] = {
        { "\"extensions\":{\"KHR_materials_clearcoat\":{\"clearcoatFactor\":1},"
          "\"KHR_materials_sheen\":{\"sheenColorFactor\":[1,1,1]}}",
          "a sheen lies on a clear coat" },
        { "\"extensions\":{\"KHR_materials_iridescence\":{}}", "iridescence is left out" },
        { "\"extensions\":{\"KHR_materials_unlit\":{}}", "seen by the camera and in mirrors" },
        { "\"occlusionTexture\":{\"index\":0}", "occlusion textures are not used" },
        { "\"extensions\":{\"KHR_materials_specular\":{\"specularFactor\":0.5}}",
          "another index of refraction" },
        { "\"extensions\":{\"KHR_materials_volume\":{\"attenuationDistance\":1}}",
          "what is inside of glass is clear" },
        { "\"normalTexture\":{\"index\":0},\"emissiveFactor\":[1,1,1],"
          "\"emissiveTexture\":{\"index\":0,\"texCoord\":1}",
          "second set of texture coordinates" },
        { "\"extensions\":{\"KHR_materials_pbrSpecularGlossiness\":{}}",
          "turned into metallic-roughness" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char rest[2000];
        start_textured();
        snprintf(rest, sizeof(rest), WITH_MATERIAL("%s"), rows[i][0]);
        expect_note(rest, rows[i][1]);
    }
    start_triangle();
    expect_note(MESH "," SHOW, "there is no light: a sky of radiance 1");
    expect_note(MESH "," SHOW, "there is no camera");
    expect_note(MESH "," SHOW ",\"animations\":[{}]", "animations are not played");
    expect_note(MESH "," SHOW ",\"extensionsUsed\":[\"ABC_new\",\"KHR_materials_ior\"]",
                "extensionsUsed: left out, as the file allows: ABC_new");
    expect_note(MESH ",\"nodes\":[{\"mesh\":0,\"skin\":0}]", "skins are not applied");
}

/* --- Lights and cameras ------------------------------------------------------------------- */

#define LIGHT_NODE                                                        \
    ",{\"translation\":[1,2,3],\"rotation\":[0,0.70710678,0,0.70710678]," \
    "\"extensions\":{\"KHR_lights_punctual\":{\"light\":0}}}"
#define WITH_LIGHT(text)                                            \
    MESH ",\"nodes\":[{\"mesh\":0}" LIGHT_NODE "],\"extensions\":{" \
         "\"KHR_lights_punctual\":{\"lights\":[" text "]}}"

static void lights_are_where_and_as_bright_as_they_say(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(
        WITH_LIGHT("{\"type\":\"spot\",\"color\":[1,0.5,0],\"intensity\":40,"
                   "\"spot\":{\"innerConeAngle\":0.5,\"outerConeAngle\":0.7}}"));
    assert_int_equal(scene->light_count, 1);
    const struct light *light = &scene->lights[0];
    assert_int_equal(light->kind, LIGHT_SPOT);
    EXPECT_NEAR(light->radiance[0], 40, 0);
    EXPECT_NEAR(light->radiance[1], 20, 0);
    EXPECT_NEAR(light->position[2] + scene->settings.center[2], 3, 1e-6);
    EXPECT_NEAR(light->direction[0], -1, 1e-6); /* -z, turned by 90 degrees about y */
    EXPECT_NEAR(light->cos_falloff_start, cos(0.5), 1e-6);
    EXPECT_NEAR(light->cos_falloff_end, cos(0.7), 1e-6);
    EXPECT_NEAR(scene->settings.sky[0], 0, 0);
    scene_free(scene);

    scene = scene_of(WITH_LIGHT("{\"type\":\"point\"}"));
    assert_int_equal(scene->lights[0].kind, LIGHT_POINT);
    EXPECT_NEAR(scene->lights[0].radiance[0], 1, 0);
    scene_free(scene);

    /* Blender wrote 683 lm for its W */
    const char *text = document_of(WITH_LIGHT("{\"type\":\"directional\",\"intensity\":1366}"),
                                   ",\"generator\":\"Khronos glTF Blender I/O v4.3.32\"");
    scene = gltf_read_bytes(text, strlen(text), NULL, NULL, NULL, NULL);
    assert_non_null(scene);
    assert_int_equal(scene->lights[0].kind, LIGHT_DISTANT);
    EXPECT_NEAR(scene->lights[0].radiance[0], 2, 1e-6);
    scene_free(scene);
}

static void cameras_are_chosen_by_name(void **state)
{
    (void)state;
    static const char rest[] = MESH
        ",\"nodes\":[{\"mesh\":0},{\"name\":\"Front\",\"camera\":0,\"translation\":[0,0,9],"
        "\"scale\":[2,3,4]},{\"name\":\"Top\",\"camera\":1,\"rotation\":"
        "[-0.70710678,0,0,0.70710678]}],\"cameras\":[{\"type\":\"perspective\","
        "\"perspective\":{\"yfov\":1,\"aspectRatio\":1.5,\"znear\":0.1}},{\"name\":\"Flat\","
        "\"type\":\"orthographic\",\"orthographic\":{\"xmag\":2,\"ymag\":4,\"zfar\":9,"
        "\"znear\":0}}]";
    start_triangle();
    struct scene *scene = scene_of(rest);
    const struct scene_settings *s = &scene->settings;
    assert_int_equal(s->width, 1080);
    assert_int_equal(s->height, 720);
    assert_int_equal(s->camera.kind, CAMERA_PERSPECTIVE);
    EXPECT_NEAR(s->camera.screen[3], tan(0.5), 1e-6);
    EXPECT_NEAR(s->camera.screen[0], -1.5 * tan(0.5), 1e-6);
    EXPECT_NEAR(s->camera.position[2] + s->center[2], 9, 1e-6);
    EXPECT_NEAR(s->camera.forward[2], -1, 1e-6);
    EXPECT_NEAR(s->camera.right[0], 1, 1e-6);
    scene_free(scene);
    expect_note(rest, "camera \"Front\" of \"Front\", \"Top\"");

    static const char *const names[] = { "Top", "Flat", "1" };
    for (int i = 0; i < 3; i++) {
        const struct gltf_options options = { .camera = names[i] };
        scene = read_document(rest, &options, NULL, NULL);
        assert_non_null(scene);
        s = &scene->settings;
        assert_int_equal(s->camera.kind, CAMERA_ORTHOGRAPHIC);
        assert_int_equal(s->width, 360);
        EXPECT_NEAR(s->camera.screen[1], 2, 1e-6);
        EXPECT_NEAR(s->camera.screen[3], 4, 1e-6);
        EXPECT_NEAR(s->camera.forward[1], -1, 1e-6);
        EXPECT_NEAR(s->camera.up[2], -1, 1e-6);
        scene_free(scene);
    }
    const struct gltf_options wrong = { .camera = "Back" };
    struct err err;
    assert_null(read_document(rest, &wrong, NULL, &err));
    assert_non_null(strstr(err.text, "no camera \"Back\"; there are \"Front\", \"Top\""));
}

static void without_a_camera_everything_is_in_the_picture(void **state)
{
    (void)state;
    start_triangle();
    struct scene *scene = scene_of(
        MESH ",\"nodes\":[{\"mesh\":0,\"translation\":[1e4,0,0],\"scale\":[3,100,1]}]");
    const struct camera *camera = &scene->settings.camera;
    for (uint32_t i = 0; i < 3; i++) {
        double x = 0, y = 0, z = 0;
        for (unsigned axis = 0; axis < 3; axis++) {
            double way = (double)scene->positions[3 * i + axis] - camera->position[axis];
            x += way * camera->right[axis];
            y += way * camera->up[axis];
            z += way * camera->forward[axis];
        }
        assert_true(z > 0);
        assert_true(fabs(x / z) < camera->screen[1] && fabs(y / z) < camera->screen[3]);
    }
    scene_free(scene);
}

/* --- Files -------------------------------------------------------------------------------- */

static void put_u32(unsigned char *bytes, uint32_t value)
{
    memcpy(bytes, &value, 4);
}

/* A GLB of the triangle; returns its size */
static size_t make_glb(unsigned char *glb)
{
    char text[600];
    size_t length = (size_t)snprintf(
        text, sizeof(text),
        "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":36}],"
        "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"accessors\":[{\"bufferView\":0,"
        "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}]," MESH "," SHOW "}");
    while (length % 4 != 0)
        text[length++] = ' ';
    memcpy(glb, "glTF", 4);
    put_u32(glb + 4, 2);
    put_u32(glb + 8, (uint32_t)(12 + 8 + length + 8 + 36));
    put_u32(glb + 12, (uint32_t)length);
    memcpy(glb + 16, "JSON", 4);
    memcpy(glb + 20, text, length);
    put_u32(glb + 20 + length, 36);
    memcpy(glb + 24 + length, "BIN", 4);
    memcpy(glb + 28 + length, corner, 36);
    return 28 + length + 36;
}

static void binary_files_are_read_whole_or_not_at_all(void **state)
{
    (void)state;
    unsigned char glb[1000];
    size_t size = make_glb(glb);
    struct scene *scene = gltf_read_bytes(glb, size, NULL, NULL, NULL, NULL);
    assert_non_null(scene);
    assert_int_equal(scene->triangle_count, 1);
    scene_free(scene);
    for (size_t cut = 0; cut < size; cut++) {
        struct err err = { .text = "" };
        unsigned char *exact = malloc(cut + 1);
        memcpy(exact, glb, cut);
        assert_null(gltf_read_bytes(exact, cut, "x.glb", NULL, NULL, &err));
        assert_memory_equal(err.text, "x.glb:", 6);
        free(exact);
    }
    /* Every bit flipped: read or refused, never worse */
    for (size_t bit = 0; bit < 8 * size; bit++) {
        unsigned char *flipped = malloc(size);
        memcpy(flipped, glb, size);
        flipped[bit / 8] ^= (unsigned char)(1u << bit % 8);
        struct err err = { .code = ERR_OK };
        scene = gltf_read_bytes(flipped, size, NULL, NULL, NULL, &err);
        assert_true(scene != NULL || err.code != ERR_OK);
        scene_free(scene);
        free(flipped);
    }
}

#define ONE_BUFFER                                                                         \
    "{\"asset\":{\"version\":\"2.0\"},\"buffers\":[{\"byteLength\":36,\"uri\":\"%s\"}],"   \
    "\"bufferViews\":[{\"buffer\":0,\"byteLength\":36}],\"accessors\":[{\"bufferView\":0," \
    "\"componentType\":5126,\"count\":3,\"type\":\"VEC3\"}]," MESH "," SHOW "}"

static void other_files_are_found_by_relative_paths_only(void **state)
{
    (void)state;
    char folder[256], text[1000], absolute[700];
    scratch_make(folder);
    mkdir(scratch_path(folder, "inner"), 0700);
    scratch_write(scratch_path(folder, "a b\xc3\xa4.bin"), corner, sizeof(corner));
    scratch_write(scratch_path(folder, "short.bin"), corner, 35);
    mkfifo(scratch_path(folder, "pipe"), 0600);
    snprintf(absolute, sizeof(absolute), "%s/short.bin", folder);
    const struct {
        const char *uri, *error; /* NULL: good */
    } rows[] = {
        { "../a%20b%c3%A4.bin", NULL },
        { ".././a b\xc3\xa4.bin", NULL },
        { "../nothing.bin", "No such file" },
        { "../short.bin", "35 of 36 bytes" },
        { "../pipe", "not a regular file" },
        { "..", "not a regular file" },
        { "../../../../../../../../../../dev/zero", "not a regular file" },
        { absolute, "not a relative path" },
        { "%2Fetc/passwd", "not a relative path" },
        { "file:///etc/passwd", "not a relative path" },
        { "https://example.org/x.bin", "not a relative path" },
        { "..%00", "not a relative path" },
        { "x%4", "not a relative path" },
        { "", "not a relative path" },
        { "data:;base64,AAAA", "3 of 36 bytes" },
        { "data:base64,AAAA", "not base64" },
        { "data:a/b;base64,AAAA", "3 of 36 bytes" },
        { "data:a/b;base64,AA*A", "damaged at character 2" },
        { "data:a/b;base64,AAA", "damaged at character 3" },
        { "data:a/b;base64,A===", "damaged at character 1" },
        { "data:text/plain,AAAA", "not base64" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        int length = snprintf(text, sizeof(text), ONE_BUFFER, rows[i].uri);
        scratch_write(scratch_path(folder, "inner/s.gltf"), text, (size_t)length);
        struct scene *scene = gltf_read(scratch_path(folder, "inner/s.gltf"), NULL, NULL, &err);
        if (rows[i].error == NULL ? scene == NULL : strstr(err.text, rows[i].error) == NULL)
            fail_msg("%s: %s", rows[i].uri, err.text);
        scene_free(scene);
    }
    struct err err;
    snprintf(text, sizeof(text), ONE_BUFFER, "x.bin");
    assert_null(gltf_read_bytes(text, strlen(text), NULL, NULL, NULL, &err));
    assert_non_null(strstr(err.text, "no file can be read from here"));
    assert_null(gltf_read("/nowhere/s.gltf", NULL, NULL, &err));
    assert_string_equal(err.text, "/nowhere/s.gltf: No such file or directory");
    assert_true(gltf_is("a/B.GLTF") && gltf_is("x.glb") && !gltf_is("nowhere.pbrt"));
    scratch_write(scratch_path(folder, "odd"), " {", 2);
    assert_true(gltf_is(scratch_path(folder, "odd")));
    scratch_write(scratch_path(folder, "odd"), "Film", 4);
    assert_false(gltf_is(scratch_path(folder, "odd")));
    scratch_remove(folder);
}

static void broken_pictures_fail_or_are_left_out(void **state)
{
    (void)state;
    static const char rest[] = MESH
        "," SHOW ",\"materials\":[{\"pbrMetallicRoughness\":{\"baseColorTexture\":"
        "{\"index\":0}}}],\"textures\":[{\"source\":0}],\"images\":[{\"uri\":"
        "\"data:image/png;base64,AAAA\"}]";
    char text[1000];
    start_triangle();
    snprintf(text, sizeof(text), "%s", rest);
    char *material = strstr(text, "{\"attributes\"");
    memmove(material + 14, material + 1, strlen(material + 1) + 1);
    memcpy(material + 1, "\"material\":0,", 13);
    struct err err = { .text = "" };
    assert_null(read_document(text, NULL, NULL, &err));
    assert_non_null(strstr(err.text, "images[0]"));
    const struct gltf_options lenient = { .lenient = true };
    struct scene_notes notes;
    struct scene *scene = read_document(text, &lenient, &notes, &err);
    assert_non_null(scene);
    assert_int_equal(notes.warnings, 1);
    assert_true(notes_saying(&notes, "images[0]: this picture is not supported"));
    scene_notes_free(&notes);
    scene_free(scene);
}

/* --- What is wrong ------------------------------------------------------------------------ */

static void wrong_files_are_refused_with_a_reason(void **state)
{
    (void)state;
    static const struct {
        const char *rest, *error;
    } rows[] = {
        { SHOW, "there is no meshes[0]" },
        { MESH ",\"nodes\":[{\"mesh\":7}]", "nodes[0]: there is no meshes[7]" },
        { MESH ",\"nodes\":[{\"mesh\":-1}]", "\"mesh\" is not a whole number" },
        { MESH ",\"nodes\":[{\"mesh\":1e300}]", "\"mesh\" is not a whole number" },
        { MESH ",\"nodes\":[{\"mesh\":\"0\"}]", "\"mesh\" is not a whole number" },
        { MESH ",\"nodes\":[5]", "no nodes[0]" },
        { MESH ",\"nodes\":[{\"children\":[0]}],\"scenes\":[{\"nodes\":[0]}]",
          "nodes[0] is the child of two nodes, or of itself" },
        { MESH ",\"nodes\":[{\"children\":[1]},{\"children\":[0]}],\"scenes\":[{\"nodes\":[0]}]",
          "the child of two nodes" },
        { MESH ",\"nodes\":[{\"children\":[9]}]", "entry 0 of its list is no node" },
        { MESH ",\"nodes\":[{\"children\":{}}]", "\"children\" is not a list" },
        { MESH ",\"nodes\":[{\"matrix\":[1,2]}]", "\"matrix\" has 2 numbers" },
        { MESH ",\"nodes\":[{\"matrix\":[1,0,0,1,0,1,0,0,0,0,1,0,0,0,0,1]}]", "not affine" },
        { MESH ",\"nodes\":[{\"translation\":[1,2,1e40]}]", "1e+40" },
        { MESH ",\"nodes\":[{\"translation\":[1,2,null]}]", "not a number" },
        { MESH "," SHOW ",\"scene\":3", "there is no scenes[3]" },
        { SHOW ",\"meshes\":[{\"primitives\":[7]}]", "meshes[0].primitives[0]: this is not an" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"mode\":9}]}]",
          "there is no mode 9" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":8}}]}]",
          "there is no accessors[8]" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":1}}]}]",
          "1 numbers are no POSITION" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":0}]}]",
          "these are no indices" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"indices\":1}]}]",
          "index 3 (number 2) of 3 vertices" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0},\"material\":1}]}]",
          "there is no materials[1]" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":0,\"NORMAL\":2}}]}]",
          "1 NORMAL for 3 vertices" },
        { SHOW ",\"meshes\":[{\"primitives\":[{\"attributes\":{\"POSITION\":3}}]}]",
          "element 0 is nan" },
        { MESH "," SHOW ",\"extensionsRequired\":[\"KHR_materials_ior\",\"KHR_draco\",\"B\"]",
          "extensionsRequired: KHR_draco, B is not supported" },
        { MESH ",\"nodes\":[{\"camera\":0}],\"cameras\":[{\"type\":\"fish\"}]",
          "cameras[0]: there is no camera \"fish\"" },
        { MESH ",\"nodes\":[{\"camera\":0}],\"cameras\":[{\"type\":\"perspective\","
               "\"perspective\":{\"yfov\":4}}]",
          "\"yfov\" is 4" },
        { WITH_LIGHT("{\"type\":\"sun\"}"), "there is no light \"sun\"" },
        { WITH_LIGHT("{\"type\":\"spot\",\"spot\":{\"innerConeAngle\":1,"
                     "\"outerConeAngle\":0.5}}"),
          "cones of 1 and 0.5" },
        { WITH_LIGHT("{\"type\":\"point\",\"intensity\":-1}"), "\"intensity\" is -1" },
    };
    static const float one_normal[3] = { 0, 0, 1 }, nan_first[9] = { NAN };
    static const uint8_t three[3] = { 0, 1, 3 };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        start_triangle();
        add(three, 3, 5121, 3, "SCALAR", "");
        add_floats(one_normal, 1, 3);
        add_floats(nan_first, 3, 3);
        struct scene *scene = read_document(rows[i].rest, NULL, NULL, &err);
        if (scene != NULL || strstr(err.text, rows[i].error) == NULL)
            fail_msg("%s\nsaid: %s", rows[i].rest, scene != NULL ? "nothing" : err.text);
        assert_memory_equal(err.text, "glTF: ", 6);
    }
}

static void text_that_is_no_gltf_is_refused(void **state)
{
    (void)state;
    static const struct {
        const char *text, *error;
    } rows[] = {
        { "", "f.gltf:1:0: " },
        { "{\n  \"asset\": }", "f.gltf:2:" },
        { "[1]", "not an object" },
        { "{}", "\"version\" is missing" },
        { "{\"asset\":3}", "asset: this is not an object" },
        { "{\"asset\":{\"version\":\"1.0\"}}", "glTF 1.0; 2.0 is known" },
        { "{\"asset\":{\"version\":\"2.1\",\"minVersion\":\"2.1\"}}", "glTF 2.1" },
        { "{\"asset\":{\"version\":2}}", "not a text" },
        { "{\"asset\":{\"version\":\"2.0\"},\"accessors\":[{\"count\":3}]," MESH "," SHOW "}",
          "its type or its count" },
        { "{\"asset\":{\"version\":\"2.0\"},\"accessors\":[{\"count\":1e9,\"componentType\":5126,"
          "\"type\":\"VEC3\"}]," MESH "," SHOW "}",
          "far smaller than what it makes of its data" },
        { "{\"asset\":{\"version\":\"2.0\"},\"accessors\":[{\"count\":3,\"componentType\":5126,"
          "\"type\":\"VEC3\",\"bufferView\":0}]," MESH "," SHOW "}",
          "there is no bufferViews[0]" },
        { "{\"asset\":{\"version\":\"2.0\",\"x\":\"\\u001b\"},\"nodes\":[{\"camera\":0}],"
          "\"cameras\":[{\"type\":\"\\u001b[31m\"}]}",
          "no camera \"?[31m\"" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct err err = { .text = "" };
        assert_null(
            gltf_read_bytes(rows[i].text, strlen(rows[i].text), "f.gltf", NULL, NULL, &err));
        if (strstr(err.text, rows[i].error) == NULL || err.text[0] != 'f')
            fail_msg("%s\nsaid: %s", rows[i].text, err.text);
    }
}

/* `before`, then `piece` again and again */
static bool opens_repeated(const char *before, const char *piece, size_t count, const char *after,
                           struct err *err)
{
    size_t length = strlen(piece), head = strlen(before);
    char *text = malloc(head + count * length + strlen(after) + 1), *end = stpcpy(text, before);
    for (size_t i = 0; i < count; i++)
        end = stpcpy(end, piece);
    end = stpcpy(end, after);
    struct scene *scene = gltf_read_bytes(text, (size_t)(end - text), NULL, NULL, NULL, err);
    free(text);
    scene_free(scene);
    return scene != NULL;
}

static void small_files_cannot_ask_for_much(void **state)
{
    (void)state;
    struct err err = { .text = "" };
    assert_false(opens_repeated("", "[", 1000000, "", &err));
    assert_false(
        opens_repeated("{\"asset\":{\"version\":\"2.0\"},\"extras\":", "[", 3000, "", &err));
    assert_non_null(strstr(err.text, "depth"));
    assert_false(opens_repeated("{\"asset\":{\"version\":\"2.0\"},\"nodes\":[", "{},", 1000000,
                                "{}]}", &err));
    assert_non_null(strstr(err.text, "too many objects"));
    /* A deep chain of nodes is no problem */
    char *chain = malloc(3000000), *end = chain;
    end = stpcpy(end, "{\"asset\":{\"version\":\"2.0\"},\"nodes\":[");
    for (int i = 1; i < 100000; i++)
        end += sprintf(end, "{\"children\":[%d]},", i);
    end = stpcpy(end, "{}]}");
    struct scene *scene = gltf_read_bytes(chain, (size_t)(end - chain), NULL, NULL, NULL, &err);
    assert_non_null(scene);
    scene_free(scene);
    free(chain);
    /* One accessor of 30,000 zeros, shown by many primitives */
    assert_false(opens_repeated(
        "{\"asset\":{\"version\":\"2.0\"},\"accessors\":[{\"count\":30000,"
        "\"componentType\":5126,\"type\":\"VEC3\"}]," SHOW ",\"meshes\":[{\"primitives\":[",
        "{\"attributes\":{\"POSITION\":0}},", 1000, "{\"attributes\":{\"POSITION\":0}}]}]}", &err));
    assert_non_null(strstr(err.text, "far smaller than what it makes of its data"));
}

/* --- Real files --------------------------------------------------------------------------- */

static void real_files_open_without_leniency(void **state)
{
    (void)state;
    const char *shared = getenv("PATHFARM_SHARED"), *source = getenv("PATHFARM_SOURCE");
    static const char *const patterns[] = { "gltf-*/*.gl[tb]*", "gltf-*/*/*.gl[tb]*" };
    char folder[500], pattern[600];
    glob_t found = { 0 };
    if (shared != NULL)
        snprintf(folder, sizeof(folder), "%s", shared);
    else
        snprintf(folder, sizeof(folder), "%s/../shared", source != NULL ? source : ".");
    for (int i = 0; i < 2; i++) {
        snprintf(pattern, sizeof(pattern), "%s/scenes/%s", folder, patterns[i]);
        glob(pattern, i > 0 ? GLOB_APPEND : 0, NULL, &found);
    }
    if (found.gl_pathc == 0)
        print_message("no scenes in %s: skipped\n", folder);
    for (size_t i = 0; i < found.gl_pathc; i++) {
        struct err err = { .text = "" };
        struct scene *scene = gltf_read(found.gl_pathv[i], NULL, NULL, &err);
        if (scene == NULL)
            fail_msg("%s", err.text);
        assert_true(scene->triangle_count > 0);
        scene_free(scene);
    }
    globfree(&found);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nodes_put_meshes_where_they_belong),
        cmocka_unit_test(only_the_chosen_scene_is_shown),
        cmocka_unit_test(mirrored_meshes_keep_their_outside),
        cmocka_unit_test(shared_meshes_stand_in_all_their_places),
        cmocka_unit_test(strips_fans_and_lists_become_triangles),
        cmocka_unit_test(points_and_lines_are_left_out_and_said),
        cmocka_unit_test(accessors_may_be_interleaved_normalised_and_sparse),
        cmocka_unit_test(vertex_colours_tint_the_base_colour),
        cmocka_unit_test(metalness_chooses_between_coat_metal_and_a_mix),
        cmocka_unit_test(a_metal_reflects_its_base_colour),
        cmocka_unit_test(glass_is_thin_without_a_volume_and_tinted),
        cmocka_unit_test(thick_glass_absorbs_on_the_way_through),
        cmocka_unit_test(clear_coats_lie_over_their_share),
        cmocka_unit_test(a_sheen_lies_over_every_part_of_a_material),
        cmocka_unit_test(the_index_and_specular_decide_what_a_dielectric_reflects),
        cmocka_unit_test(textures_are_placed_as_gltf_places_them),
        cmocka_unit_test(metalness_and_roughness_come_from_their_channels),
        cmocka_unit_test(alpha_modes_cut_holes),
        cmocka_unit_test(emissive_surfaces_are_lights),
        cmocka_unit_test(what_is_approximated_is_said_and_counted),
        cmocka_unit_test(lights_are_where_and_as_bright_as_they_say),
        cmocka_unit_test(cameras_are_chosen_by_name),
        cmocka_unit_test(without_a_camera_everything_is_in_the_picture),
        cmocka_unit_test(binary_files_are_read_whole_or_not_at_all),
        cmocka_unit_test(other_files_are_found_by_relative_paths_only),
        cmocka_unit_test(broken_pictures_fail_or_are_left_out),
        cmocka_unit_test(wrong_files_are_refused_with_a_reason),
        cmocka_unit_test(text_that_is_no_gltf_is_refused),
        cmocka_unit_test(small_files_cannot_ask_for_much),
        cmocka_unit_test(real_files_open_without_leniency),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
