/*
 * Errors that say what, where, and what happens next. One list gives each code its fixed wire
 * number, the master's reaction when a worker reports it, and its text.
 *
 * A function that can fail takes `struct err *err` last and returns false (or NULL) through
 * err_set, so that reporting is one statement. Callers add their own context with err_wrap.
 * `err` may be NULL where the caller does not care. Thread: an err belongs to one thread.
 */
#ifndef COMMON_ERR_H
#define COMMON_ERR_H

#include <stdbool.h>
#include <stddef.h>

/* What the master does about an error that a worker reports. */
enum err_reaction {
    GIVE_UP, /* the job cannot work; it fails with this reason */
    REQUEUE, /* nobody's fault: the nodes go back to the queue */
    COUNT,   /* counts against the unit: three different workers fail the job */
    UNFIT,   /* this worker is not eligible for this job; its nodes go back */
    HANG_UP, /* the peer cannot be trusted to speak: disconnect */
};

#define ERR_MAP(X) /* name, wire number (never reused), what the master does next, meaning */ \
    X(OK, 0, REQUEUE, "no error")                                                             \
    X(MEMORY, 1, UNFIT, "out of memory")                                                      \
    X(IO, 2, COUNT, "input or output failed")                                                 \
    X(ARGUMENT, 3, GIVE_UP, "an argument is wrong")                                           \
    X(CANCELLED, 4, REQUEUE, "the operation was cancelled")                                   \
    X(SCENE, 10, GIVE_UP, "scene text does not describe a scene")                             \
    X(UNSUPPORTED, 11, GIVE_UP, "the scene asks for something not supported yet")             \
    X(RENDER, 12, COUNT, "rendering a node failed")                                           \
    X(PEER, 20, REQUEUE, "the peer went away")                                                \
    X(MESSAGE, 21, HANG_UP, "the peer broke the wire protocol")                               \
    X(AUTH, 22, HANG_UP, "the peer could not prove who it is")                                \
    X(PROFILE, 23, UNFIT, "the numeric profile differs from the job's")                       \
    X(DIGEST, 24, COUNT, "bytes do not match their digest")                                   \
    X(TIMEOUT, 25, REQUEUE, "the peer stayed silent for too long")                            \
    X(LIMIT, 26, HANG_UP, "a size limit was exceeded")                                        \
    X(INTERNAL, 30, COUNT, "a bug in pathfarm")

enum err_code {
#define X(name, number, reaction, text) ERR_##name = number,
    ERR_MAP(X)
#undef X
};

struct err {
    enum err_code code;
    char text[1024]; /* a sentence without a full stop; long texts are cut with an ellipsis */
};

/*
 * err_set(err, code, format, ...) records an error, err_wrap(err, format, ...) puts "context: " in
 * front of one that is already set. Both are expressions with the value false, and the compiler
 * knows it: that keeps it from suspecting values that are only read after success.
 */
#define err_set(err, code, ...) err_failed(err_record((err), (code), __VA_ARGS__))
#define err_wrap(err, ...)      err_failed(err_context((err), __VA_ARGS__))

static inline bool err_failed(bool recorded)
{
    (void)recorded;
    return false;
}

bool err_record(struct err *err, enum err_code code, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
bool err_context(struct err *err, const char *format, ...) __attribute__((format(printf, 2, 3)));

/* Forget an error, so that the struct can be used again. */
void err_clear(struct err *err);

const char *err_name(enum err_code code);    /* "SCENE" */
const char *err_meaning(enum err_code code); /* the list's text; "unknown error" for others */
enum err_reaction err_reaction(enum err_code code);

/* The code with this wire number; false, and *code untouched, for a number nobody gave out. */
bool err_from_wire(unsigned number, enum err_code *code);

#endif
