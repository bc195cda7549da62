/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/v4l2.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>

#include "acquire/text.h"

/* A driver that asks for more than this for one frame is not believed. */
enum { MOST_FRAME_BYTES = 256 << 20 };
/* What a list of formats is cut to. */
enum { MOST_LISTED = 220 };

static void code_text(uint32_t code, char ret_text[5])
{
    for (unsigned i = 0; i < 4; i++) {
        const char c = (char)(code >> 8 * i & 0x7f);

        ret_text[i] = c >= ' ' && c <= '~' ? c : '?';
    }
    ret_text[4] = '\0';
}

static void list_sizes(const struct gsn_v4l2 *v4l2, uint32_t code, struct gsn_text *text)
{
    for (uint32_t i = 0; i < 64 && text->used < MOST_LISTED; i++) {
        struct v4l2_frmsizeenum size = { .index = i, .pixel_format = code };

        if (gsn_v4l2_ioctl(v4l2, VIDIOC_ENUM_FRAMESIZES, &size) < 0)
            return;
        if (size.type == V4L2_FRMSIZE_TYPE_DISCRETE) {
            gsn_text_add(text, " %ux%u", size.discrete.width, size.discrete.height);
            continue;
        }
        gsn_text_add(text, " %ux%u to %ux%u", size.stepwise.min_width, size.stepwise.min_height,
                     size.stepwise.max_width, size.stepwise.max_height);
        return;
    }
}

/* "YUYV 640x480 320x240; MJPG 640x480". */
static void list_formats(const struct gsn_v4l2 *v4l2, struct gsn_text *text)
{
    for (uint32_t i = 0; i < 64 && text->used < MOST_LISTED; i++) {
        struct v4l2_fmtdesc format = { .index = i, .type = V4L2_BUF_TYPE_VIDEO_CAPTURE };
        char code[5];

        if (gsn_v4l2_ioctl(v4l2, VIDIOC_ENUM_FMT, &format) < 0)
            return;
        code_text(format.pixelformat, code);
        gsn_text_add(text, "%s%s", i ? "; " : "", code);
        list_sizes(v4l2, format.pixelformat, text);
    }
}

static int refuse_adjusted(const struct gsn_v4l2 *v4l2, const struct v4l2_pix_format *got,
                           struct gsn_error *err)
{
    const struct gsn_camera_settings *const asked = &v4l2->settings;
    struct gsn_text text = { 0 };
    char code[5];
    int r;

    code_text(got->pixelformat, code);
    list_formats(v4l2, &text);
    r = gsn_fail(err, GSN_E_INPUT,
                 "%.60s: asked for %.4s %ux%u, the camera would give %s %ux%u%s; it has: %.220s",
                 v4l2->device, asked->format->fourcc, asked->width, asked->height, code, got->width,
                 got->height, got->field == V4L2_FIELD_NONE ? "" : " interlaced",
                 text.at ? text.at : "nothing it would name");
    gsn_free(text.at);
    return r;
}

static int check_rows(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    const struct v4l2_pix_format *const got = &v4l2->pixels;
    const uint64_t row = gsn_pixel_format_row(v4l2->settings.format, got->width);

    if (got->sizeimage == 0 || got->sizeimage > MOST_FRAME_BYTES)
        return gsn_fail(err, GSN_E_LIMIT, "%.60s: the driver states frames of %u bytes",
                        v4l2->device, got->sizeimage);
    v4l2->stride = got->bytesperline ? got->bytesperline : (uint32_t)row;
    if (v4l2->stride < row)
        return gsn_fail(err, GSN_E_INPUT,
                        "%.60s: the driver states rows of %u bytes where %u pixels of %.4s need "
                        "%llu",
                        v4l2->device, v4l2->stride, got->width, v4l2->settings.format->fourcc,
                        (unsigned long long)row);
    v4l2->frame_bytes = got->sizeimage;
    return GSN_OK;
}

static int set_rate(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    const uint32_t fps = v4l2->settings.fps;
    struct v4l2_streamparm parm = { .type = V4L2_BUF_TYPE_VIDEO_CAPTURE };
    const struct v4l2_fract *const got = &parm.parm.capture.timeperframe;

    if (!fps)
        return GSN_OK;
    parm.parm.capture.timeperframe = (struct v4l2_fract){ 1, fps };
    if (gsn_v4l2_ioctl(v4l2, VIDIOC_S_PARM, &parm) < 0)
        return gsn_v4l2_refused(v4l2, "setting Fps", err);
    if (got->numerator == 0 || (uint64_t)got->numerator * fps != got->denominator)
        return gsn_fail(err, GSN_E_INPUT,
                        "%.60s: Fps=%u: the camera would give %u frames in %u s; leave Fps away or "
                        "give a rate it has",
                        v4l2->device, fps, got->denominator, got->numerator);
    return GSN_OK;
}

