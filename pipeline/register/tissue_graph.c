/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/tissue_graph.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/median.h"
#include "pipeline/register/tissue_evidence.h"
#include "pipeline/register/tissue_springs.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Each section is compared with this many after it. */
enum { REACH = 2 };

/* The reference is held as if it were known to a millionth of its size. */
static const double HELD = 1e-6;

/* ---- Comparing ---------------------------------------------------------------------------- */

struct work {
    const struct gsn_tissue_section *section;
    struct gsn_tissue_springs springs;
    char *unsure; /* for each spring */
};

static struct gsn_tissue_spring *spring_of(const struct work *w, size_t a, size_t b)
{
    for (size_t i = w->springs.springs; i-- > 0;)
        if (w->springs.spring[i].a == a && w->springs.spring[i].b == b)
            return &w->springs.spring[i];
    return NULL;
}

/* A start for a on b from what is known: their marks, or the way over a section between. */
static int start_of(const struct work *w, size_t a, size_t b, struct gsn_affine *ret_start)
{
    const struct gsn_tissue_section *s = w->section;

    if (s[a].marked && s[b].marked) {
        const struct gsn_affine back = gsn_affine_inverse(&s[b].to_block);

        *ret_start = gsn_affine_compose(&s[a].to_block, &back);
        return 1;
    }
    for (size_t k = a + 1; k < b; k++) {
        const struct gsn_tissue_spring *first = spring_of(w, a, k), *second = spring_of(w, k, b);

        if (first && second) {
            *ret_start = gsn_affine_compose(&first->match.a_to_b, &second->match.a_to_b);
            return 1;
        }
    }
    return 0;
}

static int compare(struct work *w, size_t a, size_t b, struct gsn_error *err)
{
    const struct gsn_tissue *ta = w->section[a].tissue, *tb = w->section[b].tissue;
    struct gsn_tissue_match match;
    struct gsn_affine start;
    int r, searched = 0;

    if (start_of(w, a, b, &start)) {
        r = gsn_tissue_refine(ta, tb, &start, &match, err);
    } else {
        r = gsn_tissue_search(ta, tb, &match, err);
        searched = 1;
    }
    if (r == GSN_E_NOMEM)
        return r;
    if (r < 0 || match.evidence < GSN_TISSUE_LEAST_EVIDENCE)
        return GSN_OK;
    w->unsure[w->springs.springs] = searched && match.coarse < GSN_TISSUE_SURE * match.rival;
    w->springs.spring[w->springs.springs++] =
        (struct gsn_tissue_spring){ .a = a, .b = b, .match = match, .weight = 1 };
    return GSN_OK;
}

/* Neighbours first, so that those further apart start from the way over them. Further neighbours
 * are also those on both sides of one that is not there. */
static int compare_all(struct work *w, size_t count, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t far = 1; far <= REACH; far++)
        for (size_t a = 0; r >= 0 && a + far < count; a++) {
            size_t b = a;

            for (size_t found = 0; found < far && b < count;)
                if (++b < count && w->section[b].tissue)
                    found++;
            if (b < count && w->section[a].tissue)
                r = compare(w, a, b, err);
        }
    return r;
}

/* ---- First places ------------------------------------------------------------------------- */

static void place(struct work *w, const struct gsn_tissue_spring *spring)
{
    struct gsn_tissue_node *a = &w->springs.node[spring->a], *b = &w->springs.node[spring->b];

    if (a->placed) {
        const struct gsn_affine back = gsn_affine_inverse(&spring->match.a_to_b);

        b->to_block = gsn_affine_compose(&back, &a->to_block);
        b->placed = 1;
    } else {
        a->to_block = gsn_affine_compose(&spring->match.a_to_b, &b->to_block);
        a->placed = 1;
    }
}

/* From what is placed outwards, always along the comparison that is most certain. */
static void spread(struct work *w)
{
    for (;;) {
        const struct gsn_tissue_spring *best = NULL;
        double most = -1;

        for (size_t i = 0; i < w->springs.springs; i++) {
            const struct gsn_tissue_spring *s = &w->springs.spring[i];
            /* What is unsure comes last, whatever its evidence. */
            const double evidence = w->unsure[i] ? 0 : s->match.evidence;

            if (w->springs.node[s->a].placed != w->springs.node[s->b].placed && evidence > most) {
                best = s;
                most = evidence;
            }
        }
        if (!best)
            return;
        place(w, best);
    }
}

static size_t reached_from(struct work *w, size_t i, size_t count)
{
    size_t reached = 0;

    for (size_t k = 0; k < count; k++)
        w->springs.node[k].placed = 0;
    w->springs.node[i].placed = 1;
    spread(w);
    for (size_t k = 0; k < count; k++)
        reached += w->springs.node[k].placed != 0;
    return reached;
}

