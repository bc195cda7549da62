/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a person decides where the picture does not tell: `gieson show` names the question, this
 * takes the answer. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>
#include <time.h>

#include "storage/audit_log.h"
#include "ui/show.h"
#include "ui/text.h"

enum { MOST_NUMBER = 100000, LEAST_DIGITS = 8 };

/* As typed, then as understood. */
struct question {
    const char *specimen, *place, *word, *object, *reason;
    int64_t number, slot; /* of the panel; from 1, 0: the panel as a whole */
    int64_t to;           /* the number behind "slot", "first" or "pose" */
};

struct known {
    struct gsn_show view;
    int64_t slots, expected; /* of a panel; panels that the job states, or 0 */
};

static void read_job(struct known *known)
{
    json_t *job = json_loads(known->view.specimen->job_json, 0, NULL);
    const json_t *layout = json_object_get(job, "layout");
    const json_int_t rows = json_integer_value(json_array_get(layout, 0));
    const json_int_t columns = json_integer_value(json_array_get(layout, 1));

    known->slots = rows > 0 && columns > 0 ? rows * columns : 12;
    known->expected = json_integer_value(json_object_get(job, "panels"));
    json_decref(job);
}

static int load_known(struct gsn_store *store, const char *name, struct known *known,
                      struct gsn_error *err)
{
    const int r = gsn_show_load_sections(store, name, &known->view, err);

    if (r >= 0)
        read_job(known);
    return r;
}

/* ---- what was typed ---------------------------------------------------------------------- */

static int takes_number(const char *word)
{
    return strcmp(word, "slot") == 0 || strcmp(word, "first") == 0 || strcmp(word, "pose") == 0;
}

static int takes_object(const char *word)
{
    return takes_number(word) || strcmp(word, "use") == 0;
}

static int is_of_slot(const char *word)
{
    return strcmp(word, "cut") == 0 || strcmp(word, "hold") == 0 || strcmp(word, "slot") == 0 ||
           strcmp(word, "pose") == 0 || strcmp(word, "dismiss") == 0;
}

static int is_answer(const char *word)
{
    return is_of_slot(word) || takes_object(word) || strcmp(word, "lost") == 0 ||
           strcmp(word, "as-set") == 0 || strcmp(word, "as-marked") == 0 ||
           strcmp(word, "undo") == 0;
}

static int take_words(int argc, char **argv, struct question *q)
{
    const char **const place[] = { &q->specimen, &q->place, &q->word, &q->object };
    size_t count = 0;

    q->reason = "";
    for (int i = 1; i < argc; i++) {
        if (strcmp(argv[i], "--because") == 0 && i + 1 < argc)
            q->reason = argv[++i];
        else if (strncmp(argv[i], "--because=", 10) == 0)
            q->reason = argv[i] + 10;
        else if (count < 4)
            *place[count++] = argv[i];
        else
            return -1;
    }
    return q->word && takes_object(q->word) == (q->object != NULL) ? 0 : -1;
}

/* "3" or "3.6". */
static int take_place(struct question *q)
{
    gsn_auto_mem(char) panel = gsn_strdup(q->place);
    char *dot = panel ? strchr(panel, '.') : NULL;

    if (!panel)
        return 0;
    if (dot)
        *dot = 0;
    return gsn_ui_whole(panel, 1, MOST_NUMBER, &q->number) &&
           (!dot || gsn_ui_whole(dot + 1, 1, MOST_NUMBER, &q->slot));
}

