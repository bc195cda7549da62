/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A PTP session that survives its device: what is asked again, and how often.
 *
 * Steps for one question.
 * 1. A transaction that is still under way is cancelled and the pipe drained.
 * 2. The session is opened if it is not; one that is open there already is closed and opened anew.
 * 3. The question, its data into a sink with a limit, its response.
 * 4. "Device Busy" is waited for with pauses from 100 ms to 2 s, 10 s in all. Silence and nonsense
 *    lead to Cancel and the same question again, then to Device Reset, a new session and the
 * question a last time. A device that forgot the session gets a new one.
 *
 * How it fails: three tries, then GSN_E_IO. A deletion is asked for once, in the session that its
 * handle is of: in the next session the handle may be another object's. */
#include "acquire/ptp_session.h"

#include <assert.h>
#include <stdbool.h>
#include <string.h>

#include "acquire/ptp_exchange.h"

enum {
    FIRST_PAUSE_MS = 100, /* before a busy device is asked again; doubles */
    LONGEST_PAUSE_MS = 2000,
    FIRST_ROOM = 4096, /* bytes for an answer of unknown size */
    MOST_TRIES = 3,    /* of one question */
};

struct gsn_ptp_session {
    struct gsn_ptp_exchange exchange;
    bool open;
    unsigned number;
    uint32_t transaction; /* the last one used */
};

/* Where the data of an answer go. */
struct sink {
    uint8_t *bytes;
    size_t room, limit, used;
    bool grows; /* bytes is ours, and may be made larger up to the limit */
};

int gsn_ptp_session_new(struct gsn_ptp_transport *transport, struct gsn_ptp_session **ret_session,
                        struct gsn_error *err)
{
    gsn_auto(gsn_ptp_session) session = gsn_alloc_array(1, sizeof *session);
    int r;

    if (!session)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PTP session");
    r = gsn_ptp_exchange_init(&session->exchange, transport, err);
    if (r < 0)
        return r;
    *ret_session = gsn_steal(&session);
    return GSN_OK;
}

void gsn_ptp_session_free(struct gsn_ptp_session *session)
{
    if (session)
        gsn_ptp_exchange_done(&session->exchange);
    gsn_free(session);
}

unsigned gsn_ptp_session_number(const struct gsn_ptp_session *session)
{
    return session->number;
}

void gsn_ptp_session_count_from(struct gsn_ptp_session *session, unsigned number)
{
    session->number = number;
}

static uint32_t next_transaction(struct gsn_ptp_session *session, uint16_t operation)
{
    if (operation == GSN_PTP_OPEN_SESSION || !session->open)
        return gsn_ptp_no_transaction;
    session->transaction =
        session->transaction == gsn_ptp_last_transaction ? 1 : session->transaction + 1;
    return session->transaction;
}

static int make_room(struct sink *sink, struct gsn_error *err)
{
    size_t room = sink->room ? 2 * sink->room : FIRST_ROOM;
    uint8_t *bytes;

    if (!sink->grows || sink->room == sink->limit)
        return gsn_fail(err, GSN_E_LIMIT, "the device sends more than the %zu bytes asked for",
                        sink->limit);
    if (room > sink->limit)
        room = sink->limit;
    bytes = gsn_realloc_array(sink->bytes, room, 1);
    if (!bytes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu bytes of an answer", room);
    sink->bytes = bytes;
    sink->room = room;
    return GSN_OK;
}

/* All data of the answer under way. When the sink is full, one byte more is too many. */
static int pour_data(struct gsn_ptp_session *session, struct sink *sink, struct gsn_error *err)
{
    for (;;) {
        const bool full = sink->used == sink->room;
        uint8_t one_more;
        size_t got = 0;
        const int r =
            gsn_ptp_exchange_data(&session->exchange, full ? &one_more : sink->bytes + sink->used,
                                  full ? 1 : sink->room - sink->used, &got, err);

        if (r < 0 || got == 0)
            return r;
        if (full) {
            const int grown = make_room(sink, err);

            if (grown < 0)
                return grown;
            sink->bytes[sink->used] = one_more;
        }
        sink->used += got;
    }
}

/* The question once, as the standard says. Data that end before the length they claimed are a
 * failure, unless they are all that was wanted. */
static int ask_once(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                    struct sink *sink, struct gsn_ptp_response *ret_response, struct gsn_error *err)
{
    const uint32_t transaction = next_transaction(session, request->operation);
    int r = gsn_ptp_exchange_begin(&session->exchange, request, transaction, err);

    sink->used = 0;
    if (r >= 0)
        r = pour_data(session, sink, err);
    if (r >= 0)
        r = gsn_ptp_exchange_end(&session->exchange, ret_response, err);
    if (r >= 0 && gsn_ptp_exchange_was_short(&session->exchange) &&
        ret_response->code == GSN_PTP_OK && (sink->grows || sink->used < sink->limit))
        r = gsn_fail(err, GSN_E_IO, "the device broke its data off after %zu bytes", sink->used);
    return r;
}

static bool is_final(int r)
{
    return r >= 0 || r == GSN_E_NOTFOUND || r == GSN_E_NOMEM;
}

static int open_once(struct gsn_ptp_session *session, struct gsn_ptp_response *ret_response,
                     struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_OPEN_SESSION, 1, { 1 } };
    struct sink nothing = { 0 };

    return ask_once(session, &request, &nothing, ret_response, err);
}

