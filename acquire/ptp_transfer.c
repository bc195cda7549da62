/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_transfer.h"

#include <string.h>

enum {
    SMALLEST_PACKET = 8, /* of bulk pipes at full speed */
    MOST_EMPTY = 64,     /* zero-length packets in one transaction */
};

int gsn_ptp_exchange_init(struct gsn_ptp_exchange *exchange, struct gsn_ptp_transport *transport,
                          struct gsn_error *err)
{
    const size_t packet = transport->packet_size;
    uint8_t *in;

    if (packet < SMALLEST_PACKET || packet > GSN_PTP_LARGEST_PACKET ||
        GSN_PTP_LARGEST_READ % packet != 0)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "the device's packets of %zu bytes are no USB",
                        packet);
    /* A read appends to less than a response that is not complete yet. */
    in = gsn_alloc(GSN_PTP_LARGEST_READ + GSN_PTP_LARGEST_PACKET);
    if (!in)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PTP session");
    *exchange = (struct gsn_ptp_exchange){ .transport = transport, .packet = packet, .in = in };
    return GSN_OK;
}

void gsn_ptp_exchange_done(struct gsn_ptp_exchange *exchange)
{
    gsn_free(exchange->in);
    exchange->in = NULL;
}

void gsn_ptp_transfer_forget(struct gsn_ptp_exchange *exchange)
{
    exchange->at = exchange->end = exchange->size = 0;
}

int gsn_ptp_transfer_alive(const struct gsn_ptp_exchange *exchange, int r)
{
    if (exchange->transport->alive)
        exchange->transport->alive(exchange->transport->alive_context);
    return r;
}

int gsn_ptp_transfer_broken(const char *what, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_IO, "the device %s", what);
}

int gsn_ptp_transfer_receive(struct gsn_ptp_exchange *exchange, size_t size, unsigned timeout_ms,
                             struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    const size_t had = exchange->size - exchange->at;
    size_t got = 0;
    int r;

    memmove(exchange->in, exchange->in + exchange->at, had);
    exchange->at = 0;
    exchange->end = exchange->size = had;
    r = gsn_ptp_transfer_alive(exchange, to->ops->receive(to->self, GSN_PTP_IN, exchange->in + had,
                                                          size, timeout_ms, &got, err));
    if (r == GSN_PTP_STALLED) {
        r = to->ops->clear_halt(to->self, GSN_PTP_IN, err);
        if (r >= 0)
            r = to->ops->receive(to->self, GSN_PTP_IN, exchange->in + had, size, timeout_ms, &got,
                                 err);
    }
    if (r < 0)
        return r;
    if (r == GSN_PTP_STALLED)
        return gsn_ptp_transfer_broken("halts its pipe again and again", err);
    if (r == GSN_PTP_TIMEOUT && got == 0)
        return gsn_fail(err, GSN_E_IO, "the device did not answer within %u s", timeout_ms / 1000);
    if (got > size)
        return gsn_ptp_transfer_broken("gave more bytes than there was room for", err);
    if (got == 0 && ++exchange->empty > MOST_EMPTY)
        return gsn_ptp_transfer_broken("sends nothing but empty packets", err);
    exchange->transfer_was_short = r == GSN_PTP_DONE && got < size;
    exchange->end = exchange->size = had + got;
    return GSN_OK;
}

int gsn_ptp_transfer_need(struct gsn_ptp_exchange *exchange, size_t size, unsigned timeout_ms,
                          struct gsn_error *err)
{
    int r = GSN_OK;

    while (r >= 0 && exchange->size - exchange->at < size)
        r = gsn_ptp_transfer_receive(exchange, exchange->packet, timeout_ms, err);
    return r;
}
