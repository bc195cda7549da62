/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sections laid on by their tissue: what is gathered from the panels (assembly_refine_gather.c) for
 * what is compared and moved (assembly_refine.c). Private to these files. */
#ifndef GSN_PIPELINE_ASSEMBLY_REFINE_H
#define GSN_PIPELINE_ASSEMBLY_REFINE_H

#include "pipeline/assembly_parts.h"
#include "pipeline/masking.h"
#include "pipeline/register/tissue/refine.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/collagen_density.h"

/* The sections in cells about the region, while they are gathered and compared. */
struct gsn_refine_work {
    const struct gsn_specimen *specimen;
    const struct gsn_specimen_options *options;
    struct gsn_assembly *a;
    struct gsn_point *target; /* owned, as are the next */
    size_t target_count;
    size_t *section;       /* of the stack: its place in the assembly */
    struct gsn_grid *grid; /* one plane for each serial number */
    struct gsn_refine_section *prior;
    struct gsn_refined *refined;
    double radius_um;
    struct gsn_refine_stack stack;
    /* The panel that is open. */
    const struct gsn_collagen_reader *reader;
    const struct gsn_artefact_labels *labels;
    unsigned panel;
};

/* Opens the panels and lays the density of the sections listed into w->grid, whose planes are there
 * and empty. Fails as reading, decoding, unmixing and masking do. */
int gsn_refine_gather(struct gsn_refine_work *w, struct gsn_error *err);

#endif
