/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The polynomial that a spline is in each tetrahedron, made ready to be bounded on boxes.
 *
 * Method: the polynomial as a tensor of monomials, moved to a box and turned into tensor Bernstein
 * form, whose coefficients enclose it; the gradient's coefficients beside it, which are those of a
 * simplex spline of one degree less when control points are shared.
 * Reference: J. Garloff, "Convergent bounds for the range of multivariate polynomials", LNCS 212,
 * 1986; docs/MATH.md, section 6.
 *
 * Steps: (1) Bernstein coefficients of the tetrahedron to monomials; (2) bounds of what is not this
 * polynomial, from the spline; (3) coefficients of the gradient and where their functions live; (4)
 * on a box: shift, scale, convert, take the extremes; all with slack above the rounding.
 *
 * Failure: GSN_E_NOMEM while making; bounds never fail, they get wide.
 * Cost: some hundred operations a box and tetrahedron. */
#include "pipeline/measure/local_polynomial.h"

#include <math.h>
#include <string.h>

/* Barycentric coordinates are sums of four products of order one: their rounding is some 1e-15. A
 * box this much nearer than it seems is looked at too. */
#define LAMBDA_SLACK 1e-12

/* A value on a box is some hundred operations away from the Bernstein coefficients, each with a
 * relative rounding of 1.1e-16 of terms no larger than the sizes kept: 1e-12 of their sum is more
 * than all of it. */
#define VALUE_SLACK 1e-12

/* Place of x^i y^j z^k among the monomials of degree n. */
static inline size_t monomial_place(unsigned n, unsigned i, unsigned j, unsigned k)
{
    return (i * (n + 1U) + j) * (n + 1U) + k;
}

/* Barycentric coordinate k of a point. */
static inline double barycentric_at(const struct gsn_local_polynomial *piece, int k,
                                    const double u[3])
{
    double lambda = 0.25;

    for (int a = 0; a < 3; a++)
        lambda += piece->lambda[k][a] * ((u[a] - piece->origin[a]) / piece->scale);
    return lambda;
}

/* --- making --- */

/* product = product * (c0 + c . x), degrees known to stay <= n. */
static void times_linear(unsigned n, double *product, double c0, const double c[3])
{
    for (unsigned i = n + 1; i-- > 0;) {
        for (unsigned j = n + 1 - i; j-- > 0;) {
            for (unsigned k = n + 1 - i - j; k-- > 0;) {
                double value = c0 * product[monomial_place(n, i, j, k)];

                if (i > 0)
                    value += c[0] * product[monomial_place(n, i - 1, j, k)];
                if (j > 0)
                    value += c[1] * product[monomial_place(n, i, j - 1, k)];
                if (k > 0)
                    value += c[2] * product[monomial_place(n, i, j, k - 1)];
                product[monomial_place(n, i, j, k)] = value;
            }
        }
    }
}

/* lambda[k] and the frame they live in. */
static void place_frame(struct gsn_local_polynomial *piece, const struct gsn_tets *mesh, size_t tet)
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
static void expand_monomials(struct gsn_local_polynomial *piece, const struct gsn_dms *space,
                             const double *bernstein)
{
    static const double factorial[GSN_LOCAL_POLYNOMIAL_SIDE] = { 1.0, 1.0, 2.0, 6.0 };
    const unsigned n = piece->degree;

    memset(piece->monomial, 0, sizeof piece->monomial);
    memset(piece->size, 0, sizeof piece->size);
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        const uint8_t *beta = gsn_dms_beta(space, f);
        double term[GSN_LOCAL_POLYNOMIAL_TERMS] = { 0.0 },
               major[GSN_LOCAL_POLYNOMIAL_TERMS] = { 0.0 };
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
                    piece->monomial[monomial_place(n, i, j, k)] += term[monomial_place(n, i, j, k)];
                    piece->size[i + j + k] += major[monomial_place(n, i, j, k)];
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
static void least_lambda(const struct gsn_local_polynomial *piece, const struct gsn_dms *space,
                         size_t tet, const unsigned upto[4], double ret_least[4])
{
    for (int k = 0; k < 4; k++) {
        ret_least[k] = INFINITY;
        for (int j = 0; j < 4; j++) {
            for (unsigned l = 0; l <= upto[j]; l++)
                ret_least[k] =
                    fmin(ret_least[k], barycentric_at(piece, k, knot_of(space, tet, j, l)));
        }
    }
}

/* Inward: a knot of a boundary face on the inner side of its plane. The cancelling of the terms
 * that lack a cloud stops at the boundary; those terms live on the hulls of such faces' knots. */
static int points_inward(const struct gsn_local_polynomial *piece, const struct gsn_dms *space,
                         size_t tet)
{
    for (int k = 0; k < 4; k++) {
        if (gsn_dms_mesh(space)->neighbour[tet][k] >= 0)
            continue;
        for (int j = 0; j < 4; j++) {
            for (unsigned l = 0; j != k && l <= piece->degree; l++) {
                if (barycentric_at(piece, k, knot_of(space, tet, j, l)) > LAMBDA_SLACK)
                    return 1;
            }
        }
    }
    return 0;
}

size_t gsn_local_polynomial_slopes(const struct gsn_dms *space)
{
    /* binomial(n + 2, 3) of binomial(n + 3, 3) */
    const unsigned n = gsn_dms_degree(space);

    return gsn_dms_functions(space) * n / (n + 3U);
}

/* The function g + e_j. */
static size_t raised_index(const struct gsn_dms *space, const unsigned g[4], int j)
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
static void make_caps(const double (*knot)[3], double det_x,
                      struct gsn_local_polynomial_slope *slope)
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
            cap[3] += VALUE_SLACK * det_x * (1.0 / z[p] - 1.0 / z[r]);
            slope->caps++;
        }
    }
}

