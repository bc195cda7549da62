/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The morphometry of bone in voxels.
 *
 * 1. Voxels above the threshold are bone; those of them in the region are counted (BV), as are the
 *    region's voxels with data (TV).
 * 2. Surface: the level between the centres of eight voxels, cut in six tetrahedra, in each of
 *    which the field is linear (marching tetrahedra; Doi and Koide 1991). Cells whose middle lies
 *    in the region count.
 * 3. Thickness: the distance to the nearest voxel that is no bone (core/distance.h) tells the
 *    widest sphere about a voxel. From the widest on, spheres that the one which holds their middle
 *    holds as well are dropped (the distance ridge), and of those that stay the radius is the
 *    distance to the nearest point where the field passes the threshold between two voxels, from
 *    the centre or half a voxel beside it. Each voxel takes the widest of the spheres that hold it
 *    (Hildebrand and Rueegsegger, J Microsc 185, 1997). The middle of a plate lies up to a quarter
 *    of a voxel beside the nearest of these points, so that twice the radius is too little by a
 *    quarter of a voxel on average, which is added.
 * 4. Pieces: a flood over 26 neighbours.
 * 5. Euler number: corners - edges + faces - voxels of the union of closed voxels, which joins
 *    voxels by corners as the flood does (Odgaard and Gundersen, Bone 14, 1993).
 *
 * Failure: a region without data. Cost: a distance transform, and for each sphere of the ridge its
 * voxels. */
#include "pipeline/measure/bone.h"

#include "pipeline/core/distance.h"
#include "pipeline/core/parallel.h"

#include <math.h>
#include <stdlib.h>

struct work {
    const struct gsn_grid *grid;
    const struct gsn_mask *region;
    double threshold;
    uint8_t *bone;    /* above the threshold */
    uint8_t *counted; /* 1: of those in the region */
    float *squared;   /* distance to what is no bone */
    double *area;     /* of each layer of cells */
    uint32_t *held;   /* 1 more than the number of the widest sphere that holds a voxel; 0: none */
    size_t *ridge;    /* voxels that spheres are about, widest first */
    float *radius;    /* of their spheres */
    struct gsn_vec3 *crossing; /* points of the surface, row of voxels by row */
    size_t *row;               /* where each row's begin, and the end */
    size_t ridge_count;
};

static void work_done(struct work *w)
{
    gsn_free(w->bone);
    gsn_free(w->counted);
    gsn_free(w->squared);
    gsn_free(w->area);
    gsn_free(w->held);
    gsn_free(w->ridge);
    gsn_free(w->radius);
    gsn_free(w->crossing);
    gsn_free(w->row);
}

static int work_init(struct work *w, struct gsn_error *err)
{
    const size_t voxels = gsn_lattice_count(&w->grid->at);

    w->bone = gsn_alloc_array(voxels, 1);
    w->counted = gsn_alloc_array(voxels, 1);
    w->squared = gsn_alloc_array(voxels, sizeof *w->squared);
    w->area = gsn_alloc_array(w->grid->at.nz, sizeof *w->area);
    w->held = gsn_alloc_array(voxels, sizeof *w->held);
    w->ridge = gsn_alloc_array(voxels, sizeof *w->ridge);
    w->radius = gsn_alloc_array(voxels, sizeof *w->radius);
    w->row = gsn_alloc_array(w->grid->at.ny * w->grid->at.nz + 1, sizeof *w->row);
    if (!w->bone || !w->counted || !w->squared || !w->area || !w->held || !w->ridge || !w->radius ||
        !w->row)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the morphometry of bone");
    return GSN_OK;
}

/* ---- volume -------------------------------------------------------------------------------- */

static int count_voxels(struct work *w, struct gsn_bone *bone, struct gsn_error *err)
{
    const struct gsn_lattice *const at = &w->grid->at;
    size_t tissue = 0, counted = 0, i = 0;

    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const double value = (double)w->grid->value[i];
                const int inside =
                    !isnan(value) && gsn_mask_has(w->region, gsn_lattice_centre(at, x, y, z));

                w->bone[i] = value > w->threshold;
                w->counted[i] = inside && w->bone[i];
                tissue += (size_t)inside;
                counted += w->counted[i];
            }
    if (tissue == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region has no data to measure bone in");
    bone->tissue_um3 = (double)tissue * gsn_lattice_voxel_um3(at);
    bone->bone_um3 = (double)counted * gsn_lattice_voxel_um3(at);
    return GSN_OK;
}

/* ---- surface ------------------------------------------------------------------------------- */

