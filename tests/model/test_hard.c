/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whatever is asked: a value that agrees with the recurrence or a closed form, or a refusal that
 * leaves the outputs alone. Never a wrong number. */
#include "tests/check.h"
#include "tests/model/formula.h"
#include "tests/model/kuhn.h"
#include "tests/model/paths.h"

#include "pipeline/model/dms_internal.h"
#include "pipeline/model/spline.h"

#include <string.h>

static const size_t CUBES[3] = { 2, 2, 2 };

/* A mesh before it is one. */
struct raw {
    size_t vertices, tets;
    double vertex[64][3];
    uint32_t tet[64][4];
};

/* An affine map. */
struct map {
    double by[3][3], shift[3];
};

static void apply(const struct map *map, const double u[3], double ret[3])
{
    for (int c = 0; c < 3; c++)
        ret[c] = gsn_dot(map->by[c], u) + map->shift[c];
}

static struct map stretch(double x, double y, double z)
{
    return (struct map){ .by = { { x, 0, 0 }, { 0, y, 0 }, { 0, 0, z } } };
}

/* The same turned out of the axes. */
static struct map turned(struct map map)
{
    static const double turn[3][3] = { { 0.36, 0.48, -0.8 },
                                       { -0.8, 0.6, 0 },
                                       { 0.48, 0.64, 0.6 } };
    struct map ret = { .shift = { 0.1, -0.2, 0.3 } };

    for (int r = 0; r < 3; r++) {
        for (int c = 0; c < 3; c++) {
            for (int i = 0; i < 3; i++)
                ret.by[r][c] += turn[r][i] * map.by[i][c];
        }
    }
    return ret;
}

static struct gsn_tets *mapped(struct gsn_tets *mesh, const struct map *map)
{
    struct gsn_tets *ret = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < mesh->vertex_count; i++) {
        double to[3];

        apply(map, mesh->vertex[i], to);
        memcpy(mesh->vertex[i], to, sizeof to);
    }
    CHECK_OK(gsn_tets_new((const double(*)[3])mesh->vertex, mesh->vertex_count,
                          (const uint32_t(*)[4])mesh->tet, mesh->tet_count, &ret, &err),
             err);
    gsn_tets_free(mesh);
    return ret;
}

static struct gsn_tets *raw_mesh(const struct raw *raw)
{
    struct gsn_tets *mesh = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tets_new(raw->vertex, raw->vertices, raw->tet, raw->tets, &mesh, &err), err);
    return mesh;
}

enum { EACH = 12 }; /* points of a tetrahedron */

/* Points in and near every tetrahedron, on its corners, edges and faces, and in its clouds. */
static size_t draw_points(const struct gsn_dms *space, double (**ret_at)[3])
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const size_t count = EACH * mesh->tet_count;
    double(*at)[3] = gsn_alloc_array(count, sizeof *at);
    uint64_t seed = 61;

    for (size_t i = 0; i < count; i++) {
        const uint32_t *v = mesh->tet[i / EACH];
        const size_t corners = i % EACH;

        if (corners < 5) {
            draw_inside(mesh, i / EACH, &seed, at[i]);
        } else if (corners < 8) {
            draw_in_skins(mesh, i / EACH, &seed, at[i]);
        } else if (corners == 11) {
            const size_t knot = v[i / EACH % 4] * (gsn_dms_degree(space) + 1) + 1;

            memcpy(at[i], gsn_dms_knots(space)[knot], sizeof *at);
        } else {
            for (int c = 0; c < 3; c++) {
                for (size_t k = 0; k < corners - 7; k++)
                    at[i][c] += mesh->vertex[v[(k + i / EACH) % 4]][c] / (double)(corners - 7);
            }
        }
    }
    *ret_at = at;
    return count;
}

/* takes: a space. All quick ways agree with the recurrence on random control values within this,
 * gradients relative to the largest. */
static void check_space(struct gsn_dms *space, const char *what, double tolerance,
                        double slope_tolerance)
{
    uint64_t seed = 62;
    double(*at)[3];
    const size_t count = draw_points(space, &at);
    gsn_auto(gsn_spline) spline = random_spline(space, &seed);
    const struct path_gap gap = path_compare(space, spline, (const double(*)[3])at, count);

    print_message("%-28s n = %u %s: %4zu of %4zu inside, s off by %.1e, gradient by %.1e\n", what,
                  gsn_dms_degree(space), space->sharing == GSN_DMS_OWN ? "own   " : "shared",
                  gap.inside, count, gap.value, gap.slope / gap.steepest);
    CHECK(gap.inside > count / 3);
    CHECK_NEAR(gap.value, 0, tolerance);
    CHECK_NEAR(gap.slope / gap.steepest, 0, slope_tolerance);
    gsn_free(at);
    gsn_spline_free(gsn_steal(&spline));
    gsn_dms_free(space);
}

