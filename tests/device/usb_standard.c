/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/usb_standard.h"

#include <string.h>

#include "tests/device/wire.h"

enum { GET_STATUS = 0, SET_ADDRESS = 5, GET_DESCRIPTOR = 6, GET_CONFIG = 8, SET_CONFIG = 9 };
enum { DEVICE = 1, CONFIG = 2, STRING = 3, LONGEST = 255 };

static long give(const void *bytes, size_t size, uint8_t *in, size_t in_size)
{
    const size_t n = size < in_size ? size : in_size;

    memcpy(in, bytes, n);
    return (long)n;
}

static long give_string(const struct usb_model *model, unsigned index, uint8_t *in, size_t in_size)
{
    static const uint8_t english[4] = { 4, STRING, 0x09, 0x04 };
    const size_t most = sizeof model->strings / sizeof *model->strings;
    uint8_t text[LONGEST] = { 2, STRING };

    if (index == 0)
        return give(english, sizeof english, in, in_size);
    if (index >= most || !model->strings[index])
        return USB_MODEL_STALL;
    for (const char *at = model->strings[index]; *at && text[0] + 2 <= LONGEST; at++) {
        wire_put16(text + text[0], (uint8_t)*at);
        text[0] = (uint8_t)(text[0] + 2);
    }
    return give(text, text[0], in, in_size);
}

static long give_descriptor(const struct usb_model *model, const uint8_t setup[8], uint8_t *in,
                            size_t in_size)
{
    switch (setup[3]) {
    case DEVICE:
        return give(model->device, 18, in, in_size);
    case CONFIG:
        return give(model->config, model->config_size, in, in_size);
    case STRING:
        return give_string(model, setup[2], in, in_size);
    default:
        return USB_MODEL_STALL;
    }
}

long usb_standard_control(const struct usb_model *model, const uint8_t setup[8], const uint8_t *out,
                          size_t out_size, uint8_t *in, size_t in_size)
{
    if (setup[0] & 0x60 || (setup[0] & 0x1f) == 2)
        return model->control(model->self, setup, out, out_size, in, in_size);
    switch (setup[1]) {
    case GET_STATUS:
        return give("\0\0", 2, in, in_size);
    case GET_DESCRIPTOR:
        return give_descriptor(model, setup, in, in_size);
    case GET_CONFIG:
        return give("\1", 1, in, in_size);
    case SET_ADDRESS:
    case SET_CONFIG:
        return 0;
    default:
        return model->control(model->self, setup, out, out_size, in, in_size);
    }
}
