/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a slide looks like Van Gieson: by what its pixels at large absorb. A few pixels of pen,
 * dirt or JPEG's making lie at every extreme, so no extreme is asked. */
#include "pipeline/stain/sample.h"

#include <math.h>

#include "pipeline/core/robust.h"
#include "pipeline/stain/light.h"
#include "pipeline/stain/unmix.h"

static const double MOST_APART_DEG = 8;

/* Picric acid absorbs blue 2.7 times as much as green, and half as yellow is a pixel that it fills.
 * Acid fuchsin absorbs green more than red by three tenths of all that it absorbs, haematoxylin and
 * picric acid by a twentieth at most; so what a pixel holds of it shows under any amount of yellow.
 */
static const double YELLOW = 1.5, RED = 0.12;
/* Of the stained pixels. Van Gieson's and picrosirius' have 0.4 and more of yellow,
 * haematoxylin and eosin's 0.01 at most. */
static const double LEAST_SHARE = 0.02;

static double length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

/* The angle between a density and the nearest mixture. */
static double apart_deg(const struct gsn_unmixer *mix, const double od[3])
{
    return asin(fmin(gsn_unmixer_left(mix, od) / length(od), 1)) * 180 / M_PI;
}

static int judge(const struct gsn_stain_look *look, struct gsn_error *err)
{
    if (look->pixels < GSN_SAMPLE_LEAST)
        return gsn_fail(err, GSN_E_STAIN,
                        "nearly every stained pixel is too pale to tell its dyes");
    if (!(look->yellow >= LEAST_SHARE))
        return gsn_fail(err, GSN_E_STAIN,
                        "this does not look like Van Gieson: %.1f %% of its stained pixels absorb "
                        "blue %.1f times as much as green, as picric acid makes them; %.0f %% are "
                        "the least",
                        100 * look->yellow, YELLOW, 100 * LEAST_SHARE);
    if (!(look->red >= LEAST_SHARE))
        return gsn_fail(err, GSN_E_STAIN,
                        "this does not look like Van Gieson: %.1f %% of its stained pixels absorb "
                        "green as acid fuchsin makes them; %.0f %% are the least",
                        100 * look->red, 100 * LEAST_SHARE);
    return GSN_OK;
}

int gsn_stain_look(const struct gsn_stain_sample *sample, struct gsn_stain_look *ret_look,
                   struct gsn_error *err)
{
    struct gsn_stain_look look = { 0 };
    size_t red = 0, yellow = 0;
    int r;

    if (sample->count < GSN_SAMPLE_LEAST)
        return gsn_fail(err, GSN_E_STAIN,
                        "only %zu pixels are stained; at least %d are needed to tell the dyes",
                        sample->count, GSN_SAMPLE_LEAST);
    for (size_t i = 0; i < sample->count; i++) {
        const float *at = sample->pixel[i].od;
        const double od[3] = { at[0], at[1], at[2] };

        if (!(length(od) > GSN_PALE_OD))
            continue;
        look.pixels++;
        yellow += od[2] > YELLOW * od[1];
        red += od[1] - od[0] > RED * (od[0] + od[1] + od[2]);
    }
    look.yellow = look.pixels > 0 ? (double)yellow / (double)look.pixels : 0;
    look.red = look.pixels > 0 ? (double)red / (double)look.pixels : 0;
    r = judge(&look, err);
    if (r >= 0)
        *ret_look = look;
    return r;
}

int gsn_stain_apart(const struct gsn_stain_sample *sample, const struct gsn_dyes *dyes,
                    double *ret_apart_deg, struct gsn_error *err)
{
    gsn_auto_mem(double) apart = gsn_alloc_array(sample->count + 1, sizeof *apart);
    struct gsn_unmixer mix;
    double middle = 0;
    int r;

    if (!apart)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the look of a slide");
    r = gsn_unmixer_init(&mix, dyes, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < sample->count; i++) {
        const float *od = sample->pixel[i].od;

        apart[i] = apart_deg(&mix, (const double[3]){ od[0], od[1], od[2] });
    }
    if (sample->count >= GSN_SAMPLE_LEAST)
        middle = gsn_order_pick(apart, sample->count, sample->count / 2);
    *ret_apart_deg = middle;
    return GSN_OK;
}

int gsn_stain_fits(const struct gsn_stain_sample *sample, const struct gsn_dyes *dyes,
                   double *ret_apart_deg, struct gsn_error *err)
{
    double middle = 0;
    const int r = gsn_stain_apart(sample, dyes, &middle, err);

    if (r < 0)
        return r;
    if (middle > MOST_APART_DEG)
        return gsn_fail(err, GSN_E_STAIN,
                        "this does not look like Van Gieson: half of its stained pixels lie more "
                        "than %.0f degrees from every mixture of fuchsin, picric acid and "
                        "haematoxylin",
                        middle);
    *ret_apart_deg = middle;
    return GSN_OK;
}
