/*
 * Russian roulette: the mean stays, and variance and length of paths are those of the rule that
 * path.c states (NUMERICS H47-H50): survive with probability q = throughput / REFERENCE, never
 * capped, from the second event on; a survivor carries the reference.
 *
 * In a closed box of constant albedo whose walls all emit 1, and with light sampling left out, a
 * path is worth the sum of its throughputs, and mean, variance and length are known exactly. The
 * same check judges a model of such a path tracer, sound and with roulettes that are wrong.
 */
#include "tests/chi2.h"
#include "tests/kernel_scenes.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#define REFERENCE 0.25 /* ROULETTE_REFERENCE of worker/kernel/path.c */

/* What is measured of many paths, with the moments that the errors of the first two need */
struct paths {
    double n, mean, variance, fourth, events; /* fourth: central moment; events: per path */
};

static struct paths paths_of(const double *values, size_t n, double events)
{
    struct paths p = { .n = (double)n, .events = events / (double)n };
    for (size_t i = 0; i < n; i++)
        p.mean += values[i] / p.n;
    for (size_t i = 0; i < n; i++) {
        double d2 = (values[i] - p.mean) * (values[i] - p.mean);
        p.variance += d2 / p.n;
        p.fourth += d2 * d2 / p.n;
    }
    return p;
}

/*
 * The first `sure` events have rho^i >= REFERENCE after them. The next survives with q; from then
 * on each does with rho, and adds REFERENCE: N - 1 times in a row, N geometric.
 */
struct rule {
    double mean, variance, events, events_variance;
};

static struct rule rule_of(double rho)
{
    double throughput = rho, sure = 0;
    while (throughput >= REFERENCE || sure < 1) {
        throughput *= rho;
        sure++;
    }
    double q = throughput / REFERENCE, left = 1 - rho;
    double first = q / left, second = q * (1 + rho) / (left * left); /* moments of survivors */
    double spread = second - first * first;
    return (struct rule){ .mean = 1 / left,
                          .variance = REFERENCE * REFERENCE * spread,
                          .events = sure + 1 + first,
                          .events_variance = spread };
}

/* What is wrong with these paths, or NULL */
static const char *complaint(const struct paths *p, double rho)
{
    const struct rule rule = rule_of(rho);
    if (fabs(p->mean - rule.mean) > 4.5 * sqrt(p->variance / p->n) + 1e-5 * rule.mean)
        return "the mean";
    double noise = sqrt(fmax(p->fourth - p->variance * p->variance, 0) / p->n);
    if (fabs(p->variance - rule.variance) > 4.5 * noise + 1e-5 * rule.variance)
        return "the variance";
    if (fabs(p->events - rule.events) > 4.5 * sqrt(rule.events_variance / p->n))
        return "the length";
    return NULL;
}

/* ---- the kernel */

static void no_light_sampling(struct kernel_scene *ks)
{
    for (uint32_t i = 0; i < ks->light_count; i++)
        ks->light_pmf[i] = 0;
}

static struct scene *furnace(float rho)
{
    static const float low[3] = { -1, -1, -1 }, high[3] = { 1, 1, 1 };
    struct scene *scene = scenes_begin(32, 32);
    scene->settings.sampler = SAMPLER_INDEPENDENT;
    scenes_box(scene, low, high, scenes_diffuse(scene, rho), 1);
    scenes_finish(scene);
    return scene;
}

static struct paths kernel_paths(float rho, uint32_t per_pixel)
{
    struct scene *scene = furnace(rho);
    double *values = calloc((size_t)32 * 32 * per_pixel, sizeof(*values)), events = 0;
    size_t n = 0;
    for (uint32_t i = 0; i < per_pixel; i++) {
        struct picture *p = picture_take(
            scene, (struct picture_how){
                       .samples = 1, .kernel = 1, .seed = i, .alter = no_light_sampling });
        for (size_t k = 0; k < (size_t)32 * 32; k++)
            values[n++] = (double)p->rgb[3 * k];
        events += (double)p->stats.events;
        assert_int_equal(p->failed + p->stats.truncated_paths + p->stats.rays_shadow, 0);
        picture_free(p);
    }
    struct paths paths = paths_of(values, n, events);
    free(values);
    scene_free(scene);
    return paths;
}

static void the_kernel_gambles_as_it_says(void **state) /* H47, H49, H50 */
{
    (void)state;
    const struct {
        float rho;
        uint32_t per_pixel;
    } cases[] = { { 0.1f, 32 }, { 0.5f, 32 }, { 0.9f, 32 }, { 0.98f, 8 }, { 0.999f, 1 } };
    for (int i = 0; i < 5; i++) {
        double rho = (double)cases[i].rho;
        struct paths p = kernel_paths(cases[i].rho, cases[i].per_pixel);
        struct rule rule = rule_of(rho);
        if (complaint(&p, rho) != NULL)
            fail_msg("rho %g, %s: mean %g variance %g length %g, the rule has %g, %g, %g", rho,
                     complaint(&p, rho), p.mean, p.variance, p.events, rule.mean, rule.variance,
                     rule.events);
    }
}

