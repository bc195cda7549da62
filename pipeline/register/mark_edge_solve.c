/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_edge_fit.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

enum { CX = GSN_EDGE_CX, CY = GSN_EDGE_CY, R = GSN_EDGE_R, SHAPE = GSN_EDGE_SHAPE };
enum { V_BLUR = GSN_EDGE_BLUR, V_DISC, V_B0, V_BX, V_BY, UNKNOWNS };
enum { SHIFT = GSN_SECTOR_SHIFT, BLUR, DISC, TISSUE, LOCAL };
enum { STEPS = 16, SETTLING = 2, FREELY = 6 };

/* A burn's outline is round to some per cent of its radius (one standard deviation per lobe). */
static const double LOBE_SD = 0.04, LOBE_LEAST = 0.002;
/* Where Tukey's biweight cuts off, in standard deviations: 98 % efficient when nothing is wrong. */
static const double TUKEY = 6;

const int gsn_edge_moves[UNKNOWNS] = { SHIFT, SHIFT, SHIFT, SHIFT, SHIFT,  SHIFT,  SHIFT,
                                       SHIFT, SHIFT, BLUR,  DISC,  TISSUE, TISSUE, TISSUE };

double gsn_edge_contrast(const struct gsn_edge_fit *fit)
{
    return fit->v[V_DISC] - fit->v[V_B0];
}

double gsn_edge_outline(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *sector)
{
    double r = fit->v[R];

    for (int m = 2; m <= fit->lobes; m++)
        r += fit->v[2 * m - 1] * sector->cos[m] + fit->v[2 * m] * sector->sin[m];
    return r;
}

double gsn_edge_plane(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *sector)
{
    return fit->v[V_B0] + fit->v[V_BX] * sector->cos[1] + fit->v[V_BY] * sector->sin[1];
}

void gsn_edge_slopes(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *sector,
                     double ret_slope[UNKNOWNS])
{
    memset(ret_slope, 0, UNKNOWNS * sizeof *ret_slope);
    ret_slope[CX] = ret_slope[V_BX] = sector->cos[1];
    ret_slope[CY] = ret_slope[V_BY] = sector->sin[1];
    ret_slope[R] = ret_slope[V_BLUR] = ret_slope[V_DISC] = ret_slope[V_B0] = 1;
    for (int m = 2; m <= fit->lobes; m++) {
        ret_slope[2 * m - 1] = sector->cos[m];
        ret_slope[2 * m] = sector->sin[m];
    }
}

