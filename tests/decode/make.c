/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/decode/make.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <jpeglib.h>
#include <png.h>
#include <tiffio.h>

enum { ROOM = 12 << 20 };

static const char profile[] = "not a profile that anything here looks into";

void made_free(struct made *made)
{
    gsn_free(made->bytes);
    *made = (struct made){ 0 };
}

static struct made made_new(void)
{
    const struct made made = { .bytes = gsn_alloc_array(ROOM, 1) };

    assert(made.bytes);
    return made;
}

struct gsn_image *make_picture(uint32_t width, uint32_t height, uint32_t channels, uint32_t bits)
{
    struct gsn_image *image = NULL;

    if (gsn_image_new(width, height, channels, bits, &image, NULL) < 0)
        return NULL;
    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++)
            for (uint32_t c = 0; c < channels; c++) {
                const size_t i = ((size_t)y * width + x) * channels + c;
                const unsigned value = (x * 5 + y * 3 + c * 40 + (x * y) % 7) & 0xff;

                if (bits == 8)
                    ((uint8_t *)image->samples)[i] = (uint8_t)value;
                else
                    ((uint16_t *)image->samples)[i] = (uint16_t)(value * 256 + x + 2 * y);
            }
    /* Full scale once, or a small 16-bit picture would look like one of 12 bits. */
    if (bits == 16)
        ((uint16_t *)image->samples)[(size_t)width * height * channels - 1] = 65535;
    return image;
}

/* --- JPEG --- */

static void write_rows(struct jpeg_compress_struct *info, const struct gsn_image *image)
{
    const size_t row = (size_t)image->width * image->channels;
    uint8_t cmyk[4 * 512];

    for (uint32_t y = 0; y < image->height; y++) {
        JSAMPROW from = (uint8_t *)image->samples + y * row;

        for (uint32_t x = 0; info->input_components == 4 && x < image->width; x++)
            for (unsigned c = 0; c < 4; c++)
                cmyk[4 * x + c] = from[image->channels * x + c % image->channels];
        if (info->input_components == 4)
            from = cmyk;
        (void)jpeg_write_scanlines(info, &from, 1);
    }
}

struct made make_jpeg(const struct gsn_image *image, const struct jpeg_recipe *recipe)
{
    struct made made = made_new();
    struct jpeg_compress_struct info = { 0 };
    struct jpeg_error_mgr errors;
    unsigned long size = ROOM;
    uint8_t icc[14 + sizeof profile] = "ICC_PROFILE\0\1\1";

    assert(image->width <= 512);
    info.err = jpeg_std_error(&errors);
    jpeg_create_compress(&info);
    jpeg_mem_dest(&info, &made.bytes, &size);
    info.image_width = image->width;
    info.image_height = image->height;
    info.input_components = recipe->cmyk ? 4 : (int)image->channels;
    info.in_color_space = recipe->cmyk ? JCS_CMYK : image->channels == 1 ? JCS_GRAYSCALE : JCS_RGB;
    jpeg_set_defaults(&info);
    jpeg_set_quality(&info, recipe->quality ? recipe->quality : 95, TRUE);
    if (recipe->progressive)
        jpeg_simple_progression(&info);
    if (recipe->whole_resolution)
        info.comp_info[0].h_samp_factor = info.comp_info[0].v_samp_factor = 1;
    info.density_unit = (UINT8)recipe->unit;
    if (recipe->dots)
        info.X_density = info.Y_density = (UINT16)recipe->dots;
    jpeg_start_compress(&info, TRUE);
    if (recipe->exif)
        jpeg_write_marker(&info, JPEG_APP0 + 1, recipe->exif, (unsigned)recipe->exif_size);
    memcpy(icc + 14, profile, sizeof profile);
    if (recipe->with_icc)
        jpeg_write_marker(&info, JPEG_APP0 + 2, icc, sizeof icc);
    if (recipe->icc)
        jpeg_write_icc_profile(&info, recipe->icc->bytes, (unsigned)recipe->icc->size);
    write_rows(&info, image);
    jpeg_finish_compress(&info);
    jpeg_destroy_compress(&info);
    made.size = size;
    return made;
}

