/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/examine_parts.h"
#include "pipeline/register/panel/slots.h"

#include <math.h>
#include <string.h>

int gsn_answers_say(const struct gsn_panel_answers *answers, enum gsn_panel_said said)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].said == said)
            return 1;
    return 0;
}

unsigned gsn_answers_first(const struct gsn_panel_answers *answers, size_t slots)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].said == GSN_SAID_FIRST && answers->at[i].to < slots)
            return answers->at[i].to;
    return GSN_SLOT_UNSAID;
}

/* Both sections of a neck, whichever of them was named. */
static void decide_cut(struct gsn_slot *slots, struct gsn_slot *slot, int cut)
{
    struct gsn_slot *other = &slots[slot->touched];

    if (!slot->touching && !slot->parted)
        return;
    slot->parted = cut;
    slot->touching = !cut;
    if (other->touched == slot->slot && (other->touching || other->parted)) {
        other->parted = cut;
        other->touching = !cut;
    }
}

/* A section moves to the slot that is its own, if that is free. */
static void decide_seat(struct gsn_slot *slots, struct gsn_slot *slot, unsigned to)
{
    struct gsn_slot moved = *slot;

    if (!slot->doubtful || (to != slot->slot && slots[to].found))
        return;
    moved.doubtful = 0;
    moved.rival = 0;
    moved.slot = to;
    moved.row = slots[to].row;
    moved.column = slots[to].column;
    *slot = (struct gsn_slot){ .slot = slot->slot, .row = slot->row, .column = slot->column };
    slots[to] = moved;
}

static int lies_in(const struct gsn_scrap *scrap, struct gsn_point at)
{
    return at.x >= scrap->x && at.x < scrap->x + scrap->width && at.y >= scrap->y &&
           at.y < scrap->y + scrap->height;
}

static void seat_scrap(struct gsn_slot *slots, const struct gsn_scrap *scrap, unsigned to)
{
    struct gsn_slot *slot = &slots[to];

    if (slot->found)
        return;
    slot->found = 1;
    slot->x = scrap->x;
    slot->y = scrap->y;
    slot->width = scrap->width;
    slot->height = scrap->height;
    slot->area_px = scrap->area_px;
    slot->centre_px =
        (struct gsn_point){ scrap->x + 0.5 * scrap->width, scrap->y + 0.5 * scrap->height };
}

const struct gsn_panel_answer *gsn_answers_scrap(const struct gsn_panel_answers *answers,
                                                 size_t slots, const struct gsn_scrap *scrap)
{
    for (size_t i = 0; answers && i < answers->count; i++)
        if (answers->at[i].slot >= slots && lies_in(scrap, answers->at[i].at_px) &&
            (answers->at[i].said == GSN_SAID_DISMISS ||
             (answers->at[i].said == GSN_SAID_SEAT && answers->at[i].to < slots)))
            return &answers->at[i];
    return NULL;
}

void gsn_answers_apply(const struct gsn_panel_answers *answers, struct gsn_slot *slots,
                       size_t count, const struct gsn_scrap *scraps, size_t scrap_count)
{
    for (size_t i = 0; answers && i < answers->count; i++) {
        const struct gsn_panel_answer *answer = &answers->at[i];

        if (answer->slot >= count)
            continue;
        if (answer->said == GSN_SAID_CUT || answer->said == GSN_SAID_HOLD)
            decide_cut(slots, &slots[answer->slot], answer->said == GSN_SAID_CUT);
        if (answer->said == GSN_SAID_SEAT && answer->to < count)
            decide_seat(slots, &slots[answer->slot], answer->to);
    }
    for (size_t i = 0; i < scrap_count; i++) {
        const struct gsn_panel_answer *answer = gsn_answers_scrap(answers, count, &scraps[i]);

        if (answer && answer->said == GSN_SAID_SEAT && scraps[i].inside_grid)
            seat_scrap(slots, &scraps[i], answer->to);
    }
}
