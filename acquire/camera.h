/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A camera as a source, whatever interface it has: the settings of its section, stills taken when
 * the panel is at rest or on request, items kept in memory until they are acknowledged. What an
 * interface does itself (open, lock, stream) stands behind struct gsn_grabber.
 *
 * Settings, all in the section of the source:
 *   Format=        pixel format by its V4L2 code: YUYV, RGB3, MJPG, RG10, ... (needed)
 *   Width= Height= pixels (needed); what the camera would change is refused, never taken silently
 *   Fps=           frames a second, a whole number; left alone when not given
 *   Exposure= Gain= WhiteBalance=
 *                  values in the units of the interface (V4L2: exposure 100 us each, white balance
 *                  kelvin; libcamera: us, gain in thousandths, kelvin). Left away: the value the
 *                  camera has now. Automatics are switched off and the values locked either way
 *   AtRest=        frames in a row that must be still before a panel is taken, 2 to 64 (8); "no":
 *                  pictures come by request only. MJPG needs "no", for its frames show nothing
 *                  until they are decoded
 *   Noise=         brightness, 0 to 255, by which neighbouring frames may differ at rest (4)
 *   SilenceS=      seconds without a frame after which it is said and the stream begun anew (5)
 *
 * At open there may be a panel on the stage already: it is taken when at rest, as any other, unless
 * it is the one that was taken last before (the last_facts of gsn_source_options). */
#ifndef GSN_ACQUIRE_CAMERA_H
#define GSN_ACQUIRE_CAMERA_H

#include "acquire/frame.h"
#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_camera_settings {
    const struct gsn_pixel_format *format;
    uint32_t width, height;
    uint32_t fps;                          /* 0: not given */
    int64_t exposure, gain, white_balance; /* -1: not given */
    unsigned at_rest;                      /* 0: by request only */
    float noise;
    int64_t silence_ms;
};

/* Their names, NULL at the end: for gsn_source_ops. */
extern const char *const gsn_camera_keys[];

/* Fails with GSN_E_INPUT and a sentence that names the setting. */
int gsn_camera_settings_read(const struct gsn_source_options *options,
                             struct gsn_camera_settings *ret_settings, struct gsn_error *err);

/* A row of gsn_source_ops: the settings, and a name that is not empty. */
int gsn_camera_check(const char *rest, const struct gsn_source_options *options,
                     struct gsn_error *err);

/* Pictures of one camera, as its interface gives them. self is the interface's.
 * Each may fail with GSN_E_NOTFOUND: the camera was unplugged, nothing will follow. */
struct gsn_grabber_ops {
    int (*start)(void *self, struct gsn_error *err);
    void (*stop)(void *self);
    /* *ret_there 1: a frame, borrowed until release; 0: none now. Never sleeps. Damaged frames are
     * dropped and counted. */
    int (*grab)(void *self, struct gsn_frame *ret_frame, int *ret_there, struct gsn_error *err);
    void (*release)(void *self);
    /* Puts what the controls say now, and whether they are locked, into the frame (its control,
     * control_count and withheld are the grabber's, until the next call). */
    int (*read_back)(void *self, struct gsn_frame *frame, struct gsn_error *err);
    /* Frames dropped as damaged since the last call. */
    unsigned (*damaged)(void *self);
    /* Sleeps until a frame may be there, timeout_ms passed, or stop_fd (-1: none) is readable. */
    int (*wait)(void *self, int timeout_ms, int stop_fd, struct gsn_error *err);
    const char *(*device)(const void *self);
    void (*close)(void *self); /* accepts NULL */
};

struct gsn_grabber {
    const struct gsn_grabber_ops *ops;
    void *self;
    unsigned depth; /* frames that may have been taken before a request, and wait in line */
};

/* Starts the stream. Of the options only last_facts is read. takes: the grabber, also when it
 * fails. gives: a void pointer for the functions below, which are rows of gsn_source_ops and obey
 * their contract. */
int gsn_camera_new(struct gsn_grabber grabber, const struct gsn_camera_settings *settings,
                   const struct gsn_source_options *options, void **ret_self,
                   struct gsn_error *err);

/* An unplugged camera fails with GSN_E_NOTFOUND, but only when no item is left to be read. */
int gsn_camera_poll(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                    struct gsn_error *err);
int gsn_camera_read(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                    size_t *ret_got, struct gsn_error *err);
int gsn_camera_acknowledge(void *self, uint64_t item, struct gsn_error *err);
int gsn_camera_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err);
/* A frame that was exposed before the request is never taken for it. One request at a time: fails
 * with GSN_E_BUSY while the one before has not had its frame. */
int gsn_camera_capture(void *self, enum gsn_source_subject subject, struct gsn_error *err);
const char *gsn_camera_device(const void *self);
void gsn_camera_close(void *self);

#ifdef __cplusplus
}
#endif
#endif
