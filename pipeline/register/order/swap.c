/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Finds sections that lie in each other's places, by the way the tissue changes along z.
 *
 * Steps: (1) the change between any two sections up to three apart is compared with the one that
 * the sections around both predict (predict.h); how much of it a change shows in this stack, and
 * what share of swaps would therefore show, is taken from the stack's own neighbours. (2) How every
 * plane fits at every place, over one cell in three, shows which far apart are suspect. (3) Two
 * that look doubtful are registered anew where they are and in each other's places, since a plane
 * follows those that it was registered onto; the swaps that run against the prediction the most are
 * kept. (4) Each of those is weighed: everything around is registered anew as it is and as it would
 * be, and what speaks for the swap is how far the changes run that it turns over and how much
 * better all would fit, in standard errors. (5) The best is taken as undone, and the search goes on
 * for another; no section is in two proposals.
 *
 * Which of the last two at either end is the last cannot be told. Fails when memory runs out. The
 * limits below were set on drawn stacks; docs/register.md says what share of swaps is found with
 * them. */
#include "pipeline/core/robust.h"
#include "pipeline/register/order/findings.h"
#include "pipeline/register/order/predict.h"

#include <math.h>
#include <string.h>

/* Places whose surroundings a swap of two changes, at most. */
enum {
    NEAR = GSN_SEQUENCE_NEAR,
    SIDE = GSN_SEQUENCE_SIDE,
    AFFECTED = 2 * (GSN_SEQUENCE_AROUND + 1)
};

/* Tissue so many sections apart still changes one way: what lies between two says so, too. */
enum { ONE_WAY = 12 };

/* Of so many cells one tells how planes fit. */
enum { EVERY = 3 };

/* So many that fit worst where they lie are suspect. */
enum { SUSPECTS = 8 };

struct search {
    struct gsn_sequence_tissue *t;
    struct gsn_sequence_change *near; /* n * NEAR: to the places 1 to NEAR further on */
    float *kept_value;                /* of AFFECTED planes: scratch */
    unsigned char *kept_known;        /* as many: scratch */
    double kept_motion[AFFECTED][GSN_SEQUENCE_MOTION];
    float *sample;                   /* n samples: scratch */
    double *fit;                     /* n * n: how ill the plane at one place fits at another */
    double *apart;                   /* n * n: of i < j, between what the two places predict */
    double least[GSN_SEQUENCE_NEAR]; /* how much swaps 1 to NEAR apart must show */
    double gain;                     /* how much of what is predicted a change shows */
    char *used;                      /* n: in a proposal already, or left out */
    int exchanged;                   /* whether a swap was found */
    char *suspect;                   /* n: of those that fit worst where they lie */
};

struct swap {
    size_t place[2];
    struct gsn_sequence_change change; /* registered both ways */
    double turned; /* how far all changes that it turns over run against what is predicted */
    double fit;    /* how much better the planes around would fit, in standard errors */
    double convincing;
};

/* ---- how planes fit ----------------------------------------------------------------------- */

/* Two planes' cells differ by no more than this, in standard deviations of one's noise. */
static const double MOST = 3;

static size_t count_apart(size_t a, size_t b)
{
    return a > b ? a - b : b - a;
}

/* Planes up to SIDE from either place are registered again with it, and as many more look at them.
 */
static int is_concerned(size_t i, size_t f, const size_t place[2])
{
    for (int k = 0; k < 2; k++)
        if (count_apart(i, place[k]) <= 2 * SIDE + 1 ||
            count_apart(i + f, place[k]) <= 2 * SIDE + 1)
            return 1;
    return 0;
}

/* Compares anew the near changes that two places have a say in; NULL: all. */
static void compare_near(struct search *a, const size_t place[2])
{
    const size_t n = a->t->n;

    for (size_t i = 0; i < n; i++)
        for (size_t f = 1; f <= NEAR && i + f < n; f++)
            if (!place || is_concerned(i, f, place))
                a->near[i * NEAR + f - 1] = gsn_sequence_change_between(a->t, i, i + f);
}

/* How many of a plane's cells tell how it fits elsewhere. */
static size_t sample_size(const struct gsn_sequence_tissue *t)
{
    return (t->columns * t->rows + EVERY - 1) / EVERY;
}

/* The line through the sections around a place, itself left out, and where it tells. */
static struct gsn_sequence_line predict_place(const struct gsn_sequence_tissue *t, size_t place,
                                              float *ret_sample)
{
    const struct gsn_sequence_line line =
        gsn_sequence_line_at(t->z, t->n, place, place, t->z[place]);

    memset(t->predictable, 1, sample_size(t));
    gsn_sequence_predict(t, &line, place, EVERY, ret_sample, t->predictable);
    return line;
}

