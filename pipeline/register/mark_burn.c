/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/mark_field.h"
#include "pipeline/register/markers.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* Marks within this factor of the smallest or largest that are looked for: some of them are beyond.
 */
static const double NEAR_LIMIT = 1.25;

/* What one kind of burn shows. */
struct show {
    size_t clear;     /* sections with three marks */
    double misfit_um; /* of the typical three on the triangle */
    double radius_um;
};

static int show_of(const struct gsn_mark_candidates *sections, size_t count,
                   const struct gsn_point *mark_um, struct show *ret_show, struct gsn_error *err)
{
    struct gsn_triangle_prior prior = { 0 };
    struct show show = { 0 };
    int r = GSN_OK;

    if (mark_um)
        memcpy(prior.mark_um, mark_um, sizeof prior.mark_um);
    else
        r = gsn_markers_consensus(sections, count, &prior, NULL);
    if (r >= 0)
        r = gsn_markers_learn(sections, count, &prior, err);
    for (size_t i = 0; r >= 0 && i < count; i++) {
        struct gsn_mark mark[GSN_MARKS];

        gsn_markers_choose(&sections[i], &prior, mark, NULL, NULL, NULL);
        show.clear += mark[0].found && mark[1].found && mark[2].found;
    }
    if (r < 0 && r != GSN_E_MARKERS)
        return gsn_fail(err, r, "out of memory while looking for marks");
    show.misfit_um = prior.learnt ? prior.stretch_um : INFINITY;
    show.radius_um = prior.radius_um;
    *ret_show = show;
    return GSN_OK;
}

int gsn_markers_are_odd(const struct gsn_mark_candidates *sections, size_t count,
                        const struct gsn_point *mark_um, int *ret_odd, struct gsn_error *err)
{
    struct show show;
    const int r = show_of(sections, count, mark_um, &show, err);

    assert((sections || count == 0) && ret_odd);

    if (r < 0)
        return r;
    *ret_odd = count > 0 &&
               (3 * show.clear < 2 * count ||
                (show.clear < count && (show.radius_um < NEAR_LIMIT * gsn_mark_radius_least_um ||
                                        show.radius_um > gsn_mark_radius_most_um / NEAR_LIMIT)));
    return GSN_OK;
}

int gsn_markers_burn(const struct gsn_mark_candidates *sections, size_t count,
                     const struct gsn_point *mark_um, unsigned *ret_burn, struct gsn_error *err)
{
    struct show show[GSN_MARK_BURNS];
    size_t most = 0;
    unsigned best = 0;

    assert((sections || count == 0) && ret_burn);

    for (unsigned k = 0; k < GSN_MARK_BURNS; k++) {
        const int r = show_of(sections + k * count, count, mark_um, &show[k], err);

        if (r < 0)
            return r;
        most = show[k].clear > most ? show[k].clear : most;
    }
    for (unsigned k = 1; k < GSN_MARK_BURNS; k++) {
        const int allowed = 2 * show[k].clear >= count && show[k].clear > show[0].clear;

        if (allowed && 10 * show[k].clear >= 9 * most &&
            (best == 0 || show[k].misfit_um < show[best].misfit_um))
            best = k;
    }
    *ret_burn = best;
    return GSN_OK;
}
