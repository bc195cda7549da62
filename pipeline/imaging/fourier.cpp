/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* cv::dft: mixed radix 2, 3, 4, 5 and a plain sum for other factors (Cooley and Tukey 1965), rows
 * and then columns, in single precision. */
#include "pipeline/imaging/fourier.h"

#include "pipeline/imaging/opencv.hpp"

int gsn_fourier(float *numbers, uint32_t width, uint32_t height, int back, struct gsn_error *err)
{
    return gsn::guarded(err, [&] {
        cv::Mat all = gsn::over(numbers, width, height, CV_32FC2);

        cv::dft(all, all, back ? cv::DFT_INVERSE : 0);
    });
}
