/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How a Still Image device is named in an address, and who else may hold it.
 *
 * "SERIAL", "vvvv:pppp", "vvvv:pppp:SERIAL" or "any": vendor and product are four hexadecimal
 * digits as lsusb prints them; the serial number is the one of the USB descriptor. */
#ifndef GSN_ACQUIRE_USB_ADDRESS_H
#define GSN_ACQUIRE_USB_ADDRESS_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

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
