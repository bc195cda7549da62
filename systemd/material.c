/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/specimen_job.h"

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/decode/volume.h"
#include "storage/attachment.h"
#include "storage/catalog.h"
#include "storage/decision.h"
#include "storage/panel_log.h"
#include "storage/result.h"
#include "systemd/answers.h"
#include "systemd/candidates.h"
#include "systemd/panel_job.h"
#include "systemd/rescan.h"

#include <errno.h>
#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MOST_VOLUME_BYTES = 1 << 30 };

struct gsn_material {
    struct gsn_store *store;
    struct gsn_specimen specimen;
    struct gsn_specimen_row *row;
    struct gsn_protocol *protocol;
    struct gsn_panel_rows *panels;
    struct gsn_section_rows *sections;
    struct gsn_decision_rows *decided;
    struct gsn_candidate_rows *candidates;
    struct gsn_attachment_rows *attachments;
    struct gsn_specimen_panel *panel;
    struct gsn_panel_section *section; /* of all panels, panel by panel */
    struct gsn_specimen_input *input;
    struct gsn_specimen_decision *decision;
    char (*pose)[16];                /* "pose 2", for the decisions that choose one */
    const char **calibration_sha256; /* its entries are the attachments' */
    struct gsn_mask *region;
    struct gsn_grid *volume;
    char *definition, *dyes; /* of the baseline */
    json_t *baseline_keys;
    char *inputs;
    struct gsn_digest key, own_key;
};

static int read_object(void *context, const char *sha256, uint8_t **ret_bytes, size_t *ret_size,
                       struct gsn_error *err)
{
    return gsn_object_read(context, sha256, ret_bytes, ret_size, err);
}

/* ---- panels ------------------------------------------------------------------------------ */

static int clash(const struct gsn_panel_row *a, const struct gsn_panel_row *b)
{
    return a != b && a->number == b->number && strcmp(a->state, "registered") == 0 &&
           strcmp(b->state, "registered") == 0;
}

/* A second scan of one glass needs a choice; two glasses of one number may need another name.
 * gives: the sentence. */
static int say_clash(const struct gsn_section_rows *sections, const struct gsn_panel_row *panel,
                     const struct gsn_panel_row *other, char **ret_sentence, struct gsn_error *err)
{
    gsn_auto_mem(char) sentence = NULL;
    double apart_um;
    size_t marks;
    int same;
    const int r = gsn_rescan_compare(sections, panel, other, &same, &marks, &apart_um, err);

    if (r < 0)
        return r;
    sentence = same ? gsn_format("panel number %lld is claimed by %.200s as well: say which scan "
                                 "to use; both show the same glass (%zu marks agree to %.1f um)",
                                 (long long)panel->number, other->file_name, marks, apart_um)
                    : gsn_format("panel number %lld is claimed by %.200s as well: say which scan "
                                 "to use, or rename one and import again",
                                 (long long)panel->number, other->file_name);
    if (!sentence)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    *ret_sentence = gsn_steal(&sentence);
    return GSN_OK;
}

/* Panels of one number are all held: which of them is right is for a person to say. */
static int hold_duplicates(struct gsn_material *m, struct gsn_error *err)
{
    gsn_auto(gsn_section_rows) sections = NULL;
    struct gsn_panel_rows *rows = m->panels;
    int held = 0, r = gsn_section_list(m->store, m->row->id, &sections, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++)
        for (size_t j = 0; r >= 0 && j < rows->count; j++) {
            gsn_auto_mem(char) sentence = NULL;

            if (!clash(&rows->at[i], &rows->at[j]))
                continue;
            r = say_clash(sections, &rows->at[i], &rows->at[j], &sentence, err);
            if (r >= 0)
                r = gsn_panel_set_state(m->store, rows->at[i].id, "held",
                                        gsn_code_name(GSN_E_WITHHELD), sentence, err);
            held = 1;
        }
    if (r < 0 || !held)
        return r;
    m->panels = NULL;
    gsn_panel_rows_free(rows);
    return gsn_panel_list(m->store, m->row->id, &m->panels, err);
}

/* The specimen's job comes after its panels' jobs, so a panel that still waits had one that failed.
 */
static const char *message_of(const struct gsn_panel_row *row)
{
    return strcmp(row->state, "waiting") == 0
               ? "its own job failed: see `gieson status`, then `gieson retry`"
               : row->message;
}

/* A section that is doubtful by itself, or that a person decided on, keeps the candidates it was
 * found with; those of one that contradicts the stack follow from the stack again. */
