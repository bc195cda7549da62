/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* `gieson status`: the store at one moment as a table, as blocks where the terminal is narrow, or
 * as JSON.
 *
 * The next command stands behind a row where there is room, else on a line of its own, never cut:
 * it is there to be copied. Above the specimens: who serves the store, what comes in, what needs a
 * person. */
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>

#include "storage/advice.h"
#include "ui/board.h"
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

/* Columns of a row besides the specimen's name, up to the loss. */
enum { REST_OF_ROW = 49, NAME_LEAST = 10, NAME_MOST = 40, NEXT_GAP = 2 };

/* The command stands behind the row where there is room, else on a line of its own, never cut: it
 * is there to be copied. */
static void print_next(const struct gsn_ui *ui, const struct gsn_snapshot_row *row, int used)
{
    gsn_auto_mem(char) action = row->action ? gsn_advice(ui->store_dir, row->action) : NULL;
    const int fits = action && used + NEXT_GAP + gsn_text_columns(action) <= ui->width;

    if (fits)
        gsn_text_line(stdout, "%*s%s", NEXT_GAP, "", action);
    else
        (void)putchar('\n');
    if (row->detail)
        gsn_ui_wrap(ui, 4, row->detail);
    if (action && !fits)
        gsn_text_line(stdout, "    next: %s", action);
}

static void print_row(const struct gsn_ui *ui, const struct gsn_snapshot_row *row, int name_width)
{
    const struct gsn_look *look = gsn_look_of(row->state);
    gsn_auto_mem(char) name = gsn_text_cell(row->name, name_width);
    gsn_auto_mem(char) group = gsn_text_cell(row->group, 8);
    char loss[24] = "-", panels[24] = "-", sections[24] = "-";

    if (!isnan(row->loss_percent))
        (void)snprintf(loss, sizeof loss, "%.2f %%", row->loss_percent);
    if (gsn_snapshot_has_panels(row)) {
        (void)snprintf(panels, sizeof panels, "%u/%u", row->panels_registered, row->panels);
        (void)snprintf(sections, sizeof sections, "%u/%u", row->sections_found, row->sections);
    }
    (void)printf("%s%s %s %s %7s %9s %-9s %9s%s", ui->colour ? gsn_hue_ansi(look->hue) : "",
                 look->symbol, name ? name : "", group ? group : "", panels, sections, row->state,
                 loss, ui->colour ? "\033[0m" : "");
    print_next(ui, row, name_width + REST_OF_ROW);
}

/* One specimen in a few short lines, where the table is too wide. */
static void print_block(const struct gsn_ui *ui, const struct gsn_snapshot_row *row)
{
    const struct gsn_look *look = gsn_look_of(row->state);
    gsn_auto_mem(char) facts = gsn_format("panels %u/%u, sections %u/%u", row->panels_registered,
                                          row->panels, row->sections_found, row->sections);
    gsn_auto_mem(char) loss = gsn_look_loss(row->loss_percent, row->loss_lower, row->loss_upper);

    (void)fputs(ui->colour ? gsn_hue_ansi(look->hue) : "", stdout);
    (void)printf("%s %s%s ", look->symbol, row->state, ui->colour ? "\033[0m" : "");
    gsn_text_line(stdout, "%s", row->name);
    if (gsn_snapshot_has_panels(row))
        gsn_text_wrap(stdout, 4, ui->width, facts ? facts : "");
    if (loss && loss[0])
        (void)printf("    loss %s\n", loss);
    gsn_auto_mem(char) action = row->action ? gsn_advice(ui->store_dir, row->action) : NULL;

    if (row->detail)
        gsn_ui_wrap(ui, 4, row->detail);
    if (action)
        gsn_text_line(stdout, "    next: %s", action);
}

/* The longest name as far as the terminal has room; 0 where the table does not fit at all. */
static int name_columns(const struct gsn_ui *ui, const struct gsn_snapshot *snapshot)
{
    const int room = ui->width - REST_OF_ROW;
    int wanted = NAME_LEAST;

    for (size_t i = 0; i < snapshot->count; i++) {
        const int columns = gsn_text_columns(snapshot->at[i].name);

        wanted = columns > wanted ? columns : wanted;
    }
    if (!ui->out_tty)
        return wanted;
    wanted = wanted > NAME_MOST ? NAME_MOST : wanted;
    return room < NAME_LEAST ? 0 : wanted < room ? wanted : room;
}

