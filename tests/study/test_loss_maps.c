/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Maps of a study's losses, against the functions of inference.h cell by cell and R's p.adjust(). */
#include "pipeline/study/study.h"

#include <math.h>
#include <string.h>

#include "tests/check.h"

enum { CELLS = 5, MOST = 12 };

static const struct gsn_study_measure MEASURE = { "density", "density", "as drawn" };

struct drawn {
    struct gsn_study_specimen specimen[MOST];
    struct gsn_study_place place[MOST][CELLS];
    size_t count;
};

/* Cell k lies k cubes along x; value[k] NaN: the specimen has no such cell. */
static void add(struct drawn *d, const char *name, const char *animal, const char *group,
                double week, const double value[CELLS])
{
    struct gsn_study_specimen *const s = &d->specimen[d->count];
    size_t n = 0;

    *s = (struct gsn_study_specimen){ .name = name,
                                      .animal = animal,
                                      .group = group,
                                      .week = week,
                                      .control = strcmp(group, "control") == 0 ? NULL : "control",
                                      .vector_error = NAN,
                                      .section_error = NAN,
                                      .loss = NAN,
                                      .loss_lower = NAN,
                                      .loss_upper = NAN,
                                      .key = "" };
    for (size_t m = 0; m < GSN_STUDY_MEASURES; m++)
        s->value[m] = s->error[m] = NAN;
    s->value[0] = value[0];
    for (int k = 0; k < CELLS; k++)
        if (value[k] > -1)
            d->place[d->count][n++] = (struct gsn_study_place){ .address = { .cube = { k, 0, 0 } },
                                                                .density = value[k],
                                                                .volume_um3 = 1000 + k };
    s->place = d->place[d->count];
    s->place_count = n;
    d->count++;
}

static struct gsn_study_input input_of(const struct drawn *d)
{
    return (struct gsn_study_input){ .name = "drawn",
                                     .version = "0",
                                     .region = "all",
                                     .measure = &MEASURE,
                                     .measure_count = 1,
                                     .specimen = d->specimen,
                                     .specimen_count = d->count };
}

static struct gsn_study *analysed(const struct drawn *d)
{
    const struct gsn_study_input input = input_of(d);
    struct gsn_study *study = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    return study;
}

static const double CONTROL[3][CELLS] = { { 0.80, 0.70, 0.60, 0.50, 0.81 },
                                          { 0.84, 0.74, 0.66, 0.56, 0.79 },
                                          { 0.79, 0.69, 0.61, 0.54, NAN } };
static const double TREATED[3][CELLS] = { { 0.40, 0.60, 0.58, 0.62, NAN },
                                          { 0.44, 0.66, 0.64, 0.70, NAN },
                                          { 0.38, 0.58, 0.66, 0.66, 0.40 } };

static void draw_study(struct drawn *d)
{
    static const char *const name[6] = { "c0", "c1", "c2", "t0", "t1", "t2" };

    *d = (struct drawn){ .count = 0 };
    for (int i = 0; i < 3; i++)
        add(d, name[i], name[i], "control", 4, CONTROL[i]);
    for (int i = 0; i < 3; i++)
        add(d, name[3 + i], name[3 + i], "drug", 4, TREATED[i]);
}

TEST(each_cell_is_an_outcome_of_its_own)
{
    struct drawn d;

    draw_study(&d);
    gsn_auto(gsn_study) study = analysed(&d);

    CHECK(study->map_count == 1);
    CHECK(study->map[0].count == 4); /* one treated animal alone has the fifth */
    for (size_t k = 0; k < 4; k++) {
        const struct gsn_study_loss_cell *c = &study->map[0].cell[k];
        const double t[3] = { TREATED[0][k], TREATED[1][k], TREATED[2][k] };
        const double u[3] = { CONTROL[0][k], CONTROL[1][k], CONTROL[2][k] };
        const struct gsn_group_mean a = gsn_group_mean_of(t, 3), b = gsn_group_mean_of(u, 3);
        const struct gsn_group_loss loss = gsn_group_loss_of(&a, &b);

        CHECK(c->address.cube[0] == (int32_t)k && c->treated == 3 && c->controls == 3);
        CHECK_NEAR(c->density, a.mean, 1e-12);
        CHECK_NEAR(c->control, b.mean, 1e-12);
        CHECK_NEAR(c->volume_um3, 1000 + (double)k, 1e-9);
        CHECK_NEAR(c->loss.percent, loss.percent, 1e-9);
        CHECK_NEAR(c->loss.lower, loss.lower, 1e-9);
        CHECK_NEAR(c->loss.upper, loss.upper, 1e-9);
        CHECK_NEAR(c->p, gsn_group_compare(&a, &b).p, 1e-12);
    }
}