/* The knots of the function g of degree 1 in the piece's own coordinates. */
static void cap_slope(const struct gsn_dms *space, size_t tet,
                      const struct gsn_local_polynomial *piece, const unsigned g[4],
                      struct gsn_local_polynomial_slope *slope)
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

static void make_slope(const struct gsn_spline *spline, size_t tet,
                       const struct gsn_local_polynomial *piece, const unsigned g[4],
                       struct gsn_local_polynomial_slope *ret_slope)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const uint32_t *control = gsn_dms_control_ids(space, tet);
    const double *point[4];
    double value[4];

    for (int a = 0; a < 3; a++)
        ret_slope->node[a] = 0.0;
    for (int j = 0; j < 4; j++) {
        point[j] = knot_of(space, tet, j, g[j]);
        value[j] = piece->degree * gsn_spline_controls(spline)[control[raised_index(space, g, j)]];
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

static void make_slopes(const struct gsn_spline *spline, size_t tet,
                        const struct gsn_local_polynomial *piece,
                        struct gsn_local_polynomial_slope *ret_slope)
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

void gsn_local_polynomial_make(const struct gsn_spline *spline, size_t tet,
                               struct gsn_local_polynomial_slope *ret_slope,
                               struct gsn_local_polynomial *ret_piece)
{
    const struct gsn_dms *space = gsn_spline_space(spline);
    const unsigned n = gsn_dms_degree(space), all[4] = { n, n, n, n };
    double bernstein[GSN_DMS_MAX_FUNCTIONS];
    double slack = 0.0;

    ret_piece->degree = n;
    place_frame(ret_piece, gsn_dms_mesh(space), tet);
    gsn_dms_core(space, tet, ret_piece->delta);
    least_lambda(ret_piece, space, tet, all, ret_piece->least);
    ret_piece->inward = points_inward(ret_piece, space, tet);
    gsn_spline_residual(spline, tet, &ret_piece->residual_low, &ret_piece->residual_high);
    gsn_spline_bernstein(spline, tet, bernstein);
    expand_monomials(ret_piece, space, bernstein);
    make_slopes(spline, tet, ret_piece, ret_slope);
    ret_piece->slope = ret_slope;

    ret_piece->whole_low = ret_piece->whole_high = bernstein[0];
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        ret_piece->whole_low = fmin(ret_piece->whole_low, bernstein[f]);
        ret_piece->whole_high = fmax(ret_piece->whole_high, bernstein[f]);
        slack = fmax(slack, VALUE_SLACK * fabs(bernstein[f]));
    }
    ret_piece->whole_low += ret_piece->residual_low - slack;
    ret_piece->whole_high += ret_piece->residual_high + slack;
}

/* --- bounding on boxes --- */

double gsn_local_polynomial_depth(const struct gsn_local_polynomial *piece, const double u[3])
{
    double depth = INFINITY;

    for (int k = 0; k < 4; k++)
        depth = fmin(depth, barycentric_at(piece, k, u));
    return depth;
}

