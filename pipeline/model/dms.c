/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The space of DMS splines over a tetrahedral mesh: what is known of it before any spline.
 *
 * Method: triangular B-splines of Dahmen, Micchelli and Seidel with one cloud of knots a vertex.
 * Reference: W. Dahmen, C. A. Micchelli, H.-P. Seidel, "Blossoming begets B-spline bases built
 * better by B-patches", Math. Comp. 59, 1992; docs/MATH.md, sections 1 and 7.
 *
 * Steps of making one: (1) check degree, knots and sizes, copy mesh and knots; (2) per tetrahedron
 * check that no X_beta folds over and find how far its knots reach, in its own barycentric
 * coordinates, rounded outwards; (3) number the control points: one per multiset of vertices when
 * they are shared, found by sorting; (4) a search tree over the boxes around all knots; (5) find
 * where all functions sum to one.
 *
 * Failure: GSN_E_MESH names the tetrahedron whose clouds are not valid; no space is made then.
 * Cost: n log n in the tetrahedra; 45 bytes and 4 a function are kept for each. */
#include "pipeline/model/dms.h"

#include "pipeline/model/dms_internal.h"
#include "pipeline/model/orient.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* --- the shape of one tetrahedron and its knots --- */

/* Determinants between these leave room for the products and quotients of two of them, of sets of
 * knots a hundred thousand times flatter too. Lengths may be from 1e-33 to 1e33. */
#define SMALLEST 1e-100
#define LARGEST 1e100

/* Every X_beta, |beta| <= degree, has the orientation of the tetrahedron itself. */
static int check_folds(unsigned degree, const double (*knot)[3], double whole, double margin,
                       struct gsn_error *err)
{
    for (unsigned r = 0; r <= degree; r++) {
        uint8_t beta[4] = { (uint8_t)r, 0, 0, 0 };

        do {
            const double *x[4];
            double det;

            for (unsigned k = 0; k < 4; k++)
                x[k] = knot[k * (degree + 1) + beta[k]];
            det = gsn_det(x[0], x[1], x[2], x[3]);
            if (!(det > margin * whole))
                return gsn_fail(err, GSN_E_MESH,
                                "the knots of its corners fold over (det X of beta %u %u %u %u is "
                                "%.3g of the tetrahedron's); smaller knot clouds are needed",
                                beta[0], beta[1], beta[2], beta[3], det / whole);
        } while (gsn_simplex_next(beta));
    }
    return GSN_OK;
}

/* Knots of one corner nearer to each other than this part of an edge, and yet apart, differ by too
 * few digits of their coordinates: values of the spline come out wrong in the fifth digit. */
static const double THINNEST = 1e-10;

static double distance_of(const double a[3], const double b[3])
{
    return hypot(hypot(a[0] - b[0], a[1] - b[1]), a[2] - b[2]);
}

static double shortest_edge(const double *const corner[4])
{
    double least = INFINITY;

    for (unsigned k = 1; k < 4; k++)
        for (unsigned l = 0; l < k; l++)
            least = fmin(least, distance_of(corner[k], corner[l]));
    return least;
}

static int check_thickness(unsigned degree, const double (*knot)[3], double edge,
                           struct gsn_error *err)
{
    for (unsigned k = 0; k < 4; k++)
        for (unsigned i = 1; i <= degree; i++)
            for (unsigned j = 0; j < i; j++) {
                const double apart =
                    distance_of(knot[k * (degree + 1) + i], knot[k * (degree + 1) + j]);

                if (apart > 0 && apart < THINNEST * edge)
                    return gsn_fail(err, GSN_E_MESH,
                                    "two knots of a corner are %.3g of an edge apart, less than "
                                    "%g is too thin for double precision: make the cloud larger, "
                                    "or the knots the same",
                                    apart / edge, THINNEST);
            }
    return GSN_OK;
}

