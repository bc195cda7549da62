/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The report's part about the stain: how it compares with the baseline's, and what that leaves
 * open.
 *
 * 1. The link: control tissue of both specimens tells gain and offset of one stain against the
 * other (stain/normalisation.h). Two specimens are stained on two days and differ by at least what
 * panels of one day do.
 * 2. Standard errors of a mean density on its own scale, and of one that is compared by the link.
 * 3. Name and version of the density: which dye vectors, which batch, which reference.
 * 4. The panels' dye vectors that are not the built-in ones, and where calibration panels and
 * slides disagree. */
#include "pipeline/specimen/report_builder.h"

#include "pipeline/stain/calibration.h"
#include "pipeline/stain/error_propagation.h"
#include "pipeline/stain/normalisation.h"
#include "pipeline/stain/stain_vectors.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Texture and what a region's tissue happens to be scatter by about this much in even baths. */
static const double UNEVEN_UNSAID = 0.03;

const char *gsn_builder_tissue_name(unsigned tissue)
{
    static const char *const name[GSN_CONTROL_KINDS] = { "dense tissue (bone)", "loose tissue",
                                                         "dentine" };

    return name[tissue];
}

/* How much more the stain of two specimens may differ than that of two panels of one. */
static const double SPECIMENS_OVER_PANELS = 2;

int gsn_stain_link(const struct gsn_specimen *specimen, const struct gsn_scale *scale,
                   struct gsn_batch_calibration *ret_link, struct gsn_error *err)
{
    const struct gsn_specimen_baseline *b = &specimen->baseline;
    const struct gsn_normalisation *l = scale ? &scale->levelling : NULL;
    struct gsn_gain_offset spread;

    if (!l || !l->done || b->specimens == 0)
        return gsn_fail(err, GSN_E_STAIN,
                        "no tissue tells how the baseline's stain would read here");
    /* Two specimens are stained on two days, and differ by no less than panels of one day do. */
    spread.gain = SPECIMENS_OVER_PANELS * l->fit.gain_scatter;
    spread.offset = SPECIMENS_OVER_PANELS * l->fit.offset_scatter;
    return gsn_batch_calibrate(&l->tissues, &b->tissues, &spread, ret_link, err);
}

void gsn_builder_find_link(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_scale *scale = e->reconstruction ? &e->reconstruction->scale : NULL;

    d->linked = e->analysis && gsn_stain_link(e->specimen, scale, &d->link, NULL) >= 0;
}

/* What the untreated tissues are off the link by, in their errors, when something is wrong. */
static const double DISAGREEING = 2;

void gsn_builder_link(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;

    gsn_builder_value(d->measure, &d->report.measure_count, "Stain against the baseline's, factor",
                      d->link.gain, "");
    gsn_builder_value(d->measure, &d->report.measure_count, "Stain against the baseline's, added",
                      d->link.offset, "density");
    if (d->link.disagreement > DISAGREEING)
        gsn_builder_warn(
            d, gsn_builder_say(
                   d,
                   "the tissues outside of the region do not agree on how this specimen is stained "
                   "against %s: one of them has changed, or is not what it was taken for",
                   b->name));
}

/* Where no reference tissue is stated, a bath that stained one panel stronger looks like collagen.
 */
void gsn_builder_evenness(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    struct gsn_report *r = &d->report;
    const char *why;

    if (!e->reconstruction || !(e->reconstruction->scale.stain_scatter > 0))
        return;
    gsn_builder_value(d->measure, &r->measure_count,
                      "Strength of the stain, scatter from panel to panel",
                      100 * e->reconstruction->scale.stain_scatter, "%");
    if (d->linked || e->reconstruction->scale.stain_scatter <= UNEVEN_UNSAID ||
        (e->reconstruction->scale.levelling.done && e->specimen->baseline.specimens == 0))
        return;
    why = e->reconstruction->scale.levelling.done
              ? "which was taken out between the panels, but not against the baseline: too little "
                "tissue outside of the region is alike in both"
              : "and no reference tissue takes that out";
    gsn_builder_warn(
        d, gsn_builder_say(
               d,
               "the panels are stained unequally (their strongest tissue differs by %.0f %%, "
               "standard deviation), %s: the loss is only known to within its interval; state "
               "\"reference\" in job.json",
               100 * e->reconstruction->scale.stain_scatter, why));
    if (e->reconstruction->scale.levelling.why[0])
        gsn_builder_warn(d, gsn_builder_say(d, "the panels were not levelled: %s",
                                            e->reconstruction->scale.levelling.why));
}

