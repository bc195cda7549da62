/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The sparse normal equations of a fit, and conjugate gradients.
 *
 * Method: compressed sparse rows; preconditioned conjugate gradients (M. R. Hestenes, E. Stiefel,
 * "Methods of conjugate gradients for solving linear systems", 1952) with the patches of
 * fit_patches.c. The two folds, the roughness and the jumps are kept as parts of one pattern, so
 * that other weights cost a sum and no assembly.
 *
 * Steps: (1) where each unknown occurs in the blocks, the seam rows and the jumps; (2) each row of
 * the matrix summed over those places into a dense accumulator, its columns sorted; 1024 rows a
 * task; (3) the tasks' rows joined in order; (4) parts combined with the weights asked for; (5)
 * iterations until the residual, in the norm of the preconditioner, is small enough.
 *
 * Failure: GSN_E_FIT where the iterations do not suffice or the matrix is not positive,
 * GSN_E_NOMEM. Cost: an entry takes 4 bytes and 8 for each part and their sum; an iteration is one
 * product with the matrix and one with the patches, its sums in a fixed order. */
#include "pipeline/model/fit_system.h"

#include "pipeline/core/parallel.h"

#include <math.h>
#include <stdbool.h>
#include <string.h>

enum { ROWS_A_TASK = 1024 };

/* Where each unknown occurs in a list of control numbers: positions, ascending. */
struct users {
    size_t *first; /* unknown i has at[first[i]] .. at[first[i + 1]) */
    size_t *at;
};

/* What the matrix is made of: two folds, roughness, and jumps with some curvature. */
enum { PARTS = 4, ROUGH = 2, JUMP = 3 };

/* The matrix rows of one task, before they are joined. */
struct part {
    size_t count, room;
    uint32_t *column;
    double *value[PARTS];
};

struct assembly {
    const struct gsn_fit_rows *rows;
    const struct gsn_face_jumps *jumps; /* NULL: none */
    struct gsn_fit_system *system;
    size_t functions;
    uint32_t *control;   /* of tet * functions + function */
    uint32_t *term_row;  /* the seam row that a term belongs to */
    struct users places; /* in control */
    struct users terms;  /* in rows->seam_control */
    uint32_t *jump_row;  /* the row of jumps that a term belongs to */
    struct users sides;  /* in jumps->control */
    struct part *part;
};

static int out_of_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the normal equations");
}

static size_t smaller_of(size_t a, size_t b)
{
    return a < b ? a : b;
}

static void users_done(struct users *users)
{
    gsn_free(users->first);
    gsn_free(users->at);
}

static bool users_init(struct users *users, size_t unknowns, const uint32_t *control, size_t count)
{
    users->first = gsn_alloc_array(unknowns + 2, sizeof *users->first);
    users->at = gsn_alloc_array(count, sizeof *users->at);
    if (!users->first || !users->at)
        return false;
    /* first[i + 1] counts up from the first of i to the first of i + 1. */
    for (size_t p = 0; p < count; p++)
        users->first[control[p] + 2]++;
    for (size_t i = 0; i < unknowns; i++)
        users->first[i + 2] += users->first[i + 1];
    for (size_t p = 0; p < count; p++)
        users->at[users->first[control[p] + 1]++] = p;
    return true;
}

/* One row being summed: values by column, and the columns that occur. */
struct row {
    double (*sum)[PARTS];
    uint32_t *mark; /* 1 + the row that used the column last */
    uint32_t *column;
    size_t count;
};

static double *row_at(struct row *row, size_t i, uint32_t column)
{
    if (row->mark[column] != i + 1) {
        row->mark[column] = (uint32_t)(i + 1);
        memset(row->sum[column], 0, sizeof row->sum[column]);
        row->column[row->count++] = column;
    }
    return row->sum[column];
}

/* Entry f, g of a symmetric block whose entries f <= g are stored row by row. */
static size_t packed_index(size_t functions, size_t f, size_t g)
{
    const size_t low = smaller_of(f, g), high = f + g - low;

    return low * functions - low * (low + 1) / 2 + high;
}

