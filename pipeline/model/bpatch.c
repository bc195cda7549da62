/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The polynomial of a tetrahedron in three forms: B-patch, Bernstein, monomials.
 *
 * Method: de Boor's algorithm for B-patches: affine combinations along X_gamma, degree by degree.
 * With all arguments equal it is a value, with arguments of one's own the polar form (blossom),
 * with corners as arguments the Bernstein coefficients. Monomials of the barycentric coordinates
 * are forward differences of Bernstein coefficients, which is what kernels run fastest on.
 * Reference: H.-P. Seidel, "Symmetric recursive algorithms for surfaces: B-patches and the de Boor
 * algorithm for polynomials over triangles", Constr. Approx. 7, 1991; docs/MATH.md, section 7.
 *
 * Failure: none; the caller guarantees that every X_gamma is a true tetrahedron.
 * Cost: 35 affine combinations and 15 determinants at degree 3. */
#include "pipeline/model/bpatch.h"

#include "pipeline/model/barycentric.h"
#include "pipeline/model/simplex_spline.h"

#include <string.h>

/* --- B-patches --- */

/* The frame of X_gamma. */
static void frame_of(unsigned degree, const double (*knot)[3], const uint8_t gamma[4],
                     struct gsn_barycentric *ret)
{
    const double *x[4];

    for (unsigned k = 0; k < 4; k++)
        x[k] = knot[k * (degree + 1) + gamma[k]];
    gsn_barycentric_init(ret, x[0], x[1], x[2], x[3]);
}

/* The last step of the polar form in the direction of axis c instead of u, times n. */
static void add_gradient(const struct gsn_barycentric *frame, const uint8_t raised[4],
                         double weight, double (*gradient)[3])
{
    for (int c = 0; c < 3; c++) {
        double rest = 0;

        for (unsigned j = 1; j < 4; j++) {
            gradient[raised[j]][c] += weight * frame->row[j - 1][c];
            rest -= frame->row[j - 1][c];
        }
        gradient[raised[0]][c] += weight * rest;
    }
}

void gsn_bpatch_basis(unsigned degree, const double (*knot)[3], const double u[3],
                      double *ret_value, double (*ret_gradient)[3])
{
    double lower[GSN_SIMPLEX_MAX_FUNCTIONS] = { 1 }, upper[GSN_SIMPLEX_MAX_FUNCTIONS];
    const size_t functions = gsn_simplex_count(degree);

    if (ret_gradient)
        memset(ret_gradient, 0, functions * sizeof *ret_gradient);
    for (unsigned r = 0; r < degree; r++) {
        uint8_t gamma[4] = { (uint8_t)r, 0, 0, 0 };
        struct gsn_barycentric frame;
        double lambda[4];

        memset(upper, 0, sizeof upper);
        do {
            const size_t place = gsn_simplex_place(gamma);
            const uint8_t *raised = gsn_simplex_raised[place];

            frame_of(degree, knot, gamma, &frame);
            gsn_barycentric_at(&frame, u, lambda);
            for (unsigned j = 0; j < 4; j++)
                upper[raised[j]] += lambda[j] * lower[place];
            if (ret_gradient && r + 1 == degree)
                add_gradient(&frame, raised, degree * lower[place], ret_gradient);
        } while (gsn_simplex_next(gamma));
        memcpy(lower, upper, sizeof lower);
    }
    memcpy(ret_value, lower, functions * sizeof *ret_value);
}

double gsn_bpatch_polar(unsigned degree, const double (*knot)[3], const double *control,
                        const double *const arg[])
{
    double value[GSN_SIMPLEX_MAX_FUNCTIONS];

    memcpy(value, control, gsn_simplex_count(degree) * sizeof *value);
    for (unsigned r = 1; r <= degree; r++) {
        uint8_t gamma[4] = { (uint8_t)(degree - r), 0, 0, 0 };

        /* In place: no gamma + e_j comes before gamma, and those after it are still the old
         * ones. */
        do {
            struct gsn_barycentric frame;
            const size_t place = gsn_simplex_place(gamma);
            double lambda[4], sum = 0;

            frame_of(degree, knot, gamma, &frame);
            gsn_barycentric_at(&frame, arg[r - 1], lambda);
            for (unsigned j = 0; j < 4; j++)
                sum += lambda[j] * value[gsn_simplex_raised[place][j]];
            value[place] = sum;
        } while (gsn_simplex_next(gamma));
    }
    return value[0];
}

/* Values after r steps, by the multi-index alpha, |alpha| = r, of the corners taken and by gamma.
 */
typedef double steps[GSN_SIMPLEX_MAX_FUNCTIONS][GSN_SIMPLEX_MAX_FUNCTIONS];

/* The next step for one gamma. The values are symmetric in the corners, so that any of those in
 * alpha may be the last one taken. */
