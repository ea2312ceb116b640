#include "worker/kernel/light_tree.h"

#include "common/err.h"
#include "common/scene.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PI          3.14159265358979323846
#define BINS        16   /* along each axis, of the lights' centers, where a range is cut */
#define LEAST_SHARE 1e-6 /* of the mean power, that a weak light keeps */

/*
 * Bounds grow by what rounding may take from them: of positions in units of the largest coordinate,
 * of cosines in units of one. The least radius keeps squared distances within float's range.
 */
#define PAD_POSITION 1e-6
#define PAD_COSINE   1e-6
#define LEAST_RADIUS 1e-15

/* A light, or a range of them, as the tree sees it */
struct cluster {
    double low[3], high[3];
    double center[3], radius;
    double axis[3]; /* zero where light goes everywhere */
    double cos_o, cos_e;
    double power; /* largest radiant intensity, as a share of all */
    uint32_t light;
    bool two_sided;
};

struct range {
    uint32_t first, count;
    double cost;
};

struct builder {
    const struct scene *scene;
    struct light_tree *tree;
    struct cluster *lights;
    uint32_t light_count, node_capacity;
};

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* ---- what a light is to the tree */

static void set3(double to[3], const float from[3])
{
    for (int axis = 0; axis < 3; axis++)
        to[axis] = (double)from[axis];
}

/* Not by fmin and fmax, which are calls: most of the time of a build is spent here */
static void grow_box(double low[3], double high[3], const double a[3], const double b[3])
{
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = a[axis] < low[axis] ? a[axis] : low[axis];
        high[axis] = b[axis] > high[axis] ? b[axis] : high[axis];
    }
}

static void empty_box(double low[3], double high[3])
{
    for (int axis = 0; axis < 3; axis++) {
        low[axis] = INFINITY;
        high[axis] = -INFINITY;
    }
}

static double distance(const double a[3], const double b[3])
{
    const double ab[3] = { a[0] - b[0], a[1] - b[1], a[2] - b[2] };
    return sqrt(dot(ab, ab));
}

static void polygon_cluster(const float (*corners)[3], uint32_t count, struct cluster *c)
{
    empty_box(c->low, c->high);
    for (uint32_t i = 0; i < count; i++) {
        double corner[3];
        set3(corner, corners[i]);
        grow_box(c->low, c->high, corner, corner);
    }
    for (int axis = 0; axis < 3; axis++)
        c->center[axis] = (c->low[axis] + c->high[axis]) / 2;
    for (uint32_t i = 0; i < count; i++) {
        double corner[3];
        set3(corner, corners[i]);
        c->radius = fmax(c->radius, distance(corner, c->center));
    }
}

static void ball_cluster(const float center[3], double radius, struct cluster *c)
{
    set3(c->center, center);
    c->radius = radius;
    for (int axis = 0; axis < 3; axis++) {
        c->low[axis] = c->center[axis] - radius;
        c->high[axis] = c->center[axis] + radius;
    }
}

static struct cluster cluster_of(const struct scene *scene, uint32_t index)
{
    const struct light *light = &scene->lights[index];
    const struct quadric *quadric = &scene->quadrics[light->quadric]; /* of spheres and disks */
    const float *rgb = light->radiance;
    struct cluster c = { .light = index,
                         .power = 0.2126 * (double)rgb[0] + 0.7152 * (double)rgb[1] +
                                  0.0722 * (double)rgb[2],
                         .cos_o = -1,
                         .two_sided = light->flags & LIGHT_TWO_SIDED };
    switch (light->kind) {
    case LIGHT_POLYGON:
        polygon_cluster((const float(*)[3])(scene->light_corners + 3 * (size_t)light->first_corner),
                        light->corner_count, &c);
        set3(c.axis, light->normal);
        c.cos_o = 1;
        c.power *= (double)light->area;
        break;
    case LIGHT_DISK:
        ball_cluster(quadric->center, (double)quadric->world_radius, &c);
        set3(c.axis, light->normal);
        c.cos_o = 1;
        c.power *= (double)light->area;
        break;
    case LIGHT_SPHERE:
        ball_cluster(quadric->center, (double)quadric->world_radius, &c);
        c.power *= PI * c.radius * c.radius;
        c.two_sided = false; /* all directions already */
        break;
    case LIGHT_SPOT: {
        /* Full intensity up to the first angle, none beyond the second */
        double start = (double)light->cos_falloff_start, end = (double)light->cos_falloff_end;
        ball_cluster(light->position, 0, &c);
        set3(c.axis, light->direction);
        c.cos_o = start;
        c.cos_e = start > end ? start * end +
                                    sqrt(fmax(1 - start * start, 0)) * sqrt(fmax(1 - end * end, 0))
                              : 1;
        break;
    }
    default: /* points */
        ball_cluster(light->position, 0, &c);
    }
    return c;
}

