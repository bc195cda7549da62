/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/material_parts.h"

#include "systemd/panel_job.h"
#include "systemd/rescan.h"

#include <stdio.h>
#include <string.h>

static int clash(const struct gsn_panel_row *a, const struct gsn_panel_row *b)
{
    return a->number == b->number && strcmp(a->state, "registered") == 0 &&
           strcmp(b->state, "registered") == 0;
}

/* Sections of a panel whose three marks were found. */
static size_t count_found(const struct gsn_section_rows *sections, const struct gsn_panel_row *p)
{
    size_t count = 0;

    for (size_t i = 0; i < sections->count; i++)
        count += sections->at[i].panel_id == p->id && strcmp(sections->at[i].state, "found") == 0;
    return count;
}

/* Of two scans of one glass the one that shows more of it: sections with their marks, then finer
 * pixels; of equals the later one, since who scans a glass again wants that scan. */
static int is_better(const struct gsn_section_rows *sections, const struct gsn_panel_row *a,
                     const struct gsn_panel_row *b)
{
    const size_t found_a = count_found(sections, a), found_b = count_found(sections, b);

    if (found_a != found_b)
        return found_a > found_b;
    if (a->px_um < b->px_um || a->px_um > b->px_um)
        return a->px_um < b->px_um;
    return a->id > b->id;
}

/* Of two scans of one glass one is used and the other kept beside it. Two glasses of one number are
 * both held: which of them is right is for a person to say. */
static int settle_clash(struct gsn_material *m, struct gsn_decoder *decoder,
                        const struct gsn_section_rows *sections, const struct gsn_panel_row *a,
                        const struct gsn_panel_row *b, struct gsn_error *err)
{
    const struct gsn_panel_row *const pair[2] = { a, b };
    struct gsn_rescan rescan = { .same = 0 };
    int r = gsn_rescan_compare(m->store, decoder, m->protocol, sections, a, b, &rescan, err);

    for (int i = 0; r >= 0 && i < 2; i++) {
        const struct gsn_panel_row *panel = pair[i], *other = pair[1 - i];
        gsn_auto_mem(char) sentence = NULL;

        if (rescan.same && is_better(sections, panel, other))
            continue;
        sentence =
            rescan.same
                ? gsn_format(
                      "another scan of panel %lld is used, %.200s: both show the same glass "
                      "(%zu marks agree to %.1f um, the tissue to %.0f %%); this one is kept "
                      "beside it",
                      (long long)panel->number, other->file_name, rescan.marks, rescan.apart_um,
                      100 * rescan.texture)
                : gsn_format("panel number %lld is claimed by %.200s as well, which shows another "
                             "glass: say which to use, or rename one and import again",
                             (long long)panel->number, other->file_name);
        if (!sentence)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory");
        r = gsn_panel_set_state(m->store, panel->id, "held",
                                rescan.same ? GSN_PANEL_SPARE : gsn_code_name(GSN_E_WITHHELD),
                                sentence, err);
    }
    return r;
}

/* Every pair that claims one number, those that a pair before settled left out. */
int gsn_material_settle_duplicates(struct gsn_material *m, struct gsn_decoder *decoder,
                                   struct gsn_error *err)
{
    for (;;) {
        gsn_auto(gsn_section_rows) sections = NULL;
        const struct gsn_panel_row *a = NULL, *b = NULL;
        int r = gsn_section_list(m->store, m->row->id, &sections, err);

        for (size_t i = 0; r >= 0 && !b && i < m->panels->count; i++)
            for (size_t j = i + 1; !b && j < m->panels->count; j++)
                if (clash(&m->panels->at[i], &m->panels->at[j])) {
                    a = &m->panels->at[i];
                    b = &m->panels->at[j];
                }
        if (r < 0 || !b)
            return r;
        r = settle_clash(m, decoder, sections, a, b, err);
        if (r < 0)
            return r;
        gsn_panel_rows_free(m->panels);
        m->panels = NULL;
        r = gsn_panel_list(m->store, m->row->id, &m->panels, err);
        if (r < 0)
            return r;
    }
}

int gsn_material_check_turns(const struct gsn_material *m, struct gsn_error *err)
{
    for (size_t i = 0; i < m->panels->count; i++)
        if (gsn_panel_lacks_turn(&m->panels->at[i]))
            return gsn_fail(err, GSN_E_INPUT,
                            "panel %s was looked at by an older gieson, which did not keep how it "
                            "lies: import its folder again with --replace, then say `gieson run`",
                            m->panels->at[i].file_name);
    return GSN_OK;
}

/* The specimen's job comes after its panels' jobs, so a panel that still waits had one that failed.
 */
static const char *message_of(const struct gsn_panel_row *row)
{
    return strcmp(row->state, "waiting") == 0
               ? "its own job failed: see `gieson status`, then `gieson retry`"
               : row->message;
}

/* A section that is doubtful by itself, or that a person decided on, keeps the candidates it was
 * found with; those of one that contradicts the stack follow from the stack again. */
static struct gsn_panel_section section_of(const struct gsn_material *m,
                                           const struct gsn_section_row *row)
{
    struct gsn_panel_section section = gsn_panel_section_of_row(row);

    if (section.sighting == GSN_SIGHT_NEEDS_EYE || strstr(section.flags, "decided"))
        gsn_candidates_from_rows(m->candidates, row->panel_id, row->slot, &section.candidates);
    /* One that was taken as it was so likely, and not by a person, is taken again or not. */
    if (!strstr(section.flags, "decided"))
        section.candidates.chosen = 0;
    return section;
}

static struct gsn_upright upright_of(const struct gsn_panel_row *row)
{
    struct gsn_upright upright = { .turn = { .mirrored = row->mirrored != 0,
                                             .quarters = (unsigned)row->quarters } };

    (void)snprintf(upright.note, sizeof upright.note, "%s", row->turn_note);
    return upright;
}

int gsn_material_take_panels(struct gsn_material *m, struct gsn_error *err)
{
    size_t used = 0;

    m->panel = gsn_alloc_array(m->panels->count, sizeof *m->panel);
    m->section = gsn_alloc_array(m->sections->count, sizeof *m->section);
    if (!m->panel || !m->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the panels of a specimen");
    for (size_t i = 0; i < m->panels->count; i++) {
        const struct gsn_panel_row *row = &m->panels->at[i];
        const size_t first = used;

        for (size_t s = 0; s < m->sections->count; s++)
            if (m->sections->at[s].panel_id == row->id && strcmp(row->state, "registered") == 0)
                m->section[used++] = section_of(m, &m->sections->at[s]);
        m->panel[i] = (struct gsn_specimen_panel){ .number = (unsigned)row->number,
                                                   .file = row->file_name,
                                                   .sha256 = row->sha256,
                                                   .state = row->state,
                                                   .message = message_of(row),
                                                   .size = (size_t)row->size,
                                                   .px_um = row->px_um,
                                                   .upright = upright_of(row),
                                                   .section_count = used - first,
                                                   .section = m->section + first };
    }
    m->specimen.panel = m->panel;
    m->specimen.panel_count = m->panels->count;
    return GSN_OK;
}
