/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The steps that gsn_folder_register() is made of; for its files alone. Inside, lengths are um: of
 * a pixel GSN_FOLDER_PX_UM wide where nobody states its size. */
#ifndef GSN_PIPELINE_FOLDER_PARTS_H
#define GSN_PIPELINE_FOLDER_PARTS_H

#include "pipeline/decode/apart.h"
#include "pipeline/folder.h"
#include "pipeline/register/fiducial/colour.h"

#ifdef __cplusplus
extern "C" {
#endif

/* One section while the stack is worked. */
struct gsn_folder_work {
    struct gsn_mark_spots *spots; /* NULL when the picture could not be read */
    struct gsn_mark marks[GSN_MARKS];
    int mirrored;
    struct gsn_pose pose;
    struct gsn_tissue *tissue; /* NULL when it is not asked for or shows nothing */
    double search_ms;
};

struct gsn_section_folder {
    const struct gsn_folder_options *options;
    struct gsn_folder_stack *stack;
    struct gsn_folder_work *work;
    double px_um; /* stated, or made up */
    double unit;  /* um per unit of the caller's lengths */
    double cell;  /* of the tissue's bands, pixels; 0 until the first picture is read */
};

/* folder_read.c */

double gsn_folder_cpu_ms(void);
/* The pictures of the folder dir, in the order of their names. Fails with GSN_E_NOTFOUND, GSN_E_IO,
 * GSN_E_INPUT, GSN_E_NOMEM. */
int gsn_folder_list(const char *dir, struct gsn_folder_stack *stack, struct gsn_error *err);
/* Reads one picture and looks for its spots, and at its tissue where that is asked for; a picture
 * that cannot be read costs itself alone. Fails with GSN_E_PROCESS, GSN_E_NOMEM. */
int gsn_folder_search(struct gsn_section_folder *folder, const char *dir, size_t i,
                      struct gsn_error *err);

/* The picture of section i. Fails as its decoder does. */
int gsn_folder_open(const struct gsn_section_folder *folder, const char *dir, size_t i,
                    struct gsn_picture **ret_picture, struct gsn_error *err);

/* folder_marks.c */

/* The caller guarantees that the marks are stated. */
void gsn_folder_stated_marks(const struct gsn_section_folder *folder,
                             struct gsn_point ret_mark_um[GSN_MARKS]);
/* Chooses the three marks of every section, and measures them. Fails with GSN_E_MARKERS,
 * GSN_E_NOMEM. */
int gsn_folder_choose_marks(struct gsn_section_folder *folder, struct gsn_error *err);

/* Where few sections show marks of the ordinary size: reads the pictures again and looks for other
 * kinds of burns (gsn_markers_burn()), and chooses among those. chosen: what
 * gsn_folder_choose_marks() said. Fails with GSN_E_MARKERS, GSN_E_PROCESS, GSN_E_NOMEM. */
int gsn_folder_choose_burns(struct gsn_section_folder *folder, const char *dir, int chosen,
                            struct gsn_error *err);

/* folder_poses.c */

/* The block is in um, pixel centres at +0.5; the answer in the caller's unit, at whole numbers. */
struct gsn_affine gsn_folder_frame_to_px(const struct gsn_section_folder *folder,
                                         const struct gsn_affine *to_block);
void gsn_folder_add_flag(struct gsn_folder_section *section, const char *word);
/* Lays the sections by their marks. Fails with GSN_E_MARKERS, GSN_E_NOMEM. */
int gsn_folder_solve(struct gsn_section_folder *folder, struct gsn_error *err);

/* folder_tissue.c: lays what the marks left. Fails with GSN_E_NOMEM. */
int gsn_folder_lay_by_tissue(struct gsn_section_folder *folder, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
