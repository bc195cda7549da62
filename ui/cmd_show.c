/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

#include "storage/candidate.h"
#include "storage/catalog.h"
#include "storage/decision.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "storage/result.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>

/* Everything the store knows of one specimen. */
struct view {
    struct gsn_specimen_row *specimen;
    struct gsn_panel_rows *panels;
    struct gsn_section_rows *sections;
    struct gsn_run_rows *runs;
    struct gsn_measure_rows *measures; /* of the latest run; NULL when there is none */
    struct gsn_open_panel_rows *open;
    struct gsn_bench_sources *sources;
    struct gsn_trouble_rows *troubles;
    struct gsn_decision_rows *decided;
    struct gsn_candidate_rows *candidates;
    int64_t expected; /* panels that the job states, or 0 */
};

static void view_done(struct view *view)
{
    gsn_specimen_row_free(view->specimen);
    gsn_panel_rows_free(view->panels);
    gsn_section_rows_free(view->sections);
    gsn_run_rows_free(view->runs);
    gsn_measure_rows_free(view->measures);
    gsn_open_panel_rows_free(view->open);
    gsn_bench_sources_free(view->sources);
    gsn_trouble_rows_free(view->troubles);
    gsn_decision_rows_free(view->decided);
    gsn_candidate_rows_free(view->candidates);
}

static int64_t expected_panels(const struct gsn_specimen_row *specimen)
{
    json_t *job = json_loads(specimen->job_json, 0, NULL);
    const json_int_t panels = json_integer_value(json_object_get(job, "panels"));

    json_decref(job);
    return strcmp(specimen->kind, "sections") == 0 ? panels : 0;
}

static int load(struct gsn_store *store, const char *name, struct view *view, struct gsn_error *err)
{
    int r = gsn_specimen_get(store, name, &view->specimen, err);

    if (r >= 0)
        r = gsn_panel_list(store, view->specimen->id, &view->panels, err);
    if (r >= 0)
        r = gsn_section_list(store, view->specimen->id, &view->sections, err);
    if (r >= 0)
        r = gsn_run_list(store, view->specimen->id, &view->runs, err);
    if (r >= 0 && view->runs->count > 0)
        r = gsn_measure_list(store, view->runs->at[view->runs->count - 1].id, &view->measures, err);
    if (r >= 0)
        r = gsn_overview_panels(store, &view->open, err);
    if (r >= 0)
        r = gsn_bench_list(store, &view->sources, err);
    if (r >= 0)
        r = gsn_decision_list(store, view->specimen->id, &view->decided, err);
    if (r >= 0)
        r = gsn_candidate_list(store, view->specimen->id, &view->candidates, err);
    if (r >= 0)
        view->expected = expected_panels(view->specimen);
    return r >= 0 ? gsn_trouble_list(store, &view->troubles, err) : r;
}

static int has_flag(const struct gsn_section_row *section, const char *flag)
{
    return strstr(section->flags, flag) != NULL;
}

/* What was answered about a place, or NULL. */
static const struct gsn_decision_row *decision_on(const struct view *view, int64_t number,
                                                  int64_t slot)
{
    for (size_t i = 0; i < view->decided->count; i++)
        if (view->decided->at[i].number == number && view->decided->at[i].slot == slot)
            return &view->decided->at[i];
    return NULL;
}

/* gives: `gieson decide SPECIMEN PLACE ANSWER`, or NULL when memory runs out. */
static char *decide_command(const struct view *view, int64_t number, int64_t slot,
                            const char *answer)
{
    gsn_auto_mem(char) name = gsn_text_word(view->specimen->name);

    if (!name)
        return NULL;
    return slot ? gsn_format("gieson decide %s %lld.%lld %s", name, (long long)number,
                             (long long)slot, answer)
                : gsn_format("gieson decide %s %lld %s", name, (long long)number, answer);
}

