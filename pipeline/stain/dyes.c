/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The dye vectors of one slide, from its own stained pixels (Macenko 2009). */
#include "pipeline/stain/redness.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "pipeline/stain/light.h"
#include "pipeline/stain/order.h"

#define TOO_DENSE 2.0 /* beyond it, 8 bits hold no hue any more */
#define TRACE_OF_DARK                                                                              \
    0.15             /* share of the dark dye above which a pixel says little of the others        \
                      */
#define EXTREME 0.01 /* the angle that 1 % of the pixels pass stands for the pure dye */

enum {
    MOST_SAMPLES = 200000,
    LEAST_SAMPLES = 1000,
    PARTS_ACROSS = 4,
    PARTS = PARTS_ACROSS * PARTS_ACROSS,
};

struct sample {
    float od[3];
    uint8_t part, dark;
};

struct slide {
    struct sample *sample;
    size_t count;
    double *angle; /* count; scratch */
};

struct pair {
    double red[3], yellow[3];
};

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

/* Jacobi rotations: the columns of v become the eigenvectors of the symmetric m. */
static void eigen(double m[3][3], double v[3][3])
{
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            v[i][j] = i == j;
    for (int sweep = 0; sweep < 12; sweep++) {
        for (int p = 0; p < 2; p++) {
            for (int q = p + 1; q < 3; q++) {
                const double theta = 0.5 * atan2(2 * m[p][q], m[p][p] - m[q][q]);
                const double c = cos(theta), s = sin(theta);

                for (int k = 0; k < 3; k++) {
                    const double a = m[k][p], b = m[k][q], e = v[k][p], f = v[k][q];

                    m[k][p] = c * a + s * b;
                    m[k][q] = c * b - s * a;
                    v[k][p] = c * e + s * f;
                    v[k][q] = c * f - s * e;
                }
                for (int k = 0; k < 3; k++) {
                    const double a = m[p][k], b = m[q][k];

                    m[p][k] = c * a + s * b;
                    m[q][k] = c * b - s * a;
                }
            }
        }
    }
}

static int takes_part(const struct sample *sample, int without)
{
    return !sample->dark && sample->part != without;
}

/* The two largest directions of the samples, the first pointing towards more density. */
static void widest_plane(const struct slide *slide, int without, double first[3], double second[3])
{
    double m[3][3] = { { 0 } }, v[3][3];
    int order[3] = { 0, 1, 2 };

    for (size_t n = 0; n < slide->count; n++)
        if (takes_part(&slide->sample[n], without))
            for (int i = 0; i < 3; i++)
                for (int j = 0; j < 3; j++)
                    m[i][j] += (double)slide->sample[n].od[i] * slide->sample[n].od[j];
    eigen(m, v);
    for (int i = 0; i < 2; i++)
        for (int j = i + 1; j < 3; j++)
            if (m[order[j]][order[j]] > m[order[i]][order[i]]) {
                const int kept = order[i];

                order[i] = order[j];
                order[j] = kept;
            }

    const double sign = v[0][order[0]] + v[1][order[0]] + v[2][order[0]] < 0 ? -1 : 1;

    for (int i = 0; i < 3; i++) {
        first[i] = sign * v[i][order[0]];
        second[i] = v[i][order[1]];
    }
}

static void direction(const double first[3], const double second[3], double angle, double ret[3])
{
    double length;

    for (int i = 0; i < 3; i++)
        ret[i] = fmax(cos(angle) * first[i] + sin(angle) * second[i], 0);
    length = sqrt(dot(ret, ret));
    for (int i = 0; i < 3; i++)
        ret[i] /= length;
}

/* Returns the number of pixels it rests on; below LEAST_SAMPLES ret_pair is not set. */
static size_t extremes(const struct slide *slide, int without, struct pair *ret_pair)
{
    double first[3], second[3], low[3], high[3], from, to;
    size_t n = 0;

    widest_plane(slide, without, first, second);
    for (size_t i = 0; i < slide->count; i++) {
        const struct sample *s = &slide->sample[i];
        const double od[3] = { s->od[0], s->od[1], s->od[2] };

        if (takes_part(s, without))
            slide->angle[n++] = atan2(dot(od, second), dot(od, first));
    }
    if (n < LEAST_SAMPLES)
        return n;
    from = gsn_order_pick(slide->angle, n, (size_t)(EXTREME * (double)n));
    to = gsn_order_pick(slide->angle, n, (size_t)((1 - EXTREME) * (double)n));
    direction(first, second, from, low);
    direction(first, second, to, high);

    /* Fuchsin absorbs green most, picric acid blue. */
    const int low_is_red = low[1] - low[2] > high[1] - high[2];

    memcpy(ret_pair->red, low_is_red ? low : high, sizeof low);
    memcpy(ret_pair->yellow, low_is_red ? high : low, sizeof low);
    return n;
}

static int is_stained(struct gsn_plane *const od[3], const struct gsn_image *mask, size_t i)
{
    double squares = 0;

    if (mask && ((const uint8_t *)mask->samples)[i] == 0)
        return 0;
    for (int c = 0; c < 3; c++) {
        if (!(od[c]->value[i] < TOO_DENSE))
            return 0;
        squares += (double)od[c]->value[i] * od[c]->value[i];
    }
    return squares > GSN_PALE_OD * GSN_PALE_OD;
}

static int gather(struct gsn_plane *const od[3], const struct gsn_image *mask, struct slide *slide,
                  struct gsn_error *err)
{
    const size_t width = od[0]->width, height = od[0]->height;
    size_t stained = 0, seen = 0, stride;

