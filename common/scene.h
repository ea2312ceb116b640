/*
 * The scene model: what the readers produce, the bundle carries and the workers render. Every
 * array is flat, little-endian and free of pointers, so that it crosses the wire as it is and can
 * be handed to Embree without copying.
 *
 * Space: world space of the scene file, re-centred: `settings.center` (double) was subtracted from
 * every position before rounding to float32, the camera included. Colours are linear sRGB.
 * Angles are radians; text in degrees is converted where it is parsed.
 *
 * Ownership: a scene owns its arena and, through it, all arrays; scene_free releases everything.
 * Thread: built by one thread; read-only, and shareable, afterwards.
 */
#ifndef COMMON_SCENE_H
#define COMMON_SCENE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct arena;
struct err;

#define SCENE_NONE     UINT32_MAX
#define POLYGON_MAX    8  /* corners of one polygon light; larger polygons become several lights */
#define COAT_TABLE_LEN 64 /* entries of one row of a coat's tables */
#define COAT_ALPHAS    8  /* widths that a coat of textured roughness is tabulated for */
#define SHEEN_ALPHAS   49 /* widths that a sheen is tabulated for */
#define SHEEN_FIRST    16 /* the first of them: see struct material */
#define SHEEN_ROWS     (2 * SHEEN_ALPHAS)

enum camera_kind { CAMERA_PERSPECTIVE = 0, CAMERA_ORTHOGRAPHIC = 1 };

/*
 * Film point (x, y) in pixels of the full image, top row first, maps to
 *   sx = screen[0] + (screen[1] - screen[0]) * x / width
 *   sy = screen[3] - (screen[3] - screen[2]) * y / height.
 * Perspective: direction right * sx + up * sy + forward from position (`screen` already holds
 * tan(fov/2)). Orthographic: direction forward from position + right * sx + up * sy.
 * right, up and forward are the columns of camera-to-world; they need not be unit vectors
 * (a mirrored camera has a left-handed triple).
 * Thin lens (lens_radius > 0): the lens lies in the right/up plane at the camera, and points at
 * camera-space z = focal_distance are in focus; infinity means parallel rays.
 */
struct camera {
    uint32_t kind;
    float position[3], right[3], up[3], forward[3];
    float screen[4]; /* x min, x max, y min, y max */
    float lens_radius, focal_distance;
};

enum filter_kind {
    FILTER_BOX = 0,
    FILTER_TRIANGLE = 1,
    FILTER_GAUSSIAN = 2,
    FILTER_MITCHELL = 3,
    FILTER_SINC = 4
};

#define FILTER_SINC_RADIUS 16 /* the most: each pixel of it has lobes to keep apart */

/* A separable reconstruction filter; the formulas are those of pbrt-v4, section 8.8. */
struct filter_spec {
    uint32_t kind;
    float radius[2]; /* pixels */
    float sigma;     /* gaussian: exp(-x^2 / 2 sigma^2) minus its value at the radius */
    float b, c;      /* mitchell */
    float tau;       /* sinc: sinc(x) sinc(x / tau), at least 1 */
};

#define SAMPLER_MAP(X)               \
    X(SOBOL, 0, "sobol")             \
    X(INDEPENDENT, 1, "independent") \
    X(STRATIFIED, 2, "stratified")   \
    X(HALTON, 3, "halton")           \
    X(HAMMERSLEY, 4, "hammersley")
enum sampler_kind {
#define X(name, number, text) SAMPLER_##name = number,
    SAMPLER_MAP(X)
#undef X
        SAMPLER_COUNT
};

/* The small part of a scene: everything that is not an array. Fixed layout. */
struct scene_settings {
    double center[3];    /* what was subtracted from the file's world coordinates */
    float bounds_min[3]; /* of all geometry, re-centred; an empty scene has zeros */
    float bounds_max[3];
    struct camera camera;
    uint32_t width, height; /* of the full image, pixels */
    uint32_t crop[4];       /* x0, x1, y0, y1: rendered are x0 <= x < x1, y0 <= y < y1 */
    struct filter_spec filter;
    uint32_t sampler;       /* enum sampler_kind */
    uint32_t sampler_spp;   /* what the scene file asks for; 0 when it does not */
    uint32_t max_depth;     /* scattering events; SCENE_NONE when unlimited */
    uint32_t effects;       /* scene_effects() of this scene */
    uint32_t has_normals;   /* any mesh with MESH_NORMALS */
    float sky[3];           /* radiance from infinity: the sum of constant infinite lights */
    uint32_t sky_light;     /* index of its entry in lights, or SCENE_NONE */
    uint32_t camera_motion; /* 1 + index into motions, then in place of camera's vectors; or 0 */
    float shutter[2];       /* when it opens and closes, in units of the motions */
    uint32_t camera_medium; /* 1 + index of the medium it stands in; 0: vacuum */
    uint32_t reserved[3];   /* zero */
};

