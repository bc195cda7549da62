/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/folder_parts.h"
#include "pipeline/register/fiducial/triangle.h"
#include "pipeline/register/fiducial/learn.h"
#include "pipeline/register/fiducial/correspondence.h"

void gsn_folder_stated_marks(const struct gsn_section_folder *folder,
                             struct gsn_point ret_mark_um[GSN_MARKS])
{
    for (size_t i = 0; i < GSN_MARKS; i++)
        ret_mark_um[i] = (struct gsn_point){ folder->options->mark[i].x * folder->unit,
                                             folder->options->mark[i].y * folder->unit };
}

/* The candidates of all sections that could be read, one after the other. */
static size_t collect(const struct gsn_section_folder *folder,
                      struct gsn_mark_candidates *candidates)
{
    size_t n = 0;

    for (size_t i = 0; i < folder->stack->count; i++)
        if (folder->work[i].spots)
            candidates[n++] = folder->work[i].spots->candidates;
    return n;
}

static int know_triangle(const struct gsn_section_folder *folder,
                         struct gsn_triangle_prior *ret_prior, struct gsn_error *err)
{
    gsn_auto_mem(struct gsn_mark_candidates) candidates =
        gsn_alloc_array(folder->stack->count, sizeof *candidates);
    struct gsn_triangle_prior prior = { 0 };
    size_t n;
    int r = GSN_OK;

    if (!candidates)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a stack");
    n = collect(folder, candidates);
    if (folder->options->mark)
        gsn_folder_stated_marks(folder, prior.mark_um);
    else
        r = gsn_markers_consensus(candidates, n, &prior, err);
    if (r >= 0)
        r = gsn_markers_learn(candidates, n, &prior, err);
    if (r >= 0)
        *ret_prior = prior;
    return r;
}

static size_t found_of(const struct gsn_folder_work *work)
{
    size_t found = 0;

    for (size_t k = 0; k < GSN_MARKS; k++)
        found += work->marks[k].found != 0;
    return found;
}

static void choose(struct gsn_section_folder *folder, size_t i,
                   const struct gsn_triangle_prior *prior)
{
    struct gsn_folder_work *work = &folder->work[i];
    struct gsn_folder_section *section = &folder->stack->section[i];

    gsn_markers_choose(&work->spots->candidates, prior, work->marks, &work->mirrored,
                       &section->score, &section->runner_up);
}

/* Measures the spots that were chosen, or all of them. */
static int measure(struct gsn_folder_work *work, int all, struct gsn_error *err)
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

static int choose_all(struct gsn_section_folder *folder, const struct gsn_triangle_prior *prior,
                      int last, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < folder->stack->count; i++) {
        struct gsn_folder_work *work = &folder->work[i];

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
int gsn_folder_choose_marks(struct gsn_section_folder *folder, struct gsn_error *err)
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

static int look_for_burns(const struct gsn_section_folder *folder, const char *dir, size_t i,
                          struct gsn_mark_candidates *found, size_t apart, struct gsn_error *err)
{
    const struct gsn_mark_candidates *seen = &folder->work[i].spots->candidates;
    gsn_auto(gsn_picture) picture = NULL;
    int r = gsn_folder_open(folder, dir, i, &picture, err);

    found[0] = *seen;
    for (unsigned burn = 1; r >= 0 && burn < GSN_MARK_BURNS; burn++)
        r = gsn_mark_spots_find_burns(picture->image, folder->px_um, seen->tissue_px, burn,
                                      &found[burn * apart], err);
    return r < 0 ? gsn_fail_at(err, "%s", folder->stack->section[i].file) : GSN_OK;
}

static void take_burns(struct gsn_section_folder *folder, const struct gsn_mark_candidates *found)
{
    for (size_t i = 0, n = 0; i < folder->stack->count; i++) {
        struct gsn_mark_spots *spots = folder->work[i].spots;

        if (!spots)
            continue;
        spots->candidates = found[n++];
        for (size_t k = 0; k < GSN_MARK_CANDIDATES; k++)
            spots->measured[k] = 1;
    }
}

int gsn_folder_choose_burns(struct gsn_section_folder *folder, const char *dir, int chosen,
                            struct gsn_error *err)
{
    const size_t count = folder->stack->count;
    gsn_auto_mem(struct gsn_mark_candidates) found =
        gsn_alloc_array(GSN_MARK_BURNS * count, sizeof *found);
    struct gsn_point stated[GSN_MARKS];
    const struct gsn_point *mark_um = folder->options->mark ? stated : NULL;
    size_t readable, n = 0;
    unsigned burn = 0;
    int odd, r;

    if (!found)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the marks of a stack");
    if (mark_um)
        gsn_folder_stated_marks(folder, stated);
    readable = collect(folder, found);
    r = gsn_markers_are_odd(found, readable, mark_um, &odd, err);
    if (r < 0 || !odd)
        return r < 0 ? r : chosen;
    for (size_t i = 0; r >= 0 && i < count; i++)
        if (folder->work[i].spots)
            r = look_for_burns(folder, dir, i, &found[n++], readable, err);
    if (r >= 0)
        r = gsn_markers_burn(found, readable, mark_um, &burn, err);
    if (r < 0 || burn == 0)
        return r < 0 ? r : chosen;
    take_burns(folder, found + burn * readable);
    return gsn_folder_choose_marks(folder, err);
}
