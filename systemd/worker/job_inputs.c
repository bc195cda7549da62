/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The inputs of a specimen's job, loaded and hashed into the key of its run.
 *
 * Steps.
 * 1. Rows: specimen, job.json, panels, sections, operator decisions, candidates, attachments.
 * 2. Panels of one number: where they show one glass (rescan.h) the better scan is used and the
 * other kept as a spare; others are held, with the reason in their rows.
 * 3. Baseline (baseline.h).
 * 4. The list of inputs as JSON, by name and hash; what operators decided, names of people hashed.
 * 5. Key: SHA-256 of inputs, parameters, decisions and version, once with the baseline's keys and
 * once without.
 * 6. Files that the job names: mask and volume are read, calibration panels found.
 *
 * How it fails: GSN_E_IO for a damaged object, GSN_E_INPUT for a mask or volume that cannot be read
 * or a panel that an older gieson looked at. The key alone reads no object. */
#include "systemd/worker/job_inputs.h"

#include <errno.h>
#include <jansson.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/core/linalg.h"
#include "pipeline/decode/volume.h"
#include "pipeline/imaging/imaging.h"
#include "pipeline/render/lettering.h"
#include "pipeline/specimen/drawn_region.h"
#include "storage/catalog.h"
#include "storage/decision.h"
#include "storage/panel_log.h"
#include "systemd/worker/baseline.h"
#include "systemd/worker/panel_job.h"
#include "systemd/worker/rescan.h"

struct gsn_job_inputs {
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
    struct gsn_mask *region, *mask[GSN_MOST_REGIONS];
    char drawn[1 + GSN_MOST_REGIONS][GSN_DRAWN_SENTENCE]; /* of the main region and the named */
    struct gsn_grid *volume;
    struct gsn_specimen_region named[GSN_MOST_REGIONS];
    struct gsn_baseline *baseline;
    char *inputs;
    struct gsn_digest key, own_key;
};

enum { MOST_VOLUME_BYTES = 1 << 30 };

/* Files that the job names. */

static const char *find_attached(const struct gsn_job_inputs *m, const char *name)
{
    for (size_t i = 0; name && i < m->attachments->count; i++)
        if (strcmp(m->attachments->at[i].name, name) == 0)
            return m->attachments->at[i].sha256;
    return NULL;
}

/* Headers name their data file, so the attached files get their own names again for a moment: as
 * links in a folder of their own. gives: the folder. */
static int link_files(const struct gsn_job_inputs *m, char **ret_folder, struct gsn_error *err)
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

static void sweep_links(const struct gsn_job_inputs *m, const char *folder)
{
    for (size_t i = 0; i < m->attachments->count; i++) {
        gsn_auto_mem(char) link = gsn_format("%s/%s", folder, m->attachments->at[i].name);

        if (link)
            (void)unlink(link);
    }
    (void)rmdir(folder);
}

/* gives: the mask, where the region names a file; said: where it was drawn, if it was. */
static int read_mask(const struct gsn_region *region, const char *folder, double unit_um,
                     struct gsn_mask **ret_mask, char said[GSN_DRAWN_SENTENCE],
                     struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(uint8_t) text = NULL;
    size_t size = 0;
    int r;

    if (!region->file)
        return GSN_OK;
    path = gsn_format("%s/%s", folder, region->file);
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (region->kind != GSN_REGION_DRAWN)
        return gsn_volume_read_mask(path, MOST_VOLUME_BYTES, unit_um, ret_mask, err);
    r = gsn_file_read(path, GSN_DRAWN_MOST_BYTES, &text, &size, err);
    return r < 0 ? r : gsn_drawn_region_read(region, (const char *)text, size, ret_mask, said, err);
}

static int read_volumes(struct gsn_job_inputs *m, const char *folder, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;
    const double unit_um = p->spacing_unit == GSN_SPACING_MM ? 1000 : 1;
    int r = read_mask(&p->region, folder, unit_um, &m->region, m->drawn[0], err);

    for (size_t i = 0; r >= 0 && i < p->named_count; i++)
        r = read_mask(&p->named[i].region, folder, unit_um, &m->mask[i], m->drawn[1 + i], err);
    if (r >= 0 && p->kind == GSN_KIND_VOLUME) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, p->file);

        r = path ? gsn_volume_read_grid(path, MOST_VOLUME_BYTES, unit_um, &m->volume, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");
    }
    return r;
}

/* Nobody knows the folder of links: sentences begin with the file's own name. */
static void drop_folder(const char *folder, struct gsn_error *err)
{
    const size_t length = strlen(folder);

    if (strncmp(err->text, folder, length) == 0 && err->text[length] == '/')
        memmove(err->text, err->text + length + 1, strlen(err->text + length + 1) + 1);
}

