/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: a trend (polynomial regression on the inliers of a robust covariance, outlier.h) and a
 * covariance of the sections' shapes; Hotelling's T^2 for the trend, Mauchly's test of sphericity
 * with Bartlett's correction for the strain, Lawley's correction (1956) for the noise.
 *
 * The six coordinates of three residuals are a rigid motion and a strain, one to one, so the strain
 * m of a section is what its marks say of its shape, with noise of covariance N. Over the stack
 * m = trend(z) + s + n: the axes' slopes and bends, the section's own strain, and the noise.
 *
 * Steps of gsn_shape_prior_learn(). 1. The maps between residuals and strain, and the noise's
 * whitening. 2. The strain of each section of three good marks, whitened. 3. Bend, then slope, are
 * kept where they are beyond 0.1 % of chance. 4. What is left is split into noise, alike in all
 * directions, and strain. 5. Limits for the tests of single sections.
 *
 * Fails when memory runs out; from fewer than 12 sections nothing is learnt. */
#include "pipeline/register/pose/procrustes_internal.h"

#include "pipeline/core/distributions.h"
#include "pipeline/core/linalg.h"
#include "pipeline/core/mem.h"
#include "pipeline/register/pose/outlier.h"

#include <math.h>
#include <string.h>

enum { COORDS = 2 * GSN_FIDUCIALS, TERMS = 3, ROUNDS = 4 };

/* Chi-squared beyond which 0.1 % lie with 5 degrees of freedom: those in which three variances and
 * their axes can differ from being one. */
static const double CHI2_ROUND = 20.515;
/* Standard deviations beyond which 0.1 % lie on one side. */
static const double SIGMAS = 3.09;
static const double ALPHA = GSN_POSE_ALPHA;
/* Declared marks that are off by more than chance, and by no more than a hundredth, are so rare
 * that chance has to be far rarer still before it is they. */
static const double DECLARED_ALPHA = 1e-5;
/* A mark this much poorer than the median one says little of the stack. */
static const double POOR = 4;

struct lesson {
    double strain_of[3][COORDS];      /* residuals -> strain */
    double shape[COORDS][3];          /* strain -> residuals of a rigid fit with marks alike */
    double lower[3][3];               /* Cholesky factor of the noise N of the median section */
    struct gsn_robust_vector *vector; /* whitened */
    double *z, *scratch;
    size_t count, terms; /* of the trend that is used */
    double middle, half;
    double term[TERMS][3];        /* the trend: constant, slope, bend; whitened */
    double spread[3][3];          /* of what is left, whitened */
    double inverse[TERMS][TERMS]; /* of the regression's normal matrix */
};

/* The inverse of [J K], and K less its rigid part. */
static int make_maps(const struct gsn_procrustes *s, struct lesson *l)
{
    const struct gsn_point about = gsn_triangle_centroid(s->triangle);
    double a[COORDS][COORDS] = { 0 }, unit[COORDS][COORDS] = { 0 };
    double normal[3][3] = { 0 }, jk[3][3] = { 0 };
    double j[COORDS][3], k[COORDS][3];

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_point u = { s->triangle[i].x - about.x, s->triangle[i].y - about.y };

        gsn_pose_jacobian(u, &j[2 * i], &k[2 * i]);
    }
    for (size_t i = 0; i < COORDS; i++) {
        unit[i][i] = 1;
        for (size_t c = 0; c < 3; c++) {
            a[i][c] = j[i][c];
            a[i][3 + c] = k[i][c];
            for (size_t d = 0; d < 3; d++) {
                normal[c][d] += j[i][c] * j[i][d];
                jk[c][d] += j[i][c] * k[i][d];
            }
        }
    }
    if (gsn_solve_general(&a[0][0], COORDS, COORDS, &unit[0][0], COORDS, COORDS) < 0 ||
        gsn_solve_general(&normal[0][0], 3, 3, &jk[0][0], 3, 3) < 0)
        return -1;
    for (size_t c = 0; c < 3; c++)
        memcpy(l->strain_of[c], unit[3 + c], sizeof l->strain_of[c]);
    for (size_t i = 0; i < COORDS; i++)
        for (size_t c = 0; c < 3; c++) {
            l->shape[i][c] = k[i][c];
            for (size_t d = 0; d < 3; d++)
                l->shape[i][c] -= j[i][d] * jk[d][c];
        }
    return 0;
}

static int make_whitening(const struct gsn_procrustes *s, struct lesson *l)
{
    double noise[3][3];

    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++) {
            noise[i][j] = 0;
            for (size_t a = 0; a < COORDS; a++)
                noise[i][j] += l->strain_of[i][a] * l->strain_of[j][a] * s->mark_um2;
        }
    memcpy(l->lower, noise, sizeof noise);
    return gsn_cholesky(&l->lower[0][0], 3, 3);
}

