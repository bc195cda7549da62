/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Mean stain amounts of a section and the strength of its strongest tissue, and what they say of
 * its bath and of its thickness.
 *
 *   - Every k-th pixel of every k-th row, at most 40 000, is unmixed; the mean of each dye stands.
 *   - Yellow over red tells a rinse in alcohol from one in water.
 *   - A section of which all dyes are the same factor above the median of the others, beyond four
 *     of their robust deviations, was cut that much thicker (Beer and Lambert).
 *   - The strength of a section is the density of its strongest stained twentieth, that of a panel
 *     the median of its sections. What panels scatter by is widened by Student's t for few panels.
 *
 * Below 300 pixels of tissue, or five sections, nothing is said: NaN, or a factor of 1. */
#include "pipeline/stain/staining_uniformity.h"

#include "pipeline/core/robust.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>

/* A section of 5 um that was cut at 6 is 1.2 times as thick; knives do worse, tissue less. */
static const double LEAST_FACTOR = 1.2;

/* Dyes that moved together agree within this much (as a logarithm); fewer cells and more fibres
 * move them apart. */
static const double AGREEMENT = 0.1;

/* The others' own scatter, as a logarithm: what is within four of it is one of them. */
static const double DEVIATIONS = 4;

/* A dye of which there is less is mostly noise. */
static const double LEAST_AMOUNT = 0.02;

enum { MOST_LOOKED_AT = 40000, LEAST_PIXELS = 300, LEAST_OTHERS = 4, MOST_SECTIONS = 64 };

static int add_pixel(struct gsn_plane *const od[3], const struct gsn_plane *density,
                     const struct gsn_unmixer *mix, size_t i, struct gsn_stain_amounts *sum)
{
    const double d[3] = { od[0]->value[i], od[1]->value[i], od[2]->value[i] };
    double amount[3];

    if (isnan(density->value[i]) ||
        !(d[0] * d[0] + d[1] * d[1] + d[2] * d[2] > GSN_PALE_OD * GSN_PALE_OD))
        return 0;
    gsn_unmixer_apply(mix, d, amount);
    for (int k = 0; k < 3; k++)
        sum->amount[k] += amount[k];
    return 1;
}

int gsn_stain_amounts_of(struct gsn_plane *const od[3], const struct gsn_plane *density,
                         const struct gsn_dyes *dyes, const struct gsn_pixel_box *box,
                         struct gsn_stain_amounts *ret_tone, struct gsn_error *err)
{
    const int step = 1 + (int)sqrt((double)box->width * box->height / MOST_LOOKED_AT);
    struct gsn_stain_amounts tone = { .pixels = 0 };
    struct gsn_unmixer mix;
    const int r = gsn_unmixer_init(&mix, dyes, err);

    if (r < 0)
        return r;
    for (int y = box->y; y < box->y + box->height; y += step)
        for (int x = box->x; x < box->x + box->width; x += step)
            tone.pixels +=
                (size_t)add_pixel(od, density, &mix, (size_t)y * density->width + (size_t)x, &tone);
    for (int k = 0; k < 3 && tone.pixels > 0; k++)
        tone.amount[k] /= (double)tone.pixels;
    *ret_tone = tone;
    return GSN_OK;
}

struct gsn_stain_amounts gsn_stain_amounts_sum(const struct gsn_stain_amounts *a,
                                               const struct gsn_stain_amounts *b)
{
    struct gsn_stain_amounts sum = { .pixels = a->pixels + b->pixels };

    for (int k = 0; k < 3 && sum.pixels > 0; k++)
        sum.amount[k] = (a->amount[k] * (double)a->pixels + b->amount[k] * (double)b->pixels) /
                        (double)sum.pixels;
    return sum;
}

double gsn_stain_amounts_yellow_to_red(const struct gsn_stain_amounts *tone)
{
    return tone->pixels < LEAST_PIXELS || tone->amount[0] < LEAST_AMOUNT
               ? (double)NAN
               : tone->amount[1] / tone->amount[0];
}

/* The median over the sections of dye k, of those with enough tissue. */
static double median_of(const struct gsn_stain_amounts *tone, size_t count, int k)
{
    double value[MOST_SECTIONS];
    size_t n = 0;

    for (size_t i = 0; i < count && n < MOST_SECTIONS; i++)
        if (tone[i].pixels >= LEAST_PIXELS)
            value[n++] = tone[i].amount[k];
    return n > LEAST_OTHERS ? gsn_order_pick(value, n, n / 2) : 0;
}

