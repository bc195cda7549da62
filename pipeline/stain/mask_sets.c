/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/mask_cells.h"

#include "pipeline/imaging/components.h"
#include "pipeline/imaging/morphology.h"

void gsn_mask_cells_mark(struct gsn_mask_cells *cells, const uint8_t *set, enum gsn_defect defect)
{
    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++)
        if (set[i])
            cells->label[i] = (uint16_t)(cells->label[i] | defect);
}

int gsn_mask_cells_grow(const struct gsn_mask_cells *cells, const uint8_t *sure, uint8_t *weak,
                        double um, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_components) pieces = NULL;
    gsn_auto_mem(uint8_t) reach = gsn_memdup(sure, count);
    int r;

    if (!reach)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_dilate(reach, cells->nx, cells->ny, um / cells->um, err);
    for (size_t i = 0; i < count; i++)
        weak[i] = sure[i] || (weak[i] && reach[i]);
    if (r >= 0)
        r = gsn_components_find(weak, cells->nx, cells->ny, &pieces, err);
    for (size_t p = 0; r >= 0 && p < pieces->count; p++) {
        const uint32_t *cell = pieces->pixel + pieces->component[p].first;
        int held = 0;

        for (size_t i = 0; i < pieces->component[p].area; i++)
            held |= sure[cell[i]];
        for (size_t i = 0; i < pieces->component[p].area; i++)
            weak[cell[i]] = (uint8_t)held;
    }
    return r;
}

int gsn_mask_cells_broad(const struct gsn_mask_cells *cells, uint8_t *set, double half_um,
                         struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) core = gsn_memdup(set, (size_t)cells->nx * cells->ny);
    int r;

    if (!core)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_erode(core, cells->nx, cells->ny, half_um / cells->um, err);
    return r < 0 ? r : gsn_mask_cells_grow(cells, core, set, 3 * half_um, err);
}
