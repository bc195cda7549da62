/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/protocol.h"

#include <jansson.h>
#include <math.h>
#include <string.h>
#include <strings.h>

#include "pipeline/core/calendar.h"
#include "pipeline/core/nearest.h"
#include "pipeline/stated_region.h"
#include "pipeline/stated_value.h"

/* Limits that only a mistake exceeds. */
enum { MOST_SLOTS = 400, MOST_SECTIONS = 100000, MOST_PANELS = 10000 };

/* It stands behind the name of the dyes wherever that is kept. */
enum { LONGEST_BATCH = 20 };

#define REFERENCE_FORM                                                                             \
    "a mask file for a tile, or for sections {\"tissue\": a shape, \"density\": what it is taken " \
    "to be, at least 0.05}"

static int read_layout(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *layout = json_object_get(job, "layout");
    double n[2];

    if (!layout)
        return GSN_OK;
    if (gsn_stated_numbers(layout, 2, n) < 0 || n[0] < 1 || n[1] < 1 || n[0] * n[1] > MOST_SLOTS ||
        n[0] != floor(n[0]) || n[1] != floor(n[1]))
        return gsn_stated_bad(err, "layout",
                              "[rows, columns], two whole numbers with at most 400 slots");
    p->rows = (unsigned)n[0];
    p->columns = (unsigned)n[1];
    return GSN_OK;
}

static int read_markers(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *markers = json_object_get(job, "markers_um");

    if (!markers)
        return GSN_OK;
    for (size_t i = 0; i < 3; i++) {
        double xy[2];

        if (json_array_size(markers) != 3 ||
            gsn_stated_numbers(json_array_get(markers, i), 2, xy) < 0)
            return gsn_stated_bad(err, "markers_um", "three pairs [x, y] in micrometres");
        p->markers_um[i] = (struct gsn_point){ .x = xy[0], .y = xy[1] };
    }
    p->has_markers = 1;
    return GSN_OK;
}

static int read_thresholds(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *thresholds = json_object_get(job, "thresholds");
    const size_t count = json_array_size(thresholds);

    if (!thresholds)
        return GSN_OK;
    if (count < 1 || count > sizeof p->threshold / sizeof p->threshold[0] ||
        gsn_stated_numbers(thresholds, count, p->threshold) < 0)
        return gsn_stated_bad(err, "thresholds", "one to eight numbers");
    p->threshold_count = count;
    return GSN_OK;
}

/* Of sections it is the tissue that tells how strong the stain is, of a tile a mask. */
static int read_reference(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *reference = json_object_get(job, "reference");
    const json_t *tissue = json_object_get(reference, "tissue");
    const int r = gsn_stated_text(job, "batch", &p->batch, err);

    if (r < 0)
        return r;
    if (strlen(p->batch) > LONGEST_BATCH)
        return gsn_stated_bad(err, "batch", "a name of at most 20 bytes");
    if (!json_is_object(reference)) {
        if (reference && p->kind == GSN_KIND_SECTIONS)
            return gsn_stated_bad(err, "reference", REFERENCE_FORM);
        return gsn_stated_text(job, "reference", &p->reference, err);
    }
    p->reference = gsn_strdup("");
    if (!p->reference)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    if (p->kind != GSN_KIND_SECTIONS || !json_is_object(tissue) ||
        gsn_stated_number(reference, "density", 0.05, 1000, &p->reference_density, NULL) < 0 ||
        !(p->reference_density > 0))
        return gsn_stated_bad(err, "reference", REFERENCE_FORM);
    return gsn_stated_shape_read(tissue, "tissue", &p->reference_tissue, err);
}

static int read_strain(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const words[] = { "reported", "rigid", "corrected", "tissue", NULL };
    int strain = GSN_STATED_STRAIN_REPORTED;
    const int r = gsn_stated_word(job, "strain", words, &strain, err);

    if (r >= 0)
        p->strain = (enum gsn_stated_strain)strain;
    return r;
}

