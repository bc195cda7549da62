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
                                      .tets_in_tolerance =
                                          tets - fit->empty_tets - account->over_tolerance,
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

/* Volumes above a density are compared with the baseline's: on one scale, or not at all. Where the
 * dyes were measured the scale is theirs, as it is for the loss. */
void gsn_draft_check_volumes(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_protocol *p = e->specimen->protocol;
    const struct gsn_assembly *a = e->assembly;

    if (!a || e->specimen->baseline.specimens == 0 || d->linked ||
        !(d->by_colours || d->report.loss_reason) || a->by_standards ||
        (p->reference_tissue.kind != GSN_REGION_NONE && !a->not_comparable[0]))
        return;
    d->report.volume_count = 0;
    gsn_draft_warn(d, gsn_draft_say(d,
                                    "volumes above a density are withheld: too little untreated "
                                    "tissue is alike in this specimen and in %s to bring them to "
                                    "its scale; state \"reference\" in both jobs, or scan a "
                                    "calibration panel with standards",
                                    e->specimen->baseline.name));
}

/* Of the model and of the tissue; the latter only where sections are independent draws of it. */
static struct gsn_report_volume describe_volume(const struct gsn_account *account, size_t i)
{
    const struct gsn_volume_bound *const bound = &account->bound[i];
    const struct gsn_tissue_volume *const tissue = &account->tissue.volume[i];
    const int given = account->tissue.sigma_z_um > 0 && !account->tissue.withheld;

    return (struct gsn_report_volume){
        .threshold = bound->threshold,
        .lower_mm3 = 1e-9 * bound->lower_um3,
        .upper_mm3 = 1e-9 * bound->upper_um3,
        .estimate_mm3 = given ? 1e-9 * tissue->estimate_um3 : (double)NAN,
        .interval_lower_mm3 = given ? 1e-9 * tissue->lower_um3 : (double)NAN,
        .interval_upper_mm3 = given ? 1e-9 * tissue->upper_um3 : (double)NAN,
    };
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
        d->volume[i] = describe_volume(account, i);
    r->volumes = d->volume;
    r->volume_count = account->bound_count;
    if (account->tissue.withheld)
        gsn_draft_text(d->measure, &r->measure_count, "Volumes of the tissue above a density",
                       gsn_draft_say(d, "withheld: %s", account->tissue.withheld));
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
    gsn_draft_value(d->measure, &r->measure_count, "Micro-units, lower quartile of density",
                    account->summary.quartile1, "density");
    gsn_draft_value(d->measure, &r->measure_count, "Micro-units, upper quartile of density",
                    account->summary.quartile3, "density");
    gsn_draft_value(d->measure, &r->measure_count, "Micro-units with data",
                    (double)account->summary.ok, "");
    gsn_draft_value(d->measure, &r->measure_count, "Micro-units without data",
                    (double)account->summary.no_data, "");
    fill_fit(account, d);
}

