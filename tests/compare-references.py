#!/usr/bin/env python3
"""Compare renders with the reference pictures of Cycles and pbrt-v4, block by block.

Renders each scene (or takes NAME.exr from --images), lets `pathfarm compare` average the luminance
of 16x16 blocks, and prints the worst of these while it goes and one table at the end. Four standard
errors of the difference are allowed on top of every limit; the reference's noise is not known and
is estimated by scaling ours to its samples per pixel.

The programs are taken from $PATHFARM_BIN, scenes and references from $PATHFARM_SHARED. The three
comparison scenes are made by its peers/gen_scenes.py, which needs numpy (Debian: python3-numpy).
Exit status: 0 all agree, 1 some do not, 2 nothing could be compared.
"""
import argparse
import collections
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
FIREFLY = 10  # times its block's mean

Limits = collections.namedtuple("Limits", "mean median most every", defaults=[None] * 4)
# Cycles is an RGB renderer: every block must agree. But version 3.4 samples large triangle lights
# by a solid angle summed from approximate arc cosines: on the upper walls of `cornell` and `mesh`
# 1 to 4 % of the direct light are missing. With their panel cut into 16x16 quads, which it samples
# by area, it agrees with closed forms and with us; --references takes pictures made like that.
SAME = Limits(every=0.02)
SAME_NOISY = Limits(every=0.04)
# pbrt-v4 is spectral, so saturated colours differ: the mean, the median and 95 % of the blocks.
SPECTRAL = Limits(mean=0.01, median=0.015, most=0.10)
# So do real scenes, with textures, environments and pbrt's stochastic coats: a little more.
REAL = Limits(mean=0.015, median=0.02, most=0.10)

Scene = collections.namedtuple("Scene", "path reference spp width height limits")
GENERATED = None  # the path of what peers/gen_scenes.py makes
SCENES = {
    "cornell": Scene(GENERATED, "cycles-cornell.exr", 4096, 256, 256, SAME),
    "lights": Scene(GENERATED, "cycles-lights.exr", 1024, 256, 256, SAME_NOISY),
    "mesh": Scene(GENERATED, "cycles-mesh.exr", 1024, 256, 256, SAME),
    "cornell-box": Scene("cornell-box/_ref_cornell-box.pbrt", "cornell-box.exr", 2048, 256, 256,
                         SPECTRAL),
    "veach-mis": Scene("veach-mis-pbrt/_ref_veach-mis.pbrt", "veach-mis.exr", 256, 320, 240,
                       SPECTRAL),
    "material-testball": Scene("material-testball/_ref_material-testball.pbrt",
                               "material-testball.exr", 512, 320, 180, REAL),
    "bmw-m6": Scene("bmw-m6/_ref_bmw-m6.pbrt", "bmw-m6.exr", 256, 320, 229, REAL),
}


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


