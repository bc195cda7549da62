/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/storage/bench.h"

#include <math.h>
#include <string.h>

#include "storage/sql.h"

TEST(a_panel_reads_back_as_it_was_written)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_row) got = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t id = bench_add_panel(store, specimen, 3);

    CHECK_OK(gsn_panel_set_size(store, id, 70000, 50000, 0.1, &err), err);
    CHECK_OK(gsn_panel_set_state(store, id, "refused", "input", "cut at 61 %", &err), err);
    CHECK_OK(gsn_panel_get(store, id, &got, &err), err);
    CHECK(got->id == id && got->specimen_id == specimen && got->number == 3 && got->size == 4711);
    CHECK(strcmp(got->file_name, "P.tif") == 0 && strcmp(got->sha256, bench_digest(3)) == 0);
    CHECK(strcmp(got->state, "refused") == 0 && strcmp(got->code, "input") == 0);
    CHECK(strcmp(got->message, "cut at 61 %") == 0);
    CHECK(got->width == 70000 && got->height == 50000);
    CHECK_NEAR(got->px_um, 0.1, 0);
    CHECK_OK(gsn_panel_set_state(store, id, "registered", NULL, NULL, &err), err);
}

TEST(how_a_panel_was_set_upright_is_kept_as_it_was_told)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_row) fresh = NULL;
    struct gsn_error err = { 0 };
    const int64_t id = bench_add_panel(store, bench_add_specimen(store, "S", "g", ""), 3);

    CHECK_OK(gsn_panel_get(store, id, &fresh, &err), err);
    CHECK(!fresh->turn_known && fresh->turn_note[0] == '\0');
    for (int way = 0; way < 8; way++) {
        gsn_auto(gsn_panel_row) got = NULL;

        CHECK_OK(gsn_panel_set_turn(store, id, way & 1, way >> 1, way ? "turned" : NULL, &err),
                 err);
        CHECK_OK(gsn_panel_get(store, id, &got, &err), err);
        CHECK(got->turn_known && got->mirrored == (way & 1) && got->quarters == way >> 1);
        assert_string_equal(got->turn_note, way ? "turned" : "");
    }
    CHECK(gsn_panel_set_turn(store, id, 2, 0, "", &err) == GSN_E_INPUT);
    CHECK(gsn_panel_set_turn(store, id, 0, 4, "", &err) == GSN_E_INPUT);
    CHECK(gsn_panel_set_turn(store, id, 0, -1, "", &err) == GSN_E_INPUT);
    CHECK(gsn_panel_set_turn(store, 99, 0, 0, "", &err) == GSN_E_NOTFOUND);
}

TEST(the_same_bytes_again_are_the_same_panel)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) all = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t other = bench_add_specimen(store, "T", "g", "");
    struct gsn_panel_row row = bench_panel(specimen, 1);
    int64_t first = 0, second = 0, third = 0;
    int again = -1;

    CHECK_OK(gsn_panel_put(store, &row, &first, &again, &err), err);
    CHECK(again == 0);
    row.file_name = "copy of P.tif";
    CHECK_OK(gsn_panel_put(store, &row, &second, &again, &err), err);
    CHECK(again == 1 && second == first);
    row.specimen_id = other;
    CHECK_OK(gsn_panel_put(store, &row, &third, &again, &err), err);
    CHECK(again == 0 && third != first);
    CHECK_OK(gsn_panel_list(store, specimen, &all, &err), err);
    CHECK(all->count == 1 && strcmp(all->at[0].file_name, "P.tif") == 0);
}

TEST(panels_come_by_number_and_unnumbered_ones_last)
{
    static const int64_t numbers[] = { 10, 0, 2, 1 };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) all = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");

    for (unsigned i = 0; i < 4; i++) {
        struct gsn_panel_row row = bench_panel(specimen, i);
        int64_t id;
        int again;

        row.number = numbers[i];
        row.px_um = NAN;
        CHECK_OK(gsn_panel_put(store, &row, &id, &again, &err), err);
    }
    CHECK_OK(gsn_panel_list(store, specimen, &all, &err), err);
    CHECK(all->count == 4 && all->at[0].number == 1 && all->at[1].number == 2);
    CHECK(all->at[2].number == 10 && all->at[3].number == 0);
    CHECK(all->at[0].px_um != all->at[0].px_um);
}

