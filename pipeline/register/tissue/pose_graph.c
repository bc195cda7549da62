/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A pose graph in the plane (Lu & Milios, Autonomous Robots 4, 1997; Kuemmerle et al., g2o, ICRA
 * 2011): sections are nodes of three unknowns, comparisons are edges.
 *
 * 1. Every section is compared with the next three that are there: from where their marks put
 * them, when both have some, and else at all rotations and on both faces. Each comparison searches
 * for itself, so three of them around a triangle bear each other out when they close it and lead
 * over the best other motions by LEAD together (Vuong's test of models that are not nested,
 * Econometrica 57, 1989). A section is left out, the worst first, as long as more than a quarter of
 * its triangles do not close; edges of the triangles that do are sure. (By its own likelihood an
 * edge is not: of a body that is nearly symmetric, the mirrored fit of two neighbours may be the
 * better one by far.)
 * 2. Nodes are placed outwards from what holds, along sure edges first; what is reached over an
 *    unsure edge alone is unsure, and so is all beyond. Edges that contradict these places are
 *    compared again from there, and dropped when they show nothing.
 * 3. Gauss-Newton with Cauchy's weights (Huber & Ronchetti, 2009), the normal equations in a band.
 * An edge's covariance is its curvature's times a factor, one for each distance: by how much
 * columns of tissue, squares of COLUMN times its radius, pull a comparison farther apart than cells
 * that err by themselves would (the design effect); and then times what the closed ways leave,
 * where that is more.
 * 4. The error of a pose is the cluster-robust covariance of the whole graph (Liang & Zeger,
 *    Biometrika 73, 1986), the clusters being columns through all sections: with A the normal
 *    matrix, u_g what column g pulls at all edges, and W_k the information of the marks of k,
 *        C = A^-1 (G / (G - 1) sum_g u_g u_g^T + sum_k W_k) A^-1.
 *    So what a column does alike in many sections adds up along the stack, as the errors do.
 *
 * Sections that nothing reaches are not registered. For n sections 3 n comparisons, which cost all
 * but nothing else. */
#include "pipeline/register/tissue/pose_graph.h"

#include "pipeline/core/linalg.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Each section is compared with this many after it; rounds of Gauss-Newton. */
enum { REACH = 3, ROUNDS = 8 };

/* By so many standard deviations together three edges that close a triangle lead over their best
 * other motions: one in a hundred has that by chance, and one in fifty closes by chance. */
static const double LEAD = 2.33;
/* Log odds of a motion against none at all: a thousand to one, and it is the best of some million
 * that were tried. */
static const double LEAST_ODDS = 6.9 + 13.8;
/* Motions nearer to each other than this share of the tissue's radius are one. */
static const double ONE_MOTION = 0.1;
/* Side of a column, of the tissue's radius of gyration. */
static const double COLUMN = 0.75;
/* The reference is held as if it were known to a millionth of its size. */
static const double HELD = 1e-6;
/* An edge whose chi-squared of 3 degrees is this large counts half: one in a thousand. */
static const double HALF = 16;
/* Median of chi-squared with 3 degrees of freedom. */
static const double MEDIAN_CHI2 = 2.366;

/* Section a on section b, b > a. */
struct edge {
    size_t a, b, far; /* far: sections from a to b, those that are there */
    struct gsn_tissue_match match;
    double effect; /* of its columns, 1 or more */
    double lead;   /* over the best other motion, in standard deviations; of two with marks LEAD */
    int sure;
    double chi2;   /* of what is left of it, under its covariance */
    double weight; /* by its chi2: 1 for one that agrees, towards 0 */
    int dropped;   /* shows nothing where the two sections lie */
};

struct node {
    struct gsn_point centre; /* in the section */
    double radius;
    int held;
    struct gsn_affine hold; /* where it is held */
    double holding[3][3];   /* information of that */
    int placed, sure;
    struct gsn_affine to_block;
    double error;
};

/* The normal equations are symmetric: only the diagonal and the wide - 1 below it are kept. */
struct graph {
    const struct gsn_tissue_section *section;
    size_t count, edges, wide;
    struct node *node;
    struct edge *edge;
    double factor[REACH + 1]; /* of an edge's variances over its curvature's, by far */
    double *a, *b, *room;     /* 3 count * wide; 3 count; as many as edges */
};

/* ---- Comparing ---------------------------------------------------------------------------- */

static struct edge *find_edge(const struct graph *g, size_t a, size_t b)
{
    for (size_t i = g->edges; i-- > 0;)
        if (g->edge[i].a == a && g->edge[i].b == b)
            return &g->edge[i];
    return NULL;
}