/*
 * What is between surfaces, the same everywhere and in every direction: along each unit of length
 * it absorbs the share sigma_a of the light and scatters the share sigma_s, by the phase function
 * of Henyey and Greenstein with mean cosine g. Where it absorbs it emits Le, which so is the
 * radiance of a thick medium that does not scatter.
 *
 * A surface has a medium on either side, `inside` against its normal and `outside` along it: 1 +
 * index, or 0 for vacuum. What crosses the surface is in the medium of the side that it leaves to,
 * whatever it was in before (as in pbrt-v4). Where both are the same, as in scenes without media,
 * the surface says nothing about media. A surface without a material but with two different media
 * is there for them alone, and bends and stops nothing.
 */
struct medium {
    float sigma_a[3], sigma_s[3], Le[3];
    float g;
};

enum mesh_flag {
    MESH_NORMALS = 1,     /* has vertex normals */
    MESH_UVS = 2,         /* has texture coordinates */
    MESH_FLIP_NORMAL = 4, /* geometric normal is -(e1 x e2): orientation and handedness together */
    MESH_COLORS = 8,      /* has vertex colours */
};

/*
 * Triangles [first_triangle, first_triangle + triangle_count) of `triangles`. Triangle indices are
 * global: vertex v has positions[3v..3v+2], normals[3(v + normal_shift)..] and
 * uvs[2(v + uv_shift)..] and colors[4(v + color_shift)..] (linear RGB and alpha), the shifts
 * wrapping modulo 2^32. Normals are unit length, in world space, on the side given by the file
 * (already flipped by ReverseOrientation).
 */
struct mesh {
    uint32_t first_triangle, triangle_count;
    uint32_t first_vertex, vertex_count;
    uint32_t normal_shift, uv_shift, color_shift;
    uint32_t alpha;    /* texture of the share of the surface that is there; 1 + index, or 0 */
    uint32_t material; /* index into materials; SCENE_NONE: only media differ on its two sides, or
                          it is not there at all */
    uint32_t inside, outside; /* media: see above */
    uint32_t first_emissive;  /* triangle t emits as light triangle_light[first_emissive + t]; or
                                 SCENE_NONE */
    uint32_t flags;
};

enum quadric_kind { QUADRIC_SPHERE = 0, QUADRIC_DISK = 1 };
enum quadric_flag {
    QUADRIC_FLIP_NORMAL = 1, /* normal points inwards (sphere) or along -z of object space (disk) */
    QUADRIC_SIMILARITY = 2,  /* to_world is rotation times one positive scale, up to mirroring */
    QUADRIC_PARTIAL = 4,     /* z range, phi range or a disk's inner radius cuts something away */
};

/*
 * A sphere or disk, in its object space: world = center + to_world * object, object = to_object *
 * (world - center). Sphere: radius about the origin, z in [z_min, z_max]. Disk: z = 0 (the file's
 * height is folded into center), inner_radius <= r <= radius. Both: 0 <= phi <= phi_max.
 */
struct quadric {
    uint32_t kind, flags;
    float center[3];
    float to_world[9], to_object[9]; /* row-major 3x3 */
    float radius, inner_radius, z_min, z_max, phi_max;
    float world_radius; /* radius in world units when QUADRIC_SIMILARITY */
    uint32_t material;  /* as in struct mesh */
    uint32_t inside, outside;
    uint32_t light; /* or SCENE_NONE */
    uint32_t alpha; /* as in struct mesh */
};

/*
 * Shapes that are stored once and stand in several places, or that move: meshes [first_mesh,
 * first_mesh + mesh_count) and quadrics likewise. They are in the group's own space and are seen
 * through instances only. In both arrays the shapes of no group come first, then those of each
 * group in turn. Shapes of a group never emit: what emits stands in the world, once per instance,
 * so that every light knows where it is.
 */
