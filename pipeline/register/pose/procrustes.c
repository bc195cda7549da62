/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Method: generalised Procrustes analysis of planar triangles (Gower 1975), with weights of marks
 * and numberings of the sections by turns; the noise by the median of chi-squared, then by the mean
 * of the inliers, corrected for what the 0.1 % limit cuts off.
 *
 * Steps of gsn_procrustes_fit(). 1. Every section is aligned with the triangle, upright or
 * mirrored, and, once the noise is known, under other numberings where its own does not fit. 2. The
 * variance of a mark follows from what is left, and which sections are inliers. 3. The triangle
 * moves to the inliers' weighted mean, until it rests. gsn_procrustes_initialise() begins with the
 * medoid: the section most like the others. gsn_procrustes_learn_alike() ends it: which part of a
 * mark's variance is every mark's alike, and which grows with what its own fit says, by the
 * likelihood of the residuals (Akaike's criterion).
 *
 * Cannot fail; a section without a motion has infinite squares. Cost: at most 100 rounds of 2
 * closed-form fits a section. */
#include "pipeline/register/pose/procrustes_internal.h"

#include "pipeline/core/robust.h"
#include "pipeline/register/pose/outlier.h"

#include <math.h>
#include <string.h>

/* ---- one section aligned with the triangle --------------------------------------------------- */

enum { NUMBERINGS = 6, MEDOID_MOST = 400 };

static const unsigned char NUMBERING[NUMBERINGS][GSN_FIDUCIALS] = { { 0, 1, 2 }, { 1, 0, 2 },
                                                                    { 0, 2, 1 }, { 2, 1, 0 },
                                                                    { 1, 2, 0 }, { 2, 0, 1 } };

static double distance_between(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

struct gsn_point gsn_triangle_centroid(const struct gsn_point p[GSN_FIDUCIALS])
{
    return (struct gsn_point){ (p[0].x + p[1].x + p[2].x) / GSN_FIDUCIALS,
                               (p[0].y + p[1].y + p[2].y) / GSN_FIDUCIALS };
}

double gsn_triangle_rho(const struct gsn_point p[GSN_FIDUCIALS])
{
    const struct gsn_point c = gsn_triangle_centroid(p);
    double squares = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++)
        squares += pow(distance_between(p[i], c), 2);
    return sqrt(squares / GSN_FIDUCIALS);
}

double gsn_triangle_side(const struct gsn_point p[GSN_FIDUCIALS], int i)
{
    return distance_between(p[i], p[(i + 1) % GSN_FIDUCIALS]);
}

void gsn_axes_at(const struct gsn_axes *axes, double serial, const struct gsn_point triangle[3],
                 struct gsn_point ret_onto[3])
{
    const double from = serial - axes->middle;
    const double share = axes->bent ? pow(from / axes->half, 2) : 0;
    const double along = axes->slanted || axes->bent ? from : 0;

    for (int i = 0; i < 3; i++) {
        ret_onto[i].x = triangle[i].x + along * axes->slope[i].x;
        ret_onto[i].y = triangle[i].y + along * axes->slope[i].y;
        if (axes->bent) {
            ret_onto[i].x += share * axes->bend[i].x;
            ret_onto[i].y += share * axes->bend[i].y;
        }
    }
}

static struct gsn_point in_um(const struct gsn_pose_input *input, int mark, int mirrored)
{
    const struct gsn_point px = input->marks[mark].px;

    return (struct gsn_point){ (mirrored ? -px.x : px.x) * input->px_um, px.y * input->px_um };
}

/* Weighted squared residuals of the best motion under one numbering; infinite when there is none.
 */
static double try_numbering(const struct gsn_procrustes_member *m, const unsigned char *order,
                            int mirrored, const struct gsn_point *triangle,
                            struct gsn_rigid *ret_motion)
{
    struct gsn_point from[GSN_FIDUCIALS], onto[GSN_FIDUCIALS];
    double weight[GSN_FIDUCIALS], rms, sum = 0;
    size_t count = 0;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        if (!m->input->marks[order[i]].found)
            continue;
        from[count] = in_um(m->input, order[i], mirrored);
        weight[count] = 1 / m->variance[order[i]];
        onto[count++] = triangle[i];
    }
    if (gsn_rigid_fit(from, onto, weight, count, ret_motion, &rms, NULL) < 0)
        return INFINITY;
    for (size_t i = 0; i < count; i++)
        sum += weight[i];
    return sum * rms * rms;
}

