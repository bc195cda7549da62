/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_edge.h"

#include "pipeline/register/median.h"
#include "pipeline/register/small.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Shape: the centre, the radius, the lobes; then the blur, the disc's level, the tissue's plane. */
enum { LOBES = 4, SHAPE = 2 * LOBES + 1, UNKNOWNS = SHAPE + 5 };
enum { CX, CY, R };
/* What a sector knows of: the shift of its edge, the blur, the disc's level, its tissue's level. */
enum { SHIFT, BLUR, DISC, TISSUE, LOCAL };

enum {
    SECTORS_LEAST = 8,
    SECTORS_MOST = 48,
    BINS = 48,
    STEPS = 16,
    SETTLING = 2,
    FREELY = 6,
    LOOKS = 8
};

/* Width of a sector along the rim, px: two to three pixels across carry one edge. */
static const double SECTOR_PX = 2.5;
/* The window, in starting radii: room for a radius half as large again and tissue around it. */
static const double REACH = 2.0;
/* Edges are looked for between these, in starting radii. */
static const double EDGE_FROM = 0.45, EDGE_TO = 1.7;
/* A burn's outline is round to some per cent of its radius (one standard deviation per lobe). */
static const double LOBE_SD = 0.04, LOBE_LEAST = 0.002, LOBE_FIRST = 0.015;
/* Where Tukey's biweight cuts off, in standard deviations: 98 % efficient when nothing is wrong. */
static const double TUKEY = 6;
/* Fewer sectors than this share of the rim that agree are no round edge. */
static const double RIM_LEAST = 0.4;
/* An outline's distance from a circle, in radii and at least in pixels, that is still its own. */
static const double ROUGH = 0.06, ROUGH_PX = 0.75, CLOSELY = 0.5;
/* A sector's edge is seen no better than this at a first look, px. */
static const double EDGE_SD_PX = 0.15;
static const double CONTRAST_LEAST = 1e-4, SCORE_LEAST = 0.25;
/* Beyond this many blurs from an edge it is over, to five digits; the table's steps per blur. */
enum { FAR = 4, PER_BLUR = 32, TABLE = 2 * FAR * PER_BLUR + 2 };

struct sample {
    float x, y, value; /* centre, from the start */
    unsigned sector;
};

struct sector {
    double cos[LOBES + 1], sin[LOBES + 1]; /* of m times its angle, m = 0.. */
    double edge;                           /* where a first look puts it, from the start */
    double b;                              /* its tissue's level above the plane */
    double weight;                         /* 0..1: what the majority thinks of it */
    double s[LOCAL][LOCAL], t[LOCAL];      /* its part of the normal equations */
    double own_b;                          /* the same by its own account alone */
    double off, variance;                  /* its own edge, beyond the outline; of it */
};

struct edge_fit {
    double at_x, at_y;  /* where the samples' origin has got to, from the start */
    double level_noise; /* variance of a sector's level by its pixels' noise */
    double tolerance;   /* of a sector's edge as the first look sees it */
    size_t count, sectors;
    struct sample *sample; /* by sector; twice the room, for sorting */
    size_t first[SECTORS_MOST + 1];
    struct sector sector[SECTORS_MOST];
    double radius;        /* starting radius */
    double v[UNKNOWNS];   /* shape, then the four below */
    int lobes;            /* orders that are fitted, 1 for none */
    double noise, tissue; /* variance of a pixel: noise + tissue q^2 */
    double spread;        /* variance of the sectors' b */
    double lobe;          /* standard deviation of a lobe */
    float cdf[TABLE], pdf[TABLE];
};

enum { V_BLUR = SHAPE, V_DISC, V_B0, V_BX, V_BY };

static int gather(const struct gsn_plane *plane, struct gsn_point start, struct edge_fit *fit)
{
    const double reach = REACH * fit->radius;
    const int x0 = (int)fmax(floor(start.x - reach), 0), y0 = (int)fmax(floor(start.y - reach), 0);
    const int x1 = (int)fmin(ceil(start.x + reach), plane->width);
    const int y1 = (int)fmin(ceil(start.y + reach), plane->height);
    double disc = 0;

    for (int y = y0; y < y1; y++) {
        for (int x = x0; x < x1; x++) {
            const float value = plane->value[(size_t)y * plane->width + (size_t)x];
            const double dx = x + 0.5 - start.x, dy = y + 0.5 - start.y;
            const double rr = dx * dx + dy * dy;

            if (rr > reach * reach || !isfinite(value))
                continue;
            disc += rr <= fit->radius * fit->radius;
            fit->sample[fit->count++] =
                (struct sample){ .x = (float)dx, .y = (float)dy, .value = value };
        }
    }
    return disc >= 0.5 * M_PI * fit->radius * fit->radius && fit->count > 4 * UNKNOWNS;
}

