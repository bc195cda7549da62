/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Least squares: the control points that make a spline follow samples, and how well it predicts.
 *
 * Method: normal equations with two penalties, solved by conjugate gradients (fit_system.c): a
 * little of the gradient (Tikhonov), in closed form for the polynomial with all clouds collapsed,
 * and the jump of the gradient across faces (face_jump.c), as much as two-fold cross-validation
 * asks for. Generalised cross-validation of one fit: P. Craven, G. Wahba, "Smoothing noisy data
 * with spline functions", 1979, 10.1007/BF01404567.
 *
 * Steps: (1) sort the samples by tetrahedron and evaluate the basis at all of them (fit_rows.c);
 * (2) assemble the equations, fold by fold; (3) with folds, go up a ladder of weights as long as
 * each fold predicts the other better: the error there is a quadratic form of the other's
 * equations, so that no sample is evaluated twice; (4) solve with both folds for deviations from
 * the mean; (5) residuals per tetrahedron.
 *
 * Failure: GSN_E_INPUT names the first sample that is not finite or lies outside the mesh;
 * GSN_E_FIT when the solver does not reach its tolerance. Cost: evaluation of the samples
 * dominates; the solver passes over matrix and faces once a step. */
#include "pipeline/model/fit.h"

#include "pipeline/model/face_jump.h"
#include "pipeline/model/fit_system.h"
#include "pipeline/model/barycentric.h"

#include <assert.h>
#include <math.h>
#include <string.h>

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

static const double SMOOTHING = 1e-6, TOLERANCE = 1e-8;
enum { ITERATIONS = 10000, STEPS = 4 };

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

/* d h^2: samples per volume where there are samples, times the square of the edge of a regular
 * tetrahedron of the mean volume. */
static double penalty_unit(const struct gsn_fit_rows *rows)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(rows->space);
    double volume = 0, sampled = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double here = gsn_tets_volume(mesh, t);

        volume += here;
        if (rows->start[t] < rows->start[t + 1])
            sampled += here;
    }
    return (double)rows->samples->count / sampled *
           pow(6 * sqrt(2) * volume / (double)mesh->tet_count, 2.0 / 3);
}

static int find_roughness(struct gsn_fit_rows *rows, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(rows->space);
    gsn_auto_mem(struct gsn_fit_smooth) smooth = gsn_alloc_array(1, sizeof *smooth);

    if (!smooth)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the gradient penalty");
    gsn_fit_smooth_init(smooth, rows->space);
    for (size_t t = 0; t < mesh->tet_count; t++)
        gsn_fit_smooth_add(smooth, mesh, t, 1, rows->rough + t * rows->packed);
    return GSN_OK;
}

/* The equations of a fit, and what weighs their parts. */
struct equations {
    const struct gsn_fit_rows *rows;
    const struct gsn_fit_options *options;
    struct gsn_fit_system system;
    struct gsn_fit_patches *patches;
    double unit; /* of both penalties, for all samples */
};

static void equations_done(struct equations *eq)
{
    gsn_fit_system_done(&eq->system);
    gsn_fit_patches_free(eq->patches);
}

static int equations_init(struct equations *eq, struct gsn_fit_rows *rows,
                          const struct gsn_fit_options *options, struct gsn_error *err)
{
    gsn_auto(gsn_face_jumps) jumps = NULL;
    int r = find_roughness(rows, err);

    *eq = (struct equations){ .rows = rows, .options = options, .unit = penalty_unit(rows) };
    if (r >= 0 && (options->fold || options->jump > 0))
        r = gsn_face_jumps_new(rows->space, &jumps, err);
    if (r >= 0)
        r = gsn_fit_system_assemble(&eq->system, rows, jumps, options->threads, err);
    return r < 0 ? r : gsn_fit_patches_new(rows->space, &eq->patches, err);
}

/* Solves for the folds whose weight is 1; the penalties weigh as many samples as those have. x is
 * where to begin. */
static int solve_folds(struct equations *eq, const double fold[2], double jump, double tolerance,
                       unsigned iterations, double *x, unsigned *ret_iterations,
                       struct gsn_error *err)
{
    const size_t *count = eq->rows->count;
    const double unit = eq->unit * (fold[0] * (double)count[0] + fold[1] * (double)count[1]) /
                        (double)eq->rows->samples->count;
    int r;

    gsn_fit_system_combine(&eq->system, fold, unit * eq->options->smoothing, unit * jump);
    r = gsn_fit_patches_invert(eq->patches, &eq->system, eq->options->threads, err);
    if (r >= 0)
        r = gsn_fit_system_solve(&eq->system, eq->patches, tolerance, iterations,
                                 eq->options->threads, x, ret_iterations, err);
    return r;
}

/* --- cross-validation --- */

/* The ladder of weights. A rung must lower the predicted error by this part of it: a fit that
 * predicts no better for being smoother is left as it is. */
static const double FIRST_JUMP = 1e-5, RUNG = 4, GAIN = 1e-4;
enum { RUNGS = 9 };

