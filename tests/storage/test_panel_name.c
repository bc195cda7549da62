/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/panel_log.h"

#include <string.h>

#include "tests/check.h"

static const struct {
    const char *name, *specimen;
    unsigned number, called;
} cases[] = { { "GVP-D-S02-P01.tif", "", 1, 1 },
              { "GVP-D-S02-P10.tif", "", 10, 10 },
              { "panel 3.png", "", 3, 3 },
              { "panel-12 of 40.png", "", 12, 12 },
              { "Panel_7_rescan2.jpg", "", 7, 7 },
              { "1.tif", "", 1, 0 },
              { "10.tif", "", 10, 0 },
              { "scan.tif", "", 0, 0 },
              { "a99999999999999999999.tif", "", 0, 0 },
              { "S02.P4.jpeg", "", 4, 4 },
              { "grp2-07.tif", "", 7, 0 },
              { "IMG_0815.JPG", "", 815, 0 },
              { "P1010042.JPG", "", 0, 0 },
              { "", "", 0, 0 },
              { "GVP-D-S02.tif", "GVP-D-S02", 0, 0 },
              { "GVP-D-S02", "GVP-D-S02", 0, 0 },
              { "GVP-D-S02.jp2", "GVP-D-S02", 0, 0 },
              { "GVP-D-S02_3.jp2", "GVP-D-S02", 3, 0 },
              { "rat 7 panel 4.png", "rat 7", 4, 4 } };

/* Case 32. */
TEST(a_panel_number_is_read_as_a_number)
{
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const unsigned got = gsn_panel_number(cases[i].name, strlen(cases[i].specimen));

        if (got != cases[i].number)
            fail_msg("%s is read as panel %u, not %u", cases[i].name, got, cases[i].number);
    }
}

TEST(a_counter_is_no_panel_number_where_only_a_called_one_counts)
{
    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        const unsigned got = gsn_panel_number_called(cases[i].name, strlen(cases[i].specimen));

        if (got != cases[i].called)
            fail_msg("%s is called panel %u, not %u", cases[i].name, got, cases[i].called);
    }
}
