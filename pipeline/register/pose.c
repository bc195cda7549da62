/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose.h"

#include "pipeline/register/median.h"
#include "pipeline/register/rigid.h"

#include <assert.h>
#include <math.h>
#include <string.h>

enum { FREE = 3, ROUNDS = 100, LEARNING = 3, NUMBERINGS = 6 };

/* Of the chi-squared distribution with 3 degrees of freedom: the median, the value beyond which
 * 0.1 % lie, and the mean of what lies below that. */
static const double CHI2_MEDIAN = 2.365974, CHI2_GROSS = 16.26624, CHI2_MEAN_BELOW = 2.984575;
/* The same 0.1 % with 1 degree of freedom. */
static const double CHI2_GROSS_TWO = 10.82757;
/* No mark of a few pixels is trusted beyond this, in pixels: on clean sections the residuals are so
 * small that a chi-squared test against them alone would call a hundredth of a pixel gross. */
static const double FINEST_PX = 0.1;
/* Sides must differ by this many standard deviations of a mark. */
static const double SCALENE = 10;
/* A mark whose fit is this much poorer than the median's has no say. */
static const double VARIANCE_MOST = 100;

static const unsigned char NUMBERING[NUMBERINGS][GSN_MARKS] = { { 0, 1, 2 }, { 1, 0, 2 },
                                                                { 0, 2, 1 }, { 2, 1, 0 },
                                                                { 1, 2, 0 }, { 2, 0, 1 } };

/* One section while the stack is being solved. */
struct member {
    const struct gsn_pose_input *input;
    size_t marks;
    double variance[GSN_MARKS]; /* of each mark, 1 for the median one; input's numbering */
    int mirrored;
    unsigned char order[GSN_MARKS];
    struct gsn_rigid motion; /* onto the mean triangle */
    double squares;          /* weighted squared residuals; infinite where there is no motion */
    int inlier;
};

struct solution {
    struct member *member;
    size_t count, with_three;
    double *scratch; /* room for 3 * count */
    struct gsn_point triangle[GSN_MARKS];
    double sigma2;          /* variance per axis of the median mark, um^2 */
    double median_variance; /* the same by the fits' own account */
    double finest;          /* FINEST_PX of the median section, um */
    double scalene_sigma;
    int flips_told;
};

double gsn_pose_tre(double fle, double rho, double r)
{
    return fle * sqrt((1 + r * r / (2 * rho * rho)) / GSN_MARKS);
}

static double distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

static struct gsn_point centroid(const struct gsn_point p[GSN_MARKS])
{
    return (struct gsn_point){ (p[0].x + p[1].x + p[2].x) / GSN_MARKS,
                               (p[0].y + p[1].y + p[2].y) / GSN_MARKS };
}

static double rho_of(const struct gsn_point p[GSN_MARKS])
{
    const struct gsn_point c = centroid(p);
    double squares = 0;

    for (int i = 0; i < GSN_MARKS; i++)
        squares += pow(distance(p[i], c), 2);
    return sqrt(squares / GSN_MARKS);
}

static double side(const struct gsn_point p[GSN_MARKS], int i)
{
    return distance(p[i], p[(i + 1) % GSN_MARKS]);
}

/* The marks in um as the pose numbers them, those not found left out; their number. */
static size_t lay_out(const struct member *m, const unsigned char *order, int mirrored,
                      const struct gsn_point *triangle, struct gsn_point *ret_from,
                      struct gsn_point *ret_onto, double *ret_weight)
{
    size_t count = 0;

    for (int i = 0; i < GSN_MARKS; i++) {
        const struct gsn_mark *mark = &m->input->marks[order[i]];
        const double px_um = m->input->px_um;

        if (!mark->found)
            continue;
        ret_from[count] = (struct gsn_point){ mirrored ? -mark->px.x * px_um : mark->px.x * px_um,
                                              mark->px.y * px_um };
        ret_weight[count] = 1 / m->variance[order[i]];
        ret_onto[count++] = triangle[i];
    }
    return count;
}

/* Weighted squared residuals of the best motion under one numbering; infinite when there is none.
 */
