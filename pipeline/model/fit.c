/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Least squares: the control points that make a spline follow samples, and how well it predicts.
 *
 * Method: normal equations with two penalties, solved by conjugate gradients (fit_system.c): a
 * little of the gradient (Tikhonov), and the jump of the gradient across faces (face_jump.c), with
 * the curvature where there are no samples, as much as two-fold cross-validation asks for. Gradient
 * and curvature are in closed form, of the polynomial with all clouds collapsed. Generalised
 * cross-validation of one fit: P. Craven, G. Wahba, "Smoothing noisy data with spline functions",
 * 1979, 10.1007/BF01404567.
 *
 * Steps: (1) sort the samples by tetrahedron and evaluate the basis at all of them (fit_rows.c);
 * (2) assemble the equations, fold by fold; (3) with folds, go up a ladder of weights as long as
 * each fold predicts the other better: the error there is a quadratic form of the other's
 * equations, so that no sample is evaluated twice; (4) solve with both folds for deviations from
 * the mean; (5) residuals per tetrahedron. Further channels begin with (4).
 *
 * Failure: GSN_E_INPUT names the first sample that is not finite or lies outside the mesh;
 * GSN_E_FIT when the solver does not reach its tolerance, unless the caller is forgiving. Cost:
 * evaluation of the samples dominates; the solver passes over matrix and faces once a step. */
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

/* --- the curvature penalty --- */

/* The coefficients of control point beta in the second derivatives of a tetrahedron's polynomial:
 * n (n - 1) for each way to take two corners k <= l off beta, twice where they differ. rest: the
 * corner that is left of degree 3. */
struct second {
    unsigned k, l, rest;
    double ways;
};
enum { MOST_SECONDS = 3 };

static size_t list_seconds(const uint8_t *beta, struct second *ret)
{
    size_t count = 0;

    for (unsigned k = 0; k < 4; k++)
        for (unsigned l = k; l < 4; l++) {
            uint8_t left[4];

            if (beta[k] < 1 + (k == l) || beta[l] < 1)
                continue;
            memcpy(left, beta, sizeof left);
            left[k]--;
            left[l]--;
            ret[count] = (struct second){ .k = k, .l = l, .ways = k == l ? 1 : 2 };
            for (unsigned c = 0; c < 4; c++)
                if (left[c] > 0)
                    ret[count].rest = c;
            count++;
        }
    return count;
}

/* The mean over the tetrahedron of what is left of both, times the product of the second
 * derivatives' tensors. */
static double second_product(const struct second *a, const struct second *b, unsigned degree,
                             double dot[4][4])
{
    const double tensors = a->ways * b->ways / 2 *
                           (dot[a->k][b->k] * dot[a->l][b->l] + dot[a->k][b->l] * dot[a->l][b->k]);

    return degree < 3 ? tensors : tensors * (a->rest == b->rest ? 2 : 1) / 20;
}

void gsn_fit_curvature_add(const struct gsn_dms *space, size_t tet, double weight, double *block)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const unsigned degree = gsn_dms_degree(space);
    const size_t functions = gsn_dms_functions(space);
    const double n = degree, scale = weight * n * n * (n - 1) * (n - 1);
    struct second term[GSN_DMS_MAX_FUNCTIONS][MOST_SECONDS];
    size_t terms[GSN_DMS_MAX_FUNCTIONS];
    double dot[4][4];

    dot_gradients(mesh, tet, dot);
    for (size_t f = 0; f < functions; f++)
        terms[f] = list_seconds(gsn_dms_beta(space, f), term[f]);
    for (size_t f = 0; f < functions; f++)
        for (size_t g = f; g < functions; g++) {
            double sum = 0;

            for (size_t a = 0; a < terms[f]; a++)
                for (size_t b = 0; b < terms[g]; b++)
                    sum += second_product(&term[f][a], &term[g][b], degree, dot);
            *block++ += scale * gsn_tets_volume(mesh, tet) * sum;
        }
}

/* --- the fit --- */

static const double TOLERANCE = 1e-8;
enum { ITERATIONS = 10000, STEPS = 4 };