static int is_claimed_twice(const struct view *view, const struct gsn_panel_row *panel)
{
    for (size_t i = 0; i < view->panels->count; i++)
        if (view->panels->at[i].id != panel->id && view->panels->at[i].number == panel->number &&
            strcmp(view->panels->at[i].state, "held") == 0)
            return 1;
    return 0;
}

/* gives: the answer that a held panel waits for, or NULL. */
static char *panel_question(const struct view *view, const struct gsn_panel_row *panel)
{
    gsn_auto_mem(char) file = NULL;
    gsn_auto_mem(char) use = NULL;

    if (strcmp(panel->state, "held") != 0 || panel->number == 0 ||
        decision_on(view, panel->number, 0))
        return NULL;
    /* Where its sections lie is what is asked. */
    if (panel->width == 0 && strstr(panel->message, "slots in two ways"))
        return decide_command(view, panel->number, 0, "first N");
    if (!is_claimed_twice(view, panel))
        return NULL;
    file = gsn_text_word(panel->file_name);
    use = file ? gsn_format("use %s", file) : NULL;
    return use ? decide_command(view, panel->number, 0, use) : NULL;
}

/* gives: the command that answers what a held panel waits for, or that says which number it has; or
 * NULL. */
static char *panel_action(const struct view *view, const struct gsn_panel_row *panel)
{
    char *question = panel_question(view, panel);

    if (question)
        return question;
    for (size_t i = 0; strcmp(panel->state, "held") == 0 && i < view->open->count; i++)
        if (view->open->at[i].id == panel->id && view->open->at[i].scan)
            return gsn_snapshot_file_command(view->open->at[i].scan, view->specimen->name);
    return NULL;
}

static int delivers(const struct view *view, const char *source)
{
    for (size_t i = 0; i < view->sources->count; i++)
        if (strcmp(view->sources->at[i].name, source) == 0)
            return strcmp(view->sources->at[i].expects, view->specimen->name) == 0;
    return 0;
}

/* The sources that deliver this specimen, and what they could not take in. */
static void print_sources(const struct gsn_ui *ui, const struct view *view)
{
    for (size_t i = 0; i < view->sources->count; i++) {
        const struct gsn_bench_source *source = &view->sources->at[i];

        if (delivers(view, source->name))
            gsn_text_line(stdout, "  delivered by %s, which is %s", source->name, source->state);
    }
    for (size_t i = 0; i < view->troubles->count; i++) {
        const struct gsn_trouble_row *trouble = &view->troubles->at[i];

        if (!delivers(view, trouble->source))
            continue;
        gsn_text_line(stdout, "  trouble  %s", trouble->name);
        gsn_text_wrap(stdout, 4, ui->width, trouble->reason);
        gsn_text_line(stdout, "    next: %s", trouble->action);
    }
}

static void print_panels(const struct gsn_ui *ui, const struct view *view)
{
    for (size_t i = 0; i < view->panels->count; i++) {
        const struct gsn_panel_row *p = &view->panels->at[i];
        gsn_auto_mem(char) action = panel_action(view, p);

        gsn_text_line(stdout, "  panel %lld  %-10s %s", (long long)p->number, p->state,
                      p->file_name);
        if (p->message[0])
            gsn_text_wrap(stdout, 4, ui->width, p->message);
        if (action)
            gsn_text_line(stdout, "    next: %s", action);
    }
}

/* Panels that the job states and that never came. */
static void print_absent(const struct view *view)
{
    for (int64_t number = 1; number <= view->expected; number++) {
        const struct gsn_decision_row *decided = decision_on(view, number, 0);
        gsn_auto_mem(char) action = decide_command(view, number, 0, "lost");
        int is_there = 0;

        for (size_t i = 0; i < view->panels->count; i++)
            is_there |= view->panels->at[i].number == number;
        if (is_there)
            continue;
        if (decided && strcmp(decided->answer, "lost") == 0)
            gsn_text_line(stdout, "  panel %lld  lost, as %s said%s%s", (long long)number,
                          decided->actor, decided->reason[0] ? ": " : "", decided->reason);
        else
            gsn_text_line(stdout,
                          "  panel %lld  has not come\n    next: import it; where it is lost: %s",
                          (long long)number, action ? action : "");
    }
}

