/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: local quadratic regression with a Gaussian kernel, its volume above a threshold corrected
 * by linear SIMEX with wild sections.
 * References: Fan and Gijbels 1996, "Local Polynomial Modelling and Its Applications"; Cook and
 * Stefanski 1994, 10.1080/01621459.1994.10476871 (simulation and extrapolation); Wu 1986,
 * 10.1214/aos/1176350142 (wild bootstrap), here with one sign a section, since sections are the
 * independent draws of a stain's texture.
 *
 * Steps. 1. Holes (marrow, canals): where the lightly smoothed density is below half of that around
 * it, in pieces of 40 voxels or more; they hold no tissue above any threshold, and neither they nor
 * the voxels at their rim, which are partly hole, are fitted. 2. The kernel's width from a ladder,
 * by leave-one-section-out cross-validation, then half a step less: the error of prediction is flat
 * there and the bias of a volume is not. 3. The fit, which reproduces quadratic fields up to the
 * region's border, and V, the voxels above the threshold. 4. With n_i the fit of the residual
 * sections, each with a sign drawn for it, the estimate is 2 V(fit) - mean V(fit +- n_i): what
 * noise adds once more is what it has added. 5. The spread of that estimate over data made of the
 * fit and signed leave-own-section-out residuals (plain ones are too small: a section pulls the fit
 * to itself); beside it 0.15 of a voxel for where walls of what is above the threshold are. 6. What
 * the kernel blurs is seen by a kernel wider by the root of 2: at a wall the bias grows with the
 * width, so that it is 2.4 times (1 / (root of 2 - 1)) what the two estimates differ by, taken as
 * evenly spread; where density is smooth it grows with the fourth power and is less. Of kernels
 * from the chosen one down to one section, each threshold has the one whose interval is narrowest.
 *
 * Step 6 stands in place of a constant of 1 % that held on drawn blocks and failed on a real tooth
 * (computed tomography under a real grain: 0 of 4 intervals held; with it 34 of 34 in twelve draws,
 * of which three were in view when it was chosen, and 14 are withheld).
 *
 * A section's share in the fit of a voxel is linear in its data, so all wild sections cost one pass
 * over the kernel's sections. Moments are separable sums within a section.
 *
 * Failure: memory; everything that makes an interval untrue is said in `withheld`. */
#include "pipeline/measure/tissue_volume.h"

#include "pipeline/core/parallel.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum {
    TERMS = 10,         /* of a quadratic polynomial of three variables */
    PLANE_MOMENTS = 15, /* of degree 4 in the section */
    DATA_MOMENTS = 6,   /* of degree 2 */
    REPLICATES = 20,
    NESTED = 6, /* noises by which a replicate is corrected in its turn */
    RUNGS = 7,
    NARROWER = 4, /* kernels that are tried for a volume */
    LEAST_SECTIONS = 8,
    LEAST_HOLE = 40,       /* voxels */
    MOST_VOXELS = 1 << 22, /* of the box around the region */
    MOST_SECTIONS = 4096
};

static const double FIRST_SIGMA = 1, RUNG = M_SQRT2,
                    WIDER = M_SQRT2; /* of the kernel along z, in sections */
static const double XY_PER_Z = 1.25; /* noise is correlated within a section and not across */
static const double REACH = 3;       /* of the kernel, in sigma */
static const double LIGHT[2] = { 1.2, 0.6 },
                    COARSE[2] = { 9, 6 }; /* voxels in and across sections */
static const double WALL_VOXELS = 0.15, Z95 = 1.96, MOST_HALF_WIDTH = 0.10;
static const double MOST_CORRELATION = 0.1;
static const double ROUNDING = 1e-10; /* of squares: sums of floats err by some 1e-6 */

/* u^a v^b w^c of each term. */
static const uint8_t POWER[TERMS][3] = { { 0, 0, 0 }, { 1, 0, 0 }, { 0, 1, 0 }, { 0, 0, 1 },
                                         { 2, 0, 0 }, { 1, 1, 0 }, { 0, 2, 0 }, { 1, 0, 1 },
                                         { 0, 1, 1 }, { 0, 0, 2 } };

/* Where the moment u^a v^b lies in a list ordered by degree. */
static size_t place_moment(unsigned a, unsigned b)
{
    const unsigned degree = a + b;

    return degree * (degree + 1) / 2 + b;
}

