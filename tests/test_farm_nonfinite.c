/*
 * Samples that are not numbers, through the whole farm (NUMERICS H60): among a million camera
 * paths, traced by a worker's pool and sent to a master over a socket, a few are spoilt just before
 * the kernel sums them. They must be counted by cause, leave their pixel's value finite and every
 * other pixel as it was, and the picture may not claim a known error.
 */
#include "master/estimate.h"
#include "master/farm.h"
#include "master/film.h"
#include "master/image.h"
#include "master/report.h"
#include "proto/bundle.h"
#include "tests/kernel_scenes.h"
#include "worker/journal.h"
#include "worker/renderer.h"
#include "worker/session.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define WIDTH  80
#define HEIGHT 40
#define SPP    320 /* a million samples, with 80 x 40 pixels */

/* One sample of one pixel of a tile */
struct spoilt {
    uint32_t tile, replicate, pixel, sample;
    uint64_t leaf;
    float value;
};

static const struct spoilt *spoilt; /* read by the render threads */
static unsigned spoilt_count;
static atomic_bool denormals_kept;

/* ---- the renderer on Embree, with some samples spoilt */

static void (*sound_leaf)(const struct kernel_scene *, struct kernel_thread *, uint32_t, uint32_t,
                          uint64_t, struct path_stats *);

static void spoilt_leaf(const struct kernel_scene *ks, struct kernel_thread *thread, uint32_t tile,
                        uint32_t replicate, uint64_t leaf, struct path_stats *stats)
{
    sound_leaf(ks, thread, tile, replicate, leaf, stats);
    volatile float tiny = 0x1p-130f, twice = tiny * 2;
    if (twice != 0)
        denormals_kept = true;
    for (unsigned i = 0; i < spoilt_count; i++) {
        const struct spoilt *s = &spoilt[i];
        if (s->tile == tile && s->replicate == replicate && s->leaf == leaf)
            thread->radiance[i % 3 * thread->slot_count + s->pixel * ks->spec.leaf_samples +
                             s->sample] = s->value;
    }
}

static struct renderer *open_spoilt(const struct scene *scene, const struct job_spec *spec,
                                    unsigned threads, struct err *err)
{
    struct renderer *renderer = renderer_embree.open(scene, spec, threads, err);
    if (renderer != NULL) {
        struct kernel_scene *ks = (struct kernel_scene *)renderer;
        sound_leaf = ks->leaf;
        ks->leaf = spoilt_leaf;
    }
    return renderer;
}

/* ---- a master and its worker on one loop */

struct play {
    uv_loop_t loop;
    uv_timer_t too_long;
    struct scene *scene;
    struct job_spec spec;
    struct bundle *bundle;
    struct film *film;
    struct farm *farm;
    struct session *session;
    bool ended, left;
    struct err why;
};

static void on_end(void *owner, const struct err *why)
{
    struct play *play = owner;
    play->ended = true;
    play->why = *why;
}

static void on_left(void *owner, int status)
{
    struct play *play = owner;
    (void)status;
    play->left = true;
}

static void on_round(void *owner)
{
    (void)owner;
}

static void say(void *owner, const char *line)
{
    (void)owner;
    (void)line;
}

static void on_too_long(uv_timer_t *timer)
{
    (void)timer;
    fail_msg("the farm hangs");
}

/* Nothing but a sky: every sample is 1, and so is every mean of them */
static struct scene *bright_sky(void)
{
    struct scene *scene = scenes_begin(WIDTH, HEIGHT);
    scenes_sky(scene, 1);
    scenes_finish(scene);
    return scene;
}

static void render(struct play *play)
{
    static struct profile profile = { .digest = { 60 }, .text = "spoilt" };
    static struct renderer_class renderer;
    struct err err = { .code = ERR_OK };
    memset(play, 0, sizeof(*play));
    uv_loop_init(&play->loop);
    play->scene = bright_sky();
    play->spec = (struct job_spec){
        .seed = 1, .channel_count = 3, .depth_cap = 65536, .max_lanes = 8
    };
    uint64_t spp = job_shape(SPP, 4, &play->spec);
    assert_int_equal(spp, SPP);
    play->bundle = bundle_from_scene(play->scene, &play->spec, &err);
    play->film = film_new(play->scene, &play->spec, job_rounds(&play->spec, spp), 0, &err);
    assert_true(play->bundle != NULL && play->film != NULL);

    struct farm_settings settings = farm_defaults();
    settings.listen_host = "127.0.0.1";
    const struct farm_events events = { .on_round = on_round, .on_end = on_end, .say = say };
    struct farm_job job = { .scene = play->scene,
                            .spec = &play->spec,
                            .bundle = play->bundle,
                            .film = play->film,
                            .title = "spoilt",
                            .limits = { .rounds = job_rounds(&play->spec, spp) } };
    play->farm = farm_open(&play->loop, &settings, &job, &events, play, &err);
    assert_non_null(play->farm);

    renderer = renderer_embree;
    renderer.open = open_spoilt;
    struct session_options options = session_options_default();
    options.host = "127.0.0.1";
    options.port = farm_listen_port(play->farm);
    options.renderer = &renderer;
    options.profile = &profile;
    options.threads = 2;
    options.once = true;
    play->session = session_new(&play->loop, &options, on_left, play, &err);
    assert_non_null(play->session);

    uv_timer_init(&play->loop, &play->too_long);
    uv_timer_start(&play->too_long, on_too_long, 60000, 0);
    while (!play->ended)
        uv_run(&play->loop, UV_RUN_ONCE);
    assert_string_equal(play->why.text, "");
}

