/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is known of a drawn specimen, as files: first the tables (sections.csv, markers.csv,
 * defects.csv and, where sections were handled, decoys.csv and a warp_kNNN.csv each), then what was
 * drawn for it, the end of truth.json; then the whole: job.json and region.mhd as an operator
 * writes them, truth.json, and the density volume. Lengths are written with as many digits as lead
 * back to the same double.
 *
 * Failure: memory and disk. Cost: the tables a second a specimen; the volume as much as it has
 * voxels. */
#include "pipeline/phantom/truth.h"

#include "pipeline/core/parallel.h"
#include "pipeline/phantom/buffer.h"
#include "pipeline/phantom/decoy.h"
#include "pipeline/phantom/delivery.h"
#include "pipeline/phantom/plan.h"
#include "pipeline/phantom/section.h"
#include "pipeline/phantom/sight.h"
#include "pipeline/phantom/stain.h"
#include "pipeline/phantom/texture.h"

#include <assert.h>
#include <math.h>

#define DEG_PER_RAD (180 / M_PI)

static void name_defects(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan,
                         int k)
{
    const char *comma = "";

    for (size_t i = 0; i < plan->defects; i++)
        if (plan->defect[i].k == k) {
            gsn_phantom_buffer_print(text, "%s%s", comma,
                                     gsn_phantom_defect_name(plan->defect[i].kind));
            comma = ";";
        }
}

/* A section that is not there keeps its row, and with it the pose of what lies in its slot. */
static int write_sections(const struct gsn_phantom_plan *plan,
                          const struct gsn_phantom_extent *extent, const char *folder,
                          struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,z_um,panel,slot,present,flip,theta_deg,sx,sy,cx_px,cy_px,"
                                    "px_um,m00,m01,m02,m10,m11,m12,bbox_x,bbox_y,bbox_w,bbox_h,"
                                    "area_px,kr,ky,defects\n");
    for (int k = 0; k < plan->sections; k++) {
        const struct gsn_phantom_section *s = &plan->section[k];
        const struct gsn_phantom_batch *batch = &plan->batch[s->panel - 1];
        const struct gsn_affine *m = &s->to_panel;
        const struct gsn_phantom_extent *e = &extent[k];

        gsn_phantom_buffer_print(&text, "%d,%.15g,%d,%d,%d,%d,%.12g,%.12g,%.12g,%.9f,%.9f,%.15g,",
                                 k, s->z_um, s->panel, s->slot, s->shows == k, s->flip,
                                 s->theta * DEG_PER_RAD, s->sx, s->sy, s->centre_px.x,
                                 s->centre_px.y, plan->px_um);
        gsn_phantom_buffer_print(&text, "%.15g,%.15g,%.15g,%.15g,%.15g,%.15g,", m->m00, m->m01,
                                 m->m02, m->m10, m->m11, m->m12);
        gsn_phantom_buffer_print(&text, "%u,%u,%u,%u,%zu,%.12g,%.12g,", e->x, e->y, e->width,
                                 e->height, e->area_px, batch->red_gain, batch->yellow_gain);
        name_defects(&text, plan, k);
        gsn_phantom_buffer_print(&text, "\n");
    }
    return gsn_phantom_buffer_write(&text, folder, "sections.csv", err);
}

static int write_markers(const struct gsn_phantom_plan *plan, const char *folder,
                         struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,marker,x_px,y_px,visible,occluded_by\n");
    for (int k = 0; k < plan->sections; k++) {
        struct gsn_phantom_sight sight;

        gsn_phantom_sight_make(plan, k, &sight);
        for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
            struct gsn_point p;
            const char *by = gsn_phantom_sight_mark(&sight, i, &p);

            gsn_phantom_buffer_print(&text, "%d,%d,%.6f,%.6f,%d,%s\n", k, i + 1, p.x, p.y, !*by,
                                     by);
        }
    }
    return gsn_phantom_buffer_write(&text, folder, "markers.csv", err);
}

static int write_defects(const struct gsn_phantom_plan *plan, const char *folder,
                         struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,type,polygon,roi_fraction\n");
    for (size_t i = 0; i < plan->defects; i++) {
        const struct gsn_phantom_defect *d = &plan->defect[i];
        struct gsn_point p[GSN_PHANTOM_POLYGON];
        struct gsn_phantom_sight sight;
        size_t count;

        gsn_phantom_sight_make(plan, d->k, &sight);
        count = gsn_phantom_sight_polygon(&sight, d, p);
        gsn_phantom_buffer_print(&text, "%d,%s,", d->k, gsn_phantom_defect_name(d->kind));
        for (size_t j = 0; j < count; j++)
            gsn_phantom_buffer_print(&text, "%s%.2f %.2f", j ? ";" : "", p[j].x, p[j].y);
        gsn_phantom_buffer_print(&text, ",%.6f\n", gsn_phantom_sight_hidden(&sight, d));
    }
    return gsn_phantom_buffer_write(&text, folder, "defects.csv", err);
}

