/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/codes.h"

#include <math.h>

#include <dmtx.h>

/* The library looks for edges on a grid: a symbol of ten modules of two pixels is met by it. What
 * looks like a symbol and is none costs time: tries are counted, so that the same picture has the
 * same codes on every machine, and timed, so that a picture without codes holds up nobody. */
enum { SCAN_GAP = 8, MOST_TRIES = 60 };

/* Degrees, clockwise on the picture, by which the symbol's base is turned; the library's y runs
 * up. */
static double turn_of(DmtxRegion *region)
{
    DmtxVector2 base[2] = { { 0, 0 }, { 1, 0 } };

    (void)dmtxMatrix3VMultiplyBy(&base[0], region->fit2raw);
    (void)dmtxMatrix3VMultiplyBy(&base[1], region->fit2raw);
    return atan2(-(base[1].Y - base[0].Y), base[1].X - base[0].X) * 180 / M_PI;
}

/* One look at the page, for so many milliseconds. Returns how many codes were added. */
static int look(DmtxDecode *decoder, int mirrored, long most_ms, struct gsn_picture *picture)
{
    DmtxTime until = dmtxTimeAdd(dmtxTimeNow(), most_ms);
    int added = 0;

    for (int tries = 0; tries < MOST_TRIES; tries++) {
        DmtxRegion *region = dmtxRegionFindNext(decoder, &until);
        DmtxMessage *message;
        struct gsn_printed *code = NULL;

        if (!region)
            break;
        message = dmtxDecodeMatrixRegion(decoder, region, DmtxUndefined);
        if (message)
            code =
                gsn_codes_add(picture, "Data Matrix", message->output, (size_t)message->outputIdx);
        if (code) {
            code->turn_deg = remainder(turn_of(region) + (mirrored ? 180 : 0), 360);
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

static int look_flipped(const struct gsn_code_page *page, int mirrored, struct gsn_picture *picture,
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
    *ret_added = look(decoder, mirrored, (long)(page->until_ms - gsn_codes_clock()), picture);
    (void)dmtxDecodeDestroy(&decoder);
    (void)dmtxImageDestroy(&image);
    return GSN_OK;
}

/* A mirrored symbol cannot be read, so the page is looked at both ways. The library flips top to
 * bottom, which is left to right and half a turn. */
int gsn_codes_dmtx(const struct gsn_code_page *page, struct gsn_picture *picture,
                   struct gsn_error *err)
{
    int added = 0, r = GSN_OK;

    for (int mirrored = 0; r >= 0 && !added && mirrored < 2; mirrored++)
        if (gsn_codes_clock() < page->until_ms)
            r = look_flipped(page, mirrored, picture, &added, err);
    return r;
}