const struct gsn_dyes *gsn_builder_table(const struct gsn_report_inputs *e)
{
    for (size_t i = 0; e->reconstruction && i < e->reconstruction->densities.panel_count; i++)
        if (e->reconstruction->densities.panel[i].opened)
            return &e->reconstruction->densities.panel[i].stain.fit.dyes;
    return NULL;
}

int gsn_builder_calibrated(const struct gsn_report_inputs *e)
{
    for (size_t i = 0; e->reconstruction && i < e->reconstruction->densities.panel_count; i++)
        if (e->reconstruction->densities.panel[i].opened &&
            !(e->reconstruction->densities.panel[i].calibrated.panel &&
              e->reconstruction->densities.panel[i].calibrated.panel->has_dyes))
            return 0;
    return 1;
}

/* The set of dye vectors that the figures stand on: the panels' own, or none. */
const char *gsn_builder_dyes(const struct gsn_report_inputs *e)
{
    if (e->tile)
        return e->tile->fit.dyes.name;
    return gsn_builder_table(e) ? gsn_builder_table(e)->name : "";
}

void gsn_builder_definition(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    const int volume = e->specimen->protocol->kind == GSN_KIND_VOLUME;

    const struct gsn_protocol *p = e->specimen->protocol;
    const int standards = e->reconstruction && e->reconstruction->scale.by_standards;
    const int normalised =
        standards || (p->reference_tissue.kind != GSN_REGION_NONE &&
                      !(e->reconstruction && e->reconstruction->scale.not_comparable[0]));

    d->report.density_name =
        volume      ? "voxel value as imported"
        : standards ? "collagen-equivalent density (red dye by unmixing, calibration standards)"
        : normalised
            ? gsn_builder_say(d, "collagen-equivalent density (red dye by unmixing, reference %g)",
                              p->reference_density)
            : "collagen-equivalent density (red dye by unmixing)";
    /* Without a reference the figure is the batch's own. */
    d->report.density_version =
        volume ? "1"
        : p->batch[0] && !normalised
            ? gsn_builder_say(d, "%s" GSN_BUILDER_IN_BATCH "%s", gsn_builder_dyes(e), p->batch)
            : gsn_builder_dyes(e);
}

/* What vectors that were taken as exact turn by from panel to panel, as both sides' panels say. */
static struct gsn_vector_scatter turns_of_both(const struct gsn_report_inputs *e)
{
    return gsn_vector_scatter_pool(&e->reconstruction->scale.levelling.turns,
                                   &e->specimen->baseline.turns);
}

/* Relative standard error, by its dye vectors, of a density that is compared with a baseline by
 * untreated tissue and is this much of it; 0: not known. The line through the tissues takes out
 * most of what the vectors are off. */
static double vectors_error(const struct gsn_report_inputs *e, double ratio)
{
    const struct gsn_normalisation *l = &e->reconstruction->scale.levelling;
    const struct gsn_vector_scatter both = turns_of_both(e);

    if (!l->vectors.known)
        return 0;
    return gsn_vector_error_of_loss(&l->vectors, ratio) *
           (l->turns.freedom > 0 ? gsn_vector_scatter_deviation(&both) : 1);
}

/* What JPEG does to a mean density, relative: red of patches of 170 pixels of two real tiles, at
 * quality 85. It took 2.1 +- 0.7 % of one in picrosirius red and 0.1 +- 0.6 % of one in
 * haematoxylin and eosin, by how fine their texture is, so that a loss keeps part of it. */
static const double BY_JPEG = 0.013;

static int is_lossy(const struct gsn_report_inputs *e)
{
    for (size_t i = 0; i < e->reconstruction->densities.panel_count; i++)
        if (e->reconstruction->densities.panel[i].opened &&
            e->reconstruction->densities.panel[i].lossy)
            return 1;
    return 0;
}