/* The axis of a light that shines from both sides is that of the half space of +z */
static double axis_sign(const struct cluster *c)
{
    const double *a = c->axis;
    bool back = a[2] < 0 || (a[2] == 0 && (a[1] < 0 || (a[1] == 0 && a[0] < 0)));
    return c->two_sided && back ? -1 : 1;
}

/* ---- ranges of lights as clusters */

static double cos_of_sum(double cos_a, double cos_b) /* of angles up to pi; at most pi itself */
{
    if (cos_a + cos_b <= 0)
        return -1;
    return cos_a * cos_b - sqrt(fmax(1 - cos_a * cos_a, 0)) * sqrt(fmax(1 - cos_b * cos_b, 0));
}

static struct cluster cluster_of_range(const struct cluster *lights, uint32_t count)
{
    struct cluster c = lights[0];
    if (count == 1)
        return c;
    c = (struct cluster){ .cos_o = 1, .cos_e = 1 };
    empty_box(c.low, c.high);
    for (uint32_t i = 0; i < count; i++) {
        const struct cluster *l = &lights[i];
        double sign = axis_sign(l) * l->power;
        grow_box(c.low, c.high, l->low, l->high);
        for (int axis = 0; axis < 3; axis++)
            c.axis[axis] += sign * l->axis[axis];
        c.cos_e = fmin(c.cos_e, l->cos_e);
        c.power += l->power;
        c.two_sided |= l->two_sided;
    }
    double length = sqrt(dot(c.axis, c.axis));
    for (int axis = 0; axis < 3; axis++) {
        c.axis[axis] = length > 0 ? c.axis[axis] / length : 0;
        c.center[axis] = (c.low[axis] + c.high[axis]) / 2;
    }
    double reach = 0;
    for (uint32_t i = 0; i < count; i++) {
        const struct cluster *l = &lights[i];
        double cosine = length > 0 ? axis_sign(l) * dot(c.axis, l->axis) : -1;
        c.cos_o = fmin(c.cos_o, cos_of_sum(cosine, l->cos_o));
        reach = fmax(reach, distance(l->center, c.center) + l->radius);
    }
    c.radius = fmin(reach, distance(c.low, c.high) / 2);
    return c;
}

/* ---- cutting a range in two */

/*
 * What a group of lights costs: power, times its extent, times how far its lights face apart. As
 * Conty Estevez and Kulla's measure of surface area and orientation, but of the bounding sphere,
 * which is what the weights see; and of the cone, which for lights spread evenly over one of half
 * angle o follows from the length of their mean axis, (1 + cos o) / 2, without trigonometry: their
 * integral over its directions is close to linear in cos o, from 1 to 4 times pi.
 */
struct light_group {
    double low[3], high[3], axis[3], power;
};

static void group_clear(struct light_group *g)
{
    *g = (struct light_group){ .power = 0 };
    empty_box(g->low, g->high);
}

static void group_add(struct light_group *g, const struct light_group *other)
{
    grow_box(g->low, g->high, other->low, other->high);
    for (int axis = 0; axis < 3; axis++)
        g->axis[axis] += other->axis[axis];
    g->power += other->power;
}

static void group_add_light(struct light_group *g, const struct cluster *light)
{
    double sign = axis_sign(light) * light->power;
    grow_box(g->low, g->high, light->low, light->high);
    for (int axis = 0; axis < 3; axis++)
        g->axis[axis] += sign * light->axis[axis];
    g->power += light->power;
}

static double group_cost(const struct light_group *g)
{
    if (!(g->power > 0))
        return 0;
    double extent = distance(g->low, g->high), mean = sqrt(dot(g->axis, g->axis)) / g->power;
    return g->power * extent * extent * (4 - 3 * mean);
}

static uint32_t bin_of(double x, double low, double scale)
{
    double at = (x - low) * scale;
    return at < BINS - 1 ? (uint32_t)at : BINS - 1;
}

