/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_transfer.h"

enum {
    MOST_DRAINS = 512, /* transfers thrown away before the device is called unstoppable */
    MOST_EVENTS = 64,  /* taken in at once */
    MOST_STATUS_ASKED = 10,
    STATUS_MS = 100,
};

/* Failures that no further step can mend. */
static bool is_fatal(int r)
{
    return r == GSN_E_NOTFOUND || r == GSN_E_NOMEM;
}

static int clear_halts(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    int r = gsn_ptp_transfer_alive(exchange, to->ops->clear_halt(to->self, GSN_PTP_IN, err));

    if (!is_fatal(r))
        r = to->ops->clear_halt(to->self, GSN_PTP_OUT, err);
    return is_fatal(r) ? r : GSN_OK;
}

/* Reads until nothing comes. */
static int drain(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;

    gsn_ptp_transfer_forget(exchange);
    for (unsigned n = 0; n < MOST_DRAINS; n++) {
        size_t got = 0;
        int r = gsn_ptp_transfer_alive(
            exchange, to->ops->receive(to->self, GSN_PTP_IN, exchange->in, GSN_PTP_LARGEST_READ,
                                       GSN_PTP_DRAIN_MS, &got, err));

        if (r == GSN_PTP_STALLED)
            r = to->ops->clear_halt(to->self, GSN_PTP_IN, err);
        if (is_fatal(r) || (r == GSN_PTP_TIMEOUT && got == 0))
            return r < 0 ? r : GSN_OK;
    }
    return gsn_ptp_transfer_broken("does not stop sending", err);
}

/* After Cancel the device says itself when it is ready, and whether pipes are halted. */
static int await_status(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;

    for (unsigned n = 0; n < MOST_STATUS_ASKED; n++) {
        uint16_t code = GSN_PTP_OK;
        int r = gsn_ptp_transfer_alive(exchange, to->ops->status(to->self, &code, err));

        if (is_fatal(r))
            return r;
        if (r == GSN_PTP_DONE && code == GSN_PTP_DEVICE_BUSY)
            r = gsn_ptp_exchange_pause(exchange, STATUS_MS, err);
        else
            return r == GSN_PTP_DONE && code == GSN_PTP_OK ? GSN_OK : clear_halts(exchange, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

int gsn_ptp_exchange_resync(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    int r = gsn_ptp_transfer_alive(exchange, to->ops->cancel(to->self, exchange->transaction, err));

    exchange->phase = GSN_PTP_IDLE;
    if (!is_fatal(r))
        r = await_status(exchange, err);
    return is_fatal(r) ? r : drain(exchange, err);
}

int gsn_ptp_exchange_reset(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    int r = gsn_ptp_transfer_alive(exchange, to->ops->reset(to->self, err));

    exchange->phase = GSN_PTP_IDLE;
    if (!is_fatal(r))
        r = clear_halts(exchange, err);
    return is_fatal(r) ? r : drain(exchange, err);
}

static void note(struct gsn_ptp_hints *hints, const uint8_t *bytes, size_t size)
{
    struct gsn_ptp_event event;

    if (gsn_ptp_read_event(bytes, size, &event, NULL) < 0)
        return;
    hints->any = 1;
    if (event.code != GSN_PTP_OBJECT_INFO_CHANGED)
        return;
    for (size_t i = 0; i < hints->changed_count; i++) {
        if (hints->changed[i] == event.parameter)
            return;
    }
    if (hints->changed_count == sizeof hints->changed / sizeof hints->changed[0])
        hints->all_changed = 1;
    else
        hints->changed[hints->changed_count++] = event.parameter;
}

int gsn_ptp_exchange_pause(struct gsn_ptp_exchange *exchange, unsigned ms, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;

    for (unsigned n = 0; n < MOST_EVENTS; n++) {
        uint8_t bytes[GSN_PTP_LARGEST_PACKET];
        size_t got = 0;
        int r = gsn_ptp_transfer_alive(exchange, to->ops->receive(to->self, GSN_PTP_EVENT, bytes,
                                                                  sizeof bytes, ms, &got, err));

        if (r == GSN_PTP_STALLED)
            r = to->ops->clear_halt(to->self, GSN_PTP_EVENT, err);
        else if (r == GSN_PTP_DONE)
            note(&exchange->hints, bytes, got);
        if (r == GSN_E_NOTFOUND)
            return r;
        if (r != GSN_PTP_DONE)
            return GSN_OK;
    }
    return GSN_OK;
}
