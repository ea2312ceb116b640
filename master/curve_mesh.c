#include "master/curve_mesh.h"

#include "common/elem.h"
#include "common/err.h"
#include "master/vector.h"

#include <math.h>
#include <string.h>

#define PI          3.14159265358979323846
#define TOLERANCE   1e-3 /* of the curve's size */
#define PIECES_MOST 64   /* of a segment */
#define SIDES_LEAST 4
#define SIDES_MOST  64
#define TWIST       0.1 /* radians that a ribbon's normal turns along one piece */

/* Unit, or `otherwise` where there is no direction */
static struct vec unit(struct vec a, struct vec otherwise)
{
    double size = vec_length(a);
    return size > 0 && isfinite(size) ? vec_scale(a, 1 / size) : otherwise;
}

/* --- Segments ----------------------------------------------------------------------------- */

size_t curve_mesh_segments(const struct curve *curve, struct err *err)
{
    size_t degree = (size_t)curve->degree, count = curve->point_count;
    if (curve->degree != 2 && curve->degree != 3) {
        err_set(err, ERR_SCENE, "a curve of degree %d: 2 and 3 are possible", curve->degree);
        return 0;
    }
    if (count <= degree || (!curve->bspline && (count - 1) % degree != 0)) {
        err_set(err, ERR_SCENE,
                curve->bspline
                    ? "%zu points: a B-spline of degree %d has at least %zu"
                    : "%zu points: a Bezier curve of degree %d has %zu, or a multiple of "
                      "its degree more",
                count, curve->degree, degree + 1);
        return 0;
    }
    return curve->bspline ? count - degree : (count - 1) / degree;
}

/* Control points of a segment as a cubic Bezier curve */
struct cubic {
    struct vec p[4];
};

static struct cubic raise_degree(struct vec a, struct vec b, struct vec c)
{
    return (struct cubic){ { a, vec_blend(a, b, 2.0 / 3), vec_blend(c, b, 2.0 / 3), c } };
}

static struct cubic segment(const struct curve *curve, size_t index)
{
    size_t first = curve->bspline ? index : index * (size_t)curve->degree;
    struct vec p[4];
    for (size_t i = 0; i <= (size_t)curve->degree; i++)
        p[i] = vec_at(curve->points + 3 * (first + i));
    if (!curve->bspline)
        return curve->degree == 2 ? raise_degree(p[0], p[1], p[2])
                                  : (struct cubic){ { p[0], p[1], p[2], p[3] } };
    if (curve->degree == 2)
        return raise_degree(vec_blend(p[0], p[1], 0.5), p[1], vec_blend(p[1], p[2], 0.5));
    struct vec a = vec_blend(p[0], p[1], 2.0 / 3), b = vec_blend(p[1], p[2], 1.0 / 3);
    struct vec c = vec_blend(p[1], p[2], 2.0 / 3), d = vec_blend(p[2], p[3], 1.0 / 3);
    return (struct cubic){ { vec_blend(a, b, 0.5), b, c, vec_blend(c, d, 0.5) } };
}

static struct vec cubic_at(const struct cubic *cubic, double u, struct vec *tangent)
{
    const struct vec *p = cubic->p;
    struct vec ab = vec_blend(p[0], p[1], u), bc = vec_blend(p[1], p[2], u),
               cd = vec_blend(p[2], p[3], u);
    struct vec abc = vec_blend(ab, bc, u), bcd = vec_blend(bc, cd, u);
    *tangent = vec_scale(vec_sub(bcd, abc), 3);
    if (vec_length(*tangent) == 0) /* control points that coincide: the way to the next */
        *tangent = u < 0.5 ? vec_sub(p[2], p[0]) : vec_sub(p[3], p[1]);
    if (vec_length(*tangent) == 0)
        *tangent = vec_sub(p[3], p[0]);
    return vec_blend(abc, bcd, u);
}

/* --- The way along ------------------------------------------------------------------------ */

/* What is swept along the curve stands on frames: place, tangent, one direction across */
struct frame {
    struct vec p, tangent, across;
};

struct sweep {
    const struct curve *curve;
    size_t segments;
    double size;
    double sides; /* of a tube */
    struct frame last;
    bool started;
};

static double size_of(const struct curve *curve)
{
    return vec_extent(curve->points, curve->point_count) + fmax(curve->width[0], curve->width[1]);
}

static double clamp(double value, double low, double high)
{
    return !(value > low) ? low : value < high ? value : high;
}

