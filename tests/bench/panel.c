/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* From the bytes of a panel to its sections: decoding against the bare libraries and OpenCV's
 * imread, splitting and the whole chain against OpenCV, which opencv_probe.py asks. Everything is
 * one thread's CPU time. */
#include "tests/bench/panel.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/raster.h"
#include "pipeline/register/panel.h"
#include "pipeline/register/panel_reduce.h"
#include "pipeline/register/pose.h"
#include "pipeline/register/stack_colour.h"
#include "pipeline/stain/absorb.h"
#include "pipeline/stain/mask.h"

#include "tests/bench/bench.h"
#include "tests/bench/peer.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

static const struct gsn_layout LAYOUT = { BENCH_ROWS, BENCH_COLUMNS, GSN_ORDER_ROW };

struct theme {
    struct bench_panel panel;
    struct bench_peer peer;
    int has_peer;
    char folder[64], path[96];
};

static int begin(struct theme *theme, const char *measure, const char *unit)
{
    char side[16];
    char *argv[] = { (char[]){ GSN_DEBIAN_PYTHON }, (char[]){ GSN_BENCH_OPENCV }, side, NULL };

    *theme = (struct theme){ .folder = "/tmp/gieson-bench.XXXXXX" };
    if (!mkdtemp(theme->folder)) {
        bench_skip(measure, unit, NULL, "no folder could be made in /tmp");
        return 0;
    }
    theme->panel = bench_panel_draw();
    (void)snprintf(side, sizeof side, "%u", theme->panel.side);
    theme->has_peer = bench_peer_start(&theme->peer, argv);
    return 1;
}

static void end(struct theme *theme)
{
    bench_peer_end(&theme->peer);
    bench_panel_done(&theme->panel);
    (void)unlink(theme->path);
    (void)rmdir(theme->folder);
}

static void write_file(struct theme *theme, enum bench_format format)
{
    const char *suffix = format == BENCH_JPEG ? "jpg" : format == BENCH_PNG ? "png" : "tif";

    (void)snprintf(theme->path, sizeof theme->path, "%s/panel.%s", theme->folder, suffix);
    if (!bench_format_write(format, theme->panel.image, theme->path)) {
        fprintf(stderr, "gieson-bench: %s cannot be written\n", theme->path);
        exit(gsn_code_exit(GSN_E_IO));
    }
}

/* The peer's seconds for an order, or NAN where it is not there; number as in peer.h. */
static double ask(struct theme *theme, const char *verb, double *ret_number)
{
    char order[128];
    double seconds;

    (void)snprintf(order, sizeof order, "%s %s", verb, theme->path);
    seconds = theme->has_peer ? bench_peer_ask(&theme->peer, order, ret_number) : -1;
    theme->has_peer = seconds >= 0;
    return seconds >= 0 ? seconds : NAN;
}

static void say_against(struct theme *theme, const char *measure, double value, const char *unit,
                        const char *against, double ratio, json_t *details)
{
    if (theme->has_peer) {
        bench_say(measure, value, unit, against, ratio, details);
        return;
    }
    (void)json_object_set_new(
        details, "skipped", json_string("python3-opencv is not installed for " GSN_DEBIAN_PYTHON));
    bench_say(measure, value, unit, against, NAN, details);
}

/* ---- decoding ---------------------------------------------------------------------------- */

/* The bytes of a file, as they lie in the page cache. */
struct mapped {
    void *at;
    size_t size;
};

static struct mapped map_file(const char *path)
{
    struct mapped file = { .at = MAP_FAILED };
    struct gsn_error err = { 0 };
    struct stat status = { .st_size = 0 };
    int fd;

    bench_need(gsn_file_open(path, &fd, &err), &err, "panel");
    if (fstat(fd, &status) == 0) {
        file.size = (size_t)status.st_size;
        file.at = mmap(NULL, file.size, PROT_READ, MAP_PRIVATE, fd, 0);
    }
    (void)close(fd);
    if (file.at == MAP_FAILED) {
        fprintf(stderr, "gieson-bench: %s cannot be mapped\n", path);
        exit(gsn_code_exit(GSN_E_IO));
    }
    return file;
}

struct decoding {
    enum bench_format format;
    const char *path;
    uint8_t *bytes; /* room for the samples */
    size_t count;   /* of them */
};

static void decode_bare(void *context)
{
    const struct decoding *job = context;

    if (!bench_format_read(job->format, job->path, job->bytes))
        abort();
}

/* To where the samples shall be, as the bare library does. */
static void decode_ours(void *context)
{
    const struct decoding *job = context;
    const struct mapped file = map_file(job->path);
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_decode_into(file.at, file.size, NULL, job->bytes, &picture, &err), &err,
               "decode");
    (void)munmap(file.at, file.size);
}

