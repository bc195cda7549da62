/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The root of a tooth by how its density lies, and not by a level stated for it.
 *
 * Take all that is denser than some level. When the level falls, bodies grow and join; the root
 * stands alone from where its dentine comes up to where the level reaches the ligament, which all
 * around is the lower pass to the bone. Bone that a lesion has thinned may have the density of
 * dentine, but it passes into the bone beside it and never stands alone. So every body that stands
 * alone at some level is a candidate (a tree of components), the largest that lies in something
 * paler is the core of the root, and from there on it is a watershed: core and bone grow downhill,
 * each its own way, and meet in the ligament. */
#include "pipeline/stain/tissue.h"

#include "pipeline/stain/order.h"
#include "pipeline/stain/segment.h"
#include "pipeline/stain/tissue_body.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Below this share of the red of bone it is loose tissue, above it bone. */
static const double LEAST_OF_BONE = 0.35, MOST_OF_BONE = 0.82;
/* What lies around a root is tissue: it has this share of the red of bone. */
static const double LEAST_AROUND = 0.15;
/* And no more than this share of it is as dense as the root itself. */
static const double MOST_DENSER = 0.2;
/* A root of less is a splinter: a ball of 300 um. Its core is smaller. */
static const double LEAST_ROOT_UM3 = 1.4e7, LEAST_CORE_UM3 = 5e6;
/* A ligament begins behind the blur of the border and is about 100 um wide at least, in voxels. */
enum { BLURRED = 1, AROUND = 3 };
enum { LEVELS = 48, PER_LEVEL = 4, CANDIDATES = LEVELS * PER_LEVEL, BUCKETS = 2048, PASSES = 3 };

/* A body that stands alone among what is denser than a level. */
struct candidate {
    double above;
    size_t voxels;
    uint32_t voxel; /* one of them */
};

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
    const double at = (MOST_OF_BONE - share) / (MOST_OF_BONE - LEAST_OF_BONE) * LEVELS;

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
    const struct candidate *p = a, *q = b;

    if (p->voxels != q->voxels)
        return p->voxels < q->voxels ? 1 : -1;
    return (p->voxel > q->voxel) - (p->voxel < q->voxel);
}

/* Adds a candidate to the largest of one level. */
static void note(struct candidate *best, const struct candidate *one)
{
    struct candidate *least = &best[0];

    for (int k = 1; k < PER_LEVEL; k++)
        least = best[k].voxels < least->voxels ? &best[k] : least;
    if (one->voxels > least->voxels)
        *least = *one;
}