static struct vec normal_at(const struct curve *curve, size_t index)
{
    return unit(vec_at(curve->normals + 3 * index), (struct vec){ 0, 0, 1 });
}

static double angle_between(struct vec a, struct vec b)
{
    return elem_acos(clamp(vec_dot(a, b), -1, 1));
}

/* A chord is 1/8 of the second derivative and of the square of its length away */
static unsigned pieces_of(const struct sweep *sweep, const struct cubic *cubic, size_t index)
{
    const struct vec *p = cubic->p;
    double bend = fmax(vec_length(vec_add(vec_sub(p[0], p[1]), vec_sub(p[2], p[1]))),
                       vec_length(vec_add(vec_sub(p[1], p[2]), vec_sub(p[3], p[2]))));
    double pieces = ceil(sqrt(6 * bend / (8 * TOLERANCE * sweep->size)) - 1e-9);
    if (sweep->curve->ribbon)
        pieces = fmax(pieces, ceil(angle_between(normal_at(sweep->curve, index),
                                                 normal_at(sweep->curve, index + 1)) /
                                   TWIST));
    return (unsigned)clamp(pieces, 1, PIECES_MOST);
}

static struct vec any_across(struct vec t)
{
    bool small = fabs(t.x) < 0.6;
    struct vec axis = { small, !small, 0 };
    return unit(vec_cross(t, axis), (struct vec){ 0, 0, 1 });
}

/* Carry a frame on to a place and tangent without turning it about the tangent: two reflections
 * (Wang et al. 2008, Computation of Rotation Minimizing Frames) */
static struct vec carry(const struct frame *from, struct vec p, struct vec tangent)
{
    struct vec step = vec_sub(p, from->p), across = from->across, t = from->tangent;
    double c = vec_dot(step, step);
    if (c > 0) {
        across = vec_sub(across, vec_scale(step, 2 * vec_dot(step, across) / c));
        t = vec_sub(t, vec_scale(step, 2 * vec_dot(step, t) / c));
        struct vec turn = vec_sub(tangent, t);
        c = vec_dot(turn, turn);
        if (c > 0)
            across = vec_sub(across, vec_scale(turn, 2 * vec_dot(turn, across) / c));
    }
    across = vec_sub(across, vec_scale(tangent, vec_dot(tangent, across)));
    return unit(across, any_across(tangent));
}

/* From one unit normal to another on the sphere, as pbrt goes */
static struct vec turn_normal(struct vec a, struct vec b, double u)
{
    double angle = angle_between(a, b), sine = elem_sin(angle);
    if (sine < 1e-9)
        return u < 0.5 ? a : b;
    return vec_add(vec_scale(a, elem_sin((1 - u) * angle) / sine),
                   vec_scale(b, elem_sin(u * angle) / sine));
}

/* --- Cross-sections ----------------------------------------------------------------------- */

static bool add_vertex(struct tessellation *out, struct vec p, struct vec n, double u, double v,
                       struct err *err)
{
    const double place[3] = { p.x, p.y, p.z }, normal[3] = { n.x, n.y, n.z }, uv[2] = { u, v };
    return tessellate_vertex(out, place, normal, uv, err);
}

static bool add_strip(struct tessellation *out, const struct frame *frame, struct vec normal,
                      double width, double u, struct err *err)
{
    struct vec side = unit(vec_cross(normal, frame->tangent), any_across(frame->tangent));
    struct vec up = vec_cross(frame->tangent, side);
    return add_vertex(out, vec_add(frame->p, vec_scale(side, -width / 2)), up, u, 0, err) &&
           add_vertex(out, vec_add(frame->p, vec_scale(side, width / 2)), up, u, 1, err);
}

/* A polygon as long around as the circle, so that its mean width is the circle's, too; `taper` is
 * how the radius grows per length */
static bool add_ring(struct tessellation *out, const struct frame *frame, unsigned sides,
                     double radius, double taper, double u, struct err *err)
{
    double half = PI / sides;
    struct vec other = vec_cross(frame->across, frame->tangent);
    radius *= half / elem_sin(half);
    for (unsigned i = 0; i <= sides; i++) {
        double angle = 2 * half * (i % sides);
        struct vec way = vec_add(vec_scale(frame->across, elem_cos(angle)),
                                 vec_scale(other, elem_sin(angle)));
        struct vec normal = unit(vec_sub(way, vec_scale(frame->tangent, taper)), way);
        if (!add_vertex(out, vec_add(frame->p, vec_scale(way, radius)), normal, u,
                        (double)i / sides, err))
            return false;
    }
    return true;
}

