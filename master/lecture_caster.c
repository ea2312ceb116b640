#include "master/lecture_caster.h"

#include "common/elem.h"
#include "master/image.h"

#include <math.h>
#include <stdlib.h>

#define NEAREST 1e-6 /* a reflected ray does not hit where it starts */

struct hit {
    double t;
    lecture_vec p, n; /* n towards where the ray came from */
    bool front;       /* of a parallelogram, which emits there only */
    const struct caster_object *object;
};

static double dot(lecture_vec a, lecture_vec b)
{
    lecture_vec c = a * b;
    return c[0] + c[1] + c[2];
}

static lecture_vec cross(lecture_vec a, lecture_vec b)
{
    return LECTURE_VEC(a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
                       a[0] * b[1] - a[1] * b[0]);
}

static lecture_vec unit(lecture_vec a)
{
    return a / sqrt(dot(a, a));
}

static double sum_of(lecture_vec colour)
{
    return colour[0] + colour[1] + colour[2];
}

/* ---- where rays hit */

static double hit_sphere(const struct caster_object *s, lecture_vec o, lecture_vec d)
{
    lecture_vec c = s->at - o;
    double middle = dot(c, d), root = middle * middle - dot(c, c) + s->radius * s->radius;
    if (root < 0)
        return INFINITY;
    root = sqrt(root);
    return middle - root > NEAREST ? middle - root : middle + root;
}

static double hit_parallelogram(const struct caster_object *q, lecture_vec o, lecture_vec d,
                                double end)
{
    /* Solve o + t d = at + a u + b v by Cramer's rule */
    lecture_vec n = cross(q->u, q->v), from = o - q->at;
    double det = dot(d, n), t = -dot(from, n) / det;
    if (!(t > NEAREST && t < end))
        return INFINITY;
    lecture_vec across = cross(d, from);
    double a = dot(across, q->v) / det, b = -dot(across, q->u) / det;
    return a >= 0 && a <= 1 && b >= 0 && b <= 1 ? t : INFINITY;
}

static bool cast(const struct caster_scene *scene, lecture_vec o, lecture_vec d, double end,
                 struct hit *hit)
{
    *hit = (struct hit){ .t = end };
    for (unsigned i = 0; i < scene->object_count; i++) {
        const struct caster_object *object = &scene->objects[i];
        double t = object->sphere ? hit_sphere(object, o, d)
                                  : hit_parallelogram(object, o, d, hit->t);
        if (t > NEAREST && t < hit->t) {
            hit->t = t;
            hit->object = object;
        }
    }
    if (hit->object == NULL)
        return false;
    hit->p = o + hit->t * d;
    hit->n = hit->object->sphere ? unit(hit->p - hit->object->at)
                                 : unit(cross(hit->object->u, hit->object->v));
    hit->front = dot(hit->n, d) < 0;
    if (!hit->front)
        hit->n = -hit->n;
    return true;
}

/* The surface at a hit: with its checks resolved */
static struct caster_surface surface_at(const struct hit *hit)
{
    struct caster_surface surface = hit->object->surface;
    if (surface.checks > 0) {
        int64_t x = (int64_t)floor(hit->p[0] / surface.checks);
        int64_t z = (int64_t)floor(hit->p[2] / surface.checks);
        if ((x + z) & 1)
            surface.kd = surface.ks = LECTURE_VEC(0, 0, 0);
    }
    return surface;
}

/* ---- directions */

/* About the z axis to about n */
static lecture_vec lift(lecture_vec n, double x, double y, double z)
{
    lecture_vec across = fabs(n[0]) > .6 ? LECTURE_VEC(0, 1, 0) : LECTURE_VEC(1, 0, 0);
    lecture_vec a = unit(cross(n, across)), b = cross(n, a);
    return x * a + y * b + z * n;
}

/* About n, with the cosine of the angle given and the turn random */
static lecture_vec around(lecture_vec n, double cos_angle, double turn)
{
    double across = sqrt(fmax(0, 1 - cos_angle * cos_angle));
    double phi = 2 * LECTURE_PI * turn;
    return lift(n, across * elem_cos(phi), across * elem_sin(phi), cos_angle);
}

lecture_vec lecture_caster_uniform(lecture_vec n, struct lecture_dice *dice)
{
    double turn = lecture_roll(dice);
    return around(n, lecture_roll(dice), turn);
}

