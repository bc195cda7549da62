/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What terminfo says of the terminal. (Apart from the screen, because <term.h> takes the names
 * "columns" and "lines" for itself.) */
#ifndef GSN_UI_TERMINAL_H
#define GSN_UI_TERMINAL_H

/* Whether the terminal that TERM names can place text; 0 also when nobody knows it. */
int gsn_terminal_places_text(void);

#endif
