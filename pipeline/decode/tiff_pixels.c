/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pixels of one page of a TIFF, from its strips or tiles to the canvas.
 *
 * Steps: (1) every strip or tile lies in the file; (2) a piece that is stored as it is needed (not
 * compressed, in this processor's byte order) is put from where it lies in the file; (3) else
 * libtiff decodes it: whole strips straight into the picture where they may stay as they are,
 * otherwise row by row or tile by tile; (4) what is white at 0 is inverted, a palette becomes RGB,
 * planes that are separate go to their channel one after the other. JPEG in YCbCr is converted by
 * libjpeg. Reference: TIFF 6.0 (Adobe, 1992).
 *
 * Failure: GSN_E_INPUT with the place of the piece and libtiff's complaint, a warning too: no
 * sample is made up. GSN_E_LIMIT for pieces too large, GSN_E_NOMEM. Cost: that of decoding, and one
 * row or tile of memory. */
#include "pipeline/decode/tiff_internal.h"

/* The pixels of one page on their way from libtiff to the canvas. */
struct pixels {
    struct gsn_tiff *t;
    const struct gsn_raster *canvas;
    uint8_t *piece;  /* one stored row, or one tile */
    uint8_t *colour; /* one palette row expanded to RGB; NULL without a palette */
    int old_palette; /* the colour map holds 8-bit values in its 16-bit places */
};

/* Every strip or tile must lie in the file before anything is decoded, so that a truncated file is
 * refused at once and with the place. */
static int check_pieces(struct gsn_tiff *t, struct gsn_error *err)
{
    const int tiled = TIFFIsTiled(t->tiff);
    const uint32_t count = tiled ? TIFFNumberOfTiles(t->tiff) : TIFFNumberOfStrips(t->tiff);
    const char *what = tiled ? "tile" : "strip";

    for (uint32_t i = 0; i < count; i++) {
        int wrong = 0;
        const uint64_t at = TIFFGetStrileOffsetWithErr(t->tiff, i, &wrong);
        const uint64_t size = wrong ? 0 : TIFFGetStrileByteCountWithErr(t->tiff, i, &wrong);

        if (wrong || at == 0 || size == 0)
            return gsn_fail(err, GSN_E_INPUT, "corrupt TIFF: %s %u of %u has no place in the file",
                            what, i + 1, count);
        if (at > t->file.size || size > t->file.size - at)
            return gsn_fail(err, GSN_E_INPUT,
                            "truncated TIFF: %s %u of %u, at byte %llu, is to hold %llu bytes, the "
                            "file ends at %zu; copy or scan it again",
                            what, i + 1, count, (unsigned long long)at, (unsigned long long)size,
                            t->file.size);
    }
    return GSN_OK;
}

/* libtiff failed, or warned, in the stored row or tile that begins at (x, y). */
static int refuse_piece(const struct gsn_tiff *t, uint32_t x, uint32_t y, struct gsn_error *err)
{
    if (t->said_code == GSN_E_NOMEM)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding TIFF");
    return gsn_fail(err, t->said_code == GSN_E_LIMIT ? GSN_E_LIMIT : GSN_E_INPUT,
                    "corrupt TIFF near column %u, row %u of %u x %u: %s", x + 1, y + 1, t->width,
                    t->height, t->said_code ? t->said : "the data cannot be decoded");
}

static unsigned read_packed(const uint8_t *row, uint32_t x, unsigned bits)
{
    const size_t at = (size_t)x * bits;

    return row[at / 8] >> (8 - bits - at % 8) & ((1u << bits) - 1);
}

/* The samples of strip or tile number index where they lie in the file, of which they are bytes
 * many; NULL where libtiff has to make them: it unpacks, swaps and says what is wrong with sizes.
 * Uncompressed panels are most of what scanners write, and a second copy is a third of the time. */
static const uint8_t *stored(const struct gsn_tiff *t, uint32_t index, uint64_t bytes)
{
    const uint8_t *at = t->file.at + TIFFGetStrileOffset(t->tiff, index);
    uint16_t order = FILLORDER_MSB2LSB;

    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_FILLORDER, &order);
    if (t->compression != COMPRESSION_NONE || order != FILLORDER_MSB2LSB ||
        t->photometric == PHOTOMETRIC_MINISWHITE || TIFFGetStrileByteCount(t->tiff, index) != bytes)
        return NULL;
    if (t->bits == 16 && (TIFFIsByteSwapped(t->tiff) || (uintptr_t)at % sizeof(uint16_t) != 0))
        return NULL;
    return at;
}

