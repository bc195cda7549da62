/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/pixel_format.h"

#include <string.h>

/* libcamera names a layout as DRM does, from the high byte of a little-endian word: its BGR888 has
 * the bytes R, G, B. V4L2 and libcamera agree about the letters of Bayer patterns: first row first.
 */
static const struct gsn_pixel_format formats[] = {
    { "YUYV", "YUYV", GSN_PACKING_BYTES, 2, 8, "YUYV", 0, 2 },
    { "UYVY", "UYVY", GSN_PACKING_BYTES, 2, 8, "UYVY", 1, 2 },
    { "NV12", "NV12", GSN_PACKING_NV12, 1, 8, "NV12", 0, 1 },
    { "RGB3", "BGR888", GSN_PACKING_BYTES, 3, 8, "RGB", 1, 3 },
    { "BGR3", "RGB888", GSN_PACKING_BYTES, 3, 8, "BGR", 1, 3 },
    { "GREY", "R8", GSN_PACKING_BYTES, 1, 8, "GRAYSCALE", 0, 1 },
    { "Y10 ", "R10", GSN_PACKING_WORDS, 1, 10, "GRAYSCALE", 0, 0 },
    { "Y12 ", "R12", GSN_PACKING_WORDS, 1, 12, "GRAYSCALE", 0, 0 },
    { "Y16 ", "R16", GSN_PACKING_WORDS, 1, 16, "GRAYSCALE", 0, 0 },
    { "BA81", "SBGGR8", GSN_PACKING_BYTES, 1, 8, "BAYER_BGGR", 0, 1 },
    { "GBRG", "SGBRG8", GSN_PACKING_BYTES, 1, 8, "BAYER_GBRG", 0, 1 },
    { "GRBG", "SGRBG8", GSN_PACKING_BYTES, 1, 8, "BAYER_GRBG", 0, 1 },
    { "RGGB", "SRGGB8", GSN_PACKING_BYTES, 1, 8, "BAYER_RGGB", 0, 1 },
    { "BG10", "SBGGR10", GSN_PACKING_WORDS, 1, 10, "BAYER_BGGR", 0, 0 },
    { "GB10", "SGBRG10", GSN_PACKING_WORDS, 1, 10, "BAYER_GBRG", 0, 0 },
    { "BA10", "SGRBG10", GSN_PACKING_WORDS, 1, 10, "BAYER_GRBG", 0, 0 },
    { "RG10", "SRGGB10", GSN_PACKING_WORDS, 1, 10, "BAYER_RGGB", 0, 0 },
    { "BG12", "SBGGR12", GSN_PACKING_WORDS, 1, 12, "BAYER_BGGR", 0, 0 },
    { "GB12", "SGBRG12", GSN_PACKING_WORDS, 1, 12, "BAYER_GBRG", 0, 0 },
    { "BA12", "SGRBG12", GSN_PACKING_WORDS, 1, 12, "BAYER_GRBG", 0, 0 },
    { "RG12", "SRGGB12", GSN_PACKING_WORDS, 1, 12, "BAYER_RGGB", 0, 0 },
    { "BYR2", "SBGGR16", GSN_PACKING_WORDS, 1, 16, "BAYER_BGGR", 0, 0 },
    { "GB16", "SGBRG16", GSN_PACKING_WORDS, 1, 16, "BAYER_GBRG", 0, 0 },
    { "GR16", "SGRBG16", GSN_PACKING_WORDS, 1, 16, "BAYER_GRBG", 0, 0 },
    { "RG16", "SRGGB16", GSN_PACKING_WORDS, 1, 16, "BAYER_RGGB", 0, 0 },
    { "pBAA", "SBGGR10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_BGGR", 0, 0 },
    { "pGAA", "SGBRG10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_GBRG", 0, 0 },
    { "pgAA", "SGRBG10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_GRBG", 0, 0 },
    { "pRAA", "SRGGB10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_RGGB", 0, 0 },
    { "pBCC", "SBGGR12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_BGGR", 0, 0 },
    { "pGCC", "SGBRG12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_GBRG", 0, 0 },
    { "pgCC", "SGRBG12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_GRBG", 0, 0 },
    { "pRCC", "SRGGB12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_RGGB", 0, 0 },
    { "MJPG", "MJPEG", GSN_PACKING_JPEG, 0, 8, "", 0, 0 },
};

enum { COUNT = sizeof formats / sizeof formats[0] };

uint32_t gsn_pixel_format_code(const struct gsn_pixel_format *format)
{
    uint32_t code = 0;

    for (unsigned i = 0; i < 4; i++)
        code |= (uint32_t)(unsigned char)format->fourcc[i] << 8 * i;
    return code;
}

const struct gsn_pixel_format *gsn_pixel_format_v4l2(uint32_t fourcc)
{
    for (size_t i = 0; i < COUNT; i++) {
        if (gsn_pixel_format_code(&formats[i]) == fourcc)
            return &formats[i];
    }
    return NULL;
}

const struct gsn_pixel_format *gsn_pixel_format_libcamera(const char *name)
{
    for (size_t i = 0; i < COUNT; i++) {
        if (strcmp(formats[i].libcamera, name) == 0)
            return &formats[i];
    }
    return NULL;
}

const struct gsn_pixel_format *gsn_pixel_format_named(const char *fourcc)
{
    const size_t length = strlen(fourcc);

    for (size_t i = 0; i < COUNT; i++) {
        const char *const rest = formats[i].fourcc + length;

        if (length > 0 && length <= 4 && memcmp(formats[i].fourcc, fourcc, length) == 0 &&
            strspn(rest, " ") == strlen(rest))
            return &formats[i];
    }
    return NULL;
}

const char *gsn_pixel_format_list(void)
{
    return "YUYV, UYVY, NV12, RGB3, BGR3, GREY, Y10, Y12, Y16, MJPG, raw Bayer of 8, 10, 12 or 16 "
           "bit (BA81, BG10, RG12, ...; pRAA, pRCC, ... packed)";
}

int gsn_pixel_format_is_yuv(const struct gsn_pixel_format *format)
{
    return format->packing == GSN_PACKING_NV12 || strstr(format->tupltype, "YUY") != NULL ||
           strstr(format->tupltype, "UYVY") != NULL;
}

int gsn_pixel_format_is_raw(const struct gsn_pixel_format *format)
{
    return strncmp(format->tupltype, "BAYER", 5) == 0 || strcmp(format->tupltype, "GRAYSCALE") == 0;
}

uint64_t gsn_pixel_format_row(const struct gsn_pixel_format *format, uint32_t width)
{
    switch (format->packing) {
    case GSN_PACKING_BYTES:
        return (uint64_t)width * format->depth;
    case GSN_PACKING_WORDS:
        return (uint64_t)width * 2;
    case GSN_PACKING_CSI10:
        return ((uint64_t)width * 5 + 3) / 4;
    case GSN_PACKING_CSI12:
        return ((uint64_t)width * 3 + 1) / 2;
    case GSN_PACKING_NV12:
        return width;
    default:
        return 0;
    }
}
