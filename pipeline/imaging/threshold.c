/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Otsu (1979): one pass over the cuts with running sums. Not cv::threshold(), which takes 8 bits
 * alone and of equally good cuts the first: a well parted pair is then cut at the foot of its lower
 * class. */
#include "pipeline/imaging/threshold.h"

#include <math.h>

size_t gsn_otsu_cut(const size_t *histogram, size_t bins, double *ret_apart)
{
    double count = 0, all = 0, best = 0, below = 0, sum = 0, apart = 0;
    size_t first = 0, last = 0;

    for (size_t i = 0; i < bins; i++) {
        count += (double)histogram[i];
        all += (double)i * (double)histogram[i];
    }
    for (size_t i = 0; i + 1 < bins; i++) {
        below += (double)histogram[i];
        sum += (double)i * (double)histogram[i];
        const double above = count - below;
        const double gap = all * below / count - sum;
        const double between = below > 0 && above > 0 ? gap * gap / (below * above) : 0;

        if (between > best) {
            best = between;
            first = i;
            apart = (all - sum) / above - sum / below;
        }
        if (between >= best)
            last = i;
    }
    if (ret_apart)
        *ret_apart = apart;
    return (first + last) / 2 + 1;
}

double gsn_otsu(const float *values, size_t count)
{
    enum { STEPS = 512 };
    size_t bin[STEPS] = { 0 };
    double low, high;

    if (count == 0)
        return NAN;
    low = high = values[0];
    for (size_t i = 1; i < count; i++) {
        low = fmin(low, values[i]);
        high = fmax(high, values[i]);
    }
    if (!(high > low))
        return low;
    for (size_t i = 0; i < count; i++) {
        const size_t at = (size_t)((values[i] - low) / (high - low) * STEPS);

        bin[at < STEPS ? at : STEPS - 1]++;
    }
    return low + (high - low) * (double)gsn_otsu_cut(bin, STEPS, NULL) / STEPS;
}
