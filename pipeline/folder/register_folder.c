/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Registers a plain folder of pictures of sections.
 *
 * 1. Pictures are listed by name, numbers as numbers, and searched for spots; tissue is reduced to
 *    cells where the caller agrees to be placed by it.
 * 2. Three marks a section: the stated triangle or the one that the sections agree on, spots
 * measured where they were chosen, and chosen again. Where few sections show the usual burn, other
 * kinds are looked for.
 * 3. All poses together (register/pose.h), with the section's own size where sizes differ by more
 * than the marks' errors; error ellipses at five points.
 * 4. What marks leave is placed by the tissue of its neighbours (register/tissue/pose_graph.h), and
 * marks that tissue contradicts are flagged.
 *
 * Inside, lengths are um, of a pixel GSN_FOLDER_PX_UM wide where nobody states its size. A picture
 * that cannot be read costs itself alone. Fails with GSN_E_MARKERS where the sections agree on no
 * triangle and may not be placed by tissue. */
#include "pipeline/folder/register_folder.h"

#include "pipeline/core/calendar.h"
#include "pipeline/core/file.h"
#include "pipeline/core/robust.h"
#include "pipeline/decode/apart.h"
#include "pipeline/register/fiducial/colour.h"
#include "pipeline/register/fiducial/correspondence.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/triangle.h"
#include "pipeline/register/pose/pose.h"
#include "pipeline/register/pose/strain.h"
#include "pipeline/register/pose/tre.h"
#include "pipeline/register/tissue/bands.h"
#include "pipeline/register/tissue/pairwise.h"
#include "pipeline/register/tissue/pose_check.h"
#include "pipeline/register/tissue/pose_graph.h"

#include <assert.h>
#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

/* One section while the stack is worked. */
struct section_work {
    struct gsn_colour_candidates *spots; /* NULL when the picture could not be read */
    struct gsn_fiducial marks[GSN_FIDUCIALS];
    int mirrored;
    struct gsn_pose pose;
    struct gsn_tissue *tissue; /* NULL when it is not asked for or shows nothing */
    double search_ms;
};

struct folder_job {
    const struct gsn_folder_options *options;
    struct gsn_folder_stack *stack;
    struct section_work *work;
    double px_um; /* stated, or made up */
    double unit;  /* um per unit of the caller's lengths */
    double cell;  /* of the tissue's bands, pixels; 0 until the first picture is read */
};

/* Cells along a picture's longer side: what neighbouring sections share is larger than such a
 * cell, and finer ones laid none of the stacks we have better. */
enum { TISSUE_CELLS = 250 };

/* ---- pictures ------------------------------------------------------------------------------- */

static int is_picture(const struct dirent *entry)
{
    static const char *const ends[] = { ".png", ".tif", ".tiff", ".jpg", ".jpeg", ".pam" };
    const char *dot = strrchr(entry->d_name, '.');

    if (entry->d_name[0] == '.' || !dot)
        return 0;
    for (size_t i = 0; i < sizeof ends / sizeof *ends; i++)
        if (strcasecmp(dot, ends[i]) == 0)
            return 1;
    return 0;
}

/* The pictures of the folder dir, in the order of their names. Fails with GSN_E_NOTFOUND, GSN_E_IO,
 * GSN_E_INPUT, GSN_E_NOMEM. */
static int list_pictures(const char *dir, struct gsn_folder_stack *stack, struct gsn_error *err)
{
    struct dirent **entries = NULL;
    const int found = scandir(dir, &entries, is_picture, versionsort);
    int lost = 0;

    if (found < 0)
        return gsn_fail(err, errno == ENOENT ? GSN_E_NOTFOUND : GSN_E_IO, "%s: %s", dir,
                        strerror(errno));
    stack->section = found > 0 ? gsn_alloc_array((size_t)found, sizeof *stack->section) : NULL;
    for (int i = 0; i < found; i++) {
        if (stack->section) {
            stack->section[i].file = gsn_strdup(entries[i]->d_name);
            lost |= !stack->section[i].file;
            stack->count++;
        }
        free(entries[i]); /* door */
    }
    free(entries); /* door */
    if (found == 0)
        return gsn_fail(err, GSN_E_INPUT, "%s: no pictures (.png, .tif, .jpg) in this folder", dir);
    return stack->section && !lost ? GSN_OK
                                   : gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
}

