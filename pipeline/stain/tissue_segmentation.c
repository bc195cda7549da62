/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Tissue segmentation in a stacked block: tissue, bone, and the root of a tooth, by how the density
 * lies and not by a level stated for it.
 *
 *   1. The block is made coarse (about 32 um), its planes are brought to one strength by what
 *      neighbours share, gaps along z are interpolated, and it is smoothed.
 *   2. Bone is the median of what lies above Otsu's level.
 *   3. Take all that is denser than some level. When the level falls, components grow and join: a
 *      component tree (max-tree; Salembier, Oliveras and Garrido 1998, 10.1109/83.663500). The root
 *      stands alone from where its dentine comes up to where the level reaches the ligament, which
 *      all around is the lower pass to the bone. Bone that a lesion has thinned may have the
 * density of dentine, but it passes into the bone beside it and never stands alone. Of the
 * components too pale for bone, the largest that lies in something paler is the core of the root.
 *   4. From there on it is a watershed (Meyer 1994): core and bone grow downhill, each its own way,
 *      and meet in the ligament. Level and root are found anew three times.
 *
 * Fails where no component is large enough; the sentence says what to state instead. Linear in the
 * voxels but for the union-find of step 3; about 20 bytes a coarse voxel. */
#include "pipeline/stain/tissue_segmentation.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/imaging/morphology.h"
#include "pipeline/imaging/threshold.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

/* Density below which there is glass. */
#define GLASS 0.08

struct body {
    struct gsn_lattice at; /* about 32 um across */
    size_t count;
    float *value;   /* density, even from plane to plane, smoothed; 0 where there is no data */
    float *least;   /* the least value of a voxel and those beside, above and below it */
    uint8_t *set;   /* the work in hand: 0 and 1 between calls */
    uint32_t *list; /* room for every voxel */
};

/* ---- the coarse block -------------------------------------------------------------------- */

/* Voxels in the plane: half of the thinnest layer looked for, a ligament of 100 um and more, needs
 * one and a half of them. */
static const double VOXEL_UM = 32;

/* Planes further apart are not bridged: the root moves by half a ligament's width in as much. */
static const double LONGEST_GAP_UM = 240;

/* Fewer voxels that two planes share do not say how their stain compares. */
enum { LEAST_SHARED = 200 };

static void free_body(struct body *b)
{
    gsn_free(b->value);
    gsn_free(b->least);
    gsn_free(b->set);
    gsn_free(b->list);
}

static size_t reduction_of(double step_um)
{
    return (size_t)fmax(1, round(VOXEL_UM / step_um));
}

static int alloc_body(const struct gsn_lattice *at, struct body *b, struct gsn_error *err)
{
    const size_t fx = reduction_of(at->step_um.x), fy = reduction_of(at->step_um.y);

    *b = (struct body){ .at = *at };
    b->at.nx = (at->nx + fx - 1) / fx;
    b->at.ny = (at->ny + fy - 1) / fy;
    b->at.step_um.x = at->step_um.x * (double)fx;
    b->at.step_um.y = at->step_um.y * (double)fy;
    b->at.origin_um.x += at->step_um.x * (double)(fx - 1) / 2;
    b->at.origin_um.y += at->step_um.y * (double)(fy - 1) / 2;
    b->count = gsn_lattice_count(&b->at);
    b->value = gsn_alloc_array(b->count, sizeof *b->value);
    b->least = gsn_alloc_array(b->count, sizeof *b->least);
    b->set = gsn_alloc_array(b->count, 1);
    b->list = gsn_alloc_array(b->count, sizeof *b->list);
    if (b->value && b->least && b->set && b->list)
        return GSN_OK;
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissues of a block");
}

/* Means of the finer voxels, NaN where there are none. */
static void reduce_planes(const struct gsn_grid *density, struct body *b)
{
    const struct gsn_lattice *at = &density->at;
    const size_t fx = reduction_of(at->step_um.x), fy = reduction_of(at->step_um.y);
    float *weight = b->least;
    size_t i = 0;

    memset(weight, 0, b->count * sizeof *weight);
    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++)
                if (!isnan(density->value[i])) {
                    const size_t into = gsn_lattice_index(&b->at, x / fx, y / fy, z);

                    b->value[into] += density->value[i];
                    weight[into]++;
                }
    for (i = 0; i < b->count; i++)
        b->value[i] = weight[i] > 0 ? b->value[i] / weight[i] : NAN;
}

/* ---- even planes ------------------------------------------------------------------------- */

