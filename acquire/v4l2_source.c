/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One camera of the kernel's V4L2 interface, as a grabber of frames for acquire/camera.h.
 *
 * Steps.
 * 1. Open the node, ask what it is, set format, size and rate and read them back; what the driver
 *    changed is refused with the list of what the camera has.
 * 2. Lock: automatics off, values set and read back (exposure, gain, white balance; brightness and
 * hue where they have an automatic). What cannot be locked is noted in the frame.
 * 3. Stream: mapped buffers, else buffers of ours, else read(). A buffer that the driver would not
 * take back is offered again each time.
 * 4. A frame that is short or marked damaged is counted and dropped. With each frame that is kept
 * the controls are read back again.
 *
 * How it fails: GSN_E_NOTFOUND when the camera is gone, GSN_E_BUSY with the holder's name,
 * GSN_E_INPUT for a setting that the camera does not have. */
#include "acquire/v4l2_source.h"

#include <errno.h>
#include <linux/videodev2.h>
#include <poll.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include "acquire/camera.h"
#include "acquire/frame.h"
#include "acquire/v4l2_device.h"
#include "pipeline/core/file.h"

enum { BUFFERS = 4, CONTROLS = 6 };

enum io_method { IO_MMAP, IO_USERPTR, IO_READ };

struct stream_buffer {
    uint8_t *at;
    size_t size;
    void *memory; /* for USERPTR and READ: what at lies in */
    bool is_queued;
};

/* One thing that must not change by itself from panel to panel. */
struct control_lock {
    const char *name, *unit;
    uint32_t automatic; /* control that switches it; 0: none */
    int32_t off;        /* the value that means "by hand" */
    uint32_t control;   /* the value's; 0: none */
    int64_t value;      /* as locked */
    bool is_known;
    char unlock[140]; /* why it is not locked; empty: it is */
};

/* One opened capture node. */
struct v4l2 {
    int fd;
    char *node;   /* /dev/videoN, where it was found this time */
    char *device; /* card and address, for people */
    uint32_t caps;
    struct gsn_camera_settings settings;
    uint32_t stride, frame_bytes; /* as the driver read them back */
    struct v4l2_pix_format pixels;

    size_t lock_count;
    struct control_lock lock[CONTROLS];
    struct gsn_frame_control control[CONTROLS];
    char unlock[CONTROLS][140];
    char withheld[300];

    enum io_method io;
    unsigned count; /* buffers */
    struct stream_buffer buffer[BUFFERS];
    int held; /* index of the frame the caller has; -1: none */
    bool is_on;
    unsigned damaged;
};

/* ioctl() again after a signal; -1 with errno. */
static int call_ioctl(const struct v4l2 *v4l2, unsigned long request, void *argument)
{
    int r;

    do
        r = ioctl(v4l2->fd, request, argument);
    while (r < 0 && errno == EINTR);
    return r;
}

/* Writes what errno says of it: GSN_E_NOTFOUND when the camera is gone, GSN_E_BUSY with the name of
 * who holds it, else GSN_E_IO. */
static int fail_refused(const struct v4l2 *v4l2, const char *what, struct gsn_error *err)
{
    const int failure = errno;
    char holder[120];

    if (failure == ENODEV || failure == ENXIO)
        return gsn_fail(err, GSN_E_NOTFOUND, "%.60s: the camera is gone: plug it in again",
                        v4l2->device);
    if (failure != EBUSY)
        return gsn_fail(err, GSN_E_IO, "%.60s: %s: %s", v4l2->device, what, strerror(failure));
    gsn_v4l2_holder(v4l2->node, holder, sizeof holder);
    return gsn_fail(err, GSN_E_BUSY, "%.60s: %s: %s holds the camera; close that first",
                    v4l2->device, what, holder[0] ? holder : "another program");
}

/* The format. */

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