/* Mean over the dyes of the logarithm of a section's amount over the usual one; *apart is how far
 * the dyes are from agreeing. */
static double factor_of(const struct gsn_stain_amounts *tone, const double usual[3], double *apart)
{
    double low = INFINITY, high = -INFINITY, sum = 0;
    int dyes = 0;

    for (int k = 0; k < 3; k++) {
        if (!(usual[k] > LEAST_AMOUNT))
            continue;

        const double one = log(fmax(tone->amount[k], LEAST_AMOUNT / 10) / usual[k]);

        low = fmin(low, one);
        high = fmax(high, one);
        sum += one;
        dyes++;
    }
    *apart = dyes < 2 ? INFINITY : high - low;
    return dyes ? sum / dyes : 0;
}

double gsn_stain_amounts_thickness(const struct gsn_stain_amounts *tone, size_t count, size_t which)
{
    double usual[3], scatter[MOST_SECTIONS], factor, apart, unused;
    size_t n = 0;

    for (int k = 0; k < 3; k++)
        usual[k] = median_of(tone, count, k);
    if (tone[which].pixels < LEAST_PIXELS)
        return 1;
    factor = factor_of(&tone[which], usual, &apart);
    for (size_t i = 0; i < count && n < MOST_SECTIONS; i++)
        if (i != which && tone[i].pixels >= LEAST_PIXELS)
            scatter[n++] = fabs(factor_of(&tone[i], usual, &unused));
    if (n < LEAST_OTHERS || apart > AGREEMENT || fabs(factor) < log(LEAST_FACTOR) ||
        fabs(factor) < DEVIATIONS * 1.4826 * gsn_order_pick(scatter, n, n / 2))
        return 1;
    return exp(factor);
}

/* ---- the strongest stained tissue ------------------------------------------------------------ */

/* Paler than this, a pixel of a section's box is glass, fat or marrow. */
static const double PALE = 0.1;

/* The share of the tissue that counts as the strongest stained, by its lower end. */
static const double STRONGEST = 0.95;

enum { MOST_SAMPLES = 100000, LEAST_SAMPLES = 200 };

unsigned gsn_uniformity_rows_apart(int width, int height)
{
    return (unsigned)((double)width * height / MOST_SAMPLES) + 1;
}

int gsn_uniformity_of_section(const struct gsn_plane *density, double *ret_strength,
                              struct gsn_error *err)
{
    const size_t pixels = (size_t)density->width * density->height;
    gsn_auto_mem(double) sample = gsn_alloc_array(pixels, sizeof *sample);
    size_t count = 0;

    if (!sample)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the strength of a stain");
    for (size_t i = 0; i < pixels; i++)
        if ((double)density->value[i] > PALE)
            sample[count++] = density->value[i];
    *ret_strength = count < LEAST_SAMPLES
                        ? (double)NAN
                        : gsn_order_pick(sample, count, (size_t)(STRONGEST * (double)count));
    return GSN_OK;
}

double gsn_uniformity_of_panel(double *strength, size_t count)
{
    size_t known = 0;

    for (size_t i = 0; i < count; i++)
        if (!isnan(strength[i]))
            strength[known++] = strength[i];
    return known > 0 ? gsn_order_pick(strength, known, known / 2) : (double)NAN;
}

/* Student's t for 95 %, two sides, over that of the normal distribution. */
static double student_widening(size_t freedom)
{
    static const double t[] = { 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262 };
    const size_t known = sizeof t / sizeof t[0];

    return freedom == 0 ? 1 : freedom <= known ? t[freedom - 1] / 1.96 : 1 + 1.2 / (double)freedom;
}

struct gsn_uniformity gsn_uniformity_of(const double *strength, size_t count, size_t inside)
{
    struct gsn_uniformity e = { .panels = 0 };
    double sum = 0, squares = 0;

    for (size_t i = 0; i < count; i++)
        if (strength[i] > 0) {
            e.panels++;
            sum += log(strength[i]);
        }
    for (size_t i = 0; i < count; i++)
        if (strength[i] > 0)
            squares += pow(log(strength[i]) - sum / (double)e.panels, 2);
    if (e.panels < 2)
        return e;
    e.scatter = sqrt(squares / (double)(e.panels - 1));
    e.error = student_widening(e.panels - 1) * e.scatter / sqrt((double)inside);
    return e;
}
