/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Stain vectors and the strength of a stain from a calibration panel.
 *
 *   1. Of a patch, cells far from its median (dust, scratches) are left out.
 *   2. The vector of a dye is the line through the origin of optical density from which its cells
 *      lie least away (total least squares; the first eigenvector of the moments, by power
 *      iteration).
 *   3. Its covariance is the scatter of cells, or of patches where they scatter by more (a
 * sandwich: blocks that know nothing of each other), with what all cells of a patch share: the
 * error of the white, colours that a file rounds block by block.
 *   4. Standards of known density: the gain is the line through the origin; what lies off it by 8 %
 *      is refused.
 *   5. Vectors of the panel against those that a slide infers: chi-square with two degrees of
 *      freedom.
 *
 * Fails with a sentence that names the patch: too pale, of mixed hues, in the wrong place, or no
 * patch of red or yellow at all. */
#include "pipeline/stain/calibration.h"

#include "pipeline/core/geom.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/stain/unmixing.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

/* Below it an error of the white of a thousandth turns a vector by half a degree. */
static const double PALEST_OD = 0.12;
/* Cells of one dye share a hue; noise and grain of a scan turn them by less than a degree. */
static const double UNEVEN_DEG = 3;
/* Another maker's dye or another rinse turns a vector by 5 degrees to a side, a mixture of red and
 * yellow in equal parts by 13. The dark dye may be another counterstain: haematoxylin is 28 off. */
static const double ASTRAY_DEG = 12;
/* Standards that do not follow a line: a patch is in the wrong place, or the scan is clipped. */
static const double BENT = 0.08;
/* Cells further from their patch's median than so many deviations are dust or a scratch. */
static const double STRAY = 5;
/* Chi-square with two degrees of freedom, one in a thousand. */
static const double DISAGREEING = 13.816;

static const char *const NAMES[] = { "red", "yellow", "dark" };

/* Degrees; of any lengths. */
static double angle_between(const double a[3], const double b[3])
{
    return acos(fmin(gsn_dot3(a, b) / sqrt(gsn_dot3(a, a) * gsn_dot3(b, b)), 1)) / GSN_RADIANS;
}

static double *vector_of(struct gsn_dyes *dyes, int dye)
{
    return dye == 0 ? dyes->red : dye == 1 ? dyes->yellow : dyes->dark;
}

/* ---- one patch --------------------------------------------------------------------------- */

static double median_of(const double *value, size_t count)
{
    double copy[GSN_PATCH_CELLS];

    memcpy(copy, value, count * sizeof *copy);
    return gsn_order_pick(copy, count, count / 2);
}

/* Marks the cells that dust or a scratch does not touch; returns how many. */
static size_t choose_cells(const struct gsn_patch *patch, int ret_kept[GSN_PATCH_CELLS])
{
    double centre[3], away[GSN_PATCH_CELLS], most;
    size_t count = 0;

    for (int c = 0; c < 3; c++) {
        for (int i = 0; i < GSN_PATCH_CELLS; i++)
            away[i] = patch->od[i][c];
        centre[c] = median_of(away, GSN_PATCH_CELLS);
    }
    for (int i = 0; i < GSN_PATCH_CELLS; i++)
        away[i] = hypot(hypot(patch->od[i][0] - centre[0], patch->od[i][1] - centre[1]),
                        patch->od[i][2] - centre[2]);
    most = STRAY * 1.4826 * median_of(away, GSN_PATCH_CELLS);
    for (int i = 0; i < GSN_PATCH_CELLS; i++)
        count += (size_t)(ret_kept[i] = away[i] <= most);
    return count;
}

static void mean_of(const struct gsn_patch *patch, double ret_mean[3])
{
    int kept[GSN_PATCH_CELLS];
    const size_t count = choose_cells(patch, kept);

    for (int c = 0; c < 3; c++) {
        ret_mean[c] = 0;
        for (int i = 0; i < GSN_PATCH_CELLS; i++)
            ret_mean[c] += kept[i] ? patch->od[i][c] / (double)count : 0;
    }
}