static void list_sizes(const struct v4l2 *v4l2, uint32_t code, struct gsn_text *text)
{
    for (uint32_t i = 0; i < 64 && text->used < MOST_LISTED; i++) {
        struct v4l2_frmsizeenum size = { .index = i, .pixel_format = code };

        if (call_ioctl(v4l2, VIDIOC_ENUM_FRAMESIZES, &size) < 0)
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
static void list_formats(const struct v4l2 *v4l2, struct gsn_text *text)
{
    for (uint32_t i = 0; i < 64 && text->used < MOST_LISTED; i++) {
        struct v4l2_fmtdesc format = { .index = i, .type = V4L2_BUF_TYPE_VIDEO_CAPTURE };
        char code[5];

        if (call_ioctl(v4l2, VIDIOC_ENUM_FMT, &format) < 0)
            return;
        code_text(format.pixelformat, code);
        gsn_text_add(text, "%s%s", i ? "; " : "", code);
        list_sizes(v4l2, format.pixelformat, text);
    }
}

static int refuse_adjusted(const struct v4l2 *v4l2, const struct v4l2_pix_format *got,
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

static int check_rows(struct v4l2 *v4l2, struct gsn_error *err)
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

static int set_rate(struct v4l2 *v4l2, struct gsn_error *err)
{
    const uint32_t fps = v4l2->settings.fps;
    struct v4l2_streamparm parm = { .type = V4L2_BUF_TYPE_VIDEO_CAPTURE };
    const struct v4l2_fract *const got = &parm.parm.capture.timeperframe;

    if (!fps)
        return GSN_OK;
    parm.parm.capture.timeperframe = (struct v4l2_fract){ 1, fps };
    if (call_ioctl(v4l2, VIDIOC_S_PARM, &parm) < 0)
        return fail_refused(v4l2, "setting Fps", err);
    if (got->numerator == 0 || (uint64_t)got->numerator * fps != got->denominator)
        return gsn_fail(err, GSN_E_INPUT,
                        "%.60s: Fps=%u: the camera would give %u frames in %u s; leave Fps away or "
                        "give a rate it has",
                        v4l2->device, fps, got->denominator, got->numerator);
    return GSN_OK;
}

/* Sets format, size and rate and reads them back. */
static int set_format(struct v4l2 *v4l2, struct gsn_error *err)
{
    const struct gsn_camera_settings *const asked = &v4l2->settings;
    struct v4l2_format format = { .type = V4L2_BUF_TYPE_VIDEO_CAPTURE };
    const struct v4l2_pix_format *const got = &format.fmt.pix;
    int r;

    format.fmt.pix.width = asked->width;
    format.fmt.pix.height = asked->height;
    format.fmt.pix.pixelformat = gsn_pixel_format_code(asked->format);
    format.fmt.pix.field = V4L2_FIELD_NONE;
    if (call_ioctl(v4l2, VIDIOC_S_FMT, &format) < 0)
        return errno == EINVAL ? refuse_adjusted(v4l2, got, err)
                               : fail_refused(v4l2, "setting the format", err);
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

/* Puts the format and what it means into a frame. */
static void describe_frame(const struct v4l2 *v4l2, struct gsn_frame *ret_frame)
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

/* Locking the controls. */

/* What must not change by itself. The first value control a camera has is the one used; an optional
 * row counts only where the camera has the automatic. */
static const struct lockable {
    const char *name;
    uint32_t automatic;
    int32_t off;
    struct {
        uint32_t control;
        const char *unit;
    } value[2];
    bool optional;
    bool of_raw; /* bears on raw samples, too */
} lockable[] = {
    { "exposure",
      V4L2_CID_EXPOSURE_AUTO,
      V4L2_EXPOSURE_MANUAL,
      { { V4L2_CID_EXPOSURE_ABSOLUTE, "x 100 us" }, { V4L2_CID_EXPOSURE, "" } },
      false,
      true },
    { "gain",
      V4L2_CID_AUTOGAIN,
      0,
      { { V4L2_CID_GAIN, "" }, { V4L2_CID_ANALOGUE_GAIN, "" } },
      false,
      true },
    { "white balance",
      V4L2_CID_AUTO_WHITE_BALANCE,
      0,
      { { V4L2_CID_WHITE_BALANCE_TEMPERATURE, "K" } },
      false,
      false },
    { "brightness", V4L2_CID_AUTOBRIGHTNESS, 0, { { V4L2_CID_BRIGHTNESS, "" } }, true, true },
    { "hue", V4L2_CID_HUE_AUTO, 0, { { V4L2_CID_HUE, "" } }, true, false },
};

static int64_t asked_for(const struct v4l2 *v4l2, const struct lockable *row)
{
    const int64_t asked[] = { v4l2->settings.exposure, v4l2->settings.gain,
                              v4l2->settings.white_balance };
    const size_t i = (size_t)(row - lockable);

    return i < 3 ? asked[i] : -1;
}

__attribute__((format(printf, 2, 3))) static void note_unlocked(struct control_lock *lock,
                                                                const char *format, ...)
{
    va_list args;

    va_start(args, format);
    (void)vsnprintf(lock->unlock, sizeof lock->unlock, format, args);
    va_end(args);
}

static bool query_control(const struct v4l2 *v4l2, uint32_t id, struct v4l2_queryctrl *ret_control)
{
    *ret_control = (struct v4l2_queryctrl){ .id = id };
    return id && call_ioctl(v4l2, VIDIOC_QUERYCTRL, ret_control) == 0 &&
           !(ret_control->flags & V4L2_CTRL_FLAG_DISABLED);
}

static bool get_control(const struct v4l2 *v4l2, uint32_t id, int32_t *ret_value)
{
    struct v4l2_control control = { .id = id };

    if (call_ioctl(v4l2, VIDIOC_G_CTRL, &control) < 0)
        return false;
    *ret_value = control.value;
    return true;
}

static bool set_control(const struct v4l2 *v4l2, uint32_t id, int32_t value)
{
    struct v4l2_control control = { .id = id, .value = value };

    return call_ioctl(v4l2, VIDIOC_S_CTRL, &control) == 0;
}

/* Why a control cannot be set, before anybody tries; NULL: it can. */
static const char *find_obstacle(const struct v4l2_queryctrl *control)
{
    if (control->flags & V4L2_CTRL_FLAG_GRABBED)
        return "held by another program or by the stream";
    if (control->flags & V4L2_CTRL_FLAG_READ_ONLY)
        return "read-only";
    if (control->flags & V4L2_CTRL_FLAG_INACTIVE)
        return "inactive: another control governs it";
    return NULL;
}

static void switch_off(const struct v4l2 *v4l2, struct control_lock *lock)
{
    struct v4l2_queryctrl control;
    int32_t value = 0;

    (void)query_control(v4l2, lock->automatic, &control);
    if (get_control(v4l2, lock->automatic, &value) && value == lock->off)
        return;
    if (find_obstacle(&control))
        note_unlocked(lock, "its automatic cannot be switched off (%s)", find_obstacle(&control));
    else if (!set_control(v4l2, lock->automatic, lock->off))
        note_unlocked(lock, "its automatic cannot be switched off (%s)",
                      errno == EBUSY ? "held by another program or by the stream"
                                     : strerror(errno));
    else if (!get_control(v4l2, lock->automatic, &value) || value != lock->off)
        note_unlocked(lock, "its automatic was switched off, but reads on");
}

static int set_value(const struct v4l2 *v4l2, struct control_lock *lock, int64_t asked,
                     const struct v4l2_queryctrl *control, struct gsn_error *err)
{
    int32_t value = 0;

    if (asked >= 0 && (asked < control->minimum || asked > control->maximum))
        return gsn_fail(err, GSN_E_INPUT, "%.60s: %s %lld was asked for, it goes from %d to %d",
                        v4l2->device, lock->name, (long long)asked, control->minimum,
                        control->maximum);
    if (lock->unlock[0])
        return GSN_OK; /* the automatic would change it again */
    if (control->flags & V4L2_CTRL_FLAG_INACTIVE)
        note_unlocked(lock, "%s", find_obstacle(control));
    else if (asked >= 0 && find_obstacle(control))
        note_unlocked(lock, "its value cannot be set (%s)", find_obstacle(control));
    else if (asked >= 0 && !set_control(v4l2, lock->control, (int32_t)asked))
        note_unlocked(lock, "its value cannot be set (%s)", strerror(errno));
    else if (control->flags & V4L2_CTRL_FLAG_VOLATILE)
        note_unlocked(lock, "its value changes by itself");
    else if (asked >= 0 && (!get_control(v4l2, lock->control, &value) || value != asked))
        note_unlocked(lock, "it was set to %lld and reads %d", (long long)asked, value);
    return GSN_OK;
}

static int lock_row(struct v4l2 *v4l2, const struct lockable *row, struct gsn_error *err)
{
    struct control_lock *const lock = &v4l2->lock[v4l2->lock_count];
    struct v4l2_queryctrl automatic, control = { 0 };
    const bool has_automatic = query_control(v4l2, row->automatic, &automatic);
    int32_t value = 0;
    int r = GSN_OK;

    if (row->optional && !has_automatic)
        return GSN_OK;
    *lock = (struct control_lock){ .name = row->name, .unit = "", .off = row->off };
    lock->automatic = has_automatic ? row->automatic : 0;
    v4l2->lock_count++;
    if (has_automatic)
        switch_off(v4l2, lock);
    for (size_t i = 0; i < 2 && !lock->control; i++) {
        if (!query_control(v4l2, row->value[i].control, &control))
            continue;
        lock->control = row->value[i].control;
        lock->unit = row->value[i].unit;
    }
    if (lock->control)
        r = set_value(v4l2, lock, asked_for(v4l2, row), &control, err);
    else if (!lock->unlock[0])
        note_unlocked(lock, "the camera has no control for it");
    lock->is_known = lock->control && get_control(v4l2, lock->control, &value);
    lock->value = value;
    if (lock->control && !lock->is_known && !lock->unlock[0])
        note_unlocked(lock, "its value cannot be read back");
    return r;
}

/* Automatics off, values set and read back. Fails with GSN_E_INPUT when a setting is out of the
 * control's range, or NOTFOUND; what cannot be locked is no failure but noted. */
static int lock_controls(struct v4l2 *v4l2, struct gsn_error *err)
{
    const bool raw = gsn_pixel_format_is_raw(v4l2->settings.format);
    int r = GSN_OK;

    v4l2->lock_count = 0;
    for (size_t i = 0; i < sizeof lockable / sizeof lockable[0] && r >= 0; i++) {
        if (!raw || lockable[i].of_raw)
            r = lock_row(v4l2, &lockable[i], err);
    }
    return r;
}

/* What a control says now, and whether that is what was locked. */
static bool recheck_control(const struct v4l2 *v4l2, const struct control_lock *lock,
                            struct gsn_frame_control *ret_control, char *unlocked, size_t size)
{
    int32_t value = 0, automatic = lock->off;

    (void)snprintf(unlocked, size, "%s", lock->unlock);
    *ret_control = (struct gsn_frame_control){ .name = lock->name, .unit = lock->unit };
    if (lock->control) {
        ret_control->is_known = get_control(v4l2, lock->control, &value);
        ret_control->value = value;
        if (!ret_control->is_known && errno == ENODEV)
            return false;
    }
    if (!unlocked[0] && lock->automatic &&
        (!get_control(v4l2, lock->automatic, &automatic) || automatic != lock->off))
        (void)snprintf(unlocked, size, "its automatic was switched on again");
    else if (!unlocked[0] && !ret_control->is_known)
        (void)snprintf(unlocked, size, "its value cannot be read back");
    else if (!unlocked[0] && value != lock->value)
        (void)snprintf(unlocked, size, "it reads %d where %lld was locked", value,
                       (long long)lock->value);
    ret_control->unlock = unlocked[0] ? unlocked : NULL;
    return true;
}

static int read_back_controls(void *self, struct gsn_frame *frame, struct gsn_error *err)
{
    struct v4l2 *const v4l2 = self;
    size_t used = 0;

    v4l2->withheld[0] = '\0';
    for (size_t i = 0; i < v4l2->lock_count; i++) {
        if (!recheck_control(v4l2, &v4l2->lock[i], &v4l2->control[i], v4l2->unlock[i],
                             sizeof v4l2->unlock[i]))
            return fail_refused(v4l2, "reading the controls back", err);
        if (v4l2->control[i].unlock && used < sizeof v4l2->withheld)
            used += (size_t)snprintf(v4l2->withheld + used, sizeof v4l2->withheld - used,
                                     "%s%s is not locked: %s", used ? "; " : "", v4l2->lock[i].name,
                                     v4l2->control[i].unlock);
    }
    frame->control = v4l2->control;
    frame->control_count = v4l2->lock_count;
    frame->withheld = v4l2->withheld[0] ? v4l2->withheld : NULL;
    return GSN_OK;
}

/* The stream. */

static uint32_t memory_of(const struct v4l2 *v4l2)
{
    return v4l2->io == IO_MMAP ? V4L2_MEMORY_MMAP : V4L2_MEMORY_USERPTR;
}

static int request_buffers(struct v4l2 *v4l2, unsigned count)
{
    struct v4l2_requestbuffers request = { .count = count,
                                           .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                           .memory = memory_of(v4l2) };

    if (call_ioctl(v4l2, VIDIOC_REQBUFS, &request) < 0)
        return -1;
    v4l2->count = request.count < count ? request.count : count;
    return 0;
}

static void free_buffers(struct v4l2 *v4l2)
{
    for (unsigned i = 0; i < BUFFERS; i++) {
        struct stream_buffer *const buffer = &v4l2->buffer[i];

        if (buffer->at && !buffer->memory)
            (void)munmap(buffer->at, buffer->size);
        gsn_free(buffer->memory);
        *buffer = (struct stream_buffer){ 0 };
    }
    v4l2->held = -1;
    v4l2->count = 0;
}

/* -1 with errno when this node cannot be mapped. */
static int map_buffers(struct v4l2 *v4l2)
{
    for (unsigned i = 0; i < v4l2->count; i++) {
        struct v4l2_buffer buffer = { .index = i,
                                      .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                      .memory = V4L2_MEMORY_MMAP };
        void *at;

        if (call_ioctl(v4l2, VIDIOC_QUERYBUF, &buffer) < 0)
            return -1;
        at = mmap(NULL, buffer.length, PROT_READ, MAP_SHARED, v4l2->fd, buffer.m.offset);
        if (at == MAP_FAILED)
            return -1;
        v4l2->buffer[i].at = at;
        v4l2->buffer[i].size = buffer.length;
    }
    return 0;
}

/* Drivers want the memory of USERPTR to begin with a page. */
static int allocate_buffers(struct v4l2 *v4l2, struct gsn_error *err)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);

    for (unsigned i = 0; i < v4l2->count; i++) {
        struct stream_buffer *const buffer = &v4l2->buffer[i];

        buffer->memory = gsn_alloc(v4l2->frame_bytes + page);
        if (!buffer->memory)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for frames of %u bytes",
                            v4l2->frame_bytes);
        buffer->at = (uint8_t *)(((uintptr_t)buffer->memory + page - 1) / page * page);
        buffer->size = v4l2->frame_bytes;
    }
    return GSN_OK;
}

/* By mapped buffers, else by buffers of ours, else by read(). */
static int choose_io(struct v4l2 *v4l2, struct gsn_error *err)
{
    if (v4l2->caps & V4L2_CAP_STREAMING) {
        v4l2->io = IO_MMAP;
        if (request_buffers(v4l2, BUFFERS) == 0 && v4l2->count > 0) {
            if (map_buffers(v4l2) == 0)
                return GSN_OK;
            free_buffers(v4l2);
            (void)request_buffers(v4l2, 0);
        } else if (errno == EBUSY || errno == ENODEV) {
            return fail_refused(v4l2, "asking for buffers", err);
        }
        v4l2->io = IO_USERPTR;
        if (request_buffers(v4l2, BUFFERS) == 0 && v4l2->count > 0)
            return allocate_buffers(v4l2, err);
    }
    if (!(v4l2->caps & V4L2_CAP_READWRITE))
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "%.60s: its driver gives frames neither through mapped buffers, nor into "
                        "ours, nor by read()",
                        v4l2->device);
    v4l2->io = IO_READ;
    v4l2->count = 1;
    return allocate_buffers(v4l2, err);
}

