/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Collagen density of whole rows of pixels, and the area of collagen.
 *
 * Only red is told. Where all three dyes explain a pixel honestly the plain inverse counts, whose
 * amounts may come out negative: the other two by up to HONEST of the pixel's density, red by up to
 * twice that. For a dye that is a few degrees off its vector leaves negative amounts in honest
 * tissue; cutting them off at 0 pulls the mean of red towards whichever dye is nearest, and
 * differently in pale and in dense tissue. Left in, a turned vector multiplies red and adds to it
 * alike everywhere, which can be taken out again (normalisation.h). A pixel further off is no
 * mixture of these dyes and is unmixed without negative amounts, as unmixing.c does.
 *
 * The inner loop has no branch: of the solutions that use one dye, two or all, the allowed one with
 * the largest a.b wins. The compiler makes vectors of it.
 *
 * The area: pixels of the tissue above a threshold, Otsu's over the tissue unless one is stated. */
#include "pipeline/stain/collagen_density.h"

#include "pipeline/core/mem.h"
#include "pipeline/imaging/threshold.h"

#include <math.h>

/* Red and dark are 18 degrees apart: a vector that is 5 degrees off leaves a negative amount of
 * sin 5 / sin 18, a quarter, of the other. Red pays for the yellow as well: twice that. */
#define HONEST 0.25F

/* Amount i of the solution that uses these dyes, of R, G and B. */
static void amount_of(const struct gsn_unmixer *mix, unsigned subset, int i, float ret[3])
{
    for (int c = 0; c < 3; c++) {
        double sum = 0;

        for (int k = 0; k < 3; k++)
            sum += mix->inverse[subset][i][k] * mix->dye[k][c];
        ret[c] = (float)sum;
    }
}

struct gsn_collagen_weights gsn_collagen_weights_of(const struct gsn_unmixer *mix,
                                                    double full_red_od)
{
    static const int pairs[3][2] = { { 0, 1 }, { 0, 2 }, { 1, 2 } };
    struct gsn_collagen_weights w = { .per_red = (float)(1 / full_red_od) };

    for (int i = 0; i < 3; i++) {
        const unsigned both = 1u << pairs[i][0] | 1u << pairs[i][1];

        amount_of(mix, 7, i, w.all[i]);
        amount_of(mix, both, pairs[i][0], w.pair[i][0]);
        amount_of(mix, both, pairs[i][1], w.pair[i][1]);
        for (int c = 0; c < 3; c++)
            w.dye[i][c] = (float)mix->dye[i][c];
    }
    return w;
}

void gsn_collagen_row(const struct gsn_collagen_weights *weights, const float *restrict red,
                      const float *restrict green, const float *restrict blue, size_t count,
                      float *restrict to)
{
    const struct gsn_collagen_weights w = *weights;

    for (size_t i = 0; i < count; i++) {
        const float r = red[i], g = green[i], b = blue[i];
        const float b0 = w.dye[0][0] * r + w.dye[0][1] * g + w.dye[0][2] * b;
        const float b1 = w.dye[1][0] * r + w.dye[1][1] * g + w.dye[1][2] * b;
        const float b2 = w.dye[2][0] * r + w.dye[2][1] * g + w.dye[2][2] * b;
        const float p0 = w.pair[0][0][0] * r + w.pair[0][0][1] * g + w.pair[0][0][2] * b;
        const float p1 = w.pair[0][1][0] * r + w.pair[0][1][1] * g + w.pair[0][1][2] * b;
        const float q0 = w.pair[1][0][0] * r + w.pair[1][0][1] * g + w.pair[1][0][2] * b;
        const float q2 = w.pair[1][1][0] * r + w.pair[1][1][1] * g + w.pair[1][1][2] * b;
        const float s1 = w.pair[2][0][0] * r + w.pair[2][0][1] * g + w.pair[2][0][2] * b;
        const float s2 = w.pair[2][1][0] * r + w.pair[2][1][1] * g + w.pair[2][1][2] * b;
        const float a0 = w.all[0][0] * r + w.all[0][1] * g + w.all[0][2] * b;
        const float a1 = w.all[1][0] * r + w.all[1][1] * g + w.all[1][2] * b;
        const float a2 = w.all[2][0] * r + w.all[2][1] * g + w.all[2][2] * b;
        const float pp = (p0 >= 0) & (p1 >= 0) ? p0 * b0 + p1 * b1 : 0;
        const float qq = (q0 >= 0) & (q2 >= 0) ? q0 * b0 + q2 * b2 : 0;
        const float ss = (s1 >= 0) & (s2 >= 0) ? s1 * b1 + s2 * b2 : 0;
        const float one = b0 > 0 ? b0 * b0 : 0;
        const float two = b1 > 0 ? b1 * b1 : 0;
        const float three = b2 > 0 ? b2 * b2 : 0;
        const float n0 = a0 < 0 ? a0 : 0, n1 = a1 < 0 ? a1 : 0, n2 = a2 < 0 ? a2 : 0;
        const float least = HONEST * HONEST * (r * r + g * g + b * b);
        float most = one, amount = b0 > 0 ? b0 : 0;

        amount = pp > most ? p0 : amount;
        most = pp > most ? pp : most;
        amount = qq > most ? q0 : amount;
        most = qq > most ? qq : most;
        amount = ss > most ? 0 : amount;
        most = ss > most ? ss : most;
        amount = (two > most) | (three > most) ? 0 : amount;
        amount = (n0 * n0 <= 4 * least) & (n1 * n1 <= least) & (n2 * n2 <= least) ? a0 : amount;
        to[i] = w.per_red * amount;
    }
}

