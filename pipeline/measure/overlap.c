/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The tetrahedra whose functions reach each voxel of a region, and that the region lies in the
 * mesh.
 *
 * Method: object order. Every tetrahedron walks through the voxels in the box around its knots;
 * what half-spaces keep apart is left out. A voxel sticks out when a face of the boundary cuts it,
 * or when no tetrahedron holds its centre.
 *
 * Steps: (1) number the region's voxels in the order of the grid; (2) count and list the pairs;
 * (3) sort each voxel's tetrahedra; (4) look at the voxels near each face of the boundary.
 *
 * Failure: GSN_E_INPUT names the first voxel that sticks out; GSN_E_NOMEM.
 * Cost: linear in the pairs, some ten a voxel. */
#include "pipeline/measure/overlap.h"

#include <math.h>
#include <string.h>

/* A face of the domain may lie in a face of a voxel: only what reaches deeper than this part of the
 * voxel counts as cutting it. */
static const double skin_of_voxel = 1e-9;

struct gsn_aabb gsn_voxel_aabb(const struct gsn_lattice *at, size_t index)
{
    const size_t x = index % at->nx, y = index / at->nx % at->ny, z = index / at->nx / at->ny;
    const struct gsn_vec3 centre = gsn_lattice_centre(at, x, y, z);

    return (struct gsn_aabb){
        .centre = { centre.x, centre.y, centre.z },
        .half = { 0.5 * at->step_um.x, 0.5 * at->step_um.y, 0.5 * at->step_um.z },
    };
}

void gsn_voxel_range(const struct gsn_lattice *at, int axis, double low, double high,
                     size_t *ret_first, size_t *ret_end)
{
    const double origin[3] = { at->origin_um.x, at->origin_um.y, at->origin_um.z };
    const double step[3] = { at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t n[3] = { at->nx, at->ny, at->nz };
    const double most = (double)n[axis];
    /* One voxel more on either side costs a look, one less would cost the truth. */
    const double first = floor((low - origin[axis]) / step[axis] + 0.5 - 1e-6);
    const double end = floor((high - origin[axis]) / step[axis] + 0.5 + 1e-6) + 1.0;

    *ret_first = (size_t)fmin(most, fmax(0.0, first));
    *ret_end = (size_t)fmin(most, fmax(0.0, end));
}

/* Calls visit for every voxel of the region whose cell may meet the box spanned by the points. */
struct visit {
    const struct gsn_mask *region;
    int (*body)(size_t index, const struct gsn_aabb *box, void *context);
    void *context;
};

static int walk_cells(const struct visit *visit, const double (*corner)[3], int corners)
{
    const struct gsn_lattice *at = &visit->region->at;
    size_t first[3], end[3];

    for (int a = 0; a < 3; a++) {
        double low = INFINITY, high = -INFINITY;

        for (int k = 0; k < corners; k++) {
            low = fmin(low, corner[k][a]);
            high = fmax(high, corner[k][a]);
        }
        gsn_voxel_range(at, a, low, high, &first[a], &end[a]);
    }
    for (size_t z = first[2]; z < end[2]; z++) {
        for (size_t y = first[1]; y < end[1]; y++) {
            for (size_t x = first[0]; x < end[0]; x++) {
                const size_t index = gsn_lattice_index(at, x, y, z);

                if (visit->region->inside[index]) {
                    const struct gsn_aabb box = gsn_voxel_aabb(at, index);

                    if (visit->body(index, &box, visit->context))
                        return 1;
                }
            }
        }
    }
    return 0;
}

struct cut_by_boundary {
    double face[3][3];
    size_t index;
};

static int is_cut(size_t index, const struct gsn_aabb *box, void *context)
{
    struct cut_by_boundary *cut = context;
    struct gsn_aabb core = *box;

    for (int a = 0; a < 3; a++)
        core.half[a] *= 1.0 - skin_of_voxel;
    if (!gsn_aabb_meets_triangle(&core, (const double(*)[3])cut->face))
        return 0;
    cut->index = index;
    return 1;
}

static int sticks_out(const struct gsn_lattice *at, size_t index, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "voxel (%zu, %zu, %zu) of the region sticks out of the domain", index % at->nx,
                    index / at->nx % at->ny, index / at->nx / at->ny);
}

/* A voxel no face of the domain's boundary cuts is inside as a whole or outside as a whole. */
static int check_boundary(const struct gsn_mask *region, const struct gsn_tets *mesh,
                          struct gsn_error *err)
{
    for (size_t t = 0; t < mesh->tet_count; t++) {
        for (int k = 0; k < 4; k++) {
            struct cut_by_boundary cut;
            const struct visit visit = { region, is_cut, &cut };

            if (mesh->neighbour[t][k] >= 0)
                continue;
            for (int j = 0; j < 3; j++) {
                for (int a = 0; a < 3; a++)
                    cut.face[j][a] = mesh->vertex[mesh->tet[t][(k + 1 + j) % 4]][a];
            }
            if (walk_cells(&visit, (const double(*)[3])cut.face, 3))
                return sticks_out(&region->at, cut.index, err);
        }
    }
    return GSN_OK;
}