/* atan2 in turns, 0..1, to 1e-4 of a turn: enough to sort pixels into sectors. */
static float turn_of(float y, float x)
{
    const float ax = fabsf(x), ay = fabsf(y);
    const float z = (ax < ay ? ax : ay) / ((ax > ay ? ax : ay) + 1e-12f), zz = z * z;
    float a = z * (0.1591549f - zz * (0.0530516f - zz * (0.0286f - zz * 0.0097f)));

    if (ay > ax)
        a = 0.25f - a;
    if (x < 0)
        a = 0.5f - a;
    return y < 0 ? 1 - a : a;
}

/* Says which sector each pixel belongs to, and sorts the pixels by that. */
static void set_sectors(struct edge_fit *fit)
{
    size_t next[SECTORS_MOST];
    struct sample *spare = fit->sample + fit->count;

    memset(fit->first, 0, sizeof fit->first);
    for (size_t i = 0; i < fit->count; i++) {
        struct sample *p = &fit->sample[i];

        p->sector = (unsigned)(turn_of(p->y, p->x) * (float)fit->sectors) % (unsigned)fit->sectors;
        fit->first[p->sector + 1]++;
    }
    for (size_t k = 0; k < fit->sectors; k++) {
        fit->first[k + 1] += fit->first[k];
        next[k] = fit->first[k];
    }
    for (size_t i = 0; i < fit->count; i++)
        spare[next[fit->sample[i].sector]++] = fit->sample[i];
    memcpy(fit->sample, spare, fit->count * sizeof *spare);
}

static void set_angles(struct edge_fit *fit)
{
    for (size_t k = 0; k < fit->sectors; k++) {
        const double angle = 2 * M_PI * ((double)k + 0.5) / (double)fit->sectors;

        for (int m = 0; m <= LOBES; m++) {
            fit->sector[k].cos[m] = cos(m * angle);
            fit->sector[k].sin[m] = sin(m * angle);
        }
    }
}

/* ---- A first look: the sharpest fall of each sector, a circle through the majority --------- */

struct profile {
    double sum[SECTORS_MOST][BINS], n[SECTORS_MOST][BINS];
    double width; /* of a bin, px */
};

static double mean_of(const struct profile *profile, size_t sector, int from, int to)
{
    double sum = 0, n = 0;

    for (int b = from < 0 ? 0 : from; b < to && b < BINS; b++) {
        sum += profile->sum[sector][b];
        n += profile->n[sector][b];
    }
    return n > 0 ? sum / n : NAN;
}

static double fall_at(const struct profile *profile, size_t k, int bin)
{
    return mean_of(profile, k, bin - 2, bin) - mean_of(profile, k, bin, bin + 2);
}

/* Where the sector falls most from inside to outside, or NaN. */
static double sharpest(const struct edge_fit *fit, const struct profile *profile, size_t k)
{
    const int from = (int)(EDGE_FROM * fit->radius / profile->width);
    const int to = (int)(EDGE_TO * fit->radius / profile->width);
    double best = 0, at = NAN, before = 0;

    for (int b = from; b <= to; b++) {
        const double fall = fall_at(profile, k, b);

        if (fall > best) {
            const double after = fall_at(profile, k, b + 1), bend = before - 2 * fall + after;

            best = fall;
            at = (b + (bend < 0 ? 0.5 * (before - after) / bend : 0)) * profile->width;
        }
        before = fall;
    }
    return at;
}

static void look_for_edges(struct edge_fit *fit)
{
    struct profile profile = { .width = fmax(REACH * fit->radius / (BINS - 1), 1) };

    for (size_t i = 0; i < fit->count; i++) {
        const struct sample *p = &fit->sample[i];
        const int bin = (int)(sqrt((double)(p->x * p->x + p->y * p->y)) / profile.width);

        if (bin >= BINS)
            continue;
        profile.sum[p->sector][bin] += p->value;
        profile.n[p->sector][bin] += 1;
    }
    for (size_t k = 0; k < fit->sectors; k++)
        fit->sector[k].edge = sharpest(fit, &profile, k);
}

struct circle {
    double x, y, radius;
};

static int circle_through(const struct sector *a, const struct sector *b, const struct sector *c,
                          struct circle *ret_circle)
{
    const double ax = a->edge * a->cos[1], ay = a->edge * a->sin[1];
    const double bx = b->edge * b->cos[1] - ax, by = b->edge * b->sin[1] - ay;
    const double cx = c->edge * c->cos[1] - ax, cy = c->edge * c->sin[1] - ay;
    const double d = 2 * (bx * cy - by * cx);
    const double bb = bx * bx + by * by, cc = cx * cx + cy * cy;
    const double ux = (cy * bb - by * cc) / d, uy = (bx * cc - cx * bb) / d;

    *ret_circle = (struct circle){ ax + ux, ay + uy, hypot(ux, uy) };
    return isfinite(ret_circle->x) && isfinite(ret_circle->y);
}

