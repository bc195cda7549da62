/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly.h"

#include "pipeline/band.h"
#include "pipeline/evenness.h"
#include "pipeline/masking.h"
#include "pipeline/register/panel.h"
#include "pipeline/register/stack.h"
#include "pipeline/stain/spread.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

/* Voxels kept around the region of interest, so that cuts show what lies beside it. */
enum { MARGIN_VOXELS = 6, THUMBNAIL_PX = 132, MOST_TARGETS = 4096 };

/* Tissue is what absorbs this much in R, G and B together. A hundredth of it clipped is told; of a
 * fifth the mean of what is left says little, for it is the darkest that is missing. */
static const double LEAST_TISSUE_OD = 0.05, TOLD_CLIPPED = 0.01, MOST_CLIPPED = 0.2;

/* Of the white of a panel: test_glass finds it within a tenth of a percent. */
static const double WHITE_ERROR_OD = 0.0005;

/* A stack larger than this is a mistake in the region, not a block. */
static const double MOST_VOXELS_PER_SIDE = 1 << 20, MOST_VOXELS = 2147483648.0;

const char *gsn_assembly_state_name(enum gsn_assembly_state state)
{
    static const char *const names[] = { "used", "doubtful", "held", "missing", "empty" };

    return names[state];
}

static void flag(struct gsn_assembly_section *section, const char *word)
{
    const size_t used = strlen(section->flags);

    (void)snprintf(section->flags + used, sizeof section->flags - used, "%s%s", used ? " " : "",
                   word);
}

/* ---- slots ------------------------------------------------------------------------------- */

static int by_serial(const void *a, const void *b)
{
    const struct gsn_assembly_section *s = a, *t = b;

    if (s->seen.serial != t->seen.serial)
        return s->seen.serial < t->seen.serial ? -1 : 1;
    return s->panel < t->panel ? -1 : s->panel > t->panel;
}

static struct gsn_assembly_section section_of(const struct gsn_panel_section *seen, unsigned panel)
{
    static const enum gsn_assembly_state states[] = {
        [GSN_SIGHT_FOUND] = GSN_SECTION_HELD,      [GSN_SIGHT_NEEDS_EYE] = GSN_SECTION_HELD,
        [GSN_SIGHT_MISSING] = GSN_SECTION_MISSING, [GSN_SIGHT_EMPTY] = GSN_SECTION_EMPTY,
        [GSN_SIGHT_HELD] = GSN_SECTION_HELD,
    };
    struct gsn_assembly_section section = { .panel = panel,
                                            .seen = *seen,
                                            .state = states[seen->sighting] };

    if (seen->flags[0])
        flag(&section, seen->flags);
    return section;
}

static const struct gsn_specimen_panel *panel_numbered(const struct gsn_specimen *specimen,
                                                       unsigned number)
{
    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].number == number && specimen->panel[i].section_count > 0)
            return &specimen->panel[i];
    return NULL;
}

/* Every slot of every panel that the job expects or that came. */
static int list_slots(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                      struct gsn_error *err)
{
    const struct gsn_layout layout = gsn_protocol_layout(specimen->protocol);
    const unsigned slots = layout.rows * layout.columns;
    const unsigned expected = gsn_protocol_sections(specimen->protocol);
    unsigned panels = specimen->protocol->panels;

    for (size_t i = 0; i < specimen->panel_count; i++)
        if (specimen->panel[i].section_count > 0 && specimen->panel[i].number > panels)
            panels = specimen->panel[i].number;
    a->section = gsn_alloc_array((size_t)panels * slots, sizeof *a->section);
    if (!a->section)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the sections of a specimen");
    for (unsigned number = 1; number <= panels; number++) {
        const struct gsn_specimen_panel *panel = panel_numbered(specimen, number);

        for (unsigned slot = 0; slot < slots; slot++) {
            const unsigned serial = gsn_panel_serial(number, slot, &layout);
            const struct gsn_panel_section none = { .serial = serial,
                                                    .slot = slot,
                                                    .sighting = expected && serial >= expected
                                                                    ? GSN_SIGHT_EMPTY
                                                                    : GSN_SIGHT_MISSING };
            struct gsn_assembly_section *section = &a->section[a->section_count++];

            if (panel && slot < panel->section_count) {
                *section = section_of(&panel->section[slot], number);
            } else {
                *section = section_of(&none, number);
                flag(section, "no-panel");
            }
        }
    }
    qsort(a->section, a->section_count, sizeof *a->section, by_serial);
    return GSN_OK;
}

/* ---- region and lattice ------------------------------------------------------------------ */

