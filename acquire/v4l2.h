/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One opened V4L2 capture node and its parts. Private to this folder. */
#ifndef GSN_ACQUIRE_V4L2_H
#define GSN_ACQUIRE_V4L2_H

#include "acquire/camera.h"

#include <linux/videodev2.h>
#include <stdbool.h>

enum { GSN_V4L2_BUFFERS = 4, GSN_V4L2_CONTROLS = 6 };

enum gsn_v4l2_io { GSN_V4L2_MMAP, GSN_V4L2_USERPTR, GSN_V4L2_READ };

struct gsn_v4l2_buffer {
    uint8_t *at;
    size_t size;
    void *memory; /* for USERPTR and READ: what at lies in */
    bool is_queued;
};

/* One thing that must not change by itself from panel to panel. */
struct gsn_v4l2_lock {
    const char *name, *unit;
    uint32_t automatic; /* control that switches it; 0: none */
    int32_t off;        /* the value that means "by hand" */
    uint32_t control;   /* the value's; 0: none */
    int64_t value;      /* as locked */
    bool is_known;
    char unlock[140]; /* why it is not locked; empty: it is */
};

struct gsn_v4l2 {
    int fd;
    char *node;   /* /dev/videoN, where it was found this time */
    char *device; /* card and address, for people */
    uint32_t caps;
    struct gsn_camera_settings settings;
    uint32_t stride, frame_bytes; /* as the driver read them back */
    struct v4l2_pix_format pixels;

    size_t lock_count;
    struct gsn_v4l2_lock lock[GSN_V4L2_CONTROLS];
    struct gsn_frame_control control[GSN_V4L2_CONTROLS];
    char unlock[GSN_V4L2_CONTROLS][140];
    char withheld[300];

    enum gsn_v4l2_io io;
    unsigned count; /* buffers */
    struct gsn_v4l2_buffer buffer[GSN_V4L2_BUFFERS];
    int held; /* index of the frame the caller has; -1: none */
    bool is_on;
    unsigned damaged;
};

/* ioctl() again after a signal; -1 with errno. */
int gsn_v4l2_ioctl(const struct gsn_v4l2 *v4l2, unsigned long request, void *argument);

/* Writes what errno says of it: GSN_E_NOTFOUND when the camera is gone, GSN_E_BUSY with the name of
 * who holds it, else GSN_E_IO. */
int gsn_v4l2_refused(const struct gsn_v4l2 *v4l2, const char *what, struct gsn_error *err);

/* gives: the node of the camera with this by-id name or serial.
 * Fails with GSN_E_NOTFOUND, or GSN_E_INPUT when two cameras have that serial. */
int gsn_v4l2_find(const char *name, char **ret_node, struct gsn_error *err);
/* Judges a name without looking for the camera: GSN_E_INPUT for a number of a node. */
int gsn_v4l2_check_name(const char *name, struct gsn_error *err);
/* Who else has the node open, as "PID (program)"; empty when that cannot be found out. */
void gsn_v4l2_holder(const char *node, char *ret_text, size_t size);

/* Sets format, size and rate and reads them back. */
int gsn_v4l2_set_format(struct gsn_v4l2 *v4l2, struct gsn_error *err);
/* Puts the format and what it means into a frame. */
void gsn_v4l2_describe(const struct gsn_v4l2 *v4l2, struct gsn_frame *ret_frame);

/* Automatics off, values set and read back. Fails with GSN_E_INPUT when a setting is out of the
 * control's range, or NOTFOUND; what cannot be locked is no failure but noted. */
int gsn_v4l2_lock_controls(struct gsn_v4l2 *v4l2, struct gsn_error *err);
int gsn_v4l2_read_back(struct gsn_v4l2 *v4l2, struct gsn_frame *frame, struct gsn_error *err);

int gsn_v4l2_start(struct gsn_v4l2 *v4l2, struct gsn_error *err);
void gsn_v4l2_stop(struct gsn_v4l2 *v4l2);
int gsn_v4l2_grab(struct gsn_v4l2 *v4l2, struct gsn_frame *ret_frame, int *ret_there,
                  struct gsn_error *err);
void gsn_v4l2_release(struct gsn_v4l2 *v4l2);

#endif