/* To memory of its own, as imread does. */
static void decode_fresh(void *context)
{
    const struct decoding *job = context;
    const struct mapped file = map_file(job->path);
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_decode(file.at, file.size, NULL, &picture, &err), &err, "decode");
    (void)munmap(file.at, file.size);
}

/* Both ways have to give the same samples, but for JPEG, where the least digit is the library's.
 */
static void compare(struct decoding *work)
{
    const int lossy = work->format == BENCH_JPEG || work->format == BENCH_TIFF_JPEG;
    uint8_t *const theirs = bench_alloc(work->count, 1);

    decode_bare(work);
    memcpy(theirs, work->bytes, work->count);
    memset(work->bytes, 0, work->count);
    decode_ours(work);
    for (size_t i = 0; i < work->count; i++)
        if (abs(theirs[i] - work->bytes[i]) > lossy) {
            fprintf(stderr, "gieson-bench: %s is not decoded as by the bare library\n",
                    bench_format_name(work->format));
            exit(gsn_code_exit(GSN_E_INPUT));
        }
    gsn_free(theirs);
}

static void decode_format(struct theme *theme, enum bench_format format, uint8_t *bytes)
{
    struct decoding work = { .format = format,
                             .path = theme->path,
                             .bytes = bytes,
                             .count = gsn_image_bytes(theme->panel.image) *
                                      bench_format_bits(format) / 8 };
    struct bench_job job[3] = { { .run = decode_ours, .context = &work },
                                { .run = decode_bare, .context = &work },
                                { .run = decode_fresh, .context = &work } };
    const struct gsn_image *image = theme->panel.image;
    const double mpx = 1e-6 * image->width * image->height;
    const unsigned turns = bench_quick ? 1 : 5;
    double least[3] = { INFINITY, INFINITY, INFINITY }, theirs = INFINITY;

    write_file(theme, format);
    compare(&work);
    for (unsigned turn = 0; turn < turns; turn++) {
        bench_race(job, 3, 1);
        for (int j = 0; j < 3; j++)
            least[j] = fmin(least[j], job[j].cpu_s);
        theirs = fmin(theirs, ask(theme, "read", NULL));
    }
    bench_say("decode", mpx / least[0], "Mpx/s", "the bare library", least[1] / least[0],
              json_pack("{s:s, s:f}", "format", bench_format_name(format), "megapixel", mpx));
    /* The library's own figure against imread was taken with its memory given; both are said. */
    say_against(theme, "decode_imread", mpx / least[0], "Mpx/s", "cv2.imread", theirs / least[0],
                json_pack("{s:s, s:f, s:o}", "format", bench_format_name(format), "megapixel", mpx,
                          "ratio_in_fresh_memory",
                          theme->has_peer ? json_real(theirs / least[2]) : json_null()));
    (void)unlink(theme->path);
}

void bench_decode(void)
{
    enum { PAGE = 4096 };
    struct theme theme;
    uint8_t *bytes;

    if (!begin(&theme, "decode", "Mpx/s"))
        return;
    /* Whole strips are copied at half the speed to an uneven place: of the library's making, not
     * of ours. Samples of 16 bits have room too. */
    bytes = bench_alloc(2 * gsn_image_bytes(theme.panel.image) + PAGE, 1);
    for (int format = 0; format < BENCH_FORMATS; format++)
        decode_format(&theme, (enum bench_format)format, bytes + (PAGE - (uintptr_t)bytes % PAGE));
    gsn_free(bytes);
    end(&theme);
}

/* ---- splitting and the chain ------------------------------------------------------------- */

/* What is known of a panel after its sections were found. */
struct found {
    struct gsn_glass glass;
    struct gsn_slot slot[BENCH_SECTIONS];
};

/* Glass on cells of half a millimetre, sections on cells of 50 um: pipeline/scan.c. */
static void split(const struct gsn_image *image, double px_um, struct found *found)
{
    const unsigned step = gsn_panel_step(px_um);
    gsn_auto(gsn_image) small = NULL;
    gsn_auto(gsn_image) coarse = NULL;
    gsn_auto(gsn_plane) total = NULL;
    struct gsn_error err = { 0 };

    bench_need(gsn_panel_reduce(image, step, &small, &err), &err, "split");
    bench_need(gsn_panel_reduce(small, (small->width + 127) / 128, &coarse, &err), &err, "split");
    bench_need(gsn_glass_estimate(coarse, GSN_LIGHT_CODES_LINEAR, &found->glass, &err), &err,
               "split");
    found->glass.width = small->width;
    found->glass.height = small->height;
    bench_need(gsn_absorb_total(small, &found->glass, &total, &err), &err, "split");
    bench_need(gsn_panel_split(total, step, &LAYOUT, px_um, GSN_SLOT_UNSAID, found->slot, NULL,
                               NULL, &err),
               &err, "split");
    found->glass.width = image->width;
    found->glass.height = image->height;
}