void gsn_dms_measure(unsigned degree, const double (*knot)[3], struct gsn_dms_shape *shape)
{
    for (unsigned k = 0; k < 4; k++)
        shape->low[k] = shape->high[k] = 0;
    for (unsigned i = 0; i < 4 * (degree + 1); i++) {
        double lambda[4];

        gsn_barycentric_at(&shape->frame, knot[i], lambda);
        for (unsigned k = 0; k < 4; k++) {
            shape->low[k] = fmin(shape->low[k], lambda[k]);
            if (k != i / (degree + 1))
                shape->high[k] = fmax(shape->high[k], lambda[k]);
        }
    }
}

int gsn_dms_shape_init(unsigned degree, const double (*knot)[3], double margin, double widest,
                       struct gsn_dms_shape *ret_shape, struct gsn_error *err)
{
    const double *corner[4];
    double whole, wide;
    int r;

    for (unsigned k = 0; k < 4; k++)
        corner[k] = knot[k * (degree + 1)];
    whole = gsn_det(corner[0], corner[1], corner[2], corner[3]);
    if (!(whole > 0))
        return gsn_fail(err, GSN_E_MESH, "it is too flat for double precision");
    if (!(whole > SMALLEST && whole < LARGEST))
        return gsn_fail(
            err, GSN_E_MESH,
            "its volume, %g, is out of the range of what double precision can work with",
            whole / 6);
    r = check_folds(degree, knot, whole, margin, err);
    if (r >= 0)
        r = check_thickness(degree, knot, shortest_edge(corner), err);
    if (r < 0)
        return r;
    gsn_barycentric_init(&ret_shape->frame, corner[0], corner[1], corner[2], corner[3]);
    gsn_dms_measure(degree, knot, ret_shape);
    wide = ret_shape->high[0] + ret_shape->high[1] + ret_shape->high[2] + ret_shape->high[3];
    if (!(wide < widest))
        return gsn_fail(err, GSN_E_MESH,
                        "its knot clouds leave no core (sum of delta is %.3g, less than %.3g is "
                        "needed); smaller knot clouds are needed",
                        wide, widest);
    return GSN_OK;
}

void gsn_dms_shape_of(const struct gsn_dms *space, size_t tet, struct gsn_dms_shape *ret_shape)
{
    const struct gsn_tets *mesh = space->mesh;
    const uint32_t *v = mesh->tet[tet];

    gsn_barycentric_init(&ret_shape->frame, mesh->vertex[v[0]], mesh->vertex[v[1]],
                         mesh->vertex[v[2]], mesh->vertex[v[3]]);
    for (int k = 0; k < 4; k++) {
        ret_shape->low[k] = (double)space->reach[tet].low[k];
        ret_shape->high[k] = (double)space->reach[tet].high[k];
    }
}

unsigned gsn_dms_clear(const struct gsn_dms_shape *shape, const double lambda[4])
{
    unsigned clear = 0;

    for (unsigned k = 0; k < 4; k++) {
        if (lambda[k] > shape->high[k] + GSN_DMS_SLACK)
            clear |= 1u << k;
    }
    return clear;
}

int gsn_dms_is_general(const struct gsn_simplex_sets *sets, const double (*knot)[3])
{
    for (size_t s = sets->first[4]; s < sets->first[3]; s++) {
        const uint8_t *m = sets->set[s].member;

        if (gsn_orient3d(knot[m[0]], knot[m[1]], knot[m[2]], knot[m[3]]) == 0)
            return 0;
    }
    return 1;
}

/* --- numbers of shared control points --- */

/* A shared control point belongs to a multiset of vertices: vertex i_k taken beta_k times. That is
 * all its polar value depends on. Ascending; unused places are 0. */
struct key {
    uint32_t vertex[GSN_DMS_MAX_DEGREE];
    uint32_t function; /* functions * tetrahedron + function */
};

static int same_vertices(const struct key *a, const struct key *b)
{
    return memcmp(a->vertex, b->vertex, sizeof a->vertex) == 0;
}

static struct key key_of(const struct gsn_dms *space, size_t function)
{
    const uint32_t *v = space->mesh->tet[function / space->sets->functions];
    const uint8_t *beta = space->sets->beta[function % space->sets->functions];
    struct key key = { .function = (uint32_t)function };
    unsigned n = 0;

