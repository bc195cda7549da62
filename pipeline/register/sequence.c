/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence.h"

#include "pipeline/register/sequence_parts.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>

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
    if (f->a != g->a)
        return f->a < g->a ? -1 : 1;
    return f->b < g->b ? -1 : f->b > g->b;
}

void gsn_sequence_sort(struct gsn_sequence *sequence)
{
    qsort(sequence->finding, sequence->count, sizeof *sequence->finding, order);
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

/* The density of tissue, glass left aside: the mean weighed by itself. */
static double level_of(const float *value, size_t count)
{
    double sum = 0, square = 0;

    for (size_t i = 0; i < count; i++) {
        sum += (double)value[i];
        square += (double)value[i] * (double)value[i];
    }
    return sum > 0 ? square / sum : 1;
}

static void fill_tissue(const struct gsn_sequence_plane *planes, const char *out,
                        struct gsn_sequence_cells *cells, struct gsn_sequence_tissue *t)
{
    const size_t count = t->columns * t->rows;
    double level;

    gsn_sequence_gather(planes, cells);
    level = level_of(cells->value, t->n * count);
    for (size_t k = 0; k < t->n; k++)
        t->place[k] = k;
    for (size_t c = 0; c < t->n * count; c++) {
        t->filled[c] = (float)((double)cells->value[c] / level);
        t->whole[c] =
            (unsigned char)(!out[c / count] && !isnan(planes[c / count].density[c % count]));
    }
}

/* As if nothing were known of the sections that are left out. */
static int find_swaps(const struct gsn_sequence_plane *planes, const char *out, size_t n,
                      size_t columns, size_t rows, struct gsn_sequence *found,
                      struct gsn_error *err)
{
    const size_t count = columns * rows;
    gsn_auto_mem(double) z = gsn_alloc_array(n, sizeof *z);
    gsn_auto_mem(size_t) place = gsn_alloc_array(n, sizeof *place);
    gsn_auto_mem(float) value = gsn_alloc_array(2 * n * count, sizeof *value);
    gsn_auto_mem(unsigned char) known = gsn_alloc_array((2 * n + 1) * count, 1);
    double(*motion)[GSN_SEQUENCE_MOTION] = gsn_alloc_array(n, sizeof *motion);
    gsn_auto_mem(void) own_motion = motion;
    gsn_auto_mem(float) of_cells = gsn_alloc_array(7 * count, sizeof *of_cells);
    gsn_auto_mem(struct gsn_sequence_square) square = gsn_alloc_array(count, sizeof *square);
    gsn_auto_mem(void) modes = gsn_alloc(gsn_sequence_modes_size(columns, rows));
    struct gsn_sequence_cells cells = { .n = n, .columns = columns, .rows = rows };
    struct gsn_sequence_tissue t = { .n = n, .columns = columns, .rows = rows };
    int r;

    if (!z || !place || !value || !known || !motion || !of_cells || !square || !modes)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", n);
    cells.z = z;
    cells.value = t.filled = value;
    cells.next = t.value = value + n * count;
    t.z = z;
    t.place = place;
    t.known = known;
    t.whole = known + n * count;
    t.told = t.whole + n * count;
    t.motion = motion;
    t.noise2 = of_cells;
    t.deviation = of_cells + count;
    t.change = of_cells + 2 * count;
    t.energy = of_cells + 3 * count;
    t.onto = of_cells + 4 * count;
    t.off = of_cells + 5 * count;
    t.off_too = of_cells + 6 * count;
    t.modes = modes;
    t.square = square;
    fill_tissue(planes, out, &cells, &t);
    r = gsn_sequence_lay(&t, err);
    if (r >= 0)
        r = gsn_sequence_learn_noise(&t, err);
    if (r >= 0)
        r = gsn_sequence_find_swaps(&t, planes, out, found, err);
    if (r >= 0)
        found->unseen = unseen(planes, n, count, found->reach ? found->reach : (unsigned)-1);
    return r;
}

/* Of a section that is there twice one mount is left out, and where it may be the other that lies
 * wrong, that one too. */
static int find_once(const struct gsn_sequence_plane *planes, size_t n, size_t columns, size_t rows,
                     struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto_mem(char) out = gsn_alloc_array(4 * n + 2, 1);
    gsn_auto_mem(struct gsn_sequence_finding) finding = gsn_alloc_array(n + 1, sizeof *finding);
    struct gsn_sequence other = { .finding = finding };
    int r;

    if (!out || !finding)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the order of %zu sections", n);
    gsn_sequence_leave_out(planes, found, 0, out, n);
    r = find_swaps(planes, out, n, columns, rows, found, err);
    if (r < 0 || gsn_sequence_is_settled(planes, found))
        return r;
    gsn_sequence_leave_out(planes, found, 1, out, n);
    r = find_swaps(planes, out, n, columns, rows, &other, err);
    if (r >= 0)
        gsn_sequence_agree(planes, &other, found, out);
    return r;
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
        r = gsn_sequence_find_duplicates(planes, count, columns, rows, found, err);
    if (r >= 0 && count >= LEAST)
        r = find_once(planes, count, columns, rows, found, err);
    if (r < 0)
        return r;
    gsn_sequence_sort(found);
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