static void adopt_numbering(struct gsn_procrustes_member *m, const unsigned char *order,
                            int mirrored)
{
    memcpy(m->order, order, sizeof m->order);
    m->mirrored = mirrored;
    m->squares = try_numbering(m, order, mirrored, m->onto, &m->motion);
}

/* Aligns one section of three marks with its triangle, upright or mirrored, whichever is nearer.
 *
 * acceptable (in squares; 0 for not yet) lets other numberings in: in a nearly isosceles triangle
 * the choice of marks could not see the difference that the stack's own precision shows. A section
 * that fits no numbering well keeps the one it came with. */
static void align_three(struct gsn_procrustes_member *m, int mirroring, double acceptable)
{
    const int tries = acceptable > 0 ? 2 * NUMBERINGS : 2;

    adopt_numbering(m, NUMBERING[0], 0);
    for (int k = 1; k < tries; k++) {
        const unsigned char *order = NUMBERING[k / 2];
        const int mirrored = k % 2;
        struct gsn_rigid motion;
        double squares;

        if ((mirrored && !mirroring) || (k >= 2 && m->squares <= acceptable))
            continue;
        squares = try_numbering(m, order, mirrored, m->onto, &motion);
        if (squares < m->squares && (k < 2 || squares <= acceptable))
            adopt_numbering(m, order, mirrored);
    }
}

/* The near-equal sides meet in one corner; mirroring then looks like swapping the other two. */
static const unsigned char *swap_of(const struct gsn_point *triangle)
{
    int corner = 0;
    double least = INFINITY;

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const double apart = fabs(gsn_triangle_side(triangle, i) -
                                  gsn_triangle_side(triangle, (i + 2) % GSN_FIDUCIALS));

        if (apart < least) {
            least = apart;
            corner = i;
        }
    }
    return NUMBERING[corner == 0 ? 2 : corner == 1 ? 3 : 1];
}

static void align_two(struct gsn_procrustes_member *m, int mirroring)
{
    if (m->input->mirrored && !mirroring)
        adopt_numbering(m, swap_of(m->onto), 0);
    else
        adopt_numbering(m, NUMBERING[0], m->input->mirrored != 0);
}

void gsn_procrustes_align(struct gsn_procrustes *s, double acceptable)
{
    for (size_t i = 0; i < s->count; i++) {
        struct gsn_procrustes_member *m = &s->member[i];

        gsn_axes_at(&s->axes, m->input->serial, s->triangle, m->onto);
        if (m->marks == GSN_FIDUCIALS)
            align_three(m, s->flips_told, acceptable);
        else if (m->marks == 2)
            align_two(m, s->flips_told);
    }
}

/* The section whose triangle is most like the others': the median of its squared distances is the
 * least. Of a long stack every few sections will do, as half of them must agree anyway. */
void gsn_procrustes_initialise(struct gsn_procrustes *s)
{
    const size_t every = s->count / MEDOID_MOST + 1;
    double least = INFINITY;

    for (size_t i = 0; i < s->count; i += every) {
        const struct gsn_procrustes_member *m = &s->member[i];
        struct gsn_point own[GSN_FIDUCIALS];
        double median;
        size_t k = 0;

        if (m->marks != GSN_FIDUCIALS)
            continue;
        for (int j = 0; j < GSN_FIDUCIALS; j++)
            own[j] = in_um(m->input, j, 0);
        for (size_t j = 0; j < s->count; j += every) {
            if (s->member[j].marks != GSN_FIDUCIALS)
                continue;
            memcpy(s->member[j].onto, own, sizeof own);
            align_three(&s->member[j], 1, 0);
            s->scratch[k++] = s->member[j].squares;
        }
        median = gsn_median(s->scratch, k);
        if (median < least) {
            least = median;
            memcpy(s->triangle, own, sizeof own);
        }
    }
}

static double usable_variance(double variance, double otherwise)
{
    return variance >= 0 && isfinite(variance) ? variance : otherwise;
}

size_t gsn_procrustes_observation(const struct gsn_procrustes *s,
                                  const struct gsn_procrustes_member *m,
                                  struct gsn_pose_fit_input *ret_marks)
{
    double scale;
    const double px2 = m->input->px_um * m->input->px_um, excess = gsn_procrustes_excess(s, &scale);
    struct gsn_pose_fit_input in = { .about = gsn_triangle_centroid(s->triangle) };

    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_fiducial *mark = &m->input->marks[m->order[i]];
        const double unknown = m->variance[m->order[i]] / px2;
        const double xx = usable_variance(mark->cov_xx, unknown),
                     yy = usable_variance(mark->cov_yy, unknown);
        const double xy = isfinite(mark->cov_xy) ? mark->cov_xy : 0;

