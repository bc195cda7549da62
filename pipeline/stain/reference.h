/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How strongly a panel was stained, told by a tissue whose collagen does not change.
 *
 * Rinsing decides how much acid fuchsin stays, so two panels of the same tissue differ by a factor
 * that is no loss. A tissue outside of the treated region, dentine or connective tissue, carries
 * the same factor: its density as measured over its density as stated is the gain that everything
 * on that panel is divided by. */
#ifndef GSN_STAIN_REFERENCE_H
#define GSN_STAIN_REFERENCE_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* The reference tissue of one section. */
struct gsn_reference_section {
    double red; /* as gsn_reference_red() gives it */
    size_t pixels;
};

struct gsn_stain_gain {
    double gain;  /* what red is to be divided by; 1 where none was measured */
    double error; /* standard error of gain; 0 where none was measured */
    unsigned sections;
    size_t pixels;
};

/* The mean of the middle three fifths: holes, nuclei and strays at either end do not pull it, and
 * it grows in proportion to the stain. NaN when count is 0. Reorders the values; none may be NaN.
 */
double gsn_reference_red(double *values, size_t count);

/* stated: the reference tissue's density in the protocol, > 0. The error is what the sections
 * disagree by. Fails with GSN_E_STAIN when the tissue shows on fewer than three sections (of 50
 * pixels each), or is too pale to compare with. */
int gsn_stain_reference(const struct gsn_reference_section *sections, size_t count, double stated,
                        struct gsn_stain_gain *ret_gain, struct gsn_error *err);

/* The gain to take for a panel that shows too little of the reference, from the specimen's other
 * panels: their mean, with an error that holds what panels differ by. Gains without sections do not
 * take part. Fails with GSN_E_STAIN when fewer than two are left. */
int gsn_stain_gain_of_others(const struct gsn_stain_gain *gains, size_t count,
                             struct gsn_stain_gain *ret_gain, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
