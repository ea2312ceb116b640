/*
 * What people and scripts see of a render while it runs and afterwards: the progress line, the
 * report, and the tev viewer, which here is a server in the same event loop.
 */
#include "common/bytes.h"
#include "common/err.h"
#include "common/job.h"
#include "master/cmd_selftest.h"
#include "master/image.h"
#include "master/progress.h"
#include "master/report.h"
#include "master/tev.h"

#include <jansson.h>
#include <math.h>
#include <setjmp.h>
#include <signal.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include <cmocka.h>

/* ---- progress ---- */

static void the_progress_line_is_made_for_readers(void **state)
{
    (void)state;
    static const struct {
        struct progress_state state;
        const char *text;
    } rows[] = {
        { { 0.4204, 64, 1.7, 2, 0.01234, 65 },
          " 42.0 %  64 spp  1.70 Mpaths/s  2 workers  error 0.0123  1 m 05 s left" },
        { { 0.99999, 1, 0, 1, NAN, 0.2 },
          " 99.9 %  1 spp  0.00 Mpaths/s  1 worker  error unknown  1 s left" },
        { { 1, 4096, 12.345, 0, 0, 0 },
          "100.0 %  4096 spp  12.35 Mpaths/s  0 workers  error 0  0 s left" },
        { { -1, 0, 0, 0, NAN, -1 },
          "   - %  0 spp  0.00 Mpaths/s  0 workers  error unknown  - left" },
        { { 0.5, 8, 1, 1, INFINITY, 8100 },
          " 50.0 %  8 spp  1.00 Mpaths/s  1 worker  error unknown  2 h 15 m left" },
    };
    for (size_t i = 0; i < sizeof(rows) / sizeof(rows[0]); i++) {
        char text[160];
        assert_string_equal(progress_text(&rows[i].state, text, sizeof(text)), rows[i].text);
    }
}

static size_t count_of(const char *text, const char *part)
{
    size_t count = 0;
    for (; (text = strstr(text, part)) != NULL; text++)
        count++;
    return count;
}

static void a_terminal_has_one_line_that_is_rewritten(void **state)
{
    (void)state;
    char *text;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    const struct progress_state half = { 0.5, 8, 1, 2, NAN, 9 };
    struct progress progress;
    progress_open(&progress, out, true, 1000);
    for (uint64_t now = 1000; now < 2000; now += 10)
        progress_show(&progress, &half, now);
    assert_int_equal(count_of(text, "spp"), 5);
    assert_int_equal(count_of(text, "\n"), 0);
    progress_say(&progress, "worker %s joined", "elm");
    assert_non_null(strstr(text, "\r\033[Kworker elm joined\n"));
    progress_close(&progress, &half);
    assert_int_equal(text[size - 1], '\n');
    assert_int_equal(count_of(text, "\n"), 2);
    fclose(out);
    free(text);
}

static void a_log_has_plain_lines_at_growing_intervals(void **state)
{
    (void)state;
    char *text;
    size_t size;
    FILE *out = open_memstream(&text, &size);
    const struct progress_state half = { 0.5, 8, 1, 2, NAN, 9 };
    struct progress progress;
    progress_open(&progress, out, false, 0);
    for (uint64_t now = 0; now < 3600 * 1000; now += 100)
        progress_show(&progress, &half, now);
    assert_in_range(count_of(text, "\n"), 60, 66); /* 2, 6, 14, 30, 62 s, then every minute */
    assert_int_equal(count_of(text, "\r") + count_of(text, "\033"), 0);
    fclose(out);
    free(text);
}

/* ---- report ---- */

static double real_at(json_t *root, const char *key, const char *inner)
{
    json_t *value = json_object_get(root, key);
    if (inner != NULL)
        value = json_object_get(value, inner);
    if (!json_is_number(value))
        fail_msg("%s %s is not a number", key, inner != NULL ? inner : "");
    return json_number_value(value);
}

