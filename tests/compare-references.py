#!/usr/bin/env python3
"""Compare renders with the reference pictures of Cycles and pbrt-v4, block by block.

Renders each scene (or takes NAME.exr from --images), lets `pathfarm compare` average the luminance
of 16x16 blocks, and prints a line per scene with a verdict, and its worst blocks. Four standard
errors of the difference are allowed on top of every limit; the reference's noise is not known and
is estimated by scaling ours to its samples per pixel.

The programs are taken from $PATHFARM_BIN, scenes and references from $PATHFARM_SHARED. The three
comparison scenes are made by its peers/gen_scenes.py, which needs numpy (Debian: python3-numpy).
Exit status: 0 all agree, 1 some do not, 2 nothing could be compared.
"""
import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile

ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
SHARED = os.environ.get("PATHFARM_SHARED", os.path.join(ROOT, "..", "shared"))
BIN = os.environ.get("PATHFARM_BIN", os.path.join(ROOT, "build", "release", "bin"))
BLOCK = 16
SIGMAS = 4

# name: scene file (None: generated), reference, its spp, width, height
SCENES = {
    "cornell": (None, "cycles-cornell.exr", 4096, 256, 256),
    "lights": (None, "cycles-lights.exr", 1024, 256, 256),
    "mesh": (None, "cycles-mesh.exr", 1024, 256, 256),
    "cornell-box": ("scenes/cornell-box/_ref_cornell-box.pbrt", "cornell-box.exr", 2048, 256, 256),
    "material-testball": ("scenes/material-testball/_ref_material-testball.pbrt",
                          "material-testball.exr", 512, 320, 180),
    "bmw-m6": ("scenes/bmw-m6/_ref_bmw-m6.pbrt", "bmw-m6.exr", 256, 320, 229),
    "veach-mis": ("scenes/veach-mis-pbrt/_ref_veach-mis.pbrt", "veach-mis.exr", 256, 320, 240),
}
# Cycles is an RGB renderer: every block must agree. But version 3.4 samples large triangle lights
# by a solid angle summed from approximate arc cosines: on the upper walls of `cornell` and `mesh`
# 1 to 4 % of the direct light are missing. With their panel cut into 16x16 quads, which it samples
# by area, it agrees with closed forms and with us; --references takes pictures made like that.
EVERY_BLOCK = {"cornell": 0.02, "lights": 0.04, "mesh": 0.02}
# pbrt-v4 is spectral, so saturated colours differ: the mean, the median and 95 % of the blocks.
MEAN, MEDIAN, MOST = 0.01, 0.015, 0.10
# So do real scenes, with textures, environments and pbrt's stochastic coats: a little more.
REAL = {"material-testball", "bmw-m6"}
REAL_MEAN, REAL_MEDIAN, REAL_MOST = 0.015, 0.02, 0.10


class Failed(Exception):
    pass


def run(command, **options):
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
                          **options)
    if done.returncode != 0:
        raise Failed("%s: status %d\n%s" % (" ".join(command), done.returncode, done.stderr))
    return done.stdout


def python_with_numpy():
    for python in (sys.executable, "/usr/bin/python3"):
        if subprocess.run([python, "-c", "import numpy"],
                          stderr=subprocess.DEVNULL).returncode == 0:
            return python
    return None


def generate(folder):
    """The comparison scenes in `folder`, once; False without numpy."""
    if os.path.exists(os.path.join(folder, "mesh.pbrt")):
        return True
    python = python_with_numpy()
    if python is None:
        return False
    run([python, os.path.join(SHARED, "peers", "gen_scenes.py")], env=dict(os.environ, OUT=folder))
    return True


def percentile(values, share):
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, math.ceil(share * len(ordered)) - 1)]


def luminance(rgb):
    return 0.2126 * rgb[0] + 0.7152 * rgb[1] + 0.0722 * rgb[2]


class Block:
    """One block's relative difference, and what of it noise does not explain."""

    def __init__(self, found, noise_scale):
        self.x, self.y = found["x"], found["y"]
        self.ours, self.theirs = found["luminance_a"], found["luminance_b"]
        stderr = found["stderr_a"]
        if stderr is None:
            raise Failed("no standard error in our picture (too few samples per pixel?)")
        self.pixels = found["pixels"]
        self.stderr = math.hypot(stderr, stderr * noise_scale)
        base = max(self.theirs, 1e-6)
        self.difference = (self.ours - self.theirs) / base
        self.allowance = SIGMAS * self.stderr / base
        self.excess = max(0.0, abs(self.difference) - self.allowance)


