/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* JPEG by libjpeg-turbo. The library repairs what it can and says so in a warning; here every
 * warning is a refusal, and data that end early are never continued with filler. */
#include "pipeline/decode/raster.h"
#include "pipeline/decode/icc.h"
#include "pipeline/decode/exif.h"
#include "pipeline/decode/frame_notes.h"

#include <setjmp.h>
#include <stdio.h>
#include <string.h>

#include <jerror.h>
#include <jpeglib.h>

/* Progressive scans of real encoders are about ten; a file of thousands only costs time. */
enum { MOST_SCANS = 100, ROWS_AT_ONCE = 16 };

struct reader {
    struct jpeg_decompress_struct info; /* client_data points back here */
    struct jpeg_error_mgr errors;
    struct jpeg_source_mgr source;
    struct jpeg_progress_mgr progress;
    jmp_buf out;
    struct gsn_bytes file;
    struct gsn_raster canvas;
    enum { IN_HEADER, IN_ROWS, IN_SCANS } stage;
    uint8_t *row;
    int code;
    struct gsn_error *err;
};

/* "in row 12 of 128", "in scan 3" or "in the header": where reading has got to. */
static void say_place(const struct reader *reader, char *text, size_t size)
{
    const struct jpeg_decompress_struct *info = &reader->info;

    if (reader->stage == IN_HEADER)
        (void)snprintf(text, size, "in the header");
    else if (reader->stage == IN_SCANS)
        (void)snprintf(text, size, "in scan %d", info->input_scan_number);
    else
        (void)snprintf(text, size, "in row %u of %u", info->output_scanline + 1,
                       info->image_height);
}

static int code_of(int message)
{
    switch (message) {
    case JERR_OUT_OF_MEMORY:
        return GSN_E_NOMEM;
    case JERR_NO_BACKING_STORE:
        return GSN_E_LIMIT;
    case JERR_ARITH_NOTIMPL:
    case JERR_BAD_PRECISION:
    case JERR_CCIR601_NOTIMPL:
    case JERR_CONVERSION_NOTIMPL:
    case JERR_FRACT_SAMPLE_NOTIMPL:
    case JERR_NOT_COMPILED:
    case JERR_SOF_UNSUPPORTED:
        return GSN_E_UNSUPPORTED;
    default:
        return GSN_E_INPUT;
    }
}

__attribute__((noreturn)) static void leave(j_common_ptr info)
{
    struct reader *reader = info->client_data;
    char said[JMSG_LENGTH_MAX], where[48];

    info->err->format_message(info, said);
    say_place(reader, where, sizeof where);
    reader->code = code_of(info->err->msg_code);
    if (reader->code == GSN_E_NOMEM)
        (void)gsn_fail(reader->err, reader->code, "out of memory while decoding JPEG");
    else if (reader->code == GSN_E_LIMIT)
        (void)gsn_fail(reader->err, reader->code,
                       "a progressive JPEG of %u x %u pixels needs more memory than the limit: "
                       "save it as baseline JPEG",
                       reader->info.image_width, reader->info.image_height);
    else if (reader->code == GSN_E_UNSUPPORTED)
        (void)gsn_fail(reader->err, reader->code,
                       "a JPEG of a kind that is not read (%s): scan again as 8-bit grey or RGB",
                       said);
    else
        (void)gsn_fail(reader->err, reader->code, "corrupt JPEG %s, at byte %zu of %zu: %s", where,
                       reader->file.size - reader->source.bytes_in_buffer, reader->file.size, said);
    longjmp(reader->out, 1);
}

static void on_message(j_common_ptr info, int level)
{
    if (level < 0)
        leave(info);
}

static void on_print(j_common_ptr info)
{
    (void)info;
}

static void source_open(j_decompress_ptr info)
{
    (void)info;
}

static boolean source_fill(j_decompress_ptr info)
{
    struct reader *reader = info->client_data;
    char where[48];

    say_place(reader, where, sizeof where);
    reader->code = gsn_fail(reader->err, GSN_E_INPUT,
                            "truncated JPEG: the data end %s, at byte %zu; copy or scan it again",
                            where, reader->file.size);
    longjmp(reader->out, 1);
}

static void source_skip(j_decompress_ptr info, long count)
{
    struct jpeg_source_mgr *source = info->src;

    if (count <= 0)
        return;
    if ((size_t)count > source->bytes_in_buffer)
        (void)source_fill(info);
    source->next_input_byte += count;
    source->bytes_in_buffer -= (size_t)count;
}