/* The middle section of the most that hang together. */
static size_t choose_reference(struct work *w, size_t count)
{
    size_t best = 0, most = 0, left;

    for (size_t i = 0; i < count; i++) {
        const size_t reached = w->section[i].tissue ? reached_from(w, i, count) : 0;

        if (reached > most) {
            most = reached;
            best = i;
        }
        if (most > count / 2)
            break;
    }
    (void)reached_from(w, best, count);
    left = most / 2;
    for (size_t i = 0; i < count; i++)
        if (w->springs.node[i].placed && left-- == 0)
            return i;
    return best;
}

static void hold(struct gsn_tissue_node *n, const struct gsn_affine *at, double information[3][3])
{
    n->held = n->placed = 1;
    n->hold = n->to_block = *at;
    memcpy(n->holding, information, sizeof n->holding);
}

static int hold_marked(struct work *w, size_t count)
{
    int held = 0;

    for (size_t i = 0; i < count; i++) {
        const struct gsn_tissue_section *s = &w->section[i];
        double a[3][3] = { { 0 } };

        if (!s->marked || !s->tissue)
            continue;
        memcpy(a, s->covariance, sizeof a);
        if (gsn_tissue_invert(a) < 0)
            continue;
        hold(&w->springs.node[i], &s->to_block, a);
        held++;
    }
    return held;
}

static void hold_reference(struct work *w, size_t at)
{
    struct gsn_tissue_node *n = &w->springs.node[at];
    const struct gsn_affine unmoved = { 1, 0, 0, 0, 1, 0 };
    const double size = pow(HELD * n->radius, -2);
    double information[3][3] = { { size, 0, 0 }, { 0, size, 0 }, { 0, 0, pow(HELD, -2) } };

    hold(n, &unmoved, information);
}

/* ---- Telling ------------------------------------------------------------------------------ */

static int usable(const struct work *w, const struct gsn_tissue_spring *s)
{
    return s && !s->dropped && w->springs.node[s->a].placed && w->springs.node[s->b].placed;
}

/* How far two steps miss the double step, on the median of all: beyond what the curvature allows,
 * the same in all, it is a drift. */
static double drift_of(const struct work *w, size_t count, double *x, double *y)
{
    size_t n = 0;

    for (size_t a = 0; a + 2 < count; a++) {
        const struct gsn_tissue_spring *one = spring_of(w, a, a + 1),
                                       *two = spring_of(w, a + 1, a + 2);
        const struct gsn_tissue_spring *both = spring_of(w, a, a + 2);
        struct gsn_affine way;
        struct gsn_point u, v, at;

        if (!usable(w, one) || !usable(w, two) || !usable(w, both))
            continue;
        at = w->springs.node[a].centre;
        way = gsn_affine_compose(&one->match.a_to_b, &two->match.a_to_b);
        way = gsn_affine_compose(&way, &w->springs.node[a + 2].to_block);
        u = gsn_affine_apply(&way, at);
        way = gsn_affine_compose(&both->match.a_to_b, &w->springs.node[a + 2].to_block);
        v = gsn_affine_apply(&way, at);
        x[n] = v.x - u.x;
        y[n++] = v.y - u.y;
    }
    return n >= 3 ? hypot(gsn_median(x, n), gsn_median(y, n)) : 0;
}

static unsigned distance_of(const struct work *w, size_t i, size_t count)
{
    unsigned least = (unsigned)-1;

    for (size_t k = 0; k < count; k++) {
        const unsigned a = w->section[i].serial, b = w->section[k].serial;
        const unsigned far = a > b ? a - b : b - a;

        if (w->springs.node[k].held && far < least)
            least = far;
    }
    return least;
}

static double usual_of(const struct work *w, double *room)
{
    size_t n = 0;

    for (size_t i = 0; i < w->springs.springs; i++) {
        const struct gsn_tissue_spring *s = &w->springs.spring[i];
        const double radius = w->springs.node[s->a].radius;

        if (usable(w, s))
            room[n++] =
                sqrt(w->springs.factor * (s->match.covariance[0][0] + s->match.covariance[1][1] +
                                          s->match.covariance[2][2] * radius * radius));
    }
    return n > 0 ? gsn_median(room, n) : 0;
}

/* Whether all that ties this section to others is unsure, or a neighbour would have it on the other
 * face than it was laid on. */
static int is_unsure(const struct work *w, size_t i)
{
    int ties = 0, sure = 0, faces = 0;

    for (size_t k = 0; k < w->springs.springs; k++) {
        const struct gsn_tissue_spring *s = &w->springs.spring[k];

        if ((s->a != i && s->b != i) || s->b != s->a + 1)
            continue;
        faces += s->dropped;
        if (!usable(w, s))
            continue;
        ties++;
        sure += !w->unsure[k];
    }
    return (ties > 0 && sure == 0) || faces > 0;
}