static double try_numbering(const struct member *m, const unsigned char *order, int mirrored,
                            const struct gsn_point *triangle, struct gsn_rigid *ret_motion)
{
    struct gsn_point from[GSN_MARKS], onto[GSN_MARKS];
    double weight[GSN_MARKS], rms, sum = 0;
    const size_t count = lay_out(m, order, mirrored, triangle, from, onto, weight);

    if (gsn_rigid_fit(from, onto, weight, count, ret_motion, &rms, NULL) < 0)
        return INFINITY;
    for (size_t i = 0; i < count; i++)
        sum += weight[i];
    return sum * rms * rms;
}

static void adopt(struct member *m, const unsigned char *order, int mirrored,
                  const struct gsn_point *triangle)
{
    memcpy(m->order, order, sizeof m->order);
    m->mirrored = mirrored;
    m->squares = try_numbering(m, order, mirrored, triangle, &m->motion);
}

/* Lays one section of three marks on the triangle, upright or mirrored, whichever is nearer.
 *
 * acceptable (in squares; 0 for not yet) lets other numberings in: in a nearly isosceles triangle
 * the choice of marks could not see the difference that the stack's own precision shows. A section
 * that fits no numbering well keeps the one it came with. */
static void place(struct member *m, const struct gsn_point *triangle, int mirroring,
                  double acceptable)
{
    const int tries = acceptable > 0 ? 2 * NUMBERINGS : 2;

    adopt(m, NUMBERING[0], 0, triangle);
    for (int k = 1; k < tries; k++) {
        const unsigned char *order = NUMBERING[k / 2];
        const int mirrored = k % 2;
        struct gsn_rigid motion;
        double squares;

        if ((mirrored && !mirroring) || (k >= 2 && m->squares <= acceptable))
            continue;
        squares = try_numbering(m, order, mirrored, triangle, &motion);
        if (squares < m->squares && (k < 2 || squares <= acceptable))
            adopt(m, order, mirrored, triangle);
    }
}

/* The near-equal sides meet in one corner; mirroring then looks like swapping the other two. */
static const unsigned char *swap_of(const struct gsn_point *triangle)
{
    int corner = 0;
    double least = INFINITY;

    for (int i = 0; i < GSN_MARKS; i++) {
        const double apart = fabs(side(triangle, i) - side(triangle, (i + 2) % GSN_MARKS));

        if (apart < least) {
            least = apart;
            corner = i;
        }
    }
    return NUMBERING[corner == 0 ? 2 : corner == 1 ? 3 : 1];
}

static void place_two(struct member *m, const struct gsn_point *triangle, int mirroring)
{
    if (m->input->mirrored && !mirroring)
        adopt(m, swap_of(triangle), 0, triangle);
    else
        adopt(m, NUMBERING[0], m->input->mirrored != 0, triangle);
}

/* sigma^2 from the squares of the three-mark sections, 3 degrees of freedom each; the mean triangle
 * itself takes 3 of the stack's. A first guess by the median, then the mean of those that are not
 * gross, corrected for what the limit cuts off. */
static void estimate_noise(struct solution *s)
{
    const double n = (double)s->with_three;
    size_t k = 0;
    double sigma2, limit;

    for (size_t i = 0; i < s->count; i++) {
        if (s->member[i].marks == GSN_MARKS)
            s->scratch[k++] = s->member[i].squares;
    }
    sigma2 = gsn_median(s->scratch, k) / CHI2_MEDIAN;
    for (int round = 0; round < 20; round++) {
        double sum = 0;
        size_t inside = 0;

        limit = CHI2_GROSS * sigma2;
        /* The median has sorted them: the sum runs in one order always. */
        for (size_t i = 0; i < k && s->scratch[i] <= limit; i++) {
            sum += s->scratch[i];
            inside++;
        }
        if (inside == 0)
            break;
        sigma2 = sum / (double)inside / CHI2_MEAN_BELOW;
    }
    limit = CHI2_GROSS * fmax(sigma2, s->finest * s->finest);
    for (size_t i = 0; i < s->count; i++)
        s->member[i].inlier = s->member[i].marks == GSN_MARKS && s->member[i].squares <= limit;
    s->sigma2 = s->with_three > 1 ? sigma2 * n / (n - 1) : 0;
    if (s->with_three < LEARNING)
        s->sigma2 = fmax(s->sigma2, s->median_variance);
}

