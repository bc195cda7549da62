/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/sequence_parts.h"

#include "pipeline/core/robust.h"
#include "pipeline/register/sequence_texture.h"

/* A first look takes about FIRST_LOOK patches of the whole plane; those on tissue tell nearly all
 * pairs. */
enum { FIRST_LOOK = 10, LEAST_OF_FIRST = 5 };

/* A pair whose first look is below this part of the limit is not looked at again. */
static const double FAR_BELOW = 0.7;

/* Two mounts share this much of their texture at least, and this much more than neighbours of this
 * stack do, in standard deviations of what neighbours share. */
static const struct gsn_sequence_summary WHOLE = { gsn_median, GSN_SEQUENCE_LEAST_PATCHES, 0.38,
                                                   8 };
static const struct gsn_sequence_summary FIRST = { gsn_median, LEAST_OF_FIRST, 0.38, 8 };

/* Pairs far below the limit, which are nearly all, are told by a few of their patches. */
static double shared_if_much(struct gsn_sequence_texture *t, size_t i, size_t j, double least)
{
    const size_t patches = gsn_sequence_texture_patches(t);
    const size_t step = patches / FIRST_LOOK;

    if (step > 1) {
        const double first = gsn_sequence_texture_shared(t, i, j, step, &FIRST);

        if (first < FAR_BELOW * least)
            return first;
    }
    return gsn_sequence_texture_shared(t, i, j, 1, &WHOLE);
}

static void find(struct gsn_sequence_texture *t, const struct gsn_sequence_plane *planes,
                 double usual, double least, struct gsn_sequence *found)
{
    for (size_t i = 0; i < t->n; i++)
        for (size_t j = i + 1; j < t->n && found->count < t->n; j++) {
            const double share = shared_if_much(t, i, j, least);

            if (share > least)
                found->finding[found->count++] =
                    (struct gsn_sequence_finding){ .kind = GSN_SEQUENCE_DUPLICATE,
                                                   .a = planes[i].serial,
                                                   .b = planes[j].serial,
                                                   .evidence = share,
                                                   .usual = usual };
        }
}

int gsn_sequence_find_duplicates(const struct gsn_sequence_plane *planes, size_t n, size_t columns,
                                 size_t rows, struct gsn_sequence *found, struct gsn_error *err)
{
    gsn_auto(gsn_sequence_texture) t = NULL;
    double usual = 0, least = 0;
    int r = gsn_sequence_texture_new(n, columns, rows, &t, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < n; i++)
        gsn_sequence_texture_fill(t, i, planes[i].density);
    r = gsn_sequence_texture_judge(t, &WHOLE, &found->twice_told, &usual, &least, err);
    if (r >= 0 && found->twice_told)
        find(t, planes, usual, least, found);
    return r;
}
