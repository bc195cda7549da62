/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/error.h"

#include "tests/check.h"

#include <limits.h>
#include <string.h>
#include <sysexits.h>

/* An error between two walls: what is written beyond its room shows. */
struct walled {
    unsigned char before[64];
    struct gsn_error err;
    unsigned char behind[64];
};

static struct walled build(void)
{
    struct walled w;

    memset(&w, 0xA5, sizeof w);
    return w;
}

static int walls_stand(const struct walled *w)
{
    for (size_t i = 0; i < sizeof w->before; i++)
        if (w->before[i] != 0xA5 || w->behind[i] != 0xA5)
            return 0;
    return 1;
}

/* size - 1 letters and the terminating zero. */
static const char *letters(char *room, size_t size)
{
    for (size_t i = 0; i + 1 < size; i++)
        room[i] = (char)('a' + i % 26);
    room[size - 1] = '\0';
    return room;
}

TEST(a_failure_carries_its_code_and_its_sentence)
{
    struct gsn_error err = { 0 };

    CHECK(gsn_fail(&err, GSN_E_MARKERS, "section %d: %d marks", 7, 2) == GSN_E_MARKERS);
    CHECK(err.code == GSN_E_MARKERS);
    assert_string_equal(err.text, "section 7: 2 marks");
}

TEST(a_later_failure_replaces_the_sentence)
{
    struct gsn_error err = { 0 };

    (void)gsn_fail(&err, GSN_E_IO, "a rather long first sentence");
    CHECK(gsn_fail(&err, GSN_E_INPUT, "short") == GSN_E_INPUT);
    CHECK(err.code == GSN_E_INPUT);
    assert_string_equal(err.text, "short");
}

TEST(nobody_has_to_want_the_sentence)
{
    CHECK(gsn_fail(NULL, GSN_E_NOMEM, "never %s", "written") == GSN_E_NOMEM);
}

TEST(a_sentence_that_just_fits_is_whole_and_one_letter_more_is_cut)
{
    const size_t room = sizeof((struct gsn_error *)0)->text;
    char text[2 * sizeof((struct gsn_error *)0)->text];

    for (size_t size = room - 1; size <= 2 * room; size++) {
        struct walled w = build();
        const size_t kept = size < room ? size - 1 : room - 1;

        CHECK(gsn_fail(&w.err, GSN_E_INPUT, "%s", letters(text, size)) == GSN_E_INPUT);
        CHECK(walls_stand(&w));
        CHECK(strlen(w.err.text) == kept);
        CHECK(strncmp(w.err.text, text, kept) == 0);
    }
}

TEST(each_caller_adds_its_place_once_and_the_code_stays)
{
    struct gsn_error err = { 0 };

    (void)gsn_fail(&err, GSN_E_MESH, "TetGen gave up");
    CHECK(gsn_fail_at(&err, "region %d", 3) == GSN_E_MESH);
    assert_string_equal(err.text, "region 3: TetGen gave up");
    CHECK(gsn_fail_at(&err, "%s", "GVP-D-S02") == GSN_E_MESH);
    assert_string_equal(err.text, "GVP-D-S02: region 3: TetGen gave up");
    CHECK(err.code == GSN_E_MESH);
}

TEST(a_place_before_a_full_sentence_keeps_its_own_words_and_cuts_the_rest)
{
    const size_t room = sizeof((struct gsn_error *)0)->text;
    char text[sizeof((struct gsn_error *)0)->text];
    struct walled w = build();

    (void)gsn_fail(&w.err, GSN_E_INPUT, "%s", letters(text, room));
    CHECK(gsn_fail_at(&w.err, "P03.tif") == GSN_E_INPUT);
    CHECK(walls_stand(&w));
    CHECK(strlen(w.err.text) == room - 1);
    CHECK(strncmp(w.err.text, "P03.tif: ", 9) == 0);
    CHECK(strncmp(w.err.text + 9, text, room - 1 - 9) == 0);
}

