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

static void add_pair(struct pairs *pairs, struct gsn_point a, double a_um,
                     const struct gsn_marker_row *b, double b_um)
{
    if (pairs->count == MOST_PAIRS || !b->found)
        return;
    pairs->a[pairs->count] = (struct gsn_point){ a_um * a.x, a_um * a.y };
    pairs->b[pairs->count++] = (struct gsn_point){ b_um * b->x_px, b_um * b->y_px };
}

static void add(struct pairs *pairs, const struct gsn_panel_section *section, double px_um,
                const struct gsn_section_row *row, double row_px_um)
{
    for (size_t m = 0; m < GSN_MARKS; m++)
        if (section->mark[m].found)
            add_pair(pairs, section->mark[m].px, px_um, &row->marker[m], row_px_um);
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

static void pair_rows(const struct gsn_section_rows *rows, const struct gsn_panel_row *a,
                      const struct gsn_panel_row *b, struct pairs *pairs)
{
    for (size_t i = 0; i < rows->count; i++)
        for (size_t j = 0; j < rows->count; j++) {
            const struct gsn_section_row *p = &rows->at[i], *q = &rows->at[j];

            if (p->panel_id != a->id || q->panel_id != b->id || p->slot != q->slot)
                continue;
            for (size_t m = 0; m < GSN_MARKS; m++)
                if (p->marker[m].found)
                    add_pair(pairs, (struct gsn_point){ p->marker[m].x_px, p->marker[m].y_px },
                             a->px_um, &q->marker[m], b->px_um);
        }
}

static int is_same(const struct pairs *pairs, double apart_um, double a_um, double b_um)
{
    return pairs->count >= LEAST_PAIRS && apart_um < fmax(a_um, b_um) + CARRIAGE_UM;
}

int gsn_rescan_compare(const struct gsn_section_rows *rows, const struct gsn_panel_row *a,
                       const struct gsn_panel_row *b, int *ret_same, size_t *ret_marks,
                       double *ret_apart_um, struct gsn_error *err)
{
    gsn_auto_mem(struct pairs) pairs = gsn_alloc(sizeof *pairs);

    if (!pairs)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    pairs->count = 0;
    pair_rows(rows, a, b, pairs);
    *ret_marks = pairs->count;
    *ret_apart_um = residual_um(pairs);
    *ret_same = is_same(pairs, *ret_apart_um, a->px_um, b->px_um);
    return GSN_OK;
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
        if (is_same(pairs, left, findings->px_um, other->px_um))
            return gsn_fail(err, GSN_E_WITHHELD,
                            "it shows the same glass as %s (%zu marks agree to %.0f um): both are "
                            "kept; to use this one, import it under that panel's name",
                            other->file_name, pairs->count, left);
    }
    return GSN_OK;
}
