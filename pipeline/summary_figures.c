/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/summary_draft.h"

#include <math.h>
#include <string.h>

/* More bridged than this is said in the verdict; less are the halos and dust of every stack. */
static const double BRIDGED_UNSAID = 0.02;

static void fill_fit(const struct gsn_account *account, struct gsn_draft *d)
{
    const struct gsn_fit_report *fit = &account->fit.fit;
    const size_t tets = gsn_dms_mesh(account->space)->tet_count;

    d->fit = (struct gsn_report_fit){ .tets = tets,
                                      .unknowns = fit->unknowns,
                                      .samples = fit->samples,
                                      .empty_tets = fit->empty_tets,
                                      .tets_in_tolerance = tets - account->over_tolerance,
                                      .rms = fit->rms,
                                      .worst = fit->worst,
                                      .smoothing = account->smoothing,
                                      .tolerance = account->tolerance,
                                      .degree = gsn_dms_degree(account->space) };
    d->report.fit = &d->fit;
    d->units = (struct gsn_report_units){ .first = account->summary.low,
                                          .last = account->summary.high,
                                          .bin = account->summary.bin,
                                          .bin_count = GSN_UNIT_BINS,
                                          .smallest = account->summary.min,
                                          .median = account->summary.median,
                                          .largest = account->summary.max };
    d->report.units = &d->units;
}

void gsn_draft_figures(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_account *account = e->account;
    const struct gsn_protocol *p = e->specimen->protocol;
    struct gsn_report *r = &d->report;

    r->region = (struct gsn_report_region){
        .volume_mm3 = 1e-9 * account->density.volume_um3,
        .mean_density = account->density.mean,
        .coverage = account->coverage,
        .description =
            p->region.kind == GSN_REGION_MASK   ? p->region.file
            : p->region.kind == GSN_REGION_NONE ? "the whole volume"
            : p->region.kind == GSN_REGION_BAND
                ? gsn_draft_say(d, "%g to %g um from the surface of %s%s", p->region.low_um,
                                p->region.high_um, p->region.file ? "" : "the ",
                                p->region.file ? p->region.file : gsn_tissue_name(p->region.from))
                : "a shape stated in job.json"
    };
    for (size_t i = 0; i < account->bound_count; i++)
        d->volume[i] =
            (struct gsn_report_volume){ .threshold = account->bound[i].threshold,
                                        .lower_mm3 = 1e-9 * account->bound[i].lower_um3,
                                        .upper_mm3 = 1e-9 * account->bound[i].upper_um3 };
    r->volumes = d->volume;
    r->volume_count = account->bound_count;
    for (size_t i = 0; i < account->picture_count; i++)
        d->picture[i] =
            (struct gsn_report_picture){ .id = account->picture[i].id,
                                         .title = account->picture[i].title,
                                         .caption = account->picture[i].caption,
                                         .png = { account->picture[i].png, account->picture[i].size,
                                                  account->picture[i].width,
                                                  account->picture[i].height } };
    r->pictures = d->picture;
    r->picture_count = account->picture_count;
    r->area_figure =
        (struct gsn_report_value){ .name = gsn_draft_say(d, "share of sampled voxels above %.4g",
                                                         account->above_threshold),
                                   .value = 100 * account->above_share,
                                   .unit = "%" };
    gsn_draft_value(d->measure, &r->measure_count, "MicroUnit density, lower quartile",
                    account->summary.quartile1, "density");
    gsn_draft_value(d->measure, &r->measure_count, "MicroUnit density, upper quartile",
                    account->summary.quartile3, "density");
    gsn_draft_value(d->measure, &r->measure_count, "MicroUnits with data",
                    (double)account->summary.ok, "");
    gsn_draft_value(d->measure, &r->measure_count, "MicroUnits without data",
                    (double)account->summary.no_data, "");
    fill_fit(account, d);
}

/* What was measured of the region, and what was bridged. Comes after the figures. */
void gsn_draft_bridge(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_bridge *b = &e->bridge;
    struct gsn_report *r = &d->report;
    const double share = b->region > 0 ? (double)b->bridged / (double)b->region : 0;

    if (b->region == 0)
        return;
    r->region.coverage = (double)b->measured / (double)b->region;
    gsn_draft_value(d->measure, &r->measure_count, "Region bridged between sections", 100 * share,
                    "%");
    gsn_draft_value(d->measure, &r->measure_count, "Standard error of the mean from bridging",
                    b->error, "density");
    if (share > BRIDGED_UNSAID)
        gsn_draft_warn(
            d,
            gsn_draft_say(d,
                          "%.1f %% of the region of interest was not seen and is bridged from the "
                          "sections beside it, which makes the mean density uncertain by %.2g",
                          100 * share, b->error));
}

void gsn_draft_tile(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_tile *t = e->tile;
    const double pixels = (double)t->overlap.pixels;

    d->tile = (struct gsn_report_tile){
        .area_fraction = t->collagen.area_fraction,
        .mean_density = t->collagen.mean_density,
        .threshold = t->collagen.threshold,
        .compared = t->compared,
        .mask_name = e->specimen->protocol->reference,
        .dice = t->compared ? t->overlap.dice : NAN,
        .map_fraction = t->compared ? (double)t->overlap.map_px / pixels : NAN,
        .mask_fraction = t->compared ? (double)t->overlap.reference_px / pixels : NAN,
        .false_positive = t->compared ? t->overlap.false_positive : NAN,
        .false_negative = t->compared ? t->overlap.false_negative : NAN,
    };
    d->report.tile = &d->tile;
    d->report.region.mean_density = t->collagen.mean_density;
    for (size_t i = 0; i < t->picture_count; i++)
        d->picture[i] =
            (struct gsn_report_picture){ .id = t->picture[i].id,
                                         .title = t->picture[i].title,
                                         .caption = t->picture[i].caption,
                                         .png = { t->picture[i].png, t->picture[i].size,
                                                  t->picture[i].width, t->picture[i].height } };
    d->report.pictures = d->picture;
    d->report.picture_count = t->picture_count;
    if (t->fit.deviation_deg[0] > 0)
        gsn_draft_value(d->measure, &d->report.measure_count, "red dye direction, uncertainty",
                        t->fit.deviation_deg[0], "deg");
    if (t->note[0])
        gsn_draft_warn(d, t->note);
}
