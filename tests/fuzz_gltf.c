/*
 * libFuzzer target: any bytes as a glTF file, JSON or GLB, strict and lenient; built and run by
 * fuzz.sh. Files that it names are not there.
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/gltf.h"
#include "master/scene_notes.h"

#include <stdint.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

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
