/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* TIFF and BigTIFF by libtiff: opening, what the tags state, and what is refused because of them.
 * The pixels are in tiff_pixels.c. */
#include "pipeline/decode/tiff.h"
#include "pipeline/decode/icc.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* --- the file in memory, as libtiff wants it --- */

static tmsize_t on_read(thandle_t handle, void *to, tmsize_t count)
{
    struct gsn_tiff *t = handle;
    const size_t left = t->at < t->file.size ? t->file.size - t->at : 0;
    const size_t take = (size_t)count < left ? (size_t)count : left;

    memcpy(to, t->file.at + (left ? t->at : 0), take);
    t->at += take;
    return (tmsize_t)take;
}

static tmsize_t on_write(thandle_t handle, void *from, tmsize_t count)
{
    (void)handle;
    (void)from;
    (void)count;
    return -1;
}

static toff_t on_seek(thandle_t handle, toff_t to, int whence)
{
    struct gsn_tiff *t = handle;
    const toff_t base = whence == SEEK_CUR ? t->at : whence == SEEK_END ? t->file.size : 0;

    t->at = base + to;
    return t->at;
}

static int on_close(thandle_t handle)
{
    (void)handle;
    return 0;
}

static toff_t on_size(thandle_t handle)
{
    const struct gsn_tiff *t = handle;

    return t->file.size;
}

/* libtiff declares the base writable but only reads through it. */
static int on_map(thandle_t handle, void **ret_base, toff_t *ret_size)
{
    const struct gsn_tiff *t = handle;

    memcpy(ret_base, &t->file.at, sizeof *ret_base);
    *ret_size = t->file.size;
    return 1;
}

static void on_unmap(thandle_t handle, void *base, toff_t size)
{
    (void)handle;
    (void)base;
    (void)size;
}

/* --- what libtiff says --- */

/* Keeps the first complaint; the later ones mostly follow from it. */
static void keep(struct gsn_tiff *t, const char *format, va_list args)
{
    char *consequence;

    if (t->said_code != GSN_OK)
        return;
    (void)vsnprintf(t->said, sizeof t->said, format, args);
    consequence = strstr(t->said, "; tag ignored"); /* not here */
    if (consequence)
        *consequence = '\0';
    t->said_code = GSN_E_INPUT;
    if (strstr(t->said, "byte limit"))
        t->said_code = GSN_E_LIMIT;
    else if (strstr(t->said, "o space") || strstr(t->said, "ut of memory") ||
             strstr(t->said, "ailed to allocate"))
        t->said_code = GSN_E_NOMEM;
}

static int on_error(TIFF *tiff, void *user, const char *module, const char *format, va_list args)
{
    (void)tiff;
    (void)module;
    keep(user, format, args);
    return 1;
}

/* Remarks on tags that have no bearing on the samples. Real scanners write such files daily. */
static int is_harmless(const char *said)
{
    static const char *const harmless[] = { "Unknown field with tag",
                                            "RichTIFFIPTC",
                                            "ASCII value for",
                                            "null byte",
                                            "not sorted",
                                            "Sum of Photometric type-related" };

    for (size_t i = 0; i < sizeof harmless / sizeof harmless[0]; i++)
        if (strstr(said, harmless[i]))
            return 1;
    return 0;
}

static int on_warning(TIFF *tiff, void *user, const char *module, const char *format, va_list args)
{
    struct gsn_tiff *t = user;

    (void)tiff;
    (void)module;
    if (!is_harmless(format))
        keep(t, format, args);
    return 1;
}

/* Fails with what libtiff said first, or with otherwise when it said nothing. */
static int refuse_said(const struct gsn_tiff *t, const char *otherwise, struct gsn_error *err)
{
    if (t->said_code == GSN_E_NOMEM)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding TIFF");
    if (t->said_code == GSN_E_LIMIT)
        return gsn_fail(err, GSN_E_LIMIT, "a TIFF whose tags need too much memory: %s", t->said);
    return gsn_fail(err, GSN_E_INPUT, "corrupt TIFF: %s", t->said_code ? t->said : otherwise);
}

