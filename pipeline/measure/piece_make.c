/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/measure/piece_parts.h"

#include <math.h>
#include <string.h>

/* product = product * (c0 + c . x), degrees known to stay <= n. */
static void times_linear(unsigned n, double *product, double c0, const double c[3])
{
    for (unsigned i = n + 1; i-- > 0;) {
        for (unsigned j = n + 1 - i; j-- > 0;) {
            for (unsigned k = n + 1 - i - j; k-- > 0;) {
                double value = c0 * product[gsn_piece_at(n, i, j, k)];

                if (i > 0)
                    value += c[0] * product[gsn_piece_at(n, i - 1, j, k)];
                if (j > 0)
                    value += c[1] * product[gsn_piece_at(n, i, j - 1, k)];
                if (k > 0)
                    value += c[2] * product[gsn_piece_at(n, i, j, k - 1)];
                product[gsn_piece_at(n, i, j, k)] = value;
            }
        }
    }
}

/* lambda[k] and the frame they live in. */
static void place(struct gsn_piece *piece, const struct gsn_tets *mesh, size_t tet)
{
    double corner[4][3], reach = 0.0, det = 0.0;

    for (int a = 0; a < 3; a++) {
        piece->origin[a] = 0.0;
        for (int k = 0; k < 4; k++)
            piece->origin[a] += 0.25 * mesh->vertex[mesh->tet[tet][k]][a];
    }
    for (int k = 0; k < 4; k++) {
        for (int a = 0; a < 3; a++) {
            corner[k][a] = mesh->vertex[mesh->tet[tet][k]][a] - piece->origin[a];
            reach = fmax(reach, fabs(corner[k][a]));
        }
    }
    piece->scale = reach;
    for (int k = 0; k < 4; k++) {
        const double *p = corner[(k + 1) % 4], *q = corner[(k + 2) % 4], *r = corner[(k + 3) % 4];
        const double e[3] = { q[0] - p[0], q[1] - p[1], q[2] - p[2] };
        const double f[3] = { r[0] - p[0], r[1] - p[1], r[2] - p[2] };
        const double g[3] = { e[1] * f[2] - e[2] * f[1], e[2] * f[0] - e[0] * f[2],
                              e[0] * f[1] - e[1] * f[0] };

        det = g[0] * (corner[k][0] - p[0]) + g[1] * (corner[k][1] - p[1]) +
              g[2] * (corner[k][2] - p[2]);
        for (int a = 0; a < 3; a++)
            piece->lambda[k][a] = g[a] / det * reach;
    }
}

/* The polynomial sum_f b_f (n! / beta!) lambda^beta as monomials, and the sizes of what was added:
 * the same sum with every factor made positive. */
static void expand(struct gsn_piece *piece, const struct gsn_dms *space, const double *bernstein)
{
    static const double factorial[GSN_PIECE_SIDE] = { 1.0, 1.0, 2.0, 6.0 };
    const unsigned n = piece->degree;

    memset(piece->monomial, 0, sizeof piece->monomial);
    memset(piece->size, 0, sizeof piece->size);
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        double term[GSN_PIECE_TERMS] = { 0.0 }, major[GSN_PIECE_TERMS] = { 0.0 };
        double weight = factorial[n];

        for (int k = 0; k < 4; k++)
            weight /= factorial[beta[k]];
        term[0] = bernstein[f] * weight;
        major[0] = fabs(term[0]);
        for (int k = 0; k < 4; k++) {
            const double positive[3] = { fabs(piece->lambda[k][0]), fabs(piece->lambda[k][1]),
                                         fabs(piece->lambda[k][2]) };

            for (unsigned power = 0; power < beta[k]; power++) {
                times_linear(n, term, 0.25, piece->lambda[k]);
                times_linear(n, major, 0.25, positive);
            }
        }
        for (unsigned i = 0; i <= n; i++) {
            for (unsigned j = 0; i + j <= n; j++) {
                for (unsigned k = 0; i + j + k <= n; k++) {
                    piece->monomial[gsn_piece_at(n, i, j, k)] += term[gsn_piece_at(n, i, j, k)];
                    piece->size[i + j + k] += major[gsn_piece_at(n, i, j, k)];
                }
            }
        }
    }
}

static const double *knot_of(const struct gsn_dms *space, size_t tet, int corner, unsigned l)
{
    const size_t vertex = gsn_dms_mesh(space)->tet[tet][corner];

    return gsn_dms_knots(space)[vertex * (gsn_dms_degree(space) + 1U) + l];
}