static void on_progress(j_common_ptr info)
{
    struct reader *reader = info->client_data;

    if (reader->info.input_scan_number <= MOST_SCANS)
        return;
    reader->code = gsn_fail(reader->err, GSN_E_LIMIT, "a JPEG of more than %d scans", MOST_SCANS);
    longjmp(reader->out, 1);
}

static void set_up(struct reader *reader)
{
    reader->info.err = jpeg_std_error(&reader->errors);
    reader->info.client_data = reader;
    reader->errors.error_exit = leave;
    reader->errors.emit_message = on_message;
    reader->errors.output_message = on_print;
    jpeg_create_decompress(&reader->info);
    reader->source = (struct jpeg_source_mgr){ .next_input_byte = reader->file.at,
                                               .bytes_in_buffer = reader->file.size,
                                               .init_source = source_open,
                                               .fill_input_buffer = source_fill,
                                               .skip_input_data = source_skip,
                                               .resync_to_restart = jpeg_resync_to_restart,
                                               .term_source = source_open };
    reader->info.src = &reader->source;
    reader->progress.progress_monitor = on_progress;
    reader->info.progress = &reader->progress;
    jpeg_save_markers(&reader->info, JPEG_APP0 + 1, 0xffff);
    jpeg_save_markers(&reader->info, JPEG_APP0 + 2, 0xffff);
}

/* The n-th kind of application data by its signature, or NULL. */
static const struct jpeg_marker_struct *find_marker(const struct reader *reader, int marker,
                                                    const char *signature, size_t size)
{
    const struct jpeg_marker_struct *m = reader->info.marker_list;

    while (m &&
           (m->marker != marker || m->data_length < size || memcmp(m->data, signature, size) != 0))
        m = m->next;
    return m;
}

static void read_exif(const struct reader *reader, struct gsn_picture *picture,
                      struct gsn_exif *ret_exif)
{
    const struct jpeg_marker_struct *m = find_marker(reader, JPEG_APP0 + 1, "Exif\0", 6);

    *ret_exif = (struct gsn_exif){ .orientation = 1 };
    if (m && !gsn_exif_read(m->data + 6, m->data_length - 6, ret_exif))
        gsn_picture_remark(picture, "EXIF unreadable, upright as stored");
}

static void read_pitch(const struct reader *reader, const struct gsn_exif *exif,
                       struct gsn_picture *picture)
{
    const struct jpeg_decompress_struct *info = &reader->info;

    gsn_picture_pitch(picture, exif->per_unit_x, exif->per_unit_y, exif->unit_um);
    if (info->saw_JFIF_marker && (info->density_unit == 1 || info->density_unit == 2))
        gsn_picture_pitch(picture, info->X_density, info->Y_density,
                          info->density_unit == 1 ? 25400 : 10000);
}

/* A profile comes in up to 255 pieces: "ICC_PROFILE", 0, the piece's number from 1, their count. */
static void read_profile(const struct reader *reader, struct gsn_picture *picture)
{
    gsn_auto_mem(uint8_t) whole =
        picture->wants_profile ? gsn_alloc_array(GSN_ICC_MOST_BYTES + 1, 1) : NULL;
    size_t size = 0;

    for (unsigned piece = 1; whole && piece <= 255; piece++)
        for (const struct jpeg_marker_struct *m = reader->info.marker_list; m; m = m->next) {
            if (m->marker != JPEG_APP0 + 2 || m->data_length <= 14 ||
                memcmp(m->data, "ICC_PROFILE", 12) != 0 || m->data[12] != piece)
                continue;
            if (m->data_length - 14 > GSN_ICC_MOST_BYTES - size) {
                size = GSN_ICC_MOST_BYTES + 1;
                break;
            }
            memcpy(whole + size, m->data + 14, m->data_length - 14);
            size += m->data_length - 14;
            break;
        }
    gsn_icc_keep(picture, whole, whole ? size : 1);
}

static int read_header(struct reader *reader, const struct gsn_decode_limits *limits,
                       struct gsn_picture *picture)
{
    struct jpeg_decompress_struct *info = &reader->info;
    struct gsn_raster_layout layout = { .bits = 8 };
    struct gsn_exif exif;

    (void)jpeg_read_header(info, TRUE);
    if (info->num_components != 1 && info->num_components != 3)
        return gsn_fail(reader->err, GSN_E_UNSUPPORTED,
                        "a JPEG of %d components (%s): scan again as 8-bit grey or RGB",
                        info->num_components, info->num_components == 4 ? "CMYK" : "unknown");
    read_exif(reader, picture, &exif);
    read_pitch(reader, &exif, picture);
    if (find_marker(reader, JPEG_APP0 + 2, "ICC_PROFILE", 12))
        read_profile(reader, picture);
    else if (exif.is_srgb)
        picture->transfer = GSN_TRANSFER_SRGB;
    layout.width = info->image_width;
    layout.height = info->image_height;
    layout.channels = (uint32_t)info->num_components;
    layout.orientation = exif.orientation;
    return gsn_raster_open(&reader->canvas, &layout, limits, picture, reader->err);
}

