/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The codes printed on a picture: Data Matrix by libdmtx, QR and bar codes by ZBar.
 *
 * Method: a grey picture of the brightest channel of each pixel, in which print is dark and stained
 * tissue all but vanishes. Of a large picture only what
 * looks like print is shown to the libraries: blocks whose rows and columns change between dark and
 * bright as often as the modules of a code do.
 *
 * Steps: (1) grey; (2) blocks, joined to boxes; (3) each box to both libraries, upright and
 * mirrored, with a bound on tries and on time; (4) texts kept as data, what does not print becoming
 * '?'.
 *
 * Failure: GSN_E_NOMEM; a picture without codes is none. Both libraries parse what a stranger
 * sends, so this runs in gieson-decode alone. Cost: tries are bounded in number and in processor
 * time, never by the clock on the wall: a busy machine finds the same. */
#include "pipeline/decode/codes.h"

#include "pipeline/core/calendar.h"
#include "pipeline/decode/raster.h"

#include <dmtx.h>
#include <zbar.h>

#include <math.h>
#include <stdio.h>
#include <string.h>

struct code_page {
    uint32_t width, height;
    uint8_t *grey;
    double until_cpu_ms; /* of gsn_process_cpu_ms(): then the search is given up */
};

/* --- Data Matrix --- */

/* The library looks for edges on a grid: a symbol of ten modules of two pixels is met by it. What
 * looks like a symbol and is none costs time: tries are counted, so that the same picture has the
 * same codes on every machine, and timed, so that a picture without codes holds up nobody. */
enum { SCAN_GAP = 8, MOST_TRIES = 60, SLICE_MS = 50 };

/* Degrees, clockwise on the picture, by which the symbol's base is turned; the library's y runs
 * up. */
static double data_matrix_turn(DmtxRegion *region)
{
    DmtxVector2 base[2] = { { 0, 0 }, { 1, 0 } };

    (void)dmtxMatrix3VMultiplyBy(&base[0], region->fit2raw);
    (void)dmtxMatrix3VMultiplyBy(&base[1], region->fit2raw);
    return atan2(-(base[1].Y - base[0].Y), base[1].X - base[0].X) * 180 / M_PI;
}

static int is_given_up(const struct code_page *page)
{
    return gsn_process_cpu_ms() >= page->until_cpu_ms;
}

/* The library knows the clock on the wall alone, so it searches for a slice of time, and then goes
 * on where it stopped. */
static DmtxRegion *find_region(DmtxDecode *decoder, const struct code_page *page)
{
    DmtxRegion *region = NULL;
    int ended = 0;

    while (!region && !ended && !is_given_up(page)) {
        DmtxTime until = dmtxTimeAdd(dmtxTimeNow(), SLICE_MS);

        region = dmtxRegionFindNext(decoder, &until);
        ended = !dmtxTimeExceeded(until);
    }
    return region;
}

/* One look at the page. Returns how many codes were added. */
static int scan_data_matrix(DmtxDecode *decoder, const struct code_page *page, int mirrored,
                            struct gsn_picture *picture)
{
    int added = 0;

    for (int tries = 0; tries < MOST_TRIES; tries++) {
        DmtxRegion *region = find_region(decoder, page);
        DmtxMessage *message;
        struct gsn_printed *code = NULL;

        if (!region)
            break;
        message = dmtxDecodeMatrixRegion(decoder, region, DmtxUndefined);
        if (message)
            code =
                gsn_codes_add(picture, "Data Matrix", message->output, (size_t)message->outputIdx);
        if (code) {
            code->turn_deg = remainder(data_matrix_turn(region) + (mirrored ? 180 : 0), 360);
            code->mirrored = mirrored;
            added++;
        }
        if (message)
            (void)dmtxMessageDestroy(&message);
        (void)dmtxRegionDestroy(&region);
        if (added)
            break;
    }
    return added;
}

