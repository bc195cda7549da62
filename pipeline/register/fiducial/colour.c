/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: Fisher's linear discriminant (1936) of mark and tissue mixes a picture's channels into
 * one plane, in which the mark is localised.
 *
 * Steps of gsn_colour_candidates_find(). 1. Two pixels of a row of each cell stand for it, so that
 * most rows are never read; blobs (blob.h) are found in the first channel; tissue is what is darker
 * than Otsu's level. 2. A window around each blob is kept, and the picture may go. Steps of
 * gsn_colour_candidates_localise(). 1. Blocks of a fifth of a radius in the ring around the mark;
 * those that hold debris or holes are left out. 2. Their differences from block to block are the
 * covariance of what the fit cannot know. 3. The weights, the plane, the fit; where it fails, six
 * more are begun around the middle, since a mark and its debris are one blob from afar.
 *
 * Fails when the pixel size is out of range and when memory runs out. Cost: the pass over the
 * picture is bound by memory, and prefetches the next row. */
#include "pipeline/register/fiducial/colour.h"

#include "pipeline/core/error.h"
#include "pipeline/core/geom.h"
#include "pipeline/core/image.h"
#include "pipeline/core/linalg.h"
#include "pipeline/imaging/threshold.h"
#include "pipeline/register/fiducial/blob.h"
#include "pipeline/register/fiducial/localise.h"
#include "pipeline/register/fiducial/thumbnail.h"
#include "pipeline/register/fiducial/detect.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* One plane out of the channels around a mark, about 0 on tissue and 1 on the mark.
 *
 * The weights are Fisher's: the inverse of the covariance of what the tissue changes over the width
 * of an edge, times the difference of mark and tissue. The blur of the optics mixes transmitted
 * light, not density, so the plane is linear in the codes. */

/* ---- the mixture of the channels ------------------------------------------------------------- */

enum { CHANNELS = 3, CODES = 256 };

/* Where the mark surely is, and where the tissue around it, in radii. A radius may be a third off.
 */
static const double INSIDE = 0.5, RING_FROM = 1.35, RING_TO = 2.0;

/* Blocks of a fifth of a radius stand for a piece of edge; what changes from one to the next is
 * what the fit cannot know of the tissue under it. */
static const double BLOCKS_PER_RADIUS = 5;

enum { BLOCK_MOST = 8, LAG = 1 };

/* A block that goes this far towards the mark, or away from it, is debris or a hole. */
static const double DARK = 0.35, PALE = 0.6;

/* Variance of rounding a sample, in codes of 256, and the share of the overall variance that is
 * always believed in: no mixture is trusted to cancel more than that. */
static const double ROUNDING = 1.0 / 12, RIDGE = 0.003;

struct blocks {
    size_t width, height, side; /* blocks, and pixels along one */
    float *mean;                /* CHANNELS per block; the first is NaN for one that is not used */
};

static double sample_at(const struct gsn_image *image, size_t at)
{
    return image->bits == 8 ? ((const uint8_t *)image->samples)[at]
                            : ((const uint16_t *)image->samples)[at] / 257.0;
}

/* Mean of the mark's inside. */
static void mean_inside(const struct gsn_image *window, struct gsn_point centre, double radius,
                        double *ret_mean)
{
    const double reach = INSIDE * radius;
    double n = 0, sum[CHANNELS] = { 0 };

    for (uint32_t y = (uint32_t)fmax(centre.y - reach, 0);
         y < window->height && y < centre.y + reach; y++) {
        for (uint32_t x = (uint32_t)fmax(centre.x - reach, 0);
             x < window->width && x < centre.x + reach; x++) {
            const double dx = x + 0.5 - centre.x, dy = y + 0.5 - centre.y;

            if (dx * dx + dy * dy > reach * reach)
                continue;
            for (size_t c = 0; c < window->channels; c++)
                sum[c] += sample_at(window, ((size_t)y * window->width + x) * window->channels + c);
            n += 1;
        }
    }
    for (size_t c = 0; c < window->channels; c++)
        ret_mean[c] = sum[c] / fmax(n, 1);
}

static void average_blocks(const struct gsn_image *window, struct gsn_point centre, double radius,
                           struct blocks *blocks)
{
    const size_t side = blocks->side, line = window->width * window->channels;

