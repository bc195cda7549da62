/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Drawn panels as the specimen that the conductor is given: bytes behind a read(), sections as
 * gsn_panel_analyse() finds them. */
#ifndef GSN_TESTS_SPECIMEN_DRAWN_SPECIMEN_H
#define GSN_TESTS_SPECIMEN_DRAWN_SPECIMEN_H

#include "pipeline/specimen/specimen.h"
#include "tests/specimen/drawn_panel.h"

enum { DRAWN_PANELS = 4 };

/* Three panels, twelve sections every 24 um; a region of 576 x 336 x 192 um that no mark is near.
 */
#define DRAWN_JOB_HEAD                                                                             \
    "\"px_um\": 24, \"layout\": [2, 2], \"panels\": 3, \"transfer\": \"linear\", "                 \
    "\"markers_um\": " DRAWN_MARKS_JSON
#define DRAWN_REGION "{\"shape\": \"box\", \"min\": [-288, -168, 48], \"max\": [288, 168, 240]}"
#define DRAWN_JOB "{\"specimen\": \"drawn\", " DRAWN_JOB_HEAD ", \"region\": " DRAWN_REGION "}"

struct drawn_specimen {
    struct gsn_specimen specimen; /* may be changed between init and use */
    struct gsn_protocol *protocol;
    size_t count;
    struct gsn_panel_findings *findings[DRAWN_PANELS];
    struct gsn_specimen_panel panel[DRAWN_PANELS];
    struct gsn_specimen_input input[DRAWN_PANELS];
    uint8_t *png[DRAWN_PANELS];
    char sha256[DRAWN_PANELS][65], file[DRAWN_PANELS][32];
};

/* Fails the test when something fails. The address of specimen must not change afterwards. */
void drawn_specimen_init(struct drawn_specimen *specimen, const char *job,
                         const struct drawn_panel *panels, size_t count);
/* Three panels whose sections all have this density. */
void drawn_specimen_even(struct drawn_specimen *specimen, const char *job, double density);
void drawn_specimen_done(struct drawn_specimen *specimen);
#define drawn_auto __attribute__((cleanup(drawn_specimen_done))) struct drawn_specimen

/* gives: a parsed job. Fails the test when it is wrong. */
struct gsn_protocol *drawn_protocol(const char *job);

#endif
