/* Goal: PLY files of every layout give the same mesh, and no bad one gives anything but a clear
 * error, without memory being asked for on a header's word. */
#include "common/err.h"
#include "master/number.h"
#include "master/ply.h"
#include "tests/scratch.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/stat.h>
#include <zlib.h>

#include <cmocka.h>

struct mesh_of {
    struct ply_target target;
    struct ply_added added;
    struct err err;
    bool good;
};

static struct mesh_of read_bytes(const void *bytes, size_t size)
{
    struct mesh_of mesh = { .err = { .text = "" } };
    mesh.good = ply_read_bytes(bytes, size, "m.ply", &mesh.target, &mesh.added, &mesh.err);
    return mesh;
}

static void forget(struct mesh_of *mesh)
{
    growing_free(&mesh->target.positions);
    growing_free(&mesh->target.normals);
    growing_free(&mesh->target.uvs);
    growing_free(&mesh->target.triangles);
    growing_free(&mesh->target.wide);
}

/* --- Writing files to read ---------------------------------------------------------------- */

struct file {
    char bytes[4096];
    size_t size;
};

static void put(struct file *file, const void *bytes, size_t size, bool swap)
{
    assert_true(file->size + size <= sizeof(file->bytes));
    for (size_t i = 0; i < size; i++)
        file->bytes[file->size + i] = ((const char *)bytes)[swap ? size - 1 - i : i];
    file->size += size;
}

static void put_text(struct file *file, const char *text)
{
    put(file, text, strlen(text), false);
}

static void put_float(struct file *file, float value, bool swap)
{
    put(file, &value, sizeof(value), swap);
}

static void put_int(struct file *file, int32_t value, bool swap)
{
    put(file, &value, sizeof(value), swap);
}

/* A unit square of one quad or two triangles, with normals, uvs and things to skip */
static struct file square(const char *format, bool quad)
{
    static const float corners[4][2] = { { 0, 0 }, { 1, 0 }, { 1, 1 }, { 0, 1 } };
    bool ascii = strcmp(format, "ascii") == 0, swap = strstr(format, "big") != NULL;
    struct file file = { .size = 0 };
    char header[1024], line[256];
    snprintf(header, sizeof(header),
             "ply\r\nformat %s 1.0\ncomment made by hand\nelement vertex 4\n"
             "property float x\nproperty float y\nproperty float z\nproperty float nx\n"
             "property float ny\nproperty float nz\nproperty uchar red\nproperty float s\n"
             "property float t\nelement extra 1\nproperty list uchar int numbers\n"
             "element face %d\nproperty list uchar int vertex_indices\nproperty int flag\n"
             "end_header\n",
             format, quad ? 1 : 2);
    put_text(&file, header);
    for (int i = 0; i < 4; i++) {
        float u = corners[i][0], v = corners[i][1];
        const float numbers[] = { u, v, 0.5f, 0, 0, 1, u, v };
        if (ascii) {
            snprintf(line, sizeof(line), "%g %g .5 0 0 1 200 %g %g\n", u, v, u, v);
            put_text(&file, line);
        }
        for (int k = 0; !ascii && k < 8; k++) {
            if (k == 6)
                put(&file, "\200", 1, false);
            put_float(&file, numbers[k], swap);
        }
    }
    static const int32_t faces[2][4] = { { 0, 1, 2, 3 }, { 0, 2, 3, 0 } };
    if (ascii) {
        put_text(&file, quad ? "2 7 8\n4 0 1 2 3 9\n" : "2 7 8\n3 0 1 2 9\n3 0 2 3 9");
        return file;
    }
    put(&file, "\2", 1, false);
    put_int(&file, 7, swap);
    put_int(&file, 8, swap);
    for (int f = 0; f < (quad ? 1 : 2); f++) {
        put(&file, quad ? "\4" : "\3", 1, false);
        for (int i = 0; i < (quad ? 4 : 3); i++)
            put_int(&file, faces[f][i], swap);
        put_int(&file, 9, swap);
    }
    return file;
}