/* The bodies of a level that are too pale for bone and large enough. */
static void list_bodies(const struct gsn_body *b, const struct tree *t, size_t to, double above,
                        double bone, struct candidate *best)
{
    const double voxel = gsn_lattice_voxel_um3(&b->at);

    for (size_t k = 0; k < to; k++) {
        const uint32_t i = b->list[k];

        if (t->up[i] == i && t->voxels[i] * voxel >= LEAST_CORE_UM3 &&
            t->sum[i] < MOST_OF_BONE * bone * t->voxels[i])
            note(best, &(struct candidate){ .above = above, .voxels = t->voxels[i], .voxel = i });
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

/* Candidates, the largest first; those with no voxels are none. */
static int list_candidates(struct gsn_body *b, double bone, struct candidate found[CANDIDATES],
                           struct gsn_error *err)
{
    gsn_auto_mem(uint32_t) up = gsn_alloc_array(b->count, sizeof *up);
    gsn_auto_mem(uint32_t) voxels = gsn_alloc_array(b->count, sizeof *voxels);
    gsn_auto_mem(double) sum = gsn_alloc_array(b->count, sizeof *sum);
    struct tree t = { up, voxels, sum };
    size_t begins[LEVELS + 2];

    if (!up || !voxels || !sum)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
    memset(up, 0xff, b->count * sizeof *up);
    memset(found, 0, CANDIDATES * sizeof *found);
    sort_voxels(b, bone, begins);
    for (size_t k = 0; k < LEVELS; k++) {
        const double share =
            MOST_OF_BONE - (MOST_OF_BONE - LEAST_OF_BONE) * (double)(k + 1) / LEVELS;

        lower(b, &t, begins[k], begins[k + 1]);
        list_bodies(b, &t, begins[k + 1], share * bone, bone, &found[k * PER_LEVEL]);
    }
    qsort(found, CANDIDATES, sizeof *found, larger_first);
    return GSN_OK;
}

/* ---- what lies around ----------------------------------------------------------------------- */

/* The voxels whose set is 1 grow by some layers; returns how many the list then holds in all, of
 * which the first *ret_inner were reached within `inner` layers. */
static size_t grow(struct gsn_body *b, int inner, int layers, size_t *ret_inner)
{
    size_t n = 0, from = 0;

    for (size_t i = 0; i < b->count; i++)
        if (b->set[i])
            b->list[n++] = (uint32_t)i;
    for (int layer = 1; layer <= layers; layer++) {
        const size_t to = n;

        for (size_t k = from; k < to; k++) {
            uint32_t beside[6];
            const int around = gsn_body_beside(b, b->list[k], beside);

            for (int s = 0; s < around; s++)
                if (!b->set[beside[s]]) {
                    b->set[beside[s]] = 1;
                    b->list[n++] = beside[s];
                }
        }
        from = to;
        if (layer == inner)
            *ret_inner = n;
    }
    return n;
}

/* Median of the tissue around the body that the set is, behind the blur of its border; the share of
 * it that is denser than `dentine`. The set comes back as it was. */
static double look_around(struct gsn_body *b, double dentine, uint8_t *keep, double *scratch,
                          double *ret_denser)
{
    size_t inner = 0, n, denser = 0, count = 0;

    memcpy(keep, b->set, b->count);
    n = grow(b, BLURRED, BLURRED + AROUND, &inner);
    for (size_t k = inner; k < n; k++) {
        scratch[count++] = b->value[b->list[k]];
        denser += b->value[b->list[k]] > dentine;
    }
    memcpy(b->set, keep, b->count);
    *ret_denser = count > 0 ? (double)denser / (double)count : 1;
    return count > 0 ? gsn_order_pick(scratch, count, count / 2) : 0;
}

struct work {
    uint8_t *keep;
    double *scratch;
    uint32_t *next; /* chains of the flood's buckets */
};

/* The set becomes the candidate's voxels; the median of them. */
static double show(struct gsn_body *b, const struct candidate *c, double *scratch)
{
    size_t n;

    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->least[i] > c->above;
    n = gsn_body_flood(b, c->voxel);
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] == 2;
    for (size_t k = 0; k < n; k++)
        scratch[k] = b->value[b->list[k]];
    return n > 0 ? gsn_order_pick(scratch, n, n / 2) : 0;
}

/* The core of the root as the set, and the level between it and what lies around it. Whether there
 * is one. */
static int find_core(struct gsn_body *b, const struct candidate *found, struct work *w,
                     struct gsn_tissue_levels *levels)
{
    for (int k = 0; k < CANDIDATES && found[k].voxels > 0; k++) {
        const double dentine = show(b, &found[k], w->scratch);
        double around, denser;
        size_t grown;

        if (!(dentine < MOST_OF_BONE * levels->bone))
            continue;
        (void)grow(b, 0, 1, &grown); /* back to where the level was */
        gsn_body_fill_sections(b);
        around = look_around(b, dentine, w->keep, w->scratch, &denser);
        if (around < LEAST_AROUND * levels->bone || denser > MOST_DENSER)
            continue;
        levels->dentine = dentine;
        levels->border = (dentine + around) / 2;
        (void)show(b, &found[k], w->scratch);
        return 1;
    }
    return 0;
}

/* ---- the watershed -------------------------------------------------------------------------- */

enum { NOBODY, ROOT, OTHER };

struct flood {
    const struct gsn_body *b;
    uint8_t *whose;
    uint32_t *next, bucket[BUCKETS];
    double most; /* density */
};

static int bucket_of(const struct flood *f, size_t i)
{
    const double at = (1 - f->b->value[i] / f->most) * BUCKETS;

    return at < 0 ? 0 : at >= BUCKETS ? BUCKETS - 1 : (int)at;
}

/* Puts a voxel's unclaimed neighbours into the buckets, none before `now`. The lowest bucket used.
 */
static void claim_beside(struct flood *f, size_t i, int now)
{
    uint32_t beside[6];
    const int n = gsn_body_beside(f->b, i, beside);

    for (int s = 0; s < n; s++) {
        const int own = bucket_of(f, beside[s]), k = own > now ? own : now;

        if (f->whose[beside[s]] != NOBODY)
            continue;
        f->whose[beside[s]] = f->whose[i];
        f->next[beside[s]] = f->bucket[k];
        f->bucket[k] = beside[s];
    }
}

/* Every voxel goes to whom it is reached from first, the densest first. */
static void run_flood(struct flood *f)
{
    memset(f->bucket, 0xff, sizeof f->bucket);
    for (size_t i = 0; i < f->b->count; i++)
        if (f->whose[i] != NOBODY)
            f->next[i] = UINT32_MAX - 1; /* a seed */
        else
            f->next[i] = UINT32_MAX;
    for (size_t i = 0; i < f->b->count; i++)
        if (f->next[i] == UINT32_MAX - 1)
            claim_beside(f, i, 0);
    for (int k = 0; k < BUCKETS; k++)
        while (f->bucket[k] != UINT32_MAX) {
            const uint32_t i = f->bucket[k];

            f->bucket[k] = f->next[i];
            claim_beside(f, i, k);
        }
}

/* The set, the core of a root, becomes the root: what belongs to it and not to the bone or the
 * glass, and is denser than the ligament. */
static void spread(struct gsn_body *b, const struct gsn_tissue_levels *levels, struct work *w)
{
    struct flood f = { .b = b, .whose = w->keep, .next = w->next, .most = levels->bone };
    const double bone = fmax(levels->border, MOST_OF_BONE * levels->bone);

    for (size_t i = 0; i < b->count; i++)
        f.whose[i] = b->set[i]                                            ? ROOT
                     : b->least[i] > bone || b->value[i] < GSN_BODY_GLASS ? OTHER
                                                                          : NOBODY;
    run_flood(&f);
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] || (f.whose[i] == ROOT && b->value[i] > levels->border);
    gsn_body_fill_sections(b);
    gsn_body_tidy(b);
}