struct cut {
    int axis;
    uint32_t bin; /* the first of the upper part */
    double low, scale;
    double cost, cost_low, cost_high;
};

static void cut_along(const struct light_group bins[BINS], struct cut *best, int axis, double low,
                      double scale)
{
    double costs[BINS];
    struct light_group below, above;
    group_clear(&below);
    for (int i = 0; i < BINS - 1; i++) {
        group_add(&below, &bins[i]);
        costs[i + 1] = group_cost(&below);
    }
    group_clear(&above);
    for (int i = BINS - 1; i > 0; i--) {
        group_add(&above, &bins[i]);
        double high = group_cost(&above), cost = costs[i] + high;
        if (cost < best->cost)
            *best = (struct cut){ axis, (uint32_t)i, low, scale, cost, costs[i], high };
    }
}

/* Lights of the range's first part, moved to its front; at least one on either side */
static uint32_t cut_range(struct cluster *lights, uint32_t count, struct cut *cut)
{
    double low[3], high[3];
    empty_box(low, high);
    for (uint32_t i = 0; i < count; i++)
        grow_box(low, high, lights[i].center, lights[i].center);
    *cut = (struct cut){ .cost = INFINITY };
    double scale[3];
    struct light_group bins[3][BINS];
    for (int axis = 0; axis < 3; axis++) {
        scale[axis] = BINS / (high[axis] - low[axis]);
        for (int i = 0; i < BINS; i++)
            group_clear(&bins[axis][i]);
    }
    for (uint32_t i = 0; i < count; i++)
        for (int axis = 0; axis < 3; axis++)
            if (isfinite(scale[axis]))
                group_add_light(&bins[axis][bin_of(lights[i].center[axis], low[axis], scale[axis])],
                                &lights[i]);
    for (int axis = 0; axis < 3; axis++)
        if (isfinite(scale[axis]))
            cut_along(bins[axis], cut, axis, low[axis], scale[axis]);
    if (!(cut->cost < INFINITY)) { /* all in one place */
        cut->cost_low = cut->cost_high = 0;
        return count / 2;
    }
    uint32_t below = 0;
    for (uint32_t i = 0; i < count; i++)
        if (bin_of(lights[i].center[cut->axis], cut->low, cut->scale) < cut->bin) {
            struct cluster moved = lights[i];
            lights[i] = lights[below];
            lights[below++] = moved;
        }
    return below;
}

/*
 * A range as up to eight: the costliest is cut as long as it would not fit into a node; then those
 * that fit into what room there is are opened, smallest first, and save their node.
 */
static unsigned cut_in_eight(struct cluster *lights, struct range parts[LANES])
{
    unsigned n = 1;
    while (n < LANES) {
        struct range *worst = NULL;
        for (unsigned i = 0; i < n; i++)
            if (parts[i].count > LANES && (worst == NULL || parts[i].cost > worst->cost))
                worst = &parts[i];
        if (worst == NULL)
            break;
        struct cut cut;
        uint32_t below = cut_range(lights + worst->first, worst->count, &cut);
        parts[n++] = (struct range){ worst->first + below, worst->count - below, cut.cost_high };
        *worst = (struct range){ worst->first, below, cut.cost_low };
    }
    for (;;) {
        struct range *small = NULL;
        for (unsigned i = 0; i < n; i++)
            if (parts[i].count > 1 && (small == NULL || parts[i].count < small->count))
                small = &parts[i];
        if (small == NULL || n - 1 + small->count > LANES)
            return n;
        while (small->count > 1)
            parts[n++] = (struct range){ small->first + --small->count, 1, 0 };
    }
}

/* ---- nodes */

static void put_cluster(const struct cluster *c, struct light_node *node, unsigned slot)
{
    double magnitude = 0;
    for (int axis = 0; axis < 3; axis++) {
        node->center[axis][slot] = (float)c->center[axis];
        node->axis[axis][slot] = (float)c->axis[axis];
        magnitude = fmax(magnitude, fmax(fabs(c->low[axis]), fabs(c->high[axis])));
    }
    node->radius[slot] = (float)(c->radius * (1 + PAD_POSITION) + magnitude * PAD_POSITION +
                                 LEAST_RADIUS);
    double cos_o = fmax(c->cos_o - PAD_COSINE, -1);
    node->cos_o[slot] = (float)cos_o;
    node->sin_o[slot] = (float)sqrt(1 - cos_o * cos_o);
    node->cos_e[slot] = (float)c->cos_e;
    node->power[slot] = (float)(c->two_sided ? -c->power : c->power);
}

