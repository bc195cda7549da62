/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The job that examines one panel's picture, and what the database keeps of a panel as records.
 *
 * Steps.
 * 1. The object is opened after its bytes were found to have its hash.
 * 2. Operator decisions about this very picture (its hash) are read; one that chooses among scans
 * is followed.
 * 3. pipeline/specimen/panel_analysis.h splits the panel, finds the fiducial marks and the way it
 * lies.
 * 4. What the label or the name says is compared with the job; a contradiction holds the panel.
 * 5. Sections, candidates of doubtful poses, the turn, and the end of the job are one transaction.
 *
 * Marks, candidates and decisions have their conversions between row and record here, both ways.
 *
 * How it fails: a picture that is refused or held is a row with a sentence, not a failure; failing
 * means that the job itself could not be done (memory, disk, store), and it is tried again. */
#include "systemd/worker/panel_job.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "pipeline/decode/apart.h"
#include "storage/catalog.h"
#include "storage/result.h"
#include "systemd/worker/rescan.h"

_Static_assert((int)GSN_ROW_MARKS == (int)GSN_FIDUCIALS, "a row has room for a section's marks");

/* Rows and records. */

void gsn_fiducials_to_rows(const struct gsn_fiducial mark[GSN_FIDUCIALS],
                           struct gsn_fiducial_row ret_rows[GSN_ROW_MARKS])
{
    for (size_t m = 0; m < GSN_FIDUCIALS; m++)
        ret_rows[m] = (struct gsn_fiducial_row){ .found = mark[m].found,
                                                 .x_px = mark[m].px.x,
                                                 .y_px = mark[m].px.y,
                                                 .radius_px = mark[m].radius_px,
                                                 .cov_xx = mark[m].cov_xx,
                                                 .cov_xy = mark[m].cov_xy,
                                                 .cov_yy = mark[m].cov_yy,
                                                 .score = mark[m].score };
}

void gsn_fiducials_from_rows(const struct gsn_fiducial_row rows[GSN_ROW_MARKS],
                             struct gsn_fiducial ret_mark[GSN_FIDUCIALS])
{
    for (size_t m = 0; m < GSN_FIDUCIALS; m++) {
        const struct gsn_fiducial_row *row = &rows[m];

        ret_mark[m] = row->found ? (struct gsn_fiducial){ .px = { row->x_px, row->y_px },
                                                          .radius_px = row->radius_px,
                                                          .cov_xx = row->cov_xx,
                                                          .cov_xy = row->cov_xy,
                                                          .cov_yy = row->cov_yy,
                                                          .score = row->score,
                                                          .found = 1 }
                                 : (struct gsn_fiducial){ 0 };
    }
}

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
        gsn_fiducials_to_rows(c->mark, row->marker);
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
    gsn_fiducials_from_rows(row->marker, c.mark);
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

/* "slot 5" is 4; UINT_MAX when the text is no such thing. */
static unsigned number_behind(const char *text, const char *word)
{
    const size_t length = strlen(word);
    char *end;
    unsigned long number;

    if (strncmp(text, word, length) != 0 || text[length] != ' ')
        return UINT_MAX;
    number = strtoul(text + length + 1, &end, 10);
    return *end || number < 1 || number > 100000 ? UINT_MAX : (unsigned)number - 1;
}

unsigned gsn_decisions_pose(const char *answer)
{
    unsigned long number;
    char *end;

    if (strncmp(answer, "pose ", 5) != 0)
        return 0;
    number = strtoul(answer + 5, &end, 10);
    return strncmp(end, " of ", 4) == 0 && number >= 1 && number <= 100 ? (unsigned)number : 0;
}

/* "812.3", as it is written: one digit behind the point. */
static const char *take_tenths(const char *at, double *ret)
{
    char *end;
    unsigned long whole;

    if (*at < '0' || *at > '9')
        return NULL;
    whole = strtoul(at, &end, 10);
    if (end[0] != '.' || end[1] < '0' || end[1] > '9' || whole > 10000000)
        return NULL;
    *ret = (double)whole + (end[1] - '0') / 10.0;
    return end + 2;
}

