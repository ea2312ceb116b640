#include "master/lecture_light.h"

#include "common/moments.h"
#include "master/image.h"
#include "master/page.h"
#include "master/plot.h"

#include <inttypes.h>
#include <math.h>
#include <stdio.h>

enum purpose {
    BRDF = 400,
    TREES,
    EQUAL_RAYS,
    RESULTS,
    GLOSSY,
    PENUMBRA,
    LIGHT,
    MANY_LIGHTS,
    UNDERSAMPLING
};

/* ---- scenes */

#define DIFFUSE(r, g, b)                 \
    {                                    \
        .kd = { r, g, b }, .exponent = 1 \
    }
#define GLOSSY_SURFACE(d, s, n)                             \
    {                                                       \
        .kd = { d, d, d }, .ks = { s, s, s }, .exponent = n \
    }

/* The light; five walls; behind the camera the sixth. The light is so close to the ceiling that
 * nothing is lit from between: a gap of a millimetre would shine as 1 / distance^4. */
#define LIGHT_AND_WALLS(floor)                                                         \
    { .at = { -.4, 1.999999, -.4 },                                                    \
      .u = { .8, 0, 0 },                                                               \
      .v = { 0, 0, .8 },                                                               \
      .surface = { .emission = { 9, 8, 6.5 }, .exponent = 1 } },                       \
        { .at = { -1, 0, -1 }, .u = { 0, 0, 5 }, .v = { 2, 0, 0 }, .surface = floor }, \
        { .at = { -1, 2, -1 }, .u = { 2, 0, 0 }, .v = { 0, 0, 5 }, .surface = WHITE }, \
        { .at = { -1, 0, -1 }, .u = { 2, 0, 0 }, .v = { 0, 2, 0 }, .surface = WHITE }, \
        { .at = { -1, 0, -1 }, .u = { 0, 2, 0 }, .v = { 0, 0, 5 }, .surface = RED },   \
        { .at = { 1, 0, -1 }, .u = { 0, 0, 5 }, .v = { 0, 2, 0 }, .surface = GREEN },  \
    {                                                                                  \
        .at = { -1, 0, 4 }, .u = { 0, 2, 0 }, .v = { 2, 0, 0 }, .surface = WHITE       \
    }
#define WHITE DIFFUSE(.73, .73, .72)
#define RED   DIFFUSE(.65, .07, .06)
#define GREEN DIFFUSE(.12, .45, .1)

static const struct caster_object DIFFUSE_ROOM[] = {
    LIGHT_AND_WALLS(WHITE),
    { .sphere = true, .radius = .42, .at = { -.45, .42, -.35 }, .surface = DIFFUSE(.7, .7, .7) },
    { .sphere = true, .radius = .34, .at = { .45, .34, .25 }, .surface = DIFFUSE(.35, .45, .7) },
};

static const struct caster_object GLOSSY_ROOM[] = {
    LIGHT_AND_WALLS(GLOSSY_SURFACE(.35, .35, 60)),
    { .sphere = true,
      .radius = .42,
      .at = { -.45, .42, -.35 },
      .surface = GLOSSY_SURFACE(.05, .85, 500) },
    { .sphere = true,
      .radius = .34,
      .at = { .45, .34, .25 },
      .surface = GLOSSY_SURFACE(.25, .6, 25) },
};

#define ROOM_OBJECTS (sizeof(DIFFUSE_ROOM) / sizeof(DIFFUSE_ROOM[0]))

struct caster_scene lecture_light_room(bool glossy)
{
    return (struct caster_scene){
        .objects = glossy ? GLOSSY_ROOM : DIFFUSE_ROOM,
        .object_count = ROOM_OBJECTS,
        .eye = { 0, .9, 3.7 }, /* the light stays out of the picture: its edge would be the error */
        .target = { 0, .7, 0 },
        .tan_half_fov = .3,
    };
}

