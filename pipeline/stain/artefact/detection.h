/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What on a panel must not be measured, and why.
 *
 * A fold shows twice the dye, a tear none, a bubble bends the light, ink is not collagen. Each is
 * looked for by what it does to the optical densities and to the amounts of the three dyes; where
 * it lies, the density is no number, and the report says the reason and the area. What is masked in
 * vain is tissue lost, so a detector stays silent where it cannot tell. Areas are micrometres
 * squared, boxes and discs are pixels of the upright picture, x right and y down. */
#ifndef GSN_STAIN_ARTEFACT_DETECTION_H
#define GSN_STAIN_ARTEFACT_DETECTION_H

#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Bits of a label. */
enum gsn_defect {
    GSN_DEFECT_HALO = 1 << 0,   /* beside a laser mark: heat changes the stain */
    GSN_DEFECT_FOLD = 1 << 1,   /* tissue lies double: both dyes twice along a line */
    GSN_DEFECT_VOID = 1 << 2,   /* tear or hole: glass inside the outline of the tissue */
    GSN_DEFECT_BUBBLE = 1 << 3, /* air under the coverslip: a dark ring and what is in it */
    GSN_DEFECT_BLUR = 1 << 4,   /* out of focus */
    GSN_DEFECT_INK = 1 << 5,    /* a colour that no mixture of the dyes makes, or black, broad */
    GSN_DEFECT_EDGE = 1 << 6,   /* coverslip or frame: a long thin straight dark line */
    GSN_DEFECT_HAIR = 1 << 7,   /* hair or fibre: a thin dark line */
    GSN_DEFECT_DEBRIS = 1 << 8, /* dust, enamel, metal, pigment: a dark neutral grain */
    GSN_DEFECT_DUST = 1 << 9,   /* of the scanner: at the same place on every panel (dust.h) */
};

enum { GSN_DEFECTS = 10 };

/* "halo", "fold", "void", ... of bit 1 << i. */
const char *gsn_defect_word(unsigned i);

/* What it is and what may be done about it, as a clause: "the tissue lies double". */
const char *gsn_defect_reason(unsigned i);

struct gsn_artefact_disc {
    struct {
        double x, y;
    } px;
    double radius_px;
};

struct gsn_artefact_section {
    int x, y, width, height; /* box of the section */
    size_t halo_count;
    struct gsn_artefact_disc halo[4]; /* around its laser marks, masked as they are */
};

struct gsn_artefact_panel {
    const struct gsn_image *image; /* RGB */
    struct gsn_plane *const *od;   /* R, G, B of the panel or of a sample of its pixels, from which
                                      is told what is tissue and what is glass */
    const struct gsn_flat_field *glass;
    const struct gsn_dyes *dyes;
    double px_um;
    size_t section_count;
    const struct gsn_artefact_section *section;
    const struct gsn_dyes *own; /* the dyes as the panel's own tissue shows them: where its sections
                                   have a colour in common that they explain, it is no ink; NULL
                                   where that is not known */
};

/* What was masked within the outline of one section; areas of several reasons overlap. */
struct gsn_artefact_figures {
    double outline_um2; /* tissue with its holes filled; 0: no tissue */
    double masked_um2;  /* for any reason */
    double area_um2[GSN_DEFECTS];
    double sharpness; /* of the section, see blur.c; NaN where it shows no texture */
    double clipped;   /* share of the tissue's pixels with a sample at either end of its codes */
};

/* The labels of a panel's sections, in cells; halos are round to the pixel. */
struct gsn_artefact_labels;

void gsn_artefact_labels_free(struct gsn_artefact_labels *labels);

GSN_DEFINE_AUTO(gsn_artefact_labels);

/* Bits of enum gsn_defect of a panel pixel, as the section-th of the panel's sections has it; 0
 * beyond its box. */
unsigned gsn_artefact_label(const struct gsn_artefact_labels *labels, size_t section, int x, int y);

/* gives: the labels, and one record per section; borrows: all of panel. Does not depend on threads.
 * Fails with GSN_E_INPUT when a box lies outside the panel or px_um is not positive, as
 * gsn_unmix(), and with GSN_E_NOMEM. */
int gsn_artefact_find(const struct gsn_artefact_panel *panel, unsigned threads,
                      struct gsn_artefact_labels **ret_labels,
                      struct gsn_artefact_figures *ret_figures, struct gsn_error *err);

/* Density is no number any more where the section has a label. (x0, y0): the panel pixel that the
 * first of the plane is. */
void gsn_artefact_apply(const struct gsn_artefact_labels *labels, size_t section, int x0, int y0,
                        struct gsn_plane *density);

#ifdef __cplusplus
}
#endif

#endif
