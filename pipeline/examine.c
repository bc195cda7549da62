/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/examine.h"

#include "pipeline/core/parallel.h"
#include "pipeline/register/panel.h"
#include "pipeline/stain/absorb.h"

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
    static const char *const names[] = { "found", "needs-eye", "missing", "empty" };

    return names[sighting];
}

static void flag(struct gsn_panel_section *section, const char *word)
{
    const size_t used = strlen(section->flags);

    (void)snprintf(section->flags + used, sizeof section->flags - used, "%s%s", used ? " " : "",
                   word);
}

/* The triangle to look for: the protocol's, or what the sections of this panel agree on. */
static int know_triangle(const struct gsn_protocol *protocol,
                         const struct gsn_mark_candidates *candidates, size_t count,
                         struct gsn_triangle_prior *ret_prior, struct gsn_error *err)
{
    struct gsn_triangle_prior prior = { 0 };
    int r;

    if (protocol->has_markers)
        memcpy(prior.mark_um, protocol->markers_um, sizeof prior.mark_um);
    else if ((r = gsn_markers_consensus(candidates, count, &prior, err)) < 0)
        return r;
    r = gsn_markers_learn(candidates, count, &prior, err);
    if (r < 0)
        return r;
    *ret_prior = prior;
    return GSN_OK;
}

static void choose_marks(struct gsn_panel_section *section,
                         const struct gsn_mark_candidates *candidates,
                         const struct gsn_triangle_prior *prior)
{
    double score = 0, runner_up = 0;
    int mirrored = 0, found = 0;

    gsn_markers_choose(candidates, prior, section->mark, &mirrored, &score, &runner_up);
    for (size_t i = 0; i < GSN_MARKS; i++)
        found += section->mark[i].found;
    section->sighting = found == GSN_MARKS ? GSN_SIGHT_FOUND : GSN_SIGHT_NEEDS_EYE;
    if (found == 2)
        flag(section, mirrored ? "two-marks mirrored" : "two-marks");
    else if (found < 2)
        flag(section, score > 0 && runner_up > 0.5 * score ? "ambiguous-marks" : "no-marks");
}

static void shift(struct gsn_point *point, const struct gsn_slot *slot)
{
    point->x += slot->x;
    point->y += slot->y;
}

/* Red density is worked out inside the section's box alone. */
static int find_candidates(const struct gsn_scan *scan, const struct gsn_slot *slot,
                           struct gsn_mark_candidates *ret_candidates, struct gsn_error *err)
{
    const struct gsn_pixel_box box = { slot->x, slot->y, slot->width, slot->height };
    struct gsn_slot inside = *slot;
    struct gsn_plane *od[3] = { NULL };
    gsn_auto(gsn_plane) red = NULL;
    int r = gsn_absorb_box(scan->picture->image, &scan->glass, &box, 1, od, err);

    if (r < 0)
        return r;
    red = od[0];
    inside.x = inside.y = 0;
    inside.centre_px.x -= slot->x;
    inside.centre_px.y -= slot->y;
    r = gsn_markers_candidates(red, &inside, scan->px_um, ret_candidates, err);
    if (r < 0)
        return r;
    shift(&ret_candidates->tissue_px, slot);
    for (size_t i = 0; i < ret_candidates->count; i++)
        shift(&ret_candidates->mark[i].px, slot);
    return GSN_OK;
}

struct search {
    const struct gsn_scan *scan;
    const struct gsn_slot *slots;           /* those with tissue */
    struct gsn_mark_candidates *candidates; /* one for each */
};

static int search_slot(size_t index, void *context, struct gsn_error *err)
{
    const struct search *search = context;
    const struct gsn_slot *slot = &search->slots[index];
    const int r = find_candidates(search->scan, slot, &search->candidates[index], err);

    return r < 0 ? gsn_fail_at(err, "slot %u", slot->slot + 1) : GSN_OK;
}

