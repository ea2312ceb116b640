/* SHA-256 as the farm uses it, and the choice of a protocol version. */
#include "common/err.h"
#include "proto/digest.h"
#include "proto/limits.h"
#include "proto/version.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static void the_published_vectors_come_out(void **state)
{
    (void)state;
    char hex[DIGEST_HEX_SIZE];
    struct digest digest = digest_of("abc", 3);
    assert_string_equal(digest_hex(&digest, hex),
                        "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    digest = digest_of(NULL, 0);
    assert_string_equal(digest_hex(&digest, hex),
                        "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
    struct digest again;
    assert_true(digest_from_hex(&again, hex));
    assert_true(digest_equal(&again, &digest));
    assert_false(digest_from_hex(&again, "abc"));
    hex[5] = 'G';
    assert_false(digest_from_hex(&again, hex));
}

static void pieces_give_the_digest_of_the_whole(void **state)
{
    (void)state;
    struct digest_stream *stream = digest_begin();
    digest_add(stream, "a", 1);
    digest_add(stream, "", 0);
    digest_add(stream, "bc", 2);
    struct digest pieces = digest_end(stream), whole = digest_of("abc", 3);
    assert_true(digest_equal(&pieces, &whole));
}

static void an_object_is_the_digest_of_the_list_of_its_slices(void **state)
{
    (void)state;
    uint64_t size = LIMIT_SLICE + 3;
    uint8_t *bytes = calloc(1, size);
    struct digest slices[2], by_hand[2];
    bytes[LIMIT_SLICE] = 7;
    assert_int_equal(digest_slice_count(0), 0);
    assert_int_equal(digest_slice_count(LIMIT_SLICE), 1);
    assert_int_equal(digest_slice_count(size), 2);
    assert_int_equal(digest_slice_size(size, 0), LIMIT_SLICE);
    assert_int_equal(digest_slice_size(size, 1), 3);
    struct digest object = digest_of_object(bytes, size, slices);
    by_hand[0] = digest_of(bytes, LIMIT_SLICE);
    by_hand[1] = digest_of(bytes + LIMIT_SLICE, 3);
    assert_memory_equal(slices, by_hand, sizeof(slices));
    struct digest expected = digest_of(by_hand, sizeof(by_hand));
    assert_true(digest_equal(&object, &expected));
    free(bytes);
}

static void a_checksum_matches_only_its_own_bytes(void **state)
{
    (void)state;
    uint8_t checksum[CHECKSUM_SIZE];
    digest_checksum("sums", 4, checksum);
    assert_true(digest_checksum_matches("sums", 4, checksum, CHECKSUM_SIZE));
    assert_false(digest_checksum_matches("sumz", 4, checksum, CHECKSUM_SIZE));
    assert_false(digest_checksum_matches("sums", 4, checksum, CHECKSUM_SIZE - 1));
    assert_false(digest_checksum_matches("sums", 4, NULL, 0));
}

static void the_newest_version_both_sides_know_is_chosen(void **state)
{
    (void)state;
    static const struct {
        uint32_t min, max;
        bool chosen;
        const char *says;
    } cases[] = {
        { PROTOCOL_MIN, PROTOCOL_MAX, true, "" },
        { 0, PROTOCOL_MAX + 7, true, "" },
        { 0, 0, false, "the peer is too old" },
        { PROTOCOL_MAX + 1, PROTOCOL_MAX + 1, false, "this side is too old" },
        { PROTOCOL_MAX, 0, false, "no range" },
    };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct err err = { 0 };
        uint32_t version = 0;
        assert_int_equal(version_choose(cases[i].min, cases[i].max, &version, &err),
                         cases[i].chosen);
        assert_int_equal(version, cases[i].chosen ? PROTOCOL_MAX : 0);
        assert_non_null(strstr(err.text, cases[i].says));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_published_vectors_come_out),
        cmocka_unit_test(pieces_give_the_digest_of_the_whole),
        cmocka_unit_test(an_object_is_the_digest_of_the_list_of_its_slices),
        cmocka_unit_test(a_checksum_matches_only_its_own_bytes),
        cmocka_unit_test(the_newest_version_both_sides_know_is_chosen),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