static void close_once(struct gsn_ptp_session *session)
{
    const struct gsn_ptp_request request = { .operation = GSN_PTP_CLOSE_SESSION };
    struct gsn_ptp_response response;
    struct sink nothing = { 0 };

    (void)ask_once(session, &request, &nothing, &response, NULL);
    session->open = false;
}

/* Sets what a fresh session starts from. */
static void begin_numbering(struct gsn_ptp_session *session)
{
    session->open = true;
    session->transaction = 0;
    session->number++;
}

static int fail_refused(const char *what, uint16_t code, struct gsn_error *err)
{
    char words[80];

    gsn_ptp_describe(code, words, sizeof words);
    return gsn_fail(err, GSN_E_IO, "the device refused %s: %s", what, words);
}

/* Opens, or opens anew. Mends nothing else. */
static int open_plainly(struct gsn_ptp_session *session, struct gsn_error *err)
{
    struct gsn_ptp_response response = { 0 };
    int r = open_once(session, &response, err);

    if (r >= 0 && response.code == GSN_PTP_SESSION_ALREADY_OPEN) {
        begin_numbering(session);
        close_once(session);
        r = open_once(session, &response, err);
        if (r >= 0 && response.code == GSN_PTP_SESSION_ALREADY_OPEN)
            response.code = GSN_PTP_OK;
    }
    if (r >= 0 && response.code == GSN_PTP_DEVICE_BUSY)
        return gsn_fail(err, GSN_E_BUSY, "the device says that it is busy");
    if (r >= 0 && response.code != GSN_PTP_OK)
        return fail_refused("to open a session", response.code, err);
    if (r >= 0)
        begin_numbering(session);
    return r;
}

/* Before a question is tried again: gently after the first failure, by a reset after the second. */
static int mend_exchange(struct gsn_ptp_session *session, unsigned failures, struct gsn_error *err)
{
    int r = GSN_E_IO;

    if (failures == 1)
        r = gsn_ptp_exchange_resync(&session->exchange, err);
    if (is_final(r))
        return r;
    session->open = false;
    return gsn_ptp_exchange_reset(&session->exchange, err);
}

struct pauses {
    unsigned next_ms, total_ms;
};

/* The next pause before a busy device is asked again; fails when there were enough of them. */
static int wait_for_busy(struct gsn_ptp_session *session, struct pauses *pauses,
                         struct gsn_error *err)
{
    if (pauses->total_ms >= GSN_PTP_BUSY_MS)
        return gsn_fail(err, GSN_E_BUSY, "the device says that it is busy, for %u s by now",
                        pauses->total_ms / 1000);
    if (pauses->next_ms == 0)
        pauses->next_ms = FIRST_PAUSE_MS;
    pauses->total_ms += pauses->next_ms;
    if (gsn_ptp_exchange_pause(&session->exchange, pauses->next_ms, err) < 0)
        return GSN_E_NOTFOUND;
    pauses->next_ms =
        2 * pauses->next_ms > LONGEST_PAUSE_MS ? LONGEST_PAUSE_MS : 2 * pauses->next_ms;
    return GSN_OK;
}

int gsn_ptp_session_open(struct gsn_ptp_session *session, struct gsn_error *err)
{
    struct pauses pauses = { 0 };
    unsigned failures = 0;

    for (;;) {
        const int r = open_plainly(session, err);
        int mended = GSN_OK;

        if (is_final(r))
            return r;
        if (r == GSN_E_BUSY)
            mended = wait_for_busy(session, &pauses, err);
        else if (++failures == MOST_TRIES)
            return r;
        else
            mended = mend_exchange(session, failures, err);
        if (mended < 0)
            return mended;
    }
}

/* A deletion is asked for once, in the session that its handle is of: in the next one, the handle
 * may be another object's. */
static bool is_for_once(const struct gsn_ptp_request *request)
{
    return request->operation == GSN_PTP_DELETE_OBJECT;
}

static bool is_session_lost(const struct gsn_ptp_response *response)
{
    return response->code == GSN_PTP_SESSION_NOT_OPEN ||
           response->code == GSN_PTP_INVALID_TRANSACTION_ID;
}

static int ask_this_once(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                         struct sink *sink, struct gsn_ptp_response *response,
                         struct gsn_error *err)
{
    int r = GSN_OK;

    if (session->open)
        r = ask_once(session, request, sink, response, err);
    if (r >= 0 && is_session_lost(response))
        session->open = false;
    if (r >= 0 && !session->open)
        return gsn_fail(err, GSN_E_IO, "the device began anew");
    return r;
}

