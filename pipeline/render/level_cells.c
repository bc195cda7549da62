/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A mesh at whose corners every piece of a level set shows, so that marching it misses none.
 *
 * Method: where a piece lies in a tetrahedron, or passes through a face or an edge of it, and no
 * corner shows it, s is extreme somewhere in that tetrahedron, face or edge, and beyond the level.
 * Both are asked of the Bernstein coefficients there: s lies between the least and the largest of
 * them, and has no extremum where, along the direction of one edge, all their differences have one
 * sign. Where neither rules it out the tetrahedron is bisected; for a face or an edge only if the
 * piece may reach through it by more than the error allowed, by the slope between the corners.
 * The end of a region is a distance and no polynomial: there the solid is sampled, at points no
 * farther apart than the least cell or a sixteenth of this one, in cells that it may pass.
 * Reference: R. T. Farouki, "The Bernstein polynomial basis: a centennial retrospective", Computer
 * Aided Geometric Design 29, 2012; restriction to a smaller tetrahedron by blossoming.
 *
 * Steps: (1) the polynomial of each tetrahedron of the spline, without what its seams add; (2) each
 * cell of the refinement finds the tetrahedron that holds it, and its coefficients there;
 * (3) doubtful cells are halved, until there are none or they are small.
 *
 * Failure: GSN_E_NOMEM. Cost: the polynomials once a round, some thousand operations a
 * cell of a tetrahedron that the level may pass; no value of s. */
#include "pipeline/render/level_cells.h"

#include "pipeline/model/barycentric.h"
#include "pipeline/model/bisection.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { ORDER = GSN_DMS_MAX_DEGREE + 1, MOST_ROUNDS = 16 };

/* A doubtful cell is halved. */
static const double PART = 0.5;

/* Samples along an edge are no more than these: a bound of cost. */
enum { MOST_SAMPLES = 16 };

/* Rounding of a coefficient, relative to the largest. */
static const double SLACK = 1e-12;

/* A polynomial on a tetrahedron: coefficient [i][j][k] has the powers n - i - j - k, i, j, k of the
 * four barycentric coordinates. */
struct bernstein {
    unsigned degree;
    double at[ORDER][ORDER][ORDER];
};

/* s - level on one tetrahedron of the spline. What reaches beyond 0 by no more than slack may be
 * rounding: a face in the level, say. */
struct root {
    struct gsn_barycentric frame;
    struct bernstein polynomial;
    double slack;
};

/* --- polynomials --- */

static double *place_of(struct bernstein *p, const uint8_t beta[4])
{
    return &p->at[beta[1]][beta[2]][beta[3]];
}

/* One step of de Casteljau: the blossom with one argument more, the point lambda. */
static void blossom_step(struct bernstein *p, const double lambda[4])
{
    const unsigned n = --p->degree;

    for (unsigned i = 0; i <= n; i++)
        for (unsigned j = 0; i + j <= n; j++)
            for (unsigned k = 0; i + j + k <= n; k++)
                p->at[i][j][k] = lambda[0] * p->at[i][j][k] + lambda[1] * p->at[i + 1][j][k] +
                                 lambda[2] * p->at[i][j + 1][k] + lambda[3] * p->at[i][j][k + 1];
}

/* The polynomial on the smaller tetrahedron whose corners have these coordinates: coefficient beta
 * is the blossom at beta[0] times the first corner, and so on. */
static void restrict_polynomial(const struct bernstein *whole, const struct gsn_dms *space,
                                const double corner[4][4], struct bernstein *ret)
{
    ret->degree = whole->degree;
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *const beta = gsn_dms_beta(space, f);
        struct bernstein p = *whole;

        for (unsigned c = 0; c < 4; c++)
            for (unsigned times = 0; times < beta[c]; times++)
                blossom_step(&p, corner[c]);
        *place_of(ret, beta) = p.at[0][0][0];
    }
}

