/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/reference.h"

#include <math.h>

#include "pipeline/core/robust.h"

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
