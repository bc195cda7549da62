/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The word that somebody meant: of a list, the one with the fewest slips of the hand from what was
 * written. */
#ifndef GSN_CORE_NEAREST_H
#define GSN_CORE_NEAREST_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* NULL where more than a third of the letters (at least two) would have to change. borrows: one of
 * the words. Slips are a letter too many, too few, another one, or two that are swapped (optimal
 * string alignment); upper and lower case are alike. */
const char *gsn_nearest(const char *written, const char *const *words, size_t count);

#ifdef __cplusplus
}
#endif
#endif
