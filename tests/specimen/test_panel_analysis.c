/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/panel_analysis.h"

#include "pipeline/register/fiducial/fiducial.h"
#include "tests/check.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/specimen/flags.h"
#include "tests/specimen/often.h"

#include <stdio.h>
#include <string.h>

static const char JOB[] = "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2]}";
static const char JOB_WITH_MARKS[] =
    "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"panels\": 2, \"sections\": 7, "
    "\"markers_um\": " DRAWN_MARKS_JSON "}";

static struct gsn_protocol *protocol_of(const char *text)
{
    struct gsn_protocol *protocol = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_protocol_parse(text, strlen(text), &protocol, &err), err);
    return protocol;
}

static struct gsn_panel_findings *examined(const struct drawn_panel *panel, unsigned number,
                                           const char *job)
{
    gsn_auto(gsn_protocol) protocol = protocol_of(job);
    struct gsn_panel_findings *findings = NULL;
    struct gsn_error err = { 0 };
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(panel, &size);

    CHECK_OK(gsn_panel_analyse(NULL, gsn_check_fd(png, size), protocol, number, NULL, 1, NULL,
                               &findings, &err),
             err);
    CHECK(findings->count == DRAWN_SLOTS);
    return findings;
}

/* Largest distance of a found mark from where it was drawn, in pixels; marks in the job's order. */
static double worst_mark(const struct drawn_panel *panel, const struct gsn_panel_findings *findings)
{
    double worst = 0;

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++)
        for (unsigned m = 0; m < GSN_FIDUCIALS; m++) {
            const struct gsn_fiducial *mark = &findings->section[slot].mark[m];
            const struct gsn_point at = drawn_panel_place(panel, slot, drawn_marks_um[m]);

            if (mark->found)
                worst = fmax(worst, hypot(mark->px.x - at.x, mark->px.y - at.y));
        }
    return worst;
}

TEST(every_mark_is_found_within_a_tenth_of_a_pixel)
{
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto(gsn_panel_findings) findings = examined(&panel, 1, JOB_WITH_MARKS);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
        const struct gsn_panel_section *s = &findings->section[slot];

        CHECK(s->sighting == GSN_SIGHT_FOUND && s->flags.count == 0);
        CHECK(s->slot == slot && s->serial == slot);
        CHECK(s->mark[0].found && s->mark[1].found && s->mark[2].found);
        CHECK_NEAR(s->mark[0].radius_px, 75 / 24.0, 0.5);
        CHECK_NEAR(s->area_px, M_PI * DRAWN_WIDTH_UM * DRAWN_HEIGHT_UM / (24 * 24), 150);
    }
    CHECK_NEAR(worst_mark(&panel, findings), 0, 0.1);
    CHECK(findings->width == 216 && findings->height == 216);
    CHECK_NEAR(findings->px_um, 24, 0);
}

/* The boxes hold their tissue and lie in the picture. */
TEST(a_box_holds_the_tissue_of_its_slot)
{
    const struct drawn_panel panel = drawn_panel_of(2, 24, 0.5);
    gsn_auto(gsn_panel_findings) findings = examined(&panel, 1, JOB_WITH_MARKS);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
        const struct gsn_panel_section *s = &findings->section[slot];

        for (int i = 0; i < 36; i++) {
            const double a = i * M_PI / 18;
            const struct gsn_point at =
                drawn_panel_place(&panel, slot,
                                  (struct gsn_point){ 0.97 * DRAWN_WIDTH_UM * cos(a),
                                                      0.97 * DRAWN_HEIGHT_UM * sin(a) });

            CHECK(at.x > s->x && at.x < s->x + s->width);
            CHECK(at.y > s->y && at.y < s->y + s->height);
        }
        CHECK(s->x >= 0 && s->x + s->width <= (int)findings->width);
        CHECK(s->y >= 0 && s->y + s->height <= (int)findings->height);
    }
}

