/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dates of the calendar as numbers. */
#ifndef GSN_CORE_CALENDAR_H
#define GSN_CORE_CALENDAR_H

#include "pipeline/core/error.h"

#ifdef __cplusplus
extern "C" {
#endif

/* A date as YYYY-MM-DD in days since 1970-01-01, proleptic Gregorian.
 * Fails with GSN_E_INPUT when the text is no such date. */
int gsn_calendar_day(const char *text, long *ret_day, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
