/*
 * Any bytes as the bulk of a RESULT: refused, or sums that encode to exactly these bytes.
 *
 *     clang -fsanitize=fuzzer,address,undefined ... tests/fuzz_node_wire.c && ./fuzz_node_wire
 */
#include "common/err.h"
#include "proto/node_wire.h"

#include <stdlib.h>
#include <string.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    if (size < 2)
        return 0;
    struct err err = { 0 };
    uint32_t shape[2] = { bytes[0] % 40 + 1, bytes[1] % 4 + 1 }; /* pixels, channels */
    bool right_shape = (bytes[1] & 128) != 0; /* or guessing it takes most of the time */
    size_t bulk_size = size - 2;
    uint8_t *bulk = malloc(bulk_size + 1), *again = malloc(bulk_size + 1);
    memcpy(bulk, bytes + 2, bulk_size);
    if (right_shape && bulk_size >= sizeof(shape))
        memcpy(bulk, shape, sizeof(shape));

    struct node_sums *sums = node_wire_decode(bulk, bulk_size, shape[0], shape[1], &err);
    if (sums == NULL && err.code == ERR_OK)
        abort();
    if (sums != NULL &&
        (node_wire_size(sums) != bulk_size || !node_wire_encode(sums, again, bulk_size) ||
         memcmp(again, bulk, bulk_size) != 0))
        abort();
    node_sums_free(sums);
    free(again);
    free(bulk);
    return 0;
}
