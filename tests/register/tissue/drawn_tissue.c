/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/register/tissue/drawn_tissue.h"

#include "tests/check.h"

#include <math.h>

enum { SIDE = DRAWN_TISSUE_SIDE };
static const double MIDDLE = SIDE / 2.0, REACH = 78;

/* A number from -1 to 1 for each point of a lattice. */
static double lattice(unsigned seed, int i, int j)
{
    uint64_t x = seed * 0x9e3779b97f4a7c15u + (uint64_t)(i + 4096) * 0xbf58476d1ce4e5b9u +
                 (uint64_t)(j + 4096) * 0x94d049bb133111ebu;

    x = (x ^ (x >> 30)) * 0xbf58476d1ce4e5b9u;
    x = (x ^ (x >> 27)) * 0x94d049bb133111ebu;
    return (double)((x ^ (x >> 31)) >> 11) * 0x1p-52 - 1;
}

static double smooth_step(double t)
{
    return t * t * (3 - 2 * t);
}

static double noise(unsigned seed, double x, double y, double cell)
{
    const int i = (int)floor(x / cell), j = (int)floor(y / cell);
    const double u = smooth_step(x / cell - i), v = smooth_step(y / cell - j);

    return (lattice(seed, i, j) * (1 - u) + lattice(seed, i + 1, j) * u) * (1 - v) +
           (lattice(seed, i, j + 1) * (1 - u) + lattice(seed, i + 1, j + 1) * u) * v;
}

static double density(unsigned block, unsigned k, struct gsn_point u, double slant)
{
    const unsigned seed = 1000 * block;
    const double x = u.x - MIDDLE, y = u.y - MIDDLE, r = hypot(x, y), turn = atan2(y, x);
    const double edge = REACH * (1 + 0.06 * cos(2 * turn + block) + 0.04 * cos(3 * turn + 1));
    const double inside = fmin(fmax(edge - r + 0.5, 0), 1);
    const double at = u.x - slant * k;

    return inside * (0.6 + 0.25 * noise(seed + 1, at, u.y, 40) +
                     0.2 * noise(seed + 2, at, u.y, 17) + 0.15 * noise(seed + 10 + k, u.x, u.y, 7));
}

struct gsn_affine drawn_motion(double angle, int mirrored, double dx, double dy)
{
    const double c = cos(angle), s = sin(angle), m = mirrored ? -1 : 1;

    return (struct gsn_affine){ m * c, -s, MIDDLE + dx - m * c * MIDDLE + s * MIDDLE,
                                m * s, c,  MIDDLE + dy - m * s * MIDDLE - c * MIDDLE };
}

struct gsn_plane *drawn_tissue(unsigned block, unsigned k, const struct gsn_affine *motion,
                               double slant)
{
    const struct gsn_affine back = gsn_affine_inverse(motion);
    struct gsn_plane *plane = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_plane_new(SIDE, SIDE, &plane, &err), err);
    for (int y = 0; y < SIDE; y++)
        for (int x = 0; x < SIDE; x++) {
            const struct gsn_point p = { x + 0.5, y + 0.5 };

            plane->value[y * SIDE + x] =
                (float)density(block, k, gsn_affine_apply(&back, p), slant);
        }
    return plane;
}

struct gsn_tissue *drawn_section(unsigned block, unsigned k, const struct gsn_affine *motion,
                                 double slant)
{
    gsn_auto(gsn_plane) plane = drawn_tissue(block, k, motion, slant);
    struct gsn_tissue *tissue = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_new(plane, 1, &tissue, &err), err);
    return tissue;
}

double drawn_apart(const struct gsn_affine *a, const struct gsn_affine *b)
{
    double sum = 0;

    for (int i = 0; i < 64; i++) {
        const double r = REACH * sqrt((i + 0.5) / 64), turn = 2.4 * i;
        const struct gsn_point at = { MIDDLE + r * cos(turn), MIDDLE + r * sin(turn) };
        const struct gsn_point p = gsn_affine_apply(a, at), q = gsn_affine_apply(b, at);

        sum += (pow(p.x - q.x, 2) + pow(p.y - q.y, 2)) / 64;
    }
    return sqrt(sum);
}
