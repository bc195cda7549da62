/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/examine_parts.h"

#include "pipeline/register/panel/slots.h"
#include "pipeline/upright.h"

#include <stdarg.h>
#include <stdio.h>
#include <string.h>

struct gsn_layout gsn_protocol_layout(const struct gsn_protocol *protocol)
{
    static const enum gsn_order orders[] = { [GSN_STATED_ROW] = GSN_ORDER_ROW,
                                             [GSN_STATED_COLUMN] = GSN_ORDER_COLUMN,
                                             [GSN_STATED_SNAKE] = GSN_ORDER_SNAKE };

    return (struct gsn_layout){ .rows = protocol->rows,
                                .columns = protocol->columns,
                                .order = orders[protocol->order] };
}

const char *gsn_sighting_name(enum gsn_sighting sighting)
{
    static const char *const names[] = { "found", "needs-eye", "missing", "empty", "held" };

    return names[sighting];
}

void gsn_section_flag(struct gsn_panel_section *section, const char *word)
{
    const size_t used = strlen(section->flags);

    (void)snprintf(section->flags + used, sizeof section->flags - used, "%s%s", used ? " " : "",
                   word);
}

void gsn_findings_say(struct gsn_panel_findings *findings, const char *format, ...)
{
    const size_t used = strlen(findings->note);
    const char *glue = used ? "; " : "";
    char text[200];
    va_list args;

    va_start(args, format);
    (void)vsnprintf(text, sizeof text, format, args);
    va_end(args);
    /* What does not fit is left out whole. */
    if (used + strlen(glue) + strlen(text) < sizeof findings->note)
        (void)snprintf(findings->note + used, sizeof findings->note - used, "%s%s", glue, text);
}

static void take_slots(struct gsn_panel_findings *findings, const struct gsn_slot *slots,
                       const struct gsn_protocol *protocol, unsigned number)
{
    const struct gsn_layout layout = gsn_protocol_layout(protocol);

    for (size_t i = 0; i < findings->count; i++) {
        const unsigned serial = gsn_panel_serial(number, slots[i].slot, &layout);
        const unsigned expected = gsn_protocol_sections(protocol);
        struct gsn_panel_section *section = &findings->section[i];

        *section = (struct gsn_panel_section){ .serial = serial,
                                               .slot = slots[i].slot,
                                               .sighting = GSN_SIGHT_NEEDS_EYE,
                                               .x = slots[i].x,
                                               .y = slots[i].y,
                                               .width = slots[i].width,
                                               .height = slots[i].height,
                                               .area_px = slots[i].area_px };
        if (!slots[i].found)
            section->sighting =
                expected && serial >= expected ? GSN_SIGHT_EMPTY : GSN_SIGHT_MISSING;
        else if (slots[i].touching)
            section->sighting = GSN_SIGHT_HELD;
        if (slots[i].touching)
            gsn_section_flag(section, "touching");
        if (slots[i].parted)
            gsn_section_flag(section, "parted");
        if (slots[i].found && slots[i].doubtful)
            section->sighting = GSN_SIGHT_HELD;
        if (slots[i].doubtful)
            gsn_section_flag(section, "between-slots");
        if (slots[i].lost > 0)
            gsn_section_flag(section, "over-edge");
    }
}

static void note_slots(struct gsn_panel_findings *findings, const struct gsn_slot *slots)
{
    size_t found = 0;

    for (size_t i = 0; i < findings->count; i++) {
        const struct gsn_slot *s = &slots[i];

        found += s->found != 0;
        /* Each pair once, by the first that names it. */
        if (s->touching && (s->touched > s->slot || slots[s->touched].touched != s->slot))
            gsn_findings_say(
                findings,
                "the sections in slots %u and %u have grown together and are held: cut along the "
                "line from (%.0f, %.0f) to (%.0f, %.0f) px, or mount them again",
                s->slot + 1, s->touched + 1, s->cut_px[0].x, s->cut_px[0].y, s->cut_px[1].x,
                s->cut_px[1].y);
        if (s->parted && s->touched > s->slot)
            gsn_findings_say(
                findings,
                "the sections in slots %u and %u touch and were cut apart along the line from "
                "(%.0f, %.0f) to (%.0f, %.0f) px",
                s->slot + 1, s->touched + 1, s->cut_px[0].x, s->cut_px[0].y, s->cut_px[1].x,
                s->cut_px[1].y);
        if (s->found && s->doubtful)
            gsn_findings_say(findings,
                             "the section in slot %u lies between slots %u and %u and is held: say "
                             "which is its own",
                             s->slot + 1, s->slot + 1, s->rival + 1);
        if (s->lost > 0)
            gsn_findings_say(
                findings,
                "the section in slot %u runs over the edge: %.0f %% of its tissue is lost",
                s->slot + 1, 100 * s->lost);
    }
    if (found == 0)
        gsn_findings_say(findings, "no tissue on this panel");
}

