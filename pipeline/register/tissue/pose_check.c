/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Checks where marks put a section against the tissue of its neighbours.
 *
 * Steps: (1) each section is compared, from the place of its marks, with up to two neighbours on
 * either side in the two coarse bands; each that fits is a vote for a place. The vote nearest to
 * most others is the section's. (2) Medians over the stack say what evidence and what distance from
 * the marks are usual. (3) A section that fits worse or lies farther off than that is searched for
 * at all rotations and on both faces; another place takes over where it fits clearly better. (4)
 * What is beyond the length that one in a million of three normal numbers has, scaled by the
 * stack's median or by how far the votes disagree, is contradicted.
 *
 * Fewer than six sections that can be compared show nothing usual, and nothing is told. Fails when
 * memory runs out. */
#include "pipeline/register/tissue/pose_check.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/tissue/pairwise.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Neighbours on either side, how far off they may be, and the sections that make a stack. */
enum { SIDE = 2, VOTES = 2 * SIDE, REACH = 4, FEWEST = 6 };

/* The length of three normal numbers that one in a million surpasses, over their median length. */
static const double CHANCE = 3.6;
/* Fits with less than this share of the usual evidence are worth a search. */
static const double POOR = 0.5;

/* Votes of less evidence than this say nothing: chance alone gives as much. */
static const double LEAST_EVIDENCE = 24;

/* Another place takes over with so many times the evidence: an outline alone, which fits in many
 * ways, gives all of them about the same. Right motions have 1.6 times that of the best other and
 * more; two sections of other blocks with like outlines reach 1.5 in one case of forty. */
static const double BETTER = 1.5;

/* Where one neighbour's tissue puts a section. */
struct vote {
    size_t of;
    struct gsn_affine to_block;
    double evidence;
};

struct look {
    struct vote vote[VOTES];
    size_t votes, fit;         /* fit: of them with more evidence than chance */
    const struct vote *middle; /* the one nearest to most others */
    double apart, spread;      /* of it from the marks' place, and from most others */
    double evidence;           /* of the middle vote */
};

struct check {
    const struct gsn_tissue_section *section;
    size_t count;
    struct look *look;
    double *room;
    double usual, evidence; /* medians over the stack */
};

static int is_usable(const struct gsn_tissue_section *s)
{
    return s->marked && s->tissue;
}

/* ---- Around the marks' place -------------------------------------------------------------- */

static void add_vote(struct look *look, size_t of, const struct gsn_affine *to_block,
                     double evidence)
{
    look->vote[look->votes++] = (struct vote){ of, *to_block, evidence };
}

static void compare_pair(struct check *c, size_t a, size_t b)
{
    const struct gsn_tissue_section *s = c->section;
    const struct gsn_affine from_b = gsn_affine_inverse(&s[b].to_block);
    const struct gsn_affine start = gsn_affine_compose(&s[a].to_block, &from_b);
    struct gsn_affine motion, back, place;
    double evidence;

    gsn_tissue_refine_coarse(s[a].tissue, s[b].tissue, &start, &motion, &evidence);
    place = gsn_affine_compose(&motion, &s[b].to_block);
    add_vote(&c->look[a], b, &place, evidence);
    back = gsn_affine_inverse(&motion);
    place = gsn_affine_compose(&back, &s[a].to_block);
    add_vote(&c->look[b], a, &place, evidence);
}

static void compare_all(struct check *c)
{
    for (size_t a = 0; a < c->count; a++) {
        size_t found = 0;

        for (size_t b = a + 1; is_usable(&c->section[a]) && b < c->count && found < SIDE &&
                               c->section[b].serial - c->section[a].serial <= REACH;
             b++)
            if (is_usable(&c->section[b])) {
                compare_pair(c, a, b);
                found++;
            }
    }
}

/* ---- What the votes say ------------------------------------------------------------------- */

/* Of four votes that within which three lie, one of them the vote itself; of three, two; of two,
 * both. */
static double measure_spread(const struct gsn_tissue *t, const struct look *look,
                             const struct vote *middle)
{
    double far[VOTES];
    size_t count = 0;

    for (size_t i = 0; i < look->votes; i++) {
        const struct vote *v = &look->vote[i];
        double d;
        size_t k = count;

        if (v->evidence < LEAST_EVIDENCE)
            continue;
        d = gsn_tissue_apart(gsn_tissue_centre(t), gsn_tissue_radius(t), &v->to_block,
                             &middle->to_block);
        for (; k > 0 && far[k - 1] > d; k--)
            far[k] = far[k - 1];
        far[k] = d;
        count++;
    }
    return far[count / 2];
}

static void weigh_votes(const struct check *c, size_t i)
{
    const struct gsn_tissue_section *s = &c->section[i];
    struct look *look = &c->look[i];
    double evidence[VOTES];

    look->middle = NULL;
    look->fit = 0;
    for (size_t k = 0; k < look->votes; k++) {
        const struct vote *v = &look->vote[k];
        double spread;

        evidence[k] = v->evidence;
        if (v->evidence < LEAST_EVIDENCE)
            continue;
        look->fit++;
        spread = measure_spread(s->tissue, look, v);
        if (!look->middle || spread < look->spread) {
            look->middle = v;
            look->spread = spread;
        }
    }
    look->evidence = look->votes > 0 ? gsn_median(evidence, look->votes) : 0;
    look->apart = look->middle
                      ? gsn_tissue_apart(gsn_tissue_centre(s->tissue), gsn_tissue_radius(s->tissue),
                                         &look->middle->to_block, &s->to_block)
                      : 0;
}

