/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs that ask the model of a specimen's last run: `probe` at a point, `line` along a segment
 * (equations (7), (8)), `integral` over the region, a box of it, a plane through it or the whole
 * domain (equation (9)), with certified volumes above a level (equation (10)). The store is only
 * read. Micrometres of the block frame go in; volumes come out in mm3.
 *
 * Each verb fills a JSON object, which `--json` prints as it is, and from which the words are made:
 * both say the same. */
#include <math.h>
#include <string.h>
#include <sysexits.h>

#include "pipeline/core/mem.h"
#include "pipeline/core/srgb.h"
#include "pipeline/measure/density.h"
#include "pipeline/measure/integral.h"
#include "pipeline/measure/level_set.h"
#include "pipeline/model/batch.h"
#include "systemd/worker/kept_run.h"
#include "systemd/worker/work_verbs.h"

enum {
    PROFILE = 33,
    MOST_PROFILE = 100000,
    MOST_LEVELS = 8,
    NEAREST_SECTIONS = 2,
    MOST_CELLS =
        2000000 /* as a run takes (pipeline/specimen/analysis.c): the same bounds as its report */
};

struct asked {
    const struct gsn_work_request *request;
    struct gsn_store *store;
    struct gsn_kept_run *kept;
    struct gsn_model *model;
    json_t *root;
};

static void asked_done(struct asked *a)
{
    gsn_store_free(a->store);
    gsn_kept_run_free(a->kept);
    gsn_model_free(a->model);
    json_decref(a->root);
}

static int open_model(const struct gsn_work_request *request, struct asked *a,
                      struct gsn_error *err)
{
    int r = gsn_store_open(request->store_dir, GSN_STORE_READ, &a->store, err);

    a->request = request;
    if (r >= 0)
        r = gsn_kept_run_open(a->store, request->rest[0], &a->kept, err);
    if (r >= 0)
        r = gsn_kept_run_model(a->store, a->kept, &a->model, err);
    if (r < 0)
        return r;
    a->root = json_pack("{s:o, s:I}", "specimen", gsn_work_text(request->rest[0]), "run",
                        (json_int_t)a->kept->run->id);
    return a->root ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory for an answer");
}

/* JSON has no NaN. */
static json_t *number_of(double value)
{
    return isfinite(value) ? json_real(value) : json_null();
}

static json_t *numbers_of(const double *value, size_t count)
{
    json_t *list = json_array();

    for (size_t i = 0; i < count; i++)
        (void)json_array_append_new(list, number_of(value[i]));
    return list;
}

static void put_member(json_t *object, const char *key, json_t *value)
{
    (void)json_object_set_new(object, key, value);
}

/* A number of the answer; NaN where it has none. */
static double get_number(const json_t *object, const char *key)
{
    const json_t *const value = json_object_get(object, key);

    return json_is_number(value) ? json_number_value(value) : NAN;
}

static int print_json(const json_t *root)
{
    (void)json_dumpf(root, stdout, JSON_INDENT(2) | JSON_REAL_PRECISION(17));
    (void)putchar('\n');
    return EX_OK;
}

static int is_in_region(const struct gsn_model *model, const double u[3])
{
    return model->region && gsn_mask_has(model->region, gsn_vec3_make(u[0], u[1], u[2]));
}

static const struct gsn_mask *require_region(const struct asked *a, struct gsn_error *err)
{
    if (!a->model->region)
        (void)gsn_fail(err, GSN_E_NOTFOUND,
                       "the model of run %lld, by gieson %s, does not say where the region is: "
                       "`gieson night` computes it again, and --whole takes all of its domain",
                       (long long)a->kept->run->id, a->kept->run->version);
    return a->model->region;
}

/* Refuses a point with the box that the model fills. */
static int say_outside(const struct asked *a, const double u[3], struct gsn_error *err)
{
    const struct gsn_tets *mesh = gsn_dms_mesh(a->model->space);
    double low[3] = { INFINITY, INFINITY, INFINITY }, high[3] = { -INFINITY, -INFINITY, -INFINITY };

    for (size_t v = 0; v < mesh->vertex_count; v++)
        for (int c = 0; c < 3; c++) {
            low[c] = fmin(low[c], mesh->vertex[v][c]);
            high[c] = fmax(high[c], mesh->vertex[v][c]);
        }
    return gsn_fail(err, GSN_E_INPUT,
                    "(%g, %g, %g) um lies outside the model, where there is no data: it lies "
                    "between (%g, %g, %g) and (%g, %g, %g) um and does not fill that box",
                    u[0], u[1], u[2], low[0], low[1], low[2], high[0], high[1], high[2]);
}

