/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The spline as others use it: what the pipeline's folders have, behind two opaque types.
 *
 * Method: a space is a DMS space (model/dms.h), a field is a spline on it; every function here
 * turns its arguments into those of the folder that does the work. The header says what each gives.
 *
 * Failure: that of the folder, handed on with its sentence. Cost: copies of masks. */
#include "pipeline/library/gieson-spline.h"

#include "pipeline/core/file.h"
#include "pipeline/core/parallel.h"
#include "pipeline/core/process.h"
#include "pipeline/export/cells_file.h"
#include "pipeline/export/surface_file.h"
#include "pipeline/export/volume_file.h"
#include "pipeline/measure/integral.h"
#include "pipeline/measure/level_set.h"
#include "pipeline/model/batch.h"
#include "pipeline/model/domain.h"
#include "pipeline/model/fit.h"
#include "pipeline/model/free_knots.h"
#include "pipeline/model/knots.h"
#include "pipeline/model/model_file.h"
#include "pipeline/model/resample.h"
#include "pipeline/render/isosurface.h"

#include <assert.h>
#include <math.h>
#include <string.h>
#include <strings.h>

struct gsn_space {
    struct gsn_dms *dms;
};
GSN_DEFINE_AUTO(gsn_space);

struct gsn_field {
    const struct gsn_space *space;
    struct gsn_spline *spline;
    struct gsn_space *own; /* the space, when the field came from a file or has knots of its own */
};
GSN_DEFINE_AUTO(gsn_field);

/* --- voxels --- */

static struct gsn_lattice lattice_of(const struct gsn_voxels *voxels)
{
    return (struct gsn_lattice){
        .nx = voxels->size[0],
        .ny = voxels->size[1],
        .nz = voxels->size[2],
        .origin_um = { voxels->origin[0], voxels->origin[1], voxels->origin[2] },
        .step_um = { voxels->step[0], voxels->step[1], voxels->step[2] },
    };
}

/* gives: the region, every voxel 0 or 1. */
static int copy_region(const struct gsn_voxels *voxels, struct gsn_mask **ret_mask,
                       struct gsn_error *err)
{
    const struct gsn_lattice at = lattice_of(voxels);
    const int r = gsn_mask_new(&at, ret_mask, err);

    for (size_t i = 0; r >= 0 && i < gsn_lattice_count(&at); i++)
        (*ret_mask)->inside[i] = !voxels->inside || voxels->inside[i] != 0;
    return r;
}

/* --- where fields live --- */

/* Radius by altitude: as gieson itself takes it. */
static const double CLOUD = 0.015;
enum { DEGREE = 2 };

static int make_space(const struct gsn_tets *mesh, const struct gsn_space_options *options,
                      struct gsn_space **ret_space, struct gsn_error *err)
{
    const unsigned degree = options && options->degree ? options->degree : DEGREE;
    const double cloud = options && options->cloud != 0 ? options->cloud : CLOUD;
    const double(*knots)[3] = options ? options->knots : NULL;
    gsn_auto(gsn_space) space = gsn_alloc_array(1, sizeof *space);
    double(*made)[3] = NULL;
    int r = GSN_OK;

    if (!space)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a space");
    if (!knots)
        r = gsn_dms_clouds(mesh, degree, cloud, &made, err);
    if (r >= 0)
        r = gsn_dms_new(mesh, degree, knots ? knots : (const double(*)[3])made, GSN_DMS_SHARED,
                        &space->dms, err);
    gsn_free(made);
    if (r >= 0)
        *ret_space = gsn_steal(&space);
    return r;
}

int gsn_space_new(const double (*point)[3], size_t points, const uint32_t (*tet)[4], size_t tets,
                  const struct gsn_space_options *options, struct gsn_space **ret_space,
                  struct gsn_error *err)
{
    gsn_auto(gsn_tets) mesh = NULL;
    const int r = gsn_tets_new(point, points, tet, tets, &mesh, err);

    return r < 0 ? r : make_space(mesh, options, ret_space, err);
}

/* The cells that cover the region, by the edge wanted; and the largest tetrahedron, by the regular
 * one of that edge: as gieson itself does. */
static const double CELL = 0.6, LARGEST = 1.5;

/* What is asked of the mesher. gives: ret_installed, which the options keep. */
static int find_mesher(double edge, const struct gsn_space_options *options, char **ret_installed,
                       struct gsn_domain_options *ret_domain, struct gsn_error *err)
{
    struct gsn_domain_options domain = { .mesher = options ? options->mesher : NULL,
                                         .cell_um = CELL * edge,
                                         .max_tet_um3 =
                                             LARGEST * edge * edge * edge / 6 / M_SQRT2 };
    const int r = domain.mesher ? GSN_OK : gsn_process_sibling("gieson-mesh", ret_installed, err);

