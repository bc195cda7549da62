/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the examples share: a cube cut into tetrahedra, numbers that look random, the end after a
 * failure. */
#ifndef CUBE_H
#define CUBE_H

#include <gieson-spline.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Ends the program with the sentence when a call failed. */
static inline void must(int r, const struct gsn_error *err)
{
    if (r < 0) {
        fprintf(stderr, "%s (%s)\n", err->text, gsn_code_name(r));
        exit(1);
    }
}

/* Ends the program when two numbers differ by more than this. */
static inline void same(const char *what, double a, double b, double most)
{
    if (!(fabs(a - b) <= most)) {
        fprintf(stderr, "%s: %.17g is not %.17g\n", what, a, b);
        exit(1);
    }
}

/* Between 0 and 1; the same ones in every run. */
static inline double drawn(void)
{
    static uint64_t state = 1;

    state = state * 6364136223846793005u + 1442695040888963407u;
    return (double)(state >> 11) / 9007199254740992.0;
}

/* The cube from 0 to 1, n cells along each edge, six tetrahedra a cell (Kuhn's). */
static inline struct gsn_space *cube_space(uint32_t n, unsigned degree)
{
    static const uint8_t way[6][3] = { { 0, 1, 2 }, { 0, 2, 1 }, { 1, 0, 2 },
                                       { 1, 2, 0 }, { 2, 0, 1 }, { 2, 1, 0 } };
    const struct gsn_space_options options = { .degree = degree };
    const size_t side = n + 1, points = side * side * side, tets = 6 * (size_t)n * n * n;
    double(*point)[3] = malloc(points * sizeof *point);
    uint32_t(*tet)[4] = malloc(tets * sizeof *tet);
    struct gsn_space *space = NULL;
    struct gsn_error err;

    if (!point || !tet)
        exit(1);
    for (size_t i = 0; i < points; i++) {
        point[i][0] = (double)(i % side) / n;
        point[i][1] = (double)(i / side % side) / n;
        point[i][2] = (double)(i / side / side) / n;
    }
    for (size_t t = 0; t < tets; t++) {
        const uint8_t *axis = way[t % 6];
        const uint32_t step[3] = { 1, (uint32_t)side, (uint32_t)(side * side) };
        const size_t cell = t / 6;

        tet[t][0] = (uint32_t)(cell % n + cell / n % n * side + cell / n / n * side * side);
        for (int k = 0; k < 3; k++)
            tet[t][k + 1] = tet[t][k] + step[axis[k]];
    }
    must(gsn_space_new((const double(*)[3])point, points, (const uint32_t(*)[4])tet, tets, &options,
                       &space, &err),
         &err);
    free(point);
    free(tet);
    return space;
}

/* Samples of f at random places of that cube; free() what they point at. */
static inline struct gsn_data cube_samples(size_t count, double (*f)(const double u[3]))
{
    double(*at)[3] = malloc(count * sizeof *at), *value = malloc(count * sizeof *value);

    if (!at || !value)
        exit(1);
    for (size_t i = 0; i < count; i++) {
        for (int k = 0; k < 3; k++)
            at[i][k] = drawn();
        value[i] = f(at[i]);
    }
    return (struct gsn_data){ .count = count, .at = (const double(*)[3])at, .value = value };
}

static inline void samples_free(struct gsn_data *data)
{
    free((void *)data->at);
    free((void *)data->value);
}

#endif
