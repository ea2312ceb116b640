#include "master/tev.h"

#include "common/bytes.h"
#include "master/image.h"

#include <inttypes.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Rows travel in bands of about this size, so that a packet is small whatever the picture is. */
#define BAND_VALUES ((size_t)1 << 18)

enum packet_type { PACKET_CLOSE = 2, PACKET_CREATE = 4, PACKET_UPDATE = 6 };

static const char *const channel_names[3] = { "R", "G", "B" };

/* A copied picture: planes R, G, B. Empty when rgb is NULL. */
struct snapshot {
    uint32_t width, height;
    float *rgb;
};

struct tev {
    uv_getaddrinfo_t resolve;
    uv_tcp_t socket;
    uv_timer_t grace;
    uv_connect_t connect;
    uv_write_t write;
    unsigned open; /* handles and requests whose last callback is still to come */

    bool resolving, connected, writing, dropped;
    bool closing; /* tev_close was called: nobody holds `tev` but the loop */
    char *host, *name;
    tev_log_fn log;
    void *log_context;

    struct snapshot current, waiting;
    uint32_t next_row;                  /* of current */
    uint32_t shown_width, shown_height; /* of the picture the viewer was told to create */
    uint8_t *packet;                    /* being written */
};

static void release(struct tev *tev)
{
    if (--tev->open > 0)
        return;
    free(tev->current.rgb);
    free(tev->waiting.rgb);
    free(tev->packet);
    free(tev->host);
    free(tev->name);
    free(tev);
}

static void on_closed(uv_handle_t *handle)
{
    release(handle->data);
}

/* No more network; `why` is worth a line unless it is NULL. Waits for tev_close to let go. */
static void drop(struct tev *tev, const char *why)
{
    if (!tev->dropped) {
        tev->dropped = true;
        if (why != NULL && tev->log != NULL && !tev->closing) {
            char text[512];
            snprintf(text, sizeof(text), "tev viewer at %s: %s; rendering goes on without it",
                     tev->host, why);
            tev->log(tev->log_context, text);
        }
        if (tev->resolving)
            uv_cancel((uv_req_t *)&tev->resolve); /* fails when it runs already: fine */
        uv_close((uv_handle_t *)&tev->socket, on_closed);
    }
    if (tev->closing && !uv_is_closing((uv_handle_t *)&tev->grace))
        uv_close((uv_handle_t *)&tev->grace, on_closed);
}

static void on_grace_over(uv_timer_t *timer)
{
    drop(timer->data, NULL);
}

static void write_string(struct writer *out, const char *text)
{
    bytes_write(out, text, strlen(text) + 1);
}

static void write_close(struct writer *out, const char *name)
{
    write_u32(out, (uint32_t)(4 + 1 + strlen(name) + 1));
    write_u8(out, PACKET_CLOSE);
    write_string(out, name);
}

static void write_create(struct writer *out, const char *name, const struct snapshot *picture)
{
    write_u32(out, (uint32_t)(4 + 1 + 1 + strlen(name) + 1 + 3 * 4 + 3 * 2));
    write_u8(out, PACKET_CREATE);
    write_u8(out, 1); /* bring it to the front, once */
    write_string(out, name);
    write_u32(out, picture->width);
    write_u32(out, picture->height);
    write_u32(out, 3);
    for (int c = 0; c < 3; c++)
        write_string(out, channel_names[c]);
}

static void write_update(struct writer *out, const char *name, const struct snapshot *picture,
                         uint32_t row, uint32_t rows)
{
    size_t values = (size_t)picture->width * rows;
    write_u32(out, (uint32_t)(4 + 1 + 1 + strlen(name) + 1 + 4 + 3 * 2 + 4 * 4 + 3 * 16 +
                              3 * values * sizeof(float)));
    write_u8(out, PACKET_UPDATE);
    write_u8(out, 0);
    write_string(out, name);
    write_u32(out, 3);
    for (int c = 0; c < 3; c++)
        write_string(out, channel_names[c]);
    write_u32(out, 0);
    write_u32(out, row);
    write_u32(out, picture->width);
    write_u32(out, rows);
    for (uint64_t c = 0; c < 3; c++)
        write_u64(out, c * values);
    for (int c = 0; c < 3; c++)
        write_u64(out, 1);
    size_t pixels = (size_t)picture->width * picture->height;
    for (size_t c = 0; c < 3; c++)
        write_f32s(out, picture->rgb + c * pixels + (size_t)row * picture->width, values);
}

static void send_more(struct tev *tev);

static void on_written(uv_write_t *write, int status)
{
    struct tev *tev = write->data;
    tev->writing = false;
    free(tev->packet);
    tev->packet = NULL;
    if (status < 0 && status != UV_ECANCELED)
        drop(tev, uv_strerror(status));
    else if (!tev->dropped)
        send_more(tev);
    release(tev);
}

