/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The model that a page carries, unpacked here by the format's words and held against the
 * spline. */
#include "pipeline/export/page_model.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include <zlib.h>

#include "tests/check.h"
#include "tests/measure/kuhn.h"

static const double LOW[3] = { 100, -50, 20 }, HIGH[3] = { 400, 250, 180 };
static const unsigned CUBES[3] = { 4, 4, 3 };

enum {
    CORNERS = 4,
    FIRST_FACT = 9,
    FACTS = 10,
    INWARD = FIRST_FACT + FACTS,
    COLOUR = INWARD + 2,
    COLUMNS = COLOUR + 6,
    ROOM = 1 << 20
};
enum { NUMBER, DENSITY, LOWER, UPPER, RESIDUAL, BELOW, ABOVE, SAMPLES, SHARE, VOLUME };

struct unpacked {
    double head[GSN_PAGE_HEAD];
    size_t count[COLUMNS];
    int32_t *column[COLUMNS];
};

static void unpacked_done(struct unpacked *u)
{
    for (size_t i = 0; i < COLUMNS; i++)
        gsn_free(u->column[i]);
}

static struct unpacked unpack(const struct gsn_page_model *model)
{
    struct unpacked u = { .head = { 0 } };
    gsn_auto_mem(uint8_t) plain = gsn_alloc(ROOM);
    const uint8_t *at = plain + sizeof u.head;
    uLongf size = ROOM;

    CHECK(uncompress(plain, &size, model->bytes, (uLong)model->size) == Z_OK);
    memcpy(u.head, plain, sizeof u.head);
    for (size_t i = 0; i < COLOUR + 2 * (size_t)u.head[GSN_PAGE_HEAD - 1]; i++) {
        const size_t count = (size_t)u.head[i < 3 || i == 7 ? 0
                                            : i == 8        ? 1
                                            : i >= INWARD   ? (i - INWARD) % 2
                                                            : 2];
        const unsigned width = *at++;
        uint32_t last = 0;

        u.count[i] = count;
        u.column[i] = gsn_alloc_array(count + 1, sizeof *u.column[i]);
        for (size_t k = 0; k < count; k++) {
            uint32_t v = 0;

            for (unsigned b = 0; b < width; b++)
                v |= (uint32_t)at[b * count + k] << 8 * b;
            last += v & 1 ? ~(v >> 1) : v >> 1;
            u.column[i][k] = (int32_t)last;
        }
        at += width * count;
    }
    CHECK((size_t)(at - plain) == size);
    return u;
}

static double draw(void)
{
    static uint32_t state = 7;

    state = state * 1664525U + 1013904223U;
    return state / 4294967296.0;
}

/* A random spline, and figures of each cell of which every seventh holds no tissue. */
struct scene {
    struct kuhn kuhn;
    struct gsn_model_cells cells;
    struct gsn_mask *region;
};

static struct scene make_scene(unsigned degree, const unsigned cubes[3])
{
    struct scene s = { 0 };
    struct gsn_error err = { 0 };

    CHECK_OK(kuhn_random(LOW, HIGH, cubes, degree, 0.05, 11, &s.kuhn, &err), err);
    s.cells.density = gsn_alloc_array(s.kuhn.mesh->tet_count, sizeof *s.cells.density);
    s.cells.samples = gsn_alloc_array(s.kuhn.mesh->tet_count, sizeof *s.cells.samples);
    s.region = full_mask((const double[3]){ 140, -20, 40 }, 10, 20, 20, 12);
    for (size_t t = 0; t < s.kuhn.mesh->tet_count; t++) {
        s.cells.density[t] = t % 7 == 3 ? (double)NAN : 2 * draw() - 1;
        s.cells.samples[t] = (uint32_t)t;
    }
    return s;
}

static void scene_done(struct scene *s)
{
    gsn_free(s->cells.density);
    gsn_free(s->cells.samples);
    gsn_mask_free(s->region);
    kuhn_done(&s->kuhn);
}

static struct gsn_page_model *pack(const struct scene *s, size_t most, unsigned threads)
{
    const struct gsn_page_options options = {
        .region = s->region, .low = -1, .high = 1, .most_bytes = most
    };
    struct gsn_page_model *model = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_page_model_new(s->kuhn.spline, &s->cells, &options, threads, &model, &err), err);
    return model;
}

static void corners_of(const struct unpacked *u, size_t cell, double ret_at[4][3], double ret_s[4])
{
    for (size_t k = 0; k < 4; k++) {
        const int32_t v = u->column[3 + k][cell];

        for (size_t c = 0; c < 3; c++)
            ret_at[k][c] = u->head[3 + c] + u->head[6 + c] * u->column[c][v];
        ret_s[k] = u->head[9] + u->head[10] * u->column[7][v];
    }
}

static double volume_of(double at[4][3])
{
    double e[3][3], x[3];

    for (int k = 0; k < 3; k++)
        for (int c = 0; c < 3; c++)
            e[k][c] = at[k + 1][c] - at[0][c];
    gsn_cross3(e[0], e[1], x);
    return gsn_dot3(x, e[2]) / 6;
}

