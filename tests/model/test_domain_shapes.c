/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/model/test_domain_shapes.h"

#include <string.h>

#include "tests/check.h"

struct gsn_mask *shape_mask(size_t nx, size_t ny, size_t nz, double step_x, double step_y,
                            double step_z, int (*rule)(size_t x, size_t y, size_t z))
{
    const struct gsn_lattice at = { .nx = nx,
                                    .ny = ny,
                                    .nz = nz,
                                    .origin_um = { step_x / 2, step_y / 2, step_z / 2 },
                                    .step_um = { step_x, step_y, step_z } };
    struct gsn_mask *mask = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_mask_new(&at, &mask, &err), err);
    for (size_t z = 0; z < nz; z++)
        for (size_t y = 0; y < ny; y++)
            for (size_t x = 0; x < nx; x++)
                mask->inside[gsn_lattice_index(&at, x, y, z)] = rule(x, y, z) != 0;
    return mask;
}

int shape_everywhere(size_t x, size_t y, size_t z)
{
    (void)x;
    (void)y;
    (void)z;
    return 1;
}

static struct gsn_surface *surface_of(const double (*vertex)[3], size_t vertices,
                                      const uint32_t (*facet)[4], size_t facets)
{
    struct gsn_surface *surface = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_surface_new(vertices, facets, 0, &surface, &err), err);
    memcpy(surface->vertex, vertex, vertices * sizeof *vertex);
    memcpy(surface->facet, facet, facets * sizeof *facet);
    return surface;
}

struct gsn_surface *shape_crossing(void)
{
    static const double VERTEX[8][3] = { { 0, 0, 0 },       { 1, 0, 0 },       { 0, 1, 0 },
                                         { 0, 0, 1 },       { 0.2, 0.2, 0.1 }, { 1.2, 0.2, 0.1 },
                                         { 0.2, 1.2, 0.1 }, { 0.2, 0.2, 1.1 } };
    static const uint32_t N = GSN_SURFACE_NONE;
    const uint32_t facet[8][4] = { { 0, 2, 1, N }, { 0, 1, 3, N }, { 1, 2, 3, N }, { 0, 3, 2, N },
                                   { 4, 6, 5, N }, { 4, 5, 7, N }, { 5, 6, 7, N }, { 4, 7, 6, N } };

    return surface_of(VERTEX, 8, facet, 8);
}

struct gsn_surface *shape_cube(double e)
{
    const double vertex[8][3] = { { 0, 0, 0 }, { e, 0, 0 }, { e, e, 0 }, { 0, e, 0 },
                                  { 0, 0, e }, { e, 0, e }, { e, e, e }, { 0, e, e } };
    static const uint32_t FACET[6][4] = { { 0, 3, 2, 1 }, { 4, 5, 6, 7 }, { 0, 1, 5, 4 },
                                          { 1, 2, 6, 5 }, { 2, 3, 7, 6 }, { 3, 0, 4, 7 } };

    return surface_of(vertex, 8, FACET, 6);
}

struct gsn_domain_options shape_options(double cell_um, double max_tet_um3)
{
    return (struct gsn_domain_options){ .mesher = GSN_MESHER,
                                        .cell_um = cell_um,
                                        .max_tet_um3 = max_tet_um3 };
}

struct gsn_tets *shape_mesh(const struct gsn_mask *region, double cell_um, double max_tet_um3)
{
    const struct gsn_domain_options options = shape_options(cell_um, max_tet_um3);
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_domain_build(region, &options, &mesh, &err), err);
    return mesh;
}

struct gsn_dms *shape_space(unsigned degree, double cloud, double max_tet_um3)
{
    gsn_auto(gsn_mask) region = shape_mask(8, 8, 8, 10, 10, 10, shape_everywhere);
    gsn_auto(gsn_tets) mesh = shape_mesh(region, 40, max_tet_um3);
    double(*knots)[3] = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_dms_clouds(mesh, degree, cloud, &knots, &err), err);
    CHECK_OK(gsn_dms_new(mesh, degree, knots, GSN_DMS_SHARED, &space, &err), err);
    gsn_free(knots);
    return space;
}

struct shape_samples shape_grid(double low, double high, size_t n, double (*f)(const double u[3]))
{
    struct shape_samples grid = { .at = gsn_alloc_array(n * n * n, sizeof *grid.at),
                                  .value = gsn_alloc_array(n * n * n, sizeof *grid.value) };

    CHECK(grid.at && grid.value);
    for (size_t i = 0; i < n * n * n; i++) {
        const size_t at[3] = { i % n, i / n % n, i / n / n };

        for (size_t k = 0; k < 3; k++)
            grid.at[i][k] = low + (high - low) * ((double)at[k] + 0.5) / (double)n;
        grid.value[i] = (float)f(grid.at[i]);
    }
    grid.samples = (struct gsn_samples){ .count = n * n * n, .at = grid.at, .value = grid.value };
    return grid;
}

void shape_samples_done(struct shape_samples *samples)
{
    gsn_free(samples->at);
    gsn_free(samples->value);
    *samples = (struct shape_samples){ .at = NULL };
}

/* splitmix64, by Steele, Lea and Flood. */
double shape_uniform(uint64_t *state)
{
    uint64_t z = *state += 0x9E3779B97F4A7C15u;

    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9u;
    z = (z ^ z >> 27) * 0x94D049BB133111EBu;
    return ((double)((z ^ z >> 31) >> 11) + 0.5) * 0x1p-53;
}

double shape_normal(uint64_t *state)
{
    const double radius = sqrt(-2 * log(shape_uniform(state)));

    return radius * cos(2 * M_PI * shape_uniform(state));
}