    for (unsigned k = 0; k < 4; k++) {
        for (unsigned l = 0; l < beta[k]; l++) {
            unsigned at = n++;

            for (; at > 0 && key.vertex[at - 1] > v[k]; at--)
                key.vertex[at] = key.vertex[at - 1];
            key.vertex[at] = v[k];
        }
    }
    return key;
}

/* Sorts by one place, leaving the order as it is among equals; start has a place for every vertex
 * and one more. */
static void sort_by(const struct key *from, struct key *to, size_t count, int place, size_t *start,
                    size_t vertices)
{
    size_t sum = 0;

    memset(start, 0, (vertices + 1) * sizeof *start);
    for (size_t i = 0; i < count; i++)
        start[from[i].vertex[place] + 1]++;
    for (size_t v = 0; v <= vertices; v++)
        start[v] = sum += start[v];
    for (size_t i = 0; i < count; i++)
        to[start[from[i].vertex[place]]++] = from[i];
}

/* Gives equal keys one number, in the order of the keys. */
static int number_shared(struct gsn_dms *space, size_t count, struct gsn_error *err)
{
    const size_t vertices = space->mesh->vertex_count;
    gsn_auto_mem(struct key) first = gsn_alloc_array(count, sizeof *first);
    gsn_auto_mem(struct key) second = gsn_alloc_array(count, sizeof *second);
    gsn_auto_mem(size_t) start = gsn_alloc_array(vertices + 1, sizeof *start);
    struct key *key = first, *other = second;

    if (!first || !second || !start)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu functions", count);
    for (size_t i = 0; i < count; i++)
        key[i] = key_of(space, i);
    for (int place = (int)space->degree - 1; place >= 0; place--) {
        struct key *const sorted = other;

        sort_by(key, sorted, count, place, start, vertices);
        other = key;
        key = sorted;
    }
    space->controls = 0;
    for (size_t i = 0; i < count; i++) {
        if (i == 0 || !same_vertices(&key[i - 1], &key[i]))
            space->controls++;
        space->id[key[i].function] = (uint32_t)(space->controls - 1);
    }
    return GSN_OK;
}

int gsn_dms_number(struct gsn_dms *space, struct gsn_error *err)
{
    const size_t count = space->mesh->tet_count * space->sets->functions;

    space->id = gsn_alloc_array(count, sizeof *space->id);
    if (!space->id)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu functions", count);
    if (space->sharing == GSN_DMS_SHARED)
        return number_shared(space, count, err);
    for (size_t i = 0; i < count; i++)
        space->id[i] = (uint32_t)i;
    space->controls = count;
    return GSN_OK;
}

/* --- whose functions reach where --- */

/* A tetrahedron, home, and those that reach it. */
struct search {
    const struct gsn_dms *space;
    size_t home;
    double corner[4][3];
    struct gsn_bvh_box box;
    struct gsn_barycentric frame;
    struct gsn_sorted_batch *ascent;
};

/* Which corner of a tetrahedron vertex v is; 4 when it is none. The coordinates of shared vertices
 * are exactly 0 and 1, however they round. */
static unsigned corner_of(const struct gsn_tets *mesh, size_t tet, uint32_t v)
{
    const uint32_t *corner = mesh->tet[tet];
    unsigned k = 0;

    while (k < 4 && corner[k] != v)
        k++;
    return k;
}

/* Whether a face plane of home has all knots of the other beyond it, or in it at shared vertices.
 */
static int is_beyond_home(const struct search *search, size_t other, const double (*knot)[3])
{
    const struct gsn_tets *mesh = search->space->mesh;
    const unsigned per_cloud = search->space->degree + 1;
    unsigned beyond = GSN_DMS_ALL;

    for (unsigned c = 0; c < 4; c++) {
        const unsigned shared = corner_of(mesh, search->home, mesh->tet[other][c]);

        if (shared < 4)
            beyond &= ~(1u << shared);
        for (unsigned i = c * per_cloud + (shared < 4); beyond && i < (c + 1) * per_cloud; i++) {
            double lambda[4];

            gsn_barycentric_at(&search->frame, knot[i], lambda);
            for (unsigned k = 0; k < 4; k++) {
                if (!(lambda[k] < -GSN_DMS_SLACK))
                    beyond &= ~(1u << k);
            }
        }
    }
    return beyond != 0;
}