static int queue_buffer(struct v4l2 *v4l2, unsigned index)
{
    struct stream_buffer *const own = &v4l2->buffer[index];
    struct v4l2_buffer buffer = { .index = index,
                                  .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                  .memory = memory_of(v4l2) };

    if (v4l2->io == IO_USERPTR) {
        buffer.m.userptr = (unsigned long)own->at;
        buffer.length = (uint32_t)own->size;
    }
    if (call_ioctl(v4l2, VIDIOC_QBUF, &buffer) < 0)
        return -1;
    own->is_queued = true;
    return 0;
}

/* A buffer the driver would not take back is offered again each time. */
static int queue_all(struct v4l2 *v4l2, struct gsn_error *err)
{
    for (unsigned i = 0; i < v4l2->count; i++) {
        if (v4l2->buffer[i].is_queued || v4l2->held == (int)i)
            continue;
        if (queue_buffer(v4l2, i) < 0 && errno == ENODEV)
            return fail_refused(v4l2, "queueing a buffer", err);
    }
    return GSN_OK;
}

static int stream_on(struct v4l2 *v4l2, struct gsn_error *err)
{
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;

    if (call_ioctl(v4l2, VIDIOC_STREAMON, &type) == 0)
        return GSN_OK;
    if (errno == ENOSPC)
        return gsn_fail(err, GSN_E_IO,
                        "%.60s: the USB bus has no room for this stream: use another port, a lower "
                        "Fps= or a smaller picture",
                        v4l2->device);
    return fail_refused(v4l2, "starting the stream", err);
}

