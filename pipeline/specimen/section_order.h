/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The order of the sections, asked of their tissue: the densities of all placed sections side by
 * side in cells of the block frame, those of held sections beside them as they lie on their slides
 * (they may be second mounts of placed ones), and what the comparison finds. */
#ifndef GSN_SPECIMEN_SECTION_ORDER_H
#define GSN_SPECIMEN_SECTION_ORDER_H

#include "pipeline/register/order/sequence.h"
#include "pipeline/specimen/density_stack.h"

/* One held section in cells of half the planes' or of its pixels, along its box. */
struct gsn_held_section {
    size_t section; /* its place in the reconstruction */
    size_t columns, rows;
    double cell_um;
    float *density; /* owned; a mean, 0 where nothing was seen, NaN where it is masked */
};

struct gsn_section_planes {
    double cell_um;
    size_t count;            /* laid sections, one for each serial number, in their order */
    size_t *section;         /* owned; their places in the reconstruction */
    struct gsn_point origin; /* of the first cell's corner, um in the block */
    size_t columns, rows;
    float *density; /* owned; count * columns * rows: a sum, and after settling its mean */
    float *seen;    /* owned; as many: um2 of tissue or glass seen */
    size_t held_count;
    struct gsn_held_section *held; /* owned; room for all sections, in the order they came */
};

/* The places of the laid sections, the first of each serial number, in their order; returns how
 * many. ret_section: room for all sections. */
size_t gsn_section_planes_list(const struct gsn_poses *poses, size_t *ret_section);

/* gives: empty cells for all sections that are laid; NULL when none is. cell_um > 0; the cells are
 * wider where the specimen is large or its pixels are wider. Fails with GSN_E_NOMEM. */
int gsn_section_planes_new(const struct gsn_poses *poses, double cell_um,
                           struct gsn_section_planes **ret_planes, struct gsn_error *err);
void gsn_section_planes_free(struct gsn_section_planes *planes);
GSN_DEFINE_AUTO(gsn_section_planes);

/* Gathers the reconstruction's section i; nothing where it has no plane, or planes is NULL.
 * density: every apart-th row of its box, NaN where it is masked. Sections may be gathered side by
 * side. */
void gsn_section_planes_add(struct gsn_section_planes *planes, const struct gsn_poses *poses,
                            size_t i, const struct gsn_plane *density, unsigned apart);

/* Gathers the reconstruction's section i, which is held, likewise; nothing where planes is NULL.
 * px_um: of its panel. One after the other. Fails with GSN_E_NOMEM. */
int gsn_section_planes_hold(struct gsn_section_planes *planes, size_t i,
                            const struct gsn_plane *density, unsigned apart, double px_um,
                            struct gsn_error *err);

/* Sums become means, once. What no section's box reached is glass, 0; what was masked is not known,
 * NaN. */
void gsn_section_planes_settle(struct gsn_section_planes *planes);

/* Whether the laid sections lie in the order of their numbers (register/order/sequence.h).
 *
 * While the panels are opened, each section's density is gathered in cells of the block; at the end
 * all are compared, and the held ones with those around them, for one may be the second mount of
 * the other. What is found is flags and sentences: proposals for a person. */

/* Compares all that was gathered; flags the sections. Where the tissue goes on through the panels
 * in another order than the job states ("row" for a snake, panels that were turned by half, two
 * panels that have each other's numbers), densities->misordered says so, and single swaps are not
 * looked for: z is wrong, and no figure stands. gives: ret_sequence. Fails with GSN_E_NOMEM.
 */
int gsn_section_order_examine(struct gsn_section_planes *planes,
                              const struct gsn_protocol *protocol, const struct gsn_poses *poses,
                              struct gsn_densities *densities, struct gsn_sequence **ret_sequence,
                              struct gsn_error *err);

/* What a person is asked about one finding; sections are named PANEL.SLOT, with so many slots a
 * panel. */
void gsn_section_order_sentence(const struct gsn_sequence_finding *finding, unsigned slots,
                                char ret_sentence[GSN_POSE_SENTENCE]);

/* What the tissue could not have shown, in words; empty where it shows all that is looked for.
 * Returns whether there is anything to say. */
int gsn_section_order_blind_to_swaps(const struct gsn_sequence *sequence,
                                     char ret_sentence[GSN_POSE_SENTENCE]);
int gsn_section_order_blind_to_duplicates(const struct gsn_sequence *sequence,
                                          char ret_sentence[GSN_POSE_SENTENCE]);

#endif