/* Predictions need not be solved to more digits than they are compared in, nor with more than this
 * part of the iterations. */
static const double ROUGHLY = 1e-4;
enum { HURRY = 10 };

/* Rms error at the samples of each fold of a fit to those of the other. x: of each fold, where to
 * begin, and the answer. */
static int predict_folds(struct equations *eq, double jump, double *const x[2], double *scratch,
                         double *ret_rms, struct gsn_error *err)
{
    static const double FOLD[2][2] = { { 1, 0 }, { 0, 1 } };
    const double tolerance = fmax(ROUGHLY, eq->options->tolerance);
    double sum = 0;

    for (size_t k = 0; k < 2; k++) {
        unsigned iterations;
        const int r = solve_folds(eq, FOLD[k], jump, tolerance, eq->options->iterations / HURRY,
                                  x[k], &iterations, err);

        if (r < 0)
            return r;
        sum += gsn_fit_system_squares(&eq->system, 1 - k, eq->rows->squares[1 - k], x[k], scratch);
    }
    *ret_rms = sqrt(sum / (double)eq->rows->samples->count);
    return GSN_OK;
}

/* The weight at which the folds predict each other best; x becomes where to begin with it. Where
 * samples leave a wide gap, or those of one fold do, a small weight leaves it to next to nothing
 * what lies in there, and iterations without end find out: such rungs are passed over. The heaviest
 * weights take as long; the ladder ends there. */
static int choose_jump(struct equations *eq, double *ret_x, double *ret_jump, double *ret_predicted,
                       struct gsn_error *err)
{
    const size_t n = eq->system.unknowns;
    gsn_auto_mem(double) first = gsn_alloc_array(n, sizeof *first);
    gsn_auto_mem(double) second = gsn_alloc_array(n, sizeof *second);
    gsn_auto_mem(double) scratch = gsn_alloc_array(n, sizeof *scratch);
    double *const x[2] = { first, second };
    double jump = eq->options->jump > 0 ? eq->options->jump : FIRST_JUMP, best = INFINITY;
    struct gsn_error why = { 0 };
    int failed = GSN_OK;

    if (!first || !second || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the values at a fold");
    for (unsigned rung = 0; rung < RUNGS; rung++, jump *= RUNG) {
        double rms;
        const int r = predict_folds(eq, jump, x, scratch, &rms, &why);

        if (r == GSN_E_FIT && isfinite(best))
            break;
        if (r == GSN_E_FIT) {
            memset(first, 0, n * sizeof *first);
            memset(second, 0, n * sizeof *second);
            failed = r;
            continue;
        }
        if (r < 0)
            return gsn_fail(err, r, "%s", why.text);
        if (!(rms < best * (1 - GAIN)))
            break;
        best = rms;
        *ret_jump = jump;
        *ret_predicted = rms;
        for (size_t i = 0; i < n; i++)
            ret_x[i] = (first[i] + second[i]) / 2;
    }
    return isfinite(best) ? GSN_OK : gsn_fail(err, failed, "%s", why.text);
}

/* gives: the control values of the fit. */
static int solve_system(struct gsn_fit_rows *rows, const struct gsn_fit_options *options,
                        double **ret_control, struct gsn_fit_report *report, struct gsn_error *err)
{
    static const double BOTH[2] = { 1, 1 };
    const size_t unknowns = gsn_dms_controls(rows->space);
    struct equations eq;
    gsn_auto_mem(double) control = gsn_alloc_array(unknowns, sizeof *control);
    int r;

    if (!control)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the control points");
    report->jump = options->jump;
    r = equations_init(&eq, rows, options, err);
    gsn_progress_say(options->progress, "fit", 2, STEPS);
    if (r >= 0 && options->fold)
        r = choose_jump(&eq, control, &report->jump, &report->predicted, err);
    if (r >= 0)
        r = solve_folds(&eq, BOTH, report->jump, options->tolerance, options->iterations, control,
                        &report->iterations, err);
    equations_done(&eq);
    if (r < 0)
        return r;
    for (size_t i = 0; i < unknowns; i++)
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
    int r = gsn_fit_rows_sort(rows, space, samples, options->fold, options->threads, err);

    gsn_progress_say(options->progress, "fit", 0, STEPS);
    if (r >= 0)
        r = gsn_fit_rows_evaluate(rows, options->threads, err);
    gsn_progress_say(options->progress, "fit", 1, STEPS);
    if (r >= 0)
        r = solve_system(rows, options, &control, &figures->report, err);
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
    if (!(full.smoothing > 0) || !isfinite(full.smoothing) || !(full.jump >= 0) ||
        !isfinite(full.jump) || !(full.tolerance > 0) || !(full.tolerance < 1))
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

double gsn_generalised_cross_validation(const struct gsn_fit_report *fit, size_t tets)
{
    const double sampled = 1 - (double)fit->empty_tets / (double)tets;
    const double freedom = 1 - sampled * (double)fit->unknowns / (double)fit->samples;

    return freedom > 0 ? fit->rms / freedom : INFINITY;
}