static void stop_stream(void *self)
{
    struct v4l2 *const v4l2 = self;
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;

    if (!v4l2->is_on)
        return;
    v4l2->is_on = false;
    if (v4l2->io != IO_READ)
        (void)call_ioctl(v4l2, VIDIOC_STREAMOFF, &type);
    free_buffers(v4l2);
    if (v4l2->io != IO_READ)
        (void)request_buffers(v4l2, 0);
}

static int start_stream(void *self, struct gsn_error *err)
{
    struct v4l2 *const v4l2 = self;
    struct stat st;
    int r;

    if (stat(v4l2->node, &st) < 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "%.60s: the camera is gone: plug it in again",
                        v4l2->device);
    r = choose_io(v4l2, err);
    v4l2->is_on = true;
    if (r >= 0 && v4l2->io != IO_READ)
        r = queue_all(v4l2, err);
    if (r >= 0 && v4l2->io != IO_READ)
        r = stream_on(v4l2, err);
    if (r < 0)
        stop_stream(v4l2);
    return r;
}

/* Bytes a frame must have; those of a JPEG are for its end to say. */
static size_t least_bytes(const struct v4l2 *v4l2)
{
    const struct gsn_pixel_format *const format = v4l2->settings.format;
    const size_t row = (size_t)gsn_pixel_format_row(format, v4l2->pixels.width);
    const size_t rows = format->packing == GSN_PACKING_NV12 ? (size_t)v4l2->pixels.height / 2 * 3
                                                            : (size_t)v4l2->pixels.height;

    return row ? (rows - 1) * v4l2->stride + row : 4;
}

