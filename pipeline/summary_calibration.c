/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Panels in a table are told one by one up to here; warnings always are. */
enum { MOST_TOLD = 24 };

/* A standard without collagen that reads more than this shows dye vectors that are off. */
static const double MOST_ZERO = 0.03;

/* Two glasses of one scanner, its lamp steady, differ by a few percent of light. */
static const double MOST_WHITE_OD = 0.05;

static const char *const DYES[] = { "red", "yellow", "dark" };

static int is_calibrated(const struct gsn_assembly_panel *panel)
{
    return panel->calibrated.panel && panel->calibrated.panel->has_dyes;
}

/* "calibration panel C01.jpg: red (0.230 0.710 0.666) +- 0.1 deg, yellow ..." */
static const char *vectors_of(const struct gsn_assembly_panel *panel, struct gsn_draft *d)
{
    const struct gsn_dyes_fit *fit = &panel->stain.fit;
    const double *v[3] = { fit->dyes.red, fit->dyes.yellow, fit->dyes.dark };
    char line[400] = "";
    size_t used = 0;

    for (int k = 0; k < 3 && used < sizeof line; k++) {
        const int n =
            snprintf(line + used, sizeof line - used, "%s%s (%.4f %.4f %.4f) +- %.2f deg",
                     k ? ", " : "", DYES[k], v[k][0], v[k][1], v[k][2], fit->deviation_deg[k]);

        used += n > 0 ? (size_t)n : 0;
    }
    return is_calibrated(panel) ? gsn_draft_say(d, "calibration panel %s: %s",
                                                panel->calibrated.panel->stated->file, line)
                                : gsn_draft_say(d, "from the slide's own tissue: %s", line);
}

/* "red 1.2 of 4.0, ..." */
static const char *apart_of(const struct gsn_dyes_apart *apart, struct gsn_draft *d)
{
    return gsn_draft_say(
        d, "red %.1f (%.1f expected), yellow %.1f (%.1f), dark %.1f (%.1f) degrees", apart->deg[0],
        apart->expected[0], apart->deg[1], apart->expected[1], apart->deg[2], apart->expected[2]);
}

static void warn_of_dyes(const struct gsn_assembly_panel *panel, struct gsn_draft *d)
{
    const struct gsn_calibrated *c = &panel->calibrated;
    const char *file = c->panel->stated->file;

    if (!c->compared)
        gsn_draft_warn(d, gsn_draft_say(d,
                                        "panel %u: the dyes of calibration panel %s could not be "
                                        "compared with what the slide itself says: %s",
                                        panel->stain.panel, file, c->why));
    for (int k = 0; c->compared && k < 3; k++)
        if (c->apart.disagree[k])
            gsn_draft_warn(
                d, gsn_draft_say(
                       d,
                       "panel %u: its own %s dye is %.1f degrees from that of calibration panel "
                       "%s, and %.1f are to be expected: perhaps they are not of one batch; the "
                       "calibration panel was used",
                       panel->stain.panel, DYES[k], c->apart.deg[k], file, c->apart.expected[k]));
}

static void warn_of_panel(const struct gsn_assembly_panel *panel, struct gsn_draft *d)
{
    const struct gsn_calibrated *c = &panel->calibrated;

    if (is_calibrated(panel))
        warn_of_dyes(panel, d);
    if (c->white_od > MOST_WHITE_OD)
        gsn_draft_warn(
            d, gsn_draft_say(d,
                             "panel %u and calibration panel %s were not scanned under the same "
                             "light: their glasses differ by %.0f %%",
                             panel->stain.panel, c->panel->stated->file,
                             100 * (pow(10, c->white_od) - 1)));
    if (fabs(c->zero) > MOST_ZERO)
        gsn_draft_warn(d, gsn_draft_say(d,
                                        "panel %u: standards without collagen on calibration panel "
                                        "%s read a density of %.3f: the dye vectors are off",
                                        panel->stain.panel, c->panel->stated->file, c->zero));
}

/* Panels that the job left out, while it states calibration panels for others. */
static void warn_of_others(const struct gsn_evidence *e, struct gsn_draft *d)
{
    for (size_t i = 0; i < e->assembly->panel_count; i++) {
        const struct gsn_assembly_panel *panel = &e->assembly->panel[i];

        if (!panel->opened)
            continue;
        if (!panel->calibrated.panel)
            gsn_draft_warn(d, gsn_draft_say(d,
                                            "panel %u has no calibration panel, others have: its "
                                            "dye vectors are %s",
                                            panel->stain.panel, panel->stain.fit.dyes.name));
        else if (!e->assembly->by_standards && panel->calibrated.gain.sections > 0 &&
                 e->specimen->protocol->reference_tissue.kind == GSN_REGION_NONE)
            gsn_draft_warn(d, gsn_draft_say(d,
                                            "panel %u has standards, other panels have none: they "
                                            "were not used",
                                            panel->stain.panel));
    }
}

void gsn_draft_vectors(const struct gsn_evidence *e, struct gsn_draft *d)
{
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count, told = 0;

    if (!e->assembly)
        return;
    for (size_t i = 0; i < e->assembly->panel_count; i++) {
        const struct gsn_assembly_panel *panel = &e->assembly->panel[i];

        if (!panel->opened)
            continue;
        if (panel->calibrated.panel)
            warn_of_panel(panel, d);
        /* Built-in vectors are taken as they are, and have no error to tell. */
        if (!(panel->stain.fit.deviation_deg[0] > 0) || told++ >= MOST_TOLD)
            continue;
        gsn_draft_text(rows, count, gsn_draft_say(d, "dye vectors of panel %u", panel->stain.panel),
                       vectors_of(panel, d));
        if (panel->calibrated.compared)
            gsn_draft_text(rows, count,
                           gsn_draft_say(d, "panel %u: its own dyes off the calibration's",
                                         panel->stain.panel),
                           apart_of(&panel->calibrated.apart, d));
    }
    if (told > MOST_TOLD)
        gsn_draft_text(rows, count, "dye vectors of further panels",
                       gsn_draft_say(d, "%zu more panels have their own", told - MOST_TOLD));
    if (e->assembly->calibration_count > 0)
        warn_of_others(e, d);
}