static int check_patch(const struct gsn_patch *patch, struct gsn_error *err)
{
    const char *name = NAMES[patch->kind];
    int kept[GSN_PATCH_CELLS];
    const size_t count = choose_cells(patch, kept);
    double mean[3], spread = 0;

    mean_of(patch, mean);
    if (!(sqrt(gsn_dot3(mean, mean)) >= PALEST_OD))
        return gsn_fail(err, GSN_E_STAIN,
                        "patch %u of row %u (%s) is too pale to have a hue (optical density %.2f, "
                        "at least %.2f is needed): stain it longer",
                        patch->place, patch->row, name, sqrt(gsn_dot3(mean, mean)), PALEST_OD);
    for (int i = 0; i < GSN_PATCH_CELLS; i++)
        if (kept[i])
            spread += angle_between(patch->od[i], mean) * angle_between(patch->od[i], mean);
    spread = sqrt(spread / (double)count);
    if (!(spread <= UNEVEN_DEG))
        return gsn_fail(err, GSN_E_STAIN,
                        "patch %u of row %u (%s) is of mixed hues (they differ by %.1f degrees): "
                        "it holds more than one dye, or dirt",
                        patch->place, patch->row, name, spread);
    return GSN_OK;
}

/* ---- one dye ----------------------------------------------------------------------------- */

/* The direction that leaves least of the moments across to it. They are all but those of one line,
 * so that multiplying settles at once. */
static void direction_of(const double moment[3][3], double ret[3])
{
    double v[3] = { 1, 1, 1 };

    for (int round = 0; round < 50; round++) {
        double next[3];

        for (int c = 0; c < 3; c++)
            next[c] = gsn_dot3(moment[c], v);
        for (int c = 0; c < 3; c++)
            v[c] = next[c] / sqrt(gsn_dot3(next, next));
    }
    for (int c = 0; c < 3; c++)
        ret[c] = fmax(v[c], 0);
}

/* The line through the origin from which all cells of a dye lie least away. */
static void fit_line(const struct gsn_patch *patches, size_t count, int dye, double ret[3])
{
    double moment[3][3] = { { 0 } };

    for (size_t p = 0; p < count; p++) {
        int kept[GSN_PATCH_CELLS];

        if ((int)patches[p].kind != dye)
            continue;
        (void)choose_cells(&patches[p], kept);
        for (int i = 0; i < GSN_PATCH_CELLS; i++)
            for (int a = 0; kept[i] && a < 3; a++)
                for (int b = 0; b < 3; b++)
                    moment[a][b] += patches[p].od[i][a] * patches[p].od[i][b];
    }
    direction_of(moment, ret);
}

/* What cells pull the vector by: sums of length times what lies across, of blocks that know nothing
 * of each other. The scatter of the blocks is the error, whatever the noise is like. */
struct pull {
    double along2;
    double cells[2][2], blocks[2][2]; /* sums of squares by cell, and by patch */
    double floor[2][2];               /* what all cells of a patch may be off by together */
    size_t count, patches;
};

static struct pull pull_of(const struct gsn_patch *patches, size_t count, int dye,
                           const double v[3])
{
    struct pull pull = { .count = 0 };
    double way[2][3];

    gsn_dyes_tangents(v, way);
    for (size_t p = 0; p < count; p++) {
        const double *floor_od = patches[p].floor_od;
        double block[2] = { 0 }, length = 0;
        int kept[GSN_PATCH_CELLS];

        if ((int)patches[p].kind != dye)
            continue;
        (void)choose_cells(&patches[p], kept);
        for (int i = 0; i < GSN_PATCH_CELLS; i++) {
            const double *od = patches[p].od[i], along = gsn_dot3(od, v);
            const double across[2] = { along * gsn_dot3(od, way[0]), along * gsn_dot3(od, way[1]) };

            if (!kept[i])
                continue;
            pull.count++;
            pull.along2 += along * along;
            length += along;
            for (int a = 0; a < 2; a++) {
                block[a] += across[a];
                for (int b = 0; b < 2; b++)
                    pull.cells[a][b] += across[a] * across[b];
            }
        }
        pull.patches++;
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++) {
                pull.blocks[a][b] += block[a] * block[b];
                for (int c = 0; c < 3; c++)
                    pull.floor[a][b] +=
                        length * length * way[a][c] * way[b][c] * floor_od[c] * floor_od[c];
            }
    }
    return pull;
}

