/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Cuts across one axis as pictures of values or colours.
 *
 * Steps: (1) the frame: the region's bounds with a margin, or a voxel of the region near its mean
 * for the point through which cuts go; (2) the pixel centres are the nodes of a lattice one voxel
 * thick, at which the spline is resampled (model/resample.h) and grids give the voxel that the
 * pixel lies in, without interpolation; (3) values through a colour map on a sheet with scales
 * (canvas.h), no data hatched; (4) the region's outline along the pixel edges where it begins or
 * ends.
 *
 * Failure: GSN_E_INPUT for an empty region, GSN_E_NOMEM. Cost: one value a pixel. */
#include "pipeline/render/cut.h"

#include <assert.h>
#include <math.h>
#include <stdio.h>

#include "pipeline/model/resample.h"
#include "pipeline/render/lettering.h"

static const struct gsn_colour outline_colour = { 214, 48, 49 };
static const char axis_name[3] = { 'x', 'y', 'z' };

/* Which axes run to the right and down in a cut. */
static void plane_axes(enum gsn_axis axis, int *ret_right, int *ret_down)
{
    *ret_right = axis == GSN_AXIS_X ? 1 : 0;
    *ret_down = axis == GSN_AXIS_Z ? 1 : 2;
}

static void voxel_place(const struct gsn_lattice *at, size_t index, double ret_centre[3])
{
    const struct gsn_vec3 centre =
        gsn_lattice_centre(at, index % at->nx, index / at->nx % at->ny, index / at->nx / at->ny);

    ret_centre[0] = centre.x;
    ret_centre[1] = centre.y;
    ret_centre[2] = centre.z;
}

static int empty_region(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT, "the region of interest is empty: there is nothing to cut");
}

int gsn_cut_centre(const struct gsn_mask *region, struct gsn_vec3 *ret_centre_um,
                   struct gsn_error *err)
{
    const size_t total = gsn_lattice_count(&region->at), count = gsn_mask_count(region);
    double mean[3] = { 0.0, 0.0, 0.0 }, nearest = INFINITY;
    struct gsn_vec3 centre = { 0.0, 0.0, 0.0 };

    if (count == 0)
        return empty_region(err);
    for (size_t i = 0; i < total; i++) {
        double p[3];

        if (!region->inside[i])
            continue;
        voxel_place(&region->at, i, p);
        for (int a = 0; a < 3; a++)
            mean[a] += p[a] / (double)count;
    }
    for (size_t i = 0; i < total; i++) {
        double p[3], away;

        if (!region->inside[i])
            continue;
        voxel_place(&region->at, i, p);
        away = (p[0] - mean[0]) * (p[0] - mean[0]) + (p[1] - mean[1]) * (p[1] - mean[1]) +
               (p[2] - mean[2]) * (p[2] - mean[2]);
        if (away < nearest) {
            nearest = away;
            centre = gsn_vec3_make(p[0], p[1], p[2]);
        }
    }
    *ret_centre_um = centre;
    return GSN_OK;
}

int gsn_cut_frame(const struct gsn_mask *region, enum gsn_axis axis, struct gsn_vec3 through_um,
                  uint32_t longest_px, struct gsn_cut_frame *ret_frame, struct gsn_error *err)
{
    const size_t total = gsn_lattice_count(&region->at);
    const double step[3] = { region->at.step_um.x, region->at.step_um.y, region->at.step_um.z };
    const double through[3] = { through_um.x, through_um.y, through_um.z };
    double low[3] = { INFINITY, INFINITY, INFINITY }, high[3] = { -INFINITY, -INFINITY, -INFINITY };
    double longest, margin;
    int right, down;

    assert(longest_px > 0);
    for (size_t i = 0; i < total; i++) {
        double p[3];

        if (!region->inside[i])
            continue;
        voxel_place(&region->at, i, p);
        for (int a = 0; a < 3; a++) {
            low[a] = fmin(low[a], p[a] - 0.5 * step[a]);
            high[a] = fmax(high[a], p[a] + 0.5 * step[a]);
        }
    }
    plane_axes(axis, &right, &down);
    if (!(low[right] < high[right]))
        return empty_region(err);
    longest = fmax(high[right] - low[right], high[down] - low[down]);
    margin = 0.03 * longest;
    longest += 2.0 * margin;
    *ret_frame = (struct gsn_cut_frame){
        .axis = axis,
        .at_um = through[axis],
        .left_um = low[right] - margin,
        .top_um = low[down] - margin,
        .um_per_px = longest / longest_px,
        .width =
            (uint32_t)ceil((high[right] - low[right] + 2.0 * margin) / longest * longest_px - 1e-6),
        .height =
            (uint32_t)ceil((high[down] - low[down] + 2.0 * margin) / longest * longest_px - 1e-6),
    };
    return GSN_OK;
}

