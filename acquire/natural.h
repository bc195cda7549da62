/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The order in which people count files. */
#ifndef GSN_ACQUIRE_NATURAL_H
#define GSN_ACQUIRE_NATURAL_H

#ifdef __cplusplus
extern "C" {
#endif

/* Natural order: runs of digits compare as numbers of any length, the rest as bytes; names that
 * are equal so far (1, 01) fall back to bytes. Returns < 0, 0, > 0; 0 only for equal names. */
int gsn_natural_compare(const char *a, const char *b);

#ifdef __cplusplus
}
#endif
#endif
