/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From specimens to the answer of a study.
 *
 * Method. 1. Specimens that take part are sorted by group (controls first), time point, animal and
 * name, so that their order does not matter. 2. Those of one animal in one group at one time point
 * become their mean. 3. Animals of a group at a time point are a cell, with mean, spread and
 * interval. 4. Each cell of a treated group is compared with its control at the same time point, or
 * with the control of all time points where there is none; treated groups are compared with each
 * other at each time point. 5. Welch's p is corrected by Holm over all comparisons of one kind and
 * measure, those of further regions among them. 6. The variance of a loss is split into what
 * animals differ by and what measuring them adds: the spread seen between animals holds both, so
 * the animals' own is what is left, or none.
 *
 * Failure: groups without animals, animals without spread and measures that nobody has leave NaN.
 * Cost: sorting, and the exact permutations (inference.h). */
#include "pipeline/study/study.h"

#include "pipeline/study/loss_maps.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void gsn_study_free(struct gsn_study *study)
{
    if (!study)
        return;
    gsn_free(study->animal);
    gsn_free(study->cell);
    gsn_free(study->comparison);
    for (size_t i = 0; i < study->part_count; i++)
        gsn_study_free(study->part[i]);
    gsn_free(study->part);
    for (size_t i = 0; i < study->map_count; i++)
        gsn_free(study->map[i].cell);
    gsn_free(study->map);
    gsn_free(study);
}

/* ---- order --------------------------------------------------------------------------------- */

/* Time points that are not stated come first and are one. */
static int compare_weeks(double a, double b)
{
    if (isnan(a) || isnan(b))
        return isnan(b) - isnan(a);
    return (a > b) - (a < b);
}

static int compare_specimens(const void *left, const void *right)
{
    const struct gsn_study_specimen *a = *(const struct gsn_study_specimen *const *)left;
    const struct gsn_study_specimen *b = *(const struct gsn_study_specimen *const *)right;
    int order = (a->control != NULL) - (b->control != NULL);

    if (order == 0)
        order = strcmp(a->group, b->group);
    if (order == 0)
        order = compare_weeks(a->week, b->week);
    if (order == 0)
        order = strcmp(a->animal, b->animal);
    return order ? order : strcmp(a->name, b->name);
}

static int is_same_cell(const struct gsn_study_cell *cell, const struct gsn_study_specimen *s)
{
    return strcmp(cell->group, s->group) == 0 && compare_weeks(cell->week, s->week) == 0 &&
           cell->is_control == (s->control == NULL);
}

/* ---- specimens to animals ------------------------------------------------------------------ */

/* Sums, until finish_animal() divides. */
static void add_to_animal(struct gsn_study_animal *animal, const struct gsn_study_specimen *s,
                          size_t measures)
{
    for (size_t m = 0; m < measures; m++) {
        animal->value[m] += s->value[m];
        animal->error[m] += s->error[m] * s->error[m];
    }
    animal->vector_error += s->vector_error * s->vector_error;
    animal->section_error += s->section_error * s->section_error;
    animal->specimens++;
}

static void finish_animal(struct gsn_study_animal *animal, size_t measures)
{
    const double n = (double)animal->specimens;

    for (size_t m = 0; m < measures; m++) {
        animal->value[m] /= n;
        animal->error[m] = sqrt(animal->error[m]) / n;
    }
    animal->vector_error = sqrt(animal->vector_error) / n;
    animal->section_error = sqrt(animal->section_error) / n;
}

