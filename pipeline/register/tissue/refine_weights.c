/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How much each cell and each spatial frequency counts where a section is compared with the line
 * through its neighbours (refine.c).
 *
 * Steps: (1) local normalisation: what sections near one are off their lines by, in patches, says
 * how coarse the tissue is there; each cell is divided by it. (2) Coherence by Fourier shell: over
 * all sections, the regression of their transforms on those of their lines, ring by ring, says what
 * share of a line is tissue (like the Fourier ring correlation of two images, van Heel 1987; no
 * section takes part in its own line); what chance alone would give counts as none, and no finer
 * ring counts more than a coarser one. (3) The power of what is left in a ring, in the median over
 * all sections, is the noise there.
 *
 * Only the lowest frequencies are used, up to a wavelength of four cells. Fails when memory runs
 * out. */
#include "pipeline/register/tissue/refine_weights.h"

#include "pipeline/core/parallel.h"
#include "pipeline/core/robust.h"
#include "pipeline/imaging/fourier.h"
#include "pipeline/imaging/smooth.h"

#include <math.h>
#include <string.h>

static size_t count_rows(const struct gsn_refine_dft *w)
{
    return 2 * w->most + 1;
}

size_t gsn_refine_dft_count(const struct gsn_refine_dft *w)
{
    return (w->most + 1) * count_rows(w);
}

double gsn_refine_dft_times(const struct gsn_refine_dft *w, size_t i)
{
    return i / count_rows(w) > 0 ? 2 : 1;
}

size_t gsn_refine_dft_ring(const struct gsn_refine_dft *w, size_t i)
{
    const double u = (double)(i / count_rows(w)), v = (double)(i % count_rows(w)) - (double)w->most;

    return (size_t)(hypot(u, v) + 0.5);
}

/* Where the pair of column frequency u and row v lies in a whole transform. */
static size_t find_pair(const struct gsn_refine_dft *w, size_t u, size_t v)
{
    return (v + w->side - w->most) % w->side * w->side + u;
}

int gsn_refine_dft_forward(const struct gsn_refine_dft *w, const float *plane, float *scratch,
                           float *ret_pairs, struct gsn_error *err)
{
    const size_t rows = count_rows(w);
    int r;

    for (size_t i = 0; i < w->side * w->side; i++) {
        scratch[2 * i] = plane[i];
        scratch[2 * i + 1] = 0;
    }
    r = gsn_fourier(scratch, (uint32_t)w->side, (uint32_t)w->side, 0, err);
    for (size_t i = 0; r >= 0 && i < gsn_refine_dft_count(w); i++)
        memcpy(ret_pairs + 2 * i, scratch + 2 * find_pair(w, i / rows, i % rows),
               2 * sizeof *ret_pairs);
    return r;
}

/* The plane is real: the pairs left out are the conjugates of these, and add the same real part. */
int gsn_refine_dft_inverse(const struct gsn_refine_dft *w, const float *pairs, float *scratch,
                           float *ret_plane, struct gsn_error *err)
{
    const size_t rows = count_rows(w), cells = w->side * w->side;
    int r;

    memset(scratch, 0, 2 * cells * sizeof *scratch);
    for (size_t i = 0; i < gsn_refine_dft_count(w); i++) {
        const float times = (float)gsn_refine_dft_times(w, i) / (float)cells;
        float *to = scratch + 2 * find_pair(w, i / rows, i % rows);

        to[0] = times * pairs[2 * i];
        to[1] = times * pairs[2 * i + 1];
    }
    r = gsn_fourier(scratch, (uint32_t)w->side, (uint32_t)w->side, 1, err);
    for (size_t i = 0; r >= 0 && i < cells; i++)
        ret_plane[i] = scratch[2 * i];
    return r;
}

/* Tissues differ in how coarse they are: from so many sections on either side, in patches of so
 * many cells, and no place counts more than what is left at this share of the mean. */
enum { NEAR = 8 };
static const double PATCH_CELLS = 1.5, LEAST_ROUGH = 0.3;

/* Of the sections near, as many have to show a place. */
static const float LEAST_SHOWN = 1;

