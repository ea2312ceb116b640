#include "proto/digest.h"

#include "proto/limits.h"

#include <openssl/evp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void need(bool done)
{
    if (done)
        return;
    fputs("pathfarm: SHA-256 is not available: out of memory, or a broken OpenSSL\n", stderr);
    abort();
}

/* One look-up per process: EVP_sha256() would be fetched again at every digest */
static const EVP_MD *sha256(void)
{
    static EVP_MD *method;
    EVP_MD *known = __atomic_load_n(&method, __ATOMIC_ACQUIRE);
    if (known != NULL)
        return known;
    EVP_MD *fetched = EVP_MD_fetch(NULL, "SHA256", NULL);
    need(fetched != NULL);
    EVP_MD *expected = NULL;
    if (__atomic_compare_exchange_n(&method, &expected, fetched, false, __ATOMIC_ACQ_REL,
                                    __ATOMIC_ACQUIRE))
        return fetched;
    EVP_MD_free(fetched); /* another thread was faster */
    return expected;
}

struct digest_stream {
    EVP_MD_CTX *context;
};

struct digest digest_of(const void *bytes, size_t size)
{
    struct digest digest;
    need(EVP_Digest(bytes, size, digest.bytes, NULL, sha256(), NULL) == 1);
    return digest;
}

struct digest_stream *digest_begin(void)
{
    struct digest_stream *stream = malloc(sizeof(*stream));
    need(stream != NULL);
    stream->context = EVP_MD_CTX_new();
    need(stream->context != NULL && EVP_DigestInit_ex(stream->context, sha256(), NULL) == 1);
    return stream;
}

void digest_add(struct digest_stream *stream, const void *bytes, size_t size)
{
    need(EVP_DigestUpdate(stream->context, bytes, size) == 1);
}

struct digest digest_end(struct digest_stream *stream)
{
    struct digest digest;
    need(EVP_DigestFinal_ex(stream->context, digest.bytes, NULL) == 1);
    EVP_MD_CTX_free(stream->context);
    free(stream);
    return digest;
}

uint64_t digest_slice_count(uint64_t size)
{
    return size / LIMIT_SLICE + (size % LIMIT_SLICE != 0);
}

size_t digest_slice_size(uint64_t size, uint64_t slice)
{
    uint64_t left = size - slice * LIMIT_SLICE;
    return (size_t)(left < LIMIT_SLICE ? left : LIMIT_SLICE);
}

struct digest digest_of_object(const void *bytes, uint64_t size, struct digest *slices)
{
    struct digest_stream *list = digest_begin();
    for (uint64_t slice = 0; slice < digest_slice_count(size); slice++) {
        struct digest digest = digest_of((const uint8_t *)bytes + slice * LIMIT_SLICE,
                                         digest_slice_size(size, slice));
        digest_add(list, digest.bytes, DIGEST_SIZE);
        if (slices != NULL)
            slices[slice] = digest;
    }
    return digest_end(list);
}

bool digest_from_bytes(struct digest *digest, const void *bytes, size_t size)
{
    if (size != DIGEST_SIZE)
        return false;
    memcpy(digest->bytes, bytes, DIGEST_SIZE);
    return true;
}

bool digest_equal(const struct digest *a, const struct digest *b)
{
    return memcmp(a->bytes, b->bytes, DIGEST_SIZE) == 0;
}

const char *digest_hex(const struct digest *digest, char *text)
{
    for (int i = 0; i < DIGEST_SIZE; i++)
        snprintf(text + 2 * i, 3, "%02x", digest->bytes[i]);
    return text;
}

static int hex_value(char digit)
{
    if (digit >= '0' && digit <= '9')
        return digit - '0';
    if (digit >= 'a' && digit <= 'f')
        return digit - 'a' + 10;
    return -1;
}

bool digest_from_hex(struct digest *digest, const char *text)
{
    if (strlen(text) != 2 * DIGEST_SIZE)
        return false;
    for (int i = 0; i < DIGEST_SIZE; i++) {
        int high = hex_value(text[2 * i]), low = hex_value(text[2 * i + 1]);
        if (high < 0 || low < 0)
            return false;
        digest->bytes[i] = (uint8_t)(16 * high + low);
    }
    return true;
}

void digest_checksum(const void *bytes, size_t size, uint8_t checksum[CHECKSUM_SIZE])
{
    struct digest digest = digest_of(bytes, size);
    memcpy(checksum, digest.bytes, CHECKSUM_SIZE);
}

bool digest_checksum_matches(const void *bytes, size_t size, const void *checksum,
                             size_t checksum_size)
{
    if (checksum_size != CHECKSUM_SIZE)
        return false;
    struct digest digest = digest_of(bytes, size);
    return memcmp(checksum, digest.bytes, CHECKSUM_SIZE) == 0;
}
