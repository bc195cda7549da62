/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The first screen of `gieson top`: the list of the board, its pages, and its keys.
 *
 * Steps. A new board keeps what was chosen by its key. Drawing: the head, the list scrolled to what
 * is chosen, advice on it, the foot; columns are given up from the right where the terminal is
 * narrow, and on less than 40 x 10 nothing but a sentence is shown. Pages beside the list: all
 * about one line, and the help. A key moves, opens a page, or is a wish that the caller fulfils. */
#include "ui/queue_view.h"

#include <string.h>

#include "storage/advice.h"
#include "ui/board.h"
#include "ui/screen.h"
#include "ui/text.h"

/* On less than this nothing but a sentence is shown. */
enum { MIN_ROWS = 10, MIN_COLUMNS = 40, GAP = 2 };

static const struct gsn_ink plain = { .hue = GSN_HUE_PLAIN };
static const struct gsn_ink low = { .stress = GSN_STRESS_LOW };
static const struct gsn_ink high = { .stress = GSN_STRESS_HIGH };

/* Pages beside the list. */

static int put_wrapped(struct gsn_screen *screen, int row, int last, struct gsn_ink ink,
                       const char *text)
{
    const int width = gsn_screen_columns(screen);

    while (*text && row <= last) {
        const size_t bytes = gsn_text_fit(text, width);
        gsn_auto_mem(char) line = gsn_format("%.*s", (int)bytes, text);

        gsn_screen_put(screen, row++, 0, width, ink, line ? line : "");
        text += bytes;
        while (*text == ' ')
            text++;
    }
    return row;
}

/* A text in lines from row to last, with the store in its commands; returns the row behind them. */
static int put_advice_page(struct gsn_screen *screen, int row, int last, struct gsn_ink ink,
                           const char *store_dir, const char *text)
{
    gsn_auto_mem(char) advice = gsn_advice(store_dir, text);

    return put_wrapped(screen, row, last, ink, advice ? advice : text);
}

static void put_back(struct gsn_screen *screen)
{
    gsn_screen_put(screen, gsn_screen_rows(screen) - 1, 0, gsn_screen_columns(screen), low,
                   "any key: back  q quit");
}

/* All about one line of the board of that store; now: unix time that its age is counted from. */
static void put_details(const struct gsn_board_line *line, const char *store_dir, int64_t now,
                        struct gsn_screen *screen)
{
    const struct gsn_look *look = gsn_look_of(line->state);
    const int last = gsn_screen_rows(screen) - 2;
    gsn_auto_mem(char) age = gsn_look_age(now, line->since);
    gsn_auto_mem(char) state = gsn_format("%s %s%s%s", look->symbol, line->state,
                                          age && age[0] ? ", " : "", age ? age : "");
    int row = put_wrapped(screen, 0, last, high, line->name);

    row = put_wrapped(screen, row, last, (struct gsn_ink){ .hue = look->hue }, state ? state : "");
    if (line->sentence)
        row = put_advice_page(screen, row + 1, last, plain, store_dir, line->sentence);
    row++;
    for (size_t i = 0; i < GSN_BOARD_FACTS && line->fact[i]; i++)
        row = put_advice_page(screen, row, last, plain, store_dir, line->fact[i]);
    if (line->action) {
        row = put_wrapped(screen, row + 1, last, low, "next");
        (void)put_advice_page(screen, row, last, high, store_dir, line->action);
    }
    put_back(screen);
}

/* Keys and symbols. */
/* Side by side where there is room; where there is none, the keys come first: symbols stand beside
 * their words anyway. */
static void put_help(struct gsn_screen *screen)
{
    static const char *const keys[] = {
        "arrows, j, k   choose a line",
        "PgUp PgDn      a screen further",
        "Home End       first, last",
        "Enter          all about it",
        "r              let its failed jobs wait",
        "R              let all failed jobs wait",
        "q              quit",
    };
    static const char *const symbols[] = {
        ". waiting",
        "> working, receiving",
        "+ reported, ready",
        "! withheld, held, trouble",
        "? unfiled: say whose it is",
        "x failed, refused",
        "- away    = paused",
    };
    enum { ROWS = sizeof keys / sizeof keys[0] };
    const int width = gsn_screen_columns(screen), last = gsn_screen_rows(screen) - 2;
    const int beside = width >= 2 * MIN_COLUMNS;

    gsn_screen_put(screen, 0, 0, width, high, "gieson top");
    for (int i = 0; i < ROWS; i++) {
        const int row = beside ? 2 + i : 2 + ROWS + i;

        if (1 + i + beside <= last)
            gsn_screen_put(screen, 1 + i + beside, 0, MIN_COLUMNS, plain, keys[i]);
        if (row <= last)
            gsn_screen_put(screen, row, beside ? MIN_COLUMNS + GAP : 0, MIN_COLUMNS, plain,
                           symbols[i]);
    }
    if (3 + ROWS + 2 <= last)
        gsn_screen_put(screen, beside ? 3 + ROWS : 3 + 2 * ROWS, 0, width, low,
                       "Only r and R change anything.");
    put_back(screen);
}

