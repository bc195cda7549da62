/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A board while its lines are made; for the files of ui/board.h alone. */
#ifndef GSN_UI_BOARD_PARTS_H
#define GSN_UI_BOARD_PARTS_H

#include "ui/board.h"

/* Lines are added and filled; whoever runs out of memory says so once, at the end. */
struct gsn_board_maker {
    struct gsn_board *board;
    size_t room;
    int no_memory;
};

/* board.c */

/* borrows: the new line until the next is added; NULL when memory ran out. */
struct gsn_board_line *gsn_board_add(struct gsn_board_maker *maker, enum gsn_board_kind kind,
                                     const char *state);
/* Both take text, which is NULL when memory ran out. */
void gsn_board_set(struct gsn_board_maker *maker, char **field, char *text);
void gsn_board_fact(struct gsn_board_maker *maker, struct gsn_board_line *line, char *text);
/* After a blank line, unless it is the first. */
void gsn_board_heading(struct gsn_board_maker *maker, const char *name);

/* board_specimens.c: specimens, each with its panels and doubts. */
void gsn_board_add_specimens(struct gsn_board_maker *maker, const struct gsn_snapshot *snapshot);

#endif
