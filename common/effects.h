/*
 * What a scene calls for, as a bit mask. The reader's scene carries it, the worker recomputes and
 * compares it, and the kernel variant is chosen by it. A bit says "some object of the scene needs
 * this code"; the code behind an absent bit is not in the specialised kernel at all.
 */
#ifndef COMMON_EFFECTS_H
#define COMMON_EFFECTS_H

#include <stddef.h>
#include <stdint.h>

struct scene;

#define EFFECT_MAP(X) /* name, bit, as printed, what it means */                         \
    X(MESH, 0, "mesh", "triangle meshes")                                                \
    X(QUADRIC, 1, "quadric", "spheres and disks")                                        \
    X(SMOOTH_NORMALS, 2, "smooth-normals", "interpolated shading normals")               \
    X(LENS, 3, "lens", "a thin lens with a finite aperture")                             \
    X(ORTHOGRAPHIC, 4, "orthographic", "an orthographic camera")                         \
    X(MIXTURE, 5, "mixture", "diffuse + perfect specular, the lecture's mixture")        \
    X(CONDUCTOR, 6, "conductor", "metals, smooth or rough")                              \
    X(DIELECTRIC, 7, "dielectric", "glass, smooth or rough")                             \
    X(ROUGH, 8, "rough", "microfacet lobes with a finite roughness")                     \
    X(COAT, 9, "coat", "a dielectric coat over a diffuse base")                          \
    X(MIX, 10, "mix", "a random choice between two materials")                           \
    X(POLYGON_LIGHT, 11, "polygon-light", "convex polygons that emit")                   \
    X(SPHERE_LIGHT, 12, "sphere-light", "spheres that emit")                             \
    X(DISK_LIGHT, 13, "disk-light", "disks that emit")                                   \
    X(DELTA_LIGHT, 14, "delta-light", "lights that no ray finds: point, spot, distant")  \
    X(SKY, 15, "sky", "light from infinity, the same in every direction")                \
    X(MANY_LIGHTS, 16, "many-lights", "more than one light to choose from")              \
    X(SAMPLER_ANY, 17, "sampler-any", "a sampler other than Owen-scrambled Sobol")       \
    X(FILTER_ANY, 18, "filter-any", "a reconstruction filter other than the pixel box")  \
    X(PATHS, 19, "paths", "a path expression that is not L(D|S)*E")                      \
    X(WIDE_POLYGON, 20, "wide-polygon", "polygon lights of five or more corners")        \
    X(TEXTURE, 21, "texture", "values that change over a surface")                       \
    X(BUMP, 22, "bump", "normal maps and displacements by bumps")                        \
    X(ENVIRONMENT, 23, "environment", "light from infinity that changes with direction") \
    X(THIN, 24, "thin", "sheets: thin glass and diffuse transmission")                   \
    X(COATED_CONDUCTOR, 25, "coated-conductor", "a dielectric coat over metal")          \
    X(ANISOTROPIC, 26, "anisotropic", "roughness that depends on direction")             \
    X(INSTANCE, 27, "instance", "shapes that stand in several places, stored once")      \
    X(MOTION, 28, "motion", "things that move while the shutter is open")                \
    X(LIGHT_TREE, 29, "light-tree",                                                      \
      "so many lights that each receiver chooses among them by a tree")                  \
    X(MEDIUM, 30, "medium", "fog and other media between surfaces")                      \
    X(SHEEN, 31, "sheen", "fibres that stand on a surface")

/* Enumerators are int, and the last bit is its sign: beside a mask, which is unsigned, it is the
 * bit again */
enum effect {
#define X(name, bit, printed, meaning) FX_##name = (int)(1u << (bit)),
    EFFECT_MAP(X)
#undef X
};

enum {
#define X(name, bit, printed, meaning) FX_##name |
    FX_ALL = EFFECT_MAP(X) 0
#undef X
};

/*
 * FX_LIGHT_TREE: with more lights than this, not counting those at infinity. Measured on a ceiling
 * of 64 equal lights, where choosing by receiver gains least, the tree just pays for itself.
 */
#define LIGHT_TREE_ABOVE 64

/* The mask of a finished scene. Pure; any thread. */
uint32_t scene_effects(const struct scene *scene);

/* "mesh, quadric, ..." into text; cut at capacity. Returns text. */
const char *effects_text(uint32_t mask, char *text, size_t capacity);

#endif
