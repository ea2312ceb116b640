"""Closed forms through the whole farm, and the planted bugs that the same check must catch.

Every row is a scene of pbrt text, rendered by `pathfarm render` with a real worker and read back
through `pathfarm compare`. Its mean must lie within four standard errors of the closed form; the
standard error is that of the replicates (at least 32), with pixels independent of each other. A
row also has to have the power to notice 2 %: the same mean must be refused against 1.02 and .98
times the value. A planted bug is a scene that is wrong in a small way; there the check must fail.

    PATHFARM_BIN=build/release/bin python3 tests/closed_forms.py [WORDS OF A ROW'S NAME...]
"""

import json
import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from math import acos, atan, atan2, cos, exp, log, pi, radians, sin, sqrt, tan

BIN = os.environ["PATHFARM_BIN"]
REPLICATES = 32
SEED = 1
# Rounding of float32 scene values and sums, where there is no noise to hide it
ROUNDING = 1e-5


# --- Formulas: NUMERICS section 6 and what follows from it ------------------------------------

def parallel_rectangles(a, b, c):
    x, y = a / c, b / c
    u, v = sqrt(1 + x * x), sqrt(1 + y * y)
    return 2 / (pi * x * y) * (log(u * v / sqrt(1 + x * x + y * y)) + x * v * atan(x / v)
                               + y * u * atan(y / u) - x * atan(x) - y * atan(y))


def perpendicular_rectangles(w, h):
    """w x 1 and h x 1, sharing the edge of length 1"""
    w2, h2 = w * w, h * h
    d = sqrt(h2 + w2)
    a = (1 + w2) * (1 + h2) / (1 + w2 + h2)
    b = (w2 * (1 + w2 + h2) / ((1 + w2) * (w2 + h2))) ** w2
    c = (h2 * (1 + h2 + w2) / ((1 + h2) * (h2 + w2))) ** h2
    return (w * atan(1 / w) + h * atan(1 / h) - d * atan(1 / d) + log(a * b * c) / 4) / (pi * w)


def point_under_corner(a, b, c):
    a, b = a / c, b / c
    u, v = sqrt(1 + a * a), sqrt(1 + b * b)
    return (a / u * atan(b / u) + b / v * atan(a / v)) / (2 * pi)


def point_beside_wall(height, width, distance):
    """The wall rises from the receiver's plane; the receiver is opposite its corner"""
    u = sqrt(1 + (height / distance) ** 2)
    return (atan(width / distance) - atan(width / distance / u) / u) / (2 * pi)


def disk_off_axis(radius, height, offset):
    z = height ** 2 + offset ** 2
    return (1 - (z - radius ** 2) / sqrt((z + radius ** 2) ** 2 - (2 * radius * offset) ** 2)) / 2


def coaxial_disks(radius, distance):
    z = 2 + (distance / radius) ** 2
    return (z - sqrt(z * z - 4)) / 2


def sphere_light(radius, distance, cos_theta):
    s = radius / distance
    sin_theta, cos_sigma = sqrt(1 - cos_theta ** 2), sqrt(1 - s * s)
    if cos_theta >= s:
        return s * s * cos_theta
    x = max(-1, min(1, cos_sigma * cos_theta / (s * sin_theta)))
    y = max(-1, min(1, cos_sigma / sin_theta))
    return (cos_theta * s * s * acos(-x) - sin_theta * cos_sigma * s * sqrt(1 - x * x)
            + acos(y)) / pi


def polygon(corners):
    """Lambert's formula for a polygon above the horizon of the origin, whose normal is +y"""
    total = 0
    for a, b in zip(corners, corners[1:] + corners[:1]):
        c = cross(a, b)
        length = sqrt(dot(c, c))
        total += atan2(length, dot(a, b)) * c[1] / length
    return abs(total) / (2 * pi)


def fresnel(cos_theta, n):
    c = sqrt(1 - (1 - cos_theta ** 2) / (n * n))
    return (((n * cos_theta - c) / (n * cos_theta + c)) ** 2
            + ((cos_theta - n * c) / (cos_theta + n * c)) ** 2) / 2


def fresnel_metal(cos_theta, eta, k):
    n = complex(eta, -k)
    c = (1 - (1 - cos_theta ** 2) / (n * n)) ** 0.5
    return (abs((n * cos_theta - c) / (n * cos_theta + c)) ** 2
            + abs((cos_theta - n * c) / (cos_theta + n * c)) ** 2) / 2


