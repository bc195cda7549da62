/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The poses that a doubtful section may have, and what a person meant by one of them.
 *
 * 1. A section has candidates where its panel leaves open which spots are its marks, or where its
 *    three marks contradict the stack: then each pair of them.
 * 2. Each is fitted to the triangle as a rigid motion, its error predicted by the typical mark of
 *    the stack, and what sets it apart from the first is put into words for a person.
 * 3. A person's choice names the spots, not a number, so it holds for as long as they are there.
 *
 * A candidate that cannot be laid stays as it is. */
#include "pipeline/specimen/candidates.h"

#include "pipeline/register/pose/rigid.h"
#include "pipeline/register/pose/weighted_fit.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* A spot is the one that was meant when it lies within this share of its radius. */
static const double SAME_SPOT = 0.5;

/* Two ways to lay a section that differ by less than this are turned alike, in words. */
static const double TOLD_DEG = 5;

static struct gsn_candidate candidate_of(const struct gsn_fiducial mark[GSN_FIDUCIALS],
                                         int mirrored, double share)
{
    struct gsn_candidate candidate = {
        .mirrored = mirrored, .flipped = mirrored, .share = share, .error_um = NAN
    };

    memcpy(candidate.mark, mark, sizeof candidate.mark);
    return candidate;
}

void gsn_candidates_of_rivals(const struct gsn_fiducial_hypothesis *rivals, size_t count,
                              struct gsn_candidates *ret_list)
{
    struct gsn_candidates list = { .count = count };

    assert(count <= GSN_CANDIDATES);
    for (size_t i = 0; i < count; i++)
        list.at[i] = candidate_of(rivals[i].mark, rivals[i].mirrored, rivals[i].share);
    *ret_list = list;
}

void gsn_candidates_of_marks(const struct gsn_fiducial mark[GSN_FIDUCIALS], int mirrored,
                             struct gsn_candidates *ret_list)
{
    struct gsn_candidates list = { .count = GSN_FIDUCIALS + 1 };

    for (size_t i = 0; i <= GSN_FIDUCIALS; i++) {
        list.at[i] = candidate_of(mark, mirrored, NAN);
        if (i < GSN_FIDUCIALS)
            list.at[i].mark[i] = (struct gsn_fiducial){ .found = 0 };
    }
    *ret_list = list;
}

void gsn_candidates_of_gross(const struct gsn_fiducial mark[GSN_FIDUCIALS],
                             const struct gsn_pose *pose, struct gsn_candidates *ret_list)
{
    struct gsn_candidates list = { .count = 0 };

    for (int place = 0; place < GSN_FIDUCIALS; place++) {
        const struct gsn_pose_candidate *best = NULL;
        struct gsn_candidate *to = &list.at[list.count];
        int out = 0;

        /* The place-th by share; of equals the mark of the lower number is left out first. */
        for (int i = 0; i < GSN_FIDUCIALS; i++) {
            int before = 0;

            for (int k = 0; k < GSN_FIDUCIALS; k++)
                before += pose->candidate[k].share > pose->candidate[i].share ||
                          (pose->candidate[k].share == pose->candidate[i].share && k < i);
            if (before == place) {
                best = &pose->candidate[i];
                out = i;
            }
        }
        if (!best || gsn_affine_det(&best->panel_to_block_um) == 0)
            continue;
        *to = candidate_of(mark, pose->flipped, best->share);
        to->mark[out] = (struct gsn_fiducial){ .found = 0 };
        to->laid = 1;
        to->panel_to_block_um = best->panel_to_block_um;
        to->error_um = best->tre_um;
        list.count++;
    }
    *ret_list = list;
}

/* Marks in um, mirrored where the section is, beside where they belong; their number. */
static size_t lay_out(const struct gsn_candidate *c, double px_um,
                      const struct gsn_point triangle[GSN_FIDUCIALS],
                      struct gsn_point from[GSN_FIDUCIALS], struct gsn_point onto[GSN_FIDUCIALS])
{
    size_t count = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        if (!c->mark[i].found)
            continue;
        from[count] =
            (struct gsn_point){ (c->mirrored ? -c->mark[i].px.x : c->mark[i].px.x) * px_um,
                                c->mark[i].px.y * px_um };
        onto[count++] = triangle[i];
    }
    return count;
}

