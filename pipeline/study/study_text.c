/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A study for programs: long-format CSV and study.json.
 *
 * CSV as RFC 4180 has it: names in the first line, a row an animal, region and measure, texts in
 * quotes. Figures have nine significant digits, which is what R, pandas and Prism read without loss
 * of anything measured; what does not exist is an empty field, which they read as NA. A specimen
 * that takes no part has a row a measure without a value, and why. Fails only when memory runs
 * out. */
#include "pipeline/study/study.h"

#include "pipeline/report/json.h"
#include "pipeline/report/text.h"

#include <math.h>
#include <string.h>

/* ---- CSV ----------------------------------------------------------------------------------- */

static void put_figure(struct gsn_report_text *text, double value)
{
    if (isfinite(value))
        gsn_report_text_print(text, "%.9g", value == 0 ? 0 : value);
}

static void put_who(struct gsn_report_text *text, const struct gsn_study *study, const char *animal,
                    const char *group, double week, int is_control, size_t measure)
{
    const struct gsn_study_measure *const m = &study->input.measure[measure];

    gsn_report_text_field(text, study->input.name);
    gsn_report_text_raw(text, ",");
    gsn_report_text_field(text, animal);
    gsn_report_text_raw(text, ",");
    gsn_report_text_field(text, group);
    gsn_report_text_raw(text, ",");
    put_figure(text, week);
    gsn_report_text_print(text, ",%s,",
                          study->input.blind ? "blind"
                          : is_control       ? "control"
                                             : "treated");
    gsn_report_text_field(text, study->input.region);
    gsn_report_text_raw(text, ",");
    gsn_report_text_field(text, m->name);
    gsn_report_text_raw(text, ",");
    gsn_report_text_field(text, m->unit);
    gsn_report_text_raw(text, ",");
}

static void put_animal(struct gsn_report_text *text, const struct gsn_study *study,
                       const struct gsn_study_animal *animal, size_t measure)
{
    const struct gsn_study_cell *const cell = &study->cell[animal->cell];

    put_who(text, study, animal->name, cell->group, cell->week, cell->is_control, measure);
    put_figure(text, animal->value[measure]);
    gsn_report_text_raw(text, ",");
    put_figure(text, animal->error[measure]);
    gsn_report_text_print(text, ",%zu,yes,,", animal->specimens);
    gsn_report_text_field(text, study->input.measure[measure].definition);
    gsn_report_text_raw(text, "\r\n");
}

static void put_left_out(struct gsn_report_text *text, const struct gsn_study *study,
                         const struct gsn_study_specimen *s, size_t measure)
{
    put_who(text, study, s->animal, s->group, s->week, s->control == NULL, measure);
    gsn_report_text_raw(text, ",,1,no,");
    gsn_report_text_field(text, s->left_out);
    gsn_report_text_raw(text, ",");
    gsn_report_text_field(text, study->input.measure[measure].definition);
    gsn_report_text_raw(text, "\r\n");
}

/* The rows of one region. */
static void put_rows(struct gsn_report_text *text, const struct gsn_study *study)
{
    for (size_t i = 0; i < study->animal_count; i++)
        for (size_t m = 0; m < study->input.measure_count; m++)
            put_animal(text, study, &study->animal[i], m);
    for (size_t i = 0; i < study->input.specimen_count; i++)
        for (size_t m = 0; study->input.specimen[i].left_out && m < study->input.measure_count; m++)
            put_left_out(text, study, &study->input.specimen[i], m);
}