/* Moves the triangle to the mean of the inliers laid on it; how far its corners went. */
static double update_triangle(struct solution *s)
{
    struct gsn_point mean[GSN_MARKS] = { 0 };
    double weight[GSN_MARKS] = { 0 }, moved = 0;
    struct gsn_rigid back;

    for (size_t k = 0; k < s->count; k++) {
        const struct member *m = &s->member[k];
        struct gsn_point from[GSN_MARKS], onto[GSN_MARKS];
        double w[GSN_MARKS];

        if (!m->inlier)
            continue;
        (void)lay_out(m, m->order, m->mirrored, s->triangle, from, onto, w);
        for (int i = 0; i < GSN_MARKS; i++) {
            const struct gsn_point p = gsn_rigid_apply(&m->motion, from[i]);

            mean[i].x += w[i] * p.x;
            mean[i].y += w[i] * p.y;
            weight[i] += w[i];
        }
    }
    if (weight[0] == 0)
        return 0;
    for (int i = 0; i < GSN_MARKS; i++)
        mean[i] = (struct gsn_point){ mean[i].x / weight[i], mean[i].y / weight[i] };
    /* The mean may be anywhere as a whole: it stays where the triangle was. */
    if (gsn_rigid_fit(mean, s->triangle, NULL, GSN_MARKS, &back, NULL, NULL) < 0)
        return 0;
    for (int i = 0; i < GSN_MARKS; i++) {
        const struct gsn_point p = gsn_rigid_apply(&back, mean[i]);

        moved = fmax(moved, distance(p, s->triangle[i]));
        s->triangle[i] = p;
    }
    return moved;
}

/* How clearly the triangle differs from its mirror image, in standard deviations of a mark. */
static void judge_shape(struct solution *s)
{
    const double a = side(s->triangle, 0), b = side(s->triangle, 1), c = side(s->triangle, 2);
    const double apart = fmin(fmin(fabs(a - b), fabs(b - c)), fabs(c - a));
    const struct gsn_point *p = s->triangle;
    const double area2 =
        fabs((p[1].x - p[0].x) * (p[2].y - p[0].y) - (p[1].y - p[0].y) * (p[2].x - p[0].x));
    const double height = area2 / fmax(fmax(a, b), c);

    s->scalene_sigma = fmin(apart, height) / fmax(sqrt(s->sigma2), s->finest);
    s->flips_told = s->scalene_sigma >= SCALENE;
}

/* The section whose triangle is most like the others': the median of its squared distances is the
 * least. */
static void start_from_medoid(struct solution *s)
{
    double least = INFINITY;
    struct gsn_point best[GSN_MARKS] = { 0 };

    for (size_t i = 0; i < s->count; i++) {
        const struct gsn_point nowhere[GSN_MARKS] = { 0 };
        struct gsn_point own[GSN_MARKS], onto[GSN_MARKS];
        double weight[GSN_MARKS], median;
        size_t k = 0;

        if (s->member[i].marks != GSN_MARKS)
            continue;
        (void)lay_out(&s->member[i], NUMBERING[0], 0, nowhere, own, onto, weight);
        for (size_t j = 0; j < s->count; j++) {
            if (s->member[j].marks != GSN_MARKS)
                continue;
            place(&s->member[j], own, 1, 0);
            s->scratch[k++] = s->member[j].squares;
        }
        median = gsn_median(s->scratch, k);
        if (median < least) {
            least = median;
            memcpy(best, own, sizeof best);
        }
    }
    memcpy(s->triangle, best, sizeof best);
}

static void place_all(struct solution *s, double acceptable)
{
    for (size_t i = 0; i < s->count; i++) {
        struct member *m = &s->member[i];

        if (m->marks == GSN_MARKS)
            place(m, s->triangle, s->flips_told, acceptable);
        else if (m->marks == 2)
            place_two(m, s->triangle, s->flips_told);
    }
}

/* Generalised Procrustes: place, estimate the noise, move the mean triangle, until it rests. */
static void settle(struct solution *s)
{
    double acceptable = 0;

    s->flips_told = 1;
    for (int round = 0; round < ROUNDS; round++) {
        const int told = s->flips_told;
        double moved;

        place_all(s, acceptable);
        estimate_noise(s);
        moved = update_triangle(s);
        judge_shape(s);
        acceptable = CHI2_GROSS * fmax(s->sigma2, s->finest * s->finest);
        if (round > 1 && told == s->flips_told && moved <= 1e-12 * rho_of(s->triangle))
            break;
    }
    place_all(s, acceptable);
    estimate_noise(s);
}

