/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The orientation predicate, exact.
 *
 * Method: J. R. Shewchuk, "Adaptive precision floating-point arithmetic and fast robust geometric
 * predicates", 1997: a filter in floating point, then expansions; between them a determinant whose
 * every operation is seen to be exact, as it is for the coordinates of grids. Products are split by
 * a fused multiply-add. gsn_orient_side() breaks ties by a symbolic perturbation of the point (as
 * in H. Edelsbrunner, E. P. Muecke, "Simulation of simplicity", 1990): the sign of the first
 * component of the plane's normal that is not 0. Values that are divided by are in twice the
 * precision (T. J. Dekker, "A floating-point technique for extending the available precision",
 * 1971).
 *
 * Failure: none is noticed; products must neither overflow nor underflow. Cost: nearly every
 * question ends at the filter; an exact determinant has at most 192 parts, on the stack. */
#include "pipeline/model/orient.h"

#include <math.h>

enum { LONGEST = 192 }; /* parts of an exact 3x3 determinant of differences, at most */

/* An exact number: the unevaluated sum of its parts, which do not overlap and grow in magnitude.
 * Zeros are left out, so the sign is that of the last part. */
struct expansion {
    int count;
    double part[LONGEST];
};

static void append_part(struct expansion *e, double part)
{
    if (part != 0)
        e->part[e->count++] = part;
}

/* a + b = sum + rest, exactly. */
static double two_sum(double a, double b, double *rest)
{
    const double sum = a + b;
    const double of_b = sum - a;
    const double of_a = sum - of_b;

    *rest = (a - of_a) + (b - of_b);
    return sum;
}

/* a b = product + rest, exactly. */
static double two_product(double a, double b, double *rest)
{
    const double product = a * b;

    *rest = fma(a, b, -product);
    return product;
}

static void exact_difference(double a, double b, struct expansion *ret)
{
    double rest;
    const double sum = two_sum(a, -b, &rest);

    ret->count = 0;
    append_part(ret, rest);
    append_part(ret, sum);
}

/* Shewchuk's fast expansion sum: merge by magnitude, then carry upwards. */
static void add_expansions(const struct expansion *e, const struct expansion *f,
                           struct expansion *ret)
{
    double carry = 0, rest;
    int i = 0, j = 0;

    ret->count = 0;
    while (i < e->count || j < f->count) {
        const int from_e = j == f->count || (i < e->count && fabs(e->part[i]) < fabs(f->part[j]));
        const double next = from_e ? e->part[i++] : f->part[j++];

        carry = two_sum(carry, next, &rest);
        append_part(ret, rest);
    }
    append_part(ret, carry);
}

/* Shewchuk's scale expansion: e times one double. */
static void scale_expansion(const struct expansion *e, double by, struct expansion *ret)
{
    double carry = 0, rest;

    ret->count = 0;
    for (int i = 0; i < e->count; i++) {
        double low;
        const double high = two_product(e->part[i], by, &low);
        const double sum = two_sum(carry, low, &rest);

        append_part(ret, rest);
        carry = two_sum(high, sum, &rest);
        append_part(ret, rest);
    }
    append_part(ret, carry);
}

/* f has at most two parts: a difference. */
static void multiply_expansions(const struct expansion *e, const struct expansion *f,
                                struct expansion *ret)
{
    struct expansion first, second;

    ret->count = 0;
    if (f->count == 0)
        return;
    if (f->count == 1) {
        scale_expansion(e, f->part[0], ret);
        return;
    }
    scale_expansion(e, f->part[0], &first);
    scale_expansion(e, f->part[1], &second);
    add_expansions(&first, &second, ret);
}

static void negate_expansion(struct expansion *e)
{
    for (int i = 0; i < e->count; i++)
        e->part[i] = -e->part[i];
}

static int sign_of(double x)
{
    return (x > 0) - (x < 0);
}

static int sign_of_expansion(const struct expansion *e)
{
    return e->count ? sign_of(e->part[e->count - 1]) : 0;
}

/* ret = p_i q_j - p_j q_i. */
static void exact_minor(const struct expansion p[3], const struct expansion q[3], int i, int j,
                        struct expansion *ret)
{
    struct expansion plus, minus;

