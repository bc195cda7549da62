/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The three laser marks of a section.
 *
 * Char absorbs red light and the dyes hardly do, so marks are looked for in the optical density
 * (log10) of the red channel: dark round spots, each then measured by the fit of a blurred disc
 * with a pale ring (mark_fit.h). Which spots are the marks, and which is which, is told by the side
 * lengths of the triangle, which turning and mirroring leave alone. Positions are in panel pixels
 * with centres at +0.5, triangles in micrometres.
 *
 * The order of work over a stack: gsn_markers_candidates() for each section; where the protocol
 * gives no triangle, gsn_markers_consensus() over all of them; gsn_markers_learn() over all of
 * them; gsn_markers_choose() for each; gsn_markers_seek() and another choice where marks are
 * missing. */
#ifndef GSN_REGISTER_MARKERS_H
#define GSN_REGISTER_MARKERS_H

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"
#include "pipeline/register/panel.h"

#ifdef __cplusplus
extern "C" {
#endif

enum {
    GSN_MARKS = 3,
    GSN_MARK_CANDIDATES = 96,
    GSN_MARK_MAP = 40,
    GSN_MARK_RIVALS = 4,
    GSN_MARK_CHANCE = 8,
    GSN_MARK_BURNS = 6
};

/* What a laser leaves. All marks of a block are alike, so a stack is searched for one kind. */
struct gsn_mark_burn {
    double scale; /* 1: radii of 40 to 150 um are looked for; otherwise so many times that */
    int holes;    /* burnt through: light in a dark rim. Dark discs are found as well. */
};

/* From 14 to 450 um, the ordinary kind first. */
extern const struct gsn_mark_burn gsn_mark_burns[GSN_MARK_BURNS];
/* Discs of 20 to 300 um radius are found where that is so many pixels or more, holes where it is
 * twice as many; smaller ones may be missed. */
#define GSN_MARK_LEAST_UM 20.0
#define GSN_MARK_LEAST_PX 2.0

struct gsn_mark {
    struct gsn_point px;
    double radius_px;
    double contrast;               /* optical density of the disc above the tissue around it */
    double cov_xx, cov_xy, cov_yy; /* of px, in px^2, from the fit's residuals */
    double score; /* 0..1: the share of the picture's variance around it that the fit explains */
    int found;    /* 0: no acceptable mark, everything else is 0 */
};

/* Optical density from afar: GSN_MARK_MAP by GSN_MARK_MAP square cells, NaN where there is none. In
 * pixels of the section, or in um where it is what sections have in common. */
struct gsn_mark_map {
    double cell;             /* side of a cell; 0: no picture */
    struct gsn_point origin; /* corner of the first cell */
    float value[GSN_MARK_MAP * GSN_MARK_MAP];
};

/* Every spot of one section that may be a mark, the likeliest first. */
struct gsn_mark_candidates {
    double px_um;
    unsigned burn;              /* what was looked for, of gsn_mark_burns */
    struct gsn_point tissue_px; /* centre of the section's tissue */
    struct gsn_mark_map map;
    size_t count;
    struct gsn_mark mark[GSN_MARK_CANDIDATES];
};

/* What is known of the triangle before looking at a section. */
struct gsn_triangle_prior {
    struct gsn_point mark_um[GSN_MARKS]; /* marks 1..3, in the block frame when the protocol gives
                                            them, otherwise in a frame of the triangle's own */
    /* Learnt from the stack; all 0 as long as nothing is known. */
    int learnt;
    unsigned burn;              /* of gsn_mark_burns: 0, or what the sections were searched for */
    struct gsn_point tissue_um; /* centre of the tissue, same frame */
    double tissue_sd_um;        /* its scatter per axis from section to section */
    double contrast, radius_um; /* of the typical mark */
    struct gsn_mark_map tissue; /* what the sections have in common */
    double stretch_um;          /* how far an ordinary section's marks lie from a rigid triangle */
    /* By classes of unlikeness (mark_odds.h); 0: nothing is known of them. */
    double alike[GSN_MARK_CHANCE];  /* share of the marks that are at least as unlike */
    double chance[GSN_MARK_CHANCE]; /* spots per um^2 that are no marks and at most as unlike */
    double area_um2;                /* in which those were counted, of one section */
    double marked;                  /* share of the sections that have marks at all; 0: not known */
};

/* Optical density of the red channel, of width x height pixels, where it is asked for: row() puts
 * every apart-th pixel of row y from x on, count of them, to where it is told. NaN: masked. */
struct gsn_mark_density {
    uint32_t width, height;
    const void *context;
    void (*row)(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                float *to);
};

/* borrows: red_od. Spots are told from some of the slot's pixels. Finding nothing is no error.
 * Fails with GSN_E_INPUT when px_um is not positive, too coarse for a mark of 100 um, or the slot
 * is empty or reaches outside the panel; GSN_E_NOMEM. */
int gsn_markers_candidates(const struct gsn_mark_density *red_od, const struct gsn_slot *slot,
                           double px_um, struct gsn_mark_candidates *ret_candidates,
                           struct gsn_error *err);

/* The same for another kind of burn than the ordinary, of gsn_mark_burns. */
int gsn_markers_candidates_of(const struct gsn_mark_density *red_od, const struct gsn_slot *slot,
                              double px_um, unsigned burn,
                              struct gsn_mark_candidates *ret_candidates, struct gsn_error *err);

/* The same, once it is learnt what marks look like: spots like that are measured, where without it
 * the darkest are, and ink has more of those than there is room for. Before anything is learnt it
 * does the same as gsn_markers_candidates(), and it fails as that does. */
int gsn_markers_seek(const struct gsn_mark_density *red_od, const struct gsn_slot *slot,
                     double px_um, const struct gsn_triangle_prior *prior,
                     struct gsn_mark_candidates *ret_candidates, struct gsn_error *err);

/* The triangle that most sections share, where the protocol gives none.
 *
 * Mark 1 lies between the shortest side (to mark 2) and the longest (to mark 3); the majority of
 * sections is taken as the right way up. Nothing is learnt yet. Fails with GSN_E_MARKERS when fewer
 * than 3 sections, or fewer than half of those with three candidates, agree, or so many as spots
 * that are no marks would by chance. */
int gsn_markers_consensus(const struct gsn_mark_candidates *sections, size_t count,
                          struct gsn_triangle_prior *ret_prior, struct gsn_error *err);

/* Fills the learnt half of prior from the sections whose three marks are clear; leaves it as it is
 * when fewer than 3 are. Fails with GSN_E_NOMEM. */
int gsn_markers_learn(const struct gsn_mark_candidates *sections, size_t count,
                      struct gsn_triangle_prior *prior, struct gsn_error *err);

/* Which kind of burn the stack has, of gsn_mark_burns. sections: those of the whole stack searched
 * for each kind, count of each, the ordinary kind first. mark_um: the triangle, or NULL where
 * nobody states it. The kind with which most sections show three marks, at least half of all and
 * more than the ordinary kind shows; among those within a tenth of the most, the one whose marks
 * lie most nearly as the triangle does. 0 where no other kind does better than the ordinary. Fails
 * with GSN_E_NOMEM. */
int gsn_markers_burn(const struct gsn_mark_candidates *sections, size_t count,
                     const struct gsn_point *mark_um, unsigned *ret_burn, struct gsn_error *err);

/* Whether that is worth asking: fewer than two in three sections show three marks of the ordinary
 * kind, or those that do are nearly too small or too large for it. Fails with GSN_E_NOMEM. */
int gsn_markers_are_odd(const struct gsn_mark_candidates *sections, size_t count,
                        const struct gsn_point *mark_um, int *ret_odd, struct gsn_error *err);

/* Chooses and numbers the marks of one section: 1..3 as in the prior, allowing any rotation, a
 * mirrored section, and only the stated pixel size. Three spots that look like the stack's marks
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
void gsn_markers_choose(const struct gsn_mark_candidates *section,
                        const struct gsn_triangle_prior *prior,
                        struct gsn_mark ret_marks[GSN_MARKS], int *ret_mirrored, double *ret_score,
                        double *ret_runner_up);

/* One way to call spots of a section its marks. */
struct gsn_mark_rival {
    struct gsn_mark mark[GSN_MARKS]; /* numbered as in the prior */
    int mirrored;
    double share; /* of the likelihood of all that are listed; they sum to 1 */
};

/* What gsn_markers_choose() chose from, for a person to choose: the likeliest, the best first. Of
 * three spots that are as well turned over, only the likelier is listed, since three marks tell
 * that by themselves or never. Returns how many there are. */
size_t gsn_markers_rivals(const struct gsn_mark_candidates *section,
                          const struct gsn_triangle_prior *prior,
                          struct gsn_mark_rival ret_rivals[GSN_MARK_RIVALS]);

/* The marks of a section that something else than marks has laid, its tissue: panel_to_um lays
 * pixels on the frame of the prior, with this error per axis. A mark that is not found yet becomes
 * the spot that is one 20 to 1, by how far it is from the mark's place and by its looks, unless
 * another spot is half as likely or more. The caller guarantees that the prior is learnt. */
void gsn_markers_place(const struct gsn_mark_candidates *section,
                       const struct gsn_triangle_prior *prior, const struct gsn_affine *panel_to_um,
                       double error_um, struct gsn_mark marks[GSN_MARKS]);

#ifdef __cplusplus
}
#endif
#endif
