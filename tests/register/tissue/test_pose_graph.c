/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/tissue/pose_graph.h"

#include "tests/check.h"
#include "tests/register/draw.h"
#include "tests/register/tissue/drawn_tissue.h"

#include <math.h>
#include <string.h>

enum { SECTIONS = 14 };

struct stack {
    struct gsn_tissue_section section[SECTIONS];
    struct gsn_affine mounted[SECTIONS]; /* block to section */
    struct gsn_tissue *tissue[SECTIONS];
};

static void mount(struct stack *s, uint64_t seed, double slant)
{
    struct draw_chance chance = { seed };

    memset(s, 0, sizeof *s);
    for (unsigned k = 0; k < SECTIONS; k++) {
        s->mounted[k] = drawn_motion(draw_uniform(&chance, 0, 6.28), k % 5 == 3,
                                     draw_uniform(&chance, -6, 6), draw_uniform(&chance, -6, 6));
        s->tissue[k] = drawn_section(9, k, &s->mounted[k], slant);
        s->section[k] = (struct gsn_tissue_section){ .serial = k, .tissue = s->tissue[k] };
    }
}

static void unmount(struct stack *s)
{
    for (unsigned k = 0; k < SECTIONS; k++)
        gsn_tissue_free(s->tissue[k]);
}

/* Holds a section where it is, to a twentieth of a cell. */
static void mark(struct stack *s, unsigned k)
{
    s->section[k].marked = 1;
    s->section[k].to_block = gsn_affine_inverse(&s->mounted[k]);
    s->section[k].covariance[0][0] = s->section[k].covariance[1][1] = 0.05 * 0.05;
    s->section[k].covariance[2][2] = 0.001 * 0.001;
}

static void lay(const struct stack *s, struct gsn_tissue_pose *poses,
                struct gsn_tissue_summary *summary)
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_register(s->section, SECTIONS, GSN_TISSUE_MIDDLE, poses, summary, &err),
             err);
}

static double off(const struct stack *s, unsigned k, const struct gsn_tissue_pose *pose)
{
    const struct gsn_affine truth = gsn_affine_inverse(&s->mounted[k]);
    const struct gsn_affine onto_section = s->mounted[k];
    const struct gsn_affine round = gsn_affine_compose(&onto_section, &pose->to_block);
    const struct gsn_affine still = gsn_affine_compose(&onto_section, &truth);

    return drawn_apart(&round, &still);
}

/* Case 21, with neighbours that have marks: the section lies between them. */
TEST(a_section_without_marks_is_laid_by_its_neighbours)
{
    struct gsn_tissue_pose poses[SECTIONS];
    struct gsn_tissue_summary summary;
    struct stack s;

    mount(&s, 1, 0);
    for (unsigned k = 0; k < SECTIONS; k++)
        if (k != 4 && k != 8 && k != 9)
            mark(&s, k);
    lay(&s, poses, &summary);
    CHECK(summary.held == SECTIONS - 3 && summary.laid == SECTIONS);
    for (unsigned k = 0; k < SECTIONS; k++) {
        CHECK(poses[k].laid && off(&s, k, &poses[k]) < 0.4);
        CHECK(poses[k].from == (k == 4 || k == 8 || k == 9));
        CHECK_NEAR(fabs(gsn_affine_det(&poses[k].to_block)), 1, 1e-9);
    }
    CHECK(poses[4].error > poses[3].error);
    unmount(&s);
}

/* No marks at all: each lies on its neighbours, and what adds up is predicted. */
TEST(a_stack_without_marks_drifts_no_more_than_it_says)
{
    struct gsn_tissue_pose poses[SECTIONS];
    struct gsn_tissue_summary summary;
    double ratio = 0;
    struct stack s;

    mount(&s, 2, 0);
    lay(&s, poses, &summary);
    CHECK(summary.held == 0 && summary.laid == SECTIONS);
    CHECK(poses[summary.reference].from == 0 && poses[summary.reference].error < 0.01);
    for (unsigned k = 0; k < SECTIONS; k++) {
        const struct gsn_affine truth_back = gsn_affine_inverse(&s.mounted[summary.reference]);
        const struct gsn_affine in_frame = gsn_affine_compose(&s.mounted[k], &poses[k].to_block);
        const struct gsn_affine in_block = gsn_affine_compose(&in_frame, &truth_back);
        const struct gsn_affine still = { 1, 0, 0, 0, 1, 0 };
        const double error = drawn_apart(&in_block, &still);

        if (k != summary.reference)
            ratio += error / poses[k].error / (SECTIONS - 1);
        CHECK(error < 1.5);
    }
    print_message("  error over prediction %.2f; comparisons to %.3f cells, drift %.3f\n", ratio,
                  summary.usual, summary.drift);
    CHECK(ratio > 0.05 && ratio < 2);
    CHECK(poses[0].error > poses[summary.reference - 1].error);
    unmount(&s);
}

