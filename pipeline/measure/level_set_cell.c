/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/level_set_cell.h"

#include <float.h>
#include <math.h>
#include <string.h>

#include "pipeline/measure/cell_part.h"
#include "pipeline/model/frame.h"
#include "pipeline/measure/sum.h"

enum { MOST_LEVELS = 90 }; /* 30 along each of three edges */

static const double default_gap = 1e-3;
static const size_t default_cells = 100000;
/* Of the cell: sums of 1e5 shares, each good to some 1e-15, compensated. */
static const double sum_slack = 1e-12;
/* Of coordinate times surface: what cutting a cell may lose or gain by rounding. */
static const double cut_slack = 64.0 * DBL_EPSILON;
/* Of the cell: what may be missing before it counts as sticking out of the mesh. */
static const double most_missing = 1e-9;
/* Of the cell: parts that are not worth having, counted as missing. */
static const double crumb = 1e-15;

struct work {
    const struct gsn_spline *spline;
    const struct gsn_dms *space;
    struct gsn_tet_cell cell;
    double threshold, volume, slack; /* slack: um^3 */
    size_t most, count, room, open;
    struct gsn_cell_part *part; /* count, room */
    size_t *heap;               /* open of them: parts that can be halved, widest first */
    size_t skins;
    struct gsn_skin **skin;
};

static void work_done(struct work *work)
{
    for (size_t i = 0; i < work->skins; i++)
        gsn_skin_free(work->skin[i]);
    gsn_free(work->skin);
    gsn_free(work->part);
    gsn_free(work->heap);
}

static double gap_of(const struct work *work, size_t part)
{
    return work->part[part].upper - work->part[part].lower;
}

/* Puts a part into its place in the heap, from the end upward. */
static void push(struct work *work, size_t part)
{
    size_t place = work->open++;

    while (place > 0) {
        const size_t parent = (place - 1) / 2;

        if (gap_of(work, work->heap[parent]) >= gap_of(work, part))
            break;
        work->heap[place] = work->heap[parent];
        place = parent;
    }
    work->heap[place] = part;
}

/* Takes the widest part out. */
static size_t pop(struct work *work)
{
    const size_t top = work->heap[0], last = work->heap[--work->open];
    size_t place = 0;

    for (;;) {
        size_t child = 2 * place + 1;

        if (child >= work->open)
            break;
        if (child + 1 < work->open &&
            gap_of(work, work->heap[child + 1]) > gap_of(work, work->heap[child]))
            child++;
        if (gap_of(work, last) >= gap_of(work, work->heap[child]))
            break;
        work->heap[place] = work->heap[child];
        place = child;
    }
    work->heap[place] = last;
    return top;
}

static void offer(struct work *work, size_t part)
{
    if (gap_of(work, part) > 0.0 && work->part[part].level < MOST_LEVELS)
        push(work, part);
}

/* Room for one more part. */
static int grow(struct work *work, struct gsn_error *err)
{
    const size_t room = 2 * work->room + 64;
    struct gsn_cell_part *part;
    size_t *heap;

    if (work->count < work->room)
        return GSN_OK;
    part = gsn_realloc_array(work->part, room, sizeof *part);
    if (part)
        work->part = part;
    heap = gsn_realloc_array(work->heap, room, sizeof *heap);
    if (heap)
        work->heap = heap;
    if (!part || !heap)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu parts of a cell", room);
    work->room = room;
    return GSN_OK;
}

static int halve_widest(struct work *work, struct gsn_error *err)
{
    struct gsn_cell_part whole;
    size_t place;
    int r = grow(work, err);

    if (r < 0)
        return r;
    place = pop(work);
    whole = work->part[place];
    gsn_cell_part_halve(&whole, work->threshold, 0, &work->part[place]);
    gsn_cell_part_halve(&whole, work->threshold, 1, &work->part[work->count++]);
    offer(work, place);
    offer(work, work->count - 1);
    return GSN_OK;
}