/* Says how much room is needed. */
static void put_too_small(struct gsn_screen *screen)
{
    gsn_auto_mem(char) sentence = gsn_format(
        "gieson top needs %d columns and %d lines; here are %d and %d. q quits.", (int)MIN_COLUMNS,
        (int)MIN_ROWS, gsn_screen_columns(screen), gsn_screen_rows(screen));

    (void)put_wrapped(screen, 0, gsn_screen_rows(screen) - 1, plain, sentence ? sentence : "");
}

enum {
    MOST_ABOUT_SERVICE = 3, /* lines, where rows are many */
    AIRY_ROWS = 16,         /* from here on there is room for blank lines */
    COUNTS_BESIDE = 80,     /* columns: the queue's numbers stand behind the store's name */
};

enum page { PAGE_LIST, PAGE_DETAILS, PAGE_HELP };

struct gsn_queue_view {
    const char *store_dir;
    struct gsn_board *board; /* NULL before the first state */
    char *service, *counts;
    int served;              /* both parts of the service are there */
    char *trouble, *message; /* NULL: none */
    int64_t now;
    char *chosen;  /* its key; NULL: nothing can be chosen */
    size_t at;     /* its line */
    size_t top;    /* the first line that is shown */
    int list_rows; /* as last drawn; a page */
    enum page page;
};
static const struct gsn_ink care = { .hue = GSN_HUE_CARE, .stress = GSN_STRESS_HIGH };

int gsn_queue_view_new(const char *store_dir, struct gsn_queue_view **ret_view,
                       struct gsn_error *err)
{
    struct gsn_queue_view *view = gsn_alloc_array(1, sizeof *view);

    if (!view)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a screen");
    view->store_dir = store_dir;
    view->list_rows = 1;
    *ret_view = view;
    return GSN_OK;
}

void gsn_queue_view_free(struct gsn_queue_view *view)
{
    if (!view)
        return;
    gsn_board_free(view->board);
    gsn_free(view->service);
    gsn_free(view->counts);
    gsn_free(view->trouble);
    gsn_free(view->message);
    gsn_free(view->chosen);
    gsn_free(view);
}

/* ---- what is chosen ---------------------------------------------------------------------- */

static void set_text(char **field, const char *text)
{
    gsn_free(*field);
    *field = text ? gsn_strdup(text) : NULL;
}

static const struct gsn_board_line *chosen_line(const struct gsn_queue_view *view)
{
    return view->chosen ? &view->board->at[view->at] : NULL;
}

static void choose_line(struct gsn_queue_view *view, size_t at)
{
    view->at = at;
    set_text(&view->chosen, view->board->at[at].key);
}

/* The item nearest to a line: it, or the next, or the one before. */
static void choose_near(struct gsn_queue_view *view, size_t near)
{
    const struct gsn_board *board = view->board;

    for (size_t i = near; i < board->count; i++)
        if (gsn_board_is_item(&board->at[i])) {
            choose_line(view, i);
            return;
        }
    for (size_t i = near < board->count ? near : board->count; i-- > 0;)
        if (gsn_board_is_item(&board->at[i])) {
            choose_line(view, i);
            return;
        }
    set_text(&view->chosen, NULL);
}

static void choose_again(struct gsn_queue_view *view)
{
    for (size_t i = 0; view->chosen && i < view->board->count; i++)
        if (view->board->at[i].key && strcmp(view->board->at[i].key, view->chosen) == 0) {
            view->at = i;
            return;
        }
    if (view->page == PAGE_DETAILS)
        view->page = PAGE_LIST;
    choose_near(view, view->at);
}