struct work {
    struct gsn_lattice at; /* of the box around the region */
    size_t plane, voxels;
    uint8_t *counted; /* in the region, with data, no hole */
    uint8_t *fitted;  /* of these, not at the rim of a hole */
    uint8_t *hole;
    float *data;
    size_t count; /* counted voxels */
    uint32_t *voxel;
    double sigma[3];                  /* voxels */
    float *mask_moment, *data_moment; /* PLANE_MOMENTS and DATA_MOMENTS of voxels each */
    float (*weight)[TERMS], (*weight_without)[TERMS]; /* a counted voxel; without its own section */
    float *fit, *without;
    float *residual, *residual_without; /* of the box; 0 where nothing is fitted */
    float *scratch[2];
    unsigned threads;
};

static void work_done(struct work *w)
{
    gsn_free(w->counted);
    gsn_free(w->fitted);
    gsn_free(w->hole);
    gsn_free(w->data);
    gsn_free(w->voxel);
    gsn_free(w->mask_moment);
    gsn_free(w->data_moment);
    gsn_free(w->weight);
    gsn_free(w->weight_without);
    gsn_free(w->fit);
    gsn_free(w->without);
    gsn_free(w->residual);
    gsn_free(w->residual_without);
    gsn_free(w->scratch[0]);
    gsn_free(w->scratch[1]);
}

static int fail_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the volume of the tissue");
}

/* ---- sums along an axis -------------------------------------------------------------------- */

enum { MOST_REACH = 256 };

struct sums {
    const struct work *work;
    const float *in;
    float *out;
    int axis, reach;
    float kernel[2 * MOST_REACH + 1];
};

/* exp(-u^2 / 2) u^power at whole voxels. */
static void fill_kernel(struct sums *s, double sigma, unsigned power)
{
    s->reach = (int)fmin(ceil(REACH * sigma), MOST_REACH);
    for (int d = -s->reach; d <= s->reach; d++) {
        const double u = d / sigma;

        s->kernel[d + s->reach] = (float)(exp(-u * u / 2) * pow(u, power));
    }
}

static int sum_plane(size_t z, void *context, struct gsn_error *err)
{
    const struct sums *s = context;
    const struct gsn_lattice *at = &s->work->at;
    const size_t step = s->axis == 0 ? 1 : s->axis == 1 ? at->nx : s->work->plane;
    const long n = (long)(s->axis == 0 ? at->nx : s->axis == 1 ? at->ny : at->nz);

    (void)err;
    for (size_t y = 0; y < at->ny; y++) {
        const size_t row = z * s->work->plane + y * at->nx;
        float *out = s->out + row;

        memset(out, 0, at->nx * sizeof *out);
        for (long d = -s->reach; d <= s->reach; d++) {
            const float k = s->kernel[d + s->reach];
            const long p = (long)(s->axis == 1 ? y : z) + d;
            const float *in = s->in + (long)row + d * (long)step;
            long from = 0, to = (long)at->nx;

            if (s->axis == 0) {
                from = d < 0 ? -d : 0;
                to = d > 0 ? n - d : n;
            } else if (p < 0 || p >= n) {
                continue;
            }
            for (long x = from; x < to; x++)
                out[x] += k * in[x];
        }
    }
    return GSN_OK;
}

static int sum_along(const struct work *w, const float *in, float *out, int axis, double sigma,
                     unsigned power, struct gsn_error *err)
{
    struct sums s = { .work = w, .in = in, .out = out, .axis = axis };

    fill_kernel(&s, sigma, power);
    return gsn_parallel_for(w->at.nz, w->threads, sum_plane, &s, err);
}

/* All moments up to a degree of values within each section, into a list of place_moment(). */
static int sum_moments(struct work *w, const float *values, unsigned degree, float *ret_moment,
                       struct gsn_error *err)
{
    int r = GSN_OK;

    for (unsigned a = 0; r >= 0 && a <= degree; a++) {
        r = sum_along(w, values, w->scratch[0], 0, w->sigma[0], a, err);
        for (unsigned b = 0; r >= 0 && a + b <= degree; b++)
            r = sum_along(w, w->scratch[0], ret_moment + place_moment(a, b) * w->voxels, 1,
                          w->sigma[1], b, err);
    }
    return r;
}

/* ---- holes --------------------------------------------------------------------------------- */

/* values smoothed in place. */
static int smooth_box(struct work *w, float *values, const double sigma[2], struct gsn_error *err)
{
    int r = sum_along(w, values, w->scratch[0], 0, sigma[0], 0, err);

    if (r >= 0)
        r = sum_along(w, w->scratch[0], w->scratch[1], 1, sigma[0], 0, err);
    return r < 0 ? r : sum_along(w, w->scratch[1], values, 2, sigma[1], 0, err);
}

