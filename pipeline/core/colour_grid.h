/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A true-colour volume in the block frame: what the eye sees of the stack, beside its density.
 *
 * Three sRGB codes of 8 bits a voxel (IEC 61966-2-1), x fastest, of light that was averaged as
 * light. 0 0 0 means "no data"; black tissue is 1 1 1. */
#ifndef GSN_CORE_COLOUR_GRID_H
#define GSN_CORE_COLOUR_GRID_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_colour_grid {
    struct gsn_lattice at;
    uint8_t *rgb;
};

/* gives: no data anywhere. Fails with GSN_E_NOMEM, also when nx * ny * nz overflows. */
int gsn_colour_grid_new(const struct gsn_lattice *at, struct gsn_colour_grid **ret_grid,
                        struct gsn_error *err);
void gsn_colour_grid_free(struct gsn_colour_grid *grid);
GSN_DEFINE_AUTO(gsn_colour_grid);

/* gives: the volume as the bytes of an NRRD file (raw, axis 0 is the colour), which ITK,
 * VTK and Slicer read. Fails with GSN_E_NOMEM. */
int gsn_colour_grid_nrrd(const struct gsn_colour_grid *grid, uint8_t **ret_bytes, size_t *ret_size,
                         struct gsn_error *err);

/* The way back: of files that gsn_colour_grid_nrrd() wrote, and no other. gives. Fails with
 * GSN_E_INPUT, GSN_E_NOMEM. */
int gsn_colour_grid_read(const uint8_t *bytes, size_t size, struct gsn_colour_grid **ret_grid,
                         struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
