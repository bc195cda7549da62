/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/tissue_springs.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/median.h"
#include "pipeline/register/small.h"

#include <math.h>
#include <string.h>

enum { ROUNDS = 6 };

/* A spring whose chi-squared of 3 degrees is this large counts half: one in a thousand. */
static const double HALF = 16;
/* Median of chi-squared with 3 degrees of freedom. */
static const double MEDIAN_CHI2 = 2.366;

/* The normal equations: symmetric, only the last `band` columns before the diagonal are kept. */
struct band {
    size_t n, wide;
    double *a, *b; /* n * wide, a[i * wide + wide - 1] is the diagonal; n */
};

static double *entry(const struct band *m, size_t i, size_t j)
{
    return &m->a[i * m->wide + (m->wide - 1 - (i - j))];
}

/* Cholesky's factor, in place. */
static void factorise(const struct band *m)
{
    for (size_t i = 0; i < m->n; i++) {
        const size_t from = i + 1 > m->wide ? i + 1 - m->wide : 0;

        for (size_t j = from; j <= i; j++) {
            const size_t both = j + 1 > m->wide ? j + 1 - m->wide : 0;
            double sum = *entry(m, i, j);

            for (size_t k = from > both ? from : both; k < j; k++)
                sum -= *entry(m, i, k) * *entry(m, j, k);
            *entry(m, i, j) = i == j ? sqrt(fmax(sum, 1e-300)) : sum / *entry(m, j, j);
        }
    }
}

static void substitute(const struct band *m, double *x)
{
    for (size_t i = 0; i < m->n; i++) {
        for (size_t j = i + 1 > m->wide ? i + 1 - m->wide : 0; j < i; j++)
            x[i] -= *entry(m, i, j) * x[j];
        x[i] /= *entry(m, i, i);
    }
    for (size_t i = m->n; i-- > 0;) {
        x[i] /= *entry(m, i, i);
        for (size_t j = i + 1 > m->wide ? i + 1 - m->wide : 0; j < i; j++)
            x[j] -= *entry(m, i, j) * x[i];
    }
}

/* ---- Springs ------------------------------------------------------------------------------ */

static double turn_of(const struct gsn_affine *m)
{
    return atan2(-m->m01, m->m11);
}

/* From x, y, turn of a section's frame to the block's. */
static void jacobian(const struct gsn_affine *m, double ret_j[3][3])
{
    const double j[3][3] = { { m->m00, m->m01, 0 },
                             { m->m10, m->m11, 0 },
                             { 0, 0, gsn_affine_det(m) < 0 ? -1 : 1 } };

    memcpy(ret_j, j, sizeof j);
}

static void turn_over(const double c[3][3], const double j[3][3], double ret[3][3])
{
    double half[3][3] = { 0 };

    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++)
            for (size_t k = 0; k < 3; k++)
                half[p][q] += j[p][k] * c[k][q];
    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++) {
            ret[p][q] = 0;
            for (size_t k = 0; k < 3; k++)
                ret[p][q] += half[p][k] * j[q][k];
        }
}

int gsn_tissue_invert(double m[3][3])
{
    double a[GSN_SMALL][GSN_SMALL] = { 0 };

    for (size_t i = 0; i < 3; i++)
        memcpy(a[i], m[i], 3 * sizeof a[i][0]);
    if (gsn_small_invert(a, 3) < 0)
        return -1;
    for (size_t i = 0; i < 3; i++)
        memcpy(m[i], a[i], 3 * sizeof a[i][0]);
    return 0;
}

/* Shift at p and turn from one place of a section to another. */
static void apart(const struct gsn_affine *from, const struct gsn_affine *onto, struct gsn_point p,
                  double ret[3])
{
    const struct gsn_point u = gsn_affine_apply(from, p), v = gsn_affine_apply(onto, p);

    ret[0] = v.x - u.x;
    ret[1] = v.y - u.y;
    ret[2] = remainder(turn_of(onto) - turn_of(from), 2 * M_PI);
}