/* Without a protocol's triangle, up is what most sections say. */
static void turn_to_majority(struct solution *s)
{
    size_t mirrored = 0;

    for (size_t i = 0; i < s->count; i++)
        mirrored += s->member[i].marks == GSN_MARKS && s->member[i].mirrored;
    if (2 * mirrored <= s->with_three)
        return;
    for (int i = 0; i < GSN_MARKS; i++)
        s->triangle[i].x = -s->triangle[i].x;
    settle(s);
}

/* The block frame: on the protocol's marks, or else from the triangle itself. */
static int lay_frame(struct solution *s, const struct gsn_point *declared, struct gsn_error *err)
{
    const struct gsn_point c = centroid(s->triangle);
    struct gsn_rigid motion;
    double length = side(s->triangle, 0);
    int r;

    if (declared) {
        r = gsn_rigid_fit(s->triangle, declared, NULL, GSN_MARKS, &motion, NULL, err);
        if (r < 0)
            return r;
    } else {
        motion.cos = (s->triangle[1].x - s->triangle[0].x) / length;
        motion.sin = -(s->triangle[1].y - s->triangle[0].y) / length;
        motion.dx = -(motion.cos * c.x - motion.sin * c.y);
        motion.dy = -(motion.sin * c.x + motion.cos * c.y);
    }
    for (int i = 0; i < GSN_MARKS; i++)
        s->triangle[i] = gsn_rigid_apply(&motion, s->triangle[i]);
    place_all(s, CHI2_GROSS * fmax(s->sigma2, s->finest * s->finest));
    return GSN_OK;
}

/* First and second moments of the targets: all that the mean of TRE^2 over them needs. */
struct targets {
    struct gsn_point mean;
    double square; /* mean squared distance from the origin */
    size_t count;
};

static struct targets targets_of(const struct gsn_pose_options *options)
{
    struct targets t = { .count = options->target_count };

    for (size_t i = 0; i < t.count; i++) {
        const struct gsn_point p = options->targets_um[i];

        t.mean.x += p.x;
        t.mean.y += p.y;
        t.square += p.x * p.x + p.y * p.y;
    }
    if (t.count > 0) {
        t.mean.x /= (double)t.count;
        t.mean.y /= (double)t.count;
        t.square /= (double)t.count;
    }
    return t;
}

/* TRE^2 = sigma^2 (2 / sum w + r^2 / sum w |x - c|^2), which for three marks of weight 1 is the
 * formula of the header; times 1 + 1/M, since the mean triangle has its own error. */
static double predict(const struct solution *s, const struct gsn_point *onto, const double *weight,
                      size_t count, const struct targets *targets)
{
    struct gsn_point c = { 0, 0 };
    double sum = 0, inertia = 0, square;

    for (size_t i = 0; i < count; i++) {
        sum += weight[i];
        c.x += weight[i] * onto[i].x;
        c.y += weight[i] * onto[i].y;
    }
    c.x /= sum;
    c.y /= sum;
    for (size_t i = 0; i < count; i++)
        inertia += weight[i] * pow(distance(onto[i], c), 2);
    if (targets->count > 0)
        square = targets->square - 2 * (c.x * targets->mean.x + c.y * targets->mean.y) + c.x * c.x +
                 c.y * c.y;
    else
        square = pow(rho_of(s->triangle), 2);
    return sqrt(s->sigma2 * (2 / sum + fmax(square, 0) / inertia) *
                (1 + 1 / (double)s->with_three));
}

