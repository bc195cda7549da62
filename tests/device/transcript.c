/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/transcript.h"

#include <ctype.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/device/blob.h"
#include "tests/device/ptp_answers.h"
#include "tests/device/wire.h"

enum { HEADER = 12, COMMAND = 1, DATA = 2, RESPONSE = 3, MOST_PARAMETERS = 5 };

enum {
    OPEN_SESSION = 0x1002,
    GET_OBJECT_INFO = 0x1008,
    GET_OBJECT = 0x1009,
    GET_PARTIAL_OBJECT = 0x101b,
    GET_PARTIAL_OBJECT_64 = 0x95c1,
    OK = 0x2001,
    NOT_SUPPORTED = 0x2005,
};

struct question {
    uint16_t operation;
    uint32_t id;
    size_t count;
    uint32_t parameter[MOST_PARAMETERS];
};

/* A question of the record and what came before the next one. */
struct exchange {
    struct question question;
    struct blob answer;
    size_t *end; /* offsets at which a packet was short */
    size_t ends;
    struct blob event; /* containers, one after the other */
    bool used;
};

struct transcript {
    struct usb_model usb;
    uint8_t device[18];
    char serial[128];
    unsigned packet;
    struct exchange *exchange;
    size_t count;
    struct ptp_faults faults;
    struct ptp_answers *answers;
    struct blob event; /* due */
    unsigned unanswered;
};

/* Reading */

static bool read_question(const uint8_t *bytes, size_t size, struct question *ret_question)
{
    struct question question = { 0 };

    if (size < HEADER || size > HEADER + 4 * MOST_PARAMETERS || size % 4 != 0 ||
        wire_get32(bytes) != size || wire_get16(bytes + 4) != COMMAND)
        return false;
    question.operation = wire_get16(bytes + 6);
    question.id = wire_get32(bytes + 8);
    question.count = (size - HEADER) / 4;
    for (size_t i = 0; i < question.count; i++)
        question.parameter[i] = wire_get32(bytes + HEADER + 4 * i);
    *ret_question = question;
    return true;
}

static int digit_value(char digit)
{
    return digit <= '9' ? digit - '0' : tolower((unsigned char)digit) - 'a' + 10;
}

/* size bytes in hexadecimal, in any number of lines; NULL when they are not there. */
static const char *read_bytes(const char *at, const char *end, size_t size, struct blob *to)
{
    while (size > 0) {
        while (at < end && isspace((unsigned char)*at))
            at++;
        if (end - at < 2 || !isxdigit((unsigned char)at[0]) || !isxdigit((unsigned char)at[1]))
            return NULL;
        blob_u8(to, (uint32_t)(digit_value(at[0]) * 16 + digit_value(at[1])));
        at += 2;
        size--;
    }
    return at;
}

static void *grow(void *old, size_t count, size_t size)
{
    void *const larger = reallocarray(old, count, size);

    if (!larger)
        abort();
    return larger;
}

static bool begin_exchange(struct transcript *transcript, const struct blob *sent)
{
    struct question question;

    if (!read_question(sent->bytes, sent->size, &question))
        return false;
    transcript->exchange =
        grow(transcript->exchange, transcript->count + 1, sizeof *transcript->exchange);
    transcript->exchange[transcript->count++] = (struct exchange){ .question = question };
    return true;
}

/* filled: as much came as was asked for, so that only an odd size tells a short packet. */
static void add_received(struct transcript *transcript, const struct blob *received, bool filled)
{
    struct exchange *const last = &transcript->exchange[transcript->count - 1];

    if (received->size > 0)
        memcpy(blob_extend(&last->answer, received->size), received->bytes, received->size);
    if (filled && received->size % transcript->packet == 0)
        return;
    last->end = grow(last->end, last->ends + 1, sizeof *last->end);
    last->end[last->ends++] = last->answer.size;
}

static void add_event(struct transcript *transcript, const struct blob *event)
{
    struct exchange *const last = &transcript->exchange[transcript->count - 1];

    memcpy(blob_extend(&last->event, event->size), event->bytes, event->size);
}