/* Whether home lies all beyond the knots of the other, seen through one of the other's faces,
 * shared vertices apart where no knot is beyond that face. */
static int is_beyond_other(const struct search *search, size_t other)
{
    const struct gsn_tets *mesh = search->space->mesh;
    struct gsn_dms_shape shape;
    unsigned beyond = GSN_DMS_ALL;

    gsn_dms_shape_of(search->space, other, &shape);
    for (int i = 0; beyond && i < 4; i++) {
        const unsigned shared = corner_of(mesh, other, mesh->tet[search->home][i]);
        double lambda[4];

        gsn_barycentric_at(&shape.frame, search->corner[i], lambda);
        for (unsigned k = 0; k < 4; k++) {
            const int touches = shared < 4 && shared != k && shape.low[k] == 0;

            if (!touches && !(lambda[k] < shape.low[k] - GSN_DMS_SLACK))
                beyond &= ~(1u << k);
        }
    }
    return beyond != 0;
}

static int consider_other(void *context, uint32_t other)
{
    struct search *search = context;
    double own[GSN_SIMPLEX_MAX_KNOTS][3];
    const double(*knot)[3] = (const double(*)[3])own;
    struct gsn_bvh_box box;

    if (other == search->home)
        return gsn_sorted_batch_add(search->ascent, other);
    gsn_dms_gather(search->space, other, own);
    box = gsn_bvh_box_around(knot, 4 * (search->space->degree + 1));
    if (!gsn_bvh_box_meets(&box, &search->box) || is_beyond_home(search, other, knot) ||
        is_beyond_other(search, other))
        return 0;
    return gsn_sorted_batch_add(search->ascent, other);
}

void gsn_dms_reaching(const struct gsn_dms *space, size_t home, struct gsn_sorted_batch *ascent)
{
    struct search search = { .space = space, .home = home, .ascent = ascent };

    for (int k = 0; k < 4; k++)
        memcpy(search.corner[k], space->mesh->vertex[space->mesh->tet[home][k]],
               sizeof search.corner[k]);
    search.box = gsn_bvh_box_around((const double(*)[3])search.corner, 4);
    gsn_barycentric_init(&search.frame, search.corner[0], search.corner[1], search.corner[2],
                         search.corner[3]);
    (void)gsn_bvh_meeting(space->tree, &search.box, consider_other, &search);
}

/* Marks the corners of one boundary face that have a knot on its inner side. */
static void mark_leaks(const struct gsn_dms *space, size_t tet, unsigned corner, uint8_t *leaks)
{
    const struct gsn_tets *mesh = space->mesh;
    const size_t per_cloud = space->degree + 1;
    const double *at[4];
    uint32_t face[3];
    unsigned n = 0;
    int inner;

    for (unsigned k = 0; k < 4; k++) {
        if (k == corner)
            continue;
        at[n] = mesh->vertex[mesh->tet[tet][k]];
        face[n++] = mesh->tet[tet][k];
    }
    at[3] = mesh->vertex[mesh->tet[tet][corner]];
    inner = gsn_orient3d(at[0], at[1], at[2], at[3]);
    for (unsigned k = 0; k < 3; k++) {
        for (size_t l = 1; l < per_cloud; l++) {
            const double *knot = space->knot[face[k] * per_cloud + l];

            if (gsn_orient3d(at[0], at[1], at[2], knot) == inner)
                leaks[face[k]] = 1;
        }
    }
}

int gsn_dms_find_whole(struct gsn_dms *space, struct gsn_error *err)
{
    const struct gsn_tets *mesh = space->mesh;
    gsn_auto_mem(uint8_t) leaks = gsn_alloc_array(mesh->vertex_count, sizeof *leaks);

    space->whole = gsn_alloc_array(mesh->tet_count, sizeof *space->whole);
    if (!leaks || !space->whole)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", mesh->tet_count);
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (unsigned k = 0; k < 4; k++) {
            if (mesh->neighbour[t][k] < 0)
                mark_leaks(space, t, k, leaks);
        }
    }
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const uint32_t *v = mesh->tet[t];

        space->whole[t] = !(leaks[v[0]] || leaks[v[1]] || leaks[v[2]] || leaks[v[3]]);
    }
    return GSN_OK;
}

