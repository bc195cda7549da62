/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Least squares: the control points that make a spline follow samples, and how well it predicts.
 *
 * Method: normal equations with a small penalty on the gradient (Tikhonov), solved by conjugate
 * gradients (fit_system.c). The penalty is that of the polynomial with all clouds collapsed, which
 * has a closed form in Bernstein products. Two-fold cross-validation, and generalised
 * cross-validation of one fit: P. Craven, G. Wahba, "Smoothing noisy data with spline functions",
 * 1979, 10.1007/BF01404567.
 *
 * Steps: (1) sort the samples by tetrahedron and evaluate the basis at all of them (fit_rows.c);
 * (2) add the penalty to each tetrahedron's block; (3) assemble, solve for deviations from the
 * mean; (4) residuals per tetrahedron.
 *
 * Failure: GSN_E_INPUT names the first sample that is not finite or lies outside the mesh;
 * GSN_E_FIT when the solver does not reach its tolerance. Cost: evaluation of the samples
 * dominates; the solver passes over the matrix once a step. */
#include "pipeline/model/fit.h"

#include "pipeline/model/batch.h"
#include "pipeline/model/fit_system.h"
#include "pipeline/model/barycentric.h"

#include <assert.h>
#include <math.h>

/* --- the gradient penalty --- */

static double factorial_of(unsigned n)
{
    double product = 1;

    for (unsigned i = 2; i <= n; i++)
        product *= i;
    return product;
}

/* (1/V) integral of B_a B_b, B_a = m!/a! lambda^a:  m!/a! m!/b! (a+b)! 3!/(2m+3)!  */
static double mean_product(const uint8_t *beta, unsigned k, const uint8_t *gamma, unsigned l)
{
    double value = 6;
    unsigned m = 0;

    if (beta[k] == 0 || gamma[l] == 0)
        return 0;
    for (unsigned c = 0; c < 4; c++) {
        const unsigned a = beta[c] - (unsigned)(c == k), b = gamma[c] - (unsigned)(c == l);

        value *= factorial_of(a + b) / factorial_of(a) / factorial_of(b);
        m += a;
    }
    return value * factorial_of(m) * factorial_of(m) / factorial_of(2 * m + 3);
}

void gsn_fit_smooth_init(struct gsn_fit_smooth *smooth, const struct gsn_dms *space)
{
    smooth->degree = gsn_dms_degree(space);
    smooth->functions = gsn_dms_functions(space);
    for (size_t f = 0; f < smooth->functions; f++)
        for (size_t g = 0; g < smooth->functions; g++)
            for (unsigned k = 0; k < 4; k++)
                for (unsigned l = 0; l < 4; l++)
                    smooth->mass[f][k][g][l] =
                        mean_product(gsn_dms_beta(space, f), k, gsn_dms_beta(space, g), l);
}

/* dot[k][l] = grad lambda_k . grad lambda_l. */
static void dot_gradients(const struct gsn_tets *mesh, size_t tet, double dot[4][4])
{
    const uint32_t *v = mesh->tet[tet];
    double gradient[4][3];
    struct gsn_barycentric frame;

    gsn_barycentric_init(&frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                         mesh->vertex[v[3]]);
    for (size_t c = 0; c < 3; c++) {
        gradient[0][c] = -(frame.row[0][c] + frame.row[1][c] + frame.row[2][c]);
        for (size_t k = 1; k < 4; k++)
            gradient[k][c] = frame.row[k - 1][c];
    }
    for (size_t k = 0; k < 4; k++)
        for (size_t l = 0; l < 4; l++)
            dot[k][l] = gsn_dot(gradient[k], gradient[l]);
}

void gsn_fit_smooth_add(const struct gsn_fit_smooth *smooth, const struct gsn_tets *mesh,
                        size_t tet, double weight, double *block)
{
    const double n = smooth->degree;
    const double scale = weight * n * n * gsn_tets_volume(mesh, tet);
    double dot[4][4];

    dot_gradients(mesh, tet, dot);
    for (size_t f = 0; f < smooth->functions; f++)
        for (size_t g = f; g < smooth->functions; g++) {
            double sum = 0;

            for (size_t k = 0; k < 4; k++)
                for (size_t l = 0; l < 4; l++)
                    sum += dot[k][l] * smooth->mass[f][k][g][l];
            *block++ += scale * sum;
        }
}

/* --- the fit --- */

static const double SMOOTHING = 1e-6, TOLERANCE = 1e-10;
enum { ITERATIONS = 2000, STEPS = 4 };

static struct gsn_fit_options with_defaults(const struct gsn_fit_options *options)
{
    struct gsn_fit_options full = *options;

    if (full.smoothing == 0)
        full.smoothing = SMOOTHING;
    if (full.tolerance == 0)
        full.tolerance = TOLERANCE;
    if (full.iterations == 0)
        full.iterations = ITERATIONS;
    return full;
}

/* The penalty smoothing * h^2 * integral |grad s|^2 in sample units, i.e. times samples per volume
 * where there are samples; h is the edge of a regular tetrahedron of the mean volume. */
static double penalty_weight(const struct gsn_fit_rows *rows, double smoothing)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(rows->space);
    double volume = 0, sampled = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double here = gsn_tets_volume(mesh, t);

        volume += here;
        if (rows->start[t] < rows->start[t + 1])
            sampled += here;
    }
    return smoothing * (double)rows->samples->count / sampled *
           pow(6 * sqrt(2) * volume / (double)mesh->tet_count, 2.0 / 3);
}

