/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A model comes back from its file to the last bit, or is refused; test_model_file.py asks VTK what
 * it reads in those that are left behind. */
#include "pipeline/model/model_file.h"

#include "pipeline/core/file.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "tests/check.h"
#include "tests/model/kuhn.h"

enum { PROBES = 400 };

static const size_t CELLS[3] = { 2, 2, 2 };

static double plain_weight(uint64_t *seed)
{
    return 2 * draw(seed) - 1;
}

/* All knots of a vertex at the vertex, control points at random. */
static struct gsn_dms *collapsed_space(unsigned degree, enum gsn_dms_sharing sharing)
{
    struct gsn_tets *mesh = kuhn_mesh(CELLS, 0.2);
    double(*knots)[3] = gsn_alloc_array(mesh->vertex_count * (degree + 1), sizeof *knots);
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < mesh->vertex_count * (degree + 1); i++)
        memcpy(knots[i], mesh->vertex[i / (degree + 1)], sizeof *knots);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knots, sharing, &space, &err), err);
    gsn_free(knots);
    gsn_tets_free(mesh);
    return space;
}

static struct gsn_spline *spline_with(const struct gsn_dms *space, const double *control)
{
    struct gsn_spline *spline = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_spline_new(space, control, &spline, &err), err);
    return spline;
}

static struct gsn_spline *random_spline(const struct gsn_dms *space)
{
    double *control = gsn_alloc_array(gsn_dms_controls(space), sizeof *control);
    struct gsn_spline *spline;
    uint64_t seed = 11;

    for (size_t i = 0; i < gsn_dms_controls(space); i++)
        control[i] = plain_weight(&seed);
    spline = spline_with(space, control);
    gsn_free(control);
    return spline;
}

/* Points of every tetrahedron and s there, as the spline itself says: "tet x y z s" a line. */
static void leave_probes(const struct gsn_spline *spline, const char *name)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(gsn_spline_space(spline));
    char *path = gsn_format("%s/%s.txt", GSN_MODEL_DIR, name);
    FILE *file = fopen(path, "w");
    uint64_t seed = 5;

    CHECK(file);
    for (size_t i = 0; i < PROBES; i++) {
        size_t tet = i % mesh->tet_count, hint = tet;
        double u[3], value = NAN;

        draw_inside(mesh, tet, &seed, u);
        CHECK(gsn_spline_eval(spline, u, &hint, &value, NULL) == GSN_OK);
        CHECK(fprintf(file, "%zu %.17g %.17g %.17g %.17g\n", hint, u[0], u[1], u[2], value) > 0);
    }
    CHECK(fclose(file) == 0);
    gsn_free(path);
}

static const struct gsn_model_notes NOTES = { .name = "GVP-D-S02",
                                              .parameters = "{\"tolerance\": 0.03}",
                                              .version = "0.1.0" };

/* Something of each cell, other numbers in each; to be freed like a model's. */
static struct gsn_model_cells draw_cells(size_t tets)
{
    struct gsn_model_cells cells = { .density = gsn_alloc_array(tets, sizeof(double)),
                                     .inside_share = gsn_alloc_array(tets, sizeof(double)),
                                     .residual = gsn_alloc_array(tets, sizeof(double)),
                                     .samples = gsn_alloc_array(tets, sizeof(uint32_t)) };
    uint64_t seed = 23;

    for (size_t t = 0; t < tets; t++) {
        cells.density[t] = t % 7 == 0 ? (double)NAN : draw(&seed);
        cells.inside_share[t] = draw(&seed);
        cells.residual[t] = draw(&seed);
        cells.samples[t] = (uint32_t)(t * 37 % 11);
    }
    return cells;
}

static void cells_done(struct gsn_model_cells *cells)
{
    gsn_free(cells->density);
    gsn_free(cells->inside_share);
    gsn_free(cells->residual);
    gsn_free(cells->samples);
}

static void leave(const struct gsn_spline *spline, const char *name)
{
    struct gsn_model_cells cells = draw_cells(gsn_dms_mesh(gsn_spline_space(spline))->tet_count);
    char *path = gsn_format("%s/%s.vtkhdf", GSN_MODEL_DIR, name);
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_model_file_write(spline, NULL, &cells, NULL, &NOTES, &bytes, &size, &err), err);
    CHECK_OK(gsn_file_write(path, bytes, size, &err), err);
    leave_probes(spline, name);
    cells_done(&cells);
    gsn_free(path);
}

TEST(collapsed_clouds_are_written_for_vtk)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        for (int own = 0; own < 2; own++) {
            gsn_auto(gsn_dms) space = collapsed_space(degree, own ? GSN_DMS_OWN : GSN_DMS_SHARED);
            gsn_auto(gsn_spline) spline = random_spline(space);
            gsn_auto_mem(char) name =
                gsn_format("collapsed_%s_n%u", own ? "own" : "shared", degree);

            leave(spline, name);
        }
    }
}

