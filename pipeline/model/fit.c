/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/fit.h"

#include "pipeline/model/fit_rows.h"
#include "pipeline/model/fit_smooth.h"
#include "pipeline/model/fit_system.h"

#include <assert.h>
#include <math.h>

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

static int smooth(struct gsn_fit_rows *rows, double smoothing, struct gsn_error *err)
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
static int solve(struct gsn_fit_rows *rows, const struct gsn_fit_options *options,
                 double **ret_control, unsigned *ret_iterations, struct gsn_error *err)
{
    struct gsn_fit_system system = { .unknowns = 0 };
    gsn_auto_mem(double) control = gsn_alloc_array(gsn_dms_controls(rows->space), sizeof *control);
    int r;

    if (!control)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the control points");
    r = smooth(rows, options->smoothing, err);
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

static int figure(const struct gsn_fit_rows *rows, const double *control, unsigned threads,
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
        r = solve(rows, options, &control, &figures->report.iterations, err);
    gsn_progress_say(options->progress, "fit", 3, STEPS);
    if (r >= 0)
        r = figure(rows, control, options->threads, figures, err);
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