/* Columns of a grid about the centre that is given, upright in the frame that to leads to. */
static struct gsn_affine make_grid(const struct gsn_affine *to, struct gsn_point centre,
                                   double radius)
{
    const double k = 1 / (COLUMN * radius), half = 0.5 * GSN_TISSUE_COLUMNS_SIDE;
    const struct gsn_affine scale = { k, 0, half - k * centre.x, 0, k, half - k * centre.y };

    return gsn_affine_compose(to, &scale);
}

/* What the columns pull at a comparison, less their mean; the number of columns that say anything.
 */
static size_t measure_pulls(const struct graph *g, const struct edge *e,
                            const struct gsn_affine *grid, double ret_pull[GSN_TISSUE_COLUMNS][3])
{
    double mean[3] = { 0 };
    size_t columns = 0;

    gsn_tissue_pulls(g->section[e->a].tissue, g->section[e->b].tissue, &e->match.a_to_b, grid,
                     ret_pull);
    for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++) {
        columns += ret_pull[k][0] != 0;
        for (size_t p = 0; p < 3; p++)
            mean[p] += ret_pull[k][p];
    }
    for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++)
        for (size_t p = 0; p < 3 && ret_pull[k][0] != 0; p++)
            ret_pull[k][p] -= mean[p] / (double)columns;
    return columns;
}

/* By how much more the columns of a comparison differ than cells that err by themselves make them.
 */
static double sum_pulls(const struct graph *g, const struct edge *e)
{
    const struct gsn_affine still = { 1, 0, 0, 0, 1, 0 };
    const struct node *a = &g->node[e->a];
    const struct gsn_affine grid = make_grid(&still, a->centre, a->radius);
    double pull[GSN_TISSUE_COLUMNS][3], information[3][3], sum = 0;
    const size_t columns = measure_pulls(g, e, &grid, pull);

    memcpy(information, e->match.covariance, sizeof information);
    if (columns < 2 || gsn_invert_spd(&information[0][0], 3, 3) < 0)
        return 1;
    for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++)
        sum += gsn_quadratic_form(&information[0][0], 3, pull[k]) / 3;
    return fmax(sum * (double)columns / (double)(columns - 1), 1);
}

/* Whether the best motion is there at all, by its columns; and how far the best other is behind. */
static int judge_edge(const struct graph *g, struct edge *e)
{
    e->effect = sum_pulls(g, e);
    if (e->match.spread > 0)
        e->lead = fmax(e->match.evidence - e->match.rival, 0) / (e->match.spread * sqrt(e->effect));
    return e->match.evidence >= LEAST_ODDS * e->effect;
}

static int compare_pair(struct graph *g, size_t a, size_t b, size_t far, struct gsn_error *err)
{
    const struct gsn_tissue_section *sa = &g->section[a], *sb = &g->section[b];
    struct edge e = { .a = a, .b = b, .far = far, .weight = 1 };
    int r;

    if (sa->marked && sb->marked) {
        const struct gsn_affine back = gsn_affine_inverse(&sb->to_block);
        const struct gsn_affine start = gsn_affine_compose(&sa->to_block, &back);

        r = gsn_tissue_refine(sa->tissue, sb->tissue, &start, &e.match, err);
    } else {
        r = gsn_tissue_search(sa->tissue, sb->tissue, &e.match, err);
    }
    if (r == GSN_E_NOMEM)
        return r;
    if (r < 0 || !judge_edge(g, &e))
        return GSN_OK;
    if (sa->marked && sb->marked)
        e.lead = LEAD;
    g->edge[g->edges++] = e;
    return GSN_OK;
}

static int compare_all(struct graph *g, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t far = 1; far <= REACH; far++)
        for (size_t a = 0; r >= 0 && a + far < g->count; a++) {
            size_t b = a;

            for (size_t found = 0; found < far && b < g->count;)
                if (++b < g->count && g->section[b].tissue)
                    found++;
            if (b < g->count && g->section[a].tissue)
                r = compare_pair(g, a, b, far, err);
        }
    return r;
}

static int is_one_motion(const struct node *n, const struct gsn_affine *p,
                         const struct gsn_affine *q)
{
    return gsn_tissue_apart(n->centre, n->radius, p, q) < ONE_MOTION * n->radius;
}

/* What the triangles say of a section. */
struct tally {
    unsigned with, against;
    int out;
};