struct box {
    struct gsn_vec3 low, high;
};

static struct box box_of_mask(const struct gsn_mask *mask)
{
    const struct gsn_lattice *at = &mask->at;
    struct box box = { { INFINITY, INFINITY, INFINITY }, { -INFINITY, -INFINITY, -INFINITY } };

    for (size_t i = 0, z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++, i++) {
                const struct gsn_vec3 u = gsn_lattice_centre(at, x, y, z);

                if (!mask->inside[i])
                    continue;
                box.low =
                    gsn_vec3_make(fmin(box.low.x, u.x), fmin(box.low.y, u.y), fmin(box.low.z, u.z));
                box.high = gsn_vec3_make(fmax(box.high.x, u.x), fmax(box.high.y, u.y),
                                         fmax(box.high.z, u.z));
            }
    return box;
}

static struct box box_of_shape(const struct gsn_region *region)
{
    const struct gsn_vec3 c = region->centre;
    const double r = region->radius_um;

    switch (region->kind) {
    case GSN_REGION_CYLINDER:
        return (struct box){ { c.x - r, c.y - r, region->low.z },
                             { c.x + r, c.y + r, region->high.z } };
    case GSN_REGION_SPHERE:
        return (struct box){ { c.x - r, c.y - r, c.z - r }, { c.x + r, c.y + r, c.z + r } };
    default:
        return (struct box){ region->low, region->high };
    }
}

/* Voxels of the scan's own pixel size, on the mask's raster where that has the same step. z planes
 * are the sections' own: all that the region needs, also those that the block has not, so that they
 * count as not seen; and one more on either side where the block has one. 0 when that makes no
 * lattice that could be worked with. */
static int lattice_for(struct box box, const struct gsn_mask *mask, double px_um,
                       double interval_um, unsigned sections, struct gsn_lattice *lattice)
{
    const int same = mask && fabs(mask->at.step_um.x / px_um - 1) < 1e-3 &&
                     fabs(mask->at.step_um.y / px_um - 1) < 1e-3;
    const double sx = same ? mask->at.step_um.x : px_um, sy = same ? mask->at.step_um.y : px_um;
    const double ox = same ? mask->at.origin_um.x : 0, oy = same ? mask->at.origin_um.y : 0;
    const double x0 = floor((box.low.x - ox) / sx) - MARGIN_VOXELS;
    const double y0 = floor((box.low.y - oy) / sy) - MARGIN_VOXELS;
    const double first = floor(box.low.z / interval_um), last = ceil(box.high.z / interval_um) - 1;
    const double z0 = first > 0 ? first - 1 : first;
    const double z1 = last < sections - 1.0 ? last + 1 : last;
    const double nx = ceil((box.high.x - ox) / sx) + MARGIN_VOXELS - x0 + 1;
    const double ny = ceil((box.high.y - oy) / sy) + MARGIN_VOXELS - y0 + 1;
    const double nz = z1 - z0 + 1;

    if (!(first < sections && last >= 0 && nx <= MOST_VOXELS_PER_SIDE &&
          ny <= MOST_VOXELS_PER_SIDE && nx * ny * nz <= MOST_VOXELS))
        return 0;
    *lattice = (struct gsn_lattice){
        .nx = (size_t)nx,
        .ny = (size_t)ny,
        .nz = (size_t)nz,
        .origin_um = gsn_vec3_make(ox + x0 * sx, oy + y0 * sy, (z0 + 0.5) * interval_um),
        .step_um = gsn_vec3_make(sx, sy, interval_um),
    };
    return 1;
}

/* The stack's voxels are as fine as the finest panel. */
static double finest_pixel(const struct gsn_specimen *specimen)
{
    double finest = 0;

    for (size_t i = 0; i < specimen->panel_count; i++) {
        const double px_um = specimen->panel[i].px_um;

        if (specimen->panel[i].section_count > 0 && (finest == 0 || px_um < finest))
            finest = px_um;
    }
    return finest;
}

static int copy_mask(const struct gsn_mask *mask, struct gsn_mask **ret_mask, struct gsn_error *err)
{
    const int r = gsn_mask_new(&mask->at, ret_mask, err);

    if (r >= 0)
        memcpy((*ret_mask)->inside, mask->inside, gsn_lattice_count(&mask->at));
    return r;
}

