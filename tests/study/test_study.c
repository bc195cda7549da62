/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/study/study.h"

#include "pipeline/measure/stats.h"
#include "tests/check.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

static const struct gsn_study_measure density = { "density", "density", "mean density" };

static struct gsn_study_specimen draw(const char *name, const char *animal, const char *group,
                                      const char *control, double week, double value)
{
    struct gsn_study_specimen s = { .name = name,
                                    .animal = animal,
                                    .group = group,
                                    .control = control,
                                    .week = week,
                                    .loss = NAN,
                                    .loss_lower = NAN,
                                    .loss_upper = NAN,
                                    .vector_error = 0,
                                    .key = "" };

    s.value[0] = value;
    s.error[0] = 0.01;
    return s;
}

static struct gsn_study_input study_of(const struct gsn_study_specimen *s, size_t count)
{
    return (struct gsn_study_input){ .name = "drawn",
                                     .version = "1",
                                     .region = "all",
                                     .measure = &density,
                                     .measure_count = 1,
                                     .specimen = s,
                                     .specimen_count = count };
}

TEST(two_sides_of_one_animal_are_one_animal)
{
    const struct gsn_study_specimen s[] = { draw("L", "1", "drug", "none", NAN, 0.30),
                                            draw("R", "1", "drug", "none", NAN, 0.34),
                                            draw("C1", "2", "none", NULL, NAN, 0.50),
                                            draw("C2", "3", "none", NULL, NAN, 0.54) };
    const struct gsn_study_input input = study_of(s, 4);
    gsn_auto(gsn_study) study = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    CHECK(study->animal_count == 3 && study->cell_count == 2);
    CHECK(study->cell[0].is_control && study->cell[0].count == 2);
    CHECK(study->animal[2].specimens == 2);
    CHECK_NEAR(study->animal[2].value[0], 0.32, 1e-15);
    CHECK_NEAR(study->animal[2].error[0], 0.01 / sqrt(2.0), 1e-15);
    CHECK(study->comparison_count == 1);
    CHECK_NEAR(study->comparison[0].loss.percent, 100 * (1 - 0.32 / 0.52), 1e-12);
}

/* A further region is a study of its own, but for Holm's correction, which counts both. */
TEST(p_values_are_corrected_over_all_regions)
{
    const struct gsn_study_specimen s[] = { draw("a", "1", "drug", "none", 2, 0.30),
                                            draw("b", "2", "drug", "none", 2, 0.33),
                                            draw("c", "3", "none", NULL, 2, 0.50),
                                            draw("d", "4", "none", NULL, 2, 0.56) };
    const struct gsn_study_specimen t[] = { draw("a", "1", "drug", "none", 2, 0.45),
                                            draw("b", "2", "drug", "none", 2, 0.47),
                                            draw("c", "3", "none", NULL, 2, 0.50),
                                            draw("d", "4", "none", NULL, 2, 0.56) };
    const struct gsn_study_input part = study_of(t, 4);
    struct gsn_study_input input = study_of(s, 4);
    gsn_auto(gsn_study) study = NULL;
    gsn_auto(gsn_study) alone = NULL;
    gsn_auto_mem(char) csv = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    CHECK_OK(gsn_study_analyse(&part, &alone, &err), err);
    input.part = &part;
    input.part_count = 1;
    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    CHECK(study->part_count == 1 && study->comparison_count == 1 &&
          study->part[0]->comparison_count == 1);

    const double p = study->comparison[0].difference.p;
    const double q = study->part[0]->comparison[0].difference.p;

    CHECK(p < q);
    CHECK_NEAR(q, alone->comparison[0].difference.p, 0);
    CHECK_NEAR(alone->comparison[0].p_holm, q, 0);
    CHECK_NEAR(study->comparison[0].p_holm, fmin(1, 2 * p), 1e-15);
    CHECK_NEAR(study->part[0]->comparison[0].p_holm, fmax(fmin(1, 2 * p), q), 1e-15);
    CHECK_OK(gsn_study_csv(study, &csv, &size, &err), err);
    size_t lines = 0;
    for (size_t i = 0; i < size; i++)
        lines += csv[i] == '\n';
    CHECK(lines == 1 + 2 * 4);
}