    if (r < 0)
        return r;
    if (!domain.mesher)
        domain.mesher = *ret_installed;
    *ret_domain = domain;
    return GSN_OK;
}

int gsn_space_cover(const struct gsn_voxels *region, double edge,
                    const struct gsn_space_options *options, struct gsn_space **ret_space,
                    struct gsn_error *err)
{
    struct gsn_domain_options domain;
    gsn_auto_mem(char) installed = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    gsn_auto(gsn_tets) mesh = NULL;
    int r = find_mesher(edge, options, &installed, &domain, err);

    if (r >= 0)
        r = copy_region(region, &mask, err);
    if (r >= 0)
        r = gsn_domain_build(mask, &domain, &mesh, err);
    return r < 0 ? r : make_space(mesh, options, ret_space, err);
}

/* Edges of the region's rim and of the largest tetrahedra by the walls': away from walls a field is
 * smooth, and few tetrahedra do. */
static const double RIM = 1.6, AWAY = 3;

int gsn_space_follow(const struct gsn_voxels *region, const double *value, double edge,
                     const struct gsn_space_options *options, struct gsn_space **ret_space,
                     struct gsn_error *err)
{
    const struct gsn_wall_options walls = { .edge_um = edge, .rim_um = RIM * edge };
    struct gsn_domain_options domain;
    struct gsn_domain_report report;
    gsn_auto_mem(char) installed = NULL;
    gsn_auto(gsn_mask) mask = NULL;
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto(gsn_tets) mesh = NULL;
    int r = find_mesher(AWAY * edge, options, &installed, &domain, err);

    if (r >= 0 && !(edge > 0))
        r = gsn_fail(err, GSN_E_INPUT, "an edge of %g", edge);
    if (r >= 0)
        r = copy_region(region, &mask, err);
    if (r >= 0)
        r = gsn_grid_new(&mask->at, &grid, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++)
        grid->value[i] = (float)value[i];
    r = gsn_domain_follow(grid, mask, &walls, &domain, &mesh, &report, err);
    return r < 0 ? r : make_space(mesh, options, ret_space, err);
}

void gsn_space_free(struct gsn_space *space)
{
    if (!space)
        return;
    gsn_dms_free(space->dms);
    gsn_free(space);
}

size_t gsn_space_points(const struct gsn_space *space, const double (**ret_point)[3])
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space->dms);

    if (ret_point)
        *ret_point = (const double(*)[3])mesh->vertex;
    return mesh->vertex_count;
}

size_t gsn_space_tets(const struct gsn_space *space, const uint32_t (**ret_tet)[4])
{
    const struct gsn_tets *mesh = gsn_dms_mesh(space->dms);

    if (ret_tet)
        *ret_tet = (const uint32_t(*)[4])mesh->tet;
    return mesh->tet_count;
}

const double (*gsn_space_knots(const struct gsn_space *space))[3]
{
    return gsn_dms_knots(space->dms);
}

unsigned gsn_space_degree(const struct gsn_space *space)
{
    return gsn_dms_degree(space->dms);
}

size_t gsn_space_unknowns(const struct gsn_space *space)
{
    return gsn_dms_controls(space->dms);
}

/* --- fields and fits --- */

/* Takes spline, also when it fails. */
static int wrap_spline(const struct gsn_space *space, struct gsn_spline *spline,
                       struct gsn_field **ret_field, struct gsn_error *err)
{
    struct gsn_field *field = gsn_alloc_array(1, sizeof *field);

    if (!field) {
        gsn_spline_free(spline);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a field");
    }
    field->space = space;
    field->spline = spline;
    *ret_field = field;
    return GSN_OK;
}

int gsn_field_new(const struct gsn_space *space, const double *control,
                  struct gsn_field **ret_field, struct gsn_error *err)
{
    struct gsn_spline *spline = NULL;
    const int r = gsn_spline_new(space->dms, control, &spline, err);

    return r < 0 ? r : wrap_spline(space, spline, ret_field, err);
}

void gsn_field_free(struct gsn_field *field)
{
    if (!field)
        return;
    gsn_spline_free(field->spline);
    gsn_space_free(field->own);
    gsn_free(field);
}

const struct gsn_space *gsn_field_space(const struct gsn_field *field)
{
    return field->space;
}

const double *gsn_field_controls(const struct gsn_field *field)
{
    return gsn_spline_controls(field->spline);
}

