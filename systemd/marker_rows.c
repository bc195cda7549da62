/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/marker_rows.h"

_Static_assert((int)GSN_ROW_MARKS == (int)GSN_MARKS, "a row has room for a section's marks");

void gsn_marks_to_rows(const struct gsn_mark mark[GSN_MARKS],
                       struct gsn_marker_row ret_rows[GSN_ROW_MARKS])
{
    for (size_t m = 0; m < GSN_MARKS; m++)
        ret_rows[m] = (struct gsn_marker_row){ .found = mark[m].found,
                                               .x_px = mark[m].px.x,
                                               .y_px = mark[m].px.y,
                                               .radius_px = mark[m].radius_px,
                                               .cov_xx = mark[m].cov_xx,
                                               .cov_xy = mark[m].cov_xy,
                                               .cov_yy = mark[m].cov_yy,
                                               .score = mark[m].score };
}

void gsn_marks_from_rows(const struct gsn_marker_row rows[GSN_ROW_MARKS],
                         struct gsn_mark ret_mark[GSN_MARKS])
{
    for (size_t m = 0; m < GSN_MARKS; m++) {
        const struct gsn_marker_row *row = &rows[m];

        ret_mark[m] = row->found ? (struct gsn_mark){ .px = { row->x_px, row->y_px },
                                                      .radius_px = row->radius_px,
                                                      .cov_xx = row->cov_xx,
                                                      .cov_xy = row->cov_xy,
                                                      .cov_yy = row->cov_yy,
                                                      .score = row->score,
                                                      .found = 1 }
                                 : (struct gsn_mark){ 0 };
    }
}
