/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/apart.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/codes.h"
#include "tests/check.h"
#include "tests/decode/make.h"

#include <dmtx.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum { WIDTH = 400, HEIGHT = 300, MODULE = 5 };

/* libdmtx's clock, in its place: set forward, an hour goes by whenever it is asked. */
static bool hours_go_by;
static time_t hours;

DmtxTime dmtxTimeNow(void)
{
    return (DmtxTime){ .sec = (hours += hours_go_by) * 3600 };
}

static void paint(struct gsn_image *image, uint32_t x, uint32_t y, const uint8_t rgb[3])
{
    memcpy((uint8_t *)image->samples + 3 * ((size_t)y * image->width + x), rgb, 3);
}

/* White glass with red tissue in the middle and a code at (30, 40), by libdmtx's own encoder. */
static struct gsn_image *drawn(const char *text)
{
    static const uint8_t WHITE[3] = { 240, 238, 235 }, ROSE[3] = { 200, 60, 90 },
                         INK[3] = { 20, 20, 24 };
    DmtxEncode *encoder = dmtxEncodeCreate();
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };
    unsigned char letters[64];
    uint8_t *pixels;
    int side;

    CHECK_OK(gsn_image_new(WIDTH, HEIGHT, 3, 8, &image, &err), err);
    (void)snprintf((char *)letters, sizeof letters, "%s", text);
    (void)dmtxEncodeSetProp(encoder, DmtxPropModuleSize, MODULE);
    (void)dmtxEncodeSetProp(encoder, DmtxPropMarginSize, 0);
    CHECK(dmtxEncodeDataMatrix(encoder, (int)strlen(text), letters) == DmtxPass);
    side = dmtxImageGetProp(encoder->image, DmtxPropWidth);
    pixels = encoder->image->pxl;
    for (uint32_t y = 0; y < HEIGHT; y++)
        for (uint32_t x = 0; x < WIDTH; x++)
            paint(image, x, y, hypot(x - 280.0, y - 150.0) < 90 ? ROSE : WHITE);
    for (int i = 0; i < side * side; i++) {
        const uint8_t *code = pixels + 3 * (size_t)i;

        if (code[0] < 128)
            paint(image, (uint32_t)(30 + i % side), (uint32_t)(40 + i / side), INK);
    }
    (void)dmtxEncodeDestroy(&encoder);
    return image;
}

/* orientation as in EXIF: 1 as it is, 2 mirrored left to right, 3 turned by 180 degrees. */
static void turn(struct gsn_image *image, int orientation)
{
    const size_t count = WIDTH * HEIGHT;
    uint8_t *pixel = image->samples;

    for (size_t i = 0; i < count && orientation > 1; i++) {
        const size_t y = i / WIDTH, x = i % WIDTH;
        const size_t k = orientation == 2 ? y * WIDTH + WIDTH - 1 - x : count - 1 - i;

        for (int c = 0; c < 3 && i < k; c++) {
            const uint8_t kept = pixel[3 * i + (size_t)c];

            pixel[3 * i + (size_t)c] = pixel[3 * k + (size_t)c];
            pixel[3 * k + (size_t)c] = kept;
        }
    }
}

static struct gsn_decoder *new_decoder(void)
{
    struct gsn_decoder *decoder = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decoder_new(GSN_DECODER, &decoder, &err), err);
    return decoder;
}

static struct gsn_picture *decoded(const struct gsn_image *image, struct gsn_decoder *decoder,
                                   int codes)
{
    const struct gsn_decode_limits limits = { .codes = codes };
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };
    const struct png_recipe recipe = { 0 };
    auto_made png = make_png(image, &recipe);

    CHECK_OK(gsn_decode_apart(decoder, gsn_check_fd(png.bytes, png.size), &limits, &picture, &err),
             err);
    return picture;
}

TEST(a_data_matrix_is_read_whichever_way_round_it_lies)
{
    static const struct {
        int orientation, mirrored;
        double turn_deg;
    } ways[] = { { 1, 0, 0 }, { 2, 1, 0 }, { 3, 0, 180 } };

    for (size_t i = 0; i < 3; i++) {
        gsn_auto(gsn_image) image = drawn("GVP-D-S01-P03");

        turn(image, ways[i].orientation);
        gsn_auto(gsn_decoder) decoder = new_decoder();
        gsn_auto(gsn_picture) picture = decoded(image, i ? decoder : NULL, 1);

        CHECK(picture->code_count == 1);
        assert_string_equal(picture->code[0].text, "GVP-D-S01-P03");
        assert_string_equal(picture->code[0].kind, "Data Matrix");
        CHECK(picture->code[0].mirrored == ways[i].mirrored);
        CHECK_NEAR(fabs(picture->code[0].turn_deg), ways[i].turn_deg, 3);
    }
}

/* On a machine that has no time for us a label was not found, and the panel was another one. */
TEST(a_data_matrix_is_read_however_late_it_is_on_the_wall)
{
    gsn_auto(gsn_image) image = drawn("GVP-D-S02/P03");
    struct gsn_picture picture = { .image = image };
    struct gsn_error err = { 0 };

    hours_go_by = true;
    CHECK_OK(gsn_codes_read(&picture, &err), err);
    hours_go_by = false;
    CHECK(hours > 0 && picture.code_count == 1);
    CHECK(strcmp(picture.code[0].text, "GVP-D-S02/P03") == 0);
}