/* Three sections that were all compared with each other. */
struct triangle {
    size_t node[3];
    struct edge *side[3];
    int says; /* 1: it closes, and not by chance; -1: it does not; 0: by chance */
};

static int judge_triangle(const struct graph *g, struct edge *const side[3])
{
    const struct gsn_affine way =
        gsn_affine_compose(&side[0]->match.a_to_b, &side[1]->match.a_to_b);

    if (!is_one_motion(&g->node[side[0]->a], &way, &side[2]->match.a_to_b))
        return -1;
    return side[0]->lead + side[1]->lead + side[2]->lead >= sqrt(3) * LEAD;
}

/* At most REACH for each section: ways of one and one, one and two, two and one. */
static size_t list_triangles(const struct graph *g, struct triangle *triangles)
{
    size_t count = 0;

    for (size_t i = 0; i < g->edges; i++)
        for (size_t k = 0; k < g->edges; k++) {
            struct edge *const first = &g->edge[i], *const second = &g->edge[k];
            struct triangle *t = &triangles[count];
            struct edge *whole;

            if (second->a != first->b || !(whole = find_edge(g, first->a, second->b)))
                continue;
            *t =
                (struct triangle){ { first->a, first->b, second->b }, { first, second, whole }, 0 };
            t->says = judge_triangle(g, t->side);
            count++;
        }
    return count;
}

/* The section that most triangles contradict, of those in which more than one in four do; count:
 * there is none. */
static size_t most_contradicted(const struct graph *g, const struct triangle *triangles,
                                size_t count, struct tally *tally)
{
    size_t worst = g->count;

    for (size_t i = 0; i < g->count; i++)
        tally[i].with = tally[i].against = 0;
    for (size_t i = 0; i < count; i++)
        for (size_t k = 0; k < 3; k++) {
            const struct triangle *t = &triangles[i];

            if (tally[t->node[0]].out || tally[t->node[1]].out || tally[t->node[2]].out)
                continue;
            tally[t->node[k]].with += t->says > 0;
            tally[t->node[k]].against += t->says < 0;
        }
    for (size_t i = 0; i < g->count; i++)
        if (3 * tally[i].against > tally[i].with &&
            (worst == g->count || tally[i].against > tally[worst].against))
            worst = i;
    return worst;
}

/* Leaves contradicted sections out, the worst first, until the triangles of the others close; their
 * edges are sure. */
static int close_triangles(struct graph *g, struct gsn_error *err)
{
    gsn_auto_mem(struct triangle) triangles = gsn_alloc_array(REACH * g->count, sizeof *triangles);
    gsn_auto_mem(struct tally) tally = gsn_alloc_array(g->count, sizeof *tally);
    size_t count, worst;

    if (!triangles || !tally)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying %zu sections by their tissue",
                        g->count);
    count = list_triangles(g, triangles);
    while ((worst = most_contradicted(g, triangles, count, tally)) < g->count)
        tally[worst].out = 1;
    for (size_t i = 0; i < count; i++) {
        const struct triangle *t = &triangles[i];

        if (t->says <= 0 || tally[t->node[0]].out || tally[t->node[1]].out || tally[t->node[2]].out)
            continue;
        for (size_t k = 0; k < 3; k++)
            t->side[k]->sure = 1;
    }
    return GSN_OK;
}

/* What is usual at each distance; it does not fall with it. */
static void learn_factors(struct graph *g)
{
    double least = 1;

    for (size_t far = 1; far <= REACH; far++) {
        size_t n = 0;

        for (size_t i = 0; i < g->edges; i++)
            if (g->edge[i].far == far)
                g->room[n++] = g->edge[i].effect;
        least = fmax(least, n > 0 ? gsn_median(g->room, n) : 1);
        g->factor[far] = least;
    }
}

/* ---- First places ------------------------------------------------------------------------- */

static void place_node(struct graph *g, const struct edge *e)
{
    struct node *a = &g->node[e->a], *b = &g->node[e->b];

    if (a->placed) {
        const struct gsn_affine back = gsn_affine_inverse(&e->match.a_to_b);

        b->to_block = gsn_affine_compose(&back, &a->to_block);
        b->sure = a->sure && e->sure;
        b->placed = 1;
    } else {
        a->to_block = gsn_affine_compose(&e->match.a_to_b, &b->to_block);
        a->sure = b->sure && e->sure;
        a->placed = 1;
    }
}

/* Whether an edge leads on from a sure section and is sure itself. */
static int leads_surely(const struct graph *g, const struct edge *e)
{
    return e->sure && (g->node[e->a].placed ? g->node[e->a].sure : g->node[e->b].sure);
}

