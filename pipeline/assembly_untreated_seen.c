/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_untreated.h"

#include "pipeline/core/robust.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>

/* A tissue that fewer sections show is not told. */
enum { LEAST_SECTIONS = 3 };

/* ---- densities ------------------------------------------------------------------------------- */

/* One section of a tissue. */
struct sight {
    double z_um, value;
    const struct gsn_assembly_panel *panel;
};

/* What a panel's sections say together. */
static struct gsn_control_seen seen_on(const struct sight *sight, size_t count, double *scratch)
{
    struct gsn_control_seen seen = { .panel = sight->panel->place, .sections = count };
    double mean = 0;

    for (size_t i = 0; i < count; i++) {
        seen.z_um += sight[i].z_um / (double)count;
        mean += sight[i].value / (double)count;
        scratch[i] = sight[i].value;
    }
    seen.value = 0.5 * (gsn_order_pick(scratch, count, count / 2) +
                        gsn_order_pick(scratch, count, (count - 1) / 2));
    for (size_t i = 0; i < count; i++)
        seen.square += (sight[i].value - mean) * (sight[i].value - mean);
    return seen;
}

/* What is seen of one tissue, panel by panel. */
struct panels_seen {
    struct gsn_control_seen panel[GSN_GAIN_PANELS];
    size_t count;
};

static void sum_up(const struct sight *sight, size_t count, double *scratch,
                   struct panels_seen *ret_seen)
{
    ret_seen->count = 0;
    if (count < LEAST_SECTIONS)
        return;
    for (size_t i = 0, end; i < count && ret_seen->count < GSN_GAIN_PANELS; i = end) {
        for (end = i; end < count && sight[end].panel == sight[i].panel;)
            end++;
        ret_seen->panel[ret_seen->count++] = seen_on(sight + i, end - i, scratch);
    }
}

/* Mean height of a region; NaN where it is empty. */
static double height_of(const struct gsn_mask *region)
{
    const size_t plane = region->at.nx * region->at.ny;
    double sum = 0;
    size_t n = 0;

    for (size_t i = 0; i < gsn_lattice_count(&region->at); i++)
        if (region->inside[i]) {
            sum += (double)(i / plane);
            n++;
        }
    return n > 0 ? region->at.origin_um.z + region->at.step_um.z * sum / (double)n : (double)NAN;
}

/* The panel that a plane is compared by; NULL: none. */
static const struct gsn_assembly_panel *panel_of(const struct gsn_specimen *specimen,
                                                 struct gsn_assembly *a,
                                                 const struct gsn_untreated_field *f, size_t z)
{
    const struct gsn_assembly_panel *panel = gsn_assembly_panel_of_serial(
        a, gsn_assembly_serial_of_plane(&f->at, z, specimen->protocol->interval_um));

    return panel && panel->levelled ? panel : NULL;
}

/* Mean optical density of the first count columns. */
static void mean_od(const struct gsn_untreated_field *f, const struct gsn_assembly *a, size_t count,
                    double ret_od[3])
{
    for (int c = 0; c < 3; c++) {
        ret_od[c] = 0;
        for (size_t i = 0; i < count; i++)
            ret_od[c] += (double)a->columns->od[c]->value[f->column[i]] / (double)count;
    }
}

/* Adds the first count columns, as a panel's vectors see them. */
static int add_turned(const struct gsn_untreated_field *f, const struct gsn_assembly *a,
                      const struct gsn_assembly_panel *panel, size_t count,
                      struct gsn_vector_error *turned, struct gsn_error *err)
{
    double od[3];

    if (count == 0)
        return GSN_OK;
    mean_od(f, a, count, od);
    return gsn_vector_error_add(turned, &panel->stain.fit.dyes, od, (double)count, err);
}

/* A mean over planes. */
struct average {
    double sum, weight;
};

/* Adds the yellow dye of the first count columns. */
static int add_yellow(const struct gsn_untreated_field *f, const struct gsn_assembly *a,
                      const struct gsn_assembly_panel *panel, size_t count, double weight,
                      struct average *yellow, struct gsn_error *err)
{
    double od[3], amount[3];
    int r;

    if (count == 0)
        return GSN_OK;
    mean_od(f, a, count, od);
    r = gsn_unmix_one(od, &panel->stain.fit.dyes, amount, err);
    if (r < 0)
        return r;
    yellow->sum += weight * amount[1];
    yellow->weight += weight;
    return GSN_OK;
}

/* Lists the region's columns in one section; returns how many. */
static size_t list_region(const struct gsn_untreated_field *f, const struct gsn_assembly *a,
                          size_t z)
{
    size_t n = 0;

    for (size_t y = 0; y < f->at.ny; y++)
        for (size_t x = 0; x < f->at.nx; x++) {
            const size_t i = gsn_lattice_index(&f->at, x, y, z);

            if (!isnan(a->columns->density->value[i]) &&
                gsn_mask_has(a->region, gsn_lattice_centre(&f->at, x, y, z)))
                f->column[n++] = i;
        }
    return n;
}

static int measure_kind(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                        struct gsn_untreated_field *f, unsigned kind, const double *weight,
                        struct sight *sight, struct panels_seen *seen,
                        struct gsn_vector_error *turned, struct gsn_error *err)
{
    struct average yellow = { 0 };
    size_t n = 0;
    int r = GSN_OK;

