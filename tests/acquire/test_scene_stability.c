/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include <math.h>
#include <stdio.h>
#include <string.h>

#include "acquire/scene_stability.h"
#include "tests/check.h"

enum { CELLS = GSN_THUMBNAIL_COLUMNS * GSN_THUMBNAIL_ROWS, FRAMES = 8 };

/* A slide with structure, shifted by so many cells, with noise of this size in every cell. */
static struct gsn_thumbnail slide(double shift, double noise, unsigned *seed)
{
    struct gsn_thumbnail out;

    for (unsigned i = 0; i < CELLS; i++) {
        const double x = i % GSN_THUMBNAIL_COLUMNS + shift;
        const double y = (double)(i / GSN_THUMBNAIL_COLUMNS);

        *seed = *seed * 1664525U + 1013904223U;
        out.cell[i] = (float)(120 + 60 * sin(x * 0.7) * cos(y * 0.9) +
                              noise * ((*seed >> 8) / 8388608.0 - 1));
    }
    return out;
}

static enum gsn_stability_answer look(struct gsn_stability *rest, double shift, double noise,
                                      unsigned *seed)
{
    const struct gsn_thumbnail now = slide(shift, noise, seed);

    return gsn_stability_update(rest, &now);
}

/* How many pictures are taken in so many frames of this view. */
static unsigned taken(struct gsn_stability *rest, double shift, double noise, unsigned frames,
                      unsigned *seed)
{
    unsigned count = 0;

    for (unsigned i = 0; i < frames; i++)
        count += look(rest, shift, noise, seed) == GSN_STABILITY_TAKE;
    return count;
}

TEST(a_panel_that_lies_still_is_taken_once_and_not_before_its_frames)
{
    for (unsigned seed = 1; seed < 50; seed++) {
        struct gsn_stability rest = gsn_stability_begin(FRAMES, 4);
        unsigned s = seed;

        CHECK(taken(&rest, 0, 1.2, FRAMES - 1, &s) == 0);
        CHECK(taken(&rest, 0, 1.2, 1000, &s) == 1);
    }
}

TEST(each_panel_of_a_series_is_taken_once)
{
    struct gsn_stability rest = gsn_stability_begin(FRAMES, 4);
    unsigned seed = 3, count = 0;

    for (unsigned panel = 0; panel < 40; panel++) {
        for (unsigned i = 0; i < 5; i++) /* a hand moves it in */
            CHECK(look(&rest, panel * 3 + i * 0.9, 1, &seed) == GSN_STABILITY_MOVING);
        count += taken(&rest, panel * 3 + 1.7, 1, 3 * FRAMES, &seed);
    }
    CHECK(count == 40);
}

TEST(a_panel_that_moves_is_not_taken_at_any_speed)
{
    /* Cells of a structure of this size change by up to 42 a cell of shift. */
    static const double speeds[] = { 0.005, 0.02, 0.05, 0.1, 0.5, 2 };

    for (size_t i = 0; i < sizeof speeds / sizeof speeds[0]; i++) {
        struct gsn_stability rest = gsn_stability_begin(FRAMES, 4);
        unsigned seed = 7;

        for (unsigned frame = 0; frame < 300; frame++) {
            if (look(&rest, frame * speeds[i], 0, &seed) != GSN_STABILITY_MOVING)
                fail_msg("taken in frame %u at %g cells a frame", frame, speeds[i]);
        }
    }
}

TEST(noise_above_the_bound_is_never_rest)
{
    struct gsn_stability rest = gsn_stability_begin(FRAMES, 4);
    unsigned seed = 5;

    CHECK(taken(&rest, 0, 20, 500, &seed) == 0);
}

TEST(a_hand_over_the_same_panel_makes_no_second_picture)
{
    struct gsn_stability rest = gsn_stability_begin(FRAMES, 4);
    unsigned seed = 9;

    CHECK(taken(&rest, 0, 0.5, 2 * FRAMES, &seed) == 1);
    for (unsigned i = 0; i < 4; i++)
        CHECK(look(&rest, 5 + i, 0.5, &seed) == GSN_STABILITY_MOVING);
    CHECK(taken(&rest, 0, 0.5, 10 * FRAMES, &seed) == 0);
    CHECK(taken(&rest, 2, 0.5, 10 * FRAMES, &seed) == 1); /* moved a little: another */
}

TEST(known_blank_glass_and_darkness_are_not_taken)
{
    struct gsn_stability rest = gsn_stability_begin(FRAMES, 4);
    const struct gsn_thumbnail darkness = { { 3, 0, 2 } };
    unsigned seed = 11;
    struct gsn_thumbnail blank = slide(10, 0, &seed);

    gsn_stability_know(&rest, GSN_SUBJECT_BLANK, &blank);
    CHECK(taken(&rest, 10, 0.5, 5 * FRAMES, &seed) == 0);
    CHECK(taken(&rest, 12, 0.5, 5 * FRAMES, &seed) == 1);
    CHECK(taken(&rest, 10, 0.5, 5 * FRAMES, &seed) == 0);
    for (unsigned i = 0; i < 5 * FRAMES; i++)
        CHECK(gsn_stability_update(&rest, &darkness) != GSN_STABILITY_TAKE);
    CHECK(taken(&rest, 14, 0.5, 5 * FRAMES, &seed) == 1);
}

