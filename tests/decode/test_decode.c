/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include "pipeline/decode/decode.h"
#include "tests/decode/make.h"

#include <math.h>
#include <string.h>

#include <tiffio.h>

static struct gsn_picture *decode(const struct made *file)
{
    struct gsn_picture *picture = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_decode(file->bytes, file->size, NULL, &picture, &err), err);
    return picture;
}

/* Decodes, frees the file and demands exactly the samples that went in. */
static void check_exact(struct made file, const struct gsn_image *truth, const char *kind,
                        const char *note)
{
    gsn_auto(gsn_picture) picture = decode(&file);

    made_free(&file);
    CHECK(same_picture(picture->image, truth));
    CHECK(strcmp(picture->kind, kind) == 0);
    CHECK(strcmp(picture->note, note) == 0);
    CHECK(!picture->lossy);
}

/* --- TIFF --- */

TEST(tiff_samples_come_back_in_every_layout)
{
    static const int compressions[] = { COMPRESSION_NONE, COMPRESSION_LZW,
                                        COMPRESSION_ADOBE_DEFLATE, COMPRESSION_PACKBITS };
    static const uint32_t tiles[] = { 0, 16 };
    static const int planars[] = { PLANARCONFIG_CONTIG, PLANARCONFIG_SEPARATE };
    static const char *const modes[] = { "w", "wb", "w8" };

    for (unsigned i = 0; i < 4 * 2 * 2 * 3 * 4; i++) {
        const struct tiff_recipe recipe = { .compression = compressions[i % 4],
                                            .tile = tiles[i / 4 % 2],
                                            .planar = planars[i / 8 % 2],
                                            .mode = modes[i / 16 % 3] };
        gsn_auto(gsn_image) truth = make_picture(37, 23, i / 48 % 2 ? 3 : 1, i / 96 ? 16 : 8);

        check_exact(make_tiff(truth, &recipe), truth, i / 16 % 3 == 2 ? "BigTIFF" : "TIFF", "");
    }
}

/* Rows and tiles that end unevenly, and more bytes than a cache holds. */
TEST(large_tiff_samples_come_back_in_every_layout)
{
    static const uint32_t tiles[] = { 0, 16, 208 };
    static const char *const modes[] = { "w", "wb" };
    gsn_auto(gsn_image) grey = make_picture(3001, 2801, 1, 8);
    gsn_auto(gsn_image) narrow = make_picture(1703, 1651, 3, 8);
    gsn_auto(gsn_image) wide = make_picture(1203, 1169, 3, 16);
    const struct gsn_image *const truths[] = { grey, narrow, wide };

    for (unsigned i = 0; i < 3 * 3 * 2; i++) {
        const struct gsn_image *truth = truths[i % 3];
        const struct tiff_recipe recipe = { .compression = COMPRESSION_NONE,
                                            .tile = tiles[i / 3 % 3],
                                            .mode = modes[i / 9] };

        check_exact(make_tiff(truth, &recipe), truth, "TIFF", "");
    }
    for (int compression = 0; compression < 2; compression++) {
        const struct tiff_recipe recipe = { .compression = compression ? COMPRESSION_ADOBE_DEFLATE
                                                                       : COMPRESSION_LZW,
                                            .tile = 208 };

        check_exact(make_tiff(narrow, &recipe), narrow, "TIFF", "");
    }
}

/* Where the only value of a tag of a classic big-endian file ends; the tag is there. */
static uint8_t *value_end(const struct made *file, unsigned tag)
{
    const uint8_t *const head = file->bytes + 4;
    uint8_t *entry =
        file->bytes +
        ((size_t)head[0] << 24 | (size_t)head[1] << 16 | (size_t)head[2] << 8 | head[3]) + 2;

    while (((unsigned)entry[0] << 8 | entry[1]) != tag)
        entry += 12;
    return entry + (entry[3] == TIFF_SHORT ? 10 : 12);
}

TEST(an_uncompressed_tile_may_hold_bytes_too_many_but_none_too_few)
{
    const struct tiff_recipe recipe = { .mode = "wb", .tile = 16 };
    gsn_auto(gsn_image) truth = make_picture(16, 13, 3, 8);

    for (int more = -1; more <= 1; more++) {
        auto_made file = make_tiff(truth, &recipe);
        uint8_t *const end = value_end(&file, TIFFTAG_TILEBYTECOUNTS);
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };
        int r;

        CHECK(end[-2] == 3 && end[-1] == 0); /* 768 bytes */
        end[-2] = more < 0 ? 2 : 3;
        end[-1] = (uint8_t)more;
        r = gsn_decode(file.bytes, file.size, NULL, &picture, &err);
        CHECK(r == (more < 0 ? GSN_E_INPUT : GSN_OK));
        CHECK(more < 0 ? !picture : same_picture(picture->image, truth));
        CHECK(more >= 0 || strstr(err.text, "corrupt TIFF near column 1, row 1 of 16 x 13"));
    }
}

