/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* TIFF and BigTIFF by libtiff: pages, slides, what the tags state and what is refused for them.
 *
 * Method: the file is in memory and libtiff reads it through callbacks that cannot leave it. Pages
 * are counted by walking the chain of directories without the library, which would follow a chain
 * that turns back on itself. A slide is the levels of a pyramid in one file, as OpenSlide's
 * "aperio" and "generic-tiff" have them. Reference: TIFF 6.0 (Adobe, 1992); BigTIFF (libtiff);
 * Aperio's ImageDescription.
 *
 * Steps: (1) count the pages; (2) open the page or the level that the caller wants; (3) read the
 * tags that change what pixels mean, refuse what is not supported by name; (4) the pixels
 * (tiff_pixels.c).
 *
 * Failure: GSN_E_INPUT, GSN_E_LIMIT with the first complaint of libtiff; warnings are kept, not
 * shown. Cost: that of decoding; nothing is copied before. */
#include "pipeline/core/srgb.h"
#include "pipeline/decode/icc.h"
#include "pipeline/decode/tiff_internal.h"
#include "pipeline/decode/volume_internal.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* --- pages --- */

enum { MOST_PAGES = 1024 };

/* Classic and BigTIFF differ in these widths only. */
struct chain {
    struct gsn_bytes file;
    int big_endian;
    unsigned offset_size, count_size, entry_size;
};

static uint64_t get_number(const struct chain *chain, uint64_t at, unsigned bytes)
{
    uint64_t value = 0;

    for (unsigned i = 0; i < bytes; i++) {
        const uint64_t from = chain->big_endian ? at + i : at + bytes - 1 - i;

        value = value << 8 | chain->file.at[from];
    }
    return value;
}

static int lies_inside(const struct chain *chain, uint64_t at, uint64_t count)
{
    return at <= chain->file.size && count <= chain->file.size - at;
}

/* Where the directory behind the one at this offset begins; 0 behind the last. */
static int next_page(const struct chain *chain, unsigned page, uint64_t at, uint64_t *ret_next,
                     struct gsn_error *err)
{
    uint64_t count;

    if (!lies_inside(chain, at, chain->count_size))
        return gsn_fail(err, GSN_E_INPUT,
                        "truncated TIFF: page %u is to begin at byte %llu, the file ends at %zu; "
                        "copy or scan it again",
                        page, (unsigned long long)at, chain->file.size);
    count = get_number(chain, at, chain->count_size);
    if (count > chain->file.size ||
        !lies_inside(chain, at, chain->count_size + count * chain->entry_size + chain->offset_size))
        return gsn_fail(err, GSN_E_INPUT,
                        "truncated TIFF: the directory of page %u, at byte %llu, is to hold %llu "
                        "entries, the file ends at %zu",
                        page, (unsigned long long)at, (unsigned long long)count, chain->file.size);
    *ret_next =
        get_number(chain, at + chain->count_size + count * chain->entry_size, chain->offset_size);
    return GSN_OK;
}

static int refuse_loop(const uint64_t *seen, unsigned count, uint64_t next, struct gsn_error *err)
{
    for (unsigned i = 0; i < count; i++)
        if (seen[i] == next)
            return gsn_fail(err, GSN_E_INPUT,
                            "corrupt TIFF: page %u of its chain is followed by page %u again",
                            count, i + 1);
    return GSN_OK;
}

static int walk_chain(const struct chain *chain, uint64_t at, unsigned *ret_pages,
                      struct gsn_error *err)
{
    uint64_t seen[MOST_PAGES];
    unsigned pages = 0;
    int r;

    while (at != 0) {
        if (pages == MOST_PAGES)
            return gsn_fail(err, GSN_E_LIMIT, "a TIFF of more than %d pages", MOST_PAGES);
        seen[pages++] = at;
        r = next_page(chain, pages, at, &at, err);
        if (r < 0)
            return r;
        r = refuse_loop(seen, pages, at, err);
        if (r < 0)
            return r;
    }
    if (pages == 0)
        return gsn_fail(err, GSN_E_INPUT, "a TIFF without a page");
    *ret_pages = pages;
    return GSN_OK;
}

/* Counts the pages by walking the chain of directories, without libtiff.
 *
 * Fails with GSN_E_INPUT when a directory lies beyond the end or the chain turns back on itself,
 * and with GSN_E_LIMIT beyond 1024 pages. */
static int count_pages(struct gsn_bytes file, unsigned *ret_pages, struct gsn_error *err)
{
    struct chain chain = { file, file.at[0] == 'M', 4, 2, 12 };
    uint64_t first = 4;

    if (get_number(&chain, 2, 2) == 43) {
        chain = (struct chain){ file, chain.big_endian, 8, 8, 20 };
        first = 8;
    }
    if (!lies_inside(&chain, first, chain.offset_size))
        return gsn_fail(err, GSN_E_INPUT,
                        "truncated TIFF: the file ends in its header, at byte %zu", file.size);
    return walk_chain(&chain, get_number(&chain, first, chain.offset_size), ret_pages, err);
}

/* --- slides --- */

