/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_search.h"

#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

enum { NEAR = GSN_SEQUENCE_NEAR, LIKELY = 6 };

/* Two near sections that show more than this, in standard errors, lie in order; others are compared
 * both ways. So are those farther apart that stand between in order and not no better than this,
 * roughly, by cells as they were laid. */
static const double DOUBTFUL = 1.5, ROUGHLY = 0.2;
/* A swap is looked at where both ways run against what is foretold by this many standard errors,
 * and by so many more for every stack's worth of changes that are not above SHOWN in order: where
 * half of them are noise, noise shows swaps. */
static const double LEAST_AGAINST = 0.4, SHOWN = 0.5, MORE = 5;
/* And where the logarithm of the likelihood ratio against the order as numbered is this much: where
 * hardly any change is foretold, noise runs against it half of the time. */
static const double LIKELIER = 2;
/* How much a better fit speaks for a swap beside the changes that it turns over, which are part of
 * it; and how much must speak for one. */
static const double FIT = 0.5, CONVINCING = 0.5;
/* For every further one, as what is laid anew around the first shifts by about this: what is below
 * shows once the first is put right. */
static const double CONVINCING_MORE = 1.5;
/* As numbered two show more than both ways say, as each was laid by those around it: this share is
 * left. */
static const double LAID = 0.85;
/* Where fewer neighbours than these lie above SHOWN, what they show is noise, and so is what adds
 * up of it: no distance asks for less than neighbours do. */
static const double HARDLY_ANY = 0.5;
/* Of all swaps at a distance so many show where it is said that they do. */
static const double NEARLY_ALL = 0.95;

/* Nothing lies beyond the last two, so nothing says which of them is the last. */
static int is_end(const struct gsn_sequence_search *a, size_t i, size_t j)
{
    return j == i + 1 && (i == 0 || j + 1 == a->t->n);
}

static int is_near(const struct gsn_sequence_swap *swap)
{
    return swap->place[1] <= swap->place[0] + NEAR;
}

static int runs_against(const struct gsn_sequence_search *a, size_t f,
                        struct gsn_sequence_change change)
{
    return change.shown < -a->least[(f < NEAR ? f : NEAR) - 1] &&
           -2 * a->gain * change.shown * change.foretold > LIKELIER;
}

/* Whether two places are worth a closer look. */
static int is_doubtful(const struct gsn_sequence_search *a, const struct gsn_sequence_swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];

    return is_near(swap)
               ? a->near[i * NEAR + j - i - 1].shown < DOUBTFUL
               : (a->suspect[i] && a->suspect[j]) || gsn_sequence_standing(a, i, j) <= ROUGHLY;
}

/* Whether what two places show runs against what is foretold. */
static int look_at(struct gsn_sequence_search *a, struct gsn_sequence_swap *swap)
{
    if (!is_doubtful(a, swap))
        return 0;
    swap->change = gsn_sequence_change_both_ways(a, swap);
    return runs_against(a, swap->place[1] - swap->place[0], swap->change);
}

/* The swaps that run against what is foretold the most, among sections that are in none yet; how
 * many. */
static size_t list_likely(struct gsn_sequence_search *a, struct gsn_sequence_swap ret_swap[LIKELY])
{
    const size_t n = a->t->n;
    size_t count = 0;

    for (size_t i = 0; i < n; i++)
        for (size_t j = i + 1; j < n && !a->used[i]; j++) {
            struct gsn_sequence_swap swap = { .place = { i, j } };
            size_t at;

            if (a->used[j] || is_end(a, i, j) || !look_at(a, &swap))
                continue;
            count += count < LIKELY;
            for (at = count - 1; at > 0 && ret_swap[at - 1].change.shown > swap.change.shown; at--)
                ret_swap[at] = ret_swap[at - 1];
            if (at + 1 < count || ret_swap[at].change.shown > swap.change.shown)
                ret_swap[at] = swap;
        }
    return count;
}

static int is_far(const struct gsn_sequence_swap *swap)
{
    return swap->place[1] > swap->place[0] + GSN_SEQUENCE_ONE_WAY;
}

static int is_any(const struct gsn_sequence_swap *swap)
{
    return swap->place[1] > swap->place[0];
}

/* What speaks for a swap of sections at any distance. */
static double by_itself(const struct gsn_sequence_swap *swap)
{
    return swap->fit - swap->change.shown;
}

/* What lies beside swapped sections looks out of place too: of the likeliest swaps that one which
 * convinces most; 0: none does. What changes between two sections adds up only as far as tissue
 * changes one way, so the best of either kind is looked for, and then the better of the two. */
static int find_best(struct gsn_sequence_search *a, struct gsn_sequence_swap *ret_swap)
{
    struct gsn_sequence_swap likely[LIKELY] = { 0 }, best[2] = { 0 };
    const size_t count = list_likely(a, likely);

    best[0].convincing = best[1].convincing = a->exchanged ? CONVINCING_MORE : CONVINCING;
    for (size_t k = 0; k < count; k++) {
        struct gsn_sequence_swap *of_kind = &best[is_far(&likely[k])];

        gsn_sequence_weigh(a, &likely[k]);
        likely[k].convincing = likely[k].turned + FIT * likely[k].fit;
        if (likely[k].convincing > of_kind->convincing &&
            (is_near(&likely[k]) || likely[k].fit > 0))
            *of_kind = likely[k];
    }
    if (!is_any(&best[0]) || !is_any(&best[1]))
        *ret_swap = best[is_any(&best[1])];
    else
        *ret_swap = best[by_itself(&best[1]) > by_itself(&best[0])];
    return is_any(ret_swap);
}

