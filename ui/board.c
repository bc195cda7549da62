/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/board.h"

#include "storage/advice.h"

#include "ui/board_parts.h"
#include "ui/look.h"
#include "ui/text.h"

#include <string.h>

struct gsn_board_line *gsn_board_add(struct gsn_board_maker *maker, enum gsn_board_kind kind,
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

void gsn_board_set(struct gsn_board_maker *maker, char **field, char *text)
{
    maker->no_memory |= !text;
    gsn_free(*field);
    *field = text;
}

void gsn_board_fact(struct gsn_board_maker *maker, struct gsn_board_line *line, char *text)
{
    size_t i = 0;

    while (i + 1 < GSN_BOARD_FACTS && line->fact[i])
        i++;
    gsn_board_set(maker, &line->fact[i], text);
}

void gsn_board_heading(struct gsn_board_maker *maker, const char *name)
{
    struct gsn_board_line *blank =
        maker->board->count ? gsn_board_add(maker, GSN_BOARD_HEADING, NULL) : NULL;
    struct gsn_board_line *line;

    if (blank)
        gsn_board_set(maker, &blank->name, gsn_strdup(""));
    line = gsn_board_add(maker, GSN_BOARD_HEADING, NULL);
    if (line)
        gsn_board_set(maker, &line->name, gsn_strdup(name));
}

static void command(struct gsn_board_maker *maker, const char *text)
{
    struct gsn_board_line *line = gsn_board_add(maker, GSN_BOARD_COMMAND, NULL);

    if (line)
        gsn_board_set(maker, &line->name, gsn_strdup(text));
}

/* ---- what comes in ----------------------------------------------------------------------- */

static char *receiving(const struct gsn_bench_source *source)
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
        return receiving(source);
    if (source->message[0])
        return gsn_strdup(source->message);
    if (source->expects[0])
        return gsn_format("delivers %s", source->expects);
    return gsn_strdup(source->device);
}

static void add_source(struct gsn_board_maker *maker, const struct gsn_bench_source *source)
{
    gsn_auto_mem(char) name = gsn_advice_word(source->name);
    struct gsn_board_line *line =
        gsn_board_add(maker, GSN_BOARD_SOURCE, gsn_look_of(source->state)->state);

    maker->no_memory |= !name;
    if (!line || !name)
        return;
    gsn_board_set(maker, &line->key, gsn_format("source %s", source->name));
    gsn_board_set(maker, &line->name, gsn_strdup(source->name));
    gsn_board_set(maker, &line->detail, source_detail(source));
    if (source->message[0])
        gsn_board_set(maker, &line->sentence, gsn_strdup(source->message));
    gsn_board_fact(maker, line, gsn_format("address   %s", source->address));
    if (source->device[0])
        gsn_board_fact(maker, line, gsn_format("device    %s", source->device));
    if (source->item[0])
        gsn_board_fact(maker, line, gsn_format("receives  %s", source->item));
    gsn_board_fact(
        maker, line,
        source->expects[0]
            ? gsn_format("delivers  panels of %s until `gieson expect %s --nobody`",
                         source->expects, name)
            : gsn_format("delivers  panels of whom their names say; `gieson expect %s SPECIMEN` "
                         "says it for all",
                         name));
    line->since = source->changed;
}

static void add_sources(struct gsn_board_maker *maker, const struct gsn_bench_sources *sources)
{
    size_t on = 0;

    for (size_t i = 0; i < sources->count; i++)
        on += strcmp(sources->at[i].state, "off") != 0;
    if (on > 0)
        gsn_board_heading(maker, "COMES IN");
    for (size_t i = 0; on > 0 && i < sources->count; i++)
        if (strcmp(sources->at[i].state, "off") != 0)
            add_source(maker, &sources->at[i]);
}

/* ---- what needs a person ----------------------------------------------------------------- */

static void add_trouble(struct gsn_board_maker *maker, const struct gsn_trouble_row *trouble)
{
    struct gsn_board_line *line = gsn_board_add(maker, GSN_BOARD_TROUBLE, "trouble");

    if (!line)
        return;
    gsn_board_set(maker, &line->key, gsn_format("trouble %s %s", trouble->source, trouble->name));
    gsn_board_set(maker, &line->name, gsn_strdup(trouble->name));
    gsn_board_set(maker, &line->detail, gsn_strdup(trouble->reason));
    gsn_board_set(maker, &line->sentence, gsn_strdup(trouble->reason));
    gsn_board_set(maker, &line->action, gsn_strdup(trouble->action));
    gsn_board_fact(maker, line, gsn_format("source    %s", trouble->source));
    gsn_board_fact(maker, line,
                   gsn_format("tried     %lld time%s", (long long)trouble->tries,
                              trouble->tries == 1 ? "" : "s"));
    line->since = trouble->since;
    command(maker, trouble->action);
}

static void add_scan(struct gsn_board_maker *maker, const struct gsn_scan_row *scan)
{
    struct gsn_board_line *line = gsn_board_add(maker, GSN_BOARD_SCAN, "unfiled");
    gsn_auto_mem(char) action = gsn_snapshot_file_command(scan->id, NULL);
    gsn_auto_mem(char) size = gsn_look_bytes(scan->size);

    maker->no_memory |= !action || !size;
    if (!line || !action || !size)
        return;
    gsn_board_set(maker, &line->key, gsn_format("scan %lld", (long long)scan->id));
    gsn_board_set(maker, &line->name, gsn_strdup(scan->name));
    gsn_board_set(maker, &line->detail, gsn_strdup(scan->reason));
    gsn_board_set(maker, &line->sentence, gsn_strdup(scan->reason));
    gsn_board_set(maker, &line->action, gsn_strdup(action));
    gsn_board_fact(maker, line, gsn_format("scan      %lld, %s", (long long)scan->id, size));
    gsn_board_fact(maker, line, gsn_format("source    %s", scan->source));
    if (scan->device[0])
        gsn_board_fact(maker, line, gsn_format("device    %s", scan->device));
    line->since = scan->arrived;
    command(maker, action);
}

static void add_needs(struct gsn_board_maker *maker, const struct gsn_snapshot *snapshot)
{
    if (snapshot->troubles->count + snapshot->unfiled->count > 0)
        gsn_board_heading(maker, "NEEDS YOU");
    for (size_t i = 0; i < snapshot->troubles->count; i++)
        add_trouble(maker, &snapshot->troubles->at[i]);
    for (size_t i = 0; i < snapshot->unfiled->count; i++)
        add_scan(maker, &snapshot->unfiled->at[i]);
}

/* ------------------------------------------------------------------------------------------ */

int gsn_board_make(const struct gsn_snapshot *snapshot, struct gsn_board **ret_board,
                   struct gsn_error *err)
{
    gsn_auto(gsn_board) board = gsn_alloc_array(1, sizeof *board);
    struct gsn_board_maker maker = { .board = board, .no_memory = !board };

    if (board) {
        add_sources(&maker, snapshot->sources);
        add_needs(&maker, snapshot);
        gsn_board_add_specimens(&maker, snapshot);
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
        return "giesond takes panels in and works the queue";
    if (snapshot->intake)
        return "giesond takes panels in; only `gieson run` works the queue";
    if (snapshot->queue)
        return "giesond works the queue; nothing comes in by itself";
    return "giesond is not running: nothing comes in; only `gieson run` works the queue";
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