TEST(the_figures_of_a_cell_are_its_own_and_cells_without_tissue_are_left_out)
{
    struct scene s = make_scene(2, CUBES);
    gsn_auto(gsn_page_model) model = pack(&s, SIZE_MAX, 1);
    struct unpacked u = unpack(model);
    int32_t *const *const fact = u.column + FIRST_FACT;
    size_t next = 0;

    CHECK(u.head[11] == 4); /* digits of a range of 2: 20000 steps, no fewer */
    CHECK(model->cells == model->of && model->cells == u.count[3] && model->apart_um == 0);
    for (size_t t = 0; t < s.kuhn.mesh->tet_count; t++) {
        double at[4][3], height[4];

        if (isnan(s.cells.density[t]))
            continue;
        corners_of(&u, next, at, height);
        for (int k = 0; k < 4; k++)
            for (int c = 0; c < 3; c++)
                CHECK(fabs(at[k][c] - s.kuhn.mesh->vertex[s.kuhn.mesh->tet[t][k]][c]) <= 0.003);
        CHECK(fact[NUMBER][next] == (int32_t)t && fact[SAMPLES][next] == (int32_t)t);
        CHECK(fabs(fact[DENSITY][next] - 1e4 * s.cells.density[t]) <= 0.5 + 1e-9);
        CHECK(fabs(fact[VOLUME][next] / pow(10, u.head[12]) - gsn_tets_volume(s.kuhn.mesh, t)) <=
              0.51 / pow(10, u.head[12]));
        CHECK(fact[RESIDUAL][next] == INT32_MIN && fact[SHARE][next] == INT32_MIN);
        next++;
    }
    CHECK(next == model->cells);
    for (size_t v = 0; v < u.count[0]; v++) {
        double inward = INFINITY;

        for (size_t c = 0; c < 3; c++) {
            const double at = u.head[3 + c] + u.head[6 + c] * u.column[c][v];
            const double low = c == 0 ? 140 : c == 1 ? -20 : 40, high = low + (c == 2 ? 120 : 200);

            inward = fmin(inward, fmin(at - low, high - at));
        }
        if (fabs(inward) > 10) /* near edges it is smooth */
            CHECK((u.column[INWARD][v] > 0) == (inward > 0));
    }
    unpacked_done(&u);
    scene_done(&s);
}

TEST(bounds_hold_for_the_spline_at_random_points)
{
    for (unsigned degree = 1; degree <= 3; degree++) {
        struct scene s = make_scene(degree, CUBES);
        gsn_auto(gsn_page_model) model = pack(&s, SIZE_MAX, 1);
        struct unpacked u = unpack(model);
        int32_t *const *const fact = u.column + FIRST_FACT;

        for (size_t i = 0; i < 40 * model->cells; i++) {
            const size_t cell = i % model->cells;
            double at[4][3], height[4], w[4] = { 0 }, p[3] = { 0 }, sum = 0, linear = 0, value;
            size_t hint = (size_t)fact[NUMBER][cell];

            corners_of(&u, cell, at, height);
            for (int k = 0; k < 4; k++)
                sum += w[k] = i / model->cells == 0 ? 1 : -log(1e-9 + draw());
            for (int k = 0; k < 4; k++) {
                linear += w[k] / sum * height[k];
                for (int c = 0; c < 3; c++)
                    p[c] += w[k] / sum *
                            s.kuhn.mesh->vertex[s.kuhn.mesh->tet[fact[NUMBER][cell]][k]][c];
            }
            if (gsn_spline_eval(s.kuhn.spline, p, &hint, &value, NULL) != GSN_OK)
                continue;
            CHECK(1e4 * value >= fact[LOWER][cell] - 1e-6);
            CHECK(1e4 * value <= fact[UPPER][cell] + 1e-6);
            CHECK(1e4 * (linear - value) <= fact[BELOW][cell]);
            CHECK(1e4 * (value - linear) <= fact[ABOVE][cell]);
        }
        unpacked_done(&u);
        scene_done(&s);
    }
}

/* Of the edges the order is stated, so the reader need not be told which is which. */
TEST(nodes_have_the_splines_values)
{
    static const int pair[6][2] = { { 0, 1 }, { 0, 2 }, { 0, 3 }, { 1, 2 }, { 1, 3 }, { 2, 3 } };
    struct scene s = make_scene(2, CUBES);
    gsn_auto(gsn_page_model) model = pack(&s, SIZE_MAX, 1);
    struct unpacked u = unpack(model);
    gsn_auto_mem(int32_t) seen = gsn_alloc_array(u.count[0] * u.count[0], sizeof *seen);
    size_t edges = 0;

    for (size_t i = 0; i < model->cells; i++)
        for (int k = 0; k < 6; k++) {
            const size_t a = (size_t)u.column[3 + pair[k][0]][i];
            const size_t b = (size_t)u.column[3 + pair[k][1]][i];
            const size_t key = a < b ? a * u.count[0] + b : b * u.count[0] + a;
            double at[4][3], height[4], p[3], value;
            size_t hint = (size_t)u.column[FIRST_FACT + NUMBER][i];

            if (seen[key]++)
                continue;
            corners_of(&u, i, at, height);
            for (int c = 0; c < 3; c++) /* a hair inside, where the border has values */
                p[c] = (at[pair[k][0]][c] + at[pair[k][1]][c]) / 2 * 0.9999 +
                       (at[0][c] + at[1][c] + at[2][c] + at[3][c]) / 4 * 0.0001;
            CHECK(gsn_spline_eval(s.kuhn.spline, p, &hint, &value, NULL) == GSN_OK);
            CHECK(fabs(u.head[9] + u.head[10] * u.column[8][edges] - value) < 1e-3);
            edges++;
        }
    CHECK(edges == u.count[8]);
    unpacked_done(&u);
    scene_done(&s);
}