/* From what is placed outwards, always along the edge that is most certain. */
static void place_all(struct graph *g)
{
    for (;;) {
        const struct edge *best = NULL;
        int best_sure = 0;

        for (size_t i = 0; i < g->edges; i++) {
            const struct edge *e = &g->edge[i];
            int sure;

            if (g->node[e->a].placed == g->node[e->b].placed)
                continue;
            sure = leads_surely(g, e);
            if (!best || sure > best_sure ||
                (sure == best_sure && e->match.evidence > best->match.evidence)) {
                best = e;
                best_sure = sure;
            }
        }
        if (!best)
            return;
        place_node(g, best);
    }
}

static size_t reached_from(struct graph *g, size_t i)
{
    size_t reached = 0;

    for (size_t k = 0; k < g->count; k++)
        g->node[k].placed = 0;
    g->node[i].placed = g->node[i].sure = 1;
    place_all(g);
    for (size_t k = 0; k < g->count; k++)
        reached += g->node[k].placed && g->node[k].sure;
    return reached;
}

/* The middle section of the most that surely hang together. */
static size_t choose_reference(struct graph *g)
{
    size_t best = 0, most = 0, left;

    for (size_t i = 0; i < g->count && most <= g->count / 2; i++) {
        const size_t reached = g->section[i].tissue ? reached_from(g, i) : 0;

        if (reached > most) {
            most = reached;
            best = i;
        }
    }
    (void)reached_from(g, best);
    left = most / 2;
    for (size_t i = 0; i < g->count; i++)
        if (g->node[i].placed && g->node[i].sure && left-- == 0)
            return i;
    return best;
}

static void set_anchor(struct node *n, const struct gsn_affine *at, double information[3][3])
{
    n->held = n->placed = n->sure = 1;
    n->hold = n->to_block = *at;
    memcpy(n->holding, information, sizeof n->holding);
}

static size_t anchor_marked(struct graph *g)
{
    size_t held = 0;

    for (size_t i = 0; i < g->count; i++) {
        const struct gsn_tissue_section *s = &g->section[i];
        double a[3][3] = { { 0 } };

        if (!s->marked || !s->tissue)
            continue;
        memcpy(a, s->covariance, sizeof a);
        if (gsn_invert_spd(&a[0][0], 3, 3) < 0)
            continue;
        set_anchor(&g->node[i], &s->to_block, a);
        held++;
    }
    return held;
}

static void anchor_reference(struct graph *g, size_t at)
{
    struct node *n = &g->node[at];
    const struct gsn_affine unmoved = { 1, 0, 0, 0, 1, 0 };
    const double size = pow(HELD * n->radius, -2);
    double information[3][3] = { { size, 0, 0 }, { 0, size, 0 }, { 0, 0, pow(HELD, -2) } };

    for (size_t i = 0; i < g->count; i++)
        g->node[i].placed = 0;
    set_anchor(n, &unmoved, information);
}

/* Edges that put their sections elsewhere than the surer ones are compared again from there.
 */
static int compare_again(struct graph *g, struct gsn_error *err)
{
    for (size_t i = 0; i < g->edges; i++) {
        struct edge *e = &g->edge[i];
        const struct node *a = &g->node[e->a], *b = &g->node[e->b];
        struct gsn_affine back, start;
        struct edge again = *e;
        int r;

        if (!a->placed || !b->placed)
            continue;
        back = gsn_affine_inverse(&b->to_block);
        start = gsn_affine_compose(&a->to_block, &back);
        if (is_one_motion(a, &start, &e->match.a_to_b))
            continue;
        e->dropped = 1;
        r = gsn_tissue_refine(g->section[e->a].tissue, g->section[e->b].tissue, &start,
                              &again.match, err);
        if (r == GSN_E_NOMEM)
            return r;
        if (r < 0 || !is_one_motion(a, &start, &again.match.a_to_b) || !judge_edge(g, &again))
            continue;
        again.sure = again.dropped = 0;
        *e = again;
    }
    return GSN_OK;
}

static int is_usable(const struct graph *g, const struct edge *e)
{
    return !e->dropped && g->node[e->a].placed && g->node[e->b].placed;
}

/* ---- Normal equations --------------------------------------------------------------------- */

static double *find_entry(const struct graph *g, size_t i, size_t j)
{
    return &g->a[j * g->wide + (i - j)];
}

static double rotation_of(const struct gsn_affine *m)
{
    return atan2(-m->m01, m->m11);
}

