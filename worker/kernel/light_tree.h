/*
 * Choosing among many lights by what each receiver may get from them: a tree of light clusters,
 * after Conty Estevez and Kulla, "Importance Sampling of Many Lights with Adaptive Tree Splitting"
 * (2018), without its splitting. Every node has up to eight children, which are weighed side by
 * side in the lanes: a walk takes about log8 n steps, and is led by the finest clusters at hand.
 *
 * A cluster is a bounding sphere, a cone that holds the directions its lights face, how far beyond
 * the cone they shine, and their intensity. Its weight bounds what arrives: intensity, times the
 * largest cosines possible at the lights and at the receiver, over the squared distance to their
 * center. It is zero only where no light of the cluster can contribute. Where all weights of a node
 * are zero its children share evenly, so that the probabilities of all lights always sum to one.
 *
 * Lights at infinity stand beside the tree: each is chosen as often as the whole tree.
 *
 * Choices come in steps of the random number's 2^-24; a light's share of them is right on average
 * over receivers, however small it is.
 *
 * Built by one thread at kernel_open, read-only and shared by all afterwards. Whatever decides the
 * tree is IEEE arithmetic in the order of the lights, so every worker builds the same.
 */
#ifndef WORKER_KERNEL_LIGHT_TREE_H
#define WORKER_KERNEL_LIGHT_TREE_H

#include "common/lane.h"

#include <stdbool.h>
#include <stdint.h>

struct err;
struct scene;

/* A node is its children's clusters, one per lane */
struct light_node {
    _Alignas(64) float center[3][LANES];
    float radius[LANES];              /* above zero, rounding included */
    float axis[3][LANES];             /* of the cone; unit */
    float cos_o[LANES], sin_o[LANES]; /* half angle of the cone */
    float cos_e[LANES];   /* how far from the nearest direction of the cone a light shines */
    float power[LANES];   /* 0: no child; below 0: some light shines from both sides */
    int32_t child[LANES]; /* node, or ~light */
    int32_t parent;       /* LANES * node + lane; -1 at the root, which is node 0 */
};

enum { LIGHT_TREE_NEVER = -1, LIGHT_TREE_INFINITE = -2 };

struct light_tree {
    struct light_node *nodes;
    uint32_t node_count; /* 0: there is no tree */
    int32_t *place;      /* of a light: LANES * node + lane; or one of the two above */
    uint32_t *infinite;  /* lights at infinity */
    uint32_t infinite_count;
    float share; /* probability of the tree, and of each light at infinity */
};

/*
 * A tree of the scene's lights, at least one of them finite. Of those at infinity only the ones
 * whose `pmf` is above zero are chosen. light_tree_close also closes what is all zeros.
 */
bool light_tree_open(struct light_tree *tree, const struct scene *scene, const float *pmf,
                     struct err *err);
void light_tree_close(struct light_tree *tree);

/* ---- weights */

/*
 * Bounds on cosines are loose by this much, which covers all rounding: a cosine of almost 1 leaves
 * the sine an error of 2^-12.
 */
#define LIGHT_TREE_SLACK 1e-3f

/* cos(max(0, a - b)) of two angles up to pi */
LANE_FN f8 cos_less(f8 cos_a, f8 sin_a, f8 cos_b, f8 sin_b)
{
    return f8_select(cos_a >= cos_b, F8(1), cos_a * cos_b + sin_a * sin_b);
}

LANE_FN f8 sine_of(f8 cosine)
{
    return f8_sqrt(f8_max(1 - cosine * cosine, F8(0)));
}

/*
 * What the children may send to p, the same in all lanes. n is the unit normal on the side that
 * light is wanted from, or zero where it may come from anywhere.
 */
