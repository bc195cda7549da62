/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include <math.h>
#include <string.h>

/* Texture and what a region's tissue happens to be scatter by about this much in even baths. */
static const double UNEVEN_UNSAID = 0.03;

const char *gsn_draft_tissue_name(unsigned tissue)
{
    static const char *const name[GSN_UNTREATED_KINDS] = { "dense tissue (bone)", "loose tissue",
                                                           "dentine" };

    return name[tissue];
}

const char *gsn_specimen_tissue_measure(unsigned tissue)
{
    static const char *const names[GSN_UNTREATED_KINDS] = { "tissue_dense", "tissue_loose",
                                                            "tissue_dentine" };

    return names[tissue];
}

const char *gsn_specimen_tissues_measure(unsigned tissue, unsigned other)
{
    static const char *const names[] = { "tissue_dense_loose", "tissue_dense_dentine",
                                         "tissue_loose_dentine" };

    _Static_assert((int)GSN_UNTREATED_KINDS == 3, "all pairs of three have a name");
    return names[tissue + other - 1];
}

/* How much more the stain of two specimens may differ than that of two panels of one. */
static const double SPECIMENS_OVER_PANELS = 2;

int gsn_stain_link(const struct gsn_specimen *specimen, const struct gsn_assembly *assembly,
                   struct gsn_batch_calibration *ret_link, struct gsn_error *err)
{
    const struct gsn_specimen_baseline *b = &specimen->baseline;
    const struct gsn_levelling *l = assembly ? &assembly->levelling : NULL;
    struct gsn_gain_offset spread;

    if (!l || !l->done || b->specimens == 0)
        return gsn_fail(err, GSN_E_STAIN,
                        "no tissue tells how the baseline's stain would read here");
    /* Two specimens are stained on two days, and differ by no less than panels of one day do. */
    spread.gain = SPECIMENS_OVER_PANELS * l->fit.gain_scatter;
    spread.offset = SPECIMENS_OVER_PANELS * l->fit.offset_scatter;
    return gsn_batch_calibrate(&l->tissues, &b->tissues, &spread, ret_link, err);
}

void gsn_draft_find_link(const struct gsn_evidence *e, struct gsn_draft *d)
{
    d->linked = e->account && gsn_stain_link(e->specimen, e->assembly, &d->link, NULL) >= 0;
}

/* What the untreated tissues are off the link by, in their errors, when something is wrong. */
static const double DISAGREEING = 2;

void gsn_draft_link(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;

    gsn_draft_value(d->measure, &d->report.measure_count, "Stain against the baseline's, factor",
                    d->link.gain, "");
    gsn_draft_value(d->measure, &d->report.measure_count, "Stain against the baseline's, added",
                    d->link.offset, "density");
    if (d->link.disagreement > DISAGREEING)
        gsn_draft_warn(
            d, gsn_draft_say(
                   d,
                   "the tissues outside of the region do not agree on how this specimen is stained "
                   "against %s: one of them has changed, or is not what it was taken for",
                   b->name));
}

/* Where no reference tissue is stated, a bath that stained one panel stronger looks like collagen.
 */
void gsn_draft_evenness(const struct gsn_evidence *e, struct gsn_draft *d)
{
    struct gsn_report *r = &d->report;
    const char *why;

    if (!e->assembly || !(e->assembly->stain_scatter > 0))
        return;
    gsn_draft_value(d->measure, &r->measure_count,
                    "Strength of the stain, scatter from panel to panel",
                    100 * e->assembly->stain_scatter, "%");
    if (d->linked || e->assembly->stain_scatter <= UNEVEN_UNSAID ||
        (e->assembly->levelling.done && e->specimen->baseline.specimens == 0))
        return;
    why = e->assembly->levelling.done
              ? "which was taken out between the panels, but not against the baseline: too little "
                "tissue outside of the region is alike in both"
              : "and no reference tissue takes that out";
    gsn_draft_warn(
        d, gsn_draft_say(
               d,
               "the panels are stained unequally (their strongest tissue differs by %.0f %%, "
               "standard deviation), %s: the loss is only known to within its interval; state "
               "\"reference\" in job.json",
               100 * e->assembly->stain_scatter, why));
    if (e->assembly->levelling.why[0])
        gsn_draft_warn(
            d, gsn_draft_say(d, "the panels were not levelled: %s", e->assembly->levelling.why));
}

const struct gsn_dyes *gsn_draft_table(const struct gsn_evidence *e)
{
    for (size_t i = 0; e->assembly && i < e->assembly->panel_count; i++)
        if (e->assembly->panel[i].opened)
            return &e->assembly->panel[i].stain.fit.dyes;
    return NULL;
}

