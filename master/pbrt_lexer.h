/*
 * pbrt text as tokens, through nested Includes. A token's text points into a file's bytes, which
 * live as long as the lexer. Part of the pbrt reader.
 */
#ifndef MASTER_PBRT_LEXER_H
#define MASTER_PBRT_LEXER_H

#include "master/source_pos.h"

#include <stdbool.h>
#include <stddef.h>

struct err;

enum pbrt_token_kind {
    TOKEN_END,    /* of all input */
    TOKEN_WORD,   /* a directive, a number, true, false */
    TOKEN_STRING, /* text without its quotes */
    TOKEN_OPEN,   /* [ */
    TOKEN_CLOSE,  /* ] */
};

struct pbrt_token {
    enum pbrt_token_kind kind;
    const char *text; /* not terminated */
    size_t length;
    struct source_pos pos;
};

struct pbrt_lexer;

/* NULL when memory runs out. */
struct pbrt_lexer *pbrt_lexer_new(void);
void pbrt_lexer_free(struct pbrt_lexer *lexer);

/* Continue with this file (or text, which must outlive the lexer) and come back at its end. A file
 * that is being read already is refused. `from` says who asked; NULL for the first file. */
bool pbrt_lexer_open(struct pbrt_lexer *lexer, const char *path, const struct source_pos *from,
                     struct err *err);
bool pbrt_lexer_open_text(struct pbrt_lexer *lexer, const char *text, size_t length,
                          const char *name, struct err *err);

/* Read the next token, or look at it without taking it. */
bool pbrt_lexer_next(struct pbrt_lexer *lexer, struct pbrt_token *token, struct err *err);
bool pbrt_lexer_peek(struct pbrt_lexer *lexer, struct pbrt_token *token, struct err *err);

/* The path of the file that a token names: in the folder of the file the token stands in or, when
 * there is none of that name, in the folder of the first file, where pbrt looks. NULL when memory
 * runs out or the first text has no name; belongs to the lexer. */
const char *pbrt_lexer_resolve(struct pbrt_lexer *lexer, const struct pbrt_token *name);

/* How many files are open inside each other; once their last token was taken, or peeked behind,
 * they are closed. */
unsigned pbrt_lexer_depth(const struct pbrt_lexer *lexer);

/* How much text there was so far, in bytes. */
size_t pbrt_lexer_bytes(const struct pbrt_lexer *lexer);

bool pbrt_token_is(const struct pbrt_token *token, const char *text);

#endif