TEST(a_file_may_begin_at_an_odd_place_in_memory)
{
    static const uint32_t tiles[] = { 0, 16 };

    for (unsigned i = 0; i < 2; i++) {
        const struct tiff_recipe recipe = { .tile = tiles[i] };
        gsn_auto(gsn_image) truth = make_picture(37, 23, 3, 16);
        auto_made file = make_tiff(truth, &recipe);
        struct made odd = { .bytes = gsn_alloc(file.size + 1) };

        CHECK(odd.bytes != NULL);
        memcpy(odd.bytes + 1, file.bytes, file.size);
        gsn_auto(gsn_picture) picture =
            decode(&(struct made){ .bytes = odd.bytes + 1, .size = file.size });

        made_free(&odd);
        CHECK(same_picture(picture->image, truth));
    }
}

TEST(bytes_filled_from_their_lowest_bit_are_turned_round)
{
    static const uint32_t tiles[] = { 0, 16 };

    for (unsigned i = 0; i < 2; i++) {
        const struct tiff_recipe recipe = { .mode = "wb", .tile = tiles[i], .lowest_bit_first = 1 };
        gsn_auto(gsn_image) truth = make_picture(37, 23, 3, 8);

        check_exact(make_tiff(truth, &recipe), truth, "TIFF", "");
    }
}

TEST(tiff_predictors_are_undone)
{
    gsn_auto(gsn_image) narrow = make_picture(37, 23, 3, 8);
    gsn_auto(gsn_image) wide = make_picture(37, 23, 3, 16);
    const struct tiff_recipe recipe = { .compression = COMPRESSION_LZW, .predictor = 2 };

    check_exact(make_tiff(narrow, &recipe), narrow, "TIFF", "");
    check_exact(make_tiff(wide, &recipe), wide, "TIFF", "");
}

TEST(tiff_alpha_is_passed_over_with_a_note)
{
    gsn_auto(gsn_image) grey = make_picture(20, 11, 1, 16);
    gsn_auto(gsn_image) colour = make_picture(20, 11, 3, 8);
    const struct tiff_recipe strips = { .alpha = 1, .compression = COMPRESSION_LZW };
    const struct tiff_recipe planes = { .alpha = 1, .planar = PLANARCONFIG_SEPARATE, .tile = 16 };

    check_exact(make_tiff(grey, &strips), grey, "TIFF", "alpha ignored");
    check_exact(make_tiff(colour, &strips), colour, "TIFF", "alpha ignored");
    check_exact(make_tiff(colour, &planes), colour, "TIFF", "alpha ignored");
}

TEST(tiff_with_white_as_zero_is_inverted)
{
    const struct tiff_recipe strips = { .white_is_zero = 1 };
    const struct tiff_recipe tiles = { .white_is_zero = 1, .tile = 16 };
    gsn_auto(gsn_image) narrow = make_picture(20, 11, 1, 8);
    gsn_auto(gsn_image) wide = make_picture(20, 11, 1, 16);

    check_exact(make_tiff(narrow, &strips), narrow, "TIFF", "inverted: 0 is white");
    check_exact(make_tiff(wide, &tiles), wide, "TIFF", "inverted: 0 is white");
}

static void check_palette(const struct gsn_picture *picture, const struct gsn_image *index,
                          unsigned mask)
{
    CHECK(picture->image->channels == 3 && picture->image->bits == 8);
    for (uint32_t y = 0; y < index->height; y++)
        for (uint32_t x = 0; x < index->width; x++) {
            const unsigned i = gsn_image_at(index, x, y, 0) & mask;

            CHECK(gsn_image_at(picture->image, x, y, 0) == i);
            CHECK(gsn_image_at(picture->image, x, y, 1) == 255 - i);
            CHECK(gsn_image_at(picture->image, x, y, 2) == i / 2);
        }
    CHECK(strcmp(picture->note, "palette expanded") == 0);
}