/* " X,Y" or " -". */
static const char *take_mark(const char *at, struct gsn_point *ret_px, int *ret_found)
{
    if (!at || *at++ != ' ')
        return NULL;
    *ret_found = *at != '-';
    if (!*ret_found)
        return at + 1;
    at = take_tenths(at, &ret_px->x);
    return at && *at == ',' ? take_tenths(at + 1, &ret_px->y) : NULL;
}

/* "pose 2 of <sha256> up 812.3,933.1 400.0,533.2 -" */
static int read_pose(const char *text, const char *sha256, struct gsn_panel_answer *answer)
{
    enum { DIGITS = 64 };
    const char *at = gsn_decisions_pose(text) ? strstr(text, " of ") + 4 : NULL;

    if (!at || strspn(at, "0123456789abcdef") != DIGITS)
        return 0;
    answer->elsewhere = strncmp(at, sha256, DIGITS) != 0;
    at += DIGITS;
    answer->choice.mirrored = strncmp(at, " down", 5) == 0;
    if (!answer->choice.mirrored && strncmp(at, " up", 3) != 0)
        return 0;
    at += answer->choice.mirrored ? 5 : 3;
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        at = take_mark(at, &answer->choice.px[i], &answer->choice.found[i]);
    return at && !*at;
}

static int read_answer(const struct gsn_decision_row *row, const char *sha256,
                       struct gsn_panel_answer *ret)
{
    const unsigned seat = number_behind(row->answer, "slot");
    const unsigned first = number_behind(row->answer, "first");
    struct gsn_panel_answer answer = { .slot = (unsigned)(row->slot > 0 ? row->slot - 1 : 0),
                                       .at_px = { row->x_px, row->y_px } };

    if (row->slot > 0 && strcmp(row->answer, "cut") == 0)
        answer.said = GSN_SAID_CUT;
    else if (row->slot > 0 && strcmp(row->answer, "hold") == 0)
        answer.said = GSN_SAID_HOLD;
    else if (row->slot > 0 && strcmp(row->answer, "dismiss") == 0)
        answer.said = GSN_SAID_DISMISS;
    else if (row->slot > 0 && seat != UINT_MAX)
        answer.said = GSN_SAID_SEAT;
    else if (row->slot > 0 && read_pose(row->answer, sha256, &answer))
        answer.said = GSN_SAID_POSE;
    else if (row->slot == 0 && first != UINT_MAX)
        answer.said = GSN_SAID_FIRST;
    else if (row->slot == 0 && strcmp(row->answer, "as-set") == 0)
        answer.said = GSN_SAID_AS_SET;
    else if (row->slot == 0 && strcmp(row->answer, "as-marked") == 0)
        answer.said = GSN_SAID_AS_MARKED;
    else
        return 0;
    answer.to = answer.said == GSN_SAID_FIRST ? first : seat != UINT_MAX ? seat : 0;
    *ret = answer;
    return 1;
}

/* gives: the answers about this panel's own picture, whose scan has this hash. An answer of an
 * unknown form is passed over: a newer program may have written it. Fails with GSN_E_NOMEM. */
static int read_decisions(const struct gsn_decision_rows *rows, int64_t number, const char *sha256,
                          struct gsn_panel_answer **ret_answers, size_t *ret_count,
                          struct gsn_error *err)
{
    struct gsn_panel_answer *answers = gsn_alloc_array(rows->count, sizeof *answers);
    size_t count = 0;

    if (!answers)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for what was decided");
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].number == number)
            count += (size_t)read_answer(&rows->at[i], sha256, &answers[count]);
    *ret_answers = answers;
    *ret_count = count;
    return GSN_OK;
}

/* The hash of the scan of this panel number that was chosen, or NULL. borrows: rows. */
static const char *find_chosen(const struct gsn_decision_rows *rows, int64_t number)
{
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].number == number && rows->at[i].slot == 0 &&
            strncmp(rows->at[i].answer, "use ", 4) == 0)
            return rows->at[i].answer + 4;
    return NULL;
}

/* Refuses what no run of the same job could change: bad bytes, unsupported kinds, limits. */
static int is_refusal(int code)
{
    return code == GSN_E_INPUT || code == GSN_E_UNSUPPORTED || code == GSN_E_LIMIT ||
           code == GSN_E_STAIN || code == GSN_E_MARKERS;
}

