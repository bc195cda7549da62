/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Adaptive refinement: where to have more unknowns, and when to stop.
 *
 * Method: the mesh is refined by size where the residual is large, and each mesh is fitted anew
 * (docs/MATH.md, section 8); a round is taken by its predicted error: two-fold cross-validation
 * where there are folds, else generalised cross-validation (Craven and Wahba 1979, fit.h).
 *
 * Steps: (1) clouds, space and fit on the first mesh; (2) tetrahedra above the tolerance that have
 * samples enough to be split, those with most squared error first; (3) as many of them as the
 * budget of unknowns allows; (4) the mesh is bisected to their limits of volume
 * (bisection.c), and with half of them again when more came out than expected; (5) a fit; (6) taken
 * if it predicts better by a thousandth, and so on.
 *
 * Failure: that of the first fit; a later round that fails for the mesh or the fit ends
 * the rounds, and the report says why. Cost: a mesh and a fit a round, the last the largest. */
#include "pipeline/model/refine.h"

#include "pipeline/model/bisection.h"
#include "pipeline/model/fit.h"

#include <assert.h>
#include <math.h>
#include <stdbool.h>
#include <stdlib.h>

static const double CLOUD = 0.015, SAMPLES_PER_UNKNOWN = 8;
enum { DEGREE = 2, SAMPLES_PER_TET = 20, TRIES = 4 };

/* A round splits a tetrahedron into eight, three bisections; where its samples allow less, pieces
 * come out at half to the whole of their limit. */
static const double LIMIT = 0.125, COMES_OUT_AT = 0.5;

/* A round must lower the predicted error by this part of it: less is not worth the unknowns. */
static const double GAIN = 1e-3;

/* A mesh with its fit. */
struct state {
    struct gsn_dms *space;
    struct gsn_spline *spline;
    struct gsn_fit_report fit;
    uint32_t *tet_samples;
    double *tet_rms;
    double predicted; /* error at samples not seen */
};

/* A tetrahedron that asks to be split. */
struct wish {
    double squares; /* what it adds to the sum of squares */
    double limit;   /* um^3 for what it is split into */
    double pieces;  /* expected */
    size_t tet;
};

static void state_done(struct state *state)
{
    gsn_spline_free(state->spline);
    gsn_dms_free(state->space);
    gsn_free(state->tet_samples);
    gsn_free(state->tet_rms);
    *state = (struct state){ .space = NULL };
}

void gsn_adapt_report_done(struct gsn_adapt_report *report)
{
    gsn_free(report->tet_samples);
    gsn_free(report->tet_rms);
    report->tet_samples = NULL;
    report->tet_rms = NULL;
}

static int complete_options(const struct gsn_adapt_options *options, struct gsn_adapt_options *ret,
                            struct gsn_error *err)
{
    *ret = *options;
    if (ret->degree == 0)
        ret->degree = DEGREE;
    if (ret->cloud == 0)
        ret->cloud = CLOUD;
    if (ret->samples_per_unknown == 0)
        ret->samples_per_unknown = SAMPLES_PER_UNKNOWN;
    if (ret->samples_per_tet == 0)
        ret->samples_per_tet = SAMPLES_PER_TET;
    if (ret->rounds > GSN_ADAPT_MOST_ROUNDS)
        return gsn_fail(err, GSN_E_INPUT, "%u rounds of refinement, %d at most", ret->rounds,
                        GSN_ADAPT_MOST_ROUNDS);
    if (!(ret->tolerance >= 0) || !(ret->samples_per_unknown > 0))
        return gsn_fail(err, GSN_E_INPUT, "a tolerance of %g with %g samples per unknown",
                        ret->tolerance, ret->samples_per_unknown);
    return GSN_OK;
}

/* gives: clouds and the space over them. */
static int space_on(const struct gsn_tets *mesh, const struct gsn_adapt_options *options,
                    struct gsn_dms **ret_space, struct gsn_error *err)
{
    double(*knots)[3] = NULL;
    int r = gsn_dms_clouds(mesh, options->degree, options->cloud, &knots, err);

    if (r >= 0)
        r = gsn_dms_new(mesh, options->degree, knots, GSN_DMS_SHARED, ret_space, err);
    gsn_free(knots);
    return r;
}

