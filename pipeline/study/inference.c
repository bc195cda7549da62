/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Inference over animals: the statistics of small groups.
 *
 * Method. Means with Student's interval. Differences by Welch's t, as nothing says that a treatment
 * leaves the spread alone. The loss is a ratio of means, so its interval is Fieller's, with Welch
 * and Satterthwaite's freedom for mean_a - rho mean_b at the rho found. Hedges' g takes the pooled
 * standard deviation, as is its definition, with the exact factor of unbiasedness and the interval
 * that inverts the noncentral t (Hedges and Olkin 1985, 5.B; Steiger and Fouladi 1997). The
 * permutation test goes through every way to deal the values out.
 *
 * The noncentral t is integrated over the chi distribution, P = E[Phi(t s - delta)] with
 * s = chi / sqrt(freedom), by Simpson's rule: GSL has none.
 *
 * Failure: too few animals give NaN and never a guess. Cost: constant, but for permutations, which
 * grow with the number of ways, and the interval of g, some ten integrals an end. */
#include "pipeline/study/inference.h"

#include "pipeline/core/distributions.h"
#include "pipeline/core/mem.h"
#include "pipeline/measure/stats.h"

#include <float.h>
#include <math.h>
#include <stdint.h>

enum { MOST_ANIMALS = 10000 };

static const double two_sided = 0.975;

static double square_of(double x)
{
    return x * x;
}

struct gsn_group_mean gsn_group_mean_of(const double *value, size_t n)
{
    struct gsn_group_mean m = { n, NAN, NAN, NAN, NAN };
    double sum = 0, squares = 0, reach;

    for (size_t i = 0; i < n; i++)
        sum += value[i];
    if (n > 0)
        m.mean = sum / (double)n;
    if (n < 2)
        return m;
    for (size_t i = 0; i < n; i++)
        squares += square_of(value[i] - m.mean);
    m.sd = sqrt(squares / (double)(n - 1));
    reach = gsn_student_quantile(two_sided, (double)(n - 1)) * m.sd / sqrt((double)n);
    m.lower = m.mean - reach;
    m.upper = m.mean + reach;
    return m;
}

/* Of the mean. */
static double variance_of(const struct gsn_group_mean *m)
{
    return square_of(m->sd) / (double)m->n;
}

/* ---- the noncentral t ---------------------------------------------------------------------- */

/* Density of chi / sqrt(freedom), freedom >= 1. */
static double scaled_chi_density(double s, double freedom)
{
    const double half = 0.5 * freedom;

    return 2 * exp(half * log(half) - lgamma(half) + (freedom - 1) * log(fmax(s, 1e-300)) -
                   half * square_of(s));
}

double gsn_noncentral_t(double t, double freedom, double noncentrality)
{
    enum { STEPS = 4000 };
    /* Nine of its standard deviations: 1e-13 lies beyond, for one degree of freedom as for many. */
    const double reach = 9 / sqrt(2 * freedom);
    const double first = fmax(1 - reach, 0), last = 1 + reach;
    const double step = (last - first) / STEPS;
    double sum = 0;

    for (int i = 0; i <= STEPS; i++) {
        const double s = first + step * i;
        const double weight = i == 0 || i == STEPS ? 1 : i % 2 ? 4 : 2;

        sum += weight * gsn_normal_cdf(t * s - noncentrality) * scaled_chi_density(s, freedom);
    }
    return fmin(fmax(sum * step / 3, 0), 1);
}

/* The noncentrality with which t is passed with this probability; P falls as it grows. Regula falsi
 * that halves the weight of an end that stays (Dowell and Jarratt 1971, "Illinois"). */
static double invert_noncentrality(double t, double freedom, double probability)
{
    double low = t - 1, high = t + 1, above, below;

    while ((above = gsn_noncentral_t(t, freedom, low) - probability) < 0 && t - low < 1e4)
        low = t - 2 * (t - low);
    while ((below = gsn_noncentral_t(t, freedom, high) - probability) > 0 && high - t < 1e4)
        high = t + 2 * (high - t);
    for (int i = 0, stays = 0; i < 60 && high - low > 1e-12 * (1 + fabs(t)); i++) {
        const double here = low + (high - low) * above / (above - below);
        const double off = gsn_noncentral_t(t, freedom, here) - probability;

        if (off == 0)
            return here;
        if (off > 0) {
            low = here;
            above = off;
            below *= stays > 0 ? 0.5 : 1;
            stays = 1;
        } else {
            high = here;
            below = off;
            above *= stays < 0 ? 0.5 : 1;
            stays = -1;
        }
    }
    return 0.5 * (low + high);
}

