/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/sample.h"

#include <math.h>
#include <string.h>

#include "pipeline/stain/light.h"

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
static struct limits limits_of(const struct gsn_glass *glass)
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

static int speaks(struct gsn_plane *const od[3], const struct gsn_image *mask,
                  const struct limits *limits, size_t i)
{
    const double d[3] = { od[0]->value[i], od[1]->value[i], od[2]->value[i] };

    if (mask && ((const uint8_t *)mask->samples)[i] == 0)
        return 0;
    return d[0] < limits->darkest[0] && d[1] < limits->darkest[1] && d[2] < limits->darkest[2] &&
           d[0] * d[0] + d[1] * d[1] + d[2] * d[2] > limits->palest * limits->palest;
}

static int check_sizes(struct gsn_plane *const od[3], const struct gsn_image *mask,
                       struct gsn_error *err)
{
    for (int c = 1; c < 3; c++)
        if (od[c]->width != od[0]->width || od[c]->height != od[0]->height)
            return gsn_fail(err, GSN_E_INPUT, "the optical densities differ in size");
    if (mask && (mask->width != od[0]->width || mask->height != od[0]->height ||
                 mask->channels != 1 || mask->bits != 8))
        return gsn_fail(err, GSN_E_INPUT, "the mask is not an 8-bit grey image of %u x %u",
                        od[0]->width, od[0]->height);
    return GSN_OK;
}

int gsn_stain_sample_add(struct gsn_stain_sample *sample, struct gsn_plane *const od[3],
                         const struct gsn_image *mask, const struct gsn_glass *glass,
                         struct gsn_error *err)
{
    struct gsn_stain_pixel *more;
    const struct limits limits = limits_of(glass);
    size_t speaking = 0, seen = 0, stride;
    int r = check_sizes(od, mask, err);

    if (r < 0)
        return r;

    const size_t pixels = (size_t)od[0]->width * od[0]->height;

    for (size_t i = 0; i < pixels; i++)
        speaking += (size_t)speaks(od, mask, &limits, i);
    stride = speaking / MOST_PER_PANEL + 1;
    more = gsn_realloc_array(sample->pixel, sample->count + speaking / stride + 1, sizeof *more);
    if (!more)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the dyes of a slide");
    sample->pixel = more;
    for (size_t i = 0; i < pixels; i++) {
        struct gsn_stain_pixel pixel;

        if (!speaks(od, mask, &limits, i) || seen++ % stride != 0)
            continue;
        for (int c = 0; c < 3; c++) {
            pixel.od[c] = od[c]->value[i];
            pixel.noise[c] = (float)(limits.rougher * deviation_at(&limits, c, od[c]->value[i]));
        }
        sample->pixel[sample->count++] = pixel;
    }
    return GSN_OK;
}