/* Adds up; what the parts do not cover may be above the threshold or not. */
static void add_up(const struct work *work, struct gsn_volume_bound *ret_bound)
{
    struct gsn_sum lower = { 0.0, 0.0 }, upper = { 0.0, 0.0 }, covered = { 0.0, 0.0 };
    double missing;

    for (size_t i = 0; i < work->count; i++) {
        gsn_sum_add(&lower, work->part[i].lower);
        gsn_sum_add(&upper, work->part[i].upper);
        gsn_sum_add(&covered, work->part[i].volume);
    }
    missing = fmax(0.0, work->volume - (covered.value + covered.rest));
    *ret_bound = (struct gsn_volume_bound){
        .threshold = work->threshold,
        .lower_um3 = fmax(0.0, lower.value + lower.rest - work->slack),
        .upper_um3 = fmin(work->volume, upper.value + upper.rest + missing) + work->slack,
        .cells = work->count,
    };
}

static int refine(struct work *work, double wanted, struct gsn_volume_bound *ret_bound,
                  struct gsn_error *err)
{
    for (size_t next = work->count;;) {
        int r;

        /* Adding up takes as long as there are parts: now and then will do. */
        if (work->count >= next || work->open == 0) {
            add_up(work, ret_bound);
            next = work->count + work->count / 16 + 1;
            if (ret_bound->upper_um3 - ret_bound->lower_um3 <=
                wanted * fmax(ret_bound->upper_um3, 0.01 * work->volume))
                return GSN_OK;
        }
        if (work->count >= work->most || work->open == 0)
            break;
        r = halve_widest(work, err);
        if (r < 0)
            return r;
    }
    add_up(work, ret_bound);
    return GSN_OK;
}

/* Whether the boxes around some points and around the cell overlap; touching counts. */
static int is_near(const struct work *work, const double (*point)[3], size_t count,
                   const uint32_t *cloud, size_t per_cloud)
{
    for (int a = 0; a < 3; a++) {
        double low = INFINITY, high = -INFINITY, least = INFINITY, most = -INFINITY;

        for (size_t i = 0; i < 4 * count; i++) {
            const double at = point[cloud[i / count] * per_cloud + i % count][a];

            low = fmin(low, at);
            high = fmax(high, at);
        }
        for (int k = 0; k < 4; k++) {
            least = fmin(least, work->cell.corner[k][a]);
            most = fmax(most, work->cell.corner[k][a]);
        }
        if (low > most || high < least)
            return 0;
    }
    return 1;
}

/* gives: the tetrahedra with a knot box that meets the cell's, ascending. */
static int find_near(const struct work *work, uint32_t **ret_near, size_t *ret_count,
                     struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(work->space);
    const size_t cloud = gsn_dms_degree(work->space) + 1U;
    uint32_t *near;
    size_t count = 0;

    for (int writes = 0;; writes = 1) {
        near = writes ? gsn_alloc_array(count, sizeof *near) : NULL;
        if (writes && !near)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
        count = 0;
        for (size_t t = 0; t < mesh->tet_count; t++) {
            if (!is_near(work, gsn_dms_knots(work->space), cloud, mesh->tet[t], cloud))
                continue;
            if (writes)
                near[count] = (uint32_t)t;
            count++;
        }
        if (writes)
            break;
    }
    *ret_near = near;
    *ret_count = count;
    return GSN_OK;
}

/* Makes parts of what the cell and the skin's tetrahedron have in common. */
static int add_parts(struct work *work, const struct gsn_skin *skin,
                     const struct gsn_tet_parts *common, struct gsn_error *err)
{
    for (size_t i = 0; i < common->count; i++) {
        const int r = grow(work, err);

        if (r < 0)
            return r;
        gsn_cell_part_make(skin, &common->cell[i], work->threshold, &work->part[work->count++]);
        offer(work, work->count - 1);
    }
    return GSN_OK;
}