static void step_values(unsigned r, const struct gsn_barycentric *frame,
                        const double *const corner[4], size_t gamma,
                        double (*from)[GSN_SIMPLEX_MAX_FUNCTIONS],
                        double (*to)[GSN_SIMPLEX_MAX_FUNCTIONS])
{
    const uint8_t *raised = gsn_simplex_raised[gamma];
    uint8_t alpha[4] = { (uint8_t)r, 0, 0, 0 };
    double lambda[4][4];

    for (int k = 0; k < 4; k++)
        gsn_barycentric_at(frame, corner[k], lambda[k]);
    do {
        const size_t place = gsn_simplex_place(alpha);
        const double *before;
        unsigned k = 0;

        while (alpha[k] == 0)
            k++;
        alpha[k]--;
        before = from[gsn_simplex_place(alpha)];
        alpha[k]++;
        to[place][gamma] = lambda[k][0] * before[raised[0]] + lambda[k][1] * before[raised[1]] +
                           lambda[k][2] * before[raised[2]] + lambda[k][3] * before[raised[3]];
    } while (gsn_simplex_next(alpha));
}

void gsn_bpatch_bernstein(unsigned degree, const double (*knot)[3], const double *control,
                          const double *const corner[4], double *ret_coefficient)
{
    const size_t functions = gsn_simplex_count(degree);
    double even[GSN_SIMPLEX_MAX_FUNCTIONS][GSN_SIMPLEX_MAX_FUNCTIONS];
    double odd[GSN_SIMPLEX_MAX_FUNCTIONS][GSN_SIMPLEX_MAX_FUNCTIONS];

    memcpy(even[0], control, functions * sizeof *control);
    for (unsigned r = 1; r <= degree; r++) {
        uint8_t gamma[4] = { (uint8_t)(degree - r), 0, 0, 0 };

        do {
            struct gsn_barycentric frame;

            frame_of(degree, knot, gamma, &frame);
            step_values(r, &frame, corner, gsn_simplex_place(gamma), r % 2 ? even : odd,
                        r % 2 ? odd : even);
        } while (gsn_simplex_next(gamma));
    }
    for (size_t f = 0; f < functions; f++)
        ret_coefficient[f] = (degree % 2 ? odd : even)[f][0];
}

double gsn_bernstein_at(unsigned degree, const double *coefficient,
                        const struct gsn_barycentric *frame, const double lambda[4],
                        double *ret_gradient)
{
    double value[GSN_SIMPLEX_MAX_FUNCTIONS], sum = 0;

    memcpy(value, coefficient, gsn_simplex_count(degree) * sizeof *value);
    /* De Casteljau, in place as above, down to the four values of a linear function. */
    for (unsigned r = degree - 1; r > 0; r--) {
        for (size_t place = 0; place < gsn_simplex_count(r); place++) {
            const uint8_t *raised = gsn_simplex_raised[place];

            value[place] = lambda[0] * value[raised[0]] + lambda[1] * value[raised[1]] +
                           lambda[2] * value[raised[2]] + lambda[3] * value[raised[3]];
        }
    }
    for (int k = 0; k < 4; k++)
        sum += lambda[k] * value[k];
    for (int c = 0; ret_gradient && c < 3; c++) {
        ret_gradient[c] = 0;
        for (int k = 0; k < 3; k++)
            ret_gradient[c] += degree * (value[k + 1] - value[0]) * frame->row[k][c];
    }
    return sum;
}

/* --- Bernstein form to monomials --- */

/* Along each axis, by order: the places that have a difference of that order less one, descending,
 * so that a place is taken from before it changes itself. */
struct differences {
    uint8_t count[4]; /* of them, by degree */
    uint8_t place[10];
};

static const struct differences first_order = { { 0, 1, 4, 10 }, { 0, 1, 2, 3, 4, 5, 6, 7, 8, 9 } };
static const struct differences second_order[3] = { { { 0, 0, 1, 4 }, { 1, 4, 5, 6 } },
                                                    { { 0, 0, 1, 4 }, { 2, 5, 7, 8 } },
                                                    { { 0, 0, 1, 4 }, { 3, 6, 8, 9 } } };
static const uint8_t third_order[3] = { 4, 7, 9 };

/* n!/(a! b! c! (n-a-b-c)!). */
static const double times[4][GSN_SIMPLEX_MAX_FUNCTIONS] = {
    { 1 },
    { 1, 1, 1, 1 },
    { 1, 2, 2, 2, 1, 2, 2, 1, 2, 1 },
    { 1, 3, 3, 3, 3, 6, 6, 3, 6, 3, 1, 3, 3, 3, 6, 3, 1, 3, 3, 1 },
};

static void subtract_axis(const struct differences *of, unsigned degree, int axis, double *b)
{
    for (unsigned i = of->count[degree]; i-- > 0;)
        b[gsn_simplex_raised[of->place[i]][axis]] -= b[of->place[i]];
}

void gsn_poly_of_bernstein(unsigned degree, const double *bernstein, double *ret_coefficient)
{
    const size_t count = gsn_simplex_count(degree);

    memcpy(ret_coefficient, bernstein, count * sizeof *ret_coefficient);
    for (int axis = 1; axis < 4; axis++) {
        subtract_axis(&first_order, degree, axis, ret_coefficient);
        subtract_axis(&second_order[axis - 1], degree, axis, ret_coefficient);
        if (degree == 3)
            ret_coefficient[gsn_simplex_raised[third_order[axis - 1]][axis]] -=
                ret_coefficient[third_order[axis - 1]];
    }
    for (size_t i = 0; i < count; i++)
        ret_coefficient[i] *= times[degree][i];
}
