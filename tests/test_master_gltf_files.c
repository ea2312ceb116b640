/* Goal: glTF's files, whole or in parts, are found and read without leniency; what is wrong,
 * hostile or damaged is refused with a reason, and small files cannot ask for much. */
#include "tests/gltf_text.h"
#include "tests/scratch.h"

#include <glob.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/stat.h>

#include <cmocka.h>

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
        add_accessor(three, 3, 5121, 3, "SCALAR", "");
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
