/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/resample.h"

#include "pipeline/core/parallel.h"
#include "pipeline/model/resample_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* What a grid without any mesh costs, as a share of what the mesh adds. */
#define FILLING 0.1

static int fill_slab(size_t index, void *context, struct gsn_error *err)
{
    const struct gsn_resample_job *job = context;
    const size_t *layers = &job->cut[index];
    const size_t area = job->at->nx * job->at->ny;

    (void)err;
    /* Every byte 255 is a NaN, and memset() spares reading what it overwrites. */
    memset(&job->value[layers[0] * area], 255, (layers[1] - layers[0]) * area * sizeof *job->value);
    gsn_resample_tets(job, layers);
    gsn_resample_faces(job, layers);
    return GSN_OK;
}

static int check_lattice(const struct gsn_lattice *at, struct gsn_error *err)
{
    const struct gsn_vec3 last = gsn_lattice_centre(at, at->nx, at->ny, at->nz);
    const double all[9] = { at->origin_um.x, at->origin_um.y, at->origin_um.z,
                            at->step_um.x,   at->step_um.y,   at->step_um.z,
                            last.x,          last.y,          last.z };

    if (at->nx == 0 || at->ny == 0 || at->nz == 0)
        return gsn_fail(err, GSN_E_INPUT, "a grid of %zu x %zu x %zu has no voxels", at->nx, at->ny,
                        at->nz);
    if (at->nx > INT32_MAX / 2)
        return gsn_fail(err, GSN_E_INPUT, "a grid of %zu x %zu x %zu is too wide", at->nx, at->ny,
                        at->nz);
    for (int i = 0; i < 9; i++) {
        if (!isfinite(all[i]))
            return gsn_fail(err, GSN_E_INPUT, "the place of the grid is not finite");
    }
    if (!(at->step_um.x > 0 && at->step_um.y > 0 && at->step_um.z > 0))
        return gsn_fail(err, GSN_E_INPUT,
                        "the steps of the grid, %g x %g x %g um, are not positive", at->step_um.x,
                        at->step_um.y, at->step_um.z);
    return GSN_OK;
}

/* Cuts the layers where each slab has the same share of the mesh's volume and of all voxels. */
static void cut_slabs(const struct gsn_resample_job *job, size_t slabs, double *layer,
                      size_t *ret_cut)
{
    const struct gsn_tets *mesh = job->space->mesh;
    const size_t layers = job->count[2];
    double whole = 0, sum = 0;
    size_t z = 0;

    for (size_t t = 0; t < mesh->tet_count; t++) {
        const double at = (mesh->vertex[mesh->tet[t][0]][2] - job->origin[2]) / job->step[2];
        const double volume = gsn_tets_volume(mesh, t);

        if (!(at >= 0 && at < (double)layers))
            continue;
        whole += volume;
        layer[(size_t)at] += volume;
    }
    for (size_t i = 0; i < slabs; i++) {
        const double share = (double)i / (double)slabs;

        while (z < layers && sum < share * (1 + FILLING) * whole) {
            sum += layer[z] + FILLING * whole / (double)layers;
            z++;
        }
        ret_cut[i] = z;
    }
    ret_cut[slabs] = layers;
}

int gsn_spline_resample(const struct gsn_spline *spline, const struct gsn_lattice *at,
                        unsigned threads, double *ret_value, struct gsn_error *err)
{
    gsn_auto_mem(double) centre = NULL;
    gsn_auto_mem(double) layer = NULL;
    gsn_auto_mem(size_t) cut = NULL;
    const size_t wanted = threads == 0 ? gsn_parallel_threads() : threads;
    const size_t slabs = wanted < at->nz ? wanted : at->nz;
    struct gsn_resample_job job = { .spline = spline,
                                    .space = gsn_spline_space(spline),
                                    .at = at,
                                    .count = { at->nx, at->ny, at->nz },
                                    .origin = { at->origin_um.x, at->origin_um.y, at->origin_um.z },
                                    .step = { at->step_um.x, at->step_um.y, at->step_um.z },
                                    .value = ret_value };
    int r = check_lattice(at, err);
    double *to;

    assert(spline && ret_value);

    if (r < 0)
        return r;
    centre = to = gsn_alloc_array(at->nx + at->ny + at->nz, sizeof *centre);
    layer = gsn_alloc_array(at->nz, sizeof *layer);
    cut = gsn_alloc_array(slabs + 1, sizeof *cut);
    if (!centre || !layer || !cut)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a grid of %zu x %zu x %zu", at->nx,
                        at->ny, at->nz);
    for (int c = 0; c < 3; c++) {
        job.centre[c] = to;
        for (size_t i = 0; i < job.count[c]; i++) {
            const struct gsn_vec3 p = gsn_lattice_centre(at, i, i, i);

            *to = c == 0 ? p.x : c == 1 ? p.y : p.z;
            job.farthest = fmax(job.farthest, fabs(*to++));
        }
        job.farthest = fmax(job.farthest, fabs(job.origin[c]));
    }
    cut_slabs(&job, slabs, layer, cut);
    job.cut = cut;
    return gsn_parallel_for(slabs, threads, fill_slab, &job, err);
}
