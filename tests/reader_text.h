/*
 * For tests of the readers of scenes: pbrt text that must be good, or must be refused with a
 * reason, and what notes say. `path` is where the text pretends to come from; NULL: from nowhere.
 */
#ifndef TESTS_READER_TEXT_H
#define TESTS_READER_TEXT_H

#include "common/err.h"
#include "common/scene.h"
#include "master/pbrt.h"
#include "master/scene_notes.h"
#include "tests/expect.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

/* The scene of a text that must be good; its notes are the caller's (NULL: not wanted) */
static inline struct scene *reader_text_scene(const char *text, const char *path,
                                              struct scene_notes *notes)
{
    struct err err = { .text = "" };
    struct scene *scene = pbrt_read_text(text, strlen(text), path, NULL, notes, &err);
    if (scene == NULL || !scene_check(scene, &err))
        fail_msg("%s\nin: %s", err.text, text);
    return scene;
}

/* ERR_OK: whatever the code is */
static inline void reader_text_refused(const char *text, const char *path, enum err_code code,
                                       const char *why)
{
    struct err err = { .text = "" };
    struct scene *scene = pbrt_read_text(text, strlen(text), path, NULL, NULL, &err);
    bool wanted = scene == NULL && (code == ERR_OK || err.code == code);
    if (!wanted || strstr(err.text, why) == NULL)
        fail_msg("\"%s\"\ngave %s \"%s\"\nnot %s \"%s\"", text, err_name(err.code), err.text,
                 err_name(code), why);
}

/* How many notes say so */
static inline unsigned notes_saying(const struct scene_notes *notes, const char *what)
{
    unsigned lines = 0;
    for (size_t i = 0; i < notes->count; i++)
        lines += strstr(notes->lines[i], what) != NULL;
    return lines;
}

#endif
