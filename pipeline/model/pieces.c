/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The polynomials that a spline consists of, over cells and along lines.
 *
 * Method: on the tetrahedron of each four knots a face adds one polynomial (face_correction.h): the
 * weights of the recurrence from the sets T_g down to those four knots, multiplied out. So the
 * integral over a cell is a sum over these tetrahedra, each clipped to the cell; and along a line
 * s is a sum of polynomials, each on the interval in which the line is in its tetrahedron, of the
 * mesh or of knots.
 *
 * Steps: (1) the polynomial of four knots, and its gradient; (2) its integral over a cell by
 * clipping; (3) along a line the interval, from barycentric coordinates, which are affine in t, and
 * the polynomial there by interpolation in degree + 1 points, which is exact.
 *
 * Failure: none; a flat set of knots counts as 0. A line in a plane of knots may be taken to be on
 * either side of it, or on both: whoever draws moves it off by less than can be seen.
 * Cost: of a line four divisions a tetrahedron it may meet, and a value a degree and one more where
 * it does. */
#include "pipeline/model/pieces.h"

#include "pipeline/model/bpatch.h"
#include "pipeline/model/spline_internal.h"

#include <assert.h>
#include <math.h>
#include <string.h>

/* --- what a face adds, knots by knots --- */

static double affine_at(const double function[4], const double u[3])
{
    return gsn_dot(function, u) + function[3];
}

/* The jump D_g at u: coefficients of monomials by degree; its gradient unless that is NULL. */
static double jump_at(const double *c, unsigned degree, const double u[3], double *ret_gradient)
{
    double sum = c[0];

    for (int i = 0; ret_gradient && i < 3; i++)
        ret_gradient[i] = degree > 0 ? c[1 + i] : 0;
    if (degree > 0)
        sum += c[1] * u[0] + c[2] * u[1] + c[3] * u[2];
    if (degree > 1)
        sum += (c[4] * u[0] + c[5] * u[1] + c[6] * u[2]) * u[0] +
               (c[7] * u[1] + c[8] * u[2]) * u[1] + c[9] * u[2] * u[2];
    if (degree > 1 && ret_gradient) {
        ret_gradient[0] += 2 * c[4] * u[0] + c[5] * u[1] + c[6] * u[2];
        ret_gradient[1] += c[5] * u[0] + 2 * c[7] * u[1] + c[8] * u[2];
        ret_gradient[2] += c[6] * u[0] + c[8] * u[1] + 2 * c[9] * u[2];
    }
    return sum;
}

/* gradient += the gradient of affine * value. */
static void add_product_gradient(const double affine[4], double at, double value,
                                 const double slope[3], double *gradient)
{
    for (int i = 0; i < 3; i++)
        gradient[i] += affine[i] * value + at * slope[i];
}

/* What M(set) is multiplied by in the sum of the face: downwards from the T_g, each of which brings
 * D_g plane_g, to the leaves. Its gradient too unless that is NULL. */
static double set_factor(const struct gsn_face_correction *seam,
                         const struct gsn_jump_places *jumps, unsigned set, const double u[3],
                         double *ret_gradient)
{
    const struct gsn_face_correction_tables *tables = seam->tables;
    const unsigned gamma = tables->gamma[set];
    double slope[3], *const own = ret_gradient ? slope : NULL, sum = 0;

    for (int i = 0; ret_gradient && i < 3; i++)
        ret_gradient[i] = 0;
    if (gamma < gsn_face_correction_sets(seam->prism->top)) {
        const double *plane = seam->data.plane[tables->corners[gamma]];
        const double at = affine_at(plane, u);
        const double jump =
            jump_at(&seam->data.poly[jumps->at[gamma]], jumps->degree[gamma], u, own);

        sum = jump * at;
        if (own)
            add_product_gradient(plane, at, jump, slope, ret_gradient);
    }
    for (unsigned i = set ? tables->parent_end[set - 1] : 0; i < tables->parent_end[set]; i++) {
        const unsigned w = tables->parent[i];
        const double weight = affine_at(seam->data.weight[w], u);
        double above;

        if (weight == 0 && !own)
            continue;
        above = set_factor(seam, jumps, tables->leaves[1] + tables->weight[w].node, u, own);
        sum += weight * above;
        if (own)
            add_product_gradient(seam->data.weight[w], weight, above, slope, ret_gradient);
    }
    return sum;
}

