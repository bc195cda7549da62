/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures by the libraries themselves, as their manuals have it: what our decoders are compared
 * with, and what makes their files. */
#include "tests/bench/panel.h"

#include "tests/bench/bench.h"

#include <stdio.h>
#include <string.h>

#include <jpeglib.h>
#include <png.h>
#include <tiffio.h>

enum { ROWS_PER_STRIP = 16, LARGEST_TILE = 256 };

static const struct {
    const char *name;
    uint16_t compression;
    uint32_t tile; /* 0: strips */
    unsigned bits;
} KIND[BENCH_FORMATS] = {
    [BENCH_TIFF_STRIPS] = { "TIFF, strips", COMPRESSION_NONE, 0, 8 },
    [BENCH_TIFF_TILES] = { "TIFF, tiles", COMPRESSION_NONE, 256, 8 },
    [BENCH_TIFF_UNEVEN] = { "TIFF, uneven tiles", COMPRESSION_NONE, 176, 8 },
    [BENCH_TIFF_WIDE] = { "TIFF, tiles of 16 bit", COMPRESSION_NONE, 256, 16 },
    [BENCH_TIFF_LZW] = { "TIFF LZW, strips", COMPRESSION_LZW, 0, 8 },
    [BENCH_TIFF_LZW_TILES] = { "TIFF LZW, tiles", COMPRESSION_LZW, 256, 8 },
    [BENCH_TIFF_ZIP] = { "TIFF ZIP, strips", COMPRESSION_ADOBE_DEFLATE, 0, 8 },
    [BENCH_TIFF_JPEG] = { "TIFF JPEG, tiles", COMPRESSION_JPEG, 256, 8 },
    [BENCH_JPEG] = { "JPEG", 0, 0, 8 },
    [BENCH_PNG] = { "PNG", 0, 0, 8 },
};

const char *bench_format_name(enum bench_format format)
{
    return KIND[format].name;
}

unsigned bench_format_bits(enum bench_format format)
{
    return KIND[format].bits;
}

/* ---- TIFF -------------------------------------------------------------------------------- */

static uint32_t least(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

static void copy_tile(const struct gsn_image *image, uint32_t x, uint32_t y, uint32_t side,
                      uint8_t *tile)
{
    const size_t pixel = image->channels * image->bits / 8;

    memset(tile, 255, pixel * side * side);
    for (uint32_t i = 0; i < least(side, image->height - y); i++)
        memcpy(tile + pixel * side * i,
               (const uint8_t *)image->samples + pixel * ((size_t)(y + i) * image->width + x),
               pixel * least(side, image->width - x));
}

static int write_pieces(TIFF *tiff, const struct gsn_image *image, uint32_t side)
{
    static uint8_t tile[6 * LARGEST_TILE * LARGEST_TILE];
    const size_t row = gsn_image_bytes(image) / image->height;
    int ok = 1;

    if (!side) {
        for (uint32_t y = 0, s = 0; y < image->height && ok; y += ROWS_PER_STRIP, s++)
            ok = TIFFWriteEncodedStrip(
                     tiff, s, (uint8_t *)image->samples + y * row,
                     (tmsize_t)(least(ROWS_PER_STRIP, image->height - y) * row)) >= 0;
        return ok;
    }
    for (uint32_t y = 0; y < image->height; y += side)
        for (uint32_t x = 0; x < image->width && ok; x += side) {
            copy_tile(image, x, y, side, tile);
            ok = TIFFWriteTile(tiff, tile, x, y, 0, 0) >= 0;
        }
    return ok;
}

/* gives: the same picture at 16 bits. */
static struct gsn_image *widened(const struct gsn_image *image)
{
    struct gsn_image *wide = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_image_new(image->width, image->height, 3, 16, &wide, &err), &err, "panel");
    for (size_t i = 0; i < gsn_image_bytes(image); i++)
        ((uint16_t *)wide->samples)[i] = (uint16_t)(257 * ((const uint8_t *)image->samples)[i]);
    return wide;
}

static int write_tiff(enum bench_format format, const struct gsn_image *image, const char *path)
{
    const uint16_t compression = KIND[format].compression;
    TIFF *tiff = TIFFOpen(path, "w");
    int ok;

    if (!tiff)
        return 0;
    (void)TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, image->width);
    (void)TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, image->height);
    (void)TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, KIND[format].bits);
    (void)TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 3);
    (void)TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG);
    (void)TIFFSetField(tiff, TIFFTAG_COMPRESSION, compression);
    (void)TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC,
                       compression == COMPRESSION_JPEG ? PHOTOMETRIC_YCBCR : PHOTOMETRIC_RGB);
    if (compression == COMPRESSION_JPEG) {
        (void)TIFFSetField(tiff, TIFFTAG_JPEGQUALITY, 90);
        (void)TIFFSetField(tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
    }
    if (compression == COMPRESSION_LZW || compression == COMPRESSION_ADOBE_DEFLATE)
        (void)TIFFSetField(tiff, TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL);
    if (KIND[format].tile) {
        (void)TIFFSetField(tiff, TIFFTAG_TILEWIDTH, KIND[format].tile);
        (void)TIFFSetField(tiff, TIFFTAG_TILELENGTH, KIND[format].tile);
    } else {
        (void)TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, ROWS_PER_STRIP);
    }
    if (KIND[format].bits == 16) {
        gsn_auto(gsn_image) wide = widened(image);

        ok = write_pieces(tiff, wide, KIND[format].tile);
    } else {
        ok = write_pieces(tiff, image, KIND[format].tile);
    }
    TIFFClose(tiff);
    return ok;
}

