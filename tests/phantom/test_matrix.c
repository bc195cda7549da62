/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/check.h"

#include <dmtx.h>
#include <stdio.h>
#include <string.h>

#include "pipeline/phantom/label.h"
#include "pipeline/phantom/panel.h"
#include "pipeline/phantom/planning.h"

enum { SIDE = GSN_PHANTOM_MATRIX_SIDE };

static const double STRIP_UM = 3200;

/* What the library's reader finds in the label strip of an image, "" for nothing. */
static void read_strip(struct gsn_image *image, double px_um, char *ret_text, size_t size)
{
    DmtxImage *picture =
        dmtxImageCreate(image->samples, (int)image->width, (int)image->height, DmtxPack24bppRGB);
    DmtxDecode *decoder = dmtxDecodeCreate(picture, 1);
    DmtxRegion *region;
    DmtxMessage *message = NULL;

    dmtxDecodeSetProp(decoder, DmtxPropXmax, (int)(STRIP_UM / px_um) - 1);
    while (!message && (region = dmtxRegionFindNext(decoder, NULL))) {
        message = dmtxDecodeMatrixRegion(decoder, region, DmtxUndefined);
        dmtxRegionDestroy(&region);
    }
    (void)snprintf(ret_text, size, "%.*s", message ? message->outputIdx : 0,
                   message ? (const char *)message->output : "");
    if (message)
        dmtxMessageDestroy(&message);
    dmtxDecodeDestroy(&decoder);
    dmtxImageDestroy(&picture);
}

static void check_panel(const char *level, int panel, double px_um, const char *name)
{
    struct gsn_phantom_extent extent[GSN_PHANTOM_SLOTS];
    gsn_auto(gsn_image) image = NULL;
    struct gsn_phantom_plan plan;
    struct gsn_error err = { 0 };
    char text[64];

    CHECK_OK(gsn_phantom_plan_make("S02", level, 7, px_um, &plan, &err), err);
    CHECK_OK(gsn_phantom_panel_draw(&plan, &plan.file[panel - 1], 0, &image, extent, &err), err);
    read_strip(image, px_um, text, sizeof text);
    assert_string_equal(text, name);
}

TEST(a_reader_finds_the_name_of_the_panel_on_its_label)
{
    check_panel("L1", 3, 16, "GVP-D-S02-P03");
    check_panel("L0", 3, 24, "GVP-D-S02-P03");
    check_panel("L1", 5, 32, "GVP-D-S02-P05");
}

/* From 39 um on, a module of 96 um would round to two pixels, which the reader cannot follow. */
TEST(coarse_and_fine_panels_can_be_read_too)
{
    check_panel("L1", 1, 8, "GVP-D-S02-P01");
    check_panel("L1", 1, 27.5, "GVP-D-S02-P01");
    check_panel("L1", 1, 39, "GVP-D-S02-P01");
    check_panel("L1", 1, 48, "GVP-D-S02-P01");
}

/* ISO/IEC 16022: solid on the left and below, alternating above and on the right. */
TEST(two_solid_and_two_broken_sides_frame_the_matrix)
{
    struct gsn_phantom_matrix matrix;
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_phantom_matrix_make("GVP-D-S01-P03", &matrix, &err), err);
    for (int i = 0; i < SIDE; i++) {
        CHECK(matrix.dark[i][0] == 1);
        CHECK(matrix.dark[SIDE - 1][i] == 1);
        CHECK(matrix.dark[0][i] == (i + 1) % 2);
        CHECK(matrix.dark[i][SIDE - 1] == i % 2);
    }
}

TEST(text_that_does_not_fit_is_refused_and_the_matrix_is_left_alone)
{
    struct gsn_phantom_matrix matrix, before;
    struct gsn_error err = { 0 };

    memset(&matrix, 7, sizeof matrix);
    before = matrix;
    CHECK(gsn_phantom_matrix_make("thirteen long", &matrix, &err) == GSN_E_LIMIT);
    assert_string_equal(err.text, "\"thirteen long\" does not fit a Data Matrix of 16 x 16");
    CHECK(gsn_phantom_matrix_make("1234567890123456789012345", &matrix, &err) == GSN_E_LIMIT);
    CHECK(gsn_phantom_matrix_make("", &matrix, &err) == GSN_E_LIMIT);
    CHECK(memcmp(&matrix, &before, sizeof matrix) == 0);
    CHECK_OK(gsn_phantom_matrix_make("twelve chars", &matrix, &err), err);
    CHECK_OK(gsn_phantom_matrix_make("123456789012345678901234", &matrix, &err), err);
}