/* To registered sections, which is as far as the peer goes; and what is measured on them. */
enum { DECODE, SPLIT, POSES, COLOUR, REGISTERED, DENSITY = REGISTERED, MASKS, STAGES };

struct chain {
    const struct bench_panel *panel;
    const char *path;
    int sections;           /* found */
    double worst_px;        /* distance of a mark from its place */
    double stage_s[STAGES]; /* the least of all turns */
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
    struct theme theme;
    struct chain work;
    struct bench_job job = { .run = run_split, .context = &work };
    double ours = INFINITY, theirs = INFINITY, sections = 0;

    if (!begin(&theme, "panel_split", "ms"))
        return;
    write_file(&theme, BENCH_TIFF_STRIPS);
    (void)ask(&theme, "read", NULL);
    work = (struct chain){ .panel = &theme.panel };
    for (unsigned turn = 0; turn < (bench_quick ? 1 : 9); turn++) {
        bench_race(&job, 1, 1);
        ours = fmin(ours, job.cpu_s);
        theirs = fmin(theirs, ask(&theme, "split", &sections));
    }
    say_against(&theme, "panel_split", 1e3 * ours, "ms", "OpenCV at 1/16", theirs / ours,
                json_pack("{s:i, s:f, s:f, s:s}", "sections", work.sections, "their_sections",
                          sections, "their_ms", 1e3 * theirs, "of", "least of 9 turns"));
    end(&theme);
}

static double cpu_now(void)
{
    struct timespec now;

    if (clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now) < 0)
        abort();
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

static void red_row(const void *context, uint32_t x, uint32_t y, uint32_t apart, size_t count,
                    float *to)
{
    gsn_absorber_red(context, x, y, apart, count, to);
}