static void expand_row(const struct pixels *p, const uint8_t *row, uint32_t count)
{
    const struct gsn_tiff *t = p->t;

    for (uint32_t x = 0; x < count; x++) {
        const unsigned index = read_packed(row, x, t->bits);

        for (unsigned c = 0; c < 3; c++)
            p->colour[3 * (size_t)x + c] =
                (uint8_t)(p->old_palette ? t->palette[c][index] : t->palette[c][index] >> 8);
    }
}

/* The complement of a sample of 8 or 16 bits is that of its bytes. */
static void invert_samples(uint8_t *piece, size_t bytes)
{
    for (size_t i = 0; i < bytes; i++)
        piece[i] = (uint8_t)~piece[i];
}

/* A strip or a tile, or what of it lies in the picture. */
struct part {
    uint32_t x, y, width, height;
    uint16_t plane; /* counts when planes are separate */
};

/* Puts the part's decoded samples, a row of them row_bytes after the other. */
static void put_part(const struct pixels *p, const struct part *part, size_t row_bytes,
                     const uint8_t *samples)
{
    const struct gsn_tiff *t = p->t;
    const int contiguous = t->planar == PLANARCONFIG_CONTIG;
    struct gsn_run run = { .x = part->x, .y = part->y, .step = 1, .count = part->width };

    if (p->colour) {
        run.channels = run.stride = 3;
        for (uint32_t i = 0; i < part->height; i++, run.y++) {
            expand_row(p, samples + i * row_bytes, part->width);
            gsn_raster_put(p->canvas, &run, p->colour);
        }
        return;
    }
    run.channel = contiguous ? 0 : part->plane;
    run.channels = contiguous ? p->canvas->image->channels : 1;
    run.stride = contiguous ? t->samples : 1;
    run.alpha = contiguous && t->alpha && t->samples > run.channels;
    gsn_raster_put_rows(p->canvas, &run, part->height, row_bytes, samples);
}

/* Whether stored samples are the picture's own, so that whole strips may go where they stay. */
static int is_plain(const struct pixels *p)
{
    const struct gsn_tiff *t = p->t;
    const struct gsn_image *image = p->canvas->image;

    return t->planar == PLANARCONFIG_CONTIG && !p->colour && t->samples == image->channels &&
           t->bits == image->bits && t->photometric != PHOTOMETRIC_MINISWHITE &&
           gsn_raster_row(p->canvas, 0) &&
           TIFFScanlineSize64(t->tiff) == gsn_image_bytes(image) / image->height;
}

/* libtiff is fastest with whole strips. */
static int read_whole(const struct pixels *p, const struct part *part, struct gsn_error *err)
{
    struct gsn_tiff *t = p->t;
    const tmsize_t bytes = (tmsize_t)(part->height * TIFFScanlineSize64(t->tiff));

    if (TIFFReadEncodedStrip(t->tiff, TIFFComputeStrip(t->tiff, part->y, 0),
                             gsn_raster_row(p->canvas, part->y), bytes) != bytes ||
        t->said_code != GSN_OK)
        return refuse_piece(t, 0, part->y, err);
    return GSN_OK;
}

/* Row by row, so that a picture in a single strip needs no second copy. */
static int read_rows(const struct pixels *p, const struct part *part, struct gsn_error *err)
{
    struct gsn_tiff *t = p->t;
    const size_t bytes = (size_t)TIFFScanlineSize(t->tiff);
    struct part row = *part;

    row.height = 1;
    for (; row.y < part->y + part->height; row.y++) {
        if (TIFFReadScanline(t->tiff, p->piece, row.y, row.plane) < 0 || t->said_code != GSN_OK)
            return refuse_piece(t, 0, row.y, err);
        if (t->photometric == PHOTOMETRIC_MINISWHITE)
            invert_samples(p->piece, bytes);
        put_part(p, &row, bytes, p->piece);
    }
    return GSN_OK;
}

static uint32_t smaller_of(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

static int read_strips(const struct pixels *p, uint16_t plane, struct gsn_error *err)
{
    struct gsn_tiff *t = p->t;
    const uint64_t row_bytes = TIFFScanlineSize64(t->tiff);
    const int plain = is_plain(p);
    uint32_t rows = 0;
    int r = GSN_OK;

    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_ROWSPERSTRIP, &rows);
    rows = rows == 0 || rows > t->height ? t->height : rows;
    for (uint32_t y = 0; y < t->height && r >= 0; y += smaller_of(rows, t->height - y)) {
        const struct part part = { 0, y, t->width, smaller_of(rows, t->height - y), plane };
        const uint8_t *const there =
            stored(t, TIFFComputeStrip(t->tiff, y, plane), part.height * row_bytes);

        if (there)
            put_part(p, &part, (size_t)row_bytes, there);
        else
            r = plain ? read_whole(p, &part, err) : read_rows(p, &part, err);
    }
    return r;
}