/* sorted: count specimens that take part. */
static void gather_animals(struct gsn_study *study, const struct gsn_study_specimen *const *sorted,
                           size_t count)
{
    for (size_t i = 0; i < count; i++) {
        const struct gsn_study_specimen *const s = sorted[i];
        struct gsn_study_cell *cell =
            study->cell_count ? &study->cell[study->cell_count - 1] : NULL;
        struct gsn_study_animal *animal;

        if (!cell || !is_same_cell(cell, s)) {
            cell = &study->cell[study->cell_count++];
            *cell = (struct gsn_study_cell){ .group = s->group,
                                             .week = s->week,
                                             .is_control = s->control == NULL,
                                             .first = study->animal_count };
        }
        animal = cell->count ? &study->animal[study->animal_count - 1] : NULL;
        if (!animal || strcmp(animal->name, s->animal) != 0) {
            animal = &study->animal[study->animal_count++];
            *animal = (struct gsn_study_animal){ .name = s->animal, .cell = study->cell_count - 1 };
            cell->count++;
        }
        add_to_animal(animal, s, study->input.measure_count);
    }
    for (size_t i = 0; i < study->animal_count; i++)
        finish_animal(&study->animal[i], study->input.measure_count);
}

static size_t count_shared_animals(const struct gsn_study *study)
{
    size_t shared = 0;

    for (size_t i = 0; i < study->animal_count; i++)
        for (size_t k = 0; k < i; k++)
            if (strcmp(study->animal[i].name, study->animal[k].name) == 0 &&
                strcmp(study->cell[study->animal[i].cell].group,
                       study->cell[study->animal[k].cell].group) != 0) {
                shared++;
                break;
            }
    return shared;
}

/* ---- animals to groups --------------------------------------------------------------------- */

/* The values of a cell's animals that have one; returns how many. */
static size_t collect_values(const struct gsn_study *study, const struct gsn_study_cell *cell,
                             size_t measure, double *value)
{
    size_t n = 0;

    for (size_t i = cell->first; i < cell->first + cell->count; i++)
        if (isfinite(study->animal[i].value[measure]))
            value[n++] = study->animal[i].value[measure];
    return n;
}

/* Root mean square; NaN as soon as one is not known. */
static double combine_errors(const struct gsn_study *study, const struct gsn_study_cell *cell,
                             size_t measure)
{
    double sum = 0;
    size_t n = 0;

    for (size_t i = cell->first; i < cell->first + cell->count; i++)
        if (isfinite(study->animal[i].value[measure])) {
            sum += study->animal[i].error[measure] * study->animal[i].error[measure];
            n++;
        }
    return n ? sqrt(sum / (double)n) : NAN;
}

/* What is not known of an animal counts as none. */
static void combine_parts(const struct gsn_study *study, struct gsn_study_cell *cell)
{
    double vectors = 0, sections = 0;

    for (size_t i = cell->first; i < cell->first + cell->count; i++) {
        const struct gsn_study_animal *const animal = &study->animal[i];

        if (isfinite(animal->vector_error))
            vectors += animal->vector_error * animal->vector_error;
        if (isfinite(animal->section_error))
            sections += animal->section_error * animal->section_error;
    }
    cell->vector_error = sqrt(vectors / (double)cell->count);
    cell->section_error = sqrt(sections / (double)cell->count);
}

static void finish_cells(struct gsn_study *study, double *value)
{
    for (size_t c = 0; c < study->cell_count; c++) {
        struct gsn_study_cell *const cell = &study->cell[c];

        for (size_t m = 0; m < study->input.measure_count; m++) {
            cell->mean[m] = gsn_group_mean_of(value, collect_values(study, cell, m, value));
            cell->error[m] = combine_errors(study, cell, m);
        }
        combine_parts(study, cell);
    }
}

/* ---- comparisons --------------------------------------------------------------------------- */

/* Of one side: slope is d loss / d mean. Of the first measure its error is split as well. */
static struct gsn_study_share split_side(const struct gsn_group_mean *mean,
                                         const struct gsn_study_cell *cell, size_t measure,
                                         double slope)
{
    const double unit = slope * slope / (double)mean->n;
    const double seen = mean->sd * mean->sd * unit;
    const double error = cell->error[measure] * cell->error[measure] * unit;
    const double used = fmin(error, seen);
    const double scale = error > 0 ? used / error : 1;
    struct gsn_study_share share = { .animals = seen, NAN, NAN, NAN };

    if (!isfinite(error))
        return share;
    share.animals = seen - used;
    share.vectors = share.sections = 0;
    if (measure == 0) {
        share.vectors = fmin(cell->vector_error * cell->vector_error * unit, error) * scale;
        share.sections =
            fmin(cell->section_error * cell->section_error * unit * scale, used - share.vectors);
    }
    share.measurement = used - share.vectors - share.sections;
    return share;
}

