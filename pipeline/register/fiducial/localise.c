/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: maximum likelihood fit of a blurred disc in a pale ring by Levenberg and Marquardt's
 * steps, damped by the gain ratio (Nielsen 1999), with weak priors on what the picture may say
 * nothing of.
 *
 * Steps of gsn_fiducial_localise(). A mark of 6 pixels or more goes to contour.h. Below that: 1.
 * pixels within reach are gathered, levels guessed; 2. three rounds: the variance of a pixel is
 * that of the scanner plus the tissue's as far as it comes through, both read off the residuals,
 * then a descent; 3. the score is the share of the variance explained, the covariance the inverse
 * of the information, larger by the residuals' correlation between pixels; 4. where it explains too
 * little, the same is tried on pixels stretched as an oval's (oval.h).
 *
 * Fails when memory runs out; a fit that runs away, does not settle or explains too little is a
 * mark that is not found. */
#include "pipeline/register/fiducial/localise.h"

#include "pipeline/core/linalg.h"
#include "pipeline/register/fiducial/contour.h"
#include "pipeline/register/fiducial/oval.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* CX, CY are relative to the start; B = B0 + BX x + BY y with x, y from the start in units of the
 * starting radius, so that all parameters are of order one or a few pixels. */
enum { CX, CY, R, S, M, B0, BX, BY, P, RING, UNKNOWNS };

/* From this radius on, px, the rim has sectors enough to speak for themselves. */
static const double EDGE_FROM = 6;
enum { ROUNDS = 3, STEPS = 100, LAG = 2 };

/* The ring's outer radius and the blur, in radii of the disc, as far as the picture says nothing:
 * weak beliefs that keep the fit well posed when there is no ring. */
static const double RING_MEAN = 1.5, RING_SD = 0.25, BLUR_MEAN = 0.2, BLUR_SD = 0.3;
static const double BLEACH_SD = 0.7;
/* A relative gain in the sum of squares that no longer matters: with the few hundred pixels of a
 * mark, a step of some thousandths of the centre's standard deviation. */
static const double SETTLED = 1e-8;
/* Less contrast than this is rounding, and a disc that explains less of the picture is none. */
static const double CONTRAST_LEAST = 1e-4, SCORE_LEAST = 0.25;
/* An oval is believed where it leaves less than this share unexplained of what a disc leaves. */
static const double OVAL_LEAVES = 0.5;
/* Beyond this many blurs from an edge it is over, to eleven digits. */
static const double FAR = 7;
static const double LAMBDA_FIRST = 1e-3, LAMBDA_MOST = 1e8;

struct pixel {
    int column, row;
    double x, y; /* centre, from the start */
    double value, weight;
    double residual; /* in standard deviations, once fitted */
};

struct window {
    struct pixel *pixel;
    size_t count;
    double radius; /* starting radius, px */
};

struct shape {
    double a;           /* share of the disc, 1 - q */
    double t;           /* share of the tissue that comes through, q - p e q^2 */
    double model;       /* f */
    double d[UNKNOWNS]; /* df / d parameter */
};

/* Phi((r - edge) / s), and its derivatives with respect to r and s. */
static double edge_of(double r, double edge, double s, double *ret_dr, double *ret_ds)
{
    const double u = (r - edge) / s;
    double g;

    if (fabs(u) > FAR) {
        *ret_dr = *ret_ds = 0;
        return u > 0 ? 1 : 0;
    }
    g = exp(-0.5 * u * u) / (sqrt(2 * M_PI) * s);

    *ret_dr = g;
    *ret_ds = -g * u;
    return 0.5 * erfc(-u / M_SQRT2);
}

static struct shape shape_at(const struct pixel *px, const double *v, double radius)
{
    const double dx = px->x - v[CX], dy = px->y - v[CY];
    const double r = fmax(hypot(dx, dy), 1e-9);
    const double bx = px->x / radius, by = px->y / radius;
    const double b = v[B0] + v[BX] * bx + v[BY] * by;
    double q_r, q_s, o_r, o_s;
    const double q = edge_of(r, v[R], v[S], &q_r, &q_s);
    const double e = 1 - edge_of(r, v[RING], v[S], &o_r, &o_s);
    const double t = q - v[P] * e * q * q;
    const double by_q = b * (1 - 2 * v[P] * e * q) - v[M];
    const double by_e = -b * v[P] * q * q;
    const double by_r = by_q * q_r - by_e * o_r;

