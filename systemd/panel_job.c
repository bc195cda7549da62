/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/panel_job.h"

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/decode/apart.h"
#include "storage/catalog.h"
#include "storage/result.h"
#include "systemd/answers.h"
#include "systemd/candidates.h"
#include "systemd/marker_rows.h"
#include "systemd/rescan.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

enum { MOST_OBJECT_BYTES = 1 << 30 };

int gsn_is_refusal(int code)
{
    return code == GSN_E_INPUT || code == GSN_E_UNSUPPORTED || code == GSN_E_LIMIT ||
           code == GSN_E_STAIN || code == GSN_E_MARKERS;
}

static int check_digest(const char *sha256, const struct gsn_digest *digest, struct gsn_error *err)
{
    if (strcmp(digest->hex, sha256) == 0)
        return GSN_OK;
    return gsn_fail(err, GSN_E_IO,
                    "the stored object %s is damaged: its bytes no longer have this hash; "
                    "import the original again",
                    sha256);
}

int gsn_object_read(struct gsn_store *store, const char *sha256, uint8_t **ret_bytes,
                    size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_digest digest;
    size_t size;
    int r = gsn_store_object_path(store, sha256, &path, err);

    if (r >= 0)
        r = gsn_file_read(path, MOST_OBJECT_BYTES, &bytes, &size, err);
    if (r >= 0)
        r = gsn_sha256(bytes, size, &digest, err);
    if (r >= 0)
        r = check_digest(sha256, &digest, err);
    if (r < 0)
        return r;
    *ret_bytes = gsn_steal(&bytes);
    *ret_size = size;
    return GSN_OK;
}

int gsn_object_open(struct gsn_store *store, const char *sha256, int *ret_fd, struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    gsn_auto_fd fd = -1;
    struct gsn_digest digest;
    int r = gsn_store_object_path(store, sha256, &path, err);

    if (r >= 0)
        r = gsn_file_open(path, &fd, err);
    if (r >= 0)
        r = gsn_sha256_file(fd, path, &digest, NULL, err);
    if (r >= 0)
        r = check_digest(sha256, &digest, err);
    if (r < 0)
        return r;
    *ret_fd = fd;
    fd = -1;
    return GSN_OK;
}

static struct gsn_section_row row_of(const struct gsn_panel_section *s)
{
    struct gsn_section_row row = { .slot = s->slot + 1,
                                   .serial = s->serial + 1,
                                   .state = gsn_sighting_name(s->sighting),
                                   .flags = s->flags,
                                   .bbox_x = s->x,
                                   .bbox_y = s->y,
                                   .bbox_w = s->width,
                                   .bbox_h = s->height,
                                   .area_px = s->area_px };

    gsn_marks_to_rows(s->mark, row.marker);
    return row;
}

struct gsn_panel_section gsn_panel_section_of_row(const struct gsn_section_row *row)
{
    struct gsn_panel_section s = { .serial = (unsigned)(row->serial - 1),
                                   .slot = (unsigned)(row->slot - 1),
                                   .sighting = GSN_SIGHT_NEEDS_EYE,
                                   .x = (int)row->bbox_x,
                                   .y = (int)row->bbox_y,
                                   .width = (int)row->bbox_w,
                                   .height = (int)row->bbox_h,
                                   .area_px = row->area_px };

    for (int i = GSN_SIGHT_FOUND; i <= GSN_SIGHT_HELD; i++)
        if (strcmp(row->state, gsn_sighting_name((enum gsn_sighting)i)) == 0)
            s.sighting = (enum gsn_sighting)i;
    (void)snprintf(s.flags, sizeof s.flags, "%s", row->flags);
    gsn_marks_from_rows(row->marker, s.mark);
    return s;
}

int gsn_panel_lacks_turn(const struct gsn_panel_row *row)
{
    return strcmp(row->state, "registered") == 0 && !row->turn_known;
}

/* Why this panel may not be used although its picture is fine, or GSN_OK. */
static int check_number(const struct gsn_panel_row *panel, const struct gsn_protocol *protocol,
                        struct gsn_error *why)
{
    if (panel->number == 0)
        return gsn_fail(why, GSN_E_WITHHELD,
                        "its name holds no panel number: rename it (...P03.tif) and import again");
    if (protocol->panels && panel->number > protocol->panels)
        return gsn_fail(why, GSN_E_WITHHELD,
                        "panel number %lld, but job.json says there are %u: rename it or correct "
                        "\"panels\"",
                        (long long)panel->number, protocol->panels);
    return GSN_OK;
}

/* A report that was made without this panel, or with what it was before, is made again. */
static int ask_for_report(struct gsn_store *store, int64_t specimen, struct gsn_error *err)
{
    gsn_auto(gsn_run_row) run = NULL;
    int64_t job;
    const int r = gsn_run_latest(store, specimen, NULL, &run, err);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    return r < 0 ? r : gsn_queue_add(store, specimen, 0, &job, err);
}