static void covariance_of(const struct pull *pull, double ret[2][2])
{
    const double n = (double)pull->count, m = (double)pull->patches;
    const double square = pull->along2 * pull->along2;
    const double by_cells = (pull->cells[0][0] + pull->cells[1][1]) * n / (n - 1);
    const double by_patches = m > 1 ? (pull->blocks[0][0] + pull->blocks[1][1]) * m / (m - 1) : 0;

    for (int a = 0; a < 2; a++)
        for (int b = 0; b < 2; b++) {
            const double scatter = by_patches > by_cells ? pull->blocks[a][b] * m / (m - 1)
                                                         : pull->cells[a][b] * n / (n - 1);

            ret[a][b] = (scatter + pull->floor[a][b]) / square;
        }
}

/* Two patches of a dye, the strong and the weak, point the same way. */
static int check_agreement(const struct gsn_patch *patches, size_t count, int dye,
                           const double v[3], struct gsn_error *err)
{
    for (size_t p = 0; p < count; p++) {
        double mean[3];

        if ((int)patches[p].kind != dye)
            continue;
        mean_of(&patches[p], mean);
        if (angle_between(mean, v) > UNEVEN_DEG)
            return gsn_fail(err, GSN_E_STAIN,
                            "patch %u of row %u does not agree with the other patches of %s (they "
                            "are %.1f degrees apart): one of them is mixed",
                            patches[p].place, patches[p].row, NAMES[dye], angle_between(mean, v));
    }
    return GSN_OK;
}

static const struct gsn_patch *first_of(const struct gsn_patch *patches, size_t count, int dye)
{
    for (size_t p = 0; p < count; p++)
        if ((int)patches[p].kind == dye)
            return &patches[p];
    return NULL;
}

static int check_alike(const struct gsn_patch *const first[3], const struct gsn_dyes *dyes,
                       struct gsn_error *err)
{
    struct gsn_dyes copy = *dyes;

    for (int k = 0; k < 3; k++) {
        const int other = (k + 1) % 3;
        const double apart = angle_between(vector_of(&copy, k), vector_of(&copy, other));

        if (first[k] && first[other] && !(apart > GSN_DYES_APART_DEG))
            return gsn_fail(err, GSN_E_STAIN,
                            "the patches of %s and %s show one dye (they are %.1f degrees apart): "
                            "the same dye twice",
                            NAMES[k], NAMES[other], apart);
    }
    return GSN_OK;
}

static int check_place(const struct gsn_patch *patch, const struct gsn_dyes *expected,
                       const double v[3], struct gsn_error *err)
{
    struct gsn_dyes there = *expected;
    const double astray = angle_between(v, vector_of(&there, (int)patch->kind));
    int nearest = (int)patch->kind;

    for (int k = 0; k < 3; k++)
        if (angle_between(v, vector_of(&there, k)) < angle_between(v, vector_of(&there, nearest)))
            nearest = k;
    if (nearest != (int)patch->kind)
        return gsn_fail(err, GSN_E_STAIN,
                        "patch %u of row %u is stated to be %s but is nearer to %s: look at "
                        "the order of \"patches\" in job.json, or it is mixed",
                        patch->place, patch->row, NAMES[patch->kind], NAMES[nearest]);
    if (patch->kind != GSN_PATCH_DARK && astray > ASTRAY_DEG)
        return gsn_fail(err, GSN_E_STAIN,
                        "patch %u of row %u (%s) is %.1f degrees from where that dye is expected, "
                        "at most %.0f are allowed: it is mixed, or another dye",
                        patch->place, patch->row, NAMES[patch->kind], astray, ASTRAY_DEG);
    return GSN_OK;
}