def judge(name, image, spp_of_reference, reference):
    """Print what was found; true when it is within the limits."""
    found = json.loads(run([os.path.join(BIN, "pathfarm"), "compare", "--json", "--blocks",
                            str(BLOCK), image, reference]))
    spp = samples(image)
    blocks = [Block(b, math.sqrt(spp / spp_of_reference)) for b in found["blocks"] if b["pixels"]]
    pixels = sum(b.pixels for b in blocks)
    ours, theirs = luminance(found["mean_a"]), luminance(found["mean_b"])
    mean = ours / theirs - 1
    mean_stderr = math.sqrt(sum((b.stderr * b.pixels) ** 2 for b in blocks)) / pixels / theirs
    raw = [abs(b.difference) for b in blocks]
    excess = [b.excess for b in blocks]

    if name in EVERY_BLOCK:
        limits = [("every block", max(excess), EVERY_BLOCK[name])]
    else:
        real = name in REAL
        limits = [("image mean", max(0.0, abs(mean) - SIGMAS * mean_stderr),
                   REAL_MEAN if real else MEAN),
                  ("median block", statistics.median(excess), REAL_MEDIAN if real else MEDIAN),
                  ("95 % of blocks", percentile(excess, 0.95), REAL_MOST if real else MOST)]
    agrees = all(value <= limit for _, value, limit in limits) and not found["nonfinite_a"]
    print("%-12s %5d spp  mean %+.2f %% (R %+.2f G %+.2f B %+.2f, standard error %.2f)  "
          "blocks: median %.2f %%, 95th %.2f %%, largest %.2f %%, median standard error %.2f %%" %
          (name, spp, 100 * mean, *(100 * (a / b - 1) for a, b in
                                    zip(found["mean_a"], found["mean_b"])), 100 * mean_stderr,
           100 * statistics.median(raw), 100 * percentile(raw, 0.95), 100 * max(raw),
           100 * statistics.median(b.allowance / SIGMAS for b in blocks)))
    for what, value, limit in limits:
        print("    %-14s %6.2f %% beyond noise, limit %.1f %%%s" %
              (what, 100 * value, 100 * limit, "" if value <= limit else "   MISSED"))
    if found["nonfinite_a"]:
        print("    %d pixels are not finite   MISSED" % found["nonfinite_a"])
    for b in sorted(blocks, key=lambda b: (-b.excess, -abs(b.difference)))[:5]:
        print("    block at %3d,%3d: %.5g, reference %.5g, %+.2f %% (allowed for noise %.2f %%)" %
              (b.x, b.y, b.ours, b.theirs, 100 * b.difference, 100 * b.allowance))
    print("    %s" % ("agrees" if agrees else "DOES NOT AGREE"))
    sys.stdout.flush()
    return agrees


def samples(image):
    """Samples per pixel of a picture of ours, from its own layer."""
    found = json.loads(run([os.path.join(BIN, "pathfarm"), "compare", "--json", "--channels",
                            "samples", image, image]))
    return round(found["mean_a"][0])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="*", metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--spp", type=int, default=1024, help="samples per pixel (1024)")
    parser.add_argument("--images", metavar="DIR",
                        help="take NAME.exr from here where it exists, else put it here")
    parser.add_argument("--references", metavar="DIR",
                        help="take references from here, and only the scenes that have one")
    parser.add_argument("--reference-spp", type=int, metavar="N", help="their samples per pixel")
    parser.add_argument("--generated", metavar="DIR", help="where the generated scenes are or go")
    arguments = parser.parse_args()
    names = arguments.scene or list(SCENES)
    unknown = [n for n in names if n not in SCENES]
    if unknown:
        parser.error("no scene %s; there are %s" % (", ".join(unknown), ", ".join(SCENES)))
    references = arguments.references or os.path.join(SHARED, "references")
    if not os.path.isdir(references):
        print("no references in %s; set PATHFARM_SHARED" % references, file=sys.stderr)
        return 2

    missed, compared = [], 0
    with tempfile.TemporaryDirectory() as work:
        images = arguments.images or work
        generated = arguments.generated or work
        os.makedirs(images, exist_ok=True)
        os.makedirs(generated, exist_ok=True)
        for name in names:
            scene, reference, spp, width, height = SCENES[name]
            reference = os.path.join(references, reference)
            if arguments.references and not os.path.exists(reference):
                continue
            image = os.path.join(images, name + ".exr")
            if not os.path.exists(image):
                if scene is None and not generate(generated):
                    print("%-12s skipped: gen_scenes.py needs numpy (apt install python3-numpy)" %
                          name)
                    continue
                path = (os.path.join(generated, name + ".pbrt") if scene is None
                        else os.path.join(SHARED, scene))
                run([os.path.join(BIN, "pathfarm"), "render", path, "-o", image, "--quiet",
                     "--spp", str(arguments.spp), "--resolution", "%dx%d" % (width, height)])
            compared += 1
            if not judge(name, image, arguments.reference_spp or spp, reference):
                missed.append(name)
    if compared == 0:
        print("nothing to compare", file=sys.stderr)
        return 2
    print("%d of %d scenes agree%s" % (compared - len(missed), compared,
                                       "; not " + ", ".join(missed) if missed else ""))
    return 1 if missed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Failed as failure:
        print(failure, file=sys.stderr)
        sys.exit(2)