/* The plane at a place, and how much each cell counts. */
static void sample_plane(const struct gsn_sequence_tissue *t, size_t place, float *ret_sample,
                         float *ret_weight)
{
    const size_t first = t->place[place] * t->columns * t->rows, sample = sample_size(t);

    for (size_t c = 0; c < sample; c++) {
        ret_sample[c] = t->value[first + EVERY * c];
        ret_weight[c] = t->known[first + EVERY * c] ? 1 / t->noise2[EVERY * c] : 0;
    }
}

/* Squared distance over one section's noise. */
static double squared_distance(const float *one, const float *other, const float *weight,
                               size_t sample)
{
    const float most = (float)(MOST * MOST);
    double sum = 0;

    for (size_t c = 0; c < sample; c++) {
        const float off = one[c] - other[c], square = off * off * weight[c];

        sum += (double)(square < most ? square : most);
    }
    return sum;
}

/* Adds to a sample of cells how ill the plane at a place fits there. */
static void add_misfit(struct search *a, size_t place, float *sum)
{
    const size_t sample = sample_size(a->t);
    float *predicted = a->t->off_too, *plane = a->t->off, *weight = a->t->energy;
    const unsigned char *predictable = a->t->predictable;
    const struct gsn_sequence_line line = predict_place(a->t, place, predicted);
    const float scale = (float)(1 / (1 + gsn_sequence_line_noise(&line)));
    const float most = (float)(MOST * MOST);

    sample_plane(a->t, place, plane, weight);
    for (size_t c = 0; c < sample; c++) {
        const float off = plane[c] - predicted[c], square = off * off * weight[c] * scale;

        sum[c] += (float)predictable[c] * (square < most ? square : most);
    }
}

/* Two that changed places far from each other fit worst of all, but for the ends, which are only
 * predicted from one side. */
static void mark_suspects(struct search *a)
{
    const size_t n = a->t->n;

    for (size_t k = 0; k < n; k++) {
        size_t worse = 0;

        for (size_t i = 0; i < n; i++)
            worse += !a->used[i] && a->fit[i * n + i] > a->fit[k * n + k];
        a->suspect[k] = worse < SUSPECTS;
    }
}

/* How every plane fits at every place, and which are suspect. */
static void compare_far(struct search *a)
{
    const size_t n = a->t->n, sample = sample_size(a->t);
    float *plane = a->t->off, *weight = a->t->energy;

    for (size_t m = 0; m < n; m++)
        (void)predict_place(a->t, m, a->sample + m * sample);
    for (size_t k = 0; k < n; k++) {
        sample_plane(a->t, k, plane, weight);
        for (size_t m = 0; m < n; m++)
            a->fit[k * n + m] = squared_distance(plane, a->sample + m * sample, weight, sample);
    }
    for (size_t c = 0; c < sample; c++)
        weight[c] = 1 / a->t->noise2[EVERY * c];
    for (size_t m = 0; m < n; m++)
        for (size_t k = 0; k < m; k++)
            a->apart[k * n + m] =
                squared_distance(a->sample + k * sample, a->sample + m * sample, weight, sample);
    mark_suspects(a);
}

/* How the planes at two places stand between them, roughly: 1 where they lie in order, -1 where
 * each lies at the other's, 0 where one alone is out of place. */
static double estimate_standing(const struct search *a, size_t i, size_t j)
{
    const size_t n = a->t->n;
    const double off =
        a->fit[i * n + i] + a->fit[j * n + j] - a->fit[i * n + j] - a->fit[j * n + i];

    return a->apart[i * n + j] > 0 ? -off / (2 * a->apart[i * n + j]) : 0;
}

/* Two planes take each other's places; as they were registered. */
static void exchange_planes(struct search *a, const struct swap *swap)
{
    size_t *place = a->t->place;
    const size_t plane = place[swap->place[0]];

    place[swap->place[0]] = place[swap->place[1]];
    place[swap->place[1]] = plane;
}

/* The places whose surroundings a swap of two changes, themselves among them; how many. */
static size_t list_affected(size_t n, const size_t place[2], size_t ret_at[AFFECTED])
{
    size_t count = 0;

    for (size_t k = 0; k < n; k++)
        if (count_apart(k, place[0]) <= GSN_SEQUENCE_SIDE ||
            count_apart(k, place[1]) <= GSN_SEQUENCE_SIDE)
            ret_at[count++] = k;
    return count;
}