/* Takes back the pieces of fewer than LEAST_HOLE voxels (six neighbours). list, seen: room. */
static void drop_small_holes(struct work *w, uint32_t *list, uint8_t *seen)
{
    const struct gsn_lattice *at = &w->at;

    for (size_t i = 0; i < w->voxels; i++) {
        size_t count = 0;

        if (!w->hole[i] || seen[i])
            continue;
        list[count++] = (uint32_t)i;
        seen[i] = 1;
        for (size_t next = 0; next < count; next++) {
            const size_t j = list[next], x = j % at->nx, y = j / at->nx % at->ny, z = j / w->plane;
            const struct {
                int there;
                size_t voxel;
            } beside[6] = { { x > 0, j - 1 },        { x + 1 < at->nx, j + 1 },
                            { y > 0, j - at->nx },   { y + 1 < at->ny, j + at->nx },
                            { z > 0, j - w->plane }, { z + 1 < at->nz, j + w->plane } };

            for (int k = 0; k < 6; k++)
                if (beside[k].there && w->hole[beside[k].voxel] && !seen[beside[k].voxel]) {
                    seen[beside[k].voxel] = 1;
                    list[count++] = (uint32_t)beside[k].voxel;
                }
        }
        for (size_t k = 0; count < LEAST_HOLE && k < count; k++)
            w->hole[list[k]] = 0;
    }
}

/* Voxels that share a face or, within the section, an edge's length of one with a hole. */
static int is_at_rim(const struct work *w, size_t i)
{
    const struct gsn_lattice *at = &w->at;
    const size_t x = i % at->nx, y = i / at->nx % at->ny;

    return (x > 0 && w->hole[i - 1]) || (x + 1 < at->nx && w->hole[i + 1]) ||
           (y > 0 && w->hole[i - at->nx]) || (y + 1 < at->ny && w->hole[i + at->nx]);
}

static int find_holes(struct work *w, struct gsn_error *err)
{
    gsn_auto_mem(float) smooth = gsn_alloc_array(4 * w->voxels, sizeof *smooth);
    gsn_auto_mem(uint32_t) list = gsn_alloc_array(w->voxels, sizeof *list);
    gsn_auto_mem(uint8_t) seen = gsn_alloc_array(w->voxels, 1);
    float *part[4];
    int r = GSN_OK;

    if (!smooth || !list || !seen)
        return fail_memory(err);
    for (int k = 0; k < 4; k++) {
        part[k] = smooth + (size_t)k * w->voxels;
        for (size_t i = 0; i < w->voxels; i++)
            part[k][i] = k % 2 ? (float)w->counted[i] : w->data[i];
    }
    for (int k = 0; r >= 0 && k < 4; k++)
        r = smooth_box(w, part[k], k < 2 ? LIGHT : COARSE, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < w->voxels; i++)
        w->hole[i] = w->counted[i] && part[0][i] / part[1][i] < part[2][i] / part[3][i] / 2;
    drop_small_holes(w, list, seen);
    for (size_t i = 0; i < w->voxels; i++)
        w->counted[i] = w->counted[i] && !w->hole[i];
    for (size_t i = 0; i < w->voxels; i++)
        w->fitted[i] = w->counted[i] && !is_at_rim(w, i);
    return GSN_OK;
}

/* ---- the fit ------------------------------------------------------------------------------- */

/* First row of the inverse of a positive definite matrix: the weights of the value at the middle.
 * 0 when the samples do not carry a quadratic polynomial. */
static int solve_weights(double m[TERMS][TERMS], float ret_weight[TERMS])
{
    double l[TERMS][TERMS], y[TERMS], x[TERMS];

    for (int i = 0; i < TERMS; i++)
        for (int j = 0; j <= i; j++) {
            double s = i == j ? m[i][j] * (1 + 1e-9) : m[i][j];

            for (int k = 0; k < j; k++)
                s -= l[i][k] * l[j][k];
            if (i == j && !(s > 1e-12 * m[0][0]))
                return 0;
            l[i][j] = i == j ? sqrt(s) : s / l[j][j];
        }
    for (int i = 0; i < TERMS; i++) {
        y[i] = i == 0;
        for (int k = 0; k < i; k++)
            y[i] -= l[i][k] * y[k];
        y[i] /= l[i][i];
    }
    for (int i = TERMS - 1; i >= 0; i--) {
        x[i] = y[i];
        for (int k = i + 1; k < TERMS; k++)
            x[i] -= l[k][i] * x[k];
        x[i] /= l[i][i];
        ret_weight[i] = (float)x[i];
    }
    return 1;
}

