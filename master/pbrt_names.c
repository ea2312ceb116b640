#include "master/pbrt_names.h"

#include "master/pbrt_reader.h"

#include <ctype.h>
#include <stdint.h>
#include <string.h>

#define LENGTH_MAX 64 /* longer names are compared by their beginnings */

/* Levenshtein's distance, without regard to case */
static size_t edit_distance(const char *a, size_t a_length, const char *b, size_t b_length)
{
    size_t row[LENGTH_MAX + 1];
    a_length = a_length < LENGTH_MAX ? a_length : LENGTH_MAX;
    b_length = b_length < LENGTH_MAX ? b_length : LENGTH_MAX;
    for (size_t j = 0; j <= b_length; j++)
        row[j] = j;
    for (size_t i = 1; i <= a_length; i++) {
        size_t diagonal = row[0];
        row[0] = i;
        for (size_t j = 1; j <= b_length; j++) {
            bool same = tolower((unsigned char)a[i - 1]) == tolower((unsigned char)b[j - 1]);
            size_t best = diagonal + (same ? 0 : 1);
            best = row[j] + 1 < best ? row[j] + 1 : best;
            best = row[j - 1] + 1 < best ? row[j - 1] + 1 : best;
            diagonal = row[j];
            row[j] = best;
        }
    }
    return row[b_length];
}

const struct pbrt_name *pbrt_names_find(const struct pbrt_name *names, size_t count,
                                        const struct pbrt_token *token)
{
    for (size_t i = 0; i < count; i++)
        if (pbrt_token_is(token, names[i].text))
            return &names[i];
    return NULL;
}

size_t pbrt_names_distance(const char *string, const char *text, size_t length)
{
    return edit_distance(string, strlen(string), text, length);
}

const char *pbrt_names_nearest_of(const char *const *names, size_t count, const char *text,
                                  size_t length)
{
    const char *nearest = NULL;
    size_t least = SIZE_MAX;
    for (size_t i = 0; i < count; i++) {
        size_t distance = pbrt_names_distance(names[i], text, length);
        if (distance < least) {
            least = distance;
            nearest = names[i];
        }
    }
    return nearest;
}

const char *pbrt_names_nearest(const struct pbrt_name *names, size_t count,
                               const struct pbrt_token *token)
{
    const char *ours[64];
    size_t kept = 0;
    for (size_t i = 0; i < count && kept < sizeof(ours) / sizeof(ours[0]); i++)
        if (names[i].state == NAME_OURS)
            ours[kept++] = names[i].text;
    return pbrt_names_nearest_of(ours, kept, token->text, token->length);
}

bool pbrt_names_choose(struct pbrt_reader *reader, const char *kind, const struct pbrt_name *names,
                       size_t count, const struct pbrt_token *token, const struct pbrt_name **found)
{
    const struct pbrt_name *name = pbrt_names_find(names, count, token);
    int length = (int)(token->length < 100 ? token->length : 100);
    *found = NULL;
    if (name == NULL)
        return pbrt_report_error(reader, &token->pos, "unknown %s \"%.*s\"; the nearest is \"%s\"",
                                 kind, length, token->text,
                                 pbrt_names_nearest(names, count, token));
    if (name->state == NAME_OLD)
        return pbrt_report_error(reader, &token->pos, "%s \"%s\" is of pbrt-v3: %s", kind,
                                 name->text, name->hint);
    if (name->state == NAME_LATER)
        return pbrt_report_later(reader, &token->pos, "%s \"%s\"", kind, name->text);
    *found = name;
    return true;
}