/* Registers the planes at two places anew, and all whose surroundings they are. */
/* The two first: the others were registered onto them. */
static void register_around(struct search *a, const size_t place[2])
{
    size_t at[AFFECTED];
    const size_t count = list_affected(a->t->n, place, at);

    for (int i = 0; i < 2; i++)
        gsn_sequence_register_again(a->t, place[i]);
    for (size_t i = 0; i < count; i++)
        gsn_sequence_register_again(a->t, at[i]);
}

/* Between the planes around a swap and their scratch. */
static void copy_around(struct search *a, const struct swap *swap, int back)
{
    struct gsn_sequence_tissue *t = a->t;
    const size_t cells = t->columns * t->rows;
    size_t at[AFFECTED];
    const size_t count = list_affected(t->n, swap->place, at);

    for (size_t i = 0; i < count; i++) {
        float *value = t->value + t->place[at[i]] * cells, *kept_value = a->kept_value + i * cells;
        unsigned char *known = t->known + t->place[at[i]] * cells,
                      *kept_known = a->kept_known + i * cells;
        double *motion = t->motion[t->place[at[i]]], *kept_motion = a->kept_motion[i];

        memcpy(back ? value : kept_value, back ? kept_value : value, cells * sizeof *value);
        memcpy(back ? known : kept_known, back ? kept_known : known, cells);
        memcpy(back ? motion : kept_motion, back ? kept_motion : motion, sizeof *t->motion);
    }
}

/* The planes there as they are, and back; the same planes must lie there. */
static void save_around(struct search *a, const struct swap *swap)
{
    copy_around(a, swap, 0);
}

static void restore_around(struct search *a, const struct swap *swap)
{
    copy_around(a, swap, 1);
}

/* For good: the two trade places, what is around is registered anew, and what is near compared. */
static void apply_swap(struct search *a, const struct swap *swap)
{
    exchange_planes(a, swap);
    register_around(a, swap->place);
    compare_near(a, swap->place);
}

/* What two places show, each plane registered where it is and where the other is: a plane follows
 * those that it is registered onto, wherever it lies, and one from far away fits nowhere before it
 * is registered again. */
static struct gsn_sequence_change change_both_ways(struct search *a, const struct swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];
    struct gsn_sequence_change change = gsn_sequence_change_between(a->t, i, j);

    save_around(a, swap);
    exchange_planes(a, swap);
    gsn_sequence_register_again(a->t, i);
    gsn_sequence_register_again(a->t, j);
    change.shown -= gsn_sequence_change_between(a->t, i, j).shown;
    change.shown /= 2;
    exchange_planes(a, swap);
    restore_around(a, swap);
    return change;
}

/* Side of the squares of cells that say each for itself how well planes fit: 200 um. */
enum { SQUARE = 6 };

/* How ill the planes around two places fit there, by cells of the sample. */
static void sum_misfits(struct search *a, const struct swap *swap, float *ret_sum)
{
    size_t at[AFFECTED];
    const size_t count = list_affected(a->t->n, swap->place, at);

    memset(ret_sum, 0, sample_size(a->t) * sizeof *ret_sum);
    for (size_t i = 0; i < count; i++)
        add_misfit(a, at[i], ret_sum);
}

/* How much one sum over the sample is above another, in standard errors. */
static double compare_sums(const struct gsn_sequence_tissue *t, const float *one,
                           const float *other)
{
    const size_t sample = sample_size(t), across = (t->columns + SQUARE - 1) / SQUARE;
    const size_t squares = across * ((t->rows + SQUARE - 1) / SQUARE);
    double sum = 0, left = 0;

    memset(t->square, 0, squares * sizeof *t->square);
    for (size_t i = 0; i < sample; i++) {
        const size_t x = EVERY * i % t->columns / SQUARE;
        const size_t y = EVERY * i / t->columns / SQUARE;

        t->square[y * across + x].first += (double)(one[i] - other[i]);
    }
    for (size_t k = 0; k < squares; k++) {
        sum += t->square[k].first;
        left += t->square[k].first * t->square[k].first;
    }
    return left > 0 ? sum / sqrt(left) : 0;
}

/* What the changes show from the first of two places to what lies next behind it, and from what
 * lies next before the second to that: a swap of the two turns them over. */
