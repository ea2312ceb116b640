#include "worker/kernel/noise.h"

#include "common/elem.h"

#include <math.h>

static const uint8_t permutation[256] = {
    151, 160, 137, 91,  90,  15,  131, 13,  201, 95,  96,  53,  194, 233, 7,   225, 140, 36,  103,
    30,  69,  142, 8,   99,  37,  240, 21,  10,  23,  190, 6,   148, 247, 120, 234, 75,  0,   26,
    197, 62,  94,  252, 219, 203, 117, 35,  11,  32,  57,  177, 33,  88,  237, 149, 56,  87,  174,
    20,  125, 136, 171, 168, 68,  175, 74,  165, 71,  134, 139, 48,  27,  166, 77,  146, 158, 231,
    83,  111, 229, 122, 60,  211, 133, 230, 220, 105, 92,  41,  55,  46,  245, 40,  244, 102, 143,
    54,  65,  25,  63,  161, 1,   216, 80,  73,  209, 76,  132, 187, 208, 89,  18,  169, 200, 196,
    135, 130, 116, 188, 159, 86,  164, 100, 109, 198, 173, 186, 3,   64,  52,  217, 226, 250, 124,
    123, 5,   202, 38,  147, 118, 126, 255, 82,  85,  212, 207, 206, 59,  227, 47,  16,  58,  17,
    182, 189, 28,  42,  223, 183, 170, 213, 119, 248, 152, 2,   44,  154, 163, 70,  221, 153, 101,
    155, 167, 43,  172, 9,   129, 22,  39,  253, 19,  98,  108, 110, 79,  113, 224, 232, 178, 185,
    112, 104, 218, 246, 97,  228, 251, 34,  242, 193, 238, 210, 144, 12,  191, 179, 162, 241, 81,
    51,  145, 235, 249, 14,  239, 107, 49,  192, 214, 31,  181, 199, 106, 157, 184, 84,  204, 176,
    115, 121, 50,  45,  127, 4,   150, 254, 138, 236, 205, 93,  222, 114, 67,  29,  24,  72,  243,
    141, 128, 195, 78,  66,  215, 61,  156, 180,
};

/* One of twelve gradients towards the edges of a cube (four of them twice), times (x, y, z) */
static float gradient(unsigned hash, float x, float y, float z)
{
    unsigned h = hash & 15;
    float u = h < 8 || h == 12 || h == 13 ? x : y;
    float v = h < 4 || h == 12 || h == 13 ? y : z;
    return (h & 1 ? -u : u) + (h & 2 ? -v : v);
}

static float fade(float t)
{
    return t * t * t * (t * (t * 6 - 15) + 10);
}

static float between(float t, float a, float b)
{
    return (1 - t) * a + t * b;
}

/* The cell that x is in, modulo 256, and where in it. Not a number: the corner of cell 0. */
static unsigned cell_of(float x, float *inside)
{
    float whole = floorf(fmodf(x, 0x1p30f));
    *inside = fmodf(x, 0x1p30f) - whole;
    if (!(*inside >= 0)) {
        *inside = 0;
        return 0;
    }
    return (unsigned)(int32_t)whole & 255;
}

float noise_at(const float p[3])
{
    float d[3], corner[8];
    unsigned cell[3];
    for (int axis = 0; axis < 3; axis++)
        cell[axis] = cell_of(p[axis], &d[axis]);
    for (unsigned i = 0; i < 8; i++) {
        unsigned x = i & 1, y = i >> 1 & 1, z = i >> 2;
        unsigned hash = permutation[(cell[0] + x) & 255];
        hash = permutation[(hash + cell[1] + y) & 255];
        hash = permutation[(hash + cell[2] + z) & 255];
        corner[i] = gradient(hash, d[0] - (float)x, d[1] - (float)y, d[2] - (float)z);
    }
    float wx = fade(d[0]), wy = fade(d[1]), wz = fade(d[2]);
    float low = between(wy, between(wx, corner[0], corner[1]), between(wx, corner[2], corner[3]));
    float high = between(wy, between(wx, corner[4], corner[5]), between(wx, corner[6], corner[7]));
    return between(wz, low, high);
}

/* How many octaves are wider than twice the footprint */
static float octaves_seen(float width2, uint32_t octaves)
{
    float n = (float)octaves;
    if (width2 > 0) {
        float seen = (float)(-1 - elem_log((double)width2) * (0.5 / 0.6931471805599453));
        n = seen < n ? seen : n;
    }
    return n > 0 ? n : 0;
}

/* How much of the last octave, seen in part, is left */
static float partly(float share)
{
    float t = (share - 0.3f) / 0.4f;
    t = t > 0 ? (t < 1 ? t : 1) : 0;
    return t * t * (3 - 2 * t);
}

static float octave(const float p[3], float lambda)
{
    return noise_at((const float[3]){ lambda * p[0], lambda * p[1], lambda * p[2] });
}

float noise_fbm(const float p[3], float width2, float omega, uint32_t octaves)
{
    float n = octaves_seen(width2, octaves), sum = 0, lambda = 1, strength = 1;
    uint32_t whole = (uint32_t)n;
    for (uint32_t i = 0; i < whole; i++) {
        sum += strength * octave(p, lambda);
        lambda *= 1.99f;
        strength *= omega;
    }
    float share = partly(n - (float)whole);
    return share > 0 ? sum + strength * share * octave(p, lambda) : sum;
}

float noise_turbulence(const float p[3], float width2, float omega, uint32_t octaves)
{
    const float mean = 0.2f; /* of |noise|, about */
    float n = octaves_seen(width2, octaves), sum = 0, lambda = 1, strength = 1;
    uint32_t whole = (uint32_t)n;
    for (uint32_t i = 0; i < whole; i++) {
        sum += strength * fabsf(octave(p, lambda));
        lambda *= 1.99f;
        strength *= omega;
    }
    /* pbrt counts the mean of the partly seen octave twice, and so do we, to look the same */
    sum += strength * between(partly(n - (float)whole), mean, fabsf(octave(p, lambda)));
    for (uint32_t i = whole; i < octaves; i++) {
        sum += strength * mean;
        strength *= omega;
    }
    return sum;
}

static float cell_noise(float s, float t)
{
    return noise_at((const float[3]){ s, t, 0.5f });
}

bool noise_in_dot(float s, float t)
{
    const float radius = 0.35f, shift = 0.5f - radius;
    float cell_s = floorf(s + 0.5f), cell_t = floorf(t + 0.5f);
    if (!(cell_noise(cell_s + 0.5f, cell_t + 0.5f) > 0))
        return false;
    float ds = s - (cell_s + shift * cell_noise(cell_s + 1.5f, cell_t + 2.8f));
    float dt = t - (cell_t + shift * cell_noise(cell_s + 4.5f, cell_t + 9.8f));
    return ds * ds + dt * dt < radius * radius;
}
