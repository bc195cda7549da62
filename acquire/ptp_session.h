/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A conversation with a PTP device: one question at a time, and what to do when the answer is not
 * what the standard says.
 *
 * A transaction is a command, perhaps data, and a response, each in a container that crosses the
 * bus in transfers. Where one ends is decided by what came, not by the length a container claims:
 * data may share a transfer with the response, come in many short transfers, end early, or be
 * followed by a zero-length packet or not. Data are read in this fixed way, which recordings of
 * devices rely on: first one packet, then pieces of at most 64 KiB in whole packets, then one
 * packet; a response is asked for with one packet.
 *
 * What goes wrong is mended here, each step once for a question: a halted pipe is cleared and read
 * again; answers to older transactions are dropped; silence and nonsense end in Cancel (0x64) and
 * draining, then the question again; then in Device Reset (0x66) and a new session, then the
 * question a last time. Device Busy is waited for with growing pauses. All of it is bounded. A
 * deletion alone is never asked for twice.
 *
 * Time passes in the transport alone. A session belongs to one thread. */
#ifndef GSN_ACQUIRE_PTP_SESSION_H
#define GSN_ACQUIRE_PTP_SESSION_H

#include "acquire/ptp_transport.h"
#include "acquire/ptp_wire.h"
#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_ptp_session;

/* gives: a session that is not open yet. keeps: the transport, which is not closed by it. */
int gsn_ptp_session_new(struct gsn_ptp_transport *transport, struct gsn_ptp_session **ret_session,
                        struct gsn_error *err);
/* Does not talk to the device. */
void gsn_ptp_session_free(struct gsn_ptp_session *session);
GSN_DEFINE_AUTO(gsn_ptp_session);

/* OpenSession, with transaction 0. A session that is open there already (after a crash of ours, or
 * a replug the device slept through) is closed and opened anew; a device that refuses to close it
 * is gone on with. Asking needs no call of this: a session that is not open is opened then. */
int gsn_ptp_session_open(struct gsn_ptp_session *session, struct gsn_error *err);
/* CloseSession, as far as the device listens. */
void gsn_ptp_session_close(struct gsn_ptp_session *session);

/* Counts the sessions opened: a device's handles are valid within one session alone. Who meets a
 * device again counts on from what he had. */
unsigned gsn_ptp_session_number(const struct gsn_ptp_session *session);
void gsn_ptp_session_count_from(struct gsn_ptp_session *session, unsigned number);

/* Asks, and keeps up to size bytes of data. A response other than OK is an answer, not a failure:
 * look at ret_response->code. ret_got and ret_response are set on success alone; buffer is not.
 *
 * Fails with GSN_E_NOTFOUND when the device is gone, GSN_E_BUSY when it stays busy, GSN_E_LIMIT
 * when more data come than size, GSN_E_IO when all mending did not help, GSN_E_NOMEM. */
int gsn_ptp_ask(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                void *buffer, size_t size, size_t *ret_got, struct gsn_ptp_response *ret_response,
                struct gsn_error *err);

/* The same, for data whose size only the device knows. gives: ret_bytes, at most limit of them. */
int gsn_ptp_fetch(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                  size_t limit, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_ptp_response *ret_response, struct gsn_error *err);

/* A long answer, taken piece by piece while the transaction stays open. Nothing is asked again
 * here: who gets GSN_E_IO starts over. A question between the pieces cancels the stream. */
int gsn_ptp_stream_start(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                         struct gsn_error *err);
/* ret_got 0: the data are over. Fails with GSN_E_IO when no stream is under way. */
int gsn_ptp_stream_read(struct gsn_ptp_session *session, void *buffer, size_t size, size_t *ret_got,
                        struct gsn_error *err);
int gsn_ptp_stream_end(struct gsn_ptp_session *session, struct gsn_ptp_response *ret_response,
                       struct gsn_error *err);
/* Whether a stream is under way. */
int gsn_ptp_stream_is_on(const struct gsn_ptp_session *session);

/* Takes in the events that are there now, without waiting, at most some dozens. Fails with
 * GSN_E_NOTFOUND when the device is gone; other trouble with events is no failure. */
int gsn_ptp_session_hints(struct gsn_ptp_session *session, struct gsn_ptp_hints *ret_hints,
                          struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
