/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What each sample contributes to the normal equations of a fit.
 *
 * Method: in the core of a tetrahedron the spline is one polynomial, and the basis at a sample is
 * that of its B-patch (docs/MATH.md, section 7); near faces, in the seams, it is the row of all
 * functions that reach the sample (face_correction.c).
 *
 * Steps: (1) each sample's tetrahedron, found from that of the sample before; (2) samples sorted by
 * tetrahedron, in a counting sort; (3) the weight of each fold, and the mean, from which the fit is
 * of the deviations; (4) tetrahedron by tetrahedron: core samples are summed into its dense block,
 * upper triangle packed, seam samples keep their row; (5) the rows of all tasks joined in order;
 * (6) other values at the same places change right sides only; (7) residuals, for which core
 * samples are evaluated again.
 *
 * Failure: GSN_E_INPUT names the first sample that is not finite, has a weight that is none or lies
 * outside, GSN_E_LIMIT, GSN_E_NOMEM. Cost: a core sample costs a block's worth of multiplications,
 * a seam sample keeps 12 bytes for each function that reaches it. */
#include "pipeline/model/fit_system.h"

#include "pipeline/core/parallel.h"
#include "pipeline/model/bpatch.h"
#include "pipeline/model/face_correction.h"
#include "pipeline/model/barycentric.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

enum {
    SAMPLES_A_TASK = 4096,
    TETS_A_TASK = 64,
    MOST_SAMPLES = INT32_MAX,
    FIRST_ROOM = 256, /* control points of one sample; grows where more tetrahedra meet */
};

/* A barycentric coordinate this near to the core's edge is left to the exact seam evaluation. */
static const double MARGIN = 1e-9;

static size_t tasks_for(size_t count, size_t each)
{
    return (count + each - 1) / each;
}

static size_t smaller_of(size_t a, size_t b)
{
    return a < b ? a : b;
}

static double value_of(const struct gsn_samples *samples, size_t i)
{
    return samples->exact ? samples->exact[i] : (double)samples->value[i];
}

static double weight_of(const struct gsn_samples *samples, size_t i)
{
    return samples->weight ? samples->weight[i] : 1;
}

static size_t fold_of(const struct gsn_fit_rows *rows, size_t i)
{
    return rows->fold ? rows->fold[i] & 1 : 0;
}

/* ---- where every sample lies ---- */

static const uint32_t OUTSIDE = UINT32_MAX;

struct location {
    const struct gsn_fit_rows *rows;
    int forgiving;
    uint32_t *tet; /* or OUTSIDE */
};

static int locate_task(size_t task, void *context, struct gsn_error *err)
{
    const struct location *where = context;
    const struct gsn_samples *samples = where->rows->samples;
    const size_t end = smaller_of((task + 1) * SAMPLES_A_TASK, samples->count);
    size_t tet = 0;

    for (size_t i = task * SAMPLES_A_TASK; i < end; i++) {
        const double *u = samples->at[i];
        int r;

        if (!isfinite(value_of(samples, i)) || !isfinite(u[0] + u[1] + u[2]))
            return gsn_fail(err, GSN_E_INPUT, "sample %zu is not finite", i);
        if (!(weight_of(samples, i) >= 0) || !isfinite(weight_of(samples, i)))
            return gsn_fail(err, GSN_E_INPUT, "sample %zu has the weight %g", i,
                            weight_of(samples, i));
        r = gsn_dms_locate(where->rows->space, u, tet, &tet);
        if (r != GSN_OK && !where->forgiving)
            return gsn_fail(err, GSN_E_INPUT,
                            "sample %zu at (%.6g, %.6g, %.6g) um lies outside the mesh", i, u[0],
                            u[1], u[2]);
        where->tet[i] = r == GSN_OK ? (uint32_t)tet : OUTSIDE;
    }
    return GSN_OK;
}