/* Marks of all sections of the panel: found slots and their numbers in findings. A panel whose
 * sections agree on no triangle is no failure: its sections need a person's eye. */
static int find_marks(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                      const struct gsn_slot *found, size_t count, unsigned threads,
                      struct gsn_panel_findings *findings, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
        gsn_alloc_array(count, sizeof *candidates);
    struct search search = { scan, found, candidates };
    struct gsn_triangle_prior prior;
    int r;

    if (!candidates)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    r = gsn_parallel_for(count, threads, search_slot, &search, err);
    if (r < 0)
        return r;
    r = know_triangle(protocol, candidates, count, &prior, err);
    if (r < 0 && r != GSN_E_MARKERS)
        return r;
    for (size_t i = 0; i < count; i++) {
        struct gsn_panel_section *section = &findings->section[found[i].slot];

        if (r >= 0)
            choose_marks(section, &candidates[i], &prior);
        else
            flag(section, "no-marks");
    }
    return GSN_OK;
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
            flag(section, "touching");
    }
}

static void note_scraps(struct gsn_panel_findings *findings, const struct gsn_scrap *scraps,
                        size_t count)
{
    const size_t used = strlen(findings->note);
    size_t among = 0;

    for (size_t i = 0; i < count; i++)
        among += scraps[i].inside_grid != 0;
    if (among > 0)
        (void)snprintf(findings->note + used, sizeof findings->note - used,
                       "%s%zu piece%s between the slots belong to no section", used ? "; " : "",
                       among, among == 1 ? "" : "s");
}

static int examine(const struct gsn_scan *scan, const struct gsn_protocol *protocol,
                   unsigned number, unsigned threads, const struct gsn_progress *progress,
                   struct gsn_panel_findings *findings, struct gsn_error *err)
{
    const struct gsn_layout layout = gsn_protocol_layout(protocol);
    gsn_auto_mem(struct gsn_slot) slots = gsn_alloc_array(findings->count, sizeof *slots);
    gsn_auto_mem(struct gsn_scrap) scraps = NULL;
    size_t scrap_count = 0, found = 0;
    int r;

    if (!slots)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    gsn_progress_say(progress, "splitting", 0, 1);
    r = gsn_panel_split(scan->total, scan->step, &layout, scan->px_um, slots, &scraps, &scrap_count,
                        err);
    if (r < 0)
        return r;
    take_slots(findings, slots, protocol, number);
    note_scraps(findings, scraps, scrap_count);
    for (size_t i = 0; i < findings->count; i++)
        if (slots[i].found)
            slots[found++] = slots[i];
    gsn_progress_say(progress, "marks", 0, found);
    return find_marks(scan, protocol, slots, found, threads, findings, err);
}

int gsn_panel_examine(const char *decoder, const void *bytes, size_t size,
                      const struct gsn_protocol *protocol, unsigned number, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_panel_findings **ret_findings,
                      struct gsn_error *err)
{
    gsn_auto(gsn_panel_findings) findings = gsn_alloc_array(1, sizeof *findings);
    gsn_auto(gsn_scan) scan = NULL;
    int r;

    if (findings)
        findings->count = (size_t)protocol->rows * protocol->columns;
    if (findings)
        findings->section = gsn_alloc_array(findings->count, sizeof *findings->section);
    if (!findings || !findings->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a panel");
    gsn_progress_say(progress, "decoding", 0, 1);
    r = gsn_scan_survey(decoder, bytes, size, protocol, &scan, err);
    if (r < 0)
        return r;
    findings->width = scan->picture->image->width;
    findings->height = scan->picture->image->height;
    findings->px_um = scan->px_um;
    (void)snprintf(findings->note, sizeof findings->note, "%s%s%s", scan->picture->note,
                   scan->picture->note[0] && scan->note[0] ? "; " : "", scan->note);
    r = examine(scan, protocol, number, threads, progress, findings, err);
    if (r < 0)
        return r;
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