static int place_region(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                        struct gsn_assembly *a, struct gsn_lattice *lattice, struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->region;
    struct box box;

    if (specimen->region && gsn_mask_count(specimen->region) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region mask is empty: no voxel in it is set");
    box = specimen->region ? box_of_mask(specimen->region) : box_of_shape(stated);
    if (!lattice_for(box, specimen->region, px_um, specimen->protocol->interval_um, sections,
                     lattice))
        return gsn_fail(err, GSN_E_INPUT,
                        "the region of interest (z %g to %g um) does not lie in this block of "
                        "%u sections every %g um",
                        box.low.z, box.high.z, sections, specimen->protocol->interval_um);
    return specimen->region ? copy_mask(specimen->region, &a->region, err)
                            : gsn_region_raster(stated, lattice, &a->region, err);
}

/* ---- poses ------------------------------------------------------------------------------- */

/* Points of the region, thinned evenly: where the predicted error matters. */
static int targets_of(const struct gsn_mask *region, struct gsn_point **ret_points,
                      size_t *ret_count, struct gsn_error *err)
{
    const size_t total = region ? gsn_mask_count(region) : 0;
    const size_t every = total / MOST_TARGETS + 1;
    gsn_auto_mem(struct gsn_point) points = gsn_alloc_array(total / every + 1, sizeof *points);
    size_t seen = 0, count = 0;

    if (!points)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for target points");
    for (size_t i = 0; total && i < gsn_lattice_count(&region->at); i++) {
        const size_t x = i % region->at.nx, y = i / region->at.nx % region->at.ny;
        struct gsn_vec3 u;

        if (!region->inside[i] || seen++ % every != 0)
            continue;
        u = gsn_lattice_centre(&region->at, x, y, 0);
        points[count++] = (struct gsn_point){ .x = u.x, .y = u.y };
    }
    *ret_points = gsn_steal(&points);
    *ret_count = count;
    return GSN_OK;
}

static void take_pose(struct gsn_assembly_section *section, const struct gsn_pose *pose)
{
    struct gsn_mark in_order[GSN_MARKS];

    section->pose = *pose;
    section->posed = pose->state != GSN_POSE_NONE;
    for (size_t i = 0; i < GSN_MARKS; i++)
        in_order[i] = section->seen.mark[pose->order[i]];
    if (section->posed)
        memcpy(section->seen.mark, in_order, sizeof in_order);
    if (pose->gross)
        flag(section, "residual-too-large");
    if (pose->flipped)
        flag(section, "flipped");
    if (pose->rotated180)
        flag(section, "turned");
    if (!section->posed || pose->gross)
        section->state = GSN_SECTION_HELD;
    else
        section->state =
            pose->state == GSN_POSE_TWO_MARKS ? GSN_SECTION_DOUBTFUL : GSN_SECTION_USED;
}

static enum gsn_strain_mode strain_mode(const struct gsn_protocol *protocol)
{
    static const enum gsn_strain_mode modes[] = {
        [GSN_STATED_STRAIN_REPORTED] = GSN_STRAIN_REPORTED,
        [GSN_STATED_STRAIN_RIGID] = GSN_STRAIN_RIGID,
        [GSN_STATED_STRAIN_CORRECTED] = GSN_STRAIN_CORRECTED,
    };

    return modes[protocol->strain];
}

/* Does with the sections' strain what the protocol says. */
static void use_strain(struct gsn_assembly *a, const struct gsn_pose_options *options)
{
    const struct gsn_pose_targets targets =
        gsn_pose_targets_of(options->targets_um, options->target_count);

    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];

        if (!s->posed || !a->summary.stretches || a->strain_mode != GSN_STRAIN_CORRECTED)
            continue;
        s->pose.panel_to_block_um = gsn_strain_corrected(&s->pose);
        if (targets.count > 0)
            s->pose.tre_um = gsn_pose_tre_rms(&s->pose.error, &targets, 1);
    }
}

