/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sections as they lie in the block, small for the report and large for the page beside it.
 *
 * 1. The frame is a square around the middle of the placed sections, ROOM times as wide as the
 *    typical one; the more sections, the fewer pixels it has, so that all of them together weigh
 *    what a page can carry. A large picture has no more pixels than the scan.
 * 2. Panels are opened one after the other: as each passes, its placed sections are resampled
 *    between their pixels, so that a picture errs by less than a tenth of its own pixel. The large
 *    ones are coded at once as JPEG, one section after the other on each thread.
 * 3. What is not measured, once it is known: the first reason at the middle of each pixel.
 * 4. At the end the small ones are coded as JPEG of one quality, the best whose sum is small
 *    enough.
 *
 * Failure: memory. Cost: some 4 MB for each million small pixels kept, which are coded once for
 * each quality; the large ones are laid and coded once. */
#include "pipeline/specimen/aligned_pictures.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/parallel.h"
#include "pipeline/decode/jpeg_write.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/specimen/quality_control.h"
#include "pipeline/specimen/section_pictures.h"

#include <math.h>

/* So that the edge of a section that lies askew is still seen. */
static const double ROOM = 1.15;

/* Fewer would show nothing, more need not be carried. */
enum { LEAST_PX = 64, MOST_PX = 384 };

/* Of stained tissue as JPEG of quality 70 (48 sections of the phantom: 0.150), to choose how many
 * pixels there are. */
static const double BYTES_PER_PX = 0.16;

/* The last one takes half of the third's bytes. */
static const int QUALITIES[] = { 90, 80, 70, 60, 50, 40, 30 };

/* Of the large ones; their masks have a third of the pixels along a side, for they are broader. */
enum { GLASS_PX = 1200, GLASS_QUALITY = 75, PER_MASK = 3 };

struct gsn_aligned_pictures {
    struct gsn_point corner;
    double um_per_px, glass_um_per_px;
    unsigned side_px, glass_px;
    size_t count;
    struct gsn_image *
        *laid; /* owned; of each section, NULL: not shown, or its panel did not come */
};

/* Those in the model, whether or not a person should look at them: here it is that one looks. */
static int is_shown(const struct gsn_section *s)
{
    return s->posed && !s->pose.gross &&
           (s->state == GSN_SECTION_USED || s->state == GSN_SECTION_DOUBTFUL);
}

/* Micrometres of the finest pixels that any shown section was scanned with. */
static double finest_um(const struct gsn_poses *poses)
{
    double finest = INFINITY;

    for (size_t i = 0; i < poses->section_count; i++)
        if (is_shown(&poses->section[i]))
            finest =
                fmin(finest, sqrt(fabs(gsn_affine_det(&poses->section[i].pose.panel_to_block_um))));
    return finest;
}

/* Pixels along a side of each of so many square pictures that weigh so many bytes together. */
static unsigned side_of(double bytes, size_t count, double most)
{
    return (unsigned)fmin(fmax(sqrt(bytes / BYTES_PER_PX / (double)count), LEAST_PX), most) & ~7U;
}

int gsn_aligned_pictures_new(const struct gsn_poses *poses,
                             struct gsn_aligned_pictures **ret_pictures, struct gsn_error *err)
{
    gsn_auto(gsn_aligned_pictures) pictures = gsn_alloc_array(1, sizeof *pictures);
    size_t shown = 0;
    double side = 0;
    int r = GSN_OK;

    if (pictures)
        pictures->laid = gsn_alloc_array(poses->section_count, sizeof *pictures->laid);
    if (!pictures || !pictures->laid)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the aligned sections' pictures");
    pictures->count = poses->section_count;
    for (size_t i = 0; i < poses->section_count; i++)
        shown += is_shown(&poses->section[i]) != 0;
    if (poses->solved && shown >= 2)
        r = gsn_placed_frame(poses, ROOM, &pictures->corner, &side, err);
    if (r < 0)
        return r;
    if (side > 0) {
        const double scanned = fmax(side / finest_um(poses), LEAST_PX);

        pictures->side_px = side_of(GSN_ALIGNED_BYTES, shown, MOST_PX);
        pictures->um_per_px = side / pictures->side_px;
        pictures->glass_px = side_of(GSN_GLASS_BYTES, shown, fmin(scanned, GLASS_PX));
        pictures->glass_um_per_px = side / pictures->glass_px;
    }
    *ret_pictures = side > 0 ? gsn_steal(&pictures) : NULL;
    return GSN_OK;
}

void gsn_aligned_pictures_free(struct gsn_aligned_pictures *pictures)
{
    if (!pictures)
        return;
    for (size_t i = 0; pictures->laid && i < pictures->count; i++)
        gsn_image_free(pictures->laid[i]);
    gsn_free(pictures->laid);
    gsn_free(pictures);
}

/* A panel while its sections are laid. */
struct looking {
    struct gsn_aligned_pictures *pictures;
    const struct gsn_poses *poses;
    const struct gsn_scan *scan;
    struct gsn_densities *densities;
    unsigned panel;
};

