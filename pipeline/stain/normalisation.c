/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Normalisation by gain and offset, in the order in which a loss needs it.
 *
 *   1. Reference tissue: trimmed mean of its red over its stated density; the error is what the
 *      sections disagree by.
 *   2. Within one block: a robust Deming line (both sides have like noise; weights fall off with
 *      the square of the distance) through cells seen on either side of a boundary of panels; the
 *      steps are shrunk by the share that their error explains (James and Stein's idea), chained,
 *      and centred on gain 1, offset 0.
 *   3. Control tissues of a specimen, seen from the region of interest: generalised least squares
 *      (Aitken) with the covariance of the steps, the tissue's slope along the block and the
 *      sections' scatter.
 *   4. Between two specimens: generalised least squares of a line through the tissues that both
 *      show, whose gain and offset have a prior of mean "no difference" and the panels' own scatter
 *      as width, widened where the tissues differ by more than that.
 *
 * Fails, with what is missing in the sentence, where tissue is seen too little, is all of one
 * density, or a step would turn the order of densities round. */
#include "pipeline/stain/normalisation.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

/* ---- reference tissue -------------------------------------------------------------------- */

/* Below it an error of the white of a tenth of a percent is one of the gain of three percent. */
#define PALEST_RED 0.05
#define LEFT_OUT 0.2 /* of the values, at either end */

enum { LEAST_SECTIONS = 3, LEAST_PIXELS = 50 };

double gsn_reference_red(double *values, size_t count)
{
    const size_t first = (size_t)(LEFT_OUT * (double)count), last = count - first;
    double sum = 0;

    if (count == 0)
        return (double)NAN;
    /* Each pick leaves what is smaller below its rank and what is larger above it. */
    (void)gsn_order_pick(values, count, first);
    (void)gsn_order_pick(values + first, count - first, last - 1 - first);
    for (size_t i = first; i < last; i++)
        sum += values[i];
    return sum / (double)(last - first);
}

int gsn_stain_reference(const struct gsn_reference_section *sections, size_t count, double stated,
                        struct gsn_stain_gain *ret_gain, struct gsn_error *err)
{
    struct gsn_stain_gain gain = { .gain = 1 };
    double sum = 0, squares = 0, mean;

    for (size_t i = 0; i < count; i++) {
        if (sections[i].pixels < LEAST_PIXELS)
            continue;
        gain.sections++;
        gain.pixels += sections[i].pixels;
        sum += sections[i].red;
        squares += sections[i].red * sections[i].red;
    }
    if (gain.sections < LEAST_SECTIONS)
        return gsn_fail(err, GSN_E_STAIN,
                        "the reference tissue shows on %u section%s, at least %d are needed to "
                        "tell how strong the stain is: state a larger one",
                        gain.sections, gain.sections == 1 ? "" : "s", LEAST_SECTIONS);
    mean = sum / gain.sections;
    if (!(mean > PALEST_RED))
        return gsn_fail(err, GSN_E_STAIN,
                        "the reference tissue holds next to no red (density %.2f): state one that "
                        "holds collagen",
                        mean);
    gain.gain = mean / stated;
    gain.error =
        sqrt(fmax(squares - sum * mean, 0) / (gain.sections - 1.0) / gain.sections) / stated;
    *ret_gain = gain;
    return GSN_OK;
}

int gsn_stain_gain_of_others(const struct gsn_stain_gain *gains, size_t count,
                             struct gsn_stain_gain *ret_gain, struct gsn_error *err)
{
    double sum = 0, squares = 0, errors = 0;
    unsigned used = 0;

    for (size_t i = 0; i < count; i++) {
        if (gains[i].sections == 0)
            continue;
        used++;
        sum += gains[i].gain;
        squares += gains[i].gain * gains[i].gain;
        errors += gains[i].error * gains[i].error;
    }
    if (used < 2)
        return gsn_fail(err, GSN_E_STAIN,
                        "the reference tissue was measured on %u panel%s, which does not tell what "
                        "panels differ by",
                        used, used == 1 ? "" : "s");

    const double mean = sum / used;
    const double between = fmax(squares - sum * mean, 0) / (used - 1);

    /* One more panel of the same kind: what panels scatter, and how well their mean is known. */
    *ret_gain =
        (struct gsn_stain_gain){ .gain = mean,
                                 .error = sqrt(between * (1 + 1.0 / used) + errors / used / used) };
    return GSN_OK;
}

/* ---- one line of a block ----------------------------------------------------------------- */

enum { LEAST_CELLS = 100, LEAST_LINES = 4, MOST_ROUNDS = 30 };

/* Standard deviation of the cells' densities below which noise, not tissue, would tell the slope.
 */
static const double LEAST_CONTRAST = 0.05;

/* Rounding and JPEG leave a thousandth between any two pictures. */
static const double LEAST_VARIANCE = 1e-6;

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
static double weigh_by_distance(const double *x, const double *y, size_t count, double slope,
                                double offset, double *weight, double *scratch)
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

int gsn_gain_line(const double *before, const double *after, size_t count,
                  struct gsn_gain_line *ret_line, struct gsn_error *err)
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
        median = weigh_by_distance(before, after, count, slope, offset, weight, scratch);
        if (!(median > 0))
            break;
    }
    *ret_line = (struct gsn_gain_line){ .slope = slope, .offset = offset, .cells = count };
    return GSN_OK;
}