/* How far values may be off with shared and with own control points, and gradients. Own ones make
 * cliffs as steep as the clouds are small. */
struct allowed {
    double shared, own, slope;
};

static void check_mesh(struct gsn_tets *(*make)(const void *how), const void *how, const char *what,
                       double fraction, struct allowed allowed)
{
    for (int i = 0; i < 6; i++)
        check_space(kuhn_space_on(make(how), 1 + (unsigned)i % 3, fraction,
                                  i < 3 ? GSN_DMS_SHARED : GSN_DMS_OWN),
                    what, i < 3 ? allowed.shared : allowed.own, allowed.slope);
}

static const struct allowed PLAIN = { 1e-12, 5e-12, 1e-10 };
/* A height of 1e-4 takes four digits of a position, a cloud in it one or two more. */
static const struct allowed SLIVERS = { 1e-10, 1e-8, 1e-8 };

static struct gsn_tets *kuhn_mapped(const void *map)
{
    return mapped(kuhn_mesh(CUBES, 0.1), map);
}

TEST(meshes_pressed_flat_ten_thousand_times_agree_with_the_recurrence)
{
    const struct map flat = stretch(1, 1, 1e-4), oblique = turned(flat);

    check_mesh(kuhn_mapped, &flat, "flat", 0.05, SLIVERS);
    check_mesh(kuhn_mapped, &oblique, "flat, oblique", 0.05, SLIVERS);
}

TEST(meshes_drawn_to_needles_agree_with_the_recurrence)
{
    const struct map thin = stretch(1e-4, 1, 1e-4), oblique = turned(thin);

    check_mesh(kuhn_mapped, &thin, "needles", 0.05, SLIVERS);
    check_mesh(kuhn_mapped, &oblique, "needles, oblique", 0.05, SLIVERS);
}

static struct gsn_tets *raw_mapped(const void *raw)
{
    const struct map oblique = turned(stretch(1, 1, 1));

    return mapped(raw_mesh(raw), &oblique);
}

TEST(single_slivers_of_every_shape_agree_with_the_recurrence)
{
    static const struct {
        const char *name;
        struct raw raw;
    } shape[] = {
        { "sliver",
          { 4,
            1,
            { { 0, 0, 0 }, { 1, 1, 0 }, { 1, 0, 1e-4 }, { 0, 1, 1e-4 } },
            { { 0, 1, 2, 3 } } } },
        { "cap",
          { 4,
            1,
            { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0.3, 0.3, 1e-4 } },
            { { 0, 1, 2, 3 } } } },
        { "wedge",
          { 4,
            1,
            { { 0, 0, 0 }, { 1, 0, 0 }, { 0.5, 1, 0 }, { 0.5, 1, 1e-4 } },
            { { 0, 1, 2, 3 } } } },
        { "spindle",
          { 4,
            1,
            { { 0, 0, 0 }, { 1, 0, 0 }, { 0.5, 1e-4, 0 }, { 0.5, 0, 1e-4 } },
            { { 0, 1, 2, 3 } } } },
        { "needle",
          { 4,
            1,
            { { 0, 0, 0 }, { 1e-4, 0, 0 }, { 0, 1e-4, 0 }, { 0, 0, 1 } },
            { { 0, 1, 2, 3 } } } },
        { "spade",
          { 4,
            1,
            { { 0, 0, 0 }, { 1, 0, 0 }, { 0.5, 1e-4, 0 }, { 0.5, 0.5, 1 } },
            { { 0, 1, 2, 3 } } } },
        { "one tetrahedron",
          { 4, 1, { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } }, { { 0, 1, 2, 3 } } } },
    };

    for (size_t i = 0; i < sizeof shape / sizeof *shape; i++)
        check_mesh(raw_mapped, &shape[i].raw, shape[i].name, 0.05, SLIVERS);
}

