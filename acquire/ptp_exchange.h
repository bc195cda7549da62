/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One PTP transaction as transfers: where data begin and end, what belongs to an older question,
 * and how a pipe is brought back to silence. ptp_session.c decides what is asked again.
 *
 * A failure with GSN_E_IO leaves the exchange "on": resync or reset before the next question. */
#ifndef GSN_ACQUIRE_PTP_EXCHANGE_H
#define GSN_ACQUIRE_PTP_EXCHANGE_H

#include "acquire/ptp_transport.h"
#include "acquire/ptp_wire.h"

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_ptp_phase {
    GSN_PTP_IDLE,
    GSN_PTP_ASKED,    /* nothing of the answer has come */
    GSN_PTP_DATA,     /* the header of the data has come */
    GSN_PTP_ANSWERED, /* the data are over, or there are none: the response is next */
};

struct gsn_ptp_exchange {
    struct gsn_ptp_transport *transport;
    size_t packet; /* bytes */
    uint8_t *in;   /* the last transfer: in[at..end) are data, in[end..size) what follows them */
    size_t at, end, size;
    bool transfer_was_short;
    enum gsn_ptp_phase phase;
    uint32_t transaction;
    uint64_t left; /* bytes of data to come, as the header says */
    bool untold;   /* the header does not say, or lies: the data end with a short transfer */
    bool data_were_short;
    unsigned empty; /* zero-length packets met in this transaction */
    struct gsn_ptp_hints hints;
};

int gsn_ptp_exchange_init(struct gsn_ptp_exchange *exchange, struct gsn_ptp_transport *transport,
                          struct gsn_error *err);
void gsn_ptp_exchange_done(struct gsn_ptp_exchange *exchange);

bool gsn_ptp_exchange_is_on(const struct gsn_ptp_exchange *exchange);
/* Whether the data of the last answer ended before the length they claimed. */
bool gsn_ptp_exchange_was_short(const struct gsn_ptp_exchange *exchange);

int gsn_ptp_exchange_begin(struct gsn_ptp_exchange *exchange, const struct gsn_ptp_request *request,
                           uint32_t transaction, struct gsn_error *err);
/* ret_got 0: the data are over. */
int gsn_ptp_exchange_data(struct gsn_ptp_exchange *exchange, uint8_t *buffer, size_t size,
                          size_t *ret_got, struct gsn_error *err);
int gsn_ptp_exchange_end(struct gsn_ptp_exchange *exchange, struct gsn_ptp_response *ret_response,
                         struct gsn_error *err);

/* Cancels what is under way and drains the pipe; the session stays. Fails with GSN_E_IO when the
 * device does not stop sending, GSN_E_NOTFOUND when it is gone. */
int gsn_ptp_exchange_resync(struct gsn_ptp_exchange *exchange, struct gsn_error *err);
/* Device Reset, and draining; the session is over. */
int gsn_ptp_exchange_reset(struct gsn_ptp_exchange *exchange, struct gsn_error *err);

/* Lets time pass while events are taken in as hints; 0: those that are there now. Fails with
 * GSN_E_NOTFOUND when the device is gone. */
int gsn_ptp_exchange_pause(struct gsn_ptp_exchange *exchange, unsigned ms, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
