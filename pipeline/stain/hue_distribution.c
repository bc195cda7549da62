/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A histogram of hues, and the edge of their cloud seen from the control through the treated
 * tissue.
 *
 * Counting goes into a dense table of bins while cells pass; afterwards the bins that hold
 * something are kept, about a thousand for a panel of 400 000 cells.
 *
 * For a ratio L the colour q = treated - L * control remains. In amounts of control (a), of q (b)
 * and of what is across to both (c) the cells with c / b near 0 lie along the line; a / b is how
 * far along. The distribution of a / b is seen through the noise of the scan, which would put its
 * end too low: it is deconvolved (nonparametric maximum likelihood by expectation-maximisation,
 * Laird 1978, 10.1080/01621459.1978.10480103), and its 2 % quantile is the edge. That rises with L,
 * and where it is 0 q lies on the edge of the cloud. The edge need not run straight across: its
 * slope, by the cells to either side, turns the third colour until it lies along it.
 *
 *     1. steps over L until the edge changes sign, then halves
 *     2. edges at either side -> slope, by secants; again, ROUNDS times in all
 *
 * No table of stain vectors enters. It fails where no cell has the hue that remains. Some 100
 * deconvolutions of 300 x 300, 0.3 s. */
#include "pipeline/stain/hue_distribution.h"

#include "pipeline/core/geom.h"

#include <math.h>
#include <string.h>

/* ---- the histogram ----------------------------------------------------------------------- */

enum { BINS = GSN_CLOUD_GREENS * GSN_CLOUD_BLUES };

struct gsn_cloud_tally {
    double cells[BINS], od[BINS];
};

