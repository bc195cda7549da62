/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: two sections that lie in each other's places are each more like those around the other's
 * place (seriation, seriation.h; Robinson 1951).
 *
 * Steps of gsn_sequence_find_swaps(). 1. How much the exchange of every two sections would gain,
 * in standard errors of this stack's own steps. 2. The two that gain most, above LEAST, are named
 * and taken as exchanged; what lies beside them had looked out of
 * place too, and no longer does. 3. Again, until none gains so much; no section is named twice. 4.
 * What share of swaps would show: of the stack's own pairs, exchanged one by one.
 *
 * Which of the last two at either end is the last cannot be told. Fails when memory runs out; of
 * too few sections nothing is said (seriation.c). Cost: n^2 / 2 correlations, then n^2 / 2 sums of
 * twenty of them for each swap that is named. */
#include "pipeline/register/order/findings.h"
#include "pipeline/register/order/seriation.h"

/* Standard errors by which two sections must be more like those around the other's place, together.
 * By chance both places say so of two sections that could as well lie either way once in 200 000
 * pairs; 120 sections have 7140. */
static const double LEAST = 4;

/* Of all swaps at a distance so many show where it is said that they do. */
static const double NEARLY_ALL = 0.95;

struct swap {
    size_t i, j;
    double gain;
};

static struct swap find_best(const struct gsn_seriation *path, const char *out, size_t n)
{
    struct swap best = { .gain = LEAST };

    for (size_t i = 0; i < n; i++)
        for (size_t j = i + 1; j < n && !out[i]; j++) {
            const double gain = out[j] ? 0 : gsn_seriation_exchange_gain(path, i, j);

            if (gain > best.gain)
                best = (struct swap){ i, j, gain };
        }
    return best;
}

/* Whether a swap of two sections, which as far as is known lie in order, would show. */
static int would_show(struct gsn_seriation *path, size_t i, size_t j)
{
    double gain;

    gsn_seriation_exchange(path, i, j);
    gain = gsn_seriation_exchange_gain(path, i, j);
    gsn_seriation_exchange(path, i, j);
    return gain > LEAST;
}

/* Share of the swaps so far apart that would show. */
static double share_shown(struct gsn_seriation *path, size_t n, size_t apart)
{
    size_t shown = 0, pairs = 0;

    for (size_t i = 0; i + apart < n; i++)
        if (apart > 1 || (i > 0 && i + 2 < n)) {
            shown += (size_t)would_show(path, i, i + apart);
            pairs++;
        }
    return pairs ? (double)shown / (double)pairs : 0;
}

static void tell_reach(struct gsn_seriation *path, size_t n, struct gsn_sequence *found)
{
    for (size_t f = 1; f <= GSN_SEQUENCE_NEAR; f++)
        found->shown[f - 1] = share_shown(path, n, f);
    for (size_t f = n - 1; f > 0 && share_shown(path, n, f) >= NEARLY_ALL; f--)
        found->reach = (unsigned)f;
}

int gsn_sequence_find_swaps(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                            size_t rows, char *out, struct gsn_sequence *found,
                            struct gsn_error *err)
{
    gsn_auto(gsn_seriation) path = NULL;
    const int r = gsn_seriation_new(planes, n, columns, rows, &path, err);

    if (r < 0)
        return r;
    for (;;) {
        const struct swap swap = find_best(path, out, n);

        if (swap.j == 0)
            break;
        out[swap.i] = out[swap.j] = 1;
        gsn_seriation_exchange(path, swap.i, swap.j);
        found->finding[found->count++] = (struct gsn_sequence_finding){ .kind = GSN_SEQUENCE_SWAP,
                                                                        .a = planes[swap.i].serial,
                                                                        .b = planes[swap.j].serial,
                                                                        .evidence = swap.gain };
    }
    tell_reach(path, n, found);
    return GSN_OK;
}
