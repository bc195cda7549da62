/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/panel_name.h"

#include <ctype.h>
#include <stdbool.h>
#include <string.h>
#include <strings.h>

enum { MOST_PANEL_NUMBER = 10000 };

static bool ends_with_panel(const char *stem, size_t length)
{
    return length >= 5 && strncasecmp(stem + length - 5, "panel", 5) == 0;
}

/* Whether the digits at this place are called a panel: "panel 3", "Panel_3", "-P03"; not "grp2". */
static bool is_called_panel(const char *stem, size_t digits_at)
{
    size_t i = digits_at;

    while (i > 0 && strchr("-_ .", stem[i - 1]))
        i--;
    if (i < digits_at || ends_with_panel(stem, i))
        return ends_with_panel(stem, i);
    return i > 0 && (stem[i - 1] == 'P' || stem[i - 1] == 'p') &&
           (i == 1 || !isalnum((unsigned char)stem[i - 2]));
}

struct numbers {
    unsigned last, called;
};

static struct numbers read_numbers(const char *name, size_t skip)
{
    const char *const dot = strrchr(name, '.');
    const size_t length = dot && dot > name ? (size_t)(dot - name) : strlen(name);
    struct numbers found = { 0, 0 };

    for (size_t i = skip; i < length;) {
        const size_t start = i;
        unsigned value = 0;

        if (!isdigit((unsigned char)name[i])) {
            i++;
            continue;
        }
        for (; i < length && isdigit((unsigned char)name[i]); i++)
            if (value <= MOST_PANEL_NUMBER)
                value = 10 * value + (unsigned)(name[i] - '0');
        found.last = value <= MOST_PANEL_NUMBER ? value : 0;
        if (is_called_panel(name, start))
            found.called = found.last;
    }
    return found;
}

unsigned gsn_panel_number(const char *name, size_t skip)
{
    const struct numbers found = read_numbers(name, skip);

    return found.called ? found.called : found.last;
}

unsigned gsn_panel_number_called(const char *name, size_t skip)
{
    return read_numbers(name, skip).called;
}
