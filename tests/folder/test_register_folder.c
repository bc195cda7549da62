/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder/register_folder.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/pose.h"
#include "tests/check.h"
#include "tests/register/draw_picture.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { SIDE = 420, SECTIONS = 7, LOST = 4, BARE = 5, BROKEN = 6 };
static const struct gsn_point MARKS[GSN_FIDUCIALS] = { { -120, -50 }, { 100, -80 }, { 20, 110 } };

/* How section i lies: frame -> picture, pixel centres at whole numbers. */
static struct gsn_affine mounting(int i)
{
    const double angle = 0.7 * i, f = i == 2 ? -1 : 1;

    return (struct gsn_affine){ f * cos(angle), -sin(angle), 210 + 3.3 * i,
                                f * sin(angle), cos(angle),  208 - 2.7 * i };
}

static void write_section(const char *path, int i)
{
    static float value[3 * SIDE * SIDE];
    struct draw_chance chance = { (uint64_t)i + 1 };
    const struct gsn_affine map = mounting(i);
    gsn_auto(gsn_image) image = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    draw_tissue_picture(value, SIDE, SIDE, 195, &chance);
    for (int k = 0; k < GSN_FIDUCIALS; k++) {
        struct draw_spot spot = { .radius = 16, .alpha = 0.96, .cut = NAN };

        spot.centre = gsn_affine_apply(&map, MARKS[k]);
        spot.centre.x += 0.5;
        spot.centre.y += 0.5;
        if (i != BARE && !(i == LOST && k == 1))
            draw_spot_on(value, SIDE, SIDE, &spot);
    }
    CHECK_OK(gsn_image_new(SIDE, SIDE, 3, 8, &image, &err), err);
    draw_codes(value, image, 3, &chance);
    CHECK_OK(gsn_png_encode(image, &bytes, &size, &err), err);
    CHECK_OK(gsn_file_write(path, bytes, i == BROKEN ? size / 2 : size, &err), err);
}

/* gives: a folder of seven sections, the third face down, the fifth with two marks, the sixth with
 * none, the seventh cut short. */
static char *make_folder(void)
{
    const char *tmp = getenv("TMPDIR");
    char *dir = gsn_format("%s/gieson-folder-XXXXXX", tmp ? tmp : "/tmp");

    CHECK(dir && mkdtemp(dir));
    for (int i = 0; i < SECTIONS; i++) {
        gsn_auto_mem(char) path = gsn_format("%s/s%d.png", dir, i + 8); /* s8, s9, s10: by number */

        write_section(path, i);
    }
    return dir;
}

static void remove_folder(char *dir)
{
    for (int i = 0; i < SECTIONS; i++) {
        gsn_auto_mem(char) path = gsn_format("%s/s%d.png", dir, i + 8);

        (void)unlink(path);
    }
    (void)rmdir(dir);
    gsn_free(dir);
}

static double off(const struct gsn_affine *a, const struct gsn_affine *b, struct gsn_point at)
{
    const struct gsn_point p = gsn_affine_apply(a, at), q = gsn_affine_apply(b, at);

    return hypot(p.x - q.x, p.y - q.y);
}

/* The errors' mean square is quadratic in the place: over the disc it is halfway from that at the
 * origin to the mean of the rim's. */
static void check_ellipses(const struct gsn_folder_section *s, double radius)
{
    double square[GSN_FOLDER_ELLIPSES], rim = 0;

    for (size_t i = 0; i < GSN_FOLDER_ELLIPSES; i++) {
        const struct gsn_folder_ellipse *e = &s->ellipse[i];

        CHECK_NEAR(hypot(e->at.x, e->at.y), i > 0 ? radius : 0, 1e-9);
        CHECK(e->px.major >= e->px.minor && e->px.minor > 0);
        square[i] = e->px.major * e->px.major + e->px.minor * e->px.minor;
        rim += i > 0 ? square[i] / 4 : 0;
    }
    /* 2.447 for 95 % of normal errors, more as few sections tell how large they are. */
    CHECK(sqrt((square[0] + rim) / 2) > 2.44 * s->error_px);
    CHECK(sqrt((square[0] + rim) / 2) < 4 * s->error_px);
}

