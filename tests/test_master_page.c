/* Goal: a page holds everything it shows, refers to nothing outside itself, and turns no text into
 * markup that was not meant as such. */
#include "common/err.h"
#include "master/image.h"
#include "master/page.h"
#include "master/plot.h"
#include "master/png.h"
#include "tests/balanced.h"
#include "tests/scratch.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

static char *text_of(struct page *page)
{
    char *text;
    size_t size;
    struct err err = { 0 };
    if (!page_finish(page, &text, &size, &err))
        fail_msg("%s", err.text);
    assert_int_equal(strlen(text), size);
    return text;
}

static struct image *gradient(void)
{
    struct image *image = image_new(5, 3);
    float *r = image_add_channel(image, "R");
    float *g = image_add_channel(image, "G");
    image_add_channel(image, "B");
    for (int i = 0; i < 15; i++) {
        r[i] = (float)i / 14;
        g[i] = 1 - r[i];
    }
    return image;
}

/* A page with one of everything */
static struct page *full_page(void)
{
    const double x[] = { 1, 2, 3 };
    const struct plot_series series = { "line", PLOT_LINE, 3, x, x, NULL };
    struct image *image = gradient();
    struct page *page = page_new("A *{title} & more", "Its lead <here>");
    page_section(page, "First");
    page_heading(page, "Below");
    page_text(page, "N^{-1/2}, k_{d}, `{a < b}, %d %%, ^{never closed", 42);
    page_note(page, "Trap", "%s", "<script>alert(\"&\")</script>");
    page_code(page, "if (a < b && c)\n    ^{stays}");
    page_table_begin(page, "caption", "name\tvalue\tremark");
    page_row(page, "%s\t%.2f\t%s", "a<b", 1.5, "-");
    page_row(page, "b\t-3 %%\t+x");
    page_table_end(page);
    page_section(page, "Second");
    page_grid_begin(page, 200);
    page_plot(page, &(struct plot){ .title = "p", .series = &series, .series_count = 1 }, "plot");
    page_picture(page, image, "picture %d & \"quotes\"", 1);
    page_grid_end(page);
    image_free(image);
    return page;
}

static void a_page_is_well_formed_and_needs_nothing_else(void **state)
{
    (void)state;
    struct page *page = full_page();
    char *text = text_of(page);
    const char *fault = balanced_fault(text);
    if (fault != NULL)
        fail_msg("%s", fault);
    assert_null(strstr(text, "url("));
    assert_null(strstr(text, "@import"));
    assert_null(strstr(text, "<script"));
    assert_null(strstr(text, "<link"));
    for (const char *at = text; (at = strstr(at, "http")) != NULL; at++) /* a name, not a place */
        assert_memory_equal(at - 7, "xmlns=\"http://www.w3.org/2000/svg\"", 34);
    for (const char *at = text; (at = strstr(at, "src=")) != NULL; at++)
        assert_memory_equal(at, "src=\"data:image/png;base64,", 27);
    for (const char *at = text; (at = strstr(at, "href=")) != NULL; at++)
        assert_memory_equal(at, "href=\"#s", 8);
    free(text);
    page_free(page);
}

static void text_is_escaped_and_marks_are_understood(void **state)
{
    (void)state;
    static const char *const wanted[] = {
        "<title>A title &amp; more</title>",
        "<h1>A <em>title</em> &amp; more</h1>",
        "<p>Its lead &lt;here&gt;</p>",
        "N<sup>-1/2</sup>, k<sub>d</sub>, <code>a &lt; b</code>, 42 %, ^{never closed",
        "<strong>Trap.</strong> &lt;script&gt;alert(&quot;&amp;&quot;)&lt;/script&gt;",
        "<pre>if (a &lt; b &amp;&amp; c)\n    ^{stays}</pre>",
        "alt=\"picture 1 &amp; &quot;quotes&quot;\"",
        "<a href=\"#s2\">Second</a>",
        "<h2 id=\"s2\">Second</h2>",
    };
    struct page *page = full_page();
    char *text = text_of(page);
    for (size_t i = 0; i < sizeof(wanted) / sizeof(wanted[0]); i++)
        if (strstr(text, wanted[i]) == NULL)
            fail_msg("not on the page: %s", wanted[i]);
    free(text);
    page_free(page);
}