static struct gsn_pose pose_of(const struct solution *s, const struct member *m,
                               const struct targets *targets)
{
    struct gsn_pose pose = { .state = GSN_POSE_NONE, .order = { 0, 1, 2 } };
    struct gsn_point from[GSN_MARKS], onto[GSN_MARKS];
    double weight[GSN_MARKS], sum = 0;
    const double finest = FINEST_PX * m->input->px_um;
    size_t count;

    if (m->marks < 2 || !isfinite(m->squares))
        return pose;
    count = lay_out(m, m->order, m->mirrored, s->triangle, from, onto, weight);
    pose.state = count == GSN_MARKS ? GSN_POSE_OK : GSN_POSE_TWO_MARKS;
    pose.flipped = m->mirrored;
    memcpy(pose.order, m->order, sizeof pose.order);
    pose.panel_to_block_um = gsn_rigid_to_affine(&m->motion, m->input->px_um, m->mirrored);
    for (size_t i = 0, k = 0; i < GSN_MARKS; i++) {
        if (!m->input->marks[m->order[i]].found)
            continue;
        pose.residual_um[i] = distance(gsn_rigid_apply(&m->motion, from[k]), onto[k]);
        sum += pose.residual_um[i] * pose.residual_um[i];
        k++;
    }
    pose.rms_um = sqrt(sum / (double)count);
    pose.chi2 = m->squares / fmax(s->sigma2, finest * finest);
    pose.gross = pose.chi2 > (count == GSN_MARKS ? CHI2_GROSS : CHI2_GROSS_TWO);
    pose.tre_um = predict(s, onto, weight, count, targets);
    return pose;
}

/* Upright is the block frame itself when the protocol gives it, otherwise the way most sections
 * lie. */
static void mark_rotated(const struct solution *s, int declared, struct gsn_pose *poses)
{
    double x = 1, y = 0;

    if (!declared) {
        x = y = 0;
        for (size_t i = 0; i < s->count; i++) {
            if (poses[i].state != GSN_POSE_NONE) {
                x += s->member[i].motion.cos;
                y += s->member[i].motion.sin;
            }
        }
    }
    for (size_t i = 0; i < s->count; i++) {
        const struct gsn_rigid *motion = &s->member[i].motion;

        poses[i].rotated180 =
            poses[i].state != GSN_POSE_NONE && motion->cos * x + motion->sin * y < 0;
    }
}

static struct gsn_pose_summary summarise(const struct solution *s, const struct gsn_pose *poses,
                                         const struct gsn_point *declared)
{
    struct gsn_pose_summary sum = { .fle_um = sqrt(2 * s->sigma2),
                                    .rho_um = rho_of(s->triangle),
                                    .scale_vs_declared = 1,
                                    .side_ratio = { 1, 1, 1 },
                                    .isosceles_sigma = s->scalene_sigma,
                                    .flips_told = s->flips_told };
    size_t mirrored = 0;

    memcpy(sum.mean_triangle, s->triangle, sizeof sum.mean_triangle);
    for (size_t i = 0; i < s->count; i++) {
        sum.with_three += poses[i].state == GSN_POSE_OK;
        sum.with_two += poses[i].state == GSN_POSE_TWO_MARKS;
        sum.without += poses[i].state == GSN_POSE_NONE;
        sum.flipped += poses[i].flipped != 0;
        mirrored += poses[i].state == GSN_POSE_OK && poses[i].flipped;
    }
    sum.chirality = declared && 2 * mirrored > sum.with_three ? -1 : 1;
    for (int i = 0; declared && i < GSN_MARKS; i++)
        sum.side_ratio[i] = side(s->triangle, i) / side(declared, i);
    if (declared)
        sum.scale_vs_declared = sum.rho_um / rho_of(declared);
    return sum;
}

static int check(const struct gsn_pose_input *inputs, size_t count,
                 const struct gsn_pose_options *options, struct gsn_error *err)
{
    const struct gsn_point *declared = options->markers_um;

    for (size_t i = 0; i < count; i++) {
        if (!(inputs[i].px_um > 0 && isfinite(inputs[i].px_um)))
            return gsn_fail(err, GSN_E_INPUT, "section %u: a pixel of %g um", inputs[i].serial + 1,
                            inputs[i].px_um);
        for (int k = 0; k < GSN_MARKS; k++) {
            const struct gsn_mark *mark = &inputs[i].marks[k];

            if (mark->found && !(isfinite(mark->px.x) && isfinite(mark->px.y)))
                return gsn_fail(err, GSN_E_INPUT, "section %u: the place of mark %d is not finite",
                                inputs[i].serial + 1, k + 1);
        }
    }
    for (int k = 0; declared && k < GSN_MARKS; k++) {
        if (!isfinite(declared[k].x) || !isfinite(declared[k].y))
            return gsn_fail(err, GSN_E_INPUT, "markers_um: the place of mark %d is not finite",
                            k + 1);
        if (side(declared, k) <= 1e-9 * rho_of(declared) || rho_of(declared) == 0)
            return gsn_fail(err, GSN_E_MARKERS, "markers_um: marks %d and %d coincide", k + 1,
                            (k + 1) % GSN_MARKS + 1);
    }
    return GSN_OK;
}