static void dismiss(struct play *play)
{
    farm_close(play->farm);
    while (!play->left)
        uv_run(&play->loop, UV_RUN_ONCE);
    session_free(play->session);
    uv_close((uv_handle_t *)&play->too_long, NULL);
    uv_run(&play->loop, UV_RUN_DEFAULT);
    assert_int_equal(uv_loop_close(&play->loop), 0);
    film_free(play->film);
    bundle_free(play->bundle);
    scene_free(play->scene);
}

/* ---- sentences */

static void expect_in_report(const struct play *play, const struct ledger_row *last,
                             const char *words)
{
    struct render_report report = { .command = "",
                                    .build = "",
                                    .profile = "",
                                    .scene = "",
                                    .accuracy = last->accuracy,
                                    .ledger = last,
                                    .ledger_count = 1 };
    film_stats(play->film, &report.stats);
    char *json = report_json(&report);
    assert_non_null(json);
    /* Blanks are the JSON library's business */
    char *to = json;
    for (const char *from = json; *from != '\0'; from++)
        if (*from != ' ' && *from != '\n')
            *to++ = *from;
    *to = '\0';
    const char *first = strstr(json, words);
    if (first == NULL || strstr(first + 1, words) == NULL) /* in the whole and in the row */
        fail_msg("the report does not say %s twice: %s", words, json);
    free(json);
}

static void a_sound_million_has_none(void **state)
{
    (void)state;
    struct play play;
    spoilt_count = 0;
    render(&play);
    struct node_stats stats;
    size_t rows;
    film_stats(play.film, &stats);
    const struct ledger_row *last = &farm_ledger(play.farm, &rows)[rows - 1];
    assert_int_equal(stats.samples, SPP * WIDTH * HEIGHT);
    for (int cause = 0; cause < NONFINITE_CAUSES; cause++)
        assert_int_equal(stats.nonfinite[cause], 0);
    assert_true(last->accuracy.verdict != ACCURACY_NONFINITE);
    expect_in_report(&play, last,
                     "\"nonfinite_samples\":{\"nan\":0,\"infinite\":0,\"negative\":0}");
    const float *red = image_channel(farm_picture(play.farm), "R");
    for (size_t i = 0; i < (size_t)WIDTH * HEIGHT; i++)
        assert_true(red[i] == 1);
    assert_false(denormals_kept); /* the mode of a thread: every render thread must set it */
    dismiss(&play);
}

static void one_in_a_million_is_counted_left_out_and_reported(void **state)
{
    (void)state;
    /* Of each cause alone, then all of them together, two in one pixel */
    static const struct spoilt all[] = {
        { .tile = 1, .replicate = 2, .leaf = 5, .pixel = 5 * 32 + 3, .sample = 3, .value = NAN },
        { .tile = 0, .replicate = 0, .leaf = 0, .pixel = 0, .sample = 0, .value = INFINITY },
        { .tile = 4, .replicate = 3, .leaf = 19, .pixel = 7 * 32 + 31, .sample = 1, .value = -1 },
        { .tile = 1, .replicate = 2, .leaf = 11, .pixel = 5 * 32 + 3, .sample = 0, .value = NAN },
    };
    static const unsigned at[] = { 5 * WIDTH + 35, 0, 39 * WIDTH + 63, 5 * WIDTH + 35 };
    static const char *const said[] = { "{\"nan\":1,\"infinite\":0,\"negative\":0}",
                                        "{\"nan\":0,\"infinite\":1,\"negative\":0}",
                                        "{\"nan\":0,\"infinite\":0,\"negative\":1}",
                                        "{\"nan\":2,\"infinite\":1,\"negative\":1}" };
    for (unsigned i = 0; i < 4; i++) {
        unsigned first = i < 3 ? i : 0, end = i < 3 ? i + 1 : 4;
        struct play play;
        spoilt = all + first;
        spoilt_count = end - first;
        render(&play);

        size_t rows;
        const struct ledger_row *last = &farm_ledger(play.farm, &rows)[rows - 1];
        assert_int_equal(last->accuracy.verdict, ACCURACY_NONFINITE);
        expect_in_report(&play, last, said[i]);

        /* Their pixels are finite, of unknown error, and short of nothing but what was left out */
        const struct image *picture = farm_picture(play.farm);
        const float *red = image_channel(picture, "R"), *green = image_channel(picture, "G");
        const float *error = image_channel(picture, "stderr.R");
        for (unsigned p = 0; p < WIDTH * HEIGHT; p++) {
            unsigned lost = 0;
            for (unsigned k = first; k < end; k++)
                lost += at[k] == p;
            double want = 1 - (double)lost / SPP;
            if (fabs((double)red[p] - want) > 1e-6 || green[p] != red[p] ||
                isinf(error[p]) != (lost > 0) || (lost == 0 && error[p] != 0))
                fail_msg("case %u, pixel %u lost %u: %g, %g +- %g, want %g", i, p, lost,
                         (double)red[p], (double)green[p], (double)error[p], want);
        }
        dismiss(&play);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_sound_million_has_none),
        cmocka_unit_test(one_in_a_million_is_counted_left_out_and_reported),
    };
    journal_open(JOURNAL_PROBLEM, NULL);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