struct group {
    uint32_t first_mesh, mesh_count;
    uint32_t first_quadric, quadric_count;
};

/*
 * A group in the world: world = to_world (object, 1) and back, row-major 3x4, in re-centred world
 * space. Each is rounded from its own doubles, neither from the other.
 */
struct instance {
    uint32_t group;
    uint32_t motion; /* 1 + index into motions, then in place of the matrices; or 0 */
    float to_world[12], to_object[12];
};

/*
 * A transform that changes: at time s, from 0 to 1, world = T + R S object, with T and S linear in
 * s and R the rotation by the quaternion slerp(q[0], q[1], s) = (x, y, z, w), after pbrt-v4. q[0]
 * and q[1] are unit, on the same side, and `angle` apart (of a quaternion: half that of the turn).
 * Before 0 and after 1 nothing moves.
 */
struct motion {
    float translation[2][3];
    float rotation[2][4];
    float stretch[2][9]; /* S: symmetric but for rounding, row-major; may mirror */
    float angle;
};

/*
 * A picture that textures and environments read: `levels` pyramids of half the size each, from
 * `width` x `height` to 1 x 1 (sizes round down, never below 1), one after the other from texel
 * block `first_block` on. Rows start at the top; channels are interleaved: 1 grey, 2 grey and
 * alpha, 3 RGB, 4 RGBA. An environment has one level.
 */
enum picture_texel {
    TEXEL_U8 = 0,      /* value / 255 */
    TEXEL_U8_SRGB = 1, /* the same through the sRGB curve; alpha stays linear */
    TEXEL_HALF = 2,
    TEXEL_FLOAT = 3,
};
#define TEXEL_BLOCK 16 /* bytes; pictures start at multiples of it */
struct scene_picture {
    uint32_t first_block;
    uint32_t width, height, channels, levels;
    uint32_t texel; /* enum picture_texel */
};

/*
 * A picture of what comes from, or goes into, every direction. A direction d of the world is
 * to_light d in the picture's space, where a texel covers a patch of directions, all of it with
 * the texel's value times `scale` (nothing is interpolated, as in pbrt-v4; common/direction_map.h).
 * Seen from a sky the direction is the one looked into; from a point light, the one of its light.
 */
enum environment_layout {
    ENVIRONMENT_SQUARE = 0,     /* pbrt-v4's octahedron of equal areas; width = height */
    ENVIRONMENT_LAT_LONG = 1,   /* rows from +z to -z, columns once around from +x over +y */
    ENVIRONMENT_PROJECTION = 2, /* where z > 0: x / z and y / z in [-1, 1], top left at (-1, -1);
                                   black elsewhere. For point lights only. */
};
struct environment {
    uint32_t picture, layout;
    uint32_t light;    /* the one light that it belongs to */
    float to_light[9]; /* row-major; a rotation, mirrored or not, but for projections */
    float scale[3];
};

/*
 * Textures are trees: children come before their parents in the array. A value has three channels;
 * a float texture has the same in all. Where child[i] is 0, value[i] stands in its place.
 */
