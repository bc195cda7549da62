/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

/* Below this share of region voxels that were measured, or bridged from the sections beside them, a
 * loss is not printed: the density of a tenth that nobody knows can move the mean by as much as the
 * effects people look for. */
static const double LEAST_KNOWN = 0.9;
/* Of these, at least this share was measured: with every third section gone, what bridging costs
 * can hardly be measured on the rest. */
static const double LEAST_MEASURED = 0.7;

/* Per cent: of a smaller loss nobody can say from which density it is counted. */
static const double LEAST_FOR_ZERO = 5;

/* Why too little of a region is known to give a loss; NULL: enough is. */
static const char *too_little(struct gsn_draft *d, const char *whose, double known, double measured)
{
    if (known < LEAST_KNOWN)
        return gsn_draft_say(d, "%sonly %.0f %% of the region of interest has data", whose,
                             100 * measured);
    if (measured < LEAST_MEASURED)
        return gsn_draft_say(
            d,
            "%sonly %.0f %% of the region of interest was measured; the rest could "
            "only be bridged from the sections beside it",
            whose, 100 * measured);
    return NULL;
}

static const char *too_little_known(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const char *why = too_little(d, "", e->account->coverage, d->report.region.coverage);

    return why ? gsn_draft_headline(e, d, why) : NULL;
}

static const char *too_little_of_baseline(const struct gsn_specimen_baseline *b,
                                          struct gsn_draft *d)
{
    const char *whose = gsn_draft_say(d, "of the baseline %s ", b->name);
    const char *why = too_little(d, whose, 1 - b->unknown, 1 - b->unmeasured);

    return why ? gsn_draft_say(d, "%s: settle what its report says, then run again", why) : NULL;
}

/* Why the baseline gives nothing to compare with. */
static const char *no_baseline(const struct gsn_specimen_baseline *b, struct gsn_draft *d)
{
    if (b->withheld == 0)
        return gsn_draft_say(d, "the baseline %s has no result yet: import and run it", b->name);
    return gsn_draft_say(d,
                         "the baseline %s was run and its own figure is withheld: settle what its "
                         "report says, then run again",
                         b->name);
}

/* Why two densities that are known say nothing of each other; NULL: they do. */
static const char *not_comparable(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    const char *version = d->report.density_version;
    const char *own = too_little_known(e, d), *theirs = too_little_of_baseline(b, d);

    if (own && theirs)
        gsn_draft_warn(d, theirs);
    if (own || theirs)
        return own ? own : theirs;
    if (e->assembly && e->assembly->not_comparable[0])
        return e->assembly->not_comparable;
    if (strcmp(b->dyes, version) != 0 &&
        (strstr(b->dyes, GSN_DRAFT_IN_BATCH) || strstr(version, GSN_DRAFT_IN_BATCH)))
        return gsn_draft_say(d,
                             "batches not comparable: the control was measured by %s, this "
                             "specimen by %s; state \"reference\" in both jobs",
                             b->dyes, version);
    return NULL;
}

/* Others may have this specimen for their baseline. */
static void warn_as_baseline(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const char *known = e->account ? too_little_known(e, d) : NULL;

    if (known)
        gsn_draft_warn(d,
                       gsn_draft_say(d, "no loss can be given against this specimen: %s", known));
}

/* Why this specimen is compared with nothing; NULL: there is something. */
static const char *nothing_beside(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    const char *known, *none;

    if (!b->name[0]) {
        warn_as_baseline(e, d);
        return "no baseline is stated, so this specimen is its own";
    }
    if (e->tile)
        return "a tile is one picture: it has no baseline. Take `baseline` out of its job.json";
    if (!e->account)
        return gsn_draft_withheld(e, d);
    if (b->specimens > 0)
        return NULL;
    known = too_little_known(e, d);
    none = no_baseline(b, d);
    gsn_draft_warn(d, none);
    /* With a baseline it would be withheld just the same. */
    return known ? gsn_draft_say(d, "%s; %s", known, none) : none;
}

/* Why two sides give no loss; NULL: they gave ret_loss. */
static const char *compare(const struct gsn_evidence *e, struct gsn_draft *d,
                           const struct gsn_loss_side *control, const struct gsn_loss_side *treated,
                           struct gsn_loss *ret_loss)
{
    struct gsn_error why = { 0 };
    const char *reason = not_comparable(e, d);

    if (!reason && gsn_loss(control, treated, 0.95, ret_loss, &why) < 0)
        reason = gsn_draft_say(d, "%s", why.text);
    if (!reason && !gsn_draft_calibrated(e))
        reason = gsn_draft_narrow(e, d, control, treated, ret_loss);
    return reason;
}

static void print_loss(const struct gsn_loss *loss, int narrowed, struct gsn_report *r)
{
    if (loss->has_interval) {
        r->loss_lower = loss->percent_low;
        r->loss_upper = loss->percent_high;
        r->loss_interval =
            narrowed ? "95 %, stain, white and dye vectors" : "95 %, stain and white";
    }
    r->loss_percent = loss->percent;
    r->loss_points = loss->points;
}

void gsn_draft_loss(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_specimen_baseline *b = &e->specimen->baseline;
    struct gsn_report *r = &d->report;
    struct gsn_loss_side control = { .name = b->name,
                                     .definition = b->definition,
                                     .dyes = b->dyes,
                                     .mean = b->mean_density,
                                     .standard_error = b->mean_density_error,
                                     .volume_um3 = 1e9 * b->volume_mm3 };
    struct gsn_loss_side treated = { .name = r->specimen,
                                     .definition = r->density_name,
                                     .dyes = r->density_version,
                                     .mean = r->region.mean_density,
                                     .standard_error = gsn_draft_density_error(e),
                                     .volume_um3 = 1e9 * r->region.volume_mm3 };
    struct gsn_loss loss;

    r->loss_reason = nothing_beside(e, d);
    if (r->loss_reason || !e->account || b->specimens == 0)
        return;
    if (d->linked)
        gsn_draft_link_sides(e, d, &control, &treated);
    r->baseline_mean = control.mean;
    r->loss_reason = compare(e, d, &control, &treated, &loss);
    if (r->loss_reason) {
        gsn_draft_warn(d, r->loss_reason);
        return;
    }
    print_loss(&loss, d->by_colours, r);
    if (d->edge_panels > 0 && fabs(loss.percent) > LEAST_FOR_ZERO)
        r->zero_density =
            (treated.mean - (1 - loss.percent / 100) * control.mean) / (loss.percent / 100);
    if (d->by_colours || (d->linked && e->assembly->levelling.vectors.known))
        gsn_draft_value(d->measure, &r->measure_count, "Standard error of the loss by dye vectors",
                        d->by_colours ? d->loss_by_colour
                                      : gsn_draft_loss_by_vectors(e, &control, &treated),
                        "%");
}