static void find_jumps(const struct gsn_face_correction *seam, struct gsn_jump_places *ret_jumps)
{
    unsigned gamma = 0;
    size_t next = 0;

    for (unsigned m = 1; m <= seam->prism->top; m++) {
        const unsigned rest = seam->degree - m;

        for (unsigned i = 0; i < (m + 1) * (m + 2) / 2; i++, gamma++) {
            ret_jumps->at[gamma] = (uint8_t)next;
            ret_jumps->degree[gamma] = (uint8_t)rest;
            next += gsn_simplex_count(rest);
        }
    }
}

/* --- over a cell --- */

/* What is integrated: the polynomial of one leaf over its part in the cell. */
struct part {
    const struct gsn_face_correction *seam;
    unsigned leaf;
    struct gsn_barycentric cell; /* all in the axes of the face */
    struct gsn_jump_places jumps;
};

/* Over a piece that lies in the cell, by rules that are exact for degree 2 (Hammer, Marlowe and
 * Stroud) and 3 (Keast). */
static double integrate_piece(const struct part *part, const double (*corner)[3])
{
    const int cubic = part->seam->degree == 3;
    const double near = cubic ? 0.5 : (5 + 3 * sqrt(5)) / 20, far = (1 - near) / 3;
    const double volume = fabs(gsn_det(corner[0], corner[1], corner[2], corner[3])) / 6;
    double sum = 0, u[3];

    if (volume == 0)
        return 0;
    for (int i = 0; i < (cubic ? 5 : 4); i++) {
        for (int c = 0; c < 3; c++) {
            const double all = corner[0][c] + corner[1][c] + corner[2][c] + corner[3][c];

            u[c] = i == 4 ? all / 4 : far * all + (near - far) * corner[i][c];
        }
        sum += (i == 4  ? -0.8
                : cubic ? 0.45
                        : 0.25) *
               set_factor(part->seam, &part->jumps, part->leaf, u, NULL);
    }
    return volume * sum;
}

/* The integral over the piece's part on the inner side of the cell's faces from this one on. An
 * edge across the plane is cut in two, and the piece with it, until none is. */
static double clip_integral(const struct part *part, unsigned face, const double (*corner)[3])
{
    double lambda[4][4], piece[4][3], at, sum;
    int in = -1, out = -1;

    if (face == 4)
        return integrate_piece(part, corner);
    for (int i = 0; i < 4; i++) {
        gsn_barycentric_at(&part->cell, corner[i], lambda[i]);
        in = lambda[i][face] > GSN_DMS_SLACK ? i : in;
        out = lambda[i][face] < -GSN_DMS_SLACK ? i : out;
    }
    if (out < 0)
        return clip_integral(part, face + 1, corner);
    if (in < 0)
        return 0;
    at = lambda[in][face] / (lambda[in][face] - lambda[out][face]);
    memcpy(piece, corner, sizeof piece);
    for (int c = 0; c < 3; c++)
        piece[out][c] = corner[in][c] + at * (corner[out][c] - corner[in][c]);
    sum = clip_integral(part, face, (const double(*)[3])piece);
    memcpy(piece[in], piece[out], sizeof *piece);
    memcpy(piece[out], corner[out], sizeof *piece);
    return sum + clip_integral(part, face, (const double(*)[3])piece);
}

/* A bit per face of the cell that a knot lies beyond. */
static unsigned faces_beyond(const struct part *part, const double knot[3])
{
    double lambda[4];
    unsigned faces = 0;

    gsn_barycentric_at(&part->cell, knot, lambda);
    for (int k = 0; k < 4; k++)
        faces |= (unsigned)(lambda[k] < 0) << k;
    return faces;
}

/* The corners of the cell in the axes of the face. */
static void part_init(struct part *part, const struct gsn_face_correction *seam,
                      const double (*corner)[3])
{
    double cell[4][3];

    part->seam = seam;
    find_jumps(seam, &part->jumps);
    for (int k = 0; k < 4; k++) {
        double d[3];

        gsn_subtract(corner[k], seam->prism->origin, d);
        for (int c = 0; c < 3; c++)
            cell[k][c] = gsn_dot(seam->prism->turn[c], d);
    }
    gsn_barycentric_init(&part->cell, cell[0], cell[1], cell[2], cell[3]);
}