    for (size_t b = 0; b < blocks->width * blocks->height; b++) {
        const size_t x0 = b % blocks->width * side, y0 = b / blocks->width * side;
        const double dx = ((double)x0 + 0.5 * (double)side - centre.x) / radius;
        const double dy = ((double)y0 + 0.5 * (double)side - centre.y) / radius;
        const double rr = dx * dx + dy * dy;
        float *mean = blocks->mean + CHANNELS * b;

        mean[0] = NAN;
        if (rr < RING_FROM * RING_FROM || rr > RING_TO * RING_TO)
            continue;
        for (size_t c = 0; c < window->channels; c++) {
            double sum = 0;

            for (size_t y = y0; y < y0 + side; y++)
                for (size_t x = x0; x < x0 + side; x++)
                    sum += sample_at(window, y * line + x * window->channels + c);
            mean[c] = (float)(sum / (double)(side * side));
        }
    }
}

/* Channel by channel, to a code: enough to tell tissue from what is not. */
static void median_of_blocks(const struct blocks *blocks, size_t channels, double *ret_median)
{
    for (size_t c = 0; c < channels; c++) {
        unsigned histogram[CODES] = { 0 };
        size_t n = 0, below = 0, code = 0;

        for (size_t b = 0; b < blocks->width * blocks->height; b++) {
            if (isnan(blocks->mean[CHANNELS * b]))
                continue;
            histogram[(size_t)blocks->mean[CHANNELS * b + c]]++;
            n++;
        }
        for (; code + 1 < CODES && 2 * (below + histogram[code]) < n; code++)
            below += histogram[code];
        ret_median[c] = (double)code + 0.5;
    }
}

/* Blocks that hold something else than tissue take no part. */
static void reject_debris(struct blocks *blocks, size_t channels, const double *tissue,
                          const double *contrast)
{
    double length = 0;

    for (size_t c = 0; c < channels; c++)
        length += contrast[c] * contrast[c];
    for (size_t b = 0; b < blocks->width * blocks->height; b++) {
        float *mean = blocks->mean + CHANNELS * b;
        double along = 0;

        for (size_t c = 0; c < channels; c++)
            along += contrast[c] * (tissue[c] - mean[c]);
        if (along > DARK * length || along < -PALE * length)
            mean[0] = NAN;
    }
}

static void add_difference(const float *a, const float *b, size_t channels,
                           double sum[CHANNELS][CHANNELS], double *n)
{
    if (isnan(a[0]) || isnan(b[0]))
        return;
    for (size_t i = 0; i < channels; i++)
        for (size_t k = 0; k < channels; k++)
            sum[i][k] += 0.5 * ((double)a[i] - (double)b[i]) * ((double)a[k] - (double)b[k]);
    *n += 1;
}

static void covariance_of(const struct blocks *blocks, size_t channels,
                          double ret_cov[CHANNELS][CHANNELS])
{
    double n = 0, trace = 0;

    memset(ret_cov, 0, CHANNELS * sizeof *ret_cov);
    for (size_t y = 0; y < blocks->height; y++) {
        for (size_t x = 0; x < blocks->width; x++) {
            const float *at = blocks->mean + CHANNELS * (y * blocks->width + x);

            if (x + LAG < blocks->width)
                add_difference(at, at + LAG * CHANNELS, channels, ret_cov, &n);
            if (y + LAG < blocks->height)
                add_difference(at, at + LAG * CHANNELS * blocks->width, channels, ret_cov, &n);
        }
    }
    for (size_t i = 0; i < channels; i++) {
        for (size_t k = 0; k < channels; k++)
            ret_cov[i][k] /= fmax(n, 1);
        trace += ret_cov[i][i];
    }
    for (size_t i = 0; i < channels; i++)
        ret_cov[i][i] += ROUNDING + RIDGE * trace;
}

/* level less the weighted samples of 8 bits, which are most pictures'. */
static void mix_bytes(const uint8_t *restrict from, size_t count, size_t channels, float level,
                      const float *weight, float *restrict to)
{
    for (size_t i = 0; channels == 1 && i < count; i++)
        to[i] = level - weight[0] * from[i];
    for (size_t i = 0; channels == 3 && i < count; i++)
        to[i] = level - (weight[0] * from[3 * i] + weight[1] * from[3 * i + 1] +
                         weight[2] * from[3 * i + 2]);
}