static double sum_shown(const struct search *a, const struct swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];
    double sum = 0;

    if (j > i + ONE_WAY)
        return 0;
    for (size_t k = i + 1; k < j && k <= i + NEAR; k++)
        sum += gsn_sequence_change_between(a->t, i, k).shown;
    for (size_t k = i + NEAR < j ? j - NEAR : i + 1; k < j; k++)
        sum += gsn_sequence_change_between(a->t, k, j).shown;
    return sum;
}

/* What speaks for a swap: how far the changes run that it turns over, and how much better all
 * planes around would fit. Everything around is registered anew as it is and as it would be, as a
 * plane out of place has misled those that were registered onto it. */
static void weigh_swap(struct search *a, struct swap *swap)
{
    float *as_is = a->sample, *exchanged = a->sample + sample_size(a->t);
    double between;

    save_around(a, swap);
    register_around(a, swap->place);
    between = -sum_shown(a, swap);
    sum_misfits(a, swap, as_is);
    restore_around(a, swap);
    exchange_planes(a, swap);
    register_around(a, swap->place);
    between += sum_shown(a, swap);
    sum_misfits(a, swap, exchanged);
    exchange_planes(a, swap);
    restore_around(a, swap);
    swap->turned = between / 2 - swap->change.shown;
    swap->fit = compare_sums(a->t, as_is, exchanged);
}

/* ---- the search --------------------------------------------------------------------------- */

enum { LIKELY = 6 };

/* Two near sections that show more than this, in standard errors, lie in order; others are compared
 * both ways. So are those farther apart that stand between in order and not no better than this,
 * roughly, by cells as they were registered. */
static const double DOUBTFUL = 1.5, ROUGHLY = 0.2;

/* A swap is looked at where both ways run against what is predicted by this many standard errors,
 * and by so many more for every stack's worth of changes that are not above SHOWN in order: where
 * half of them are noise, noise shows swaps. */
static const double LEAST_AGAINST = 0.4, SHOWN = 0.5, MORE = 5;

/* And where the logarithm of the likelihood ratio against the order as numbered is this much: where
 * hardly any change is predicted, noise runs against it half of the time. */
static const double LIKELIER = 2;

/* How much a better fit speaks for a swap beside the changes that it turns over, which are part of
 * it; and how much must speak for one. */
static const double FIT = 0.5, CONVINCING = 0.5;

/* For every further one, as what is registered anew around the first shifts by about this: what is
 * below shows once the first is put right. */
static const double CONVINCING_MORE = 1.5;

/* As numbered two show more than both ways say, as each was registered by those around it: this
 * share is left. */
static const double LAID = 0.85;

/* Where fewer neighbours than these lie above SHOWN, what they show is noise, and so is what adds
 * up of it: no distance asks for less than neighbours do. */
static const double HARDLY_ANY = 0.5;

/* Of all swaps at a distance so many show where it is said that they do. */
static const double NEARLY_ALL = 0.95;

/* Nothing lies beyond the last two, so nothing says which of them is the last. */
static int is_end(const struct search *a, size_t i, size_t j)
{
    return j == i + 1 && (i == 0 || j + 1 == a->t->n);
}

static int is_near(const struct swap *swap)
{
    return swap->place[1] <= swap->place[0] + NEAR;
}

static int runs_against(const struct search *a, size_t f, struct gsn_sequence_change change)
{
    return change.shown < -a->least[(f < NEAR ? f : NEAR) - 1] &&
           -2 * a->gain * change.shown * change.predicted > LIKELIER;
}

/* Whether two places are worth a closer look. */
static int is_doubtful(const struct search *a, const struct swap *swap)
{
    const size_t i = swap->place[0], j = swap->place[1];

    return is_near(swap)
               ? a->near[i * NEAR + j - i - 1].shown < DOUBTFUL
               : (a->suspect[i] && a->suspect[j]) || estimate_standing(a, i, j) <= ROUGHLY;
}

/* Whether what two places show runs against what is predicted. */
static int looks_swapped(struct search *a, struct swap *swap)
{
    if (!is_doubtful(a, swap))
        return 0;
    swap->change = change_both_ways(a, swap);
    return runs_against(a, swap->place[1] - swap->place[0], swap->change);
}

/* The swaps that run against what is predicted the most, among sections that are in none yet; how
 * many. */
