/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stain/level_tissues.h"

#include "pipeline/core/linalg.h"
#include "pipeline/stain/classes.h"

#include <math.h>
#include <string.h>

/* What tissue changes by along a block, of its density per um: a tenth in a millimetre is usual. */
static const double SLOPE = 1e-4;
/* What sections of one panel scatter by, of the density, where too few are seen to tell; and how
 * many are too few. */
static const double SCATTER = 0.05;
enum { LEAST_FREE = 4 };
/* A median's variance against a mean's. */
static const double MEDIAN = 1.57;
/* Rounding and JPEG leave a thousandth between any two pictures. */
static const double LEAST_VARIANCE = 1e-6;

/* What all panels say of one tissue. */
struct tissue {
    const struct gsn_level_seen *seen;
    size_t count;
    double density;                  /* about where the steps lift it */
    double weight[GSN_LEVEL_PANELS]; /* of the panels that see it */
    double lever[GSN_LEVEL_PANELS];  /* of all panels, against the region's shares */
    double noise[GSN_LEVEL_PANELS];  /* variance, of the panels that see it */
};

/* Squares of sections, and by how many degrees of freedom they are known. */
struct scatter {
    double squares, of_density, free;
};

static void add_scatter(const struct gsn_level_seen *seen, size_t count, struct scatter *s)
{
    for (size_t i = 0; i < count; i++) {
        const double free = seen[i].sections > 0 ? (double)seen[i].sections - 1 : 0;

        s->squares += free > 0 ? seen[i].square : 0;
        s->of_density += free * seen[i].value * seen[i].value;
        s->free += free;
    }
}

/* Variance of one section over its density squared, by all tissues and panels. */
static double relative_variance(const struct gsn_level_seen *const seen[GSN_LEVEL_TISSUES],
                                const size_t count[GSN_LEVEL_TISSUES])
{
    struct scatter all = { 0 };

    for (size_t t = 0; t < GSN_LEVEL_TISSUES; t++)
        add_scatter(seen[t], count[t], &all);
    return all.free >= LEAST_FREE && all.of_density > 0 ? all.squares / all.of_density
                                                        : SCATTER * SCATTER;
}

/* Sections of one tissue may scatter by more than those of all do; that they scatter by less is
 * chance. */
static void tissue_init(const struct gsn_level_seen *seen, size_t count, double relative,
                        struct tissue *t)
{
    struct scatter own = { 0 };
    double variance;

    *t = (struct tissue){ .seen = seen, .count = count };
    for (size_t i = 0; i < count; i++)
        t->density += seen[i].value / (double)count;
    add_scatter(seen, count, &own);
    variance = fmax(relative * t->density * t->density,
                    own.free >= LEAST_FREE ? own.squares / own.free : 0);
    for (size_t i = 0; i < count; i++)
        t->noise[i] = LEAST_VARIANCE + MEDIAN * variance / (double)seen[i].sections;
}

/* Covariance of what two panels are off by. */
static double covariance_of(const struct gsn_level_frame *frame, const struct tissue *t, size_t i,
                            size_t j)
{
    const size_t panels = frame->fit->steps + 1;
    const double slope = SLOPE * t->density;
    double one[GSN_LEVEL_PANELS], other[GSN_LEVEL_PANELS];

    for (size_t p = 0; p < panels; p++)
        one[p] = other[p] = -frame->share[p];
    one[t->seen[i].panel] += 1;
    other[t->seen[j].panel] += 1;
    return gsn_level_covariance(frame->fit, one, t->density, other, t->density) +
           slope * slope * (t->seen[i].z_um - frame->at_um) * (t->seen[j].z_um - frame->at_um) +
           (i == j ? t->noise[i] : 0);
}

/* The weights of the panels: the best linear unbiased ones. */
static void weigh(const struct gsn_level_frame *frame, struct tissue *t)
{
    double covariance[GSN_LEVEL_PANELS * GSN_LEVEL_PANELS], sum = 0;

    for (size_t i = 0; i < t->count; i++) {
        t->weight[i] = 1;
        for (size_t j = 0; j < t->count; j++)
            covariance[i * t->count + j] = covariance_of(frame, t, i, j);
    }
    (void)gsn_solve_spd(covariance, t->count, t->count, t->weight); /* noise keeps it definite */
    for (size_t i = 0; i < t->count; i++)
        sum += t->weight[i];
    for (size_t p = 0; p <= frame->fit->steps; p++)
        t->lever[p] = -frame->share[p];
    for (size_t i = 0; i < t->count; i++) {
        t->weight[i] /= sum;
        t->lever[t->seen[i].panel] += t->weight[i];
    }
}

static double own_variance(const struct gsn_level_frame *frame, const struct tissue *t)
{
    double away = 0, noise = 0;

    for (size_t i = 0; i < t->count; i++) {
        away += t->weight[i] * (t->seen[i].z_um - frame->at_um);
        noise += t->weight[i] * t->weight[i] * t->noise[i];
    }
    return noise + SLOPE * SLOPE * t->density * t->density * away * away;
}

void gsn_level_tissues_at(const struct gsn_level_frame *frame,
                          const struct gsn_level_seen *const seen[GSN_LEVEL_TISSUES],
                          const size_t count[GSN_LEVEL_TISSUES],
                          struct gsn_level_tissues *ret_tissues)
{
    const double relative = relative_variance(seen, count);
    struct tissue tissue[GSN_LEVEL_TISSUES];
    struct gsn_level_tissues ret = { 0 };

    for (size_t t = 0; t < GSN_LEVEL_TISSUES; t++) {
        tissue_init(seen[t], count[t], relative, &tissue[t]);
        if (count[t] > 0)
            weigh(frame, &tissue[t]);
        ret.value[t] = count[t] > 0 ? 0 : (double)NAN;
        for (size_t i = 0; i < count[t]; i++)
            ret.value[t] += tissue[t].weight[i] * seen[t][i].value;
    }
    for (size_t t = 0; t < GSN_LEVEL_TISSUES; t++)
        for (size_t u = 0; u < GSN_LEVEL_TISSUES; u++)
            ret.covariance[t][u] =
                count[t] == 0 || count[u] == 0
                    ? (double)NAN
                    : gsn_level_covariance(frame->fit, tissue[t].lever, tissue[t].density,
                                           tissue[u].lever, tissue[u].density) +
                          (t == u ? own_variance(frame, &tissue[t]) : 0);
    *ret_tissues = ret;
}

double gsn_level_tissue_error(const struct gsn_level_tissues *tissues, size_t tissue)
{
    return sqrt(tissues->covariance[tissue][tissue]);
}