/* Take the next band of the current picture, or the waiting picture, or end if that was wanted. */
static void send_more(struct tev *tev)
{
    if (!tev->connected || tev->writing || tev->dropped)
        return;
    if (tev->current.rgb == NULL) {
        tev->current = tev->waiting;
        tev->waiting = (struct snapshot){ 0 };
        tev->next_row = 0;
    }
    const struct snapshot *picture = &tev->current;
    if (picture->rgb == NULL) {
        if (tev->closing)
            drop(tev, NULL);
        return;
    }

    /* First measure, then write; a picture of another size replaces the one that is there */
    bool create = tev->shown_width != picture->width || tev->shown_height != picture->height;
    size_t rows = BAND_VALUES / picture->width;
    rows = rows < 1 ? 1 : rows;
    if (rows > picture->height - tev->next_row)
        rows = picture->height - tev->next_row;
    struct writer out = writer_of(NULL, 0);
    for (int pass = 0; pass < 2; pass++) {
        if (create) {
            write_close(&out, tev->name);
            write_create(&out, tev->name, picture);
        }
        write_update(&out, tev->name, picture, tev->next_row, (uint32_t)rows);
        if (pass == 1)
            break;
        tev->packet = malloc(out.size);
        if (tev->packet == NULL) {
            drop(tev, "out of memory");
            return;
        }
        out = writer_of(tev->packet, out.size);
    }
    tev->shown_width = picture->width;
    tev->shown_height = picture->height;
    tev->next_row += (uint32_t)rows;
    if (tev->next_row == picture->height) {
        free(tev->current.rgb);
        tev->current = (struct snapshot){ 0 };
    }

    uv_buf_t buffer = uv_buf_init((char *)tev->packet, (unsigned)out.size);
    int status = uv_write(&tev->write, (uv_stream_t *)&tev->socket, &buffer, 1, on_written);
    if (status < 0) {
        drop(tev, uv_strerror(status));
        return;
    }
    tev->writing = true;
    tev->open++;
}

static void on_connected(uv_connect_t *connect, int status)
{
    struct tev *tev = connect->data;
    if (status < 0 && status != UV_ECANCELED) {
        drop(tev, uv_strerror(status));
    } else if (status == 0 && !tev->dropped) {
        tev->connected = true;
        send_more(tev);
    }
    release(tev);
}

static void on_resolved(uv_getaddrinfo_t *resolve, int status, struct addrinfo *address)
{
    struct tev *tev = resolve->data;
    tev->resolving = false;
    if (status == 0 && !tev->dropped)
        status = uv_tcp_connect(&tev->connect, &tev->socket, address->ai_addr, on_connected);
    if (status < 0 && !tev->dropped)
        drop(tev, uv_strerror(status));
    else if (status == 0 && !tev->dropped)
        tev->open++;
    uv_freeaddrinfo(address);
    release(tev);
}

struct tev *tev_open(uv_loop_t *loop, const char *host, unsigned port, const char *name,
                     tev_log_fn log, void *log_context)
{
    struct tev *tev = calloc(1, sizeof(*tev));
    if (tev == NULL)
        return NULL;
    tev->log = log;
    tev->log_context = log_context;
    tev->host = strdup(host);
    tev->name = strdup(name);
    if (tev->host == NULL || tev->name == NULL) {
        free(tev->host);
        free(tev->name);
        free(tev);
        return NULL;
    }
    tev->resolve.data = tev->connect.data = tev->write.data = tev;
    uv_timer_init(loop, &tev->grace);
    uv_tcp_init(loop, &tev->socket); /* makes no socket yet, so neither can fail */
    tev->grace.data = tev->socket.data = tev;
    tev->open = 2;

    char service[16];
    snprintf(service, sizeof(service), "%u", port);
    const struct addrinfo hints = { .ai_family = AF_UNSPEC, .ai_socktype = SOCK_STREAM };
    int status = uv_getaddrinfo(loop, &tev->resolve, on_resolved, host, service, &hints);
    if (status == 0) {
        tev->resolving = true;
        tev->open++;
    } else {
        drop(tev, uv_strerror(status));
    }
    return tev;
}

void tev_update(struct tev *tev, const struct image *image)
{
    if (tev == NULL || tev->dropped || image->width == 0 || image->height == 0)
        return;
    size_t pixels = (size_t)image->width * image->height;
    float *rgb = malloc(3 * pixels * sizeof(float));
    if (rgb == NULL)
        return; /* a picture less in the viewer; a later one may find memory */
    for (size_t c = 0; c < 3; c++) {
        const float *values = image_channel(image, channel_names[c]);
        if (values == NULL) {
            free(rgb);
            return;
        }
        memcpy(rgb + c * pixels, values, pixels * sizeof(float));
    }
    free(tev->waiting.rgb);
    tev->waiting = (struct snapshot){ image->width, image->height, rgb };
    send_more(tev);
}

void tev_close(struct tev *tev, unsigned grace_ms)
{
    if (tev == NULL)
        return;
    tev->closing = true;
    bool idle = tev->current.rgb == NULL && tev->waiting.rgb == NULL && !tev->writing;
    if (tev->dropped || idle || grace_ms == 0)
        drop(tev, NULL);
    else
        uv_timer_start(&tev->grace, on_grace_over, grace_ms, 0);
}
