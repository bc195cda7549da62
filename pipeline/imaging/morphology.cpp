/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Binary morphology (Serra 1982) with a disc of a real radius: what lies within the radius of a
 * set, centre to centre. A small disc is a structuring element for cv::dilate and cv::erode; beyond
 * WIDE pixels, where going over all of the disc costs more, the exact distance
 * (cv::distanceTransform, Felzenszwalb and Huttenlocher 2012) is compared with the radius. Both
 * give the same pixels. A signed distance is that of a set less that of what is not in it, half a
 * pixel nearer each. Holes are filled by cv::floodFill from a frame around the set
 * (cv::copyMakeBorder). */
#include "pipeline/imaging/morphology.h"

#include <cmath>

#include "pipeline/imaging/opencv.hpp"

/* Squares of distances are compared as floats: 5 pixels of 3 and 4 are 5 in any unit. */
static cv::Mat disc(double radius)
{
    const int reach = static_cast<int>(std::floor(radius + 1e-6));
    cv::Mat element = cv::Mat::zeros(2 * reach + 1, 2 * reach + 1, CV_8U);

    for (int y = -reach; y <= reach; y++)
        for (int x = -reach; x <= reach; x++)
            element.at<uint8_t>(y + reach, x + reach) =
                static_cast<float>(x * x + y * y) <= static_cast<float>(radius * radius);
    return element;
}

/* Above this many pixels of radius distances are cheaper than discs. */
static const double WIDE = 14;

/* The distance of every pixel to the nearest 0 of a set. */
static cv::Mat distance_to_zero(const cv::Mat &set)
{
    cv::Mat distance;

    cv::distanceTransform(set, distance, cv::DIST_L2, cv::DIST_MASK_PRECISE, CV_32F);
    return distance;
}

int gsn_dilate(uint8_t *set, uint32_t width, uint32_t height, double radius, struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        cv::Mat all = gsn::over(set, width, height, CV_8U);

        if (cv::countNonZero(all) == 0)
            return;
        if (radius >= std::hypot(width, height))
            all.setTo(1);
        else if (radius > WIDE)
            cv::bitwise_and(distance_to_zero(all == 0) <= static_cast<float>(radius), 1, all);
        else
            cv::dilate(all, all, disc(radius));
    });
}

int gsn_erode(uint8_t *set, uint32_t width, uint32_t height, double radius, struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        cv::Mat all = gsn::over(set, width, height, CV_8U);

        if (cv::countNonZero(all) == static_cast<int>(all.total()))
            return;
        if (radius >= std::hypot(width, height))
            all.setTo(0);
        else if (radius > WIDE)
            cv::bitwise_and(distance_to_zero(all) > static_cast<float>(radius), 1, all);
        else
            cv::erode(all, all, disc(radius));
    });
}

int gsn_dilate_values(float *value, uint32_t width, uint32_t height, double radius,
                      struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        cv::Mat all = gsn::over(value, width, height, CV_32F);

        cv::dilate(all, all, disc(radius));
    });
}

int gsn_erode_values(float *value, uint32_t width, uint32_t height, double radius,
                     struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        cv::Mat all = gsn::over(value, width, height, CV_32F);

        cv::erode(all, all, disc(radius));
    });
}

int gsn_fill_holes(uint8_t *set, uint32_t width, uint32_t height, int neighbours,
                   struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        const cv::Mat all = gsn::over(set, width, height, CV_8U);
        cv::Mat framed;

        cv::copyMakeBorder(all, framed, 1, 1, 1, 1, cv::BORDER_CONSTANT, cv::Scalar(0));
        cv::floodFill(framed, cv::Point(0, 0), cv::Scalar(2), nullptr, cv::Scalar(), cv::Scalar(),
                      neighbours);
        for (uint32_t y = 0; y < height; y++) {
            const uint8_t *row = framed.ptr<uint8_t>(static_cast<int>(y) + 1) + 1;

            for (uint32_t x = 0; x < width; x++)
                set[static_cast<size_t>(y) * width + x] = row[x] != 2;
        }
    });
}

int gsn_signed_distance(const uint8_t *set, uint32_t width, uint32_t height, float *to,
                        struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        const cv::Mat all = gsn::over(set, width, height, CV_8U);
        cv::Mat framed, inside, outside;

        cv::copyMakeBorder(all, framed, 1, 1, 1, 1, cv::BORDER_CONSTANT, cv::Scalar(0));
        inside = distance_to_zero(framed);
        outside = distance_to_zero(framed == 0);
        for (uint32_t y = 0; y < height; y++)
            for (uint32_t x = 0; x < width; x++) {
                const int row = static_cast<int>(y) + 1, column = static_cast<int>(x) + 1;
                const float depth = inside.at<float>(row, column);

                to[static_cast<size_t>(y) * width + x] =
                    depth > 0 ? depth - 0.5F : 0.5F - outside.at<float>(row, column);
            }
    });
}