/* Sections of the kernel around one: first and last. */
static void find_sections(const struct work *w, size_t z, size_t *ret_first, size_t *ret_last)
{
    const size_t reach = (size_t)ceil(REACH * w->sigma[2]);

    *ret_first = z > reach ? z - reach : 0;
    *ret_last = z + reach < w->at.nz ? z + reach : w->at.nz - 1;
}

/* One counted voxel's weights, with and without its own section; too few samples: the mean, NaN. */
static void find_weights(struct work *w, size_t n)
{
    const size_t i = w->voxel[n], z = i / w->plane;
    double moment[5][5][5] = { { { 0 } } }, m[TERMS][TERMS], without[TERMS][TERMS];
    size_t first, last;

    find_sections(w, z, &first, &last);
    for (size_t k = first; k <= last; k++) {
        const double u = ((double)k - (double)z) / w->sigma[2];
        const float *at = w->mask_moment + i % w->plane + k * w->plane;
        double power = exp(-u * u / 2);

        for (unsigned c = 0; c <= 4; c++, power *= u)
            for (unsigned a = 0; a + c <= 4; a++)
                for (unsigned b = 0; a + b + c <= 4; b++)
                    moment[a][b][c] += power * (double)at[place_moment(a, b) * w->voxels];
    }
    for (int p = 0; p < TERMS; p++)
        for (int q = 0; q < TERMS; q++) {
            const unsigned a = POWER[p][0] + POWER[q][0], b = POWER[p][1] + POWER[q][1],
                           c = POWER[p][2] + POWER[q][2];

            m[p][q] = moment[a][b][c];
            without[p][q] =
                m[p][q] - (c ? 0 : (double)w->mask_moment[place_moment(a, b) * w->voxels + i]);
        }
    if (!solve_weights(m, w->weight[n])) {
        memset(w->weight[n], 0, sizeof w->weight[n]);
        w->weight[n][0] = m[0][0] > 0 ? (float)(1 / m[0][0]) : 0;
    }
    if (!solve_weights(without, w->weight_without[n]))
        for (int p = 0; p < TERMS; p++)
            w->weight_without[n][p] = NAN;
}

/* What one section, k sections on, adds to a fit by these weights, of the data whose moments are
 * given. */
static double add_section(const struct work *w, const float weight[TERMS], const float *moment,
                          size_t i, size_t k)
{
    const double u = ((double)k - (double)(i / w->plane)) / w->sigma[2];
    const float *at = moment + i % w->plane + k * w->plane;
    const double power[3] = { 1, u, u * u };
    double sum = 0;

    for (int p = 0; p < TERMS; p++)
        sum += (double)weight[p] * power[POWER[p][2]] *
               (double)at[place_moment(POWER[p][0], POWER[p][1]) * w->voxels];
    return exp(-u * u / 2) * sum;
}

enum { BATCH = 4096 };

static int fit_batch(size_t batch, void *context, struct gsn_error *err)
{
    struct work *w = context;
    const size_t end = (batch + 1) * BATCH < w->count ? (batch + 1) * BATCH : w->count;

    (void)err;
    for (size_t n = batch * BATCH; n < end; n++) {
        const size_t i = w->voxel[n];
        double fit = 0, without = 0;
        size_t first, last;

        find_weights(w, n);
        find_sections(w, i / w->plane, &first, &last);
        for (size_t k = first; k <= last; k++) {
            fit += add_section(w, w->weight[n], w->data_moment, i, k);
            if (k != i / w->plane)
                without += add_section(w, w->weight_without[n], w->data_moment, i, k);
        }
        w->fit[n] = (float)fit;
        w->without[n] = (float)without;
    }
    return GSN_OK;
}

