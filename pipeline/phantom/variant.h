/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a specimen is to have that its level and its block do not say: another bath, other marks,
 * another anatomy or layout, a mistake in job.json. It is read from a small JSON file, so that a
 * case is data (tests/cases/variants). All keys are optional; README.md lists them. */
#ifndef GSN_PHANTOM_VARIANT_H
#define GSN_PHANTOM_VARIANT_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "pipeline/phantom/geometry.h"
#include "pipeline/phantom/stain.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_PHANTOM_DECOYS_MOST = 60, GSN_PHANTOM_WORD = 32 };

enum gsn_phantom_label { GSN_PHANTOM_UPRIGHT, GSN_PHANTOM_TURNED, GSN_PHANTOM_UNLABELLED };

enum gsn_phantom_calibrated {
    GSN_PHANTOM_NOT_CALIBRATED,
    GSN_PHANTOM_BY_DYES,   /* one glass of the bath, with a patch of each dye */
    GSN_PHANTOM_BY_PATCHES /* one of each panel's batch, with standards of known density as well */
};

/* A plain value. Fractions and factors are 1 where nothing is changed; a negative number leaves it
 * to the level. */
struct gsn_phantom_variant {
    char *text; /* the file, for the record; NULL without one */

    double bath_turn_deg; /* of red, yellow and dark, exactly, alike in all panels */
    uint64_t bath_seed;   /* which way */
    int haematoxylin;     /* is the dark dye */
    double panel_turn_deg;
    double stain_strength, texture, loss, exposure;
    double size_share; /* deviation of a section's size */
    int jpeg_quality;  /* 0: PNG */

    struct gsn_phantom_geometry geometry;
    struct gsn_phantom_burning burning;
    double aspect; /* of the longest mark */
    int decoys;    /* round spots in a section, exactly */
    int no_marks;

    int rows, columns; /* of a panel */
    enum gsn_phantom_label label;
    int black_frame_px;
    enum gsn_phantom_calibrated calibrated;

    char markers_key[GSN_PHANTOM_WORD], order[GSN_PHANTOM_WORD]; /* as job.json has them */
    int markers_y_up;
};

/* GVP-D as its specification and a level have it. */
struct gsn_phantom_variant gsn_phantom_variant_usual(void);

/* Reads the file. gives: ret_variant, for gsn_phantom_variant_done(). Fails with GSN_E_NOTFOUND,
 * GSN_E_IO, GSN_E_NOMEM, and GSN_E_INPUT naming the key: one that nobody defined (and the nearest
 * that there is), or a value that is out of its range. */
int gsn_phantom_variant_read(const char *path, struct gsn_phantom_variant *ret_variant,
                             struct gsn_error *err);
/* The same, from text; name: for the sentence. */
int gsn_phantom_variant_parse(const char *text, size_t size, const char *name,
                              struct gsn_phantom_variant *ret_variant, struct gsn_error *err);
void gsn_phantom_variant_done(struct gsn_phantom_variant *variant);
#define gsn_auto_phantom_variant                                                                   \
    __attribute__((cleanup(gsn_phantom_variant_done))) struct gsn_phantom_variant

/* The vector of a dye in the variant's bath. */
void gsn_phantom_variant_dye(const struct gsn_phantom_variant *variant, enum gsn_phantom_dye dye,
                             double ret_vector[3]);

#ifdef __cplusplus
}
#endif
#endif
