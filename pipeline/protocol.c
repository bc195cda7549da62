/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/protocol.h"

#include "pipeline/stain/age.h"

#include <jansson.h>
#include <math.h>
#include <string.h>

/* Limits that only a mistake exceeds. */
enum { MOST_SLOTS = 400, MOST_SECTIONS = 100000, LONGEST_NAME = 1000 };

static int bad(struct gsn_error *err, const char *key, const char *wanted)
{
    return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be %s", key, wanted);
}

/* It stands behind the name of the dyes wherever that is kept. */
enum { LONGEST_BATCH = 20 };

#define REFERENCE_FORM                                                                             \
    "a mask file for a tile, or for sections {\"tissue\": a shape, \"density\": what it is taken " \
    "to be, at least 0.05}"

static int get_text(const json_t *job, const char *key, char **text, struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (value && (!json_is_string(value) || json_string_length(value) > LONGEST_NAME ||
                  strlen(json_string_value(value)) != json_string_length(value)))
        return bad(err, key, "text of at most 1000 bytes");
    *text = gsn_strdup(value ? json_string_value(value) : "");
    return *text ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
}

static int get_number(const json_t *job, const char *key, double low, double high, double *number,
                      struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (!value)
        return GSN_OK;
    if (!json_is_number(value) || !(json_number_value(value) >= low) ||
        !(json_number_value(value) <= high))
        return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be a number from %g to %g", key,
                        low, high);
    *number = json_number_value(value);
    return GSN_OK;
}

static int get_count(const json_t *job, const char *key, unsigned most, unsigned *count,
                     struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (!value)
        return GSN_OK;
    if (!json_is_integer(value) || json_integer_value(value) < 1 ||
        json_integer_value(value) > (json_int_t)most)
        return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be a whole number from 1 to %u",
                        key, most);
    *count = (unsigned)json_integer_value(value);
    return GSN_OK;
}

/* One of several words; *chosen is left alone when the key is absent. */
static int get_word(const json_t *job, const char *key, const char *const *words, int *chosen,
                    struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (!value)
        return GSN_OK;
    for (int i = 0; words[i]; i++)
        if (json_is_string(value) && strcmp(json_string_value(value), words[i]) == 0) {
            *chosen = i;
            return GSN_OK;
        }
    return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be one of \"%s\", \"%s\"%s%s%s", key,
                    words[0], words[1], words[2] ? ", \"" : "", words[2] ? words[2] : "",
                    words[2] ? "\"" : "");
}

static int get_numbers(const json_t *array, size_t count, double *numbers)
{
    if (!json_is_array(array) || json_array_size(array) != count)
        return -1;
    for (size_t i = 0; i < count; i++) {
        const json_t *value = json_array_get(array, i);

        if (!json_is_number(value) || !isfinite(json_number_value(value)))
            return -1;
        numbers[i] = json_number_value(value);
    }
    return 0;
}

static int read_layout(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *layout = json_object_get(job, "layout");
    double n[2];

    if (!layout)
        return GSN_OK;
    if (get_numbers(layout, 2, n) < 0 || n[0] < 1 || n[1] < 1 || n[0] * n[1] > MOST_SLOTS ||
        n[0] != floor(n[0]) || n[1] != floor(n[1]))
        return bad(err, "layout", "[rows, columns], two whole numbers with at most 400 slots");
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

        if (json_array_size(markers) != 3 || get_numbers(json_array_get(markers, i), 2, xy) < 0)
            return bad(err, "markers_um", "three pairs [x, y] in micrometres");
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
        get_numbers(thresholds, count, p->threshold) < 0)
        return bad(err, "thresholds", "one to eight numbers");
    p->threshold_count = count;
    return GSN_OK;
}

static int read_box(const json_t *shape, struct gsn_region *region)
{
    double low[3], high[3];

    if (get_numbers(json_object_get(shape, "min"), 3, low) < 0 ||
        get_numbers(json_object_get(shape, "max"), 3, high) < 0)
        return -1;
    region->low = gsn_vec3_make(low[0], low[1], low[2]);
    region->high = gsn_vec3_make(high[0], high[1], high[2]);
    return low[0] < high[0] && low[1] < high[1] && low[2] < high[2] ? 0 : -1;
}