struct corner {
    struct gsn_vec3 at;
    double off; /* of the field from the threshold */
};

static struct gsn_vec3 go_between(struct gsn_vec3 a, struct gsn_vec3 b, double share)
{
    return gsn_vec3_make(a.x + share * (b.x - a.x), a.y + share * (b.y - a.y),
                         a.z + share * (b.z - a.z));
}

static struct gsn_vec3 cross_between(const struct corner *a, const struct corner *b)
{
    return go_between(a->at, b->at, a->off / (a->off - b->off));
}

static double area_of(struct gsn_vec3 a, struct gsn_vec3 b, struct gsn_vec3 c)
{
    return 0.5 * gsn_vec3_length(gsn_vec3_cross(gsn_vec3_sub(b, a), gsn_vec3_sub(c, a)));
}

/* Of the level in a tetrahedron. */
static double cut_tetrahedron(const struct corner *const corner[4])
{
    const struct corner *above[4], *below[4];
    size_t up = 0, down = 0;

    for (int i = 0; i < 4; i++) {
        if (corner[i]->off > 0)
            above[up++] = corner[i];
        else
            below[down++] = corner[i];
    }
    if (up == 0 || down == 0)
        return 0;
    if (up == 1)
        return area_of(cross_between(above[0], below[0]), cross_between(above[0], below[1]),
                       cross_between(above[0], below[2]));
    if (down == 1)
        return area_of(cross_between(above[0], below[0]), cross_between(above[1], below[0]),
                       cross_between(above[2], below[0]));
    {
        const struct gsn_vec3 a = cross_between(above[0], below[0]);
        const struct gsn_vec3 b = cross_between(above[0], below[1]);
        const struct gsn_vec3 c = cross_between(above[1], below[1]);
        const struct gsn_vec3 d = cross_between(above[1], below[0]);

        return area_of(a, b, c) + area_of(a, c, d);
    }
}

/* The cell between the centres of eight voxels; corner i lies at bit 0 along x, 1 along y, 2 z. */
static double cut_cell(const struct work *w, size_t x, size_t y, size_t z)
{
    /* Kuhn's six, each a way from corner 0 to corner 7 along the axes in turn. */
    static const unsigned way[6][2] = {
        { 1, 3 }, { 1, 5 }, { 2, 3 }, { 2, 6 }, { 4, 5 }, { 4, 6 }
    };
    const struct gsn_lattice *const at = &w->grid->at;
    struct corner corner[8];
    double area = 0;
    int above = 0;

    for (unsigned i = 0; i < 8; i++) {
        const size_t u = x + (i & 1), v = y + (i >> 1 & 1), n = z + (i >> 2);
        const double value = (double)w->grid->value[gsn_lattice_index(at, u, v, n)];

        if (isnan(value))
            return 0;
        corner[i] = (struct corner){ gsn_lattice_centre(at, u, v, n), value - w->threshold };
        above += corner[i].off > 0;
    }
    if (above == 0 || above == 8 ||
        !gsn_mask_has(w->region, go_between(corner[0].at, corner[7].at, 0.5)))
        return 0;
    for (int i = 0; i < 6; i++) {
        const struct corner *const four[4] = { &corner[0], &corner[way[i][0]], &corner[way[i][1]],
                                               &corner[7] };

        area += cut_tetrahedron(four);
    }
    return area;
}

static int cut_layer(size_t z, void *context, struct gsn_error *err)
{
    struct work *const w = context;
    const struct gsn_lattice *const at = &w->grid->at;

    (void)err;
    for (size_t y = 0; y + 1 < at->ny; y++)
        for (size_t x = 0; x + 1 < at->nx; x++)
            w->area[z] += cut_cell(w, x, y, z);
    return GSN_OK;
}

static int measure_surface(struct work *w, unsigned threads, struct gsn_bone *bone,
                           struct gsn_error *err)
{
    const size_t layers = w->grid->at.nz - 1;
    const int r = gsn_parallel_for(layers, threads, cut_layer, w, err);

    for (size_t z = 0; z < layers; z++)
        bone->surface_um2 += w->area[z];
    return r;
}

/* ---- thickness ----------------------------------------------------------------------------- */

/* A voxel of bone and the squared distance to what is none. */
struct centre {
    float squared;
    size_t voxel;
};

static int compare_centres(const void *left, const void *right)
{
    const struct centre *const a = left, *const b = right;

    if (a->squared != b->squared)
        return a->squared < b->squared ? 1 : -1;
    return (a->voxel > b->voxel) - (a->voxel < b->voxel);
}