TEST(meshes_in_pieces_agree_with_the_recurrence)
{
    static const struct {
        const char *name;
        struct raw raw;
    } mesh[] = {
        { "two, apart",
          { 8,
            2,
            { { 0, 0, 0 },
              { 1, 0, 0 },
              { 0, 1, 0 },
              { 0, 0, 1 },
              { 3, 0, 0 },
              { 4, 0, 0 },
              { 3, 1, 0 },
              { 3, 0, 1 } },
            { { 0, 1, 2, 3 }, { 4, 5, 6, 7 } } } },
        { "two, 1e9 apart",
          { 8,
            2,
            { { 0, 0, 0 },
              { 1, 0, 0 },
              { 0, 1, 0 },
              { 0, 0, 1 },
              { 1e9, 0, 0 },
              { 1e9 + 1, 0, 0 },
              { 1e9, 1, 0 },
              { 1e9, 0, 1 } },
            { { 0, 1, 2, 3 }, { 4, 5, 6, 7 } } } },
        { "two at a vertex",
          { 7,
            2,
            { { 0, 0, 0 },
              { 1, 0, 0 },
              { 0, 1, 0 },
              { 0, 0, 1 },
              { -1, 0, 0 },
              { 0, -1, 0 },
              { 0, 0, -1 } },
            { { 0, 1, 2, 3 }, { 0, 5, 4, 6 } } } },
        { "two at an edge",
          { 6,
            2,
            { { 0, 0, 0 }, { 0, 0, 1 }, { 1, 0, 0 }, { 0, 1, 0 }, { -1, 0, 0 }, { 0, -1, 0 } },
            { { 0, 1, 2, 3 }, { 0, 1, 4, 5 } } } },
    };

    for (size_t i = 0; i < sizeof mesh / sizeof *mesh; i++)
        check_mesh((struct gsn_tets * (*)(const void *)) raw_mesh, &mesh[i].raw, mesh[i].name, 0.05,
                   PLAIN);
}

TEST(clouds_tiny_and_huge_agree_with_the_recurrence)
{
    const struct map same = stretch(1, 1, 1);

    check_mesh(kuhn_mapped, &same, "clouds of 0.5", 0.5, PLAIN);
    /* The recurrence adds slopes of 1e9 that nearly cancel. */
    check_mesh(kuhn_mapped, &same, "clouds of 1e-9", 1e-9, (struct allowed){ 1e-12, 2e-4, 1e-3 });
}

/* ---- size and place ---- */

/* The same spline with all knots mapped. */
static struct gsn_dms *moved(const struct gsn_dms *space, const struct map *map)
{
    const size_t vertices = gsn_dms_mesh(space)->vertex_count;
    const size_t per_cloud = gsn_dms_degree(space) + 1;
    double(*knot)[3] = gsn_alloc_array(vertices * per_cloud, sizeof *knot);
    double(*vertex)[3] = gsn_alloc_array(vertices, sizeof *vertex);
    struct gsn_tets *mesh = NULL;
    struct gsn_dms *ret = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < vertices * per_cloud; i++)
        apply(map, gsn_dms_knots(space)[i], knot[i]);
    for (size_t i = 0; i < vertices; i++)
        memcpy(vertex[i], knot[i * per_cloud], sizeof *vertex);
    CHECK_OK(gsn_tets_new((const double(*)[3])vertex, vertices,
                          (const uint32_t(*)[4])gsn_dms_mesh(space)->tet,
                          gsn_dms_mesh(space)->tet_count, &mesh, &err),
             err);
    CHECK_OK(gsn_dms_new(mesh, gsn_dms_degree(space), (const double(*)[3])knot, space->sharing,
                         &ret, &err),
             err);
    gsn_tets_free(mesh);
    gsn_free(vertex);
    gsn_free(knot);
    return ret;
}

/* Numbers on a grid of 2^-20, so that a shift by 1e9 rounds nothing. */
static void coarsen(double *x, size_t count)
{
    for (size_t i = 0; i < count; i++)
        x[i] = round(x[i] * 0x1p20) * 0x1p-20;
}