/* --- the space --- */

/* An X_beta smaller than this share of its tetrahedron counts as folded: near 0 the rounded
 * determinant could not tell, and B-patches divide by it. */
#define FOLD_MARGIN 1e-9

void gsn_dms_gather(const struct gsn_dms *space, size_t tet,
                    double ret_knot[GSN_SIMPLEX_MAX_KNOTS][3])
{
    const size_t per_cloud = space->degree + 1;

    for (size_t k = 0; k < 4; k++)
        memcpy(ret_knot[k * per_cloud], space->knot[space->mesh->tet[tet][k] * per_cloud],
               per_cloud * sizeof *space->knot);
}

static int check_input(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3],
                       struct gsn_error *err)
{
    if (degree < 1 || degree > GSN_DMS_MAX_DEGREE)
        return gsn_fail(err, GSN_E_INPUT, "degree %u: a simplex spline has degree 1 to %d", degree,
                        GSN_DMS_MAX_DEGREE);
    if (mesh->tet_count >= UINT32_MAX / GSN_DMS_MAX_FUNCTIONS)
        return gsn_fail(err, GSN_E_INPUT, "%zu tetrahedra are too many", mesh->tet_count);
    for (size_t i = 0; i < mesh->vertex_count * (degree + 1); i++) {
        for (int c = 0; c < 3; c++) {
            if (!isfinite(knots[i][c]))
                return gsn_fail(err, GSN_E_INPUT,
                                "knot %zu of vertex %zu has a coordinate that is not finite",
                                i % (degree + 1), i / (degree + 1));
        }
        if (i % (degree + 1) == 0 &&
            memcmp(knots[i], mesh->vertex[i / (degree + 1)], sizeof *knots) != 0)
            return gsn_fail(err, GSN_E_INPUT, "knot 0 of vertex %zu is not the vertex",
                            i / (degree + 1));
    }
    return GSN_OK;
}

static int copy_in(const struct gsn_tets *mesh, const double (*knots)[3], struct gsn_dms *space,
                   struct gsn_error *err)
{
    int r = gsn_tets_new((const double(*)[3])mesh->vertex, mesh->vertex_count,
                         (const uint32_t(*)[4])mesh->tet, mesh->tet_count, &space->mesh, err);

    if (r == GSN_OK)
        r = gsn_simplex_sets_new(space->degree, &space->sets, err);
    if (r < 0)
        return r;
    space->knot = gsn_memdup(knots, mesh->vertex_count * (space->degree + 1) * sizeof *knots);
    space->reach = gsn_alloc_array(mesh->tet_count, sizeof *space->reach);
    if (!space->knot || !space->reach)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the knots of %zu tetrahedra",
                        mesh->tet_count);
    return GSN_OK;
}

static float round_down(double x)
{
    const float nearest = (float)x;

    return (double)nearest > x ? nextafterf(nearest, -INFINITY) : nearest;
}

static struct gsn_dms_reach reach_of(const struct gsn_dms_shape *shape)
{
    struct gsn_dms_reach reach;

    for (int k = 0; k < 4; k++) {
        reach.low[k] = round_down(shape->low[k]);
        reach.high[k] = -round_down(-shape->high[k]);
    }
    return reach;
}

static int measure_tets(struct gsn_dms *space, struct gsn_error *err)
{
    const size_t count = space->mesh->tet_count;
    gsn_auto_mem(struct gsn_bvh_box) box = gsn_alloc_array(count, sizeof *box);

    if (!box)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu tetrahedra", count);
    for (size_t t = 0; t < count; t++) {
        const uint32_t *v = space->mesh->tet[t];
        double knot[GSN_SIMPLEX_MAX_KNOTS][3];
        struct gsn_dms_shape shape;
        int r;

        gsn_dms_gather(space, t, knot);
        r = gsn_dms_shape_init(space->degree, (const double(*)[3])knot, FOLD_MARGIN, 1, &shape,
                               err);
        if (r < 0)
            return gsn_fail_at(err, "tetrahedron %zu (vertices %u %u %u %u)", t, v[0], v[1], v[2],
                               v[3]);
        space->reach[t] = reach_of(&shape);
        box[t] = gsn_bvh_box_around((const double(*)[3])knot, 4 * (space->degree + 1));
    }
    return gsn_bvh_new(box, count, &space->tree, err);
}