/* What of a picture is needed to lay it by its tissue. One that shows none has no such pose. */
static int look_at_tissue(struct folder_job *folder, size_t i, const struct gsn_image *image,
                          struct gsn_error *err)
{
    gsn_auto(gsn_plane) density = NULL;
    struct gsn_error own = { 0 };
    int r;

    if (!folder->options->by_tissue)
        return GSN_OK;
    if (!(folder->cell > 0))
        folder->cell = fmax(1, fmax((double)image->width, (double)image->height) / TISSUE_CELLS);
    r = gsn_tissue_reduce(image, folder->cell, &density, &own);
    if (r >= 0)
        r = gsn_tissue_new(density, folder->cell * folder->px_um, &folder->work[i].tissue, &own);
    return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", own.text) : GSN_OK;
}

/* The picture of section i. Fails as its decoder does. */
static int open_picture(const struct folder_job *folder, const char *dir, size_t i,
                        struct gsn_picture **ret_picture, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", dir, folder->stack->section[i].file);
    gsn_auto_fd picture_fd = -1;
    int r;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a picture of %s", dir);
    r = gsn_file_open(path, &picture_fd, err);
    return r < 0 ? r
                 : gsn_decode_apart(folder->options->decoder, picture_fd, NULL, ret_picture, err);
}

/* Reads one picture and looks for its spots, and at its tissue where that is asked for; a picture
 * that cannot be read costs itself alone. Fails with GSN_E_PROCESS, GSN_E_NOMEM. */
static int search_picture(struct folder_job *folder, const char *dir, size_t i,
                          struct gsn_error *err)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error own = { 0 };
    double began;
    int r = open_picture(folder, dir, i, &picture, &own);

    began = gsn_process_cpu_ms();
    if (r >= 0)
        r = gsn_colour_candidates_find(picture->image, folder->px_um, &folder->work[i].spots, &own);
    if (r >= 0)
        r = look_at_tissue(folder, i, picture->image, &own);
    folder->work[i].search_ms = gsn_process_cpu_ms() - began;
    if (r == GSN_E_NOMEM || r == GSN_E_PROCESS)
        return gsn_fail(err, r, "%s: %s", section->file, own.text);
    if (r < 0)
        (void)snprintf(section->reason, sizeof section->reason, "%s", own.text);
    return GSN_OK;
}

/* ---- marks ---------------------------------------------------------------------------------- */

/* The caller guarantees that the marks are stated. */
static void get_stated_marks(const struct folder_job *folder,
                             struct gsn_point ret_mark_um[GSN_FIDUCIALS])
{
    for (size_t i = 0; i < GSN_FIDUCIALS; i++)
        ret_mark_um[i] = (struct gsn_point){ folder->options->mark[i].x * folder->unit,
                                             folder->options->mark[i].y * folder->unit };
}

/* The candidates of all sections that could be read, one after the other. */
static size_t collect_candidates(const struct folder_job *folder,
                                 struct gsn_fiducial_candidates *candidates)
{
    size_t n = 0;

    for (size_t i = 0; i < folder->stack->count; i++)
        if (folder->work[i].spots)
            candidates[n++] = folder->work[i].spots->candidates;
    return n;
}

static int know_triangle(const struct folder_job *folder, struct gsn_triangle_prior *ret_prior,
                         struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_fiducial_candidates) candidates =
        gsn_alloc_array(folder->stack->count, sizeof *candidates);
    struct gsn_triangle_prior prior = { 0 };
    size_t n;
    int r = GSN_OK;

    if (!candidates)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a stack");
    n = collect_candidates(folder, candidates);
    if (folder->options->mark)
        get_stated_marks(folder, prior.mark_um);
    else
        r = gsn_fiducials_vote_triangle(candidates, n, &prior, err);
    if (r >= 0)
        r = gsn_fiducials_learn(candidates, n, &prior, err);
    if (r >= 0)
        *ret_prior = prior;
    return r;
}

static size_t found_of(const struct section_work *work)
{
    size_t found = 0;

    for (size_t k = 0; k < GSN_FIDUCIALS; k++)
        found += work->marks[k].found != 0;
    return found;
}