/* Fits with a kernel of so many sections; ret_rms: of what a section is from the fit without it. */
static int fit_with(struct work *w, double sections, double *ret_rms, struct gsn_error *err)
{
    const double sigma_um = sections * w->at.step_um.z;
    gsn_auto_mem(float) values = gsn_alloc_array(w->voxels, sizeof *values);
    double sum = 0;
    size_t samples = 0;
    int r;

    if (!values)
        return fail_memory(err);
    w->sigma[0] = XY_PER_Z * sigma_um / w->at.step_um.x;
    w->sigma[1] = XY_PER_Z * sigma_um / w->at.step_um.y;
    w->sigma[2] = sections;
    for (size_t i = 0; i < w->voxels; i++)
        values[i] = w->fitted[i];
    r = sum_moments(w, values, 4, w->mask_moment, err);
    for (size_t i = 0; i < w->voxels; i++)
        values[i] = w->fitted[i] ? w->data[i] : 0;
    if (r >= 0)
        r = sum_moments(w, values, 2, w->data_moment, err);
    if (r >= 0)
        r = gsn_parallel_for((w->count + BATCH - 1) / BATCH, w->threads, fit_batch, w, err);
    if (r < 0)
        return r;
    for (size_t n = 0; n < w->count; n++) {
        const size_t i = w->voxel[n];
        const double plain = (double)w->data[i] - (double)w->fit[n];
        const double apart = (double)w->data[i] - (double)w->without[n];

        if (!w->fitted[i])
            continue;
        w->residual[i] = (float)plain;
        w->residual_without[i] = (float)(isfinite(apart) ? apart : plain);
        sum += isfinite(apart) ? apart * apart : 0;
        samples += isfinite(apart) ? 1 : 0;
    }
    *ret_rms = samples ? sqrt(sum / (double)samples) : INFINITY;
    return GSN_OK;
}

static int choose_kernel(struct work *w, double *ret_sections, struct gsn_error *err)
{
    double best = INFINITY, chosen = FIRST_SIGMA, rms;
    int r = GSN_OK;

    for (int k = 0; r >= 0 && k < RUNGS; k++) {
        r = fit_with(w, FIRST_SIGMA * pow(RUNG, k), &rms, err);
        if (r >= 0 && !(rms < best))
            break;
        best = rms;
        chosen = FIRST_SIGMA * pow(RUNG, k);
    }
    if (r >= 0)
        *ret_sections = chosen / sqrt(RUNG);
    return r;
}

/* Correlation of the residuals of neighbouring sections; 0 where they are but rounding. */
static double correlate_neighbours(const struct work *w)
{
    double cross = 0, square[2] = { 0 }, data = 0;

    for (size_t i = 0; i + w->plane < w->voxels; i++)
        if (w->fitted[i] && w->fitted[i + w->plane]) {
            const double a = (double)w->residual_without[i],
                         b = (double)w->residual_without[i + w->plane];

            cross += a * b;
            data += (double)w->data[i] * (double)w->data[i];
            square[0] += a * a;
            square[1] += b * b;
        }
    return square[0] > ROUNDING * data && square[1] > ROUNDING * data
               ? cross / sqrt(square[0] * square[1])
               : 0;
}

/* ---- volumes ------------------------------------------------------------------------------- */

/* Voxels above each threshold: of the fit; of these at a wall; of the fit and each noise, twice; of
 * each replicate; of each replicate and each of its noises, twice. */
struct counts {
    uint64_t fit, wall, noisy, replicate[REPLICATES], nested[REPLICATES];
};

struct volumes {
    const struct work *work;
    const float *residual_moment, *without_moment;
    const double *threshold;
    size_t thresholds;
    int8_t *sign;          /* REPLICATES by section */
    struct counts *counts; /* of each batch, by threshold */
};

/* +1 or -1, the same in every run (splitmix64). */
static int8_t draw_sign(uint64_t n)
{
    uint64_t x = (n + 1) * 0x9e3779b97f4a7c15u;

    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return (x ^ x >> 31) & 1 ? 1 : -1;
}

static void count_voxel(double fit, const double plain[REPLICATES], const double apart[REPLICATES],
                        double threshold, struct counts *c)
{
    c->fit += fit > threshold;
    for (int q = 0; q < REPLICATES; q++) {
        const double replicate = fit + apart[q];

        c->noisy += (uint64_t)(fit + plain[q] > threshold) + (fit - plain[q] > threshold);
        c->replicate[q] += replicate > threshold;
        for (int k = 1; k <= NESTED; k++) {
            const double noise = plain[(q + k) % REPLICATES];

            c->nested[q] +=
                (uint64_t)(replicate + noise > threshold) + (replicate - noise > threshold);
        }
    }
}

/* Whether a counted voxel has one beside it in its section that is none. */
static int is_at_wall(const struct work *w, size_t i)
{
    const struct gsn_lattice *at = &w->at;
    const size_t x = i % at->nx, y = i / at->nx % at->ny;

    return x == 0 || !w->counted[i - 1] || x + 1 == at->nx || !w->counted[i + 1] || y == 0 ||
           !w->counted[i - at->nx] || y + 1 == at->ny || !w->counted[i + at->nx];
}