static int keep_candidates(struct gsn_store *store, int64_t panel_id,
                           const struct gsn_panel_findings *findings, size_t count,
                           struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_candidate_row) rows =
        gsn_alloc_array(count * GSN_CANDIDATES, sizeof *rows);
    size_t used = 0;

    if (!rows)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the candidates of a panel");
    for (size_t i = 0; i < count; i++)
        used += gsn_candidates_to_rows(&findings->section[i].candidates,
                                       findings->section[i].slot + 1, &rows[used]);
    return gsn_candidate_replace(store, panel_id, rows, used, err);
}

/* What became of a panel: its rows. */
struct outcome {
    struct gsn_panel_findings *findings; /* NULL: none */
    const char *state, *code, *message;
    struct gsn_error why; /* of one that is not registered */
};

static void outcome_done(struct outcome *outcome)
{
    gsn_panel_findings_free(outcome->findings);
}
#define auto_outcome __attribute__((cleanup(outcome_done))) struct outcome

/* In a transaction. */
static int write_outcome(struct gsn_store *store, int64_t panel, const struct outcome *outcome,
                         struct gsn_error *err)
{
    const struct gsn_panel_findings *const findings = outcome->findings;
    const size_t count =
        findings && strcmp(outcome->state, "registered") == 0 ? findings->count : 0;
    gsn_auto_mem(struct gsn_section_row) rows = gsn_alloc_array(count, sizeof *rows);
    int r = GSN_OK;

    if (!rows)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the rows of a panel");
    for (size_t i = 0; i < count; i++)
        rows[i] = row_of(&findings->section[i]);
    if (findings)
        r = gsn_panel_set_size(store, panel, findings->width, findings->height, findings->px_um,
                               err);
    if (r >= 0 && findings)
        r = gsn_panel_set_turn(store, panel, findings->upright.turn.mirrored,
                               findings->upright.turn.quarters, findings->upright.note, err);
    if (r >= 0)
        r = gsn_section_replace(store, panel, rows, count, err);
    if (r >= 0)
        r = keep_candidates(store, panel, findings, count, err);
    return r < 0 ? r
                 : gsn_panel_set_state(store, panel, outcome->state, outcome->code,
                                       outcome->message, err);
}

/* The panel's rows and the end of the job, all or nothing. */
static int keep(struct gsn_store *store, const struct gsn_job_row *job,
                const struct outcome *outcome, struct gsn_error *err)
{
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = write_outcome(store, job->panel_id, outcome, err);
    if (r >= 0)
        r = ask_for_report(store, job->specimen_id, err);
    if (r >= 0)
        r = gsn_queue_done(store, job, err);
    if (r < 0) {
        gsn_store_rollback(store);
        return r;
    }
    return gsn_store_commit(store, err);
}

/* ---- what the label says ----------------------------------------------------------------- */

static int follows(const char *name, const char *begin)
{
    const size_t length = strlen(begin);

    return length > 0 && strncmp(name, begin, length) == 0 &&
           (!name[length] || strchr("-_ .", name[length]));
}

/* Whether the subject of a label ("GVP-D-S01") is this specimen: its name, with or without the
 * study before it, and with or without more behind it on either side. */
static int is_subject(const struct gsn_specimen_row *specimen, const char *subject)
{
    const char *rest = subject;

    if (follows(subject, specimen->study) && subject[strlen(specimen->study)])
        rest = subject + strlen(specimen->study) + 1;
    return follows(specimen->name, subject) || follows(subject, specimen->name) ||
           follows(specimen->name, rest) || follows(rest, specimen->name);
}

static int is_known(struct gsn_store *store, const char *subject, int *ret_known,
                    struct gsn_error *err)
{
    gsn_auto(gsn_specimen_rows) all = NULL;
    const int r = gsn_specimen_list(store, &all, err);

    *ret_known = 0;
    for (size_t i = 0; r >= 0 && i < all->count; i++)
        *ret_known |= is_subject(&all->at[i], subject);
    return r;
}

/* A label that contradicts the file's name holds the panel, with both named. Whoever it belongs to
 * is for a person to say; nothing is ever created from a label. */
static int check_label(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                       const struct gsn_panel_row *panel, const struct gsn_panel_findings *findings,
                       struct gsn_error *why)
{
    int known = 0, r;

    if (findings->label_number == 0)
        return GSN_OK;
    if (!is_subject(specimen, findings->label_subject)) {
        r = is_known(store, findings->label_subject, &known, why);
        if (r < 0)
            return r;
        if (!known)
            return gsn_fail(why, GSN_E_WITHHELD,
                            "its label says %s, and no specimen here is called %s: import its job "
                            "first, or correct the label; nothing was created",
                            findings->label, findings->label_subject);
        return gsn_fail(why, GSN_E_WITHHELD,
                        "its label says %s, but it came as panel %lld of %s: look at the glass, "
                        "then import it where it belongs",
                        findings->label, (long long)panel->number, specimen->name);
    }
    if (panel->number && findings->label_number != (unsigned)panel->number)
        return gsn_fail(why, GSN_E_WITHHELD,
                        "its label says %s, but its file %s is panel %lld: look at the glass, then "
                        "rename the file and import again",
                        findings->label, panel->file_name, (long long)panel->number);
    return GSN_OK;
}