/* p.adjust(p, "BH"): each the least of p[j] n / rank(j) over those that are no smaller. */
TEST(the_share_of_false_findings_is_benjamini_and_hochbergs)
{
    struct drawn d;

    draw_study(&d);
    gsn_auto(gsn_study) study = analysed(&d);
    const struct gsn_study_loss_map *map = &study->map[0];
    double lost = 0, gained = 0, all = 0;

    for (size_t i = 0; i < map->count; i++) {
        const struct gsn_study_loss_cell *c = &map->cell[i];
        double q = 1;

        for (size_t j = 0; j < map->count; j++) {
            size_t rank = 0;

            for (size_t k = 0; k < map->count; k++)
                rank += map->cell[k].p <= map->cell[j].p;
            if (map->cell[j].p >= c->p)
                q = fmin(q, map->cell[j].p * (double)map->count / (double)rank);
        }
        CHECK_NEAR(c->q, q, 1e-12);
        all += c->volume_um3 * c->control;
        lost += c->q <= 0.05 && c->loss.percent > 0 ? c->volume_um3 * c->control : 0;
        gained += c->q <= 0.05 && c->loss.percent < 0 ? c->volume_um3 * c->control : 0;
    }
    CHECK(lost > 0 && gained > 0 && lost + gained < all);
    CHECK_NEAR(map->lost, lost / all, 1e-12);
    CHECK_NEAR(map->gained, gained / all, 1e-12);
    CHECK(map->low < map->median && map->median < map->high);
    CHECK_NEAR(map->low, map->cell[3].loss.percent, 1e-12);  /* the gain */
    CHECK_NEAR(map->high, map->cell[0].loss.percent, 1e-12); /* the greatest loss */
}

TEST(two_sides_of_an_animal_are_one_and_the_order_of_specimens_does_not_matter)
{
    const double left[CELLS] = { 0.30, 0.60, 0.58, 0.62, NAN };
    const double right[CELLS] = { 0.50, 0.60, 0.58, 0.62, NAN };
    struct drawn d, other = { .count = 0 };

    draw_study(&d);
    gsn_auto(gsn_study) whole = analysed(&d);

    /* t0 again, as two sides whose mean is what it had. */
    add(&other, "t2", "t2", "drug", 4, TREATED[2]);
    add(&other, "t0 right", "t0", "drug", 4, right);
    add(&other, "c1", "c1", "control", 4, CONTROL[1]);
    add(&other, "t0 left", "t0", "drug", 4, left);
    add(&other, "c2", "c2", "control", 4, CONTROL[2]);
    add(&other, "t1", "t1", "drug", 4, TREATED[1]);
    add(&other, "c0", "c0", "control", 4, CONTROL[0]);
    gsn_auto(gsn_study) sides = analysed(&other);

    CHECK(sides->map[0].count == whole->map[0].count);
    for (size_t k = 0; k < whole->map[0].count; k++) {
        CHECK(sides->map[0].cell[k].treated == 3);
        CHECK_NEAR(sides->map[0].cell[k].loss.percent, whole->map[0].cell[k].loss.percent, 1e-9);
        CHECK_NEAR(sides->map[0].cell[k].p, whole->map[0].cell[k].p, 1e-9);
    }
}

TEST(controls_of_all_weeks_stand_in_where_there_are_none_at_this_one)
{
    struct drawn d;

    draw_study(&d);
    d.specimen[1].week = 2;
    for (int i = 3; i < 6; i++)
        d.specimen[i].week = 8;
    gsn_auto(gsn_study) study = analysed(&d);

    CHECK(study->comparison[study->map[0].comparison].pooled);
    CHECK(study->map[0].cell[0].controls == 3);
    CHECK_NEAR(study->map[0].cell[0].control, (0.80 + 0.84 + 0.79) / 3, 1e-12);
}

TEST(one_animal_a_side_or_no_cells_make_no_map)
{
    struct drawn d;

    draw_study(&d);
    for (size_t i = 0; i < d.count; i++)
        d.specimen[i].place_count = i < 4 ? d.specimen[i].place_count : 0;
    gsn_auto(gsn_study) one = analysed(&d);

    for (size_t i = 0; i < d.count; i++)
        d.specimen[i].place_count = 0;
    gsn_auto(gsn_study) none = analysed(&d);

    CHECK(one->map_count == 0 && none->map_count == 0);
}