TEST(palettes_are_expanded)
{
    gsn_auto(gsn_image) index = make_picture(31, 9, 1, 8);
    auto_made eight = make_palette_tiff(index, 8);
    auto_made four = make_palette_tiff(index, 4);
    auto_made png = make_palette_png(index);
    gsn_auto(gsn_picture) from_eight = decode(&eight);
    gsn_auto(gsn_picture) from_four = decode(&four);
    gsn_auto(gsn_picture) from_png = decode(&png);

    check_palette(from_eight, index, 255);
    check_palette(from_four, index, 15);
    check_palette(from_png, index, 255);
}

/* Both writers use libjpeg's default tables for quality 75 and halve the chroma; one strip. */
TEST(jpeg_inside_tiff_is_the_picture_that_jpeg_alone_gives)
{
    gsn_auto(gsn_image) truth = make_picture(48, 16, 3, 8);
    const struct tiff_recipe recipe = { .compression = COMPRESSION_JPEG, .jpeg_ycbcr = 1 };
    auto_made inside = make_tiff(truth, &recipe);
    auto_made alone = make_jpeg(truth, &(struct jpeg_recipe){ .quality = 75 });
    gsn_auto(gsn_picture) a = decode(&inside);
    gsn_auto(gsn_picture) b = decode(&alone);

    CHECK(same_picture(a->image, b->image));
    CHECK(a->lossy && b->lossy);
}

TEST(jpeg_tiles_of_rgb_come_close_to_what_went_in)
{
    gsn_auto(gsn_image) truth = make_picture(48, 32, 3, 8);
    const struct tiff_recipe recipe = { .compression = COMPRESSION_JPEG, .tile = 16 };
    auto_made file = make_tiff(truth, &recipe);
    gsn_auto(gsn_picture) picture = decode(&file);

    CHECK_NEAR(mean_difference(picture->image, truth), 2, 2);
}

TEST(the_first_of_several_pages_is_decoded)
{
    gsn_auto(gsn_image) truth = make_picture(20, 11, 3, 8);
    const struct tiff_recipe recipe = { .pages = 3 };
    auto_made file = make_tiff(truth, &recipe);
    gsn_auto(gsn_picture) picture = decode(&file);

    CHECK(picture->pages == 3);
    CHECK(strcmp(picture->note, "page 1 of 3") == 0);
    CHECK(same_picture(picture->image, truth));
}

/* --- PNG --- */

TEST(png_samples_come_back_interlaced_or_not)
{
    /* Widths below 8 leave passes of Adam7 empty. */
    for (uint32_t width = 1; width < 20; width++)
        for (unsigned i = 0; i < 16; i++) {
            const struct png_recipe recipe = { .interlaced = (int)(i % 2),
                                               .alpha = (int)(i / 2 % 2) };
            gsn_auto(gsn_image) truth =
                make_picture(width, width % 7 + 2, i / 4 % 2 ? 3 : 1, i / 8 ? 16 : 8);

            check_exact(make_png(truth, &recipe), truth, "PNG", i / 2 % 2 ? "alpha ignored" : "");
        }
}

/* --- JPEG --- */

TEST(jpeg_comes_close_to_what_went_in)
{
    for (unsigned i = 0; i < 4; i++) {
        const struct jpeg_recipe recipe = { .quality = 100,
                                            .progressive = (int)(i % 2),
                                            .whole_resolution = i > 1 };
        gsn_auto(gsn_image) truth = make_picture(48, 33, i / 2 ? 3 : 1, 8);
        auto_made file = make_jpeg(truth, &recipe);
        gsn_auto(gsn_picture) picture = decode(&file);

        CHECK_NEAR(mean_difference(picture->image, truth), 0.5, 0.5);
        CHECK(strcmp(picture->kind, "JPEG") == 0);
    }
}

TEST(a_progressive_jpeg_is_the_same_picture_as_a_baseline_one)
{
    gsn_auto(gsn_image) truth = make_picture(48, 33, 3, 8);
    auto_made one = make_jpeg(truth, &(struct jpeg_recipe){ .quality = 80 });
    auto_made many = make_jpeg(truth, &(struct jpeg_recipe){ .quality = 80, .progressive = 1 });
    gsn_auto(gsn_picture) a = decode(&one);
    gsn_auto(gsn_picture) b = decode(&many);

    CHECK(same_picture(a->image, b->image));
}

/* --- upright --- */

