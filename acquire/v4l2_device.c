/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which camera a V4L2 name means, who holds it, and what its USB descriptors say against it.
 *
 * Numbers of nodes (/dev/video0) are dealt anew at each boot, so a name is a file of /dev/v4l/by-id
 * or the serial number that sysfs has for the USB device. Of a camera with several nodes the first
 * takes pictures. Who holds a node is looked for in /proc/PID/fd, by name first: asking for more of
 * a file that is not ours may take for ever. The descriptors (acquire/uvc.h) say before anybody
 * opens the camera whether its automatics can be switched off at all.
 *
 * How it fails: GSN_E_NOTFOUND with "is it plugged in?", GSN_E_INPUT when two cameras have one
 * serial number; a note is empty where nothing is known. */
#include "acquire/v4l2_device.h"

#include <dirent.h>
#include <errno.h>
#include <limits.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/sysmacros.h>
#include <unistd.h>

#include "acquire/uvc.h"
#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"

enum { V4L2_MAJOR = 81 };

static const char by_id[] = "/dev/v4l/by-id";
static const char in_sysfs[] = "/sys/class/video4linux";

int gsn_v4l2_check_name(const char *name, struct gsn_error *err)
{
    const char *const number = strncmp(name, "video", 5) == 0 ? name + 5 : "";
    const bool is_number = number[0] && strspn(number, "0123456789") == strlen(number);

    if (is_number || strncmp(name, "/dev/video", 10) == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "v4l2:%.200s: these numbers are dealt anew at each boot and would name "
                        "another camera; give a name from %s or the camera's serial number",
                        name, by_id);
    if (!name[0] || strchr(name, '/') || name[0] == '.')
        return gsn_fail(err, GSN_E_INPUT,
                        "v4l2:%.200s: give a file name from %s, or the camera's serial number",
                        name, by_id);
    return GSN_OK;
}

/* A line of a file in sysfs; empty when there is none. */
static void read_line(const char *path, char *ret_line, size_t size)
{
    int fd = -1;
    ssize_t got = 0;

    ret_line[0] = '\0';
    if (gsn_file_open(path, &fd, NULL) < 0)
        return;
    got = read(fd, ret_line, size - 1);
    (void)close(fd);
    ret_line[got > 0 ? got : 0] = '\0';
    ret_line[strcspn(ret_line, "\n")] = '\0';
}

static bool has_attribute(const char *video, const char *attribute, const char *value)
{
    char path[PATH_MAX], line[256];

    (void)snprintf(path, sizeof path, "%s/%s/%s", in_sysfs, video, attribute);
    read_line(path, line, sizeof line);
    return strcmp(line, value) == 0;
}

/* The nodes of a USB camera hang on its interface, the serial on the device above that. Its first
 * node takes pictures; those behind it (index 1, ...) are of another kind. */
static int find_serial(const char *serial, char *ret_node, size_t size, struct gsn_error *err)
{
    const struct dirent *entry;
    DIR *const dir = opendir(in_sysfs);
    unsigned count = 0;

    while (dir && (entry = readdir(dir))) {
        if (entry->d_name[0] == '.' || !has_attribute(entry->d_name, "device/../serial", serial) ||
            !has_attribute(entry->d_name, "index", "0"))
            continue;
        (void)snprintf(ret_node, size, "/dev/%.200s", entry->d_name);
        count++;
    }
    if (dir)
        (void)closedir(dir);
    if (count == 0)
        return gsn_fail(err, GSN_E_NOTFOUND,
                        "v4l2:%.200s: no camera has this name in %s, or this serial number: is it "
                        "plugged in?",
                        serial, by_id);
    if (count > 1)
        return gsn_fail(err, GSN_E_INPUT,
                        "v4l2:%.200s: %u cameras have this serial number; give a name from %s",
                        serial, count, by_id);
    return GSN_OK;
}

/* The links of by-id lead to ../../videoN. */
static bool find_link(const char *name, char *ret_node, size_t size)
{
    char path[PATH_MAX], target[PATH_MAX];
    const char *last;
    ssize_t length;

    (void)snprintf(path, sizeof path, "%s/%.200s", by_id, name);
    length = readlink(path, target, sizeof target - 1);
    if (length <= 0)
        return false;
    target[length] = '\0';
    last = strrchr(target, '/');
    (void)snprintf(ret_node, size, "/dev/%.200s", last ? last + 1 : target);
    return true;
}

