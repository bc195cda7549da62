/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verb `export`: the model of a specimen's last run as a file of another program. The name's
 * ending says which. The store is only read; a file that exists is never written over.
 *
 * Surfaces and volumes end where the region of interest ends: what the spline says beyond is no
 * measurement. A surface is closed there: it bounds what is denser than the level in the region.
 * `--whole` takes the whole domain, where it is open. */
#include <math.h>
#include <string.h>
#include <strings.h>
#include <sysexits.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/mem.h"
#include "pipeline/export/cells_file.h"
#include "pipeline/export/ome_tiff.h"
#include "pipeline/export/surface_file.h"
#include "pipeline/export/volume_file.h"
#include "pipeline/model/resample.h"
#include "systemd/worker/kept_run.h"
#include "systemd/worker/work_verbs.h"

static const double MOST_VOXELS = 1 << 28; /* 2 GiB of numbers */

/* Of a voxel, that triangles may lie from the surface. */
static const double SURFACE_WITHIN = 0.1;

enum kind { KIND_MODEL, KIND_SURFACE, KIND_VOLUME, KIND_STACK };

struct export;

struct format {
    const char *ending;
    enum kind kind;
    int (*make)(struct export *e, struct gsn_error *err);
    int (*write)(const struct gsn_trimesh *surface, uint8_t **ret_bytes, size_t *ret_size,
                 struct gsn_error *err); /* of surfaces */
};

/* What is asked for, and what has been made of it. */
struct export
{
    const struct gsn_work_request *request;
    const char *file;
    const struct format *format;
    double level, step; /* NaN: not said */
    struct gsn_store *store;
    struct gsn_kept_run *kept;
    struct gsn_model *model;
    uint8_t *bytes;
    size_t size;
    char said[200]; /* what is in the file */
    struct gsn_lattice at; /* of a stack; 0 else */
};

static void export_done(struct export *e)
{
    gsn_store_free(e->store);
    gsn_kept_run_free(e->kept);
    gsn_model_free(e->model);
    gsn_free(e->bytes);
}

/* ---- formats ------------------------------------------------------------------------------- */

static int make_vtkhdf(struct export *e, struct gsn_error *err)
{
    (void)snprintf(e->said, sizeof e->said, "%zu Bezier tetrahedra of degree %u",
                   gsn_dms_mesh(e->model->space)->tet_count, gsn_dms_degree(e->model->space));
    return gsn_kept_run_file(e->store, e->kept, "model.vtkhdf", &e->bytes, &e->size, err);
}

static int make_vtu(struct export *e, struct gsn_error *err)
{
    (void)snprintf(e->said, sizeof e->said, "%zu Bezier tetrahedra of degree %u",
                   gsn_dms_mesh(e->model->space)->tet_count, gsn_dms_degree(e->model->space));
    return gsn_vtu_write(e->model, &e->bytes, &e->size, err);
}

static int make_csv(struct export *e, struct gsn_error *err)
{
    (void)snprintf(e->said, sizeof e->said, "%zu micro-units",
                   gsn_dms_mesh(e->model->space)->tet_count);
    return gsn_units_csv_write(e->model, &e->bytes, &e->size, err);
}

/* The region that bounds surfaces and volumes; NULL for the whole domain. */
static int choose_region(const struct export *e, const struct gsn_mask **ret_region,
                         struct gsn_error *err)
{
    if (!e->request->whole && !e->model->region)
        return gsn_fail(
            err, GSN_E_NOTFOUND,
            "the model of run %lld, by gieson %s, does not say where the region is: add "
            "--whole for all of its domain, or `gieson night` computes it again",
            (long long)e->kept->run->id, e->kept->run->version);
    *ret_region = e->request->whole ? NULL : e->model->region;
    return GSN_OK;
}

static int make_surface(struct export *e, struct gsn_error *err)
{
    const struct gsn_mask *region;
    gsn_auto(gsn_border) border = NULL;
    gsn_auto(gsn_trimesh) surface = NULL;
    struct gsn_isosurface_options options = { .level = e->level, .threads = e->request->threads };
    double area, closing;
    int r = choose_region(e, &region, err);

    if (r < 0)
        return r;
    /* Within a part of the voxels that the model was fitted to, where these are known. */
    if (!isnan(e->step))
        options.edge_um = e->step;
    else if (e->model->region)
        options.error_um = SURFACE_WITHIN * fmin(e->model->region->at.step_um.x,
                                                 e->model->region->at.step_um.z);
    if (region)
        r = gsn_border_new(region, e->request->threads, &border, err);
    options.border = border;
    if (r >= 0)
        r = gsn_isosurface(e->model->spline, &options, &surface, err);
    if (r >= 0 && surface->triangle_count == 0)
        r = gsn_fail(err, GSN_E_INPUT, "the density is %g nowhere in %s, so there is no surface",
                     e->level, region ? "the region" : "the domain");
    if (r < 0)
        return r;
    area = gsn_trimesh_area(surface, &closing);
    (void)snprintf(e->said, sizeof e->said,
                   region ? "%zu triangles within %.2g um, %.4g mm2, at level %g, closed by %.4g "
                            "mm2 where the region ends"
                          : "%zu triangles within %.2g um, %.4g mm2, at level %g",
                   surface->triangle_count, surface->error_um, 1e-6 * (area - closing), e->level,
                   1e-6 * closing);
    return e->format->write(surface, &e->bytes, &e->size, err);
}

