/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* PNG (ISO/IEC 15948) by libpng, with all that may vary fixed: 8 bits, the filter Sub, one level of
 * compression, neither time nor text. libpng leaves by longjmp(), so the function with setjmp()
 * owns nothing; its memory is ours, so that the tests can make it fail.
 *
 * Failure: GSN_E_NOMEM. Cost: that of compressing. */
#include "pipeline/decode/png_write.h"

#include <setjmp.h>
#include <string.h>

#include <png.h>

/* Good enough for pictures of a report; the level is part of what makes the bytes repeat. */
enum { LEVEL = 6 };

struct writer {
    png_structp png;
    png_infop info;
    uint8_t *bytes;
    size_t size, room;
    struct gsn_error *err;
    int code;
};

static png_voidp on_alloc(png_structp png, png_alloc_size_t size)
{
    (void)png;
    return gsn_alloc(size);
}

static void on_free(png_structp png, png_voidp memory)
{
    (void)png;
    gsn_free(memory);
}

/* The caller's pixels cannot be wrong, so running out of memory is all that can happen. */
__attribute__((noreturn)) static void on_error(png_structp png, png_const_charp said)
{
    struct writer *writer = png_get_error_ptr(png);

    writer->code = gsn_fail(writer->err, GSN_E_NOMEM, "out of memory while writing PNG: %s", said);
    png_longjmp(png, 1);
}

static void on_warning(png_structp png, png_const_charp said)
{
    (void)png;
    (void)said;
}

static void on_write(png_structp png, png_bytep from, size_t count)
{
    struct writer *writer = png_get_io_ptr(png);

    if (count > writer->room - writer->size) {
        const size_t room = 2 * (writer->room + count);
        uint8_t *bytes = gsn_realloc_array(writer->bytes, room, 1);

        if (!bytes)
            png_error(png, "no room for the file");
        writer->bytes = bytes;
        writer->room = room;
    }
    memcpy(writer->bytes + writer->size, from, count);
    writer->size += count;
}

static void on_flush(png_structp png)
{
    (void)png;
}

/* Alone with setjmp(): nothing that lives here changes after it. */
static int write_guarded(struct writer *writer, const struct gsn_image *image)
{
    const size_t row_bytes = (size_t)image->width * image->channels;

    if (setjmp(png_jmpbuf(writer->png)))
        return writer->code;
    png_set_write_fn(writer->png, writer, on_write, on_flush);
    png_set_user_limits(writer->png, PNG_UINT_31_MAX, PNG_UINT_31_MAX);
    png_set_IHDR(writer->png, writer->info, image->width, image->height, 8,
                 image->channels == 3 ? PNG_COLOR_TYPE_RGB : PNG_COLOR_TYPE_GRAY,
                 PNG_INTERLACE_NONE, PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    png_set_compression_level(writer->png, LEVEL);
    png_set_filter(writer->png, PNG_FILTER_TYPE_BASE, PNG_FILTER_SUB);
    png_write_info(writer->png, writer->info);
    for (uint32_t y = 0; y < image->height; y++)
        png_write_row(writer->png, (const uint8_t *)image->samples + y * row_bytes);
    png_write_end(writer->png, NULL);
    return GSN_OK;
}

int gsn_png_encode(const struct gsn_image *image, uint8_t **ret_bytes, size_t *ret_size,
                   struct gsn_error *err)
{
    struct writer writer = { .err = err };
    int r = GSN_E_NOMEM;

    if (image->bits != 8)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "PNG is written with 8 bit, not %u", image->bits);
    if (image->width == 0 || image->height == 0 || image->width > PNG_UINT_31_MAX ||
        image->height > PNG_UINT_31_MAX)
        return gsn_fail(err, GSN_E_INPUT, "a picture of %u x %u pixels cannot be written",
                        image->width, image->height);
    writer.png = png_create_write_struct_2(PNG_LIBPNG_VER_STRING, &writer, on_error, on_warning,
                                           NULL, on_alloc, on_free);
    writer.info = writer.png ? png_create_info_struct(writer.png) : NULL;
    if (writer.info)
        r = write_guarded(&writer, image);
    else
        (void)gsn_fail(err, GSN_E_NOMEM, "out of memory while writing PNG");
    png_destroy_write_struct(&writer.png, &writer.info);
    if (r < 0) {
        gsn_free(writer.bytes);
        return r;
    }
    *ret_bytes = writer.bytes;
    *ret_size = writer.size;
    return GSN_OK;
}