/* Marks and pose of every section, in pixels of the panel. */
static void find_poses(const struct bench_panel *panel, const struct gsn_image *image,
                       const struct found *found, struct gsn_pose *pose, double *ret_worst)
{
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
        bench_alloc(BENCH_SECTIONS, sizeof *candidates);
    struct gsn_pose_input input[BENCH_SECTIONS] = { { 0 } };
    const struct gsn_pose_options options = { .markers_um = panel->triangle_um };
    struct gsn_triangle_prior prior = { 0 };
    gsn_auto(gsn_absorber) absorber = NULL;
    struct gsn_mark_density red;
    struct gsn_pose_summary summary;
    struct gsn_error err = { 0 };

    memcpy(prior.mark_um, panel->triangle_um, sizeof prior.mark_um);
    bench_need(gsn_absorber_new(image, &found->glass, &absorber, &err), &err, "chain");
    red = (struct gsn_mark_density){ image->width, image->height, absorber, red_row };
    for (unsigned i = 0; i < BENCH_SECTIONS; i++)
        bench_need(
            gsn_markers_candidates(&red, &found->slot[i], panel->px_um, &candidates[i], &err), &err,
            "chain");
    bench_need(gsn_markers_learn(candidates, BENCH_SECTIONS, &prior, &err), &err, "chain");
    for (unsigned i = 0; i < BENCH_SECTIONS; i++) {
        input[i].serial = i;
        input[i].px_um = panel->px_um;
        gsn_markers_choose(&candidates[i], &prior, input[i].marks, &input[i].mirrored, NULL, NULL);
        for (unsigned m = 0; m < GSN_MARKS && input[i].marks[m].found; m++)
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

/* Collagen density of every section in the block frame, as pipeline/assembly_density.c lays it. */
static int lay_density(const struct bench_panel *panel, const struct gsn_image *image,
                       const struct found *found, const struct gsn_pose *pose)
{
    const struct gsn_lattice at = block_of(panel);
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    gsn_auto(gsn_absorber) absorber = NULL;
    gsn_auto(gsn_red_reader) reader = NULL;
    gsn_auto(gsn_grid) grid = NULL;
    struct gsn_error err = { 0 };
    int count = 0;

    bench_need(gsn_absorber_new(image, &found->glass, &absorber, &err), &err, "chain");
    bench_need(gsn_red_reader_new(absorber, &dyes, &reader, &err), &err, "chain");
    bench_need(gsn_grid_new(&at, &grid, &err), &err, "chain");
    for (unsigned i = 0; i < BENCH_SECTIONS; i++) {
        const struct gsn_slot *slot = &found->slot[i];
        struct gsn_stack_section section = section_of(slot, &pose[i], i);
        gsn_auto(gsn_plane) density = NULL;

        if (pose[i].state != GSN_POSE_OK || !gsn_stack_footprint(&at, 24, &section))
            continue;
        bench_need(gsn_red_box(reader,
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

/* True colours of every section in the block frame, as pipeline/assembly_density.c lays them. */
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
        bench_need(gsn_stack_colour(&section, image, &light, 24, 1, grid, &err), &err, "chain");
        count++;
    }
    return count;
}

/* Defects of every section. */
static void find_masks(const struct bench_panel *panel, const struct gsn_image *image,
                       const struct found *found)
{
    struct gsn_mask_section place[BENCH_SECTIONS] = { { 0 } };
    struct gsn_mask_figures figures[BENCH_SECTIONS];
    const struct gsn_dyes dyes = gsn_dyes_builtin();
    struct gsn_plane *od[3];
    struct gsn_mask_panel look = { image, od, &found->glass, &dyes, panel->px_um, 0, place, NULL };
    gsn_auto(gsn_mask_labels) labels = NULL;
    struct gsn_error err = { 0 };

    for (unsigned i = 0; i < BENCH_SECTIONS; i++)
        place[look.section_count++] = (struct gsn_mask_section){ .x = found->slot[i].x,
                                                                 .y = found->slot[i].y,
                                                                 .width = found->slot[i].width,
                                                                 .height = found->slot[i].height };
    bench_need(gsn_absorb_thin(image, &found->glass, 5, od, &err), &err, "chain");
    bench_need(gsn_mask_find(&look, 1, &labels, figures, &err), &err, "chain");
    for (int c = 0; c < 3; c++)
        gsn_plane_free(od[c]);
}

static void run_chain(void *context)
{
    struct chain *job = context;
    const struct mapped file = map_file(job->path);
    struct gsn_pose pose[BENCH_SECTIONS];
    gsn_auto(gsn_picture) picture = NULL;
    struct found found;
    struct gsn_error err = { 0 };
    double at[STAGES + 1];

    at[0] = cpu_now();
    bench_need(gsn_decode(file.at, file.size, NULL, &picture, &err), &err, "chain");
    at[1] = cpu_now();
    split(picture->image, job->panel->px_um, &found);
    at[2] = cpu_now();
    find_poses(job->panel, picture->image, &found, pose, &job->worst_px);
    at[3] = cpu_now();
    job->sections = lay_colour(job->panel, picture->image, &found, pose);
    at[4] = cpu_now();
    (void)lay_density(job->panel, picture->image, &found, pose);
    at[5] = cpu_now();
    find_masks(job->panel, picture->image, &found);
    at[6] = cpu_now();
    (void)munmap(file.at, file.size);
    for (int i = 0; i < STAGES; i++)
        job->stage_s[i] = fmin(job->stage_s[i], at[i + 1] - at[i]);
}

void bench_chain(void)
{
    struct theme theme;
    struct chain work;
    struct bench_job job = { .run = run_chain, .context = &work };
    double ours = 0, theirs = INFINITY, sections = 0;

    if (!begin(&theme, "panel_chain", "ms"))
        return;
    write_file(&theme, BENCH_TIFF_STRIPS);
    work = (struct chain){ .panel = &theme.panel, .path = theme.path };
    for (int i = 0; i < STAGES; i++)
        work.stage_s[i] = INFINITY;
    for (unsigned turn = 0; turn < (bench_quick ? 1 : 7); turn++) {
        bench_race(&job, 1, 1);
        theirs = fmin(theirs, ask(&theme, "chain", &sections));
    }
    for (int i = 0; i < REGISTERED; i++)
        ours += work.stage_s[i];
    say_against(&theme, "panel_chain", 1e3 * ours, "ms", "OpenCV, file to registered sections",
                theirs / ours,
                json_pack("{s:i, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:s}", "sections",
                          work.sections, "their_sections", sections, "their_ms", 1e3 * theirs,
                          "worst_mark_px", work.worst_px, "decode_ms", 1e3 * work.stage_s[DECODE],
                          "split_ms", 1e3 * work.stage_s[SPLIT], "poses_ms",
                          1e3 * work.stage_s[POSES], "colour_ms", 1e3 * work.stage_s[COLOUR], "of",
                          "least of 7 turns, each stage"));
    bench_say("panel_density", 1e3 * work.stage_s[DENSITY], "ms", NULL, NAN,
              json_pack("{s:s}", "what", "collagen density of the same sections"));
    bench_say("panel_masks", 1e3 * work.stage_s[MASKS], "ms", NULL, NAN,
              json_pack("{s:s}", "what", "defects of the same sections"));
    end(&theme);
}