static void print_source(const struct gsn_ui *ui, const struct gsn_bench_source *source)
{
    const struct gsn_look *look = gsn_look_of(source->state);
    const char *what = source->message[0] ? source->message : source->item;
    gsn_auto_mem(char) line = gsn_format("%s source %s %s%s%s%s%s", look->symbol, source->name,
                                         source->state, what[0] ? ": " : "", what,
                                         source->expects[0] ? ", delivers " : "", source->expects);

    if (strcmp(source->state, "off") != 0)
        gsn_text_wrap(stdout, 0, ui->width, line ? line : source->name);
}

/* What a person must do something about, each with the command or the words that say what. */
static void print_need(const struct gsn_ui *ui, const char *state, const char *name,
                       const char *source, const char *reason, const char *action)
{
    const struct gsn_look *look = gsn_look_of(state);

    (void)printf("%s%s %s%s ", ui->colour ? gsn_hue_ansi(look->hue) : "", look->symbol, state,
                 ui->colour ? "\033[0m" : "");
    gsn_text_line(stdout, "%s from %s", name, source);
    gsn_auto_mem(char) advice = gsn_advice(ui->store_dir, action);

    gsn_ui_wrap(ui, 4, reason);
    gsn_text_line(stdout, "    next: %s", advice ? advice : action);
}

static void print_bench(const struct gsn_ui *ui, const struct gsn_snapshot *snapshot)
{
    const struct gsn_trouble_rows *troubles = snapshot->troubles;
    const struct gsn_scan_rows *unfiled = snapshot->unfiled;
    gsn_auto_mem(char) service = gsn_board_service(snapshot);

    if (snapshot->sources->count > 0 || snapshot->unsettled > 0)
        gsn_ui_wrap(ui, 0, service ? service : "");
    for (size_t i = 0; i < snapshot->sources->count; i++)
        print_source(ui, &snapshot->sources->at[i]);
    for (size_t i = 0; i < troubles->count; i++)
        print_need(ui, "trouble", troubles->at[i].name, troubles->at[i].source,
                   troubles->at[i].reason, troubles->at[i].action);
    for (size_t i = 0; i < unfiled->count; i++) {
        gsn_auto_mem(char) action = gsn_snapshot_file_command(unfiled->at[i].id, NULL);

        print_need(ui, "unfiled", unfiled->at[i].name, unfiled->at[i].source, unfiled->at[i].reason,
                   action ? action : "gieson file");
    }
}

static void print_table(const struct gsn_ui *ui, const struct gsn_snapshot *snapshot)
{
    const struct gsn_job_counts *jobs = &snapshot->jobs;
    const int name_width = name_columns(ui, snapshot);
    gsn_auto_mem(char) queue = gsn_format(
        "queue: %lld waiting, %lld running, %lld done, %lld failed", (long long)jobs->waiting,
        (long long)jobs->running, (long long)jobs->done, (long long)jobs->failed);

    gsn_text_wrap(stdout, 0, ui->width, queue ? queue : "");
    print_bench(ui, snapshot);
    if (snapshot->count == 0)
        gsn_ui_wrap(ui, 0, "no specimen yet: `gieson import FOLDER` takes one in");
    else if (name_width > 0)
        (void)printf("  %-*s %-8s %7s %9s %-9s %9s%s\n", name_width, "SPECIMEN", "GROUP", "PANELS",
                     "SECTIONS", "STATE", "LOSS",
                     name_width + REST_OF_ROW + 6 <= ui->width ? "  NEXT" : "");
    for (size_t i = 0; i < snapshot->count; i++) {
        if (name_width > 0)
            print_row(ui, &snapshot->at[i], name_width);
        else
            print_block(ui, &snapshot->at[i]);
    }
}

