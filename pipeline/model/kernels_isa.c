/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Compiled once per instruction set, with GSN_ISA naming the version; and once more as the careful
 * scalar version, whose plane values have been decided elsewhere. */
#include "pipeline/model/kernels.h"

#include "pipeline/model/simd.h"

#define NAME(what) what

#define KERNEL(what)                                                                               \
    static unsigned what(const struct gsn_face_correction_data *restrict data,                     \
                         const double *restrict px, const double *restrict py,                     \
                         const double *restrict pz, double *restrict ret,                          \
                         const double *restrict fixed)

/* x, y, z: the points in the axes of the face. */
#define TURN(row)                                                                                  \
    gsn_simd_fma(                                                                                  \
        gsn_simd_all(data->turn[row][0]), dx,                                                      \
        gsn_simd_fma(gsn_simd_all(data->turn[row][1]), dy, gsn_simd_all(data->turn[row][2]) * dz))

#define BEGIN                                                                                      \
    const gsn_simd dx = gsn_simd_load(px) - gsn_simd_all(data->origin[0]);                         \
    const gsn_simd dy = gsn_simd_load(py) - gsn_simd_all(data->origin[1]);                         \
    const gsn_simd dz = gsn_simd_load(pz) - gsn_simd_all(data->origin[2]);                         \
    const gsn_simd x = TURN(0), y = TURN(1), z = TURN(2);                                          \
    gsn_simd least = gsn_simd_all(INFINITY);                                                       \
    (void)fixed;

#ifdef GSN_FACE_CORRECTION_CAREFUL
#define PLANE(i) gsn_simd_all(fixed[i])
#define END                                                                                        \
    (void)least;                                                                                   \
    (void)x;                                                                                       \
    (void)y;                                                                                       \
    (void)z;                                                                                       \
    return 0;
#else
#define PLANE(i)                                                                                   \
    gsn_simd_fma(gsn_simd_all(data->plane[i][0]), x,                                               \
                 gsn_simd_fma(gsn_simd_all(data->plane[i][1]), y,                                  \
                              gsn_simd_fma(gsn_simd_all(data->plane[i][2]), z,                     \
                                           gsn_simd_all(data->plane[i][3]))))
#define END return gsn_simd_not_above(least, data->bound);
#endif

/* Back to the axes of the mesh. */
#define TURN_BACK(column, gx, gy, gz)                                                              \
    gsn_simd_store(&ret[(1 + (column)) * GSN_SIMD_WIDTH],                                          \
                   gsn_simd_fma(gsn_simd_all(data->turn[0][column]), gx,                           \
                                gsn_simd_fma(gsn_simd_all(data->turn[1][column]), gy,              \
                                             gsn_simd_all(data->turn[2][column]) * (gz))))
#define END_SLOPE(gx, gy, gz)                                                                      \
    TURN_BACK(0, gx, gy, gz);                                                                      \
    TURN_BACK(1, gx, gy, gz);                                                                      \
    TURN_BACK(2, gx, gy, gz);

#include "face_correction_kernels.inc"

#ifndef GSN_FACE_CORRECTION_CAREFUL

/* c + p (..) and so on, innermost first; i runs over the coefficients. */
static inline gsn_simd eval_cubic(unsigned degree, const double *c, gsn_simd p, gsn_simd q,
                                  gsn_simd r)
{
#define C(i) gsn_simd_all(c[i])
    gsn_simd of_p = C(1), of_q = C(2), of_r = C(3);

    if (degree == 2) {
        of_p = gsn_simd_fma(C(4), p, gsn_simd_fma(C(5), q, gsn_simd_fma(C(6), r, of_p)));
        of_q = gsn_simd_fma(C(7), q, gsn_simd_fma(C(8), r, of_q));
        of_r = gsn_simd_fma(C(9), r, of_r);
    }
    if (degree == 3) {
        const gsn_simd pp =
            gsn_simd_fma(C(10), p, gsn_simd_fma(C(11), q, gsn_simd_fma(C(12), r, C(4))));
        const gsn_simd pq = gsn_simd_fma(C(13), q, gsn_simd_fma(C(14), r, C(5)));
        const gsn_simd pr = gsn_simd_fma(C(15), r, C(6));
        const gsn_simd qq = gsn_simd_fma(C(16), q, gsn_simd_fma(C(17), r, C(7)));
        const gsn_simd qr = gsn_simd_fma(C(18), r, C(8));
        const gsn_simd rr = gsn_simd_fma(C(19), r, C(9));

        of_p = gsn_simd_fma(pp, p, gsn_simd_fma(pq, q, gsn_simd_fma(pr, r, of_p)));
        of_q = gsn_simd_fma(qq, q, gsn_simd_fma(qr, r, of_q));
        of_r = gsn_simd_fma(rr, r, of_r);
    }
    return gsn_simd_fma(of_p, p, gsn_simd_fma(of_q, q, gsn_simd_fma(of_r, r, C(0))));
#undef C
}