def smooth_coat(cos_theta, albedo):
    """What a coat of index 1.5 over paint sends back of a uniform sky"""
    inside = 0.596345759708  # hemispherical mean of the internal Fresnel reflection
    f = fresnel(cos_theta, 1.5)
    return f + (1 - f) * (1 - inside) * albedo / (1 - inside * albedo)


def furnace(albedo, depth=None):
    return (1 - (albedo ** (depth + 1) if depth is not None else 0)) / (1 - albedo)


def dot(a, b):
    return sum(x * y for x, y in zip(a, b))


def cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


# --- Scene text -------------------------------------------------------------------------------

def numbers(values):
    return "[ " + " ".join(repr(float(v)) for v in values) + " ]"


def grey(kind, name, value):
    return f'"{kind} {name}" {numbers([value] * 3)}'


def look(start, end, up=(0, 0, 1)):
    return "LookAt " + " ".join(repr(float(v)) for v in (*start, *end, *up))


def window(start, end, half_width, up=(0, 0, 1)):
    """An orthographic camera; rays are parallel, so that a tiny window sees one point"""
    w = half_width
    return f'{look(start, end, up)}\nCamera "orthographic" "float screenwindow" ' \
           f'{numbers([-w, w, -w, w])}'


def looking_down(height=1e-3, half_width=1e-4):
    return window((0, height, 0), (0, 0, 0), half_width)


def fan(*corners):
    """A convex polygon; its normal follows the right hand"""
    indices = " ".join(f"0 {i} {i + 1}" for i in range(1, len(corners) - 1))
    return f'Shape "trianglemesh" "point3 P" {numbers([x for c in corners for x in c])} ' \
           f'"integer indices" [ {indices} ]'


def level(x0, x1, z0, z1, y=0):
    """A rectangle with its normal up"""
    return fan((x0, y, z0), (x0, y, z1), (x1, y, z1), (x1, y, z0))


def ceiling(x0, x1, z0, z1, y):
    """The same with its normal down"""
    return fan((x0, y, z0), (x1, y, z0), (x1, y, z1), (x0, y, z1))


def box_corners(half=1):
    return [(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)]


def box(half=1, corners=None):
    """Normals inwards"""
    c = corners or box_corners(half)
    sides = (0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)
    return "\n".join(fan(*(c[i] for i in side)) for side in sides)


def placed(shape, *transforms):
    return "\n".join(("AttributeBegin", *transforms, shape, "AttributeEnd"))


def ball(radius, x=0, y=0, z=0, before=""):
    return placed(f'{before}\nShape "sphere" "float radius" {radius!r}',
                  f"Translate {x!r} {y!r} {z!r}")


def disk_down(radius, x, y, before=""):
    return placed(f'{before}\nShape "disk" "float radius" {radius!r}',
                  f"Translate {x!r} {y!r} 0", "Rotate 90 1 0 0")


def diffuse(albedo):
    return f'Material "diffuse" {grey("rgb", "reflectance", albedo)}'


def emits(radiance, more=""):
    """What follows is a black light until the attribute ends"""
    return f'{diffuse(0)}\nAreaLightSource "diffuse" {grey("rgb", "L", radiance)} {more}'


def light(shape, radiance=1, more=""):
    return f"AttributeBegin\n{emits(radiance, more)}\n{shape}\nAttributeEnd"


def sky(radiance=1):
    return f'LightSource "infinite" {grey("rgb", "L", radiance)}'


def floor(albedo=0.5, half=1):
    return f"{diffuse(albedo)}\n{level(-half, half, -half, half)}"


def scene(camera, *world, size=16, pixel_filter='"box"', depth=None):
    film = f'Film "rgb" "integer xresolution" {size} "integer yresolution" {size}'
    integrator = 'Integrator "path"' + ("" if depth is None else f' "integer maxdepth" {depth}')
    return "\n".join((camera, film, f"PixelFilter {pixel_filter}", 'Sampler "sobol"', integrator,
                      "WorldBegin", *world, ""))


# --- Rows -------------------------------------------------------------------------------------

ROWS = []


class Row:
    """`value` is the closed form. `bug`: the scene is wrong, and the check has to notice.
    `flat`: so must be every pixel, without noise. `bound`: the value may not be exceeded, nor be
    missed by more than a tenth."""

    def __init__(self, name, text, value, bug=False, spp=128, flat=False, bound=False, workers=1,
                 depth_limited=False):
        self.name, self.text, self.value, self.bug = name, text, value, bug
        self.spp, self.workers, self.depth_limited = spp, workers, depth_limited
        self.flat, self.bound = flat, bound