static bool add_transfer(struct transcript *transcript, char kind, const struct blob *bytes,
                         bool filled)
{
    if (kind == '>')
        return bytes->size == 0 || begin_exchange(transcript, bytes);
    if (transcript->count == 0)
        return true; /* left over from before the record began */
    if (kind == '<')
        add_received(transcript, bytes, filled);
    else if (bytes->size >= HEADER && wire_get32(bytes->bytes) == bytes->size)
        add_event(transcript, bytes);
    return true;
}

static bool read_head(struct transcript *transcript, const char *line)
{
    unsigned vendor, product;
    char serial[sizeof transcript->serial] = "";

    if (sscanf(line, "gieson-ptp 1 %4x %4x %u %127[^\n]", &vendor, &product, &transcript->packet,
               serial) < 3 ||
        transcript->packet == 0)
        return false;
    wire_put16(transcript->device + 8, vendor);
    wire_put16(transcript->device + 10, product);
    memcpy(transcript->serial, serial, sizeof serial);
    return true;
}

/* One line and the bytes that belong to it; NULL when it is nonsense. */
static const char *read_line(struct transcript *transcript, const char *at, const char *end)
{
    const char *const newline = memchr(at, '\n', (size_t)(end - at));
    struct blob bytes = { 0 };
    bool good;
    char *after;

    if (!newline)
        return NULL;
    if (strncmp(at, "gieson-ptp ", 11) == 0)
        return read_head(transcript, at) ? newline + 1 : NULL;
    if (!strchr("><e", *at) || at[1] != ' ')
        return newline + 1;
    const char kind = *at;
    const size_t size = strtoul(at + 2, &after, 10);
    const bool filled = strncmp(after, " +", 2) == 0;

    at = read_bytes(newline, end, size, &bytes);
    good = at && transcript->packet > 0 && add_transfer(transcript, kind, &bytes, filled);
    free(bytes.bytes);
    return good ? at : NULL;
}

/* Playing */

static bool is_same(const struct question *a, const struct question *b)
{
    if (a->operation != b->operation)
        return false;
    for (size_t i = 0; i < MOST_PARAMETERS; i++)
        if (a->parameter[i] != b->parameter[i] && a->operation != OPEN_SESSION)
            return false;
    return true;
}

static struct exchange *find(struct transcript *transcript, const struct question *question)
{
    struct exchange *found = NULL;

    for (size_t i = 0; i < transcript->count; i++) {
        struct exchange *const at = &transcript->exchange[i];

        if (!is_same(&at->question, question))
            continue;
        found = at;
        if (!at->used)
            break;
    }
    return found;
}

/* Containers begin where the answer does, behind the data, and behind short packets. */
static void renumber(const struct exchange *exchange, uint8_t *bytes, size_t at, uint32_t id)
{
    if (exchange->answer.size < at + HEADER || wire_get32(bytes + at + 8) != exchange->question.id)
        return;
    if (wire_get16(bytes + at + 4) == DATA || wire_get16(bytes + at + 4) == RESPONSE)
        wire_put32(bytes + at + 8, id);
}

static void play(struct transcript *transcript, struct exchange *exchange, uint32_t id)
{
    const struct blob *const answer = &exchange->answer;
    uint8_t *const bytes = grow(NULL, answer->size + 1, 1);

    exchange->used = true;
    if (exchange->event.size > 0)
        memcpy(blob_extend(&transcript->event, exchange->event.size), exchange->event.bytes,
               exchange->event.size);
    if (exchange->ends == 0) { /* it was never answered */
        free(bytes);
        return;
    }
    memcpy(bytes, answer->bytes, answer->size);
    if (answer->size >= HEADER && wire_get16(bytes + 4) == DATA)
        renumber(exchange, bytes, wire_get32(bytes), id);
    for (size_t i = 0; i < exchange->ends; i++)
        renumber(exchange, bytes, exchange->end[i], id);
    renumber(exchange, bytes, 0, id);
    ptp_answers_add_raw(transcript->answers, bytes, exchange->end, exchange->ends);
}