static int solve_poses(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                       struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_pose_input) inputs = gsn_alloc_array(a->section_count, sizeof *inputs);
    gsn_auto_mem(struct gsn_pose) poses = gsn_alloc_array(a->section_count, sizeof *poses);
    gsn_auto_mem(struct gsn_point) targets = NULL;
    struct gsn_pose_options options = { .markers_um = specimen->protocol->has_markers
                                                          ? specimen->protocol->markers_um
                                                          : NULL };
    struct gsn_error why = { 0 };
    size_t count = 0;
    int r;

    if (!inputs || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for poses");
    r = targets_of(a->region, &targets, &options.target_count, err);
    if (r < 0)
        return r;
    options.targets_um = targets;
    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].state == GSN_SECTION_HELD) {
            inputs[count] = (struct gsn_pose_input){
                .serial = a->section[i].seen.serial,
                .px_um = panel_numbered(specimen, a->section[i].panel)->px_um,
                .mirrored = strstr(a->section[i].seen.flags, "mirrored") != NULL
            };
            memcpy(inputs[count].marks, a->section[i].seen.mark, sizeof inputs[count].marks);
            count++;
        }
    r = gsn_pose_solve(inputs, count, &options, poses, &a->summary, &why);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    a->solved = r >= 0;
    if (r < 0)
        memcpy(a->unsolved, why.text, sizeof a->unsolved);
    for (size_t i = 0, p = 0; r >= 0 && i < a->section_count; i++)
        if (a->section[i].state == GSN_SECTION_HELD)
            take_pose(&a->section[i], &poses[p++]);
    if (r < 0)
        return GSN_OK;
    a->panel_stretch =
        gsn_strain_of_panel(inputs, poses, count, options.markers_um, a->summary.mean_triangle);
    a->strain_mode = strain_mode(specimen->protocol);
    use_strain(a, &options);
    return GSN_OK;
}

/* ---- density, panel by panel ------------------------------------------------------------- */

/* Defects: their pixels lose their density. */
static int mask_panel(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                      const struct gsn_specimen_stain *stain, struct gsn_plane *density,
                      struct gsn_assembly *a, struct gsn_error *err)
{
    gsn_auto(gsn_image) labels = NULL;
    const int r =
        gsn_masking_find(scan, &stain->fit.dyes, stain->panel, options->threads, a, &labels, err);

    if (r < 0)
        return r;
    gsn_masking_region(labels, stain->panel, specimen->protocol->interval_um, a);
    gsn_mask_apply(labels, density);
    return GSN_OK;
}

/* A sample at either end of its codes only says "or beyond". All three at the top are bare glass.
 */
static int is_clipped(const struct gsn_image *image, uint32_t x, uint32_t y)
{
    const unsigned top = image->bits == 8 ? 255 : 65535;
    unsigned at_top = 0, at_zero = 0;

    for (unsigned c = 0; c < 3; c++) {
        const unsigned sample = gsn_image_at(image, x, y, c);

        at_top += sample == top;
        at_zero += sample == 0;
    }
    return at_zero > 0 || (at_top > 0 && at_top < 3);
}

/* Masks the clipped pixels of a section and says which share of its tissue they are. */
static double mask_clipped(const struct gsn_scan *scan, const struct gsn_panel_section *seen,
                           struct gsn_plane *density)
{
    const struct gsn_image *image = scan->picture->image;
    size_t tissue = 0, clipped = 0;

    for (int y = seen->y; y < seen->y + seen->height; y++)
        for (int x = seen->x; x < seen->x + seen->width; x++) {
            const size_t i = (size_t)y * density->width + (size_t)x;
            const double od = scan->od[0]->value[i] + scan->od[1]->value[i] + scan->od[2]->value[i];

            if (!(od > LEAST_TISSUE_OD))
                continue;
            tissue++;
            if (!is_clipped(image, (uint32_t)x, (uint32_t)y))
                continue;
            clipped++;
            density->value[i] = NAN;
        }
    return tissue ? (double)clipped / (double)tissue : 0;
}

static void judge_clipped(const struct gsn_scan *scan, unsigned number, struct gsn_plane *density,
                          struct gsn_assembly *a)
{
    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        char word[32];

        if (s->panel != number || s->seen.width <= 0 || s->seen.height <= 0)
            continue;
        s->clipped = mask_clipped(scan, &s->seen, density);
        if (s->clipped <= TOLD_CLIPPED)
            continue;
        (void)snprintf(word, sizeof word, "clipped-%.0f%%", 100 * s->clipped);
        flag(s, word);
        if (s->clipped > MOST_CLIPPED)
            s->state = GSN_SECTION_HELD;
    }
}

