/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_device.h"

#include <string.h>

/* Reading pieces of an object, in whichever way the device offers. */

enum { TRIES = 2 };

static int judge(const struct gsn_ptp_response *response, uint16_t *ret_code, struct gsn_error *err)
{
    char words[80];

    *ret_code = response->code;
    if (response->code == GSN_PTP_OK)
        return GSN_OK;
    gsn_ptp_describe(response->code, words, sizeof words);
    return gsn_fail(err, GSN_E_INPUT, "the device refuses to give it: %s", words);
}

static int ask_partial(struct gsn_ptp_device *device, const struct gsn_ptp_request *request,
                       void *buffer, size_t size, size_t *ret_got, uint16_t *ret_code,
                       struct gsn_error *err)
{
    for (int tries = 1;; tries++) {
        struct gsn_ptp_response response = { 0 };
        size_t got = 0;
        int r = gsn_ptp_ask(device->session, request, buffer, size, &got, &response, err);

        if (r >= 0)
            r = judge(&response, ret_code, err);
        if (r < 0)
            return r;
        /* The response counts the bytes as well; devices that do not count say 0. */
        if (got > 0 &&
            (response.count == 0 || response.parameter[0] == 0 || response.parameter[0] == got)) {
            *ret_got = got;
            return GSN_OK;
        }
        if (got == 0)
            return gsn_fail(err, GSN_E_LIMIT, "the device has no more bytes of it");
        if (tries == TRIES)
            return gsn_fail(err, GSN_E_IO, "the device says that it gave %lu bytes, and gave %zu",
                            (unsigned long)response.parameter[0], got);
    }
}

static int read_partial(struct gsn_ptp_device *device, uint32_t handle, uint64_t offset,
                        void *buffer, size_t size, size_t *ret_got, uint16_t *ret_code,
                        struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_PARTIAL_OBJECT,
                                             3,
                                             { handle, (uint32_t)offset, (uint32_t)size } };

    return ask_partial(device, &request, buffer, size, ret_got, ret_code, err);
}

static int read_partial_64(struct gsn_ptp_device *device, uint32_t handle, uint64_t offset,
                           void *buffer, size_t size, size_t *ret_got, uint16_t *ret_code,
                           struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_PARTIAL_OBJECT_64,
                                             4,
                                             { handle, (uint32_t)offset, (uint32_t)(offset >> 32),
                                               (uint32_t)size } };

    return ask_partial(device, &request, buffer, size, ret_got, ret_code, err);
}

/* Makes the stream stand at offset: from its beginning, or on from where it is. */
static int wind(struct gsn_ptp_device *device, uint32_t handle, uint64_t offset, void *buffer,
                size_t size, struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT, 1, { handle } };
    struct gsn_ptp_stream *const stream = &device->stream;
    int r = GSN_OK;

    if (!gsn_ptp_stream_is_on(device->session) || stream->handle != handle || stream->at > offset) {
        *stream = (struct gsn_ptp_stream){ .handle = handle };
        r = gsn_ptp_stream_start(device->session, &request, err);
    }
    while (r >= 0 && stream->at < offset) {
        const uint64_t left = offset - stream->at;
        size_t got = 0;

        r = gsn_ptp_stream_read(device->session, buffer, left < size ? (size_t)left : size, &got,
                                err);
        if (r >= 0 && got == 0)
            return GSN_OK;
        stream->at += got;
    }
    return r;
}

/* The data are over: what does the device say about them? */
static int end_stream(struct gsn_ptp_device *device, uint64_t object_size, uint16_t *ret_code,
                      struct gsn_error *err)
{
    struct gsn_ptp_response response = { 0 };
    uint8_t one_more;
    size_t got = 0;
    int r = gsn_ptp_stream_read(device->session, &one_more, 1, &got, err);

    if (r >= 0 && got > 0)
        return gsn_fail(err, GSN_E_LIMIT, "the device gives more bytes than it told of");
    if (r >= 0)
        r = gsn_ptp_stream_end(device->session, &response, err);
    if (r >= 0)
        r = judge(&response, ret_code, err);
    if (r >= 0 && device->stream.at < object_size)
        r = gsn_fail(err, GSN_E_IO, "the device ended it after %llu bytes",
                     (unsigned long long)device->stream.at);
    return r;
}

