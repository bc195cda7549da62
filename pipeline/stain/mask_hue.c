/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which colours that the stated dyes do not explain are the tissue's own.
 *
 * A bath that dyes another hue than was stated does so to every section of its panel; a pen does
 * not draw on every section, and where it does, not as much on each. So a colour is the tissue's
 * when the section has no more of it than its panel's sections usually have, when the dyes as the
 * tissue itself shows them explain it, and when it is not darker than stain gets over the breadth
 * of a stroke. All three are needed: a red dye may come near a red pen's, and pens may be on most
 * sections. */
#include "pipeline/stain/mask_cells.h"

#include "pipeline/core/robust.h"
#include "pipeline/stain/unmix.h"

#include <math.h>

/* A hue is the share that red and green have in the sum of the three densities; bins are about
 * 2 degrees wide. Evened over 3 x 3 they reach no farther than a colour has to be from the dyes to
 * be foreign; else ordinary tissue would stand up for the ink beside it. */
enum { ACROSS = 50, BINS = ACROSS * ACROSS };

/* Fewer sections cannot outvote a pen. */
enum { LEAST_SECTIONS = 4 };
/* A section of fewer cells, half a square millimetre, does not vote. */
enum { LEAST_CELLS = 1000 };
/* Neighbouring sections have up to this many times as much of a hue of their own. */
static const double MORE = 4;

/* No tissue is as dark over such a breadth, by the median of its panel's: a strong bath darkens all
 * of it. */
static const double DARKEST = 1.6;

struct hues {
    float share[BINS]; /* of the section's tissue, evened over 3 x 3 bins */
    double length;     /* median, of optical density */
    int votes;
};

/* What the sections have in common. */
struct usual {
    float share[BINS]; /* 0 everywhere where too few sections vote */
    double darkest;
};

static int bin_along(double share)
{
    const int bin = (int)floor(fmin(fmax(share, 0), 1) * ACROSS);

    return bin < ACROSS ? bin : ACROSS - 1;
}

static size_t bin_of(const struct gsn_mask_cells *cells, size_t i)
{
    const double sum = fmax(cells->total->value[i], 1e-6);

    return (size_t)bin_along(cells->even[1]->value[i] / sum) * ACROSS +
           (size_t)bin_along(cells->even[0]->value[i] / sum);
}

static float even_bin(const float count[BINS], int x, int y)
{
    float sum = 0;

    for (int v = y > 0 ? y - 1 : 0; v <= y + 1 && v < ACROSS; v++)
        for (int u = x > 0 ? x - 1 : 0; u <= x + 1 && u < ACROSS; u++)
            sum += count[v * ACROSS + u];
    return sum / 9;
}

static double length_at(const struct gsn_mask_cells *cells, size_t i)
{
    return sqrt(cells->even[0]->value[i] * cells->even[0]->value[i] +
                cells->even[1]->value[i] * cells->even[1]->value[i] +
                cells->even[2]->value[i] * cells->even[2]->value[i]);
}

/* list: scratch, a value for each cell. */
static void count_hues(const struct gsn_mask_cells *cells, double *list, struct hues *ret)
{
    float count[BINS] = { 0 };
    size_t all = 0;

    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++)
        if (cells->tissue[i] && !cells->label[i]) {
            count[bin_of(cells, i)]++;
            list[all++] = length_at(cells, i);
        }
    ret->votes = all >= LEAST_CELLS;
    ret->length = all > 0 ? gsn_order_pick(list, all, all / 2) : 0;
    for (int b = 0; b < BINS; b++)
        ret->share[b] = all > 0 ? even_bin(count, b % ACROSS, b / ACROSS) / (float)all : 0;
}

/* Medians over the sections that vote. list: scratch. */
static void find_usual(const struct hues *hues, size_t count, double *list, struct usual *ret)
{
    size_t n = 0;

    for (size_t k = 0; k < count; k++)
        if (hues[k].votes)
            list[n++] = hues[k].length;
    ret->darkest = GSN_DARKEST_OD;
    if (n >= LEAST_SECTIONS)
        ret->darkest = fmax(ret->darkest, DARKEST * gsn_order_pick(list, n, (n - 1) / 2));
    for (int b = 0; b < BINS; b++) {
        n = 0;
        for (size_t k = 0; k < count; k++)
            if (hues[k].votes)
                list[n++] = hues[k].share[b];
        ret->share[b] = n >= LEAST_SECTIONS ? (float)gsn_order_pick(list, n, (n - 1) / 2) : 0;
    }
}

/* gives: 1 where the section is dark over the breadth of a stroke. */
static int find_dark(const struct gsn_mask_cells *cells, double darkest, uint8_t **ret_dark,
                     struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;

    *ret_dark = gsn_alloc_array(count, 1);
    if (!*ret_dark)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        (*ret_dark)[i] = length_at(cells, i) > darkest;
    return gsn_mask_cells_broad(cells, *ret_dark, GSN_STROKE_HALF_UM, err);
}

static int lower_foreign(struct gsn_mask_cells *cells, const struct hues *hues,
                         const struct usual *usual, const struct gsn_unmixer *own,
                         struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) dark = NULL;
    const int r = find_dark(cells, usual->darkest, &dark, err);

    for (size_t i = 0; r >= 0 && i < (size_t)cells->nx * cells->ny; i++) {
        const double od[3] = { cells->even[0]->value[i], cells->even[1]->value[i],
                               cells->even[2]->value[i] };
        const size_t bin = bin_of(cells, i);
        float left;

        if (!(cells->total->value[i] > cells->clear) || dark[i] || !(usual->share[bin] > 0) ||
            hues->share[bin] > MORE * usual->share[bin])
            continue;
        left = (float)gsn_unmixer_left(own, od);
        if (left < cells->foreign->value[i])
            cells->foreign->value[i] = left;
    }
    return r;
}

/* gives: room for a value of each section and for one of each cell of any of them. */
static double *scratch(struct gsn_mask_cells *const *cells, size_t count)
{
    size_t most = count;

    for (size_t k = 0; k < count; k++) {
        const size_t here = (size_t)cells[k]->nx * cells[k]->ny;

        most = here > most ? here : most;
    }
    return gsn_alloc_array(most, sizeof(double));
}

int gsn_mask_own_hues(struct gsn_mask_cells *const *cells, size_t count, const struct gsn_dyes *own,
                      struct gsn_error *err)
{
    gsn_auto_mem(struct hues) hues = gsn_alloc_array(count, sizeof *hues);
    gsn_auto_mem(double) list = scratch(cells, count);
    struct usual usual;
    struct gsn_unmixer mix;
    int r = gsn_unmixer_init(&mix, own, err);

    if (r < 0)
        return r;
    if (!hues || !list)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t k = 0; k < count; k++)
        count_hues(cells[k], list, &hues[k]);
    find_usual(hues, count, list, &usual);
    for (size_t k = 0; k < count && r >= 0; k++)
        r = lower_foreign(cells[k], &hues[k], &usual, &mix, err);
    return r;
}
