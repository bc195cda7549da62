/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Pictures as JPEG, by libjpeg-turbo into memory.
 *
 * The transform is the slow integer one, which gives the same bytes with and without vector
 * instructions. The room is what libjpeg-turbo's documentation bounds a file of this size by, so
 * that its destination never asks for more. libjpeg's way out is longjmp: the function that calls
 * it owns nothing. The caller's pixels cannot be wrong: running out of memory is all that can fail.
 */
#include "pipeline/decode/jpeg_write.h"

#include <math.h>
#include <setjmp.h>
#include <stdio.h>

#include <jpeglib.h> /* wants <stdio.h> before it */

enum { UNIT_INCH = 1, UNIT_CM = 2 };

/* libjpeg's way out, and where it writes. */
struct writer {
    struct jpeg_error_mgr error;
    jmp_buf out;
    uint8_t *bytes;
    unsigned long size;
};

__attribute__((noreturn)) static void give_up(j_common_ptr jpeg)
{
    longjmp(((struct writer *)jpeg->client_data)->out, 1);
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

/* Alone with setjmp(): nothing that lives here changes after it. */
static int write_guarded(j_compress_ptr jpeg, struct writer *writer, const struct gsn_image *image,
                         const struct gsn_jpeg_style *style)
{
    if (setjmp(writer->out))
        return -1;
    jpeg_create_compress(jpeg);
    jpeg_mem_dest(jpeg, &writer->bytes, &writer->size);
    jpeg->image_width = image->width;
    jpeg->image_height = image->height;
    jpeg->input_components = 3;
    jpeg->in_color_space = JCS_RGB;
    jpeg_set_defaults(jpeg); /* which subsamples the colours 4:2:0 */
    jpeg_set_quality(jpeg, style->quality, TRUE);
    jpeg->dct_method = JDCT_ISLOW;
    jpeg->optimize_coding = style->smallest ? TRUE : FALSE;
    if (style->px_um > 0)
        set_density(jpeg, style->px_um);
    jpeg_start_compress(jpeg, TRUE);
    if (style->orientation > 1)
        set_orientation(jpeg, style->orientation);
    while (jpeg->next_scanline < jpeg->image_height) {
        JSAMPROW rows[1] = { (JSAMPLE *)image->samples +
                             (size_t)jpeg->next_scanline * image->width * 3 };

        (void)jpeg_write_scanlines(jpeg, rows, 1);
    }
    jpeg_finish_compress(jpeg);
    return 0;
}

/* TJBUFSIZE of 4:2:0: blocks of 16 x 16 pixels at 3 bytes each, and the headers. */
static size_t most_bytes(const struct gsn_image *image)
{
    return ((size_t)image->width + 15) / 16 * 16 * (((size_t)image->height + 15) / 16 * 16) * 3 +
           2048;
}

int gsn_jpeg_encode(const struct gsn_image *image, const struct gsn_jpeg_style *style,
                    uint8_t **ret_bytes, size_t *ret_size, struct gsn_error *err)
{
    struct writer writer = { .size = 0 };
    struct jpeg_compress_struct jpeg = { .err = jpeg_std_error(&writer.error),
                                         .client_data = &writer };
    gsn_auto_mem(uint8_t) room = NULL;
    uint8_t *fitting;
    int r;

    if (image->bits != 8 || image->channels != 3)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "JPEG is written with three channels of 8 bit");
    if (image->width == 0 || image->height == 0 || image->width > JPEG_MAX_DIMENSION ||
        image->height > JPEG_MAX_DIMENSION)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels cannot be written",
                        image->width, image->height);
    writer.error.error_exit = give_up;
    writer.error.output_message = keep_quiet;
    writer.size = most_bytes(image);
    room = gsn_alloc(writer.size);
    writer.bytes = room;
    r = room ? write_guarded(&jpeg, &writer, image, style) : -1;
    jpeg_destroy_compress(&jpeg);
    fitting = r < 0 ? NULL : gsn_realloc_array(room, writer.size, 1);
    if (!fitting)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while writing JPEG");
    (void)gsn_steal(&room);
    *ret_bytes = fitting;
    *ret_size = writer.size;
    return GSN_OK;
}
