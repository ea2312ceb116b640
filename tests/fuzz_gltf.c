/*
 * libFuzzer target: any bytes as a glTF file, JSON or GLB, strict and lenient; built and run by
 * fuzz.sh. Files that it names are not there.
 *
 * The tables of coats are those below, not coat.c's: with sanitizers, those would take a second
 * each, and all they get of the input are numbers that were checked.
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/coat.h"
#include "master/gltf.h"
#include "master/scene_notes.h"

#include <stdint.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

void coat_tabulate(double alpha, double ior, double thickness, struct coat *coat)
{
    if (!(alpha >= 0 && alpha <= 1 && ior >= 1 && ior <= 20 && thickness == 0))
        abort();
    *coat = (struct coat){ .inner = 0.5f, .scale = 0.1f };
}

void coat_metal_tabulate(double alpha, double base_alpha, double ior, double thickness,
                         struct coat_metal *coat)
{
    if (!(base_alpha >= 0 && base_alpha <= 1))
        abort();
    struct coat other;
    coat_tabulate(alpha, ior, thickness, &other);
    *coat = (struct coat_metal){ .inner = 0.5f, .scale = 0.1f };
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    for (int lenient = 0; lenient < 2; lenient++) {
        struct gltf_options options = { .lenient = lenient };
        struct scene_notes notes;
        struct err err = { .code = ERR_OK };
        struct scene *scene = gltf_read_bytes(data, size, NULL, &options, &notes, &err);
        if (scene != NULL ? !scene_check(scene, NULL) : err.code == ERR_OK)
            abort();
        scene_notes_free(&notes);
        scene_free(scene);
    }
    return 0;
}
