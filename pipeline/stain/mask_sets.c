/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/mask_cells.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/distance.h"

/* Means over 2 r + 1 values of a line, fewer at its ends. */
static void smooth_line(const float *in, float *out, size_t n, size_t r)
{
    double sum = 0;
    size_t first = 0, end = 0;

    for (size_t i = 0; i < n; i++) {
        for (; end < n && end <= i + r; end++)
            sum += in[end];
        for (; first + r < i; first++)
            sum -= in[first];
        out[i] = (float)(sum / (double)(end - first));
    }
}

static void add_line(const float *line, double sign, double *sum, size_t n)
{
    for (size_t x = 0; x < n; x++)
        sum[x] += sign * line[x];
}

/* The same down all columns at once, line by line as they lie in memory. sum: nx zeroes. */
static void smooth_columns(const float *in, float *out, size_t nx, size_t ny, size_t r, double *sum)
{
    size_t first = 0, end = 0;

    for (size_t y = 0; y < ny; y++) {
        for (; end < ny && end <= y + r; end++)
            add_line(in + end * nx, 1, sum, nx);
        for (; first + r < y; first++)
            add_line(in + first * nx, -1, sum, nx);
        for (size_t x = 0; x < nx; x++)
            out[y * nx + x] = (float)(sum[x] / (double)(end - first));
    }
}

int gsn_mask_cells_smooth(const struct gsn_plane *plane, uint32_t r, struct gsn_plane **ret_smooth,
                          struct gsn_error *err)
{
    const size_t nx = plane->width, ny = plane->height;
    gsn_auto(gsn_plane) rows = NULL;
    gsn_auto(gsn_plane) all = NULL;
    gsn_auto_mem(double) sum = gsn_alloc_array(nx, sizeof *sum);
    int code = sum ? gsn_plane_new(plane->width, plane->height, &rows, err)
                   : gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");

    if (code >= 0)
        code = gsn_plane_new(plane->width, plane->height, &all, err);
    if (code < 0)
        return code;
    for (size_t y = 0; y < ny; y++)
        smooth_line(plane->value + y * nx, rows->value + y * nx, nx, r);
    smooth_columns(rows->value, all->value, nx, ny, r, sum);
    *ret_smooth = gsn_steal(&all);
    return GSN_OK;
}

/* set becomes 1 within um of where it was `value`, else 0. */
static int near(const struct gsn_mask_cells *cells, uint8_t *set, uint8_t value, double um,
                struct gsn_error *err)
{
    const struct gsn_distance_box box = { cells->nx, cells->ny, 1, cells->um, cells->um, 1 };
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(float) squared = NULL;
    size_t members = 0;
    int r;

    for (size_t i = 0; i < count; i++) {
        set[i] = set[i] == value;
        members += set[i];
    }
    if (members == 0) /* most sections have none of most defects */
        return GSN_OK;
    squared = gsn_alloc_array(count, sizeof *squared);
    if (!squared)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_distance_squared(set, &box, 1, squared, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        set[i] = squared[i] <= (float)(um * um);
    return r;
}

int gsn_mask_cells_dilate(const struct gsn_mask_cells *cells, uint8_t *set, double um,
                          struct gsn_error *err)
{
    return near(cells, set, 1, um, err);
}

int gsn_mask_cells_erode(const struct gsn_mask_cells *cells, uint8_t *set, double um,
                         struct gsn_error *err)
{
    const int r = near(cells, set, 0, um, err);

    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++)
        set[i] = !set[i];
    return r;
}

void gsn_mask_cells_mark(struct gsn_mask_cells *cells, const uint8_t *set, enum gsn_defect defect)
{
    for (size_t i = 0; i < (size_t)cells->nx * cells->ny; i++)
        if (set[i])
            cells->label[i] = (uint16_t)(cells->label[i] | defect);
}

void gsn_mask_cells_pieces_free(struct gsn_mask_cells_pieces *pieces)
{
    if (!pieces)
        return;
    gsn_free(pieces->piece);
    gsn_free(pieces->cell);
    gsn_free(pieces);
}

/* Takes the piece that holds start out of left, appending its cells to list. */
static size_t flood(const struct gsn_mask_cells *cells, uint8_t *left, size_t start, uint32_t *list)
{
    size_t count = 0;

    list[count++] = (uint32_t)start;
    left[start] = 0;
    for (size_t done = 0; done < count; done++) {
        const long x = list[done] % cells->nx, y = list[done] / cells->nx;

        for (long v = y > 0 ? y - 1 : 0; v <= y + 1 && v < (long)cells->ny; v++)
            for (long u = x > 0 ? x - 1 : 0; u <= x + 1 && u < (long)cells->nx; u++) {
                const size_t at = (size_t)v * cells->nx + (size_t)u;

                if (left[at]) {
                    left[at] = 0;
                    list[count++] = (uint32_t)at;
                }
            }
    }
    return count;
}