static void expect_square(const struct mesh_of *mesh)
{
    static const float positions[] = { 0, 0, .5f, 1, 0, .5f, 1, 1, .5f, 0, 1, .5f };
    static const float uvs[] = { 0, 0, 1, 0, 1, 1, 0, 1 };
    static const uint32_t triangles[] = { 0, 1, 2, 0, 2, 3 };
    if (!mesh->good)
        fail_msg("%s", mesh->err.text);
    assert_int_equal(mesh->added.vertex_count, 4);
    assert_int_equal(mesh->added.triangle_count, 2);
    assert_true(mesh->added.has_normals && mesh->added.has_uvs && !mesh->added.has_wide);
    assert_memory_equal(mesh->target.positions.data, positions, sizeof(positions));
    assert_memory_equal(mesh->target.uvs.data, uvs, sizeof(uvs));
    assert_memory_equal(mesh->target.triangles.data, triangles, sizeof(triangles));
    assert_float_equal(((float *)mesh->target.normals.data)[11], 1, 0);
}

static const char *const formats[] = { "ascii", "binary_little_endian", "binary_big_endian" };

static void every_format_gives_the_same_mesh(void **state)
{
    (void)state;
    for (int i = 0; i < 3; i++)
        for (int quad = 0; quad < 2; quad++) {
            struct file file = square(formats[i], quad);
            struct mesh_of mesh = read_bytes(file.bytes, file.size);
            expect_square(&mesh);
            forget(&mesh);
        }
}

static void files_may_be_compressed(void **state)
{
    (void)state;
    char folder[256];
    scratch_make(folder);
    for (int i = 0; i < 3; i++)
        for (int compressed = 0; compressed < 2; compressed++) {
            struct file file = square(formats[i], true);
            const char *path = scratch_path(folder, "square.ply");
            gzFile out = gzopen(path, compressed ? "wb" : "wbT");
            assert_int_equal(gzwrite(out, file.bytes, (unsigned)file.size), file.size);
            gzclose(out);
            struct mesh_of mesh = { .err = { .text = "" } };
            mesh.good = ply_read(path, &mesh.target, &mesh.added, &mesh.err);
            expect_square(&mesh);
            forget(&mesh);

            /* The same, cut short */
            struct stat status;
            assert_int_equal(stat(path, &status), 0);
            assert_int_equal(truncate(path, status.st_size - 12), 0);
            mesh = (struct mesh_of){ .err = { .text = "" } };
            assert_false(ply_read(path, &mesh.target, &mesh.added, &mesh.err));
            assert_non_null(strstr(mesh.err.text, "square.ply"));
            forget(&mesh);
        }
    scratch_remove(folder);
}

/* Corners of face `f` of the lists below */
static uint32_t corner_count(int list, uint32_t f)
{
    switch (list) {
    case 0:
        return f == 123456 ? 4 : 3; /* one quad */
    case 1:
        return 4;
    default:
        return f % 5000 == 77 ? 5 : f % 3 == 1 ? 4 : 3;
    }
}

/* Triangles and quads take the fast way, in pieces of the buffer; what comes in between must not
 * confuse it */
static void long_face_lists_of_every_mixture_become_fans(void **state)
{
    (void)state;
    enum { FACES = 200000, VERTICES = 7 };
    char folder[256];
    scratch_make(folder);
    const char *path = scratch_path(folder, "long.ply");
    size_t capacity = 21 * FACES + 1024;
    char *bytes = malloc(capacity);
    assert_non_null(bytes);
    for (int list = 0; list < 3; list++) {
        size_t size = (size_t)snprintf(
            bytes, capacity,
            "ply\nformat binary_little_endian 1.0\nelement vertex %d\nproperty float "
            "x\nproperty float y\nproperty float z\nelement face %d\nproperty list "
            "uchar uint vertex_index\nend_header\n",
            VERTICES, FACES);
        memset(bytes + size, 0, 12 * VERTICES);
        size += 12 * VERTICES;
        for (uint32_t f = 0; f < FACES; f++) {
            uint32_t count = corner_count(list, f);
            bytes[size++] = (char)count;
            for (uint32_t i = 0; i < count; i++, size += 4) {
                uint32_t corner = (f + i) % VERTICES;
                memcpy(bytes + size, &corner, 4);
            }
        }
        scratch_write(path, bytes, size);
        struct mesh_of mesh = { .err = { .text = "" } };
        mesh.good = ply_read(path, &mesh.target, &mesh.added, &mesh.err);
        if (!mesh.good)
            fail_msg("%s", mesh.err.text);
        const uint32_t *triangle = mesh.target.triangles.data;
        for (uint32_t f = 0; f < FACES; f++)
            for (uint32_t i = 2; i < corner_count(list, f); i++, triangle += 3) {
                assert_int_equal(triangle[0], f % VERTICES);
                assert_int_equal(triangle[1], (f + i - 1) % VERTICES);
                assert_int_equal(triangle[2], (f + i) % VERTICES);
            }
        size_t made = (size_t)(triangle - (uint32_t *)mesh.target.triangles.data) / 3;
        assert_int_equal(mesh.added.triangle_count, made);
        forget(&mesh);
    }
    scratch_remove(folder);
    free(bytes);
}

