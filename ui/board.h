/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A snapshot as the lines of `gieson top`, from top to bottom: what comes in, what needs a person,
 * specimens with those of their panels that are not settled. Specimens that failed come first, then
 * those at work, those that wait, and the others, the latest first. */
#ifndef GSN_UI_BOARD_H
#define GSN_UI_BOARD_H

#include "ui/snapshot.h"

enum gsn_board_kind {
    GSN_BOARD_HEADING, /* name is all it has; it may be empty */
    GSN_BOARD_SOURCE,
    GSN_BOARD_TROUBLE,
    GSN_BOARD_SCAN,
    GSN_BOARD_SPECIMEN,
    GSN_BOARD_PANEL,
    GSN_BOARD_DOUBT,   /* sections of the specimen above whose pose a person is to choose */
    GSN_BOARD_COMMAND, /* the command for the line above, in name */
};

enum { GSN_BOARD_FACTS = 6 };

struct gsn_board_line {
    enum gsn_board_kind kind;
    const char *state; /* a word; NULL for headings and commands */
    /* Owned, and NULL where there is none. */
    char *key;  /* tells it from all others, also on the next board */
    char *name; /* never NULL */
    char *detail;
    char *sentence; /* what a person must know */
    char *action;   /* the next command */
    char *fact[GSN_BOARD_FACTS];
    int64_t since;    /* 0: unknown */
    int64_t specimen; /* its own or its panel's; 0: none */
};

struct gsn_board {
    size_t count;
    struct gsn_board_line *at;
};

/* gives. Fails with GSN_E_NOMEM. */
int gsn_board_make(const struct gsn_snapshot *snapshot, struct gsn_board **ret_board,
                   struct gsn_error *err);
void gsn_board_free(struct gsn_board *board);
GSN_DEFINE_AUTO(gsn_board);

/* Whether it belongs to the specimen above it. */
int gsn_board_is_part(const struct gsn_board_line *line);
/* Headings and commands belong to others and cannot be chosen. */
int gsn_board_is_item(const struct gsn_board_line *line);

/* gives: one line on who serves the store. NULL when memory runs out. */
char *gsn_board_service(const struct gsn_snapshot *snapshot);

#endif