/* The motion that is left of a spring, in the block at a's centre: shift and turn. */
static void left_of(const struct gsn_tissue_springs *s, const struct gsn_tissue_spring *spring,
                    double ret_left[3])
{
    const struct gsn_tissue_node *a = &s->node[spring->a], *b = &s->node[spring->b];
    const struct gsn_affine by_b = gsn_affine_compose(&spring->match.a_to_b, &b->to_block);

    apart(&a->to_block, &by_b, a->centre, ret_left);
}

static int information_of(const struct gsn_tissue_springs *s,
                          const struct gsn_tissue_spring *spring, double ret[3][3])
{
    double j[3][3];

    jacobian(&s->node[spring->a].to_block, j);
    turn_over(spring->match.covariance, j, ret);
    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++)
            ret[p][q] *= s->factor;
    return gsn_tissue_invert(ret);
}

static double chi2_of(const double w[3][3], const double left[3])
{
    double sum = 0;

    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++)
            sum += left[p] * w[p][q] * left[q];
    return sum;
}

static int active(const struct gsn_tissue_springs *s, const struct gsn_tissue_spring *spring)
{
    return !spring->dropped && s->node[spring->a].placed && s->node[spring->b].placed;
}

/* Adds J^T w J and J^T w r of rows that touch one or two nodes. */
static void add(const struct band *m, const size_t at[2], double j[2][3][3], size_t nodes,
                const double w[3][3], const double left[3])
{
    for (size_t u = 0; u < nodes; u++)
        for (size_t p = 0; p < 3; p++) {
            double jw[3] = { 0 };
            const size_t row = 3 * at[u] + p;

            for (size_t k = 0; k < 3; k++)
                for (size_t l = 0; l < 3; l++)
                    jw[l] += j[u][k][p] * w[k][l];
            for (size_t l = 0; l < 3; l++)
                m->b[row] -= jw[l] * left[l];
            for (size_t v = 0; v < nodes; v++)
                for (size_t q = 0; q < 3; q++)
                    for (size_t l = 0; l < 3 && 3 * at[v] + q <= row; l++)
                        *entry(m, row, 3 * at[v] + q) += jw[l] * j[v][l][q];
        }
}

/* The residual is b's word minus a's place, at a's centre; b turns about its own. */
static void add_spring(const struct gsn_tissue_springs *s, struct gsn_tissue_spring *spring,
                       const struct band *m)
{
    const struct gsn_tissue_node *a = &s->node[spring->a], *b = &s->node[spring->b];
    const struct gsn_point p = gsn_affine_apply(&a->to_block, a->centre);
    const struct gsn_point q = gsn_affine_apply(&b->to_block, b->centre);
    const size_t at[2] = { spring->a, spring->b };
    double j[2][3][3] = { { { -1, 0, 0 }, { 0, -1, 0 }, { 0, 0, -1 } },
                          { { 1, 0, -(p.y - q.y) }, { 0, 1, p.x - q.x }, { 0, 0, 1 } } };
    double w[3][3], left[3];

    if (!active(s, spring) || information_of(s, spring, w) < 0)
        return;
    left_of(s, spring, left);
    spring->chi2 = chi2_of(w, left);
    spring->weight = HALF / (HALF + spring->chi2);
    for (size_t k = 0; k < 3; k++)
        for (size_t l = 0; l < 3; l++)
            w[k][l] *= spring->weight;
    add(m, at, j, 2, w, left);
}

static void add_hold(const struct gsn_tissue_springs *s, size_t i, const struct band *m)
{
    const struct gsn_tissue_node *n = &s->node[i];
    const size_t at[2] = { i, i };
    double j[2][3][3] = { { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } } };
    double left[3];

    if (!n->placed) {
        for (size_t p = 0; p < 3; p++)
            *entry(m, 3 * i + p, 3 * i + p) += 1;
        return;
    }
    if (!n->held)
        return;
    apart(&n->hold, &n->to_block, n->centre, left);
    add(m, at, j, 1, n->holding, left);
}