double gsn_face_correction_integral(struct gsn_face_correction *seam, const double (*corner)[3])
{
    double knot[GSN_FACE_CORRECTION_MAX_KNOTS][3], sum = 0;
    unsigned off[GSN_FACE_CORRECTION_MAX_KNOTS];
    struct part part;

    gsn_face_correction_complete(seam);
    part_init(&part, seam, corner);
    for (unsigned i = 0; i < seam->tables->knots; i++) {
        for (int c = 0; c < 3; c++)
            knot[i][c] = seam->prism->at[c][i];
        off[i] = faces_beyond(&part, knot[i]);
    }
    for (unsigned l = 0; l < seam->tables->leaves[1]; l++) {
        const uint8_t *m = seam->tables->leaf[l];
        double own[4][3];

        if (seam->data.leaf[l] == 0 || off[m[0]] & off[m[1]] & off[m[2]] & off[m[3]])
            continue;
        for (int i = 0; i < 4; i++)
            memcpy(own[i], knot[m[i]], sizeof own[i]);
        part.leaf = l;
        sum += seam->data.leaf[l] * clip_integral(&part, 0, (const double(*)[3])own);
    }
    return sum;
}

/* --- along a line --- */

/* Shortens the interval to where an affine function at + rise t is not negative. */
static int keep_above(double at, double rise, double *from, double *to)
{
    if (rise > 0)
        *from = fmax(*from, -at / rise);
    else if (rise < 0)
        *to = fmin(*to, -at / rise);
    else if (at < 0)
        return 0;
    return *from < *to;
}

/* Where the line start + t into lies in the tetrahedron of the frame; lambda and rise are its
 * barycentric coordinates at start and by t. */
static int cross_tetrahedron(const struct gsn_barycentric *frame, const double start[3],
                             const double into[3], double lambda[4], double rise[4], double *from,
                             double *to)
{
    gsn_barycentric_at(frame, start, lambda);
    rise[0] = 0;
    for (int k = 1; k < 4; k++) {
        rise[k] = gsn_dot(frame->row[k - 1], into);
        rise[0] -= rise[k];
    }
    for (int k = 0; k < 4; k++) {
        if (!keep_above(lambda[k], rise[k], from, to))
            return 0;
    }
    return 1;
}

/* A polynomial in 0..1 by its values at even places. */
static void interpolate(unsigned degree, const double value[4], double ret[4])
{
    memset(ret, 0, 4 * sizeof *ret);
    ret[0] = value[0];
    if (degree == 1) {
        ret[1] = value[1] - value[0];
    } else if (degree == 2) {
        ret[1] = 4 * (value[1] - value[0]) - (value[2] - value[0]);
        ret[2] = 2 * (value[2] - value[0]) - 4 * (value[1] - value[0]);
    } else {
        const double a = value[1] - value[0], b = value[2] - value[0], c = value[3] - value[0];

        ret[1] = 9 * a - 4.5 * b + c;
        ret[2] = -22.5 * a + 18 * b - 4.5 * c;
        ret[3] = 13.5 * a - 13.5 * b + 4.5 * c;
    }
}

void gsn_tet_line_init(const struct gsn_spline *spline, size_t tet, struct gsn_tet_line *ret_line)
{
    const struct gsn_tets *mesh = spline->space->mesh;
    const uint32_t *v = mesh->tet[tet];

    ret_line->degree = spline->space->degree;
    gsn_barycentric_init(&ret_line->frame, mesh->vertex[v[0]], mesh->vertex[v[1]],
                         mesh->vertex[v[2]], mesh->vertex[v[3]]);
    gsn_spline_bernstein(spline, tet, ret_line->coefficient);
}

int gsn_tet_line_piece(const struct gsn_tet_line *line, const double start[3], const double into[3],
                       double from, double to, int with_slope, struct gsn_line_piece *ret_piece)
{
    double lambda[4], rise[4], value[4], slope[3][4];

    if (!cross_tetrahedron(&line->frame, start, into, lambda, rise, &from, &to))
        return 0;
    for (unsigned i = 0; i <= line->degree; i++) {
        const double t = from + (to - from) * i / line->degree;
        double here[4], gradient[3];

        for (int k = 0; k < 4; k++)
            here[k] = lambda[k] + t * rise[k];
        value[i] = gsn_bernstein_at(line->degree, line->coefficient, &line->frame, here,
                                    with_slope ? gradient : NULL);
        for (int c = 0; with_slope && c < 3; c++)
            slope[c][i] = gradient[c];
    }
    ret_piece->from = from;
    ret_piece->to = to;
    interpolate(line->degree, value, ret_piece->value);
    for (int c = 0; with_slope && c < 3; c++)
        interpolate(line->degree, slope[c], ret_piece->slope[c]);
    return 1;
}

