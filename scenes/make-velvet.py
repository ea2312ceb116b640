#!/usr/bin/env python3
"""The balls of velvet.gltf: make-velvet.py > velvet.gltf

glTF's sheen (KHR_materials_sheen): the same dark red cloth four times, bare and under fibres whose
roughness is .25, .5 and 1, lit by a soft light from above and a bright one from behind. The whole
file is its own: no picture, no other file. The only scene here that is not pbrt-v4.
"""
import base64
import json
import math
import struct

TURNS, ROWS = 40, 20 # of a ball's triangles
ROUGHNESS = (None, .25, .5, 1)
CLOTH, FIBRES = [.18, .01, .02, 1], [.95, .55, .5]


def ball():
    points, triangles = [], []
    for i in range(ROWS + 1):
        down = math.pi * i / ROWS
        for j in range(TURNS + 1):
            turn = 2 * math.pi * j / TURNS
            points.append((math.sin(down) * math.cos(turn), math.cos(down),
                           math.sin(down) * math.sin(turn)))
    for i in range(ROWS):
        for j in range(TURNS):
            at = i * (TURNS + 1) + j
            below = at + TURNS + 1
            if i > 0:
                triangles += [at, at + 1, below]
            if i < ROWS - 1:
                triangles += [at + 1, below + 1, below]
    return points, triangles


points, triangles = ball()
square = [(-1, 0, -1), (-1, 0, 1), (1, 0, 1), (1, 0, -1)] # seen from above
arrays = [b"".join(struct.pack("<3f", *p) for p in points),
          struct.pack("<%dH" % len(triangles), *triangles),
          b"".join(struct.pack("<3f", *p) for p in square), struct.pack("<6H", 0, 1, 2, 0, 2, 3)]
counts, at = (len(points), len(triangles), 4, 6), 0
views, accessors = [], []
for i, data in enumerate(arrays):
    views.append({"buffer": 0, "byteOffset": at, "byteLength": len(data)})
    accessors.append({"bufferView": i, "componentType": 5123 if i % 2 else 5126,
                      "count": counts[i], "type": "SCALAR" if i % 2 else "VEC3"})
    at += len(data)


def opaque(color, roughness, extensions):
    return {"pbrMetallicRoughness": {"baseColorFactor": color, "metallicFactor": 0,
                                     "roughnessFactor": roughness}, "extensions": extensions}


def lamp(strength):
    return {"pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1], "metallicFactor": 0},
            "emissiveFactor": [1, .95, .9],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": strength}}}


def turned(axis, degrees):
    half = math.radians(degrees) / 2
    return [math.sin(half) * a for a in axis] + [math.cos(half)]


materials = [opaque(CLOTH, .9, {} if r is None else {
    "KHR_materials_sheen": {"sheenColorFactor": FIBRES, "sheenRoughnessFactor": r}})
             for r in ROUGHNESS]
materials += [opaque([.12, .12, .13, 1], .9, {}), lamp(15), lamp(65)]
meshes = [{"primitives": [{"material": i, "indices": 1,
                           "attributes": {"POSITION": 0, "NORMAL": 0}}]} for i in range(4)]
meshes += [{"primitives": [{"material": i, "indices": 3, "attributes": {"POSITION": 2}}]}
           for i in range(4, 7)]
nodes = [{"mesh": i, "translation": [2.4 * i - 3.6, 1, 0]} for i in range(4)]
nodes += [{"mesh": 4, "scale": [30, 1, 30]},
          {"mesh": 5, "scale": [5, 1, 2], "translation": [0, 8, 3], "rotation": turned([1, 0, 0], 160)},
          {"mesh": 6, "scale": [6, 1, 1], "translation": [0, 5, -6],
           "rotation": turned([1, 0, 0], 125)},
          {"camera": 0, "translation": [0, 3.2, 14], "rotation": turned([1, 0, 0], -9)}]
print(json.dumps({
    "asset": {"version": "2.0", "generator": "make-velvet.py"},
    "extensionsUsed": ["KHR_materials_sheen", "KHR_materials_emissive_strength"],
    "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}], "nodes": nodes, "meshes": meshes,
    "cameras": [{"type": "perspective",
                 "perspective": {"yfov": math.radians(20), "aspectRatio": 2, "znear": .1}}],
    "materials": materials, "accessors": accessors, "bufferViews": views,
    "buffers": [{"byteLength": at, "uri": "data:application/octet-stream;base64," +
                 base64.b64encode(b"".join(arrays)).decode()}]}, separators=(",", ":")))