/* The job. */

/* flags: made for the row, and borrowed by it. */
static struct gsn_section_row row_of(const struct gsn_panel_section *s, char flags[GSN_FLAGS_TEXT])
{
    struct gsn_section_row row = { .slot = s->slot + 1,
                                   .serial = s->serial + 1,
                                   .state = gsn_sighting_name(s->sighting),
                                   .flags = flags,
                                   .bbox_x = s->x,
                                   .bbox_y = s->y,
                                   .bbox_w = s->width,
                                   .bbox_h = s->height,
                                   .area_px = s->area_px };

    gsn_flags_text(&s->flags, flags);
    gsn_fiducials_to_rows(s->mark, row.marker);
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
    s.flags = gsn_flags_of_text(row->flags);
    gsn_fiducials_from_rows(row->marker, s.mark);
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
    gsn_auto_mem(char) flags = gsn_alloc_array(count, GSN_FLAGS_TEXT);
    int r = GSN_OK;

    if (!rows || !flags)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the rows of a panel");
    for (size_t i = 0; i < count; i++)
        rows[i] = row_of(&findings->section[i], flags + i * GSN_FLAGS_TEXT);
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
static int commit_outcome(struct gsn_store *store, const struct gsn_job_row *job,
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

static int has_prefix(const char *name, const char *begin)
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

    if (has_prefix(subject, specimen->study) && subject[strlen(specimen->study)])
        rest = subject + strlen(specimen->study) + 1;
    return has_prefix(specimen->name, subject) || has_prefix(subject, specimen->name) ||
           has_prefix(specimen->name, rest) || has_prefix(rest, specimen->name);
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
    const char *chosen = find_chosen(decided, panel->number);

    return chosen && strcmp(chosen, panel->sha256) == 0;
}

static int check_choice(const struct gsn_decision_rows *decided, const struct gsn_panel_row *panel,
                        struct gsn_error *why)
{
    if (!find_chosen(decided, panel->number) || is_chosen(decided, panel))
        return GSN_OK;
    return gsn_fail(why, GSN_E_WITHHELD,
                    "another scan of panel %lld was chosen; this one is kept beside it",
                    (long long)panel->number);
}

static int examine_picture(struct gsn_store *store, struct gsn_decoder *decoder,
                           const struct gsn_panel_row *panel, const struct gsn_protocol *protocol,
                           const struct gsn_decision_rows *decided,
                           const struct gsn_job_options *options,
                           const struct gsn_progress *progress,
                           struct gsn_panel_findings **ret_findings, struct gsn_error *err)
{
    gsn_auto_fd picture_fd = -1;
    gsn_auto_mem(struct gsn_panel_answer) answer = NULL;
    struct gsn_panel_answers answers = { 0 };
    int r = gsn_object_open(store, panel->sha256, &picture_fd, err);

    if (r >= 0)
        r = read_decisions(decided, panel->number, panel->sha256, &answer, &answers.count, err);
    answers.at = answer;

    if (r >= 0)
        r = gsn_panel_analyse(decoder, picture_fd, protocol,
                              (unsigned)(panel->number ? panel->number : 1), &answers,
                              options->threads, progress, ret_findings, err);
    return r;
}

/* Looks at a panel's picture. Fails when that cannot be done (memory, disk, store); a panel that is
 * refused or held is an outcome. */
static int look_at_panel(struct gsn_store *store, int64_t specimen_id, int64_t panel_id,
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
    r = examine_picture(store, decoder, panel, protocol, decided, options, progress,
                        &outcome->findings, why);
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
    else if (!outcome->findings && is_refusal(r))
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
    const int r =
        look_at_panel(store, job->specimen_id, job->panel_id, options, progress, &outcome, err);

    return r < 0 ? r : commit_outcome(store, job, &outcome, err);
}

int gsn_panel_look_again(struct gsn_store *store, int64_t specimen_id, int64_t panel_id,
                         const struct gsn_job_options *options, struct gsn_error *err)
{
    auto_outcome outcome = { .findings = NULL };
    const int r = look_at_panel(store, specimen_id, panel_id, options, NULL, &outcome, err);

    return r < 0 ? r : write_outcome(store, panel_id, &outcome, err);
}
