/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Flat-field correction from the picture itself: the reference white as a quadratic surface.
 *
 *   1. Codes become linear light (IEC 61966-2-1 for sRGB) and its logarithm, by a table.
 *   2. The picture is cut into at most 384 cells a side; of each, 10 x 10 pixels give the mean
 *      light and the roughness.
 *   3. The brightest peak of the smooth cells' brightness is where glass begins, unless it is too
 *      small (a label's paper) and a darker peak of the same hue is not.
 *   4. From there a quadratic surface in x and y is fitted to the logarithm of light by iteratively
 *      reweighted least squares with Tukey's biweight (Beaton and Tukey 1974,
 *      10.1080/00401706.1974.10489171). Its reach shrinks from round to round until only what lies
 *      on the surface is left; darker cells weigh less, for glass is the brightest there is.
 *
 * It fails where less than 15 % of the cells end on the surface. Tissue that is paler than about
 * 0.03 everywhere cannot be told from glass that way. It costs as much for 48 million pixels as for
 * one: the cells that are read are as many. */
#include "pipeline/stain/flat_field.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/robust.h"
#include "pipeline/core/srgb.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* ---- samples and light ------------------------------------------------------------------- */

static double decode_code(enum gsn_light light, double code)
{
    return light == GSN_LIGHT_SRGB ? gsn_light_of_srgb(code) : code;
}

double gsn_light_of_sample(enum gsn_light light, unsigned sample, unsigned bits)
{
    assert(bits == 8 || bits == 16);
    return decode_code(light, sample / (bits == 8 ? 255.0 : 65535.0));
}

double gsn_light_encode(enum gsn_light light, double linear)
{
    return light == GSN_LIGHT_SRGB ? gsn_srgb_of_light(linear) : linear;
}

int gsn_light_table(enum gsn_light light, unsigned bits, double **ret_table, struct gsn_error *err)
{
    const unsigned top = bits == 8 ? 255 : 65535;
    double *table = gsn_alloc_array((size_t)top + 1, sizeof *table);

    if (!table)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a table of %u codes", top + 1);
    for (unsigned i = 0; i <= top; i++)
        table[i] = log10(decode_code(light, (i ? i : 0.5) / top));
    *ret_table = table;
    return GSN_OK;
}

/* ---- the surface ------------------------------------------------------------------------- */

int gsn_flat_field_given(uint32_t width, uint32_t height, enum gsn_light light,
                         const double white[3], struct gsn_flat_field *ret_glass,
                         struct gsn_error *err)
{
    struct gsn_flat_field glass = { .light = light, .width = width, .height = height };

    for (int c = 0; c < 3; c++) {
        if (!(white[c] >= 1 && white[c] <= 255))
            return gsn_fail(err, GSN_E_INPUT, "a white of %g is not a code from 1 to 255",
                            white[c]);
        glass.white[c] = white[c];
        glass.surface[c][0] = log10(decode_code(light, white[c] / 255));
    }
    *ret_glass = glass;
    return GSN_OK;
}

void gsn_flat_field_row(const struct gsn_flat_field *glass, uint32_t y, unsigned channel,
                        double ret[3])
{
    const double *s = glass->surface[channel];
    const double v = 2 * (y + 0.5) / glass->height - 1;

    ret[0] = s[0] + v * (s[2] + v * s[5]);
    ret[1] = s[1] + v * s[4];
    ret[2] = s[3];
}

double gsn_flat_field_at(const struct gsn_flat_field *glass, uint32_t x, uint32_t y,
                         unsigned channel)
{
    const double u = 2 * (x + 0.5) / glass->width - 1;
    double row[3];

    gsn_flat_field_row(glass, y, channel, row);
    return pow(10, row[0] + u * (row[1] + u * row[2]));
}

/* ---- robust fit to cells ----------------------------------------------------------------- */

enum { GSN_GLASS_TERMS = 6 };

struct gsn_glass_cell {
    double light[3]; /* mean of log10 */
    double rough;    /* deviation of one pixel in it */
    uint32_t top;    /* of the pixels read, those with a channel at the highest code */
    double weight;
};

