/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Examines the order of the sections: duplicates first, then swaps without them.
 *
 * Steps: (1) sections that are there twice (duplicate.c). (2) All planes in cells, holes filled
 * from the nearest known value below and above, each scaled to one mean; aligned (align.c), their
 * noise learnt (predict.c), swaps searched (swap.c), as if nothing were known of the second mounts.
 * (3) Where the mounts of a pair do not lie side by side, or one is in a swap, either may be the
 * one that lies wrong: the search is done once more with the other left out, and of both answers
 * those swaps stand that bring the two together, and those found both ways that do not part them.
 * (4) How much a swap that does not show may carry from one place to another.
 *
 * Fails when memory runs out. */
#include "pipeline/register/order/sequence.h"

#include "pipeline/register/order/findings.h"
#include "pipeline/register/order/predict.h"

#include <assert.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LEAST = 8 };

/* ---- swaps beside a duplicate ------------------------------------------------------------- */

static size_t find_place(const struct gsn_sequence_plane *planes, unsigned serial)
{
    size_t k = 0;

    while (planes[k].serial != serial)
        k++;
    return k;
}

static size_t count_apart(size_t one, size_t other)
{
    return one > other ? one - other : other - one;
}

static int is_either(const struct gsn_sequence_finding *f, unsigned serial)
{
    return f->a == serial || f->b == serial;
}

static int is_of_twins(const struct gsn_sequence_finding *swap,
                       const struct gsn_sequence_finding *twins)
{
    return is_either(swap, twins->a) || is_either(swap, twins->b);
}

void gsn_sequence_leave_out(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found, int second, char *ret_out, size_t n)
{
    memset(ret_out, 0, n);
    for (size_t k = 0; k < found->count; k++)
        if (found->finding[k].kind == GSN_SEQUENCE_DUPLICATE)
            ret_out[find_place(planes, second ? found->finding[k].b : found->finding[k].a)] = 1;
}

int gsn_sequence_is_settled(const struct gsn_sequence_plane *planes,
                            const struct gsn_sequence *found)
{
    for (size_t k = 0; k < found->count; k++) {
        const struct gsn_sequence_finding *twins = &found->finding[k];

        if (twins->kind != GSN_SEQUENCE_DUPLICATE)
            continue;
        if (find_place(planes, twins->b) != find_place(planes, twins->a) + 1)
            return 0;
        for (size_t i = 0; i < found->count; i++)
            if (found->finding[i].kind == GSN_SEQUENCE_SWAP &&
                is_of_twins(&found->finding[i], twins))
                return 0;
    }
    return 1;
}

static const struct gsn_sequence_finding *find_same(const struct gsn_sequence *s,
                                                    const struct gsn_sequence_finding *swap)
{
    for (size_t k = 0; k < s->count; k++)
        if (s->finding[k].kind == GSN_SEQUENCE_SWAP && s->finding[k].a == swap->a &&
            s->finding[k].b == swap->b)
            return &s->finding[k];
    return NULL;
}

/* Where a section lies once a swap is undone. */
static size_t place_when_undone(const struct gsn_sequence_plane *planes,
                                const struct gsn_sequence_finding *swap, unsigned serial)
{
    if (swap->a == serial)
        return find_place(planes, swap->b);
    return find_place(planes, swap->b == serial ? swap->a : serial);
}

/* 1 where a swap brings two mounts side by side, -1 where it moves one from or past the other, 0
 * where it moves neither. */
static int brings_together(const struct gsn_sequence_plane *planes,
                           const struct gsn_sequence *duplicates,
                           const struct gsn_sequence_finding *swap)
{
    int moved = 0;

    for (size_t k = 0; k < duplicates->count; k++) {
        const struct gsn_sequence_finding *twins = &duplicates->finding[k];

        if (twins->kind != GSN_SEQUENCE_DUPLICATE || !is_of_twins(swap, twins))
            continue;
        if (count_apart(place_when_undone(planes, swap, twins->a),
                        place_when_undone(planes, swap, twins->b)) != 1)
            return -1;
        moved = 1;
    }
    return moved;
}

/* Whether another swap of one of its sections brings mounts together with more evidence. */
static int is_beaten(const struct gsn_sequence_plane *planes, const struct gsn_sequence *found,
                     const struct gsn_sequence *other, const struct gsn_sequence_finding *swap)
{
    for (size_t k = 0; k < other->count; k++) {
        const struct gsn_sequence_finding *f = &other->finding[k];

        if (f->kind == GSN_SEQUENCE_SWAP && brings_together(planes, found, f) > 0 &&
            (is_either(swap, f->a) || is_either(swap, f->b)) && f->evidence > swap->evidence)
            return 1;
    }
    return 0;
}

