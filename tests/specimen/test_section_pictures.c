/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/specimen/section_pictures.h"

#include "pipeline/specimen/reconstruction.h"

#include "tests/check.h"
#include "tests/specimen/drawn_specimen.h"

#include <math.h>
#include <string.h>

/* Panel 2, slot 2: its second mark was not burnt. */
enum { DOUBTFUL = 5 };

static void draw(struct drawn_specimen *d)
{
    struct drawn_panel panels[3];

    for (unsigned i = 0; i < 3; i++)
        panels[i] = drawn_panel_of(i + 1, 24, 0.6);
    panels[1].section[1].no_marks = 2;
    drawn_specimen_init(d, DRAWN_JOB, panels, 3);
}

static struct gsn_reconstruction *assembled(const struct drawn_specimen *d)
{
    const struct gsn_specimen_options options = { .mesher = GSN_MESHER, .threads = 1 };
    struct gsn_reconstruction *a = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_reconstruct(&d->specimen, &options, &a, &err), err);
    return a;
}

static struct gsn_scan *opened(const struct drawn_specimen *d, size_t panel)
{
    struct gsn_scan *scan = NULL;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_scan_open(NULL, gsn_check_fd(d->png[panel], d->input[panel].size), d->protocol,
                           &d->panel[panel].upright, &scan, &err),
             err);
    return scan;
}

/* Whether the picture shows the tissue's ellipse where it is in the block: its share of cells that
 * are as they should be. */
static double right_share(const struct gsn_image *image, double um_per_px, double corner_um)
{
    size_t right = 0;

    for (uint32_t y = 0; y < image->height; y++)
        for (uint32_t x = 0; x < image->width; x++) {
            const double u = corner_um + (x + 0.5) * um_per_px;
            const double v = corner_um + (y + 0.5) * um_per_px;
            const int tissue = hypot(u / DRAWN_WIDTH_UM, v / DRAWN_HEIGHT_UM) < 1;

            right += (gsn_image_at(image, x, y, 1) < 200) == tissue;
        }
    return (double)right / ((double)image->width * image->height);
}

TEST(a_section_is_shown_where_its_pose_lays_it_and_elsewhere_where_another_does)
{
    drawn_auto d;
    struct gsn_image *image = NULL;
    struct gsn_error err = { 0 };

    draw(&d);
    gsn_auto(gsn_reconstruction) a = assembled(&d);
    gsn_auto(gsn_scan) scan = opened(&d, 1);
    const struct gsn_section *s = &a->poses.section[DOUBTFUL];

    CHECK(s->state == GSN_SECTION_DOUBTFUL && s->candidates.count >= 2);
    for (size_t c = 0; c < s->candidates.count; c++) {
        const struct gsn_placed_box box = { s->candidates.at[c].panel_to_block_um, s->seen.x,
                                            s->seen.y, s->seen.width, s->seen.height };
        double share;

        CHECK_OK(gsn_placed_picture(scan->picture->image, scan->glass.light, &box,
                                    (struct gsn_point){ -1200, -1200 }, 20, 120, &image, &err),
                 err);
        share = right_share(image, 20, -1200);
        gsn_image_free(image);
        CHECK(c == 0 ? share > 0.97 : share < 0.95);
    }
}

/* Only what is doubtful is drawn, over the section beside it. */
TEST(a_doubtful_section_has_a_picture_for_each_candidate_and_others_have_none)
{
    drawn_auto d;

    draw(&d);
    gsn_auto(gsn_reconstruction) a = assembled(&d);

    for (size_t i = 0; i < a->poses.section_count; i++) {
        const struct gsn_section *s = &a->poses.section[i];
        const struct gsn_section_density *shown = &a->densities.section[i];

        CHECK((s->candidates.count > 0) == (i == DOUBTFUL));
        for (size_t c = 0; c < GSN_CANDIDATES; c++)
            CHECK((shown->candidate_picture[c].size > 0) == (c < s->candidates.count));
        CHECK(shown->compared_with == (i == DOUBTFUL ? DOUBTFUL : 0)); /* serial 4, from 1 */
    }
}

TEST(a_specimen_without_doubt_has_no_sheet)
{
    struct gsn_candidate_sheet *sheet = NULL;
    struct gsn_error err = { 0 };
    drawn_auto d;

    drawn_specimen_even(&d, DRAWN_JOB, 0.6);
    gsn_auto(gsn_reconstruction) a = assembled(&d);

    CHECK_OK(gsn_candidate_sheet_new(&a->poses, &sheet, &err), err);
    CHECK(sheet == NULL);
    CHECK_OK(gsn_candidate_sheet_look(sheet, &a->poses, NULL, 1, &err), err);
    CHECK_OK(gsn_candidate_sheet_draw(sheet, &a->poses, &a->densities, &err), err);
}

static int draw_once(struct gsn_reconstruction *a, const struct gsn_scan *scan,
                     struct gsn_error *err)
{
    gsn_auto(gsn_candidate_sheet) sheet = NULL;
    struct gsn_section_density *s = &a->densities.section[DOUBTFUL];
    int r;

    for (size_t c = 0; c < GSN_CANDIDATES; c++) {
        gsn_free(s->candidate_picture[c].png);
        s->candidate_picture[c] = (struct gsn_png_picture){ .png = NULL };
    }
    r = gsn_candidate_sheet_new(&a->poses, &sheet, err);
    if (r >= 0)
        r = gsn_candidate_sheet_look(sheet, &a->poses, scan, 2, err);
    return r < 0 ? r : gsn_candidate_sheet_draw(sheet, &a->poses, &a->densities, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    struct gsn_error err = { 0 };
    drawn_auto d;

    draw(&d);
    gsn_auto(gsn_reconstruction) a = assembled(&d);
    gsn_auto(gsn_scan) scan = opened(&d, 1);

    CHECK_EVERY_OOM(draw_once(a, scan, &err), err);
    CHECK(a->densities.section[DOUBTFUL].candidate_picture[0].size > 0);
}
