/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/nearest.h"

#include "pipeline/core/printable.h"
#include "tests/check.h"

#include <stdio.h>
#include <string.h>

static const char *const WORDS[] = { "px_um", "voxel_um", "baseline", "region", "status" };

static const char *near(const char *written)
{
    return gsn_nearest(written, WORDS, sizeof WORDS / sizeof WORDS[0]);
}

TEST(each_slip_of_the_hand_finds_its_word)
{
    CHECK(strcmp(near("basline"), "baseline") == 0);  /* one too few */
    CHECK(strcmp(near("regioon"), "region") == 0);    /* one too many */
    CHECK(strcmp(near("voxel-um"), "voxel_um") == 0); /* another one */
    CHECK(strcmp(near("statsu"), "status") == 0);     /* swapped */
    CHECK(strcmp(near("BaseLine"), "baseline") == 0);
    CHECK(strcmp(near("px_um"), "px_um") == 0);
}

TEST(what_is_far_from_all_is_near_to_none)
{
    static const char longest[] = "a word of more than forty letters is no slip of a hand";

    CHECK(near("magnification") == NULL);
    CHECK(near("xy") == NULL); /* shorter than the slips that it would take */
    CHECK(near("") == NULL);
    CHECK(near(longest) == NULL);
    CHECK(gsn_nearest("status", WORDS, 0) == NULL);
}

TEST(what_moves_a_cursor_or_turns_a_line_is_a_question_mark)
{
    static const struct {
        const char *text, *wanted;
    } cases[] = {
        { "plain\nlines", "plain\nlines" },
        { "a\033[2Jb\r\tc\x7f", "a?[2Jb??c?" },
        { "\xc3\xbc \xc2\xb5m \xe2\x9c\x93", "\xc3\xbc \xc2\xb5m \xe2\x9c\x93" },
        { "\xc2\x9b"
          "31m",
          "?31m" }, /* U+009B is CSI */
        { "a\x9b"
          "b",
          "a?b" },                                  /* and so is the stray byte */
        { "x\xe2\x80\xaey\xe2\x81\xa6z", "x?y?z" }, /* right to left, isolate */
        { "cut \xc3", "cut \xc3" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        char text[40];

        (void)snprintf(text, sizeof text, "%s", cases[i].text);
        gsn_printable(text);
        assert_string_equal(text, cases[i].wanted);
    }
}