void gsn_builder_compression(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    if (!e->reconstruction || !is_lossy(e))
        return;
    gsn_builder_value(d->measure, &d->report.measure_count,
                      "Standard error of the mean density by JPEG", 100 * BY_JPEG, "%");
    gsn_builder_warn_cost(
        d, (struct gsn_builder_cost){ .points = 100 * BY_JPEG * d->report.region.mean_density },
        gsn_builder_say(d,
                        "panels went through JPEG, which takes the colour of fine "
                        "texture: a mean density is off by %.1f %% (standard error): "
                        "let the scanner write PNG or TIFF without JPEG",
                        100 * BY_JPEG));
}

/* That by all that the stain leaves open. What the steps between panels do is in the errors of the
 * tissues, which stand for the panels that bear the region. */
static double own_error(const struct gsn_report_inputs *e, double ratio)
{
    const struct gsn_reconstruction *a = e->reconstruction;
    const double vectors = vectors_error(e, ratio);
    const double other = sqrt(fmax(0, a->scale.red_error * a->scale.red_error -
                                          a->scale.step_error * a->scale.step_error));

    /* Inferred vectors are the most of the other. */
    return hypot(is_lossy(e) ? BY_JPEG : 0,
                 a->scale.levelling.vectors.known && !(a->scale.levelling.turns.freedom > 0)
                     ? vectors
                     : hypot(vectors, other));
}

/* Standard error of the mean density by what the stain leaves open; 0: not known. Of its own scale
 * it leaves out what all panels have in common and untreated tissue shows. */
double gsn_builder_own_scale_error(const struct gsn_report_inputs *e)
{
    return e->reconstruction && e->analysis ? own_error(e, 1) * e->analysis->density.mean : 0;
}

double gsn_builder_density_error(const struct gsn_report_inputs *e)
{
    return e->reconstruction && e->analysis
               ? hypot(is_lossy(e) ? BY_JPEG : 0, hypot(e->reconstruction->scale.red_error,
                                                        e->reconstruction->scale.common_error)) *
                     e->analysis->density.mean
               : 0;
}

/* The baseline as it would read in this specimen's stain, and what that leaves open. */
void gsn_builder_link_sides(const struct gsn_report_inputs *e, const struct gsn_builder *d,
                            struct gsn_loss_side *control, struct gsn_loss_side *treated)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;

    control->mean = d->link.gain * b->mean_density + d->link.offset;
    control->standard_error = hypot(d->link.gain * b->own_scale_error,
                                    gsn_batch_calibration_error(&d->link, b->mean_density));
    treated->standard_error =
        own_error(e, treated->mean / control->mean) * e->analysis->density.mean;
}

double gsn_builder_loss_by_vectors(const struct gsn_report_inputs *e,
                                   const struct gsn_loss_side *control,
                                   const struct gsn_loss_side *treated)
{
    const double ratio = treated->mean / control->mean;

    return 100 * ratio * vectors_error(e, ratio);
}

/* Panels in a table are told one by one up to here; warnings always are. */
enum { MOST_TOLD = 24 };

/* A standard without collagen that reads more than this shows dye vectors that are off. */
static const double MOST_ZERO = 0.03;

/* Two glasses of one scanner, its lamp steady, differ by a few percent of light. */
static const double MOST_WHITE_OD = 0.05;

static const char *const DYES[] = { "red", "yellow", "dark" };

static int is_calibrated(const struct gsn_stack_panel *panel)
{
    return panel->calibrated.panel && panel->calibrated.panel->has_dyes;
}

/* "calibration panel C01.jpg: red (0.230 0.710 0.666) +- 0.1 deg, yellow ..." */
static const char *vectors_of(const struct gsn_stack_panel *panel, struct gsn_builder *d)
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
    return is_calibrated(panel) ? gsn_builder_say(d, "calibration panel %s: %s",
                                                  panel->calibrated.panel->stated->file, line)
                                : gsn_builder_say(d, "from the slide's own tissue: %s", line);
}

/* "red 1.2 of 4.0, ..." */
static const char *apart_of(const struct gsn_dyes_apart *apart, struct gsn_builder *d)
{
    return gsn_builder_say(
        d, "red %.1f (%.1f expected), yellow %.1f (%.1f), dark %.1f (%.1f) degrees", apart->deg[0],
        apart->expected[0], apart->deg[1], apart->expected[1], apart->deg[2], apart->expected[2]);
}