        if (!mark->found)
            continue;
        in.from[in.count] = in_um(m->input, m->order[i], m->mirrored);
        in.onto[in.count] = m->onto[i];
        in.cov[in.count++] =
            (struct gsn_cov2){ excess + scale * px2 * xx, scale * px2 * (m->mirrored ? -xy : xy),
                               excess + scale * px2 * yy };
    }
    memcpy(in.strain, s->strain, sizeof in.strain);
    *ret_marks = in;
    return in.count;
}

/* ---- the noise, and the triangle ------------------------------------------------------------- */

enum { ROUNDS = 100, LEARNING = 3, SHARES = 4, RELAXING = 4 };

/* Of the chi-squared distribution with 3 degrees of freedom: the median, and the mean of what lies
 * below the 0.1 % limit. */
static const double CHI2_MEDIAN = 2.365974, CHI2_MEAN_BELOW = 2.984575;

/* The median with 2 degrees of freedom. */
static const double CHI2_MEDIAN_2 = 1.386294;

/* No mark of a few pixels is trusted beyond this, in pixels: on clean sections the residuals are so
 * small that a chi-squared test against them alone would call a hundredth of a pixel gross. */
static const double FINEST_PX = 0.1;

/* A mark whose fit gives no variance at all counts as this much poorer than the median one. */
static const double VARIANCE_UNKNOWN = 100;

/* Rounding of the marks' places, in pixels. */
static const double ROUNDING_PX = 1e-7;

static double fit_variance(const struct gsn_pose_input *input, int mark)
{
    return 0.5 * (input->marks[mark].cov_xx + input->marks[mark].cov_yy) * input->px_um *
           input->px_um;
}

static double rounding_um2(const struct gsn_procrustes *s)
{
    return s->finest * pow(ROUNDING_PX / FINEST_PX, 2);
}

/* The median mark's variance is what the residuals say. A part of it is every mark's alike (the
 * burn's own shape), the rest in proportion to what each mark's fit says. Unless the stack tells
 * the parts, what is alike is what the median mark has more than its fit says; where it has less,
 * the fits exaggerate. */
double gsn_procrustes_excess(const struct gsn_procrustes *s, double *ret_scale)
{
    const double alike =
        s->alike < 0 ? fmax(1 - s->fit_um2 / fmax(s->mark_um2, 1e-300), 0) : s->alike;

    *ret_scale = s->fit_um2 > 0 ? (1 - alike) * s->mark_um2 / s->fit_um2 : 1;
    return alike * s->mark_um2 + rounding_um2(s);
}

static void weigh_marks(struct gsn_procrustes *s)
{
    double scale;
    const double excess = gsn_procrustes_excess(s, &scale);

    for (size_t i = 0; i < s->count; i++)
        for (int k = 0; k < GSN_FIDUCIALS; k++) {
            const double own = fit_variance(s->member[i].input, k);

            s->member[i].variance[k] = own >= 0 && isfinite(own)
                                           ? excess + scale * own
                                           : VARIANCE_UNKNOWN * (excess + scale * s->fit_um2);
        }
}

void gsn_procrustes_add_observations(struct gsn_procrustes *s, const struct gsn_pose_input *inputs)
{
    size_t marks = 0, sections = 0;

    for (size_t i = 0; i < s->count; i++) {
        struct gsn_procrustes_member *m = &s->member[i];

        *m = (struct gsn_procrustes_member){ .input = &inputs[i],
                                             .order = { 0, 1, 2 },
                                             .squares = INFINITY };
        for (int k = 0; k < GSN_FIDUCIALS; k++) {
            const double own = fit_variance(&inputs[i], k);

            m->marks += inputs[i].marks[k].found != 0;
            if (inputs[i].marks[k].found && own >= 0 && isfinite(own))
                s->scratch[marks++] = own;
        }
        s->with_three += m->marks == GSN_FIDUCIALS;
    }
    s->fit_um2 = marks > 0 ? gsn_median(s->scratch, marks) : 0;
    for (size_t i = 0; i < s->count; i++)
        if (s->member[i].marks >= 2)
            s->scratch[sections++] = pow(FINEST_PX * inputs[i].px_um, 2);
    s->finest = sections > 0 ? gsn_median(s->scratch, sections) : 0;
    s->mark_um2 = fmax(s->fit_um2, s->finest);
    s->freedom = INFINITY;
    weigh_marks(s);
}

