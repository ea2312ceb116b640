#include "master/page.h"

#include "common/err.h"
#include "master/atomic_file.h"
#include "master/image.h"
#include "master/markup.h"
#include "master/plot.h"
#include "master/png.h"

#include <ctype.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct stream {
    FILE *file;
    char *text;
    size_t size;
};

struct page {
    char *title, *lead;
    struct stream body, contents;
    unsigned sections;
    char *headings; /* of the table that was begun: they wait for the first row */
    struct err why; /* the first failure */
};

static const char STYLE[] =
    ":root{color-scheme:light dark;--ink:#1c1c1c;--paper:#fff;--line:#ccc;--faint:#666;"
    "--box:#f3f4f1}\n"
    "@media(prefers-color-scheme:dark){:root{--ink:#e2e2e2;--paper:#161718;--line:#444;"
    "--faint:#a0a0a0;--box:#232527}}\n"
    "body{margin:0 auto;max-width:54rem;padding:1rem;background:var(--paper);color:var(--ink);"
    "font:1rem/1.5 system-ui,sans-serif}\n"
    "h1{line-height:1.2}\n"
    "h2{margin-top:3rem;border-top:1px solid var(--line);padding-top:1rem}\n"
    "nav{columns:18rem}nav a{display:block;color:inherit}\n"
    "code,pre{font-family:ui-monospace,monospace;font-size:.9em}\n"
    "pre{background:var(--box);padding:.7rem 1rem;overflow-x:auto}\n"
    ".note{background:var(--box);border-left:.25rem solid #c8741a;padding:.6rem 1rem}\n"
    ".wide{overflow-x:auto;margin:1rem 0}\n"
    "table{border-collapse:collapse;font-variant-numeric:tabular-nums}\n"
    "caption,figcaption{color:var(--faint);font-size:.9rem;text-align:left;padding:.2rem 0}\n"
    "th,td{text-align:left;padding:.15rem .8rem .15rem 0;vertical-align:top}\n"
    "th{border-bottom:1px solid var(--line);vertical-align:bottom}\n"
    ".n{text-align:right}td.n{white-space:nowrap}\n"
    "figure{margin:1rem 0;break-inside:avoid}.grid figure{margin:0}\n"
    ".grid{display:grid;gap:1rem;margin:1rem 0}\n"
    "img{display:block;width:100%;height:auto;image-rendering:pixelated}\n"
    "figure>svg{display:block;width:100%;height:auto}\n"
    "@media print{body{max-width:none;padding:0}h2{break-after:avoid}}\n";

static bool stream_open(struct stream *stream)
{
    stream->file = open_memstream(&stream->text, &stream->size);
    return stream->file != NULL;
}

static void stream_close(struct stream *stream)
{
    if (stream->file != NULL)
        fclose(stream->file);
    free(stream->text);
    *stream = (struct stream){ 0 };
}

struct page *page_new(const char *title, const char *lead)
{
    struct page *page = calloc(1, sizeof(*page));
    if (page == NULL)
        return NULL;
    page->title = strdup(title);
    page->lead = strdup(lead);
    if (page->title == NULL || page->lead == NULL || !stream_open(&page->body) ||
        !stream_open(&page->contents)) {
        page_free(page);
        return NULL;
    }
    return page;
}

void page_free(struct page *page)
{
    if (page == NULL)
        return;
    stream_close(&page->body);
    stream_close(&page->contents);
    free(page->headings);
    free(page->title);
    free(page->lead);
    free(page);
}

/* Remember the first failure. */
static void fail(struct page *page, const struct err *why)
{
    if (page->why.code == ERR_OK)
        page->why = *why;
}

static void fail_memory(struct page *page)
{
    fail(page, &(struct err){ .code = ERR_MEMORY, .text = "no memory for the page" });
}

/* Formatted and marked up; a text that finds no memory is a failure */
static void write_formatted(struct page *page, const char *format, va_list arguments)
{
    char *text;
    if (vasprintf(&text, format, arguments) < 0) {
        fail_memory(page);
        return;
    }
    markup_write(page->body.file, text, MARKUP_HTML);
    free(text);
}