/* Adds squares of what sections near the k-th are off their lines by, and how many show them. */
static void sum_squares(const struct gsn_refine_comparison *c, size_t k, float *square,
                        float *shown)
{
    const size_t first = k > NEAR ? k - NEAR : 0;

    for (size_t j = first; j < c->stack->count && j <= k + NEAR; j++) {
        const size_t from = j * c->cells;

        for (size_t i = 0; c->flanked[j] && i < c->cells; i++) {
            const float off = c->placed[from + i] - c->line[from + i];

            if (isnan(off))
                continue;
            square[i] += c->weight[from + i] * off * off;
            shown[i] += c->weight[from + i];
        }
    }
}

static double mean_square_of(const struct gsn_refine_comparison *c, const float *square,
                             const float *shown)
{
    double sum = 0, n = 0;

    for (size_t i = 0; i < c->cells; i++)
        if (shown[i] > LEAST_SHOWN) {
            sum += (double)(c->taper[i] * square[i] / shown[i]);
            n += (double)c->taper[i];
        }
    return n > 0 ? sum / n : 0;
}

static int learn_section(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;
    float *even = c->local + k * c->cells;
    gsn_auto_mem(float) scratch = NULL;
    gsn_auto_mem(float) shown = NULL;
    double mean;

    if (!c->flanked[k])
        return GSN_OK;
    scratch = gsn_alloc_array(c->cells, sizeof *scratch);
    shown = gsn_alloc_array(c->cells, sizeof *shown);
    if (!scratch || !shown)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
    memset(even, 0, c->cells * sizeof *even);
    memset(shown, 0, c->cells * sizeof *shown);
    sum_squares(c, k, even, shown);
    gsn_smooth_gaussian(even, c->stack->side, c->stack->side, PATCH_CELLS, scratch);
    gsn_smooth_gaussian(shown, c->stack->side, c->stack->side, PATCH_CELLS, scratch);
    mean = mean_square_of(c, even, shown);
    for (size_t i = 0; i < c->cells; i++) {
        const double here = shown[i] > LEAST_SHOWN ? (double)(even[i] / shown[i]) : mean;

        even[i] =
            mean > 0 ? (float)sqrt((1 + LEAST_ROUGH) * mean / (here + LEAST_ROUGH * mean)) : 1;
    }
    return GSN_OK;
}

int gsn_refine_normalise_locally(struct gsn_refine_comparison *c, unsigned threads,
                                 struct gsn_error *err)
{
    return gsn_parallel_for(c->stack->count, threads, learn_section, c, err);
}

/* A frequency that the line through the neighbours tells worse than this says nothing. */
static const double LEAST_TOLD = 0.15;

/* What sections and their lines share by chance stays below so many of its deviations. Two
 * neighbours meet twice, each in the other's line. */
static const double CHANCE = 4 * M_SQRT2;

/* Median of an exponential distribution with mean 1: the power in one frequency. */
static const double MEDIAN_POWER = 0.6931;

void gsn_refine_buffers_done(struct gsn_refine_buffers *room)
{
    gsn_free(room->plane);
    gsn_free(room->gradient[0]);
    gsn_free(room->gradient[1]);
    gsn_free(room->scratch);
    gsn_free(room->pairs);
    for (size_t p = 0; p < PARTS; p++)
        gsn_free(room->column[p]);
}

int gsn_refine_buffers_init(const struct gsn_refine_comparison *c, struct gsn_refine_buffers *room,
                            struct gsn_error *err)
{
    const size_t pairs = 2 * c->pairs;
    int full;

    room->plane = gsn_alloc_array(c->cells, sizeof *room->plane);
    room->gradient[0] = gsn_alloc_array(c->cells, sizeof *room->plane);
    room->gradient[1] = gsn_alloc_array(c->cells, sizeof *room->plane);
    room->scratch = gsn_alloc_array(2 * c->cells, sizeof *room->scratch);
    room->pairs = gsn_alloc_array(pairs, sizeof *room->pairs);
    full = room->plane && room->gradient[0] && room->gradient[1] && room->scratch && room->pairs;
    for (size_t p = 0; p < PARTS; p++) {
        room->column[p] = gsn_alloc_array(pairs, sizeof *room->column[p]);
        full = full && room->column[p];
    }
    return full ? GSN_OK
                : gsn_fail(err, GSN_E_NOMEM, "out of memory to compare the sections' tissue");
}

double gsn_refine_product(const float *a, const float *b)
{
    return (double)a[0] * b[0] + (double)a[1] * b[1];
}

/* The transform of the section as it is filled; of its line; of what it is off the line by, weighed
 * as that is from place to place. */
