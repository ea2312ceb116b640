#include "proto/node_wire.h"

#include "common/bytes.h"
#include "common/err.h"
#include "proto/limits.h"

#include <math.h>
#include <string.h>

enum flag { FLAG_FAILED = 1 };

#define SHAPE_SIZE 16
#define STATS_SIZE (8 * (4 + NONFINITE_CAUSES + 1) + 8 + 4)

_Static_assert(SHAPE_SIZE + STATS_SIZE + TILE_PIXELS / 8 + 4 * TILE_PIXELS * LIMIT_CHANNELS <=
                   LIMIT_NODE_BULK,
               "the largest node fits its frame");

static size_t failed_words(uint32_t pixel_count)
{
    return (pixel_count + 31) / 32;
}

static bool any_failed(const struct node_sums *sums)
{
    for (size_t word = 0; word < failed_words(sums->pixel_count); word++)
        if (sums->failed[word] != 0)
            return true;
    return false;
}

static size_t wire_size(uint32_t pixel_count, uint32_t channel_count, bool failed)
{
    return SHAPE_SIZE + STATS_SIZE + (failed ? 4 * failed_words(pixel_count) : 0) +
           sizeof(float) * pixel_count * channel_count;
}

size_t node_wire_size(const struct node_sums *sums)
{
    return wire_size(sums->pixel_count, sums->channel_count, any_failed(sums));
}

size_t node_wire_size_max(uint32_t pixel_count, uint32_t channel_count)
{
    return wire_size(pixel_count, channel_count, true);
}

static void write_stats(struct writer *out, const struct node_stats *stats)
{
    write_u64(out, stats->samples);
    write_u64(out, stats->rays_closest);
    write_u64(out, stats->rays_shadow);
    write_u64(out, stats->events);
    write_u64s(out, stats->nonfinite, NONFINITE_CAUSES);
    write_u64(out, stats->truncated_paths);
    write_f64(out, stats->truncated_energy);
    write_f32(out, stats->largest);
}

static void read_stats(struct reader *in, struct node_stats *stats)
{
    stats->samples = read_u64(in);
    stats->rays_closest = read_u64(in);
    stats->rays_shadow = read_u64(in);
    stats->events = read_u64(in);
    read_u64s(in, stats->nonfinite, NONFINITE_CAUSES);
    stats->truncated_paths = read_u64(in);
    stats->truncated_energy = read_f64(in);
    stats->largest = read_f32(in);

    if (stats->truncated_paths > stats->samples)
        reader_fail(in, "more paths cut than traced");
    for (int cause = 0; cause < NONFINITE_CAUSES; cause++)
        if (stats->nonfinite[cause] > stats->samples)
            reader_fail(in, "more samples left out than taken");
    if (!(isfinite(stats->truncated_energy) && stats->truncated_energy >= 0))
        reader_fail(in, "the energy cut off is not a number");
    if (!(isfinite(stats->largest) && stats->largest >= 0))
        reader_fail(in, "the largest sample is not a number");
}

bool node_wire_encode(const struct node_sums *sums, void *bulk, size_t size)
{
    struct writer out = writer_of(bulk, size);
    bool failed = any_failed(sums);
    write_u32(&out, sums->pixel_count);
    write_u32(&out, sums->channel_count);
    write_u32(&out, failed ? FLAG_FAILED : 0);
    write_u32(&out, 0);
    write_stats(&out, &sums->stats);
    if (failed)
        write_u32s(&out, sums->failed, failed_words(sums->pixel_count));
    write_f32s(&out, sums->values, (size_t)sums->pixel_count * sums->channel_count);
    return writer_done(&out) && out.size == size;
}

static void read_failed(struct reader *in, struct node_sums *sums)
{
    read_u32s(in, sums->failed, failed_words(sums->pixel_count));
    uint32_t odd_pixels = sums->pixel_count % 32;
    if (odd_pixels != 0 && sums->failed[failed_words(sums->pixel_count) - 1] >> odd_pixels != 0)
        reader_fail(in, "a failed pixel outside the tile");
    if (!any_failed(sums))
        reader_fail(in, "failed bits without any failed pixel");
}

struct node_sums *node_wire_decode(const void *bulk, size_t size, uint32_t pixel_count,
                                   uint32_t channel_count, struct err *err)
{
    struct reader in = reader_of(bulk, size);
    uint32_t pixels = read_u32(&in), channels = read_u32(&in);
    uint32_t flags = read_u32(&in), zero = read_u32(&in);
    struct node_sums *sums = NULL;

    if (in.failure == NULL && (pixels != pixel_count || channels != channel_count)) {
        err_set(err, ERR_MESSAGE, "%u pixels in %u channels where %u in %u were leased", pixels,
                channels, pixel_count, channel_count);
        goto fail;
    }
    if ((flags & ~(uint32_t)FLAG_FAILED) != 0 || zero != 0)
        reader_fail(&in, "unknown flags");
    if (in.failure == NULL &&
        size != wire_size(pixel_count, channel_count, (flags & FLAG_FAILED) != 0))
        reader_fail(&in, "the length is not that of its shape");
    if (in.failure != NULL) {
        err_set(err, ERR_MESSAGE, "%s", in.failure);
        goto fail;
    }

    sums = node_sums_new(pixel_count, channel_count);
    if (sums == NULL) {
        err_set(err, ERR_MEMORY, "no memory for %u pixels in %u channels", pixel_count,
                channel_count);
        goto fail;
    }
    read_stats(&in, &sums->stats);
    if ((flags & FLAG_FAILED) != 0)
        read_failed(&in, sums);
    read_f32s(&in, sums->values, (size_t)pixel_count * channel_count);
    if (!reader_done(&in, err))
        goto fail;
    return sums;

fail:
    node_sums_free(sums);
    err_wrap(err, "sums of a node");
    return NULL;
}
