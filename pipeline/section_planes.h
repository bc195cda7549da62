/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The densities of all laid sections side by side, in cells of the block frame: what is told by
 * comparing sections with each other. Those of held sections beside them, as they lie on their
 * slides: they may be second mounts of laid ones. */
#ifndef GSN_PIPELINE_SECTION_PLANES_H
#define GSN_PIPELINE_SECTION_PLANES_H

#include "pipeline/assembly.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One held section in cells of half the planes' or of its pixels, along its box. */
struct gsn_section_apart {
    size_t section; /* its place in the assembly */
    size_t columns, rows;
    double cell_um;
    float *density; /* owned; a mean, 0 where nothing was seen, NaN where it is masked */
};

struct gsn_section_planes {
    double cell_um;
    size_t count;            /* laid sections, one for each serial number, in their order */
    size_t *section;         /* owned; their places in the assembly */
    struct gsn_point origin; /* of the first cell's corner, um in the block */
    size_t columns, rows;
    float *density; /* owned; count * columns * rows: a sum, and after settling its mean */
    float *seen;    /* owned; as many: um2 of tissue or glass seen */
    size_t held_count;
    struct gsn_section_apart *held; /* owned; room for all sections, in the order they came */
};

/* The places of the laid sections, the first of each serial number, in their order; returns how
 * many. ret_section: room for all sections of the assembly. */
size_t gsn_section_planes_list(const struct gsn_assembly *a, size_t *ret_section);

/* gives: empty cells for all sections that are laid; NULL when none is. cell_um > 0; the cells are
 * wider where the specimen is large or its pixels are wider. Fails with GSN_E_NOMEM. */
int gsn_section_planes_new(const struct gsn_assembly *a, double cell_um,
                           struct gsn_section_planes **ret_planes, struct gsn_error *err);
void gsn_section_planes_free(struct gsn_section_planes *planes);
GSN_DEFINE_AUTO(gsn_section_planes);

/* Gathers the assembly's section i; nothing where it has no plane, or planes is NULL. density:
 * every apart-th row of its box, NaN where it is masked. Sections may be gathered side by side. */
void gsn_section_planes_add(struct gsn_section_planes *planes, const struct gsn_assembly *a,
                            size_t i, const struct gsn_plane *density, unsigned apart);

/* Gathers the assembly's section i, which is held, likewise; nothing where planes is NULL. px_um:
 * of its panel. One after the other. Fails with GSN_E_NOMEM. */
int gsn_section_planes_hold(struct gsn_section_planes *planes, size_t i,
                            const struct gsn_plane *density, unsigned apart, double px_um,
                            struct gsn_error *err);

/* Sums become means, once. What no section's box reached is glass, 0; what was masked is not known,
 * NaN. */
void gsn_section_planes_settle(struct gsn_section_planes *planes);

#ifdef __cplusplus
}
#endif
#endif
