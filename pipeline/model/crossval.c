/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/crossval.h"

#include "pipeline/model/batch.h"

#include <math.h>

enum { CHUNK = 1 << 16 }; /* samples whose values are held at once */

/* The samples of one fold. */
struct half {
    struct gsn_samples samples;
    double (*at)[3];
    float *value;
};

static void half_done(struct half *half)
{
    gsn_free(half->at);
    gsn_free(half->value);
}

static int take_half(const struct gsn_samples *samples, const uint8_t *fold, uint8_t which,
                     struct half *half, struct gsn_error *err)
{
    size_t count = 0;

    *half = (struct half){ .at = gsn_alloc_array(samples->count, sizeof *half->at),
                           .value = gsn_alloc_array(samples->count, sizeof *half->value) };
    if (!half->at || !half->value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a fold of the samples");
    for (size_t i = 0; i < samples->count; i++)
        if (fold[i] == which) {
            for (size_t c = 0; c < 3; c++)
                half->at[count][c] = samples->at[i][c];
            half->value[count++] = samples->value[i];
        }
    half->samples = (struct gsn_samples){ .count = count,
                                          .at = (const double(*)[3])half->at,
                                          .value = half->value };
    return GSN_OK;
}

/* Adds the squared errors at the samples of the other fold. Those on the mesh's upper boundary have
 * no value by the half-open rule; the domain is larger than the region, so there are none. */
static int add_errors(const struct gsn_spline *spline, const struct gsn_samples *samples,
                      unsigned threads, double *sum, struct gsn_error *err)
{
    gsn_auto_mem(double) value = gsn_alloc_array(CHUNK, sizeof *value);

    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the values at a fold");
    for (size_t first = 0; first < samples->count; first += CHUNK) {
        const size_t left = samples->count - first, count = left < CHUNK ? left : CHUNK;
        const int r =
            gsn_spline_eval_many(spline, samples->at + first, count, threads, value, NULL, err);

        if (r < 0)
            return r;
        for (size_t i = 0; i < count; i++) {
            const double error = value[i] - (double)samples->value[first + i];

            *sum += isnan(value[i]) ? 0 : error * error;
        }
    }
    return GSN_OK;
}

static int one_way(const struct gsn_dms *space, const struct half *seen, const struct half *unseen,
                   const struct gsn_fit_options *options, double *sum, struct gsn_error *err)
{
    gsn_auto(gsn_spline) spline = NULL;
    struct gsn_fit_report report;
    const int r = gsn_fit(space, &seen->samples, options, &spline, &report, NULL, NULL, err);

    return r < 0 ? r : add_errors(spline, &unseen->samples, options->threads, sum, err);
}

int gsn_cross_validate(const struct gsn_dms *space, const struct gsn_samples *samples,
                       const uint8_t *fold, const struct gsn_fit_options *options, double *ret_rms,
                       struct gsn_error *err)
{
    struct half half[2] = { { .at = NULL }, { .at = NULL } };
    double sum = 0;
    int r = take_half(samples, fold, 0, &half[0], err);

    if (r >= 0)
        r = take_half(samples, fold, 1, &half[1], err);
    if (r >= 0)
        r = one_way(space, &half[0], &half[1], options, &sum, err);
    if (r >= 0)
        r = one_way(space, &half[1], &half[0], options, &sum, err);
    half_done(&half[0]);
    half_done(&half[1]);
    if (r >= 0)
        *ret_rms = sqrt(sum / (double)samples->count);
    return r;
}

double gsn_generalised_cross_validation(const struct gsn_fit_report *fit, size_t tets)
{
    const double sampled = 1 - (double)fit->empty_tets / (double)tets;
    const double freedom = 1 - sampled * (double)fit->unknowns / (double)fit->samples;

    return freedom > 0 ? fit->rms / freedom : INFINITY;
}
