/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/show.h"

#include "storage/advice.h"

#include "ui/snapshot.h"
#include "ui/text.h"

#include <string.h>

char *gsn_show_decide_command(const struct gsn_show *view, int64_t number, int64_t slot,
                              const char *answer)
{
    gsn_auto_mem(char) name = gsn_advice_word(view->specimen->name);

    if (!name)
        return NULL;
    return slot ? gsn_format("gieson decide %s %lld.%lld %s", name, (long long)number,
                             (long long)slot, answer)
                : gsn_format("gieson decide %s %lld %s", name, (long long)number, answer);
}

static int is_claimed_twice(const struct gsn_show *view, const struct gsn_panel_row *panel)
{
    for (size_t i = 0; i < view->panels->count; i++)
        if (view->panels->at[i].id != panel->id && view->panels->at[i].number == panel->number &&
            strcmp(view->panels->at[i].state, "held") == 0)
            return 1;
    return 0;
}

/* gives: the answer that a held panel waits for, or NULL. */
static char *panel_question(const struct gsn_show *view, const struct gsn_panel_row *panel)
{
    gsn_auto_mem(char) file = NULL;
    gsn_auto_mem(char) use = NULL;

    if (strcmp(panel->state, "held") != 0 || panel->number == 0 ||
        gsn_show_decision_on(view, panel->number, 0))
        return NULL;
    /* Where its sections lie is what is asked. */
    if (panel->width == 0 && strstr(panel->message, "slots in two ways"))
        return gsn_show_decide_command(view, panel->number, 0, "first N");
    if (strstr(panel->message, "decide as-marked"))
        return gsn_show_decide_command(view, panel->number, 0, "as-marked");
    if (!is_claimed_twice(view, panel))
        return NULL;
    file = gsn_advice_word(panel->file_name);
    use = file ? gsn_format("use %s", file) : NULL;
    return use ? gsn_show_decide_command(view, panel->number, 0, use) : NULL;
}

char *gsn_show_panel_action(const struct gsn_show *view, const struct gsn_panel_row *panel)
{
    char *question = panel_question(view, panel);

    if (question)
        return question;
    for (size_t i = 0; strcmp(panel->state, "held") == 0 && i < view->open->count; i++)
        if (view->open->at[i].id == panel->id && view->open->at[i].scan)
            return gsn_snapshot_file_command(view->open->at[i].scan, view->specimen->name);
    return NULL;
}

/* Whether a person is still to choose its pose: nobody did, or the choice could not be used. */
static int asks_pose(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const struct gsn_candidate_row *c = NULL;
    const size_t count = gsn_show_candidates(view, s, &c);

    for (size_t i = 0; i < count; i++)
        if (c[i].chosen)
            return 0;
    return count > 0 &&
           (!gsn_show_decision_on(view, gsn_show_panel_number(view, s->panel_id), s->slot) ||
            gsn_show_has_flag(s, "decision-void") || gsn_show_has_flag(s, "decided"));
}

char *gsn_show_section_action(const struct gsn_show *view, const struct gsn_section_row *s)
{
    const int64_t number = gsn_show_panel_number(view, s->panel_id);

    if (asks_pose(view, s))
        return gsn_show_decide_command(view, number, s->slot, "pose N");
    if (strcmp(s->state, "held") != 0 || gsn_show_decision_on(view, number, s->slot))
        return NULL;
    if (gsn_show_has_flag(s, "touching"))
        return gsn_show_decide_command(view, number, s->slot, "cut");
    return gsn_show_has_flag(s, "scrap") || gsn_show_has_flag(s, "between-slots")
               ? gsn_show_decide_command(view, number, s->slot, "slot N")
               : NULL;
}