/* The index of a whole frame, -1 when none is there. */
static int dequeue_frame(struct v4l2 *v4l2, int *ret_index, size_t *ret_size, struct gsn_error *err)
{
    *ret_index = -1;
    for (unsigned tries = 0; tries < 2 * BUFFERS; tries++) {
        struct v4l2_buffer buffer = { .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                      .memory = memory_of(v4l2) };
        int r;

        r = queue_all(v4l2, err);
        if (r < 0)
            return r;
        if (call_ioctl(v4l2, VIDIOC_DQBUF, &buffer) < 0) {
            v4l2->damaged += errno == EIO;
            return errno == ENODEV ? fail_refused(v4l2, "waiting for a frame", err) : GSN_OK;
        }
        if (buffer.index >= v4l2->count)
            return gsn_fail(err, GSN_E_IO, "%.60s: the driver gives a buffer %u of %u",
                            v4l2->device, buffer.index, v4l2->count);
        v4l2->buffer[buffer.index].is_queued = false;
        *ret_size = buffer.bytesused < v4l2->buffer[buffer.index].size
                        ? buffer.bytesused
                        : v4l2->buffer[buffer.index].size;
        if (!(buffer.flags & V4L2_BUF_FLAG_ERROR) && *ret_size >= least_bytes(v4l2)) {
            *ret_index = (int)buffer.index;
            return GSN_OK;
        }
        v4l2->damaged++;
    }
    return GSN_OK;
}