static void the_report_is_json_and_says_unknown_as_null(void **state)
{
    (void)state;
    const struct report_worker workers[2] = {
        { .host = "elm", .build = "0.1.0", .cores = 8, .nodes = 12, .core_seconds = 3.5 },
        { .host = "bad \xff name", .build = NULL, .cores = 2, .lost = true },
    };
    const struct ledger_row ledger[2] = {
        { .round = 0,
          .spp = 16,
          .wall_s = 1,
          .core_s = 2,
          .accuracy = { .verdict = ACCURACY_FEW_SAMPLES, .rmse = 0.5 } },
        { .round = 1,
          .spp = 32,
          .wall_s = 2,
          .core_s = 4,
          .truncated_energy = 0.25,
          .accuracy = { .verdict = ACCURACY_KNOWN,
                        .rmse = 0.25,
                        .relmse = 0.125,
                        .rmse95 = { 0.2, INFINITY } } },
    };
    struct render_report report = {
        .command = "pathfarm render \"a.pbrt\"",
        .seed = UINT64_MAX,
        .spp = 32,
        .techniques_off = TECHNIQUE_MIS,
        .stats = { .samples = 100,
                   .rays_closest = 300,
                   .rays_shadow = 200,
                   .nonfinite = { 1, 2, 3 },
                   .truncated_paths = 4,
                   .truncated_energy = 50 },
        .accuracy = ledger[1].accuracy,
        .workers = workers,
        .worker_count = 2,
        .nodes_reissued = 7,
        .ledger = ledger,
        .ledger_count = 2,
        .wall_seconds = NAN,
    };
    report.job_digest.bytes[0] = 0xab;

    char *text = report_json(&report);
    assert_non_null(text);
    json_t *root = json_loads(text, 0, NULL);
    assert_non_null(root);
    assert_string_equal(json_string_value(json_object_get(root, "command")), report.command);
    const json_t *off = json_object_get(root, "techniques_off");
    assert_int_equal(json_array_size(off), 1);
    assert_string_equal(json_string_value(json_array_get(off, 0)), "mis");
    assert_string_equal(json_string_value(json_object_get(root, "seed")), "18446744073709551615");
    assert_memory_equal(json_string_value(json_object_get(root, "job_digest")), "ab00", 4);
    assert_true(json_is_null(json_object_get(root, "wall_seconds")));
    assert_true(real_at(root, "camera_paths", NULL) == 100);
    assert_true(real_at(root, "rays", "closest") == 300);
    assert_true(real_at(root, "nonfinite_samples", "negative") == 3);
    assert_true(real_at(root, "truncated", "energy_per_path") == 0.5);
    assert_true(real_at(root, "nodes", "reissued") == 7);
    assert_true(real_at(root, "error", "rmse") == 0.25);
    json_t *interval = json_object_get(json_object_get(root, "error"), "rmse_95");
    assert_true(json_is_null(json_array_get(interval, 1)));
    assert_int_equal(json_array_size(json_object_get(root, "workers")), 2);

    json_t *rows = json_object_get(root, "ledger");
    assert_int_equal(json_array_size(rows), 2);
    json_t *error = json_object_get(json_array_get(rows, 0), "error");
    assert_true(json_is_true(json_object_get(error, "unknown")));
    assert_true(json_is_null(json_object_get(error, "rmse"))); /* not the small number it had */
    assert_true(json_is_string(json_object_get(error, "why")));
    assert_true(real_at(json_array_get(rows, 1), "spp", NULL) == 32);
    json_decref(root);
    free(text);
}

/* ---- tev ---- */

/* A viewer that takes packets apart and keeps the picture. */
struct viewer {
    uv_loop_t loop;
    uv_tcp_t server, client;
    uv_timer_t clock;
    bool connected, gone;
    uint8_t bytes[1 << 22];
    size_t size;
    unsigned closes, creates, updates;
    uint32_t width, height;
    float *rgb; /* interleaved, so that strides and offsets matter */
    char name[64];
    bool wrong;
};

static void read_text(struct reader *in, char *text, size_t capacity)
{
    size_t length = 0;
    for (char c; (c = (char)read_u8(in)) != '\0' && in->failure == NULL;)
        if (length + 1 < capacity)
            text[length++] = c;
    text[length] = '\0';
}

