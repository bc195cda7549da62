/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/redness.h"

#include <assert.h>
#include <math.h>
#include <string.h>

#include "pipeline/core/parallel.h"
#include "pipeline/stain/light.h"
#include "pipeline/stain/segment.h"
#include "pipeline/stain/unmix.h"

/* Rows handed to a thread at once: enough to outweigh the hand-over. */
enum { ROWS = 32 };

static size_t bands(uint32_t height)
{
    return ((size_t)height + ROWS - 1) / ROWS;
}

static uint32_t band_end(size_t band, uint32_t height)
{
    const size_t end = (band + 1) * ROWS;

    return end < height ? (uint32_t)end : height;
}

static int same_size(const struct gsn_plane *a, const struct gsn_plane *b)
{
    return a->width == b->width && a->height == b->height;
}

static int check_three(struct gsn_plane *const od[3], struct gsn_error *err)
{
    for (int c = 1; c < 3; c++)
        if (!same_size(od[0], od[c]))
            return gsn_fail(err, GSN_E_INPUT,
                            "the optical densities differ in size: %u x %u, %u x %u", od[0]->width,
                            od[0]->height, od[c]->width, od[c]->height);
    return GSN_OK;
}

int gsn_unmix_one(const double od[3], const struct gsn_dyes *dyes, double ret_amount[3],
                  struct gsn_error *err)
{
    struct gsn_unmixer mix;
    const int r = gsn_unmixer_init(&mix, dyes, err);

    if (r >= 0)
        gsn_unmixer_apply(&mix, od, ret_amount);
    return r;
}

struct unmix_work {
    const struct gsn_unmixer *mix;
    struct gsn_plane *const *od;
    struct gsn_plane *out[3]; /* NULL where not wanted */
    double full_red_od;
};

static int unmix_band(size_t band, void *context, struct gsn_error *err)
{
    const struct unmix_work *work = context;
    const size_t width = work->od[0]->width;
    const size_t end = width * band_end(band, work->od[0]->height);

    (void)err;
    for (size_t i = width * band * ROWS; i < end; i++) {
        const double od[3] = { work->od[0]->value[i], work->od[1]->value[i],
                               work->od[2]->value[i] };
        double amount[3];

        gsn_unmixer_apply(work->mix, od, amount);
        amount[0] /= work->full_red_od;
        for (int k = 0; k < 3; k++)
            if (work->out[k])
                work->out[k]->value[i] = (float)amount[k];
    }
    return GSN_OK;
}

int gsn_unmix(struct gsn_plane *const od[3], const struct gsn_dyes *dyes, unsigned threads,
              struct gsn_plane **ret_red, struct gsn_plane **ret_yellow,
              struct gsn_plane **ret_dark, struct gsn_error *err)
{
    const uint32_t width = od[0]->width, height = od[0]->height;
    gsn_auto(gsn_plane) red = NULL;
    gsn_auto(gsn_plane) yellow = NULL;
    gsn_auto(gsn_plane) dark = NULL;
    struct gsn_unmixer mix;
    int r;

    r = check_three(od, err);
    if (r >= 0)
        r = gsn_unmixer_init(&mix, dyes, err);
    if (r >= 0)
        r = gsn_plane_new(width, height, &red, err);
    if (r >= 0 && ret_yellow)
        r = gsn_plane_new(width, height, &yellow, err);
    if (r >= 0 && ret_dark)
        r = gsn_plane_new(width, height, &dark, err);
    if (r < 0)
        return r;

    struct unmix_work work = { &mix, od, { red, yellow, dark }, dyes->full_red_od };

    r = gsn_parallel_for(bands(height), threads, unmix_band, &work, err);
    if (r < 0)
        return r;
    *ret_red = gsn_steal(&red);
    if (ret_yellow)
        *ret_yellow = gsn_steal(&yellow);
    if (ret_dark)
        *ret_dark = gsn_steal(&dark);
    return GSN_OK;
}

int gsn_red_share(const struct gsn_plane *red, const struct gsn_plane *yellow,
                  const struct gsn_plane *dark, const struct gsn_dyes *dyes,
                  struct gsn_plane **ret_share, struct gsn_error *err)
{
    gsn_auto(gsn_plane) share = NULL;
    int r;

    if (!same_size(red, yellow) || !same_size(red, dark))
        return gsn_fail(err, GSN_E_INPUT, "the planes of the dyes differ in size");
    r = gsn_plane_new(red->width, red->height, &share, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < (size_t)red->width * red->height; i++) {
        const double amount = red->value[i] * dyes->full_red_od;
        const double all = amount + yellow->value[i] + dark->value[i];

        share->value[i] = all > GSN_PALE_OD ? (float)(amount / all) : 0;
    }
    *ret_share = gsn_steal(&share);
    return GSN_OK;
}

/* The middle of the emptiest stretch of the histogram below `end`, of the first where several are
 * equally empty; values start at 0. */
static double valley(const float *values, size_t count, double end)
{
    enum { BINS = 128, AROUND = 3 };
    size_t bin[BINS] = { 0 }, least = SIZE_MAX;
    int first = 0, last = 0;

    for (size_t i = 0; i < count; i++)
        if (values[i] < end)
            bin[(size_t)(values[i] / end * BINS)]++;
    for (int i = AROUND; i < BINS - AROUND; i++) {
        size_t sum = 0;

        for (int j = i - AROUND; j <= i + AROUND; j++)
            sum += bin[j];
        if (sum < least) {
            least = sum;
            first = i;
            last = i;
        } else if (sum == least && last + 1 == i) {
            last = i;
        }
    }
    return end * ((first + last) / 2 + 0.5) / BINS;
}

/* The palest stain that a scan of 8 bits tells from glass, R + G + B. */
#define PALEST 0.05

int gsn_tissue_plane(struct gsn_plane *const od[3], const struct gsn_glass *glass,
                     struct gsn_plane **ret_total, double *ret_threshold, struct gsn_error *err)
{
    const size_t count = (size_t)od[0]->width * od[0]->height;
    gsn_auto(gsn_plane) total = NULL;
    gsn_auto_mem(float) root = NULL;
    double split;
    int r = check_three(od, err);

    if (r >= 0)
        r = gsn_plane_new(od[0]->width, od[0]->height, &total, err);
    if (r < 0)
        return r;
    root = gsn_alloc_array(count, sizeof *root);
    if (!root)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue threshold");

    /* The root spreads what is pale and draws dark marks nearer to the tissue. */
    for (size_t i = 0; i < count; i++) {
        total->value[i] = od[0]->value[i] + od[1]->value[i] + od[2]->value[i];
        root[i] = sqrtf(fmaxf(total->value[i], 0));
    }
    split = gsn_otsu(root, count);
    if (split > 0)
        split = valley(root, count, split);
    /* The noises of three channels add in squares. */
    *ret_threshold = fmax(fmax(split * split, 6 * sqrt(3) * glass->noise_od), PALEST);
    *ret_total = gsn_steal(&total);
    return GSN_OK;
}
