/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures and float planes: zeroed memory for them, refused where it overflows, and a sample by
 * its place. */
#include "pipeline/core/image.h"

#include <assert.h>

int gsn_image_new(uint32_t width, uint32_t height, uint32_t channels, uint32_t bits,
                  struct gsn_image **ret_image, struct gsn_error *err)
{
    gsn_auto(gsn_image) image = gsn_alloc_array(1, sizeof *image);

    assert((channels == 1 || channels == 3) && (bits == 8 || bits == 16));
    if (image)
        *image = (struct gsn_image){ .width = width,
                                     .height = height,
                                     .channels = channels,
                                     .bits = bits,
                                     .samples = gsn_alloc_array((size_t)width * height,
                                                                (size_t)channels * bits / 8) };
    if (!image || !image->samples)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an image of %u x %u", width, height);
    *ret_image = gsn_steal(&image);
    return GSN_OK;
}

void gsn_image_free(struct gsn_image *image)
{
    if (!image)
        return;
    gsn_free(image->samples);
    gsn_free(image);
}

unsigned gsn_image_at(const struct gsn_image *image, uint32_t x, uint32_t y, uint32_t channel)
{
    const size_t i = ((size_t)y * image->width + x) * image->channels + channel;

    return image->bits == 8 ? ((const uint8_t *)image->samples)[i]
                            : ((const uint16_t *)image->samples)[i];
}

size_t gsn_image_bytes(const struct gsn_image *image)
{
    return (size_t)image->width * image->height * image->channels * (image->bits / 8);
}

int gsn_plane_new(uint32_t width, uint32_t height, struct gsn_plane **ret_plane,
                  struct gsn_error *err)
{
    gsn_auto(gsn_plane) plane = gsn_alloc_array(1, sizeof *plane);

    if (plane)
        *plane =
            (struct gsn_plane){ .width = width,
                                .height = height,
                                .value = gsn_alloc_array((size_t)width * height, sizeof(float)) };
    if (!plane || !plane->value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a plane of %u x %u", width, height);
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}

void gsn_plane_free(struct gsn_plane *plane)
{
    if (!plane)
        return;
    gsn_free(plane->value);
    gsn_free(plane);
}
