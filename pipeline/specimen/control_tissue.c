/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Internal control tissue: bone, loose tissue and dentine off the region, which nobody treated.
 *
 * 1. The coarse grid is smoothed; bone is the median of what lies above Otsu's threshold; the root
 * is found by its shape (stain/tissue_segmentation.h). Each column is dense, loose, dentine or
 * neither by its share of the density of bone.
 * 2. Columns count that lie two from the border of their tissue and, but for dentine, more than
 *    GSN_SURROUNDINGS_UM from the region; of these the half that is farther off.
 * 3. Sections give one value each, panels the median of theirs; the three tissues are brought to
 * the height of the region (stain/normalisation.h).
 * 4. What errors of the dye vectors leave open beside these tissues (stain/error_propagation.h): by
 * the vectors' covariance where it is known, else by their scatter from panel to panel.
 *
 * Tissue that too few sections show is NaN. Fails with GSN_E_NOMEM, GSN_E_STAIN. */
#include "pipeline/specimen/normalisation.h"

#include "pipeline/core/robust.h"
#include "pipeline/imaging/threshold.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"
#include "pipeline/stain/tissue_segmentation.h"
#include "pipeline/stain/unmixing.h"

#include <math.h>
#include <string.h>

/* The work in hand: one value and one kind per column of the block. */
struct tissue_field {
    const struct gsn_specimen *specimen;
    const struct gsn_mask *region;
    const struct gsn_poses *poses;
    const struct gsn_densities *d;
    struct gsn_lattice at;
    size_t count;
    float *smooth;            /* owned: mean of 3 x 3 x 3 where there is tissue, else NaN */
    uint8_t *kind;            /* owned: 1 + enum gsn_control_tissue, 0 none */
    struct gsn_grid *away;    /* owned: of each column from the region, um */
    double *value, *distance; /* owned: of the columns of one plane that are looked at */
    size_t *column;           /* owned: which they are */
    double *scratch;
};

/* ---- which tissue each column is ------------------------------------------------------------ */

/* Columns from the border of a tissue: what is blurred over it is neither. */
enum { RIM = 2, LEAST_COLUMNS = 50 };

static void field_done(struct tissue_field *f)
{
    gsn_free(f->smooth);
    gsn_free(f->kind);
    gsn_grid_free(f->away);
    gsn_free(f->value);
    gsn_free(f->distance);
    gsn_free(f->column);
    gsn_free(f->scratch);
}

static int field_init(struct tissue_field *f, struct gsn_error *err)
{
    const struct gsn_lattice *at = &f->d->coarse->density->at;

    f->at = *at;
    f->count = gsn_lattice_count(at);
    f->smooth = gsn_alloc_array(f->count, sizeof *f->smooth);
    f->kind = gsn_alloc_array(f->count, 1);
    f->value = gsn_alloc_array(at->nx * at->ny, sizeof *f->value);
    f->distance = gsn_alloc_array(at->nx * at->ny, sizeof *f->distance);
    f->column = gsn_alloc_array(at->nx * at->ny, sizeof *f->column);
    f->scratch = gsn_alloc_array(f->count, sizeof *f->scratch);
    if (f->smooth && f->kind && f->value && f->distance && f->column && f->scratch)
        return gsn_coarse_grid_away(f->region, at, &f->away, err);
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a block");
}

static float mean_around(const struct gsn_grid *density, size_t x, size_t y, size_t z)
{
    const struct gsn_lattice *at = &density->at;
    double sum = 0;
    unsigned n = 0;

    for (size_t k = z > 0 ? z - 1 : 0; k <= z + 1 && k < at->nz; k++)
        for (size_t j = y > 0 ? y - 1 : 0; j <= y + 1 && j < at->ny; j++)
            for (size_t i = x > 0 ? x - 1 : 0; i <= x + 1 && i < at->nx; i++) {
                const float value = density->value[gsn_lattice_index(at, i, j, k)];

                if (isnan(value))
                    continue;
                sum += (double)value;
                n++;
            }
    return n > 0 ? (float)(sum / n) : NAN;
}