static int thumbnails(const struct gsn_scan *scan, unsigned number, struct gsn_assembly *a,
                      struct gsn_error *err)
{
    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];
        int r;

        if (s->panel != number || s->seen.width <= 0 || s->seen.height <= 0)
            continue;
        r = gsn_thumbnail(scan->picture->image, s->seen.x, s->seen.y, s->seen.width, s->seen.height,
                          s->seen.mark, THUMBNAIL_PX, &s->thumbnail, err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

/* A serial that an earlier section of the list already fills. */
static int taken(const struct gsn_assembly *a, size_t i)
{
    for (size_t j = 0; j < i; j++)
        if (a->section[j].seen.serial == a->section[i].seen.serial &&
            (a->section[j].state == GSN_SECTION_USED ||
             a->section[j].state == GSN_SECTION_DOUBTFUL))
            return 1;
    return 0;
}

static size_t sections_of_panel(struct gsn_assembly *a, unsigned number,
                                const struct gsn_plane *density, struct gsn_stack_section *sections)
{
    size_t count = 0;

    for (size_t i = 0; i < a->section_count; i++) {
        struct gsn_assembly_section *s = &a->section[i];

        if (s->panel != number ||
            (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL))
            continue;
        if (taken(a, i)) {
            s->state = GSN_SECTION_HELD;
            flag(s, "duplicate-serial");
            continue;
        }
        sections[count++] =
            (struct gsn_stack_section){ .serial = s->seen.serial,
                                        .density = density,
                                        .panel_to_block_um = s->pose.panel_to_block_um,
                                        .x = s->seen.x,
                                        .y = s->seen.y,
                                        .width = s->seen.width,
                                        .height = s->seen.height };
    }
    return count;
}

static void merge(const struct gsn_grid *from, struct gsn_grid *into)
{
    const size_t total = gsn_lattice_count(&into->at);

    for (size_t i = 0; i < total; i++)
        if (!isnan(from->value[i]))
            into->value[i] = from->value[i];
}

static int resample_into(const struct gsn_stack_section *sections, size_t count, double interval_um,
                         unsigned threads, struct gsn_grid *into, struct gsn_error *err)
{
    gsn_auto(gsn_grid) grid = NULL;
    const int r = gsn_stack_resample(sections, count, &into->at, interval_um, threads, &grid, err);

    if (r >= 0)
        merge(grid, into);
    return r;
}

static int stack_panel(const struct gsn_specimen *specimen,
                       const struct gsn_specimen_options *options, unsigned number,
                       const struct gsn_plane *density, struct gsn_assembly *a,
                       struct gsn_error *err)
{
    const double interval_um = specimen->protocol->interval_um;
    gsn_auto_mem(struct gsn_stack_section) sections =
        gsn_alloc_array(a->section_count, sizeof *sections);
    size_t count;
    int r;

    if (!sections)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the stack");
    count = sections_of_panel(a, number, density, sections);
    if (count == 0)
        return GSN_OK;
    r = resample_into(sections, count, interval_um, options->threads, a->grid, err);
    if (r >= 0 && a->tissue_grid)
        r = resample_into(sections, count, interval_um, options->threads, a->tissue_grid, err);
    return r;
}

/* What the dye vectors and the white of a panel leave open. */
static int judge_vectors(const struct gsn_scan *scan, struct gsn_assembly_panel *panel,
                         struct gsn_error *err)
{
    const struct gsn_dyes_fit *fit = &panel->stain.fit;
    struct gsn_red_mean red;
    int r;

    if (!(fit->deviation_deg[0] > 0))
        return GSN_OK;
    r = gsn_red_mean(scan->od, NULL, &fit->dyes, &red, err);
    if (r < 0)
        return r;
    red.sampling = 0; /* of the glass beside the tissue it would say nothing */

    const struct gsn_red_side side = { &red, fit, WHITE_ERROR_OD, 1, 0 };

    panel->red_error = gsn_red_half_width(&side) / 1.96 / red.mean;
    return GSN_OK;
}

static int work_panel(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options, struct gsn_assembly_panel *panel,
                      struct gsn_assembly *a, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto(gsn_scan) scan = NULL;
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_specimen_stain *stain = &panel->stain;
    size_t size;
    int r = specimen->read(specimen->context, panel->given->sha256, &bytes, &size, err);

    if (r >= 0)
        r = gsn_scan_open(options->decoder, bytes, size, specimen->protocol, options->threads,
                          &scan, err);
    if (r >= 0)
        r = gsn_scan_dyes(scan, specimen->protocol, &stain->fit, err);
    if (r >= 0)
        r = thumbnails(scan, panel->given->number, a, err);
    if (r < 0)
        return r;
    panel->opened = 1;
    panel->glass = scan->glass;
    stain->panel = panel->given->number;
    memcpy(stain->white, scan->glass.white, sizeof stain->white);
    (void)snprintf(panel->note, sizeof panel->note, "%s", scan->note);
    if (!a->grid)
        return GSN_OK;
    r = gsn_unmix(scan->od, &stain->fit.dyes, options->threads, &density, NULL, NULL, err);
    if (r < 0)
        return r;
    r = mask_panel(specimen, options, scan, stain, density, a, err);
    if (r < 0)
        return r;
    r = judge_vectors(scan, panel, err);
    if (r < 0)
        return r;
    judge_clipped(scan, stain->panel, density, a);
    r = gsn_evenness_of_panel(a, stain->panel, density, &panel->strength, err);
    if (r < 0)
        return r;
    return stack_panel(specimen, options, stain->panel, density, a, err);
}

static int work_panels(const struct gsn_specimen *specimen,
                       const struct gsn_specimen_options *options, struct gsn_assembly *a,
                       struct gsn_error *err)
{
    a->panel = gsn_alloc_array(specimen->panel_count, sizeof *a->panel);
    if (!a->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the panels of a specimen");
    a->panel_count = specimen->panel_count;
    for (size_t i = 0; i < specimen->panel_count; i++) {
        int r;

        a->panel[i].given = &specimen->panel[i];
        gsn_progress_say(options->progress, "stacking", i, specimen->panel_count);
        if (specimen->panel[i].section_count == 0)
            continue;
        r = work_panel(specimen, options, &a->panel[i], a, err);
        if (r < 0)
            return gsn_fail_at(err, "panel %u (%s)", specimen->panel[i].number,
                               specimen->panel[i].file);
    }
    return GSN_OK;
}

/* Panels that have a section in the planes of the grid. */
static size_t panels_inside(const struct gsn_assembly *a, double interval_um)
{
    const struct gsn_lattice *at = &a->grid->at;
    unsigned last = 0;
    size_t count = 0;

    /* Sections are sorted by serial number, so those of one panel follow each other. */
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];
        const double z = interval_um * (s->seen.serial + 0.5);

        if ((s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL) ||
            s->panel == last || z < at->origin_um.z - 0.5 * at->step_um.z ||
            z > at->origin_um.z + ((double)at->nz - 0.5) * at->step_um.z)
            continue;
        last = s->panel;
        count++;
    }
    return count;
}