static int read_round(const json_t *shape, struct gsn_region *region)
{
    const json_t *radius = json_object_get(shape, "radius");
    double centre[3] = { 0 }, z[2];

    if (get_numbers(json_object_get(shape, "centre"), region->kind == GSN_REGION_SPHERE ? 3 : 2,
                    centre) < 0)
        return -1;
    region->centre = gsn_vec3_make(centre[0], centre[1], centre[2]);
    region->radius_um = json_is_number(radius) ? json_number_value(radius) : 0;
    if (region->kind == GSN_REGION_CYLINDER) {
        if (get_numbers(json_object_get(shape, "z"), 2, z) < 0 || !(z[0] < z[1]))
            return -1;
        region->low.z = z[0];
        region->high.z = z[1];
    }
    return region->radius_um > 0 ? 0 : -1;
}

static int read_shape(const json_t *shape_of, const char *key, struct gsn_region *region,
                      struct gsn_error *err)
{
    static const char *const shapes[] = { "box", "cylinder", "sphere", NULL };
    int shape = -1;
    const int r = get_word(shape_of, "shape", shapes, &shape, err);

    if (r < 0)
        return r;
    if (shape >= 0)
        region->kind = (enum gsn_region_kind)(GSN_REGION_BOX + shape);
    if (shape < 0 || (shape == 0 ? read_box(shape_of, region) : read_round(shape_of, region)))
        return bad(err, key,
                   "{\"shape\": \"box\", \"min\": [x,y,z], \"max\": [x,y,z]}, {\"shape\": "
                   "\"cylinder\", \"centre\": [x,y], \"radius\": r, \"z\": [from,to]} or "
                   "{\"shape\": \"sphere\", \"centre\": [x,y,z], \"radius\": r}");
    return GSN_OK;
}

static const char BAND[] =
    "{\"kind\": \"band\", \"from\": \"root\", \"bone\", \"tissue\" or a mask file, \"low_um\": a, "
    "\"high_um\": b above a}, "
    "with or without \"z\": [from,to] and \"within\": {\"centre\": [x,y], \"radius\": r}";

/* The cylinder and the z range that limit a band, where they are stated. */
static int read_limits(const json_t *band, struct gsn_region *region)
{
    const json_t *z = json_object_get(band, "z"), *within = json_object_get(band, "within");
    double range[2] = { -INFINITY, INFINITY }, centre[2] = { 0 };
    const json_t *radius = json_object_get(within, "radius");

    if (z && (get_numbers(z, 2, range) < 0 || !(range[0] < range[1])))
        return -1;
    if (within && (get_numbers(json_object_get(within, "centre"), 2, centre) < 0 ||
                   !(json_number_value(radius) > 0)))
        return -1;
    region->low.z = range[0];
    region->high.z = range[1];
    region->centre = gsn_vec3_make(centre[0], centre[1], 0);
    region->radius_um = within ? json_number_value(radius) : 0;
    return 0;
}

static int read_band(const json_t *band, struct gsn_region *region, struct gsn_error *err)
{
    const json_t *from = json_object_get(band, "from");
    const json_t *low = json_object_get(band, "low_um"), *high = json_object_get(band, "high_um");

    region->kind = GSN_REGION_BAND;
    region->low_um = json_number_value(low);
    region->high_um = json_number_value(high);
    if (!json_is_string(from) || !json_string_value(from)[0] || !json_is_number(low) ||
        !json_is_number(high) || !(region->low_um < region->high_um) || !isfinite(region->low_um) ||
        !isfinite(region->high_um) || read_limits(band, region) < 0)
        return bad(err, "region", BAND);
    for (enum gsn_tissue_kind k = GSN_TISSUE_ROOT; k < GSN_TISSUE_BODIES; k++)
        if (strcmp(json_string_value(from), gsn_tissue_name(k)) == 0) {
            region->from = k;
            return GSN_OK;
        }
    return get_text(band, "from", &region->file, err);
}

static int read_region(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const kinds[] = { "band", "band", NULL };
    const json_t *region = json_object_get(job, "region");
    int kind = 0;

    if (!region)
        return GSN_OK;
    if (json_is_string(region)) {
        p->region.kind = GSN_REGION_MASK;
        return get_text(job, "region", &p->region.file, err);
    }
    if (!json_is_object(region))
        return bad(err, "region", "the name of a mask file or a shape");
    if (json_object_get(region, "kind"))
        return get_word(region, "kind", kinds, &kind, err) < 0 ? bad(err, "region", BAND)
                                                               : read_band(region, &p->region, err);
    return read_shape(region, "region", &p->region, err);
}

