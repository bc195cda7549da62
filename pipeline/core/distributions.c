/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Quantiles and tails by GSL's cdf functions (GNU Scientific Library 2.7, chapter "Random Number
 * Distributions"; Wichura 1988 for the normal, Hill 1970 for Student's quantile).
 *
 * Not taken from GSL is the quantile of Fisher's F: gsl_cdf_fdist_Qinv() gives NaN, or with GSL's
 * own handler ends the process, from 400 degrees of freedom on (3 274 of 12 354 pairs of freedom up
 * to 1e8 and probability down to 1e-9). Its tail is right (against R 4.2 within 1e-9 up to 1e4
 * degrees of freedom, 3e-4 at 5e5), so the limit is found by halving an interval of that. A known
 * variance is chi-squared, where GSL's inverse is right for the few degrees of freedom asked for
 * here.
 *
 * Arguments outside of what the header allows are a caller's mistake; inside nothing fails. */
#include "pipeline/core/distributions.h"

#include <assert.h>
#include <math.h>

#include <gsl/gsl_cdf.h>

double gsn_normal_cdf(double z)
{
    return gsl_cdf_ugaussian_P(z);
}

double gsn_normal_quantile(double probability)
{
    assert(probability > 0.0 && probability < 1.0);
    return gsl_cdf_ugaussian_Pinv(probability);
}

double gsn_student_quantile(double probability, double freedom)
{
    assert(probability > 0.0 && probability < 1.0 && freedom > 0.0);
    return gsl_cdf_tdist_Pinv(probability, freedom);
}

double gsn_student_tail(double t, double freedom)
{
    assert(freedom > 0.0);
    return gsl_cdf_tdist_Q(t, freedom);
}

/* ---- sums of squares over an estimated variance --------------------------------------------- */

double gsn_ratio_tail(unsigned p, double freedom, double square)
{
    assert(p >= 1 && freedom >= 1 && !isnan(square));

    if (square <= 0)
        return 1;
    if (isinf(square))
        return 0;
    return isinf(freedom) ? gsl_cdf_chisq_Q(square, p) : gsl_cdf_fdist_Q(square / p, p, freedom);
}

double gsn_ratio_limit(unsigned p, double freedom, double alpha)
{
    double low, high;

    assert(p >= 1 && freedom >= 1 && alpha > 0 && alpha < 1);

    /* An estimated variance makes the tail heavier: the limit is no less than with a known one. */
    low = gsl_cdf_chisq_Qinv(alpha, p);
    if (isinf(freedom))
        return low;
    low *= 0.5;
    for (high = 4 * low; gsn_ratio_tail(p, freedom, high) > alpha; high *= 4)
        low = high;
    while (high - low > 1e-12 * high) {
        const double middle = low + 0.5 * (high - low);

        if (gsn_ratio_tail(p, freedom, middle) > alpha)
            low = middle;
        else
            high = middle;
    }
    return low + 0.5 * (high - low);
}