/* Case 29: a section that is not there leaves its neighbours joined over it. */
TEST(a_lost_section_does_not_break_the_stack)
{
    struct gsn_tissue_pose poses[SECTIONS];
    struct gsn_tissue_summary summary;
    struct stack s;

    mount(&s, 3, 0);
    s.section[6].tissue = NULL;
    mark(&s, 0);
    mark(&s, 13);
    lay(&s, poses, &summary);
    CHECK(!poses[6].laid && summary.laid == SECTIONS - 1);
    CHECK(off(&s, 5, &poses[5]) < 0.6 && off(&s, 7, &poses[7]) < 0.6);
    unmount(&s);
}

TEST(marks_that_contradict_the_tissue_are_told)
{
    struct gsn_tissue_pose poses[SECTIONS];
    struct gsn_tissue_summary summary;
    struct gsn_affine aside = { 1, 0, 3, 0, 1, 0 };
    struct stack s;
    double others = 0;

    mount(&s, 4, 0);
    for (unsigned k = 0; k < SECTIONS; k++)
        mark(&s, k);
    s.section[7].to_block = gsn_affine_compose(&s.section[7].to_block, &aside);
    lay(&s, poses, &summary);
    for (unsigned k = 0; k < SECTIONS; k++)
        if (k < 4 || k > 10)
            others = fmax(others, poses[k].disagrees);
    print_message("  it disagrees by %.1f, others by %.1f at most\n", poses[7].disagrees, others);
    CHECK(poses[7].disagrees > 3.3 && others < 3.3);
    unmount(&s);
}

/* One neighbour lies face down and does not know it: what it says is against five others. */
TEST(a_section_is_not_laid_on_the_face_that_one_neighbour_has_wrong)
{
    struct gsn_tissue_pose poses[SECTIONS];
    struct gsn_tissue_summary summary;

    for (int wrong = 0; wrong < 2; wrong++) {
        const struct gsn_affine turned_over = { -1, 0, 0, 0, 1, 0 };
        struct stack s;

        mount(&s, 1, 0);
        for (unsigned k = 0; k < SECTIONS; k++)
            if (k != 6)
                mark(&s, k);
        if (wrong)
            s.section[5].to_block = gsn_affine_compose(&s.section[5].to_block, &turned_over);
        lay(&s, poses, &summary);
        CHECK(poses[6].laid && !poses[6].unsure && off(&s, 6, &poses[6]) < 0.4);
        unmount(&s);
    }
}

/* Grain on a disc lies as well at any rotation: what is registered is not taken for sure. */
TEST(round_sections_that_share_nothing_are_unsure)
{
    struct gsn_tissue_pose poses[SECTIONS];
    struct draw_chance chance = { 5 };
    struct gsn_tissue_summary summary;
    struct stack s;
    size_t sure = 0;

    mount(&s, 5, 0);
    for (unsigned k = 0; k < SECTIONS; k++) {
        gsn_auto(gsn_plane) plane = drawn_tissue(1, k, &s.mounted[k], 0);
        const double x = draw_uniform(&chance, 95, 105), y = draw_uniform(&chance, 95, 105);
        struct gsn_error err = { 0 };

        for (int i = 0; i < DRAWN_TISSUE_SIDE * DRAWN_TISSUE_SIDE; i++) {
            const double r = hypot(i % DRAWN_TISSUE_SIDE - x, i / DRAWN_TISSUE_SIDE - y);

            plane->value[i] = (float)(fmin(fmax(75 - r, 0), 1) * draw_uniform(&chance, 0.3, 0.9));
        }
        gsn_tissue_free(s.tissue[k]);
        s.tissue[k] = NULL;
        CHECK_OK(gsn_tissue_new(plane, 1, &s.tissue[k], &err), err);
        s.section[k].tissue = s.tissue[k];
    }
    lay(&s, poses, &summary);
    for (unsigned k = 0; k < SECTIONS; k++)
        sure += poses[k].laid && !poses[k].unsure;
    CHECK(sure == 1 && !poses[summary.reference].unsure);
    unmount(&s);
}

TEST(numbers_that_do_not_rise_are_refused)
{
    struct gsn_tissue_section section[2] = { { .serial = 4 }, { .serial = 4 } };
    struct gsn_tissue_pose poses[2] = { { .from = 77 } };
    struct gsn_tissue_summary summary = { .laid = 77 };
    struct gsn_error err = { 0 };

    CHECK(gsn_tissue_register(section, 2, GSN_TISSUE_MIDDLE, poses, &summary, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "section 5 comes after section 5: serial numbers must rise") == 0);
    CHECK(poses[0].from == 77 && summary.laid == 77);
}

static int lay_once(const struct stack *s, struct gsn_error *err)
{
    struct gsn_tissue_pose poses[SECTIONS];
    struct gsn_tissue_summary summary;

    return gsn_tissue_register(s->section, 3, GSN_TISSUE_MIDDLE, poses, &summary, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    struct stack s;

    mount(&s, 5, 0);
    CHECK_EVERY_OOM(lay_once(&s, &err), err);
    unmount(&s);
}
