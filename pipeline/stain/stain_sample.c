/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sampling stained pixels, and the look of a slide.
 *
 * Of a panel an even choice of at most 4000 pixels is taken, among those that tell a hue: not as
 * pale as glass, and not so dark that noise hides a channel. Codes are read with the same error
 * everywhere, densities with one that grows as the light falls; each pixel carries that noise.
 *
 * Whether a slide looks like Van Gieson is told by what its pixels at large absorb, and by the
 * median angle to the nearest mixture of the dyes. A few pixels of pen, dirt or JPEG's making lie
 * at every extreme, so no extreme is asked (Macenko et al. 2009 take percentiles of the hue for the
 * same reason; their beta, 0.15, is the length below which a hue is noise). A slide with fewer than
 * 1000 stained pixels, without picric acid's yellow or without acid fuchsin's red is refused. */
#include "pipeline/stain/stain_sample.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/stain/optical_density.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>

/* Optical densities. */
#define TOO_NOISY 0.1 /* a channel whose noise is larger holds no hue any more */
#define PALEST 0.05   /* length below which white errors of a percent turn the hue by 5 degrees */
#define SRGB_TOE 0.04045 /* below this code the curve is a line (IEC 61966-2-1) */
#define QUANTISED 0.001  /* noise of a scan of 8 bits that claims to have none */

/* JPEG evens out the glass and not the tissue, so the glass tells of less noise than tissue has:
 * there it is two codes of 255 at the least. */
#define TISSUE_NOISE 0.003

enum { MOST_PER_PANEL = 4000 };

int gsn_stain_sample_new(struct gsn_stain_sample **ret_sample, struct gsn_error *err)
{
    struct gsn_stain_sample *sample = gsn_alloc_array(1, sizeof *sample);

    if (!sample)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the dyes of a slide");
    *ret_sample = sample;
    return GSN_OK;
}

void gsn_stain_sample_free(struct gsn_stain_sample *sample)
{
    if (!sample)
        return;
    gsn_free(sample->pixel);
    gsn_free(sample);
}

/* Optical density per code (of 0..1) at this light: how far an error of the code reaches. */
static double reach_of_code(enum gsn_light light, double linear)
{
    /* The codes that a profile was undone for had a curve much like that of sRGB. */
    const double code =
        gsn_light_encode(light == GSN_LIGHT_CODES_LINEAR ? light : GSN_LIGHT_SRGB, linear);

    if (light == GSN_LIGHT_CODES_LINEAR || code <= SRGB_TOE)
        return M_LOG10E / code;
    return 2.4 * M_LOG10E / (code + 0.055);
}

/* Which densities speak, and how noisy they are. */
struct limits {
    enum gsn_light light;
    double white[3], noise[3]; /* light of the glass; its noise over that of a code */
    double palest, darkest[3];
    double rougher; /* noise of tissue over that of the glass */
};

static double deviation_at(const struct limits *limits, int c, double density)
{
    const double light = limits->white[c] * pow(10, -fmax(density, 0));

    return limits->noise[c] * reach_of_code(limits->light, light);
}

/* Codes are read with the same error everywhere, densities with one that grows as the light
 * falls: the darkest that speaks is found by halving. */
static struct limits limits_of(const struct gsn_flat_field *glass)
{
    const double noise = fmax(glass->noise_od, QUANTISED);
    struct limits limits = { .light = glass->light,
                             .palest = fmax(PALEST, 10 * noise),
                             .rougher = fmax(TISSUE_NOISE / noise, 1) };

    for (int c = 0; c < 3; c++) {
        double low = 0, high = 5;

        limits.white[c] =
            gsn_light_of_sample(glass->light, (unsigned)lround(fmax(glass->white[c], 1)), 8);
        limits.noise[c] = noise / reach_of_code(glass->light, limits.white[c]);
        for (int i = 0; i < 30; i++) {
            const double middle = (low + high) / 2;

            if (deviation_at(&limits, c, middle) < TOO_NOISY)
                low = middle;
            else
                high = middle;
        }
        limits.darkest[c] = low;
    }
    return limits;
}

