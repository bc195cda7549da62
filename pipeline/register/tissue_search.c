/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/tissue_bands.h"

#include <math.h>
#include <string.h>

/* Every rotation in steps of 5 degrees: half a step moves the outline by less than a cell. */
enum { N = GSN_TISSUE_GRID, ANGLES = 72, STAGES = 6 };

/* Complex numbers apart, so that a whole row is turned at once. */
struct spectrum {
    float re[N][N], im[N][N];
};

struct peak {
    double height, angle;
    int mirrored, dx, dy;
};

struct room {
    struct spectrum a, b;
    float cosine[N / 2], sine[N / 2];
    struct peak peak[2 * ANGLES];
    double step; /* side of a cell here, in cells of the first level */
};

/* ---- Fourier ------------------------------------------------------------------------------ */

static void swap_rows(float *a, float *b)
{
    float keep[N];

    memcpy(keep, a, sizeof keep);
    memcpy(a, b, sizeof keep);
    memcpy(b, keep, sizeof keep);
}

static size_t reversed(size_t i)
{
    size_t r = 0;

    for (int bit = 0; bit < STAGES; bit++)
        r |= (i >> bit & 1) << (STAGES - 1 - bit);
    return r;
}

/* One butterfly of two rows. */
static void butterfly(struct spectrum *s, size_t p, size_t q, float c, float si)
{
    float *restrict pr = s->re[p], *restrict pi = s->im[p];
    float *restrict qr = s->re[q], *restrict qi = s->im[q];

    for (size_t x = 0; x < N; x++) {
        const float tr = c * qr[x] - si * qi[x], ti = c * qi[x] + si * qr[x];

        qr[x] = pr[x] - tr;
        qi[x] = pi[x] - ti;
        pr[x] += tr;
        pi[x] += ti;
    }
}

/* Down all columns. sign -1: forward, 1: backward, not divided by anything. */
static void transform_columns(const struct room *room, struct spectrum *s, float sign)
{
    for (size_t i = 0; i < N; i++) {
        const size_t j = reversed(i);

        if (j > i) {
            swap_rows(s->re[i], s->re[j]);
            swap_rows(s->im[i], s->im[j]);
        }
    }
    for (size_t half = 1; half < N; half *= 2)
        for (size_t start = 0; start < N; start += 2 * half)
            for (size_t k = 0; k < half; k++)
                butterfly(s, start + k, start + k + half, room->cosine[k * (N / 2) / half],
                          sign * room->sine[k * (N / 2) / half]);
}

static void transpose(float a[N][N])
{
    for (size_t y = 0; y < N; y++)
        for (size_t x = 0; x < y; x++) {
            const float keep = a[y][x];

            a[y][x] = a[x][y];
            a[x][y] = keep;
        }
}

/* Both ways; rows and columns come out exchanged, and right again after the way back. */
static void transform(const struct room *room, struct spectrum *s, float sign)
{
    transform_columns(room, s, sign);
    transpose(s->re);
    transpose(s->im);
    transform_columns(room, s, sign);
}

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

/* The section about its centre, turned and perhaps mirrored; a cell is step of the first level. */
static void lay(const struct gsn_tissue *t, double step, double angle, int mirrored,
                float onto[N][N])
{
    const struct gsn_tissue_band *band = &t->band[t->levels - 1];
    const double scale = ldexp(1, (int)t->levels - 1);
    const double c = cos(angle) * step / scale, s = sin(angle) * step / scale;
    const double m = mirrored ? -1 : 1;

    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++) {
            const double u = m * (x - N / 2), v = y - N / 2;

            onto[y][x] = sample(t->whole, band->w, band->h, t->centre.x / scale + c * u - s * v,
                                t->centre.y / scale + s * u + c * v);
        }
}

static void find_peak(const float plane[N][N], double angle, int mirrored, struct peak *peak)
{
    *peak = (struct peak){ .angle = angle, .mirrored = mirrored };
    for (int y = 0; y < N; y++)
        for (int x = 0; x < N; x++)
            if ((double)plane[y][x] > peak->height) {
                peak->height = (double)plane[y][x];
                peak->dx = x < N / 2 ? x : x - N;
                peak->dy = y < N / 2 ? y : y - N;
            }
}

/* The plain face is the real part and the mirrored one the imaginary: one transform for both. */
static void correlate(struct room *room, const struct gsn_tissue *b, double angle,
                      struct peak ret_peak[2])
{
    struct spectrum *s = &room->b;

    lay(b, room->step, angle, 0, s->re);
    lay(b, room->step, angle, 1, s->im);
    transform(room, s, -1);
    for (size_t i = 0; i < (size_t)N * N; i++) {
        const float ar = (&room->a.re[0][0])[i], ai = (&room->a.im[0][0])[i];
        const float br = (&s->re[0][0])[i], bi = (&s->im[0][0])[i];

        (&s->re[0][0])[i] = br * ar + bi * ai;
        (&s->im[0][0])[i] = bi * ar - br * ai;
    }
    transform(room, s, 1);
    find_peak(s->re, angle, 0, &ret_peak[0]);
    find_peak(s->im, angle, 1, &ret_peak[1]);
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

    if (!room || !peak)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying a section by its tissue");
    for (size_t k = 0; k < N / 2; k++) {
        room->cosine[k] = (float)cos(2 * M_PI * (double)k / N);
        room->sine[k] = (float)sin(2 * M_PI * (double)k / N);
    }
    room->step = ldexp(1, (int)(a->levels > b->levels ? a->levels : b->levels) - 1);
    lay(a, room->step, 0, 0, room->a.re);
    transform(room, &room->a, -1);
    for (size_t i = 0; i < ANGLES; i++)
        correlate(room, b, 2 * M_PI * (double)i / ANGLES, &room->peak[2 * i]);
    *ret_count = highest(room, most, peak);
    for (size_t i = 0; i < *ret_count; i++)
        ret_start[i] = motion_of(a, b, &peak[i], room->step);
    return GSN_OK;
}
