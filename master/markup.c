#include "master/markup.h"

#include <stddef.h>
#include <string.h>

/* What opens and closes a mark. In SVG a shift of the line lasts until the next one, which needs a
 * character to hang on: one without width. */
static const struct mark {
    char sign;
    const char *open[2], *close[2]; /* HTML, SVG */
} MARKS[] = {
    { '^',
      { "<sup>", "<tspan dy=\"-.45em\" font-size=\"75%\">" },
      { "</sup>", "</tspan><tspan dy=\".34em\">&#8203;</tspan>" } },
    { '_',
      { "<sub>", "<tspan dy=\".3em\" font-size=\"75%\">" },
      { "</sub>", "</tspan><tspan dy=\"-.23em\">&#8203;</tspan>" } },
    { '*', { "<em>", "<tspan font-style=\"italic\">" }, { "</em>", "</tspan>" } },
    { '`', { "<code>", "<tspan font-family=\"monospace\">" }, { "</code>", "</tspan>" } },
};

static void write_escaped(FILE *out, const char *text, size_t length)
{
    for (size_t i = 0; i < length; i++) {
        unsigned char c = (unsigned char)text[i];
        switch (c) {
        case '&':
            fputs("&amp;", out);
            break;
        case '<':
            fputs("&lt;", out);
            break;
        case '>':
            fputs("&gt;", out);
            break;
        case '"':
            fputs("&quot;", out);
            break;
        default:
            putc(c < ' ' && c != '\n' && c != '\t' ? ' ' : c, out);
        }
    }
}

/* The mark that opens at `text` and is closed further on, or NULL */
static const struct mark *mark_at(const char *text)
{
    for (size_t i = 0; i < sizeof(MARKS) / sizeof(MARKS[0]); i++)
        if (text[0] == MARKS[i].sign && text[1] == '{' && strchr(text, '}') != NULL)
            return &MARKS[i];
    return NULL;
}

void markup_write(FILE *out, const char *text, enum markup_into into)
{
    if (into == MARKUP_EXACT) {
        write_escaped(out, text, strlen(text));
        return;
    }
    while (*text != '\0') {
        const struct mark *mark = mark_at(text);
        if (mark == NULL) {
            write_escaped(out, text++, 1);
            continue;
        }
        text += 2;
        size_t length = (size_t)(strchr(text, '}') - text);
        if (into != MARKUP_PLAIN)
            fputs(mark->open[into], out);
        write_escaped(out, text, length);
        if (into != MARKUP_PLAIN)
            fputs(mark->close[into], out);
        text += length + 1;
    }
}