/* The pixels as voxels, one of them along the axis. */
static struct gsn_lattice pixels_of(const struct gsn_cut_frame *frame)
{
    const double px = frame->um_per_px;
    size_t n[3] = { 1, 1, 1 };
    double first[3];
    int right, down;

    plane_axes(frame->axis, &right, &down);
    n[right] = frame->width;
    n[down] = frame->height;
    first[frame->axis] = frame->at_um;
    first[right] = frame->left_um + 0.5 * px;
    first[down] = frame->top_um + 0.5 * px;
    return (struct gsn_lattice){ .nx = n[0],
                                 .ny = n[1],
                                 .nz = n[2],
                                 .origin_um = gsn_vec3_make(first[0], first[1], first[2]),
                                 .step_um = gsn_vec3_make(px, px, px) };
}

struct gsn_vec3 gsn_cut_pixel(const struct gsn_cut_frame *frame, size_t i, size_t j)
{
    const struct gsn_lattice pixels = pixels_of(frame);
    size_t at[3] = { 0, 0, 0 };
    int right, down;

    plane_axes(frame->axis, &right, &down);
    at[right] = i;
    at[down] = j;
    return gsn_lattice_centre(&pixels, at[0], at[1], at[2]);
}

int gsn_cut_spline(const struct gsn_spline *spline, const struct gsn_cut_frame *frame,
                   unsigned threads, struct gsn_plane **ret_plane, struct gsn_error *err)
{
    const struct gsn_lattice pixels = pixels_of(frame);
    const size_t count = gsn_lattice_count(&pixels);
    gsn_auto(gsn_plane) plane = NULL;
    gsn_auto_mem(double) value = NULL;
    int r = gsn_plane_new(frame->width, frame->height, &plane, err);

    if (r < 0)
        return r;
    value = gsn_alloc_array(count, sizeof *value);
    if (!value)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a cut of %u x %u pixels", frame->width,
                        frame->height);
    r = gsn_spline_resample(spline, &pixels, threads, value, err);
    if (r < 0)
        return r;
    /* The lattice runs along the right axis before the down axis, as a plane does. */
    for (size_t i = 0; i < count; i++)
        plane->value[i] = (float)value[i];
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}

/* The voxel along one axis whose cell holds the coordinate, or n. */
static size_t cell_of(double at, double origin, double step, size_t n)
{
    const double cell = floor((at - origin) / step + 0.5);

    return cell >= 0.0 && cell < (double)n ? (size_t)cell : n;
}

/* Which voxel a point lies in; returns 0 beyond the lattice. */
static int voxel_of(const struct gsn_lattice *at, struct gsn_vec3 p, size_t *ret_index)
{
    const size_t x = cell_of(p.x, at->origin_um.x, at->step_um.x, at->nx);
    const size_t y = cell_of(p.y, at->origin_um.y, at->step_um.y, at->ny);
    const size_t z = cell_of(p.z, at->origin_um.z, at->step_um.z, at->nz);

    if (x >= at->nx || y >= at->ny || z >= at->nz)
        return 0;
    *ret_index = gsn_lattice_index(at, x, y, z);
    return 1;
}

static float grid_at(const struct gsn_grid *grid, struct gsn_vec3 p)
{
    size_t index;

    return voxel_of(&grid->at, p, &index) ? grid->value[index] : NAN;
}

int gsn_cut_grid(const struct gsn_grid *grid, const struct gsn_cut_frame *frame,
                 struct gsn_plane **ret_plane, struct gsn_error *err)
{
    gsn_auto(gsn_plane) plane = NULL;
    const int r = gsn_plane_new(frame->width, frame->height, &plane, err);

    if (r < 0)
        return r;
    for (uint32_t j = 0; j < frame->height; j++) {
        for (uint32_t i = 0; i < frame->width; i++)
            plane->value[(size_t)j * frame->width + i] = grid_at(grid, gsn_cut_pixel(frame, i, j));
    }
    *ret_plane = gsn_steal(&plane);
    return GSN_OK;
}

void gsn_cut_range(const struct gsn_grid *grid, const struct gsn_mask *region, double *ret_low,
                   double *ret_high)
{
    double low = INFINITY, high = -INFINITY;

    assert(gsn_lattice_count(&grid->at) == gsn_lattice_count(&region->at));
    for (size_t i = 0; i < gsn_lattice_count(&grid->at); i++) {
        if (region->inside[i]) {
            low = fmin(low, (double)grid->value[i]);
            high = fmax(high, (double)grid->value[i]);
        }
    }
    if (low > high)
        low = high = 0;
    *ret_low = low;
    *ret_high = low < high ? high : low + fmax(1, fabs(low));
}

