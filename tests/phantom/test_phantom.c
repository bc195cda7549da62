/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <ftw.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/phantom/phantom.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/phantom/truth.h"

enum { MOST_BYTES = 64 << 20 };

static int remove_one(const char *path, const struct stat *st, int kind, struct FTW *where)
{
    (void)st;
    (void)kind;
    (void)where;
    return remove(path);
}

/* A folder that goes away with the block it is named in. */
static void remove_folder(char (*folder)[32])
{
    (void)nftw(*folder, remove_one, 8, FTW_DEPTH | FTW_PHYS);
}

#define auto_folder __attribute__((cleanup(remove_folder))) char

static struct gsn_phantom_plan plan_of(const char *specimen, const char *level, uint64_t seed,
                                       double px_um)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make(specimen, level, seed, px_um, &plan, &err), err);
    return plan;
}

static uint8_t *slurp(const char *folder, const char *name, size_t *ret_size)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folder, name);
    struct gsn_error err = { 0 };
    uint8_t *bytes = NULL;

    CHECK_OK(gsn_file_read(path, MOST_BYTES, &bytes, ret_size, &err), err);
    return bytes;
}

static void check_same_file(const char *a, const char *b, const char *name)
{
    size_t a_size, b_size;
    gsn_auto_mem(uint8_t) a_bytes = slurp(a, name, &a_size);
    gsn_auto_mem(uint8_t) b_bytes = slurp(b, name, &b_size);

    if (a_size != b_size || memcmp(a_bytes, b_bytes, a_size) != 0)
        fail_msg("%s differs", name);
}

TEST(the_same_arguments_give_the_same_bytes_with_one_and_two_threads)
{
    static const char *const name[] = {
        "GVP-D-S02-P01.tif", "GVP-D-S02-P02.tif", "GVP-D-S02-P03.tif",  "GVP-D-S02-P04.tif",
        "GVP-D-S02-P05.tif", "job.json",          "region.mhd",         "region.raw",
        "truth/truth.json",  "truth/loss.csv",    "truth/sections.csv", "truth/markers.csv",
        "truth/roi.mhd",     "truth/roi.raw",     "truth/defects.csv",  "truth/density.mhd",
        "truth/density.raw",
    };
    const struct gsn_phantom_plan plan = plan_of("S02", "L1", 7, 48);
    auto_folder one[32] = "/tmp/gsn_phantom_XXXXXX", two[32] = "/tmp/gsn_phantom_XXXXXX";
    struct gsn_error err = { 0 };

    CHECK(mkdtemp(one) && mkdtemp(two));
    CHECK_OK(gsn_phantom_make(&plan, 1, 1, one, NULL, &err), err);
    CHECK_OK(gsn_phantom_make(&plan, 1, 2, two, NULL, &err), err);
    for (size_t i = 0; i < sizeof name / sizeof *name; i++)
        check_same_file(one, two, name[i]);
}

/* The panel that is missing, the file that is cut: every trouble leaves a folder that is complete.
 */
TEST(a_bad_day_s_files_are_those_that_the_truth_lists)
{
    const struct gsn_phantom_plan plan = plan_of("S02", "L3", 7, 48);
    auto_folder folder[32] = "/tmp/gsn_phantom_XXXXXX";
    gsn_auto_mem(uint8_t) table = NULL;
    gsn_auto_mem(char) text = NULL;
    struct gsn_error err = { 0 };
    size_t size, lines = 0;

    CHECK(mkdtemp(folder));
    CHECK_OK(gsn_phantom_make(&plan, 0, 0, folder, NULL, &err), err);
    table = slurp(folder, "truth/files.csv", &size);
    text = gsn_format("%.*s", (int)size, (const char *)table);
    CHECK(text);
    for (char *line = strchr(text, '\n'); line && line[1]; line = strchr(line + 1, '\n')) {
        gsn_auto_mem(char) name = gsn_format("%.*s", (int)strcspn(line + 1, ","), line + 1);
        gsn_auto_mem(uint8_t) bytes = slurp(folder, name, &size);

        CHECK(bytes && size > 10000);
        lines++;
    }
    CHECK(lines == 5);
}

TEST(a_damaged_specimen_is_the_same_with_one_and_two_threads)
{
    static const char *const name[] = {
        "GVP-D-S02-P01.jpg", "GVP-D-S02-P02.jpg",  "GVP-D-S02-P05.jpg",
        "truth/truth.json",  "truth/sections.csv", "truth/markers.csv",
        "truth/defects.csv", "truth/decoys.csv",   "truth/warp_k007.csv",
    };
    const struct gsn_phantom_plan plan = plan_of("S02", "L2", 7, 48);
    auto_folder one[32] = "/tmp/gsn_phantom_XXXXXX", two[32] = "/tmp/gsn_phantom_XXXXXX";
    struct gsn_error err = { 0 };

    CHECK(mkdtemp(one) && mkdtemp(two));
    CHECK_OK(gsn_phantom_make(&plan, 0, 1, one, NULL, &err), err);
    CHECK_OK(gsn_phantom_make(&plan, 0, 2, two, NULL, &err), err);
    for (size_t i = 0; i < sizeof name / sizeof *name; i++)
        check_same_file(one, two, name[i]);
}