/* --- PNG --- */

static void png_put(png_structp png, png_bytep from, size_t count)
{
    struct made *made = png_get_io_ptr(png);

    assert(count <= ROOM - made->size);
    memcpy(made->bytes + made->size, from, count);
    made->size += count;
}

static void png_flush_nothing(png_structp png)
{
    (void)png;
}

static int png_colour(const struct gsn_image *image, int alpha)
{
    if (image->channels == 1)
        return alpha ? PNG_COLOR_TYPE_GRAY_ALPHA : PNG_COLOR_TYPE_GRAY;
    return alpha ? PNG_COLOR_TYPE_RGB_ALPHA : PNG_COLOR_TYPE_RGB;
}

static void png_tags(png_structp png, png_infop info, const struct png_recipe *recipe)
{
    if (recipe->gamma)
        png_set_gAMA_fixed(png, info, (png_fixed_point)recipe->gamma);
    if (recipe->srgb)
        png_set_sRGB(png, info, PNG_sRGB_INTENT_PERCEPTUAL);
    if (recipe->per_metre)
        png_set_pHYs(png, info, recipe->per_metre, recipe->per_metre, PNG_RESOLUTION_METER);
}

static void png_raw_chunks(png_structp png, const struct png_recipe *recipe)
{
    if (recipe->with_icc)
        png_write_chunk(png, (png_const_bytep) "iCCP", (png_const_bytep)profile, sizeof profile);
    if (recipe->icc)
        png_write_chunk(png, (png_const_bytep) "iCCP", recipe->icc->bytes, recipe->icc->size);
    if (recipe->exif)
        png_write_chunk(png, (png_const_bytep) "eXIf", recipe->exif, recipe->exif_size);
}

/* The rows of the image, with an alpha put behind each pixel when asked for. */
static void png_rows(png_structp png, png_infop info, const struct gsn_image *image,
                     const struct png_recipe *recipe)
{
    const size_t pixel = (size_t)image->channels * image->bits / 8;
    const size_t stored = png_get_rowbytes(png, info) / image->width;
    const size_t row_bytes = png_get_rowbytes(png, info);
    gsn_auto_mem(uint8_t) all = gsn_alloc_array(image->height, row_bytes);
    gsn_auto_mem(png_bytep) rows = gsn_alloc_array(image->height, sizeof *rows);

    assert(all && rows);
    memset(all, recipe->alpha == 2 ? 0x14 : 0x80, image->height * row_bytes);
    for (uint32_t y = 0; y < image->height; y++) {
        rows[y] = all + y * row_bytes;
        for (uint32_t x = 0; recipe->bits != 1 && x < image->width; x++)
            memcpy(rows[y] + x * stored,
                   (const uint8_t *)image->samples + ((size_t)y * image->width + x) * pixel, pixel);
    }
    if (image->bits == 16)
        png_set_swap(png);
    if (recipe->interlaced)
        (void)png_set_interlace_handling(png);
    png_write_image(png, rows);
}

