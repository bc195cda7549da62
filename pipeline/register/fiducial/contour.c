/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: maximum likelihood fit of a blurred edge with a Fourier descriptor of its outline (Zahn
 * and Roskies 1972), by Gauss and Newton's steps with iteratively reweighted sectors (Tukey's
 * biweight) and random effects of the tissue (each sector's own level, eliminated as its mixed
 * model says).
 *
 * Steps of gsn_contour_fit(). 1. Pixels within two radii are gathered. 2. contour_initial.c:
 * sectors and rings, the circle that most sectors agree on, its outline; sectors off it are
 * silenced.
 * 3. The tissue's grain and how its level walks are learnt from the rings outside. 4. Up to 16
 * steps: normal equations of every sector from its pixels, rings far from the edge summed as a
 * whole; the sectors' levels eliminated, the unknowns moved; then the pixels' variance, the
 * sectors' weights and the descriptor's prior are learnt again. 5. The covariance, larger by how
 * much more than it says the sectors disagree. 6. Where a round outline leaves too much, or little
 * of the rim agrees on it, that of an oval (oval.h) is tried.
 *
 * Fails when memory runs out; too few sectors that agree, or a fit that runs away, is a mark that
 * is not found. Pixels are summed in single precision, in loops that the compiler makes vectors
 * of. */
#include "pipeline/register/fiducial/contour.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/fiducial/contour_internal.h"
#include "pipeline/register/fiducial/oval.h"

#include <assert.h>
#include <math.h>
#include <string.h>

typedef double matrix[UNKNOWNS][UNKNOWNS];

enum { SECTORS_MIN = 8, FLOATS = 6, BANDS = 4 };
enum { STEPS = 16, SETTLING = 2, FREELY = 6 };
/* Beyond this from an edge all is tissue, but for a very blurred one. */
static const double OVER_PX = 3;
/* Standard errors of the sum of squares that chance alone is given. */
static const double SIGMAS = 1;
/* Width of a sector along the rim, px: two to three pixels across carry one edge. */
static const double SECTOR_PX = 2.5;
static const double CONTRAST_MIN = 1e-4, SCORE_MIN = 0.25;
/* An oval is taken where so much of its rim agrees and it leaves less than this share of what a
 * round outline leaves unexplained. */
static const double OVAL_LEAVES = 0.5, RIM_AGREES = 0.85;
/* Where less of the rim agrees on a round outline: two in three of an oval's sectors may lie on a
 * circle beside its middle, which explains what it still looks at. The oval then explains as much
 * of what is all around, but for this share of the variance; a disc that lost an arc is no such
 * oval, and leaves 0.013 more. */
static const double OVAL_MISSES = 0.005;
/* A burn's outline is round to some per cent of its radius (one standard deviation per lobe). */
static const double DESCRIPTOR_SD = 0.04, DESCRIPTOR_SD_MIN = 0.002;
/* Where Tukey's biweight cuts off, in standard deviations: 98 % efficient when nothing is wrong. */
static const double TUKEY = 6;
/* Beyond this many blurs from an edge it is over, to five digits. */
#define FAR 4.0f

/* Which of a sector's quantities each unknown moves, and by how much: one each. */
static const int moved_by[UNKNOWNS] = { SHIFT, SHIFT, SHIFT, SHIFT, SHIFT,  SHIFT,  SHIFT,
                                        SHIFT, SHIFT, BLUR,  DISC,  TISSUE, TISSUE, TISSUE };

/* Squared residuals on either side of the edge. */
struct residual_sums {
    double inner, inner_n, outer, outer_n, outer_q;
};

static double find_contrast(const struct gsn_contour *fit)
{
    return fit->v[V_DISC] - fit->v[V_B0];
}

/* What the tissue's plane is under a sector's middle. */
static double plane_at(const struct gsn_contour *fit, const struct gsn_contour_sector *sector)
{
    return fit->v[V_B0] + fit->v[V_BX] * sector->cos[1] + fit->v[V_BY] * sector->sin[1];
}

/* ---- rings, and the tissue outside ----------------------------------------------------------- */

/* Of count rings from the first on; what lies outside of 0..RINGS is empty. */
static struct gsn_contour_ring sum_rings(const struct gsn_contour *fit, size_t sector, int from,
                                         int to)
{
    struct gsn_contour_ring all = { 0 };

    for (int b = from < 0 ? 0 : from; b < to && b < RINGS; b++) {
        const struct gsn_contour_ring *ring = &fit->ring[sector][b];

        all.n += ring->n;
        all.sum += ring->sum;
        all.squares += ring->squares;
    }
    return all;
}

/* Squares of a sector's pixels about their cells' means, and of bands of rings about the next. */
struct changes {
    double grain, grain_n, squares, per_pixel, bands;
};

static void add_bands(struct changes *c, struct gsn_contour_ring a, struct gsn_contour_ring b)
{
    if (!(a.n > 0 && b.n > 0))
        return;
    c->squares += pow(a.sum / a.n - b.sum / b.n, 2);
    c->per_pixel += 1 / a.n + 1 / b.n;
    c->bands += 1;
}

