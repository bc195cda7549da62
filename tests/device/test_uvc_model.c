/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The camera's descriptors against the sums that UVC 1.1 demands, its payloads and controls against
 * bytes written out by hand. */
#include "tests/device/uvc_model.h"

#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/device/wire.h"

enum { WIDTH = 160, HEIGHT = 100, SIZE = 2 * WIDTH * HEIGHT, URB = 16384 };

static uint8_t frames[2 * SIZE], buffer[URB], picture[SIZE];

static struct uvc_model *start(const struct uvc_faults *faults)
{
    struct uvc_model *const model = uvc_model_new("CAM1", WIDTH, HEIGHT, 100, faults);

    for (size_t i = 0; i < sizeof frames; i++)
        frames[i] = (uint8_t)(i * 5 + i / 253);
    CHECK(uvc_model_add_file(model, frames, sizeof frames) == 2);
    return model;
}

static long request(struct uvc_model *model, uint8_t request_, uint8_t selector, uint8_t entity,
                    uint8_t interface, uint8_t *bytes, size_t size)
{
    const struct usb_model *const usb = uvc_model_usb(model);
    const bool in = request_ & 0x80;
    const uint8_t setup[8] = { in ? 0xa1 : 0x21, request_,     0, selector, interface,
                               entity,           (uint8_t)size };

    return usb->control(usb->self, setup, in ? NULL : bytes, in ? 0 : size, in ? bytes : NULL,
                        in ? size : 0);
}

static void commit(struct uvc_model *model, uint8_t format)
{
    uint8_t probe[34] = { 0, 0, format, 1 };

    CHECK(request(model, 0x01, 1, 0, 1, probe, sizeof probe) == 0);
    CHECK(request(model, 0x81, 1, 0, 1, probe, sizeof probe) == 34);
    CHECK(probe[2] == format && wire_get32(probe + 18) == SIZE && wire_get32(probe + 22) == URB);
    CHECK(request(model, 0x01, 2, 0, 1, probe, sizeof probe) == 0);
}

/* One frame as a driver puts it together; returns its bytes, or what the transfer said. */
static long pull(struct uvc_model *model, uint8_t *ret_flags)
{
    const struct usb_model *const usb = uvc_model_usb(model);
    size_t used = 0;

    *ret_flags = 0;
    for (;;) {
        const long got = usb->in(usb->self, 0x81, buffer, URB);

        if (got < 0)
            return got;
        CHECK(got >= 2 && buffer[0] == 2 && used + (size_t)got - 2 <= SIZE);
        memcpy(picture + used, buffer + 2, (size_t)got - 2);
        used += (size_t)got - 2;
        *ret_flags |= buffer[1];
        if (buffer[1] & 2)
            return (long)used;
    }
}

TEST(descriptors_add_up)
{
    struct uvc_model *const model = start(NULL);
    static const uint8_t jpeg[] = { 0xff, 0xd8, 0xff, 0xd9 };
    const struct usb_model *usb;
    size_t control = 0, streaming = 0, formats = 0, in_class = 0;

    uvc_model_add(model, UVC_MJPEG, jpeg, sizeof jpeg);
    usb = uvc_model_usb(model);
    CHECK(wire_get16(usb->config + 2) == usb->config_size);
    for (size_t at = 0; at < usb->config_size; at += usb->config[at]) {
        const uint8_t *const d = usb->config + at;

        CHECK(d[0] >= 2 && at + d[0] <= usb->config_size);
        if (d[1] == 4)
            in_class = d[6]; /* 1 control, 2 streaming */
        if (d[1] == 0x24)
            *(in_class == 1 ? &control : &streaming) += d[0];
        if (d[1] == 0x24 && in_class == 2 && (d[2] == 4 || d[2] == 6))
            formats++;
    }
    CHECK(control == 52 && formats == 2);
    CHECK(streaming == 13 + 2 + 27 + 30 + 11 + 30);
    uvc_model_free(model);
}