static struct made png_with(const struct gsn_image *image, const struct png_recipe *recipe,
                            const png_color *palette)
{
    struct made made = made_new();
    png_structp png = png_create_write_struct(PNG_LIBPNG_VER_STRING, NULL, NULL, NULL);
    png_infop info = png_create_info_struct(png);

    png_set_write_fn(png, &made, png_put, png_flush_nothing);
    png_set_IHDR(png, info, image->width, image->height,
                 recipe->bits ? recipe->bits : (int)image->bits,
                 palette ? PNG_COLOR_TYPE_PALETTE : png_colour(image, recipe->alpha),
                 recipe->interlaced ? PNG_INTERLACE_ADAM7 : PNG_INTERLACE_NONE,
                 PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
    if (palette)
        png_set_PLTE(png, info, palette, 256);
    png_tags(png, info, recipe);
    png_write_info(png, info);
    png_raw_chunks(png, recipe);
    png_rows(png, info, image, recipe);
    png_write_end(png, info);
    png_destroy_write_struct(&png, &info);
    return made;
}

struct made make_png(const struct gsn_image *image, const struct png_recipe *recipe)
{
    return png_with(image, recipe, NULL);
}

struct made make_palette_png(const struct gsn_image *image)
{
    const struct png_recipe plain = { 0 };
    png_color palette[256];

    for (unsigned i = 0; i < 256; i++)
        palette[i] = (png_color){ (uint8_t)i, (uint8_t)(255 - i), (uint8_t)(i / 2) };
    return png_with(image, &plain, palette);
}

/* --- TIFF --- */

struct tape {
    struct made made;
    size_t at;
};

static tmsize_t tape_read(thandle_t handle, void *to, tmsize_t count)
{
    struct tape *tape = handle;
    const size_t left = tape->at < tape->made.size ? tape->made.size - tape->at : 0;
    const size_t take = (size_t)count < left ? (size_t)count : left;

    memcpy(to, tape->made.bytes + tape->at, take);
    tape->at += take;
    return (tmsize_t)take;
}

static tmsize_t tape_write(thandle_t handle, void *from, tmsize_t count)
{
    struct tape *tape = handle;

    assert((size_t)count <= ROOM - tape->at);
    memcpy(tape->made.bytes + tape->at, from, (size_t)count);
    tape->at += (size_t)count;
    if (tape->at > tape->made.size)
        tape->made.size = tape->at;
    return count;
}

static toff_t tape_seek(thandle_t handle, toff_t to, int whence)
{
    struct tape *tape = handle;
    const toff_t base = whence == SEEK_CUR ? tape->at : whence == SEEK_END ? tape->made.size : 0;

    return tape->at = base + to;
}

static int tape_close(thandle_t handle)
{
    (void)handle;
    return 0;
}

static toff_t tape_size(thandle_t handle)
{
    return ((struct tape *)handle)->made.size;
}

static TIFF *tape_open(struct tape *tape, const char *mode)
{
    TIFF *tiff = TIFFClientOpen("tape", mode ? mode : "w", tape, tape_read, tape_write, tape_seek,
                                tape_close, tape_size, NULL, NULL);

    assert(tiff);
    return tiff;
}

static void tiff_tags(TIFF *tiff, const struct gsn_image *image, const struct tiff_recipe *recipe)
{
    const int colours = (int)image->channels;
    uint16_t extra = EXTRASAMPLE_UNASSALPHA;
    int photometric = colours == 3 ? PHOTOMETRIC_RGB : PHOTOMETRIC_MINISBLACK;

    if (recipe->photometric)
        photometric = recipe->photometric;
    if (recipe->white_is_zero)
        photometric = PHOTOMETRIC_MINISWHITE;
    if (recipe->jpeg_ycbcr)
        photometric = PHOTOMETRIC_YCBCR;
    TIFFSetField(tiff, TIFFTAG_IMAGEWIDTH, image->width);
    TIFFSetField(tiff, TIFFTAG_IMAGELENGTH, image->height);
    TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, image->bits);
    TIFFSetField(tiff, TIFFTAG_SAMPLESPERPIXEL, colours + (recipe->alpha ? 1 : 0));
    TIFFSetField(tiff, TIFFTAG_PHOTOMETRIC, photometric);
    TIFFSetField(tiff, TIFFTAG_PLANARCONFIG, recipe->planar ? recipe->planar : PLANARCONFIG_CONTIG);
    TIFFSetField(tiff, TIFFTAG_COMPRESSION,
                 recipe->compression ? recipe->compression : COMPRESSION_NONE);
    if (recipe->predictor)
        TIFFSetField(tiff, TIFFTAG_PREDICTOR, recipe->predictor);
    if (recipe->orientation)
        TIFFSetField(tiff, TIFFTAG_ORIENTATION, recipe->orientation);
    if (recipe->alpha)
        TIFFSetField(tiff, TIFFTAG_EXTRASAMPLES, 1, &extra);
    if (recipe->sample_format)
        TIFFSetField(tiff, TIFFTAG_SAMPLEFORMAT, recipe->sample_format);
    if (recipe->jpeg_ycbcr)
        TIFFSetField(tiff, TIFFTAG_JPEGCOLORMODE, JPEGCOLORMODE_RGB);
    if (recipe->tile) {
        TIFFSetField(tiff, TIFFTAG_TILEWIDTH, recipe->tile);
        TIFFSetField(tiff, TIFFTAG_TILELENGTH, recipe->tile);
    } else {
        TIFFSetField(tiff, TIFFTAG_ROWSPERSTRIP, recipe->jpeg_ycbcr ? 16 : 5);
    }
}

