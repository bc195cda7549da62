/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which scanners and cameras of the Still Image class are plugged in, and which of them an address
 * means. Private to usb_transport.c; libusb's types are opaque here. */
#ifndef GSN_ACQUIRE_USB_FIND_H
#define GSN_ACQUIRE_USB_FIND_H

#include <stddef.h>
#include <stdint.h>

#include "acquire/usb_address.h"
#include "acquire/usb_transport.h"
#include "pipeline/core/error.h"

struct libusb_context;
struct libusb_device;

/* Where a Still Image device has its pipes. event 0: it has none. */
struct gsn_usb_pipes {
    int interface, alternate;
    uint8_t in, out, event;
    uint16_t in_packet, event_packet;
};

/* Fails with GSN_E_IO where there is no USB; GSN_E_NOMEM. gives: ret_context, for libusb_exit(). */
int gsn_usb_start(struct libusb_context **ret_context, struct gsn_error *err);

/* 0: the device is none of the Still Image class, or lacks a pipe; then *ret_pipes may be changed.
 */
int gsn_usb_find_pipes(struct libusb_device *device, struct gsn_usb_pipes *ret_pipes);

void gsn_usb_describe(struct libusb_device *device, struct gsn_ptp_usb_device *ret_described);

/* Lists the Still Image devices; of the one that answers to address (NULL: none) ret_device is a
 * reference, NULL when several or none do. ret_matches and ret_device may be NULL. */
int gsn_usb_look(struct libusb_context *context, const struct gsn_usb_address *address,
                 struct gsn_ptp_usb_devices *ret_devices, size_t *ret_matches,
                 struct libusb_device **ret_device, struct gsn_error *err);

/* Fails always: says why not exactly one of the devices answers to an address (rest, as given). */
int gsn_usb_explain(const char *rest, const struct gsn_usb_address *address, size_t matches,
                    const struct gsn_ptp_usb_devices *devices, struct gsn_error *err);

#endif
