/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/board_parts.h"

#include "storage/advice.h"

#include "ui/look.h"
#include "ui/text.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static char *specimen_detail(const struct gsn_snapshot_row *row)
{
    gsn_auto_mem(char) panels =
        row->panels == 0 ? gsn_strdup("")
                         : gsn_format("%u/%u panels", row->panels_registered, row->panels);
    const char *between = panels && panels[0] ? ", " : "";

    if (!panels)
        return NULL;
    if (strcmp(row->state, "failed") == 0 || strcmp(row->state, "withheld") == 0 ||
        (strcmp(row->state, "waiting") == 0 && row->panels == 0))
        return gsn_strdup(row->detail ? row->detail : "");
    if (row->progress)
        return gsn_format("%s%s%s", panels, between, row->progress);
    if (strcmp(row->state, "reported") == 0 && !isnan(row->loss_percent))
        return gsn_format("%s%sloss %.2f %%", panels, between, row->loss_percent);
    return gsn_strdup(panels);
}

static void specimen_facts(struct gsn_board_maker *maker, struct gsn_board_line *line,
                           const struct gsn_snapshot_row *row)
{
    if (row->group[0])
        gsn_board_fact(maker, line, gsn_format("group     %s", row->group));
    if (gsn_snapshot_has_panels(row))
        gsn_board_fact(maker, line,
                       gsn_format("panels    %u of %u read, %u refused or held",
                                  row->panels_registered, row->panels, row->panels_refused));
    if (gsn_snapshot_has_panels(row))
        gsn_board_fact(maker, line,
                       gsn_format("sections  %u of %u found", row->sections_found, row->sections));
    if (!isnan(row->loss_percent)) {
        gsn_auto_mem(char) loss =
            gsn_look_loss(row->loss_percent, row->loss_lower, row->loss_upper);

        gsn_board_fact(maker, line, loss ? gsn_format("loss      %s", loss) : NULL);
    }
    if (row->report)
        gsn_board_fact(maker, line, gsn_format("report    %s", row->report));
}

static void add_specimen(struct gsn_board_maker *maker, const struct gsn_snapshot_row *row)
{
    struct gsn_board_line *line = gsn_board_add(maker, GSN_BOARD_SPECIMEN, row->state);

    if (!line)
        return;
    gsn_board_set(maker, &line->key, gsn_format("specimen %lld", (long long)row->id));
    gsn_board_set(maker, &line->name, gsn_strdup(row->name));
    gsn_board_set(maker, &line->detail, specimen_detail(row));
    if (row->detail)
        gsn_board_set(maker, &line->sentence, gsn_strdup(row->detail));
    if (row->action)
        gsn_board_set(maker, &line->action, gsn_strdup(row->action));
    specimen_facts(maker, line, row);
    line->since = row->changed;
    line->specimen = row->id;
}

static const char *panel_state(const struct gsn_open_panel_row *panel)
{
    if (strcmp(panel->job.state, "failed") == 0)
        return "failed";
    if (strcmp(panel->job.state, "running") == 0)
        return "working";
    if (panel->job.state[0])
        return "waiting";
    return strcmp(panel->state, "refused") == 0 ? "refused" : "held";
}

static const char *panel_sentence(const struct gsn_open_panel_row *panel)
{
    return strcmp(panel->job.state, "failed") == 0 ? panel->job.message
           : panel->job.state[0]                   ? ""
                                                   : panel->message;
}

static void panel_action(struct gsn_board_maker *maker, struct gsn_board_line *line,
                         const struct gsn_open_panel_row *panel,
                         const struct gsn_snapshot_row *specimen)
{
    gsn_auto_mem(char) name = gsn_advice_word(specimen->name);
    const char *verb = strcmp(line->state, "failed") == 0 ? "retry" : "show";

    if (panel->scan && strcmp(line->state, "held") == 0)
        gsn_board_set(maker, &line->action, gsn_snapshot_file_command(panel->scan, specimen->name));
    else
        gsn_board_set(maker, &line->action, name ? gsn_format("gieson %s %s", verb, name) : NULL);
}

static void add_panel(struct gsn_board_maker *maker, const struct gsn_open_panel_row *panel,
                      const struct gsn_snapshot_row *specimen)
{
    struct gsn_board_line *line = gsn_board_add(maker, GSN_BOARD_PANEL, panel_state(panel));
    const struct gsn_overview_job *job = &panel->job;
    const char *sentence = panel_sentence(panel);

    if (!line)
        return;
    gsn_board_set(maker, &line->key, gsn_format("panel %lld", (long long)panel->id));
    gsn_board_set(maker, &line->name,
                  panel->number ? gsn_format("panel %lld", (long long)panel->number)
                                : gsn_strdup("panel ?"));
    if (strcmp(line->state, "working") == 0)
        gsn_board_set(maker, &line->detail,
                      gsn_look_progress(job->stage, job->done, job->total, job->eta_s));
    else
        gsn_board_set(maker, &line->detail, gsn_strdup(sentence[0] ? sentence : panel->file_name));
    if (sentence[0]) {
        gsn_board_set(maker, &line->sentence, gsn_strdup(sentence));
        panel_action(maker, line, panel, specimen);
    }
    gsn_board_fact(maker, line, gsn_format("specimen  %s", specimen->name));
    gsn_board_fact(maker, line, gsn_format("file      %s", panel->file_name));
    line->since = panel->arrived;
    line->specimen = panel->specimen_id;
}