LANE_FN f8 light_node_weigh(const struct light_node *node, struct vec3x8 p, struct vec3x8 n)
{
    struct vec3x8 center = { f8_load(node->center[0]), f8_load(node->center[1]),
                             f8_load(node->center[2]) };
    struct vec3x8 axis = { f8_load(node->axis[0]), f8_load(node->axis[1]), f8_load(node->axis[2]) };
    f8 r = f8_load(node->radius), power = f8_load(node->power);
    struct vec3x8 to = vec3x8_sub(center, p);
    f8 d2 = vec3x8_length2(to), r2 = r * r;
    /* Within the sphere some lights are closer than its center: measured, 1/8 serves best */
    f8 inv_d2 = 1 / f8_max(d2, r2 * 0.125f), inv_d = f8_sqrt(inv_d2);

    /* Half the angle under which p sees the sphere; all around from inside */
    i8 outside = d2 > r2;
    f8 sin_b = f8_select(outside, r * inv_d, F8(0));
    f8 cos_b = f8_select(outside, f8_sqrt(f8_max(1 - r2 * inv_d2, F8(0))), F8(-1));

    /* At the lights: from the direction to p to the cone, and less by what the sphere allows */
    f8 cos_w = -vec3x8_dot(axis, to) * inv_d;
    cos_w = f8_select(power < 0, f8_abs(cos_w), cos_w);
    f8 sin_w = sine_of(cos_w);
    f8 cos_o = f8_load(node->cos_o), sin_o = f8_load(node->sin_o);
    f8 cos_x = cos_less(cos_w, sin_w, cos_o, sin_o);
    f8 sin_x = f8_select(cos_w >= cos_o, F8(0), sin_w * cos_o - cos_w * sin_o);
    f8 cos_l = cos_less(cos_x, sin_x, cos_b, sin_b);
    i8 emits = cos_l > f8_load(node->cos_e) - LIGHT_TREE_SLACK;

    /* At the receiver */
    f8 cos_n = vec3x8_dot(n, to) * inv_d;
    f8 cos_r = cos_less(cos_n, sine_of(cos_n), cos_b, sin_b);
    cos_r = f8_select(vec3x8_length2(n) > 0, cos_r, F8(1));
    emits &= cos_r > -LIGHT_TREE_SLACK;

    f8 cosines = (f8_max(cos_l, F8(0)) + LIGHT_TREE_SLACK) *
                 (f8_max(cos_r, F8(0)) + LIGHT_TREE_SLACK);
    return f8_select(emits, f8_abs(power) * cosines * inv_d2, F8(0));
}

/* Sums up to each lane, itself included */
LANE_FN f8 f8_sums(f8 a)
{
    const f8 zero = F8(0);
    a = a + __builtin_shufflevector(a, zero, 8, 0, 1, 2, 3, 4, 5, 6);
    a = a + __builtin_shufflevector(a, zero, 8, 8, 0, 1, 2, 3, 4, 5);
    return a + __builtin_shufflevector(a, zero, 8, 8, 8, 8, 0, 1, 2, 3);
}

/* Weights of the children whose sum is above zero; the same in every choice and density */
LANE_FN f8 light_node_weights(const struct light_node *node, struct vec3x8 p, struct vec3x8 n,
                              f8 *sums)
{
    f8 weights = light_node_weigh(node, p, n);
    *sums = f8_sums(weights);
    if (!((*sums)[LANES - 1] > 0)) {
        weights = f8_select(f8_load(node->power) != 0, F8(1), F8(0));
        *sums = f8_sums(weights);
    }
    return weights;
}

/* ---- choosing; not inlined, as they are long and called from several places */

#define LIGHT_TREE_FN static __attribute__((noinline, unused))

LANE_FN struct vec3x8 vec3x8_of_lane(const struct vec3x8 *a, unsigned lane)
{
    return vec3x8_all(a->x[lane], a->y[lane], a->z[lane]);
}

/* One receiver's walk down the tree, or up from a light */
struct light_walk {
    struct vec3x8 p, n; /* the same in all lanes */
    float u, probability;
    int32_t at; /* the node, or ~light: going down; the place, or -1: going up */
};

/* Ask memory for a node that is wanted when the other walks have done a step */
LANE_FN void light_node_fetch(const struct light_tree *tree, int32_t index)
{
    const char *node = (const char *)&tree->nodes[index];
    for (size_t byte = 0; byte < sizeof(tree->nodes[0]); byte += 64)
        __builtin_prefetch(node + byte);
}