/* The samples of the tile that holds (x, y), in the file or in p->piece; NULL where libtiff fails
 * or warns. */
static const uint8_t *read_tile(const struct pixels *p, uint32_t x, uint32_t y, uint16_t plane)
{
    struct gsn_tiff *t = p->t;
    const uint64_t bytes = TIFFTileSize64(t->tiff);
    const uint8_t *const there = stored(t, TIFFComputeTile(t->tiff, x, y, 0, plane), bytes);

    if (there)
        return there;
    if (TIFFReadTile(t->tiff, p->piece, x, y, 0, plane) < 0 || t->said_code != GSN_OK)
        return NULL;
    if (t->photometric == PHOTOMETRIC_MINISWHITE)
        invert_samples(p->piece, (size_t)bytes);
    return p->piece;
}

static int read_tiles(const struct pixels *p, uint16_t plane, struct gsn_error *err)
{
    struct gsn_tiff *t = p->t;
    const size_t row_bytes = (size_t)TIFFTileRowSize(t->tiff);
    uint32_t wide = 0, high = 0;

    (void)TIFFGetField(t->tiff, TIFFTAG_TILEWIDTH, &wide);
    (void)TIFFGetField(t->tiff, TIFFTAG_TILELENGTH, &high);
    if (wide == 0 || high == 0)
        return gsn_fail(err, GSN_E_INPUT, "corrupt TIFF: tiles of %u x %u pixels", wide, high);
    for (uint64_t y = 0; y < t->height; y += high)
        for (uint64_t x = 0; x < t->width; x += wide) {
            const uint32_t left = (uint32_t)x, top = (uint32_t)y;
            const struct part part = { left, top, smaller_of(wide, t->width - left),
                                       smaller_of(high, t->height - top), plane };
            const uint8_t *const tile = read_tile(p, left, top, plane);

            if (!tile)
                return refuse_piece(t, left, top, err);
            put_part(p, &part, row_bytes, tile);
        }
    return GSN_OK;
}

static int read_planes(const struct pixels *p, struct gsn_error *err)
{
    const struct gsn_tiff *t = p->t;
    const int separate = t->planar == PLANARCONFIG_SEPARATE && t->samples > 1;
    const uint16_t planes = separate ? (uint16_t)p->canvas->image->channels : 1;
    int r = GSN_OK;

    for (uint16_t s = 0; s < planes && r >= 0; s++)
        r = TIFFIsTiled(t->tiff) ? read_tiles(p, s, err) : read_strips(p, s, err);
    return r;
}

static int is_old_palette(const struct gsn_tiff *t)
{
    for (unsigned c = 0; c < 3; c++)
        for (unsigned i = 0; i < 1u << t->bits; i++)
            if (t->palette[c][i] > 255)
                return 0;
    return 1;
}

int gsn_tiff_read_pixels(struct gsn_tiff *t, const struct gsn_raster *canvas, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) piece = NULL;
    gsn_auto_mem(uint8_t) colour = NULL;
    const int is_palette = t->palette[0] != NULL;
    uint64_t size;
    int r;

    /* libtiff then converts subsampled YCbCr itself, with libjpeg's own filter. */
    if (t->photometric == PHOTOMETRIC_YCBCR)
        (void)TIFFSetField(t->tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
    r = check_pieces(t, err);
    if (r < 0)
        return r;
    size = TIFFIsTiled(t->tiff) ? TIFFTileSize64(t->tiff) : TIFFScanlineSize64(t->tiff);
    if (size == 0 || t->said_code != GSN_OK)
        return refuse_piece(t, 0, 0, err);
    if (size > GSN_DECODE_PIECE_BYTES)
        return gsn_fail(err, GSN_E_LIMIT,
                        "a TIFF of rows or tiles of %llu bytes: write smaller tiles",
                        (unsigned long long)size);
    piece = gsn_alloc((size_t)size);
    /* A tile may be wider than the picture, but never more of it is put than the picture's width.
     */
    if (is_palette)
        colour = gsn_alloc_array(t->width, 3);
    if (!piece || (is_palette && !colour))
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding TIFF");

    return read_planes(&(struct pixels){ .t = t,
                                         .canvas = canvas,
                                         .piece = piece,
                                         .colour = colour,
                                         .old_palette = is_palette && is_old_palette(t) },
                       err);
}
