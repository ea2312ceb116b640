/*
 * Direct light by light sampling alone, by scattering alone, and by both under their weights. The
 * three are one integral, and must agree within four standard errors.
 *
 * All are pictures of the path kernel itself. What a light says about how often it is chosen enters
 * both its samples and the weight of a ray that finds it by chance. Where it says never, scattering
 * is left alone; where it says 2^40 times as often as it is, light sampling is, and the picture is
 * 2^-40 of the true one.
 *
 * What the job can switch off (common/job.h) must agree with them, too: technique_switched.
 */
#ifndef TESTS_TECHNIQUES_H
#define TESTS_TECHNIQUES_H

#include "tests/kernel_scenes.h"

/* Planted ones have seeds of their own; what is wrong in them, picture_how.alter says */
enum technique { LIGHTS, SCATTERING, BOTH, LIGHTS_PLANTED, BOTH_PLANTED };

#define OVERSTATED 0x1p40f

static inline void technique_overstate(struct kernel_scene *ks, float by)
{
    for (uint32_t i = 0; i < ks->light_count; i++)
        ks->light_pmf[i] *= by;
}

static inline void technique_lights_alone(struct kernel_scene *ks)
{
    technique_overstate(ks, OVERSTATED);
}

static inline void technique_scattering_alone(struct kernel_scene *ks)
{
    technique_overstate(ks, 0);
}

struct estimate {
    double mean, error; /* standard error of the mean */
};

static inline struct estimate estimate_of(const struct picture *p, double scale)
{
    return (struct estimate){ scale * p->mean, scale * sqrt(p->variance / p->pixels) };
}

/* `how` says samples and leaves; its `alter`, if any, takes the place of the technique's own */
static inline struct estimate estimate_take(const struct scene *scene, enum technique technique,
                                            struct picture_how how)
{
    void (*const alter[BOTH_PLANTED + 1])(struct kernel_scene *) = {
        [LIGHTS] = technique_lights_alone, [SCATTERING] = technique_scattering_alone
    };
    if (how.alter == NULL)
        how.alter = alter[technique];
    how.kernel = 1; /* its lights are always chosen from a table */
    how.seed = technique;
    struct picture *p = picture_take(scene, how);
    bool alone = technique == LIGHTS || technique == LIGHTS_PLANTED;
    struct estimate e = estimate_of(p, alone ? (double)OVERSTATED : 1);
    assert_int_equal(p->failed, 0);
    picture_free(p);
    return e;
}

/* Standard errors between two of them; rounding counts as 1e-5 */
static inline double estimate_apart(struct estimate a, struct estimate b)
{
    return fabs(a.mean - b.mean) / (hypot(a.error, b.error) + 1e-5 * fabs(a.mean) + 1e-30);
}

/* The same with techniques that the job switches off; a light's word on itself stays as it is */
static inline struct estimate technique_switched(const struct scene *scene, uint32_t off,
                                                 struct picture_how how)
{
    how.alter = NULL;
    how.techniques_off = off;
    how.seed = BOTH_PLANTED + 1 + off;
    struct picture *p = picture_take(scene, how);
    struct estimate e = estimate_of(p, 1);
    assert_string_equal(p->variant, "everything");
    assert_int_equal(p->failed, 0);
    picture_free(p);
    return e;
}

/* Without light sampling, and with it but without weights, there is as much light as `want` */
static inline void technique_expect_switches(const struct scene *scene, struct picture_how how,
                                             struct estimate want, const char *name)
{
    for (uint32_t off = TECHNIQUE_LIGHT_SAMPLING; off <= TECHNIQUE_MIS; off++) {
        if (off == TECHNIQUE_LIGHT_SAMPLING && (scene->settings.effects & FX_DELTA_LIGHT))
            continue;
        struct estimate e = technique_switched(scene, off, how);
        if (!(estimate_apart(e, want) < 4))
            fail_msg("%s: %g +- %g without %s, want %g +- %g", name, e.mean, e.error,
                     off == TECHNIQUE_MIS ? "weights" : "light sampling", want.mean, want.error);
    }
}

/* A speck at the origin that faces +z; every pixel looks at it from `camera` along `forward` */
static inline void technique_receiver(struct scene *scene, uint32_t material, const float camera[3],
                                      const float forward[3])
{
    scene->settings.max_depth = 1;
    scene->settings.camera = (struct camera){ .screen = { -1, 1, -1, 1 } };
    memcpy(scene->settings.camera.position, camera, 3 * sizeof(float));
    memcpy(scene->settings.camera.forward, forward, 3 * sizeof(float));
    static const float speck[4][3] = {
        { -0.01f, -0.01f, 0 }, { 0.01f, -0.01f, 0 }, { 0.01f, 0.01f, 0 }, { -0.01f, 0.01f, 0 }
    };
    scenes_quad(scene, speck, material, 0);
}

#endif