void page_section(struct page *page, const char *title)
{
    page->sections++;
    fprintf(page->contents.file, "<a href=\"#s%u\">", page->sections);
    markup_write(page->contents.file, title, MARKUP_HTML);
    fputs("</a>\n", page->contents.file);
    fprintf(page->body.file, "<h2 id=\"s%u\">", page->sections);
    markup_write(page->body.file, title, MARKUP_HTML);
    fputs("</h2>\n", page->body.file);
}

void page_heading(struct page *page, const char *title)
{
    fputs("<h3>", page->body.file);
    markup_write(page->body.file, title, MARKUP_HTML);
    fputs("</h3>\n", page->body.file);
}

void page_text(struct page *page, const char *format, ...)
{
    fputs("<p>", page->body.file);
    va_list arguments;
    va_start(arguments, format);
    write_formatted(page, format, arguments);
    va_end(arguments);
    fputs("</p>\n", page->body.file);
}

void page_note(struct page *page, const char *label, const char *format, ...)
{
    fputs("<p class=\"note\"><strong>", page->body.file);
    markup_write(page->body.file, label, MARKUP_HTML);
    fputs(".</strong> ", page->body.file);
    va_list arguments;
    va_start(arguments, format);
    write_formatted(page, format, arguments);
    va_end(arguments);
    fputs("</p>\n", page->body.file);
}

void page_code(struct page *page, const char *text)
{
    fputs("<pre>", page->body.file);
    markup_write(page->body.file, text, MARKUP_EXACT);
    fputs("</pre>\n", page->body.file);
}

static bool is_numeric(const char *cell)
{
    cell += strspn(cell, "+-.");
    return isdigit((unsigned char)*cell);
}

/* The next cell of a row of them: cut off at its tab; NULL after the last */
static char *next_cell(char **rest)
{
    return strsep(rest, "\t");
}

/* The headings that waited, each set as the cell below it */
static void write_headings(struct page *page, const char *row)
{
    FILE *out = page->body.file;
    char *headings = page->headings, *rest = headings, *cell;
    fputs("<tr>", out);
    while ((cell = next_cell(&rest)) != NULL) {
        fprintf(out, "<th%s>", is_numeric(row) ? " class=\"n\"" : "");
        markup_write(out, cell, MARKUP_HTML);
        fputs("</th>", out);
        row += strcspn(row, "\t");
        row += *row == '\t';
    }
    fputs("</tr>\n", out);
    free(headings);
    page->headings = NULL;
}

void page_table_begin(struct page *page, const char *caption, const char *headings)
{
    free(page->headings);
    page->headings = strdup(headings);
    if (page->headings == NULL)
        fail_memory(page);
    fputs("<div class=\"wide\"><table>\n", page->body.file);
    if (caption != NULL) {
        fputs("<caption>", page->body.file);
        markup_write(page->body.file, caption, MARKUP_HTML);
        fputs("</caption>\n", page->body.file);
    }
}

void page_row(struct page *page, const char *format, ...)
{
    FILE *out = page->body.file;
    char *row;
    va_list arguments;
    va_start(arguments, format);
    int length = vasprintf(&row, format, arguments);
    va_end(arguments);
    if (length < 0) {
        fail_memory(page);
        return;
    }
    if (page->headings != NULL)
        write_headings(page, row);
    char *rest = row, *cell;
    fputs("<tr>", out);
    while ((cell = next_cell(&rest)) != NULL) {
        fprintf(out, "<td%s>", is_numeric(cell) ? " class=\"n\"" : "");
        markup_write(out, cell, MARKUP_HTML);
        fputs("</td>", out);
    }
    fputs("</tr>\n", out);
    free(row);
}

void page_table_end(struct page *page)
{
    if (page->headings != NULL) /* no row came */
        write_headings(page, "");
    fputs("</table></div>\n", page->body.file);
}

void page_grid_begin(struct page *page, unsigned width)
{
    fprintf(page->body.file,
            "<div class=\"grid\" style=\"grid-template-columns:"
            "repeat(auto-fill,minmax(min(100%%,%upx),1fr))\">\n",
            width);
}