int gsn_draft_calibrated(const struct gsn_evidence *e)
{
    for (size_t i = 0; e->assembly && i < e->assembly->panel_count; i++)
        if (e->assembly->panel[i].opened && !(e->assembly->panel[i].calibrated.panel &&
                                              e->assembly->panel[i].calibrated.panel->has_dyes))
            return 0;
    return 1;
}

/* The set of dye vectors that the figures stand on: the panels' own, or none. */
const char *gsn_draft_dyes(const struct gsn_evidence *e)
{
    if (e->tile)
        return e->tile->fit.dyes.name;
    return gsn_draft_table(e) ? gsn_draft_table(e)->name : "";
}

void gsn_draft_definition(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const int volume = e->specimen->protocol->kind == GSN_KIND_VOLUME;

    const struct gsn_protocol *p = e->specimen->protocol;
    const int standards = e->assembly && e->assembly->by_standards;
    const int normalised = standards || (p->reference_tissue.kind != GSN_REGION_NONE &&
                                         !(e->assembly && e->assembly->not_comparable[0]));

    d->report.density_name =
        volume      ? "voxel value as imported"
        : standards ? "collagen-equivalent density (red dye by unmixing, calibration standards)"
        : normalised
            ? gsn_draft_say(d, "collagen-equivalent density (red dye by unmixing, reference %g)",
                            p->reference_density)
            : "collagen-equivalent density (red dye by unmixing)";
    /* Without a reference the figure is the batch's own. */
    d->report.density_version =
        volume ? "1"
        : p->batch[0] && !normalised
            ? gsn_draft_say(d, "%s" GSN_DRAFT_IN_BATCH "%s", gsn_draft_dyes(e), p->batch)
            : gsn_draft_dyes(e);
}

/* What vectors that were taken as exact turn by from panel to panel, as both sides' panels say. */
static struct gsn_vector_scatter turns_of_both(const struct gsn_evidence *e)
{
    return gsn_vector_scatter_pool(&e->assembly->levelling.turns, &e->specimen->baseline.turns);
}

/* Relative standard error, by its dye vectors, of a density that is compared with a baseline by
 * untreated tissue and is this much of it; 0: not known. The line through the tissues takes out
 * most of what the vectors are off. */
static double vectors_error(const struct gsn_evidence *e, double ratio)
{
    const struct gsn_levelling *l = &e->assembly->levelling;
    const struct gsn_vector_scatter both = turns_of_both(e);

    if (!l->vectors.known)
        return 0;
    return gsn_vector_error_of_loss(&l->vectors, ratio) *
           (l->turns.freedom > 0 ? gsn_vector_scatter_deviation(&both) : 1);
}

/* That by all that the stain leaves open. What the steps between panels do is in the errors of the
 * tissues, which stand for the panels that bear the region. */
static double own_error(const struct gsn_evidence *e, double ratio)
{
    const struct gsn_assembly *a = e->assembly;
    const double vectors = vectors_error(e, ratio);
    const double other = sqrt(fmax(0, a->red_error * a->red_error - a->step_error * a->step_error));

    /* Inferred vectors are the most of the other. */
    return a->levelling.vectors.known && !(a->levelling.turns.freedom > 0) ? vectors
                                                                           : hypot(vectors, other);
}

/* Standard error of the mean density by what the stain leaves open; 0: not known. Of its own scale
 * it leaves out what all panels have in common and untreated tissue shows. */
double gsn_draft_own_scale_error(const struct gsn_evidence *e)
{
    return e->assembly && e->account ? own_error(e, 1) * e->account->density.mean : 0;
}

double gsn_draft_density_error(const struct gsn_evidence *e)
{
    return e->assembly && e->account
               ? hypot(e->assembly->red_error, e->assembly->common_error) * e->account->density.mean
               : 0;
}

/* The baseline as it would read in this specimen's stain, and what that leaves open. */
void gsn_draft_link_sides(const struct gsn_evidence *e, const struct gsn_draft *d,
                          struct gsn_loss_side *control, struct gsn_loss_side *treated)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;

    control->mean = d->link.gain * b->mean_density + d->link.offset;
    control->standard_error = hypot(d->link.gain * b->own_scale_error,
                                    gsn_batch_calibration_error(&d->link, b->mean_density));
    treated->standard_error =
        own_error(e, treated->mean / control->mean) * e->account->density.mean;
}

double gsn_draft_loss_by_vectors(const struct gsn_evidence *e, const struct gsn_loss_side *control,
                                 const struct gsn_loss_side *treated)
{
    const double ratio = treated->mean / control->mean;

    return 100 * ratio * vectors_error(e, ratio);
}