static int look_flipped(const struct code_page *page, int mirrored, struct gsn_picture *picture,
                        int *ret_added, struct gsn_error *err)
{
    DmtxImage *image =
        dmtxImageCreate(page->grey, (int)page->width, (int)page->height, DmtxPack8bppK);
    DmtxDecode *decoder;

    if (!image)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
    (void)dmtxImageSetProp(image, DmtxPropImageFlip, mirrored ? DmtxFlipY : DmtxFlipNone);
    decoder = dmtxDecodeCreate(image, 1);
    if (!decoder) {
        (void)dmtxImageDestroy(&image);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
    }
    (void)dmtxDecodeSetProp(decoder, DmtxPropScanGap, SCAN_GAP);
    *ret_added = scan_data_matrix(decoder, page, mirrored, picture);
    (void)dmtxDecodeDestroy(&decoder);
    (void)dmtxImageDestroy(&image);
    return GSN_OK;
}

/* Adds the Data Matrices behind the codes that were found, as far as there is room. Fails with
 * GSN_E_NOMEM. A mirrored symbol cannot be read, so the page is looked at both ways. The library
 * flips top to bottom, which is left to right and half a turn. */
static int find_data_matrices(const struct code_page *page, struct gsn_picture *picture,
                              struct gsn_error *err)
{
    int added = 0, r = GSN_OK;

    for (int mirrored = 0; r >= 0 && !added && mirrored < 2; mirrored++)
        if (!is_given_up(page))
            r = look_flipped(page, mirrored, picture, &added, err);
    return r;
}

/* --- QR and bar codes --- */

static double bar_code_turn(const zbar_symbol_t *symbol)
{
    switch (zbar_symbol_get_orientation(symbol)) {
    case ZBAR_ORIENT_RIGHT:
        return 90;
    case ZBAR_ORIENT_DOWN:
        return 180;
    case ZBAR_ORIENT_LEFT:
        return -90;
    default:
        return 0;
    }
}

static int find_barcodes(const struct code_page *page, struct gsn_picture *picture,
                         struct gsn_error *err)
{
    zbar_image_scanner_t *scanner = zbar_image_scanner_create();
    zbar_image_t *image = zbar_image_create();
    const zbar_symbol_t *symbol = NULL;

    if (scanner && image) {
        zbar_image_set_format(image, zbar_fourcc('Y', '8', '0', '0'));
        zbar_image_set_size(image, page->width, page->height);
        zbar_image_set_data(image, page->grey, (unsigned long)page->width * page->height, NULL);
        if (zbar_scan_image(scanner, image) > 0)
            symbol = zbar_image_first_symbol(image);
    }
    for (; symbol; symbol = zbar_symbol_next(symbol)) {
        struct gsn_printed *code =
            gsn_codes_add(picture, zbar_get_symbol_name(zbar_symbol_get_type(symbol)),
                          zbar_symbol_get_data(symbol), zbar_symbol_get_data_length(symbol));

        if (code)
            code->turn_deg = bar_code_turn(symbol);
    }
    if (image)
        zbar_image_destroy(image);
    if (scanner)
        zbar_image_scanner_destroy(scanner);
    return scanner && image ? GSN_OK
                            : gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
}

/* --- where to look --- */

/* A module of the smallest label is 0.15 mm; on a panel of 75 mm this leaves it five pixels. */
enum { LONGEST = 2500, TAPS = 2 };
/* A picture no longer than this is looked at as a whole. Of a larger one only what looks like
 * print: of a block of pixels at least so many percent are darker than so many percent of white,
 * and its rows and columns change between dark and bright, as the modules of a code and the bars of
 * a bar code do. The edge of a scanner's bed, a frame or a coverslip changes once at most. Blocks
 * this far from each other belong together; the smallest code has two blocks a side, and a label
 * takes a strip of the panel, so no more than this share of it is one. */
enum {
    SMALL = 480,
    BLOCK = 16,
    PRINT_PERCENT = 15,
    DARK_PERCENT = 35,
    REACH = 2,
    LEAST_BLOCKS = 2,
    MOST_AREAS = 16,
    MOST_SHARE = 4, /* one part in so many of the page */
    /* Changes in the 16 lines of a block, along both ways or along one alone. */
    CHANGES_BOTH = BLOCK / 2,
    CHANGES_ONE = 3 * BLOCK / 2,
};

/* A label takes a fifth of a second of the processor. What looks like print for so long is none. */
static const double MOST_CPU_MS = 4000;

