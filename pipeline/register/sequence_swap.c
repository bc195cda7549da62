/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/register/median.h"

#include <math.h>
#include <string.h>

enum { NEAR = GSN_SEQUENCE_NEAR, SIDE = GSN_SEQUENCE_SIDE, EVERY = 3, LIKELY = 4 };

/* A proposal must be this much likelier than the order as numbered: e^14 is a million to one, to
 * be divided among some thousand pairs of a stack; e^7 is a thousand to one, for as many neighbours
 * as it has sections: their change is 3.7 standard errors off then. */
static const double SURE = 14, SURE_OF_NEIGHBOURS = 7;
/* And run against what is foretold by this many standard errors: where much is foretold, the
 * smallest contrary step would be evidence, and a tear may be that. */
static const double LEAST_AGAINST = 2, LEAST_AGAINST_OF_NEIGHBOURS = 1.5;
/* Two planes' cells differ by no more than this, in standard deviations of one's noise. */
static const double MOST = 3;
/* Median absolute deviation to standard deviation of normal numbers. */
static const double MAD_TO_SD = 1.4826;
/* Of all swaps at a distance so many show where it is said that they do. */
static const double NEARLY_ALL = 0.99;

struct search {
    struct gsn_sequence_tissue *t;
    struct gsn_sequence_change *near; /* n * NEAR: to the places 1 to NEAR further on */
    struct gsn_sequence_change *kept; /* as many: scratch */
    double *fit;                      /* n * n: how ill the plane at one place fits at another */
    double gain;                      /* how much of what is foretold a change shows */
    double spread;                    /* standard deviation of what shows, in standard errors */
    char *used;                       /* n: in a proposal already */
};

static double evidence(const struct search *a, struct gsn_sequence_change change)
{
    return -2 * a->gain * change.shown * change.foretold;
}

/* How far a change over f places must run against what is foretold. */
static double least_against(const struct search *a, size_t f, double foretold)
{
    return fmax(f == 1 ? LEAST_AGAINST_OF_NEIGHBOURS : LEAST_AGAINST,
                (f == 1 ? SURE_OF_NEIGHBOURS : SURE) / (2 * a->gain * foretold));
}

static size_t away(size_t a, size_t b)
{
    return a > b ? a - b : b - a;
}

/* Nothing lies beyond the last two, so nothing says which of them is the last. */
static int is_end(const struct search *a, size_t i, size_t j)
{
    return j == i + 1 && (i == 0 || j + 1 == a->t->n);
}

/* Compares anew what one place has a say in; n: all. */
static void compare_near(struct search *a, size_t place)
{
    const size_t n = a->t->n;

    for (size_t i = 0; i < n; i++)
        for (size_t f = 1; f <= NEAR && i + f < n; f++)
            if (place == n || away(i, place) <= SIDE + 1 || away(i + f, place) <= SIDE + 1)
                a->near[i * NEAR + f - 1] = gsn_sequence_change_between(a->t, i, i + f);
}

/* The line through the sections around a place, itself left out. */
static void foretell(const struct gsn_sequence_tissue *t, size_t place, float *ret_plane)
{
    const size_t cells = t->columns * t->rows;
    const struct gsn_sequence_line line =
        gsn_sequence_line_at(t->z, t->n, place, place, t->z[place]);

    memset(ret_plane, 0, cells * sizeof *ret_plane);
    for (size_t k = 0; k < line.count; k++) {
        const float *plane = t->value + t->place[line.at[k]] * cells;
        const float weight = (float)line.weight[k];

        for (size_t c = 0; c < cells; c += EVERY)
            ret_plane[c] += weight * plane[c];
    }
}

static double misfit(const struct gsn_sequence_tissue *t, size_t place, const float *foretold)
{
    const size_t cells = t->columns * t->rows;
    const float *plane = t->value + t->place[place] * cells, most = (float)MOST;
    const unsigned char *known = t->known + t->place[place] * cells;
    double sum = 0;

    for (size_t c = 0; c < cells; c += EVERY) {
        const float off = fminf(fabsf(plane[c] - foretold[c]), most * t->deviation[c]);

        sum += known[c] ? (double)(off * off / t->noise2[c]) : 0;
    }
    return sum;
}

static void compare_far(struct search *a)
{
    const size_t n = a->t->n;

    for (size_t m = 0; m < n; m++) {
        foretell(a->t, m, a->t->change);
        for (size_t k = 0; k < n; k++)
            a->fit[k * n + m] = misfit(a->t, k, a->t->change);
    }
}

/* Places farther apart are compared only where each section fits better in the other's. */
static int may_be_swapped(const struct search *a, size_t i, size_t j)
{
    const size_t n = a->t->n;

    return a->fit[i * n + j] < a->fit[i * n + i] && a->fit[j * n + i] < a->fit[j * n + j];
}

/* Unless their places are hardly apart, each by itself must lie nearer to the other's place: a
 * section that does not belong there looks contrary to all those around it. */
static int runs_against(const struct search *a, size_t f, struct gsn_sequence_change change)
{
    return change.shown < -least_against(a, f, change.foretold) &&
           (f < NEAR || (change.first < 0 && change.second < 0));
}

struct swap {
    size_t place[2];
    struct gsn_sequence_change change;
    double evidence;
};

