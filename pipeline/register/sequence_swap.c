/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/register/median.h"

#include <math.h>
#include <string.h>

enum { SIDE = GSN_SEQUENCE_SIDE };

/* A proposal must be this much likelier than the order as numbered: e^14 is a million to one, to
 * be divided among some thousand pairs of a stack; e^7 is a thousand to one, for as many neighbours
 * as it has sections. */
static const double SURE = 14, SURE_OF_NEIGHBOURS = 7;
/* A swap that takes less than this off the roughness around both is not worth a person's look; in a
 * stack without grain the smallest difference is evidence. */
static const double LEAST_SMOOTHER = 0.05;
/* Where one section's change is less than its noise, nothing is said of any distance. */
static const double LEAST_CHANGE = 1;
/* Standard normal quantile of 99 %. */
static const double NEARLY_ALL = 2.326;
/* Median absolute deviation to standard deviation of normal numbers. */
static const double MAD_TO_SD = 1.4826;

/* What is usual in this stack. */
struct search {
    struct gsn_sequence_stack *s;
    double noise2; /* squared norm of one section's noise along a direction of change */
    double slope2; /* squared norm of the change from one section to the next */
    double gain;   /* how much of a true change the comparison shows */
    int told;      /* whether a swap of neighbours would be seen */
};

/* Plane i between places i and j: -1/2 when it lies at its own, 1/2 at the other; and the squared
 * distance between the two places. Neither section is in the lines. */
struct stand {
    double at_i, at_j; /* of planes i and j: -1/2 and 1/2 in order */
    double apart2;
};

static struct stand compare(const struct gsn_sequence_stack *s, size_t i, size_t j)
{
    const struct gsn_sequence_line a = gsn_sequence_line_at(s->z, s->n, i, j, s->z[i]),
                                   b = gsn_sequence_line_at(s->z, s->n, j, i, s->z[j]);
    const double aa = gsn_sequence_line_line(s, &a, &a), bb = gsn_sequence_line_line(s, &b, &b);
    const double middle = 0.5 * (bb - aa);
    /* Where noise leaves less than nothing, the places are not told apart. */
    const double apart2 = fmax(aa + bb - 2 * gsn_sequence_line_line(s, &a, &b), 1e-12 * aa);

    return (struct stand){
        .at_i = (gsn_sequence_line_plane(s, &b, i) - gsn_sequence_line_plane(s, &a, i) - middle) /
                apart2,
        .at_j = (gsn_sequence_line_plane(s, &b, j) - gsn_sequence_line_plane(s, &a, j) - middle) /
                apart2,
        .apart2 = apart2,
    };
}

/* Noise and change from all neighbours: most of them lie in order, so medians tell. */
static void learn(struct search *a)
{
    const struct gsn_sequence_stack *s = a->s;
    const size_t pairs = s->n - 1;
    double *shown = s->room, *slope = s->room + s->n, *off = s->room + 2 * s->n;

    for (size_t i = 0; i < pairs; i++) {
        const struct stand t = compare(s, i, i + 1);
        const double far = s->z[i + 1] - s->z[i];

        shown[i] = t.at_j - t.at_i;
        slope[i] = t.apart2 / (far * far);
    }
    memcpy(off, shown, pairs * sizeof *off);
    a->gain = gsn_median(off, pairs);
    for (size_t i = 0; i < pairs; i++) {
        const double far = s->z[i + 1] - s->z[i];

        off[i] = fabs(shown[i] - a->gain) * sqrt(slope[i]) * far / sqrt(2);
    }
    a->noise2 = pow(MAD_TO_SD * gsn_median(off, pairs), 2);
    a->slope2 = gsn_median(slope, pairs);
}

/* The distance over which a swap's logarithm of the likelihood ratio is expected to be `evidence`;
 * INFINITY: none is. With one section's change d in units of its noise, it is 2 d^2 f^2 over f
 * sections, and 2 d f its standard deviation. */
static double distance_of(const struct search *a, double evidence)
{
    if (!(a->gain > 0 && a->noise2 > 0 && a->slope2 > LEAST_CHANGE * a->noise2))
        return INFINITY;
    return sqrt(evidence * a->noise2 / (2 * a->gain * a->gain * a->slope2));
}

/* The distance over which 99 of 100 swaps give the evidence asked for: the greater root of
 * 2 m^2 - 2 q m = e, in evidence 2 m^2. */
static double distance_found(const struct search *a, double evidence)
{
    const double m = 0.5 * (NEARLY_ALL + sqrt(NEARLY_ALL * NEARLY_ALL + 2 * evidence));

    return distance_of(a, 2 * m * m);
}

/* The least distance from which on all swaps are found, in whole sections; 0: none are. */
static unsigned reach(const struct search *a)
{
    const double far = distance_found(a, SURE);

    if (a->told && distance_found(a, SURE_OF_NEIGHBOURS) <= 1)
        return 1;
    return far < (double)a->s->n ? (unsigned)fmax(ceil(far), 2) : 0;
}

