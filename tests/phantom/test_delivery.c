/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <stdio.h>
#include <string.h>

#include <jpeglib.h>

#include "pipeline/phantom/delivery.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/planning.h"

static struct gsn_phantom_plan plan_of(const char *level, uint64_t seed)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("S02", level, seed, 16, &plan, &err), err);
    return plan;
}

TEST(an_ordinary_scanner_delivers_each_panel_once_and_in_order)
{
    const struct gsn_phantom_plan plan = plan_of("L2", 3);
    gsn_auto_mem(char) name = gsn_phantom_delivery_name(&plan, 2);

    CHECK(plan.files == 5 && plan.missing_panel == 0);
    CHECK(strcmp(name, "GVP-D-S02-P03.jpg") == 0);
    for (int i = 0; i < plan.files; i++) {
        const struct gsn_phantom_file *f = &plan.file[i];

        CHECK(f->panel == i + 1 && !f->again && f->orientation == 1 && f->bits == 8);
        CHECK(f->kept == 1 && f->tag_um == 16 && f->passes == 1);
    }
}

TEST(a_bad_bench_that_loses_no_panel_turns_and_stains_alike)
{
    const struct gsn_phantom_plan bad = plan_of("L3", 3), whole = plan_of("L3-whole", 3);

    CHECK(whole.files == 5 && whole.missing_panel == 0 && bad.missing_panel > 0);
    for (int i = 0; i < whole.files; i++)
        CHECK(whole.file[i].panel == i + 1 && whole.file[i].kept == 1 && whole.file[i].passes == 1);
    for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++)
        CHECK_NEAR(whole.section[k].theta, bad.section[k].theta, 0);
    for (int i = 0; i < whole.panels; i++)
        CHECK_NEAR(whole.batch[i].red_gain, bad.batch[i].red_gain, 0);
}

static void check_awkward(const struct gsn_phantom_plan *plan)
{
    int cut = 0, turned = 0, deep = 0, wrong = 0, again = 0, seen[GSN_PHANTOM_PANELS + 1] = { 0 };

    for (int i = 0; i < plan->files; i++) {
        const struct gsn_phantom_file *f = &plan->file[i];

        cut += f->kept < 1;
        turned += f->orientation != 1;
        deep += f->bits == 16;
        wrong += f->tag_um != plan->px_um;
        again += f->again;
        seen[f->panel]++;
        CHECK(f->bits == 16 || f->passes == 2);
        CHECK(f->again == (i == plan->files - 1));
        CHECK(seen[f->panel] == 1 + f->again);
    }
    CHECK(plan->files == 5 && cut == 1 && turned == 1 && deep == 1 && wrong == 1 && again == 1);
    CHECK(plan->missing_panel >= 1 && seen[plan->missing_panel] == 0);
}

TEST(a_bad_day_brings_each_trouble_once)
{
    int in_order = 0, missing[GSN_PHANTOM_PANELS + 1] = { 0 };

    for (uint64_t seed = 0; seed < 60; seed++) {
        const struct gsn_phantom_plan plan = plan_of("L3", seed);
        int rising = 1;

        check_awkward(&plan);
        missing[plan.missing_panel]++;
        for (int i = 1; i < plan.files - 1; i++)
            rising = rising && plan.file[i].panel > plan.file[i - 1].panel;
        in_order += rising;
        for (int k = 0; k < GSN_PHANTOM_SECTIONS; k++)
            CHECK(plan.section[k].panel != plan.missing_panel || plan.section[k].shows == -1);
    }
    /* One order of 24 is the right one. */
    CHECK(in_order < 12);
    for (int panel = 1; panel <= GSN_PHANTOM_PANELS; panel++)
        CHECK(missing[panel] > 0);
}

/* 96 x 64 with a corner each of another brightness: 0 upper left, 80 upper right, 160 lower left,
 * 240 lower right. */
static struct gsn_image *cornered(void)
{
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(96, 64, 3, 8, &image, &err), err);
    for (uint32_t y = 0; y < 64; y++)
        for (uint32_t x = 0; x < 96; x++)
            memset((uint8_t *)image->samples + 3 * (y * 96 + x),
                   (x >= 48 ? 80 : 0) + (y >= 32 ? 160 : 0), 3);
    return image;
}

static void read_corners(const struct gsn_phantom_buffer *file, uint32_t *ret_width, int ret_at[4])
{
    struct jpeg_decompress_struct jpeg = { 0 };
    struct jpeg_error_mgr errors;
    uint8_t row[96 * 3];
    JSAMPROW rows[1] = { row };

    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_decompress(&jpeg);
    jpeg_mem_src(&jpeg, file->bytes, file->size);
    CHECK(jpeg_read_header(&jpeg, TRUE) == JPEG_HEADER_OK);
    (void)jpeg_start_decompress(&jpeg);
    for (uint32_t y = 0; y < jpeg.output_height; y++) {
        CHECK(jpeg_read_scanlines(&jpeg, rows, 1) == 1);
        if (y == 4 || y == jpeg.output_height - 5) {
            ret_at[y == 4 ? 0 : 2] = row[3 * 4];
            ret_at[y == 4 ? 1 : 3] = row[3 * (jpeg.output_width - 5)];
        }
    }
    *ret_width = jpeg.output_width;
    (void)jpeg_finish_decompress(&jpeg);
    jpeg_destroy_decompress(&jpeg);
}