TEST(a_control_that_holds_nothing_has_nothing_to_lose)
{
    const double empty[CELLS] = { 0.5, 0, 0, NAN, NAN };
    struct drawn d = { .count = 0 };

    for (int i = 0; i < 4; i++)
        add(&d, i % 2 ? "a" : "b", i % 2 ? "a" : "b", i < 2 ? "control" : "drug", 4, empty);
    gsn_auto(gsn_study) study = analysed(&d);

    for (size_t m = 0; m < study->map_count; m++)
        for (size_t k = 0; k < study->map[m].count; k++)
            CHECK(study->map[m].cell[k].control > 0);
}

TEST(the_table_has_a_row_a_cell_and_the_page_draws_its_layer)
{
    struct drawn d;
    gsn_auto_mem(char) csv = NULL;
    gsn_auto_mem(char) page = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0, rows = 0;

    draw_study(&d);
    gsn_auto(gsn_study) study = analysed(&d);

    CHECK_OK(gsn_study_cells_csv(study, &csv, &size, &err), err);
    for (const char *at = csv; (at = strstr(at, "\r\n")) != NULL; at += 2)
        rows++;
    CHECK(rows == 5);
    CHECK(strstr(csv, "\r\n\"drug\",4,\"control\",1,0,0,0,"));
    CHECK_OK(gsn_study_page(study, &page, &size, &err), err);
    CHECK(strstr(page, "<h2>Where it was lost</h2>") && strstr(page, "4 cells that two animals"));
    rows = 0;
    for (const char *at = page; (at = strstr(at, "<polygon")) != NULL; at++)
        rows++;
    CHECK(rows == 4);
}

static double draw_normal(uint64_t *seed)
{
    double sum = -6;

    for (int i = 0; i < 12; i++) {
        *seed = *seed * 6364136223846793005u + 1442695040888963407u;
        sum += (double)(*seed >> 11) / 9007199254740992.0;
    }
    return sum;
}

/* Of studies of four against four in 60 cells, of which `lost` have lost a third: the mean share of
 * cells among the findings that have lost nothing, and of those that have how many are found. */
static void find_often(size_t lost, double *ret_false, double *ret_found)
{
    enum { STUDIES = 400, WIDE = 60, SIDE = 4 };
    static struct gsn_study_place place[2 * SIDE][WIDE];
    static const char *const name[2 * SIDE] = { "a", "b", "c", "d", "e", "f", "g", "h" };
    const double empty[CELLS] = { 0.5, NAN, NAN, NAN, NAN };
    uint64_t seed = 7;

    *ret_false = *ret_found = 0;
    for (int n = 0; n < STUDIES; n++) {
        struct drawn d = { .count = 0 };
        double found = 0, wrong = 0;

        for (size_t i = 0; i < 2 * SIDE; i++) {
            add(&d, name[i], name[i], i < SIDE ? "control" : "drug", 4, empty);
            for (size_t k = 0; k < WIDE; k++) {
                const double mean = i >= SIDE && k < lost ? 0.4 : 0.6;

                place[i][k] = (struct gsn_study_place){ .address = { .cube = { (int32_t)k, 0, 0 } },
                                                        .density = mean + 0.03 * draw_normal(&seed),
                                                        .volume_um3 = 1 };
            }
            d.specimen[i].place = place[i];
            d.specimen[i].place_count = WIDE;
        }
        gsn_auto(gsn_study) study = analysed(&d);

        for (size_t k = 0; k < study->map[0].count; k++)
            if (study->map[0].cell[k].q <= 0.05) {
                found += k < lost;
                wrong += k >= lost;
            }
        *ret_false += wrong > 0 ? wrong / (wrong + found) / STUDIES : 0;
        *ret_found += lost > 0 ? found / (double)lost / STUDIES : 0;
    }
}

TEST(one_in_twenty_findings_is_false_at_most_and_what_is_lost_is_found)
{
    double wrong, found;

    find_often(0, &wrong, &found);
    print_message("nothing lost: a finding in %.1f %% of studies\n", 100 * wrong);
    CHECK(wrong <= 0.05 + 2 * sqrt(0.05 * 0.95 / 400));
    find_often(20, &wrong, &found);
    print_message("20 of 60 cells: %.1f %% found, %.1f %% of the findings false\n", 100 * found,
                  100 * wrong);
    CHECK(wrong <= 0.05);
    CHECK(found > 0.9);
}

static int analyse_and_free(const struct drawn *d, struct gsn_error *err)
{
    const struct gsn_study_input input = input_of(d);
    gsn_auto(gsn_study) study = NULL;
    gsn_auto_mem(char) csv = NULL;
    size_t size;
    int r = gsn_study_analyse(&input, &study, err);

    return r < 0 ? r : gsn_study_cells_csv(study, &csv, &size, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    struct drawn d;

    draw_study(&d);
    CHECK_EVERY_OOM(analyse_and_free(&d, &err), err);
}