static void add_sector(const struct gsn_contour *fit, size_t k, int from, int band,
                       struct changes *c)
{
    for (int b = from; b < RINGS - 1; b++) {
        const struct gsn_contour_ring *ring = &fit->ring[k][b];

        if (ring->n > 1) {
            c->grain += ring->squares - ring->sum * ring->sum / ring->n;
            c->grain_n += ring->n - 1;
        }
    }
    for (int b = from; b + 2 * band < RINGS; b += band)
        add_bands(c, sum_rings(fit, k, b, b + band), sum_rings(fit, k, b + band, b + 2 * band));
}

/* Neighbouring bands of width w of a level that walks by v per pixel differ by 2/3 v w in square.
 * Only what chance does not make of grain counts: on even tissue, all of it is heard. */
static void learn_tissue(struct gsn_contour *fit)
{
    const int from = (int)ceil((fit->v[R] + OVER_PX) / fit->width);
    const int room = RINGS - 1 - from, band = room >= 4 * BANDS ? room / BANDS : 1;
    struct changes c = { 0 };
    double chance;

    for (size_t k = 0; k < fit->sectors; k++)
        if (fit->sector[k].weight > 0)
            add_sector(fit, k, from, band, &c);
    fit->grain = c.grain / fmax(c.grain_n, 1);
    chance = fit->grain * c.per_pixel * (1 + SIGMAS * sqrt(2 / fmax(c.bands, 1)));
    fit->walk = fmax(c.squares - chance, 0) / fmax(c.bands, 1) * 1.5 / (band * fit->width);
}

/* ---- what the pixels say --------------------------------------------------------------------- */

/* Share of the tissue where the edge is u blurs inwards of a pixel, Phi(u), and the slope of that;
 * -FAR to FAR. Chebyshev series in t = 2 u^2 / FAR^2 - 1, right to 2e-6 and 8e-6: unlike a table
 * they are worked out for several pixels at once. */
static inline float share_of(float u)
{
    const float t = u * u * (2 / (FAR * FAR)) - 1;
    float p = -0.00059151531f;

    p = p * t + 0.00160517095f;
    p = p * t - 0.00266035395f;
    p = p * t + 0.00582848649f;
    p = p * t - 0.01254486498f;
    p = p * t + 0.02266773498f;
    p = p * t - 0.03685618997f;
    p = p * t + 0.05591522291f;
    p = p * t - 0.08432211201f;
    p = p * t + 0.17595016421f;
    return 0.5f + u * p;
}

static inline float slope_of(float u)
{
    const float t = u * u * (2 / (FAR * FAR)) - 1;
    float p = -0.00781989572f;

    p = p * t + 0.01835007765f;
    p = p * t - 0.02106036386f;
    p = p * t + 0.03553384027f;
    p = p * t - 0.06356437354f;
    p = p * t + 0.08016357219f;
    p = p * t - 0.07771985478f;
    p = p * t + 0.05817187352f;
    p = p * t - 0.02923866911f;
    return p * t + 0.00731261772f;
}

static inline float clamp_blurs(float u)
{
    const float low = u < -FAR ? -FAR : u;

    return low > FAR ? FAR : low;
}

/* How far inside and outside of the outline pixels take part: the whole edge, and enough of either
 * side to know its level. */
static double reach_inwards(const struct gsn_contour *fit)
{
    return fmax(3 * fit->v[V_BLUR] + 1, 0.35 * fit->v[R]);
}

/* The mean over a length w of a level that walks by v a pixel misses that at its end by v w / 3 in
 * square, and grain adds to it as little as there are many pixels: both together are least at
 * `best`. Until it is settled which sectors see the mark's edge, some width shows where there is
 * none. */
static double reach_outwards(const struct gsn_contour *fit)
{
    const double across = 2 * M_PI * fit->v[R] / (double)fit->sectors;
    const double best = sqrt(3 * fit->grain / (across * fmax(fit->walk, 1e-30)));
    const double reach = fmin(best, fit->v[R]);

    return fit->near ? fmax(2 * fit->v[V_BLUR] + 1.5, reach)
                     : fmax(3 * fit->v[V_BLUR] + 2, fmax(reach, 0.8 * fit->v[R]));
}

/* How a sector looks before its pixels are asked. */
struct view {
    float x, y;             /* centre */
    float edge;             /* the outline under the sector's middle */
    float along_x, along_y; /* how it goes on from there */
    float from, to;         /* pixels that take part, from the outline */
    float per_blur, level, disc, noise, tissue;
};

/* What the pixels of a sector add up to. */
struct tally {
    float t[LOCAL], m[LOCAL][LOCAL];
    double inner, inner_n, outer, outer_n, outer_q;
};

