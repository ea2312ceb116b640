#include "master/subdivide.h"

#include "common/elem.h"
#include "common/err.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#define PI   3.14159265358979323846
#define NONE UINT32_MAX

/*
 * Edge k of face f goes from corner k to corner k + 1; `across` is the face on its other side, or
 * NONE. Corner k of a face is 3 f + k everywhere.
 */
struct level {
    double *points; /* 3 each */
    uint32_t point_count;
    uint32_t *corners, *across; /* 3 per face */
    uint32_t face_count;
    uint32_t *corner_of; /* of a vertex: a corner at it; NONE: no face has it. On a boundary, the
                            first in the order in which step() goes around */
};

static bool no_memory(struct err *err)
{
    return err_set(err, ERR_MEMORY, "no memory to subdivide a mesh");
}

static void level_free(struct level *level)
{
    free(level->points);
    free(level->corners);
    free(level->across);
    free(level->corner_of);
}

static bool level_new(struct level *level, size_t points, size_t faces)
{
    *level = (struct level){ .point_count = (uint32_t)points, .face_count = (uint32_t)faces };
    level->points = malloc((points + 1) * 3 * sizeof(double));
    level->corners = malloc((faces + 1) * 3 * sizeof(uint32_t));
    level->across = malloc((faces + 1) * 3 * sizeof(uint32_t));
    level->corner_of = malloc((points + 1) * sizeof(uint32_t));
    return level->points != NULL && level->corners != NULL && level->across != NULL &&
           level->corner_of != NULL;
}

/* --- Topology ----------------------------------------------------------------------------- */

static uint32_t next(uint32_t corner)
{
    return corner % 3 == 2 ? corner - 2 : corner + 1;
}

static uint32_t previous(uint32_t corner)
{
    return corner % 3 == 0 ? corner + 2 : corner - 1;
}

/* The corner at the same vertex in the face beyond one of its two edges; NONE at a boundary */
static uint32_t find_corner(const struct level *level, uint32_t face, uint32_t vertex)
{
    if (face == NONE)
        return NONE;
    uint32_t corner = 3 * face;
    while (level->corners[corner] != vertex)
        corner++;
    return corner;
}

/* Counter-clockwise, seen from where the corners of faces go around counter-clockwise */
static uint32_t step(const struct level *level, uint32_t corner)
{
    return find_corner(level, level->across[previous(corner)], level->corners[corner]);
}

static uint32_t step_back(const struct level *level, uint32_t corner)
{
    return find_corner(level, level->across[corner], level->corners[corner]);
}

struct edge {
    uint32_t low, high, corner; /* vertices; the corner that it starts from */
};

static int compare_edges(const void *x, const void *y)
{
    const struct edge *a = x, *b = y;
    if (a->low != b->low)
        return a->low < b->low ? -1 : 1;
    if (a->high != b->high)
        return a->high < b->high ? -1 : 1;
    return a->corner < b->corner ? -1 : a->corner > b->corner;
}

static bool pair_edges(struct level *level, struct err *err)
{
    size_t count = 3 * (size_t)level->face_count;
    struct edge *edges = malloc((count + 1) * sizeof(*edges));
    if (edges == NULL)
        return no_memory(err);
    for (uint32_t c = 0; c < count; c++) {
        uint32_t a = level->corners[c], b = level->corners[next(c)];
        edges[c] = (struct edge){ a < b ? a : b, a < b ? b : a, c };
        level->across[c] = NONE;
    }
    qsort(edges, count, sizeof(*edges), compare_edges);
    bool good = true;
    for (size_t i = 0; good && i + 1 < count; i++) {
        const struct edge *edge = &edges[i], *other = edge + 1;
        if (edge->low != other->low || edge->high != other->high)
            continue;
        bool third = i + 2 < count && edge[2].low == edge->low && edge[2].high == edge->high;
        if (third || level->corners[edge->corner] == level->corners[other->corner]) {
            good = err_set(err, ERR_SCENE, "%s the edge from vertex %u to %u",
                           third ? "more than two triangles share"
                                 : "two triangles go the same way along",
                           edge->low, edge->high);
        } else {
            level->across[edge->corner] = other->corner / 3;
            level->across[other->corner] = edge->corner / 3;
            i++;
        }
    }
    free(edges);
    return good;
}