static struct gsn_vec3 centre_of(const struct gsn_lattice *at, size_t voxel)
{
    return gsn_lattice_centre(at, voxel % at->nx, voxel / at->nx % at->ny, voxel / at->nx / at->ny);
}

/* Whether the sphere about a voxel goes less than half a voxel beyond the one that holds it. */
static int is_held(const struct work *w, const struct centre *c, double half_voxel)
{
    const struct gsn_lattice *const at = &w->grid->at;
    size_t other;

    if (w->held[c->voxel] == 0)
        return 0;
    other = w->ridge[w->held[c->voxel] - 1];
    return sqrt((double)c->squared) +
               gsn_vec3_length(gsn_vec3_sub(centre_of(at, c->voxel), centre_of(at, other))) <
           sqrt((double)w->squared[other]) + half_voxel;
}

/* The voxels of a sphere that no wider one holds are held by it. */
static void hold_sphere(struct work *w, const struct centre *c)
{
    const struct gsn_lattice *const at = &w->grid->at;
    const size_t x = c->voxel % at->nx, y = c->voxel / at->nx % at->ny;
    const size_t z = c->voxel / at->nx / at->ny;
    const double squared = (double)c->squared, reach = sqrt(squared);
    const size_t deep = (size_t)(reach / at->step_um.z), down = (size_t)(reach / at->step_um.y);

    for (size_t n = z > deep ? z - deep : 0; n <= z + deep && n < at->nz; n++)
        for (size_t v = y > down ? y - down : 0; v <= y + down && v < at->ny; v++) {
            const double away = ((double)n - (double)z) * at->step_um.z;
            const double aside = ((double)v - (double)y) * at->step_um.y;
            const double left = squared - away * away - aside * aside;
            const size_t right = left > 0 ? (size_t)(sqrt(left) / at->step_um.x) : 0;

            for (size_t u = x > right ? x - right : 0; left > 0 && u <= x + right && u < at->nx;
                 u++) {
                const double along = ((double)u - (double)x) * at->step_um.x;
                uint32_t *const held = &w->held[gsn_lattice_index(at, u, v, n)];

                if (*held == 0 && along * along < left)
                    *held = (uint32_t)w->ridge_count;
            }
        }
}

/* Spheres from the widest on, but for those that another holds. */
static int find_spheres(struct work *w, struct gsn_error *err)
{
    const size_t voxels = gsn_lattice_count(&w->grid->at);
    const double half_voxel = 0.5 * cbrt(gsn_lattice_voxel_um3(&w->grid->at));
    gsn_auto_mem(struct centre) centre = NULL;
    size_t count = 0, k = 0;

    for (size_t i = 0; i < voxels; i++)
        count += w->bone[i] && isfinite(w->squared[i]);
    centre = gsn_alloc_array(count + 1, sizeof *centre);
    if (!centre)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the morphometry of bone");
    for (size_t i = 0; i < voxels; i++)
        if (w->bone[i] && isfinite(w->squared[i]))
            centre[k++] = (struct centre){ w->squared[i], i };
    qsort(centre, count, sizeof *centre, compare_centres);
    for (k = 0; k < count; k++)
        if (!is_held(w, &centre[k], half_voxel)) {
            w->ridge[w->ridge_count++] = centre[k].voxel;
            hold_sphere(w, &centre[k]);
        }
    return GSN_OK;
}

/* Where the field passes the threshold between a voxel of bone and its neighbour along x, y or z;
 * half way where that has no data. Rows hold those of the lattice's rows of voxels, by the voxel
 * that is first along the axis. */
static int find_crossings(struct work *w, struct gsn_error *err)
{
    const struct gsn_lattice *const at = &w->grid->at;
    const size_t voxels = gsn_lattice_count(at), ahead[3] = { 1, at->nx, at->nx * at->ny };
    size_t count = 0, i = 0;

    for (int pass = 0; pass < 2; pass++) {
        if (pass) {
            w->crossing = gsn_alloc_array(count + 1, sizeof *w->crossing);
            if (!w->crossing)
                return gsn_fail(err, GSN_E_NOMEM, "out of memory for the morphometry of bone");
        }
        for (i = count = 0; i < voxels; i++) {
            const size_t x = i % at->nx, y = i / at->nx % at->ny, z = i / at->nx / at->ny;
            const int is_last[3] = { x + 1 == at->nx, y + 1 == at->ny, z + 1 == at->nz };

            if (x == 0)
                w->row[i / at->nx] = count;
            for (int a = 0; a < 3; a++) {
                double share;

                if (is_last[a] || w->bone[i] == w->bone[i + ahead[a]])
                    continue;
                share = (w->threshold - (double)w->grid->value[i]) /
                        ((double)w->grid->value[i + ahead[a]] - (double)w->grid->value[i]);
                if (pass)
                    w->crossing[count] =
                        go_between(gsn_lattice_centre(at, x, y, z),
                                   gsn_lattice_centre(at, x + (a == 0), y + (a == 1), z + (a == 2)),
                                   isnan(share) ? 0.5 : share);
                count++;
            }
        }
    }
    w->row[voxels / at->nx] = count;
    return GSN_OK;
}