int gsn_v4l2_find(const char *name, char **ret_node, struct gsn_error *err)
{
    char node[256];
    struct stat st;
    int r = GSN_OK;

    if (!find_link(name, node, sizeof node))
        r = find_serial(name, node, sizeof node, err);
    if (r < 0)
        return r;
    /* By its path: an opened descriptor says less (tests put other files there). */
    if (stat(node, &st) < 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "v4l2:%.200s: %.200s: %s", name, node,
                        strerror(errno));
    if (!S_ISCHR(st.st_mode) || major(st.st_rdev) != V4L2_MAJOR)
        return gsn_fail(err, GSN_E_INPUT, "v4l2:%.200s: %.200s is no video device", name, node);
    *ret_node = gsn_strdup(node);
    return *ret_node ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera");
}

/* Whether this descriptor of a process is the node. Its name is looked at first: asking for more
 * of a file that is none of ours may take for ever (a network that is gone). */
static bool is_node(const char *descriptor, const char *node)
{
    char target[PATH_MAX];
    const ssize_t length = readlink(descriptor, target, sizeof target - 1);
    const char *last;
    struct stat held, own;

    target[length > 0 ? length : 0] = '\0';
    last = strrchr(target, '/');
    return last && strcmp(last, strrchr(node, '/')) == 0 && stat(descriptor, &held) == 0 &&
           stat(node, &own) == 0 && held.st_dev == own.st_dev && held.st_ino == own.st_ino;
}

static bool has_open(const char *pid, const char *node)
{
    char path[PATH_MAX];
    const struct dirent *entry;
    bool found = false;
    DIR *dir;

    (void)snprintf(path, sizeof path, "/proc/%.20s/fd", pid);
    dir = opendir(path);
    while (dir && !found && (entry = readdir(dir))) {
        (void)snprintf(path, sizeof path, "/proc/%.20s/fd/%.20s", pid, entry->d_name);
        found = is_node(path, node);
    }
    if (dir)
        (void)closedir(dir);
    return found;
}

void gsn_v4l2_holder(const char *node, char *ret_text, size_t size)
{
    const struct dirent *entry;
    DIR *const dir = opendir("/proc");
    char self[24], path[64], name[64];

    ret_text[0] = '\0';
    (void)snprintf(self, sizeof self, "%ld", (long)getpid());
    while (dir && !ret_text[0] && (entry = readdir(dir))) {
        if (strspn(entry->d_name, "0123456789") != strlen(entry->d_name) ||
            strcmp(entry->d_name, self) == 0 || !has_open(entry->d_name, node))
            continue;
        (void)snprintf(path, sizeof path, "/proc/%.20s/comm", entry->d_name);
        read_line(path, name, sizeof name);
        (void)snprintf(ret_text, size, "process %.20s (%s)", entry->d_name, name);
    }
    if (dir)
        (void)closedir(dir);
}

enum { MOST_DESCRIPTORS = 65536 };

/* The descriptors of the USB device that a node hangs on; 0 bytes when it hangs on none. */
static size_t read_descriptors(const char *node, uint8_t *bytes, size_t room)
{
    const char *const name = strrchr(node, '/') + 1;
    char path[300];
    size_t size = 0;
    ssize_t got = 1;
    int fd = -1;

    (void)snprintf(path, sizeof path, "/sys/class/video4linux/%.100s/device/../descriptors", name);
    if (gsn_file_open(path, &fd, NULL) < 0)
        return 0;
    while (got > 0 && size < room) {
        got = read(fd, bytes + size, room - size);
        size += got > 0 ? (size_t)got : 0;
    }
    (void)close(fd);
    return size;
}

static void judge_descriptors(const uint8_t *bytes, size_t size, char *ret_note, size_t room)
{
    gsn_auto(gsn_uvc) uvc = NULL;
    struct gsn_error err = { 0 };
    char reason[200];

    if (gsn_uvc_parse(bytes, size, &uvc, &err) < 0)
        (void)snprintf(ret_note, room, "its description cannot be trusted: %.300s", err.text);
    else if (!gsn_uvc_can_be_locked(uvc, reason, sizeof reason))
        (void)snprintf(ret_note, room, "cannot be locked (%s): its pictures are not measured",
                       reason);
}

void gsn_v4l2_note(const char *name, char *ret_note, size_t size)
{
    gsn_auto_mem(char) node = NULL;
    gsn_auto_mem(uint8_t) bytes = gsn_alloc(MOST_DESCRIPTORS);
    size_t got = 0;

    ret_note[0] = '\0';
    if (bytes && gsn_v4l2_find(name, &node, NULL) >= 0)
        got = read_descriptors(node, bytes, MOST_DESCRIPTORS);
    if (got > 0)
        judge_descriptors(bytes, got, ret_note, size);
}
