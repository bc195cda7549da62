/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/tissue.h"

#include <math.h>
#include <string.h>

#include "pipeline/core/distance.h"
#include "pipeline/stain/order.h"
#include "pipeline/stain/segment.h"

/* Voxels in the plane: half of the thinnest layer looked for, a ligament of 100 um and more, needs
 * one and a half of them. */
#define VOXEL_UM 32.0
/* Below this share of the red of bone it is loose tissue, above it bone. */
#define LEAST_OF_BONE 0.35
#define MOST_OF_BONE 0.82
/* The blurred border between two tissues passes through every density, in a thinner shell. */
#define SHELL_UM 60.0
#define GLASS 0.08
/* A root of less is a splinter: a ball of 300 um. */
#define LEAST_ROOT_UM3 1.4e7

struct body {
    struct gsn_lattice at;
    size_t count;
    float *value;  /* smoothed density */
    uint8_t *set;  /* the work in hand */
    float *square; /* distances */
    uint32_t *list;
    unsigned threads;
};

static void body_done(struct body *b)
{
    gsn_free(b->value);
    gsn_free(b->set);
    gsn_free(b->square);
    gsn_free(b->list);
}

static int body_init(const struct gsn_grid *density, unsigned threads, struct body *b,
                     struct gsn_error *err)
{
    const struct gsn_lattice *at = &density->at;
    const size_t fx = (size_t)fmax(1, round(VOXEL_UM / at->step_um.x));
    const size_t fy = (size_t)fmax(1, round(VOXEL_UM / at->step_um.y));

    *b = (struct body){ .at = *at, .threads = threads };
    b->at.nx = (at->nx + fx - 1) / fx;
    b->at.ny = (at->ny + fy - 1) / fy;
    b->at.step_um.x = at->step_um.x * (double)fx;
    b->at.step_um.y = at->step_um.y * (double)fy;
    b->at.origin_um.x += at->step_um.x * (double)(fx - 1) / 2;
    b->at.origin_um.y += at->step_um.y * (double)(fy - 1) / 2;
    b->count = gsn_lattice_count(&b->at);
    b->value = gsn_alloc_array(b->count, sizeof *b->value);
    b->set = gsn_alloc_array(b->count, 1);
    b->square = gsn_alloc_array(b->count, sizeof *b->square);
    b->list = gsn_alloc_array(b->count, sizeof *b->list);
    if (b->value && b->set && b->square && b->list)
        return GSN_OK;
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
}

/* ---- smoothing, where no data counts as nothing ------------------------------------------- */

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

/* Means of the finer voxels, then of 3 x 3 x 3 of them. */
static void reduce(const struct gsn_grid *density, struct body *b)
{
    const struct gsn_lattice *at = &density->at;
    const size_t fx = (size_t)fmax(1, round(VOXEL_UM / at->step_um.x));
    const size_t fy = (size_t)fmax(1, round(VOXEL_UM / at->step_um.y));
    float *weight = b->square;
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
    sum_all_axes(&b->at, b->value);
    sum_all_axes(&b->at, weight);
    for (i = 0; i < b->count; i++)
        b->value[i] = weight[i] > 0 ? b->value[i] / weight[i] : 0;
}

/* ---- sets ---------------------------------------------------------------------------------- */

/* set becomes 1 within um of where it was `of`, else 0. */
static int near(struct body *b, uint8_t of, double um, struct gsn_error *err)
{
    const struct gsn_distance_box box = { b->at.nx,        b->at.ny,        b->at.nz,
                                          b->at.step_um.x, b->at.step_um.y, b->at.step_um.z };
    int r;

    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] == of;
    r = gsn_distance_squared(b->set, &box, b->threads, b->square, err);
    for (size_t i = 0; r >= 0 && i < b->count; i++)
        b->set[i] = b->square[i] <= (float)(um * um);
    return r;
}

static int dilate(struct body *b, double um, struct gsn_error *err)
{
    return near(b, 1, um, err);
}

static int erode(struct body *b, double um, struct gsn_error *err)
{
    const int r = near(b, 0, um, err);

    for (size_t i = 0; i < b->count; i++)
        b->set[i] = !b->set[i];
    return r;
}

static size_t take(uint8_t *set, size_t at, uint32_t *list, size_t n)
{
    if (set[at] != 1)
        return n;
    set[at] = 2;
    list[n] = (uint32_t)at;
    return n + 1;
}