    return (struct shape){ .a = 1 - q,
                           .t = t,
                           .model = b * t + v[M] * (1 - q),
                           .d = { [CX] = -by_r * dx / r,
                                  [CY] = -by_r * dy / r,
                                  [R] = -by_q * q_r,
                                  [S] = by_q * q_s - by_e * o_s,
                                  [M] = 1 - q,
                                  [B0] = t,
                                  [BX] = t * bx,
                                  [BY] = t * by,
                                  [P] = -b * e * q * q,
                                  [RING] = by_e * o_r } };
}

/* The weak beliefs, as residuals in standard deviations with their derivatives. */
struct belief {
    int of, per; /* parameter; its radius (R) or -1 */
    double mean, sd;
};

static const struct belief BELIEFS[] = {
    { RING, R, RING_MEAN, RING_SD },
    { S, R, BLUR_MEAN, BLUR_SD },
    { P, -1, 0, BLEACH_SD },
};

static double add_beliefs(const double *v, double h[UNKNOWNS][UNKNOWNS], double *g)
{
    double cost = 0;

    for (size_t i = 0; i < sizeof BELIEFS / sizeof *BELIEFS; i++) {
        const struct belief *b = &BELIEFS[i];
        const double scale = b->per < 0 ? 1 : v[b->per];
        const double res = (v[b->of] - b->mean * scale) / (b->sd * scale);
        const double d = 1 / (b->sd * scale);

        /* The dependence on the radius is left out of the slope: the belief then pulls the ring
         * and the blur, never the disc. */
        cost += res * res;
        if (h) {
            h[b->of][b->of] += d * d;
            g[b->of] -= d * res;
        }
    }
    return cost;
}

/* Sum of weighted squares; with h and g also J^T W J and J^T W (value - model). */
static double normal_equations(const struct window *w, const double *v,
                               double h[UNKNOWNS][UNKNOWNS], double *g)
{
    double cost = 0;

    if (h) {
        memset(h, 0, UNKNOWNS * sizeof *h);
        memset(g, 0, UNKNOWNS * sizeof *g);
    }
    for (size_t i = 0; i < w->count; i++) {
        const struct pixel *px = &w->pixel[i];
        const struct shape shape = shape_at(px, v, w->radius);
        const double res = px->value - shape.model;

        cost += px->weight * res * res;
        for (int j = 0; h && j < UNKNOWNS; j++) {
            const double wd = px->weight * shape.d[j];

            g[j] += wd * res;
            for (int k = 0; k <= j; k++)
                h[j][k] += wd * shape.d[k];
        }
    }
    return cost + add_beliefs(v, h, g);
}

static int is_legal(const struct window *w, const double *v)
{
    return v[R] > 0.4 * w->radius && v[R] < 2.2 * w->radius && v[S] > 0.1 &&
           v[S] < 1.2 * w->radius && v[RING] > v[R] && v[P] < 1 && v[P] > -1 &&
           hypot(v[CX], v[CY]) < w->radius;
}

/* What a step by should gain if the model were linear: by . (lambda D by + g). */
static double promised_gain(double h[UNKNOWNS][UNKNOWNS], const double *g, double lambda,
                            const double *by)
{
    double sum = 0;

    for (int j = 0; j < UNKNOWNS; j++)
        sum += by[j] * (lambda * h[j][j] * by[j] + g[j]);
    return sum;
}

/* Levenberg-Marquardt from v, damped by how well each step kept its promise (Nielsen 1999); whether
 * it settled. */
static int descend_from(const struct window *w, double *v)
{
    double h[UNKNOWNS][UNKNOWNS], g[UNKNOWNS];
    double lambda = LAMBDA_FIRST, raise = 2;
    double cost = normal_equations(w, v, h, g);

    for (int step = 0; step < STEPS && lambda < LAMBDA_MOST; step++) {
        double a[UNKNOWNS][UNKNOWNS], trial[UNKNOWNS], by[UNKNOWNS], after = INFINITY, kept;

        memcpy(a, h, sizeof a);
        memcpy(by, g, sizeof by);
        for (int j = 0; j < UNKNOWNS; j++)
            a[j][j] += lambda * h[j][j];
        if (gsn_solve_spd(&a[0][0], UNKNOWNS, UNKNOWNS, by) >= 0) {
            for (int j = 0; j < UNKNOWNS; j++)
                trial[j] = v[j] + by[j];
            if (is_legal(w, trial))
                after = normal_equations(w, trial, NULL, NULL);
        }
        if (!(after < cost)) {
            lambda *= raise;
            raise *= 2;
            continue;
        }
        kept = (cost - after) / promised_gain(h, g, lambda, by);
        lambda *= fmax(1.0 / 3, 1 - pow(2 * kept - 1, 3));
        raise = 2;
        memcpy(v, trial, sizeof trial);
        if (cost - after <= SETTLED * cost)
            return 1;
        cost = normal_equations(w, v, h, g);
    }
    /* No step however small helps: this is the bottom, to rounding. */
    return lambda >= LAMBDA_MOST;
}