static void mix_channels(const struct gsn_image *window, const double *tissue, const double *weight,
                         struct gsn_plane *plane)
{
    const size_t channels = window->channels, count = (size_t)plane->width * plane->height;
    float single[CHANNELS] = { 0 };
    double level = 0;

    for (size_t c = 0; c < channels; c++) {
        level += weight[c] * tissue[c];
        single[c] = (float)weight[c];
    }
    if (window->bits == 8) {
        mix_bytes(window->samples, count, channels, (float)level, single, plane->value);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        double sum = level;

        for (size_t c = 0; c < channels; c++)
            sum -= weight[c] * sample_at(window, i * channels + c);
        plane->value[i] = (float)sum;
    }
}

/* borrows: window, with the mark about at centre. gives: ret_plane, of the window's size.
 * ret_contrast: by how much the mark is darker in the first channel, log10. Fails with
 * GSN_E_NOMEM. */
static int mix_window(const struct gsn_image *window, struct gsn_point centre, double radius_px,
                      struct gsn_plane **ret_plane, double *ret_contrast, struct gsn_error *err)
{
    const size_t side = (size_t)fmin(fmax(floor(radius_px / BLOCKS_PER_RADIUS), 1), BLOCK_MOST);
    struct blocks blocks = { window->width / side, window->height / side, side, NULL };
    const size_t count = blocks.width * blocks.height + 1, channels = window->channels;
    gsn_auto_mem(float) mean = gsn_alloc_array(CHANNELS * count, sizeof *mean);
    gsn_auto(gsn_plane) plane = NULL;
    double mark[CHANNELS], tissue[CHANNELS] = { 0 }, contrast[CHANNELS], weight[CHANNELS];
    double cov[CHANNELS][CHANNELS], length = 0;
    int r;

    assert(window && radius_px > 0 && ret_plane && ret_contrast);

    if (!mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the window of a mark");
    r = gsn_plane_new(window->width, window->height, &plane, err);
    if (r < 0)
        return r;
    blocks.mean = mean;
    mean_inside(window, centre, radius_px, mark);
    average_blocks(window, centre, radius_px, &blocks);
    median_of_blocks(&blocks, channels, tissue);
    for (size_t c = 0; c < channels; c++)
        weight[c] = contrast[c] = tissue[c] - mark[c];
    reject_debris(&blocks, channels, tissue, contrast);
    covariance_of(&blocks, channels, cov);
    /* ROUNDING keeps it definite; else the plain contrast serves. */
    (void)gsn_solve_spd(&cov[0][0], channels, CHANNELS, weight);
    for (size_t c = 0; c < channels; c++)
        length += weight[c] * contrast[c];
    for (size_t c = 0; c < channels; c++)
        weight[c] /= fmax(length, 1e-9);
    mix_channels(window, tissue, weight, plane);
    *ret_contrast = log10((tissue[0] + 0.5) / (mark[0] + 0.5));
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}

/* ---- blobs of a picture ---------------------------------------------------------------------- */

enum { SAMPLES = 2 };

/* A blob this much fainter than the strongest is none of three marks burnt alike, were the
 * strongest a blot of ink. */
static const double FAINTEST = 0.125;
static const double PX_MOST_UM = 40;

/* Where else a fit is begun when it fails from the middle of a blob: in radii, and how often. */
static const double BESIDE = 0.6;

enum { AROUND = 6 };

/* A window reaches a little further than the fit's, from a centre that may be half a cell off. */
static const double WINDOW = 2.1;

/* -log10 of SAMPLES times a code out of 256; the offset and the curve do not matter here. */
static void density_table(float *table, size_t samples)
{
    for (size_t i = 0; i <= samples * (CODES - 1); i++)
        table[i] =
            (float)-log10(((double)i + 0.5 * (double)samples) / ((double)samples * (double)CODES));
}

/* A sample cut down to 8 bits. */
static inline unsigned code_at(const struct gsn_image *image, size_t sample)
{
    return image->bits == 8 ? ((const uint8_t *)image->samples)[sample]
                            : (unsigned)(((const uint16_t *)image->samples)[sample] >> 8);
}

static void reduce_bytes(const uint8_t *row, size_t near, size_t far, size_t apart, size_t count,
                         size_t ahead, const float *table, float *restrict od)
{
    const uint8_t *a = row + near, *b = row + far;

    for (size_t i = 0; i < count; i++, a += apart, b += apart) {
        /* Rows are far apart, and no processor guesses the next one. */
        __builtin_prefetch(a + ahead);
        od[i] = table[*a + *b];
    }
}

/* Two pixels of a cell stand for it: more would find no more marks, and cost another pass over the
 * picture. */
static void reduce_picture(const struct gsn_image *image, size_t step, struct gsn_blob_field *field)
{
    const size_t near = step / 4, far = step - 1 - step / 4, channels = image->channels;
    float table[SAMPLES * (CODES - 1) + 1];

    density_table(table, SAMPLES);
    for (size_t y = 0; y < field->height; y++) {
        const size_t row = (y * step + step / 2) * image->width;
        float *od = field->od + y * field->width;

        if (image->bits == 8) {
            reduce_bytes((const uint8_t *)image->samples + row * channels, near * channels,
                         far * channels, step * channels, field->width,
                         step * image->width * channels, table, od);
            continue;
        }
        for (size_t x = 0; x < field->width; x++)
            od[x] = table[code_at(image, (row + x * step + near) * channels) +
                          code_at(image, (row + x * step + far) * channels)];
    }
}

/* Centre of what is darker, in its darkest channel, than the glass (Otsu 1979): one pixel of every
 * fourth cell in both directions, of those that the reduction has just read. */
static struct gsn_point find_tissue(const struct gsn_image *image, size_t step)
{
    const size_t apart = 4 * step, channels = image->channels;
    size_t histogram[CODES] = { 0 };
    double sum_x = 0, sum_y = 0, n = 0, between;
    size_t level = 0;

