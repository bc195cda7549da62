/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One scanned picture, opened: decoded, its light understood, its glass measured, its colours
 * read as optical density. What a panel and a single tile have in common. */
#ifndef GSN_SPECIMEN_SCAN_H
#define GSN_SPECIMEN_SCAN_H

#include "pipeline/decode/apart.h"
#include "pipeline/specimen/protocol.h"
#include "pipeline/stain/artefact/dust.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/stain_vectors.h"

/* How bright the empty slide is, where too little of it shows to be measured as glass is: by the
 * palest parts of the picture. */
struct gsn_palest {
    struct gsn_flat_field glass;  /* even; its fraction is 0 */
    struct gsn_flat_field darker; /* the same by four times as much of the picture */
    double share;            /* of the picture that was taken */
    double clipped;          /* share of its samples at the highest code */
};

/* gives: the mean of each whole cell of side x side pixels, 16 bits a sample, codes as they are.
 * Fails with GSN_E_INPUT on a grey picture or one of less than one cell, GSN_E_NOMEM. */
int gsn_scan_cells(const struct gsn_image *image, uint32_t side, struct gsn_image **ret_cells,
                   struct gsn_error *err);

/* How a picture was set upright. Whatever is found on it lies on the upright picture, so whoever
 * opens it again must set it upright alike. */
struct gsn_orientation {
    struct gsn_dust_turn turn;
    char note[240]; /* what was assumed, for people; empty when nothing was */
};

struct gsn_scan {
    struct gsn_picture *picture; /* RGB */
    struct gsn_flat_field glass;
    struct gsn_plane *od[3]; /* of every apart-th pixel in both directions, for statistics;
                                NULL after gsn_scan_survey() */
    unsigned apart;          /* 1 for a tile */
    struct gsn_plane *total; /* R + G + B optical density in cells of step x step pixels, after
                                gsn_scan_survey(); else NULL */
    unsigned step;
    struct gsn_orientation upright;
    double px_um; /* the job's, else the file's; 0 only for a tile of which neither says it */
    enum gsn_light light;
    int light_assumed;        /* neither job nor file says what the samples mean */
    int by_palest;            /* a tile with too little glass: its palest parts stand for it */
    struct gsn_palest palest; /* then */
    char note[300];           /* what was assumed, "; " between; empty when nothing was */
};

/* gives. A panel is set upright, and that is noted: as it was when somebody looked at it before
 * (upright), and then no codes are read; or, where that is NULL, as the codes printed on it and its
 * sections tell (orientation.h). Samples are read as the job says, else as the file says, else as
 * the built-in dye vectors were measured (codes in proportion to light), and that is noted; those
 * of a tile as sRGB, which is what pictures are kept in that say nothing.
 *
 * decoder: as for gsn_decode_apart(). Fails as gsn_decode_apart() and gsn_flat_field_estimate() do;
 * with GSN_E_WITHHELD when it is to be told which way round it lies and that is not clear; with
 * GSN_E_INPUT when neither job nor file states the pixel size of a panel, or it is grey; with
 * GSN_E_STAIN when whoever took the picture says in it that its colours must not be measured.
 * borrows: picture_fd, protocol, upright. */
int gsn_scan_open(struct gsn_decoder *decoder, int picture_fd, const struct gsn_protocol *protocol,
                  const struct gsn_orientation *upright, struct gsn_scan **ret_scan,
                  struct gsn_error *err);
/* The same for one look at a panel: the glass is measured on the picture made small, which costs a
 * fiftieth, and optical density is there in cells only. Fails as gsn_scan_open(). */
int gsn_scan_survey(struct gsn_decoder *decoder, int picture_fd,
                    const struct gsn_protocol *protocol, const struct gsn_orientation *upright,
                    struct gsn_scan **ret_scan, struct gsn_error *err);
void gsn_scan_free(struct gsn_scan *scan);
GSN_DEFINE_AUTO(gsn_scan);

/* The dye vectors to unmix this scan with: the built-in ones, taken as exact, or those of the slide
 * itself where the job asks for it or, where it states nothing, the built-in ones were measured in
 * another light. Those of a tile are the built-in ones as well as they are known, unless asked;
 * it may be of a stain that is like this one (picrosirius), which the fit's apart_deg tells.
 * tissue: of the size of the thinned densities, 0 leaves a pixel out of what the slide is asked;
 * NULL takes all that is stained.
 * Fails as gsn_stain_fits(), gsn_stain_look() and gsn_dyes_estimate() do: a slide of another stain
 * is refused whichever vectors are asked for. */
int gsn_scan_dyes(const struct gsn_scan *scan, const struct gsn_image *tissue,
                  const struct gsn_protocol *protocol, struct gsn_dyes_fit *ret_fit,
                  struct gsn_error *err);

#endif
