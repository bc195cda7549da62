/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/stain/order.h"
#include "pipeline/stain/reference.h"
#include "pipeline/stain/segment.h"
#include "pipeline/stain/tissue.h"

#include <math.h>
#include <string.h>

/* As the root is told (stain/tissue.c): what is less than this of the red of bone is loose tissue,
 * what is more is bone. */
static const double LEAST_OF_BONE = 0.35, MOST_OF_BONE = 0.82;

/* A lesion does not end where the region does: nothing nearer is looked at, and of what is left the
 * half that is farther off. */
static const double SURROUNDINGS_UM = 300;

/* Columns from the border of a tissue: what is blurred over it is neither. */
enum { RIM = 2, LEAST_COLUMNS = 50, LEAST_SECTIONS = 3 };

/* The work in hand: one value and one kind per column of the block. */
struct field {
    struct gsn_lattice at;
    size_t count;
    float *smooth;            /* owned: mean of 3 x 3 x 3 where there is tissue, else NaN */
    uint8_t *kind;            /* owned: 1 + enum gsn_untreated, 0 none */
    struct gsn_grid *away;    /* owned: of each column from the region, um */
    double *value, *distance; /* owned: of the columns of one plane that are looked at */
    size_t *column;           /* owned: which they are */
    double *scratch;
};

static void field_done(struct field *f)
{
    gsn_free(f->smooth);
    gsn_free(f->kind);
    gsn_grid_free(f->away);
    gsn_free(f->value);
    gsn_free(f->distance);
    gsn_free(f->column);
    gsn_free(f->scratch);
}

static int field_init(const struct gsn_lattice *at, const struct gsn_mask *region, struct field *f,
                      struct gsn_error *err)
{
    *f = (struct field){ .at = *at, .count = gsn_lattice_count(at) };
    f->smooth = gsn_alloc_array(f->count, sizeof *f->smooth);
    f->kind = gsn_alloc_array(f->count, 1);
    f->value = gsn_alloc_array(at->nx * at->ny, sizeof *f->value);
    f->distance = gsn_alloc_array(at->nx * at->ny, sizeof *f->distance);
    f->column = gsn_alloc_array(at->nx * at->ny, sizeof *f->column);
    f->scratch = gsn_alloc_array(f->count, sizeof *f->scratch);
    if (f->smooth && f->kind && f->value && f->distance && f->column && f->scratch)
        return gsn_columns_away(region, at, &f->away, err);
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

static void smoothen(const struct gsn_grid *density, struct field *f)
{
    for (size_t i = 0, z = 0; z < f->at.nz; z++)
        for (size_t y = 0; y < f->at.ny; y++)
            for (size_t x = 0; x < f->at.nx; x++, i++)
                f->smooth[i] = isnan(density->value[i]) ? NAN : mean_around(density, x, y, z);
}

/* The density of bone: the median of what lies above Otsu's cut; NaN where there is no tissue. */
static double bone_of(struct field *f, float *list)
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
static int find_root(const struct gsn_columns *columns, struct gsn_mask **ret_root,
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
        return value > border && value < MOST_OF_BONE * bone ? 1 + GSN_UNTREATED_DENTINE : 0;
    if (value >= MOST_OF_BONE * bone)
        return 1 + GSN_UNTREATED_DENSE;
    return value <= LEAST_OF_BONE * bone ? 1 + GSN_UNTREATED_LOOSE : 0;
}

static void tell_kinds(struct field *f, const struct gsn_mask *root,
                       const struct gsn_tissue_levels *levels, double bone)
{
    for (size_t i = 0; i < f->count; i++)
        f->kind[i] = isnan(f->smooth[i]) ? 0
                                         : kind_of((double)f->smooth[i], bone,
                                                   root && root->inside[i], levels->border);
}

/* Whether all columns around are of one kind. */
static int is_core(const struct field *f, size_t x, size_t y, size_t z)
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
static int is_untreated(const struct field *f, const struct gsn_mask *region, uint8_t kind,
                        size_t x, size_t y, size_t z)
{
    if (kind == 1 + GSN_UNTREATED_DENTINE)
        return !gsn_mask_has(region, gsn_lattice_centre(&f->at, x, y, z));
    return f->away->value[y * f->at.nx + x] > (float)SURROUNDINGS_UM;
}

/* Lists the tissue's columns in one section; returns how many. */
static size_t list_columns(const struct field *f, const struct gsn_assembly *a, uint8_t kind,
                           size_t z)
{
    size_t n = 0;

    for (size_t y = 0; y < f->at.ny; y++)
        for (size_t x = 0; x < f->at.nx; x++) {
            const size_t i = gsn_lattice_index(&f->at, x, y, z);

            if (f->kind[i] != kind || !is_core(f, x, y, z) ||
                !is_untreated(f, a->region, kind, x, y, z))
                continue;
            f->value[n] = (double)a->columns->density->value[i];
            f->column[n] = i;
            f->distance[n++] = (double)f->away->value[y * f->at.nx + x];
        }
    return n;
}

/* Keeps the half of the columns that is farther from the region; returns how many that are. */
static size_t keep_far(struct field *f, size_t count)
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

/* Adds the first count columns, as a panel's vectors see them. */
static int add_turned(const struct field *f, const struct gsn_assembly *a,
                      const struct gsn_assembly_panel *panel, size_t count,
                      struct gsn_turned *turned, struct gsn_error *err)
{
    const struct gsn_dyes_fit *fit = &panel->stain.fit;
    double od[3] = { 0 };

