/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/decode/decode.h"
#include "tests/decode/make.h"

#include <stdio.h>
#include <string.h>

#include <tiffio.h>
#include <zlib.h>

static int decode(const struct made *file, const struct gsn_decode_limits *limits,
                  struct gsn_picture **ret_picture, struct gsn_error *err)
{
    return gsn_decode(file->bytes, file->size, limits, ret_picture, err);
}

/* Refused with this code, in a sentence that begins so, and the output stays untouched. */
static void check_refused_at(struct made file, int code, const char *sentence, const char *where,
                             int line)
{
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };
    const int r = decode(&file, NULL, &picture, &err);

    made_free(&file);
    if (r != code || strncmp(err.text, sentence, strlen(sentence)) != 0 || picture) {
        print_error("%d \"%s\", should be %d \"%s\"\n", r, err.text, code, sentence);
        _fail(where, line);
    }
}
#define check_refused(file, code, sentence)                                                        \
    check_refused_at(file, code, sentence, __FILE__, __LINE__)

static struct made copy(const void *bytes, size_t size)
{
    return (struct made){ .bytes = gsn_memdup(bytes, size), .size = size };
}

/* --- truncated and damaged --- */

/* A shorter file is refused, or it is the same picture (what was cut off did not matter). */
static void check_truncations(struct made file)
{
    gsn_auto(gsn_picture) whole = NULL;
    struct gsn_error err = { 0 };
    size_t refused = 0;

    CHECK_OK(decode(&file, NULL, &whole, &err), err);
    for (size_t size = 0; size < file.size; size += 7) {
        auto_made part = copy(file.bytes, size);
        gsn_auto(gsn_picture) picture = NULL;
        const int r = decode(&part, NULL, &picture, &err);

        CHECK(r == GSN_OK ? same_picture(picture->image, whole->image) : picture == NULL);
        refused += r != GSN_OK;
    }
    CHECK(refused > file.size / 7 / 2);
    made_free(&file);
}

TEST(no_truncated_file_becomes_another_picture)
{
    gsn_auto(gsn_image) image = make_picture(37, 23, 3, 8);
    const struct jpeg_recipe progressive = { .progressive = 1 };
    const struct png_recipe interlaced = { .interlaced = 1 };
    const struct tiff_recipe lzw = { .compression = COMPRESSION_LZW };
    const struct tiff_recipe tiles = { .compression = COMPRESSION_ADOBE_DEFLATE, .tile = 16 };
    const struct tiff_recipe big = { .mode = "w8", .planar = PLANARCONFIG_SEPARATE };
    const struct tiff_recipe jpeg = { .compression = COMPRESSION_JPEG, .jpeg_ycbcr = 1 };

    check_truncations(make_jpeg(image, &(struct jpeg_recipe){ 0 }));
    check_truncations(make_jpeg(image, &progressive));
    check_truncations(make_png(image, &(struct png_recipe){ 0 }));
    check_truncations(make_png(image, &interlaced));
    check_truncations(make_tiff(image, &lzw));
    check_truncations(make_tiff(image, &tiles));
    check_truncations(make_tiff(image, &big));
    check_truncations(make_tiff(image, &jpeg));
}

/* PNG carries checksums, so there not one flipped bit may pass; JPEG and TIFF need only survive it.
 */
static void check_damage(struct made file, int has_checksums)
{
    for (size_t at = 0; at < file.size; at++)
        for (unsigned flip = 1; flip < 256; flip = flip * 5 + 1) {
            gsn_auto(gsn_picture) picture = NULL;
            struct gsn_error err = { 0 };
            int r;

            file.bytes[at] ^= (uint8_t)flip;
            r = decode(&file, NULL, &picture, &err);
            file.bytes[at] ^= (uint8_t)flip;
            CHECK((r == GSN_OK) == (picture != NULL));
            CHECK(!has_checksums || r != GSN_OK);
        }
    made_free(&file);
}

TEST(a_damaged_file_neither_crashes_nor_passes_its_checksums)
{
    gsn_auto(gsn_image) image = make_picture(19, 11, 3, 8);
    const struct tiff_recipe lzw = { .compression = COMPRESSION_LZW, .tile = 16 };
    const struct tiff_recipe big = { .mode = "w8", .compression = COMPRESSION_ADOBE_DEFLATE };
    const struct jpeg_recipe progressive = { .progressive = 1 };
    const struct png_recipe tagged = { .per_metre = 62500, .gamma = 100000 };

    check_damage(make_png(image, &tagged), 1);
    check_damage(make_jpeg(image, &progressive), 0);
    check_damage(make_jpeg(image, &(struct jpeg_recipe){ 0 }), 0);
    check_damage(make_tiff(image, &lzw), 0);
    check_damage(make_tiff(image, &big), 0);
}

