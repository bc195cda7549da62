/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <stdio.h>
#include <string.h>

#include "pipeline/core/hash.h"
#include "pipeline/core/mem.h"
#include "pipeline/report/text.h"
#include "tests/report/sample.h"

enum { MOST_DEPTH = 64, MOST_NAME = 24 };

static const char hostile[] = "\"><script>alert('1')</script>&\x01\x80\xE2\x80\xAE\xC3\xA9";

static char *page_of(const struct gsn_report *report)
{
    struct gsn_error err = { 0 };
    char *page = NULL;
    size_t size = 0;

    CHECK_OK(gsn_report_html(report, &page, &size, &err), err);
    CHECK(page[size] == '\0' && strlen(page) == size);
    return page;
}

static int is_one_of(const char *name, const char *const *names)
{
    for (; *names; names++)
        if (strcmp(name, *names) == 0)
            return 1;
    return 0;
}

/* Walks over the attributes of a tag: each is a bare name or name="value". Returns behind '>'. */
static const char *skip_attributes(const char *at, int *ret_closed)
{
    *ret_closed = 0;
    for (;;) {
        while (*at == ' ' || *at == '\n')
            at++;
        if (*at == '>')
            return at + 1;
        if (at[0] == '/' && at[1] == '>') {
            *ret_closed = 1;
            return at + 2;
        }
        const size_t length =
            strspn(at, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-");

        if (length == 0)
            fail_msg("no attribute: %.40s", at);
        at += length;
        if (*at != '=')
            continue;
        CHECK(at[1] == '"');
        at = strchr(at + 2, '"');
        assert_non_null(at);
        at++;
    }
}

/* Every element is closed in the right order, and text holds no stray < or bare &. */
static void check_well_formed(const char *page)
{
    static const char *const empty[] = { "meta", "img", "br", "input", NULL };
    char open[MOST_DEPTH][MOST_NAME];
    size_t depth = 0;

    CHECK(strncmp(page, "<!DOCTYPE html>", 15) == 0);
    for (const char *at = page + 15; *at;) {
        if (*at == '&') {
            const size_t length = strcspn(at, ";");

            CHECK(length <= 6);
            at += length;
            continue;
        }
        CHECK(*at != '>' || (depth && strcmp(open[depth - 1], "style") == 0));
        if (*at != '<') {
            at++;
            continue;
        }
        const int closing = at[1] == '/';
        const char *name = at + 1 + closing;
        const size_t length = strspn(name, "abcdefghijklmnopqrstuvwxyz0123456789");
        char found[MOST_NAME];
        int closed;

        CHECK(length > 0 && length < MOST_NAME);
        memcpy(found, name, length);
        found[length] = '\0';
        at = skip_attributes(name + length, &closed);
        if (closing) {
            CHECK(depth > 0);
            assert_string_equal(open[--depth], found);
        } else if (strcmp(found, "script") == 0) {
            at = strstr(at, "</script>");
            assert_non_null(at);
            at += 9;
        } else if (!closed && !is_one_of(found, empty)) {
            CHECK(depth < MOST_DEPTH);
            memcpy(open[depth++], found, sizeof found);
        }
    }
    CHECK(depth == 0);
}

static size_t count_of(const char *page, const char *what)
{
    size_t count = 0;

    for (const char *at = strstr(page, what); at; at = strstr(at + 1, what))
        count++;
    return count;
}

/* Case 68. */
TEST(every_kind_of_page_is_well_formed_and_fetches_nothing)
{
    for (int kind = 0; kind < 3; kind++) {
        struct sample *sample = sample_new((enum gsn_report_kind)kind, 24);
        gsn_auto_mem(char) page = page_of(sample_report(sample));

        check_well_formed(page);
        assert_null(strstr(page, "http:"));
        assert_null(strstr(page, "https:"));
        CHECK(count_of(page, "<script") == (kind == GSN_REPORT_SPECIMEN)); /* alignment.js */
        assert_null(strstr(page, "<link"));
        assert_null(strstr(page, "url("));
        assert_null(strstr(page, "@import"));
        assert_null(strstr(page, " style=")); /* the policy would drop it */
        assert_null(strstr(page, ">nan<"));
        for (const char *at = strstr(page, "src="); at; at = strstr(at + 1, "src="))
            CHECK(strncmp(at, "src=\"data:image/png;base64,", 27) == 0 ||
                  strncmp(at, "src=\"data:image/jpeg;base64,", 28) == 0);
        sample_free(sample);
    }
}

/* CSP Level 3, section 2.3.1: base64 of the SHA-256 of the text between the tags. */
static const char *add_hash_between(const char *page, const char *open, const char *close,
                                    struct gsn_report_text *wanted)
{
    const char *const from = strstr(page, open) + strlen(open);
    const char *const to = strstr(from, close);
    struct gsn_error err = { 0 };
    struct gsn_digest digest;
    uint8_t raw[32];

    CHECK_OK(gsn_sha256(from, (size_t)(to - from), &digest, &err), err);
    for (size_t i = 0; i < 32; i++) {
        unsigned byte = 0;

        CHECK(sscanf(digest.hex + 2 * i, "%2x", &byte) == 1);
        raw[i] = (uint8_t)byte;
    }
    gsn_report_text_raw(wanted, " 'sha256-");
    gsn_report_text_base64(wanted, raw, sizeof raw);
    gsn_report_text_raw(wanted, "'");
    return to;
}

TEST(the_policy_allows_just_this_style_sheet_and_the_viewers_of_what_there_is)
{
    static const uint8_t model_bytes[] = "any bytes";
    const struct gsn_report_model model = { .bytes = model_bytes,
                                            .size = sizeof model_bytes,
                                            .cells = 5,
                                            .of = 9,
                                            .apart_um = 30,
                                            .unit = hostile };
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    const struct gsn_report_aligned *aligned = sample_report(sample)->aligned;

    for (int which = 0; which < 4; which++) {
        const int turned = which & 1, scrolled = which >> 1;
        gsn_auto_report_text wanted = { .bytes = NULL };
        gsn_auto_mem(char) page = NULL;
        const char *at;

        sample_report(sample)->model = turned ? &model : NULL;
        sample_report(sample)->aligned = scrolled ? aligned : NULL;
        page = page_of(sample_report(sample));
        check_well_formed(page);
        gsn_report_text_raw(&wanted, "content=\"default-src 'none'; img-src data:; style-src");
        at = add_hash_between(page, "<style>", "</style>", &wanted);
        if (which)
            gsn_report_text_raw(&wanted, "; script-src");
        for (int i = 0; i < turned + scrolled; i++)
            at = add_hash_between(at, "<script>", "</script>", &wanted);
        gsn_report_text_raw(&wanted, "; base-uri 'none'; form-action 'none'\">");
        assert_non_null(strstr(page, wanted.bytes));
        assert_null(strstr(at, "<script>"));
        CHECK((strstr(page, "5 of the 9 cells") != NULL) == turned);
        CHECK((strstr(page, "<a href=\"#model\">") != NULL) == turned);
        CHECK((strstr(page, ">YW55IGJ5dGVzAA==</script>") != NULL) == turned);
        CHECK((strstr(page, "<a href=\"#alignment\">") != NULL) == scrolled);
        assert_null(strstr(page, "http:"));
        assert_null(strstr(page, "https:"));
        assert_null(strstr(page, "alert('1')"));
    }
    sample_free(sample);
}

TEST(each_section_with_a_pose_lies_in_the_row_with_what_its_marks_leave)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    struct gsn_report *report = sample_report(sample);
    /* The sample's are const to a reader alone. */
    struct gsn_report_section *section = (struct gsn_report_section *)(uintptr_t)report->sections;
    gsn_auto_mem(char) page = NULL;

    section[3].onto_um[0] = (struct gsn_point){ 1234.5, -678 };
    section[3].off_um[0] = (struct gsn_point){ -0.25, 1.125 };
    section[3].onto_um[1].x = (double)NAN; /* laid by tissue: no mark has a place */
    section[3].marker_found[2] = 0;
    section[3].tissue_apart_um = 7.5;
    section[4].tissue_apart_um = (double)NAN;
    page = page_of(report);
    CHECK(count_of(page, "<figure data-serial=") == 58);
    assert_non_null(strstr(page, "<figure data-serial=\"3\" data-z=\"84\" data-state=\"used\" "
                                 "data-marks=\"1234.5 -678.0 -0.250 1.125,,\" "));
    CHECK(count_of(page, " data-tissue=\"") == 57);
    assert_non_null(strstr(page, " data-tissue=\"7.5 31.0\""));
    assert_null(strstr(page, "<figure data-serial=\"29\"")); /* missing, and held: no place */
    assert_null(strstr(page, "<figure data-serial=\"52\""));
    sample_free(sample);
}