    if (count == 0)
        return GSN_OK;
    for (int c = 0; c < 3; c++)
        for (size_t i = 0; i < count; i++)
            od[c] += (double)a->columns->od[c]->value[f->column[i]] / (double)count;
    return gsn_turned_add(turned, &fit->dyes, od, (double)count, err);
}

/* The tissue's density in one section; NaN where too little of it is seen. ret_count: how many
 * columns it rests on. */
static double seen_in(struct field *f, const struct gsn_assembly *a, uint8_t kind, size_t z,
                      size_t *ret_count)
{
    size_t n = list_columns(f, a, kind, z);

    *ret_count = 0;
    if (n < LEAST_COLUMNS)
        return (double)NAN;
    if (kind != 1 + GSN_UNTREATED_DENTINE)
        n = keep_far(f, n);
    *ret_count = n;
    return gsn_reference_red(f->value, n);
}

/* ---- along the block ----------------------------------------------------------------------- */

/* One section of a tissue. */
struct sight {
    double z_um, value;
    const struct gsn_assembly_panel *panel;
};

/* What a panel's sections say together. */
static struct gsn_level_seen seen_on(const struct sight *sight, size_t count, double *scratch)
{
    struct gsn_level_seen seen = { .panel = sight->panel->place, .sections = count };
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
    struct gsn_level_seen panel[GSN_LEVEL_PANELS];
    size_t count;
};

static void sum_up(const struct sight *sight, size_t count, double *scratch,
                   struct panels_seen *ret_seen)
{
    ret_seen->count = 0;
    if (count < LEAST_SECTIONS)
        return;
    for (size_t i = 0, end; i < count && ret_seen->count < GSN_LEVEL_PANELS; i = end) {
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
                                                 struct gsn_assembly *a, const struct field *f,
                                                 size_t z)
{
    const struct gsn_assembly_panel *panel = gsn_assembly_panel_of_serial(
        a, gsn_assembly_serial_of_plane(&f->at, z, specimen->protocol->interval_um));

    return panel && panel->levelled ? panel : NULL;
}

static int measure_kind(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                        struct field *f, unsigned kind, struct sight *sight,
                        struct panels_seen *seen, struct gsn_turned *turned, struct gsn_error *err)
{
    size_t n = 0;
    int r = GSN_OK;

    for (size_t z = 0; z < f->at.nz && r >= 0; z++) {
        const struct gsn_assembly_panel *of = panel_of(specimen, a, f, z);
        size_t columns;

        if (!of)
            continue;
        sight[n] = (struct sight){ f->at.origin_um.z + (double)z * f->at.step_um.z,
                                   seen_in(f, a, (uint8_t)(1 + kind), z, &columns), of };
        n += isnan(sight[n].value) ? 0 : 1;
        r = add_turned(f, a, of, columns, turned, err);
    }
    sum_up(sight, n, f->scratch, seen);
    return r;
}

/* Lists the region's columns in one section; returns how many. */
static size_t list_region(const struct field *f, const struct gsn_assembly *a, size_t z)
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
static void mean_covariance(const struct gsn_assembly *a, double ret[GSN_DYE_TURNS][GSN_DYE_TURNS])
{
    for (size_t p = 0; p < a->panel_count; p++)
        for (int m = 0; m < GSN_DYE_TURNS && a->panel[p].levelled; m++)
            for (int n = 0; n < GSN_DYE_TURNS; n++)
                ret[m][n] += a->panel[p].stain.fit.covariance[m][n] / (double)a->levelling.panels;
}

/* What density 0 scatters by from panel to panel, beyond what levelling errs by: variance. */
static double zero_variance(const struct gsn_levelling *l)
{
    double erring = 0;

    for (size_t p = 0; p < l->panels; p++) {
        double lever[GSN_LEVEL_PANELS];

        for (size_t i = 0; i < l->panels; i++)
            lever[i] = (i == p) - 1 / (double)l->panels;
        erring += gsn_level_covariance(&l->fit, lever, 0, lever, 0) / ((double)l->panels - 1);
    }
    return fmax(0, l->fit.offset_scatter * l->fit.offset_scatter - erring);
}

/* Vectors that were taken as exact are not: each panel's bath turns them a little, and yellow that
 * counts as red is an offset. The mean over the region's panels keeps a share of independent turns.
 * Where they put density 0 the offsets say themselves. */
static void judge_scatter(const struct gsn_turned *tissue, const struct gsn_turned *region,
                          struct gsn_levelling *l)
{
    double covariance[GSN_DYE_TURNS][GSN_DYE_TURNS] = { { 0 } }, kept = 0;

