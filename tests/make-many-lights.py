#!/usr/bin/env python3
"""A market at night: make-many-lights.py [COUNT] > SCENE.pbrt

Lanterns of twenty emissive triangles each hang over a square of stalls, one to a square metre, of
sizes, colours and brightness that differ. Each place is lit by the few lanterns around it, however
many there are in all. COUNT triangles, 100,000 unless given; the same COUNT gives the same bytes.
"""
import math
import random
import sys

COLOURS = ((1, .55, .2), (1, .8, .55), (.5, .7, 1), (1, .3, .25), (.4, 1, .5))
GROUPS = 40 # lanterns of the same colour and brightness
GOLDEN = (1 + 5 ** .5) / 2
CORNERS = [[v / math.hypot(1, GOLDEN) for v in corner[k:] + corner[:k]] for k in range(3)
           for corner in ([0, a, b * GOLDEN] for a in (-1, 1) for b in (-1, 1))]


def icosahedron():
    """Its faces: neighbours are 1.05 apart; each face counter-clockwise seen from outside"""
    def near(i, j):
        return math.dist(CORNERS[i], CORNERS[j]) < 1.1
    faces = []
    for i in range(12):
        for j in range(i):
            for k in range(j):
                if near(i, j) and near(j, k) and near(i, k):
                    a, b, c = (CORNERS[n] for n in (i, j, k))
                    volume = (a[0] * (b[1] * c[2] - b[2] * c[1]) + a[1] * (b[2] * c[0] - b[0] * c[2]) +
                              a[2] * (b[0] * c[1] - b[1] * c[0]))
                    faces.append((i, j, k) if volume > 0 else (i, k, j))
    return faces


FACES = icosahedron()


def mesh(corners, triangles):
    return ('Shape "trianglemesh" "point3 P" [%s]\n  "integer indices" [%s]\n' %
            (" ".join("%.5g" % c for p in corners for c in p), " ".join(map(str, triangles))))


def box(low, high):
    corners = [[(low, high)[i >> axis & 1][axis] for axis in range(3)] for i in range(8)]
    sides = ((0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5))
    return mesh(corners, [k for a, b, c, d in sides for k in (a, b, c, a, c, d)])


def main():
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 100000
    lanterns = count // len(FACES)
    half = math.sqrt(lanterns) / 2
    rng = random.Random(1)
    out = sys.stdout.write
    out("# Many lights: a market at night under %d lanterns of %d emissive triangles. Each place is\n"
        "# lit by the few around it; who chooses lights by power alone hardly ever finds those.\n"
        "# Made by tests/make-many-lights.py %d\n" % (lanterns, len(FACES), count))
    out('LookAt 0 %g %g  0 0 %g  0 1 0\nCamera "perspective" "float fov" 50\n' %
        (min(half * 1.6, 5), -min(half * 1.8, 6), -min(half * .3, 1)))
    out('Film "rgb" "integer xresolution" 192 "integer yresolution" 128\n'
        '  "string filename" "many-lights.exr"\n'
        'PixelFilter "box" "float xradius" 0.5 "float yradius" 0.5\n'
        'Sampler "sobol" "integer pixelsamples" 64\nIntegrator "path" "integer maxdepth" 5\n'
        'WorldBegin\n')
    out('Material "diffuse" "rgb reflectance" [.5 .48 .45]\n')
    side = half + 2
    out(mesh([(-side, 0, -side), (side, 0, -side), (side, 0, side), (-side, 0, side)],
             (0, 2, 1, 0, 3, 2)))
    out('Material "coateddiffuse" "rgb reflectance" [.35 .2 .12] "float roughness" .1\n')
    stalls = 2 * max(int(half) // 2, 1)
    for i in range(stalls * stalls):
        x, z = ((k + .5 - stalls / 2) * 2 * half / stalls for k in (i % stalls, i // stalls))
        out(box((x - .4, 0, z - .3), (x + .4, rng.uniform(.4, .9), z + .3)))
    out('Material "diffuse" "rgb reflectance" [0 0 0]\n')
    for group in range(min(GROUPS, lanterns)):
        corners, triangles = [], []
        bright = 10 ** rng.uniform(2, 3)
        for _ in range(group, lanterns, GROUPS):
            middle = (rng.uniform(-half, half), rng.uniform(1.1, 2.2), rng.uniform(-half, half))
            radius = .03 * 10 ** rng.uniform(-.4, .2)
            triangles += [len(corners) + corner for face in FACES for corner in face]
            corners += [[m + radius * c for m, c in zip(middle, corner)] for corner in CORNERS]
        out('AttributeBegin\nAreaLightSource "diffuse" "rgb L" [%s]\n' %
            " ".join("%.5g" % (bright * c) for c in COLOURS[group % len(COLOURS)]))
        out(mesh(corners, triangles))
        out('AttributeEnd\n')


if __name__ == "__main__":
    main()