/* ---- one group against another ------------------------------------------------------------- */

static void measure_effect(const struct gsn_group_mean *a, const struct gsn_group_mean *b,
                           struct gsn_group_difference *d)
{
    const double freedom = (double)(a->n + b->n - 2);
    const double pooled = sqrt(
        ((double)(a->n - 1) * square_of(a->sd) + (double)(b->n - 1) * square_of(b->sd)) / freedom);
    const double per_t = sqrt(1.0 / (double)a->n + 1.0 / (double)b->n);
    const double unbiased =
        exp(lgamma(0.5 * freedom) - lgamma(0.5 * (freedom - 1))) / sqrt(0.5 * freedom);
    const double t = d->difference / pooled / per_t;

    if (!(pooled > 0) || fabs(t) > 1e3) /* no spread that a double could hold */
        return;
    d->g = unbiased * d->difference / pooled;
    d->g_lower = unbiased * per_t * invert_noncentrality(t, freedom, two_sided);
    d->g_upper = unbiased * per_t * invert_noncentrality(t, freedom, 1 - two_sided);
}

struct gsn_group_difference gsn_group_welch(const struct gsn_group_mean *a,
                                            const struct gsn_group_mean *b)
{
    struct gsn_group_difference d = { a->mean - b->mean, NAN, NAN, NAN, NAN, NAN, NAN, NAN, NAN };
    double error, reach;

    if (a->n < 2 || b->n < 2)
        return d;
    error = sqrt(variance_of(a) + variance_of(b));
    if (!(error > 0))
        return d;
    d.freedom =
        gsn_welch_freedom(variance_of(a), (double)(a->n - 1), variance_of(b), (double)(b->n - 1));
    d.t = d.difference / error;
    d.p = 2 * gsn_student_tail(fabs(d.t), d.freedom);
    reach = gsn_student_quantile(two_sided, d.freedom) * error;
    d.lower = d.difference - reach;
    d.upper = d.difference + reach;
    return d;
}

struct gsn_group_difference gsn_group_compare(const struct gsn_group_mean *a,
                                              const struct gsn_group_mean *b)
{
    struct gsn_group_difference d = gsn_group_welch(a, b);

    if (isfinite(d.p))
        measure_effect(a, b, &d);
    return d;
}

struct gsn_group_loss gsn_group_loss_of(const struct gsn_group_mean *a,
                                        const struct gsn_group_mean *b)
{
    const double ratio = a->mean / b->mean;
    struct gsn_group_loss loss = { 100 * (1 - ratio), NAN, NAN };
    double freedom, low, high;

    if (!isfinite(ratio))
        loss.percent = NAN;
    if (a->n < 2 || b->n < 2 || !isfinite(ratio))
        return loss;
    freedom = gsn_welch_freedom(variance_of(a), (double)(a->n - 1),
                                square_of(ratio) * variance_of(b), (double)(b->n - 1));
    if (!(freedom > 0))
        return loss;
    if (gsn_fieller(a->mean, variance_of(a), b->mean, variance_of(b),
                    gsn_student_quantile(two_sided, freedom), &low, &high, NULL) < 0)
        return loss;
    loss.lower = 100 * (1 - high);
    loss.upper = 100 * (1 - low);
    return loss;
}

/* ---- permutation --------------------------------------------------------------------------- */

/* n over k; more than the limit counts as the limit. */
static double count_ways(size_t n, size_t k)
{
    double ways = 1;

    for (size_t i = 1; i <= k && ways < 1e15; i++)
        ways = ways * (double)(n - k + i) / (double)i;
    return ways;
}

double gsn_permutation_least_p(size_t n_a, size_t n_b)
{
    if (n_a == 0 || n_b == 0)
        return 1;
    return fmin(1, 2 / round(count_ways(n_a + n_b, n_a < n_b ? n_a : n_b)));
}

/* The next k of n indices in lexical order; returns the first place that changed, k after the
 * last. */
static size_t advance_choice(size_t *choice, size_t k, size_t n)
{
    size_t i = k, changed;

    while (i > 0 && choice[i - 1] == n - k + i - 1)
        i--;
    if (i == 0)
        return k;
    changed = i - 1;
    choice[changed]++;
    for (; i < k; i++)
        choice[i] = choice[i - 1] + 1;
    return changed;
}

