/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The calendar: a date as a number of days, since libc reads dates in the local time zone only and
 * takes 2026-02-30 for the second of March. And a clock that only runs on. */
#include "pipeline/core/calendar.h"

#include <string.h>
#include <time.h>

static int days_of_month(int year, int month)
{
    static const int days[] = { 31, 28, 31, 30, 31, 30, 31, 31, 30, 31, 30, 31 };
    const int leap = (year % 4 == 0 && year % 100 != 0) || year % 400 == 0;

    return days[month - 1] + (month == 2 && leap);
}

/* Digits from..to as a number; -1 where one is none. */
static int read_digits(const char *text, int from, int to)
{
    int number = 0;

    for (int i = from; i < to; i++) {
        if (text[i] < '0' || text[i] > '9')
            return -1;
        number = 10 * number + text[i] - '0';
    }
    return number;
}

int gsn_calendar_day(const char *text, long *ret_day, struct gsn_error *err)
{
    const int whole = strlen(text) == 10 && text[4] == '-' && text[7] == '-';
    const int year = whole ? read_digits(text, 0, 4) : -1,
              month = whole ? read_digits(text, 5, 7) : -1;
    const int day = whole ? read_digits(text, 8, 10) : -1;
    long days;

    if (year < 1970 || month < 1 || month > 12 || day < 1 || day > days_of_month(year, month))
        return gsn_fail(err, GSN_E_INPUT, "\"%.20s\" is no date such as 2026-03-31", text);
    days = 365L * (year - 1970) + (year - 1969) / 4 - (year - 1901) / 100 + (year - 1601) / 400;
    for (int m = 1; m < month; m++)
        days += days_of_month(year, m);
    *ret_day = days + day - 1;
    return GSN_OK;
}

int64_t gsn_now_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

double gsn_process_cpu_ms(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return 1e3 * (double)now.tv_sec + 1e-6 * (double)now.tv_nsec;
}
