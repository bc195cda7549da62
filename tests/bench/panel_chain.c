/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From a panel's file to its sections in the block frame, by the product's own stages, against
 * OpenCV's. */
#include "tests/bench/panel_theme.h"

#include "pipeline/core/file.h"
#include "pipeline/core/process.h"
#include "pipeline/decode/apart.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/register/panel/reduce.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/stack/resample_colour.h"
#include "pipeline/stain/artefact/detection.h"
#include "pipeline/stain/collagen_density.h"
#include "pipeline/register/fiducial/detect.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/correspondence.h"

#include "tests/bench/bench.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>

static const struct gsn_layout LAYOUT = { BENCH_ROWS, BENCH_COLUMNS, GSN_ORDER_ROW };

/* What is known of a panel after its sections were found. */
struct found {
    struct gsn_flat_field glass;
    struct gsn_slot slot[BENCH_SECTIONS];
};

/* Glass on cells of half a millimetre, sections on cells of 50 um: pipeline/specimen/scan.c. */
static void split(const struct gsn_image *image, double px_um, struct found *found)
{
    const unsigned step = gsn_panel_step(px_um);
    gsn_auto(gsn_image) small = NULL;
    gsn_auto(gsn_image) coarse = NULL;
    gsn_auto(gsn_plane) total = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_panel_reduce(image, step, &small, &err), &err, "split");
    bench_need(gsn_panel_reduce(small, (small->width + 127) / 128, &coarse, &err), &err, "split");
    bench_need(gsn_flat_field_estimate(coarse, GSN_LIGHT_CODES_LINEAR, &found->glass, &err), &err,
               "split");
    found->glass.width = small->width;
    found->glass.height = small->height;
    bench_need(gsn_od_total(small, &found->glass, &total, &err), &err, "split");
    bench_need(gsn_panel_split(total, step, &LAYOUT, px_um, GSN_SLOT_UNSAID, found->slot, NULL,
                               NULL, &err),
               &err, "split");
    found->glass.width = image->width;
    found->glass.height = image->height;
}

enum { DECODE, SPLIT, POSES, COLOUR, STAGES };

struct chain {
    const struct bench_panel *panel;
    const char *path;
    int sections;                    /* found */
    double worst_px;                 /* distance of a mark from its place */
    double total_s, stage_s[STAGES]; /* of the quickest turn */
};

static void run_split(void *context)
{
    struct chain *job = context;
    struct found found;

    split(job->panel->image, job->panel->px_um, &found);
    job->sections = 0;
    for (size_t i = 0; i < BENCH_SECTIONS; i++)
        job->sections += found.slot[i].found && !found.slot[i].touching;
}

void bench_split(void)
{
    struct bench_theme theme;
    struct chain work;
    struct bench_job job = { .run = run_split, .context = &work };
    double ours = INFINITY, theirs = INFINITY, sections = 0;

    if (!bench_theme_begin(&theme, "panel_split", "ms"))
        return;
    bench_theme_write(&theme, BENCH_TIFF_STRIPS);
    (void)bench_theme_ask(&theme, "read", NULL);
    work = (struct chain){ .panel = &theme.panel };
    for (unsigned turn = 0; turn < (bench_quick ? 1 : 9); turn++) {
        bench_race(&job, 1, 1);
        ours = fmin(ours, job.cpu_s);
        theirs = fmin(theirs, bench_theme_ask(&theme, "split", &sections));
    }
    bench_theme_say(&theme, "panel_split", 1e3 * ours, "ms", "OpenCV at 1/16", theirs / ours,
                    json_pack("{s:i, s:f, s:f, s:s}", "sections", work.sections, "their_sections",
                              sections, "their_ms", 1e3 * theirs, "of", "least of 9 turns"));
    bench_theme_end(&theme);
}

static double cpu_now(void)
{
    struct timespec now;

    if (clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now) < 0)
        abort();
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

/* Of children that have ended: the sandboxed decoder's share. */
static double children_cpu(void)
{
    struct rusage used;

    if (getrusage(RUSAGE_CHILDREN, &used) < 0)
        abort();
    return (double)(used.ru_utime.tv_sec + used.ru_stime.tv_sec) +
           1e-6 * (double)(used.ru_utime.tv_usec + used.ru_stime.tv_usec);
}