lecture_vec lecture_caster_cosine(lecture_vec n, struct lecture_dice *dice)
{
    double turn = lecture_roll(dice);
    return around(n, sqrt(1 - lecture_roll(dice)), turn);
}

/* f of both parts */
static lecture_vec brdf(const struct caster_surface *s, lecture_vec n, lecture_vec wo,
                        lecture_vec wi)
{
    double c = dot(2 * dot(n, wo) * n - wo, wi);
    double lobe = c > 0 ? (s->exponent + 2) / (2 * LECTURE_PI) * elem_pow(c, s->exponent) : 0;
    return s->kd / LECTURE_PI + lobe * s->ks;
}

bool lecture_caster_reflect(const struct caster_surface *s, lecture_vec n, lecture_vec wo,
                            struct lecture_dice *dice, lecture_vec *wi, lecture_vec *weight,
                            bool *diffuse)
{
    double kd = sum_of(s->kd), ks = sum_of(s->ks);
    if (kd + ks == 0)
        return false;
    double p = kd / (kd + ks);
    *diffuse = lecture_roll(dice) < p;
    if (*diffuse) {
        *wi = lecture_caster_cosine(n, dice);
        *weight = s->kd / p;
        return true;
    }
    lecture_vec mirror = 2 * dot(n, wo) * n - wo;
    if (isinf(s->exponent)) {
        *wi = mirror;
        *weight = s->ks / (1 - p);
        return true;
    }
    /* Density (n + 1) / (2 pi) cos^n about the mirror direction */
    double turn = lecture_roll(dice);
    double cos_angle = elem_pow(1 - lecture_roll(dice), 1 / (s->exponent + 1));
    *wi = around(mirror, cos_angle, turn);
    *weight = s->ks * ((s->exponent + 2) / (s->exponent + 1) * dot(n, *wi) / (1 - p));
    return dot(n, *wi) > 0;
}

/* ---- light */

/* What a random point of the light sends by way of the surface's diffuse part */
static lecture_vec direct(const struct caster_scene *scene, const struct hit *hit,
                          const struct caster_surface *s, struct lecture_dice *dice,
                          struct caster_counts *counts)
{
    const struct caster_object *light = &scene->objects[scene->light];
    double a = lecture_roll(dice), b = lecture_roll(dice);
    lecture_vec to = light->at + a * light->u + b * light->v - hit->p;
    double distance = sqrt(dot(to, to));
    lecture_vec wi = to / distance, n = cross(light->u, light->v);
    double area = sqrt(dot(n, n)), cos_light = -dot(n, wi) / area, cos_here = dot(hit->n, wi);
    if (cos_light <= 0 || cos_here <= 0)
        return LECTURE_VEC(0, 0, 0);
    struct hit between;
    counts->shadow_rays++;
    if (cast(scene, hit->p, wi, distance * (1 - 1e-9), &between))
        return LECTURE_VEC(0, 0, 0);
    return s->kd / LECTURE_PI * light->surface.emission *
           (cos_here * cos_light * area / (distance * distance));
}

/* As lecture_caster_radiance; without `with_light`, the light's own shine does not count: a ray to
 * it has been sent */
static lecture_vec radiance(const struct caster_scene *scene, const struct caster_how *how,
                            lecture_vec o, lecture_vec d, unsigned depth, bool with_light,
                            struct lecture_dice *dice, struct caster_counts *counts)
{
    struct hit hit;
    counts->rays[depth < CASTER_DEPTHS ? depth : CASTER_DEPTHS - 1]++;
    if (!cast(scene, o, d, INFINITY, &hit))
        return scene->sky != NULL ? scene->sky(d) : LECTURE_VEC(0, 0, 0);
    struct caster_surface surface = surface_at(&hit);
    lecture_vec light = LECTURE_VEC(0, 0, 0);
    bool is_light = scene->light >= 0 && hit.object == &scene->objects[scene->light];
    if (hit.front && (with_light || !is_light))
        light = surface.emission;
    if (how->max_depth > 0 && depth >= how->max_depth)
        return light;

    bool to_light = how->light_sampling && !how->uniform && scene->light >= 0 &&
                    sum_of(surface.kd) > 0;
    if (to_light)
        light += direct(scene, &hit, &surface, dice, counts);