TEST(codes_are_read_only_when_asked_for)
{
    gsn_auto(gsn_image) image = drawn("GVP-D-S01-P03");
    gsn_auto(gsn_picture) picture = decoded(image, NULL, 0);

    CHECK(picture->code_count == 0);
}

/* Case 63: what a label says is data. */
TEST(a_text_that_does_not_print_is_shown_as_question_marks)
{
    gsn_auto(gsn_image) image = drawn("a\x1b[2J\nb");
    gsn_auto(gsn_decoder) decoder = new_decoder();
    gsn_auto(gsn_picture) picture = decoded(image, decoder, 1);

    CHECK(picture->code_count == 1);
    assert_string_equal(picture->code[0].text, "a?[2J?b");
}

TEST(a_picture_without_a_code_has_none)
{
    gsn_auto(gsn_image) image = drawn("x");

    for (uint32_t i = 0; i < 120 * 120; i++)
        paint(image, 25 + i % 120, 35 + i / 120, (const uint8_t[]){ 240, 238, 235 });
    gsn_auto(gsn_decoder) decoder = new_decoder();
    gsn_auto(gsn_picture) picture = decoded(image, decoder, 1);

    CHECK(picture->code_count == 0);
}

/* The same picture on the dark bed of a scanner, whose black is not even: as wide as the glass on
 * either side. */
static struct gsn_image *on_bed(const struct gsn_image *image)
{
    const uint32_t bed = 400;
    struct gsn_image *whole = NULL;
    struct gsn_error err = { 0 };
    uint32_t random = 1;

    CHECK_OK(gsn_image_new(image->width + 2 * bed, image->height + 2 * bed, 3, 8, &whole, &err),
             err);
    for (size_t i = 0; i < gsn_image_bytes(whole); i++) {
        random = random * 1664525 + 1013904223;
        ((uint8_t *)whole->samples)[i] = (uint8_t)(8 + (random >> 28));
    }
    for (uint32_t y = 0; y < image->height; y++)
        memcpy((uint8_t *)whole->samples + 3 * ((size_t)(y + bed) * whole->width + bed),
               (const uint8_t *)image->samples + (size_t)3 * y * image->width,
               (size_t)3 * image->width);
    return whole;
}

/* Its edges are no print, so nobody looks for a code along them; an askew one shows no other. */
TEST(a_dark_bed_around_the_glass_costs_no_search)
{
    gsn_auto(gsn_image) image = drawn("GVP-D-S01-P03");
    gsn_auto(gsn_image) bed = on_bed(image);
    struct gsn_picture read = { .image = bed };
    struct gsn_error err = { 0 };
    clock_t spent = clock();

    CHECK_OK(gsn_codes_read(&read, &err), err);
    spent = clock() - spent;
    CHECK(read.code_count == 1);
    assert_string_equal(read.code[0].text, "GVP-D-S01-P03");
    print_message("  %.0f ms\n", 1e3 * (double)spent / CLOCKS_PER_SEC);

    /* Without its code nothing is left to look at. */
    memset(&read.code, 0, sizeof read.code);
    read.code_count = 0;
    for (uint32_t i = 0; i < 120 * 120; i++)
        paint(bed, 425 + i % 120, 435 + i / 120, (const uint8_t[]){ 240, 238, 235 });
    spent = clock();
    CHECK_OK(gsn_codes_read(&read, &err), err);
    spent = clock() - spent;
    CHECK(read.code_count == 0);
    print_message("  %.0f ms without a code\n", 1e3 * (double)spent / CLOCKS_PER_SEC);
    CHECK((double)spent / CLOCKS_PER_SEC < 0.5);
}

/* Photographs of Data Matrices that come with libdmtx. */
TEST(photographs_of_codes_are_read)
{
    static const char *const names[] = { "01", "07", "11", "12", "16" };
    const struct gsn_decode_limits limits = { .codes = 1 };
    int read = 0;

    if (access(GSN_SHARED "/data/barcodes", R_OK) != 0)
        gsn_check_skip("%s is not there", GSN_SHARED "/data/barcodes");
    gsn_auto(gsn_decoder) decoder = new_decoder();
    for (size_t i = 0; i < 5; i++) {
        gsn_auto_mem(uint8_t) bytes = NULL;
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };
        char path[512];
        size_t size;

        (void)snprintf(path, sizeof path, GSN_SHARED "/data/barcodes/test_image%s.png", names[i]);
        CHECK_OK(gsn_file_read(path, 1 << 26, &bytes, &size, &err), err);
        CHECK_OK(gsn_decode_apart(decoder, gsn_check_fd(bytes, size), &limits, &picture, &err),
                 err);
        print_message("%s: %u %s \"%s\"\n", names[i], picture->code_count, picture->code[0].kind,
                      picture->code[0].text);
        read += picture->code_count > 0;
    }
    CHECK(read >= 4);
}
