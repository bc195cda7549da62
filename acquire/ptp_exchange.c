/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One PTP transaction as USB transfers (PIMA 15740, annex D; USB Still Image Capture Device
 * Definition 1.0).
 *
 * Steps.
 * 1. The command container is sent; a halted pipe is cleared and the send tried once more.
 * 2. The header of the answer is awaited. Containers of older transactions are skipped, 16 at most.
 * 3. Data are handed out as they come. Where they end is decided by what came: by the length, or,
 *    where the header does not tell it or lies, by a short transfer; the response may share the
 * last transfer with the data, and its header may be cut by the end of a packet.
 * 4. The response ends the transaction.
 * Between transactions: resync cancels (0x64), waits for the device's status and drains the pipe;
 * reset (0x66) ends the session too. Events are taken in as hints while time passes.
 *
 * How it fails: GSN_E_IO leaves the exchange "on", and the session (ptp_session.c) decides what is
 * asked again; GSN_E_NOTFOUND is a device that is gone. Every loop has a bound: strays, empty
 * packets, drained transfers, events. tests/fuzz plays devices that keep to nothing. */
#include "acquire/ptp_exchange.h"

#include <string.h>

#include "pipeline/core/mem.h"

enum {
    LARGEST_READ = 65536,
    LARGEST_PACKET = 1024,
    SMALLEST_PACKET = 8, /* of bulk pipes at full speed */
    MOST_EMPTY = 64,     /* zero-length packets in one transaction */
};

/* Transfers. */

int gsn_ptp_exchange_init(struct gsn_ptp_exchange *exchange, struct gsn_ptp_transport *transport,
                          struct gsn_error *err)
{
    const size_t packet = transport->packet_size;
    uint8_t *in;

    if (packet < SMALLEST_PACKET || packet > LARGEST_PACKET || LARGEST_READ % packet != 0)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "the device's packets of %zu bytes are no USB",
                        packet);
    /* A read appends to less than a response that is not complete yet. */
    in = gsn_alloc(LARGEST_READ + LARGEST_PACKET);
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

static void forget_transfer(struct gsn_ptp_exchange *exchange)
{
    exchange->at = exchange->end = exchange->size = 0;
}

/* Gives a sign of life, and r. */
static int report_alive(const struct gsn_ptp_exchange *exchange, int r)
{
    if (exchange->transport->alive)
        exchange->transport->alive(exchange->transport->alive_context);
    return r;
}

/* Fails with GSN_E_IO: what the device does. */
static int fail_broken(const char *what, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_IO, "the device %s", what);
}

/* One transfer, put behind what is there. A halted pipe is cleared and read once more. */
static int receive_transfer(struct gsn_ptp_exchange *exchange, size_t size, unsigned timeout_ms,
                            struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    const size_t had = exchange->size - exchange->at;
    size_t got = 0;
    int r;

    memmove(exchange->in, exchange->in + exchange->at, had);
    exchange->at = 0;
    exchange->end = exchange->size = had;
    r = report_alive(exchange, to->ops->receive(to->self, GSN_PTP_IN, exchange->in + had, size,
                                                timeout_ms, &got, err));
    if (r == GSN_PTP_STALLED) {
        r = to->ops->clear_halt(to->self, GSN_PTP_IN, err);
        if (r >= 0)
            r = to->ops->receive(to->self, GSN_PTP_IN, exchange->in + had, size, timeout_ms, &got,
                                 err);
    }
    if (r < 0)
        return r;
    if (r == GSN_PTP_STALLED)
        return fail_broken("halts its pipe again and again", err);
    if (r == GSN_PTP_TIMEOUT && got == 0)
        return gsn_fail(err, GSN_E_IO, "the device did not answer within %u s", timeout_ms / 1000);
    if (got > size)
        return fail_broken("gave more bytes than there was room for", err);
    if (got == 0 && ++exchange->empty > MOST_EMPTY)
        return fail_broken("sends nothing but empty packets", err);
    exchange->transfer_was_short = r == GSN_PTP_DONE && got < size;
    exchange->end = exchange->size = had + got;
    return GSN_OK;
}

/* Reads packets until that many bytes are there: a header may come in parts. */
static int need_bytes(struct gsn_ptp_exchange *exchange, size_t size, unsigned timeout_ms,
                      struct gsn_error *err)
{
    int r = GSN_OK;

    while (r >= 0 && exchange->size - exchange->at < size)
        r = receive_transfer(exchange, exchange->packet, timeout_ms, err);
    return r;
}

enum {
    SEND_MS = 5000,
    MOST_STRAYS = 16, /* containers of older transactions before ours */
    MOST_STRAY_BYTES = 64 << 20,
};

/* The transaction. */

bool gsn_ptp_exchange_is_on(const struct gsn_ptp_exchange *exchange)
{
    return exchange->phase != GSN_PTP_IDLE;
}