static int count_batch(size_t batch, void *context, struct gsn_error *err)
{
    const struct volumes *v = context;
    const struct work *w = v->work;
    const size_t end = (batch + 1) * BATCH < w->count ? (batch + 1) * BATCH : w->count;

    (void)err;
    for (size_t n = batch * BATCH; n < end; n++) {
        double plain[REPLICATES] = { 0 }, apart[REPLICATES] = { 0 };
        size_t first, last;

        find_sections(w, w->voxel[n] / w->plane, &first, &last);
        for (size_t k = first; k <= last; k++) {
            const double a = add_section(w, w->weight[n], v->residual_moment, w->voxel[n], k);
            const double b = add_section(w, w->weight[n], v->without_moment, w->voxel[n], k);

            for (size_t q = 0; q < REPLICATES; q++) {
                const int8_t sign = v->sign[q * w->at.nz + k];

                plain[q] += sign * a;
                apart[q] += sign * b;
            }
        }
        for (size_t t = 0; t < v->thresholds; t++) {
            v->counts[batch * v->thresholds + t].wall +=
                (double)w->fit[n] > v->threshold[t] && is_at_wall(w, w->voxel[n]);
            count_voxel((double)w->fit[n], plain, apart, v->threshold[t],
                        &v->counts[batch * v->thresholds + t]);
        }
    }
    return GSN_OK;
}

static double correct_count(const struct counts *c)
{
    return 2 * (double)c->fit - (double)c->noisy / (2 * REPLICATES);
}

/* wider: what the kernel wider by WIDER gives. */
static struct gsn_tissue_volume estimate_volume(const struct counts *c, double wider,
                                                double threshold, double voxel_um3)
{
    const double estimate = correct_count(c), blur = (wider - estimate) / (WIDER - 1);
    double sum = 0, squares = 0, variance, half;

    for (int q = 0; q < REPLICATES; q++) {
        const double e = 2 * (double)c->replicate[q] - (double)c->nested[q] / (2 * NESTED);

        sum += e;
        squares += e * e;
    }
    variance = fmax(0, (squares - sum * sum / REPLICATES) / (REPLICATES - 1));
    half = Z95 * sqrt(variance + pow(WALL_VOXELS * (double)c->wall, 2) + pow(blur, 2) / 3);
    return (struct gsn_tissue_volume){ threshold, voxel_um3 * estimate,
                                       voxel_um3 * fmax(0, estimate - half),
                                       voxel_um3 * (estimate + half) };
}

/* The counts of the fit as it is, by threshold. */
static int count_volumes(struct work *w, const double *thresholds, size_t count,
                         struct counts *ret_all, struct gsn_error *err)
{
    const size_t batches = (w->count + BATCH - 1) / BATCH;
    const size_t moments = DATA_MOMENTS * w->voxels;
    gsn_auto_mem(float) moment = gsn_alloc_array(moments, sizeof *moment);
    gsn_auto_mem(int8_t) sign = gsn_alloc_array(REPLICATES, w->at.nz);
    gsn_auto_mem(struct counts) counts = gsn_alloc_array(batches * count, sizeof *counts);
    struct volumes v = { .work = w,
                         .residual_moment = w->data_moment,
                         .without_moment = moment,
                         .threshold = thresholds,
                         .thresholds = count,
                         .sign = sign,
                         .counts = counts };
    int r;

    if (!moment || !sign || !counts)
        return fail_memory(err);
    for (size_t i = 0; i < REPLICATES * w->at.nz; i++)
        sign[i] = draw_sign(i);
    r = sum_moments(w, w->residual, 2, w->data_moment, err);
    if (r >= 0)
        r = sum_moments(w, w->residual_without, 2, moment, err);
    if (r >= 0)
        r = gsn_parallel_for(batches, w->threads, count_batch, &v, err);
    if (r < 0)
        return r;
    memset(ret_all, 0, count * sizeof *ret_all);
    for (size_t t = 0; t < count; t++)
        for (size_t b = 0; b < batches; b++) {
            const struct counts *c = &counts[b * count + t];

            ret_all[t].fit += c->fit;
            ret_all[t].wall += c->wall;
            ret_all[t].noisy += c->noisy;
            for (int q = 0; q < REPLICATES; q++) {
                ret_all[t].replicate[q] += c->replicate[q];
                ret_all[t].nested[q] += c->nested[q];
            }
        }
    return GSN_OK;
}