static int check_dyes(const struct gsn_patch *patches, size_t count,
                      const struct gsn_dyes *expected, struct gsn_dyes *dyes, struct gsn_error *err)
{
    const struct gsn_patch *first[3];
    int r;

    for (int k = 0; k < 3; k++)
        first[k] = first_of(patches, count, k);
    r = check_alike(first, dyes, err);
    for (int k = 0; r >= 0 && k < 3; k++)
        if (first[k])
            r = check_agreement(patches, count, k, vector_of(dyes, k), err);
    for (int k = 0; r >= 0 && k < 3; k++)
        if (first[k])
            r = check_place(first[k], expected, vector_of(dyes, k), err);
    return r;
}

int gsn_calibration_dyes(const struct gsn_patch *patches, size_t count,
                         const struct gsn_dyes_prior *expected, struct gsn_dyes_fit *ret_fit,
                         struct gsn_error *err)
{
    struct gsn_dyes_fit fit = gsn_dyes_as_stated(expected);
    struct gsn_dyes before = expected->dyes;
    int r = GSN_OK;

    assert(patches || count == 0);

    for (int k = 0; k < 2; k++)
        if (!first_of(patches, count, k))
            return gsn_fail(err, GSN_E_STAIN, "it has no patch of %s alone", NAMES[k]);
    for (size_t p = 0; r >= 0 && p < count; p++)
        if (patches[p].kind != GSN_PATCH_STANDARD)
            r = check_patch(&patches[p], err);
    for (int k = 0; k < 3; k++)
        if (first_of(patches, count, k))
            fit_line(patches, count, k, vector_of(&fit.dyes, k));
    if (r >= 0)
        r = check_dyes(patches, count, &expected->dyes, &fit.dyes, err);
    if (r < 0)
        return r;
    for (int k = 0; k < 3; k++) {
        struct pull pull;
        double own[2][2];

        if (!first_of(patches, count, k))
            continue;
        pull = pull_of(patches, count, k, vector_of(&fit.dyes, k));
        covariance_of(&pull, own);
        for (int a = 0; a < 2; a++)
            for (int b = 0; b < 2; b++)
                fit.covariance[2 * k + a][2 * k + b] = own[a][b];
        fit.deviation_deg[k] = sqrt(own[0][0] + own[1][1]) / GSN_RADIANS;
        fit.moved_deg[k] = angle_between(vector_of(&before, k), vector_of(&fit.dyes, k));
        fit.pixels += pull.count;
    }
    (void)snprintf(fit.dyes.name, sizeof fit.dyes.name, "calibrated-1");
    *ret_fit = fit;
    return GSN_OK;
}

/* ---- strength ---------------------------------------------------------------------------- */

/* What a standard reads; 0 for a patch that is none. */
static int read_standard(const struct gsn_patch *patch, const struct gsn_dyes *dyes,
                         double *ret_red, struct gsn_error *err)
{
    double mean[3], amount[3];
    int r;

    *ret_red = 0;
    if (patch->kind != GSN_PATCH_STANDARD)
        return GSN_OK;
    mean_of(patch, mean);
    r = gsn_unmix_one(mean, dyes, amount, err);
    if (r >= 0)
        *ret_red = amount[0] / dyes->full_red_od;
    return r;
}

