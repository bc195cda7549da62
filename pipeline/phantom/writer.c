/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Panels as files: JPEG (also there and back, for pictures that have been one), then PNG and LZW
 * TIFF, each with the pixel size in its resolution tags. The ways out of libjpeg and libpng are
 * longjmp: a function that calls them owns nothing. */
#include "pipeline/phantom/writer.h"

#include <math.h>
#include <png.h>
#include <setjmp.h>
#include <stdio.h>
#include <string.h>
#include <tiffio.h>

#include <jpeglib.h> /* wants <stdio.h> before it */

#include "pipeline/decode/jpeg_write.h"

int gsn_phantom_jpeg(const struct gsn_image *image, double px_um, int quality, int orientation,
                     struct gsn_phantom_buffer *ret_file, struct gsn_error *err)
{
    const struct gsn_jpeg_style style = { .quality = quality,
                                          .px_um = px_um,
                                          .orientation = orientation };
    uint8_t *bytes;
    size_t size;
    const int r = gsn_jpeg_encode(image, &style, &bytes, &size, err);

    if (r < 0)
        return r;
    *ret_file = (struct gsn_phantom_buffer){ .bytes = bytes, .size = size, .room = size };
    return GSN_OK;
}

static void keep_quiet(j_common_ptr jpeg)
{
    (void)jpeg;
}

struct reader {
    struct jpeg_error_mgr error;
    jmp_buf out;
};

static void stop_reading(j_common_ptr jpeg)
{
    struct reader *reader = jpeg->client_data;

    longjmp(reader->out, 1);
}

/* Owns nothing that libjpeg's way out would lose. */
static int decode_image(j_decompress_ptr jpeg, struct reader *reader,
                        const struct gsn_phantom_buffer *file, const struct gsn_image *onto)
{
    if (setjmp(reader->out))
        return -1;
    jpeg_create_decompress(jpeg);
    jpeg_mem_src(jpeg, file->bytes, file->size);
    (void)jpeg_read_header(jpeg, TRUE);
    jpeg->dct_method = JDCT_ISLOW;
    (void)jpeg_start_decompress(jpeg);
    while (jpeg->output_scanline < jpeg->output_height) {
        JSAMPROW rows[1] = { (JSAMPLE *)onto->samples +
                             (size_t)jpeg->output_scanline * onto->width * 3 };

        (void)jpeg_read_scanlines(jpeg, rows, 1);
    }
    (void)jpeg_finish_decompress(jpeg);
    return 0;
}

int gsn_phantom_jpeg_lossy(const struct gsn_image *image, int quality, struct gsn_image **ret_image,
                           struct gsn_error *err)
{
    const double any_px_um = 16;
    gsn_auto_phantom_buffer file = { 0 };
    gsn_auto(gsn_image) back = NULL;
    struct jpeg_decompress_struct jpeg = { 0 };
    struct reader reader;
    int r;

    r = gsn_phantom_jpeg(image, any_px_um, quality, 1, &file, err);
    if (r < 0)
        return r;
    r = gsn_image_new(image->width, image->height, 3, 8, &back, err);
    if (r < 0)
        return r;
    jpeg.err = jpeg_std_error(&reader.error);
    jpeg.err->error_exit = stop_reading;
    jpeg.err->output_message = keep_quiet;
    jpeg.client_data = &reader;
    r = decode_image(&jpeg, &reader, &file, back);
    jpeg_destroy_decompress(&jpeg);
    if (r < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a JPEG file");
    *ret_image = gsn_steal(&back);
    return GSN_OK;
}

enum { ROWS_PER_STRIP = 64 };

static const uint8_t *row_of(const struct gsn_image *image, uint32_t y)
{
    return (const uint8_t *)image->samples + (size_t)y * image->width * 3 * (image->bits / 8);
}

static int check_kind(const struct gsn_image *image, uint32_t most_bits, struct gsn_error *err)
{
    if (image->channels != 3 || image->bits > most_bits)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "panels are written as %u-bit RGB at most",
                        most_bits);
    return GSN_OK;
}

/* --- PNG --- */

static void png_put(png_structp png, png_bytep bytes, png_size_t size)
{
    struct gsn_phantom_buffer *file = png_get_io_ptr(png);

    if (gsn_phantom_buffer_put(file, file->size, bytes, size) < 0)
        png_error(png, "out of memory");
}

static void png_nothing(png_structp png)
{
    (void)png;
}

static void png_fail(png_structp png, png_const_charp text)
{
    (void)text;
    png_longjmp(png, 1);
}

static void png_quiet(png_structp png, png_const_charp text)
{
    (void)png;
    (void)text;
}

/* Owns nothing, so that libpng may jump out of it. */
static int png_encode(png_structp png, png_infop info, const struct gsn_image *image, double px_um,
                      struct gsn_phantom_buffer *file)
{
    const png_uint_32 per_metre = (png_uint_32)lround(1e6 / px_um);

    if (setjmp(png_jmpbuf(png)))
        return -1;
    png_set_write_fn(png, file, png_put, png_nothing);
    png_set_IHDR(png, info, image->width, image->height, 8, PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_pHYs(png, info, per_metre, per_metre, PNG_RESOLUTION_METER);
    png_write_info(png, info);
    for (uint32_t y = 0; y < image->height; y++)
        png_write_row(png, row_of(image, y));
    png_write_end(png, info);
    return 0;
}

int gsn_phantom_png(const struct gsn_image *image, double px_um,
                    struct gsn_phantom_buffer *ret_file, struct gsn_error *err)
{
    gsn_auto_phantom_buffer file = { 0 };
    png_structp png;
    png_infop info;
    int r = check_kind(image, 8, err);