def row(name, text, value, **more):
    ROWS.append(Row(name, text, value, **more))


def bug(name, text, value, **more):
    row("bug: " + name, text, value, bug=True, **more)


def furnaces():
    """Every surface emits 1 and reflects the albedo: the lecture's geometric series"""
    inside = f'{look((0, 0, 0), (1, .3, .2))}\nCamera "perspective" "float fov" 90'

    def closed(albedo, shape, view=inside, **more):
        walls = f'{diffuse(albedo)}\nAreaLightSource "diffuse" {grey("rgb", "L", 1)}'
        return scene(view, walls, shape, **more)

    hollow = 'ReverseOrientation\nShape "sphere"'
    for albedo, spp in (.5, 128), (.8, 256), (.9, 1024):
        row(f"furnace box {albedo}", closed(albedo, box()), furnace(albedo), spp=spp)
    for albedo, spp, size in (.5, 128, 16), (.8, 256, 16), (.99, 1024, 24):
        row(f"furnace sphere {albedo}", closed(albedo, hollow, size=size), furnace(albedo),
            spp=spp, workers=2)
    # A million away: scenes are re-centred when they are read
    far = 1e6, -1e6, 5e5
    corners = [tuple(c + o for c, o in zip(corner, far)) for corner in box_corners()]
    row("furnace box .5 a million away",
        closed(.5, box(corners=corners),
               view=f'{look(far, [a + b for a, b in zip(far, (1, .3, .2))])}\n'
                    'Camera "perspective" "float fov" 90'), 2)
    row("furnace box .9 of depth 5", closed(.9, box(), depth=5), furnace(.9, 5), spp=256,
        depth_limited=True)
    row("furnace through a mitchell filter", closed(.5, box(), pixel_filter='"mitchell"'), 2,
        spp=128)
    bug("furnace .9 cut at depth 40", closed(.9, box(), depth=40), 10, spp=1024,
        depth_limited=True)
    bug("furnace of depth 5 cut at 4", closed(.9, box(), depth=4), furnace(.9, 5), spp=256,
        depth_limited=True)
    bug("furnace albedo off by .01", closed(.81, box()), furnace(.8), spp=256)
    bug("furnace with a wall missing", closed(.5, box().rsplit("\n", 1)[0]), 2)


# Of nori's scenes/pa5/tests, by their corners: seen from the origin under the normal +y
TRIANGLES = (
    ((-0.443432, 0.596366, 0.495985), (-0.320397, 0.0677699, -0.229359),
     (0.0341197, 0.11415, -0.343049)),
    ((0.461963, 0.397843, 0.412747), (-0.0381582, 0.851323, -0.156872),
     (0.195443, 0.891957, -0.260672)),
    ((0.100871, 0.289075, -0.422609), (-0.308386, 0.629587, 0.423966),
     (-0.373132, 0.237287, 0.351592)),
    ((-0.17575, 0.639397, 0.151268), (0.318604, 0.732996, 0.459771),
     (0.139095, 0.294498, 0.478556)),
    ((-0.17487, 0.447916, 0.367201), (-0.405259, 0.249607, -0.354079),
     (0.356029, 0.0918984, -0.132271)),
)
TRIANGLE_VALUES = 0.08983925852, 0.02292004042, 0.05341954023, 0.02053139149, 0.2617398589


def triangles():
    for number, (corners, value) in enumerate(zip(TRIANGLES, TRIANGLE_VALUES), 1):
        a, b, c = corners
        normal = cross([y - x for x, y in zip(a, b)], [y - x for x, y in zip(a, c)])
        towards, away = ((a, b, c), (a, c, b)) if dot(normal, a) < 0 else ((a, c, b), (a, b, c))
        assert abs(.5 * polygon(list(corners)) - value) < 1e-9
        row(f"triangle light {number}", scene(looking_down(), floor(), light(fan(*towards))), value)
        if number == 1:
            bug("triangle light of the wrong side",
                scene(looking_down(), floor(), light(fan(*away))), value)
            bug("triangle light 2 % too bright",
                scene(looking_down(), floor(), light(fan(*towards), 1.02)), value)
            bug("triangle light with a corner off by .02",
                scene(looking_down(), floor(), light(fan(towards[0], towards[1], tuple(
                    x + .02 for x in towards[2])))), value)


