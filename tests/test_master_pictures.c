/*
 * The pictures of a render are whole, say how complete they are, do not change while they are being
 * written, and need no memory that was not taken at the start.
 */
#include "common/err.h"
#include "common/scene.h"
#include "master/exr.h"
#include "master/film.h"
#include "master/image.h"
#include "master/pictures.h"
#include "proto/bundle.h"
#include "tests/scratch.h"

#include <malloc.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cmocka.h>

#define SIDE 200

struct play {
    char folder[256];
    const char *exr, *png;
    uv_loop_t loop;
    struct scene *scene;
    struct job_spec spec;
    struct bundle *bundle;
    struct film *film;
    struct image *picture;
    struct pictures *pictures;
    char log[600];
};

static void on_log(void *context, const char *line)
{
    struct play *play = context;
    snprintf(play->log, sizeof(play->log), "%s", line);
}

static void play_open(struct play *play)
{
    struct err err = { .code = ERR_OK };
    memset(play, 0, sizeof(*play));
    scratch_make(play->folder);
    play->exr = scratch_path(play->folder, "picture.exr");
    play->png = scratch_path(play->folder, "picture.png");
    uv_loop_init(&play->loop);
    play->scene = scene_new();
    struct scene_settings *s = &play->scene->settings;
    s->width = s->crop[1] = s->height = s->crop[3] = SIDE;
    play->spec = (struct job_spec){ .channel_count = 3, .max_lanes = 8 };
    job_shape(64, 0, &play->spec);
    play->bundle = bundle_from_scene(play->scene, &play->spec, &err);
    play->film = film_new(play->scene, &play->spec, 1, 0, &err);
    assert_true(play->bundle != NULL && play->film != NULL);
    play->picture = film_image_new(play->film);
    struct picture_facts facts = { .command = "pathfarm",
                                   .build = "test",
                                   .profile_text = "none",
                                   .bundle = play->bundle,
                                   .spec = &play->spec };
    struct picture_paths paths = { .exr = play->exr, .png = play->png };
    play->pictures = pictures_new(&play->loop, play->film, &facts, &paths);
    assert_true(play->picture != NULL && play->pictures != NULL);
}

static void play_close(struct play *play)
{
    pictures_free(play->pictures);
    image_free(play->picture);
    film_free(play->film);
    bundle_free(play->bundle);
    scene_free(play->scene);
    uv_loop_close(&play->loop);
    scratch_remove(play->folder);
}

/* Every pixel of every channel; by places, so that files do not compress to nothing */
static void paint(struct image *picture, float value)
{
    for (uint32_t c = 0; c < picture->channel_count; c++)
        for (uint32_t p = 0; p < SIDE * SIDE; p++)
            picture->channels[c].values[p] = value + (float)(p * 7919 % 1009 + c);
}

static void refresh(struct play *play)
{
    struct picture_moment moment = { .picture = play->picture };
    pictures_refresh(play->pictures, &moment, on_log, play);
}

static void expect_file(const struct play *play, const struct image *picture, const char *complete)
{
    struct err err = { .code = ERR_OK };
    struct image *file = exr_image_read(play->exr, &err);
    if (file == NULL)
        fail_msg("%s", err.text);
    for (uint32_t c = 0; c < picture->channel_count; c++)
        assert_memory_equal(image_channel(file, picture->channels[c].name),
                            picture->channels[c].values, SIDE * SIDE * sizeof(float));
    assert_string_equal(image_attribute(file, "pathfarm.complete"), complete);
    image_free(file);
    assert_int_equal(access(play->png, R_OK), 0);
}

static void a_refresh_shows_the_picture_as_it_was_when_asked_for(void **state)
{
    (void)state;
    struct play play;
    struct err err = { .code = ERR_OK };
    play_open(&play);
    struct picture_moment moment = { .picture = NULL }; /* no round has ended */
    pictures_refresh(play.pictures, &moment, on_log, &play);
    assert_false(pictures_busy(play.pictures));

    struct image *before = film_image_new(play.film);
    paint(before, 1);
    paint(play.picture, 1);
    refresh(&play);
    assert_true(pictures_busy(play.pictures));
    paint(play.picture, 2);
    refresh(&play); /* dropped: one is being written */
    uv_run(&play.loop, UV_RUN_DEFAULT);
    assert_false(pictures_busy(play.pictures));
    expect_file(&play, before, "no");

    moment = (struct picture_moment){ .picture = play.picture, .complete = true };
    assert_true(pictures_write(play.pictures, &moment, &err));
    expect_file(&play, play.picture, "yes");
    assert_string_equal(play.log, "");
    image_free(before);
    play_close(&play);
}

static void a_refresh_that_fails_is_said_and_the_next_one_is_tried(void **state)
{
    (void)state;
    struct play play;
    play_open(&play);
    paint(play.picture, 1);
    char moved[300];
    snprintf(moved, sizeof(moved), "%s-moved", play.folder);
    assert_int_equal(rename(play.folder, moved), 0);
    refresh(&play);
    uv_run(&play.loop, UV_RUN_DEFAULT);
    assert_non_null(strstr(play.log, "picture.exr"));

    assert_int_equal(rename(moved, play.folder), 0);
    refresh(&play);
    uv_run(&play.loop, UV_RUN_DEFAULT);
    expect_file(&play, play.picture, "no");
    play_close(&play);
}

static void a_picture_is_there_page_by_page_before_anything_is_rendered(void **state)
{
    (void)state;
    struct play play;
    play_open(&play);
    size_t page = (size_t)sysconf(_SC_PAGESIZE);
    for (uint32_t c = 0; c < play.picture->channel_count; c++) {
        uintptr_t values = (uintptr_t)play.picture->channels[c].values;
        uintptr_t first = values / page * page;
        size_t pages = (values + SIDE * SIDE * sizeof(float) - first + page - 1) / page;
        unsigned char resident[SIDE * SIDE] = { 0 };
        assert_true(pages <= sizeof(resident));
        assert_int_equal(mincore((void *)first, pages * page, resident), 0);
        for (size_t i = 0; i < pages; i++)
            assert_int_equal(resident[i] & 1, 1);
    }
    play_close(&play);
}

static size_t allocated_bytes(void)
{
    struct mallinfo2 info = mallinfo2();
    return info.uordblks + info.hblkhd;
}

static void writing_again_and_again_keeps_nothing(void **state)
{
    (void)state;
    struct play play;
    struct err err = { .code = ERR_OK };
    play_open(&play);
    paint(play.picture, 1);
    struct picture_moment moment = { .picture = play.picture };
    for (int i = 0; i < 4; i++) /* libraries set up, malloc's caches filled */
        assert_true(pictures_write(play.pictures, &moment, &err));
    size_t before = allocated_bytes();
    for (int i = 0; i < 5; i++)
        assert_true(pictures_write(play.pictures, &moment, &err));
    assert_true(allocated_bytes() < before + SIDE); /* malloc's own caches move by some bytes */
    play_close(&play);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_refresh_shows_the_picture_as_it_was_when_asked_for),
        cmocka_unit_test(a_refresh_that_fails_is_said_and_the_next_one_is_tried),
        cmocka_unit_test(a_picture_is_there_page_by_page_before_anything_is_rendered),
        cmocka_unit_test(writing_again_and_again_keeps_nothing),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
