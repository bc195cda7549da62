/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: robust statistics (medians, median deviations) of the sections whose three marks are
 * clear, in two rounds; the share of sections that have marks by expectation and maximisation.
 *
 * Steps of gsn_fiducials_learn(). 1. Each section's marks are matched by what is known so far. 2.
 * Where at least three are clear: contrast, radius, place of the tissue and the misfit of a rigid
 * triangle, the counts of appearance (appearance.h), the mean thumbnail. 3. Again, since what the
 * first round took for marks by the triangle alone the second holds against their appearance. 4.
 * The share of sections with marks. gsn_fiducials_choose_burn() does that for each kind of burn,
 * and the kind with which most sections are clear is the stack's.
 *
 * Fails when memory runs out; of fewer than three clear sections nothing is learnt. Cost: two
 * matchings a section, and as many for each kind of burn. */
#include "pipeline/register/fiducial/learn.h"

#include "pipeline/core/mem.h"
#include "pipeline/core/robust.h"
#include "pipeline/register/fiducial/blob.h"
#include "pipeline/register/fiducial/thumbnail.h"
#include "pipeline/register/fiducial/appearance.h"
#include "pipeline/register/fiducial/triangle.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/pose/rigid.h"
#include "pipeline/register/fiducial/correspondence.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { FEWEST_SECTIONS = 3, ROUNDS = 2, EM_ROUNDS = 50 };

/* A misfit that one section in a thousand exceeds, over the median one: chi-squared of 3 degrees of
 * freedom, 16.3 and 2.4; three standard deviations are let in, so a third of its root does. The
 * rest is for triangles that stretch unequally. */
static const double STRETCH_TAUGHT = 2;

/* What learning gathers: one number per section and kind. */
enum { TISSUE_X, TISSUE_Y, CONTRAST, RADIUS, MISFIT, KINDS };

static int gather_section(const struct gsn_fiducial_candidates *section,
                          const struct gsn_triangle_prior *prior, double found[KINDS],
                          struct gsn_fiducial marks[GSN_FIDUCIALS], struct gsn_rigid *ret_motion,
                          int *ret_mirrored)
{
    struct gsn_point from[GSN_FIDUCIALS], tissue;
    struct gsn_rigid best = { 0 };
    double least = INFINITY;
    int mirrored = 0;

    gsn_fiducials_match(section, prior, marks, NULL, NULL, NULL);
    if (!marks[0].found || !marks[1].found || !marks[2].found)
        return 0;
    for (int k = 0; k < 2; k++) {
        struct gsn_rigid motion;
        double rms;

        for (int i = 0; i < GSN_FIDUCIALS; i++)
            from[i] = gsn_fiducial_to_um(marks[i].px, section->px_um, k);
        if (gsn_rigid_fit(from, prior->mark_um, NULL, GSN_FIDUCIALS, &motion, &rms, NULL) < 0 ||
            rms >= least)
            continue;
        least = rms;
        best = motion;
        mirrored = k;
    }
    tissue =
        gsn_rigid_apply(&best, gsn_fiducial_to_um(section->tissue_px, section->px_um, mirrored));
    *ret_motion = best;
    *ret_mirrored = mirrored;
    found[TISSUE_X] = tissue.x;
    found[TISSUE_Y] = tissue.y;
    found[MISFIT] = least;
    found[CONTRAST] = (marks[0].contrast + marks[1].contrast + marks[2].contrast) / GSN_FIDUCIALS;
    found[RADIUS] = (marks[0].radius_px + marks[1].radius_px + marks[2].radius_px) / GSN_FIDUCIALS *
                    section->px_um;
    return 1;
}

/* A robust standard deviation of count values about their median; reorders them. */
static double median_deviation(double *value, size_t count, double centre)
{
    for (size_t i = 0; i < count; i++)
        value[i] = fabs(value[i] - centre);
    return 1.4826 * gsn_median(value, count);
}

