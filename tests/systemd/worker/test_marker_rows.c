/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/worker/panel_job.h"

#include "tests/check.h"

#include <string.h>

static const struct gsn_fiducial SEEN = { .px = { 12.5, -3.25 },
                                          .radius_px = 15,
                                          .cov_xx = 0.01,
                                          .cov_xy = -0.002,
                                          .cov_yy = 0.03,
                                          .score = 0.75,
                                          .found = 1 };

TEST(marks_come_back_from_rows_as_they_went_in)
{
    const struct gsn_fiducial mark[GSN_FIDUCIALS] = { SEEN, { .found = 0 }, SEEN };
    struct gsn_fiducial_row row[GSN_ROW_MARKS];
    struct gsn_fiducial back[GSN_FIDUCIALS];

    memset(back, 255, sizeof back);
    gsn_fiducials_to_rows(mark, row);
    CHECK(row[0].found == 1 && row[1].found == 0 && row[2].found == 1);
    CHECK(row[0].x_px == 12.5 && row[0].y_px == -3.25 && row[0].cov_xy == -0.002);
    gsn_fiducials_from_rows(row, back);
    for (size_t m = 0; m < GSN_FIDUCIALS; m++) {
        CHECK(back[m].found == mark[m].found && back[m].radius_px == mark[m].radius_px);
        CHECK(back[m].px.x == mark[m].px.x && back[m].px.y == mark[m].px.y);
        CHECK(back[m].cov_xx == mark[m].cov_xx && back[m].cov_xy == mark[m].cov_xy);
        CHECK(back[m].cov_yy == mark[m].cov_yy && back[m].score == mark[m].score);
    }
}

/* The store gives what is not there back as NaN. */
TEST(a_mark_that_was_not_found_has_no_numbers)
{
    const struct gsn_fiducial_row none = { 0, NAN, NAN, NAN, NAN, NAN, NAN, NAN };
    const struct gsn_fiducial_row row[GSN_ROW_MARKS] = { none, none, none };
    struct gsn_fiducial back[GSN_FIDUCIALS];

    gsn_fiducials_from_rows(row, back);
    for (size_t m = 0; m < GSN_FIDUCIALS; m++)
        CHECK(!back[m].found && back[m].px.x == 0 && back[m].cov_xx == 0 && back[m].score == 0);
}