static size_t seam_fold(const struct gsn_fit_rows *rows, size_t seam)
{
    return rows->fold ? rows->fold[rows->seam_sample[seam]] & 1 : 0;
}

static double seam_weight(const struct gsn_fit_rows *rows, size_t seam)
{
    return rows->samples->weight ? rows->samples->weight[rows->seam_sample[seam]] : 1;
}

static void row_sum(const struct assembly *work, size_t i, struct row *row)
{
    const struct gsn_fit_rows *rows = work->rows;
    const size_t functions = work->functions;

    row->count = 0;
    for (size_t p = work->places.first[i]; p < work->places.first[i + 1]; p++) {
        const size_t place = work->places.at[p], tet = place / functions, f = place % functions;

        for (size_t g = 0; g < functions; g++) {
            const size_t at = tet * rows->packed + packed_index(functions, f, g);
            double *sum = row_at(row, i, work->control[tet * functions + g]);

            for (size_t fold = 0; fold < rows->folds; fold++)
                sum[fold] += rows->block[fold][at];
            sum[ROUGH] += rows->rough[at];
            if (rows->curvature)
                sum[JUMP] += rows->curvature[at];
        }
    }
    for (size_t p = work->terms.first[i]; p < work->terms.first[i + 1]; p++) {
        const size_t term = work->terms.at[p], seam = work->term_row[term];
        const size_t fold = seam_fold(rows, seam);
        const double value = seam_weight(rows, seam) * rows->seam_value[term];

        for (size_t q = rows->seam_first[seam]; q < rows->seam_first[seam + 1]; q++)
            row_at(row, i, rows->seam_control[q])[fold] += value * rows->seam_value[q];
    }
    for (size_t p = work->jumps ? work->sides.first[i] : 0;
         work->jumps && p < work->sides.first[i + 1]; p++) {
        const size_t term = work->sides.at[p], face = work->jump_row[term];
        const double value = work->jumps->value[term];

        for (size_t q = work->jumps->first[face]; q < work->jumps->first[face + 1]; q++)
            row_at(row, i, work->jumps->control[q])[JUMP] += value * work->jumps->value[q];
    }
}

static void sort_columns(uint32_t *column, size_t count)
{
    for (size_t i = 1; i < count; i++) {
        const uint32_t moving = column[i];
        size_t j = i;

        for (; j > 0 && column[j - 1] > moving; j--)
            column[j] = column[j - 1];
        column[j] = moving;
    }
}

/* Which of the parts there are: a second fold may not be, nor jumps. */
static bool uses_part(const struct gsn_fit_system *system, size_t k)
{
    return k < system->folds || k == ROUGH || (k == JUMP && system->jumps);
}

static bool part_room(struct part *part, const struct gsn_fit_system *system, size_t more)
{
    const size_t room = 2 * (part->count + more) + 4096;
    uint32_t *column;

    if (part->count + more <= part->room)
        return true;
    column = gsn_realloc_array(part->column, room, sizeof *column);
    if (!column)
        return false;
    part->column = column;
    for (size_t k = 0; k < PARTS; k++) {
        double *value =
            uses_part(system, k) ? gsn_realloc_array(part->value[k], room, sizeof *value) : NULL;

        if (uses_part(system, k) && !value)
            return false;
        part->value[k] = value;
    }
    part->room = room;
    return true;
}

static int assemble_rows(const struct assembly *work, size_t first, size_t end, struct row *row,
                         struct part *part, struct gsn_error *err)
{
    struct gsn_fit_system *system = work->system;

    for (size_t i = first; i < end; i++) {
        row_sum(work, i, row);
        if (!part_room(part, system, row->count))
            return out_of_memory(err);
        sort_columns(row->column, row->count);
        for (size_t n = 0; n < row->count; n++) {
            for (size_t k = 0; k < PARTS; k++)
                if (uses_part(system, k))
                    part->value[k][part->count] = row->sum[row->column[n]][k];
            part->column[part->count++] = row->column[n];
        }
        system->first[i + 1] = row->count; /* joined: becomes the end of row i */
    }
    return GSN_OK;
}

