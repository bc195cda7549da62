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

/* One section while the stack is worked. */
struct work {
    struct gsn_mark_spots *spots; /* NULL when the picture could not be read */
    struct gsn_mark marks[GSN_MARKS];
    int mirrored;
    double search_ms;
};

struct folder {
    const struct gsn_folder_options *options;
    struct gsn_folder_stack *stack;
    struct work *work;
    double px_um; /* stated, or made up */
    double unit;  /* um per unit of the caller's lengths */
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

static void tell(const struct folder *folder, size_t i, const struct gsn_pose *pose,
                 const struct gsn_pose_options *options)
{
    struct gsn_folder_section *section = &folder->stack->section[i];
    struct gsn_affine frame_to_px, px_to_frame = pose->panel_to_block_um;
    double error_um = pose->tre_um;

    section->state = pose->state;
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
    frame_to_px = gsn_affine_inverse(&px_to_frame);
    frame_to_px.m00 *= folder->unit;
    frame_to_px.m01 *= folder->unit;
    frame_to_px.m10 *= folder->unit;
    frame_to_px.m11 *= folder->unit;
    frame_to_px.m02 -= 0.5;
    frame_to_px.m12 -= 0.5;
    section->frame_to_px = frame_to_px;
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
    double began;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < folder->stack->count; i++)
        r = search(folder, dir, i, err);
    began = cpu_ms();
    if (r >= 0)
        r = settle(folder, err);
    if (r >= 0)
        r = solve(folder, err);
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
    for (size_t i = 0; i < stack->count; i++)
        gsn_mark_spots_free(work[i].spots);
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
