/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_cut.h"

#include <assert.h>
#include <math.h>

/* Lines that are tried: every half cell along the middle half of the way between the centres,
 * turned by up to 45 degrees either way in steps of 3. */
enum { TURNS = 15, MOST_PLACES = 200 };
static const double TURN_RAD = M_PI / 60, PLACES_PER_CELL = 2;

struct shape {
    const struct gsn_component *box;
    uint8_t *cell; /* of the box: 1 inside the piece */
};

static int draw_shape(const struct gsn_components *pieces, size_t piece, struct shape *ret_shape,
                      struct gsn_error *err)
{
    const struct gsn_component *box = &pieces->component[piece];
    uint8_t *cell = gsn_alloc_array((size_t)box->width, (size_t)box->height);

    if (!cell)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while splitting a panel");
    for (size_t i = 0; i < box->area; i++) {
        const uint32_t pixel = pieces->pixel[box->first + i];
        const int x = (int)(pixel % pieces->width), y = (int)(pixel / pieces->width);

        cell[(y - box->y) * box->width + x - box->x] = 1;
    }
    *ret_shape = (struct shape){ box, cell };
    return GSN_OK;
}

static int inside(const struct shape *shape, struct gsn_point at)
{
    const int x = (int)floor(at.x) - shape->box->x, y = (int)floor(at.y) - shape->box->y;

    return x >= 0 && y >= 0 && x < shape->box->width && y < shape->box->height &&
           shape->cell[y * shape->box->width + x];
}

/* Cells of tissue along a line through at, and its ends in tissue; steps of half a cell. */
static int tissue_along(const struct shape *shape, struct gsn_point at, double dx, double dy,
                        struct gsn_point end[2])
{
    const int reach = 2 * (shape->box->width + shape->box->height);
    int count = 0;

    end[0] = end[1] = at;
    for (int i = -reach; i <= reach; i++) {
        const struct gsn_point here = { at.x + 0.5 * i * dx, at.y + 0.5 * i * dy };

        if (!inside(shape, here))
            continue;
        end[count > 0] = here;
        count++;
    }
    return count;
}

int gsn_panel_cut(const struct gsn_components *pieces, size_t piece,
                  const struct gsn_point centre[2], struct gsn_point ret_end[2], double *ret_width,
                  struct gsn_error *err)
{
    const double wx = centre[1].x - centre[0].x, wy = centre[1].y - centre[0].y;
    const double way = hypot(wx, wy);
    const int places = (int)fmin(fmax(ceil(0.5 * way * PLACES_PER_CELL), 1), MOST_PLACES);
    struct shape shape = { 0 };
    double least = INFINITY;
    int r;

    assert(piece < pieces->count && way > 0);

    r = draw_shape(pieces, piece, &shape, err);
    if (r < 0)
        return r;
    for (int p = 0; p <= places; p++)
        for (int t = -TURNS; t <= TURNS; t++) {
            const double share = 0.25 + 0.5 * p / places, turn = t * TURN_RAD;
            const struct gsn_point at = { centre[0].x + share * wx, centre[0].y + share * wy };
            const double nx = (-wy * cos(turn) - wx * sin(turn)) / way;
            const double ny = (wx * cos(turn) - wy * sin(turn)) / way;
            struct gsn_point end[2];
            /* Of equally short ones the straightest, nearest to the middle. */
            const int tissue = tissue_along(&shape, at, nx, ny, end);
            const double cost = tissue + 0.01 * (fabs(share - 0.5) + 0.1 * fabs(turn));

            if (cost < least) {
                least = cost;
                *ret_width = 0.5 * tissue;
                ret_end[0] = end[0];
                ret_end[1] = end[1];
            }
        }
    gsn_free(shape.cell);
    return GSN_OK;
}
