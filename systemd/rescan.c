/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/rescan.h"

#include <math.h>
#include <string.h>

/* Marks of three sections: by chance they agree never. */
enum { LEAST_PAIRS = 9, MOST_PAIRS = 3 * 512 };

/* Root mean square distance that is left: one pixel of the coarser scan, and what the carriage of a
 * scanner is off. */
static const double CARRIAGE_UM = 10;

struct pairs {
    size_t count;
    struct gsn_point a[MOST_PAIRS], b[MOST_PAIRS]; /* um on the glass */
};

static void add(struct pairs *pairs, const struct gsn_panel_section *section, double px_um,
                const struct gsn_section_row *row, double row_px_um)
{
    for (size_t m = 0; m < GSN_MARKS && pairs->count < MOST_PAIRS; m++) {
        const struct gsn_mark *mark = &section->mark[m];

        if (!mark->found || !row->marker[m].found)
            continue;
        pairs->a[pairs->count] = (struct gsn_point){ px_um * mark->px.x, px_um * mark->px.y };
        pairs->b[pairs->count++] =
            (struct gsn_point){ row_px_um * row->marker[m].x_px, row_px_um * row->marker[m].y_px };
    }
}

/* What a turn and a shift leave of the distances, root mean square; infinite for too few pairs. */
static double residual_um(const struct pairs *pairs)
{
    const double n = (double)pairs->count;
    double ax = 0, ay = 0, bx = 0, by = 0, dot = 0, cross = 0, squares = 0;

    if (pairs->count < LEAST_PAIRS)
        return INFINITY;
    for (size_t i = 0; i < pairs->count; i++) {
        ax += pairs->a[i].x / n;
        ay += pairs->a[i].y / n;
        bx += pairs->b[i].x / n;
        by += pairs->b[i].y / n;
    }
    for (size_t i = 0; i < pairs->count; i++) {
        const double px = pairs->a[i].x - ax, py = pairs->a[i].y - ay;
        const double qx = pairs->b[i].x - bx, qy = pairs->b[i].y - by;

        dot += px * qx + py * qy;
        cross += px * qy - py * qx;
        squares += px * px + py * py + qx * qx + qy * qy;
    }
    /* |R p - q|^2 summed is at least this. */
    return sqrt(fmax(squares - 2 * hypot(dot, cross), 0) / n);
}

static void pair_up(const struct gsn_panel_findings *findings, const struct gsn_section_rows *rows,
                    const struct gsn_panel_row *other, struct pairs *pairs)
{
    pairs->count = 0;
    for (size_t i = 0; i < rows->count; i++) {
        const size_t slot = (size_t)rows->at[i].slot - 1;

        if (rows->at[i].panel_id == other->id && slot < findings->count)
            add(pairs, &findings->section[slot], findings->px_um, &rows->at[i], other->px_um);
    }
}

int gsn_rescan_check(struct gsn_store *store, const struct gsn_panel_row *panel,
                     const struct gsn_panel_findings *findings, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    gsn_auto(gsn_section_rows) rows = NULL;
    gsn_auto_mem(struct pairs) pairs = gsn_alloc(sizeof *pairs);
    int r;

    if (!pairs)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    if (findings->label_number != 0 && findings->label_number == panel->number)
        return GSN_OK;
    r = gsn_panel_list(store, panel->specimen_id, &panels, err);
    if (r >= 0)
        r = gsn_section_list(store, panel->specimen_id, &rows, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < panels->count; i++) {
        const struct gsn_panel_row *other = &panels->at[i];
        double left;

        /* Those of one number are all held, whatever they show (material.c). */
        if (other->id == panel->id || other->number == panel->number ||
            strcmp(other->state, "registered") != 0 || !(other->px_um > 0))
            continue;
        pair_up(findings, rows, other, pairs);
        left = residual_um(pairs);
        if (pairs->count >= LEAST_PAIRS && left < fmax(findings->px_um, other->px_um) + CARRIAGE_UM)
            return gsn_fail(err, GSN_E_WITHHELD,
                            "it shows the same glass as %s (%zu marks agree to %.0f um): both are "
                            "kept; to use this one, import it under that panel's name",
                            other->file_name, pairs->count, left);
    }
    return GSN_OK;
}