int gsn_study_csv(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                  struct gsn_error *err)
{
    gsn_auto_report_text text = { .bytes = NULL };

    gsn_report_text_raw(&text,
                        "study,animal,group,week,role,region,measure,unit,value,standard_error,"
                        "specimens,included,reason,definition\r\n");
    put_rows(&text, study);
    for (size_t k = 0; k < study->part_count; k++)
        put_rows(&text, study->part[k]);
    if (text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the study's table");
    gsn_report_text_give(&text, ret_bytes, ret_size);
    return GSN_OK;
}

/* ---- JSON ---------------------------------------------------------------------------------- */

struct pair {
    const char *key;
    double value;
};

static void put_pairs(struct gsn_json_writer *w, json_t *object, const struct pair *pair,
                      size_t count)
{
    for (size_t i = 0; i < count; i++)
        gsn_json_put(w, object, pair[i].key, gsn_json_figure(pair[i].value));
}

static json_t *make_mean(struct gsn_json_writer *w, const struct gsn_group_mean *m)
{
    const struct pair pair[] = {
        { "mean", m->mean }, { "sd", m->sd }, { "lower", m->lower }, { "upper", m->upper }
    };
    json_t *object = json_object();

    gsn_json_put(w, object, "n", gsn_json_count(m->n));
    put_pairs(w, object, pair, sizeof pair / sizeof pair[0]);
    return object;
}

static json_t *make_measures(struct gsn_json_writer *w, const struct gsn_study *study)
{
    json_t *array = json_array();

    for (size_t m = 0; m < study->input.measure_count; m++) {
        json_t *object = json_object();

        gsn_json_put(w, object, "name", gsn_json_text(study->input.measure[m].name));
        gsn_json_put(w, object, "unit", gsn_json_text(study->input.measure[m].unit));
        gsn_json_put(w, object, "definition", gsn_json_text(study->input.measure[m].definition));
        gsn_json_append(w, array, object);
    }
    return array;
}

static json_t *make_groups(struct gsn_json_writer *w, const struct gsn_study *study)
{
    json_t *array = json_array();

    for (size_t c = 0; c < study->cell_count; c++) {
        const struct gsn_study_cell *const cell = &study->cell[c];
        json_t *object = json_object(), *means = json_object();

        gsn_json_put(w, object, "group", gsn_json_text(cell->group));
        gsn_json_put(w, object, "week", gsn_json_figure(cell->week));
        gsn_json_put(w, object, "control", json_boolean(cell->is_control));
        for (size_t m = 0; m < study->input.measure_count; m++) {
            json_t *mean = make_mean(w, &cell->mean[m]);

            gsn_json_put(w, mean, "error_of_measurement", gsn_json_figure(cell->error[m]));
            gsn_json_put(w, means, study->input.measure[m].name, mean);
        }
        gsn_json_put(w, object, "measures", means);
        gsn_json_append(w, array, object);
    }
    return array;
}

static json_t *make_animals(struct gsn_json_writer *w, const struct gsn_study *study)
{
    json_t *array = json_array();

    for (size_t i = 0; i < study->animal_count; i++) {
        const struct gsn_study_animal *const animal = &study->animal[i];
        const struct gsn_study_cell *const cell = &study->cell[animal->cell];
        json_t *object = json_object(), *values = json_object();

        gsn_json_put(w, object, "animal", gsn_json_text(animal->name));
        gsn_json_put(w, object, "group", gsn_json_text(cell->group));
        gsn_json_put(w, object, "week", gsn_json_figure(cell->week));
        gsn_json_put(w, object, "specimens", gsn_json_count(animal->specimens));
        for (size_t m = 0; m < study->input.measure_count; m++) {
            const struct pair pair[] = { { "value", animal->value[m] },
                                         { "standard_error", animal->error[m] } };
            json_t *value = json_object();

            put_pairs(w, value, pair, 2);
            gsn_json_put(w, values, study->input.measure[m].name, value);
        }
        gsn_json_put(w, object, "measures", values);
        gsn_json_append(w, array, object);
    }
    return array;
}

static json_t *make_budget(struct gsn_json_writer *w, const struct gsn_study_budget *b)
{
    const struct gsn_study_share *const t = &b->treated, *const c = &b->control;
    const struct pair pair[] = { { "total", b->total },
                                 { "animals", t->animals },
                                 { "animals_control", c->animals },
                                 { "dye_vectors", t->vectors },
                                 { "dye_vectors_control", c->vectors },
                                 { "sections", t->sections },
                                 { "sections_control", c->sections },
                                 { "measurement", t->measurement },
                                 { "measurement_control", c->measurement } };
    json_t *object = json_object();

    put_pairs(w, object, pair, sizeof pair / sizeof pair[0]);
    return object;
}

static json_t *make_comparison(struct gsn_json_writer *w, const struct gsn_study *study,
                               const struct gsn_study_comparison *c)
{
    const struct gsn_study_cell *const a = &study->cell[c->a], *const b = &study->cell[c->b];
    const struct pair figures[] = { { "loss_percent", c->loss.percent },
                                    { "loss_lower", c->loss.lower },
                                    { "loss_upper", c->loss.upper },
                                    { "difference", c->difference.difference },
                                    { "difference_lower", c->difference.lower },
                                    { "difference_upper", c->difference.upper },
                                    { "t", c->difference.t },
                                    { "freedom", c->difference.freedom },
                                    { "p", c->difference.p },
                                    { "p_holm", c->p_holm },
                                    { "p_permutation", c->p_exact },
                                    { "p_permutation_least", c->p_least },
                                    { "hedges_g", c->difference.g },
                                    { "hedges_g_lower", c->difference.g_lower },
                                    { "hedges_g_upper", c->difference.g_upper } };
    char allows[256];
    json_t *object = json_object();

    gsn_study_allows(c, allows, sizeof allows);
    gsn_json_put(w, object, "kind",
                 json_string(c->kind == GSN_STUDY_LOSS ? "against control" : "between groups"));
    gsn_json_put(w, object, "measure", gsn_json_text(study->input.measure[c->measure].name));
    gsn_json_put(w, object, "group", gsn_json_text(a->group));
    gsn_json_put(w, object, "week", gsn_json_figure(a->week));
    gsn_json_put(w, object, "against", gsn_json_text(b->group));
    gsn_json_put(w, object, "against_week", c->pooled ? json_null() : gsn_json_figure(b->week));
    gsn_json_put(w, object, "against_all_weeks", json_boolean(c->pooled));
    gsn_json_put(w, object, "values", make_mean(w, &c->mean_a));
    gsn_json_put(w, object, "values_against", make_mean(w, &c->mean_b));
    put_pairs(w, object, figures, sizeof figures / sizeof figures[0]);
    gsn_json_put(w, object, "variance_of_loss", make_budget(w, &c->budget));
    gsn_json_put(w, object, "remark", gsn_json_text_or_null(allows));
    return object;
}

static json_t *make_specimens(struct gsn_json_writer *w, const struct gsn_study *study)
{
    json_t *array = json_array();

    for (size_t i = 0; i < study->input.specimen_count; i++) {
        const struct gsn_study_specimen *const s = &study->input.specimen[i];
        const struct pair figures[] = { { "week", s->week },
                                        { "loss_percent", s->loss },
                                        { "loss_lower", s->loss_lower },
                                        { "loss_upper", s->loss_upper } };
        json_t *object = json_object();

        gsn_json_put(w, object, "specimen", gsn_json_text(s->name));
        gsn_json_put(w, object, "animal", gsn_json_text(s->animal));
        gsn_json_put(w, object, "group", gsn_json_text(s->group));
        put_pairs(w, object, figures, sizeof figures / sizeof figures[0]);
        gsn_json_put(w, object, "left_out", gsn_json_text_or_null(s->left_out));
        gsn_json_put(w, object, "run_key", gsn_json_text_or_null(s->key));
        gsn_json_put(w, object, "report", gsn_json_text_or_null(s->page));
        gsn_json_append(w, array, object);
    }
    return array;
}

static json_t *make_comparisons(struct gsn_json_writer *w, const struct gsn_study *study)
{
    json_t *array = json_array();

    for (size_t i = 0; i < study->comparison_count; i++)
        gsn_json_append(w, array, make_comparison(w, study, &study->comparison[i]));
    return array;
}

static json_t *make_maps(struct gsn_json_writer *w, const struct gsn_study *study)
{
    json_t *array = json_array();

    for (size_t i = 0; i < study->map_count; i++) {
        const struct gsn_study_loss_map *const map = &study->map[i];
        const struct gsn_study_comparison *const c = &study->comparison[map->comparison];
        const struct pair figures[] = { { "low_percent", map->low },
                                        { "median_percent", map->median },
                                        { "high_percent", map->high },
                                        { "lost_share", map->lost },
                                        { "gained_share", map->gained } };
        json_t *object = json_object();

        gsn_json_put(w, object, "group", gsn_json_text(study->cell[c->a].group));
        gsn_json_put(w, object, "week", gsn_json_figure(study->cell[c->a].week));
        gsn_json_put(w, object, "against", gsn_json_text(study->cell[c->b].group));
        gsn_json_put(w, object, "edge_um", gsn_json_figure(GSN_BASE_EDGE_UM));
        gsn_json_put(w, object, "cells", gsn_json_count(map->count));
        put_pairs(w, object, figures, sizeof figures / sizeof figures[0]);
        gsn_json_append(w, array, object);
    }
    return array;
}

static json_t *make_parts(struct gsn_json_writer *w, const struct gsn_study *study)
{
    json_t *array = json_array();

    for (size_t k = 0; k < study->part_count; k++) {
        const struct gsn_study *const part = study->part[k];
        json_t *object = json_object();

        gsn_json_put(w, object, "region", gsn_json_text(part->input.region));
        gsn_json_put(w, object, "groups", make_groups(w, part));
        gsn_json_put(w, object, "comparisons", make_comparisons(w, part));
        gsn_json_put(w, object, "animals", make_animals(w, part));
        gsn_json_put(w, object, "specimens", make_specimens(w, part));
        gsn_json_append(w, array, object);
    }
    return array;
}

static int add_piece(const char *bytes, size_t size, void *context)
{
    struct gsn_report_text *const text = context;

    gsn_report_text_bytes(text, bytes, size);
    return text->failed ? -1 : 0;
}

int gsn_study_json(const struct gsn_study *study, char **ret_bytes, size_t *ret_size,
                   struct gsn_error *err)
{
    struct gsn_json_writer w = { 0 };
    gsn_auto_report_text text = { .bytes = NULL };
    json_t *root = json_object();

    gsn_json_put(&w, root, "schema", json_string("gieson-study-1"));
    gsn_json_put(&w, root, "study", gsn_json_text(study->input.name));
    gsn_json_put(&w, root, "version", gsn_json_text(study->input.version));
    gsn_json_put(&w, root, "region", gsn_json_text(study->input.region));
    gsn_json_put(&w, root, "blind", json_boolean(study->input.blind));
    gsn_json_put(&w, root, "frozen", gsn_json_text_or_null(study->input.frozen));
    gsn_json_put(&w, root, "animals_in_several_groups", gsn_json_count(study->shared_animals));
    gsn_json_put(&w, root, "measures", make_measures(&w, study));
    gsn_json_put(&w, root, "groups", make_groups(&w, study));
    gsn_json_put(&w, root, "comparisons", make_comparisons(&w, study));
    gsn_json_put(&w, root, "loss_maps", make_maps(&w, study));
    gsn_json_put(&w, root, "animals", make_animals(&w, study));
    gsn_json_put(&w, root, "specimens", make_specimens(&w, study));
    if (study->part_count > 0)
        gsn_json_put(&w, root, "regions", make_parts(&w, study));
    if (!w.failed &&
        json_dump_callback(root, add_piece, &text, JSON_INDENT(2) | JSON_REAL_PRECISION(9)) < 0)
        w.failed = 1;
    json_decref(root);
    gsn_report_text_raw(&text, "\n");
    if (w.failed || text.failed)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the study's JSON");
    gsn_report_text_give(&text, ret_bytes, ret_size);
    return GSN_OK;
}