enum { HALVES = 27 };

/* The radius of the widest sphere about the voxel's centre or one of the points half a voxel beside
 * it: to the nearest crossing. */
static int find_radius(size_t k, void *context, struct gsn_error *err)
{
    struct work *const w = context;
    const struct gsn_lattice *const at = &w->grid->at;
    const size_t i = w->ridge[k];
    const size_t x = i % at->nx, y = i / at->nx % at->ny, z = i / at->nx / at->ny;
    const struct gsn_vec3 here = gsn_lattice_centre(at, x, y, z);
    const double reach = sqrt((double)w->squared[i]) + gsn_vec3_length(at->step_um);
    const double farthest = reach + 0.5 * gsn_vec3_length(at->step_um);
    const size_t down = (size_t)(reach / at->step_um.y) + 1;
    const size_t deep = (size_t)(reach / at->step_um.z) + 1;
    double least[HALVES], most = 0;

    (void)err;
    for (int h = 0; h < HALVES; h++)
        least[h] = INFINITY;
    for (size_t n = z > deep ? z - deep : 0; n <= z + deep && n < at->nz; n++)
        for (size_t v = y > down ? y - down : 0; v <= y + down && v < at->ny; v++)
            for (size_t c = w->row[n * at->ny + v]; c < w->row[n * at->ny + v + 1]; c++) {
                const struct gsn_vec3 off = gsn_vec3_sub(w->crossing[c], here);

                if (off.x * off.x + off.y * off.y + off.z * off.z > farthest * farthest)
                    continue;
                for (int h = 0; h < HALVES; h++) {
                    const double a = off.x - 0.5 * (h % 3 - 1) * at->step_um.x;
                    const double b = off.y - 0.5 * (h / 3 % 3 - 1) * at->step_um.y;
                    const double d = off.z - 0.5 * (h / 9 - 1) * at->step_um.z;

                    least[h] = fmin(least[h], a * a + b * b + d * d);
                }
            }
    for (int h = 0; h < HALVES; h++)
        most = fmax(most, least[h]);
    w->radius[k] = (float)sqrt(most);
    return GSN_OK;
}

static void sum_thickness(const struct work *w, struct gsn_bone *bone)
{
    const struct gsn_lattice *const at = &w->grid->at;
    const double quarter = 0.25 * cbrt(gsn_lattice_voxel_um3(at));
    const size_t voxels = gsn_lattice_count(at);
    double n = 0, sum = 0, squares = 0;

    bone->thickness_most = NAN;
    for (size_t i = 0; i < voxels; i++) {
        double thickness;

        if (!w->counted[i] || w->held[i] == 0)
            continue;
        thickness = 2 * (double)w->radius[w->held[i] - 1] + quarter;
        n++;
        sum += thickness;
        squares += thickness * thickness;
        bone->thickness_most = fmax(bone->thickness_most, thickness);
    }
    bone->thickness_um = n > 0 ? sum / n : (double)NAN;
    bone->thickness_sd =
        n > 0 ? sqrt(fmax(squares / n - bone->thickness_um * bone->thickness_um, 0)) : (double)NAN;
}