static int write_decoys(const struct gsn_phantom_plan *plan, const char *folder,
                        struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "k,type,x_px,y_px,radius_um\n");
    for (int k = 0; k < plan->sections; k++)
        for (int i = 0; i < plan->section[k].decoys; i++) {
            const struct gsn_phantom_decoy *d = &plan->section[k].decoy[i];

            gsn_phantom_buffer_print(&text, "%d,%s,%.3f,%.3f,%.3f\n", k,
                                     gsn_phantom_decoy_name(d->kind), d->at_um.x / plan->px_um,
                                     d->at_um.y / plan->px_um, d->radius_um);
        }
    return gsn_phantom_buffer_write(&text, folder, "decoys.csv", err);
}

/* Numbers files in the order of their delivery. */
static int write_files(const struct gsn_phantom_plan *plan, const char *folder,
                       struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text, "file,panel,again,orientation,bits,jpeg_passes,kept,tag_um\n");
    for (int i = 0; i < plan->files; i++) {
        const struct gsn_phantom_file *f = &plan->file[i];
        gsn_auto_mem(char) name = gsn_phantom_delivery_name(plan, i);

        if (!name)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for files.csv");
        gsn_phantom_buffer_print(&text, "%s,%d,%d,%d,%d,%d,%.6f,%.6f\n", name, f->panel, f->again,
                                 f->orientation, f->bits, f->bits == 8 ? f->passes : 0, f->kept,
                                 f->tag_um);
    }
    return gsn_phantom_buffer_write(&text, folder, "files.csv", err);
}

static int write_warp(const struct gsn_phantom_plan *plan, int k, const char *folder,
                      struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };
    gsn_auto_mem(char) name = gsn_format("warp_k%03d.csv", k);
    struct gsn_phantom_warp warp;

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the warp of section %d", k);
    gsn_phantom_plan_warp(plan, k, &warp);
    gsn_phantom_buffer_print(&text, "row,column,x_px,y_px,nx_um,ny_um\n");
    for (int j = 0; j < GSN_PHANTOM_WARP_SIDE; j++)
        for (int i = 0; i < GSN_PHANTOM_WARP_SIDE; i++)
            gsn_phantom_buffer_print(&text, "%d,%d,%.9g,%.9g,%.9f,%.9f\n", j, i,
                                     (warp.corner_um.x + i * warp.pitch_um) / plan->px_um,
                                     (warp.corner_um.y + j * warp.pitch_um) / plan->px_um,
                                     warp.node[j][i].x, warp.node[j][i].y);
    return gsn_phantom_buffer_write(&text, folder, name, err);
}

/* extent is by section. */
int gsn_phantom_tables_write(const struct gsn_phantom_plan *plan,
                             const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS],
                             const char *folder, struct gsn_error *err)
{
    int r = write_sections(plan, extent, folder, err);

    if (r >= 0)
        r = write_markers(plan, folder, err);
    if (r >= 0)
        r = write_defects(plan, folder, err);
    if (r >= 0 && gsn_phantom_plan_varies(plan))
        r = write_decoys(plan, folder, err);
    if (r >= 0 && plan->level.awkward)
        r = write_files(plan, folder, err);
    for (int k = 0; r >= 0 && plan->level.warp_rms_um > 0 && k < plan->sections; k++)
        if (plan->section[k].shows >= 0)
            r = write_warp(plan, k, folder, err);
    return r;
}

static const char *truth_of(int yes)
{
    return yes ? "true" : "false";
}

static void add_marks(struct gsn_phantom_buffer *text, const struct gsn_phantom_section *s)
{
    gsn_phantom_buffer_print(text, ",\n     \"marks\": [");
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++) {
        const struct gsn_phantom_mark *m = &s->mark[i];

        gsn_phantom_buffer_print(text,
                                 "%s{\"marker\": %d, \"missing\": %s, \"block_um\": [%.15g, %.15g],"
                                 " \"radius_um\": %.15g, \"ratio\": %.15g, \"turn_deg\": %.15g}",
                                 i ? ",\n       " : "", i + 1, truth_of(m->missing), m->centre.x,
                                 m->centre.y, m->radius_um, m->ratio, m->turn * DEG_PER_RAD);
    }
    gsn_phantom_buffer_print(text, "]");
}