static int read_frame(struct v4l2 *v4l2, int *ret_index, size_t *ret_size, struct gsn_error *err)
{
    const ssize_t got = read(v4l2->fd, v4l2->buffer[0].at, v4l2->buffer[0].size);

    *ret_index = -1;
    if (got < 0 && errno == ENODEV)
        return fail_refused(v4l2, "waiting for a frame", err);
    if (got < 0)
        v4l2->damaged += errno == EIO;
    else if (got > 0 && (size_t)got < least_bytes(v4l2))
        v4l2->damaged++;
    else if (got > 0)
        *ret_index = 0;
    *ret_size = got > 0 ? (size_t)got : 0;
    return GSN_OK;
}

static int grab_frame(void *self, struct gsn_frame *ret_frame, int *ret_there,
                      struct gsn_error *err)
{
    struct v4l2 *const v4l2 = self;
    int index = -1, r = GSN_OK;
    size_t size = 0;

    if (v4l2->is_on)
        r = v4l2->io == IO_READ ? read_frame(v4l2, &index, &size, err)
                                : dequeue_frame(v4l2, &index, &size, err);
    if (r < 0)
        return r;
    *ret_there = index >= 0;
    if (index < 0)
        return GSN_OK;
    v4l2->held = index;
    describe_frame(v4l2, ret_frame);
    ret_frame->bytes = v4l2->buffer[index].at;
    ret_frame->size = size;
    return GSN_OK;
}