static int read_tiles(TIFF *tiff, uint32_t width, uint32_t height, enum bench_format format,
                      uint8_t *bytes)
{
    static uint8_t tile[6 * LARGEST_TILE * LARGEST_TILE];
    const uint32_t side = KIND[format].tile;
    const size_t pixel = 3 * KIND[format].bits / 8;

    for (uint32_t y = 0; y < height; y += side)
        for (uint32_t x = 0; x < width; x += side) {
            const uint32_t rows = least(side, height - y), columns = least(side, width - x);

            if (TIFFReadTile(tiff, tile, x, y, 0, 0) < 0)
                return 0;
            for (uint32_t i = 0; i < rows; i++)
                memcpy(bytes + pixel * ((size_t)(y + i) * width + x), tile + pixel * side * i,
                       pixel * columns);
        }
    return 1;
}

static int read_tiff(enum bench_format format, const char *path, uint8_t *bytes)
{
    TIFF *tiff = TIFFOpen(path, "r");
    uint32_t width = 0, height = 0;
    int ok = 1;

    if (!tiff)
        return 0;
    (void)TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &width);
    (void)TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &height);
    if (KIND[format].compression == COMPRESSION_JPEG)
        (void)TIFFSetField(tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
    if (KIND[format].tile) {
        ok = read_tiles(tiff, width, height, format, bytes);
    } else {
        const size_t strip = (size_t)TIFFStripSize(tiff);

        for (uint32_t i = 0; i < TIFFNumberOfStrips(tiff) && ok; i++)
            ok = TIFFReadEncodedStrip(tiff, i, bytes + i * strip, -1) >= 0;
    }
    TIFFClose(tiff);
    return ok;
}

/* ---- JPEG, PNG --------------------------------------------------------------------------- */

static int write_jpeg(const struct gsn_image *image, const char *path)
{
    FILE *file = fopen(path, "wb");
    struct jpeg_compress_struct info;
    struct jpeg_error_mgr errors;

    if (!file)
        return 0;
    info.err = jpeg_std_error(&errors);
    jpeg_create_compress(&info);
    jpeg_stdio_dest(&info, file);
    info.image_width = image->width;
    info.image_height = image->height;
    info.input_components = 3;
    info.in_color_space = JCS_RGB;
    jpeg_set_defaults(&info);
    jpeg_set_quality(&info, 90, TRUE);
    jpeg_start_compress(&info, TRUE);
    while (info.next_scanline < info.image_height) {
        JSAMPROW row = (uint8_t *)image->samples + 3 * (size_t)info.next_scanline * image->width;

        (void)jpeg_write_scanlines(&info, &row, 1);
    }
    jpeg_finish_compress(&info);
    jpeg_destroy_compress(&info);
    return fclose(file) == 0;
}

static int read_jpeg(const char *path, uint8_t *bytes)
{
    FILE *file = fopen(path, "rb");
    struct jpeg_decompress_struct info;
    struct jpeg_error_mgr errors;

    if (!file)
        return 0;
    info.err = jpeg_std_error(&errors);
    jpeg_create_decompress(&info);
    jpeg_stdio_src(&info, file);
    (void)jpeg_read_header(&info, TRUE);
    (void)jpeg_start_decompress(&info);
    while (info.output_scanline < info.output_height) {
        JSAMPROW row = bytes + 3 * (size_t)info.output_scanline * info.output_width;

        (void)jpeg_read_scanlines(&info, &row, 1);
    }
    (void)jpeg_finish_decompress(&info);
    jpeg_destroy_decompress(&info);
    return fclose(file) == 0;
}

static int write_png(const struct gsn_image *image, const char *path)
{
    png_image info = { .version = PNG_IMAGE_VERSION,
                       .width = image->width,
                       .height = image->height,
                       .format = PNG_FORMAT_RGB,
                       .flags = PNG_IMAGE_FLAG_FAST };

    return png_image_write_to_file(&info, path, 0, image->samples, 0, NULL);
}

static int read_png(const char *path, uint8_t *bytes)
{
    png_image info = { .version = PNG_IMAGE_VERSION };

    if (!png_image_begin_read_from_file(&info, path))
        return 0;
    info.format = PNG_FORMAT_RGB;
    return png_image_finish_read(&info, NULL, bytes, 0, NULL);
}

int bench_format_write(enum bench_format format, const struct gsn_image *image, const char *path)
{
    return format == BENCH_JPEG  ? write_jpeg(image, path)
           : format == BENCH_PNG ? write_png(image, path)
                                 : write_tiff(format, image, path);
}

int bench_format_read(enum bench_format format, const char *path, uint8_t *bytes)
{
    return format == BENCH_JPEG  ? read_jpeg(path, bytes)
           : format == BENCH_PNG ? read_png(path, bytes)
                                 : read_tiff(format, path, bytes);
}