/* The piece (6 neighbours) that holds start; its voxels become 2. */
static size_t flood(struct body *b, size_t start, uint32_t *list)
{
    const size_t nx = b->at.nx, plane = nx * b->at.ny;
    size_t n = take(b->set, start, list, 0);

    for (size_t done = 0; done < n; done++) {
        const size_t i = list[done], x = i % nx, y = i / nx % b->at.ny, z = i / plane;

        n = x > 0 ? take(b->set, i - 1, list, n) : n;
        n = x + 1 < nx ? take(b->set, i + 1, list, n) : n;
        n = y > 0 ? take(b->set, i - nx, list, n) : n;
        n = y + 1 < b->at.ny ? take(b->set, i + nx, list, n) : n;
        n = z > 0 ? take(b->set, i - plane, list, n) : n;
        n = z + 1 < b->at.nz ? take(b->set, i + plane, list, n) : n;
    }
    return n;
}

/* Leaves the largest piece. */
static void keep_largest(struct body *b)
{
    size_t most = 0, best = 0, n;

    for (size_t i = 0; i < b->count; i++)
        if (b->set[i] == 1 && (n = flood(b, i, b->list)) > most) {
            most = n;
            best = i;
        }
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] != 0;
    n = most > 0 ? flood(b, best, b->list) : 0;
    for (size_t i = 0; i < b->count; i++)
        b->set[i] = b->set[i] == 2;
}

/* What is enclosed within one section belongs to it: the pulp opens at the end of the block. */
static void fill_sections(struct body *b)
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

/* ---- the root ------------------------------------------------------------------------------ */

/* Lists the values of the set; with no set, those that are not glass. */
static size_t list_values(const struct body *b, int of_set, float *list)
{
    size_t n = 0;

    for (size_t i = 0; i < b->count; i++)
        if (of_set ? b->set[i] : b->value[i] > GLASS)
            list[n++] = b->value[i];
    return n;
}

static double median(const float *value, size_t n, double above, double *scratch)
{
    size_t count = 0;

    for (size_t i = 0; i < n; i++)
        if (value[i] > above)
            scratch[count++] = value[i];
    return count > 0 ? gsn_order_pick(scratch, count, count / 2) : (double)NAN;
}

/* Everything between loose tissue and bone, without the shells around bone, and what splits it into
 * ligament and dentine. */
static int find_between(struct body *b, float *list, double *scratch,
                        struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    size_t n = list_values(b, 0, list);
    int r;

    levels->bone = median(list, n, gsn_otsu(list, n), scratch);
    for (size_t i = 0; i < b->count; i++)
        b->set[i] =
            b->value[i] > LEAST_OF_BONE * levels->bone && b->value[i] < MOST_OF_BONE * levels->bone;
    r = erode(b, SHELL_UM, err);
    if (r < 0)
        return r;
    keep_largest(b);
    r = dilate(b, SHELL_UM, err);
    n = list_values(b, 1, list);
    levels->border = gsn_otsu(list, n);
    levels->dentine = median(list, n, levels->border, scratch);
    return r;
}

/* The core of what is dentine by its density, grown back to its own border and filled. */
static int find_root(struct body *b, const struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    int r;

    for (size_t i = 0; i < b->count; i++)
        b->set[i] =
            b->set[i] && b->value[i] > levels->border && b->value[i] < MOST_OF_BONE * levels->bone;
    r = erode(b, SHELL_UM, err);
    if (r < 0)
        return r;
    keep_largest(b);
    r = dilate(b, SHELL_UM, err);
    if (r >= 0)
        fill_sections(b);
    return r;
}

static int make_root(struct body *b, struct gsn_mask **ret_root, struct gsn_tissue_levels *levels,
                     struct gsn_error *err)
{
    gsn_auto_mem(float) list = gsn_alloc_array(b->count, sizeof *list);
    gsn_auto_mem(double) scratch = gsn_alloc_array(b->count, sizeof *scratch);
    gsn_auto(gsn_mask) root = NULL;
    int r;

