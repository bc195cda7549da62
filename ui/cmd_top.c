/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* `gieson top`: the queue as it goes, read from the store alone; as a table, once, where there is
 * no terminal to draw on. */
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <sysexits.h>
#include <time.h>
#include <unistd.h>

#include "storage/advice.h"
#include "storage/queue.h"
#include "ui/queue_view.h"
#include "ui/text.h"
#include "ui/ui.h"

enum {
    LOOK_EVERY_MS = 500,
    PATIENCE_MS = 250, /* a locked database must not stop the keys */
    AGES_EVERY_S = 20, /* ages are told in minutes */
};

/* The store as it is watched. */
struct watch {
    const struct gsn_ui *ui;
    struct gsn_store *store; /* NULL while it cannot be opened */
    struct stat file;        /* the database that is open */
    int64_t change, told;    /* number of the store, and when its state was shown */
    int intake, queue;
};

static int is_same_file(const struct watch *watch)
{
    gsn_auto_mem(char) path = gsn_format("%s/gieson.db", watch->ui->store_dir);
    struct stat now;

    return path && stat(path, &now) == 0 && now.st_ino == watch->file.st_ino &&
           now.st_dev == watch->file.st_dev;
}

static int reopen_store(struct watch *watch, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/gieson.db", watch->ui->store_dir);
    int r;

    gsn_store_free(watch->store);
    watch->store = NULL;
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = gsn_store_open(watch->ui->store_dir, GSN_STORE_READ, &watch->store, err);
    if (r < 0)
        return r;
    gsn_store_set_busy_timeout(watch->store, PATIENCE_MS);
    watch->told = 0;
    if (stat(path, &watch->file) < 0)
        return gsn_fail(err, GSN_E_NOTFOUND, "%s is gone", path);
    return GSN_OK;
}

/* Whether what is shown may be out of date: others committed, the service came or went, ages grew.
 */
static int has_changed(struct watch *watch, int64_t now, int *ret_news, struct gsn_error *err)
{
    int intake = 0, queue = 0;
    int64_t change = 0;
    int r = gsn_store_change(watch->store, &change, err);

    if (r >= 0)
        r = gsn_snapshot_services(watch->ui->store_dir, &intake, &queue, err);
    if (r < 0)
        return r;
    *ret_news = change != watch->change || intake != watch->intake || queue != watch->queue ||
                now - watch->told >= AGES_EVERY_S || now < watch->told;
    watch->change = change;
    watch->intake = intake;
    watch->queue = queue;
    return GSN_OK;
}

static int look_at_store(struct watch *watch, struct gsn_queue_view *view, int *ret_news,
                         struct gsn_error *err)
{
    const int64_t now = time(NULL);
    gsn_auto(gsn_snapshot) snapshot = NULL;
    int r = watch->store && is_same_file(watch) ? GSN_OK : reopen_store(watch, err);

    if (r >= 0)
        r = has_changed(watch, now, ret_news, err);
    if (r < 0 || !*ret_news)
        return r;
    r = gsn_snapshot_take(watch->store, &snapshot, err);
    if (r >= 0)
        r = gsn_queue_view_set(view, snapshot, now, err);
    watch->told = r >= 0 ? now : 0;
    return r;
}

/* Shows what is new; a store that does not answer is a line on the screen. Returns whether
 * anything must be drawn. */
static int refresh_view(struct watch *watch, struct gsn_queue_view *view)
{
    struct gsn_error err = { 0 };
    int news = 0;

    if (look_at_store(watch, view, &news, &err) >= 0)
        return news;
    watch->told = 0;
    gsn_queue_view_set_trouble(view, err.text);
    return 1;
}

static void retry_jobs(const struct watch *watch, struct gsn_queue_view *view, int64_t specimen)
{
    gsn_auto(gsn_store) store = NULL;
    gsn_auto_mem(char) said = NULL;
    struct gsn_error err = { 0 };
    size_t count = 0;
    int r = gsn_store_open(watch->ui->store_dir, GSN_STORE_WRITE, &store, &err);

    if (r >= 0) {
        gsn_store_set_busy_timeout(store, PATIENCE_MS);
        r = gsn_queue_retry(store, specimen, &count, &err);
    }
    if (r < 0)
        said = gsn_strdup(err.text);
    else
        said = gsn_format("%zu failed job%s again%s", count, count == 1 ? " waits" : "s wait",
                          watch->queue ? "" : "; `gieson run` does them");
    gsn_queue_view_say(view, said);
}

static void watch_screen(struct watch *watch, struct gsn_queue_view *view,
                         struct gsn_screen *screen)
{
    enum gsn_queue_wish wish = GSN_QUEUE_WISH_NONE;
    int key = GSN_KEY_RESIZED;

