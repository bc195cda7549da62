/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the code on a panel's label does to the panel: drawn panels of the phantom, whose labels say
 * "GVP-D-S02-P03". */
#include "systemd/worker/job.h"

#include "pipeline/decode/png_write.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "tests/check.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/planning.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/systemd/worker/bench_job.h"

#include <string.h>

static const struct gsn_job_options OPTIONS = { .mesher = GSN_MESHER,
                                                .decoder = GSN_DECODER,
                                                .owner = "test" };

static void write_panel(const struct gsn_scratch *scratch, const char *specimen, const char *folder,
                        const char *file)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    gsn_auto(gsn_image) image = NULL;
    gsn_auto_mem(uint8_t) png = NULL;
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_phantom_plan_make(specimen, "L0", 7, 40, &plan, &err), err);
    CHECK_OK(gsn_phantom_panel_draw(&plan, &plan.file[2], 0, &image, extent, &err), err);
    CHECK_OK(gsn_png_encode(image, &png, &size, &err), err);
    bench_write(scratch, folder, file, png, size);
}

static void write_job(const struct gsn_scratch *scratch, const char *folder, const char *specimen)
{
    gsn_auto_mem(char) job = gsn_format("{\"specimen\": \"%s\", \"study\": \"GVP-D\", \"px_um\": "
                                        "40, \"layout\": [3, 4], \"panels\": 5}",
                                        specimen);

    bench_write_job(scratch, folder, job);
}

/* Imports the folder and works the queue until it is empty. gives: the specimen's panels. */
static struct gsn_panel_rows *worked(const struct gsn_scratch *scratch, struct gsn_store *store,
                                     const char *folder, const char *specimen)
{
    gsn_auto(gsn_specimen_row) row = NULL;
    struct gsn_panel_rows *panels = NULL;
    struct gsn_import_counts counts = { 0 };
    struct gsn_error err = { 0 };
    struct heard heard;

    CHECK_OK(bench_import(scratch, store, folder, 0, &heard, &counts, &err), err);
    while (gsn_job_next(store, &OPTIONS, &err) >= 0) {
    }
    CHECK_OK(gsn_specimen_get(store, specimen, &row, &err), err);
    CHECK_OK(gsn_panel_list(store, row->id, &panels, &err), err);
    return panels;
}

static void check_panel(const struct gsn_panel_row *panel, const char *state, const char *message)
{
    if (strcmp(panel->state, state) != 0 || strcmp(panel->message, message) != 0)
        fail_msg("%s is %s: %s", panel->file_name, panel->state, panel->message);
}

/* ---- scans of one glass, and glasses that are mounted alike -------------------------------- */

/* Panel 1 or 2 of a block that a jig mounts: the second's sections lie as the first's, marks and
 * all. What would be read on its label is crossed out. */
static void write_jigged(const struct gsn_scratch *scratch, const char *file, int panel,
                         double light)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    gsn_auto(gsn_image) image = NULL;
    gsn_auto_mem(uint8_t) png = NULL;
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };
    uint8_t *pixel;
    size_t size;

    CHECK_OK(gsn_phantom_plan_make("S00", "L1", 7, 30, &plan, &err), err);
    for (int k = 0; k < GSN_PHANTOM_SLOTS; k++) {
        const struct gsn_phantom_section first = plan.section[k];
        struct gsn_phantom_section *second = &plan.section[GSN_PHANTOM_SLOTS + k];

        second->flip = first.flip;
        second->theta = first.theta;
        second->sx = first.sx;
        second->sy = first.sy;
        second->centre_px = first.centre_px;
        second->to_panel = first.to_panel;
        memcpy(second->mark, first.mark, sizeof second->mark);
    }
    CHECK_OK(gsn_phantom_panel_draw(&plan, &plan.file[panel - 1], 0, &image, extent, &err), err);
    pixel = image->samples;
    for (size_t i = 0; i < gsn_image_bytes(image); i++)
        pixel[i] = (uint8_t)(light * pixel[i]);
    for (uint32_t y = 0; y < image->height; y++)
        memset(pixel + 3 * ((size_t)y * image->width + 48), 30, (size_t)3 * 12);
    CHECK_OK(gsn_png_encode(image, &png, &size, &err), err);
    bench_write(scratch, "in", file, png, size);
}