    if (l->panels < 2)
        return;
    for (size_t p = 0; p < l->panels; p++)
        kept += l->share[p] * l->share[p];
    for (int m = 0; m < GSN_DYE_TURNS; m++)
        covariance[m][m] = kept;
    l->turns =
        gsn_turned_scatter_of(tissue, GSN_UNTREATED_KINDS, zero_variance(l), (double)l->panels - 1);
    l->vectors = gsn_turned_left_of(tissue, GSN_UNTREATED_KINDS, region, covariance);
    l->vectors.zero = l->vectors.both = 0;
}

static int judge_turns(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                       const struct field *f, const struct gsn_turned *tissue,
                       struct gsn_error *err)
{
    double covariance[GSN_DYE_TURNS][GSN_DYE_TURNS] = { { 0 } };
    struct gsn_turned region = { 0 };
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
    a->levelling.vectors = gsn_turned_left_of(tissue, GSN_UNTREATED_KINDS, &region, covariance);
    return GSN_OK;
}

/* The tissues where the region lies: there both specimens are compared, whatever sections each of
 * them lacks. */
static void judge_tissues(const struct panels_seen seen[GSN_UNTREATED_KINDS],
                          struct gsn_assembly *a)
{
    const struct gsn_level_frame frame = { &a->levelling.fit, a->levelling.share,
                                           height_of(a->region) };
    const struct gsn_level_seen *panel[GSN_LEVEL_TISSUES];
    size_t count[GSN_LEVEL_TISSUES];

    _Static_assert((int)GSN_UNTREATED_KINDS == (int)GSN_LEVEL_TISSUES, "one list of tissues");
    for (size_t k = 0; k < GSN_UNTREATED_KINDS; k++) {
        panel[k] = seen[k].panel;
        count[k] = seen[k].count;
    }
    gsn_level_tissues_at(&frame, panel, count, &a->levelling.tissues);
}

static int measure_kinds(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                         struct field *f, struct gsn_error *err)
{
    gsn_auto_mem(struct sight) sight = gsn_alloc_array(f->at.nz, sizeof *sight);
    struct gsn_turned turned[GSN_UNTREATED_KINDS] = { { 0 } };
    struct panels_seen seen[GSN_UNTREATED_KINDS];
    int r = sight ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a block");

    for (unsigned k = 0; k < GSN_UNTREATED_KINDS && r >= 0; k++)
        r = measure_kind(specimen, a, f, k, sight, &seen[k], &turned[k], err);
    if (r < 0)
        return r;
    judge_tissues(seen, a);
    return judge_turns(specimen, a, f, turned, err);
}

static int find_kinds(const struct gsn_specimen *specimen, struct gsn_assembly *a, struct field *f,
                      struct gsn_error *err)
{
    gsn_auto_mem(float) list = gsn_alloc_array(f->count, sizeof *list);
    gsn_auto(gsn_mask) root = NULL;
    struct gsn_tissue_levels levels = { 0 };
    double bone;
    int r = list ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for the tissue of a block");

    if (r < 0)
        return r;
    smoothen(a->columns->density, f);
    bone = bone_of(f, list);
    if (!(bone > 0))
        return GSN_OK;
    r = find_root(a->columns, &root, &levels, err);
    if (r < 0)
        return r;
    tell_kinds(f, root, &levels, bone);
    return measure_kinds(specimen, a, f, err);
}

int gsn_assembly_find_tissues(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                              struct gsn_error *err)
{
    struct field f;
    int r;

    if (!a->columns || !a->levelling.done || !a->region)
        return GSN_OK;
    r = field_init(&a->columns->density->at, a->region, &f, err);
    if (r >= 0)
        r = find_kinds(specimen, a, &f, err);
    field_done(&f);
    return r;
}
