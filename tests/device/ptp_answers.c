/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/ptp_answers.h"

#include <stdlib.h>
#include <string.h>

#include "tests/device/wire.h"

enum { HEADER = 12, DATA = 2, RESPONSE = 3, PARTS = 4 };

/* clang-format off */
const uint8_t ptp_config_descriptor[PTP_CONFIG] = {
    9, 2, WIRE16(PTP_CONFIG), 1, 1, 0, 0xc0, 50,
    9, 4, 0, 0, 3, 6, 1, 1, 0,
    7, 5, 0x81, 2, WIRE16(PTP_PACKET), 0,
    7, 5, 0x02, 2, WIRE16(PTP_PACKET), 0,
    7, 5, 0x83, 3, WIRE16(28), 8,
};
/* clang-format on */

/* What comes after the last byte of a part. */
enum end {
    RUN_ON,   /* the next part, in the same packet */
    FINISHED, /* a short packet; a zero-length one where the last was full */
    NO_ZLP,   /* the same, but the zero-length one is forgotten */
};

/* A stretch of bytes that crosses the bus. */
struct part {
    struct ptp_payload payload;
    enum end end;
};

struct queued {
    struct queued *next;
    int64_t ready_ms;
    bool held;
    uint8_t header[HEADER], response[HEADER + 20];
    size_t parts, now;
    uint64_t at; /* in the part of now */
    struct part part[];
};

struct ptp_answers {
    const struct ptp_faults *faults;
    struct queued *first;
    uint64_t in_block; /* bytes since the last packet boundary by force */
    uint64_t given, given_since_plugged;
    unsigned transfers, headers;
    bool halted;
};

struct ptp_answers *ptp_answers_new(const struct ptp_faults *faults)
{
    struct ptp_answers *const answers = calloc(1, sizeof *answers);

    if (answers)
        answers->faults = faults;
    return answers;
}

static void drop_first(struct ptp_answers *answers)
{
    struct queued *const first = answers->first;

    answers->first = first->next;
    answers->in_block = 0;
    for (size_t i = 0; i < first->parts; i++)
        free(first->part[i].payload.owned);
    free(first);
}

void ptp_answers_clear(struct ptp_answers *answers)
{
    while (answers->first)
        drop_first(answers);
}

void ptp_answers_restart(struct ptp_answers *answers)
{
    ptp_answers_clear(answers);
    answers->given_since_plugged = 0;
    answers->transfers = answers->headers = 0;
    answers->halted = false;
}

void ptp_answers_free(struct ptp_answers *answers)
{
    if (answers)
        ptp_answers_clear(answers);
    free(answers);
}

static void put_header(uint8_t *to, uint64_t size, unsigned type, uint16_t code, uint32_t id)
{
    wire_put32(to, size > UINT32_MAX ? UINT32_MAX : (uint32_t)size);
    wire_put16(to + 4, type);
    wire_put16(to + 6, code);
    wire_put32(to + 8, id);
}

static void add_part(struct queued *queued, const struct ptp_payload *payload, enum end end)
{
    queued->part[queued->parts++] = (struct part){ *payload, end };
}

static void add_bytes(struct queued *queued, const uint8_t *bytes, size_t size, enum end end)
{
    add_part(queued, &(struct ptp_payload){ .size = size, .bytes = bytes }, end);
}

static bool is_hit(const struct ptp_answer *answer, unsigned at)
{
    return at > 0 && answer->nth == at;
}

static void add_data(struct ptp_answers *answers, struct queued *queued,
                     const struct ptp_answer *answer, uint32_t id)
{
    const struct ptp_faults *const faults = answers->faults;
    struct ptp_payload payload = *answer->payload;

    put_header(queued->header, HEADER + payload.size, DATA, answer->operation, id);
    if (++answers->headers == faults->lying_length_at)
        wire_put32(queued->header, answers->headers % 2 ? 0x7fffffff : 5);
    if (is_hit(answer, faults->short_data_at))
        payload.size /= 2;
    add_bytes(queued, queued->header, HEADER, faults->split_header ? FINISHED : RUN_ON);
    if (payload.size == 0 && faults->split_header)
        free(payload.owned); /* the header alone was all of it */
    else
        add_part(queued, &payload,
                 faults->merge_response ? RUN_ON
                 : faults->no_zlp       ? NO_ZLP
                                        : FINISHED);
}

static void add_response(const struct ptp_answers *answers, struct queued *queued,
                         const struct ptp_answer *answer, uint32_t id)
{
    const size_t size = HEADER + 4 * answer->count;

    put_header(queued->response, size, RESPONSE, answer->code, id);
    for (unsigned i = 0; i < answer->count; i++)
        wire_put32(queued->response + HEADER + 4 * (size_t)i, answer->parameter[i]);
    if (answers->faults->leftover_zlp)
        add_bytes(queued, NULL, 0, FINISHED);
    add_bytes(queued, queued->response, size, FINISHED);
}