/* How the outline changes with the angle, px per radian. */
static double outline_slope(const struct gsn_contour *fit, const struct gsn_contour_sector *s)
{
    double sum = 0;

    for (int m = 2; m <= fit->lobes; m++)
        sum += m * (fit->v[2 * m] * s->cos[m] - fit->v[2 * m - 1] * s->sin[m]);
    return sum;
}

static struct view find_view(const struct gsn_contour *fit, const struct gsn_contour_sector *s)
{
    const double edge = gsn_contour_radius(fit, s), turn = outline_slope(fit, s) / edge;

    return (struct view){ .x = (float)fit->v[CX],
                          .y = (float)fit->v[CY],
                          .edge = (float)edge,
                          .along_x = (float)(-turn * s->sin[1]),
                          .along_y = (float)(turn * s->cos[1]),
                          .from = (float)-reach_inwards(fit),
                          .to = (float)reach_outwards(fit),
                          .per_blur = (float)(1 / fit->v[V_BLUR]),
                          .level = (float)(plane_at(fit, s) + s->b),
                          .disc = (float)fit->v[V_DISC],
                          .noise = (float)fit->noise,
                          .tissue = (float)fit->tissue };
}

/* What a view makes of a pixel. */
struct seen {
    float r, off; /* from the view's centre; from the edge, outwards */
    float u, q;   /* the same in blurs, and the share of tissue there */
    float left;   /* of the pixel's value by what was expected of it */
};

static inline struct seen view_pixel(const struct view *v, float x, float y, float value)
{
    const float dx = x - v->x, dy = y - v->y, r = sqrtf(dx * dx + dy * dy);
    const float off = r - v->edge - v->along_x * dx - v->along_y * dy;
    const float u = clamp_blurs(off * v->per_blur), q = share_of(u);

    return (struct seen){ r, off, u, q, value - v->level * q - v->disc * (1 - q) };
}

/* Pixels that the edge may pass through. Single precision: a sector holds some tens of them. */
static void add_edge(const struct view *v, const float *restrict px, const float *restrict py,
                     const float *restrict value, size_t count, struct tally *y)
{
    const float slope = v->per_blur * (v->disc - v->level);
    float t0 = 0, t1 = 0, t2 = 0, t3 = 0, m00 = 0, m10 = 0, m11 = 0, m20 = 0, m21 = 0, m22 = 0;
    float m30 = 0, m31 = 0, m32 = 0, m33 = 0;
    float inner = 0, inner_n = 0, outer = 0, outer_n = 0, outer_q = 0;

    for (size_t i = 0; i < count; i++) {
        const struct seen seen = view_pixel(v, px[i], py[i], value[i]);
        const float u = seen.u, q = seen.q, res = seen.left, g = slope_of(u) * slope;
        const float takes_part = seen.off < v->from || seen.off > v->to ? 0.0f : 1.0f;
        const float w = takes_part / (v->noise + v->tissue * q * q);
        const float inside = q < 0.25f ? takes_part : 0.0f, outside = takes_part - inside;
        const float w0 = w * g, w1 = w0 * u, w2 = w * (1 - q), w3 = w * q;

        t0 += w0 * res;
        t1 += w1 * res;
        t2 += w2 * res;
        t3 += w3 * res;
        m00 += w0 * g;
        m10 += w1 * g;
        m11 += w1 * g * u;
        m20 += w2 * g;
        m21 += w2 * g * u;
        m22 += w2 * (1 - q);
        m30 += w3 * g;
        m31 += w3 * g * u;
        m32 += w3 * (1 - q);
        m33 += w3 * q;
        inner += inside * res * res;
        inner_n += inside;
        outer += outside * res * res;
        outer_n += outside;
        outer_q += outside * q * q;
    }
    *y = (struct tally){ .t = { t0, t1, t2, t3 },
                         .m = { { m00, m10, m20, m30 },
                                { m10, m11, m21, m31 },
                                { m20, m21, m22, m32 },
                                { m30, m31, m32, m33 } },
                         .inner = (double)inner,
                         .inner_n = (double)inner_n,
                         .outer = (double)outer,
                         .outer_n = (double)outer_n,
                         .outer_q = (double)outer_q };
}

/* Rings beyond the edge on one side, where it is all of one level. */
static void add_level(struct tally *y, int side, double level, double variance,
                      struct gsn_contour_ring ring)
{
    const double off = ring.sum - ring.n * level;
    const double squares = fmax(ring.squares - level * (2 * ring.sum - ring.n * level), 0);

    y->t[side] += (float)(off / variance);
    y->m[side][side] += (float)(ring.n / variance);
    if (side == DISC) {
        y->inner += squares;
        y->inner_n += ring.n;
    } else {
        y->outer += squares;
        y->outer_n += ring.n;
        y->outer_q += ring.n;
    }
}

static int clip_index(double at, int low, int high)
{
    return at <= low ? low : at >= high ? high : (int)at;
}

/* Inner rings, rings that the edge may pass through, outer rings: where each of them ends, as seen
 * from the origin, which the centre has not left by much. */