static double beside(const struct sector *s, const struct circle *circle)
{
    const double x = s->edge * s->cos[1] - circle->x, y = s->edge * s->sin[1] - circle->y;

    return sqrt(x * x + y * y) - circle->radius;
}

/* Sum of squared distances, none counting for more than one beyond tolerance. */
static double misfit(const struct edge_fit *fit, const struct circle *circle, double tolerance)
{
    double sum = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const double off = beside(&fit->sector[k], circle) / tolerance;

        sum += off * off < 1 ? off * off : 1; /* NaN counts as one */
    }
    return sum;
}

/* Standard deviation of a sector's edge as the first look sees it, from how it lies between its
 * neighbours': lobes and cuts hardly show in that. */
static double jitter(const struct edge_fit *fit)
{
    double off[SECTORS_MOST];
    size_t n = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const double second = fit->sector[k].edge - 2 * fit->sector[(k + 1) % fit->sectors].edge +
                              fit->sector[(k + 2) % fit->sectors].edge;

        if (isfinite(second))
            off[n++] = fabs(second) / sqrt(6);
    }
    return n > 0 ? 1.4826 * gsn_median(off, n) : 0;
}

/* The circle that most sectors agree on, out of those through three of them a third, a quarter or a
 * sixth of a turn apart: one of these lies in what is whole of a mark that has lost an arc. What it
 * leaves, in sectors, goes to *ret_misfit; infinite when there is none. */
static struct circle majority(const struct edge_fit *fit, double tolerance, double *ret_misfit)
{
    const size_t n = fit->sectors, apart[3] = { n / 3, n / 4, n / 6 };
    struct circle best = { 0 };

    *ret_misfit = INFINITY;
    for (size_t k = 0; k < 3 * n; k++) {
        const struct sector *s = fit->sector;
        struct circle circle;
        double sum;

        if (!circle_through(&s[k % n], &s[(k + apart[k / n]) % n], &s[(k + 2 * apart[k / n]) % n],
                            &circle) ||
            hypot(circle.x, circle.y) > fit->radius || circle.radius < EDGE_FROM * fit->radius ||
            circle.radius > EDGE_TO * fit->radius)
            continue;
        sum = misfit(fit, &circle, tolerance);
        if (sum < *ret_misfit) {
            *ret_misfit = sum;
            best = circle;
        }
    }
    return best;
}

/* A round mark that has lost an arc looks nearly as much like a smaller one that has lost nothing
 * and is ragged; so a circle that enough of the rim follows closely goes first. */
static int find_circle(struct edge_fit *fit)
{
    const double n = (double)fit->sectors;
    double left;
    struct circle circle = majority(fit, fit->tolerance * CLOSELY, &left);

    if (left > (1 - RIM_LEAST) * n)
        circle = majority(fit, fit->tolerance, &left);
    if (!(left < (1 - RIM_LEAST) * n))
        return 0;
    fit->v[CX] = circle.x;
    fit->v[CY] = circle.y;
    fit->v[R] = circle.radius;
    return 1;
}

/* ---- The fit ------------------------------------------------------------------------------ */

static double contrast_of(const struct edge_fit *fit)
{
    return fit->v[V_DISC] - fit->v[V_B0];
}

static void guess_levels(struct edge_fit *fit)
{
    double in = 0, in_n = 0, out = 0, out_n = 0;

    for (size_t i = 0; i < fit->count; i++) {
        const struct sample *p = &fit->sample[i];
        const float r = sqrtf(p->x * p->x + p->y * p->y) / (float)fit->v[R];

        if (fit->sector[p->sector].weight == 0)
            continue;
        if (r > 0.5 && r < 0.85) {
            in += p->value;
            in_n += 1;
        } else if (r > 1.2 && r < 1.5) {
            out += p->value;
            out_n += 1;
        }
    }
    fit->v[V_DISC] = in / fmax(in_n, 1);
    fit->v[V_B0] = out / fmax(out_n, 1);
    fit->v[V_BLUR] = fmax(0.08 * fit->v[R], 0.7);
    fit->noise = 1;
    fit->lobe = LOBE_FIRST * fit->v[R];
    fit->spread = fit->level_noise = pow(0.05 * contrast_of(fit), 2);
}

static void make_tables(struct edge_fit *fit)
{
    for (int i = 0; i < TABLE; i++) {
        const double u = (double)i / PER_BLUR - FAR;

        fit->cdf[i] = (float)(0.5 * erfc(-u / M_SQRT2));
        fit->pdf[i] = (float)(exp(-0.5 * u * u) / sqrt(2 * M_PI));
    }
}

static double outline(const struct edge_fit *fit, const struct sector *s)
{
    double r = fit->v[R];

    for (int m = 2; m <= fit->lobes; m++)
        r += fit->v[2 * m - 1] * s->cos[m] + fit->v[2 * m] * s->sin[m];
    return r;
}