/* How many of all ways differ by at least as much as the first n_a values do from the rest. sum:
 * room for n_a + 1, of the first values chosen, so that a way costs what it changes. */
static double share_at_least(const double *value, size_t n, size_t n_a, size_t *choice, double *sum)
{
    double total = 0, size = 0, seen = 0, ways = 0, as_far = 0;
    size_t changed = 0;

    for (size_t i = 0; i < n; i++) {
        total += value[i];
        size = fmax(size, fabs(value[i]));
        seen += i < n_a ? value[i] : 0;
    }
    /* |mean_a - mean_b| grows with |sum_a - n_a/n total|: the same for all ways. */
    seen = fabs(seen - (double)n_a / (double)n * total);
    for (size_t i = 0; i < n_a; i++)
        choice[i] = i;
    sum[0] = 0;
    do {
        for (size_t i = changed; i < n_a; i++)
            sum[i + 1] = sum[i] + value[choice[i]];
        ways++;
        /* A tie is a tie, whatever the order of addition made of its last bits. */
        as_far += fabs(sum[n_a] - (double)n_a / (double)n * total) >=
                  seen - 64 * DBL_EPSILON * (double)n * size;
        changed = advance_choice(choice, n_a, n);
    } while (changed < n_a);
    return as_far / ways;
}

int gsn_permutation_p(const double *a, size_t n_a, const double *b, size_t n_b, double *ret_p,
                      struct gsn_error *err)
{
    gsn_auto_mem(double) value = NULL;
    gsn_auto_mem(double) sum = NULL;
    gsn_auto_mem(size_t) choice = NULL;

    if (n_a == 0 || n_b == 0)
        return gsn_fail(err, GSN_E_INPUT, "a permutation test needs animals on both sides");
    if (count_ways(n_a + n_b, n_a) > GSN_PERMUTATIONS)
        return gsn_fail(err, GSN_E_LIMIT,
                        "%zu and %zu animals can be dealt out in more than %d ways", n_a, n_b,
                        (int)GSN_PERMUTATIONS);
    value = gsn_alloc_array(n_a + n_b, sizeof *value);
    sum = gsn_alloc_array(n_a + 1, sizeof *sum);
    choice = gsn_alloc_array(n_a, sizeof *choice);
    if (!value || !sum || !choice)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a permutation test");
    for (size_t i = 0; i < n_a; i++)
        value[i] = a[i];
    for (size_t i = 0; i < n_b; i++)
        value[n_a + i] = b[i];
    *ret_p = share_at_least(value, n_a + n_b, n_a, choice, sum);
    return GSN_OK;
}

/* ---- several comparisons ------------------------------------------------------------------- */

void gsn_holm(double *p, size_t count)
{
    size_t left = 0;
    double so_far = 0;

    for (size_t i = 0; i < count; i++)
        left += isnan(p[i]) ? 0 : 1;
    for (; left > 0; left--) {
        size_t least = count;

        /* What is done carries a sign. */
        for (size_t i = 0; i < count; i++)
            if (!isnan(p[i]) && !signbit(p[i]) && (least == count || p[i] < p[least]))
                least = i;
        so_far = fmin(1, fmax(so_far, p[least] * (double)left));
        p[least] = -so_far;
    }
    for (size_t i = 0; i < count; i++)
        p[i] = fabs(p[i]);
}

/* ---- planning ------------------------------------------------------------------------------ */

double gsn_power(double effect, size_t n, double alpha)
{
    const double freedom = 2 * (double)(n - 1);
    const double limit = gsn_student_quantile(1 - 0.5 * alpha, freedom);
    const double noncentrality = fabs(effect) * sqrt(0.5 * (double)n);

    return 1 - gsn_noncentral_t(limit, freedom, noncentrality) +
           gsn_noncentral_t(-limit, freedom, noncentrality);
}

size_t gsn_animals_needed(double effect, double alpha, double power)
{
    size_t low = 1, high = 2;

    while (high <= MOST_ANIMALS && gsn_power(effect, high, alpha) < power) {
        low = high;
        high *= 2;
    }
    if (gsn_power(effect, high, alpha) < power)
        return 0;
    while (high - low > 1) {
        const size_t middle = low + (high - low) / 2;

        if (gsn_power(effect, middle, alpha) < power)
            low = middle;
        else
            high = middle;
    }
    return high > MOST_ANIMALS ? 0 : high;
}
