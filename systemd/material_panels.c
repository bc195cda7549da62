/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/material_parts.h"

#include "systemd/panel_job.h"
#include "systemd/rescan.h"

#include <stdio.h>
#include <string.h>

static int clash(const struct gsn_panel_row *a, const struct gsn_panel_row *b)
{
    return a != b && a->number == b->number && strcmp(a->state, "registered") == 0 &&
           strcmp(b->state, "registered") == 0;
}

/* A second scan of one glass needs a choice; two glasses of one number may need another name.
 * gives: the sentence. */
static int say_clash(const struct gsn_section_rows *sections, const struct gsn_panel_row *panel,
                     const struct gsn_panel_row *other, char **ret_sentence, struct gsn_error *err)
{
    gsn_auto_mem(char) sentence = NULL;
    double apart_um;
    size_t marks;
    int same;
    const int r = gsn_rescan_compare(sections, panel, other, &same, &marks, &apart_um, err);

    if (r < 0)
        return r;
    sentence = same ? gsn_format("panel number %lld is claimed by %.200s as well: say which scan "
                                 "to use; both show the same glass (%zu marks agree to %.1f um)",
                                 (long long)panel->number, other->file_name, marks, apart_um)
                    : gsn_format("panel number %lld is claimed by %.200s as well: say which scan "
                                 "to use, or rename one and import again",
                                 (long long)panel->number, other->file_name);
    if (!sentence)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    *ret_sentence = gsn_steal(&sentence);
    return GSN_OK;
}

/* Panels of one number are all held: which of them is right is for a person to say. */
int gsn_material_hold_duplicates(struct gsn_material *m, struct gsn_error *err)
{
    gsn_auto(gsn_section_rows) sections = NULL;
    struct gsn_panel_rows *rows = m->panels;
    int held = 0, r = gsn_section_list(m->store, m->row->id, &sections, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++)
        for (size_t j = 0; r >= 0 && j < rows->count; j++) {
            gsn_auto_mem(char) sentence = NULL;

            if (!clash(&rows->at[i], &rows->at[j]))
                continue;
            r = say_clash(sections, &rows->at[i], &rows->at[j], &sentence, err);
            if (r >= 0)
                r = gsn_panel_set_state(m->store, rows->at[i].id, "held",
                                        gsn_code_name(GSN_E_WITHHELD), sentence, err);
            held = 1;
        }
    if (r < 0 || !held)
        return r;
    m->panels = NULL;
    gsn_panel_rows_free(rows);
    return gsn_panel_list(m->store, m->row->id, &m->panels, err);
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