static int assemble_task(size_t task, void *context, struct gsn_error *err)
{
    const struct assembly *work = context;
    const size_t unknowns = work->system->unknowns, first = task * ROWS_A_TASK;
    double(*sum)[PARTS] __attribute__((cleanup(gsn_auto_release))) =
        gsn_alloc_array(unknowns, sizeof *sum);
    gsn_auto_mem(uint32_t) mark = gsn_alloc_array(unknowns, sizeof *mark);
    gsn_auto_mem(uint32_t) column = gsn_alloc_array(unknowns, sizeof *column);
    struct row row = { .sum = sum, .mark = mark, .column = column };

    if (!sum || !mark || !column)
        return out_of_memory(err);
    return assemble_rows(work, first, smaller_of(first + ROWS_A_TASK, unknowns), &row,
                         &work->part[task], err);
}

static void part_done(struct part *part)
{
    gsn_free(part->column);
    for (size_t k = 0; k < PARTS; k++)
        gsn_free(part->value[k]);
    *part = (struct part){ .column = NULL };
}

static int join_parts(struct gsn_fit_system *system, struct part *part, size_t parts,
                      struct gsn_error *err)
{
    double **const to[PARTS] = { &system->fold_value[0], &system->fold_value[1],
                                 &system->rough_value, &system->jump_value };
    size_t at = 0, total;

    for (size_t i = 0; i < system->unknowns; i++)
        system->first[i + 1] += system->first[i];
    total = system->first[system->unknowns];
    system->column = gsn_alloc_array(total, sizeof *system->column);
    system->value = gsn_alloc_array(total, sizeof *system->value);
    if (!system->column || !system->value)
        return out_of_memory(err);
    for (size_t k = 0; k < PARTS; k++) {
        *to[k] = uses_part(system, k) ? gsn_alloc_array(total, sizeof **to[k]) : NULL;
        if (uses_part(system, k) && !*to[k])
            return out_of_memory(err);
    }
    for (size_t p = 0; p < parts; p++) {
        if (part[p].count > 0)
            memcpy(system->column + at, part[p].column, part[p].count * sizeof *system->column);
        for (size_t k = 0; k < PARTS && part[p].count > 0; k++)
            if (*to[k])
                memcpy(*to[k] + at, part[p].value[k], part[p].count * sizeof **to[k]);
        at += part[p].count;
        part_done(&part[p]);
    }
    return GSN_OK;
}

static int list_sides(struct assembly *work, struct gsn_error *err)
{
    const struct gsn_face_jumps *jumps = work->jumps;
    const size_t terms = jumps->first[jumps->rows];

    work->jump_row = gsn_alloc_array(terms, sizeof *work->jump_row);
    if (!work->jump_row || !users_init(&work->sides, work->system->unknowns, jumps->control, terms))
        return out_of_memory(err);
    for (size_t row = 0; row < jumps->rows; row++)
        for (size_t i = jumps->first[row]; i < jumps->first[row + 1]; i++)
            work->jump_row[i] = (uint32_t)row;
    return GSN_OK;
}

static int assembly_init(struct assembly *work, struct gsn_error *err)
{
    const struct gsn_fit_rows *rows = work->rows;
    const size_t tets = gsn_dms_mesh(rows->space)->tet_count, unknowns = work->system->unknowns;
    const size_t terms = rows->seam_first[rows->seams];

    work->control = gsn_alloc_array(tets, work->functions * sizeof *work->control);
    work->term_row = gsn_alloc_array(terms, sizeof *work->term_row);
    work->part = gsn_alloc_array((unknowns + ROWS_A_TASK - 1) / ROWS_A_TASK, sizeof *work->part);
    if (!work->control || !work->term_row || !work->part)
        return out_of_memory(err);
    for (size_t t = 0; t < tets; t++)
        memcpy(work->control + t * work->functions, gsn_dms_control_ids(rows->space, t),
               work->functions * sizeof *work->control);
    for (size_t row = 0; row < rows->seams; row++)
        for (size_t i = rows->seam_first[row]; i < rows->seam_first[row + 1]; i++)
            work->term_row[i] = (uint32_t)row;
    if (!users_init(&work->places, unknowns, work->control, tets * work->functions) ||
        !users_init(&work->terms, unknowns, rows->seam_control, terms))
        return out_of_memory(err);
    return work->jumps ? list_sides(work, err) : GSN_OK;
}