static void measure_piece(const struct gsn_mask_cells *cells, const uint32_t *list,
                          struct gsn_mask_cells_piece *piece)
{
    double xx = 1.0 / 12, yy = 1.0 / 12, xy = 0; /* a cell is a square, not a point */
    double half, turn;

    for (size_t i = 0; i < piece->count; i++) {
        piece->x += list[i] % cells->nx / (double)piece->count;
        piece->y += list[i] / cells->nx / (double)piece->count;
    }
    for (size_t i = 0; i < piece->count; i++) {
        const double x = list[i] % cells->nx - piece->x, y = list[i] / cells->nx - piece->y;

        xx += x * x / (double)piece->count;
        yy += y * y / (double)piece->count;
        xy += x * y / (double)piece->count;
    }
    half = hypot((xx - yy) / 2, xy);
    turn = atan2(2 * xy, xx - yy) / 2;
    piece->length = 4 * sqrt((xx + yy) / 2 + half);
    piece->breadth = 4 * sqrt(fmax((xx + yy) / 2 - half, 0));
    piece->along_x = cos(turn);
    piece->along_y = sin(turn);
}

int gsn_mask_cells_pieces(const struct gsn_mask_cells *cells, const uint8_t *set,
                          struct gsn_mask_cells_pieces **ret_pieces, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_mask_cells_pieces) pieces = gsn_alloc_array(1, sizeof *pieces);
    gsn_auto_mem(uint8_t) left = gsn_memdup(set, count);
    size_t room = 0, used = 0;

    if (pieces)
        pieces->cell = gsn_alloc_array(count, sizeof *pieces->cell);
    if (!pieces || !left || !pieces->cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++) {
        if (!left[i])
            continue;
        if (pieces->count == room) {
            void *more = gsn_realloc_array(pieces->piece, 2 * room + 64, sizeof *pieces->piece);

            if (!more)
                return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
            pieces->piece = more;
            room = 2 * room + 64;
        }
        struct gsn_mask_cells_piece piece = { .first = used };

        piece.count = flood(cells, left, i, pieces->cell + used);
        measure_piece(cells, pieces->cell + used, &piece);
        used += piece.count;
        pieces->piece[pieces->count++] = piece;
    }
    *ret_pieces = gsn_steal(&pieces);
    return GSN_OK;
}

int gsn_mask_cells_grow(const struct gsn_mask_cells *cells, const uint8_t *sure, uint8_t *weak,
                        double um, struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto(gsn_mask_cells_pieces) pieces = NULL;
    gsn_auto_mem(uint8_t) reach = gsn_memdup(sure, count);
    int r;

    if (!reach)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_mask_cells_dilate(cells, reach, um, err);
    for (size_t i = 0; i < count; i++)
        weak[i] = sure[i] || (weak[i] && reach[i]);
    if (r >= 0)
        r = gsn_mask_cells_pieces(cells, weak, &pieces, err);
    for (size_t p = 0; r >= 0 && p < pieces->count; p++) {
        const uint32_t *cell = pieces->cell + pieces->piece[p].first;
        int held = 0;

        for (size_t i = 0; i < pieces->piece[p].count; i++)
            held |= sure[cell[i]];
        for (size_t i = 0; i < pieces->piece[p].count; i++)
            weak[cell[i]] = (uint8_t)held;
    }
    return r;
}

int gsn_mask_cells_broad(const struct gsn_mask_cells *cells, uint8_t *set, double half_um,
                         struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) core = gsn_memdup(set, (size_t)cells->nx * cells->ny);
    int r;

    if (!core)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    r = gsn_mask_cells_erode(cells, core, half_um, err);
    return r < 0 ? r : gsn_mask_cells_grow(cells, core, set, 3 * half_um, err);
}

int gsn_mask_cells_fill_holes(const struct gsn_mask_cells *cells, uint8_t *set,
                              struct gsn_error *err)
{
    const size_t count = (size_t)cells->nx * cells->ny;
    gsn_auto_mem(uint8_t) outside = gsn_alloc(count);
    gsn_auto_mem(uint32_t) list = gsn_alloc_array(count, sizeof *list);
    size_t n;

    if (!outside || !list)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for masks");
    for (size_t i = 0; i < count; i++)
        outside[i] = !set[i];
    n = flood(cells, outside, 0, list); /* the rim is glass, and all of one piece */
    memset(set, 1, count);
    for (size_t i = 0; i < n; i++)
        set[list[i]] = 0;
    return GSN_OK;
}
