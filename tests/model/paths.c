/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/model/paths.h"

#include "tests/check.h"

#include "pipeline/model/batch.h"
#include "pipeline/model/face_correction.h"
#include "pipeline/model/resample.h"

#include <string.h>

enum { TERMS = 2000, CONTROLS = 2000 };

const char *path_name(enum path path)
{
    static const char *const name[PATHS] = { "recurrence", "eval", "many", "grid", "row" };

    return name[path];
}

int path_has_slope(enum path path)
{
    return path == PATH_RECURRENCE || path == PATH_EVAL || path == PATH_MANY;
}

/* The answers of one point, GSN_OK or GSN_DMS_OUTSIDE. */
static int run_recurrence(const struct gsn_spline *spline, const double u[3], size_t *hint,
                          double *ret_value, double ret_slope[3])
{
    gsn_auto_mem(struct gsn_dms_term) term = gsn_alloc_array(TERMS, sizeof *term);
    const double *control = gsn_spline_controls(spline);
    size_t count;

    if (gsn_dms_basis(gsn_spline_space(spline), u, 1, hint, term, TERMS, &count) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    CHECK(count <= TERMS);
    *ret_value = ret_slope[0] = ret_slope[1] = ret_slope[2] = 0;
    for (size_t i = 0; i < count; i++) {
        *ret_value += control[term[i].control] * term[i].value;
        for (int c = 0; c < 3; c++)
            ret_slope[c] += control[term[i].control] * term[i].gradient[c];
    }
    return GSN_OK;
}

static int run_eval(const struct gsn_spline *spline, const double u[3], size_t *hint,
                    double *ret_value, double ret_slope[3])
{
    double alone = 99;
    const int code = gsn_spline_eval(spline, u, hint, ret_value, ret_slope);

    CHECK(gsn_spline_eval(spline, u, hint, &alone, NULL) == code);
    CHECK(code == GSN_OK ? alone == *ret_value : alone == 99);
    return code;
}

static int run_grid(const struct gsn_spline *spline, const double u[3], double *ret_value)
{
    const struct gsn_lattice at = { 1, 1, 1, { u[0], u[1], u[2] }, { 1, 1, 1 } };
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_resample(spline, &at, 1, ret_value, &err), err);
    return GSN_OK;
}

static int run_row(const struct gsn_spline *spline, const double u[3], size_t *hint,
                   double *ret_value)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    uint32_t control[CONTROLS];
    double weight[CONTROLS], sum = 0;
    size_t count;

    if (gsn_dms_locate(space, u, *hint, hint) != GSN_OK)
        return GSN_DMS_OUTSIDE;
    CHECK(gsn_face_correction_row(space, *hint, u, CONTROLS, control, weight, &count) == GSN_OK);
    for (size_t i = 0; i < count; i++)
        sum += gsn_spline_controls(spline)[control[i]] * weight[i];
    *ret_value = sum;
    return GSN_OK;
}

void path_run(enum path path, const struct gsn_spline *spline, const double (*at)[3], size_t count,
              double *ret_value, double (*ret_slope)[3])
{
    struct gsn_error err = { 0 };
    size_t hint = 0;

    if (path == PATH_MANY) {
        CHECK_OK(gsn_spline_eval_many(spline, at, count, 1, ret_value, ret_slope, &err), err);
        return;
    }
    for (size_t i = 0; i < count; i++) {
        double value = NAN, slope[3] = { NAN, NAN, NAN };
        int code = GSN_DMS_OUTSIDE;

        if (path == PATH_RECURRENCE)
            code = run_recurrence(spline, at[i], &hint, &value, slope);
        else if (path == PATH_EVAL)
            code = run_eval(spline, at[i], &hint, &value, slope);
        else if (path == PATH_GRID)
            code = run_grid(spline, at[i], &value);
        else
            code = run_row(spline, at[i], &hint, &value);
        /* Who has no data leaves the outputs alone. */
        CHECK(code == GSN_OK || (isnan(value) && isnan(slope[0])));
        ret_value[i] = value;
        memcpy(ret_slope[i], slope, sizeof slope);
    }
}

void path_each_isa(struct gsn_dms *space, void (*run)(void *context, const char *name),
                   void *context)
{
    for (int isa = 0; isa < GSN_ISA_COUNT; isa++) {
        const struct gsn_kernels *kernels = gsn_kernels_for((enum gsn_isa)isa);

        if (!kernels)
            continue;
        gsn_dms_use(space, kernels);
        run(context, kernels->name);
    }
    gsn_dms_use(space, gsn_kernels_best());
}

struct comparison {
    const struct gsn_spline *spline;
    const double (*at)[3];
    size_t count;
    double *truth, *value, (*steep)[3], (*slope)[3];
    struct path_gap gap;
};

static void widen(double *gap, double difference)
{
    if (isnan(difference))
        fail_msg("no number");
    *gap = fmax(*gap, fabs(difference));
}

static void compare_point(struct comparison *c, enum path path, size_t i)
{
    if (isnan(c->truth[i]) != isnan(c->value[i])) {
        print_message("%s at %.17g %.17g %.17g: %.17g, not %.17g\n", path_name(path), c->at[i][0],
                      c->at[i][1], c->at[i][2], c->value[i], c->truth[i]);
        fail();
    }
    if (isnan(c->truth[i]))
        return;
    widen(&c->gap.value, c->value[i] - c->truth[i]);
    for (int k = 0; path_has_slope(path) && k < 3; k++)
        widen(&c->gap.slope, c->slope[i][k] - c->steep[i][k]);
}

static void compare_quick(void *context, const char *name)
{
    struct comparison *c = context;

    (void)name;
    for (enum path path = PATH_EVAL; path < PATHS; path++) {
        path_run(path, c->spline, c->at, c->count, c->value, c->slope);
        for (size_t i = 0; i < c->count; i++)
            compare_point(c, path, i);
    }
}

struct path_gap path_compare(struct gsn_dms *space, const struct gsn_spline *spline,
                             const double (*at)[3], size_t count)
{
    gsn_auto_mem(double) truth = gsn_alloc_array(2 * count, sizeof *truth);
    double(*steep)[3] = gsn_alloc_array(2 * count, sizeof *steep);
    struct comparison c = { .spline = spline,
                            .at = at,
                            .count = count,
                            .truth = truth,
                            .value = truth + count,
                            .steep = steep,
                            .slope = steep + count };

    path_run(PATH_RECURRENCE, spline, at, count, truth, steep);
    for (size_t i = 0; i < count; i++) {
        if (isnan(truth[i]))
            continue;
        c.gap.inside++;
        widen(&c.gap.largest, truth[i]);
        for (int k = 0; k < 3; k++)
            widen(&c.gap.steepest, steep[i][k]);
    }
    path_each_isa(space, compare_quick, &c);
    gsn_free(steep);
    return c.gap;
}