static char *glass_of(const struct gsn_report *report)
{
    struct gsn_error err = { 0 };
    char *page = NULL;
    size_t size = 0;

    CHECK_OK(gsn_report_glass_page(report, &page, &size, &err), err);
    CHECK(strlen(page) == size);
    return page;
}

/* CSP Level 3; somebody's names and flags pass the escape. */
TEST(the_page_of_large_sections_holds_all_with_a_pose_and_fetches_nothing)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    struct gsn_report *report = sample_report(sample);
    struct gsn_report_section *section = (struct gsn_report_section *)(uintptr_t)report->sections;
    static const char *const flags[] = { hostile };
    gsn_auto_report_text wanted = { .bytes = NULL };
    gsn_auto_mem(char) page = NULL;
    gsn_auto_mem(char) sheet = NULL;
    const char *at;

    report->specimen = hostile;
    section[7].flags = flags;
    section[7].flag_count = 1;
    page = glass_of(report);
    check_well_formed(page);
    gsn_report_text_raw(&wanted, "content=\"default-src 'none'; img-src data:; style-src");
    at = add_hash_between(page, "<style>", "</style>", &wanted);
    gsn_report_text_raw(&wanted, "; script-src");
    at = add_hash_between(at, "<script>", "</script>", &wanted);
    gsn_report_text_raw(&wanted, "; base-uri 'none'; form-action 'none'\">");
    assert_non_null(strstr(page, wanted.bytes));
    assert_null(strstr(at, "<script>"));
    assert_null(strstr(page, "http:"));
    assert_null(strstr(page, "alert('1')"));
    CHECK(count_of(page, "<figure id=\"section-") == 58);
    CHECK(count_of(page, "class=\"masked\"") == 58 && count_of(page, "class=\"density\"") == 57);
    assert_non_null(strstr(page, "data-reasons=\"halo,fold\""));
    assert_null(strstr(page, "<figure id=\"section-29\"")); /* missing, and held: no place */
    /* The report leads to each of them. */
    sheet = page_of(report);
    CHECK(count_of(sheet, "<a class=\"glass\" href=\"sections.html#section-") == 58);
    report->glass = NULL;
    gsn_free(sheet);
    sheet = page_of(report);
    CHECK(count_of(sheet, "sections.html#section-") == 0);
    sample_free(sample);
}

