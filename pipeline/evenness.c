/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/evenness.h"

#include "pipeline/core/robust.h"

#include <math.h>

/* Paler than this, a pixel of a section's box is glass, fat or marrow. */
static const double PALE = 0.1;
/* The share of the tissue that counts as the strongest stained, by its lower end. */
static const double STRONGEST = 0.95;

enum { MOST_SAMPLES = 100000, LEAST_SAMPLES = 200 };

unsigned gsn_evenness_apart(int width, int height)
{
    return (unsigned)((double)width * height / MOST_SAMPLES) + 1;
}

int gsn_evenness_of_section(const struct gsn_plane *density, double *ret_strength,
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

double gsn_evenness_of_panel(double *strength, size_t count)
{
    size_t known = 0;

    for (size_t i = 0; i < count; i++)
        if (!isnan(strength[i]))
            strength[known++] = strength[i];
    return known > 0 ? gsn_order_pick(strength, known, known / 2) : (double)NAN;
}

/* Student's t for 95 %, two sides, over that of the normal distribution. */
static double widening(size_t freedom)
{
    static const double t[] = { 12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262 };
    const size_t known = sizeof t / sizeof t[0];

    return freedom == 0 ? 1 : freedom <= known ? t[freedom - 1] / 1.96 : 1 + 1.2 / (double)freedom;
}

struct gsn_evenness gsn_evenness_of(const double *strength, size_t count, size_t inside)
{
    struct gsn_evenness e = { .panels = 0 };
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
    e.error = widening(e.panels - 1) * e.scatter / sqrt((double)inside);
    return e;
}