static size_t list_likely(struct search *a, struct swap ret_swap[LIKELY])
{
    const size_t n = a->t->n;
    size_t count = 0;

    for (size_t i = 0; i < n; i++)
        for (size_t j = i + 1; j < n && !a->used[i]; j++) {
            struct swap swap = { .place = { i, j } };
            size_t at;

            if (a->used[j] || is_end(a, i, j) || !looks_swapped(a, &swap))
                continue;
            count += count < LIKELY;
            for (at = count - 1; at > 0 && ret_swap[at - 1].change.shown > swap.change.shown; at--)
                ret_swap[at] = ret_swap[at - 1];
            if (at + 1 < count || ret_swap[at].change.shown > swap.change.shown)
                ret_swap[at] = swap;
        }
    return count;
}

static int is_far(const struct swap *swap)
{
    return swap->place[1] > swap->place[0] + ONE_WAY;
}

static int is_any(const struct swap *swap)
{
    return swap->place[1] > swap->place[0];
}

/* What speaks for a swap of sections at any distance. */
static double support_of(const struct swap *swap)
{
    return swap->fit - swap->change.shown;
}

/* What lies beside swapped sections looks out of place too: of the likeliest swaps that one which
 * convinces most; 0: none does. What changes between two sections adds up only as far as tissue
 * changes one way, so the best of either kind is looked for, and then the better of the two. */
static int find_best_swap(struct search *a, struct swap *ret_swap)
{
    struct swap likely[LIKELY] = { 0 }, best[2] = { 0 };
    const size_t count = list_likely(a, likely);

    best[0].convincing = best[1].convincing = a->exchanged ? CONVINCING_MORE : CONVINCING;
    for (size_t k = 0; k < count; k++) {
        struct swap *of_kind = &best[is_far(&likely[k])];

        weigh_swap(a, &likely[k]);
        likely[k].convincing = likely[k].turned + FIT * likely[k].fit;
        if (likely[k].convincing > of_kind->convincing &&
            (is_near(&likely[k]) || likely[k].fit > 0))
            *of_kind = likely[k];
    }
    if (!is_any(&best[0]) || !is_any(&best[1]))
        *ret_swap = best[is_any(&best[1])];
    else
        *ret_swap = best[support_of(&best[1]) > support_of(&best[0])];
    return is_any(ret_swap);
}

/* The others are looked for as if the swap found were undone. No section is in two proposals. */
static void find_all_swaps(struct search *a, const struct gsn_sequence_plane *planes,
                           struct gsn_sequence *found)
{
    struct swap swap = { 0 };

    while (find_best_swap(a, &swap)) {
        const unsigned first = planes[swap.place[0]].serial, second = planes[swap.place[1]].serial;

        a->used[swap.place[0]] = a->used[swap.place[1]] = 1;
        a->exchanged = 1;
        apply_swap(a, &swap);
        compare_far(a);
        found->finding[found->count++] =
            (struct gsn_sequence_finding){ .kind = GSN_SEQUENCE_SWAP,
                                           .a = first,
                                           .b = second,
                                           .evidence = swap.convincing,
                                           .against = -swap.change.shown,
                                           .predicted = swap.change.predicted };
    }
}

/* Most neighbours lie in order, so their median tells what changes show of what is predicted. */
static double learn_gain(const struct search *a, double *room)
{
    const size_t n = a->t->n;

    for (size_t i = 0; i + 1 < n; i++) {
        const struct gsn_sequence_change change = a->near[i * NEAR];

        room[i] = change.predicted > 0 ? change.shown / change.predicted : 0;
    }
    return fmin(fmax(gsn_median(room, n - 1), 0), 1);
}

/* Whether a swap would show of two sections that show this much in order. */
static int would_show(const struct search *a, struct gsn_sequence_change change, double times,
                      double least)
{
    const double shown = LAID * times * change.shown;

    return shown > least && 2 * a->gain * shown * times * change.predicted > LIKELIER;
}

/* The share of swaps f sections apart that would show, told from how far the sections here run
 * along what is predicted; beyond NEAR change adds up. */
static double share_shown(const struct search *a, size_t f, double least)
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

static void set_limits(struct search *a, struct gsn_sequence *found)
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
    const size_t kept = AFFECTED * cells;
    gsn_auto_mem(float) kept_value = gsn_alloc_array(kept, sizeof *kept_value);
    gsn_auto_mem(unsigned char) kept_known = gsn_alloc_array(kept, 1);
    gsn_auto_mem(float) sample = gsn_alloc_array(t->n * sample_size(t), sizeof *sample);
    struct search a = { .t = t,
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
    compare_near(&a, NULL);
    a.gain = learn_gain(&a, fit);
    compare_far(&a);
    set_limits(&a, found);
    find_all_swaps(&a, planes, found);
    return GSN_OK;
}