/* Of sections it is the tissue that tells how strong the stain is, of a tile a mask. */
static int read_reference(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *reference = json_object_get(job, "reference");
    const json_t *tissue = json_object_get(reference, "tissue");
    const int r = get_text(job, "batch", &p->batch, err);

    if (r < 0)
        return r;
    if (strlen(p->batch) > LONGEST_BATCH)
        return bad(err, "batch", "a name of at most 20 bytes");
    if (!json_is_object(reference)) {
        if (reference && p->kind == GSN_KIND_SECTIONS)
            return bad(err, "reference", REFERENCE_FORM);
        return get_text(job, "reference", &p->reference, err);
    }
    p->reference = gsn_strdup("");
    if (!p->reference)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    if (p->kind != GSN_KIND_SECTIONS || !json_is_object(tissue) ||
        get_number(reference, "density", 0.05, 1000, &p->reference_density, NULL) < 0 ||
        !(p->reference_density > 0))
        return bad(err, "reference", REFERENCE_FORM);
    return read_shape(tissue, "tissue", &p->reference_tissue, err);
}

static int read_strain(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const words[] = { "reported", "rigid", "corrected", "tissue", NULL };
    int strain = GSN_STATED_STRAIN_REPORTED;
    const int r = get_word(job, "strain", words, &strain, err);

    if (r >= 0)
        p->strain = (enum gsn_stated_strain)strain;
    return r;
}

/* When the stain was made and when it was scanned, and what its batch's control glass allows. */
static int read_stain(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *limits = json_object_get(job, "yellow_to_red");
    long stained = 0, scanned = 0;
    int r = get_text(job, "stained", &p->stained, err);

    if (r >= 0)
        r = get_text(job, "scanned", &p->scanned, err);
    if (r < 0)
        return r;
    if (p->stained[0] && gsn_age_day(p->stained, &stained, NULL) < 0)
        return bad(err, "stained", "a date such as \"2026-03-31\"");
    if (p->scanned[0] && gsn_age_day(p->scanned, &scanned, NULL) < 0)
        return bad(err, "scanned", "a date such as \"2026-03-31\"");
    if (p->stained[0] && p->scanned[0] && scanned < stained)
        return bad(err, "scanned", "no earlier than \"stained\"");
    if (p->stained[0] && p->scanned[0])
        p->days_to_scan = (double)(scanned - stained);
    if (limits && (get_numbers(limits, 2, p->yellow_to_red) < 0 || !(p->yellow_to_red[0] > 0) ||
                   !(p->yellow_to_red[0] < p->yellow_to_red[1])))
        return bad(err, "yellow_to_red", "[low, high], above 0, as the batch's control glass says");
    return GSN_OK;
}

static int read_calibration(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *stated = json_object_get(job, "calibration");

    if (stated && p->kind != GSN_KIND_SECTIONS)
        return bad(err, "calibration", "left out: it is of panels of sections");
    return gsn_stated_calibrations_read(stated, &p->calibration, &p->calibration_count, err);
}

