/*
 * Little-endian bytes, written and read field by field. Both sides remember their first failure,
 * so that an encoder or decoder has no branches and reads like a schema:
 *
 *     struct reader in = reader_of(bytes, size);
 *     node->level = read_u32(&in);
 *     node->index = read_u64(&in);
 *     return reader_done(&in, err);       // ends early, or bytes left over
 *
 * A reader that failed gives zeros; what was decoded counts for nothing until reader_done said yes.
 * A writer writes into memory of the caller and keeps counting once that is full, so a first pass
 * over no memory at all (writer_of(NULL, 0)) measures. Neither allocates. Pure; any thread.
 */
#ifndef COMMON_BYTES_H
#define COMMON_BYTES_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;

struct reader {
    const uint8_t *at, *end;
    const char *failure; /* the first one; NULL while all is well */
};

struct writer {
    uint8_t *bytes;
    size_t capacity;
    size_t size; /* bytes written, counting those that found no room */
};

_Static_assert(__BYTE_ORDER__ == __ORDER_LITTLE_ENDIAN__, "arrays cross the wire as they are");

/* The two that everything below is made of: copy `size` bytes, or zeros after a failure. */
void bytes_read(struct reader *in, void *to, size_t size);
void bytes_write(struct writer *out, const void *from, size_t size);

static inline struct reader reader_of(const void *bytes, size_t size)
{
    const uint8_t *at = bytes;
    return (struct reader){ at, size > 0 ? at + size : at, NULL };
}

/* The next `size` bytes in place, unaligned; NULL when there are not that many. */
const void *bytes_span(struct reader *in, size_t size);

/* Record a failure of the caller's own ("unknown flag"), unless there is one already. */
static inline void reader_fail(struct reader *in, const char *why)
{
    if (in->failure == NULL)
        in->failure = why;
}

/* True when nothing failed and nothing is left over; else ERR_MESSAGE. */
bool bytes_read_all(const struct reader *in, struct err *err);

static inline bool reader_done(const struct reader *in, struct err *err)
{
    return bytes_read_all(in, err);
}

static inline struct writer writer_of(void *bytes, size_t capacity)
{
    return (struct writer){ bytes, capacity, 0 };
}

/* True when everything found room. */
bool bytes_fit(const struct writer *out);

static inline bool writer_done(const struct writer *out)
{
    return bytes_fit(out);
}

/* read_u8(in), read_u8s(in, values, count), write_u8(out, value), write_u8s(out, values, count) */
#define BYTES_MAP(X) \
    X(u8, uint8_t)   \
    X(u16, uint16_t) \
    X(u32, uint32_t) \
    X(u64, uint64_t) \
    X(f32, float)    \
    X(f64, double)

#define X(name, type)                                                                        \
    static inline type read_##name(struct reader *in)                                        \
    {                                                                                        \
        type value;                                                                          \
        bytes_read(in, &value, sizeof(value));                                               \
        return value;                                                                        \
    }                                                                                        \
    static inline void read_##name##s(struct reader *in, type *values, size_t count)         \
    {                                                                                        \
        bytes_read(in, values, count * sizeof(type));                                        \
    }                                                                                        \
    static inline void write_##name(struct writer *out, type value)                          \
    {                                                                                        \
        bytes_write(out, &value, sizeof(value));                                             \
    }                                                                                        \
    static inline void write_##name##s(struct writer *out, const type *values, size_t count) \
    {                                                                                        \
        bytes_write(out, values, count * sizeof(type));                                      \
    }
BYTES_MAP(X)
#undef X

#endif