static void choose_marks(struct folder_job *folder, size_t i,
                         const struct gsn_triangle_prior *prior)
{
    struct section_work *work = &folder->work[i];
    struct gsn_folder_section *section = &folder->stack->section[i];

    gsn_fiducials_match(&work->spots->candidates, prior, work->marks, &work->mirrored,
                        &section->score, &section->runner_up);
}

/* Measures the spots that were chosen, or all of them. */
static int measure_spots(struct section_work *work, int all, struct gsn_error *err)
{
    for (size_t i = 0; i < work->spots->candidates.count; i++) {
        const struct gsn_fiducial *spot = &work->spots->candidates.mark[i];
        int wanted = all;
        int r;

        for (size_t k = 0; k < GSN_FIDUCIALS; k++)
            wanted |= work->marks[k].found && work->marks[k].px.x == spot->px.x &&
                      work->marks[k].px.y == spot->px.y;
        r = wanted ? gsn_colour_candidates_localise(work->spots, i, err) : GSN_OK;
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

static int choose_all(struct folder_job *folder, const struct gsn_triangle_prior *prior, int last,
                      struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < folder->stack->count; i++) {
        struct section_work *work = &folder->work[i];

        if (!work->spots)
            continue;
        choose_marks(folder, i, prior);
        r = measure_spots(work, found_of(work) < GSN_FIDUCIALS, err);
        if (last)
            choose_marks(folder, i, prior);
    }
    return r;
}

/* Chooses the three marks of every section, and measures them. Fails with GSN_E_MARKERS,
 * GSN_E_NOMEM. */
/* What was chosen from afar is measured, everything where nothing could be chosen; three measured
 * marks of every clear section then tell how like the triangles are, and the choice is made again.
 */
static int choose_all_marks(struct folder_job *folder, struct gsn_error *err)
{
    struct gsn_triangle_prior prior;
    int r = know_triangle(folder, &prior, err);

    if (r >= 0)
        r = choose_all(folder, &prior, 0, err);
    if (r >= 0)
        r = know_triangle(folder, &prior, err);
    return r < 0 ? r : choose_all(folder, &prior, 1, err);
}

/* ---- other burns than the ordinary ------------------------------------------------------- */

static int look_for_burns(const struct folder_job *folder, const char *dir, size_t i,
                          struct gsn_fiducial_candidates *found, size_t apart,
                          struct gsn_error *err)
{
    const struct gsn_fiducial_candidates *seen = &folder->work[i].spots->candidates;
    gsn_auto(gsn_picture) picture = NULL;
    int r = open_picture(folder, dir, i, &picture, err);

    found[0] = *seen;
    for (unsigned burn = 1; r >= 0 && burn < GSN_BURNS; burn++)
        r = gsn_colour_candidates_find_burns(picture->image, folder->px_um, seen->tissue_px, burn,
                                             &found[burn * apart], err);
    return r < 0 ? gsn_fail_at(err, "%s", folder->stack->section[i].file) : GSN_OK;
}

static void take_burns(struct folder_job *folder, const struct gsn_fiducial_candidates *found)
{
    for (size_t i = 0, n = 0; i < folder->stack->count; i++) {
        struct gsn_colour_candidates *spots = folder->work[i].spots;

        if (!spots)
            continue;
        spots->candidates = found[n++];
        for (size_t k = 0; k < GSN_FIDUCIAL_CANDIDATES; k++)
            spots->measured[k] = 1;
    }
}

/* Where few sections show marks of the ordinary size: reads the pictures again and looks for other
 * kinds of burns (gsn_fiducials_choose_burn()), and chooses among those. chosen: what
 * choose_all_marks() said. Fails with GSN_E_MARKERS, GSN_E_PROCESS, GSN_E_NOMEM. */
static int choose_burns(struct folder_job *folder, const char *dir, int chosen,
                        struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_fiducial_candidates) found =
        gsn_alloc_array(GSN_BURNS * count, sizeof *found);
    struct gsn_point stated[GSN_FIDUCIALS];
    const struct gsn_point *mark_um = folder->options->mark ? stated : NULL;
    size_t readable, n = 0;
    unsigned burn = 0;
    int odd, r;

    if (!found)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a stack");
    if (mark_um)
        get_stated_marks(folder, stated);
    readable = collect_candidates(folder, found);
    r = gsn_fiducials_are_odd(found, readable, mark_um, &odd, err);
    if (r < 0 || !odd)
        return r < 0 ? r : chosen;
    for (size_t i = 0; r >= 0 && i < count; i++)
        if (folder->work[i].spots)
            r = look_for_burns(folder, dir, i, &found[n++], readable, err);
    if (r >= 0)
        r = gsn_fiducials_choose_burn(found, readable, mark_um, &burn, err);
    if (r < 0 || burn == 0)
        return r < 0 ? r : chosen;
    take_burns(folder, found + burn * readable);
    return choose_all_marks(folder, err);
}

