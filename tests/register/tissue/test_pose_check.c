/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/tissue/pose_check.h"

#include "tests/check.h"
#include "tests/register/draw.h"
#include "tests/register/tissue/drawn_tissue.h"

#include <string.h>

enum { SECTIONS = 12, SIDE = DRAWN_TISSUE_SIDE };

struct stack {
    struct gsn_tissue_section section[SECTIONS];
    struct gsn_tissue *tissue[SECTIONS];
};

/* Marks put each section to about half a cell. */
static void mount(struct stack *s, unsigned block, double slant)
{
    struct draw_chance chance = { block };

    memset(s, 0, sizeof *s);
    for (unsigned k = 0; k < SECTIONS; k++) {
        const struct gsn_affine mounted =
            drawn_motion(draw_uniform(&chance, 0, 6.28), k % 5 == 3, draw_uniform(&chance, -6, 6),
                         draw_uniform(&chance, -6, 6));
        const struct gsn_affine off =
            drawn_motion(draw_uniform(&chance, -0.01, 0.01), 0, draw_uniform(&chance, -0.8, 0.8),
                         draw_uniform(&chance, -0.8, 0.8));
        const struct gsn_affine back = gsn_affine_inverse(&mounted);

        s->tissue[k] = drawn_section(block, k, &mounted, slant);
        s->section[k] = (struct gsn_tissue_section){ .serial = k,
                                                     .tissue = s->tissue[k],
                                                     .marked = 1,
                                                     .to_block = gsn_affine_compose(&back, &off) };
        s->section[k].covariance[0][0] = s->section[k].covariance[1][1] = 0.5 * 0.5;
        s->section[k].covariance[2][2] = 0.006 * 0.006;
    }
}

static void unmount(struct stack *s)
{
    for (unsigned k = 0; k < SECTIONS; k++)
        gsn_tissue_free(s->tissue[k]);
}

static void check(const struct stack *s, struct gsn_tissue_finding findings[SECTIONS])
{
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_tissue_check(s->section, SECTIONS, findings, &err), err);
}

/* With section k registered so, it and no other is contradicted. */
static void check_told(struct stack *s, unsigned k, const struct gsn_affine *moved, int other_face)
{
    const struct gsn_affine right = s->section[k].to_block;
    struct gsn_tissue_finding findings[SECTIONS];

    s->section[k].to_block = gsn_affine_compose(&right, moved);
    check(s, findings);
    s->section[k].to_block = right;
    for (unsigned i = 0; i < SECTIONS; i++)
        if (findings[i].contradicted != (i == k))
            fail_msg("section %u moved: section %u is %scontradicted (%.1f apart, limit %.1f)", k,
                     i, findings[i].contradicted ? "" : "not ", findings[i].apart,
                     findings[i].limit);
    CHECK(findings[k].other_face == other_face);
}

TEST(sections_that_their_marks_lay_right_are_not_contradicted)
{
    for (unsigned block = 1; block <= 6; block++) {
        struct gsn_tissue_finding findings[SECTIONS];
        struct stack s;

        mount(&s, block, block % 2 ? 0 : 0.3);
        check(&s, findings);
        for (unsigned k = 0; k < SECTIONS; k++) {
            const unsigned inner = k >= 2 && k + 2 < SECTIONS;

            CHECK(!findings[k].contradicted && findings[k].apart < findings[k].limit);
            CHECK(findings[k].compared == (inner ? 4 : k == 1 || k + 2 == SECTIONS ? 3 : 2));
        }
        unmount(&s);
    }
}

TEST(a_section_on_the_wrong_face_is_contradicted_wherever_it_lies)
{
    struct stack s;

    mount(&s, 9, 0);
    for (unsigned k = 0; k < SECTIONS; k++) {
        const struct gsn_affine moved = drawn_motion(0.5 + k, 1, 3, -2);

        check_told(&s, k, &moved, 1);
    }
    unmount(&s);
}

TEST(a_section_turned_by_half_is_contradicted)
{
    const struct gsn_affine moved = drawn_motion(3.1416, 0, 2, 2);
    struct stack s;

    mount(&s, 7, 0);
    check_told(&s, 0, &moved, 0);
    check_told(&s, 5, &moved, 0);
    unmount(&s);
}

/* What is far beyond the limit is told, what is far within it is not; nothing but the stack itself
 * says how far that is. */
