/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much of a tetrahedral cell is above a threshold, with bounds that are guaranteed.
 *
 * Method: branch and bound on equation (10) where it is stated, on a tetrahedron. A part inside one
 * tetrahedron of the mesh has a polynomial in Bernstein form plus what its boundary layer adds
 * (boundary_layer.h); the linear function through its corners plus the extremes of the rest
 * encloses both, and half-spaces cut out of tetrahedra have a closed form. Reference: docs/MATH.md,
 * section 6.
 *
 * Steps: (1) cut the cell along the faces of the mesh (tet_cut.h); (2) bound each part; (3) halve
 * the one with the largest difference across an edge, from a heap, until the sum of the differences
 * is small enough or the parts are spent.
 *
 * Failure: GSN_E_INPUT when the cell is flat or sticks out of the mesh, GSN_E_NOMEM. When the parts
 * are spent the bounds are true but wider than wanted.
 * Cost: the difference falls like the reciprocal of the number of parts. */
#include "pipeline/measure/level_set_cell.h"

#include "pipeline/measure/boundary_layer.h"
#include "pipeline/measure/sum.h"
#include "pipeline/model/bpatch.h"
#include "pipeline/model/barycentric.h"
#include "pipeline/model/simplex_spline.h"

#include <float.h>
#include <math.h>
#include <string.h>

/* borrows skin. Volumes in um^3. */
struct cell_part {
    struct gsn_tet_cell at;
    const struct gsn_boundary_layer *skin;
    double coefficient[GSN_DMS_MAX_FUNCTIONS]; /* of the polynomial, over this part */
    double volume, lower, upper;
    uint8_t level, edge[2]; /* how often halved, and the edge to halve next */
};

/* --- a part of the cell --- */

static double linear_at(const uint8_t beta[4], const double corner[4], unsigned degree)
{
    double sum = 0.0;

    for (int k = 0; k < 4; k++)
        sum += beta[k] * corner[k];
    return sum / degree;
}

/* p on a part, less the threshold: within low..high of the linear function with these corner
 * values, and within least..most. */
struct linear {
    double corner[4], low, high, least, most;
};

static struct linear linear_of(const struct gsn_boundary_layer *skin, const double *coefficient,
                               double threshold)
{
    const struct gsn_dms *space = gsn_spline_space(skin->spline);
    struct linear linear = { { 0.0 }, 0.0, 0.0, INFINITY, -INFINITY };

    for (int k = 0; k < 4; k++) {
        uint8_t beta[4] = { 0, 0, 0, 0 };

        beta[k] = (uint8_t)skin->degree;
        linear.corner[k] = coefficient[gsn_simplex_place(beta)] - threshold;
    }
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const double value = coefficient[f] - threshold;
        const double rest = value - linear_at(gsn_dms_beta(space, f), linear.corner, skin->degree);

        linear.low = fmin(linear.low, rest);
        linear.high = fmax(linear.high, rest);
        linear.least = fmin(linear.least, value);
        linear.most = fmax(linear.most, value);
    }
    return linear;
}

/* Narrows the part's shares by one bound of what is to be added to p. */
static void narrow_shares(const struct linear *linear, const struct gsn_boundary_layer_bound *bound,
                          double *lower, double *upper)
{
    double low[4], high[4];

    for (int k = 0; k < 4; k++) {
        low[k] = linear->corner[k] + bound->corner[k] + linear->low + bound->low;
        high[k] = linear->corner[k] + bound->corner[k] + linear->high + bound->high;
    }
    *lower = fmax(*lower, gsn_tet_share_above(low));
    *upper = fmin(*upper, gsn_tet_share_above(high));
}

static double square_length(const struct gsn_tet_cell *cell, int i, int j)
{
    double edge[3];

    gsn_subtract(cell->corner[i], cell->corner[j], edge);
    return gsn_dot(edge, edge);
}

/* The largest second difference of the coefficients along an edge. */
static double largest_bend(const struct cell_part *part, int i, int j)
{
    uint8_t g[4] = { (uint8_t)(part->skin->degree - 2U), 0, 0, 0 };
    double most = 0.0;

    do {
        double value[3];

        for (int s = 0; s < 3; s++) {
            uint8_t beta[4];

            memcpy(beta, g, sizeof beta);
            beta[i] = (uint8_t)(beta[i] + 2 - s);
            beta[j] = (uint8_t)(beta[j] + s);
            value[s] = part->coefficient[gsn_simplex_place(beta)];
        }
        most = fmax(most, fabs(value[0] - 2.0 * value[1] + value[2]));
    } while (gsn_simplex_next(g));
    return most;
}

/* Across the strongest bend; where the gap is not bend, parts are to get smaller all round. */
static void choose_edge(int bent, struct cell_part *part)
{
    double best = -1.0;

    for (uint8_t i = 0; i < 4; i++) {
        for (uint8_t j = (uint8_t)(i + 1); j < 4; j++) {
            const double size = bent ? largest_bend(part, i, j) : square_length(&part->at, i, j);

            if (size > best) {
                best = size;
                part->edge[0] = i;
                part->edge[1] = j;
            }
        }
    }
}

