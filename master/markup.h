/*
 * Text on its way into HTML or SVG: escaped, with four marks that a writer may use, none of which
 * turns up in names and paths by chance: ^{above} and _{below} the line, *{emphasis}, `{code}.
 * They do not nest; one that is never closed stands as it is. Text is UTF-8; control characters but
 * tab and newline become a space, since neither format can hold them.
 */
#ifndef MASTER_MARKUP_H
#define MASTER_MARKUP_H

#include <stdio.h>

enum markup_into {
    MARKUP_HTML,
    MARKUP_SVG,   /* inside of <text> */
    MARKUP_PLAIN, /* in an attribute or a title: the marks vanish, what they hold stays */
    MARKUP_EXACT, /* marks are ordinary characters */
};

void markup_write(FILE *out, const char *text, enum markup_into into);

#endif
