#include "master/gltf.h"

#include "common/err.h"
#include "common/scene.h"
#include "master/gltf_reader.h"
#include "master/scene_notes.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

/* Extensions whose members are read, or left out with a note */
static const char *const known[] = {
    "EXT_mesh_gpu_instancing",
    "KHR_lights_punctual",
    "KHR_materials_anisotropy",
    "KHR_materials_clearcoat",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_dispersion",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_iridescence",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_sheen",
    "KHR_materials_specular",
    "KHR_materials_transmission",
    "KHR_materials_unlit",
    "KHR_materials_variants", /* the default one */
    "KHR_materials_volume",
    "KHR_mesh_quantization",
    "KHR_texture_transform",
    "KHR_xmp_json_ld", /* says nothing about the picture */
};

static bool ends_in(const char *path, const char *ending)
{
    size_t length = strlen(path), tail = strlen(ending);
    return length > tail && strcasecmp(path + length - tail, ending) == 0;
}

bool gltf_is(const char *path)
{
    char start[64] = "";
    if (ends_in(path, ".gltf") || ends_in(path, ".glb"))
        return true;
    FILE *file = fopen(path, "rb");
    if (file != NULL) {
        size_t got = fread(start, 1, sizeof(start) - 1, file);
        start[got] = '\0';
        fclose(file);
    }
    return strncmp(start, "glTF", 4) == 0 || start[strspn(start, " \t\r\n")] == '{';
}

/* --- Extensions --------------------------------------------------------------------------- */

static bool is_known(const char *name)
{
    for (size_t i = 0; i < sizeof(known) / sizeof(known[0]); i++)
        if (strcmp(name, known[i]) == 0)
            return true;
    return false;
}

/* Names of a list that are not known: "A, B" */
static void list_unknown(const json_t *list, char *text, size_t capacity)
{
    size_t length = 0;
    text[0] = '\0';
    for (size_t i = 0; i < json_array_size(list) && length < capacity; i++) {
        const char *name = json_string_value(json_array_get(list, i));
        if (name != NULL && !is_known(name))
            length += (size_t)snprintf(text + length, capacity - length, "%s%.100s",
                                       length > 0 ? ", " : "", name);
    }
}

static bool check_extensions(struct gltf_reader *reader)
{
    struct gltf_item root = gltf_json_root(reader);
    const json_t *required = gltf_json_list(reader, &root, "extensionsRequired");
    const json_t *used = gltf_json_list(reader, &root, "extensionsUsed");
    char names[360];
    if (reader->failed)
        return false;
    list_unknown(required, names, sizeof(names));
    if (names[0] != '\0')
        return gltf_report_later(reader, "extensionsRequired", "%s", names);
    list_unknown(used, names, sizeof(names));
    if (names[0] != '\0')
        gltf_report_note(reader, "extensionsUsed", "left out, as the file allows: %s", names);
    if (gltf_json_count(reader, "animations") > 0)
        gltf_report_note(reader, "", "animations are not played: nodes are where they stand");
    return true;
}

/* --- Reading ------------------------------------------------------------------------------ */

static void reader_close(struct gltf_reader *reader)
{
    gltf_nodes_free(&reader->nodes);
    gltf_meshes_free(&reader->meshes);
    gltf_materials_free(&reader->materials);
    gltf_textures_free(&reader->textures);
    gltf_file_free(&reader->file);
    scene_notes_draft_free(&reader->report.notes);
    scene_build_free(reader->build);
}

static struct scene *finish(struct gltf_reader *reader)
{
    struct build_counts counts;
    gltf_lights_finish(reader);
    if (!gltf_view_finish(reader))
        return NULL;
    struct scene *scene = scene_build_finish(reader->build, &counts, reader->err);
    if (scene == NULL) {
        gltf_report_wrap(reader, "");
        return NULL;
    }
    if (counts.degenerate_triangles > 0)
        gltf_report_note(reader, "", "%llu triangles without area were left out",
                         (unsigned long long)counts.degenerate_triangles);
    if (scene->triangle_count == 0)
        gltf_report_note(reader, "", "the scene has no shape");
    return scene;
}

static struct scene *read_from(const char *path, const void *bytes, size_t size, const char *name,
                               const struct gltf_options *options, struct scene_notes *notes,
                               struct err *err)
{
    static const struct gltf_options strict = { 0 };
    struct gltf_reader reader = {
        .options = options != NULL ? options : &strict,
        .err = err,
        .report = { .path = path != NULL   ? path
                            : name != NULL ? name
                                           : "glTF" },
    };
    struct scene *scene = NULL;
    reader.build = scene_build_new();
    bool opened = reader.build == NULL ? gltf_report_no_memory(&reader)
                  : path != NULL       ? gltf_file_open(&reader, path)
                                       : gltf_file_open_bytes(&reader, bytes, size, name);
    if (opened && check_extensions(&reader) && gltf_textures_start(&reader) &&
        gltf_materials_start(&reader) && gltf_meshes_start(&reader) && gltf_lights_start(&reader) &&
        gltf_nodes_walk(&reader))
        scene = finish(&reader);
    if (notes != NULL)
        *notes = scene_notes_of(&reader.report.notes, reader.report.warnings);
    reader_close(&reader);
    return scene;
}

struct scene *gltf_read(const char *path, const struct gltf_options *options,
                        struct scene_notes *notes, struct err *err)
{
    return read_from(path, NULL, 0, NULL, options, notes, err);
}

struct scene *gltf_read_bytes(const void *bytes, size_t size, const char *name,
                              const struct gltf_options *options, struct scene_notes *notes,
                              struct err *err)
{
    return read_from(NULL, bytes, size, name, options, notes, err);
}