/* A bright evening: the glow of the horizon, and two windows of light */
static lecture_vec evening(lecture_vec d)
{
    double up = .5 + .5 * d[1];
    lecture_vec sky = LECTURE_VEC(.10, .14, .25) + (1 - up) * LECTURE_VEC(.35, .22, .10);
    double across = d[0] + .5 * d[2], high = d[1] - .55;
    if (fabs(across - .45) < .18 && fabs(high) < .22 && d[2] > 0)
        sky += LECTURE_VEC(7, 6, 4.5);
    if (fabs(across + .55) < .1 && fabs(high + .2) < .3 && d[2] > 0)
        sky += LECTURE_VEC(2, 3, 5);
    return sky;
}

/* ---- pairs of films */

void lecture_light_more(struct lecture_pair *pair, const struct caster_scene *scene,
                        const struct caster_how *how, uint64_t samples, uint64_t seed)
{
    for (uint64_t i = 0; i < 2; i++)
        lecture_caster_expose(&pair->film[i], scene, how, samples, hash64(seed, i), &pair->counts);
}

struct lecture_pair lecture_light_pair(const struct caster_scene *scene,
                                       const struct caster_how *how, unsigned size,
                                       uint64_t samples, uint64_t seed)
{
    struct lecture_pair pair = { .film = { lecture_caster_film(size, size),
                                           lecture_caster_film(size, size) } };
    lecture_light_more(&pair, scene, how, samples, seed);
    return pair;
}

void lecture_light_pair_free(struct lecture_pair *pair)
{
    lecture_caster_film_free(&pair->film[0]);
    lecture_caster_film_free(&pair->film[1]);
}

double lecture_light_rmse(const struct lecture_pair *pair)
{
    return lecture_caster_rmse(&pair->film[0], &pair->film[1]);
}

double lecture_light_mean(const struct lecture_pair *pair)
{
    return .5 * (lecture_caster_mean(&pair->film[0]) + lecture_caster_mean(&pair->film[1]));
}

static double pixels(const struct lecture_pair *pair)
{
    return (double)pair->film[0].width * pair->film[0].height;
}

double lecture_light_mean_error(const struct lecture_pair *pair)
{
    return lecture_light_rmse(pair) / sqrt(2 * pixels(pair));
}

double lecture_light_rays(const struct lecture_pair *pair)
{
    double rays = (double)pair->counts.shadow_rays;
    for (int depth = 0; depth < CASTER_DEPTHS; depth++)
        rays += (double)pair->counts.rays[depth];
    return rays / (2 * pixels(pair) * (double)pair->film[0].samples);
}

void lecture_light_show(struct page *page, const struct lecture_pair *pair, const char *label)
{
    struct image *image = lecture_caster_image(&pair->film[0]);
    page_picture(page, image, "%s: error %.3g", label, lecture_light_rmse(pair));
    image_free(image);
}

static unsigned size_of(const struct lecture *lecture)
{
    return lecture->quick ? 24 : 96;
}

/* ---- sampling a BRDF */

static void write_brdf(struct lecture *lecture)
{
    static const struct caster_object BALL = {
        .sphere = true,
        .radius = 1,
        .surface = { .kd = { .08, .08, .08 }, .ks = { .85, .8, .7 }, .exponent = 80 }
    };
    static const uint64_t SAMPLES[3] = { 5, 25, 75 };
    const struct caster_scene scene = { .objects = &BALL,
                                        .object_count = 1,
                                        .light = -1,
                                        .sky = evening,
                                        .eye = { 0, .6, 4 },
                                        .tan_half_fov = .28 };
    struct page *page = lecture->page;
    double rmse[2][3];
    page_section(page, "Sampling a BRDF: uniform against its own shape");
    page_text(page,
              "A glossy ball (a Phong lobe with exponent 80, and a little diffuse) under a sky "
              "with two windows of light. Above, directions uniform over the hemisphere, U(ω); "
              "below, by the BRDF, P(ω). 5, 25 and 75 samples per pixel. Errors are root mean "
              "squares over pixels and colours.");
    page_grid_begin(page, 240);
    for (int shape = 0; shape < 2; shape++)
        for (int i = 0; i < 3; i++) {
            const struct caster_how how = { .uniform = shape == 0, .max_depth = 1, .survival = 1 };
            struct lecture_pair pair = lecture_light_pair(
                &scene, &how, size_of(lecture), SAMPLES[i],
                hash64_4(lecture->seed, BRDF, (uint64_t)shape, SAMPLES[i]));
            char label[64];
            snprintf(label, sizeof(label), "%s, %" PRIu64 " samples", shape ? "P(ω)" : "U(ω)",
                     SAMPLES[i]);
            rmse[shape][i] = lecture_light_rmse(&pair);
            lecture_light_show(page, &pair, label);
            lecture_light_pair_free(&pair);
        }
    page_grid_end(page);
    page_note(page, "Result",
              "At 75 samples the error is %.4f against %.4f: uniform directions need %.0f times "
              "the samples for the same picture. The rate is 1/√N either way.",
              rmse[0][2], rmse[1][2], rmse[0][2] / rmse[1][2] * (rmse[0][2] / rmse[1][2]));
}

