/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What one panel shows, in parts: its slots and label, the marks of its sections, what a person
 * decided. Private to examine*.c. Lengths are panel pixels. */
#ifndef GSN_PIPELINE_EXAMINE_PARTS_H
#define GSN_PIPELINE_EXAMINE_PARTS_H

#include "pipeline/examine.h"
#include "pipeline/register/panel/slots.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Adds a word to the section's flags. */
void gsn_section_flag(struct gsn_panel_section *section, const char *word);
/* Adds a sentence to the panel's note; one that does not fit is left out whole. */
void gsn_findings_say(struct gsn_panel_findings *findings, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* Marks of all sections of the panel: found slots and their numbers in findings. A panel whose
 * sections agree on no triangle is no failure: its sections need a person's eye. */
int gsn_examine_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                      const struct gsn_slot *found, size_t count,
                      const struct gsn_panel_answers *answers, unsigned threads,
                      struct gsn_panel_findings *findings, struct gsn_error *err);
/* Sections that show no marks where the job knows their triangle: perhaps they are there, and the
 * pixels are not as large as stated. A person puts that right, since all lengths hang on it. */
int gsn_examine_pixels(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                       const struct gsn_slot *found, size_t count, unsigned threads,
                       const struct gsn_panel_findings *findings, struct gsn_error *err);

/* Whether a person said this of the panel as a whole. */
int gsn_answers_say(const struct gsn_panel_answers *answers, enum gsn_panel_said said);
/* The slot that a person said is the panel's first of tissue; GSN_SLOT_UNSAID: nobody did. */
unsigned gsn_answers_first(const struct gsn_panel_answers *answers, size_t slots);
/* borrows: the answer about this scrap, or NULL. */
const struct gsn_panel_answer *gsn_answers_scrap(const struct gsn_panel_answers *answers,
                                                 size_t slots, const struct gsn_scrap *scrap);
/* Cuts, holds and seats the sections and scraps that a person spoke of. */
void gsn_answers_apply(const struct gsn_panel_answers *answers, struct gsn_slot *slots,
                       size_t count, const struct gsn_scrap *scraps, size_t scrap_count);

#ifdef __cplusplus
}
#endif
#endif