/* Slides: the levels of a pyramid in one TIFF, as OpenSlide's "aperio", "generic-tiff" and
 * "hamamatsu" (NDPI) have them. The finest level is the first page; the others are pages of the
 * same picture made smaller, in tiles; Aperio's thumbnail, label and overview are not tiled, and no
 * levels. NDPI's pages are one JPEG strip each, and a tag of its own tells the levels from the
 * macro image and the map, another the focal planes above and below. */

enum { MOST_LEVELS = 32 };

/* A level's sides are whole pixels, so they keep the shape of the first to a pixel. */
static const double SHAPE_PX = 1.5;
/* Pixels that differ by more than this along the two axes are not square. */
static const double SQUARE = 0.01;

struct level {
    tdir_t page;
    uint32_t width, height;
};

struct slide {
    unsigned count;
    struct level level[MOST_LEVELS]; /* finest first */
};

/* Hamamatsu's own tags, as OpenSlide's openslide-vendor-hamamatsu.c names them: the file is NDPI;
 * magnification of the page's lens, negative for the macro image and the map; its focal plane. */
enum { NDPI_FORMAT = 65420, NDPI_LENS = 65421, NDPI_FOCAL_PLANE = 65424 };

static const char *description(TIFF *tiff)
{
    char *text = NULL;

    return TIFFGetField(tiff, TIFFTAG_IMAGEDESCRIPTION, &text) && text ? text : "";
}

static int is_aperio(TIFF *tiff)
{
    return strncmp(description(tiff), "Aperio", 6) == 0;
}

/* Pixels in um as Aperio's scanners write them into the description ("|MPP = 0.499"); 0: it does
 * not say. */
static double aperio_um(TIFF *tiff)
{
    const char *at = is_aperio(tiff) ? strstr(description(tiff), "|MPP = ") : NULL;
    struct gsn_words number = { 0 };
    double um = 0;

    if (!at)
        return 0;
    number.at = at + strlen("|MPP = ");
    number.size = strcspn(number.at, "|\r\n");
    return gsn_words_numbers(number, &um, 1) && um > 0.01 && um < 1000 ? um : 0;
}

/* The first value of a tag that libtiff does not know; NULL where the page has none of this type.
 */
static const void *private_value(TIFF *tiff, uint32_t tag, TIFFDataType type)
{
    const TIFFField *field = TIFFFindField(tiff, tag, TIFF_ANY);
    uint32_t count = 0;
    void *values = NULL;

    if (!field || TIFFFieldDataType(field) != type || !TIFFFieldPassCount(field))
        return NULL;
    return TIFFGetField(tiff, tag, &count, &values) && count > 0 ? values : NULL;
}

static int is_hamamatsu(TIFF *tiff)
{
    return private_value(tiff, NDPI_FORMAT, TIFF_LONG) != NULL;
}

/* Whether the current page may be a level at all, by the layout of its vendor. */
static int is_level_page(TIFF *tiff, int hamamatsu)
{
    const float *lens;
    const int32_t *plane;

    if (!hamamatsu)
        return TIFFIsTiled(tiff);
    lens = private_value(tiff, NDPI_LENS, TIFF_FLOAT);
    plane = private_value(tiff, NDPI_FOCAL_PLANE, TIFF_SLONG);
    return lens && *lens > 0 && !(plane && *plane != 0);
}

static int has_shape(const struct level *finest, uint32_t width, uint32_t height)
{
    const double scale = (double)finest->width / width;

    return width > 0 && height > 0 && width < finest->width &&
           fabs(finest->height / scale - height) <= SHAPE_PX;
}

static void add_level(struct slide *slide, const struct level *level)
{
    unsigned at = slide->count++;

    for (; at > 0 && slide->level[at - 1].width < level->width; at--)
        slide->level[at] = slide->level[at - 1];
    slide->level[at] = *level;
}

static void find_levels(TIFF *tiff, unsigned pages, int hamamatsu, struct slide *slide)
{
    for (unsigned page = 0; page < pages && slide->count < MOST_LEVELS; page++) {
        struct level level = { .page = (tdir_t)page };

        if (!TIFFSetDirectory(tiff, (tdir_t)page) ||
            !TIFFGetField(tiff, TIFFTAG_IMAGEWIDTH, &level.width) ||
            !TIFFGetField(tiff, TIFFTAG_IMAGELENGTH, &level.height))
            return;
        if (page == 0 || (is_level_page(tiff, hamamatsu) &&
                          has_shape(&slide->level[0], level.width, level.height)))
            add_level(slide, &level);
    }
}