struct pairs {
    const struct gsn_local_polynomial *piece;
    uint32_t tet;
    const size_t *rank;  /* of a lattice index in the region */
    size_t *first;       /* [rank + 1] counts, then [rank] is where the next goes */
    uint32_t *list;      /* NULL while counting */
    unsigned char *held; /* whether some tetrahedron holds the voxel's centre */
};

static int note_pair(size_t index, const struct gsn_aabb *box, void *context)
{
    const struct pairs *pairs = context;
    const size_t rank = pairs->rank[index];

    if (!gsn_local_polynomial_reaches(pairs->piece, box))
        return 0;
    if (pairs->list) {
        pairs->list[pairs->first[rank]++] = pairs->tet;
    } else {
        pairs->first[rank + 1]++;
        if (gsn_local_polynomial_depth(pairs->piece, box->centre) > -skin_of_voxel)
            pairs->held[rank] = 1;
    }
    return 0;
}

static void note_all(const struct gsn_mask *region, const struct gsn_dms *space,
                     const struct gsn_local_polynomial *pieces, struct pairs *pairs)
{
    const struct visit visit = { region, note_pair, pairs };
    const struct gsn_tets *mesh = gsn_dms_mesh(space);
    const size_t cloud = gsn_dms_degree(space) + 1U;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        double knot[4 * (GSN_DMS_MAX_DEGREE + 1)][3];
        int count = 0;

        for (int k = 0; k < 4; k++) {
            for (size_t l = 0; l < cloud; l++, count++)
                memcpy(knot[count], gsn_dms_knots(space)[mesh->tet[t][k] * cloud + l],
                       sizeof knot[0]);
        }
        pairs->piece = &pieces[t];
        pairs->tet = (uint32_t)t;
        (void)walk_cells(&visit, (const double(*)[3])knot, count);
    }
}

static int fill_overlap(const struct gsn_mask *region, const struct gsn_dms *space,
                        const struct gsn_local_polynomial *pieces,
                        struct gsn_voxel_overlap *overlap, struct gsn_error *err)
{
    const size_t total = gsn_lattice_count(&region->at), count = overlap->voxel_count;
    gsn_auto_mem(size_t) rank = gsn_alloc_array(total, sizeof *rank);
    gsn_auto_mem(unsigned char) held = gsn_alloc_array(count, 1);
    struct pairs pairs = { .rank = rank, .first = overlap->first, .held = held };

    if (!rank || !held)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu voxels", total);
    for (size_t i = 0, v = 0; i < total; i++) {
        if (region->inside[i]) {
            overlap->voxel[v] = i;
            rank[i] = v++;
        }
    }
    note_all(region, space, pieces, &pairs);
    for (size_t v = 0; v < count; v++) {
        if (!held[v])
            return sticks_out(&region->at, overlap->voxel[v], err);
        overlap->first[v + 1] += overlap->first[v];
    }
    overlap->tet = gsn_alloc_array(overlap->first[count], sizeof *overlap->tet);
    if (!overlap->tet)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu voxels", count);
    pairs.list = overlap->tet;
    note_all(region, space, pieces, &pairs);
    /* Filling moved every start to the next one's. */
    for (size_t v = count; v > 0; v--)
        overlap->first[v] = overlap->first[v - 1];
    overlap->first[0] = 0;
    return GSN_OK;
}

int gsn_voxel_overlap_new(const struct gsn_mask *region, const struct gsn_dms *space,
                          const struct gsn_local_polynomial *pieces,
                          struct gsn_voxel_overlap **ret_overlap, struct gsn_error *err)
{
    const size_t count = gsn_mask_count(region);
    gsn_auto(gsn_voxel_overlap) overlap = NULL;
    int r;

    if (count == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region of interest is empty");
    r = check_boundary(region, gsn_dms_mesh(space), err);
    if (r < 0)
        return r;
    overlap = gsn_alloc_array(1, sizeof *overlap);
    if (overlap) {
        overlap->at = region->at;
        overlap->voxel_count = count;
        overlap->voxel = gsn_alloc_array(count, sizeof *overlap->voxel);
        overlap->first = gsn_alloc_array(count + 1, sizeof *overlap->first);
    }
    if (!overlap || !overlap->voxel || !overlap->first)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu voxels", count);
    r = fill_overlap(region, space, pieces, overlap, err);
    if (r < 0)
        return r;
    *ret_overlap = gsn_steal(&overlap);
    return GSN_OK;
}

void gsn_voxel_overlap_free(struct gsn_voxel_overlap *overlap)
{
    if (!overlap)
        return;
    gsn_free(overlap->voxel);
    gsn_free(overlap->first);
    gsn_free(overlap->tet);
    gsn_free(overlap);
}