/* How the outline changes with the angle, px per radian. */
static double slope(const struct edge_fit *fit, const struct sector *s)
{
    double sum = 0;

    for (int m = 2; m <= fit->lobes; m++)
        sum += m * (fit->v[2 * m] * s->cos[m] - fit->v[2 * m - 1] * s->sin[m]);
    return sum;
}

static double plane_at(const struct edge_fit *fit, const struct sector *s)
{
    return fit->v[V_B0] + fit->v[V_BX] * s->cos[1] + fit->v[V_BY] * s->sin[1];
}

/* How far inside and outside of the outline pixels take part: the whole edge, and enough of either
 * side to know its level. Where tissue differs from place to place more than noise makes it seem
 * to, that from further away tells less about that under the edge. */
static double inwards(const struct edge_fit *fit)
{
    return fmax(3 * fit->v[V_BLUR] + 1, 0.35 * fit->v[R]);
}

static double outwards(const struct edge_fit *fit)
{
    const double alike = fit->level_noise / (fit->level_noise + fit->spread);

    return fmax(3 * fit->v[V_BLUR] + 2, (0.4 + 0.6 * alike) * fit->v[R]);
}

struct sums {
    double inner, inner_n, outer, outer_n, outer_q; /* squared residuals on either side */
};

static void edge_at(const struct edge_fit *fit, float u, float *ret_q, float *ret_g)
{
    const float at = ((u < -FAR ? -FAR : u > FAR ? FAR : u) + FAR) * PER_BLUR;
    const int i = (int)at;
    const float part = at - (float)i;

    *ret_q = fit->cdf[i] + part * (fit->cdf[i + 1] - fit->cdf[i]);
    *ret_g = fit->pdf[i] + part * (fit->pdf[i + 1] - fit->pdf[i]);
}

/* What a pixel at off from its sector's edge adds. */
struct tally {
    float t[LOCAL], m[LOCAL][LOCAL];
    float inner, inner_n, outer, outer_n, outer_q;
};

static inline void add_edge(const struct edge_fit *fit, float off, float value, float level,
                            struct tally *y)
{
    const float per_blur = (float)(1 / fit->v[V_BLUR]), disc = (float)fit->v[V_DISC];
    float d[LOCAL], q, g, res, w;

    edge_at(fit, off * per_blur, &q, &g);
    res = value - level * q - disc * (1 - q);
    w = 1 / ((float)fit->noise + (float)fit->tissue * q * q);
    g *= per_blur * (disc - level);
    d[SHIFT] = g;
    d[BLUR] = g * off * per_blur;
    d[DISC] = 1 - q;
    d[TISSUE] = q;
    for (int a = 0; a < LOCAL; a++) {
        const float wd = w * d[a];

        y->t[a] += wd * res;
        for (int b = 0; b <= a; b++)
            y->m[a][b] += wd * d[b];
    }
    if (q < 0.25f) {
        y->inner += res * res;
        y->inner_n += 1;
    } else {
        y->outer += res * res;
        y->outer_q += q * q;
        y->outer_n += 1;
    }
}

/* The same for many pixels beyond the edge on one side, of which count, sum and sum of squares of
 * the residuals are known. */
static void add_level(struct tally *y, int side, float variance, const float sum[3])
{
    y->t[side] += sum[1] / variance;
    y->m[side][side] += sum[0] / variance;
    if (side == DISC) {
        y->inner += sum[2];
        y->inner_n += sum[0];
    } else {
        y->outer += sum[2];
        y->outer_n += sum[0];
        y->outer_q += sum[0];
    }
}

/* One sector's part of the normal equations. Single precision: a sector holds some tens of pixels.
 */
static void accumulate_sector(const struct edge_fit *fit, size_t k, struct sector *s,
                              struct sums *sums)
{
    const float from = (float)-inwards(fit), to = (float)outwards(fit);
    const float over = FAR * (float)fit->v[V_BLUR], edge = (float)outline(fit, s);
    const float level = (float)(plane_at(fit, s) + s->b), disc = (float)fit->v[V_DISC];
    const float cx = (float)fit->v[CX], cy = (float)fit->v[CY];
    /* From the sector's middle on, the outline goes on as its slope says. */
    const float turn = (float)(slope(fit, s) / outline(fit, s));
    const float along_x = -turn * (float)s->sin[1], along_y = turn * (float)s->cos[1];
    float inside[3] = { 0 }, outside[3] = { 0 };
    struct tally y = { 0 };