def spheres():
    def lit(distance, cos_theta, radius=1, radiance=1., more="", height=1e-3, half_width=1e-4):
        x, y = distance * sqrt(1 - cos_theta ** 2), distance * cos_theta
        return scene(looking_down(height, half_width), floor(half=.01),
                     light(ball(radius, x, y), radiance, more))

    for cos_theta, spp in (1, 128), (.6, 128), (.3, 128), (0, 256), (-.3, 1024):
        row(f"sphere light at 2, cos {cos_theta}", lit(2, cos_theta),
            .5 * sphere_light(1, 2, cos_theta), spp=spp)
    for distance, cos_theta in (1.05, 1), (5, .7), (100, .7), (1e3, .7):
        row(f"sphere light at {distance}, cos {cos_theta}",
            lit(distance, cos_theta, radiance=distance ** 2),
            .5 * distance ** 2 * sphere_light(1, distance, cos_theta))
    row("sphere light of radius 1e-4 of its distance", lit(1000, .7, radius=.1, radiance=1e8), .35)
    # Shadow rays shorter than the rounding error of what they end on
    for distance, cos_theta in (1.01, 0), (1.001, 0), (1.0001, 0), (1.0001, 1):
        row(f"sphere light almost touching at {distance}, cos {cos_theta}",
            lit(distance, cos_theta, height=1e-5, half_width=5e-6),
            .5 * sphere_light(1, distance, cos_theta))
    bug("sphere light 2 % too bright", lit(2, .3, radiance=1.02), .5 * sphere_light(1, 2, .3))
    bug("sphere light 1 % too large", lit(2, 1, radius=1.01), .125)
    bug("sphere light as if the horizon cut nothing", lit(2, .3), .5 * .25 * .3)
    bug("sphere light that shines inwards", lit(2, .6, more="\nReverseOrientation"), .075)


def rectangles():
    over = window((.5, .5, .5), (.5, 0, .5), .5)
    receiver = f"{diffuse(.5)}\n{level(0, 1, 0, 1)}"
    wall = fan((0, 0, 0), (0, 1, 0), (0, 1, 1), (0, 0, 1))
    parallel = .5 * parallel_rectangles(1, 1, 1)
    row("parallel squares", scene(over, receiver, light(ceiling(0, 1, 0, 1, 1))), parallel)
    row("parallel squares .1 apart",
        scene(window((.5, .05, .5), (.5, 0, .5), .5), receiver, light(ceiling(0, 1, 0, 1, .1))),
        .5 * parallel_rectangles(1, 1, .1))
    row("perpendicular squares", scene(over, receiver, light(wall)),
        .5 * perpendicular_rectangles(1, 1))
    row("square above a point", scene(looking_down(), floor(half=.1),
                                      light(ceiling(-.5, .5, -.5, .5, 1))),
        2 * point_under_corner(.5, .5, 1))
    row("wall beside a point",
        scene(looking_down(), floor(half=.1),
              light(fan((.5, 0, 0), (.5, 0, 2), (.5, 1, 2), (.5, 1, 0)))),
        .5 * point_beside_wall(1, 2, .5))
    # Its ends are almost opposite each other, seen from the receiver
    for distance, end in (.1, 1), (.1, 1e3), (.01, 100), (.001, 1), (.001, 10), (.001, 1e3):
        row(f"wall {distance} beside a point and {2 * end:g} long",
            scene(looking_down(half_width=distance / 100), floor(half=distance / 10),
                  light(fan((distance, 0, -end), (distance, 0, end), (distance, 1, end),
                            (distance, 1, -end)))),
            point_beside_wall(1, end, distance), spp=512)
    bug("parallel squares .01 too far apart",
        scene(over, receiver, light(ceiling(0, 1, 0, 1, 1.01))), parallel)
    bug("perpendicular squares, the light facing away",
        scene(over, receiver, light("ReverseOrientation\n" + wall)),
        .5 * perpendicular_rectangles(1, 1))

    # Both sides of a two-sided light, and the back of a one-sided one
    back = level(-.5, .5, -.5, .5, 1)
    lit = 2 * point_under_corner(.5, .5, 1)
    row("two-sided light, its back",
        scene(looking_down(), floor(half=.1), light(back, 1, '"bool twosided" true')), lit)
    row("two-sided light, its front",
        scene(looking_down(), floor(half=.1),
              light(ceiling(-.5, .5, -.5, .5, 1), 1, '"bool twosided" true')), lit)
    bug("the back of a one-sided light", scene(looking_down(), floor(half=.1), light(back)), lit)
    row("one-sided light seen from behind",
        scene(window((0, 2, 0), (0, 1, 0), .1), light(ceiling(-1, 1, -1, 1, 1))), 0, flat=True)
    for distance in 1e-2, 1, 1e4:
        row(f"emitter seen directly from {distance}",
            scene(window((0, 1 + distance, 0), (0, 1, 0), .1), light(level(-1, 1, -1, 1, 1), 3)),
            3, flat=True)