void gsn_candidates_lay(struct gsn_candidates *list, double px_um,
                        const struct gsn_point triangle[GSN_FIDUCIALS])
{
    for (size_t i = 0; i < list->count; i++) {
        struct gsn_candidate *c = &list->at[i];
        struct gsn_point from[GSN_FIDUCIALS], onto[GSN_FIDUCIALS];
        const size_t count = lay_out(c, px_um, triangle, from, onto);
        struct gsn_rigid motion;

        if (count < 2 || gsn_rigid_fit(from, onto, NULL, count, &motion, NULL, NULL) < 0)
            continue;
        c->laid = 1;
        c->flipped = c->mirrored;
        c->panel_to_block_um = gsn_rigid_to_affine(&motion, px_um, c->mirrored);
    }
}

/* Every mark with the error of the stack's typical one: what a spot's own fit says of it is small
 * beside the question whether it is a mark. */
void gsn_candidates_predict(struct gsn_candidates *list, double px_um,
                            const struct gsn_pose_summary *summary,
                            const struct gsn_pose_targets *targets)
{
    const struct gsn_point *t = summary->mean_triangle;
    const double variance = 0.5 * summary->fle_um * summary->fle_um;

    for (size_t i = 0; i < list->count; i++) {
        struct gsn_candidate *c = &list->at[i];
        struct gsn_pose_fit_input input = { .about = { (t[0].x + t[1].x + t[2].x) / GSN_FIDUCIALS,
                                                       (t[0].y + t[1].y + t[2].y) /
                                                           GSN_FIDUCIALS } };
        struct gsn_pose_fit fit;

        if (!c->laid || !(variance > 0))
            continue;
        input.count = lay_out(c, px_um, t, input.from, input.onto);
        for (size_t m = 0; m < input.count; m++)
            input.cov[m] = (struct gsn_cov2){ variance, 0, variance };
        for (int k = 0; k < 3 && summary->stretches; k++)
            input.strain[k][k] = summary->strain_sd[k] * summary->strain_sd[k];
        if (gsn_pose_fit(&input, &fit, NULL) >= 0)
            c->error_um = gsn_pose_tre_rms(&fit.error, targets, 0);
    }
}

struct gsn_point gsn_candidate_direction(const struct gsn_affine *map)
{
    const double sign = gsn_affine_det(map) < 0 ? -1 : 1;
    const double size = hypot(map->m00, map->m10);

    return (struct gsn_point){ sign * map->m00 / size, sign * map->m10 / size };
}

/* ---- in words ---------------------------------------------------------------------------- */

static int same_spot(const struct gsn_fiducial *a, const struct gsn_fiducial *b)
{
    return a->found && b->found && a->px.x == b->px.x && a->px.y == b->px.y;
}

/* Whether both call the same spots marks, whatever their numbers. */
static int same_spots(const struct gsn_candidate *a, const struct gsn_candidate *b)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        int seen = !a->mark[i].found;

        for (int k = 0; k < GSN_FIDUCIALS; k++)
            seen |= same_spot(&a->mark[i], &b->mark[k]);
        if (!seen)
            return 0;
    }
    return 1;
}

static int count_found(const struct gsn_candidate *c)
{
    return c->mark[0].found + c->mark[1].found + c->mark[2].found;
}

static void say_marks(const struct gsn_candidate *c, char words[GSN_CANDIDATE_WORDS])
{
    const int missing = !c->mark[0].found ? 1 : !c->mark[1].found ? 2 : 3;

    if (count_found(c) == GSN_FIDUCIALS)
        (void)snprintf(words, GSN_CANDIDATE_WORDS, "on all three marks");
    else
        (void)snprintf(words, GSN_CANDIDATE_WORDS, "on two marks, without mark %d", missing);
}