/* ---- boxes of a picture ------------------------------------------------------------------ */

struct gsn_collagen_reader {
    const struct gsn_od_reader *absorber;
    struct gsn_collagen_weights weights;
};

int gsn_collagen_reader_new(const struct gsn_od_reader *absorber, const struct gsn_dyes *dyes,
                            struct gsn_collagen_reader **ret_reader, struct gsn_error *err)
{
    struct gsn_unmixer mix;
    struct gsn_collagen_reader *reader;
    const int r = gsn_unmixer_init(&mix, dyes, err);

    if (r < 0)
        return r;
    reader = gsn_alloc_array(1, sizeof *reader);
    if (!reader)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for densities");
    reader->absorber = absorber;
    reader->weights = gsn_collagen_weights_of(&mix, dyes->full_red_od);
    *ret_reader = reader;
    return GSN_OK;
}

void gsn_collagen_reader_free(struct gsn_collagen_reader *reader)
{
    gsn_free(reader);
}

/* Of count pixels from (x, y) on; NaN where they are tissue and clipped. scratch: 3 x count. */
static void read_row(const struct gsn_collagen_reader *reader, uint32_t x, uint32_t y, size_t count,
                     float *scratch, float *to)
{
    const struct gsn_od_reader *absorber = reader->absorber;
    float *const od[3] = { scratch, scratch + count, scratch + 2 * count };

    gsn_od_reader_row(absorber, x, y, count, od);
    gsn_collagen_row(&reader->weights, od[0], od[1], od[2], count, to);
    if (!gsn_od_reader_at_end(absorber, x, y, count))
        return;
    for (size_t i = 0; i < count; i++)
        if (od[0][i] + od[1][i] + od[2][i] > GSN_TISSUE_OD &&
            gsn_od_reader_clipped(absorber, x + (uint32_t)i, y))
            to[i] = NAN;
}