/* Of the first page, which must be the current one. */
static int finest_um(TIFF *tiff, double *ret_um, struct gsn_error *err)
{
    struct gsn_picture stated = { 0 };
    uint16_t unit = RESUNIT_NONE;
    float x = 0, y = 0;
    double um = aperio_um(tiff);

    (void)TIFFGetField(tiff, TIFFTAG_XRESOLUTION, &x);
    (void)TIFFGetField(tiff, TIFFTAG_YRESOLUTION, &y);
    (void)TIFFGetFieldDefaulted(tiff, TIFFTAG_RESOLUTIONUNIT, &unit);
    if (um == 0 && (unit == RESUNIT_INCH || unit == RESUNIT_CENTIMETER))
        gsn_picture_pitch(&stated, (double)x, (double)y, unit == RESUNIT_INCH ? 25400 : 10000);
    if (stated.px_um_x > 0 && fabs(stated.px_um_y / stated.px_um_x - 1) > SQUARE)
        return gsn_fail(err, GSN_E_INPUT,
                        "a slide whose pixels are not square (%.4g x %.4g um): export it anew",
                        stated.px_um_x, stated.px_um_y);
    um = um > 0 ? um : stated.px_um_x;
    if (!(um > 0))
        return gsn_fail(err, GSN_E_INPUT,
                        "a slide that does not state the size of its pixels, so no level can be "
                        "measured: export it with its resolution");
    *ret_um = um;
    return GSN_OK;
}

static double level_um(const struct slide *slide, unsigned level, double um)
{
    return um * slide->level[0].width / slide->level[level].width;
}

static unsigned level_for(const struct slide *slide, double um, double target_um)
{
    unsigned level = 0;

    while (level + 1 < slide->count && level_um(slide, level + 1, um) <= target_um * (1 + SQUARE))
        level++;
    return level;
}

/* Opens the page of the level that limits ask for, and says which in the picture's note.
 * Fails with GSN_E_INPUT when there is no such level, or the pixels' size is not stated or not the
 * same along both axes. */
static int choose_level(struct gsn_tiff *t, const struct gsn_decode_limits *limits,
                        struct gsn_picture *picture, struct gsn_error *err)
{
    const int hamamatsu = is_hamamatsu(t->tiff);
    const char *vendor = hamamatsu            ? "Hamamatsu slide"
                         : is_aperio(t->tiff) ? "Aperio slide"
                                              : "tiled slide";
    struct slide slide = { 0 };
    unsigned level = limits->level;
    double um = 0;
    int r = finest_um(t->tiff, &um, err);

    if (r < 0)
        return r;
    find_levels(t->tiff, picture->pages, hamamatsu, &slide);
    if (limits->target_um > 0)
        level = level_for(&slide, um, limits->target_um);
    if (level >= slide.count)
        return gsn_fail(err, GSN_E_INPUT,
                        "a slide with %u level%s, so there is no level %u: say a smaller \"level\" "
                        "in job.json (0 is the finest)",
                        slide.count, slide.count == 1 ? "" : "s", level);
    if (!TIFFSetDirectory(t->tiff, slide.level[level].page))
        return gsn_fail(err, GSN_E_INPUT, "the directory of level %u cannot be read", level);
    t->slide_um = level_um(&slide, level, um);
    gsn_picture_remark(picture, "%s, level %u of %u (0 to %u), %.4g um", vendor, level, slide.count,
                       slide.count - 1, t->slide_um);
    return GSN_OK;
}

/* --- the file and its tags --- */

/* TIFF and BigTIFF by libtiff: opening, what the tags state, and what is refused because of them.
 * The pixels are in tiff_pixels.c. */

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
static void keep_complaint(struct gsn_tiff *t, const char *format, va_list args)
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
    keep_complaint(user, format, args);
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
        keep_complaint(t, format, args);
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

/* Aperio's own numbers of it. */
enum { APERIO_JPEG_2000_YCC = 33003, APERIO_JPEG_2000_RGB = 33005 };

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
    case APERIO_JPEG_2000_YCC:
    case APERIO_JPEG_2000_RGB:
    case COMPRESSION_JP2000:
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "a TIFF with JPEG 2000 compression (%u): export it with JPEG",
                        t->compression);
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
static unsigned count_colours(const struct gsn_tiff *t)
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
    const unsigned wanted = count_colours(t);
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

static double decode_straight(double v)
{
    return v;
}

/* Within half an 8-bit step all along. */
static int follows_curve(const uint16_t *curve, size_t count, double (*truth)(double))
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
        linear = linear && follows_curve(curve[c], count, decode_straight);
        srgb = srgb && follows_curve(curve[c], count, gsn_light_of_srgb);
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
        picture->px_um_x = picture->px_um_y = aperio_um(t->tiff);
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

static void note_remark(const struct gsn_tiff *t, struct gsn_picture *picture)
{
    if (picture->pages > 1 && !(t->slide_um > 0))
        gsn_picture_remark(picture, "page 1 of %u", picture->pages);
    if (t->samples > count_colours(t))
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
                                              .channels = is_palette ? 3 : count_colours(t),
                                              .bits = is_palette ? 8 : t->bits,
                                              .orientation = t->orientation };
    struct gsn_raster canvas;
    int r;

    read_pitch(t, picture);
    picture->transfer = read_transfer(t, picture);
    picture->lossy = t->compression == COMPRESSION_JPEG;
    note_remark(t, picture);
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

    r = count_pages(file, &picture->pages, err);
    if (r < 0)
        return r;
    r = open_page(&t, err);
    if (r >= 0 && limits->slide)
        r = choose_level(&t, limits, picture, err);
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