    for (size_t z = 0; z < f->at.nz && r >= 0; z++) {
        const struct gsn_assembly_panel *of = panel_of(specimen, a, f, z);
        size_t columns;

        if (!of)
            continue;
        sight[n] = (struct sight){ f->at.origin_um.z + (double)z * f->at.step_um.z,
                                   gsn_untreated_in(f, a, (uint8_t)(1 + kind), z, &columns), of };
        n += isnan(sight[n].value) ? 0 : 1;
        r = add_turned(f, a, of, columns, turned, err);
        if (r >= 0)
            r = add_yellow(f, a, of, columns, weight[z], &yellow, err);
    }
    sum_up(sight, n, f->scratch, seen);
    if (yellow.weight > 0)
        a->levelling.yellow[kind] = yellow.sum / yellow.weight;
    return r;
}

/* ---- vectors --------------------------------------------------------------------------------- */

/* Whether vectors were inferred or measured, so that their errors are known. */
static int has_errors(const struct gsn_assembly *a)
{
    for (size_t p = 0; p < a->panel_count; p++)
        if (a->panel[p].levelled && a->panel[p].stain.fit.deviation_deg[0] > 0)
            return 1;
    return 0;
}

/* The vectors of all panels lean on one prior, and the tissue misleads them alike: their errors are
 * taken as common. */
static void mean_covariance(const struct gsn_assembly *a,
                            double ret[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS])
{
    for (size_t p = 0; p < a->panel_count; p++)
        for (int m = 0; m < GSN_DYE_ROTATIONS && a->panel[p].levelled; m++)
            for (int n = 0; n < GSN_DYE_ROTATIONS; n++)
                ret[m][n] += a->panel[p].stain.fit.covariance[m][n] / (double)a->levelling.panels;
}

/* What density 0 scatters by from panel to panel, beyond what levelling errs by: variance. */
static double zero_variance(const struct gsn_levelling *l)
{
    double erring = 0;

    for (size_t p = 0; p < l->panels; p++) {
        double lever[GSN_GAIN_PANELS];

        for (size_t i = 0; i < l->panels; i++)
            lever[i] = (i == p) - 1 / (double)l->panels;
        erring += gsn_gain_covariance(&l->fit, lever, 0, lever, 0) / ((double)l->panels - 1);
    }
    return fmax(0, l->fit.offset_scatter * l->fit.offset_scatter - erring);
}

/* Vectors that were taken as exact are not: each panel's bath turns them a little, and yellow that
 * counts as red is an offset. The mean over the region's panels keeps a share of independent turns.
 * Where they put density 0 the offsets say themselves. */
static void judge_scatter(const struct gsn_vector_error *tissue,
                          const struct gsn_vector_error *region, struct gsn_levelling *l)
{
    double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS] = { { 0 } }, kept = 0;

    if (l->panels < 2)
        return;
    for (size_t p = 0; p < l->panels; p++)
        kept += l->share[p] * l->share[p];
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        covariance[m][m] = kept;
    l->turns =
        gsn_vector_scatter_of(tissue, GSN_UNTREATED_KINDS, zero_variance(l), (double)l->panels - 1);
    l->vectors = gsn_vector_error_left_of(tissue, GSN_UNTREATED_KINDS, region, covariance);
    l->vectors.zero = l->vectors.both = 0;
}

static int judge_turns(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                       const struct gsn_untreated_field *f, const struct gsn_vector_error *tissue,
                       struct gsn_error *err)
{
    double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS] = { { 0 } };
    struct gsn_vector_error region = { 0 };
    int r = GSN_OK;

    for (size_t z = 0; z < f->at.nz && r >= 0; z++) {
        const struct gsn_assembly_panel *of = panel_of(specimen, a, f, z);

        if (of)
            r = add_turned(f, a, of, list_region(f, a, z), &region, err);
    }
    if (r < 0)
        return r;
    if (!has_errors(a)) {
        judge_scatter(tissue, &region, &a->levelling);
        return GSN_OK;
    }
    mean_covariance(a, covariance);
    a->levelling.vectors =
        gsn_vector_error_left_of(tissue, GSN_UNTREATED_KINDS, &region, covariance);
    return GSN_OK;
}

/* The tissues where the region lies: there both specimens are compared, whatever sections each of
 * them lacks. */
static void judge_tissues(const struct panels_seen seen[GSN_UNTREATED_KINDS],
                          struct gsn_assembly *a)
{
    const struct gsn_control_frame frame = { &a->levelling.fit, a->levelling.share,
                                             height_of(a->region) };
    const struct gsn_control_seen *panel[GSN_CONTROL_TISSUES];
    size_t count[GSN_CONTROL_TISSUES];

    _Static_assert((int)GSN_UNTREATED_KINDS == (int)GSN_CONTROL_TISSUES, "one list of tissues");
    for (size_t k = 0; k < GSN_UNTREATED_KINDS; k++) {
        panel[k] = seen[k].panel;
        count[k] = seen[k].count;
    }
    gsn_control_tissues_at(&frame, panel, count, &a->levelling.tissues);
}

int gsn_untreated_measure(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                          struct gsn_untreated_field *f, struct gsn_error *err)
{
    gsn_auto_mem(struct sight) sight = gsn_alloc_array(f->at.nz, sizeof *sight);
    gsn_auto_mem(double) weight = gsn_alloc_array(f->at.nz, sizeof *weight);
    struct gsn_vector_error turned[GSN_UNTREATED_KINDS] = { { 0 } };
    struct panels_seen seen[GSN_UNTREATED_KINDS];
    int r = sight && weight ? GSN_OK
                            : gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a block");

    for (size_t z = 0; z < f->at.nz && r >= 0; z++)
        weight[z] = (double)list_region(f, a, z);
    for (unsigned k = 0; k < GSN_UNTREATED_KINDS && r >= 0; k++)
        r = measure_kind(specimen, a, f, k, weight, sight, &seen[k], &turned[k], err);
    if (r < 0)
        return r;
    judge_tissues(seen, a);
    return judge_turns(specimen, a, f, turned, err);
}
