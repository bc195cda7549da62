/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The spots around one section of an opened panel that may be its marks. */
#ifndef GSN_SPECIMEN_FIDUCIAL_SEARCH_H
#define GSN_SPECIMEN_FIDUCIAL_SEARCH_H

#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/specimen/scan.h"
#include "pipeline/stain/optical_density.h"

/* The longer side of the typical section's box, px; 0 when there is none. scratch: one for each. */
double gsn_fiducial_search_side(const struct gsn_slot *slots, size_t count, double *scratch);

/* Sections of a panel, where their marks are looked for. */
struct gsn_fiducial_search {
    const struct gsn_scan *scan;
    const struct gsn_od_reader *absorber; /* of the scan's picture and glass */
    struct gsn_layout layout;
    double side; /* of the typical section's box, px */
    const struct gsn_slot *slots;
    size_t count;
    unsigned threads;
};

/* The spots around each of the sections, of the kind of burn that they have
 * (gsn_fiducials_choose_burn()). mark_um: the job's triangle, or NULL. ret_candidates has room for
 * all. Fails as gsn_fiducials_detect(). */
int gsn_fiducial_search_panel(const struct gsn_fiducial_search *search,
                              const struct gsn_point *mark_um,
                              struct gsn_fiducial_candidates *ret_candidates,
                              struct gsn_error *err);

/* One section. burn: of gsn_burns, where prior is NULL. absorber: of the scan's picture and
 * glass; side: of the typical section's box, px; prior: what the panel's sections have taught, or
 * NULL. Fails as gsn_fiducials_detect(). */
int gsn_fiducial_search_section(const struct gsn_scan *scan, const struct gsn_od_reader *absorber,
                                const struct gsn_layout *layout, double side,
                                const struct gsn_slot *slot, unsigned burn,
                                const struct gsn_triangle_prior *prior,
                                struct gsn_fiducial_candidates *ret_candidates,
                                struct gsn_error *err);

#endif