static void red_row(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                    float *to)
{
    gsn_od_reader_red(context, x, y, apart, count, to);
}

/* Marks and pose of every section, in pixels of the panel. */
static void find_poses(const struct bench_panel *panel, const struct gsn_image *image,
                       const struct found *found, struct gsn_pose *pose, double *ret_worst)
{
    gsn_auto_mem(struct gsn_fiducial_candidates) candidates =
        bench_alloc(BENCH_SECTIONS, sizeof *candidates);
    struct gsn_pose_input input[BENCH_SECTIONS] = { { 0 } };
    const struct gsn_pose_options options = { .markers_um = panel->triangle_um };
    struct gsn_triangle_prior prior = { 0 };
    gsn_auto(gsn_od_reader) absorber = NULL;
    struct gsn_density_source red;
    struct gsn_pose_summary summary;
    struct gsn_error err = { 0 };

    memcpy(prior.mark_um, panel->triangle_um, sizeof prior.mark_um);
    bench_need(gsn_od_reader_new(image, &found->glass, &absorber, &err), &err, "chain");
    red = (struct gsn_density_source){ image->width, image->height, absorber, red_row };
    for (unsigned i = 0; i < BENCH_SECTIONS; i++)
        bench_need(gsn_fiducials_detect(&red, &found->slot[i], panel->px_um, &candidates[i], &err),
                   &err, "chain");
    bench_need(gsn_fiducials_learn(candidates, BENCH_SECTIONS, &prior, &err), &err, "chain");
    for (unsigned i = 0; i < BENCH_SECTIONS; i++) {
        input[i].serial = i;
        input[i].px_um = panel->px_um;
        gsn_fiducials_match(&candidates[i], &prior, input[i].marks, &input[i].mirrored, NULL, NULL);
        for (unsigned m = 0; m < GSN_FIDUCIALS && input[i].marks[m].found; m++)
            *ret_worst = fmax(*ret_worst, hypot(input[i].marks[m].px.x - panel->mark[i][m].x,
                                                input[i].marks[m].px.y - panel->mark[i][m].y));
    }
    bench_need(gsn_pose_solve(input, BENCH_SECTIONS, &options, pose, &summary, &err), &err,
               "chain");
}

static struct gsn_stack_section section_of(const struct gsn_slot *slot, const struct gsn_pose *pose,
                                           unsigned serial)
{
    return (struct gsn_stack_section){ .serial = serial,
                                       .panel_to_block_um = pose->panel_to_block_um,
                                       .x = slot->x,
                                       .y = slot->y,
                                       .width = slot->width,
                                       .height = slot->height };
}

/* The block frame at the panel's own pixel size, a plane a section. */
static struct gsn_lattice block_of(const struct bench_panel *panel)
{
    const double half_um = 0.5 * panel->side * panel->px_um;

    return (struct gsn_lattice){ .nx = panel->side,
                                 .ny = panel->side,
                                 .nz = BENCH_SECTIONS,
                                 .origin_um = { -half_um, -half_um, 12 },
                                 .step_um = { panel->px_um, panel->px_um, 24 } };
}

/* Collagen density of every section in the block frame, as pipeline/specimen/density_stack.c has
 * it. */
