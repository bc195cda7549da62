/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The loss: one minus the ratio of two means, in per cent, and their difference in points.
 *
 * Method: Fieller's interval of the ratio (E. C. Fieller, "Some problems in interval estimation",
 * 1954) with Student's quantile at the degrees of freedom of Welch and Satterthwaite; docs/MATH.md,
 * section 12.
 *
 * Steps: (1) both sides are figures of a region; (2) they are of one definition, of one set of
 * dyes, and of one volume or one rule; (3) the baseline is away from zero; (4) loss and points; (5)
 * the interval, where both sides have a standard error.
 *
 * Failure: GSN_E_INPUT says what differs; GSN_E_WITHHELD where the baseline may be zero. Cost:
 * none. */
#include "pipeline/measure/loss.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "pipeline/core/distributions.h"
#include "pipeline/measure/stats.h"

/* A density is an optical figure of order 0.1 to 1; a mean this small is an empty region. */
static const double nearly_zero = 1e-6;
/* The same shape put on the same lattice agrees to rounding; 0.1 % is another region. */
static const double most_volume_difference = 1e-3;

int gsn_loss_is_one_volume(double a_um3, double b_um3)
{
    return fabs(a_um3 - b_um3) <= most_volume_difference * b_um3;
}

static int is_one_rule(const struct gsn_loss_side *a, const struct gsn_loss_side *b)
{
    return a->region && b->region && *a->region && strcmp(a->region, b->region) == 0;
}

static const char *say_rule(const struct gsn_loss_side *side)
{
    return side->region && *side->region ? side->region : "not known how";
}

static int check_side(const struct gsn_loss_side *side, struct gsn_error *err)
{
    if (!isfinite(side->mean) || !isfinite(side->volume_um3) || !(side->volume_um3 > 0.0))
        return gsn_fail(err, GSN_E_INPUT, "%s: mean %g over %g um3 is no density of a region",
                        side->name, side->mean, side->volume_um3);
    if (!isfinite(side->standard_error) || side->standard_error < 0.0 || !isfinite(side->freedom) ||
        side->freedom < 0.0)
        return gsn_fail(err, GSN_E_INPUT, "%s: standard error %g with %g degrees of freedom",
                        side->name, side->standard_error, side->freedom);
    return GSN_OK;
}

static int check_alike(const struct gsn_loss_side *baseline, const struct gsn_loss_side *treated,
                       struct gsn_error *err)
{
    if (strcmp(baseline->definition, treated->definition) != 0)
        return gsn_fail(err, GSN_E_INPUT, "the density definitions differ: %s has %s, %s has %s",
                        baseline->name, baseline->definition, treated->name, treated->definition);
    if (strcmp(baseline->dyes, treated->dyes) != 0)
        return gsn_fail(err, GSN_E_INPUT, "the dye vectors differ: %s has %s, %s has %s",
                        baseline->name, baseline->dyes, treated->name, treated->dyes);
    if (!gsn_loss_is_one_volume(treated->volume_um3, baseline->volume_um3) &&
        !is_one_rule(baseline, treated))
        return gsn_fail(err, GSN_E_INPUT,
                        "the regions differ: %s has %.6g mm3 (%.80s), %s has %.6g mm3 (%.80s)",
                        baseline->name, baseline->volume_um3 * 1e-9, say_rule(baseline),
                        treated->name, treated->volume_um3 * 1e-9, say_rule(treated));
    return GSN_OK;
}

static int find_interval(const struct gsn_loss_side *baseline, const struct gsn_loss_side *treated,
                         double confidence, struct gsn_loss *loss, struct gsn_error *err)
{
    const double var_a = treated->standard_error * treated->standard_error;
    const double var_b = baseline->standard_error * baseline->standard_error;
    const double ratio = treated->mean / baseline->mean;
    const double freedom =
        gsn_welch_freedom(var_a, treated->freedom, ratio * ratio * var_b, baseline->freedom);
    const double tail = 0.5 + confidence / 2.0;
    const double quantile =
        freedom > 0.0 ? gsn_student_quantile(tail, freedom) : gsn_normal_quantile(tail);
    double low, high;
    const int r =
        gsn_fieller(treated->mean, var_a, baseline->mean, var_b, quantile, &low, &high, err);

    if (r < 0)
        return gsn_fail_at(err, "baseline %s", baseline->name);
    loss->has_interval = 1;
    loss->percent_low = 100.0 * (1.0 - high);
    loss->percent_high = 100.0 * (1.0 - low);
    return GSN_OK;
}

int gsn_loss(const struct gsn_loss_side *baseline, const struct gsn_loss_side *treated,
             double confidence, struct gsn_loss *ret_loss, struct gsn_error *err)
{
    struct gsn_loss loss = { 0 };
    int r;

    assert(confidence > 0.0 && confidence < 1.0);
    r = check_side(baseline, err);
    if (r == GSN_OK)
        r = check_side(treated, err);
    if (r == GSN_OK)
        r = check_alike(baseline, treated, err);
    if (r < 0)
        return r;
    if (!(baseline->mean > nearly_zero))
        return gsn_fail(err, GSN_E_WITHHELD,
                        "the baseline %s has a mean density of %.3g, too near zero to divide by",
                        baseline->name, baseline->mean);
    loss.percent = 100.0 * (1.0 - treated->mean / baseline->mean);
    loss.points = 100.0 * (baseline->mean - treated->mean);
    if (baseline->standard_error > 0.0 && treated->standard_error > 0.0) {
        r = find_interval(baseline, treated, confidence, &loss, err);
        if (r < 0)
            return r;
    }
    *ret_loss = loss;
    return GSN_OK;
}
