/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/devices.h"

#include "acquire/usb_address.h"
#include "acquire/usb_transport.h"
#include "acquire/v4l2_source.h"
#include "pipeline/core/file.h"

#include <dirent.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MOST_NAME_BYTES = 4096 };

static const char BY_ID[] = "/dev/v4l/by-id";

/* Takes the three texts, which are NULL when memory ran out. */
static int add(struct gsn_devices *devices, char *address, char *name, char *note,
               struct gsn_error *err)
{
    struct gsn_device *more =
        gsn_realloc_array(devices->at, devices->count + 1, sizeof *devices->at);

    if (more)
        devices->at = more;
    if (more && address && name && note) {
        more[devices->count++] = (struct gsn_device){ address, name, note };
        return GSN_OK;
    }
    gsn_free(address);
    gsn_free(name);
    gsn_free(note);
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a list of devices");
}

/* ---- USB --------------------------------------------------------------------------------- */

static char *usb_address(const struct gsn_ptp_usb_devices *all, const struct gsn_ptp_usb_device *of)
{
    size_t same = 0;

    for (size_t i = 0; i < all->count; i++)
        same += strcmp(all->at[i].serial, of->serial) == 0;
    if (!of->serial[0])
        return gsn_format("ptp:%04x:%04x", (unsigned)of->vendor, (unsigned)of->product);
    if (same > 1)
        return gsn_format("ptp:%04x:%04x:%s", (unsigned)of->vendor, (unsigned)of->product,
                          of->serial);
    return gsn_format("ptp:%s", of->serial);
}

static char *usb_note(const struct gsn_ptp_usb_device *device)
{
    char holder[160] = "";

    if (gsn_usb_holder(device->bus, device->number, holder, sizeof holder))
        return gsn_format("held by %s", holder);
    if (device->refused)
        return gsn_strdup("may not be opened by this user, so its serial number is not known");
    return gsn_strdup("");
}

static int add_usb(struct gsn_devices *devices, struct gsn_error *err)
{
    struct gsn_ptp_usb_devices found;
    int r = gsn_ptp_usb_list(&found, err);

    for (size_t i = 0; r >= 0 && i < found.count; i++)
        r = add(devices, usb_address(&found, &found.at[i]),
                found.at[i].name[0] ? gsn_strdup(found.at[i].name)
                                    : gsn_format("%04x:%04x", (unsigned)found.at[i].vendor,
                                                 (unsigned)found.at[i].product),
                usb_note(&found.at[i]), err);
    return r;
}

/* ---- V4L2 -------------------------------------------------------------------------------- */

/* What the driver calls the node that a link leads to; the link's own name where it does not say.
 */
static char *camera_name(const char *link)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", BY_ID, link);
    gsn_auto_mem(char) name = NULL;
    gsn_auto_mem(uint8_t) text = NULL;
    struct gsn_error quiet = { 0 };
    char node[PATH_MAX];
    const ssize_t length = path ? readlink(path, node, sizeof node - 1) : -1;
    size_t size;

    if (length < 0)
        return gsn_strdup(link);
    node[length] = '\0';
    name = gsn_format("/sys/class/video4linux/%s/name", basename(node));
    if (!name || gsn_file_read(name, MOST_NAME_BYTES, &text, &size, &quiet) < 0)
        return gsn_strdup(link);
    text[strcspn((const char *)text, "\n")] = '\0';
    return gsn_strdup((const char *)text);
}

/* The first node of a camera takes pictures; others carry what is said about them. */
static int takes_pictures(const struct dirent *entry)
{
    static const char first[] = "-video-index0";
    const size_t length = strlen(entry->d_name), tail = sizeof first - 1;

    return length > tail && strcmp(entry->d_name + length - tail, first) == 0;
}

static int by_address(const void *left, const void *right)
{
    return strcmp(((const struct gsn_device *)left)->address,
                  ((const struct gsn_device *)right)->address);
}

static int add_cameras(struct gsn_devices *devices, struct gsn_error *err)
{
    const size_t first = devices->count;
    DIR *folder = opendir(BY_ID);
    const struct dirent *entry;
    int r = GSN_OK;

    while (r >= 0 && folder && (entry = readdir(folder)))
        if (takes_pictures(entry)) {
            char note[400];

            gsn_v4l2_note(entry->d_name, note, sizeof note);
            r = add(devices, gsn_format("v4l2:%s", entry->d_name), camera_name(entry->d_name),
                    gsn_strdup(note), err);
        }
    if (folder)
        (void)closedir(folder);
    if (devices->count > first)
        qsort(devices->at + first, devices->count - first, sizeof *devices->at, by_address);
    return r;
}

/* ------------------------------------------------------------------------------------------ */

int gsn_devices_list(struct gsn_devices **ret_devices, struct gsn_error *err)
{
    gsn_auto(gsn_devices) devices = gsn_alloc_array(1, sizeof *devices);
    int r = devices ? add_usb(devices, err)
                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for a list of devices");

    if (r >= 0)
        r = add_cameras(devices, err);
    if (r >= 0)
        *ret_devices = gsn_steal(&devices);
    return r;
}

void gsn_devices_free(struct gsn_devices *devices)
{
    if (!devices)
        return;
    for (size_t i = 0; i < devices->count; i++) {
        gsn_free(devices->at[i].address);
        gsn_free(devices->at[i].name);
        gsn_free(devices->at[i].note);
    }
    gsn_free(devices->at);
    gsn_free(devices);
}
