/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/correspondence.h"

#include "tests/check.h"

#include <string.h>

static const double PX = 16;
static const struct gsn_point MARK_UM[GSN_FIDUCIALS] = { { -2050, -1000 },
                                                         { 1700, -1500 },
                                                         { -1500, 1300 } };
enum { DECOYS = 4 };
/* In the block's frame, a millimetre and more from every mark. */
static const struct gsn_point DECOY_UM[DECOYS] = {
    { 300, -400 }, { 1200, 900 }, { -300, 600 }, { -600, -1400 }
};

/* What a panel has taught: hardly any spots that look like marks. */
static struct gsn_triangle_prior taught(void)
{
    struct gsn_triangle_prior prior = {
        .learnt = 1, .contrast = 0.4, .radius_um = 75, .stretch_um = 60
    };

    memcpy(prior.mark_um, MARK_UM, sizeof prior.mark_um);
    for (int k = 0; k < GSN_APPEARANCE_CLASSES; k++) {
        prior.alike[k] = k > 0 ? exp(-0.5 * ldexp(1, k - 1)) : 1;
        prior.chance[k] = 0.5e-6 * ldexp(1, k - GSN_APPEARANCE_CLASSES + 1);
    }
    return prior;
}

/* A section mounted at this angle, perhaps face down: panel pixels to um in the block. */
static struct gsn_affine mounted(double angle, int flipped)
{
    const double c = PX * cos(angle), s = PX * sin(angle), m = flipped ? -1 : 1;
    const struct gsn_affine turned = { m * c, -s, 0, m * s, c, 0 };
    const struct gsn_affine centre = { 1, 0, -300, 0, 1, -400 };

    return gsn_affine_compose(&centre, &turned);
}

static void add_spot(struct gsn_fiducial_candidates *section, const struct gsn_affine *to_um,
                     struct gsn_point um)
{
    const struct gsn_affine back = gsn_affine_inverse(to_um);

    section->mark[section->count++] = (struct gsn_fiducial){ .px = gsn_affine_apply(&back, um),
                                                             .radius_px = 75 / PX,
                                                             .contrast = 0.4,
                                                             .score = 0.95,
                                                             .found = 1 };
}

static struct gsn_fiducial_candidates with_decoys(const struct gsn_affine *to_um)
{
    struct gsn_fiducial_candidates section = { .px_um = PX };

    for (int i = 0; i < DECOYS; i++)
        add_spot(&section, to_um, DECOY_UM[i]);
    return section;
}

static int is_at(const struct gsn_fiducial *mark, const struct gsn_affine *to_um,
                 struct gsn_point um)
{
    const struct gsn_point at = gsn_affine_apply(to_um, mark->px);

    return mark->found && hypot(at.x - um.x, at.y - um.y) < 1e-6;
}

/* However few there are, and however the section was mounted. */
TEST(marks_are_named_by_where_their_section_lies)
{
    const struct gsn_triangle_prior prior = taught();

    for (unsigned there = 0; there < 8; there++)
        for (int turn = 0; turn < 24; turn++) {
            const struct gsn_affine to_um = mounted(0.26 * turn, turn % 2);
            struct gsn_fiducial_candidates section = with_decoys(&to_um);
            struct gsn_fiducial marks[GSN_FIDUCIALS] = { 0 };

            for (int i = GSN_FIDUCIALS - 1; i >= 0; i--)
                if (there >> i & 1)
                    add_spot(&section, &to_um,
                             (struct gsn_point){ MARK_UM[i].x + 90, MARK_UM[i].y - 60 });
            gsn_fiducials_match_placed(&section, &prior, &to_um, 40, marks);
            for (int i = 0; i < GSN_FIDUCIALS; i++) {
                CHECK(marks[i].found == (int)(there >> i & 1));
                if (marks[i].found)
                    CHECK(is_at(&marks[i], &to_um,
                                (struct gsn_point){ MARK_UM[i].x + 90, MARK_UM[i].y - 60 }));
            }
        }
}

/* The rougher the place is known, the less a spot near it says; one half a millimetre off, or one
 * that looks like dirt, is none. */
TEST(a_spot_that_may_lie_there_by_chance_is_no_mark)
{
    const struct gsn_triangle_prior prior = taught();
    const struct gsn_affine to_um = mounted(1, 0);

    for (int far = 0; far < 2; far++)
        for (int dirt = 0; dirt < 2; dirt++) {
            struct gsn_fiducial_candidates section = { .px_um = PX };
            struct gsn_fiducial marks[GSN_FIDUCIALS] = { 0 };

            add_spot(&section, &to_um,
                     (struct gsn_point){ MARK_UM[1].x + (far ? 700 : 50), MARK_UM[1].y });
            section.mark[0].contrast *= dirt ? 2.6 : 1;
            gsn_fiducials_match_placed(&section, &prior, &to_um, 40, marks);
            CHECK(marks[1].found == (!far && !dirt));
        }
    {
        struct gsn_fiducial_candidates section = { .px_um = PX };
        struct gsn_fiducial marks[GSN_FIDUCIALS] = { 0 };

        add_spot(&section, &to_um, MARK_UM[1]);
        gsn_fiducials_match_placed(&section, &prior, &to_um, 20000, marks);
        CHECK(!marks[1].found);
    }
}

TEST(of_two_spots_that_are_about_as_likely_neither_is_the_mark)
{
    const struct gsn_triangle_prior prior = taught();
    const struct gsn_affine to_um = mounted(2, 1);

    for (int closer = 0; closer < 2; closer++) {
        struct gsn_fiducial_candidates section = { .px_um = PX };
        struct gsn_fiducial marks[GSN_FIDUCIALS] = { 0 };

        add_spot(&section, &to_um, (struct gsn_point){ MARK_UM[0].x, MARK_UM[0].y + 200 });
        add_spot(&section, &to_um,
                 (struct gsn_point){ MARK_UM[0].x, MARK_UM[0].y - (closer ? 20 : 195) });
        gsn_fiducials_match_placed(&section, &prior, &to_um, 40, marks);
        CHECK(marks[0].found == closer && !marks[1].found && !marks[2].found);
        if (closer)
            CHECK(is_at(&marks[0], &to_um, (struct gsn_point){ MARK_UM[0].x, MARK_UM[0].y - 20 }));
    }
}

/* What was found stays as it is, and no spot is two marks. */
TEST(marks_that_are_known_stay)
{
    const struct gsn_triangle_prior prior = taught();
    const struct gsn_affine to_um = mounted(0.5, 0);
    struct gsn_fiducial_candidates section = { .px_um = PX };
    struct gsn_fiducial marks[GSN_FIDUCIALS] = { 0 };

    add_spot(&section, &to_um, MARK_UM[0]);
    add_spot(&section, &to_um, MARK_UM[1]);
    marks[0] = section.mark[1];
    marks[2] = section.mark[1];
    marks[2].px.x += 30;
    gsn_fiducials_match_placed(&section, &prior, &to_um, 40, marks);
    CHECK(is_at(&marks[0], &to_um, MARK_UM[1]));
    CHECK(!marks[1].found);
    CHECK(marks[2].px.x == section.mark[1].px.x + 30);
}
