/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What can be told of a job before anything is written and an hour is spent.
 *
 * Refused is what can only be a mistake: a key that nobody knows, lengths that no laser, saw or
 * microscope makes (so they are in another unit), a volume that does not say its unit. Told is what
 * will be withheld as things are, each with what would change that, and how many panels are here of
 * those stated; these are no mistakes, for panels, regions and baselines may come later. */
#include "systemd/import_parts.h"

#include "acquire/container.h"
#include "pipeline/core/file.h"
#include "pipeline/decode/volume.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"

#include <dirent.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

enum { MOST_HEADER_BYTES = 1 << 30, HEADER_BYTES = 65536 };

/* Lengths in micrometres beyond which a mistake is likelier than a specimen. Light resolves 0.2 um,
 * and a pixel of more than 100 um shows no mark (the largest burnt is 600 um across); a block is
 * 0.1 mm to 30 cm wide; a microtome cuts no thinner than 0.5 um. */
static const double FINEST_PX = 0.05, COARSEST_PX = 200;
static const double NARROWEST = 100, WIDEST = 3e5;
static const double THINNEST = 0.5;
/* The least region that holds a section's worth of pixels. */
static const double LEAST_REGION = 20;

static int refuse_unit(struct gsn_error *err, const char *key, const char *what, double value,
                       const char *unit, double factor)
{
    return gsn_fail(
        err, GSN_E_INPUT,
        "job.json: \"%s\" states %s of %.4g um; is that in %s? Lengths are micrometres: "
        "state %.6g",
        key, what, value, unit, value * factor);
}

static int check_keys(const struct gsn_protocol *p, struct gsn_error *err)
{
    if (!p->unknown)
        return GSN_OK;
    if (p->unknown_near && strcmp(p->unknown_near, "comment") == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: %s is no key; a note goes under \"comment\" or any key that "
                        "begins with it",
                        p->unknown);
    if (p->unknown_near)
        return gsn_fail(
            err, GSN_E_INPUT,
            "job.json: %s is no key: did you mean \"%s\"? man gieson-job lists all; notes go "
            "under \"comment\"",
            p->unknown, p->unknown_near);
    return gsn_fail(err, GSN_E_INPUT,
                    "job.json: %s is no key: man gieson-job lists all; notes go under \"comment\"",
                    p->unknown);
}

static int check_pixel(const struct gsn_protocol *p, struct gsn_error *err)
{
    if (p->px_um > 0 && p->px_um < FINEST_PX)
        return refuse_unit(err, "px_um", "pixels", p->px_um, "millimetres", 1000);
    if (p->px_um > COARSEST_PX)
        return refuse_unit(err, "px_um", "pixels", p->px_um, "nanometres", 0.001);
    if (p->interval_um < THINNEST)
        return refuse_unit(err, "interval_um", "sections", p->interval_um, "millimetres", 1000);
    return GSN_OK;
}

static int check_markers(const struct gsn_protocol *p, struct gsn_error *err)
{
    double longest = 0;

    if (!p->has_markers)
        return GSN_OK;
    for (int i = 0; i < 3; i++) {
        const struct gsn_point a = p->markers_um[i], b = p->markers_um[(i + 1) % 3];

        longest = fmax(longest, hypot(a.x - b.x, a.y - b.y));
    }
    if (longest < NARROWEST)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"markers_um\" states marks at most %.4g um apart; are they in "
                        "millimetres? Lengths are micrometres: multiply them by 1000",
                        longest);
    if (longest > WIDEST)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"markers_um\" states marks %.4g um apart; are they in "
                        "nanometres? Lengths are micrometres: divide them by 1000",
                        longest);
    return GSN_OK;
}

static int check_region(const struct gsn_protocol *p, struct gsn_error *err)
{
    const struct gsn_region *region = &p->region;
    double size = INFINITY;

    if (region->kind == GSN_REGION_BOX)
        size = fmax(region->high.x - region->low.x, region->high.y - region->low.y);
    if (region->kind == GSN_REGION_CYLINDER || region->kind == GSN_REGION_SPHERE)
        size = 2 * region->radius_um;
    if (p->kind == GSN_KIND_SECTIONS && size < LEAST_REGION)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"region\" is %.4g um wide; is it in millimetres? Lengths are "
                        "micrometres: multiply them by 1000",
                        size);
    return GSN_OK;
}

