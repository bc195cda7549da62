/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One picture of stained tissue without sections: its collagen map, and its mean density.
 *
 * 1. Dyes are unmixed (stain/unmixing.h). The share of red among them decides what is collagen:
 * unlike the density it depends neither on thickness nor on how strongly the slide was stained.
 * 2. Where the job names a mask, the map is compared with it (Dice, false positives and negatives).
 * 3. The mean density in cells of 4 x 4 pixels: codes are averaged before the logarithm, so what a
 *    JPEG blurs stays out. What the mean moves by in cells twice as large is what finer detail may
 *    still do to it.
 * 4. Amounts of dye by least squares (Ruifrok and Johnston 2001), with vectors as uncertain as
 * their table says (stain/error_propagation.h).
 *
 * How strongly the slide was stained no picture tells by itself. It multiplies all three dyes
 * alike, so the share of the red one is free of it. One pass over the picture, four over its cells.
 */
#include "pipeline/specimen/tile.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/render/canvas.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/flat_field.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { CELL = 4 };

/* ---- the mean ---------------------------------------------------------------------------- */

/* Optical density in cells, and which of them are tissue. */
struct looked {
    struct gsn_plane *od[3];
    struct gsn_image *tissue;
};

static void looked_done(struct looked *looked)
{
    for (size_t c = 0; c < 3; c++)
        gsn_plane_free(looked->od[c]);
    gsn_image_free(looked->tissue);
}
#define looked_auto __attribute__((cleanup(looked_done))) struct looked

static int look_in_cells(const struct gsn_image *image, const struct gsn_flat_field *glass,
                         uint32_t side, struct looked *looked, struct gsn_error *err)
{
    struct gsn_flat_field same = *glass; /* in parts of the picture, so it fits at any size */
    gsn_auto(gsn_image) cells = NULL;
    gsn_auto(gsn_plane) total = NULL;
    double least;
    int r = gsn_scan_cells(image, side, &cells, err);

    if (r < 0)
        return r;
    same.width = cells->width;
    same.height = cells->height;
    r = gsn_od_thin(cells, &same, 1, looked->od, err);
    if (r >= 0)
        r = gsn_od_tissue(looked->od, &same, &total, &least, err);
    return r < 0 ? r : gsn_plane_above(total, least, &looked->tissue, err);
}

static int average_dyes(const struct looked *looked, const struct gsn_dyes *dyes,
                        struct gsn_tile_density *density, struct gsn_error *err)
{
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    const int r = gsn_unmix(looked->od, dyes, 1, &red, &yellow, &dark, err);
    double sum[3] = { 0 }, count = 0;

    if (r < 0)
        return r;
    for (size_t i = 0; i < (size_t)red->width * red->height; i++) {
        if (!((const uint8_t *)looked->tissue->samples)[i])
            continue;
        sum[0] += (double)red->value[i] * dyes->full_red_od;
        sum[1] += (double)yellow->value[i];
        sum[2] += (double)dark->value[i];
        count++;
    }
    density->red = sum[0] / count;
    density->yellow = sum[1] / count;
    density->dark = sum[2] / count;
    density->red_share = sum[0] / (sum[0] + sum[1] + sum[2]);
    return GSN_OK;
}

/* The mean alone, in cells of this side, by this white. */
static int mean_otherwise(const struct gsn_image *image, const struct gsn_flat_field *glass,
                          uint32_t side, const struct gsn_dyes *dyes, double *ret_mean,
                          struct gsn_error *err)
{
    struct gsn_collagen_mean red;
    looked_auto looked = { .tissue = NULL };
    int r = look_in_cells(image, glass, side, &looked, err);

    if (r >= 0)
        r = gsn_collagen_mean(looked.od, looked.tissue, dyes, &red, err);
    if (r >= 0)
        *ret_mean = red.mean;
    return r;
}

static double error_by_vectors(const struct gsn_collagen_mean *red, const struct gsn_dyes_fit *fit)
{
    double variance = 0;

    for (size_t i = 0; i < GSN_DYE_ROTATIONS; i++)
        for (size_t j = 0; j < GSN_DYE_ROTATIONS; j++)
            variance += red->by_turn[i] * fit->covariance[i][j] * red->by_turn[j];
    return sqrt(fmax(variance, 0));
}

