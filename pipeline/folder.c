/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/apart.h"
#include "pipeline/register/mark_spots.h"
#include "pipeline/register/median.h"
#include "pipeline/register/rigid.h"

#include <assert.h>
#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/mman.h>
#include <time.h>

enum { MOST_PICTURE_BYTES = 1 << 30, TARGETS = 21 };

/* Cells along a picture's longer side: what neighbouring sections share is larger than such a
 * cell, and finer ones laid none of the stacks we have better. */
enum { TISSUE_CELLS = 250 };
/* Chi-squared of one in a million for each of the 3 degrees of freedom, and then its root. */
static const double DISAGREES = 3.3;

/* One section while the stack is worked. */
struct work {
    struct gsn_mark_spots *spots; /* NULL when the picture could not be read */
    struct gsn_mark marks[GSN_MARKS];
    int mirrored;
    struct gsn_pose pose;
    struct gsn_tissue *tissue; /* NULL when it is not asked for or shows nothing */
    double search_ms;
};

struct folder {
    const struct gsn_folder_options *options;
    struct gsn_folder_stack *stack;
    struct work *work;
    double px_um; /* stated, or made up */
    double unit;  /* um per unit of the caller's lengths */
    double cell;  /* of the tissue's bands, pixels; 0 until the first picture is read */
};

static double cpu_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return 1e3 * (double)now.tv_sec + 1e-6 * (double)now.tv_nsec;
}

/* ---- Reading ------------------------------------------------------------------------------- */

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

static int list(const char *dir, struct gsn_folder_stack *stack, struct gsn_error *err)
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
static int look_at_tissue(struct folder *folder, size_t i, const struct gsn_image *image,
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

/* Reads one picture and looks for its spots; a picture that cannot be read costs itself alone. */
static int search(struct folder *folder, const char *dir, size_t i, struct gsn_error *err)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    gsn_auto_mem(char) path = gsn_format("%s/%s", dir, section->file);
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto(gsn_picture) picture = NULL;
    struct gsn_error own = { 0 };
    size_t size;
    double began;
    int r;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", section->file);
    r = gsn_file_read(path, MOST_PICTURE_BYTES, &bytes, &size, &own);
    if (r >= 0)
        r = gsn_decode_apart(folder->options->decoder, bytes, size, NULL, &picture, &own);
    /* The decoder's pages come into this process with the decoding, not with the search. */
    if (r >= 0 && picture->mapped_bytes > 0)
        (void)madvise(picture->place, picture->mapped_bytes, MADV_POPULATE_READ);
    began = cpu_ms();
    if (r >= 0)
        r = gsn_mark_spots_find(picture->image, folder->px_um, &folder->work[i].spots, &own);
    if (r >= 0)
        r = look_at_tissue(folder, i, picture->image, &own);
    folder->work[i].search_ms = cpu_ms() - began;
    if (r == GSN_E_NOMEM || r == GSN_E_PROCESS)
        return gsn_fail(err, r, "%s: %s", section->file, own.text);
    if (r < 0)
        (void)snprintf(section->reason, sizeof section->reason, "%s", own.text);
    return GSN_OK;
}

/* ---- Choosing ------------------------------------------------------------------------------ */

/* The candidates of all sections that could be read, one after the other. */
static size_t collect(const struct folder *folder, struct gsn_mark_candidates *candidates)
{
    size_t n = 0;

    for (size_t i = 0; i < folder->stack->count; i++)
        if (folder->work[i].spots)
            candidates[n++] = folder->work[i].spots->candidates;
    return n;
}

static int know_triangle(const struct folder *folder, struct gsn_triangle_prior *ret_prior,
                         struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
        gsn_alloc_array(folder->stack->count, sizeof *candidates);
    struct gsn_triangle_prior prior = { 0 };
    size_t n;
    int r = GSN_OK;

    if (!candidates)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a stack");
    n = collect(folder, candidates);
    for (size_t i = 0; folder->options->mark && i < GSN_MARKS; i++)
        prior.mark_um[i] = (struct gsn_point){ folder->options->mark[i].x * folder->unit,
                                               folder->options->mark[i].y * folder->unit };
    if (!folder->options->mark)
        r = gsn_markers_consensus(candidates, n, &prior, err);
    if (r >= 0)
        r = gsn_markers_learn(candidates, n, &prior, err);
    if (r >= 0)
        *ret_prior = prior;
    return r;
}

static size_t found_of(const struct work *work)
{
    size_t found = 0;

    for (size_t k = 0; k < GSN_MARKS; k++)
        found += work->marks[k].found != 0;
    return found;
}

static void choose(struct folder *folder, size_t i, const struct gsn_triangle_prior *prior)
{
    struct work *work = &folder->work[i];
    struct gsn_folder_section *section = &folder->stack->section[i];

    gsn_markers_choose(&work->spots->candidates, prior, work->marks, &work->mirrored,
                       &section->score, &section->runner_up);
}

