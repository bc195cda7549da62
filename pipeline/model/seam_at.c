/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/model/seam_at.h"

#include "pipeline/model/spline_internal.h"

#include <string.h>

/* A bit per corner of a tetrahedron that is not clear of its cloud at u. */
static unsigned unclear_at(const struct gsn_dms *space, size_t tet, const double u[3])
{
    struct gsn_dms_shape shape;
    double lambda[4];

    gsn_dms_shape_of(space, tet, &shape);
    gsn_frame_at(&shape.frame, u, lambda);
    return GSN_DMS_ALL & ~gsn_dms_clear(&shape, lambda);
}

/* The greatest |g| of a face. */
static unsigned top_of(const struct gsn_dms *space, size_t tet, unsigned corner)
{
    return space->sharing == GSN_DMS_SHARED && space->mesh->neighbour[tet][corner] >= 0
               ? space->degree - 1
               : space->degree;
}

/* Whether the box around the knots of a face holds u. */
static int box_holds(const struct gsn_dms *space, size_t tet, unsigned corner, unsigned top,
                     const double u[3])
{
    for (int c = 0; c < 3; c++) {
        int below = 0, above = 0;

        for (unsigned k = 0; k < 4; k++) {
            const size_t first = space->mesh->tet[tet][k] * (space->degree + 1);

            for (unsigned l = 0; k != corner && l <= top; l++) {
                below = below || space->knot[first + l][c] <= u[c];
                above = above || space->knot[first + l][c] >= u[c];
            }
        }
        if (!below || !above)
            return 0;
    }
    return 1;
}

static unsigned corner_towards(const struct gsn_tets *mesh, size_t tet, size_t other)
{
    unsigned k = 0;

    while (k < 3 && mesh->neighbour[tet][k] != (int32_t)other)
        k++;
    return k;
}

/* The faces of one tetrahedron that is the one with the smaller number. */
static void each_face(const struct gsn_dms *space, size_t tet, const double u[3],
                      void (*visit)(void *context, size_t tet, unsigned corner), void *context)
{
    for (unsigned k = 0; k < 4; k++) {
        const int64_t other = space->mesh->neighbour[tet][k];
        const unsigned top = top_of(space, tet, k);

        if ((other < 0 || (size_t)other > tet) && top > 0 && box_holds(space, tet, k, top, u))
            visit(context, tet, k);
    }
}

void gsn_seam_each(const struct gsn_dms *space, size_t home, const double u[3],
                   void (*visit)(void *context, size_t tet, unsigned corner), void *context)
{
    const struct gsn_tets *mesh = space->mesh;
    const unsigned unclear = unclear_at(space, home, u);
    struct gsn_ascent ascent;

    if (unclear == 0)
        return;
    if ((unclear & (unclear - 1)) == 0) {
        const unsigned corner = (unsigned)__builtin_ctz(unclear);
        const int64_t other = mesh->neighbour[home][corner];
        const unsigned back = other < 0 ? 0 : corner_towards(mesh, (size_t)other, home);

        if (other >= 0 && unclear_at(space, (size_t)other, u) == 1u << back) {
            if (top_of(space, home, corner) > 0)
                visit(context, home < (size_t)other ? home : (size_t)other,
                      home < (size_t)other ? corner : back);
            return;
        }
    }
    gsn_ascent_begin(&ascent);
    do {
        (void)gsn_boxtree_at(space->tree, u, gsn_ascent_add, &ascent);
        for (size_t i = 0; i < ascent.count; i++)
            each_face(space, ascent.item[i], u, visit, context);
    } while (gsn_ascent_next(&ascent));
}

struct sum {
    const struct gsn_spline *spline;
    const double *u;
    double *value, *gradient;
};

static void add_face(void *context, size_t tet, unsigned corner)
{
    const struct sum *sum = context;
    const double *const at[3] = { &sum->u[0], &sum->u[1], &sum->u[2] };
    double *slope[3] = { NULL };
    struct gsn_prism prism;
    struct gsn_seam seam;
    int unclear;

    if (!gsn_prism_init(sum->spline->space, tet, corner, &prism))
        return;
    unclear = gsn_prism_at(&prism, sum->u);
    if (unclear < 0)
        return;
    for (int c = 0; sum->gradient && c < 3; c++)
        slope[c] = &sum->gradient[c];
    gsn_seam_init(&seam, sum->spline->space, &prism, sum->spline->control);
    gsn_seam_add(&seam, (unsigned)unclear, at, 1, sum->value, sum->gradient ? slope : NULL);
}

void gsn_spline_add_seams(const struct gsn_spline *spline, size_t home, const double u[3],
                          double *value, double *gradient)
{
    struct sum sum = { spline, u, value, gradient };

    gsn_seam_each(spline->space, home, u, add_face, &sum);
}