/* Log of how much more stain a plane took than an earlier one: the median over the tissue that both
 * show, which a lesion or a pulp that begins between them does not move. 0 where too little is
 * shared. */
static double step_of_stain(const struct body *b, size_t earlier, size_t later, double *ratio)
{
    const size_t plane = b->at.nx * b->at.ny;
    const float *one = b->value + earlier * plane, *two = b->value + later * plane;
    size_t n = 0;

    for (size_t i = 0; i < plane; i++)
        if (one[i] > 2 * GLASS && two[i] > 2 * GLASS)
            ratio[n++] = log((double)(two[i] / one[i]));
    return n < LEAST_SHARED ? 0 : gsn_order_pick(ratio, n, n / 2);
}

static int has_data(const struct body *b, size_t z)
{
    const size_t plane = b->at.nx * b->at.ny;
    size_t n = 0;

    for (size_t i = z * plane; i < (z + 1) * plane && n < LEAST_SHARED; i++)
        n += b->value[i] > GLASS;
    return n >= LEAST_SHARED;
}

/* Panels are stained unequally, and one level must tell tissues apart in all of them. What the
 * tissue itself changes from one plane to the next is small beside that. */
static int even_planes(struct body *b, struct gsn_error *err)
{
    const size_t plane = b->at.nx * b->at.ny;
    gsn_auto_mem(double) ratio = gsn_alloc_array(plane + b->at.nz, sizeof *ratio);
    gsn_auto_mem(double) strength = gsn_alloc_array(b->at.nz, sizeof *strength);
    size_t before = SIZE_MAX, n = 0;
    double middle;

    if (!ratio || !strength)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissues of a block");
    for (size_t z = 0; z < b->at.nz; z++) {
        if (!has_data(b, z)) {
            strength[z] = NAN;
            continue;
        }
        strength[z] =
            before == SIZE_MAX ? 0 : strength[before] + step_of_stain(b, before, z, ratio);
        before = z;
    }
    for (size_t z = 0; z < b->at.nz; z++)
        if (!isnan(strength[z]))
            ratio[n++] = strength[z];
    middle = n > 0 ? gsn_order_pick(ratio, n, n / 2) : 0;
    for (size_t z = 0; z < b->at.nz; z++)
        for (size_t i = z * plane; !isnan(strength[z]) && i < (z + 1) * plane; i++)
            b->value[i] *= (float)exp(middle - strength[z]);
    return GSN_OK;
}

/* Straight lines along z across what is missing. */
static void interpolate_gaps(struct body *b)
{
    const size_t plane = b->at.nx * b->at.ny;
    const size_t longest = (size_t)(LONGEST_GAP_UM / b->at.step_um.z);

    for (size_t i = 0; i < plane; i++) {
        size_t before = SIZE_MAX;

        for (size_t z = 0; z < b->at.nz; z++) {
            const float here = b->value[z * plane + i];

            if (isnan(here))
                continue;
            for (size_t k = before + 1; before != SIZE_MAX && z - before <= longest && k < z; k++) {
                const float t = (float)(k - before) / (float)(z - before);

                b->value[k * plane + i] = (1 - t) * b->value[before * plane + i] + t * here;
            }
            before = z;
        }
    }
}

/* ---- smoothing, where no data counts as nothing ------------------------------------------ */

/* Sums over three neighbours along one axis. */
static void sum_of_three(float *value, size_t n, size_t stride)
{
    float before = 0;

    for (size_t i = 0; i < n; i++) {
        const float here = value[i * stride];

        value[i * stride] = before + here + (i + 1 < n ? value[(i + 1) * stride] : 0);
        before = here;
    }
}

static void sum_all_axes(const struct gsn_lattice *at, float *value)
{
    for (size_t i = 0; i < at->ny * at->nz; i++)
        sum_of_three(value + i * at->nx, at->nx, 1);
    for (size_t z = 0; z < at->nz; z++)
        for (size_t x = 0; x < at->nx; x++)
            sum_of_three(value + z * at->nx * at->ny + x, at->ny, at->nx);
    for (size_t i = 0; i < at->nx * at->ny; i++)
        sum_of_three(value + i, at->nz, at->nx * at->ny);
}

static void smooth_block(struct body *b)
{
    float *weight = b->least;

    for (size_t i = 0; i < b->count; i++) {
        const int known = !isnan(b->value[i]);

        weight[i] = (float)known;
        b->value[i] = known ? b->value[i] : 0;
    }
    sum_all_axes(&b->at, b->value);
    sum_all_axes(&b->at, weight);
    for (size_t i = 0; i < b->count; i++)
        b->value[i] = weight[i] > 0 ? b->value[i] / weight[i] : 0;
}

