/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/level.h"

#include <math.h>

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"

enum { LEAST_CELLS = 100, LEAST_LINES = 4, MOST_ROUNDS = 30 };

/* Standard deviation of the cells' densities below which noise, not tissue, would tell the slope.
 */
static const double LEAST_CONTRAST = 0.05;
/* ---- one line ------------------------------------------------------------------------------ */

struct moments {
    double x, y, xx, yy, xy;
};

static struct moments moments_of(const double *x, const double *y, const double *weight,
                                 size_t count)
{
    struct moments m = { 0 };
    double sum = 0;

    for (size_t i = 0; i < count; i++) {
        sum += weight[i];
        m.x += weight[i] * x[i];
        m.y += weight[i] * y[i];
    }
    m.x /= sum;
    m.y /= sum;
    for (size_t i = 0; i < count; i++) {
        const double dx = x[i] - m.x, dy = y[i] - m.y;

        m.xx += weight[i] * dx * dx / sum;
        m.yy += weight[i] * dy * dy / sum;
        m.xy += weight[i] * dx * dy / sum;
    }
    return m;
}

/* Weights by the distance from the line (Tukey's idea in a smooth form). Returns the median
 * distance. */
static double weigh(const double *x, const double *y, size_t count, double slope, double offset,
                    double *weight, double *scratch)
{
    const double scale = sqrt(1 + slope * slope);
    double median;

    for (size_t i = 0; i < count; i++)
        scratch[i] = fabs(y[i] - slope * x[i] - offset) / scale;
    median = gsn_order_pick(scratch, count, count / 2);
    for (size_t i = 0; i < count; i++) {
        const double off = fabs(y[i] - slope * x[i] - offset) / scale;
        const double t = median > 0 ? off / (2 * 1.4826 * median) : 0;

        weight[i] = 1 / ((1 + t * t) * (1 + t * t));
    }
    return median;
}

int gsn_level_line(const double *before, const double *after, size_t count,
                   struct gsn_level_line *ret_line, struct gsn_error *err)
{
    gsn_auto_mem(double) weight = NULL;
    gsn_auto_mem(double) scratch = NULL;
    double slope = 1, offset = 0, median = 0;

    if (count < LEAST_CELLS)
        return gsn_fail(err, GSN_E_STAIN,
                        "only %zu cells of tissue are seen on both sides, at least %d are needed",
                        count, LEAST_CELLS);
    weight = gsn_alloc_array(count, sizeof *weight);
    scratch = gsn_alloc_array(count, sizeof *scratch);
    if (!weight || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the level of a panel");
    for (size_t i = 0; i < count; i++)
        weight[i] = 1;
    for (int round = 0; round < MOST_ROUNDS; round++) {
        const struct moments m = moments_of(before, after, weight, count);
        const double d = m.yy - m.xx;

        if (!(m.xy > LEAST_CONTRAST * LEAST_CONTRAST))
            return gsn_fail(err, GSN_E_STAIN,
                            "the tissue outside of the region is all of one density, so gain and "
                            "offset of the stain cannot be told apart");
        slope = (d + sqrt(d * d + 4 * m.xy * m.xy)) / (2 * m.xy);
        offset = m.y - slope * m.x;
        median = weigh(before, after, count, slope, offset, weight, scratch);
        if (!(median > 0))
            break;
    }
    *ret_line = (struct gsn_level_line){ .slope = slope, .offset = offset, .cells = count };
    return GSN_OK;
}

/* ---- the chain ----------------------------------------------------------------------------- */

/* How far a line lifts a density. */
static double lift(const struct gsn_level_line *line, double at)
{
    return (line->slope - 1) * at + line->offset;
}

static void learn_drift(const struct gsn_level_line *within, size_t lines,
                        struct gsn_level_fit *fit)
{
    double sum[2] = { 0 }, square[3] = { 0 }, lags = 0; /* sum of their squares */
    const double n = (double)lines;

