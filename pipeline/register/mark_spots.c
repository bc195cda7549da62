/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_spots.h"

#include "pipeline/register/mark_colour.h"
#include "pipeline/register/mark_field.h"
#include "pipeline/register/mark_fit.h"
#include "pipeline/register/mark_map.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { CODES = 256, SAMPLES = 2, CHANNELS = 3 };
/* A spot this much fainter than the strongest is none of three marks burnt alike, were the
 * strongest a blot of ink. */
static const double FAINTEST = 0.125;
static const double PX_MOST_UM = 40;
/* Where else a fit is begun when it fails from the middle of a spot: in radii, and how often. */
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
static void reduce(const struct gsn_image *image, size_t step, struct gsn_mark_field *field)
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

/* The level that parts a histogram into its two most compact halves (Otsu 1979). */
static size_t part(const unsigned *histogram, size_t bins)
{
    double all = 0, sum = 0, below = 0, below_sum = 0, best = 0;
    size_t at = 0;

    for (size_t i = 0; i < bins; i++) {
        all += histogram[i];
        sum += (double)i * histogram[i];
    }
    for (size_t i = 0; i + 1 < bins; i++) {
        double between;

        below += histogram[i];
        below_sum += (double)i * histogram[i];
        if (below == 0 || below == all)
            continue;
        between =
            pow(below_sum / below - (sum - below_sum) / (all - below), 2) * below * (all - below);
        if (between > best) {
            best = between;
            at = i + 1;
        }
    }
    return at;
}

/* Centre of what is darker, in its darkest channel, than the glass: one pixel of every fourth
 * cell in both directions, of those that the reduction has just read. */
static struct gsn_point tissue_of(const struct gsn_image *image, size_t step)
{
    const size_t apart = 4 * step, channels = image->channels;
    unsigned histogram[CODES] = { 0 };
    double sum_x = 0, sum_y = 0, n = 0;
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
        level = part(histogram, CODES);
    }
    return n > 0 ? (struct gsn_point){ sum_x / n + 0.5, sum_y / n + 0.5 }
                 : (struct gsn_point){ image->width / 2.0, image->height / 2.0 };
}

static int cut_window(const struct gsn_image *image, struct gsn_mark_spots *spots, size_t i,
                      struct gsn_error *err)
{
    const struct gsn_mark *mark = &spots->candidates.mark[i];
    const double reach = WINDOW * mark->radius_px + 2;
    const int x0 = (int)fmax(floor(mark->px.x - reach), 0);
    const int y0 = (int)fmax(floor(mark->px.y - reach), 0);
    const int x1 = (int)fmin(ceil(mark->px.x + reach), image->width);
    const int y1 = (int)fmin(ceil(mark->px.y + reach), image->height);
    const size_t size = image->channels * image->bits / 8;
    const int r = gsn_image_new((uint32_t)(x1 - x0), (uint32_t)(y1 - y0), image->channels,
                                image->bits, &spots->window[i], err);

    if (r < 0)
        return r;
    for (int y = y0; y < y1; y++)
        memcpy((char *)spots->window[i]->samples + (size_t)(y - y0) * (size_t)(x1 - x0) * size,
               (const char *)image->samples + ((size_t)y * image->width + (size_t)x0) * size,
               (size_t)(x1 - x0) * size);
    spots->x[i] = x0;
    spots->y[i] = y0;
    return GSN_OK;
}

int gsn_mark_spots_find(const struct gsn_image *picture, double px_um,
                        struct gsn_mark_spots **ret_spots, struct gsn_error *err)
{
    gsn_auto(gsn_mark_spots) spots = gsn_alloc_array(1, sizeof *spots);
    gsn_auto_mem(float) od = NULL;
    struct gsn_mark_field field = { .cell_px = 1 };
    size_t step;
    int r;

    assert(picture && ret_spots);