/* least[k] of the knots t_{j,0..upto[j]}. */
static void least_lambda(const struct gsn_piece *piece, const struct gsn_dms *space, size_t tet,
                         const unsigned upto[4], double ret_least[4])
{
    for (int k = 0; k < 4; k++) {
        ret_least[k] = INFINITY;
        for (int j = 0; j < 4; j++) {
            for (unsigned l = 0; l <= upto[j]; l++)
                ret_least[k] =
                    fmin(ret_least[k], gsn_piece_lambda(piece, k, knot_of(space, tet, j, l)));
        }
    }
}

/* Inward: a knot of a boundary face on the inner side of its plane. The cancelling of the terms
 * that lack a cloud stops at the boundary; those terms live on the hulls of such faces' knots. */
static int points_inward(const struct gsn_piece *piece, const struct gsn_dms *space, size_t tet)
{
    for (int k = 0; k < 4; k++) {
        if (gsn_dms_mesh(space)->neighbour[tet][k] >= 0)
            continue;
        for (int j = 0; j < 4; j++) {
            for (unsigned l = 0; j != k && l <= piece->degree; l++) {
                if (gsn_piece_lambda(piece, k, knot_of(space, tet, j, l)) > GSN_PIECE_LAMBDA_SLACK)
                    return 1;
            }
        }
    }
    return 0;
}

size_t gsn_piece_slopes(const struct gsn_dms *space)
{
    /* binomial(n + 2, 3) of binomial(n + 3, 3) */
    const unsigned n = gsn_dms_degree(space);

    return gsn_dms_functions(space) * n / (n + 3U);
}

/* The function g + e_j. */
static size_t raised(const struct gsn_dms *space, const unsigned g[4], int j)
{
    size_t f = 0;

    for (;; f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        int same = 1;

        for (int k = 0; k < 4; k++)
            same &= beta[k] == g[k] + (k == j ? 1U : 0U);
        if (same)
            return f;
    }
}

/* Gradient of the linear function with these values at these points. */
static void linear_gradient(const double *const point[4], const double value[4], double ret[3])
{
    double e[3][3], rise[3], det;

    for (int k = 0; k < 3; k++) {
        for (int a = 0; a < 3; a++)
            e[k][a] = point[k + 1][a] - point[0][a];
        rise[k] = value[k + 1] - value[0];
    }
    det = e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) -
          e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
          e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
    for (int a = 0; a < 3; a++) {
        const int m = (a + 1) % 3, n = (a + 2) % 3;

        ret[a] = 0.0;
        for (int k = 0; k < 3; k++) {
            const double *f = e[(k + 1) % 3], *g = e[(k + 2) % 3];

            ret[a] += rise[k] * (f[m] * g[n] - f[n] * g[m]) / det;
        }
    }
}

static double det_of(const double *const p[4])
{
    double e[3][3];

    for (int k = 0; k < 3; k++) {
        for (int a = 0; a < 3; a++)
            e[k][a] = p[k + 1][a] - p[0][a];
    }
    return e[0][0] * (e[1][1] * e[2][2] - e[1][2] * e[2][1]) -
           e[0][1] * (e[1][0] * e[2][2] - e[1][2] * e[2][0]) +
           e[0][2] * (e[1][0] * e[2][1] - e[1][1] * e[2][0]);
}

/* The five knots of a function of degree 1 without one of them. */
static void leave_out(const double (*knot)[3], int left, const double *ret[4])
{
    int count = 0;

    for (int r = 0; r < 5; r++) {
        if (r != left)
            ret[count++] = knot[r];
    }
}

/* lambda_r with respect to the four knots other than m, divided by the size of det_r. */
static void share_of(const double (*knot)[3], int m, int r, double det_r, double ret[4])
{
    const double *point[4];
    double value[4] = { 0.0, 0.0, 0.0, 0.0 };

    ret[0] = ret[1] = ret[2] = ret[3] = 0.0;
    if (r == m)
        return;
    leave_out(knot, m, point);
    value[r < m ? r : r - 1] = 1.0 / fabs(det_r);
    linear_gradient(point, value, ret);
    ret[3] = value[0];
    for (int a = 0; a < 3; a++)
        ret[3] -= ret[a] * point[0][a];
}

/* M of five knots in space is the length of a fibre: u has one convex combination of the knots for
 * every s in an interval, w + s z with z_r = +-det_r (the knots without r), and M(u) is its length,
 *
 *     min over z_p > 0 > z_r of w_p / |z_p| + w_r / |z_r|,    w = lambda(u) without the knot m:
 *
 * the least of at most six linear functions. The recurrence, in which every u is in exactly two of
 * the five tetrahedra, gives the same. */
