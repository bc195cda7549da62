/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pipes of a Still Image device (interface class 06/01/01) through libusb.
 *
 * A device belongs to one program at a time: it is claimed when opened (a kernel driver is asked to
 * let go) and given back when closed. Its addresses are those of gsn_usb_address_read(). */
#ifndef GSN_ACQUIRE_USB_TRANSPORT_H
#define GSN_ACQUIRE_USB_TRANSPORT_H

#include "acquire/ptp_transport.h"
#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the transport; its ops->close(self) ends it.
 *
 * Fails with GSN_E_INPUT for an address that is wrong or that several devices answer to (the
 * sentence lists them), GSN_E_NOTFOUND when none does, GSN_E_BUSY when another program holds it
 * (the sentence says which, where that can be seen), GSN_E_IO when it may not be opened. */
int gsn_ptp_usb_open(const char *rest, struct gsn_ptp_transport **ret_transport,
                     struct gsn_error *err);

/* Judges the address alone. */
int gsn_ptp_usb_check(const char *rest, struct gsn_error *err);

enum { GSN_PTP_USB_MOST = 16 };

struct gsn_ptp_usb_device {
    uint16_t vendor, product;
    unsigned bus, number; /* /dev/bus/usb/BUS/NUMBER */
    int refused;          /* it may not be opened: serial and name are not known */
    char serial[128];     /* of the USB descriptors, as the name; empty where there is none */
    char name[128];       /* "Canon Inc. PowerShot SX200" */
};

struct gsn_ptp_usb_devices {
    size_t count;
    struct gsn_ptp_usb_device at[GSN_PTP_USB_MOST]; /* those beyond are left out */
};

/* The Still Image devices that are plugged in, claimed or not. */
int gsn_ptp_usb_list(struct gsn_ptp_usb_devices *ret_devices, struct gsn_error *err);

/* How a Still Image device is named in an address, and who else may hold it.
 *
 * "SERIAL", "vvvv:pppp", "vvvv:pppp:SERIAL" or "any": vendor and product are four hexadecimal
 * digits as lsusb prints them; the serial number is the one of the USB descriptor. */

struct gsn_usb_address {
    int has_ids; /* vendor and product count */
    uint16_t vendor, product;
    char serial[128]; /* empty: any */
};

/* Fails with GSN_E_INPUT. */
int gsn_usb_address_read(const char *rest, struct gsn_usb_address *ret_address,
                         struct gsn_error *err);

int gsn_usb_address_matches(const struct gsn_usb_address *address, uint16_t vendor,
                            uint16_t product, const char *serial);

/* Writes "gvfsd-gphoto2 (process 812)" of another process that has this node of usbfs open, and
 * returns 1; 0 when none is seen: those of other users are hidden from whoever is not root. */
int gsn_usb_holder(unsigned bus, unsigned device, char *ret_text, size_t size);

#ifdef __cplusplus
}
#endif
#endif