/* So many items on (or back, where negative). */
static void move_choice(struct gsn_queue_view *view, long by)
{
    const struct gsn_board *board = view->board;
    size_t at = view->at;

    for (size_t i = at; by > 0 && ++i < board->count;)
        if (gsn_board_is_item(&board->at[i])) {
            at = i;
            by--;
        }
    for (size_t i = at; by < 0 && i-- > 0;)
        if (gsn_board_is_item(&board->at[i])) {
            at = i;
            by++;
        }
    if (view->chosen)
        choose_line(view, at);
}

int64_t gsn_queue_view_specimen(const struct gsn_queue_view *view)
{
    const struct gsn_board_line *line = chosen_line(view);

    return line ? line->specimen : 0;
}

/* ---- what is known ----------------------------------------------------------------------- */

int gsn_queue_view_set(struct gsn_queue_view *view, const struct gsn_snapshot *snapshot,
                       int64_t now, struct gsn_error *err)
{
    const struct gsn_job_counts *jobs = &snapshot->jobs;
    gsn_auto(gsn_board) board = NULL;
    gsn_auto_mem(char) service = gsn_board_service(snapshot);
    gsn_auto_mem(char) counts =
        gsn_format("%lld waiting  %lld working  %lld done  %lld failed", (long long)jobs->waiting,
                   (long long)jobs->running, (long long)jobs->done, (long long)jobs->failed);
    const int r = gsn_board_make(snapshot, &board, err);

    if (r < 0)
        return r;
    if (!service || !counts)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a screen");
    gsn_board_free(view->board);
    view->board = gsn_steal(&board);
    gsn_free(view->service);
    view->service = gsn_steal(&service);
    gsn_free(view->counts);
    view->counts = gsn_steal(&counts);
    view->served = snapshot->intake && snapshot->queue;
    view->now = now;
    set_text(&view->trouble, NULL);
    choose_again(view);
    return GSN_OK;
}

void gsn_queue_view_set_trouble(struct gsn_queue_view *view, const char *sentence)
{
    set_text(&view->trouble, sentence);
}

void gsn_queue_view_say(struct gsn_queue_view *view, const char *sentence)
{
    set_text(&view->message, sentence);
}

/* ---- the list ---------------------------------------------------------------------------- */

/* Where columns begin, and how wide they are; 0: left out. */
struct columns {
    int name, state_at, detail_at, detail, age_at, next_at;
};

enum { SYMBOL = 2, STATE = 9, AGE = 6, NEXT = 6, NAME_MIN = 10, PANEL_INDENT = 2 };

static struct columns columns_of(const struct gsn_queue_view *view, int width)
{
    const int with_next = width >= 60, with_age = width >= 50;
    const int right = (with_next ? GAP + NEXT : 0) + (with_age ? GAP + AGE : 0);
    struct columns c = { .name = NAME_MIN };

    for (size_t i = 0; i < view->board->count; i++) {
        const struct gsn_board_line *line = &view->board->at[i];
        const int indent = gsn_board_is_part(line) ? PANEL_INDENT : 0;
        const int wanted = gsn_board_is_item(line) ? indent + gsn_text_columns(line->name) : 0;

        c.name = wanted > c.name ? wanted : c.name;
    }
    c.name = c.name > width / 4 && width / 4 > NAME_MIN ? width / 4 : c.name;
    c.name = c.name > width / 4 ? NAME_MIN : c.name;
    c.state_at = SYMBOL + c.name + GAP;
    c.detail_at = c.state_at + STATE + GAP;
    c.detail = width - right - c.detail_at;
    c.age_at = with_age ? c.detail_at + c.detail + GAP : 0;
    c.next_at = with_next ? width - NEXT : 0;
    return c;
}

/* The verb of a command of ours: what the key or the reader does next. */
static void put_next(struct gsn_screen *screen, int row, int column, struct gsn_ink ink,
                     const char *action)
{
    static const char ours[] = "gieson ";
    gsn_auto_mem(char) verb = NULL;

    if (!action || strncmp(action, ours, strlen(ours)) != 0)
        return;
    action += strlen(ours);
    verb = gsn_format("%.*s", (int)strcspn(action, " "), action);
    if (verb)
        gsn_screen_put(screen, row, column, NEXT, ink, verb);
}