static void doubles_are_kept_as_doubles(void **state)
{
    (void)state;
    static const char text[] = "ply\nformat ascii 1.0\nelement vertex 3\nproperty double x\n"
                               "property double y\nproperty double z\nelement face 1\n"
                               "property list uchar int vertex_indices\nend_header\n"
                               "1000000.03 0 0\n1 0 0\n0 1 0\n3 0 1 2\n";
    struct mesh_of mesh = read_bytes(text, strlen(text));
    assert_true(mesh.good && mesh.added.has_wide);
    assert_true(((double *)mesh.target.wide.data)[0] == 1000000.03);
    forget(&mesh);
}

static void meshes_are_appended(void **state)
{
    (void)state;
    struct file file = square("binary_little_endian", false);
    struct mesh_of mesh = read_bytes(file.bytes, file.size);
    mesh.good = ply_read_bytes(file.bytes, file.size, "m.ply", &mesh.target, &mesh.added,
                               &mesh.err);
    assert_true(mesh.good);
    assert_int_equal(mesh.added.first_vertex, 4);
    assert_int_equal(mesh.added.first_triangle, 2);
    assert_int_equal(((uint32_t *)mesh.target.triangles.data)[6], 4);
    forget(&mesh);
}

/* --- Bad files ---------------------------------------------------------------------------- */

#define HEAD  "ply\nformat ascii 1.0\n"
#define XYZ   "property float x\nproperty float y\nproperty float z\n"
#define FACE  "property list uchar int vertex_indices\nend_header\n"
#define THREE HEAD "element vertex 3\n" XYZ "element face 1\n" FACE "0 0 0\n1 0 0\n0 1 0\n"

