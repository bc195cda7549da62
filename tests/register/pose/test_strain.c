/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose/strain.h"

#include "tests/check.h"
#include "tests/register/mounted.h"

/* PHANTOM.md level 2: size sd .008 common and .004 for each axis; the marks follow the tissue's own
 * warp of 10 um rms, 7 um per axis. */
static const struct mounted_world LEVEL2 = { .marks = mounted_marks,
                                             .angle = 0.4,
                                             .flips = 0.03,
                                             .burn_um = 7,
                                             .strain_sd = { 0.0085, 0.0028, 0 } };
static const struct gsn_point TARGET = { 411, 646 };

static double off(const struct gsn_affine *map, const struct mounted *m, struct gsn_point um)
{
    const struct gsn_point p = gsn_affine_apply(map, mounted_px(m, um));

    return hypot(p.x - um.x, p.y - um.y);
}

struct outcome {
    double rigid, corrected, predicted; /* rms, um */
    double covered;
};

static struct outcome outcome_with(const struct mounted_world *world,
                                   const struct gsn_pose_options *options, size_t trials,
                                   uint64_t seed)
{
    struct draw_chance chance = { seed };
    struct mounted_stack s = mounted_new(60);
    struct outcome o = { 0 };
    size_t count = 0;

    while (count < trials) {
        struct gsn_affine mean = { 1, 0, 0, 0, 1, 0 };

        mounted_draw(&s, world, &chance);
        mounted_solve(&s, options);
        if (options->sizes && s.summary.stretches)
            mean = gsn_strain_of_mean(s.summary.mean_triangle, options->markers_um);
        for (size_t i = 0; i < s.count; i++) {
            const struct gsn_affine own = gsn_strain_corrected(&s.pose[i]);
            const struct gsn_affine corrected = gsn_affine_compose(&own, &mean);
            const struct gsn_cov2 c = gsn_pose_tre_at(&s.pose[i].error, TARGET, 1);
            const struct gsn_point e =
                gsn_affine_apply(&corrected, mounted_px(&s.mounting[i], TARGET));
            const double x = e.x - TARGET.x, y = e.y - TARGET.y;
            const double k = gsn_pose_ellipse(s.pose[i].error.freedom, 0.95);

            if (s.pose[i].gross)
                continue;
            o.rigid += pow(off(&s.pose[i].panel_to_block_um, &s.mounting[i], TARGET), 2);
            o.corrected += x * x + y * y;
            o.predicted += c.xx + c.yy;
            o.covered += (c.yy * x * x - 2 * c.xy * x * y + c.xx * y * y) <=
                         k * k * (c.xx * c.yy - c.xy * c.xy);
            count++;
        }
    }
    mounted_done(&s);
    return (struct outcome){ sqrt(o.rigid / (double)count), sqrt(o.corrected / (double)count),
                             sqrt(o.predicted / (double)count), o.covered / (double)count };
}

static struct outcome outcome_of(const struct mounted_world *world, size_t trials, uint64_t seed)
{
    return outcome_with(world, &mounted_declared, trials, seed);
}

TEST(undoing_strain_halves_the_error_and_the_prediction_knows)
{
    const struct outcome o = outcome_of(&LEVEL2, mounted_trials(6000), 1);

    print_message("  at the region: rigid %.1f um, corrected %.1f um, predicted %.1f um, ellipse "
                  "holds %.1f %%\n",
                  o.rigid, o.corrected, o.predicted, 100 * o.covered);
    CHECK(o.rigid > 14 && o.rigid < 20);
    CHECK(o.corrected < 0.7 * o.rigid && o.corrected < 10);
    CHECK_NEAR(o.predicted, o.corrected, 0.08 * o.corrected);
    CHECK(o.covered > 0.93 && o.covered < 0.97);
}

/* As `gieson register` lays them: marks to a third of a micrometre, sizes by up to 5 %. */
TEST(sections_that_differ_in_size_are_laid_with_their_size)
{
    static const double sizes[] = { 0, 0.005, 0.02, 0.05 };
    const struct gsn_pose_options options = { .markers_um = mounted_marks, .sizes = 1 };

    for (size_t k = 0; k < 2 * (sizeof sizes / sizeof *sizes); k++) {
        const int erratic = k % 2 == 1;
        const struct mounted_world world = { .marks = mounted_marks,
                                             .angle = 3,
                                             .flips = 0.1,
                                             .burn_um = erratic ? 0 : 3,
                                             .fit_um = 2,
                                             .erratic = erratic ? 0.4 : 0,
                                             .strain_sd = { sizes[k / 2], 0, 0 } };
        const struct outcome o = outcome_with(&world, &options, mounted_trials(6000), 11 + k);

        print_message("  sizes by %.1f %%%s: rigid %.2f um, with their size %.2f, predicted %.2f, "
                      "ellipse holds %.1f %%\n",
                      100 * sizes[k / 2], erratic ? ", fits whose word is chance" : "", o.rigid,
                      o.corrected, o.predicted, 100 * o.covered);
        CHECK(o.covered > 0.93 && o.covered < 0.97);
        CHECK_NEAR(o.predicted, o.corrected, 0.08 * o.corrected);
    }
}

