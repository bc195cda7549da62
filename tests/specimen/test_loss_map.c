/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The map of the loss, from panels to the page. */
#include "pipeline/specimen/process.h"

#include "pipeline/core/mem.h"
#include "pipeline/model/model_file.h"
#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"

#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define TREATED_JOB                                                                                \
    "{\"specimen\": \"treated\", \"baseline\": \"control\", " DRAWN_JOB_HEAD                       \
    ", \"region\": " DRAWN_REGION "}"

static const struct gsn_specimen_options OPTIONS = { .mesher = GSN_MESHER, .threads = 1 };

static struct gsn_specimen_result *worked(const struct drawn_specimen *d)
{
    struct gsn_specimen_result *result = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_specimen_process(&d->specimen, &OPTIONS, &result, &err), err);
    return result;
}

static const struct gsn_specimen_file *file_of(const struct gsn_specimen_result *result,
                                               const char *name)
{
    for (size_t i = 0; i < result->file_count; i++)
        if (strcmp(result->file[i].name, name) == 0)
            return &result->file[i];
    fail_msg("the run kept no %s", name);
    return NULL;
}

/* 0 where the result has none, as a store hands it on. */
static double known(const struct gsn_specimen_result *result, const char *name)
{
    const double value = gsn_specimen_result_measure(result, name, NULL);

    return value > 0 ? value : 0;
}

static double measure(const struct gsn_specimen_result *result, const char *name)
{
    return gsn_specimen_result_measure(result, name, NULL);
}

/* What a store hands on of a control. */
static void hand_on(const struct gsn_specimen_result *control, const struct gsn_model *model,
                    struct gsn_specimen_control *ret_control,
                    struct gsn_specimen_baseline *ret_baseline)
{
    *ret_control = control->colours;
    ret_control->plane_error = measure(control, "plane_error");
    ret_control->model = model;
    *ret_baseline = (struct gsn_specimen_baseline){
        .name = "control",
        .specimens = 1,
        .control = ret_control,
        .mean_density = measure(control, "mean_density"),
        .mean_density_error = known(control, "mean_density_error"),
        .section_error = known(control, "section_error"),
        .volume_mm3 = measure(control, "region_volume"),
        .definition = control->definition,
        .dyes = control->dyes,
    };
}

/* The number in this column of a row; NaN: the cell is empty. */
static double column(const char *row, int which)
{
    while (which-- > 0)
        row = strchr(row, ',') + 1;
    return *row == ',' || *row == '\r' ? (double)NAN : strtod(row, NULL); /* door */
}

enum { VOLUME = 7, DENSITY, DENSITY_ERROR, BASELINE, BASELINE_ERROR, LOSS, LOSS_ERROR };

static const char *first_row(const char *csv)
{
    CHECK(strncmp(csv, "cube_x,cube_y,cube_z,tet,x_um,y_um,z_um,volume_um3,density,", 58) == 0);
    return strstr(csv, "\r\n") + 2;
}

static char *text_of(const struct gsn_specimen_file *file)
{
    return gsn_format("%.*s", (int)file->size, (const char *)file->bytes);
}

/* Cell by cell, and together that of the region. */
TEST(each_cell_of_two_drawn_specimens_lost_what_their_densities_say)
{
    drawn_auto control, treated;
    struct gsn_specimen_control handed;
    gsn_auto(gsn_model) model = NULL;
    struct gsn_error err = { 0 };
    double weight = 0, lost = 0;
    size_t cells = 0;

    drawn_specimen_even(&control, DRAWN_JOB, 0.8);
    drawn_specimen_even(&treated, TREATED_JOB, 0.6);
    gsn_auto(gsn_specimen_result) base = worked(&control);
    const struct gsn_specimen_file *kept = file_of(base, "model.vtkhdf");

    CHECK_OK(gsn_model_file_read(kept->bytes, kept->size, &model, &err), err);
    hand_on(base, model, &handed, &treated.specimen.baseline);
    gsn_auto(gsn_specimen_result) result = worked(&treated);
    gsn_auto_mem(char) csv = text_of(file_of(result, "base-cells.csv"));

    for (const char *row = first_row(csv); *row; row = strstr(row, "\r\n") + 2, cells++) {
        const double w = column(row, VOLUME) * column(row, BASELINE);

        CHECK_NEAR(column(row, LOSS), 25, 2);
        CHECK(column(row, LOSS_ERROR) > 0);
        CHECK_NEAR(column(row, LOSS), 100 * (1 - column(row, DENSITY) / column(row, BASELINE)),
                   1e-9);
        weight += w;
        lost += w * column(row, LOSS);
    }
    CHECK(cells > 20);
    CHECK_NEAR(lost / weight, measure(result, "loss"), 0.02);
    CHECK(strstr(result->html, "id=\"lost\"") && strstr(result->html, "Loss across z"));
    json_t *root = json_loadb(result->json, result->json_size, 0, NULL);
    const json_t *map = json_object_get(root, "loss_map");

    CHECK((size_t)json_integer_value(json_object_get(map, "cells")) == cells);
    CHECK_NEAR(json_number_value(json_object_get(map, "shared")), 1, 1e-9);
    CHECK_NEAR(json_number_value(json_object_get(map, "median_percent")), 25, 1.5);
    CHECK(json_array_size(json_object_get(map, "pictures")) == 2);
    CHECK(json_is_null(json_object_get(root, "loss_map_reason")));
    json_decref(root);
}

TEST(a_control_has_its_cells_and_no_loss)
{
    drawn_auto control;

    drawn_specimen_even(&control, DRAWN_JOB, 0.8);
    gsn_auto(gsn_specimen_result) base = worked(&control);
    gsn_auto_mem(char) csv = text_of(file_of(base, "base-cells.csv"));

    for (const char *row = first_row(csv); *row; row = strstr(row, "\r\n") + 2) {
        CHECK_NEAR(column(row, DENSITY), 0.8, 0.06);
        CHECK(column(row, DENSITY_ERROR) > 0);
        CHECK(!(column(row, LOSS) >= 0) && !(column(row, LOSS) < 0));
    }
    CHECK(strstr(base->json, "\"loss_map\": null") || strstr(base->json, "\"loss_map\":null"));
    CHECK(!strstr(base->html, "id=\"lost\""));
}

TEST(a_control_whose_model_is_not_at_hand_costs_the_map_and_the_page_says_so)
{
    drawn_auto control, treated;
    struct gsn_specimen_control handed;

    drawn_specimen_even(&control, DRAWN_JOB, 0.8);
    drawn_specimen_even(&treated, TREATED_JOB, 0.6);
    gsn_auto(gsn_specimen_result) base = worked(&control);

    hand_on(base, NULL, &handed, &treated.specimen.baseline);
    handed.model_lacks = "the model of control is not at hand: it was by gieson 0.0.9";
    gsn_auto(gsn_specimen_result) result = worked(&treated);

    CHECK_NEAR(measure(result, "loss"), 25, 0.5);
    CHECK(strstr(result->html, "There is no map of the loss: the model of control is not at hand"));
    CHECK(strstr(result->json, "it was by gieson 0.0.9"));
    CHECK(file_of(result, "base-cells.csv")->size > 0);
}
