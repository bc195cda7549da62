/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How long a stain waited for its scan. Picro-fuchsin fades, in acid mounting media quickly, and
 * what has faded looks like collagen that was lost. */
#ifndef GSN_STAIN_AGE_H
#define GSN_STAIN_AGE_H

#include "pipeline/core/error.h"

#ifdef __cplusplus
extern "C" {
#endif

/* More days than this between stain and scan are told. */
#define GSN_AGE_TOLD_DAYS 28

/* A date as YYYY-MM-DD in days since 1970-01-01, proleptic Gregorian.
 * Fails with GSN_E_INPUT when the text is no such date. */
int gsn_age_day(const char *text, long *ret_day, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