static void smooth_density(const struct gsn_grid *density, struct tissue_field *f)
{
    for (size_t i = 0, z = 0; z < f->at.nz; z++)
        for (size_t y = 0; y < f->at.ny; y++)
            for (size_t x = 0; x < f->at.nx; x++, i++)
                f->smooth[i] = isnan(density->value[i]) ? NAN : mean_around(density, x, y, z);
}

/* The density of bone: the median of what lies above Otsu's cut; NaN where there is no tissue. */
static double bone_of(struct tissue_field *f, float *list)
{
    double cut;
    size_t n = 0, above = 0;

    for (size_t i = 0; i < f->count; i++)
        if (!isnan(f->smooth[i]))
            list[n++] = f->smooth[i];
    cut = gsn_otsu(list, n);
    for (size_t i = 0; i < n; i++)
        if ((double)list[i] > cut)
            f->scratch[above++] = (double)list[i];
    return above > 0 ? gsn_order_pick(f->scratch, above, above / 2) : (double)NAN;
}

/* The root, where there is one; NULL is none. */
static int find_root(const struct gsn_coarse_grid *columns, struct gsn_mask **ret_root,
                     struct gsn_tissue_levels *levels, struct gsn_error *err)
{
    gsn_auto(gsn_grid) whole = NULL;
    struct gsn_error why = { 0 };
    int r = gsn_grid_new(&columns->density->at, &whole, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < gsn_lattice_count(&whole->at); i++)
        whole->value[i] = columns->tissue->value[i] < 0.5f ? 0 : columns->density->value[i];
    r = gsn_tissue_find(whole, GSN_TISSUE_ROOT, ret_root, levels, &why);
    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", why.text) : GSN_OK;
}

static uint8_t kind_of(double value, double bone, int in_root, double border)
{
    if (in_root)
        return value > border && value < GSN_MOST_OF_BONE * bone ? 1 + GSN_CONTROL_DENTINE : 0;
    if (value >= GSN_MOST_OF_BONE * bone)
        return 1 + GSN_CONTROL_DENSE;
    return value <= GSN_LEAST_OF_BONE * bone ? 1 + GSN_CONTROL_LOOSE : 0;
}

static void tell_kinds(struct tissue_field *f, const struct gsn_mask *root,
                       const struct gsn_tissue_levels *levels, double bone)
{
    for (size_t i = 0; i < f->count; i++)
        f->kind[i] = isnan(f->smooth[i]) ? 0
                                         : kind_of((double)f->smooth[i], bone,
                                                   root && root->inside[i], levels->border);
}

/* Whether all columns around are of one kind. */
static int is_core(const struct tissue_field *f, size_t x, size_t y, size_t z)
{
    const size_t nx = f->at.nx, ny = f->at.ny;
    const uint8_t kind = f->kind[gsn_lattice_index(&f->at, x, y, z)];

    if (kind == 0 || x < RIM || y < RIM || x + RIM >= nx || y + RIM >= ny)
        return 0;
    for (size_t j = y - RIM; j <= y + RIM; j++)
        for (size_t i = x - RIM; i <= x + RIM; i++)
            if (f->kind[gsn_lattice_index(&f->at, i, j, z)] != kind)
                return 0;
    return 1;
}

/* Dentine is not remodelled, so it need not be far from the region; bone and loose tissue above and
 * below the region are left out with it. */
static int is_untreated(const struct tissue_field *f, const struct gsn_mask *region, uint8_t kind,
                        size_t x, size_t y, size_t z)
{
    if (kind == 1 + GSN_CONTROL_DENTINE)
        return !gsn_mask_has(region, gsn_lattice_centre(&f->at, x, y, z));
    return f->away->value[y * f->at.nx + x] > (float)GSN_SURROUNDINGS_UM;
}