static int open_page(struct gsn_tiff *t, struct gsn_error *err)
{
    TIFFOpenOptions *options = TIFFOpenOptionsAlloc();

    if (!options)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while decoding TIFF");
    TIFFOpenOptionsSetMaxSingleMemAlloc(options, (tmsize_t)GSN_DECODE_WORK_BYTES);
    TIFFOpenOptionsSetErrorHandlerExtR(options, on_error, t);
    TIFFOpenOptionsSetWarningHandlerExtR(options, on_warning, t);
    /* C: never split a strip behind our back. */
    t->tiff = TIFFClientOpenExt("picture", "rC", t, on_read, on_write, on_seek, on_close, on_size,
                                on_map, on_unmap, options);
    TIFFOpenOptionsFree(options);
    if (!t->tiff || t->said_code != GSN_OK)
        return refuse_said(t, "its first page cannot be read", err);
    return GSN_OK;
}

/* --- what the tags state --- */

static void read_tags(struct gsn_tiff *t)
{
    uint16_t *extra = NULL;
    uint16_t *palette[3] = { NULL, NULL, NULL };

    (void)TIFFGetField(t->tiff, TIFFTAG_IMAGEWIDTH, &t->width);
    (void)TIFFGetField(t->tiff, TIFFTAG_IMAGELENGTH, &t->height);
    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_BITSPERSAMPLE, &t->bits);
    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_SAMPLESPERPIXEL, &t->samples);
    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_PLANARCONFIG, &t->planar);
    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_COMPRESSION, &t->compression);
    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_ORIENTATION, &t->orientation);
    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_EXTRASAMPLES, &t->extra, &extra);
    t->alpha = t->extra > 0 && extra && extra[0] != EXTRASAMPLE_UNSPECIFIED;
    if (!TIFFGetField(t->tiff, TIFFTAG_PHOTOMETRIC, &t->photometric))
        t->photometric = UINT16_MAX;
    if (t->photometric == PHOTOMETRIC_PALETTE &&
        TIFFGetField(t->tiff, TIFFTAG_COLORMAP, &palette[0], &palette[1], &palette[2]))
        memcpy(t->palette, palette, sizeof palette);
    if (t->orientation < 1 || t->orientation > 8)
        t->orientation = 1;
}

static int check_compression(const struct gsn_tiff *t, struct gsn_error *err)
{
    switch (t->compression) {
    case COMPRESSION_NONE:
    case COMPRESSION_LZW:
    case COMPRESSION_PACKBITS:
    case COMPRESSION_ADOBE_DEFLATE:
    case COMPRESSION_DEFLATE:
    case COMPRESSION_JPEG:
        return GSN_OK;
    case COMPRESSION_OJPEG:
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a TIFF with old-style JPEG compression: scan again with LZW or JPEG");
    default:
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a TIFF with compression %u: scan again with LZW, Deflate or JPEG",
                        t->compression);
    }
}

static int check_samples(const struct gsn_tiff *t, struct gsn_error *err)
{
    const int is_palette = t->photometric == PHOTOMETRIC_PALETTE;
    uint16_t format = SAMPLEFORMAT_UINT;

    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_SAMPLEFORMAT, &format);
    if (format != SAMPLEFORMAT_UINT && format != SAMPLEFORMAT_VOID)
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a TIFF of %s samples: scan again as 8 or 16 bit grey or RGB",
                        format == SAMPLEFORMAT_INT      ? "signed"
                        : format == SAMPLEFORMAT_IEEEFP ? "floating-point"
                                                        : "complex");
    if (is_palette ? t->bits != 1 && t->bits != 2 && t->bits != 4 && t->bits != 8
                   : t->bits != 8 && t->bits != 16)
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a TIFF of %u bit per sample: scan again as 8 or 16 bit grey or RGB",
                        t->bits);
    return GSN_OK;
}

