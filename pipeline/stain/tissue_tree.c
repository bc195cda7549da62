/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The bodies of which the tissue is made while the level above which it counts falls: a tree of
 * components (Salembier's max-tree), of which only the bodies too pale for bone are kept. */
#include "pipeline/stain/tissue_body.h"

#include <stdlib.h>
#include <string.h>

/* Smaller is no core of a root: a ball of 200 um. */
static const double LEAST_CORE_UM3 = 5e6;
enum { LEVELS = 48, PER_LEVEL = GSN_BODY_ALONE / LEVELS };

/* The bodies while the level falls; of one body all voxels lead to the same one by `up`. */
struct tree {
    uint32_t *up, *voxels;
    double *sum;
};

static uint32_t root_of(uint32_t *up, uint32_t i)
{
    while (up[i] != i) {
        up[i] = up[up[i]];
        i = up[i];
    }
    return i;
}

static void join(struct tree *t, uint32_t a, uint32_t b)
{
    a = root_of(t->up, a);
    b = root_of(t->up, b);
    if (a == b)
        return;
    if (t->voxels[a] < t->voxels[b]) {
        const uint32_t c = a;

        a = b;
        b = c;
    }
    t->up[b] = a;
    t->voxels[a] += t->voxels[b];
    t->sum[a] += t->sum[b];
}

static int level_of(const struct gsn_body *b, size_t i, double bone)
{
    const double share = b->least[i] / bone;
    const double at =
        (GSN_BODY_MOST_OF_BONE - share) / (GSN_BODY_MOST_OF_BONE - GSN_BODY_LEAST_OF_BONE) * LEVELS;

    return at < 0 ? 0 : at >= LEVELS ? LEVELS : (int)at;
}

/* Adds the voxels of one level, listed in list[from, to), to the bodies. */
static void lower(const struct gsn_body *b, struct tree *t, size_t from, size_t to)
{
    for (size_t k = from; k < to; k++) {
        const uint32_t i = b->list[k];
        uint32_t beside[6];
        const int n = gsn_body_beside(b, i, beside);

        t->up[i] = i;
        t->voxels[i] = 1;
        t->sum[i] = (double)b->value[i];
        for (int s = 0; s < n; s++)
            if (t->up[beside[s]] != UINT32_MAX)
                join(t, i, beside[s]);
    }
}

static int larger_first(const void *a, const void *b)
{
    const struct gsn_body_alone *p = a, *q = b;

    if (p->voxels != q->voxels)
        return p->voxels < q->voxels ? 1 : -1;
    return (p->voxel > q->voxel) - (p->voxel < q->voxel);
}

/* Adds a candidate to the largest of one level. */
static void note(struct gsn_body_alone *best, const struct gsn_body_alone *one)
{
    struct gsn_body_alone *least = &best[0];

    for (int k = 1; k < PER_LEVEL; k++)
        least = best[k].voxels < least->voxels ? &best[k] : least;
    if (one->voxels > least->voxels)
        *least = *one;
}

/* The bodies of a level that are too pale for bone and large enough. */
static void list_bodies(const struct gsn_body *b, const struct tree *t, size_t to, double above,
                        double bone, struct gsn_body_alone *best)
{
    const double voxel = gsn_lattice_voxel_um3(&b->at);

    for (size_t k = 0; k < to; k++) {
        const uint32_t i = b->list[k];

        if (t->up[i] == i && t->voxels[i] * voxel >= LEAST_CORE_UM3 &&
            t->sum[i] < GSN_BODY_MOST_OF_BONE * bone * t->voxels[i])
            note(best,
                 &(struct gsn_body_alone){ .above = above, .voxels = t->voxels[i], .voxel = i });
    }
}

/* Sorts the voxels by level into list; begins[k] is where level k begins. */
static void sort_voxels(struct gsn_body *b, double bone, size_t begins[LEVELS + 2])
{
    size_t next[LEVELS + 1];

    memset(begins, 0, (LEVELS + 2) * sizeof *begins);
    for (size_t i = 0; i < b->count; i++)
        begins[level_of(b, i, bone) + 1]++;
    for (int k = 0; k <= LEVELS; k++)
        begins[k + 1] += begins[k];
    memcpy(next, begins, sizeof next);
    for (size_t i = 0; i < b->count; i++)
        b->list[next[level_of(b, i, bone)]++] = (uint32_t)i;
}

int gsn_body_list_alone(struct gsn_body *b, double bone,
                        struct gsn_body_alone ret_found[GSN_BODY_ALONE], struct gsn_error *err)
{
    gsn_auto_mem(uint32_t) up = gsn_alloc_array(b->count, sizeof *up);
    gsn_auto_mem(uint32_t) voxels = gsn_alloc_array(b->count, sizeof *voxels);
    gsn_auto_mem(double) sum = gsn_alloc_array(b->count, sizeof *sum);
    struct tree t = { up, voxels, sum };
    size_t begins[LEVELS + 2];

    if (!up || !voxels || !sum)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
    memset(up, 0xff, b->count * sizeof *up);
    memset(ret_found, 0, GSN_BODY_ALONE * sizeof *ret_found);
    sort_voxels(b, bone, begins);
    for (size_t k = 0; k < LEVELS; k++) {
        const double share =
            GSN_BODY_MOST_OF_BONE -
            (GSN_BODY_MOST_OF_BONE - GSN_BODY_LEAST_OF_BONE) * (double)(k + 1) / LEVELS;

        lower(b, &t, begins[k], begins[k + 1]);
        list_bodies(b, &t, begins[k + 1], share * bone, bone, &ret_found[k * PER_LEVEL]);
    }
    qsort(ret_found, GSN_BODY_ALONE, sizeof *ret_found, larger_first);
    return GSN_OK;
}