LANE_FN void light_walk_down(const struct light_tree *tree, struct light_walk *walk)
{
    const struct light_node *node = &tree->nodes[walk->at];
    f8 sums, weights = light_node_weights(node, walk->p, walk->n, &sums);
    float all = sums[LANES - 1], target = walk->u * all;
    unsigned some = i8_bits(weights > 0), beyond = some & i8_bits(sums > target);
    unsigned slot = (unsigned)(beyond != 0 ? __builtin_ctz(beyond) : 31 - __builtin_clz(some));
    float weight = weights[slot];
    walk->probability *= weight / all;
    /* What is left of u decides on the next level */
    float u = (target - (sums[slot] - weight)) / weight;
    walk->u = u < 0 ? 0 : u < 0x1.fffffep-1f ? u : 0x1.fffffep-1f;
    walk->at = node->child[slot];
    if (walk->at >= 0)
        light_node_fetch(tree, walk->at);
}

LANE_FN void light_walk_up(const struct light_tree *tree, struct light_walk *walk)
{
    const struct light_node *node = &tree->nodes[walk->at / LANES];
    f8 sums, weights = light_node_weights(node, walk->p, walk->n, &sums);
    walk->probability *= weights[walk->at % LANES] / sums[LANES - 1];
    walk->at = node->parent;
    if (walk->at >= 0)
        light_node_fetch(tree, walk->at / LANES);
}

/*
 * For every lane of `lanes` a light, and the probability of that choice. All walk side by side, a
 * step each in turn: one step waits for its node and its roots, the next does not wait for it.
 */
LIGHT_TREE_FN void light_tree_choose(const struct light_tree *tree, unsigned lanes,
                                     const struct vec3x8 *p8, const struct vec3x8 *n8, const f8 *u8,
                                     i8 *light, f8 *chosen)
{
    struct light_walk walks[LANES];
    unsigned walking = 0;
    *light = I8(0);
    *chosen = F8(1);
    for (unsigned todo = lanes; todo != 0; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        float u = (*u8)[lane] * (float)(tree->infinite_count + 1);
        uint32_t which = (uint32_t)u;
        if (which < tree->infinite_count) {
            (*light)[lane] = (int32_t)tree->infinite[which];
            (*chosen)[lane] = tree->share;
            continue;
        }
        walks[lane] = (struct light_walk){ .p = vec3x8_of_lane(p8, lane),
                                           .n = vec3x8_of_lane(n8, lane),
                                           .u = u - (float)tree->infinite_count,
                                           .probability = tree->share };
        walking |= 1u << lane;
    }
    while (walking != 0)
        for (unsigned todo = walking; todo != 0; todo &= todo - 1) {
            unsigned lane = (unsigned)__builtin_ctz(todo);
            light_walk_down(tree, &walks[lane]);
            if (walks[lane].at >= 0)
                continue;
            (*light)[lane] = ~walks[lane].at;
            (*chosen)[lane] = walks[lane].probability;
            walking &= ~(1u << lane);
        }
}

/* The probability with which light_tree_choose chooses `light`; in the lanes of `lanes` */
LIGHT_TREE_FN void light_tree_pick(const struct light_tree *tree, unsigned lanes,
                                   const struct vec3x8 *p8, const struct vec3x8 *n8,
                                   const i8 *light, f8 *pick)
{
    struct light_walk walks[LANES];
    unsigned walking = 0;
    *pick = F8(0);
    for (unsigned todo = lanes; todo != 0; todo &= todo - 1) {
        unsigned lane = (unsigned)__builtin_ctz(todo);
        int32_t place = tree->place[(*light)[lane]];
        if (place == LIGHT_TREE_NEVER)
            continue;
        (*pick)[lane] = tree->share;
        walks[lane] = (struct light_walk){ .p = vec3x8_of_lane(p8, lane),
                                           .n = vec3x8_of_lane(n8, lane),
                                           .probability = tree->share,
                                           .at = place };
        if (place >= 0) {
            light_node_fetch(tree, place / LANES);
            walking |= 1u << lane;
        }
    }
    while (walking != 0)
        for (unsigned todo = walking; todo != 0; todo &= todo - 1) {
            unsigned lane = (unsigned)__builtin_ctz(todo);
            light_walk_up(tree, &walks[lane]);
            if (walks[lane].at >= 0)
                continue;
            (*pick)[lane] = walks[lane].probability;
            walking &= ~(1u << lane);
        }
}

#endif
