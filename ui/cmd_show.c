/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

#include "storage/catalog.h"
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
    return r >= 0 ? gsn_trouble_list(store, &view->troubles, err) : r;
}

/* gives: the command that says which number a held panel has, or NULL. */
static char *panel_action(const struct view *view, const struct gsn_panel_row *panel)
{
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

static int64_t panel_number(const struct view *view, int64_t id)
{
    for (size_t i = 0; i < view->panels->count; i++)
        if (view->panels->at[i].id == id)
            return view->panels->at[i].number;
    return 0;
}

/* Serial number 0: a piece that lies in no slot. */
static void print_section(const struct view *view, const struct gsn_section_row *s)
{
    if (s->serial == 0)
        gsn_text_line(stdout, "  a piece beside the slots of panel %lld  %s  %s",
                      (long long)panel_number(view, s->panel_id), s->state, s->flags);
    else
        gsn_text_line(stdout, "  section %lld (slot %lld)  %s  %s", (long long)s->serial - 1,
                      (long long)s->slot - 1, s->state, s->flags);
}

/* Only what a person should look at; found and empty slots are counted. */
static void print_sections(const struct view *view)
{
    size_t found = 0, empty = 0;

    for (size_t i = 0; i < view->sections->count; i++) {
        const struct gsn_section_row *s = &view->sections->at[i];

        found += strcmp(s->state, "found") == 0;
        empty += strcmp(s->state, "empty") == 0;
        if (strcmp(s->state, "found") != 0 && strcmp(s->state, "empty") != 0)
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

static json_t *sections_json(const struct view *view)
{
    json_t *array = json_array();

    for (size_t i = 0; i < view->sections->count; i++) {
        const struct gsn_section_row *s = &view->sections->at[i];

        (void)json_array_append_new(
            array,
            json_pack("{s:o, s:I, s:s, s:s}", "serial",
                      s->serial ? json_integer((json_int_t)s->serial - 1) : json_null(), "slot",
                      (json_int_t)s->slot - 1, "state", s->state, "flags", s->flags));
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