TEST(where_nothing_stretches_nothing_is_corrected)
{
    struct draw_chance chance = { 2 };
    struct mounted_world world = LEVEL2;
    struct mounted_stack s = mounted_new(60);

    world.strain_sd[0] = world.strain_sd[1] = 0;
    mounted_draw(&s, &world, &chance);
    mounted_solve(&s, &mounted_declared);
    CHECK(!s.summary.stretches && !s.summary.as_declared);
    for (size_t i = 0; i < s.count; i++) {
        const struct gsn_affine map = gsn_strain_corrected(&s.pose[i]);

        CHECK(s.pose[i].strain[0] == 0 && s.pose[i].strain[1] == 0 && s.pose[i].strain[2] == 0);
        CHECK_NEAR(fabs(gsn_affine_det(&map)), MOUNTED_PX * MOUNTED_PX, 1e-8);
    }
    mounted_done(&s);
}

/* What the sections of a stack are off by in the mean, by their own strain alone and with the mean
 * triangle's strain undone as well: root mean square over stacks. */
struct in_mean {
    double alone, as_declared, agreed;
};

static struct in_mean mean_errors(const struct gsn_pose_options *options, size_t stacks)
{
    struct draw_chance chance = { 4 };
    struct mounted_stack s = mounted_new(60);
    struct in_mean mean = { 0 };

    for (size_t k = 0; k < stacks; k++) {
        struct gsn_point sum = { 0 };
        struct gsn_affine map;

        mounted_draw(&s, &LEVEL2, &chance);
        mounted_solve(&s, options);
        for (size_t i = 0; i < s.count; i++) {
            const struct gsn_affine corrected = gsn_strain_corrected(&s.pose[i]);
            const struct gsn_point p =
                gsn_affine_apply(&corrected, mounted_px(&s.mounting[i], TARGET));

            sum.x += p.x / (double)s.count;
            sum.y += p.y / (double)s.count;
        }
        mean.agreed += s.summary.as_declared / (double)stacks;
        mean.alone += (pow(sum.x - TARGET.x, 2) + pow(sum.y - TARGET.y, 2)) / (double)stacks;
        map = gsn_strain_of_mean(s.summary.mean_triangle, options->markers_um);
        sum = gsn_affine_apply(&map, sum);
        mean.as_declared += (pow(sum.x - TARGET.x, 2) + pow(sum.y - TARGET.y, 2)) / (double)stacks;
    }
    mounted_done(&s);
    return (struct in_mean){ sqrt(mean.alone), sqrt(mean.as_declared), mean.agreed };
}

/* The share of a mark's shift that the target goes along with, when a triangle is laid on another.
 */
static void shares_of(struct gsn_point target, double ret_share[GSN_FIDUCIALS])
{
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_point *a = &mounted_marks[(i + 1) % GSN_FIDUCIALS];
        const struct gsn_point *b = &mounted_marks[(i + 2) % GSN_FIDUCIALS], *c = &mounted_marks[i];

        ret_share[i] = ((b->x - a->x) * (target.y - a->y) - (b->y - a->y) * (target.x - a->x)) /
                       ((b->x - a->x) * (c->y - a->y) - (b->y - a->y) * (c->x - a->x));
    }
}

/* Nothing of the sections' strain is left, only what the marks of sixty sections err by. */
TEST(what_sections_stretch_by_in_the_mean_is_undone_on_the_declared_marks)
{
    const struct in_mean mean = mean_errors(&mounted_declared, mounted_trials(200));
    double share[GSN_FIDUCIALS], left = 0;

    shares_of(TARGET, share);
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        left += 2 * pow(LEVEL2.burn_um * share[i], 2) / 60;
    print_message("  in the mean %.2f um, on the declared marks %.2f (%.2f by the marks alone); "
                  "agreed %.3f\n",
                  mean.alone, mean.as_declared, sqrt(left), mean.agreed);
    CHECK_NEAR(mean.as_declared, sqrt(left), 0.12 * sqrt(left));
    CHECK(mean.alone > 1.3 * mean.as_declared);
    CHECK(mean.agreed > 0.98);
}

TEST(declared_marks_that_chance_does_not_explain_are_not_taken)
{
    struct gsn_point wider[GSN_FIDUCIALS];
    const struct gsn_pose_options options = { .markers_um = wider };

    for (int i = 0; i < GSN_FIDUCIALS; i++)
        wider[i] = (struct gsn_point){ 1.01 * mounted_marks[i].x, 1.01 * mounted_marks[i].y };
    CHECK(mean_errors(&options, 20).agreed == 0);
}

TEST(the_mean_triangle_goes_exactly_onto_the_declared_one)
{
    const struct gsn_point mean[GSN_FIDUCIALS] = { { -2040, -1003 },
                                                   { 1711, -1490 },
                                                   { -1502, 1295 } };
    const struct gsn_affine map = gsn_strain_of_mean(mean, mounted_marks);

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_point p = gsn_affine_apply(&map, mean[i]);

        CHECK_NEAR(p.x, mounted_marks[i].x, 1e-9);
        CHECK_NEAR(p.y, mounted_marks[i].y, 1e-9);
    }
}