/* The box around the region's voxels, or around the domain. */
static void find_extent(const struct export *e, const struct gsn_mask *region, double low[3],
                        double high[3])
{
    const struct gsn_tets *mesh = gsn_dms_mesh(e->model->space);

    if (region) {
        gsn_mask_box(region, low, high);
        return;
    }
    for (int c = 0; c < 3; c++) {
        low[c] = INFINITY;
        high[c] = -INFINITY;
    }
    for (size_t v = 0; v < mesh->vertex_count; v++)
        for (int c = 0; c < 3; c++) {
            low[c] = fmin(low[c], mesh->vertex[v][c]);
            high[c] = fmax(high[c], mesh->vertex[v][c]);
        }
}

/* Without a step it is the region's own lattice. */
static int choose_lattice(const struct export *e, const struct gsn_mask *region,
                          struct gsn_lattice *ret_at, struct gsn_error *err)
{
    double low[3], high[3], count[3];

    if (isnan(e->step) && region) {
        *ret_at = region->at;
        return GSN_OK;
    }
    if (isnan(e->step))
        return gsn_fail(err, GSN_E_INPUT, "say how large the voxels are: --step UM");
    find_extent(e, region, low, high);
    for (int c = 0; c < 3; c++)
        count[c] = fmax(1, ceil((high[c] - low[c]) / e->step - 1e-9));
    if (count[0] * count[1] * count[2] > MOST_VOXELS)
        return gsn_fail(err, GSN_E_LIMIT,
                        "%.0f x %.0f x %.0f voxels are too many (%.0f at most): a larger --step",
                        count[0], count[1], count[2], MOST_VOXELS);
    *ret_at = (struct gsn_lattice){ .nx = (size_t)count[0],
                                    .ny = (size_t)count[1],
                                    .nz = (size_t)count[2],
                                    .origin_um = { low[0] + e->step / 2, low[1] + e->step / 2,
                                                   low[2] + e->step / 2 },
                                    .step_um = { e->step, e->step, e->step } };
    return GSN_OK;
}

static int make_volume(struct export *e, struct gsn_error *err)
{
    const struct gsn_mask *region;
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_lattice at;
    size_t filled = 0;
    int r = choose_region(e, &region, err);

    if (r >= 0)
        r = choose_lattice(e, region, &at, err);
    if (r >= 0)
        r = gsn_spline_grid(e->model->spline, &at, e->request->threads, &grid, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < gsn_lattice_count(&at); i++) {
        const int beyond =
            region && !gsn_mask_has(region, gsn_lattice_centre(&at, i % at.nx, i / at.nx % at.ny,
                                                               i / at.nx / at.ny));

        if (beyond)
            grid->value[i] = NAN;
        filled += isnan(grid->value[i]) ? 0 : 1;
    }
    (void)snprintf(e->said, sizeof e->said,
                   "%zu x %zu x %zu voxels of %g x %g x %g um, %zu with data", at.nx, at.ny, at.nz,
                   at.step_um.x, at.step_um.y, at.step_um.z, filled);
    if (strcasecmp(strrchr(e->file, '.'), ".nrrd") == 0)
        return gsn_nrrd_write(grid, &e->bytes, &e->size, err);
    return gsn_nifti_write(grid, strcasecmp(strrchr(e->file, '.'), ".gz") == 0, &e->bytes, &e->size,
                           err);
}

/* Of the true-colour stack beside the report; needs no model. */
static int make_stack(struct export *e, struct gsn_error *err)
{
    gsn_auto(gsn_colour_grid) stack = NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    int r = gsn_kept_run_file(e->store, e->kept, "colour.nrrd", &bytes, &size, err);

    if (r >= 0)
        r = gsn_colour_grid_read(bytes, size, &stack, err);
    if (r < 0)
        return r;
    e->at = stack->at;
    (void)snprintf(e->said, sizeof e->said, "%zu planes of %zu x %zu pixels", stack->at.nz,
                   stack->at.nx, stack->at.ny);
    return gsn_ome_tiff_write(stack, e->request->rest[0], &e->bytes, &e->size, err);
}

static const struct format formats[] = {
    { ".vtkhdf", KIND_MODEL, make_vtkhdf, NULL },
    { ".vtu", KIND_MODEL, make_vtu, NULL },
    { ".csv", KIND_MODEL, make_csv, NULL },
    { ".stl", KIND_SURFACE, make_surface, gsn_stl_write },
    { ".ply", KIND_SURFACE, make_surface, gsn_ply_write },
    { ".glb", KIND_SURFACE, make_surface, gsn_glb_write },
    { ".nrrd", KIND_VOLUME, make_volume, NULL },
    { ".nii", KIND_VOLUME, make_volume, NULL },
    { ".nii.gz", KIND_VOLUME, make_volume, NULL },
    { ".ome.tif", KIND_STACK, make_stack, NULL },
    { ".ome.tiff", KIND_STACK, make_stack, NULL },
};

