/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which camera a V4L2 name means: a file name in /dev/v4l/by-id, or the camera's USB serial number;
 * who holds it, and what can be said of it before anybody opens it. */
#ifndef GSN_ACQUIRE_V4L2_DEVICE_H
#define GSN_ACQUIRE_V4L2_DEVICE_H

#include "pipeline/core/error.h"

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the node of the camera with this by-id name or serial.
 * Fails with GSN_E_NOTFOUND, or GSN_E_INPUT when two cameras have that serial. */
int gsn_v4l2_find(const char *name, char **ret_node, struct gsn_error *err);
/* Judges a name without looking for the camera: GSN_E_INPUT for a number of a node. */
int gsn_v4l2_check_name(const char *name, struct gsn_error *err);
/* Who else has the node open, as "PID (program)"; empty when that cannot be found out. */
void gsn_v4l2_holder(const char *node, char *ret_text, size_t size);

/* What its USB descriptors say against the camera of this name before anybody opens it: that it
 * cannot be locked, and why. Empty when nothing does, or when it is no USB camera. */
void gsn_v4l2_note(const char *name, char *ret_note, size_t size);

#ifdef __cplusplus
}
#endif
#endif