def disks():
    row("disk on axis", scene(looking_down(), floor(half=.1), light(disk_down(1, 0, 1))), .25)
    row("disk off axis", scene(looking_down(), floor(half=.1), light(disk_down(1, 1, 1))),
        .5 * disk_off_axis(1, 1, 1))
    row("disk far off axis, grazing",
        scene(looking_down(), floor(half=.1), light(disk_down(.5, 4, .2), 100)),
        50 * disk_off_axis(.5, .2, 4))
    row("coaxial disks",
        scene(window((0, .5, 0), (0, 0, 0), 1), diffuse(.5),
              placed('Shape "disk"', "Rotate -90 1 0 0"), light(disk_down(1, 0, 1)), size=32),
        .5 * pi / 4 * coaxial_disks(1, 1))
    bug("disk 2 % too bright",
        scene(looking_down(), floor(half=.1), light(disk_down(1, 1, 1), 1.02)),
        .5 * disk_off_axis(1, 1, 1))
    bug("disk off axis by 1.01",
        scene(looking_down(), floor(half=.1), light(disk_down(1, 1.01, 1))),
        .5 * disk_off_axis(1, 1, 1))


def delta_lights():
    """No noise but the pixel's own"""
    def lit(*text):
        return scene(looking_down(), floor(half=.01), *text)

    def point(x, y, z, intensity=1, more=""):
        return f'LightSource "point" {grey("rgb", "I", intensity)} ' \
               f'"point3 from" {numbers((x, y, z))} {more}'

    def spot(x, y, to_x, more=""):
        return f'LightSource "spot" {grey("rgb", "I", 1)} "point3 from" {numbers((x, y, 0))} ' \
               f'"point3 to" {numbers((to_x, 0, 0))} "float coneangle" 30 ' \
               f'"float conedeltaangle" 10 {more}'

    def distant(degrees, more=""):
        a = radians(degrees)
        return f'LightSource "distant" {grey("rgb", "L", 1)} ' \
               f'"point3 from" {numbers((sin(a), cos(a), 0))} "point3 to" [ 0 0 0 ] {more}'

    for distance in .1, 1, 2, 100:
        row(f"point light at {distance}", lit(point(0, distance, 0)), .5 / pi / distance ** 2)
    row("point light aslant", lit(point(1, 1, 1)), .5 / pi / 3 ** 1.5)
    row("point light by its power", lit(point(0, 1, 0, more='"float power" 5')),
        .5 / pi * 5 / (4 * pi))
    for degrees in 0, 60, 85:
        row(f"distant light at {degrees} degrees", lit(distant(degrees)),
            .5 / pi * cos(radians(degrees)))
    # Off its axis a spot light follows a smoothstep over the cosine, from 30 degrees to 20
    start, end = cos(radians(20)), cos(radians(30))
    t = (cos(radians(25)) - end) / (start - end)
    row("spot light on its axis", lit(spot(0, 2, 0)), .5 / pi / 4)
    row("spot light in its falloff", lit(spot(0, 2, 2 * tan(radians(25)))),
        .5 / pi / 4 * t * t * (3 - 2 * t))
    row("spot light outside its cone", lit(spot(0, 2, 2 * tan(radians(30.1)))), 0, flat=True)
    bug("point light 1 % too far", lit(point(0, 2.02, 0)), .5 / pi / 4)
    bug("distant light at 61 degrees", lit(distant(61)), .25 / pi)
    bug("spot light wider by a degree",
        lit(spot(0, 2, 2 * tan(radians(25))).replace("coneangle\" 30", "coneangle\" 31")),
        .5 / pi / 4 * t * t * (3 - 2 * t))

    # A diffuse sphere around a point light: the first bounce varies, all later ones do not
    def inside(x, y, z, *text, depth=None):
        eye = tuple(.999 * c for c in (x, y, z))
        return scene(window(eye, (x, y, z), 1e-4, (.1, 1, .2)), diffuse(.5), 'Shape "sphere"',
                     *text, depth=depth)

    high = point(0, 0, .5)
    for name, place, direct in (("north", (0, 0, 1), 4), ("equator", (1, 0, 0), 1.25 ** -1.5),
                                ("south", (0, 0, -1), 1.5 ** -2)):
        row(f"light in a sphere, its {name}", inside(*place, high), .5 / pi * (direct + 1), spp=512)
    row("light in the middle of a sphere, depth 8", inside(1, 0, 0, point(0, 0, 0, pi), depth=8),
        1 - 2 ** -8, spp=512, depth_limited=True)
    bug("light in a sphere, lost after depth 4", inside(1, 0, 0, high, depth=4),
        .5 / pi * (1.25 ** -1.5 + 1), spp=512, depth_limited=True)

    # The picture's corners see nothing
    row("ball lit head-on, over the picture",
        scene(window((0, 0, 3), (0, 0, 0), 1, (0, 1, 0)), diffuse(.5), 'Shape "sphere"',
              f'LightSource "distant" {grey("rgb", "L", 1)} "point3 from" [ 0 0 1 ] '
              '"point3 to" [ 0 0 0 ]', size=32), .5 / pi * 2 / 3 * pi / 4)


