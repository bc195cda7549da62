/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The steps that gsn_assembly_make() takes, in their order: the frame (assembly_frame.c), the poses
 * (assembly_poses.c, assembly_refine.c), the density panel by panel (assembly_density.c), the dyes
 * of calibration panels (assembly_calibration.c), what the stain leaves open (assembly_stain.c),
 * the panels brought to one scale (assembly_level.c). Private to these files. Fail as
 * gsn_assembly_make() does. */
#ifndef GSN_PIPELINE_ASSEMBLY_PARTS_H
#define GSN_PIPELINE_ASSEMBLY_PARTS_H

#include "pipeline/assembly.h"

/* um in the block. */
struct gsn_box {
    struct gsn_vec3 low, high;
};

/* One word more. */
void gsn_assembly_flag(struct gsn_assembly_section *section, const char *word);

/* The panel of this number that has sections; NULL when there is none. Borrowed. */
const struct gsn_specimen_panel *gsn_assembly_panel(const struct gsn_specimen *specimen,
                                                    unsigned number);

/* The side of the stack's voxels, um: as the job states it, but never finer than the finest panel's
 * pixel; 0 where no panel has sections. */
double gsn_assembly_voxel(const struct gsn_specimen *specimen);
struct gsn_box gsn_assembly_box_of_shape(const struct gsn_region *region);

/* Voxels of the scan's own pixel size, on the mask's raster where that has the same step; mask may
 * be NULL. z planes are the sections' own: all that the box needs, also those that the block has
 * not, so that they count as not seen; and one more on either side where the block has one. 0 when
 * that makes no lattice that could be worked with. */
int gsn_assembly_lattice(struct gsn_box box, const struct gsn_mask *mask, double px_um,
                         double interval_um, unsigned sections, struct gsn_lattice *lattice);
/* gives: every voxel NaN. */
int gsn_assembly_empty_grid(const struct gsn_lattice *lattice, struct gsn_grid **ret_grid,
                            struct gsn_error *err);

/* The stated mask or shape, and the lattice around it. */
int gsn_assembly_place_region(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                              struct gsn_assembly *a, struct gsn_lattice *lattice,
                              struct gsn_error *err);
/* The lattice of all posed sections, in which a band will be looked for. */
int gsn_assembly_place_block(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                             const struct gsn_assembly *a, struct gsn_lattice *lattice,
                             struct gsn_error *err);
/* Finds the band. Not finding it is a state, with a sentence. */
int gsn_assembly_find_band(const struct gsn_specimen *specimen,
                           const struct gsn_specimen_options *options, struct gsn_assembly *a,
                           struct gsn_error *err);

/* Poses of all sections together by their marks, where the job asks for marks. A stack that cannot
 * be solved is a state, with a sentence. */
int gsn_assembly_solve(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                       struct gsn_error *err);

/* gives: points of the region, thinned evenly: where the predicted error matters. None without a
 * region. */
int gsn_assembly_targets(const struct gsn_mask *region, struct gsn_point **ret_points,
                         size_t *ret_count, struct gsn_error *err);

/* assembly_refine.c: where the job asks for it, opens every panel and moves the sections on by what
 * their tissue has in common with their neighbours'. That it cannot be done is a state, with a
 * sentence. */
int gsn_assembly_refine(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options, struct gsn_assembly *a,
                        struct gsn_error *err);

/* Lays the candidates of every section that has some in the solved stack; sections whose three
 * marks contradict it get theirs. */
void gsn_assembly_list_candidates(const struct gsn_specimen *specimen,
                                  const struct gsn_pose_options *options, struct gsn_assembly *a);
/* Gives a section with three marks the ways to lay it on two of them, and that on all. */
void gsn_assembly_offer_marks(const struct gsn_specimen *specimen,
                              const struct gsn_pose_options *options, const struct gsn_assembly *a,
                              struct gsn_assembly_section *section);

/* assembly_marks.c: on an opened panel, the marks of the sections that their tissue has laid: spots
 * that lie where it puts a mark and look like the panel's others. The pose stays the tissue's. */
int gsn_assembly_seek_marks(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                            unsigned panel, struct gsn_assembly *a, struct gsn_error *err);

/* The colour volume on the grid's lattice. */
int gsn_assembly_place_colour(struct gsn_assembly *a, struct gsn_error *err);
/* Cuts it down to what is left of the grid. */
int gsn_assembly_crop_colour(struct gsn_assembly *a, struct gsn_error *err);
/* What the samples of an opened panel mean as light. */
struct gsn_assembly_light {
    uint16_t *of_sample; /* owned, as is the next: resample_colour.h */
    uint8_t *code;
};
/* gives: the tables. Fails with GSN_E_NOMEM. */
int gsn_assembly_light(enum gsn_light light, unsigned bits, struct gsn_assembly_light *ret_light,
                       struct gsn_error *err);
void gsn_assembly_light_done(struct gsn_assembly_light *light);

/* assembly_calibration.c: room for the stated calibration panels, and whether the densities will be
 * on their standards' scale. */
int gsn_assembly_place_calibrations(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                                    struct gsn_error *err);
/* The dye vectors of an opened panel: its calibration panel's, where one is stated. */
int gsn_assembly_find_dyes(const struct gsn_specimen *specimen,
                           const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                           struct gsn_assembly *a, struct gsn_assembly_panel *panel,
                           struct gsn_error *err);

/* Opens every panel and lays its density into the grids that there are. */
int gsn_assembly_work_panels(const struct gsn_specimen *specimen,
                             const struct gsn_specimen_options *options, struct gsn_assembly *a,
                             struct gsn_error *err);

/* The reference tissue, where one is stated. */
int gsn_assembly_place_reference(const struct gsn_specimen *specimen, double px_um,
                                 unsigned sections, struct gsn_assembly *a, struct gsn_error *err);
/* The panel that the section with this serial number was taken from, and the serial number of a
 * plane; NULL when there is none. Borrowed. */
struct gsn_assembly_panel *gsn_assembly_panel_of_serial(struct gsn_assembly *a, double serial);
double gsn_assembly_serial_of_plane(const struct gsn_lattice *at, size_t z, double interval_um);

/* Where no reference tissue is stated: the cells of the whole block. */
int gsn_assembly_place_columns(const struct gsn_specimen *specimen, unsigned sections,
                               struct gsn_assembly *a, struct gsn_error *err);
/* Brings the panels to their common scale. That it cannot be done is a state, with a sentence. */
int gsn_assembly_level(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                       struct gsn_error *err);
/* Finds tissue that other specimens have too, off the region. Comes when the region and its shares
 * of the panels are known. */
int gsn_assembly_find_tissues(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                              struct gsn_error *err);

/* assembly_cloud.c: the colours of all tissue, panel by panel, and the region's mean colour. Comes
 * when the panels are on one scale. */
int gsn_assembly_count_colours(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                               struct gsn_error *err);

/* Divides each plane by the gain that the reference tissue, or else the standards, tell of its
 * panel. */
int gsn_assembly_normalise(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                           struct gsn_error *err);
/* The standard error of a mean density by the stain, and what unequal panels add to it; and the
 * region's shares of the levelled panels. */
void gsn_assembly_sum_errors(const struct gsn_specimen *specimen, struct gsn_assembly *a);

#endif