TEST(frames_come_byte_equal_one_after_the_other)
{
    struct uvc_model *const model = start(NULL);
    const struct usb_model *const usb = uvc_model_usb(model);
    uint8_t first, second;

    CHECK(pull(model, &first) == USB_MODEL_NAK);
    commit(model, 1);
    CHECK(pull(model, &first) == SIZE && memcmp(picture, frames, SIZE) == 0);
    CHECK(pull(model, &second) == USB_MODEL_NAK); /* not before its time */
    usb->tick(usb->self, 100);
    CHECK(pull(model, &second) == SIZE && memcmp(picture, frames + SIZE, SIZE) == 0);
    CHECK((first ^ second) & 1); /* the frame id toggles */
    usb->tick(usb->self, 200);
    CHECK(pull(model, &first) == SIZE && memcmp(picture, frames, SIZE) == 0);
    CHECK(uvc_model_frames(model) == 3);
    uvc_model_free(model);
}

TEST(motion_jpegs_are_parted_at_their_seams)
{
    static const uint8_t file[] = { 0xff, 0xd8, 1, 0xff, 0xd9, 0xff, 0xd8, 2, 3, 0xff, 0xd9 };
    struct uvc_model *const model = uvc_model_new("CAM1", WIDTH, HEIGHT, 0, NULL);
    uint8_t flags;

    CHECK(uvc_model_add_file(model, file, sizeof file) == 2);
    commit(model, 1);
    CHECK(pull(model, &flags) == 5 && memcmp(picture, file, 5) == 0);
    CHECK(pull(model, &flags) == 6 && memcmp(picture, file + 5, 6) == 0);
    uvc_model_free(model);
}

TEST(frames_that_were_captured_are_played_again)
{
    static const char header[] = "P7\n# gieson frame 1\n# device: X\nWIDTH 160\nHEIGHT 100\n"
                                 "DEPTH 2\nMAXVAL 255\nTUPLTYPE YUYV\nENDHDR\n";
    struct uvc_model *const model = uvc_model_new("CAM1", WIDTH, HEIGHT, 0, NULL);
    struct uvc_model *const other = uvc_model_new("CAM1", WIDTH, HEIGHT + 1, 0, NULL);
    static uint8_t file[2 * (sizeof header - 1 + SIZE)];
    uint8_t *at = file, flags;

    for (size_t i = 0; i < sizeof frames; i++)
        frames[i] = (uint8_t)(i * 5 + i / 253);
    for (size_t i = 0; i < 2; i++) {
        at = (uint8_t *)mempcpy(at, header, sizeof header - 1);
        at = (uint8_t *)mempcpy(at, frames + i * SIZE, SIZE);
    }
    CHECK(uvc_model_add_file(model, file, sizeof file) == 2);
    commit(model, 1);
    CHECK(pull(model, &flags) == SIZE && memcmp(picture, frames, SIZE) == 0);
    CHECK(pull(model, &flags) == SIZE && memcmp(picture, frames + SIZE, SIZE) == 0);
    CHECK(uvc_model_add_file(model, file, sizeof file - 1) == 0);
    CHECK(uvc_model_add_file(other, file, sizeof file) == 0);
    uvc_model_free(model);
    uvc_model_free(other);
}