    while (key != GSN_KEY_CLOSED && wish != GSN_QUEUE_WISH_QUIT) {
        /* Keys that wait are taken before the store is asked: holding one down must not lag. */
        if (key == GSN_KEY_NONE ? refresh_view(watch, view) : 1)
            gsn_queue_view_draw(view, screen);
        key = gsn_screen_key(screen, LOOK_EVERY_MS);
        wish = key >= 0 ? gsn_queue_view_key(view, key) : GSN_QUEUE_WISH_NONE;
        if (wish == GSN_QUEUE_WISH_RETRY)
            retry_jobs(watch, view, gsn_queue_view_specimen(view));
        if (wish == GSN_QUEUE_WISH_RETRY_ALL)
            retry_jobs(watch, view, 0);
    }
}

/* ---- without a terminal ------------------------------------------------------------------ */

static void print_line(const struct gsn_ui *ui, const struct gsn_board_line *line, int name_width,
                       int64_t now)
{
    const int indent = gsn_board_is_part(line) ? 2 : 0;
    gsn_auto_mem(char) age = gsn_look_age(now, line->since);
    gsn_auto_mem(char) name = gsn_text_cell(line->name, name_width - indent);
    const char *told = line->sentence ? line->sentence : line->detail;
    gsn_auto_mem(char) detail = gsn_advice(ui->store_dir, told ? told : "");

    if (line->kind == GSN_BOARD_HEADING)
        gsn_ui_say(ui, "%s", line->name);
    else if (line->kind == GSN_BOARD_COMMAND)
        gsn_ui_next(ui, line->name, "");
    else {
        gsn_text_line(stdout, "%*s%s %s  %-9s  %-6s  %s", indent, "",
                      gsn_look_of(line->state)->symbol, name ? name : "", line->state,
                      age ? age : "", detail ? detail : "");
        if (line->action && line->kind != GSN_BOARD_TROUBLE && line->kind != GSN_BOARD_SCAN)
            gsn_ui_next(ui, line->action, "");
    }
}

static int print_table(const struct gsn_ui *ui, struct gsn_store *store)
{
    gsn_auto(gsn_snapshot) snapshot = NULL;
    gsn_auto(gsn_board) board = NULL;
    gsn_auto_mem(char) service = NULL;
    struct gsn_error err = { 0 };
    const int64_t now = time(NULL);
    int width = 10;
    int r = gsn_snapshot_take(store, &snapshot, &err);

    if (r >= 0)
        r = gsn_board_make(snapshot, &board, &err);
    if (r < 0)
        return gsn_ui_complain(ui, &err, r);
    service = gsn_board_service(snapshot);
    gsn_ui_say(ui, "%s", service ? service : "");
    (void)putchar('\n');
    for (size_t i = 0; i < board->count; i++) {
        const int columns =
            gsn_text_columns(board->at[i].name) + (gsn_board_is_part(&board->at[i]) ? 2 : 0);

        if (gsn_board_is_item(&board->at[i]) && columns > width)
            width = columns;
    }
    for (size_t i = 0; i < board->count; i++)
        print_line(ui, &board->at[i], width, now);
    return EX_OK;
}

/* ------------------------------------------------------------------------------------------ */

int gsn_cmd_top(const struct gsn_ui *ui, int argc, char **argv)
{
    struct watch watch = { .ui = ui };
    gsn_auto(gsn_queue_view) view = NULL;
    gsn_auto(gsn_screen) screen = NULL;
    struct gsn_error err = { 0 };
    int status = EX_OK, news = 0, r;

    if (argc > 1)
        return gsn_ui_usage(ui, "top takes no argument, not \"%s\"; see `gieson show`", argv[1]);
    if (ui->json)
        return gsn_ui_usage(ui, "top is for eyes; `gieson status --json` says the same to scripts");
    watch.store = gsn_ui_store(ui, GSN_STORE_READ, &status);
    if (!watch.store)
        return status;
    if (!ui->out_tty || !isatty(STDIN_FILENO) ||
        gsn_screen_open(ui->colour, &screen, &err) == GSN_E_UNSUPPORTED) {
        status = print_table(ui, watch.store);
        gsn_store_free(watch.store);
        return status;
    }
    r = screen ? gsn_queue_view_new(ui->store_dir, &view, &err) : err.code;
    if (r >= 0)
        r = look_at_store(&watch, view, &news, &err);
    if (r >= 0)
        watch_screen(&watch, view, screen);
    gsn_store_free(watch.store);
    gsn_screen_free(gsn_steal(&screen));
    return r < 0 ? gsn_ui_complain(ui, &err, r) : EX_OK;
}