    for (size_t i = fit->first[k]; i < fit->first[k + 1]; i++) {
        const struct sample *p = &fit->sample[i];
        const float dx = p->x - cx, dy = p->y - cy;
        const float off = sqrtf(dx * dx + dy * dy) - edge - along_x * dx - along_y * dy;

        if (off < from || off > to)
            continue;
        if (off < over && off > -over) {
            add_edge(fit, off, p->value, level, &y);
        } else {
            float *sum = off > 0 ? outside : inside;
            const float res = p->value - (off > 0 ? level : disc);

            sum[0] += 1;
            sum[1] += res;
            sum[2] += res * res;
        }
    }
    add_level(&y, TISSUE, (float)(fit->noise + fit->tissue), outside);
    add_level(&y, DISC, (float)fit->noise, inside);
    for (int a = 0; a < LOCAL; a++) {
        s->t[a] = y.t[a];
        for (int b = 0; b <= a; b++)
            s->s[a][b] = s->s[b][a] = y.m[a][b];
    }
    sums->inner += s->weight * y.inner;
    sums->inner_n += s->weight * y.inner_n;
    sums->outer += s->weight * y.outer;
    sums->outer_n += s->weight * y.outer_n;
    sums->outer_q += s->weight * y.outer_q;
}

static void accumulate(struct edge_fit *fit, struct sums *sums)
{
    memset(sums, 0, sizeof *sums);
    for (size_t k = 0; k < fit->sectors; k++)
        accumulate_sector(fit, k, &fit->sector[k], sums);
}

/* The variance of a pixel: the scanner's inside, with the tissue's as far as it comes through. */
static void reweigh_pixels(struct edge_fit *fit, const struct sums *sums)
{
    const double inner = sums->inner / fmax(sums->inner_n - 2, 1);
    const double outer = sums->outer / fmax(sums->outer_n - 5, 1);
    const double floor_ = 1e-10 * pow(contrast_of(fit), 2);

    /* A disc drawn without any noise must not silence everything else. */
    fit->noise = fmax(fmax(fmin(inner, outer), 0.01 * outer), fmax(floor_, 1e-30));
    fit->tissue =
        sums->outer_q > 0 ? fmax(outer - fit->noise, 0) * sums->outer_n / sums->outer_q : 0;
}

/* Takes b_k out of a sector's equations: it is normal with variance spread. */
static void eliminate(const struct edge_fit *fit, const struct sector *s, double m[LOCAL][LOCAL],
                      double t[LOCAL])
{
    const double belief = 1 / fit->spread, pivot = s->s[TISSUE][TISSUE] + belief;
    const double rest = s->t[TISSUE] - belief * s->b;

    for (int a = 0; a < LOCAL; a++) {
        t[a] = s->t[a] - s->s[a][TISSUE] * rest / pivot;
        for (int b = 0; b < LOCAL; b++)
            m[a][b] = s->s[a][b] - s->s[a][TISSUE] * s->s[TISSUE][b] / pivot;
    }
}

/* d(local quantity) / d(unknown), as sparse as it is. */
static void spread_out(const struct edge_fit *fit, const struct sector *s,
                       double x[LOCAL][UNKNOWNS])
{
    memset(x, 0, LOCAL * sizeof *x);
    x[SHIFT][CX] = s->cos[1];
    x[SHIFT][CY] = s->sin[1];
    x[SHIFT][R] = 1;
    for (int m = 2; m <= fit->lobes; m++) {
        x[SHIFT][2 * m - 1] = s->cos[m];
        x[SHIFT][2 * m] = s->sin[m];
    }
    x[BLUR][V_BLUR] = 1;
    x[DISC][V_DISC] = 1;
    x[TISSUE][V_B0] = 1;
    x[TISSUE][V_BX] = s->cos[1];
    x[TISSUE][V_BY] = s->sin[1];
}

static void assemble(const struct edge_fit *fit, double h[UNKNOWNS][UNKNOWNS], double *g)
{
    const double lobe = 1 / (fit->lobe * fit->lobe);

    memset(h, 0, UNKNOWNS * sizeof *h);
    memset(g, 0, UNKNOWNS * sizeof *g);
    for (size_t k = 0; k < fit->sectors; k++) {
        const struct sector *s = &fit->sector[k];
        double m[LOCAL][LOCAL], t[LOCAL], x[LOCAL][UNKNOWNS], mx[LOCAL][UNKNOWNS];

        if (s->weight <= 0)
            continue;
        eliminate(fit, s, m, t);
        spread_out(fit, s, x);
        for (int a = 0; a < LOCAL; a++) {
            for (int j = 0; j < UNKNOWNS; j++) {
                double sum = 0;

                for (int b = 0; b < LOCAL; b++)
                    sum += m[a][b] * x[b][j];
                mx[a][j] = s->weight * sum;
                g[j] += s->weight * x[a][j] * t[a];
            }
        }
        for (int i = 0; i < UNKNOWNS; i++)
            for (int j = 0; j <= i; j++)
                for (int a = 0; a < LOCAL; a++)
                    h[i][j] += x[a][i] * mx[a][j];
    }
    for (int i = 3; i < SHAPE; i++) {
        h[i][i] += lobe;
        g[i] -= lobe * fit->v[i];
        if (i > 2 * fit->lobes)
            h[i][i] += 1e12 * lobe;
    }
}