/* The EXIF table the other way round: which stored pixel is seen at (x, y) of the upright one. */
static unsigned stored_at(const struct gsn_image *s, unsigned orientation, uint32_t x, uint32_t y,
                          uint32_t c)
{
    const uint32_t w = s->width - 1, h = s->height - 1;

    switch (orientation) {
    case 2:
        return gsn_image_at(s, w - x, y, c);
    case 3:
        return gsn_image_at(s, w - x, h - y, c);
    case 4:
        return gsn_image_at(s, x, h - y, c);
    case 5:
        return gsn_image_at(s, y, x, c);
    case 6:
        return gsn_image_at(s, y, h - x, c);
    case 7:
        return gsn_image_at(s, w - y, h - x, c);
    case 8:
        return gsn_image_at(s, w - y, x, c);
    default:
        return gsn_image_at(s, x, y, c);
    }
}

static void check_upright(struct made file, const struct gsn_image *stored, unsigned orientation)
{
    gsn_auto(gsn_picture) picture = decode(&file);
    const struct gsn_image *image = picture->image;
    const int turned = orientation > 4;

    made_free(&file);
    CHECK(image->width == (turned ? stored->height : stored->width));
    CHECK(image->height == (turned ? stored->width : stored->height));
    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++)
            for (uint32_t c = 0; c < image->channels; c++)
                CHECK(gsn_image_at(image, x, y, c) == stored_at(stored, orientation, x, y, c));
    CHECK((picture->note[0] == '\0') == (orientation == 1));
}

TEST(tiff_is_turned_upright_in_strips_and_tiles)
{
    for (int o = 1; o <= 8; o++)
        for (unsigned i = 0; i < 8; i++) {
            const struct tiff_recipe recipe = { .orientation = o,
                                                .tile = i % 2 ? 16 : 0,
                                                .planar = i / 2 % 2 ? PLANARCONFIG_SEPARATE
                                                                    : PLANARCONFIG_CONTIG };
            gsn_auto(gsn_image) stored = make_picture(37, 23, 3, i / 4 ? 16 : 8);

            check_upright(make_tiff(stored, &recipe), stored, (unsigned)o);
        }
}

TEST(png_is_turned_upright_interlaced_or_not)
{
    for (unsigned o = 1; o <= 8; o++)
        for (int interlaced = 0; interlaced < 2; interlaced++) {
            uint8_t exif[128];
            const size_t size = make_exif(&(struct exif_recipe){ .orientation = o }, exif);
            gsn_auto(gsn_image) stored = make_picture(13, 9, 3, 8);
            const struct png_recipe recipe = { .interlaced = interlaced,
                                               .exif = exif,
                                               .exif_size = size };

            check_upright(make_png(stored, &recipe), stored, o);
        }
}

TEST(jpeg_is_turned_upright_by_exif_of_either_byte_order)
{
    gsn_auto(gsn_image) painted = make_picture(37, 23, 3, 8);
    auto_made plain = make_jpeg(painted, &(struct jpeg_recipe){ 0 });
    gsn_auto(gsn_picture) stored = decode(&plain);

    for (unsigned i = 0; i < 16; i++) {
        const struct exif_recipe exif = { .for_jpeg = 1,
                                          .orientation = i % 8 + 1,
                                          .big_endian = i > 7 };
        uint8_t block[128];
        const struct jpeg_recipe recipe = { .exif = block, .exif_size = make_exif(&exif, block) };

        check_upright(make_jpeg(painted, &recipe), stored->image, i % 8 + 1);
    }
}

/* --- pitch --- */

static void check_pitch(struct made file, double x, double y)
{
    gsn_auto(gsn_picture) picture = decode(&file);

    made_free(&file);
    CHECK_NEAR(picture->px_um_x, x, x * 1e-6);
    CHECK_NEAR(picture->px_um_y, y, y * 1e-6);
}