static struct gsn_panel_section section_of(const struct gsn_material *m,
                                           const struct gsn_section_row *row)
{
    struct gsn_panel_section section = gsn_panel_section_of_row(row);

    if (section.sighting == GSN_SIGHT_NEEDS_EYE || strstr(section.flags, "decided"))
        gsn_candidates_from_rows(m->candidates, row->panel_id, row->slot, &section.candidates);
    return section;
}

static int take_panels(struct gsn_material *m, struct gsn_error *err)
{
    size_t used = 0;

    m->panel = gsn_alloc_array(m->panels->count, sizeof *m->panel);
    m->section = gsn_alloc_array(m->sections->count, sizeof *m->section);
    if (!m->panel || !m->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the panels of a specimen");
    for (size_t i = 0; i < m->panels->count; i++) {
        const struct gsn_panel_row *row = &m->panels->at[i];
        const size_t first = used;

        for (size_t s = 0; s < m->sections->count; s++)
            if (m->sections->at[s].panel_id == row->id && strcmp(row->state, "registered") == 0)
                m->section[used++] = section_of(m, &m->sections->at[s]);
        m->panel[i] = (struct gsn_specimen_panel){ .number = (unsigned)row->number,
                                                   .file = row->file_name,
                                                   .sha256 = row->sha256,
                                                   .state = row->state,
                                                   .message = message_of(row),
                                                   .size = (size_t)row->size,
                                                   .px_um = row->px_um,
                                                   .section_count = used - first,
                                                   .section = m->section + first };
    }
    m->specimen.panel = m->panel;
    m->specimen.panel_count = m->panels->count;
    return GSN_OK;
}

/* ---- files the job names ----------------------------------------------------------------- */

static const char *attached(const struct gsn_material *m, const char *name)
{
    for (size_t i = 0; name && i < m->attachments->count; i++)
        if (strcmp(m->attachments->at[i].name, name) == 0)
            return m->attachments->at[i].sha256;
    return NULL;
}

/* Headers name their data file, so the attached files get their own names again for a moment: as
 * links in a folder of their own. gives: the folder. */
static int lay_out(const struct gsn_material *m, char **ret_folder, struct gsn_error *err)
{
    const char *tmp = getenv("TMPDIR");
    gsn_auto_mem(char) folder = gsn_format("%s/gieson.XXXXXX", tmp && tmp[0] ? tmp : "/tmp");

    if (!folder)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (!mkdtemp(folder))
        return gsn_fail(err, GSN_E_IO, "%s: %s", folder, strerror(errno));
    for (size_t i = 0; i < m->attachments->count; i++) {
        gsn_auto_mem(char) path = NULL;
        gsn_auto_mem(char) whole = NULL;
        gsn_auto_mem(char) link = gsn_format("%s/%s", folder, m->attachments->at[i].name);
        int r = gsn_store_object_path(m->store, m->attachments->at[i].sha256, &path, err);

        if (r < 0)
            return r;
        whole = realpath(path, NULL);
        if (!link || !whole || symlink(whole, link) < 0)
            return gsn_fail(err, GSN_E_IO, "the file %s of this specimen: %s",
                            m->attachments->at[i].name, strerror(errno));
    }
    *ret_folder = gsn_steal(&folder);
    return GSN_OK;
}

static void sweep(const struct gsn_material *m, const char *folder)
{
    for (size_t i = 0; i < m->attachments->count; i++) {
        gsn_auto_mem(char) link = gsn_format("%s/%s", folder, m->attachments->at[i].name);

        if (link)
            (void)unlink(link);
    }
    (void)rmdir(folder);
}

static int read_volumes(struct gsn_material *m, const char *folder, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;
    int r = GSN_OK;

    if (p->region.file) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, p->region.file);

        r = path ? gsn_volume_read_mask(path, MOST_VOLUME_BYTES, &m->region, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");
    }
    if (r >= 0 && p->kind == GSN_KIND_VOLUME) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, p->file);

        r = path ? gsn_volume_read_grid(path, MOST_VOLUME_BYTES, &m->volume, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");
    }
    return r;
}

static int find_calibrations(struct gsn_material *m, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;

    m->calibration_sha256 =
        gsn_alloc_array(p->calibration_count + 1, sizeof *m->calibration_sha256);
    if (!m->calibration_sha256)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the calibration panels");
    for (size_t i = 0; i < p->calibration_count; i++)
        m->calibration_sha256[i] = attached(m, p->calibration[i].file);
    m->specimen.calibration_sha256 = m->calibration_sha256;
    return GSN_OK;
}

