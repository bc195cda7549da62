/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/conditions.h"

#include <math.h>
#include <stdio.h>

/* Bands of the blank glass may differ by this much, 2.3 % of the light: it moves a density of 0.7
 * by 1.4 %. The vignetting that the glass's surface cannot follow stays below 0.008. */
static const double STEADY_OD = 0.01;
/* More of a panel's tissue than pens ever cover. */
static const double MUCH_INK = 0.25;
/* A stain that waited longer for its scan is told: picro-fuchsin fades, in acid mounting media
 * quickly. */
static const double TOLD_DAYS = 28;

static int add(struct gsn_conditions_words *words, char *sentence)
{
    char **more = gsn_realloc_array(words->sentence, words->count + 1, sizeof *more);

    if (more)
        words->sentence = more;
    if (!more || !sentence) {
        gsn_free(sentence);
        return GSN_E_NOMEM;
    }
    words->sentence[words->count++] = sentence;
    return GSN_OK;
}

void gsn_conditions_words_done(struct gsn_conditions_words *words)
{
    for (size_t i = 0; i < words->count; i++)
        gsn_free(words->sentence[i]);
    gsn_free(words->sentence);
}

static int say_lamp(const struct gsn_assembly_panel *p, struct gsn_conditions_words *words)
{
    const int rows = !(p->lamp.rows < p->lamp.columns);
    const double drift = rows ? p->lamp.rows : p->lamp.columns;

    if (!(drift > STEADY_OD))
        return GSN_OK;
    return add(words,
               gsn_format("panel %u: the blank glass drifts by %.1f %% from %s to %s within "
                          "the scan, and %.1f %% are allowed: the lamp flickers or was "
                          "still warming up; let it warm up and scan the panel again",
                          p->given->number, 100 * (pow(10, drift) - 1), rows ? "row" : "column",
                          rows ? "row" : "column", 100 * (pow(10, STEADY_OD) - 1)));
}

static int say_bath(const struct gsn_assembly_panel *p, const struct gsn_protocol *protocol,
                    struct gsn_conditions_words *words)
{
    const double ratio = gsn_stain_amounts_yellow_to_red(&p->tone);
    const double low = protocol->yellow_to_red[0], high = protocol->yellow_to_red[1];

    if (!(low > 0) || isnan(ratio) || (ratio >= low && ratio <= high))
        return GSN_OK;
    return add(words, gsn_format("panel %u: yellow dye is %.2f times the red, the batch's limits "
                                 "are %g to %g: %s; compare with the batch's control glass",
                                 p->given->number, ratio, low, high,
                                 ratio > high
                                     ? "red was washed out (differentiated too long) or yellow "
                                       "rinsed too little"
                                     : "yellow was washed out (in water) or red differentiated too "
                                       "little"));
}

/* Pen strokes cover little of what they are drawn on; tissue of another hue than the dyes' may be
 * taken for ink, and is lost to the figures like it. */
static int say_ink(const struct gsn_assembly *a, unsigned panel, struct gsn_conditions_words *words)
{
    enum { INK = 5 };
    _Static_assert(GSN_DEFECT_INK == 1 << INK, "the bit of ink");
    double ink = 0, tissue = 0;

    for (size_t i = 0; i < a->section_count; i++)
        if (a->section[i].panel == panel) {
            ink += a->section[i].masked.area_um2[INK];
            tissue += a->section[i].masked.outline_um2;
        }
    if (!(ink > MUCH_INK * tissue))
        return GSN_OK;
    return add(words,
               gsn_format("panel %u: %.0f %% of its tissue has a colour that the dyes do not "
                          "explain and is left out as ink; if it is not drawn upon, it was "
                          "stained by other dyes than those that the job goes by: state a "
                          "calibration panel, or \"dyes\": \"estimate\"",
                          panel, 100 * fmin(ink / tissue, 1)));
}

/* "2 (1.4 times), 7 (0.7 times)" */
static int say_knife(const struct gsn_assembly *a, struct gsn_conditions_words *words)
{
    char list[400] = "";
    size_t used = 0, count = 0;

    for (size_t i = 0; i < a->section_count; i++) {
        const double times = a->section[i].thickness;
        int n;

        if (!(times > 0) || times == 1)
            continue;
        count++;
        if (used + 30 > sizeof list)
            continue;
        n = snprintf(list + used, sizeof list - used, "%s%u (%.1f times)", used ? ", " : "",
                     a->section[i].seen.serial, times);
        used += n > 0 ? (size_t)n : 0;
    }
    if (count == 0)
        return GSN_OK;
    return add(words, gsn_format("all dyes of section%s %s differ together from the panel's other "
                                 "sections: thickness suspected, look at the knife; %s density is "
                                 "not corrected",
                                 count == 1 ? "" : "s", list, count == 1 ? "its" : "their"));
}

static int say_dust(const struct gsn_assembly *a, struct gsn_conditions_words *words)
{
    char list[200] = "";
    size_t used = 0;

    if (a->spot_count == 0)
        return GSN_OK;
    for (size_t i = 0; i < a->spot_count && used + 30 < sizeof list; i++) {
        const int n = snprintf(list + used, sizeof list - used, "%s(%.0f, %.0f)", used ? ", " : "",
                               a->spot[i].px.x, a->spot[i].px.y);

        used += n > 0 ? (size_t)n : 0;
    }
    return add(words, gsn_format("%zu spot%s at the same place of all %u panels, at %s px: dirt on "
                                 "the scanner's glass or sensor. %s masked; clean it before the "
                                 "next panel",
                                 a->spot_count, a->spot_count == 1 ? " is dark" : "s are dark",
                                 a->spot_panels, list, a->spot_count == 1 ? "It is" : "They are"));
}

static int say_age(const struct gsn_protocol *p, struct gsn_conditions_words *words)
{
    if (!(p->days_to_scan > TOLD_DAYS))
        return GSN_OK;
    return add(words, gsn_format("stained on %s and scanned on %s, %.0f days later: picro-fuchsin "
                                 "fades, and what has faded looks like loss; compare only with a "
                                 "control of the same age",
                                 p->stained, p->scanned, p->days_to_scan));
}

int gsn_conditions_words(const struct gsn_assembly *a, const struct gsn_protocol *protocol,
                         struct gsn_conditions_words *words)
{
    int r = say_age(protocol, words);

    for (size_t p = 0; r >= 0 && p < a->panel_count; p++) {
        if (!a->panel[p].opened || !a->grid)
            continue;
        r = say_lamp(&a->panel[p], words);
        if (r >= 0)
            r = say_bath(&a->panel[p], protocol, words);
        if (r >= 0)
            r = say_ink(a, a->panel[p].given->number, words);
    }
    if (r >= 0)
        r = say_knife(a, words);
    return r < 0 ? r : say_dust(a, words);
}