/* Whether lambda_k rises to least[k] or more somewhere in the box, for every k by itself. */
static int rises_to(const struct gsn_local_polynomial *piece, const double least[4],
                    const struct gsn_aabb *box)
{
    const double scale = 1.0 / piece->scale;

    for (int k = 0; k < 4; k++) {
        double most = 0.25;

        for (int a = 0; a < 3; a++)
            most += piece->lambda[k][a] * ((box->centre[a] - piece->origin[a]) * scale) +
                    fabs(piece->lambda[k][a]) * (box->half[a] * scale);
        if (most < least[k] - LAMBDA_SLACK)
            return 0;
    }
    return 1;
}

int gsn_local_polynomial_reaches(const struct gsn_local_polynomial *piece,
                                 const struct gsn_aabb *box)
{
    return rises_to(piece, piece->least, box);
}

double gsn_local_polynomial_slope_weight(const struct gsn_local_polynomial *piece,
                                         const struct gsn_local_polynomial_slope *slope,
                                         const struct gsn_aabb *box)
{
    const double scale = 1.0 / piece->scale;
    double weight = 1.0;

    if (!rises_to(piece, slope->least, box))
        return 0.0;
    for (unsigned i = 0; i < slope->caps; i++) {
        const double *cap = slope->cap[i];
        double most = cap[3];

        for (int a = 0; a < 3; a++)
            most += cap[a] * ((box->centre[a] - piece->origin[a]) * scale) +
                    fabs(cap[a]) * (box->half[a] * scale);
        weight = fmin(weight, most);
    }
    return fmax(0.0, weight);
}

enum gsn_local_polynomial_touch gsn_local_polynomial_meets(const struct gsn_local_polynomial *piece,
                                                           const struct gsn_aabb *box)
{
    const double scale = 1.0 / piece->scale;
    int in_core = 1;

    for (int k = 0; k < 4; k++) {
        double middle = 0.25, reach = 0.0;

        for (int a = 0; a < 3; a++) {
            middle += piece->lambda[k][a] * ((box->centre[a] - piece->origin[a]) * scale);
            reach += fabs(piece->lambda[k][a]) * (box->half[a] * scale);
        }
        if (middle + reach < -LAMBDA_SLACK)
            return GSN_LOCAL_POLYNOMIAL_APART;
        if (middle - reach <= piece->delta[k] + LAMBDA_SLACK)
            in_core = 0;
    }
    return in_core ? GSN_LOCAL_POLYNOMIAL_COVERS : GSN_LOCAL_POLYNOMIAL_TOUCHES;
}

/* The coefficients of one line of the tensor about x0, for steps of w: Horner's rule, repeated. */
static void shift_line(double *first, size_t stride, unsigned degree, double x0, double w)
{
    double power = w;

    for (unsigned r = 0; r < degree; r++) {
        for (unsigned i = degree; i-- > r;)
            first[i * stride] += x0 * first[(i + 1) * stride];
    }
    for (unsigned i = 1; i <= degree; i++) {
        first[i * stride] *= power;
        power *= w;
    }
}

/* The piece as a polynomial in the box's own t in [-1,1]^3. */
static void shift_to_box(const struct gsn_local_polynomial *piece, const struct gsn_aabb *box,
                         double *ret_term)
{
    const unsigned n = piece->degree;
    const size_t stride[3] = { (n + 1U) * (n + 1U), n + 1U, 1 };

    memcpy(ret_term, piece->monomial, (n + 1U) * (n + 1U) * (n + 1U) * sizeof *ret_term);
    for (int a = 0; a < 3; a++) {
        const double x0 = (box->centre[a] - piece->origin[a]) / piece->scale;
        const double w = box->half[a] / piece->scale;
        const size_t down = stride[(a + 1) % 3], across = stride[(a + 2) % 3];

        for (unsigned i = 0; i <= n; i++) {
            for (unsigned j = 0; i + j <= n; j++)
                shift_line(ret_term + i * down + j * across, stride[a], n - i - j, x0, w);
        }
    }
}

void gsn_local_polynomial_tangent(const struct gsn_local_polynomial *piece,
                                  const struct gsn_aabb *box,
                                  struct gsn_local_polynomial_linear *ret_linear,
                                  struct gsn_local_polynomial_bend *ret_bend)
{
    const unsigned n = piece->degree;
    double term[GSN_LOCAL_POLYNOMIAL_TERMS];

