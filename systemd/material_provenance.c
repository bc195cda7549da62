/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/material_parts.h"

#include "pipeline/core/hash.h"
#include "pipeline/core/linalg.h"
#include "pipeline/imaging/imaging.h"
#include "systemd/answers.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

int gsn_material_list_inputs(struct gsn_material *m, struct gsn_error *err)
{
    const size_t count = 1 + m->panels->count + m->attachments->count;
    size_t i = 0;

    m->input = gsn_alloc_array(count, sizeof *m->input);
    if (!m->input)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the provenance");
    m->input[i++] = (struct gsn_specimen_input){ .name = "job.json",
                                                 .sha256 = m->row->job_sha256,
                                                 .size = strlen(m->row->job_json) };
    for (size_t p = 0; p < m->panels->count; p++)
        m->input[i++] = (struct gsn_specimen_input){ .name = m->panels->at[p].file_name,
                                                     .sha256 = m->panels->at[p].sha256,
                                                     .size = (size_t)m->panels->at[p].size };
    for (size_t a = 0; a < m->attachments->count; a++)
        m->input[i++] = (struct gsn_specimen_input){ .name = m->attachments->at[a].name,
                                                     .sha256 = m->attachments->at[a].sha256,
                                                     .size = (size_t)m->attachments->at[a].size };
    m->specimen.input = m->input;
    m->specimen.input_count = count;
    return GSN_OK;
}

int gsn_material_take_decisions(struct gsn_material *m, struct gsn_error *err)
{
    m->decision = gsn_alloc_array(m->decided->count, sizeof *m->decision);
    m->pose = gsn_alloc_array(m->decided->count, sizeof *m->pose);
    if (!m->decision || !m->pose)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for what was decided");
    for (size_t i = 0; i < m->decided->count; i++) {
        const struct gsn_decision_row *row = &m->decided->at[i];
        const unsigned pose = gsn_answers_pose(row->answer);

        (void)snprintf(m->pose[i], sizeof m->pose[i], "pose %u", pose);
        m->decision[i] = (struct gsn_specimen_decision){ .panel = (unsigned)row->number,
                                                         .slot = (unsigned)row->slot,
                                                         .answer = pose ? m->pose[i] : row->answer,
                                                         .actor = row->actor,
                                                         .reason = row->reason,
                                                         .time = row->time,
                                                         .is_pose = pose > 0 };
    }
    m->specimen.decision = m->decision;
    m->specimen.decision_count = m->decided->count;
    return GSN_OK;
}

static int hash_text(json_t *root, char **ret_text, struct gsn_digest *ret_digest,
                     struct gsn_error *err)
{
    char *dumped = json_dumps(root, JSON_COMPACT);
    gsn_auto_mem(char) text = dumped ? gsn_strdup(dumped) : NULL;
    int r;

    free(dumped); /* door */
    if (!text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the provenance");
    r = gsn_sha256(text, strlen(text), ret_digest, err);
    if (r >= 0 && ret_text)
        *ret_text = gsn_steal(&text);
    return r;
}

/* A text that may be any bytes, as something that JSON can hold. */
static json_t *hashed(const char *text)
{
    struct gsn_digest digest = { "" };

    return gsn_sha256(text, strlen(text), &digest, NULL) < 0 ? json_null()
                                                             : json_string(digest.hex);
}

/* A report that rests on an answer is another report, and says who gave it, when and why. */
static void add_decisions(const struct gsn_material *m, json_t *root)
{
    json_t *answers = json_array();

    for (size_t i = 0; i < m->decided->count; i++)
        (void)json_array_append_new(answers, json_pack("{s:I, s:I, s:s, s:o, s:o, s:I}", "panel",
                                                       (json_int_t)m->decided->at[i].number, "slot",
                                                       (json_int_t)m->decided->at[i].slot, "answer",
                                                       m->decided->at[i].answer, "by",
                                                       hashed(m->decided->at[i].actor), "reason",
                                                       hashed(m->decided->at[i].reason), "time",
                                                       (json_int_t)m->decided->at[i].time));
    if (json_array_size(answers) > 0)
        (void)json_object_set(root, "decisions", answers);
    json_decref(answers);
}

int gsn_material_make_keys(struct gsn_material *m, struct gsn_error *err)
{
    json_t *root = json_object(), *inputs = json_array(), *unread = json_array();
    int r;

    for (size_t i = 0; i < m->specimen.input_count; i++)
        (void)json_array_append_new(inputs,
                                    json_pack("{s:s, s:s}", "name", m->specimen.input[i].name,
                                              "sha256", m->specimen.input[i].sha256));
    for (size_t i = 0; i < m->panels->count; i++)
        if (strcmp(m->panels->at[i].state, "waiting") == 0)
            (void)json_array_append_new(unread, json_string(m->panels->at[i].sha256));
    (void)json_object_set_new(root, "inputs", inputs);
    /* The same inputs, but a report without them: it must not take the other one's place. */
    if (json_array_size(unread) > 0)
        (void)json_object_set(root, "unread", unread);
    json_decref(unread);
    add_decisions(m, root);
    (void)json_object_set_new(root, "version", json_string(GSN_VERSION));
    /* Another version of these may change a pixel or a figure. */
    (void)json_object_set_new(root, "libraries",
                              json_pack("{s:s, s:s}", "opencv", gsn_imaging_version(), "gsl",
                                        gsn_linalg_version()));
    r = hash_text(root, NULL, &m->own_key, err);
    (void)json_object_set(root, "baseline", m->baseline_keys);
    if (r >= 0)
        r = hash_text(root, &m->inputs, &m->key, err);
    json_decref(root);
    m->specimen.key = m->key.hex;
    return r;
}