TEST(a_place_longer_than_the_room_is_cut_too)
{
    const size_t room = sizeof((struct gsn_error *)0)->text;
    char place[sizeof((struct gsn_error *)0)->text + 100];

    /* The colon and the old sentence fall off the end one after the other. */
    for (size_t size = room - 6; size <= sizeof place; size++) {
        struct walled w = build();

        (void)gsn_fail(&w.err, GSN_E_STORE, "no");
        CHECK(gsn_fail_at(&w.err, "%s", letters(place, size)) == GSN_E_STORE);
        CHECK(walls_stand(&w));
        CHECK(strlen(w.err.text) == (size + 3 < room ? size + 3 : room - 1));
    }
}

TEST(every_code_has_a_word_of_its_own)
{
    for (int code = GSN_OK; code >= GSN_E_DENIED; code--) {
        CHECK(strcmp(gsn_code_name(code), "unknown") != 0);
        for (int other = GSN_OK; other > code; other--)
            CHECK(strcmp(gsn_code_name(code), gsn_code_name(other)) != 0);
    }
    assert_string_equal(gsn_code_name(GSN_OK), "ok");
    assert_string_equal(gsn_code_name(GSN_E_NOMEM), "nomem");
    assert_string_equal(gsn_code_name(GSN_E_NOTFOUND), "notfound");
    assert_string_equal(gsn_code_name(GSN_E_PROCESS), "process");
    assert_string_equal(gsn_code_name(GSN_E_WITHHELD), "withheld");
}

TEST(what_is_no_code_has_no_name)
{
    assert_string_equal(gsn_code_name(1), "unknown");
    assert_string_equal(gsn_code_name(INT_MAX), "unknown");
    assert_string_equal(gsn_code_name(GSN_E_DENIED - 1), "unknown");
    assert_string_equal(gsn_code_name(INT_MIN), "unknown");
}

TEST(programs_end_with_the_status_of_sysexits)
{
    CHECK(gsn_code_exit(GSN_OK) == 0);
    CHECK(gsn_code_exit(GSN_E_INPUT) == EX_DATAERR && EX_DATAERR == 65);
    CHECK(gsn_code_exit(GSN_E_UNSUPPORTED) == EX_DATAERR);
    CHECK(gsn_code_exit(GSN_E_LIMIT) == EX_DATAERR);
    CHECK(gsn_code_exit(GSN_E_MARKERS) == EX_DATAERR);
    CHECK(gsn_code_exit(GSN_E_STAIN) == EX_DATAERR);
    CHECK(gsn_code_exit(GSN_E_WITHHELD) == EX_DATAERR);
    CHECK(gsn_code_exit(GSN_E_DENIED) == EX_IOERR && EX_IOERR == 74);
    CHECK(gsn_code_exit(GSN_E_NOTFOUND) == EX_NOINPUT && EX_NOINPUT == 66);
    CHECK(gsn_code_exit(GSN_E_PROCESS) == EX_UNAVAILABLE && EX_UNAVAILABLE == 69);
    CHECK(gsn_code_exit(GSN_E_MESH) == EX_UNAVAILABLE);
    CHECK(gsn_code_exit(GSN_E_FIT) == EX_UNAVAILABLE);
    CHECK(gsn_code_exit(GSN_E_NOMEM) == EX_OSERR && EX_OSERR == 71);
    CHECK(gsn_code_exit(GSN_E_IO) == EX_IOERR && EX_IOERR == 74);
    CHECK(gsn_code_exit(GSN_E_STORE) == EX_IOERR);
    CHECK(gsn_code_exit(GSN_E_BUSY) == EX_TEMPFAIL && EX_TEMPFAIL == 75);
}

TEST(no_failure_ends_a_program_as_if_all_were_well)
{
    for (int code = -1; code >= 2 * GSN_E_DENIED; code--)
        CHECK(gsn_code_exit(code) != 0);
}