TEST(the_order_of_specimens_does_not_matter)
{
    struct gsn_study_specimen s[] = { draw("a", "1", "drug", "none", 2, 0.30),
                                      draw("b", "2", "drug", "none", 2, 0.33),
                                      draw("c", "3", "none", NULL, 2, 0.50),
                                      draw("d", "4", "none", NULL, 2, 0.56) };
    gsn_auto_mem(char) first = NULL;
    gsn_auto_mem(char) second = NULL;
    size_t size;
    struct gsn_error err = { 0 };

    for (int turn = 0; turn < 2; turn++) {
        const struct gsn_study_input input = study_of(s, 4);
        gsn_auto(gsn_study) study = NULL;
        const struct gsn_study_specimen kept = s[0];

        CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
        CHECK_OK(gsn_study_csv(study, turn ? &second : &first, &size, &err), err);
        s[0] = s[3];
        s[3] = kept;
    }
    CHECK(strcmp(first, second) == 0);
}

TEST(a_time_point_without_control_is_compared_with_the_control_of_all)
{
    const struct gsn_study_specimen s[] = { draw("a", "1", "drug", "none", 4, 0.30),
                                            draw("b", "2", "drug", "none", 4, 0.32),
                                            draw("c", "3", "none", NULL, 0, 0.50),
                                            draw("d", "4", "none", NULL, 2, 0.60) };
    const struct gsn_study_input input = study_of(s, 4);
    gsn_auto(gsn_study) study = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    CHECK(study->comparison_count == 1 && study->comparison[0].pooled);
    CHECK(study->comparison[0].mean_b.n == 2);
    CHECK_NEAR(study->comparison[0].loss.percent, 100 * (1 - 0.31 / 0.55), 1e-12);
}

/* Case 51: with one animal in a group there is no interval, and that is said. */
TEST(groups_that_nobody_treated_are_compared_with_each_other)
{
    const struct gsn_study_specimen s[] = { draw("a", "1", "A", NULL, NAN, 0.30),
                                            draw("b", "2", "A", NULL, NAN, 0.32),
                                            draw("c", "3", "B", NULL, NAN, 0.50) };
    const struct gsn_study_input input = study_of(s, 3);
    gsn_auto(gsn_study) study = NULL;
    struct gsn_error err = { 0 };
    char said[256];

    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    CHECK(study->comparison_count == 1 && study->comparison[0].kind == GSN_STUDY_TREATMENT);
    gsn_study_allows(&study->comparison[0], said, sizeof said);
    CHECK(strstr(said, "a single animal has no spread"));
}

/* The parts are the whole: Var(loss) by its two slopes. */
static void check_parts(const struct gsn_study_budget *b)
{
    const struct gsn_study_share *const t = &b->treated, *const c = &b->control;

    CHECK(t->animals >= 0 && t->vectors >= 0 && t->sections >= 0 && t->measurement >= 0);
    CHECK(c->animals >= 0 && c->vectors >= 0 && c->sections >= 0 && c->measurement >= 0);
    CHECK_NEAR(t->animals + t->vectors + t->sections + t->measurement + c->animals + c->vectors +
                   c->sections + c->measurement,
               b->total, 1e-9 * b->total);
}

/* Case 52. */
TEST(three_against_three_are_told_what_they_cannot_reach)
{
    const struct gsn_study_specimen s[] = {
        draw("a", "1", "drug", "none", NAN, 0.30), draw("b", "2", "drug", "none", NAN, 0.32),
        draw("c", "3", "drug", "none", NAN, 0.33), draw("d", "4", "none", NULL, NAN, 0.52),
        draw("e", "5", "none", NULL, NAN, 0.50),   draw("f", "6", "none", NULL, NAN, 0.56)
    };
    const struct gsn_study_input input = study_of(s, 6);
    gsn_auto(gsn_study) study = NULL;
    struct gsn_error err = { 0 };
    char said[256];

    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    gsn_study_allows(&study->comparison[0], said, sizeof said);
    CHECK(strstr(said, "smallest p it can give is 0.1"));
    CHECK_NEAR(study->comparison[0].p_exact, 0.1, 1e-12);
    check_parts(&study->comparison[0].budget);
    CHECK(study->comparison[0].budget.treated.measurement > 0);
}

