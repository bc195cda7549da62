/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cameras of the kernel's V4L2 interface: USB cameras (UVC) and frame grabbers.
 *
 * "v4l2:NAME", where NAME is a file name in /dev/v4l/by-id or the camera's USB serial number.
 * /dev/videoN and videoN are refused: the numbers are dealt anew at each boot, and another camera
 * would be taken for this one. The settings are those of a camera (acquire/camera.h); the format is
 * set, read back, and refused when the driver changed anything of it, with a list of what the
 * camera has.
 *
 * Automatic exposure, gain and white balance are switched off, the values set and read back. Where
 * that cannot be done (no such control, held by another, read-only, inactive, or it reads
 * differently afterwards) the camera works, but its frames say "not to be measured" with the
 * reason. Frames of one plane only; for sensors on a CSI bus there is libcamera. */
#ifndef GSN_ACQUIRE_V4L2_SOURCE_H
#define GSN_ACQUIRE_V4L2_SOURCE_H

#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const struct gsn_source_ops gsn_v4l2_source_ops;

#ifdef __cplusplus
}
#endif
#endif