int gsn_fit_system_assemble(struct gsn_fit_system *system, const struct gsn_fit_rows *rows,
                            const struct gsn_face_jumps *jumps, unsigned threads,
                            struct gsn_error *err)
{
    struct assembly work = {
        .rows = rows, .jumps = jumps, .system = system, .functions = gsn_dms_functions(rows->space)
    };
    size_t parts;
    int r;

    *system = (struct gsn_fit_system){ .unknowns = gsn_dms_controls(rows->space),
                                       .folds = rows->folds,
                                       .jumps = jumps != NULL };
    parts = (system->unknowns + ROWS_A_TASK - 1) / ROWS_A_TASK;
    system->first = gsn_alloc_array(system->unknowns + 1, sizeof *system->first);
    system->right = gsn_alloc_array(system->unknowns, sizeof *system->right);
    for (size_t k = 0; k < rows->folds; k++) {
        system->fold_right[k] = gsn_alloc_array(system->unknowns, sizeof *system->right);
        if (!system->fold_right[k])
            return out_of_memory(err);
    }
    if (!system->first || !system->right)
        return out_of_memory(err);
    r = assembly_init(&work, err);
    if (r >= 0)
        r = gsn_parallel_for(parts, threads, assemble_task, &work, err);
    if (r >= 0)
        r = join_parts(system, work.part, parts, err);
    if (r >= 0)
        gsn_fit_system_aim(system, rows);
    for (size_t p = 0; work.part && p < parts; p++)
        part_done(&work.part[p]);
    users_done(&work.places);
    users_done(&work.terms);
    users_done(&work.sides);
    gsn_free(work.jump_row);
    gsn_free(work.control);
    gsn_free(work.term_row);
    gsn_free(work.part);
    return r;
}

void gsn_fit_system_aim(struct gsn_fit_system *system, const struct gsn_fit_rows *rows)
{
    const size_t functions = gsn_dms_functions(rows->space);

    for (size_t k = 0; k < system->folds; k++)
        memset(system->fold_right[k], 0, system->unknowns * sizeof *system->fold_right[k]);
    for (size_t t = 0; t < gsn_dms_mesh(rows->space)->tet_count; t++) {
        const uint32_t *id = gsn_dms_control_ids(rows->space, t);

        for (size_t k = 0; k < system->folds; k++)
            for (size_t f = 0; f < functions; f++)
                system->fold_right[k][id[f]] += rows->right[k][t * functions + f];
    }
    for (size_t seam = 0; seam < rows->seams; seam++) {
        double *right = system->fold_right[seam_fold(rows, seam)];

        for (size_t i = rows->seam_first[seam]; i < rows->seam_first[seam + 1]; i++)
            right[rows->seam_control[i]] +=
                seam_weight(rows, seam) * rows->seam_value[i] * rows->seam_target[seam];
    }
}

void gsn_fit_system_done(struct gsn_fit_system *system)
{
    gsn_free(system->first);
    gsn_free(system->column);
    gsn_free(system->value);
    gsn_free(system->right);
    gsn_free(system->rough_value);
    gsn_free(system->jump_value);
    for (size_t k = 0; k < 2; k++) {
        gsn_free(system->fold_value[k]);
        gsn_free(system->fold_right[k]);
    }
    *system = (struct gsn_fit_system){ .unknowns = 0 };
}

/* ---- conjugate gradients ---- */

struct product {
    const struct gsn_fit_system *system;
    const double *value, *x;
    double *ret;
};

static int multiply_rows(size_t task, void *context, struct gsn_error *err)
{
    const struct product *work = context;
    const struct gsn_fit_system *system = work->system;
    const size_t end = smaller_of((task + 1) * ROWS_A_TASK, system->unknowns);

    (void)err;
    for (size_t i = task * ROWS_A_TASK; i < end; i++) {
        double sum = 0;

        for (size_t k = system->first[i]; k < system->first[i + 1]; k++)
            sum += work->value[k] * work->x[system->column[k]];
        work->ret[i] = sum;
    }
    return GSN_OK;
}