/* Cases 17, 19, 20, 21 and 3: what has a pose has the true one, what has none says why. */
TEST(every_section_has_its_pose_or_a_reason)
{
    const struct gsn_folder_options options = { .mark = MARKS, .radius = 150 };
    gsn_auto(gsn_folder_stack) stack = NULL;
    struct gsn_error err = { 0 };
    char *dir = make_folder();

    CHECK_OK(gsn_folder_register(dir, &options, &stack, &err), err);
    remove_folder(dir);
    CHECK(stack->count == SECTIONS && strcmp(stack->section[2].file, "s10.png") == 0);
    for (int i = 0; i < LOST; i++) {
        const struct gsn_folder_section *s = &stack->section[i];
        const struct gsn_affine truth = mounting(i);

        CHECK(s->state == GSN_POSE_OK && s->reason[0] == '\0');
        CHECK(off(&s->frame_to_px, &truth, (struct gsn_point){ 0, 0 }) < 0.15);
        CHECK(off(&s->frame_to_px, &truth, (struct gsn_point){ 150, 0 }) < 0.25);
        CHECK(s->error_px > 0 && s->error_px < 0.2);
        CHECK((strstr(s->flags, "flipped") != NULL) == (i == 2));
        check_ellipses(s, 150);
    }
    CHECK(stack->section[LOST].state != GSN_POSE_OK);
    CHECK(stack->section[LOST].state == GSN_POSE_TWO_MARKS ||
          strstr(stack->section[LOST].reason, "look at the section"));
    CHECK(stack->section[BARE].state == GSN_POSE_NONE);
    CHECK(strstr(stack->section[BARE].reason, "look at the section"));
    CHECK(stack->section[BROKEN].state == GSN_POSE_NONE && stack->section[BROKEN].reason[0]);
    CHECK(stack->fle_px > 0 && stack->fle_px < 0.3 && stack->cpu_ms > 0);
}

TEST(without_stated_marks_the_sections_agree_on_their_own_frame)
{
    const struct gsn_folder_options options = { .px_um = 5 };
    gsn_auto(gsn_folder_stack) stack = NULL;
    struct gsn_error err = { 0 };
    char *dir = make_folder();

    CHECK_OK(gsn_folder_register(dir, &options, &stack, &err), err);
    remove_folder(dir);
    for (int i = 0; i < LOST; i++) {
        const struct gsn_affine *m = &stack->section[i].frame_to_px, truth = mounting(i);
        const struct gsn_point middle =
            gsn_affine_apply(&truth, (struct gsn_point){ 0, -20.0 / 3 });

        /* um to pixels; the origin is the triangle's centroid. */
        CHECK(stack->section[i].state == GSN_POSE_OK);
        CHECK_NEAR(fabs(gsn_affine_det(m)), 1.0 / 25, 1e-9);
        CHECK(hypot(m->m02 - middle.x, m->m12 - middle.y) < 0.15);
    }
}

TEST(a_folder_without_pictures_is_refused)
{
    const struct gsn_folder_options options = { 0 };
    struct gsn_folder_stack *stack = NULL;
    struct gsn_error err = { 0 };
    char dir[] = "/tmp/gieson-empty-XXXXXX";

    CHECK(mkdtemp(dir));
    CHECK(gsn_folder_register(dir, &options, &stack, &err) == GSN_E_INPUT);
    CHECK(strstr(err.text, "no pictures") && stack == NULL);
    (void)rmdir(dir);
    CHECK(gsn_folder_register(dir, &options, &stack, &err) == GSN_E_NOTFOUND && stack == NULL);
}