    for (int pass = 0; pass < 2; pass++) {
        for (size_t y = step / 2; y < image->height; y += apart) {
            for (size_t x = step / 4; x < image->width; x += apart) {
                const size_t at = (y * image->width + x) * channels;
                unsigned darkest = code_at(image, at);

                for (size_t c = 1; c < channels; c++)
                    if (code_at(image, at + c) < darkest)
                        darkest = code_at(image, at + c);
                if (pass == 0) {
                    histogram[darkest]++;
                } else if (darkest < level) {
                    sum_x += (double)x;
                    sum_y += (double)y;
                    n += 1;
                }
            }
        }
        level = gsn_otsu_cut(histogram, CODES, &between);
        level = between > 0 ? level : 0;
    }
    return n > 0 ? (struct gsn_point){ sum_x / n + 0.5, sum_y / n + 0.5 }
                 : (struct gsn_point){ image->width / 2.0, image->height / 2.0 };
}

static int cut_window(const struct gsn_image *image, struct gsn_colour_candidates *found, size_t i,
                      struct gsn_error *err)
{
    const struct gsn_fiducial *mark = &found->candidates.mark[i];
    const double reach = WINDOW * mark->radius_px + 2;
    const int x0 = (int)fmax(floor(mark->px.x - reach), 0);
    const int y0 = (int)fmax(floor(mark->px.y - reach), 0);
    const int x1 = (int)fmin(ceil(mark->px.x + reach), image->width);
    const int y1 = (int)fmin(ceil(mark->px.y + reach), image->height);
    const size_t size = image->channels * image->bits / 8;
    const int r = gsn_image_new((uint32_t)(x1 - x0), (uint32_t)(y1 - y0), image->channels,
                                image->bits, &found->window[i], err);

    if (r < 0)
        return r;
    for (int y = y0; y < y1; y++)
        memcpy((char *)found->window[i]->samples + (size_t)(y - y0) * (size_t)(x1 - x0) * size,
               (const char *)image->samples + ((size_t)y * image->width + (size_t)x0) * size,
               (size_t)(x1 - x0) * size);
    found->x[i] = x0;
    found->y[i] = y0;
    return GSN_OK;
}

int gsn_colour_candidates_find(const struct gsn_image *picture, double px_um,
                               struct gsn_colour_candidates **ret_found, struct gsn_error *err)
{
    gsn_auto(gsn_colour_candidates) found = gsn_alloc_array(1, sizeof *found);
    gsn_auto_mem(float) od = NULL;
    struct gsn_blob_field field = { .cell_px = 1 };
    size_t step;
    int r;

    assert(picture && ret_found);