    shift_to_box(piece, box, term);
    *ret_linear = (struct gsn_local_polynomial_linear){
        .value = term[0],
        .slope = { term[monomial_place(n, 1, 0, 0)], term[monomial_place(n, 0, 1, 0)],
                   term[monomial_place(n, 0, 0, 1)] },
    };
    *ret_bend = (struct gsn_local_polynomial_bend){ { 0.0 }, { 0.0 } };
    if (n >= 2)
        *ret_bend = (struct gsn_local_polynomial_bend){
            .square = { term[monomial_place(n, 2, 0, 0)], term[monomial_place(n, 0, 2, 0)],
                        term[monomial_place(n, 0, 0, 2)] },
            .cross = { term[monomial_place(n, 0, 1, 1)], term[monomial_place(n, 1, 0, 1)],
                       term[monomial_place(n, 1, 1, 0)] },
        };
    for (unsigned i = 0; i <= n; i++) {
        for (unsigned j = 0; i + j <= n; j++) {
            for (unsigned k = 0; i + j + k <= n; k++) {
                const double size = i + j + k > 1 ? fabs(term[monomial_place(n, i, j, k)]) : 0.0;

                ret_linear->bend[0] += i > 0 ? size : 0.0;
                ret_linear->bend[1] += j > 0 ? size : 0.0;
                ret_linear->bend[2] += k > 0 ? size : 0.0;
            }
        }
    }
}

/* One line from powers of t in [-1,1] to Bernstein coefficients. */
static void bernstein_line(double *c, size_t stride, unsigned n)
{
    const double a0 = c[0], a1 = c[stride];

    if (n == 1) {
        c[0] = a0 - a1;
        c[stride] = a0 + a1;
    } else if (n == 2) {
        const double a2 = c[2 * stride];

        c[0] = a0 - a1 + a2;
        c[stride] = a0 - a2;
        c[2 * stride] = a0 + a1 + a2;
    } else {
        const double a2 = c[2 * stride], a3 = c[3 * stride];

        c[0] = a0 - a1 + a2 - a3;
        c[stride] = a0 - (a1 + a2) / 3.0 + a3;
        c[2 * stride] = a0 + (a1 - a2) / 3.0 - a3;
        c[3 * stride] = a0 + a1 + a2 + a3;
    }
}

/* More than the rounding in any coefficient of the piece on this box. */
static double rounding_bound(const struct gsn_local_polynomial *piece, const struct gsn_aabb *box)
{
    double reach = 0.0, sum = 0.0;

    for (int a = 0; a < 3; a++)
        reach = fmax(reach, fabs(box->centre[a] - piece->origin[a]) + box->half[a]);
    reach /= piece->scale;
    for (unsigned d = piece->degree + 1; d-- > 0;)
        sum = sum * reach + piece->size[d];
    return VALUE_SLACK * sum;
}

void gsn_local_polynomial_bound(const struct gsn_local_polynomial *piece,
                                const struct gsn_aabb *box,
                                const struct gsn_local_polynomial_linear *linear, double *ret_low,
                                double *ret_high)
{
    const unsigned n = piece->degree;
    const size_t side = n + 1U, stride[3] = { side * side, side, 1 };
    double term[GSN_LOCAL_POLYNOMIAL_TERMS], low = INFINITY, high = -INFINITY;
    double square_low = 0.0, square_high = 0.0, slack = rounding_bound(piece, box);

    shift_to_box(piece, box, term);
    term[0] -= linear->value;
    slack += VALUE_SLACK * fabs(linear->value);
    for (int a = 0; a < 3; a++) {
        term[stride[a]] -= linear->slope[a];
        slack += VALUE_SLACK * fabs(linear->slope[a]);
        /* t^2 is in [0,1]; its Bernstein hull would say [-1,1]. */
        if (n >= 2) {
            square_low += fmin(0.0, term[2 * stride[a]]);
            square_high += fmax(0.0, term[2 * stride[a]]);
            term[2 * stride[a]] = 0.0;
        }
    }
    for (int a = 0; a < 3; a++) {
        for (size_t i = 0; i < side; i++) {
            for (size_t j = 0; j < side; j++)
                bernstein_line(term + i * stride[(a + 1) % 3] + j * stride[(a + 2) % 3], stride[a],
                               n);
        }
    }
    for (size_t i = 0; i < side * side * side; i++) {
        low = fmin(low, term[i]);
        high = fmax(high, term[i]);
    }
    *ret_low = low + square_low - slack;
    *ret_high = high + square_high + slack;
}