/* What each sector says after the step by, and how far its own edge then lies off. */
static void follow(struct edge_fit *fit, const double *by)
{
    for (size_t k = 0; k < fit->sectors; k++) {
        struct sector *s = &fit->sector[k];
        const double belief = 1 / fit->spread, pivot = s->s[TISSUE][TISSUE] + belief;
        double m[LOCAL][LOCAL], t[LOCAL], x[LOCAL][UNKNOWNS], d[LOCAL] = { 0 };
        double tissue = s->t[TISSUE] - belief * s->b;

        eliminate(fit, s, m, t);
        spread_out(fit, s, x);
        for (int a = 0; a < LOCAL; a++)
            for (int j = 0; j < UNKNOWNS; j++)
                d[a] += x[a][j] * by[j];
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

/* How much larger than their own claim the deviations of the sectors are, robustly. */
static double excess(const struct edge_fit *fit)
{
    double off[SECTORS_MOST];
    size_t n = 0;

    for (size_t k = 0; k < fit->sectors; k++)
        if (isfinite(fit->sector[k].variance) && fit->sector[k].weight > 0)
            off[n++] = fabs(fit->sector[k].off) / sqrt(fit->sector[k].variance);
    return n > 0 ? fmax(1.4826 * gsn_median(off, n), 1) : 1;
}

/* Sectors whose own edge lies off the outline: what moved it does not end at the sector's border,
 * so its neighbours are not heard either. A fit that sees only an edge's foot takes it for nearer.
 */
static void gate(struct edge_fit *fit)
{
    const struct circle circle = { fit->v[CX], fit->v[CY], fit->v[R] };
    const size_t n = fit->sectors;
    int off[SECTORS_MOST];

    for (size_t k = 0; k < n; k++) {
        const struct sector *s = &fit->sector[k];

        off[k] = !(fabs(beside(s, &circle) - outline(fit, s) + fit->v[R]) < fit->tolerance) &&
                 !(fabs(s->off) < 3 * sqrt(s->variance));
    }
    for (size_t k = 0; k < n; k++)
        if (off[k] || off[(k + 1) % n] || off[(k + n - 1) % n])
            fit->sector[k].weight = 0;
}

/* Once the fit has had its time, a sector that is out stays out: two that take turns would keep it
 * from settling. */
static void reweigh_sectors(struct edge_fit *fit, int step)
{
    const double scale = TUKEY * excess(fit);

    for (size_t k = 0; k < fit->sectors; k++) {
        struct sector *s = &fit->sector[k];
        const double z = s->off / (scale * sqrt(s->variance));

        const double weight = z * z < 1 ? pow(1 - z * z, 2) : 0;

        s->weight = step < FREELY ? weight : fmin(weight, s->weight);
    }
    gate(fit);
}

/* How much the tissue differs from sector to sector, beyond what noise alone would show. */
static void learn_spread(struct edge_fit *fit)
{
    double squares = 0, precision = 0, n = 0;

    /* By their precision: a sector that is mostly masked says little. */
    for (size_t k = 0; k < fit->sectors; k++) {
        const struct sector *s = &fit->sector[k];

        squares += s->weight * s->s[TISSUE][TISSUE] * s->own_b * s->own_b;
        precision += s->weight * s->s[TISSUE][TISSUE];
        n += s->weight;
    }
    if (!(precision > 0))
        return;
    fit->level_noise = n / precision;
    /* Three of them are the plane's. */
    fit->spread = fmax(squares / precision * n / fmax(n - 3, 1) - fit->level_noise,
                       1e-2 * fit->level_noise + 1e-8 * pow(contrast_of(fit), 2));
}

/* How lobed this outline is: an arc that is missing must not be made up by lobes that the rest of
 * the rim does not have. */
static void learn_lobes(struct edge_fit *fit, double h[UNKNOWNS][UNKNOWNS])
{
    double sum = 0, n = 0;

    for (int i = 3; i < 2 * fit->lobes + 1; i++) {
        sum += fit->v[i] * fit->v[i] + 1 / h[i][i];
        n += 1;
    }
    if (n > 0)
        fit->lobe = fmin(fmax(sqrt(sum / n), LOBE_LEAST * fit->v[R]), LOBE_SD * fit->v[R]);
}

static int legal(const struct edge_fit *fit)
{
    const double *v = fit->v;

    return v[R] > 0.4 * fit->radius && v[R] < 2.2 * fit->radius && v[V_BLUR] > 0.1 &&
           v[V_BLUR] < 1.2 * fit->radius && hypot(v[CX], v[CY]) < fit->radius &&
           contrast_of(fit) > 0;
}

static double clamp(double value, double most)
{
    return fmin(fmax(value, -most), most);
}

/* Gauss-Newton from the first look; whether it settled somewhere legal. ret_h is the information at
 * the end. */
static int descend(struct edge_fit *fit, double ret_h[UNKNOWNS][UNKNOWNS])
{
    double settled = INFINITY;

    for (int step = 0; step < STEPS; step++) {
        double h[UNKNOWNS][UNKNOWNS], by[UNKNOWNS];
        struct sums sums;

        accumulate(fit, &sums);
        assemble(fit, h, by);
        memcpy(ret_h, h, sizeof h);
        if (gsn_small_solve_spd(&h[0][0], by, UNKNOWNS) < 0)
            return 0;
        for (int i = 0; i < SHAPE; i++)
            by[i] = clamp(by[i], 0.15 * fit->v[R]);
        by[V_BLUR] = clamp(by[V_BLUR], 0.4 * fit->v[V_BLUR]);
        follow(fit, by);
        for (int i = 0; i < UNKNOWNS; i++)
            fit->v[i] += by[i];
        if (!legal(fit))
            return 0;
        reweigh_pixels(fit, &sums);
        if (step > 0)
            reweigh_sectors(fit, step);
        learn_spread(fit);
        if (step > 0)
            learn_lobes(fit, ret_h);
        settled = hypot(by[CX], by[CY]);
        /* The next step will be a tenth of it. */
        if (step > SETTLING && settled < 4e-3)
            return 1;
    }
    return settled < 0.05;
}

/* How much more than claimed the outline is off: the sectors' disagreement beyond the unknowns
 * spent on it, and as far as neighbours err together. */
static double inflation(const struct edge_fit *fit)
{
    double squares = 0, n = 0, sum = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct sector *s = &fit->sector[k];

        squares += s->weight * s->off * s->off / s->variance;
        n += s->weight;
        for (size_t lag = 1; lag <= 3; lag++) {
            const struct sector *o = &fit->sector[(k + lag) % fit->sectors];

            sum += sqrt(s->weight * o->weight / (s->variance * o->variance)) * s->off * o->off;
        }
    }
    if (!(squares > 0))
        return 1;
    return fmax(squares / fmax(n - 2 * fit->lobes - 1, 2), 1) * fmax(1 + 2 * sum / squares, 1);
}

static int covariance(const struct edge_fit *fit, double h[UNKNOWNS][UNKNOWNS],
                      struct gsn_mark *mark)
{
    const double larger = inflation(fit);
    double column[2][UNKNOWNS] = { { 0 } };

    for (int c = 0; c < 2; c++) {
        double a[UNKNOWNS][UNKNOWNS];

        memcpy(a, h, sizeof a);
        column[c][c] = 1;
        if (gsn_small_solve_spd(&a[0][0], column[c], UNKNOWNS) < 0)
            return 0;
    }
    mark->cov_xx = larger * column[0][CX];
    mark->cov_xy = larger * column[0][CY];
    mark->cov_yy = larger * column[1][CY];
    return 1;
}

/* Share of the variance around the mark that the fit explains, where the edge is the mark's. */
static double explained(const struct edge_fit *fit)
{
    const float reach = (float)(1.5 * fit->v[R]), disc = (float)fit->v[V_DISC];
    double sum = 0, squares = 0, left = 0, n = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct sector *s = &fit->sector[k];
        const float edge = (float)outline(fit, s), level = (float)plane_at(fit, s);

        for (size_t i = fit->first[k]; s->weight > 0 && i < fit->first[k + 1]; i++) {
            const struct sample *p = &fit->sample[i];
            const float dx = p->x - (float)fit->v[CX], dy = p->y - (float)fit->v[CY];
            const float r = sqrtf(dx * dx + dy * dy);
            float q, g, res;

            if (r > reach)
                continue;
            edge_at(fit, (r - edge) / (float)fit->v[V_BLUR], &q, &g);
            res = p->value - level * q - disc * (1 - q);
            sum += p->value;
            squares += p->value * p->value;
            left += res * res;
            n += 1;
        }
    }
    squares -= sum * sum / fmax(n, 1);
    return squares > 0 ? fmax(1 - left / squares, 0) : 0;
}