static void move(struct gsn_tissue_node *n, const double by[3])
{
    const struct gsn_point c = gsn_affine_apply(&n->to_block, n->centre);
    const double co = cos(by[2]), si = sin(by[2]);
    const struct gsn_affine turn = { co, -si, c.x + by[0] - co * c.x + si * c.y,
                                     si, co,  c.y + by[1] - si * c.x - co * c.y };

    n->to_block = gsn_affine_compose(&n->to_block, &turn);
}

static void assemble(struct gsn_tissue_springs *s, const struct band *m)
{
    memset(m->a, 0, m->n * m->wide * sizeof *m->a);
    memset(m->b, 0, m->n * sizeof *m->b);
    for (size_t i = 0; i < s->springs; i++)
        add_spring(s, &s->spring[i], m);
    for (size_t i = 0; i < s->nodes; i++)
        add_hold(s, i, m);
}

/* The factor under which the springs' chi-squared is what is usual: each leaves only the share of
 * 3 degrees of freedom that the unknowns did not take. */
static void learn_factor(struct gsn_tissue_springs *s, double *room)
{
    size_t n = 0, unknown = 0, holds = 0;
    double share;

    for (size_t i = 0; i < s->springs; i++)
        if (active(s, &s->spring[i]))
            room[n++] = s->spring[i].chi2;
    for (size_t i = 0; i < s->nodes; i++) {
        unknown += s->node[i].placed != 0;
        holds += s->node[i].placed && s->node[i].held;
    }
    if (n + holds <= unknown)
        return;
    share = (double)(n + holds - unknown) / (double)(n + holds);
    s->factor = fmax(s->factor * gsn_median(room, n) / (MEDIAN_CHI2 * share), 1);
}

static void learn_errors(struct gsn_tissue_springs *s, const struct band *m, double *x)
{
    for (size_t i = 0; i < s->nodes; i++) {
        struct gsn_tissue_node *n = &s->node[i];

        for (size_t p = 0; n->placed && p < 3; p++) {
            memset(x, 0, m->n * sizeof *x);
            x[3 * i + p] = 1;
            substitute(m, x);
            for (size_t q = 0; q < 3; q++)
                n->covariance[q][p] = x[3 * i + q];
        }
        n->error = sqrt(n->covariance[0][0] + n->covariance[1][1] +
                        n->covariance[2][2] * n->radius * n->radius);
    }
}

int gsn_tissue_relax(struct gsn_tissue_springs *s, struct gsn_error *err)
{
    size_t span = 0;
    struct band m = { .n = 3 * s->nodes };
    gsn_auto_mem(double) a = NULL;
    gsn_auto_mem(double) b = gsn_alloc_array(m.n, sizeof *b);
    gsn_auto_mem(double) room = gsn_alloc_array(s->springs + 1, sizeof *room);

    for (size_t i = 0; i < s->springs; i++)
        span = s->spring[i].b - s->spring[i].a > span ? s->spring[i].b - s->spring[i].a : span;
    m.wide = 3 * span + 3;
    a = gsn_alloc_array(m.n, m.wide * sizeof *a);
    if (!a || !b || !room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying %zu sections by their tissue",
                        s->nodes);
    m.a = a;
    m.b = b;
    for (int round = 0; round <= ROUNDS; round++) {
        assemble(s, &m);
        factorise(&m);
        if (round == ROUNDS)
            break;
        substitute(&m, m.b);
        for (size_t i = 0; i < s->nodes; i++)
            if (s->node[i].placed)
                move(&s->node[i], &m.b[3 * i]);
        assemble(s, &m);
        learn_factor(s, room);
    }
    learn_errors(s, &m, m.b);
    return GSN_OK;
}