static int add_penalty(struct gsn_fit_rows *rows, double smoothing, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(rows->space);
    const double weight = penalty_weight(rows, smoothing);
    gsn_auto_mem(struct gsn_fit_smooth) smooth = gsn_alloc_array(1, sizeof *smooth);

    if (!smooth)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the gradient penalty");
    gsn_fit_smooth_init(smooth, rows->space);
    for (size_t t = 0; t < mesh->tet_count; t++)
        gsn_fit_smooth_add(smooth, mesh, t, weight, rows->block + t * rows->packed);
    return GSN_OK;
}

/* gives: the control values of the fit. */
static int solve_system(struct gsn_fit_rows *rows, const struct gsn_fit_options *options,
                        double **ret_control, unsigned *ret_iterations, struct gsn_error *err)
{
    struct gsn_fit_system system = { .unknowns = 0 };
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(rows->space), sizeof *control);
    int r;

    if (!control)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the control points");
    r = add_penalty(rows, options->smoothing, err);
    if (r >= 0)
        r = gsn_fit_system_assemble(&system, rows, options->threads, err);
    gsn_progress_say(options->progress, "fit", 2, STEPS);
    if (r >= 0)
        r = gsn_fit_system_solve(&system, options->tolerance, options->iterations, control,
                                 ret_iterations, err);
    gsn_fit_system_done(&system);
    if (r < 0)
        return r;
    for (size_t i = 0; i < gsn_dms_controls(rows->space); i++)
        control[i] += rows->mean;
    *ret_control = gsn_steal(&control);
    return GSN_OK;
}

/* The figures of a fit, and per tetrahedron. */
struct figures {
    struct gsn_fit_report report;
    uint32_t *tet_samples;
    double *tet_rms;
};

static void figures_done(struct figures *figures)
{
    gsn_free(figures->tet_samples);
    gsn_free(figures->tet_rms);
}

static int find_figures(const struct gsn_fit_rows *rows, const double *control, unsigned threads,
                        struct figures *figures, struct gsn_error *err)
{
    const size_t tets = gsn_dms_mesh(rows->space)->tet_count;
    gsn_auto_mem(struct gsn_fit_residual) residual = gsn_alloc_array(tets, sizeof *residual);
    double squares = 0;
    int r;

    figures->tet_samples = gsn_alloc_array(tets, sizeof *figures->tet_samples);
    figures->tet_rms = gsn_alloc_array(tets, sizeof *figures->tet_rms);
    if (!residual || !figures->tet_samples || !figures->tet_rms)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the residuals");
    r = gsn_fit_rows_residuals(rows, control, threads, residual, err);
    if (r < 0)
        return r;
    for (size_t t = 0; t < tets; t++) {
        const uint32_t count = rows->start[t + 1] - rows->start[t];

        figures->tet_samples[t] = count;
        figures->tet_rms[t] = count ? sqrt(residual[t].squares / count) : 0;
        figures->report.empty_tets += count == 0;
        figures->report.worst = fmax(figures->report.worst, residual[t].worst);
        squares += residual[t].squares;
    }
    figures->report.unknowns = gsn_dms_controls(rows->space);
    figures->report.samples = rows->samples->count;
    figures->report.rms = sqrt(squares / (double)rows->samples->count);
    return GSN_OK;
}

static int fit_rows(struct gsn_fit_rows *rows, const struct gsn_samples *samples,
                    const struct gsn_dms *space, const struct gsn_fit_options *options,
                    struct gsn_spline **ret_spline, struct figures *figures, struct gsn_error *err)
{
    gsn_auto_mem(double) control = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    int r = gsn_fit_rows_sort(rows, space, samples, options->threads, err);

    gsn_progress_say(options->progress, "fit", 0, STEPS);
    if (r >= 0)
        r = gsn_fit_rows_evaluate(rows, options->threads, err);
    gsn_progress_say(options->progress, "fit", 1, STEPS);
    if (r >= 0)
        r = solve_system(rows, options, &control, &figures->report.iterations, err);
    gsn_progress_say(options->progress, "fit", 3, STEPS);
    if (r >= 0)
        r = find_figures(rows, control, options->threads, figures, err);
    if (r >= 0)
        r = gsn_spline_new(space, control, &spline, err);
    gsn_progress_say(options->progress, "fit", STEPS, STEPS);
    if (r >= 0)
        *ret_spline = gsn_steal(&spline);
    return r;
}

int gsn_fit(const struct gsn_dms *space, const struct gsn_samples *samples,
            const struct gsn_fit_options *options, struct gsn_spline **ret_spline,
            struct gsn_fit_report *ret_report, uint32_t **ret_tet_samples, double **ret_tet_rms,
            struct gsn_error *err)
{
    const struct gsn_fit_options full = with_defaults(options);
    struct figures figures = { .tet_rms = NULL };
    struct gsn_fit_rows rows;
    int r;

    assert(space && samples && options && ret_spline && ret_report);
    if (!(full.smoothing > 0) || !isfinite(full.smoothing) || !(full.tolerance > 0) ||
        !(full.tolerance < 1))
        return gsn_fail(err, GSN_E_INPUT, "smoothing %g and tolerance %g cannot be used",
                        full.smoothing, full.tolerance);
    r = fit_rows(&rows, samples, space, &full, ret_spline, &figures, err);
    gsn_fit_rows_done(&rows);
    if (r >= 0) {
        *ret_report = figures.report;
        if (ret_tet_samples)
            *ret_tet_samples = gsn_steal(&figures.tet_samples);
        if (ret_tet_rms)
            *ret_tet_rms = gsn_steal(&figures.tet_rms);
    }
    figures_done(&figures);
    return r;
}

/* --- cross-validation --- */

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