static void part_rings(const struct gsn_contour *fit, const struct gsn_contour_sector *s,
                       const struct view *v, int ret_end[4])
{
    const double edge = (double)v->edge + fit->v[CX] * s->cos[1] + fit->v[CY] * s->sin[1];
    const double over = (double)FAR * fit->v[V_BLUR] + 1, width = fit->width;

    ret_end[0] = clip_index((edge + (double)v->from) / width + 0.5, 0, RINGS);
    ret_end[1] = clip_index((edge - over) / width, ret_end[0], RINGS);
    if (ret_end[1] == ret_end[0]) /* the pixels tell themselves */
        ret_end[0] = ret_end[1] = clip_index((edge + (double)v->from) / width - 1, 0, RINGS);
    ret_end[2] = clip_index((edge + over) / width + 1, ret_end[1], RINGS);
    ret_end[3] = clip_index((edge + (double)v->to) / width + 0.5, ret_end[2], RINGS);
}

/* One sector's part of the normal equations. */
static void add_sector_pixels(const struct gsn_contour *fit, size_t k, struct gsn_contour_sector *s,
                              struct residual_sums *sums)
{
    const struct view v = find_view(fit, s);
    const unsigned *first = &fit->first[k * RINGS];
    struct tally y;
    int end[4];

    part_rings(fit, s, &v, end);
    add_edge(&v, fit->by_x + first[end[1]], fit->by_y + first[end[1]],
             fit->by_value + first[end[1]], first[end[2]] - first[end[1]], &y);
    add_level(&y, DISC, (double)v.disc, fit->noise, sum_rings(fit, k, end[0], end[1]));
    add_level(&y, TISSUE, (double)v.level, fit->noise + fit->tissue,
              sum_rings(fit, k, end[2], end[3]));
    for (int a = 0; a < LOCAL; a++) {
        s->t[a] = (double)y.t[a];
        for (int b = 0; b < LOCAL; b++)
            s->s[a][b] = (double)y.m[a][b];
    }
    sums->inner += s->weight * y.inner;
    sums->inner_n += s->weight * y.inner_n;
    sums->outer += s->weight * y.outer;
    sums->outer_n += s->weight * y.outer_n;
    sums->outer_q += s->weight * y.outer_q;
}

/* Fills every sector's normal equations. */
static void add_all_pixels(struct gsn_contour *fit, struct residual_sums *ret_sums)
{
    memset(ret_sums, 0, sizeof *ret_sums);
    for (size_t k = 0; k < fit->sectors; k++)
        add_sector_pixels(fit, k, &fit->sector[k], ret_sums);
}

/* Of a sector's pixels up to reach: their number, sum, squares, and what the fit leaves of them. */
static void add_explained(const struct view *v, float reach, const float *restrict px,
                          const float *restrict py, const float *restrict value, size_t count,
                          double sum[4])
{
    float n = 0, all = 0, squares = 0, left = 0;

    for (size_t i = 0; i < count; i++) {
        const struct seen seen = view_pixel(v, px[i], py[i], value[i]);
        const float takes_part = seen.r > reach ? 0.0f : 1.0f;

        n += takes_part;
        all += takes_part * value[i];
        squares += takes_part * value[i] * value[i];
        left += takes_part * seen.left * seen.left;
    }
    sum[0] += (double)n;
    sum[1] += (double)all;
    sum[2] += (double)squares;
    sum[3] += (double)left;
}

/* Share of the variance around the mark that the fit explains; all: not only where the edge is the
 * mark's. */
static double share_explained(const struct gsn_contour *fit, int all)
{
    double sum[4] = { 0 }, squares;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_contour_sector *s = &fit->sector[k];
        const unsigned *first = &fit->first[k * RINGS];
        struct view v = find_view(fit, s);

        if (!all && !(s->weight > 0))
            continue;
        /* An outline without a slope, and tissue that is the plane alone. */
        v.along_x = v.along_y = 0;
        v.level = (float)plane_at(fit, s);
        add_explained(&v, (float)(1.5 * fit->v[R]), fit->by_x + first[0], fit->by_y + first[0],
                      fit->by_value + first[0], first[RINGS] - first[0], sum);
    }
    squares = sum[2] - sum[1] * sum[1] / fmax(sum[0], 1);
    return squares > 0 ? fmax(1 - sum[3] / squares, 0) : 0;
}

/* ---- normal equations ------------------------------------------------------------------------ */

/* Takes b_k out of a sector's equations: it is normal with variance spread. */
static void eliminate_level(const struct gsn_contour *fit, const struct gsn_contour_sector *s,
                            double m[LOCAL][LOCAL], double t[LOCAL])
{
    const double belief = 1 / fit->spread, pivot = s->s[TISSUE][TISSUE] + belief;
    const double rest = s->t[TISSUE] - belief * s->b;

    for (int a = 0; a < LOCAL; a++) {
        const double share = s->s[a][TISSUE] / pivot;

        t[a] = s->t[a] - share * rest;
        for (int b = 0; b < LOCAL; b++)
            m[a][b] = s->s[a][b] - share * s->s[TISSUE][b];
    }
}