/* What unequal stain adds, where no reference tissue takes it out. */
static double uneven_error(const struct gsn_specimen *specimen, struct gsn_assembly *a)
{
    double strength[64];
    struct gsn_evenness evenness;
    size_t count = 0, inside;

    if (!a->grid || (a->tissue_grid && !a->not_comparable[0]))
        return 0;
    for (size_t p = 0; p < a->panel_count && count < sizeof strength / sizeof strength[0]; p++)
        if (a->panel[p].opened)
            strength[count++] = a->panel[p].strength;
    inside = panels_inside(a, specimen->protocol->interval_um);
    evenness = gsn_evenness_of(strength, count, inside > 0 ? inside : 1);
    a->stain_scatter = evenness.scatter;
    return evenness.error;
}

/* The vectors of all panels lean on one prior, so their errors are taken as common; gains are
 * measured panel by panel. */
static void sum_errors(const struct gsn_specimen *specimen, struct gsn_assembly *a)
{
    const double uneven = uneven_error(specimen, a);
    double vectors = 0, gains = 0, panels = 0;

    for (size_t p = 0; p < a->panel_count; p++) {
        const struct gsn_assembly_panel *panel = &a->panel[p];

        if (!panel->opened)
            continue;
        panels++;
        vectors += panel->red_error;
        if (panel->gain.gain > 0)
            gains += panel->gain.error * panel->gain.error / (panel->gain.gain * panel->gain.gain);
    }
    if (panels > 0)
        a->red_error = hypot(hypot(vectors / panels, sqrt(gains) / panels), uneven);
}

static int empty_grid(const struct gsn_lattice *lattice, struct gsn_grid **ret_grid,
                      struct gsn_error *err)
{
    const int r = gsn_grid_new(lattice, ret_grid, err);

    for (size_t i = 0; r >= 0 && i < gsn_lattice_count(lattice); i++)
        (*ret_grid)->value[i] = NAN;
    return r;
}

/* ---- the internal reference -------------------------------------------------------------- */

static int place_reference(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                           struct gsn_assembly *a, struct gsn_error *err)
{
    const struct gsn_region *stated = &specimen->protocol->reference_tissue;
    struct gsn_lattice lattice;
    int r;

    if (stated->kind == GSN_REGION_NONE || !a->grid)
        return GSN_OK;
    if (!lattice_for(box_of_shape(stated), NULL, px_um, specimen->protocol->interval_um, sections,
                     &lattice))
        return gsn_fail(err, GSN_E_INPUT,
                        "the reference tissue does not lie in this block of %u "
                        "sections",
                        sections);
    r = gsn_region_raster(stated, &lattice, &a->tissue, err);
    return r < 0 ? r : empty_grid(&lattice, &a->tissue_grid, err);
}