static double rim(const struct edge_fit *fit)
{
    double sum = 0;

    for (size_t k = 0; k < fit->sectors; k++)
        sum += fit->sector[k].weight;
    return sum / (double)fit->sectors;
}

/* Moves the origin to the circle just found, so that sectors are sectors of it. */
static void centre(struct edge_fit *fit)
{
    for (size_t i = 0; i < fit->count; i++) {
        fit->sample[i].x -= (float)fit->v[CX];
        fit->sample[i].y -= (float)fit->v[CY];
    }
    for (size_t k = 0; k < fit->sectors; k++) {
        struct sector *s = &fit->sector[k];

        s->edge += fit->v[R] -
                   hypot(fit->v[R] * s->cos[1] + fit->v[CX], fit->v[R] * s->sin[1] + fit->v[CY]);
    }
    fit->at_x += fit->v[CX];
    fit->at_y += fit->v[CY];
    fit->radius = fit->v[R];
    fit->v[CX] = fit->v[CY] = 0;
}

static void set_tolerance(struct edge_fit *fit)
{
    fit->tolerance = fmax(fmax(ROUGH * fit->radius, ROUGH_PX), 5 * jitter(fit));
}

/* Bends the circle of the majority to the edges that lie beside it, and to those that then do. */
static void bend(struct edge_fit *fit)
{
    const double belief = 1 / pow(LOBE_FIRST * fit->radius, 2);
    const double precision = 1 / pow(fmax(jitter(fit), EDGE_SD_PX), 2);

    for (int round = 0; round < LOOKS; round++) {
        const struct circle circle = { fit->v[CX], fit->v[CY], fit->v[R] };
        double h[UNKNOWNS][UNKNOWNS] = { { 0 } }, by[UNKNOWNS] = { 0 };

        for (int i = 0; i < UNKNOWNS; i++)
            h[i][i] = i < 3 ? 1e-9 : i < 2 * fit->lobes + 1 ? belief : 1;
        for (int i = 3; i < 2 * fit->lobes + 1; i++)
            by[i] = -belief * fit->v[i];
        for (size_t k = 0; k < fit->sectors; k++) {
            const struct sector *s = &fit->sector[k];
            const double off = beside(s, &circle) - outline(fit, s) + fit->v[R];
            double x[LOCAL][UNKNOWNS];

            if (!(fabs(off) < fit->tolerance))
                continue;
            spread_out(fit, s, x);
            for (int i = 0; i < 2 * fit->lobes + 1; i++) {
                by[i] += precision * off * x[SHIFT][i];
                for (int j = 0; j <= i; j++)
                    h[i][j] += precision * x[SHIFT][i] * x[SHIFT][j];
            }
        }
        if (gsn_small_solve_spd(&h[0][0], by, UNKNOWNS) < 0)
            return;
        for (int i = 0; i < 2 * fit->lobes + 1; i++)
            fit->v[i] += by[i];
    }
}

