/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The kinds of source there are, in one table; a new kind is one row and one file.
 *
 * The address "KIND:REST" picks the row; the kind's own check judges the rest and the settings of
 * the section, so that a configuration is refused before anything is opened. An unknown kind is
 * answered with all kinds there are, an unknown setting is named. Apart from source.c, on which
 * every kind rests.
 */
#include <stdio.h>
#include <string.h>

#include "acquire/folder_source.h"
#include "acquire/libcamera_source.h"
#include "acquire/ptp_source.h"
#include "acquire/source.h"
#include "acquire/v4l2_source.h"

/* The kinds of source there are. */
static const struct gsn_source_ops *const kinds[] = {
    &gsn_hot_folder_ops,  &gsn_replay_folder_ops,    &gsn_ptp_source_ops,
    &gsn_v4l2_source_ops, &gsn_libcamera_source_ops,
};

static const struct gsn_source_ops *find_kind(const char *address)
{
    const char *const colon = strchr(address, ':');

    for (size_t i = 0; colon && i < sizeof kinds / sizeof kinds[0]; i++) {
        const size_t length = (size_t)(colon - address);

        if (strlen(kinds[i]->kind) == length && memcmp(kinds[i]->kind, address, length) == 0)
            return kinds[i];
    }
    return NULL;
}

static int check_keys(const struct gsn_source_ops *ops, const struct gsn_source_options *options,
                      struct gsn_error *err)
{
    for (size_t i = 0; i < options->setting_count; i++) {
        const char *const *known = ops->settings;

        while (known && *known && strcmp(*known, options->setting[i].key) != 0)
            known++;
        if (!known || !*known)
            return gsn_fail(err, GSN_E_INPUT, "a source of kind %s has no setting \"%.100s\"",
                            ops->kind, options->setting[i].key);
    }
    return GSN_OK;
}

/* "give hot:FOLDER, replay:FOLDER or ptp:DEVICE", from the table. */
static int name_kinds(const char *address, struct gsn_error *err)
{
    const size_t count = sizeof kinds / sizeof kinds[0];
    char list[200] = "";

    for (size_t i = 0; i < count; i++) {
        const char *const joint = i == 0 ? "" : i + 1 < count ? ", " : " or ";
        const size_t used = strlen(list);

        (void)snprintf(list + used, sizeof list - used, "%s%s:%s", joint, kinds[i]->kind,
                       kinds[i]->subsystem ? "DEVICE" : "FOLDER");
    }
    return gsn_fail(err, GSN_E_UNSUPPORTED, "\"%.200s\" names no source: give %s", address, list);
}

static int check_address(const char *address, const struct gsn_source_options *options,
                         const struct gsn_source_ops **ret_ops, struct gsn_error *err)
{
    const struct gsn_source_ops *const ops = find_kind(address);
    int r;

    if (!ops)
        return name_kinds(address, err);
    r = check_keys(ops, options, err);
    if (r >= 0 && ops->check)
        r = ops->check(strchr(address, ':') + 1, options, err);
    if (r >= 0)
        *ret_ops = ops;
    return r;
}

int gsn_source_check(const char *address, const struct gsn_source_options *options,
                     struct gsn_error *err)
{
    const struct gsn_source_ops *ops;

    return check_address(address, options, &ops, err);
}

int gsn_source_open(const char *address, const struct gsn_source_options *options,
                    struct gsn_source **ret_source, struct gsn_error *err)
{
    const struct gsn_source_ops *ops = NULL;
    void *self = NULL;
    int r = check_address(address, options, &ops, err);

    if (r >= 0)
        r = ops->open(strchr(address, ':') + 1, options, &self, err);
    return r < 0 ? r : gsn_source_make(ops, self, address, options, ret_source, err);
}

const char *gsn_source_subsystem(const char *address)
{
    const struct gsn_source_ops *const ops = find_kind(address);

    return ops ? ops->subsystem : NULL;
}