static struct gsn_study_budget split_variance(const struct gsn_study_comparison *c,
                                              const struct gsn_study_cell *a,
                                              const struct gsn_study_cell *b)
{
    /* d loss / d mean_a and d mean_b, in per cent */
    const double slope_a = 100 / c->mean_b.mean;
    const double slope_b = 100 * c->mean_a.mean / (c->mean_b.mean * c->mean_b.mean);

    return (struct gsn_study_budget){
        .total = c->mean_a.sd * c->mean_a.sd / (double)c->mean_a.n * slope_a * slope_a +
                 c->mean_b.sd * c->mean_b.sd / (double)c->mean_b.n * slope_b * slope_b,
        .treated = split_side(&c->mean_a, a, c->measure, slope_a),
        .control = split_side(&c->mean_b, b, c->measure, slope_b)
    };
}

/* Room for the values of two sides. */
struct sides {
    double *a, *b;
    size_t n_a, n_b;
};

static int compare_sides(struct gsn_study *study, struct gsn_study_comparison *c,
                         const struct sides *sides, struct gsn_error *err)
{
    int r = GSN_OK;

    c->mean_a = gsn_group_mean_of(sides->a, sides->n_a);
    c->mean_b = gsn_group_mean_of(sides->b, sides->n_b);
    c->difference = gsn_group_compare(&c->mean_a, &c->mean_b);
    c->loss = (struct gsn_group_loss){ NAN, NAN, NAN };
    c->budget = (struct gsn_study_budget){ NAN, { NAN, NAN, NAN, NAN }, { NAN, NAN, NAN, NAN } };
    c->p_exact = c->p_holm = NAN;
    c->p_least = gsn_permutation_least_p(sides->n_a, sides->n_b);
    if (c->kind == GSN_STUDY_LOSS) {
        c->loss = gsn_group_loss_of(&c->mean_a, &c->mean_b);
        if (sides->n_a > 1 && sides->n_b > 1)
            c->budget = split_variance(c, &study->cell[c->a], &study->cell[c->b]);
    }
    if (sides->n_a > 0 && sides->n_b > 0)
        r = gsn_permutation_p(sides->a, sides->n_a, sides->b, sides->n_b, &c->p_exact, err);
    return r == GSN_E_LIMIT ? GSN_OK : r;
}

/* The control group of a treated cell: its specimens' own, which must be one. */
static int find_control(const struct gsn_study *study, const struct gsn_study_cell *cell,
                        const char **ret_group, struct gsn_error *err)
{
    const char *group = NULL;

    for (size_t i = 0; i < study->input.specimen_count; i++) {
        const struct gsn_study_specimen *const s = &study->input.specimen[i];

        if (s->left_out || !s->control || strcmp(s->group, cell->group) != 0)
            continue;
        if (group && strcmp(group, s->control) != 0)
            return gsn_fail(err, GSN_E_WITHHELD,
                            "specimens of group %s are measured against several controls, %s and "
                            "%s: state one `baseline` in their job.json",
                            cell->group, group, s->control);
        group = s->control;
    }
    *ret_group = group;
    return GSN_OK;
}

/* The cells of a control group: those at this week, else all of them. Returns how many values; the
 * first cell taken is *ret_cell. */
static size_t collect_control(const struct gsn_study *study, const char *group, double week,
                              size_t measure, double *value, size_t *ret_cell, int *ret_pooled)
{
    size_t n = 0;

    for (int pooled = 0; pooled < 2 && n == 0; pooled++)
        for (size_t c = 0; c < study->cell_count; c++) {
            const struct gsn_study_cell *const cell = &study->cell[c];

            if (!cell->is_control || strcmp(cell->group, group) != 0 ||
                (!pooled && compare_weeks(cell->week, week) != 0))
                continue;
            if (n == 0)
                *ret_cell = c;
            n += collect_values(study, cell, measure, value + n);
            *ret_pooled = pooled;
        }
    return n;
}

