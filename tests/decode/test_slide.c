/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Slides, written by libtiff as Aperio's scanners and others write them. What each level must be is
 * what was written, and what libtiff and OpenSlide make of the same file. */
#include "pipeline/decode/apart.h"
#include "pipeline/decode/decode.h"

#include "pipeline/core/file.h"
#include "tests/check.h"
#include "tests/storage/scratch.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <tiffio.h>

#ifdef GSN_HAS_OPENSLIDE
#include <openslide/openslide.h>
#endif

enum { WIDTH = 400, HEIGHT = 272, LEVELS = 3, TILE = 64 };

struct slide {
    const char *description; /* NULL: none */
    double dots_x, dots_y;   /* per centimetre; 0: none */
    int thumbnail;           /* a page of strips behind the first */
};

static const char APERIO[] = "Aperio Image Library v11.2.1\r\n400x272 [0,0 400x272] (64x64) "
                             "none|AppMag = 5|MPP = 2.0160|Left = 1.0";

static uint8_t pixel(unsigned level, unsigned x, unsigned y, unsigned channel)
{
    return (uint8_t)(40 * level + 3 * x + 5 * y * (channel + 1) + 60 * channel);
}

static void write_level(TIFF *tiff, const struct slide *slide, unsigned level, int tiled)
{
    const unsigned width = WIDTH >> level, height = HEIGHT >> level;

    TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, width);
    TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, height);
    TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 8);
    TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 3);
    TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_RGB);
    TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_LZW);
    if (slide->description)
        TIFFSetField(tiff, TIFFTAG_IMAGEDESCRIPTION, slide->description);
    if (level > 0)
        TIFFSetField(tiff, TIFFTAG_SUBFILETYPE, FILETYPE_REDUCEDIMAGE);
    if (slide->dots_x > 0) {
        TIFFSetField(tiff, TIFFTAG_RESOLUTIONUNIT, RESUNIT_CENTIMETER);
        TIFFSetField(tiff, TIFFTAG_XRESOLUTION, slide->dots_x);
        TIFFSetField(tiff, TIFFTAG_YRESOLUTION, slide->dots_y);
    }
    if (tiled) {
        TIFFSetField(tiff, TIFFTAG_TILEWIDTH, TILE);
        TIFFSetField(tiff, TIFFTAG_TILELENGTH, TILE);
    } else {
        TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, 8);
    }
    for (unsigned y0 = 0; y0 < height; y0 += tiled ? TILE : 1)
        for (unsigned x0 = 0; x0 < width; x0 += tiled ? TILE : width) {
            uint8_t part[TILE * WIDTH * 3] = { 0 };
            const unsigned wide = tiled ? TILE : width, high = tiled ? TILE : 1;

            for (unsigned i = 0; i < wide * high * 3; i++)
                part[i] = pixel(level, x0 + i / 3 % wide, y0 + i / 3 / wide, i % 3);
            if (tiled)
                CHECK(TIFFWriteTile(tiff, part, x0, y0, 0, 0) > 0);
            else
                CHECK(TIFFWriteScanline(tiff, part, y0, 0) > 0);
        }
    CHECK(TIFFWriteDirectory(tiff));
}

/* gives: the path; the bytes. */
static char *write_slide(const struct gsn_scratch *scratch, const struct slide *slide,
                         uint8_t **ret_bytes, size_t *ret_size)
{
    char *path = gsn_format("%s/slide.svs", scratch->dir);
    TIFF *tiff = TIFFOpen(path, "w");
    struct gsn_error err = { 0 };

    CHECK(tiff);
    write_level(tiff, slide, 0, 1);
    if (slide->thumbnail)
        write_level(tiff, slide, 1, 0);
    for (unsigned level = 1; level < LEVELS; level++)
        write_level(tiff, slide, level, 1);
    TIFFClose(tiff);
    CHECK_OK(gsn_file_read(path, 16 << 20, ret_bytes, ret_size, &err), err);
    return path;
}

