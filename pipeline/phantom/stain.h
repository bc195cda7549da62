/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From what the tissue holds to what the scanner sees.
 *
 * Optical density is log10, per channel R, G, B, in the space of the file's code values: the dyes
 * are defined there, so a reader that undoes a transfer curve first would see other dyes. */
#ifndef GSN_PHANTOM_STAIN_H
#define GSN_PHANTOM_STAIN_H

#include "pipeline/phantom/geometry.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_phantom_dye {
    GSN_PHANTOM_RED,
    GSN_PHANTOM_YELLOW,
    GSN_PHANTOM_NUCLEAR,
    GSN_PHANTOM_MARK,
    GSN_PHANTOM_DYES
};

enum { GSN_PHANTOM_NUCLEI_FULL = 6 }; /* a pixel with so many nuclei is all nucleus */

struct gsn_phantom_stain {
    double red_gain, yellow_gain; /* k_r, k_y */
    double ramp;                  /* relative change of red over half a section */
    double depth;                 /* A of the lesion */
    const double (*dye)[3];       /* by dye, R, G, B; NULL for those of the specification */
};

/* What varies from pixel to pixel beside the field. */
struct gsn_phantom_local {
    double red_texture, yellow_texture; /* T1, T2: mean 0, deviation 1; 0 for none */
    double ramp_place;                  /* l */
    int nuclei;                         /* drawn with mean gsn_phantom_nuclei_mean() */
};

/* The unit vector of a dye, R, G, B. */
void gsn_phantom_dye_vector(enum gsn_phantom_dye dye, double ret_vector[3]);

/* I0, the code values of blank glass. */
extern const double gsn_phantom_white[3];

/* 6 n. */
double gsn_phantom_nuclei_mean(const struct gsn_phantom_field *field, double depth);

void gsn_phantom_optical_density(const struct gsn_phantom_field *field,
                                 const struct gsn_phantom_stain *stain,
                                 const struct gsn_phantom_local *local, double ret_od[3]);

/* What a laser leaves: a dark disc with a bleached ring around it, or, where it burnt through, a
 * hole as bright as glass with a dark rim. Lengths in um. */
struct gsn_phantom_burning {
    int hole;
    double radius_um, ring_um; /* of the disc or hole; of the ring or rim around it */
    double edge_um;            /* over which one becomes the other */
};

/* The disc of the specification, of 75 um. */
const struct gsn_phantom_burning *gsn_phantom_burning(void);

/* Burns a mark into od, at distance_um of its centre. */
void gsn_phantom_burn(const struct gsn_phantom_burning *burning, double distance_um, double od[3]);

/* How the specification's numbers are written down for others. */
struct gsn_phantom_recipe {
    double red_amount, yellow_amount, yellow_loss, nuclear_amount, least_texture, lesion_nuclei;
    double nuclei[GSN_PHANTOM_LAYERS], amplitude[GSN_PHANTOM_LAYERS];
    double mark_bleach, mark_amount;
};

const struct gsn_phantom_recipe *gsn_phantom_recipe(void);

#ifdef __cplusplus
}
#endif
#endif