/* The angle by which b is turned against a, -180..180 degrees. */
static double turned_deg(const struct gsn_candidate *a, const struct gsn_candidate *b)
{
    const struct gsn_point p = gsn_candidate_direction(&a->panel_to_block_um);
    const struct gsn_point q = gsn_candidate_direction(&b->panel_to_block_um);

    return atan2(p.x * q.y - p.y * q.x, p.x * q.x + p.y * q.y) * 180 / M_PI;
}

static void say_same(const struct gsn_candidate *first, const struct gsn_candidate *c,
                     char words[GSN_CANDIDATE_WORDS])
{
    const double turn = first->laid && c->laid ? fabs(turned_deg(first, c)) : 0;
    const int over = first->mirrored != c->mirrored;
    char turned[40] = "";

    if (turn >= TOLD_DEG)
        (void)snprintf(turned, sizeof turned, "turned by %.0f degrees", turn);
    (void)snprintf(words, GSN_CANDIDATE_WORDS, "the same spots%s%s%s%s",
                   over || turned[0] ? ", " : " with other numbers", over ? "the other way up" : "",
                   over && turned[0] ? " and " : "", turned);
}

/* Whether they only leave out another of the same marks. */
static int only_leaves_out(const struct gsn_candidate *first, const struct gsn_candidate *c)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (first->mark[i].found && c->mark[i].found && !same_spot(&first->mark[i], &c->mark[i]))
            return 0;
    return first->mirrored == c->mirrored;
}

/* The spots that the first does not have. */
static void say_others(const struct gsn_candidate *first, const struct gsn_candidate *c,
                       char words[GSN_CANDIDATE_WORDS])
{
    const char *glue = ": ";

    say_marks(c, words);
    for (int i = 0; i < GSN_FIDUCIALS && !only_leaves_out(first, c); i++) {
        const size_t used = strlen(words);
        int known = !c->mark[i].found;

        for (int k = 0; k < GSN_FIDUCIALS; k++)
            known |= same_spot(&c->mark[i], &first->mark[k]);
        if (known)
            continue;
        (void)snprintf(words + used, GSN_CANDIDATE_WORDS - used,
                       "%smark %d is the spot at (%.0f, %.0f) px", glue, i + 1, c->mark[i].px.x,
                       c->mark[i].px.y);
        glue = ", ";
    }
}

void gsn_candidates_say(struct gsn_candidates *list, struct gsn_point upright)
{
    for (size_t i = 0; i < list->count; i++) {
        struct gsn_candidate *c = &list->at[i];
        const struct gsn_candidate *first = &list->at[0];

        if (c->laid) {
            const struct gsn_point d = gsn_candidate_direction(&c->panel_to_block_um);

            c->rotated180 = d.x * upright.x + d.y * upright.y < 0;
        }
        if (i == 0)
            say_marks(c, c->differs);
        else if (same_spots(first, c) && same_spots(c, first))
            say_same(first, c, c->differs);
        else
            say_others(first, c, c->differs);
    }
}

/* ---- what a person meant ----------------------------------------------------------------- */

static int is_meant(const struct gsn_candidate *c, const struct gsn_candidate_choice *choice)
{
    /* Three marks tell by themselves which way up they lie. */
    if (count_found(c) < GSN_FIDUCIALS && !c->mirrored != !choice->mirrored)
        return 0;
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_fiducial *m = &c->mark[i];

        if (!m->found != !choice->found[i])
            return 0;
        if (m->found && !(hypot(m->px.x - choice->px[i].x, m->px.y - choice->px[i].y) <=
                          SAME_SPOT * m->radius_px))
            return 0;
    }
    return 1;
}

unsigned gsn_candidates_meant(const struct gsn_candidates *list,
                              const struct gsn_candidate_choice *choice)
{
    for (size_t i = 0; i < list->count; i++)
        if (is_meant(&list->at[i], choice))
            return (unsigned)i + 1;
    return 0;
}