/* In a session that is open for sure. */
static int ask_in_session(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                          struct sink *sink, struct gsn_ptp_response *response,
                          struct gsn_error *err)
{
    int r = session->open ? GSN_OK : gsn_ptp_session_open(session, err);

    if (r >= 0)
        r = ask_once(session, request, sink, response, err);
    if (r < 0 || !is_session_lost(response))
        return r;
    /* It forgot the session, or counts differently: both begin afresh. */
    session->open = false;
    r = gsn_ptp_session_open(session, err);
    return r < 0 ? r : ask_once(session, request, sink, response, err);
}

static int ask_until_answered(struct gsn_ptp_session *session,
                              const struct gsn_ptp_request *request, struct sink *sink,
                              struct gsn_ptp_response *ret_response, struct gsn_error *err)
{
    struct pauses pauses = { 0 };
    unsigned failures = 0;

    for (;;) {
        struct gsn_ptp_response response = { 0 };
        int r = GSN_OK, mended = GSN_OK;

        if (gsn_ptp_exchange_is_on(&session->exchange))
            r = gsn_ptp_exchange_resync(&session->exchange, err);
        if (r >= 0 && !is_for_once(request))
            r = ask_in_session(session, request, sink, &response, err);
        else if (r >= 0)
            r = ask_this_once(session, request, sink, &response, err);
        if (r >= 0 && response.code == GSN_PTP_DEVICE_BUSY)
            mended = wait_for_busy(session, &pauses, err);
        else if (r >= 0)
            *ret_response = response;
        if (r == GSN_E_BUSY || (is_final(r) && response.code != GSN_PTP_DEVICE_BUSY))
            return r;
        /* Opening a session has mended all it could. */
        if (r < 0 && (!session->open || is_for_once(request)))
            return r;
        if (r < 0 && (++failures == MOST_TRIES || r == GSN_E_LIMIT))
            return r;
        if (r < 0)
            mended = mend_exchange(session, failures, err);
        if (mended < 0)
            return mended;
    }
}

int gsn_ptp_ask(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                void *buffer, size_t size, size_t *ret_got, struct gsn_ptp_response *ret_response,
                struct gsn_error *err)
{
    struct sink sink = { .bytes = buffer, .room = size, .limit = size };
    const int r = ask_until_answered(session, request, &sink, ret_response, err);

    if (r >= 0)
        *ret_got = sink.used;
    return r;
}

int gsn_ptp_fetch(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                  size_t limit, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_ptp_response *ret_response, struct gsn_error *err)
{
    struct sink sink = { .limit = limit, .grows = true };
    int r = make_room(&sink, err);

    if (r >= 0)
        r = ask_until_answered(session, request, &sink, ret_response, err);
    if (r < 0) {
        gsn_free(sink.bytes);
        return r;
    }
    *ret_bytes = sink.bytes;
    *ret_size = sink.used;
    return GSN_OK;
}

void gsn_ptp_session_close(struct gsn_ptp_session *session)
{
    int r = GSN_OK;

    if (gsn_ptp_exchange_is_on(&session->exchange))
        r = gsn_ptp_exchange_resync(&session->exchange, NULL);
    if (r >= 0 && session->open)
        close_once(session);
    session->open = false;
}

int gsn_ptp_stream_start(struct gsn_ptp_session *session, const struct gsn_ptp_request *request,
                         struct gsn_error *err)
{
    int r = GSN_OK;

    if (gsn_ptp_exchange_is_on(&session->exchange))
        r = gsn_ptp_exchange_resync(&session->exchange, err);
    if (r >= 0 && !session->open)
        r = gsn_ptp_session_open(session, err);
    if (r < 0)
        return r;
    return gsn_ptp_exchange_begin(&session->exchange, request,
                                  next_transaction(session, request->operation), err);
}

int gsn_ptp_stream_read(struct gsn_ptp_session *session, void *buffer, size_t size, size_t *ret_got,
                        struct gsn_error *err)
{
    if (!gsn_ptp_exchange_is_on(&session->exchange))
        return gsn_fail(err, GSN_E_IO, "nothing is being received");
    return gsn_ptp_exchange_data(&session->exchange, buffer, size, ret_got, err);
}

int gsn_ptp_stream_end(struct gsn_ptp_session *session, struct gsn_ptp_response *ret_response,
                       struct gsn_error *err)
{
    if (!gsn_ptp_exchange_is_on(&session->exchange))
        return gsn_fail(err, GSN_E_IO, "nothing is being received");
    return gsn_ptp_exchange_end(&session->exchange, ret_response, err);
}

int gsn_ptp_stream_is_on(const struct gsn_ptp_session *session)
{
    return gsn_ptp_exchange_is_on(&session->exchange);
}

int gsn_ptp_session_hints(struct gsn_ptp_session *session, struct gsn_ptp_hints *ret_hints,
                          struct gsn_error *err)
{
    const int r = gsn_ptp_exchange_pause(&session->exchange, 0, err);

    if (r < 0)
        return r;
    *ret_hints = session->exchange.hints;
    session->exchange.hints = (struct gsn_ptp_hints){ 0 };
    return GSN_OK;
}