    for (size_t i = 0; i < width * height; i++)
        stained += (size_t)is_stained(od, mask, i);
    if (stained < LEAST_SAMPLES)
        return gsn_fail(err, GSN_E_STAIN,
                        "only %zu pixels are stained; at least %d are needed to tell the dyes",
                        stained, LEAST_SAMPLES);
    stride = (stained + MOST_SAMPLES - 1) / MOST_SAMPLES;
    slide->sample = gsn_alloc_array(stained / stride + 1, sizeof *slide->sample);
    slide->angle = gsn_alloc_array(stained / stride + 1, sizeof *slide->angle);
    if (!slide->sample || !slide->angle)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the dyes of a slide");
    for (size_t i = 0; i < width * height; i++) {
        if (!is_stained(od, mask, i) || seen++ % stride != 0)
            continue;
        slide->sample[slide->count++] = (struct sample){
            .od = { od[0]->value[i], od[1]->value[i], od[2]->value[i] },
            .part = (uint8_t)(i / width * PARTS_ACROSS / height * PARTS_ACROSS +
                              i % width * PARTS_ACROSS / width),
        };
    }
    return GSN_OK;
}

static int check_hues(const struct pair *pair, struct gsn_error *err)
{
    const double *red = pair->red, *yellow = pair->yellow;

    if (!(yellow[2] > 1.5 * yellow[1]))
        return gsn_fail(err, GSN_E_STAIN,
                        "this does not look like Van Gieson: the yellowest pixels absorb blue %.1f "
                        "times as much as green, picric acid does it more than 1.5 times",
                        yellow[2] / fmax(yellow[1], 0.01));
    if (!(red[1] > 0.8 * red[2] && red[1] > 1.3 * red[0]))
        return gsn_fail(err, GSN_E_STAIN,
                        "this does not look like Van Gieson: the reddest pixels absorb red, green "
                        "and blue as %.2f : %.2f : %.2f, acid fuchsin absorbs green most",
                        red[0], red[1], red[2]);
    return GSN_OK;
}

static void name_dyes(const struct pair *pair, const struct gsn_dyes *start,
                      struct gsn_dyes *ret_dyes)
{
    *ret_dyes = *start;
    (void)snprintf(ret_dyes->name, sizeof ret_dyes->name, "macenko-1");
    memcpy(ret_dyes->red, pair->red, sizeof pair->red);
    memcpy(ret_dyes->yellow, pair->yellow, sizeof pair->yellow);
}

static int leave_out_dark(struct slide *slide, const struct gsn_dyes *dyes, struct gsn_error *err)
{
    for (size_t i = 0; i < slide->count; i++) {
        struct sample *s = &slide->sample[i];
        const double od[3] = { s->od[0], s->od[1], s->od[2] };
        double amount[3];
        const int r = gsn_unmix_one(od, dyes, amount, err);

        if (r < 0)
            return r;
        s->dark = amount[2] > TRACE_OF_DARK * (amount[0] + amount[1] + amount[2]);
    }
    return GSN_OK;
}

static double angle_deg(const double a[3], const double b[3])
{
    return acos(fmin(dot(a, b), 1)) * 180 / M_PI;
}

/* Jackknife: the slide without one of its parts at a time. */
static void jackknife(const struct slide *slide, const struct pair *whole, double ret_deg[2])
{
    double red = 0, yellow = 0;
    int parts = 0;

    for (int part = 0; part < PARTS; part++) {
        struct pair without;
        double a;

        if (extremes(slide, part, &without) < LEAST_SAMPLES)
            continue;
        a = angle_deg(without.red, whole->red);
        red += a * a;
        a = angle_deg(without.yellow, whole->yellow);
        yellow += a * a;
        parts++;
    }
    ret_deg[0] = parts > 1 ? sqrt(red * (parts - 1) / parts) : (double)NAN;
    ret_deg[1] = parts > 1 ? sqrt(yellow * (parts - 1) / parts) : (double)NAN;
}

static int estimate(struct slide *slide, const struct gsn_dyes *start, struct gsn_dyes *ret_dyes,
                    double ret_uncertainty_deg[2], struct gsn_error *err)
{
    enum { NONE = -1 };
    struct gsn_dyes rough;
    struct pair pair;
    int r;

    (void)extremes(slide, NONE, &pair);
    r = check_hues(&pair, err);
    if (r < 0)
        return r;
    name_dyes(&pair, start, &rough);
    r = leave_out_dark(slide, &rough, err);
    if (r < 0)
        return r;
    if (extremes(slide, NONE, &pair) < LEAST_SAMPLES)
        return gsn_fail(err, GSN_E_STAIN, "nearly every stained pixel holds the dark dye");
    r = check_hues(&pair, err);
    if (r < 0)
        return r;
    jackknife(slide, &pair, ret_uncertainty_deg);
    name_dyes(&pair, start, ret_dyes);
    return GSN_OK;
}

int gsn_dyes_estimate(struct gsn_plane *const od[3], const struct gsn_image *mask,
                      const struct gsn_dyes *start, struct gsn_dyes *ret_dyes,
                      double ret_uncertainty_deg[2], struct gsn_error *err)
{
    struct slide slide = { .count = 0 };
    int r;

    for (int c = 1; c < 3; c++)
        if (od[c]->width != od[0]->width || od[c]->height != od[0]->height)
            return gsn_fail(err, GSN_E_INPUT, "the optical densities differ in size");
    if (mask && (mask->width != od[0]->width || mask->height != od[0]->height ||
                 mask->channels != 1 || mask->bits != 8))
        return gsn_fail(err, GSN_E_INPUT, "the mask is not an 8-bit grey image of %u x %u",
                        od[0]->width, od[0]->height);
    r = gather(od, mask, &slide, err);
    if (r >= 0)
        r = estimate(&slide, start, ret_dyes, ret_uncertainty_deg, err);
    gsn_free(slide.sample);
    gsn_free(slide.angle);
    return r;
}
