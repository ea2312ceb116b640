#include "master/pbrt_lexer.h"

#include "common/arena.h"
#include "common/err.h"

#include <errno.h>
#include <fcntl.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>
#include <zlib.h>

#define READ_SIZE (1 << 16)
#define DEPTH_MAX 64 /* of Includes in Includes */

struct source {
    struct source *outer;
    const char *path;
    const char *at, *end, *line_start;
    int line;
    char *bytes; /* when the lexer read it; kept until the lexer goes */
    dev_t device;
    ino_t inode;
};

struct pbrt_lexer {
    struct arena *arena;
    struct source *source; /* the innermost */
    const char *root;      /* the path of the first; NULL: text without a name */
    int depth;
    size_t bytes; /* of all of them */
    bool has_peeked;
    struct pbrt_token peeked;
};

struct pbrt_lexer *pbrt_lexer_new(void)
{
    struct pbrt_lexer *lexer = calloc(1, sizeof(*lexer));
    if (lexer == NULL)
        return NULL;
    lexer->arena = arena_new();
    if (lexer->arena == NULL) {
        free(lexer);
        return NULL;
    }
    return lexer;
}

void pbrt_lexer_free(struct pbrt_lexer *lexer)
{
    if (lexer == NULL)
        return;
    arena_free(lexer->arena);
    free(lexer);
}

static bool no_memory(struct err *err)
{
    return err_set(err, ERR_MEMORY, "no memory to read the scene");
}

/* The file's bytes, decompressed where it is gzip */
static bool slurp(int fd, uint64_t expected, char **bytes, size_t *length)
{
    size_t capacity = (size_t)expected + 1, used = 0;
    char *data = malloc(capacity);
    gzFile file = gzdopen(dup(fd), "rb");
    if (data == NULL || file == NULL)
        goto fail;
    gzbuffer(file, READ_SIZE);
    for (;;) {
        if (used == capacity) {
            char *larger = realloc(data, 2 * capacity);
            if (larger == NULL)
                goto fail;
            data = larger;
            capacity *= 2;
        }
        size_t room = capacity - used;
        int got = gzread(file, data + used, (unsigned)(room < (1u << 30) ? room : 1u << 30));
        if (got < 0)
            goto fail;
        if (got == 0)
            break;
        used += (size_t)got;
    }
    if (gzclose(file) != Z_OK) {
        free(data);
        return false;
    }
    *bytes = data;
    *length = used;
    return true;

fail:
    if (file != NULL)
        gzclose(file);
    free(data);
    return false;
}

static bool push(struct pbrt_lexer *lexer, const char *text, size_t length, const char *path,
                 struct source **pushed)
{
    struct source *source = arena_alloc(lexer->arena, 1, sizeof(*source));
    char *name = arena_text(lexer->arena, path, strlen(path));
    if (source == NULL || name == NULL)
        return false;
    *source = (struct source){ .outer = lexer->source,
                               .path = name,
                               .at = text,
                               .end = length > 0 ? text + length : text,
                               .line_start = text,
                               .line = 1 };
    if (lexer->source == NULL)
        lexer->root = name;
    lexer->source = source;
    lexer->depth++;
    lexer->bytes += length;
    *pushed = source;
    return true;
}

static bool open_error(const char *path, const struct source_pos *from, const char *why,
                       struct err *err)
{
    if (from == NULL)
        return err_set(err, ERR_SCENE, "%s: %s", path, why);
    return err_set(err, ERR_SCENE, "%s:%d:%d: %s: %s", from->path, from->line, from->column, path,
                   why);
}

bool pbrt_lexer_open(struct pbrt_lexer *lexer, const char *path, const struct source_pos *from,
                     struct err *err)
{
    if (lexer->depth == DEPTH_MAX)
        return open_error(path, from, "too many files that include each other", err);
    struct stat status;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK);
    if (fd < 0)
        return open_error(path, from, strerror(errno), err);
    if (fstat(fd, &status) != 0 || !S_ISREG(status.st_mode)) {
        close(fd);
        return open_error(path, from, "not a regular file", err);
    }
    for (const struct source *outer = lexer->source; outer != NULL; outer = outer->outer)
        if (outer->bytes != NULL && outer->device == status.st_dev &&
            outer->inode == status.st_ino) {
            close(fd);
            return open_error(path, from, "the file includes itself", err);
        }
    char *bytes;
    size_t length;
    bool read = slurp(fd, (uint64_t)status.st_size, &bytes, &length);
    close(fd);
    if (!read)
        return open_error(path, from, "cannot be read", err);
    if (!arena_adopt(lexer->arena, bytes, free)) {
        free(bytes);
        return no_memory(err);
    }
    struct source *source;
    if (!push(lexer, bytes, length, path, &source))
        return no_memory(err);
    source->bytes = bytes;
    source->device = status.st_dev;
    source->inode = status.st_ino;
    return true;
}