    if (!(px_um > 0 && px_um <= PX_MOST_UM))
        return gsn_fail(err, GSN_E_INPUT,
                        "a pixel of %g um: marks need a pixel size above 0 and up to %g um", px_um,
                        PX_MOST_UM);
    step = gsn_blob_cell_px(px_um);
    field.cell_px = (double)step;
    field.width = picture->width / step;
    field.height = picture->height / step;
    od = gsn_alloc((field.width * field.height + 1) * sizeof *od);
    if (!found || !od)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    field.od = od;
    reduce_picture(picture, step, &field);
    gsn_thumbnail_take(&field, &found->candidates.map);
    found->candidates.px_um = px_um;
    found->candidates.tissue_px = find_tissue(picture, step);
    r = gsn_blobs_find(&field, px_um, GSN_FIDUCIAL_CANDIDATES, found->candidates.mark,
                       &found->candidates.count, err);
    while (found->candidates.count > 0 &&
           found->candidates.mark[found->candidates.count - 1].contrast <
               FAINTEST * found->candidates.mark[0].contrast)
        found->candidates.count--;
    for (size_t i = 0; r >= 0 && i < found->candidates.count; i++)
        r = cut_window(picture, found, i, err);
    if (r < 0)
        return r;
    *ret_found = gsn_steal(&found);
    return GSN_OK;
}

/* A picture's red channel, and the optical density of its codes. */
struct red {
    const struct gsn_image *image;
    float table[CODES];
};

static void red_row(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                    float *to)
{
    const struct red *red = context;
    const size_t first = (size_t)y * red->image->width + x;

    for (size_t i = 0; i < count; i++)
        to[i] = red->table[code_at(red->image, (first + i * apart) * red->image->channels)];
}

int gsn_colour_candidates_find_burns(const struct gsn_image *picture, double px_um,
                                     struct gsn_point tissue_px, unsigned burn,
                                     struct gsn_fiducial_candidates *ret_candidates,
                                     struct gsn_error *err)
{
    const struct gsn_slot slot = { .found = 1,
                                   .width = (int)picture->width,
                                   .height = (int)picture->height,
                                   .centre_px = tissue_px };
    struct red red = { .image = picture };
    const struct gsn_density_source density = { picture->width, picture->height, &red, red_row };

    assert(picture && ret_candidates);

    density_table(red.table, 1);
    return gsn_fiducials_detect_burn(&density, &slot, px_um, burn, ret_candidates, err);
}

void gsn_colour_candidates_free(struct gsn_colour_candidates *found)
{
    if (!found)
        return;
    for (size_t i = 0; i < GSN_FIDUCIAL_CANDIDATES; i++)
        gsn_image_free(found->window[i]);
    gsn_free(found);
}

/* ---- localised when it matters --------------------------------------------------------------- */

/* The fit from one start, in the picture's pixels. */
static int fit_once(const struct gsn_colour_candidates *found, size_t i, struct gsn_point at,
                    struct gsn_fiducial *ret_mark, struct gsn_error *err)
{
    const double radius = found->candidates.mark[i].radius_px;
    const struct gsn_point start = { at.x - found->x[i], at.y - found->y[i] };
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_fiducial mark;
    double contrast;
    int r = mix_window(found->window[i], start, radius, &plane, &contrast, err);

    if (r >= 0)
        r = gsn_fiducial_localise(plane, start, radius, &mark, err);
    if (r < 0)
        return r;
    mark.px.x += found->x[i];
    mark.px.y += found->y[i];
    mark.contrast = contrast;
    *ret_mark = mark;
    return GSN_OK;
}

int gsn_colour_candidates_localise(struct gsn_colour_candidates *found, size_t i,
                                   struct gsn_error *err)
{
    struct gsn_fiducial best = { 0 };
    struct gsn_point at;
    double beside;
    int r;

    assert(found && i < found->candidates.count);

    if (found->measured[i])
        return GSN_OK;
    at = found->candidates.mark[i].px;
    beside = BESIDE * found->candidates.mark[i].radius_px;
    r = fit_once(found, i, at, &best, err);
    /* A mark and its debris are one spot from afar, and its middle may be on neither. */
    for (int k = 0; r >= 0 && !best.found && k < AROUND; k++) {
        const double angle = 2 * M_PI * k / AROUND;

        r = fit_once(found, i,
                     (struct gsn_point){ at.x + beside * cos(angle), at.y + beside * sin(angle) },
                     &best, err);
    }
    if (r < 0)
        return r;
    found->measured[i] = 1;
    if (best.found)
        found->candidates.mark[i] = best;
    else
        found->candidates.mark[i].score = 0;
    return GSN_OK;
}
