/*
 * Is a text of HTML or SVG well formed? Every element is closed in its order (but for HTML's void
 * ones), attributes are quoted, and < and & stand only where markup begins.
 */
#ifndef TESTS_BALANCED_H
#define TESTS_BALANCED_H

#include <ctype.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#define BALANCED_DEPTH 64

static inline bool balanced_is_void(const char *name, size_t length)
{
    static const char *const VOID[] = { "meta", "img", "br" };
    for (size_t i = 0; i < sizeof(VOID) / sizeof(VOID[0]); i++)
        if (strlen(VOID[i]) == length && strncmp(name, VOID[i], length) == 0)
            return true;
    return false;
}

/* The end of a tag that begins at `at` ("<name ..."), past its '>'; NULL where it is malformed */
static inline const char *balanced_tag_end(const char *at, bool *closes_itself)
{
    char quote = 0;
    for (at++; *at != '\0'; at++) {
        if (quote != 0) {
            if (*at == '<')
                return NULL;
            quote = *at == quote ? 0 : quote;
        } else if (*at == '"' || *at == '\'') {
            if (at[-1] != '=')
                return NULL;
            quote = *at;
        } else if (*at == '<') {
            return NULL;
        } else if (*at == '>') {
            *closes_itself = at[-1] == '/';
            return at + 1;
        }
    }
    return NULL;
}

/* NULL, or what is wrong, with some of the text where it is. */
static inline const char *balanced_fault(const char *text)
{
    static char fault[160];
    const char *open[BALANCED_DEPTH];
    size_t length[BALANCED_DEPTH], depth = 0;
    const char *why = "", *at = text;
    while (*at != '\0') {
        if (*at == '&') {
            size_t name = strspn(at + 1, "#abcdefghijklmnopqrstuvwxyz0123456789");
            why = "a bare &";
            if (name == 0 || at[1 + name] != ';')
                goto bad;
        }
        if (*at != '<') {
            at++;
            continue;
        }
        if (at[1] == '!') {
            at = strchr(at, '>');
            why = "an unclosed declaration";
            if (at++ == NULL)
                goto bad;
            continue;
        }
        bool closing = at[1] == '/', closes_itself = false;
        const char *name = at + 1 + closing, *end = balanced_tag_end(at, &closes_itself);
        size_t size = strcspn(name, " \t\n/>");
        why = "a malformed tag";
        if (end == NULL || !isalpha((unsigned char)*name))
            goto bad;
        why = "closed out of order";
        if (closing &&
            (depth == 0 || length[depth - 1] != size || strncmp(open[depth - 1], name, size) != 0))
            goto bad;
        why = "nested too deep";
        if (depth == BALANCED_DEPTH)
            goto bad;
        if (closing) {
            depth--;
        } else if (!closes_itself && !balanced_is_void(name, size)) {
            open[depth] = name;
            length[depth++] = size;
        }
        at = end;
    }
    if (depth == 0)
        return NULL;
    snprintf(fault, sizeof(fault), "never closed: %.80s", open[depth - 1]);
    return fault;

bad:
    snprintf(fault, sizeof(fault), "%s: %.80s", why, at == NULL ? "" : at);
    return fault;
}

#endif