/* Where to start going around each vertex. A vertex where several fans meet has the last of them
 * for its own, as in pbrt. */
static void find_starts(struct level *level)
{
    for (uint32_t v = 0; v < level->point_count; v++)
        level->corner_of[v] = NONE;
    for (uint32_t c = 0; c < 3 * level->face_count; c++)
        level->corner_of[level->corners[c]] = c;
    for (uint32_t v = 0; v < level->point_count; v++) {
        uint32_t first = level->corner_of[v], c = first, back;
        if (first == NONE)
            continue;
        while ((back = step_back(level, c)) != NONE && back != first)
            c = back;
        level->corner_of[v] = back == NONE ? c : first;
    }
}

static bool first_level(struct level *level, const struct subdivide_mesh *mesh, struct err *err)
{
    if (mesh->point_count >= NONE || mesh->triangle_count >= NONE / 3)
        return err_set(err, ERR_SCENE, "the mesh has too many vertices or triangles");
    if (!level_new(level, mesh->point_count, mesh->triangle_count))
        return no_memory(err);
    memcpy(level->points, mesh->points, mesh->point_count * 3 * sizeof(double));
    for (size_t i = 0; i < 3 * mesh->triangle_count; i++) {
        double index = mesh->indices[i];
        if (!(index >= 0 && index < (double)mesh->point_count))
            return err_set(err, ERR_SCENE,
                           "index %.0f (number %zu) is out of range: there are %zu vertices", index,
                           i, mesh->point_count);
        level->corners[i] = (uint32_t)index;
    }
    for (uint32_t c = 0; c < 3 * level->face_count; c++)
        if (level->corners[c] == level->corners[next(c)])
            return err_set(err, ERR_SCENE, "triangle %u has vertex %u twice", c / 3,
                           level->corners[c]);
    if (!pair_edges(level, err))
        return false;
    find_starts(level);
    return true;
}

/* --- Rings and rules ---------------------------------------------------------------------- */

/* The neighbours of a vertex, counter-clockwise, and what the masks take of them */
struct ring {
    bool boundary;
    uint32_t valence;
    double sum[3], first[3], last[3];
};

/* What a neighbour that comes as number `k` does to somebody's sums */
typedef void ring_visit(void *sums, uint32_t k, const double p[3]);

static bool on_boundary(const struct level *level, uint32_t vertex)
{
    return step_back(level, level->corner_of[vertex]) == NONE;
}

static void go_around(const struct level *level, uint32_t vertex, ring_visit *visit, void *sums)
{
    uint32_t first = level->corner_of[vertex], corner = first, last, k = 0;
    do {
        visit(sums, k++, level->points + 3 * (size_t)level->corners[next(corner)]);
        last = corner;
        corner = step(level, corner);
    } while (corner != NONE && corner != first);
    if (corner == NONE)
        visit(sums, k, level->points + 3 * (size_t)level->corners[previous(last)]);
}

static void add_to_ring(void *sums, uint32_t k, const double p[3])
{
    struct ring *ring = sums;
    for (int axis = 0; axis < 3; axis++) {
        ring->sum[axis] += p[axis];
        if (k == 0)
            ring->first[axis] = p[axis];
        ring->last[axis] = p[axis];
    }
    ring->valence = k + 1;
}

static struct ring ring_of(const struct level *level, uint32_t vertex)
{
    struct ring ring = { .boundary = on_boundary(level, vertex) };
    go_around(level, vertex, add_to_ring, &ring);
    return ring;
}

/* Loop's weight of each neighbour, with Warren's simpler numbers as in pbrt */
static double even_weight(uint32_t valence)
{
    return valence == 3 ? 3.0 / 16 : 3.0 / (8.0 * valence);
}

/* The vertex moves by these shares towards its neighbours, or to the two along the boundary */
static void move(const struct level *level, uint32_t vertex, const struct ring *ring, double inner,
                 double boundary, double out[3])
{
    const double *p = level->points + 3 * (size_t)vertex;
    for (int axis = 0; axis < 3; axis++)
        out[axis] = ring->boundary
                        ? (1 - 2 * boundary) * p[axis] +
                              boundary * (ring->first[axis] + ring->last[axis])
                        : (1 - ring->valence * inner) * p[axis] + inner * ring->sum[axis];
}