/* ---- the chain --------------------------------------------------------------------------- */

/* How far a line lifts a density. */
static double lift_at(const struct gsn_gain_line *line, double at)
{
    return (line->slope - 1) * at + line->offset;
}

static void learn_drift(const struct gsn_gain_line *within, size_t lines, struct gsn_gain_fit *fit)
{
    double sum[2] = { 0 }, square[3] = { 0 }, lags = 0; /* sum of their squares */
    const double n = (double)lines;

    for (size_t i = 0; i < lines; i++) {
        lags += within[i].lag * within[i].lag;
        for (int k = 0; k < 2; k++)
            sum[k] += lift_at(&within[i], fit->at[k]) / within[i].lag / n;
    }
    for (size_t i = 0; i < lines; i++) {
        const double a = lift_at(&within[i], fit->at[0]) - sum[0] * within[i].lag;
        const double b = lift_at(&within[i], fit->at[1]) - sum[1] * within[i].lag;

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
    fit->covariance[0] += LEAST_VARIANCE;
    fit->covariance[2] += LEAST_VARIANCE;
}

/* A step in units of its error, squared. */
static double size_of_step(const struct gsn_gain_fit *fit, double lag, const double d[2])
{
    double c[3], det;

    for (int k = 0; k < 3; k++)
        c[k] = fit->covariance[k] + lag * lag * fit->drift_covariance[k];
    det = c[0] * c[2] - c[1] * c[1];
    return (c[2] * d[0] * d[0] - 2 * c[1] * d[0] * d[1] + c[0] * d[1] * d[1]) / det;
}

static void step_of(const struct gsn_gain_line *line, const struct gsn_gain_fit *fit, double d[2])
{
    for (int k = 0; k < 2; k++)
        d[k] = lift_at(line, fit->at[k]) - fit->drift[k] * line->lag;
}

static double share_kept(const struct gsn_gain_line *step, size_t steps,
                         const struct gsn_gain_fit *fit)
{
    double sum = 0, d[2];

    for (size_t i = 0; i < steps; i++) {
        step_of(&step[i], fit, d);
        sum += size_of_step(fit, step[i].lag, d);
    }
    return steps > 0 && sum > 0 ? fmax(0, 1 - 2 * (double)steps / sum) : 0;
}

/* Levels on the scale of the first panel become levels on the scale of their mean. */
static void centre_levels(struct gsn_gain_offset *level, size_t panels, struct gsn_gain_fit *fit)
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

int gsn_gain_chain(const struct gsn_gain_line *step, size_t steps,
                   const struct gsn_gain_line *within, size_t lines, const double at[2],
                   struct gsn_gain_offset *ret_level, struct gsn_gain_fit *ret_fit,
                   struct gsn_error *err)
{
    struct gsn_gain_fit fit = { .at = { at[0], at[1] }, .steps = steps };

    if (steps >= GSN_GAIN_PANELS)
        return gsn_fail(err, GSN_E_STAIN, "%zu panels: one block has %d at most", steps + 1,
                        GSN_GAIN_PANELS);
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
    ret_level[0] = (struct gsn_gain_offset){ 1, 0 };
    for (size_t i = 0; i < steps; i++) {
        double d[2], slope, offset;

        step_of(&step[i], &fit, d);
        slope = 1 + fit.kept * (d[1] - d[0]) / (at[1] - at[0]);
        offset = fit.kept * d[0] - (slope - 1) * at[0];
        ret_level[i + 1] = (struct gsn_gain_offset){ slope * ret_level[i].gain,
                                                     slope * ret_level[i].offset + offset };
    }
    centre_levels(ret_level, steps + 1, &fit);
    *ret_fit = fit;
    return GSN_OK;
}

/* Covariance of a step's lift at two densities. */
static double at_densities(const struct gsn_gain_fit *fit, const double c[3], double a, double b)
{
    const double width = fit->at[1] - fit->at[0];
    const double ua = (a - fit->at[0]) / width, ub = (b - fit->at[0]) / width;

    return (1 - ua) * (1 - ub) * c[0] + ((1 - ua) * ub + ua * (1 - ub)) * c[1] + ua * ub * c[2];
}

double gsn_gain_covariance(const struct gsn_gain_fit *fit, const double *a, double density_a,
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

double gsn_gain_error(const struct gsn_gain_fit *fit, const double *share, double density)
{
    const size_t panels = fit->steps + 1;
    double lever[GSN_GAIN_PANELS];

    for (size_t p = 0; p < panels; p++)
        lever[p] = share[p] - 1 / (double)panels;
    return sqrt(fmax(0, gsn_gain_covariance(fit, lever, density, lever, density)));
}

/* ---- control tissues of one specimen ----------------------------------------------------- */

/* What tissue changes by along a block, of its density per um: a tenth in a millimetre is usual. */
static const double SLOPE_PER_UM = 1e-4;

/* What sections of one panel scatter by, of the density, where too few are seen to tell; and how
 * many are too few. */
static const double SCATTER = 0.05;

enum { LEAST_FREE = 4 };

/* A median's variance against a mean's. */
static const double MEDIAN = 1.57;

/* What all panels say of one tissue. */
struct tissue {
    const struct gsn_control_seen *seen;
    size_t count;
    double density;                  /* about where the steps lift it */
    double weight[GSN_GAIN_PANELS];  /* of the panels that see it */
    double lever[GSN_GAIN_PANELS];   /* of all panels, against the region's shares */
    double noise[GSN_GAIN_PANELS];   /* variance, of the panels that see it */
};

/* Squares of sections, and by how many degrees of freedom they are known. */
struct scatter {
    double squares, of_density, free;
};

static void add_scatter(const struct gsn_control_seen *seen, size_t count, struct scatter *s)
{
    for (size_t i = 0; i < count; i++) {
        const double free = seen[i].sections > 0 ? (double)seen[i].sections - 1 : 0;

        s->squares += free > 0 ? seen[i].square : 0;
        s->of_density += free * seen[i].value * seen[i].value;
        s->free += free;
    }
}

/* Variance of one section over its density squared, by all tissues and panels. */
static double relative_variance(const struct gsn_control_seen *const seen[GSN_CONTROL_TISSUES],
                                const size_t count[GSN_CONTROL_TISSUES])
{
    struct scatter all = { 0 };

    for (size_t t = 0; t < GSN_CONTROL_TISSUES; t++)
        add_scatter(seen[t], count[t], &all);
    return all.free >= LEAST_FREE && all.of_density > 0 ? all.squares / all.of_density
                                                        : SCATTER * SCATTER;
}

/* Sections of one tissue may scatter by more than those of all do; that they scatter by less is
 * chance. */
static void tissue_init(const struct gsn_control_seen *seen, size_t count, double relative,
                        struct tissue *t)
{
    struct scatter own = { 0 };
    double variance;

    *t = (struct tissue){ .seen = seen, .count = count };
    for (size_t i = 0; i < count; i++)
        t->density += seen[i].value / (double)count;
    add_scatter(seen, count, &own);
    variance = fmax(relative * t->density * t->density,
                    own.free >= LEAST_FREE ? own.squares / own.free : 0);
    for (size_t i = 0; i < count; i++)
        t->noise[i] = LEAST_VARIANCE + MEDIAN * variance / (double)seen[i].sections;
}

/* Covariance of what two panels are off by. */
static double covariance_of(const struct gsn_control_frame *frame, const struct tissue *t, size_t i,
                            size_t j)
{
    const size_t panels = frame->fit->steps + 1;
    const double slope = SLOPE_PER_UM * t->density;
    double one[GSN_GAIN_PANELS], other[GSN_GAIN_PANELS];

    for (size_t p = 0; p < panels; p++)
        one[p] = other[p] = -frame->share[p];
    one[t->seen[i].panel] += 1;
    other[t->seen[j].panel] += 1;
    return gsn_gain_covariance(frame->fit, one, t->density, other, t->density) +
           slope * slope * (t->seen[i].z_um - frame->at_um) * (t->seen[j].z_um - frame->at_um) +
           (i == j ? t->noise[i] : 0);
}

/* The weights of the panels: the best linear unbiased ones. */
static void weigh_panels(const struct gsn_control_frame *frame, struct tissue *t)
{
    double covariance[GSN_GAIN_PANELS * GSN_GAIN_PANELS], sum = 0;

    for (size_t i = 0; i < t->count; i++) {
        t->weight[i] = 1;
        for (size_t j = 0; j < t->count; j++)
            covariance[i * t->count + j] = covariance_of(frame, t, i, j);
    }
    (void)gsn_solve_spd(covariance, t->count, t->count, t->weight); /* noise keeps it definite */
    for (size_t i = 0; i < t->count; i++)
        sum += t->weight[i];
    for (size_t p = 0; p <= frame->fit->steps; p++)
        t->lever[p] = -frame->share[p];
    for (size_t i = 0; i < t->count; i++) {
        t->weight[i] /= sum;
        t->lever[t->seen[i].panel] += t->weight[i];
    }
}

static double own_variance(const struct gsn_control_frame *frame, const struct tissue *t)
{
    double away = 0, noise = 0;

    for (size_t i = 0; i < t->count; i++) {
        away += t->weight[i] * (t->seen[i].z_um - frame->at_um);
        noise += t->weight[i] * t->weight[i] * t->noise[i];
    }
    return noise + SLOPE_PER_UM * SLOPE_PER_UM * t->density * t->density * away * away;
}

void gsn_control_tissues_at(const struct gsn_control_frame *frame,
                            const struct gsn_control_seen *const seen[GSN_CONTROL_TISSUES],
                            const size_t count[GSN_CONTROL_TISSUES],
                            struct gsn_control_tissues *ret_tissues)
{
    const double relative = relative_variance(seen, count);
    struct tissue tissue[GSN_CONTROL_TISSUES];
    struct gsn_control_tissues ret = { 0 };

    for (size_t t = 0; t < GSN_CONTROL_TISSUES; t++) {
        tissue_init(seen[t], count[t], relative, &tissue[t]);
        if (count[t] > 0)
            weigh_panels(frame, &tissue[t]);
        ret.value[t] = count[t] > 0 ? 0 : (double)NAN;
        for (size_t i = 0; i < count[t]; i++)
            ret.value[t] += tissue[t].weight[i] * seen[t][i].value;
    }
    for (size_t t = 0; t < GSN_CONTROL_TISSUES; t++)
        for (size_t u = 0; u < GSN_CONTROL_TISSUES; u++)
            ret.covariance[t][u] =
                count[t] == 0 || count[u] == 0
                    ? (double)NAN
                    : gsn_gain_covariance(frame->fit, tissue[t].lever, tissue[t].density,
                                          tissue[u].lever, tissue[u].density) +
                          (t == u ? own_variance(frame, &tissue[t]) : 0);
    *ret_tissues = ret;
}

double gsn_control_tissue_error(const struct gsn_control_tissues *tissues, size_t tissue)
{
    return sqrt(tissues->covariance[tissue][tissue]);
}

/* ---- between two specimens --------------------------------------------------------------- */

/* What animals of one kind are taken to differ by in tissue that nobody treated: of its density,
 * and in density by the cells in it, whose nuclei are neither red nor yellow. Nobody has measured
 * either; a study's own controls will. */
static const double ANIMALS = 0.02, NUCLEI = 0.005;

/* Two or three tissues tell a variance badly: where they differ by more than their errors, the
 * difference is rather believed than halved. */
static const double GENEROUS = 4;

/* Baths that are even still differ: less than this is not worth a name. */
static const struct gsn_gain_offset LEAST_SPREAD = { 1e-3, 5e-4 };

/* The tissues that both show. */
struct pairs {
    size_t count;
    double here[GSN_CONTROL_TISSUES], there[GSN_CONTROL_TISSUES];
    double covariance[GSN_CONTROL_TISSUES *
                      GSN_CONTROL_TISSUES]; /* of their differences; count x count */
};

static void pair_up(const struct gsn_control_tissues *here, const struct gsn_control_tissues *there,
                    struct pairs *p)
{
    size_t kind[GSN_CONTROL_TISSUES];

    *p = (struct pairs){ 0 };
    for (size_t t = 0; t < GSN_CONTROL_TISSUES; t++)
        if (!isnan(here->value[t]) && !isnan(there->value[t])) {
            p->here[p->count] = here->value[t];
            p->there[p->count] = there->value[t];
            kind[p->count++] = t;
        }
    for (size_t i = 0; i < p->count; i++)
        for (size_t j = 0; j < p->count; j++) {
            const double animals = ANIMALS * p->there[i];

            p->covariance[i * p->count + j] =
                here->covariance[kind[i]][kind[j]] + there->covariance[kind[i]][kind[j]] +
                (i == j ? 2 * (animals * animals + NUCLEI * NUCLEI) : 0);
        }
}

/* How many times spread, squared, the tissues' differences allow for; 1 at least. */
static double find_widening(const struct pairs *p, const struct gsn_gain_offset *spread)
{
    double excess = 0, expected = 0;

    for (size_t i = 0; i < p->count; i++) {
        const double v = p->covariance[i * p->count + i];
        const double d = p->here[i] - p->there[i], g = spread->gain * p->there[i];

        excess += d * d / v - 1;
        expected += (g * g + spread->offset * spread->offset) / v;
    }
    return expected > 0 ? fmax(1, GENEROUS * excess / expected) : 1;
}

/* x becomes covariance^-1 x. */
static int divide_by_covariance(const struct pairs *p, double x[GSN_CONTROL_TISSUES])
{
    double covariance[GSN_CONTROL_TISSUES * GSN_CONTROL_TISSUES];

    memcpy(covariance, p->covariance, sizeof covariance);
    return gsn_solve_spd(covariance, p->count, p->count, x) == 0;
}

/* Generalised least squares of the differences by a straight line, whose gain and offset have these
 * variances beforehand. */
static int fit_link(const struct pairs *p, const double prior[2],
                    struct gsn_batch_calibration *link)
{
    double slope[GSN_CONTROL_TISSUES] = { 0 }, one[GSN_CONTROL_TISSUES] = { 0 };
    double n00 = 1 / prior[0], n01 = 0, n11 = 1 / prior[1], r0 = 0, r1 = 0, det;

    for (size_t i = 0; i < p->count; i++) {
        slope[i] = p->there[i];
        one[i] = 1;
    }
    if (!divide_by_covariance(p, slope) || !divide_by_covariance(p, one))
        return 0;
    for (size_t i = 0; i < p->count; i++) {
        const double off = p->here[i] - p->there[i];

        n00 += slope[i] * p->there[i];
        n01 += one[i] * p->there[i];
        n11 += one[i];
        r0 += slope[i] * off;
        r1 += one[i] * off;
    }
    det = n00 * n11 - n01 * n01;
    *link = (struct gsn_batch_calibration){ .gain = 1 + (n11 * r0 - n01 * r1) / det,
                                            .offset = (n00 * r1 - n01 * r0) / det,
                                            .covariance = { n11 / det, -n01 / det, n00 / det },
                                            .tissues = p->count };
    return 1;
}

static double find_disagreement(const struct pairs *p, const struct gsn_batch_calibration *link)
{
    double off[GSN_CONTROL_TISSUES] = { 0 }, scaled[GSN_CONTROL_TISSUES] = { 0 }, sum = 0;

    for (size_t i = 0; i < p->count; i++)
        off[i] = scaled[i] = p->here[i] - link->gain * p->there[i] - link->offset;
    (void)divide_by_covariance(p, scaled); /* as the fit did */
    for (size_t i = 0; i < p->count; i++)
        sum += off[i] * scaled[i] / (double)p->count;
    return sqrt(fmax(0, sum));
}

int gsn_batch_calibrate(const struct gsn_control_tissues *here,
                        const struct gsn_control_tissues *there,
                        const struct gsn_gain_offset *spread,
                        struct gsn_batch_calibration *ret_link, struct gsn_error *err)
{
    const struct gsn_gain_offset least = { fmax(spread->gain, LEAST_SPREAD.gain),
                                           fmax(spread->offset, LEAST_SPREAD.offset) };
    struct gsn_batch_calibration link;
    struct pairs pairs;
    double wide;

    pair_up(here, there, &pairs);
    if (pairs.count < 2)
        return gsn_fail(err, GSN_E_STAIN,
                        "the two specimens share %zu kind%s of untreated tissue, two are needed to "
                        "compare their stain",
                        pairs.count, pairs.count == 1 ? "" : "s");
    wide = find_widening(&pairs, &least);
    if (!fit_link(
            &pairs,
            (const double[]){ wide * least.gain * least.gain, wide * least.offset * least.offset },
            &link))
        return gsn_fail(err, GSN_E_STAIN,
                        "the errors of the untreated tissues contradict each other, so the stain "
                        "of the two specimens cannot be compared");
    link.disagreement = find_disagreement(&pairs, &link);
    *ret_link = link;
    return GSN_OK;
}

double gsn_batch_calibration_error(const struct gsn_batch_calibration *link, double density)
{
    const double *c = link->covariance;

    return sqrt(fmax(0, density * density * c[0] + 2 * density * c[1] + c[2]));
}