/* EX_OK, or the status of a mistake that was told. */
static int parse_question(const struct gsn_ui *ui, int argc, char **argv, struct question *q)
{
    if (take_words(argc, argv, q) < 0 || !is_answer(q->word))
        return gsn_ui_usage(
            ui, "say `gieson decide SPECIMEN PANEL.SLOT cut|hold|dismiss|slot N|pose N` or "
                "`gieson decide SPECIMEN PANEL use FILE|first N|as-set|as-marked|lost`, or undo; "
                "`gieson show SPECIMEN` says what is asked");
    if (!take_place(q))
        return gsn_ui_usage(ui,
                            "the place is a panel's number, with a slot's behind a dot, such as 3 "
                            "or 3.6, not \"%s\"",
                            q->place);
    if (is_of_slot(q->word) != (q->slot > 0) && strcmp(q->word, "undo") != 0)
        return gsn_ui_usage(ui, "\"%s\" is said of %s, not of \"%s\"", q->word,
                            is_of_slot(q->word) ? "a slot, such as 3.6" : "a panel, such as 3",
                            q->place);
    if (takes_number(q->word) && !gsn_ui_whole(q->object, 1, MOST_NUMBER, &q->to))
        return gsn_ui_usage(ui, "a %s is named by its number, not \"%s\"",
                            strcmp(q->word, "pose") == 0 ? "pose" : "slot", q->object);
    return EX_OK;
}

/* ---- whether it was asked ---------------------------------------------------------------- */

static size_t count_panels(const struct known *known, int64_t number)
{
    size_t count = 0;

    for (size_t i = 0; i < known->view.panels->count; i++)
        count += known->view.panels->at[i].number == number;
    return count;
}

static const struct gsn_section_row *slot_of(const struct known *known, int64_t number,
                                             int64_t slot)
{
    for (size_t i = 0; i < known->view.sections->count; i++)
        for (size_t k = 0; k < known->view.panels->count; k++)
            if (known->view.panels->at[k].id == known->view.sections->at[i].panel_id &&
                known->view.panels->at[k].number == number &&
                strcmp(known->view.panels->at[k].state, "registered") == 0 &&
                known->view.sections->at[i].slot == slot)
                return &known->view.sections->at[i];
    return NULL;
}

static int check_target(const struct known *known, const struct question *q, struct gsn_error *err)
{
    const struct gsn_section_row *to = slot_of(known, q->number, q->to);

    if (q->to > known->slots)
        return gsn_fail(err, GSN_E_INPUT,
                        "a panel of this specimen has %lld slots, so none is %lld",
                        (long long)known->slots, (long long)q->to);
    if (q->to == q->slot || !to || strcmp(to->state, "missing") == 0 ||
        strcmp(to->state, "empty") == 0)
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "slot %lld of panel %lld holds a section already: say an empty one, or where "
                    "that one belongs first",
                    (long long)q->to, (long long)q->number);
}

static int no_slot(const struct question *q, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND,
                    "panel %lld of %.200s has no slot %lld that was looked at: `gieson show` lists "
                    "what is there",
                    (long long)q->number, q->specimen, (long long)q->slot);
}

static int check_slot(const struct known *known, const struct question *q, struct gsn_error *err)
{
    const struct gsn_section_row *row = slot_of(known, q->number, q->slot);
    const int cuts = strcmp(q->word, "cut") == 0 || strcmp(q->word, "hold") == 0;

    if (!row)
        return no_slot(q, err);
    if (cuts && !gsn_show_has_flag(row, "touching") && !gsn_show_has_flag(row, "parted"))
        return gsn_fail(err, GSN_E_INPUT, "the section in slot %lld of panel %lld touches no other",
                        (long long)q->slot, (long long)q->number);
    if (strcmp(q->word, "dismiss") == 0 && !gsn_show_has_flag(row, "scrap"))
        return gsn_fail(err, GSN_E_INPUT,
                        "slot %lld of panel %lld holds no loose piece: only those can be dismissed",
                        (long long)q->slot, (long long)q->number);
    if (strcmp(q->word, "slot") != 0)
        return GSN_OK;
    if (!gsn_show_has_flag(row, "scrap") && !gsn_show_has_flag(row, "between-slots"))
        return gsn_fail(err, GSN_E_INPUT,
                        "the slot of the section in slot %lld of panel %lld is "
                        "not in doubt",
                        (long long)q->slot, (long long)q->number);
    return check_target(known, q, err);
}

