/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/register/median.h"

#include <math.h>
#include <string.h>

/* A patch is compared at all shifts up to REACH, as two mounts of a section
 * are warped each in its own way. A patch of 16 is half a millimetre: small enough to be shifted as
 * a whole, large enough that chance agrees by a fifth at most shifts. */
enum { PATCH = 16, REACH = 5, SHIFTS = 2 * REACH + 1, WINDOW = PATCH + 2 * REACH };
/* Whole vectors. */
enum { ROW = 12 };
/* What is finer than this is texture. */
enum { SMOOTHINGS = 2 };
/* With fewer than LEAST_PATCHES the median says little. A first look takes about FIRST_LOOK patches
 * of the whole plane; those on tissue tell nearly all pairs. */
enum { LEAST_PATCHES = 9, FIRST_LOOK = 10, LEAST_OF_FIRST = 5, MOST_PATCHES = 4096 };

/* Two mounts share this much of their texture at least, and this much more than neighbours of this
 * stack do, in standard deviations of what neighbours share. */
static const double SAME = 0.38, SAME_DEVIATIONS = 8;
/* What two mounts of a section share under a good scanner. Where the limit is above, neighbours
 * share so much that nothing could tell a section that is there twice. */
static const double TWO_MOUNTS = 0.6;
/* A pair whose first look is below this part of the limit is not looked at again. */
static const double FAR_BELOW = 0.7;
/* Median absolute deviation to standard deviation of normal numbers. */
static const double MAD_TO_SD = 1.4826;
/* Of the plane's mean over what is not glass: below it is no tissue. */
static const double TISSUE = 0.1;
/* Edges of the anatomy are clipped to this many standard deviations: neighbours share them. */
static const double CLIP = 3;
/* Share of a patch that must be tissue; of the window around it in the other section. */
static const double FULL = 0.8, FULL_WINDOW = 0.5;

typedef float four __attribute__((vector_size(16)));

struct texture {
    size_t n, columns, rows;
    float *value;  /* n planes; 0 beside the tissue */
    double *share; /* of patches: scratch */
    float *smooth; /* one plane each: scratch */
    float *weight;
    double *spread;
};

/* ---- what a section has finer than its anatomy --------------------------------------------- */

/* Below this a cell is glass, or so poor in dye that its noise is all there is. */
static double least_tissue(const float *density, size_t cells)
{
    double sum = 0, count = 0;

    for (size_t c = 0; c < cells; c++)
        if (density[c] > 0) {
            sum += (double)density[c];
            count++;
        }
    return count > 0 ? TISSUE * sum / count : INFINITY;
}

/* The difference to the plane's own smooth part, in robust standard deviations. */
static void fill(struct texture *t, const float *density, float *ret_value)
{
    const size_t cells = t->columns * t->rows;
    const float least = (float)least_tissue(density, cells);
    size_t count = 0;
    double sd;

    for (size_t c = 0; c < cells; c++) {
        t->weight[c] = isnan(density[c]) ? 0.0f : 1.0f;
        t->smooth[c] = isnan(density[c]) ? 0 : density[c];
    }
    gsn_sequence_smooth(t->smooth, t->columns, t->rows, SMOOTHINGS);
    gsn_sequence_smooth(t->weight, t->columns, t->rows, SMOOTHINGS);
    for (size_t c = 0; c < cells; c++) {
        ret_value[c] = density[c] > least ? density[c] - t->smooth[c] / t->weight[c] : 0;
        if (density[c] > least)
            t->spread[count++] = fabs((double)ret_value[c]);
    }
    sd = count ? MAD_TO_SD * gsn_median(t->spread, count) : 0;
    for (size_t c = 0; c < cells; c++)
        ret_value[c] = sd > 0 ? (float)fmax(-CLIP, fmin((double)ret_value[c] / sd, CLIP)) : 0;
}

/* ---- how much of it two sections share ----------------------------------------------------- */

static double share_of_tissue(const struct texture *t, const float *corner, size_t side)
{
    size_t count = 0;

    for (size_t y = 0; y < side; y++)
        for (size_t x = 0; x < side; x++)
            count += corner[y * t->columns + x] != 0;
    return (double)count / (double)(side * side);
}

/* Sums of squares over every patch of a window. */
static void energies(const struct texture *t, const float *window,
                     double ret_energy[SHIFTS][SHIFTS])
{
    double sum[WINDOW + 1][WINDOW + 1] = { { 0 } };

    for (int y = 0; y < WINDOW; y++)
        for (int x = 0; x < WINDOW; x++) {
            const double v = (double)window[(size_t)y * t->columns + (size_t)x];

            sum[y + 1][x + 1] = sum[y][x + 1] + sum[y + 1][x] - sum[y][x] + v * v;
        }
    for (int v = 0; v < SHIFTS; v++)
        for (int u = 0; u < SHIFTS; u++)
            ret_energy[v][u] =
                sum[v + PATCH][u + PATCH] - sum[v][u + PATCH] - sum[v + PATCH][u] + sum[v][u];
}

/* A line of a patch times a row of the window, at ROW shifts. Written with vectors, as this is
 * where the time goes and the compiler would turn the loops inside out. */
static void add_products(const float line[PATCH], const float row[PATCH + ROW],
                         float ret_product[ROW])
{
    four sum[ROW / 4];

    memcpy(sum, ret_product, sizeof sum);
    for (int x = 0; x < PATCH; x++)
        for (int k = 0; k < ROW / 4; k++) {
            four at;

            memcpy(&at, row + x + 4 * k, sizeof at);
            sum[k] += line[x] * at;
        }
    memcpy(ret_product, sum, sizeof sum);
}

