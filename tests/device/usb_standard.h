/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The control requests that every USB device answers (USB 2.0, chapter 9), from its descriptors. */
#ifndef GSN_TESTS_DEVICE_USB_STANDARD_H
#define GSN_TESTS_DEVICE_USB_STANDARD_H

#include "tests/device/usb_model.h"

/* As the model's control, which is asked for what is not standard. */
long usb_standard_control(const struct usb_model *model, const uint8_t setup[8], const uint8_t *out,
                          size_t out_size, uint8_t *in, size_t in_size);

#endif