/* ---- the verb ------------------------------------------------------------------------------ */

static const struct format *find_format(const char *file)
{
    for (size_t i = 0; i < sizeof formats / sizeof *formats; i++) {
        const size_t length = strlen(formats[i].ending), name = strlen(file);

        if (name > length && strcasecmp(file + name - length, formats[i].ending) == 0)
            return &formats[i];
    }
    return NULL;
}

/* Which options go with which formats; NULL: it is fine. */
static const char *find_mistake(const struct export *e, size_t levels)
{
    const struct format *const format = e->format;
    const int bounded = format && (format->kind == KIND_SURFACE || format->kind == KIND_VOLUME);

    if (!format)
        return "the file's ending says what to write: .vtkhdf, .vtu, .csv, .stl, .ply, .glb, "
               ".nrrd, .nii, .nii.gz or .ome.tif";
    if (format->kind == KIND_SURFACE && levels != 1)
        return "a surface is where the density has one value: say --level V";
    if (format->kind != KIND_SURFACE && levels > 0)
        return "--level is for surfaces, .stl, .ply and .glb";
    if (!bounded && !isnan(e->step))
        return "--step is for volumes and surfaces: .nrrd, .nii, .nii.gz, .stl, .ply, .glb";
    if (!isnan(e->step) && !(e->step > 0))
        return "--step is a length in micrometres, above 0";
    if (!bounded && e->request->whole)
        return "--whole is for volumes and surfaces: .nrrd, .nii, .nii.gz, .stl, .ply, .glb";
    return NULL;
}

/* The "stack" of a region that is drawn on it, in job.json. */
static json_t *describe_stack(const struct gsn_lattice *at)
{
    return json_pack("{s:[i,i,i], s:[f,f,f], s:[f,f,f]}", "size", (int)at->nx, (int)at->ny,
                     (int)at->nz, "pixel_um", at->step_um.x, at->step_um.y, at->step_um.z,
                     "origin_um", at->origin_um.x, at->origin_um.y, at->origin_um.z);
}

static void say_export(const struct export *e)
{
    json_t *stack = e->at.nx ? describe_stack(&e->at) : NULL;

    if (e->request->json) {
        json_t *root =
            json_pack("{s:o, s:I, s:o, s:I, s:s}", "specimen", gsn_work_text(e->request->rest[0]),
                      "run", (json_int_t)e->kept->run->id, "file", gsn_work_text(e->file), "bytes",
                      (json_int_t)e->size, "holds", e->said);

        if (stack)
            (void)json_object_set_new(root, "stack", stack);
        (void)json_dumpf(root, stdout, JSON_INDENT(2));
        (void)putchar('\n');
        json_decref(root);
        return;
    }
    gsn_work_print(stdout, "%s: %s; run %lld of %s\n", e->file, e->said,
                   (long long)e->kept->run->id, e->request->rest[0]);
    if (!stack)
        return;
    (void)fputs("a region drawn on it: \"region\": {\"kind\": \"drawn\", \"file\": "
                "\"FILE.geojson\", \"stack\": ",
                stdout);
    (void)json_dumpf(stack, stdout, JSON_REAL_PRECISION(10));
    (void)fputs("}\n", stdout);
    json_decref(stack);
}

int gsn_work_export(const struct gsn_work_request *request)
{
    struct export e
        __attribute__((cleanup(export_done))) = { .request = request, .level = NAN, .step = NAN };
    const size_t levels = json_array_size(request->levels);
    const char *mistake;
    struct gsn_error err = { 0 };
    int r;

    if (request->rest_count != 2)
        return gsn_work_usage(request,
                              "export what, and where to? Say `gieson export SPECIMEN FILE`");
    e.file = request->rest[1];
    e.format = find_format(e.file);
    if (levels == 1)
        e.level = json_number_value(json_array_get(request->levels, 0));
    if (request->step && !gsn_work_numbers(request->step, 1, &e.step))
        return gsn_work_usage(request, "--step is a length in micrometres, above 0");
    mistake = find_mistake(&e, levels);
    if (mistake)
        return gsn_work_usage(request, mistake);
    if (access(e.file, F_OK) == 0)
        return gsn_work_usage(request,
                              "that file exists already, and export writes over none: remove it, "
                              "or say another name");
    r = gsn_store_open(request->store_dir, GSN_STORE_READ, &e.store, &err);
    if (r >= 0)
        r = gsn_kept_run_open(e.store, request->rest[0], &e.kept, &err);
    if (r >= 0 && e.format->kind != KIND_STACK)
        r = gsn_kept_run_model(e.store, e.kept, &e.model, &err);
    if (r >= 0)
        r = e.format->make(&e, &err);
    if (r >= 0)
        r = gsn_file_write(e.file, e.bytes, e.size, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    say_export(&e);
    return EX_OK;
}