TEST(what_is_no_panel_is_refused)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_panel_rows) all = NULL;
    struct gsn_panel_row *none = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    struct gsn_panel_row row[3] = { bench_panel(99, 1), bench_panel(specimen, 1),
                                    bench_panel(specimen, 1) };
    int64_t id = -7;
    int again = -7;

    row[1].state = "eaten";
    row[2].sha256 = "../../../../etc/passwd__________________________________________x";
    for (size_t i = 0; i < 3; i++)
        CHECK(gsn_panel_put(store, &row[i], &id, &again, &err) == GSN_E_INPUT);
    CHECK(id == -7 && again == -7);
    CHECK(strncmp(err.text, "panel P.tif: ", 13) == 0);
    CHECK_OK(gsn_panel_list(store, specimen, &all, &err), err);
    CHECK(all->count == 0);
    CHECK(gsn_panel_get(store, 5, &none, &err) == GSN_E_NOTFOUND && none == NULL);
    CHECK(gsn_panel_set_state(store, 5, "held", "", "", &err) == GSN_E_NOTFOUND);
    id = bench_add_panel(store, specimen, 1);
    CHECK(gsn_panel_set_state(store, id, "eaten", "", "", &err) == GSN_E_INPUT);
}

static struct gsn_section_row section(int64_t slot, int64_t serial)
{
    struct gsn_section_row row = { .slot = slot,
                                   .serial = serial,
                                   .state = "found",
                                   .flags = "tear fold",
                                   .bbox_x = 10.5,
                                   .bbox_y = 20,
                                   .bbox_w = 300,
                                   .bbox_h = 200,
                                   .area_px = 1.0 / 3 };

    for (int i = 0; i < GSN_ROW_MARKS; i++)
        row.marker[i] =
            (struct gsn_fiducial_row){ 1, 0.1 * i, 1e5 / 3 + i, 9, 0.01, -0.001, 0.02, 7 };
    return row;
}

TEST(sections_and_marks_read_back_to_the_last_bit)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_section_rows) got = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t panel = bench_add_panel(store, specimen, 1);
    struct gsn_section_row rows[3] = { section(1, 12), section(2, 0), section(3, 11) };
    const struct gsn_fiducial_row *lost;

    rows[0].marker[1].found = 0;
    CHECK_OK(gsn_section_replace(store, panel, rows, 3, &err), err);
    CHECK_OK(gsn_section_list(store, specimen, &got, &err), err);
    CHECK(got->count == 3);
    CHECK(got->at[0].serial == 11 && got->at[1].serial == 12 && got->at[2].serial == 0);
    CHECK(got->at[0].panel_id == panel && got->at[0].slot == 3);
    CHECK(strcmp(got->at[0].flags, "tear fold") == 0);
    CHECK_NEAR(got->at[0].area_px, 1.0 / 3, 0);
    CHECK_NEAR(got->at[0].bbox_x, 10.5, 0);
    for (int i = 0; i < GSN_ROW_MARKS; i++)
        CHECK(memcmp(&got->at[0].marker[i], &rows[2].marker[i], sizeof rows[2].marker[i]) == 0);
    lost = &got->at[1].marker[1];
    CHECK(lost->found == 0 && lost->x_px != lost->x_px && lost->score != lost->score);
}

TEST(replacing_sections_is_all_or_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_section_rows) got = NULL;
    gsn_auto(gsn_section_rows) after = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t panel = bench_add_panel(store, specimen, 1);
    struct gsn_section_row rows[2] = { section(1, 1), section(2, 2) };

    CHECK_OK(gsn_section_replace(store, panel, rows, 2, &err), err);
    rows[0].serial = 77;
    rows[1].slot = 1;
    CHECK(gsn_section_replace(store, panel, rows, 2, &err) == GSN_E_INPUT);
    CHECK(gsn_section_replace(store, panel + 1, rows, 1, &err) == GSN_E_NOTFOUND);
    CHECK_OK(gsn_section_list(store, specimen, &got, &err), err);
    CHECK(got->count == 2 && got->at[0].serial == 1 && got->at[1].serial == 2);
    CHECK_OK(gsn_section_replace(store, panel, rows, 1, &err), err);
    CHECK_OK(gsn_section_list(store, specimen, &after, &err), err);
    CHECK(after->count == 1 && after->at[0].serial == 77);
}

TEST(the_slots_of_neighbouring_panels_stay_apart)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto(gsn_section_rows) got = NULL;
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const int64_t first = bench_add_panel(store, specimen, 1);
    const int64_t second = bench_add_panel(store, specimen, 2);
    struct gsn_section_row ends[2] = { section(1, 1), section(4095, 2) };
    struct gsn_section_row beyond = section(4096, 3);

    CHECK(second == first + 1);
    CHECK_OK(gsn_section_replace(store, first, ends, 2, &err), err);
    CHECK_OK(gsn_section_replace(store, second, ends, 2, &err), err);
    CHECK(gsn_section_replace(store, first, &beyond, 1, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "slot 4096"));
    CHECK_OK(gsn_section_replace(store, second, ends, 1, &err), err);
    CHECK_OK(gsn_section_list(store, specimen, &got, &err), err);
    CHECK(got->count == 3 && got->at[0].panel_id == first && got->at[1].panel_id == second);
    CHECK(got->at[2].panel_id == first && got->at[2].slot == 4095);
}