class Verdict:
    """What was found about one picture, and whether it is within its limits."""

    def __init__(self, name, image, spp_of_reference, reference):
        self.command = [os.path.join(BIN, "pathfarm"), "compare", "--json"]
        self.images = [image, reference]
        self.pixels = None
        found = json.loads(run(self.command + ["--blocks", str(BLOCK)] + self.images))
        self.name, self.spp = name, samples(image)
        scale = math.sqrt(self.spp / spp_of_reference)
        self.blocks = [Block(b, scale) for b in found["blocks"] if b["pixels"]]
        self.not_finite = found["nonfinite_a"]
        theirs = luminance(found["mean_b"])
        self.mean = luminance(found["mean_a"]) / theirs - 1
        self.colors = [a / b - 1 for a, b in zip(found["mean_a"], found["mean_b"])]
        pixels = sum(b.pixels for b in self.blocks)
        self.stderr = math.sqrt(sum((b.stderr * b.pixels) ** 2
                                    for b in self.blocks)) / pixels / theirs
        self.raw = [abs(b.difference) for b in self.blocks]
        excess = [b.excess for b in self.blocks]
        beyond = max(0.0, abs(self.mean) - SIGMAS * self.stderr)
        limits = SCENES[name].limits
        self.rows = [row for row in (
            ("image mean", beyond, limits.mean),
            ("median block", statistics.median(excess), limits.median),
            ("95 % of blocks", percentile(excess, 0.95), limits.most),
            ("every block", max(excess), limits.every)) if row[2] is not None]
        self.agrees = not self.not_finite and all(value <= limit for _, value, limit in self.rows)

    def explain(self, worst):
        print("%s: mean R %+.2f %% G %+.2f %% B %+.2f %%" %
              (self.name, *(100 * c for c in self.colors)))
        if self.not_finite:
            print("    %d pixels are not finite" % self.not_finite)
        for b in sorted(self.blocks, key=lambda b: (-b.excess, -abs(b.difference)))[:worst]:
            x, y, ours, theirs = self.brightest(b)
            share = (ours - theirs) / b.pixels / max(b.theirs, 1e-6)
            whose = "ours" if ours > theirs else "the reference"
            print("    block at %3d,%3d: %.5g, reference %.5g, %+.2f %% (%.2f %% may be noise)%s" %
                  (b.x, b.y, b.ours, b.theirs, 100 * b.difference, 100 * b.allowance,
                   "; %+.2f %% are a firefly of %s in %d,%d" % (100 * share, whose, x, y)
                   if max(ours, theirs) > FIREFLY * b.theirs else ""))
        sys.stdout.flush()

    def brightest(self, block):
        """The brightest pixel of a block in either picture: x, y, ours, theirs."""
        if self.pixels is None:
            found = json.loads(run(self.command + ["--blocks", "1"] + self.images))
            self.pixels = [(p["x"], p["y"], p["luminance_a"], p["luminance_b"])
                           for p in found["blocks"] if p["pixels"]]
        return max((p for p in self.pixels if 0 <= p[0] - block.x < BLOCK
                    and 0 <= p[1] - block.y < BLOCK), key=lambda p: max(p[2:]))

    def line(self):
        beyond = ", ".join("%s %.2f (%g)%s" % (what, 100 * value, 100 * limit,
                                               "" if value <= limit else " MISSED")
                           for what, value, limit in self.rows)
        noise = statistics.median(b.allowance / SIGMAS for b in self.blocks)
        return "%-17s %5d  %+6.2f +- %4.2f  %6.2f %6.2f %7.2f  %5.2f  %-9s %s" % (
            self.name, self.spp, 100 * self.mean, 100 * self.stderr,
            100 * statistics.median(self.raw), 100 * percentile(self.raw, 0.95),
            100 * max(self.raw), 100 * noise, "agrees" if self.agrees else "DIFFERS", beyond)


TABLE_HEAD = """
                              mean            blocks: difference   standard   in % beyond noise
scene               spp  difference  error  median   95th largest     error   (and its limit)"""


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
    parser.add_argument("--worst", type=int, default=5, metavar="N",
                        help="how many of the worst blocks are shown (5)")
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

    verdicts = []
    with tempfile.TemporaryDirectory() as work:
        images = arguments.images or work
        generated = arguments.generated or work
        os.makedirs(images, exist_ok=True)
        os.makedirs(generated, exist_ok=True)
        for name in names:
            scene = SCENES[name]
            reference = os.path.join(references, scene.reference)
            if arguments.references and not os.path.exists(reference):
                continue
            image = os.path.join(images, name + ".exr")
            if not os.path.exists(image):
                if scene.path is GENERATED and not generate(generated):
                    print("%s skipped: gen_scenes.py needs numpy (apt install python3-numpy)" %
                          name)
                    continue
                path = (os.path.join(generated, name + ".pbrt") if scene.path is GENERATED
                        else os.path.join(SHARED, "scenes", scene.path))
                run([os.path.join(BIN, "pathfarm"), "render", path, "-o", image, "--quiet", "--spp",
                     str(arguments.spp), "--resolution", "%dx%d" % (scene.width, scene.height)])
            verdict = Verdict(name, image, arguments.reference_spp or scene.spp, reference)
            verdict.explain(arguments.worst)
            verdicts.append(verdict)
    if not verdicts:
        print("nothing to compare", file=sys.stderr)
        return 2
    print(TABLE_HEAD)
    for verdict in verdicts:
        print(verdict.line())
    missed = [verdict.name for verdict in verdicts if not verdict.agrees]
    print("%d of %d scenes agree%s" % (len(verdicts) - len(missed), len(verdicts),
                                       "; not " + ", ".join(missed) if missed else ""))
    return 1 if missed else 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except Failed as failure:
        print(failure, file=sys.stderr)
        sys.exit(2)