/* The strain in what the marks are off by. */
static void whiten_strain(const struct lesson *l, const double y[COORDS], double ret_v[3])
{
    for (size_t i = 0; i < 3; i++) {
        double strain = 0;

        for (size_t a = 0; a < COORDS; a++)
            strain += l->strain_of[i][a] * y[a];
        for (size_t j = 0; j < i; j++)
            strain -= l->lower[i][j] * ret_v[j];
        ret_v[i] = strain / l->lower[i][i];
    }
}

static void add_section(const struct gsn_procrustes *s, const struct gsn_procrustes_member *m,
                        struct lesson *l)
{
    struct gsn_robust_vector *to = &l->vector[l->count];
    struct gsn_pose_fit_input laid;
    double y[COORDS];

    (void)gsn_procrustes_observation(s, m, &laid);
    for (size_t i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_point p = gsn_rigid_apply(&m->motion, laid.from[i]);

        y[2 * i] = p.x - laid.onto[i].x;
        y[2 * i + 1] = p.y - laid.onto[i].y;
    }
    whiten_strain(l, y, to->v);
    to->inlier = m->inlier;
    l->z[l->count++] = m->input->serial;
}

static void gather_sections(const struct gsn_procrustes *s, struct lesson *l)
{
    double low = INFINITY, high = -INFINITY;

    for (size_t i = 0; i < s->count; i++) {
        const struct gsn_procrustes_member *m = &s->member[i];
        double worst = 0;

        for (int k = 0; k < GSN_FIDUCIALS; k++)
            worst = fmax(worst, m->variance[k]);
        if (m->marks == GSN_FIDUCIALS && isfinite(m->squares) && worst <= POOR * s->mark_um2)
            add_section(s, m, l);
    }
    for (size_t i = 0; i < l->count; i++) {
        low = fmin(low, l->z[i]);
        high = fmax(high, l->z[i]);
    }
    l->middle = 0.5 * (low + high);
    l->half = fmax(0.5 * (high - low), 1);
}

/* 1, position from -1 to 1, and its square: the bend is that of the ends against the middle. */
static void terms_at(const struct lesson *l, double serial, double ret_term[TERMS])
{
    const double t = (serial - l->middle) / l->half;

    ret_term[0] = 1;
    ret_term[1] = t;
    ret_term[2] = t * t;
}

/* Least squares over the inliers with the first `terms` terms. */
static int regress_trend(struct lesson *l, size_t terms)
{
    double right[TERMS][3] = { 0 };

    memset(l->inverse, 0, sizeof l->inverse);
    memset(l->term, 0, sizeof l->term);
    for (size_t k = 0; k < l->count; k++) {
        double t[TERMS];

        if (!l->vector[k].inlier)
            continue;
        terms_at(l, l->z[k], t);
        for (size_t i = 0; i < terms; i++) {
            for (size_t j = 0; j < terms; j++)
                l->inverse[i][j] += t[i] * t[j];
            for (size_t c = 0; c < 3; c++)
                right[i][c] += t[i] * l->vector[k].v[c];
        }
    }
    if (gsn_invert_spd(&l->inverse[0][0], terms, TERMS) < 0)
        return -1;
    for (size_t i = 0; i < terms; i++)
        for (size_t c = 0; c < 3; c++)
            for (size_t j = 0; j < terms; j++)
                l->term[i][c] += l->inverse[i][j] * right[j][c];
    return 0;
}

static void subtract_trend(struct lesson *l, double sign)
{
    for (size_t k = 0; k < l->count; k++) {
        double t[TERMS];

        terms_at(l, l->z[k], t);
        for (size_t i = 0; i < TERMS; i++)
            for (size_t c = 0; c < 3; c++)
                l->vector[k].v[c] -= sign * t[i] * l->term[i][c];
    }
}

/* Trend and spread by turns; the vectors are given back as they came. */
static int fit_trend(struct lesson *l, size_t terms)
{
    for (int round = 0; round < ROUNDS; round++) {
        int r = regress_trend(l, terms);

        if (r < 0)
            return r;
        subtract_trend(l, 1);
        r = gsn_robust_covariance(l->vector, l->count, l->scratch, l->spread);
        subtract_trend(l, -1);
        if (r < 0)
            return r;
    }
    return 0;
}

/* Whether a constant or another term is more than chance makes; variance: in units of the spread.
 */
