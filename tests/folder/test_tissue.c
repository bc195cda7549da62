/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder/register_folder.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/png_write.h"
#include "pipeline/register/pose/pose.h"
#include "tests/check.h"
#include "tests/register/draw.h"
#include "tests/register/tissue/drawn_tissue.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { SECTIONS = 8, BLANK = 6, WRONG = 5, SIDE = DRAWN_TISSUE_SIDE };

static struct gsn_affine mounted[SECTIONS];

/* A burn of 5 cells with its pale ring, as the density changes there; 0 where there is none. */
static double burn(double density, double r)
{
    const double dark = fmin(fmax(5.5 - r, 0), 1), pale = fmin(fmax(8.5 - r, 0), 1) * (1 - dark);

    return density * (1 - 0.65 * pale) * (1 - dark) + 2.6 * dark;
}

/* Burns three marks into section k; wrong: where they would be if it lay face down. */
static void burn_marks(struct gsn_plane *plane, unsigned k, int wrong)
{
    static const struct gsn_point marks[3] = { { 62, 66 }, { 142, 74 }, { 78, 140 } };
    const struct gsn_affine way = mounted[k];

    for (int m = 0; m < 3; m++) {
        const struct gsn_point at = { wrong ? SIDE - marks[m].x : marks[m].x, marks[m].y };
        const struct gsn_point p = gsn_affine_apply(&way, at);

        for (int i = 0; i < SIDE * SIDE; i++)
            plane->value[i] = (float)burn((double)plane->value[i],
                                          hypot(i % SIDE + 0.5 - p.x, i / SIDE + 0.5 - p.y));
    }
}

/* Grey, two pixels for each cell; the seventh picture is empty glass. marked: with marks, wrong
 * ones in the sixth. */
static void write_section(const char *path, unsigned k, int marked)
{
    gsn_auto(gsn_plane) plane = drawn_tissue(5, k, &mounted[k], 0);
    gsn_auto(gsn_image) image = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size;

    if (marked)
        burn_marks(plane, k, k == WRONG);
    CHECK_OK(gsn_image_new(2 * SIDE, 2 * SIDE, 3, 8, &image, &err), err);
    for (size_t i = 0; i < (size_t)4 * SIDE * SIDE; i++) {
        const double od = (double)plane->value[i / (2 * SIDE) / 2 * SIDE + i % (2 * SIDE) / 2];
        const int grain = (int)((i * 2654435761u >> 29) & 7);
        const uint8_t code = (uint8_t)(k == BLANK ? 236 + grain : 240 * pow(10, -0.4 * od));

        memset((uint8_t *)image->samples + 3 * i, code, 3);
    }
    CHECK_OK(gsn_png_encode(image, &bytes, &size, &err), err);
    CHECK_OK(gsn_file_write(path, bytes, size, &err), err);
}

static char *make_folder(int marked)
{
    const char *tmp = getenv("TMPDIR");
    char *dir = gsn_format("%s/gieson-tissue-XXXXXX", tmp ? tmp : "/tmp");
    struct draw_chance chance = { 11 };

    CHECK(dir && mkdtemp(dir));
    for (unsigned k = 0; k < SECTIONS; k++) {
        gsn_auto_mem(char) path = gsn_format("%s/s%u.png", dir, k);

        mounted[k] = drawn_motion(draw_uniform(&chance, 0, 6.28), k == 2,
                                  draw_uniform(&chance, -6, 6), draw_uniform(&chance, -6, 6));
        write_section(path, k, marked);
    }
    return dir;
}

static void remove_folder(char *dir)
{
    for (unsigned k = 0; k < SECTIONS; k++) {
        gsn_auto_mem(char) path = gsn_format("%s/s%u.png", dir, k);

        (void)unlink(path);
    }
    (void)rmdir(dir);
    gsn_free(dir);
}

/* In cells at +0.5, as the drawing has it. */
static struct gsn_affine in_cells(const struct gsn_affine *m)
{
    return (struct gsn_affine){ m->m00, m->m01, (m->m02 - (m->m00 + m->m01) * 0.5 + 0.5) / 2,
                                m->m10, m->m11, (m->m12 - (m->m10 + m->m11) * 0.5 + 0.5) / 2 };
}

/* Case 21 for all sections: no marks anywhere. */
TEST(a_folder_without_marks_is_laid_by_tissue_when_asked)
{
    const struct gsn_folder_options options = { .by_tissue = 1 };
    gsn_auto(gsn_folder_stack) stack = NULL;
    struct gsn_error err = { 0 };
    char *dir = make_folder(0);
    const struct gsn_affine *first;
    size_t reference;

    CHECK_OK(gsn_folder_register(dir, &options, &stack, &err), err);
    remove_folder(dir);
    reference = stack->tissue.reference;
    first = &mounted[reference];
    CHECK(stack->by_tissue == SECTIONS - 1 && stack->tissue.held == 0);
    for (unsigned k = 0; k < SECTIONS; k++) {
        const struct gsn_folder_section *s = &stack->section[k];
        const struct gsn_affine back = gsn_affine_inverse(first);
        const struct gsn_affine truth = gsn_affine_compose(&back, &mounted[k]);
        const struct gsn_affine found = in_cells(&s->frame_to_px);

        CHECK(s->state == GSN_POSE_NONE && s->by_tissue == (k != BLANK));
        if (k == BLANK) {
            CHECK(strcmp(s->reason, "no marks, and its tissue fits none of the three sections "
                                    "before and after; look at the section") == 0);
            continue;
        }
        CHECK(drawn_apart(&found, &truth) < 1);
        CHECK(strstr(s->flags, "by-tissue") && (strstr(s->flags, "flipped") != NULL) == (k == 2));
        CHECK(s->reason[0] == '\0' && (k == reference || s->error_px > 0.05));
    }
}

/* What recurs in the drawn tissue may look like a triangle of marks; what does not is said. */
TEST(a_folder_without_marks_is_not_laid_by_tissue_unasked)
{
    const struct gsn_folder_options options = { 0 };
    gsn_auto(gsn_folder_stack) stack = NULL;
    struct gsn_error err = { 0 };
    char *dir = make_folder(0);
    const int r = gsn_folder_register(dir, &options, &stack, &err);

    remove_folder(dir);
    CHECK(r == GSN_OK || (r == GSN_E_MARKERS && err.text[0] != '\0' && !stack));
    for (unsigned k = 0; stack && k < SECTIONS; k++) {
        const struct gsn_folder_section *s = &stack->section[k];

        CHECK(!s->by_tissue && (s->state != GSN_POSE_NONE || s->reason[0] != '\0'));
    }
}

/* Three spots that fit the triangle with the other face up: the tissue lays the section, and says
 * that they are not its marks. */
TEST(marks_that_the_tissue_contradicts_do_not_lay_a_section)
{
    const struct gsn_folder_options options = { .by_tissue = 1 };
    gsn_auto(gsn_folder_stack) stack = NULL;
    struct gsn_error err = { 0 };
    char *dir = make_folder(1);

    CHECK_OK(gsn_folder_register(dir, &options, &stack, &err), err);
    remove_folder(dir);
    CHECK(stack->tissue.held == SECTIONS - 2);
    for (unsigned k = 0; k < SECTIONS; k++) {
        const struct gsn_folder_section *s = &stack->section[k];

        if (k == BLANK)
            continue;
        CHECK((s->state == GSN_POSE_OK) == (k != WRONG) && s->by_tissue == (k == WRONG));
        CHECK((strstr(s->flags, "tissue-disagrees") != NULL) == (k == WRONG));
        CHECK(s->flipped == (k == 2));
    }
}