    if (!list || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the root of a block");
    r = find_between(b, list, scratch, levels, err);
    if (r >= 0)
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

int gsn_tissue_root(const struct gsn_grid *density, unsigned threads, struct gsn_mask **ret_root,
                    struct gsn_tissue_levels *ret_levels, struct gsn_error *err)
{
    struct gsn_tissue_levels levels = { 0 };
    struct body b;
    int r = body_init(density, threads, &b, err);

    if (r >= 0) {
        reduce(density, &b);
        r = make_root(&b, ret_root, &levels, err);
    }
    body_done(&b);
    if (r >= 0)
        *ret_levels = levels;
    return r;
}

/* ---- bands --------------------------------------------------------------------------------- */

/* Whether a voxel or one of its six neighbours is `of`. */
static int touches(const struct gsn_mask *body, size_t i, uint8_t of)
{
    const struct gsn_lattice *at = &body->at;
    const size_t x = i % at->nx, y = i / at->nx % at->ny, z = i / at->nx / at->ny;
    const size_t plane = at->nx * at->ny;
    const uint8_t *in = body->inside + i;

    return in[0] == of || (x > 0 && in[-1] == of) || (x + 1 < at->nx && in[1] == of) ||
           (y > 0 && *(in - at->nx) == of) || (y + 1 < at->ny && in[at->nx] == of) ||
           (z > 0 && *(in - plane) == of) || (z + 1 < at->nz && in[plane] == of);
}

/* Adds to each voxel that is not `of` its distance from those that are, and from those that are or
 * touch them: the surface lies midway, whichever way it runs through the voxels. */
static int add_distances(const struct gsn_mask *body, uint8_t of, unsigned threads, double sign,
                         float *distance, struct gsn_error *err)
{
    const struct gsn_lattice *at = &body->at;
    const struct gsn_distance_box box = { at->nx,        at->ny,        at->nz,
                                          at->step_um.x, at->step_um.y, at->step_um.z };
    const size_t count = gsn_lattice_count(at);
    gsn_auto_mem(uint8_t) set = gsn_alloc_array(count, 1);
    gsn_auto_mem(float) squared = gsn_alloc_array(count, sizeof *squared);
    int r = set && squared ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for distances");

    for (int wide = 0; wide < 2 && r >= 0; wide++) {
        for (size_t i = 0; i < count; i++)
            set[i] = wide ? (uint8_t)touches(body, i, of) : body->inside[i] == of;
        r = gsn_distance_squared(set, &box, threads, squared, err);
        for (size_t i = 0; r >= 0 && i < count; i++)
            distance[i] += (float)(body->inside[i] == of ? 0 : sign * sqrt(squared[i]) / 2);
    }
    return r;
}

/* Distance from the surface at every voxel centre, negative inside. */
static int signed_distance(const struct gsn_mask *body, unsigned threads, float *distance,
                           struct gsn_error *err)
{
    const int r = add_distances(body, 1, threads, 1, distance, err);

    return r < 0 ? r : add_distances(body, 0, threads, -1, distance, err);
}

/* One axis of an interpolation: the cell before and how far beyond it. 0 outside the lattice. */
static int place(double um, double origin, double step, size_t n, size_t *ret_at, double *ret_t)
{
    const double x = (um - origin) / step;
    const double within = fmin(fmax(x, 0), (double)n - 1);
    const double first = fmin(floor(within), fmax((double)n - 2, 0));

    *ret_at = (size_t)first;
    *ret_t = within - first;
    return x > -0.5 - 1e-9 && x < (double)n - 0.5 + 1e-9;
}

/* Trilinear; NaN outside the lattice. */
static double distance_at(const struct gsn_lattice *at, const float *distance, struct gsn_vec3 u)
{
    size_t x, y, z;
    double tx, ty, tz, sum = 0;

    if (!place(u.x, at->origin_um.x, at->step_um.x, at->nx, &x, &tx) ||
        !place(u.y, at->origin_um.y, at->step_um.y, at->ny, &y, &ty) ||
        !place(u.z, at->origin_um.z, at->step_um.z, at->nz, &z, &tz))
        return NAN;
    for (size_t k = 0; k < 8; k++) {
        const double w = (k & 1 ? tx : 1 - tx) * (k & 2 ? ty : 1 - ty) * (k & 4 ? tz : 1 - tz);

        if (w > 0)
            sum += w * distance[gsn_lattice_index(at, x + (k & 1), y + (k >> 1 & 1), z + (k >> 2))];
    }
    return sum;
}

int gsn_tissue_band(const struct gsn_mask *body, double low_um, double high_um,
                    const struct gsn_lattice *at, unsigned threads, struct gsn_mask **ret_band,
                    struct gsn_error *err)
{
    gsn_auto_mem(float) distance = gsn_alloc_array(gsn_lattice_count(&body->at), sizeof *distance);
    gsn_auto(gsn_mask) band = NULL;
    int r;

    if (!distance)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the distance from a surface");
    if (gsn_mask_count(body) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the body to measure distances from is empty");
    r = signed_distance(body, threads, distance, err);
    if (r >= 0)
        r = gsn_mask_new(at, &band, err);
    if (r < 0)
        return r;
    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const double d = distance_at(&body->at, distance, gsn_lattice_centre(at, x, y, z));

                band->inside[i] = d >= low_um && d < high_um;
            }
    if (gsn_mask_count(band) == 0)
        return gsn_fail(err, GSN_E_INPUT, "no voxel lies %g to %g um from the surface of the body",
                        low_um, high_um);
    *ret_band = gsn_steal(&band);
    return GSN_OK;
}
