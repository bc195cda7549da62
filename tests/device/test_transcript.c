/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Records written by hand, and what the device that is played from them puts on the bus. */
#include "tests/device/transcript.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/device/wire.h"

enum { ROOM = 16384 };

#define HEAD "gieson-ptp 1 04a9 31c0 512 SN 7\n"
/* GetObject of object 5, transaction 9; its data "ABCDEFGHIJ"; OK. */
#define OBJECT                                                                                     \
    "> 16\n1000000001000910\n0900000005000000\n"                                                   \
    "< 22\n16000000020009100900000041424344\n45464748494a\n"                                       \
    "< 12\n0c0000000300012009000000\n"
/* GetStorageIDs, twice, with other answers; an event comes after the second. */
#define STORAGES                                                                                   \
    "> 12\n0c0000000100041002000000\n< 12\n0c0000000300192002000000\n"                             \
    "> 12\n0c0000000100041003000000\nstalled in\ncleared in\n< 12\n0c0000000300012003000000\n"     \
    "e 16\n10000000040002400300000005000000\n"

static uint8_t buffer[ROOM];

static struct transcript *read_text(const char *text)
{
    return transcript_new(text, strlen(text));
}

static void ask(struct transcript *transcript, uint16_t operation, size_t count, uint32_t a,
                uint32_t b, uint32_t c)
{
    const struct usb_model *const usb = transcript_usb(transcript);
    const uint32_t size = (uint32_t)(12 + 4 * count);
    uint8_t command[24] = { WIRE32(size), 1,         0,         WIRE16(operation),
                            WIRE32(77u),  WIRE32(a), WIRE32(b), WIRE32(c) };

    CHECK(usb->out(usb->self, 0x02, command, size) == (long)size);
}

static long in(struct transcript *transcript, uint8_t endpoint, size_t size)
{
    const struct usb_model *const usb = transcript_usb(transcript);

    return usb->in(usb->self, endpoint, buffer, size);
}

static void responds(struct transcript *transcript, uint16_t code)
{
    CHECK(in(transcript, 0x81, 512) >= 12 && wire_get16(buffer + 4) == 3);
    CHECK(wire_get16(buffer + 6) == code && wire_get32(buffer + 8) == 77);
}

TEST(a_question_is_answered_as_then_under_the_number_of_now)
{
    struct transcript *const transcript = read_text(HEAD OBJECT);
    const struct usb_model *const usb = transcript_usb(transcript);

    CHECK(wire_get16(usb->device + 8) == 0x04a9 && wire_get16(usb->device + 10) == 0x31c0);
    CHECK(strcmp(usb->strings[3], "SN 7") == 0 && transcript_questions(transcript) == 1);
    for (int again = 0; again < 2; again++) {
        ask(transcript, 0x1009, 1, 5, 0, 0);
        CHECK(in(transcript, 0x81, 512) == 22 && wire_get32(buffer + 8) == 77);
        CHECK(memcmp(buffer + 12, "ABCDEFGHIJ", 10) == 0);
        responds(transcript, 0x2001);
        CHECK(in(transcript, 0x81, 512) == USB_MODEL_NAK);
    }
    transcript_free(transcript);
}

TEST(other_pieces_than_then_are_made_of_the_same_bytes)
{
    struct transcript *const transcript = read_text(HEAD OBJECT);

    ask(transcript, 0x101b, 3, 5, 4, 3);
    CHECK(in(transcript, 0x81, 512) == 15 && memcmp(buffer + 12, "EFG", 3) == 0);
    responds(transcript, 0x2001);
    CHECK(wire_get32(buffer + 12) == 3);
    ask(transcript, 0x101b, 3, 5, 8, 100);
    CHECK(in(transcript, 0x81, 512) == 14 && memcmp(buffer + 12, "IJ", 2) == 0);
    responds(transcript, 0x2001);
    CHECK(transcript_unanswered(transcript) == 0);
    ask(transcript, 0x101b, 3, 6, 0, 1); /* nobody has seen object 6 */
    responds(transcript, 0x2005);
    CHECK(transcript_unanswered(transcript) == 1);
    transcript_free(transcript);
}

TEST(answers_come_in_turn_and_events_where_they_came)
{
    struct transcript *const transcript = read_text(HEAD STORAGES);

    ask(transcript, 0x1004, 0, 0, 0, 0);
    responds(transcript, 0x2019);
    CHECK(in(transcript, 0x83, 64) == USB_MODEL_NAK);
    for (int again = 0; again < 2; again++) {
        ask(transcript, 0x1004, 0, 0, 0, 0);
        responds(transcript, 0x2001);
        CHECK(in(transcript, 0x83, 64) == 16 && wire_get32(buffer + 12) == 5);
    }
    transcript_free(transcript);
}

/* A record of 512 bytes that filled their transfer, with more behind, or not. */
static struct transcript *long_answer(const char *mark, const char *rest)
{
    char *const text = malloc(4000);
    struct transcript *transcript;
    int used = snprintf(text, 4000, "%s> 12\n0c0000000100041002000000\n< 512%s\n", HEAD, mark);

    for (int i = 0; i < 512; i++)
        used += snprintf(text + used, 4000 - (size_t)used, "%s", i ? "ab" : "64");
    (void)snprintf(text + used, 4000 - (size_t)used, "\n%s", rest);
    transcript = read_text(text);
    free(text);
    CHECK(transcript);
    return transcript;
}

TEST(a_block_is_broken_where_it_was_and_nowhere_else)
{
    struct transcript *transcript = long_answer(" +", "< 3\n010203\n");

    ask(transcript, 0x1004, 0, 0, 0, 0);
    CHECK(in(transcript, 0x81, ROOM) == 515); /* it went on */
    transcript_free(transcript);
    transcript = long_answer("", "< 3\n010203\n");
    ask(transcript, 0x1004, 0, 0, 0, 0);
    CHECK(in(transcript, 0x81, ROOM) == 512 && in(transcript, 0x81, ROOM) == 3);
    transcript_free(transcript);
    transcript = long_answer(" +", "< 0\n");
    ask(transcript, 0x1004, 0, 0, 0, 0);
    CHECK(in(transcript, 0x81, 512) == 512 && in(transcript, 0x81, 512) == 0);
    transcript_free(transcript);
}

TEST(what_is_no_record_is_not_played)
{
    static const char *const wrong[] = {
        "",
        "gieson-ptp 2 04a9 31c0 512 X\n",
        "> 16\n10000000010002100000000001000000\n",
        "gieson-ptp 1 04a9 31c0 512 X\n> 16\n100000000100\n",
        "gieson-ptp 1 04a9 31c0 512 X\n> 3\n100000\n",
        "gieson-ptp 1 04a9 31c0 512 X\n> 16\n1000000001000210000000000100000g\n",
    };

    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++)
        CHECK(transcript_new(wrong[i], strlen(wrong[i])) == NULL);
}
