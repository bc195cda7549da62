/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sections of a block without marks: an outline and structures that all share, grain that each has
 * for itself. Cells, whose middles are at +0.5. */
#ifndef GSN_TESTS_REGISTER_TISSUE_DRAWN_TISSUE_H
#define GSN_TESTS_REGISTER_TISSUE_DRAWN_TISSUE_H

#include "pipeline/core/geom.h"
#include "pipeline/register/tissue/pairwise.h"

enum { DRAWN_TISSUE_SIDE = 200 };

/* Turned by angle about the middle of the block, then shifted; first mirrored when asked. */
struct gsn_affine drawn_motion(double angle, int mirrored, double dx, double dy);

/* gives: section k of the block, whose point u lies at motion(u). block: another number, another
 * block. slant: how far its structures move in x from one section to the next. */
struct gsn_plane *drawn_tissue(unsigned block, unsigned k, const struct gsn_affine *motion,
                               double slant);
struct gsn_tissue *drawn_section(unsigned block, unsigned k, const struct gsn_affine *motion,
                                 double slant);

/* How far two motions are apart: root mean square over the tissue's disc. */
double drawn_apart(const struct gsn_affine *a, const struct gsn_affine *b);

#endif
