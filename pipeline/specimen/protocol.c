/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Parses job.json, what the operator states about a specimen.
 *
 * 1. The text is parsed as JSON, doubled keys refused; a comma too many or too few is named.
 * 2. Keys that are not known are noted, with the key that the first of them was meant to be.
 * 3. Every key is read and checked by itself: text, number, count, word, region, calibration panel.
 * 4. Keys that need each other are checked together: coordinates need a frame, dates their order.
 *
 * Whatever is wrong fails with GSN_E_INPUT and one sentence that names the key and what is allowed.
 * What is absent leaves the default. docs/user/job.md describes the keys. */
#include "pipeline/specimen/protocol.h"

#include "pipeline/core/calendar.h"
#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"
#include "pipeline/core/nearest.h"
#include "pipeline/specimen/region.h"
#include "pipeline/stain/calibration.h"
#include "pipeline/stain/tissue_segmentation.h"

#include <jansson.h>
#include <math.h>
#include <stddef.h>
#include <string.h>
#include <strings.h>

/* ---- values under their keys --------------------------------------------------------------
 *
 * Text, numbers, words. Where nothing else is said,
 * what is absent leaves the answer as it is, and what is wrong fails with GSN_E_INPUT, naming the
 * key and what is allowed. */

/* Limits that only a mistake exceeds. */
enum { LONGEST_NAME = 1000, MOST_SLOTS = 400, MOST_SECTIONS = 100000, MOST_PANELS = 10000 };
static const double MOST_DRAWN_VOXELS = 1 << 30;

/* Says what the key must be. */
static int refuse_value(struct gsn_error *err, const char *key, const char *wanted)
{
    return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be %s", key, wanted);
}

/* gives: text, "" when the key is absent. Fails with GSN_E_NOMEM too. */
static int read_text(const json_t *job, const char *key, char **text, struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (value && (!json_is_string(value) || json_string_length(value) > LONGEST_NAME ||
                  strlen(json_string_value(value)) != json_string_length(value)))
        return refuse_value(err, key, "text of at most 1000 bytes");
    *text = gsn_strdup(value ? json_string_value(value) : "");
    return *text ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
}

static int read_number(const json_t *job, const char *key, double low, double high, double *number,
                       struct gsn_error *err)
{
    const json_t *value = json_object_get(job, key);

    if (!value)
        return GSN_OK;
    if (!json_is_number(value) || !(json_number_value(value) >= low) ||
        !(json_number_value(value) <= high))
        return gsn_fail(err, GSN_E_INPUT, "job.json: \"%s\" must be a number from %g to %g%s", key,
                        low, high, strstr(key, "_um") ? " micrometres" : "");
    *number = json_number_value(value);
    return GSN_OK;
}