TEST(a_section_laid_aside_is_contradicted_beyond_the_limit)
{
    struct gsn_tissue_finding findings[SECTIONS];
    struct stack s;

    mount(&s, 4, 0);
    check(&s, findings);
    for (unsigned k = 3; k < 9; k++) {
        const double far = 2 * findings[k].limit, near = 0.3 * findings[k].limit;
        const struct gsn_affine aside = { 1, 0, 0.8 * far, 0, 1, -0.6 * far };
        const struct gsn_affine right = s.section[k].to_block;
        const struct gsn_affine little = { 1, 0, near, 0, 1, 0 };
        struct gsn_tissue_finding again[SECTIONS];

        check_told(&s, k, &aside, 0);
        s.section[k].to_block = gsn_affine_compose(&right, &little);
        check(&s, again);
        s.section[k].to_block = right;
        CHECK(!again[k].contradicted);
    }
    unmount(&s);
}

/* A round section with grain of its own. */
static struct gsn_tissue *disc(struct draw_chance *chance)
{
    gsn_auto(gsn_plane) plane = NULL;
    struct gsn_tissue *tissue = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_plane_new(SIDE, SIDE, &plane, &err), err);
    for (int i = 0; i < SIDE * SIDE; i++) {
        const double r = hypot(i % SIDE + 0.5 - SIDE / 2.0, i / SIDE + 0.5 - SIDE / 2.0);

        plane->value[i] = (float)(fmin(fmax(70 - r, 0), 1) * (1 + draw_uniform(chance, -0.3, 0.3)));
    }
    CHECK_OK(gsn_tissue_new(plane, 1, &tissue, &err), err);
    return tissue;
}

/* An outline alone that is registered as well any way round. */
TEST(tissue_that_looks_the_same_any_way_round_contradicts_nothing)
{
    struct gsn_tissue_finding findings[SECTIONS];
    struct draw_chance chance = { 12 };
    struct stack s = { 0 };

    for (unsigned k = 0; k < SECTIONS; k++) {
        s.tissue[k] = disc(&chance);
        s.section[k] = (struct gsn_tissue_section){
            .serial = k,
            .tissue = s.tissue[k],
            .marked = 1,
            .to_block = drawn_motion(draw_uniform(&chance, 0, 6.28), k % 4 == 1,
                                     draw_uniform(&chance, -1, 1), draw_uniform(&chance, -1, 1))
        };
    }
    check(&s, findings);
    for (unsigned k = 0; k < SECTIONS; k++)
        CHECK(findings[k].compared > 0 && !findings[k].contradicted);
    unmount(&s);
}

/* Five sections show nothing usual; a section beyond four serial numbers is no neighbour. */
TEST(where_too_little_can_be_compared_nothing_is_told)
{
    const struct gsn_affine moved = drawn_motion(2, 1, 0, 0);
    struct gsn_tissue_finding findings[SECTIONS];
    struct stack s;

    mount(&s, 3, 0);
    s.section[2].to_block = gsn_affine_compose(&s.section[2].to_block, &moved);
    for (unsigned k = 5; k < SECTIONS; k++)
        s.section[k].marked = 0;
    check(&s, findings);
    for (unsigned k = 0; k < SECTIONS; k++)
        CHECK(findings[k].compared == 0 && !findings[k].contradicted);
    for (unsigned k = 5; k < SECTIONS; k++)
        s.section[k].marked = 1;
    for (unsigned k = 0; k < SECTIONS; k++)
        s.section[k].serial = k < 3 ? 5 * k : 20 + k;
    check(&s, findings);
    CHECK(findings[2].compared == 0 && findings[3].compared == 2);
    unmount(&s);
}

TEST(numbers_that_do_not_rise_are_refused)
{
    struct gsn_tissue_section section[2] = { { .serial = 4 }, { .serial = 4 } };
    struct gsn_tissue_finding findings[2] = { { .compared = 77 } };
    struct gsn_error err = { 0 };

    CHECK(gsn_tissue_check(section, 2, findings, &err) == GSN_E_INPUT);
    CHECK(strcmp(err.text, "section 5 comes after section 5: serial numbers must rise") == 0);
    CHECK(findings[0].compared == 77);
}

static int check_once(const struct stack *s, struct gsn_error *err)
{
    struct gsn_tissue_finding findings[SECTIONS];

    return gsn_tissue_check(s->section, 7, findings, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    const struct gsn_affine moved = drawn_motion(2, 1, 0, 0);
    struct gsn_error err = { 0 };
    struct stack s;

    mount(&s, 5, 0);
    s.section[3].to_block = gsn_affine_compose(&s.section[3].to_block, &moved);
    CHECK_EVERY_OOM(check_once(&s, &err), err);
    unmount(&s);
}