/* A line on every pixel edge at which the region ends, as wide as the pixels on both sides. */
static int draw_outline(struct gsn_image *sheet, int x0, int y0, const struct gsn_cut_frame *frame,
                        const struct gsn_mask *region, struct gsn_error *err)
{
    gsn_auto(gsn_pen) pen = NULL;
    const int r = gsn_pen_new(sheet, &pen, err);

    if (r < 0)
        return r;
    for (int j = 0; j < (int)frame->height; j++) {
        for (int i = 0; i < (int)frame->width; i++) {
            const size_t x = (size_t)i, y = (size_t)j;
            const int here = gsn_mask_has(region, gsn_cut_pixel(frame, x, y));

            if (here != gsn_mask_has(region, gsn_cut_pixel(frame, x + 1, y)))
                gsn_pen_line(pen, x0 + i + 1, y0 + j, x0 + i + 1, y0 + j + 1);
            if (here != gsn_mask_has(region, gsn_cut_pixel(frame, x, y + 1)))
                gsn_pen_line(pen, x0 + i, y0 + j + 1, x0 + i + 1, y0 + j + 1);
        }
    }
    return gsn_pen_ink(pen, sheet, 2.0, outline_colour, err);
}

enum { NOTE = 64 };

static void describe_cut(const struct gsn_cut_frame *frame, char note[NOTE])
{
    int right, down;

    plane_axes(frame->axis, &right, &down);
    (void)snprintf(note, NOTE, "%c = %.0f \xc2\xb5m  (%c right, %c down)", axis_name[frame->axis],
                   frame->at_um, axis_name[right], axis_name[down]);
}

int gsn_cut_paint(const struct gsn_plane *plane, const struct gsn_cut_frame *frame,
                  const struct gsn_mask *region, const struct gsn_cut_style *style,
                  struct gsn_image **ret_image, struct gsn_error *err)
{
    gsn_auto(gsn_image) sheet = NULL;
    struct gsn_plate plate = { .title = style->title,
                               .um_per_px = frame->um_per_px,
                               .has_scale = 1,
                               .unit = style->unit,
                               .low = style->low,
                               .high = style->high,
                               .map = style->map };
    char note[NOTE];
    int r, x, y;

    assert(plane->width == frame->width && plane->height == frame->height);
    describe_cut(frame, note);
    plate.note = note;
    gsn_plate_range(plane, &plate.low, &plate.high);
    r = gsn_plate_new(&plate, plane->width, plane->height, &sheet, &x, &y, err);
    if (r < 0)
        return r;
    gsn_plate_fill(sheet, x, y, plane, plate.map, plate.low, plate.high);
    if (region)
        r = draw_outline(sheet, x, y, frame, region, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}

/* Returns 0 where there is no data. */
static int colour_at(const struct gsn_colour_grid *grid, struct gsn_vec3 p,
                     struct gsn_colour *ret_colour)
{
    const uint8_t *rgb;
    size_t index;

    if (!voxel_of(&grid->at, p, &index))
        return 0;
    rgb = grid->rgb + 3 * index;
    *ret_colour = (struct gsn_colour){ .r = rgb[0], .g = rgb[1], .b = rgb[2] };
    return rgb[0] || rgb[1] || rgb[2];
}

int gsn_cut_colour(const struct gsn_colour_grid *grid, const struct gsn_cut_frame *frame,
                   const struct gsn_mask *region, const char *title, struct gsn_image **ret_image,
                   struct gsn_error *err)
{
    gsn_auto(gsn_image) sheet = NULL;
    char note[NOTE];
    const struct gsn_plate plate = { .title = title, .note = note, .um_per_px = frame->um_per_px };
    int r, x0, y0;

    describe_cut(frame, note);
    r = gsn_plate_new(&plate, frame->width, frame->height, &sheet, &x0, &y0, err);
    if (r < 0)
        return r;
    for (uint32_t j = 0; j < frame->height; j++)
        for (uint32_t i = 0; i < frame->width; i++) {
            struct gsn_colour colour;

            if (colour_at(grid, gsn_cut_pixel(frame, i, j), &colour))
                gsn_canvas_put(sheet, x0 + (int)i, y0 + (int)j, colour);
            else
                gsn_canvas_no_data(sheet, x0 + (int)i, y0 + (int)j);
        }
    if (region)
        r = draw_outline(sheet, x0, y0, frame, region, err);
    if (r < 0)
        return r;
    *ret_image = gsn_steal(&sheet);
    return GSN_OK;
}