static int add_tet(struct work *work, const uint32_t *near, size_t count, uint32_t tet,
                   struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(work->space);
    struct gsn_tet_parts common = { 0 };
    struct gsn_tet_cell home;
    int r;

    for (int k = 0; k < 4; k++)
        memcpy(home.corner[k], mesh->vertex[mesh->tet[tet][k]], sizeof home.corner[k]);
    r = gsn_tet_cell_common(&work->cell, &home, crumb * work->volume, &common, err);
    if (r == GSN_OK && common.count > 0)
        r = gsn_skin_new(work->spline, tet, near, count, &work->skin[work->skins], err);
    if (r == GSN_OK && common.count > 0)
        r = add_parts(work, work->skin[work->skins++], &common, err);
    gsn_free(common.cell);
    return r;
}

static int cut_by_mesh(struct work *work, struct gsn_error *err)
{
    gsn_auto_mem(uint32_t) near = NULL;
    double covered = 0.0;
    size_t count = 0;
    int r = find_near(work, &near, &count, err);

    if (r < 0)
        return r;
    work->skin = gsn_alloc_array(count, sizeof(struct gsn_skin *));
    if (!work->skin)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    for (size_t i = 0; r == GSN_OK && i < count; i++)
        r = add_tet(work, near, count, near[i], err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < work->count; i++)
        covered += work->part[i].volume;
    if (work->volume - covered > fmax(work->slack, most_missing * work->volume))
        return gsn_fail(err, GSN_E_INPUT,
                        "the cell sticks out of the mesh with %.3g of its volume of %.6g um^3",
                        (work->volume - covered) / work->volume, work->volume);
    return GSN_OK;
}

static double surface(const struct gsn_tet_cell *cell)
{
    double sum = 0.0;

    for (int k = 0; k < 4; k++) {
        const double *a = cell->corner[(k + 1) % 4];
        double b[3], c[3], normal[3];

        gsn_subtract(cell->corner[(k + 2) % 4], a, b);
        gsn_subtract(cell->corner[(k + 3) % 4], a, c);
        gsn_cross(b, c, normal);
        sum += 0.5 * sqrt(gsn_dot(normal, normal));
    }
    return sum;
}

/* Sets the cell's volume and slack. */
static int check_cell(struct work *work, struct gsn_error *err)
{
    double reach = 0.0, rounding;

    if (!isfinite(work->threshold))
        return gsn_fail(err, GSN_E_INPUT, "the threshold is not a number");
    for (int k = 0; k < 4; k++) {
        for (int a = 0; a < 3; a++) {
            if (!isfinite(work->cell.corner[k][a]))
                return gsn_fail(err, GSN_E_INPUT, "corner %d of the cell is not a point", k + 1);
            reach = fmax(reach, fabs(work->cell.corner[k][a]));
        }
    }
    work->volume = gsn_tet_cell_volume(&work->cell);
    rounding = cut_slack * reach * surface(&work->cell);
    work->slack = sum_slack * work->volume + rounding;
    if (!isfinite(work->slack))
        return gsn_fail(err, GSN_E_INPUT, "the cell is too large to have a volume");
    if (!(work->volume > rounding))
        return gsn_fail(err, GSN_E_INPUT, "the cell is flat");
    return GSN_OK;
}

int gsn_level_set_cell(const struct gsn_spline *spline, const double cell[4][3], double threshold,
                       const struct gsn_level_set_cell_options *options,
                       struct gsn_volume_bound *ret_bound, struct gsn_error *err)
{
    static const struct gsn_level_set_cell_options plain = { 0 };
    struct work work = { .spline = spline,
                         .space = gsn_spline_space(spline),
                         .threshold = threshold };
    struct gsn_volume_bound bound = { 0 };
    int r;

    if (!options)
        options = &plain;
    work.most = options->most_cells > 0 ? options->most_cells : default_cells;
    memcpy(work.cell.corner, cell, sizeof work.cell.corner);
    r = check_cell(&work, err);
    if (r == GSN_OK)
        r = cut_by_mesh(&work, err);
    if (r == GSN_OK)
        r = refine(&work, options->gap > 0.0 ? options->gap : default_gap, &bound, err);
    work_done(&work);
    if (r < 0)
        return r;
    *ret_bound = bound;
    return GSN_OK;
}
