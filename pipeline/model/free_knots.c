/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: variable projection (Golub and Pereyra 1973, 10.1137/0710036) with a block diagonal
 * Gauss-Newton direction and a step that is doubled or halved.
 *
 * Steps of gsn_free_knots(). 1. The fit with the knots as they are. 2. find_slopes(): the
 * derivative of the sum of squares by each knot (equation (6), knots.h), and for each vertex the
 * 3 x 3 matrix that the squares have by its place: a point with barycentric coordinate lambda there
 * moves against the field by lambda, so it is the sum of lambda^2 grad s grad s'. 3. Each vertex
 * moves with its cloud by that Newton step, but no farther than a share of the lowest height of
 * the tetrahedra around it: four vertices that come together then leave a tetrahedron more than
 * half of its height. 4. The fit again; a step is taken where the rms falls by more than LEAST of
 * itself, and halved otherwise. 5. The same for single knots of the clouds, within a share of the
 * distance to their vertex.
 *
 * Failure: as gsn_fit(); a space that is none only halves the step. Cost: a fit a trial, and a
 * derivative a sample and step. */
#include "pipeline/model/free_knots.h"

#include "pipeline/core/linalg.h"
#include "pipeline/model/barycentric.h"
#include "pipeline/model/dms_internal.h"
#include "pipeline/model/knots.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* A step that gains less is the last. */
static const double LEAST = 1e-3;
/* Of a height, and of a knot's distance to its vertex: how far one step goes. */
static const double OF_HEIGHT = 0.12, OF_CLOUD = 0.3;
enum { HALVINGS = 4 };

struct state {
    const struct gsn_samples *samples;
    const struct gsn_fit_options *fit;
    size_t vertices, each; /* knots a vertex */
    enum gsn_dms_sharing sharing;
    uint8_t *inner;     /* owned, as what follows; per vertex */
    double *height;     /* lowest around each vertex, um */
    double (*slope)[3]; /* of the sum of squares, per knot */
    double (*curve)[3][3];
    double (*step)[3];  /* per knot */
    double (*knots)[3]; /* that are tried */
    double (*place)[3]; /* of the vertices that are tried */
};

struct made {
    struct gsn_dms *space; /* owned */
    struct gsn_spline *spline;
    struct gsn_fit_report report;
};

static void made_done(struct made *made)
{
    gsn_spline_free(made->spline);
    gsn_dms_free(made->space);
    *made = (struct made){ .space = NULL };
}

static void state_done(struct state *s)
{
    gsn_free(s->inner);
    gsn_free(s->height);
    gsn_free(s->slope);
    gsn_free(s->curve);
    gsn_free(s->step);
    gsn_free(s->knots);
    gsn_free(s->place);
}

static int state_init(struct state *s, const struct gsn_dms *space, struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space);

    s->vertices = mesh->vertex_count;
    s->each = gsn_dms_degree(space) + 1;
    s->sharing = gsn_dms_sharing(space);
    s->inner = gsn_alloc_array(s->vertices, sizeof *s->inner);
    s->height = gsn_alloc_array(s->vertices, sizeof *s->height);
    s->slope = gsn_alloc_array(s->vertices * s->each, sizeof *s->slope);
    s->curve = gsn_alloc_array(s->vertices, sizeof *s->curve);
    s->step = gsn_alloc_array(s->vertices * s->each, sizeof *s->step);
    s->knots = gsn_alloc_array(s->vertices * s->each, sizeof *s->knots);
    s->place = gsn_alloc_array(s->vertices, sizeof *s->place);
    if (!s->inner || !s->height || !s->slope || !s->curve || !s->step || !s->knots || !s->place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the free knots of %zu vertices",
                        s->vertices);
    memset(s->inner, 1, s->vertices);
    for (size_t t = 0; t < mesh->tet_count; t++)
        for (size_t k = 0; k < 4; k++)
            for (size_t c = 0; mesh->neighbour[t][k] < 0 && c < 4; c++)
                if (c != k)
                    s->inner[mesh->tet[t][c]] = 0;
    return GSN_OK;
}

static double find_length(const double v[3])
{
    return sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]);
}