static int find_calibrations(struct gsn_job_inputs *m, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;

    m->calibration_sha256 =
        gsn_alloc_array(p->calibration_count + 1, sizeof *m->calibration_sha256);
    if (!m->calibration_sha256)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the calibration panels");
    for (size_t i = 0; i < p->calibration_count; i++)
        m->calibration_sha256[i] = find_attached(m, p->calibration[i].file);
    m->specimen.calibration_sha256 = m->calibration_sha256;
    return GSN_OK;
}

static int has_files(const struct gsn_protocol *p)
{
    int has = p->region.file || p->kind == GSN_KIND_VOLUME;

    for (size_t i = 0; i < p->named_count; i++)
        has |= p->named[i].region.file != NULL;
    return has;
}

/* Reads every file that the job names. */
static int take_files(struct gsn_job_inputs *m, struct gsn_error *err)
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
    if (has_files(m->protocol)) {
        r = link_files(m, &folder, err);
        if (r >= 0)
            r = read_volumes(m, folder, err);
        if (r < 0 && folder)
            drop_folder(folder, err);
        if (folder)
            sweep_links(m, folder);
    }
    m->specimen.region = m->region;
    m->specimen.region_drawn = m->drawn[0][0] ? m->drawn[0] : NULL;
    for (size_t i = 0; i < m->protocol->named_count; i++) {
        m->named[i].mask = m->mask[i];
        m->named[i].drawn = m->drawn[1 + i][0] ? m->drawn[1 + i] : NULL;
    }
    m->specimen.volume = m->volume;
    if (m->protocol->kind == GSN_KIND_TILE)
        m->specimen.picture_sha256 = find_attached(m, m->protocol->file);
    if (m->protocol->kind == GSN_KIND_TILE && m->protocol->reference[0])
        m->specimen.reference_sha256 = find_attached(m, m->protocol->reference);
    return r < 0 ? r : find_calibrations(m, err);
}

/* Panels. */

static int is_clash(const struct gsn_panel_row *a, const struct gsn_panel_row *b)
{
    return a->number == b->number && strcmp(a->state, "registered") == 0 &&
           strcmp(b->state, "registered") == 0;
}

/* Sections of a panel whose three marks were found. */
static size_t count_found(const struct gsn_section_rows *sections, const struct gsn_panel_row *p)
{
    size_t count = 0;

    for (size_t i = 0; i < sections->count; i++)
        count += sections->at[i].panel_id == p->id && strcmp(sections->at[i].state, "found") == 0;
    return count;
}

/* Of two scans of one glass the one that shows more of it: sections with their marks, then finer
 * pixels; of equals the later one, since who scans a glass again wants that scan. */
static int is_better(const struct gsn_section_rows *sections, const struct gsn_panel_row *a,
                     const struct gsn_panel_row *b)
{
    const size_t found_a = count_found(sections, a), found_b = count_found(sections, b);

    if (found_a != found_b)
        return found_a > found_b;
    if (a->px_um < b->px_um || a->px_um > b->px_um)
        return a->px_um < b->px_um;
    return a->id > b->id;
}

/* Of two scans of one glass one is used and the other kept beside it. Two glasses of one number are
 * both held: which of them is right is for a person to say. */
static int resolve_clash(struct gsn_job_inputs *m, struct gsn_decoder *decoder,
                         const struct gsn_section_rows *sections, const struct gsn_panel_row *a,
                         const struct gsn_panel_row *b, struct gsn_error *err)
{
    const struct gsn_panel_row *const pair[2] = { a, b };
    struct gsn_rescan rescan = { .same = 0 };
    int r = gsn_rescan_compare(m->store, decoder, m->protocol, sections, a, b, &rescan, err);

    for (int i = 0; r >= 0 && i < 2; i++) {
        const struct gsn_panel_row *panel = pair[i], *other = pair[1 - i];
        gsn_auto_mem(char) sentence = NULL;

        if (rescan.same && is_better(sections, panel, other))
            continue;
        sentence =
            rescan.same
                ? gsn_format(
                      "another scan of panel %lld is used, %.200s: both show the same glass "
                      "(%zu marks agree to %.1f um, the tissue to %.0f %%); this one is kept "
                      "beside it",
                      (long long)panel->number, other->file_name, rescan.marks, rescan.apart_um,
                      100 * rescan.texture)
                : gsn_format("panel number %lld is claimed by %.200s as well, which shows another "
                             "glass: say which to use, or rename one and import again",
                             (long long)panel->number, other->file_name);
        if (!sentence)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory");
        r = gsn_panel_set_state(m->store, panel->id, "held",
                                rescan.same ? GSN_PANEL_SPARE : gsn_code_name(GSN_E_WITHHELD),
                                sentence, err);
    }
    return r;
}

