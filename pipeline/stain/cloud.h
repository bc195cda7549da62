/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The colours of a panel's tissue, counted: a histogram over hue, small enough to be handed on to
 * the specimens that are compared with this one.
 *
 * Hue is the share of each channel in the optical density of a cell of tissue; amounts of dye drop
 * out of it, and mixtures lie on straight lines between what they are mixed of. */
#ifndef GSN_STAIN_CLOUD_H
#define GSN_STAIN_CLOUD_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Bins of hue: shares of green and of blue from these on, so far apart. All stains of three dyes
 * lie inside; a degree of hue is some four bins. */
#define GSN_CLOUD_SHARE 0.004
#define GSN_CLOUD_LEAST_GREEN 0.15
#define GSN_CLOUD_LEAST_BLUE 0.10
enum { GSN_CLOUD_GREENS = 112, GSN_CLOUD_BLUES = 160 };

/* What is paler than this (R + G + B) is too pale to have a hue. */
#define GSN_CLOUD_LEAST_OD 0.25

/* Cells of one hue. */
struct gsn_cloud_bin {
    uint32_t at;  /* green * GSN_CLOUD_BLUES + blue */
    double cells; /* how many */
    double od;    /* mean R + G + B of them */
};

/* The cloud of one panel. */
struct gsn_cloud_panel {
    unsigned panel;            /* its number, 1-based */
    double noise;              /* variance of a cell's optical density at density 0, one channel */
    int lossy;                 /* whether its file is a JPEG, whose colours run over */
    struct gsn_cloud_bin *bin; /* owned; in order of at */
    size_t bins;
};

struct gsn_cloud {
    struct gsn_cloud_panel *panel; /* owned */
    size_t panels;
};

/* gives: panels without bins. Fails with GSN_E_NOMEM. */
int gsn_cloud_new(size_t panels, struct gsn_cloud **ret_cloud, struct gsn_error *err);
void gsn_cloud_free(struct gsn_cloud *cloud);
GSN_DEFINE_AUTO(gsn_cloud);

/* Counts the cells of one panel while they pass. Opaque. */
struct gsn_cloud_tally;

/* gives. Fails with GSN_E_NOMEM. */
int gsn_cloud_tally_new(struct gsn_cloud_tally **ret_tally, struct gsn_error *err);
void gsn_cloud_tally_free(struct gsn_cloud_tally *tally);
GSN_DEFINE_AUTO(gsn_cloud_tally);

/* One cell, or so many alike; what is too pale or no colour of a stain is passed over. */
void gsn_cloud_tally_add(struct gsn_cloud_tally *tally, const double od[3], double cells);
/* The panel takes what was counted, and the tally is empty again. Fails with GSN_E_NOMEM. */
int gsn_cloud_tally_take(struct gsn_cloud_tally *tally, struct gsn_cloud_panel *panel,
                         struct gsn_error *err);

/* R, G and B optical density in the middle of a bin, at its mean total. */
void gsn_cloud_bin_od(const struct gsn_cloud_bin *bin, double ret_od[3]);

#ifdef __cplusplus
}
#endif
#endif