/* The candidate that is meant, by its number among those of the section. */
static int find_pose(const struct known *known, const struct question *q,
                     const struct gsn_candidate_row **ret_pose, struct gsn_error *err)
{
    const struct gsn_section_row *section = slot_of(known, q->number, q->slot);
    const struct gsn_candidate_row *first = NULL;
    size_t count;

    if (!section)
        return no_slot(q, err);
    count = gsn_show_candidates(&known->view, section, &first);
    for (size_t i = 0; i < count; i++)
        if (first[i].number == q->to) {
            *ret_pose = &first[i];
            return GSN_OK;
        }
    if (count == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "the section in slot %lld of panel %lld has no poses to choose from",
                        (long long)q->slot, (long long)q->number);
    return gsn_fail(err, GSN_E_INPUT,
                    "the section in slot %lld of panel %lld has %zu poses to choose from, so none "
                    "is %lld",
                    (long long)q->slot, (long long)q->number, count, (long long)q->to);
}

/* gives: where its marks are, so that the choice holds as long as they are there. */
static char *pose_answer(const struct known *known, const struct question *q,
                         const struct gsn_candidate_row *pose)
{
    const char *sha256 = "";
    char mark[GSN_ROW_MARKS][40];

    for (size_t i = 0; i < known->view.panels->count; i++)
        if (known->view.panels->at[i].id == pose->panel_id)
            sha256 = known->view.panels->at[i].sha256;
    for (size_t m = 0; m < GSN_ROW_MARKS; m++)
        if (pose->marker[m].found)
            (void)snprintf(mark[m], sizeof mark[m], "%.1f,%.1f", pose->marker[m].x_px,
                           pose->marker[m].y_px);
        else
            (void)snprintf(mark[m], sizeof mark[m], "-");
    return gsn_format("pose %lld of %s %s %s %s %s", (long long)q->to, sha256,
                      pose->mirrored ? "down" : "up", mark[0], mark[1], mark[2]);
}

/* The hash of the file that is meant, by its name or by the first digits of the hash itself. */
static int find_file(const struct known *known, const struct question *q, const char **ret_sha256,
                     struct gsn_error *err)
{
    const char *found = NULL;
    size_t count = 0;

    for (size_t i = 0; i < known->view.panels->count; i++) {
        const struct gsn_panel_row *p = &known->view.panels->at[i];

        if (p->number != q->number || (strcmp(p->file_name, q->object) != 0 &&
                                       (strlen(q->object) < LEAST_DIGITS ||
                                        strncmp(p->sha256, q->object, strlen(q->object)) != 0)))
            continue;
        found = p->sha256;
        count++;
    }
    if (count > 1)
        return gsn_fail(err, GSN_E_INPUT,
                        "%zu scans of panel %lld are called %.200s: give the first %d digits of "
                        "its hash, which `gieson show --json` lists",
                        count, (long long)q->number, q->object, (int)LEAST_DIGITS);
    if (!found)
        return gsn_fail(err, GSN_E_NOTFOUND, "no scan of panel %lld is called %.200s",
                        (long long)q->number, q->object);
    *ret_sha256 = found;
    return GSN_OK;
}

static int check_panel(const struct known *known, const struct question *q, struct gsn_error *err)
{
    const size_t count = count_panels(known, q->number);

    if (strcmp(q->word, "lost") == 0) {
        if (count > 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "panel %lld has been delivered; only one that never came is lost",
                            (long long)q->number);
        if (known->expected > 0 && q->number > known->expected)
            return gsn_fail(err, GSN_E_INPUT, "job.json says that there are %lld panels",
                            (long long)known->expected);
        return GSN_OK;
    }
    if (count == 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "%.200s has no panel %lld", q->specimen,
                        (long long)q->number);
    if (strcmp(q->word, "use") == 0 && count < 2)
        return gsn_fail(err, GSN_E_INPUT, "there is one scan of panel %lld, and it is used",
                        (long long)q->number);
    if (strcmp(q->word, "first") == 0 && q->to > known->slots)
        return gsn_fail(err, GSN_E_INPUT,
                        "a panel of this specimen has %lld slots, so none is %lld",
                        (long long)known->slots, (long long)q->to);
    return GSN_OK;
}