enum texture_kind {
    TEXTURE_CONSTANT = 0, /* value[0] */
    TEXTURE_IMAGE = 1,    /* picture, at (u, v) of the mapping, times scale; v upwards from the
                             bottom row */
    TEXTURE_SCALE = 2,    /* child 0 times child 1 */
    TEXTURE_MIX = 3,      /* child 0 (1 - child 2) + child 1 child 2 */
    TEXTURE_CHECKERBOARD =
        4,              /* child 0 where the sum of the floors of the mapping is even, else 1 */
    TEXTURE_BILERP = 5, /* value[0] at (0,0), [1] at (0,1), [2] at (1,0), [3] at (1,1) */
    TEXTURE_FBM = 6,    /* pbrt-v4's noises of a point: octaves, omega */
    TEXTURE_WRINKLED = 7,
    TEXTURE_WINDY = 8,
    TEXTURE_DOTS = 9,          /* child 0 inside of pbrt's random dots, child 1 outside */
    TEXTURE_MARBLE = 10,       /* octaves, omega, scale, variation */
    TEXTURE_VERTEX_COLOR = 11, /* colours of the mesh, interpolated; white where there are none */
    TEXTURE_DIRECTION = 12,    /* mix of child 0 and 1 by |n . d|, d in value[2] */
    TEXTURE_STEP = 13,         /* 1 where child 0 is at least child 1, else 0 */
    TEXTURE_KINDS
};
enum texture_mapping {
    MAPPING_UV = 0,          /* (map[0] u + map[1] v + map[2], map[3] u + map[4] v + map[5]) */
    MAPPING_PLANAR = 1,      /* (map[0..2] . p + map[3], map[4..6] . p + map[7]) */
    MAPPING_SPHERICAL = 2,   /* of map (3x4, world to texture) times p: (theta / pi, phi / 2 pi) */
    MAPPING_CYLINDRICAL = 3, /* of the same point: (phi / 2 pi + 1/2, z) */
    MAPPING_POINT = 4,       /* the same point itself, for textures of three dimensions */
};
enum texture_wrap { WRAP_REPEAT = 0, WRAP_CLAMP = 1, WRAP_BLACK = 2, WRAP_MIRROR = 3 };
enum texture_flag {
    TEXTURE_INVERT = 1,      /* 1 - value, never below 0 */
    TEXTURE_NEAREST = 2,     /* no interpolation between texels */
    TEXTURE_THREE_SPACE = 4, /* a checkerboard of cubes */
};
struct texture {
    uint32_t kind, flags;
    uint32_t child[3]; /* 1 + index of an earlier texture, or 0 */
    float value[4][3];
    uint32_t mapping;
    float map[12];    /* p is in re-centred world space; already divided by what it divides */
    uint32_t picture; /* index */
    uint32_t wrap[2]; /* along u and v */
    uint32_t channel; /* 0 to 3: that channel alone, in all three; SCENE_NONE: RGB */
    float scale, variation;
    uint32_t octaves;
    float omega;
};

enum material_kind {
    MATERIAL_DIFFUSE = 0,    /* reflectance */
    MATERIAL_MIXTURE = 1,    /* reflectance (k_d) + perfect mirror of colour specular (k_s) */
    MATERIAL_CONDUCTOR = 2,  /* eta, k per channel; alpha */
    MATERIAL_DIELECTRIC = 3, /* ior; alpha */
    MATERIAL_COAT = 4,       /* dielectric coat (ior, alpha, table) over diffuse reflectance */
    MATERIAL_MIX = 5, /* mix[0] with probability 1 - amount, mix[1] with probability amount */
    MATERIAL_THIN_DIELECTRIC = 6,      /* ior: a pane, both of its faces at once; smooth */
    MATERIAL_DIFFUSE_TRANSMISSION = 7, /* reflectance on wo's side, specular on the other */
    MATERIAL_COATED_CONDUCTOR = 8, /* coat (ior, alpha, table) over metal (eta, k, base_alpha) */
    MATERIAL_UNLIT = 9, /* shows reflectance to the camera and in mirrors, whatever light falls on
                           it; to all else it is black, so it lights nothing */
    MATERIAL_KINDS
};

/*
 * alpha is the GGX (Trowbridge-Reitz) width along x and y of the shading frame, already remapped;
 * below ALPHA_SMOOTH in both the surface is perfectly smooth and its lobes are delta events.
 *
 * The coat is the expectation of pbrt-v4's layered random walk with an empty medium, summed to
 * infinite depth (derived and tabulated in master/coat.h); n is ior, per colour channel:
 *   f(wo, wi) = f_ggx(wo, wi) + T(wo) T(wi) reflectance coat_scale / (1 - reflectance coat_inner)
 * with T(mu) the share of light from outside at cosine mu that arrives at the base, coat_inner the
 * share of the base's diffuse light that the coat sends back to it, and coat_scale = 1 / (pi n^2).
 * coat_tables[coat_table * COAT_TABLE_LEN + i] = T(mu) at mu = (i / (COAT_TABLE_LEN - 1))^2;
 * between them linear in sqrt(mu). Both sides of the surface are coated. With two alphas the table
 * is that of their mean.
 *
 * Over a conductor there are three rows in place of one, enum coat_row, and its lobes are those of
 * master/coat.h. With MATERIAL_COATS the rows come COAT_ALPHAS times, for a coat of
 * alpha = (j / (COAT_ALPHAS - 1))^2 each (between them linear in sqrt(alpha), above 1 as at 1), and
 * behind them all is one row more: coat_inner of each alpha, then 1 / coat_scale of each (0 for 0).
 *
 * A sheen (MATERIAL_SHEEN) may lie over any kind but mixes and unlit ones, on both sides: that of
 * common/sheen.h in the colour `sheen`, of width sheen_alpha. From coat_tables row sheen_table on
 * there are SHEEN_ALPHAS rows of its albedo and as many of its bound, mu as above, for widths of
 * alpha = ((SHEEN_FIRST + j) / 64)^4 each (between them linear in the fourth root of alpha).
 */
