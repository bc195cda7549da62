/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/core/calendar.h"

#include "tests/check.h"

#include <string.h>

/* By `date -d DATE +%s`, over 86400. */
TEST(days_are_those_of_the_calendar)
{
    static const struct {
        const char *text;
        long day;
    } known[] = { { "1970-01-01", 0 },     { "1999-12-31", 10956 }, { "2000-02-29", 11016 },
                  { "2000-03-01", 11017 }, { "2026-03-31", 20543 }, { "2100-03-01", 47541 } };
    struct gsn_error err = { 0 };

    for (size_t i = 0; i < sizeof known / sizeof known[0]; i++) {
        long day = -7;

        CHECK_OK(gsn_calendar_day(known[i].text, &day, &err), err);
        CHECK_NEAR((double)day, (double)known[i].day, 0);
    }
}

TEST(what_is_no_date_is_refused_and_the_output_stays_untouched)
{
    static const char *const wrong[] = { "",           "2026-3-31",  "2026-02-29", "2100-02-29",
                                         "2026-13-01", "2026-00-10", "2026-04-31", "31.03.2026",
                                         "2026-03-3x", "1969-12-31", "2026-03-310" };
    long day = -7;

    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        struct gsn_error err = { 0 };

        CHECK(gsn_calendar_day(wrong[i], &day, &err) == GSN_E_INPUT);
        CHECK(strstr(err.text, "is no date such as 2026-03-31") != NULL);
    }
    CHECK_NEAR((double)day, -7, 0);
}