TEST(the_control_that_is_one_specimen_is_a_link_to_its_page)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);

    sample_report(sample)->baseline_page = "../../GVP%25\"/latest/report.html";
    for (int withheld = 0; withheld < 2; withheld++) {
        gsn_auto_mem(char) page = NULL;

        if (withheld)
            sample_report(sample)->loss_percent = (double)NAN;
        page = page_of(sample_report(sample));
        check_well_formed(page);
        assert_non_null(strstr(page, "against <a href=\"../../GVP%25&quot;/latest/report.html\">"
                                     "GVP-D-S00</a></p>"));
    }
    sample_free(sample);
}

TEST(the_first_thing_said_is_the_loss_and_against_what)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    gsn_auto_mem(char) page = page_of(sample_report(sample));

    assert_non_null(strstr(page, "Collagen loss against GVP-D-S00</p>"));
    assert_non_null(strstr(page, "<p class=\"big\">36.6<small>%</small></p>"));
    assert_non_null(strstr(page, "<p class=\"range\">34.1 to 38.9 % <span class=\"soft\">(95 %, "
                                 "stain, white and sections)</span></p>"));
    assert_non_null(strstr(page, "Relative per cent"));
    assert_non_null(strstr(page, "30.8 points"));
    assert_non_null(strstr(page, "! Reported with warnings"));
    CHECK(strstr(page, "Collagen loss against") < strstr(page, "<h2>"));
    sample_free(sample);
}

