/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Correspondence: which candidates of a section are its marks, and which is which. */
#ifndef GSN_REGISTER_FIDUCIAL_CORRESPONDENCE_H
#define GSN_REGISTER_FIDUCIAL_CORRESPONDENCE_H

#include "pipeline/register/fiducial/fiducial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Chooses and numbers the marks of one section: 1..3 as in the prior, allowing any rotation, a
 * mirrored section, and only the stated pixel size. Three blobs that look like the stack's marks
 * may lie on a triangle that a tear has pulled apart; the joint solution calls that gross. A triple
 * far from the section's tissue is a neighbour's and none. Any two of three may as well be the
 * marks of a section that lies otherwise and has lost the third: the picture learnt is weighed
 * against the odds that the third is a mark.
 *
 * Where no triple fits, but two candidates do and the tissue learnt says which is which, those two
 * are found, as are two whose distance a fold or a tear has changed where the tissue's picture says
 * so 20 to 1; the joint solution then says that they are not as far apart as they should be. Two
 * marks say nothing about mirroring, so ret_mirrored (may be NULL) tells what the tissue said: its
 * picture, or where there is none its centre. ret_score and ret_runner_up (each may be NULL) are
 * the likelihoods, 0..1, of the choice and of the best other choice or numbering; the choice is
 * refused, all three marks not found, when the second is more than half of the first. In a triangle
 * too nearly isosceles the numbering that leaves the section unmirrored wins, and the pose says so.
 */
void gsn_fiducials_match(const struct gsn_fiducial_candidates *section,
                         const struct gsn_triangle_prior *prior,
                         struct gsn_fiducial ret_marks[GSN_FIDUCIALS], int *ret_mirrored,
                         double *ret_score, double *ret_runner_up);

/* One way to call blobs of a section its marks. */
struct gsn_fiducial_hypothesis {
    struct gsn_fiducial mark[GSN_FIDUCIALS]; /* numbered as in the prior */
    int mirrored;
    double share; /* of the likelihood of all that are listed; they sum to 1 */
};

/* What gsn_fiducials_match() chose from, for a person to choose: the likeliest, the best first. Of
 * three blobs that are as well turned over, only the likelier is listed, since three marks tell
 * that by themselves or never. Returns how many there are. */
size_t gsn_fiducials_hypotheses(const struct gsn_fiducial_candidates *section,
                                const struct gsn_triangle_prior *prior,
                                struct gsn_fiducial_hypothesis ret_rivals[GSN_FIDUCIAL_HYPOTHESES]);

/* The marks of a section that something else than marks has laid, its tissue: panel_to_um lays
 * pixels on the frame of the prior, with this error per axis. A mark that is not found yet becomes
 * the blob that is one 20 to 1, by how far it is from the mark's place and by its looks, unless
 * another blob is half as likely or more. The caller guarantees that the prior is learnt. */
void gsn_fiducials_match_placed(const struct gsn_fiducial_candidates *section,
                                const struct gsn_triangle_prior *prior,
                                const struct gsn_affine *panel_to_um, double error_um,
                                struct gsn_fiducial marks[GSN_FIDUCIALS]);

/* How much likelier the section has three marks, anywhere, than none; without what the tissue says.
 */
double gsn_hypotheses_over_none(const struct gsn_fiducial_candidates *section,
                                const struct gsn_triangle_prior *prior);

#ifdef __cplusplus
}
#endif
#endif