static void a_path_that_gives_no_light_back_ends(void **state) /* H49 */
{
    (void)state;
    struct paths p = kernel_paths(0, 1);
    EXPECT_NEAR(p.mean, 1, 0);
    EXPECT_NEAR(p.events, 0, 0);
}

/*
 * Inside glass the throughput is divided by eta^2, and light that leaves takes it back: without
 * eta^2 in the gamble, nine of ten rays in this ball would be gambled away (H48). With it a ball in
 * a uniform sky has no noise at all.
 */
static void light_in_glass_is_not_gambled_away(void **state)
{
    (void)state;
    const float iors[] = { 1.5f, 3 };
    for (int i = 0; i < 2; i++) {
        struct scene *scene = scenes_begin(32, 32);
        struct material glass = { .kind = MATERIAL_DIELECTRIC, .ior = iors[i] };
        scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, 2, 1.2f, scenes_material(scene, glass), 0);
        scenes_sky(scene, 1);
        scenes_finish(scene);
        struct picture *p = picture_take(scene, (struct picture_how){ .samples = 16 });
        EXPECT_NEAR(p->mean, 1, 1e-5);
        EXPECT_NEAR(p->largest, 1, 1e-5);
        EXPECT_NEAR(p->variance, 0, 1e-10);
        picture_free(p);

        /* Planted: a grey speck inside is gambled at, and seen as noise */
        scenes_quadric(scene, QUADRIC_SPHERE, 0, 0, 2, 0.2f, scenes_diffuse(scene, 0.5f), 0);
        scenes_finish(scene);
        p = picture_take(scene, (struct picture_how){ .samples = 16 });
        assert_true(p->variance > 1e-6);
        picture_free(p);
        scene_free(scene);
    }
}

/* ---- a model of it, and what the check must catch */

enum roulette {
    SOUND,
    CAPPED,      /* survival of at most .95 */
    NOT_DIVIDED, /* survivors keep their weight */
    TOO_KEEN,    /* survival by the square of the throughput */
    TOO_EARLY,   /* a reference of 1 */
    DIVIDED_LATE /* the weight of what it was before */
};

static struct paths model_paths(double rho, size_t n, enum roulette roulette)
{
    struct random_lanes r = { 47, 0 };
    double *values = calloc(n, sizeof(*values)), events = 0;
    for (size_t i = 0; i < n; i++) {
        double beta = 1, last = 1;
        for (unsigned event = 1;; event++) {
            values[i] += beta;
            events++;
            last = beta;
            beta *= rho;
            double q = beta / (roulette == TOO_EARLY ? 1 : REFERENCE);
            if (roulette == CAPPED)
                q = fmin(q, 0.95);
            if (roulette == TOO_KEEN)
                q *= q;
            if (event == 1 || q >= 1)
                continue;
            if (random_double(&r) >= q)
                break;
            if (roulette == DIVIDED_LATE)
                beta = last / fmin(last / REFERENCE, 1);
            else if (roulette != NOT_DIVIDED)
                beta /= q;
        }
    }
    struct paths paths = paths_of(values, n, events);
    free(values);
    return paths;
}

static void wrong_roulettes_are_noticed(void **state)
{
    (void)state;
    static const struct {
        const char *name;
        enum roulette roulette;
        const char *complaint;
    } cases[] = {
        { "sound", SOUND, NULL },
        { "capped", CAPPED, "the variance" },
        { "not divided", NOT_DIVIDED, "the mean" },
        { "too keen", TOO_KEEN, "the variance" },
        { "too early", TOO_EARLY, "the variance" },
        { "divided late", DIVIDED_LATE, "the mean" },
    };
    const double rhos[] = { 0.6, 0.9 };
    for (size_t i = 0; i < sizeof(cases) / sizeof(cases[0]); i++)
        for (int k = 0; k < 2; k++) {
            struct paths p = model_paths(rhos[k], 32768, cases[i].roulette);
            const char *found = complaint(&p, rhos[k]);
            if ((found == NULL) != (cases[i].complaint == NULL) ||
                (found != NULL && strcmp(found, cases[i].complaint) != 0))
                fail_msg("%s at rho %g: the check complains of %s", cases[i].name, rhos[k],
                         found != NULL ? found : "nothing");
        }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(the_kernel_gambles_as_it_says),
        cmocka_unit_test(a_path_that_gives_no_light_back_ends),
        cmocka_unit_test(light_in_glass_is_not_gambled_away),
        cmocka_unit_test(wrong_roulettes_are_noticed),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