/* One line for all of a specimen's doubtful sections, from the first on; the command is about that.
 */
static void add_doubts(struct gsn_board_maker *maker, const struct gsn_doubt_row *first,
                       size_t count, const struct gsn_snapshot_row *specimen)
{
    struct gsn_board_line *line =
        count > 0 ? gsn_board_add(maker, GSN_BOARD_DOUBT, "needs-eye") : NULL;
    gsn_auto_mem(char) name = gsn_advice_word(specimen->name);

    if (!line)
        return;
    gsn_board_set(maker, &line->key, gsn_format("doubt %lld", (long long)specimen->id));
    gsn_board_set(maker, &line->name,
                  count == 1 ? gsn_format("section %lld.%lld", (long long)first->panel,
                                          (long long)first->slot)
                             : gsn_format("%zu sections", count));
    gsn_board_set(maker, &line->detail,
                  gsn_format("%lld poses to choose from for section %lld.%lld",
                             (long long)first->candidates, (long long)first->panel,
                             (long long)first->slot));
    gsn_board_set(
        maker, &line->sentence,
        gsn_format("`gieson show` lists the poses that %s may have, and the report shows them",
                   count == 1 ? "it" : "they"));
    gsn_board_set(maker, &line->action,
                  name ? gsn_format("gieson decide %s %lld.%lld pose N", name,
                                    (long long)first->panel, (long long)first->slot)
                       : NULL);
    gsn_board_fact(maker, line, gsn_format("specimen  %s", specimen->name));
    line->specimen = specimen->id;
}

static int rank(const struct gsn_snapshot_row *row)
{
    static const char *const order[] = { "failed", "working", "waiting" };
    int i = 0;

    while (i < 3 && strcmp(order[i], row->state) != 0)
        i++;
    return i;
}

static int by_rank(const void *left, const void *right)
{
    const struct gsn_snapshot_row *a = *(const struct gsn_snapshot_row *const *)left;
    const struct gsn_snapshot_row *b = *(const struct gsn_snapshot_row *const *)right;

    if (rank(a) != rank(b))
        return rank(a) - rank(b);
    /* What waits or runs keeps its place; of what is done the latest is of interest. */
    if (rank(a) == 3 && a->changed != b->changed)
        return a->changed > b->changed ? -1 : 1;
    return a->id < b->id ? -1 : a->id > b->id;
}

/* The first of the specimen's panels; panels are in order of specimens. */
static size_t first_panel(const struct gsn_open_panel_rows *panels, int64_t specimen)
{
    size_t low = 0, high = panels->count;

    while (low < high) {
        const size_t middle = (low + high) / 2;

        if (panels->at[middle].specimen_id < specimen)
            low = middle + 1;
        else
            high = middle;
    }
    return low;
}

static void add_doubts_of(struct gsn_board_maker *maker, const struct gsn_doubt_rows *doubts,
                          const struct gsn_snapshot_row *specimen)
{
    size_t first = 0, count = 0;

    while (first < doubts->count && doubts->at[first].specimen_id < specimen->id)
        first++;
    while (first + count < doubts->count && doubts->at[first + count].specimen_id == specimen->id)
        count++;
    if (count > 0)
        add_doubts(maker, &doubts->at[first], count, specimen);
}

void gsn_board_add_specimens(struct gsn_board_maker *maker, const struct gsn_snapshot *snapshot)
{
    const struct gsn_open_panel_rows *panels = snapshot->panels;
    gsn_auto_mem(const struct gsn_snapshot_row *) order =
        gsn_alloc_array(snapshot->count, sizeof *order);

    maker->no_memory |= !order;
    if (!order)
        return;
    for (size_t i = 0; i < snapshot->count; i++)
        order[i] = &snapshot->at[i];
    qsort(order, snapshot->count, sizeof *order, by_rank);
    gsn_board_heading(maker, snapshot->count
                                 ? "SPECIMENS"
                                 : "no specimen yet: `gieson import FOLDER` takes one in");
    for (size_t i = 0; i < snapshot->count && !maker->no_memory; i++) {
        add_specimen(maker, order[i]);
        for (size_t p = first_panel(panels, order[i]->id);
             p < panels->count && panels->at[p].specimen_id == order[i]->id; p++)
            add_panel(maker, &panels->at[p], order[i]);
        add_doubts_of(maker, snapshot->doubts, order[i]);
    }
}