static void check_level(const struct gsn_picture *picture, unsigned level)
{
    const struct gsn_image *image = picture->image;

    CHECK(image->width == (unsigned)WIDTH >> level && image->height == (unsigned)HEIGHT >> level);
    for (unsigned y = 0; y < image->height; y++)
        for (unsigned x = 0; x < image->width; x++)
            for (unsigned c = 0; c < 3; c++)
                if (gsn_image_at(image, x, y, c) != pixel(level, x, y, c))
                    fail_msg("level %u differs at (%u, %u)", level, x, y);
}

#ifdef GSN_HAS_OPENSLIDE
/* The same file, by OpenSlide. */
static void check_openslide(const char *path, const struct gsn_picture *picture, unsigned level,
                            const char *vendor)
{
    openslide_t *slide = openslide_open(path);
    const struct gsn_image *image = picture->image;
    gsn_auto_mem(uint32_t) argb = gsn_alloc_array((size_t)image->width * image->height, 4);
    int64_t width = 0, height = 0;

    CHECK(slide && !openslide_get_error(slide));
    assert_string_equal(openslide_get_property_value(slide, OPENSLIDE_PROPERTY_NAME_VENDOR),
                        vendor);
    CHECK(openslide_get_level_count(slide) == LEVELS);
    openslide_get_level_dimensions(slide, (int32_t)level, &width, &height);
    CHECK(width == image->width && height == image->height);
    if (strcmp(vendor, "aperio") == 0)
        CHECK_NEAR(
            picture->px_um_x,
            strtod(openslide_get_property_value(slide, OPENSLIDE_PROPERTY_NAME_MPP_X), NULL) *
                openslide_get_level_downsample(slide, (int32_t)level),
            1e-9);
    openslide_read_region(slide, argb, 0, 0, (int32_t)level, width, height);
    CHECK(!openslide_get_error(slide));
    for (uint32_t i = 0; i < image->width * image->height; i++)
        for (unsigned c = 0; c < 3; c++)
            if ((argb[i] >> (16 - 8 * c) & 255) !=
                gsn_image_at(image, i % image->width, i / image->width, c))
                fail_msg("OpenSlide has another pixel %u of level %u", i, level);
    openslide_close(slide);
}
#endif

static void check_slide(const struct slide *slide, double um, const char *vendor, const char *says)
{
    scratch_auto scratch = gsn_scratch_new();
    uint8_t *read = NULL;
    size_t size = 0;
    gsn_auto_mem(char) path = write_slide(&scratch, slide, &read, &size);
    gsn_auto_mem(uint8_t) bytes = read;

    for (unsigned level = 0; level < LEVELS; level++) {
        const struct gsn_decode_limits limits = { .slide = 1, .level = level };
        gsn_auto(gsn_decoder) decoder = NULL;
        gsn_auto(gsn_picture) picture = NULL;
        gsn_auto(gsn_picture) apart = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(gsn_decode(bytes, size, &limits, &picture, &err), err);
        check_level(picture, level);
        CHECK_NEAR(picture->px_um_x, um * (1 << level), 1e-6 * um);
        CHECK(picture->px_um_x == picture->px_um_y);
        if (level == 1)
            assert_string_equal(picture->note, says);
        CHECK_OK(gsn_decoder_new(GSN_DECODER, &decoder, &err), err);
        CHECK_OK(gsn_decode_apart(decoder, gsn_check_fd(bytes, size), &limits, &apart, &err), err);
        check_level(apart, level);
        CHECK(apart->px_um_x == picture->px_um_x);
#ifdef GSN_HAS_OPENSLIDE
        check_openslide(path, picture, level, vendor);
#else
        (void)vendor;
#endif
    }
}

TEST(every_level_of_an_aperio_slide_is_what_was_written)
{
    const struct slide slide = { .description = APERIO, .thumbnail = 1 };

    check_slide(&slide, 2.016, "aperio", "Aperio slide, level 1 of 3 (0 to 2), 4.032 um");
}

TEST(every_level_of_a_tiled_pyramid_is_what_was_written)
{
    const struct slide slide = { .dots_x = 2500, .dots_y = 2500 };

    check_slide(&slide, 4, "generic-tiff", "tiled slide, level 1 of 3 (0 to 2), 8 um");
}

/* --- NDPI --- */

enum { NDPI_FORMAT = 65420, NDPI_LENS = 65421, NDPI_FOCAL_PLANE = 65424 };