static void add_decoys(struct gsn_phantom_buffer *text, const struct gsn_phantom_section *s)
{
    gsn_phantom_buffer_print(text, ",\n     \"decoys\": [");
    for (int i = 0; i < s->decoys; i++)
        gsn_phantom_buffer_print(
            text, "%s{\"type\": \"%s\", \"at_um\": [%.15g, %.15g], \"radius_um\": %.15g}",
            i ? ", " : "", gsn_phantom_decoy_name(s->decoy[i].kind), s->decoy[i].at_um.x,
            s->decoy[i].at_um.y, s->decoy[i].radius_um);
    gsn_phantom_buffer_print(text, "]");
}

static void add_sections(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"sections\": [");
    for (int k = 0; k < plan->sections; k++) {
        const struct gsn_phantom_section *s = &plan->section[k];

        gsn_phantom_buffer_print(
            text,
            "%s\n    {\"k\": %d, \"z_um\": %.15g, \"panel\": %d, \"slot\": %d, "
            "\"present\": %s, \"flip\": %s, \"theta_deg\": %.15g, "
            "\"sx\": %.15g, \"sy\": %.15g, \"c_px\": [%.15g, %.15g]",
            k ? "," : "", k, s->z_um, s->panel, s->slot, truth_of(s->shows == k), truth_of(s->flip),
            s->theta * DEG_PER_RAD, s->sx, s->sy, s->centre_px.x, s->centre_px.y);
        if (gsn_phantom_plan_varies(plan)) {
            gsn_phantom_buffer_print(text, ", \"shows\": %d", s->shows);
            add_marks(text, s);
            add_decoys(text, s);
        }
        gsn_phantom_buffer_print(text, "}");
    }
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_markers(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"markers\": [");
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++)
        gsn_phantom_buffer_print(text, "%s{\"marker\": %d, \"block_um\": [%.15g, %.15g]}",
                                 i ? ", " : "", i + 1, plan->variant.geometry.mark[i].x,
                                 plan->variant.geometry.mark[i].y);
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_vector(struct gsn_phantom_buffer *text, const char *name, const double v[3])
{
    gsn_phantom_buffer_print(text, ", \"%s\": [%.15g, %.15g, %.15g]", name, v[0], v[1], v[2]);
}

static void add_panels(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"panels\": [");
    for (int i = 0; i < plan->panels; i++) {
        const struct gsn_phantom_batch *b = &plan->batch[i];

        gsn_phantom_buffer_print(text, "%s\n    {\"panel\": %d, \"kr\": %.15g, \"ky\": %.15g",
                                 i ? "," : "", i + 1, b->red_gain, b->yellow_gain);
        add_vector(text, "I0", b->white);
        add_vector(text, "RED", b->dye[GSN_PHANTOM_RED]);
        add_vector(text, "YEL", b->dye[GSN_PHANTOM_YELLOW]);
        add_vector(text, "NUC", b->dye[GSN_PHANTOM_NUCLEAR]);
        gsn_phantom_buffer_print(text, "}");
    }
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_files(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"missing_panel\": %d,\n  \"files\": [", plan->missing_panel);
    for (int i = 0; i < plan->files; i++) {
        const struct gsn_phantom_file *f = &plan->file[i];

        gsn_phantom_buffer_print(text,
                                 "%s\n    {\"panel\": %d, \"again\": %s, \"orientation\": %d, "
                                 "\"bits\": %d, \"kept\": %.15g, \"tag_um\": %.15g}",
                                 i ? "," : "", f->panel, truth_of(f->again), f->orientation,
                                 f->bits, f->kept, f->tag_um);
    }
    gsn_phantom_buffer_print(text, "],\n");
}

static void add_places(struct gsn_phantom_buffer *text, const struct gsn_phantom_defect *d)
{
    gsn_phantom_buffer_print(text, ", \"points_um\": [");
    for (size_t i = 0; i < d->count; i++)
        gsn_phantom_buffer_print(text, "%s[%.15g, %.15g]", i ? ", " : "", d->point[i].x,
                                 d->point[i].y);
    gsn_phantom_buffer_print(text, "], \"dust_um\": [");
    for (int i = 0; i < GSN_PHANTOM_DUST && d->dust[i].radius > 0; i++)
        gsn_phantom_buffer_print(text, "%s[%.15g, %.15g, %.15g]", i ? ", " : "", d->dust[i].at.x,
                                 d->dust[i].at.y, d->dust[i].radius);
    gsn_phantom_buffer_print(text, "]");
}

