/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include <math.h>

/* Whether every panel with sections has standards, so that all are on one scale. */
static int all_have_standards(const struct gsn_specimen *specimen)
{
    const struct gsn_protocol *p = specimen->protocol;

    for (size_t i = 0; i < specimen->panel_count; i++) {
        const struct gsn_stated_calibration *stated = gsn_stated_calibration_of(
            p->calibration, p->calibration_count, specimen->panel[i].number);

        if (specimen->panel[i].section_count > 0 &&
            (!stated || !gsn_stated_calibration_has_standards(stated)))
            return 0;
    }
    return p->calibration_count > 0;
}

int gsn_assembly_place_calibrations(const struct gsn_specimen *specimen, struct gsn_assembly *a,
                                    struct gsn_error *err)
{
    const size_t count = specimen->protocol->calibration_count;

    if (count == 0)
        return GSN_OK;
    a->calibration = gsn_alloc_array(count, sizeof(struct gsn_calibration_panel *));
    if (!a->calibration)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the calibration panels");
    a->calibration_count = count;
    a->by_standards = !a->tissue_grid && all_have_standards(specimen);
    return GSN_OK;
}

/* A panel of several slides is read once. */
static int know_calibration(const struct gsn_specimen *specimen,
                            const struct gsn_specimen_options *options, size_t which,
                            struct gsn_assembly *a, struct gsn_error *err)
{
    const struct gsn_stated_calibration *stated = &specimen->protocol->calibration[which];
    const char *sha256 = specimen->calibration_sha256 ? specimen->calibration_sha256[which] : NULL;
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size;
    int r;

    if (a->calibration[which])
        return GSN_OK;
    if (!sha256)
        return gsn_fail(err, GSN_E_STAIN,
                        "calibration panel %s did not come with the specimen: import it again with "
                        "the file beside job.json",
                        stated->file);
    r = specimen->read(specimen->context, sha256, &bytes, &size, err);
    if (r < 0)
        return r;
    return gsn_calibration_panel_read(options->decoder, bytes, size, specimen->protocol, stated,
                                      &a->calibration[which], err);
}

/* Around a mark, in its radii: char is no dye. */
static const double MARK_REACH = 3;

static int near_mark(const struct gsn_panel_section *seen, double x, double y)
{
    for (int m = 0; m < GSN_MARKS; m++)
        if (seen->mark[m].found && hypot(x - seen->mark[m].px.x, y - seen->mark[m].px.y) <=
                                       MARK_REACH * seen->mark[m].radius_px)
            return 1;
    return 0;
}

/* gives: the boxes of the panel's sections without their marks; labels and ink lie elsewhere. */
static int tissue_of(const struct gsn_scan *scan, const struct gsn_assembly *a, unsigned panel,
                     struct gsn_image **ret_tissue, struct gsn_error *err)
{
    const struct gsn_plane *od = scan->od[0];
    const int apart = (int)scan->apart;
    gsn_auto(gsn_image) tissue = NULL;
    const int r = gsn_image_new(od->width, od->height, 1, 8, &tissue, err);

    if (r < 0)
        return r;
    for (size_t i = 0; i < a->section_count; i++) {
        const struct gsn_panel_section *seen = &a->section[i].seen;

        if (a->section[i].panel != panel)
            continue;
        for (int y = seen->y / apart; y < (seen->y + seen->height) / apart; y++)
            for (int x = seen->x / apart; x < (seen->x + seen->width) / apart; x++)
                ((uint8_t *)tissue->samples)[(size_t)y * od->width + (size_t)x] =
                    !near_mark(seen, x * apart + 0.5, y * apart + 0.5);
    }
    *ret_tissue = gsn_steal(&tissue);
    return GSN_OK;
}

int gsn_assembly_find_dyes(const struct gsn_specimen *specimen,
                           const struct gsn_specimen_options *options, const struct gsn_scan *scan,
                           struct gsn_assembly *a, struct gsn_assembly_panel *panel,
                           struct gsn_error *err)
{
    const struct gsn_protocol *p = specimen->protocol;
    const struct gsn_stated_calibration *stated =
        gsn_stated_calibration_of(p->calibration, p->calibration_count, panel->given->number);
    gsn_auto(gsn_image) tissue = NULL;
    size_t which;
    int r;

    if (!stated)
        return gsn_scan_dyes(scan, p, &panel->stain.fit, err);
    which = (size_t)(stated - p->calibration);
    r = know_calibration(specimen, options, which, a, err);
    if (r >= 0)
        r = tissue_of(scan, a, panel->given->number, &tissue, err);
    return r < 0 ? r
                 : gsn_calibration_apply(a->calibration[which], scan, tissue, p, &panel->stain.fit,
                                         &panel->calibrated, err);
}