/* How many samples of a pixel are its colour; 0 for a kind that is not read. */
static unsigned colours(const struct gsn_tiff *t)
{
    switch (t->photometric) {
    case PHOTOMETRIC_MINISBLACK:
    case PHOTOMETRIC_MINISWHITE:
        return 1;
    case PHOTOMETRIC_PALETTE:
        return t->palette[0] ? 1 : 0;
    case PHOTOMETRIC_RGB:
        return 3;
    case PHOTOMETRIC_YCBCR:
        return t->compression == COMPRESSION_JPEG && t->planar == PLANARCONFIG_CONTIG ? 3 : 0;
    default:
        return 0;
    }
}

static const char *photometric_name(uint16_t photometric)
{
    switch (photometric) {
    case PHOTOMETRIC_PALETTE:
        return "palette without a colour map";
    case PHOTOMETRIC_SEPARATED:
        return "CMYK";
    case PHOTOMETRIC_YCBCR:
        return "YCbCr without JPEG";
    case PHOTOMETRIC_CIELAB:
    case PHOTOMETRIC_ICCLAB:
    case PHOTOMETRIC_ITULAB:
        return "Lab";
    case PHOTOMETRIC_LOGL:
    case PHOTOMETRIC_LOGLUV:
        return "LogLuv";
    case PHOTOMETRIC_CFA:
        return "raw mosaic";
    case UINT16_MAX:
        return "unstated";
    default:
        return "unknown";
    }
}

static int check_colours(const struct gsn_tiff *t, struct gsn_error *err)
{
    const unsigned wanted = colours(t);
    /* Samples nobody declared are alpha in practice, one of them at most. */
    const unsigned extra = t->extra > 1 ? t->extra : 1;
    const unsigned most = t->photometric == PHOTOMETRIC_PALETTE ? 1 : wanted + extra;

    if (wanted == 0)
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a TIFF of %s colours: scan again as 8 or 16 bit grey or RGB",
                        photometric_name(t->photometric));
    if (t->samples < wanted || t->samples > most || t->samples > 5)
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a TIFF of %u samples per pixel where %u make the colour: scan again as 8 "
                        "or 16 bit grey or RGB",
                        t->samples, wanted);
    if (t->compression == COMPRESSION_JPEG && t->samples != wanted)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "a TIFF with JPEG compression and alpha");
    return GSN_OK;
}

/* --- how samples relate to light --- */

static double srgb_to_linear(double v)
{
    return v <= 0.04045 ? v / 12.92 : pow((v + 0.055) / 1.055, 2.4);
}

static double straight(double v)
{
    return v;
}

/* Within half an 8-bit step all along. */
static int follows(const uint16_t *curve, size_t count, double (*truth)(double))
{
    for (size_t i = 0; i < count; i++)
        if (fabs(curve[i] / 65535.0 - truth((double)i / (double)(count - 1))) > 0.5 / 255)
            return 0;
    return 1;
}

static enum gsn_transfer read_transfer(const struct gsn_tiff *t, struct gsn_picture *picture)
{
    const size_t count = (size_t)1 << t->bits;
    uint16_t *curve[3] = { NULL, NULL, NULL };
    uint32_t size = 0;
    void *profile = NULL;
    int linear = 1, srgb = 1;

    if (TIFFGetField(t->tiff, TIFFTAG_ICCPROFILE, &size, &profile)) {
        gsn_icc_keep(picture, profile, size);
        return GSN_TRANSFER_ICC;
    }
    if (!TIFFGetField(t->tiff, TIFFTAG_TRANSFERFUNCTION, &curve[0], &curve[1], &curve[2]))
        return GSN_TRANSFER_UNKNOWN;
    for (unsigned c = 0; c < 3 && curve[c]; c++) {
        linear = linear && follows(curve[c], count, straight);
        srgb = srgb && follows(curve[c], count, srgb_to_linear);
    }
    return linear ? GSN_TRANSFER_LINEAR : srgb ? GSN_TRANSFER_SRGB : GSN_TRANSFER_UNKNOWN;
}