/* Measures the spots that were chosen, or all of them. */
static int measure(struct work *work, int all, struct gsn_error *err)
{
    for (size_t i = 0; i < work->spots->candidates.count; i++) {
        const struct gsn_mark *spot = &work->spots->candidates.mark[i];
        int wanted = all;
        int r;

        for (size_t k = 0; k < GSN_MARKS; k++)
            wanted |= work->marks[k].found && work->marks[k].px.x == spot->px.x &&
                      work->marks[k].px.y == spot->px.y;
        r = wanted ? gsn_mark_spots_measure(work->spots, i, err) : GSN_OK;
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

static int choose_all(struct folder *folder, const struct gsn_triangle_prior *prior, int last,
                      struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < folder->stack->count; i++) {
        struct work *work = &folder->work[i];

        if (!work->spots)
            continue;
        choose(folder, i, prior);
        r = measure(work, found_of(work) < GSN_MARKS, err);
        if (last)
            choose(folder, i, prior);
    }
    return r;
}

/* What was chosen from afar is measured, everything where nothing could be chosen; three measured
 * marks of every clear section then tell how like the triangles are, and the choice is made again.
 */
static int settle(struct folder *folder, struct gsn_error *err)
{
    struct gsn_triangle_prior prior;
    int r = know_triangle(folder, &prior, err);

    if (r >= 0)
        r = choose_all(folder, &prior, 0, err);
    if (r >= 0)
        r = know_triangle(folder, &prior, err);
    return r < 0 ? r : choose_all(folder, &prior, 1, err);
}

/* ---- Solving and telling -------------------------------------------------------------------- */

static size_t make_targets(const struct folder *folder, struct gsn_point *targets)
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

static void say_why(const struct work *work, struct gsn_folder_section *section)
{
    if (section->reason[0])
        return;
    if (section->score > 0 && section->runner_up > 0.5 * section->score)
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

/* The block is in um, pixel centres at +0.5; the answer in the caller's unit, at whole numbers. */
static struct gsn_affine frame_to_px(const struct folder *folder, const struct gsn_affine *to_block)
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

static void tell(const struct folder *folder, size_t i, const struct gsn_pose *pose,
                 const struct gsn_pose_options *options)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    struct gsn_affine px_to_frame = pose->panel_to_block_um;
    double error_um = pose->tre_um;

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
    folder->work[i].pose.panel_to_block_um = px_to_frame;
    section->frame_to_px = frame_to_px(folder, &px_to_frame);
    section->error_px = error_um / folder->px_um;
    section->rms_px = pose->rms_um / folder->px_um;
    section->flipped = pose->flipped;
    if (pose->flipped)
        add_flag(section, "flipped");
    if (pose->rotated180)
        add_flag(section, "rotated180");
    if (pose->state == GSN_POSE_TWO_MARKS)
        add_flag(section, "two-marks");
    if (pose->gross)
        add_flag(section, "gross");
}

static int solve(struct folder *folder, struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_pose_input) inputs = gsn_alloc_array(count, sizeof *inputs);
    gsn_auto_mem(struct gsn_pose) poses = gsn_alloc_array(count, sizeof *poses);
    struct gsn_point targets[TARGETS * TARGETS], marks[GSN_MARKS];
    struct gsn_pose_options options = { .targets_um = targets };
    int r;

    if (!inputs || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a stack");
    for (size_t i = 0; i < count; i++) {
        inputs[i] = (struct gsn_pose_input){ .serial = (unsigned)i,
                                             .px_um = folder->px_um,
                                             .mirrored = folder->work[i].mirrored };
        memcpy(inputs[i].marks, folder->work[i].marks, sizeof inputs[i].marks);
    }
    for (size_t i = 0; folder->options->mark && i < GSN_MARKS; i++)
        marks[i] = (struct gsn_point){ folder->options->mark[i].x * folder->unit,
                                       folder->options->mark[i].y * folder->unit };
    options.markers_um = folder->options->mark ? marks : NULL;
    options.target_count = make_targets(folder, targets);
    r = gsn_pose_solve(inputs, count, &options, poses, &folder->stack->summary, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < count; i++)
        tell(folder, i, &poses[i], &options);
    folder->stack->fle_px = folder->stack->summary.fle_um / folder->px_um;
    return GSN_OK;
}

/* ---- By tissue ------------------------------------------------------------------------------ */

/* Whether the marks are to be relied on. */
static int marks_hold(const struct folder *folder)
{
    size_t with = 0, read = 0;

    for (size_t i = 0; i < folder->stack->count; i++) {
        with += folder->work[i].pose.state == GSN_POSE_OK;
        read += folder->work[i].tissue != NULL;
    }
    return with > 0 && (folder->options->mark || 2 * with >= read);
}

static void state_section(const struct folder *folder, size_t i, int marks,
                          struct gsn_tissue_section *ret_section)
{
    const struct work *work = &folder->work[i];
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

static void say_no_tissue(const struct work *work, struct gsn_folder_section *section)
{
    if (!work->spots && section->reason[0])
        return;
    (void)snprintf(section->reason, sizeof section->reason,
                   "no marks, and its tissue fits none of the two sections before and after; look "
                   "at the section");
}

/* A pose by tissue: the reference's own picture is the frame, not half a pixel beside it. */
static void tell_tissue(struct folder *folder, size_t i, const struct gsn_tissue_pose *pose,
                        int flipped)
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
    section->frame_to_px = frame_to_px(folder, &map);
    section->from = pose->from;
    section->error_px = pose->error / px;
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
static int usual_face(const struct folder *folder, const struct gsn_tissue_pose *poses)
{
    int sum = 0;

    for (size_t i = 0; i < folder->stack->count; i++)
        if (poses[i].laid)
            sum += gsn_affine_det(&poses[i].to_block) > 0 ? 1 : -1;
    return folder->stack->tissue.held > 0 || sum >= 0 ? 1 : -1;
}

static void tell_all(struct folder *folder, const struct gsn_tissue_section *sections,
                     const struct gsn_tissue_pose *poses)
{
    const int face = usual_face(folder, poses);

    for (size_t i = 0; i < folder->stack->count; i++) {
        struct gsn_folder_section *section = &folder->stack->section[i];

        if (!sections[i].marked && folder->work[i].spots)
            tell_tissue(folder, i, &poses[i], gsn_affine_det(&poses[i].to_block) * face < 0);
        else if (poses[i].disagrees > DISAGREES)
            add_flag(section, "tissue-disagrees");
    }
}

/* Lays what the marks left. */
static int lay(struct folder *folder, struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_tissue_section) sections = gsn_alloc_array(count, sizeof *sections);
    gsn_auto_mem(struct gsn_tissue_pose) poses = gsn_alloc_array(count, sizeof *poses);
    struct gsn_tissue_summary *summary = &folder->stack->tissue;
    const int marks = marks_hold(folder);
    int r;

    if (!sections || !poses)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of a stack");
    for (size_t i = 0; i < count; i++)
        state_section(folder, i, marks, &sections[i]);
    r = gsn_tissue_lay(sections, count, poses, summary, err);
    if (r < 0)
        return r;
    summary->usual /= folder->px_um;
    summary->drift /= folder->px_um;
    tell_all(folder, sections, poses);
    return GSN_OK;
}

static double median_search_ms(const struct folder *folder)
{
    gsn_auto_mem(double) ms = gsn_alloc_array(folder->stack->count, sizeof *ms);
    size_t n = 0;

    for (size_t i = 0; ms && i < folder->stack->count; i++)
        if (folder->work[i].spots)
            ms[n++] = folder->work[i].search_ms;
    return n > 0 ? gsn_median(ms, n) : 0;
}

static int run(struct folder *folder, const char *dir, struct gsn_error *err)
{
    struct gsn_error own = { 0 };
    double began;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < folder->stack->count; i++)
        r = search(folder, dir, i, err);
    began = cpu_ms();
    if (r >= 0)
        r = settle(folder, &own);
    if (r >= 0)
        r = solve(folder, &own);
    if (r == GSN_E_MARKERS && folder->options->by_tissue && !folder->options->mark)
        r = GSN_OK;
    else if (r < 0 && own.text[0])
        r = gsn_fail(err, r, "%s", own.text);
    if (r >= 0 && folder->options->by_tissue)
        r = lay(folder, err);
    folder->stack->cpu_ms =
        median_search_ms(folder) + (cpu_ms() - began) / (double)folder->stack->count;
    return r;
}

int gsn_folder_register(const char *dir, const struct gsn_folder_options *options,
                        struct gsn_folder_stack **ret_stack, struct gsn_error *err)
{
    gsn_auto(gsn_folder_stack) stack = gsn_alloc_array(1, sizeof *stack);
    gsn_auto_mem(struct work) work = NULL;
    struct folder folder = { .options = options, .stack = stack };
    int r;

    assert(dir && options && ret_stack);

    if (!stack)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
    r = list(dir, stack, err);
    if (r < 0)
        return r;
    work = gsn_alloc_array(stack->count, sizeof *work);
    if (!work)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for %s", dir);
    folder.work = work;
    folder.px_um = options->px_um > 0 ? options->px_um : GSN_FOLDER_PX_UM;
    folder.unit = options->px_um > 0 ? 1 : GSN_FOLDER_PX_UM;
    r = run(&folder, dir, err);
    for (size_t i = 0; i < stack->count; i++) {
        gsn_mark_spots_free(work[i].spots);
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
