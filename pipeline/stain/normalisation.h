/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Stain normalisation: gain and offset that bring panels, and specimens, to one scale.
 *
 *     measured = gain * density + offset.
 *
 * A bath that dyes stronger multiplies the density; a dye whose colour turned a little lets some of
 * the yellow dye count as red, and yellow is weakest where red is strongest, so that adds a
 * constant as well. Three ways tell them: a reference tissue of stated density (one panel), tissue
 * that goes on across panels (one block), and control tissues that nobody treated (two specimens,
 * inter-batch calibration). */
#ifndef GSN_STAIN_NORMALISATION_H
#define GSN_STAIN_NORMALISATION_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* ---- by a reference tissue --------------------------------------------------------------- */

/* Rinsing decides how much acid fuchsin stays, so two panels of the same tissue differ by a factor
 * that is no loss. A tissue outside of the treated region, dentine or connective tissue, carries
 * the same factor: its density as measured over its density as stated is the gain that everything
 * on that panel is divided by. */

/* How strongly a panel was stained, told by a tissue whose collagen does not change.
 *
 * Rinsing decides how much acid fuchsin stays, so two panels of the same tissue differ by a factor
 * that is no loss. A tissue outside of the treated region, dentine or connective tissue, carries
 * the same factor: its density as measured over its density as stated is the gain that everything
 * on that panel is divided by. */

/* The reference tissue of one section. */
struct gsn_reference_section {
    double red; /* as gsn_reference_red() gives it */
    size_t pixels;
};

struct gsn_stain_gain {
    double gain;  /* what red is to be divided by; 1 where none was measured */
    double error; /* standard error of gain; 0 where none was measured */
    unsigned sections;
    size_t pixels;
};

/* The mean of the middle three fifths: holes, nuclei and strays at either end do not pull it, and
 * it grows in proportion to the stain. NaN when count is 0. Reorders the values; none may be NaN.
 */
double gsn_reference_red(double *values, size_t count);

/* stated: the reference tissue's density in the protocol, > 0. The error is what the sections
 * disagree by. Fails with GSN_E_STAIN when the tissue shows on fewer than three sections (of 50
 * pixels each), or is too pale to compare with. */
int gsn_stain_reference(const struct gsn_reference_section *sections, size_t count, double stated,
                        struct gsn_stain_gain *ret_gain, struct gsn_error *err);

/* The gain to take for a panel that shows too little of the reference, from the specimen's other
 * panels: their mean, with an error that holds what panels differ by. Gains without sections do not
 * take part. Fails with GSN_E_STAIN when fewer than two are left. */
int gsn_stain_gain_of_others(const struct gsn_stain_gain *gains, size_t count,
                             struct gsn_stain_gain *ret_gain, struct gsn_error *err);

/* ---- panels of one block ----------------------------------------------------------------- */

/* Tissue goes on across the boundary of two panels: the sections on its either side show the same
 * cells of tissue, and the straight line between what they measure is the step of the stain. Within
 * a panel the same comparison tells how much tissue, pose and focus change by themselves over as
 * many sections; their mean is taken off as the tissue's own drift, their scatter is the error. */

/* Panels of one block brought to one scale by tissue that the treatment did not reach.
 *
 * A bath that dyes stronger multiplies the density; a dye whose colour turned a little lets some of
 * the yellow dye count as red, and yellow is weakest where red is strongest, so that adds a
 * constant as well. What is measured on a panel is therefore
 *
 *     measured = gain * density + offset.
 *
 * Tissue goes on across the boundary of two panels: the sections on its either side show the same
 * cells of tissue, and the straight line between what they measure is the step of the stain. Within
 * a panel the same comparison tells how much tissue, pose and focus change by themselves over as
 * many sections; their mean is taken off as the tissue's own drift, their scatter is the error. */

/* after = slope * before + offset. */
struct gsn_gain_line {
    double slope, offset;
    double lag;   /* sections between the middles of the two sides */
    size_t cells; /* that it rests on */
};

/* The line through cells seen twice, both times with like noise (Deming's), robustly: cells off it
 * by more than four of their median deviation hardly count. lag of ret_line is not set.
 * Fails with GSN_E_STAIN when there are fewer than 100 cells or they are so alike that a line is
 * not told; GSN_E_NOMEM. No value may be NaN. */
int gsn_gain_line(const double *before, const double *after, size_t count,
                  struct gsn_gain_line *ret_line, struct gsn_error *err);

struct gsn_gain_offset {
    double gain, offset;
};

/* Panels of one block, at most. */
enum { GSN_GAIN_PANELS = 64 };

/* How well the panels could be levelled. */
struct gsn_gain_fit {
    double at[2];               /* the two densities between which tissue lies mostly */
    double drift[2];            /* what tissue itself changes by at those, per section */
    double covariance[3];       /* of one step at those: 00, 01, 11 */
    double drift_covariance[3]; /* of drift; what it is off by, all steps are off by */
    size_t steps;
    double lag[GSN_GAIN_PANELS];         /* of each step, sections */
    double kept;                         /* share of the steps that is more than error, 0..1 */
    double gain_scatter, offset_scatter; /* standard deviations from panel to panel */
};