static void init_root(const struct gsn_spline *spline, double level, size_t tet, struct root *root)
{
    const struct gsn_dms *const space = gsn_spline_space(spline);
    const struct gsn_tets *const mesh = gsn_dms_mesh(space);
    const uint32_t *const v = mesh->tet[tet];
    double coefficient[GSN_DMS_MAX_FUNCTIONS];

    gsn_barycentric_init(&root->frame, mesh->vertex[v[0]], mesh->vertex[v[1]], mesh->vertex[v[2]],
                         mesh->vertex[v[3]]);
    gsn_spline_bernstein(spline, tet, coefficient);
    root->polynomial.degree = gsn_dms_degree(space);
    root->slack = 0;
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        *place_of(&root->polynomial, gsn_dms_beta(space, f)) = coefficient[f] - level;
        root->slack = fmax(root->slack, SLACK * (fabs(coefficient[f]) + fabs(level)));
    }
}

/* --- doubt --- */

static int lies_in(const uint8_t beta[4], unsigned corners)
{
    for (unsigned c = 0; c < 4; c++)
        if (beta[c] > 0 && !(corners >> c & 1))
            return 0;
    return 1;
}

/* Least and largest coefficient of the part with these corners. */
static void bound_part(struct bernstein *p, const struct gsn_dms *space, unsigned corners,
                       double *ret_low, double *ret_high)
{
    *ret_low = INFINITY;
    *ret_high = -INFINITY;
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *const beta = gsn_dms_beta(space, f);

        if (!lies_in(beta, corners))
            continue;
        *ret_low = fmin(*ret_low, *place_of(p, beta));
        *ret_high = fmax(*ret_high, *place_of(p, beta));
    }
}

/* Whether the derivative from corner a towards corner b has one sign in all of the part: each
 * coefficient that counts a is followed by the one that counts b in its stead. */
static int is_monotone(struct bernstein *p, const struct gsn_dms *space, unsigned corners,
                       unsigned a, unsigned b)
{
    int rises = 0, falls = 0;

    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *const beta = gsn_dms_beta(space, f);
        uint8_t moved[4];
        double step;

        if (!lies_in(beta, corners) || beta[a] == 0)
            continue;
        memcpy(moved, beta, sizeof moved);
        moved[a]--;
        moved[b]++;
        step = *place_of(p, moved) - *place_of(p, beta);
        rises |= step >= 0;
        falls |= step <= 0;
    }
    return !(rises && falls);
}

static int has_extremum(struct bernstein *p, const struct gsn_dms *space, unsigned corners)
{
    for (unsigned a = 0; a < 3; a++)
        for (unsigned b = a + 1; b < 4; b++)
            if ((corners >> a & 1) && (corners >> b & 1) && is_monotone(p, space, corners, a, b))
                return 0;
    return 1;
}

/* The corners at which the polynomial is at least 0, by their bits. */
static unsigned corners_above(struct bernstein *p)
{
    const unsigned n = p->degree;

    return (p->at[0][0][0] >= 0) | (unsigned)(p->at[n][0][0] >= 0) << 1 |
           (unsigned)(p->at[0][n][0] >= 0) << 2 | (unsigned)(p->at[0][0][n] >= 0) << 3;
}

/* The largest difference between corners. */
static double corner_range(struct bernstein *p)
{
    const unsigned n = p->degree;
    const double at[4] = { p->at[0][0][0], p->at[n][0][0], p->at[0][n][0], p->at[0][0][n] };
    const double low = fmin(fmin(at[0], at[1]), fmin(at[2], at[3])),
                 high = fmax(fmax(at[0], at[1]), fmax(at[2], at[3]));

    return high - low;
}

/* Whether the tetrahedron may hold a piece that its corners do not show, or a face or an edge may
 * be passed by one. bulge: of s, what it may be passed by; slack: what is rounding. */
