/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Codes of sRGB and light, both 0..1 (IEC 61966-2-1). Beyond that the curves go on. */
#ifndef GSN_CORE_SRGB_H
#define GSN_CORE_SRGB_H

#include <math.h>

static inline double gsn_light_of_srgb(double code)
{
    return code <= 0.04045 ? code / 12.92 : pow((code + 0.055) / 1.055, 2.4);
}

static inline double gsn_srgb_of_light(double light)
{
    return light <= 0.0031308 ? 12.92 * light : 1.055 * pow(light, 1 / 2.4) - 0.055;
}

#endif