/* The lower half of h. */
static void assemble_equations(const struct gsn_contour *fit, matrix h, double *g)
{
    const double lobe = 1 / (fit->lobe * fit->lobe);

    memset(h, 0, UNKNOWNS * sizeof *h);
    memset(g, 0, UNKNOWNS * sizeof *g);
    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_contour_sector *s = &fit->sector[k];
        double m[LOCAL][LOCAL], t[LOCAL], slope[UNKNOWNS];

        if (s->weight <= 0)
            continue;
        eliminate_level(fit, s, m, t);
        gsn_contour_slopes(fit, s, slope);
        for (int i = 0; i < UNKNOWNS; i++) {
            const double weight = s->weight * slope[i];
            const double *row = m[moved_by[i]];

            g[i] += weight * t[moved_by[i]];
            for (int j = 0; j <= i; j++)
                h[i][j] += weight * row[moved_by[j]] * slope[j];
        }
    }
    for (int i = 3; i < SHAPE; i++) {
        h[i][i] += lobe;
        g[i] -= lobe * fit->v[i];
        if (i > 2 * fit->lobes)
            h[i][i] += 1e12 * lobe;
    }
}

/* What each sector says after the step by, and how far its own edge then lies off. */
static void follow_step(struct gsn_contour *fit, const double *by)
{
    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_contour_sector *s = &fit->sector[k];
        const double belief = 1 / fit->spread, pivot = s->s[TISSUE][TISSUE] + belief;
        double m[LOCAL][LOCAL], t[LOCAL], slope[UNKNOWNS], d[LOCAL] = { 0 };
        double tissue = s->t[TISSUE] - belief * s->b;

        eliminate_level(fit, s, m, t);
        gsn_contour_slopes(fit, s, slope);
        for (int j = 0; j < UNKNOWNS; j++)
            d[moved_by[j]] += slope[j] * by[j];
        for (int a = 0; a < LOCAL; a++) {
            t[SHIFT] -= m[SHIFT][a] * d[a];
            tissue -= s->s[TISSUE][a] * d[a];
        }
        s->own_b = s->b + (tissue + belief * s->b) / fmax(s->s[TISSUE][TISSUE], 1e-30);
        s->b += tissue / pivot;
        s->off = m[SHIFT][SHIFT] > 0 ? t[SHIFT] / m[SHIFT][SHIFT] : 0;
        s->variance = m[SHIFT][SHIFT] > 0 ? 1 / m[SHIFT][SHIFT] : INFINITY;
    }
}

/* ---- what is learnt between two steps -------------------------------------------------------- */

/* The variance of a pixel: the scanner's inside, with the tissue's as far as it comes through. */
static void reweigh_pixels(struct gsn_contour *fit, const struct residual_sums *sums)
{
    const double inner = sums->inner / fmax(sums->inner_n - 2, 1);
    const double outer = sums->outer / fmax(sums->outer_n - 5, 1);
    const double least = 1e-10 * pow(find_contrast(fit), 2);

    /* A disc drawn without any noise must not silence everything else. */
    fit->noise = fmax(fmax(fmin(inner, outer), 0.01 * outer), fmax(least, 1e-30));
    fit->tissue =
        sums->outer_q > 0 ? fmax(outer - fit->noise, 0) * sums->outer_n / sums->outer_q : 0;
}

/* How much larger than their own claim the deviations of the sectors are, robustly. */
static double find_excess(const struct gsn_contour *fit)
{
    double off[SECTORS];
    size_t n = 0;

    for (size_t k = 0; k < fit->sectors; k++)
        if (isfinite(fit->sector[k].variance) && fit->sector[k].weight > 0)
            off[n++] = fabs(fit->sector[k].off) / sqrt(fit->sector[k].variance);
    return n > 0 ? fmax(1.4826 * gsn_median(off, n), 1) : 1;
}

/* Once the fit has had its time, a sector that is out stays out: two that take turns would keep it
 * from settling. */
static void reweigh_sectors(struct gsn_contour *fit, int step)
{
    const double scale = TUKEY * find_excess(fit);

    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_contour_sector *s = &fit->sector[k];
        const double z2 = s->off * s->off / (scale * scale * s->variance);
        const double weight = z2 < 1 ? (1 - z2) * (1 - z2) : 0;

        s->weight = step < FREELY && !fit->near ? weight : fmin(weight, s->weight);
    }
    gsn_contour_gate(fit);
}

/* How much the tissue differs from sector to sector, beyond what noise alone would show. */
static void learn_spread(struct gsn_contour *fit)
{
    double squares = 0, precision = 0, n = 0;

    /* By their precision: a sector that is mostly masked says little. */
    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_contour_sector *s = &fit->sector[k];

        squares += s->weight * s->s[TISSUE][TISSUE] * s->own_b * s->own_b;
        precision += s->weight * s->s[TISSUE][TISSUE];
        n += s->weight;
    }
    if (!(precision > 0))
        return;
    fit->level_noise = n / precision;
    /* Three of them are the plane's. */
    fit->spread = fmax(squares / precision * n / fmax(n - 3, 1) - fit->level_noise,
                       1e-2 * fit->level_noise + 1e-8 * pow(find_contrast(fit), 2));
}

