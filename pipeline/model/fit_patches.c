/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The preconditioner of a fit: the equations around each vertex, solved by themselves.
 *
 * Method: additive Schwarz over the open stars of the vertices. A patch has the control points that
 * depend on the vertex (beta > 0 there); its dense matrix is inverted once and applied in every
 * step. Reference: J. Schoeberl, "Multigrid methods for a parameter dependent problem in primal
 * variables", 1999, 10.1007/s002110050465: patches that hold the local functions without jumps make
 * it robust for any weight of the jumps.
 *
 * Failure: GSN_E_FIT on a control point that nothing determines. Cost: 1, 15, 65 control points a
 * patch for degrees 1, 2, 3; their squares in single precision, and as many multiplications a step.
 */
#include "pipeline/model/fit_system.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/parallel.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { PATCHES_A_TASK = 64, ROWS_A_TASK = 4096 };

struct gsn_fit_patches {
    size_t count, unknowns;
    size_t *first;     /* patch p has the control points control[first[p]] .. */
    uint32_t *control; /* ascending within a patch */
    size_t *inverse_first;
    float *inverse;     /* row by row */
    float *local;       /* of the last apply, per entry of control: what went in, scaled */
    double *part;       /* and what came out */
    size_t *user_first; /* unknown i is the entries user[user_first[i]] .. of control */
    size_t *user;
};

static int out_of_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the preconditioner of a fit");
}

void gsn_fit_patches_free(struct gsn_fit_patches *patches)
{
    if (!patches)
        return;
    gsn_free(patches->first);
    gsn_free(patches->control);
    gsn_free(patches->inverse_first);
    gsn_free(patches->inverse);
    gsn_free(patches->local);
    gsn_free(patches->part);
    gsn_free(patches->user_first);
    gsn_free(patches->user);
    gsn_free(patches);
}

static int compare_numbers(const void *a, const void *b)
{
    const uint64_t left = *(const uint64_t *)a, right = *(const uint64_t *)b;

    return (left > right) - (left < right);
}

/* Fills in the patches: pairs (vertex, control point), sorted, each once. */
static int list_patches(const struct gsn_dms *space, struct gsn_fit_patches *patches,
                        struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const size_t functions = gsn_dms_functions(space);
    gsn_auto_mem(uint64_t) pair = gsn_alloc_array(mesh->tet_count, 4 * functions * sizeof *pair);
    size_t count = 0, kept = 0;

    patches->count = mesh->vertex_count;
    patches->first = gsn_alloc_array(patches->count + 1, sizeof *patches->first);
    if (!pair || !patches->first)
        return out_of_memory(err);
    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t f = 0; f < functions; f++)
            for (size_t k = 0; k < 4; k++)
                if (gsn_dms_beta(space, f)[k] > 0)
                    pair[count++] =
                        (uint64_t)mesh->tet[t][k] << 32 | gsn_dms_control_ids(space, t)[f];
    qsort(pair, count, sizeof *pair, compare_numbers);
    for (size_t i = 0; i < count; i++)
        if (kept == 0 || pair[kept - 1] != pair[i])
            pair[kept++] = pair[i];
    patches->control = gsn_alloc_array(kept, sizeof *patches->control);
    if (!patches->control)
        return out_of_memory(err);
    for (size_t i = 0; i < kept; i++) {
        patches->control[i] = (uint32_t)pair[i];
        patches->first[(pair[i] >> 32) + 1] = i + 1;
    }
    return GSN_OK;
}

static int list_users(struct gsn_fit_patches *patches, struct gsn_error *err)
{
    const size_t entries = patches->first[patches->count];

    patches->user_first = gsn_alloc_array(patches->unknowns + 2, sizeof *patches->user_first);
    patches->user = gsn_alloc_array(entries, sizeof *patches->user);
    patches->local = gsn_alloc_array(entries, sizeof *patches->local);
    patches->part = gsn_alloc_array(entries, sizeof *patches->part);
    patches->inverse_first = gsn_alloc_array(patches->count + 1, sizeof *patches->inverse_first);
    if (!patches->user_first || !patches->user || !patches->local || !patches->part ||
        !patches->inverse_first)
        return out_of_memory(err);
    for (size_t i = 0; i < entries; i++)
        patches->user_first[patches->control[i] + 2]++;
    for (size_t i = 0; i < patches->unknowns; i++)
        patches->user_first[i + 2] += patches->user_first[i + 1];
    for (size_t i = 0; i < entries; i++)
        patches->user[patches->user_first[patches->control[i] + 1]++] = i;
    for (size_t p = 0; p < patches->count; p++) {
        const size_t n = patches->first[p + 1] - patches->first[p];

        patches->inverse_first[p + 1] = patches->inverse_first[p] + n * n;
    }
    patches->inverse =
        gsn_alloc_array(patches->inverse_first[patches->count], sizeof *patches->inverse);
    return patches->inverse ? GSN_OK : out_of_memory(err);
}

struct inversion {
    const struct gsn_fit_system *system;
    struct gsn_fit_patches *patches;
};

/* The patch's part of the matrix: its rows are sorted, as are the patch's control points. */
static void take_matrix(const struct gsn_fit_system *system, const uint32_t *control, size_t n,
                        double *ret)
{
    for (size_t a = 0; a < n; a++) {
        size_t b = 0;

        for (size_t k = system->first[control[a]]; k < system->first[control[a] + 1]; k++) {
            while (b < n && control[b] < system->column[k])
                b++;
            if (b < n && control[b] == system->column[k])
                ret[a * n + b] = system->value[k];
        }
    }
}