/* Twice, since a look from beside the centre sees some edges aslant. */
static int look(struct edge_fit *fit)
{
    set_angles(fit);
    for (int i = 0; i < 2; i++) {
        set_sectors(fit);
        look_for_edges(fit);
        set_tolerance(fit);
        if (!find_circle(fit))
            return 0;
        centre(fit);
    }
    set_sectors(fit);
    fit->lobes = fit->radius >= 8 ? LOBES : fit->radius >= 5 ? 2 : 1;
    for (size_t k = 0; k < fit->sectors; k++)
        fit->sector[k].weight = 1;
    bend(fit);
    gate(fit);
    return 1;
}

static int run(struct edge_fit *fit, struct gsn_mark *mark)
{
    double h[UNKNOWNS][UNKNOWNS];

    if (!look(fit))
        return 0;
    guess_levels(fit);
    make_tables(fit);
    if (!(contrast_of(fit) > CONTRAST_LEAST) || !descend(fit, h) || rim(fit) < RIM_LEAST)
        return 0;
    mark->radius_px = fit->v[R];
    mark->contrast = contrast_of(fit);
    mark->score = explained(fit);
    return mark->contrast >= CONTRAST_LEAST && mark->score >= SCORE_LEAST &&
           covariance(fit, h, mark);
}

int gsn_mark_edge_fit(const struct gsn_plane *plane, struct gsn_point start, double radius_px,
                      struct gsn_mark *ret_mark, struct gsn_error *err)
{
    const size_t side = (size_t)ceil(2 * REACH * radius_px) + 3;
    gsn_auto_mem(struct sample) samples = gsn_alloc_array(2 * side * side, sizeof *samples);
    gsn_auto_mem(struct edge_fit) fit = gsn_alloc_array(1, sizeof *fit);
    struct gsn_mark mark = { 0 };

    assert(plane && radius_px > 0 && ret_mark);

    if (!samples || !fit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    fit->sample = samples;
    fit->radius = radius_px;
    fit->sectors =
        (size_t)fmin(fmax(2 * M_PI * radius_px / SECTOR_PX, SECTORS_LEAST), SECTORS_MOST);
    *ret_mark = (struct gsn_mark){ 0 };
    if (!gather(plane, start, fit) || !run(fit, &mark))
        return GSN_OK;
    mark.px =
        (struct gsn_point){ start.x + fit->at_x + fit->v[CX], start.y + fit->at_y + fit->v[CY] };
    mark.found = 1;
    *ret_mark = mark;
    return GSN_OK;
}