static int measure_thickness(struct work *w, unsigned threads, struct gsn_bone *bone,
                             struct gsn_error *err)
{
    const struct gsn_lattice *const at = &w->grid->at;
    const struct gsn_distance_box box = { at->nx,        at->ny,        at->nz,
                                          at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t voxels = gsn_lattice_count(at);
    int r;

    for (size_t i = 0; i < voxels; i++)
        w->bone[i] = !w->bone[i];
    r = gsn_distance_squared(w->bone, &box, threads, w->squared, err);
    for (size_t i = 0; i < voxels; i++)
        w->bone[i] = !w->bone[i];
    if (r >= 0)
        r = find_spheres(w, err);
    if (r >= 0)
        r = find_crossings(w, err);
    if (r >= 0)
        r = gsn_parallel_for(w->ridge_count, threads, find_radius, w, err);
    if (r >= 0)
        sum_thickness(w, bone);
    return r;
}

/* ---- pieces and tunnels -------------------------------------------------------------------- */

/* Marks all that hangs together with voxel start. stack: room for every voxel. */
static void flood(struct work *w, size_t start, size_t *stack)
{
    const struct gsn_lattice *const at = &w->grid->at;
    size_t height = 0;

    stack[height++] = start;
    w->counted[start] = 2;
    while (height > 0) {
        const size_t i = stack[--height];
        const size_t x = i % at->nx, y = i / at->nx % at->ny, z = i / at->nx / at->ny;

        for (size_t n = z ? z - 1 : 0; n <= z + 1 && n < at->nz; n++)
            for (size_t v = y ? y - 1 : 0; v <= y + 1 && v < at->ny; v++)
                for (size_t u = x ? x - 1 : 0; u <= x + 1 && u < at->nx; u++) {
                    const size_t k = gsn_lattice_index(at, u, v, n);

                    if (w->counted[k] != 1)
                        continue;
                    w->counted[k] = 2;
                    stack[height++] = k;
                }
    }
}

static size_t count_components(struct work *w)
{
    const size_t voxels = gsn_lattice_count(&w->grid->at);
    size_t count = 0;

    for (size_t i = 0; i < voxels; i++)
        if (w->counted[i] == 1) {
            flood(w, i, w->ridge);
            count++;
        }
    return count;
}

static int is_bone_at(const struct work *w, size_t x, size_t y, size_t z)
{
    const struct gsn_lattice *const at = &w->grid->at;

    /* Below 0 wraps around, and is beyond the end as well. */
    return x < at->nx && y < at->ny && z < at->nz &&
           w->counted[gsn_lattice_index(at, x, y, z)] != 0;
}

/* A corner of voxels with the edges, faces and the voxel that begin there, towards larger
 * coordinates. */
static int count_at_corner(const struct work *w, size_t x, size_t y, size_t z)
{
    int cell[2][2][2], any = 0, edges, faces;

    for (size_t i = 0; i < 8; i++) {
        const size_t a = i & 1, b = i >> 1 & 1, c = i >> 2;

        cell[a][b][c] = is_bone_at(w, x + a - 1, y + b - 1, z + c - 1);
        any |= cell[a][b][c];
    }
    edges = (cell[1][0][0] | cell[1][0][1] | cell[1][1][0] | cell[1][1][1]) +
            (cell[0][1][0] | cell[0][1][1] | cell[1][1][0] | cell[1][1][1]) +
            (cell[0][0][1] | cell[0][1][1] | cell[1][0][1] | cell[1][1][1]);
    faces = (cell[1][1][0] | cell[1][1][1]) + (cell[1][0][1] | cell[1][1][1]) +
            (cell[0][1][1] | cell[1][1][1]);
    return any - edges + faces - cell[1][1][1];
}

static int64_t count_euler(const struct work *w)
{
    const struct gsn_lattice *const at = &w->grid->at;
    int64_t euler = 0;

    for (size_t z = 0; z <= at->nz; z++)
        for (size_t y = 0; y <= at->ny; y++)
            for (size_t x = 0; x <= at->nx; x++)
                euler += count_at_corner(w, x, y, z);
    return euler;
}

int gsn_bone_measure(const struct gsn_grid *grid, const struct gsn_mask *region, double threshold,
                     unsigned threads, struct gsn_bone *ret_bone, struct gsn_error *err)
{
    __attribute__((cleanup(work_done))) struct work w = { .grid = grid,
                                                          .region = region,
                                                          .threshold = threshold };
    struct gsn_bone bone = { 0 };
    int r;

    if (gsn_lattice_count(&grid->at) > GSN_BONE_VOXELS)
        return gsn_fail(err, GSN_E_LIMIT, "bone is measured in at most %d voxels",
                        (int)GSN_BONE_VOXELS);
    r = work_init(&w, err);

    if (r >= 0)
        r = count_voxels(&w, &bone, err);
    if (r >= 0)
        r = measure_surface(&w, threads, &bone, err);
    if (r >= 0)
        r = measure_thickness(&w, threads, &bone, err);
    if (r < 0)
        return r;
    bone.euler = count_euler(&w);
    bone.components = count_components(&w);
    *ret_bone = bone;
    return GSN_OK;
}