/* How much likelier two sections lie in each other's places than in their own. Unless they are
 * neighbours, whose places are hardly apart, each by itself must be nearer to the other's. */
static double swapped(const struct search *a, size_t i, size_t j)
{
    const struct stand t = compare(a->s, i, j);

    if (j > i + 1 && (t.at_i <= 0 || t.at_j >= 0))
        return 0;
    return 2 * a->gain * (t.at_i - t.at_j) * t.apart2 / a->noise2;
}

/* How far the sections around two places are off the lines through their neighbours: the roughness
 * along z that a swap of the two could change. */
static double roughness(const struct gsn_sequence_stack *s, size_t i, size_t j)
{
    double sum = 0;

    for (size_t k = 0; k < s->n; k++) {
        const size_t di = k > i ? k - i : i - k, dj = k > j ? k - j : j - k;

        if (di <= SIDE || dj <= SIDE)
            sum += gsn_sequence_off_line(s, k);
    }
    return sum;
}

/* What is gained in roughness by swapping two sections; ret_share: of what it is; 0 where neither
 * the tissue of the two nor the roughness asks for it. */
static double smoother(const struct search *a, size_t i, size_t j, double sure, double *ret_share)
{
    struct gsn_sequence_stack *s = a->s;
    double before, after;

    if (!(s->z[j] - s->z[i] > distance_of(a, SURE)))
        return 0;
    /* Nothing lies beyond the last two, so nothing says which of them is the last. */
    if (j == i + 1 && (i == 0 || j + 1 == s->n))
        return 0;
    if (swapped(a, i, j) <= sure)
        return 0;
    before = roughness(s, i, j);
    gsn_sequence_exchange(s, i, j);
    after = roughness(s, i, j);
    gsn_sequence_exchange(s, i, j);
    if (!(after < (1 - LEAST_SMOOTHER) * before))
        return 0;
    *ret_share = 1 - after / before;
    return before - after;
}

static int is_duplicate(const struct gsn_sequence *found, unsigned a, unsigned b)
{
    for (size_t k = 0; k < found->count; k++)
        if (found->finding[k].kind == GSN_SEQUENCE_DUPLICATE && found->finding[k].a == a &&
            found->finding[k].b == b)
            return 1;
    return 0;
}

/* The swap that smooths most among sections that are in none yet: its share; 0: there is none. */
static double find_best(const struct search *a, const char *used, const char *near,
                        size_t ret_pair[2])
{
    double most = 0, gained = 0;

    for (size_t i = 0; i < a->s->n; i++)
        for (size_t j = i + 1; j < a->s->n && !used[i]; j++) {
            const int clean = j == i + 1 && !near[i] && !near[j] && a->told;
            double share = 0;
            const double gain =
                used[j] ? 0 : smoother(a, i, j, clean ? SURE_OF_NEIGHBOURS : SURE, &share);

            if (gain > most) {
                most = gain;
                gained = share;
                ret_pair[0] = i;
                ret_pair[1] = j;
            }
        }
    return gained;
}

/* The swap that smooths most comes first; the others are looked for as if it were undone, since
 * what lies beside swapped sections looks out of place too. No section is in two proposals. */
static void find_all(const struct search *a, const struct gsn_sequence_plane *planes, char *used,
                     char *near, struct gsn_sequence *found)
{
    size_t pair[2] = { 0, 0 };
    double share;

    while ((share = find_best(a, used, near, pair)) > 0) {
        const unsigned first = planes[pair[0]].serial, second = planes[pair[1]].serial;
        const double evidence = swapped(a, pair[0], pair[1]);

        for (int side = 0; side < 2; side++) {
            used[pair[side]] = 1;
            for (size_t k = 0; k < a->s->n; k++)
                near[k] = near[k] || (k + SIDE >= pair[side] && k <= pair[side] + SIDE);
        }
        gsn_sequence_exchange(a->s, pair[0], pair[1]);
        if (!is_duplicate(found, first, second))
            found->finding[found->count++] =
                (struct gsn_sequence_finding){ .kind = GSN_SEQUENCE_SWAP,
                                               .a = first,
                                               .b = second,
                                               .evidence = evidence,
                                               .smoother = share };
    }
}

int gsn_sequence_find_swaps(struct gsn_sequence_stack *s, const struct gsn_sequence_plane *planes,
                            struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto_mem(char) used = gsn_alloc_array(s->n, 1);
    gsn_auto_mem(char) near = gsn_alloc_array(s->n, 1); /* laid beside a wrong neighbour */
    struct search a = { .s = s };

    if (!used || !near)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", s->n);
    learn(&a);
    a.told = distance_of(&a, SURE) < 1;
    found->change = a.noise2 > 0 ? sqrt(a.slope2 / a.noise2) : 0;
    found->reach = reach(&a);
    find_all(&a, planes, used, near, found);
    return GSN_OK;
}