/* Shift at p and turn from one place of a section to another. */
static void measure_residual(const struct gsn_affine *from, const struct gsn_affine *onto,
                             struct gsn_point p, double ret[3])
{
    const struct gsn_point u = gsn_affine_apply(from, p), v = gsn_affine_apply(onto, p);

    ret[0] = v.x - u.x;
    ret[1] = v.y - u.y;
    ret[2] = remainder(rotation_of(onto) - rotation_of(from), 2 * M_PI);
}

/* From x, y, turn of a section's frame to the block's. */
static void rotate_to_block(const struct gsn_affine *m, double ret_j[3][3])
{
    const double j[3][3] = { { m->m00, m->m01, 0 },
                             { m->m10, m->m11, 0 },
                             { 0, 0, gsn_affine_det(m) < 0 ? -1 : 1 } };

    memcpy(ret_j, j, sizeof j);
}

static int edge_information(const struct graph *g, const struct edge *e, double ret[3][3])
{
    double j[3][3], half[3][3] = { 0 };

    rotate_to_block(&g->node[e->a].to_block, j);
    memset(ret, 0, 9 * sizeof ret[0][0]);
    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++)
            for (size_t k = 0; k < 3; k++)
                half[p][q] += g->factor[e->far] * j[p][k] * e->match.covariance[k][q];
    for (size_t p = 0; p < 3; p++)
        for (size_t q = 0; q < 3; q++)
            for (size_t k = 0; k < 3; k++)
                ret[p][q] += half[p][k] * j[q][k];
    return gsn_invert_spd(&ret[0][0], 3, 3);
}

/* How a motion that is left of an edge, b's word minus a's place at a's centre, follows from those
 * of a and b, each about its own centre. */
static void edge_jacobians(const struct graph *g, const struct edge *e, double ret_j[2][3][3])
{
    const struct node *a = &g->node[e->a], *b = &g->node[e->b];
    const struct gsn_point p = gsn_affine_apply(&a->to_block, a->centre);
    const struct gsn_point q = gsn_affine_apply(&b->to_block, b->centre);
    const double j[2][3][3] = { { { -1, 0, 0 }, { 0, -1, 0 }, { 0, 0, -1 } },
                                { { 1, 0, -(p.y - q.y) }, { 0, 1, p.x - q.x }, { 0, 0, 1 } } };

    memcpy(ret_j, j, sizeof j);
}

/* Adds J^T w J of rows that touch one or two nodes. */
static void add_matrix(const struct graph *g, const size_t at[2], double j[2][3][3], size_t nodes,
                       double w[3][3])
{
    for (size_t u = 0; u < nodes; u++)
        for (size_t p = 0; p < 3; p++) {
            const size_t row = 3 * at[u] + p;

            for (size_t k = 0; k < 3; k++)
                for (size_t l = 0; l < 3; l++)
                    for (size_t v = 0; v < nodes; v++)
                        for (size_t q = 0; q < 3 && 3 * at[v] + q <= row; q++)
                            *find_entry(g, row, 3 * at[v] + q) += j[u][k][p] * w[k][l] * j[v][l][q];
        }
}

/* Adds J^T w left to x. */
static void add_side(const size_t at[2], double j[2][3][3], size_t nodes, double w[3][3],
                     const double left[3], double *x)
{
    for (size_t u = 0; u < nodes; u++)
        for (size_t p = 0; p < 3; p++)
            for (size_t k = 0; k < 3; k++)
                for (size_t l = 0; l < 3; l++)
                    x[3 * at[u] + p] += j[u][k][p] * w[k][l] * left[l];
}

/* The information that an edge has in the graph; 0 where it has none. */
static int edge_weight(const struct graph *g, const struct edge *e, double ret_w[3][3])
{
    if (!is_usable(g, e) || edge_information(g, e, ret_w) < 0)
        return 0;
    for (size_t k = 0; k < 3; k++)
        for (size_t l = 0; l < 3; l++)
            ret_w[k][l] *= e->weight;
    return 1;
}

static void add_edge(struct graph *g, struct edge *e)
{
    const struct node *a = &g->node[e->a], *b = &g->node[e->b];
    const struct gsn_affine by_b = gsn_affine_compose(&e->match.a_to_b, &b->to_block);
    const size_t at[2] = { e->a, e->b };
    double j[2][3][3], w[3][3], left[3];

    if (!is_usable(g, e) || edge_information(g, e, w) < 0)
        return;
    measure_residual(&a->to_block, &by_b, a->centre, left);
    e->chi2 = gsn_quadratic_form(&w[0][0], 3, left);
    e->weight = HALF / (HALF + e->chi2);
    (void)edge_weight(g, e, w);
    edge_jacobians(g, e, j);
    add_matrix(g, at, j, 2, w);
    add_side(at, j, 2, w, left, g->b);
}

