/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* PAM (netpbm's P7): grey and colour pictures, and frames of cameras as acquire/frame.h lays them
 * down.
 *
 * Samples of 8 and 16 bits are taken as they are; those of other ranges are stretched to 0..65535,
 * which no two of them share. Y, U and V become 16-bit R', G', B' by the matrix and the range that
 * the frame states, Eq. (1) to (3) below; U and V serve each pixel that shares them, nothing is
 * interpolated. What a YUV triple names outside of RGB is cut at its border.
 *
 * A Bayer frame becomes 16-bit colour by bilinear interpolation: a pixel keeps its own sample, and
 * gets of the other two colours the mean of the samples of that colour among its eight neighbours
 * (at the border: those there are). A plane of colour that rises evenly is given back exactly. */
#include "pipeline/decode/frame_notes.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MOST_HEADER = 65536 };

enum kind { GREY, COLOUR, BGR, YUYV, UYVY, NV12, BAYER };

static const struct type {
    const char *name;
    enum kind kind;
    unsigned depth, alpha;
    unsigned red_x, red_y; /* Bayer: where in a square of four the red one is */
} types[] = {
    { "GRAYSCALE", GREY, 1, 0, 0, 0 },   { "GRAYSCALE_ALPHA", GREY, 2, 1, 0, 0 },
    { "RGB", COLOUR, 3, 0, 0, 0 },       { "RGB_ALPHA", COLOUR, 4, 1, 0, 0 },
    { "BGR", BGR, 3, 0, 0, 0 },          { "YUYV", YUYV, 2, 0, 0, 0 },
    { "UYVY", UYVY, 2, 0, 0, 0 },        { "NV12", NV12, 1, 0, 0, 0 },
    { "BAYER_RGGB", BAYER, 1, 0, 0, 0 }, { "BAYER_GRBG", BAYER, 1, 0, 1, 0 },
    { "BAYER_GBRG", BAYER, 1, 0, 0, 1 }, { "BAYER_BGGR", BAYER, 1, 0, 1, 1 },
};

/* Kr and Kb of a matrix: ITU-R BT.601, BT.709 and BT.2020. */
static const struct matrix {
    const char *name;
    double kr, kb;
} matrices[] = {
    { "BT.601", 0.299, 0.114 },
    { "BT.709", 0.2126, 0.0722 },
    { "BT.2020", 0.2627, 0.0593 },
};

struct reader {
    struct gsn_bytes file;
    size_t at; /* behind the header: of the first sample */
    uint32_t width, height, depth, maxval;
    unsigned seen; /* which lines came, a bit each */
    char tupltype[32];
    const struct type *type;
    const struct matrix *matrix;
    int is_limited;
    struct gsn_frame_notes notes;
    struct gsn_raster_layout layout;
    struct gsn_raster canvas;
};

/* A line "KEY number", once. */
static int read_number(struct reader *reader, const char *line, size_t size, const char *key,
                       unsigned bit, uint32_t *ret_value, struct gsn_error *err)
{
    uint64_t value = 0;
    size_t i = strlen(key);

    while (i < size && (line[i] == ' ' || line[i] == '\t'))
        i++;
    if (i == size || reader->seen & 1U << bit)
        return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: %s without a number, or twice", key);
    for (; i < size && value <= UINT32_MAX; i++) {
        if (line[i] < '0' || line[i] > '9')
            return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: %s is no number", key);
        value = value * 10 + (uint64_t)(line[i] - '0');
    }
    if (value == 0 || value > UINT32_MAX)
        return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: %s is out of range", key);
    reader->seen |= 1U << bit;
    *ret_value = (uint32_t)value;
    return GSN_OK;
}

static int is_key(const char *line, size_t size, const char *key)
{
    const size_t length = strlen(key);

    return size > length && memcmp(line, key, length) == 0 &&
           (line[length] == ' ' || line[length] == '\t');
}

static int read_tupltype(struct reader *reader, const char *line, size_t size,
                         struct gsn_error *err)
{
    enum { BIT = 4, KEY = 9 };

    if (reader->seen & 1U << BIT)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "a PAM with several lines of TUPLTYPE");
    reader->seen |= 1U << BIT;
    (void)snprintf(reader->tupltype, sizeof reader->tupltype, "%.*s", (int)(size - KEY),
                   line + KEY);
    return GSN_OK;
}

