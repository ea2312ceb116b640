/*
 * libFuzzer target: any bytes as pbrt text, strict and lenient. Not built by default: fuzz.sh
 * builds it, and runs it with
 *   -max_len=65536 -malloc_limit_mb=68 -dict=tests/fuzz_pbrt.dict corpus scenes
 * (64 MiB and 64 bytes per byte of input are what reading may take.)
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt.h"
#include "master/scene_notes.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    for (int lenient = 0; lenient < 2; lenient++) {
        struct pbrt_options options = { .lenient = lenient };
        struct scene_notes notes;
        struct err err = { .code = ERR_OK };
        struct scene *scene = pbrt_read_text((const char *)data, size, NULL, &options, &notes,
                                             &err);
        /* Either a scene that checks, or an error with its text */
        if (scene != NULL ? !scene_check(scene, NULL) : err.code == ERR_OK || err.text[0] == '\0')
            abort();
        scene_free(scene);
        scene_notes_free(&notes);
    }
    return 0;
}