void page_grid_end(struct page *page)
{
    fputs("</div>\n", page->body.file);
}

static void end_figure(struct page *page, const char *caption)
{
    FILE *out = page->body.file;
    if (caption != NULL) {
        fputs("<figcaption>", out);
        markup_write(out, caption, MARKUP_HTML);
        fputs("</figcaption>", out);
    }
    fputs("</figure>\n", out);
}

void page_plot(struct page *page, const struct plot *plot, const char *caption)
{
    fputs("<figure>", page->body.file);
    plot_write(plot, page->body.file);
    end_figure(page, caption);
}

static void write_base64(FILE *out, const uint8_t *bytes, size_t size)
{
    static const char DIGITS[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < size; i += 3) {
        size_t left = size - i;
        uint32_t three = (uint32_t)bytes[i] << 16;
        three |= left > 1 ? (uint32_t)bytes[i + 1] << 8 : 0;
        three |= left > 2 ? bytes[i + 2] : 0;
        putc(DIGITS[three >> 18], out);
        putc(DIGITS[three >> 12 & 63], out);
        putc(left > 1 ? DIGITS[three >> 6 & 63] : '=', out);
        putc(left > 2 ? DIGITS[three & 63] : '=', out);
    }
}

void page_picture(struct page *page, const struct image *image, const char *format, ...)
{
    FILE *out = page->body.file;
    if (image == NULL) {
        fail_memory(page);
        return;
    }
    char *caption = NULL;
    if (format != NULL) {
        va_list arguments;
        va_start(arguments, format);
        if (vasprintf(&caption, format, arguments) < 0) {
            caption = NULL;
            fail_memory(page);
        }
        va_end(arguments);
    }
    uint8_t *png;
    size_t size;
    struct err err = { 0 };
    if (!png_preview_encode(image, &png, &size, &err)) {
        fail(page, &err);
    } else {
        fputs("<figure><img alt=\"", out);
        markup_write(out, caption != NULL ? caption : "", MARKUP_PLAIN);
        fprintf(out, "\" width=\"%u\" height=\"%u\" src=\"data:image/png;base64,",
                image->display_width, image->display_height);
        write_base64(out, png, size);
        fputs("\">", out);
        end_figure(page, caption);
        free(png);
    }
    free(caption);
}

bool page_finish(struct page *page, char **text, size_t *size, struct err *err)
{
    /* fflush makes the streams' texts what was written to them */
    if (fflush(page->body.file) != 0 || fflush(page->contents.file) != 0 ||
        ferror(page->body.file) || ferror(page->contents.file))
        fail_memory(page);
    if (page->why.code != ERR_OK)
        return err_set(err, page->why.code, "%s", page->why.text);

    FILE *out = open_memstream(text, size);
    if (out == NULL)
        return err_set(err, ERR_MEMORY, "no memory for the page");
    fputs("<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n"
          "<meta name=\"viewport\" content=\"width=device-width,initial-scale=1\">\n<title>",
          out);
    markup_write(out, page->title, MARKUP_PLAIN);
    fprintf(out, "</title>\n<style>\n%s</style>\n</head>\n<body>\n<h1>", STYLE);
    markup_write(out, page->title, MARKUP_HTML);
    fputs("</h1>\n<p>", out);
    markup_write(out, page->lead, MARKUP_HTML);
    fputs("</p>\n", out);
    if (page->sections > 1)
        fprintf(out, "<nav>\n%s</nav>\n", page->contents.text);
    fwrite(page->body.text, 1, page->body.size, out);
    fputs("</body>\n</html>\n", out);
    bool whole = !ferror(out);
    if (fclose(out) != 0 || !whole) {
        free(*text);
        return err_set(err, ERR_MEMORY, "no memory for the page");
    }
    return true;
}

bool page_save(struct page *page, const char *path, struct err *err)
{
    char *text;
    size_t size;
    if (!page_finish(page, &text, &size, err))
        return err_wrap(err, "%s", path);
    bool saved = atomic_file_write(path, text, size, err);
    free(text);
    return saved;
}