static void take_packet(struct viewer *viewer, const uint8_t *bytes, size_t size)
{
    struct reader in = reader_of(bytes, size);
    char text[64];
    switch (read_u8(&in)) {
    case 2:
        read_text(&in, viewer->name, sizeof(viewer->name));
        viewer->closes++;
        break;
    case 4:
        read_u8(&in);
        read_text(&in, viewer->name, sizeof(viewer->name));
        viewer->width = read_u32(&in);
        viewer->height = read_u32(&in);
        viewer->wrong |= read_u32(&in) != 3;
        for (int c = 0; c < 3; c++) {
            read_text(&in, text, sizeof(text));
            viewer->wrong |= text[0] != "RGB"[c] || text[1] != '\0';
        }
        free(viewer->rgb);
        viewer->rgb = calloc((size_t)viewer->width * viewer->height * 3, sizeof(float));
        viewer->creates++;
        break;
    case 6: {
        read_u8(&in);
        read_text(&in, text, sizeof(text));
        viewer->wrong |= strcmp(text, viewer->name) != 0 || read_u32(&in) != 3;
        for (int c = 0; c < 3; c++)
            read_text(&in, text, sizeof(text));
        uint32_t x = read_u32(&in), y = read_u32(&in), width = read_u32(&in),
                 height = read_u32(&in);
        uint64_t offset[3], stride[3];
        read_u64s(&in, offset, 3);
        read_u64s(&in, stride, 3);
        if (x + width > viewer->width || y + height > viewer->height) {
            viewer->wrong = true;
            return;
        }
        size_t values = (size_t)width * height;
        for (int c = 0; c < 3; c++) {
            for (size_t p = 0; p < values; p++) {
                struct reader value = in;
                bytes_span(&value, (offset[c] + p * stride[c]) * sizeof(float));
                size_t at = (y + p / width) * viewer->width + x + p % width;
                viewer->rgb[3 * at + (size_t)c] = read_f32(&value);
                viewer->wrong |= value.failure != NULL;
            }
        }
        bytes_span(&in, 3 * values * sizeof(float));
        viewer->updates++;
        break;
    }
    default:
        viewer->wrong = true;
    }
    viewer->wrong |= !reader_done(&in, NULL);
}

static void viewer_alloc(uv_handle_t *handle, size_t wanted, uv_buf_t *buffer)
{
    (void)wanted;
    struct viewer *viewer = handle->data;
    *buffer = uv_buf_init((char *)viewer->bytes + viewer->size,
                          (unsigned)(sizeof(viewer->bytes) - viewer->size));
}

static void viewer_read(uv_stream_t *stream, ssize_t got, const uv_buf_t *buffer)
{
    (void)buffer;
    struct viewer *viewer = stream->data;
    if (got < 0) {
        viewer->gone = true;
        uv_close((uv_handle_t *)stream, NULL);
        return;
    }
    viewer->size += (size_t)got;
    for (uint32_t length; viewer->size >= 4; viewer->size -= length) {
        memcpy(&length, viewer->bytes, 4);
        if (length < 5 || length > sizeof(viewer->bytes)) {
            viewer->wrong = true;
            return;
        }
        if (viewer->size < length)
            return;
        take_packet(viewer, viewer->bytes + 4, length - 4);
        memmove(viewer->bytes, viewer->bytes + length, viewer->size - length);
    }
}

static void viewer_accept(uv_stream_t *server, int status)
{
    struct viewer *viewer = server->data;
    assert_int_equal(status, 0);
    uv_tcp_init(&viewer->loop, &viewer->client);
    viewer->client.data = viewer;
    assert_int_equal(uv_accept(server, (uv_stream_t *)&viewer->client), 0);
    uv_read_start((uv_stream_t *)&viewer->client, viewer_alloc, viewer_read);
    viewer->connected = true;
}

/* Listen on a free port, and return it. */
static unsigned viewer_listen(struct viewer *viewer)
{
    memset(viewer, 0, sizeof(*viewer));
    uv_loop_init(&viewer->loop);
    uv_tcp_init(&viewer->loop, &viewer->server);
    uv_timer_init(&viewer->loop, &viewer->clock);
    viewer->server.data = viewer->clock.data = viewer;
    struct sockaddr_in address;
    uv_ip4_addr("127.0.0.1", 0, &address);
    assert_int_equal(uv_tcp_bind(&viewer->server, (const struct sockaddr *)&address, 0), 0);
    assert_int_equal(uv_listen((uv_stream_t *)&viewer->server, 1, viewer_accept), 0);
    int size = sizeof(address);
    uv_tcp_getsockname(&viewer->server, (struct sockaddr *)&address, &size);
    return ntohs(address.sin_port);
}

