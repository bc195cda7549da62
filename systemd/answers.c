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

unsigned gsn_answers_pose(const char *answer)
{
    unsigned long number;
    char *end;

    if (strncmp(answer, "pose ", 5) != 0)
        return 0;
    number = strtoul(answer + 5, &end, 10);
    return strncmp(end, " of ", 4) == 0 && number >= 1 && number <= 100 ? (unsigned)number : 0;
}

/* "812.3", as it is written: one digit behind the point. */
static const char *take_tenths(const char *at, double *ret)
{
    char *end;
    unsigned long whole;

    if (*at < '0' || *at > '9')
        return NULL;
    whole = strtoul(at, &end, 10);
    if (end[0] != '.' || end[1] < '0' || end[1] > '9' || whole > 10000000)
        return NULL;
    *ret = (double)whole + (end[1] - '0') / 10.0;
    return end + 2;
}

/* " X,Y" or " -". */
static const char *take_mark(const char *at, struct gsn_point *ret_px, int *ret_found)
{
    if (!at || *at++ != ' ')
        return NULL;
    *ret_found = *at != '-';
    if (!*ret_found)
        return at + 1;
    at = take_tenths(at, &ret_px->x);
    return at && *at == ',' ? take_tenths(at + 1, &ret_px->y) : NULL;
}

/* "pose 2 of <sha256> up 812.3,933.1 400.0,533.2 -" */
static int read_pose(const char *text, const char *sha256, struct gsn_panel_answer *answer)
{
    enum { DIGITS = 64 };
    const char *at = gsn_answers_pose(text) ? strstr(text, " of ") + 4 : NULL;

    if (!at || strspn(at, "0123456789abcdef") != DIGITS)
        return 0;
    answer->elsewhere = strncmp(at, sha256, DIGITS) != 0;
    at += DIGITS;
    answer->choice.mirrored = strncmp(at, " down", 5) == 0;
    if (!answer->choice.mirrored && strncmp(at, " up", 3) != 0)
        return 0;
    at += answer->choice.mirrored ? 5 : 3;
    for (int i = 0; i < GSN_MARKS; i++)
        at = take_mark(at, &answer->choice.px[i], &answer->choice.found[i]);
    return at && !*at;
}

static int read_answer(const struct gsn_decision_row *row, const char *sha256,
                       struct gsn_panel_answer *ret)
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
    else if (row->slot > 0 && read_pose(row->answer, sha256, &answer))
        answer.said = GSN_SAID_POSE;
    else if (row->slot == 0 && first != UINT_MAX)
        answer.said = GSN_SAID_FIRST;
    else if (row->slot == 0 && strcmp(row->answer, "as-set") == 0)
        answer.said = GSN_SAID_AS_SET;
    else if (row->slot == 0 && strcmp(row->answer, "as-marked") == 0)
        answer.said = GSN_SAID_AS_MARKED;
    else
        return 0;
    answer.to = answer.said == GSN_SAID_FIRST ? first : seat != UINT_MAX ? seat : 0;
    *ret = answer;
    return 1;
}

int gsn_answers_read(const struct gsn_decision_rows *rows, int64_t number, const char *sha256,
                     struct gsn_panel_answer **ret_answers, size_t *ret_count,
                     struct gsn_error *err)
{
    struct gsn_panel_answer *answers = gsn_alloc_array(rows->count, sizeof *answers);
    size_t count = 0;

    if (!answers)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for what was decided");
    for (size_t i = 0; i < rows->count; i++)
        if (rows->at[i].number == number)
            count += (size_t)read_answer(&rows->at[i], sha256, &answers[count]);
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
