/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/writer.h"

#include <math.h>
#include <setjmp.h>
#include <stdio.h>

#include <jpeglib.h>

enum { CHUNK = 1 << 16, UNIT_INCH = 1, UNIT_CM = 2 };

/* libjpeg's destination and its way out, with ours behind them. */
struct sink {
    struct jpeg_destination_mgr destination;
    struct jpeg_error_mgr error;
    jmp_buf out;
    struct gsn_phantom_buffer *file;
    JOCTET chunk[CHUNK];
};

static void sink_open(j_compress_ptr jpeg)
{
    struct sink *sink = (struct sink *)jpeg->dest;

    sink->destination.next_output_byte = sink->chunk;
    sink->destination.free_in_buffer = CHUNK;
}

static void put_bytes(struct sink *sink, size_t size)
{
    if (gsn_phantom_buffer_put(sink->file, sink->file->size, sink->chunk, size) < 0)
        longjmp(sink->out, 1);
}

static boolean sink_flush(j_compress_ptr jpeg)
{
    put_bytes((struct sink *)jpeg->dest, CHUNK);
    sink_open(jpeg);
    return TRUE;
}

static void sink_close(j_compress_ptr jpeg)
{
    struct sink *sink = (struct sink *)jpeg->dest;

    put_bytes(sink, CHUNK - sink->destination.free_in_buffer);
}

static void give_up(j_common_ptr jpeg)
{
    struct sink *sink = jpeg->client_data;

    longjmp(sink->out, 1);
}

static void keep_quiet(j_common_ptr jpeg)
{
    (void)jpeg;
}

/* JFIF has whole numbers only: the unit that comes nearer to the pixel size is taken. */
static void set_density(j_compress_ptr jpeg, double px_um)
{
    const double per_cm = 1e4 / px_um, per_inch = 25400 / px_um;
    const int in_cm = fabs(round(per_cm) / per_cm - 1) <= fabs(round(per_inch) / per_inch - 1);

    jpeg->density_unit = in_cm ? UNIT_CM : UNIT_INCH;
    jpeg->X_density = jpeg->Y_density = (UINT16)lround(in_cm ? per_cm : per_inch);
}

/* The marker of EXIF with the orientation and nothing else: a TIFF header of one entry. */
static void set_orientation(j_compress_ptr jpeg, int orientation)
{
    JOCTET exif[] = { 'E',  'x', 'i', 'f', 0, 0, 'I', 'I', 42,   0, 8, 0, 0, 0, 1, 0,
                      0x12, 1,   3,   0,   1, 0, 0,   0,   0xff, 0, 0, 0, 0, 0, 0, 0 };

    exif[24] = (JOCTET)orientation;
    jpeg_write_marker(jpeg, JPEG_APP0 + 1, exif, sizeof exif);
}

/* Owns nothing that libjpeg's way out would lose. */
static int encode_image(j_compress_ptr jpeg, struct sink *sink, const struct gsn_image *image,
                        double px_um, int quality, int orientation)
{
    if (setjmp(sink->out))
        return -1;
    jpeg_create_compress(jpeg);
    jpeg->dest = &sink->destination;
    jpeg->image_width = image->width;
    jpeg->image_height = image->height;
    jpeg->input_components = 3;
    jpeg->in_color_space = JCS_RGB;
    jpeg_set_defaults(jpeg); /* which subsamples the colours 4:2:0 */
    jpeg_set_quality(jpeg, quality, TRUE);
    jpeg->dct_method = JDCT_ISLOW; /* the same bytes with and without vector instructions */
    set_density(jpeg, px_um);
    jpeg_start_compress(jpeg, TRUE);
    if (orientation != 1)
        set_orientation(jpeg, orientation);
    while (jpeg->next_scanline < jpeg->image_height) {
        const JSAMPLE *row =
            (const JSAMPLE *)image->samples + (size_t)jpeg->next_scanline * image->width * 3;
        JSAMPROW rows[1] = { (JSAMPROW)(uintptr_t)row };

        (void)jpeg_write_scanlines(jpeg, rows, 1);
    }
    jpeg_finish_compress(jpeg);
    return 0;
}

int gsn_phantom_jpeg(const struct gsn_image *image, double px_um, int quality, int orientation,
                     struct gsn_phantom_buffer *ret_file, struct gsn_error *err)
{
    gsn_auto_phantom_buffer file = { 0 };
    gsn_auto_mem(struct sink) sink = NULL;
    struct jpeg_compress_struct jpeg = { 0 };
    int r;

    if (image->channels != 3 || image->bits != 8)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "panels are written as 8-bit RGB only");
    sink = gsn_alloc_array(1, sizeof *sink);
    if (!sink)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a JPEG file");
    sink->file = &file;
    sink->destination.init_destination = sink_open;
    sink->destination.empty_output_buffer = sink_flush;
    sink->destination.term_destination = sink_close;
    jpeg.err = jpeg_std_error(&sink->error);
    jpeg.err->error_exit = give_up;
    jpeg.err->output_message = keep_quiet;
    jpeg.client_data = sink;
    r = encode_image(&jpeg, sink, image, px_um, quality, orientation);
    jpeg_destroy_compress(&jpeg);
    if (r < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a JPEG file");
    *ret_file = file;
    file = (struct gsn_phantom_buffer){ 0 };
    return GSN_OK;
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