static void stop_loop(uv_timer_t *timer)
{
    uv_stop(timer->loop);
}

static void run_for(struct viewer *viewer, unsigned ms)
{
    uv_timer_start(&viewer->clock, stop_loop, ms, 0);
    uv_run(&viewer->loop, UV_RUN_DEFAULT);
    uv_timer_stop(&viewer->clock);
}

/* Run until `*flag` or two seconds went by. */
static void run_until(struct viewer *viewer, const bool *flag)
{
    for (unsigned i = 0; i < 400 && !*flag; i++)
        run_for(viewer, 5);
}

/* Everything must be closed by now: a handle left open would leak in every render. */
static void viewer_end(struct viewer *viewer)
{
    uv_close((uv_handle_t *)&viewer->clock, NULL);
    if (!uv_is_closing((uv_handle_t *)&viewer->server))
        uv_close((uv_handle_t *)&viewer->server, NULL);
    uv_run(&viewer->loop, UV_RUN_DEFAULT);
    assert_int_equal(uv_loop_close(&viewer->loop), 0);
    free(viewer->rgb);
}

static struct image *picture(uint32_t width, uint32_t height, float value)
{
    struct image *image = image_new(width, height);
    static const char *const names[3] = { "R", "G", "B" };
    for (int c = 0; c < 3; c++) {
        float *values = image_add_channel(image, names[c]);
        assert_non_null(values);
        for (uint32_t p = 0; p < width * height; p++)
            values[p] = value + (float)c + (float)p * 0x1p-20f;
    }
    return image;
}

static void expect_shown(const struct viewer *viewer, const struct image *image)
{
    assert_false(viewer->wrong);
    assert_int_equal(viewer->width, image->width);
    assert_int_equal(viewer->height, image->height);
    for (uint32_t p = 0; p < image->width * image->height; p++)
        for (uint32_t c = 0; c < 3; c++)
            if (viewer->rgb[3 * p + c] != image->channels[c].values[p])
                fail_msg("pixel %u channel %u: %g, wanted %g", p, c, (double)viewer->rgb[3 * p + c],
                         (double)image->channels[c].values[p]);
}

static unsigned logged;

static void count_log(void *context, const char *text)
{
    (void)context;
    assert_non_null(strstr(text, "rendering goes on"));
    logged++;
}

static struct viewer viewer; /* large */

static void a_viewer_gets_every_pixel_and_the_last_picture(void **state)
{
    (void)state;
    logged = 0;
    unsigned port = viewer_listen(&viewer);
    struct tev *tev = tev_open(&viewer.loop, "127.0.0.1", port, "cornell", count_log, NULL);
    assert_non_null(tev);

    /* Before the connection stands, and faster than anything is sent: the newest one survives */
    struct image *image = NULL;
    for (int i = 0; i < 20; i++) {
        image_free(image);
        image = picture(700, 900, (float)i); /* more than two bands */
        tev_update(tev, image);
    }
    run_until(&viewer, &viewer.connected);
    for (int i = 0; i < 400 && viewer.updates < 3; i++)
        run_for(&viewer, 5);
    assert_string_equal(viewer.name, "cornell");
    assert_int_equal(viewer.creates, 1);
    assert_int_equal(viewer.updates, 3);
    expect_shown(&viewer, image);
    image_free(image);

    /* Another size: a new picture of the same name; closing sends what waits */
    image = picture(33, 7, -1);
    tev_update(tev, image);
    tev_close(tev, 2000);
    run_until(&viewer, &viewer.gone);
    assert_true(viewer.gone);
    assert_int_equal(viewer.creates, 2);
    assert_int_equal(viewer.closes, 2);
    expect_shown(&viewer, image);
    image_free(image);
    assert_int_equal(logged, 0);
    viewer_end(&viewer);
}

static void a_refused_connection_is_mentioned_once(void **state)
{
    (void)state;
    logged = 0;
    unsigned port = viewer_listen(&viewer);
    uv_close((uv_handle_t *)&viewer.server, NULL); /* nobody listens there now */
    run_for(&viewer, 1);
    struct tev *tev = tev_open(&viewer.loop, "127.0.0.1", port, "x", count_log, NULL);
    struct image *image = picture(8, 8, 0);
    for (int i = 0; i < 10; i++) {
        tev_update(tev, image);
        run_for(&viewer, 5);
    }
    assert_int_equal(logged, 1);
    tev_close(tev, 1000);
    tev_update(NULL, image);
    tev_close(NULL, 0);
    image_free(image);
    viewer_end(&viewer);
}