/* Case 5. Their marks lie alike to a pixel on both glasses, so the tissue must tell. */
TEST(of_two_scans_of_one_glass_one_is_used_and_glasses_mounted_alike_are_two)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    bench_write_job(&scratch, "in",
                    "{\"specimen\": \"x\", \"px_um\": 30, \"layout\": [3, 4], \"panels\": 2, "
                    "\"markers_um\": [[-2050, -1000], [1700, -1500], [-1500, 1300]]}");
    write_jigged(&scratch, "P01.png", 1, 1);
    write_jigged(&scratch, "P01_again.png", 1, 0.93);
    write_jigged(&scratch, "P02.png", 2, 1);
    gsn_auto(gsn_panel_rows) rows = worked(&scratch, store, "in", "x");

    CHECK(rows->count == 3);
    print_message("  %s\n", rows->at[0].message);
    assert_string_equal(rows->at[0].file_name, "P01.png");
    assert_string_equal(rows->at[0].state, "held");
    assert_string_equal(rows->at[0].code, GSN_PANEL_SPARE);
    CHECK(strstr(rows->at[0].message, "another scan of panel 1 is used, P01_again.png: both show "
                                      "the same glass (36 marks agree to "));
    assert_string_equal(rows->at[1].state, "registered");
    assert_string_equal(rows->at[2].file_name, "P02.png");
    assert_string_equal(rows->at[2].state, "registered");
}

/* Case 5: the same glass under another light and number, its code not to be read. */
TEST(another_scan_of_the_same_glass_is_held_and_both_are_kept)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    const struct drawn_panel fine = drawn_panel_of(1, 24, 0.8), coarse = drawn_panel_of(1, 24, 0.7);
    const struct drawn_panel next = drawn_panel_of(2, 24, 0.8);
    const struct drawn_panel *const panels[] = { &fine, &coarse, &next };
    static const char *const names[] = { "P01.tif.png", "P02.png", "P03.png" };

    bench_write_job(&scratch, "in",
                    "{\"specimen\": \"x\", \"layout\": [2, 2], \"panels\": 5, \"px_um\": 24, "
                    "\"markers_um\": " DRAWN_MARKS_JSON "}");
    for (size_t i = 0; i < 3; i++) {
        size_t size;
        gsn_auto_mem(uint8_t) png = drawn_panel_png(panels[i], &size);

        bench_write(&scratch, "in", names[i], png, size);
    }
    gsn_auto(gsn_panel_rows) rows = worked(&scratch, store, "in", "x");

    CHECK(rows->count == 3);
    CHECK(strcmp(rows->at[0].state, "registered") == 0);
    CHECK(strcmp(rows->at[1].state, "held") == 0);
    CHECK(
        strstr(rows->at[1].message, "it shows the same glass as P01.tif.png (12 marks agree to "));
    CHECK(strstr(rows->at[1].message, "): both are kept; to use this one, import it under that "
                                      "panel's name"));
    CHECK(strcmp(rows->at[2].state, "registered") == 0);
}

TEST(a_label_that_agrees_with_the_name_lets_the_panel_pass)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    write_job(&scratch, "in", "S02-L0");
    write_panel(&scratch, "S02", "in", "P03.png");
    gsn_auto(gsn_panel_rows) panels = worked(&scratch, store, "in", "S02-L0");

    CHECK(panels->count == 1 && strcmp(panels->at[0].state, "registered") == 0);
    CHECK(!strstr(panels->at[0].message, "label"));
}

/* Case 34: the number on the label and that of the file. */
TEST(a_label_with_another_number_holds_the_panel_and_names_both)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    write_job(&scratch, "in", "S02-L0");
    write_panel(&scratch, "S02", "in", "P02.png");
    gsn_auto(gsn_panel_rows) panels = worked(&scratch, store, "in", "S02-L0");

    check_panel(&panels->at[0], "held",
                "its label says GVP-D-S02-P03, but its file P02.png is panel 2: look at the glass, "
                "then rename the file and import again");
}

/* Case 33: the panel of another animal. */
TEST(a_label_of_another_specimen_holds_the_panel_and_names_both)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    write_job(&scratch, "other", "S02-L0");
    write_panel(&scratch, "S02", "other", "P03.png");
    gsn_panel_rows_free(worked(&scratch, store, "other", "S02-L0"));
    write_job(&scratch, "in", "S01-L0");
    write_panel(&scratch, "S02", "in", "P04.png");
    gsn_auto(gsn_panel_rows) panels = worked(&scratch, store, "in", "S01-L0");

    check_panel(
        &panels->at[0], "held",
        "its label says GVP-D-S02-P03, but it came as panel 4 of S01-L0: look at the glass, "
        "then import it where it belongs");
}

/* Case 35. */
TEST(a_label_of_nobody_is_quarantined_and_creates_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_specimen_rows) all = NULL;
    struct gsn_error err = { 0 };

    write_job(&scratch, "in", "S01-L0");
    write_panel(&scratch, "S02", "in", "P03.png");
    gsn_auto(gsn_panel_rows) panels = worked(&scratch, store, "in", "S01-L0");

    check_panel(
        &panels->at[0], "held",
        "its label says GVP-D-S02-P03, and no specimen here is called GVP-D-S02: import its "
        "job first, or correct the label; nothing was created");
    CHECK_OK(gsn_specimen_list(store, &all, &err), err);
    CHECK(all->count == 1);
}
