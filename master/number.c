#include "master/number.h"

#include <ctype.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static const double powers_of_ten[] = { 1e0,  1e1,  1e2,  1e3,  1e4,  1e5,  1e6,  1e7,
                                        1e8,  1e9,  1e10, 1e11, 1e12, 1e13, 1e14, 1e15,
                                        1e16, 1e17, 1e18, 1e19, 1e20, 1e21, 1e22 };

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

/* What the fast way cannot round: strtod, on a copy that ends in a zero byte */
static bool parse_slowly(const char *begin, const char *end, double *value)
{
    char stack[128];
    size_t length = (size_t)(end - begin);
    char *text = length < sizeof(stack) ? stack : malloc(length + 1);
    if (text == NULL)
        return false;
    memcpy(text, begin, length);
    text[length] = '\0';
    char *parsed;
    *value = strtod(text, &parsed);
    bool whole = parsed == text + length;
    if (text != stack)
        free(text);
    return whole;
}

static bool parse_word(const char *begin, const char *end, bool negative, double *value)
{
    size_t length = (size_t)(end - begin);
    if ((length == 3 && strncasecmp(begin, "inf", 3) == 0) ||
        (length == 8 && strncasecmp(begin, "infinity", 8) == 0))
        *value = negative ? -INFINITY : INFINITY;
    else if (length == 3 && strncasecmp(begin, "nan", 3) == 0)
        *value = NAN;
    else
        return false;
    return true;
}

bool number_parse(const char *begin, const char *end, double *value)
{
    const char *at = begin;
    bool negative = at < end && *at == '-';
    if (at < end && (*at == '-' || *at == '+'))
        at++;
    if (at < end && isalpha((unsigned char)*at))
        return parse_word(at, end, negative, value);

    uint64_t digits = 0;
    int count = 0, exponent = 0; /* count: significant digits taken */
    bool any = false, exact = true;
    for (; at < end && is_digit(*at); at++) {
        any = true;
        if (count < 18) {
            digits = 10 * digits + (uint64_t)(*at - '0');
            count += digits != 0;
        } else {
            exact = false;
        }
    }
    if (at < end && *at == '.') {
        for (at++; at < end && is_digit(*at); at++) {
            any = true;
            if (count < 18) {
                digits = 10 * digits + (uint64_t)(*at - '0');
                count += digits != 0;
                exponent -= exponent > -1000;
            } else {
                exact = exact && *at == '0';
            }
        }
    }
    if (!any)
        return false;
    if (at < end && (*at == 'e' || *at == 'E')) {
        at++;
        bool down = at < end && *at == '-';
        if (at < end && (*at == '-' || *at == '+'))
            at++;
        if (at == end || !is_digit(*at))
            return false;
        int written = 0;
        for (; at < end && is_digit(*at); at++)
            written = written < 10000 ? 10 * written + (*at - '0') : written;
        exponent += down ? -written : written;
    }
    if (at != end)
        return false;

    /* An integer below 2^53 times or over an exact power of ten rounds once: correctly */
    if (!exact || digits > UINT64_C(1) << 53 || exponent < -22 || exponent > 22)
        return parse_slowly(begin, end, value);
    double magnitude = (double)digits;
    magnitude = exponent < 0 ? magnitude / powers_of_ten[-exponent]
                             : magnitude * powers_of_ten[exponent];
    *value = negative ? -magnitude : magnitude;
    return true;
}