static int read_line(struct reader *reader, const char *line, size_t size, int *begun,
                     struct gsn_error *err)
{
    static const char *const keys[] = { "WIDTH", "HEIGHT", "DEPTH", "MAXVAL" };
    uint32_t *const values[] = { &reader->width, &reader->height, &reader->depth, &reader->maxval };

    if (size == 0)
        return GSN_OK;
    if (line[0] == '#') {
        gsn_frame_notes_line(&reader->notes, begun, line, size);
        return GSN_OK;
    }
    for (unsigned i = 0; i < 4; i++) {
        if (is_key(line, size, keys[i]))
            return read_number(reader, line, size, keys[i], i, values[i], err);
    }
    if (is_key(line, size, "TUPLTYPE"))
        return read_tupltype(reader, line, size, err);
    return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: its header has a line of another kind");
}

static int read_lines(struct reader *reader, struct gsn_error *err)
{
    const struct gsn_bytes file = reader->file;
    const size_t most = file.size < MOST_HEADER ? file.size : MOST_HEADER;
    int begun = 0;

    for (reader->at = 3; reader->at < most;) {
        const char *const line = (const char *)file.at + reader->at;
        const char *const end = memchr(line, '\n', most - reader->at);
        const size_t size = end ? (size_t)(end - line) : 0;
        int r;

        if (!end)
            break;
        reader->at += size + 1;
        if (size == 6 && memcmp(line, "ENDHDR", 6) == 0)
            return GSN_OK;
        r = read_line(reader, line, size, &begun, err);
        if (r < 0)
            return r;
    }
    return gsn_fail(err, GSN_E_INPUT,
                    "truncated PAM: the header has no ENDHDR; take or copy it "
                    "again");
}

static int find_type(struct reader *reader, struct gsn_error *err)
{
    if ((reader->seen & 15U) != 15U)
        return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: WIDTH, HEIGHT, DEPTH or MAXVAL is missing");
    for (size_t i = 0; i < sizeof types / sizeof types[0]; i++) {
        if (strcmp(types[i].name, reader->tupltype) == 0)
            reader->type = &types[i];
    }
    if (!reader->type)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "a PAM of TUPLTYPE \"%s\" is not read",
                        reader->tupltype);
    if (reader->depth != reader->type->depth)
        return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: %s has DEPTH %u, not %u", reader->tupltype,
                        reader->type->depth, reader->depth);
    if (reader->maxval > 65535)
        return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: MAXVAL %u is above 65535", reader->maxval);
    return GSN_OK;
}

static int is_yuv(const struct reader *reader)
{
    return reader->type->kind == YUYV || reader->type->kind == UYVY || reader->type->kind == NV12;
}

/* Without its matrix and range a YUV picture has no colours: none are made up. */
static int find_matrix(struct reader *reader, struct gsn_error *err)
{
    const struct gsn_frame_notes *const notes = &reader->notes;

    for (size_t i = 0; i < sizeof matrices / sizeof matrices[0]; i++) {
        if (strcmp(matrices[i].name, notes->matrix) == 0)
            reader->matrix = &matrices[i];
    }
    reader->is_limited = strcmp(notes->range, "limited") == 0;
    if (!reader->matrix || (!reader->is_limited && strcmp(notes->range, "full") != 0))
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a %s frame of matrix \"%s\" and range \"%s\": its colours are not known",
                        reader->tupltype, notes->matrix, notes->range);
    if (reader->maxval != 255)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "a %s frame with MAXVAL %u", reader->tupltype,
                        reader->maxval);
    return GSN_OK;
}

