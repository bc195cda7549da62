/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: Mahalanobis distances of contrast and radius (their logarithms, of one standard
 * deviation), made likelihood ratios by counting: how many marks of clear sections are at least as
 * unlike, how many other blobs at most (a histogram of eight classes, with one count more than was
 * seen: Laplace's rule of succession).
 *
 * Steps. gsn_appearance_count() adds a clear section, gsn_appearance_learn() makes shares of the
 * counts, and gsn_third_mark_ratio() multiplies the ratio of appearance with that of place: a
 * mixture of three normal densities (ordinary, loose, torn sections) against blobs that lie
 * anywhere.
 *
 * Cannot fail. Cost: nothing. */
#include "pipeline/register/fiducial/appearance.h"

#include <assert.h>
#include <math.h>

/* Burns of one stack differ by a third at most in contrast and radius, two standard deviations. */
static const double ALIKE = 0.15;

/* Share of the picture that the fit of a mark explains, and what is lost when dirt touches it. */
static const double EXPLAINED = 0.9, EXPLAINED_SD = 0.15;

/* Marks of which looks say nothing: half burnt in, half under dirt. They stand against blobs of any
 * looks. */
static const double DISGUISED = 0.02;

double gsn_appearance_distance(const struct gsn_fiducial *mark, double px_um,
                               const struct gsn_triangle_prior *prior)
{
    const double contrast = log(mark->contrast / prior->contrast) / ALIKE;
    const double radius = log(mark->radius_px * px_um / prior->radius_um) / ALIKE;

    return 0.5 * (contrast * contrast + radius * radius);
}

double gsn_appearance_residual(const struct gsn_fiducial *mark)
{
    return pow(fmax(EXPLAINED - mark->score, 0) / EXPLAINED_SD, 2);
}

static int class_of(double unlike)
{
    int k = 0;

    while (k < GSN_APPEARANCE_CLASSES - 1 && unlike > ldexp(1, k))
        k++;
    return k;
}

/* Share of burns that are at least so unlike, as far as none was counted. */
static double expected_share(int k)
{
    return k > 0 ? exp(-0.5 * ldexp(1, k - 1)) : 1;
}

static double unlike_in_all(const struct gsn_fiducial *mark, double px_um,
                            const struct gsn_triangle_prior *prior)
{
    return gsn_appearance_distance(mark, px_um, prior) + gsn_appearance_residual(mark);
}

static double distance_um(const struct gsn_fiducial_candidates *section, struct gsn_point px)
{
    return section->px_um * hypot(px.x - section->tissue_px.x, px.y - section->tissue_px.y);
}

static int is_one_of(const struct gsn_fiducial marks[GSN_FIDUCIALS],
                     const struct gsn_fiducial *blob)
{
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (marks[i].px.x == blob->px.x && marks[i].px.y == blob->px.y)
            return 1;
    return 0;
}

void gsn_appearance_count(const struct gsn_fiducial_candidates *section,
                          const struct gsn_fiducial marks[GSN_FIDUCIALS],
                          const struct gsn_triangle_prior *prior,
                          struct gsn_appearance_counts *counts)
{
    double reach_um = 0;

    assert(section && marks && prior && counts);

    /* Farther out than its marks, a section may show those of its neighbours. */
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        reach_um = fmax(reach_um, distance_um(section, marks[i].px));
        counts->marks += 1;
        for (int k = class_of(unlike_in_all(&marks[i], section->px_um, prior)); k >= 0; k--)
            counts->alike[k] += 1;
    }
    for (size_t i = 0; i < section->count; i++) {
        const struct gsn_fiducial *blob = &section->mark[i];

        if (distance_um(section, blob->px) > reach_um || is_one_of(marks, blob))
            continue;
        for (int k = class_of(unlike_in_all(blob, section->px_um, prior));
             k < GSN_APPEARANCE_CLASSES; k++)
            counts->seen[k] += 1;
    }
    counts->area_um2 += M_PI * reach_um * reach_um;
    counts->sections += 1;
}

/* One blob more than was counted, since none may be seen in a small stack. One of the marks that
 * look so may be the one in question, which does not vouch for itself: one that looks as burns may
 * stands for it. */
void gsn_appearance_learn(const struct gsn_appearance_counts *counts,
                          struct gsn_triangle_prior *prior)
{
    const double area = counts->area_um2;

    assert(counts && prior);

    prior->area_um2 = counts->sections > 0 ? area / counts->sections : 0;
    for (int k = 0; k < GSN_APPEARANCE_CLASSES; k++) {
        const double others = fmax(counts->alike[k] - 1, 0);

        prior->alike[k] = area > 0 ? (others + expected_share(k)) / fmax(counts->marks, 1) : 0;
        prior->chance[k] = area > 0 ? (counts->seen[k] + 1) / area : 0;
    }
}

double gsn_appearance_ratio(const struct gsn_fiducial *mark, double px_um,
                            const struct gsn_triangle_prior *prior)
{
    const int k = class_of(unlike_in_all(mark, px_um, prior));

    assert(prior->learnt);

    return fmax(prior->alike[k] / prior->chance[k],
                DISGUISED / prior->chance[GSN_APPEARANCE_CLASSES - 1]);
}

