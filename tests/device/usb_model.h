/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* An emulated USB device: bytes in, bytes out, no I/O of its own.
 *
 * The same model answers the initiator in memory, an ioctl handler of umockdev, and qemu's
 * usb-redir. A model never blocks and never reads a clock: whoever drives it tells the time. */
#ifndef GSN_TESTS_DEVICE_USB_MODEL_H
#define GSN_TESTS_DEVICE_USB_MODEL_H

#include <stddef.h>
#include <stdint.h>

enum {
    USB_MODEL_NAK = -1,    /* nothing yet: keep the request waiting */
    USB_MODEL_STALL = -2,  /* the endpoint is halted, or the control request refused */
    USB_MODEL_GONE = -3,   /* unplugged */
    USB_MODEL_BABBLE = -4, /* the buffer ends inside a packet: those bytes are lost */
};

struct usb_model {
    const uint8_t *device; /* 18 bytes */
    const uint8_t *config;
    size_t config_size;
    const char *strings[5]; /* 1..4, by index of the descriptors; NULL for none */
    void *self;
    /* Class requests and those the transport does not answer itself (SET_INTERFACE, CLEAR_FEATURE
     * of an endpoint). Returns the bytes written to in, or one of the above. */
    long (*control)(void *self, const uint8_t setup[8], const uint8_t *out, size_t out_size,
                    uint8_t *in, size_t in_size);
    /* One transfer to or from the endpoint with this address (0x02, 0x81, 0x83). */
    long (*out)(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size);
    long (*in)(void *self, uint8_t endpoint, uint8_t *buffer, size_t size);
    void (*tick)(void *self, int64_t now_ms); /* time for what comes late; may be NULL */
};

#endif