static struct gsn_dms *coarse_space(unsigned degree, enum gsn_dms_sharing sharing)
{
    gsn_auto(gsn_dms) fine = kuhn_space(CUBES, 0.1, degree, 0.05, sharing);
    const size_t vertices = gsn_dms_mesh(fine)->vertex_count;
    double(*knot)[3] = gsn_memdup(gsn_dms_knots(fine), vertices * (degree + 1) * sizeof *knot);
    double(*vertex)[3] = gsn_memdup(gsn_dms_mesh(fine)->vertex, vertices * sizeof *vertex);
    struct gsn_tets *mesh = NULL;
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    coarsen(knot[0], 3 * vertices * (degree + 1));
    coarsen(vertex[0], 3 * vertices);
    CHECK_OK(gsn_tets_new((const double(*)[3])vertex, vertices,
                          (const uint32_t(*)[4])gsn_dms_mesh(fine)->tet,
                          gsn_dms_mesh(fine)->tet_count, &mesh, &err),
             err);
    CHECK_OK(gsn_dms_new(mesh, degree, (const double(*)[3])knot, sharing, &space, &err), err);
    gsn_tets_free(mesh);
    gsn_free(vertex);
    gsn_free(knot);
    return space;
}

/* Values of the mapped spline at mapped points are those of the unmapped one. */
static void check_moved(const struct map *map, const char *what, double tolerance)
{
    for (int i = 0; i < 6; i++) {
        gsn_auto(gsn_dms) space =
            coarse_space(1 + (unsigned)i % 3, i < 3 ? GSN_DMS_SHARED : GSN_DMS_OWN);
        gsn_auto(gsn_dms) there = moved(space, map);
        uint64_t seed = 63, again = 63;
        gsn_auto(gsn_spline) spline = random_spline(space, &seed);
        gsn_auto(gsn_spline) far = random_spline(there, &again);
        double(*at)[3], (*to)[3], (*slope)[3], worst = 0;
        const size_t count = draw_points(space, &at);
        gsn_auto_mem(double) value = gsn_alloc_array(2 * count, sizeof *value);

        to = gsn_alloc_array(count, sizeof *to);
        slope = gsn_alloc_array(count, sizeof *slope);
        coarsen(at[0], 3 * count);
        for (size_t p = 0; p < count; p++)
            apply(map, at[p], to[p]);
        path_run(PATH_RECURRENCE, spline, (const double(*)[3])at, count, value, slope);
        for (enum path path = PATH_RECURRENCE; path < PATHS; path++) {
            path_run(path, far, (const double(*)[3])to, count, value + count, slope);
            for (size_t p = 0; p < count; p++) {
                CHECK(isnan(value[p]) == isnan(value[count + p]));
                if (isnan(value[p]))
                    continue;
                worst = fmax(worst, fabs(value[p] - value[count + p]));
                CHECK_NEAR(value[count + p], value[p], tolerance);
            }
        }
        print_message("%-28s n = %u: s off by %.1e\n", what, gsn_dms_degree(space), worst);
        gsn_free(at);
        gsn_free(to);
        gsn_free(slope);
    }
}

TEST(a_mesh_far_from_the_origin_has_the_same_values)
{
    struct map far = stretch(1, 1, 1);

    far.shift[0] = 1e9;
    far.shift[1] = -1e9;
    far.shift[2] = 1e9;
    check_moved(&far, "1e9 from the origin", 1e-12);
}

TEST(a_mesh_of_any_size_has_the_same_values)
{
    const struct map small = stretch(0x1p-20, 0x1p-20, 0x1p-20),
                     tiny = stretch(0x1p-100, 0x1p-100, 0x1p-100);
    const struct map large = stretch(0x1p20, 0x1p20, 0x1p20),
                     huge = stretch(0x1p100, 0x1p100, 0x1p100);

    check_moved(&small, "1e-6 in size", 1e-12);
    check_moved(&large, "1e6 in size", 1e-12);
    check_moved(&tiny, "1e-30 in size", 1e-12);
    check_moved(&huge, "1e30 in size", 1e-12);
}

TEST(clouds_made_for_small_and_large_meshes_agree_with_the_recurrence)
{
    const struct map small = stretch(1e-6, 1e-6, 1e-6), large = stretch(1e6, 1e6, 1e6);

    check_mesh(kuhn_mapped, &small, "1e-6 in size", 0.05, PLAIN);
    check_mesh(kuhn_mapped, &large, "1e6 in size", 0.05, PLAIN);
}

