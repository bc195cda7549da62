/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/stated_calibration.h"

#include "pipeline/core/mem.h"

#include <jansson.h>
#include <string.h>

enum { LONGEST_NAME = 1000, MOST_PANELS = 10000 };

static int bad(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT,
                    "job.json: \"calibration\" must be a file beside job.json, or {\"file\": a "
                    "file, \"panels\": [1, 2, ...], \"patches\": [[\"red\", \"yellow\", "
                    "\"dark\"], [0, 0.5, 1]]} (rows from the top, at most %d patches: a dye, or "
                    "the density of a standard, 0 to 10), or a list of these that names no panel "
                    "twice",
                    GSN_MOST_PATCHES);
}

static int read_file(const json_t *file, struct gsn_stated_calibration *c, struct gsn_error *err)
{
    const char *name = json_string_value(file);

    if (!name || !name[0] || json_string_length(file) > LONGEST_NAME ||
        strlen(name) != json_string_length(file))
        return bad(err);
    c->file = gsn_strdup(name);
    return c->file ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
}

static int read_panels(const json_t *panels, struct gsn_stated_calibration *c,
                       struct gsn_error *err)
{
    if (!panels)
        return GSN_OK;
    if (!json_is_array(panels) || json_array_size(panels) == 0)
        return bad(err);
    c->panel = gsn_alloc_array(json_array_size(panels), sizeof *c->panel);
    if (!c->panel)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    for (size_t i = 0; i < json_array_size(panels); i++) {
        const json_t *number = json_array_get(panels, i);

        if (!json_is_integer(number) || json_integer_value(number) < 1 ||
            json_integer_value(number) > MOST_PANELS)
            return bad(err);
        c->panel[c->panel_count++] = (unsigned)json_integer_value(number);
    }
    return GSN_OK;
}

static int read_patch(const json_t *value, struct gsn_stated_patch *patch)
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
static void usual_patches(struct gsn_stated_calibration *c)
{
    for (unsigned k = 0; k < 3; k++)
        c->patch[c->patch_count++] =
            (struct gsn_stated_patch){ .kind = (enum gsn_patch_kind)k, .row = 1, .place = k + 1 };
}

static int read_patches(const json_t *rows, struct gsn_stated_calibration *c, struct gsn_error *err)
{
    if (!rows) {
        usual_patches(c);
        return GSN_OK;
    }
    if (!json_is_array(rows) || json_array_size(rows) == 0)
        return bad(err);
    for (size_t i = 0; i < json_array_size(rows); i++) {
        const json_t *row = json_array_get(rows, i);

        if (!json_is_array(row) || json_array_size(row) == 0)
            return bad(err);
        for (size_t k = 0; k < json_array_size(row); k++) {
            struct gsn_stated_patch patch = { .row = (unsigned)i + 1, .place = (unsigned)k + 1 };

            if (c->patch_count == GSN_MOST_PATCHES || read_patch(json_array_get(row, k), &patch))
                return bad(err);
            c->patch[c->patch_count++] = patch;
        }
    }
    return GSN_OK;
}

static int read_one(const json_t *value, struct gsn_stated_calibration *c, struct gsn_error *err)
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
        return bad(err);
    r = read_file(json_object_get(value, "file"), c, err);
    if (r >= 0)
        r = read_panels(json_object_get(value, "panels"), c, err);
    if (r >= 0)
        r = read_patches(json_object_get(value, "patches"), c, err);
    return r;
}

/* How often a panel is named. */
static size_t times_named(const struct gsn_stated_calibration *c, size_t count, unsigned panel)
{
    size_t times = 0;

    for (size_t i = 0; i < count; i++) {
        times += !c[i].panel;
        for (size_t k = 0; k < c[i].panel_count; k++)
            times += c[i].panel[k] == panel;
    }
    return times;
}

static int check_panels(const struct gsn_stated_calibration *c, size_t count, struct gsn_error *err)
{
    for (size_t i = 0; i < count; i++) {
        if (!c[i].panel && count > 1)
            return bad(err);
        for (size_t k = 0; k < c[i].panel_count; k++)
            if (times_named(c, count, c[i].panel[k]) > 1)
                return bad(err);
    }
    return GSN_OK;
}

int gsn_stated_calibrations_read(const struct json_t *value,
                                 struct gsn_stated_calibration **ret_calibrations,
                                 size_t *ret_count, struct gsn_error *err)
{
    const size_t count = !value ? 0 : json_is_array(value) ? json_array_size(value) : 1;
    struct gsn_stated_calibration *c;
    int r = GSN_OK;

    if (!value) {
        *ret_calibrations = NULL;
        *ret_count = 0;
        return GSN_OK;
    }
    if (count == 0 || count > MOST_PANELS)
        return bad(err);
    c = gsn_alloc_array(count, sizeof *c);
    if (!c)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory reading job.json");
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = read_one(json_is_array(value) ? json_array_get(value, i) : value, &c[i], err);
    if (r >= 0)
        r = check_panels(c, count, err);
    if (r < 0) {
        gsn_stated_calibrations_free(c, count);
        return r;
    }
    *ret_calibrations = c;
    *ret_count = count;
    return GSN_OK;
}

void gsn_stated_calibrations_free(struct gsn_stated_calibration *calibrations, size_t count)
{
    for (size_t i = 0; calibrations && i < count; i++) {
        gsn_free(calibrations[i].file);
        gsn_free(calibrations[i].panel);
    }
    gsn_free(calibrations);
}

const struct gsn_stated_calibration *
gsn_stated_calibration_of(const struct gsn_stated_calibration *calibrations, size_t count,
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

int gsn_stated_calibration_has_standards(const struct gsn_stated_calibration *calibration)
{
    for (size_t i = 0; i < calibration->patch_count; i++)
        if (calibration->patch[i].kind == GSN_PATCH_STANDARD && calibration->patch[i].density > 0)
            return 1;
    return 0;
}