static int sort_samples(struct gsn_fit_rows *rows, const uint32_t *tet, struct gsn_error *err)
{
    const size_t tets = gsn_dms_mesh(rows->space)->tet_count, count = rows->samples->count;

    rows->start = gsn_alloc_array(tets + 2, sizeof *rows->start);
    rows->order = gsn_alloc_array(count, sizeof *rows->order);
    if (!rows->start || !rows->order)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu samples", count);
    /* start[t + 1] counts up from the first of t to the first of t + 1. */
    for (size_t i = 0; i < count; i++)
        if (tet[i] != OUTSIDE)
            rows->start[tet[i] + 2]++;
    for (size_t t = 0; t < tets; t++)
        rows->start[t + 2] += rows->start[t + 1];
    for (size_t i = 0; i < count; i++)
        if (tet[i] != OUTSIDE)
            rows->order[rows->start[tet[i] + 1]++] = (uint32_t)i;
    return GSN_OK;
}

/* How much each fold has inside the mesh, and what is outside of it. */
static int weigh_folds(struct gsn_fit_rows *rows, const uint32_t *tet, struct gsn_error *err)
{
    rows->first_outside = rows->samples->count;
    for (size_t i = 0; i < rows->samples->count; i++) {
        if (tet[i] == OUTSIDE) {
            rows->first_outside = smaller_of(rows->first_outside, i);
            continue;
        }
        rows->inside++;
        rows->mass[fold_of(rows, i)] += weight_of(rows->samples, i);
    }
    if (rows->inside == 0)
        return gsn_fail(err, GSN_E_INPUT, "all %zu samples lie outside the mesh",
                        rows->samples->count);
    for (size_t k = 0; k < rows->folds; k++)
        if (!(rows->mass[k] > 0))
            return gsn_fail(err, GSN_E_INPUT, "no sample in the mesh%s has a weight above 0",
                            rows->folds == 1 ? ""
                            : k == 0         ? " and in fold 0"
                                             : " and in fold 1");
    return GSN_OK;
}

/* Mean of the values with their weights, summed in the order of the samples. */
static int find_mean(struct gsn_fit_rows *rows, struct gsn_error *err)
{
    const struct gsn_samples *samples = rows->samples;
    gsn_auto_mem(uint8_t) inside = gsn_alloc_array(samples->count, 1);
    double sum = 0;

    if (!inside)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu samples", samples->count);
    for (size_t i = 0; i < rows->inside; i++)
        inside[rows->order[i]] = 1;
    for (size_t i = 0; i < samples->count; i++)
        if (inside[i])
            sum += weight_of(samples, i) * value_of(samples, i);
    rows->mean = sum / (rows->mass[0] + rows->mass[1]);
    return GSN_OK;
}

int gsn_fit_rows_sort(struct gsn_fit_rows *rows, const struct gsn_dms *space,
                      const struct gsn_samples *samples, const struct gsn_fit_options *options,
                      struct gsn_error *err)
{
    gsn_auto_mem(uint32_t) tet = NULL;
    struct location where = { .rows = rows, .forgiving = options->forgiving };
    int r;

    *rows = (struct gsn_fit_rows){
        .space = space, .samples = samples, .fold = options->fold, .folds = options->fold ? 2 : 1
    };
    if (samples->count == 0)
        return gsn_fail(err, GSN_E_INPUT, "there are no samples to fit");
    if (samples->count > MOST_SAMPLES)
        return gsn_fail(err, GSN_E_LIMIT, "%zu samples are more than the %d that a fit takes",
                        samples->count, MOST_SAMPLES);
    tet = gsn_alloc_array(samples->count, sizeof *tet);
    if (!tet)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu samples", samples->count);
    where.tet = tet;
    r = gsn_parallel_for(tasks_for(samples->count, SAMPLES_A_TASK), options->threads, locate_task,
                         &where, err);
    if (r >= 0)
        r = weigh_folds(rows, tet, err);
    if (r >= 0)
        r = sort_samples(rows, tet, err);
    return r < 0 ? r : find_mean(rows, err);
}

/* ---- what every sample contributes ---- */

/* The seam rows of one task's tetrahedra. */
struct part {
    size_t rows, row_room, terms, term_room;
    size_t *end; /* of each row's terms */
    uint32_t *sample;
    double *target;
    uint32_t *control;
    double *value;
};

