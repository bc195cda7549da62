/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What gieson-intake does with a folder, in one call and until the folder's end. */
#ifndef GSN_TESTS_POWER_INGEST_H
#define GSN_TESTS_POWER_INGEST_H

#include "pipeline/core/error.h"

struct power_ingest {
    const char *store, *address;
    /* How many pictures to take before the store is closed again; 0: all there are. */
    unsigned most;
    /* After every so many pictures another handle checkpoints the log, as other programs do; 0:
     * never. */
    unsigned checkpoint_every;
    void (*acknowledged)(void *context, const char *name, const char *sha256);
    void *context;
};

/* Makes the store and its specimen where they are missing. ret_taken: pictures acknowledged now. */
int power_ingest(const struct power_ingest *ingest, unsigned *ret_taken, struct gsn_error *err);

#endif