static void add_anchor(struct graph *g, size_t i)
{
    struct node *n = &g->node[i];
    const size_t at[2] = { i, i };
    double j[2][3][3] = { { { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 } } };
    double left[3];

    if (!n->placed)
        for (size_t p = 0; p < 3; p++)
            *find_entry(g, 3 * i + p, 3 * i + p) += 1;
    if (!n->placed || !n->held)
        return;
    measure_residual(&n->hold, &n->to_block, n->centre, left);
    add_matrix(g, at, j, 1, n->holding);
    add_side(at, j, 1, n->holding, left, g->b);
}

/* Assembles and factorises. */
static int assemble_normal(struct graph *g, struct gsn_error *err)
{
    memset(g->a, 0, 3 * g->count * g->wide * sizeof *g->a);
    memset(g->b, 0, 3 * g->count * sizeof *g->b);
    for (size_t i = 0; i < g->edges; i++)
        add_edge(g, &g->edge[i]);
    for (size_t i = 0; i < g->count; i++)
        add_anchor(g, i);
    return gsn_band_cholesky(g->a, 3 * g->count, g->wide) < 0
               ? gsn_fail(err, GSN_E_FIT,
                          "the comparisons of %zu sections do not say where each lies", g->count)
               : GSN_OK;
}

/* Takes a step off. */
static void move_node(struct node *n, const double by[3])
{
    const struct gsn_point c = gsn_affine_apply(&n->to_block, n->centre);
    const double co = cos(by[2]), si = -sin(by[2]);
    const struct gsn_affine turn = { co, -si, c.x - by[0] - co * c.x + si * c.y,
                                     si, co,  c.y - by[1] - si * c.x - co * c.y };

    n->to_block = gsn_affine_compose(&n->to_block, &turn);
}

/* The factor under which the edges' chi-squared is what is usual: each leaves only the share of 3
 * degrees of freedom that the unknowns did not take. */
static void close_ways(struct graph *g)
{
    size_t n = 0, unknown = 0, holds = 0;
    double more;

    for (size_t i = 0; i < g->edges; i++)
        if (is_usable(g, &g->edge[i]))
            g->room[n++] = g->edge[i].chi2;
    for (size_t i = 0; i < g->count; i++) {
        unknown += g->node[i].placed != 0;
        holds += g->node[i].placed && g->node[i].held;
    }
    if (n + holds <= unknown)
        return;
    more = gsn_median(g->room, n) * (double)(n + holds) /
           (MEDIAN_CHI2 * (double)(n + holds - unknown));
    for (size_t far = 1; far <= REACH; far++)
        g->factor[far] *= fmax(more, 1);
}

static int optimise_poses(struct graph *g, struct gsn_error *err)
{
    for (int round = 0; round < ROUNDS; round++) {
        const int r = assemble_normal(g, err);

        if (r < 0)
            return r;
        gsn_band_solve(g->a, 3 * g->count, g->wide, g->b);
        for (size_t i = 0; i < g->count; i++)
            if (g->node[i].placed)
                move_node(&g->node[i], &g->b[3 * i]);
    }
    return assemble_normal(g, err);
}

/* ---- Errors ------------------------------------------------------------------------------- */

/* Where all sections' tissue lies in the block, and how far it reaches. */
static struct gsn_affine block_grid(const struct graph *g)
{
    const struct gsn_affine still = { 1, 0, 0, 0, 1, 0 };
    struct gsn_point centre = { 0, 0 };
    double radius = 0, n = 0;

    for (size_t i = 0; i < g->count; i++) {
        const struct node *node = &g->node[i];
        const struct gsn_point at = gsn_affine_apply(&node->to_block, node->centre);

        if (!node->placed)
            continue;
        centre.x += at.x;
        centre.y += at.y;
        radius += node->radius;
        n++;
    }
    return make_grid(&still, (struct gsn_point){ centre.x / n, centre.y / n }, radius / n);
}

