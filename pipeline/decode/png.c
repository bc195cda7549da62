/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* PNG by libpng. Only the critical chunks are left to the library; of the others the few that
 * matter here are read below, so that a bad colour profile neither costs memory nor a scan. */
#include "pipeline/decode/raster.h"
#include "pipeline/decode/icc.h"
#include "pipeline/decode/exif.h"

#include <setjmp.h>
#include <string.h>

#include <png.h>
#include <zlib.h>

struct reader {
    png_structp png;
    png_infop info;
    struct gsn_bytes file;
    size_t at;
    uint32_t row; /* 0 until the first row was asked for, then 1-based */
    struct gsn_raster_layout layout;
    struct gsn_raster canvas;
    struct gsn_exif exif;
    uint8_t *samples; /* one row */
    int alpha;        /* behind the colours of each pixel */
    int starved;      /* an allocation failed */
    int code;
    struct gsn_error *err;
};

static png_voidp on_alloc(png_structp png, png_alloc_size_t size)
{
    struct reader *reader = png_get_mem_ptr(png);
    void *memory = gsn_alloc(size);

    if (!memory)
        reader->starved = 1;
    return memory;
}

static void on_free(png_structp png, png_voidp memory)
{
    (void)png;
    gsn_free(memory);
}

__attribute__((noreturn)) static void on_error(png_structp png, png_const_charp said)
{
    struct reader *reader = png_get_error_ptr(png);

    if (reader->starved)
        reader->code = gsn_fail(reader->err, GSN_E_NOMEM, "out of memory while decoding PNG");
    else if (reader->code == GSN_OK && reader->row)
        reader->code = gsn_fail(
            reader->err, GSN_E_INPUT, "corrupt PNG in row %u of %u, before byte %zu of %zu: %s",
            reader->row, reader->layout.height, reader->at, reader->file.size, said);
    else if (reader->code == GSN_OK)
        reader->code = gsn_fail(reader->err, GSN_E_INPUT,
                                "corrupt PNG in the header, before byte %zu of %zu: %s", reader->at,
                                reader->file.size, said);
    png_longjmp(png, 1);
}

/* Warnings concern chunks without bearing on the samples; those with bearing are made errors. */
static void on_warning(png_structp png, png_const_charp said)
{
    (void)png;
    (void)said;
}

static void on_read(png_structp png, png_bytep to, size_t count)
{
    struct reader *reader = png_get_io_ptr(png);

    if (count > reader->file.size - reader->at) {
        if (reader->row)
            reader->code = gsn_fail(reader->err, GSN_E_INPUT,
                                    "truncated PNG: the data end in row %u of %u, at byte %zu; "
                                    "copy or scan it again",
                                    reader->row, reader->layout.height, reader->file.size);
        else
            reader->code = gsn_fail(reader->err, GSN_E_INPUT,
                                    "truncated PNG: the data end in the header, at byte %zu; copy "
                                    "or scan it again",
                                    reader->file.size);
        png_error(png, "truncated");
    }
    memcpy(to, reader->file.at + reader->at, count);
    reader->at += count;
}

static void set_up(struct reader *reader)
{
    static const uint8_t wanted[] = "iCCP\0sRGB\0gAMA\0pHYs\0eXIf";
    png_structp png = reader->png;

    png_set_read_fn(png, reader, on_read);
    png_set_crc_action(png, PNG_CRC_ERROR_QUIT, PNG_CRC_ERROR_QUIT);
    png_set_benign_errors(png, 0);
    png_set_user_limits(png, PNG_UINT_31_MAX, PNG_UINT_31_MAX);
    png_set_chunk_cache_max(png, 64);
    png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_NEVER, NULL, -1);
    png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_ALWAYS, wanted, (int)sizeof wanted / 5);
    png_set_keep_unknown_chunks(png, PNG_HANDLE_CHUNK_AS_DEFAULT, (const uint8_t *)"tRNS", 1);
}

/* The chunk of this name that has at least size bytes, or NULL. */
static const png_unknown_chunk *find_chunk(const struct reader *reader, const char *name,
                                           size_t size)
{
    png_unknown_chunkp chunks = NULL;
    const int count = png_get_unknown_chunks(reader->png, reader->info, &chunks);

    for (int i = 0; i < count; i++)
        if (memcmp(chunks[i].name, name, 4) == 0 && chunks[i].size >= size)
            return &chunks[i];
    return NULL;
}