/* Finds the part's volumes, and its edge. */
static void measure_part(struct cell_part *part, double threshold)
{
    static const double nothing[GSN_DMS_MAX_FUNCTIONS] = { 0.0 };
    const struct gsn_boundary_layer *skin = part->skin;
    const int clear = gsn_boundary_layer_clear(skin, &part->at);
    const struct linear linear =
        linear_of(skin, clear || skin->whole ? part->coefficient : nothing, threshold);
    struct gsn_boundary_layer_bound by_values = { .low = -skin->slack, .high = skin->slack },
                                    by_slopes;
    const size_t reach = clear ? 0 : gsn_boundary_layer_by_values(skin, &part->at, &by_values);
    double lower = 0.0, upper = 1.0, width;

    narrow_shares(&linear, &by_values, &lower, &upper);
    if (linear.least + by_values.low > 0.0)
        lower = 1.0;
    if (linear.most + by_values.high <= 0.0)
        upper = 0.0;
    width = by_values.high - by_values.low;
    if (reach > 0 && upper > lower && gsn_boundary_layer_by_slopes(skin, &part->at, &by_slopes)) {
        narrow_shares(&linear, &by_slopes, &lower, &upper);
        width = fmin(width, by_slopes.high - by_slopes.low);
    }
    choose_edge(skin->degree > 1 && linear.high - linear.low > width, part);
    /* Both are true; rounding may cross them by a little, which the slack of the sum covers. */
    part->lower = fmin(lower, upper) * part->volume;
    part->upper = fmax(lower, upper) * part->volume;
}

static void make_part(const struct gsn_boundary_layer *skin, const struct gsn_tet_cell *at,
                      double threshold, struct cell_part *ret_part)
{
    const double *const corner[4] = { at->corner[0], at->corner[1], at->corner[2], at->corner[3] };

    *ret_part = (struct cell_part){ .at = *at, .skin = skin };
    gsn_bpatch_bernstein(skin->degree, (const double(*)[3])skin->knot, skin->control, corner,
                         ret_part->coefficient);
    ret_part->volume = gsn_tet_cell_volume(at);
    measure_part(ret_part, threshold);
}

/* One corner goes to the middle of the edge: coefficient beta is the mean of those with some of
 * beta_move given to keep, weighted by the binomials. */
/* The half that keeps the end 0 or 1 of the part's edge. */
static void halve_part(const struct cell_part *part, double threshold, int end,
                       struct cell_part *ret_half)
{
    static const double binomial[4][4] = { { 1 }, { 1, 1 }, { 1, 2, 1 }, { 1, 3, 3, 1 } };
    const struct gsn_dms *space = gsn_spline_space(part->skin->spline);
    const int keep = part->edge[end], move = part->edge[1 - end];

    *ret_half = *part;
    for (int a = 0; a < 3; a++)
        ret_half->at.corner[move][a] =
            0.5 * part->at.corner[keep][a] + 0.5 * part->at.corner[move][a];
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        uint8_t beta[4];
        const uint8_t *whole = gsn_dms_beta(space, f);
        double sum = 0.0;

        memcpy(beta, whole, sizeof beta);
        for (uint8_t s = 0; s <= whole[move]; s++) {
            beta[move] = s;
            beta[keep] = (uint8_t)(whole[keep] + whole[move] - s);
            sum += binomial[whole[move]][s] * part->coefficient[gsn_simplex_place(beta)];
        }
        ret_half->coefficient[f] = ldexp(sum, -whole[move]);
    }
    ret_half->volume = 0.5 * part->volume;
    ret_half->level++;
    measure_part(ret_half, threshold);
}

/* --- the cell --- */

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
    struct cell_part *part; /* count, room */
    size_t *heap;           /* open of them: parts that can be halved, widest first */
    size_t skins;
    struct gsn_boundary_layer **skin;
};

static void work_done(struct work *work)
{
    for (size_t i = 0; i < work->skins; i++)
        gsn_boundary_layer_free(work->skin[i]);
    gsn_free(work->skin);
    gsn_free(work->part);
    gsn_free(work->heap);
}

static double gap_of(const struct work *work, size_t part)
{
    return work->part[part].upper - work->part[part].lower;
}

/* Puts a part into its place in the heap, from the end upward. */
static void push_part(struct work *work, size_t part)
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
static size_t pop_widest(struct work *work)
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

static void offer_part(struct work *work, size_t part)
{
    if (gap_of(work, part) > 0.0 && work->part[part].level < MOST_LEVELS)
        push_part(work, part);
}

/* Room for one more part. */
static int grow_heap(struct work *work, struct gsn_error *err)
{
    const size_t room = 2 * work->room + 64;
    struct cell_part *part;
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
    struct cell_part whole;
    size_t place;
    int r = grow_heap(work, err);

    if (r < 0)
        return r;
    place = pop_widest(work);
    whole = work->part[place];
    halve_part(&whole, work->threshold, 0, &work->part[place]);
    halve_part(&whole, work->threshold, 1, &work->part[work->count++]);
    offer_part(work, place);
    offer_part(work, work->count - 1);
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

static int refine_parts(struct work *work, double wanted, struct gsn_volume_bound *ret_bound,
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
static int add_parts(struct work *work, const struct gsn_boundary_layer *skin,
                     const struct gsn_tet_parts *common, struct gsn_error *err)
{
    for (size_t i = 0; i < common->count; i++) {
        const int r = grow_heap(work, err);

        if (r < 0)
            return r;
        make_part(skin, &common->cell[i], work->threshold, &work->part[work->count++]);
        offer_part(work, work->count - 1);
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
        r = gsn_boundary_layer_new(work->spline, tet, near, count, &work->skin[work->skins], err);
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
    work->skin = gsn_alloc_array(count, sizeof(struct gsn_boundary_layer *));
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

static double cell_surface(const struct gsn_tet_cell *cell)
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
    rounding = cut_slack * reach * cell_surface(&work->cell);
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
        r = refine_parts(&work, options->gap > 0.0 ? options->gap : default_gap, &bound, err);
    work_done(&work);
    if (r < 0)
        return r;
    *ret_bound = bound;
    return GSN_OK;
}