struct evaluation {
    struct gsn_fit_rows *rows;
    struct part *part;
};

/* What is the same for all samples of a tetrahedron. */
struct cell {
    size_t tet;
    struct gsn_barycentric frame;
    double delta[4];
    double knot[4 * (GSN_DMS_MAX_DEGREE + 1)][3];
};

static void cell_init(struct cell *cell, const struct gsn_dms *space, size_t tet)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const size_t each = gsn_dms_degree(space) + 1;
    const uint32_t *v = mesh->tet[tet];

    cell->tet = tet;
    gsn_barycentric_init(&cell->frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                         mesh->vertex[v[3]]);
    gsn_dms_core(space, tet, cell->delta);
    for (size_t k = 0; k < 4; k++)
        memcpy(cell->knot[k * each], gsn_dms_knots(space)[v[k] * each],
               each * sizeof cell->knot[0]);
}

static bool in_core(const struct cell *cell, const double u[3])
{
    double lambda[4];

    gsn_barycentric_at(&cell->frame, u, lambda);
    for (size_t k = 0; k < 4; k++)
        if (!(lambda[k] > cell->delta[k] + MARGIN))
            return false;
    return true;
}

static void add_core(struct gsn_fit_rows *rows, const struct cell *cell, size_t sample)
{
    const size_t functions = gsn_dms_functions(rows->space);
    const size_t fold = fold_of(rows, sample);
    const double weight = weight_of(rows->samples, sample);
    const double target = value_of(rows->samples, sample) - rows->mean;
    double *block = rows->block[fold] + cell->tet * rows->packed;
    double *right = rows->right[fold] + cell->tet * functions;
    double value[GSN_DMS_MAX_FUNCTIONS];

    gsn_bpatch_basis(gsn_dms_degree(rows->space), cell->knot, rows->samples->at[sample], value,
                     NULL);
    for (size_t f = 0; f < functions; f++) {
        const double weighted = weight * value[f];

        right[f] += weighted * target;
        for (size_t g = f; g < functions; g++)
            *block++ += weighted * value[g];
    }
}

static int out_of_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the basis values of the samples");
}

/* array: the address of a pointer of any type. */
static bool grow_array(void *array, size_t room, size_t size)
{
    void *larger;

    memcpy(&larger, array, sizeof larger);
    larger = gsn_realloc_array(larger, room, size);
    if (larger)
        memcpy(array, &larger, sizeof larger);
    return larger != NULL;
}

static bool room_for_row(struct part *part, size_t terms)
{
    if (part->rows == part->row_room) {
        const size_t room = 2 * part->row_room + 64;

        if (!grow_array(&part->end, room, sizeof *part->end) ||
            !grow_array(&part->sample, room, sizeof *part->sample) ||
            !grow_array(&part->target, room, sizeof *part->target))
            return false;
        part->row_room = room;
    }
    if (part->terms + terms > part->term_room) {
        const size_t room = 2 * (part->term_room + terms) + 1024;

        if (!grow_array(&part->control, room, sizeof *part->control) ||
            !grow_array(&part->value, room, sizeof *part->value))
            return false;
        part->term_room = room;
    }
    return true;
}

static int add_seam(struct part *part, const struct gsn_fit_rows *rows, size_t tet, size_t sample,
                    struct gsn_error *err)
{
    size_t room = FIRST_ROOM, count = 0;
    double sum = 0;
    int r;

    do {
        if (!room_for_row(part, room))
            return out_of_memory(err);
        r = gsn_face_correction_row(rows->space, tet, rows->samples->at[sample], room,
                                    &part->control[part->terms], &part->value[part->terms], &count);
        room *= 2;
    } while (r == GSN_E_LIMIT);
    for (size_t i = part->terms; i < part->terms + count; i++)
        sum += part->value[i];
    part->terms += count;
    part->sample[part->rows] = (uint32_t)sample;
    part->target[part->rows] = value_of(rows->samples, sample) - rows->mean * sum;
    part->end[part->rows++] = part->terms;
    return GSN_OK;
}

