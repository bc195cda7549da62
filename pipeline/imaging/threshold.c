/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Otsu (1979): one pass over the cuts with running sums. Not cv::threshold(), which takes 8 bits
 * alone and of equally good cuts the first: a well parted pair is then cut at the foot of its lower
 * class. */
#include "pipeline/imaging/threshold.h"

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
