/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Ink: a colour that no mixture of the dyes makes, or black and as broad as a stroke.
 *
 *   1. Which colours that the stated dyes do not explain are the tissue's own. A bath that dyes
 *      another hue than was stated does so to every section of its panel; a pen does not draw on
 *      every section, and where it does, not as much on each. So a colour is the tissue's when the
 *      section has no more of it than its panel's sections usually have (a histogram of hue per
 *      section, medians over sections), when the dyes as the tissue itself shows them explain it,
 *      and when it is not darker than stain gets over the breadth of a stroke. All three are
 * needed: a red dye may come near a red pen's, and pens may be on most sections.
 *   2. Ink is what stays foreign by more than the vectors' error, and broad black; beside it the
 * hue alone decides, as far as a stroke fades (hysteresis).
 *
 * Fewer than four sections do not vote. Grey pencil is paler than ink and stays. */
#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/imaging/filter.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/stain/artefact/cells.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>

/* ---- colours of the tissue itself -------------------------------------------------------- */

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

static size_t bin_of(const struct gsn_artefact_cells *cells, size_t i)
{
    const double sum = fmax(cells->total->value[i], 1e-6);

    return (size_t)bin_along(cells->even[1]->value[i] / sum) * ACROSS +
           (size_t)bin_along(cells->even[0]->value[i] / sum);
}

/* The length of the three densities. */
static double length_at(const struct gsn_artefact_cells *cells, size_t i)
{
    return sqrt(cells->even[0]->value[i] * cells->even[0]->value[i] +
                cells->even[1]->value[i] * cells->even[1]->value[i] +
                cells->even[2]->value[i] * cells->even[2]->value[i]);
}

/* list: scratch, a value for each cell. */
static int count_hues(const struct gsn_artefact_cells *cells, double *list, struct hues *ret,
                      struct gsn_error *err)
{
    float count[BINS] = { 0 }, sum[BINS];
    size_t all = 0;
    int r;

    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++)
        if (cells->tissue[i] && !cells->label[i]) {
            count[bin_of(cells, i)]++;
            list[all++] = length_at(cells, i);
        }
    ret->votes = all >= LEAST_CELLS;
    ret->length = all > 0 ? gsn_order_pick(list, all, all / 2) : 0;
    r = gsn_box_sum(count, ACROSS, ACROSS, 1, sum, err);
    if (r < 0)
        return r;
    for (int b = 0; b < BINS; b++)
        ret->share[b] = all > 0 ? sum[b] / 9 / (float)all : 0;
    return GSN_OK;
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
static int find_dark(const struct gsn_artefact_cells *cells, double darkest, uint8_t **ret_dark,
                     struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;

    *ret_dark = gsn_alloc_array(count, 1);
    if (!*ret_dark)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        (*ret_dark)[i] = length_at(cells, i) > darkest;
    return gsn_artefact_cells_broad(cells, *ret_dark, GSN_STROKE_HALF_UM, err);
}

static int lower_foreign(struct gsn_artefact_cells *cells, const struct hues *hues,
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
static double *new_scratch(struct gsn_artefact_cells *const *cells, size_t count)
{
    size_t most = count;

    for (size_t k = 0; k < count; k++) {
        const size_t here = (size_t)cells[k]->nx * cells[k]->ny;

        most = here > most ? here : most;
    }
    return gsn_alloc_array(most, sizeof(double));
}

int gsn_artefact_own_hues(struct gsn_artefact_cells *const *cells, size_t count,
                          const struct gsn_dyes *own, struct gsn_error *err)
{
    gsn_auto_mem(struct hues) hues = gsn_alloc_array(count, sizeof *hues);
    gsn_auto_mem(double) list = new_scratch(cells, count);
    struct usual usual;
    struct gsn_unmixer mix;
    int r = gsn_unmixer_init(&mix, own, err);

    if (r < 0)
        return r;
    if (!hues || !list)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t k = 0; k < count && r >= 0; k++)
        r = count_hues(cells[k], list, &hues[k], err);
    if (r < 0)
        return r;
    find_usual(hues, count, list, &usual);
    for (size_t k = 0; k < count && r >= 0; k++)
        r = lower_foreign(cells[k], &hues[k], &usual, &mix, err);
    return r;
}

/* ---- ink --------------------------------------------------------------------------------- */

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

static int new_set(const struct gsn_artefact_cells *cells, uint8_t **ret_set, struct gsn_error *err)
{
    *ret_set = gsn_alloc_array((size_t)cells->nx * cells->ny, 1);
    return *ret_set ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
}

static int is_black(const struct gsn_artefact_cells *cells, size_t i)
{
    const double r = cells->even[0]->value[i], g = cells->even[1]->value[i],
                 b = cells->even[2]->value[i];
    const double least = fmin(r, fmin(g, b)), most = fmax(r, fmax(g, b));

    return length_at(cells, i) > GSN_DARKEST_OD && least > BLACK_EVEN * most;
}

/* Adds broad black to sure. */
static int add_black(const struct gsn_artefact_cells *cells, uint8_t *sure, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) black = NULL;
    int r = new_set(cells, &black, err);

    for (size_t i = 0; r >= 0 && i < count; i++)
        black[i] = (uint8_t)is_black(cells, i);
    if (r >= 0)
        r = gsn_artefact_cells_broad(cells, black, GSN_STROKE_HALF_UM, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        sure[i] |= black[i];
    return r;
}

int gsn_artefact_ink(struct gsn_artefact_cells *cells, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) sure = NULL;
    gsn_auto_mem(uint8_t) weak = NULL;
    int r = new_set(cells, &sure, err);

    if (r >= 0)
        r = new_set(cells, &weak, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        const double v = length_at(cells, i), foreign = cells->foreign->value[i];
        const int halo = (cells->label[i] & GSN_DEFECT_HALO) != 0;

        sure[i] = !halo && v > INK_OD && foreign > BEYOND + BEYOND_SHARE * v;
        weak[i] = v > GSN_DARKEST_OD ||
                  (cells->total->value[i] > cells->clear && foreign > EDGE_SHARE * v);
    }
    if (r >= 0)
        r = add_black(cells, sure, err);
    if (r >= 0)
        r = gsn_artefact_cells_grow(cells, sure, weak, FADES_UM, err);
    if (r >= 0)
        r = gsn_dilate(weak, cells->nx, cells->ny, SMEAR_UM / cells->um, err);
    if (r >= 0)
        gsn_artefact_cells_mark(cells, weak, GSN_DEFECT_INK);
    return r;
}