/* ---- probe --------------------------------------------------------------------------------- */

/* What the file says of a tetrahedron, and between what values s certainly lies in it. */
static json_t *describe_cell(const struct gsn_model *model, size_t tet)
{
    const size_t functions = gsn_dms_functions(model->space);
    double coefficient[GSN_DMS_MAX_FUNCTIONS], low, high, least = INFINITY, most = -INFINITY;
    json_t *cell = json_object();

    gsn_spline_bernstein(model->spline, tet, coefficient);
    gsn_spline_residual(model->spline, tet, &low, &high);
    for (size_t f = 0; f < functions; f++) {
        least = fmin(least, coefficient[f]);
        most = fmax(most, coefficient[f]);
    }
    put_member(cell, "number", json_integer((json_int_t)tet));
    put_member(cell, "volume_um3", number_of(gsn_tets_volume(gsn_dms_mesh(model->space), tet)));
    put_member(cell, "density",
               number_of(model->cells.density ? model->cells.density[tet] : (double)NAN));
    put_member(cell, "inside_share",
               number_of(model->cells.inside_share ? model->cells.inside_share[tet] : (double)NAN));
    put_member(cell, "samples",
               model->cells.samples ? json_integer(model->cells.samples[tet]) : json_null());
    put_member(cell, "residual",
               number_of(model->cells.residual ? model->cells.residual[tet] : (double)NAN));
    put_member(cell, "lower", number_of(least + low));
    put_member(cell, "upper", number_of(most + high));
    return cell;
}

static const char *find_file(const json_t *report, json_int_t panel)
{
    const json_t *const panels = json_object_get(report, "panels");
    const json_t *row;
    size_t i;

    json_array_foreach(panels, i, row)
    {
        if (json_integer_value(json_object_get(row, "number")) == panel)
            return json_string_value(json_object_get(row, "file"));
    }
    return NULL;
}

/* A section as it lies at the point: which pixel of which panel shows it. NULL: it has no pose. */
static json_t *describe_section(const json_t *report, const json_t *section, const double u[3])
{
    const json_t *const pose = json_object_get(section, "panel_to_block_um");
    const json_t *const panel = json_object_get(section, "panel");
    struct gsn_affine map;
    struct gsn_point px;
    double m[6];
    json_t *row;

    if (json_array_size(pose) != 6)
        return NULL;
    for (size_t i = 0; i < 6; i++)
        m[i] = json_number_value(json_array_get(pose, i));
    map = (struct gsn_affine){ m[0], m[1], m[2], m[3], m[4], m[5] };
    if (!(fabs(gsn_affine_det(&map)) > 0))
        return NULL;
    map = gsn_affine_inverse(&map);
    px = gsn_affine_apply(&map, (struct gsn_point){ u[0], u[1] });
    row = json_object();
    put_member(row, "serial", json_incref(json_object_get(section, "serial")));
    put_member(row, "z_um", json_incref(json_object_get(section, "z_um")));
    put_member(row, "above_um", number_of(u[2] - get_number(section, "z_um")));
    put_member(row, "panel", json_incref(json_object_get(section, "panel")));
    put_member(row, "file", gsn_work_text(find_file(report, json_integer_value(panel))));
    put_member(row, "slot", json_incref(json_object_get(section, "slot")));
    put_member(row, "state", json_incref(json_object_get(section, "state")));
    put_member(row, "x_px", number_of(px.x));
    put_member(row, "y_px", number_of(px.y));
    return row;
}

/* The posed sections that are nearest in z, the nearest first. */
static json_t *list_sections(const json_t *report, const double u[3])
{
    const json_t *const sections = json_object_get(report, "sections");
    json_t *list = json_array();
    double last = -1;

    for (int n = 0; n < NEAREST_SECTIONS; n++) {
        json_t *nearest = NULL;
        double distance = INFINITY;
        const json_t *section;
        size_t i;

        json_array_foreach(sections, i, section)
        {
            const double here = fabs(get_number(section, "z_um") - u[2]);
            json_t *row =
                here < distance && here > last ? describe_section(report, section, u) : NULL;

            if (!row)
                continue;
            json_decref(nearest);
            nearest = row;
            distance = here;
        }
        if (nearest)
            (void)json_array_append_new(list, nearest);
        last = distance;
    }
    return list;
}