/* ---- which of two scans ------------------------------------------------------------------ */

static int is_chosen(const struct gsn_decision_rows *decided, const struct gsn_panel_row *panel)
{
    const char *chosen = gsn_answers_chosen(decided, panel->number);

    return chosen && strcmp(chosen, panel->sha256) == 0;
}

static int check_choice(const struct gsn_decision_rows *decided, const struct gsn_panel_row *panel,
                        struct gsn_error *why)
{
    if (!gsn_answers_chosen(decided, panel->number) || is_chosen(decided, panel))
        return GSN_OK;
    return gsn_fail(why, GSN_E_WITHHELD,
                    "another scan of panel %lld was chosen; this one is kept beside it",
                    (long long)panel->number);
}

static int examine(struct gsn_store *store, struct gsn_decoder *decoder,
                   const struct gsn_panel_row *panel, const struct gsn_protocol *protocol,
                   const struct gsn_decision_rows *decided, const struct gsn_job_options *options,
                   const struct gsn_progress *progress, struct gsn_panel_findings **ret_findings,
                   struct gsn_error *err)
{
    gsn_auto_fd picture_fd = -1;
    gsn_auto_mem(struct gsn_panel_answer) answer = NULL;
    struct gsn_panel_answers answers = { 0 };
    int r = gsn_object_open(store, panel->sha256, &picture_fd, err);

    if (r >= 0)
        r = gsn_answers_read(decided, panel->number, panel->sha256, &answer, &answers.count, err);
    answers.at = answer;

    if (r >= 0)
        r = gsn_panel_examine(decoder, picture_fd, protocol,
                              (unsigned)(panel->number ? panel->number : 1), &answers,
                              options->threads, progress, ret_findings, err);
    return r;
}

/* Looks at a panel's picture. Fails when that cannot be done (memory, disk, store); a panel that is
 * refused or held is an outcome. */
static int look(struct gsn_store *store, int64_t specimen_id, int64_t panel_id,
                const struct gsn_job_options *options, const struct gsn_progress *progress,
                struct outcome *outcome, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_row) specimen = NULL;
    gsn_auto(gsn_panel_row) panel = NULL;
    gsn_auto(gsn_protocol) protocol = NULL;
    gsn_auto(gsn_decision_rows) decided = NULL;
    gsn_auto(gsn_decoder) decoder = NULL;
    struct gsn_error *const why = &outcome->why;
    int spare = 0, r = gsn_specimen_get_by_id(store, specimen_id, &specimen, err);

    if (r >= 0)
        r = gsn_panel_get(store, panel_id, &panel, err);
    if (r >= 0)
        r = gsn_protocol_parse(specimen->job_json, strlen(specimen->job_json), &protocol, err);
    if (r >= 0)
        r = gsn_decision_list(store, specimen_id, &decided, err);
    if (r >= 0 && options->decoder)
        r = gsn_decoder_new(options->decoder, &decoder, err);
    if (r < 0)
        return r;
    r = examine(store, decoder, panel, protocol, decided, options, progress, &outcome->findings,
                why);
    if (r >= 0)
        r = check_number(panel, protocol, why);
    if (r >= 0)
        r = check_label(store, specimen, panel, outcome->findings, why);
    spare = r >= 0 && (r = check_choice(decided, panel, why)) == GSN_E_WITHHELD;
    if (r >= 0 && !is_chosen(decided, panel))
        r = gsn_rescan_check(store, decoder, protocol, panel, outcome->findings, why);
    outcome->code = r >= 0 ? "" : spare ? GSN_PANEL_SPARE : gsn_code_name(r);
    outcome->message = r < 0 ? why->text : outcome->findings->note;
    /* Held: the picture is fine, and only a person can say what it shows. */
    if (r >= 0)
        outcome->state = "registered";
    else if (r == GSN_E_WITHHELD)
        outcome->state = "held";
    else if (!outcome->findings && gsn_is_refusal(r))
        outcome->state = "refused";
    if (outcome->state)
        return GSN_OK;
    if (err)
        *err = *why;
    return r;
}

int gsn_panel_job(struct gsn_store *store, const struct gsn_job_row *job,
                  const struct gsn_job_options *options, const struct gsn_progress *progress,
                  struct gsn_error *err)
{
    auto_outcome outcome = { .findings = NULL };
    const int r = look(store, job->specimen_id, job->panel_id, options, progress, &outcome, err);

    return r < 0 ? r : keep(store, job, &outcome, err);
}

int gsn_panel_look_again(struct gsn_store *store, int64_t specimen_id, int64_t panel_id,
                         const struct gsn_job_options *options, struct gsn_error *err)
{
    auto_outcome outcome = { .findings = NULL };
    const int r = look(store, specimen_id, panel_id, options, NULL, &outcome, err);

    return r < 0 ? r : write_outcome(store, panel_id, &outcome, err);
}