    for (size_t i = 0; i < lines; i++) {
        lags += within[i].lag * within[i].lag;
        for (int k = 0; k < 2; k++)
            sum[k] += lift(&within[i], fit->at[k]) / within[i].lag / n;
    }
    for (size_t i = 0; i < lines; i++) {
        const double a = lift(&within[i], fit->at[0]) - sum[0] * within[i].lag;
        const double b = lift(&within[i], fit->at[1]) - sum[1] * within[i].lag;

        square[0] += a * a;
        square[1] += a * b;
        square[2] += b * b;
    }
    for (int k = 0; k < 2; k++)
        fit->drift[k] = sum[k];
    for (int k = 0; k < 3; k++) {
        fit->covariance[k] = square[k] / (n - 1);
        fit->drift_covariance[k] = square[k] / (n - 1) / lags;
    }
    /* Rounding and JPEG leave a thousandth between any two pictures. */
    fit->covariance[0] += 1e-6;
    fit->covariance[2] += 1e-6;
}

/* A step in units of its error, squared. */
static double size_of_step(const struct gsn_level_fit *fit, double lag, const double d[2])
{
    double c[3], det;

    for (int k = 0; k < 3; k++)
        c[k] = fit->covariance[k] + lag * lag * fit->drift_covariance[k];
    det = c[0] * c[2] - c[1] * c[1];
    return (c[2] * d[0] * d[0] - 2 * c[1] * d[0] * d[1] + c[0] * d[1] * d[1]) / det;
}

static void step_of(const struct gsn_level_line *line, const struct gsn_level_fit *fit, double d[2])
{
    for (int k = 0; k < 2; k++)
        d[k] = lift(line, fit->at[k]) - fit->drift[k] * line->lag;
}

static double share_kept(const struct gsn_level_line *step, size_t steps,
                         const struct gsn_level_fit *fit)
{
    double sum = 0, d[2];

    for (size_t i = 0; i < steps; i++) {
        step_of(&step[i], fit, d);
        sum += size_of_step(fit, step[i].lag, d);
    }
    return steps > 0 && sum > 0 ? fmax(0, 1 - 2 * (double)steps / sum) : 0;
}

/* Levels on the scale of the first panel become levels on the scale of their mean. */
static void centre(struct gsn_level *level, size_t panels, struct gsn_level_fit *fit)
{
    double gain = 0, offset = 0, gains = 0, offsets = 0;

    for (size_t p = 0; p < panels; p++) {
        gain += level[p].gain / (double)panels;
        offset += level[p].offset / (double)panels;
    }
    for (size_t p = 0; p < panels; p++) {
        level[p].gain /= gain;
        level[p].offset -= level[p].gain * offset;
        gains += (level[p].gain - 1) * (level[p].gain - 1);
        offsets += level[p].offset * level[p].offset;
    }
    if (panels > 1) {
        fit->gain_scatter = sqrt(gains / (double)(panels - 1));
        fit->offset_scatter = sqrt(offsets / (double)(panels - 1));
    }
}

int gsn_level_chain(const struct gsn_level_line *step, size_t steps,
                    const struct gsn_level_line *within, size_t lines, const double at[2],
                    struct gsn_level *ret_level, struct gsn_level_fit *ret_fit,
                    struct gsn_error *err)
{
    struct gsn_level_fit fit = { .at = { at[0], at[1] }, .steps = steps };

    if (steps >= GSN_LEVEL_PANELS)
        return gsn_fail(err, GSN_E_STAIN, "%zu panels: one block has %d at most", steps + 1,
                        GSN_LEVEL_PANELS);
    if (lines < LEAST_LINES)
        return gsn_fail(err, GSN_E_STAIN,
                        "only %zu times could sections of one panel be compared with each other, "
                        "at least %d are needed to know what a step between panels means",
                        lines, LEAST_LINES);
    learn_drift(within, lines, &fit);
    fit.kept = share_kept(step, steps, &fit);
    for (size_t i = 0; i < steps; i++) {
        double d[2];

        fit.lag[i] = step[i].lag;
        step_of(&step[i], &fit, d);
        if (!(1 + fit.kept * (d[1] - d[0]) / (at[1] - at[0]) > 0.1))
            return gsn_fail(err, GSN_E_STAIN,
                            "what is dense on one panel is pale on the next: look at the poses");
    }
    ret_level[0] = (struct gsn_level){ 1, 0 };
    for (size_t i = 0; i < steps; i++) {
        double d[2], slope, offset;

        step_of(&step[i], &fit, d);
        slope = 1 + fit.kept * (d[1] - d[0]) / (at[1] - at[0]);
        offset = fit.kept * d[0] - (slope - 1) * at[0];
        ret_level[i + 1] =
            (struct gsn_level){ slope * ret_level[i].gain, slope * ret_level[i].offset + offset };
    }
    centre(ret_level, steps + 1, &fit);
    *ret_fit = fit;
    return GSN_OK;
}

/* Covariance of a step's lift at two densities. */
static double at_densities(const struct gsn_level_fit *fit, const double c[3], double a, double b)
{
    const double width = fit->at[1] - fit->at[0];
    const double ua = (a - fit->at[0]) / width, ub = (b - fit->at[0]) / width;

    return (1 - ua) * (1 - ub) * c[0] + ((1 - ua) * ub + ua * (1 - ub)) * c[1] + ua * ub * c[2];
}

double gsn_level_covariance(const struct gsn_level_fit *fit, const double *a, double density_a,
                            const double *b, double density_b)
{
    double behind_a = 0, behind_b = 0, steps = 0, drift_a = 0, drift_b = 0;

    /* A step lifts all panels behind it; an error of the drift lifts every step by its lag. */
    for (size_t i = fit->steps; i > 0; i--) {
        behind_a += a[i];
        behind_b += b[i];
        steps += behind_a * behind_b;
        drift_a += behind_a * fit->lag[i - 1];
        drift_b += behind_b * fit->lag[i - 1];
    }
    return steps * at_densities(fit, fit->covariance, density_a, density_b) +
           drift_a * drift_b * at_densities(fit, fit->drift_covariance, density_a, density_b);
}

double gsn_level_error(const struct gsn_level_fit *fit, const double *share, double density)
{
    const size_t panels = fit->steps + 1;
    double lever[GSN_LEVEL_PANELS];

    for (size_t p = 0; p < panels; p++)
        lever[p] = share[p] - 1 / (double)panels;
    return sqrt(fmax(0, gsn_level_covariance(fit, lever, density, lever, density)));
}