/* Pieces among the slots that no section claims: rows of their own, for a person to look at. What
 * lies outside the grid is a label. */
static int take_scraps(struct gsn_panel_findings *findings, const struct gsn_scrap *scraps,
                       size_t count, const struct gsn_panel_answers *answers, struct gsn_error *err)
{
    size_t held = 0;

    struct gsn_panel_section *longer =
        gsn_realloc_array(findings->section, findings->count + count, sizeof *longer);
    const size_t slots = findings->count;

    if (!longer)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the pieces of a panel");
    findings->section = longer;
    for (size_t i = 0; i < count; i++) {
        struct gsn_panel_section *section = &findings->section[findings->count];

        if (!scraps[i].inside_grid)
            continue;
        *section = (struct gsn_panel_section){ .serial = GSN_NO_SERIAL,
                                               .slot = (unsigned)findings->count,
                                               .sighting = GSN_SIGHT_HELD,
                                               .x = scraps[i].x,
                                               .y = scraps[i].y,
                                               .width = scraps[i].width,
                                               .height = scraps[i].height,
                                               .area_px = scraps[i].area_px };
        gsn_section_flag(section, "scrap");
        if (gsn_answers_scrap(answers, slots, &scraps[i])) {
            section->sighting = GSN_SIGHT_EMPTY;
            gsn_section_flag(section, "decided");
        }
        held += section->sighting == GSN_SIGHT_HELD;
        findings->count++;
    }
    if (held > 0)
        gsn_findings_say(findings, "%zu piece%s between the slots belong%s to no section: held",
                         held, held == 1 ? "" : "s", held == 1 ? "s" : "");
    return GSN_OK;
}

/* "GVP-D-S01-P03" is panel 3 of "GVP-D-S01". */
static int read_label(struct gsn_panel_findings *findings, const char *text)
{
    const char *dash = strrchr(text, '-');
    unsigned number = 0;

    if (!dash || dash == text || (dash[1] != 'P' && dash[1] != 'p') || !dash[2])
        return 0;
    for (const char *c = dash + 2; *c; c++) {
        if (*c < '0' || *c > '9' || number > 10000)
            return 0;
        number = 10 * number + (unsigned)(*c - '0');
    }
    findings->label_number = number;
    (void)snprintf(findings->label, sizeof findings->label, "%s", text);
    (void)snprintf(findings->label_subject, sizeof findings->label_subject, "%.*s",
                   (int)(dash - text), text);
    return number > 0;
}

/* A label that cannot be read is shown where it is; what it is printed on lies beside the slots. */
static void note_label(const struct gsn_picture *picture, const struct gsn_scrap *scraps,
                       size_t count, struct gsn_panel_findings *findings)
{
    int x0 = INT_MAX, y0 = INT_MAX, x1 = 0, y1 = 0;

    if (findings->label_number > 0)
        return;
    for (unsigned i = 0; i < picture->code_count; i++)
        if (read_label(findings, picture->code[i].text))
            return;
    for (size_t i = 0; i < count; i++) {
        const struct gsn_scrap *s = &scraps[i];

        if (s->inside_grid)
            continue;
        x0 = s->x < x0 ? s->x : x0;
        y0 = s->y < y0 ? s->y : y0;
        x1 = s->x + s->width > x1 ? s->x + s->width : x1;
        y1 = s->y + s->height > y1 ? s->y + s->height : y1;
    }
    if (picture->code_count > 0)
        gsn_findings_say(findings, "its label says \"%s\", which names no panel",
                         picture->code[0].text);
    else if (x1 > 0)
        gsn_findings_say(
            findings,
            "no code could be read on its label: compare what is written from (%d, %d) to (%d, %d) "
            "px",
            x0, y0, x1, y1);
}

static int examine(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                   unsigned number, const struct gsn_panel_answers *answers, unsigned threads,
                   const struct gsn_progress *progress, struct gsn_panel_findings *findings,
                   struct gsn_error *err)
{
    const struct gsn_layout layout = gsn_protocol_layout(protocol);
    gsn_auto_mem(struct gsn_slot) slots = gsn_alloc_array(findings->count, sizeof *slots);
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t scrap_count = 0, found = 0;
    struct gsn_error wrong = { 0 };
    int r;