/* The levels of panels that follow each other, from the steps between them (one less than panels)
 * and from lines within them (four at least). The mean of the levels is gain 1, offset 0: what all
 * panels share is not told by steps. Steps are shrunk by the share of them that their own error
 * explains (their sum of squares in units of the error is compared with that of mere error), so
 * panels that are even stay as they are.
 * Fails with GSN_E_STAIN when there are too few lines, GSN_GAIN_PANELS steps or a step turns the
 * order of densities round.
 */
int gsn_gain_chain(const struct gsn_gain_line *step, size_t steps,
                   const struct gsn_gain_line *within, size_t lines, const double at[2],
                   struct gsn_gain_offset *ret_level, struct gsn_gain_fit *ret_fit,
                   struct gsn_error *err);

/* Covariance of what the errors of the steps lift two sums over panels by: one weighs the panels by
 * a, the other by b, and they lie at these densities. Weights are fit->steps + 1 each; those of one
 * sum to 0, as all panels alike are nobody's step. */
double gsn_gain_covariance(const struct gsn_gain_fit *fit, const double *a, double density_a,
                           const double *b, double density_b);

/* Standard error of a mean density, at that density, over panels with these shares of the region
 * (they sum to 1), against the mean of all panels. */
double gsn_gain_error(const struct gsn_gain_fit *fit, const double *share, double density);

/* ---- two specimens: inter-batch calibration ---------------------------------------------- */

/* The densities of tissues that nobody treated, as the panels that bear the region of interest show
 * them. Only what a tissue's density is off by against the region's counts when two specimens are
 * compared by it. Panels are brought to one scale step by step, so a tissue on the region's own
 * panels is known well against it, and one that is seen some panels on only as well as the steps
 * between are; those errors are common to all tissues that are seen there. A tissue's sections
 * scatter, and tissue thins or thickens along a block by as much as nobody knows before. Each panel
 * counts as much as these errors leave of it. */

/* The densities of tissues that nobody treated, as the panels that bear the region of interest show
 * them.
 *
 * Only what a tissue's density is off by against the region's counts when two specimens are
 * compared by it. Panels are brought to one scale step by step (stain/normalisation.h), so a tissue
 * on the region's own panels is known well against it, and one that is seen some panels on only as
 * well as the steps between are; those errors are common to all tissues that are seen there. A
 * tissue's sections scatter, and tissue thins or thickens along a block by as much as nobody knows
 * before. Each panel counts as much as these errors leave of it (generalised least squares). */

enum { GSN_CONTROL_TISSUES = 3 };

/* What one panel says of a tissue. */
struct gsn_control_seen {
    size_t panel; /* place along the block among the levelled panels, 0-based */
    double z_um;  /* mean height of its sections */
    double value; /* median of their densities, levelled */
    size_t sections;
    double square; /* sum of the squares of what they are off their own mean by */
};

/* Where the tissues are to be compared: the region's shares of the panels (they sum to 1), and its
 * mean height in the block. */
struct gsn_control_frame {
    const struct gsn_gain_fit *fit;
    const double *share; /* borrowed; one per levelled panel */
    double at_um;
};

struct gsn_control_tissues {
    double value[GSN_CONTROL_TISSUES]; /* NaN: not seen */
    double covariance[GSN_CONTROL_TISSUES][GSN_CONTROL_TISSUES];
};

/* seen: of each tissue its panels (GSN_GAIN_PANELS at most), count: how many. */
void gsn_control_tissues_at(const struct gsn_control_frame *frame,
                            const struct gsn_control_seen *const seen[GSN_CONTROL_TISSUES],
                            const size_t count[GSN_CONTROL_TISSUES],
                            struct gsn_control_tissues *ret_tissues);

/* Standard error of one tissue's density. */
double gsn_control_tissue_error(const struct gsn_control_tissues *tissues, size_t tissue);

/* How one specimen's densities read in the stain of another: here = gain * there + offset. */
struct gsn_batch_calibration {
    double gain, offset;
    double covariance[3]; /* of gain and offset: 00, 01, 11 */
    size_t tissues;       /* that both show */
    double disagreement;  /* rms of what the tissues are off the line by, in their errors */
};

/* The link by tissues that both specimens have. What animals differ by in tissue that nobody
 * treated (taken as 2 % of its density) counts as error. The link leans towards "no difference", as
 * much as the tissues differ no more than by error and as spread allows: it says what standard
 * deviations of gain and offset the panels' own scatter makes likely between two specimens.
 * Fails with GSN_E_STAIN when they share fewer than two. */
int gsn_batch_calibrate(const struct gsn_control_tissues *here,
                        const struct gsn_control_tissues *there,
                        const struct gsn_gain_offset *spread,
                        struct gsn_batch_calibration *ret_link, struct gsn_error *err);

/* Standard error of gain * density + offset. */
double gsn_batch_calibration_error(const struct gsn_batch_calibration *link, double density);

#ifdef __cplusplus
}
#endif

#endif
