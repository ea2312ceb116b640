/*
 * The picture, live, in a tev viewer. The viewer is a guest: whether it refuses, stalls or goes
 * away, the render does not notice. At most one picture is being sent and one, the newest, waits;
 * older ones are dropped. A lost viewer is mentioned once and not called again.
 *
 * Used from the event loop only; nothing here blocks. As for everything on libuv, the process
 * ignores SIGPIPE.
 */
#ifndef MASTER_TEV_H
#define MASTER_TEV_H

#include <stdint.h>
#include <uv.h>

struct image;
struct tev;

#define TEV_PORT 14158 /* where tev listens unless told otherwise */

/* Told once, when the viewer cannot be reached or is lost. */
typedef void (*tev_log_fn)(void *context, const char *text);

/*
 * Begin to connect to host:port; `name` is the picture's name in the viewer. `log` may be NULL.
 * NULL only when memory runs out.
 */
struct tev *tev_open(uv_loop_t *loop, const char *host, unsigned port, const char *name,
                     tev_log_fn log, void *log_context);

/* Show R, G and B of the image's data window. The pixels are copied. tev may be NULL. */
void tev_update(struct tev *tev, const struct image *image);

/*
 * Send what waits, for at most grace_ms, then disconnect. The memory goes once the loop has closed
 * the handles; `tev` and the log context are the caller's no longer. The viewer keeps the picture.
 * tev may be NULL.
 */
void tev_close(struct tev *tev, unsigned grace_ms);

#endif