static int beyond_chance(const struct lesson *l, const double v[3], double variance, double alpha)
{
    const double n = (double)l->count;
    double inverse[3][3], square = 0;

    for (size_t i = 0; i < 3; i++)
        memcpy(inverse[i], l->spread[i], sizeof l->spread[i]);
    if (gsn_invert_spd(&inverse[0][0], 3, 3) < 0)
        return 0;
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            square += v[i] * inverse[i][j] * v[j];
    return square / variance > gsn_ratio_limit(3, n - 4, alpha) * (n - 1) / (n - 3);
}

static int is_significant(const struct lesson *l, size_t term)
{
    return beyond_chance(l, l->term[term], l->inverse[term][term], ALPHA);
}

/* Strain to one vector for each mark. */
static void to_marks(const struct lesson *l, const double whitened[3], struct gsn_point ret_mark[3])
{
    double strain[3] = { 0 };

    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j <= i; j++)
            strain[i] += l->lower[i][j] * whitened[j];
    for (size_t m = 0; m < GSN_FIDUCIALS; m++) {
        ret_mark[m] = (struct gsn_point){ 0, 0 };
        for (size_t c = 0; c < 3; c++) {
            ret_mark[m].x += l->shape[2 * m][c] * strain[c];
            ret_mark[m].y += l->shape[2 * m + 1][c] * strain[c];
        }
    }
}

/* The spread of a term over the marks, root mean square of the six coordinates. */
static double sd_of(const struct lesson *l, size_t term)
{
    double sum = 0;

    for (size_t c = 0; c < 3; c++) {
        const double unit[3] = { c == 0, c == 1, c == 2 };
        struct gsn_point mark[GSN_FIDUCIALS];

        /* The whitened spread is near 1 each way; its trace is shared evenly. */
        to_marks(l, unit, mark);
        for (size_t m = 0; m < GSN_FIDUCIALS; m++)
            sum += l->spread[c][c] * (mark[m].x * mark[m].x + mark[m].y * mark[m].y);
    }
    return sqrt(sum * l->inverse[term][term] / COORDS);
}

static int learn_axes(struct gsn_procrustes *s, struct lesson *l)
{
    struct gsn_axes axes = { .middle = l->middle, .half = l->half };

    l->terms = 3;
    if (fit_trend(l, 3) < 0)
        return -1;
    axes.bent = is_significant(l, 2);
    to_marks(l, l->term[2], axes.bend);
    axes.bend_sd = sd_of(l, 2);
    l->terms = axes.bent ? 3 : 2;
    if (!axes.bent && fit_trend(l, 2) < 0)
        return -1;
    axes.slanted = is_significant(l, 1);
    to_marks(l, l->term[1], axes.slope);
    axes.slope_sd = sd_of(l, 1) / l->half;
    for (size_t i = 0; i < GSN_FIDUCIALS; i++) {
        axes.slope[i].x /= l->half;
        axes.slope[i].y /= l->half;
    }
    l->terms = axes.bent || axes.slanted ? l->terms : 1;
    if (l->terms == 1 && fit_trend(l, 1) < 0)
        return -1;
    s->axes = axes;
    return 0;
}

/* Moves the triangle to the mean of the sections' shapes. Before strain was known it was the mean
 * of marks that weigh by their own errors, and a section that has swollen pulled a mark that it
 * shows well farther out than the others. */
static void move_triangle(struct gsn_procrustes *s, const struct lesson *l)
{
    struct gsn_point shift[GSN_FIDUCIALS];

    if (!s->axes.bent && !s->axes.slanted && !(s->sizes && s->stretches))
        return;
    to_marks(l, l->term[0], shift);
    for (size_t i = 0; i < GSN_FIDUCIALS; i++) {
        s->triangle[i].x += shift[i].x;
        s->triangle[i].y += shift[i].y;
    }
}

/* The noise by the smallest of three sample variances, which chance makes too small by the more
 * the nearer the others are (Lawley 1956); never more than the mean with the next. */
static double smallest_variance(const double value[3], double n)
{
    const double near = value[1] / (value[1] - value[2]), far = value[0] / (value[0] - value[2]);

    return fmin(value[2] * (1 + (near + far) / n), 0.5 * (value[1] + value[2]));
}

/* Where sections may differ in size alone: the noise is what is left of their shapes, in the two
 * directions across a change of size. The logarithm of the ratio of two sample variances, of n and
 * 2 n degrees of freedom, has the variance 3 / n. */