int gsn_tile_density(const struct gsn_image *image, const struct gsn_flat_field *glass,
                     const struct gsn_flat_field *darker, const struct gsn_dyes_fit *fit,
                     struct gsn_tile_density *ret_density, struct gsn_error *err)
{
    struct gsn_tile_density density = { 0 };
    struct gsn_collagen_mean red;
    looked_auto looked = { .tissue = NULL };
    double coarse = 0, otherwise;
    int r = look_in_cells(image, glass, CELL, &looked, err);

    if (r >= 0)
        r = gsn_collagen_mean(looked.od, looked.tissue, &fit->dyes, &red, err);
    if (r >= 0)
        r = average_dyes(&looked, &fit->dyes, &density, err);
    if (r >= 0)
        r = mean_otherwise(image, glass, 2 * CELL, &fit->dyes, &coarse, err);
    otherwise = red.mean;
    if (r >= 0 && darker)
        r = mean_otherwise(image, darker, CELL, &fit->dyes, &otherwise, err);
    if (r < 0)
        return r;
    density.mean = red.mean;
    density.by_white = fabs(otherwise - red.mean);
    density.by_detail = fabs(coarse - red.mean);
    density.by_vectors = error_by_vectors(&red, fit);
    density.error = hypot(hypot(density.by_white, density.by_detail), density.by_vectors);
    *ret_density = density;
    return GSN_OK;
}

/* ---- the map and its pictures ---------------------------------------------------------------- */

enum { LONGEST_PX = 700 };

static int add_picture(const struct gsn_image *image, enum gsn_light light, const char *id,
                       const char *title, const char *caption, struct gsn_tile *tile,
                       struct gsn_error *err)
{
    static const struct gsn_fiducial none[GSN_FIDUCIALS] = { 0 };
    struct gsn_png_picture *kept = &tile->picture[tile->picture_count];
    const int r = gsn_thumbnail(image, light, 0, 0, (int)image->width, (int)image->height, none,
                                LONGEST_PX, 0, kept, err);

    if (r < 0)
        return r;
    kept->id = id;
    kept->title = title;
    (void)snprintf(kept->caption, sizeof kept->caption, "%s", caption);
    tile->picture_count++;
    return GSN_OK;
}

static int density_picture(const struct gsn_plane *density, struct gsn_tile *tile,
                           struct gsn_error *err)
{
    static const struct gsn_colour black = { 0 };
    gsn_auto(gsn_image) image = NULL;
    const int r = gsn_canvas_new(density->width, density->height, black, &image, err);

    if (r < 0)
        return r;
    for (uint32_t y = 0; y < density->height; y++)
        for (uint32_t x = 0; x < density->width; x++)
            gsn_canvas_put(image, (int)x, (int)y,
                           gsn_colour_of(GSN_MAP_VIRIDIS,
                                         (double)density->value[(size_t)y * density->width + x]));
    return add_picture(image, GSN_LIGHT_SRGB, "density", "Collagen-equivalent density",
                       "Red dye after unmixing, 0 dark to 1 bright.", tile, err);
}

/* White: both maps; red: ours alone; blue: the reference alone; dark: neither. */
static int agreement_picture(const struct gsn_image *map, const struct gsn_image *reference,
                             struct gsn_tile *tile, struct gsn_error *err)
{
    static const struct gsn_colour colours[4] = {
        { 24, 24, 28 }, { 60, 110, 230 }, { 220, 60, 50 }, { 240, 240, 236 }
    };
    const unsigned half = reference && reference->bits == 16 ? 32768 : 128;
    const unsigned channel = reference && reference->channels == 3 ? 1 : 0;
    gsn_auto(gsn_image) image = NULL;
    const int r = gsn_canvas_new(map->width, map->height, colours[0], &image, err);

    if (r < 0)
        return r;
    for (uint32_t y = 0; y < map->height; y++)
        for (uint32_t x = 0; x < map->width; x++) {
            const unsigned ours = gsn_image_at(map, x, y, 0) >= 128 ? 2 : 0;
            const unsigned theirs =
                reference ? gsn_image_at(reference, x, y, channel) >= half : ours / 2;

            gsn_canvas_put(image, (int)x, (int)y, colours[ours | theirs]);
        }
    return add_picture(image, GSN_LIGHT_SRGB, "map", "Collagen map",
                       reference
                           ? "White: both maps; red: this map alone; blue: the reference alone."
                           : "White: collagen.",
                       tile, err);
}