/* What was measured of the region, and what was bridged. Comes after the figures. */
void gsn_draft_bridge(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_gap_interpolation *b = &e->bridge;
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

/* What the figures of a tile rest on, each as measured, as stated or as assumed. */
static void tell_origin(const struct gsn_tile *t, const struct gsn_protocol *p, struct gsn_draft *d)
{
    struct gsn_report_value *rows = d->parameter;
    size_t *count = &d->report.parameter_count;
    const double *white = t->glass.white;
    const char *codes = gsn_draft_say(d, "%.0f, %.0f, %.0f of 255", white[0], white[1], white[2]);

    gsn_draft_text(rows, count, "white",
                   p->has_white ? gsn_draft_say(d, "%s, as stated in job.json", codes)
                   : t->by_palest
                       ? gsn_draft_say(d,
                                       "%s, the palest %.2g %% of the picture; assumed to be the "
                                       "empty slide",
                                       codes, 100 * t->palest.share)
                       : gsn_draft_say(d,
                                       "%s, measured on the glass that is %.0f %% of the picture",
                                       codes, 100 * t->glass.fraction));
    if (t->px_um > 0)
        gsn_draft_text(rows, count, "pixel size",
                       gsn_draft_say(d, "%g um, as %s states", t->px_um,
                                     p->px_um > 0 ? "job.json" : "the file"));
    else
        gsn_draft_text(rows, count, "pixel size", "not known; no figure here needs it");
    gsn_draft_text(rows, count, "transfer curve",
                   t->light_assumed ? "sRGB, assumed: neither job.json nor the file says"
                   : p->transfer == GSN_STATED_LINEAR ? "linear, as stated in job.json"
                   : p->transfer == GSN_STATED_SRGB   ? "sRGB, as stated in job.json"
                                                      : "as the file states");
    gsn_draft_text(
        rows, count, "dye vectors",
        p->dyes == GSN_STATED_DYES_ESTIMATE
            ? gsn_draft_say(d, "%s, inferred from the picture as job.json asks", t->fit.dyes.name)
            : gsn_draft_say(d, "%s, %s, each %.1f degrees uncertain", t->fit.dyes.name,
                            p->dyes == GSN_STATED_DYES_BUILTIN ? "as stated in job.json"
                                                               : "assumed",
                            t->fit.deviation_deg[0]));
}

/* From here on a slide of sections would be refused (gsn_stain_fits()). */
static const double UNLIKE_DEG = 8;

static void warn_of_tile(const struct gsn_tile *t, const struct gsn_protocol *p,
                         struct gsn_draft *d)
{
    const int table = p->dyes == GSN_STATED_DYES_NONE;

    if (t->by_palest || t->light_assumed || table)
        gsn_draft_warn(
            d,
            gsn_draft_say(d, "assumed, because nobody stated it:%s%s%s%s%s",
                          t->by_palest ? " the palest part of the picture is the empty slide" : "",
                          t->by_palest && (t->light_assumed || table) ? ";" : "",
                          t->light_assumed ? " samples are coded as sRGB" : "",
                          t->light_assumed && table ? ";" : "",
                          table ? " the dyes are those of the built-in table" : ""));
    if (table && t->fit.apart_deg > UNLIKE_DEG)
        gsn_draft_warn(
            d,
            gsn_draft_say(d,
                          "half of the stained pixels lie more than %.0f degrees from every "
                          "mixture of Van Gieson's dyes, as picrosirius does: the density is the "
                          "built-in table's, to be compared with pictures of this stain alone; "
                          "\"dyes\": \"estimate\" in a job.json takes the picture's own",
                          t->fit.apart_deg));
    gsn_draft_warn(d, "how strongly the slide was stained one picture does not tell: a stain 20 % "
                      "stronger reads as 20 % more density and is in no interval; compare pictures "
                      "of one batch, or by the share of the red dye, which it does not change");
    if (t->by_palest && t->palest.clipped > 0.01)
        gsn_draft_warn(d,
                       gsn_draft_say(d,
                                     "%.0f %% of the samples that stand for white are at the "
                                     "highest code: the empty slide may be brighter, expose less",
                                     100 * t->palest.clipped));
    if (t->note[0])
        gsn_draft_warn(d, t->note);
}

void gsn_draft_tile(const struct gsn_evidence *e, struct gsn_draft *d)
{
    const struct gsn_protocol *p = e->specimen->protocol;
    const struct gsn_tile *t = e->tile;
    const double pixels = (double)t->overlap.pixels;
    struct gsn_report_value *rows = d->measure;
    size_t *count = &d->report.measure_count;

    d->tile = (struct gsn_report_tile){
        .area_fraction = t->collagen.area_fraction,
        .mean_density = t->density.mean,
        .mean_lower = t->density.mean - 1.96 * t->density.error,
        .mean_upper = t->density.mean + 1.96 * t->density.error,
        .red_share = t->density.red_share,
        .threshold = t->collagen.threshold,
        .compared = t->compared,
        .mask_name = p->reference,
        .dice = t->compared ? t->overlap.dice : NAN,
        .map_fraction = t->compared ? (double)t->overlap.map_px / pixels : NAN,
        .mask_fraction = t->compared ? (double)t->overlap.reference_px / pixels : NAN,
        .false_positive = t->compared ? t->overlap.false_positive : NAN,
        .false_negative = t->compared ? t->overlap.false_negative : NAN,
    };
    d->report.tile = &d->tile;
    d->report.region.mean_density = t->density.mean;
    for (size_t i = 0; i < t->picture_count; i++)
        d->picture[i] =
            (struct gsn_report_picture){ .id = t->picture[i].id,
                                         .title = t->picture[i].title,
                                         .caption = t->picture[i].caption,
                                         .png = { t->picture[i].png, t->picture[i].size,
                                                  t->picture[i].width, t->picture[i].height } };
    d->report.pictures = d->picture;
    d->report.picture_count = t->picture_count;
    gsn_draft_value(rows, count, "Standard error of the mean density by white", t->density.by_white,
                    "density");
    gsn_draft_value(rows, count, "Standard error of the mean density by detail and compression",
                    t->density.by_detail, "density");
    gsn_draft_value(rows, count, "Standard error of the mean density by dye vectors",
                    t->density.by_vectors, "density");
    gsn_draft_value(rows, count, "Red dye in the tissue, mean", t->density.red, "optical density");
    gsn_draft_value(rows, count, "Yellow dye in the tissue, mean", t->density.yellow,
                    "optical density");
    gsn_draft_value(rows, count, "Dark dye in the tissue, mean", t->density.dark,
                    "optical density");
    tell_origin(t, p, d);
    warn_of_tile(t, p, d);
}