/* Products of a patch with every patch of a window. */
static void products(const struct texture *t, const float *patch, const float *window,
                     float ret_product[SHIFTS][ROW])
{
    float row[WINDOW + ROW] = { 0 };

    memset(ret_product, 0, SHIFTS * sizeof *ret_product);
    for (int w = 0; w < WINDOW; w++) {
        memcpy(row, window + (size_t)w * t->columns, WINDOW * sizeof *row);
        for (int v = w < PATCH ? 0 : w - PATCH + 1; v < SHIFTS && v <= w; v++) {
            const float *line = patch + (size_t)(w - v) * t->columns;

            add_products(line, row, ret_product[v]);
        }
    }
}

/* The largest correlation of a patch with the patches around its place in the other section. */
static double agreement(const struct texture *t, const float *patch, const float *window)
{
    float product[SHIFTS][ROW];
    double energy[SHIFTS][SHIFTS], own = 0, most = 0;

    for (size_t y = 0; y < PATCH; y++)
        for (size_t x = 0; x < PATCH; x++)
            own += pow((double)patch[y * t->columns + x], 2);
    energies(t, window, energy);
    products(t, patch, window, product);
    for (int v = 0; v < SHIFTS; v++)
        for (int u = 0; u < SHIFTS; u++)
            if (energy[v][u] * own > 0)
                most = fmax(most, (double)product[v][u] / sqrt(energy[v][u] * own));
    return most;
}

/* Share of their texture that sections i and j have in common: the median of their patches; every
 * step-th patch is looked at. NaN where fewer than least of them have tissue over tissue. */
static double shared(const struct texture *t, size_t i, size_t j, size_t step, size_t least)
{
    const size_t cells = t->columns * t->rows;
    size_t count = 0, at = 0;

    for (size_t y = REACH; y + PATCH + REACH <= t->rows; y += PATCH)
        for (size_t x = REACH; x + PATCH + REACH <= t->columns; x += PATCH) {
            const float *a = t->value + i * cells + y * t->columns + x;
            const float *b = t->value + j * cells + (y - REACH) * t->columns + x - REACH;

            if (at++ % step != 0 || count >= MOST_PATCHES || share_of_tissue(t, a, PATCH) < FULL ||
                share_of_tissue(t, b, WINDOW) < FULL_WINDOW)
                continue;
            t->share[count++] = agreement(t, a, b);
        }
    return count >= least ? gsn_median(t->share, count) : NAN;
}

/* ---- what only two mounts share ------------------------------------------------------------- */

/* Whether neighbours show enough to go by. room: 2 n. */
static int judge_neighbours(const struct texture *t, double *room, double *ret_usual,
                            double *ret_least)
{
    size_t pairs = 0;
    double usual;

    for (size_t i = 0; i + 1 < t->n; i++) {
        const double share = shared(t, i, i + 1, 1, LEAST_PATCHES);

        if (!isnan(share))
            room[pairs++] = share;
    }
    if (2 * pairs < t->n)
        return 0;
    memcpy(room + t->n, room, pairs * sizeof *room);
    usual = gsn_median(room + t->n, pairs);
    for (size_t i = 0; i < pairs; i++)
        room[i] = fabs(room[i] - usual);
    *ret_usual = usual;
    *ret_least = fmax(SAME, usual + SAME_DEVIATIONS * MAD_TO_SD * gsn_median(room, pairs));
    return *ret_least <= TWO_MOUNTS;
}

/* Pairs far below the limit, which are nearly all, are told by a few of their patches. */
static double shared_if_much(const struct texture *t, size_t i, size_t j, double least)
{
    const size_t patches = (t->columns / PATCH) * (t->rows / PATCH);
    const size_t step = patches / FIRST_LOOK;

    if (step > 1) {
        const double first = shared(t, i, j, step, LEAST_OF_FIRST);

        if (first < FAR_BELOW * least)
            return first;
    }
    return shared(t, i, j, 1, LEAST_PATCHES);
}

static void find(const struct texture *t, const struct gsn_sequence_plane *planes, double *room,
                 struct gsn_sequence *found)
{
    double usual = 0, least = 0;

    found->twice_told = judge_neighbours(t, room, &usual, &least);
    for (size_t i = 0; i < t->n && found->twice_told; i++)
        for (size_t j = i + 1; j < t->n && found->count < t->n; j++) {
            const double share = shared_if_much(t, i, j, least);

            if (share > least)
                found->finding[found->count++] =
                    (struct gsn_sequence_finding){ .kind = GSN_SEQUENCE_DUPLICATE,
                                                   .a = planes[i].serial,
                                                   .b = planes[j].serial,
                                                   .evidence = share,
                                                   .usual = usual };
        }
}

int gsn_sequence_find_duplicates(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                                 size_t rows, struct gsn_sequence *found, struct gsn_error *err)
{
    struct texture t = { .n = n, .columns = columns, .rows = rows };
    const size_t cells = columns * rows;
    gsn_auto_mem(float) value = gsn_alloc_array((n + 2) * cells, sizeof *value);
    gsn_auto_mem(double) room = gsn_alloc_array(cells + 2 * n + MOST_PATCHES, sizeof *room);

    if (!value || !room)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the texture of %zu sections", n);
    t.value = value;
    t.smooth = value + n * cells;
    t.weight = t.smooth + cells;
    t.share = room + 2 * n;
    t.spread = t.share + MOST_PATCHES;
    for (size_t i = 0; i < n; i++)
        fill(&t, planes[i].density, value + i * cells);
    find(&t, planes, room, found);
    return GSN_OK;
}