static void read_exif(struct reader *reader, struct gsn_picture *picture)
{
    const png_unknown_chunk *chunk = find_chunk(reader, "eXIf", 0);

    reader->exif = (struct gsn_exif){ .orientation = 1 };
    if (chunk && !gsn_exif_read(chunk->data, chunk->size, &reader->exif))
        gsn_picture_remark(picture, "EXIF unreadable, upright as stored");
}

static void read_pitch(const struct reader *reader, struct gsn_picture *picture)
{
    const png_unknown_chunk *chunk = find_chunk(reader, "pHYs", 9);

    gsn_picture_pitch(picture, reader->exif.per_unit_x, reader->exif.per_unit_y,
                      reader->exif.unit_um);
    if (chunk && chunk->data[8] == PNG_RESOLUTION_METER)
        gsn_picture_pitch(picture, png_get_uint_32(chunk->data), png_get_uint_32(chunk->data + 4),
                          1e6);
}

/* A name, a zero, the method 0, and the profile as zlib packed it. */
static void read_profile(const png_unknown_chunk *chunk, struct gsn_picture *picture)
{
    const uint8_t *zero = memchr(chunk->data, 0, chunk->size);
    const size_t head = zero ? (size_t)(zero - chunk->data) + 2 : chunk->size;
    uLongf size = GSN_ICC_MOST_BYTES + 1;
    gsn_auto_mem(uint8_t) whole = picture->wants_profile ? gsn_alloc_array(size, 1) : NULL;

    if (whole && (head >= chunk->size || uncompress(whole, &size, chunk->data + head,
                                                    (uLong)(chunk->size - head)) != Z_OK))
        size = 0;
    gsn_icc_keep(picture, whole, whole ? size : 1);
}

static enum gsn_transfer read_transfer(const struct reader *reader, struct gsn_picture *picture)
{
    const png_unknown_chunk *gamma = find_chunk(reader, "gAMA", 4);
    const uint32_t exponent = gamma ? png_get_uint_32(gamma->data) : 0;

    if (find_chunk(reader, "iCCP", 0)) {
        read_profile(find_chunk(reader, "iCCP", 0), picture);
        return GSN_TRANSFER_ICC;
    }
    if (find_chunk(reader, "sRGB", 0) || exponent == 45455)
        return GSN_TRANSFER_SRGB;
    if (exponent == 100000)
        return GSN_TRANSFER_LINEAR;
    return reader->exif.is_srgb ? GSN_TRANSFER_SRGB : GSN_TRANSFER_UNKNOWN;
}

static void set_conversions(struct reader *reader, unsigned colour, struct gsn_picture *picture)
{
    const uint16_t probe = 1;

    if (colour == PNG_COLOR_TYPE_PALETTE) {
        png_set_palette_to_rgb(reader->png);
        gsn_picture_remark(picture, "palette expanded");
    }
    if (png_get_valid(reader->png, reader->info, PNG_INFO_tRNS))
        png_set_tRNS_to_alpha(reader->png);
    reader->alpha =
        (colour & PNG_COLOR_MASK_ALPHA) || png_get_valid(reader->png, reader->info, PNG_INFO_tRNS);
    if (reader->alpha)
        gsn_picture_remark(picture, "alpha ignored");
    if (reader->layout.bits == 16 && *(const uint8_t *)&probe == 1)
        png_set_swap(reader->png); /* PNG is big-endian */
}

static int read_header(struct reader *reader, const struct gsn_decode_limits *limits,
                       struct gsn_picture *picture)
{
    struct gsn_raster_layout *layout = &reader->layout;
    unsigned colour, bits;

    png_read_info(reader->png, reader->info);
    colour = png_get_color_type(reader->png, reader->info);
    bits = png_get_bit_depth(reader->png, reader->info);
    if (bits < 8 && colour != PNG_COLOR_TYPE_PALETTE)
        return gsn_fail(reader->err, GSN_E_UNSUPPORTED,
                        "a PNG of %u bit per sample: scan again as 8 or 16 bit", bits);
    read_exif(reader, picture);
    read_pitch(reader, picture);
    picture->transfer = read_transfer(reader, picture);
    layout->width = png_get_image_width(reader->png, reader->info);
    layout->height = png_get_image_height(reader->png, reader->info);
    layout->channels = colour & PNG_COLOR_MASK_COLOR ? 3 : 1;
    layout->bits = bits == 16 ? 16 : 8;
    layout->orientation = reader->exif.orientation;
    set_conversions(reader, colour, picture);
    return gsn_raster_open(&reader->canvas, layout, limits, picture, reader->err);
}