/* With open clouds p_I is the spline wherever that is a polynomial, here everywhere. */
TEST(polynomials_on_open_clouds_are_written_for_vtk)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        gsn_auto(gsn_dms) space = kuhn_space(CELLS, 0.2, degree, 0.05, GSN_DMS_SHARED);
        uint64_t seed = 17;
        const struct polynomial p = draw_polynomial(degree, &seed);
        gsn_auto_mem(double) control = polynomial_controls(&p, space);
        gsn_auto(gsn_spline) spline = spline_with(space, control);
        gsn_auto_mem(char) name = gsn_format("polynomial_n%u", degree);

        leave(spline, name);
    }
}

static uint8_t inside[] = { 1, 0, 0, 1, 1, 0, 1, 1, 0, 0, 1, 0 };
static const struct gsn_mask REGION = {
    .at = { .nx = 2, .ny = 3, .nz = 2, .origin_um = { -0.3, 0.1, 7 }, .step_um = { 1, 0.7, 24 } },
    .inside = inside,
};

/* A model of degree 3 with open clouds, as bytes. */
static void write_model(struct gsn_dms **ret_space, struct gsn_spline **ret_spline,
                        struct gsn_model_cells *ret_cells, uint8_t **ret_bytes, size_t *ret_size)
{
    struct gsn_error err = { 0 };

    *ret_space = kuhn_space(CELLS, 0.2, 3, 0.05, GSN_DMS_SHARED);
    *ret_spline = random_spline(*ret_space);
    *ret_cells = draw_cells(gsn_dms_mesh(*ret_space)->tet_count);
    CHECK_OK(gsn_model_file_write(*ret_spline, NULL, ret_cells, &REGION, &NOTES, ret_bytes,
                                  ret_size, &err),
             err);
}

#define CHECK_SAME(a, b, count) CHECK(memcmp((a), (b), (count) * sizeof *(a)) == 0)

TEST(a_model_comes_back_to_the_last_bit)
{
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto(gsn_model) model = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_model_cells cells;
    struct gsn_error err = { 0 };
    const struct gsn_tets *mesh, *back;
    size_t size = 0;

    write_model(&space, &spline, &cells, &bytes, &size);
    CHECK_OK(gsn_model_file_read(bytes, size, &model, &err), err);
    mesh = gsn_dms_mesh(space);
    back = gsn_dms_mesh(model->space);
    CHECK(back->vertex_count == mesh->vertex_count && back->tet_count == mesh->tet_count);
    CHECK_SAME(mesh->vertex, back->vertex, mesh->vertex_count);
    CHECK_SAME(mesh->tet, back->tet, mesh->tet_count);
    CHECK(gsn_dms_degree(model->space) == 3);
    CHECK(gsn_dms_sharing(model->space) == GSN_DMS_SHARED);
    CHECK_SAME(gsn_dms_knots(space), gsn_dms_knots(model->space), 4 * mesh->vertex_count);
    CHECK_SAME(gsn_spline_controls(spline), gsn_spline_controls(model->spline),
               gsn_dms_controls(space));
    CHECK_SAME(cells.density, model->cells.density, mesh->tet_count);
    CHECK_SAME(cells.inside_share, model->cells.inside_share, mesh->tet_count);
    CHECK_SAME(cells.residual, model->cells.residual, mesh->tet_count);
    CHECK_SAME(cells.samples, model->cells.samples, mesh->tet_count);
    CHECK(model->region);
    CHECK_SAME(&REGION.at, &model->region->at, 1);
    CHECK_SAME(inside, model->region->inside, sizeof inside);
    CHECK(strcmp(model->name, NOTES.name) == 0);
    CHECK(strcmp(model->parameters, NOTES.parameters) == 0);
    CHECK(strcmp(model->version, NOTES.version) == 0);
    CHECK(gsn_model_colours(model) == NULL);
    cells_done(&cells);
}

TEST(colours_come_back_to_the_last_bit_and_belong_to_the_checksum)
{
    gsn_auto(gsn_dms) space = kuhn_space(CELLS, 0.2, 2, 0.05, GSN_DMS_SHARED);
    gsn_auto(gsn_spline) spline = random_spline(space);
    const size_t controls = gsn_dms_controls(space);
    struct gsn_spline *colour[3] = { NULL };
    gsn_auto(gsn_model) model = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_model *changed = NULL;
    struct gsn_error err = { 0 };
    const uint8_t *found;
    size_t size = 0;

    for (int c = 0; c < 3; c++) {
        gsn_auto_mem(double) control =
            gsn_memdup(gsn_spline_controls(spline), controls * sizeof *control);

        CHECK(control);
        for (size_t i = 0; i < controls; i++)
            control[i] = sin((double)(3 * i) + c);
        CHECK_OK(gsn_spline_new(space, control, &colour[c], &err), err);
    }
    CHECK_OK(gsn_model_file_write(spline, (const struct gsn_spline *const *)colour,
                                  &(struct gsn_model_cells){ .density = NULL }, &REGION, &NOTES,
                                  &bytes, &size, &err),
             err);
    CHECK_OK(gsn_model_file_read(bytes, size, &model, &err), err);
    CHECK(gsn_model_colours(model) != NULL);
    for (int c = 0; c < 3; c++)
        CHECK_SAME(gsn_spline_controls(colour[c]), gsn_spline_controls(model->colour[c]), controls);
    found = memmem(bytes, size, gsn_spline_controls(colour[2]), 8 * sizeof(double));
    CHECK(found);
    bytes[found - bytes] ^= 1;
    CHECK(gsn_model_file_read(bytes, size, &changed, &err) == GSN_E_INPUT);
    CHECK(!changed && strstr(err.text, "was changed since"));
    for (int c = 0; c < 3; c++)
        gsn_spline_free(colour[c]);
}