int gsn_cloud_new(size_t panels, struct gsn_cloud **ret_cloud, struct gsn_error *err)
{
    gsn_auto(gsn_cloud) cloud = gsn_alloc_array(1, sizeof *cloud);

    if (cloud)
        cloud->panel = gsn_alloc_array(panels + 1, sizeof *cloud->panel);
    if (!cloud || !cloud->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a specimen");
    cloud->panels = panels;
    *ret_cloud = gsn_steal(&cloud);
    return GSN_OK;
}

void gsn_cloud_free(struct gsn_cloud *cloud)
{
    if (!cloud)
        return;
    for (size_t p = 0; p < cloud->panels && cloud->panel; p++)
        gsn_free(cloud->panel[p].bin);
    gsn_free(cloud->panel);
    gsn_free(cloud);
}

int gsn_cloud_tally_new(struct gsn_cloud_tally **ret_tally, struct gsn_error *err)
{
    struct gsn_cloud_tally *tally = gsn_alloc_array(1, sizeof *tally);

    if (!tally)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a panel");
    *ret_tally = tally;
    return GSN_OK;
}

void gsn_cloud_tally_free(struct gsn_cloud_tally *tally)
{
    gsn_free(tally);
}

void gsn_cloud_tally_add(struct gsn_cloud_tally *tally, const double od[3], double cells)
{
    const double all = od[0] + od[1] + od[2];
    const double green = (od[1] / all - GSN_CLOUD_LEAST_GREEN) / GSN_CLOUD_SHARE;
    const double blue = (od[2] / all - GSN_CLOUD_LEAST_BLUE) / GSN_CLOUD_SHARE;

    if (!(all >= GSN_CLOUD_LEAST_OD) || !(green >= 0 && green < GSN_CLOUD_GREENS) ||
        !(blue >= 0 && blue < GSN_CLOUD_BLUES))
        return;

    const size_t at = (size_t)green * GSN_CLOUD_BLUES + (size_t)blue;

    tally->cells[at] += cells;
    tally->od[at] += cells * all;
}

int gsn_cloud_tally_take(struct gsn_cloud_tally *tally, struct gsn_cloud_panel *panel,
                         struct gsn_error *err)
{
    struct gsn_cloud_bin *bin;
    size_t count = 0;

    for (size_t i = 0; i < BINS; i++)
        count += tally->cells[i] > 0;
    bin = gsn_alloc_array(count + 1, sizeof *bin);
    if (!bin)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the colours of a panel");
    gsn_free(panel->bin);
    panel->bin = bin;
    panel->bins = count;
    for (size_t i = 0; i < BINS; i++)
        if (tally->cells[i] > 0)
            *bin++ = (struct gsn_cloud_bin){ (uint32_t)i, tally->cells[i],
                                             tally->od[i] / tally->cells[i] };
    memset(tally, 0, sizeof *tally);
    return GSN_OK;
}

void gsn_cloud_bin_od(const struct gsn_cloud_bin *bin, double ret_od[3])
{
    const double green =
        GSN_CLOUD_LEAST_GREEN + GSN_CLOUD_SHARE * (bin->at / GSN_CLOUD_BLUES + 0.5);
    const double blue = GSN_CLOUD_LEAST_BLUE + GSN_CLOUD_SHARE * (bin->at % GSN_CLOUD_BLUES + 0.5);

    ret_od[0] = bin->od * (1 - green - blue);
    ret_od[1] = bin->od * green;
    ret_od[2] = bin->od * blue;
}

/* ---- cells along the line ---------------------------------------------------------------- */

/* a / b from here on in steps of STEP; cells that are more of the control's tissue than twice what
 * remains tell nothing of the edge. */
#define LEAST (-1.0)
#define STEP 0.01

enum { PLACES = 301 };

/* The stretch across that counts, c / b to either side, falling off linearly. */
static const double ACROSS = 0.15;
static const double QUANTILE = 0.02, FOREMOST = 0.005, FOLLOWING = 0.05;
static const double LEAST_CELLS = 300;

/* Below this share of what remains a cell has no place along the line. */
static const double LEAST_REMAINS = 0.02;
static const double LEAST_RATIO = -0.2, MOST_RATIO = 1.2, RATIO_STEP = 0.1;

enum { HALVINGS = 10, ROUNDS = 4, ITERATIONS = 60 };

/* Of the slope in one round; and of what a change of it must show to be gone by. */
static const double MOST_STEP = 2, LEAST_CHANGE = 0.1;

static double sum_of_three(const double a[3])
{
    return a[0] + a[1] + a[2];
}

/* What was seen along the line, and the distribution behind it. */
struct line {
    double cells[PLACES], variance[PLACES]; /* seen: how many, and the mean of their noise */
    double kernel[PLACES][PLACES];          /* seen place, true place */
    double share[PLACES];                   /* of the true places; they sum to 1 */
    double all;
};

/* 0: the three colours lie in one plane. */
static int frame_of(const double control[3], const double remains[3], double slope,
                    double ret_frame[3][3])
{
    double axis[3][3], det, length;

    for (int c = 0; c < 3; c++) {
        axis[0][c] = control[c] / sum_of_three(control);
        axis[1][c] = remains[c];
    }
    gsn_cross3(axis[0], axis[1], axis[2]);
    length = sqrt(gsn_dot3(axis[2], axis[2]));
    if (!(length > 1e-3))
        return 0;
    for (int c = 0; c < 3; c++)
        axis[2][c] = axis[2][c] / length * sqrt(gsn_dot3(remains, remains)) + slope * axis[0][c];
    for (int k = 0; k < 3; k++)
        gsn_cross3(axis[(k + 1) % 3], axis[(k + 2) % 3], ret_frame[k]);
    det = gsn_dot3(axis[0], ret_frame[0]);
    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            ret_frame[k][c] /= det;
    return 1;
}

/* Cells whose c / b lies near `shift`, by their a / b. */
static void gather_cells(const double frame[3][3], const struct gsn_hue_edge_point *point,
                         size_t points, double shift, struct line *line)
{
    memset(line->cells, 0, sizeof line->cells);
    memset(line->variance, 0, sizeof line->variance);
    line->all = 0;
    for (size_t i = 0; i < points; i++) {
        const double remains = gsn_dot3(frame[1], point[i].hue);
        double along, across, weight, variance = 0, both = 0;

        if (!(remains > LEAST_REMAINS))
            continue;
        along = gsn_dot3(frame[0], point[i].hue) / remains;
        across = gsn_dot3(frame[2], point[i].hue) / remains;
        for (int c = 0; c < 3; c++) {
            const double slope = (frame[0][c] - along * frame[1][c]) / remains;

            variance += slope * slope * point[i].variance[c];
            both += slope * (frame[2][c] - across * frame[1][c]) / remains * point[i].variance[c];
        }
        /* Noise moves a cell along and across at once; whether it counts must not hang on what
         * moves it along. On the edge, where along is 0, that changes nothing. */
        if (variance > 0)
            across -= both / variance * along;
        weight = point[i].cells * (1 - fabs(across - shift) / ACROSS);
        if (!(weight > 0) || !(along >= LEAST && along < LEAST + STEP * (PLACES - 1)))
            continue;

        const double place = (along - LEAST) / STEP;
        const size_t at = (size_t)place;
        const double beyond = weight * (place - (double)at);

        line->cells[at] += weight - beyond;
        line->cells[at + 1] += beyond;
        line->variance[at] += (weight - beyond) * variance;
        line->variance[at + 1] += beyond * variance;
        line->all += weight;
    }
}

/* The distribution behind what was seen. */
static void deconvolve_line(struct line *line)
{
    for (int i = 0; i < PLACES; i++) {
        double deviation;

        if (!(line->cells[i] > 0))
            continue;
        deviation = sqrt(line->variance[i] / line->cells[i] + STEP * STEP / 6);
        for (int j = 0; j < PLACES; j++) {
            const double t = STEP * (i - j) / deviation;

            line->kernel[i][j] = exp(-0.5 * t * t) / deviation;
        }
    }
    for (int j = 0; j < PLACES; j++)
        line->share[j] = 1.0 / PLACES;
    for (int round = 0; round < ITERATIONS; round++) {
        double more[PLACES] = { 0 };

        for (int i = 0; i < PLACES; i++) {
            double density = 0;

            if (!(line->cells[i] > 0))
                continue;
            for (int j = 0; j < PLACES; j++)
                density += line->kernel[i][j] * line->share[j];
            density = line->cells[i] / (density * line->all);
            for (int j = 0; j < PLACES; j++)
                more[j] += line->kernel[i][j] * density;
        }
        for (int j = 0; j < PLACES; j++)
            line->share[j] *= more[j];
    }
}

/* Below which this share of the cells truly lies. */
static double quantile_of(const struct line *line, double share)
{
    double below = 0;

    for (int j = 0; j < PLACES; j++) {
        if (below + line->share[j] >= share)
            return LEAST + STEP * (j - 0.5 + (share - below) / line->share[j]);
        below += line->share[j];
    }
    return LEAST + STEP * (PLACES - 1);
}

/* The edge at a place across; NaN: too few cells. */
static double edge_at(const double frame[3][3], const struct gsn_hue_edge_point *point,
                      size_t points, double shift, struct line *line)
{
    gather_cells(frame, point, points, shift, line);
    if (!(line->all >= LEAST_CELLS))
        return (double)NAN;
    deconvolve_line(line);
    return quantile_of(line, QUANTILE);
}

/* ---- the edge ---------------------------------------------------------------------------- */

/* What is sought, and among what. */
struct search {
    const struct gsn_hue_edge_point *point;
    size_t points;
    const double *control, *treated;
    double slope;
    struct line *line;
};

/* The colour that remains at a ratio, of R + G + B 1; 0: it has none. */
static int remains_at(const struct search *s, double ratio, double ret[3])
{
    double all = 0;

    for (int c = 0; c < 3; c++) {
        ret[c] = s->treated[c] - ratio * s->control[c];
        all += ret[c];
    }
    for (int c = 0; c < 3; c++)
        ret[c] /= all;
    return all > 0;
}

static double edge_of_ratio(const struct search *s, double ratio, double frame[3][3])
{
    double remains[3];

    if (!remains_at(s, ratio, remains) || !frame_of(s->control, remains, s->slope, frame))
        return (double)NAN;
    return edge_at(frame, s->point, s->points, 0, s->line);
}

/* The ratio at which the edge is 0; NaN: there is none. */
static double find_ratio(const struct search *s)
{
    double frame[3][3], below = (double)NAN, above = (double)NAN;

    for (double ratio = LEAST_RATIO; ratio <= MOST_RATIO; ratio += RATIO_STEP) {
        const double edge = edge_of_ratio(s, ratio, frame);

        if (edge <= 0) {
            below = ratio;
        } else if (edge > 0 && !isnan(below)) {
            above = ratio;
            break;
        }
    }
    if (isnan(above))
        return (double)NAN;
    for (int i = 0; i < HALVINGS; i++) {
        const double middle = (below + above) / 2;
        const double edge = edge_of_ratio(s, middle, frame);

        if (isnan(edge))
            return (double)NAN;
        if (edge > 0)
            above = middle;
        else
            below = middle;
    }
    return (below + above) / 2;
}

int gsn_hue_edge_find(const struct gsn_hue_edge_point *point, size_t points,
                      const double control[3], const double treated[3],
                      struct gsn_hue_edge *ret_edge, struct gsn_error *err)
{
    gsn_auto_mem(struct line) line = gsn_alloc_array(1, sizeof *line);
    struct search s = { point, points, control, treated, 0, line };
    struct gsn_hue_edge edge = { .cells = 0 };
    double ratio = (double)NAN, before = 0, tilt_before = (double)NAN;

    if (!line)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the edge of the stained colours");
    for (int round = 0; round < ROUNDS; round++) {
        double tilt, next;

        ratio = find_ratio(&s);
        if (isnan(ratio))
            return gsn_fail(err, GSN_E_STAIN,
                            "too little tissue has the colour that is left where collagen is gone");
        (void)edge_of_ratio(&s, ratio, edge.frame);
        tilt = (edge_at(edge.frame, point, points, ACROSS, line) -
                edge_at(edge.frame, point, points, -ACROSS, line)) /
               (2 * ACROSS);
        if (round + 1 == ROUNDS || isnan(tilt))
            continue;
        /* Cells to one side reach over to the other, so the tilt shows only in part: secant. */
        next = s.slope + tilt;
        if (tilt_before - tilt > LEAST_CHANGE * fabs(tilt_before))
            next = s.slope + tilt * (s.slope - before) / (tilt_before - tilt);
        before = s.slope;
        tilt_before = tilt;
        s.slope += fmax(-MOST_STEP, fmin(MOST_STEP, next - s.slope));
    }
    (void)edge_of_ratio(&s, ratio, edge.frame);
    (void)remains_at(&s, ratio, edge.remains);
    edge.vertex = quantile_of(line, FOLLOWING) - quantile_of(line, FOREMOST);
    edge.cells = line->all;
    *ret_edge = edge;
    return GSN_OK;
}

int gsn_hue_edge_of(const struct gsn_hue_edge *edge, const struct gsn_hue_edge_point *point,
                    size_t points, double *ret_at, struct gsn_error *err)
{
    gsn_auto_mem(struct line) line = gsn_alloc_array(1, sizeof *line);
    double at;

    if (!line)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the edge of the stained colours");
    at = edge_at(edge->frame, point, points, 0, line);
    if (isnan(at))
        return gsn_fail(err, GSN_E_STAIN, "fewer than %.0f cells lie near the edge", LEAST_CELLS);
    *ret_at = at;
    return GSN_OK;
}

double gsn_hue_edge_ratio(const struct gsn_hue_edge *edge, const double control[3],
                          const double treated[3], double purest)
{
    const double *collagen = edge->frame[0], *remains = edge->frame[1];

    return (gsn_dot3(collagen, treated) + purest * gsn_dot3(remains, treated)) /
           (gsn_dot3(collagen, control) + purest * gsn_dot3(remains, control));
}