static void release_frame(void *self)
{
    struct v4l2 *const v4l2 = self;
    v4l2->held = -1; /* queued again before the next frame is asked for */
}

/* The camera as a source. */

static void v4l2_free(struct v4l2 *v4l2)
{
    if (!v4l2)
        return;
    stop_stream(v4l2);
    if (v4l2->fd >= 0)
        (void)close(v4l2->fd);
    gsn_free(v4l2->node);
    gsn_free(v4l2->device);
    gsn_free(v4l2);
}

static unsigned take_damaged(void *self)
{
    struct v4l2 *const v4l2 = self;
    const unsigned count = v4l2->damaged;

    v4l2->damaged = 0;
    return count;
}

/* A hint only: some drivers' poll() is ready when no frame is. */
static int wait_for_frame(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    const struct v4l2 *const v4l2 = self;
    struct pollfd on[2] = { { .fd = v4l2->fd, .events = POLLIN },
                            { .fd = stop_fd, .events = POLLIN } };

    if (poll(on, 2, timeout_ms) < 0 && errno != EINTR)
        return fail_refused(v4l2, "waiting for a frame", err);
    return GSN_OK;
}

static const char *name_device(const void *self)
{
    return ((const struct v4l2 *)self)->device;
}

static void close_camera(void *self)
{
    v4l2_free(self);
}

