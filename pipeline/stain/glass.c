/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The blank glass of one scan, found in the picture itself.
 *
 * The picture is cut into small square cells. The brightest peak of their brightness is where glass
 * begins; from there a quadratic surface is fitted to the logarithm of light with Tukey's biweight,
 * whose reach shrinks from round to round until only what lies on the surface is left. Tissue that
 * is paler than about 0.03 everywhere cannot be told from glass that way. */
#include "pipeline/stain/redness.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/robust.h"
#include "pipeline/stain/glass_parts.h"
#include "pipeline/stain/light.h"

/* Lengths below are optical densities unless said otherwise. */
#define LEAST_GLASS 0.15 /* share of the picture that vendors and we ask for */
#define LEAST_PEAK 0.01  /* share of the cells that makes a peak of brightness */
#define BIN 0.005        /* of the histogram of brightness */
#define SMOOTH 0.02      /* a rougher cell does not count for a peak */
#define FIRST_REACH 0.06 /* half of the light lost to vignetting within the first rounds' reach */
#define NEUTRAL 0.03     /* glass beside brighter paper differs from it by no more colour */

enum {
    MOST_CELLS_ACROSS = 384,
    TAPS = 10, /* pixels of a cell that are read, along each side: there are thousands of cells */
    SIDE_AT_LEAST = 16,
    BINS = 520, /* 10^-2.6 of full light is never glass */
    HALF_WINDOW = 3,
};

static double brightness(const struct gsn_glass_cell *cell)
{
    return (cell->light[0] + cell->light[1] + cell->light[2]) / 3;
}

static void measure_cell(const struct gsn_image *image, const double *log_light,
                         const struct gsn_glass_cells *all, size_t i, struct gsn_glass_cell *cell)
{
    const size_t x0 = i % all->nx * all->side + all->apart / 2;
    const size_t y0 = i / all->nx * all->side + all->apart / 2;
    const unsigned top = image->bits == 8 ? 255 : 65535;
    const double n = (double)(all->taps * all->taps);
    double sum[3] = { 0 }, squares[3] = { 0 }, variance = 0;

    for (size_t v = 0; v < all->taps; v++) {
        for (size_t u = 0; u < all->taps; u++) {
            const uint32_t x = (uint32_t)(x0 + u * all->apart), y = (uint32_t)(y0 + v * all->apart);
            int at_top = 0;

            for (unsigned c = 0; c < 3; c++) {
                const unsigned sample = gsn_image_at(image, x, y, c);

                sum[c] += log_light[sample];
                squares[c] += log_light[sample] * log_light[sample];
                at_top |= sample == top;
            }
            cell->top += (uint32_t)at_top;
        }
    }
    for (int c = 0; c < 3; c++) {
        cell->light[c] = sum[c] / n;
        variance += fmax(squares[c] - sum[c] * sum[c] / n, 0) / (n - 1) / 3;
    }
    cell->rough = sqrt(variance);
}

static int cut_cells(const struct gsn_image *image, enum gsn_light light,
                     struct gsn_glass_cells *ret, struct gsn_error *err)
{
    const size_t longest = image->width > image->height ? image->width : image->height;
    const size_t side = (longest + MOST_CELLS_ACROSS - 1) / MOST_CELLS_ACROSS;
    gsn_auto_mem(double) log_light = NULL;
    const int r = gsn_light_table(light, image->bits, &log_light, err);

    if (r < 0)
        return r;
    ret->side = side < 2 ? 2 : side;
    ret->apart = ret->side > TAPS ? ret->side / TAPS : 1;
    ret->taps = ret->side / ret->apart;
    ret->width = image->width;
    ret->height = image->height;
    ret->nx = image->width / ret->side;
    ret->ny = image->height / ret->side;
    ret->cell = gsn_alloc_array(ret->nx * ret->ny, sizeof *ret->cell);
    ret->scratch = gsn_alloc_array(ret->nx * ret->ny, sizeof *ret->scratch);
    if (!ret->cell || !ret->scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the glass of a picture");
    for (size_t i = 0; i < ret->nx * ret->ny; i++)
        measure_cell(image, log_light, ret, i, &ret->cell[i]);
    return GSN_OK;
}

/* How many smooth cells lie within the window around each bin; bin 0 is full light. */
static void count_brightness(const struct gsn_glass_cells *all, size_t window[BINS])
{
    size_t bin[BINS] = { 0 };

    for (size_t i = 0; i < all->nx * all->ny; i++) {
        const double at = -brightness(&all->cell[i]) / BIN;

        if (all->cell[i].rough < SMOOTH && at < BINS)
            bin[at > 0 ? (size_t)at : 0]++;
    }
    for (int i = 0; i < BINS; i++) {
        window[i] = 0;
        for (int j = i - HALF_WINDOW; j <= i + HALF_WINDOW; j++)
            if (j >= 0 && j < BINS)
                window[i] += bin[j];
    }
}

static int is_peak(const size_t window[BINS], int i, size_t least)
{
    if (window[i] < least)
        return 0;
    for (int j = i - HALF_WINDOW; j <= i + HALF_WINDOW; j++)
        if (j >= 0 && j < BINS && (window[j] > window[i] || (j < i && window[j] == window[i])))
            return 0;
    return 1;
}

/* An even surface: the median colour of the smooth cells of this brightness. */
static int start(const struct gsn_glass_cells *all, double peak,
                 struct gsn_glass_surface *ret_surface)
{
    const size_t count = all->nx * all->ny;

