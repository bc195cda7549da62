/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A stacked block made coarse for looking at whole tissues, and sets of its voxels.
 * Private to pipeline/stain. */
#ifndef GSN_STAIN_TISSUE_BODY_H
#define GSN_STAIN_TISSUE_BODY_H

#include "pipeline/core/grid.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Density below which there is glass. */
#define GSN_BODY_GLASS 0.08

struct gsn_body {
    struct gsn_lattice at; /* about 32 um across */
    size_t count;
    float *value;   /* density, even from plane to plane, smoothed; 0 where there is no data */
    float *least;   /* the least value of a voxel and those beside, above and below it */
    uint8_t *set;   /* the work in hand: 0 and 1 between calls */
    uint32_t *list; /* room for every voxel */
};

/* Fails with GSN_E_NOMEM; gsn_body_done() is to be called in any case. */
int gsn_body_init(const struct gsn_grid *density, struct gsn_body *b, struct gsn_error *err);
void gsn_body_done(struct gsn_body *b);

/* The up to six neighbours of a voxel; returns how many. */
int gsn_body_beside(const struct gsn_body *b, size_t at, uint32_t ret_beside[6]);

/* The piece of the voxels whose set is 1 that holds start: they become 2 and are listed from
 * list[0] on. Returns how many. */
size_t gsn_body_flood(struct gsn_body *b, size_t start);

/* Takes away what is thinner than three voxels and leaves the largest piece. */
void gsn_body_tidy(struct gsn_body *b);

/* Of the red of bone: below it there is loose tissue, above it bone. */
#define GSN_BODY_LEAST_OF_BONE 0.35
#define GSN_BODY_MOST_OF_BONE 0.82

enum { GSN_BODY_ALONE = 192 };

/* A body that stands alone among what is denser than a level. */
struct gsn_body_alone {
    double above;
    size_t voxels;
    uint32_t voxel; /* one of them */
};

/* Bodies paler than bone that stand alone at some level, the largest first; those without voxels
 * are none. Uses the list. Fails with GSN_E_NOMEM. */
int gsn_body_list_alone(struct gsn_body *b, double bone,
                        struct gsn_body_alone ret_found[GSN_BODY_ALONE], struct gsn_error *err);

/* The set becomes the root, of which levels->bone is known; empty where there is none. Fails with
 * GSN_E_NOMEM. */
struct gsn_tissue_levels;
int gsn_body_find_root(struct gsn_body *b, struct gsn_tissue_levels *levels, struct gsn_error *err);

/* What is enclosed within one section becomes 1: the pulp opens at the end of the block. */
void gsn_body_fill_sections(struct gsn_body *b);

#ifdef __cplusplus
}
#endif
#endif