/* Adds what one edge's columns pull to each column's right side. */
static void add_pulls(const struct graph *g, const struct edge *e, const struct gsn_affine *grid,
                      double *side)
{
    const struct gsn_affine to_grid = gsn_affine_compose(&g->node[e->a].to_block, grid);
    const size_t at[2] = { e->a, e->b };
    double pull[GSN_TISSUE_COLUMNS][3], j[2][3][3], w[3][3], turn[3][3];

    if (!edge_weight(g, e, w))
        return;
    (void)measure_pulls(g, e, &to_grid, pull);
    edge_jacobians(g, e, j);
    rotate_to_block(&g->node[e->a].to_block, turn);
    for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++) {
        double in_block[3] = { 0 };

        for (size_t p = 0; p < 3; p++)
            for (size_t q = 0; q < 3; q++)
                in_block[p] += turn[p][q] * pull[k][q];
        add_side(at, j, 2, w, in_block, side + k * 3 * g->count);
    }
}

static double average_over_tissue(const struct node *n, const double variance[3])
{
    return variance[0] + variance[1] + variance[2] * n->radius * n->radius;
}

/* Mean square over a section's tissue by what the columns pull. */
static void add_column_errors(const struct graph *g, const double *side, size_t columns,
                              double more)
{
    const double share = more * (double)columns / fmax((double)columns - 1, 1);

    for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++)
        for (size_t i = 0; i < g->count; i++) {
            const double *x = side + 3 * (k * g->count + i);
            const double square[3] = { x[0] * x[0], x[1] * x[1], x[2] * x[2] };

            g->node[i].error += share * average_over_tissue(&g->node[i], square);
        }
}

/* And by the marks' own errors. */
static void add_mark_errors(const struct graph *g)
{
    for (size_t i = 0; i < g->count; i++) {
        double variance[3] = { 0 };

        for (size_t p = 0; g->node[i].placed && p < 3; p++) {
            memset(g->b, 0, 3 * g->count * sizeof *g->b);
            g->b[3 * i + p] = 1;
            gsn_band_solve(g->a, 3 * g->count, g->wide, g->b);
            for (size_t k = 0; k < g->count; k++)
                if (g->node[k].held)
                    variance[p] += gsn_quadratic_form(&g->node[k].holding[0][0], 3, &g->b[3 * k]);
        }
        g->node[i].error += average_over_tissue(&g->node[i], variance);
    }
}

/* more: by how much the closed ways leave more than the columns tell. */
static int learn_errors(struct graph *g, double more, struct gsn_error *err)
{
    gsn_auto_mem(double) side = gsn_alloc_array(3 * g->count * GSN_TISSUE_COLUMNS, sizeof *side);
    const struct gsn_affine grid = block_grid(g);
    size_t columns = 0;

    if (!side)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying %zu sections by their tissue",
                        g->count);
    for (size_t i = 0; i < g->edges; i++)
        add_pulls(g, &g->edge[i], &grid, side);
    for (size_t k = 0; k < GSN_TISSUE_COLUMNS; k++) {
        double *x = side + k * 3 * g->count;
        int any = 0;

        for (size_t i = 0; i < 3 * g->count; i++)
            any |= x[i] != 0;
        columns += any != 0;
        gsn_band_solve(g->a, 3 * g->count, g->wide, x);
    }
    add_column_errors(g, side, columns, more);
    add_mark_errors(g);
    for (size_t i = 0; i < g->count; i++)
        g->node[i].error = sqrt(g->node[i].error);
    return GSN_OK;
}

/* ---- Telling ------------------------------------------------------------------------------ */

static unsigned count_to_anchor(const struct graph *g, size_t i)
{
    unsigned least = (unsigned)-1;

    for (size_t k = 0; k < g->count; k++) {
        const unsigned a = g->section[i].serial, b = g->section[k].serial;
        const unsigned far = a > b ? a - b : b - a;

        if (g->node[k].held && far < least)
            least = far;
    }
    return least;
}

static double usual_error(const struct graph *g)
{
    size_t n = 0;

    for (size_t i = 0; i < g->edges; i++) {
        const struct edge *e = &g->edge[i];
        const double variance[3] = { e->match.covariance[0][0], e->match.covariance[1][1],
                                     e->match.covariance[2][2] };

        if (is_usable(g, e) && e->far == 1)
            g->room[n++] = sqrt(g->factor[1] * average_over_tissue(&g->node[e->a], variance));
    }
    return n > 0 ? gsn_median(g->room, n) : 0;
}