/* ---- trees of rays */

void lecture_light_tree(const struct caster_scene *scene, unsigned branches, unsigned depth,
                        uint64_t count, struct lecture_dice dice, double rays[CASTER_DEPTHS])
{
    const struct caster_film film = { .width = 1, .height = 1 };
    const struct caster_how how = { .branches = branches, .max_depth = depth, .survival = 1 };
    struct caster_counts counts = { 0 };
    for (uint64_t i = 0; i < count; i++) {
        lecture_vec d = lecture_caster_camera(scene, &film, 0, 0, &dice);
        lecture_caster_radiance(scene, &how, scene->eye, d, 0, &dice, &counts);
    }
    for (int i = 0; i < CASTER_DEPTHS; i++)
        rays[i] = (double)counts.rays[i] / (double)count;
}

static void write_trees(struct lecture *lecture)
{
    static const struct tree {
        unsigned branches, depth;
        const char *name;
    } TREES_SHOWN[] = {
        { 1, 6, "path tracing: one ray at each hit" },
        { 2, 6, "2 rays at each hit" },
        { 4, 6, "4 rays at each hit" },
        { 16, 4, "16 rays at each hit" },
    };
    enum { COUNT = 4, DEEPEST = 6 };
    struct page *page = lecture->page;
    struct caster_scene scene = lecture_light_room(false);
    double depth[DEEPEST + 1], rays[COUNT][CASTER_DEPTHS];
    struct plot_series series[COUNT];
    page_section(page, "Distribution ray tracing, and its trees");
    page_text(page, "Cast many rays from each visible point, and recurse: with M rays at each hit, "
                    "reflection d costs M^{d} rays. Counted in a closed room, where every ray hits "
                    "something (those that hit the light end there):");
    for (int i = 0; i <= DEEPEST; i++)
        depth[i] = i;
    for (int i = 0; i < COUNT; i++) {
        const struct tree *tree = &TREES_SHOWN[i];
        lecture_light_tree(&scene, tree->branches, tree->depth, lecture->quick ? 4 : 64,
                           lecture_dice(lecture->seed, TREES, (uint64_t)i), rays[i]);
        for (unsigned d = 1; d <= tree->depth; d++)
            rays[i][d] += rays[i][d - 1];
        series[i] = (struct plot_series){ tree->name,      PLOT_LINE | PLOT_MARKERS,
                                          tree->depth + 1, depth,
                                          rays[i],         NULL };
    }
    page_plot(page,
              &(struct plot){ .title = "Rays for one camera ray",
                              .x = { .label = "reflections" },
                              .y = { .label = "rays so far", .log = true },
                              .series = series,
                              .series_count = COUNT },
              NULL);
    page_table_begin(page, "Rays for one camera ray, up to and with this many reflections.",
                     "M\t0\t1\t2\t3\t4\t5\t6");
    for (int i = 0; i < COUNT; i++) {
        char row[256];
        int used = snprintf(row, sizeof(row), "%u", TREES_SHOWN[i].branches);
        for (unsigned d = 0; d <= TREES_SHOWN[i].depth; d++)
            used += snprintf(row + used, sizeof(row) - (size_t)used, "\t%.1f", rays[i][d]);
        page_row(page, "%s", row);
    }
    page_table_end(page);
}

