/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "storage/store.h"

#include <stdbool.h>
#include <string.h>

#include "pipeline/core/hash.h"
#include "storage/within.h"

enum {
    DIGEST_DIGITS = 64,
    LONGEST_NAME = 150, /* with the digest below the 255 bytes a file system allows */
};

int gsn_digest_check(const char *hex, struct gsn_error *err)
{
    if (strlen(hex) != DIGEST_DIGITS || strspn(hex, "0123456789abcdef") != DIGEST_DIGITS)
        return gsn_fail(err, GSN_E_INPUT, "\"%.80s\" is not a SHA-256", hex);
    return GSN_OK;
}

int gsn_store_object_path(const struct gsn_store *store, const char *hex, char **ret_path,
                          struct gsn_error *err)
{
    const int r = gsn_digest_check(hex, err);
    char *path;

    if (r < 0)
        return r;
    path = gsn_format("%s/objects/%.2s/%s", gsn_store_dir(store), hex, hex + 2);
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    *ret_path = path;
    return GSN_OK;
}

static bool is_plain(char c, bool first)
{
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
           c == '-' || (c == '.' && !first);
}

/* Writes at most room - 1 characters and a zero; whole escapes only. Returns false when cut. */
static bool escape(const char *name, char *to, size_t room)
{
    static const char digits[] = "0123456789ABCDEF";
    size_t used = 0;

    for (const char *c = name; *c; c++) {
        const bool plain = is_plain(*c, c == name);

        to[used] = '\0';
        if (used + (plain ? 1 : 3) >= room)
            return false;
        if (plain) {
            to[used++] = *c;
            continue;
        }
        to[used++] = '%';
        to[used++] = digits[(unsigned char)*c >> 4];
        to[used++] = digits[(unsigned char)*c & 15];
    }
    to[used] = '\0';
    return true;
}

/* DIR/ROOM/NAME, for names that may hold anything. */
static int make_dir_path(const struct gsn_store *store, const char *room, const char *said,
                         char **ret_path, struct gsn_error *err)
{
    struct gsn_digest digest = { "" };
    char name[LONGEST_NAME];
    const bool whole = escape(said, name, sizeof name);
    char *path;
    int r = GSN_OK;

    if (!whole)
        r = gsn_sha256(said, strlen(said), &digest, err);
    if (r < 0)
        return r;
    /* '~' is never plain, so a cut name cannot be mistaken for a whole one. */
    path = gsn_format("%s/%s/%s%s%s", gsn_store_dir(store), room, name, whole ? "" : "~",
                      digest.hex);
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a path");
    *ret_path = path;
    return GSN_OK;
}

int gsn_store_report_dir(const struct gsn_store *store, const char *specimen, char **ret_path,
                         struct gsn_error *err)
{
    if (!*specimen)
        return gsn_fail(err, GSN_E_INPUT, "a specimen needs a name");
    return make_dir_path(store, "reports", specimen, ret_path, err);
}

int gsn_store_study_dir(const struct gsn_store *store, const char *study, char **ret_path,
                        struct gsn_error *err)
{
    if (!*study)
        return gsn_fail(err, GSN_E_INPUT, "a study needs a name: state `study` in job.json");
    return make_dir_path(store, "studies", study, ret_path, err);
}