static const struct gsn_grabber_ops grabber_ops = {
    .start = start_stream,
    .stop = stop_stream,
    .grab = grab_frame,
    .release = release_frame,
    .read_back = read_back_controls,
    .damaged = take_damaged,
    .wait = wait_for_frame,
    .device = name_device,
    .close = close_camera,
};

static int query_camera(struct v4l2 *v4l2, const char *name, struct gsn_error *err)
{
    struct v4l2_capability caps = { 0 };

    if (call_ioctl(v4l2, VIDIOC_QUERYCAP, &caps) < 0)
        return errno == ENOTTY
                   ? gsn_fail(err, GSN_E_INPUT, "v4l2:%.100s: %.60s is no camera", name, v4l2->node)
                   : fail_refused(v4l2, "asking what it is", err);
    v4l2->caps = caps.capabilities & V4L2_CAP_DEVICE_CAPS ? caps.device_caps : caps.capabilities;
    caps.card[sizeof caps.card - 1] = '\0';
    gsn_free(v4l2->device);
    v4l2->device = gsn_format("%s, %s", (const char *)caps.card, name);
    if (!v4l2->device)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera");
    if (v4l2->caps & V4L2_CAP_VIDEO_CAPTURE)
        return GSN_OK;
    if (v4l2->caps & V4L2_CAP_VIDEO_CAPTURE_MPLANE)
        return gsn_fail(
            err, GSN_E_UNSUPPORTED,
            "%.100s gives frames in several planes: address it as libcamera:", v4l2->device);
    return gsn_fail(err, GSN_E_INPUT, "%.100s: this node takes no pictures", v4l2->device);
}

static int prepare_camera(struct v4l2 *v4l2, const char *name, struct gsn_error *err)
{
    int r = gsn_v4l2_find(name, &v4l2->node, err);

    if (r >= 0)
        r = gsn_file_open(v4l2->node, &v4l2->fd, err);
    if (r >= 0)
        r = query_camera(v4l2, name, err);
    if (r >= 0)
        r = set_format(v4l2, err);
    return r < 0 ? r : lock_controls(v4l2, err);
}

static int v4l2_check(const char *rest, const struct gsn_source_options *options,
                      struct gsn_error *err)
{
    struct gsn_camera_settings settings;
    const int r = gsn_v4l2_check_name(rest, err);

    return r < 0 ? r : gsn_camera_settings_read(options, &settings, err);
}

static int v4l2_open(const char *rest, const struct gsn_source_options *options, void **ret_self,
                     struct gsn_error *err)
{
    struct v4l2 *v4l2 = gsn_alloc_array(1, sizeof *v4l2);
    int r;

    if (!v4l2)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera");
    v4l2->fd = -1;
    v4l2->held = -1;
    v4l2->device = gsn_format("v4l2:%s", rest);
    r = v4l2->device ? gsn_camera_settings_read(options, &v4l2->settings, err)
                     : gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera");
    if (r >= 0)
        r = prepare_camera(v4l2, rest, err);
    if (r < 0) {
        v4l2_free(v4l2);
        return r;
    }
    return gsn_camera_new((struct gsn_grabber){ &grabber_ops, v4l2, BUFFERS }, &v4l2->settings,
                          options, ret_self, err);
}

const struct gsn_source_ops gsn_v4l2_source_ops = {
    .kind = "v4l2",
    .subsystem = "video4linux",
    .settings = gsn_camera_keys,
    .check = v4l2_check,
    .open = v4l2_open,
    .poll = gsn_camera_poll,
    .read = gsn_camera_read,
    .acknowledge = gsn_camera_acknowledge,
    .wait = gsn_camera_wait,
    .capture = gsn_camera_capture,
    .device = gsn_camera_device,
    .close = gsn_camera_close,
};
