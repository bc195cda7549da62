/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: the cross-correlation of two sections by Fourier transforms, for every rotation in steps
 * of 5 degrees and for both faces (the plain face is the real part, the mirrored one the imaginary:
 * one transform serves both).
 * Steps: (1) both sections about their centres on a coarse grid; (2) the product of one spectrum
 * with the conjugate of the other, and back; (3) the highest peak of each rotation and face; (4) the
 * highest of those, at most one of rotations that are nearly the same.
 * Fails when memory runs out. */
#include "pipeline/register/tissue_bands.h"

#include <math.h>

#include "pipeline/imaging/fourier.h"

/* Every rotation in steps of 5 degrees: half a step moves the outline by less than a cell. */
enum { N = GSN_TISSUE_GRID, ANGLES = 72 };

/* Complex numbers. */
struct spectrum {
    float z[N][N][2];
};

struct peak {
    double height, angle;
    int mirrored, dx, dy;
};

struct room {
    struct spectrum a, b;
    struct peak peak[2 * ANGLES];
    double step; /* side of a cell here, in cells of the first level */
};

/* ---- Rotations ---------------------------------------------------------------------------- */

static float sample(const float *plane, size_t w, size_t h, double x, double y)
{
    const double u = x - 0.5, v = y - 0.5;
    const int i = (int)floor(u), j = (int)floor(v);
    const float fx = (float)(u - i), fy = (float)(v - j);
    const float *at;

    if (i < 0 || j < 0 || i + 1 >= (int)w || j + 1 >= (int)h)
        return 0;
    at = plane + (size_t)j * w + (size_t)i;
    return (at[0] * (1 - fx) + at[1] * fx) * (1 - fy) + (at[w] * (1 - fx) + at[w + 1] * fx) * fy;
}

/* The section about its centre, turned and perhaps mirrored, as the real (0) or imaginary (1) part; a
 * cell is step of the first level. */
static void lay(const struct gsn_tissue *t, double step, double angle, int mirrored, int part,
                struct spectrum *onto)
{
    const struct gsn_tissue_band *band = &t->band[t->levels - 1];
    const double scale = ldexp(1, (int)t->levels - 1);
    const double c = cos(angle) * step / scale, s = sin(angle) * step / scale;
    const double m = mirrored ? -1 : 1;

    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++) {
            const double u = m * (x - N / 2), v = y - N / 2;

            onto->z[y][x][part] =
                sample(t->whole, band->w, band->h, t->centre.x / scale + c * u - s * v,
                       t->centre.y / scale + s * u + c * v);
        }
}

static void find_peak(const struct spectrum *s, int part, double angle, struct peak *peak)
{
    *peak = (struct peak){ .angle = angle, .mirrored = part };
    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++)
            if ((double)s->z[y][x][part] > peak->height) {
                peak->height = (double)s->z[y][x][part];
                peak->dx = x < N / 2 ? x : x - N;
                peak->dy = y < N / 2 ? y : y - N;
            }
}

/* The plain face is the real part and the mirrored one the imaginary: one transform for both. */
static int correlate(struct room *room, const struct gsn_tissue *b, double angle,
                     struct peak ret_peak[2], struct gsn_error *err)
{
    struct spectrum *s = &room->b;
    int r;

    lay(b, room->step, angle, 0, 0, s);
    lay(b, room->step, angle, 1, 1, s);
    r = gsn_fourier(&s->z[0][0][0], N, N, 0, err);
    for (size_t i = 0; r >= 0 && i < (size_t)N * N; i++) {
        const float *p = (&room->a.z[0][0])[i];
        float *q = (&s->z[0][0])[i];
        const float re = q[0] * p[0] + q[1] * p[1], im = q[1] * p[0] - q[0] * p[1];

        q[0] = re;
        q[1] = im;
    }
    if (r >= 0)
        r = gsn_fourier(&s->z[0][0][0], N, N, 1, err);
    if (r < 0)
        return r;
    find_peak(s, 0, angle, &ret_peak[0]);
    find_peak(s, 1, angle, &ret_peak[1]);
    return GSN_OK;
}

/* A point u of a lies at c_b + R F (u - c_a + shift). */
static struct gsn_affine motion_of(const struct gsn_tissue *a, const struct gsn_tissue *b,
                                   const struct peak *peak, double scale)
{
    const double c = cos(peak->angle), s = sin(peak->angle), m = peak->mirrored ? -1 : 1;
    const struct gsn_point at = { peak->dx * scale - a->centre.x, peak->dy * scale - a->centre.y };
    struct gsn_affine map = { m * c, -s, 0, m * s, c, 0 };
    const struct gsn_point moved = gsn_affine_apply(&map, at);

    map.m02 = b->centre.x + moved.x;
    map.m12 = b->centre.y + moved.y;
    return map;
}

static int alike(const struct peak *p, const struct peak *q)
{
    const double step = 2 * M_PI / ANGLES;

    return p->mirrored == q->mirrored &&
           fabs(remainder(p->angle - q->angle, 2 * M_PI)) < 2.5 * step;
}

/* The highest peaks, at most one of rotations that are nearly the same. */
static size_t highest(const struct room *room, size_t most, struct peak *ret_peak)
{
    size_t count = 0;

    while (count < most) {
        const struct peak *best = NULL;

        for (size_t i = 0; i < (size_t)2 * ANGLES; i++) {
            const struct peak *p = &room->peak[i];
            int taken = p->height <= 0;

            for (size_t k = 0; k < count && !taken; k++)
                taken = alike(p, &ret_peak[k]);
            if (!taken && (!best || p->height > best->height))
                best = p;
        }
        if (!best)
            break;
        ret_peak[count++] = *best;
    }
    return count;
}

int gsn_tissue_starts(const struct gsn_tissue *a, const struct gsn_tissue *b, size_t most,
                      struct gsn_affine *ret_start, size_t *ret_count, struct gsn_error *err)
{
    gsn_auto_mem(struct room) room = gsn_alloc_array(1, sizeof *room);
    gsn_auto_mem(struct peak) peak = gsn_alloc_array(most, sizeof *peak);
    int r;

    if (!room || !peak)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying a section by its tissue");
    room->step = ldexp(1, (int)(a->levels > b->levels ? a->levels : b->levels) - 1);
    lay(a, room->step, 0, 0, 0, &room->a);
    r = gsn_fourier(&room->a.z[0][0][0], N, N, 0, err);
    for (size_t i = 0; r >= 0 && i < ANGLES; i++)
        r = correlate(room, b, 2 * M_PI * (double)i / ANGLES, &room->peak[2 * i], err);
    if (r < 0)
        return r;
    *ret_count = highest(room, most, peak);
    for (size_t i = 0; i < *ret_count; i++)
        ret_start[i] = motion_of(a, b, &peak[i], room->step);
    return GSN_OK;
}