static void move_even(const struct level *level, uint32_t vertex, double out[3])
{
    if (level->corner_of[vertex] == NONE) {
        memcpy(out, level->points + 3 * (size_t)vertex, 3 * sizeof(double));
        return;
    }
    struct ring ring = ring_of(level, vertex);
    move(level, vertex, &ring, even_weight(ring.valence), 1.0 / 8, out);
}

static void make_odd(const struct level *level, uint32_t corner, double out[3])
{
    const double *a = level->points + 3 * (size_t)level->corners[corner];
    const double *b = level->points + 3 * (size_t)level->corners[next(corner)];
    const double *c = level->points + 3 * (size_t)level->corners[previous(corner)];
    uint32_t other = find_corner(level, level->across[corner], level->corners[corner]);
    const double *d = other == NONE ? NULL
                                    : level->points + 3 * (size_t)level->corners[next(other)];
    for (int axis = 0; axis < 3; axis++)
        out[axis] = d == NULL ? (a[axis] + b[axis]) / 2
                              : 3 * (a[axis] + b[axis]) / 8 + (c[axis] + d[axis]) / 8;
}

/* --- Refinement --------------------------------------------------------------------------- */

/* Number the edges: both corners of an edge get its vertex in the next level */
static uint32_t number_edges(const struct level *level, uint32_t *odd)
{
    uint32_t count = level->point_count;
    for (uint32_t c = 0; c < 3 * level->face_count; c++) {
        uint32_t face = level->across[c];
        if (face == NONE || face > c / 3)
            odd[c] = count++;
        else
            odd[c] = odd[previous(find_corner(level, face, level->corners[c]))];
    }
    return count;
}

/* Face f becomes 4 f + k at its corner k, and 4 f + 3 in the middle, whose corner k is the vertex
 * of edge k */
static void split_face(const struct level *level, const uint32_t *odd, uint32_t face,
                       struct level *finer)
{
    uint32_t middle = 4 * face + 3;
    for (uint32_t k = 0; k < 3; k++) {
        uint32_t corner = 3 * face + k, child = 4 * face + k, at = 3 * child;
        uint32_t vertex = level->corners[corner], before = previous(corner);
        finer->corners[at + k] = vertex;
        finer->corners[at + (k + 1) % 3] = odd[corner];
        finer->corners[at + (k + 2) % 3] = odd[before];
        finer->corners[3 * middle + k] = odd[corner];

        /* Beyond the corner's own edges are the neighbours' children at the same vertex */
        uint32_t over = find_corner(level, level->across[corner], vertex);
        uint32_t under = find_corner(level, level->across[before], vertex);
        finer->across[at + k] = over == NONE ? NONE : 4 * (over / 3) + over % 3;
        finer->across[at + (k + 2) % 3] = under == NONE ? NONE : 4 * (under / 3) + under % 3;
        finer->across[at + (k + 1) % 3] = middle;
        finer->across[3 * middle + k] = 4 * face + (k + 1) % 3;
    }
}

static bool refine(const struct level *level, struct level *finer, struct err *err)
{
    uint32_t *odd = malloc(((size_t)level->face_count + 1) * 3 * sizeof(*odd));
    if (odd == NULL)
        return no_memory(err);
    if (!level_new(finer, number_edges(level, odd), 4 * (size_t)level->face_count)) {
        free(odd);
        return no_memory(err);
    }
    for (uint32_t v = 0; v < level->point_count; v++)
        move_even(level, v, finer->points + 3 * (size_t)v);
    for (uint32_t c = 0; c < 3 * level->face_count; c++)
        make_odd(level, c, finer->points + 3 * (size_t)odd[c]);
    for (uint32_t face = 0; face < level->face_count; face++)
        split_face(level, odd, face, finer);
    free(odd);
    find_starts(finer);
    return true;
}

/* --- The limit ---------------------------------------------------------------------------- */

/* Two tangents of the limit surface, from the masks of its neighbours */
struct tangents {
    bool boundary;
    uint32_t valence;
    double s[3], t[3];
};

