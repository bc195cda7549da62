/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The delivery: files of a plan, and each file from its picture.
 *
 * Steps: (1) one file a panel, in order; at the awkward level roles (missing, cut short, turned, 16
 * bits, a wrong resolution) and order are dealt out by a shuffle (Fisher and Yates); (2) a picture
 * is turned the way that it is stored (EXIF orientation) and, at that level, goes through JPEG
 * twice; (3) the encoder of its extension; (4) what is cut short loses its last bytes.
 *
 * Failure: memory. Cost: that of encoding. */
#include "pipeline/phantom/delivery.h"

#include "pipeline/core/mem.h"
#include "pipeline/phantom/writer.h"

#include <math.h>
#include <string.h>

/* What programs state that do not know the resolution: 300 dpi. */
static const double USUAL_TAG_UM = 25400.0 / 300;

/* The roles of the panels of an awkward delivery; each panel plays one, the first of them when
 * there are fewer panels, and none of them as ROLES and beyond. */
enum role { MISSING, CUT, TURNED, DEEP, WRONG_TAG, ROLES };

static struct gsn_phantom_file deliver_plain(const struct gsn_phantom_plan *plan, int panel)
{
    return (struct gsn_phantom_file){ .panel = panel,
                                      .orientation = 1,
                                      .bits = 8,
                                      .passes = 1,
                                      .kept = 1,
                                      .tag_um = plan->px_um,
                                      .extension = plan->level.extension };
}

static void shuffle_cards(struct gsn_phantom_random *random, int *card, int count)
{
    for (int i = 0; i < count; i++) {
        const int j = (int)gsn_phantom_below(random, (uint32_t)i + 1);

        card[i] = card[j];
        card[j] = i;
    }
}

static struct gsn_phantom_file in_role(const struct gsn_phantom_plan *plan, int panel,
                                       enum role role, struct gsn_phantom_random *random)
{
    static const int orientation[] = { 3, 6, 8 };
    struct gsn_phantom_file file = deliver_plain(plan, panel);
    const int turned = orientation[gsn_phantom_below(random, 3)];
    const double kept = gsn_phantom_between(random, .35, .85);

    file.passes = 2;
    if (role == CUT)
        file.kept = kept;
    if (role == TURNED)
        file.orientation = turned;
    if (role == WRONG_TAG)
        file.tag_um = USUAL_TAG_UM;
    if (role == DEEP) {
        file.bits = 16;
        file.extension = "tif";
    }
    return file;
}

void gsn_phantom_delivery_draw(struct gsn_phantom_plan *plan)
{
    struct gsn_phantom_random random =
        gsn_phantom_plan_random(plan, GSN_PHANTOM_STREAM_DELIVERY, 0, 0);
    int role[GSN_PHANTOM_PANELS_MOST] = { 0 }, order[GSN_PHANTOM_PANELS_MOST] = { 0 };
    struct gsn_phantom_file again = { 0 };

    plan->files = 0;
    for (int i = 0; i < plan->panels; i++)
        plan->file[plan->files++] = deliver_plain(plan, i + 1);
    if (!plan->level.awkward)
        return;
    shuffle_cards(&random, role, plan->panels);
    shuffle_cards(&random, order, plan->panels);
    plan->files = 0;
    for (int i = 0; i < plan->panels; i++) {
        const int panel = order[i] + 1;

        if (role[order[i]] == MISSING) {
            plan->missing_panel = panel;
            continue;
        }
        plan->file[plan->files++] = in_role(plan, panel, (enum role)role[order[i]], &random);
        if (role[order[i]] == TURNED)
            again = in_role(plan, panel, ROLES, &random);
    }
    again.again = 1;
    plan->file[plan->files++] = again;
}

char *gsn_phantom_delivery_name(const struct gsn_phantom_plan *plan, int i)
{
    const struct gsn_phantom_file *file = &plan->file[i];

    if (plan->level.awkward)
        return gsn_format("%02d-" GSN_PHANTOM_STUDY "-%s-P%02d.%s", i + 1, plan->specimen.name,
                          file->panel, file->extension);
    return gsn_format(GSN_PHANTOM_STUDY "-%s-P%02d.%s", plan->specimen.name, file->panel,
                      file->extension);
}

/* Where the pixel in this row and column of the stored picture lies in the upright one (EXIF 2.3,
 * 4.6.4 A: what the first row and column of each orientation are). */
static size_t find_upright(const struct gsn_image *image, int orientation, uint32_t row,
                           uint32_t column)
{
    const uint32_t right = image->width - 1, low = image->height - 1;

    if (orientation == 3) /* row 0 is the bottom, column 0 the right side */
        return (size_t)(low - row) * image->width + (right - column);
    if (orientation == 6) /* row 0 is the right side, column 0 the top */
        return (size_t)column * image->width + (right - row);
    return (size_t)(low - column) * image->width + row; /* 8: the left side, the bottom */
}

static int turn_image(const struct gsn_image *image, int orientation, struct gsn_image **ret_image,
                      struct gsn_error *err)
{
    const int lying = orientation != 3;
    gsn_auto(gsn_image) turned = NULL;
    const int r = gsn_image_new(lying ? image->height : image->width,
                                lying ? image->width : image->height, 3, 8, &turned, err);

    if (r < 0)
        return r;
    for (uint32_t y = 0; y < turned->height; y++)
        for (uint32_t x = 0; x < turned->width; x++)
            memcpy((uint8_t *)turned->samples + 3 * ((size_t)y * turned->width + x),
                   (const uint8_t *)image->samples + 3 * find_upright(image, orientation, y, x), 3);
    *ret_image = gsn_steal(&turned);
    return GSN_OK;
}

static int encode_jpeg(const struct gsn_phantom_file *file, int quality,
                       const struct gsn_image *image, struct gsn_phantom_buffer *ret_file,
                       struct gsn_error *err)
{
    gsn_auto(gsn_image) turned = NULL;
    gsn_auto(gsn_image) lossy = NULL;
    int r = GSN_OK;

    if (file->orientation != 1)
        r = turn_image(image, file->orientation, &turned, err);
    if (r >= 0 && file->passes > 1)
        r = gsn_phantom_jpeg_lossy(turned ? turned : image, quality, &lossy, err);
    if (r < 0)
        return r;
    image = lossy ? lossy : turned ? turned : image;
    return gsn_phantom_jpeg(image, file->tag_um, quality, file->orientation, ret_file, err);
}

int gsn_phantom_delivery_encode(const struct gsn_phantom_plan *plan,
                                const struct gsn_phantom_file *file, const struct gsn_image *image,
                                struct gsn_phantom_buffer *ret_file, struct gsn_error *err)
{
    int r;

    if (strcmp(file->extension, "jpg") == 0)
        r = encode_jpeg(file, plan->level.quality, image, ret_file, err);
    else if (strcmp(file->extension, "png") == 0)
        r = gsn_phantom_png(image, file->tag_um, ret_file, err);
    else
        r = gsn_phantom_tiff(image, file->tag_um, ret_file, err);
    if (r < 0)
        return r;
    ret_file->size = (size_t)(file->kept * (double)ret_file->size);
    return GSN_OK;
}