static void find_heights(struct state *s, const struct gsn_tets *mesh)
{
    for (size_t p = 0; p < s->vertices; p++)
        s->height[p] = INFINITY;
    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double height = 1 / gsn_dms_steepest(mesh, t);

        for (size_t k = 0; k < 4; k++)
            s->height[mesh->tet[t][k]] = fmin(s->height[mesh->tet[t][k]], height);
    }
}

static void add_sample(struct state *s, const struct made *at, size_t i, size_t *hint)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(at->space);
    const double *u = s->samples->at[i];
    const double weight = s->samples->weight ? s->samples->weight[i] : 1;
    const double target = s->samples->exact ? s->samples->exact[i] : (double)s->samples->value[i];
    struct gsn_dms_shape shape;
    double value, slope[3], lambda[4];

    if (weight == 0 || gsn_spline_eval(at->spline, u, hint, &value, slope) != GSN_OK)
        return;
    (void)gsn_knots_gradient_add(at->spline, u, hint, 2 * weight * (value - target), s->slope);
    gsn_dms_shape_of(at->space, *hint, &shape);
    gsn_barycentric_at(&shape.frame, u, lambda);
    for (size_t k = 0; k < 4; k++)
        for (size_t a = 0; a < 3; a++)
            for (size_t b = 0; b < 3; b++)
                s->curve[mesh->tet[*hint][k]][a][b] +=
                    2 * weight * lambda[k] * lambda[k] * slope[a] * slope[b];
}

static void find_slopes(struct state *s, const struct made *at)
{
    size_t hint = 0;

    memset(s->slope, 0, s->vertices * s->each * sizeof *s->slope);
    memset(s->curve, 0, s->vertices * sizeof *s->curve);
    for (size_t i = 0; i < s->samples->count; i++)
        add_sample(s, at, i, &hint);
}

/* -curve^-1 slope, no longer than most. Where the field hardly changes nothing is known. */
static void find_step(const double curve[3][3], double share, const double slope[3], double most,
                      double ret_step[3])
{
    const double trace = curve[0][0] + curve[1][1] + curve[2][2];
    double m[3][3], length;

    memcpy(m, curve, sizeof m);
    for (size_t a = 0; a < 3; a++) {
        for (size_t b = 0; b < 3; b++)
            m[a][b] *= share;
        m[a][a] += 0.05 * share * trace;
        ret_step[a] = -slope[a];
    }
    if (!(trace > 0) || gsn_solve_spd(&m[0][0], 3, 3, ret_step) < 0) {
        memset(ret_step, 0, 3 * sizeof *ret_step);
        return;
    }
    length = find_length(ret_step);
    for (size_t a = 0; a < 3 && length > most; a++)
        ret_step[a] *= most / length;
}

/* Each inner vertex, its cloud with it. */
static void find_vertex_steps(struct state *s, const struct made *at)
{
    find_heights(s, gsn_dms_mesh(at->space));
    for (size_t p = 0; p < s->vertices; p++) {
        double(*const step)[3] = &s->step[p * s->each];
        double slope[3] = { 0 };

        for (size_t l = 0; l < s->each; l++)
            for (size_t a = 0; a < 3; a++)
                slope[a] += s->slope[p * s->each + l][a];
        find_step((const double(*)[3])s->curve[p], 1, slope, OF_HEIGHT * s->height[p], step[0]);
        for (size_t l = 0; l < s->each; l++)
            for (size_t a = 0; a < 3; a++)
                step[l][a] = s->inner[p] ? step[0][a] : 0;
    }
}

/* Each knot but the vertex itself. A move of one of n + 1 moves the field about that much less. */
static void find_cloud_steps(struct state *s, const struct made *at)
{
    const double(*knots)[3] = gsn_dms_knots(at->space);
    const double share = 1 / pow((double)s->each, 2);

    for (size_t p = 0; p < s->vertices; p++)
        for (size_t l = 0; l < s->each; l++) {
            const size_t i = p * s->each + l, vertex = p * s->each;
            const double off[3] = { knots[i][0] - knots[vertex][0], knots[i][1] - knots[vertex][1],
                                    knots[i][2] - knots[vertex][2] };

            find_step((const double(*)[3])s->curve[p], share, s->slope[i],
                      OF_CLOUD * find_length(off), s->step[i]);
            if (!s->inner[p] || l == 0)
                memset(s->step[i], 0, sizeof s->step[i]);
        }
}