/* Fits on state->space, which is given back when that fails. */
static int fit_state(struct state *state, const struct gsn_samples *samples,
                     const struct gsn_adapt_options *options, struct gsn_error *err)
{
    int r = gsn_fit(state->space, samples, &options->fit, &state->spline, &state->fit,
                    &state->tet_samples, &state->tet_rms, err);

    if (r < 0)
        state_done(state);
    else
        state->predicted = options->fit.fold
                               ? state->fit.predicted
                               : gsn_generalised_cross_validation(
                                     &state->fit, gsn_dms_mesh(state->space)->tet_count);
    return r;
}

static size_t over_tolerance(const struct state *state, double tolerance)
{
    size_t over = 0;

    for (size_t t = 0; t < gsn_dms_mesh(state->space)->tet_count; t++)
        over += state->tet_rms[t] > tolerance;
    return over;
}

static void record_round(struct gsn_adapt_report *report, const struct state *state,
                         double tolerance, bool accepted)
{
    report->round[report->rounds++] = (struct gsn_adapt_round){
        .tets = gsn_dms_mesh(state->space)->tet_count,
        .unknowns = state->fit.unknowns,
        .empty_tets = state->fit.empty_tets,
        .over_tolerance = over_tolerance(state, tolerance),
        .rms = state->fit.rms,
        .worst = state->fit.worst,
        .predicted = state->predicted,
        .accepted = accepted,
    };
}

/* Most error first; equal ones in the order of the mesh. */
static int compare_wishes(const void *a, const void *b)
{
    const struct wish *left = a, *right = b;

    if (left->squares != right->squares)
        return left->squares > right->squares ? -1 : 1;
    return (left->tet > right->tet) - (left->tet < right->tet);
}

/* Fills wishes with the tetrahedra worth splitting; returns how many. */
static size_t collect_wishes(const struct state *state, const struct gsn_adapt_options *options,
                             struct wish *wishes)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(state->space);
    size_t count = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double samples = state->tet_samples[t];
        double part;

        if (samples == 0 || !(state->tet_rms[t] > options->tolerance))
            continue;
        part = fmax(LIMIT, options->samples_per_tet / (COMES_OUT_AT * samples));
        /* Limits near the volume itself would only stir the mesh. */
        if (part > COMES_OUT_AT)
            continue;
        wishes[count++] = (struct wish){
            .squares = state->tet_rms[t] * state->tet_rms[t] * samples,
            .limit = part * gsn_tets_volume(mesh, t),
            .pieces = 1 / (part * COMES_OUT_AT),
            .tet = t,
        };
    }
    qsort(wishes, count, sizeof *wishes, compare_wishes);
    return count;
}

/* How many wishes, from the first, keep the expected unknowns within the budget. */
static size_t count_affordable(const struct state *state, const struct wish *wishes, size_t count,
                               double budget)
{
    const double tets = (double)gsn_dms_mesh(state->space)->tet_count;
    const double each = (double)state->fit.unknowns / tets;
    double unknowns = (double)state->fit.unknowns;
    size_t taken = 0;

    while (taken < count && unknowns + each * (wishes[taken].pieces - 1) <= budget)
        unknowns += each * (wishes[taken++].pieces - 1);
    return taken;
}