static void write_equal_rays(struct lecture *lecture)
{
    static const unsigned BRANCHES[] = { 2, 4, 8 };
    struct page *page = lecture->page;
    struct caster_scene scene = lecture_light_room(false);
    unsigned size = lecture->quick ? 12 : 48;
    page_heading(page, "A tree, or as many paths");
    page_text(page,
              "The room with three reflections (and rays to the light): one tree for each pixel, "
              "against as many paths as cost the same number of rays.");
    page_table_begin(page, NULL,
                     "M\trays per tree\terror of one tree\tpaths for these rays\ttheir error\trays "
                     "that a tree wastes");
    for (size_t i = 0; i < sizeof(BRANCHES) / sizeof(BRANCHES[0]); i++) {
        const struct caster_how trees = {
            .light_sampling = true, .branches = BRANCHES[i], .max_depth = 3, .survival = 1
        };
        struct caster_how paths = trees;
        paths.branches = 1;
        struct lecture_pair tree = lecture_light_pair(&scene, &trees, size, 1,
                                                      hash64_3(lecture->seed, EQUAL_RAYS, 0));
        struct lecture_pair path = lecture_light_pair(&scene, &paths, size, 1,
                                                      hash64_3(lecture->seed, EQUAL_RAYS, 1));
        double wanted = lecture_light_rays(&tree) / lecture_light_rays(&path);
        uint64_t count = wanted < 1.5 ? 1 : (uint64_t)(wanted + .5);
        lecture_light_more(&path, &scene, &paths, count - 1,
                           hash64_3(lecture->seed, EQUAL_RAYS, 1));
        double ratio = lecture_light_rmse(&tree) / lecture_light_rmse(&path);
        page_row(page, "%u\t%.1f\t%.4f\t%" PRIu64 "\t%.4f\t%.0f %%", BRANCHES[i],
                 lecture_light_rays(&tree), lecture_light_rmse(&tree), count,
                 lecture_light_rmse(&path), 100 * (1 - 1 / (ratio * ratio)));
        lecture_light_pair_free(&tree);
        lecture_light_pair_free(&path);
    }
    page_table_end(page);
    page_note(page, "Result",
              "A tree spends nearly all of its rays where they matter least, after several "
              "reflections; a path spends them evenly, and its many camera rays smooth the edges "
              "of the picture as well. Last column: by 1/√N, the share of the tree's rays that as "
              "many paths would not have needed for the same error.");
}

/* ---- path tracing */

static void show_one(struct lecture *lecture, const struct caster_scene *scene,
                     const struct caster_how *how, uint64_t samples, uint64_t purpose,
                     const char *label)
{
    struct lecture_pair pair = lecture_light_pair(scene, how, size_of(lecture), samples,
                                                  hash64_3(lecture->seed, purpose, samples));
    lecture_light_show(lecture->page, &pair, label);
    lecture_light_pair_free(&pair);
}

static void write_results(struct lecture *lecture)
{
    struct page *page = lecture->page;
    struct caster_scene diffuse = lecture_light_room(false), glossy = lecture_light_room(true);
    const struct caster_how how = { .light_sampling = true };
    page_section(page, "Path tracing: diffuse and glossy");
    page_text(
        page,
        "One ray at each hit, many for each pixel. Paths end by Russian roulette, so there "
        "is no deepest reflection. A diffuse reflection sends a ray to the light; a glossy "
        "one finds it by itself. (The light is just above the picture. In it, the pixels along "
        "its bright edge would have most of the error.)");
    page_grid_begin(page, 240);
    show_one(lecture, &diffuse, &how, 10, RESULTS, "diffuse, 10 paths per pixel");
    show_one(lecture, &glossy, &how, 10, GLOSSY, "glossy, 10 paths per pixel");
    show_one(lecture, &glossy, &how, 100, GLOSSY, "glossy, 100 paths per pixel");
    page_grid_end(page);
    page_note(page, "Trap",
              "The slides write paths as L(D|S)*E, and ray tracing as LD[S*]E. Those brackets "
              "group; in the syntax of regular expressions they would be a set of characters, S "
              "or *. What is meant is LDS*E. (And a program that says it is unbiased and has a "
              "largest depth is not: see the last section.)");
}