static int take_files(struct gsn_material *m, struct gsn_error *err)
{
    gsn_auto_mem(char) folder = NULL;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < m->attachments->count; i++) {
        gsn_auto_mem(uint8_t) bytes = NULL;
        size_t size;

        r = gsn_object_read(m->store, m->attachments->at[i].sha256, &bytes, &size, err);
    }
    if (r < 0)
        return r;
    if (m->protocol->region.file || m->protocol->kind == GSN_KIND_VOLUME) {
        r = lay_out(m, &folder, err);
        if (r >= 0)
            r = read_volumes(m, folder, err);
        if (folder)
            sweep(m, folder);
    }
    m->specimen.region = m->region;
    m->specimen.volume = m->volume;
    if (m->protocol->kind == GSN_KIND_TILE)
        m->specimen.picture_sha256 = attached(m, m->protocol->file);
    if (m->protocol->kind == GSN_KIND_TILE && m->protocol->reference[0])
        m->specimen.reference_sha256 = attached(m, m->protocol->reference);
    return r < 0 ? r : find_calibrations(m, err);
}

/* ---- baseline ---------------------------------------------------------------------------- */

static const struct gsn_measure_row *row_named(const struct gsn_measure_rows *rows,
                                               const char *name)
{
    for (size_t i = 0; i < rows->count; i++)
        if (strcmp(rows->at[i].name, name) == 0)
            return &rows->at[i];
    return NULL;
}

static double measure_named(const struct gsn_measure_rows *rows, const char *name)
{
    const struct gsn_measure_row *row = row_named(rows, name);

    return row ? row->value : (double)NAN;
}

static double known(const struct gsn_measure_rows *rows, const char *name)
{
    const double value = measure_named(rows, name);

    return isnan(value) ? 0 : value;
}

/* A text of a run's parameters, or "". gives. */
static char *parameter(const struct gsn_run_row *run, const char *name)
{
    json_t *root = json_loads(run->parameters_json, 0, NULL);
    const char *text = json_string_value(json_object_get(root, name));
    char *copy = gsn_strdup(text ? text : "");

    json_decref(root);
    return copy;
}

/* The specimen's latest run with a report, whichever way it ended. */
static int finished_run(struct gsn_store *store, int64_t specimen, struct gsn_run_row **ret_run,
                        struct gsn_error *err)
{
    gsn_auto(gsn_run_row) reported = NULL;
    gsn_auto(gsn_run_row) withheld = NULL;
    int r = gsn_run_latest(store, specimen, "reported", &reported, err);

    if (r >= 0 || r == GSN_E_NOTFOUND)
        r = gsn_run_latest(store, specimen, "withheld", &withheld, err);
    if (r < 0 && r != GSN_E_NOTFOUND)
        return r;
    if (!reported && !withheld)
        return r;
    *ret_run = withheld && (!reported || withheld->id > reported->id) ? gsn_steal(&withheld)
                                                                      : gsn_steal(&reported);
    return GSN_OK;
}

/* Sums over controls; what one of them lacks is not known of all. */
static void add_tissues(const struct gsn_measure_rows *rows, struct gsn_specimen_baseline *b)
{
    for (unsigned t = 0; t < GSN_SPECIMEN_TISSUES; t++) {
        const struct gsn_measure_row *row = row_named(rows, gsn_specimen_tissue_measure(t));
        const double error = row ? (row->upper - row->lower) / (2 * 1.96) : (double)NAN;

        b->tissue[t].value += row ? row->value : (double)NAN;
        b->tissue[t].error = hypot(b->tissue[t].error, error);
    }
}

/* Adds one control to the sums; a control without a figure adds nothing to them, but this run rests
 * on its having none: else two such specimens, each the other's baseline, would ask for each other
 * for ever. */