/* How lobed this outline is: an arc that is missing must not be made up by lobes that the rest of
 * the rim does not have. */
static void learn_descriptor(struct gsn_contour *fit, matrix h)
{
    double sum = 0, n = 0;

    for (int i = 3; i < 2 * fit->lobes + 1; i++) {
        sum += fit->v[i] * fit->v[i] + 1 / h[i][i];
        n += 1;
    }
    if (n > 0)
        fit->lobe =
            fmin(fmax(sqrt(sum / n), DESCRIPTOR_SD_MIN * fit->v[R]), DESCRIPTOR_SD * fit->v[R]);
}

/* ---- the steps ------------------------------------------------------------------------------- */

static int is_legal(const struct gsn_contour *fit)
{
    const double *v = fit->v;

    return v[R] > 0.4 * fit->radius && v[R] < 2.2 * fit->radius && v[V_BLUR] > 0.1 &&
           v[V_BLUR] < 1.2 * fit->radius && hypot(v[CX], v[CY]) < fit->radius &&
           find_contrast(fit) > 0;
}

static double clamp_step(double value, double most)
{
    return fmin(fmax(value, -most), most);
}

/* Gauss-Newton from the initial estimate; whether it settled somewhere legal. ret_h is the
 * information at the end, its lower half. */
static int iterate_fit(struct gsn_contour *fit, matrix ret_h)
{
    double settled = INFINITY;

    for (int step = 0; step < STEPS; step++) {
        matrix h;
        double by[UNKNOWNS];
        struct residual_sums sums;

        /* Not after the last step: h is then of the lobes believed in. */
        if (step > 1)
            learn_descriptor(fit, ret_h);
        add_all_pixels(fit, &sums);
        assemble_equations(fit, h, by);
        memcpy(ret_h, h, sizeof h);
        if (gsn_solve_spd(&h[0][0], UNKNOWNS, UNKNOWNS, by) < 0)
            return 0;
        for (int i = 0; i < SHAPE; i++)
            by[i] = clamp_step(by[i], 0.15 * fit->v[R]);
        by[V_BLUR] = clamp_step(by[V_BLUR], 0.4 * fit->v[V_BLUR]);
        follow_step(fit, by);
        for (int i = 0; i < UNKNOWNS; i++)
            fit->v[i] += by[i];
        if (!is_legal(fit))
            return 0;
        reweigh_pixels(fit, &sums);
        if (step > 0)
            reweigh_sectors(fit, step);
        learn_spread(fit);
        settled = hypot(by[CX], by[CY]);
        /* The next step will be a tenth of it. */
        if (fit->near && settled < 4e-3)
            return 1;
        fit->near = fit->near || (step >= SETTLING && settled < 4e-2);
    }
    return settled < 0.05;
}

/* ---- the whole of it ------------------------------------------------------------------------- */

/* Pixels within reach of the start; whether at least half of the disc is among them. */
static int gather_pixels(const struct gsn_plane *plane, struct gsn_point start,
                         struct gsn_contour *fit)
{
    const double reach = REACH * fit->radius, disc2 = fit->radius * fit->radius;
    const int y0 = (int)fmax(floor(start.y - reach), 0);
    const int y1 = (int)fmin(ceil(start.y + reach), plane->height);
    size_t disc = 0;

    for (int y = y0; y < y1; y++) {
        const double dy = y + 0.5 - start.y, half = sqrt(fmax(reach * reach - dy * dy, 0));
        const int x0 = (int)fmax(ceil(start.x - half - 0.5), 0);
        const int x1 = (int)fmin(floor(start.x + half - 0.5) + 1, plane->width);
        const float *row = plane->value + (size_t)y * plane->width;

        for (int x = x0; x < x1; x++) {
            const double dx = x + 0.5 - start.x;

            if (!isfinite(row[x]))
                continue;
            disc += dx * dx + dy * dy <= disc2;
            fit->x[fit->count] = (float)dx;
            fit->y[fit->count] = (float)dy;
            fit->value[fit->count++] = row[x];
        }
    }
    return (double)disc >= 0.5 * M_PI * disc2 && fit->count > 4 * UNKNOWNS;
}