/* The variance of a pixel is that of the scanner plus the tissue's as far as it comes through; both
 * are read off the residuals. Weights are the inverse, so that a smooth disc in a rough tissue is
 * measured by its inner edge. */
static void reweigh_pixels(const struct window *w, const double *v)
{
    double inner = 0, inner_n = 0, outer = 0, outer_n = 0, outer_t = 0, noise, tissue;

    for (size_t i = 0; i < w->count; i++) {
        const struct shape shape = shape_at(&w->pixel[i], v, w->radius);
        const double res = w->pixel[i].value - shape.model;

        if (shape.t < 0.25) {
            inner += res * res;
            inner_n += 1;
        } else {
            outer += res * res;
            outer_t += shape.t * shape.t;
            outer_n += 1;
        }
    }
    inner = inner / fmax(inner_n - 2, 1);
    outer_t = outer_t / fmax(outer_n, 1);
    outer = outer / fmax(outer_n - 5, 1);
    /* A disc drawn without any noise must not silence everything else. */
    noise = fmax(fmin(inner, outer), 0.01 * outer);
    noise = fmax(noise, 1e-10 * (1 + v[M] * v[M]));
    tissue = outer_t > 0 ? fmax(outer - noise, 0) / outer_t : 0;
    for (size_t i = 0; i < w->count; i++) {
        const double t = shape_at(&w->pixel[i], v, w->radius).t;

        w->pixel[i].weight = 1 / (noise + tissue * t * t);
    }
}

/* How much more neighbouring pixels' residuals vary together than alone: 1 for white noise. */
static double correlate_residuals(const struct window *w, const double *v)
{
    double together = 0, alone = 0;

    for (size_t i = 0; i < w->count; i++) {
        struct pixel *p = &w->pixel[i];

        p->residual = (p->value - shape_at(p, v, w->radius).model) * sqrt(p->weight);
        alone += p->residual * p->residual;
    }
    for (size_t i = 0; i < w->count; i++) {
        const struct pixel *p = &w->pixel[i];

        for (size_t j = i + 1; j < w->count && w->pixel[j].row <= p->row + LAG; j++) {
            const struct pixel *o = &w->pixel[j];

            if (abs(o->column - p->column) <= LAG)
                together += p->residual * o->residual;
        }
    }
    return alone > 0 ? fmax(1 + 2 * together / alone, 1) : 1;
}

/* Share of the window's variance that the fit explains. */
static double share_explained(const struct window *w, const double *v)
{
    double sum = 0, squares = 0, left = 0;
    const double n = (double)w->count;

    for (size_t i = 0; i < w->count; i++) {
        const double value = w->pixel[i].value;
        const double res = value - shape_at(&w->pixel[i], v, w->radius).model;

        sum += value;
        squares += value * value;
        left += res * res;
    }
    squares -= sum * sum / n;
    return squares > 0 ? fmax(1 - left / squares, 0) : 0;
}

/* The 2 x 2 block of the inverse of J^T W J that belongs to the centre. */
static int find_covariance(const struct window *w, const double *v, struct gsn_fiducial *mark)
{
    double h[UNKNOWNS][UNKNOWNS], g[UNKNOWNS], column[2][UNKNOWNS];
    const double inflation = correlate_residuals(w, v);

    (void)normal_equations(w, v, h, g);
    for (int c = 0; c < 2; c++) {
        double a[UNKNOWNS][UNKNOWNS];

        memcpy(a, h, sizeof a);
        memset(column[c], 0, sizeof column[c]);
        column[c][c == 0 ? CX : CY] = 1;
        if (gsn_solve_spd(&a[0][0], UNKNOWNS, UNKNOWNS, column[c]) < 0)
            return 0;
    }
    mark->cov_xx = inflation * column[0][CX];
    mark->cov_xy = inflation * column[0][CY];
    mark->cov_yy = inflation * column[1][CY];
    return 1;
}

