/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Everything the store knows of one specimen, and what a person is to do next about it: what
 * `gieson show` tells, in words and as JSON, and what `gieson decide` looks an answer up in. */
#ifndef GSN_UI_SHOW_H
#define GSN_UI_SHOW_H

#include "storage/bench.h"
#include "storage/decision.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/result.h"
#include "storage/queue.h"
#include "ui/ui.h"

#include <jansson.h>

struct gsn_show {
    struct gsn_specimen_row *specimen;
    struct gsn_panel_rows *panels;
    struct gsn_section_rows *sections;
    struct gsn_run_rows *runs;
    struct gsn_measure_rows *measures; /* of the latest run; NULL when there is none */
    struct gsn_open_panel_rows *open;
    struct gsn_bench_sources *sources;
    struct gsn_trouble_rows *troubles;
    struct gsn_decision_rows *decided;
    struct gsn_candidate_rows *candidates;
    int64_t expected; /* panels that the job states, or 0 */
};

/* Both give what view holds, on failure too, and fail as the store does. */
/* The specimen, its panels and sections, what was answered about them and the poses to choose from;
 * the rest of view is left alone. */
int gsn_show_load_sections(struct gsn_store *store, const char *name, struct gsn_show *view,
                           struct gsn_error *err);
void gsn_show_done(struct gsn_show *view);

/* Whether this word is among its flags. */
int gsn_show_has_flag(const struct gsn_section_row *section, const char *flag);
/* What was answered about a place, or NULL. */
const struct gsn_decision_row *gsn_show_decision_on(const struct gsn_show *view, int64_t number,
                                                    int64_t slot);
/* The first of a section's candidates, which follow each other, and their number. */
size_t gsn_show_candidates(const struct gsn_show *view, const struct gsn_section_row *s,
                           const struct gsn_candidate_row **ret_first);

#endif