static int evaluate_tets(struct gsn_fit_rows *rows, struct part *part, size_t first, size_t end,
                         struct gsn_error *err)
{
    for (size_t t = first; t < end; t++) {
        struct cell cell;

        if (rows->start[t] < rows->start[t + 1])
            cell_init(&cell, rows->space, t);
        for (size_t i = rows->start[t]; i < rows->start[t + 1]; i++) {
            const size_t sample = rows->order[i];
            int r = GSN_OK;

            if (in_core(&cell, rows->samples->at[sample]))
                add_core(rows, &cell, sample);
            else
                r = add_seam(part, rows, t, sample, err);
            if (r < 0)
                return r;
        }
        rows->seam_of_tet[t + 1] = part->rows; /* of this task so far; join_parts() makes it all */
    }
    return GSN_OK;
}

static int evaluate_task(size_t task, void *context, struct gsn_error *err)
{
    const struct evaluation *work = context;
    const size_t first = task * TETS_A_TASK;
    const size_t tets = gsn_dms_mesh(work->rows->space)->tet_count;

    return evaluate_tets(work->rows, &work->part[task], first,
                         smaller_of(first + TETS_A_TASK, tets), err);
}

static void part_done(struct part *part)
{
    gsn_free(part->end);
    gsn_free(part->sample);
    gsn_free(part->target);
    gsn_free(part->control);
    gsn_free(part->value);
    *part = (struct part){ .end = NULL };
}

/* Puts the parts, in their order, into one list, and gives each back as soon as it is in. */
static int join_parts(struct gsn_fit_rows *rows, struct part *part, size_t parts,
                      struct gsn_error *err)
{
    const size_t tets = gsn_dms_mesh(rows->space)->tet_count;
    size_t terms = 0, row = 0, at = 0;

    for (size_t p = 0; p < parts; p++) {
        rows->seams += part[p].rows;
        terms += part[p].terms;
    }
    rows->seam_first = gsn_alloc_array(rows->seams + 1, sizeof *rows->seam_first);
    rows->seam_sample = gsn_alloc_array(rows->seams, sizeof *rows->seam_sample);
    rows->seam_target = gsn_alloc_array(rows->seams, sizeof *rows->seam_target);
    rows->seam_control = gsn_alloc_array(terms, sizeof *rows->seam_control);
    rows->seam_value = gsn_alloc_array(terms, sizeof *rows->seam_value);
    if (!rows->seam_first || !rows->seam_sample || !rows->seam_target || !rows->seam_control ||
        !rows->seam_value)
        return out_of_memory(err);
    for (size_t p = 0; p < parts; p++) {
        const size_t end = smaller_of((p + 1) * TETS_A_TASK, tets);

        for (size_t t = p * TETS_A_TASK; t < end; t++)
            rows->seam_of_tet[t + 1] += row;
        for (size_t i = 0; i < part[p].rows; i++) {
            rows->seam_sample[row] = part[p].sample[i];
            rows->seam_target[row] = part[p].target[i];
            rows->seam_first[++row] = at + part[p].end[i];
        }
        for (size_t i = 0; i < part[p].terms; i++) {
            rows->seam_control[at] = part[p].control[i];
            rows->seam_value[at++] = part[p].value[i];
        }
        part_done(&part[p]);
    }
    return GSN_OK;
}

/* Of the targets: those in seams are what they are less of the mean that the functions there make.
 */
static void sum_squares(struct gsn_fit_rows *rows)
{
    size_t seam = 0;

    rows->squares[0] = rows->squares[1] = 0;
    for (size_t i = 0; i < rows->inside; i++) {
        const size_t sample = rows->order[i];
        const bool in_seam = seam < rows->seams && rows->seam_sample[seam] == sample;
        const double target =
            in_seam ? rows->seam_target[seam++] : value_of(rows->samples, sample) - rows->mean;

        rows->squares[fold_of(rows, sample)] += weight_of(rows->samples, sample) * target * target;
    }
}

