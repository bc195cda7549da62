/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/segment.h"

#include <math.h>

#include "pipeline/imaging/threshold.h"

enum { STEPS = 512 };

double gsn_otsu(const float *values, size_t count)
{
    size_t bin[STEPS] = { 0 };
    double low, high;

    if (count == 0)
        return NAN;
    low = high = values[0];
    for (size_t i = 1; i < count; i++) {
        low = fmin(low, values[i]);
        high = fmax(high, values[i]);
    }
    if (!(high > low))
        return low;
    for (size_t i = 0; i < count; i++) {
        const size_t at = (size_t)((values[i] - low) / (high - low) * STEPS);

        bin[at < STEPS ? at : STEPS - 1]++;
    }
    return low + (high - low) * (double)gsn_otsu_cut(bin, STEPS, NULL) / STEPS;
}

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

static void fill(const struct gsn_plane *by, const struct gsn_plane *density,
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

    fill(by, density, tissue, map->samples, &figures);
    *ret_map = gsn_steal(&map);
    *ret_figures = figures;
    return GSN_OK;
}

static int is_set(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    const unsigned half = image->bits == 8 ? 128 : 32768;

    return gsn_image_at(image, x, y, image->channels == 3 ? 1 : 0) >= half;
}

int gsn_mask_compare(const struct gsn_image *map, const struct gsn_image *reference,
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