/* Each threshold's volume by the kernel, of those from the given one down, whose interval is
 * narrowest. */
static int estimate_volumes(struct work *w, double sections, const double *thresholds, size_t count,
                            struct gsn_tissue_volume *ret_volume, struct gsn_error *err)
{
    struct counts wider[GSN_TISSUE_VOLUME_MOST_THRESHOLDS],
        counts[GSN_TISSUE_VOLUME_MOST_THRESHOLDS];
    double half[GSN_TISSUE_VOLUME_MOST_THRESHOLDS], rms;
    int r = fit_with(w, WIDER * sections, &rms, err);

    if (r >= 0)
        r = count_volumes(w, thresholds, count, wider, err);
    for (size_t t = 0; t < count; t++)
        half[t] = INFINITY;
    for (int k = 0; r >= 0 && k < NARROWER && (k == 0 || sections >= FIRST_SIGMA); k++) {
        r = fit_with(w, sections, &rms, err);
        if (r >= 0)
            r = count_volumes(w, thresholds, count, counts, err);
        for (size_t t = 0; r >= 0 && t < count; t++) {
            const struct gsn_tissue_volume v = estimate_volume(
                &counts[t], correct_count(&wider[t]), thresholds[t], gsn_lattice_voxel_um3(&w->at));

            if (v.upper_um3 - v.estimate_um3 < half[t]) {
                half[t] = v.upper_um3 - v.estimate_um3;
                ret_volume[t] = v;
            }
            wider[t] = counts[t];
        }
        sections /= WIDER;
    }
    for (size_t t = 0; r >= 0 && t < count; t++)
        if (!(half[t] <= MOST_HALF_WIDTH * ret_volume[t].estimate_um3))
            ret_volume[t] = (struct gsn_tissue_volume){ thresholds[t], NAN, NAN, NAN };
    return r;
}

/* No tissue of the region is larger than the region. */
static void bound_by_region(const struct gsn_mask *region, struct gsn_tissue_volume *v)
{
    const double most = (double)gsn_mask_count(region) * gsn_lattice_voxel_um3(&region->at);

    if (v->upper_um3 > most) {
        v->upper_um3 = most;
        v->estimate_um3 = fmin(v->estimate_um3, most);
        v->lower_um3 = fmin(v->lower_um3, most);
    }
}

/* ---- the whole ----------------------------------------------------------------------------- */

/* The box of the grid around its voxels in the region; 0: there are none. */
static int find_box(const struct gsn_grid *grid, const struct gsn_mask *region, size_t low[3],
                    size_t high[3])
{
    const struct gsn_lattice *at = &grid->at;
    const size_t size[3] = { at->nx, at->ny, at->nz };

    for (int c = 0; c < 3; c++) {
        low[c] = size[c];
        high[c] = 0;
    }
    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++) {
                const size_t place[3] = { x, y, z };

                if (!gsn_mask_has(region, gsn_lattice_centre(at, x, y, z)))
                    continue;
                for (int c = 0; c < 3; c++) {
                    low[c] = place[c] < low[c] ? place[c] : low[c];
                    high[c] = place[c] + 1 > high[c] ? place[c] + 1 : high[c];
                }
            }
    return high[0] > 0;
}

static int make_room(struct work *w, struct gsn_error *err)
{
    w->counted = gsn_alloc_array(w->voxels, 1);
    w->fitted = gsn_alloc_array(w->voxels, 1);
    w->hole = gsn_alloc_array(w->voxels, 1);
    w->data = gsn_alloc_array(w->voxels, sizeof *w->data);
    w->voxel = gsn_alloc_array(w->voxels, sizeof *w->voxel);
    w->mask_moment = gsn_alloc_array(w->voxels, PLANE_MOMENTS * sizeof *w->mask_moment);
    w->data_moment = gsn_alloc_array(w->voxels, DATA_MOMENTS * sizeof *w->data_moment);
    w->residual = gsn_alloc_array(w->voxels, sizeof *w->residual);
    w->residual_without = gsn_alloc_array(w->voxels, sizeof *w->residual_without);
    w->scratch[0] = gsn_alloc_array(w->voxels, sizeof *w->scratch[0]);
    w->scratch[1] = gsn_alloc_array(w->voxels, sizeof *w->scratch[1]);
    return w->counted && w->fitted && w->hole && w->data && w->voxel && w->mask_moment &&
                   w->data_moment && w->residual && w->residual_without && w->scratch[0] &&
                   w->scratch[1]
               ? GSN_OK
               : fail_memory(err);
}