/* The data of a recorded answer, without their header; 0 when they are not whole. */
static size_t data_of(const struct exchange *exchange, const uint8_t **ret_bytes)
{
    const struct blob *const answer = &exchange->answer;
    const uint32_t length = answer->size >= HEADER ? wire_get32(answer->bytes) : 0;

    if (length < HEADER || wire_get16(answer->bytes + 4) != DATA ||
        answer->size < (size_t)length + HEADER || wire_get16(answer->bytes + length + 6) != OK)
        return 0;
    *ret_bytes = answer->bytes + HEADER;
    return length - HEADER;
}

/* Which bytes of an object a question is for; size 0: all. */
static bool asks_for_bytes(const struct question *question, uint64_t *ret_offset,
                           uint32_t *ret_size)
{
    const uint32_t *const p = question->parameter;
    const bool wide = question->operation == GET_PARTIAL_OBJECT_64;

    if (question->operation != GET_OBJECT && question->operation != GET_PARTIAL_OBJECT && !wide)
        return false;
    *ret_offset = question->operation == GET_OBJECT ? 0 : wide ? p[1] | (uint64_t)p[2] << 32 : p[1];
    *ret_size = question->operation == GET_OBJECT ? 0 : wide ? p[3] : p[2];
    return true;
}

static uint64_t object_size(const struct transcript *transcript, uint32_t handle)
{
    uint64_t size = 0;

    for (size_t i = 0; i < transcript->count; i++) {
        const struct exchange *const at = &transcript->exchange[i];
        const uint8_t *data;

        if (at->question.parameter[0] != handle)
            continue;
        if (at->question.operation == GET_OBJECT && data_of(at, &data) > 0)
            return data_of(at, &data);
        if (at->question.operation == GET_OBJECT_INFO && data_of(at, &data) >= 12)
            size = wire_get32(data + 8);
    }
    return size;
}

/* Copies what the record has from offset on; returns how much that is. */
static size_t copy_known(const struct transcript *transcript, uint32_t handle, uint64_t offset,
                         uint8_t *to, size_t size)
{
    size_t most = 0;

    for (size_t i = 0; i < transcript->count; i++) {
        const struct exchange *const at = &transcript->exchange[i];
        const uint8_t *data = NULL;
        const size_t has = data_of(at, &data);
        uint64_t from;
        uint32_t asked;

        if (has == 0 || at->question.parameter[0] != handle ||
            !asks_for_bytes(&at->question, &from, &asked) || from > offset || from + has <= offset)
            continue;
        const size_t skip = (size_t)(offset - from), n = has - skip < size ? has - skip : size;

        if (n > most)
            memcpy(to, data + skip, n);
        most = n > most ? n : most;
    }
    return most;
}

/* Bytes of an object, put together from whatever parts of it the record has. */
static bool synthesise(struct transcript *transcript, const struct question *question)
{
    struct ptp_answer answer = { .operation = question->operation,
                                 .transaction = question->id,
                                 .code = OK };
    struct ptp_payload payload = { 0 };
    const uint64_t size = object_size(transcript, question->parameter[0]);
    uint64_t offset;
    uint32_t most;
    uint8_t *bytes;

    if (!asks_for_bytes(question, &offset, &most) || size == 0 || offset > size)
        return false;
    payload.size = most > 0 && most < size - offset ? most : size - offset;
    bytes = grow(NULL, (size_t)payload.size + 1, 1);
    for (size_t done = 0, n = 1; done < payload.size; done += n) {
        n = copy_known(transcript, question->parameter[0], offset + done, bytes + done,
                       (size_t)payload.size - done);
        if (n == 0) {
            free(bytes);
            return false;
        }
    }
    payload.bytes = payload.owned = bytes;
    answer.payload = &payload;
    answer.count = question->operation != GET_OBJECT;
    answer.parameter[0] = (uint32_t)payload.size;
    ptp_answers_add(transcript->answers, &answer, 0);
    return true;
}