static double fit_variance(const struct gsn_pose_input *input, int mark)
{
    return 0.5 * (input->marks[mark].cov_xx + input->marks[mark].cov_yy) * input->px_um *
           input->px_um;
}

/* Counts marks and weighs them against the median one. */
static void enrol(struct solution *s, const struct gsn_pose_input *inputs)
{
    size_t marks = 0, sections = 0;

    for (size_t i = 0; i < s->count; i++) {
        struct member *m = &s->member[i];

        *m = (struct member){ .input = &inputs[i], .order = { 0, 1, 2 }, .squares = INFINITY };
        for (int k = 0; k < GSN_MARKS; k++) {
            m->marks += inputs[i].marks[k].found != 0;
            if (inputs[i].marks[k].found)
                s->scratch[marks++] = fit_variance(&inputs[i], k);
        }
        s->with_three += m->marks == GSN_MARKS;
    }
    s->median_variance = marks > 0 ? gsn_median(s->scratch, marks) : 0;
    for (size_t i = 0; i < s->count; i++) {
        for (int k = 0; k < GSN_MARKS; k++) {
            const double ratio =
                s->median_variance > 0 ? fit_variance(&inputs[i], k) / s->median_variance : 1;

            /* Half of the error is the burn's own shape, which no fit knows of. */
            s->member[i].variance[k] = fmin(0.5 + 0.5 * ratio, VARIANCE_MOST);
        }
        if (s->member[i].marks >= 2)
            s->scratch[sections++] = FINEST_PX * inputs[i].px_um;
    }
    s->finest = sections > 0 ? gsn_median(s->scratch, sections) : 0;
}

/* With three sides alike, the sections could be turned by a third and nobody would see. */
static int check_shape(const struct solution *s, struct gsn_error *err)
{
    const double a = side(s->triangle, 0), b = side(s->triangle, 1), c = side(s->triangle, 2);
    const double sigma = fmax(sqrt(s->sigma2), s->finest);

    if (fmin(fmin(a, b), c) < SCALENE * sigma)
        return gsn_fail(err, GSN_E_MARKERS, "two of the three marks coincide in most sections");
    if (fmax(fmax(a, b), c) - fmin(fmin(a, b), c) < SCALENE * sigma)
        return gsn_fail(err, GSN_E_MARKERS,
                        "the marks' triangle has sides of %.0f, %.0f and %.0f um, too nearly "
                        "equal to tell which mark is which",
                        a, b, c);
    return GSN_OK;
}

int gsn_pose_solve(const struct gsn_pose_input *inputs, size_t count,
                   const struct gsn_pose_options *options, struct gsn_pose *ret_poses,
                   struct gsn_pose_summary *ret_summary, struct gsn_error *err)
{
    gsn_auto_mem(struct member) member = gsn_alloc_array(count, sizeof *member);
    gsn_auto_mem(double) scratch = gsn_alloc_array(count * GSN_MARKS, sizeof *scratch);
    struct solution s = { .member = member, .count = count, .scratch = scratch };
    struct targets targets;
    int r;

    assert((inputs || count == 0) && options && ret_poses && ret_summary);

    if (!member || !scratch)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the poses of %zu sections", count);
    r = check(inputs, count, options, err);
    if (r < 0)
        return r;
    enrol(&s, inputs);
    if (s.with_three == 0)
        return gsn_fail(err, GSN_E_MARKERS, "none of %zu sections has three marks", count);
    if (options->markers_um)
        memcpy(s.triangle, options->markers_um, sizeof s.triangle);
    else
        start_from_medoid(&s);
    settle(&s);
    if (!options->markers_um)
        turn_to_majority(&s);
    r = check_shape(&s, err);
    if (r >= 0)
        r = lay_frame(&s, options->markers_um, err);
    if (r < 0)
        return r;

    targets = targets_of(options);
    for (size_t i = 0; i < count; i++)
        ret_poses[i] = pose_of(&s, &s.member[i], &targets);
    mark_rotated(&s, options->markers_um != NULL, ret_poses);
    *ret_summary = summarise(&s, ret_poses, options->markers_um);
    return GSN_OK;
}