static void add_defects(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    gsn_phantom_buffer_print(text, "  \"defects\": [");
    for (size_t i = 0; i < plan->defects; i++) {
        const struct gsn_phantom_defect *d = &plan->defect[i];

        gsn_phantom_buffer_print(
            text,
            "%s\n    {\"k\": %d, \"type\": \"%s\", \"turn_deg\": %.15g, \"at_um\": [%.15g, %.15g], "
            "\"slope\": %.15g, \"width_um\": %.15g, \"radius_um\": %.15g, \"sigma_px\": %.15g, "
            "\"colour\": %d, \"place_um\": [%.15g, %.15g], \"place_turn_deg\": %.15g",
            i ? "," : "", d->k, gsn_phantom_defect_name(d->kind), d->turn * DEG_PER_RAD, d->at.x,
            d->at.y, d->slope, d->width, d->radius, d->sigma_px, d->colour, d->place.x, d->place.y,
            d->place_turn * DEG_PER_RAD);
        add_places(text, d);
        gsn_phantom_buffer_print(text, "}");
    }
    gsn_phantom_buffer_print(text, "]\n}\n");
}

/* Adds "sections", "markers" and "defects", and where sections and panels vary "panels", and the
 * closing brace. */
static void gsn_phantom_record_drawn(const struct gsn_phantom_plan *plan,
                                     struct gsn_phantom_buffer *text)
{
    add_sections(text, plan);
    add_markers(text, plan);
    if (gsn_phantom_plan_varies(plan))
        add_panels(text, plan);
    if (plan->level.awkward)
        add_files(text, plan);
    add_defects(text, plan);
}

static const double VOXEL_UM = 16, LOSS_STEP_UM = 6;

/* --- volumes --- */

/* Voxels over an axis of the block, its soft edge included. */
static size_t voxels_over(double half_axis)
{
    const double edge = 8;

    return 2 * (size_t)ceil((half_axis + edge) / VOXEL_UM);
}

struct gsn_lattice gsn_phantom_truth_lattice(const struct gsn_phantom_geometry *g)
{
    const size_t nx = voxels_over(g->ax), ny = voxels_over(g->ay);
    const struct gsn_lattice at = {
        .nx = nx,
        .ny = ny,
        .nz = (size_t)g->sections,
        .origin_um = { -VOXEL_UM * ((double)nx - 1) / 2, -VOXEL_UM * ((double)ny - 1) / 2,
                       g->first_z },
        .step_um = { VOXEL_UM, VOXEL_UM, g->interval },
    };
    return at;
}

/* Cuts one axis of a lattice down to the voxels within low..high and two on either side. */
static void crop_axis(double low, double high, double step, double *origin, size_t *count)
{
    const double border = 2;
    const double first = fmax(ceil((low - *origin) / step) - border, 0);
    const double last = fmin(floor((high - *origin) / step) + border, (double)*count - 1);

    *origin += first * step;
    *count = (size_t)(last - first) + 1;
}

struct gsn_lattice gsn_phantom_region_lattice(const struct gsn_phantom_geometry *g)
{
    struct gsn_lattice at = gsn_phantom_truth_lattice(g);

    crop_axis(g->lesion.x - g->region_radius, g->lesion.x + g->region_radius, at.step_um.x,
              &at.origin_um.x, &at.nx);
    crop_axis(g->lesion.y - g->region_radius, g->lesion.y + g->region_radius, at.step_um.y,
              &at.origin_um.y, &at.ny);
    crop_axis(g->lesion.z - g->region_half_height, g->lesion.z + g->region_half_height,
              at.step_um.z, &at.origin_um.z, &at.nz);
    return at;
}

int gsn_phantom_region_mask(const struct gsn_phantom_geometry *g, const struct gsn_lattice *at,
                            struct gsn_mask **ret_mask, struct gsn_error *err)
{
    gsn_auto(gsn_mask) mask = NULL;
    const int r = gsn_mask_new(at, &mask, err);

    if (r < 0)
        return r;
    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++)
                mask->inside[gsn_lattice_index(at, x, y, z)] =
                    (uint8_t)gsn_phantom_in_region(g, gsn_lattice_centre(at, x, y, z));
    *ret_mask = gsn_steal(&mask);
    return GSN_OK;
}

struct density_job {
    const struct gsn_phantom_geometry *geometry;
    struct gsn_grid *grid;
    double depth, gain;
};

static int fill_density(size_t z, void *context, struct gsn_error *err)
{
    const struct density_job *job = context;
    const struct gsn_lattice *at = &job->grid->at;
    struct gsn_phantom_field field;

    (void)err;
    for (size_t y = 0; y < at->ny; y++)
        for (size_t x = 0; x < at->nx; x++) {
            gsn_phantom_field_at(job->geometry, gsn_lattice_centre(at, x, y, z), &field);
            gsn_phantom_field_thicken(&field, job->gain);
            job->grid->value[gsn_lattice_index(at, x, y, z)] =
                (float)gsn_phantom_density(&field, job->depth);
        }
    return GSN_OK;
}