int gsn_fit_rows_evaluate(struct gsn_fit_rows *rows, unsigned threads, struct gsn_error *err)
{
    const size_t tets = gsn_dms_mesh(rows->space)->tet_count;
    const size_t functions = gsn_dms_functions(rows->space), tasks = tasks_for(tets, TETS_A_TASK);
    gsn_auto_mem(struct part) part = gsn_alloc_array(tasks, sizeof *part);
    struct evaluation work = { rows, part };
    int r;

    rows->packed = functions * (functions + 1) / 2;
    for (size_t k = 0; k < rows->folds; k++) {
        rows->block[k] = gsn_alloc_array(tets, rows->packed * sizeof *rows->block[k]);
        rows->right[k] = gsn_alloc_array(tets, functions * sizeof *rows->right[k]);
        if (!rows->block[k] || !rows->right[k])
            return out_of_memory(err);
    }
    rows->rough = gsn_alloc_array(tets, rows->packed * sizeof *rows->rough);
    rows->seam_of_tet = gsn_alloc_array(tets + 1, sizeof *rows->seam_of_tet);
    if (!part || !rows->rough || !rows->seam_of_tet)
        return out_of_memory(err);
    r = gsn_parallel_for(tasks, threads, evaluate_task, &work, err);
    if (r >= 0)
        r = join_parts(rows, part, tasks, err);
    if (r >= 0)
        sum_squares(rows);
    for (size_t p = 0; p < tasks; p++)
        part_done(&part[p]);
    return r;
}

void gsn_fit_rows_done(struct gsn_fit_rows *rows)
{
    gsn_free(rows->start);
    gsn_free(rows->order);
    for (size_t k = 0; k < 2; k++) {
        gsn_free(rows->block[k]);
        gsn_free(rows->right[k]);
    }
    gsn_free(rows->rough);
    gsn_free(rows->curvature);
    gsn_free(rows->seam_first);
    gsn_free(rows->seam_sample);
    gsn_free(rows->seam_target);
    gsn_free(rows->seam_control);
    gsn_free(rows->seam_value);
    gsn_free(rows->seam_of_tet);
    *rows = (struct gsn_fit_rows){ .space = NULL };
}

/* ---- other values at the same samples ---- */

static void aim_seam(struct gsn_fit_rows *rows, size_t row)
{
    double sum = 0;

    for (size_t i = rows->seam_first[row]; i < rows->seam_first[row + 1]; i++)
        sum += rows->seam_value[i];
    rows->seam_target[row] = value_of(rows->samples, rows->seam_sample[row]) - rows->mean * sum;
}

static void aim_core(struct gsn_fit_rows *rows, const struct cell *cell, size_t sample)
{
    const size_t functions = gsn_dms_functions(rows->space);
    const double target = value_of(rows->samples, sample) - rows->mean;
    double *right = rows->right[fold_of(rows, sample)] + cell->tet * functions;
    double value[GSN_DMS_MAX_FUNCTIONS];

    gsn_bpatch_basis(gsn_dms_degree(rows->space), cell->knot, rows->samples->at[sample], value,
                     NULL);
    for (size_t f = 0; f < functions; f++)
        right[f] += weight_of(rows->samples, sample) * value[f] * target; /* as add_core() */
}

static void aim_tet(struct gsn_fit_rows *rows, size_t tet)
{
    const size_t functions = gsn_dms_functions(rows->space);
    size_t seam = rows->seam_of_tet[tet];
    struct cell cell;

    for (size_t k = 0; k < rows->folds; k++)
        memset(rows->right[k] + tet * functions, 0, functions * sizeof *rows->right[k]);
    if (rows->start[tet] < rows->start[tet + 1])
        cell_init(&cell, rows->space, tet);
    for (size_t i = rows->start[tet]; i < rows->start[tet + 1]; i++) {
        const size_t sample = rows->order[i];

        if (seam < rows->seam_of_tet[tet + 1] && rows->seam_sample[seam] == sample)
            aim_seam(rows, seam++);
        else
            aim_core(rows, &cell, sample);
    }
}