/* The fit after part of the step. 1 where it can be made, 0 where that is no space. */
static int try_step(struct state *s, const struct made *at, double part, struct made *ret_made,
                    struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(at->space);
    const double(*knots)[3] = gsn_dms_knots(at->space);
    gsn_auto(gsn_tets) moved = NULL;
    struct made made = { .space = NULL };
    struct gsn_error why = { 0 };
    int r;

    for (size_t i = 0; i < s->vertices * s->each; i++)
        for (size_t a = 0; a < 3; a++)
            s->knots[i][a] = knots[i][a] + part * s->step[i][a];
    for (size_t p = 0; p < s->vertices; p++)
        memcpy(s->place[p], s->knots[p * s->each], sizeof s->place[p]);
    r = gsn_tets_new((const double(*)[3])s->place, s->vertices, (const uint32_t(*)[4])mesh->tet,
                     mesh->tet_count, &moved, &why);
    if (r >= 0)
        r = gsn_dms_new(moved, (unsigned)s->each - 1, (const double(*)[3])s->knots, s->sharing,
                        &made.space, &why);
    if (r >= 0)
        r = gsn_fit(made.space, s->samples, s->fit, &made.spline, &made.report, NULL, NULL, &why);
    if (r >= 0) {
        *ret_made = made;
        return 1;
    }
    made_done(&made);
    if (r == GSN_E_MESH || r == GSN_E_FIT)
        return 0;
    *err = why;
    return r;
}

/* Steps of one kind. *ret_taken of them lowered the rms. */
static int take_steps(struct state *s, struct made *at,
                      void (*find)(struct state *, const struct made *), unsigned most,
                      unsigned *ret_taken, struct gsn_error *err)
{
    double part = 1;

    *ret_taken = 0;
    while (*ret_taken < most) {
        struct made next = { .space = NULL };
        int r = 0;

        find_slopes(s, at);
        find(s, at);
        for (int k = 0; k < HALVINGS && r == 0; k++) {
            r = try_step(s, at, part, &next, err);
            if (r > 0 && !(next.report.rms < (1 - LEAST) * at->report.rms)) {
                made_done(&next);
                r = 0;
            }
            if (r == 0)
                part *= 0.5;
        }
        if (r < 0)
            return r;
        if (r == 0)
            break;
        made_done(at);
        *at = next;
        *ret_taken += 1;
        part = fmin(2 * part, 1);
    }
    return GSN_OK;
}

int gsn_free_knots(const struct gsn_dms *space, const struct gsn_samples *samples,
                   const struct gsn_free_knots_options *options, struct gsn_dms **ret_space,
                   struct gsn_spline **ret_spline, struct gsn_free_knots_report *ret_report,
                   struct gsn_error *err)
{
    struct state s = { .samples = samples, .fit = &options->fit };
    struct gsn_free_knots_report report = { 0 };
    struct made at = { .space = NULL };
    int r;

    assert(space && samples && options && ret_space && ret_spline && ret_report);

    r = state_init(&s, space, err);
    if (r >= 0)
        r = gsn_dms_new(gsn_dms_mesh(space), gsn_dms_degree(space), gsn_dms_knots(space), s.sharing,
                        &at.space, err);
    if (r >= 0)
        r = gsn_fit(at.space, samples, &options->fit, &at.spline, &at.report, NULL, NULL, err);
    report.rms_fixed = at.report.rms;
    if (r >= 0)
        r = take_steps(&s, &at, find_vertex_steps, options->vertex_steps, &report.vertex_steps,
                       err);
    report.rms_vertices = at.report.rms;
    if (r >= 0)
        r = take_steps(&s, &at, find_cloud_steps, options->cloud_steps, &report.cloud_steps, err);
    state_done(&s);
    if (r < 0) {
        made_done(&at);
        return r;
    }
    report.fit = at.report;
    *ret_space = at.space;
    *ret_spline = at.spline;
    *ret_report = report;
    return GSN_OK;
}