enum { TARGETS = 21 };

static size_t make_targets(const struct folder_job *folder, struct gsn_point *targets)
{
    const double radius = folder->options->radius * folder->unit;
    size_t n = 0;

    for (int k = 0; k < TARGETS * TARGETS; k++) {
        const struct gsn_point at = { radius * (k % TARGETS - TARGETS / 2) / (TARGETS / 2),
                                      radius * (k / TARGETS - TARGETS / 2) / (TARGETS / 2) };

        if (at.x * at.x + at.y * at.y <= radius * radius)
            targets[n++] = at;
    }
    return radius > 0 ? n : 0;
}

static void add_flag(struct gsn_folder_section *section, const char *word)
{
    const size_t used = strlen(section->flags);

    (void)snprintf(section->flags + used, sizeof section->flags - used, "%s%s", used ? " " : "",
                   word);
}

static void say_why(const struct section_work *work, struct gsn_folder_section *section)
{
    if (section->reason[0])
        return;
    if (section->score > 0 && 20 * section->runner_up > section->score)
        (void)snprintf(section->reason, sizeof section->reason,
                       "the marks could be others: the best three spots score %.2g, the next %.2g; "
                       "look at the section",
                       section->score, section->runner_up);
    else
        (void)snprintf(section->reason, sizeof section->reason,
                       "no three marks: %zu dark spot%s, none of them in the triangle's places; "
                       "look at the section",
                       work->spots->candidates.count,
                       work->spots->candidates.count == 1 ? "" : "s");
}

/* ---- poses by marks -------------------------------------------------------------------------- */

/* The block is in um, pixel centres at +0.5; the answer in the caller's unit, at whole numbers. */
static struct gsn_affine map_frame_to_px(const struct folder_job *folder,
                                         const struct gsn_affine *to_block)
{
    struct gsn_affine map = gsn_affine_inverse(to_block);

    map.m00 *= folder->unit;
    map.m01 *= folder->unit;
    map.m10 *= folder->unit;
    map.m11 *= folder->unit;
    map.m02 -= 0.5;
    map.m12 -= 0.5;
    return map;
}

static void flag_pose(struct gsn_folder_section *section, const struct gsn_pose *pose)
{
    if (pose->flipped)
        add_flag(section, "flipped");
    if (pose->rotated180)
        add_flag(section, "rotated180");
    if (pose->state == GSN_POSE_TWO_MARKS)
        add_flag(section, "two-marks");
    if (pose->gross)
        add_flag(section, "gross");
}

/* Where a mark may be wrong, the ellipses grow as the whole error does. */
static void report_ellipses(const struct folder_job *folder, const struct gsn_pose *pose,
                            double growth, struct gsn_folder_section *section)
{
    static const int towards[GSN_FOLDER_ELLIPSES][2] = {
        { 0, 0 }, { 1, 0 }, { 0, 1 }, { -1, 0 }, { 0, -1 }
    };
    const double radius = folder->options->radius > 0
                              ? folder->options->radius
                              : folder->stack->summary.rho_um / folder->unit;
    const double px = growth / folder->px_um;

    for (size_t i = 0; i < GSN_FOLDER_ELLIPSES; i++) {
        const struct gsn_point at = { radius * towards[i][0], radius * towards[i][1] };
        const struct gsn_point um = { at.x * folder->unit, at.y * folder->unit };
        const struct gsn_ellipse e =
            gsn_pose_ellipse_at(&pose->error, um, folder->stack->summary.stretches, 0.95);

        section->ellipse[i] =
            (struct gsn_folder_ellipse){ at, { e.major * px, e.minor * px, e.angle } };
    }
}

/* The pose with the section's own size, where the stack's differ by more than their marks'
 * errors: the knife and the water bath change a section's size by some per cent, which a
 * rigid pose leaves as an error that grows with the distance from the marks' middle. Marks that are
 * stated are where the frame has them, whatever the sections' mean size. ret_error_um: over the
 * same targets as before. */
