/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Integrals over the region of interest by the midpoint rule on a cubic lattice, plane by plane;
 * planes go to threads and are summed in their order. Then the table of values that the
 * specification demands of them.
 *
 * Failure: GSN_E_NOMEM. Cost: the field at each point of the cylinder around the region, the cube
 * of one over the step. */
#include "pipeline/phantom/check.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/parallel.h"

#include <math.h>
#include <stdio.h>

const double gsn_phantom_thresholds[GSN_PHANTOM_THRESHOLDS] = { 0.3, 0.5, 0.7 };

struct layer_sum {
    size_t inside, above[GSN_PHANTOM_DEPTHS][GSN_PHANTOM_THRESHOLDS];
    double intact, lost, bone;
};

struct job {
    const struct gsn_phantom_geometry *geometry;
    const double *depth;
    double step_um, gain;
    size_t across; /* steps over the region's diameter */
    struct layer_sum *layer;
};

static void add_point(const struct job *job, struct gsn_vec3 at, struct layer_sum *sum)
{
    struct gsn_phantom_field field;

    gsn_phantom_field_at(job->geometry, at, &field);
    sum->inside++;
    sum->intact += field.intact;
    sum->lost += field.lost;
    sum->bone += field.bone;
    gsn_phantom_field_thicken(&field, job->gain);
    for (int a = 0; a < GSN_PHANTOM_DEPTHS; a++)
        for (int t = 0; t < GSN_PHANTOM_THRESHOLDS; t++)
            if (gsn_phantom_density(&field, job->depth[a]) > gsn_phantom_thresholds[t])
                sum->above[a][t]++;
}

static int add_layer(size_t index, void *context, struct gsn_error *err)
{
    const struct job *job = context;
    const struct gsn_phantom_geometry *g = job->geometry;
    struct layer_sum sum = { 0 };
    struct gsn_vec3 at;

    (void)err;
    at.z = g->lesion.z - g->region_half_height + ((double)index + 0.5) * job->step_um;
    for (size_t j = 0; j < job->across; j++) {
        at.y = g->lesion.y - g->region_radius + ((double)j + 0.5) * job->step_um;
        for (size_t i = 0; i < job->across; i++) {
            at.x = g->lesion.x - g->region_radius + ((double)i + 0.5) * job->step_um;
            if (gsn_phantom_in_region(g, at))
                add_point(job, at, &sum);
        }
    }
    job->layer[index] = sum;
    return GSN_OK;
}

int gsn_phantom_sum(const struct gsn_phantom_geometry *g, double step_um,
                    const double depth[GSN_PHANTOM_DEPTHS], double gain, unsigned threads,
                    struct gsn_phantom_sums *ret_sums, struct gsn_error *err)
{
    const double height = 2 * g->region_half_height;
    const size_t layers = (size_t)fmax(1, round(height / step_um));
    const double step = height / (double)layers, cell = step * step * step * 1e-9;
    gsn_auto_mem(struct layer_sum) layer = gsn_alloc_array(layers, sizeof *layer);
    struct gsn_phantom_sums sums = { 0 };
    struct job job = { .geometry = g,
                       .depth = depth,
                       .step_um = step,
                       .gain = gain,
                       .across = (size_t)ceil(2 * g->region_radius / step - 1e-9),
                       .layer = layer };
    int r;

    if (!layer)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sums over the region");
    r = gsn_parallel_for(layers, threads, add_layer, &job, err);
    if (r < 0)
        return r;
    for (size_t z = 0; z < layers; z++) {
        sums.volume += (double)layer[z].inside * cell;
        sums.intact += layer[z].intact * cell;
        sums.lost += layer[z].lost * cell;
        sums.bone += layer[z].bone * cell;
        for (int a = 0; a < GSN_PHANTOM_DEPTHS; a++)
            for (int t = 0; t < GSN_PHANTOM_THRESHOLDS; t++)
                sums.above[a][t] += (double)layer[z].above[a][t] * cell;
    }
    *ret_sums = sums;
    return GSN_OK;
}

double gsn_phantom_loss_percent(const struct gsn_phantom_sums *sums, double depth)
{
    return 100 * depth * sums->lost / sums->intact;
}

static void demand_value(struct gsn_phantom_check *check, double value, double demanded,
                         double tolerance)
{
    check->value = value;
    check->demanded = demanded;
    check->tolerance = tolerance;
    check->met = fabs(value - demanded) <= tolerance;
}

int gsn_phantom_check_all(double step_um, unsigned threads,
                          struct gsn_phantom_check ret_check[GSN_PHANTOM_CHECKS],
                          struct gsn_error *err)
{
    static const double depth[GSN_PHANTOM_DEPTHS] = { 0, 0.3698, 0.8153, 1 };
    static const double loss[GSN_PHANTOM_DEPTHS] = { 0, 16.594, 36.585, 44.873 };
    static const double above[GSN_PHANTOM_THRESHOLDS][GSN_PHANTOM_DEPTHS] = {
        { 0.9656, 0.9652, 0.8733, 0.7422 },
        { 0.9636, 0.9626, 0.5830, 0.4685 },
        { 0.9575, 0.5566, 0.2039, 0.1380 },
    };
    static const double region_mm3 = 0.9802, mean_density = 0.8431;
    const double points = 0.02, relative = 0.001;
    struct gsn_phantom_check *next = ret_check;
    struct gsn_phantom_sums sums;
    const int r = gsn_phantom_sum(gsn_phantom_geometry(), step_um, depth, 1, threads, &sums, err);

    if (r < 0)
        return r;
    for (int a = 0; a < GSN_PHANTOM_DEPTHS; a++, next++) {
        (void)snprintf(next->name, sizeof next->name, "loss %% at A = %g", depth[a]);
        demand_value(next, gsn_phantom_loss_percent(&sums, depth[a]), loss[a], points);
    }
    for (int t = 0; t < GSN_PHANTOM_THRESHOLDS; t++)
        for (int a = 0; a < GSN_PHANTOM_DEPTHS; a++, next++) {
            (void)snprintf(next->name, sizeof next->name, "mm3 of D > %g at A = %g",
                           gsn_phantom_thresholds[t], depth[a]);
            demand_value(next, sums.above[a][t], above[t][a], relative * above[t][a]);
        }
    (void)snprintf(next->name, sizeof next->name, "mm3 of the region");
    demand_value(next++, sums.volume, region_mm3, relative * region_mm3);
    (void)snprintf(next->name, sizeof next->name, "mean density at A = 0");
    demand_value(next, sums.intact / sums.volume, mean_density, relative * mean_density);
    return GSN_OK;
}