static int64_t panel_number(const struct view *view, int64_t id)
{
    for (size_t i = 0; i < view->panels->count; i++)
        if (view->panels->at[i].id == id)
            return view->panels->at[i].number;
    return 0;
}

/* The first of a section's candidates, which follow each other, and their number. */
static size_t candidates_of(const struct view *view, const struct gsn_section_row *s,
                            const struct gsn_candidate_row **ret_first)
{
    size_t count = 0;

    for (size_t i = 0; i < view->candidates->count; i++) {
        const struct gsn_candidate_row *c = &view->candidates->at[i];

        if (c->panel_id == s->panel_id && c->slot == s->slot && count++ == 0)
            *ret_first = c;
    }
    return count;
}

/* Whether a person is still to choose its pose: nobody did, or the choice could not be used. */
static int asks_pose(const struct view *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = candidates_of(view, s, &c);

    for (size_t i = 0; i < count; i++)
        if (c[i].chosen)
            return 0;
    return count > 0 && (!decision_on(view, panel_number(view, s->panel_id), s->slot) ||
                         has_flag(s, "decision-void") || has_flag(s, "decided"));
}

/* gives: the command that answers what a section waits for, or NULL. */
static char *section_action(const struct view *view, const struct gsn_section_row *s)
{
    const int64_t number = panel_number(view, s->panel_id);

    if (asks_pose(view, s))
        return decide_command(view, number, s->slot, "pose N");
    if (strcmp(s->state, "held") != 0 || decision_on(view, number, s->slot))
        return NULL;
    if (has_flag(s, "touching"))
        return decide_command(view, number, s->slot, "cut");
    return has_flag(s, "scrap") || has_flag(s, "between-slots")
               ? decide_command(view, number, s->slot, "slot N")
               : NULL;
}

/* What may be said instead. */
static const char *otherwise(const struct gsn_section_row *s)
{
    if (has_flag(s, "touching"))
        return ", or hold";
    return has_flag(s, "scrap") ? ", or dismiss" : "";
}

/* gives: a dash for what is not known. */
static char *share_text(double share)
{
    if (isnan(share))
        return gsn_strdup("-");
    return share < 0.001 ? gsn_strdup("< 0.1 %") : gsn_format("%.1f %%", 100 * share);
}

static char *error_text(double error_um)
{
    return isnan(error_um) ? gsn_strdup("-") : gsn_format("%.1f um", error_um);
}

static void print_candidate(const struct gsn_candidate_row *c)
{
    gsn_auto_mem(char) likely = share_text(c->share);
    gsn_auto_mem(char) error = error_text(c->error_um);

    gsn_text_line(stdout, "    %c %2lld  %8s  %9s  %-4s  %-6s  %s", c->chosen ? '*' : ' ',
                  (long long)c->number, likely ? likely : "", error ? error : "",
                  c->flipped ? "down" : "up", c->rotated180 ? "yes" : "no", c->differs);
}

static void print_choice(const struct view *view, const struct gsn_section_row *s, int is_used)
{
    const struct gsn_decision_row *d = decision_on(view, panel_number(view, s->panel_id), s->slot);

    if (!d || strncmp(d->answer, "pose ", 5) != 0)
        return;
    if (has_flag(s, "decision-void"))
        gsn_text_line(stdout, "    what %s chose is not found there any more and is not used",
                      d->actor);
    else if (is_used)
        gsn_text_line(stdout, "    chosen by %s%s%s", d->actor, d->reason[0] ? ": " : "",
                      d->reason);
    else if (has_flag(s, "decided"))
        gsn_text_line(stdout, "    what %s chose does not fit the stack and is not used", d->actor);
    else
        gsn_text_line(stdout, "    %.*s, as %s said; `gieson run` works it",
                      (int)strcspn(d->answer + 5, " ") + 5, d->answer, d->actor);
}