/* Red is the spline itself, green its half beyond black, blue above white: clamped. */
TEST(nodes_have_the_colours_of_their_places_as_codes)
{
    struct scene s = make_scene(2, CUBES);
    const struct quadric fields[3] = { { 0.1, { 1e-3, 0, 0 }, { 0 } },
                                       { -0.2, { 0, 1e-3, 0 }, { 0 } },
                                       { 1.5, { 0 }, { 0 } } };
    struct kuhn colour[3];
    const struct gsn_spline *splines[3];
    gsn_auto(gsn_page_model) model = NULL;
    struct gsn_error err = { 0 };

    for (int c = 0; c < 3; c++) {
        CHECK_OK(kuhn_new(LOW, HIGH, CUBES, 2, 0.05, &fields[c], &colour[c], &err), err);
        splines[c] = colour[c].spline;
    }
    const struct gsn_page_options options = {
        .region = s.region, .low = -1, .high = 1, .colour = splines, .most_bytes = SIZE_MAX
    };

    CHECK_OK(gsn_page_model_new(s.kuhn.spline, &s.cells, &options, 2, &model, &err), err);
    struct unpacked u = unpack(model);

    CHECK(u.count[COLOUR] == u.count[0] && u.count[COLOUR + 1] == u.count[8]);
    for (size_t v = 0; v < u.count[0]; v++)
        for (size_t c = 0; c < 3; c++) {
            const double at = u.head[3 + c] + u.head[6 + c] * u.column[c][v];
            const double light = fields[c].constant + 1e-3 * (c < 2 ? at : 0);
            const double clamped = fmin(1, fmax(0, light));
            /* IEC 61966-2-1 */
            const double code =
                clamped <= 0.0031308 ? 12.92 * clamped : 1.055 * pow(clamped, 1 / 2.4) - 0.055;

            CHECK(fabs(u.column[COLOUR + 2 * c][v] - 255 * code) <= 0.6);
        }
    unpacked_done(&u);
    for (int c = 0; c < 3; c++)
        kuhn_done(&colour[c]);
    scene_done(&s);
}

TEST(what_is_too_large_is_made_coarser_and_says_so)
{
    struct scene s = make_scene(2, CUBES);
    gsn_auto(gsn_page_model) all = pack(&s, SIZE_MAX, 1);
    gsn_auto(gsn_page_model) few = pack(&s, all->size / 2, 1);
    const struct gsn_page_options none = { .low = -1, .high = 1, .most_bytes = 10 };
    gsn_auto(gsn_page_model) model = NULL;
    struct gsn_error err = { 0 };
    struct unpacked u = unpack(few);

    CHECK(few->size <= all->size / 2 && few->of == all->of && few->apart_um > 0);
    CHECK(few->cells > 0 && few->cells < all->cells);
    for (size_t i = 0; i < few->cells; i++) {
        const size_t t = (size_t)u.column[FIRST_FACT + NUMBER][i];
        double at[4][3], height[4];

        corners_of(&u, i, at, height);
        CHECK(volume_of(at) > 0);
        CHECK(fabs(u.column[FIRST_FACT + DENSITY][i] - 1e4 * s.cells.density[t]) <= 0.5 + 1e-9);
    }
    CHECK(gsn_page_model_new(s.kuhn.spline, &s.cells, &none, 1, &model, &err) == GSN_E_LIMIT);
    CHECK(!model);
    unpacked_done(&u);
    scene_done(&s);
}

TEST(any_number_of_threads_gives_the_same_bytes)
{
    struct scene s = make_scene(3, CUBES);
    gsn_auto(gsn_page_model) one = pack(&s, SIZE_MAX, 1);
    gsn_auto(gsn_page_model) three = pack(&s, SIZE_MAX, 3);

    CHECK(one->size == three->size && memcmp(one->bytes, three->bytes, one->size) == 0);
    scene_done(&s);
}

static int pack_once(const struct scene *s, size_t most, struct gsn_error *err)
{
    const struct gsn_page_options options = {
        .region = s->region, .low = -1, .high = 1, .most_bytes = most
    };
    gsn_auto(gsn_page_model) model = NULL;

    return gsn_page_model_new(s->kuhn.spline, &s->cells, &options, 1, &model, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    static const unsigned few[3] = { 1, 1, 1 };
    struct scene s = make_scene(1, few);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(pack_once(&s, SIZE_MAX, &err), err);
    scene_done(&s);
}
