/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence.h"

#include "pipeline/register/median.h"
#include "pipeline/register/sequence_parts.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LEAST = 8 };

static int check(const struct gsn_sequence_plane *planes, size_t count, struct gsn_error *err)
{
    for (size_t i = 1; i < count; i++)
        if (planes[i].serial <= planes[i - 1].serial)
            return gsn_fail(err, GSN_E_INPUT,
                            "section %u comes after section %u: serial numbers must rise",
                            planes[i].serial + 1, planes[i - 1].serial + 1);
    return GSN_OK;
}

static int order(const void *a, const void *b)
{
    const struct gsn_sequence_finding *f = a, *g = b;

    if (f->kind != g->kind)
        return f->kind < g->kind ? -1 : 1;
    if (f->evidence != g->evidence)
        return f->evidence > g->evidence ? -1 : 1;
    return f->a < g->a ? -1 : f->a > g->a;
}

/* A plane's product with itself holds the noise of all its cells, which would make every line look
 * longer than it is: that is taken off, as much as the median plane is off its line. */
static void take_off_noise(struct gsn_sequence_stack *s)
{
    double median;

    for (size_t i = 0; i < s->n; i++)
        s->room[i] = gsn_sequence_off_line(s, i);
    median = gsn_median(s->room, s->n);
    for (size_t i = 0; i < s->n; i++)
        s->gram[i * s->n + i] -= median;
}

/* How much a swap of sections that is not seen carries from one place to the other, as a share of
 * all density: the most that any two so near differ by. */
static double unseen(const struct gsn_sequence_plane *planes, size_t count, size_t cells,
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

static int examine(const struct gsn_sequence_plane *planes, struct gsn_sequence_cells *cells,
                   struct gsn_sequence_stack *stack, struct gsn_sequence *found,
                   struct gsn_error *err)
{
    int r = gsn_sequence_find_duplicates(planes, cells->n, GSN_SEQUENCE_FINER * cells->columns,
                                         GSN_SEQUENCE_FINER * cells->rows, found, err);

    if (r < 0)
        return r;
    gsn_sequence_gather(planes, cells);
    gsn_sequence_align(cells);
    gsn_sequence_smooth(cells);
    gsn_sequence_align(cells);
    gsn_sequence_multiply(cells, stack);
    gsn_sequence_reduce(stack);
    take_off_noise(stack);
    r = gsn_sequence_find_swaps(stack, planes, found, err);
    if (r >= 0)
        found->unseen = unseen(planes, cells->n, cells->columns * cells->rows,
                               found->reach ? found->reach : (unsigned)-1);
    return r;
}

static int with_room(const struct gsn_sequence_plane *planes, size_t n, size_t columns, size_t rows,
                     struct gsn_sequence *found, struct gsn_error *err)
{
    const size_t count = columns * rows;
    gsn_auto_mem(double) of_planes = gsn_alloc_array(n, sizeof *of_planes);
    gsn_auto_mem(double) gram = gsn_alloc_array(n * n, sizeof *gram);
    gsn_auto_mem(float) value = gsn_alloc_array(2 * n * count, sizeof *value);
    gsn_auto_mem(double) mean = gsn_alloc_array(count, sizeof *mean);
    gsn_auto_mem(double) room = gsn_alloc_array(2 * n * n + 4 * n, sizeof *room);
    struct gsn_sequence_cells cells = { .n = n, .columns = columns, .rows = rows };
    struct gsn_sequence_stack stack = { .n = n, .z = of_planes, .gram = gram };

    if (!of_planes || !gram || !value || !mean || !room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", n);
    cells.z = of_planes;
    cells.value = value;
    cells.next = value + n * count;
    cells.mean = mean;
    stack.room = room;
    return examine(planes, &cells, &stack, found, err);
}

int gsn_sequence_examine(const struct gsn_sequence_plane *planes, size_t count, size_t columns,
                         size_t rows, struct gsn_sequence **ret_sequence, struct gsn_error *err)
{
    gsn_auto(gsn_sequence) found = gsn_alloc_array(1, sizeof *found);
    int r = check(planes, count, err);

    assert(ret_sequence);

    if (r < 0)
        return r;
    if (found)
        found->finding = gsn_alloc_array(2 * count + 1, sizeof *found->finding);
    if (!found || !found->finding)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", count);
    if (count >= LEAST)
        r = with_room(planes, count, columns, rows, found, err);
    if (r < 0)
        return r;
    qsort(found->finding, found->count, sizeof *found->finding, order);
    *ret_sequence = gsn_steal(&found);
    return GSN_OK;
}

void gsn_sequence_free(struct gsn_sequence *sequence)
{
    if (!sequence)
        return;
    gsn_free(sequence->finding);
    gsn_free(sequence);
}