/* The poses that the section may have, and what was chosen of them. */
static void print_candidates(const struct view *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = candidates_of(view, s, &c);
    int is_used = 0;

    if (count > 0)
        gsn_text_line(stdout, "    pose    likely      error  side  turned");
    for (size_t i = 0; i < count; i++) {
        print_candidate(&c[i]);
        is_used |= c[i].chosen != 0;
    }
    print_choice(view, s, is_used);
}

/* Serial number 0: a piece that lies in no slot. */
static void print_section(const struct view *view, const struct gsn_section_row *s)
{
    gsn_auto_mem(char) action = section_action(view, s);

    if (s->serial == 0)
        gsn_text_line(stdout, "  a piece beside the slots of panel %lld  %s  %s",
                      (long long)panel_number(view, s->panel_id), s->state, s->flags);
    else
        gsn_text_line(stdout, "  section %lld (slot %lld)  %s  %s", (long long)s->serial - 1,
                      (long long)s->slot, s->state, s->flags);
    print_candidates(view, s);
    if (action)
        gsn_text_line(stdout, "    next: %s%s", action, otherwise(s));
}

/* Only what a person should look at, or did; found and empty slots are counted. */
static void print_sections(const struct view *view)
{
    size_t found = 0, empty = 0;

    for (size_t i = 0; i < view->sections->count; i++) {
        const struct gsn_section_row *s = &view->sections->at[i];
        const struct gsn_candidate_row *first;

        found += strcmp(s->state, "found") == 0;
        empty += strcmp(s->state, "empty") == 0;
        if ((strcmp(s->state, "found") != 0 && strcmp(s->state, "empty") != 0) ||
            candidates_of(view, s, &first) > 0 || has_flag(s, "decision-void"))
            print_section(view, s);
    }
    if (view->sections->count > 0)
        (void)printf("  %zu sections found, %zu slots empty\n", found, empty);
}

static void print_runs(const struct gsn_ui *ui, const struct view *view)
{
    for (size_t i = 0; i < view->runs->count; i++) {
        const struct gsn_run_row *run = &view->runs->at[i];
        gsn_auto_mem(char) line = gsn_format("run %lld  %s%s%s", (long long)run->id, run->state,
                                             run->message[0] ? ": " : "", run->message);

        gsn_text_wrap(stdout, 2, ui->width, line ? line : "");
    }
    for (size_t i = 0; view->measures && i < view->measures->count; i++) {
        const struct gsn_measure_row *m = &view->measures->at[i];

        gsn_auto_mem(char) bounds =
            isnan(m->lower) ? gsn_strdup("") : gsn_format("  (%.6g to %.6g)", m->lower, m->upper);
        gsn_auto_mem(char) line =
            gsn_format("%-18s %.6g %s%s", m->name, m->value, m->unit, bounds ? bounds : "");

        gsn_text_wrap(stdout, 4, ui->width, line ? line : m->name);
    }
}

static void print_text(const struct gsn_ui *ui, const struct view *view)
{
    const struct gsn_specimen_row *s = view->specimen;

    gsn_text_line(stdout, "%s  (%s)", s->name, s->kind);
    if (s->group[0] || s->study[0])
        gsn_text_line(stdout, "  study %s, group %s, animal %s", s->study[0] ? s->study : "-",
                      s->group[0] ? s->group : "-", s->animal[0] ? s->animal : "-");
    if (s->baseline[0])
        gsn_text_line(stdout, "  baseline %s", s->baseline);
    print_sources(ui, view);
    print_panels(ui, view);
    print_absent(view);
    print_sections(view);
    print_runs(ui, view);
}

