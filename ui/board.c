/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A snapshot of the store as the lines of `gieson top`.
 *
 * Steps. What comes in (sources, and what they receive), what needs a person (troubles, unfiled
 * scans, panels that are held), then the specimens: those that failed, those at work, those that
 * wait, the others, the latest first, each with its panels that are not done. A line has its state,
 * sentence, next command and facts.
 *
 * How it fails: memory that runs out is noted by the maker and said once at the end. */
#include "ui/board.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "storage/advice.h"
#include "ui/text.h"

/* A board while its lines are made: they are added and filled; whoever runs out of memory says so
 * once, at the end. */
struct board_maker {
    struct gsn_board *board;
    size_t room;
    int no_memory;
};

/* Making lines. */

/* borrows: the new line until the next is added; NULL when memory ran out. */
static struct gsn_board_line *add_line(struct board_maker *maker, enum gsn_board_kind kind,
                                       const char *state)
{
    struct gsn_board *board = maker->board;

    if (board->count == maker->room) {
        const size_t room = maker->room ? 2 * maker->room : 64;
        struct gsn_board_line *more = gsn_realloc_array(board->at, room, sizeof *more);

        if (!more) {
            maker->no_memory = 1;
            return NULL;
        }
        board->at = more;
        maker->room = room;
    }
    board->at[board->count] = (struct gsn_board_line){ .kind = kind, .state = state };
    return &board->at[board->count++];
}

/* Both take text, which is NULL when memory ran out. */
static void set_text(struct board_maker *maker, char **field, char *text)
{
    maker->no_memory |= !text;
    gsn_free(*field);
    *field = text;
}

static void add_fact(struct board_maker *maker, struct gsn_board_line *line, char *text)
{
    size_t i = 0;

    while (i + 1 < GSN_BOARD_FACTS && line->fact[i])
        i++;
    set_text(maker, &line->fact[i], text);
}

/* After a blank line, unless it is the first. */
static void add_heading(struct board_maker *maker, const char *name)
{
    struct gsn_board_line *blank =
        maker->board->count ? add_line(maker, GSN_BOARD_HEADING, NULL) : NULL;
    struct gsn_board_line *line;

    if (blank)
        set_text(maker, &blank->name, gsn_strdup(""));
    line = add_line(maker, GSN_BOARD_HEADING, NULL);
    if (line)
        set_text(maker, &line->name, gsn_strdup(name));
}

/* Specimens and their panels. */

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

static void specimen_facts(struct board_maker *maker, struct gsn_board_line *line,
                           const struct gsn_snapshot_row *row)
{
    if (row->group[0])
        add_fact(maker, line, gsn_format("group     %s", row->group));
    if (gsn_snapshot_has_panels(row))
        add_fact(maker, line,
                 gsn_format("panels    %u of %u read, %u refused or held", row->panels_registered,
                            row->panels, row->panels_refused));
    if (gsn_snapshot_has_panels(row))
        add_fact(maker, line,
                 gsn_format("sections  %u of %u found", row->sections_found, row->sections));
    if (!isnan(row->loss_percent)) {
        gsn_auto_mem(char) loss =
            gsn_look_loss(row->loss_percent, row->loss_lower, row->loss_upper);

        add_fact(maker, line, loss ? gsn_format("loss      %s", loss) : NULL);
    }
    if (row->report)
        add_fact(maker, line, gsn_format("report    %s", row->report));
}