static json_t *load_job(const struct gsn_phantom_plan *plan)
{
    auto_folder folder[32] = "/tmp/gsn_phantom_XXXXXX";
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    json_t *job;
    size_t size;

    CHECK(mkdtemp(folder));
    CHECK_OK(gsn_phantom_write_job(plan, folder, &err), err);
    bytes = slurp(folder, "job.json", &size);
    job = json_loadb((const char *)bytes, size, JSON_REJECT_DUPLICATES, NULL);
    CHECK(job);
    return job;
}

TEST(the_job_names_its_baseline_unless_it_is_the_baseline)
{
    const struct gsn_phantom_plan treated = plan_of("S02", "L1", 1, 16);
    const struct gsn_phantom_plan control = plan_of("S00", "L1", 1, 16);
    json_t *job = load_job(&treated);
    json_t *marks = json_object_get(job, "markers_um");

    CHECK(strcmp(json_string_value(json_object_get(job, "specimen")), "GVP-D-S02") == 0);
    CHECK(strcmp(json_string_value(json_object_get(job, "baseline")), "GVP-D-S00") == 0);
    CHECK(strcmp(json_string_value(json_object_get(job, "transfer")), "linear") == 0);
    CHECK(json_integer_value(json_object_get(job, "panels")) == 5);
    CHECK_NEAR(json_number_value(json_array_get(json_array_get(marks, 2), 0)), -1500, 0);
    CHECK_NEAR(json_number_value(json_array_get(json_object_get(job, "thresholds"), 1)), 0.5, 0);
    CHECK(json_object_size(job) == 16);
    json_decref(job);

    job = load_job(&control);
    CHECK(!json_object_get(job, "baseline"));
    CHECK(json_object_size(job) == 15);
    json_decref(job);
}

/* The specification gives 0.9802 mm3 from steps of 6 um; voxels of 16 x 16 x 24 um come close. */
TEST(the_region_mask_lies_on_the_sections_and_has_the_region_s_volume)
{
    const struct gsn_lattice part = gsn_phantom_region_lattice(gsn_phantom_geometry());
    const struct gsn_lattice whole = gsn_phantom_truth_lattice(gsn_phantom_geometry());
    gsn_auto(gsn_mask) small = NULL;
    gsn_auto(gsn_mask) large = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_region_mask(gsn_phantom_geometry(), &part, &small, &err), err);
    CHECK_OK(gsn_phantom_region_mask(gsn_phantom_geometry(), &whole, &large, &err), err);
    CHECK(gsn_mask_count(small) == gsn_mask_count(large));
    CHECK_NEAR((double)gsn_mask_count(small) * gsn_lattice_voxel_um3(&part) * 1e-9, 0.9802, 0.002);
    CHECK_NEAR(fmod(part.origin_um.z - 12, 24), 0, 0);
    CHECK(whole.nx == 326 && whole.ny == 258 && whole.nz == 60);
    for (size_t y = 0; y < part.ny; y++)
        for (size_t x = 0; x < part.nx; x++) {
            CHECK(!small->inside[gsn_lattice_index(&part, x, y, 1)]);
            CHECK(!small->inside[gsn_lattice_index(&part, x, y, part.nz - 2)]);
        }
}

TEST(the_density_grid_holds_the_density_at_its_voxel_centres)
{
    const struct gsn_lattice part = gsn_phantom_region_lattice(gsn_phantom_geometry());
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_density_grid(gsn_phantom_geometry(), &part, 0.5, 1, 0, &grid, &err), err);
    for (size_t i = 0; i < part.nx; i++) {
        const size_t y = i % part.ny, z = i % part.nz;
        struct gsn_phantom_field field;

        gsn_phantom_field_at(gsn_phantom_geometry(), gsn_lattice_centre(&part, i, y, z), &field);
        CHECK_NEAR((double)grid->value[gsn_lattice_index(&part, i, y, z)],
                   field.intact - 0.5 * field.lost, 1e-6);
    }
}

TEST(a_folder_that_cannot_be_made_is_reported)
{
    const struct gsn_phantom_plan plan = plan_of("S00", "L0", 1, 48);
    struct gsn_error err = { 0 };

    CHECK(gsn_phantom_make(&plan, 0, 1, "/dev/null/phantom", NULL, &err) == GSN_E_IO);
    CHECK(strstr(err.text, "/dev/null"));
}

static int describe_once(const struct gsn_phantom_plan *plan, const char *folder,
                         struct gsn_error *err)
{
    static const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS];
    const int r = gsn_phantom_write_job(plan, folder, err);

    return r < 0 ? r : gsn_phantom_write_truth(plan, extent, 0, 0, folder, err);
}

static int tabulate_once(const struct gsn_phantom_plan *plan, const char *folder,
                         struct gsn_error *err)
{
    static const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS];

    return gsn_phantom_tables_write(plan, extent, folder, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_phantom_plan whole = plan_of("S02", "L1", 1, 48);
    struct gsn_phantom_plan damaged = plan_of("S02", "L2", 1, 48);
    auto_folder folder[32] = "/tmp/gsn_phantom_XXXXXX";
    struct gsn_error err = { 0 };

    /* Warps and defects are all alike: one and two of them do. */
    for (int k = 1; k < GSN_PHANTOM_SECTIONS; k++)
        damaged.section[k].shows = -1;
    damaged.defects = 2;
    CHECK(mkdtemp(folder));
    CHECK_EVERY_OOM(describe_once(&whole, folder, &err), err);
    CHECK_EVERY_OOM(tabulate_once(&damaged, folder, &err), err);
}
