/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where density 0 lies on the common scale of many panels.
 *
 * A yellow vector that is off makes yellow count as red, or red as less than it is, by the same on
 * all tissue of a panel: there density 0 is where the panel's vectors put it, and not where it is.
 * Tissue shows what panels differ by in that (stain/level.h), and not which of them is right. What
 * they are off by is peaked and has long tails, as a vector that turns by a normal angle to any
 * side has components like that: most baths are near what the vectors say, and one now and then is
 * far off. So density 0 is where most panels put it, of however many specimens, and not at their
 * mean: the location of Student's distribution with three degrees of freedom (Lange, Little and
 * Taylor 1989, 10.2307/2290063), whose scale is not known beforehand. */
#ifndef GSN_STAIN_LEVEL_ZERO_H
#define GSN_STAIN_LEVEL_ZERO_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_level_zero {
    double at;    /* density; mean of its probability when the panels are all that is known */
    double error; /* standard deviation of that; 0: not known */
    size_t panels;
};

/* zero: of each panel, where its vectors put density 0, on the common scale; finite. Fewer than two
 * tell nothing: at and error are 0. */
struct gsn_level_zero gsn_level_zero_of(const double *zero, size_t panels);

#ifdef __cplusplus
}
#endif
#endif