static void learn_sizes(struct gsn_procrustes *s, const struct lesson *l)
{
    const double n = (double)l->count;
    double size[3], length2 = 0, along = 0, noise = 0;

    for (size_t i = 0; i < 3; i++) {
        size[i] = i == 0;
        for (size_t j = 0; j < i; j++)
            size[i] -= l->lower[i][j] * size[j];
        size[i] /= l->lower[i][i];
        length2 += size[i] * size[i];
        noise += l->spread[i][i];
    }
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++)
            along += size[i] * l->spread[i][j] * size[j] / length2;
    noise = 0.5 * (noise - along) * n / (n - (double)l->terms);
    along *= n / (n - (double)l->terms);
    if (!(noise > 0) || !(log(along / noise) > SIGMAS * sqrt(3 / n)))
        return;
    s->stretches = 1;
    s->strain[0][0] = (along - noise) / length2;
    s->mark_um2 *= noise;
}

/* Splits the spread of n vectors into noise, alike in all directions, and the rest. Mauchly's test
 * of sphericity with Bartlett's correction says whether there is a rest. */
static void learn_strain(struct gsn_procrustes *s, const struct lesson *l)
{
    double spread[3][3], value[3], axis[3][3], rest[3][3] = { 0 }, noise, mean;
    const double n = (double)l->count;

    memcpy(spread, l->spread, sizeof spread);
    gsn_eigen_symmetric(&spread[0][0], 3, value, &axis[0][0]);
    for (size_t i = 0; i < 3; i++)
        value[i] *= n / (n - (double)l->terms);
    if (!(value[2] > 0))
        return;
    mean = (value[0] + value[1] + value[2]) / 3;
    s->stretches =
        -(n - 1 - 23.0 / 18) * log(value[0] * value[1] * value[2] / pow(mean, 3)) > CHI2_ROUND;
    noise = s->stretches ? smallest_variance(value, n) : mean;
    for (size_t e = 0; s->stretches && e < 2; e++)
        for (size_t i = 0; i < 3; i++)
            for (size_t j = 0; j < 3; j++)
                rest[i][j] += fmax(value[e] - noise, 0) * axis[i][e] * axis[j][e];
    for (size_t i = 0; i < 3; i++)
        for (size_t j = 0; j < 3; j++) {
            double sum = 0;

            for (size_t a = 0; a <= i; a++)
                for (size_t b = 0; b <= j; b++)
                    sum += l->lower[i][a] * rest[a][b] * l->lower[j][b];
            s->strain[i][j] = sum;
        }
    /* Otherwise the stack's noise was settled well by all three directions together. */
    if (s->stretches || l->terms > 1)
        s->mark_um2 *= noise;
}

/* Axes that slant have no one triangle to hold against the protocol's. */
static void compare_with_declared(struct gsn_procrustes *s, const struct lesson *l)
{
    double y[COORDS], v[3];

    if (!s->declared || !s->stretches || l->terms > 1)
        return;
    for (size_t i = 0; i < GSN_FIDUCIALS; i++) {
        y[2 * i] = s->triangle[i].x - s->declared[i].x;
        y[2 * i + 1] = s->triangle[i].y - s->declared[i].y;
    }
    whiten_strain(l, y, v);
    s->as_declared = !beyond_chance(l, v, l->inverse[0][0], DECLARED_ALPHA);
}

/* What is known of the noise, for the tests of single sections. */
static void set_limits(struct gsn_procrustes *s, const struct lesson *l)
{
    const double n = (double)l->count;

    if (s->stretches)
        s->freedom = s->sizes ? 2 * n - 3 : n - 3;
    s->spread_freedom = fmax(s->freedom, 2);
    s->side_limit = gsn_ratio_limit(1, s->spread_freedom, ALPHA);
    /* Hotelling's: where strain was learnt, all of the covariance is estimated. */
    s->widening = s->stretches ? (n - 1) / (n - 3) : 1;
}

int gsn_shape_prior_learn(struct gsn_procrustes *s, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_robust_vector) vector = gsn_alloc_array(s->count, sizeof *vector);
    gsn_auto_mem(double) z = gsn_alloc_array(s->count, sizeof *z);
    struct lesson l = { .vector = vector, .z = z, .scratch = s->scratch };

    if (!vector || !z)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the shapes of %zu sections", s->count);
    /* Shapes that agree to a tenth of a pixel have nothing to teach. */
    if (s->mark_um2 > s->finest && make_maps(s, &l) >= 0 && make_whitening(s, &l) >= 0) {
        gather_sections(s, &l);
        if (l.count >= GSN_ROBUST_COVARIANCE_MIN && learn_axes(s, &l) >= 0) {
            if (s->sizes)
                learn_sizes(s, &l);
            else
                learn_strain(s, &l);
            move_triangle(s, &l);
            compare_with_declared(s, &l);
        }
    }
    set_limits(s, &l);
    return GSN_OK;
}