struct gsn_printed *gsn_codes_add(struct gsn_picture *picture, const char *kind, const void *text,
                                  size_t size)
{
    const char *from = text;
    struct gsn_printed *code;

    if (picture->code_count == GSN_CODES)
        return NULL;
    code = &picture->code[picture->code_count++];
    *code = (struct gsn_printed){ .turn_deg = 0 };
    (void)snprintf(code->kind, sizeof code->kind, "%s", kind);
    for (size_t i = 0; i < size && i + 1 < sizeof code->text; i++)
        code->text[i] = from[i];
    for (size_t i = 0; code->text[i]; i++)
        if (code->text[i] < ' ' || code->text[i] > '~')
            code->text[i] = '?';
    return code;
}

/* The mean over a cell of the brightest channel, of at most TAPS x TAPS of its pixels. */
static uint8_t mean_brightest(const struct gsn_image *image, uint32_t x0, uint32_t y0,
                              unsigned step)
{
    const unsigned taps = step < TAPS ? step : TAPS;
    unsigned sum = 0;

    for (unsigned k = 0; k < taps * taps; k++) {
        const uint32_t x = x0 + (2 * (k % taps) + 1) * step / (2 * taps);
        const uint32_t y = y0 + (2 * (k / taps) + 1) * step / (2 * taps);
        unsigned most = 0;

        for (unsigned c = 0; c < image->channels; c++) {
            const unsigned code = gsn_image_at(image, x, y, c);

            most = code > most ? code : most;
        }
        sum += image->bits == 8 ? most : most >> 8;
    }
    return (uint8_t)(sum / (taps * taps));
}

/* ---- where there is print ---------------------------------------------------------------- */

/* The page in blocks: 1 where a good part of a block is dark, as in print; a mark of laser char or
 * a speck is too small for it. */
struct blocks {
    uint32_t width, height;
    uint8_t *print;
};

struct area {
    uint32_t x0, y0, x1, y1; /* blocks, [x0, x1) by [y0, y1) */
};

/* The code that only one pixel in fifty is brighter than. */
static unsigned white_of(const struct code_page *page)
{
    const size_t count = (size_t)page->width * page->height;
    size_t histogram[256] = { 0 }, above = 0;
    unsigned white = 255;

    for (size_t i = 0; i < count; i++)
        histogram[page->grey[i]]++;
    while (white > 0 && (above += histogram[white]) < count / 50)
        white--;
    return white;
}

static int is_print(const uint8_t *from, size_t width, unsigned dark)
{
    unsigned count = 0, across = 0, down = 0;

    for (unsigned y = 0; y < BLOCK; y++)
        for (unsigned x = 0; x < BLOCK; x++) {
            const uint8_t *at = from + y * width + x;

            count += *at < dark;
            across += x > 0 && (*at < dark) != (at[-1] < dark);
            down += y > 0 && (*at < dark) != (*(at - width) < dark);
        }
    return 100 * count >= PRINT_PERCENT * BLOCK * BLOCK &&
           ((across >= CHANGES_BOTH && down >= CHANGES_BOTH) || across >= CHANGES_ONE ||
            down >= CHANGES_ONE);
}

static void find_print(const struct code_page *page, const struct blocks *blocks)
{
    const unsigned dark = white_of(page) * DARK_PERCENT / 100;

    for (uint32_t i = 0; i < blocks->width * blocks->height; i++)
        blocks->print[i] =
            (uint8_t)is_print(page->grey + (size_t)(i / blocks->width * BLOCK) * page->width +
                                  i % blocks->width * BLOCK,
                              page->width, dark);
}

/* Widens the area over the blocks that touch it until none is left, and takes them away. */
static struct area take_area(const struct blocks *blocks, uint32_t x, uint32_t y)
{
    struct area area = { x, y, x + 1, y + 1 };
    int grown = 1;

    while (grown) {
        const struct area round = {
            area.x0 > REACH ? area.x0 - REACH : 0, area.y0 > REACH ? area.y0 - REACH : 0,
            area.x1 + REACH < blocks->width ? area.x1 + REACH : blocks->width,
            area.y1 + REACH < blocks->height ? area.y1 + REACH : blocks->height
        };

        grown = 0;
        for (uint32_t v = round.y0; v < round.y1; v++)
            for (uint32_t u = round.x0; u < round.x1; u++) {
                uint8_t *print = &blocks->print[v * blocks->width + u];

                if (!*print)
                    continue;
                *print = 0;
                grown = 1;
                area.x0 = u < area.x0 ? u : area.x0;
                area.y0 = v < area.y0 ? v : area.y0;
                area.x1 = u + 1 > area.x1 ? u + 1 : area.x1;
                area.y1 = v + 1 > area.y1 ? v + 1 : area.y1;
            }
    }
    return area;
}