static void learn_numbers(double *value, size_t count, size_t n, struct gsn_triangle_prior *prior)
{
    prior->tissue_um.x = gsn_median(value + TISSUE_X * count, n);
    prior->tissue_um.y = gsn_median(value + TISSUE_Y * count, n);
    /* Of sections whose marks lie exactly nothing is learnt. */
    prior->stretch_um = STRETCH_TAUGHT * gsn_median(value + MISFIT * count, n);
    prior->contrast = gsn_median(value + CONTRAST * count, n);
    prior->radius_um = gsn_median(value + RADIUS * count, n);
    prior->tissue_sd_um = fmax(median_deviation(value + TISSUE_X * count, n, prior->tissue_um.x),
                               median_deviation(value + TISSUE_Y * count, n, prior->tissue_um.y));
}

/* What marks of clear sections look like, and what is seen beside them. */
static void learn_looks(const struct gsn_fiducial_candidates *sections, const int *clear,
                        const struct gsn_fiducial *marks, size_t count,
                        struct gsn_triangle_prior *prior)
{
    struct gsn_appearance_counts counts = { .marks = 0 };

    for (size_t i = 0; i < count; i++)
        if (clear[i])
            gsn_appearance_count(&sections[i], &marks[GSN_FIDUCIALS * i], prior, &counts);
    gsn_appearance_learn(&counts, prior);
}

/* One round: from what is known before it to what the sections then say. */
static int learn_once(const struct gsn_fiducial_candidates *sections, size_t count,
                      struct gsn_triangle_prior *prior, struct gsn_error *err)
{
    gsn_auto_mem(double) value = gsn_alloc_array(count * KINDS, sizeof *value);
    gsn_auto_mem(struct gsn_rigid) motion = gsn_alloc_array(count, sizeof *motion);
    gsn_auto_mem(int) clear = gsn_alloc_array(2 * count, sizeof *clear);
    gsn_auto_mem(struct gsn_fiducial) marks = gsn_alloc_array(GSN_FIDUCIALS * count, sizeof *marks);
    size_t n = 0;

    if (!value || !motion || !clear || !marks)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while learning what a mark looks like");
    for (size_t i = 0; i < count; i++) {
        double found[KINDS];

        clear[i] = gather_section(&sections[i], prior, found, &marks[GSN_FIDUCIALS * i], &motion[i],
                                  &clear[count + i]);
        for (size_t k = 0; clear[i] && k < KINDS; k++)
            value[k * count + n] = found[k];
        n += (size_t)clear[i];
    }
    if (n < FEWEST_SECTIONS)
        return GSN_OK;
    learn_numbers(value, count, n, prior);
    prior->learnt = 1;
    learn_looks(sections, clear, marks, count, prior);
    return gsn_thumbnail_mean(sections, motion, clear + count, clear, count, prior->tissue_um,
                              &prior->tissue, err);
}

/* The share of sections that have marks at all, by its likelihood (EM; one section more with marks
 * and one without, as nothing is certain). Blobs that lie like the triangle by chance do so in few
 * sections of a stack without marks, and are then worth nothing in any. */
static double share_marked(const struct gsn_fiducial_candidates *sections, size_t count,
                           const struct gsn_triangle_prior *prior, double *over_none)
{
    double share = 0.5;

    for (size_t i = 0; i < count; i++)
        over_none[i] = gsn_hypotheses_over_none(&sections[i], prior);
    for (int round = 0; round < EM_ROUNDS; round++) {
        double sum = 1;

        for (size_t i = 0; i < count; i++)
            sum += share * over_none[i] / (1 - share + share * over_none[i]);
        share = sum / ((double)count + 2);
    }
    return share;
}