static void add_to_tangents(void *sums, uint32_t k, const double p[3])
{
    struct tangents *tangents = sums;
    uint32_t n = tangents->valence;
    double s, t;
    if (!tangents->boundary) {
        s = elem_cos(2 * PI * k / n);
        t = elem_sin(2 * PI * k / n);
    } else {
        /* Along the boundary, and from it inwards */
        double theta = n > 1 ? PI / (n - 1) : 0;
        bool end = k == 0 || k == n - 1;
        s = k == 0 ? -1 : k == n - 1 ? 1 : 0;
        if (n < 4)
            t = n == 2 ? 1 : !end;
        else if (n == 4)
            t = end ? -1 : 2;
        else
            t = end ? -elem_sin(theta) : (2 - 2 * elem_cos(theta)) * elem_sin(k * theta);
    }
    for (int axis = 0; axis < 3; axis++) {
        tangents->s[axis] += s * p[axis];
        tangents->t[axis] += t * p[axis];
    }
}

/* Of a vertex of a regular boundary, or of one or two triangles, the mask has a share, too */
static double own_share(const struct tangents *tangents)
{
    if (!tangents->boundary)
        return 0;
    return tangents->valence == 2   ? -2
           : tangents->valence == 3 ? -1
           : tangents->valence == 4 ? -2
                                    : 0;
}

static void limit_normal(const struct level *level, uint32_t vertex, const struct ring *ring,
                         double n[3])
{
    struct tangents tangents = { .boundary = ring->boundary, .valence = ring->valence };
    go_around(level, vertex, add_to_tangents, &tangents);
    const double *p = level->points + 3 * (size_t)vertex, share = own_share(&tangents);
    double *s = tangents.s, *t = tangents.t;
    for (int axis = 0; axis < 3; axis++)
        t[axis] += share * p[axis];
    /* s x t is on the side of counter-clockwise corners, but for a boundary, whose ring's end is
     * where its start would be inside */
    double side = ring->boundary ? 1 : -1;
    n[0] = side * (s[1] * t[2] - s[2] * t[1]);
    n[1] = side * (s[2] * t[0] - s[0] * t[2]);
    n[2] = side * (s[0] * t[1] - s[1] * t[0]);
    double length = sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
    for (int axis = 0; axis < 3; axis++)
        n[axis] = length > 0 && isfinite(length) ? n[axis] / length : 0;
}

static bool add_limit(struct tessellation *out, const struct level *level, struct err *err)
{
    uint32_t first = (uint32_t)out->positions.count;
    for (uint32_t v = 0; v < level->point_count; v++) {
        double p[3], n[3] = { 0, 0, 0 };
        memcpy(p, level->points + 3 * (size_t)v, sizeof(p));
        if (level->corner_of[v] != NONE) {
            struct ring ring = ring_of(level, v);
            double inner = 1 / (ring.valence + 3 / (8 * even_weight(ring.valence)));
            move(level, v, &ring, inner, 1.0 / 6, p);
            limit_normal(level, v, &ring, n);
        }
        if (!tessellate_vertex(out, p, n, NULL, err))
            return false;
    }
    for (uint32_t face = 0; face < level->face_count; face++) {
        const uint32_t *corner = level->corners + 3 * (size_t)face;
        if (!tessellate_triangle(out, first + corner[0], first + corner[1], first + corner[2], err))
            return false;
    }
    return true;
}

bool subdivide_loop(struct tessellation *out, const struct subdivide_mesh *mesh, unsigned levels,
                    struct err *err)
{
    if (levels > SUBDIVIDE_LEVELS)
        return err_set(err, ERR_SCENE, "%u levels of subdivision: at most %d are possible", levels,
                       SUBDIVIDE_LEVELS);
    if (!tessellate_allows(out, (double)mesh->triangle_count * (double)(1u << 2 * levels), err))
        return false;
    struct level level = { 0 };
    bool good = first_level(&level, mesh, err);
    for (unsigned i = 0; good && i < levels; i++) {
        struct level finer = { 0 };
        good = refine(&level, &finer, err);
        level_free(&level);
        level = finer;
    }
    good = good && add_limit(out, &level, err);
    level_free(&level);
    return good;
}
