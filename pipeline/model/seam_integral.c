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

/* D_g plane_g where the set is T_g, 0 where it is none. */
static double own_factor(const struct gsn_seam *seam, unsigned set, const double u[3])
{
    const unsigned top = seam->prism->top;
    const double *poly = seam->data.poly;
    unsigned g = 0;

    for (unsigned m = 1; m <= top; m++) {
        const unsigned degree = seam->degree - m;

        for (unsigned i = 0; i < (m + 1) * (m + 2) / 2; i++, g++) {
            if (seam->tables->set[g] == set)
                return jump_at(poly, degree, u) *
                       affine_at(seam->data.plane[seam->tables->corners[g]], u);
            poly += gsn_simplex_count(degree);
        }
    }
    return 0;
}

/* What M(set) is multiplied by in the sum of the face: downwards, from the T_g to the leaves. */
static double factor(const struct gsn_seam *seam, unsigned set, const double u[3])
{
    const struct gsn_seam_tables *tables = seam->tables;
    double sum = own_factor(seam, set, u);

    for (unsigned w = 0; w < tables->weights[1]; w++) {
        const double *weight = seam->data.weight[w];

        if (tables->child[w] != set ||
            (weight[0] == 0 && weight[1] == 0 && weight[2] == 0 && weight[3] == 0))
            continue;
        sum += affine_at(weight, u) * factor(seam, tables->leaves[1] + tables->weight[w].node, u);
    }
    return sum;
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
        sum += (i == 4 ? -0.8 : cubic ? 0.45 : 0.25) * factor(part->seam, part->leaf, u);
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

double gsn_seam_integral(struct gsn_seam *seam, const double (*corner)[3])
{
    const struct gsn_prism *prism = seam->prism;
    struct part part = { .seam = seam };
    double cell[4][3], sum = 0;

    gsn_seam_complete(seam);
    for (int k = 0; k < 4; k++) {
        double d[3];

        gsn_subtract(corner[k], prism->origin, d);
        for (int c = 0; c < 3; c++)
            cell[k][c] = gsn_dot(prism->turn[c], d);
    }
    gsn_frame_init(&part.cell, cell[0], cell[1], cell[2], cell[3]);
    for (unsigned l = 0; l < seam->tables->leaves[1]; l++) {
        double knot[4][3];

        if (seam->data.leaf[l] == 0)
            continue;
        for (int i = 0; i < 4; i++) {
            for (int c = 0; c < 3; c++)
                knot[i][c] = prism->at[c][seam->tables->leaf[l][i]];
        }
        part.leaf = l;
        sum += seam->data.leaf[l] * clip(&part, 0, (const double(*)[3])knot);
    }
    return sum;
}