bool pbrt_lexer_open_text(struct pbrt_lexer *lexer, const char *text, size_t length,
                          const char *name, struct err *err)
{
    struct source *source;
    if (!push(lexer, text, length, name != NULL ? name : "text", &source))
        return no_memory(err);
    if (name == NULL)
        lexer->root = NULL;
    return true;
}

static bool is_space(char c)
{
    return c == ' ' || c == '\t' || c == '\n' || c == '\r' || c == '\f' || c == '\v';
}

static bool ends_word(char c)
{
    return is_space(c) || c == '"' || c == '[' || c == ']' || c == '#';
}

static void skip_blank(struct source *source)
{
    const char *at = source->at, *end = source->end;
    while (at < end) {
        if (*at == '\n') {
            source->line++;
            source->line_start = at + 1;
        } else if (*at == '#') {
            const char *newline = memchr(at, '\n', (size_t)(end - at));
            at = newline != NULL ? newline : end;
            continue;
        } else if (!is_space(*at)) {
            break;
        }
        at++;
    }
    source->at = at;
}

static bool scan(struct pbrt_lexer *lexer, struct pbrt_token *token, struct err *err)
{
    struct source *source = lexer->source;
    for (;;) {
        skip_blank(source);
        if (source->at < source->end || source->outer == NULL)
            break;
        lexer->source = source = source->outer;
        lexer->depth--;
    }
    const char *begin = source->at;
    token->pos = (struct source_pos){ source->path, source->line,
                                      (int)(begin - source->line_start) + 1 };
    token->text = begin;
    token->length = 1;
    if (begin == source->end) {
        token->kind = TOKEN_END;
        token->length = 0;
        return true;
    }
    const char *at = begin + 1;
    if (*begin == '[') {
        token->kind = TOKEN_OPEN;
    } else if (*begin == ']') {
        token->kind = TOKEN_CLOSE;
    } else if (*begin == '"') {
        while (at < source->end && *at != '"' && *at != '\n')
            at++;
        if (at == source->end || *at == '\n')
            return err_set(err, ERR_SCENE, "%s:%d:%d: a string without its closing quote",
                           token->pos.path, token->pos.line, token->pos.column);
        token->kind = TOKEN_STRING;
        token->text = begin + 1;
        token->length = (size_t)(at - begin - 1);
        at++;
    } else {
        while (at < source->end && !ends_word(*at))
            at++;
        token->kind = TOKEN_WORD;
        token->length = (size_t)(at - begin);
    }
    source->at = at;
    return true;
}

bool pbrt_lexer_next(struct pbrt_lexer *lexer, struct pbrt_token *token, struct err *err)
{
    if (!lexer->has_peeked)
        return scan(lexer, token, err);
    *token = lexer->peeked;
    lexer->has_peeked = false;
    return true;
}

bool pbrt_lexer_peek(struct pbrt_lexer *lexer, struct pbrt_token *token, struct err *err)
{
    if (!lexer->has_peeked && !scan(lexer, &lexer->peeked, err))
        return false;
    lexer->has_peeked = true;
    *token = lexer->peeked;
    return true;
}

/* `name` in the folder of `beside` */
static char *join(struct arena *arena, const char *beside, const char *name, size_t length)
{
    const char *slash = strrchr(beside, '/');
    size_t before = slash != NULL && (length == 0 || name[0] != '/') ? (size_t)(slash + 1 - beside)
                                                                     : 0;
    char *path = arena_alloc(arena, before + length + 1, 1);
    if (path == NULL)
        return NULL;
    memcpy(path, beside, before);
    memcpy(path + before, name, length);
    return path;
}

const char *pbrt_lexer_resolve(struct pbrt_lexer *lexer, const struct pbrt_token *name)
{
    if (lexer->root == NULL)
        return NULL;
    char *path = join(lexer->arena, name->pos.path, name->text, name->length);
    if (path == NULL || access(path, F_OK) == 0)
        return path;
    char *elsewhere = join(lexer->arena, lexer->root, name->text, name->length);
    return elsewhere != NULL && access(elsewhere, F_OK) == 0 ? elsewhere : path;
}

unsigned pbrt_lexer_depth(const struct pbrt_lexer *lexer)
{
    return (unsigned)lexer->depth;
}

size_t pbrt_lexer_bytes(const struct pbrt_lexer *lexer)
{
    return lexer->bytes;
}

bool pbrt_token_is(const struct pbrt_token *token, const char *text)
{
    return strlen(text) == token->length && memcmp(token->text, text, token->length) == 0;
}
