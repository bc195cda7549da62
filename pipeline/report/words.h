/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The words that the page and the JSON share. */
#ifndef GSN_REPORT_WORDS_H
#define GSN_REPORT_WORDS_H

#include "pipeline/report/report.h"

static inline const char *gsn_report_kind_word(enum gsn_report_kind kind)
{
    static const char *const word[] = { "specimen", "volume", "tile" };

    return word[kind];
}

static inline const char *gsn_report_verdict_word(enum gsn_report_verdict verdict)
{
    static const char *const word[] = { "reported", "reported with warnings", "withheld" };

    return word[verdict];
}

#endif