static void tiff_more_tags(TIFF *tiff, const struct tiff_recipe *recipe)
{
    if (recipe->unit) {
        TIFFSetField(tiff, TIFFTAG_RESOLUTIONUNIT, recipe->unit);
        TIFFSetField(tiff, TIFFTAG_XRESOLUTION, recipe->dots);
        TIFFSetField(tiff, TIFFTAG_YRESOLUTION, recipe->dots * 2);
    }
    if (recipe->lowest_bit_first)
        TIFFSetField(tiff, TIFFTAG_FILLORDER, FILLORDER_LSB2MSB);
    if (recipe->curve)
        TIFFSetField(tiff, TIFFTAG_TRANSFERFUNCTION, recipe->curve, recipe->curve, recipe->curve);
    if (recipe->with_icc)
        TIFFSetField(tiff, TIFFTAG_ICCPROFILE, (uint32_t)sizeof profile, profile);
    if (recipe->icc)
        TIFFSetField(tiff, TIFFTAG_ICCPROFILE, (uint32_t)recipe->icc->size, recipe->icc->bytes);
}

/* One piece of one plane: rows of width pixels from (x0, y0), zero beyond the picture. */
static void cut(const struct gsn_image *image, const struct tiff_recipe *recipe, uint32_t x0,
                uint32_t y0, uint32_t width, uint32_t height, unsigned plane, uint8_t *to)
{
    const int separate = recipe->planar == PLANARCONFIG_SEPARATE;
    const unsigned channels = image->channels + (recipe->alpha ? 1 : 0);
    const unsigned first = separate ? plane : 0, last = separate ? plane + 1 : channels;
    const int inverted = recipe->white_is_zero;

    for (uint32_t y = 0; y < height; y++)
        for (uint32_t x = 0; x < width; x++)
            for (unsigned c = first; c < last; c++) {
                unsigned value = recipe->alpha == 2 ? 20 : image->bits == 8 ? 177 : 45000;
                const uint32_t px = x0 + x, py = y0 + y;

                if (px >= image->width || py >= image->height)
                    value = 0;
                else if (c < image->channels)
                    value = gsn_image_at(image, px, py, c);
                if (inverted)
                    value = (image->bits == 8 ? 255 : 65535) - value;
                if (image->bits == 8)
                    *to++ = (uint8_t)value;
                else
                    memcpy(to, &(uint16_t){ (uint16_t)value }, 2), to += 2;
            }
}