static json_t *panels_json(const struct view *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->panels->count; i++) {
        const struct gsn_panel_row *p = &view->panels->at[i];
        gsn_auto_mem(char) action = panel_action(view, p);

        (void)json_array_append_new(
            array, json_pack("{s:I, s:o, s:s, s:s, s:s, s:o, s:o}", "number", (json_int_t)p->number,
                             "file", gsn_text_json(p->file_name), "sha256", p->sha256, "state",
                             p->state, "code", p->code, "message", gsn_text_json(p->message),
                             "action", gsn_text_json(action ? action : "")));
    }
    return array;
}

static json_t *delivered_json(const struct view *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->sources->count; i++)
        if (delivers(view, view->sources->at[i].name))
            (void)json_array_append_new(array, gsn_text_json(view->sources->at[i].name));
    return array;
}

static json_t *candidates_json(const struct view *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = candidates_of(view, s, &c);
    json_t *array = json_array();

    for (size_t i = 0; i < count; i++)
        (void)json_array_append_new(
            array,
            json_pack("{s:I, s:b, s:o, s:o, s:b, s:b, s:o}", "number", (json_int_t)c[i].number,
                      "chosen", (int)c[i].chosen, "share", gsn_ui_number(c[i].share), "error_um",
                      gsn_ui_number(c[i].error_um), "flipped", (int)c[i].flipped, "rotated180",
                      (int)c[i].rotated180, "differs", gsn_text_json(c[i].differs)));
    return array;
}

static json_t *sections_json(const struct view *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->sections->count; i++) {
        const struct gsn_section_row *s = &view->sections->at[i];
        gsn_auto_mem(char) action = section_action(view, s);

        (void)json_array_append_new(
            array,
            json_pack("{s:o, s:I, s:s, s:s, s:o, s:o}", "serial",
                      s->serial ? json_integer((json_int_t)s->serial - 1) : json_null(), "slot",
                      (json_int_t)s->slot - 1, "state", s->state, "flags", s->flags, "candidates",
                      candidates_json(view, s), "action", gsn_text_json(action ? action : "")));
    }
    return array;
}

static json_t *runs_json(const struct view *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->runs->count; i++) {
        const struct gsn_run_row *run = &view->runs->at[i];

        (void)json_array_append_new(
            array, json_pack("{s:I, s:s, s:o, s:s, s:s, s:s}", "run", (json_int_t)run->id, "state",
                             run->state, "message", gsn_text_json(run->message), "key", run->key,
                             "version", run->version, "event_head", run->event_head));
    }
    return array;
}

static json_t *measures_json(const struct view *view)
{
    json_t *array = json_array();

    for (size_t i = 0; view->measures && i < view->measures->count; i++) {
        const struct gsn_measure_row *m = &view->measures->at[i];
        json_t *row = json_pack("{s:s, s:o, s:s}", "name", m->name, "value",
                                gsn_ui_number(m->value), "unit", m->unit);

        if (!isnan(m->lower)) {
            (void)json_object_set_new(row, "lower", json_real(m->lower));
            (void)json_object_set_new(row, "upper", json_real(m->upper));
        }
        (void)json_array_append_new(array, row);
    }
    return array;
}

int gsn_cmd_show(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    struct view view = { 0 };
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc != 2)
        return gsn_ui_usage("show which specimen? `gieson status` lists them");
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = load(store, argv[1], &view, &err);
    if (r < 0)
        status = gsn_ui_complain(&err, r);
    else if (ui->json)
        gsn_ui_print_json(json_pack(
            "{s:o, s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "specimen",
            gsn_text_json(view.specimen->name), "kind", view.specimen->kind, "group",
            gsn_text_json(view.specimen->group), "baseline", gsn_text_json(view.specimen->baseline),
            "delivered_by", delivered_json(&view), "panels", panels_json(&view), "sections",
            sections_json(&view), "runs", runs_json(&view), "measures", measures_json(&view)));
    else
        print_text(ui, &view);
    view_done(&view);
    return status;
}
