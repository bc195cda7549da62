/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/natural.h"

#include <stdbool.h>
#include <string.h>
#include <strings.h>

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

/* Compares the numbers both begin with, and moves behind them. */
static int compare_numbers(const char **a, const char **b)
{
    size_t la, lb;
    int order;

    *a += strspn(*a, "0");
    *b += strspn(*b, "0");
    la = strspn(*a, "0123456789");
    lb = strspn(*b, "0123456789");
    order = la != lb ? (la < lb ? -1 : 1) : memcmp(*a, *b, la);
    *a += la;
    *b += lb;
    return order;
}

int gsn_natural_compare(const char *a, const char *b)
{
    const char *x = a, *y = b;

    while (*x && *y) {
        int order = (unsigned char)*x - (unsigned char)*y;

        if (is_digit(*x) && is_digit(*y)) {
            order = compare_numbers(&x, &y);
        } else {
            x++;
            y++;
        }
        if (order != 0)
            return order;
    }
    if (*x || *y)
        return *x ? 1 : -1;
    return strcmp(a, b);
}

int gsn_name_is_picture(const char *name)
{
    static const char *const endings[] = { "jpg", "jpeg", "png", "tif", "tiff", "btf",  "tf8",
                                           "svs", "ndpi", "scn", "bmp", "gif",  "webp", "jp2",
                                           "pam", "pnm",  "ppm", "pgm", "heic" };
    const char *const dot = strrchr(name, '.');

    for (size_t i = 0; dot && i < sizeof endings / sizeof endings[0]; i++) {
        if (strcasecmp(dot + 1, endings[i]) == 0)
            return 1;
    }
    return 0;
}
