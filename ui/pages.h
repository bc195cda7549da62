/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pages of `gieson top` beside its list. */
#ifndef GSN_UI_PAGES_H
#define GSN_UI_PAGES_H

#include "ui/board.h"
#include "ui/screen.h"

#ifdef __cplusplus
extern "C" {
#endif

/* On less than this nothing but a sentence is shown. */
enum { GSN_PAGE_LEAST_ROWS = 10, GSN_PAGE_LEAST_COLUMNS = 40 };

/* All about one line of the board of that store; now: unix time that its age is counted from. */
void gsn_page_details(const struct gsn_board_line *line, const char *store_dir, int64_t now,
                      struct gsn_screen *screen);
/* A text in lines from row to last, with the store in its commands; returns the row behind them. */
int gsn_page_advice(struct gsn_screen *screen, int row, int last, struct gsn_ink ink,
                    const char *store_dir, const char *text);
/* Keys and symbols. */
void gsn_page_help(struct gsn_screen *screen);
/* Says how much room is needed. */
void gsn_page_too_small(struct gsn_screen *screen);

#ifdef __cplusplus
}
#endif
#endif
