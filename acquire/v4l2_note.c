/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/v4l2_source.h"

#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "acquire/uvc.h"
#include "acquire/v4l2.h"
#include "pipeline/core/file.h"

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

static void judge(const uint8_t *bytes, size_t size, char *ret_note, size_t room)
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
        judge(bytes, got, ret_note, size);
}
