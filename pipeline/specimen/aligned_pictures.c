/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sections as they lie in the block, small.
 *
 * 1. The frame is a square around the middle of the placed sections, ROOM times as wide as the
 *    typical one; the more sections, the fewer pixels it has, so that all of them together weigh
 *    what a page can carry.
 * 2. Panels are opened one after the other: as each passes, its placed sections are resampled
 *    between their pixels, so that a picture errs by less than a tenth of its own pixel.
 * 3. At the end all are coded as JPEG of one quality, the best whose sum is small enough.
 *
 * Failure: memory. Cost: some 4 MB for each million pixels kept; coding once for each quality. */
#include "pipeline/specimen/aligned_pictures.h"

#include "pipeline/core/mem.h"
#include "pipeline/decode/jpeg_write.h"
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

struct gsn_aligned_pictures {
    struct gsn_point corner;
    double um_per_px;
    unsigned side_px;
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
        const double fit = sqrt(GSN_ALIGNED_BYTES / BYTES_PER_PX / (double)shown);

        pictures->side_px = (unsigned)fmin(fmax(fit, LEAST_PX), MOST_PX) & ~7U;
        pictures->um_per_px = side / pictures->side_px;
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

int gsn_aligned_pictures_look(struct gsn_aligned_pictures *pictures, const struct gsn_poses *poses,
                              const struct gsn_scan *scan, unsigned panel, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; pictures && r >= 0 && i < pictures->count; i++) {
        const struct gsn_section *s = &poses->section[i];
        const struct gsn_placed_box box = { .panel_to_block_um = s->pose.panel_to_block_um,
                                            .x = s->seen.x,
                                            .y = s->seen.y,
                                            .width = s->seen.width,
                                            .height = s->seen.height };

        if (s->panel == panel && is_shown(s) && !pictures->laid[i])
            r = gsn_placed_picture(scan->picture->image, scan->glass.light, &box, pictures->corner,
                                   pictures->um_per_px, pictures->side_px, &pictures->laid[i], err);
    }
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
    return GSN_OK;
}