/* Red, green and blue as codes of sRGB, #rrggbb; null: the model has no colours. */
static json_t *colour_at(const struct gsn_model *model, const double u[3])
{
    const struct gsn_spline *const *const colour = gsn_model_colours(model);
    unsigned code[3] = { 0 };

    for (int c = 0; colour && c < 3; c++) {
        double light = 0;
        size_t hint = 0;

        (void)gsn_spline_eval(colour[c], u, &hint, &light, NULL);
        code[c] = (unsigned)lrint(255 * gsn_srgb_of_light(fmin(1, fmax(0, light))));
    }
    return colour ? json_sprintf("#%02x%02x%02x", code[0], code[1], code[2]) : json_null();
}

static int probe_point(struct asked *a, const double u[3], struct gsn_error *err)
{
    double value, gradient[3], hessian[6];
    size_t tet = 0, hint = 0;

    if (gsn_spline_eval(a->model->spline, u, &hint, &value, gradient) != GSN_OK ||
        gsn_spline_hessian(a->model->spline, u, &hint, hessian) != GSN_OK ||
        gsn_dms_locate(a->model->space, u, hint, &tet) != GSN_OK)
        return say_outside(a, u, err);
    put_member(a->root, "at_um", numbers_of(u, 3));
    put_member(a->root, "value", number_of(value));
    put_member(a->root, "gradient_per_um", numbers_of(gradient, 3));
    put_member(a->root, "hessian_per_um2", numbers_of(hessian, 6));
    put_member(a->root, "colour", colour_at(a->model, u));
    put_member(a->root, "in_region",
               a->model->region ? json_boolean(is_in_region(a->model, u)) : json_null());
    put_member(a->root, "cell", describe_cell(a->model, tet));
    put_member(a->root, "sections", list_sections(a->kept->report, u));
    return GSN_OK;
}

static void print_probe(const struct asked *a)
{
    const json_t *const cell = json_object_get(a->root, "cell");
    const json_t *const gradient = json_object_get(a->root, "gradient_per_um");
    const json_t *const in_region = json_object_get(a->root, "in_region");
    const json_t *section;
    size_t i;

    (void)printf("value %.6g%s\n", get_number(a->root, "value"),
                 json_is_false(in_region)  ? ", beyond the region of interest"
                 : json_is_true(in_region) ? ""
                                           : "; where the region is, this model does not say");
    (void)printf("gradient (%.4g, %.4g, %.4g) per um\n",
                 json_number_value(json_array_get(gradient, 0)),
                 json_number_value(json_array_get(gradient, 1)),
                 json_number_value(json_array_get(gradient, 2)));
    if (json_is_string(json_object_get(a->root, "colour")))
        (void)printf("colour %s (sRGB)\n", json_string_value(json_object_get(a->root, "colour")));
    (void)printf("cell %.0f: the spline lies between %.4g and %.4g in all of it\n",
                 get_number(cell, "number"), get_number(cell, "lower"), get_number(cell, "upper"));
    if (get_number(cell, "samples") > 0)
        (void)printf("  %.0f samples, rms residual %.3g; %.3g %% of it in the region, mean %.4g\n",
                     get_number(cell, "samples"), get_number(cell, "residual"),
                     100 * get_number(cell, "inside_share"), get_number(cell, "density"));
    else if (get_number(cell, "samples") == 0)
        (void)printf("  no sample: the value is made up from the cells around, and no "
                     "measurement\n");
    json_array_foreach(json_object_get(a->root, "sections"), i, section)
    {
        gsn_work_print(stdout, "section %.0f, %.4g um away: pixel (%.1f, %.1f) of panel %.0f, %s\n",
                       get_number(section, "serial"), fabs(get_number(section, "above_um")),
                       get_number(section, "x_px"), get_number(section, "y_px"),
                       get_number(section, "panel"),
                       json_string_value(json_object_get(section, "file"))
                           ? json_string_value(json_object_get(section, "file"))
                           : "?");
    }
}

