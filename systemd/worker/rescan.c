/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method. 1. The marks of both scans, section by section, are laid on each other by one turn and
 * shift of the glass (Procrustes in closed form); what is left must be within a pixel and what the
 * carriage of a scanner is off. 2. The tissue, as optical density in cells of some 50 um, is taken
 * through that motion, what is coarser than a quarter of a millimetre is taken off both, and the
 * rest is correlated over the cells that are tissue on both. Two scans of one glass share it
 * whatever the light and the exposure; another section of the block, laid on by its own marks, does
 * not: of the real stacks that were at hand, even direct neighbours share less than half. Cells
 * that are no tissue on either side do not count, so outlines that are alike add little.
 *
 * The pictures are opened only where the marks agree. What fails there (a picture that is damaged
 * now) fails the comparison. Cost: two surveys, some seconds for a panel of 50 megapixels. */
#include "systemd/worker/rescan.h"

#include <math.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/catalog.h"

/* Marks of three sections: by chance they agree never. */
enum { LEAST_PAIRS = 9, MOST_PAIRS = 3 * 512 };

/* Root mean square distance that is left: one pixel of the coarser scan, and what the carriage of a
 * scanner is off. */
static const double CARRIAGE_UM = 10;

/* The correlation of two scans of one glass is above this: in the middle of what is told above. */
static const double SAME_TEXTURE = 0.7;
/* Cells on either side that a cell's own mean is taken over: 0.5 mm across. */
enum { AROUND = 5 };
/* Optical density, R + G + B, that tissue has and glass has not. */
static const float TISSUE = 0.15f;
/* Fewer cells of tissue than a square millimetre tell nothing. */
enum { LEAST_CELLS = 400 };

struct pairs {
    size_t count;
    struct gsn_point a[MOST_PAIRS], b[MOST_PAIRS]; /* um on the glass */
};

/* q = R p + shift, and what it leaves. */
struct motion {
    double cos, sin, dx, dy, left_um;
};

static struct motion fit_motion(const struct pairs *pairs)
{
    const double n = (double)pairs->count;
    double ax = 0, ay = 0, bx = 0, by = 0, dot = 0, cross = 0, squares = 0, size;
    struct motion motion = { .left_um = INFINITY };

    if (pairs->count < LEAST_PAIRS)
        return motion;
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
    size = hypot(dot, cross);
    motion.cos = size > 0 ? dot / size : 1;
    motion.sin = size > 0 ? cross / size : 0;
    motion.dx = bx - (motion.cos * ax - motion.sin * ay);
    motion.dy = by - (motion.sin * ax + motion.cos * ay);
    motion.left_um = sqrt(fmax(squares - 2 * size, 0) / n);
    return motion;
}

/* ---- the marks --------------------------------------------------------------------------- */

static void add_pair(struct pairs *pairs, struct gsn_point a, double a_um,
                     const struct gsn_fiducial_row *b, double b_um)
{
    if (pairs->count == MOST_PAIRS || !b->found)
        return;
    pairs->a[pairs->count] = (struct gsn_point){ a_um * a.x, a_um * a.y };
    pairs->b[pairs->count++] = (struct gsn_point){ b_um * b->x_px, b_um * b->y_px };
}

static void pair_findings(const struct gsn_panel_findings *findings,
                          const struct gsn_section_rows *rows, const struct gsn_panel_row *other,
                          struct pairs *pairs)
{
    pairs->count = 0;
    for (size_t i = 0; i < rows->count; i++) {
        const size_t slot = (size_t)rows->at[i].slot - 1;

        for (size_t m = 0;
             m < GSN_FIDUCIALS && rows->at[i].panel_id == other->id && slot < findings->count; m++)
            if (findings->section[slot].mark[m].found)
                add_pair(pairs, findings->section[slot].mark[m].px, findings->px_um,
                         &rows->at[i].marker[m], other->px_um);
    }
}