static int lay_section(size_t i, void *context, struct gsn_error *err)
{
    static const struct gsn_jpeg_style style = { .quality = GLASS_QUALITY, .smallest = 1 };
    const struct looking *look = context;
    struct gsn_aligned_pictures *const pictures = look->pictures;
    const struct gsn_section *s = &look->poses->section[i];
    struct gsn_png_picture *const glass = &look->densities->section[i].glass;
    const struct gsn_placed_box box = { .panel_to_block_um = s->pose.panel_to_block_um,
                                        .x = s->seen.x,
                                        .y = s->seen.y,
                                        .width = s->seen.width,
                                        .height = s->seen.height };
    gsn_auto(gsn_image) large = NULL;
    int r;

    if (s->panel != look->panel || !is_shown(s) || pictures->laid[i])
        return GSN_OK;
    r = gsn_placed_picture(look->scan->picture->image, look->scan->glass.light, &box,
                           pictures->corner, pictures->um_per_px, pictures->side_px,
                           &pictures->laid[i], err);
    if (r >= 0)
        r = gsn_placed_picture(look->scan->picture->image, look->scan->glass.light, &box,
                               pictures->corner, pictures->glass_um_per_px, pictures->glass_px,
                               &large, err);
    if (r < 0)
        return r;
    gsn_free(glass->png);
    *glass = (struct gsn_png_picture){ .width = pictures->glass_px, .height = pictures->glass_px };
    return gsn_jpeg_encode(large, &style, &glass->png, &glass->size, err);
}

int gsn_aligned_pictures_look(struct gsn_aligned_pictures *pictures, const struct gsn_poses *poses,
                              const struct gsn_scan *scan, unsigned panel, unsigned threads,
                              struct gsn_densities *densities, struct gsn_error *err)
{
    struct looking look = { pictures, poses, scan, densities, panel };

    return pictures ? gsn_parallel_for(pictures->count, threads, lay_section, &look, err) : GSN_OK;
}

static unsigned mask_px(const struct gsn_aligned_pictures *pictures)
{
    return (pictures->glass_px + PER_MASK - 1) / PER_MASK;
}

static int draw_mask(const struct gsn_aligned_pictures *pictures, const struct gsn_poses *poses,
                     const struct gsn_artefact_labels *labels, size_t i,
                     struct gsn_png_picture *ret_mask, struct gsn_error *err)
{
    const struct gsn_section *s = &poses->section[i];
    const struct gsn_affine to_block = gsn_settled_pose(&s->pose.panel_to_block_um);
    const struct gsn_affine to_px = gsn_affine_inverse(&to_block);
    const size_t section = gsn_masking_index(poses, i);
    const double um_per_px = PER_MASK * pictures->glass_um_per_px;
    const uint32_t side = mask_px(pictures);
    gsn_auto(gsn_image) mask = NULL;
    int r = gsn_image_new(side, side, 1, 8, &mask, err);

    if (r < 0)
        return r;
    for (uint32_t k = 0; k < side * side; k++) {
        const struct gsn_point um = { pictures->corner.x + (k % side + 0.5) * um_per_px,
                                      pictures->corner.y + (k / side + 0.5) * um_per_px };
        const struct gsn_point px = gsn_affine_apply(&to_px, um);
        unsigned label, reason = 0;

        if (!(px.x >= s->seen.x && px.y >= s->seen.y && px.x < s->seen.x + s->seen.width &&
              px.y < s->seen.y + s->seen.height))
            continue;
        label = gsn_artefact_label(labels, section, (int)px.x, (int)px.y);
        while (label && !(label >> reason & 1U))
            reason++;
        ((uint8_t *)mask->samples)[k] = (uint8_t)(label ? 1 + reason : 0);
    }
    gsn_free(ret_mask->png);
    *ret_mask = (struct gsn_png_picture){ .width = side, .height = side };
    return gsn_png_encode(mask, &ret_mask->png, &ret_mask->size, err);
}

int gsn_aligned_pictures_mask(const struct gsn_aligned_pictures *pictures,
                              const struct gsn_poses *poses,
                              const struct gsn_artefact_labels *labels, unsigned panel,
                              struct gsn_densities *densities, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; pictures && r >= 0 && i < pictures->count; i++)
        if (poses->section[i].panel == panel && is_shown(&poses->section[i]))
            r = draw_mask(pictures, poses, labels, i, &densities->section[i].masked_map, err);
    return r;
}

/* Codes all of them anew; their bytes together. */
static int code_all(const struct gsn_aligned_pictures *pictures, int quality,
                    struct gsn_densities *densities, size_t *ret_bytes, struct gsn_error *err)
{
    const struct gsn_jpeg_style style = { .quality = quality, .smallest = 1 };
    size_t sum = 0;

    for (size_t i = 0; i < pictures->count; i++) {
        struct gsn_png_picture *const coded = &densities->section[i].aligned;
        int r;

        if (!pictures->laid[i])
            continue;
        gsn_free(coded->png);
        *coded =
            (struct gsn_png_picture){ .width = pictures->side_px, .height = pictures->side_px };
        r = gsn_jpeg_encode(pictures->laid[i], &style, &coded->png, &coded->size, err);
        if (r < 0)
            return r;
        sum += coded->size;
    }
    *ret_bytes = sum;
    return GSN_OK;
}

int gsn_aligned_pictures_code(const struct gsn_aligned_pictures *pictures,
                              struct gsn_densities *densities, struct gsn_error *err)
{
    size_t bytes = GSN_ALIGNED_BYTES + 1;
    int r = GSN_OK;

    if (!pictures)
        return GSN_OK;
    for (size_t i = 0;
         r >= 0 && bytes > GSN_ALIGNED_BYTES && i < sizeof QUALITIES / sizeof *QUALITIES; i++)
        r = code_all(pictures, QUALITIES[i], densities, &bytes, err);
    if (r < 0)
        return r;
    densities->aligned_corner = pictures->corner;
    densities->aligned_um_per_px = pictures->um_per_px;
    densities->glass_um_per_px = pictures->glass_um_per_px;
    densities->masked_um_per_px = PER_MASK * pictures->glass_um_per_px;
    return GSN_OK;
}