int gsn_dms_new(const struct gsn_tets *mesh, unsigned degree, const double (*knots)[3],
                enum gsn_dms_sharing sharing, struct gsn_dms **ret_space, struct gsn_error *err)
{
    gsn_auto(gsn_dms) space = NULL;
    int r;

    assert(mesh && knots && ret_space);

    r = check_input(mesh, degree, knots, err);
    if (r < 0)
        return r;
    space = gsn_alloc_array(1, sizeof *space);
    if (!space)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a spline space");
    space->degree = degree;
    space->sharing = sharing;
    space->kernels = gsn_kernels_best();
    r = copy_in(mesh, knots, space, err);
    if (r == GSN_OK)
        r = measure_tets(space, err);
    if (r == GSN_OK)
        r = gsn_dms_number(space, err);
    if (r == GSN_OK)
        r = gsn_dms_find_whole(space, err);
    if (r < 0)
        return r;
    *ret_space = gsn_steal(&space);
    return GSN_OK;
}

void gsn_dms_free(struct gsn_dms *space)
{
    if (!space)
        return;
    gsn_tets_free(space->mesh);
    gsn_simplex_sets_free(space->sets);
    gsn_bvh_free(space->tree);
    gsn_free(space->knot);
    gsn_free(space->id);
    gsn_free(space->reach);
    gsn_free(space->whole);
    gsn_free(space);
}

void gsn_dms_use(struct gsn_dms *space, const struct gsn_kernels *kernels)
{
    space->kernels = kernels;
}

size_t gsn_dms_bytes(const struct gsn_dms *space)
{
    const struct gsn_tets *mesh = space->mesh;
    const struct gsn_simplex_sets *sets = space->sets;
    const size_t per_vertex = sizeof *mesh->vertex + (space->degree + 1) * sizeof *space->knot;
    const size_t per_tet = sizeof *mesh->tet + sizeof *mesh->neighbour +
                           sets->functions * sizeof *space->id + sizeof *space->reach +
                           sizeof *space->whole;
    const size_t table = sizeof *sets + GSN_SIMPLEX_MAX_SETS * sizeof *sets->set +
                         (sets->first[4] + 1) * sizeof *sets->quads +
                         sets->quads[sets->first[4]] * sizeof *sets->quad;

    return sizeof *space + sizeof *mesh + mesh->vertex_count * per_vertex +
           mesh->tet_count * per_tet + gsn_bvh_bytes(space->tree) + table;
}

const struct gsn_tets *gsn_dms_mesh(const struct gsn_dms *space)
{
    return space->mesh;
}

const double (*gsn_dms_knots(const struct gsn_dms *space))[3]
{
    return (const double(*)[3])space->knot;
}

unsigned gsn_dms_degree(const struct gsn_dms *space)
{
    return space->degree;
}

enum gsn_dms_sharing gsn_dms_sharing(const struct gsn_dms *space)
{
    return space->sharing;
}

size_t gsn_dms_functions(const struct gsn_dms *space)
{
    return space->sets->functions;
}

size_t gsn_dms_controls(const struct gsn_dms *space)
{
    return space->controls;
}

const uint32_t *gsn_dms_control_ids(const struct gsn_dms *space, size_t tet)
{
    return &space->id[tet * space->sets->functions];
}

const uint8_t *gsn_dms_beta(const struct gsn_dms *space, size_t function)
{
    return space->sets->beta[function];
}

void gsn_dms_core(const struct gsn_dms *space, size_t tet, double ret_delta[4])
{
    double knot[GSN_SIMPLEX_MAX_KNOTS][3];
    struct gsn_dms_shape shape;

    gsn_dms_gather(space, tet, knot);
    gsn_dms_shape_of(space, tet, &shape);
    gsn_dms_measure(space->degree, (const double(*)[3])knot, &shape);
    memcpy(ret_delta, shape.high, sizeof shape.high);
}