/* Beyond what products of three lengths can be told from 0 or infinity there are no splines. */
TEST(a_mesh_too_small_or_too_large_for_its_determinants_is_refused)
{
    static const double size[] = { 1e-300, 1e-120, 1e-105, 1e-40, 1e40, 1e105, 1e120, 1e300 };

    for (size_t i = 0; i < sizeof size / sizeof *size; i++) {
        const struct raw raw = {
            4,
            1,
            { { 0, 0, 0 }, { size[i], 0, 0 }, { 0, size[i], 0 }, { 0, 0, size[i] } },
            { { 0, 1, 2, 3 } }
        };
        struct gsn_tets *mesh = NULL;
        double(*knots)[3] = NULL;
        struct gsn_error err = { 0 };
        int r = gsn_tets_new(raw.vertex, 4, raw.tet, 1, &mesh, &err);

        if (r == GSN_OK)
            r = gsn_dms_clouds(mesh, 2, 0.05, &knots, &err);
        CHECK(r == GSN_E_MESH && err.text[0] != 0);
        CHECK(knots == NULL);
        gsn_tets_free(mesh);
    }
}

/* ---- knots in one place ---- */

static struct gsn_dms *coinciding(unsigned degree, unsigned how, enum gsn_dms_sharing sharing)
{
    gsn_auto(gsn_dms) model = kuhn_space(CUBES, 0.1, degree, 0.1, sharing);
    const size_t vertices = gsn_dms_mesh(model)->vertex_count;
    double(*knot)[3] = gsn_memdup(gsn_dms_knots(model), vertices * (degree + 1) * sizeof *knot);
    struct gsn_dms *space = NULL;
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < vertices; i++) {
        for (unsigned l = 1; l <= degree; l++) {
            if (how == 2 || (how == 0 && l == 1) || (how == 1 && l == degree) ||
                (how == 3 && i % 2 == 0))
                memcpy(knot[i * (degree + 1) + l], knot[i * (degree + 1) + l - 1], sizeof *knot);
        }
    }
    CHECK_OK(
        gsn_dms_new(gsn_dms_mesh(model), degree, (const double(*)[3])knot, sharing, &space, &err),
        err);
    gsn_free(knot);
    return space;
}

TEST(coinciding_knots_agree_with_the_recurrence)
{
    static const char *const what[4] = { "first knot on the vertex", "last two knots together",
                                         "all knots on their vertices",
                                         "all knots of every other" };

    for (unsigned how = 0; how < 4; how++) {
        for (int i = 0; i < 6; i++)
            check_space(coinciding(1 + (unsigned)i % 3, how, i < 3 ? GSN_DMS_SHARED : GSN_DMS_OWN),
                        what[how], 1e-12, 1e-10);
    }
}

/* Means over the tetrahedra, by their seams and by the recurrence for any cell. */
TEST(means_agree_with_each_other_when_knots_coincide)
{
    for (unsigned how = 0; how < 4; how++) {
        for (unsigned degree = 1; degree <= 2; degree++) {
            gsn_auto(gsn_dms) space = coinciding(degree, how, GSN_DMS_SHARED);
            uint64_t seed = 64;
            gsn_auto(gsn_spline) spline = random_spline(space, &seed);
            const struct gsn_tets *mesh = gsn_dms_mesh(space);
            struct gsn_error err = { 0 };

            for (size_t t = 0; t < mesh->tet_count; t += 17) {
                double corner[4][3], mean, other;

                for (int k = 0; k < 4; k++)
                    memcpy(corner[k], mesh->vertex[mesh->tet[t][k]], sizeof corner[k]);
                CHECK_OK(gsn_spline_tet_mean(spline, t, &mean, &err), err);
                CHECK_OK(gsn_spline_cell_mean(spline, (const double(*)[3])corner, &other, &err),
                         err);
                CHECK_NEAR(mean, other, 1e-10);
            }
        }
    }
}

/* ---- cells ---- */

TEST(flat_and_folded_meshes_are_refused)
{
    static const struct raw raw[] = {
        { 4, 1, { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 1, 1, 0 } }, { { 0, 1, 2, 3 } } },
        { 4, 1, { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 1, 0 } }, { { 0, 1, 2, 3 } } },
        { 4, 1, { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, NAN, 1 } }, { { 0, 1, 2, 3 } } },
        { 4, 1, { { 0, 0, 0 }, { INFINITY, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } }, { { 0, 1, 2, 3 } } },
    };

    for (size_t i = 0; i < sizeof raw / sizeof *raw; i++) {
        struct gsn_tets *mesh = NULL;
        struct gsn_error err = { 0 };

        CHECK(gsn_tets_new(raw[i].vertex, 4, raw[i].tet, 1, &mesh, &err) == GSN_E_MESH);
        CHECK(err.text[0] != 0 && mesh == NULL);
    }
}
