/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/phantom/writer.h"

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

static void put(struct sink *sink, size_t size)
{
    if (gsn_phantom_buffer_put(sink->file, sink->file->size, sink->chunk, size) < 0)
        longjmp(sink->out, 1);
}

static boolean sink_flush(j_compress_ptr jpeg)
{
    put((struct sink *)jpeg->dest, CHUNK);
    sink_open(jpeg);
    return TRUE;
}

static void sink_close(j_compress_ptr jpeg)
{
    struct sink *sink = (struct sink *)jpeg->dest;

    put(sink, CHUNK - sink->destination.free_in_buffer);
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

/* Owns nothing that libjpeg's way out would lose. */
static int encode(j_compress_ptr jpeg, struct sink *sink, const struct gsn_image *image,
                  double px_um, int quality)
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
    while (jpeg->next_scanline < jpeg->image_height) {
        const JSAMPLE *row =
            (const JSAMPLE *)image->samples + (size_t)jpeg->next_scanline * image->width * 3;
        JSAMPROW rows[1] = { (JSAMPROW)(uintptr_t)row };

        (void)jpeg_write_scanlines(jpeg, rows, 1);
    }
    jpeg_finish_compress(jpeg);
    return 0;
}

int gsn_phantom_jpeg(const struct gsn_image *image, double px_um, int quality,
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
    r = encode(&jpeg, sink, image, px_um, quality);
    jpeg_destroy_compress(&jpeg);
    if (r < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a JPEG file");
    *ret_file = file;
    file = (struct gsn_phantom_buffer){ 0 };
    return GSN_OK;
}
