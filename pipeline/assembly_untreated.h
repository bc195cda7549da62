/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Tissue that nobody treated while it is looked for: assembly_untreated.c tells what each column of
 * the block is, assembly_untreated_seen.c what the panels say of each tissue. Private to them. */
#ifndef GSN_PIPELINE_ASSEMBLY_UNTREATED_H
#define GSN_PIPELINE_ASSEMBLY_UNTREATED_H

#include "pipeline/assembly_parts.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The work in hand: one value and one kind per column of the block. */
struct gsn_untreated_field {
    struct gsn_lattice at;
    size_t count;
    float *smooth;            /* owned: mean of 3 x 3 x 3 where there is tissue, else NaN */
    uint8_t *kind;            /* owned: 1 + enum gsn_untreated, 0 none */
    struct gsn_grid *away;    /* owned: of each column from the region, um */
    double *value, *distance; /* owned: of the columns of one plane that are looked at */
    size_t *column;           /* owned: which they are */
    double *scratch;
};

/* A tissue's density in one section; NaN where too little of it is seen. ret_count: how many
 * columns it rests on, which f->column then lists first. */
double gsn_untreated_in(struct gsn_untreated_field *f, const struct gsn_assembly *a, uint8_t kind,
                        size_t z, size_t *ret_count);

/* Fills the levelling's tissues, vectors and turns. Fails with GSN_E_NOMEM, GSN_E_STAIN. */
int gsn_untreated_measure(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                          struct gsn_untreated_field *f, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
