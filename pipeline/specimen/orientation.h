/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which way round a panel lies on its picture, and setting it upright.
 *
 * The code on its label is printed upright, so it tells a picture that the scanner mirrored and a
 * panel that was fed the wrong way round. A code that lies on its side may be how a label is made:
 * whether the whole panel lies on its side is asked of the grid of its sections, rows by columns as
 * the job states it. Where no code is read and the grid lies on its side, the marks' triangle that
 * the job states tells which way, by the majority of the sections. A panel of which that is not
 * clear is refused. Whether it then lies as the marks say is asked where they are found
 * (panel_analysis.c). */
#ifndef GSN_SPECIMEN_ORIENTATION_H
#define GSN_SPECIMEN_ORIENTATION_H

#include "pipeline/specimen/scan.h"
#include "pipeline/stain/artefact/dust.h"

/* Whether the picture must be looked at to tell which way round it lies: its code lies on its side,
 * or it is upright where the layout is wide, or wide where that is upright. */
int gsn_orientation_asks(const struct gsn_picture *picture, const struct gsn_protocol *protocol);

/* What the code alone says; nothing to turn where there is none. */
struct gsn_dust_turn gsn_orientation_by_code(const struct gsn_picture *picture);

/* Whether a code was read that says which way round it lies. */
int gsn_orientation_is_coded(const struct gsn_picture *picture);

/* The one turn that is one and then another. */
struct gsn_dust_turn gsn_orientation_compose(struct gsn_dust_turn first, struct gsn_dust_turn then);

/* What code, grid and marks say together. scan: as surveyed, not turned. ret_why: by what it was
 * told, in words, static; untouched where the code alone tells. Fails with GSN_E_WITHHELD when
 * they leave it open or contradict each other; GSN_E_NOMEM. */
int gsn_orientation_find(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                         struct gsn_dust_turn *ret_turn, const char **ret_why,
                         struct gsn_error *err);

/* Turns the picture; its samples stay where they are in memory. Fails with GSN_E_NOMEM, and then
 * the picture is as before. */
int gsn_orientation_turn(struct gsn_picture *picture, struct gsn_dust_turn turn,
                         struct gsn_error *err);

#endif