/* The offset of the n-th start-of-scan marker. */
static size_t find_scan(const struct made *file, unsigned n)
{
    size_t at = 2;

    for (; at + 1 < file->size; at++)
        if (file->bytes[at] == 0xff && file->bytes[at + 1] == 0xda && --n == 0)
            break;
    return at;
}

TEST(a_progressive_jpeg_closed_before_its_last_scans_is_refused)
{
    gsn_auto(gsn_image) image = make_picture(37, 23, 3, 8);
    struct made file = make_jpeg(image, &(struct jpeg_recipe){ .progressive = 1 });
    const size_t cut = find_scan(&file, 4);

    CHECK(cut + 2 < file.size);
    file.bytes[cut] = 0xff;
    file.bytes[cut + 1] = 0xd9; /* an end marker where the fourth scan began */
    file.size = cut + 2;
    check_refused(file, GSN_E_INPUT, "truncated JPEG: it ends after 3 scans");
}

/* An end marker in the middle: libjpeg would go on with grey and only warn. */
TEST(jpeg_data_closed_too_early_are_refused_alone_and_inside_tiff)
{
    static const uint8_t end[] = { 0xff, 0xd9 };
    gsn_auto(gsn_image) image = make_picture(64, 64, 3, 8);
    const struct tiff_recipe inside = { .compression = COMPRESSION_JPEG, .jpeg_ycbcr = 1 };
    struct made jpeg = make_jpeg(image, &(struct jpeg_recipe){ 0 });
    struct made tiff = make_tiff(image, &inside);

    memcpy(jpeg.bytes + find_scan(&jpeg, 1) + 200, end, sizeof end);
    check_refused(jpeg, GSN_E_INPUT, "corrupt JPEG in row ");
    memcpy(tiff.bytes + find_scan(&tiff, 2) + 60, end, sizeof end);
    check_refused(tiff, GSN_E_INPUT, "corrupt TIFF near column 1, row 17 of 64 x 64: ");
}

/* Case 3. */
TEST(the_sentence_names_row_and_byte)
{
    gsn_auto(gsn_image) image = make_picture(64, 64, 3, 8);
    struct made jpeg = make_jpeg(image, &(struct jpeg_recipe){ 0 });
    struct made png = make_png(image, &(struct png_recipe){ 0 });
    char sentence[80];

    jpeg.size /= 2;
    (void)snprintf(sentence, sizeof sentence, "truncated JPEG: the data end in row ");
    check_refused(jpeg, GSN_E_INPUT, sentence);
    png.size -= 14; /* the end chunk and its neighbour's checksum */
    check_refused(png, GSN_E_INPUT, "truncated PNG: the data end in row 64 of 64, at byte ");
}

TEST(a_png_without_its_end_is_refused)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    struct made png = make_png(image, &(struct png_recipe){ 0 });

    png.size -= 12;
    check_refused(png, GSN_E_INPUT, "truncated PNG: the data end in row 11 of 11");
}

/* --- empty of meaning --- */

TEST(a_picture_of_one_value_is_not_a_scan)
{
    gsn_auto(gsn_image) black = NULL;
    gsn_auto(gsn_image) teal = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(20, 11, 1, 16, &black, &err), err);
    CHECK_OK(gsn_image_new(20, 11, 3, 8, &teal, &err), err);
    for (size_t i = 0; i < 20 * 11; i++)
        memcpy((uint8_t *)teal->samples + 3 * i, "\x01\x02\x03", 3);
    check_refused(make_tiff(black, &(struct tiff_recipe){ 0 }), GSN_E_INPUT,
                  "every pixel has the same value 0: not a scan");
    check_refused(make_png(teal, &(struct png_recipe){ 0 }), GSN_E_INPUT,
                  "every pixel has the same colour (1, 2, 3): not a scan");
}

TEST(one_pixel_that_differs_is_enough)
{
    gsn_auto(gsn_image) image = NULL;
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };
    auto_made file = { 0 };

    CHECK_OK(gsn_image_new(20, 11, 1, 8, &image, &err), err);
    ((uint8_t *)image->samples)[20 * 11 - 1] = 1;
    file = make_png(image, &(struct png_recipe){ 0 });
    CHECK_OK(decode(&file, NULL, &picture, &err), err);
}

/* --- kinds that are not read --- */