static inline void paint_rows(unsigned degree, const struct gsn_paint *paint, const double *y,
                              const double *z, const struct gsn_rows *rows, const size_t stride[2],
                              double *ret_value)
{
    static const double ramp[GSN_MAX_SIMD_WIDTH] = { 0, 1, 2, 3, 4, 5, 6, 7 };
    const gsn_simd step[3] = { gsn_simd_all(paint->x[0]), gsn_simd_all(paint->x[1]),
                               gsn_simd_all(paint->x[2]) };

    for (size_t r = 0; r < rows->count; r++) {
        const double dy = y[rows->y[r]] - paint->origin[0], dz = z[rows->z[r]] - paint->origin[1];
        const int32_t high = rows->high[r];
        double *to = &ret_value[(size_t)rows->y[r] * stride[0] + (size_t)rows->z[r] * stride[1]];
        gsn_simd start[3];

        for (int k = 0; k < 3; k++)
            start[k] = gsn_simd_all(fma(paint->y[k], dy, fma(paint->z[k], dz, paint->at[k])));
        for (int32_t i = rows->low[r]; i < high; i += GSN_SIMD_WIDTH) {
            const gsn_simd at = gsn_simd_all((double)i) + gsn_simd_load(ramp);
            const gsn_simd value = eval_cubic(
                degree, paint->coefficient, gsn_simd_fma(at, step[0], start[0]),
                gsn_simd_fma(at, step[1], start[1]), gsn_simd_fma(at, step[2], start[2]));

            gsn_simd_store_some(&to[i], value, (size_t)(high - i));
        }
    }
}

/* The coefficients of the derivative with respect to one variable. */
static void differentiate_terms(unsigned degree, const double *c, int variable, double *ret)
{
    /* Of 1, p, q, r, pp, pq, pr, qq, qr, rr: its times, and where its coefficient stands. */
    static const unsigned char from[3][10] = { { 1, 4, 5, 6, 10, 11, 12, 13, 14, 15 },
                                               { 2, 5, 7, 8, 11, 13, 14, 16, 17, 18 },
                                               { 3, 6, 8, 9, 12, 14, 15, 17, 18, 19 } };
    static const unsigned char times[3][10] = { { 1, 2, 1, 1, 3, 2, 2, 1, 1, 1 },
                                                { 1, 1, 2, 1, 1, 2, 1, 3, 2, 1 },
                                                { 1, 1, 1, 2, 1, 1, 2, 1, 2, 3 } };
    static const unsigned char terms[4] = { 0, 1, 4, 10 };

    for (unsigned i = 0; i < terms[degree]; i++)
        ret[i] = times[variable][i] * c[from[variable][i]];
}

static inline void eval_points(unsigned degree, const double *c, const double *const at[3],
                               size_t count, double *ret_value, double *const ret_slope[3])
{
    double steep[3][10];

    for (int v = 0; ret_slope && v < 3; v++)
        differentiate_terms(degree, c, v, steep[v]);
    for (size_t i = 0; i < count; i += GSN_SIMD_WIDTH) {
        const gsn_simd p = gsn_simd_load_some(&at[0][i], count - i);
        const gsn_simd q = gsn_simd_load_some(&at[1][i], count - i);
        const gsn_simd r = gsn_simd_load_some(&at[2][i], count - i);

        gsn_simd_store_some(&ret_value[i], eval_cubic(degree, c, p, q, r), count - i);
        for (int v = 0; ret_slope && v < 3; v++) {
            const gsn_simd slope =
                degree == 1 ? gsn_simd_all(steep[v][0]) : eval_cubic(degree - 1, steep[v], p, q, r);

            gsn_simd_store_some(&ret_slope[v][i], slope, count - i);
        }
    }
}

/* Lines at one z: a + b y. */
struct section {
    unsigned count;
    const double *y;
    double at[GSN_MAX_SIMD_WIDTH];
};

static inline void cut_lines(const struct gsn_lines *lines, double z, struct section *ret)
{
    ret->count = lines->count;
    ret->y = lines->y;
    for (unsigned i = 0; i < lines->count; i += GSN_SIMD_WIDTH) {
        const size_t some = lines->count - i;

        gsn_simd_store(&ret->at[i],
                       gsn_simd_fma(gsn_simd_load_some(&lines->z[i], some), gsn_simd_all(z),
                                    gsn_simd_load_some(&lines->at[i], some)));
    }
}