    if (!slots)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    gsn_progress_say(progress, "splitting", 0, 1);
    r = gsn_panel_split(scan->total, scan->step, &layout, scan->px_um,
                        gsn_answers_first(answers, findings->count), slots, &scraps, &scrap_count,
                        err);
    if (r < 0)
        return r;
    gsn_answers_apply(answers, slots, findings->count, scraps, scrap_count);
    take_slots(findings, slots, protocol, number);
    note_slots(findings, slots);
    for (size_t i = 0; i < findings->count; i++)
        if (slots[i].found && !slots[i].doubtful)
            slots[found++] = slots[i];
    note_label(scan->picture, scraps, scrap_count, findings);
    r = take_scraps(findings, scraps, scrap_count, answers, err);
    if (r < 0)
        return r;
    gsn_progress_say(progress, "marks", 0, found);
    r = gsn_examine_marks(scan, protocol, slots, found, answers, threads, findings, err);
    /* Pixels too large for marks may only be said to be. */
    if (r == GSN_E_INPUT && gsn_examine_pixels(scan, protocol, slots, found, threads, findings,
                                               &wrong) == GSN_E_WITHHELD)
        return gsn_fail(err, GSN_E_WITHHELD, "%s", wrong.text);
    return r < 0 ? r : gsn_examine_pixels(scan, protocol, slots, found, threads, findings, err);
}

static int examine_as(struct gsn_decoder *decoder, int picture_fd,
                      const struct gsn_protocol *protocol, const struct gsn_upright *upright,
                      unsigned number, const struct gsn_panel_answers *answers, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_panel_findings *findings,
                      struct gsn_error *err)
{
    gsn_auto(gsn_scan) scan = NULL;
    int r;

    gsn_progress_say(progress, "decoding", 0, 1);
    r = gsn_scan_survey(decoder, picture_fd, protocol, upright, &scan, err);
    if (r < 0)
        return r;
    findings->width = scan->picture->image->width;
    findings->height = scan->picture->image->height;
    findings->px_um = scan->px_um;
    findings->upright = scan->upright;
    (void)snprintf(findings->note, sizeof findings->note, "%s%s%s", scan->picture->note,
                   scan->picture->note[0] && scan->note[0] ? "; " : "", scan->note);
    return examine(scan, protocol, number, answers, threads, progress, findings, err);
}

static int findings_new(const struct gsn_protocol *protocol,
                        struct gsn_panel_findings **ret_findings, struct gsn_error *err)
{
    gsn_auto(gsn_panel_findings) findings = gsn_alloc_array(1, sizeof *findings);

    if (findings)
        findings->count = (size_t)protocol->rows * protocol->columns;
    if (findings)
        findings->section = gsn_alloc_array(findings->count, sizeof *findings->section);
    if (!findings || !findings->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a panel");
    *ret_findings = gsn_steal(&findings);
    return GSN_OK;
}

int gsn_panel_examine(struct gsn_decoder *decoder, int picture_fd,
                      const struct gsn_protocol *protocol, unsigned number,
                      const struct gsn_panel_answers *answers, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_panel_findings **ret_findings,
                      struct gsn_error *err)
{
    gsn_auto(gsn_panel_findings) findings = NULL;
    gsn_auto(gsn_panel_findings) first = NULL;
    struct gsn_error why = { 0 };
    struct gsn_upright as_marked = { .note = "set as its marks say, as was decided" };
    int r = findings_new(protocol, &findings, err);

    if (r < 0)
        return r;
    r = examine_as(decoder, picture_fd, protocol, NULL, number, answers, threads, progress,
                   findings, &why);
    if (r == GSN_E_WITHHELD && (findings->against.mirrored || findings->against.quarters) &&
        gsn_answers_say(answers, GSN_SAID_AS_MARKED)) {
        first = gsn_steal(&findings);
        as_marked.turn = gsn_upright_compose(first->upright.turn, first->against);
        r = findings_new(protocol, &findings, err);
        if (r < 0)
            return r;
        findings->label_number = first->label_number;
        memcpy(findings->label, first->label, sizeof findings->label);
        memcpy(findings->label_subject, first->label_subject, sizeof findings->label_subject);
        r = examine_as(decoder, picture_fd, protocol, &as_marked, number, answers, threads,
                       progress, findings, &why);
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    *ret_findings = gsn_steal(&findings);
    return GSN_OK;
}

void gsn_panel_findings_free(struct gsn_panel_findings *findings)
{
    if (!findings)
        return;
    gsn_free(findings->section);
    gsn_free(findings);
}