static int read_light(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const transfers[] = { "unknown", "linear", "srgb", NULL };
    static const char *const dyes[] = { "builtin", "estimate", NULL };
    const json_t *white = json_object_get(job, "white");
    int transfer = GSN_STATED_UNKNOWN;
    int r;

    r = get_word(job, "transfer", transfers, &transfer, err);
    if (r >= 0)
        r = get_word(job, "dyes", dyes, &p->estimate_dyes, err);
    if (r < 0)
        return r;
    p->transfer = (enum gsn_stated_transfer)transfer;
    if (!white)
        return GSN_OK;
    if (get_numbers(white, 3, p->white) < 0 || !(p->white[0] > 0 && p->white[0] <= 1) ||
        !(p->white[1] > 0 && p->white[1] <= 1) || !(p->white[2] > 0 && p->white[2] <= 1))
        return bad(err, "white", "three codes as fractions of full scale, above 0 and up to 1");
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
        const int r = get_text(job, names[i].key, names[i].text, err);

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

/* Keys we do not know are named, not refused: a scanner's own notes must not stop the work, and a
 * misspelt key must not pass unseen. */
static int note_unknown_keys(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const known[] = {
        "specimen",  "study",       "group",     "animal",   "week",          "px_um",
        "voxel_um",  "interval_um", "panels",    "layout",   "order",         "sections",
        "region",    "markers_um",  "baseline",  "transfer", "dyes",          "white",
        "kind",      "thresholds",  "tolerance", "file",     "reference",     "batch",
        "comment",   "strain",      "stained",   "scanned",  "yellow_to_red", "level",
        "target_um", "calibration"
    };
    void *at = json_object_iter((json_t *)(uintptr_t)job);

    for (; at; at = json_object_iter_next((json_t *)(uintptr_t)job, at)) {
        const char *key = json_object_iter_key(at);
        size_t i = 0;
        char *more;

        while (i < sizeof known / sizeof known[0] && strcmp(key, known[i]) != 0)
            i++;
        if (i < sizeof known / sizeof known[0])
            continue;
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
    int order = GSN_STATED_ROW, kind = GSN_KIND_SECTIONS;
    int r;

    if ((r = note_unknown_keys(job, p, err)) < 0 || (r = read_names(job, p, err)) < 0 ||
        (r = get_word(job, "kind", kinds, &kind, err)) < 0 ||
        (r = get_word(job, "order", orders, &order, err)) < 0 ||
        (r = get_number(job, "week", 0, 10000, &p->week, err)) < 0 ||
        (r = get_number(job, "px_um", 0.01, 1000, &p->px_um, err)) < 0 ||
        (r = get_number(job, "level", 0, 31, &p->level, err)) < 0 ||
        (r = get_number(job, "target_um", 0.01, 1000, &p->target_um, err)) < 0 ||
        (r = get_number(job, "interval_um", 0.1, 10000, &p->interval_um, err)) < 0 ||
        (r = get_number(job, "voxel_um", 0.01, 1000, &p->voxel_um, err)) < 0 ||
        (r = get_number(job, "tolerance", 1e-9, 1e9, &p->tolerance, err)) < 0 ||
        (r = get_count(job, "panels", 10000, &p->panels, err)) < 0 ||
        (r = get_count(job, "sections", MOST_SECTIONS, &p->sections, err)) < 0 ||
        (r = read_layout(job, p, err)) < 0 || (r = read_markers(job, p, err)) < 0 ||
        (r = read_thresholds(job, p, err)) < 0 || (r = read_region(job, p, err)) < 0 ||
        (r = read_strain(job, p, err)) < 0 || (r = read_light(job, p, err)) < 0 ||
        (r = read_stain(job, p, err)) < 0)
        return r;
    p->kind = (enum gsn_kind)kind;
    p->order = (enum gsn_stated_order)order;
    r = read_reference(job, p, err);
    if (r >= 0)
        r = read_calibration(job, p, err);
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
        return gsn_fail(err, GSN_E_INPUT, "job.json: line %d: %s", where.line, where.text);
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

static int holds(const struct gsn_region *region, struct gsn_vec3 u)
{
    const struct gsn_vec3 d = gsn_vec3_sub(u, region->centre);

    if (region->kind == GSN_REGION_SPHERE)
        return gsn_vec3_length(d) <= region->radius_um;
    if (!(region->low.z <= u.z && u.z < region->high.z))
        return 0;
    if (region->kind == GSN_REGION_CYLINDER)
        return hypot(d.x, d.y) <= region->radius_um;
    return region->low.x <= u.x && u.x < region->high.x && region->low.y <= u.y &&
           u.y < region->high.y;
}

int gsn_region_raster(const struct gsn_region *region, const struct gsn_lattice *at,
                      struct gsn_mask **ret_mask, struct gsn_error *err)
{
    gsn_auto(gsn_mask) mask = NULL;
    const int r = gsn_mask_new(at, &mask, err);

    if (r < 0)
        return r;
    for (size_t z = 0; z < at->nz; z++)
        for (size_t y = 0; y < at->ny; y++)
            for (size_t x = 0; x < at->nx; x++)
                mask->inside[gsn_lattice_index(at, x, y, z)] =
                    (uint8_t)holds(region, gsn_lattice_centre(at, x, y, z));
    if (gsn_mask_count(mask) == 0)
        return gsn_fail(err, GSN_E_INPUT, "the region of interest holds no voxel of this stack");
    *ret_mask = gsn_steal(&mask);
    return GSN_OK;
}