/* An end marker set too early leaves coefficients that no scan has sent; libjpeg smooths over. */
static int check_complete(const struct reader *reader)
{
    const struct jpeg_decompress_struct *info = &reader->info;
    int missing = 0;

    for (int c = 0; c < info->num_components; c++) {
        missing += info->comp_info[c].quant_table == NULL;
        for (int k = 0; info->coef_bits && k < DCTSIZE2; k++)
            missing += info->coef_bits[c][k] != 0;
    }
    if (missing)
        return gsn_fail(reader->err, GSN_E_INPUT,
                        "truncated JPEG: it ends after %d scans with coefficients missing",
                        info->input_scan_number);
    return GSN_OK;
}

/* Rows as they are stored go where they stay, as many at once as the library has. */
static int read_straight(struct reader *reader)
{
    struct jpeg_decompress_struct *info = &reader->info;

    while (info->output_scanline < info->image_height) {
        const uint32_t y = info->output_scanline, left = info->image_height - y;
        JSAMPROW row[ROWS_AT_ONCE];
        const uint32_t count = left < ROWS_AT_ONCE ? left : ROWS_AT_ONCE;

        for (uint32_t i = 0; i < count; i++)
            row[i] = gsn_raster_row(&reader->canvas, y + i);
        (void)jpeg_read_scanlines(info, row, count);
    }
    return GSN_OK;
}

static int read_turned(struct reader *reader)
{
    struct jpeg_decompress_struct *info = &reader->info;
    const uint32_t channels = (uint32_t)info->num_components;
    JSAMPROW row;

    reader->row = gsn_alloc((size_t)info->image_width * channels);
    if (!reader->row)
        return gsn_fail(reader->err, GSN_E_NOMEM, "out of memory while decoding JPEG");
    row = reader->row;
    for (uint32_t y = 0; y < info->image_height; y++) {
        const struct gsn_run run = {
            .y = y, .step = 1, .count = info->image_width, .channels = channels, .stride = channels
        };

        (void)jpeg_read_scanlines(info, &row, 1);
        gsn_raster_put(&reader->canvas, &run, row);
    }
    return GSN_OK;
}

static int read_rows(struct reader *reader, const struct gsn_decode_limits *limits)
{
    struct jpeg_decompress_struct *info = &reader->info;
    const uint32_t channels = (uint32_t)info->num_components;
    const uint64_t image_bytes = gsn_image_bytes(reader->canvas.image);
    int r;

    reader->stage = jpeg_has_multiple_scans(info) ? IN_SCANS : IN_ROWS;
    info->out_color_space = channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
    info->dct_method = JDCT_ISLOW;
    info->do_block_smoothing = FALSE;
    info->mem->max_memory_to_use = (long)(limits->most_bytes - image_bytes + GSN_DECODE_WORK_BYTES);
    (void)jpeg_start_decompress(info);
    r = check_complete(reader);
    if (r < 0)
        return r;
    r = gsn_raster_row(&reader->canvas, 0) ? read_straight(reader) : read_turned(reader);
    if (r < 0)
        return r;
    (void)jpeg_finish_decompress(info);
    return GSN_OK;
}

/* Alone with setjmp(): nothing that lives here changes after it. */
static int read_guarded(struct reader *reader, const struct gsn_decode_limits *limits,
                        struct gsn_picture *picture)
{
    int r;

    if (setjmp(reader->out))
        return reader->code;
    set_up(reader);
    r = read_header(reader, limits, picture);
    return r < 0 ? r : read_rows(reader, limits);
}

int gsn_jpeg_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                    struct gsn_picture *picture, struct gsn_error *err)
{
    gsn_auto_mem(struct reader) reader = gsn_alloc_array(1, sizeof *reader);
    int r;

    if (!reader)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding JPEG");
    reader->file = file;
    reader->err = err;
    picture->lossy = 1;
    r = read_guarded(reader, limits, picture);
    if (r >= 0) {
        const struct gsn_frame_notes notes = gsn_frame_notes_of_jpeg(file);

        gsn_frame_notes_apply(&notes, picture);
    }
    gsn_free(reader->row);
    jpeg_destroy_decompress(&reader->info);
    return r;
}