/* The same for an oval: its pixels, stretched. */
static int gather_oval(const struct gsn_plane *plane, struct gsn_point start,
                       const struct gsn_oval_stretch *by, struct gsn_contour *fit)
{
    const double reach = REACH * fit->radius, disc2 = fit->radius * fit->radius;
    /* The longer half axis of what is stretched to a circle. */
    const double far = reach * sqrt(gsn_oval_axes_max);
    const int x0 = (int)fmax(floor(start.x - far), 0), y0 = (int)fmax(floor(start.y - far), 0);
    const int x1 = (int)fmin(ceil(start.x + far), plane->width);
    const int y1 = (int)fmin(ceil(start.y + far), plane->height);
    size_t disc = 0;

    for (int y = y0; y < y1; y++) {
        for (int x = x0; x < x1; x++) {
            const float value = plane->value[(size_t)y * plane->width + (size_t)x];
            const double dx = x + 0.5 - start.x, dy = y + 0.5 - start.y;
            const double u = by->xx * dx + by->xy * dy, v = by->xy * dx + by->yy * dy;

            if (!isfinite(value) || u * u + v * v > reach * reach)
                continue;
            disc += u * u + v * v <= disc2;
            fit->x[fit->count] = (float)u;
            fit->y[fit->count] = (float)v;
            fit->value[fit->count++] = value;
        }
    }
    return (double)disc >= 0.5 * M_PI * disc2 && fit->count > 4 * UNKNOWNS;
}

/* What rings between two radii hold, in sectors that are heard. */
static struct gsn_contour_ring find_level(const struct gsn_contour *fit, double from, double to)
{
    struct gsn_contour_ring all = { 0 };

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_contour_ring ring =
            sum_rings(fit, k, (int)round(from * fit->v[R] / fit->width),
                      (int)round(to * fit->v[R] / fit->width));

        if (fit->sector[k].weight == 0)
            continue;
        all.n += ring.n;
        all.sum += ring.sum;
    }
    return all;
}

static void guess_levels(struct gsn_contour *fit)
{
    const struct gsn_contour_ring in = find_level(fit, 0.5, 0.85), out = find_level(fit, 1.2, 1.5);

    fit->v[V_DISC] = in.sum / fmax(in.n, 1);
    fit->v[V_B0] = out.sum / fmax(out.n, 1);
    fit->v[V_BLUR] = fmax(0.08 * fit->v[R], 0.7);
    fit->noise = 1;
    fit->lobe = DESCRIPTOR_FIRST * fit->v[R];
    fit->spread = fit->level_noise = pow(0.05 * find_contrast(fit), 2);
}

/* How much more than claimed the outline is off: the sectors' disagreement beyond the unknowns
 * spent on it, and as far as neighbours err together. What is claimed counts as much as what a rim
 * of sectors that err by it would show, since some thirty squares alone are known to a quarter. */
static double find_inflation(const struct gsn_contour *fit)
{
    const double claimed = (double)fit->sectors;
    double squares = 0, n = 0, sum = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_contour_sector *s = &fit->sector[k];

        squares += s->weight * s->off * s->off / s->variance;
        n += s->weight;
        for (size_t lag = 1; lag <= 3; lag++) {
            const struct gsn_contour_sector *o = &fit->sector[(k + lag) % fit->sectors];

            sum += sqrt(s->weight * o->weight / (s->variance * o->variance)) * s->off * o->off;
        }
    }
    if (!(squares > 0))
        return 1;
    return fmax((claimed + squares) / (claimed + fmax(n - 2 * fit->lobes - 1, 2)), 1) *
           fmax(1 + 2 * sum / squares, 1);
}

/* How much more the disc's level differs from sector to sector than single pixels' noise makes it.
 * Tissue that shows through a faint mark is alike over several pixels and moves its edge by as much
 * more than noise of that size. */
static double find_unevenness(const struct gsn_contour *fit)
{
    double squares = 0, n = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_contour_sector *s = &fit->sector[k];
        const double information = s->s[DISC][DISC];

        if (!(s->weight > 0 && information > 0))
            continue;
        squares += s->weight * pow(s->t[DISC], 2) / information;
        n += s->weight;
    }
    return fmax(squares / fmax(n - 1, 1), 1);
}

/* Part of the centre's covariance that is what its lobes may be as far as the rim says nothing. */
static double part_by_prior(const struct gsn_contour *fit, const double *a, const double *b)
{
    double sum = 0;

    for (int i = R + 1; i < 2 * fit->lobes + 1; i++)
        sum += a[i] * b[i];
    return sum / (fit->lobe * fit->lobe);
}

/* The inverse of the information; larger where the sectors say so, but for what is belief. */
static int find_covariance(const struct gsn_contour *fit, matrix h, struct gsn_fiducial *mark)
{
    const double larger = find_inflation(fit) * find_unevenness(fit);
    double column[2][UNKNOWNS] = { { 0 } };

    for (int c = 0; c < 2; c++) {
        matrix a;

        memcpy(a, h, sizeof a);
        column[c][c] = 1;
        if (gsn_solve_spd(&a[0][0], UNKNOWNS, UNKNOWNS, column[c]) < 0)
            return 0;
    }
    mark->cov_xx = larger * column[0][CX] - (larger - 1) * part_by_prior(fit, column[0], column[0]);
    mark->cov_xy = larger * column[0][CY] - (larger - 1) * part_by_prior(fit, column[0], column[1]);
    mark->cov_yy = larger * column[1][CY] - (larger - 1) * part_by_prior(fit, column[1], column[1]);
    return 1;
}

