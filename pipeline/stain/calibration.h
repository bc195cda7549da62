/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Dye vectors and the strength of a stain from a calibration panel: a glass that was stained in the
 * same batch as the sections and scanned by the same scanner, with patches that hold one dye each
 * and standards of a known collagen density.
 *
 * A patch of one dye lies on a line through the origin of optical density, however thick it is. Its
 * direction is the dye's vector: the line from which the patch's cells lie least away, square to it
 * (total least squares through the origin). Cells are means of many pixels, so that the noise of
 * the scan, which is not the same in all channels, has no say in the direction. */
#ifndef GSN_STAIN_CALIBRATION_H
#define GSN_STAIN_CALIBRATION_H

#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_patch_kind {
    GSN_PATCH_RED,
    GSN_PATCH_YELLOW,
    GSN_PATCH_DARK,
    GSN_PATCH_STANDARD, /* all dyes, as the protocol stains collagen of a known density */
};

enum { GSN_PATCH_SIDE = 6, GSN_PATCH_CELLS = GSN_PATCH_SIDE * GSN_PATCH_SIDE };

/* One patch, as stated and as seen. */
struct gsn_patch {
    enum gsn_patch_kind kind;
    double density;                /* of a standard, as stated; 1 is full */
    unsigned row, place;           /* 1-based, from the top and from the left */
    double od[GSN_PATCH_CELLS][3]; /* mean optical density of its inner cells */
    double floor_od[3];            /* standard error that all of its cells share: of the white, and
                                      of colours that the file rounds block by block */
};

/* The vectors of the dyes that have patches; the others stay where they are expected, as uncertain
 * as that says. The covariance holds what cells and patches of a dye scatter, and floor_od.
 *
 * expected: in the light of the scan. Fails with GSN_E_STAIN, with a sentence that names the patch:
 * no patch of red or of yellow; one too pale, uneven in hue, or so far from where its dye is
 * expected that it holds another or a mixture; two dyes that come out alike; two patches of one dye
 * that do not agree. */
int gsn_calibration_dyes(const struct gsn_patch *patches, size_t count,
                         const struct gsn_dyes_prior *expected, struct gsn_dyes_fit *ret_fit,
                         struct gsn_error *err);

/* By how much the standards read more than stated, with these dyes. ret_gain->sections: how many
 * standards. ret_zero (may be NULL): what those of density 0 read; NaN: there is none.
 * Fails with GSN_E_STAIN when no standard is above 0, or they lie on no line through the origin;
 * GSN_E_NOMEM. */
int gsn_calibration_gain(const struct gsn_patch *patches, size_t count, const struct gsn_dyes *dyes,
                         struct gsn_stain_gain *ret_gain, double *ret_zero, struct gsn_error *err);

/* What the vectors of a calibration panel and those inferred from a slide differ by. */
struct gsn_dyes_apart {
    double deg[3];      /* red, yellow, dark */
    double expected[3]; /* standard deviation of that, deg, of both together */
    int disagree[3];    /* further apart than chance brings one in a thousand */
};

/* inferred: by gsn_dyes_estimate(). */
struct gsn_dyes_apart gsn_dyes_compare(const struct gsn_dyes_fit *calibrated,
                                       const struct gsn_dyes_fit *inferred);

#ifdef __cplusplus
}
#endif
#endif
