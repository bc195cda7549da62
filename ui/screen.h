/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A terminal as rows of columns, by ncurses, and its keyboard. Texts are any bytes, as in
 * ui/text.h. The terminal is given back as it was when the screen is freed. */
#ifndef GSN_UI_SCREEN_H
#define GSN_UI_SCREEN_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "ui/text.h"

struct gsn_screen;

/* colour 0: none, whatever the terminal can. gives. Fails with GSN_E_UNSUPPORTED when the terminal
 * (or what TERM says of it) cannot place text. */
int gsn_screen_open(int colour, struct gsn_screen **ret_screen, struct gsn_error *err);

void gsn_screen_free(struct gsn_screen *screen);

GSN_DEFINE_AUTO(gsn_screen);

int gsn_screen_rows(const struct gsn_screen *screen);

int gsn_screen_columns(const struct gsn_screen *screen);

enum gsn_stress { GSN_STRESS_NONE, GSN_STRESS_LOW, GSN_STRESS_HIGH };

struct gsn_ink {
    enum gsn_hue hue;
    enum gsn_stress stress;
    int chosen; /* as the line that is chosen */
};

/* Nothing is seen before gsn_screen_show(). */
void gsn_screen_wipe(struct gsn_screen *screen);

/* Puts the text into exactly so many columns, cut or filled; what lies outside is left out. */
void gsn_screen_put(struct gsn_screen *screen, int row, int column, int columns, struct gsn_ink ink,
                    const char *text);

void gsn_screen_show(struct gsn_screen *screen);

enum gsn_key {
    GSN_KEY_NONE = -1,   /* nothing came in time */
    GSN_KEY_CLOSED = -2, /* the terminal is gone, or we are asked to end */
    GSN_KEY_RESIZED = -3,
    GSN_KEY_UP = 256, /* other keys are their characters */
    GSN_KEY_DOWN,
    GSN_KEY_PAGE_UP,
    GSN_KEY_PAGE_DOWN,
    GSN_KEY_HOME,
    GSN_KEY_END,
    GSN_KEY_ENTER,
    GSN_KEY_ESCAPE,
    GSN_KEY_OTHER,
};

/* Waits at most so long for a key. */
int gsn_screen_key(struct gsn_screen *screen, int wait_ms);

/* Whether the terminal that TERM names can place text; 0 also when nobody knows it. */
int gsn_terminal_places_text(void);

#endif
