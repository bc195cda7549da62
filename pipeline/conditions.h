/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Under which conditions the panels of a specimen were cut, stained and scanned, as they themselves
 * show it: the lamp by the blank glass, the bath by the dyes, the knife by all dyes together, the
 * scanner's dust by what every panel shares. */
#ifndef GSN_PIPELINE_CONDITIONS_H
#define GSN_PIPELINE_CONDITIONS_H

#include "pipeline/assembly.h"
#include "pipeline/scan.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Looks at one panel: fills lamp, tone and turn of it and the tones of its sections, and adds to
 * the assembly's map of dust, all in cells of about 20 um. Fails with GSN_E_STAIN as gsn_unmix()
 * and with GSN_E_NOMEM. borrows: scan, labels. */
int gsn_conditions_look(const struct gsn_scan *scan, const struct gsn_artefact_labels *labels,
                        struct gsn_assembly_panel *panel, struct gsn_assembly *assembly,
                        struct gsn_error *err);

/* After the last panel: says which sections are thicker or thinner than those beside them, and
 * takes the density behind the scanner's dust out of the stack. Fails with GSN_E_NOMEM. */
int gsn_conditions_judge(const struct gsn_specimen *specimen, struct gsn_assembly *assembly,
                         struct gsn_error *err);

struct gsn_conditions_words {
    size_t count;
    char **sentence; /* owned */
};

/* One sentence for each thing that somebody has to do something about.
 * Fails with GSN_E_NOMEM; what was said until then is there. */
int gsn_conditions_words(const struct gsn_assembly *assembly, const struct gsn_protocol *protocol,
                         struct gsn_conditions_words *words);
void gsn_conditions_words_done(struct gsn_conditions_words *words);

#ifdef __cplusplus
}
#endif
#endif