/* What EXIF says the first row and column are: of 3 bottom and right, of 6 right and top, of 8 left
 * and bottom. So the corners of the stored picture, left to right and down, are these. */
TEST(a_turned_file_says_how_to_turn_it_back)
{
    static const struct {
        int orientation;
        uint32_t width;
        int at[4];
    } stored[] = { { 1, 96, { 0, 80, 160, 240 } },
                   { 3, 96, { 240, 160, 80, 0 } },
                   { 6, 64, { 80, 240, 0, 160 } },
                   { 8, 64, { 160, 0, 240, 80 } } };
    const struct gsn_phantom_plan plan = plan_of("L3", 1);
    gsn_auto(gsn_image) image = cornered();
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof stored / sizeof *stored; i++) {
        const uint8_t exif[] = { 0x12, 1, 3, 0, 1, 0, 0, 0, (uint8_t)stored[i].orientation, 0 };
        struct gsn_phantom_file file = plan.file[4];
        gsn_auto_phantom_buffer bytes = { 0 };
        uint32_t width = 0;
        int at[4] = { 0 };

        file.orientation = stored[i].orientation;
        CHECK_OK(gsn_phantom_delivery_encode(&plan, &file, image, &bytes, &err), err);
        read_corners(&bytes, &width, at);
        CHECK(width == stored[i].width);
        for (int c = 0; c < 4; c++)
            CHECK_NEAR(at[c], stored[i].at[c], 4);
        CHECK(!memmem(bytes.bytes, bytes.size, exif, sizeof exif) == (file.orientation == 1));
    }
}

TEST(a_file_that_was_cut_short_is_the_beginning_of_the_whole)
{
    const struct gsn_phantom_plan plan = plan_of("L3", 1);
    struct gsn_phantom_file file = plan.file[4];
    gsn_auto(gsn_image) image = cornered();
    gsn_auto_phantom_buffer whole = { 0 };
    gsn_auto_phantom_buffer cut = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_delivery_encode(&plan, &file, image, &whole, &err), err);
    file.kept = 0.5;
    CHECK_OK(gsn_phantom_delivery_encode(&plan, &file, image, &cut, &err), err);
    CHECK(cut.size == whole.size / 2);
    CHECK(memcmp(cut.bytes, whole.bytes, cut.size) == 0);
}

/* The second scan of a panel: other noise (deviation 3 each, so 3 sqrt 2 between them), the same
 * tissue; and 16 bits are 257 times the codes of 8. */
TEST(scanned_again_only_the_noise_is_new)
{
    const struct gsn_phantom_plan plan = plan_of("L3", 1);
    const int panel = plan.file[4].panel;
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    struct gsn_phantom_file first = { .panel = panel, .bits = 8 }, deep = first, again = first;
    gsn_auto(gsn_image) one = NULL;
    gsn_auto(gsn_image) two = NULL;
    gsn_auto(gsn_image) fine = NULL;
    struct gsn_error err = { 0 };
    double squares = 0;
    size_t count;

    deep.bits = 16;
    again.again = 1;
    CHECK_OK(gsn_phantom_panel_draw(&plan, &first, 0, &one, extent, &err), err);
    CHECK_OK(gsn_phantom_panel_draw(&plan, &again, 0, &two, extent, &err), err);
    CHECK_OK(gsn_phantom_panel_draw(&plan, &deep, 0, &fine, extent, &err), err);
    count = gsn_image_bytes(one);
    for (size_t i = 0; i < count; i++) {
        const int a = ((uint8_t *)one->samples)[i], b = ((uint8_t *)two->samples)[i];

        squares += (a - b) * (a - b);
        CHECK_NEAR(((uint16_t *)fine->samples)[i] / 257.0, a, 0.51);
    }
    CHECK_NEAR(sqrt(squares / (double)count), 3 * sqrt(2), 0.1);
}

static int encode_once(const struct gsn_phantom_plan *plan, const struct gsn_phantom_file *file,
                       const struct gsn_image *image, struct gsn_error *err)
{
    gsn_auto_phantom_buffer bytes = { 0 };

    return gsn_phantom_delivery_encode(plan, file, image, &bytes, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_phantom_plan plan = plan_of("L3", 1);
    struct gsn_phantom_file file = plan.file[4];
    gsn_auto(gsn_image) image = cornered();
    struct gsn_error err = { 0 };

    file.orientation = 6;
    CHECK_EVERY_OOM(encode_once(&plan, &file, image, &err), err);
}