static struct gsn_affine fit_size(const struct folder_job *folder, const struct gsn_pose *pose,
                                  const struct gsn_pose_options *options, double *ret_error_um)
{
    const struct gsn_pose_summary *summary = &folder->stack->summary;
    const struct gsn_pose_targets targets =
        gsn_pose_targets_of(options->targets_um, options->target_count);
    const struct gsn_affine own = gsn_strain_corrected(pose);
    struct gsn_affine mean;

    if (targets.count > 0)
        *ret_error_um = gsn_pose_tre_rms(&pose->error, &targets, 1);
    if (!options->markers_um)
        return own;
    mean = gsn_strain_of_mean(summary->mean_triangle, options->markers_um);
    return gsn_affine_compose(&own, &mean);
}

static void report_pose(const struct folder_job *folder, size_t i, const struct gsn_pose *pose,
                        const struct gsn_pose_options *options)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    struct gsn_affine px_to_frame = pose->panel_to_block_um;
    double error_um = pose->tre_um, growth = 1;

    section->state = pose->state;
    folder->work[i].pose = *pose;
    if (pose->state == GSN_POSE_NONE) {
        say_why(&folder->work[i], section);
        return;
    }
    /* A mark that lies wrong would drag the others along. */
    if (pose->gross && pose->state == GSN_POSE_OK)
        gsn_pose_likeliest(pose, options->targets_um, options->target_count, &px_to_frame,
                           &error_um);
    else if (pose->gross)
        error_um = hypot(pose->tre_um, pose->rms_um);
    else if (folder->stack->summary.stretches)
        px_to_frame = fit_size(folder, pose, options, &error_um);
    if (pose->gross)
        growth = error_um / pose->tre_um;
    folder->work[i].pose.panel_to_block_um = px_to_frame;
    section->frame_to_px = map_frame_to_px(folder, &px_to_frame);
    section->error_px = error_um / folder->px_um;
    report_ellipses(folder, pose, growth, section);
    section->rms_px = pose->rms_um / folder->px_um;
    section->flipped = pose->flipped;
    flag_pose(section, pose);
}

/* Lays the sections by their marks. Fails with GSN_E_MARKERS, GSN_E_NOMEM. */
static int solve_poses(struct folder_job *folder, struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_pose_input) inputs = gsn_alloc_array(count, sizeof *inputs);
    gsn_auto_mem(struct gsn_pose) poses = gsn_alloc_array(count, sizeof *poses);
    struct gsn_point targets[TARGETS * TARGETS], marks[GSN_FIDUCIALS];
    struct gsn_pose_options options = { .targets_um = targets, .sizes = 1 };
    int r;

    if (!inputs || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a stack");
    for (size_t i = 0; i < count; i++) {
        inputs[i] = (struct gsn_pose_input){ .serial = (unsigned)i,
                                             .px_um = folder->px_um,
                                             .mirrored = folder->work[i].mirrored };
        memcpy(inputs[i].marks, folder->work[i].marks, sizeof inputs[i].marks);
    }
    if (folder->options->mark) {
        get_stated_marks(folder, marks);
        options.markers_um = marks;
    }
    options.target_count = make_targets(folder, targets);
    r = gsn_pose_solve(inputs, count, &options, poses, &folder->stack->summary, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < count; i++)
        report_pose(folder, i, &poses[i], &options);
    folder->stack->fle_px = folder->stack->summary.fle_um / folder->px_um;
    return GSN_OK;
}

/* ---- poses by tissue ------------------------------------------------------------------------- */

/* Chi-squared of one in a million for each of the 3 degrees of freedom, and then its root. */
static const double DISAGREES = 3.3;

/* Whether the marks are to be relied on. */
static int marks_hold(const struct folder_job *folder)
{
    size_t with = 0, read = 0;

    for (size_t i = 0; i < folder->stack->count; i++) {
        with += folder->work[i].pose.state == GSN_POSE_OK;
        read += folder->work[i].tissue != NULL;
    }
    return with > 0 && (folder->options->mark || 2 * with >= read);
}