enum what { SECTION, LINE, OFF };

static int transform_plane(const struct gsn_refine_comparison *c, size_t k, enum what what,
                           struct gsn_refine_buffers *room, float *ret_pairs, struct gsn_error *err)
{
    for (size_t i = 0, at = k * c->cells; i < c->cells; i++, at++) {
        const float off = isnan(c->placed[at]) ? 0 : (c->placed[at] - c->line[at]) * c->local[at];
        const float value = what == SECTION ? c->filled[at] : what == LINE ? c->line[at] : off;

        room->plane[i] = value * c->taper[i];
    }
    return gsn_refine_dft_forward(&c->dft, room->plane, room->scratch, ret_pairs, err);
}

static void add_common(const struct gsn_refine_comparison *c, const float *section,
                       const float *line, struct gsn_refine_common *common)
{
    for (size_t i = 0; i < c->pairs; i++) {
        const size_t ring = gsn_refine_dft_ring(&c->dft, i);
        const float *a = section + 2 * i, *b = line + 2 * i;

        if (ring >= c->rings)
            continue;
        common[ring].both += gsn_refine_product(a, b);
        common[ring].line += gsn_refine_product(b, b);
        common[ring].section += gsn_refine_product(a, a);
        common[ring].frequencies++;
    }
}

static int transform_section(size_t k, void *context, struct gsn_error *err)
{
    struct gsn_refine_comparison *c = context;
    struct gsn_refine_common *common = c->common + k * c->rings;
    struct gsn_refine_buffers room = { 0 };
    int r;

    memset(common, 0, c->rings * sizeof *common);
    if (!c->flanked[k])
        return GSN_OK;
    r = gsn_refine_buffers_init(c, &room, err);
    if (r >= 0)
        r = transform_plane(c, k, SECTION, &room, room.column[0], err);
    if (r >= 0)
        r = transform_plane(c, k, LINE, &room, room.column[1], err);
    if (r >= 0)
        r = transform_plane(c, k, OFF, &room, c->wave + 2 * k * c->pairs, err);
    if (r >= 0)
        add_common(c, room.column[0], room.column[1], common);
    gsn_refine_buffers_done(&room);
    return r;
}

/* How much of a line's value at this wavelength the sections show themselves: their regression on
 * their lines, in which no section takes part in its own line. What neighbours share falls with the
 * wavelength; where it once says nothing, finer ones do not either. */
static void learn_coherence(struct gsn_refine_comparison *c)
{
    double most = 1;

    for (size_t ring = 1; ring < c->rings; ring++) {
        struct gsn_refine_common s = { 0 };
        double told;

        for (size_t k = 0; k < c->stack->count; k++) {
            const struct gsn_refine_common *of = &c->common[k * c->rings + ring];

            s.both += of->both;
            s.line += of->line;
            s.section += of->section;
            s.frequencies += of->frequencies;
        }
        told = s.line > 0 ? s.both / s.line : 0;
        if (s.both < CHANCE * sqrt(s.line * s.section / (s.frequencies + 1)) || told < LEAST_TOLD)
            told = 0;
        most = fmin(most, told);
        c->coherence[ring] = most;
    }
    c->coherence[0] = c->coherence[1];
}

static void learn_noise(struct gsn_refine_comparison *c)
{
    for (size_t ring = 1; ring < c->rings; ring++) {
        size_t n = 0;

        for (size_t k = 0; k < c->stack->count; k++)
            for (size_t i = 0; c->flanked[k] && i < c->pairs; i++)
                if (gsn_refine_dft_ring(&c->dft, i) == ring) {
                    const float *at = c->wave + 2 * (k * c->pairs + i);

                    c->room[n++] = gsn_refine_product(at, at);
                }
        c->noise[ring] = n > 0 ? gsn_median(c->room, n) / MEDIAN_POWER : 0;
    }
    /* The sections' means were taken off, so the lowest frequencies look better known than they
     * are. */
    c->noise[1] = fmax(c->noise[1], c->noise[2]);
    c->noise[0] = c->noise[1];
}

int gsn_refine_learn_coherence(struct gsn_refine_comparison *c, unsigned threads,
                               struct gsn_error *err)
{
    const int r = gsn_parallel_for(c->stack->count, threads, transform_section, c, err);

    if (r < 0)
        return r;
    learn_coherence(c);
    learn_noise(c);
    return GSN_OK;
}
