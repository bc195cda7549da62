/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: decimation by the mean of nine pixels a cell, at the middles of equal parts of it.
 *
 * Of a cell of 50 um, in a scan of some 5 um a pixel, three rows of ten are read: what the panel's
 * outlines are told from need not be free of aliasing, and the pass is bound by memory. Sums of
 * whole codes, so the same everywhere. 8 bits and 3 channels have a loop of their own.
 *
 * Fails when not one cell fits, and when memory runs out. */
#include "pipeline/register/panel/reduce.h"

#include <assert.h>
#include <math.h>

static const double CELL_UM = 50;

/* Pixels read of a cell, along each side: noise falls to a third, and nine are enough for a cell at
 * a section's edge to fall on the right side more often than not. */
enum { TAPS = 3 };

unsigned gsn_panel_step(double px_um)
{
    assert(px_um > 0);
    return (unsigned)fmin(fmax(floor(CELL_UM / px_um), 1), 1000);
}

struct taps {
    unsigned count;      /* 1 to TAPS */
    size_t offset[TAPS]; /* pixels from the cell's first */
};

/* The middles of as many equal parts of a cell. */
static struct taps taps_of(unsigned step)
{
    struct taps taps = { .count = step < TAPS ? step : TAPS };

    for (unsigned i = 0; i < taps.count; i++)
        taps.offset[i] = (2 * i + 1) * step / (2 * taps.count);
    return taps;
}

/* Three rows at a time, so that the sums of a cell stay in registers. */
static void cells_rgb8(const uint8_t *const row[TAPS], const struct taps *taps, unsigned step,
                       size_t cells, uint16_t *to)
{
    const size_t a = 3 * taps->offset[0], b = 3 * taps->offset[1], c = 3 * taps->offset[2];

    for (size_t i = 0; i < cells; i++) {
        const size_t at = 3 * i * step;

        for (size_t k = at; k < at + 3; k++) {
            const int sum = row[0][k + a] + row[0][k + b] + row[0][k + c] + row[1][k + a] +
                            row[1][k + b] + row[1][k + c] + row[2][k + a] + row[2][k + b] +
                            row[2][k + c];

            *to++ = (uint16_t)((sum * 257 + TAPS * TAPS / 2) / (TAPS * TAPS));
        }
    }
}

static void cells_any(const struct gsn_image *image, const struct taps *taps, unsigned step,
                      size_t y, size_t cells, uint16_t *to)
{
    const unsigned stretch = image->bits == 8 ? 257 : 1, n = taps->count * taps->count;

    for (size_t i = 0; i < cells; i++)
        for (unsigned c = 0; c < image->channels; c++) {
            unsigned sum = 0;

            for (unsigned k = 0; k < n; k++)
                sum += gsn_image_at(image, (uint32_t)(i * step + taps->offset[k % taps->count]),
                                    (uint32_t)(y * step + taps->offset[k / taps->count]), c);
            *to++ = (uint16_t)((sum * stretch + n / 2) / n);
        }
}

int gsn_panel_reduce(const struct gsn_image *image, unsigned step, struct gsn_image **ret_small,
                     struct gsn_error *err)
{
    const struct taps taps = taps_of(step);
    const uint32_t width = image->width / step, height = image->height / step;
    gsn_auto(gsn_image) small = NULL;
    int r;

    if (width < 1 || height < 1)
        return gsn_fail(err, GSN_E_INPUT, "a panel of %u x %u pixels is too small to be split",
                        image->width, image->height);
    r = gsn_image_new(width, height, image->channels, 16, &small, err);
    if (r < 0)
        return r;
    for (size_t y = 0; y < height; y++) {
        uint16_t *to = (uint16_t *)small->samples + y * width * image->channels;
        const uint8_t *row[TAPS];

        if (image->bits != 8 || image->channels != 3 || taps.count < TAPS) {
            cells_any(image, &taps, step, y, width, to);
            continue;
        }
        for (size_t k = 0; k < TAPS; k++)
            row[k] = (const uint8_t *)image->samples +
                     3 * (size_t)image->width * (y * step + taps.offset[k]);
        cells_rgb8(row, &taps, step, width, to);
    }
    *ret_small = gsn_steal(&small);
    return GSN_OK;
}