static void add_specimen(struct board_maker *maker, const struct gsn_snapshot_row *row)
{
    struct gsn_board_line *line = add_line(maker, GSN_BOARD_SPECIMEN, row->state);

    if (!line)
        return;
    set_text(maker, &line->key, gsn_format("specimen %lld", (long long)row->id));
    set_text(maker, &line->name, gsn_strdup(row->name));
    set_text(maker, &line->detail, specimen_detail(row));
    if (row->detail)
        set_text(maker, &line->sentence, gsn_strdup(row->detail));
    if (row->action)
        set_text(maker, &line->action, gsn_strdup(row->action));
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

static void panel_action(struct board_maker *maker, struct gsn_board_line *line,
                         const struct gsn_open_panel_row *panel,
                         const struct gsn_snapshot_row *specimen)
{
    gsn_auto_mem(char) name = gsn_advice_word(specimen->name);
    const char *verb = strcmp(line->state, "failed") == 0 ? "retry" : "show";

    if (panel->scan && strcmp(line->state, "held") == 0)
        set_text(maker, &line->action, gsn_snapshot_file_command(panel->scan, specimen->name));
    else
        set_text(maker, &line->action, name ? gsn_format("gieson %s %s", verb, name) : NULL);
}

static void add_panel(struct board_maker *maker, const struct gsn_open_panel_row *panel,
                      const struct gsn_snapshot_row *specimen)
{
    struct gsn_board_line *line = add_line(maker, GSN_BOARD_PANEL, panel_state(panel));
    const struct gsn_overview_job *job = &panel->job;
    const char *sentence = panel_sentence(panel);

    if (!line)
        return;
    set_text(maker, &line->key, gsn_format("panel %lld", (long long)panel->id));
    set_text(maker, &line->name,
             panel->number ? gsn_format("panel %lld", (long long)panel->number)
                           : gsn_strdup("panel ?"));
    if (strcmp(line->state, "working") == 0)
        set_text(maker, &line->detail,
                 gsn_look_progress(job->stage, job->done, job->total, job->eta_s));
    else
        set_text(maker, &line->detail, gsn_strdup(sentence[0] ? sentence : panel->file_name));
    if (sentence[0]) {
        set_text(maker, &line->sentence, gsn_strdup(sentence));
        panel_action(maker, line, panel, specimen);
    }
    add_fact(maker, line, gsn_format("specimen  %s", specimen->name));
    add_fact(maker, line, gsn_format("file      %s", panel->file_name));
    line->since = panel->arrived;
    line->specimen = panel->specimen_id;
}

/* One line for all of a specimen's doubtful sections, from the first on; the command is about that.
 */
static void add_doubts(struct board_maker *maker, const struct gsn_doubt_row *first, size_t count,
                       const struct gsn_snapshot_row *specimen)
{
    struct gsn_board_line *line = count > 0 ? add_line(maker, GSN_BOARD_DOUBT, "needs-eye") : NULL;
    gsn_auto_mem(char) name = gsn_advice_word(specimen->name);

    if (!line)
        return;
    set_text(maker, &line->key, gsn_format("doubt %lld", (long long)specimen->id));
    set_text(maker, &line->name,
             count == 1
                 ? gsn_format("section %lld.%lld", (long long)first->panel, (long long)first->slot)
                 : gsn_format("%zu sections", count));
    set_text(maker, &line->detail,
             gsn_format("%lld poses to choose from for section %lld.%lld",
                        (long long)first->candidates, (long long)first->panel,
                        (long long)first->slot));
    set_text(maker, &line->sentence,
             gsn_format("`gieson show` lists the poses that %s may have, and the report shows them",
                        count == 1 ? "it" : "they"));
    set_text(maker, &line->action,
             name ? gsn_format("gieson decide %s %lld.%lld pose N", name, (long long)first->panel,
                               (long long)first->slot)
                  : NULL);
    add_fact(maker, line, gsn_format("specimen  %s", specimen->name));
    line->specimen = specimen->id;
}

static int rank_of(const struct gsn_snapshot_row *row)
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

    if (rank_of(a) != rank_of(b))
        return rank_of(a) - rank_of(b);
    /* What waits or runs keeps its place; of what is done the latest is of interest. */
    if (rank_of(a) == 3 && a->changed != b->changed)
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

static void add_doubts_of(struct board_maker *maker, const struct gsn_doubt_rows *doubts,
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

/* Specimens, each with its panels and doubts. */
static void add_specimens(struct board_maker *maker, const struct gsn_snapshot *snapshot)
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
    add_heading(maker, snapshot->count ? "SPECIMENS"
                                       : "no specimen yet: `gieson import FOLDER` takes one in");
    for (size_t i = 0; i < snapshot->count && !maker->no_memory; i++) {
        add_specimen(maker, order[i]);
        for (size_t p = first_panel(panels, order[i]->id);
             p < panels->count && panels->at[p].specimen_id == order[i]->id; p++)
            add_panel(maker, &panels->at[p], order[i]);
        add_doubts_of(maker, snapshot->doubts, order[i]);
    }
}

static void add_command(struct board_maker *maker, const char *text)
{
    struct gsn_board_line *line = add_line(maker, GSN_BOARD_COMMAND, NULL);

    if (line)
        set_text(maker, &line->name, gsn_strdup(text));
}

/* ---- what comes in ----------------------------------------------------------------------- */

static char *describe_receiving(const struct gsn_bench_source *source)
{
    gsn_auto_mem(char) size = gsn_look_bytes(source->total);

    if (!size)
        return NULL;
    if (source->total <= 0)
        return gsn_strdup(source->item);
    return gsn_format("%.0f %% of %s, %s", 100 * (double)source->done / (double)source->total, size,
                      source->item);
}

static char *source_detail(const struct gsn_bench_source *source)
{
    if (strcmp(source->state, "receiving") == 0)
        return describe_receiving(source);
    if (source->message[0])
        return gsn_strdup(source->message);
    if (source->expects[0])
        return gsn_format("delivers %s", source->expects);
    return gsn_strdup(source->device);
}

static void add_source(struct board_maker *maker, const struct gsn_bench_source *source)
{
    gsn_auto_mem(char) name = gsn_advice_word(source->name);
    struct gsn_board_line *line =
        add_line(maker, GSN_BOARD_SOURCE, gsn_look_of(source->state)->state);

    maker->no_memory |= !name;
    if (!line || !name)
        return;
    set_text(maker, &line->key, gsn_format("source %s", source->name));
    set_text(maker, &line->name, gsn_strdup(source->name));
    set_text(maker, &line->detail, source_detail(source));
    if (source->message[0])
        set_text(maker, &line->sentence, gsn_strdup(source->message));
    add_fact(maker, line, gsn_format("address   %s", source->address));
    if (source->device[0])
        add_fact(maker, line, gsn_format("device    %s", source->device));
    if (source->item[0])
        add_fact(maker, line, gsn_format("receives  %s", source->item));
    add_fact(
        maker, line,
        source->expects[0]
            ? gsn_format("delivers  panels of %s until `gieson expect %s --nobody`",
                         source->expects, name)
            : gsn_format("delivers  panels of whom their names say; `gieson expect %s SPECIMEN` "
                         "says it for all",
                         name));
    line->since = source->changed;
}

static void add_sources(struct board_maker *maker, const struct gsn_bench_sources *sources)
{
    size_t on = 0;

    for (size_t i = 0; i < sources->count; i++)
        on += strcmp(sources->at[i].state, "off") != 0;
    if (on > 0)
        add_heading(maker, "COMES IN");
    for (size_t i = 0; on > 0 && i < sources->count; i++)
        if (strcmp(sources->at[i].state, "off") != 0)
            add_source(maker, &sources->at[i]);
}

/* ---- what needs a person ----------------------------------------------------------------- */

static void add_trouble(struct board_maker *maker, const struct gsn_trouble_row *trouble)
{
    struct gsn_board_line *line = add_line(maker, GSN_BOARD_TROUBLE, "trouble");

    if (!line)
        return;
    set_text(maker, &line->key, gsn_format("trouble %s %s", trouble->source, trouble->name));
    set_text(maker, &line->name, gsn_strdup(trouble->name));
    set_text(maker, &line->detail, gsn_strdup(trouble->reason));
    set_text(maker, &line->sentence, gsn_strdup(trouble->reason));
    set_text(maker, &line->action, gsn_strdup(trouble->action));
    add_fact(maker, line, gsn_format("source    %s", trouble->source));
    add_fact(maker, line,
             gsn_format("tried     %lld time%s", (long long)trouble->tries,
                        trouble->tries == 1 ? "" : "s"));
    line->since = trouble->since;
    add_command(maker, trouble->action);
}

static void add_scan(struct board_maker *maker, const struct gsn_scan_row *scan)
{
    struct gsn_board_line *line = add_line(maker, GSN_BOARD_SCAN, "unfiled");
    gsn_auto_mem(char) action = gsn_snapshot_file_command(scan->id, NULL);
    gsn_auto_mem(char) size = gsn_look_bytes(scan->size);

    maker->no_memory |= !action || !size;
    if (!line || !action || !size)
        return;
    set_text(maker, &line->key, gsn_format("scan %lld", (long long)scan->id));
    set_text(maker, &line->name, gsn_strdup(scan->name));
    set_text(maker, &line->detail, gsn_strdup(scan->reason));
    set_text(maker, &line->sentence, gsn_strdup(scan->reason));
    set_text(maker, &line->action, gsn_strdup(action));
    add_fact(maker, line, gsn_format("scan      %lld, %s", (long long)scan->id, size));
    add_fact(maker, line, gsn_format("source    %s", scan->source));
    if (scan->device[0])
        add_fact(maker, line, gsn_format("device    %s", scan->device));
    line->since = scan->arrived;
    add_command(maker, action);
}

static void add_needs(struct board_maker *maker, const struct gsn_snapshot *snapshot)
{
    if (snapshot->troubles->count + snapshot->unfiled->count > 0)
        add_heading(maker, "NEEDS YOU");
    for (size_t i = 0; i < snapshot->troubles->count; i++)
        add_trouble(maker, &snapshot->troubles->at[i]);
    for (size_t i = 0; i < snapshot->unfiled->count; i++)
        add_scan(maker, &snapshot->unfiled->at[i]);
}

int gsn_board_make(const struct gsn_snapshot *snapshot, struct gsn_board **ret_board,
                   struct gsn_error *err)
{
    gsn_auto(gsn_board) board = gsn_alloc_array(1, sizeof *board);
    struct board_maker maker = { .board = board, .no_memory = !board };

    if (board) {
        add_sources(&maker, snapshot->sources);
        add_needs(&maker, snapshot);
        add_specimens(&maker, snapshot);
    }
    if (maker.no_memory)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the lines of the screen");
    *ret_board = gsn_steal(&board);
    return GSN_OK;
}

void gsn_board_free(struct gsn_board *board)
{
    if (!board)
        return;
    for (size_t i = 0; i < board->count; i++) {
        struct gsn_board_line *line = &board->at[i];

        gsn_free(line->key);
        gsn_free(line->name);
        gsn_free(line->detail);
        gsn_free(line->sentence);
        gsn_free(line->action);
        for (size_t f = 0; f < GSN_BOARD_FACTS; f++)
            gsn_free(line->fact[f]);
    }
    gsn_free(board->at);
    gsn_free(board);
}

int gsn_board_is_part(const struct gsn_board_line *line)
{
    return line->kind == GSN_BOARD_PANEL || line->kind == GSN_BOARD_DOUBT;
}

int gsn_board_is_item(const struct gsn_board_line *line)
{
    return line->kind != GSN_BOARD_HEADING && line->kind != GSN_BOARD_COMMAND;
}

static const char *service_words(const struct gsn_snapshot *snapshot)
{
    if (snapshot->intake && snapshot->queue)
        return "giesond takes panels in and does the jobs";
    if (snapshot->intake)
        return "giesond takes panels in; only `gieson run` does the jobs";
    if (snapshot->queue)
        return "giesond does the jobs; nothing comes in by itself";
    return "giesond is not running: nothing comes in; only `gieson run` does the jobs";
}

char *gsn_board_service(const struct gsn_snapshot *snapshot)
{
    const char *words = service_words(snapshot);
    const long long n = snapshot->unsettled;

    if (n == 0)
        return gsn_strdup(words);
    return gsn_format("%s; %lld picture%s came in, %s safe and %s", words, n, n == 1 ? "" : "s",
                      n == 1 ? "is" : "are",
                      snapshot->intake || snapshot->queue ? "being filed"
                                                          : "not filed yet: `gieson run` does it");
}
