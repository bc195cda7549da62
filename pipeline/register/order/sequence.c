/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Examines the order of the sections: duplicates first, then swaps of the others.
 *
 * Steps: (1) sections that are there twice (duplicate.c). (2) Swaps (swap.c) of what is there once:
 * which of two mounts lies wrong is for a person to see. (3) How much a swap that does not show may
 * carry from one place to another. (4) When asked, second mounts among the sections that are not
 * registered (duplicate.c). What is found is sorted, the surest first within each kind.
 *
 * Fails when memory runs out. */
#include "pipeline/register/order/sequence.h"

#include "pipeline/register/order/findings.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

enum { LEAST = 8 };

static int check_serials(const struct gsn_sequence_plane *planes, size_t count,
                         struct gsn_error *err)
{
    for (size_t i = 1; i < count; i++)
        if (planes[i].serial <= planes[i - 1].serial)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %u comes after section %u: serial numbers must rise",
                            planes[i].serial + 1, planes[i - 1].serial + 1);
    return GSN_OK;
}

static int compare_findings(const void *a, const void *b)
{
    const struct gsn_sequence_finding *f = a, *g = b;

    if (f->kind != g->kind)
        return f->kind < g->kind ? -1 : 1;
    if (f->evidence != g->evidence)
        return f->evidence > g->evidence ? -1 : 1;
    if (f->a != g->a)
        return f->a < g->a ? -1 : 1;
    return f->b < g->b ? -1 : f->b > g->b;
}

static void sort_findings(struct gsn_sequence *sequence)
{
    qsort(sequence->finding, sequence->count, sizeof *sequence->finding, compare_findings);
}

/* How much a swap of sections that is not seen carries from one place to the other, as a share of
 * all density: the most that any two so near differ by. */
static double measure_unseen(const struct gsn_sequence_plane *planes, size_t count, size_t cells,
                             unsigned reach)
{
    double all = 0, most = 0;

    for (size_t i = 0; i < count; i++)
        for (size_t c = 0; c < cells; c++)
            all += isnan(planes[i].density[c]) ? 0 : fabs((double)planes[i].density[c]);
    for (size_t i = 0; i < count; i++)
        for (size_t j = i + 1; j < count && planes[j].serial - planes[i].serial < reach; j++) {
            double apart = 0;

            for (size_t c = 0; c < cells; c++) {
                const double off = (double)planes[i].density[c] - (double)planes[j].density[c];

                apart += isnan(off) ? 0 : fabs(off);
            }
            most = fmax(most, apart);
        }
    return all > 0 ? most / all : 0;
}

/* What is there twice is in no swap. */
static void leave_out(const struct gsn_sequence_plane *planes, size_t n,
                      const struct gsn_sequence *found, char *ret_out)
{
    for (size_t k = 0; k < n; k++)
        for (size_t i = 0; i < found->count; i++)
            ret_out[k] |=
                planes[k].serial == found->finding[i].a || planes[k].serial == found->finding[i].b;
}

static int find_all(const struct gsn_sequence_plane *planes, size_t n, size_t columns, size_t rows,
                    struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto_mem(char) out = gsn_alloc_array(n, 1);
    int r = gsn_sequence_find_duplicates(planes, n, columns, rows, found, err);

    if (r >= 0 && !out)
        r = gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", n);
    if (r < 0)
        return r;
    leave_out(planes, n, found, out);
    r = gsn_sequence_find_swaps(planes, n, columns, rows, out, found, err);
    if (r >= 0)
        found->unseen =
            measure_unseen(planes, n, columns * rows, found->reach ? found->reach : (unsigned)-1);
    return r;
}

int gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                         size_t rows, struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto(gsn_sequence) found = gsn_alloc_array(1, sizeof *found);
    int r = check_serials(planes, count, err);

    assert(ret_sequence);

    if (r < 0)
        return r;
    if (found)
        found->finding = gsn_alloc_array(2 * count + 1, sizeof *found->finding);
    if (!found || !found->finding)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", count);
    if (count >= LEAST)
        r = find_all(planes, count, columns, rows, found, err);
    if (r < 0)
        return r;
    sort_findings(found);
    *ret_sequence = gsn_steal(&found);
    return GSN_OK;
}

int gsn_sequence_examine_excluded(const struct gsn_sequence_plane *planes, size_t count,
                                  size_t columns, size_t rows,
                                  const struct gsn_sequence_excluded *held, size_t held_count,
                                  struct gsn_sequence *sequence, struct gsn_error *err)
{
    int r;

    if (held_count == 0 || !sequence->duplicates_known)
        return GSN_OK;
    r = gsn_sequence_find_excluded(planes, count, columns, rows, held, held_count, sequence, err);
    if (r < 0)
        return r;
    sort_findings(sequence);
    return GSN_OK;
}

void gsn_sequence_free(struct gsn_sequence *sequence)
{
    if (!sequence)
        return;
    gsn_free(sequence->finding);
    gsn_free(sequence);
}