struct gsn_glass_cells {
    size_t nx, ny, side;
    size_t apart, taps;     /* pixels read of a cell along each side, and how far from each other */
    uint32_t width, height; /* of the picture */
    struct gsn_glass_cell *cell;
    double *scratch; /* nx * ny */
};

struct gsn_glass_surface {
    double s[3][GSN_GLASS_TERMS];
    double reach;
};

/* Lengths below are optical densities. */
#define LAST_REACH 0.004 /* quantisation of 8 bits stays within it */
#define EVEN_HANDED 0.02 /* until the reach is this short, */
#define DARKER 0.1       /* darker cells weigh less: glass is the brightest there is */
#define RIDGE 1e-4       /* keeps the surface flat where no glass was seen */

enum { ROUNDS = 24 };

static void fill_basis(const struct gsn_glass_cells *all, size_t i, double ret[GSN_GLASS_TERMS])
{
    const double x = ((double)(i % all->nx) + 0.5) * (double)all->side;
    const double y = ((double)(i / all->nx) + 0.5) * (double)all->side;
    const double u = 2 * x / all->width - 1, v = 2 * y / all->height - 1;

    ret[0] = 1;
    ret[1] = u;
    ret[2] = v;
    ret[3] = u * u;
    ret[4] = u * v;
    ret[5] = v * v;
}

static double evaluate_surface(const double s[GSN_GLASS_TERMS], const double b[GSN_GLASS_TERMS])
{
    double sum = 0;

    for (int k = 0; k < GSN_GLASS_TERMS; k++)
        sum += s[k] * b[k];
    return sum;
}

static int fit_surface(const struct gsn_glass_cells *all, struct gsn_glass_surface *surface)
{
    double a[GSN_GLASS_TERMS][GSN_GLASS_TERMS] = { { 0 } }, b[3][GSN_GLASS_TERMS] = { { 0 } },
           sum = 0;

    for (size_t i = 0; i < all->nx * all->ny; i++) {
        const struct gsn_glass_cell *cell = &all->cell[i];
        double t[GSN_GLASS_TERMS];

        if (!(cell->weight > 0))
            continue;
        sum += cell->weight;
        fill_basis(all, i, t);
        for (int j = 0; j < GSN_GLASS_TERMS; j++) {
            for (int k = 0; k <= j; k++)
                a[j][k] += cell->weight * t[j] * t[k];
            for (int c = 0; c < 3; c++)
                b[c][j] += cell->weight * t[j] * cell->light[c];
        }
    }
    if (!(sum > 0))
        return 0;
    for (int j = 1; j < GSN_GLASS_TERMS; j++)
        a[j][j] += RIDGE * sum;
    if (gsn_cholesky(&a[0][0], GSN_GLASS_TERMS, GSN_GLASS_TERMS) < 0)
        return 0; /* the ridge keeps it definite */
    memcpy(surface->s, b, sizeof b);
    for (int c = 0; c < 3; c++)
        gsn_cholesky_solve(&a[0][0], GSN_GLASS_TERMS, GSN_GLASS_TERMS, surface->s[c]);
    return 1;
}

/* The largest of the three residuals; negative where the cell is darker than the surface. */
static double deviation_of_cell(const struct gsn_glass_cells *all, size_t i,
                                const struct gsn_glass_surface *surface)
{
    double t[GSN_GLASS_TERMS], most = 0, sum = 0;

    fill_basis(all, i, t);
    for (int c = 0; c < 3; c++) {
        const double d = all->cell[i].light[c] - evaluate_surface(surface->s[c], t);

        most = fmax(most, fabs(d));
        sum += d;
    }
    return sum < 0 ? -most : most;
}

static void weigh_cells(const struct gsn_glass_cells *all, const struct gsn_glass_surface *surface)
{
    for (size_t i = 0; i < all->nx * all->ny; i++) {
        const double d = deviation_of_cell(all, i, surface) / surface->reach;
        const double biweight = (1 - d * d) * (1 - d * d);
        const int takes_part = fabs(d) < 1;

        all->cell[i].weight = !takes_part                             ? 0
                              : d < 0 && surface->reach > EVEN_HANDED ? DARKER * biweight
                                                                      : biweight;
    }
}

