/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/candidates.h"

#include "systemd/marker_rows.h"

#include <math.h>
#include <stdio.h>

size_t gsn_candidates_to_rows(const struct gsn_candidates *list, int64_t slot,
                              struct gsn_candidate_row ret_rows[GSN_CANDIDATES])
{
    for (size_t i = 0; i < list->count; i++) {
        const struct gsn_candidate *c = &list->at[i];
        struct gsn_candidate_row *row = &ret_rows[i];

        *row = (struct gsn_candidate_row){ .slot = slot,
                                           .chosen = list->chosen == i + 1,
                                           .mirrored = c->mirrored,
                                           .flipped = c->flipped,
                                           .rotated180 = c->rotated180,
                                           .share = c->share,
                                           .error_um = c->error_um,
                                           .differs = c->differs };
        gsn_marks_to_rows(c->mark, row->marker);
    }
    return list->count;
}

static struct gsn_candidate candidate_of(const struct gsn_candidate_row *row)
{
    struct gsn_candidate c = { .mirrored = row->mirrored != 0,
                               .flipped = row->flipped != 0,
                               .rotated180 = row->rotated180 != 0,
                               .share = row->share,
                               .error_um = NAN };

    (void)snprintf(c.differs, sizeof c.differs, "%s", row->differs);
    gsn_marks_from_rows(row->marker, c.mark);
    return c;
}

void gsn_candidates_from_rows(const struct gsn_candidate_rows *rows, int64_t panel_id, int64_t slot,
                              struct gsn_candidates *ret_list)
{
    struct gsn_candidates list = { .count = 0 };

    for (size_t i = 0; i < rows->count && list.count < GSN_CANDIDATES; i++) {
        if (rows->at[i].panel_id != panel_id || rows->at[i].slot != slot)
            continue;
        list.at[list.count++] = candidate_of(&rows->at[i]);
        if (rows->at[i].chosen)
            list.chosen = (unsigned)list.count;
    }
    *ret_list = list;
}