static void read_pitch(const struct gsn_tiff *t, struct gsn_picture *picture)
{
    float x = 0, y = 0;
    uint16_t unit = RESUNIT_NONE;

    if (t->slide_um > 0) {
        picture->px_um_x = picture->px_um_y = t->slide_um;
        return;
    }
    (void)TIFFGetField(t->tiff, TIFFTAG_XRESOLUTION, &x);
    (void)TIFFGetField(t->tiff, TIFFTAG_YRESOLUTION, &y);
    (void)TIFFGetFieldDefaulted(t->tiff, TIFFTAG_RESOLUTIONUNIT, &unit);
    if (unit == RESUNIT_INCH || unit == RESUNIT_CENTIMETER)
        gsn_picture_pitch(picture, (double)x, (double)y, unit == RESUNIT_INCH ? 25400 : 10000);
    if (!(picture->px_um_x > 0))
        picture->px_um_x = picture->px_um_y = gsn_tiff_aperio_um(t->tiff);
}

/* --- the whole --- */

static int check_page(struct gsn_tiff *t, struct gsn_error *err)
{
    int r;

    read_tags(t);
    r = check_compression(t, err);
    if (r >= 0)
        r = check_samples(t, err);
    return r < 0 ? r : check_colours(t, err);
}

static void remark(const struct gsn_tiff *t, struct gsn_picture *picture)
{
    if (picture->pages > 1 && !(t->slide_um > 0))
        gsn_picture_remark(picture, "page 1 of %u", picture->pages);
    if (t->samples > colours(t))
        gsn_picture_remark(picture, "alpha ignored");
    if (t->photometric == PHOTOMETRIC_PALETTE)
        gsn_picture_remark(picture, "palette expanded");
    if (t->photometric == PHOTOMETRIC_MINISWHITE)
        gsn_picture_remark(picture, "inverted: 0 is white");
}

static int decode_page(struct gsn_tiff *t, const struct gsn_decode_limits *limits,
                       struct gsn_picture *picture, struct gsn_error *err)
{
    const int is_palette = t->photometric == PHOTOMETRIC_PALETTE;
    const struct gsn_raster_layout layout = { .width = t->width,
                                              .height = t->height,
                                              .channels = is_palette ? 3 : colours(t),
                                              .bits = is_palette ? 8 : t->bits,
                                              .orientation = t->orientation };
    struct gsn_raster canvas;
    int r;

    read_pitch(t, picture);
    picture->transfer = read_transfer(t, picture);
    remark(t, picture);
    r = gsn_raster_open(&canvas, &layout, limits, picture, err);
    if (r < 0)
        return r;
    return gsn_tiff_read_pixels(t, &canvas, err);
}

int gsn_tiff_decode(struct gsn_bytes file, const struct gsn_decode_limits *limits,
                    struct gsn_picture *picture, struct gsn_error *err)
{
    struct gsn_tiff t = { .file = file };
    int r;

    r = gsn_tiff_count_pages(file, &picture->pages, err);
    if (r < 0)
        return r;
    r = open_page(&t, err);
    if (r >= 0 && limits->slide)
        r = gsn_tiff_choose_level(&t, limits, picture, err);
    if (r >= 0 && t.said_code != GSN_OK)
        r = refuse_said(&t, "the directory of its level cannot be read", err);
    if (r >= 0)
        r = check_page(&t, err);
    if (r >= 0)
        r = decode_page(&t, limits, picture, err);
    if (t.tiff)
        TIFFClose(t.tiff);
    return r;
}