static json_t *row_json(const struct gsn_snapshot_row *row)
{
    return json_pack(
        "{s:o, s:o, s:s, s:o, s:o, s:i, s:i, s:i, s:i, s:i, s:o, s:o, s:o, s:o, s:I, s:o}",
        "specimen", gsn_text_json(row->name), "group", gsn_text_json(row->group), "state",
        row->state, "detail", gsn_text_json(row->detail ? row->detail : ""), "action",
        gsn_text_json(row->action ? row->action : ""), "panels", row->panels, "panels_registered",
        row->panels_registered, "panels_refused", row->panels_refused, "sections", row->sections,
        "sections_found", row->sections_found, "loss_percent", gsn_ui_number(row->loss_percent),
        "loss_lower", gsn_ui_number(row->loss_lower), "loss_upper", gsn_ui_number(row->loss_upper),
        "mean_density", gsn_ui_number(row->mean_density), "run", (json_int_t)row->run, "report",
        row->report ? gsn_text_json(row->report) : json_null());
}

static json_t *sources_json(const struct gsn_bench_sources *sources)
{
    json_t *array = json_array();

    for (size_t i = 0; i < sources->count; i++) {
        const struct gsn_bench_source *s = &sources->at[i];

        (void)json_array_append_new(
            array, json_pack("{s:o, s:o, s:o, s:s, s:o, s:o, s:I, s:I, s:o, s:I}", "source",
                             gsn_text_json(s->name), "address", gsn_text_json(s->address), "device",
                             gsn_text_json(s->device), "state", s->state, "message",
                             gsn_text_json(s->message), "item", gsn_text_json(s->item), "done",
                             (json_int_t)s->done, "total", (json_int_t)s->total, "delivers",
                             gsn_text_json(s->expects), "changed", (json_int_t)s->changed));
    }
    return array;
}

static json_t *troubles_json(const struct gsn_trouble_rows *troubles)
{
    json_t *array = json_array();

    for (size_t i = 0; i < troubles->count; i++) {
        const struct gsn_trouble_row *t = &troubles->at[i];

        (void)json_array_append_new(
            array, json_pack("{s:o, s:o, s:o, s:o, s:I, s:I}", "source", gsn_text_json(t->source),
                             "name", gsn_text_json(t->name), "reason", gsn_text_json(t->reason),
                             "action", gsn_text_json(t->action), "tries", (json_int_t)t->tries,
                             "since", (json_int_t)t->since));
    }
    return array;
}

static json_t *unfiled_json(const struct gsn_scan_rows *scans)
{
    json_t *array = json_array();

    for (size_t i = 0; i < scans->count; i++) {
        const struct gsn_scan_row *s = &scans->at[i];
        gsn_auto_mem(char) action = gsn_snapshot_file_command(s->id, NULL);

        (void)json_array_append_new(
            array,
            json_pack("{s:I, s:o, s:o, s:s, s:I, s:o, s:I, s:s}", "scan", (json_int_t)s->id,
                      "source", gsn_text_json(s->source), "name", gsn_text_json(s->name), "sha256",
                      s->sha256, "size", (json_int_t)s->size, "reason", gsn_text_json(s->reason),
                      "arrived", (json_int_t)s->arrived, "action", action ? action : ""));
    }
    return array;
}

static void print_json(const struct gsn_ui *ui, const struct gsn_snapshot *snapshot)
{
    const struct gsn_job_counts *jobs = &snapshot->jobs;
    json_t *specimens = json_array();

    for (size_t i = 0; i < snapshot->count; i++)
        (void)json_array_append_new(specimens, row_json(&snapshot->at[i]));
    gsn_ui_print_json(
        ui,
        json_pack("{s:{s:I, s:I, s:I, s:I}, s:{s:b, s:b}, s:o, s:o, s:I, s:o, s:o}", "queue",
                  "waiting", (json_int_t)jobs->waiting, "running", (json_int_t)jobs->running,
                  "done", (json_int_t)jobs->done, "failed", (json_int_t)jobs->failed, "service",
                  "intake", snapshot->intake, "works_queue", snapshot->queue, "sources",
                  sources_json(snapshot->sources), "troubles", troubles_json(snapshot->troubles),
                  "unsettled", (json_int_t)snapshot->unsettled, "unfiled",
                  unfiled_json(snapshot->unfiled), "specimens", specimens));
}

int gsn_cmd_status(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_snapshot) snapshot = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc > 1)
        return gsn_ui_usage(ui, "status takes no argument, not \"%s\"; see `gieson show`", argv[1]);
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = gsn_snapshot_take(store, &snapshot, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    if (ui->json)
        print_json(ui, snapshot);
    else
        print_table(ui, snapshot);
    return EX_OK;
}