/* The up to six neighbours of a voxel; returns how many. */
static int list_neighbours(const struct body *b, size_t at, uint32_t ret_beside[6])
{
    const size_t nx = b->at.nx, plane = nx * b->at.ny;
    const size_t x = at % nx, y = at / nx % b->at.ny, z = at / plane;
    int n = 0;

    if (x > 0)
        ret_beside[n++] = (uint32_t)(at - 1);
    if (x + 1 < nx)
        ret_beside[n++] = (uint32_t)(at + 1);
    if (y > 0)
        ret_beside[n++] = (uint32_t)(at - nx);
    if (y + 1 < b->at.ny)
        ret_beside[n++] = (uint32_t)(at + nx);
    if (z > 0)
        ret_beside[n++] = (uint32_t)(at - plane);
    if (z + 1 < b->at.nz)
        ret_beside[n++] = (uint32_t)(at + plane);
    return n;
}

static void find_least(struct body *b)
{
    for (size_t i = 0; i < b->count; i++) {
        uint32_t beside[6];
        const int n = list_neighbours(b, i, beside);

        b->least[i] = b->value[i];
        for (int k = 0; k < n; k++)
            b->least[i] = fminf(b->least[i], b->value[beside[k]]);
    }
}

/* Fails with GSN_E_NOMEM; gsn_body_done() is to be called in any case. */
static int coarsen_block(const struct gsn_grid *density, struct body *b, struct gsn_error *err)
{
    int r = alloc_body(&density->at, b, err);

    if (r < 0)
        return r;
    reduce_planes(density, b);
    r = even_planes(b, err);
    if (r < 0)
        return r;
    interpolate_gaps(b);
    smooth_block(b);
    find_least(b);
    return GSN_OK;
}

/* ---- sets of voxels ---------------------------------------------------------------------- */

/* The piece of the voxels whose set is 1 that holds start: they become 2 and are listed from
 * list[0] on. Returns how many. */
static size_t flood_component(struct body *b, size_t start)
{
    size_t n = 0;

    if (b->set[start] != 1)
        return 0;
    b->set[start] = 2;
    b->list[n++] = (uint32_t)start;
    for (size_t done = 0; done < n; done++) {
        uint32_t beside[6];
        const int around = list_neighbours(b, b->list[done], beside);

        for (int k = 0; k < around; k++)
            if (b->set[beside[k]] == 1) {
                b->set[beside[k]] = 2;
                b->list[n++] = beside[k];
            }
    }
    return n;
}

/* Leaves the largest piece. */
static void keep_largest(struct body *b)
{
    size_t most = 0, best = 0, n;

    for (size_t i = 0; i < b->count; i++)
        if ((n = flood_component(b, i)) > most) {
            most = n;
            best = i;
        }
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] != 0;
    n = most > 0 ? flood_component(b, best) : 0;
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] == 2;
}

/* Voxels that have one of the other kind beside them change to it. */
static void shift_border(struct body *b, uint8_t to)
{
    size_t n = 0;

    for (size_t i = 0; i < b->count; i++) {
        uint32_t beside[6];
        const int around = b->set[i] != to ? list_neighbours(b, i, beside) : 0;

        for (int k = 0; k < around; k++)
            if (b->set[beside[k]] == to) {
                b->list[n++] = (uint32_t)i;
                break;
            }
    }
    for (size_t k = 0; k < n; k++)
        b->set[b->list[k]] = to;
}

/* Takes away what is thinner than three voxels and leaves the largest piece. */
static void tidy_set(struct body *b)
{
    shift_border(b, 0);
    keep_largest(b);
    shift_border(b, 1);
}

/* What is enclosed within one section becomes 1: the pulp opens at the end of the block. */
static int fill_sections(struct body *b, struct gsn_error *err)
{
    const size_t plane = b->at.nx * b->at.ny;
    int r = GSN_OK;

    for (size_t z = 0; z < b->at.nz && r >= 0; z++)
        r = gsn_fill_holes(b->set + z * plane, (uint32_t)b->at.nx, (uint32_t)b->at.ny, 4, err);
    return r;
}

/* ---- the component tree ------------------------------------------------------------------ */

enum { COMPONENTS = 192 };

