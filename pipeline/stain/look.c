/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a slide looks like Van Gieson: robust extreme angles in the plane of the two largest
 * directions of the densities (Macenko 2009). */
#include "pipeline/stain/sample.h"

#include <math.h>
#include <string.h>

#include "pipeline/stain/light.h"
#include "pipeline/stain/order.h"
#include "pipeline/stain/unmix.h"

#define TRACE_OF_DARK 0.15 /* more than this share of dark dye, and a pixel says little of hue */
#define EXTREME 0.01       /* the angle that 1 % of the pixels pass stands for a dye */

struct hues {
    const struct gsn_stain_sample *sample;
    uint8_t *dark; /* owned; per pixel */
    double *angle; /* owned; scratch */
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

/* The two largest directions of the samples, the first pointing towards more density. */
static void widest_plane(const struct hues *hues, double first[3], double second[3])
{
    double m[3][3] = { { 0 } }, v[3][3];
    int order[3] = { 0, 1, 2 };

    for (size_t n = 0; n < hues->sample->count; n++)
        for (int i = 0; i < 3 && !hues->dark[n]; i++)
            for (int j = 0; j < 3; j++)
                m[i][j] +=
                    (double)hues->sample->pixel[n].od[i] * (double)hues->sample->pixel[n].od[j];
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

/* Returns the number of pixels it rests on; below GSN_SAMPLE_LEAST ret_look is not set. */
static size_t extremes(const struct hues *hues, struct gsn_stain_look *ret_look)
{
    double first[3], second[3], low[3], high[3], from, to;
    size_t n = 0;

    widest_plane(hues, first, second);
    for (size_t i = 0; i < hues->sample->count; i++) {
        const struct gsn_stain_pixel *s = &hues->sample->pixel[i];
        const double od[3] = { s->od[0], s->od[1], s->od[2] };

        if (!hues->dark[i] && dot(od, od) > GSN_PALE_OD * GSN_PALE_OD)
            hues->angle[n++] = atan2(dot(od, second), dot(od, first));
    }
    if (n < GSN_SAMPLE_LEAST)
        return n;
    from = gsn_order_pick(hues->angle, n, (size_t)(EXTREME * (double)n));
    to = gsn_order_pick(hues->angle, n, (size_t)((1 - EXTREME) * (double)n));
    direction(first, second, from, low);
    direction(first, second, to, high);

    /* Fuchsin absorbs green most, picric acid blue. */
    const int low_is_red = low[1] - low[2] > high[1] - high[2];

    memcpy(ret_look->red, low_is_red ? low : high, sizeof low);
    memcpy(ret_look->yellow, low_is_red ? high : low, sizeof low);
    ret_look->apart_deg = fabs(to - from) * 180 / M_PI;
    return n;
}

static int check_hues(const struct gsn_stain_look *look, struct gsn_error *err)
{
    const double *red = look->red, *yellow = look->yellow;

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

/* Marks the pixels with more than a trace of what is neither of the two. */
static int leave_out_dark(const struct hues *hues, const struct gsn_stain_look *look,
                          struct gsn_error *err)
{
    struct gsn_dyes dyes = gsn_dyes_builtin();

    memcpy(dyes.red, look->red, sizeof dyes.red);
    memcpy(dyes.yellow, look->yellow, sizeof dyes.yellow);
    for (size_t i = 0; i < hues->sample->count; i++) {
        const struct gsn_stain_pixel *s = &hues->sample->pixel[i];
        const double od[3] = { s->od[0], s->od[1], s->od[2] };
        double amount[3];
        const int r = gsn_unmix_one(od, &dyes, amount, err);

        if (r < 0)
            return r;
        hues->dark[i] = amount[2] > TRACE_OF_DARK * (amount[0] + amount[1] + amount[2]);
    }
    return GSN_OK;
}

static int look_at(const struct hues *hues, struct gsn_stain_look *ret_look, struct gsn_error *err)
{
    struct gsn_stain_look look;
    int r;

    if (extremes(hues, &look) < GSN_SAMPLE_LEAST)
        return gsn_fail(err, GSN_E_STAIN,
                        "nearly every stained pixel is too pale to tell its dyes");
    r = check_hues(&look, err);
    if (r >= 0)
        r = leave_out_dark(hues, &look, err);
    if (r < 0)
        return r;
    if (extremes(hues, &look) < GSN_SAMPLE_LEAST)
        return gsn_fail(err, GSN_E_STAIN, "nearly every stained pixel holds the dark dye");
    r = check_hues(&look, err);
    if (r >= 0)
        *ret_look = look;
    return r;
}

int gsn_stain_look(const struct gsn_stain_sample *sample, struct gsn_stain_look *ret_look,
                   struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) dark = NULL;
    gsn_auto_mem(double) angle = NULL;

    if (sample->count < GSN_SAMPLE_LEAST)
        return gsn_fail(err, GSN_E_STAIN,
                        "only %zu pixels are stained; at least %d are needed to tell the dyes",
                        sample->count, GSN_SAMPLE_LEAST);
    dark = gsn_alloc_array(sample->count, sizeof *dark);
    angle = gsn_alloc_array(sample->count, sizeof *angle);
    if (!dark || !angle)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the look of a slide");

    const struct hues hues = { sample, dark, angle };

    return look_at(&hues, ret_look, err);
}

static const double MOST_APART_DEG = 8;

int gsn_stain_fits(const struct gsn_stain_sample *sample, const struct gsn_dyes *dyes,
                   double *ret_apart_deg, struct gsn_error *err)
{
    gsn_auto_mem(double) apart = gsn_alloc_array(sample->count + 1, sizeof *apart);
    const double *v[3] = { dyes->red, dyes->yellow, dyes->dark };
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
        const double d[3] = { od[0], od[1], od[2] };
        double amount[3], left[3];

        gsn_unmixer_apply(&mix, d, amount);
        for (int c = 0; c < 3; c++)
            left[c] = d[c] - amount[0] * v[0][c] - amount[1] * v[1][c] - amount[2] * v[2][c];
        apart[i] = asin(fmin(sqrt(dot(left, left) / dot(d, d)), 1)) * 180 / M_PI;
    }
    if (sample->count >= GSN_SAMPLE_LEAST)
        middle = gsn_order_pick(apart, sample->count, sample->count / 2);
    if (middle > MOST_APART_DEG)
        return gsn_fail(err, GSN_E_STAIN,
                        "this does not look like Van Gieson: half of its stained pixels lie more "
                        "than %.0f degrees from every mixture of fuchsin, picric acid and "
                        "haematoxylin",
                        middle);
    *ret_apart_deg = middle;
    return GSN_OK;
}