/* The panel that the section with this serial number was taken from; NULL when there is none. */
static struct gsn_assembly_panel *panel_of_serial(struct gsn_assembly *a, double serial)
{
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];

        if (s->seen.serial != serial ||
            (s->state != GSN_SECTION_USED && s->state != GSN_SECTION_DOUBTFUL))
            continue;
        for (size_t p = 0; p < a->panel_count; p++)
            if (a->panel[p].opened && a->panel[p].stain.panel == s->panel)
                return &a->panel[p];
    }
    return NULL;
}

static double serial_of_plane(const struct gsn_lattice *at, size_t z, double interval_um)
{
    return round((at->origin_um.z + (double)z * at->step_um.z) / interval_um - 0.5);
}

/* The reference tissue in the plane z of its grid. scratch: as many values as a plane has. */
static struct gsn_reference_section reference_in(const struct gsn_assembly *a, size_t z,
                                                 double *scratch)
{
    const struct gsn_lattice *at = &a->tissue_grid->at;
    const size_t first = gsn_lattice_index(at, 0, 0, z), plane = at->nx * at->ny;
    size_t n = 0;

    for (size_t i = first; i < first + plane; i++)
        if (a->tissue->inside[i] && !isnan(a->tissue_grid->value[i]))
            scratch[n++] = a->tissue_grid->value[i];
    return (struct gsn_reference_section){ .red = gsn_reference_red(scratch, n), .pixels = n };
}

static int measure_panel_gain(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                              struct gsn_assembly_panel *panel, struct gsn_error *why,
                              struct gsn_error *err)
{
    const struct gsn_lattice *at = &a->tissue_grid->at;
    gsn_auto_mem(struct gsn_reference_section) sections = gsn_alloc_array(at->nz, sizeof *sections);
    gsn_auto_mem(double) scratch = gsn_alloc_array(at->nx * at->ny, sizeof *scratch);
    size_t count = 0;

    if (!sections || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t z = 0; z < at->nz; z++)
        if (panel_of_serial(a, serial_of_plane(at, z, specimen->protocol->interval_um)) == panel)
            sections[count++] = reference_in(a, z, scratch);
    panel->gain = (struct gsn_stain_gain){ .gain = 1 };
    (void)gsn_stain_reference(sections, count, specimen->protocol->reference_density, &panel->gain,
                              why);
    return GSN_OK;
}

/* A panel without enough of the reference takes what the others say. */
static int fill_gains(struct gsn_assembly *a, const struct gsn_error *why, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_stain_gain) gains = gsn_alloc_array(a->panel_count + 1, sizeof *gains);
    struct gsn_stain_gain others;
    struct gsn_error none = { 0 };
    int told;

    if (!gains)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t p = 0; p < a->panel_count; p++)
        gains[p] = a->panel[p].gain;
    told = gsn_stain_gain_of_others(gains, a->panel_count, &others, &none) >= 0;
    for (size_t p = 0; p < a->panel_count; p++) {
        if (!a->panel[p].opened || a->panel[p].gain.sections > 0)
            continue;
        if (told)
            a->panel[p].gain = others;
        else if (!a->not_comparable[0])
            (void)snprintf(a->not_comparable, sizeof a->not_comparable,
                           "batches not comparable: panel %u: %s", a->panel[p].stain.panel,
                           why[p].text);
    }
    return GSN_OK;
}

/* Divides each plane by the gain of its panel. */
static void divide(struct gsn_assembly *a, double interval_um)
{
    const struct gsn_lattice *at = &a->grid->at;
    const size_t plane = at->nx * at->ny;

    for (size_t z = 0; z < at->nz; z++) {
        const struct gsn_assembly_panel *panel =
            panel_of_serial(a, serial_of_plane(at, z, interval_um));

        for (size_t i = z * plane; panel && i < (z + 1) * plane; i++)
            a->grid->value[i] = (float)(a->grid->value[i] / panel->gain.gain);
    }
}

static int normalise(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                     struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_error) why = NULL;
    int r = GSN_OK;

    if (!a->tissue_grid)
        return GSN_OK;
    why = gsn_alloc_array(a->panel_count + 1, sizeof *why);
    if (!why)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the reference tissue");
    for (size_t p = 0; p < a->panel_count && r >= 0; p++)
        if (a->panel[p].opened)
            r = measure_panel_gain(specimen, a, &a->panel[p], &why[p], err);
    if (r >= 0)
        r = fill_gains(a, why, err);
    if (r >= 0 && !a->not_comparable[0])
        divide(a, specimen->protocol->interval_um);
    return r;
}