static int lay_density(const struct bench_panel *panel, const struct gsn_image *image,
                       const struct found *found, const struct gsn_pose *pose)
{
    const struct gsn_lattice at = block_of(panel);
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(gsn_od_reader) absorber = NULL;
    gsn_auto(gsn_collagen_reader) reader = NULL;
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };
    int count = 0;

    bench_need(gsn_od_reader_new(image, &found->glass, &absorber, &err), &err, "chain");
    bench_need(gsn_collagen_reader_new(absorber, &dyes, &reader, &err), &err, "chain");
    bench_need(gsn_grid_new(&at, &grid, &err), &err, "chain");
    for (unsigned i = 0; i < BENCH_SECTIONS; i++) {
        const struct gsn_slot *slot = &found->slot[i];
        struct gsn_stack_section section = section_of(slot, &pose[i], i);
        gsn_auto(gsn_plane) density = NULL;

        if (pose[i].state != GSN_POSE_OK || !gsn_stack_footprint(&at, 24, &section))
            continue;
        bench_need(gsn_collagen_box(reader,
                                    &(struct gsn_pixel_box){ section.x, section.y, section.width,
                                                             section.height },
                                    1, &density, &err),
                   &err, "chain");
        section.density = density;
        section.plane_x = section.x;
        section.plane_y = section.y;
        bench_need(gsn_stack_resample(&section, 1, 24, 1, grid, &err), &err, "chain");
        count++;
    }
    return count;
}

/* True colours of every section in the block frame, as pipeline/specimen/density_stack.c has them.
 */
static int lay_colour(const struct bench_panel *panel, const struct gsn_image *image,
                      const struct found *found, const struct gsn_pose *pose)
{
    const struct gsn_lattice at = block_of(panel);
    uint16_t of_sample[256];
    gsn_auto_mem(uint8_t) code = bench_alloc(GSN_STACK_FULL_LIGHT / 4 + 1, 1);
    const struct gsn_stack_light light = { of_sample, code };
    gsn_auto(gsn_colour_grid) grid = NULL;
    struct gsn_error err = { 0 };
    int count = 0;

    for (unsigned i = 0; i < 256; i++)
        of_sample[i] = (uint16_t)(128 * i);
    for (size_t i = 0; i <= GSN_STACK_FULL_LIGHT / 4; i++)
        code[i] = (uint8_t)fmax(
            1,
            round(255 * gsn_light_encode(GSN_LIGHT_SRGB, 4.0 * (double)i / GSN_STACK_FULL_LIGHT)));
    bench_need(gsn_colour_grid_new(&at, &grid, &err), &err, "chain");
    for (unsigned i = 0; i < BENCH_SECTIONS; i++) {
        const struct gsn_stack_section section = section_of(&found->slot[i], &pose[i], i);

        if (pose[i].state != GSN_POSE_OK)
            continue;
        bench_need(gsn_stack_resample_colour(&section, image, &light, 24, 1, grid, &err), &err,
                   "chain");
        count++;
    }
    return count;
}

/* Defects of every section. */
static void find_masks(const struct bench_panel *panel, const struct gsn_image *image,
                       const struct found *found)
{
    struct gsn_artefact_section place[BENCH_SECTIONS] = { { 0 } };
    struct gsn_artefact_figures figures[BENCH_SECTIONS];
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_plane *od[3];
    struct gsn_artefact_panel look = {
        image, od, &found->glass, &dyes, panel->px_um, 0, place, NULL
    };
    gsn_auto(gsn_artefact_labels) labels = NULL;
    struct gsn_error err = { 0 };

    for (unsigned i = 0; i < BENCH_SECTIONS; i++)
        place[look.section_count++] =
            (struct gsn_artefact_section){ .x = found->slot[i].x,
                                           .y = found->slot[i].y,
                                           .width = found->slot[i].width,
                                           .height = found->slot[i].height };
    bench_need(gsn_od_thin(image, &found->glass, 5, od, &err), &err, "chain");
    bench_need(gsn_artefact_find(&look, 1, &labels, figures, &err), &err, "chain");
    for (int c = 0; c < 3; c++)
        gsn_plane_free(od[c]);
}

/* A panel whose sections have their poses. */
struct registered {
    const struct bench_panel *panel;
    struct gsn_decoder *decoder; /* owned */
    struct gsn_picture *picture; /* owned */
    struct found found;
    struct gsn_pose pose[BENCH_SECTIONS];
};