TEST(several_controls_for_one_group_are_withheld_and_named)
{
    const struct gsn_study_specimen s[] = { draw("a", "1", "drug", "sham", NAN, 0.30),
                                            draw("b", "2", "drug", "none", NAN, 0.32),
                                            draw("c", "3", "none", NULL, NAN, 0.50) };
    const struct gsn_study_input input = study_of(s, 3);
    struct gsn_study *study = NULL;
    struct gsn_error err = { 0 };

    CHECK(gsn_study_analyse(&input, &study, &err) == GSN_E_WITHHELD);
    CHECK(strstr(err.text, "sham") && strstr(err.text, "none") && !study);
}

TEST(who_is_left_out_counts_nowhere_and_keeps_a_row_with_the_reason)
{
    struct gsn_study_specimen s[] = { draw("a", "1", "drug", "none", NAN, 0.30),
                                      draw("b", "2", "drug", "none", NAN, 9),
                                      draw("c", "=3", "none", NULL, NAN, 0.50) };
    struct gsn_study_input input = study_of(s, 3);
    gsn_auto(gsn_study) study = NULL;
    gsn_auto_mem(char) csv = NULL;
    size_t size;
    struct gsn_error err = { 0 };

    s[1].left_out = "the block \"broke\"";
    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    CHECK(study->animal_count == 2);
    CHECK_OK(gsn_study_csv(study, &csv, &size, &err), err);
    CHECK(size == strlen(csv));
    CHECK(strstr(csv, "\"2\",\"drug\",,treated,\"all\",\"density\",\"density\",,,1,no,"
                      "\"the block \"\"broke\"\"\""));
    CHECK(strstr(csv, "\"'=3\"")); /* no formula for a spreadsheet */
}

TEST(hostile_names_stay_text_on_the_page_and_in_json)
{
    const struct gsn_study_specimen s[] = { draw("<script>", "1", "\"><b>", "none", NAN, 0.30),
                                            draw("\xFF", "2", "none", NULL, NAN, 0.50) };
    const struct gsn_study_input input = study_of(s, 2);
    gsn_auto(gsn_study) study = NULL;
    gsn_auto_mem(char) page = NULL;
    gsn_auto_mem(char) text = NULL;
    json_t *root;
    size_t size;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
    CHECK_OK(gsn_study_page(study, &page, &size, &err), err);
    CHECK(!strstr(page, "<script") && !strstr(page, "<b>\"") && strstr(page, "&lt;script&gt;"));
    CHECK_OK(gsn_study_json(study, &text, &size, &err), err);
    root = json_loads(text, 0, NULL);
    CHECK(root && json_array_size(json_object_get(root, "comparisons")) == 1);
    json_decref(root);
}

static int make_everything(const struct gsn_study_input *input, struct gsn_error *err)
{
    gsn_auto(gsn_study) study = NULL;
    gsn_auto_mem(char) csv = NULL;
    gsn_auto_mem(char) page = NULL;
    gsn_auto_mem(char) json = NULL;
    size_t size;
    int r = gsn_study_analyse(input, &study, err);

    if (r >= 0)
        r = gsn_study_csv(study, &csv, &size, err);
    if (r >= 0)
        r = gsn_study_page(study, &page, &size, err);
    return r < 0 ? r : gsn_study_json(study, &json, &size, err);
}

TEST(a_study_says_when_memory_runs_out)
{
    const struct gsn_study_specimen s[] = { draw("a", "1", "drug", "none", NAN, 0.30),
                                            draw("b", "2", "none", NULL, NAN, 0.50) };
    const struct gsn_study_input input = study_of(s, 2);
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(make_everything(&input, &err), err);
}

static double draw_normal(uint64_t *seed)
{
    double u[2];

    for (int i = 0; i < 2; i++) {
        *seed = *seed * 6364136223846793005u + 1442695040888963407u;
        u[i] = ((double)(*seed >> 11) + 0.5) / 9007199254740992.0;
    }
    return sqrt(-2 * log(u[0])) * cos(2 * M_PI * u[1]);
}

