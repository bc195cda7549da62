/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "ui/look.h"

#include <math.h>
#include <string.h>

static const struct gsn_look looks[] = {
    { "waiting", ".", GSN_HUE_PLAIN },  { "working", ">", GSN_HUE_BUSY },
    { "reported", "+", GSN_HUE_GOOD },  { "withheld", "!", GSN_HUE_CARE },
    { "failed", "x", GSN_HUE_BAD },     { "refused", "x", GSN_HUE_BAD },
    { "held", "!", GSN_HUE_CARE },      { "unfiled", "?", GSN_HUE_CARE },
    { "trouble", "!", GSN_HUE_CARE },   { "away", "-", GSN_HUE_CARE },
    { "ready", "+", GSN_HUE_GOOD },     { "receiving", ">", GSN_HUE_BUSY },
    { "paused", "=", GSN_HUE_CARE },    { "off", "-", GSN_HUE_PLAIN },
    { "needs-eye", "?", GSN_HUE_CARE },
};

const struct gsn_look *gsn_look_of(const char *state)
{
    for (size_t i = 0; i < sizeof looks / sizeof looks[0]; i++)
        if (strcmp(looks[i].state, state) == 0)
            return &looks[i];
    return &looks[0];
}

const char *gsn_hue_ansi(enum gsn_hue hue)
{
    static const char *const codes[] = { "", "\033[36m", "\033[32m", "\033[33m", "\033[31m" };

    return codes[hue];
}

char *gsn_look_age(int64_t now, int64_t then)
{
    const long long minutes = then ? (now - then) / 60 : 0;

    if (then == 0)
        return gsn_strdup("");
    if (minutes < 1)
        return gsn_strdup("now");
    if (minutes < 60)
        return gsn_format("%lld min", minutes);
    if (minutes < 48 * 60)
        return gsn_format("%lld h", minutes / 60);
    return gsn_format("%lld d", minutes / (24 * 60));
}

char *gsn_look_progress(const char *stage, int64_t done, int64_t total, double left_s)
{
    const double percent = total > 0 ? 100 * (double)done / (double)total : NAN;
    const char *unit = left_s < 90 ? "s" : left_s < 90 * 60 ? "min" : "h";
    const double left = left_s < 90 ? left_s : left_s < 90 * 60 ? left_s / 60 : left_s / 3600;

    if (!stage[0])
        return gsn_strdup("starting");
    if (isnan(percent))
        return gsn_strdup(stage);
    if (isnan(left_s))
        return gsn_format("%s %.0f %%", stage, percent);
    return gsn_format("%s %.0f %%, %.0f %s left", stage, percent, left, unit);
}

char *gsn_look_loss(double percent, double lower, double upper)
{
    if (isnan(percent))
        return gsn_strdup("");
    if (isnan(lower) || isnan(upper))
        return gsn_format("%.2f %%", percent);
    return gsn_format("%.2f %% (%.2f to %.2f)", percent, lower, upper);
}

char *gsn_look_bytes(int64_t bytes)
{
    static const char *const units[] = { "kB", "MB", "GB", "TB" };
    double size = (double)bytes / 1000;
    size_t unit = 0;

    for (; size >= 999.95 && unit + 1 < sizeof units / sizeof units[0]; unit++)
        size /= 1000;
    return gsn_format("%.1f %s", size, units[unit]);
}
