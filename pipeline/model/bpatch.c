/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/bpatch.h"

#include "pipeline/model/frame.h"
#include "pipeline/model/simplex_sets.h"

#include <string.h>

/* The frame of X_gamma. */
static void frame_of(unsigned degree, const double (*knot)[3], const uint8_t gamma[4],
                     struct gsn_frame *ret)
{
    const double *x[4];

    for (unsigned k = 0; k < 4; k++)
        x[k] = knot[k * (degree + 1) + gamma[k]];
    (void)gsn_frame_init(ret, x[0], x[1], x[2], x[3]);
}

static size_t raised(const uint8_t gamma[4], unsigned j)
{
    uint8_t beta[4];

    memcpy(beta, gamma, sizeof beta);
    beta[j]++;
    return gsn_simplex_place(beta);
}

/* The last step of the polar form in the direction of axis c instead of u, times n. */
static void add_gradient(const struct gsn_frame *frame, const uint8_t gamma[4], double weight,
                         double (*gradient)[3])
{
    for (int c = 0; c < 3; c++) {
        double rest = 0;

        for (unsigned j = 1; j < 4; j++) {
            gradient[raised(gamma, j)][c] += weight * frame->row[j - 1][c];
            rest -= frame->row[j - 1][c];
        }
        gradient[raised(gamma, 0)][c] += weight * rest;
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
        struct gsn_frame frame;
        double lambda[4];

        memset(upper, 0, sizeof upper);
        do {
            const double value = lower[gsn_simplex_place(gamma)];

            frame_of(degree, knot, gamma, &frame);
            gsn_frame_at(&frame, u, lambda);
            for (unsigned j = 0; j < 4; j++)
                upper[raised(gamma, j)] += lambda[j] * value;
            if (ret_gradient && r + 1 == degree)
                add_gradient(&frame, gamma, degree * value, ret_gradient);
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

        /* In place: gamma comes at or before every gamma + e_j, and those after it are still the
         * old ones. */
        do {
            struct gsn_frame frame;
            double lambda[4], sum = 0;

            frame_of(degree, knot, gamma, &frame);
            gsn_frame_at(&frame, arg[r - 1], lambda);
            for (unsigned j = 0; j < 4; j++)
                sum += lambda[j] * value[raised(gamma, j)];
            value[gsn_simplex_place(gamma)] = sum;
        } while (gsn_simplex_next(gamma));
    }
    return value[0];
}

void gsn_bpatch_bernstein(unsigned degree, const double (*knot)[3], const double *control,
                          const double *const corner[4], double *ret_coefficient)
{
    uint8_t beta[4] = { (uint8_t)degree, 0, 0, 0 };

    do {
        const double *arg[GSN_SIMPLEX_MAX_DEGREE];
        unsigned n = 0;

        for (unsigned k = 0; k < 4; k++) {
            for (unsigned l = 0; l < beta[k]; l++)
                arg[n++] = corner[k];
        }
        ret_coefficient[gsn_simplex_place(beta)] = gsn_bpatch_polar(degree, knot, control, arg);
    } while (gsn_simplex_next(beta));
}