/* Pixels within reach of the start; whether at least half of the disc is among them. */
static int gather_pixels(const struct gsn_plane *plane, struct gsn_point start,
                         const struct gsn_oval_stretch *by, struct window *w)
{
    const double reach = GSN_LOCALISE_REACH * w->radius;
    const double far = by ? reach * sqrt(gsn_oval_axes_max) : reach;
    const int x0 = (int)fmax(floor(start.x - far), 0), y0 = (int)fmax(floor(start.y - far), 0);
    const int x1 = (int)fmin(ceil(start.x + far), plane->width);
    const int y1 = (int)fmin(ceil(start.y + far), plane->height);
    double disc = 0;

    for (int y = y0; y < y1; y++) {
        for (int x = x0; x < x1; x++) {
            const float value = plane->value[(size_t)y * plane->width + (size_t)x];
            const double right = x + 0.5 - start.x, down = y + 0.5 - start.y;
            const double dx = by ? by->xx * right + by->xy * down : right;
            const double dy = by ? by->xy * right + by->yy * down : down;
            const double r = hypot(dx, dy);

            if (r > reach || !isfinite(value))
                continue;
            if (r <= w->radius)
                disc += 1;
            w->pixel[w->count++] = (struct pixel){
                .column = x, .row = y, .x = dx, .y = dy, .value = value, .weight = 1
            };
        }
    }
    return disc >= 0.5 * M_PI * w->radius * w->radius && w->count > 3 * UNKNOWNS;
}

static void guess_unknowns(const struct window *w, double *v)
{
    double in = 0, in_n = 0, out = 0, out_n = 0;

    for (size_t i = 0; i < w->count; i++) {
        const double r = hypot(w->pixel[i].x, w->pixel[i].y) / w->radius;

        if (r < 0.6) {
            in += w->pixel[i].value;
            in_n += 1;
        } else if (r > 1.7) {
            out += w->pixel[i].value;
            out_n += 1;
        }
    }
    memset(v, 0, UNKNOWNS * sizeof *v);
    v[M] = in / fmax(in_n, 1);
    v[B0] = out / fmax(out_n, 1);
    v[R] = w->radius;
    v[S] = fmax(BLUR_MEAN * w->radius, 0.3);
    v[RING] = RING_MEAN * w->radius;
    v[P] = 0.1;
}

/* stretch: NULL for a round mark. pixels has room for all within reach. */
static struct gsn_fiducial fit_disc(const struct gsn_plane *plane, struct gsn_point start,
                                    double radius_px, const struct gsn_oval_stretch *stretch,
                                    struct pixel *pixels)
{
    struct window w = { .pixel = pixels, .radius = radius_px };
    struct gsn_fiducial mark = { 0 };
    double v[UNKNOWNS];
    int settled = 1;

    if (!gather_pixels(plane, start, stretch, &w))
        return mark;
    guess_unknowns(&w, v);
    for (int round = 0; round < ROUNDS && settled; round++) {
        reweigh_pixels(&w, v);
        settled = descend_from(&w, v);
    }
    mark.radius_px = v[R];
    mark.contrast = v[M] - (v[B0] + (v[BX] * v[CX] + v[BY] * v[CY]) / w.radius);
    mark.score = share_explained(&w, v);
    if (!settled || !(mark.contrast >= CONTRAST_LEAST) || !(mark.score >= SCORE_LEAST) ||
        !find_covariance(&w, v, &mark))
        return (struct gsn_fiducial){ 0 };
    mark.px = (struct gsn_point){ v[CX], v[CY] };
    if (stretch)
        gsn_oval_unstretch(stretch, &mark);
    mark.px = (struct gsn_point){ start.x + mark.px.x, start.y + mark.px.y };
    mark.found = 1;
    return mark;
}

static int fit_small(const struct gsn_plane *plane, struct gsn_point start, double radius_px,
                     struct gsn_fiducial *ret_mark, struct gsn_error *err)
{
    /* An oval may be 1.6 times as large as was thought. */
    const size_t side = (size_t)ceil(1.6 * 2 * GSN_LOCALISE_REACH * radius_px) + 3;
    gsn_auto_mem(struct pixel) pixels = gsn_alloc_array(side * side, sizeof *pixels);
    struct gsn_oval_stretch stretch;
    struct gsn_fiducial mark, oval;

    if (!pixels)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    mark = fit_disc(plane, start, radius_px, NULL, pixels);
    if (mark.score < gsn_oval_round_score && gsn_oval_find(plane, &start, &radius_px, &stretch)) {
        oval = fit_disc(plane, start, radius_px, &stretch, pixels);
        if (1 - oval.score < OVAL_LEAVES * (1 - mark.score))
            mark = oval;
    }
    *ret_mark = mark;
    return GSN_OK;
}

int gsn_fiducial_localise(const struct gsn_plane *plane, struct gsn_point start, double radius_px,
                          struct gsn_fiducial *ret_mark, struct gsn_error *err)
{
    assert(plane && radius_px > 0 && ret_mark);

    return radius_px >= EDGE_FROM ? gsn_contour_fit(plane, start, radius_px, ret_mark, err)
                                  : fit_small(plane, start, radius_px, ret_mark, err);
}