static int read_stream_once(struct gsn_ptp_device *device, uint32_t handle, uint64_t object_size,
                            uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                            uint16_t *ret_code, struct gsn_error *err)
{
    struct gsn_ptp_stream *const stream = &device->stream;
    size_t got = 0;
    int r = wind(device, handle, offset, buffer, size, err);

    if (r >= 0)
        r = gsn_ptp_stream_read(device->session, buffer, size, &got, err);
    if (r < 0)
        return r;
    stream->at += got;
    /* The last piece counts only when the device says that all went well. */
    if (got == 0 || stream->at == object_size)
        r = end_stream(device, object_size, ret_code, err);
    if (r >= 0)
        *ret_got = got;
    return r;
}

static int read_stream(struct gsn_ptp_device *device, uint32_t handle, uint64_t object_size,
                       uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                       uint16_t *ret_code, struct gsn_error *err)
{
    int r = GSN_OK;

    for (int tries = 0; tries < TRIES; tries++) {
        r = read_stream_once(device, handle, object_size, offset, buffer, size, ret_got, ret_code,
                             err);
        if (r != GSN_E_IO)
            return r;
        /* Over from the start, in the order it was asked for. */
        device->stream = (struct gsn_ptp_stream){ .at = UINT64_MAX };
    }
    return r;
}

/* The way that is offered for a piece that ends there. */
static uint16_t choose(const struct gsn_ptp_device *device, uint64_t end)
{
    if (end <= UINT32_MAX && !device->no_partial &&
        gsn_ptp_offers(&device->info, GSN_PTP_GET_PARTIAL_OBJECT))
        return GSN_PTP_GET_PARTIAL_OBJECT;
    if (!device->no_partial_64 && gsn_ptp_offers(&device->info, GSN_PTP_GET_PARTIAL_OBJECT_64))
        return GSN_PTP_GET_PARTIAL_OBJECT_64;
    return GSN_PTP_GET_OBJECT;
}

static int read_once(struct gsn_ptp_device *device, uint16_t way, uint32_t handle,
                     uint64_t object_size, uint64_t offset, void *buffer, size_t size,
                     size_t *ret_got, uint16_t *ret_code, struct gsn_error *err)
{
    if (way == GSN_PTP_GET_PARTIAL_OBJECT)
        return read_partial(device, handle, offset, buffer, size, ret_got, ret_code, err);
    if (way == GSN_PTP_GET_PARTIAL_OBJECT_64)
        return read_partial_64(device, handle, offset, buffer, size, ret_got, ret_code, err);
    return read_stream(device, handle, object_size, offset, buffer, size, ret_got, ret_code, err);
}

/* Whether another way, or a smaller piece, is worth a try after this failure. */
static bool adapt(struct gsn_ptp_device *device, uint16_t way, int r, uint16_t code)
{
    if (way == GSN_PTP_GET_OBJECT)
        return false;
    if (r == GSN_E_INPUT && code == GSN_PTP_OPERATION_NOT_SUPPORTED) {
        device->no_partial |= way == GSN_PTP_GET_PARTIAL_OBJECT;
        device->no_partial_64 |= way == GSN_PTP_GET_PARTIAL_OBJECT_64;
        return true;
    }
    /* Silent after all mending: firmware that large requests crash. */
    if (r != GSN_E_IO || device->piece == GSN_PTP_SMALLEST_PIECE)
        return false;
    device->piece = GSN_PTP_SMALLEST_PIECE;
    return true;
}

int gsn_ptp_device_read(struct gsn_ptp_device *device, uint32_t handle, uint64_t object_size,
                        uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                        uint16_t *ret_code, struct gsn_error *err)
{
    for (;;) {
        const uint64_t left = object_size - offset;
        size_t now = size < device->piece ? size : device->piece;
        uint16_t way;
        int r;

        if (now > left)
            now = (size_t)left;
        way = choose(device, offset + now);
        *ret_code = 0;
        r = read_once(device, way, handle, object_size, offset, buffer, now, ret_got, ret_code,
                      err);
        if (r >= 0 || !adapt(device, way, r, *ret_code))
            return r;
    }
}