static void state_section(const struct folder_job *folder, size_t i, int marks,
                          struct gsn_tissue_section *ret_section)
{
    const struct section_work *work = &folder->work[i];
    const double px = folder->px_um;
    struct gsn_affine map = work->pose.panel_to_block_um;

    *ret_section = (struct gsn_tissue_section){
        .serial = (unsigned)i,
        .tissue = work->tissue,
        .marked = marks && work->pose.state != GSN_POSE_NONE && !work->pose.gross,
    };
    if (!ret_section->marked || !work->tissue)
        return;
    map.m00 /= px;
    map.m01 /= px;
    map.m10 /= px;
    map.m11 /= px;
    ret_section->to_block = map;
    gsn_pose_error_about(&work->pose.error, gsn_affine_apply(&map, gsn_tissue_centre(work->tissue)),
                         ret_section->covariance);
}

static void say_no_tissue(const struct section_work *work, struct gsn_folder_section *section)
{
    if (!work->spots && section->reason[0])
        return;
    (void)snprintf(section->reason, sizeof section->reason,
                   "no marks, and its tissue fits none of the three sections before and after; "
                   "look at the section");
}

/* A pose by tissue: the reference's own picture is the frame, not half a pixel beside it. */
static void report_tissue_pose(struct folder_job *folder, size_t i,
                               const struct gsn_tissue_pose *pose, int flipped)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    const double px = folder->px_um, half = folder->stack->tissue.held > 0 ? 0 : 0.5 * px;
    struct gsn_affine map = pose->to_block;

    section->flags[0] = '\0';
    section->reason[0] = '\0';
    section->state = GSN_POSE_NONE;
    section->by_tissue = pose->laid;
    if (!pose->laid) {
        say_no_tissue(&folder->work[i], section);
        return;
    }
    map.m00 *= px;
    map.m01 *= px;
    map.m10 *= px;
    map.m11 *= px;
    map.m02 -= half;
    map.m12 -= half;
    section->frame_to_px = map_frame_to_px(folder, &map);
    section->from = pose->from;
    section->error_px = pose->error / px;
    memset(section->ellipse, 0, sizeof section->ellipse);
    section->rms_px = 0;
    section->flipped = flipped;
    folder->stack->by_tissue++;
    add_flag(section, "by-tissue");
    if (flipped)
        add_flag(section, "flipped");
    if (pose->unsure)
        add_flag(section, "unsure");
}

/* The face that most sections show; with marks it is the marks' that counts. */
static int usual_face(const struct folder_job *folder, const struct gsn_tissue_pose *poses)
{
    int sum = 0;

    for (size_t i = 0; i < folder->stack->count; i++)
        if (poses[i].laid)
            sum += gsn_affine_det(&poses[i].to_block) > 0 ? 1 : -1;
    return folder->stack->tissue.held > 0 || sum >= 0 ? 1 : -1;
}

static void report_all(struct folder_job *folder, const struct gsn_tissue_section *sections,
                       const struct gsn_tissue_finding *findings,
                       const struct gsn_tissue_pose *poses)
{
    const int face = usual_face(folder, poses);

    for (size_t i = 0; i < folder->stack->count; i++) {
        struct gsn_folder_section *section = &folder->stack->section[i];

        if (!sections[i].marked && folder->work[i].spots)
            report_tissue_pose(folder, i, &poses[i], gsn_affine_det(&poses[i].to_block) * face < 0);
        if (findings[i].contradicted || (sections[i].marked && poses[i].disagrees > DISAGREES))
            add_flag(section, "tissue-disagrees");
        if (findings[i].contradicted && !poses[i].laid)
            (void)snprintf(section->reason, sizeof section->reason,
                           "what looks like its marks lays it elsewhere than its neighbours' "
                           "tissue does, which alone does not lay it; look at the section");
    }
}