int gsn_phantom_density_grid(const struct gsn_phantom_geometry *g, const struct gsn_lattice *at,
                             double depth, double gain, unsigned threads,
                             struct gsn_grid **ret_grid, struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = NULL;
    struct density_job job = { .geometry = g, .depth = depth, .gain = gain };
    int r;

    r = gsn_grid_new(at, &grid, err);
    if (r < 0)
        return r;
    job.grid = grid;
    r = gsn_parallel_for(at->nz, threads, fill_density, &job, err);
    if (r < 0)
        return r;
    *ret_grid = gsn_steal(&grid);
    return GSN_OK;
}

static int write_header(const struct gsn_lattice *at, const char *type, const char *folder,
                        const char *name, struct gsn_error *err)
{
    gsn_auto_phantom_buffer text = { 0 };
    gsn_auto_mem(char) file = gsn_format("%s.mhd", name);

    if (!file)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s.mhd", name);
    gsn_phantom_buffer_print(&text,
                             "ObjectType = Image\nNDims = 3\nBinaryData = True\n"
                             "BinaryDataByteOrderMSB = False\nCompressedData = False\n"
                             "TransformMatrix = 1 0 0 0 1 0 0 0 1\n"
                             "Offset = %.15g %.15g %.15g\nCenterOfRotation = 0 0 0\n"
                             "ElementSpacing = %.15g %.15g %.15g\nDimSize = %zu %zu %zu\n"
                             "ElementType = %s\nElementDataFile = %s.raw\n",
                             at->origin_um.x, at->origin_um.y, at->origin_um.z, at->step_um.x,
                             at->step_um.y, at->step_um.z, at->nx, at->ny, at->nz, type, name);
    return gsn_phantom_buffer_write(&text, folder, file, err);
}

static int write_raw(const void *bytes, size_t size, const char *folder, const char *name,
                     struct gsn_error *err)
{
    gsn_auto_phantom_buffer raw = { 0 };
    gsn_auto_mem(char) file = gsn_format("%s.raw", name);

    if (!file || gsn_phantom_buffer_put(&raw, 0, bytes, size) < 0)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s.raw", name);
    return gsn_phantom_buffer_write(&raw, folder, file, err);
}

static int write_region(const struct gsn_phantom_geometry *g, const struct gsn_lattice *at,
                        const char *folder, const char *name, struct gsn_error *err)
{
    gsn_auto(gsn_mask) mask = NULL;
    int r;

    r = gsn_phantom_region_mask(g, at, &mask, err);
    if (r < 0)
        return r;
    r = write_raw(mask->inside, gsn_lattice_count(at), folder, name, err);
    if (r < 0)
        return r;
    return write_header(at, "MET_UCHAR", folder, name, err);
}

static int write_density(const struct gsn_phantom_plan *plan, unsigned threads, const char *folder,
                         struct gsn_error *err)
{
    const struct gsn_phantom_geometry *g = &plan->variant.geometry;
    const struct gsn_phantom_specimen *s = &plan->specimen;
    const struct gsn_lattice at = gsn_phantom_truth_lattice(g);
    gsn_auto(gsn_grid) grid = NULL;
    int r;

    r = gsn_phantom_density_grid(g, &at, s->depth, s->bone_gain, threads, &grid, err);
    if (r < 0)
        return r;
    r = write_raw(grid->value, gsn_lattice_count(&at) * sizeof *grid->value, folder, "density",
                  err);
    if (r < 0)
        return r;
    return write_header(&at, "MET_FLOAT", folder, "density", err);
}

/* --- what the operator types --- */

/* The patches of one row, of standards or of dyes. */
static void add_calibration(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    const enum gsn_phantom_calibrated by = plan->variant.calibrated;

    if (by == GSN_PHANTOM_BY_DYES)
        gsn_phantom_buffer_print(text, "  \"calibration\": \"" GSN_PHANTOM_STUDY "-%s-C01.png\",\n",
                                 plan->specimen.name);
    if (by != GSN_PHANTOM_BY_PATCHES)
        return;
    gsn_phantom_buffer_print(text, "  \"calibration\": [");
    for (int panel = 1; panel <= plan->panels; panel++)
        gsn_phantom_buffer_print(text,
                                 "%s\n    {\"file\": \"" GSN_PHANTOM_STUDY "-%s-C%02d.png\", "
                                 "\"panels\": [%d], \"patches\": [[0, 0.25, 0.5, 0.75, 1], "
                                 "[\"red\", \"yellow\", \"dark\"]]}",
                                 panel > 1 ? "," : "", plan->specimen.name, panel, panel);
    gsn_phantom_buffer_print(text, "],\n");
}