double gsn_procrustes_acceptable(const struct gsn_procrustes *s)
{
    return GSN_POSE_CHI2_GROSS * fmax(1, s->finest / fmax(s->mark_um2, 1e-300));
}

/* The marks' variance from the squares of the three-mark sections, 3 degrees of freedom each; the
 * mean triangle itself takes 3 of the stack's. A first guess by the median, then the mean of those
 * that are not gross, corrected for what the limit cuts off. */
static void estimate_noise(struct gsn_procrustes *s)
{
    const double n = (double)s->with_three;
    double factor, limit;
    size_t k = 0;

    for (size_t i = 0; i < s->count; i++)
        if (s->member[i].marks == GSN_FIDUCIALS)
            s->scratch[k++] = s->member[i].squares;
    gsn_sort(s->scratch, k);
    factor = gsn_median(s->scratch, k) / CHI2_MEDIAN;
    for (int round = 0; round < 20; round++) {
        double sum = 0;
        size_t inside = 0;

        limit = GSN_POSE_CHI2_GROSS * factor;
        /* They are sorted: the sum runs in one order always. */
        for (size_t i = 0; i < k && s->scratch[i] <= limit; i++) {
            sum += s->scratch[i];
            inside++;
        }
        if (inside == 0)
            break;
        factor = sum / (double)inside / CHI2_MEAN_BELOW;
    }
    limit = GSN_POSE_CHI2_GROSS * fmax(factor, s->finest / fmax(s->mark_um2, 1e-300));
    for (size_t i = 0; i < s->count; i++)
        s->member[i].inlier = s->member[i].marks == GSN_FIDUCIALS && s->member[i].squares <= limit;
    /* Never 0, from where no factor leads away. */
    s->mark_um2 = fmax(s->with_three > 1 ? s->mark_um2 * factor * n / (n - 1) : 0, rounding_um2(s));
    s->freedom = 3 * (n - 1);
    if (s->with_three < LEARNING) {
        s->mark_um2 = fmax(s->mark_um2, s->fit_um2);
        s->freedom = INFINITY;
    }
    weigh_marks(s);
}

/* Moves the triangle to the mean of the inliers laid on it; how far its corners went. */
static double update_triangle(struct gsn_procrustes *s)
{
    struct gsn_point mean[GSN_FIDUCIALS] = { 0 };
    double weight[GSN_FIDUCIALS] = { 0 }, moved = 0;
    struct gsn_rigid back;

    for (size_t k = 0; k < s->count; k++) {
        const struct gsn_procrustes_member *m = &s->member[k];
        struct gsn_pose_fit_input laid;

        if (!m->inlier)
            continue;
        (void)gsn_procrustes_observation(s, m, &laid);
        for (int i = 0; i < GSN_FIDUCIALS; i++) {
            const struct gsn_point p = gsn_rigid_apply(&m->motion, laid.from[i]);
            const double w = 1 / m->variance[m->order[i]];

            mean[i].x += w * (p.x - m->onto[i].x);
            mean[i].y += w * (p.y - m->onto[i].y);
            weight[i] += w;
        }
    }
    if (weight[0] == 0)
        return 0;
    for (int i = 0; i < GSN_FIDUCIALS; i++)
        mean[i] = (struct gsn_point){ s->triangle[i].x + mean[i].x / weight[i],
                                      s->triangle[i].y + mean[i].y / weight[i] };
    /* The mean may be anywhere as a whole: it stays where the triangle was. */
    if (gsn_rigid_fit(mean, s->triangle, NULL, GSN_FIDUCIALS, &back, NULL, NULL) < 0)
        return 0;
    for (int i = 0; i < GSN_FIDUCIALS; i++) {
        const struct gsn_point p = gsn_rigid_apply(&back, mean[i]);

        moved = fmax(moved, hypot(p.x - s->triangle[i].x, p.y - s->triangle[i].y));
        s->triangle[i] = p;
    }
    return moved;
}

/* Variance of a mark per axis by the shapes alone, whatever their size: 2 degrees of freedom a
 * section. A section that has swollen is no more like its mirror image. */