static double share_of_rim(const struct gsn_contour *fit)
{
    double sum = 0;

    for (size_t k = 0; k < fit->sectors; k++)
        sum += fit->sector[k].weight;
    return sum / (double)fit->sectors;
}

static int run_fit(struct gsn_contour *fit, struct gsn_fiducial *mark)
{
    matrix h;

    if (!gsn_contour_estimate(fit))
        return 0;
    guess_levels(fit);
    learn_tissue(fit);
    if (!(find_contrast(fit) > CONTRAST_MIN) || !iterate_fit(fit, h) || share_of_rim(fit) < RIM_MIN)
        return 0;
    mark->radius_px = fit->v[R];
    mark->contrast = find_contrast(fit);
    mark->score = share_explained(fit, 0);
    return mark->contrast >= CONTRAST_MIN && mark->score >= SCORE_MIN &&
           find_covariance(fit, h, mark);
}

/* One fit; stretch: NULL for a round mark. Returns the share of the rim that agrees, or 0. */
static double fit_outline(struct gsn_contour *fit, const struct gsn_plane *plane,
                          struct gsn_point start, double radius_px,
                          const struct gsn_oval_stretch *stretch, struct gsn_fiducial *ret_mark)
{
    struct gsn_fiducial mark = { 0 };

    fit->radius = radius_px;
    fit->sectors = (size_t)fmin(fmax(2 * M_PI * radius_px / SECTOR_PX, SECTORS_MIN), SECTORS);
    if (!(stretch ? gather_oval(plane, start, stretch, fit) : gather_pixels(plane, start, fit)) ||
        !run_fit(fit, &mark))
        return 0;
    mark.px = (struct gsn_point){ fit->at_x + fit->v[CX], fit->at_y + fit->v[CY] };
    if (stretch)
        gsn_oval_unstretch(stretch, &mark);
    mark.px.x += start.x;
    mark.px.y += start.y;
    mark.found = 1;
    *ret_mark = mark;
    return share_of_rim(fit);
}

/* What the fit is worked in. */
static void clear_buffers(struct gsn_contour *fit, float *floats, int *cells, size_t room)
{
    memset(fit, 0, sizeof *fit);
    fit->x = floats;
    fit->y = floats + room;
    fit->value = floats + 2 * room;
    fit->by_x = floats + 3 * room;
    fit->by_y = floats + 4 * room;
    fit->by_value = floats + 5 * room;
    fit->cell = cells;
}

/* Standard error of the centre, px; infinite for a mark that was not found. */
static double find_error(const struct gsn_fiducial *mark)
{
    return mark->found ? sqrt(mark->cov_xx + mark->cov_yy) : INFINITY;
}

/* Whether the oval, the last that was fitted, is rather the mark than the round outline. */
static int is_the_better(const struct gsn_contour *fit, const struct gsn_fiducial *mark, double rim,
                         const struct gsn_fiducial *oval, double oval_rim)
{
    if (!oval->found)
        return 0;
    if (!mark->found)
        return oval_rim >= RIM_AGREES;
    if (oval_rim >= RIM_AGREES && 1 - oval->score < OVAL_LEAVES * (1 - mark->score))
        return 1;
    return rim < RIM_AGREES && oval_rim > rim && find_error(oval) < find_error(mark) &&
           mark->score - share_explained(fit, 1) < OVAL_MISSES;
}

int gsn_contour_fit(const struct gsn_plane *plane, struct gsn_point start, double radius_px,
                    struct gsn_fiducial *ret_mark, struct gsn_error *err)
{
    /* An oval may be 1.6 times as large as was thought. */
    const size_t side = (size_t)ceil(1.6 * 2 * REACH * radius_px) + 3, room = side * side;
    gsn_auto_mem(float) floats = gsn_alloc(FLOATS * room * sizeof *floats);
    gsn_auto_mem(int) cells = gsn_alloc(room * sizeof *cells);
    gsn_auto_mem(struct gsn_contour) fit = gsn_alloc_array(1, sizeof *fit);
    struct gsn_fiducial mark = { 0 }, oval = { 0 };
    struct gsn_oval_stretch stretch;
    double rim, oval_rim;

    assert(plane && radius_px > 0 && ret_mark);

    if (!floats || !cells || !fit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    clear_buffers(fit, floats, cells, room);
    rim = fit_outline(fit, plane, start, radius_px, NULL, &mark);
    if ((rim < RIM_AGREES || mark.score < gsn_oval_round_score) &&
        gsn_oval_find(plane, &start, &radius_px, &stretch)) {
        clear_buffers(fit, floats, cells, room);
        oval_rim = fit_outline(fit, plane, start, radius_px, &stretch, &oval);
        if (is_the_better(fit, &mark, rim, &oval, oval_rim))
            mark = oval;
    }
    *ret_mark = mark;
    return GSN_OK;
}
