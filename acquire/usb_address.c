/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/usb_address.h"

#include <ctype.h>
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"

/* Four hexadecimal digits and nothing else up to the end of a part. */
static int read_id(const char *text, uint16_t *ret_id)
{
    for (int i = 0; i < 4; i++)
        if (!isxdigit((unsigned char)text[i]))
            return 0;
    *ret_id = (uint16_t)strtoul(text, NULL, 16);
    return text[4] == ':' || text[4] == '\0';
}

static int wrong(const char *rest, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "\"%.100s\" names no USB device: give its serial number, VVVV:PPPP or "
                    "VVVV:PPPP:SERIAL with the hexadecimal numbers that lsusb prints, or any",
                    rest);
}

static int read_serial(const char *serial, const char *rest, struct gsn_usb_address *address,
                       struct gsn_error *err)
{
    const size_t length = strlen(serial);

    if (length == 0 || length >= sizeof address->serial)
        return wrong(rest, err);
    for (size_t i = 0; i < length; i++)
        if (iscntrl((unsigned char)serial[i]))
            return wrong(rest, err);
    memcpy(address->serial, serial, length + 1);
    return GSN_OK;
}

int gsn_usb_address_read(const char *rest, struct gsn_usb_address *ret_address,
                         struct gsn_error *err)
{
    struct gsn_usb_address address = { 0 };
    int r = GSN_OK;

    if (strcmp(rest, "any") == 0) {
        *ret_address = address;
        return GSN_OK;
    }
    if (!strchr(rest, ':')) {
        r = read_serial(rest, rest, &address, err);
    } else {
        if (!read_id(rest, &address.vendor) || rest[4] != ':' ||
            !read_id(rest + 5, &address.product))
            return wrong(rest, err);
        address.has_ids = 1;
        if (rest[9] == ':')
            r = read_serial(rest + 10, rest, &address, err);
    }
    if (r >= 0)
        *ret_address = address;
    return r;
}

int gsn_usb_address_matches(const struct gsn_usb_address *address, uint16_t vendor,
                            uint16_t product, const char *serial)
{
    return (!address->has_ids || (address->vendor == vendor && address->product == product)) &&
           (!address->serial[0] || strcmp(address->serial, serial) == 0);
}

/* The first file open in /proc/PROCESS/fd whose path ends with end; 0 when there is none. */
static int find_open(const char *process, const char *end, char *ret_path, size_t size)
{
    char path[64], link[400];
    const size_t tail = strlen(end);
    struct dirent *entry;
    DIR *dir;
    int found = 0;

    (void)snprintf(path, sizeof path, "/proc/%.20s/fd", process);
    dir = opendir(path);
    while (dir && !found && (entry = readdir(dir))) {
        const ssize_t length = readlinkat(dirfd(dir), entry->d_name, link, sizeof link);

        found = length >= (ssize_t)tail && (size_t)length < size &&
                memcmp(link + (size_t)length - tail, end, tail) == 0;
        if (found) {
            memcpy(ret_path, link, (size_t)length);
            ret_path[length] = '\0';
        }
    }
    if (dir)
        (void)closedir(dir);
    return found;
}

/* Whether the process has this very file open. */
static int has_open(const char *process, const char *node)
{
    char path[400];

    return find_open(process, node, path, sizeof path) && strcmp(path, node) == 0;
}

static void describe_process(const char *process, char *ret_text, size_t size)
{
    char path[64], name[64] = "";
    ssize_t length = 0;
    int fd;

    (void)snprintf(path, sizeof path, "/proc/%.20s/comm", process);
    if (gsn_file_open(path, &fd, NULL) >= 0) {
        length = read(fd, name, sizeof name - 1);
        (void)close(fd);
    }
    name[length > 0 ? length : 0] = '\0';
    name[strcspn(name, "\n")] = '\0';
    (void)snprintf(ret_text, size, "%s (process %.20s)", name[0] ? name : "another program",
                   process);
}

int gsn_usb_holder(unsigned bus, unsigned device, char *ret_text, size_t size)
{
    char name[40], node[400], own[24];
    struct dirent *entry;
    DIR *proc;
    int found = 0;

    (void)snprintf(name, sizeof name, "/dev/bus/usb/%03u/%03u", bus, device);
    /* Who asks has it open as well; an emulated bus keeps the file elsewhere. */
    if (!find_open("self", name, node, sizeof node))
        (void)snprintf(node, sizeof node, "%s", name);
    (void)snprintf(own, sizeof own, "%ld", (long)getpid());
    proc = opendir("/proc");
    while (proc && !found && (entry = readdir(proc))) {
        if (!isdigit((unsigned char)entry->d_name[0]) || strcmp(entry->d_name, own) == 0)
            continue;
        found = has_open(entry->d_name, node);
        if (found)
            describe_process(entry->d_name, ret_text, size);
    }
    if (proc)
        (void)closedir(proc);
    return found;
}