static struct gsn_fit_options fit_options(const struct gsn_data *data,
                                          const struct gsn_field_options *options)
{
    if (!options)
        return (struct gsn_fit_options){ .smoothing = GSN_FIT_SMOOTHING,
                                         .fold = data->fold,
                                         .forgiving = 1 };
    return (struct gsn_fit_options){ .smoothing = options->smoothing,
                                     .jump = options->jump,
                                     .fold = data->fold,
                                     .tolerance = options->tolerance,
                                     .iterations = options->iterations,
                                     .threads = options->threads,
                                     .forgiving = !options->strict,
                                     .progress = options->progress };
}

static struct gsn_field_report report_of(const struct gsn_fit_report *fit)
{
    return (struct gsn_field_report){ .unknowns = fit->unknowns,
                                      .samples = fit->samples,
                                      .outside = fit->outside,
                                      .first_outside = fit->first_outside,
                                      .empty_tets = fit->empty_tets,
                                      .iterations = fit->iterations,
                                      .unconverged = fit->unconverged,
                                      .rms = fit->rms,
                                      .worst = fit->worst,
                                      .jump = fit->jump,
                                      .predicted = fit->predicted };
}

/* All splines as fields, or none. Takes the splines. */
static int wrap_splines(const struct gsn_space *space, struct gsn_spline **spline, size_t count,
                        struct gsn_field **ret_field, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_field *) made = gsn_alloc_array(count, sizeof *made);
    int r = made ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu fields", count);

    for (size_t c = 0; c < count; c++)
        if (r >= 0)
            r = wrap_spline(space, spline[c], &made[c], err);
        else
            gsn_spline_free(spline[c]);
    for (size_t c = 0; made && c < count; c++)
        if (r >= 0)
            ret_field[c] = made[c];
        else
            gsn_field_free(made[c]);
    return r;
}

int gsn_field_fit_many(const struct gsn_space *space, const struct gsn_data *data,
                       const double *const *value, size_t channels,
                       const struct gsn_field_options *options, struct gsn_field **ret_field,
                       struct gsn_field_report *ret_report, struct gsn_error *err)
{
    const struct gsn_samples samples = { .count = data->count,
                                         .at = data->at,
                                         .weight = data->weight };
    const struct gsn_fit_options fit = fit_options(data, options);
    gsn_auto_mem(struct gsn_spline *) spline = gsn_alloc_array(channels, sizeof *spline);
    gsn_auto_mem(struct gsn_fit_report) report = gsn_alloc_array(channels, sizeof *report);
    int r;

    assert(space && value && ret_field);
    if (channels == 0)
        return gsn_fail(err, GSN_E_INPUT, "there are no channels to fit");
    if (!spline || !report)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu channels", channels);
    r = gsn_fit_channels(space->dms, &samples, value, channels, &fit, spline, report, err);
    if (r >= 0)
        r = wrap_splines(space, spline, channels, ret_field, err);
    for (size_t c = 0; r >= 0 && ret_report && c < channels; c++)
        ret_report[c] = report_of(&report[c]);
    return r;
}

int gsn_field_fit(const struct gsn_space *space, const struct gsn_data *data,
                  const struct gsn_field_options *options, struct gsn_field **ret_field,
                  struct gsn_field_report *ret_report, struct gsn_error *err)
{
    return gsn_field_fit_many(space, data, &data->value, 1, options, ret_field, ret_report, err);
}

int gsn_field_fit_free(const struct gsn_space *space, const struct gsn_data *data,
                       const struct gsn_field_options *options, unsigned steps,
                       struct gsn_field **ret_field, struct gsn_free_report *ret_free,
                       struct gsn_field_report *ret_report, struct gsn_error *err)
{
    const struct gsn_samples samples = {
        .count = data->count, .at = data->at, .exact = data->value, .weight = data->weight
    };
    const unsigned most = steps > 0 ? steps : 16;
    const struct gsn_free_knots_options free_options = { .fit = fit_options(data, options),
                                                         .vertex_steps = most,
                                                         .cloud_steps = most / 4 };
    gsn_auto(gsn_space) own = gsn_alloc_array(1, sizeof *own);
    struct gsn_free_knots_report report;
    struct gsn_spline *spline = NULL;
    int r;

    assert(space && ret_field);
    if (!own)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a space");
    r = gsn_free_knots(space->dms, &samples, &free_options, &own->dms, &spline, &report, err);
    if (r >= 0)
        r = wrap_spline(own, spline, ret_field, err);
    if (r < 0)
        return r;
    (*ret_field)->own = gsn_steal(&own);
    if (ret_free)
        *ret_free = (struct gsn_free_report){ report.rms_fixed, report.rms_vertices,
                                              report.vertex_steps, report.cloud_steps };
    if (ret_report)
        *ret_report = report_of(&report.fit);
    return GSN_OK;
}

