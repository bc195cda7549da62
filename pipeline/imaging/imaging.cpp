/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* OpenCV made ready, once in the process (std::call_once): it prints nothing, starts no threads,
 * and has run one small operation, which loads what it would load later. Failure: none here; a call
 * that matters fails in its own name. */
#include "pipeline/imaging/imaging.h"

#include <mutex>

#include "pipeline/imaging/opencv.hpp"

/* OpenCV prints what it throws unless somebody listens. */
static int keep_quiet(int, const char *, const char *, const char *, int, void *)
{
    return 0;
}

static void prepare_opencv()
{
    cv::redirectError(keep_quiet);
    cv::setNumThreads(1);
    try {
        const cv::Mat square = cv::Mat::ones(8, 8, CV_8U);
        cv::Mat grown;

        cv::dilate(square, grown, cv::Mat::ones(3, 3, CV_8U));
    } catch (...) {
        /* The call that is meant fails in its own name. */
    }
}

void gsn_imaging_open(void)
{
    static std::once_flag once;

    std::call_once(once, prepare_opencv);
}

const char *gsn_imaging_version(void)
{
    static const cv::String version = cv::getVersionString();

    return version.c_str();
}