static double shape_um2(const struct gsn_procrustes *s)
{
    const struct gsn_point about = gsn_triangle_centroid(s->triangle);
    size_t n = 0;

    for (size_t k = 0; k < s->count; k++) {
        const struct gsn_procrustes_member *m = &s->member[k];
        struct gsn_pose_fit_input laid;
        double square = 0, along = 0, length = 0;

        if (m->marks != GSN_FIDUCIALS || !isfinite(m->squares))
            continue;
        (void)gsn_procrustes_observation(s, m, &laid);
        for (int i = 0; i < GSN_FIDUCIALS; i++) {
            const struct gsn_point p = gsn_rigid_apply(&m->motion, laid.from[i]);
            const double x = p.x - laid.onto[i].x, y = p.y - laid.onto[i].y;
            const double ux = laid.onto[i].x - about.x, uy = laid.onto[i].y - about.y;

            square += x * x + y * y;
            along += x * ux + y * uy;
            length += ux * ux + uy * uy;
        }
        s->scratch[n++] = fmax(square - along * along / length, 0);
    }
    return n > 0 ? gsn_median(s->scratch, n) / CHI2_MEDIAN_2 : INFINITY;
}

/* How clearly the triangle differs from its mirror image, in standard deviations of a mark. */
static void judge_shape(struct gsn_procrustes *s)
{
    const double noise = fmin(s->mark_um2, shape_um2(s));
    const double a = gsn_triangle_side(s->triangle, 0), b = gsn_triangle_side(s->triangle, 1),
                 c = gsn_triangle_side(s->triangle, 2);
    const double apart = fmin(fmin(fabs(a - b), fabs(b - c)), fabs(c - a));
    const struct gsn_point *p = s->triangle;
    const double area2 =
        fabs((p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[1].y - p[0].y) * (p[2].x - p[0].x));
    const double height = area2 / fmax(fmax(a, b), c);

    s->scalene_sigma = fmin(apart, height) / sqrt(fmax(noise, s->finest));
    s->flips_told = s->scalene_sigma >= GSN_POSE_SCALENE;
}

/* Align, estimate the noise, move the mean triangle, until it rests. */
static void iterate_procrustes(struct gsn_procrustes *s)
{
    double acceptable = 0;

    s->flips_told = 1;
    for (int round = 0; round < ROUNDS; round++) {
        const int told = s->flips_told;
        double moved;

        gsn_procrustes_align(s, acceptable);
        estimate_noise(s);
        moved = update_triangle(s);
        judge_shape(s);
        acceptable = gsn_procrustes_acceptable(s);
        if (round > 1 && told == s->flips_told && moved <= 1e-12 * gsn_triangle_rho(s->triangle))
            break;
    }
    gsn_procrustes_align(s, acceptable);
    estimate_noise(s);
}

void gsn_procrustes_fit(struct gsn_procrustes *s)
{
    s->alike = -1;
    iterate_procrustes(s);
}

/* ---- what marks have alike ------------------------------------------------------------------- */

/* Twice the negative logarithm of the residuals' likelihood, what the motions take of them left
 * out; a gross section counts as one that is just not. ret_mean: of chi-squared of the others. */
static double find_deviance(const struct gsn_procrustes *s, double *ret_mean)
{
    double deviance = 0, sum = 0, n = 0;

    for (size_t i = 0; i < s->count; i++) {
        const struct gsn_procrustes_member *m = &s->member[i];
        struct gsn_pose_fit_input marks;
        struct gsn_pose_fit fit;

        if (m->marks != GSN_FIDUCIALS || !isfinite(m->squares))
            continue;
        (void)gsn_procrustes_observation(s, m, &marks);
        if (gsn_pose_fit(&marks, &fit, NULL) < 0)
            continue;
        deviance += fit.log_det + fmin(fit.chi2, GSN_POSE_CHI2_GROSS);
        if (fit.chi2 < GSN_POSE_CHI2_GROSS) {
            sum += fit.chi2;
            n += 1;
        }
    }
    *ret_mean = n > 0 ? sum / n : CHI2_MEAN_BELOW;
    return deviance;
}

void gsn_procrustes_learn_alike(struct gsn_procrustes *s)
{
    double mean, least, best = s->alike, best_um2 = s->mark_um2;

    if (s->with_three < GSN_ROBUST_COVARIANCE_MIN || s->fit_um2 <= rounding_um2(s))
        return;
    least = find_deviance(s, &mean) - 2;
    for (int k = 1; k < SHARES; k++) {
        double deviance;

        s->alike = (double)k / SHARES;
        for (int round = 0; round < RELAXING; round++) {
            (void)find_deviance(s, &mean);
            s->mark_um2 = fmax(s->mark_um2 * mean / CHI2_MEAN_BELOW, rounding_um2(s));
        }
        deviance = find_deviance(s, &mean);
        if (deviance < least) {
            least = deviance;
            best = s->alike;
            best_um2 = s->mark_um2;
        }
    }
    s->alike = best;
    s->mark_um2 = best_um2;
    weigh_marks(s);
}