    multiply_expansions(&p[i], &q[j], &plus);
    multiply_expansions(&p[j], &q[i], &minus);
    negate_expansion(&minus);
    add_expansions(&plus, &minus, ret);
}

static void exact_rows(const double a[3], const double b[3], const double c[3],
                       struct expansion p[3], struct expansion q[3])
{
    for (int i = 0; i < 3; i++) {
        exact_difference(b[i], a[i], &p[i]);
        exact_difference(c[i], a[i], &q[i]);
    }
}

static int exact_orient3d(const double a[3], const double b[3], const double c[3],
                          const double d[3])
{
    struct expansion p[3], q[3], r, minor, term, sum = { .count = 0 }, next;

    exact_rows(a, b, c, p, q);
    for (int i = 0; i < 3; i++) {
        exact_minor(p, q, (i + 1) % 3, (i + 2) % 3, &minor);
        exact_difference(d[i], a[i], &r);
        multiply_expansions(&minor, &r, &term);
        add_expansions(&sum, &term, &next);
        sum = next;
    }
    return sign_of_expansion(&sum);
}

/* b - a and c - a; returns whether one of them had to be rounded. */
static int rounded_rows(const double a[3], const double b[3], const double c[3], double p[3],
                        double q[3])
{
    int rounded = 0;
    double rest;

    for (int i = 0; i < 3; i++) {
        p[i] = two_sum(b[i], -a[i], &rest);
        rounded |= rest != 0;
        q[i] = two_sum(c[i], -a[i], &rest);
        rounded |= rest != 0;
    }
    return rounded;
}

/* p_i q_j - p_j q_i; returns whether it had to be rounded. */
static int rounded_minor(const double p[3], const double q[3], int i, int j, double *ret_minor)
{
    double plus_rest, minus_rest, rest;
    const double plus = two_product(p[i], q[j], &plus_rest);
    const double minus = two_product(p[j], q[i], &minus_rest);

    *ret_minor = two_sum(plus, -minus, &rest);
    return plus_rest != 0 || minus_rest != 0 || rest != 0;
}

/* The determinant; returns whether it had to be rounded. Numbers of few digits, those of grids and
 * of meshes made for them, need not be. */
static int rounded_det(const double a[3], const double b[3], const double c[3], const double d[3],
                       double *ret_det)
{
    double p[3], q[3], rest, minor;
    int rounded = rounded_rows(a, b, c, p, q);

    *ret_det = 0;
    for (int i = 0; i < 3 && !rounded; i++) {
        const double r = two_sum(d[i], -a[i], &rest);
        double term;

        rounded |= rest != 0;
        rounded |= rounded_minor(p, q, (i + 1) % 3, (i + 2) % 3, &minor);
        term = two_product(minor, r, &rest);
        rounded |= rest != 0;
        *ret_det = two_sum(*ret_det, term, &rest);
        rounded |= rest != 0;
    }
    return rounded;
}

static int same_point(const double a[3], const double b[3])
{
    return a[0] == b[0] && a[1] == b[1] && a[2] == b[2];
}

int gsn_orient3d(const double a[3], const double b[3], const double c[3], const double d[3])
{
    const double p[3] = { b[0] - a[0], b[1] - a[1], b[2] - a[2] };
    const double q[3] = { c[0] - a[0], c[1] - a[1], c[2] - a[2] };
    double det = 0, permanent = 0;

    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const double r = d[i] - a[i], plus = p[j] * q[k], minus = p[k] * q[j];

        det += r * (plus - minus);
        permanent += fabs(r) * (fabs(plus) + fabs(minus));
    }
    if (fabs(det) > GSN_ORIENT_BOUND * permanent)
        return sign_of(det);
    /* The everyday zero: tetrahedra ask about vertices they share. */
    if (same_point(d, a) || same_point(d, b) || same_point(d, c))
        return 0;
    if (!rounded_det(a, b, c, d, &det))
        return sign_of(det);
    return exact_orient3d(a, b, c, d);
}

