/*
 * Reads glTF 2.0 scenes, .gltf and .glb, into the scene model.
 *
 * Errors name the file and the place in it ("box.gltf: meshes[3].primitives[0]: ..."; for JSON that
 * is none, line and column). What is approximated is a counted note, never silent. An extension
 * that the file requires and that is not known is ERR_UNSUPPORTED with its name, and so is a
 * picture in a format that we do not read; when lenient, a note, and what is there without it.
 *
 * What is made of what:
 * - Surfaces reflect from both sides, whatever doubleSided says; it only decides whether an
 *   emissive surface emits from its back as well.
 * - Metallic-roughness: by "metallic" a mix of a metal with reflectance baseColor and a dielectric
 *   coat (ior) over a diffuse base of baseColor; the width of both is roughness squared.
 * - A sheen lies over all of that on both sides, a clear coat included, where glTF has it between
 *   the two. A roughness below 1/16 is taken as that.
 * - Unlit materials show their base colour to the camera, and to it in mirrors and through glass,
 *   whatever light falls on them; they light nothing, and other surfaces see them black.
 * - Glass is a pane; with a thickness (KHR_materials_volume) its mesh is the surface of a body,
 *   whose inside absorbs as attenuation colour and distance say. A colour of 0 is taken as 1e-6.
 * - Emission is radiance, 1 for a factor of 1, times what an emissive texture shows.
 * - Light intensities: candela and lux are taken as radiant intensity and irradiance of the same
 *   number, on the scale of emission (1 is 1 nit), as glTF says. Blender's exporter alone turns
 *   its watts into lumens with 683 lm/W and leaves emission as it is: lights of files that it
 *   wrote are divided by 683, so that the picture is Blender's. A spot's light falls off between
 *   its cones as pbrt's; "range" is not applied, light goes on forever.
 * - The picture has 720 rows, and as many columns as the camera's aspect asks for (1280 when it
 *   does not). Near and far planes do not cut. Occlusion textures are not used: light is traced.
 * - Animations and skins are shown as the nodes stand. Points and lines are not surfaces.
 *
 * A file without lights gets a constant sky of radiance 1, one without a camera a view from the
 * front that holds everything; a note says so.
 *
 * Files are taken for strangers': every index and length is checked, geometry is held to 64 times
 * the input and 64 MiB, and what a file names is looked for by relative paths only, and only if it
 * is a regular file.
 *
 * Thread: any, one call each.
 */
#ifndef MASTER_GLTF_H
#define MASTER_GLTF_H

#include <stdbool.h>
#include <stddef.h>

struct err;
struct scene;
struct scene_notes;

struct gltf_options {
    bool lenient;
    const char *camera; /* name of a camera or of its node, or its number in the file; NULL: the
                           first */
};

/* Is it glTF, by its name, or else by how it begins? */
bool gltf_is(const char *path);

/* The scene, checked and finished, or NULL with err set. `options` may be NULL; `notes` may be
 * NULL, else it is overwritten. */
struct scene *gltf_read(const char *path, const struct gltf_options *options,
                        struct scene_notes *notes, struct err *err);

/* The same from memory. `name` stands for the file in errors; files that it names are looked for in
 * the folder of `name`, and nowhere (an error) when `name` is NULL. */
struct scene *gltf_read_bytes(const void *bytes, size_t size, const char *name,
                              const struct gltf_options *options, struct scene_notes *notes,
                              struct err *err);

#endif