static void read_row(struct reader *reader, struct gsn_run run)
{
    void *const straight = run.step == 1 && run.count == reader->layout.width && !reader->alpha
                               ? gsn_raster_row(&reader->canvas, run.y)
                               : NULL;

    reader->row = run.y + 1;
    run.channels = reader->layout.channels;
    run.stride = run.channels + (reader->alpha ? 1 : 0);
    run.alpha = reader->alpha;
    if (straight) {
        png_read_row(reader->png, straight, NULL);
        return;
    }
    png_read_row(reader->png, reader->samples, NULL);
    gsn_raster_put(&reader->canvas, &run, reader->samples);
}

/* The seven sub-pictures of Adam7: first column and row, then the steps from one to the next. */
static const struct pass {
    uint32_t x, y, dx, dy;
} passes[7] = { { 0, 0, 8, 8 }, { 4, 0, 8, 8 }, { 0, 4, 4, 8 }, { 2, 0, 4, 4 },
                { 0, 2, 2, 4 }, { 1, 0, 2, 2 }, { 0, 1, 1, 2 } };

/* They arrive one after the other and go straight to their places. */
static void read_interlaced(struct reader *reader)
{
    const struct gsn_raster_layout *layout = &reader->layout;

    for (size_t i = 0; i < 7; i++) {
        const struct pass *pass = &passes[i];

        if (layout->width <= pass->x)
            continue; /* libpng skips a pass without columns, too */
        for (uint64_t y = pass->y; y < layout->height; y += pass->dy)
            read_row(reader,
                     (struct gsn_run){ .x = pass->x,
                                       .y = (uint32_t)y,
                                       .step = pass->dx,
                                       .count = (layout->width - pass->x - 1) / pass->dx + 1 });
    }
}

static int read_rows(struct reader *reader)
{
    const struct gsn_raster_layout *layout = &reader->layout;
    const png_unknown_chunk *late;
    struct gsn_exif exif;

    png_read_update_info(reader->png, reader->info);
    /* libpng writes a whole row even for a sub-picture of fewer columns. */
    reader->samples = gsn_alloc(png_get_rowbytes(reader->png, reader->info));
    if (!reader->samples)
        return gsn_fail(reader->err, GSN_E_NOMEM, "out of memory while decoding PNG");
    if (png_get_interlace_type(reader->png, reader->info) == PNG_INTERLACE_NONE)
        for (uint32_t y = 0; y < layout->height; y++)
            read_row(reader, (struct gsn_run){ .y = y, .step = 1, .count = layout->width });
    else
        read_interlaced(reader);
    png_read_end(reader->png, reader->info);

    late = find_chunk(reader, "eXIf", 0);
    if (late && gsn_exif_read(late->data, late->size, &exif) &&
        exif.orientation != layout->orientation)
        return gsn_fail(reader->err, GSN_E_UNSUPPORTED,
                        "a PNG that states its orientation behind the pixels: save it upright");
    return GSN_OK;
}

/* Alone with setjmp(): nothing that lives here changes after it. */
static int read_guarded(struct reader *reader, const struct gsn_decode_limits *limits,
                        struct gsn_picture *picture)
{
    int r;

    if (setjmp(png_jmpbuf(reader->png)))
        return reader->code;
    set_up(reader);
    r = read_header(reader, limits, picture);
    return r < 0 ? r : read_rows(reader);
}

int gsn_png_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                   struct gsn_picture *picture, struct gsn_error *err)
{
    struct reader reader = { .file = file, .err = err };
    int r = GSN_E_NOMEM;

    reader.png = png_create_read_struct_2(PNG_LIBPNG_VER_STRING, &reader, on_error, on_warning,
                                          &reader, on_alloc, on_free);
    reader.info = reader.png ? png_create_info_struct(reader.png) : NULL;
    if (reader.info)
        r = read_guarded(&reader, limits, picture);
    else
        (void)gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding PNG");
    png_destroy_read_struct(&reader.png, &reader.info, NULL);
    gsn_free(reader.samples);
    /* libpng goes on without some of its tables; then we do not know what was left out. */
    if (r >= 0 && reader.starved)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding PNG");
    return r;
}
