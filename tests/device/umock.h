/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Models of USB devices behind /dev/bus/usb, udev and usbfs as umockdev makes them believed: libusb
 * and every program that uses it meets them unmodified, in this process and in its children.
 *
 * The process needs libumockdev-preload in LD_PRELOAD (CMake's gsn_umock_test() sees to it). The
 * models are driven by a thread of umockdev's: touch them only between umock_lock and
 * umock_unlock. */
#ifndef GSN_TESTS_DEVICE_UMOCK_H
#define GSN_TESTS_DEVICE_UMOCK_H

#include "tests/device/usb_model.h"

struct umock;

/* gives. One at a time in a process. */
struct umock *umock_new(void);
void umock_free(struct umock *umock);

void umock_lock(struct umock *umock);
void umock_unlock(struct umock *umock);

/* The device appears as /dev/bus/usb/001/NUMBER (1..99). keeps: the model. */
void umock_plug(struct umock *umock, const struct usb_model *model, unsigned number);
/* And goes: the node, its entry in sysfs, and the kernel's word of it. The model is not told. */
void umock_unplug(struct umock *umock, unsigned number);

/* From now on somebody else has claimed its interface. */
void umock_claim(struct umock *umock, unsigned number, int by_another);

/* borrows: where the device's node lies in truth. */
const char *umock_root(const struct umock *umock);

#endif