bool gsn_ptp_exchange_was_short(const struct gsn_ptp_exchange *exchange)
{
    return exchange->data_were_short;
}

static struct gsn_ptp_header header_at(const struct gsn_ptp_exchange *exchange, size_t at)
{
    return gsn_ptp_read_header(exchange->in + at);
}

/* Whether our response begins there. */
static bool is_response(const struct gsn_ptp_exchange *exchange, size_t at)
{
    struct gsn_ptp_header header;

    if (exchange->size - at < GSN_PTP_HEADER)
        return false;
    header = header_at(exchange, at);
    return header.type == GSN_PTP_RESPONSE_BLOCK && header.transaction == exchange->transaction;
}

/* Whether our response, and nothing else, fills the transfer from there on. */
static bool is_whole_response(const struct gsn_ptp_exchange *exchange, size_t at)
{
    const size_t size = exchange->size - at;

    return is_response(exchange, at) && size <= GSN_PTP_LONGEST_RESPONSE &&
           header_at(exchange, at).length == size;
}

/* Where the length is not told, the response may still share the last transfer with the data. */
static void find_end(struct gsn_ptp_exchange *exchange)
{
    exchange->end = exchange->size;
    if (!exchange->untold)
        return;
    for (size_t size = GSN_PTP_HEADER; size <= GSN_PTP_LONGEST_RESPONSE; size += 4) {
        if (size <= exchange->size - exchange->at &&
            is_whole_response(exchange, exchange->size - size))
            exchange->end = exchange->size - size;
    }
}

int gsn_ptp_exchange_begin(struct gsn_ptp_exchange *exchange, const struct gsn_ptp_request *request,
                           uint32_t transaction, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    uint8_t command[GSN_PTP_LONGEST_RESPONSE];
    const size_t size = gsn_ptp_write_command(request, transaction, command);
    int r;

    forget_transfer(exchange);
    exchange->phase = GSN_PTP_ASKED;
    exchange->transaction = transaction;
    exchange->untold = exchange->data_were_short = false;
    exchange->left = 0;
    exchange->empty = 0;
    r = report_alive(exchange, to->ops->send(to->self, command, size, SEND_MS, err));
    if (r == GSN_PTP_STALLED) {
        r = to->ops->clear_halt(to->self, GSN_PTP_OUT, err);
        if (r >= 0)
            r = to->ops->send(to->self, command, size, SEND_MS, err);
    }
    if (r == GSN_PTP_STALLED || r == GSN_PTP_TIMEOUT)
        return fail_broken("takes no command", err);
    return r;
}

/* Answers to what was asked before: a session's first transaction is 0, and whatever else comes
 * then is of the session before. */
static bool is_older(const struct gsn_ptp_exchange *exchange, const struct gsn_ptp_header *header)
{
    if (header->type != GSN_PTP_DATA_BLOCK && header->type != GSN_PTP_RESPONSE_BLOCK)
        return false;
    return exchange->transaction == gsn_ptp_no_transaction
               ? header->transaction != gsn_ptp_no_transaction
               : header->transaction < exchange->transaction;
}

/* Drops an older container: a response with its transfer, data until their length or their end. */
static int skip_container(struct gsn_ptp_exchange *exchange, const struct gsn_ptp_header *header,
                          struct gsn_error *err)
{
    uint64_t left = header->length < GSN_PTP_HEADER ? GSN_PTP_HEADER : header->length;
    uint64_t dropped = 0;
    int r = GSN_OK;

    for (;;) {
        const size_t there = exchange->size - exchange->at;
        const size_t now = left < there ? (size_t)left : there;

        exchange->at += now;
        left -= now;
        dropped += now;
        if (left == 0 || header->type == GSN_PTP_RESPONSE_BLOCK ||
            (exchange->transfer_was_short && dropped > GSN_PTP_HEADER))
            return GSN_OK;
        if (dropped > MOST_STRAY_BYTES)
            return fail_broken("goes on answering an older question", err);
        r = receive_transfer(exchange, exchange->packet, GSN_PTP_ANSWER_MS, err);
        if (r < 0)
            return r;
    }
}

/* Waits for the header of what belongs to this transaction. */
static int meet_header(struct gsn_ptp_exchange *exchange, struct gsn_ptp_header *ret_header,
                       struct gsn_error *err)
{
    for (unsigned strays = 0; strays < MOST_STRAYS; strays++) {
        struct gsn_ptp_header header;
        int r = need_bytes(exchange, GSN_PTP_HEADER, GSN_PTP_ANSWER_MS, err);

        if (r < 0)
            return r;
        header = header_at(exchange, exchange->at);
        if (header.transaction == exchange->transaction &&
            (header.type == GSN_PTP_DATA_BLOCK || header.type == GSN_PTP_RESPONSE_BLOCK)) {
            *ret_header = header;
            return GSN_OK;
        }
        if (!is_older(exchange, &header))
            return fail_broken("answers what was not asked", err);
        r = skip_container(exchange, &header, err);
        if (r < 0)
            return r;
    }
    return fail_broken("goes on answering older questions", err);
}