static int split_wishes(const struct state *state, const struct wish *wishes, size_t count,
                        struct gsn_tets **ret_mesh, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(state->space);
    gsn_auto_mem(double) limit = gsn_alloc_array(mesh->tet_count, sizeof *limit);

    if (!limit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while refining a fit");
    for (size_t i = 0; i < count; i++)
        limit[wishes[i].tet] = wishes[i].limit;
    return gsn_tets_bisect(mesh, limit, ret_mesh, err);
}

/* One refinement and its fit into ret; with fewer wishes when it comes out over the budget. Without
 * a space in ret nothing could be afforded, and *ret_end says why. */
static int next_state(const struct state *state, const struct gsn_samples *samples,
                      const struct gsn_adapt_options *options, struct state *ret,
                      enum gsn_adapt_end *ret_end, struct gsn_error *err)
{
    const double carried = (double)samples->count / options->samples_per_unknown;
    const double most = options->most_unknowns ? (double)options->most_unknowns : carried;
    gsn_auto_mem(struct wish) wishes =
        gsn_alloc_array(gsn_dms_mesh(state->space)->tet_count, sizeof *wishes);
    size_t count;

    if (!wishes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while refining a fit");
    count = collect_wishes(state, options, wishes);
    *ret_end = count > 0 && most < carried ? GSN_ADAPT_UNKNOWNS : GSN_ADAPT_SAMPLES;
    count = count_affordable(state, wishes, count, fmin(most, carried));
    for (unsigned attempt = 0; attempt < TRIES && count > 0; attempt++, count /= 2) {
        gsn_auto(gsn_tets) mesh = NULL;
        struct state next = { .space = NULL };
        int r = split_wishes(state, wishes, count, &mesh, err);

        if (r >= 0)
            r = space_on(mesh, options, &next.space, err);
        if (r < 0)
            return r;
        if ((double)gsn_dms_controls(next.space) <= fmin(most, carried)) {
            r = fit_state(&next, samples, options, err);
            if (r >= 0)
                *ret = next;
            return r;
        }
        state_done(&next);
    }
    return GSN_OK;
}

/* Failures of one refinement that leave the fit before it as good as it was. */
static bool ends_the_rounds(int code)
{
    return code == GSN_E_MESH || code == GSN_E_PROCESS || code == GSN_E_FIT;
}

/* *ret_more: the refinement was taken, another may follow; else report->end says why not. */
static int refine_round(struct state *state, const struct gsn_samples *samples,
                        const struct gsn_adapt_options *options, struct gsn_adapt_report *report,
                        bool *ret_more, struct gsn_error *err)
{
    struct state next = { .space = NULL };
    const int r = next_state(state, samples, options, &next, &report->end, &report->why);

    *ret_more = false;
    if (ends_the_rounds(r)) {
        report->end = GSN_ADAPT_FAILED;
        return GSN_OK;
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", report->why.text);
    if (!next.space)
        return GSN_OK;
    *ret_more = next.predicted < state->predicted * (1 - GAIN);
    record_round(report, &next, options->tolerance, *ret_more);
    if (*ret_more) {
        const struct state old = *state;

        *state = next;
        next = old;
    } else {
        report->end = GSN_ADAPT_NO_GAIN;
    }
    state_done(&next);
    return GSN_OK;
}

static int refine_rounds(struct state *state, const struct gsn_samples *samples,
                         const struct gsn_adapt_options *options, struct gsn_adapt_report *report,
                         struct gsn_error *err)
{
    bool more = true;
    int r = GSN_OK;

    for (unsigned round = 0; more && r >= 0; round++) {
        gsn_progress_say(options->progress, "adapt", round, options->rounds);
        more = round < options->rounds;
        report->end = GSN_ADAPT_ROUNDS;
        if (over_tolerance(state, options->tolerance) == 0) {
            report->end = GSN_ADAPT_WITHIN;
            break;
        }
        if (more)
            r = refine_round(state, samples, options, report, &more, err);
    }
    return r;
}

int gsn_adapt(const struct gsn_tets *mesh, const struct gsn_samples *samples,
              const struct gsn_adapt_options *options, struct gsn_dms **ret_space,
              struct gsn_spline **ret_spline, struct gsn_adapt_report *ret_report,
              struct gsn_error *err)
{
    struct gsn_adapt_report report = { .rounds = 0 };
    struct gsn_adapt_options full;
    struct state state = { .space = NULL };
    int r;

    assert(mesh && samples && options && ret_space && ret_spline && ret_report);
    r = complete_options(options, &full, err);
    if (r >= 0)
        r = space_on(mesh, &full, &state.space, err);
    if (r >= 0)
        r = fit_state(&state, samples, &full, err);
    if (r >= 0) {
        record_round(&report, &state, full.tolerance, true);
        r = refine_rounds(&state, samples, &full, &report, err);
    }
    if (r < 0) {
        state_done(&state);
        return r;
    }
    report.fit = state.fit;
    report.tet_samples = gsn_steal(&state.tet_samples);
    report.tet_rms = gsn_steal(&state.tet_rms);
    *ret_report = report;
    *ret_space = gsn_steal(&state.space);
    *ret_spline = gsn_steal(&state.spline);
    return GSN_OK;
}
