/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Blur: fine detail against coarse detail.
 *
 * Some tissue is smooth by nature, so the amount of detail says nothing about focus. But detail of
 * one cell fades with defocus long before detail of several cells does: the ratio of the two, with
 * the noise of the camera taken off, is the same in smooth and in rough tissue that is in focus. It
 * depends on the stain and on the scanner, so a place is compared with other sections only. */
#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/stain/artefact/cells.h"

#include <math.h>
#include <string.h>

enum {
    WINDOW = 8, /* cells to either side: 17 x 17 tell the ratio to about a tenth */
    COARSE = 4, /* half width of what is coarse */
};

/* A Gaussian of one cell leaves a seventh of the fine detail's variance. */
#define BLURRED 0.3

/* Where coarse detail is not this much above the noise, focus cannot be told. */
#define LEAST_DETAIL 6.0
#define LEAST_SHARE 0.5 /* of the window that must be tissue */
#define LEAST_BLUR_UM 200.0

struct detail {
    struct gsn_plane *fine, *coarse, *noise, *share;
};

static void detail_done(struct detail *d)
{
    gsn_plane_free(d->fine);
    gsn_plane_free(d->coarse);
    gsn_plane_free(d->noise);
    gsn_plane_free(d->share);
}

/* Tissue well away from borders, which are sharp or not for reasons of their own. */
static int inner_tissue(const struct gsn_artefact_cells *cells, uint8_t **ret_set,
                        struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) set = gsn_alloc_array(count, 1);
    int r;

    if (!set)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        set[i] = cells->tissue[i] && !cells->label[i];
    r = gsn_erode(set, cells->nx, cells->ny, COARSE + 1, err);
    if (r >= 0)
        *ret_set = gsn_steal(&set);
    return r;
}

/* Squares of the two kinds of detail of green's density, where light is absorbed most. */
static void take_detail(const struct gsn_artefact_cells *cells, const uint8_t *inner,
                        const struct gsn_plane *broad, struct detail *d)
{
    const float *g = cells->od[1]->value;
    const size_t nx = cells->nx;

    for (size_t i = nx; i + nx < nx * cells->ny; i++) {
        if (!inner[i])
            continue;
        const double fine = g[i] - (g[i - 1] + g[i + 1] + g[i - nx] + g[i + nx]) / 4;
        const double coarse = cells->even[1]->value[i] - broad->value[i];
        /* The camera's noise is even in codes, so it grows with the density. */
        const double noise = cells->noise * pow(10, cells->even[1]->value[i]);

        d->fine->value[i] = (float)(fine * fine);
        d->coarse->value[i] = (float)(coarse * coarse);
        d->noise->value[i] = (float)(noise * noise);
        d->share->value[i] = 1;
    }
}

static int smooth_in_place(struct gsn_plane **plane, struct gsn_error *err)
{
    struct gsn_plane *smooth;
    const int r = gsn_box_mean(*plane, WINDOW, &smooth, err);

    if (r < 0)
        return r;
    gsn_plane_free(*plane);
    *plane = smooth;
    return GSN_OK;
}

static int measure_detail(const struct gsn_artefact_cells *cells, const uint8_t *inner,
                          struct detail *d, struct gsn_error *err)
{
    struct gsn_plane **const planes[] = { &d->fine, &d->coarse, &d->noise, &d->share };
    gsn_auto(gsn_plane) broad = NULL;
    int r = gsn_box_mean(cells->od[1], COARSE, &broad, err);

    for (size_t i = 0; r >= 0 && i < 4; i++)
        r = gsn_plane_new(cells->nx, cells->ny, planes[i], err);
    if (r >= 0)
        take_detail(cells, inner, broad, d);
    for (size_t i = 0; r >= 0 && i < 4; i++)
        r = smooth_in_place(planes[i], err);
    return r;
}

/* The mean over 5 of the noise of five cells stays in what is fine, 1.25 of it; over 9, less what
 * is broad, in what is coarse. */
static float detail_ratio(const struct detail *d, size_t i)
{
    const double noise = d->noise->value[i];
    const double coarse = d->coarse->value[i] - noise / 9;

    if (d->share->value[i] < LEAST_SHARE || coarse <= LEAST_DETAIL * noise / 9 || coarse <= 0)
        return NAN;
    return (float)fmax(0, (d->fine->value[i] - 1.25 * noise) / coarse);
}

int gsn_artefact_sharpness(const struct gsn_artefact_cells *cells, struct gsn_plane **ret_sharpness,
                           double *ret_median, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    struct detail d = { NULL, NULL, NULL, NULL };
    gsn_auto(gsn_plane) sharpness = NULL;
    gsn_auto_mem(double) list = gsn_alloc_array(count, sizeof *list);
    gsn_auto_mem(uint8_t) inner = NULL;
    size_t n = 0;
    int r = list ? inner_tissue(cells, &inner, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");

    if (r >= 0)
        r = gsn_plane_new(cells->nx, cells->ny, &sharpness, err);
    if (r >= 0)
        r = measure_detail(cells, inner, &d, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        sharpness->value[i] = detail_ratio(&d, i);
        if (inner[i] && !isnan(sharpness->value[i]))
            list[n++] = sharpness->value[i];
    }
    detail_done(&d);
    if (r < 0)
        return r;
    *ret_median = n > 0 ? gsn_order_pick(list, n, n / 2) : (double)NAN;
    *ret_sharpness = gsn_steal(&sharpness);
    return GSN_OK;
}

int gsn_artefact_blur(struct gsn_artefact_cells *cells, const struct gsn_plane *sharpness,
                      double usual, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) set = gsn_alloc_array(count, 1);
    int r;

    if (!set)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        set[i] = sharpness->value[i] < BLURRED * usual; /* false for NaN */
    r = gsn_erode(set, cells->nx, cells->ny, LEAST_BLUR_UM / 2 / cells->um, err);
    /* Most of the window at the border of a blurred place must be blurred to be told. */
    if (r >= 0)
        r = gsn_dilate(set, cells->nx, cells->ny, LEAST_BLUR_UM / 2 / cells->um + 0.75 * WINDOW,
                       err);
    for (size_t i = 0; i < count; i++)
        set[i] &= cells->outline[i];
    if (r >= 0)
        gsn_artefact_cells_mark(cells, set, GSN_DEFECT_BLUR);
    return r;
}
