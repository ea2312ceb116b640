/*
 * The tree of nodes: where meshes, lights and cameras stand. Part of the glTF reader.
 *
 * Nodes are a forest; one that is met twice is an error, so a walk ends after as many steps as
 * there are nodes, however deep they lie.
 */
#ifndef MASTER_GLTF_NODES_H
#define MASTER_GLTF_NODES_H

#include "master/gltf_json.h"
#include "master/growing.h"

#include <stdbool.h>

struct gltf_nodes {
    struct growing met;    /* bool, of each node */
    struct growing ahead;  /* struct gltf_node: still to be looked at */
    struct growing placed; /* struct gltf_placed: meshes, in the order of the tree */
};

void gltf_nodes_free(struct gltf_nodes *nodes);

/* Look at all nodes of the file's scene, then put the meshes where they stand. */
bool gltf_nodes_walk(struct gltf_reader *reader);

#endif