#define ALPHA_SMOOTH      1e-3f
#define SHEEN_ALPHA_LEAST (1 / 256.0f)

/*
 * What a texture may give instead of the number in struct material. SLOT_ROUGHNESS_* give alpha
 * after the remapping of MATERIAL_REMAP; SLOT_NORMAL is a normal in the tangent frame, (c + 1) / 2;
 * SLOT_BUMP a displacement along the normal, in world units, of which only the slope is used.
 */
enum material_slot {
    SLOT_REFLECTANCE = 0, /* reflectance */
    SLOT_SPECULAR = 1,    /* specular */
    SLOT_ROUGHNESS_U = 2, /* alpha[0] */
    SLOT_ROUGHNESS_V = 3, /* alpha[1] */
    SLOT_AMOUNT = 4,      /* mix_amount */
    SLOT_ETA = 5,         /* eta */
    SLOT_K = 6,           /* k */
    SLOT_NORMAL = 7,
    SLOT_BUMP = 8,
    SLOT_SHEEN = 9,        /* sheen */
    SLOT_SHEEN_ALPHA = 10, /* sheen_alpha */
    MATERIAL_SLOTS
};
enum material_flag {
    MATERIAL_REMAP = 1, /* a texture's roughness r means alpha = sqrt(r) */
    MATERIAL_METAL = 2, /* conductor: SLOT_REFLECTANCE gives eta = 1 and k as for "reflectance" */
    MATERIAL_NORMAL_SCALED = 4, /* the normal map's x and y are multiplied by normal_scale */
    MATERIAL_TINTED = 8,        /* dielectric, thin or not: what is transmitted takes the colour
                                   specular, at each crossing of the surface */
    MATERIAL_COATS = 16,        /* one set of coat rows for each of COAT_ALPHAS widths */
    MATERIAL_SHEEN = 32,        /* a sheen lies over it */
};

/* Rows of a coat over a conductor, all over the cosine mu outside */
enum coat_row {
    COAT_ENTER = 0,  /* what arrives at the conductor, T */
    COAT_RETURN = 1, /* what the interface sends back of light leaving towards mu, R */
    COAT_SPREAD = 2, /* what comes out in no particular direction, M */
    COAT_METAL_ROWS
};
struct material {
    uint32_t kind, flags;
    uint32_t texture[MATERIAL_SLOTS]; /* 1 + index, or 0 */
    float normal_scale;
    float reflectance[3];
    float specular[3];
    float eta[3], k[3];
    float ior; /* inside over outside */
    float alpha[2];
    float base_alpha[2]; /* GGX widths of the conductor below a coat */
    uint32_t mix[2];
    float mix_amount;
    uint32_t coat_table;
    float coat_inner, coat_scale;
    float sheen[3], sheen_alpha;
    uint32_t sheen_table;
};

enum light_kind {
    LIGHT_POLYGON = 0,
    LIGHT_SPHERE = 1,
    LIGHT_DISK = 2,
    LIGHT_POINT = 3,
    LIGHT_SPOT = 4,
    LIGHT_DISTANT = 5,
    LIGHT_SKY = 6,
    LIGHT_KINDS
};
enum light_flag {
    LIGHT_TWO_SIDED = 1,
    LIGHT_UNSEEN = 2, /* area lights: no ray finds their shape; they light all the same */
};

/*
 * Area lights emit `radiance` on the side of `normal` (polygon) or of their quadric's normal, or on
 * both. Point and spot: `radiance` is radiant intensity; distant: irradiance on a surface facing
 * it. A polygon is convex and planar, corners light_corners[3 * (first_corner + i)] in an order
 * that is counter-clockwise seen from the side of `normal`. What an environment says by direction
 * (sky, point) takes the place of `radiance`, which then is its mean over all directions.
 *
 * So does what a texture says over the surface of an area light, times texture_scale: `radiance` is
 * about its mean then, by which lights are chosen. A polygon with a texture, or of a mesh that is
 * there in part, is one triangle of its mesh.
 *
 * A sky with corners shines through that polygon alone (pbrt-v4's portal): along rays that pass it
 * against its normal, wherever they start. Its area is the portal's.
 */