TEST(what_is_no_picture_is_refused_by_name)
{
    check_refused(copy("", 0), GSN_E_INPUT, "the file is empty");
    check_refused(copy("%PDF-1.7 ", 9), GSN_E_UNSUPPORTED, "a PDF file is not read");
    check_refused(copy("....ftypheic....", 16), GSN_E_UNSUPPORTED, "a HEIF or AVIF file");
    check_refused(copy("hello", 5), GSN_E_UNSUPPORTED,
                  "neither TIFF, PNG, JPEG nor PAM: the 5 bytes begin with 68 65 6c 6c");
    check_refused(copy("II*\0", 4), GSN_E_INPUT, "truncated TIFF: the file ends in its header");
    check_refused(copy("MM\0+\0\x08\0\0", 8), GSN_E_INPUT, "truncated TIFF: the file ends in its");
    check_refused(copy("II*\0\0\0\0\0", 8), GSN_E_INPUT, "a TIFF without a page");
    check_refused(copy("\xff\xd8\xff", 3), GSN_E_INPUT, "truncated JPEG: the data end in the head");
    check_refused(copy("\x89PNG\r\n\x1a\n", 8), GSN_E_INPUT, "truncated PNG: the data end in the");
}

TEST(sample_kinds_that_are_not_read_are_refused_by_name)
{
    gsn_auto(gsn_image) colour = make_picture(20, 11, 3, 8);
    gsn_auto(gsn_image) grey = make_picture(20, 11, 1, 8);
    gsn_auto(gsn_image) wide = make_picture(20, 11, 1, 16);
    const struct tiff_recipe is_signed = { .sample_format = SAMPLEFORMAT_INT };
    const struct tiff_recipe lab = { .photometric = PHOTOMETRIC_CIELAB };
    const struct tiff_recipe cmyk = { .photometric = PHOTOMETRIC_SEPARATED, .alpha = 1 };
    const struct tiff_recipe fax = { .compression = COMPRESSION_LZMA };

    check_refused(make_jpeg(colour, &(struct jpeg_recipe){ .cmyk = 1 }), GSN_E_UNSUPPORTED,
                  "a JPEG of 4 components (CMYK)");
    check_refused(make_png(grey, &(struct png_recipe){ .bits = 1 }), GSN_E_UNSUPPORTED,
                  "a PNG of 1 bit per sample");
    check_refused(make_tiff(wide, &is_signed), GSN_E_UNSUPPORTED, "a TIFF of signed samples");
    check_refused(make_tiff(colour, &lab), GSN_E_UNSUPPORTED, "a TIFF of Lab colours");
    check_refused(make_tiff(colour, &cmyk), GSN_E_UNSUPPORTED, "a TIFF of CMYK colours");
    check_refused(make_tiff(grey, &fax), GSN_E_UNSUPPORTED, "a TIFF with compression 34925");
}

/* --- limits --- */

static void put32(uint8_t *at, uint32_t number)
{
    for (unsigned i = 0; i < 4; i++)
        at[i] = (uint8_t)(number >> (24 - 8 * i));
}

/* The header chunk is always the first: length at 8, name at 12, sizes at 16, checksum at 29. */
static struct made png_bomb(uint32_t width, uint32_t height)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    struct made png = make_png(image, &(struct png_recipe){ 0 });

    put32(png.bytes + 16, width);
    put32(png.bytes + 20, height);
    put32(png.bytes + 29, (uint32_t)crc32(0, png.bytes + 12, 17));
    return png;
}

/* Finds the SOF0 marker and makes the picture 65500 pixels square. */
static struct made jpeg_bomb(void)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    struct made jpeg = make_jpeg(image, &(struct jpeg_recipe){ 0 });

    for (size_t at = 2; at + 9 < jpeg.size; at++)
        if (jpeg.bytes[at] == 0xff && jpeg.bytes[at + 1] == 0xc0) {
            memcpy(jpeg.bytes + at + 5, (uint8_t[]){ 0xff, 0xdc, 0xff, 0xdc }, 4);
            break;
        }
    return jpeg;
}

/* Where the directory of a big-endian TIFF begins. */
static size_t first_page(const struct made *file)
{
    const uint8_t *at = file->bytes + 4;

    return (size_t)at[0] << 24 | (size_t)at[1] << 16 | (size_t)at[2] << 8 | at[3];
}

static struct made tiff_bomb(void)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    struct made tiff = make_tiff(image, &(struct tiff_recipe){ .mode = "wb" });
    const size_t page = first_page(&tiff);

    /* The first entry is the width, made a LONG of 2^28; the number of strips stays right. */
    tiff.bytes[page + 2 + 3] = 4;
    put32(tiff.bytes + page + 2 + 8, 1u << 28);
    return tiff;
}

/* In 256 MiB the gigabytes that these headers ask for could not be had: the code would be nomem. */
static void check_bomb(struct made file, const char *sentence)
{
    struct gsn_error said = { 0 };
    const int code = decode_in_child(file.bytes, file.size, (uint64_t)256 << 20, &said, NULL);

    made_free(&file);
    if (code != GSN_E_LIMIT || strncmp(said.text, sentence, strlen(sentence)) != 0)
        fail_msg("%d \"%s\"", code, said.text);
}

