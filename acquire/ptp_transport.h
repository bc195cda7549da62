/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The four pipes of a Still Image device (USB Still Image Capture Device Definition 1.0), as the
 * PTP initiator sees them: bulk out, bulk in, interrupt in, and the class requests.
 *
 * libusb stands behind them at the bench, a model of a device in the tests. A call is one transfer;
 * nothing is retried here. A transport belongs to one thread at a time. */
#ifndef GSN_ACQUIRE_PTP_TRANSPORT_H
#define GSN_ACQUIRE_PTP_TRANSPORT_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* What a transfer ended with, where it did not fail with a negative enum gsn_code.
 * GSN_E_NOTFOUND means that the device is gone. */
enum gsn_ptp_io {
    GSN_PTP_DONE = 0,
    GSN_PTP_STALLED = 1, /* the endpoint is halted until clear_halt */
    GSN_PTP_TIMEOUT = 2, /* nothing came, or not all went, in time */
};

enum gsn_ptp_pipe { GSN_PTP_OUT, GSN_PTP_IN, GSN_PTP_EVENT };

struct gsn_ptp_transport_ops {
    /* Sends a whole container in one transfer; a zero-length packet follows by itself where the
     * size is a multiple of the packet size. */
    int (*send)(void *self, const void *bytes, size_t size, unsigned timeout_ms,
                struct gsn_error *err);
    /* One transfer from bulk in or interrupt in: ends at a short packet or when size bytes came
     * (ask for multiples of packet_size). 0 bytes is a zero-length packet. With GSN_PTP_TIMEOUT
     * *ret_got bytes may have come. timeout_ms 0: what is there now. */
    int (*receive)(void *self, enum gsn_ptp_pipe pipe, void *buffer, size_t size,
                   unsigned timeout_ms, size_t *ret_got, struct gsn_error *err);
    int (*clear_halt)(void *self, enum gsn_ptp_pipe pipe, struct gsn_error *err);
    /* The class requests: Cancel (0x64), Device Reset (0x66), Get Device Status (0x67). */
    int (*cancel)(void *self, uint32_t transaction, struct gsn_error *err);
    int (*reset)(void *self, struct gsn_error *err);
    int (*status)(void *self, uint16_t *ret_code, struct gsn_error *err);
    /* Sleeps until an event may have come, timeout_ms passed, or stop_fd (-1: none) is readable. */
    int (*wait)(void *self, int timeout_ms, int stop_fd, struct gsn_error *err);
    void (*close)(void *self); /* accepts NULL */
};

struct gsn_ptp_transport {
    const struct gsn_ptp_transport_ops *ops;
    void *self;
    size_t packet_size; /* of bulk in: 64, 512 or 1024 */
    uint16_t vendor, product;
    char serial[128]; /* from the USB descriptor; empty where it has none */
    /* Told after every transfer and class request, whatever came of it: a silent device costs
     * minutes, an object that is skipped through too, and whoever watches over us must hear that
     * they pass well. NULL: nobody does. */
    void (*alive)(void *context);
    void *alive_context;
};

/* How long an initiator waits. */
enum gsn_ptp_timeouts {
    GSN_PTP_ANSWER_MS = 10000, /* for the first packet of an answer, and for each after it */
    GSN_PTP_DRAIN_MS = 100,    /* a pipe is empty when nothing comes for so long */
    GSN_PTP_BUSY_MS = 10000,   /* a busy device is asked again for about so long */
};

/* Writes down what crosses the pipes of a device, for a bug report or a test: a text that the
 * replayer in tests/device/transcript.h plays as a device.
 *
 *     gieson-ptp 1 04a9 31c0 512 C767F1C7      version, vendor, product, packet size, serial
 *     > 16                                     sent: bytes, then they follow in hexadecimal
 *     10000000010002100000000001000000
 *     < 12                                     received in one transfer, which ended short
 *     0c0000000300012000000000
 *     < 65536 +                                received as much as was asked for
 *     ...
 *     e 16                                     an event
 *     stalled in, silent in, cleared in, cancelled 5, reset, status 2001, gone
 *
 * The pictures themselves are in it. */

/* takes: the transport, also on failure; ops->close(self) of the one given closes it. Appends to
 * the file at path, which only its owner may read. A disk that refuses later ends the record, never
 * the session.
 * Fails with GSN_E_IO when the file cannot be opened, GSN_E_NOMEM. */
int gsn_ptp_record(struct gsn_ptp_transport *transport, const char *path,
                   struct gsn_ptp_transport **ret_transport, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
