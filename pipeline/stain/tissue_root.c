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

#include "pipeline/core/robust.h"
#include "pipeline/stain/tissue_body.h"

#include <math.h>
#include <string.h>

/* What lies around a root is tissue: it has this share of the red of bone. */
static const double LEAST_AROUND = 0.15;
/* And no more than this share of it is as dense as the root itself. */
static const double MOST_DENSER = 0.2;
/* A ligament begins behind the blur of the border and is about 100 um wide at least, in voxels. */
enum { BLURRED = 1, AROUND = 3 };
enum { BUCKETS = 2048, PASSES = 3 };

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
static double show(struct gsn_body *b, const struct gsn_body_alone *c, double *scratch)
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
static int find_core(struct gsn_body *b, const struct gsn_body_alone *found, struct work *w,
                     struct gsn_tissue_levels *levels)
{
    for (int k = 0; k < GSN_BODY_ALONE && found[k].voxels > 0; k++) {
        const double dentine = show(b, &found[k], w->scratch);
        double around, denser;
        size_t grown;

        if (!(dentine < GSN_BODY_MOST_OF_BONE * levels->bone))
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
    const double bone = fmax(levels->border, GSN_BODY_MOST_OF_BONE * levels->bone);

    for (size_t i = 0; i < b->count; i++)
        f.whose[i] = b->set[i]                                            ? ROOT
                     : b->least[i] > bone || b->value[i] < GSN_BODY_GLASS ? OTHER
                                                                          : NOBODY;
    run_flood(&f);
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] || (f.whose[i] == ROOT && b->value[i] > levels->border);
    gsn_body_fill_sections(b);
    gsn_body_tidy(b);
    gsn_body_fill_sections(b);
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

int gsn_body_find_root(struct gsn_body *b, struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) keep = gsn_alloc_array(b->count, 1);
    gsn_auto_mem(uint8_t) core = gsn_alloc_array(b->count, 1);
    gsn_auto_mem(double) scratch = gsn_alloc_array(b->count, sizeof *scratch);
    gsn_auto_mem(uint32_t) next = gsn_alloc_array(b->count, sizeof *next);
    struct work w = { keep, scratch, next };
    struct gsn_body_alone found[GSN_BODY_ALONE];
    int r;

    if (!keep || !core || !scratch || !next)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
    r = gsn_body_list_alone(b, levels->bone, found, err);
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