int gsn_field_insert(const struct gsn_field *field, const double (*knots)[3],
                     struct gsn_field **ret_field, struct gsn_error *err)
{
    gsn_auto(gsn_space) own = gsn_alloc_array(1, sizeof *own);
    gsn_auto_mem(double) control = NULL;
    struct gsn_spline *spline = NULL;
    size_t tet;
    int r;

    assert(field && knots && ret_field);
    if (!own)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a space");
    if (gsn_dms_locate(field->space->dms, knots[0], 0, &tet) != GSN_OK)
        return gsn_fail(err, GSN_E_INPUT, "the new vertex does not lie in the mesh");
    r = gsn_insert_vertex(field->spline, tet, knots, &own->dms, &control, err);
    if (r >= 0)
        r = gsn_spline_new(own->dms, control, &spline, err);
    if (r >= 0)
        r = wrap_spline(own, spline, ret_field, err);
    if (r >= 0)
        (*ret_field)->own = gsn_steal(&own);
    return r;
}

/* --- values --- */

int gsn_field_at(const struct gsn_field *field, const double (*at)[3], size_t count,
                 unsigned threads, double *ret_value, double (*ret_gradient)[3],
                 struct gsn_error *err)
{
    return gsn_spline_eval_many(field->spline, at, count, threads, ret_value, ret_gradient, err);
}

void gsn_field_hessian(const struct gsn_field *field, const double (*at)[3], size_t count,
                       double (*ret_hessian)[6])
{
    size_t hint = 0;

    for (size_t i = 0; i < count; i++)
        if (gsn_spline_hessian(field->spline, at[i], &hint, ret_hessian[i]) != GSN_OK)
            for (int k = 0; k < 6; k++)
                ret_hessian[i][k] = NAN;
}

int gsn_field_on_grid(const struct gsn_field *field, const struct gsn_voxels *grid,
                      unsigned threads, double *ret_value, struct gsn_error *err)
{
    const struct gsn_lattice at = lattice_of(grid);

    return gsn_spline_resample(field->spline, &at, threads, ret_value, err);
}

/* --- integrals --- */

int gsn_field_segment(const struct gsn_field *field, const double a[3], const double b[3],
                      double *ret_integral, double *ret_length, struct gsn_error *err)
{
    double integral = 0, length = 0;
    int r = gsn_spline_segment(field->spline, a, b, &integral, err);

    if (r >= 0 && ret_length)
        r = gsn_segment_inside(gsn_dms_mesh(field->space->dms), a, b, &length, err);
    if (r < 0)
        return r;
    *ret_integral = integral;
    if (ret_length)
        *ret_length = length;
    return GSN_OK;
}

double gsn_field_line(const struct gsn_field *field, const double p[3], const double d[3])
{
    return gsn_spline_line(field->spline, p, d);
}

int gsn_field_integral(const struct gsn_field *field, unsigned threads, double *ret_integral,
                       double *ret_volume, struct gsn_error *err)
{
    return gsn_domain_integral(field->spline, threads, ret_volume, ret_integral, err);
}

struct means {
    const struct gsn_spline *spline;
    double *mean;
};

static int find_mean(size_t tet, void *context, struct gsn_error *err)
{
    const struct means *means = context;

    return gsn_spline_tet_mean(means->spline, tet, &means->mean[tet], err);
}

int gsn_field_means(const struct gsn_field *field, unsigned threads, double *ret_mean,
                    struct gsn_error *err)
{
    struct means means = { field->spline, ret_mean };

    return gsn_parallel_for(gsn_space_tets(field->space, NULL), threads, find_mean, &means, err);
}

/* --- certain bounds --- */

int gsn_field_volume_above(const struct gsn_field *field, const struct gsn_voxels *region,
                           const double *threshold, size_t count, double gap, unsigned threads,
                           const struct gsn_progress *progress, struct gsn_field_volume *ret_volume,
                           struct gsn_error *err)
{
    const struct gsn_level_set_options options = { .gap = gap,
                                                   .threads = threads,
                                                   .progress = progress };
    gsn_auto_mem(struct gsn_volume_bound) bound = gsn_alloc_array(count, sizeof *bound);
    gsn_auto(gsn_mask) mask = NULL;
    int r;