TEST(without_a_stated_triangle_the_sections_agree_on_one)
{
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto(gsn_panel_findings) findings = examined(&panel, 1, JOB);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
        double side[3];

        CHECK(findings->section[slot].sighting == GSN_SIGHT_FOUND);
        for (unsigned m = 0; m < 3; m++) {
            const struct gsn_point a = findings->section[slot].mark[m].px;
            const struct gsn_point b = findings->section[slot].mark[(m + 1) % 3].px;

            side[m] = 24 * hypot(a.x - b.x, a.y - b.y);
        }
        /* Mark 1 lies between the shortest side (to mark 2) and the longest (to mark 3). */
        CHECK_NEAR(side[0], hypot(717.5 - 525, 350 + 455), 4);
        CHECK_NEAR(side[1], hypot(717.5 + 595, 525 - 350), 4);
        CHECK_NEAR(side[2], hypot(595 + 525, 525 + 455), 4);
    }
}

TEST(a_missing_section_keeps_its_slot_and_the_following_ones_their_serials)
{
    struct drawn_panel panel = drawn_panel_of(2, 24, 0.8);

    panel.section[1].missing = 1;
    panel.section[3].missing = 1; /* serial 7 of 7: nothing is expected there */
    gsn_auto(gsn_panel_findings) findings = examined(&panel, 2, JOB_WITH_MARKS);

    CHECK(findings->section[0].serial == 4 && findings->section[0].sighting == GSN_SIGHT_FOUND);
    CHECK(findings->section[1].serial == 5 && findings->section[1].sighting == GSN_SIGHT_MISSING);
    CHECK(findings->section[2].serial == 6 && findings->section[2].sighting == GSN_SIGHT_FOUND);
    CHECK(findings->section[3].serial == 7 && findings->section[3].sighting == GSN_SIGHT_EMPTY);
    CHECK(findings->section[1].width == 0 && findings->section[1].area_px == 0);
    CHECK(!findings->section[1].mark[0].found && findings->section[1].flags.count == 0);
    CHECK_NEAR(worst_mark(&panel, findings), 0, 0.1);
}

TEST(two_marks_are_kept_and_flagged_and_one_mark_needs_an_eye)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    panel.section[2].no_marks = 2; /* mark 2 */
    gsn_auto(gsn_panel_findings) two = examined(&panel, 1, JOB_WITH_MARKS);

    CHECK(two->section[2].sighting == GSN_SIGHT_NEEDS_EYE);
    CHECK(strcmp(text_of(&two->section[2].flags).text, "two-marks") == 0);
    CHECK(two->section[2].mark[0].found && !two->section[2].mark[1].found &&
          two->section[2].mark[2].found);
    CHECK_NEAR(worst_mark(&panel, two), 0, 0.1);

    panel.section[2].no_marks = 6;
    gsn_auto(gsn_panel_findings) one = examined(&panel, 1, JOB_WITH_MARKS);

    CHECK(one->section[2].sighting == GSN_SIGHT_NEEDS_EYE);
    CHECK(strcmp(text_of(&one->section[2].flags).text, "no-marks") == 0);
    CHECK(one->section[0].sighting == GSN_SIGHT_FOUND);
}

/* No triangle can be agreed on: the sections are there, each needs an eye, and nothing fails. */
TEST(a_panel_without_marks_is_examined_all_the_same)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++)
        panel.section[slot].no_marks = 7;
    gsn_auto(gsn_panel_findings) findings = examined(&panel, 1, JOB);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
        CHECK(findings->section[slot].sighting == GSN_SIGHT_NEEDS_EYE);
        CHECK(strcmp(text_of(&findings->section[slot].flags).text, "no-marks") == 0);
        CHECK(findings->section[slot].area_px > 0);
    }
}

/* A section face down is one whose marks still carry their own numbers. */
TEST(a_mirrored_section_has_its_marks_in_the_jobs_order)
{
    struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    panel.section[1].flipped = 1;
    panel.section[3].turn_deg += 180;
    gsn_auto(gsn_panel_findings) findings = examined(&panel, 1, JOB_WITH_MARKS);

    for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++)
        CHECK(findings->section[slot].sighting == GSN_SIGHT_FOUND);
    CHECK_NEAR(worst_mark(&panel, findings), 0, 0.1);
}