def skies():
    """Under a uniform sky of 1 the picture is the albedo"""
    def plane(*text, cos_theta=1., **more):
        eye = (sqrt(1 - cos_theta ** 2), cos_theta, 0)
        return scene(window(eye, (0, 0, 0), .1), sky(), *text, level(-9, 9, -9, 9), **more)

    def around(*text, **more):
        return scene(f'{look((0, 0, 4), (0, 0, 0), (0, 1, 0))}\nCamera "perspective" '
                     '"float fov" 40', sky(), *text, **more)

    glass = 'Material "dielectric"'
    for albedo in .2, .8, 1:
        row(f"diffuse plane {albedo} under a sky", plane(diffuse(albedo)), albedo)
    bug("diffuse plane .8 painted .81", plane(diffuse(.81)), .8)

    mixture = f'Material "mixture" {grey("rgb", "diffuse", .3)} {grey("rgb", "specular", .4)}'
    row("mixture of .3 diffuse and .4 mirror", plane(mixture), .7)
    row("mixture seen aslant", plane(mixture, cos_theta=.2), .7)
    row("mixture that is black", plane(mixture.replace(".3", "0").replace(".4", "0")), 0, flat=True)
    bug("mixture with .41 of mirror", plane(mixture.replace("0.4", "0.41")), .7)
    mix = "\n".join(
        f'MakeNamedMaterial "{name}" "string type" "diffuse" {grey("rgb", "reflectance", value)}'
        for name, value in (("dark", .2), ("light", .8)))
    mix += '\nMaterial "mix" "string materials" [ "dark" "light" ] "float amount" .25'
    row("mix of a quarter .8 and the rest .2", plane(mix), .35)
    bug("mix of .26", plane(mix.replace("amount\" .25", "amount\" .26")), .35)

    metal = f'Material "conductor" {grey("rgb", "eta", .2)} {grey("rgb", "k", 3.9)}'
    for cos_theta in 1., cos(radians(45)), cos(radians(80)):
        row(f"smooth metal, cos {cos_theta:.3f}", plane(metal, cos_theta=cos_theta),
            fresnel_metal(cos_theta, .2, 3.9), flat=True)
    bug("smooth metal of another k", plane(metal.replace("3.9", "3.8")),
        fresnel_metal(1, .2, 3.9), flat=True)
    # GGX reflects once and loses the rest (quadrature in NUMERICS section 3)
    for alpha, cos_theta, value in ((.1, .7, .98142), (.25, 1., .91582), (.5, .3, .74527),
                                    (1., 1., 1 - log(2)), (1., .7, .37889)):
        rough = f'Material "conductor" {grey("rgb", "reflectance", 1)} "float roughness" {alpha} ' \
                '"bool remaproughness" false'
        row(f"rough mirror, alpha {alpha}, cos {cos_theta}", plane(rough, cos_theta=cos_theta),
            .9999 * value, spp=256)
    bug("rough mirror, alpha .5 for .45",
        plane(rough.replace("roughness\" 1.0", "roughness\" 0.45"), cos_theta=.3), .74527, spp=256)

    coat = 'Material "coateddiffuse" "float roughness" 0 "float thickness" 0 '
    for albedo, cos_theta in (.5, 1.), (.5, .3), (1., 1.):
        row(f"coat over {albedo}, cos {cos_theta}",
            plane(coat + grey("rgb", "reflectance", albedo), cos_theta=cos_theta),
            smooth_coat(cos_theta, albedo), spp=256)
    row("rough coat over white returns no more than it gets",
        plane('Material "coateddiffuse" "float roughness" .001 "float thickness" 0 '
              + grey("rgb", "reflectance", 1)), 1, bound=True, spp=256)
    bug("coat over .52 for .5", plane(coat + grey("rgb", "reflectance", .52)),
        smooth_coat(1, .5), spp=256)

    row("glass ball under a uniform sky is invisible", around(glass, 'Shape "sphere"'), 1,
        flat=True)
    row("glass ball of index 1", around(glass + ' "float eta" 1', 'Shape "sphere"'), 1, flat=True)
    row("glass box under a uniform sky is invisible", around(glass, "Rotate 30 1 2 3",
                                                             "ReverseOrientation", box(.7)), 1)
    row("lens under a uniform sky",
        scene(f'{look((0, 0, 4), (0, 0, 0), (0, 1, 0))}\nCamera "perspective" "float fov" 40 '
              '"float lensradius" .5 "float focaldistance" 3', sky()), 1, flat=True)
    row("camera inside glass",
        scene(f'{look((0, 0, 0), (0, 0, 1), (0, 1, 0))}\nCamera "perspective" "float fov" 20',
              sky(), glass, 'Shape "sphere"'), 2.25)
    bug("glass ball with a grey speck in it",
        around(glass, 'Shape "sphere"', diffuse(.5), ball(.2)), 1, flat=True)