/* Places what the marks left. Fails with GSN_E_NOMEM. */
static int place_by_tissue(struct folder_job *folder, struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_tissue_section) sections = gsn_alloc_array(count, sizeof *sections);
    gsn_auto_mem(struct gsn_tissue_finding) findings = gsn_alloc_array(count, sizeof *findings);
    gsn_auto_mem(struct gsn_tissue_pose) poses = gsn_alloc_array(count, sizeof *poses);
    struct gsn_tissue_summary *summary = &folder->stack->tissue;
    const int marks = marks_hold(folder);
    int r;

    if (!sections || !findings || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a stack");
    for (size_t i = 0; i < count; i++)
        state_section(folder, i, marks, &sections[i]);
    r = gsn_tissue_check(sections, count, findings, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        sections[i].marked &= !findings[i].contradicted;
    if (r >= 0)
        r = gsn_tissue_register(sections, count, GSN_TISSUE_MIDDLE, poses, summary, err);
    if (r < 0)
        return r;
    summary->usual /= folder->px_um;
    summary->drift /= folder->px_um;
    report_all(folder, sections, findings, poses);
    return GSN_OK;
}

static double median_search_ms(const struct folder_job *folder)
{
    gsn_auto_mem(double) ms = gsn_alloc_array(folder->stack->count, sizeof *ms);
    size_t n = 0;

    for (size_t i = 0; ms && i < folder->stack->count; i++)
        if (folder->work[i].spots)
            ms[n++] = folder->work[i].search_ms;
    return n > 0 ? gsn_median(ms, n) : 0;
}

/* Why there may be no marks, when they are not found. */
static int fail_without_marks(const struct folder_job *folder, const char *why,
                              struct gsn_error *err)
{
    const double least_um = GSN_FIDUCIAL_MIN_PX * folder->px_um;

    if (!(folder->options->px_um > 0 && least_um > GSN_FIDUCIAL_MIN_UM))
        return gsn_fail(err, GSN_E_MARKERS, "%s", why);
    return gsn_fail(err, GSN_E_MARKERS,
                    "%s; at %.4g um a pixel marks of less than %.3g um radius (%g pixels; holes: "
                    "%.3g um) may not be told from grain: scan finer if they are so small",
                    why, folder->px_um, least_um, GSN_FIDUCIAL_MIN_PX, 2 * least_um);
}

static int register_folder(struct folder_job *folder, const char *dir, struct gsn_error *err)
{
    struct gsn_error own = { 0 };
    double began;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < folder->stack->count; i++)
        r = search_picture(folder, dir, i, err);
    began = gsn_process_cpu_ms();
    if (r >= 0)
        r = choose_all_marks(folder, &own);
    if (r >= 0 || r == GSN_E_MARKERS)
        r = choose_burns(folder, dir, r, &own);
    if (r >= 0)
        r = solve_poses(folder, &own);
    if (r == GSN_E_MARKERS && folder->options->by_tissue && !folder->options->mark)
        r = GSN_OK;
    else if (r == GSN_E_MARKERS)
        r = fail_without_marks(folder, own.text, err);
    else if (r < 0 && own.text[0])
        r = gsn_fail(err, r, "%s", own.text);
    if (r >= 0 && folder->options->by_tissue)
        r = place_by_tissue(folder, err);
    folder->stack->cpu_ms =
        median_search_ms(folder) + (gsn_process_cpu_ms() - began) / (double)folder->stack->count;
    return r;
}

int gsn_folder_register(const char *dir, const struct gsn_folder_options *options,
                        struct gsn_folder_stack **ret_stack, struct gsn_error *err)
{
    gsn_auto(gsn_folder_stack) stack = gsn_alloc_array(1, sizeof *stack);
    gsn_auto_mem(struct section_work) work = NULL;
    struct folder_job folder = { .options = options, .stack = stack };
    int r;

    assert(dir && options && ret_stack);

    if (!stack)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
    r = list_pictures(dir, stack, err);
    if (r < 0)
        return r;
    work = gsn_alloc_array(stack->count, sizeof *work);
    if (!work)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
    folder.work = work;
    folder.px_um = options->px_um > 0 ? options->px_um : GSN_FOLDER_PX_UM;
    folder.unit = options->px_um > 0 ? 1 : GSN_FOLDER_PX_UM;
    r = register_folder(&folder, dir, err);
    for (size_t i = 0; i < stack->count; i++) {
        gsn_colour_candidates_free(work[i].spots);
        gsn_tissue_free(work[i].tissue);
    }
    if (r < 0)
        return r;
    *ret_stack = gsn_steal(&stack);
    return GSN_OK;
}

void gsn_folder_stack_free(struct gsn_folder_stack *stack)
{
    if (!stack)
        return;
    for (size_t i = 0; stack->section && i < stack->count; i++)
        gsn_free(stack->section[i].file);
    gsn_free(stack->section);
    gsn_free(stack);
}
