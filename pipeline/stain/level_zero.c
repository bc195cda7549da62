/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/level_zero.h"

#include <math.h>

/* The panels' scale lies between these, any factor as likely as another: levelling leaves about the
 * least, and vectors ten degrees off are no Van Gieson's. */
static const double LEAST_SCALE = 0.005, MOST_SCALE = 0.3;
/* Of Student's distribution: fewer follow a few panels that happen to agree, more follow strays. */
static const double FREEDOM = 3;

enum { PLACES = 401, SCALES = 32 };

/* Logarithm of how probable the panels are with density 0 there, whatever the scale. */
static double evidence_at(const double *zero, size_t panels, double at)
{
    double each[SCALES], most = -INFINITY, sum = 0;

    for (int k = 0; k < SCALES; k++) {
        const double scale = LEAST_SCALE * pow(MOST_SCALE / LEAST_SCALE, k / (SCALES - 1.0));

        each[k] = -(double)panels * log(scale);
        for (size_t p = 0; p < panels; p++) {
            const double t = (zero[p] - at) / scale;

            each[k] -= (FREEDOM + 1) / 2 * log1p(t * t / FREEDOM);
        }
        most = fmax(most, each[k]);
    }
    for (int k = 0; k < SCALES; k++)
        sum += exp(each[k] - most);
    return most + log(sum);
}

struct gsn_level_zero gsn_level_zero_of(const double *zero, size_t panels)
{
    struct gsn_level_zero ret = { .panels = panels };
    double low = INFINITY, high = -INFINITY, most = -INFINITY, sum = 0, square = 0;
    double first, step, each[PLACES];

    if (panels < 2)
        return ret;
    for (size_t p = 0; p < panels; p++) {
        low = fmin(low, zero[p]);
        high = fmax(high, zero[p]);
    }
    first = 2 * low - high - 6 * LEAST_SCALE;
    step = (3 * (high - low) + 12 * LEAST_SCALE) / (PLACES - 1);
    for (int i = 0; i < PLACES; i++) {
        each[i] = evidence_at(zero, panels, first + i * step);
        most = fmax(most, each[i]);
    }
    for (int i = 0; i < PLACES; i++) {
        const double weight = exp(each[i] - most);

        sum += weight;
        ret.at += weight * i;
        square += weight * i * i;
    }
    ret.at /= sum;
    ret.error = step * sqrt(fmax(0, square / sum - ret.at * ret.at));
    ret.at = first + step * ret.at;
    return ret;
}
