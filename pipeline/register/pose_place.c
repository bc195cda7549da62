/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/pose_stack.h"

#include "pipeline/core/robust.h"

#include <math.h>
#include <string.h>

enum { NUMBERINGS = 6, MEDOID_MOST = 400 };

static const unsigned char NUMBERING[NUMBERINGS][GSN_MARKS] = { { 0, 1, 2 }, { 1, 0, 2 },
                                                                { 0, 2, 1 }, { 2, 1, 0 },
                                                                { 1, 2, 0 }, { 2, 0, 1 } };

static double distance(struct gsn_point a, struct gsn_point b)
{
    return hypot(a.x - b.x, a.y - b.y);
}

struct gsn_point gsn_pose_centroid(const struct gsn_point p[GSN_MARKS])
{
    return (struct gsn_point){ (p[0].x + p[1].x + p[2].x) / GSN_MARKS,
                               (p[0].y + p[1].y + p[2].y) / GSN_MARKS };
}

double gsn_pose_rho(const struct gsn_point p[GSN_MARKS])
{
    const struct gsn_point c = gsn_pose_centroid(p);
    double squares = 0;

    for (int i = 0; i < GSN_MARKS; i++)
        squares += pow(distance(p[i], c), 2);
    return sqrt(squares / GSN_MARKS);
}

double gsn_pose_side(const struct gsn_point p[GSN_MARKS], int i)
{
    return distance(p[i], p[(i + 1) % GSN_MARKS]);
}

static struct gsn_point in_um(const struct gsn_pose_input *input, int mark, int mirrored)
{
    const struct gsn_point px = input->marks[mark].px;

    return (struct gsn_point){ (mirrored ? -px.x : px.x) * input->px_um, px.y * input->px_um };
}

/* Weighted squared residuals of the best motion under one numbering; infinite when there is none.
 */
static double try_numbering(const struct gsn_pose_member *m, const unsigned char *order,
                            int mirrored, const struct gsn_point *triangle,
                            struct gsn_rigid *ret_motion)
{
    struct gsn_point from[GSN_MARKS], onto[GSN_MARKS];
    double weight[GSN_MARKS], rms, sum = 0;
    size_t count = 0;

    for (int i = 0; i < GSN_MARKS; i++) {
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

static void adopt(struct gsn_pose_member *m, const unsigned char *order, int mirrored)
{
    memcpy(m->order, order, sizeof m->order);
    m->mirrored = mirrored;
    m->squares = try_numbering(m, order, mirrored, m->onto, &m->motion);
}

/* Lays one section of three marks on its triangle, upright or mirrored, whichever is nearer.
 *
 * acceptable (in squares; 0 for not yet) lets other numberings in: in a nearly isosceles triangle
 * the choice of marks could not see the difference that the stack's own precision shows. A section
 * that fits no numbering well keeps the one it came with. */
static void place(struct gsn_pose_member *m, int mirroring, double acceptable)
{
    const int tries = acceptable > 0 ? 2 * NUMBERINGS : 2;

    adopt(m, NUMBERING[0], 0);
    for (int k = 1; k < tries; k++) {
        const unsigned char *order = NUMBERING[k / 2];
        const int mirrored = k % 2;
        struct gsn_rigid motion;
        double squares;

        if ((mirrored && !mirroring) || (k >= 2 && m->squares <= acceptable))
            continue;
        squares = try_numbering(m, order, mirrored, m->onto, &motion);
        if (squares < m->squares && (k < 2 || squares <= acceptable))
            adopt(m, order, mirrored);
    }
}

/* The near-equal sides meet in one corner; mirroring then looks like swapping the other two. */
static const unsigned char *swap_of(const struct gsn_point *triangle)
{
    int corner = 0;
    double least = INFINITY;

    for (int i = 0; i < GSN_MARKS; i++) {
        const double apart =
            fabs(gsn_pose_side(triangle, i) - gsn_pose_side(triangle, (i + 2) % GSN_MARKS));

        if (apart < least) {
            least = apart;
            corner = i;
        }
    }
    return NUMBERING[corner == 0 ? 2 : corner == 1 ? 3 : 1];
}

static void place_two(struct gsn_pose_member *m, int mirroring)
{
    if (m->input->mirrored && !mirroring)
        adopt(m, swap_of(m->onto), 0);
    else
        adopt(m, NUMBERING[0], m->input->mirrored != 0);
}

void gsn_pose_place(struct gsn_pose_stack *s, double acceptable)
{
    for (size_t i = 0; i < s->count; i++) {
        struct gsn_pose_member *m = &s->member[i];

        gsn_axes_at(&s->axes, m->input->serial, s->triangle, m->onto);
        if (m->marks == GSN_MARKS)
            place(m, s->flips_told, acceptable);
        else if (m->marks == 2)
            place_two(m, s->flips_told);
    }
}

/* The section whose triangle is most like the others': the median of its squared distances is the
 * least. Of a long stack every few sections will do, as half of them must agree anyway. */
void gsn_pose_start(struct gsn_pose_stack *s)
{
    const size_t every = s->count / MEDOID_MOST + 1;
    double least = INFINITY;

    for (size_t i = 0; i < s->count; i += every) {
        const struct gsn_pose_member *m = &s->member[i];
        struct gsn_point own[GSN_MARKS];
        double median;
        size_t k = 0;

        if (m->marks != GSN_MARKS)
            continue;
        for (int j = 0; j < GSN_MARKS; j++)
            own[j] = in_um(m->input, j, 0);
        for (size_t j = 0; j < s->count; j += every) {
            if (s->member[j].marks != GSN_MARKS)
                continue;
            memcpy(s->member[j].onto, own, sizeof own);
            place(&s->member[j], 1, 0);
            s->scratch[k++] = s->member[j].squares;
        }
        median = gsn_median(s->scratch, k);
        if (median < least) {
            least = median;
            memcpy(s->triangle, own, sizeof own);
        }
    }
}

static double usable(double variance, double otherwise)
{
    return variance >= 0 && isfinite(variance) ? variance : otherwise;
}

size_t gsn_pose_lay_out(const struct gsn_pose_stack *s, const struct gsn_pose_member *m,
                        struct gsn_pose_fit_input *ret_marks)
{
    double scale;
    const double px2 = m->input->px_um * m->input->px_um, excess = gsn_pose_excess(s, &scale);
    struct gsn_pose_fit_input in = { .about = gsn_pose_centroid(s->triangle) };

    for (int i = 0; i < GSN_MARKS; i++) {
        const struct gsn_mark *mark = &m->input->marks[m->order[i]];
        const double unknown = m->variance[m->order[i]] / px2;
        const double xx = usable(mark->cov_xx, unknown), yy = usable(mark->cov_yy, unknown);
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