static int meet_answer(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    struct gsn_ptp_header header;
    const int r = meet_header(exchange, &header, err);

    if (r < 0)
        return r;
    if (header.type == GSN_PTP_RESPONSE_BLOCK) {
        exchange->phase = GSN_PTP_ANSWERED;
        return GSN_OK;
    }
    exchange->phase = GSN_PTP_DATA;
    exchange->untold = header.length == gsn_ptp_every || header.length < GSN_PTP_HEADER;
    exchange->left = exchange->untold ? 0 : header.length - GSN_PTP_HEADER;
    exchange->at += GSN_PTP_HEADER;
    find_end(exchange);
    return GSN_OK;
}

static size_t read_size(const struct gsn_ptp_exchange *exchange)
{
    if (exchange->untold || exchange->left >= LARGEST_READ)
        return LARGEST_READ;
    if (exchange->left >= exchange->packet)
        return (size_t)(exchange->left - exchange->left % exchange->packet);
    return exchange->packet;
}

/* The next transfer of the data; or, where they ended early, the response. */
static int receive_data(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const int r = receive_transfer(exchange, read_size(exchange), GSN_PTP_ANSWER_MS, err);

    if (r < 0)
        return r;
    if (is_whole_response(exchange, exchange->at)) {
        exchange->data_were_short = !exchange->untold;
        exchange->phase = GSN_PTP_ANSWERED;
    }
    find_end(exchange);
    return GSN_OK;
}

/* Whether what is left of the transfer may be the beginning of our response, cut by the end of a
 * packet. */
static bool begins_like_response(const struct gsn_ptp_exchange *exchange)
{
    const size_t size = exchange->size - exchange->at;
    uint8_t truth[GSN_PTP_HEADER] = { 0, 0, 0, 0, GSN_PTP_RESPONSE_BLOCK };

    if (size >= GSN_PTP_HEADER)
        return false;
    truth[0] = exchange->in[exchange->at]; /* the length: any */
    for (size_t i = 6; i < 8 && i < size; i++)
        truth[i] = exchange->in[exchange->at + i]; /* the code: any */
    for (size_t i = 8; i < GSN_PTP_HEADER; i++)
        truth[i] = (uint8_t)(exchange->transaction >> 8 * (i - 8));
    return truth[0] >= GSN_PTP_HEADER && truth[0] <= GSN_PTP_LONGEST_RESPONSE &&
           memcmp(exchange->in + exchange->at, truth, size) == 0;
}

/* The data that were announced are all there, and the transfer may hold more: our response, or
 * what shows that the length was a lie. */
static int leave_data(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    int r = GSN_OK;

    if (exchange->at < exchange->size && begins_like_response(exchange))
        r = need_bytes(exchange, GSN_PTP_HEADER, GSN_PTP_ANSWER_MS, err);
    if (r < 0)
        return r;
    if (exchange->at == exchange->size || is_response(exchange, exchange->at)) {
        exchange->phase = GSN_PTP_ANSWERED;
        return GSN_OK;
    }
    exchange->untold = true;
    find_end(exchange);
    return GSN_OK;
}

static size_t hand_out(struct gsn_ptp_exchange *exchange, uint8_t *buffer, size_t size)
{
    size_t now = exchange->end - exchange->at;

    if (now > size)
        now = size;
    if (!exchange->untold && now > exchange->left)
        now = (size_t)exchange->left;
    memcpy(buffer, exchange->in + exchange->at, now);
    exchange->at += now;
    if (!exchange->untold)
        exchange->left -= now;
    return now;
}

/* Of untold data the last transfer is out. */
static bool is_at_end(const struct gsn_ptp_exchange *exchange)
{
    return exchange->untold && exchange->at == exchange->end &&
           (exchange->end < exchange->size ||
            (exchange->transfer_was_short && exchange->size != GSN_PTP_HEADER));
}

int gsn_ptp_exchange_data(struct gsn_ptp_exchange *exchange, uint8_t *buffer, size_t size,
                          size_t *ret_got, struct gsn_error *err)
{
    size_t got = 0;
    int r = GSN_OK;

    if (exchange->phase == GSN_PTP_ASKED)
        r = meet_answer(exchange, err);
    while (r >= 0 && exchange->phase == GSN_PTP_DATA && got < size) {
        if (!exchange->untold && exchange->left == 0)
            r = leave_data(exchange, err);
        else if (is_at_end(exchange))
            exchange->phase = GSN_PTP_ANSWERED;
        else if (exchange->at < exchange->end)
            got += hand_out(exchange, buffer + got, size - got);
        else
            r = receive_data(exchange, err);
    }
    if (r < 0)
        return r;
    *ret_got = got;
    return GSN_OK;
}

