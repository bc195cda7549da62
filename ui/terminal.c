/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/terminal.h"

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