/* A body that stands alone among what is denser than a level. */
struct component {
    double above;
    size_t voxels;
    uint32_t voxel; /* one of them */
};

/* Smaller is no core of a root: a ball of 200 um. */
static const double LEAST_CORE_UM3 = 5e6;

enum { LEVELS = 48, PER_LEVEL = COMPONENTS / LEVELS };

/* The bodies while the level falls; of one body all voxels lead to the same one by `up`. */
struct tree {
    uint32_t *up, *voxels;
    double *sum;
};

static uint32_t representative_of(uint32_t *up, uint32_t i)
{
    while (up[i] != i) {
        up[i] = up[up[i]];
        i = up[i];
    }
    return i;
}

static void join_components(struct tree *t, uint32_t a, uint32_t b)
{
    a = representative_of(t->up, a);
    b = representative_of(t->up, b);
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

static int level_of(const struct body *b, size_t i, double bone)
{
    const double share = b->least[i] / bone;
    const double at = (GSN_MOST_OF_BONE - share) / (GSN_MOST_OF_BONE - GSN_LEAST_OF_BONE) * LEVELS;

    return at < 0 ? 0 : at >= LEVELS ? LEVELS : (int)at;
}

/* Adds the voxels of one level, listed in list[from, to), to the bodies. */
static void lower_level(const struct body *b, struct tree *t, size_t from, size_t to)
{
    for (size_t k = from; k < to; k++) {
        const uint32_t i = b->list[k];
        uint32_t beside[6];
        const int n = list_neighbours(b, i, beside);

        t->up[i] = i;
        t->voxels[i] = 1;
        t->sum[i] = (double)b->value[i];
        for (int s = 0; s < n; s++)
            if (t->up[beside[s]] != UINT32_MAX)
                join_components(t, i, beside[s]);
    }
}

static int larger_first(const void *a, const void *b)
{
    const struct component *p = a, *q = b;

    if (p->voxels != q->voxels)
        return p->voxels < q->voxels ? 1 : -1;
    return (p->voxel > q->voxel) - (p->voxel < q->voxel);
}

/* Adds a candidate to the largest of one level. */
static void note_candidate(struct component *best, const struct component *one)
{
    struct component *least = &best[0];

    for (int k = 1; k < PER_LEVEL; k++)
        least = best[k].voxels < least->voxels ? &best[k] : least;
    if (one->voxels > least->voxels)
        *least = *one;
}

/* The bodies of a level that are too pale for bone and large enough. */
static void list_candidates(const struct body *b, const struct tree *t, size_t to, double above,
                            double bone, struct component *best)
{
    const double voxel = gsn_lattice_voxel_um3(&b->at);

    for (size_t k = 0; k < to; k++) {
        const uint32_t i = b->list[k];

        if (t->up[i] == i && t->voxels[i] * voxel >= LEAST_CORE_UM3 &&
            t->sum[i] < GSN_MOST_OF_BONE * bone * t->voxels[i])
            note_candidate(
                best, &(struct component){ .above = above, .voxels = t->voxels[i], .voxel = i });
    }
}

/* Sorts the voxels by level into list; begins[k] is where level k begins. */
static void sort_voxels(struct body *b, double bone, size_t begins[LEVELS + 2])
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

/* Bodies paler than bone that stand alone at some level, the largest first; those without voxels
 * are none. Uses the list. Fails with GSN_E_NOMEM. */
static int list_components(struct body *b, double bone, struct component ret_found[COMPONENTS],
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
    memset(ret_found, 0, COMPONENTS * sizeof *ret_found);
    sort_voxels(b, bone, begins);
    for (size_t k = 0; k < LEVELS; k++) {
        const double share =
            GSN_MOST_OF_BONE - (GSN_MOST_OF_BONE - GSN_LEAST_OF_BONE) * (double)(k + 1) / LEVELS;

        lower_level(b, &t, begins[k], begins[k + 1]);
        list_candidates(b, &t, begins[k + 1], share * bone, bone, &ret_found[k * PER_LEVEL]);
    }
    qsort(ret_found, COMPONENTS, sizeof *ret_found, larger_first);
    return GSN_OK;
}

/* ---- the core of the root ---------------------------------------------------------------- */

/* What lies around a root is tissue: it has this share of the red of bone. */
static const double LEAST_AROUND = 0.15;

/* And no more than this share of it is as dense as the root itself. */
static const double MOST_DENSER = 0.2;

/* A ligament begins behind the blur of the border and is about 100 um wide at least, in voxels. */
enum { BLURRED = 1, AROUND = 3 };

enum { BUCKETS = 2048, PASSES = 3 };

/* The voxels whose set is 1 grow by some layers; returns how many the list then holds in all, of
 * which the first *ret_inner were reached within `inner` layers. */
static size_t grow_set(struct body *b, int inner, int layers, size_t *ret_inner)
{
    size_t n = 0, from = 0;

    for (size_t i = 0; i < b->count; i++)
        if (b->set[i])
            b->list[n++] = (uint32_t)i;
    for (int layer = 1; layer <= layers; layer++) {
        const size_t to = n;

        for (size_t k = from; k < to; k++) {
            uint32_t beside[6];
            const int around = list_neighbours(b, b->list[k], beside);

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
static double look_around(struct body *b, double dentine, uint8_t *keep, double *scratch,
                          double *ret_denser)
{
    size_t inner = 0, n, denser = 0, count = 0;

    memcpy(keep, b->set, b->count);
    n = grow_set(b, BLURRED, BLURRED + AROUND, &inner);
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
static double show_candidate(struct body *b, const struct component *c, double *scratch)
{
    size_t n;

    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->least[i] > c->above;
    n = flood_component(b, c->voxel);
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] == 2;
    for (size_t k = 0; k < n; k++)
        scratch[k] = b->value[b->list[k]];
    return n > 0 ? gsn_order_pick(scratch, n, n / 2) : 0;
}

/* The core of the root as the set, and the level between it and what lies around it; an empty set
 * where there is none. */
static int find_core(struct body *b, const struct component *found, struct work *w,
                     struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    for (int k = 0; k < COMPONENTS && found[k].voxels > 0; k++) {
        const double dentine = show_candidate(b, &found[k], w->scratch);
        double around, denser;
        size_t grown;
        int r;

        if (!(dentine < GSN_MOST_OF_BONE * levels->bone))
            continue;
        (void)grow_set(b, 0, 1, &grown); /* back to where the level was */
        r = fill_sections(b, err);
        if (r < 0)
            return r;
        around = look_around(b, dentine, w->keep, w->scratch, &denser);
        if (around < LEAST_AROUND * levels->bone || denser > MOST_DENSER)
            continue;
        levels->dentine = dentine;
        levels->border = (dentine + around) / 2;
        (void)show_candidate(b, &found[k], w->scratch);
        return GSN_OK;
    }
    memset(b->set, 0, b->count);
    levels->dentine = 0;
    return GSN_OK;
}

/* ---- the watershed ----------------------------------------------------------------------- */

enum { NOBODY, ROOT, OTHER };

struct flood {
    const struct body *b;
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
    const int n = list_neighbours(f->b, i, beside);

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
static int flood_root(struct body *b, const struct gsn_tissue_levels *levels, struct work *w,
                      struct gsn_error *err)
{
    struct flood f = { .b = b, .whose = w->keep, .next = w->next, .most = levels->bone };
    const double bone = fmax(levels->border, GSN_MOST_OF_BONE * levels->bone);
    int r;

    for (size_t i = 0; i < b->count; i++)
        f.whose[i] = b->set[i] ? ROOT : b->least[i] > bone || b->value[i] < GLASS ? OTHER : NOBODY;
    run_flood(&f);
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = f.whose[i] == ROOT && (double)b->value[i] > levels->border;
    r = fill_sections(b, err);
    if (r < 0)
        return r;
    tidy_set(b);
    return fill_sections(b, err);
}

/* The levels anew, from the root that the set is; its pulp is left out. */
static void update_levels(struct body *b, struct work *w, struct gsn_tissue_levels *levels)
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

static int find_root(struct body *b, struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) keep = gsn_alloc_array(b->count, 1);
    gsn_auto_mem(uint8_t) core = gsn_alloc_array(b->count, 1);
    gsn_auto_mem(double) scratch = gsn_alloc_array(b->count, sizeof *scratch);
    gsn_auto_mem(uint32_t) next = gsn_alloc_array(b->count, sizeof *next);
    struct work w = { keep, scratch, next };
    struct component found[COMPONENTS];
    int r;

    if (!keep || !core || !scratch || !next)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
    r = list_components(b, levels->bone, found, err);
    if (r < 0)
        return r;
    r = find_core(b, found, &w, levels, err);
    if (r < 0 || !(levels->dentine > 0))
        return r;
    /* The whole root says better than its core how dense dentine is, and which density lies midway
     * to the ligament. */
    memcpy(core, b->set, b->count);
    for (int pass = 0; pass < PASSES; pass++) {
        memcpy(b->set, core, b->count);
        r = flood_root(b, levels, &w, err);
        if (r < 0)
            return r;
        update_levels(b, &w, levels);
    }
    return GSN_OK;
}

/* ---- the tissues ------------------------------------------------------------------------- */

/* A body of less is a splinter: a ball of 300 um. */
static const double LEAST_UM3 = 1.4e7;

/* What is not there, and what that may mean. */
static const char *const MISSING[] = {
    [GSN_TISSUE_ROOT] = "no root was found in this block: nothing solid, paler than bone, stands "
                        "alone within a ligament",
    [GSN_TISSUE_BONE] = "no bone was found in this block: nothing solid stands out by its density",
    [GSN_TISSUE_ALL] = "no tissue was found in this block",
};

const char *gsn_tissue_name(enum gsn_tissue_kind tissue)
{
    static const char *const name[] = { "root", "bone", "tissue" };

    return name[tissue];
}

/* Bone is the median of what lies above Otsu's level. */
static int find_levels(const struct body *b, struct gsn_tissue_levels *levels,
                       struct gsn_error *err)
{
    gsn_auto_mem(float) list = gsn_alloc_array(b->count, sizeof *list);
    gsn_auto_mem(double) scratch = gsn_alloc_array(b->count, sizeof *scratch);
    size_t n = 0, count = 0;

    if (!list || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissues of a block");
    for (size_t i = 0; i < b->count; i++)
        if (b->value[i] > (float)GLASS)
            list[n++] = b->value[i];
    levels->border = gsn_otsu(list, n);
    for (size_t i = 0; i < n; i++)
        if ((double)list[i] > levels->border)
            scratch[count++] = (double)list[i];
    levels->bone = count > 0 ? gsn_order_pick(scratch, count, count / 2) : 0;
    return GSN_OK;
}

/* The set, the root or nothing, becomes the bone: what is denser than midway between the ligament
 * and the bone, where there is a ligament. */
static void take_bone(struct body *b, struct gsn_tissue_levels *levels)
{
    if (levels->dentine > 0)
        levels->border = (2 * levels->border - levels->dentine + levels->bone) / 2;
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = !b->set[i] && (double)b->value[i] > levels->border;
    tidy_set(b);
}

/* The outline: voids within a section belong to it. */
static int take_all(struct body *b, struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    levels->border = GLASS;
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = (double)b->value[i] > levels->border;
    tidy_set(b);
    return fill_sections(b, err);
}

static int find_set(struct body *b, enum gsn_tissue_kind tissue, struct gsn_tissue_levels *levels,
                    struct gsn_error *err)
{
    int r = find_levels(b, levels, err);

    if (r >= 0 && tissue != GSN_TISSUE_ALL && levels->bone > 0)
        r = find_root(b, levels, err);
    if (r >= 0 && tissue == GSN_TISSUE_BONE)
        take_bone(b, levels);
    if (r >= 0 && tissue == GSN_TISSUE_ALL)
        r = take_all(b, levels, err);
    return r;
}

static int make_body(struct body *b, enum gsn_tissue_kind tissue, struct gsn_mask **ret_body,
                     struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    gsn_auto(gsn_mask) body = NULL;
    int r = find_set(b, tissue, levels, err);

    if (r >= 0)
        r = gsn_mask_new(&b->at, &body, err);
    if (r < 0)
        return r;
    memcpy(body->inside, b->set, b->count);
    levels->volume_um3 = (double)gsn_mask_count(body) * gsn_lattice_voxel_um3(&b->at);
    if (!(levels->volume_um3 >= LEAST_UM3))
        return gsn_fail(err, GSN_E_STAIN, "%s; state the region as a mask or a shape",
                        MISSING[tissue]);
    *ret_body = gsn_steal(&body);
    return GSN_OK;
}

int gsn_tissue_find(const struct gsn_grid *density, enum gsn_tissue_kind tissue,
                    struct gsn_mask **ret_body, struct gsn_tissue_levels *ret_levels,
                    struct gsn_error *err)
{
    struct gsn_tissue_levels levels = { 0 };
    struct body b;
    int r = coarsen_block(density, &b, err);

    if (r >= 0)
        r = make_body(&b, tissue, ret_body, &levels, err);
    free_body(&b);
    if (r >= 0)
        *ret_levels = levels;
    return r;
}