static void know_ndpi(TIFF *tiff)
{
    static char format[] = "NdpiFormat", lens[] = "SourceLens", plane[] = "FocalPlane";
    static const TIFFFieldInfo fields[] = {
        { NDPI_FORMAT, 1, 1, TIFF_LONG, FIELD_CUSTOM, 1, 0, format },
        { NDPI_LENS, 1, 1, TIFF_FLOAT, FIELD_CUSTOM, 1, 0, lens },
        { NDPI_FOCAL_PLANE, 1, 1, TIFF_SLONG, FIELD_CUSTOM, 1, 0, plane },
    };

    CHECK(TIFFMergeFieldInfo(tiff, fields, 3) == 0);
}

/* A ramp, which JPEG keeps to a few codes; shade tells the pages apart. */
static uint8_t ramp(unsigned level, unsigned x, unsigned y)
{
    return (uint8_t)(60 + ((x + y) << level) / 8);
}

/* One JPEG strip, as Hamamatsu writes a page. */
static void write_ndpi_page(TIFF *tiff, unsigned level, double lens, int plane)
{
    const unsigned width = WIDTH >> level, height = HEIGHT >> level;
    uint8_t row[WIDTH * 3];

    know_ndpi(tiff);
    TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, width);
    TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, height);
    TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, 8);
    TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 3);
    TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_JPEG);
    TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_YCBCR);
    TIFFSetField(tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
    TIFFSetField(tiff, TIFFTAG_JPEGTABLESMODE, 0);
    TIFFSetField(tiff, TIFFTAG_JPEGQUALITY, 95);
    TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, height);
    TIFFSetField(tiff, TIFFTAG_MAKE, "Hamamatsu");
    TIFFSetField(tiff, TIFFTAG_RESOLUTIONUNIT, RESUNIT_CENTIMETER);
    TIFFSetField(tiff, TIFFTAG_XRESOLUTION, 2500. / (1 << level));
    TIFFSetField(tiff, TIFFTAG_YRESOLUTION, 2500. / (1 << level));
    TIFFSetField(tiff, NDPI_FORMAT, 1);
    TIFFSetField(tiff, NDPI_LENS, lens);
    TIFFSetField(tiff, NDPI_FOCAL_PLANE, plane);
    for (unsigned y = 0; y < height; y++) {
        for (unsigned x = 0; x < width; x++)
            memset(row + 3 * x, lens > 0 && plane == 0 ? ramp(level, x, y) : 20, 3);
        CHECK(TIFFWriteScanline(tiff, row, y, 0) > 0);
    }
    CHECK(TIFFWriteDirectory(tiff));
}

/* Pages as a scanner orders them: the finest level, a focal plane above it, the next level, the
 * macro image, here of the very shape of a level. */
static char *write_ndpi(const struct gsn_scratch *scratch, uint8_t **ret_bytes, size_t *ret_size)
{
    char *path = gsn_format("%s/slide.ndpi", scratch->dir);
    TIFF *tiff = TIFFOpen(path, "w");
    struct gsn_error err = { 0 };

    CHECK(tiff);
    write_ndpi_page(tiff, 0, 20, 0);
    write_ndpi_page(tiff, 0, 20, 4000);
    write_ndpi_page(tiff, 1, 10, 4000);
    write_ndpi_page(tiff, 1, 10, 0);
    write_ndpi_page(tiff, 2, -1, 0);
    TIFFClose(tiff);
    CHECK_OK(gsn_file_read(path, 16 << 20, ret_bytes, ret_size, &err), err);
    return path;
}

static void check_ramp(const struct gsn_picture *picture, unsigned level)
{
    const struct gsn_image *image = picture->image;

    CHECK(image->width == (unsigned)WIDTH >> level && image->height == (unsigned)HEIGHT >> level);
    for (unsigned y = 0; y < image->height; y++)
        for (unsigned x = 0; x < image->width; x++)
            CHECK_NEAR(gsn_image_at(image, x, y, 0), ramp(level, x, y), 6);
}

