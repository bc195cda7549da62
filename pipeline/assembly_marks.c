/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/slot_marks.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/panel/slots.h"

#include <string.h>

/* The sections of one panel, where marks are looked for. */
struct search {
    struct gsn_slot_search in;
    struct gsn_slot *slots;                 /* those with tissue */
    struct gsn_mark_candidates *candidates; /* one for each */
    size_t *section;                        /* its place in the assembly */
};

static int is_wanted(const struct gsn_assembly_section *s, unsigned panel)
{
    return s->panel == panel && s->place.known &&
           !(s->seen.mark[0].found && s->seen.mark[1].found && s->seen.mark[2].found);
}

static int any_wanted(const struct gsn_assembly *a, unsigned panel)
{
    for (size_t i = 0; i < a->section_count; i++)
        if (is_wanted(&a->section[i], panel))
            return 1;
    return 0;
}

static void list_sections(const struct gsn_assembly *a, unsigned panel, struct search *search)
{
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_panel_section *seen = &a->section[i].seen;

        if (a->section[i].panel != panel || seen->width <= 0 || seen->height <= 0)
            continue;
        search->slots[search->in.count] =
            (struct gsn_slot){ .slot = seen->slot,
                               .found = 1,
                               .x = seen->x,
                               .y = seen->y,
                               .width = seen->width,
                               .height = seen->height,
                               .centre_px = { seen->x + 0.5 * seen->width,
                                              seen->y + 0.5 * seen->height } };
        search->section[search->in.count++] = i;
    }
}

/* Looks once more, now for spots like the panel's other marks. */
static int name_marks(const struct search *search, size_t index,
                      const struct gsn_pose_summary *summary,
                      const struct gsn_triangle_prior *learnt, struct gsn_assembly_section *s,
                      struct gsn_error *err)
{
    struct gsn_triangle_prior prior = *learnt;
    struct gsn_mark_candidates candidates;
    const struct gsn_slot_search *in = &search->in;
    const int r = gsn_slot_marks(in->scan, in->absorber, &in->layout, in->side,
                                 &search->slots[index], 0, learnt, &candidates, err);

    if (r < 0)
        return r;
    gsn_axes_at(&summary->axes, s->seen.serial, summary->mean_triangle, prior.mark_um);
    gsn_markers_place(&candidates, &prior, &s->place.panel_to_block_um, s->place.error_um,
                      s->seen.mark);
    return GSN_OK;
}

static int look(struct search *search, unsigned panel, struct gsn_assembly *a,
                struct gsn_error *err)
{
    const size_t count = search->in.count;
    gsn_auto_mem(double) scratch = gsn_alloc_array(count, sizeof *scratch);
    struct gsn_triangle_prior prior = { 0 };
    int r;

    if (!scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    search->in.slots = search->slots;
    search->in.side = gsn_slot_typical_side(search->slots, count, scratch);
    memcpy(prior.mark_um, a->summary.mean_triangle, sizeof prior.mark_um);
    r = gsn_slots_marks(&search->in, prior.mark_um, search->candidates, err);
    if (r >= 0)
        r = gsn_markers_learn(search->candidates, count, &prior, err);
    for (size_t i = 0; r >= 0 && prior.learnt && i < count; i++) {
        struct gsn_assembly_section *s = &a->section[search->section[i]];

        if (is_wanted(s, panel))
            r = name_marks(search, i, &a->summary, &prior, s, err);
    }
    return r;
}

int gsn_assembly_seek_marks(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                            unsigned panel, struct gsn_assembly *a, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_slot) slots = NULL;
    gsn_auto_mem(struct gsn_mark_candidates) candidates = NULL;
    gsn_auto_mem(size_t) section = NULL;
    gsn_auto(gsn_od_reader) absorber = NULL;
    struct search search = { .in = { .scan = scan,
                                     .layout = gsn_protocol_layout(specimen->protocol),
                                     .threads = options->threads } };
    int r;

    if (a->by_tissue.done || !any_wanted(a, panel))
        return GSN_OK;
    slots = gsn_alloc_array(a->section_count, sizeof *slots);
    candidates = gsn_alloc_array(a->section_count, sizeof *candidates);
    section = gsn_alloc_array(a->section_count, sizeof *section);
    if (!slots || !candidates || !section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    r = gsn_od_reader_new(scan->picture->image, &scan->glass, &absorber, err);
    if (r < 0)
        return r;
    search.in.absorber = absorber;
    search.slots = slots;
    search.candidates = candidates;
    search.section = section;
    list_sections(a, panel, &search);
    return look(&search, panel, a, err);
}
