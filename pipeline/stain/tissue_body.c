/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/tissue_body.h"

#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

/* Voxels in the plane: half of the thinnest layer looked for, a ligament of 100 um and more, needs
 * one and a half of them. */
static const double VOXEL_UM = 32;
/* Planes further apart are not bridged: the root moves by half a ligament's width in as much. */
static const double LONGEST_GAP_UM = 240;
/* Fewer voxels that two planes share do not say how their stain compares. */
enum { LEAST_SHARED = 200 };

void gsn_body_done(struct gsn_body *b)
{
    gsn_free(b->value);
    gsn_free(b->least);
    gsn_free(b->set);
    gsn_free(b->list);
}

static size_t factor(double step_um)
{
    return (size_t)fmax(1, round(VOXEL_UM / step_um));
}

static int make_room(const struct gsn_lattice *at, struct gsn_body *b, struct gsn_error *err)
{
    const size_t fx = factor(at->step_um.x), fy = factor(at->step_um.y);

    *b = (struct gsn_body){ .at = *at };
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
static void reduce(const struct gsn_grid *density, struct gsn_body *b)
{
    const struct gsn_lattice *at = &density->at;
    const size_t fx = factor(at->step_um.x), fy = factor(at->step_um.y);
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

/* ---- even planes ---------------------------------------------------------------------------- */

/* Log of how much more stain a plane took than an earlier one: the median over the tissue that both
 * show, which a lesion or a pulp that begins between them does not move. 0 where too little is
 * shared. */
static double step_of_stain(const struct gsn_body *b, size_t earlier, size_t later, double *ratio)
{
    const size_t plane = b->at.nx * b->at.ny;
    const float *one = b->value + earlier * plane, *two = b->value + later * plane;
    size_t n = 0;

    for (size_t i = 0; i < plane; i++)
        if (one[i] > 2 * GSN_BODY_GLASS && two[i] > 2 * GSN_BODY_GLASS)
            ratio[n++] = log((double)(two[i] / one[i]));
    return n < LEAST_SHARED ? 0 : gsn_order_pick(ratio, n, n / 2);
}

static int has_data(const struct gsn_body *b, size_t z)
{
    const size_t plane = b->at.nx * b->at.ny;
    size_t n = 0;

    for (size_t i = z * plane; i < (z + 1) * plane && n < LEAST_SHARED; i++)
        n += b->value[i] > GSN_BODY_GLASS;
    return n >= LEAST_SHARED;
}

/* Panels are stained unequally, and one level must tell tissues apart in all of them. What the
 * tissue itself changes from one plane to the next is small beside that. */
static int even_planes(struct gsn_body *b, struct gsn_error *err)
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
static void bridge(struct gsn_body *b)
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

/* ---- smoothing, where no data counts as nothing --------------------------------------------- */

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

static void smooth(struct gsn_body *b)
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

/* ---- sets ----------------------------------------------------------------------------------- */

int gsn_body_beside(const struct gsn_body *b, size_t at, uint32_t ret_beside[6])
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

static void find_least(struct gsn_body *b)
{
    for (size_t i = 0; i < b->count; i++) {
        uint32_t beside[6];
        const int n = gsn_body_beside(b, i, beside);

        b->least[i] = b->value[i];
        for (int k = 0; k < n; k++)
            b->least[i] = fminf(b->least[i], b->value[beside[k]]);
    }
}

size_t gsn_body_flood(struct gsn_body *b, size_t start)
{
    size_t n = 0;

    if (b->set[start] != 1)
        return 0;
    b->set[start] = 2;
    b->list[n++] = (uint32_t)start;
    for (size_t done = 0; done < n; done++) {
        uint32_t beside[6];
        const int around = gsn_body_beside(b, b->list[done], beside);

        for (int k = 0; k < around; k++)
            if (b->set[beside[k]] == 1) {
                b->set[beside[k]] = 2;
                b->list[n++] = beside[k];
            }
    }
    return n;
}

/* Leaves the largest piece. */
static void keep_largest(struct gsn_body *b)
{
    size_t most = 0, best = 0, n;

    for (size_t i = 0; i < b->count; i++)
        if ((n = gsn_body_flood(b, i)) > most) {
            most = n;
            best = i;
        }
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] != 0;
    n = most > 0 ? gsn_body_flood(b, best) : 0;
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] == 2;
}

/* Voxels that have one of the other kind beside them change to it. */
static void shift_border(struct gsn_body *b, uint8_t to)
{
    size_t n = 0;

    for (size_t i = 0; i < b->count; i++) {
        uint32_t beside[6];
        const int around = b->set[i] != to ? gsn_body_beside(b, i, beside) : 0;

        for (int k = 0; k < around; k++)
            if (b->set[beside[k]] == to) {
                b->list[n++] = (uint32_t)i;
                break;
            }
    }
    for (size_t k = 0; k < n; k++)
        b->set[b->list[k]] = to;
}

void gsn_body_tidy(struct gsn_body *b)
{
    shift_border(b, 0);
    keep_largest(b);
    shift_border(b, 1);
}

static size_t take(uint8_t *set, size_t at, uint32_t *list, size_t n)
{
    if (set[at] != 1)
        return n;
    set[at] = 2;
    list[n] = (uint32_t)at;
    return n + 1;
}

void gsn_body_fill_sections(struct gsn_body *b)
{
    const size_t nx = b->at.nx, ny = b->at.ny, plane = nx * ny;

    for (size_t z = 0; z < b->at.nz; z++) {
        uint8_t *set = b->set + z * plane;
        size_t n = 0;

        for (size_t i = 0; i < plane; i++)
            set[i] = !set[i];
        for (size_t i = 0; i < plane; i++) /* from the border of the section */
            if (i < nx || i + nx >= plane || i % nx == 0 || i % nx + 1 == nx)
                n = take(set, i, b->list, n);
        for (size_t done = 0; done < n; done++) {
            const size_t i = b->list[done];

            n = i % nx > 0 ? take(set, i - 1, b->list, n) : n;
            n = i % nx + 1 < nx ? take(set, i + 1, b->list, n) : n;
            n = i >= nx ? take(set, i - nx, b->list, n) : n;
            n = i + nx < plane ? take(set, i + nx, b->list, n) : n;
        }
        for (size_t i = 0; i < plane; i++)
            set[i] = set[i] != 2;
    }
}

int gsn_body_init(const struct gsn_grid *density, struct gsn_body *b, struct gsn_error *err)
{
    int r = make_room(&density->at, b, err);

    if (r < 0)
        return r;
    reduce(density, b);
    r = even_planes(b, err);
    if (r < 0)
        return r;
    bridge(b);
    smooth(b);
    find_least(b);
    return GSN_OK;
}
