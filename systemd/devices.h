/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is plugged in and could be a source: Still Image devices on USB, cameras of V4L2; each with
 * the address under which the configuration names it. */
#ifndef GSN_SYSTEMD_DEVICES_H
#define GSN_SYSTEMD_DEVICES_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

/* Texts are owned; name is as the device says it: any bytes. */
struct gsn_device {
    char *address; /* "ptp:SERIAL", "v4l2:NAME" */
    char *name;
    char *note; /* why it cannot be used as it stands, or empty */
};

struct gsn_devices {
    size_t count;
    struct gsn_device *at;
};

/* gives: Still Image devices first. Opens none for longer than its serial number takes. */
int gsn_devices_list(struct gsn_devices **ret_devices, struct gsn_error *err);
void gsn_devices_free(struct gsn_devices *devices);
GSN_DEFINE_AUTO(gsn_devices);

#endif
