/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/answers.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* "slot 5" is 4; UINT_MAX when the text is no such thing. */
static unsigned number_behind(const char *text, const char *word)
{
    const size_t length = strlen(word);
    char *end;
    unsigned long number;

    if (strncmp(text, word, length) != 0 || text[length] != ' ')
        return UINT_MAX;
    number = strtoul(text + length + 1, &end, 10);
    return *end || number < 1 || number > 100000 ? UINT_MAX : (unsigned)number - 1;
}

static int read_answer(const struct gsn_decision_row *row, struct gsn_panel_answer *ret)
{
    const unsigned seat = number_behind(row->answer, "slot");
    const unsigned first = number_behind(row->answer, "first");
    struct gsn_panel_answer answer = { .slot = (unsigned)(row->slot > 0 ? row->slot - 1 : 0),
                                       .at_px = { row->x_px, row->y_px } };

    if (row->slot > 0 && strcmp(row->answer, "cut") == 0)
        answer.said = GSN_SAID_CUT;
    else if (row->slot > 0 && strcmp(row->answer, "hold") == 0)
        answer.said = GSN_SAID_HOLD;
    else if (row->slot > 0 && strcmp(row->answer, "dismiss") == 0)
        answer.said = GSN_SAID_DISMISS;
    else if (row->slot > 0 && seat != UINT_MAX)
        answer.said = GSN_SAID_SEAT;
    else if (row->slot == 0 && first != UINT_MAX)
        answer.said = GSN_SAID_FIRST;
    else
        return 0;
    answer.to = answer.said == GSN_SAID_FIRST ? first : seat != UINT_MAX ? seat : 0;
    *ret = answer;
    return 1;
}

int gsn_answers_read(const struct gsn_decision_rows *rows, int64_t number,
                     struct gsn_panel_answer **ret_answers, size_t *ret_count,
                     struct gsn_error *err)
{
    struct gsn_panel_answer *answers = gsn_alloc_array(rows->count, sizeof *answers);
    size_t count = 0;

    if (!answers)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for what was decided");
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].number == number)
            count += (size_t)read_answer(&rows->at[i], &answers[count]);
    *ret_answers = answers;
    *ret_count = count;
    return GSN_OK;
}

const char *gsn_answers_chosen(const struct gsn_decision_rows *rows, int64_t number)
{
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].number == number && rows->at[i].slot == 0 &&
            strncmp(rows->at[i].answer, "use ", 4) == 0)
            return rows->at[i].answer + 4;
    return NULL;
}