TEST(the_pitch_comes_from_inches_centimetres_and_metres)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    uint8_t exif[128];
    const struct exif_recipe dots = { .for_jpeg = 1, .orientation = 1, .dots_per_cm = 500 };
    const size_t size = make_exif(&dots, exif);

    /* The recipe writes twice the dots along y. */
    check_pitch(make_tiff(image, &(struct tiff_recipe){ .unit = RESUNIT_INCH, .dots = 1587.5 }), 16,
                8);
    check_pitch(make_tiff(image, &(struct tiff_recipe){ .unit = RESUNIT_CENTIMETER, .dots = 625 }),
                16, 8);
    check_pitch(make_tiff(image, &(struct tiff_recipe){ .unit = RESUNIT_CENTIMETER,
                                                        .dots = 625,
                                                        .orientation = 6 }),
                8, 16);
    check_pitch(make_tiff(image, &(struct tiff_recipe){ .unit = RESUNIT_NONE, .dots = 625 }), 0, 0);
    check_pitch(make_tiff(image, &(struct tiff_recipe){ 0 }), 0, 0);
    check_pitch(make_jpeg(image, &(struct jpeg_recipe){ .unit = 1, .dots = 1270 }), 20, 20);
    check_pitch(make_jpeg(image, &(struct jpeg_recipe){ .unit = 2, .dots = 1000 }), 10, 10);
    check_pitch(make_jpeg(image, &(struct jpeg_recipe){ .unit = 0, .dots = 1 }), 0, 0);
    check_pitch(make_jpeg(image, &(struct jpeg_recipe){ .exif = exif, .exif_size = size }), 20, 20);
    check_pitch(make_png(image, &(struct png_recipe){ .per_metre = 62500 }), 16, 16);
    check_pitch(make_png(image, &(struct png_recipe){ 0 }), 0, 0);
}

/* --- transfer --- */

static void check_transfer(struct made file, enum gsn_transfer transfer)
{
    gsn_auto(gsn_picture) picture = decode(&file);

    made_free(&file);
    CHECK(picture->transfer == transfer);
}

TEST(the_transfer_curve_is_what_the_file_states)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 3, 8);
    uint16_t straight[256], srgb[256], cubic[256];
    uint8_t exif[128];
    const struct exif_recipe colours = { .for_jpeg = 1, .orientation = 1, .colour_space = 1 };
    const size_t size = make_exif(&colours, exif);

    for (unsigned i = 0; i < 256; i++) {
        const double v = i / 255.0;
        const double light = v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);

        straight[i] = (uint16_t)(i * 257);
        srgb[i] = (uint16_t)(light * 65535 + 0.5);
        cubic[i] = (uint16_t)(v * v * v * 65535 + 0.5);
    }
    check_transfer(make_png(image, &(struct png_recipe){ 0 }), GSN_TRANSFER_UNKNOWN);
    check_transfer(make_png(image, &(struct png_recipe){ .gamma = 100000 }), GSN_TRANSFER_LINEAR);
    check_transfer(make_png(image, &(struct png_recipe){ .gamma = 45455 }), GSN_TRANSFER_SRGB);
    check_transfer(make_png(image, &(struct png_recipe){ .gamma = 55556 }), GSN_TRANSFER_UNKNOWN);
    check_transfer(make_png(image, &(struct png_recipe){ .srgb = 1 }), GSN_TRANSFER_SRGB);
    check_transfer(make_png(image, &(struct png_recipe){ .srgb = 1, .with_icc = 1 }),
                   GSN_TRANSFER_ICC);
    check_transfer(make_jpeg(image, &(struct jpeg_recipe){ 0 }), GSN_TRANSFER_UNKNOWN);
    check_transfer(make_jpeg(image, &(struct jpeg_recipe){ .exif = exif, .exif_size = size }),
                   GSN_TRANSFER_SRGB);
    check_transfer(make_jpeg(image, &(struct jpeg_recipe){ .with_icc = 1 }), GSN_TRANSFER_ICC);
    check_transfer(make_tiff(image, &(struct tiff_recipe){ 0 }), GSN_TRANSFER_UNKNOWN);
    check_transfer(make_tiff(image, &(struct tiff_recipe){ .curve = straight }),
                   GSN_TRANSFER_LINEAR);
    check_transfer(make_tiff(image, &(struct tiff_recipe){ .curve = srgb }), GSN_TRANSFER_SRGB);
    check_transfer(make_tiff(image, &(struct tiff_recipe){ .curve = cubic }), GSN_TRANSFER_UNKNOWN);
    check_transfer(make_tiff(image, &(struct tiff_recipe){ .with_icc = 1 }), GSN_TRANSFER_ICC);
}

TEST(twelve_bits_in_sixteen_are_noted)
{
    gsn_auto(gsn_image) image = make_picture(20, 11, 1, 16);
    uint16_t *samples = image->samples;

    for (size_t i = 0; i < 20 * 11; i++)
        samples[i] &= 0xfff;
    check_exact(make_tiff(image, &(struct tiff_recipe){ 0 }), image, "TIFF",
                "only 12 of 16 bits are used");
}