static void tiff_plane(TIFF *tiff, const struct gsn_image *image, const struct tiff_recipe *recipe,
                       uint16_t plane)
{
    const tmsize_t line = TIFFScanlineSize(tiff);
    const size_t size = recipe->tile ? (size_t)TIFFTileSize(tiff) : (size_t)line;
    gsn_auto_mem(uint8_t) piece = gsn_alloc_array(size, 1);

    assert(piece);
    for (uint32_t y = 0; !recipe->tile && y < image->height; y++) {
        cut(image, recipe, 0, y, image->width, 1, plane, piece);
        (void)TIFFWriteScanline(tiff, piece, y, plane);
    }
    for (uint32_t y = 0; recipe->tile && y < image->height; y += recipe->tile)
        for (uint32_t x = 0; x < image->width; x += recipe->tile) {
            cut(image, recipe, x, y, recipe->tile, recipe->tile, plane, piece);
            (void)TIFFWriteTile(tiff, piece, x, y, 0, plane);
        }
}

struct made make_tiff(const struct gsn_image *image, const struct tiff_recipe *recipe)
{
    struct tape tape = { .made = made_new() };
    TIFF *tiff = tape_open(&tape, recipe->mode);
    const int separate = recipe->planar == PLANARCONFIG_SEPARATE;
    const uint16_t planes =
        separate ? (uint16_t)(image->channels + (recipe->alpha ? 1 : 0)) : (uint16_t)1;

    for (int page = 0; page < (recipe->pages ? recipe->pages : 1); page++) {
        tiff_tags(tiff, image, recipe);
        tiff_more_tags(tiff, recipe);
        for (uint16_t s = 0; s < planes; s++)
            tiff_plane(tiff, image, recipe, s);
        (void)TIFFWriteDirectory(tiff);
    }
    TIFFClose(tiff);
    return tape.made;
}

struct made make_palette_tiff(const struct gsn_image *image, unsigned bits)
{
    struct tape tape = { .made = made_new() };
    TIFF *tiff = tape_open(&tape, NULL);
    const struct tiff_recipe plain = { .photometric = PHOTOMETRIC_PALETTE };
    uint16_t map[3][256];
    uint8_t row[512];

    for (unsigned i = 0; i < 256; i++) {
        map[0][i] = (uint16_t)(i * 257);
        map[1][i] = (uint16_t)((255 - i) * 257);
        map[2][i] = (uint16_t)(i / 2 * 257);
    }
    tiff_tags(tiff, image, &plain);
    TIFFSetField(tiff, TIFFTAG_BITSPERSAMPLE, bits);
    TIFFSetField(tiff, TIFFTAG_COLORMAP, map[0], map[1], map[2]);
    for (uint32_t y = 0; y < image->height; y++) {
        memset(row, 0, sizeof row);
        for (uint32_t x = 0; x < image->width; x++) {
            const unsigned value = gsn_image_at(image, x, y, 0);

            if (bits == 8)
                row[x] = (uint8_t)value;
            else
                row[x / 2] |= (uint8_t)((value & 15) << (x % 2 ? 0 : 4));
        }
        (void)TIFFWriteScanline(tiff, row, y, 0);
    }
    TIFFClose(tiff);
    return tape.made;
}

/* --- EXIF --- */

static size_t put_number(uint8_t *room, size_t at, int big_endian, uint32_t value, unsigned bytes)
{
    for (unsigned i = 0; i < bytes; i++)
        room[at + i] = (uint8_t)(value >> 8 * (big_endian ? bytes - 1 - i : i));
    return at + bytes;
}

static size_t put_entry(uint8_t *room, size_t at, int big, unsigned tag, unsigned type,
                        uint32_t value)
{
    at = put_number(room, at, big, tag, 2);
    at = put_number(room, at, big, type, 2);
    at = put_number(room, at, big, 1, 4);
    (void)put_number(room, at, big, value, type == 3 ? 2 : 4);
    return at + 4;
}