static int is_doubtful(struct bernstein *p, const struct gsn_dms *space, double bulge, double slack)
{
    const unsigned above = corners_above(p);

    for (unsigned corners = 3; corners < 16; corners++) {
        const double least = corners == 15 ? slack : fmax(slack, bulge);
        double low, high;

        if ((corners & (corners - 1)) == 0 ||
            ((above & corners) != 0 && (above & corners) != corners))
            continue;
        bound_part(p, space, corners, &low, &high);
        if ((above & corners ? low < -least : high > least) && has_extremum(p, space, corners))
            return 1;
    }
    return 0;
}

/* --- where a region ends --- */

/* A cell, what is asked of it, and its polynomial. */
struct cell {
    const struct gsn_level *level;
    struct bernstein polynomial; /* s - level */
    double corner[4][3], longest_um;
};

/* The polynomial at barycentric coordinates. */
static double value_at(const struct bernstein *polynomial, const double lambda[4])
{
    struct bernstein p = *polynomial;

    while (p.degree > 0)
        blossom_step(&p, lambda);
    return p.at[0][0][0];
}

/* Whether the point is of the solid; share: barycentric. */
static int is_solid(const struct cell *cell, const double share[4])
{
    double u[3] = { 0, 0, 0 };

    for (unsigned c = 0; c < 4; c++)
        for (unsigned k = 0; k < 3; k++)
            u[k] += share[c] * cell->corner[c][k];
    return gsn_border_at(cell->level->border, u, NULL) >= 0 &&
           value_at(&cell->polynomial, share) >= 0;
}

/* Whether the region's border may be nearer to the cell's middle than its farthest corner. */
static int may_end_here(const struct cell *cell)
{
    double middle[3] = { 0, 0, 0 }, farthest = 0;

    for (unsigned c = 0; c < 4; c++)
        for (unsigned k = 0; k < 3; k++)
            middle[k] += cell->corner[c][k] / 4;
    for (unsigned c = 0; c < 4; c++) {
        double d[3];

        gsn_subtract(cell->corner[c], middle, d);
        farthest = fmax(farthest, gsn_dot(d, d));
    }
    return fabs(gsn_border_at(cell->level->border, middle, NULL)) <= sqrt(farthest);
}

/* Whether the corners are alike and a point between them is not, of points apart_um from each other
 * along the longest edge, or a sixteenth of it. */
static int hides_end(const struct cell *cell, double apart_um)
{
    const int n = (int)fmin(MOST_SAMPLES, ceil(cell->longest_um / apart_um));
    int solid = -1;

    if (!may_end_here(cell))
        return 0;
    for (unsigned c = 0; c < 4; c++) {
        const double share[4] = { c == 0, c == 1, c == 2, c == 3 };
        const int here = is_solid(cell, share);

        if (solid >= 0 && here != solid)
            return 0;
        solid = here;
    }
    for (int i = 0; i <= n; i++)
        for (int j = 0; i + j <= n; j++)
            for (int k = 0; i + j + k <= n; k++) {
                const double share[4] = { (double)(n - i - j - k) / n, (double)i / n, (double)j / n,
                                          (double)k / n };

                if (is_solid(cell, share) != solid)
                    return 1;
            }
    return 0;
}

/* --- rounds --- */

double gsn_cell_longest_edge(const struct gsn_tets *cells, size_t cell)
{
    double longest = 0;

    for (unsigned a = 0; a < 3; a++)
        for (unsigned b = a + 1; b < 4; b++) {
            double edge[3];

            gsn_subtract(cells->vertex[cells->tet[cell][a]], cells->vertex[cells->tet[cell][b]],
                         edge);
            longest = fmax(longest, gsn_dot(edge, edge));
        }
    return sqrt(longest);
}

/* The tetrahedron of the spline that holds the cell. */
static size_t find_root(const struct gsn_dms *space, const struct gsn_tets *cells, size_t cell,
                        size_t hint)
{
    double middle[3] = { 0, 0, 0 };
    size_t tet = hint;

    for (unsigned c = 0; c < 4; c++)
        for (unsigned k = 0; k < 3; k++)
            middle[k] += cells->vertex[cells->tet[cell][c]][k] / 4;
    (void)gsn_dms_locate(space, middle, hint, &tet);
    return tet;
}