static bool node_add(struct builder *b, struct err *err)
{
    struct light_tree *tree = b->tree;
    if (tree->node_count == b->node_capacity) {
        size_t size = sizeof(*tree->nodes);
        uint32_t capacity = b->node_capacity * 2 + 64;
        struct light_node *nodes = aligned_alloc(_Alignof(struct light_node), capacity * size);
        if (nodes == NULL)
            return err_set(err, ERR_MEMORY, "no memory for a tree of %u lights", b->light_count);
        if (tree->node_count > 0)
            memcpy(nodes, tree->nodes, tree->node_count * size);
        free(tree->nodes);
        tree->nodes = nodes;
        b->node_capacity = capacity;
    }
    struct light_node *node = &tree->nodes[tree->node_count++];
    memset(node, 0, sizeof(*node));
    for (int slot = 0; slot < LANES; slot++)
        node->radius[slot] = 1;
    return true;
}

/* The node of a range of lights; as deep as cuts at bins are, at worst some hundred levels */
static bool node_make(struct builder *b, struct range range, int32_t parent, struct err *err)
{
    int32_t index = (int32_t)b->tree->node_count;
    if (!node_add(b, err))
        return false;
    struct range parts[LANES] = { range };
    unsigned n = cut_in_eight(b->lights, parts);
    b->tree->nodes[index].parent = parent;
    for (unsigned slot = 0; slot < n; slot++) {
        const struct cluster *lights = b->lights + parts[slot].first;
        struct cluster c = cluster_of_range(lights, parts[slot].count);
        put_cluster(&c, &b->tree->nodes[index], slot);
        int32_t place = LANES * index + (int32_t)slot;
        if (parts[slot].count == 1) {
            b->tree->nodes[index].child[slot] = ~(int32_t)lights[0].light;
            b->tree->place[lights[0].light] = place;
            continue;
        }
        b->tree->nodes[index].child[slot] = (int32_t)b->tree->node_count;
        if (!node_make(b, parts[slot], place, err))
            return false;
    }
    return true;
}

/* ---- opening and closing */

static bool at_infinity(const struct light *light)
{
    return light->kind == LIGHT_DISTANT || light->kind == LIGHT_SKY;
}

static void gather_lights(struct builder *b, const float *pmf)
{
    const struct scene *scene = b->scene;
    struct light_tree *tree = b->tree;
    double power = 0;
    for (uint32_t i = 0; i < scene->light_count; i++) {
        if (at_infinity(&scene->lights[i])) {
            bool sampled = pmf[i] > 0;
            tree->place[i] = sampled ? LIGHT_TREE_INFINITE : LIGHT_TREE_NEVER;
            if (sampled)
                tree->infinite[tree->infinite_count++] = i;
            continue;
        }
        b->lights[b->light_count] = cluster_of(scene, i);
        power += b->lights[b->light_count++].power;
    }
    /* Shares of all power, so that weights stay within float's range */
    double least = LEAST_SHARE / b->light_count;
    for (uint32_t i = 0; i < b->light_count; i++) {
        struct cluster *c = &b->lights[i];
        c->power = fmax(power > 0 ? c->power / power : 1.0 / b->light_count, least);
    }
    tree->share = 1 / (float)(tree->infinite_count + 1);
}

bool light_tree_open(struct light_tree *tree, const struct scene *scene, const float *pmf,
                     struct err *err)
{
    struct builder b = { .scene = scene, .tree = tree };
    size_t n = scene->light_count;
    memset(tree, 0, sizeof(*tree));
    b.lights = malloc(n * sizeof(*b.lights));
    tree->place = malloc(n * sizeof(*tree->place));
    tree->infinite = malloc(n * sizeof(*tree->infinite));
    if (b.lights == NULL || tree->place == NULL || tree->infinite == NULL) {
        free(b.lights);
        return err_set(err, ERR_MEMORY, "no memory for a tree of %zu lights", n);
    }
    gather_lights(&b, pmf);
    bool good = node_make(&b, (struct range){ 0, b.light_count, 0 }, -1, err);
    free(b.lights);
    return good;
}

void light_tree_close(struct light_tree *tree)
{
    free(tree->nodes);
    free(tree->place);
    free(tree->infinite);
    memset(tree, 0, sizeof(*tree));
}