/* at: the clock before each stage. */
static void register_panel(struct chain *job, struct registered *ret_panel, double at[STAGES])
{
    gsn_auto_mem(char) program = NULL;
    gsn_auto_fd fd = -1;
    struct gsn_error err = { 0 };

    bench_need(gsn_process_sibling("gieson-decode", &program, &err), &err, "chain");
    ret_panel->panel = job->panel;
    at[DECODE] = cpu_now();
    bench_need(gsn_file_open(job->path, &fd, &err), &err, "chain");
    bench_need(gsn_decoder_new(program, &ret_panel->decoder, &err), &err, "chain");
    bench_need(gsn_decode_apart(ret_panel->decoder, fd, NULL, &ret_panel->picture, &err), &err,
               "chain");
    at[SPLIT] = cpu_now();
    split(ret_panel->picture->image, job->panel->px_um, &ret_panel->found);
    at[POSES] = cpu_now();
    find_poses(job->panel, ret_panel->picture->image, &ret_panel->found, ret_panel->pose,
               &job->worst_px);
}

static void registered_done(struct registered *panel)
{
    gsn_picture_free(panel->picture);
    gsn_decoder_free(panel->decoder);
}

/* As far as the peer goes, and nothing else: a panel as a job has it, its decoder started for it.
 */
static void run_chain(void *context)
{
    struct chain *job = context;
    struct registered panel;
    double at[STAGES + 1], apart = -children_cpu();

    register_panel(job, &panel, at);
    at[COLOUR] = cpu_now();
    job->sections = lay_colour(panel.panel, panel.picture->image, &panel.found, panel.pose);
    registered_done(&panel);
    at[STAGES] = cpu_now();
    apart += children_cpu();
    if (at[STAGES] - at[0] + apart >= job->total_s)
        return;
    job->total_s = at[STAGES] - at[0] + apart;
    for (int i = 0; i < STAGES; i++)
        job->stage_s[i] = at[i + 1] - at[i];
    job->stage_s[DECODE] += apart;
}

static void run_density(void *context)
{
    const struct registered *panel = context;

    (void)lay_density(panel->panel, panel->picture->image, &panel->found, panel->pose);
}

static void run_masks(void *context)
{
    const struct registered *panel = context;

    find_masks(panel->panel, panel->picture->image, &panel->found);
}

/* What is measured on registered sections; the peer has nothing like it. */
static void measure(struct chain *chain)
{
    struct registered panel;
    double at[STAGES];
    struct bench_job job[2] = { { .run = run_density, .context = &panel },
                                { .run = run_masks, .context = &panel } };

    register_panel(chain, &panel, at);
    bench_race(job, 2, bench_quick ? 1 : 3);
    registered_done(&panel);
    bench_say("panel_density", 1e3 * job[0].cpu_s, "ms", NULL, NAN,
              json_pack("{s:s}", "what", "collagen density of the same sections"));
    bench_say("panel_masks", 1e3 * job[1].cpu_s, "ms", NULL, NAN,
              json_pack("{s:s}", "what", "defects of the same sections"));
}

void bench_chain(void)
{
    struct bench_theme theme;
    struct chain work;
    struct bench_job job = { .run = run_chain, .context = &work };
    double theirs = INFINITY, sections = 0;

    if (!bench_theme_begin(&theme, "panel_chain", "ms"))
        return;
    bench_theme_write(&theme, BENCH_TIFF_STRIPS);
    work = (struct chain){ .panel = &theme.panel, .path = theme.path, .total_s = INFINITY };
    for (unsigned turn = 0; turn < (bench_quick ? 1 : 9); turn++) {
        bench_race(&job, 1, 1);
        theirs = fmin(theirs, bench_theme_ask(&theme, "chain", &sections));
    }
    bench_theme_say(&theme, "panel_chain", 1e3 * work.total_s, "ms",
                    "OpenCV, file to registered sections", theirs / work.total_s,
                    json_pack("{s:i, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:s}", "sections",
                              work.sections, "their_sections", sections, "their_ms", 1e3 * theirs,
                              "worst_mark_px", work.worst_px, "decode_ms",
                              1e3 * work.stage_s[DECODE], "split_ms", 1e3 * work.stage_s[SPLIT],
                              "poses_ms", 1e3 * work.stage_s[POSES], "colour_ms",
                              1e3 * work.stage_s[COLOUR], "of", "least of 9 turns"));
    measure(&work);
    bench_theme_end(&theme);
}