TEST(the_same_model_is_the_same_bytes)
{
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto_mem(uint8_t) first = NULL;
    gsn_auto_mem(uint8_t) second = NULL;
    struct gsn_model_cells cells;
    struct gsn_error err = { 0 };
    size_t first_size = 0, second_size = 0;

    write_model(&space, &spline, &cells, &first, &first_size);
    CHECK_OK(
        gsn_model_file_write(spline, NULL, &cells, &REGION, &NOTES, &second, &second_size, &err),
        err);
    CHECK(first_size == second_size && memcmp(first, second, first_size) == 0);
    cells_done(&cells);
}

TEST(what_is_not_known_of_cells_is_not_in_the_file)
{
    gsn_auto(gsn_dms) space = kuhn_space(CELLS, 0.2, 2, 0.05, GSN_DMS_OWN);
    gsn_auto(gsn_spline) spline = random_spline(space);
    gsn_auto(gsn_model) model = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_model_file_write(spline, NULL, &(struct gsn_model_cells){ .density = NULL }, NULL,
                                  &NOTES, &bytes, &size, &err),
             err);
    CHECK_OK(gsn_model_file_read(bytes, size, &model, &err), err);
    CHECK(!model->cells.density && !model->cells.samples && !model->region);
    CHECK(gsn_dms_sharing(model->space) == GSN_DMS_OWN);
}

/* Each byte of a control value, a knot and a vertex: found where they lie in the file. */
TEST(a_changed_number_is_refused)
{
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_model_cells cells;
    struct gsn_error err = { 0 };
    size_t size = 0;
    uint8_t *found[5];

    write_model(&space, &spline, &cells, &bytes, &size);
    found[0] = memmem(bytes, size, &gsn_spline_controls(spline)[5], sizeof(double));
    found[1] = memmem(bytes, size, &cells.residual[3], sizeof(double));
    found[2] = memmem(bytes, size, NOTES.parameters, strlen(NOTES.parameters));
    found[3] = memmem(bytes, size, inside, sizeof inside);
    found[4] = memmem(bytes, size, &REGION.at.step_um, sizeof REGION.at.step_um);
    for (size_t i = 0; i < 5; i++) {
        struct gsn_model *model = NULL;

        CHECK(found[i]);
        found[i][3] ^= 1;
        CHECK(gsn_model_file_read(bytes, size, &model, &err) == GSN_E_INPUT);
        CHECK(!model && strstr(err.text, "was changed since it was kept"));
        found[i][3] ^= 1;
    }
    cells_done(&cells);
}

/* What a full disk or a broken copy leaves. */
TEST(a_file_cut_anywhere_is_refused)
{
    gsn_auto(gsn_dms) space = NULL;
    gsn_auto(gsn_spline) spline = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_model_cells cells;
    struct gsn_error err = { 0 };
    size_t size = 0;

    write_model(&space, &spline, &cells, &bytes, &size);
    for (size_t at = 1; at < size; at += 997) {
        struct gsn_model *model = NULL;

        CHECK(gsn_model_file_read(bytes, at, &model, &err) == GSN_E_INPUT && !model);
    }
    cells_done(&cells);
}

TEST(what_is_no_model_is_refused)
{
    static const uint8_t text[] = "This is a report, and no model.";
    struct gsn_model *model = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_model_file_read(text, sizeof text, &model, &err) == GSN_E_INPUT);
    CHECK(gsn_model_file_read(text, 0, &model, &err) == GSN_E_INPUT);
    CHECK(!model && strstr(err.text, "no model"));
}

static int write_and_read(const struct gsn_spline *spline, struct gsn_error *err)
{
    gsn_auto(gsn_model) model = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    const struct gsn_spline *const colour[3] = { spline, spline, spline };
    size_t size = 0;
    int r = gsn_model_file_write(spline, colour, &(struct gsn_model_cells){ .density = NULL },
                                 &REGION, &NOTES, &bytes, &size, err);

    return r < 0 ? r : gsn_model_file_read(bytes, size, &model, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    gsn_auto(gsn_dms) space = collapsed_space(1, GSN_DMS_SHARED);
    gsn_auto(gsn_spline) spline = random_spline(space);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(write_and_read(spline, &err), err);
}
