#!/usr/bin/env python3
"""The sky of environment.pbrt: make-environment.py > environment.hdr

128 x 128 texels of equal solid angle, in pbrt-v4's octahedral layout with +z up, as flat RGBE: a
blue that pales towards the horizon, dim ground below it, and a sun of 3 x 3 texels (ten times as
wide as the real one) with a glow around it, which gives about as much light as all the rest.
"""
import math
import sys

SIZE = 128
ZENITH, HORIZON, GROUND = (.18, .36, .80), (.80, .88, 1), (.16, .14, .12)
GLOW, SUN = (1, .75, .45), (512, 424, 312)
SUN_TEXEL = (81, 83) # the middle one


def direction(x, y):
    """Towards the middle of a texel, by Clarberg's mapping (2008)"""
    u, v = 2 * (x + .5) / SIZE - 1, 2 * (y + .5) / SIZE - 1
    d = 1 - (abs(u) + abs(v))
    r = 1 - abs(d)
    phi = ((abs(v) - abs(u)) / r + 1) * math.pi / 4
    across = r * math.sqrt(2 - r * r)
    return (math.copysign(across * math.cos(phi), u), math.copysign(across * math.sin(phi), v),
            math.copysign(1 - r * r, d))


def radiance(x, y):
    if max(abs(x - SUN_TEXEL[0]), abs(y - SUN_TEXEL[1])) <= 1:
        return SUN
    w, sun = direction(x, y), direction(*SUN_TEXEL)
    share = max(w[2], 0) ** .7
    below = min(max(-w[2] / .3 - .3, 0), 1)
    glow = math.exp(-18 * (1 - sum(a * b for a, b in zip(w, sun))))
    sky = [h + (z - h) * share + g * glow for h, z, g in zip(HORIZON, ZENITH, GLOW)]
    return [s + (g - s) * below for s, g in zip(sky, GROUND)]


def rgbe(rgb):
    exponent = math.frexp(max(rgb))[1]
    return bytes(int(c * 2 ** (8 - exponent)) for c in rgb) + bytes([exponent + 128])


out = sys.stdout.buffer
out.write(b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y %d +X %d\n" % (SIZE, SIZE))
for y in range(SIZE):
    for x in range(SIZE):
        out.write(rgbe(radiance(x, y)))