static int add_losses(struct gsn_study *study, struct sides *sides, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t m = 0; m < study->input.measure_count; m++)
        for (size_t c = 0; r >= 0 && c < study->cell_count; c++) {
            struct gsn_study_comparison *const to = &study->comparison[study->comparison_count];
            const char *control = NULL;

            if (study->cell[c].is_control)
                continue;
            r = find_control(study, &study->cell[c], &control, err);
            if (r < 0 || !control)
                continue;
            *to = (struct gsn_study_comparison){ .kind = GSN_STUDY_LOSS, .measure = m, .a = c };
            sides->n_a = collect_values(study, &study->cell[c], m, sides->a);
            sides->n_b = collect_control(study, control, study->cell[c].week, m, sides->b, &to->b,
                                         &to->pooled);
            if (sides->n_a == 0 || sides->n_b == 0)
                continue;
            r = compare_sides(study, to, sides, err);
            study->comparison_count++;
        }
    return r;
}

/* Whether two cells are compared as treatments: at one time point, no control among them; where
 * nobody is known to be treated, all with all. */
static int are_treatments(const struct gsn_study *study, size_t a, size_t b)
{
    const struct gsn_study_cell *const x = &study->cell[a], *const y = &study->cell[b];
    /* Controls come first. */
    const int nobody_is_treated = study->cell[study->cell_count - 1].is_control;

    return compare_weeks(x->week, y->week) == 0 && x->is_control == y->is_control &&
           (!x->is_control || nobody_is_treated);
}

static int add_treatments(struct gsn_study *study, struct sides *sides, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t m = 0; m < study->input.measure_count; m++)
        for (size_t a = 0; a < study->cell_count; a++)
            for (size_t b = a + 1; r >= 0 && b < study->cell_count; b++) {
                struct gsn_study_comparison *const to = &study->comparison[study->comparison_count];

                if (!are_treatments(study, a, b))
                    continue;
                *to = (struct gsn_study_comparison){
                    .kind = GSN_STUDY_TREATMENT, .measure = m, .a = a, .b = b
                };
                sides->n_a = collect_values(study, &study->cell[a], m, sides->a);
                sides->n_b = collect_values(study, &study->cell[b], m, sides->b);
                if (sides->n_a == 0 || sides->n_b == 0)
                    continue;
                r = compare_sides(study, to, sides, err);
                study->comparison_count++;
            }
    return r;
}

/* The comparisons of one kind and measure, of this region and of its parts: their p into the list
 * (back: out of it again). Returns how many. */
static size_t pass_p(struct gsn_study *study, enum gsn_study_kind kind, size_t measure, int back,
                     double *p)
{
    size_t n = 0;

    for (size_t i = 0; i < study->comparison_count; i++) {
        struct gsn_study_comparison *const c = &study->comparison[i];

        if (c->kind != kind || c->measure != measure)
            continue;
        if (back)
            c->p_holm = p[n++];
        else
            p[n++] = c->difference.p;
    }
    for (size_t k = 0; k < study->part_count; k++)
        n += pass_p(study->part[k], kind, measure, back, p + n);
    return n;
}

static int correct_p(struct gsn_study *study, struct gsn_error *err)
{
    size_t most = study->comparison_count + 1;
    gsn_auto_mem(double) p = NULL;

    for (size_t k = 0; k < study->part_count; k++)
        most += study->part[k]->comparison_count;
    p = gsn_alloc_array(most, sizeof *p);
    if (!p)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");
    for (size_t m = 0; m < study->input.measure_count; m++)
        for (int kind = GSN_STUDY_LOSS; kind <= GSN_STUDY_TREATMENT; kind++) {
            gsn_holm(p, pass_p(study, (enum gsn_study_kind)kind, m, 0, p));
            (void)pass_p(study, (enum gsn_study_kind)kind, m, 1, p);
        }
    return GSN_OK;
}

