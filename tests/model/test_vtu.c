/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The files themselves; test_vtu.py asks VTK what it reads in those that are left behind. */
#include "pipeline/model/vtu.h"

#include "pipeline/core/file.h"

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
    char *path = gsn_format("%s/%s.txt", GSN_VTU_DIR, name);
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

static void leave(const struct gsn_spline *spline, const char *name)
{
    char *path = gsn_format("%s/%s.vtu", GSN_VTU_DIR, name);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_vtu_write(spline, path, &err), err);
    leave_probes(spline, name);
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

/* The array behind the XML that starts this many bytes after the underscore. */
static const uint8_t *array_at(const uint8_t *bytes, size_t size, const char *name,
                               uint64_t *ret_size)
{
    char *needle = gsn_format("Name=\"%s\"", name);
    const char *tag = strstr((const char *)bytes, needle), *place = tag;
    const uint8_t *start = memmem(bytes, size, "raw\">\n_", 7);
    size_t offset = 0;

    CHECK(tag && start);
    place = strstr(tag, "offset=\"");
    CHECK(place && sscanf(place, "offset=\"%zu\"", &offset) == 1);
    start += 7 + offset;
    memcpy(ret_size, start, sizeof *ret_size);
    CHECK((size_t)(start - bytes) + sizeof *ret_size + *ret_size <= size);
    gsn_free(needle);
    return start + sizeof *ret_size;
}

static double double_at(const uint8_t *array, size_t item)
{
    double value;

    memcpy(&value, array + item * sizeof value, sizeof value);
    return value;
}

/* What needs no VTK to be seen: a corner's Bernstein coefficient is the value there. */
TEST(corners_lie_at_the_vertices_with_the_values_there)
{
    gsn_auto(gsn_dms) space = kuhn_space(CELLS, 0.2, 3, 0.05, GSN_DMS_SHARED);
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    uint64_t seed = 3, points_size, values_size;
    const struct polynomial p = draw_polynomial(3, &seed);
    gsn_auto_mem(double) control = polynomial_controls(&p, space);
    gsn_auto(gsn_spline) spline = spline_with(space, control);
    gsn_auto_mem(uint8_t) bytes = NULL;
    const uint8_t *points, *values;
    struct gsn_error err = { 0 };
    size_t size = 0;

    CHECK_OK(gsn_vtu_write(spline, GSN_VTU_DIR "/corners.vtu", &err), err);
    CHECK_OK(gsn_file_read(GSN_VTU_DIR "/corners.vtu", 1 << 20, &bytes, &size, &err), err);
    points = array_at(bytes, size, "Points", &points_size);
    values = array_at(bytes, size, "s", &values_size);
    CHECK(values_size == mesh->tet_count * 20 * sizeof(double));
    CHECK(points_size == 3 * values_size);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (size_t k = 0; k < 4; k++) {
            const double *vertex = mesh->vertex[mesh->tet[t][k]];

            for (size_t c = 0; c < 3; c++)
                CHECK_NEAR(double_at(points, 3 * (20 * t + k) + c), vertex[c], 1e-15);
            CHECK_NEAR(double_at(values, 20 * t + k), polynomial_at(&p, vertex, NULL), 1e-10);
        }
    }
}

TEST(a_path_that_cannot_be_written_is_refused_by_name)
{
    gsn_auto(gsn_dms) space = collapsed_space(1, GSN_DMS_SHARED);
    gsn_auto(gsn_spline) spline = random_spline(space);
    struct gsn_error err = { 0 };

    CHECK(gsn_vtu_write(spline, GSN_VTU_DIR "/no/such/folder/s.vtu", &err) == GSN_E_IO);
    CHECK(strstr(err.text, "/no/such/folder/s.vtu"));
    CHECK(gsn_vtu_write(spline, GSN_VTU_DIR, &err) == GSN_E_IO);
}

TEST(running_out_of_memory_leaves_the_old_file)
{
    gsn_auto(gsn_dms) space = collapsed_space(1, GSN_DMS_SHARED);
    gsn_auto(gsn_spline) spline = random_spline(space);
    struct gsn_error err = { 0 };
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;

    CHECK_OK(gsn_file_write(GSN_VTU_DIR "/old.vtu", "old", 3, &err), err);
    gsn_check_fail_allocation(1);
    CHECK(gsn_vtu_write(spline, GSN_VTU_DIR "/old.vtu", &err) == GSN_E_NOMEM);
    gsn_check_fail_allocation(0);
    CHECK_OK(gsn_file_read(GSN_VTU_DIR "/old.vtu", 100, &bytes, &size, &err), err);
    CHECK(size == 3 && memcmp(bytes, "old", 3) == 0);
    CHECK_EVERY_OOM(gsn_vtu_write(spline, GSN_VTU_DIR "/old.vtu", &err), err);
}