int gsn_v4l2_set_format(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    const struct gsn_camera_settings *const asked = &v4l2->settings;
    struct v4l2_format format = { .type = V4L2_BUF_TYPE_VIDEO_CAPTURE };
    const struct v4l2_pix_format *const got = &format.fmt.pix;
    int r;

    format.fmt.pix.width = asked->width;
    format.fmt.pix.height = asked->height;
    format.fmt.pix.pixelformat = gsn_pixel_format_code(asked->format);
    format.fmt.pix.field = V4L2_FIELD_NONE;
    if (gsn_v4l2_ioctl(v4l2, VIDIOC_S_FMT, &format) < 0)
        return errno == EINVAL ? refuse_adjusted(v4l2, got, err)
                               : gsn_v4l2_refused(v4l2, "setting the format", err);
    if (got->width != asked->width || got->height != asked->height ||
        got->pixelformat != gsn_pixel_format_code(asked->format) || got->field != V4L2_FIELD_NONE)
        return refuse_adjusted(v4l2, got, err);
    v4l2->pixels = *got;
    r = check_rows(v4l2, err);
    return r < 0 ? r : set_rate(v4l2, err);
}

static const char *colorspace_name(uint32_t colorspace)
{
    switch (colorspace) {
    case V4L2_COLORSPACE_SMPTE170M:
        return "SMPTE 170M";
    case V4L2_COLORSPACE_REC709:
        return "Rec. 709";
    case V4L2_COLORSPACE_SRGB:
        return "sRGB";
    case V4L2_COLORSPACE_OPRGB:
        return "opRGB";
    case V4L2_COLORSPACE_BT2020:
        return "BT.2020";
    case V4L2_COLORSPACE_RAW:
        return "raw";
    case V4L2_COLORSPACE_JPEG:
        return "JPEG";
    case V4L2_COLORSPACE_DEFAULT:
        return "not stated, taken as sRGB";
    default:
        return "another";
    }
}

/* What a driver leaves at "default" is what the kernel's documentation says that stands for. */
static const char *matrix_name(uint32_t colorspace, uint32_t encoding)
{
    if (encoding == V4L2_YCBCR_ENC_DEFAULT)
        encoding = V4L2_MAP_YCBCR_ENC_DEFAULT(colorspace);
    switch (encoding) {
    case V4L2_YCBCR_ENC_601:
    case V4L2_YCBCR_ENC_XV601:
        return "BT.601";
    case V4L2_YCBCR_ENC_709:
    case V4L2_YCBCR_ENC_XV709:
        return "BT.709";
    case V4L2_YCBCR_ENC_BT2020:
        return "BT.2020";
    default:
        return "another";
    }
}

static const char *transfer_name(uint32_t colorspace, uint32_t transfer)
{
    if (transfer == V4L2_XFER_FUNC_DEFAULT)
        transfer = V4L2_MAP_XFER_FUNC_DEFAULT(colorspace);
    if (transfer == V4L2_XFER_FUNC_SRGB)
        return "sRGB";
    return transfer == V4L2_XFER_FUNC_NONE ? "linear" : NULL;
}

void gsn_v4l2_describe(const struct gsn_v4l2 *v4l2, struct gsn_frame *ret_frame)
{
    const struct v4l2_pix_format *const pixels = &v4l2->pixels;
    const bool yuv = gsn_pixel_format_is_yuv(v4l2->settings.format);
    const bool raw = gsn_pixel_format_is_raw(v4l2->settings.format);
    const bool extended = pixels->priv == V4L2_PIX_FMT_PRIV_MAGIC;
    const uint32_t colorspace =
        pixels->colorspace == V4L2_COLORSPACE_DEFAULT ? V4L2_COLORSPACE_SRGB : pixels->colorspace;
    const uint32_t encoding = extended ? pixels->ycbcr_enc : V4L2_YCBCR_ENC_DEFAULT;
    uint32_t range = extended ? pixels->quantization : V4L2_QUANTIZATION_DEFAULT;

    if (range == V4L2_QUANTIZATION_DEFAULT)
        range = V4L2_MAP_QUANTIZATION_DEFAULT(!yuv, colorspace, encoding);
    *ret_frame = (struct gsn_frame){
        .format = v4l2->settings.format,
        .width = pixels->width,
        .height = pixels->height,
        .stride = v4l2->stride,
        .device = v4l2->device,
        .interface = "V4L2",
        .colorspace = colorspace_name(pixels->colorspace),
        .matrix = yuv ? matrix_name(colorspace, encoding) : NULL,
        .range = !yuv ? NULL : (range == V4L2_QUANTIZATION_LIM_RANGE ? "limited" : "full"),
        .transfer = raw && colorspace == V4L2_COLORSPACE_RAW
                        ? "linear"
                        : transfer_name(colorspace, extended ? pixels->xfer_func : 0),
    };
}
