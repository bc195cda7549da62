/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What an import could not take.
 *
 * A file that may not be read, a link, one that does not fit: the rest of the folder comes in
 * without it, and the import ends as one that left something out. Whoever asked is told at once;
 * who looks at the store later finds a row of trouble, named by the file's whole path. The next
 * import of any folder ends the rows of files that are gone, and of those in its folder that it did
 * not leave out again. Where a watched folder is served, its source tells all this by itself. */
#include "systemd/import_parts.h"

#include "storage/bench.h"

#include <errno.h>
#include <limits.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

/* The whole path of a file in the folder, for people who stand elsewhere. gives. */
static char *path_of(const struct gsn_import *import, const char *name)
{
    char whole[PATH_MAX];

    return gsn_format("%s/%s", realpath(import->dir, whole) ? whole : import->dir, name);
}

static int note_left(struct gsn_import_work *in, const char *path, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(path);
    char **more = copy ? gsn_realloc_array(in->left, in->counts.left_out + 1, sizeof *more) : NULL;

    if (!more)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    in->left = more;
    more[in->counts.left_out++] = gsn_steal(&copy);
    return GSN_OK;
}

int gsn_import_leave_out(struct gsn_import_work *in, const char *name, const char *reason,
                         const char *action, struct gsn_error *err)
{
    gsn_auto_mem(char) path = path_of(in->import, name);
    gsn_auto_mem(char) next = gsn_format("%s; then import the folder again", action);
    const struct gsn_trouble_row row = {
        .source = GSN_IMPORT_SOURCE, .name = path, .reason = reason, .action = next
    };
    int r;

    if (!path || !next)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = note_left(in, path, err);
    if (r < 0)
        return r;
    if (in->import->left_out)
        in->import->left_out(in->import->context, name, reason, action);
    return in->import->served ? GSN_OK : gsn_trouble_put(in->import->store, &row, time(NULL), err);
}

static bool is_left(const struct gsn_import_work *in, const char *path)
{
    for (unsigned i = 0; i < in->counts.left_out; i++)
        if (strcmp(in->left[i], path) == 0)
            return true;
    return false;
}

int gsn_import_forget_left(struct gsn_import_work *in, struct gsn_error *err)
{
    gsn_auto_mem(char) folder = path_of(in->import, "");
    gsn_auto(gsn_trouble_rows) rows = NULL;
    int r = folder ? gsn_trouble_list(in->import->store, &rows, err)
                   : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    for (size_t i = 0; r >= 0 && i < rows->count; i++) {
        const char *const path = rows->at[i].name;
        struct stat st;

        if (strcmp(rows->at[i].source, GSN_IMPORT_SOURCE) != 0)
            continue;
        if ((strncmp(path, folder, strlen(folder)) == 0 && !is_left(in, path)) ||
            (lstat(path, &st) < 0 && errno == ENOENT))
            r = gsn_trouble_clear(in->import->store, GSN_IMPORT_SOURCE, path, in->import->actor,
                                  time(NULL), err);
    }
    return r;
}
