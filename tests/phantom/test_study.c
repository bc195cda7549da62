/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <string.h>

#include "pipeline/core/mem.h"
#include "pipeline/phantom/planning.h"
#include "pipeline/phantom/study.h"
#include "pipeline/phantom/truth.h"

static struct gsn_phantom_sums sums_of(const char *name)
{
    const struct gsn_phantom_specimen *s = gsn_phantom_specimen_find(name);
    struct gsn_phantom_sums sums;
    struct gsn_error err = { 0 };

    CHECK(s);
    CHECK_OK(gsn_phantom_truth_sums(gsn_phantom_geometry(), s, 0, &sums, &err), err);
    return sums;
}

/* Mean and variance of a group's four true losses. */
static void group(const char *letter, const struct gsn_phantom_sums *sums, double *ret_mean,
                  double *ret_variance)
{
    double sum = 0, squares = 0;

    for (int i = 1; i <= 4; i++) {
        gsn_auto_mem(char) name = gsn_format("%s%d", letter, i);
        const struct gsn_phantom_specimen *s = gsn_phantom_specimen_find(name);
        const double loss = gsn_phantom_truth_loss(s, sums);

        CHECK(strcmp(s->group, letter) == 0 && s->week == 8);
        sum += loss;
        squares += loss * loss;
    }
    *ret_mean = sum / 4;
    *ret_variance = (squares - sum * sum / 4) / 3;
}

/* Group means of 16.6 and 36.6, of a difference that is 8.9 times its standard error: with the
 * 5.3 degrees of freedom of Welch's test the two-sided p is 0.0002. Controls lie around none. */
TEST(the_groups_lose_what_the_specification_says)
{
    const struct gsn_phantom_sums sums = sums_of("S00");
    double n, s, u, n_variance, s_variance, u_variance, a, b;

    group("N", &sums, &n, &n_variance);
    group("S", &sums, &s, &s_variance);
    group("U", &sums, &u, &u_variance);
    CHECK_NEAR(n, 0, 0.01);
    CHECK_NEAR(s, 16.6, 0.01);
    CHECK_NEAR(u, 36.6, 0.01);
    a = s_variance / 4;
    b = u_variance / 4;
    CHECK_NEAR((u - s) / sqrt(a + b), 8.897, 0.005);
    CHECK_NEAR((a + b) * (a + b) / (a * a / 3 + b * b / 3), 5.344, 0.005);
}

TEST(along_time_the_loss_grows)
{
    static const char *const name[] = { "T2", "T4", "T8" };
    static const double loss[] = { 18, 27, 36.6 };
    const struct gsn_phantom_sums sums = sums_of("S00");

    for (int i = 0; i < 3; i++) {
        const struct gsn_phantom_specimen *s = gsn_phantom_specimen_find(name[i]);

        CHECK(s && s->week == 2 << i);
        CHECK_NEAR(gsn_phantom_truth_loss(s, &sums), loss[i], 0.01);
    }
}

/* What is written into loss.csv comes from the denser bone itself, what study.csv says from the
 * share of bone in the ordinary block: the same integral twice. */
TEST(a_denser_control_is_denser_by_its_bone)
{
    const struct gsn_phantom_specimen *n4 = gsn_phantom_specimen_find("GVP-D-N4");
    const struct gsn_phantom_sums plain = sums_of("S00"), dense = sums_of("N4");
    const struct gsn_lattice part = gsn_phantom_region_lattice(gsn_phantom_geometry());
    gsn_auto(gsn_grid) ordinary = NULL;
    gsn_auto(gsn_grid) denser = NULL;
    gsn_auto(gsn_mask) region = NULL;
    struct gsn_error err = { 0 };
    double before = 0, after = 0;

    CHECK_NEAR(gsn_phantom_truth_loss(n4, &plain), gsn_phantom_truth_loss(n4, &dense), 1e-9);
    CHECK(dense.above[0][2] > plain.above[0][2]);
    CHECK_OK(gsn_phantom_density_grid(gsn_phantom_geometry(), &part, 0, 1, 0, &ordinary, &err),
             err);
    CHECK_OK(
        gsn_phantom_density_grid(gsn_phantom_geometry(), &part, 0, n4->bone_gain, 0, &denser, &err),
        err);
    CHECK_OK(gsn_phantom_region_mask(gsn_phantom_geometry(), &part, &region, &err), err);
    for (size_t i = 0; i < gsn_lattice_count(&part); i++)
        if (region->inside[i]) {
            before += (double)ordinary->value[i];
            after += (double)denser->value[i];
        }
    CHECK_NEAR(100 * (1 - after / before), gsn_phantom_truth_loss(n4, &plain), 0.005);
}

TEST(an_animal_has_36_sections_on_three_panels)
{
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_plan_make("GVP-D-U3", "L2", 1, 0, &plan, &err), err);
    CHECK(plan.sections == 36 && plan.panels == 3 && plan.files == 3);
    CHECK(plan.px_um == 24 && plan.width == 1533 && plan.height == 1040);
    for (size_t i = 0; i < plan.defects; i++)
        CHECK(plan.defect[i].k < 36);
    CHECK_OK(gsn_phantom_plan_make("GVP-D-U3", "L3", 1, 0, &plan, &err), err);
    CHECK(plan.files == 3 && plan.missing_panel > 0 && plan.missing_panel <= 3);
}

TEST(every_specimen_draws_for_itself_unless_only_the_stain_differs)
{
    for (int i = 0; i < GSN_PHANTOM_SPECIMENS; i++)
        for (int j = 0; j < i; j++) {
            const struct gsn_phantom_specimen *a = gsn_phantom_specimen_at(i);
            const struct gsn_phantom_specimen *b = gsn_phantom_specimen_at(j);

            CHECK(strcmp(a->name, b->name) != 0);
            CHECK(a->draws_as != b->draws_as || (a->depth == b->depth && i < 5));
        }
    CHECK(gsn_phantom_specimen_at(-1) == NULL);
    CHECK(gsn_phantom_specimen_at(GSN_PHANTOM_SPECIMENS) == NULL);
}

TEST(a_study_that_cannot_be_written_is_reported)
{
    struct gsn_error err = { 0 };

    CHECK(gsn_phantom_study_make("L0", 1, 48, 0, "/dev/null/study", NULL, &err) == GSN_E_IO);
    CHECK(strstr(err.text, "/dev/null"));
    CHECK(gsn_phantom_study_make("L7", 1, 48, 0, "/dev/null/study", NULL, &err) == GSN_E_NOTFOUND);
}