static void pair_rows(const struct gsn_section_rows *rows, const struct gsn_panel_row *a,
                      const struct gsn_panel_row *b, struct pairs *pairs)
{
    pairs->count = 0;
    for (size_t i = 0; i < rows->count; i++)
        for (size_t j = 0; j < rows->count; j++) {
            const struct gsn_section_row *p = &rows->at[i], *q = &rows->at[j];

            if (p->panel_id != a->id || q->panel_id != b->id || p->slot != q->slot)
                continue;
            for (size_t m = 0; m < GSN_FIDUCIALS; m++)
                if (p->marker[m].found)
                    add_pair(pairs, (struct gsn_point){ p->marker[m].x_px, p->marker[m].y_px },
                             a->px_um, &q->marker[m], b->px_um);
        }
}

static int marks_agree(const struct motion *motion, double a_um, double b_um)
{
    return motion->left_um < fmax(a_um, b_um) + CARRIAGE_UM;
}

/* ---- the tissue -------------------------------------------------------------------------- */

static int survey_picture(struct gsn_store *store, struct gsn_decoder *decoder,
                          const struct gsn_protocol *protocol, const char *sha256,
                          const struct gsn_orientation *upright, struct gsn_scan **ret_scan,
                          struct gsn_error *err)
{
    gsn_auto_fd picture_fd = -1;
    const int r = gsn_object_open(store, sha256, &picture_fd, err);

    return r < 0 ? r : gsn_scan_survey(decoder, picture_fd, protocol, upright, ret_scan, err);
}

/* The density at a place, 0 off the picture: no tissue. */
static float total_at(const struct gsn_plane *total, double x, double y)
{
    const double u = x - 0.5, v = y - 0.5;
    const size_t w = total->width, i = (size_t)fmax(u, 0), j = (size_t)fmax(v, 0);
    const float fu = (float)(u - (double)i), fv = (float)(v - (double)j);
    const float *at = total->value + j * w + i;

    if (u < 0 || v < 0 || i + 1 >= w || j + 1 >= total->height)
        return 0;
    return (at[0] * (1 - fu) + at[1] * fu) * (1 - fv) + (at[w] * (1 - fu) + at[w + 1] * fu) * fv;
}

/* The cell's value less the mean of the tissue around it. */
static double texture_at(const float *value, size_t width, size_t x, size_t y)
{
    double sum = 0;
    size_t count = 0;

    for (size_t v = y - AROUND; v <= y + AROUND; v++)
        for (size_t u = x - AROUND; u <= x + AROUND; u++) {
            const float at = value[v * width + u];

            sum += at > TISSUE ? (double)at : 0;
            count += at > TISSUE;
        }
    return value[y * width + x] - sum / (double)count;
}

/* b's density where a's cells lie. */
static void take_through(const struct gsn_scan *a, const struct gsn_scan *b,
                         const struct motion *motion, float *ret_value)
{
    const double from = a->step * a->px_um, onto = b->step * b->px_um;

    for (size_t i = 0; i < (size_t)a->total->width * a->total->height; i++) {
        const double x = from * ((double)(i % a->total->width) + 0.5);
        const double y = from * ((double)(i / a->total->width) + 0.5);

        ret_value[i] = total_at(b->total, (motion->cos * x - motion->sin * y + motion->dx) / onto,
                                (motion->sin * x + motion->cos * y + motion->dy) / onto);
    }
}

/* Correlation over the cells that are tissue on both; 0 where they are too few. */
static int compare_tissue(const struct gsn_scan *a, const struct gsn_scan *b,
                          const struct motion *motion, double *ret_texture, struct gsn_error *err)
{
    const size_t width = a->total->width, height = a->total->height;
    const float *p = a->total->value;
    gsn_auto_mem(float) q = gsn_alloc_array(width * height, sizeof *q);
    double pp = 0, qq = 0, pq = 0;
    size_t count = 0;

    if (!q)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while comparing two panels");
    take_through(a, b, motion, q);
    for (size_t y = AROUND; y + AROUND < height; y++)
        for (size_t x = AROUND; x + AROUND < width; x++) {
            const size_t i = y * width + x;
            double u, v;

            if (!(p[i] > TISSUE && q[i] > TISSUE))
                continue;
            u = texture_at(p, width, x, y);
            v = texture_at(q, width, x, y);
            pp += u * u;
            qq += v * v;
            pq += u * v;
            count++;
        }
    *ret_texture = count >= LEAST_CELLS && pp > 0 && qq > 0 ? pq / sqrt(pp * qq) : 0;
    return GSN_OK;
}

