/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/v4l2.h"

#include <errno.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

static uint32_t memory_of(const struct gsn_v4l2 *v4l2)
{
    return v4l2->io == GSN_V4L2_MMAP ? V4L2_MEMORY_MMAP : V4L2_MEMORY_USERPTR;
}

static int request_buffers(struct gsn_v4l2 *v4l2, unsigned count)
{
    struct v4l2_requestbuffers request = { .count = count,
                                           .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                           .memory = memory_of(v4l2) };

    if (gsn_v4l2_ioctl(v4l2, VIDIOC_REQBUFS, &request) < 0)
        return -1;
    v4l2->count = request.count < count ? request.count : count;
    return 0;
}

static void free_buffers(struct gsn_v4l2 *v4l2)
{
    for (unsigned i = 0; i < GSN_V4L2_BUFFERS; i++) {
        struct gsn_v4l2_buffer *const buffer = &v4l2->buffer[i];

        if (buffer->at && !buffer->memory)
            (void)munmap(buffer->at, buffer->size);
        gsn_free(buffer->memory);
        *buffer = (struct gsn_v4l2_buffer){ 0 };
    }
    v4l2->held = -1;
    v4l2->count = 0;
}

/* -1 with errno when this node cannot be mapped. */
static int map_buffers(struct gsn_v4l2 *v4l2)
{
    for (unsigned i = 0; i < v4l2->count; i++) {
        struct v4l2_buffer buffer = { .index = i,
                                      .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                      .memory = V4L2_MEMORY_MMAP };
        void *at;

        if (gsn_v4l2_ioctl(v4l2, VIDIOC_QUERYBUF, &buffer) < 0)
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
static int allocate_buffers(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);

    for (unsigned i = 0; i < v4l2->count; i++) {
        struct gsn_v4l2_buffer *const buffer = &v4l2->buffer[i];

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
static int choose_io(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    if (v4l2->caps & V4L2_CAP_STREAMING) {
        v4l2->io = GSN_V4L2_MMAP;
        if (request_buffers(v4l2, GSN_V4L2_BUFFERS) == 0 && v4l2->count > 0) {
            if (map_buffers(v4l2) == 0)
                return GSN_OK;
            free_buffers(v4l2);
            (void)request_buffers(v4l2, 0);
        } else if (errno == EBUSY || errno == ENODEV) {
            return gsn_v4l2_refused(v4l2, "asking for buffers", err);
        }
        v4l2->io = GSN_V4L2_USERPTR;
        if (request_buffers(v4l2, GSN_V4L2_BUFFERS) == 0 && v4l2->count > 0)
            return allocate_buffers(v4l2, err);
    }
    if (!(v4l2->caps & V4L2_CAP_READWRITE))
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "%.60s: its driver gives frames neither through mapped buffers, nor into "
                        "ours, nor by read()",
                        v4l2->device);
    v4l2->io = GSN_V4L2_READ;
    v4l2->count = 1;
    return allocate_buffers(v4l2, err);
}

static int queue(struct gsn_v4l2 *v4l2, unsigned index)
{
    struct gsn_v4l2_buffer *const own = &v4l2->buffer[index];
    struct v4l2_buffer buffer = { .index = index,
                                  .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                  .memory = memory_of(v4l2) };

    if (v4l2->io == GSN_V4L2_USERPTR) {
        buffer.m.userptr = (unsigned long)own->at;
        buffer.length = (uint32_t)own->size;
    }
    if (gsn_v4l2_ioctl(v4l2, VIDIOC_QBUF, &buffer) < 0)
        return -1;
    own->is_queued = true;
    return 0;
}

/* A buffer the driver would not take back is offered again each time. */
static int queue_all(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    for (unsigned i = 0; i < v4l2->count; i++) {
        if (v4l2->buffer[i].is_queued || v4l2->held == (int)i)
            continue;
        if (queue(v4l2, i) < 0 && errno == ENODEV)
            return gsn_v4l2_refused(v4l2, "queueing a buffer", err);
    }
    return GSN_OK;
}

static int stream_on(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;

    if (gsn_v4l2_ioctl(v4l2, VIDIOC_STREAMON, &type) == 0)
        return GSN_OK;
    if (errno == ENOSPC)
        return gsn_fail(err, GSN_E_IO,
                        "%.60s: the USB bus has no room for this stream: use another port, a lower "
                        "Fps= or a smaller picture",
                        v4l2->device);
    return gsn_v4l2_refused(v4l2, "starting the stream", err);
}

int gsn_v4l2_start(struct gsn_v4l2 *v4l2, struct gsn_error *err)
{
    struct stat st;
    int r;

    if (stat(v4l2->node, &st) < 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "%.60s: the camera is gone: plug it in again",
                        v4l2->device);
    r = choose_io(v4l2, err);
    v4l2->is_on = true;
    if (r >= 0 && v4l2->io != GSN_V4L2_READ)
        r = queue_all(v4l2, err);
    if (r >= 0 && v4l2->io != GSN_V4L2_READ)
        r = stream_on(v4l2, err);
    if (r < 0)
        gsn_v4l2_stop(v4l2);
    return r;
}

void gsn_v4l2_stop(struct gsn_v4l2 *v4l2)
{
    int type = V4L2_BUF_TYPE_VIDEO_CAPTURE;

    if (!v4l2->is_on)
        return;
    v4l2->is_on = false;
    if (v4l2->io != GSN_V4L2_READ)
        (void)gsn_v4l2_ioctl(v4l2, VIDIOC_STREAMOFF, &type);
    free_buffers(v4l2);
    if (v4l2->io != GSN_V4L2_READ)
        (void)request_buffers(v4l2, 0);
}

/* Bytes a frame must have; those of a JPEG are for its end to say. */
static size_t least_bytes(const struct gsn_v4l2 *v4l2)
{
    const struct gsn_pixel_format *const format = v4l2->settings.format;
    const size_t row = (size_t)gsn_pixel_format_row(format, v4l2->pixels.width);
    const size_t rows = format->packing == GSN_PACKING_NV12 ? (size_t)v4l2->pixels.height / 2 * 3
                                                            : (size_t)v4l2->pixels.height;

    return row ? (rows - 1) * v4l2->stride + row : 4;
}

/* The index of a whole frame, -1 when none is there. */
static int dequeue(struct gsn_v4l2 *v4l2, int *ret_index, size_t *ret_size, struct gsn_error *err)
{
    *ret_index = -1;
    for (unsigned tries = 0; tries < 2 * GSN_V4L2_BUFFERS; tries++) {
        struct v4l2_buffer buffer = { .type = V4L2_BUF_TYPE_VIDEO_CAPTURE,
                                      .memory = memory_of(v4l2) };
        int r;

        r = queue_all(v4l2, err);
        if (r < 0)
            return r;
        if (gsn_v4l2_ioctl(v4l2, VIDIOC_DQBUF, &buffer) < 0) {
            v4l2->damaged += errno == EIO;
            return errno == ENODEV ? gsn_v4l2_refused(v4l2, "waiting for a frame", err) : GSN_OK;
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

static int read_frame(struct gsn_v4l2 *v4l2, int *ret_index, size_t *ret_size,
                      struct gsn_error *err)
{
    const ssize_t got = read(v4l2->fd, v4l2->buffer[0].at, v4l2->buffer[0].size);

    *ret_index = -1;
    if (got < 0 && errno == ENODEV)
        return gsn_v4l2_refused(v4l2, "waiting for a frame", err);
    if (got < 0)
        v4l2->damaged += errno == EIO;
    else if (got > 0 && (size_t)got < least_bytes(v4l2))
        v4l2->damaged++;
    else if (got > 0)
        *ret_index = 0;
    *ret_size = got > 0 ? (size_t)got : 0;
    return GSN_OK;
}

int gsn_v4l2_grab(struct gsn_v4l2 *v4l2, struct gsn_frame *ret_frame, int *ret_there,
                  struct gsn_error *err)
{
    int index = -1, r = GSN_OK;
    size_t size = 0;

    if (v4l2->is_on)
        r = v4l2->io == GSN_V4L2_READ ? read_frame(v4l2, &index, &size, err)
                                      : dequeue(v4l2, &index, &size, err);
    if (r < 0)
        return r;
    *ret_there = index >= 0;
    if (index < 0)
        return GSN_OK;
    v4l2->held = index;
    gsn_v4l2_describe(v4l2, ret_frame);
    ret_frame->bytes = v4l2->buffer[index].at;
    ret_frame->size = size;
    return GSN_OK;
}

void gsn_v4l2_release(struct gsn_v4l2 *v4l2)
{
    v4l2->held = -1; /* queued again before the next frame is asked for */
}