/* ---- the light */

/* Direct light without noise to speak of: no error in the caption */
static void show_direct(struct lecture *lecture, const struct caster_scene *scene,
                        const char *caption)
{
    const struct caster_how direct = { .light_sampling = true, .max_depth = 1 };
    struct caster_film film = lecture_caster_film(size_of(lecture), size_of(lecture));
    struct caster_counts counts = { 0 };
    lecture_caster_expose(&film, scene, &direct, lecture->quick ? 4 : 64,
                          hash64(lecture->seed, PENUMBRA), &counts);
    struct image *image = lecture_caster_image(&film);
    page_picture(lecture->page, image, "%s", caption);
    image_free(image);
    lecture_caster_film_free(&film);
}

/* The slide's question: "How would you do that?" */
static void write_many_lights(struct lecture *lecture)
{
    /* What four lights emit, and how much of it a certain point receives */
    static const double POWER[4] = { 100, 60, 30, 10 }, RECEIVED[4] = { 1, 4, 2, .2 };
    static const char *const NAMES[3] = { "each with the same", "by its power",
                                          "by what arrives here" };
    struct page *page = lecture->page;
    page_heading(page, "Several lights: which one?");
    page_text(page,
              "The slide asks how. Choose one light with a probability p, and divide what arrives "
              "from it by p. Four lights of 100, 60, 30 and 10 W send 1, 4, 2 and 0.2 to a point, "
              "7.2 together:");
    page_table_begin(page, NULL,
                     "probability\tmean (7.2)\t± standard error\tstandard "
                     "deviation of one choice\ttheory");
    for (int way = 0; way < 3; way++) {
        double p[4], sum = 0, square = 0;
        for (int i = 0; i < 4; i++)
            sum += p[i] = way == 0 ? 1 : way == 1 ? POWER[i] : RECEIVED[i];
        for (int i = 0; i < 4; i++) {
            p[i] /= sum;
            square += RECEIVED[i] * RECEIVED[i] / p[i];
        }
        struct moments m = { 0 };
        struct lecture_dice dice = lecture_dice(lecture->seed, MANY_LIGHTS, (uint64_t)way);
        for (int n = 0; n < (lecture->quick ? 2000 : 100000); n++) {
            double u = lecture_roll(&dice);
            int i = 0;
            while (i < 3 && u >= p[i])
                u -= p[i++];
            moments_add(&m, RECEIVED[i] / p[i]);
        }
        page_row(page, "%s\t%.4f\t%.4f\t%.3f\t%.3f", NAMES[way], m.mean, moments_stderr(&m),
                 sqrt(moments_variance(&m)), sqrt(fmax(0, square - 7.2 * 7.2)));
    }
    page_table_end(page);
    page_note(page, "Result",
              "All are right on average. What is emitted is a poor guide to what arrives; the "
              "perfect choice knows the answer already. Where there are many lights, `{pathfarm "
              "render} asks a tree of them for an estimate of what arrives.");
}