/* By what the sections are laid, and in whose frame. Strain is what the marks show. */
static int read_registration(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const words[] = { "marks+tissue", "marks", "tissue", NULL };
    const json_t *frame = json_object_get(job, "frame");
    int registration = GSN_STATED_MARKS_AND_TISSUE;
    const int r = gsn_stated_word(job, "registration", words, &registration, err);
    double at[2];

    if (r < 0)
        return r;
    p->registration = (enum gsn_stated_registration)registration;
    if (p->registration == GSN_STATED_TISSUE &&
        (p->strain == GSN_STATED_STRAIN_CORRECTED || p->strain == GSN_STATED_STRAIN_TISSUE))
        return gsn_stated_bad(err, "strain",
                              "\"reported\" or \"rigid\" where \"registration\" is \"tissue\": "
                              "only marks show how far a section is stretched");
    if (!frame)
        return GSN_OK;
    if (p->registration != GSN_STATED_TISSUE)
        return gsn_stated_bad(err, "frame",
                              "left out unless \"registration\" is \"tissue\": the marks are the "
                              "frame");
    if (gsn_stated_numbers(frame, 2, at) < 0 || at[0] < 1 || at[1] < 1 || at[0] != floor(at[0]) ||
        at[1] != floor(at[1]) || at[0] > MOST_PANELS || at[1] > p->rows * p->columns)
        return gsn_stated_bad(err, "frame",
                              "[panel, slot], two whole numbers counted from 1: the section whose "
                              "panel's picture the coordinates are taken from");
    p->frame_panel = (unsigned)at[0];
    p->frame_slot = (unsigned)at[1];
    return GSN_OK;
}

/* Sections without marks have no frame but that of one of them, and any of them lies turned and
 * shifted: coordinates say nothing without the section that they were taken from. */
static int check_frame(const struct gsn_protocol *p, struct gsn_error *err)
{
    const int region = gsn_region_has_coordinates(&p->region);

    if (p->registration != GSN_STATED_TISSUE || p->frame_panel > 0 ||
        (!region && !gsn_region_has_coordinates(&p->reference_tissue)))
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT,
                    "job.json: \"%s\" has coordinates: where \"registration\" is \"tissue\" they "
                    "need \"frame\": [panel, slot], the section whose panel's picture they were "
                    "taken from; a band from a tissue needs none",
                    region ? "region" : "reference");
}

/* When the stain was made and when it was scanned, and what its batch's control glass allows. */
static int read_stain(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *limits = json_object_get(job, "yellow_to_red");
    long stained = 0, scanned = 0;
    int r = gsn_stated_text(job, "stained", &p->stained, err);

    if (r >= 0)
        r = gsn_stated_text(job, "scanned", &p->scanned, err);
    if (r < 0)
        return r;
    if (p->stained[0] && gsn_calendar_day(p->stained, &stained, NULL) < 0)
        return gsn_stated_bad(err, "stained", "a date such as \"2026-03-31\"");
    if (p->scanned[0] && gsn_calendar_day(p->scanned, &scanned, NULL) < 0)
        return gsn_stated_bad(err, "scanned", "a date such as \"2026-03-31\"");
    if (p->stained[0] && p->scanned[0] && scanned < stained)
        return gsn_stated_bad(err, "scanned", "no earlier than \"stained\"");
    if (p->stained[0] && p->scanned[0])
        p->days_to_scan = (double)(scanned - stained);
    if (limits && (gsn_stated_numbers(limits, 2, p->yellow_to_red) < 0 ||
                   !(p->yellow_to_red[0] > 0) || !(p->yellow_to_red[0] < p->yellow_to_red[1])))
        return gsn_stated_bad(err, "yellow_to_red",
                              "[low, high], above 0, as the batch's control glass says");
    return GSN_OK;
}

static int read_calibration(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *stated = json_object_get(job, "calibration");

    if (stated && p->kind != GSN_KIND_SECTIONS)
        return gsn_stated_bad(err, "calibration", "left out: it is of panels of sections");
    return gsn_stated_calibrations_read(stated, &p->calibration, &p->calibration_count, err);
}

static int read_light(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const transfers[] = { "unknown", "linear", "srgb", NULL };
    static const char *const dyes[] = { "builtin", "estimate", NULL };
    const json_t *white = json_object_get(job, "white");
    int transfer = GSN_STATED_UNKNOWN, vectors = -1;
    int r;

    r = gsn_stated_word(job, "transfer", transfers, &transfer, err);
    if (r >= 0)
        r = gsn_stated_word(job, "dyes", dyes, &vectors, err);
    if (r < 0)
        return r;
    p->transfer = (enum gsn_stated_transfer)transfer;
    p->dyes = (enum gsn_stated_dyes)(vectors + 1);
    if (!white)
        return GSN_OK;
    if (gsn_stated_numbers(white, 3, p->white) < 0 || !(p->white[0] > 0 && p->white[0] <= 1) ||
        !(p->white[1] > 0 && p->white[1] <= 1) || !(p->white[2] > 0 && p->white[2] <= 1))
        return gsn_stated_bad(err, "white",
                              "three codes as fractions of full scale, above 0 and up to 1");
    p->has_white = 1;
    return GSN_OK;
}

