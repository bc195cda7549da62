/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures as JPEG, by libjpeg into memory that grows.
 *
 * The transform is the slow integer one, which gives the same bytes with and without vector
 * instructions. libjpeg's way out is longjmp, so the function that calls it owns nothing. The
 * caller's pixels cannot be wrong: running out of memory is all that can fail. */
#include "pipeline/decode/jpeg_write.h"

#include <setjmp.h>
#include <stdio.h>

#include <jpeglib.h> /* wants <stdio.h> before it */

enum { FIRST_ROOM = 1 << 14 };

/* libjpeg's destination and its way out, with ours behind them. */
struct sink {
    struct jpeg_destination_mgr destination;
    struct jpeg_error_mgr error;
    jmp_buf out;
    uint8_t *bytes;
    size_t size, room;
};

__attribute__((noreturn)) static void give_up(j_common_ptr jpeg)
{
    longjmp(((struct sink *)jpeg->client_data)->out, 1);
}

static void keep_quiet(j_common_ptr jpeg)
{
    (void)jpeg;
}

static void offer_room(struct sink *sink)
{
    sink->destination.next_output_byte = sink->bytes + sink->size;
    sink->destination.free_in_buffer = sink->room - sink->size;
}

static void open_sink(j_compress_ptr jpeg)
{
    offer_room(jpeg->client_data);
}

/* Is called when all room is used. */
static boolean grow_sink(j_compress_ptr jpeg)
{
    struct sink *const sink = jpeg->client_data;
    uint8_t *const bytes = gsn_realloc_array(sink->bytes, 2 * sink->room, 1);

    if (!bytes)
        longjmp(sink->out, 1);
    sink->bytes = bytes;
    sink->size = sink->room;
    sink->room *= 2;
    offer_room(sink);
    return TRUE;
}

static void close_sink(j_compress_ptr jpeg)
{
    struct sink *const sink = jpeg->client_data;

    sink->size = sink->room - sink->destination.free_in_buffer;
}

/* Alone with setjmp(): nothing that lives here changes after it. */
static int write_guarded(j_compress_ptr jpeg, struct sink *sink, const struct gsn_image *image,
                         int quality)
{
    if (setjmp(sink->out))
        return -1;
    jpeg_create_compress(jpeg);
    jpeg->dest = &sink->destination;
    jpeg->image_width = image->width;
    jpeg->image_height = image->height;
    jpeg->input_components = 3;
    jpeg->in_color_space = JCS_RGB;
    jpeg_set_defaults(jpeg);
    jpeg_set_quality(jpeg, quality, TRUE);
    jpeg->dct_method = JDCT_ISLOW;
    jpeg->optimize_coding = TRUE;
    jpeg_start_compress(jpeg, TRUE);
    while (jpeg->next_scanline < jpeg->image_height) {
        JSAMPROW rows[1] = { (JSAMPLE *)image->samples +
                             (size_t)jpeg->next_scanline * image->width * 3 };

        (void)jpeg_write_scanlines(jpeg, rows, 1);
    }
    jpeg_finish_compress(jpeg);
    return 0;
}

int gsn_jpeg_encode(const struct gsn_image *image, int quality, uint8_t **ret_bytes,
                    size_t *ret_size, struct gsn_error *err)
{
    struct sink sink = { .destination = { .init_destination = open_sink,
                                          .empty_output_buffer = grow_sink,
                                          .term_destination = close_sink },
                         .room = FIRST_ROOM };
    struct jpeg_compress_struct jpeg = { .err = jpeg_std_error(&sink.error), .client_data = &sink };
    int r;

    if (image->bits != 8 || image->channels != 3)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "JPEG is written with three channels of 8 bit");
    if (image->width == 0 || image->height == 0 || image->width > JPEG_MAX_DIMENSION ||
        image->height > JPEG_MAX_DIMENSION)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels cannot be written",
                        image->width, image->height);
    sink.error.error_exit = give_up;
    sink.error.output_message = keep_quiet;
    sink.bytes = gsn_alloc(sink.room);
    r = sink.bytes ? write_guarded(&jpeg, &sink, image, quality) : -1;
    jpeg_destroy_compress(&jpeg);
    if (r < 0) {
        gsn_free(sink.bytes);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while writing JPEG");
    }
    *ret_bytes = sink.bytes;
    *ret_size = sink.size;
    return GSN_OK;
}