    unsigned branches = how->branches > 1 ? how->branches : 1;
    for (unsigned i = 0; i < branches; i++) {
        lecture_vec wi, weight;
        bool diffuse;
        if (how->uniform) {
            wi = lecture_caster_uniform(hit.n, dice);
            weight = brdf(&surface, hit.n, -d, wi) * (2 * LECTURE_PI * dot(hit.n, wi));
            diffuse = false;
        } else if (!lecture_caster_reflect(&surface, hit.n, -d, dice, &wi, &weight, &diffuse)) {
            continue;
        }
        *(diffuse ? &counts->diffuse : &counts->specular) += 1;

        /* Russian roulette: the survivors stand for those that are gone */
        double q = how->survival;
        if (q == 0) {
            lecture_vec k = surface.kd + surface.ks;
            q = fmin(fmax(k[0], fmax(k[1], k[2])), 1);
        }
        if (lecture_roll(dice) >= q)
            continue;
        light += weight / (q * branches) *
                 radiance(scene, how, hit.p, wi, depth + 1, !(to_light && diffuse), dice, counts);
    }
    return light;
}

lecture_vec lecture_caster_radiance(const struct caster_scene *scene, const struct caster_how *how,
                                    lecture_vec o, lecture_vec d, unsigned depth,
                                    struct lecture_dice *dice, struct caster_counts *counts)
{
    return radiance(scene, how, o, d, depth, true, dice, counts);
}

/* ---- pictures */

struct caster_film lecture_caster_film(unsigned width, unsigned height)
{
    return (struct caster_film){ width, height, 0,
                                 calloc((size_t)width * height, 3 * sizeof(double)) };
}

void lecture_caster_film_free(struct caster_film *film)
{
    free(film->sums);
    *film = (struct caster_film){ 0 };
}

lecture_vec lecture_caster_camera(const struct caster_scene *scene, const struct caster_film *film,
                                  unsigned x, unsigned y, struct lecture_dice *dice)
{
    lecture_vec forward = unit(scene->target - scene->eye);
    lecture_vec right = unit(cross(forward, LECTURE_VEC(0, 1, 0))), up = cross(right, forward);
    double a = (2 * (x + lecture_roll(dice)) - film->width) / film->height;
    double b = 1 - 2 * (y + lecture_roll(dice)) / film->height;
    return unit(forward + scene->tan_half_fov * (a * right + b * up));
}

void lecture_caster_expose(struct caster_film *film, const struct caster_scene *scene,
                           const struct caster_how *how, uint64_t samples, uint64_t seed,
                           struct caster_counts *counts)
{
    if (film->sums == NULL)
        return;
    for (unsigned y = 0; y < film->height; y++)
        for (unsigned x = 0; x < film->width; x++) {
            uint64_t pixel = (uint64_t)y * film->width + x;
            lecture_vec sum = LECTURE_VEC(0, 0, 0);
            for (uint64_t i = 0; i < samples; i++) {
                struct lecture_dice dice = lecture_dice(seed, pixel, film->samples + i);
                lecture_vec d = lecture_caster_camera(scene, film, x, y, &dice);
                sum += lecture_caster_radiance(scene, how, scene->eye, d, 0, &dice, counts);
            }
            for (int c = 0; c < 3; c++)
                film->sums[3 * pixel + (unsigned)c] += sum[c];
        }
    film->samples += samples;
}

struct image *lecture_caster_image(const struct caster_film *film)
{
    static const char *const NAMES[3] = { "R", "G", "B" };
    struct image *image = film->sums == NULL ? NULL : image_new(film->width, film->height);
    for (size_t c = 0; image != NULL && c < 3; c++) {
        float *values = image_add_channel(image, NAMES[c]);
        if (values == NULL) {
            image_free(image);
            return NULL;
        }
        for (size_t i = 0; i < (size_t)film->width * film->height; i++)
            values[i] = (float)(film->sums[3 * i + c] / (double)film->samples);
    }
    return image;
}

double lecture_caster_mean(const struct caster_film *film)
{
    size_t count = 3 * (size_t)film->width * film->height;
    double sum = 0;
    for (size_t i = 0; film->sums != NULL && i < count; i++)
        sum += film->sums[i];
    return sum / ((double)count * (double)film->samples);
}

double lecture_caster_rmse(const struct caster_film *a, const struct caster_film *b)
{
    size_t count = 3 * (size_t)a->width * a->height;
    double sum = 0;
    for (size_t i = 0; a->sums != NULL && b->sums != NULL && i < count; i++) {
        double difference = a->sums[i] / (double)a->samples - b->sums[i] / (double)b->samples;
        sum += difference * difference;
    }
    return sqrt(sum / (double)count / 2);
}