static void bad_files_are_refused_with_a_reason(void **state)
{
    (void)state;
    static const struct {
        const char *text, *says;
    } rows[] = {
        { "", "ends inside the PLY header" },
        { "plx\n", "not a PLY file" },
        { "ply\nformat ascii 1.0\nelement", "ends inside the PLY header" },
        { "ply\nformat utf8 1.0\n", "m.ply:2: unknown format \"utf8\"" },
        { HEAD "element vertex many\n", "m.ply:3: an element needs" },
        { HEAD "element vertex -3\n", "an element needs" },
        { HEAD "property float x\n", "before the first element" },
        { HEAD "element vertex 3\nproperty half x\n", "unknown property type \"half\"" },
        { HEAD "element face 1\nproperty list float int vertex_indices\n", "length cannot be" },
        { HEAD "element face 1\nproperty list uchar float vertex_indices\n", "indices cannot be" },
        { HEAD "elephant\n", "unknown header line \"elephant\"" },
        { HEAD "element vertex 1\nelement vertex 1\n", "a second element" },
        { HEAD "element tristrips 1\n", "not supported yet" },
        { "ply\nelement vertex 3\n" XYZ "end_header\n", "names no format" },
        { HEAD "element vertex 3\nproperty float x\nelement face 1\n" FACE, "no vertices with" },
        { HEAD "element vertex 3\n" XYZ "end_header\n", "no faces" },
        { HEAD "element vertex 1000000000\n" XYZ "element face 1\n" FACE "0 0 0\n",
          "claims 1000000000 vertices and 1 faces, at least 6000000002 bytes; the whole file has" },
        { HEAD "element vertex 3\n" XYZ "element face 999999999999999999\n" FACE, "claims" },
        { THREE, "the file ends early, in face 0" },
        { THREE "3 0 1", "the file ends early, in face 0" },
        { THREE "3 0 1 3", "face 0: vertex index 3 is out of range (3 vertices)" },
        { THREE "3 0 1 -1", "vertex index -1 is out of range" },
        { THREE "3 0 1 1.5", "out of range" },
        { THREE "-1 0 1 2", "a list of -1 items" },
        { THREE "3 0 one 2", "m.ply:13: \"one\" is not a number (face 0)" },
        { HEAD "element vertex 3\n" XYZ "element face 1\n" FACE "0 0 0\n1 nan 0\n0 1 0\n3 0 1 2",
          "vertex 1: its position is not finite" },
        { HEAD "element vertex 3\n" XYZ "element face 1\n" FACE "0 0 0\n1 1e99 0\n0 1 0\n3 0 1 2",
          "vertex 1: its position is not finite" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        struct mesh_of mesh = read_bytes(rows[i].text, strlen(rows[i].text));
        if (mesh.good || strstr(mesh.err.text, rows[i].says) == NULL)
            fail_msg("row %zu: \"%s\" was wanted, not \"%s\"", i, rows[i].says, mesh.err.text);
        assert_true(mesh.err.code == ERR_SCENE || mesh.err.code == ERR_UNSUPPORTED);
        forget(&mesh);
    }
}

static void an_index_out_of_range_in_binary_names_its_face(void **state)
{
    (void)state;
    struct file file = square("binary_little_endian", false);
    int32_t bad = 4;
    memcpy(file.bytes + file.size - 8, &bad, sizeof(bad)); /* last corner of the last face */
    struct mesh_of mesh = read_bytes(file.bytes, file.size);
    assert_false(mesh.good);
    assert_non_null(strstr(mesh.err.text, "face 1: vertex index 4 is out of range (4 vertices)"));
    forget(&mesh);
}

static void every_truncation_is_an_error(void **state)
{
    (void)state;
    for (int f = 0; f < 3; f++) {
        struct file file = square(formats[f], true);
        for (size_t size = 0; size + 2 < file.size; size++) {
            struct mesh_of mesh = read_bytes(file.bytes, size);
            assert_false(mesh.good);
            assert_true(mesh.err.text[0] != '\0');
            forget(&mesh);
        }
    }
}

static void missing_files_and_folders_are_named(void **state)
{
    (void)state;
    struct mesh_of mesh = { .err = { .text = "" } };
    assert_false(ply_read("/nowhere/a.ply", &mesh.target, &mesh.added, &mesh.err));
    assert_non_null(strstr(mesh.err.text, "/nowhere/a.ply: cannot be opened"));
    assert_false(ply_read("/", &mesh.target, &mesh.added, &mesh.err));
    assert_non_null(strstr(mesh.err.text, "not a regular file"));
    forget(&mesh);
}

static void numbers_are_rounded_as_strtod_does(void **state)
{
    (void)state;
    static const char *const texts[] = {
        "0",
        "-0",
        "1",
        "+1",
        "0.1",
        "-12.5e3",
        ".5",
        "5.",
        "1e22",
        "1e23",
        "1e-22",
        "1e-23",
        "9007199254740993",
        "123456789012345678901234567890",
        "0.00000000000000000000000001234",
        "1.7976931348623157e308",
        "4.9e-324",
        "1e400",
        "3.4028235e38",
        "2.2250738585072011e-308",
        "1000000000000000000000.5e-21",
        "0.30000000000000004",
        "7.1428571428571425e-2",
    };
    for (size_t i = 0; i < sizeof(texts) / sizeof(texts[0]); i++) {
        double value;
        assert_true(number_parse(texts[i], texts[i] + strlen(texts[i]), &value));
        if (value != strtod(texts[i], NULL))
            fail_msg("%s gave %.17g", texts[i], value);
    }
    static const char *const bad[] = { "",     "-",  ".",   "e5", "1e",   "1e+", "1.2.3",
                                       "0x10", "1f", "--1", "1 ", "nano", "true" };
    for (size_t i = 0; i < sizeof(bad) / sizeof(bad[0]); i++) {
        double value;
        if (number_parse(bad[i], bad[i] + strlen(bad[i]), &value))
            fail_msg("\"%s\" was taken for the number %g", bad[i], value);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_format_gives_the_same_mesh),
        cmocka_unit_test(files_may_be_compressed),
        cmocka_unit_test(long_face_lists_of_every_mixture_become_fans),
        cmocka_unit_test(doubles_are_kept_as_doubles),
        cmocka_unit_test(meshes_are_appended),
        cmocka_unit_test(bad_files_are_refused_with_a_reason),
        cmocka_unit_test(an_index_out_of_range_in_binary_names_its_face),
        cmocka_unit_test(every_truncation_is_an_error),
        cmocka_unit_test(missing_files_and_folders_are_named),
        cmocka_unit_test(numbers_are_rounded_as_strtod_does),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