    *ret_surface = (struct gsn_glass_surface){ .reach = FIRST_REACH };
    for (int c = 0; c < 3; c++) {
        size_t n = 0;

        for (size_t i = 0; i < count; i++)
            if (all->cell[i].rough < SMOOTH &&
                fabs(brightness(&all->cell[i]) - peak) < BIN * HALF_WINDOW)
                all->scratch[n++] = all->cell[i].light[c];
        if (n == 0)
            return 0;
        ret_surface->s[c][0] = gsn_order_pick(all->scratch, n, n / 2);
    }
    return 1;
}

/* Whether b differs from a in brightness only, as glass does from the paper of a label. */
static int same_hue(const struct gsn_glass_surface *a, const struct gsn_glass_surface *b)
{
    double low = INFINITY, high = -INFINITY;

    for (int c = 0; c < 3; c++) {
        low = fmin(low, a->s[c][0] - b->s[c][0]);
        high = fmax(high, a->s[c][0] - b->s[c][0]);
    }
    return high - low < NEUTRAL;
}

/* The brightest peak is glass, unless it is too small and a darker one of the same hue is not. */
static double find_glass(const struct gsn_glass_cells *all, struct gsn_glass_surface *ret_surface)
{
    const size_t least = (size_t)ceil(LEAST_PEAK * (double)(all->nx * all->ny));
    struct gsn_glass_surface first = { .reach = 0 };
    size_t window[BINS];
    double first_share = -1;

    count_brightness(all, window);
    for (int i = 0; i < BINS; i++) {
        struct gsn_glass_surface surface;
        double share;

        if (!is_peak(window, i, least) || !start(all, -(i + 0.5) * BIN, &surface))
            continue;
        if (first_share < 0)
            first = surface;
        else if (!same_hue(&first, &surface))
            continue;
        share = gsn_glass_grow(all, &surface);
        if (first_share < 0)
            first_share = share;
        if (share >= LEAST_GLASS) {
            *ret_surface = surface;
            return share;
        }
    }
    return fmax(first_share, 0);
}

static void describe(const struct gsn_glass_cells *all, struct gsn_glass *glass)
{
    enum { POINTS = 16 };
    size_t near = 0, top = 0;

    for (size_t i = 0; i < all->nx * all->ny; i++) {
        if (!(all->cell[i].weight > 0))
            continue;
        all->scratch[near++] = all->cell[i].rough;
        top += all->cell[i].top;
    }
    glass->overexposed = (double)top / (double)(near * all->taps * all->taps);
    glass->noise_od = gsn_order_pick(all->scratch, near, near / 2);
    for (unsigned c = 0; c < 3; c++) {
        double sum = 0;

        for (uint32_t i = 0; i < POINTS * POINTS; i++)
            sum += gsn_glass_at(glass, (uint32_t)((i % POINTS + 0.5) * glass->width / POINTS),
                                (uint32_t)((i / POINTS + 0.5) * glass->height / POINTS), c);
        glass->white[c] = 255 * gsn_light_encode(glass->light, sum / (POINTS * POINTS));
    }
}

static int estimate(const struct gsn_image *image, enum gsn_light light,
                    struct gsn_glass_cells *all, struct gsn_glass *ret_glass, struct gsn_error *err)
{
    struct gsn_glass glass = { .light = light, .width = image->width, .height = image->height };
    struct gsn_glass_surface surface;
    const int r = cut_cells(image, light, all, err);

    if (r < 0)
        return r;
    glass.fraction = find_glass(all, &surface);
    if (glass.fraction < LEAST_GLASS)
        return gsn_fail(
            err, GSN_E_STAIN,
            "only %.0f %% of this picture is blank glass; at least %.0f %% is needed to "
            "measure how bright the light was",
            floor(100 * glass.fraction), 100 * LEAST_GLASS);
    memcpy(glass.surface, surface.s, sizeof glass.surface);
    describe(all, &glass);
    *ret_glass = glass;
    return GSN_OK;
}

int gsn_glass_estimate(const struct gsn_image *image, enum gsn_light light,
                       struct gsn_glass *ret_glass, struct gsn_error *err)
{
    struct gsn_glass_cells all = { .nx = 0 };
    int r;

    if (image->channels != 3)
        return gsn_fail(err, GSN_E_INPUT, "a grey picture tells no dyes apart");
    if (image->width < SIDE_AT_LEAST || image->height < SIDE_AT_LEAST)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels is too small to show glass",
                        image->width, image->height);
    r = estimate(image, light, &all, ret_glass, err);
    gsn_free(all.cell);
    gsn_free(all.scratch);
    return r;
}
