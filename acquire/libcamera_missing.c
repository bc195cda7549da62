/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The kind "libcamera" of a program that is not linked with libcamera. */
#include "acquire/camera.h"
#include "acquire/libcamera_source.h"

static int refuse_open(const char *rest, const struct gsn_source_options *options, void **ret_self,
                       struct gsn_error *err)
{
    (void)options;
    (void)ret_self;
    return gsn_fail(err, GSN_E_UNSUPPORTED,
                    "libcamera:%.200s: this program was built without libcamera: install it and "
                    "build again, or address the camera as v4l2:",
                    rest);
}

const struct gsn_source_ops gsn_libcamera_source_ops = {
    .kind = "libcamera",
    .subsystem = "video4linux",
    .settings = gsn_camera_keys,
    .check = gsn_camera_check,
    .open = refuse_open,
    .poll = gsn_camera_poll,
    .read = gsn_camera_read,
    .acknowledge = gsn_camera_acknowledge,
    .wait = gsn_camera_wait,
    .capture = gsn_camera_capture,
    .device = gsn_camera_device,
    .close = gsn_camera_close,
};
