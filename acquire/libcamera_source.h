/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cameras by libcamera: sensors on a CSI bus, and what else it has a handler for.
 *
 * "libcamera:ID", where ID is libcamera's own name of the camera ("cam -l" lists them); it is made
 * of the place the camera is plugged into and stays the same over reboots. A USB camera on a
 * controller that the firmware does not name has none: address that as v4l2:. The settings are
 * those of a camera (acquire/camera.h); Gain is in thousandths.
 *
 * One source of this kind in a process, for libcamera allows one manager there. A program that is
 * not linked with gsn_libcamera knows the kind and judges its settings, but cannot open it. */
#ifndef GSN_ACQUIRE_LIBCAMERA_SOURCE_H
#define GSN_ACQUIRE_LIBCAMERA_SOURCE_H

#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const struct gsn_source_ops gsn_libcamera_source_ops;

#ifdef __cplusplus
}
#endif
#endif
