/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Ink, tears and holes: what has the wrong colour, and what has none. */
#include "pipeline/stain/mask_cells.h"

#include <math.h>

#include "pipeline/imaging/morphology.h"

/* Felt pens absorb as strongly as the darkest stain; paler foreign colour is dirt or JPEG. */
#define INK_OD 0.35
/* The dye vectors of a slide are known to about 4 degrees (a tangent of 0.07), and codes of 8 bits
 * are rounded. Red ink, the nearest to a dye, lies 12 degrees from the red one. */
#define BEYOND 0.04
#define BEYOND_SHARE 0.07
/* At the edge of a stroke, beside what is surely ink, the hue alone decides: 6 degrees. Where two
 * inks lie over each other the hue may be a dye's, but nothing is as dark. */
#define EDGE_SHARE 0.10
/* How far a stroke fades, and what JPEG smears its colour by. */
#define FADES_UM 250.0
#define SMEAR_UM 45.0
/* Black ink has no hue, so it must be darker than stain gets, in all three channels alike, and
 * as broad as a stroke. */
#define BLACK_EVEN 0.65

/* A void that is smaller may be a vessel or a fat cell, or noise in pale tissue. */
#define LEAST_VOID_UM 80.0

static int new_set(const struct gsn_mask_cells *cells, uint8_t **ret_set, struct gsn_error *err)
{
    *ret_set = gsn_alloc_array((size_t)cells->nx * cells->ny, 1);
    return *ret_set ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
}

/* The length of the three densities. */
static double strength(const struct gsn_mask_cells *cells, size_t i)
{
    double sum = 0;

    for (int c = 0; c < 3; c++)
        sum += cells->even[c]->value[i] * cells->even[c]->value[i];
    return sqrt(sum);
}

static int is_black(const struct gsn_mask_cells *cells, size_t i)
{
    const double r = cells->even[0]->value[i], g = cells->even[1]->value[i],
                 b = cells->even[2]->value[i];
    const double least = fmin(r, fmin(g, b)), most = fmax(r, fmax(g, b));

    return strength(cells, i) > GSN_DARKEST_OD && least > BLACK_EVEN * most;
}

/* Adds broad black to sure. */
static int add_black(const struct gsn_mask_cells *cells, uint8_t *sure, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) black = NULL;
    int r = new_set(cells, &black, err);

    for (size_t i = 0; r >= 0 && i < count; i++)
        black[i] = (uint8_t)is_black(cells, i);
    if (r >= 0)
        r = gsn_mask_cells_broad(cells, black, GSN_STROKE_HALF_UM, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        sure[i] |= black[i];
    return r;
}

int gsn_mask_ink(struct gsn_mask_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) sure = NULL;
    gsn_auto_mem(uint8_t) weak = NULL;
    int r = new_set(cells, &sure, err);

    if (r >= 0)
        r = new_set(cells, &weak, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        const double v = strength(cells, i), foreign = cells->foreign->value[i];
        const int halo = (cells->label[i] & GSN_DEFECT_HALO) != 0;

        sure[i] = !halo && v > INK_OD && foreign > BEYOND + BEYOND_SHARE * v;
        weak[i] = v > GSN_DARKEST_OD ||
                  (cells->total->value[i] > cells->clear && foreign > EDGE_SHARE * v);
    }
    if (r >= 0)
        r = add_black(cells, sure, err);
    if (r >= 0)
        r = gsn_mask_cells_grow(cells, sure, weak, FADES_UM, err);
    if (r >= 0)
        r = gsn_dilate(weak, cells->nx, cells->ny, SMEAR_UM / cells->um, err);
    if (r >= 0)
        gsn_mask_cells_mark(cells, weak, GSN_DEFECT_INK);
    return r;
}

/* Tears and holes are glass within the outline. What a mark burnt is its halo's. */
int gsn_mask_voids(struct gsn_mask_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) clear = NULL;
    gsn_auto_mem(uint8_t) core = NULL;
    int r = new_set(cells, &clear, err);

    for (size_t i = 0; r >= 0 && i < count; i++)
        clear[i] = cells->outline[i] && !cells->tissue[i] && !cells->label[i];
    core = r >= 0 ? gsn_memdup(clear, count) : NULL;
    if (!core)
        return r < 0 ? r : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_erode(core, cells->nx, cells->ny, LEAST_VOID_UM / 2 / cells->um, err);
    if (r >= 0)
        r = gsn_mask_cells_grow(cells, core, clear, 1e9, err);
    /* The cells at its border hold glass too. */
    if (r >= 0)
        r = gsn_dilate(clear, cells->nx, cells->ny, 1.5, err);
    for (size_t i = 0; i < count; i++)
        clear[i] &= cells->outline[i];
    if (r >= 0)
        gsn_mask_cells_mark(cells, clear, GSN_DEFECT_VOID);
    return r;
}