/* What is asked of all cells. */
struct question {
    const struct gsn_level *level;
    double error_um, least_um;
};

static int ask_cell(const struct question *question, const struct gsn_tets *cells, size_t cell,
                    double longest_um, struct root *root)
{
    const struct gsn_dms *const space = gsn_spline_space(question->level->spline);
    struct cell asked = { .level = question->level, .longest_um = longest_um };
    double low, high, corner[4][4];

    bound_part(&root->polynomial, space, 15, &low, &high);
    if (high < 0 || (low >= 0 && !question->level->border))
        return 0;
    for (unsigned c = 0; c < 4; c++) {
        const double *const at = cells->vertex[cells->tet[cell][c]];

        gsn_barycentric_at(&root->frame, at, corner[c]);
        memcpy(asked.corner[c], at, sizeof asked.corner[c]);
    }
    restrict_polynomial(&root->polynomial, space, (const double(*)[4])corner, &asked.polynomial);
    if (low < 0 &&
        is_doubtful(&asked.polynomial, space,
                    question->error_um / longest_um * corner_range(&asked.polynomial), root->slack))
        return 1;
    return question->level->border && hides_end(&asked, question->least_um);
}

/* limit: of each cell's volume, 0 where it may stay. Returns how many may not. */
static size_t doubt_cells(const struct question *question, const struct gsn_tets *cells,
                          double *limit)
{
    const struct gsn_spline *const spline = question->level->spline;
    size_t doubtful = 0, tet = SIZE_MAX, hint = 0;
    struct root root;

    for (size_t cell = 0; cell < cells->tet_count; cell++) {
        const double longest = gsn_cell_longest_edge(cells, cell);

        limit[cell] = 0;
        if (longest <= question->least_um)
            continue;
        hint = find_root(gsn_spline_space(spline), cells, cell, hint);
        if (hint != tet)
            init_root(spline, question->level->level, hint, &root);
        tet = hint;
        if (!ask_cell(question, cells, cell, longest, &root))
            continue;
        limit[cell] = PART * gsn_tets_volume(cells, cell);
        doubtful++;
    }
    return doubtful;
}

/* One round; *ret_done: nothing was in doubt, and cells stays as it is. */
static int split_doubtful(const struct question *question, struct gsn_tets **cells, int *ret_done,
                          struct gsn_error *err)
{
    gsn_auto_mem(double) limit = gsn_alloc_array((*cells)->tet_count, sizeof *limit);
    struct gsn_tets *finer = NULL;
    int r;

    if (!limit)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a finer mesh");
    *ret_done = doubt_cells(question, *cells, limit) == 0;
    if (*ret_done)
        return GSN_OK;
    r = gsn_tets_bisect_behind(*cells, limit, &finer, err);
    if (r < 0)
        return r;
    gsn_tets_free(*cells);
    *cells = finer;
    return GSN_OK;
}

int gsn_level_cells(const struct gsn_level *level, double error_um, double least_um,
                    size_t most_cells, struct gsn_tets **ret_cells, struct gsn_error *err)
{
    const struct gsn_tets *const mesh = gsn_dms_mesh(gsn_spline_space(level->spline));
    const struct question question = { level, error_um, least_um };
    gsn_auto(gsn_tets) cells = NULL;
    int done = 0, r;

    assert(error_um >= 0 && least_um > 0);
    r = gsn_tets_new((const double(*)[3])mesh->vertex, mesh->vertex_count,
                     (const uint32_t(*)[4])mesh->tet, mesh->tet_count, &cells, err);
    for (int round = 0; r >= 0 && !done && round < MOST_ROUNDS && cells->tet_count <= most_cells;
         round++)
        r = split_doubtful(&question, &cells, &done, err);
    if (r < 0)
        return r;
    *ret_cells = gsn_steal(&cells);
    return GSN_OK;
}
