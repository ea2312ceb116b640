/*
 * How a large mesh gets from its file to Embree, on one core and step by step, and what that has to
 * keep in memory at least.
 *
 *     bench_load make TRIANGLES positions|normals MESH.ply
 *         a wavy sheet as exporters write it: little-endian, triangles with a byte of length; with
 *         nx ny nz u v or without
 *     bench_load run SCENE.pbrt
 *         read the scene as the master does, make the bundle, take its slices as the worker does,
 *         check them, and open the kernel's scene. A line per step, "name seconds"; what Embree's
 *         own building takes is apart; then "name bytes": of the arrays, and the most that Embree
 *         had at a time
 *
 * The linker puts the functions __wrap_* around what the kernel calls.
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt.h"
#include "proto/assembly.h"
#include "proto/bundle.h"
#include "worker/kernel/kernel.h"
#include "worker/profile.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

/* Of the one thread that there is: other programs do not count */
static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

static double step(const char *name, double begin)
{
    double end = now_s();
    printf("%s %.4f\n", name, end - begin);
    return end;
}

/* ---- Embree, watched */

void __real_rtcCommitScene(RTCScene scene);
void __wrap_rtcCommitScene(RTCScene scene);

static struct {
    double seconds;
    int64_t bytes, most;
} embree;

static bool watch(void *user, ssize_t bytes, bool post)
{
    (void)user;
    (void)post;
    embree.bytes += bytes;
    embree.most = embree.bytes > embree.most ? embree.bytes : embree.most;
    return true;
}

void __wrap_rtcCommitScene(RTCScene scene)
{
    RTCDevice device = rtcGetSceneDevice(scene);
    double begin = now_s();
    rtcSetDeviceMemoryMonitorFunction(device, watch, NULL);
    __real_rtcCommitScene(scene);
    rtcSetDeviceMemoryMonitorFunction(device, NULL, NULL);
    rtcReleaseDevice(device);
    embree.seconds += now_s() - begin;
}

/* ---- the mesh */

static bool make(uint32_t triangles, bool normals, const char *path)
{
    const uint32_t width = (uint32_t)sqrt(triangles / 2.0), height = triangles / 2 / width;
    const uint64_t vertices = (uint64_t)(width + 1) * (height + 1);
    FILE *file = fopen(path, "wb");
    if (file == NULL)
        return false;
    fprintf(file, "ply\nformat binary_little_endian 1.0\nelement vertex %" PRIu64 "\n", vertices);
    fprintf(file, "property float x\nproperty float y\nproperty float z\n%s",
            normals ? "property float nx\nproperty float ny\nproperty float nz\n"
                      "property float u\nproperty float v\n"
                    : "");
    fprintf(file, "element face %u\nproperty list uchar int vertex_indices\nend_header\n",
            2 * width * height);
    for (uint32_t y = 0; y <= height; y++)
        for (uint32_t x = 0; x <= width; x++) {
            double u = (double)x / width, v = (double)y / height;
            double slope = 0.9 * cos(30 * u) * cos(20 * v), length = sqrt(1 + slope * slope);
            const float values[8] = { (float)u,
                                      (float)v,
                                      (float)(0.03 * sin(30 * u) * cos(20 * v)),
                                      (float)(-slope / length),
                                      0,
                                      (float)(1 / length),
                                      (float)u,
                                      (float)v };
            fwrite(values, sizeof(float), normals ? 8 : 3, file);
        }
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++) {
            uint32_t at = y * (width + 1) + x, above = at + width + 1;
            const uint32_t corners[2][3] = { { at, at + 1, above + 1 }, { at, above + 1, above } };
            for (int i = 0; i < 2; i++) {
                unsigned char record[13] = { 3 };
                memcpy(record + 1, corners[i], sizeof(corners[i]));
                fwrite(record, sizeof(record), 1, file);
            }
        }
    bool written = ferror(file) == 0;
    return fclose(file) == 0 && written;
}

/* ---- its way */

/* Every slice, as if the wire took no time */
static bool transfer(const struct bundle *bundle, struct assembly *assembly, struct err *err)
{
    Pathfarm__ObjectWanted wanted;
    while (assembly_want(assembly, 8, &wanted))
        for (uint32_t i = 0; i < wanted.slice_count; i++) {
            struct digest digest;
            Pathfarm__ObjectSlice message;
            const void *data;
            size_t size;
            if (!digest_from_bytes(&digest, wanted.digest.data, wanted.digest.len) ||
                !bundle_slice(bundle, &digest, wanted.first_slice + i, &message, &data, &size) ||
                !assembly_slice(assembly, &message, data, size, err))
                return false;
        }
    return assembly_complete(assembly) || err_set(err, ERR_INTERNAL, "slices are missing");
}

static bool run(const char *path, struct err *err)
{
    const struct job_spec spec = {
        .replicates = 1, .channel_count = 3, .leaf_samples = 4, .depth_cap = 65536, .max_lanes = 8
    };
    struct bundle *bundle = NULL;
    struct assembly *assembly = NULL;
    struct kernel_scene *ks = NULL;
    Pathfarm__Job job = PATHFARM__JOB__INIT;
    bool good = false;
    profile_thread_mode();

    double begin = now_s();
    struct scene *scene = pbrt_read(path, NULL, NULL, err);
    if (scene == NULL)
        return false;
    begin = step("read", begin);
    bundle = bundle_from_scene(scene, &spec, err);
    if (bundle == NULL)
        goto fail;
    begin = step("bundle", begin);
    bundle_describe(bundle, &job);
    assembly = assembly_new(&job, UINT64_MAX, err);
    if (assembly == NULL || !transfer(bundle, assembly, err))
        goto fail;
    begin = step("slices", begin);
    const struct scene *arrived = assembly_scene(assembly);
    if (!scene_check(arrived, err))
        goto fail;
    begin = step("check", begin);
    ks = kernel_open(arrived, &spec, err);
    if (ks == NULL)
        goto fail;
    printf("open %.4f\nembree %.4f\n", now_s() - begin - embree.seconds, embree.seconds);
    printf("arrays_bytes %" PRIu64 "\nembree_bytes %" PRId64 "\n", bundle_size(bundle),
           embree.most);
    good = true;

fail:
    kernel_close(ks);
    assembly_free(assembly);
    bundle_free(bundle);
    scene_free(scene);
    return good;
}

int main(int argc, char **argv)
{
    struct err err = { .text = "it cannot be written" };
    bool good = false;
    if (argc == 5 && strcmp(argv[1], "make") == 0) {
        good = make((uint32_t)strtoul(argv[2], NULL, 10), strcmp(argv[3], "normals") == 0, argv[4]);
    } else if (argc == 3 && strcmp(argv[1], "run") == 0) {
        good = run(argv[2], &err);
    } else {
        fprintf(stderr, "usage: bench_load make TRIANGLES positions|normals MESH.ply\n"
                        "       bench_load run SCENE.pbrt\n");
        return 2;
    }
    if (!good)
        fprintf(stderr, "bench_load: %s\n", err.text);
    return good ? 0 : 1;
}
