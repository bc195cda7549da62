/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/night.h"

#include "storage/overview.h"
#include "storage/queue.h"
#include "storage/result.h"
#include "systemd/specimen_job.h"

#include <stdio.h>
#include <string.h>

/* The key of the last run that left a report; untouched when there is none. */
static int last_key(struct gsn_store *store, int64_t specimen, struct gsn_digest *ret_key,
                    struct gsn_error *err)
{
    gsn_auto(gsn_run_rows) runs = NULL;
    const int r = gsn_run_list(store, specimen, &runs, err);

    for (size_t i = 0; r >= 0 && i < runs->count; i++)
        if (runs->at[i].json_path[0])
            (void)snprintf(ret_key->hex, sizeof ret_key->hex, "%s", runs->at[i].key);
    return r;
}

static int has_changed(struct gsn_store *store, int64_t specimen, int *ret_changed,
                       struct gsn_error *err)
{
    struct gsn_digest was = { "" }, is = { "" };
    struct gsn_error quiet = { 0 };
    int r = last_key(store, specimen, &was, err);

    if (r < 0)
        return r;
    r = gsn_material_key_now(store, specimen, &is, &quiet);
    if (r == GSN_E_NOMEM || r == GSN_E_BUSY || r == GSN_E_STORE)
        return gsn_fail(err, r, "%s", quiet.text);
    *ret_changed = strcmp(was.hex, is.hex) != 0;
    return GSN_OK;
}

int gsn_night_ask(struct gsn_store *store, size_t *ret_count, struct gsn_error *err)
{
    gsn_auto(gsn_overview_rows) specimens = NULL;
    size_t count = 0;
    int r = gsn_overview_list(store, &specimens, err);

    for (size_t i = 0; r >= 0 && i < specimens->count; i++) {
        const struct gsn_overview_row *row = &specimens->at[i];
        int64_t job;
        int changed = 0;

        if (row->job.state[0] || (row->run == 0 && row->panels == 0))
            continue;
        r = has_changed(store, row->id, &changed, err);
        if (r >= 0 && changed) {
            r = gsn_queue_add(store, row->id, 0, &job, err);
            count++;
        }
    }
    if (r >= 0)
        *ret_count = count;
    return r;
}