/* Most of its neighbours, two at least, have something to say of it. */
static int is_told(const struct look *look)
{
    return look->fit >= 2 && 2 * look->fit > look->votes;
}

/* What is usual in this stack; 0 when too few sections show it. */
static int learn_usual(struct check *c)
{
    size_t count = 0, told_of = 0;

    for (size_t i = 0; i < c->count; i++)
        if (c->look[i].votes >= 2)
            c->room[count++] = c->look[i].evidence;
    if (count < FEWEST)
        return 0;
    c->evidence = gsn_median(c->room, count);
    for (size_t i = 0; i < c->count; i++)
        if (is_told(&c->look[i]))
            c->room[told_of++] = c->look[i].apart;
    if (told_of < FEWEST)
        return 0;
    c->usual = gsn_median(c->room, told_of);
    return 1;
}

/* ---- At all rotations and on both faces --------------------------------------------------- */

/* Where all neighbours put the section near this place; the sum of their evidence. */
static double try_place(const struct check *c, size_t i, const struct gsn_affine *place,
                        struct vote ret_vote[VOTES])
{
    const struct gsn_tissue_section *s = c->section;
    const struct look *look = &c->look[i];
    double sum = 0;

    for (size_t k = 0; k < look->votes; k++) {
        const size_t of = look->vote[k].of;
        const struct gsn_affine from_it = gsn_affine_inverse(&s[of].to_block);
        const struct gsn_affine start = gsn_affine_compose(place, &from_it);
        struct gsn_affine motion;

        gsn_tissue_refine_coarse(s[i].tissue, s[of].tissue, &start, &motion, &ret_vote[k].evidence);
        ret_vote[k].of = of;
        ret_vote[k].to_block = gsn_affine_compose(&motion, &s[of].to_block);
        sum += ret_vote[k].evidence;
    }
    return sum;
}

/* The votes near the place that all neighbours together like best, among those that one of them
 * likes best, where they like it clearly better than the marks'. */
static int search_place(struct check *c, size_t i, struct gsn_error *err)
{
    const struct gsn_tissue_section *s = c->section;
    struct look *look = &c->look[i];
    struct vote best[VOTES];
    double most = 0;

    for (size_t k = 0; k < look->votes; k++)
        most += BETTER * look->vote[k].evidence;
    memcpy(best, look->vote, sizeof best);
    for (size_t k = 0; k < look->votes; k++) {
        const struct gsn_tissue_section *other = &s[look->vote[k].of];
        struct gsn_tissue_match match;
        struct gsn_error own = { 0 };
        struct gsn_affine place;
        struct vote vote[VOTES];
        double sum;
        const int r = gsn_tissue_search(s[i].tissue, other->tissue, &match, &own);

        if (r == GSN_E_NOMEM)
            return gsn_fail(err, r, "%s", own.text);
        if (r < 0)
            continue;
        place = gsn_affine_compose(&match.a_to_b, &other->to_block);
        sum = try_place(c, i, &place, vote);
        if (sum <= most)
            continue;
        most = sum;
        memcpy(best, vote, look->votes * sizeof *vote);
    }
    memcpy(look->vote, best, sizeof best);
    weigh_votes(c, i);
    return GSN_OK;
}

static void judge_section(const struct check *c, size_t i, struct gsn_tissue_finding *ret_finding)
{
    const struct gsn_tissue_section *s = &c->section[i];
    const struct look *look = &c->look[i];
    const double radius = gsn_tissue_radius(s->tissue);
    const double marks =
        sqrt(s->covariance[0][0] + s->covariance[1][1] + s->covariance[2][2] * radius * radius);

    if (!is_told(look))
        return;
    ret_finding->compared = (unsigned)look->fit;
    ret_finding->apart = look->apart;
    ret_finding->limit = CHANCE * hypot(hypot(c->usual, look->spread), marks);
    ret_finding->contradicted = look->apart > ret_finding->limit;
    ret_finding->other_face =
        ret_finding->contradicted &&
        gsn_affine_det(&look->middle->to_block) * gsn_affine_det(&s->to_block) < 0;
}

static int check_all(struct check *c, struct gsn_tissue_finding *ret_findings,
                     struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < c->count; i++) {
        const struct look *look = &c->look[i];

        if (look->votes < 2)
            continue;
        if (look->evidence < POOR * c->evidence || look->apart > CHANCE * c->usual)
            r = search_place(c, i, err);
        if (r >= 0)
            judge_section(c, i, &ret_findings[i]);
    }
    return r;
}

int gsn_tissue_check(const struct gsn_tissue_section *sections, size_t count,
                     struct gsn_tissue_finding *ret_findings, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_tissue_finding) found = gsn_alloc_array(count, sizeof *found);
    gsn_auto_mem(struct look) look = gsn_alloc_array(count, sizeof *look);
    gsn_auto_mem(double) room = gsn_alloc_array(count, sizeof *room);
    struct check c = { .section = sections, .count = count, .look = look, .room = room };
    int r = GSN_OK;

    assert(sections && ret_findings);

    for (size_t i = 1; i < count; i++)
        if (sections[i].serial <= sections[i - 1].serial)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %u comes after section %u: serial numbers must rise",
                            sections[i].serial + 1, sections[i - 1].serial + 1);
    if (!found || !look || !room)
        return gsn_fail(err, GSN_E_NOMEM,
                        "out of memory for holding %zu sections against their tissue", count);
    compare_all(&c);
    for (size_t i = 0; i < count; i++)
        weigh_votes(&c, i);
    if (learn_usual(&c))
        r = check_all(&c, found, err);
    if (r >= 0)
        memcpy(ret_findings, found, count * sizeof *found);
    return r;
}
