/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_search.h"

#include "pipeline/register/median.h"

#include <math.h>

enum { NEAR = GSN_SEQUENCE_NEAR, LIKELY = 4 };

/* A change is looked at where it runs against what is foretold by this many standard errors. */
static const double LEAST_AGAINST = 0.75;
/* And where the logarithm of the likelihood ratio against the order as numbered is this much: where
 * hardly any change is foretold, noise runs against it half of the time. */
static const double LIKELIER = 5;
/* Places farther apart than NEAR must show this part of a swap at least: none is shown where one of
 * the two alone is out of place. Roughly, by cells as they were laid, it is no more than that. */
static const double PART = 0.2, ROUGHLY = 0.2;
/* A proposal must make the changes around run more evenly by this many standard errors, those that
 * the two run against counted twice. In order hardly any two sections are above 0. */
static const double CONVINCING = 6;
/* Of what the two show in order a swap shows this share at least as a rule, as each was laid by
 * those it does not belong to; and it is found where that is above ENOUGH. */
static const double LAID = 0.6, ENOUGH = 1.5;
/* Where fewer than this share of swaps at a distance would show, what does show may be chance. */
static const double TELLING = 0.25;
/* Of all swaps at a distance so many show where it is said that they do. */
static const double NEARLY_ALL = 0.95;

/* Nothing lies beyond the last two, so nothing says which of them is the last. */
static int is_end(const struct gsn_sequence_search *a, size_t i, size_t j)
{
    return j == i + 1 && (i == 0 || j + 1 == a->t->n);
}

static int runs_against(const struct gsn_sequence_search *a, size_t f,
                        struct gsn_sequence_change change)
{
    if (a->shown[(f < NEAR ? f : NEAR) - 1] < TELLING)
        return 0;
    return change.shown < -LEAST_AGAINST &&
           -2 * a->gain * change.shown * change.foretold > LIKELIER &&
           (f <= NEAR || change.shown < -PART * a->gain * change.foretold);
}

/* Whether what two places show runs against what is foretold. */
static int look_at(struct gsn_sequence_search *a, struct gsn_sequence_swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];

    if (j <= i + NEAR)
        swap->change = a->near[i * NEAR + j - i - 1];
    else if (a->suspect[i] && a->suspect[j])
        swap->change = gsn_sequence_change_both_ways(a, swap);
    else if (gsn_sequence_standing(a, i, j) <= ROUGHLY)
        swap->change = gsn_sequence_change_between(a->t, i, j);
    else
        return 0;
    return runs_against(a, j - i, swap->change);
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

/* How far all near changes run the way that those around them do. */
static double evenness(const struct gsn_sequence_search *a)
{
    double sum = 0;

    for (size_t i = 0; i < a->t->n * NEAR; i++)
        sum += a->near[i].shown;
    return sum;
}

/* What lies beside swapped sections looks out of place too: of the likeliest swaps that one which
 * convinces most; 0: none does. */
static int find_best(struct gsn_sequence_search *a, struct gsn_sequence_swap *ret_swap)
{
    const double before = evenness(a);
    struct gsn_sequence_swap likely[LIKELY] = { 0 };
    const size_t count = list_likely(a, likely);
    double most = CONVINCING;

    for (size_t k = 0; k < count; k++) {
        gsn_sequence_keep(a, &likely[k]);
        gsn_sequence_exchange(a, &likely[k]);
        likely[k].convincing = evenness(a) - before - 2 * likely[k].change.shown;
        gsn_sequence_put_back(a, &likely[k]);
        if (likely[k].convincing > most) {
            most = likely[k].convincing;
            *ret_swap = likely[k];
        }
    }
    return most > CONVINCING;
}

static int is_duplicate(const struct gsn_sequence *found, unsigned a, unsigned b)
{
    for (size_t k = 0; k < found->count; k++)
        if (found->finding[k].kind == GSN_SEQUENCE_DUPLICATE && found->finding[k].a == a &&
            found->finding[k].b == b)
            return 1;
    return 0;
}

/* The others are looked for as if the swap found were undone. No section is in two proposals. */
static void find_all(struct gsn_sequence_search *a, const struct gsn_sequence_plane *planes,
                     struct gsn_sequence *found)
{
    struct gsn_sequence_swap swap = { 0 };

    while (find_best(a, &swap)) {
        const unsigned first = planes[swap.place[0]].serial, second = planes[swap.place[1]].serial;

        a->used[swap.place[0]] = a->used[swap.place[1]] = 1;
        gsn_sequence_exchange(a, &swap);
        gsn_sequence_compare_far(a);
        if (!is_duplicate(found, first, second))
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
                      double times)
{
    const double shown = LAID * times * change.shown;

    return shown > ENOUGH && 2 * a->gain * shown * times * change.foretold > LIKELIER;
}

/* The share of swaps f sections apart that would show, told from how far the sections here run
 * along what is foretold; beyond NEAR change adds up. */
static double share_shown(const struct gsn_sequence_search *a, size_t f)
{
    const size_t n = a->t->n, far = f < NEAR ? f : NEAR;
    size_t shown = 0, count = 0;

    for (size_t i = 0; i + far < n; i++)
        if (!is_end(a, i, i + far)) {
            shown += (size_t)would_show(a, a->near[i * NEAR + far - 1], (double)f / (double)far);
            count++;
        }
    return count ? (double)shown / (double)count : 0;
}

static void tell_shown(struct gsn_sequence_search *a, struct gsn_sequence *found)
{
    for (size_t f = 1; f <= NEAR; f++)
        found->shown[f - 1] = a->shown[f - 1] = share_shown(a, f);
    for (size_t f = a->t->n - 1; f > 0 && share_shown(a, f) >= NEARLY_ALL; f--)
        found->reach = (unsigned)f;
}

int gsn_sequence_find_swaps(struct gsn_sequence_tissue *t, const struct gsn_sequence_plane *planes,
                            struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto_mem(char) used = gsn_alloc_array(2 * t->n, 1);
    gsn_auto_mem(double) fit = gsn_alloc_array(2 * t->n * t->n, sizeof *fit);
    gsn_auto_mem(struct gsn_sequence_change) near = gsn_alloc_array(2 * t->n * NEAR, sizeof *near);
    const size_t cells = t->columns * t->rows;
    gsn_auto_mem(float) kept_value = gsn_alloc_array(2 * cells, sizeof *kept_value);
    gsn_auto_mem(unsigned char) kept_known = gsn_alloc_array(2 * cells, 1);
    gsn_auto_mem(float) foretold = gsn_alloc_array(t->n * gsn_sequence_sample(t), sizeof *foretold);
    struct gsn_sequence_search a = { .t = t,
                                     .near = near,
                                     .kept_value = kept_value,
                                     .kept_known = kept_known,
                                     .foretold = foretold,
                                     .fit = fit,
                                     .used = used };

    if (!used || !fit || !near || !kept_value || !kept_known || !foretold)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", t->n);
    a.suspect = used + t->n;
    a.kept = near + t->n * NEAR;
    a.apart = fit + t->n * t->n;
    gsn_sequence_compare_near(&a, NULL);
    a.gain = learn_gain(&a, fit);
    gsn_sequence_compare_far(&a);
    tell_shown(&a, found);
    find_all(&a, planes, found);
    return GSN_OK;
}