TEST(from_what_both_densities_are_counted_stands_between_them_and_their_difference)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);

    sample_report(sample)->zero_density = 0.0274;
    gsn_auto_mem(char) page = page_of(sample_report(sample));
    const char *row = strstr(page, "<td>No collagen, from which both are counted</td><td>0.027<");

    assert_non_null(row);
    CHECK(row > strstr(page, "This specimen</td>") && row < strstr(page, "<td>Difference, on"));
    sample_report(sample)->zero_density = (double)NAN;
    gsn_auto_mem(char) other = page_of(sample_report(sample));

    assert_null(strstr(other, "No collagen, from which"));
    sample_free(sample);
}

TEST(where_it_was_lost_is_said_with_what_sections_alone_make_of_it_or_why_it_is_not_known)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    struct gsn_report *report = sample_report(sample);
    gsn_auto_mem(char) page = page_of(report);

    assert_non_null(strstr(page, "<a href=\"#lost\">Where it was lost</a>"));
    assert_non_null(strstr(page, "lies where more than 35.5 % of it was lost; a twentieth where "
                                 "less than 8.5 % was, a twentieth where more than 69.1 % was."));
    assert_non_null(strstr(page, "uncertain by 3.7 points (standard error)"));
    report->loss_map = NULL;
    report->loss_map_reason = "the two regions <b>do not</b> meet";
    gsn_auto_mem(char) without = page_of(report);

    assert_non_null(strstr(without, "no map of the loss: the two regions &lt;b&gt;do not"));
    report->loss_map_reason = NULL;
    gsn_auto_mem(char) none = page_of(report);

    assert_null(strstr(none, "Where it was lost"));
    sample_free(sample);
}

TEST(a_withheld_loss_shows_its_reason_and_no_number)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);
    struct gsn_report *report = sample_report(sample);

    report->verdict = GSN_REPORT_WITHHELD;
    report->loss_percent = report->loss_points = (double)NAN;
    report->loss_reason = "Only 61 % of the region has data.";

    gsn_auto_mem(char) page = page_of(report);

    assert_non_null(strstr(page, "<p class=\"big word\">withheld</p>\n<p>Only 61 %"));
    assert_null(strstr(page, "<small>%</small></p>\n<p class=\"soft\">Relative"));
    sample_free(sample);
}

TEST(without_a_baseline_the_density_stands_in_front)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 0);

    sample_report(sample)->baseline = NULL;
    sample_report(sample)->loss_percent = (double)NAN;

    gsn_auto_mem(char) page = page_of(sample_report(sample));

    assert_non_null(strstr(page, "No baseline is named"));
    assert_non_null(strstr(page, "<p class=\"big\">0.535</p>"));
    assert_null(strstr(page, "Collagen loss"));
    sample_free(sample);
}

/* The share above a density is in the table of volumes; a second one, of single voxels, would be
 * another number for what reads as the same. */
TEST(what_is_above_a_density_has_one_number)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    struct gsn_report *report = sample_report(sample);
    gsn_auto_mem(char) page = page_of(report);
    gsn_auto_mem(char) without = NULL;

    assert_null(strstr(page, "Area figure"));
    assert_non_null(strstr(page, "by their laser marks and their tissue"));
    report->volume_count = 0;
    without = page_of(report);
    assert_non_null(strstr(without, "Area figure"));
    sample_free(sample);
}