/* The sign of component i of (b - a) x (c - a). */
static int normal_sign(const double a[3], const double b[3], const double c[3], int i)
{
    const int j = (i + 1) % 3, k = (i + 2) % 3;
    const double plus = (b[j] - a[j]) * (c[k] - a[k]), minus = (b[k] - a[k]) * (c[j] - a[j]);
    double row[2][3], plain;
    struct expansion p[3], q[3], minor;

    if (fabs(plus - minus) > GSN_ORIENT_BOUND * (fabs(plus) + fabs(minus)))
        return sign_of(plus - minus);
    if (!rounded_rows(a, b, c, row[0], row[1]) && !rounded_minor(row[0], row[1], j, k, &plain))
        return sign_of(plain);
    exact_rows(a, b, c, p, q);
    exact_minor(p, q, j, k, &minor);
    return sign_of_expansion(&minor);
}

int gsn_orient_side(const double a[3], const double b[3], const double c[3], const double u[3])
{
    int sign = gsn_orient3d(a, b, c, u);

    for (int i = 0; i < 3 && sign == 0; i++)
        sign = normal_sign(a, b, c, i);
    return sign;
}

/* A number in twice the precision (Dekker 1971): high is the sum rounded. */
struct twofold {
    double high, low;
};

static struct twofold twofold_difference(double a, double b)
{
    struct twofold ret;

    ret.high = two_sum(a, -b, &ret.low);
    return ret;
}

static struct twofold twofold_plus(struct twofold a, struct twofold b)
{
    struct twofold ret;
    double rest;
    const double sum = two_sum(a.high, b.high, &rest);

    ret.high = two_sum(sum, rest + (a.low + b.low), &ret.low);
    return ret;
}

static struct twofold twofold_times(struct twofold a, struct twofold b)
{
    struct twofold ret;
    double rest;
    const double product = two_product(a.high, b.high, &rest);

    ret.high = two_sum(product, rest + (a.high * b.low + a.low * b.high), &ret.low);
    return ret;
}

static struct twofold twofold_minus(struct twofold a, struct twofold b)
{
    return twofold_plus(a, (struct twofold){ -b.high, -b.low });
}

double gsn_orient_value(const double a[3], const double b[3], const double c[3], const double d[3])
{
    struct twofold p[3], q[3], sum = { 0, 0 };

    for (int i = 0; i < 3; i++) {
        p[i] = twofold_difference(b[i], a[i]);
        q[i] = twofold_difference(c[i], a[i]);
    }
    for (int i = 0; i < 3; i++) {
        const int j = (i + 1) % 3, k = (i + 2) % 3;
        const struct twofold minor =
            twofold_minus(twofold_times(p[j], q[k]), twofold_times(p[k], q[j]));

        sum = twofold_plus(sum, twofold_times(minor, twofold_difference(d[i], a[i])));
    }
    return sum.high;
}

void gsn_orient_rows(const double a[3], const double b[3], const double c[3], const double d[3],
                     double (*ret_row)[3])
{
    const double *const end[3] = { b, c, d };
    struct twofold edge[3][3], minor[3][3], det = { 0, 0 };

    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 3; i++)
            edge[k][i] = twofold_difference(end[k][i], a[i]);
    }
    for (int k = 0; k < 3; k++) {
        const struct twofold *p = edge[(k + 1) % 3], *q = edge[(k + 2) % 3];

        for (int i = 0; i < 3; i++)
            minor[k][i] = twofold_minus(twofold_times(p[(i + 1) % 3], q[(i + 2) % 3]),
                                        twofold_times(p[(i + 2) % 3], q[(i + 1) % 3]));
    }
    for (int i = 0; i < 3; i++)
        det = twofold_plus(det, twofold_times(minor[0][i], edge[0][i]));
    for (int k = 0; k < 3; k++) {
        for (int i = 0; i < 3; i++)
            ret_row[k][i] = minor[k][i].high / det.high;
    }
}

int gsn_orient_cross(const double p[2], const double q[2])
{
    double plus_rest, minus_rest;
    const double plus = two_product(p[0], q[1], &plus_rest);
    const double minus = two_product(p[1], q[0], &minus_rest);

    /* Rounding is monotonic: different rounded products are in the order of the exact ones. */
    return plus != minus ? sign_of(plus - minus) : sign_of(plus_rest - minus_rest);
}