TEST(the_order_of_mounting_decides_which_slot_is_which)
{
    static const struct {
        const char *job;
        int row[4], column[4];
    } orders[] = { { "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"order\": "
                     "\"column\"}",
                     { 0, 1, 0, 1 },
                     { 0, 0, 1, 1 } },
                   { "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2], \"order\": "
                     "\"snake\"}",
                     { 0, 0, 1, 1 },
                     { 0, 1, 1, 0 } } };
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);

    for (size_t i = 0; i < sizeof orders / sizeof orders[0]; i++) {
        gsn_auto(gsn_panel_findings) findings = examined(&panel, 3, orders[i].job);

        for (unsigned slot = 0; slot < DRAWN_SLOTS; slot++) {
            const struct gsn_panel_section *s = &findings->section[slot];

            CHECK(s->serial == 8 + slot);
            CHECK((s->y + s->height / 2 > 108) == orders[i].row[slot]);
            CHECK((s->x + s->width / 2 > 108) == orders[i].column[slot]);
        }
    }
}

TEST(a_panel_that_cannot_be_read_leaves_the_findings_untouched)
{
    static const struct {
        const char *job;
        size_t cut; /* bytes kept; 0: all */
        int code;
        const char *says;
    } cases[] = {
        { "{\"specimen\": \"x\", \"layout\": [2, 2]}", 0, GSN_E_INPUT, "pixel size" },
        { "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [2, 2]}", 2000, GSN_E_INPUT, "" },
        { "{\"specimen\": \"x\", \"px_um\": 900, \"layout\": [2, 2]}", 0, GSN_E_INPUT, "" },
        { "{\"specimen\": \"x\", \"px_um\": 24, \"layout\": [20, 20]}", 0, GSN_E_INPUT, "" },
    };
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        gsn_auto(gsn_protocol) protocol = protocol_of(cases[i].job);
        struct gsn_panel_findings *findings = NULL;
        struct gsn_error err = { 0 };
        const int r = gsn_panel_analyse(NULL, gsn_check_fd(png, cases[i].cut ? cases[i].cut : size),
                                        protocol, 1, NULL, 1, NULL, &findings, &err);

        if (r != cases[i].code || !err.text[0] || !strstr(err.text, cases[i].says))
            fail_msg("case %zu: %d (%s)", i, r, err.text);
        CHECK(findings == NULL);
    }
}

static void heard(void *context, const char *stage, size_t done, size_t total)
{
    char *all = context;

    CHECK(done <= total);
    if (!strstr(all, stage))
        (void)snprintf(all + strlen(all), 100 - strlen(all), "%s ", stage);
}

TEST(the_stages_tell_where_they_are)
{
    const struct drawn_panel panel = drawn_panel_of(1, 24, 0.8);
    gsn_auto(gsn_protocol) protocol = protocol_of(JOB);
    gsn_auto(gsn_panel_findings) findings = NULL;
    char stages[100] = "";
    const struct gsn_progress progress = { .report = heard, .context = stages };
    struct gsn_error err = { 0 };
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

    CHECK_OK(gsn_panel_analyse(NULL, gsn_check_fd(png, size), protocol, 1, NULL, 2, &progress,
                               &findings, &err),
             err);
    CHECK(strcmp(stages, "decoding splitting marks ") == 0);
}

struct oom {
    const uint8_t *png;
    size_t size;
    const struct gsn_protocol *protocol;
};

static int examine_once(const struct oom *oom, struct gsn_error *err)
{
    gsn_auto(gsn_panel_findings) findings = NULL;

    return gsn_panel_analyse(NULL, gsn_check_fd(oom->png, oom->size), oom->protocol, 1, NULL, 1,
                             NULL, &findings, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct drawn_panel panel = drawn_panel_of(1, 28, 0.8);
    gsn_auto(gsn_protocol) protocol =
        protocol_of("{\"specimen\": \"x\", \"px_um\": 28, \"layout\": [2, 2]}");
    struct gsn_error err = { 0 };
    size_t size;
    gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);
    const struct oom oom = { png, size, protocol };

    CHECK_MANY_OOM(examine_once(&oom, &err), err, 40, 50);
}
