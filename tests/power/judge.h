/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether what a power cut left is as was promised: opened by the product's own code, and the
 * intake run again to its end. */
#ifndef GSN_TESTS_POWER_JUDGE_H
#define GSN_TESTS_POWER_JUDGE_H

#include <stddef.h>

enum power_verdict {
    POWER_FINE,
    POWER_CLOSED,     /* the store cannot be opened */
    POWER_DAMAGED,    /* the database or its diary is not sound */
    POWER_LOST,       /* an acknowledged picture has no row */
    POWER_ROW_ALONE,  /* a row has not its exact object */
    POWER_FALSE_NAME, /* an object is not what its name says */
    POWER_NOT_AGAIN,  /* the next intake does not end */
    POWER_NOT_ONCE,   /* after it, a picture is missing or there twice */
    POWER_LEFT_OVER,  /* temporaries stay */
    POWER_DIED,       /* the process that looked */
    POWER_VERDICTS,
};

const char *power_verdict_name(enum power_verdict verdict);

/* safe: "SHA256 NAME" of the count pictures acknowledged before the cut. pictures: how many there
 * are in the folder of the address. text: room for a sentence. */
enum power_verdict power_judge(const char *store, const char *address, const char *const *safe,
                               size_t count, size_t pictures, char text[static 600]);

#endif
