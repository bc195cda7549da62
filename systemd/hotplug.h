/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Hears from udev that a device came. Events are hints: several within a moment are told as one,
 * and whoever is told looks for himself. */
#ifndef GSN_SYSTEMD_HOTPLUG_H
#define GSN_SYSTEMD_HOTPLUG_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <systemd/sd-event.h>

struct gsn_hotplug;

/* Listens to the subsystems that these addresses wait for; others wake nobody. keeps: loop,
 * context. gives; NULL in ret_hotplug when no address waits for any. Fails with GSN_E_IO when udev
 * cannot be heard, which leaves the service with looking every minute. */
int gsn_hotplug_new(sd_event *loop, const char *const *addresses, size_t count,
                    void (*arrived)(void *context, const char *subsystem), void *context,
                    struct gsn_hotplug **ret_hotplug, struct gsn_error *err);
void gsn_hotplug_free(struct gsn_hotplug *hotplug);
GSN_DEFINE_AUTO(gsn_hotplug);

#endif
