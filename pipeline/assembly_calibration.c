/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/assembly_parts.h"

#include "pipeline/core/file.h"
#include "pipeline/masking.h"

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
    gsn_auto_fd picture_fd = -1;
    int r;

    if (a->calibration[which])
        return GSN_OK;
    if (!sha256)
        return gsn_fail(err, GSN_E_STAIN,
                        "calibration panel %s did not come with the specimen: import it again with "
                        "the file beside job.json",
                        stated->file);
    r = specimen->open(specimen->context, sha256, &picture_fd, err);
    if (r < 0)
        return r;
    return gsn_calibration_panel_read(options->decoder, picture_fd, specimen->protocol, stated,
                                      &a->calibration[which], err);
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

    r = gsn_masking_tissue(scan, panel->given->number, a, &tissue, err);
    if (r >= 0 && !stated)
        return gsn_scan_dyes(scan, tissue, p, &panel->stain.fit, err);
    if (r < 0)
        return r;
    which = (size_t)(stated - p->calibration);
    r = know_calibration(specimen, options, which, a, err);
    return r < 0 ? r
                 : gsn_calibration_apply(a->calibration[which], scan, tissue, p, &panel->stain.fit,
                                         &panel->calibrated, err);
}