/* gives: the answer as it is kept. */
static char *kept_answer(const struct known *known, const struct question *q, const char *sha256,
                         const struct gsn_candidate_row *pose)
{
    if (strcmp(q->word, "undo") == 0)
        return gsn_strdup("");
    if (strcmp(q->word, "use") == 0)
        return gsn_format("use %s", sha256);
    if (pose)
        return pose_answer(known, q, pose);
    return takes_number(q->word) ? gsn_format("%s %lld", q->word, (long long)q->to)
                                 : gsn_strdup(q->word);
}

/* What was answered before is no mistake to say again, even when nothing asks for it any more. */
static int was_said(const struct known *known, const struct question *q, const char *answer)
{
    const struct gsn_decision_row *said = gsn_show_decision_on(&known->view, q->number, q->slot);

    return !answer[0] || (said && strcmp(said->answer, answer) == 0);
}

static int put_decision(struct gsn_store *store, const struct question *q, int *ret_again,
                        struct gsn_error *err)
{
    const struct gsn_actor who = gsn_actor_now();
    struct known known = { 0 };
    gsn_auto_mem(char) answer = NULL;
    struct gsn_decision_row row = { .number = q->number,
                                    .slot = q->slot,
                                    .x_px = NAN,
                                    .y_px = NAN,
                                    .actor = who.name,
                                    .reason = q->reason,
                                    .time = time(NULL) };
    const struct gsn_section_row *section;
    const struct gsn_candidate_row *pose = NULL;
    const char *sha256 = "";
    int r = load_known(store, q->specimen, &known, err);

    if (r >= 0 && strcmp(q->word, "use") == 0)
        r = find_file(&known, q, &sha256, err);
    if (r >= 0 && strcmp(q->word, "pose") == 0)
        r = find_pose(&known, q, &pose, err);
    if (r >= 0 && !(answer = kept_answer(&known, q, sha256, pose)))
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (r >= 0 && !was_said(&known, q, answer))
        r = q->slot ? check_slot(&known, q, err) : check_panel(&known, q, err);
    if (r >= 0) {
        section = q->slot ? slot_of(&known, q->number, q->slot) : NULL;
        row.answer = answer;
        row.x_px = section ? section->bbox_x + section->bbox_w / 2 : NAN;
        row.y_px = section ? section->bbox_y + section->bbox_h / 2 : NAN;
        r = gsn_decision_put(store, q->specimen, &row, ret_again, err);
    }
    gsn_show_done(&known.view);
    return r;
}

int gsn_cmd_decide(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    struct question q = { 0 };
    struct gsn_error err = { 0 };
    int status = parse_question(ui, argc, argv, &q), again = 0, r;

    if (status != EX_OK)
        return status;
    store = gsn_ui_store(ui, GSN_STORE_WRITE, &status);
    if (!store)
        return status;
    r = put_decision(store, &q, &again, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        gsn_ui_print_json(ui, json_pack("{s:o, s:I, s:o, s:s, s:b}", "specimen",
                                        gsn_text_json(q.specimen), "panel", (json_int_t)q.number,
                                        "slot", q.slot ? json_integer(q.slot) : json_null(),
                                        "answer", q.word, "again", again));
    else
        gsn_text_line(stdout, "%s of %s: %s%s%s%s", q.place, q.specimen, q.word,
                      q.object ? " " : "", q.object ? q.object : "",
                      again ? ", as it was" : "; `gieson run` does it");
    return EX_OK;
}