static void put_item(const struct gsn_queue_view *view, struct gsn_screen *screen, int row,
                     const struct columns *c, const struct gsn_board_line *line)
{
    const struct gsn_look *look = gsn_look_of(line->state);
    const int is_chosen = line == chosen_line(view);
    const int indent = gsn_board_is_part(line) ? PANEL_INDENT : 0;
    const struct gsn_ink ink = { .hue = look->hue, .chosen = is_chosen };
    const struct gsn_ink calm = { .stress = GSN_STRESS_LOW, .chosen = is_chosen };
    const struct gsn_ink name = { .stress = indent ? GSN_STRESS_NONE : GSN_STRESS_HIGH,
                                  .chosen = is_chosen };
    gsn_auto_mem(char) age = gsn_look_age(view->now, line->since);

    if (is_chosen)
        gsn_screen_put(screen, row, 0, gsn_screen_columns(screen), ink, "");
    gsn_screen_put(screen, row, indent, SYMBOL, ink, look->symbol);
    gsn_screen_put(screen, row, SYMBOL + indent, c->name - indent, name, line->name);
    gsn_screen_put(screen, row, c->state_at, STATE, ink, line->state);
    gsn_screen_put(screen, row, c->detail_at, c->detail, (struct gsn_ink){ .chosen = is_chosen },
                   line->detail ? line->detail : "");
    if (c->age_at)
        gsn_screen_put(screen, row, c->age_at, AGE, calm, age ? age : "");
    if (c->next_at)
        put_next(screen, row, c->next_at, calm, line->action);
}

/* A sentence or a command, with the store in what it advises. */
static void put_told(const struct gsn_queue_view *view, struct gsn_screen *screen, int row,
                     int column, struct gsn_ink ink, const char *text)
{
    gsn_auto_mem(char) advice = gsn_advice(view->store_dir, text);

    gsn_screen_put(screen, row, column, gsn_screen_columns(screen) - column, ink,
                   advice ? advice : text);
}

static void put_line(const struct gsn_queue_view *view, struct gsn_screen *screen, int row,
                     const struct columns *c, const struct gsn_board_line *line)
{
    if (line->kind == GSN_BOARD_HEADING)
        put_told(view, screen, row, 0, low, line->name);
    else if (line->kind == GSN_BOARD_COMMAND)
        put_told(view, screen, row, SYMBOL + GAP, plain, line->name);
    else
        put_item(view, screen, row, c, line);
}

/* What is chosen is seen, with the heading above it and the command below. */
static void scroll_to_chosen(struct gsn_queue_view *view, size_t rows)
{
    const struct gsn_board *board = view->board;
    size_t first = view->at, last = view->at;

    while (first > 0 && board->at[first - 1].kind == GSN_BOARD_HEADING)
        first--;
    if (last + 1 < board->count && board->at[last + 1].kind == GSN_BOARD_COMMAND)
        last++;
    if (last - first >= rows)
        first = view->at;
    if (first < view->top)
        view->top = first;
    if (last >= view->top + rows)
        view->top = last - rows + 1;
    if (view->top + rows > board->count)
        view->top = board->count > rows ? board->count - rows : 0;
}

static void put_list(struct gsn_queue_view *view, struct gsn_screen *screen, int from, int rows)
{
    const struct columns c = columns_of(view, gsn_screen_columns(screen));

    scroll_to_chosen(view, (size_t)rows);
    view->list_rows = rows;
    for (int i = 0; i < rows && view->top + (size_t)i < view->board->count; i++)
        put_line(view, screen, from + i, &c, &view->board->at[view->top + (size_t)i]);
}

/* ---- around the list --------------------------------------------------------------------- */

/* Returns the rows used. */
static int put_head(const struct gsn_queue_view *view, struct gsn_screen *screen)
{
    const int width = gsn_screen_columns(screen);
    const int beside = width >= COUNTS_BESIDE ? gsn_text_columns(view->counts) : 0;
    const struct gsn_ink ink = view->trouble || !view->served ? care : low;
    const char *said = view->trouble ? view->trouble : view->service;
    int row = 0;

    gsn_screen_put(screen, row, 0, 6, high, "gieson");
    gsn_screen_put(screen, row, 8, width - 8 - (beside ? beside + GAP : 0), plain, view->store_dir);
    if (beside)
        gsn_screen_put(screen, row, width - beside, beside, plain, view->counts);
    else
        gsn_screen_put(screen, ++row, 0, width, plain, view->counts);
    row++;
    if (gsn_screen_rows(screen) >= AIRY_ROWS)
        return put_advice_page(screen, row, row + MOST_ABOUT_SERVICE - 1, ink, view->store_dir,
                               said);
    put_told(view, screen, row, 0, ink, said);
    return row + 1;
}