/* Lists the tissue's columns in one section; returns how many. */
static size_t list_columns(const struct tissue_field *f, uint8_t kind, size_t z)
{
    size_t n = 0;

    for (size_t y = 0; y < f->at.ny; y++)
        for (size_t x = 0; x < f->at.nx; x++) {
            const size_t i = gsn_lattice_index(&f->at, x, y, z);

            if (f->kind[i] != kind || !is_core(f, x, y, z) ||
                !is_untreated(f, f->region, kind, x, y, z))
                continue;
            f->value[n] = (double)f->d->coarse->density->value[i];
            f->column[n] = i;
            f->distance[n++] = (double)f->away->value[y * f->at.nx + x];
        }
    return n;
}

/* Keeps the half of the columns that is farther from the region; returns how many that are. */
static size_t keep_far(struct tissue_field *f, size_t count)
{
    const size_t far = count / 2 > LEAST_COLUMNS ? count / 2 : LEAST_COLUMNS;
    size_t n = 0;
    double least;

    memcpy(f->scratch, f->distance, count * sizeof *f->scratch);
    least = gsn_order_pick(f->scratch, count, count - far);
    for (size_t i = 0; i < count; i++)
        if (f->distance[i] >= least) {
            f->value[n] = f->value[i];
            f->column[n++] = f->column[i];
        }
    return n;
}

/* A tissue's density in one section; NaN where too little of it is seen. ret_count: how many
 * columns it rests on, which f->column then lists first. */
static double density_in_section(struct tissue_field *f, uint8_t kind, size_t z, size_t *ret_count)
{
    size_t n = list_columns(f, kind, z);

    *ret_count = 0;
    if (n < LEAST_COLUMNS)
        return (double)NAN;
    if (kind != 1 + GSN_CONTROL_DENTINE)
        n = keep_far(f, n);
    *ret_count = n;
    return gsn_reference_red(f->value, n);
}

/* A tissue that fewer sections show is not told. */
enum { LEAST_SECTIONS = 3 };

/* ---- what the panels say of each tissue
 * ------------------------------------------------------------------------------- */

/* One section of a tissue. */
struct sight {
    double z_um, value;
    int panel;
    size_t place; /* of the panel */
};

/* What a panel's sections say together. */
static struct gsn_control_seen seen_on(const struct sight *sight, size_t count, double *scratch)
{
    struct gsn_control_seen seen = { .panel = sight->place, .sections = count };
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

/* The panel that a plane is compared by; -1: none. */
static int panel_of(const struct tissue_field *f, const struct gsn_scale *scale, size_t z)
{
    const int p = gsn_panel_of_plane(f->poses, f->d, &f->at, z, f->specimen->protocol->interval_um);

    return p >= 0 && scale->panel[p].levelled ? p : -1;
}

/* Mean optical density of the first count columns. */
static void mean_od(const struct tissue_field *f, size_t count, double ret_od[3])
{
    for (int c = 0; c < 3; c++) {
        ret_od[c] = 0;
        for (size_t i = 0; i < count; i++)
            ret_od[c] += (double)f->d->coarse->od[c]->value[f->column[i]] / (double)count;
    }
}

/* Adds the first count columns, as a panel's vectors see them. */
static int add_turned(const struct tissue_field *f, int panel, size_t count,
                      struct gsn_vector_error *turned, struct gsn_error *err)
{
    double od[3];

    if (count == 0)
        return GSN_OK;
    mean_od(f, count, od);
    return gsn_vector_error_add(turned, &f->d->panel[panel].stain.fit.dyes, od, (double)count, err);
}

/* A mean over planes. */
struct average {
    double sum, weight;
};

/* Adds the yellow dye of the first count columns. */
static int add_yellow(const struct tissue_field *f, int panel, size_t count, double weight,
                      struct average *yellow, struct gsn_error *err)
{
    double od[3], amount[3];
    int r;