/* ---- a band, which is found in the stack itself --------------------------------------------- */

/* The boxes of all posed sections, laid into the block. */
static struct box box_of_sections(const struct gsn_assembly *a, double interval_um)
{
    struct box box = { { INFINITY, INFINITY, INFINITY }, { -INFINITY, -INFINITY, -INFINITY } };

    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_assembly_section *s = &a->section[i];

        for (int corner = 0; s->posed && corner < 4; corner++) {
            const struct gsn_point px = { s->seen.x + (corner & 1 ? s->seen.width : 0),
                                          s->seen.y + (corner & 2 ? s->seen.height : 0) };
            const struct gsn_point um = gsn_affine_apply(&s->pose.panel_to_block_um, px);

            box.low = gsn_vec3_make(fmin(box.low.x, um.x), fmin(box.low.y, um.y),
                                    fmin(box.low.z, interval_um * s->seen.serial));
            box.high = gsn_vec3_make(fmax(box.high.x, um.x), fmax(box.high.y, um.y),
                                     fmax(box.high.z, interval_um * (s->seen.serial + 1)));
        }
    }
    return box;
}

static int place_block(const struct gsn_specimen *specimen, double px_um, unsigned sections,
                       const struct gsn_assembly *a, struct gsn_lattice *lattice,
                       struct gsn_error *err)
{
    const double interval_um = specimen->protocol->interval_um;

    if (lattice_for(box_of_sections(a, interval_um), NULL, px_um, interval_um, sections, lattice))
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "the sections span more than a block can: look at the marks and \"px_um\"");
}

/* Finds the band. Not finding it is a state, with a sentence. */
static int find_band(const struct gsn_specimen *specimen,
                     const struct gsn_specimen_options *options, struct gsn_assembly *a,
                     struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    int r = gsn_band_region(&specimen->protocol->region, specimen->region, a->grid,
                            options->threads, &a->region, &why);

    if (r == GSN_E_STAIN || r == GSN_E_INPUT) {
        memcpy(a->no_region, why.text, sizeof a->no_region);
        gsn_grid_free(a->grid);
        a->grid = NULL;
        return GSN_OK;
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    r = gsn_band_crop(&a->grid, &a->region, MARGIN_VOXELS, err);
    if (r >= 0)
        gsn_masking_gaps(specimen->protocol->interval_um, a);
    return r;
}

int gsn_assembly_make(const struct gsn_specimen *specimen,
                      const struct gsn_specimen_options *options,
                      struct gsn_assembly **ret_assembly, struct gsn_error *err)
{
    gsn_auto(gsn_assembly) a = gsn_alloc_array(1, sizeof *a);
    const double px_um = finest_pixel(specimen);
    const int band = specimen->protocol->region.kind == GSN_REGION_BAND;
    struct gsn_lattice lattice = { 0 };
    unsigned sections;
    int r;

    if (!a)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the assembly of a specimen");
    r = list_slots(specimen, a, err);
    sections = a->section_count ? a->section[a->section_count - 1].seen.serial + 1 : 0;
    if (r >= 0 && px_um > 0 && !band &&
        (specimen->region || specimen->protocol->region.kind > GSN_REGION_MASK))
        r = place_region(specimen, px_um, sections, a, &lattice, err);
    if (r >= 0)
        r = solve_poses(specimen, a, err);
    if (r >= 0 && a->solved && band)
        r = place_block(specimen, px_um, sections, a, &lattice, err);
    if (r >= 0 && a->solved && (a->region || band))
        r = empty_grid(&lattice, &a->grid, err);
    if (r >= 0)
        r = place_reference(specimen, px_um, sections, a, err);
    if (r >= 0)
        r = work_panels(specimen, options, a, err);
    if (r >= 0)
        r = normalise(specimen, a, err);
    if (r >= 0 && band && a->grid)
        r = find_band(specimen, options, a, err);
    if (r < 0)
        return r;
    sum_errors(specimen, a);
    *ret_assembly = gsn_steal(&a);
    return GSN_OK;
}

void gsn_assembly_free(struct gsn_assembly *a)
{
    if (!a)
        return;
    for (size_t i = 0; i < a->section_count; i++)
        gsn_free(a->section[i].thumbnail.png);
    gsn_free(a->section);
    gsn_free(a->panel);
    gsn_mask_free(a->region);
    gsn_grid_free(a->grid);
    gsn_mask_free(a->tissue);
    gsn_grid_free(a->tissue_grid);
    gsn_free(a);
}