TEST(faults_hit_one_frame)
{
    struct uvc_model *const model = uvc_model_new(
        "CAM1", WIDTH, HEIGHT, 0,
        &(struct uvc_faults){ .short_frame_at = 2, .error_at = 3, .silent_after = 4 });
    const struct usb_model *usb;
    const uint8_t clear[8] = { 0x02, 1, 0, 0, 0x81 };
    uint8_t flags;

    uvc_model_add(model, UVC_YUY2, frames, SIZE);
    usb = uvc_model_usb(model);
    commit(model, 1);
    CHECK(pull(model, &flags) == SIZE && !(flags & 0x40));
    CHECK(pull(model, &flags) == SIZE / 2);
    CHECK(pull(model, &flags) == SIZE && (flags & 0x40));
    CHECK(pull(model, &flags) == SIZE && pull(model, &flags) == USB_MODEL_NAK);
    uvc_model_set_faults(model, &(struct uvc_faults){ .stall_at = 10 });
    CHECK(pull(model, &flags) == SIZE);
    CHECK(pull(model, &flags) == USB_MODEL_STALL && pull(model, &flags) == USB_MODEL_STALL);
    CHECK(usb->control(usb->self, clear, NULL, 0, NULL, 0) == 0);
    CHECK(pull(model, &flags) == SIZE);
    CHECK(usb->control(usb->self, clear, NULL, 0, NULL, 0) == 0); /* the host ends the stream */
    CHECK(pull(model, &flags) == USB_MODEL_NAK);
    uvc_model_free(model);
}

TEST(unplugged_it_is_gone_and_forgets_what_was_set)
{
    struct uvc_model *const model = start(&(struct uvc_faults){ .unplug_at_byte = 20000 });
    uint8_t flags, gain[2] = { 9 };

    CHECK(request(model, 0x01, UVC_PROCESSING_GAIN, UVC_PROCESSING, 0, gain, 2) == 0);
    commit(model, 1);
    CHECK(pull(model, &flags) == USB_MODEL_GONE);
    CHECK(request(model, 0x81, UVC_PROCESSING_GAIN, UVC_PROCESSING, 0, gain, 2) == USB_MODEL_GONE);
    uvc_model_replug(model);
    CHECK(uvc_model_value(model, UVC_PROCESSING, UVC_PROCESSING_GAIN) == 64);
    uvc_model_free(model);
}

TEST(what_is_automatic_wanders_and_cannot_be_set_until_it_is_locked)
{
    struct uvc_model *const model = uvc_model_new("CAM1", WIDTH, HEIGHT, 0, NULL);
    uint8_t value[4] = { 200 }, manual = 1, off = 0, white[2] = { 0x88, 0x13 }, flags, why = 0;

    uvc_model_add(model, UVC_YUY2, frames, SIZE);
    commit(model, 1);
    CHECK(pull(model, &flags) == SIZE);
    CHECK(uvc_model_value(model, UVC_CAMERA, UVC_CAMERA_EXPOSURE) != 156);
    CHECK(request(model, 0x01, UVC_CAMERA_EXPOSURE, UVC_CAMERA, 0, value, 4) == USB_MODEL_STALL);
    CHECK(request(model, 0x81, 2, 0, 0, &why, 1) == 1 && why == 2);
    CHECK(request(model, 0x86, UVC_CAMERA_EXPOSURE, UVC_CAMERA, 0, &why, 1) == 1 && why == 7);
    CHECK(request(model, 0x01, UVC_CAMERA_AE_MODE, UVC_CAMERA, 0, &manual, 1) == 0);
    CHECK(request(model, 0x01, UVC_CAMERA_EXPOSURE, UVC_CAMERA, 0, value, 4) == 0);
    CHECK(request(model, 0x01, UVC_PROCESSING_WHITE_AUTO, UVC_PROCESSING, 0, &off, 1) == 0);
    CHECK(request(model, 0x01, UVC_PROCESSING_WHITE, UVC_PROCESSING, 0, white, 2) == 0);
    CHECK(pull(model, &flags) == SIZE && pull(model, &flags) == SIZE);
    CHECK(request(model, 0x81, UVC_CAMERA_EXPOSURE, UVC_CAMERA, 0, value, 4) == 4);
    CHECK(wire_get32(value) == 200);
    CHECK(uvc_model_value(model, UVC_PROCESSING, UVC_PROCESSING_WHITE) == 5000);
    uvc_model_set_faults(model, &(struct uvc_faults){ .always_automatic = true });
    CHECK(request(model, 0x01, UVC_CAMERA_AE_MODE, UVC_CAMERA, 0, &manual, 1) == USB_MODEL_STALL);
    uvc_model_free(model);
}
