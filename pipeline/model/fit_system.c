/* SPDX-License-Identifier: AGPL-3.0-or-later */
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

/* The matrix rows of one task, before they are joined. */
struct part {
    size_t count, room;
    uint32_t *column;
    double *value;
};

struct assembly {
    const struct gsn_fit_rows *rows;
    struct gsn_fit_system *system;
    size_t functions;
    uint32_t *control;   /* of tet * functions + function */
    uint32_t *term_row;  /* the seam row that a term belongs to */
    struct users places; /* in control */
    struct users terms;  /* in rows->seam_control */
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
    double *sum;
    uint32_t *mark; /* 1 + the row that used the column last */
    uint32_t *column;
    size_t count;
    double right;
};

static void row_add(struct row *row, size_t i, uint32_t column, double value)
{
    if (row->mark[column] != i + 1) {
        row->mark[column] = (uint32_t)(i + 1);
        row->sum[column] = 0;
        row->column[row->count++] = column;
    }
    row->sum[column] += value;
}

/* Entry f, g of a symmetric block whose entries f <= g are stored row by row. */
static size_t packed_index(size_t functions, size_t f, size_t g)
{
    const size_t low = smaller_of(f, g), high = f + g - low;

    return low * functions - low * (low + 1) / 2 + high;
}

