/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* cv::boxFilter adds up in double precision (running sums, Crow 1984), with zeros beyond the
 * border; for a mean each sum is then divided by the number of pixels that there are. Halving is
 * cv::resize by area. */
#include "pipeline/imaging/filter.h"

#include <algorithm>

#include "pipeline/imaging/opencv.hpp"

/* How many of the 2 r + 1 places about i lie on a line of n. */
static uint32_t count_places(uint32_t i, uint32_t n, uint32_t r)
{
    return std::min(i, r) + 1 + std::min(n - 1 - i, r);
}

int gsn_box_sum(const float *from, uint32_t width, uint32_t height, uint32_t radius, float *to,
                struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        const int side = 2 * static_cast<int>(radius) + 1;
        cv::Mat sums = gsn::over(to, width, height, CV_32F);

        cv::boxFilter(gsn::over(from, width, height, CV_32F), sums, CV_32F, cv::Size(side, side),
                      cv::Point(-1, -1), false, cv::BORDER_CONSTANT);
    });
}

/* A power of two as scale is exact, with fused multiply-adds as without. */
int gsn_differences(const float *from, uint32_t width, uint32_t height, double scale, float *dx,
                    float *dy, struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        const cv::Mat all = gsn::over(from, width, height, CV_32F);
        cv::Mat across = gsn::over(dx, width, height, CV_32F);
        cv::Mat down = gsn::over(dy, width, height, CV_32F);

        cv::Sobel(all, across, CV_32F, 1, 0, 1, scale, 0, cv::BORDER_REPLICATE);
        cv::Sobel(all, down, CV_32F, 0, 1, 1, scale, 0, cv::BORDER_REPLICATE);
    });
}

int gsn_median_3(uint8_t *bytes, uint32_t width, uint32_t height, struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        cv::Mat all = gsn::over(bytes, width, height, CV_8U);

        cv::medianBlur(all, all, 3);
    });
}

int gsn_halve(const float *from, uint32_t width, uint32_t height, float *to, struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        const int w = static_cast<int>(width / 2), h = static_cast<int>(height / 2);
        cv::Mat half = gsn::over(to, width / 2, height / 2, CV_32F);

        cv::resize(gsn::over(from, width, height, CV_32F)(cv::Rect(0, 0, 2 * w, 2 * h)), half,
                   half.size(), 0, 0, cv::INTER_AREA);
    });
}

int gsn_box_mean(const struct gsn_plane *plane, uint32_t radius, struct gsn_plane **ret_mean,
                 struct gsn_error *err)
{
    struct gsn_plane *mean = nullptr;
    int r = gsn_plane_new(plane->width, plane->height, &mean, err);

    if (r < 0)
        return r;
    r = gsn_box_sum(plane->value, plane->width, plane->height, radius, mean->value, err);
    if (r < 0) {
        gsn_plane_free(mean);
        return r;
    }
    for (uint32_t y = 0; y < plane->height; y++)
        for (uint32_t x = 0; x < plane->width; x++)
            mean->value[static_cast<size_t>(y) * plane->width + x] /= static_cast<float>(
                count_places(x, plane->width, radius) * count_places(y, plane->height, radius));
    *ret_mean = mean;
    return GSN_OK;
}