/* Case 64. */
TEST(a_header_that_asks_for_too_much_is_refused_before_allocation)
{
    check_bomb(png_bomb(100000, 90000), "100000 x 90000 pixels are more than the limit of 250 mil");
    check_bomb(jpeg_bomb(), "65500 x 65500 pixels are more than the limit of 250 million");
    check_bomb(tiff_bomb(), "268435456 x 11 pixels are more than the limit of 250 million");
}

TEST(the_limits_are_the_callers)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 16);
    auto_made file = make_png(image, &(struct png_recipe){ 0 });
    const struct gsn_decode_limits exact = { .most_pixels = 220, .most_bytes = 220 * 6 };
    const struct gsn_decode_limits pixels = { .most_pixels = 219 };
    const struct gsn_decode_limits bytes = { .most_bytes = 220 * 6 - 1 };
    gsn_auto(gsn_picture) picture = NULL;
    gsn_auto(gsn_picture) none = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(decode(&file, &exact, &picture, &err), err);
    CHECK(decode(&file, &pixels, &none, &err) == GSN_E_LIMIT);
    CHECK(decode(&file, &bytes, &none, &err) == GSN_E_LIMIT);
    CHECK(none == NULL);
}

TEST(a_strip_beyond_the_end_is_refused_by_its_number)
{
    gsn_auto(gsn_image) image = make_picture(20, 5, 1, 8);
    struct made file = make_tiff(image, &(struct tiff_recipe){ .mode = "wb" });
    const size_t page = first_page(&file);
    size_t entry = page + 2;

    while (file.bytes[entry] << 8 != 0x100 || file.bytes[entry + 1] != 0x11) /* StripOffsets */
        entry += 12;
    memcpy(file.bytes + entry + 2, (uint8_t[]){ 0, 4, 0, 0, 0, 1, 0, 1, 0, 0 }, 10);
    check_refused(file, GSN_E_INPUT, "truncated TIFF: strip 1 of 1, at byte 65536, is to hold 100");
}

TEST(a_chain_of_pages_that_turns_back_is_refused)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 1, 8);
    struct made file = make_tiff(image, &(struct tiff_recipe){ .mode = "wb" });
    const size_t page = first_page(&file);
    const size_t count = (size_t)file.bytes[page] << 8 | file.bytes[page + 1];

    memcpy(file.bytes + page + 2 + 12 * count, file.bytes + 4, 4);
    check_refused(file, GSN_E_INPUT, "corrupt TIFF: page 1 of its chain is followed by page 1");
}

/* --- out of memory --- */

static int decode_once(const struct made *file, struct gsn_error *err)
{
    gsn_auto(gsn_picture) picture = NULL;

    return decode(file, NULL, &picture, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    gsn_auto(gsn_image) index = make_picture(20, 11, 1, 8);
    auto_made jpeg = make_jpeg(image, &(struct jpeg_recipe){ .with_icc = 1 });
    auto_made png = make_png(image, &(struct png_recipe){ .with_icc = 1, .interlaced = 1 });
    auto_made palette = make_palette_png(index);
    auto_made strips = make_tiff(image, &(struct tiff_recipe){ 0 });
    auto_made indexed = make_palette_tiff(index, 4);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(decode_once(&jpeg, &err), err);
    CHECK_EVERY_OOM(decode_once(&png, &err), err);
    CHECK_EVERY_OOM(decode_once(&palette, &err), err);
    CHECK_EVERY_OOM(decode_once(&strips, &err), err);
    CHECK_EVERY_OOM(decode_once(&indexed, &err), err);
}

/* What lies under a transparent pixel is whatever a program left there. */
TEST(transparent_pixels_are_called_transparent)
{
    const struct png_recipe clear = { .alpha = 2 };
    const struct tiff_recipe strips = { .alpha = 2 };

    for (int i = 0; i < 4; i++) {
        gsn_auto(gsn_image) image = make_picture(16, 12, i % 2 ? 3 : 1, i / 2 ? 16 : 8);
        auto_made png = make_png(image, &clear);
        auto_made tiff = make_tiff(image, &strips);
        const struct made *const files[2] = { &png, &tiff };

        for (int k = 0; k < 2; k++) {
            struct gsn_picture *picture = NULL;
            struct gsn_error err = { 0 };

            CHECK(gsn_decode(files[k]->bytes, files[k]->size, NULL, &picture, &err) ==
                  GSN_E_UNSUPPORTED);
            CHECK(picture == NULL);
            CHECK(strstr(err.text, "100 % of its pixels are transparent"));
        }
    }
}
