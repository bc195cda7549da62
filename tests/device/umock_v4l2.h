/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cameras behind /dev/videoN, sysfs and V4L2's ioctls as umockdev makes them believed: this process
 * and its children meet them unmodified. They give the frames they were handed, one for each buffer
 * asked back, and nothing by themselves: no clock is involved.
 *
 * The process needs libumockdev-preload in LD_PRELOAD (CMake's gsn_umock_test() sees to it). */
#ifndef GSN_TESTS_DEVICE_UMOCK_V4L2_H
#define GSN_TESTS_DEVICE_UMOCK_V4L2_H

#include <stddef.h>
#include <stdint.h>

enum { V4L2_MOCK_SIZES = 4, V4L2_MOCK_CONTROLS = 8 };

struct v4l2_mock_size {
    uint32_t fourcc, width, height;
};

struct v4l2_mock_control {
    uint32_t id; /* 0: none */
    int32_t minimum, maximum, value;
    uint32_t flags;
    int set_errno;  /* setting it fails with this */
    int is_stuck;   /* setting it succeeds and changes nothing */
    uint32_t rules; /* inactive while the control with this id is not manual (0 or, for exposure, 1)
                     */
};

struct v4l2_mock_recipe {
    const char *card, *serial;
    const char *by_id;          /* its name in /dev/v4l/by-id; NULL: none */
    const uint8_t *descriptors; /* of its USB device, as in sysfs; NULL: it is none */
    size_t descriptors_size;
    int is_pty; /* a node that cannot be mapped */
    int no_mmap, no_userptr, has_read;
    struct v4l2_mock_size size[V4L2_MOCK_SIZES]; /* what is asked for and not here becomes the
                                                    first, as drivers do */
    uint32_t padding;                            /* bytes at the end of each row */
    uint32_t colorspace, encoding, quantization;
    struct v4l2_mock_control control[V4L2_MOCK_CONTROLS];
};

struct v4l2_mock;
struct v4l2_mock_camera;

/* NULL when the process has no umockdev-preload. One at a time in a process. */
struct v4l2_mock *v4l2_mock_new(void);
void v4l2_mock_free(struct v4l2_mock *mock);
/* borrows: the directory that holds dev/ and sys/. */
const char *v4l2_mock_root(const struct v4l2_mock *mock);

/* It appears as /dev/videoNUMBER (0..7). */
struct v4l2_mock_camera *v4l2_mock_plug(struct v4l2_mock *mock, unsigned number,
                                        const struct v4l2_mock_recipe *recipe);
/* The node and its links go; who has it open gets ENODEV from now on. */
void v4l2_mock_unplug(struct v4l2_mock_camera *camera);

/* Hands a copy of a frame to the camera, padding and all; flags are those of the buffer. */
void v4l2_mock_push(struct v4l2_mock_camera *camera, const void *bytes, size_t size,
                    uint32_t flags);
/* Frames not given away yet. */
size_t v4l2_mock_waiting(struct v4l2_mock_camera *camera);

/* The next count requests of this kind (VIDIOC_...) fail with error. */
void v4l2_mock_fail(struct v4l2_mock_camera *camera, unsigned long request, int error,
                    unsigned count);
/* How often it was asked. */
unsigned v4l2_mock_asked(struct v4l2_mock_camera *camera, unsigned long request);
/* Somebody else turns a control. */
void v4l2_mock_turn(struct v4l2_mock_camera *camera, uint32_t id, int32_t value);
int32_t v4l2_mock_value(struct v4l2_mock_camera *camera, uint32_t id);

#endif
