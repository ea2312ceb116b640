/* Bytes: what was written is read back, and whatever is missing or left over is said. */
#include "common/bytes.h"
#include "common/err.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <string.h>

#include <cmocka.h>

static void write_everything(struct writer *out)
{
    const uint32_t words[3] = { 1, 0x80000000u, UINT32_MAX };
    const uint32_t signalling_nan = 0x7fa00001;
    float odd;
    memcpy(&odd, &signalling_nan, sizeof(odd));
    write_u8(out, 0xab);
    write_u16(out, 0x1234);
    write_u32(out, 0xdeadbeef);
    write_u64(out, UINT64_C(0x0123456789abcdef));
    write_f32s(out, &odd, 1);
    write_f64(out, -0.0);
    write_u32s(out, words, 3);
    bytes_write(out, "tail", 4);
}

static void every_type_comes_back_with_its_bits(void **state)
{
    (void)state;
    uint8_t bytes[64];
    struct writer out = writer_of(bytes, sizeof(bytes));
    write_everything(&out);
    assert_true(writer_done(&out));
    assert_int_equal(out.size, 1 + 2 + 4 + 8 + 4 + 8 + 12 + 4);

    struct reader in = reader_of(bytes, out.size);
    uint32_t words[3], odd_bits;
    float odd;
    assert_int_equal(read_u8(&in), 0xab);
    assert_int_equal(read_u16(&in), 0x1234);
    assert_int_equal(read_u32(&in), 0xdeadbeef);
    assert_true(read_u64(&in) == UINT64_C(0x0123456789abcdef));
    read_f32s(&in, &odd, 1);
    memcpy(&odd_bits, &odd, sizeof(odd_bits));
    assert_int_equal(odd_bits, 0x7fa00001);
    double zero = read_f64(&in);
    assert_true(zero == 0 && __builtin_signbit(zero));
    read_u32s(&in, words, 3);
    assert_int_equal(words[2], UINT32_MAX);
    assert_memory_equal(bytes_span(&in, 4), "tail", 4);
    assert_true(reader_done(&in, NULL));
}

static void numbers_are_little_endian(void **state)
{
    (void)state;
    uint8_t bytes[4];
    struct writer out = writer_of(bytes, sizeof(bytes));
    write_u32(&out, 0x01020304);
    assert_memory_equal(bytes, ((uint8_t[]){ 4, 3, 2, 1 }), 4);
}

static void a_writer_without_memory_measures(void **state)
{
    (void)state;
    uint8_t bytes[64];
    struct writer real = writer_of(bytes, sizeof(bytes)), measure = writer_of(NULL, 0);
    write_everything(&real);
    write_everything(&measure);
    assert_int_equal(measure.size, real.size);
    assert_false(writer_done(&measure));
}

static void a_full_writer_writes_nothing_more(void **state)
{
    (void)state;
    uint8_t bytes[8] = { 0 };
    struct writer out = writer_of(bytes, 6);
    write_u32(&out, 0x11111111);
    write_u32(&out, 0x22222222);
    write_u8(&out, 0x33); /* would fit, but after a hole */
    assert_false(writer_done(&out));
    assert_int_equal(out.size, 9);
    assert_memory_equal(bytes, ((uint8_t[]){ 0x11, 0x11, 0x11, 0x11, 0, 0, 0, 0 }), 8);
}

static void bad_lengths_are_refused_with_a_reason(void **state)
{
    (void)state;
    static const struct {
        const char *what;
        size_t size;
        const char *says;
    } cases[] = {
        { "nothing at all", 0, "ends early" },
        { "one byte less", 11, "ends early" },
        { "the right size", 12, NULL },
        { "one byte more", 13, "1 bytes left over" },
    };
    const uint8_t bytes[16] = { 0 };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++) {
        struct err err = { 0 };
        struct reader in = reader_of(cases[i].size > 0 ? bytes : NULL, cases[i].size);
        read_u32(&in);
        read_u64(&in);
        assert_int_equal(reader_done(&in, &err), cases[i].says == NULL);
        if (cases[i].says != NULL) {
            assert_int_equal(err.code, ERR_MESSAGE);
            assert_non_null(strstr(err.text, cases[i].says));
        }
    }
}

static void a_failed_reader_gives_zeros_and_keeps_its_first_reason(void **state)
{
    (void)state;
    const uint8_t bytes[6] = { 1, 1, 1, 1, 1, 1 };
    uint32_t words[2] = { 7, 7 };
    struct err err = { 0 };
    struct reader in = reader_of(bytes, sizeof(bytes));
    read_u32s(&in, words, 2);
    assert_int_equal(words[0], 0);
    assert_int_equal(words[1], 0);
    assert_int_equal(read_u8(&in), 0); /* there is a byte, but not for a reader that failed */
    assert_null(bytes_span(&in, 1));
    reader_fail(&in, "unknown flag");
    assert_false(reader_done(&in, &err));
    assert_string_equal(err.text, "ends early");
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_type_comes_back_with_its_bits),
        cmocka_unit_test(numbers_are_little_endian),
        cmocka_unit_test(a_writer_without_memory_measures),
        cmocka_unit_test(a_full_writer_writes_nothing_more),
        cmocka_unit_test(bad_lengths_are_refused_with_a_reason),
        cmocka_unit_test(a_failed_reader_gives_zeros_and_keeps_its_first_reason),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