static int compare_reference(const struct gsn_specimen *specimen, struct gsn_decoder *decoder,
                             const struct gsn_image *map, struct gsn_tile *tile,
                             struct gsn_error *err)
{
    gsn_auto_fd mask_fd = -1;
    gsn_auto(gsn_picture) reference = NULL;
    int r;

    if (!specimen->reference_sha256)
        return agreement_picture(map, NULL, tile, err);
    r = specimen->open(specimen->context, specimen->reference_sha256, &mask_fd, err);
    if (r >= 0)
        r = gsn_decode_apart(decoder, mask_fd, NULL, &reference, err);
    if (r >= 0)
        r = gsn_collagen_compare(map, reference->image, &tile->overlap, err);
    if (r < 0)
        return gsn_fail_at(err, "the reference mask");
    tile->compared = 1;
    return agreement_picture(map, reference->image, tile, err);
}

/* The share of red among the dyes decides what is collagen: unlike the density it depends neither
 * on how thick the tissue is nor on how strongly it was stained. */
static int map_collagen(const struct gsn_specimen *specimen,
                        const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                        struct gsn_tile *tile, struct gsn_error *err)
{
    const struct gsn_protocol *protocol = specimen->protocol;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    gsn_auto(gsn_plane) share = NULL;
    gsn_auto(gsn_plane) total = NULL;
    gsn_auto(gsn_image) tissue = NULL;
    gsn_auto(gsn_image) map = NULL;
    double least;
    int r = gsn_unmix(scan->od, &tile->fit.dyes, options->threads, &red, &yellow, &dark, err);

    if (r >= 0)
        r = gsn_red_share(red, yellow, dark, &tile->fit.dyes, &share, err);
    if (r >= 0)
        r = gsn_od_tissue(scan->od, &scan->glass, &total, &least, err);
    if (r >= 0)
        r = gsn_plane_above(total, least, &tissue, err);
    if (r >= 0)
        r = gsn_collagen_map(share, red, tissue,
                             protocol->threshold_count ? protocol->threshold[0] : NAN, &map,
                             &tile->collagen, err);
    if (r >= 0)
        r = density_picture(red, tile, err);
    return r < 0 ? r : compare_reference(specimen, options->decoder, map, tile, err);
}

int gsn_tile_process(const struct gsn_specimen *specimen,
                     const struct gsn_specimen_options *options, struct gsn_tile **ret_tile,
                     struct gsn_error *err)
{
    gsn_auto(gsn_tile) tile = gsn_alloc_array(1, sizeof *tile);
    gsn_auto_fd picture_fd = -1;
    gsn_auto(gsn_scan) scan = NULL;
    int r;

    if (!tile)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a tile");
    gsn_progress_say(options->progress, "unmixing", 0, 1);
    r = specimen->open(specimen->context, specimen->picture_sha256, &picture_fd, err);
    if (r >= 0)
        r = gsn_scan_open(options->decoder, picture_fd, specimen->protocol, NULL, &scan, err);
    if (r >= 0)
        r = gsn_scan_dyes(scan, NULL, specimen->protocol, &tile->fit, err);
    if (r >= 0)
        r = add_picture(scan->picture->image, scan->glass.light, "picture", "The picture",
                        "As scanned.", tile, err);
    if (r >= 0)
        r = map_collagen(specimen, options, scan, tile, err);
    if (r >= 0)
        r = gsn_tile_density(scan->picture->image, &scan->glass,
                             scan->by_palest ? &scan->palest.darker : NULL, &tile->fit,
                             &tile->density, err);
    if (r < 0)
        return r;
    tile->glass = scan->glass;
    tile->px_um = scan->px_um;
    tile->light_assumed = scan->light_assumed;
    tile->by_palest = scan->by_palest;
    tile->palest = scan->palest;
    (void)snprintf(tile->note, sizeof tile->note, "%s", scan->note);
    *ret_tile = gsn_steal(&tile);
    return GSN_OK;
}

void gsn_tile_free(struct gsn_tile *tile)
{
    if (!tile)
        return;
    for (size_t i = 0; i < tile->picture_count; i++)
        gsn_free(tile->picture[i].png);
    gsn_free(tile);
}