/* The others are looked for as if the swap found were undone. No section is in two proposals. */
static void find_all(struct gsn_sequence_search *a, const struct gsn_sequence_plane *planes,
                     struct gsn_sequence *found)
{
    struct gsn_sequence_swap swap = { 0 };

    while (find_best(a, &swap)) {
        const unsigned first = planes[swap.place[0]].serial, second = planes[swap.place[1]].serial;

        a->used[swap.place[0]] = a->used[swap.place[1]] = 1;
        a->exchanged = 1;
        gsn_sequence_exchange(a, &swap);
        gsn_sequence_compare_far(a);
        found->finding[found->count++] =
            (struct gsn_sequence_finding){ .kind = GSN_SEQUENCE_SWAP,
                                           .a = first,
                                           .b = second,
                                           .evidence = swap.convincing,
                                           .against = -swap.change.shown,
                                           .foretold = swap.change.foretold };
    }
}

/* Most neighbours lie in order, so their median tells what changes show of what is foretold. */
static double learn_gain(const struct gsn_sequence_search *a, double *room)
{
    const size_t n = a->t->n;

    for (size_t i = 0; i + 1 < n; i++) {
        const struct gsn_sequence_change change = a->near[i * NEAR];

        room[i] = change.foretold > 0 ? change.shown / change.foretold : 0;
    }
    return fmin(fmax(gsn_median(room, n - 1), 0), 1);
}

/* Whether a swap would show of two sections that show this much in order. */
static int would_show(const struct gsn_sequence_search *a, struct gsn_sequence_change change,
                      double times, double least)
{
    const double shown = LAID * times * change.shown;

    return shown > least && 2 * a->gain * shown * times * change.foretold > LIKELIER;
}

/* The share of swaps f sections apart that would show, told from how far the sections here run
 * along what is foretold; beyond NEAR change adds up. */
static double share_shown(const struct gsn_sequence_search *a, size_t f, double least)
{
    const size_t n = a->t->n, far = f < NEAR ? f : NEAR;
    size_t shown = 0, count = 0;

    for (size_t i = 0; i + far < n; i++)
        if (!is_end(a, i, i + far) && !a->used[i] && !a->used[i + far]) {
            shown +=
                (size_t)would_show(a, a->near[i * NEAR + far - 1], (double)f / (double)far, least);
            count++;
        }
    return count ? (double)shown / (double)count : 0;
}

static void tell_shown(struct gsn_sequence_search *a, struct gsn_sequence *found)
{
    const double neighbours = share_shown(a, 1, SHOWN);

    for (size_t f = 1; f <= NEAR; f++) {
        const double share = share_shown(a, f, SHOWN);

        a->least[f - 1] = LEAST_AGAINST +
                          MORE * (1 - (neighbours < HARDLY_ANY ? fmin(share, neighbours) : share));
        found->shown[f - 1] = share_shown(a, f, a->least[f - 1]);
    }
    for (size_t f = a->t->n - 1;
         f > 0 && share_shown(a, f, a->least[(f < NEAR ? f : NEAR) - 1]) >= NEARLY_ALL; f--)
        found->reach = (unsigned)f;
}

int gsn_sequence_find_swaps(struct gsn_sequence_tissue *t, const struct gsn_sequence_plane *planes,
                            const char *out, struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto_mem(char) used = gsn_alloc_array(2 * t->n, 1);
    gsn_auto_mem(double) fit = gsn_alloc_array(2 * t->n * t->n, sizeof *fit);
    gsn_auto_mem(struct gsn_sequence_change) near = gsn_alloc_array(t->n * NEAR, sizeof *near);
    const size_t cells = t->columns * t->rows;
    const size_t kept = GSN_SEQUENCE_AFFECTED * cells;
    gsn_auto_mem(float) kept_value = gsn_alloc_array(kept, sizeof *kept_value);
    gsn_auto_mem(unsigned char) kept_known = gsn_alloc_array(kept, 1);
    gsn_auto_mem(float) sample = gsn_alloc_array(t->n * gsn_sequence_sample(t), sizeof *sample);
    struct gsn_sequence_search a = { .t = t,
                                     .near = near,
                                     .kept_value = kept_value,
                                     .kept_known = kept_known,
                                     .sample = sample,
                                     .fit = fit,
                                     .used = used };

    if (!used || !fit || !near || !kept_value || !kept_known || !sample)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", t->n);
    memcpy(used, out, t->n);
    a.suspect = used + t->n;
    a.apart = fit + t->n * t->n;
    gsn_sequence_compare_near(&a, NULL);
    a.gain = learn_gain(&a, fit);
    gsn_sequence_compare_far(&a);
    tell_shown(&a, found);
    find_all(&a, planes, found);
    return GSN_OK;
}
