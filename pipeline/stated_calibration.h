/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What job.json says of calibration panels: which file, for which panels of the specimen, and what
 * its patches hold, row by row. */
#ifndef GSN_PIPELINE_STATED_CALIBRATION_H
#define GSN_PIPELINE_STATED_CALIBRATION_H

#include "pipeline/core/error.h"
#include "pipeline/stain/calibration.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_MOST_PATCHES = 48 };

struct gsn_stated_patch {
    enum gsn_patch_kind kind;
    double density;      /* of a standard */
    unsigned row, place; /* 1-based */
};

struct gsn_stated_calibration {
    char *file; /* owned, as is the next */
    size_t panel_count;
    unsigned *panel; /* 1-based; NULL: all panels */
    size_t patch_count;
    struct gsn_stated_patch patch[GSN_MOST_PATCHES]; /* by row, then place */
};

struct json_t;

/* gives: one for each that value states; NULL and 0 where value is NULL.
 * Fails with GSN_E_INPUT, GSN_E_NOMEM. */
int gsn_stated_calibrations_read(const struct json_t *value,
                                 struct gsn_stated_calibration **ret_calibrations,
                                 size_t *ret_count, struct gsn_error *err);
void gsn_stated_calibrations_free(struct gsn_stated_calibration *calibrations, size_t count);

/* The one of these that a panel was stained with, or NULL. */
const struct gsn_stated_calibration *
gsn_stated_calibration_of(const struct gsn_stated_calibration *calibrations, size_t count,
                          unsigned panel);

/* Whether it holds standards of a known density. */
int gsn_stated_calibration_has_standards(const struct gsn_stated_calibration *calibration);

#ifdef __cplusplus
}
#endif
#endif
