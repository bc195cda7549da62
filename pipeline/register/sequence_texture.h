/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What sections have finer than their anatomy, and how much of it two of them share: patch by
 * patch, each where it fits best, since every mount stretches and warps a section anew. */
#ifndef GSN_REGISTER_SEQUENCE_TEXTURE_H
#define GSN_REGISTER_SEQUENCE_TEXTURE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* With fewer patches than this their median says little. */
enum { GSN_SEQUENCE_LEAST_PATCHES = 9 };

struct gsn_sequence_texture {
    size_t n, columns, rows;
    float *value;  /* owned; n planes, 0 beside the tissue, and two of scratch */
    double *share; /* owned; what each patch compared last shares, and scratch */
};

/* gives: n planes without texture. Fails with GSN_E_NOMEM. */
int gsn_sequence_texture_new(size_t n, size_t columns, size_t rows,
                             struct gsn_sequence_texture **ret_texture, struct gsn_error *err);
void gsn_sequence_texture_free(struct gsn_sequence_texture *texture);
GSN_DEFINE_AUTO(gsn_sequence_texture);

/* Plane i from densities: 0 on glass, NaN where nothing is known. */
void gsn_sequence_texture_fill(struct gsn_sequence_texture *texture, size_t i,
                               const float *density);

/* Fills share with the largest correlation of each patch of plane i with those around its place in
 * plane j; every step-th patch is looked at. Returns how many have tissue over tissue. */
size_t gsn_sequence_texture_compare(struct gsn_sequence_texture *texture, size_t i, size_t j,
                                    size_t step);

/* Patches of a whole plane, with tissue or without. */
size_t gsn_sequence_texture_patches(const struct gsn_sequence_texture *texture);

/* One number for the shares of at least so many patches; NaN of fewer. Two mounts share `same`
 * at least, and this many standard deviations of what neighbours share more than they do. */
struct gsn_sequence_summary {
    double (*of)(double *share, size_t count);
    size_t least;
    double same, deviations;
};
double gsn_sequence_texture_shared(struct gsn_sequence_texture *texture, size_t i, size_t j,
                                   size_t step, const struct gsn_sequence_summary *summary);

/* Whether neighbours show enough to know two mounts of one section by. ret_usual: what they share,
 * in the median of the pairs; ret_least: what two mounts share more than. Fails with GSN_E_NOMEM.
 */
int gsn_sequence_texture_judge(struct gsn_sequence_texture *texture,
                               const struct gsn_sequence_summary *summary, int *ret_told,
                               double *ret_usual, double *ret_least, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