/* The mean disagreement of its comparisons that others do not explain: root of chi2 over its 3. */
static double disagreement(const struct work *w, size_t i)
{
    double sum = 0;
    size_t n = 0;

    for (size_t k = 0; k < w->springs.springs; k++) {
        const struct gsn_tissue_spring *s = &w->springs.spring[k];

        if (usable(w, s) && (s->a == i || s->b == i)) {
            sum += s->chi2 / 3;
            n++;
        }
    }
    return n > 0 ? sqrt(sum / (double)n) : 0;
}

static void tell(const struct work *w, size_t count, const struct gsn_tissue_summary *summary,
                 struct gsn_tissue_pose *ret_poses)
{
    for (size_t i = 0; i < count; i++) {
        const struct gsn_tissue_node *n = &w->springs.node[i];
        struct gsn_tissue_pose *pose = &ret_poses[i];

        *pose = (struct gsn_tissue_pose){ .laid = n->placed };
        if (!n->placed)
            continue;
        pose->to_block = n->to_block;
        pose->from = distance_of(w, i, count);
        pose->error = hypot(n->error, summary->drift * pose->from);
        pose->disagrees = n->held ? disagreement(w, i) : 0;
        pose->unsure = !n->held && is_unsure(w, i);
    }
}

static void drop_other_faces(struct work *w)
{
    for (size_t i = 0; i < w->springs.springs; i++) {
        struct gsn_tissue_spring *s = &w->springs.spring[i];
        const struct gsn_tissue_node *a = &w->springs.node[s->a], *b = &w->springs.node[s->b];

        if (!a->placed || !b->placed)
            continue;
        s->dropped = gsn_affine_det(&a->to_block) * gsn_affine_det(&b->to_block) *
                         gsn_affine_det(&s->match.a_to_b) <
                     0;
    }
}

static void sum_up(struct work *w, size_t count, double *room, struct gsn_tissue_summary *summary)
{
    summary->usual = usual_of(w, room);
    summary->drift = drift_of(w, count, room, room + count);
    summary->matches = w->springs.springs;
    for (size_t i = 0; i < count; i++)
        summary->laid += w->springs.node[i].placed != 0;
    for (size_t i = 0; i < w->springs.springs; i++)
        summary->refused += !usable(w, &w->springs.spring[i]) || w->springs.spring[i].weight < 0.25;
}

static int lay(struct work *w, size_t count, double *room, struct gsn_tissue_pose *ret_poses,
               struct gsn_tissue_summary *ret_summary, struct gsn_error *err)
{
    struct gsn_tissue_summary summary = { 0 };
    int r = compare_all(w, count, err);

    if (r < 0)
        return r;
    summary.held = (size_t)hold_marked(w, count);
    if (summary.held == 0) {
        summary.reference = choose_reference(w, count);
        for (size_t i = 0; i < count; i++)
            w->springs.node[i].placed = 0;
        hold_reference(w, summary.reference);
    }
    spread(w);
    drop_other_faces(w);
    r = gsn_tissue_relax(&w->springs, err);
    if (r < 0)
        return r;
    sum_up(w, count, room, &summary);
    tell(w, count, &summary, ret_poses);
    *ret_summary = summary;
    return GSN_OK;
}

int gsn_tissue_lay(const struct gsn_tissue_section *sections, size_t count,
                   struct gsn_tissue_pose *ret_poses, struct gsn_tissue_summary *ret_summary,
                   struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_tissue_node) node = gsn_alloc_array(count, sizeof *node);
    gsn_auto_mem(struct gsn_tissue_spring) spring = gsn_alloc_array(REACH * count, sizeof *spring);
    gsn_auto_mem(char) unsure = gsn_alloc_array(REACH * count, 1);
    gsn_auto_mem(double) room = gsn_alloc_array(REACH * count, sizeof *room);
    struct work w = { sections,
                      { .node = node, .spring = spring, .nodes = count, .factor = 1 },
                      unsure };

    assert(sections && ret_poses && ret_summary);

    for (size_t i = 1; i < count; i++)
        if (sections[i].serial <= sections[i - 1].serial)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %u comes after section %u: serial numbers must rise",
                            sections[i].serial + 1, sections[i - 1].serial + 1);
    if (!node || !spring || !unsure || !room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for laying %zu sections by their tissue",
                        count);
    for (size_t i = 0; i < count; i++)
        if (sections[i].tissue) {
            node[i].centre = gsn_tissue_centre(sections[i].tissue);
            node[i].radius = gsn_tissue_radius(sections[i].tissue);
        }
    return lay(&w, count, room, ret_poses, ret_summary, err);
}
