/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How OpenCV is called. Private to pipeline/imaging, the one door to it: core and imgproc alone.
 *
 * A cv::Mat is a header over memory of ours; an answer is written into our memory, never copied.
 * Nothing is thrown past a function of ours: what OpenCV throws becomes a code and its sentence. */
#ifndef GSN_IMAGING_OPENCV_HPP
#define GSN_IMAGING_OPENCV_HPP

#include <new>

#include <opencv2/core.hpp>
#include <opencv2/imgproc.hpp>

#include "pipeline/core/error.h"
#include "pipeline/imaging/imaging.h"

namespace gsn
{

/* Runs a body that calls OpenCV. */
template <class Body> int guarded(struct gsn_error *err, Body body) noexcept
{
    gsn_imaging_open();
    try {
        body();
        return GSN_OK;
    } catch (const cv::Exception &e) {
        return e.code == cv::Error::StsNoMem
                   ? gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture")
                   : gsn_fail(err, GSN_E_INPUT, "OpenCV: %s in %s", e.err.c_str(), e.func.c_str());
    } catch (const std::bad_alloc &) {
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture");
    } catch (...) {
        return gsn_fail(err, GSN_E_INPUT, "OpenCV failed without a reason");
    }
}

/* A header over rows that follow each other without padding. */
template <class Sample>
cv::Mat over(const Sample *samples, size_t width, size_t height, int type)
{
    return cv::Mat(static_cast<int>(height), static_cast<int>(width), type,
                   const_cast<Sample *>(samples));
}

} // namespace gsn

#endif