/* Takes b_k out of a sector's equations: it is normal with variance spread. */
static void eliminate(const struct gsn_edge_fit *fit, const struct gsn_edge_sector *s,
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
static void assemble(const struct gsn_edge_fit *fit, gsn_edge_matrix h, double *g)
{
    const double lobe = 1 / (fit->lobe * fit->lobe);

    memset(h, 0, UNKNOWNS * sizeof *h);
    memset(g, 0, UNKNOWNS * sizeof *g);
    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_edge_sector *s = &fit->sector[k];
        double m[LOCAL][LOCAL], t[LOCAL], slope[UNKNOWNS];

        if (s->weight <= 0)
            continue;
        eliminate(fit, s, m, t);
        gsn_edge_slopes(fit, s, slope);
        for (int i = 0; i < UNKNOWNS; i++) {
            const double weight = s->weight * slope[i];
            const double *row = m[gsn_edge_moves[i]];

            g[i] += weight * t[gsn_edge_moves[i]];
            for (int j = 0; j <= i; j++)
                h[i][j] += weight * row[gsn_edge_moves[j]] * slope[j];
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
static void follow(struct gsn_edge_fit *fit, const double *by)
{
    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_edge_sector *s = &fit->sector[k];
        const double belief = 1 / fit->spread, pivot = s->s[TISSUE][TISSUE] + belief;
        double m[LOCAL][LOCAL], t[LOCAL], slope[UNKNOWNS], d[LOCAL] = { 0 };
        double tissue = s->t[TISSUE] - belief * s->b;

        eliminate(fit, s, m, t);
        gsn_edge_slopes(fit, s, slope);
        for (int j = 0; j < UNKNOWNS; j++)
            d[gsn_edge_moves[j]] += slope[j] * by[j];
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
static void reweigh_pixels(struct gsn_edge_fit *fit, const struct gsn_edge_sums *sums)
{
    const double inner = sums->inner / fmax(sums->inner_n - 2, 1);
    const double outer = sums->outer / fmax(sums->outer_n - 5, 1);
    const double least = 1e-10 * pow(gsn_edge_contrast(fit), 2);

    /* A disc drawn without any noise must not silence everything else. */
    fit->noise = fmax(fmax(fmin(inner, outer), 0.01 * outer), fmax(least, 1e-30));
    fit->tissue =
        sums->outer_q > 0 ? fmax(outer - fit->noise, 0) * sums->outer_n / sums->outer_q : 0;
}

/* How much larger than their own claim the deviations of the sectors are, robustly. */
static double excess(const struct gsn_edge_fit *fit)
{
    double off[GSN_EDGE_SECTORS];
    size_t n = 0;

    for (size_t k = 0; k < fit->sectors; k++)
        if (isfinite(fit->sector[k].variance) && fit->sector[k].weight > 0)
            off[n++] = fabs(fit->sector[k].off) / sqrt(fit->sector[k].variance);
    return n > 0 ? fmax(1.4826 * gsn_median(off, n), 1) : 1;
}

/* Once the fit has had its time, a sector that is out stays out: two that take turns would keep it
 * from settling. */
static void reweigh_sectors(struct gsn_edge_fit *fit, int step)
{
    const double scale = TUKEY * excess(fit);

    for (size_t k = 0; k < fit->sectors; k++) {
        struct gsn_edge_sector *s = &fit->sector[k];
        const double z2 = s->off * s->off / (scale * scale * s->variance);
        const double weight = z2 < 1 ? (1 - z2) * (1 - z2) : 0;

        s->weight = step < FREELY && !fit->near ? weight : fmin(weight, s->weight);
    }
    gsn_edge_gate(fit);
}

/* How much the tissue differs from sector to sector, beyond what noise alone would show. */
static void learn_spread(struct gsn_edge_fit *fit)
{
    double squares = 0, precision = 0, n = 0;

    /* By their precision: a sector that is mostly masked says little. */
    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_edge_sector *s = &fit->sector[k];

        squares += s->weight * s->s[TISSUE][TISSUE] * s->own_b * s->own_b;
        precision += s->weight * s->s[TISSUE][TISSUE];
        n += s->weight;
    }
    if (!(precision > 0))
        return;
    fit->level_noise = n / precision;
    /* Three of them are the plane's. */
    fit->spread = fmax(squares / precision * n / fmax(n - 3, 1) - fit->level_noise,
                       1e-2 * fit->level_noise + 1e-8 * pow(gsn_edge_contrast(fit), 2));
}

/* How lobed this outline is: an arc that is missing must not be made up by lobes that the rest of
 * the rim does not have. */
static void learn_lobes(struct gsn_edge_fit *fit, gsn_edge_matrix h)
{
    double sum = 0, n = 0;

    for (int i = 3; i < 2 * fit->lobes + 1; i++) {
        sum += fit->v[i] * fit->v[i] + 1 / h[i][i];
        n += 1;
    }
    if (n > 0)
        fit->lobe = fmin(fmax(sqrt(sum / n), LOBE_LEAST * fit->v[R]), LOBE_SD * fit->v[R]);
}

/* ---- steps ----------------------------------------------------------------------------------- */

static int legal(const struct gsn_edge_fit *fit)
{
    const double *v = fit->v;

    return v[R] > 0.4 * fit->radius && v[R] < 2.2 * fit->radius && v[V_BLUR] > 0.1 &&
           v[V_BLUR] < 1.2 * fit->radius && hypot(v[CX], v[CY]) < fit->radius &&
           gsn_edge_contrast(fit) > 0;
}

static double clamp(double value, double most)
{
    return fmin(fmax(value, -most), most);
}

int gsn_edge_descend(struct gsn_edge_fit *fit, gsn_edge_matrix ret_h)
{
    double settled = INFINITY;

    for (int step = 0; step < STEPS; step++) {
        gsn_edge_matrix h;
        double by[UNKNOWNS];
        struct gsn_edge_sums sums;

        /* Not after the last step: h is then of the lobes believed in. */
        if (step > 1)
            learn_lobes(fit, ret_h);
        gsn_edge_accumulate(fit, &sums);
        assemble(fit, h, by);
        memcpy(ret_h, h, sizeof h);
        if (gsn_solve_spd(&h[0][0], UNKNOWNS, UNKNOWNS, by) < 0)
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
        settled = hypot(by[CX], by[CY]);
        /* The next step will be a tenth of it. */
        if (fit->near && settled < 4e-3)
            return 1;
        fit->near = fit->near || (step >= SETTLING && settled < 4e-2);
    }
    return settled < 0.05;
}