static int analyse_parts(struct gsn_study *study, struct gsn_error *err)
{
    const struct gsn_study_input *const input = &study->input;
    int r = GSN_OK;

    study->part = gsn_alloc_array(input->part_count + 1, sizeof *study->part);
    if (!study->part)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");
    for (size_t k = 0; r >= 0 && k < input->part_count; k++) {
        r = gsn_study_analyse(&input->part[k], &study->part[k], err);
        study->part_count += r >= 0;
    }
    return r;
}

static int compare_groups(struct gsn_study *study, struct gsn_error *err)
{
    const size_t most = study->input.measure_count * study->cell_count * (study->cell_count + 1);
    gsn_auto_mem(double) a = gsn_alloc_array(study->animal_count + most + 1, sizeof *a);
    gsn_auto_mem(double) b = gsn_alloc_array(study->animal_count + 1, sizeof *b);
    struct sides sides = { a, b, 0, 0 };
    int r;

    study->comparison = gsn_alloc_array(most + 1, sizeof *study->comparison);
    if (!a || !b || !study->comparison)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");
    finish_cells(study, a);
    r = add_losses(study, &sides, err);
    if (r >= 0)
        r = add_treatments(study, &sides, err);
    return r;
}

int gsn_study_analyse(const struct gsn_study_input *input, struct gsn_study **ret_study,
                      struct gsn_error *err)
{
    gsn_auto_mem(const struct gsn_study_specimen *) sorted =
        gsn_alloc_array(input->specimen_count + 1, sizeof *sorted);
    gsn_auto(gsn_study) study = gsn_alloc_array(1, sizeof *study);
    size_t count = 0;
    int r;

    if (input->measure_count == 0 || input->measure_count > GSN_STUDY_MEASURES)
        return gsn_fail(err, GSN_E_INPUT, "a study has 1 to %d measures", (int)GSN_STUDY_MEASURES);
    if (!sorted || !study)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");
    study->input = *input;
    for (size_t i = 0; i < input->specimen_count; i++)
        if (!input->specimen[i].left_out)
            sorted[count++] = &input->specimen[i];
    qsort(sorted, count, sizeof *sorted, compare_specimens);
    study->animal = gsn_alloc_array(count + 1, sizeof *study->animal);
    study->cell = gsn_alloc_array(count + 1, sizeof *study->cell);
    if (!study->animal || !study->cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a study");
    gather_animals(study, sorted, count);
    study->shared_animals = count_shared_animals(study);
    r = compare_groups(study, err);
    if (r >= 0)
        r = analyse_parts(study, err);
    if (r >= 0)
        r = correct_p(study, err);
    if (r >= 0)
        r = gsn_study_map_losses(study, err);
    if (r >= 0)
        *ret_study = gsn_steal(&study);
    return r;
}

/* ---- what so few allow --------------------------------------------------------------------- */

static const char *say_animals(size_t n)
{
    return n == 1 ? "animal" : "animals";
}

void gsn_study_allows(const struct gsn_study_comparison *c, char *text, size_t room)
{
    const size_t a = c->mean_a.n, b = c->mean_b.n, few = a < b ? a : b;

    if (room == 0)
        return;
    text[0] = '\0';
    if (few == 1)
        (void)snprintf(text, room,
                       "%zu %s against %zu: a single animal has no spread, so there is no interval "
                       "and no p; two more a group would give the first",
                       a, say_animals(a), b);
    else if (c->p_least > 0.05)
        (void)snprintf(
            text, room,
            "with %zu against %zu animals no permutation or rank test can reach 0.05: the "
            "smallest p it can give is %.2g",
            a, b, c->p_least);
    else if (few < 4)
        (void)snprintf(text, room,
                       "%zu against %zu animals: the interval rests on a spread that so few hardly "
                       "show",
                       a, b);
}
