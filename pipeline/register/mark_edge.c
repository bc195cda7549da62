/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_edge.h"

#include "pipeline/core/linalg.h"
#include "pipeline/register/mark_edge_fit.h"
#include "pipeline/register/mark_oval.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { CX = GSN_EDGE_CX, CY = GSN_EDGE_CY, R = GSN_EDGE_R, UNKNOWNS = GSN_EDGE_UNKNOWNS };
enum { V_BLUR = GSN_EDGE_BLUR, V_DISC = GSN_EDGE_DISC, V_B0 = GSN_EDGE_B0 };
enum { SECTORS_LEAST = 8, FLOATS = 6 };

/* Width of a sector along the rim, px: two to three pixels across carry one edge. */
static const double SECTOR_PX = 2.5;
/* A burn's outline is round to some per cent of its radius. */
static const double LOBE_FIRST = 0.015;
/* Fewer sectors than this share of the rim that agree are no round edge. */
static const double RIM_LEAST = 0.4;
static const double CONTRAST_LEAST = 1e-4, SCORE_LEAST = 0.25;
/* An oval is believed where it leaves less than this share unexplained of what a round outline
 * leaves, and so much of its rim agrees. */
static const double OVAL_LEAVES = 0.5, OVAL_RIM = 0.85;

/* Pixels within reach of the start; whether at least half of the disc is among them. */
static int gather(const struct gsn_plane *plane, struct gsn_point start, struct gsn_edge_fit *fit)
{
    const double reach = GSN_EDGE_REACH * fit->radius, disc2 = fit->radius * fit->radius;
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
static int gather_stretched(const struct gsn_plane *plane, struct gsn_point start,
                            const struct gsn_mark_stretch *by, struct gsn_edge_fit *fit)
{
    const double reach = GSN_EDGE_REACH * fit->radius, disc2 = fit->radius * fit->radius;
    /* The longer half axis of what is stretched to a circle. */
    const double far = reach * sqrt(gsn_mark_oval_most);
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
static struct gsn_edge_ring between(const struct gsn_edge_fit *fit, double from, double to)
{
    struct gsn_edge_ring all = { 0 };

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_edge_ring ring =
            gsn_edge_rings(fit, k, (int)round(from * fit->v[R] / fit->width),
                           (int)round(to * fit->v[R] / fit->width));

        if (fit->sector[k].weight == 0)
            continue;
        all.n += ring.n;
        all.sum += ring.sum;
    }
    return all;
}

static void guess_levels(struct gsn_edge_fit *fit)
{
    const struct gsn_edge_ring in = between(fit, 0.5, 0.85), out = between(fit, 1.2, 1.5);

    fit->v[V_DISC] = in.sum / fmax(in.n, 1);
    fit->v[V_B0] = out.sum / fmax(out.n, 1);
    fit->v[V_BLUR] = fmax(0.08 * fit->v[R], 0.7);
    fit->noise = 1;
    fit->lobe = LOBE_FIRST * fit->v[R];
    fit->spread = fit->level_noise = pow(0.05 * gsn_edge_contrast(fit), 2);
}

/* How much more than claimed the outline is off: the sectors' disagreement beyond the unknowns
 * spent on it, and as far as neighbours err together. What is claimed counts as much as what a rim
 * of sectors that err by it would show, since some thirty squares alone are known to a quarter. */
static double inflation(const struct gsn_edge_fit *fit)
{
    const double claimed = (double)fit->sectors;
    double squares = 0, n = 0, sum = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_edge_sector *s = &fit->sector[k];

        squares += s->weight * s->off * s->off / s->variance;
        n += s->weight;
        for (size_t lag = 1; lag <= 3; lag++) {
            const struct gsn_edge_sector *o = &fit->sector[(k + lag) % fit->sectors];

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
static double unevenness(const struct gsn_edge_fit *fit)
{
    double squares = 0, n = 0;

    for (size_t k = 0; k < fit->sectors; k++) {
        const struct gsn_edge_sector *s = &fit->sector[k];
        const double information = s->s[GSN_SECTOR_DISC][GSN_SECTOR_DISC];

        if (!(s->weight > 0 && information > 0))
            continue;
        squares += s->weight * pow(s->t[GSN_SECTOR_DISC], 2) / information;
        n += s->weight;
    }
    return fmax(squares / fmax(n - 1, 1), 1);
}

/* Part of the centre's covariance that is what its lobes may be as far as the rim says nothing. */
static double by_belief(const struct gsn_edge_fit *fit, const double *a, const double *b)
{
    double sum = 0;

    for (int i = R + 1; i < 2 * fit->lobes + 1; i++)
        sum += a[i] * b[i];
    return sum / (fit->lobe * fit->lobe);
}

/* The inverse of the information; larger where the sectors say so, but for what is belief. */
static int covariance(const struct gsn_edge_fit *fit, gsn_edge_matrix h, struct gsn_mark *mark)
{
    const double larger = inflation(fit) * unevenness(fit);
    double column[2][UNKNOWNS] = { { 0 } };

    for (int c = 0; c < 2; c++) {
        gsn_edge_matrix a;

        memcpy(a, h, sizeof a);
        column[c][c] = 1;
        if (gsn_solve_spd(&a[0][0], UNKNOWNS, UNKNOWNS, column[c]) < 0)
            return 0;
    }
    mark->cov_xx = larger * column[0][CX] - (larger - 1) * by_belief(fit, column[0], column[0]);
    mark->cov_xy = larger * column[0][CY] - (larger - 1) * by_belief(fit, column[0], column[1]);
    mark->cov_yy = larger * column[1][CY] - (larger - 1) * by_belief(fit, column[1], column[1]);
    return 1;
}

static double rim(const struct gsn_edge_fit *fit)
{
    double sum = 0;

    for (size_t k = 0; k < fit->sectors; k++)
        sum += fit->sector[k].weight;
    return sum / (double)fit->sectors;
}

static int run(struct gsn_edge_fit *fit, struct gsn_mark *mark)
{
    gsn_edge_matrix h;

    if (!gsn_edge_look(fit))
        return 0;
    guess_levels(fit);
    gsn_edge_learn_tissue(fit);
    if (!(gsn_edge_contrast(fit) > CONTRAST_LEAST) || !gsn_edge_descend(fit, h) ||
        rim(fit) < RIM_LEAST)
        return 0;
    mark->radius_px = fit->v[R];
    mark->contrast = gsn_edge_contrast(fit);
    mark->score = gsn_edge_explained(fit);
    return mark->contrast >= CONTRAST_LEAST && mark->score >= SCORE_LEAST &&
           covariance(fit, h, mark);
}

/* One fit; stretch: NULL for a round mark. Returns the share of the rim that agrees, or 0. */
static double fit_outline(struct gsn_edge_fit *fit, const struct gsn_plane *plane,
                          struct gsn_point start, double radius_px,
                          const struct gsn_mark_stretch *stretch, struct gsn_mark *ret_mark)
{
    struct gsn_mark mark = { 0 };

    fit->radius = radius_px;
    fit->sectors =
        (size_t)fmin(fmax(2 * M_PI * radius_px / SECTOR_PX, SECTORS_LEAST), GSN_EDGE_SECTORS);
    if (!(stretch ? gather_stretched(plane, start, stretch, fit) : gather(plane, start, fit)) ||
        !run(fit, &mark))
        return 0;
    mark.px = (struct gsn_point){ fit->at_x + fit->v[CX], fit->at_y + fit->v[CY] };
    if (stretch)
        gsn_mark_unstretch(stretch, &mark);
    mark.px.x += start.x;
    mark.px.y += start.y;
    mark.found = 1;
    *ret_mark = mark;
    return rim(fit);
}

/* What the fit is worked in. */
static void clear(struct gsn_edge_fit *fit, float *floats, int *cells, size_t room)
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

int gsn_mark_edge_fit(const struct gsn_plane *plane, struct gsn_point start, double radius_px,
                      struct gsn_mark *ret_mark, struct gsn_error *err)
{
    /* An oval may be 1.6 times as large as was thought. */
    const size_t side = (size_t)ceil(1.6 * 2 * GSN_EDGE_REACH * radius_px) + 3, room = side * side;
    gsn_auto_mem(float) floats = gsn_alloc(FLOATS * room * sizeof *floats);
    gsn_auto_mem(int) cells = gsn_alloc(room * sizeof *cells);
    gsn_auto_mem(struct gsn_edge_fit) fit = gsn_alloc_array(1, sizeof *fit);
    struct gsn_mark mark = { 0 }, oval = { 0 };
    struct gsn_mark_stretch stretch;

    assert(plane && radius_px > 0 && ret_mark);

    if (!floats || !cells || !fit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    clear(fit, floats, cells, room);
    (void)fit_outline(fit, plane, start, radius_px, NULL, &mark);
    if (mark.score < gsn_mark_round_score &&
        gsn_mark_find_oval(plane, &start, &radius_px, &stretch)) {
        clear(fit, floats, cells, room);
        if (fit_outline(fit, plane, start, radius_px, &stretch, &oval) >= OVAL_RIM &&
            1 - oval.score < OVAL_LEAVES * (1 - mark.score))
            mark = oval;
    }
    *ret_mark = mark;
    return GSN_OK;
}