static void make_caps(const double (*knot)[3], double det_x, struct gsn_piece_slope *slope)
{
    double z[5], largest = 0.0;
    int m = 0;

    slope->caps = 0;
    for (int r = 0; r < 5; r++) {
        const double *point[4];

        leave_out(knot, r, point);
        z[r] = (r % 2 ? -1.0 : 1.0) * det_of(point);
        if (fabs(z[r]) > largest) {
            largest = fabs(z[r]);
            m = r;
        }
    }
    for (int p = 0; p < 5; p++) {
        for (int r = 0; r < 5; r++) {
            double a[4], b[4], *cap = slope->cap[slope->caps];

            /* Signs that rounding could have made say nothing; a cap fewer is still true. */
            if (z[p] <= 1e-9 * largest || z[r] >= -1e-9 * largest)
                continue;
            share_of(knot, m, p, z[p], a);
            share_of(knot, m, r, z[r], b);
            for (int k = 0; k < 4; k++)
                cap[k] = det_x * (a[k] + b[k]);
            cap[3] += GSN_PIECE_VALUE_SLACK * det_x * (1.0 / z[p] - 1.0 / z[r]);
            slope->caps++;
        }
    }
}

/* The knots of the function g of degree 1 in the piece's own coordinates. */
static void cap_slope(const struct gsn_dms *space, size_t tet, const struct gsn_piece *piece,
                      const unsigned g[4], struct gsn_piece_slope *slope)
{
    double knot[5][3];
    const double *x[4];
    int count = 0;

    for (int j = 0; j < 4; j++) {
        for (unsigned l = 0; l <= g[j]; l++, count++) {
            for (int a = 0; a < 3; a++)
                knot[count][a] = (knot_of(space, tet, j, l)[a] - piece->origin[a]) / piece->scale;
        }
        x[j] = knot[count - 1];
    }
    make_caps((const double(*)[3])knot, fabs(det_of(x)), slope);
}

static void make_slope(const struct gsn_spline *spline, size_t tet, const struct gsn_piece *piece,
                       const unsigned g[4], struct gsn_piece_slope *ret_slope)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const uint32_t *control = gsn_dms_control_ids(space, tet);
    const double *point[4];
    double value[4];

    for (int a = 0; a < 3; a++)
        ret_slope->node[a] = 0.0;
    for (int j = 0; j < 4; j++) {
        point[j] = knot_of(space, tet, j, g[j]);
        value[j] = piece->degree * gsn_spline_controls(spline)[control[raised(space, g, j)]];
        for (unsigned l = 0; l < g[j]; l++) {
            for (int a = 0; a < 3; a++)
                ret_slope->node[a] += knot_of(space, tet, j, l)[a] / (piece->degree - 1U);
        }
    }
    linear_gradient(point, value, ret_slope->gradient);
    least_lambda(piece, space, tet, g, ret_slope->least);
    ret_slope->caps = 0;
    if (piece->degree == 2)
        cap_slope(space, tet, piece, g, ret_slope);
}

static void make_slopes(const struct gsn_spline *spline, size_t tet, const struct gsn_piece *piece,
                        struct gsn_piece_slope *ret_slope)
{
    const unsigned most = piece->degree - 1U;
    unsigned g[4];

    for (g[0] = 0; g[0] <= most; g[0]++) {
        for (g[1] = 0; g[0] + g[1] <= most; g[1]++) {
            for (g[2] = 0; g[0] + g[1] + g[2] <= most; g[2]++) {
                g[3] = most - g[0] - g[1] - g[2];
                make_slope(spline, tet, piece, g, ret_slope++);
            }
        }
    }
}

void gsn_piece_make(const struct gsn_spline *spline, size_t tet, struct gsn_piece_slope *ret_slope,
                    struct gsn_piece *ret_piece)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const unsigned n = gsn_dms_degree(space), all[4] = { n, n, n, n };
    double bernstein[GSN_DMS_MAX_FUNCTIONS];
    double slack = 0.0;

    ret_piece->degree = n;
    place(ret_piece, gsn_dms_mesh(space), tet);
    gsn_dms_core(space, tet, ret_piece->delta);
    least_lambda(ret_piece, space, tet, all, ret_piece->least);
    ret_piece->inward = points_inward(ret_piece, space, tet);
    gsn_spline_residual(spline, tet, &ret_piece->residual_low, &ret_piece->residual_high);
    gsn_spline_bernstein(spline, tet, bernstein);
    expand(ret_piece, space, bernstein);
    make_slopes(spline, tet, ret_piece, ret_slope);
    ret_piece->slope = ret_slope;

    ret_piece->whole_low = ret_piece->whole_high = bernstein[0];
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        ret_piece->whole_low = fmin(ret_piece->whole_low, bernstein[f]);
        ret_piece->whole_high = fmax(ret_piece->whole_high, bernstein[f]);
        slack = fmax(slack, GSN_PIECE_VALUE_SLACK * fabs(bernstein[f]));
    }
    ret_piece->whole_low += ret_piece->residual_low - slack;
    ret_piece->whole_high += ret_piece->residual_high + slack;
}