def slabs():
    """A light behind a pane, and one behind the camera: (1-R)/(1+R) and 2R/(1+R)"""
    def pane(light_z, eta=1.5):
        def wall(z, facing):
            corners = (-9, -9, z), (9, -9, z), (9, 9, z), (-9, 9, z)
            return fan(*corners[::facing])
        return scene(window((0, 0, 0), (0, 0, 1), .1, (0, 1, 0)),
                     f'Material "dielectric" "float eta" {eta}', wall(1, -1), wall(2, 1),
                     light(wall(light_z, -1 if light_z > 0 else 1)))

    r = fresnel(1, 1.5)
    row("through a pane", pane(3), (1 - r) / (1 + r), spp=256)
    row("reflected by a pane", pane(-1), 2 * r / (1 + r), spp=1024)
    bug("through a pane of index 1.6", pane(3, 1.6), (1 - r) / (1 + r), spp=256)


def media():
    def medium(name, absorbed, scattered, more=""):
        return f'MakeNamedMedium "{name}" "string type" "homogeneous" ' \
               f'{grey("rgb", "sigma_a", absorbed)} {grey("rgb", "sigma_s", scattered)} {more}'

    def through(*world, fov=.01):
        return scene(f'{look((0, 0, 4), (0, 0, 0), (0, 1, 0))}\nCamera "perspective" '
                     f'"float fov" {fov}', *world)

    inside = 'MediumInterface "fog" ""'
    nothing = f'{inside}\nMaterial "interface"\nShape "sphere"'
    row("sky through a ball that absorbs", through(medium("fog", .5, 0), sky(), nothing), exp(-1),
        flat=True)
    row("ball that glows", through(medium("fog", .5, 0, grey("rgb", "Le", 3)), nothing),
        3 * (1 - exp(-1)), flat=True)
    for g in 0, .8, -.8:
        fog = medium("fog", 0, 2, f'"float g" {g}')
        row(f"fog of g {g} under a uniform sky is invisible", through(fog, sky(), nothing, fov=40),
            1, spp=256)
    row("fog in glass under a uniform sky is invisible",
        through(medium("fog", 0, 1), sky(), inside, 'Material "dielectric"', 'Shape "sphere"',
                fov=40), 1, spp=256)
    bug("fog under a uniform sky that absorbs 1 %",
        through(medium("fog", .02, 2), sky(), nothing, fov=.01), 1, spp=512)

    # A light over a floor, and everything in the medium; the camera looks down from 2 beside it
    def lit(absorbed):
        return "\n".join(('MediumInterface "" "fog"', window((0, 2, 0), (0, 0, 0), 1e-4), "")) \
            + scene("", 'MediumInterface ""', medium("fog", absorbed, 0), floor(half=.01),
                    f'LightSource "point" {grey("rgb", "I", 1)} "point3 from" [ 0 1 0 ]')

    row("point light in a medium without end", lit(.3), .5 / pi * exp(-.9))
    bug("point light in a medium of .31", lit(.31), .5 / pi * exp(-.9))