int gsn_face_line_init(const struct gsn_spline *spline, size_t tet, unsigned corner,
                       struct gsn_face_line *ret_line)
{
    const struct gsn_face_correction *seam = &ret_line->seam;

    if (!gsn_prism_init(spline->space, tet, corner, &ret_line->prism))
        return 0;
    gsn_face_correction_init(&ret_line->seam, spline->space, &ret_line->prism, spline->control);
    gsn_face_correction_complete(&ret_line->seam);
    find_jumps(seam, &ret_line->jumps);
    for (unsigned l = 0; l < seam->tables->leaves[1]; l++) {
        double knot[4][3];

        for (int k = 0; k < 4; k++) {
            for (int c = 0; c < 3; c++)
                knot[k][c] = ret_line->prism.at[c][seam->tables->leaf[l][k]];
        }
        if (seam->data.leaf[l] != 0)
            gsn_barycentric_init(&ret_line->leaf[l], knot[0], knot[1], knot[2], knot[3]);
    }
    return 1;
}

/* The polynomial of one leaf on its interval. */
static void fit_leaf(const struct gsn_face_line *line, unsigned l, const double start[3],
                     const double into[3], double from, double to, int with_slope,
                     struct gsn_line_piece *ret_piece)
{
    const unsigned degree = line->seam.degree;
    double value[4], slope[3][4];

    for (unsigned i = 0; i <= degree; i++) {
        const double t = from + (to - from) * i / degree;
        const double u[3] = { start[0] + t * into[0], start[1] + t * into[1],
                              start[2] + t * into[2] };
        double gradient[3];

        value[i] = line->seam.data.leaf[l] *
                   set_factor(&line->seam, &line->jumps, l, u, with_slope ? gradient : NULL);
        for (int c = 0; with_slope && c < 3; c++) {
            /* Back from the axes of the face. */
            slope[c][i] = line->seam.data.leaf[l] * (line->prism.turn[0][c] * gradient[0] +
                                                     line->prism.turn[1][c] * gradient[1] +
                                                     line->prism.turn[2][c] * gradient[2]);
        }
    }
    interpolate(degree, value, ret_piece->value);
    for (int c = 0; with_slope && c < 3; c++)
        interpolate(degree, slope[c], ret_piece->slope[c]);
}

size_t gsn_face_line_pieces(const struct gsn_face_line *line, const double start[3],
                            const double into[3], double from, double to, int with_slope,
                            struct gsn_line_piece ret_piece[GSN_FACE_CORRECTION_MAX_LEAVES])
{
    double away[3], near[3], turned[3], along[3], shift;
    size_t count = 0;

    /* From the point nearest to the face: far away, digits would be lost that thin tetrahedra of
     * knots need. */
    gsn_subtract(start, line->prism.origin, away);
    shift = -gsn_dot(away, into);
    for (int c = 0; c < 3; c++)
        near[c] = away[c] + shift * into[c];
    from -= shift;
    to -= shift;
    for (int i = 0; i < 5; i++) {
        if (!keep_above(gsn_dot(line->prism.inside[i], near) + line->prism.inside[i][3],
                        gsn_dot(line->prism.inside[i], into), &from, &to))
            return 0;
    }
    for (int c = 0; c < 3; c++) {
        turned[c] = gsn_dot(line->prism.turn[c], near);
        along[c] = gsn_dot(line->prism.turn[c], into);
    }
    for (unsigned l = 0; l < line->seam.tables->leaves[1]; l++) {
        double lambda[4], rise[4], in = from, out = to;

        if (line->seam.data.leaf[l] == 0 ||
            !cross_tetrahedron(&line->leaf[l], turned, along, lambda, rise, &in, &out))
            continue;
        fit_leaf(line, l, turned, along, in, out, with_slope, &ret_piece[count]);
        ret_piece[count].from = in + shift;
        ret_piece[count].to = out + shift;
        count++;
    }
    return count;
}
