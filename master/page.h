/*
 * A self-contained HTML page: headings, paragraphs, tables, plots and pictures in one file that
 * refers to nothing outside itself. Pictures are data: URIs of PNG, plots are inline SVG, the style
 * is one element. Readable on paper and on a phone, in light and in dark.
 *
 * Text is plain UTF-8; whatever it holds is escaped, but for the marks of markup.h.
 *
 * The page remembers its first failure, so that a writer has no branches; page_save tells of it.
 * Used by one thread.
 */
#ifndef MASTER_PAGE_H
#define MASTER_PAGE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct image;
struct plot;
struct page;

#define PAGE_FORMAT(n) __attribute__((format(printf, n, n + 1)))

/* NULL when memory runs out; page_free(NULL) does nothing. The texts are marked up as all are. */
struct page *page_new(const char *title, const char *lead);
void page_free(struct page *page);

/* A heading that the list of contents at the top leads to, and one below it that is not listed. */
void page_section(struct page *page, const char *title);
void page_heading(struct page *page, const char *title);

void page_text(struct page *page, const char *format, ...) PAGE_FORMAT(2); /* a paragraph */
/* A boxed paragraph that opens with a word or two in bold: "Trap", "Result" */
void page_note(struct page *page, const char *label, const char *format, ...) PAGE_FORMAT(3);
/* Lines of a program as they are, without marks */
void page_code(struct page *page, const char *text);

/*
 * A table. Cells, and headings, are separated by tabs. Cells that begin as numbers are set to the
 * right, and headings as the first row's cells are.
 */
void page_table_begin(struct page *page, const char *caption, const char *headings);
void page_row(struct page *page, const char *format, ...) PAGE_FORMAT(2);
void page_table_end(struct page *page);

/*
 * Figures that stand side by side as long as there is room, each at least `width` wide (in CSS
 * pixels). Outside of a grid a figure has the width of the page. A caption may be NULL.
 */
void page_grid_begin(struct page *page, unsigned width);
void page_grid_end(struct page *page);

void page_plot(struct page *page, const struct plot *plot, const char *caption);
/* Channels R, G and B, linear, as png.h shows them; enlarged pixels stay square. NULL, a picture
 * that found no memory, is a failure. */
void page_picture(struct page *page, const struct image *image, const char *format, ...)
    PAGE_FORMAT(3);

/* The page as it is so far; the caller frees *text. False with the first failure there was. */
bool page_finish(struct page *page, char **text, size_t *size, struct err *err);
/* The same into a file that appears whole or not at all. */
bool page_save(struct page *page, const char *path, struct err *err);

#endif
