/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the evidence of a comparison of two sections' tissue (tissue.h) is worth. Private to the
 * tissue files. */
#ifndef GSN_REGISTER_TISSUE_EVIDENCE_H
#define GSN_REGISTER_TISSUE_EVIDENCE_H

/* Evidence below this is chance: the best of all motions that were tried. */
#define GSN_TISSUE_LEAST_EVIDENCE 24

/* How many times the evidence of the best other motion makes one sure. An outline alone, which fits
 * in many ways, gives all of them about the same. Right motions have 1.6 times that of the best
 * other and more; two sections of other blocks with like outlines reach 1.5 in one case of forty.
 */
#define GSN_TISSUE_SURE 1.5

#endif
