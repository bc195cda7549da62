/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The flags of a section as the text of a report. */
#ifndef GSN_TESTS_SPECIMEN_FLAGS_H
#define GSN_TESTS_SPECIMEN_FLAGS_H

#include "pipeline/specimen/section_flags.h"

struct flags_text {
    char text[GSN_FLAGS_TEXT];
};

static inline struct flags_text text_of(const struct gsn_section_flags *flags)
{
    struct flags_text t;

    gsn_flags_text(flags, t.text);
    return t;
}

#endif
