/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_exchange.h"

#include <string.h>

#include "acquire/ptp_transfer.h"

enum {
    SEND_MS = 5000,
    MOST_STRAYS = 16, /* containers of older transactions before ours */
    MOST_STRAY_BYTES = 64 << 20,
};

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

    gsn_ptp_transfer_forget(exchange);
    exchange->phase = GSN_PTP_ASKED;
    exchange->transaction = transaction;
    exchange->untold = exchange->data_were_short = false;
    exchange->left = 0;
    exchange->empty = 0;
    r = gsn_ptp_transfer_alive(exchange, to->ops->send(to->self, command, size, SEND_MS, err));
    if (r == GSN_PTP_STALLED) {
        r = to->ops->clear_halt(to->self, GSN_PTP_OUT, err);
        if (r >= 0)
            r = to->ops->send(to->self, command, size, SEND_MS, err);
    }
    if (r == GSN_PTP_STALLED || r == GSN_PTP_TIMEOUT)
        return gsn_ptp_transfer_broken("takes no command", err);
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
static int skip(struct gsn_ptp_exchange *exchange, const struct gsn_ptp_header *header,
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
            return gsn_ptp_transfer_broken("goes on answering an older question", err);
        r = gsn_ptp_transfer_receive(exchange, exchange->packet, GSN_PTP_ANSWER_MS, err);
        if (r < 0)
            return r;
    }
}

/* Waits for the header of what belongs to this transaction. */
static int meet(struct gsn_ptp_exchange *exchange, struct gsn_ptp_header *ret_header,
                struct gsn_error *err)
{
    for (unsigned strays = 0; strays < MOST_STRAYS; strays++) {
        struct gsn_ptp_header header;
        int r = gsn_ptp_transfer_need(exchange, GSN_PTP_HEADER, GSN_PTP_ANSWER_MS, err);

        if (r < 0)
            return r;
        header = header_at(exchange, exchange->at);
        if (header.transaction == exchange->transaction &&
            (header.type == GSN_PTP_DATA_BLOCK || header.type == GSN_PTP_RESPONSE_BLOCK)) {
            *ret_header = header;
            return GSN_OK;
        }
        if (!is_older(exchange, &header))
            return gsn_ptp_transfer_broken("answers what was not asked", err);
        r = skip(exchange, &header, err);
        if (r < 0)
            return r;
    }
    return gsn_ptp_transfer_broken("goes on answering older questions", err);
}

static int meet_answer(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    struct gsn_ptp_header header;
    const int r = meet(exchange, &header, err);

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
    if (exchange->untold || exchange->left >= GSN_PTP_LARGEST_READ)
        return GSN_PTP_LARGEST_READ;
    if (exchange->left >= exchange->packet)
        return (size_t)(exchange->left - exchange->left % exchange->packet);
    return exchange->packet;
}

/* The next transfer of the data; or, where they ended early, the response. */
static int receive_data(struct gsn_ptp_exchange *exchange, struct gsn_error *err)
{
    const int r = gsn_ptp_transfer_receive(exchange, read_size(exchange), GSN_PTP_ANSWER_MS, err);

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
        r = gsn_ptp_transfer_need(exchange, GSN_PTP_HEADER, GSN_PTP_ANSWER_MS, err);
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
    if (gsn_ptp_transfer_need(exchange, size, GSN_PTP_DRAIN_MS, err) == GSN_E_NOTFOUND)
        return GSN_E_NOTFOUND;
    if (size > exchange->size - exchange->at)
        size = exchange->size - exchange->at;
    *ret_response = gsn_ptp_read_response(exchange->in + exchange->at, size);
    gsn_ptp_transfer_forget(exchange);
    exchange->phase = GSN_PTP_IDLE;
    return GSN_OK;
}

int gsn_ptp_exchange_end(struct gsn_ptp_exchange *exchange, struct gsn_ptp_response *ret_response,
                         struct gsn_error *err)
{
    struct gsn_ptp_header header;
    const int r = meet(exchange, &header, err);

    if (r < 0)
        return r;
    if (header.type != GSN_PTP_RESPONSE_BLOCK)
        return gsn_ptp_transfer_broken("sends data where its response is due", err);
    return take_response(exchange, &header, ret_response, err);
}