static size_t items_to(const struct gsn_queue_view *view, size_t end)
{
    size_t items = 0;

    for (size_t i = 0; i < end; i++)
        items += gsn_board_is_item(&view->board->at[i]) != 0;
    return items;
}

/* What to do about the chosen line, in full. */
static void put_advice(const struct gsn_queue_view *view, struct gsn_screen *screen, int row)
{
    const struct gsn_board_line *line = chosen_line(view);

    if (view->message)
        put_told(view, screen, row, 0, high, view->message);
    else if (line && line->action) {
        gsn_screen_put(screen, row, 0, 6, low, "next");
        put_told(view, screen, row, 6, plain, line->action);
    } else if (line && line->sentence)
        put_told(view, screen, row, 0, plain, line->sentence);
}

static void put_foot(const struct gsn_queue_view *view, struct gsn_screen *screen)
{
    static const char keys[] = "? help  Enter details  r retry  q quit";
    const int row = gsn_screen_rows(screen) - 1, width = gsn_screen_columns(screen);
    gsn_auto_mem(char) place =
        gsn_format("%zu of %zu", items_to(view, view->at) + 1, items_to(view, view->board->count));
    const int beside = place ? gsn_text_columns(place) : 0;

    put_advice(view, screen, row - 1);
    gsn_screen_put(screen, row, 0, width, low, keys);
    if (view->chosen && place && width >= (int)sizeof keys + GAP + beside)
        gsn_screen_put(screen, row, width - beside, beside, low, place);
}

void gsn_queue_view_draw(struct gsn_queue_view *view, struct gsn_screen *screen)
{
    const int rows = gsn_screen_rows(screen), airy = rows >= AIRY_ROWS;

    gsn_screen_wipe(screen);
    if (rows < MIN_ROWS || gsn_screen_columns(screen) < MIN_COLUMNS)
        put_too_small(screen);
    else if (view->page == PAGE_HELP)
        put_help(screen);
    else if (view->page == PAGE_DETAILS && view->chosen)
        put_details(chosen_line(view), view->store_dir, view->now, screen);
    else {
        const int from = put_head(view, screen) + airy;

        put_list(view, screen, from, rows - from - airy - 2);
        put_foot(view, screen);
    }
    gsn_screen_show(screen);
}

/* ---- keys -------------------------------------------------------------------------------- */

static enum gsn_queue_wish wish_retry(struct gsn_queue_view *view)
{
    const struct gsn_board_line *line = chosen_line(view);

    if (line && line->specimen && strcmp(line->state, "failed") == 0)
        return GSN_QUEUE_WISH_RETRY;
    gsn_queue_view_say(view, "nothing failed here; R lets all failed jobs wait again");
    return GSN_QUEUE_WISH_NONE;
}

enum gsn_queue_wish gsn_queue_view_key(struct gsn_queue_view *view, int key)
{
    const long page = view->list_rows > 1 ? view->list_rows - 1 : 1;

    set_text(&view->message, NULL);
    if (key == 'q' || key == 'Q')
        return GSN_QUEUE_WISH_QUIT;
    if (view->page != PAGE_LIST) {
        view->page = PAGE_LIST;
        return GSN_QUEUE_WISH_NONE;
    }
    switch (key) {
    case GSN_KEY_UP:
    case 'k':
        move_choice(view, -1);
        break;
    case GSN_KEY_DOWN:
    case 'j':
        move_choice(view, 1);
        break;
    case GSN_KEY_PAGE_UP:
        move_choice(view, -page);
        break;
    case GSN_KEY_PAGE_DOWN:
        move_choice(view, page);
        break;
    case GSN_KEY_HOME:
        choose_near(view, 0);
        break;
    case GSN_KEY_END:
        choose_near(view, view->board->count);
        break;
    case GSN_KEY_ENTER:
        view->page = view->chosen ? PAGE_DETAILS : PAGE_LIST;
        break;
    case '?':
    case 'h':
        view->page = PAGE_HELP;
        break;
    case 'r':
        return wish_retry(view);
    case 'R':
        return GSN_QUEUE_WISH_RETRY_ALL;
    default:
        break;
    }
    return GSN_QUEUE_WISH_NONE;
}
