/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly.h"

#include "pipeline/assembly_parts.h"
#include "pipeline/assembly_tissue.h"
#include "pipeline/conditions.h"
#include "pipeline/register/panel/slots.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *gsn_assembly_state_name(enum gsn_assembly_state state)
{
    static const char *const names[] = { "used", "doubtful", "held", "missing", "empty" };

    return names[state];
}

void gsn_assembly_flag(struct gsn_assembly_section *section, const char *word)
{
    const size_t used = strlen(section->flags);

    (void)snprintf(section->flags + used, sizeof section->flags - used, "%s%s", used ? " " : "",
                   word);
}

static int by_serial(const void *a, const void *b)
{
    const struct gsn_assembly_section *s = a, *t = b;

    if (s->seen.serial != t->seen.serial)
        return s->seen.serial < t->seen.serial ? -1 : 1;
    return s->panel < t->panel ? -1 : s->panel > t->panel;
}

static struct gsn_assembly_section section_of(const struct gsn_panel_section *seen, unsigned panel)
{
    static const enum gsn_assembly_state states[] = {
        [GSN_SIGHT_FOUND] = GSN_SECTION_HELD,      [GSN_SIGHT_NEEDS_EYE] = GSN_SECTION_HELD,
        [GSN_SIGHT_MISSING] = GSN_SECTION_MISSING, [GSN_SIGHT_EMPTY] = GSN_SECTION_EMPTY,
        [GSN_SIGHT_HELD] = GSN_SECTION_HELD,
    };
    struct gsn_assembly_section section = { .panel = panel,
                                            .seen = *seen,
                                            .state = states[seen->sighting],
                                            .candidates = seen->candidates };

    /* How the panel alone lays them is no place in the block. */
    for (size_t i = 0; i < section.candidates.count; i++)
        section.candidates.at[i].laid = 0;
    if (seen->flags[0])
        gsn_assembly_flag(&section, seen->flags);
    return section;
}

const struct gsn_specimen_panel *gsn_assembly_panel(const struct gsn_specimen *specimen,
                                                    unsigned number)
{
    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number == number && specimen->panel[i].section_count > 0)
            return &specimen->panel[i];
    return NULL;
}

/* Every slot of every panel that the job expects or that came; each has a number, and pieces
 * between the slots are the panel's alone. */
static int list_slots(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                      struct gsn_error *err)
{
    const struct gsn_layout layout = gsn_protocol_layout(specimen->protocol);
    const unsigned slots = layout.rows * layout.columns;
    const unsigned expected = gsn_protocol_sections(specimen->protocol);
    unsigned panels = specimen->protocol->panels;

    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].section_count > 0 && specimen->panel[i].number > panels)
            panels = specimen->panel[i].number;
    a->section = gsn_alloc_array((size_t)panels * slots, sizeof *a->section);
    if (!a->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections of a specimen");
    for (unsigned number = 1; number <= panels; number++) {
        const struct gsn_specimen_panel *panel = gsn_assembly_panel(specimen, number);

        for (unsigned slot = 0; slot < slots; slot++) {
            const unsigned serial = gsn_panel_serial(number, slot, &layout);
            const struct gsn_panel_section none = { .serial = serial,
                                                    .slot = slot,
                                                    .sighting = expected && serial >= expected
                                                                    ? GSN_SIGHT_EMPTY
                                                                    : GSN_SIGHT_MISSING };
            struct gsn_assembly_section *section = &a->section[a->section_count++];

            if (panel && slot < panel->section_count) {
                *section = section_of(&panel->section[slot], number);
            } else {
                *section = section_of(&none, number);
                gsn_assembly_flag(section, "no-panel");
            }
        }
    }
    qsort(a->section, a->section_count, sizeof *a->section, by_serial);
    return GSN_OK;
}

int gsn_assembly_make(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options,
                      struct gsn_assembly **ret_assembly, struct gsn_error *err)
{
    gsn_auto(gsn_assembly) a = gsn_alloc_array(1, sizeof *a);
    const double px_um = gsn_assembly_voxel(specimen);
    const int band = specimen->protocol->region.kind == GSN_REGION_BAND;
    struct gsn_lattice lattice = { 0 };
    unsigned sections;
    int r;

    if (!a)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the assembly of a specimen");
    r = list_slots(specimen, a, err);
    sections = a->section_count ? a->section[a->section_count - 1].seen.serial + 1 : 0;
    if (r >= 0 && px_um > 0 && !band &&
        (specimen->region || specimen->protocol->region.kind > GSN_REGION_MASK))
        r = gsn_assembly_place_region(specimen, px_um, sections, a, &lattice, err);
    if (r >= 0)
        r = gsn_assembly_solve(specimen, a, err);
    if (r >= 0)
        r = gsn_assembly_lay_by_tissue(specimen, options, a, err);
    if (r >= 0 && a->solved && band)
        r = gsn_assembly_place_block(specimen, px_um, sections, a, &lattice, err);
    if (r >= 0 && a->solved && (a->region || band))
        r = gsn_assembly_empty_grid(&lattice, &a->grid, err);
    if (r >= 0)
        r = gsn_assembly_place_colour(a, err);
    if (r >= 0)
        r = gsn_assembly_place_reference(specimen, px_um, sections, a, err);
    if (r >= 0)
        r = gsn_assembly_place_calibrations(specimen, a, err);
    if (r >= 0)
        r = gsn_assembly_place_columns(specimen, sections, a, err);
    if (r >= 0)
        r = gsn_assembly_refine(specimen, options, a, err);
    if (r >= 0)
        r = gsn_assembly_work_panels(specimen, options, a, err);
    if (r >= 0)
        r = gsn_conditions_judge(specimen, a, err);
    if (r >= 0)
        r = gsn_assembly_normalise(specimen, a, err);
    if (r >= 0)
        r = gsn_assembly_level(specimen, a, err);
    if (r >= 0 && band && a->grid)
        r = gsn_assembly_find_band(specimen, options, a, err);
    if (r >= 0)
        gsn_assembly_sum_errors(specimen, a);
    if (r >= 0)
        r = gsn_assembly_find_tissues(specimen, a, err);
    if (r >= 0)
        r = gsn_assembly_count_colours(specimen, a, err);
    if (r < 0)
        return r;
    *ret_assembly = gsn_steal(&a);
    return GSN_OK;
}

void gsn_assembly_free(struct gsn_assembly *a)
{
    if (!a)
        return;
    for (size_t i = 0; i < a->section_count; i++) {
        gsn_free(a->section[i].thumbnail.png);
        for (size_t c = 0; c < GSN_CANDIDATES; c++)
            gsn_free(a->section[i].candidate_picture[c].png);
    }
    gsn_free(a->section);
    gsn_dust_free(a->dust);
    gsn_free(a->spot);
    gsn_free(a->panel);
    for (size_t i = 0; i < a->calibration_count; i++)
        gsn_calibration_panel_free(a->calibration[i]);
    gsn_free(a->calibration);
    gsn_mask_free(a->region);
    gsn_grid_free(a->grid);
    gsn_colour_grid_free(a->colour);
    gsn_mask_free(a->tissue);
    gsn_grid_free(a->tissue_grid);
    gsn_columns_free(a->columns);
    gsn_cloud_free(a->cloud);
    gsn_sequence_free(a->sequence);
    gsn_free(a);
}
