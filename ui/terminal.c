/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What terminfo says of the terminal. Apart from screen.c, and with our header first, because
 * <term.h> takes the names "columns" and "lines" for itself. */
#include "ui/screen.h"

#include <ncurses.h>
#include <term.h>
#include <unistd.h>

int gsn_terminal_places_text(void)
{
    int error, places;

    if (setupterm(NULL, STDOUT_FILENO, &error) == ERR)
        return 0;
    places = cursor_address != NULL;
    (void)del_curterm(cur_term);
    return places;
}
