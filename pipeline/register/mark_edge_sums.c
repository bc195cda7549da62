/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_edge_fit.h"

#include <math.h>
#include <string.h>

enum { SHIFT = GSN_SECTOR_SHIFT, BLUR, DISC, TISSUE, LOCAL };
enum { R = GSN_EDGE_R, V_BLUR = GSN_EDGE_BLUR, V_DISC = GSN_EDGE_DISC };

/* Beyond this many blurs from an edge it is over, to five digits. */
#define FAR 4.0f

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

static inline float clamp(float u)
{
    const float low = u < -FAR ? -FAR : u;

    return low > FAR ? FAR : low;
}

/* How far inside and outside of the outline pixels take part: the whole edge, and enough of either
 * side to know its level. */
static double inwards(const struct gsn_edge_fit *fit)
{
    return fmax(3 * fit->v[V_BLUR] + 1, 0.35 * fit->v[R]);
}

/* The mean over a length w of a level that walks by v a pixel misses that at its end by v w / 3 in
 * square, and grain adds to it as little as there are many pixels: both together are least at
 * `best`. Until it is settled which sectors see the mark's edge, some width shows where there is
 * none. */
static double outwards(const struct gsn_edge_fit *fit)
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
static double turning(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *s)
{
    double sum = 0;

    for (int m = 2; m <= fit->lobes; m++)
        sum += m * (fit->v[2 * m] * s->cos[m] - fit->v[2 * m - 1] * s->sin[m]);
    return sum;
}

static struct view view_of(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *s)
{
    const double edge = gsn_edge_outline(fit, s), turn = turning(fit, s) / edge;

    return (struct view){ .x = (float)fit->v[GSN_EDGE_CX],
                          .y = (float)fit->v[GSN_EDGE_CY],
                          .edge = (float)edge,
                          .along_x = (float)(-turn * s->sin[1]),
                          .along_y = (float)(turn * s->cos[1]),
                          .from = (float)-inwards(fit),
                          .to = (float)outwards(fit),
                          .per_blur = (float)(1 / fit->v[V_BLUR]),
                          .level = (float)(gsn_edge_plane(fit, s) + s->b),
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

static inline struct seen look_at(const struct view *v, float x, float y, float value)
{
    const float dx = x - v->x, dy = y - v->y, r = sqrtf(dx * dx + dy * dy);
    const float off = r - v->edge - v->along_x * dx - v->along_y * dy;
    const float u = clamp(off * v->per_blur), q = share_of(u);

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
        const struct seen seen = look_at(v, px[i], py[i], value[i]);
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
                      struct gsn_edge_ring ring)
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

static int between(double at, int low, int high)
{
    return at <= low ? low : at >= high ? high : (int)at;
}

/* Inner rings, rings that the edge may pass through, outer rings: where each of them ends, as seen
 * from the origin, which the centre has not left by much. */
static void part(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *s,
                 const struct view *v, int ret_end[4])
{
    const double edge =
        (double)v->edge + fit->v[GSN_EDGE_CX] * s->cos[1] + fit->v[GSN_EDGE_CY] * s->sin[1];
    const double over = (double)FAR * fit->v[V_BLUR] + 1, width = fit->width;

    ret_end[0] = between((edge + (double)v->from) / width + 0.5, 0, GSN_EDGE_RINGS);
    ret_end[1] = between((edge - over) / width, ret_end[0], GSN_EDGE_RINGS);
    if (ret_end[1] == ret_end[0]) /* the pixels tell themselves */
        ret_end[0] = ret_end[1] = between((edge + (double)v->from) / width - 1, 0, GSN_EDGE_RINGS);
    ret_end[2] = between((edge + over) / width + 1, ret_end[1], GSN_EDGE_RINGS);
    ret_end[3] = between((edge + (double)v->to) / width + 0.5, ret_end[2], GSN_EDGE_RINGS);
}

/* One sector's part of the normal equations. */
static void accumulate(const struct gsn_edge_fit *fit, size_t k, struct gsn_edge_sector *s,
                       struct gsn_edge_sums *sums)
{
    const struct view v = view_of(fit, s);
    const unsigned *first = &fit->first[k * GSN_EDGE_RINGS];
    struct tally y;
    int end[4];

    part(fit, s, &v, end);
    add_edge(&v, fit->by_x + first[end[1]], fit->by_y + first[end[1]],
             fit->by_value + first[end[1]], first[end[2]] - first[end[1]], &y);
    add_level(&y, DISC, (double)v.disc, fit->noise, gsn_edge_rings(fit, k, end[0], end[1]));
    add_level(&y, TISSUE, (double)v.level, fit->noise + fit->tissue,
              gsn_edge_rings(fit, k, end[2], end[3]));
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

void gsn_edge_accumulate(struct gsn_edge_fit *fit, struct gsn_edge_sums *ret_sums)
{
    memset(ret_sums, 0, sizeof *ret_sums);
    for (size_t k = 0; k < fit->sectors; k++)
        accumulate(fit, k, &fit->sector[k], ret_sums);
}

/* Of a sector's pixels up to reach: their number, sum, squares, and what the fit leaves of them. */
static void add_explained(const struct view *v, float reach, const float *restrict px,
                          const float *restrict py, const float *restrict value, size_t count,
                          double sum[4])
{
    float n = 0, all = 0, squares = 0, left = 0;

    for (size_t i = 0; i < count; i++) {
        const struct seen seen = look_at(v, px[i], py[i], value[i]);
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

double gsn_edge_explained(const struct gsn_edge_fit *fit)
{
    double sum[4] = { 0 }, squares;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_edge_sector *s = &fit->sector[k];
        const unsigned *first = &fit->first[k * GSN_EDGE_RINGS];
        struct view v = view_of(fit, s);

        if (!(s->weight > 0))
            continue;
        /* An outline without a slope, and tissue that is the plane alone. */
        v.along_x = v.along_y = 0;
        v.level = (float)gsn_edge_plane(fit, s);
        add_explained(&v, (float)(1.5 * fit->v[R]), fit->by_x + first[0], fit->by_y + first[0],
                      fit->by_value + first[0], first[GSN_EDGE_RINGS] - first[0], sum);
    }
    squares = sum[2] - sum[1] * sum[1] / fmax(sum[0], 1);
    return squares > 0 ? fmax(1 - sum[3] / squares, 0) : 0;
}