/* Narrows the reach towards what the noise of smooth cells deserves. The spread of the residuals
 * must not decide it: pale tissue would widen it and stay. */
static void narrow_reach(const struct gsn_glass_cells *all, struct gsn_glass_surface *surface)
{
    size_t near = 0;
    double rough;

    for (size_t i = 0; i < all->nx * all->ny; i++)
        if (all->cell[i].weight > 0)
            all->scratch[near++] = all->cell[i].rough;
    if (near == 0)
        return;
    rough = gsn_order_pick(all->scratch, near, near / 4);
    surface->reach = fmax(LAST_REACH + 5 * rough / (double)all->taps, 0.85 * surface->reach);
}

/* Share of the cells that end on the surface, which begins near them and is fitted to them with a
 * reach that shrinks; their weights are left as they were last. */
static double grow_surface(const struct gsn_glass_cells *all, struct gsn_glass_surface *surface)
{
    const size_t count = all->nx * all->ny;
    size_t on = 0;

    weigh_cells(all, surface);
    for (int round = 0; round < ROUNDS; round++) {
        if (!fit_surface(all, surface))
            return 0;
        narrow_reach(all, surface);
        weigh_cells(all, surface);
    }
    for (size_t i = 0; i < count; i++)
        on += all->cell[i].weight > 0;
    return (double)on / (double)count;
}

/* ---- cells and the peak of their brightness ---------------------------------------------- */

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

static double brightness_of(const struct gsn_glass_cell *cell)
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
        const double at = -brightness_of(&all->cell[i]) / BIN;

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
static int start_surface(const struct gsn_glass_cells *all, double peak,
                         struct gsn_glass_surface *ret_surface)
{
    const size_t count = all->nx * all->ny;

    *ret_surface = (struct gsn_glass_surface){ .reach = FIRST_REACH };
    for (int c = 0; c < 3; c++) {
        size_t n = 0;

        for (size_t i = 0; i < count; i++)
            if (all->cell[i].rough < SMOOTH &&
                fabs(brightness_of(&all->cell[i]) - peak) < BIN * HALF_WINDOW)
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

        if (!is_peak(window, i, least) || !start_surface(all, -(i + 0.5) * BIN, &surface))
            continue;
        if (first_share < 0)
            first = surface;
        else if (!same_hue(&first, &surface))
            continue;
        share = grow_surface(all, &surface);
        if (first_share < 0)
            first_share = share;
        if (share >= LEAST_GLASS) {
            *ret_surface = surface;
            return share;
        }
    }
    return fmax(first_share, 0);
}

static void describe_glass(const struct gsn_glass_cells *all, struct gsn_flat_field *glass)
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
            sum += gsn_flat_field_at(glass, (uint32_t)((i % POINTS + 0.5) * glass->width / POINTS),
                                     (uint32_t)((i / POINTS + 0.5) * glass->height / POINTS), c);
        glass->white[c] = 255 * gsn_light_encode(glass->light, sum / (POINTS * POINTS));
    }
}

static int estimate_glass(const struct gsn_image *image, enum gsn_light light,
                          struct gsn_glass_cells *all, struct gsn_flat_field *ret_glass,
                          struct gsn_error *err)
{
    struct gsn_flat_field glass = { .light = light,
                                    .width = image->width,
                                    .height = image->height };
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
    describe_glass(all, &glass);
    *ret_glass = glass;
    return GSN_OK;
}

int gsn_flat_field_estimate(const struct gsn_image *image, enum gsn_light light,
                            struct gsn_flat_field *ret_glass, struct gsn_error *err)
{
    struct gsn_glass_cells all = { .nx = 0 };
    int r;

    if (image->channels != 3)
        return gsn_fail(err, GSN_E_INPUT, "a grey picture tells no dyes apart");
    if (image->width < SIDE_AT_LEAST || image->height < SIDE_AT_LEAST)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels is too small to show glass",
                        image->width, image->height);
    r = estimate_glass(image, light, &all, ret_glass, err);
    gsn_free(all.cell);
    gsn_free(all.scratch);
    return r;
}