int gsn_phantom_write_job(const struct gsn_phantom_plan *plan, const char *folder,
                          struct gsn_error *err)
{
    const struct gsn_phantom_variant *v = &plan->variant;
    const struct gsn_phantom_geometry *g = &v->geometry;
    const struct gsn_phantom_specimen *s = &plan->specimen;
    const struct gsn_lattice region = gsn_phantom_region_lattice(g);
    gsn_auto_phantom_buffer text = { 0 };
    int r;

    gsn_phantom_buffer_print(&text,
                             "{\n  \"study\": \"%s\",\n  \"specimen\": \"%s-%s\",\n"
                             "  \"group\": \"%s\",\n  \"animal\": \"%s\",\n  \"week\": %d,\n",
                             GSN_PHANTOM_STUDY, GSN_PHANTOM_STUDY, s->name, s->group, s->animal,
                             s->week);
    if (s->baseline)
        gsn_phantom_buffer_print(&text, "  \"baseline\": \"%s\",\n", s->baseline);
    gsn_phantom_buffer_print(&text,
                             "  \"px_um\": %.15g,\n  \"interval_um\": %.15g,\n  \"panels\": %d,\n"
                             "  \"layout\": [%d, %d],\n  \"order\": \"%s\",\n"
                             "  \"sections\": %d,\n",
                             plan->px_um, g->interval, plan->panels, v->rows, v->columns, v->order,
                             plan->sections);
    add_calibration(&text, plan);
    gsn_phantom_buffer_print(&text, "  \"%s\": [", v->markers_key);
    for (int i = 0; i < GSN_PHANTOM_MARKS; i++)
        gsn_phantom_buffer_print(&text, "%s[%.15g, %.15g]", i ? ", " : "", g->mark[i].x,
                                 v->markers_y_up ? -g->mark[i].y : g->mark[i].y);
    /* The dyes act on code values, so optical density is the logarithm of the code itself. */
    gsn_phantom_buffer_print(&text,
                             "],\n  \"region\": \"region.mhd\",\n  \"transfer\": \"linear\",\n"
                             "  \"thresholds\": [%g, %g, %g]\n}\n",
                             gsn_phantom_thresholds[0], gsn_phantom_thresholds[1],
                             gsn_phantom_thresholds[2]);
    r = write_region(g, &region, folder, "region", err);
    if (r < 0)
        return r;
    return gsn_phantom_buffer_write(&text, folder, "job.json", err);
}

int gsn_phantom_truth_sums(const struct gsn_phantom_geometry *g,
                           const struct gsn_phantom_specimen *s, unsigned threads,
                           struct gsn_phantom_sums *ret_sums, struct gsn_error *err)
{
    const double depths[GSN_PHANTOM_DEPTHS] = { s->depth, s->depth, s->depth, s->depth };

    return gsn_phantom_sum(g, LOSS_STEP_UM, depths, s->bone_gain, threads, ret_sums, err);
}

double gsn_phantom_truth_loss(const struct gsn_phantom_specimen *s,
                              const struct gsn_phantom_sums *sums)
{
    const double denser = 100 * (s->bone_gain - 1) * sums->bone / sums->intact;

    assert(s->depth == 0 || s->bone_gain == 1);
    return gsn_phantom_loss_percent(sums, s->depth) - denser;
}

static int write_loss(const struct gsn_phantom_plan *plan, unsigned threads, const char *folder,
                      struct gsn_error *err)
{
    const struct gsn_phantom_specimen *s = &plan->specimen;
    gsn_auto_phantom_buffer text = { 0 };
    struct gsn_phantom_sums sums;
    double integral;
    int r;

    r = gsn_phantom_truth_sums(&plan->variant.geometry, s, threads, &sums, err);
    if (r < 0)
        return r;
    integral = sums.intact - s->depth * sums.lost + (s->bone_gain - 1) * sums.bone;
    gsn_phantom_buffer_print(&text, "region,volume_mm3,mean_D,integral_D,baseline_integral,"
                                    "loss_pct,V_gt_0.3,V_gt_0.5,V_gt_0.7\n");
    gsn_phantom_buffer_print(&text, "roi,%.9f,%.9f,%.9f,%.9f,%.6f,%.9f,%.9f,%.9f\n", sums.volume,
                             integral / sums.volume, integral, sums.intact,
                             gsn_phantom_truth_loss(s, &sums), sums.above[0][0], sums.above[0][1],
                             sums.above[0][2]);
    return gsn_phantom_buffer_write(&text, folder, "loss.csv", err);
}

/* --- truth.json: enough for another program to compute everything again --- */

static void add_layers(struct gsn_phantom_buffer *text, const char *name,
                       const double value[GSN_PHANTOM_LAYERS])
{
    gsn_phantom_buffer_print(text,
                             "    \"%s\": {\"conn\": %.15g, \"dent\": %.15g, \"pulp\": %.15g, "
                             "\"pdl\": %.15g, \"bone\": %.15g, \"marr\": %.15g},\n",
                             name, value[GSN_PHANTOM_CONN], value[GSN_PHANTOM_DENT],
                             value[GSN_PHANTOM_PULP], value[GSN_PHANTOM_PDL],
                             value[GSN_PHANTOM_BONE], value[GSN_PHANTOM_MARR]);
}