static inline gsn_simd line_at(const struct section *section, unsigned i, gsn_simd y)
{
    return gsn_simd_fma(gsn_simd_all(section->y[i]), y, gsn_simd_all(section->at[i]));
}

/* The ends of the part of rows y that a body has; whole numbers, at most one beyond the range. */
static inline void find_ends(const struct section section[2], const gsn_simd range[2], gsn_simd y,
                             gsn_simd ret_end[2])
{
    gsn_simd low = range[0], high = range[1];

    for (unsigned i = 0; i < section[0].count; i++)
        low = gsn_simd_max(line_at(&section[0], i, y), low);
    for (unsigned i = 0; i < section[1].count; i++)
        high = gsn_simd_min(line_at(&section[1], i, y), high);
    ret_end[0] = gsn_simd_min(gsn_simd_ceil(low), range[1] + gsn_simd_all(1));
    ret_end[1] = gsn_simd_max(gsn_simd_floor(high) + gsn_simd_all(1), range[0]);
}

/* Those of one z among them. */
static inline void rows_at(const struct gsn_bodies *bodies, const struct section *section,
                           const double *y, size_t ys, int32_t z, struct gsn_rows *rows)
{
    static const double ramp[GSN_MAX_SIMD_WIDTH] = { 0, 1, 2, 3, 4, 5, 6, 7 };
    const gsn_simd range[2] = { gsn_simd_all(bodies->range[0]), gsn_simd_all(bodies->range[1]) };

    for (size_t i = 0; i < ys; i += GSN_SIMD_WIDTH) {
        const gsn_simd at = gsn_simd_load_some(&y[i], ys - i) - gsn_simd_all(bodies->origin[0]);
        const unsigned now =
            ys - i < GSN_SIMD_WIDTH ? (1u << (ys - i)) - 1 : (1u << GSN_SIMD_WIDTH) - 1;
        gsn_simd outer[2], inner[2];
        unsigned some;

        find_ends(&section[0], range, at, outer);
        some = gsn_simd_below(outer[0], outer[1]) & now;
        if (some == 0)
            continue;
        find_ends(&section[2], range, at, inner);
        gsn_simd_squeeze(&rows->y[rows->count], gsn_simd_all((double)i) + gsn_simd_load(ramp),
                         some);
        gsn_simd_squeeze(&rows->low[rows->count], outer[0], some);
        gsn_simd_squeeze(&rows->high[rows->count], outer[1], some);
        gsn_simd_squeeze(&rows->inner_low[rows->count], inner[0], some);
        gsn_simd_squeeze(&rows->inner_high[rows->count], inner[1], some);
        for (int j = 0; j < GSN_SIMD_WIDTH; j++)
            rows->z[rows->count + (size_t)j] = z;
        rows->count += (size_t)__builtin_popcount(some);
    }
}

static void find_rows(const struct gsn_bodies *bodies, const double *y, size_t ys, const double *z,
                      size_t zs, struct gsn_rows *ret_rows)
{
    struct section section[4];

    ret_rows->count = 0;
    for (size_t i = 0; i < zs; i++) {
        cut_lines(&bodies->outer.low, z[i] - bodies->origin[1], &section[0]);
        cut_lines(&bodies->outer.high, z[i] - bodies->origin[1], &section[1]);
        cut_lines(&bodies->inner.low, z[i] - bodies->origin[1], &section[2]);
        cut_lines(&bodies->inner.high, z[i] - bodies->origin[1], &section[3]);
        rows_at(bodies, section, y, ys, (int32_t)i, ret_rows);
    }
}

#define OF_DEGREE(n)                                                                               \
    static void paint##n(const struct gsn_paint *what, const double *y, const double *z,           \
                         const struct gsn_rows *rows, const size_t stride[2], double *ret_value)   \
    {                                                                                              \
        paint_rows(n, what, y, z, rows, stride, ret_value);                                        \
    }                                                                                              \
    static void points##n(const double *c, const double *const at[3], size_t count,                \
                          double *ret_value, double *const ret_slope[3])                           \
    {                                                                                              \
        eval_points(n, c, at, count, ret_value, ret_slope);                                        \
    }

OF_DEGREE(1)
OF_DEGREE(2)
OF_DEGREE(3)

#endif

const struct gsn_kernels GSN_ISA = {
    .name = GSN_ISA_NAME,
    .lanes = GSN_SIMD_WIDTH,
    .seam = { CHOICES },
#ifndef GSN_FACE_CORRECTION_CAREFUL
    .rows = find_rows,
    .paint = { NULL, paint1, paint2, paint3 },
    .points = { NULL, points1, points2, points3 },
#endif
};
