/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* `gieson show`: everything the store knows of one specimen, and what a person is to do next about
 * it.
 *
 * Steps. Load its rows; for each panel and section the next command, as a question with its answers
 * where a person must decide; print it in words, or as JSON with the same facts. `gieson decide`
 * looks its answers up in the same view (show.h). */
#include "ui/show.h"

#include <jansson.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>

#include "storage/advice.h"
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

/* Loading. */

void gsn_show_done(struct gsn_show *view)
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

int gsn_show_load_sections(struct gsn_store *store, const char *name, struct gsn_show *view,
                           struct gsn_error *err)
{
    int r = gsn_specimen_get(store, name, &view->specimen, err);

    if (r >= 0)
        r = gsn_panel_list(store, view->specimen->id, &view->panels, err);
    if (r >= 0)
        r = gsn_section_list(store, view->specimen->id, &view->sections, err);
    if (r >= 0)
        r = gsn_decision_list(store, view->specimen->id, &view->decided, err);
    return r >= 0 ? gsn_candidate_list(store, view->specimen->id, &view->candidates, err) : r;
}

/* Everything. */
static int load_view(struct gsn_store *store, const char *name, struct gsn_show *view,
                     struct gsn_error *err)
{
    int r = gsn_show_load_sections(store, name, view, err);

    if (r >= 0)
        r = gsn_run_list(store, view->specimen->id, &view->runs, err);
    if (r >= 0 && view->runs->count > 0)
        r = gsn_measure_list(store, view->runs->at[view->runs->count - 1].id, &view->measures, err);
    if (r >= 0)
        r = gsn_overview_panels(store, &view->open, err);
    if (r >= 0)
        r = gsn_bench_list(store, &view->sources, err);
    if (r >= 0)
        view->expected = expected_panels(view->specimen);
    return r >= 0 ? gsn_trouble_list(store, &view->troubles, err) : r;
}

int gsn_show_has_flag(const struct gsn_section_row *section, const char *flag)
{
    const size_t length = strlen(flag);

    for (const char *at = strstr(section->flags, flag); at; at = strstr(at + 1, flag))
        if ((at == section->flags || at[-1] == ' ') && (!at[length] || at[length] == ' '))
            return 1;
    return 0;
}

const struct gsn_decision_row *gsn_show_decision_on(const struct gsn_show *view, int64_t number,
                                                    int64_t slot)
{
    for (size_t i = 0; i < view->decided->count; i++)
        if (view->decided->at[i].number == number && view->decided->at[i].slot == slot)
            return &view->decided->at[i];
    return NULL;
}

/* Whether a source delivers this specimen. */
static int is_delivered_by(const struct gsn_show *view, const char *source)
{
    for (size_t i = 0; i < view->sources->count; i++)
        if (strcmp(view->sources->at[i].name, source) == 0)
            return strcmp(view->sources->at[i].expects, view->specimen->name) == 0;
    return 0;
}

static int64_t panel_number_of(const struct gsn_show *view, int64_t id)
{
    for (size_t i = 0; i < view->panels->count; i++)
        if (view->panels->at[i].id == id)
            return view->panels->at[i].number;
    return 0;
}