/* What cannot be inverted, for rounding, is taken by its diagonal. */
static int invert_patch(const struct gsn_fit_system *system, const uint32_t *control, size_t n,
                        double *matrix, float *ret, struct gsn_error *err)
{
    int whole;

    memset(matrix, 0, n * n * sizeof *matrix);
    take_matrix(system, control, n, matrix);
    for (size_t a = 0; a < n; a++)
        if (!(matrix[a * n + a] > 0) || !isfinite(1 / matrix[a * n + a]))
            return gsn_fail(err, GSN_E_FIT,
                            "control point %u is not determined by anything: no sample is near, "
                            "and there is no smoothing",
                            (unsigned)control[a]);
    whole = gsn_invert_spd(matrix, n, n) == 0;
    if (!whole) {
        memset(matrix, 0, n * n * sizeof *matrix);
        take_matrix(system, control, n, matrix);
    }
    for (size_t a = 0; a < n; a++)
        for (size_t b = 0; b < n; b++)
            ret[a * n + b] = (float)(whole    ? matrix[a <= b ? a * n + b : b * n + a]
                                     : a == b ? 1 / matrix[a * n + a]
                                              : 0);
    return GSN_OK;
}

static int invert_task(size_t task, void *context, struct gsn_error *err)
{
    const struct inversion *work = context;
    struct gsn_fit_patches *patches = work->patches;
    const size_t first = task * PATCHES_A_TASK;
    size_t most = 0, end = first + PATCHES_A_TASK;
    gsn_auto_mem(double) matrix = NULL;
    int r = GSN_OK;

    if (end > patches->count)
        end = patches->count;
    for (size_t p = first; p < end; p++)
        if (patches->first[p + 1] - patches->first[p] > most)
            most = patches->first[p + 1] - patches->first[p];
    matrix = gsn_alloc_array(most * most, sizeof *matrix);
    if (!matrix)
        return out_of_memory(err);
    for (size_t p = first; r >= 0 && p < end; p++)
        r = invert_patch(work->system, patches->control + patches->first[p],
                         patches->first[p + 1] - patches->first[p], matrix,
                         patches->inverse + patches->inverse_first[p], err);
    return r;
}

int gsn_fit_patches_new(const struct gsn_dms *space, struct gsn_fit_patches **ret_patches,
                        struct gsn_error *err)
{
    gsn_auto(gsn_fit_patches) patches = gsn_alloc_array(1, sizeof *patches);
    int r;

    if (!patches)
        return out_of_memory(err);
    patches->unknowns = gsn_dms_controls(space);
    r = list_patches(space, patches, err);
    if (r >= 0)
        r = list_users(patches, err);
    if (r >= 0)
        *ret_patches = gsn_steal(&patches);
    return r;
}

int gsn_fit_patches_invert(struct gsn_fit_patches *patches, const struct gsn_fit_system *system,
                           unsigned threads, struct gsn_error *err)
{
    struct inversion work = { system, patches };

    return gsn_parallel_for((patches->count + PATCHES_A_TASK - 1) / PATCHES_A_TASK, threads,
                            invert_task, &work, err);
}

struct application {
    const struct gsn_fit_patches *patches;
    const double *x;
    double *ret;
};

static void apply_patch(const struct application *work, size_t p)
{
    const struct gsn_fit_patches *patches = work->patches;
    const size_t first = patches->first[p], n = patches->first[p + 1] - first;
    const float *row = patches->inverse + patches->inverse_first[p];
    float *local = patches->local + first;
    double size = 0;

    /* scaled, so that a small residual does not leave the range of single precision */
    for (size_t a = 0; a < n; a++)
        size = fmax(size, fabs(work->x[patches->control[first + a]]));
    for (size_t a = 0; a < n; a++)
        local[a] = size > 0 ? (float)(work->x[patches->control[first + a]] / size) : 0;
    for (size_t a = 0; a < n; a++, row += n) {
        float sum = 0;

        for (size_t b = 0; b < n; b++)
            sum += row[b] * local[b];
        patches->part[first + a] = size * (double)sum;
    }
}

static int apply_task(size_t task, void *context, struct gsn_error *err)
{
    const struct application *work = context;
    size_t end = (task + 1) * PATCHES_A_TASK;

    (void)err;
    if (end > work->patches->count)
        end = work->patches->count;
    for (size_t p = task * PATCHES_A_TASK; p < end; p++)
        apply_patch(work, p);
    return GSN_OK;
}

static int gather_task(size_t task, void *context, struct gsn_error *err)
{
    const struct application *work = context;
    const struct gsn_fit_patches *patches = work->patches;
    size_t end = (task + 1) * ROWS_A_TASK;

    (void)err;
    if (end > patches->unknowns)
        end = patches->unknowns;
    for (size_t i = task * ROWS_A_TASK; i < end; i++) {
        work->ret[i] = 0;
        for (size_t k = patches->user_first[i]; k < patches->user_first[i + 1]; k++)
            work->ret[i] += patches->part[patches->user[k]];
    }
    return GSN_OK;
}

void gsn_fit_patches_apply(const struct gsn_fit_patches *patches, const double *x, double *ret,
                           unsigned threads)
{
    struct application work = { patches, x, ret };

    (void)gsn_parallel_for((patches->count + PATCHES_A_TASK - 1) / PATCHES_A_TASK, threads,
                           apply_task, &work, NULL);
    (void)gsn_parallel_for((patches->unknowns + ROWS_A_TASK - 1) / ROWS_A_TASK, threads,
                           gather_task, &work, NULL);
}
