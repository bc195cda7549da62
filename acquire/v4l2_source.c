/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/v4l2_source.h"

#include <errno.h>
#include <poll.h>
#include <string.h>
#include <sys/ioctl.h>
#include <unistd.h>

#include "acquire/v4l2.h"
#include "pipeline/core/file.h"

int gsn_v4l2_ioctl(const struct gsn_v4l2 *v4l2, unsigned long request, void *argument)
{
    int r;

    do
        r = ioctl(v4l2->fd, request, argument);
    while (r < 0 && errno == EINTR);
    return r;
}

int gsn_v4l2_refused(const struct gsn_v4l2 *v4l2, const char *what, struct gsn_error *err)
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

static void v4l2_free(struct gsn_v4l2 *v4l2)
{
    if (!v4l2)
        return;
    gsn_v4l2_stop(v4l2);
    if (v4l2->fd >= 0)
        (void)close(v4l2->fd);
    gsn_free(v4l2->node);
    gsn_free(v4l2->device);
    gsn_free(v4l2);
}

static int start(void *self, struct gsn_error *err)
{
    return gsn_v4l2_start(self, err);
}

static void stop(void *self)
{
    gsn_v4l2_stop(self);
}

static int grab(void *self, struct gsn_frame *ret_frame, int *ret_there, struct gsn_error *err)
{
    return gsn_v4l2_grab(self, ret_frame, ret_there, err);
}

static void release(void *self)
{
    gsn_v4l2_release(self);
}

static int read_back(void *self, struct gsn_frame *frame, struct gsn_error *err)
{
    return gsn_v4l2_read_back(self, frame, err);
}

static unsigned damaged(void *self)
{
    struct gsn_v4l2 *const v4l2 = self;
    const unsigned count = v4l2->damaged;

    v4l2->damaged = 0;
    return count;
}

/* A hint only: some drivers' poll() is ready when no frame is. */
static int wait_for_frame(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    const struct gsn_v4l2 *const v4l2 = self;
    struct pollfd on[2] = { { .fd = v4l2->fd, .events = POLLIN },
                            { .fd = stop_fd, .events = POLLIN } };

    if (poll(on, 2, timeout_ms) < 0 && errno != EINTR)
        return gsn_v4l2_refused(v4l2, "waiting for a frame", err);
    return GSN_OK;
}

static const char *device(const void *self)
{
    return ((const struct gsn_v4l2 *)self)->device;
}

static void close_camera(void *self)
{
    v4l2_free(self);
}

static const struct gsn_grabber_ops grabber_ops = {
    .start = start,
    .stop = stop,
    .grab = grab,
    .release = release,
    .read_back = read_back,
    .damaged = damaged,
    .wait = wait_for_frame,
    .device = device,
    .close = close_camera,
};

static int query_camera(struct gsn_v4l2 *v4l2, const char *name, struct gsn_error *err)
{
    struct v4l2_capability caps = { 0 };

    if (gsn_v4l2_ioctl(v4l2, VIDIOC_QUERYCAP, &caps) < 0)
        return errno == ENOTTY
                   ? gsn_fail(err, GSN_E_INPUT, "v4l2:%.100s: %.60s is no camera", name, v4l2->node)
                   : gsn_v4l2_refused(v4l2, "asking what it is", err);
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

static int prepare(struct gsn_v4l2 *v4l2, const char *name, struct gsn_error *err)
{
    int r = gsn_v4l2_find(name, &v4l2->node, err);

    if (r >= 0)
        r = gsn_file_open(v4l2->node, &v4l2->fd, err);
    if (r >= 0)
        r = query_camera(v4l2, name, err);
    if (r >= 0)
        r = gsn_v4l2_set_format(v4l2, err);
    return r < 0 ? r : gsn_v4l2_lock_controls(v4l2, err);
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
    struct gsn_v4l2 *v4l2 = gsn_alloc_array(1, sizeof *v4l2);
    int r;

    if (!v4l2)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera");
    v4l2->fd = -1;
    v4l2->held = -1;
    v4l2->device = gsn_format("v4l2:%s", rest);
    r = v4l2->device ? gsn_camera_settings_read(options, &v4l2->settings, err)
                     : gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera");
    if (r >= 0)
        r = prepare(v4l2, rest, err);
    if (r < 0) {
        v4l2_free(v4l2);
        return r;
    }
    return gsn_camera_new((struct gsn_grabber){ &grabber_ops, v4l2, GSN_V4L2_BUFFERS },
                          &v4l2->settings, options, ret_self, err);
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