/* Of a volume, or of a mask: its header must say its unit, or the job. */
static int check_unit(const struct gsn_import *import, const struct gsn_protocol *p,
                      const char *file, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_fd fd = -1;
    size_t size = 0;
    int r;

    if (p->spacing_unit != GSN_SPACING_UNSAID)
        return GSN_OK;
    r = gsn_file_open_in(import->dir, file, &fd, err);
    if (r >= 0)
        r = gsn_file_read_open(fd, file, MOST_HEADER_BYTES, &bytes, &size, err);
    if (r < 0)
        return r;
    if (gsn_volume_states_unit((const char *)bytes, size < HEADER_BYTES ? size : HEADER_BYTES))
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "%s does not say in what its spacing is: ITK and Slicer write millimetres. Say "
                    "--spacing-unit mm or um (in a job.json \"spacing_unit\")",
                    file);
}

int gsn_import_check_job(const struct gsn_import *import, const struct gsn_protocol *p,
                         struct gsn_error *err)
{
    int r = check_keys(p, err);

    if (r >= 0)
        r = check_pixel(p, err);
    if (r >= 0)
        r = check_markers(p, err);
    if (r >= 0)
        r = check_region(p, err);
    if (r >= 0 && p->kind == GSN_KIND_VOLUME)
        r = check_unit(import, p, p->file, err);
    return r;
}

/* ---- what will be withheld ---------------------------------------------------------------- */

static void tell(const struct gsn_import_work *in, const char *sentence)
{
    if (in->import->notice)
        in->import->notice(in->import->context, "job.json", sentence);
}

static int tell_baseline(const struct gsn_import_work *in, struct gsn_error *err)
{
    const struct gsn_protocol *p = in->protocol;
    gsn_auto(gsn_specimen_rows) rows = NULL;
    char sentence[400];
    int r;

    if (!p->baseline[0])
        return GSN_OK;
    r = gsn_specimen_baseline(in->import->store, p->study, p->baseline, &rows, err);
    if (r < 0)
        return r;
    if (rows->count == 0) {
        (void)snprintf(sentence, sizeof sentence,
                       "no specimen or group \"%.200s\" is in the store%s%.60s%s: the loss waits "
                       "until its panels are imported",
                       p->baseline, p->study[0] ? " in study \"" : "", p->study,
                       p->study[0] ? "\"" : "");
        tell(in, sentence);
    }
    if (p->calibration_count == 0)
        tell(in, "no \"calibration\" is stated: the loss will have a wide interval or be withheld; "
                 "a calibration panel of the batch narrows it");
    return GSN_OK;
}

int gsn_import_tell_job(const struct gsn_import_work *in, struct gsn_error *err)
{
    const struct gsn_protocol *p = in->protocol;
    gsn_auto(gsn_panel_rows) panels = NULL;
    char sentence[200];
    int r;

    if (p->kind != GSN_KIND_SECTIONS)
        return GSN_OK;
    r = gsn_panel_list(in->import->store, in->specimen, &panels, err);
    if (r < 0)
        return r;
    if (panels->count == 0)
        tell(in, "no panel lies beside it: copy the scans into this folder and import it again");
    else if (p->panels > 0 && panels->count != p->panels) {
        (void)snprintf(sentence, sizeof sentence, "it states %u panel%s, %zu %s here: %s",
                       p->panels, p->panels == 1 ? "" : "s", panels->count,
                       panels->count == 1 ? "is" : "are",
                       panels->count < p->panels
                           ? "import the rest, or say which are lost with `gieson decide`"
                           : "take the others out of the folder, or put \"panels\" right");
        tell(in, sentence);
    }
    if (p->region.kind == GSN_REGION_NONE)
        tell(in, "no \"region\" is stated: the figures will be withheld");
    else if (!p->has_markers && p->region.kind != GSN_REGION_BAND)
        tell(in,
             "\"region\" is stated and \"markers_um\" is not: nobody knows where it lies in the "
             "block, so the figures will be withheld");
    return tell_baseline(in, err);
}