static int read_names(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const struct {
        const char *key;
        char **text;
    } names[] = { { "specimen", &p->specimen }, { "study", &p->study },
                  { "group", &p->group },       { "animal", &p->animal },
                  { "baseline", &p->baseline }, { "file", &p->file } };

    for (size_t i = 0; i < sizeof names / sizeof names[0]; i++) {
        const int r = gsn_stated_text(job, names[i].key, names[i].text, err);

        if (r < 0)
            return r;
    }
    if (!p->specimen[0])
        return gsn_fail(err, GSN_E_INPUT, "job.json: \"specimen\" is missing: name the specimen");
    if (strcmp(p->baseline, p->specimen) == 0 && p->baseline[0])
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"baseline\" names the specimen itself; leave it out for a "
                        "control");
    return GSN_OK;
}

static int read_collagen_free(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *tissue = json_object_get(job, "collagen_free");

    if (!tissue)
        return GSN_OK;
    if (p->kind != GSN_KIND_SECTIONS || !json_is_object(tissue))
        return gsn_stated_bad(err, "collagen_free",
                              "a shape of tissue without collagen, for sections only");
    return gsn_stated_shape_read(tissue, "collagen_free", &p->collagen_free, err);
}

/* What other programs, or other people, call our keys. */
static const char *meant_by_beginning(const char *key)
{
    static const char *const other[][2] = {
        { "pixel", "px_um" },
        { "mpp", "px_um" },
        { "resolution", "px_um" },
        { "spacing", "interval_um" },
        { "distance", "interval_um" },
        { "thickness", "interval_um" },
        { "roi", "region" },
        { "mask", "region" },
        { "control", "baseline" },
        { "name", "specimen" },
        { "id", "specimen" },
        { "note", "comment" },
        { "grid", "layout" },
        { "rows", "layout" },
        { "columns", "layout" },
        { "marks", "markers_um" },
        { "fiducial", "markers_um" },
        { "//", "comment" },
        { "_", "comment" },
        { "unit", "spacing_unit" },
    };

    for (size_t i = 0; i < sizeof other / sizeof other[0]; i++)
        if (strncasecmp(key, other[i][0], strlen(other[i][0])) == 0)
            return other[i][1];
    return NULL;
}

/* Keys we do not know stop the import (systemd/worker/import.c), for a misspelt one must not pass.
 * Here they are only noted: stores hold jobs of older versions. "comment" and what begins with it
 * is the operator's. */
static int note_unknown_keys(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const known[] = {
        "specimen",  "study",       "group",        "animal",   "week",          "px_um",
        "voxel_um",  "interval_um", "panels",       "layout",   "order",         "sections",
        "region",    "markers_um",  "baseline",     "transfer", "dyes",          "white",
        "kind",      "thresholds",  "tolerance",    "file",     "reference",     "batch",
        "comment",   "strain",      "stained",      "scanned",  "yellow_to_red", "level",
        "target_um", "calibration", "registration", "frame",    "spacing_unit",  "collagen_free"
    };
    const size_t count = sizeof known / sizeof known[0];
    void *at = json_object_iter((json_t *)(uintptr_t)job);

    for (; at; at = json_object_iter_next((json_t *)(uintptr_t)job, at)) {
        const char *key = json_object_iter_key(at);
        size_t i = 0;
        char *more;

        while (i < count && strcmp(key, known[i]) != 0)
            i++;
        if (i < count || strncmp(key, "comment", strlen("comment")) == 0)
            continue;
        if (!p->unknown) {
            const char *near = meant_by_beginning(key);

            p->unknown_near = near ? near : gsn_nearest(key, known, count);
        }
        more =
            gsn_format("%s%s\"%.60s\"", p->unknown ? p->unknown : "", p->unknown ? ", " : "", key);
        if (!more)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
        gsn_free(p->unknown);
        p->unknown = more;
    }
    return GSN_OK;
}