static long transcript_out(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    struct transcript *const transcript = self;
    struct question question;
    struct exchange *exchange;

    if (endpoint != 0x02 || !read_question(bytes, size, &question))
        return USB_MODEL_STALL;
    exchange = find(transcript, &question);
    if (exchange) {
        play(transcript, exchange, question.id);
    } else if (!synthesise(transcript, &question)) {
        transcript->unanswered++;
        ptp_answers_add(transcript->answers,
                        &(struct ptp_answer){ .operation = question.operation,
                                              .transaction = question.id,
                                              .code = NOT_SUPPORTED },
                        0);
    }
    return (long)size;
}

static long give_event(struct transcript *transcript, uint8_t *buffer, size_t size)
{
    struct blob *const due = &transcript->event;
    size_t n;

    if (due->size < HEADER)
        return USB_MODEL_NAK;
    n = wire_get32(due->bytes);
    if (n > size)
        return USB_MODEL_BABBLE;
    memcpy(buffer, due->bytes, n);
    due->size -= n;
    memmove(due->bytes, due->bytes + n, due->size);
    return (long)n;
}

static long transcript_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    struct transcript *const transcript = self;

    return endpoint == 0x83 ? give_event(transcript, buffer, size)
                            : ptp_answers_give(transcript->answers, buffer, size, 0);
}

static long transcript_control(void *self, const uint8_t setup[8], const uint8_t *out,
                               size_t out_size, uint8_t *in, size_t in_size)
{
    static const uint8_t fine[4] = { 4, 0, WIRE16(OK) };
    struct transcript *const transcript = self;

    (void)out;
    (void)out_size;
    if (setup[0] == 0xa1 && setup[1] == 0x67 && in_size >= sizeof fine) {
        memcpy(in, fine, sizeof fine);
        return sizeof fine;
    }
    if (setup[0] == 0x21 && (setup[1] == 0x64 || setup[1] == 0x66)) {
        ptp_answers_clear(transcript->answers);
        return 0;
    }
    return setup[0] == 0x02 || setup[0] == 0x01 ? 0 : USB_MODEL_STALL;
}

struct transcript *transcript_new(const char *text, size_t size)
{
    static const uint8_t device[18] = { 18, 1, WIRE16(0x0200), 0, 0, 0, 64, 0, 0,
                                        0,  0, WIRE16(0x0100), 1, 2, 3, 1 };
    struct transcript *const transcript = grow(NULL, 1, sizeof *transcript);
    const char *at = text, *const end = text + size;

    *transcript = (struct transcript){ .packet = 0 };
    memcpy(transcript->device, device, sizeof device);
    while (at && at < end)
        at = read_line(transcript, at, end);
    transcript->answers = ptp_answers_new(&transcript->faults);
    if (at && transcript->packet == PTP_PACKET && transcript->answers)
        return transcript;
    transcript_free(transcript);
    return NULL;
}

void transcript_free(struct transcript *transcript)
{
    if (!transcript)
        return;
    for (size_t i = 0; i < transcript->count; i++) {
        free(transcript->exchange[i].answer.bytes);
        free(transcript->exchange[i].event.bytes);
        free(transcript->exchange[i].end);
    }
    ptp_answers_free(transcript->answers);
    free(transcript->exchange);
    free(transcript->event.bytes);
    free(transcript);
}

const struct usb_model *transcript_usb(struct transcript *transcript)
{
    transcript->usb =
        (struct usb_model){ .device = transcript->device,
                            .config = ptp_config_descriptor,
                            .config_size = PTP_CONFIG,
                            .strings = { NULL, "gieson", "Recorded Device", transcript->serial },
                            .self = transcript,
                            .control = transcript_control,
                            .out = transcript_out,
                            .in = transcript_in };
    return &transcript->usb;
}

size_t transcript_questions(const struct transcript *transcript)
{
    return transcript->count;
}

unsigned transcript_unanswered(const struct transcript *transcript)
{
    return transcript->unanswered;
}