TEST(an_empty_stage_nobody_has_shown_is_taken_for_nobody_can_tell)
{
    struct gsn_stability rest = gsn_stability_begin(FRAMES, 4);
    struct gsn_thumbnail white;
    unsigned count = 0;

    for (unsigned i = 0; i < CELLS; i++)
        white.cell[i] = 230;
    for (unsigned i = 0; i < 3 * FRAMES; i++)
        count += gsn_stability_update(&rest, &white) == GSN_STABILITY_TAKE;
    CHECK(count == 1);
}

/* The facts that hold this text as their thumbnail. */
static const char *facts_with(const char *text)
{
    static char facts[2 * GSN_THUMBNAIL_TEXT];

    (void)snprintf(facts, sizeof facts, "{\"device\":\"x\",\"thumbnail\":\"%s\"}", text);
    return facts;
}

TEST(a_thumbnail_reads_back_from_the_facts_as_it_was)
{
    unsigned seed = 21;

    for (unsigned i = 0; i < 20; i++) {
        const struct gsn_thumbnail written = slide(i, 60, &seed);
        struct gsn_thumbnail read;
        char text[GSN_THUMBNAIL_TEXT + 1];

        gsn_thumbnail_write(&written, text);
        CHECK(strlen(text) == GSN_THUMBNAIL_TEXT);
        CHECK(gsn_thumbnail_read(facts_with(text), &read) == 1);
        CHECK(gsn_thumbnail_difference(&written, &read) <= 1.0F / 32);
    }
}

TEST(a_thumbnail_as_text_is_sixteenths_in_two_letters)
{
    struct gsn_thumbnail thumbnail = { { 0, 1, 255, 4, -3, 999 } };
    char text[GSN_THUMBNAIL_TEXT + 1];

    gsn_thumbnail_write(&thumbnail, text);
    CHECK(memcmp(text, "AAAQ/wBAAA/wAA", 14) == 0);
}

TEST(facts_that_hold_no_thumbnail_give_none)
{
    const struct gsn_thumbnail before = { { 17, 4 } };
    struct gsn_thumbnail thumbnail = before;
    char good[GSN_THUMBNAIL_TEXT + 40], bad[sizeof good];

    (void)snprintf(good, sizeof good, "{\"thumbnail\":\"%0*d\"}", GSN_THUMBNAIL_TEXT, 0);
    CHECK(gsn_thumbnail_read(good, &(struct gsn_thumbnail){ { 0 } }) == 1);
    for (size_t cut = 0; good[cut + 1]; cut++) { /* every end but that behind the last quote */
        memcpy(bad, good, sizeof bad);
        bad[cut] = '\0';
        CHECK(gsn_thumbnail_read(bad, &thumbnail) == (good[cut] == '}'));
        memcpy(bad, good, sizeof bad);
        bad[cut] = '\x80';
        CHECK(gsn_thumbnail_read(bad, &thumbnail) == (cut == 0 || good[cut] == '}'));
    }
    thumbnail = before;
    CHECK(gsn_thumbnail_read(NULL, &thumbnail) == 0);
    CHECK(gsn_thumbnail_read("{\"thumbnail\":\"\"}", &thumbnail) == 0);
    memcpy(good + 14, "//", 2); /* 4095 sixteenths are more than 255 */
    CHECK(gsn_thumbnail_read(good, &thumbnail) == 0);
    CHECK(memcmp(&thumbnail, &before, sizeof before) == 0);
}

/* A frame of one brightness has thumbnails of that brightness, in every layout. */
TEST(brightness_is_read_from_every_layout)
{
    static uint8_t bytes[100 * 60 * 3];
    static const struct {
        const char *fourcc;
        uint32_t stride;
        uint8_t pattern[5];
        unsigned period;
        double brightness;
    } cases[] = {
        { "GREY", 100, { 77 }, 1, 77 },
        { "YUYV", 200, { 77, 1 }, 2, 77 },
        { "UYVY", 200, { 1, 77 }, 2, 77 },
        { "NV12", 100, { 77 }, 1, 77 },
        { "RGB3", 300, { 1, 77, 200 }, 3, 77 },
        { "Y10 ", 200, { 0x00, 0x02 }, 2, 512 * 255.0 / 1023 },
        { "RG12", 200, { 0x34, 0x08 }, 2, 0x834 * 255.0 / 4095 },
        { "pRAA", 125, { 77, 77, 77, 77, 0xe4 }, 5, 77 },
        { "pRCC", 150, { 77, 77, 0x21 }, 3, 77 },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        struct gsn_frame frame = { .format = gsn_pixel_format_named(cases[i].fourcc),
                                   .width = 100,
                                   .height = 60,
                                   .stride = cases[i].stride,
                                   .bytes = bytes,
                                   .size = sizeof bytes };
        struct gsn_thumbnail thumbnail;

        for (size_t k = 0; k < sizeof bytes; k++)
            bytes[k] = cases[i].pattern[k % cases[i].stride % cases[i].period];
        CHECK(gsn_thumbnail_make(&frame, &thumbnail) == 1);
        for (unsigned k = 0; k < CELLS; k++)
            CHECK_NEAR(thumbnail.cell[k], cases[i].brightness, 0.01);
        frame.size = (size_t)60 * cases[i].stride - 70;
        CHECK(gsn_thumbnail_make(&frame, &thumbnail) == 0); /* short */
        frame = (struct gsn_frame){
            .format = frame.format, .width = 1, .height = 1, .stride = 6, .bytes = bytes, .size = 6
        };
        CHECK(gsn_thumbnail_make(&frame, &thumbnail) == 1); /* one pixel for every cell */
    }
}