static int add_control(struct gsn_material *m, const struct gsn_specimen_row *control,
                       struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = &m->specimen.baseline;
    gsn_auto(gsn_run_row) run = NULL;
    gsn_auto(gsn_measure_rows) measures = NULL;
    gsn_auto_mem(char) own_key = NULL;
    struct gsn_error quiet = { 0 };
    double mean;
    int r = finished_run(m->store, control->id, &run, &quiet);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r >= 0)
        r = gsn_measure_list(m->store, run->id, &measures, &quiet);
    if (r < 0)
        return gsn_fail(err, r, "%s", quiet.text);
    own_key = parameter(run, "own_key");
    if (!own_key || json_array_append_new(m->baseline_keys, json_string(own_key)) < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
    mean = measure_named(measures, "mean_density");
    if (isnan(mean)) {
        b->withheld++;
        return GSN_OK;
    }
    b->mean_density += mean;
    b->mean_density_error = hypot(b->mean_density_error, known(measures, "mean_density_error"));
    b->own_scale_error = hypot(b->own_scale_error, known(measures, "own_scale_error"));
    add_tissues(measures, b);
    b->volume_mm3 += measure_named(measures, "region_volume");
    b->specimens++;
    if (!m->definition) {
        m->definition = parameter(run, "definition");
        m->dyes = parameter(run, "dyes");
    }
    return m->definition && m->dyes ? GSN_OK
                                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for the baseline");
}

static int take_baseline(struct gsn_material *m, struct gsn_error *err)
{
    struct gsn_specimen_baseline *b = &m->specimen.baseline;
    gsn_auto(gsn_specimen_rows) controls = NULL;
    int r = GSN_OK;

    m->baseline_keys = json_array();
    b->name = m->row->baseline;
    if (!b->name[0])
        return GSN_OK;
    r = gsn_specimen_baseline(m->store, m->row->study, b->name, &controls, err);
    for (size_t i = 0; r >= 0 && i < controls->count; i++)
        if (controls->at[i].id != m->row->id)
            r = add_control(m, &controls->at[i], err);
    if (b->specimens > 0) {
        b->mean_density /= (double)b->specimens;
        b->mean_density_error /= (double)b->specimens;
        b->own_scale_error /= (double)b->specimens;
        for (unsigned t = 0; t < GSN_SPECIMEN_TISSUES; t++) {
            b->tissue[t].value /= (double)b->specimens;
            b->tissue[t].error /= (double)b->specimens;
        }
        b->volume_mm3 /= (double)b->specimens;
    }
    b->definition = m->definition ? m->definition : "";
    b->dyes = m->dyes ? m->dyes : "";
    return r;
}

/* ---- provenance -------------------------------------------------------------------------- */

static int list_inputs(struct gsn_material *m, struct gsn_error *err)
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

/* What people decided, for the report. */
static int take_decisions(struct gsn_material *m, struct gsn_error *err)
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

static int make_keys(struct gsn_material *m, struct gsn_error *err)
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
    r = hash_text(root, NULL, &m->own_key, err);
    (void)json_object_set(root, "baseline", m->baseline_keys);
    if (r >= 0)
        r = hash_text(root, &m->inputs, &m->key, err);
    json_decref(root);
    m->specimen.key = m->key.hex;
    return r;
}

/* ------------------------------------------------------------------------------------------ */

static int load_rows(struct gsn_material *m, int64_t id, struct gsn_error *err)
{
    int r = gsn_specimen_get_by_id(m->store, id, &m->row, err);

    if (r >= 0)
        r = gsn_protocol_parse(m->row->job_json, strlen(m->row->job_json), &m->protocol, err);
    if (r >= 0)
        r = gsn_panel_list(m->store, id, &m->panels, err);
    if (r >= 0)
        r = hold_duplicates(m, err);
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
static int take_rows(struct gsn_material *m, struct gsn_store *store, int64_t id,
                     struct gsn_error *err)
{
    int r;

    m->store = store;
    m->specimen.read = read_object;
    m->specimen.context = store;
    r = load_rows(m, id, err);
    if (r >= 0)
        r = take_panels(m, err);
    if (r >= 0)
        r = take_baseline(m, err);
    if (r >= 0)
        r = list_inputs(m, err);
    if (r >= 0)
        r = take_decisions(m, err);
    return r >= 0 ? make_keys(m, err) : r;
}

int gsn_material_load(struct gsn_store *store, int64_t specimen_id,
                      struct gsn_material **ret_material, struct gsn_error *err)
{
    gsn_auto(gsn_material) m = gsn_alloc_array(1, sizeof *m);
    int r;

    if (!m)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a specimen");
    r = take_rows(m, store, specimen_id, err);
    if (r >= 0)
        r = take_files(m, err);
    if (r < 0)
        return r;
    *ret_material = gsn_steal(&m);
    return GSN_OK;
}

int gsn_material_key_now(struct gsn_store *store, int64_t specimen_id, struct gsn_digest *ret_key,
                         struct gsn_error *err)
{
    gsn_auto(gsn_material) m = gsn_alloc_array(1, sizeof *m);
    const int r = m ? take_rows(m, store, specimen_id, err)
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
