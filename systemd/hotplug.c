/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/hotplug.h"

#include <errno.h>
#include <libudev.h>
#include <stdbool.h>
#include <string.h>

#include "acquire/source.h"

/* A device comes with several events (itself, its interfaces, the rules' work on them); the last
 * one is followed by this much quiet. */
enum { QUIET_MS = 400, MOST_SUBSYSTEMS = 8 };

struct subsystem {
    const char *name;
    bool came;
};

struct gsn_hotplug {
    sd_event *loop;
    struct udev *udev;
    struct udev_monitor *monitor;
    sd_event_source *events, *quiet;
    void (*arrived)(void *context, const char *subsystem);
    void *context;
    size_t count;
    struct subsystem at[MOST_SUBSYSTEMS];
};

void gsn_hotplug_free(struct gsn_hotplug *hotplug)
{
    if (!hotplug)
        return;
    (void)sd_event_source_disable_unref(hotplug->events);
    (void)sd_event_source_disable_unref(hotplug->quiet);
    if (hotplug->monitor)
        (void)udev_monitor_unref(hotplug->monitor);
    if (hotplug->udev)
        (void)udev_unref(hotplug->udev);
    gsn_free(hotplug);
}

static int on_quiet(sd_event_source *source, uint64_t usec, void *context)
{
    struct gsn_hotplug *const hotplug = context;

    (void)source;
    (void)usec;
    for (size_t i = 0; i < hotplug->count; i++) {
        if (hotplug->at[i].came)
            hotplug->arrived(hotplug->context, hotplug->at[i].name);
        hotplug->at[i].came = false;
    }
    return 0;
}

static void note(struct gsn_hotplug *hotplug, struct udev_device *device)
{
    const char *const action = udev_device_get_action(device);
    const char *const subsystem = udev_device_get_subsystem(device);

    if (!action || !subsystem || strcmp(action, "remove") == 0 || strcmp(action, "unbind") == 0)
        return;
    for (size_t i = 0; i < hotplug->count; i++)
        if (strcmp(hotplug->at[i].name, subsystem) == 0)
            hotplug->at[i].came = true;
}

static int on_event(sd_event_source *source, int fd, uint32_t revents, void *context)
{
    struct gsn_hotplug *const hotplug = context;
    struct udev_device *device;

    (void)source;
    (void)fd;
    (void)revents;
    while ((device = udev_monitor_receive_device(hotplug->monitor))) {
        note(hotplug, device);
        (void)udev_device_unref(device);
    }
    hotplug->quiet = sd_event_source_disable_unref(hotplug->quiet);
    (void)sd_event_add_time_relative(hotplug->loop, &hotplug->quiet, CLOCK_MONOTONIC,
                                     QUIET_MS * 1000, 0, on_quiet, hotplug);
    return 0;
}

static void add_subsystem(struct gsn_hotplug *hotplug, const char *name)
{
    for (size_t i = 0; i < hotplug->count; i++)
        if (strcmp(hotplug->at[i].name, name) == 0)
            return;
    if (hotplug->count < MOST_SUBSYSTEMS)
        hotplug->at[hotplug->count++] = (struct subsystem){ .name = name };
}

static int listen_to(struct gsn_hotplug *hotplug, struct gsn_error *err)
{
    int r = 0;

    hotplug->udev = udev_new();
    if (hotplug->udev)
        hotplug->monitor = udev_monitor_new_from_netlink(hotplug->udev, "udev");
    if (!hotplug->monitor)
        return gsn_fail(err, GSN_E_IO, "udev cannot be heard: %s", strerror(errno));
    for (size_t i = 0; i < hotplug->count; i++)
        (void)udev_monitor_filter_add_match_subsystem_devtype(hotplug->monitor, hotplug->at[i].name,
                                                              NULL);
    r = udev_monitor_enable_receiving(hotplug->monitor);
    if (r >= 0)
        r = sd_event_add_io(hotplug->loop, &hotplug->events, udev_monitor_get_fd(hotplug->monitor),
                            EPOLLIN, on_event, hotplug);
    return r < 0 ? gsn_fail(err, GSN_E_IO, "udev cannot be heard: %s", strerror(-r)) : GSN_OK;
}

int gsn_hotplug_new(sd_event *loop, const char *const *addresses, size_t count,
                    void (*arrived)(void *context, const char *subsystem), void *context,
                    struct gsn_hotplug **ret_hotplug, struct gsn_error *err)
{
    gsn_auto(gsn_hotplug) hotplug = gsn_alloc_array(1, sizeof *hotplug);
    int r;

    if (!hotplug)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a monitor of devices");
    hotplug->loop = loop;
    hotplug->arrived = arrived;
    hotplug->context = context;
    for (size_t i = 0; i < count; i++) {
        const char *const subsystem = gsn_source_subsystem(addresses[i]);

        if (subsystem)
            add_subsystem(hotplug, subsystem);
    }
    if (hotplug->count == 0) {
        *ret_hotplug = NULL;
        return GSN_OK;
    }
    r = listen_to(hotplug, err);
    if (r < 0)
        return r;
    *ret_hotplug = gsn_steal(&hotplug);
    return GSN_OK;
}
