/* SPDX-License-Identifier: AGPL-3.0-or-later */

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
#ifndef GSN_ACQUIRE_PTP_RECORD_H
#define GSN_ACQUIRE_PTP_RECORD_H

#include "acquire/ptp_transport.h"

#ifdef __cplusplus
extern "C" {
#endif

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
