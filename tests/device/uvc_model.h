/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A camera that speaks UVC 1.1 with one bulk endpoint: it plays frames round and round, as YUY2,
 * MJPEG or both, and has the controls that decide whether colours can be compared.
 *
 * Exposure and white balance start on automatic, and then wander a little with every frame. */
#ifndef GSN_TESTS_DEVICE_UVC_MODEL_H
#define GSN_TESTS_DEVICE_UVC_MODEL_H

#include "tests/device/usb_model.h"

#include <stdbool.h>

struct uvc_model;

enum uvc_format { UVC_YUY2, UVC_MJPEG };

/* Entities and selectors of UVC 1.1, tables, as uvc_model_value() takes them. */
enum {
    UVC_CAMERA = 1,
    UVC_PROCESSING = 2,
    UVC_CAMERA_AE_MODE = 0x02, /* 1 manual, 8 aperture priority (automatic) */
    UVC_CAMERA_AE_PRIORITY = 0x03,
    UVC_CAMERA_EXPOSURE = 0x04, /* in 100 us */
    UVC_PROCESSING_BRIGHTNESS = 0x02,
    UVC_PROCESSING_GAIN = 0x04,
    UVC_PROCESSING_WHITE = 0x0a, /* in kelvin */
    UVC_PROCESSING_WHITE_AUTO = 0x0b,
};

/* Each is off when zero. "At" counts from 1, since the model was made or plugged in. */
struct uvc_faults {
    unsigned stall_at;       /* this bulk-in transfer stalls, once */
    unsigned silent_after;   /* after so many frames nothing comes until the stream starts anew */
    unsigned short_frame_at; /* this frame ends in the middle */
    unsigned error_at;       /* the payloads of this frame carry the error bit */
    uint64_t unplug_at_byte; /* gone before this bulk-in byte, until uvc_model_replug() */
    bool always_automatic;   /* exposure and white balance refuse to become manual */
    bool forgets_gain;       /* gain is taken, and stays what it was */
};

/* gives. keeps: nothing but the frames to come. Sizes in pixels, interval_ms between frames. */
struct uvc_model *uvc_model_new(const char *serial, unsigned width, unsigned height,
                                unsigned interval_ms, const struct uvc_faults *faults);
void uvc_model_free(struct uvc_model *model);

/* keeps: the bytes. A YUY2 frame has 2 * width * height of them. A format is offered when the model
 * is first plugged in with a frame of it, so add them before uvc_model_usb(). */
void uvc_model_add(struct uvc_model *model, enum uvc_format format, const uint8_t *bytes,
                   size_t size);
/* Frames of a file, one after the other: what the spool keeps of a camera (JPEGs, or PAMs of YUYV,
 * see acquire/frame.h), or raw YUY2. Returns how many, 0 for none of these. */
size_t uvc_model_add_file(struct uvc_model *model, const uint8_t *bytes, size_t size);

const struct usb_model *uvc_model_usb(struct uvc_model *model);

void uvc_model_set_faults(struct uvc_model *model, const struct uvc_faults *faults);
void uvc_model_unplug(struct uvc_model *model);
void uvc_model_replug(struct uvc_model *model);

/* What a control is now; frames begun since it was made. */
int32_t uvc_model_value(const struct uvc_model *model, unsigned entity, unsigned selector);
unsigned uvc_model_frames(const struct uvc_model *model);

#endif