static void write_light(struct lecture *lecture)
{
    struct page *page = lecture->page;
    struct caster_scene room = lecture_light_room(false);
    page_section(page, "Area lights");

    struct caster_object small[ROOM_OBJECTS];
    for (size_t i = 0; i < ROOM_OBJECTS; i++)
        small[i] = room.objects[i];
    struct caster_object *point = &small[room.light];
    point->at += .4875 * (point->u + point->v);
    point->u *= .025;
    point->v *= .025;
    point->surface.emission *= 1600.;
    struct caster_scene spot = room;
    spot.objects = small;
    page_text(page,
              "Direct light only. A light as small as a point has hard shadows; a light with an "
              "area, sampled at a random point for each ray, has penumbras.");
    page_grid_begin(page, 240);
    show_direct(lecture, &spot, "a light of 2 by 2 cm");
    show_direct(lecture, &room, "a light of 80 by 80 cm, of the same power");
    page_grid_end(page);

    page_heading(page, "With and without explicit light sampling");
    page_text(page,
              "Without it, a path has to hit the light by chance. The expected picture is the "
              "same. 1 and 4 paths per pixel:");
    double rmse[2] = { 0, 0 }, rays[2] = { 0, 0 };
    page_grid_begin(page, 200);
    for (uint64_t paths = 1; paths <= 4; paths *= 4)
        for (int sampled = 0; sampled < 2; sampled++) {
            const struct caster_how how = { .light_sampling = sampled };
            struct lecture_pair pair = lecture_light_pair(
                &room, &how, size_of(lecture), paths,
                hash64_4(lecture->seed, LIGHT, paths, (uint64_t)sampled));
            char label[64];
            snprintf(label, sizeof(label), "%s, %" PRIu64 " path%s", sampled ? "with" : "without",
                     paths, paths > 1 ? "s" : "");
            lecture_light_show(page, &pair, label);
            rmse[sampled] = lecture_light_rmse(&pair);
            rays[sampled] = lecture_light_rays(&pair);
            lecture_light_pair_free(&pair);
        }
    page_grid_end(page);
    double ratio = rmse[0] / rmse[1];
    page_note(page, "Result",
              "With 4 paths the error is %.3f without and %.3f with light sampling: worth %.0f "
              "times the paths. A path costs %.1f rays without, %.1f with it, so at equal rays it "
              "is worth %.0f times.",
              rmse[0], rmse[1], ratio * ratio, rays[0], rays[1], ratio * ratio * rays[0] / rays[1]);
}

/* ---- too few samples */

static void write_undersampling(struct lecture *lecture)
{
    struct page *page = lecture->page;
    struct caster_scene room = lecture_light_room(true);
    const struct caster_how how = { .light_sampling = true };
    uint64_t seed = hash64(lecture->seed, UNDERSAMPLING);
    struct lecture_rate rate = { 0 };
    struct lecture_pair pair = lecture_light_pair(&room, &how, size_of(lecture), 1, seed);
    page_section(page, "Too few samples: 1, 4, 64 and 1024 rays");
    page_grid_begin(page, 200);
    for (uint64_t rays = 1; rays <= (lecture->quick ? 64u : 1024u); rays *= 2) {
        if (rays > 1)
            lecture_light_more(&pair, &room, &how, rays / 2, seed);
        lecture_rate_note(&rate, rays, lecture_light_rmse(&pair), 3.0 / size_of(lecture));
        char label[64];
        snprintf(label, sizeof(label), "%" PRIu64 " ray%s", rays, rays > 1 ? "s" : "");
        if (rays == 1 || rays == 4 || rays == 64 || rays == 1024)
            lecture_light_show(page, &pair, label);
    }
    page_grid_end(page);
    lecture_light_pair_free(&pair);
    char name[64];
    snprintf(name, sizeof(name), "measured: slope %s",
             lecture_slope_text(lecture_rate_fit(&rate, 1)));
    double half[LECTURE_RATE_MAX];
    for (size_t i = 0; i < rate.count; i++)
        half[i] = rate.rmse[rate.count - 1] * sqrt(rate.n[rate.count - 1] / rate.n[i]);
    const struct plot_series series[] = {
        { name, PLOT_MARKERS, rate.count, rate.n, rate.rmse, NULL },
        { "1/√N", PLOT_DASHED | PLOT_GREY, rate.count, rate.n, half, NULL },
    };
    page_plot(page,
              &(struct plot){ .title = "Error of the picture",
                              .x = { .label = "rays per pixel", .log = true },
                              .y = { .label = "root mean square error", .log = true },
                              .series = series,
                              .series_count = 2 },
              "Half the error costs four times the rays. These are independent numbers; "
              "`{pathfarm render} uses Sobol points, and `{pathfarm accuracy} measures what they "
              "are worth.");
}

void lecture_light_write(struct lecture *lecture)
{
    write_brdf(lecture);
    write_trees(lecture);
    write_equal_rays(lecture);
    write_results(lecture);
    write_light(lecture);
    write_many_lights(lecture);
    write_undersampling(lecture);
}