    if (!(px_um > 0 && px_um <= PX_MOST_UM))
        return gsn_fail(err, GSN_E_INPUT,
                        "a pixel of %g um: marks need a pixel size above 0 and up to %g um", px_um,
                        PX_MOST_UM);
    step = gsn_mark_field_step(px_um);
    field.cell_px = (double)step;
    field.width = picture->width / step;
    field.height = picture->height / step;
    od = gsn_alloc((field.width * field.height + 1) * sizeof *od);
    if (!spots || !od)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while looking for marks");
    field.od = od;
    reduce(picture, step, &field);
    gsn_mark_map_take(&field, &spots->candidates.map);
    spots->candidates.px_um = px_um;
    spots->candidates.tissue_px = tissue_of(picture, step);
    r = gsn_mark_field_spots(&field, px_um, GSN_MARK_CANDIDATES, spots->candidates.mark,
                             &spots->candidates.count, err);
    while (spots->candidates.count > 0 &&
           spots->candidates.mark[spots->candidates.count - 1].contrast <
               FAINTEST * spots->candidates.mark[0].contrast)
        spots->candidates.count--;
    for (size_t i = 0; r >= 0 && i < spots->candidates.count; i++)
        r = cut_window(picture, spots, i, err);
    if (r < 0)
        return r;
    *ret_spots = gsn_steal(&spots);
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

int gsn_mark_spots_find_burns(const struct gsn_image *picture, double px_um,
                              struct gsn_point tissue_px, unsigned burn,
                              struct gsn_mark_candidates *ret_candidates, struct gsn_error *err)
{
    const struct gsn_slot slot = { .found = 1,
                                   .width = (int)picture->width,
                                   .height = (int)picture->height,
                                   .centre_px = tissue_px };
    struct red red = { .image = picture };
    const struct gsn_mark_density density = { picture->width, picture->height, &red, red_row };

    assert(picture && ret_candidates);

    density_table(red.table, 1);
    return gsn_markers_candidates_of(&density, &slot, px_um, burn, ret_candidates, err);
}

void gsn_mark_spots_free(struct gsn_mark_spots *spots)
{
    if (!spots)
        return;
    for (size_t i = 0; i < GSN_MARK_CANDIDATES; i++)
        gsn_image_free(spots->window[i]);
    gsn_free(spots);
}

/* The fit from one start, in the picture's pixels. */
static int fit_from(const struct gsn_mark_spots *spots, size_t i, struct gsn_point at,
                    struct gsn_mark *ret_mark, struct gsn_error *err)
{
    const double radius = spots->candidates.mark[i].radius_px;
    const struct gsn_point start = { at.x - spots->x[i], at.y - spots->y[i] };
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_mark mark;
    double contrast;
    int r = gsn_mark_mix(spots->window[i], start, radius, &plane, &contrast, err);

    if (r >= 0)
        r = gsn_mark_fit(plane, start, radius, &mark, err);
    if (r < 0)
        return r;
    mark.px.x += spots->x[i];
    mark.px.y += spots->y[i];
    mark.contrast = contrast;
    *ret_mark = mark;
    return GSN_OK;
}

int gsn_mark_spots_measure(struct gsn_mark_spots *spots, size_t i, struct gsn_error *err)
{
    struct gsn_mark best = { 0 };
    struct gsn_point at;
    double beside;
    int r;

    assert(spots && i < spots->candidates.count);

    if (spots->measured[i])
        return GSN_OK;
    at = spots->candidates.mark[i].px;
    beside = BESIDE * spots->candidates.mark[i].radius_px;
    r = fit_from(spots, i, at, &best, err);
    /* A mark and its debris are one spot from afar, and its middle may be on neither. */
    for (int k = 0; r >= 0 && !best.found && k < AROUND; k++) {
        const double angle = 2 * M_PI * k / AROUND;

        r = fit_from(spots, i,
                     (struct gsn_point){ at.x + beside * cos(angle), at.y + beside * sin(angle) },
                     &best, err);
    }
    if (r < 0)
        return r;
    spots->measured[i] = 1;
    if (best.found)
        spots->candidates.mark[i] = best;
    else
        spots->candidates.mark[i].score = 0;
    return GSN_OK;
}