/* Case 47. Whatever the strain, the pose's own determinant is that of the pixel size. */
TEST(a_section_compressed_along_the_knife_shows_it_and_keeps_a_rigid_pose)
{
    struct draw_chance chance = { 3 };
    struct mounted_stack s = mounted_new(60);

    mounted_draw(&s, &LEVEL2, &chance);
    for (size_t i = 20; i < 23; i++) {
        const double angle = 0.5, by = -0.015;

        s.mounting[i].strain[0] = by / 2;
        s.mounting[i].strain[1] = by / 2 * cos(2 * angle);
        s.mounting[i].strain[2] = by / 2 * sin(2 * angle);
        for (int k = 0; k < GSN_FIDUCIALS; k++)
            s.input[i].marks[k].px = mounted_px(&s.mounting[i], mounted_marks[k]);
    }
    mounted_solve(&s, &mounted_declared);
    CHECK(s.summary.stretches);
    print_message("  sd of strain: common %.4f, x against y %.4f, shear %.4f\n",
                  s.summary.strain_sd[0], s.summary.strain_sd[1], s.summary.strain_sd[2]);
    CHECK_NEAR(s.summary.strain_sd[0], 0.0085, 0.003);
    CHECK_NEAR(s.summary.strain_sd[1], 0.0028, 0.0015);
    for (size_t i = 20; i < 23; i++) {
        const struct gsn_strain_axes a = gsn_strain_principal(s.pose[i].strain);

        CHECK_NEAR(fabs(gsn_affine_det(&s.pose[i].panel_to_block_um)), MOUNTED_PX * MOUNTED_PX,
                   1e-9);
        CHECK(a.least < -0.005 && a.most > a.least);
    }
    mounted_done(&s);
}

TEST(principal_directions_are_those_of_the_tensor)
{
    const double angle = 0.3, most = 0.02, least = -0.01;
    const double strain[3] = { 0.5 * (most + least), 0.5 * (most - least) * cos(2 * angle),
                               0.5 * (most - least) * sin(2 * angle) };
    const struct gsn_strain_axes a = gsn_strain_principal(strain);

    CHECK_NEAR(a.most, most, 1e-15);
    CHECK_NEAR(a.least, least, 1e-15);
    CHECK_NEAR(a.angle, angle, 1e-12);
}

TEST(the_strain_between_two_triangles_is_what_was_put_in)
{
    const struct mounted m = { .angle = 1.1,
                               .strain = { 0.004, -0.002, 0.003 },
                               .about = { -1850.0 / 3, -400 } };
    struct gsn_point to[GSN_FIDUCIALS];
    double strain[3];

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        to[i] = mounted_px(&m, mounted_marks[i]);
        to[i].x *= MOUNTED_PX;
        to[i].y *= MOUNTED_PX;
    }
    gsn_strain_between(mounted_marks, to, strain);
    for (int i = 0; i < 3; i++)
        CHECK_NEAR(strain[i], m.strain[i], 2e-5);
}

/* The scan is longer along x: marks are measured in it, whatever the section's turn. */
static struct gsn_strain_common scanned(double longer, double angle, int declared, uint64_t seed)
{
    struct draw_chance chance = { seed };
    struct mounted_world world = LEVEL2;
    struct mounted_stack s = mounted_new(60);
    struct gsn_strain_common common;

    world.angle = angle;
    mounted_draw(&s, &world, &chance);
    for (size_t i = 0; i < s.count; i++)
        for (int k = 0; k < GSN_FIDUCIALS; k++) {
            s.input[i].marks[k].px.x *= 1 + longer / 2;
            s.input[i].marks[k].px.y *= 1 - longer / 2;
        }
    mounted_solve(&s, declared ? &mounted_declared : &(struct gsn_pose_options){ 0 });
    common = gsn_strain_of_panel(s.input, s.pose, s.count, declared ? mounted_marks : NULL,
                                 s.summary.mean_triangle);
    mounted_done(&s);
    return common;
}

/* Case 15. */
TEST(pixels_that_are_not_square_are_told_from_tissue)
{
    struct gsn_strain_common c = scanned(0.012, M_PI, 1, 4);

    print_message("  turned sections: %.4f +- %.4f\n", c.along_x, c.sd);
    CHECK(c.anisotropic && !c.from_declared);
    CHECK_NEAR(c.along_x, 0.012, 4 * c.sd);
    c = scanned(0.012, M_PI, 0, 5);
    CHECK(c.anisotropic);
    CHECK_NEAR(c.along_x, 0.012, 4 * c.sd);
    c = scanned(0.012, 0.01, 1, 6);
    print_message("  sections that are not turned: %.4f +- %.4f\n", c.along_x, c.sd);
    CHECK(c.anisotropic && c.from_declared);
    CHECK_NEAR(c.along_x, 0.012, 4 * c.sd);
    CHECK(!scanned(0.012, 0.01, 0, 7).anisotropic);
    for (uint64_t seed = 8; seed < 40; seed++)
        CHECK(!scanned(0, M_PI, 1, seed).anisotropic);
}