/* The coordinates behind the specimen's name. */
static int read_coordinates(const struct gsn_work_request *request, int count, double *ret_number)
{
    if (request->rest_count != 1 + count)
        return 0;
    for (int i = 0; i < count; i++)
        if (!gsn_work_numbers(request->rest[1 + i], 1, &ret_number[i]))
            return 0;
    return 1;
}

int gsn_work_probe(const struct gsn_work_request *request)
{
    struct asked a __attribute__((cleanup(asked_done))) = { .root = NULL };
    struct gsn_error err = { 0 };
    double u[3];
    int r;

    if (!read_coordinates(request, 3, u))
        return gsn_work_usage(
            request, "say a specimen and a point of the block in micrometres: `gieson probe "
                     "SPECIMEN X Y Z`");
    r = open_model(request, &a, &err);
    if (r >= 0)
        r = probe_point(&a, u, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    if (request->json)
        return print_json(a.root);
    print_probe(&a);
    return EX_OK;
}

/* ---- line ---------------------------------------------------------------------------------- */

static json_t *describe_part(double um, double integral)
{
    json_t *part = json_object();

    put_member(part, "length_um", number_of(um));
    put_member(part, "integral_um", number_of(integral));
    put_member(part, "mean", um > 0 ? number_of(integral / um) : json_null());
    return part;
}

static int list_profile(struct asked *a, const double end[6], size_t count, struct gsn_error *err)
{
    gsn_auto_mem(double) flat = gsn_alloc_array(count, 3 * sizeof *flat);
    double(*const at)[3] = (double(*)[3])flat;
    gsn_auto_mem(double) value = gsn_alloc_array(count, sizeof *value);
    json_t *list = json_array();
    int r;

    put_member(a->root, "profile", list);
    if (!flat || !value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a profile of %zu points", count);
    for (size_t i = 0; i < count; i++)
        for (int c = 0; c < 3; c++)
            at[i][c] = end[c] + (end[3 + c] - end[c]) * (double)i / (double)(count - 1);
    r = gsn_spline_eval_many(a->model->spline, (const double(*)[3])flat, count, a->request->threads,
                             value, NULL, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        json_t *row = json_object();

        put_member(row, "at_um", numbers_of(at[i], 3));
        put_member(row, "value", number_of(value[i]));
        put_member(row, "in_region",
                   a->model->region ? json_boolean(is_in_region(a->model, at[i])) : json_null());
        (void)json_array_append_new(list, row);
    }
    return r;
}

static int follow_line(struct asked *a, const double end[6], size_t points, struct gsn_error *err)
{
    double inside = 0, integral = 0, region_um = 0, region_integral = 0;
    int r = gsn_segment_inside(gsn_dms_mesh(a->model->space), end, end + 3, &inside, err);

    if (r >= 0 && !(inside > 0))
        return gsn_fail(err, GSN_E_INPUT,
                        "the segment from (%g, %g, %g) to (%g, %g, %g) um runs outside the model, "
                        "where there is no data",
                        end[0], end[1], end[2], end[3], end[4], end[5]);
    if (r >= 0)
        r = gsn_spline_segment(a->model->spline, end, end + 3, &integral, err);
    if (r >= 0 && a->model->region)
        r = gsn_region_segment(a->model->spline, a->model->region, end, end + 3, &region_um,
                               &region_integral, err);
    if (r < 0)
        return r;
    put_member(a->root, "from_um", numbers_of(end, 3));
    put_member(a->root, "to_um", numbers_of(end + 3, 3));
    put_member(a->root, "domain", describe_part(inside, integral));
    put_member(a->root, "region",
               a->model->region ? describe_part(region_um, region_integral) : json_null());
    return list_profile(a, end, points, err);
}

static void print_part(const char *where, const json_t *part)
{
    if (json_is_object(part))
        (void)printf("%s: %.6g um, integral %.6g density x um, mean %.6g\n", where,
                     get_number(part, "length_um"), get_number(part, "integral_um"),
                     get_number(part, "mean"));
}

static void print_line(const struct asked *a)
{
    const json_t *row;
    size_t i;

    print_part("in the region", json_object_get(a->root, "region"));
    print_part("in the whole domain", json_object_get(a->root, "domain"));
    (void)printf("x_um\ty_um\tz_um\tvalue\n");
    json_array_foreach(json_object_get(a->root, "profile"), i, row)
    {
        const json_t *const at = json_object_get(row, "at_um");
        const double value = get_number(row, "value");

        for (size_t c = 0; c < 3; c++)
            (void)printf("%.6g\t", json_number_value(json_array_get(at, c)));
        if (isnan(value))
            (void)printf("no data\n");
        else
            (void)printf("%.6g%s\n", value,
                         json_is_false(json_object_get(row, "in_region")) ? "\tbeyond the region"
                                                                          : "");
    }
}

int gsn_work_line(const struct gsn_work_request *request)
{
    struct asked a __attribute__((cleanup(asked_done))) = { .root = NULL };
    struct gsn_error err = { 0 };
    double end[6], points = PROFILE;
    int r;

    if (!read_coordinates(request, 6, end) ||
        (end[0] == end[3] && end[1] == end[4] && end[2] == end[5]))
        return gsn_work_usage(request,
                              "say a specimen and two points of the block in micrometres: `gieson "
                              "line SPECIMEN X1 Y1 Z1 X2 Y2 Z2`");
    if (request->points && (!gsn_work_numbers(request->points, 1, &points) || points < 2 ||
                            points > MOST_PROFILE || points != floor(points)))
        return gsn_work_usage(request,
                              "--points is how many points the profile has, from 2 to 100000");
    r = open_model(request, &a, &err);
    if (r >= 0)
        r = follow_line(&a, end, (size_t)points, &err);
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    if (request->json)
        return print_json(a.root);
    print_line(&a);
    return EX_OK;
}

/* ---- integral ------------------------------------------------------------------------------ */

static int bound_levels(struct asked *a, const struct gsn_mask *region, struct gsn_error *err)
{
    const struct gsn_level_set_options options = { .most_cells = MOST_CELLS,
                                                   .threads = a->request->threads };
    const size_t count = json_array_size(a->request->levels);
    struct gsn_volume_bound bound[MOST_LEVELS];
    double level[MOST_LEVELS];
    json_t *list = json_array();
    int r;

    put_member(a->root, "volumes", list);
    if (count == 0)
        return GSN_OK;
    for (size_t i = 0; i < count; i++)
        level[i] = json_number_value(json_array_get(a->request->levels, i));
    r = gsn_level_set_volume(a->model->spline, region, level, count, &options, bound, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        json_t *row = json_object();

        put_member(row, "level", number_of(level[i]));
        put_member(row, "lower_mm3", number_of(1e-9 * bound[i].lower_um3));
        put_member(row, "upper_mm3", number_of(1e-9 * bound[i].upper_um3));
        (void)json_array_append_new(list, row);
    }
    return r;
}

static int integrate_region(struct asked *a, const struct gsn_mask *region, const char *over,
                            struct gsn_error *err)
{
    struct gsn_region_density density;
    int r = gsn_region_density(a->model->spline, region, a->request->threads, NULL, &density, err);

    if (r < 0)
        return r;
    put_member(a->root, "over", json_string(over));
    put_member(a->root, "voxels", json_integer((json_int_t)density.voxels));
    put_member(a->root, "volume_mm3", number_of(1e-9 * density.volume_um3));
    put_member(a->root, "integral_mm3", number_of(1e-9 * density.volume_um3 * density.mean));
    put_member(a->root, "mean", number_of(density.mean));
    return bound_levels(a, region, err);
}

static int integrate_box(struct asked *a, const double side[6], struct gsn_error *err)
{
    gsn_auto(gsn_mask) part = NULL;
    double low[3], high[3];
    int r;

    if (!require_region(a, err))
        return GSN_E_NOTFOUND;
    for (int c = 0; c < 3; c++) {
        low[c] = fmin(side[c], side[3 + c]);
        high[c] = fmax(side[c], side[3 + c]);
    }
    r = gsn_region_in_box(a->model->region, low, high, &part, err);
    return r < 0 ? r : integrate_region(a, part, "box", err);
}

static int integrate_plane(struct asked *a, const double plane[6], struct gsn_error *err)
{
    struct gsn_plane_cut cut;
    int r;

    if (!require_region(a, err))
        return GSN_E_NOTFOUND;
    r = gsn_region_cut(a->model->spline, a->model->region, plane, plane + 3, a->request->threads,
                       &cut, err);
    if (r < 0)
        return r;
    put_member(a->root, "over", json_string("plane"));
    put_member(a->root, "area_mm2", number_of(1e-6 * cut.area_um2));
    put_member(a->root, "integral_mm2", number_of(1e-6 * cut.integral));
    put_member(a->root, "mean", number_of(cut.integral / cut.area_um2));
    return GSN_OK;
}

static int integrate_domain(struct asked *a, struct gsn_error *err)
{
    const size_t tets = gsn_dms_mesh(a->model->space)->tet_count;
    size_t empty = 0;
    double volume, integral;
    const int r =
        gsn_domain_integral(a->model->spline, a->request->threads, &volume, &integral, err);

    if (r < 0)
        return r;
    for (size_t t = 0; a->model->cells.samples && t < tets; t++)
        empty += a->model->cells.samples[t] == 0;
    put_member(a->root, "over", json_string("domain"));
    put_member(a->root, "volume_mm3", number_of(1e-9 * volume));
    put_member(a->root, "integral_mm3", number_of(1e-9 * integral));
    put_member(a->root, "mean", number_of(integral / volume));
    put_member(a->root, "cells", json_integer((json_int_t)tets));
    put_member(a->root, "cells_without_samples",
               a->model->cells.samples ? json_integer((json_int_t)empty) : json_null());
    return GSN_OK;
}

static void print_integral(const struct asked *a)
{
    const char *over = json_string_value(json_object_get(a->root, "over"));
    const int is_plane = strcmp(over, "plane") == 0;
    const json_t *row;
    size_t i;

    if (is_plane)
        (void)printf("the plane in the region: %.6g mm2, integral %.6g density x mm2, mean %.6g\n",
                     get_number(a->root, "area_mm2"), get_number(a->root, "integral_mm2"),
                     get_number(a->root, "mean"));
    else
        (void)printf("%s: %.6g mm3, integral %.6g density x mm3, mean %.6g\n",
                     strcmp(over, "box") == 0      ? "the region in the box"
                     : strcmp(over, "domain") == 0 ? "the whole domain"
                                                   : "the region",
                     get_number(a->root, "volume_mm3"), get_number(a->root, "integral_mm3"),
                     get_number(a->root, "mean"));
    if (get_number(a->root, "cells_without_samples") > 0)
        (void)printf("%.0f of its %.0f cells hold no sample: what the model says there is no "
                     "measurement\n",
                     get_number(a->root, "cells_without_samples"), get_number(a->root, "cells"));
    json_array_foreach(json_object_get(a->root, "volumes"), i, row)
    {
        (void)printf("the model is above %g in %.6g to %.6g mm3\n", get_number(row, "level"),
                     get_number(row, "lower_mm3"), get_number(row, "upper_mm3"));
    }
}

int gsn_work_integral(const struct gsn_work_request *request)
{
    struct asked a __attribute__((cleanup(asked_done))) = { .root = NULL };
    const int ways = (request->box != NULL) + (request->plane != NULL) + (request->whole != 0);
    struct gsn_error err = { 0 };
    double six[6];
    int r;

    if (request->rest_count != 1 || ways > 1)
        return gsn_work_usage(request,
                              "say `gieson integral SPECIMEN`, with one of --box, --plane and "
                              "--whole or none of them");
    if (request->box && !gsn_work_numbers(request->box, 6, six))
        return gsn_work_usage(request, "--box is two corners in micrometres: X1,Y1,Z1,X2,Y2,Z2");
    if (request->plane && !gsn_work_numbers(request->plane, 6, six))
        return gsn_work_usage(request,
                              "--plane is a point in micrometres and a normal: X,Y,Z,NX,NY,NZ");
    if (json_array_size(request->levels) > (request->plane || request->whole ? 0 : MOST_LEVELS))
        return gsn_work_usage(request,
                              "--level goes with the region or a --box, up to eight times");
    r = open_model(request, &a, &err);
    if (r >= 0 && request->box)
        r = integrate_box(&a, six, &err);
    else if (r >= 0 && request->plane)
        r = integrate_plane(&a, six, &err);
    else if (r >= 0 && request->whole)
        r = integrate_domain(&a, &err);
    else if (r >= 0)
        r = require_region(&a, &err) ? integrate_region(&a, a.model->region, "region", &err)
                                     : GSN_E_NOTFOUND;
    if (r < 0)
        return gsn_work_complain(request, &err, r);
    if (request->json)
        return print_json(a.root);
    print_integral(&a);
    return EX_OK;
}
