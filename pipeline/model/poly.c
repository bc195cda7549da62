/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/poly.h"

#include "pipeline/model/simplex_sets.h"

#include <string.h>

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

static void subtract(const struct differences *of, unsigned degree, int axis, double *b)
{
    for (unsigned i = of->count[degree]; i-- > 0;)
        b[gsn_simplex_raised[of->place[i]][axis]] -= b[of->place[i]];
}

void gsn_poly_of_bernstein(unsigned degree, const double *bernstein, double *ret_coefficient)
{
    const size_t count = gsn_simplex_count(degree);

    memcpy(ret_coefficient, bernstein, count * sizeof *ret_coefficient);
    for (int axis = 1; axis < 4; axis++) {
        subtract(&first_order, degree, axis, ret_coefficient);
        subtract(&second_order[axis - 1], degree, axis, ret_coefficient);
        if (degree == 3)
            ret_coefficient[gsn_simplex_raised[third_order[axis - 1]][axis]] -=
                ret_coefficient[third_order[axis - 1]];
    }
    for (size_t i = 0; i < count; i++)
        ret_coefficient[i] *= times[degree][i];
}