/* Of panels that claim one number and show one glass the better scan is used; of others all are
 * held. Lists the panels anew. decoder: as for gsn_decode_apart(). */
/* Every pair that claims one number, those that a pair before resolved left out. */
static int resolve_duplicates(struct gsn_job_inputs *m, struct gsn_decoder *decoder,
                              struct gsn_error *err)
{
    for (;;) {
        gsn_auto(gsn_section_rows) sections = NULL;
        const struct gsn_panel_row *a = NULL, *b = NULL;
        int r = gsn_section_list(m->store, m->row->id, &sections, err);

        for (size_t i = 0; r >= 0 && !b && i < m->panels->count; i++)
            for (size_t j = i + 1; !b && j < m->panels->count; j++)
                if (is_clash(&m->panels->at[i], &m->panels->at[j])) {
                    a = &m->panels->at[i];
                    b = &m->panels->at[j];
                }
        if (r < 0 || !b)
            return r;
        r = resolve_clash(m, decoder, sections, a, b, err);
        if (r < 0)
            return r;
        gsn_panel_rows_free(m->panels);
        m->panels = NULL;
        r = gsn_panel_list(m->store, m->row->id, &m->panels, err);
        if (r < 0)
            return r;
    }
}

/* Refuses panels that lack their turn (panel_job.h). */
static int check_turns(const struct gsn_job_inputs *m, struct gsn_error *err)
{
    for (size_t i = 0; i < m->panels->count; i++)
        if (gsn_panel_lacks_turn(&m->panels->at[i]))
            return gsn_fail(err, GSN_E_INPUT,
                            "panel %s was looked at by an older gieson, which did not keep how it "
                            "lies: import its folder again with --replace, then say `gieson run`",
                            m->panels->at[i].file_name);
    return GSN_OK;
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
static struct gsn_panel_section section_of(const struct gsn_job_inputs *m,
                                           const struct gsn_section_row *row)
{
    struct gsn_panel_section section = gsn_panel_section_of_row(row);

    if (section.sighting == GSN_SIGHT_NEEDS_EYE || gsn_flags_has(&section.flags, GSN_FLAG_DECIDED))
        gsn_candidates_from_rows(m->candidates, row->panel_id, row->slot, &section.candidates);
    /* One that was taken as it was so likely, and not by a person, is taken again or not. */
    if (!gsn_flags_has(&section.flags, GSN_FLAG_DECIDED))
        section.candidates.chosen = 0;
    return section;
}

static struct gsn_orientation upright_of(const struct gsn_panel_row *row)
{
    struct gsn_orientation upright = { .turn = { .mirrored = row->mirrored != 0,
                                                 .quarters = (unsigned)row->quarters } };

    (void)snprintf(upright.note, sizeof upright.note, "%s", row->turn_note);
    return upright;
}

/* The panels and their sections as they were logged. */
static int take_panels(struct gsn_job_inputs *m, struct gsn_error *err)
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
                                                   .upright = upright_of(row),
                                                   .section_count = used - first,
                                                   .section = m->section + first };
    }
    m->specimen.panel = m->panel;
    m->specimen.panel_count = m->panels->count;
    return GSN_OK;
}

/* All inputs by name and hash. */
static int list_inputs(struct gsn_job_inputs *m, struct gsn_error *err)
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
static int take_decisions(struct gsn_job_inputs *m, struct gsn_error *err)
{
    m->decision = gsn_alloc_array(m->decided->count, sizeof *m->decision);
    m->pose = gsn_alloc_array(m->decided->count, sizeof *m->pose);
    if (!m->decision || !m->pose)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for what was decided");
    for (size_t i = 0; i < m->decided->count; i++) {
        const struct gsn_decision_row *row = &m->decided->at[i];
        const unsigned pose = gsn_decisions_pose(row->answer);

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
static json_t *hash_json(const char *text)
{
    struct gsn_digest digest = { "" };

    return gsn_sha256(text, strlen(text), &digest, NULL) < 0 ? json_null()
                                                             : json_string(digest.hex);
}

/* A report that rests on an answer is another report, and says who gave it, when and why. */
static void add_decisions(const struct gsn_job_inputs *m, json_t *root)
{
    json_t *answers = json_array();

    for (size_t i = 0; i < m->decided->count; i++)
        (void)json_array_append_new(answers, json_pack("{s:I, s:I, s:s, s:o, s:o, s:I}", "panel",
                                                       (json_int_t)m->decided->at[i].number, "slot",
                                                       (json_int_t)m->decided->at[i].slot, "answer",
                                                       m->decided->at[i].answer, "by",
                                                       hash_json(m->decided->at[i].actor), "reason",
                                                       hash_json(m->decided->at[i].reason), "time",
                                                       (json_int_t)m->decided->at[i].time));
    if (json_array_size(answers) > 0)
        (void)json_object_set(root, "decisions", answers);
    json_decref(answers);
}

/* The keys of what has been taken so far: with the baseline and without it. */
static int make_keys(struct gsn_job_inputs *m, struct gsn_error *err)
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
                              json_pack("{s:s, s:s, s:s, s:s}", "opencv", gsn_imaging_version(),
                                        "gsl", gsn_linalg_version(), "cairo", gsn_lettering_cairo(),
                                        "pango", gsn_lettering_pango()));
    r = hash_text(root, NULL, &m->own_key, err);
    (void)json_object_set(root, "baseline", gsn_baseline_keys(m->baseline));
    if (r >= 0)
        r = hash_text(root, &m->inputs, &m->key, err);
    json_decref(root);
    m->specimen.key = m->key.hex;
    return r;
}