static int aim_task(size_t task, void *context, struct gsn_error *err)
{
    struct gsn_fit_rows *rows = context;
    const size_t end = smaller_of((task + 1) * TETS_A_TASK, gsn_dms_mesh(rows->space)->tet_count);

    (void)err;
    for (size_t t = task * TETS_A_TASK; t < end; t++)
        aim_tet(rows, t);
    return GSN_OK;
}

int gsn_fit_rows_aim(struct gsn_fit_rows *rows, const struct gsn_samples *samples, unsigned threads,
                     struct gsn_error *err)
{
    int r;

    for (size_t i = 0; i < samples->count; i++)
        if (!isfinite(value_of(samples, i)))
            return gsn_fail(err, GSN_E_INPUT, "sample %zu is not finite", i);
    rows->samples = samples;
    r = find_mean(rows, err);
    if (r >= 0)
        r = gsn_parallel_for(tasks_for(gsn_dms_mesh(rows->space)->tet_count, TETS_A_TASK), threads,
                             aim_task, rows, err);
    if (r >= 0)
        sum_squares(rows);
    return r;
}

/* ---- how far the fit is from every sample ---- */

struct comparison {
    const struct gsn_fit_rows *rows;
    const double *control;
    struct gsn_fit_residual *residual;
};

static double core_value(const struct comparison *with, const struct cell *cell, const double u[3])
{
    const struct gsn_dms *space = with->rows->space;
    const uint32_t *id = gsn_dms_control_ids(space, cell->tet);
    double value[GSN_DMS_MAX_FUNCTIONS], sum = 0;

    gsn_bpatch_basis(gsn_dms_degree(space), cell->knot, u, value, NULL);
    for (size_t f = 0; f < gsn_dms_functions(space); f++)
        sum += value[f] * with->control[id[f]];
    return sum;
}

static double seam_value(const struct comparison *with, size_t row)
{
    const struct gsn_fit_rows *rows = with->rows;
    double sum = 0;

    for (size_t i = rows->seam_first[row]; i < rows->seam_first[row + 1]; i++)
        sum += rows->seam_value[i] * with->control[rows->seam_control[i]];
    return sum;
}

static struct gsn_fit_residual compare_tet(const struct comparison *with, size_t tet)
{
    const struct gsn_fit_rows *rows = with->rows;
    struct gsn_fit_residual sum = { 0 };
    size_t seam = rows->seam_of_tet[tet];
    struct cell cell;

    if (rows->start[tet] < rows->start[tet + 1])
        cell_init(&cell, rows->space, tet);
    for (size_t i = rows->start[tet]; i < rows->start[tet + 1]; i++) {
        const size_t sample = rows->order[i];
        const bool in_seam = seam < rows->seam_of_tet[tet + 1] && rows->seam_sample[seam] == sample;
        const double value =
            in_seam ? seam_value(with, seam++) : core_value(with, &cell, rows->samples->at[sample]);
        const double off = value - value_of(rows->samples, sample);
        const double weight = weight_of(rows->samples, sample);

        sum.squares += weight * off * off;
        sum.mass += weight;
        if (weight > 0)
            sum.worst = fmax(sum.worst, fabs(off));
    }
    return sum;
}

static int compare_task(size_t task, void *context, struct gsn_error *err)
{
    const struct comparison *with = context;
    const size_t end =
        smaller_of((task + 1) * TETS_A_TASK, gsn_dms_mesh(with->rows->space)->tet_count);

    (void)err;
    for (size_t t = task * TETS_A_TASK; t < end; t++)
        with->residual[t] = compare_tet(with, t);
    return GSN_OK;
}

int gsn_fit_rows_residuals(const struct gsn_fit_rows *rows, const double *control, unsigned threads,
                           struct gsn_fit_residual *ret, struct gsn_error *err)
{
    struct comparison with = { rows, control, ret };

    return gsn_parallel_for(tasks_for(gsn_dms_mesh(rows->space)->tet_count, TETS_A_TASK), threads,
                            compare_task, &with, err);
}