/* An answer of up to so many parts, the last to be given. */
static struct queued *add_answer(struct ptp_answers *answers, size_t parts)
{
    struct queued **last = &answers->first;
    struct queued *const queued = calloc(1, sizeof *queued + parts * sizeof queued->part[0]);

    if (!queued)
        abort();
    while (*last)
        last = &(*last)->next;
    *last = queued;
    return queued;
}

void ptp_answers_add_raw(struct ptp_answers *answers, uint8_t *bytes, const size_t *ends,
                         size_t count)
{
    struct queued *const queued = add_answer(answers, count);

    for (size_t i = 0, at = 0; i < count; at = ends[i++])
        add_bytes(queued, bytes + at, ends[i] - at, FINISHED);
    queued->part[0].payload.owned = bytes;
}

void ptp_answers_add(struct ptp_answers *answers, const struct ptp_answer *answer, int64_t now_ms)
{
    const struct ptp_faults *const faults = answers->faults;
    const uint32_t id = answer->transaction + (is_hit(answer, faults->wrong_id_at) ? 0x100u : 0u);
    struct queued *const queued = add_answer(answers, PARTS);

    queued->ready_ms = now_ms + faults->late_ms;
    queued->held = is_hit(answer, faults->late_at);
    if (answer->payload)
        add_data(answers, queued, answer, id);
    add_response(answers, queued, answer, id);
}

void ptp_answers_release(struct ptp_answers *answers)
{
    for (struct queued *at = answers->first; at; at = at->next)
        at->held = false;
}

static void copy(const struct ptp_payload *payload, uint64_t at, uint8_t *to, size_t size)
{
    if (payload->read)
        payload->read(payload->context, payload->offset + at, to, size);
    else if (size > 0)
        memcpy(to, payload->bytes + at, size);
}

/* Past the part of now; the answer itself goes with its last part. */
static void advance(struct ptp_answers *answers)
{
    struct queued *const queued = answers->first;

    queued->at = 0;
    if (++queued->now == queued->parts)
        drop_first(answers);
}

/* The part of now is all given; whether the transfer ends here. full: it has no room left. */
static bool ends(struct ptp_answers *answers, bool full)
{
    const enum end end = answers->first->part[answers->first->now].end;
    const bool short_packet = answers->in_block % PTP_PACKET != 0;

    if (end == RUN_ON) {
        advance(answers);
        return false;
    }
    if (!short_packet && full && !(end == NO_ZLP && answers->in_block > 0))
        return true; /* the zero-length packet is the next transfer */
    const bool run_on = !short_packet && end == NO_ZLP && answers->in_block > 0 && !full;

    answers->in_block = 0;
    advance(answers);
    return !run_on;
}

/* How much one transfer gives, and 0 or babble. */
static long fill(struct ptp_answers *answers, uint8_t *buffer, size_t size, size_t limit)
{
    size_t got = 0;

    while (answers->first) {
        struct queued *const queued = answers->first;
        const struct ptp_payload *const payload = &queued->part[queued->now].payload;
        const uint64_t left = payload->size - queued->at;
        size_t n = limit - got;

        if (left == 0) {
            if (ends(answers, got == limit))
                return (long)got;
            continue;
        }
        if (n == 0) {
            if (limit < size)
                answers->in_block = 0; /* a short packet in the middle of the block */
            return answers->in_block % PTP_PACKET ? USB_MODEL_BABBLE : (long)got;
        }
        if (n > left)
            n = (size_t)left;
        copy(payload, queued->at, buffer + got, n);
        queued->at += n;
        answers->in_block += n;
        got += n;
    }
    return (long)got;
}

static bool stalls(struct ptp_answers *answers)
{
    const struct ptp_faults *const faults = answers->faults;

    answers->transfers++;
    answers->halted = answers->transfers == faults->stall_at ||
                      (faults->stall_every && answers->transfers % faults->stall_every == 0);
    return answers->halted;
}

long ptp_answers_give(struct ptp_answers *answers, uint8_t *buffer, size_t size, int64_t now_ms)
{
    const struct ptp_faults *const faults = answers->faults;
    const size_t most = faults->short_reads;
    long got;

    if (answers->halted)
        return USB_MODEL_STALL;
    if (size == 0 || !answers->first || answers->first->held || answers->first->ready_ms > now_ms)
        return USB_MODEL_NAK;
    if (stalls(answers))
        return USB_MODEL_STALL;
    got = fill(answers, buffer, size, most && most < size ? most : size);
    if (got > 0) {
        answers->given += (uint64_t)got;
        answers->given_since_plugged += (uint64_t)got;
    }
    if (faults->unplug_at_byte && answers->given_since_plugged >= faults->unplug_at_byte)
        return USB_MODEL_GONE;
    return got;
}

int ptp_answers_halted(const struct ptp_answers *answers)
{
    return answers->halted;
}

void ptp_answers_clear_halt(struct ptp_answers *answers)
{
    answers->halted = false;
}

uint64_t ptp_answers_given(const struct ptp_answers *answers)
{
    return answers->given;
}
