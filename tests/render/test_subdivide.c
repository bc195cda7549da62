/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/render/subdivide.h"

#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double low[3] = { 0.0, 0.0, 0.0 }, high[3] = { 3.0, 2.0, 1.0 };
static const unsigned cells[3] = { 3, 2, 1 };
static const struct quadric nothing = { 0.0, { 0.0, 0.0, 0.0 }, { 0.0, 0.0, 0.0 } };

static double volume(const double *a, const double *b, const double *c, const double *d)
{
    double e[3], f[3], g[3];

    for (int k = 0; k < 3; k++) {
        e[k] = b[k] - a[k];
        f[k] = c[k] - a[k];
        g[k] = d[k] - a[k];
    }
    return (e[0] * (f[1] * g[2] - f[2] * g[1]) - e[1] * (f[0] * g[2] - f[2] * g[0]) +
            e[2] * (f[0] * g[1] - f[1] * g[0])) /
           6.0;
}

struct face {
    uint32_t point[3];
};

static int by_number(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;

    return (x > y) - (x < y);
}

static int by_points(const void *a, const void *b)
{
    return memcmp(a, b, sizeof(struct face));
}

/* Every face of the parts is shared by two, but for those on the box: 2 * 4^level per cube face. */
static void check_faces(const struct gsn_fine *fine, unsigned level)
{
    const size_t count = 4 * fine->tet_count * fine->parts;
    gsn_auto_mem(struct face) face = gsn_alloc_array(count, sizeof *face);
    size_t at = 0, alone = 0;

    for (size_t t = 0; t < fine->tet_count; t++) {
        for (unsigned p = 0; p < fine->parts; p++) {
            for (int k = 0; k < 4; k++, at++) {
                for (int j = 0; j < 3; j++)
                    face[at].point[j] =
                        fine->place[t * fine->places + fine->part[p][(k + 1 + j) % 4]];
                qsort(face[at].point, 3, sizeof(uint32_t), by_number);
            }
        }
    }
    qsort(face, count, sizeof *face, by_points);
    for (size_t i = 0, same = 1; i < count; i += same) {
        for (same = 1; i + same < count && by_points(&face[i], &face[i + same]) == 0;)
            same++;
        CHECK(same <= 2);
        alone += same == 1;
    }
    CHECK(alone == (size_t)2 * (3 * 2 + 2 * 1 + 3 * 1) * 2 << (2 * level));
}

TEST(parts_fill_their_tetrahedron_and_fit_their_neighbours)
{
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 1, 0.05, &nothing, &kuhn, &err), err);
    for (unsigned level = 0; level <= GSN_FINE_MOST_LEVEL; level++) {
        const size_t side = (size_t)1 << level;
        gsn_auto(gsn_fine) fine = NULL;

        CHECK_OK(gsn_fine_new(kuhn.mesh, level, &fine, &err), err);
        CHECK(fine->parts == side * side * side);
        CHECK(fine->point_count == (3 * side + 1) * (2 * side + 1) * (side + 1));
        for (size_t t = 0; t < fine->tet_count; t++) {
            const uint32_t *place = fine->place + t * fine->places;

            for (unsigned p = 0; p < fine->parts; p++)
                CHECK_NEAR(volume(fine->point[place[fine->part[p][0]]],
                                  fine->point[place[fine->part[p][1]]],
                                  fine->point[place[fine->part[p][2]]],
                                  fine->point[place[fine->part[p][3]]]),
                           gsn_tets_volume(kuhn.mesh, t) / (double)(side * side * side), 1e-15);
        }
        check_faces(fine, level);
    }
    kuhn_done(&kuhn);
}

static int subdivide(const struct gsn_tets *mesh, struct gsn_error *err)
{
    gsn_auto(gsn_fine) fine = NULL;

    return gsn_fine_new(mesh, 3, &fine, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    struct kuhn kuhn;

    CHECK_OK(kuhn_new(low, high, cells, 1, 0.05, &nothing, &kuhn, &err), err);
    CHECK_EVERY_OOM(subdivide(kuhn.mesh, &err), err);
    kuhn_done(&kuhn);
}
