/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/register/panel_parts.h"

#include <assert.h>

void gsn_panel_place(const struct gsn_layout *layout, unsigned slot, unsigned *ret_row,
                     unsigned *ret_column)
{
    assert(slot < layout->rows * layout->columns);

    if (layout->order == GSN_ORDER_COLUMN) {
        *ret_row = slot % layout->rows;
        *ret_column = slot / layout->rows;
        return;
    }
    *ret_row = slot / layout->columns;
    *ret_column = slot % layout->columns;
    if (layout->order == GSN_ORDER_SNAKE && *ret_row % 2 == 1)
        *ret_column = layout->columns - 1 - *ret_column;
}

unsigned gsn_panel_serial(unsigned panel_number, unsigned slot, const struct gsn_layout *layout)
{
    assert(panel_number >= 1);

    return (panel_number - 1) * layout->rows * layout->columns + slot;
}

int gsn_panel_place_of(const struct gsn_layout *layout, unsigned slot)
{
    unsigned row, column;

    if (slot == GSN_SLOT_UNSAID)
        return GSN_NO_PLACE;
    gsn_panel_place(layout, slot, &row, &column);
    return (int)(row * layout->columns + column);
}

unsigned gsn_panel_slot_at(const struct gsn_layout *layout, int place)
{
    for (unsigned slot = 0; slot < layout->rows * layout->columns; slot++) {
        unsigned row, column;

        gsn_panel_place(layout, slot, &row, &column);
        if ((int)(row * layout->columns + column) == place)
            return slot;
    }
    return 0;
}
