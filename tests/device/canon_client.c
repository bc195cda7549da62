/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Asks the recorded camera, which umockdev-run plays byte by byte, what gphoto2 asked it then, and
 * writes the photos: canon_client OUT1 OUT2. The conversation and libusb are ours; only the last
 * read of a block is narrowed to what the recording has. See canon_replay.sh. */
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "acquire/ptp_session.h"
#include "acquire/usb_transport.h"
#include "pipeline/core/file.h"

enum { LARGEST = 1 << 20, PACKET = 512 };

/* A transport that asks for the last bytes of a block exactly. */
struct narrow {
    struct gsn_ptp_transport transport, *inner;
    uint64_t left; /* of the data block, as its header says */
    bool begun;
};

static int narrow_send(void *self, const void *bytes, size_t size, unsigned timeout_ms,
                       struct gsn_error *err)
{
    struct narrow *const narrow = self;

    narrow->begun = false;
    narrow->left = 0;
    return narrow->inner->ops->send(narrow->inner->self, bytes, size, timeout_ms, err);
}

static int narrow_receive(void *self, enum gsn_ptp_pipe pipe, void *buffer, size_t size,
                          unsigned timeout_ms, size_t *ret_got, struct gsn_error *err)
{
    struct narrow *const narrow = self;
    const size_t exact = narrow->left > 0 && narrow->left < size ? (size_t)narrow->left : size;
    /* Whole packets first, then the rest. */
    const size_t asked = exact > PACKET ? exact / PACKET * PACKET : exact;
    const int r = narrow->inner->ops->receive(narrow->inner->self, pipe, buffer, asked, timeout_ms,
                                              ret_got, err);

    if (r != GSN_PTP_DONE || pipe != GSN_PTP_IN)
        return r;
    if (!narrow->begun && *ret_got >= GSN_PTP_HEADER &&
        gsn_ptp_read_header(buffer).type == GSN_PTP_DATA_BLOCK)
        narrow->left = gsn_ptp_read_header(buffer).length;
    narrow->begun = true;
    narrow->left -= narrow->left < *ret_got ? narrow->left : *ret_got;
    return r;
}

/* What mends a conversation is not in the recording. */
static int no_clear_halt(void *self, enum gsn_ptp_pipe pipe, struct gsn_error *err)
{
    (void)self;
    (void)pipe;
    return gsn_fail(err, GSN_E_NOTFOUND, "a halt was to be cleared, which was not recorded");
}

static int no_cancel(void *self, uint32_t transaction, struct gsn_error *err)
{
    (void)self;
    return gsn_fail(err, GSN_E_NOTFOUND, "question %lu was to be cancelled, which was not recorded",
                    (unsigned long)transaction);
}

static int no_reset(void *self, struct gsn_error *err)
{
    (void)self;
    return gsn_fail(err, GSN_E_NOTFOUND, "the device was to be reset, which was not recorded");
}

static int no_status(void *self, uint16_t *ret_code, struct gsn_error *err)
{
    (void)self;
    (void)ret_code;
    return gsn_fail(err, GSN_E_NOTFOUND, "the status was asked for, which was not recorded");
}

static int no_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    (void)self;
    (void)timeout_ms;
    (void)stop_fd;
    return gsn_fail(err, GSN_E_NOTFOUND, "an event was waited for, which was not recorded");
}

static const struct gsn_ptp_transport_ops narrow_ops = {
    .send = narrow_send,
    .receive = narrow_receive,
    .clear_halt = no_clear_halt,
    .cancel = no_cancel,
    .reset = no_reset,
    .status = no_status,
    .wait = no_wait,
};

static const struct gsn_ptp_request before[] = {
    { GSN_PTP_GET_DEVICE_INFO, 0, { 0 } },
    { GSN_PTP_GET_OBJECT_HANDLES, 3, { 0xffffffff, 0, 0xffffffff } },
    { GSN_PTP_GET_STORAGE_IDS, 0, { 0 } },
    { GSN_PTP_GET_OBJECT_HANDLES, 3, { 0x10001, 0, 0xffffffff } },
    { GSN_PTP_GET_STORAGE_IDS, 0, { 0 } },
    { GSN_PTP_GET_OBJECT_INFO, 1, { 0x80000 } },
    { 0x9021, 4, { 0x10001, 0, 0, 0x80000 } }, /* Canon's own */
    { GSN_PTP_GET_OBJECT_HANDLES, 3, { 0x10001, 0, 0x80000 } },
    { GSN_PTP_GET_OBJECT_INFO, 1, { 0x1900000 } },
    { 0x9021, 4, { 0x10001, 0, 0x80000, 0x1900000 } },
    { GSN_PTP_GET_OBJECT_HANDLES, 3, { 0x10001, 0, 0x1900000 } },
    { GSN_PTP_GET_OBJECT_INFO, 1, { 0x1900011 } },
    { 0x9021, 4, { 0x10001, 0, 0x1900000, 0x1900011 } },
    { GSN_PTP_GET_OBJECT_INFO, 1, { 0x1900021 } },
    { 0x9021, 4, { 0x10001, 0, 0x1900000, 0x1900021 } },
};

static int ask(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
               const char *to, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_ptp_response response = { 0 };
    size_t size = 0;
    int r = gsn_ptp_fetch(session, request, LARGEST, &bytes, &size, &response, err);

    if (r >= 0 && response.code != GSN_PTP_OK)
        r = gsn_fail(err, GSN_E_IO, "%04x was answered %04x", request->operation, response.code);
    return r >= 0 && to ? gsn_file_write(to, bytes, size, err) : r;
}

static int talk(struct narrow *narrow, char **photo, struct gsn_error *err)
{
    gsn_auto(gsn_ptp_session) session = NULL;
    int r = gsn_ptp_session_new(&narrow->transport, &session, err);

    if (r >= 0)
        r = gsn_ptp_session_open(session, err);
    for (size_t i = 0; r >= 0 && i < sizeof before / sizeof *before; i++)
        r = ask(session, &before[i], NULL, err);
    for (uint32_t i = 0; r >= 0 && i < 2; i++)
        r = ask(session,
                &(struct gsn_ptp_request){ GSN_PTP_GET_OBJECT, 1, { 0x1900011 + 0x10 * i } },
                photo[i], err);
    if (r >= 0)
        gsn_ptp_session_close(session);
    return r;
}

int main(int argc, char **argv)
{
    struct narrow narrow = { 0 };
    struct gsn_error err = { 0 };
    int r;

    if (argc != 3)
        return 64;
    r = gsn_ptp_usb_open("04a9:31c0", &narrow.inner, &err);
    if (r >= 0) {
        narrow.transport = *narrow.inner;
        narrow.transport.ops = &narrow_ops;
        narrow.transport.self = &narrow;
        r = talk(&narrow, argv + 1, &err);
        narrow.inner->ops->close(narrow.inner->self);
    }
    if (r < 0)
        (void)fprintf(stderr, "canon_client: %s\n", err.text);
    return r < 0;
}
