/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Names of files as people read them: in which order they count, and what they call a picture. */
#ifndef GSN_ACQUIRE_NATURAL_H
#define GSN_ACQUIRE_NATURAL_H

#ifdef __cplusplus
extern "C" {
#endif

/* Natural order: runs of digits compare as numbers of any length, the rest as bytes; names that
 * are equal so far (1, 01) fall back to bytes. Returns < 0, 0, > 0; 0 only for equal names. */
int gsn_natural_compare(const char *a, const char *b);

/* Whether a file of this name is called like a picture ("P01.TIF"). */
int gsn_name_is_picture(const char *name);

#ifdef __cplusplus
}
#endif
#endif
