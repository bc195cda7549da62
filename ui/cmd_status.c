/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/snapshot.h"
#include "ui/text.h"
#include "ui/ui.h"

#include <math.h>
#include <stdio.h>
#include <string.h>
#include <sysexits.h>

/* State by symbol and word, so that neither colour nor a symbol alone carries the meaning. */
static const struct look {
    const char *state, *symbol, *colour;
} looks[] = { { "waiting", ".", "" },
              { "working", ">", "\033[36m" },
              { "reported", "+", "\033[32m" },
              { "withheld", "!", "\033[33m" },
              { "failed", "x", "\033[31m" } };

static const struct look *look_of(const char *state)
{
    for (size_t i = 0; i < sizeof looks / sizeof looks[0]; i++)
        if (strcmp(looks[i].state, state) == 0)
            return &looks[i];
    return &looks[0];
}

/* Columns of a row besides the specimen's name, up to the loss. */
enum { REST_OF_ROW = 49, NAME_LEAST = 10, NAME_MOST = 40, NEXT_GAP = 2 };

/* The command stands behind the row where there is room, else on a line of its own, never cut: it
 * is there to be copied. */
static void print_next(const struct gsn_ui *ui, const struct gsn_snapshot_row *row, int used)
{
    if (row->action && used + NEXT_GAP + gsn_text_columns(row->action) <= ui->width)
        gsn_text_line(stdout, "%*s%s", NEXT_GAP, "", row->action);
    else
        (void)putchar('\n');
    if (row->detail)
        gsn_text_wrap(stdout, 4, ui->width, row->detail);
    if (row->action && used + NEXT_GAP + gsn_text_columns(row->action) > ui->width)
        gsn_text_line(stdout, "    next: %s", row->action);
}

static void print_row(const struct gsn_ui *ui, const struct gsn_snapshot_row *row, int name_width)
{
    const struct look *look = look_of(row->state);
    gsn_auto_mem(char) name = gsn_text_cell(row->name, name_width);
    gsn_auto_mem(char) group = gsn_text_cell(row->group, 8);
    char loss[24] = "-", panels[24], sections[24];

    if (!isnan(row->loss_percent))
        (void)snprintf(loss, sizeof loss, "%.2f %%", row->loss_percent);
    (void)snprintf(panels, sizeof panels, "%u/%u", row->panels_registered, row->panels);
    (void)snprintf(sections, sizeof sections, "%u/%u", row->sections_found, row->sections);
    (void)printf("%s%s %s %s %7s %9s %-9s %9s%s", ui->colour ? look->colour : "", look->symbol,
                 name ? name : "", group ? group : "", panels, sections, row->state, loss,
                 ui->colour ? "\033[0m" : "");
    print_next(ui, row, name_width + REST_OF_ROW);
}

/* One specimen in a few short lines, where the table is too wide. */
static void print_block(const struct gsn_ui *ui, const struct gsn_snapshot_row *row)
{
    const struct look *look = look_of(row->state);
    gsn_auto_mem(char) facts = gsn_format("panels %u/%u, sections %u/%u", row->panels_registered,
                                          row->panels, row->sections_found, row->sections);

    (void)fputs(ui->colour ? look->colour : "", stdout);
    (void)printf("%s %s%s ", look->symbol, row->state, ui->colour ? "\033[0m" : "");
    gsn_text_line(stdout, "%s", row->name);
    gsn_text_wrap(stdout, 4, ui->width, facts ? facts : "");
    if (!isnan(row->loss_percent))
        (void)printf("    loss %.2f %%\n", row->loss_percent);
    if (row->detail)
        gsn_text_wrap(stdout, 4, ui->width, row->detail);
    if (row->action)
        gsn_text_line(stdout, "    next: %s", row->action);
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

static void print_table(const struct gsn_ui *ui, const struct gsn_snapshot *snapshot)
{
    const struct gsn_job_counts *jobs = &snapshot->jobs;
    const int name_width = name_columns(ui, snapshot);
    gsn_auto_mem(char) queue = gsn_format(
        "queue: %lld waiting, %lld running, %lld done, %lld failed", (long long)jobs->waiting,
        (long long)jobs->running, (long long)jobs->done, (long long)jobs->failed);

    gsn_text_wrap(stdout, 0, ui->width, queue ? queue : "");
    if (snapshot->count == 0)
        gsn_text_wrap(stdout, 0, ui->width, "no specimen yet: `gieson import FOLDER` takes one in");
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
    return json_pack("{s:o, s:o, s:s, s:o, s:o, s:i, s:i, s:i, s:i, s:i, s:o, s:o, s:I, s:o}",
                     "specimen", gsn_text_json(row->name), "group", gsn_text_json(row->group),
                     "state", row->state, "detail", gsn_text_json(row->detail ? row->detail : ""),
                     "action", gsn_text_json(row->action ? row->action : ""), "panels", row->panels,
                     "panels_registered", row->panels_registered, "panels_refused",
                     row->panels_refused, "sections", row->sections, "sections_found",
                     row->sections_found, "loss_percent", gsn_ui_number(row->loss_percent),
                     "mean_density", gsn_ui_number(row->mean_density), "run", (json_int_t)row->run,
                     "report", row->report ? gsn_text_json(row->report) : json_null());
}

static void print_json(const struct gsn_snapshot *snapshot)
{
    json_t *specimens = json_array();

    for (size_t i = 0; i < snapshot->count; i++)
        (void)json_array_append_new(specimens, row_json(&snapshot->at[i]));
    gsn_ui_print_json(json_pack(
        "{s:{s:I, s:I, s:I, s:I}, s:o}", "queue", "waiting", (json_int_t)snapshot->jobs.waiting,
        "running", (json_int_t)snapshot->jobs.running, "done", (json_int_t)snapshot->jobs.done,
        "failed", (json_int_t)snapshot->jobs.failed, "specimens", specimens));
}

int gsn_cmd_status(const struct gsn_ui *ui, int argc, char **argv)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_snapshot) snapshot = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, r;

    if (argc > 1)
        return gsn_ui_usage("status takes no argument, not \"%s\"; see `gieson show`", argv[1]);
    store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!store)
        return status;
    r = gsn_snapshot_take(store, &snapshot, &err);
    if (r < 0)
        return gsn_ui_complain(&err, r);
    if (ui->json)
        print_json(snapshot);
    else
        print_table(ui, snapshot);
    return EX_OK;
}