size_t make_exif(const struct exif_recipe *recipe, uint8_t room[128])
{
    const int big = recipe->big_endian;
    const size_t start = recipe->for_jpeg ? 6 : 0;
    uint8_t *tiff = room + start;
    size_t at = 0;

    memset(room, 0, 128);
    if (recipe->for_jpeg)
        memcpy(room, "Exif\0", 6);
    at = put_number(tiff, at, big, big ? 0x4d4d : 0x4949, 2);
    at = put_number(tiff, at, big, 42, 2);
    at = put_number(tiff, at, big, 8, 4);
    at = put_number(tiff, at, big, 5, 2);
    at = put_entry(tiff, at, big, 0x112, 3, recipe->orientation);
    at = put_entry(tiff, at, big, 0x11a, 5, 92);
    at = put_entry(tiff, at, big, 0x11b, 5, 92);
    at = put_entry(tiff, at, big, 0x128, 3, 3);
    at = put_entry(tiff, at, big, 0x8769, 4, 74);
    at = put_number(tiff, at, big, 0, 4);
    at = put_number(tiff, at, big, 1, 2); /* at 74: the Exif directory */
    at = put_entry(tiff, at, big, 0xa001, 3, recipe->colour_space);
    at = put_number(tiff, at, big, 0, 4);
    at = put_number(tiff, at, big, recipe->dots_per_cm, 4); /* at 92: the rational */
    at = put_number(tiff, at, big, recipe->dots_per_cm ? 1 : 0, 4);
    return start + at;
}

/* --- a child --- */

static void decode_and_tell(int to, const void *bytes, size_t size, uint64_t address_space)
{
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error said = { 0 };
    struct rlimit most = { address_space, address_space };

    /* The sanitizers map terabytes of shadow; there only the clock and the peak are watched. */
#if !defined(__SANITIZE_ADDRESS__) && !defined(__SANITIZE_THREAD__)
    (void)setrlimit(RLIMIT_AS, &most);
#else
    (void)most;
#endif
    (void)alarm(10);
    said.code = gsn_decode(bytes, size, NULL, &picture, &said);
    if (said.code >= 0)
        (void)snprintf(said.text, sizeof said.text, "%s", picture->note);
    if (write(to, &said, sizeof said) != (ssize_t)sizeof said)
        _exit(2);
    _exit(0);
}

int decode_in_child(const void *bytes, size_t size, uint64_t address_space,
                    struct gsn_error *ret_said, uint64_t *ret_peak_bytes)
{
    struct rusage used = { 0 };
    int ends[2], status = 1;
    ssize_t got;
    pid_t child;

    if (pipe(ends) < 0)
        return CHILD_DIED;
    (void)fflush(stdout);
    child = fork();
    if (child == 0)
        decode_and_tell(ends[1], bytes, size, address_space);
    (void)close(ends[1]);
    got = child > 0 ? read(ends[0], ret_said, sizeof *ret_said) : -1;
    (void)close(ends[0]);
    if (child > 0)
        (void)wait4(child, &status, 0, &used);
    if (ret_peak_bytes)
        *ret_peak_bytes = (uint64_t)used.ru_maxrss * 1024;
    if (got != (ssize_t)sizeof *ret_said || !WIFEXITED(status) || WEXITSTATUS(status) != 0)
        return CHILD_DIED;
    return ret_said->code;
}

/* --- comparing --- */

static int same_shape(const struct gsn_image *a, const struct gsn_image *b)
{
    return a->width == b->width && a->height == b->height && a->channels == b->channels &&
           a->bits == b->bits;
}

double mean_difference(const struct gsn_image *a, const struct gsn_image *b)
{
    double sum = 0;

    if (!same_shape(a, b))
        return -1;
    for (uint32_t y = 0; y < a->height; y++)
        for (uint32_t x = 0; x < a->width; x++)
            for (uint32_t c = 0; c < a->channels; c++)
                sum += abs((int)gsn_image_at(a, x, y, c) - (int)gsn_image_at(b, x, y, c));
    return sum / ((double)a->width * a->height * a->channels);
}

int same_picture(const struct gsn_image *a, const struct gsn_image *b)
{
    return same_shape(a, b) && memcmp(a->samples, b->samples, gsn_image_bytes(a)) == 0;
}
