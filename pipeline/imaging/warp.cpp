/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* cv::flip() in place, and cv::rotate() out of a copy: a transposition in blocks that fit the
 * processor's cache, then a mirror. Pixels are moved and never computed with. */
#include "pipeline/imaging/warp.h"

#include "pipeline/core/mem.h"
#include "pipeline/imaging/opencv.hpp"

int gsn_turn_image(struct gsn_image *image, int mirrored, unsigned quarters, struct gsn_error *err)
{
    const int type = CV_MAKETYPE(image->bits == 8 ? CV_8U : CV_16U, image->channels);
    const uint32_t width = image->width, height = image->height;
    void *was = nullptr;
    int r;

    if (quarters % 2 == 1) {
        was = gsn_memdup(image->samples, gsn_image_bytes(image));
        if (!was)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for turning a picture");
    }
    r = gsn::guarded(err, [&] {
        auto *const samples = static_cast<uint8_t *>(image->samples);
        cv::Mat all = gsn::over(was ? static_cast<uint8_t *>(was) : samples, width, height, type);

        if (mirrored)
            cv::flip(all, all, 1);
        if (was) {
            cv::Mat turned = gsn::over(samples, height, width, type);

            cv::rotate(all, turned,
                       quarters == 1 ? cv::ROTATE_90_CLOCKWISE : cv::ROTATE_90_COUNTERCLOCKWISE);
        } else if (quarters == 2) {
            cv::flip(all, all, -1);
        }
    });
    gsn_free(was);
    if (r >= 0 && was) {
        image->width = height;
        image->height = width;
    }
    return r;
}