static int is_upheld(const struct gsn_sequence_plane *planes, const struct gsn_sequence *found,
                     const struct gsn_sequence *other, const struct gsn_sequence_finding *swap)
{
    const int together = brings_together(planes, found, swap);

    if (find_same(other, swap))
        return together >= 0;
    return together > 0 && !is_beaten(planes, found, other, swap);
}

void gsn_sequence_agree(const struct gsn_sequence_plane *planes, const struct gsn_sequence *other,
                        struct gsn_sequence *found, char *room)
{
    const size_t own = found->count;
    size_t count = 0;

    for (size_t k = 0; k < own; k++)
        room[k] = found->finding[k].kind != GSN_SEQUENCE_SWAP ||
                  is_upheld(planes, found, other, &found->finding[k]);
    for (size_t k = 0; k < other->count; k++)
        room[own + k] = other->finding[k].kind == GSN_SEQUENCE_SWAP &&
                        !find_same(found, &other->finding[k]) &&
                        is_upheld(planes, found, found, &other->finding[k]);
    for (size_t k = 0; k < own; k++)
        if (room[k])
            found->finding[count++] = found->finding[k];
    for (size_t k = 0; k < other->count; k++)
        if (room[own + k])
            found->finding[count++] = other->finding[k];
    found->count = count;
}

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

void gsn_sequence_sort(struct gsn_sequence *sequence)
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

/* ---- planes in cells ---------------------------------------------------------------------- */

struct cells {
    size_t n, columns, rows;
    double *z;    /* n */
    float *value; /* n * columns * rows */
    float *next;  /* as many: scratch */
};

/* The nearest known value of this cell below or above, or their mean. */
static double fill_in(const float *value, size_t n, size_t cells, size_t plane, size_t cell)
{
    double sum = 0;
    int found = 0;

    for (size_t k = plane; k-- > 0 && !found;)
        if (!isnan(value[k * cells + cell])) {
            sum += (double)value[k * cells + cell];
            found = 1;
        }
    for (size_t k = plane + 1, above = 0; k < n && !above; k++)
        if (!isnan(value[k * cells + cell])) {
            sum += (double)value[k * cells + cell];
            found++;
            above = 1;
        }
    return found ? sum / found : 0;
}

/* Holes are filled from the neighbours, each plane is scaled to a mean of 1. */
static void gather_cells(const struct gsn_sequence_plane *planes, struct cells *a)
{
    const size_t cells = a->columns * a->rows;

    for (size_t i = 0; i < a->n; i++) {
        a->z[i] = planes[i].serial;
        memcpy(a->next + i * cells, planes[i].density, cells * sizeof *a->next);
    }
    for (size_t i = 0; i < a->n; i++) {
        double sum = 0;

        for (size_t c = 0; c < cells; c++) {
            const float own = a->next[i * cells + c];

            a->value[i * cells + c] = isnan(own) ? (float)fill_in(a->next, a->n, cells, i, c) : own;
            sum += (double)a->value[i * cells + c];
        }
        for (size_t c = 0; sum > 0 && c < cells; c++)
            a->value[i * cells + c] *= (float)((double)cells / sum);
    }
}

/* The density of tissue, glass left aside: the mean weighed by itself. */
static double measure_level(const float *value, size_t count)
{
    double sum = 0, square = 0;

    for (size_t i = 0; i < count; i++) {
        sum += (double)value[i];
        square += (double)value[i] * (double)value[i];
    }
    return sum > 0 ? square / sum : 1;
}

static void fill_tissue(const struct gsn_sequence_plane *planes, const char *out,
                        struct cells *cells, struct gsn_sequence_tissue *t)
{
    const size_t count = t->columns * t->rows;
    double level;

    gather_cells(planes, cells);
    level = measure_level(cells->value, t->n * count);
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
    struct cells cells = { .n = n, .columns = columns, .rows = rows };
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
    t.predictable = t.whole + n * count;
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
    r = gsn_sequence_register(&t, err);
    if (r >= 0)
        r = gsn_sequence_learn_noise(&t, err);
    if (r >= 0)
        r = gsn_sequence_find_swaps(&t, planes, out, found, err);
    if (r >= 0)
        found->unseen =
            measure_unseen(planes, n, count, found->reach ? found->reach : (unsigned)-1);
    return r;
}

/* Of a section that is there twice one mount is left out, and where it may be the other that lies
 * wrong, that one too. */
static int find_swaps_once(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                           size_t rows, struct gsn_sequence *found, struct gsn_error *err)
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
    int r = check_serials(planes, count, err);

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
        r = find_swaps_once(planes, count, columns, rows, found, err);
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
