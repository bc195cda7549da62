/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/material_parts.h"

#include "systemd/panel_job.h"

#include <string.h>

static int open_object(void *context, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    return gsn_object_open(context, sha256, ret_fd, err);
}

/* Two scans of one panel are settled only where their pictures may be opened. */
static int load_rows(struct gsn_material *m, int64_t id, int settles, struct gsn_decoder *decoder,
                     struct gsn_error *err)
{
    int r = gsn_specimen_get_by_id(m->store, id, &m->row, err);

    if (r >= 0)
        r = gsn_protocol_parse(m->row->job_json, strlen(m->row->job_json), &m->protocol, err);
    if (r >= 0)
        r = gsn_panel_list(m->store, id, &m->panels, err);
    if (r >= 0 && settles)
        r = gsn_material_settle_duplicates(m, decoder, err);
    if (r >= 0)
        r = gsn_section_list(m->store, id, &m->sections, err);
    if (r >= 0)
        r = gsn_decision_list(m->store, id, &m->decided, err);
    if (r >= 0)
        r = gsn_candidate_list(m->store, id, &m->candidates, err);
    if (r >= 0)
        r = gsn_attachment_list(m->store, id, &m->attachments, err);
    m->specimen.protocol = m->protocol;
    return r;
}

/* What the key is made of. */
static int take_rows(struct gsn_material *m, struct gsn_store *store, int64_t id, int settles,
                     struct gsn_decoder *decoder, struct gsn_error *err)
{
    int r;

    m->store = store;
    m->specimen.open = open_object;
    m->specimen.context = store;
    r = load_rows(m, id, settles, decoder, err);
    if (r >= 0)
        r = gsn_material_take_panels(m, err);
    if (r >= 0)
        r = gsn_material_take_baseline(m, err);
    if (r >= 0)
        r = gsn_material_list_inputs(m, err);
    if (r >= 0)
        r = gsn_material_take_decisions(m, err);
    return r >= 0 ? gsn_material_make_keys(m, err) : r;
}

int gsn_material_load(struct gsn_store *store, int64_t specimen_id, struct gsn_decoder *decoder,
                      struct gsn_material **ret_material, struct gsn_error *err)
{
    gsn_auto(gsn_material) m = gsn_alloc_array(1, sizeof *m);
    int r;

    if (!m)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a specimen");
    r = take_rows(m, store, specimen_id, 1, decoder, err);
    if (r >= 0)
        r = gsn_material_check_turns(m, err);
    if (r >= 0)
        r = gsn_material_take_files(m, err);
    if (r < 0)
        return r;
    *ret_material = gsn_steal(&m);
    return GSN_OK;
}

int gsn_material_key_now(struct gsn_store *store, int64_t specimen_id, struct gsn_digest *ret_key,
                         struct gsn_error *err)
{
    gsn_auto(gsn_material) m = gsn_alloc_array(1, sizeof *m);
    const int r = m ? take_rows(m, store, specimen_id, 0, NULL, err)
                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for a specimen");

    if (r >= 0)
        *ret_key = m->key;
    return r;
}

void gsn_material_free(struct gsn_material *m)
{
    if (!m)
        return;
    json_decref(m->baseline_keys);
    gsn_specimen_row_free(m->row);
    gsn_protocol_free(m->protocol);
    gsn_panel_rows_free(m->panels);
    gsn_section_rows_free(m->sections);
    gsn_decision_rows_free(m->decided);
    gsn_candidate_rows_free(m->candidates);
    gsn_attachment_rows_free(m->attachments);
    gsn_mask_free(m->region);
    gsn_grid_free(m->volume);
    gsn_free(m->panel);
    gsn_free(m->section);
    gsn_free(m->input);
    gsn_free(m->decision);
    gsn_free(m->pose);
    gsn_free(m->calibration_sha256);
    gsn_free(m->definition);
    gsn_free(m->dyes);
    for (size_t i = 0; m->control && i < m->specimen.baseline.specimens; i++)
        gsn_cloud_free(m->control[i].cloud);
    gsn_free(m->control);
    gsn_free(m->inputs);
    gsn_free(m);
}

const struct gsn_specimen *gsn_material_specimen(const struct gsn_material *m)
{
    return &m->specimen;
}

const char *gsn_material_key(const struct gsn_material *m)
{
    return m->key.hex;
}

const char *gsn_material_inputs(const struct gsn_material *m)
{
    return m->inputs;
}

const char *gsn_material_own_key(const struct gsn_material *m)
{
    return m->own_key.hex;
}