static int tells_hue(struct gsn_plane *const od[3], const struct gsn_image *mask,
                     const struct limits *limits, size_t i)
{
    const double d[3] = { od[0]->value[i], od[1]->value[i], od[2]->value[i] };

    if (mask && ((const uint8_t *)mask->samples)[i] == 0)
        return 0;
    return d[0] < limits->darkest[0] && d[1] < limits->darkest[1] && d[2] < limits->darkest[2] &&
           d[0] * d[0] + d[1] * d[1] + d[2] * d[2] > limits->palest * limits->palest;
}

int gsn_stain_sample_add(struct gsn_stain_sample *sample, struct gsn_plane *const od[3],
                         const struct gsn_image *mask, const struct gsn_flat_field *glass,
                         struct gsn_error *err)
{
    struct gsn_stain_pixel *more;
    const struct limits limits = limits_of(glass);
    size_t speaking = 0, seen = 0, stride;
    int r = gsn_od_check(od, mask, err);

    if (r < 0)
        return r;

    const size_t pixels = (size_t)od[0]->width * od[0]->height;

    for (size_t i = 0; i < pixels; i++)
        speaking += (size_t)tells_hue(od, mask, &limits, i);
    stride = speaking / MOST_PER_PANEL + 1;
    more = gsn_realloc_array(sample->pixel, sample->count + speaking / stride + 1, sizeof *more);
    if (!more)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the dyes of a slide");
    sample->pixel = more;
    for (size_t i = 0; i < pixels; i++) {
        struct gsn_stain_pixel pixel;

        if (!tells_hue(od, mask, &limits, i) || seen++ % stride != 0)
            continue;
        for (int c = 0; c < 3; c++) {
            pixel.od[c] = od[c]->value[i];
            pixel.noise[c] = (float)(limits.rougher * deviation_at(&limits, c, od[c]->value[i]));
        }
        sample->pixel[sample->count++] = pixel;
    }
    return GSN_OK;
}

/* ---- the look of a slide ----------------------------------------------------------------- */

/* Picric acid absorbs blue 2.7 times as much as green, and half as yellow is a pixel that it fills.
 * Acid fuchsin absorbs green more than red by three tenths of all that it absorbs, haematoxylin and
 * picric acid by a twentieth at most; so what a pixel holds of it shows under any amount of yellow.
 */
static const double YELLOW = 1.5, RED = 0.12;

/* Of the stained pixels. Van Gieson's and picrosirius' have 0.4 and more of yellow,
 * haematoxylin and eosin's 0.01 at most. */
static const double LEAST_SHARE = 0.02;

/* The angle between a density and the nearest mixture. */
static double apart_deg(const struct gsn_unmixer *mix, const double od[3])
{
    return asin(fmin(gsn_unmixer_left(mix, od) / gsn_length3(od), 1)) * 180 / M_PI;
}

static int judge_look(const struct gsn_stain_look *look, struct gsn_error *err)
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

        if (!(gsn_length3(od) > GSN_PALE_OD))
            continue;
        look.pixels++;
        yellow += od[2] > YELLOW * od[1];
        red += od[1] - od[0] > RED * (od[0] + od[1] + od[2]);
    }
    look.yellow = look.pixels > 0 ? (double)yellow / (double)look.pixels : 0;
    look.red = look.pixels > 0 ? (double)red / (double)look.pixels : 0;
    r = judge_look(&look, err);
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
    if (middle > GSN_STAIN_APART_DEG)
        return gsn_fail(err, GSN_E_STAIN,
                        "this does not look like Van Gieson: half of its stained pixels lie more "
                        "than %.0f degrees from every mixture of fuchsin, picric acid and "
                        "haematoxylin",
                        middle);
    *ret_apart_deg = middle;
    return GSN_OK;
}