struct light {
    uint32_t kind, flags;
    float radiance[3];
    float position[3];
    float direction[3]; /* spot, distant: the way the light travels, unit */
    float normal[3];
    float cos_falloff_start, cos_falloff_end; /* spot, pbrt's smoothstep between them */
    float area;                               /* world units, one side */
    float pick; /* probability that light sampling chooses this light; all sum to 1 */
    uint32_t first_corner, corner_count;
    uint32_t quadric;
    uint32_t environment; /* 1 + index, or 0 */
    uint32_t texture;     /* 1 + index, or 0 */
    float texture_scale;
};

/* What the file calls element `index` of an array */
struct scene_name {
    uint32_t index;
    const char *text;
};

struct scene {
    struct arena *arena;
    struct scene_settings settings;
    /* array, count: every X below is one bundle object */
    float *positions;
    uint32_t vertex_count; /* positions has 3 floats each */
    float *normals;
    uint32_t normal_count;
    float *uvs;
    uint32_t uv_count;
    uint32_t *triangles; /* 3 vertex indices each */
    uint32_t triangle_count;
    struct mesh *meshes;
    uint32_t mesh_count;
    struct quadric *quadrics;
    uint32_t quadric_count;
    struct material *materials;
    uint32_t material_count;
    float *coat_tables;
    uint32_t coat_table_count; /* COAT_TABLE_LEN floats each */
    struct light *lights;
    uint32_t light_count;
    float *light_corners;
    uint32_t light_corner_count;
    uint32_t *triangle_light;
    uint32_t triangle_light_count;
    float *colors;
    uint32_t color_count;
    struct texture *textures;
    uint32_t texture_count;
    struct scene_picture *pictures;
    uint32_t picture_count;
    uint8_t *texels;
    uint32_t texel_block_count; /* TEXEL_BLOCK bytes each */
    struct environment *environments;
    uint32_t environment_count;
    struct group *groups;
    uint32_t group_count;
    struct instance *instances;
    uint32_t instance_count;
    struct motion *motions;
    uint32_t motion_count;
    struct medium *media;
    uint32_t medium_count;

    /* For people: names stay in the master, and are in no digest */
    struct scene_name *material_names;
    uint32_t material_name_count;
    struct scene_name *group_names; /* by rising index */
    uint32_t group_name_count;
};

/* The arrays that cross the wire, for code that treats all alike: member, count member, element
 * type, per count */
#define SCENE_ARRAYS(X)                                       \
    X(positions, vertex_count, float, 3)                      \
    X(normals, normal_count, float, 3)                        \
    X(uvs, uv_count, float, 2)                                \
    X(triangles, triangle_count, uint32_t, 3)                 \
    X(meshes, mesh_count, struct mesh, 1)                     \
    X(quadrics, quadric_count, struct quadric, 1)             \
    X(materials, material_count, struct material, 1)          \
    X(coat_tables, coat_table_count, float, COAT_TABLE_LEN)   \
    X(lights, light_count, struct light, 1)                   \
    X(light_corners, light_corner_count, float, 3)            \
    X(triangle_light, triangle_light_count, uint32_t, 1)      \
    X(colors, color_count, float, 4)                          \
    X(textures, texture_count, struct texture, 1)             \
    X(pictures, picture_count, struct scene_picture, 1)       \
    X(texels, texel_block_count, uint8_t, TEXEL_BLOCK)        \
    X(environments, environment_count, struct environment, 1) \
    X(groups, group_count, struct group, 1)                   \
    X(instances, instance_count, struct instance, 1)          \
    X(motions, motion_count, struct motion, 1)                \
    X(media, medium_count, struct medium, 1)

/* An empty scene with default settings; NULL when memory runs out. scene_free(NULL) is fine. */
struct scene *scene_new(void);
void scene_free(struct scene *scene);

/*
 * Check a scene that came from outside (a reader or the wire): every index in range, every float
 * finite where it must be, the effect mask equal to the recomputed one. ERR_SCENE says what not.
 */
bool scene_check(const struct scene *scene, struct err *err);

#endif