static int read_count(const json_t *job, const char *key, unsigned most, unsigned *count,
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

/* One of several words, of which there are two at least, with NULL behind the last. */
static int read_word(const json_t *job, const char *key, const char *const *words, int *chosen,
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

/* Exactly count finite numbers; else -1, and nothing is said. */
static int read_numbers(const json_t *array, size_t count, double *numbers)
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

/* ---- regions -------------------------------------------------------------------------------- */

static int read_box(const json_t *shape, struct gsn_region *region)
{
    double low[3], high[3];

    if (read_numbers(json_object_get(shape, "min"), 3, low) < 0 ||
        read_numbers(json_object_get(shape, "max"), 3, high) < 0)
        return -1;
    region->low = gsn_vec3_make(low[0], low[1], low[2]);
    region->high = gsn_vec3_make(high[0], high[1], high[2]);
    return low[0] < high[0] && low[1] < high[1] && low[2] < high[2] ? 0 : -1;
}

static int read_round(const json_t *shape, struct gsn_region *region)
{
    const json_t *radius = json_object_get(shape, "radius");
    double centre[3] = { 0 }, z[2];

    if (read_numbers(json_object_get(shape, "centre"), region->kind == GSN_REGION_SPHERE ? 3 : 2,
                     centre) < 0)
        return -1;
    region->centre = gsn_vec3_make(centre[0], centre[1], centre[2]);
    region->radius_um = json_is_number(radius) ? json_number_value(radius) : 0;
    if (region->kind == GSN_REGION_CYLINDER) {
        if (read_numbers(json_object_get(shape, "z"), 2, z) < 0 || !(z[0] < z[1]))
            return -1;
        region->low.z = z[0];
        region->high.z = z[1];
    }
    return region->radius_um > 0 ? 0 : -1;
}

/* Reads a shape out of an object; key: what the sentence calls it. Fails with GSN_E_INPUT. */
static int read_shape(const json_t *shape_of, const char *key, struct gsn_region *region,
                      struct gsn_error *err)
{
    static const char *const shapes[] = { "box", "cylinder", "sphere", NULL };
    int shape = -1;
    const int r = read_word(shape_of, "shape", shapes, &shape, err);

    if (r < 0)
        return r;
    if (shape >= 0)
        region->kind = (enum gsn_region_kind)(GSN_REGION_BOX + shape);
    if (shape < 0 || (shape == 0 ? read_box(shape_of, region) : read_round(shape_of, region)))
        return refuse_value(err, key,
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

    if (z && (read_numbers(z, 2, range) < 0 || !(range[0] < range[1])))
        return -1;
    if (within && (read_numbers(json_object_get(within, "centre"), 2, centre) < 0 ||
                   !(json_number_value(radius) > 0)))
        return -1;
    region->low.z = range[0];
    region->high.z = range[1];
    region->centre = gsn_vec3_make(centre[0], centre[1], 0);
    region->radius_um = within ? json_number_value(radius) : 0;
    return 0;
}

static int read_band(const json_t *band, const char *key, struct gsn_region *region,
                     struct gsn_error *err)
{
    const json_t *from = json_object_get(band, "from");
    const json_t *low = json_object_get(band, "low_um"), *high = json_object_get(band, "high_um");

    region->kind = GSN_REGION_BAND;
    region->low_um = json_number_value(low);
    region->high_um = json_number_value(high);
    if (!json_is_string(from) || !json_string_value(from)[0] || !json_is_number(low) ||
        !json_is_number(high) || !(region->low_um < region->high_um) || !isfinite(region->low_um) ||
        !isfinite(region->high_um) || read_limits(band, region) < 0)
        return refuse_value(err, key, BAND);
    for (enum gsn_tissue_kind k = GSN_TISSUE_ROOT; k < GSN_TISSUE_BODIES; k++)
        if (strcmp(json_string_value(from), gsn_tissue_name(k)) == 0) {
            region->from = k;
            return GSN_OK;
        }
    return read_text(band, "from", &region->file, err);
}

static const char DRAWN[] =
    "{\"kind\": \"drawn\", \"file\": a file of GeoJSON or ImageJ, \"stack\": {\"size\": "
    "[nx,ny,nz], \"pixel_um\": [x,y,z] with x = y, \"origin_um\": [x,y,z]}}, with or without "
    "\"class\": a classification; `gieson export SPECIMEN FILE.ome.tif` prints the \"stack\" of "
    "its file";

/* The stack that outlines were drawn on, as export describes it; its voxels fit into a mask. */
static int read_stack(const json_t *stack, struct gsn_lattice *ret_at)
{
    double size[3], step[3], origin[3], voxels = 1;

    if (read_numbers(json_object_get(stack, "size"), 3, size) < 0 ||
        read_numbers(json_object_get(stack, "pixel_um"), 3, step) < 0 ||
        read_numbers(json_object_get(stack, "origin_um"), 3, origin) < 0)
        return -1;
    for (int c = 0; c < 3; c++) {
        if (!(size[c] >= 1 && size[c] <= MOST_SECTIONS && size[c] == floor(size[c]) &&
              step[c] > 0))
            return -1;
        voxels *= size[c];
    }
    *ret_at = (struct gsn_lattice){ .nx = (size_t)size[0],
                                    .ny = (size_t)size[1],
                                    .nz = (size_t)size[2],
                                    .origin_um = gsn_vec3_make(origin[0], origin[1], origin[2]),
                                    .step_um = gsn_vec3_make(step[0], step[1], step[2]) };
    return voxels <= MOST_DRAWN_VOXELS && fabs(step[0] / step[1] - 1) < 0.01 ? 0 : -1;
}

static int read_drawn(const json_t *drawn, const char *key, struct gsn_region *region,
                      struct gsn_error *err)
{
    int r;

    region->kind = GSN_REGION_DRAWN;
    if (!json_string_length(json_object_get(drawn, "file")) ||
        read_stack(json_object_get(drawn, "stack"), &region->stack) < 0)
        return refuse_value(err, key, DRAWN);
    r = read_text(drawn, "file", &region->file, err);
    return r < 0 || !json_object_get(drawn, "class")
               ? r
               : read_text(drawn, "class", &region->class_name, err);
}

/* Reads a region under its key; region is left alone when it is absent. gives:
 * region->file and class_name. Fails with GSN_E_INPUT, GSN_E_NOMEM. */
static int read_region(const json_t *job, const char *key, struct gsn_region *region,
                       struct gsn_error *err)
{
    const json_t *stated = json_object_get(job, key);
    const json_t *kind = json_object_get(stated, "kind");
    const char *word = json_string_value(kind);

    if (!stated)
        return GSN_OK;
    if (json_is_string(stated)) {
        region->kind = GSN_REGION_MASK;
        return read_text(job, key, &region->file, err);
    }
    if (!json_is_object(stated))
        return refuse_value(err, key, "the name of a mask file or a shape");
    if (word && strcmp(word, "drawn") == 0)
        return read_drawn(stated, key, region, err);
    if (kind && !(word && strcmp(word, "band") == 0))
        return refuse_value(err, key, BAND);
    if (kind)
        return read_band(stated, key, region, err);
    return read_shape(stated, key, region, err);
}

/* What may be part of a file's name and of a figure's. */
static int is_region_name(const char *name)
{
    const size_t length = strlen(name);

    return length >= 1 && length <= 40 &&
           strspn(name, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_") ==
               length;
}

/* Regions beside the main one. */
static int read_named(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *stated = json_object_get(job, "regions");
    void *at = json_object_iter((json_t *)(uintptr_t)stated);
    int r = GSN_OK;

    if (!stated)
        return GSN_OK;
    if (!json_is_object(stated) || json_object_size(stated) > GSN_MOST_REGIONS)
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json: \"regions\" must be {\"a name\": a region, ...}, at most %d, "
                        "each as \"region\" is stated",
                        GSN_MOST_REGIONS);
    p->named = gsn_alloc_array(json_object_size(stated) + 1, sizeof *p->named);
    if (!p->named)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    for (; r >= 0 && at; at = json_object_iter_next((json_t *)(uintptr_t)stated, at)) {
        struct gsn_protocol_region *one = &p->named[p->named_count];
        const char *name = json_object_iter_key(at);

        if (!is_region_name(name))
            return gsn_fail(err, GSN_E_INPUT,
                            "job.json: \"regions\": \"%.60s\" is no name of a region: 1 to 40 "
                            "letters, digits, - and _",
                            name);
        one->name = gsn_strdup(name);
        p->named_count++;
        r = one->name ? read_region(stated, name, &one->region, err)
                      : gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    }
    return r;
}

/* What the main region is not, the others are not beside. */
static int check_named(const struct gsn_protocol *p, struct gsn_error *err)
{
    if (p->named_count == 0)
        return GSN_OK;
    if (p->kind == GSN_KIND_TILE)
        return refuse_value(err, "regions", "left out: a tile is one picture");
    if (p->kind == GSN_KIND_SECTIONS && p->region.kind == GSN_REGION_NONE)
        return refuse_value(err, "regions",
                            "beside \"region\", which is the main one: state that too");
    return GSN_OK;
}

/* ---- calibration panels -------------------------------------------------------------------- */

static int refuse_calibration(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "job.json: \"calibration\" must be a file beside job.json, or {\"file\": a "
                    "file, \"panels\": [1, 2, ...], \"patches\": [[\"red\", \"yellow\", "
                    "\"dark\"], [0, 0.5, 1]]} (rows from the top, at most %d patches: a dye, or "
                    "the density of a standard, 0 to 10), or a list of these that names no panel "
                    "twice",
                    GSN_MOST_PATCHES);
}

static int read_file(const json_t *file, struct gsn_protocol_calibration *c, struct gsn_error *err)
{
    const char *name = json_string_value(file);

    if (!name || !name[0] || json_string_length(file) > LONGEST_NAME ||
        strlen(name) != json_string_length(file))
        return refuse_calibration(err);
    c->file = gsn_strdup(name);
    return c->file ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
}

static int read_panels(const json_t *panels, struct gsn_protocol_calibration *c,
                       struct gsn_error *err)
{
    if (!panels)
        return GSN_OK;
    if (!json_is_array(panels) || json_array_size(panels) == 0)
        return refuse_calibration(err);
    c->panel = gsn_alloc_array(json_array_size(panels), sizeof *c->panel);
    if (!c->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    for (size_t i = 0; i < json_array_size(panels); i++) {
        const json_t *number = json_array_get(panels, i);

        if (!json_is_integer(number) || json_integer_value(number) < 1 ||
            json_integer_value(number) > MOST_PANELS)
            return refuse_calibration(err);
        c->panel[c->panel_count++] = (unsigned)json_integer_value(number);
    }
    return GSN_OK;
}

static int read_patch(const json_t *value, struct gsn_protocol_patch *patch)
{
    static const char *const dyes[] = { "red", "yellow", "dark" };

    if (json_is_number(value)) {
        patch->kind = GSN_PATCH_STANDARD;
        patch->density = json_number_value(value);
        return patch->density >= 0 && patch->density <= 10 ? 0 : -1;
    }
    for (int k = 0; json_is_string(value) && k < 3; k++)
        if (strcmp(json_string_value(value), dyes[k]) == 0) {
            patch->kind = (enum gsn_patch_kind)k;
            return 0;
        }
    return -1;
}

/* The three dyes side by side, where nothing is said. */
static void usual_patches(struct gsn_protocol_calibration *c)
{
    for (unsigned k = 0; k < 3; k++)
        c->patch[c->patch_count++] =
            (struct gsn_protocol_patch){ .kind = (enum gsn_patch_kind)k, .row = 1, .place = k + 1 };
}

static int read_patches(const json_t *rows, struct gsn_protocol_calibration *c,
                        struct gsn_error *err)
{
    if (!rows) {
        usual_patches(c);
        return GSN_OK;
    }
    if (!json_is_array(rows) || json_array_size(rows) == 0)
        return refuse_calibration(err);
    for (size_t i = 0; i < json_array_size(rows); i++) {
        const json_t *row = json_array_get(rows, i);

        if (!json_is_array(row) || json_array_size(row) == 0)
            return refuse_calibration(err);
        for (size_t k = 0; k < json_array_size(row); k++) {
            struct gsn_protocol_patch patch = { .row = (unsigned)i + 1, .place = (unsigned)k + 1 };

            if (c->patch_count == GSN_MOST_PATCHES || read_patch(json_array_get(row, k), &patch))
                return refuse_calibration(err);
            c->patch[c->patch_count++] = patch;
        }
    }
    return GSN_OK;
}

static int read_one(const json_t *value, struct gsn_protocol_calibration *c, struct gsn_error *err)
{
    static const char *const known[] = { "file", "panels", "patches", "comment" };
    void *at = json_object_iter((json_t *)(uintptr_t)value);
    size_t keys = 0;
    int r;

    if (json_is_string(value)) {
        usual_patches(c);
        return read_file(value, c, err);
    }
    for (; at; at = json_object_iter_next((json_t *)(uintptr_t)value, at))
        for (size_t i = 0; i < sizeof known / sizeof known[0]; i++)
            keys += strcmp(json_object_iter_key(at), known[i]) == 0;
    if (!json_is_object(value) || keys != json_object_size(value))
        return refuse_calibration(err);
    r = read_file(json_object_get(value, "file"), c, err);
    if (r >= 0)
        r = read_panels(json_object_get(value, "panels"), c, err);
    if (r >= 0)
        r = read_patches(json_object_get(value, "patches"), c, err);
    return r;
}

/* How often a panel is named. */
static size_t times_named(const struct gsn_protocol_calibration *c, size_t count, unsigned panel)
{
    size_t times = 0;

    for (size_t i = 0; i < count; i++) {
        times += !c[i].panel;
        for (size_t k = 0; k < c[i].panel_count; k++)
            times += c[i].panel[k] == panel;
    }
    return times;
}

static int check_panels(const struct gsn_protocol_calibration *c, size_t count,
                        struct gsn_error *err)
{
    for (size_t i = 0; i < count; i++) {
        if (!c[i].panel && count > 1)
            return refuse_calibration(err);
        for (size_t k = 0; k < c[i].panel_count; k++)
            if (times_named(c, count, c[i].panel[k]) > 1)
                return refuse_calibration(err);
    }
    return GSN_OK;
}

static void free_calibrations(struct gsn_protocol_calibration *calibrations, size_t count)
{
    for (size_t i = 0; calibrations && i < count; i++) {
        gsn_free(calibrations[i].file);
        gsn_free(calibrations[i].panel);
    }
    gsn_free(calibrations);
}

/* gives: one for each that value states; NULL and 0 where value is NULL.
 * Fails with GSN_E_INPUT, GSN_E_NOMEM. */
static int read_calibrations(const struct json_t *value,
                             struct gsn_protocol_calibration **ret_calibrations, size_t *ret_count,
                             struct gsn_error *err)
{
    const size_t count = !value ? 0 : json_is_array(value) ? json_array_size(value) : 1;
    struct gsn_protocol_calibration *c;
    int r = GSN_OK;

    if (!value) {
        *ret_calibrations = NULL;
        *ret_count = 0;
        return GSN_OK;
    }
    if (count == 0 || count > MOST_PANELS)
        return refuse_calibration(err);
    c = gsn_alloc_array(count, sizeof *c);
    if (!c)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = read_one(json_is_array(value) ? json_array_get(value, i) : value, &c[i], err);
    if (r >= 0)
        r = check_panels(c, count, err);
    if (r < 0) {
        free_calibrations(c, count);
        return r;
    }
    *ret_calibrations = c;
    *ret_count = count;
    return GSN_OK;
}

const struct gsn_protocol_calibration *
gsn_protocol_calibration_of(const struct gsn_protocol_calibration *calibrations, size_t count,
                            unsigned panel)
{
    for (size_t i = 0; i < count; i++) {
        if (!calibrations[i].panel)
            return &calibrations[i];
        for (size_t k = 0; k < calibrations[i].panel_count; k++)
            if (calibrations[i].panel[k] == panel)
                return &calibrations[i];
    }
    return NULL;
}

int gsn_protocol_calibration_has_standards(const struct gsn_protocol_calibration *calibration)
{
    for (size_t i = 0; i < calibration->patch_count; i++)
        if (calibration->patch[i].kind == GSN_PATCH_STANDARD && calibration->patch[i].density > 0)
            return 1;
    return 0;
}

/* ---- the other keys ------------------------------------------------------------------------ */

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
    if (read_numbers(layout, 2, n) < 0 || n[0] < 1 || n[1] < 1 || n[0] * n[1] > MOST_SLOTS ||
        n[0] != floor(n[0]) || n[1] != floor(n[1]))
        return refuse_value(err, "layout",
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

        if (json_array_size(markers) != 3 || read_numbers(json_array_get(markers, i), 2, xy) < 0)
            return refuse_value(err, "markers_um", "three pairs [x, y] in micrometres");
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
        read_numbers(thresholds, count, p->threshold) < 0)
        return refuse_value(err, "thresholds", "one to eight numbers");
    p->threshold_count = count;
    return GSN_OK;
}

/* Of sections it is the tissue that tells how strong the stain is, of a tile a mask. */
static int read_reference(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *reference = json_object_get(job, "reference");
    const json_t *tissue = json_object_get(reference, "tissue");
    const int r = read_text(job, "batch", &p->batch, err);

    if (r < 0)
        return r;
    if (strlen(p->batch) > LONGEST_BATCH)
        return refuse_value(err, "batch", "a name of at most 20 bytes");
    if (!json_is_object(reference)) {
        if (reference && p->kind == GSN_KIND_SECTIONS)
            return refuse_value(err, "reference", REFERENCE_FORM);
        return read_text(job, "reference", &p->reference, err);
    }
    p->reference = gsn_strdup("");
    if (!p->reference)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    if (p->kind != GSN_KIND_SECTIONS || !json_is_object(tissue) ||
        read_number(reference, "density", 0.05, 1000, &p->reference_density, NULL) < 0 ||
        !(p->reference_density > 0))
        return refuse_value(err, "reference", REFERENCE_FORM);
    return read_shape(tissue, "tissue", &p->reference_tissue, err);
}

static int read_strain(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const words[] = { "reported", "rigid", "corrected", "tissue", NULL };
    int strain = GSN_PROTOCOL_STRAIN_REPORTED;
    const int r = read_word(job, "strain", words, &strain, err);

    if (r >= 0)
        p->strain = (enum gsn_protocol_strain)strain;
    return r;
}

/* By what the sections are laid, and in whose frame. Strain is what the marks show. */
static int read_registration(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const words[] = { "marks+tissue", "marks", "tissue", NULL };
    const json_t *frame = json_object_get(job, "frame");
    int registration = GSN_PROTOCOL_MARKS_AND_TISSUE;
    const int r = read_word(job, "registration", words, &registration, err);
    double at[2];

    if (r < 0)
        return r;
    p->registration = (enum gsn_protocol_registration)registration;
    if (p->registration == GSN_PROTOCOL_TISSUE &&
        (p->strain == GSN_PROTOCOL_STRAIN_CORRECTED || p->strain == GSN_PROTOCOL_STRAIN_TISSUE))
        return refuse_value(err, "strain",
                            "\"reported\" or \"rigid\" where \"registration\" is \"tissue\": "
                            "only marks show how far a section is stretched");
    if (!frame)
        return GSN_OK;
    if (p->registration != GSN_PROTOCOL_TISSUE)
        return refuse_value(err, "frame",
                            "left out unless \"registration\" is \"tissue\": the marks are the "
                            "frame");
    if (read_numbers(frame, 2, at) < 0 || at[0] < 1 || at[1] < 1 || at[0] != floor(at[0]) ||
        at[1] != floor(at[1]) || at[0] > MOST_PANELS || at[1] > p->rows * p->columns)
        return refuse_value(err, "frame",
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
    int region = gsn_region_has_coordinates(&p->region);

    for (size_t i = 0; i < p->named_count; i++)
        region |= gsn_region_has_coordinates(&p->named[i].region);
    if (p->registration != GSN_PROTOCOL_TISSUE || p->frame_panel > 0 ||
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
    int r = read_text(job, "stained", &p->stained, err);

    if (r >= 0)
        r = read_text(job, "scanned", &p->scanned, err);
    if (r < 0)
        return r;
    if (p->stained[0] && gsn_calendar_day(p->stained, &stained, NULL) < 0)
        return refuse_value(err, "stained", "a date such as \"2026-03-31\"");
    if (p->scanned[0] && gsn_calendar_day(p->scanned, &scanned, NULL) < 0)
        return refuse_value(err, "scanned", "a date such as \"2026-03-31\"");
    if (p->stained[0] && p->scanned[0] && scanned < stained)
        return refuse_value(err, "scanned", "no earlier than \"stained\"");
    if (p->stained[0] && p->scanned[0])
        p->days_to_scan = (double)(scanned - stained);
    if (limits && (read_numbers(limits, 2, p->yellow_to_red) < 0 || !(p->yellow_to_red[0] > 0) ||
                   !(p->yellow_to_red[0] < p->yellow_to_red[1])))
        return refuse_value(err, "yellow_to_red",
                            "[low, high], above 0, as the batch's control glass says");
    return GSN_OK;
}

static int read_calibration(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    const json_t *stated = json_object_get(job, "calibration");

    if (stated && p->kind != GSN_KIND_SECTIONS)
        return refuse_value(err, "calibration", "left out: it is of panels of sections");
    return read_calibrations(stated, &p->calibration, &p->calibration_count, err);
}

static int read_light(const json_t *job, struct gsn_protocol *p, struct gsn_error *err)
{
    static const char *const transfers[] = { "unknown", "linear", "srgb", NULL };
    static const char *const dyes[] = { "builtin", "estimate", NULL };
    const json_t *white = json_object_get(job, "white");
    int transfer = GSN_PROTOCOL_TRANSFER_UNKNOWN, vectors = -1;
    int r;

    r = read_word(job, "transfer", transfers, &transfer, err);
    if (r >= 0)
        r = read_word(job, "dyes", dyes, &vectors, err);
    if (r < 0)
        return r;
    p->transfer = (enum gsn_protocol_transfer)transfer;
    p->dyes = (enum gsn_protocol_dyes)(vectors + 1);
    if (!white)
        return GSN_OK;
    if (read_numbers(white, 3, p->white) < 0 || !(p->white[0] > 0 && p->white[0] <= 1) ||
        !(p->white[1] > 0 && p->white[1] <= 1) || !(p->white[2] > 0 && p->white[2] <= 1))
        return refuse_value(err, "white",
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
        const int r = read_text(job, names[i].key, names[i].text, err);

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
        return refuse_value(err, "collagen_free",
                            "a shape of tissue without collagen, for sections only");
    return read_shape(tissue, "collagen_free", &p->collagen_free, err);
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
        { "rois", "regions" },
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
        "target_um", "calibration", "registration", "frame",    "spacing_unit",  "collagen_free",
        "regions"
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
    int order = GSN_PROTOCOL_ROW, kind = GSN_KIND_SECTIONS, unit = -1;
    int r;

    if ((r = note_unknown_keys(job, p, err)) < 0 || (r = read_names(job, p, err)) < 0 ||
        (r = read_word(job, "kind", kinds, &kind, err)) < 0 ||
        (r = read_word(job, "order", orders, &order, err)) < 0 ||
        (r = read_word(job, "spacing_unit", units, &unit, err)) < 0 ||
        (r = read_number(job, "week", 0, 10000, &p->week, err)) < 0 ||
        (r = read_number(job, "px_um", 0.01, 1000, &p->px_um, err)) < 0 ||
        (r = read_number(job, "level", 0, 31, &p->level, err)) < 0 ||
        (r = read_number(job, "target_um", 0.01, 1000, &p->target_um, err)) < 0 ||
        (r = read_number(job, "interval_um", 0.1, 10000, &p->interval_um, err)) < 0 ||
        (r = read_number(job, "voxel_um", 0.01, 1000, &p->voxel_um, err)) < 0 ||
        (r = read_number(job, "tolerance", 1e-9, 1e9, &p->tolerance, err)) < 0 ||
        (r = read_count(job, "panels", MOST_PANELS, &p->panels, err)) < 0 ||
        (r = read_count(job, "sections", MOST_SECTIONS, &p->sections, err)) < 0 ||
        (r = read_layout(job, p, err)) < 0 || (r = read_markers(job, p, err)) < 0 ||
        (r = read_thresholds(job, p, err)) < 0 ||
        (r = read_region(job, "region", &p->region, err)) < 0 ||
        (r = read_named(job, p, err)) < 0 ||
        (r = read_strain(job, p, err)) < 0 || (r = read_registration(job, p, err)) < 0 ||
        (r = read_light(job, p, err)) < 0 || (r = read_stain(job, p, err)) < 0)
        return r;
    p->kind = (enum gsn_kind)kind;
    p->order = (enum gsn_protocol_order)order;
    p->spacing_unit = (enum gsn_spacing_unit)(unit + 1);
    r = read_reference(job, p, err);
    if (r >= 0)
        r = read_collagen_free(job, p, err);
    if (r >= 0)
        r = read_calibration(job, p, err);
    if (r >= 0)
        r = check_named(p, err);
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
    free_calibrations(p->calibration, p->calibration_count);
    gsn_free(p->batch);
    gsn_free(p->stained);
    gsn_free(p->scanned);
    gsn_free(p->unknown);
    gsn_region_done(&p->region);
    for (size_t i = 0; i < p->named_count; i++) {
        gsn_free(p->named[i].name);
        gsn_region_done(&p->named[i].region);
    }
    gsn_free(p->named);
    gsn_free(p);
}

unsigned gsn_protocol_sections(const struct gsn_protocol *p)
{
    const unsigned slots = p->panels * p->rows * p->columns;

    return p->sections && (p->sections < slots || !slots) ? p->sections : slots;
}

struct gsn_layout gsn_protocol_layout(const struct gsn_protocol *protocol)
{
    static const enum gsn_order orders[] = { [GSN_PROTOCOL_ROW] = GSN_ORDER_ROW,
                                             [GSN_PROTOCOL_COLUMN] = GSN_ORDER_COLUMN,
                                             [GSN_PROTOCOL_SNAKE] = GSN_ORDER_SNAKE };

    return (struct gsn_layout){ .rows = protocol->rows,
                                .columns = protocol->columns,
                                .order = orders[protocol->order] };
}