/* Truth: a loss of 36 % among animals that differ by 6 % (control) and 10 % (treated). */
TEST(the_interval_over_animals_holds_the_truth_in_95_of_100_studies)
{
    static const size_t sides[] = { 3, 4, 6, 10 };
    enum { STUDIES = 4000 };
    uint64_t seed = 20261125;

    for (size_t k = 0; k < sizeof sides / sizeof sides[0]; k++) {
        int held = 0;

        for (int i = 0; i < STUDIES; i++) {
            double a[10], b[10];
            struct gsn_group_mean x, y;
            struct gsn_group_loss loss;

            for (size_t n = 0; n < sides[k]; n++) {
                a[n] = 0.64 * (0.5 + 0.05 * draw_normal(&seed));
                b[n] = 0.5 + 0.03 * draw_normal(&seed);
            }
            x = gsn_group_mean_of(a, sides[k]);
            y = gsn_group_mean_of(b, sides[k]);
            loss = gsn_group_loss_of(&x, &y);
            held += loss.lower <= 36 && 36 <= loss.upper;
        }
        printf("%zu animals a side: the interval holds the truth in %.1f %%\n", sides[k],
               100.0 * held / STUDIES);
        CHECK((double)held / STUDIES > 0.93);
        CHECK((double)held / STUDIES < 0.97);
    }
}

/* Animals that differ by 0.05 and 0.03, measured with an error of 0.02, of which dye vectors make
 * 0.012 and sections 0.01. */
static void draw_animals(size_t side, uint64_t *seed, struct gsn_study_specimen *s,
                         char (*name)[24])
{
    for (size_t i = 0; i < 2 * side; i++) {
        const int treated = i >= side;
        const double own =
            treated ? 0.32 + 0.05 * draw_normal(seed) : 0.50 + 0.03 * draw_normal(seed);

        (void)snprintf(name[i], sizeof name[i], "%zu", i);
        s[i] = draw(name[i], name[i], treated ? "drug" : "none", treated ? "none" : NULL, NAN,
                    own + 0.02 * draw_normal(seed));
        s[i].error[0] = 0.02;
        s[i].vector_error = 0.012;
        s[i].section_error = 0.01;
    }
}

static void add_share(const struct gsn_study_share *share, double sum[4])
{
    sum[0] += share->animals;
    sum[1] += share->vectors;
    sum[2] += share->sections;
    sum[3] += share->measurement;
}

/* In each study, with however few animals, the parts are the whole; with ten a side their means are
 * those drawn: of the treated side's variance 25 are the animals', 1.44 and 1 vectors' and
 * sections' and 1.56 the rest. */
TEST(the_variance_budget_adds_up_and_its_parts_are_those_drawn)
{
    static const size_t sides[] = { 3, 4, 6, 10 };
    enum { STUDIES = 500 };
    uint64_t seed = 27;

    for (size_t k = 0; k < sizeof sides / sizeof sides[0]; k++) {
        double part[4] = { 0 }, all = 0;

        for (size_t i = 0; i < STUDIES; i++) {
            struct gsn_study_specimen s[20];
            char name[20][24];
            struct gsn_error err = { 0 };
            gsn_auto(gsn_study) study = NULL;

            draw_animals(sides[k], &seed, s, name);
            const struct gsn_study_input input = study_of(s, 2 * sides[k]);

            CHECK_OK(gsn_study_analyse(&input, &study, &err), err);
            check_parts(&study->comparison[0].budget);
            add_share(&study->comparison[0].budget.treated, part);
        }
        for (int i = 0; i < 4; i++)
            all += part[i];
        printf(
            "%zu animals a side: animals %.1f, vectors %.1f, sections %.1f, other %.1f %% (drawn "
            "86.2, 5.0, 3.4, 5.4)\n",
            sides[k], 100 * part[0] / all, 100 * part[1] / all, 100 * part[2] / all,
            100 * part[3] / all);
        if (sides[k] < 10)
            continue; /* a spread of few is often below the error of measuring them */
        CHECK_NEAR(part[0] / all, 25 / 29., 0.05 * 25 / 29);
        CHECK_NEAR(part[1] / part[2], 1.44, 0.05 * 1.44);
        CHECK_NEAR(part[3] / part[2], 1.56, 0.05 * 1.56);
    }
}