/* The likeliest swaps among sections that are in none yet, the likeliest first; how many. */
static size_t list_likely(struct search *a, struct swap ret_swap[LIKELY])
{
    const size_t n = a->t->n;
    size_t count = 0;

    for (size_t i = 0; i < n; i++)
        for (size_t j = i + 1; j < n && !a->used[i]; j++) {
            struct swap swap = { .place = { i, j } };
            size_t at;

            if (a->used[j] || is_end(a, i, j) || (j > i + NEAR && !may_be_swapped(a, i, j)))
                continue;
            swap.change = j <= i + NEAR ? a->near[i * NEAR + j - i - 1]
                                        : gsn_sequence_change_between(a->t, i, j);
            swap.evidence = evidence(a, swap.change);
            if (!runs_against(a, j - i, swap.change))
                continue;
            count += count < LIKELY;
            for (at = count - 1; at > 0 && ret_swap[at - 1].evidence < swap.evidence; at--)
                ret_swap[at] = ret_swap[at - 1];
            if (at + 1 < count || ret_swap[at].evidence < swap.evidence)
                ret_swap[at] = swap;
        }
    return count;
}

static void exchange(struct search *a, const struct swap *swap)
{
    size_t *place = a->t->place;
    const size_t plane = place[swap->place[0]];

    place[swap->place[0]] = place[swap->place[1]];
    place[swap->place[1]] = plane;
    compare_near(a, swap->place[0]);
    compare_near(a, swap->place[1]);
}

/* How far all near changes run the way that those around them do. */
static double evenness(const struct search *a)
{
    double sum = 0;

    for (size_t i = 0; i < a->t->n * NEAR; i++)
        sum += a->near[i].shown;
    return sum;
}

/* What lies beside swapped sections looks out of place too: of the likeliest swaps that one after
 * which the stack changes most evenly; 0: none makes it more even. */
static int find_best(struct search *a, struct swap *ret_swap)
{
    const size_t bytes = a->t->n * NEAR * sizeof *a->near;
    const double before = evenness(a);
    struct swap likely[LIKELY] = { 0 };
    const size_t count = list_likely(a, likely);
    double most = 0;

    memcpy(a->kept, a->near, bytes);
    for (size_t k = 0; k < count; k++) {
        double gained;

        exchange(a, &likely[k]);
        gained = evenness(a) - before;
        exchange(a, &likely[k]);
        memcpy(a->near, a->kept, bytes);
        if (gained > most) {
            most = gained;
            *ret_swap = likely[k];
        }
    }
    return most > 0;
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
static void find_all(struct search *a, const struct gsn_sequence_plane *planes,
                     struct gsn_sequence *found)
{
    struct swap swap = { 0 };

    while (find_best(a, &swap)) {
        const unsigned first = planes[swap.place[0]].serial, second = planes[swap.place[1]].serial;

        a->used[swap.place[0]] = a->used[swap.place[1]] = 1;
        exchange(a, &swap);
        compare_far(a);
        if (!is_duplicate(found, first, second))
            found->finding[found->count++] = (struct gsn_sequence_finding){
                GSN_SEQUENCE_SWAP,   first, second, swap.evidence, -swap.change.shown,
                swap.change.foretold
            };
    }
}

/* Most neighbours lie in order, so medians tell what changes show of what is foretold, and how far
 * they are off that. */
static void learn(struct search *a, double *room)
{
    const size_t n = a->t->n;

    for (size_t i = 0; i + 1 < n; i++) {
        const struct gsn_sequence_change change = a->near[i * NEAR];

        room[i] = change.foretold > 0 ? change.shown / change.foretold : 0;
    }
    a->gain = fmin(fmax(gsn_median(room, n - 1), 0), 1);
    for (size_t i = 0; i + 1 < n; i++)
        room[i] = fabs(a->near[i * NEAR].shown - a->gain * a->near[i * NEAR].foretold);
    a->spread = fmax(MAD_TO_SD * gsn_median(room, n - 1), 1);
}

/* How likely a swap shows where so much change is foretold. */
static double chance(const struct search *a, size_t f, double foretold)
{
    if (!(a->gain * foretold > 0))
        return 0;
    return 0.5 * erfc((least_against(a, f, foretold) - a->gain * foretold) / a->spread / sqrt(2));
}

/* The share of swaps f sections apart that would show; beyond NEAR change adds up. */
static double share_shown(const struct search *a, size_t f)
{
    const size_t n = a->t->n, far = f < NEAR ? f : NEAR;
    double sum = 0;
    size_t count = 0;

    for (size_t i = 0; i + far < n; i++)
        if (!is_end(a, i, i + far)) {
            sum += chance(a, f, a->near[i * NEAR + far - 1].foretold * (double)f / (double)far);
            count++;
        }
    return count ? sum / (double)count : 0;
}

static void tell_shown(const struct search *a, struct gsn_sequence *found)
{
    for (size_t f = 1; f <= NEAR; f++)
        found->shown[f - 1] = share_shown(a, f);
    for (size_t f = a->t->n - 1; f > 0 && share_shown(a, f) >= NEARLY_ALL; f--)
        found->reach = (unsigned)f;
}

int gsn_sequence_find_swaps(struct gsn_sequence_tissue *t, const struct gsn_sequence_plane *planes,
                            struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto_mem(char) used = gsn_alloc_array(t->n, 1);
    gsn_auto_mem(double) fit = gsn_alloc_array(t->n * t->n, sizeof *fit);
    gsn_auto_mem(struct gsn_sequence_change) near = gsn_alloc_array(2 * t->n * NEAR, sizeof *near);
    struct search a = { .t = t, .near = near, .fit = fit, .used = used };

    if (!used || !fit || !near)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", t->n);
    a.kept = near + t->n * NEAR;
    compare_near(&a, t->n);
    learn(&a, fit);
    compare_far(&a);
    tell_shown(&a, found);
    find_all(&a, planes, found);
    return GSN_OK;
}
