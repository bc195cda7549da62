/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/pages.h"

#include "storage/advice.h"
#include "ui/look.h"
#include "ui/text.h"

enum { GAP = 2 };

static const struct gsn_ink plain = { .hue = GSN_HUE_PLAIN };
static const struct gsn_ink low = { .stress = GSN_STRESS_LOW };
static const struct gsn_ink high = { .stress = GSN_STRESS_HIGH };

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

int gsn_page_advice(struct gsn_screen *screen, int row, int last, struct gsn_ink ink,
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

void gsn_page_details(const struct gsn_board_line *line, const char *store_dir, int64_t now,
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
        row = gsn_page_advice(screen, row + 1, last, plain, store_dir, line->sentence);
    row++;
    for (size_t i = 0; i < GSN_BOARD_FACTS && line->fact[i]; i++)
        row = gsn_page_advice(screen, row, last, plain, store_dir, line->fact[i]);
    if (line->action) {
        row = put_wrapped(screen, row + 1, last, low, "next");
        (void)gsn_page_advice(screen, row, last, high, store_dir, line->action);
    }
    put_back(screen);
}

/* Side by side where there is room; where there is none, the keys come first: symbols stand beside
 * their words anyway. */
void gsn_page_help(struct gsn_screen *screen)
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
    const int beside = width >= 2 * GSN_PAGE_LEAST_COLUMNS;

    gsn_screen_put(screen, 0, 0, width, high, "gieson top");
    for (int i = 0; i < ROWS; i++) {
        const int row = beside ? 2 + i : 2 + ROWS + i;

        if (1 + i + beside <= last)
            gsn_screen_put(screen, 1 + i + beside, 0, GSN_PAGE_LEAST_COLUMNS, plain, keys[i]);
        if (row <= last)
            gsn_screen_put(screen, row, beside ? GSN_PAGE_LEAST_COLUMNS + GAP : 0,
                           GSN_PAGE_LEAST_COLUMNS, plain, symbols[i]);
    }
    if (3 + ROWS + 2 <= last)
        gsn_screen_put(screen, beside ? 3 + ROWS : 3 + 2 * ROWS, 0, width, low,
                       "Only r and R change anything.");
    put_back(screen);
}

void gsn_page_too_small(struct gsn_screen *screen)
{
    gsn_auto_mem(char) sentence =
        gsn_format("gieson top needs %d columns and %d lines; here are %d and %d. q quits.",
                   (int)GSN_PAGE_LEAST_COLUMNS, (int)GSN_PAGE_LEAST_ROWS,
                   gsn_screen_columns(screen), gsn_screen_rows(screen));

    (void)put_wrapped(screen, 0, gsn_screen_rows(screen) - 1, plain, sentence ? sentence : "");
}