static void multiply_matrix(const struct gsn_fit_system *system, const double *value,
                            const double *x, double *ret, unsigned threads)
{
    struct product work = { system, value, x, ret };

    (void)gsn_parallel_for((system->unknowns + ROWS_A_TASK - 1) / ROWS_A_TASK, threads,
                           multiply_rows, &work, NULL);
}

static double dot_product(const double *a, const double *b, size_t count)
{
    double sum = 0;

    for (size_t i = 0; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

void gsn_fit_system_combine(struct gsn_fit_system *system, const double fold[2], double rough,
                            double jump)
{
    const size_t total = system->first[system->unknowns];

    for (size_t k = 0; k < total; k++) {
        system->value[k] = rough * system->rough_value[k];
        for (size_t f = 0; f < system->folds; f++)
            system->value[k] += fold[f] * system->fold_value[f][k];
    }
    for (size_t k = 0; system->jumps && k < total; k++)
        system->value[k] += jump * system->jump_value[k];
    for (size_t i = 0; i < system->unknowns; i++) {
        system->right[i] = 0;
        for (size_t f = 0; f < system->folds; f++)
            system->right[i] += fold[f] * system->fold_right[f][i];
    }
}

double gsn_fit_system_squares(const struct gsn_fit_system *system, size_t fold, double squares,
                              const double *x, double *scratch)
{
    multiply_matrix(system, system->fold_value[fold], x, scratch, 1);
    for (size_t i = 0; i < system->unknowns; i++)
        scratch[i] -= 2 * system->fold_right[fold][i];
    return fmax(0, squares + dot_product(x, scratch, system->unknowns));
}

int gsn_fit_system_solve(const struct gsn_fit_system *system, const struct gsn_fit_patches *patches,
                         double tolerance, unsigned iterations, unsigned threads, double *x,
                         unsigned *ret_iterations, struct gsn_error *err)
{
    const size_t n = system->unknowns;
    gsn_auto_mem(double) rest = gsn_alloc_array(n, sizeof *rest);
    gsn_auto_mem(double) near = gsn_alloc_array(n, sizeof *near);
    gsn_auto_mem(double) way = gsn_alloc_array(n, sizeof *way);
    gsn_auto_mem(double) image = gsn_alloc_array(n, sizeof *image);
    double whole, now;

    if (!rest || !near || !way || !image)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while solving for %zu unknowns", n);
    gsn_fit_patches_apply(patches, system->right, near, threads);
    whole = dot_product(near, system->right, n);
    multiply_matrix(system, system->value, x, image, threads);
    for (size_t i = 0; i < n; i++)
        rest[i] = system->right[i] - image[i];
    gsn_fit_patches_apply(patches, rest, way, threads);
    now = dot_product(way, rest, n);
    for (unsigned iteration = 0; iteration <= iterations; iteration++) {
        double curvature, before = now;

        if (sqrt(now) <= tolerance * sqrt(whole)) {
            *ret_iterations = iteration;
            return GSN_OK;
        }
        multiply_matrix(system, system->value, way, image, threads);
        curvature = dot_product(way, image, n);
        if (!(curvature > 0))
            return gsn_fail(err, GSN_E_FIT,
                            "the normal equations are not positive definite: iteration %u meets a "
                            "direction of curvature %.3g",
                            iteration + 1, curvature);
        for (size_t i = 0; i < n; i++) {
            x[i] += before / curvature * way[i];
            rest[i] -= before / curvature * image[i];
        }
        gsn_fit_patches_apply(patches, rest, near, threads);
        now = dot_product(near, rest, n);
        for (size_t i = 0; i < n; i++)
            way[i] = near[i] + now / before * way[i];
    }
    return gsn_fail(err, GSN_E_FIT, "%u iterations leave %.3g of the residual, %.3g were allowed",
                    iterations, sqrt(now / whole), tolerance);
}