/* Quads between two cross-sections of `count` vertices, of which the last ends at `end` */
static bool join(struct tessellation *out, uint32_t end, uint32_t count, const bool pointed[2],
                 struct err *err)
{
    uint32_t low = end - 2 * count, high = end - count;
    for (uint32_t i = 0; i + 1 < count; i++)
        if ((!pointed[1] && !tessellate_triangle(out, low + i, high + i, high + i + 1, err)) ||
            (!pointed[0] && !tessellate_triangle(out, low + i, high + i + 1, low + i + 1, err)))
            return false;
    return true;
}

/* --- All together ------------------------------------------------------------------------- */

static double width_at(const struct sweep *sweep, size_t index, double u)
{
    double t = ((double)index + u) / (double)sweep->segments;
    return (1 - t) * sweep->curve->width[0] + t * sweep->curve->width[1];
}

/* Where two segments meet at an angle, both stand on the tangent between theirs */
static struct vec tangent_at(const struct sweep *sweep, size_t index, const struct cubic *cubic,
                             double u, struct vec *p)
{
    struct vec tangent, other;
    *p = cubic_at(cubic, u, &tangent);
    struct vec mine = unit(tangent, (struct vec){ 0, 0, 1 });
    if ((u > 0 || index == 0) && (u < 1 || index + 1 == sweep->segments))
        return mine;
    struct cubic neighbour = segment(sweep->curve, u > 0 ? index + 1 : index - 1);
    cubic_at(&neighbour, u > 0 ? 0 : 1, &other);
    return unit(vec_add(mine, unit(other, mine)), mine);
}

static bool add_segment(struct tessellation *out, struct sweep *sweep, size_t index,
                        struct err *err)
{
    const struct curve *curve = sweep->curve;
    struct cubic cubic = segment(curve, index);
    unsigned pieces = pieces_of(sweep, &cubic, index);
    uint32_t count = curve->ribbon ? 2 : (uint32_t)sweep->sides + 1;
    if (!tessellate_allows(out, 2.0 * pieces * (count - 1), err))
        return false;
    bool pointed[2] = { false, false };
    for (unsigned i = 0; i <= pieces; i++) {
        double u = (double)i / pieces, width = width_at(sweep, index, u);
        struct frame frame;
        frame.tangent = tangent_at(sweep, index, &cubic, u, &frame.p);
        frame.across = sweep->started ? carry(&sweep->last, frame.p, frame.tangent)
                                      : any_across(frame.tangent);
        sweep->last = frame;
        sweep->started = true;
        bool added;
        if (curve->ribbon) {
            struct vec normal = turn_normal(normal_at(curve, index), normal_at(curve, index + 1),
                                            u);
            added = add_strip(out, &frame, normal, width, u, err);
        } else {
            struct vec tangent;
            cubic_at(&cubic, u, &tangent);
            double taper = (curve->width[1] - curve->width[0]) / 2 / (double)sweep->segments /
                           vec_length(tangent);
            added = add_ring(out, &frame, count - 1, width / 2, isfinite(taper) ? taper : 0, u,
                             err);
        }
        pointed[0] = pointed[1];
        pointed[1] = width == 0;
        if (!added || (i > 0 && !join(out, (uint32_t)out->positions.count, count, pointed, err)))
            return false;
    }
    return true;
}

bool curve_mesh_add(struct tessellation *out, const struct curve *curve, struct err *err)
{
    struct sweep sweep = { .curve = curve, .segments = curve_mesh_segments(curve, err) };
    if (sweep.segments == 0)
        return false;
    if (curve->ribbon && curve->normal_count != sweep.segments + 1)
        return err_set(err, ERR_SCENE, "%zu normals for a ribbon of %zu segments: %zu are wanted",
                       curve->normal_count, sweep.segments, sweep.segments + 1);
    double widest = fmax(curve->width[0], curve->width[1]);
    sweep.size = size_of(curve);
    if (!(widest > 0) || !(sweep.size > widest))
        return true;
    sweep.sides = clamp(ceil(PI * sqrt(widest / 2 / (3 * TOLERANCE * sweep.size))), SIDES_LEAST,
                        SIDES_MOST);
    for (size_t i = 0; i < sweep.segments; i++)
        if (!add_segment(out, &sweep, i, err))
            return false;
    return true;
}