    if (r < 0)
        return r;
    png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, png_fail, png_quiet);
    info = png ? png_create_info_struct(png) : NULL;
    r = info ? png_encode(png, info, image, px_um, &file) : -1;
    png_destroy_write_struct(&png, &info);
    if (r < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PNG file");
    *ret_file = file;
    file = (struct gsn_phantom_buffer){ 0 };
    return GSN_OK;
}

/* --- TIFF --- */

struct tiff_file {
    struct gsn_phantom_buffer buffer;
    size_t at;
};

static tmsize_t tiff_read(thandle_t handle, void *bytes, tmsize_t size)
{
    struct tiff_file *file = handle;
    const size_t left = file->at < file->buffer.size ? file->buffer.size - file->at : 0;
    const size_t count = (size_t)size < left ? (size_t)size : left;

    if (count > 0)
        memcpy(bytes, file->buffer.bytes + file->at, count);
    file->at += count;
    return (tmsize_t)count;
}

static tmsize_t tiff_write(thandle_t handle, void *bytes, tmsize_t size)
{
    struct tiff_file *file = handle;

    if (gsn_phantom_buffer_put(&file->buffer, file->at, bytes, (size_t)size) < 0)
        return 0;
    file->at += (size_t)size;
    return size;
}

static toff_t tiff_seek(thandle_t handle, toff_t offset, int whence)
{
    struct tiff_file *file = handle;

    if (whence == SEEK_SET)
        file->at = offset;
    else if (whence == SEEK_CUR)
        file->at += offset;
    else
        file->at = file->buffer.size + offset;
    return file->at;
}

static toff_t tiff_size(thandle_t handle)
{
    const struct tiff_file *file = handle;

    return file->buffer.size;
}

static int tiff_nothing(thandle_t handle)
{
    (void)handle;
    return 0;
}

static int tiff_quiet(TIFF *tiff, void *context, const char *module, const char *format,
                      va_list args)
{
    (void)tiff;
    (void)context;
    (void)module;
    (void)format;
    (void)args;
    return 1;
}

static TIFF *tiff_open(struct tiff_file *file)
{
    TIFFOpenOptions *options = TIFFOpenOptionsAlloc();
    TIFF *tiff;

    if (!options)
        return NULL;
    TIFFOpenOptionsSetErrorHandlerExtR(options, tiff_quiet, NULL);
    TIFFOpenOptionsSetWarningHandlerExtR(options, tiff_quiet, NULL);
    /* Little endian whatever the machine: same arguments, same bytes. */
    tiff = TIFFClientOpenExt("panel", "wl", file, tiff_read, tiff_write, tiff_seek, tiff_nothing,
                             tiff_size, NULL, NULL, options);
    TIFFOpenOptionsFree(options);
    return tiff;
}

static int tiff_encode(TIFF *tiff, const struct gsn_image *image, double px_um)
{
    const double per_cm = 1e4 / px_um;
    int good = TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, image->width) &&
               TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, image->height) &&
               TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, 3) &&
               TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, image->bits) &&
               TIFFSetField(tiff, TIFFTAG_ORIENTATION, ORIENTATION_TOPLEFT) &&
               TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, PLANARCONFIG_CONTIG) &&
               TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, PHOTOMETRIC_RGB) &&
               TIFFSetField(tiff, TIFFTAG_COMPRESSION, COMPRESSION_LZW) &&
               TIFFSetField(tiff, TIFFTAG_PREDICTOR, PREDICTOR_HORIZONTAL) &&
               TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, ROWS_PER_STRIP) &&
               TIFFSetField(tiff, TIFFTAG_RESOLUTIONUNIT, RESUNIT_CENTIMETER) &&
               TIFFSetField(tiff, TIFFTAG_XRESOLUTION, per_cm) &&
               TIFFSetField(tiff, TIFFTAG_YRESOLUTION, per_cm);

    /* By strips: scanline by scanline the predictor would work in the image itself. */
    for (uint32_t y = 0; good && y < image->height; y += ROWS_PER_STRIP) {
        const uint32_t left = image->height - y,
                       rows = left < ROWS_PER_STRIP ? left : ROWS_PER_STRIP;
        const tmsize_t size = (tmsize_t)rows * image->width * 3 * (tmsize_t)(image->bits / 8);

        good = TIFFWriteEncodedStrip(tiff, y / ROWS_PER_STRIP, (void *)(uintptr_t)row_of(image, y),
                                     size) == size;
    }
    return good && TIFFFlush(tiff) == 1 ? 0 : -1;
}

int gsn_phantom_tiff(const struct gsn_image *image, double px_um,
                     struct gsn_phantom_buffer *ret_file, struct gsn_error *err)
{
    struct tiff_file file = { 0 };
    TIFF *tiff;
    int r = check_kind(image, 16, err);

    if (r < 0)
        return r;
    tiff = tiff_open(&file);
    r = tiff ? tiff_encode(tiff, image, px_um) : -1;
    if (tiff)
        TIFFClose(tiff);
    if (r < 0 || file.buffer.failed) {
        gsn_phantom_buffer_done(&file.buffer);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a TIFF file");
    }
    *ret_file = file.buffer;
    return GSN_OK;
}
