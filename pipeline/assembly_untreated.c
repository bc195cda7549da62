/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_untreated.h"

#include "pipeline/core/robust.h"
#include "pipeline/imaging/threshold.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/tissue_segmentation.h"

#include <math.h>
#include <string.h>

/* As the root is told (stain/tissue_segmentation.c): what is less than this of the red of bone is loose tissue,
 * what is more is bone. */
static const double LEAST_OF_BONE = 0.35, MOST_OF_BONE = 0.82;

/* A lesion does not end where the region does: nothing nearer is looked at, and of what is left the
 * half that is farther off. */
static const double SURROUNDINGS_UM = 300;

/* Columns from the border of a tissue: what is blurred over it is neither. */
enum { RIM = 2, LEAST_COLUMNS = 50 };

static void field_done(struct gsn_untreated_field *f)
{
    gsn_free(f->smooth);
    gsn_free(f->kind);
    gsn_grid_free(f->away);
    gsn_free(f->value);
    gsn_free(f->distance);
    gsn_free(f->column);
    gsn_free(f->scratch);
}

static int field_init(const struct gsn_lattice *at, const struct gsn_mask *region,
                      struct gsn_untreated_field *f, struct gsn_error *err)
{
    *f = (struct gsn_untreated_field){ .at = *at, .count = gsn_lattice_count(at) };
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

static void smoothen(const struct gsn_grid *density, struct gsn_untreated_field *f)
{
    for (size_t i = 0, z = 0; z < f->at.nz; z++)
        for (size_t y = 0; y < f->at.ny; y++)
            for (size_t x = 0; x < f->at.nx; x++, i++)
                f->smooth[i] = isnan(density->value[i]) ? NAN : mean_around(density, x, y, z);
}

/* The density of bone: the median of what lies above Otsu's cut; NaN where there is no tissue. */
static double bone_of(struct gsn_untreated_field *f, float *list)
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

static void tell_kinds(struct gsn_untreated_field *f, const struct gsn_mask *root,
                       const struct gsn_tissue_levels *levels, double bone)
{
    for (size_t i = 0; i < f->count; i++)
        f->kind[i] = isnan(f->smooth[i]) ? 0
                                         : kind_of((double)f->smooth[i], bone,
                                                   root && root->inside[i], levels->border);
}

/* Whether all columns around are of one kind. */
static int is_core(const struct gsn_untreated_field *f, size_t x, size_t y, size_t z)
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
static int is_untreated(const struct gsn_untreated_field *f, const struct gsn_mask *region,
                        uint8_t kind, size_t x, size_t y, size_t z)
{
    if (kind == 1 + GSN_UNTREATED_DENTINE)
        return !gsn_mask_has(region, gsn_lattice_centre(&f->at, x, y, z));
    return f->away->value[y * f->at.nx + x] > (float)SURROUNDINGS_UM;
}

/* Lists the tissue's columns in one section; returns how many. */
static size_t list_columns(const struct gsn_untreated_field *f, const struct gsn_assembly *a,
                           uint8_t kind, size_t z)
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
static size_t keep_far(struct gsn_untreated_field *f, size_t count)
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

double gsn_untreated_in(struct gsn_untreated_field *f, const struct gsn_assembly *a, uint8_t kind,
                        size_t z, size_t *ret_count)
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

static int find_kinds(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                      struct gsn_untreated_field *f, struct gsn_error *err)
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
    return gsn_untreated_measure(specimen, a, f, err);
}

int gsn_assembly_find_tissues(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                              struct gsn_error *err)
{
    struct gsn_untreated_field f;
    int r;

    if (!a->columns || !a->levelling.done || !a->region)
        return GSN_OK;
    r = field_init(&a->columns->density->at, a->region, &f, err);
    if (r >= 0)
        r = find_kinds(specimen, a, &f, err);
    field_done(&f);
    return r;
}