/* A row while it grows, ascending. */
struct row {
    const struct gsn_dms *space;
    const double *u;
    size_t room, count;
    uint32_t *control;
    double *value;
    int full;
};

static void put(struct row *row, uint32_t control, double value)
{
    size_t low = 0, high = row->count;

    while (low < high) {
        const size_t middle = (low + high) / 2;

        if (row->control[middle] < control)
            low = middle + 1;
        else
            high = middle;
    }
    if (low < row->count && row->control[low] == control) {
        row->value[low] += value;
        return;
    }
    if (row->count == row->room) {
        row->full = 1;
        return;
    }
    memmove(&row->control[low + 1], &row->control[low], (row->count - low) * sizeof *row->control);
    memmove(&row->value[low + 1], &row->value[low], (row->count - low) * sizeof *row->value);
    row->control[low] = control;
    row->value[low] = value;
    row->count++;
}

/* Derivatives with respect to the c_g of one tetrahedron, by |g| and place. */
struct adjoint {
    double of[GSN_DMS_MAX_DEGREE + 1][GSN_DMS_MAX_FUNCTIONS];
};

/* Hands them down to the control points. */
static void descend(struct row *row, size_t tet, struct adjoint *adjoint)
{
    const struct gsn_dms *space = row->space;
    const uint32_t *id = gsn_dms_control_ids(space, tet), *v = space->mesh->tet[tet];
    const size_t per_cloud = space->degree + 1;

    for (unsigned r = 0; r < space->degree; r++) {
        uint8_t gamma[4] = { (uint8_t)r, 0, 0, 0 };

        do {
            const size_t place = gsn_simplex_place(gamma);
            struct gsn_frame frame;
            double lambda[4];

            if (adjoint->of[r][place] == 0)
                continue;
            gsn_frame_init(&frame, space->knot[v[0] * per_cloud + gamma[0]],
                           space->knot[v[1] * per_cloud + gamma[1]],
                           space->knot[v[2] * per_cloud + gamma[2]],
                           space->knot[v[3] * per_cloud + gamma[3]]);
            gsn_frame_at(&frame, row->u, lambda);
            for (unsigned j = 0; j < 4; j++)
                adjoint->of[r + 1][gsn_simplex_raised[place][j]] +=
                    lambda[j] * adjoint->of[r][place];
        } while (gsn_simplex_next(gamma));
    }
    for (size_t f = 0; f < gsn_dms_functions(space); f++) {
        if (adjoint->of[space->degree][f] != 0)
            put(row, id[f], adjoint->of[space->degree][f]);
    }
}

/* The weights of a face, times sign, for the tetrahedron on one of its sides. */
static void add_side(struct row *row, const struct gsn_prism *prism, size_t tet, double sign,
                     const double *weight)
{
    const uint32_t *v = row->space->mesh->tet[tet];
    struct adjoint adjoint = { { { 0 } } };
    unsigned corner[3] = { 0, 0, 0 };

    for (unsigned m = 0; m < 3; m++) {
        while (v[corner[m]] != prism->vertex[m])
            corner[m]++;
    }
    for (unsigned m = 1; m <= prism->top; m++) {
        uint8_t gamma[4] = { (uint8_t)m, 0, 0, 0 };

        do {
            uint8_t own[4] = { 0 };

            if (gamma[3] != 0)
                continue;
            for (unsigned k = 0; k < 3; k++)
                own[corner[k]] = gamma[k];
            adjoint.of[m][gsn_simplex_place(own)] = sign * *weight++;
        } while (gsn_simplex_next(gamma));
    }
    descend(row, tet, &adjoint);
}

static void add_weights(void *context, size_t tet, unsigned corner)
{
    struct row *row = context;
    double weight[GSN_SEAM_MAX_SETS];
    struct gsn_prism prism;
    struct gsn_seam seam;
    int unclear;

    if (!gsn_prism_init(row->space, tet, corner, &prism))
        return;
    unclear = gsn_prism_at(&prism, row->u);
    if (unclear < 0)
        return;
    gsn_seam_init(&seam, row->space, &prism, NULL);
    gsn_seam_weights(&seam, (unsigned)unclear, row->u, weight);
    add_side(row, &prism, tet, prism.side, weight);
    if (prism.other >= 0)
        add_side(row, &prism, (size_t)prism.other, -prism.side, weight);
}

int gsn_seam_row(const struct gsn_dms *space, size_t home, const double u[3], size_t room,
                 uint32_t *ret_control, double *ret_value, size_t *ret_count)
{
    struct row row = {
        .space = space, .u = u, .room = room, .control = ret_control, .value = ret_value
    };
    struct adjoint adjoint = { { { 1 } } };

    descend(&row, home, &adjoint);
    gsn_seam_each(space, home, u, add_weights, &row);
    *ret_count = row.count;
    return row.full ? GSN_E_LIMIT : GSN_OK;
}