static void a_name_that_means_nothing_is_mentioned_once(void **state)
{
    (void)state;
    logged = 0;
    viewer_listen(&viewer);
    char host[400];
    memset(host, 'a', sizeof(host)); /* longer than any name, so that nobody is asked */
    host[sizeof(host) - 1] = '\0';
    struct tev *tev = tev_open(&viewer.loop, host, 1, "x", count_log, NULL);
    for (int i = 0; i < 400 && logged == 0; i++)
        run_for(&viewer, 5);
    assert_int_equal(logged, 1);
    tev_close(tev, 1000);
    viewer_end(&viewer);
}

static void a_viewer_that_stalls_costs_at_most_the_grace_time(void **state)
{
    (void)state;
    logged = 0;
    unsigned port = viewer_listen(&viewer);
    struct tev *tev = tev_open(&viewer.loop, "127.0.0.1", port, "x", count_log, NULL);
    run_until(&viewer, &viewer.connected);
    uv_read_stop((uv_stream_t *)&viewer.client); /* it never reads again */
    struct image *image = picture(2000, 1500, 0);
    for (int i = 0; i < 5; i++) {
        tev_update(tev, image);
        run_for(&viewer, 5);
    }
    image_free(image);
    tev_close(tev, 100);
    uv_close((uv_handle_t *)&viewer.server, NULL);
    uv_run(&viewer.loop, UV_RUN_DEFAULT); /* returns once nothing but the silent client is left */
    uv_close((uv_handle_t *)&viewer.client, NULL);
    viewer_end(&viewer);
}

static void a_viewer_that_goes_away_does_not_hurt(void **state)
{
    (void)state;
    logged = 0;
    unsigned port = viewer_listen(&viewer);
    struct tev *tev = tev_open(&viewer.loop, "127.0.0.1", port, "x", count_log, NULL);
    run_until(&viewer, &viewer.connected);
    uv_close((uv_handle_t *)&viewer.client, NULL);
    struct image *image = picture(300, 300, 0);
    for (int i = 0; i < 100 && logged == 0; i++) {
        tev_update(tev, image);
        run_for(&viewer, 5);
    }
    assert_int_equal(logged, 1);
    tev_update(tev, image);
    tev_close(tev, 1000);
    image_free(image);
    viewer_end(&viewer);
}

static void closing_at_once_leaves_nothing_behind(void **state)
{
    (void)state;
    unsigned port = viewer_listen(&viewer);
    tev_close(tev_open(&viewer.loop, "127.0.0.1", port, "x", NULL, NULL), 1000);
    struct tev *tev = tev_open(&viewer.loop, "localhost", port, "x", NULL, NULL);
    struct image *image = picture(8, 8, 0);
    tev_update(tev, image);
    tev_close(tev, 0);
    image_free(image);
    viewer_end(&viewer);
}

/* ---- selftest ---- */

static void this_machine_computes_the_bits_of_all_others(void **state)
{
    (void)state;
    assert_int_equal(cmd_selftest(1, (char *[]){ "selftest", NULL }), 0);
}

int main(void)
{
    signal(SIGPIPE, SIG_IGN);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_progress_line_is_made_for_readers),
        cmocka_unit_test(a_terminal_has_one_line_that_is_rewritten),
        cmocka_unit_test(a_log_has_plain_lines_at_growing_intervals),
        cmocka_unit_test(the_report_is_json_and_says_unknown_as_null),
        cmocka_unit_test(a_viewer_gets_every_pixel_and_the_last_picture),
        cmocka_unit_test(a_refused_connection_is_mentioned_once),
        cmocka_unit_test(a_name_that_means_nothing_is_mentioned_once),
        cmocka_unit_test(a_viewer_that_stalls_costs_at_most_the_grace_time),
        cmocka_unit_test(a_viewer_that_goes_away_does_not_hurt),
        cmocka_unit_test(closing_at_once_leaves_nothing_behind),
        cmocka_unit_test(this_machine_computes_the_bits_of_all_others),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