/* ---- reading ----------------------------------------------------------------------------- */

static int read_page(const struct code_page *page, struct gsn_picture *picture,
                     struct gsn_error *err)
{
    const int r = find_data_matrices(page, picture, err);

    return r < 0 ? r : find_barcodes(page, picture, err);
}

/* An area of print with the white around it, as a page of its own. */
static int read_area(const struct code_page *page, const struct area *area,
                     struct gsn_picture *picture, struct gsn_error *err)
{
    const uint32_t x0 = area->x0 > 0 ? (area->x0 - 1) * BLOCK : 0;
    const uint32_t y0 = area->y0 > 0 ? (area->y0 - 1) * BLOCK : 0;
    const uint32_t right = (area->x1 + 1) * BLOCK, below = (area->y1 + 1) * BLOCK;
    const uint32_t x1 = right < page->width ? right : page->width;
    const uint32_t y1 = below < page->height ? below : page->height;
    const struct code_page part = { .width = x1 - x0,
                                    .height = y1 - y0,
                                    .until_cpu_ms = page->until_cpu_ms };
    struct code_page copy = part;
    gsn_auto_mem(uint8_t) grey = gsn_alloc((size_t)part.width * part.height);

    if (!grey)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
    for (uint32_t y = 0; y < part.height; y++)
        memcpy(grey + (size_t)y * part.width, page->grey + (size_t)(y0 + y) * page->width + x0,
               part.width);
    copy.grey = grey;
    return read_page(&copy, picture, err);
}

static int read_areas(const struct code_page *page, struct gsn_picture *picture,
                      struct gsn_error *err)
{
    struct blocks blocks = { .width = page->width / BLOCK, .height = page->height / BLOCK };
    gsn_auto_mem(uint8_t) print = gsn_alloc_array(blocks.width, blocks.height);
    int areas = 0, r = GSN_OK;

    if (!print)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
    blocks.print = print;
    find_print(page, &blocks);
    for (uint32_t i = 0;
         i < blocks.width * blocks.height && areas < MOST_AREAS && r >= 0 && !is_given_up(page);
         i++) {
        struct area area;

        if (!print[i])
            continue;
        area = take_area(&blocks, i % blocks.width, i / blocks.width);
        if (area.x1 - area.x0 < LEAST_BLOCKS || area.y1 - area.y0 < LEAST_BLOCKS ||
            (area.x1 - area.x0) * (area.y1 - area.y0) * MOST_SHARE > blocks.width * blocks.height)
            continue;
        areas++;
        r = read_area(page, &area, picture, err);
    }
    return r;
}

int gsn_codes_read(struct gsn_picture *picture, struct gsn_error *err)
{
    const struct gsn_image *image = picture->image;
    const uint32_t longest = image->width > image->height ? image->width : image->height;
    const unsigned step = (longest + LONGEST - 1) / LONGEST;
    struct code_page page = { .width = image->width / step,
                              .height = image->height / step,
                              .until_cpu_ms = gsn_process_cpu_ms() + MOST_CPU_MS };
    gsn_auto_mem(uint8_t) grey = NULL;
    int r;

    if (page.width < BLOCK || page.height < BLOCK)
        return GSN_OK;
    grey = gsn_alloc((size_t)page.width * page.height);
    if (!grey)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
    for (uint32_t y = 0; y < page.height; y++)
        for (uint32_t x = 0; x < page.width; x++)
            grey[(size_t)y * page.width + x] = mean_brightest(image, x * step, y * step, step);
    page.grey = grey;
    r = longest <= SMALL ? read_page(&page, picture, err) : read_areas(&page, picture, err);
    if (r >= 0 && picture->code_count == 0 && is_given_up(&page))
        gsn_picture_remark(picture, "no code was found within the time for it: much on this "
                                    "picture looks like print");
    return r;
}