/* How far the standards lie from the line of this gain: the sum of squares, and the furthest. */
static int check_line(const struct gsn_patch *patches, const double *red, size_t count, double gain,
                      double *ret_off2, struct gsn_error *err)
{
    *ret_off2 = 0;
    for (size_t p = 0; p < count; p++) {
        const double off = red[p] - gain * patches[p].density;

        if (patches[p].kind != GSN_PATCH_STANDARD)
            continue;
        *ret_off2 += off * off;
        if (fabs(off) > BENT * gain)
            return gsn_fail(err, GSN_E_STAIN,
                            "its standards do not follow their densities: patch %u of row %u "
                            "(density %g) reads %.3f where the others put %.3f",
                            patches[p].place, patches[p].row, patches[p].density, red[p],
                            gain * patches[p].density);
    }
    return GSN_OK;
}

int gsn_calibration_gain(const struct gsn_patch *patches, size_t count, const struct gsn_dyes *dyes,
                         struct gsn_stain_gain *ret_gain, double *ret_zero, struct gsn_error *err)
{
    gsn_auto_mem(double) red = gsn_alloc_array(count + 1, sizeof *red);
    double squares = 0, products = 0, zeros = 0, floor2 = 0, off2;
    struct gsn_stain_gain gain = { 0 };
    unsigned empty = 0;
    int r = GSN_OK;

    if (!red)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the standards of a calibration panel");
    for (size_t p = 0; r >= 0 && p < count; p++) {
        r = read_standard(&patches[p], dyes, &red[p], err);
        if (patches[p].kind != GSN_PATCH_STANDARD)
            continue;
        gain.sections++;
        squares += patches[p].density * patches[p].density;
        products += patches[p].density * red[p];
        floor2 += patches[p].density * patches[p].density *
                  gsn_dot3(patches[p].floor_od, patches[p].floor_od) / 3;
        empty += patches[p].density <= 0;
        zeros += patches[p].density <= 0 ? red[p] : 0;
    }
    if (r < 0)
        return r;
    if (!(squares > 0 && products > 0))
        return gsn_fail(err, GSN_E_STAIN, "none of its standards holds collagen");
    gain.gain = products / squares;
    r = check_line(patches, red, count, gain.gain, &off2, err);
    if (r < 0)
        return r;
    /* Of the line, and of the white under it. */
    gain.error = gain.sections > 1 ? sqrt(off2 / (gain.sections - 1.0) / squares) : 0;
    gain.error = hypot(gain.error, sqrt(floor2) / squares / dyes->full_red_od);
    *ret_gain = gain;
    if (ret_zero)
        *ret_zero = empty > 0 ? zeros / empty : (double)NAN;
    return GSN_OK;
}

/* ---- against what a slide says ----------------------------------------------------------- */

struct gsn_dyes_apart gsn_dyes_compare(const struct gsn_dyes_fit *calibrated,
                                       const struct gsn_dyes_fit *inferred)
{
    struct gsn_dyes from = calibrated->dyes, to = inferred->dyes;
    struct gsn_dyes_apart apart = { 0 };

    for (int k = 0; k < 3; k++) {
        double way[2][3], d[2], c[2][2], det;

        gsn_dyes_tangents(vector_of(&from, k), way);
        for (int i = 0; i < 2; i++) {
            d[i] = gsn_dot3(vector_of(&to, k), way[i]);
            for (int j = 0; j < 2; j++)
                c[i][j] = calibrated->covariance[2 * k + i][2 * k + j] +
                          inferred->covariance[2 * k + i][2 * k + j];
        }
        det = c[0][0] * c[1][1] - c[0][1] * c[1][0];
        apart.deg[k] = angle_between(vector_of(&from, k), vector_of(&to, k));
        apart.expected[k] = sqrt(c[0][0] + c[1][1]) / GSN_RADIANS;
        apart.disagree[k] =
            c[1][1] * d[0] * d[0] - 2 * c[0][1] * d[0] * d[1] + c[0][0] * d[1] * d[1] >
            DISAGREEING * det;
    }
    return apart;
}