/* The response is there from its header on; its parameters may be cut off by short transfers. */
static int take_response(struct gsn_ptp_exchange *exchange, const struct gsn_ptp_header *header,
                         struct gsn_ptp_response *ret_response, struct gsn_error *err)
{
    size_t size = header->length;

    if (size < GSN_PTP_HEADER || size > GSN_PTP_LONGEST_RESPONSE)
        size = GSN_PTP_HEADER;
    if (need_bytes(exchange, size, GSN_PTP_DRAIN_MS, err) == GSN_E_NOTFOUND)
        return GSN_E_NOTFOUND;
    if (size > exchange->size - exchange->at)
        size = exchange->size - exchange->at;
    *ret_response = gsn_ptp_read_response(exchange->in + exchange->at, size);
    forget_transfer(exchange);
    exchange->phase = GSN_PTP_IDLE;
    return GSN_OK;
}

int gsn_ptp_exchange_end(struct gsn_ptp_exchange *exchange, struct gsn_ptp_response *ret_response,
                         struct gsn_error *err)
{
    struct gsn_ptp_header header;
    const int r = meet_header(exchange, &header, err);

    if (r < 0)
        return r;
    if (header.type != GSN_PTP_RESPONSE_BLOCK)
        return fail_broken("sends data where its response is due", err);
    return take_response(exchange, &header, ret_response, err);
}

enum {
    MOST_DRAINS = 512, /* transfers thrown away before the device is called unstoppable */
    MOST_EVENTS = 64,  /* taken in at once */
    MOST_STATUS_ASKED = 10,
    STATUS_MS = 100,
};

/* Back to silence. */

/* Failures that no further step can mend. */
static bool is_fatal(int r)
{
    return r == GSN_E_NOTFOUND || r == GSN_E_NOMEM;
}

static int clear_halts(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    int r = report_alive(exchange, to->ops->clear_halt(to->self, GSN_PTP_IN, err));

    if (!is_fatal(r))
        r = to->ops->clear_halt(to->self, GSN_PTP_OUT, err);
    return is_fatal(r) ? r : GSN_OK;
}

/* Reads until nothing comes. */
static int drain_pipe(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;

    forget_transfer(exchange);
    for (unsigned n = 0; n < MOST_DRAINS; n++) {
        size_t got = 0;
        int r = report_alive(exchange, to->ops->receive(to->self, GSN_PTP_IN, exchange->in,
                                                        LARGEST_READ, GSN_PTP_DRAIN_MS, &got, err));

        if (r == GSN_PTP_STALLED)
            r = to->ops->clear_halt(to->self, GSN_PTP_IN, err);
        if (is_fatal(r) || (r == GSN_PTP_TIMEOUT && got == 0))
            return r < 0 ? r : GSN_OK;
    }
    return fail_broken("does not stop sending", err);
}

/* After Cancel the device says itself when it is ready, and whether pipes are halted. */
static int await_status(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;

    for (unsigned n = 0; n < MOST_STATUS_ASKED; n++) {
        uint16_t code = GSN_PTP_OK;
        int r = report_alive(exchange, to->ops->status(to->self, &code, err));

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
    int r = report_alive(exchange, to->ops->cancel(to->self, exchange->transaction, err));

    exchange->phase = GSN_PTP_IDLE;
    if (!is_fatal(r))
        r = await_status(exchange, err);
    return is_fatal(r) ? r : drain_pipe(exchange, err);
}

int gsn_ptp_exchange_reset(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const struct gsn_ptp_transport *const to = exchange->transport;
    int r = report_alive(exchange, to->ops->reset(to->self, err));

    exchange->phase = GSN_PTP_IDLE;
    if (!is_fatal(r))
        r = clear_halts(exchange, err);
    return is_fatal(r) ? r : drain_pipe(exchange, err);
}

static void note_event(struct gsn_ptp_hints *hints, const uint8_t *bytes, size_t size)
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
        uint8_t bytes[LARGEST_PACKET];
        size_t got = 0;
        int r = report_alive(exchange, to->ops->receive(to->self, GSN_PTP_EVENT, bytes,
                                                        sizeof bytes, ms, &got, err));

        if (r == GSN_PTP_STALLED)
            r = to->ops->clear_halt(to->self, GSN_PTP_EVENT, err);
        else if (r == GSN_PTP_DONE)
            note_event(&exchange->hints, bytes, got);
        if (r == GSN_E_NOTFOUND)
            return r;
        if (r != GSN_PTP_DONE)
            return GSN_OK;
    }
    return GSN_OK;
}
