/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A section's marks, between the pipeline's record and the store's rows. */
#ifndef GSN_SYSTEMD_MARKER_ROWS_H
#define GSN_SYSTEMD_MARKER_ROWS_H

#include "pipeline/register/markers.h"
#include "storage/panel_log.h"

void gsn_marks_to_rows(const struct gsn_mark mark[GSN_MARKS],
                       struct gsn_marker_row ret_rows[GSN_ROW_MARKS]);
/* One that was not found comes back as nothing but that; its contrast is not kept. */
void gsn_marks_from_rows(const struct gsn_marker_row rows[GSN_ROW_MARKS],
                         struct gsn_mark ret_mark[GSN_MARKS]);

#endif