TEST(the_contact_sheet_shows_every_slot_with_its_state_in_words)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    gsn_auto_mem(char) page = page_of(sample_report(sample));
    char cell[60];
    size_t slots = 0;

    for (const char *at = strstr(page, "<td class=\"slot "); at;
         at = strstr(at + 1, "<td class=\"slot "))
        slots++;
    CHECK(slots == 60);
    for (unsigned serial = 0; serial < 60; serial++) {
        (void)snprintf(cell, sizeof cell, "<p class=\"who\"><b>%u.%u</b>", serial / 12 + 1,
                       serial % 12 + 1);
        assert_non_null(strstr(page, cell));
    }
    assert_non_null(strstr(page, "\xE2\x9C\x93 56 used"));
    assert_non_null(strstr(page, "! 2 doubtful"));
    assert_non_null(strstr(page, "turned over"));
    assert_non_null(strstr(page, "turned by 180"));
    assert_non_null(strstr(page, "<b>3.6</b> <span class=\"state\">\xE2\x80\x93 missing"));
    assert_non_null(strstr(page, "<b>5.5</b> <span class=\"state\">\xE2\x9C\x95 held"));
    sample_free(sample);
}

/* Places without a record and records outside the stated layout are both drawn. */
TEST(a_layout_that_does_not_fit_its_sections_grows)
{
    struct gsn_report_section section = {
        .serial = 7, .panel = 3, .row = 1, .column = 2, .state = "odd", .z_um = 180
    };
    struct gsn_report_panel panel = { .number = 3, .file = "p.tif", .rows = 1, .columns = 1 };
    const struct gsn_report report = { .specimen = "x",
                                       .sections = &section,
                                       .section_count = 1,
                                       .panels = &panel,
                                       .panel_count = 1 };
    gsn_auto_mem(char) page = page_of(&report);
    size_t slots = 0;

    for (const char *at = strstr(page, "<td class=\"slot "); at;
         at = strstr(at + 1, "<td class=\"slot "))
        slots++;
    CHECK(slots == 6);
    assert_non_null(strstr(page, "\xE2\x80\xA2 odd"));
    check_well_formed(page);
}

/* Two scans of panel 1, of which the second is used; nothing of panel 2. */
TEST(the_scan_that_is_used_heads_its_panel_and_the_others_follow)
{
    struct gsn_report_section sections[2] = {
        { .serial = 0, .panel = 1, .state = "used", .z_um = 12 },
        { .serial = 1, .panel = 2, .state = "missing", .z_um = 36 },
    };
    struct gsn_report_panel panels[2] = {
        { .number = 1, .file = "a.tif", .state = "held", .message = "kept beside it" },
        { .number = 1, .file = "b.tif", .state = "used", .message = "" },
    };
    const struct gsn_report report = { .specimen = "x",
                                       .sections = sections,
                                       .section_count = 2,
                                       .panels = panels,
                                       .panel_count = 2 };
    gsn_auto_mem(char) page = page_of(&report);
    const char *head = strstr(page, "<h3>Panel 1</h3>"), *second = strstr(page, "<h3>Panel 2</h3>");

    assert_non_null(head);
    assert_non_null(second);
    const char *used = strstr(head, "b.tif"), *other = strstr(head, "a.tif");

    CHECK(used && other && used < other && other < second);
    CHECK(strstr(other, "kept beside it") && strstr(other, "kept beside it") < second);
    assert_non_null(strstr(second, "no scan of it was delivered"));
    check_well_formed(page);
}