static int check_shape(const struct reader *reader, struct gsn_error *err)
{
    const uint64_t samples = (uint64_t)reader->width * reader->height;
    const uint64_t per_pixel = (uint64_t)reader->depth * (reader->maxval > 255 ? 2 : 1);
    const uint64_t there = reader->file.size - reader->at;
    const int bad = (is_yuv(reader) && reader->width % 2) ||
                    (reader->type->kind == NV12 && reader->height % 3) ||
                    (reader->type->kind == BAYER && (reader->width < 2 || reader->height < 2));

    if (bad)
        return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: %u x %u samples are no %s picture",
                        reader->width, reader->height, reader->tupltype);
    if (samples > there / per_pixel)
        return gsn_fail(err, GSN_E_INPUT,
                        "truncated PAM: %u x %u pixels of %llu bytes do not fit into the %llu "
                        "behind its header; take or copy it again",
                        reader->width, reader->height, (unsigned long long)per_pixel,
                        (unsigned long long)there);
    if (samples * per_pixel != there)
        return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: %llu bytes follow the picture",
                        (unsigned long long)(there - samples * per_pixel));
    return GSN_OK;
}

static int read_header(struct reader *reader, const struct gsn_decode_limits *limits,
                       struct gsn_picture *picture, struct gsn_error *err)
{
    int r = read_lines(reader, err);

    if (r >= 0)
        r = find_type(reader, err);
    if (r >= 0 && is_yuv(reader))
        r = find_matrix(reader, err);
    if (r >= 0)
        r = check_shape(reader, err);
    if (r < 0)
        return r;
    gsn_frame_notes_apply(&reader->notes, picture);
    if (reader->type->alpha)
        gsn_picture_remark(picture, "alpha ignored");
    if (reader->type->kind == BAYER)
        gsn_picture_remark(picture, "Bayer pattern interpolated");
    if (reader->maxval != 255 && reader->maxval != 65535)
        gsn_picture_remark(picture, "0..%u stretched to 16 bit", reader->maxval);
    reader->layout = (struct gsn_raster_layout){
        .width = reader->width,
        .height = reader->type->kind == NV12 ? reader->height / 3 * 2 : reader->height,
        .channels = reader->type->kind == GREY ? 1 : 3,
        .bits = reader->maxval == 255 && !is_yuv(reader) && reader->type->kind != BAYER ? 8 : 16,
        .orientation = 1,
    };
    return gsn_raster_open(&reader->canvas, &reader->layout, limits, picture, err);
}

/* Sample number i of the file. */
static unsigned read_sample(const struct reader *reader, size_t i)
{
    const uint8_t *const at = reader->file.at + reader->at;

    return reader->maxval > 255 ? (unsigned)at[2 * i] << 8 | at[2 * i + 1] : at[i];
}

/* 0..MAXVAL to 0..65535, rounded. */
static uint16_t stretch_value(const struct reader *reader, unsigned value)
{
    return (uint16_t)(((uint64_t)value * 65535 + reader->maxval / 2) / reader->maxval);
}

static int check_samples(const struct reader *reader, struct gsn_error *err)
{
    const size_t count = (size_t)reader->width * reader->height * reader->depth;

    for (size_t i = 0; i < count && reader->maxval != 255 && reader->maxval != 65535; i++) {
        if (read_sample(reader, i) > reader->maxval)
            return gsn_fail(err, GSN_E_INPUT, "corrupt PAM: a sample of %u is above MAXVAL %u",
                            read_sample(reader, i), reader->maxval);
    }
    return GSN_OK;
}

/* One row of grey or colour; samples are 8 or 16 bit as the layout says. */
static void take_plain(const struct reader *reader, uint32_t y, void *row)
{
    const unsigned channels = reader->layout.channels;
    const size_t first = (size_t)y * reader->width * reader->depth;

    for (size_t x = 0; x < reader->width; x++) {
        for (unsigned c = 0; c < channels; c++) {
            const unsigned from = reader->type->kind == BGR ? 2 - c : c;
            const unsigned value = read_sample(reader, first + x * reader->depth + from);

            if (reader->layout.bits == 8)
                ((uint8_t *)row)[x * channels + c] = (uint8_t)value;
            else
                ((uint16_t *)row)[x * channels + c] = stretch_value(reader, value);
        }
    }
}

static uint16_t code_of(double light)
{
    return (uint16_t)(fmin(fmax(light, 0), 1) * 65535 + 0.5);
}

