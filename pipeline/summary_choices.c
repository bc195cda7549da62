/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include <stdio.h>
#include <string.h>
#include <time.h>

static struct gsn_report_candidate candidate_of(const struct gsn_candidate *c,
                                                const struct gsn_account_picture *picture)
{
    struct gsn_report_candidate row = { .flipped = c->flipped,
                                        .rotated180 = c->rotated180,
                                        .share = c->share,
                                        .laid = c->laid,
                                        .panel_to_block_um = c->panel_to_block_um,
                                        .predicted_tre_um = c->error_um,
                                        .differs = c->differs,
                                        .picture = { .bytes = picture->png,
                                                     .size = picture->size,
                                                     .width = picture->width,
                                                     .height = picture->height } };

    for (size_t m = 0; m < GSN_MARKS; m++) {
        row.marker_found[m] = c->mark[m].found;
        row.marker_px[m] = c->mark[m].px;
    }
    return row;
}

/* A name that a shell takes as it is, or in quotes. */
static const char *command_of(const struct gsn_evidence *e, const struct gsn_assembly_section *s,
                              struct gsn_draft *d)
{
    static const char plain[] = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-";
    const char *name = e->specimen->protocol->specimen;
    const char *quote = name[strspn(name, plain)] ? "'" : "";

    return gsn_draft_say(d, "gieson decide %s%s%s %u.%u pose", quote, name, quote, s->panel,
                         s->seen.slot + 1);
}

static void fill_candidates(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_assembly *a = e->assembly;
    size_t open = 0;

    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];
        struct gsn_report_section *row = &d->section[i];

        if (s->candidates.count == 0)
            continue;
        for (size_t c = 0; c < s->candidates.count; c++)
            d->candidate[i][c] = candidate_of(&s->candidates.at[c], &s->candidate_picture[c]);
        row->candidates = d->candidate[i];
        row->candidate_count = s->candidates.count;
        row->chosen = s->candidates.chosen;
        row->compared_with = s->compared_with;
        row->command = command_of(e, s, d);
        open += !s->candidates.chosen;
    }
    if (open)
        gsn_draft_warn(d, gsn_draft_say(d,
                                        "%zu section%s to choose from: look at them and say which, "
                                        "with `gieson decide`",
                                        open, open == 1 ? " has poses" : "s have poses"));
}

static const char *time_of(struct gsn_draft *d, int64_t seconds)
{
    const time_t then = (time_t)seconds;
    struct tm utc;

    if (!gmtime_r(&then, &utc))
        return "";
    return gsn_draft_say(d, "%04d-%02d-%02d %02d:%02d UTC", utc.tm_year + 1900, utc.tm_mon + 1,
                         utc.tm_mday, utc.tm_hour, utc.tm_min);
}

static const struct gsn_assembly_section *section_at(const struct gsn_assembly *a, unsigned panel,
                                                     unsigned slot)
{
    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].panel == panel && a->section[i].seen.slot + 1 == slot)
            return &a->section[i];
    return NULL;
}

/* What became of a pose that was chosen. */
static const char *effect_of(const struct gsn_assembly *a, const struct gsn_specimen_decision *from)
{
    const struct gsn_assembly_section *s = section_at(a, from->panel, from->slot);

    if (!s || strstr(s->flags, "no-panel"))
        return "not used: its panel is not there";
    if (!s->candidates.chosen && strstr(s->flags, "decided"))
        return "not used: those marks do not fit the stack; choose again";
    if (!s->candidates.chosen)
        return "not used: nothing that is found there has those marks; choose again";
    if (s->state == GSN_SECTION_HELD)
        return "not used: the section is held for another reason";
    return s->pose.gross ? "used, though those marks do not fit the stack" : "used";
}

static void fill_decisions(const struct gsn_evidence *e, struct gsn_draft *d)
{
    for (size_t i = 0; i < e->specimen->decision_count; i++) {
        const struct gsn_specimen_decision *from = &e->specimen->decision[i];
        struct gsn_report_decision *row = &d->decision[i];

        *row = (struct gsn_report_decision){ .panel = from->panel,
                                             .slot = from->slot,
                                             .answer = from->answer,
                                             .actor = from->actor,
                                             .reason = from->reason,
                                             .time = time_of(d, from->time),
                                             .effect = "" };
        if (!from->is_pose)
            continue;
        row->effect = effect_of(e->assembly, from);
        if (strncmp(row->effect, "used", 4) != 0)
            gsn_draft_warn(
                d, gsn_draft_say(d, "panel %u, slot %u: the pose that %s chose on %s is %s",
                                 from->panel, from->slot, from->actor, row->time, row->effect));
    }
    d->report.decisions = d->decision;
    d->report.decision_count = e->specimen->decision_count;
}

void gsn_draft_choices(const struct gsn_evidence *e, struct gsn_draft *d)
{
    fill_candidates(e, d);
    fill_decisions(e, d);
}
