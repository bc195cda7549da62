/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dates of the calendar as numbers; a clock. */
#ifndef GSN_CORE_CALENDAR_H
#define GSN_CORE_CALENDAR_H

#include "pipeline/core/error.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* A date as YYYY-MM-DD in days since 1970-01-01, proleptic Gregorian.
 * Fails with GSN_E_INPUT when the text is no such date. */
int gsn_calendar_day(const char *text, long *ret_day, struct gsn_error *err);

/* Milliseconds of a clock that nobody sets (CLOCK_MONOTONIC); its beginning means nothing. */
int64_t gsn_now_ms(void);

/* Milliseconds of the processor that this process has used, all its threads together. */
double gsn_process_cpu_ms(void);

#ifdef __cplusplus
}
#endif
#endif
