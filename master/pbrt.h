/*
 * Reads pbrt-v4 scene text into the scene model.
 *
 * What pbrt knows and pathfarm does not yet is ERR_UNSUPPORTED at its position, or, when lenient, a
 * counted note and a stand-in (grey diffuse for a material, nothing for a shape or a light). What
 * pbrt does not know is ERR_SCENE with the nearest valid name. Nothing is silently ignored. Every
 * error starts with file:line:column.
 *
 * Beyond pbrt: Material "mixture" with "rgb diffuse" and "rgb specular" (the lecture's: diffuse or
 * a perfect mirror), and Sampler "hammersley".
 *
 * Where pbrt-v4 is of two minds: the normal of a sphere or disk under a mirroring transform is the
 * object's own (outwards, +z), flipped by ReverseOrientation alone. A mesh with vertex normals is
 * rewound at load, triangle by triangle, so that its geometric normal is on the side of the sum of
 * the three vertex normals; its light leaves on that side. Area lights with "power" on a mesh emit
 * that power from every triangle, as in pbrt.
 *
 * Shapes that are no mesh, sphere or disk become triangles (pbrt_curved.h): the normal of a
 * cylinder or a curve that is no ribbon points outwards, that of a subdivision surface where pbrt
 * has it. "power" on them is that of the whole shape, of a bilinear mesh that of each patch.
 *
 * Brightness is pbrt's: the film sees (shutterclose - shutteropen) * iso / 100 of the light
 * (pbrt_sensor.h). Integrators that find the same light in another way render as ours; limits that
 * pbrt sets by default, or only to have less noise, are not applied, and a note says so.
 *
 * Textures differ from pbrt-v4 in this: "bilinear", "trilinear" and "ewa" pictures are all filtered
 * trilinearly; a PNG's alpha is linear, whatever its colours are; and what the numbers of a texture
 * are (reflectances are at most 1) is decided where it is defined, not where it is used.
 *
 * Thread: any, one call each.
 */
#ifndef MASTER_PBRT_H
#define MASTER_PBRT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct err;
struct scene;
struct scene_notes;

struct pbrt_options {
    bool lenient;
};

/* The scene, checked and finished, or NULL with err set. `options` may be NULL (strict); `notes`
 * may be NULL, else it is overwritten; its lines begin with their position. */
struct scene *pbrt_read(const char *path, const struct pbrt_options *options,
                        struct scene_notes *notes, struct err *err);

/* The same from memory. `name` stands for the file in errors; files that the text names are looked
 * for in the folder of `name`, and nowhere (an error) when `name` is NULL. */
struct scene *pbrt_read_text(const char *text, size_t length, const char *name,
                             const struct pbrt_options *options, struct scene_notes *notes,
                             struct err *err);

/*
 * Change the resolution of a finished scene. The crop window keeps its fractions. The screen
 * window follows when it has the picture's shape now (square pixels): its shorter side is kept, as
 * if the file had named the new resolution. ERR_ARGUMENT outside 1..65536.
 */
bool pbrt_set_resolution(struct scene *scene, uint32_t width, uint32_t height, struct err *err);

/* Render only these fractions of the picture, x0 x1 y0 y1, rounded as pbrt's cropwindow. */
bool pbrt_set_crop(struct scene *scene, const double crop[4], struct err *err);

#endif