/* Gathering. */

static int take_baseline(struct gsn_job_inputs *m, struct gsn_error *err)
{
    const int r = gsn_baseline_load(m->store, m->row, m->protocol, &m->baseline, err);

    if (r < 0)
        return r;
    m->specimen.baseline = *gsn_baseline_of_region(m->baseline, 0);
    for (size_t i = 0; i < m->protocol->named_count; i++)
        m->named[i].baseline = *gsn_baseline_of_region(m->baseline, 1 + i);
    m->specimen.named = m->named;
    return GSN_OK;
}

static int open_object(void *context, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    return gsn_object_open(context, sha256, ret_fd, err);
}

/* Which of two scans of one panel is used is found only where their pictures may be opened. */
static int load_rows(struct gsn_job_inputs *m, int64_t id, int resolves,
                     struct gsn_decoder *decoder, struct gsn_error *err)
{
    int r = gsn_specimen_get_by_id(m->store, id, &m->row, err);

    if (r >= 0)
        r = gsn_protocol_parse(m->row->job_json, strlen(m->row->job_json), &m->protocol, err);
    if (r >= 0)
        r = gsn_panel_list(m->store, id, &m->panels, err);
    if (r >= 0 && resolves)
        r = resolve_duplicates(m, decoder, err);
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
static int take_rows(struct gsn_job_inputs *m, struct gsn_store *store, int64_t id, int resolves,
                     struct gsn_decoder *decoder, struct gsn_error *err)
{
    int r;

    m->store = store;
    m->specimen.open = open_object;
    m->specimen.context = store;
    r = load_rows(m, id, resolves, decoder, err);
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

int gsn_job_inputs_load(struct gsn_store *store, int64_t specimen_id, struct gsn_decoder *decoder,
                        struct gsn_job_inputs **ret_inputs, struct gsn_error *err)
{
    gsn_auto(gsn_job_inputs) m = gsn_alloc_array(1, sizeof *m);
    int r;

    if (!m)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a specimen");
    r = take_rows(m, store, specimen_id, 1, decoder, err);
    if (r >= 0)
        r = check_turns(m, err);
    if (r >= 0)
        r = take_files(m, err);
    if (r >= 0)
        r = gsn_baseline_take_models(m->baseline, store, err);
    if (r < 0)
        return r;
    *ret_inputs = gsn_steal(&m);
    return GSN_OK;
}

int gsn_job_inputs_key_now(struct gsn_store *store, int64_t specimen_id, struct gsn_digest *ret_key,
                           struct gsn_error *err)
{
    gsn_auto(gsn_job_inputs) m = gsn_alloc_array(1, sizeof *m);
    const int r = m ? take_rows(m, store, specimen_id, 0, NULL, err)
                    : gsn_fail(err, GSN_E_NOMEM, "out of memory for a specimen");

    if (r >= 0)
        *ret_key = m->key;
    return r;
}

void gsn_job_inputs_free(struct gsn_job_inputs *m)
{
    if (!m)
        return;
    gsn_baseline_free(m->baseline);
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
    for (size_t i = 0; i < GSN_MOST_REGIONS; i++)
        gsn_mask_free(m->mask[i]);
    gsn_free(m->inputs);
    gsn_free(m);
}

/* Access */

const struct gsn_specimen *gsn_job_inputs_specimen(const struct gsn_job_inputs *m)
{
    return &m->specimen;
}

const char *gsn_job_inputs_key(const struct gsn_job_inputs *m)
{
    return m->key.hex;
}

const char *gsn_job_inputs_json(const struct gsn_job_inputs *m)
{
    return m->inputs;
}

const char *gsn_job_inputs_own_key(const struct gsn_job_inputs *m)
{
    return m->own_key.hex;
}