static void add_geometry(struct gsn_phantom_buffer *text, const struct gsn_phantom_geometry *g)
{
    gsn_phantom_buffer_print(
        text,
        "  \"geometry\": {\n    \"N\": %d, \"first_z\": %.15g, \"interval\": %.15g, \"H\": %.15g,\n"
        "    \"Ax\": %.15g, \"Ay\": %.15g, \"p\": %.15g, \"delta\": %.15g,\n"
        "    \"a\": %.15g, \"b\": %.15g, \"Lr\": %.15g, \"zap\": %.15g,\n"
        "    \"cx\": %.15g, \"cy\": %.15g, \"tx\": %.15g, \"ty\": %.15g,\n"
        "    \"pulp_scale\": %.15g, \"pulp_start\": %.15g,\n",
        g->sections, g->first_z, g->interval, g->height, g->ax, g->ay, g->p, g->delta, g->a, g->b,
        g->root_length, g->apex_z, g->cx, g->cy, g->tx, g->ty, g->pulp_scale, g->pulp_start);
    gsn_phantom_buffer_print(
        text,
        "    \"wpdl\": %.15g, \"wb0\": %.15g, \"wb1\": %.15g, \"wbt\": %.15g,\n"
        "    \"lam\": %.15g, \"lamL\": %.15g, \"gz\": %.15g,\n",
        g->pdl_width, g->bone_width, g->bone_wave, g->bone_turn, g->lamella, g->lamella_length,
        g->slope_z);
    add_layers(text, "D", g->density);
    gsn_phantom_buffer_print(text, "    \"outline\": [");
    for (int i = 0; i < GSN_PHANTOM_OUTLINE_WAVES; i++)
        gsn_phantom_buffer_print(text, "%s[%.15g, %.15g, %.15g, %.15g]", i ? ", " : "",
                                 g->outline[i].m, g->outline[i].a, g->outline[i].p,
                                 g->outline[i].w);
    gsn_phantom_buffer_print(text, "],\n    \"marrow\": [");
    for (int i = 0; i < g->marrows; i++) {
        const struct gsn_phantom_ellipsoid *e = &g->marrow[i];

        gsn_phantom_buffer_print(text, "%s\n      [%.15g, %.15g, %.15g, %.15g, %.15g, %.15g]",
                                 i ? "," : "", e->centre.x, e->centre.y, e->centre.z, e->radius.x,
                                 e->radius.y, e->radius.z);
    }
    gsn_phantom_buffer_print(text,
                             "],\n    \"region\": {\"depth\": %.15g, \"half_height\": %.15g, "
                             "\"radius\": %.15g}\n  },\n",
                             g->region_depth, g->region_half_height, g->region_radius);
}

static void add_lesion(struct gsn_phantom_buffer *text, const struct gsn_phantom_geometry *g,
                       double depth)
{
    gsn_phantom_buffer_print(text,
                             "  \"lesion\": {\"A\": %.15g, \"centre\": [%.15g, %.15g, %.15g], "
                             "\"s\": [%.15g, %.15g, %.15g], \"lphi\": %.15g, \"in_pdl\": %.15g},\n",
                             depth, g->lesion.x, g->lesion.y, g->lesion.z, g->lesion_radius.x,
                             g->lesion_radius.y, g->lesion_radius.z, g->lesion_turn,
                             g->lesion_in_pdl);
}

static void add_dye(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan,
                    const char *name, enum gsn_phantom_dye dye)
{
    double v[3];

    gsn_phantom_variant_dye(&plan->variant, dye, v);
    gsn_phantom_buffer_print(text, "    \"%s\": [%.15g, %.15g, %.15g],\n", name, v[0], v[1], v[2]);
}

static void add_stain(struct gsn_phantom_buffer *text, const struct gsn_phantom_plan *plan)
{
    const struct gsn_phantom_recipe *recipe = gsn_phantom_recipe();
    const double *white = gsn_phantom_white;

    gsn_phantom_buffer_print(text, "  \"stain\": {\n    \"I0\": [%.15g, %.15g, %.15g],\n", white[0],
                             white[1], white[2]);
    add_dye(text, plan, "RED", GSN_PHANTOM_RED);
    add_dye(text, plan, "YEL", GSN_PHANTOM_YELLOW);
    add_dye(text, plan, "NUC", GSN_PHANTOM_NUCLEAR);
    add_dye(text, plan, "MARK", GSN_PHANTOM_MARK);
    add_layers(text, "nf", recipe->nuclei);
    add_layers(text, "amp", recipe->amplitude);
    gsn_phantom_buffer_print(text,
                             "    \"red\": %.15g, \"yellow\": %.15g, \"yellow_loss\": %.15g, "
                             "\"nuclear\": %.15g,\n    \"kr\": %.15g, \"ky\": %.15g\n  },\n",
                             recipe->red_amount, recipe->yellow_amount, recipe->yellow_loss,
                             recipe->nuclear_amount, plan->specimen.red_gain,
                             plan->specimen.yellow_gain);
}