size_t gsn_show_candidates(const struct gsn_show *view, const struct gsn_section_row *s,
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

/* What to do next. */

static char *make_decide_command(const struct gsn_show *view, int64_t number, int64_t slot,
                                 const char *answer)
{
    gsn_auto_mem(char) name = gsn_advice_word(view->specimen->name);

    if (!name)
        return NULL;
    return slot ? gsn_format("gieson decide %s %lld.%lld %s", name, (long long)number,
                             (long long)slot, answer)
                : gsn_format("gieson decide %s %lld %s", name, (long long)number, answer);
}

static int is_claimed_twice(const struct gsn_show *view, const struct gsn_panel_row *panel)
{
    for (size_t i = 0; i < view->panels->count; i++)
        if (view->panels->at[i].id != panel->id && view->panels->at[i].number == panel->number &&
            strcmp(view->panels->at[i].state, "held") == 0)
            return 1;
    return 0;
}

/* gives: the answer that a held panel waits for, or NULL. */
static char *panel_question(const struct gsn_show *view, const struct gsn_panel_row *panel)
{
    gsn_auto_mem(char) file = NULL;
    gsn_auto_mem(char) use = NULL;

    if (strcmp(panel->state, "held") != 0 || panel->number == 0 ||
        gsn_show_decision_on(view, panel->number, 0))
        return NULL;
    /* Where its sections lie is what is asked. */
    if (panel->width == 0 && strstr(panel->message, "slots in two ways"))
        return make_decide_command(view, panel->number, 0, "first N");
    if (strstr(panel->message, "decide as-marked"))
        return make_decide_command(view, panel->number, 0, "as-marked");
    if (!is_claimed_twice(view, panel))
        return NULL;
    file = gsn_advice_word(panel->file_name);
    use = file ? gsn_format("use %s", file) : NULL;
    return use ? make_decide_command(view, panel->number, 0, use) : NULL;
}

static char *panel_action(const struct gsn_show *view, const struct gsn_panel_row *panel)
{
    char *question = panel_question(view, panel);

    if (question)
        return question;
    for (size_t i = 0; strcmp(panel->state, "held") == 0 && i < view->open->count; i++)
        if (view->open->at[i].id == panel->id && view->open->at[i].scan)
            return gsn_snapshot_file_command(view->open->at[i].scan, view->specimen->name);
    return NULL;
}

/* Whether a person is still to choose its pose: nobody did, or the choice could not be used. */
static int asks_pose(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = gsn_show_candidates(view, s, &c);

    for (size_t i = 0; i < count; i++)
        if (c[i].chosen)
            return 0;
    return count > 0 && (!gsn_show_decision_on(view, panel_number_of(view, s->panel_id), s->slot) ||
                         gsn_show_has_flag(s, "decision-void") || gsn_show_has_flag(s, "decided"));
}

static char *section_action(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const int64_t number = panel_number_of(view, s->panel_id);

    if (asks_pose(view, s))
        return make_decide_command(view, number, s->slot, "pose N");
    if (strcmp(s->state, "held") != 0 || gsn_show_decision_on(view, number, s->slot))
        return NULL;
    if (gsn_show_has_flag(s, "touching"))
        return make_decide_command(view, number, s->slot, "cut");
    return gsn_show_has_flag(s, "scrap") || gsn_show_has_flag(s, "between-slots")
               ? make_decide_command(view, number, s->slot, "slot N")
               : NULL;
}

/* In words. */

/* The sources that deliver this specimen, and what they could not take in. */
static void print_sources(const struct gsn_ui *ui, const struct gsn_show *view)
{
    for (size_t i = 0; i < view->sources->count; i++) {
        const struct gsn_bench_source *source = &view->sources->at[i];

        if (is_delivered_by(view, source->name))
            gsn_text_line(stdout, "  delivered by %s, which is %s", source->name, source->state);
    }
    for (size_t i = 0; i < view->troubles->count; i++) {
        const struct gsn_trouble_row *trouble = &view->troubles->at[i];

        if (!is_delivered_by(view, trouble->source))
            continue;
        gsn_text_line(stdout, "  trouble  %s", trouble->name);
        gsn_ui_wrap(ui, 4, trouble->reason);
        gsn_ui_next(ui, trouble->action, "");
    }
}

static void print_panels(const struct gsn_ui *ui, const struct gsn_show *view)
{
    for (size_t i = 0; i < view->panels->count; i++) {
        const struct gsn_panel_row *p = &view->panels->at[i];
        gsn_auto_mem(char) action = panel_action(view, p);

        gsn_text_line(stdout, "  panel %lld  %-10s %s", (long long)p->number, p->state,
                      p->file_name);
        if (p->message[0])
            gsn_ui_wrap(ui, 4, p->message);
        if (action)
            gsn_ui_next(ui, action, "");
    }
}

static void print_missing(const struct gsn_ui *ui, int64_t number, const char *action)
{
    gsn_auto_mem(char) advice = gsn_advice(ui->store_dir, action);

    gsn_text_line(stdout, "  panel %lld  has not come", (long long)number);
    gsn_text_line(stdout, "    next: import it; where it is lost: %s", advice ? advice : action);
}

/* Panels that the job states and that never came. */
static void print_absent(const struct gsn_ui *ui, const struct gsn_show *view)
{
    for (int64_t number = 1; number <= view->expected; number++) {
        const struct gsn_decision_row *decided = gsn_show_decision_on(view, number, 0);
        gsn_auto_mem(char) action = make_decide_command(view, number, 0, "lost");
        int is_there = 0;

        for (size_t i = 0; i < view->panels->count; i++)
            is_there |= view->panels->at[i].number == number;
        if (is_there)
            continue;
        if (decided && strcmp(decided->answer, "lost") == 0)
            gsn_text_line(stdout, "  panel %lld  lost, as %s said%s%s", (long long)number,
                          decided->actor, decided->reason[0] ? ": " : "", decided->reason);
        else
            print_missing(ui, number, action ? action : "");
    }
}

/* What may be said instead. */
static const char *say_otherwise(const struct gsn_section_row *s)
{
    if (gsn_show_has_flag(s, "touching"))
        return ", or hold";
    return gsn_show_has_flag(s, "scrap") ? ", or dismiss" : "";
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

static void print_choice(const struct gsn_show *view, const struct gsn_section_row *s, int is_used)
{
    const struct gsn_decision_row *d =
        gsn_show_decision_on(view, panel_number_of(view, s->panel_id), s->slot);

    if (!d || strncmp(d->answer, "pose ", 5) != 0)
        return;
    if (gsn_show_has_flag(s, "decision-void"))
        gsn_text_line(stdout, "    what %s chose is not found there any more and is not used",
                      d->actor);
    else if (is_used)
        gsn_text_line(stdout, "    chosen by %s%s%s", d->actor, d->reason[0] ? ": " : "",
                      d->reason);
    else if (gsn_show_has_flag(s, "decided"))
        gsn_text_line(stdout, "    what %s chose does not fit the stack and is not used", d->actor);
    else
        gsn_text_line(stdout, "    %.*s, as %s said; `gieson run` does it",
                      (int)strcspn(d->answer + 5, " ") + 5, d->answer, d->actor);
}

/* The poses that the section may have, and what was chosen of them. */
static void print_candidates(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = gsn_show_candidates(view, s, &c);
    int is_used = 0;

    if (count > 0)
        gsn_text_line(stdout, "    pose    likely      error  side  turned");
    for (size_t i = 0; i < count; i++) {
        print_candidate(&c[i]);
        is_used |= c[i].chosen != 0;
    }
    print_choice(view, s, is_used);
}

/* A panel's look may find marks that the stack or the neighbours' tissue contradicts. */
static const char *state_of(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *first;

    return strcmp(s->state, "found") == 0 && gsn_show_candidates(view, s, &first) > 0
               ? "found, but its marks are in doubt"
               : s->state;
}

/* Named as `decide` takes it, PANEL.SLOT. Serial number 0: a piece that lies in no slot. */
static void print_section(const struct gsn_ui *ui, const struct gsn_show *view,
                          const struct gsn_section_row *s)
{
    gsn_auto_mem(char) action = section_action(view, s);

    if (s->serial == 0)
        gsn_text_line(stdout, "  a piece beside the slots of panel %lld  %s  %s",
                      (long long)panel_number_of(view, s->panel_id), s->state, s->flags);
    else
        gsn_text_line(stdout, "  section %lld.%lld  %s  %s",
                      (long long)panel_number_of(view, s->panel_id), (long long)s->slot,
                      state_of(view, s), s->flags);
    print_candidates(view, s);
    if (action)
        gsn_ui_next(ui, action, say_otherwise(s));
}

/* Only what a person should look at, or did; found and empty slots are counted. */
static void print_sections(const struct gsn_ui *ui, const struct gsn_show *view)
{
    size_t found = 0, empty = 0;

    for (size_t i = 0; i < view->sections->count; i++) {
        const struct gsn_section_row *s = &view->sections->at[i];
        const struct gsn_candidate_row *first;

        found += strcmp(s->state, "found") == 0;
        empty += strcmp(s->state, "empty") == 0;
        if ((strcmp(s->state, "found") != 0 && strcmp(s->state, "empty") != 0) ||
            gsn_show_candidates(view, s, &first) > 0 || gsn_show_has_flag(s, "decision-void"))
            print_section(ui, view, s);
    }
    if (view->sections->count > 0)
        (void)printf("  %zu sections found, %zu slots empty\n", found, empty);
}

static void print_runs(const struct gsn_ui *ui, const struct gsn_show *view)
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

static void print_show(const struct gsn_ui *ui, const struct gsn_show *view)
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
    print_absent(ui, view);
    print_sections(ui, view);
    print_runs(ui, view);
}

/* As JSON. */

static json_t *panels_json(const struct gsn_show *view)
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

static json_t *delivered_json(const struct gsn_show *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->sources->count; i++)
        if (is_delivered_by(view, view->sources->at[i].name))
            (void)json_array_append_new(array, gsn_text_json(view->sources->at[i].name));
    return array;
}

static json_t *candidates_json(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = gsn_show_candidates(view, s, &c);
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

static json_t *sections_json(const struct gsn_show *view)
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

static json_t *runs_json(const struct gsn_show *view)
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

static json_t *measures_json(const struct gsn_show *view)
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

static json_t *make_json(const struct gsn_show *view)
{
    return json_pack("{s:o, s:s, s:o, s:o, s:o, s:o, s:o, s:o, s:o}", "specimen",
                     gsn_text_json(view->specimen->name), "kind", view->specimen->kind, "group",
                     gsn_text_json(view->specimen->group), "baseline",
                     gsn_text_json(view->specimen->baseline), "delivered_by", delivered_json(view),
                     "panels", panels_json(view), "sections", sections_json(view), "runs",
                     runs_json(view), "measures", measures_json(view));
}

int gsn_cmd_show(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_show view = { 0 };
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc != 2)
        return gsn_ui_usage(ui, "show which specimen? `gieson status` lists them");
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = load_view(store, argv[1], &view, &err);
    if (r < 0)
        status = gsn_ui_complain(ui, &err, r);
    else if (ui->json)
        gsn_ui_print_json(ui, make_json(&view));
    else
        print_show(ui, &view);
    gsn_show_done(&view);
    return status;
}