TEST(the_levels_of_an_ndpi_slide_are_its_lenses_in_the_middle_focal_plane)
{
    scratch_auto scratch = gsn_scratch_new();
    uint8_t *read = NULL;
    size_t size = 0;
    gsn_auto_mem(char) path = write_ndpi(&scratch, &read, &size);
    gsn_auto_mem(uint8_t) bytes = read;
    const struct gsn_decode_limits third = { .slide = 1, .level = 2 };
    struct gsn_picture *none = NULL;
    struct gsn_error err = { 0 };

    for (unsigned level = 0; level < 2; level++) {
        const struct gsn_decode_limits limits = { .slide = 1, .level = level };
        gsn_auto(gsn_picture) picture = NULL;

        CHECK_OK(gsn_decode(bytes, size, &limits, &picture, &err), err);
        check_ramp(picture, level);
        CHECK_NEAR(picture->px_um_x, 4. * (1 << level), 1e-5);
        assert_string_equal(picture->note, level == 0
                                               ? "Hamamatsu slide, level 0 of 2 (0 to 1), 4 um"
                                               : "Hamamatsu slide, level 1 of 2 (0 to 1), 8 um");
    }
    CHECK(gsn_decode(bytes, size, &third, &none, &err) == GSN_E_INPUT);
#ifdef GSN_HAS_OPENSLIDE
    assert_string_equal(openslide_detect_vendor(path), "hamamatsu");
#endif
}

static int decode_slide(const struct slide *slide, const struct gsn_decode_limits *limits,
                        struct gsn_picture **ret_picture, struct gsn_error *err)
{
    scratch_auto scratch = gsn_scratch_new();
    uint8_t *read = NULL;
    size_t size = 0;
    gsn_auto_mem(char) path = write_slide(&scratch, slide, &read, &size);
    gsn_auto_mem(uint8_t) bytes = read;

    return gsn_decode(bytes, size, limits, ret_picture, err);
}

TEST(the_coarsest_level_that_is_fine_enough_is_taken)
{
    const struct slide slide = { .description = APERIO, .thumbnail = 1 };
    static const struct {
        double target_um;
        unsigned level;
    } cases[] = { { 1, 0 }, { 2.016, 0 }, { 3.9, 0 }, { 4.1, 1 }, { 8.064, 2 }, { 500, 2 } };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const struct gsn_decode_limits limits = { .slide = 1, .target_um = cases[i].target_um };
        gsn_auto(gsn_picture) picture = NULL;
        struct gsn_error err = { 0 };

        CHECK_OK(decode_slide(&slide, &limits, &picture, &err), err);
        check_level(picture, cases[i].level);
    }
}

/* Cases 14 and 15. */
TEST(a_slide_whose_pixels_have_no_size_or_two_is_refused)
{
    static const struct {
        struct slide slide;
        unsigned level;
        const char *says;
    } cases[] = {
        { { .description = "some scanner" },
          0,
          "a slide that does not state the size of its pixels, so no level can be measured: export "
          "it with its resolution" },
        { { .description = "Aperio Image Library v1\r\n400x272|AppMag = 5" },
          0,
          "a slide that does not state the size of its pixels, so no level can be measured: export "
          "it with its resolution" },
        { { .dots_x = 2500, .dots_y = 1250 },
          0,
          "a slide whose pixels are not square (4 x 8 um): export it anew" },
        { { .description = APERIO },
          3,
          "a slide with 3 levels, so there is no level 3: say a smaller \"level\" in job.json (0 "
          "is "
          "the finest)" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const struct gsn_decode_limits limits = { .slide = 1, .level = cases[i].level };
        struct gsn_picture *picture = NULL;
        struct gsn_error err = { 0 };

        CHECK(decode_slide(&cases[i].slide, &limits, &picture, &err) == GSN_E_INPUT);
        assert_string_equal(err.text, cases[i].says);
        CHECK(picture == NULL);
    }
}

TEST(without_a_level_a_slide_is_its_first_page_and_its_pixels_have_their_size)
{
    const struct slide slide = { .description = APERIO, .thumbnail = 1 };
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(decode_slide(&slide, NULL, &picture, &err), err);
    check_level(picture, 0);
    CHECK_NEAR(picture->px_um_x, 2.016, 1e-9);
    assert_string_equal(picture->note, "page 1 of 4");
}
