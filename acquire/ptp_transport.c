/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A transport that writes down what crosses another one.
 *
 * Each call of the initiator is handed to the inner transport; what was asked and what came of it
 * become lines of a text, whose form acquire/ptp_transport.h shows. The text is played back as a
 * device by tests/device/transcript.c, so a bug report from a bench becomes a test.
 *
 * How it fails: a disk that refuses ends the record and never the session. */
#include "acquire/ptp_transport.h"

#include <errno.h>
#include <fcntl.h>
#include <stdarg.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/mem.h"

enum { BYTES_A_LINE = 32, LINE = 256 };

struct record {
    struct gsn_ptp_transport transport; /* ours: what is asked of it goes to inner */
    struct gsn_ptp_transport *inner;
    int fd; /* -1 when the disk refused */
};

static const char *const pipes[] = { "out", "in", "event" };

static void put_text(struct record *record, const char *text, size_t size)
{
    while (record->fd >= 0 && size > 0) {
        const ssize_t done = write(record->fd, text, size);

        if (done < 0 && errno == EINTR)
            continue;
        if (done <= 0) {
            (void)close(record->fd);
            record->fd = -1;
            return;
        }
        text += done;
        size -= (size_t)done;
    }
}

__attribute__((format(printf, 2, 3))) static void put_line(struct record *record,
                                                           const char *format, ...)
{
    char line[LINE];
    va_list values;
    int length;

    va_start(values, format);
    length = vsnprintf(line, sizeof line, format, values);
    va_end(values);
    if (length > 0)
        put_text(record, line, (size_t)length < sizeof line ? (size_t)length : sizeof line - 1);
}

static void put_bytes(struct record *record, const uint8_t *bytes, size_t size)
{
    static const char digit[] = "0123456789abcdef";
    char line[2 * BYTES_A_LINE + 1];

    for (size_t at = 0; at < size; at += BYTES_A_LINE) {
        const size_t n = size - at < BYTES_A_LINE ? size - at : BYTES_A_LINE;

        for (size_t i = 0; i < n; i++) {
            line[2 * i] = digit[bytes[at + i] >> 4];
            line[2 * i + 1] = digit[bytes[at + i] & 15];
        }
        line[2 * n] = '\n';
        put_text(record, line, 2 * n + 1);
    }
}

/* How a call ended, where that is worth a line; returns what the call did. */
static int note_outcome(struct record *record, int r, enum gsn_ptp_pipe pipe)
{
    if (r == GSN_PTP_STALLED)
        put_line(record, "stalled %s\n", pipes[pipe]);
    else if (r == GSN_PTP_TIMEOUT && pipe != GSN_PTP_EVENT) /* events are mostly silent */
        put_line(record, "silent %s\n", pipes[pipe]);
    else if (r == GSN_E_NOTFOUND)
        put_line(record, "gone\n");
    else if (r < 0)
        put_line(record, "failed %s\n", pipes[pipe]);
    return r;
}

static int record_send(void *self, const void *bytes, size_t size, unsigned timeout_ms,
                       struct gsn_error *err)
{
    struct record *const record = self;

    put_line(record, "> %zu\n", size);
    put_bytes(record, bytes, size);
    return note_outcome(record,
                        record->inner->ops->send(record->inner->self, bytes, size, timeout_ms, err),
                        GSN_PTP_OUT);
}

static int record_receive(void *self, enum gsn_ptp_pipe pipe, void *buffer, size_t size,
                          unsigned timeout_ms, size_t *ret_got, struct gsn_error *err)
{
    struct record *const record = self;
    const int r = record->inner->ops->receive(record->inner->self, pipe, buffer, size, timeout_ms,
                                              ret_got, err);

    if (r == GSN_PTP_DONE || (r == GSN_PTP_TIMEOUT && *ret_got > 0)) {
        put_line(record, "%c %zu%s\n", pipe == GSN_PTP_EVENT ? 'e' : '<', *ret_got,
                 r == GSN_PTP_TIMEOUT || *ret_got == size ? " +" : "");
        put_bytes(record, buffer, *ret_got);
    }
    return note_outcome(record, r, pipe);
}

static int record_clear_halt(void *self, enum gsn_ptp_pipe pipe, struct gsn_error *err)
{
    struct record *const record = self;

    put_line(record, "cleared %s\n", pipes[pipe]);
    return note_outcome(record, record->inner->ops->clear_halt(record->inner->self, pipe, err),
                        pipe);
}

static int record_cancel(void *self, uint32_t transaction, struct gsn_error *err)
{
    struct record *const record = self;

    put_line(record, "cancelled %lu\n", (unsigned long)transaction);
    return note_outcome(record, record->inner->ops->cancel(record->inner->self, transaction, err),
                        GSN_PTP_OUT);
}

static int record_reset(void *self, struct gsn_error *err)
{
    struct record *const record = self;

    put_line(record, "reset\n");
    return note_outcome(record, record->inner->ops->reset(record->inner->self, err), GSN_PTP_OUT);
}

static int record_status(void *self, uint16_t *ret_code, struct gsn_error *err)
{
    struct record *const record = self;
    const int r = record->inner->ops->status(record->inner->self, ret_code, err);

    if (r >= 0)
        put_line(record, "status %04x\n", *ret_code);
    return note_outcome(record, r, GSN_PTP_OUT);
}

static int record_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    const struct record *const record = self;

    return record->inner->ops->wait(record->inner->self, timeout_ms, stop_fd, err);
}

static void record_close(void *self)
{
    struct record *const record = self;

    if (!record)
        return;
    record->inner->ops->close(record->inner->self);
    if (record->fd >= 0)
        (void)close(record->fd);
    gsn_free(record);
}

static const struct gsn_ptp_transport_ops record_ops = {
    .send = record_send,
    .receive = record_receive,
    .clear_halt = record_clear_halt,
    .cancel = record_cancel,
    .reset = record_reset,
    .status = record_status,
    .wait = record_wait,
    .close = record_close,
};

int gsn_ptp_record(struct gsn_ptp_transport *transport, const char *path,
                   struct gsn_ptp_transport **ret_transport, struct gsn_error *err)
{
    struct record *const record = gsn_alloc_array(1, sizeof *record);
    int r = GSN_OK;

    if (!record) {
        transport->ops->close(transport->self);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a record");
    }
    record->transport = *transport;
    record->transport.ops = &record_ops;
    record->transport.self = record;
    record->inner = transport;
    record->fd = open(path, O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NOCTTY, 0600); /* door */
    if (record->fd < 0)
        r = gsn_fail(err, GSN_E_IO, "%.300s: no record can be written there: %s", path,
                     strerror(errno));
    if (r < 0) {
        record_close(record);
        return r;
    }
    put_line(record, "gieson-ptp 1 %04x %04x %zu %.127s\n", transport->vendor, transport->product,
             transport->packet_size, transport->serial);
    *ret_transport = &record->transport;
    return GSN_OK;
}
