/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A terminal as rows of columns, by ncurses.
 *
 * Opening asks terminfo whether the terminal can place text at all, takes colours where it has
 * them, and gives the terminal back when it is freed. What the reader's locale cannot show becomes
 * "?" (text.h). A signal that ends the program, and a terminal that is gone, come as keys, so that
 * the loop ends in one place.
 *
 * How it fails: GSN_E_UNSUPPORTED for a terminal without cursor addressing. */
#include "ui/screen.h"

#include <langinfo.h>
#include <locale.h>
#include <ncurses.h>
#include <poll.h>
#include <signal.h>
#include <string.h>
#include <sys/signalfd.h>
#include <unistd.h>

#include "ui/text.h"

enum {
    ESCAPE_MS = 25,  /* an escape that nothing follows within this is the key */
    MOST_EMPTY = 16, /* reads in a row that find nothing where something was announced: hung up */
};

struct gsn_screen {
    SCREEN *terminal;
    int colour, utf8;
    int ends;  /* descriptor that tells of signals that end us */
    int empty; /* see MOST_EMPTY */
    sigset_t before;
};

/* What the user's locale says; ours stays UTF-8, as the store's texts are. */
static int shows_utf8(void)
{
    int utf8;

    (void)setlocale(LC_CTYPE, "");
    utf8 = strcmp(nl_langinfo(CODESET), "UTF-8") == 0;
    (void)setlocale(LC_CTYPE, "C.UTF-8");
    return utf8;
}

static int use_colours(int colour)
{
    static const short colours[] = { COLOR_WHITE, COLOR_CYAN, COLOR_GREEN, COLOR_YELLOW,
                                     COLOR_RED };

    if (!colour || !has_colors() || start_color() == ERR || use_default_colors() == ERR)
        return 0;
    for (short hue = GSN_HUE_BUSY; hue <= GSN_HUE_BAD; hue++)
        if (init_pair(hue, colours[hue], -1) == ERR)
            return 0;
    return 1;
}

/* Signals that end us are read like keys, so that the terminal is given back on one way only. */
static int block_ends(struct gsn_screen *screen)
{
    sigset_t ends;

    (void)sigemptyset(&ends);
    (void)sigaddset(&ends, SIGINT);
    (void)sigaddset(&ends, SIGTERM);
    (void)sigaddset(&ends, SIGHUP);
    (void)sigprocmask(SIG_BLOCK, &ends, &screen->before);
    return signalfd(-1, &ends, SFD_CLOEXEC | SFD_NONBLOCK);
}

int gsn_screen_open(int colour, struct gsn_screen **ret_screen, struct gsn_error *err)
{
    gsn_auto(gsn_screen) screen = gsn_alloc_array(1, sizeof *screen);

    if (!screen)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a screen");
    screen->utf8 = shows_utf8();
    screen->ends = block_ends(screen);
    if (gsn_terminal_places_text())
        screen->terminal = newterm(NULL, stdout, stdin);
    if (!screen->terminal)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "this terminal cannot place text");
    (void)cbreak();
    (void)noecho();
    (void)nonl();
    (void)curs_set(0);
    (void)keypad(stdscr, TRUE);
    (void)nodelay(stdscr, TRUE);
    (void)set_escdelay(ESCAPE_MS);
    screen->colour = use_colours(colour);
    *ret_screen = gsn_steal(&screen);
    return GSN_OK;
}

void gsn_screen_free(struct gsn_screen *screen)
{
    if (!screen)
        return;
    if (screen->terminal) {
        (void)endwin();
        delscreen(screen->terminal);
    }
    if (screen->ends >= 0)
        (void)close(screen->ends);
    (void)sigprocmask(SIG_SETMASK, &screen->before, NULL);
    gsn_free(screen);
}

int gsn_screen_rows(const struct gsn_screen *screen)
{
    (void)screen;
    return getmaxy(stdscr);
}

int gsn_screen_columns(const struct gsn_screen *screen)
{
    (void)screen;
    return getmaxx(stdscr);
}

void gsn_screen_wipe(struct gsn_screen *screen)
{
    (void)screen;
    (void)erase();
}

static attr_t attributes_of(struct gsn_ink ink)
{
    if (ink.chosen)
        return A_REVERSE;
    return ink.stress == GSN_STRESS_HIGH ? A_BOLD : ink.stress == GSN_STRESS_LOW ? A_DIM : A_NORMAL;
}

void gsn_screen_put(struct gsn_screen *screen, int row, int column, int columns, struct gsn_ink ink,
                    const char *text)
{
    const int room = getmaxx(stdscr) - column;
    gsn_auto_mem(char) cell = NULL;

    columns = columns < room ? columns : room;
    if (row < 0 || row >= getmaxy(stdscr) || column < 0 || columns <= 0)
        return;
    cell = gsn_text_cell(text, columns);
    if (!cell)
        return;
    if (!screen->utf8)
        gsn_text_ascii(cell);
    (void)attr_set(attributes_of(ink), screen->colour && !ink.chosen ? (short)ink.hue : 0, NULL);
    (void)mvaddstr(row, column, cell);
    (void)attr_set(A_NORMAL, 0, NULL);
}

void gsn_screen_show(struct gsn_screen *screen)
{
    (void)screen;
    (void)refresh();
}

static int key_of(int code)
{
    switch (code) {
    case KEY_RESIZE:
        return GSN_KEY_RESIZED;
    case KEY_UP:
        return GSN_KEY_UP;
    case KEY_DOWN:
        return GSN_KEY_DOWN;
    case KEY_PPAGE:
        return GSN_KEY_PAGE_UP;
    case KEY_NPAGE:
        return GSN_KEY_PAGE_DOWN;
    case KEY_HOME:
        return GSN_KEY_HOME;
    case KEY_END:
        return GSN_KEY_END;
    case KEY_ENTER:
    case '\r':
    case '\n':
        return GSN_KEY_ENTER;
    case 27:
        return GSN_KEY_ESCAPE;
    default:
        return code < 256 ? code : GSN_KEY_OTHER;
    }
}

/* Taken out, so that it does not end us a second time when signals are let through again. */
static void take_signal(int fd)
{
    struct signalfd_siginfo taken;

    (void)!read(fd, &taken, sizeof taken);
}

int gsn_screen_key(struct gsn_screen *screen, int wait_ms)
{
    struct pollfd from[] = { { .fd = STDIN_FILENO, .events = POLLIN },
                             { .fd = screen->ends, .events = POLLIN } };
    int code = getch();

    if (code == ERR) {
        const int ready = poll(from, 2, wait_ms);

        if (ready > 0 && from[1].revents)
            take_signal(screen->ends);
        if (ready > 0 && (from[1].revents || from[0].revents & (POLLHUP | POLLERR | POLLNVAL)))
            return GSN_KEY_CLOSED;
        code = getch();
        screen->empty = code == ERR && ready > 0 ? screen->empty + 1 : 0;
    }
    if (screen->empty > MOST_EMPTY)
        return GSN_KEY_CLOSED;
    return code == ERR ? GSN_KEY_NONE : key_of(code);
}