static int read_all(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const orders[] = { "row", "column", "snake", NULL };
    static const char *const kinds[] = { "sections", "volume", "tile", NULL };
    static const char *const units[] = { "um", "mm", NULL };
    int order = GSN_STATED_ROW, kind = GSN_KIND_SECTIONS, unit = -1;
    int r;

    if ((r = note_unknown_keys(job, p, err)) < 0 || (r = read_names(job, p, err)) < 0 ||
        (r = gsn_stated_word(job, "kind", kinds, &kind, err)) < 0 ||
        (r = gsn_stated_word(job, "order", orders, &order, err)) < 0 ||
        (r = gsn_stated_word(job, "spacing_unit", units, &unit, err)) < 0 ||
        (r = gsn_stated_number(job, "week", 0, 10000, &p->week, err)) < 0 ||
        (r = gsn_stated_number(job, "px_um", 0.01, 1000, &p->px_um, err)) < 0 ||
        (r = gsn_stated_number(job, "level", 0, 31, &p->level, err)) < 0 ||
        (r = gsn_stated_number(job, "target_um", 0.01, 1000, &p->target_um, err)) < 0 ||
        (r = gsn_stated_number(job, "interval_um", 0.1, 10000, &p->interval_um, err)) < 0 ||
        (r = gsn_stated_number(job, "voxel_um", 0.01, 1000, &p->voxel_um, err)) < 0 ||
        (r = gsn_stated_number(job, "tolerance", 1e-9, 1e9, &p->tolerance, err)) < 0 ||
        (r = gsn_stated_count(job, "panels", MOST_PANELS, &p->panels, err)) < 0 ||
        (r = gsn_stated_count(job, "sections", MOST_SECTIONS, &p->sections, err)) < 0 ||
        (r = read_layout(job, p, err)) < 0 || (r = read_markers(job, p, err)) < 0 ||
        (r = read_thresholds(job, p, err)) < 0 ||
        (r = gsn_stated_region_read(job, &p->region, err)) < 0 ||
        (r = read_strain(job, p, err)) < 0 || (r = read_registration(job, p, err)) < 0 ||
        (r = read_light(job, p, err)) < 0 || (r = read_stain(job, p, err)) < 0)
        return r;
    p->kind = (enum gsn_kind)kind;
    p->order = (enum gsn_stated_order)order;
    p->spacing_unit = (enum gsn_spacing_unit)(unit + 1);
    r = read_reference(job, p, err);
    if (r >= 0)
        r = read_collagen_free(job, p, err);
    if (r >= 0)
        r = read_calibration(job, p, err);
    if (r >= 0)
        r = check_frame(p, err);
    if (r < 0)
        return r;
    if (p->level > floor(p->level) || (p->target_um > 0 && !isnan(p->level)))
        return gsn_fail(
            err, GSN_E_INPUT,
            "job.json: \"level\" is a whole number, 0 for the finest, and \"target_um\" "
            "stands in its place, not beside it");
    if (p->kind != GSN_KIND_SECTIONS && !p->file[0])
        return gsn_fail(err, GSN_E_INPUT, "job.json: \"file\" is missing: name the %s",
                        kind == GSN_KIND_VOLUME ? "volume" : "picture");
    return GSN_OK;
}

int gsn_protocol_parse(const char *text, size_t size, struct gsn_protocol **ret_protocol,
                       struct gsn_error *err)
{
    gsn_auto(gsn_protocol) p = gsn_alloc_array(1, sizeof *p);
    json_error_t where;
    json_t *job;
    int r;

    if (!p)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    p->week = NAN;
    p->days_to_scan = NAN;
    p->level = NAN;
    p->interval_um = 24;
    p->rows = 3;
    p->columns = 4;
    job = json_loadb(text, size, JSON_REJECT_DUPLICATES, &where);
    if (!job)
        return gsn_fail(err, GSN_E_INPUT, "job.json: line %d: %s%s", where.line, where.text,
                        strstr(where.text, "expected near '}'") ||
                                strstr(where.text, "unexpected token near ']'")
                            ? ": is there a comma too many before it?"
                        : strstr(where.text, "expected near")
                            ? ": is a comma or a quotation mark missing before it?"
                            : "");
    r = json_is_object(job) ? read_all(job, p, err)
                            : gsn_fail(err, GSN_E_INPUT, "job.json: not a JSON object");
    json_decref(job);
    if (r < 0)
        return r;
    *ret_protocol = gsn_steal(&p);
    return GSN_OK;
}

void gsn_protocol_free(struct gsn_protocol *p)
{
    if (!p)
        return;
    gsn_free(p->specimen);
    gsn_free(p->study);
    gsn_free(p->group);
    gsn_free(p->animal);
    gsn_free(p->baseline);
    gsn_free(p->file);
    gsn_free(p->reference);
    gsn_stated_calibrations_free(p->calibration, p->calibration_count);
    gsn_free(p->batch);
    gsn_free(p->stained);
    gsn_free(p->scanned);
    gsn_free(p->unknown);
    gsn_free(p->region.file);
    gsn_free(p);
}

unsigned gsn_protocol_sections(const struct gsn_protocol *p)
{
    const unsigned slots = p->panels * p->rows * p->columns;

    return p->sections && (p->sections < slots || !slots) ? p->sections : slots;
}