/* The mean disagreement of its comparisons that others do not explain: root of chi2 over its 3. */
static double measure_disagreement(const struct graph *g, size_t i)
{
    double sum = 0;
    size_t n = 0;

    for (size_t k = 0; k < g->edges; k++) {
        const struct edge *e = &g->edge[k];

        if (is_usable(g, e) && (e->a == i || e->b == i)) {
            sum += e->chi2 / 3;
            n++;
        }
    }
    return n > 0 ? sqrt(sum / (double)n) : 0;
}

static void summarise_graph(const struct graph *g, struct gsn_tissue_summary *summary,
                            struct gsn_tissue_pose *ret_poses)
{
    summary->matches = g->edges;
    summary->usual = usual_error(g);
    for (size_t i = 0; i < g->edges; i++)
        summary->refused += !is_usable(g, &g->edge[i]) || g->edge[i].weight < 0.25;
    for (size_t i = 0; i < g->count; i++) {
        const struct node *n = &g->node[i];
        struct gsn_tissue_pose *pose = &ret_poses[i];

        *pose = (struct gsn_tissue_pose){ .laid = n->placed };
        if (!n->placed)
            continue;
        summary->laid++;
        pose->to_block = n->to_block;
        pose->from = count_to_anchor(g, i);
        pose->error = n->error;
        pose->disagrees = n->held ? measure_disagreement(g, i) : 0;
        pose->unsure = !n->held && !n->sure;
        if (pose->from > 0)
            summary->drift = fmax(summary->drift, pose->error / pose->from);
    }
}

static int solve_graph(struct graph *g, size_t reference, struct gsn_tissue_pose *ret_poses,
                       struct gsn_tissue_summary *ret_summary, struct gsn_error *err)
{
    struct gsn_tissue_summary summary = { 0 };
    gsn_auto_mem(double) a = NULL;
    double columns_alone;
    int r = compare_all(g, err);

    if (r < 0)
        return r;
    g->wide = 3;
    for (size_t i = 0; i < g->edges; i++)
        if (3 * (g->edge[i].b - g->edge[i].a) + 3 > g->wide)
            g->wide = 3 * (g->edge[i].b - g->edge[i].a) + 3;
    a = gsn_alloc_array(3 * g->count, g->wide * sizeof *a);
    if (!a)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying %zu sections by their tissue",
                        g->count);
    g->a = a;
    r = close_triangles(g, err);
    if (r < 0)
        return r;
    learn_factors(g);
    summary.held = anchor_marked(g);
    if (summary.held == 0) {
        summary.reference = reference == GSN_TISSUE_MIDDLE ? choose_reference(g) : reference;
        anchor_reference(g, summary.reference);
    }
    place_all(g);
    r = compare_again(g, err);
    if (r < 0)
        return r;
    columns_alone = g->factor[1];
    r = optimise_poses(g, err);
    if (r < 0)
        return r;
    close_ways(g);
    r = optimise_poses(g, err);
    if (r >= 0)
        r = learn_errors(g, g->factor[1] / columns_alone, err);
    if (r < 0)
        return r;
    summarise_graph(g, &summary, ret_poses);
    *ret_summary = summary;
    return GSN_OK;
}

int gsn_tissue_register(const struct gsn_tissue_section *sections, size_t count, size_t reference,
                        struct gsn_tissue_pose *ret_poses, struct gsn_tissue_summary *ret_summary,
                        struct gsn_error *err)
{
    gsn_auto_mem(struct node) node = gsn_alloc_array(count, sizeof *node);
    gsn_auto_mem(struct edge) edge = gsn_alloc_array(REACH * count, sizeof *edge);
    gsn_auto_mem(double) b = gsn_alloc_array(3 * count, sizeof *b);
    gsn_auto_mem(double) room = gsn_alloc_array(REACH * count, sizeof *room);
    struct graph g = {
        .section = sections, .count = count, .node = node, .edge = edge, .b = b, .room = room
    };

    assert(sections && ret_poses && ret_summary);
    assert(reference == GSN_TISSUE_MIDDLE || (reference < count && sections[reference].tissue));

    for (size_t i = 1; i < count; i++)
        if (sections[i].serial <= sections[i - 1].serial)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %u comes after section %u: serial numbers must rise",
                            sections[i].serial + 1, sections[i - 1].serial + 1);
    if (!node || !edge || !b || !room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying %zu sections by their tissue",
                        count);
    for (size_t i = 0; i < count; i++)
        if (sections[i].tissue) {
            node[i].centre = gsn_tissue_centre(sections[i].tissue);
            node[i].radius = gsn_tissue_radius(sections[i].tissue);
        }
    return solve_graph(&g, reference, ret_poses, ret_summary, err);
}