static void gather_voxels(struct work *w, const struct gsn_grid *grid,
                          const struct gsn_mask *region, const size_t low[3])
{
    for (size_t i = 0; i < w->voxels; i++) {
        const size_t x = low[0] + i % w->at.nx, y = low[1] + i / w->at.nx % w->at.ny,
                     z = low[2] + i / w->plane;
        const float value = grid->value[gsn_lattice_index(&grid->at, x, y, z)];

        w->counted[i] =
            isfinite(value) && gsn_mask_has(region, gsn_lattice_centre(&grid->at, x, y, z));
        w->data[i] = w->counted[i] ? value : 0;
    }
}

static int estimate_all(struct work *w, const double *thresholds, size_t count,
                        struct gsn_tissue_volumes *ret, struct gsn_error *err)
{
    size_t holes = 0;
    double sections, rms;
    int r = find_holes(w, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < w->voxels; i++) {
        holes += w->hole[i];
        if (w->counted[i])
            w->voxel[w->count++] = (uint32_t)i;
    }
    w->weight = gsn_alloc_array(w->count, sizeof *w->weight);
    w->weight_without = gsn_alloc_array(w->count, sizeof *w->weight_without);
    w->fit = gsn_alloc_array(w->count, sizeof *w->fit);
    w->without = gsn_alloc_array(w->count, sizeof *w->without);
    if (!w->weight || !w->weight_without || !w->fit || !w->without)
        return fail_memory(err);
    r = choose_kernel(w, &sections, err);
    if (r >= 0)
        r = fit_with(w, sections, &rms, err);
    if (r < 0)
        return r;
    ret->sigma_xy_um = w->sigma[0] * w->at.step_um.x;
    ret->sigma_z_um = w->sigma[2] * w->at.step_um.z;
    ret->neighbours = correlate_neighbours(w);
    ret->wall_share = (double)holes / (double)(holes + w->count);
    if (ret->neighbours > MOST_CORRELATION) {
        ret->withheld = "what the sections leave beside a smooth density goes on from one to the "
                        "next, so that it is no noise";
        return GSN_OK;
    }
    return estimate_volumes(w, sections, thresholds, count, ret->volume, err);
}

int gsn_tissue_volumes(const struct gsn_grid *grid, const struct gsn_mask *region,
                       const double *thresholds, size_t count, unsigned threads,
                       struct gsn_tissue_volumes *ret_volumes, struct gsn_error *err)
{
    struct work w __attribute__((cleanup(work_done))) = { .threads = threads };
    struct gsn_tissue_volumes ret = { .sigma_xy_um = NAN, .sigma_z_um = NAN, .neighbours = NAN };
    size_t low[3], high[3];
    int r = GSN_OK;

    assert(count <= GSN_TISSUE_VOLUME_MOST_THRESHOLDS && ret_volumes);

    for (size_t t = 0; t < count; t++)
        ret.volume[t] = (struct gsn_tissue_volume){ thresholds[t], NAN, NAN, NAN };
    if (!find_box(grid, region, low, high)) {
        ret.withheld = "no voxel lies in the region";
    } else if (high[2] - low[2] < LEAST_SECTIONS) {
        ret.withheld = "fewer than 8 sections cross the region";
    } else if ((double)(high[0] - low[0]) * (double)(high[1] - low[1]) *
                       (double)(high[2] - low[2]) >
                   MOST_VOXELS ||
               high[2] - low[2] > MOST_SECTIONS) {
        ret.withheld = "the region has too many voxels for it";
    } else {
        w.at = (struct gsn_lattice){ .nx = high[0] - low[0],
                                     .ny = high[1] - low[1],
                                     .nz = high[2] - low[2],
                                     .origin_um =
                                         gsn_lattice_centre(&grid->at, low[0], low[1], low[2]),
                                     .step_um = grid->at.step_um };
        w.plane = w.at.nx * w.at.ny;
        w.voxels = w.plane * w.at.nz;
        r = make_room(&w, err);
        if (r >= 0) {
            gather_voxels(&w, grid, region, low);
            r = estimate_all(&w, thresholds, count, &ret, err);
        }
    }
    if (r < 0)
        return r;
    for (size_t t = 0; t < count; t++)
        bound_by_region(region, &ret.volume[t]);
    *ret_volumes = ret;
    return GSN_OK;
}