static void row_sum(const struct assembly *work, size_t i, struct row *row)
{
    const struct gsn_fit_rows *rows = work->rows;
    const size_t functions = work->functions;

    row->count = 0;
    row->right = 0;
    for (size_t p = work->places.first[i]; p < work->places.first[i + 1]; p++) {
        const size_t place = work->places.at[p], tet = place / functions, f = place % functions;
        const double *block = rows->block + tet * rows->packed;

        for (size_t g = 0; g < functions; g++)
            row_add(row, i, work->control[tet * functions + g],
                    block[packed_index(functions, f, g)]);
        row->right += rows->right[place];
    }
    for (size_t p = work->terms.first[i]; p < work->terms.first[i + 1]; p++) {
        const size_t term = work->terms.at[p], seam = work->term_row[term];
        const double value = rows->seam_value[term];

        for (size_t q = rows->seam_first[seam]; q < rows->seam_first[seam + 1]; q++)
            row_add(row, i, rows->seam_control[q], value * rows->seam_value[q]);
        row->right += value * rows->seam_target[seam];
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

static bool part_room(struct part *part, size_t more)
{
    const size_t room = 2 * (part->count + more) + 4096;
    uint32_t *column;
    double *value;

    if (part->count + more <= part->room)
        return true;
    column = gsn_realloc_array(part->column, room, sizeof *column);
    if (column)
        part->column = column;
    value = gsn_realloc_array(part->value, room, sizeof *value);
    if (value)
        part->value = value;
    if (!column || !value)
        return false;
    part->room = room;
    return true;
}

static int assemble_rows(const struct assembly *work, size_t first, size_t end, struct row *row,
                         struct part *part, struct gsn_error *err)
{
    for (size_t i = first; i < end; i++) {
        row_sum(work, i, row);
        if (!part_room(part, row->count))
            return out_of_memory(err);
        sort_columns(row->column, row->count);
        for (size_t k = 0; k < row->count; k++) {
            part->column[part->count] = row->column[k];
            part->value[part->count++] = row->sum[row->column[k]];
        }
        work->system->first[i + 1] = row->count; /* joined: becomes the end of row i */
        work->system->right[i] = row->right;
    }
    return GSN_OK;
}

static int assemble_task(size_t task, void *context, struct gsn_error *err)
{
    const struct assembly *work = context;
    const size_t unknowns = work->system->unknowns, first = task * ROWS_A_TASK;
    gsn_auto_mem(double) sum = gsn_alloc_array(unknowns, sizeof *sum);
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
    gsn_free(part->value);
    *part = (struct part){ .column = NULL };
}

static int join_parts(struct gsn_fit_system *system, struct part *part, size_t parts,
                      struct gsn_error *err)
{
    size_t at = 0;

    for (size_t i = 0; i < system->unknowns; i++)
        system->first[i + 1] += system->first[i];
    system->column = gsn_alloc_array(system->first[system->unknowns], sizeof *system->column);
    system->value = gsn_alloc_array(system->first[system->unknowns], sizeof *system->value);
    if (!system->column || !system->value)
        return out_of_memory(err);
    for (size_t p = 0; p < parts; p++) {
        if (part[p].count > 0) {
            memcpy(system->column + at, part[p].column, part[p].count * sizeof *system->column);
            memcpy(system->value + at, part[p].value, part[p].count * sizeof *system->value);
        }
        at += part[p].count;
        part_done(&part[p]);
    }
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
    return GSN_OK;
}

int gsn_fit_system_assemble(struct gsn_fit_system *system, const struct gsn_fit_rows *rows,
                            unsigned threads, struct gsn_error *err)
{
    struct assembly work = { .rows = rows,
                             .system = system,
                             .functions = gsn_dms_functions(rows->space) };
    size_t parts;
    int r;

    *system = (struct gsn_fit_system){ .unknowns = gsn_dms_controls(rows->space) };
    parts = (system->unknowns + ROWS_A_TASK - 1) / ROWS_A_TASK;
    system->first = gsn_alloc_array(system->unknowns + 1, sizeof *system->first);
    system->right = gsn_alloc_array(system->unknowns, sizeof *system->right);
    if (!system->first || !system->right)
        return out_of_memory(err);
    r = assembly_init(&work, err);
    if (r >= 0)
        r = gsn_parallel_for(parts, threads, assemble_task, &work, err);
    if (r >= 0)
        r = join_parts(system, work.part, parts, err);
    for (size_t p = 0; work.part && p < parts; p++)
        part_done(&work.part[p]);
    users_done(&work.places);
    users_done(&work.terms);
    gsn_free(work.control);
    gsn_free(work.term_row);
    gsn_free(work.part);
    return r;
}

void gsn_fit_system_done(struct gsn_fit_system *system)
{
    gsn_free(system->first);
    gsn_free(system->column);
    gsn_free(system->value);
    gsn_free(system->right);
    *system = (struct gsn_fit_system){ .unknowns = 0 };
}

/* ---- conjugate gradients ---- */

static void multiply_matrix(const struct gsn_fit_system *system, const double *x, double *ret)
{
    for (size_t i = 0; i < system->unknowns; i++) {
        double sum = 0;

        for (size_t k = system->first[i]; k < system->first[i + 1]; k++)
            sum += system->value[k] * x[system->column[k]];
        ret[i] = sum;
    }
}

static double dot_product(const double *a, const double *b, size_t count)
{
    double sum = 0;

    for (size_t i = 0; i < count; i++)
        sum += a[i] * b[i];
    return sum;
}

/* 1 / diagonal; refuses one that is not positive. */
static int invert_diagonal(const struct gsn_fit_system *system, double *ret, struct gsn_error *err)
{
    for (size_t i = 0; i < system->unknowns; i++) {
        ret[i] = 0;
        for (size_t k = system->first[i]; k < system->first[i + 1]; k++)
            if (system->column[k] == i)
                ret[i] = system->value[k];
        if (!(ret[i] > 0) || !isfinite(1 / ret[i]))
            return gsn_fail(err, GSN_E_FIT, "control point %zu is not determined by anything", i);
        ret[i] = 1 / ret[i];
    }
    return GSN_OK;
}

int gsn_fit_system_solve(const struct gsn_fit_system *system, double tolerance, unsigned iterations,
                         double *x, unsigned *ret_iterations, struct gsn_error *err)
{
    const size_t n = system->unknowns;
    gsn_auto_mem(double) scale = gsn_alloc_array(n, sizeof *scale);
    gsn_auto_mem(double) rest = gsn_memdup(system->right, n * sizeof *rest);
    gsn_auto_mem(double) way = gsn_alloc_array(n, sizeof *way);
    gsn_auto_mem(double) image = gsn_alloc_array(n, sizeof *image);
    double first = 0, now = 0;
    int r;

    if (!scale || !rest || !way || !image)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while solving for %zu unknowns", n);
    r = invert_diagonal(system, scale, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < n; i++) {
        x[i] = 0;
        way[i] = scale[i] * rest[i];
        first += way[i] * rest[i];
    }
    now = first;
    for (unsigned iteration = 0; iteration <= iterations; iteration++) {
        double curvature, before = now;

        if (sqrt(now) <= tolerance * sqrt(first)) {
            *ret_iterations = iteration;
            return GSN_OK;
        }
        multiply_matrix(system, way, image);
        curvature = dot_product(way, image, n);
        if (!(curvature > 0))
            return gsn_fail(err, GSN_E_FIT, "the normal equations are not positive");
        now = 0;
        for (size_t i = 0; i < n; i++) {
            x[i] += before / curvature * way[i];
            rest[i] -= before / curvature * image[i];
            now += scale[i] * rest[i] * rest[i];
        }
        for (size_t i = 0; i < n; i++)
            way[i] = scale[i] * rest[i] + now / before * way[i];
    }
    return gsn_fail(err, GSN_E_FIT, "%u iterations leave %.3g of the residual, %.3g were allowed",
                    iterations, sqrt(now / first), tolerance);
}