static struct gsn_fit_options with_defaults(const struct gsn_fit_options *options)
{
    struct gsn_fit_options full = *options;

    if (full.tolerance == 0)
        full.tolerance = TOLERANCE;
    if (full.iterations == 0)
        full.iterations = ITERATIONS;
    return full;
}

/* Whether a tetrahedron has samples; those of weight 0 are none. */
static int counts_there(const struct gsn_fit_rows *rows, size_t tet)
{
    const double *weight = rows->samples->weight;

    for (size_t i = rows->start[tet]; i < rows->start[tet + 1]; i++)
        if (!weight || weight[rows->order[i]] > 0)
            return 1;
    return 0;
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
        if (counts_there(rows, t))
            sampled += here;
    }
    return (rows->mass[0] + rows->mass[1]) / sampled *
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

/* What the curvature of a tetrahedron without samples weighs beside the jumps; 1 would be what
 * jumps across faces that cut it into linear pieces weigh. It has no jumps inside, and without this
 * what it bends by is free: values there ran off to several times the data's range, and the solver
 * took thousands of iterations to find out. */
static const double CURVATURE = 0.1;

/* h^2 int |grad grad s|^2 of each of those, h the edge of the regular one of its volume. */
static int find_curvature(struct gsn_fit_rows *rows, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(rows->space);

    rows->curvature = gsn_alloc_array(mesh->tet_count, rows->packed * sizeof *rows->curvature);
    if (!rows->curvature)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the curvature penalty");
    for (size_t t = 0; t < mesh->tet_count; t++)
        if (!counts_there(rows, t))
            gsn_fit_curvature_add(rows->space, t,
                                  CURVATURE * pow(6 * sqrt(2) * gsn_tets_volume(mesh, t), 2.0 / 3),
                                  rows->curvature + t * rows->packed);
    return GSN_OK;
}

/* The equations of a fit, and what weighs their parts. */
struct equations {
    struct gsn_fit_rows *rows;
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
    if (r >= 0 && jumps)
        r = find_curvature(rows, err);
    if (r >= 0)
        r = gsn_fit_system_assemble(&eq->system, rows, jumps, options->threads, err);
    return r < 0 ? r : gsn_fit_patches_new(rows->space, &eq->patches, err);
}

/* The equations of the folds whose weight is 1; the penalties weigh as many samples as those have.
 */
static void weigh_equations(struct equations *eq, const double fold[2], double jump)
{
    const double *mass = eq->rows->mass;
    const double unit = eq->unit * (fold[0] * mass[0] + fold[1] * mass[1]) / (mass[0] + mass[1]);

    gsn_fit_system_combine(&eq->system, fold, unit * eq->options->smoothing, unit * jump);
}

/* Solves them. x is where to begin. */
static int solve_folds(struct equations *eq, const double fold[2], double jump, double tolerance,
                       unsigned iterations, double *x, unsigned *ret_iterations,
                       struct gsn_error *err)
{
    int r;

    weigh_equations(eq, fold, jump);
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
    *ret_rms = sqrt(sum / (eq->rows->mass[0] + eq->rows->mass[1]));
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

/* --- the channels of a fit --- */

/* What comes out of one channel. */
struct channel {
    struct gsn_spline *spline;
    struct gsn_fit_report report;
};

/* The answer of one channel of the equations. The first one chooses the weight of the jumps and
 * makes the preconditioner. */
static int solve_channel(struct equations *eq, int first, double *control,
                         struct gsn_fit_report *report, struct gsn_error *err)
{
    static const double BOTH[2] = { 1, 1 };
    const struct gsn_fit_options *options = eq->options;
    int r = GSN_OK;