TEST(hostile_texts_anywhere_stay_text)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    struct gsn_report *report = sample_report(sample);
    const char *const said[] = { hostile };
    struct gsn_report_section section = report->sections[17];
    struct gsn_report_panel panel = report->panels[0];
    struct gsn_report_picture picture = report->pictures[0];
    const struct gsn_report_exclusion exclusion = { hostile, hostile };
    const struct gsn_report_input input = { hostile, hostile, 7 };
    const struct gsn_report_value values[] = { { hostile, 1, hostile, NULL },
                                               { hostile, 1, hostile, hostile } };

    section.state = hostile;
    section.flags = said;
    section.flag_count = 1;
    panel.file = panel.sha256 = panel.state = panel.message = hostile;
    picture.id = picture.title = picture.caption = hostile;
    report->specimen = report->study = report->group = report->animal = report->week = hostile;
    report->verdict_reason = report->baseline = report->region.description = hostile;
    report->density_name = report->density_version = report->version = report->key = hostile;
    report->area_figure = values[1];
    report->sections = &section;
    report->panels = &panel;
    report->pictures = &picture;
    report->warnings = said;
    report->exclusions = &exclusion;
    report->inputs = &input;
    report->parameters = report->measures = values;
    report->section_count = report->panel_count = report->picture_count = 1;
    report->warning_count = report->exclusion_count = report->input_count = 1;
    report->parameter_count = report->measure_count = 2;
    for (int withheld = 0; withheld < 2; withheld++) {
        gsn_auto_mem(char) page = NULL;

        if (withheld) {
            report->loss_percent = (double)NAN;
            report->loss_reason = hostile;
        }
        page = page_of(report);
        check_well_formed(page);
        CHECK(count_of(page, "<script") == 1); /* alignment.js */
        assert_null(strchr(page, '\x01'));
        assert_null(strstr(page, "\xE2\x80\xAE"));
        assert_non_null(strstr(page, "&quot;&gt;&lt;script&gt;alert(&#39;1&#39;)&lt;/script&gt;"
                                     "&amp;\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD\xC3\xA9"));
    }
    sample_free(sample);
}

TEST(a_very_long_name_and_an_empty_report_are_fine)
{
    const struct gsn_report empty = { .loss_percent = (double)NAN };
    struct gsn_report large = empty;
    gsn_auto_mem(char) name = gsn_alloc_array(100001, 1);
    gsn_auto_mem(char) page = page_of(&empty);
    gsn_auto_mem(char) long_page = NULL;

    check_well_formed(page);
    memset(name, 'M', 100000);
    large.specimen = name;
    long_page = page_of(&large);
    check_well_formed(long_page);
    CHECK(strlen(long_page) < strlen(page) + 100200);
}

TEST(the_tile_page_compares_the_map_with_the_mask)
{
    struct sample *sample = sample_new(GSN_REPORT_TILE, 24);
    gsn_auto_mem(char) page = page_of(sample_report(sample));

    assert_non_null(strstr(page, "Agreement with psr_left_mask.jpg"));
    assert_non_null(strstr(page, "<p class=\"big\">0.875</p>"));
    assert_non_null(strstr(page, "<p class=\"big\">31.1<small>%</small></p>"));
    assert_null(strstr(page, "Contact sheet"));
    sample_free(sample);
}

TEST(the_same_record_gives_the_same_bytes)
{
    struct sample *one = sample_new(GSN_REPORT_SPECIMEN, 24);
    struct sample *two = sample_new(GSN_REPORT_SPECIMEN, 24);
    gsn_auto_mem(char) first = page_of(sample_report(one));
    gsn_auto_mem(char) second = page_of(sample_report(two));

    assert_string_equal(first, second);
    sample_free(one);
    sample_free(two);
}

static int glass_once(const struct gsn_report *report, struct gsn_error *err)
{
    gsn_auto_mem(char) page = NULL;
    size_t size;

    return gsn_report_glass_page(report, &page, &size, err);
}

static int html_once(const struct gsn_report *report, struct gsn_error *err)
{
    gsn_auto_mem(char) page = NULL;
    size_t size = 0;

    return gsn_report_html(report, &page, &size, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(html_once(sample_report(sample), &err), err);
    CHECK_EVERY_OOM(glass_once(sample_report(sample), &err), err);
    sample_free(sample);
}

TEST(a_page_says_what_was_done_in_words_for_a_manuscript)
{
    struct sample *sample = sample_new(GSN_REPORT_SPECIMEN, 24);
    gsn_auto_mem(char) page = page_of(sample_report(sample));
    const char *const methods = strstr(page, "id=\"methods\"");

    CHECK(methods);
    CHECK(strstr(methods, "were stacked by rigid registration"));
    CHECK(strstr(methods, sample_report(sample)->key));
    CHECK(strstr(methods, "computer program"));
    sample_free(sample);
}