int gsn_fiducials_learn(const struct gsn_fiducial_candidates *sections, size_t count,
                        struct gsn_triangle_prior *prior, struct gsn_error *err)
{
    gsn_auto_mem(double) over_none = gsn_alloc_array(count, sizeof *over_none);
    struct gsn_triangle_prior learnt;
    int r = GSN_OK;

    assert((sections || count == 0) && prior);

    if (!over_none)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while learning what a mark looks like");
    learnt = *prior;
    learnt.marked = 0;
    learnt.burn = count > 0 ? sections[0].burn : 0;
    /* What the first round took for marks by the triangle alone, the second holds against looks. */
    for (int round = 0; round < ROUNDS && r >= 0; round++)
        r = learn_once(sections, count, &learnt, err);
    if (r < 0)
        return r;
    learnt.marked = share_marked(sections, count, &learnt, over_none);
    *prior = learnt;
    return GSN_OK;
}

/* Marks within this factor of the smallest or largest that are looked for: some of them are beyond.
 */
static const double NEAR_LIMIT = 1.25;

/* What one kind of burn shows. */
struct show {
    size_t clear;     /* sections with three marks */
    double misfit_um; /* of the typical three on the triangle */
    double radius_um;
};

static int try_burn(const struct gsn_fiducial_candidates *sections, size_t count,
                    const struct gsn_point *mark_um, struct show *ret_show, struct gsn_error *err)
{
    struct gsn_triangle_prior prior = { 0 };
    struct show show = { 0 };
    int r = GSN_OK;

    if (mark_um)
        memcpy(prior.mark_um, mark_um, sizeof prior.mark_um);
    else
        r = gsn_fiducials_vote_triangle(sections, count, &prior, NULL);
    if (r >= 0)
        r = gsn_fiducials_learn(sections, count, &prior, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        struct gsn_fiducial mark[GSN_FIDUCIALS];

        gsn_fiducials_match(&sections[i], &prior, mark, NULL, NULL, NULL);
        show.clear += mark[0].found && mark[1].found && mark[2].found;
    }
    if (r < 0 && r != GSN_E_MARKERS)
        return gsn_fail(err, r, "out of memory while looking for marks");
    show.misfit_um = prior.learnt ? prior.stretch_um : INFINITY;
    show.radius_um = prior.radius_um;
    *ret_show = show;
    return GSN_OK;
}

int gsn_fiducials_are_odd(const struct gsn_fiducial_candidates *sections, size_t count,
                          const struct gsn_point *mark_um, int *ret_odd, struct gsn_error *err)
{
    struct show show;
    const int r = try_burn(sections, count, mark_um, &show, err);

    assert((sections || count == 0) && ret_odd);

    if (r < 0)
        return r;
    *ret_odd = count > 0 &&
               (3 * show.clear < 2 * count ||
                (show.clear < count && (show.radius_um < NEAR_LIMIT * gsn_burn_radius_min_um ||
                                        show.radius_um > gsn_burn_radius_max_um / NEAR_LIMIT)));
    return GSN_OK;
}

int gsn_fiducials_choose_burn(const struct gsn_fiducial_candidates *sections, size_t count,
                              const struct gsn_point *mark_um, unsigned *ret_burn,
                              struct gsn_error *err)
{
    struct show show[GSN_BURNS];
    size_t most = 0;
    unsigned best = 0;

    assert((sections || count == 0) && ret_burn);

    for (unsigned k = 0; k < GSN_BURNS; k++) {
        const int r = try_burn(sections + k * count, count, mark_um, &show[k], err);

        if (r < 0)
            return r;
        most = show[k].clear > most ? show[k].clear : most;
    }
    for (unsigned k = 1; k < GSN_BURNS; k++) {
        const int allowed = 2 * show[k].clear >= count && show[k].clear > show[0].clear;

        if (allowed && 10 * show[k].clear >= 9 * most &&
            (best == 0 || show[k].misfit_um < show[best].misfit_um))
            best = k;
    }
    *ret_burn = best;
    return GSN_OK;
}