/* BT.601, BT.709, BT.2020: from luma and colour differences in their coded ranges to 0..1. */
static void put_yuv(const struct reader *reader, unsigned y, unsigned u, unsigned v, uint16_t *to)
{
    const double kr = reader->matrix->kr, kb = reader->matrix->kb, kg = 1 - kr - kb;
    const double luma = reader->is_limited ? ((double)y - 16) / 219 : y / 255.0;
    const double scale = reader->is_limited ? 224 : 255;
    const double pb = ((double)u - 128) / scale, pr = ((double)v - 128) / scale;

    to[0] = code_of(luma + 2 * (1 - kr) * pr);                                         /* Eq. (1) */
    to[1] = code_of(luma - 2 * kr * (1 - kr) / kg * pr - 2 * kb * (1 - kb) / kg * pb); /* Eq. (2) */
    to[2] = code_of(luma + 2 * (1 - kb) * pb);                                         /* Eq. (3) */
}

static void take_yuv(const struct reader *reader, uint32_t y, uint16_t *row)
{
    const uint8_t *const all = reader->file.at + reader->at;
    const size_t width = reader->width, height = reader->layout.height;

    for (size_t x = 0; x < width; x++) {
        const uint8_t *const pair = all + (y * width + x / 2 * 2) * 2;
        const uint8_t *const shared = all + (height + y / 2) * width + x / 2 * 2;

        if (reader->type->kind == YUYV)
            put_yuv(reader, pair[x % 2 * 2], pair[1], pair[3], row + 3 * x);
        else if (reader->type->kind == UYVY)
            put_yuv(reader, pair[x % 2 * 2 + 1], pair[0], pair[2], row + 3 * x);
        else
            put_yuv(reader, all[y * width + x], shared[0], shared[1], row + 3 * x);
    }
}

/* Red 0, green 1, blue 2. */
static unsigned colour_at(const struct reader *reader, uint32_t x, uint32_t y)
{
    return ((x + reader->type->red_x) % 2) + ((y + reader->type->red_y) % 2);
}

static void put_bayer(const struct reader *reader, uint32_t x, uint32_t y, uint16_t *to)
{
    const unsigned own = colour_at(reader, x, y);
    uint64_t sum[3] = { 0 }, count[3] = { 0 };

    for (uint32_t ny = y ? y - 1 : 0; ny <= y + 1 && ny < reader->height; ny++) {
        for (uint32_t nx = x ? x - 1 : 0; nx <= x + 1 && nx < reader->width; nx++) {
            const unsigned colour = colour_at(reader, nx, ny);

            if (colour == own && (nx != x || ny != y))
                continue;
            sum[colour] += read_sample(reader, (size_t)ny * reader->width + nx);
            count[colour]++;
        }
    }
    for (unsigned c = 0; c < 3; c++) {
        const uint64_t whole = count[c] * reader->maxval;

        to[c] = (uint16_t)((sum[c] * 65535 + whole / 2) / whole);
    }
}

static void take_row(const struct reader *reader, uint32_t y, void *row)
{
    if (is_yuv(reader)) {
        take_yuv(reader, y, row);
        return;
    }
    if (reader->type->kind != BAYER) {
        take_plain(reader, y, row);
        return;
    }
    for (uint32_t x = 0; x < reader->width; x++)
        put_bayer(reader, x, y, (uint16_t *)row + 3 * (size_t)x);
}

int gsn_pam_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                   struct gsn_picture *picture, struct gsn_error *err)
{
    struct reader reader = { .file = file };
    gsn_auto_mem(uint16_t) row = NULL;
    int r = read_header(&reader, limits, picture, err);

    if (r >= 0)
        r = check_samples(&reader, err);
    if (r < 0)
        return r;
    row = gsn_alloc_array(reader.width, 3 * sizeof *row);
    if (!row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding PAM");
    for (uint32_t y = 0; y < reader.layout.height; y++) {
        const struct gsn_run run = { .y = y,
                                     .step = 1,
                                     .count = reader.width,
                                     .channels = reader.layout.channels,
                                     .stride = reader.layout.channels };

        take_row(&reader, y, row);
        gsn_raster_put(&reader.canvas, &run, row);
    }
    return GSN_OK;
}
