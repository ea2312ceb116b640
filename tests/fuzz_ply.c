/*
 * libFuzzer target: any bytes as a PLY file. Not built by default:
 *   clang -g -O1 -fsanitize=fuzzer,address,undefined -D_GNU_SOURCE -Wno-psabi -I. tests/fuzz_ply.c
 *       common/{err,pages}.c master/{ply,number,growing}.c -lz -lm -o fuzz_ply
 *   ./fuzz_ply -max_len=65536 -malloc_limit_mb=68 corpus
 */
#include "common/err.h"
#include "master/ply.h"

#include <math.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

static void check(const struct ply_target *target, const struct ply_added *added)
{
    const uint32_t *corner = target->triangles.data;
    const float *position = target->positions.data;
    for (size_t i = 0; i < 3 * (size_t)added->triangle_count; i++)
        if (corner[i] >= added->vertex_count)
            abort();
    for (size_t i = 0; i < 3 * (size_t)added->vertex_count; i++)
        if (!isfinite(position[i]))
            abort();
}

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    struct ply_target target = { 0 };
    struct ply_added added;
    struct err err = { .code = ERR_OK };
    if (ply_read_bytes(data, size, "fuzz.ply", &target, &added, &err))
        check(&target, &added);
    else if (err.code == ERR_OK)
        abort();
    growing_free(&target.positions);
    growing_free(&target.normals);
    growing_free(&target.uvs);
    growing_free(&target.triangles);
    growing_free(&target.wide);
    return 0;
}