    if (count == 0)
        return GSN_OK;
    mean_od(f, count, od);
    r = gsn_unmix_one(od, &f->d->panel[panel].stain.fit.dyes, amount, err);
    if (r < 0)
        return r;
    yellow->sum += weight * amount[1];
    yellow->weight += weight;
    return GSN_OK;
}

/* Lists the region's columns in one section; returns how many. */
static size_t list_region(const struct tissue_field *f, size_t z)
{
    size_t n = 0;

    for (size_t y = 0; y < f->at.ny; y++)
        for (size_t x = 0; x < f->at.nx; x++) {
            const size_t i = gsn_lattice_index(&f->at, x, y, z);

            if (!isnan(f->d->coarse->density->value[i]) &&
                gsn_mask_has(f->region, gsn_lattice_centre(&f->at, x, y, z)))
                f->column[n++] = i;
        }
    return n;
}

static int measure_kind(struct tissue_field *f, unsigned kind, const double *weight,
                        struct gsn_scale *scale, struct sight *sight, struct panels_seen *seen,
                        struct gsn_vector_error *turned, struct gsn_error *err)
{
    struct average yellow = { 0 };
    size_t n = 0;
    int r = GSN_OK;

    for (size_t z = 0; z < f->at.nz && r >= 0; z++) {
        const int of = panel_of(f, scale, z);
        size_t columns;

        if (of < 0)
            continue;
        sight[n] = (struct sight){ f->at.origin_um.z + (double)z * f->at.step_um.z,
                                   density_in_section(f, (uint8_t)(1 + kind), z, &columns), of,
                                   scale->panel[of].place };
        n += isnan(sight[n].value) ? 0 : 1;
        r = add_turned(f, of, columns, turned, err);
        if (r >= 0)
            r = add_yellow(f, of, columns, weight[z], &yellow, err);
    }
    sum_up(sight, n, f->scratch, seen);
    if (yellow.weight > 0)
        scale->levelling.yellow[kind] = yellow.sum / yellow.weight;
    return r;
}

/* ---- vectors --------------------------------------------------------------------------------- */

/* Whether vectors were inferred or measured, so that their errors are known. */
static int has_errors(const struct gsn_densities *d, const struct gsn_scale *scale)
{
    for (size_t p = 0; p < d->panel_count; p++)
        if (scale->panel[p].levelled && d->panel[p].stain.fit.deviation_deg[0] > 0)
            return 1;
    return 0;
}

/* The vectors of all panels lean on one prior, and the tissue misleads them alike: their errors are
 * taken as common. */
static void mean_covariance(const struct gsn_densities *d, const struct gsn_scale *scale,
                            double ret[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS])
{
    for (size_t p = 0; p < d->panel_count; p++)
        for (int m = 0; m < GSN_DYE_ROTATIONS && scale->panel[p].levelled; m++)
            for (int n = 0; n < GSN_DYE_ROTATIONS; n++)
                ret[m][n] +=
                    d->panel[p].stain.fit.covariance[m][n] / (double)scale->levelling.panels;
}

/* What density 0 scatters by from panel to panel, beyond what levelling errs by: variance. */
static double zero_variance(const struct gsn_normalisation *l)
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
                          const struct gsn_vector_error *region, struct gsn_normalisation *l)
{
    double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS] = { { 0 } }, kept = 0;

    if (l->panels < 2)
        return;
    for (size_t p = 0; p < l->panels; p++)
        kept += l->share[p] * l->share[p];
    for (int m = 0; m < GSN_DYE_ROTATIONS; m++)
        covariance[m][m] = kept;
    l->turns =
        gsn_vector_scatter_of(tissue, GSN_CONTROL_KINDS, zero_variance(l), (double)l->panels - 1);
    l->vectors = gsn_vector_error_left_of(tissue, GSN_CONTROL_KINDS, region, covariance);
    l->vectors.zero = l->vectors.both = 0;
}

static int judge_turns(const struct tissue_field *f, const struct gsn_vector_error *tissue,
                       struct gsn_scale *scale, struct gsn_error *err)
{
    double covariance[GSN_DYE_ROTATIONS][GSN_DYE_ROTATIONS] = { { 0 } };
    struct gsn_vector_error region = { 0 };
    int r = GSN_OK;

