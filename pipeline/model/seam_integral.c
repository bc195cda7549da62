/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The integral over a cell of what a face adds. */
#include "pipeline/model/seam.h"

#include <math.h>
#include <string.h>

/* What is integrated: the polynomial of one leaf over its part in the cell. */
struct part {
    const struct gsn_seam *seam;
    unsigned leaf;
    struct gsn_frame cell; /* all in the axes of the face */
    uint8_t poly[GSN_SEAM_MAX_SETS], rest[GSN_SEAM_MAX_SETS];
};

static double affine_at(const double function[4], const double u[3])
{
    return gsn_dot(function, u) + function[3];
}

/* The jump D_g at u: coefficients of monomials by degree. */
static double jump_at(const double *c, unsigned degree, const double u[3])
{
    double sum = c[0];

    if (degree > 0)
        sum += c[1] * u[0] + c[2] * u[1] + c[3] * u[2];
    if (degree > 1)
        sum += (c[4] * u[0] + c[5] * u[1] + c[6] * u[2]) * u[0] +
               (c[7] * u[1] + c[8] * u[2]) * u[1] + c[9] * u[2] * u[2];
    return sum;
}

/* What M(set) is multiplied by in the sum of the face: downwards from the T_g, each of which brings
 * D_g plane_g, to the leaves. */
static double factor(const struct part *part, unsigned set, const double u[3])
{
    const struct gsn_seam *seam = part->seam;
    const struct gsn_seam_tables *tables = seam->tables;
    const unsigned gamma = tables->gamma[set];
    double sum = 0;

    if (gamma < gsn_seam_sets(seam->prism->top))
        sum = jump_at(&seam->data.poly[part->poly[gamma]], part->rest[gamma], u) *
              affine_at(seam->data.plane[tables->corners[gamma]], u);
    for (unsigned i = set ? tables->parent_end[set - 1] : 0; i < tables->parent_end[set]; i++) {
        const unsigned w = tables->parent[i];
        const double weight = affine_at(seam->data.weight[w], u);

        if (weight != 0)
            sum += weight * factor(part, tables->leaves[1] + tables->weight[w].node, u);
    }
    return sum;
}

/* Where the jumps begin, and their degrees. */
static void find_jumps(struct part *part)
{
    unsigned gamma = 0;
    size_t next = 0;

    for (unsigned m = 1; m <= part->seam->prism->top; m++) {
        const unsigned rest = part->seam->degree - m;

        for (unsigned i = 0; i < (m + 1) * (m + 2) / 2; i++, gamma++) {
            part->poly[gamma] = (uint8_t)next;
            part->rest[gamma] = (uint8_t)rest;
            next += gsn_simplex_count(rest);
        }
    }
}

/* Over a piece that lies in the cell, by rules that are exact for degree 2 (Hammer, Marlowe and
 * Stroud) and 3 (Keast). */
static double integrate(const struct part *part, const double (*corner)[3])
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
        sum += (i == 4 ? -0.8 : cubic ? 0.45 : 0.25) * factor(part, part->leaf, u);
    }
    return volume * sum;
}

/* The integral over the piece's part on the inner side of the cell's faces from this one on. An
 * edge across the plane is cut in two, and the piece with it, until none is. */
static double clip(const struct part *part, unsigned face, const double (*corner)[3])
{
    double lambda[4][4], piece[4][3], at, sum;
    int in = -1, out = -1;

    if (face == 4)
        return integrate(part, corner);
    for (int i = 0; i < 4; i++) {
        gsn_frame_at(&part->cell, corner[i], lambda[i]);
        in = lambda[i][face] > GSN_DMS_SLACK ? i : in;
        out = lambda[i][face] < -GSN_DMS_SLACK ? i : out;
    }
    if (out < 0)
        return clip(part, face + 1, corner);
    if (in < 0)
        return 0;
    at = lambda[in][face] / (lambda[in][face] - lambda[out][face]);
    memcpy(piece, corner, sizeof piece);
    for (int c = 0; c < 3; c++)
        piece[out][c] = corner[in][c] + at * (corner[out][c] - corner[in][c]);
    sum = clip(part, face, (const double(*)[3])piece);
    memcpy(piece[in], piece[out], sizeof *piece);
    memcpy(piece[out], corner[out], sizeof *piece);
    return sum + clip(part, face, (const double(*)[3])piece);
}

/* A bit per face of the cell that a knot lies beyond. */
static unsigned beyond(const struct part *part, const double knot[3])
{
    double lambda[4];
    unsigned faces = 0;

    gsn_frame_at(&part->cell, knot, lambda);
    for (int k = 0; k < 4; k++)
        faces |= (unsigned)(lambda[k] < 0) << k;
    return faces;
}

/* The corners of the cell in the axes of the face. */
static void part_init(struct part *part, const struct gsn_seam *seam, const double (*corner)[3])
{
    double cell[4][3];

    part->seam = seam;
    find_jumps(part);
    for (int k = 0; k < 4; k++) {
        double d[3];

        gsn_subtract(corner[k], seam->prism->origin, d);
        for (int c = 0; c < 3; c++)
            cell[k][c] = gsn_dot(seam->prism->turn[c], d);
    }
    gsn_frame_init(&part->cell, cell[0], cell[1], cell[2], cell[3]);
}

double gsn_seam_integral(struct gsn_seam *seam, const double (*corner)[3])
{
    double knot[GSN_SEAM_MAX_KNOTS][3], sum = 0;
    unsigned off[GSN_SEAM_MAX_KNOTS];
    struct part part;

    gsn_seam_complete(seam);
    part_init(&part, seam, corner);
    for (unsigned i = 0; i < seam->tables->knots; i++) {
        for (int c = 0; c < 3; c++)
            knot[i][c] = seam->prism->at[c][i];
        off[i] = beyond(&part, knot[i]);
    }
    for (unsigned l = 0; l < seam->tables->leaves[1]; l++) {
        const uint8_t *m = seam->tables->leaf[l];
        double own[4][3];

        if (seam->data.leaf[l] == 0 || off[m[0]] & off[m[1]] & off[m[2]] & off[m[3]])
            continue;
        for (int i = 0; i < 4; i++)
            memcpy(own[i], knot[m[i]], sizeof own[i]);
        part.leaf = l;
        sum += seam->data.leaf[l] * clip(&part, 0, (const double(*)[3])own);
    }
    return sum;
}