/* The levels anew, from the root that the set is; its pulp is left out. */
static void settle(struct gsn_body *b, struct work *w, struct gsn_tissue_levels *levels)
{
    size_t n = 0;
    double denser;

    for (size_t i = 0; i < b->count; i++)
        if (b->set[i] && b->value[i] > levels->border)
            w->scratch[n++] = b->value[i];
    if (n == 0)
        return;
    levels->dentine = gsn_order_pick(w->scratch, n, n / 2);
    levels->border =
        (levels->dentine + look_around(b, levels->dentine, w->keep, w->scratch, &denser)) / 2;
}

static int find_root(struct gsn_body *b, struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) keep = gsn_alloc_array(b->count, 1);
    gsn_auto_mem(uint8_t) core = gsn_alloc_array(b->count, 1);
    gsn_auto_mem(double) scratch = gsn_alloc_array(b->count, sizeof *scratch);
    gsn_auto_mem(uint32_t) next = gsn_alloc_array(b->count, sizeof *next);
    struct work w = { keep, scratch, next };
    struct candidate found[CANDIDATES];
    int r;

    if (!keep || !core || !scratch || !next)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
    r = list_candidates(b, levels->bone, found, err);
    if (r < 0)
        return r;
    if (!find_core(b, found, &w, levels)) {
        memset(b->set, 0, b->count);
        return GSN_OK;
    }
    /* The whole root says better than its core how dense dentine is, and which density lies midway
     * to the ligament. */
    memcpy(core, b->set, b->count);
    for (int pass = 0; pass < PASSES; pass++) {
        memcpy(b->set, core, b->count);
        spread(b, levels, &w);
        settle(b, &w, levels);
    }
    return GSN_OK;
}

/* The median of what lies above Otsu's level is bone. */
static int find_bone(const struct gsn_body *b, double *ret_bone, struct gsn_error *err)
{
    gsn_auto_mem(float) list = gsn_alloc_array(b->count, sizeof *list);
    gsn_auto_mem(double) scratch = gsn_alloc_array(b->count, sizeof *scratch);
    size_t n = 0, count = 0;
    double least;

    if (!list || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
    for (size_t i = 0; i < b->count; i++)
        if (b->value[i] > GSN_BODY_GLASS)
            list[n++] = b->value[i];
    least = gsn_otsu(list, n);
    for (size_t i = 0; i < n; i++)
        if ((double)list[i] > least)
            scratch[count++] = (double)list[i];
    *ret_bone = count > 0 ? gsn_order_pick(scratch, count, count / 2) : 0;
    return GSN_OK;
}

static int make_root(struct gsn_body *b, struct gsn_mask **ret_root,
                     struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    gsn_auto(gsn_mask) root = NULL;
    int r = find_bone(b, &levels->bone, err);

    if (r >= 0 && levels->bone > 0)
        r = find_root(b, levels, err);
    if (r >= 0)
        r = gsn_mask_new(&b->at, &root, err);
    if (r < 0)
        return r;
    memcpy(root->inside, b->set, b->count);
    levels->volume_um3 = (double)gsn_mask_count(root) * gsn_lattice_voxel_um3(&b->at);
    if (!(levels->volume_um3 >= LEAST_ROOT_UM3))
        return gsn_fail(err, GSN_E_STAIN,
                        "no root was found in this block: nothing solid lies between a ligament "
                        "and the density of bone; state the region as a mask or a shape");
    *ret_root = gsn_steal(&root);
    return GSN_OK;
}

int gsn_tissue_root(const struct gsn_grid *density, struct gsn_mask **ret_root,
                    struct gsn_tissue_levels *ret_levels, struct gsn_error *err)
{
    struct gsn_tissue_levels levels = { 0 };
    struct gsn_body b;
    int r = gsn_body_init(density, &b, err);

    if (r >= 0)
        r = make_root(&b, ret_root, &levels, err);
    gsn_body_done(&b);
    if (r >= 0)
        *ret_levels = levels;
    return r;
}