def filters():
    for name in '"box"', '"triangle"', '"gaussian"', '"mitchell"', \
                '"mitchell" "float B" 0 "float C" .75', '"sinc"', '"sinc" "float tau" 1000':
        row(f"sky through {name}", scene(looking_down(), sky(), pixel_filter=name), 1, flat=True)
    bug("half a sky through mitchell",
        scene(window((0, 1, 0), (0, 0, 0), 1), sky(), diffuse(.9), level(-2, 0, -2, 2),
              pixel_filter='"mitchell"'), 1, flat=True)


# --- Rendering and judging --------------------------------------------------------------------

class Unfit(Exception):
    """Something went wrong that no row, planted bug or not, may have"""


def run(*arguments):
    done = subprocess.run(arguments, capture_output=True, text=True, timeout=300)
    if done.returncode != 0:
        raise Unfit(f"{' '.join(arguments)}: status {done.returncode}\n{done.stderr}")
    return done.stdout


def render(this, folder, number):
    """The blocks of the picture: one of the whole, or one of each pixel"""
    stem = os.path.join(folder, str(number))
    with open(stem + ".pbrt", "w", encoding="ascii") as file:
        file.write(this.text)
    run(f"{BIN}/pathfarm", "render", stem + ".pbrt", "-o", stem + ".exr", "--report",
        stem + ".json", "--spp", str(this.spp), "--replicates", str(REPLICATES), "--seed",
        str(SEED), "--workers", str(this.workers), "--threads", "1", "--no-cache", "--quiet")
    with open(stem + ".json", encoding="ascii") as file:
        report = json.load(file)
    if report["replicates"] < REPLICATES:
        raise Unfit(f"only {report['replicates']} replicates")
    if any(report["nonfinite_samples"].values()):
        raise Unfit(f"samples that are not finite: {report['nonfinite_samples']}")
    if report["truncated"]["paths"] > 0 and not this.depth_limited:
        raise Unfit(f"{report['truncated']['paths']} paths were cut")
    blocks = json.loads(run(f"{BIN}/pathfarm", "compare", "--json", "--blocks",
                            "1" if this.flat else "65536", stem + ".exr", stem + ".exr"))["blocks"]
    return [(block["luminance_a"], block["stderr_a"]) for block in blocks]


def agrees(this, value, blocks):
    """The check itself"""
    for mean, stderr in blocks:
        slack = ROUNDING * max(abs(value), 1e-3) + (0 if this.flat else 4 * stderr)
        if not abs(mean - value) <= slack and not (this.bound and .9 * value <= mean <= value):
            return False
    return True


def judge(this, folder, number):
    """What is wrong with the row, or None, and a line about it"""
    try:
        blocks = render(this, folder, number)
    except Unfit as unfit:
        return str(unfit), this.name
    mean = sum(block[0] for block in blocks) / len(blocks)
    stderr = sqrt(sum(block[1] ** 2 for block in blocks)) / len(blocks)
    sigmas = f"{(mean - this.value) / stderr:+.2f} standard errors" if stderr > 0 else "no noise"
    line = f"{this.name}: {mean:.9g}, closed form {this.value:.9g}, {sigmas} of {stderr:.2g}"
    if this.bug:
        noticed = not agrees(this, this.value, blocks)
        return (None if noticed else "the planted bug was not noticed"), line
    if not agrees(this, this.value, blocks):
        return "it differs from the closed form", line
    powerless = any(agrees(this, factor * this.value, blocks) for factor in (.98, 1.02))
    if powerless and this.value != 0 and not this.bound:
        return "too noisy to notice 2 %", line
    return None, line


def main():
    for family in (furnaces, triangles, spheres, rectangles, disks, delta_lights, skies, slabs,
                   media, filters):
        family()
    chosen = [this for this in ROWS if all(word in this.name for word in sys.argv[1:])]
    failures = 0
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(2) as pool:
        jobs = [pool.submit(judge, this, folder, i) for i, this in enumerate(chosen)]
        for job in jobs:
            wrong, line = job.result()
            failures += wrong is not None
            print(line if wrong is None else f"FAILED: {line}\n    {wrong}", flush=True)
    planted = sum(this.bug for this in chosen)
    print(f"{len(chosen) - planted} closed forms, {planted} planted bugs, {failures} failures")
    return 1 if failures or not chosen else 0


if __name__ == "__main__":
    sys.exit(main())