static void numbers_stand_to_the_right_and_so_do_their_headings(void **state)
{
    (void)state;
    struct page *page = full_page();
    char *text = text_of(page);
    assert_non_null(strstr(text, "<tr><th>name</th><th class=\"n\">value</th><th>remark</th></tr>\n"
                                 "<tr><td>a&lt;b</td><td class=\"n\">1.50</td><td>-</td></tr>\n"
                                 "<tr><td>b</td><td class=\"n\">-3 %</td><td>+x</td></tr>\n"));
    free(text);
    page_free(page);
}

static int digit_of(char c)
{
    return c >= 'A' && c <= 'Z'   ? c - 'A'
           : c >= 'a' && c <= 'z' ? c - 'a' + 26
           : c >= '0' && c <= '9' ? c - '0' + 52
           : c == '+'             ? 62
                                  : 63;
}

static void a_picture_is_the_preview_in_base64(void **state)
{
    (void)state;
    struct page *page = full_page();
    char *text = text_of(page);
    struct image *image = gradient();
    uint8_t *png;
    size_t size;
    assert_true(png_preview_encode(image, &png, &size, NULL));

    const char *at = strstr(text, "base64,") + 7;
    for (size_t i = 0; i < size; i++) {
        const char *four = at + i / 3 * 4;
        uint32_t three = 0;
        for (int c = 0; c < 4; c++)
            three = three << 6 | (uint32_t)(four[c] == '=' ? 0 : digit_of(four[c]));
        assert_int_equal((uint8_t)(three >> (16 - 8 * (i % 3))), png[i]);
    }
    assert_int_equal(at[(size + 2) / 3 * 4], '"');
    assert_int_equal(at[(size + 2) / 3 * 4 - 1] == '=', size % 3 != 0);
    image_free(image);
    free(png);
    free(text);
    page_free(page);
}

static void the_same_calls_make_the_same_bytes(void **state)
{
    (void)state;
    struct page *a = full_page(), *b = full_page();
    char *text_a = text_of(a), *text_b = text_of(b), *again = text_of(a);
    assert_string_equal(text_a, text_b);
    assert_string_equal(text_a, again);
    free(text_a);
    free(text_b);
    free(again);
    page_free(a);
    page_free(b);
}

static void the_first_failure_is_told_at_the_end(void **state)
{
    (void)state;
    char folder[256];
    scratch_make(folder);
    struct page *page = page_new("title", "lead");
    struct image *grey = image_new(2, 2);
    image_add_channel(grey, "Y");
    page_picture(page, grey, "no colours");
    page_text(page, "and on it goes");
    struct err err = { 0 };
    const char *path = scratch_path(folder, "page.html");
    assert_false(page_save(page, path, &err));
    assert_non_null(strstr(err.text, "no channels R, G and B"));
    assert_int_equal(access(path, F_OK), -1);
    image_free(grey);
    page_free(page);

    page = full_page();
    assert_true(page_save(page, path, NULL));
    assert_int_equal(access(path, R_OK), 0);
    err_clear(&err);
    assert_false(page_save(page, scratch_path(folder, "nowhere/page.html"), &err));
    assert_int_equal(err.code, ERR_IO);
    page_free(page);
    scratch_remove(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_page_is_well_formed_and_needs_nothing_else),
        cmocka_unit_test(text_is_escaped_and_marks_are_understood),
        cmocka_unit_test(numbers_stand_to_the_right_and_so_do_their_headings),
        cmocka_unit_test(a_picture_is_the_preview_in_base64),
        cmocka_unit_test(the_same_calls_make_the_same_bytes),
        cmocka_unit_test(the_first_failure_is_told_at_the_end),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