/* Density per um^2 of places so far away, with this variance per axis. */
static double density_at(double away_um, double variance)
{
    return exp(-0.5 * away_um * away_um / variance) / (2 * M_PI * variance);
}

/* Odds for a blob so far from where a mark belongs. What lays that place has variances of its own,
 * per axis, in an ordinary section and in any other. */
static double ratio_of(const struct gsn_fiducial *blob, double px_um,
                       const struct gsn_triangle_prior *prior, const struct gsn_displacement *moves,
                       double away_um, double ordinary, double other)
{
    const double here =
        moves->ordinary * density_at(away_um, moves->ordinary_um * moves->ordinary_um + ordinary) +
        moves->loose * density_at(away_um, moves->loose_um * moves->loose_um + other) +
        moves->torn * density_at(away_um, moves->torn_um * moves->torn_um + other);

    return GSN_FIDUCIAL_SEEN / (1 - GSN_FIDUCIAL_SEEN) * here *
           gsn_appearance_ratio(blob, px_um, prior);
}

double gsn_third_mark_ratio(const struct gsn_fiducial *blob, double px_um,
                            const struct gsn_triangle_prior *prior,
                            const struct gsn_displacement *moves, double away_um, double apart_um,
                            double across_um)
{
    /* The middle of two has half of their variance; what turns them moves the third by as much more
     * as it is farther away, in one of its two directions. */
    const double carried = 0.5 + pow(across_um / apart_um, 2);

    assert(blob && prior && moves && apart_um > 0);

    return ratio_of(blob, px_um, prior, moves, away_um,
                    carried * moves->ordinary_um * moves->ordinary_um,
                    carried * moves->loose_um * moves->loose_um);
}

double gsn_placed_mark_ratio(const struct gsn_fiducial *blob, double px_um,
                             const struct gsn_triangle_prior *prior,
                             const struct gsn_displacement *moves, double away_um, double error_um)
{
    assert(blob && prior && moves);

    return ratio_of(blob, px_um, prior, moves, away_um, error_um * error_um, error_um * error_um);
}

/* Of marks that are alike, looks say less than this. */
static const double ALIKE_MOST = 3;

/* A blob this much fainter than the third strongest is no mark as long as nothing is learnt... */
static const double FAINTEST = 0.3;

/* ...and afterwards one that differs from the typical mark by more than these factors. A burn may
 * be half burnt in, and half of the rest bleached. */
static const double STRONGER = 2.5, FAINTER = 5, RADIUS_FACTOR = 2;

static double strength_of(const struct gsn_fiducial *mark)
{
    return mark->contrast * mark->score;
}

/* The strength that one of three marks burnt alike reaches, in a section with the marks and maybe a
 * blot of ink or two: the third strongest. */
static double third_strength(const struct gsn_fiducial_candidates *section)
{
    const size_t third = section->count < GSN_FIDUCIALS ? section->count : GSN_FIDUCIALS;

    return third > 0 ? strength_of(&section->mark[third - 1]) : 0;
}

int gsn_appearance_acceptable(const struct gsn_fiducial_candidates *section, size_t i,
                              const struct gsn_triangle_prior *prior)
{
    const struct gsn_fiducial *mark = &section->mark[i];
    const double um = mark->radius_px * section->px_um;

    if (!prior->learnt)
        return strength_of(mark) >= FAINTEST * third_strength(section);
    return mark->contrast <= STRONGER * prior->contrast &&
           strength_of(mark) >= prior->contrast / FAINTER &&
           um <= RADIUS_FACTOR * prior->radius_um && um >= prior->radius_um / RADIUS_FACTOR;
}

static double clipped_distance(const struct gsn_fiducial *mark, double px_um,
                               const struct gsn_triangle_prior *prior)
{
    return fmin(gsn_appearance_distance(mark, px_um, prior), GSN_APPEARANCE_DISTANCE_MAX);
}

double gsn_appearance_sum(const struct gsn_fiducial_candidates *section,
                          const struct gsn_triangle_prior *prior,
                          const int candidate[GSN_FIDUCIALS], double most)
{
    const double third = third_strength(section);
    double sum = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_fiducial *mark;

        if (candidate[i] < 0)
            continue;
        mark = &section->mark[candidate[i]];
        if (prior->learnt)
            sum +=
                fmin(clipped_distance(mark, section->px_um, prior) + gsn_appearance_residual(mark),
                     most);
        else if (third > 0)
            sum += 2 * fmax(1 - strength_of(mark) / third, 0);
    }
    return sum;
}

int gsn_appearance_alike(const struct gsn_fiducial_candidates *section,
                         const struct gsn_triangle_prior *prior, const int candidate[GSN_FIDUCIALS])
{
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        if (candidate[i] >= 0 &&
            clipped_distance(&section->mark[candidate[i]], section->px_um, prior) > ALIKE_MOST)
            return 0;
    return 1;
}