    if (!bound)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu thresholds", count);
    r = copy_region(region, &mask, err);
    if (r >= 0)
        r = gsn_level_set_volume(field->spline, mask, threshold, count, &options, bound, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        ret_volume[i] =
            (struct gsn_field_volume){ bound[i].threshold, bound[i].lower_um3, bound[i].upper_um3 };
    return r;
}

/* --- files --- */

/* Larger than any model: what does not fit into memory is refused by then. */
static const size_t MOST_BYTES = (size_t)1 << 36;

int gsn_field_save(const struct gsn_field *field, const char *name, const char *path,
                   struct gsn_error *err)
{
    const struct gsn_model_cells cells = { .density = NULL };
    const struct gsn_model_notes notes = { .name = name ? name : "",
                                           .parameters = "{}",
                                           .version = GSN_VERSION };
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    const int r =
        gsn_model_file_write(field->spline, NULL, &cells, NULL, &notes, &bytes, &size, err);

    return r < 0 ? r : gsn_file_write(path, bytes, size, err);
}

int gsn_field_load(const char *path, struct gsn_field **ret_field, struct gsn_error *err)
{
    gsn_auto(gsn_model) model = NULL;
    gsn_auto(gsn_space) space = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_field *field = NULL;
    size_t size = 0;
    int r = gsn_file_read(path, MOST_BYTES, &bytes, &size, err);

    if (r >= 0)
        r = gsn_model_file_read(bytes, size, &model, err);
    if (r < 0)
        return r;
    space = gsn_alloc_array(1, sizeof *space);
    if (!space)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a space");
    r = wrap_spline(space, gsn_steal(&model->spline), &field, err);
    if (r < 0)
        return r;
    space->dms = gsn_steal(&model->space);
    field->own = gsn_steal(&space);
    *ret_field = field;
    return GSN_OK;
}

static int ends_with(const char *path, const char *ending)
{
    const size_t length = strlen(path), tail = strlen(ending);

    return length > tail && strcasecmp(path + length - tail, ending) == 0;
}

static int refuse_ending(const char *path, const char *known, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_UNSUPPORTED, "%s: the name must end in %s", path, known);
}

int gsn_field_write_cells(const struct gsn_field *field, const char *path, struct gsn_error *err)
{
    const int csv = ends_with(path, ".csv");
    gsn_auto_mem(double) mean = gsn_alloc_array(gsn_space_tets(field->space, NULL), sizeof *mean);
    const struct gsn_model model = { .space = field->space->dms,
                                     .spline = field->spline,
                                     .cells = { .density = mean } };
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    int r;

    if (!csv && !ends_with(path, ".vtu"))
        return refuse_ending(path, ".vtu or .csv", err);
    if (!mean)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the means of the tetrahedra");
    r = gsn_field_means(field, 0, mean, err);
    if (r >= 0)
        r = csv ? gsn_units_csv_write(&model, &bytes, &size, err)
                : gsn_vtu_write(&model, &bytes, &size, err);
    return r < 0 ? r : gsn_file_write(path, bytes, size, err);
}

int gsn_field_write_surface(const struct gsn_field *field, double level, double error,
                            const char *path, struct gsn_error *err)
{
    const struct gsn_isosurface_options options = { .level = level, .error_um = error };
    const int stl = ends_with(path, ".stl");
    gsn_auto(gsn_trimesh) surface = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    int r;

    if (!stl && !ends_with(path, ".ply"))
        return refuse_ending(path, ".stl or .ply", err);
    r = gsn_isosurface(field->spline, &options, &surface, err);
    if (r >= 0 && surface->triangle_count == 0)
        r = gsn_fail(err, GSN_E_INPUT, "the field is %g nowhere, so there is no surface", level);
    if (r >= 0)
        r = stl ? gsn_stl_write(surface, &bytes, &size, err)
                : gsn_ply_write(surface, &bytes, &size, err);
    return r < 0 ? r : gsn_file_write(path, bytes, size, err);
}

int gsn_field_write_grid(const struct gsn_field *field, const struct gsn_voxels *voxels,
                         const char *path, struct gsn_error *err)
{
    const int nrrd = ends_with(path, ".nrrd"), gzip = ends_with(path, ".nii.gz");
    const struct gsn_lattice at = lattice_of(voxels);
    gsn_auto(gsn_grid) grid = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    int r;

    if (!nrrd && !gzip && !ends_with(path, ".nii"))
        return refuse_ending(path, ".nrrd, .nii or .nii.gz", err);
    r = gsn_spline_grid(field->spline, &at, 0, &grid, err);
    if (r >= 0)
        r = nrrd ? gsn_nrrd_write(grid, &bytes, &size, err)
                 : gsn_nifti_write(grid, gzip, &bytes, &size, err);
    return r < 0 ? r : gsn_file_write(path, bytes, size, err);
}