static int64_t ask(struct gsn_store *store, const char *sql)
{
    struct gsn_error err = { 0 };
    int64_t value = -1;

    CHECK_OK(gsn_sql_int(store, sql, SQL_NO_ARGS, &value, &err), err);
    return value;
}

TEST(sections_and_marks_of_the_fifth_schema_are_kept)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_section_rows) got = NULL;
    gsn_auto(gsn_store) store = NULL;
    static const char *const older[] = { gsn_schema_001, gsn_schema_002, gsn_schema_003,
                                         gsn_schema_004, gsn_schema_005 };
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof older / sizeof older[0]; i++)
        CHECK(bench_raw(&scratch, older[i]) == 0);
    CHECK(
        bench_raw(&scratch,
                  "PRAGMA application_id = 0x67736e31; PRAGMA user_version = 5; "
                  "PRAGMA journal_mode = WAL; "
                  "INSERT INTO study VALUES (1, 'st'); INSERT INTO study_group VALUES (1, 1, 'g'); "
                  "INSERT INTO animal VALUES (1, 1, 'rat'); INSERT INTO specimen VALUES "
                  "(1, 'S', 1, 1, 1, 4, 'sections', '', '{}', printf('%064d', 0)); "
                  "INSERT INTO panel VALUES (7, 1, 3, 'P3.tif', printf('%064d', 3), 9, "
                  "'registered', '', '', 0, 0, NULL); INSERT INTO section VALUES (31, 7, 2, 25, "
                  "'found', 'tear', 1, 2, 3, 4, 5); INSERT INTO marker VALUES (31, 1, 1, 10, 11, "
                  "12, 13, 14, 15, 16), (31, 2, 0, NULL, NULL, NULL, NULL, NULL, NULL, NULL), "
                  "(31, 3, 1, 30, 31, 32, 33, 34, 35, 36)") == 0);
    store = bench_open(&scratch, GSN_STORE_WRITE);
    CHECK(ask(store, "SELECT integrity_check = 'ok' FROM pragma_integrity_check") == 1);
    CHECK_OK(gsn_section_list(store, 1, &got, &err), err);
    CHECK(got->count == 1 && got->at[0].panel_id == 7 && got->at[0].slot == 2);
    CHECK(got->at[0].serial == 25 && strcmp(got->at[0].flags, "tear") == 0);
    CHECK_NEAR(got->at[0].area_px, 5, 0);
    CHECK(got->at[0].marker[0].found == 1 && got->at[0].marker[1].found == 0);
    CHECK_NEAR(got->at[0].marker[0].cov_xx, 13, 0);
    CHECK_NEAR(got->at[0].marker[2].x_px, 30, 0);
    CHECK_NEAR(got->at[0].marker[2].score, 36, 0);
    CHECK(ask(store, "SELECT sum(mark * y_px) FROM marker WHERE panel_id = 7 AND slot = 2") ==
          11 + 3 * 31);

    /* Nobody kept how the picture of its panel was turned. */
    gsn_auto(gsn_panel_row) panel = NULL;

    CHECK_OK(gsn_panel_get(store, 7, &panel, &err), err);
    CHECK(strcmp(panel->state, "registered") == 0 && !panel->turn_known);
}

static int put_once(struct gsn_store *store, const struct gsn_panel_row *row, struct gsn_error *err)
{
    int64_t id;
    int again;

    return gsn_panel_put(store, row, &id, &again, err);
}

static int list_once(struct gsn_store *store, int64_t specimen, struct gsn_error *err)
{
    gsn_auto(gsn_section_rows) rows = NULL;

    return gsn_section_list(store, specimen, &rows, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    const int64_t specimen = bench_add_specimen(store, "S", "g", "");
    const struct gsn_panel_row row = bench_panel(specimen, 1);
    const struct gsn_section_row one = section(1, 1);

    CHECK_EVERY_OOM(put_once(store, &row, &err), err);
    CHECK_EVERY_OOM(gsn_section_replace(store, 1, &one, 1, &err), err);
    CHECK_EVERY_OOM(list_once(store, specimen, &err), err);
    CHECK_EVERY_OOM(gsn_panel_set_turn(store, 1, 1, 3, "turned", &err), err);
}