static int compare_pictures(struct gsn_store *store, struct gsn_decoder *decoder,
                            const struct gsn_protocol *protocol, const char *a_sha256,
                            const struct gsn_orientation *a_upright, const struct gsn_panel_row *b,
                            const struct motion *motion, double *ret_texture, struct gsn_error *err)
{
    const struct gsn_orientation b_upright = { .turn = { .mirrored = b->mirrored != 0,
                                                         .quarters = (unsigned)b->quarters } };
    gsn_auto(gsn_scan) scan_a = NULL;
    gsn_auto(gsn_scan) scan_b = NULL;
    int r = survey_picture(store, decoder, protocol, a_sha256, a_upright, &scan_a, err);

    if (r >= 0)
        r = survey_picture(store, decoder, protocol, b->sha256, &b_upright, &scan_b, err);
    return r < 0 ? r : compare_tissue(scan_a, scan_b, motion, ret_texture, err);
}

/* ---- together ---------------------------------------------------------------------------- */

int gsn_rescan_compare(struct gsn_store *store, struct gsn_decoder *decoder,
                       const struct gsn_protocol *protocol, const struct gsn_section_rows *rows,
                       const struct gsn_panel_row *a, const struct gsn_panel_row *b,
                       struct gsn_rescan *ret_rescan, struct gsn_error *err)
{
    const struct gsn_orientation upright = { .turn = { .mirrored = a->mirrored != 0,
                                                       .quarters = (unsigned)a->quarters } };
    gsn_auto_mem(struct pairs) pairs = gsn_alloc(sizeof *pairs);
    struct gsn_rescan rescan = { .texture = NAN };
    struct motion motion;
    int r = GSN_OK;

    if (!pairs)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a panel");
    pair_rows(rows, a, b, pairs);
    motion = fit_motion(pairs);
    rescan.marks = pairs->count;
    rescan.apart_um = motion.left_um;
    if (marks_agree(&motion, a->px_um, b->px_um))
        r = compare_pictures(store, decoder, protocol, a->sha256, &upright, b, &motion,
                             &rescan.texture, err);
    if (r < 0)
        return r;
    rescan.same = rescan.texture >= SAME_TEXTURE;
    *ret_rescan = rescan;
    return GSN_OK;
}

int gsn_rescan_check(struct gsn_store *store, struct gsn_decoder *decoder,
                     const struct gsn_protocol *protocol, const struct gsn_panel_row *panel,
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
        struct motion motion;
        double texture = NAN;

        /* Of those of one number one is used (job_inputs.c). */
        if (other->id == panel->id || other->number == panel->number ||
            strcmp(other->state, "registered") != 0 || !(other->px_um > 0))
            continue;
        pair_findings(findings, rows, other, pairs);
        motion = fit_motion(pairs);
        if (!marks_agree(&motion, findings->px_um, other->px_um))
            continue;
        r = compare_pictures(store, decoder, protocol, panel->sha256, &findings->upright, other,
                             &motion, &texture, err);
        if (r < 0)
            return r;
        if (texture >= SAME_TEXTURE)
            return gsn_fail(err, GSN_E_WITHHELD,
                            "it shows the same glass as %s (%zu marks agree to %.0f um, the tissue "
                            "to %.0f %%): both are kept; to use this one, import it under that "
                            "panel's name",
                            other->file_name, pairs->count, motion.left_um, 100 * texture);
    }
    return GSN_OK;
}