static void warn_of_dyes(const struct gsn_stack_panel *panel, struct gsn_builder *d)
{
    const struct gsn_calibrated *c = &panel->calibrated;
    const char *file = c->panel->stated->file;

    if (!c->compared)
        gsn_builder_warn(d,
                         gsn_builder_say(d,
                                         "panel %u: the dyes of calibration panel %s could not be "
                                         "compared with what the slide itself says: %s",
                                         panel->stain.panel, file, c->why));
    for (int k = 0; c->compared && k < 3; k++)
        if (c->apart.disagree[k])
            gsn_builder_warn(
                d, gsn_builder_say(
                       d,
                       "panel %u: its own %s dye is %.1f degrees from that of calibration panel "
                       "%s, and %.1f are to be expected: perhaps they are not of one batch; the "
                       "calibration panel was used",
                       panel->stain.panel, DYES[k], c->apart.deg[k], file, c->apart.expected[k]));
}

static void warn_of_panel(const struct gsn_stack_panel *panel, struct gsn_builder *d)
{
    const struct gsn_calibrated *c = &panel->calibrated;

    if (is_calibrated(panel))
        warn_of_dyes(panel, d);
    if (c->white_od > MOST_WHITE_OD)
        gsn_builder_warn(
            d, gsn_builder_say(d,
                               "panel %u and calibration panel %s were not scanned under the same "
                               "light: their glasses differ by %.0f %%",
                               panel->stain.panel, c->panel->stated->file,
                               100 * (pow(10, c->white_od) - 1)));
    if (fabs(c->zero) > MOST_ZERO)
        gsn_builder_warn(
            d, gsn_builder_say(d,
                               "panel %u: standards without collagen on calibration panel "
                               "%s read a density of %.3f: the dye vectors are off",
                               panel->stain.panel, c->panel->stated->file, c->zero));
}

/* Panels that the job left out, while it states calibration panels for others. */
static void warn_of_others(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    for (size_t i = 0; i < e->reconstruction->densities.panel_count; i++) {
        const struct gsn_stack_panel *panel = &e->reconstruction->densities.panel[i];

        if (!panel->opened)
            continue;
        if (!panel->calibrated.panel)
            gsn_builder_warn(d,
                             gsn_builder_say(d,
                                             "panel %u has no calibration panel, others have: its "
                                             "dye vectors are %s",
                                             panel->stain.panel, panel->stain.fit.dyes.name));
        else if (!e->reconstruction->scale.by_standards && panel->calibrated.gain.sections > 0 &&
                 e->specimen->protocol->reference_tissue.kind == GSN_REGION_NONE)
            gsn_builder_warn(d,
                             gsn_builder_say(d,
                                             "panel %u has standards, other panels have none: they "
                                             "were not used",
                                             panel->stain.panel));
    }
}

void gsn_builder_vectors(const struct gsn_report_inputs *e, struct gsn_builder *d)
{
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count, told = 0;

    if (!e->reconstruction)
        return;
    for (size_t i = 0; i < e->reconstruction->densities.panel_count; i++) {
        const struct gsn_stack_panel *panel = &e->reconstruction->densities.panel[i];

        if (!panel->opened)
            continue;
        if (panel->calibrated.panel)
            warn_of_panel(panel, d);
        /* Built-in vectors are taken as they are, and have no error to tell. */
        if (!(panel->stain.fit.deviation_deg[0] > 0) || told++ >= MOST_TOLD)
            continue;
        gsn_builder_text(rows, count,
                         gsn_builder_say(d, "dye vectors of panel %u", panel->stain.panel),
                         vectors_of(panel, d));
        if (panel->calibrated.compared)
            gsn_builder_text(rows, count,
                             gsn_builder_say(d, "panel %u: its own dyes off the calibration's",
                                             panel->stain.panel),
                             apart_of(&panel->calibrated.apart, d));
    }
    if (told > MOST_TOLD)
        gsn_builder_text(rows, count, "dye vectors of further panels",
                         gsn_builder_say(d, "%zu more panels have their own", told - MOST_TOLD));
    if (e->reconstruction->calibrations.count > 0)
        warn_of_others(e, d);
}
