/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_grid.h"

#include "pipeline/core/mem.h"
#include "pipeline/register/panel_grid_parts.h"

#include <assert.h>
#include <math.h>

/* What a hand is off, in sizes of a section and along each axis: most sections lie within a quarter
 * of their own size, and half a pitch is three times that. */
static const double HAND = 0.25;

struct gsn_point gsn_panel_grid_centre(const struct gsn_panel_grid *grid, int place)
{
    const double x = (double)((unsigned)place % grid->columns) * grid->pitch_x;
    const double y = (double)((unsigned)place / grid->columns) * grid->pitch_y;
    const double c = cos(grid->turn), s = sin(grid->turn);

    return (struct gsn_point){ grid->first.x + c * x - s * y, grid->first.y + s * x + c * y };
}

int gsn_panel_grid_place(const struct gsn_panel_grid *grid, struct gsn_point at)
{
    const double dx = at.x - grid->first.x, dy = at.y - grid->first.y;
    const double c = cos(grid->turn), s = sin(grid->turn);
    const double column = round((c * dx + s * dy) / grid->pitch_x);
    const double row = round((c * dy - s * dx) / grid->pitch_y);

    if (!(column >= 0 && column < grid->columns && row >= 0 && row < grid->rows))
        return GSN_NO_PLACE;
    return (int)row * (int)grid->columns + (int)column;
}

/* All answers, one for each pair of axes that are worth a look. */
static int find_answers(const struct gsn_grid_problem *p, const struct gsn_grid_axis *by_x,
                        size_t count_x, const struct gsn_grid_axis *by_y, size_t count_y,
                        struct gsn_grid_answer *answers, struct gsn_error *err)
{
    for (size_t i = 0; i < count_x; i++)
        for (size_t k = 0; k < count_y; k++) {
            struct gsn_grid_answer *a = &answers[i * count_y + k];
            int r;

            a->grid = (struct gsn_panel_grid){ .rows = p->ground->rows,
                                               .columns = p->ground->columns,
                                               .first = { by_x[i].first, by_y[k].first },
                                               .pitch_x = by_x[i].pitch,
                                               .pitch_y = by_y[k].pitch };
            r = gsn_grid_settle(p, a, err);
            if (r < 0)
                return r;
        }
    return GSN_OK;
}

int gsn_panel_grid_fit(const struct gsn_point *centre, size_t count,
                       const struct gsn_panel_ground *ground, struct gsn_panel_grid *ret_grid,
                       struct gsn_panel_seat *ret_seat, struct gsn_error *err)
{
    const struct gsn_grid_problem p = { centre, count, ground, HAND * ground->size };
    struct gsn_grid_axis by_x[GSN_GRID_AXES] = { 0 }, by_y[GSN_GRID_AXES] = { 0 };
    size_t count_x, count_y;
    gsn_auto_mem(struct gsn_grid_answer) answers = NULL;
    gsn_auto_mem(int) places = NULL;
    int r;

    assert(centre && count > 0 && ground->rows > 0 && ground->columns > 0 && ground->size > 0);

    count_x = gsn_grid_axes(&p, 1, by_x);
    count_y = gsn_grid_axes(&p, 0, by_y);
    answers = gsn_alloc_array(count_x * count_y, sizeof *answers);
    places = gsn_alloc_array(count_x * count_y * count, sizeof *places);
    if (!answers || !places)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the slots of a panel");
    if (count_x == 0 || count_y == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "sections of %.0f x %.0f of this picture leave no room for %u x %u slots: "
                        "correct \"layout\" or \"px_um\" in job.json",
                        ground->size, ground->size, ground->rows, ground->columns);
    for (size_t k = 0; k < count_x * count_y; k++)
        answers[k].place = places + k * count;
    r = find_answers(&p, by_x, count_x, by_y, count_y, answers, err);
    return r < 0 ? r : gsn_grid_choose(&p, answers, count_x * count_y, ret_grid, ret_seat, err);
}