    for (size_t z = 0; z < f->at.nz && r >= 0; z++) {
        const int of = panel_of(f, scale, z);

        if (of >= 0)
            r = add_turned(f, of, list_region(f, z), &region, err);
    }
    if (r < 0)
        return r;
    if (!has_errors(f->d, scale)) {
        judge_scatter(tissue, &region, &scale->levelling);
        return GSN_OK;
    }
    mean_covariance(f->d, scale, covariance);
    scale->levelling.vectors =
        gsn_vector_error_left_of(tissue, GSN_CONTROL_KINDS, &region, covariance);
    return GSN_OK;
}

/* The tissues where the region lies: there both specimens are compared, whatever sections each of
 * them lacks. */
static void judge_tissues(const struct panels_seen seen[GSN_CONTROL_KINDS],
                          const struct gsn_mask *region, struct gsn_normalisation *l)
{
    const struct gsn_control_frame frame = { &l->fit, l->share, height_of(region) };
    const struct gsn_control_seen *panel[GSN_CONTROL_TISSUES];
    size_t count[GSN_CONTROL_TISSUES];

    _Static_assert((int)GSN_CONTROL_KINDS == (int)GSN_CONTROL_TISSUES, "one list of tissues");
    for (size_t k = 0; k < GSN_CONTROL_KINDS; k++) {
        panel[k] = seen[k].panel;
        count[k] = seen[k].count;
    }
    gsn_control_tissues_at(&frame, panel, count, &l->tissues);
}

/* Fills the levelling's tissues, vectors and turns. Fails with GSN_E_NOMEM, GSN_E_STAIN. */
static int measure_tissues(struct tissue_field *f, struct gsn_scale *scale, struct gsn_error *err)
{
    gsn_auto_mem(struct sight) sight = gsn_alloc_array(f->at.nz, sizeof *sight);
    gsn_auto_mem(double) weight = gsn_alloc_array(f->at.nz, sizeof *weight);
    struct gsn_vector_error turned[GSN_CONTROL_KINDS] = { { 0 } };
    struct panels_seen seen[GSN_CONTROL_KINDS];
    int r = sight && weight ? GSN_OK
                            : gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a block");

    for (size_t z = 0; z < f->at.nz && r >= 0; z++)
        weight[z] = (double)list_region(f, z);
    for (unsigned k = 0; k < GSN_CONTROL_KINDS && r >= 0; k++)
        r = measure_kind(f, k, weight, scale, sight, &seen[k], &turned[k], err);
    if (r < 0)
        return r;
    judge_tissues(seen, f->region, &scale->levelling);
    return judge_turns(f, turned, scale, err);
}

/* ---- together ---------------------------------------------------------------------------- */

static int find_kinds(struct tissue_field *f, struct gsn_scale *scale, struct gsn_error *err)
{
    gsn_auto_mem(float) list = gsn_alloc_array(f->count, sizeof *list);
    gsn_auto(gsn_mask) root = NULL;
    struct gsn_tissue_levels levels = { 0 };
    double bone;
    int r = list ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a block");

    if (r < 0)
        return r;
    smooth_density(f->d->coarse->density, f);
    bone = bone_of(f, list);
    if (!(bone > 0))
        return GSN_OK;
    r = find_root(f->d->coarse, &root, &levels, err);
    if (r < 0)
        return r;
    tell_kinds(f, root, &levels, bone);
    return measure_tissues(f, scale, err);
}

int gsn_scale_find_tissues(const struct gsn_specimen *specimen, const struct gsn_mask *region,
                           const struct gsn_poses *poses, const struct gsn_densities *densities,
                           struct gsn_scale *scale, struct gsn_error *err)
{
    struct tissue_field f = {
        .specimen = specimen, .region = region, .poses = poses, .d = densities
    };
    int r;

    if (!densities->coarse || !scale->levelling.done || !region)
        return GSN_OK;
    r = field_init(&f, err);
    if (r >= 0)
        r = find_kinds(&f, scale, err);
    field_done(&f);
    return r;
}