static void add_level(struct gsn_phantom_buffer *text, const struct gsn_phantom_level *level)
{
    gsn_phantom_buffer_print(
        text,
        "  \"parameters\": {\n    \"turn_within_deg\": %g, \"turn_sd_deg\": %g, "
        "\"half_turn_share\": %g, \"flip_share\": %g,\n    \"jitter_um\": %g, \"size_sd\": %g, "
        "\"axis_sd\": %g, \"warp_rms_um\": %g,\n    \"mark_missing_share\": %g, "
        "\"mark_wander_um\": %g, \"decoys_most\": %d,\n",
        level->turn_within_deg, level->turn_sd_deg, level->half_turn_share, level->flip_share,
        level->jitter_um, level->size_sd, level->axis_sd, level->warp_rms_um,
        level->mark_missing_share, level->mark_wander_um, level->decoys_most);
    gsn_phantom_buffer_print(
        text,
        "    \"ln_red_sd\": %g, \"ln_yellow_sd\": %g, \"dye_turn_deg\": %g, \"white_sd\": %g,\n"
        "    \"ramp\": %g, \"illumination\": %g, \"noise_sd\": %g, \"texture\": %g,\n"
        "    \"defects_least\": %d, \"defects_most\": %d, \"missing_most\": %d, "
        "\"file\": \"%s\"\n  },\n",
        level->ln_red_sd, level->ln_yellow_sd, level->dye_turn_deg, level->white_sd, level->ramp,
        level->illumination, level->noise_sd, level->texture, level->defects_least,
        level->defects_most, level->missing_most, level->extension);
}

static int write_parameters(const struct gsn_phantom_plan *plan, const char *folder,
                            struct gsn_error *err)
{
    const struct gsn_phantom_geometry *g = &plan->variant.geometry;
    gsn_auto_phantom_buffer text = { 0 };

    gsn_phantom_buffer_print(&text,
                             "{\n  \"version\": \"GVP-1\",\n  \"specimen\": \"%s-%s\",\n"
                             "  \"level\": \"%s\",\n  \"seed\": %llu,\n  \"px_um\": %.15g,\n",
                             GSN_PHANTOM_STUDY, plan->specimen.name, plan->level.name,
                             (unsigned long long)plan->seed, plan->px_um);
    if (plan->variant.text)
        gsn_phantom_buffer_print(&text, "  \"variant\": %s,\n", plan->variant.text);
    add_geometry(&text, g);
    add_lesion(&text, g, plan->specimen.depth);
    if (g->floor > 0)
        gsn_phantom_buffer_print(&text, "  \"floor\": %.15g,\n", g->floor);
    if (plan->specimen.bone_gain != 1)
        gsn_phantom_buffer_print(&text, "  \"bone_gain\": %.15g,\n", plan->specimen.bone_gain);
    add_stain(&text, plan);
    gsn_phantom_buffer_print(&text,
                             "  \"texture_source\": {\"file\": \"%s\", \"sha256\": \"%s\"},\n",
                             GSN_PHANTOM_TEXTURE_FILE, GSN_PHANTOM_TEXTURE_SHA256);
    add_level(&text, &plan->level);
    gsn_phantom_record_drawn(plan, &text);
    return gsn_phantom_buffer_write(&text, folder, "truth.json", err);
}

int gsn_phantom_write_truth(const struct gsn_phantom_plan *plan,
                            const struct gsn_phantom_extent extent[GSN_PHANTOM_SECTIONS],
                            int with_density, unsigned threads, const char *folder,
                            struct gsn_error *err)
{
    const struct gsn_phantom_geometry *g = &plan->variant.geometry;
    const struct gsn_lattice whole = gsn_phantom_truth_lattice(g);
    int r;

    r = write_parameters(plan, folder, err);
    if (r >= 0)
        r = gsn_phantom_tables_write(plan, extent, folder, err);
    if (r >= 0)
        r = write_region(g, &whole, folder, "roi", err);
    if (r >= 0 && with_density)
        r = write_density(plan, threads, folder, err);
    if (r >= 0)
        r = write_loss(plan, threads, folder, err);
    return r;
}