    if (first && options->fold)
        r = choose_jump(eq, control, &report->jump, &report->predicted, err);
    if (r >= 0)
        weigh_equations(eq, BOTH, report->jump);
    if (r >= 0 && first)
        r = gsn_fit_patches_invert(eq->patches, &eq->system, options->threads, err);
    if (r < 0)
        return r;
    r = gsn_fit_system_solve(&eq->system, eq->patches, options->tolerance, options->iterations,
                             options->threads, control, &report->iterations, err);
    report->unconverged = r == GSN_E_FIT && options->forgiving;
    if (report->unconverged) {
        report->iterations = options->iterations;
        r = GSN_OK;
    }
    for (size_t i = 0; r >= 0 && i < eq->system.unknowns; i++)
        control[i] += eq->rows->mean;
    return r;
}

/* tet_samples, tet_rms: room for the tetrahedra, or NULL. */
static int find_figures(const struct gsn_fit_rows *rows, const double *control, unsigned threads,
                        struct gsn_fit_report *report, uint32_t *tet_samples, double *tet_rms,
                        struct gsn_error *err)
{
    const size_t tets = gsn_dms_mesh(rows->space)->tet_count;
    gsn_auto_mem(struct gsn_fit_residual) residual = gsn_alloc_array(tets, sizeof *residual);
    double squares = 0;
    int r;

    if (!residual)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the residuals");
    r = gsn_fit_rows_residuals(rows, control, threads, residual, err);
    if (r < 0)
        return r;
    report->empty_tets = 0;
    report->worst = 0;
    for (size_t t = 0; t < tets; t++) {
        const uint32_t count = rows->start[t + 1] - rows->start[t];

        if (tet_samples)
            tet_samples[t] = count;
        if (tet_rms)
            tet_rms[t] = residual[t].mass > 0 ? sqrt(residual[t].squares / residual[t].mass) : 0;
        report->empty_tets += !counts_there(rows, t);
        report->worst = fmax(report->worst, residual[t].worst);
        squares += residual[t].squares;
    }
    report->unknowns = gsn_dms_controls(rows->space);
    report->samples = rows->inside;
    report->outside = rows->samples->count - rows->inside;
    report->first_outside = report->outside ? rows->first_outside : 0;
    report->rms = sqrt(squares / (rows->mass[0] + rows->mass[1]));
    return GSN_OK;
}

/* control: where the solver begins, all 0. */
static int fit_channel(struct equations *eq, int first, double *control, struct channel *channel,
                       uint32_t *tet_samples, double *tet_rms, struct gsn_error *err)
{
    int r = solve_channel(eq, first, control, &channel->report, err);

    gsn_progress_say(eq->options->progress, "fit", 3, STEPS);
    if (r >= 0)
        r = find_figures(eq->rows, control, eq->options->threads, &channel->report, tet_samples,
                         tet_rms, err);
    return r < 0 ? r : gsn_spline_new(eq->rows->space, control, &channel->spline, err);
}

/* The channels after the first, whose equations those are. */
static int fit_others(struct equations *eq, const double *const *value, size_t channels,
                      double *control, struct channel *channel, struct gsn_error *err)
{
    struct gsn_samples samples = *eq->rows->samples;

    for (size_t c = 1; c < channels; c++) {
        int r;

        samples.exact = value[c];
        channel[c].report = (struct gsn_fit_report){ .jump = channel[0].report.jump };
        memset(control, 0, eq->system.unknowns * sizeof *control);
        r = gsn_fit_rows_aim(eq->rows, &samples, eq->options->threads, err);
        if (r >= 0) {
            gsn_fit_system_aim(&eq->system, eq->rows);
            r = fit_channel(eq, 0, control, &channel[c], NULL, NULL, err);
        }
        if (r < 0)
            return err ? gsn_fail_at(err, "channel %zu", c) : r;
    }
    return GSN_OK;
}

/* All channels. value: of each, or NULL with the samples' own as the only one. */
static int fit_all(const struct gsn_dms *space, const struct gsn_samples *samples,
                   const double *const *value, size_t channels,
                   const struct gsn_fit_options *options, struct channel *channel,
                   uint32_t *tet_samples, double *tet_rms, struct gsn_error *err)
{
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    struct gsn_fit_rows rows;
    struct equations eq = { .patches = NULL };
    int r;

    if (!control)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the control points");
    channel[0].report.jump = options->jump;
    r = gsn_fit_rows_sort(&rows, space, samples, options, err);
    gsn_progress_say(options->progress, "fit", 0, STEPS);
    if (r >= 0)
        r = gsn_fit_rows_evaluate(&rows, options->threads, err);
    gsn_progress_say(options->progress, "fit", 1, STEPS);
    if (r >= 0)
        r = equations_init(&eq, &rows, options, err);
    gsn_progress_say(options->progress, "fit", 2, STEPS);
    if (r >= 0)
        r = fit_channel(&eq, 1, control, &channel[0], tet_samples, tet_rms, err);
    if (r >= 0)
        r = fit_others(&eq, value, channels, control, channel, err);
    gsn_progress_say(options->progress, "fit", STEPS, STEPS);
    equations_done(&eq);
    gsn_fit_rows_done(&rows);
    return r;
}

static int check_options(const struct gsn_fit_options *options, struct gsn_error *err)
{
    if (!(options->smoothing >= 0) || !isfinite(options->smoothing) || !(options->jump >= 0) ||
        !isfinite(options->jump) || !(options->tolerance > 0) || !(options->tolerance < 1))
        return gsn_fail(err, GSN_E_INPUT, "smoothing %g, jumps %g and tolerance %g cannot be used",
                        options->smoothing, options->jump, options->tolerance);
    return GSN_OK;
}

int gsn_fit(const struct gsn_dms *space, const struct gsn_samples *samples,
            const struct gsn_fit_options *options, struct gsn_spline **ret_spline,
            struct gsn_fit_report *ret_report, uint32_t **ret_tet_samples, double **ret_tet_rms,
            struct gsn_error *err)
{
    const struct gsn_fit_options full = with_defaults(options);
    const size_t tets = gsn_dms_mesh(space)->tet_count;
    struct channel channel = { .spline = NULL };
    gsn_auto_mem(uint32_t) tet_samples = NULL;
    gsn_auto_mem(double) tet_rms = NULL;
    int r;

