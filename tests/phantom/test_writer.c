/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <png.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <tiffio.h>
#include <unistd.h>

#include <jpeglib.h>

#include "pipeline/phantom/writer.h"

enum { WIDE = 133, HIGH = 150 };

static struct gsn_image *picture(void)
{
    struct gsn_error err = { 0 };
    struct gsn_image *image = NULL;

    CHECK_OK(gsn_image_new(WIDE, HIGH, 3, 8, &image, &err), err);
    for (size_t i = 0; i < gsn_image_bytes(image); i++)
        ((uint8_t *)image->samples)[i] = (uint8_t)(i * i / 7);
    return image;
}

/* libpng's own reader gives the pixels back; pHYs is 11 bytes with a big-endian 62500 twice. */
TEST(a_png_carries_the_pixels_and_their_size)
{
    gsn_auto(gsn_image) image = picture();
    gsn_auto_phantom_buffer file = { 0 };
    gsn_auto_mem(uint8_t) back = gsn_alloc(WIDE * HIGH * 3);
    png_image reader = { .version = PNG_IMAGE_VERSION };
    static const char tag[] = "pHYs\0\0\xf4\x24\0\0\xf4\x24\1";
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_png(image, 16, &file, &err), err);
    CHECK(png_image_begin_read_from_memory(&reader, file.bytes, file.size));
    CHECK(reader.width == WIDE && reader.height == HIGH && reader.format == PNG_FORMAT_RGB);
    CHECK(png_image_finish_read(&reader, NULL, back, 0, NULL));
    CHECK(memcmp(back, image->samples, WIDE * HIGH * 3) == 0);
    CHECK(memmem(file.bytes, file.size, tag, sizeof tag - 1));
}

/* libtiff's own reader, from a file. */
static void check_tiff(const char *path, const struct gsn_image *image)
{
    TIFF *tiff = TIFFOpen(path, "r");
    uint8_t row[WIDE * 3];
    uint16_t compression = 0, unit = 0;
    uint32_t width = 0, height = 0;
    float per_cm = 0;

    CHECK(tiff);
    CHECK(TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width) && width == WIDE);
    CHECK(TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height) && height == HIGH);
    CHECK(TIFFGetField(tiff, TIFFTAG_COMPRESSION, &compression) && compression == COMPRESSION_LZW);
    CHECK(TIFFGetField(tiff, TIFFTAG_RESOLUTIONUNIT, &unit) && unit == RESUNIT_CENTIMETER);
    CHECK(TIFFGetField(tiff, TIFFTAG_XRESOLUTION, &per_cm));
    CHECK_NEAR((double)per_cm, 625, 1e-6);
    CHECK(TIFFGetField(tiff, TIFFTAG_YRESOLUTION, &per_cm));
    CHECK_NEAR((double)per_cm, 625, 1e-6);
    for (uint32_t y = 0; y < HIGH; y++) {
        CHECK(TIFFReadScanline(tiff, row, y, 0) == 1);
        CHECK(memcmp(row, (const uint8_t *)image->samples + (size_t)y * sizeof row, sizeof row) ==
              0);
    }
    TIFFClose(tiff);
}

TEST(a_tiff_carries_the_pixels_and_their_size)
{
    char folder[] = "/tmp/gsn_writer_XXXXXX";
    gsn_auto(gsn_image) image = picture();
    gsn_auto_phantom_buffer file = { 0 };
    gsn_auto_mem(char) path = NULL;
    struct gsn_error err = { 0 };

    CHECK(mkdtemp(folder));
    path = gsn_format("%s/panel.tif", folder);
    CHECK_OK(gsn_phantom_tiff(image, 16, &file, &err), err);
    CHECK_OK(gsn_phantom_buffer_write(&file, folder, "panel.tif", &err), err);
    check_tiff(path, image);
    CHECK(unlink(path) == 0 && rmdir(folder) == 0);
}

/* libjpeg's own reader: a smooth picture comes back within what quality 85 loses, the colours have
 * half the resolution both ways, and the density is whole and next to the truth. */
static void check_jpeg(double px_um, UINT8 unit, UINT16 density)
{
    gsn_auto(gsn_image) image = picture();
    gsn_auto_phantom_buffer file = { 0 };
    struct jpeg_decompress_struct jpeg = { 0 };
    struct jpeg_error_mgr errors;
    struct gsn_error err = { 0 };
    uint8_t row[WIDE * 3];
    JSAMPROW rows[1] = { row };

    for (size_t i = 0; i < gsn_image_bytes(image); i++)
        ((uint8_t *)image->samples)[i] = (uint8_t)(40 + i / 300);
    CHECK_OK(gsn_phantom_jpeg(image, px_um, 85, 1, &file, &err), err);
    jpeg.err = jpeg_std_error(&errors);
    jpeg_create_decompress(&jpeg);
    jpeg_mem_src(&jpeg, file.bytes, file.size);
    CHECK(jpeg_read_header(&jpeg, TRUE) == JPEG_HEADER_OK);
    CHECK(jpeg.image_width == WIDE && jpeg.image_height == HIGH);
    CHECK(jpeg.comp_info[0].h_samp_factor == 2 && jpeg.comp_info[0].v_samp_factor == 2);
    CHECK(jpeg.comp_info[1].h_samp_factor == 1 && jpeg.comp_info[2].v_samp_factor == 1);
    CHECK(jpeg.density_unit == unit && jpeg.X_density == density && jpeg.Y_density == density);
    (void)jpeg_start_decompress(&jpeg);
    for (size_t y = 0; y < HIGH; y++) {
        CHECK(jpeg_read_scanlines(&jpeg, rows, 1) == 1);
        for (size_t i = 0; i < sizeof row; i++)
            CHECK_NEAR(row[i], ((uint8_t *)image->samples)[y * sizeof row + i], 4);
    }
    (void)jpeg_finish_decompress(&jpeg);
    jpeg_destroy_decompress(&jpeg);
}

TEST(a_jpeg_carries_the_picture_and_the_size_of_its_pixels)
{
    check_jpeg(16, 2, 625);     /* per cm */
    check_jpeg(10.58, 1, 2401); /* per inch: nearer than 945 per cm */
}

TEST(another_kind_of_image_is_refused)
{
    gsn_auto(gsn_image) grey = NULL;
    gsn_auto_phantom_buffer file = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_image_new(4, 4, 1, 16, &grey, &err), err);
    CHECK(gsn_phantom_png(grey, 16, &file, &err) == GSN_E_UNSUPPORTED);
    CHECK(gsn_phantom_tiff(grey, 16, &file, &err) == GSN_E_UNSUPPORTED);
    CHECK(gsn_phantom_jpeg(grey, 16, 85, 1, &file, &err) == GSN_E_UNSUPPORTED);
    CHECK(file.bytes == NULL);
}

static int write_all(const struct gsn_image *image, struct gsn_error *err)
{
    gsn_auto_phantom_buffer png = { 0 };
    gsn_auto_phantom_buffer tiff = { 0 };
    gsn_auto_phantom_buffer jpeg = { 0 };
    int r = gsn_phantom_png(image, 16, &png, err);

    if (r >= 0)
        r = gsn_phantom_tiff(image, 16, &tiff, err);
    return r < 0 ? r : gsn_phantom_jpeg(image, 16, 85, 1, &jpeg, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_image) image = picture();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(write_all(image, &err), err);
}
