/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/record.h"

#include "pipeline/phantom/decoy.h"

#include <math.h>

#define DEG_PER_RAD (180 / M_PI)

static const char *truth_of(int yes)
{
    return yes ? "true" : "false";
}

static void add_marks(struct gsn_phantom_buffer *text, const struct gsn_phantom_section *s)
{
    gsn_phantom_buffer_print(text, ",\n     \"marks\": [");
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        const struct gsn_phantom_mark *m = &s->mark[i];

        gsn_phantom_buffer_print(text,
                                 "%s{\"marker\": %d, \"missing\": %s, \"block_um\": [%.15g, %.15g],"
                                 " \"radius_um\": %.15g, \"ratio\": %.15g, \"turn_deg\": %.15g}",
                                 i ? ",\n       " : "", i + 1, truth_of(m->missing), m->centre.x,
                                 m->centre.y, m->radius_um, m->ratio, m->turn * DEG_PER_RAD);
    }
    gsn_phantom_buffer_print(text, "]");
}

static void add_decoys(struct gsn_phantom_buffer *text, const struct gsn_phantom_section *s)
{
    gsn_phantom_buffer_print(text, ",\n     \"decoys\": [");
    for (int i = 0; i < s->decoys; i++)
        gsn_phantom_buffer_print(
            text, "%s{\"type\": \"%s\", \"at_um\": [%.15g, %.15g], \"radius_um\": %.15g}",
            i ? ", " : "", gsn_phantom_decoy_name(s->decoy[i].kind), s->decoy[i].at_um.x,
            s->decoy[i].at_um.y, s->decoy[i].radius_um);
    gsn_phantom_buffer_print(text, "]");
}

static void add_sections(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"sections\": [");
    for (int k = 0; k < plan->sections; k++) {
        const struct gsn_phantom_section *s = &plan->section[k];

        gsn_phantom_buffer_print(
            text,
            "%s\n    {\"k\": %d, \"z_um\": %.15g, \"panel\": %d, \"slot\": %d, "
            "\"present\": %s, \"flip\": %s, \"theta_deg\": %.15g, "
            "\"sx\": %.15g, \"sy\": %.15g, \"c_px\": [%.15g, %.15g]",
            k ? "," : "", k, s->z_um, s->panel, s->slot, truth_of(s->shows == k), truth_of(s->flip),
            s->theta * DEG_PER_RAD, s->sx, s->sy, s->centre_px.x, s->centre_px.y);
        if (gsn_phantom_plan_varies(plan)) {
            gsn_phantom_buffer_print(text, ", \"shows\": %d", s->shows);
            add_marks(text, s);
            add_decoys(text, s);
        }
        gsn_phantom_buffer_print(text, "}");
    }
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_markers(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"markers\": [");
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++)
        gsn_phantom_buffer_print(text, "%s{\"marker\": %d, \"block_um\": [%.15g, %.15g]}",
                                 i ? ", " : "", i + 1, plan->variant.geometry.mark[i].x,
                                 plan->variant.geometry.mark[i].y);
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_vector(struct gsn_phantom_buffer *text, const char *name, const double v[3])
{
    gsn_phantom_buffer_print(text, ", \"%s\": [%.15g, %.15g, %.15g]", name, v[0], v[1], v[2]);
}

static void add_panels(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"panels\": [");
    for (int i = 0; i < plan->panels; i++) {
        const struct gsn_phantom_batch *b = &plan->batch[i];

        gsn_phantom_buffer_print(text, "%s\n    {\"panel\": %d, \"kr\": %.15g, \"ky\": %.15g",
                                 i ? "," : "", i + 1, b->red_gain, b->yellow_gain);
        add_vector(text, "I0", b->white);
        add_vector(text, "RED", b->dye[GSN_PHANTOM_RED]);
        add_vector(text, "YEL", b->dye[GSN_PHANTOM_YELLOW]);
        add_vector(text, "NUC", b->dye[GSN_PHANTOM_NUCLEAR]);
        gsn_phantom_buffer_print(text, "}");
    }
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_files(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"missing_panel\": %d,\n  \"files\": [", plan->missing_panel);
    for (int i = 0; i < plan->files; i++) {
        const struct gsn_phantom_file *f = &plan->file[i];

        gsn_phantom_buffer_print(text,
                                 "%s\n    {\"panel\": %d, \"again\": %s, \"orientation\": %d, "
                                 "\"bits\": %d, \"kept\": %.15g, \"tag_um\": %.15g}",
                                 i ? "," : "", f->panel, truth_of(f->again), f->orientation,
                                 f->bits, f->kept, f->tag_um);
    }
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_places(struct gsn_phantom_buffer *text, const struct gsn_phantom_defect *d)
{
    gsn_phantom_buffer_print(text, ", \"points_um\": [");
    for (size_t i = 0; i < d->count; i++)
        gsn_phantom_buffer_print(text, "%s[%.15g, %.15g]", i ? ", " : "", d->point[i].x,
                                 d->point[i].y);
    gsn_phantom_buffer_print(text, "], \"dust_um\": [");
    for (int i = 0; i < GSN_PHANTOM_DUST && d->dust[i].radius > 0; i++)
        gsn_phantom_buffer_print(text, "%s[%.15g, %.15g, %.15g]", i ? ", " : "", d->dust[i].at.x,
                                 d->dust[i].at.y, d->dust[i].radius);
    gsn_phantom_buffer_print(text, "]");
}

static void add_defects(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"defects\": [");
    for (size_t i = 0; i < plan->defects; i++) {
        const struct gsn_phantom_defect *d = &plan->defect[i];

        gsn_phantom_buffer_print(
            text,
            "%s\n    {\"k\": %d, \"type\": \"%s\", \"turn_deg\": %.15g, \"at_um\": [%.15g, %.15g], "
            "\"slope\": %.15g, \"width_um\": %.15g, \"radius_um\": %.15g, \"sigma_px\": %.15g, "
            "\"colour\": %d, \"place_um\": [%.15g, %.15g], \"place_turn_deg\": %.15g",
            i ? "," : "", d->k, gsn_phantom_defect_name(d->kind), d->turn * DEG_PER_RAD, d->at.x,
            d->at.y, d->slope, d->width, d->radius, d->sigma_px, d->colour, d->place.x, d->place.y,
            d->place_turn * DEG_PER_RAD);
        add_places(text, d);
        gsn_phantom_buffer_print(text, "}");
    }
    gsn_phantom_buffer_print(text, "]\n}\n");
}

void gsn_phantom_record_drawn(const struct gsn_phantom_plan *plan, struct gsn_phantom_buffer *text)
{
    add_sections(text, plan);
    add_markers(text, plan);
    if (gsn_phantom_plan_varies(plan))
        add_panels(text, plan);
    if (plan->level.awkward)
        add_files(text, plan);
    add_defects(text, plan);
}