int gsn_collagen_box(const struct gsn_collagen_reader *reader, const struct gsn_pixel_box *box,
                     unsigned apart, struct gsn_plane **ret_density, struct gsn_error *err)
{
    const uint32_t width = (uint32_t)box->width;
    const uint32_t height = ((uint32_t)box->height + apart - 1) / apart;
    gsn_auto(gsn_plane) density = NULL;
    gsn_auto_mem(float) scratch = gsn_alloc_array(3 * (size_t)width, sizeof *scratch);
    int r;

    if (!scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for densities");
    r = gsn_plane_new(width, height, &density, err);
    if (r < 0)
        return r;
    for (uint32_t y = 0; y < height; y++)
        read_row(reader, (uint32_t)box->x, (uint32_t)box->y + y * apart, width, scratch,
                 density->value + (size_t)y * width);
    *ret_density = gsn_steal(&density);
    return GSN_OK;
}

static int same_size(const struct gsn_plane *a, const struct gsn_plane *b)
{
    return a->width == b->width && a->height == b->height;
}

int gsn_red_share(const struct gsn_plane *red, const struct gsn_plane *yellow,
                  const struct gsn_plane *dark, const struct gsn_dyes *dyes,
                  struct gsn_plane **ret_share, struct gsn_error *err)
{
    gsn_auto(gsn_plane) share = NULL;
    int r;

    if (!same_size(red, yellow) || !same_size(red, dark))
        return gsn_fail(err, GSN_E_INPUT, "the planes of the dyes differ in size");
    r = gsn_plane_new(red->width, red->height, &share, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < (size_t)red->width * red->height; i++) {
        const double amount = red->value[i] * dyes->full_red_od;
        const double all = amount + yellow->value[i] + dark->value[i];

        share->value[i] = all > GSN_PALE_OD ? (float)(amount / all) : 0;
    }
    *ret_share = gsn_steal(&share);
    return GSN_OK;
}

/* ---- the area that is collagen ----------------------------------------------------------- */

int gsn_plane_above(const struct gsn_plane *plane, double threshold, struct gsn_image **ret_map,
                    struct gsn_error *err)
{
    const int r = gsn_image_new(plane->width, plane->height, 1, 8, ret_map, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < (size_t)plane->width * plane->height; i++)
        ((uint8_t *)(*ret_map)->samples)[i] = plane->value[i] > threshold ? 255 : 0;
    return GSN_OK;
}

static int is_tissue(const struct gsn_image *tissue, size_t i)
{
    return !tissue || ((const uint8_t *)tissue->samples)[i] >= 128;
}

static int check_planes(const struct gsn_plane *by, const struct gsn_plane *density,
                        const struct gsn_image *tissue, struct gsn_error *err)
{
    if (by->width != density->width || by->height != density->height)
        return gsn_fail(err, GSN_E_INPUT, "the planes are of %u x %u and %u x %u pixels", by->width,
                        by->height, density->width, density->height);
    if (tissue && (tissue->width != by->width || tissue->height != by->height))
        return gsn_fail(err, GSN_E_INPUT, "the tissue map is of %u x %u pixels, not of %u x %u",
                        tissue->width, tissue->height, by->width, by->height);
    if (tissue && (tissue->channels != 1 || tissue->bits != 8))
        return gsn_fail(err, GSN_E_INPUT, "the tissue map is not an 8-bit grey image");
    for (size_t i = 0; i < (size_t)by->width * by->height; i++)
        if (is_tissue(tissue, i) && !(isfinite(by->value[i]) && isfinite(density->value[i])))
            return gsn_fail(err, GSN_E_INPUT, "the density of pixel (%zu, %zu) is not a number",
                            i % by->width, i / by->width);
    return GSN_OK;
}

static int otsu_of_tissue(const struct gsn_plane *by, const struct gsn_image *tissue, size_t count,
                          double *ret_threshold, struct gsn_error *err)
{
    gsn_auto_mem(float) values = gsn_alloc_array(count, sizeof *values);
    size_t n = 0;

    if (!values)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a threshold");
    for (size_t i = 0; i < (size_t)by->width * by->height; i++)
        if (is_tissue(tissue, i))
            values[n++] = by->value[i];
    *ret_threshold = gsn_otsu(values, n);
    return GSN_OK;
}

static void fill_map(const struct gsn_plane *by, const struct gsn_plane *density,
                     const struct gsn_image *tissue, uint8_t *map, struct gsn_collagen *figures)
{
    double sum = 0, sum_inside = 0;

    for (size_t i = 0; i < (size_t)by->width * by->height; i++) {
        if (!is_tissue(tissue, i))
            continue;
        sum += density->value[i];
        if (!(by->value[i] > figures->threshold))
            continue;
        map[i] = 255;
        figures->collagen_px++;
        sum_inside += density->value[i];
    }
    figures->area_fraction = (double)figures->collagen_px / (double)figures->tissue_px;
    figures->mean_density = sum / (double)figures->tissue_px;
    figures->mean_inside =
        figures->collagen_px ? sum_inside / (double)figures->collagen_px : (double)NAN;
}

int gsn_collagen_map(const struct gsn_plane *by, const struct gsn_plane *density,
                     const struct gsn_image *tissue, double threshold, struct gsn_image **ret_map,
                     struct gsn_collagen *ret_figures, struct gsn_error *err)
{
    struct gsn_collagen figures = { .threshold = threshold };
    gsn_auto(gsn_image) map = NULL;
    int r = check_planes(by, density, tissue, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < (size_t)by->width * by->height; i++)
        figures.tissue_px += (size_t)is_tissue(tissue, i);
    if (figures.tissue_px == 0)
        return gsn_fail(err, GSN_E_STAIN, "there is no tissue in this picture");
    if (isnan(threshold))
        r = otsu_of_tissue(by, tissue, figures.tissue_px, &figures.threshold, err);
    if (r >= 0)
        r = gsn_image_new(by->width, by->height, 1, 8, &map, err);
    if (r < 0)
        return r;

    fill_map(by, density, tissue, map->samples, &figures);
    *ret_map = gsn_steal(&map);
    *ret_figures = figures;
    return GSN_OK;
}

static int is_set(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    const unsigned half = image->bits == 8 ? 128 : 32768;

    return gsn_image_at(image, x, y, image->channels == 3 ? 1 : 0) >= half;
}

int gsn_collagen_compare(const struct gsn_image *map, const struct gsn_image *reference,
                         struct gsn_overlap *ret_overlap, struct gsn_error *err)
{
    struct gsn_overlap overlap = { .pixels = (size_t)map->width * map->height };

    if (map->width != reference->width || map->height != reference->height)
        return gsn_fail(err, GSN_E_INPUT, "the mask is of %u x %u pixels, the picture of %u x %u",
                        reference->width, reference->height, map->width, map->height);
    for (uint32_t y = 0; y < map->height; y++) {
        for (uint32_t x = 0; x < map->width; x++) {
            const int ours = is_set(map, x, y), theirs = is_set(reference, x, y);

            overlap.map_px += (size_t)ours;
            overlap.reference_px += (size_t)theirs;
            overlap.both_px += (size_t)(ours && theirs);
        }
    }

    const double a = (double)overlap.map_px, b = (double)overlap.reference_px,
                 both = (double)overlap.both_px;

    overlap.dice = a + b > 0 ? 2 * both / (a + b) : 1;
    overlap.false_positive = a > 0 ? (a - both) / a : 0;
    overlap.false_negative = b > 0 ? (b - both) / b : 0;
    *ret_overlap = overlap;
    return GSN_OK;
}