    assert(space && samples && options && ret_spline && ret_report);
    r = check_options(&full, err);
    if (r < 0)
        return r;
    tet_samples = gsn_alloc_array(tets, sizeof *tet_samples);
    tet_rms = gsn_alloc_array(tets, sizeof *tet_rms);
    if (!tet_samples || !tet_rms)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the residuals");
    r = fit_all(space, samples, NULL, 1, &full, &channel, tet_samples, tet_rms, err);
    if (r < 0) {
        gsn_spline_free(channel.spline);
        return r;
    }
    *ret_spline = channel.spline;
    *ret_report = channel.report;
    if (ret_tet_samples)
        *ret_tet_samples = gsn_steal(&tet_samples);
    if (ret_tet_rms)
        *ret_tet_rms = gsn_steal(&tet_rms);
    return GSN_OK;
}

int gsn_fit_channels(const struct gsn_dms *space, const struct gsn_samples *samples,
                     const double *const *value, size_t channels,
                     const struct gsn_fit_options *options, struct gsn_spline **ret_splines,
                     struct gsn_fit_report *ret_reports, struct gsn_error *err)
{
    const struct gsn_fit_options full = with_defaults(options);
    gsn_auto_mem(struct channel) channel = gsn_alloc_array(channels, sizeof *channel);
    struct gsn_samples first = *samples;
    int r = check_options(&full, err);

    assert(space && value && channels > 0 && ret_splines && ret_reports);
    if (r < 0)
        return r;
    if (!channel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu channels", channels);
    first.exact = value[0];
    r = fit_all(space, &first, value, channels, &full, channel, NULL, NULL, err);
    for (size_t c = 0; c < channels; c++) {
        if (r < 0) {
            gsn_spline_free(channel[c].spline);
            continue;
        }
        ret_splines[c] = channel[c].spline;
        ret_reports[c] = channel[c].report;
    }
    return r;
}

double gsn_generalised_cross_validation(const struct gsn_fit_report *fit, size_t tets)
{
    const double sampled = 1 - (double)fit->empty_tets / (double)tets;
    const double freedom = 1 - sampled * (double)fit->unknowns / (double)fit->samples;

    return freedom > 0 ? fit->rms / freedom : INFINITY;
}
