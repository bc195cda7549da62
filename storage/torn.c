/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The method: both objects are read side by side. From the first byte in which they differ to the
 * last, the torn one holds nothing but zeros, or has ended: so is a file that was cut, or made to
 * its length (ftruncate(2), posix_fallocate(3)) and filled from its beginning, its end or both.
 * Another scan of the same name differs in its data and never passes; nor does a picture in which
 * somebody has blackened a place, for between two rows of that stand bytes that are alike.
 *
 * It costs reading both once, and only where two pictures of one name are not the same. */
#include "storage/torn.h"

#include <errno.h>
#include <math.h>
#include <stdbool.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/sql.h"
#include "storage/transaction.h"

enum { PIECE = 1 << 16 };

static int open_object(const struct gsn_store *store, const char *sha256, int *ret_fd,
                       struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    const int r = gsn_store_object_path(store, sha256, &path, err);

    return r < 0 ? r : gsn_file_open(path, ret_fd, err);
}

/* The whole piece, or what is left of the file. */
static int read_piece(int fd, off_t at, uint8_t *piece, size_t *ret_got, struct gsn_error *err)
{
    size_t got = 0;

    while (got < PIECE) {
        const ssize_t more = pread(fd, piece + got, PIECE - got, at + (off_t)got);

        if (more < 0 && errno == EINTR)
            continue;
        if (more < 0)
            return gsn_fail(err, GSN_E_IO, "an object: %s", strerror(errno));
        if (more == 0)
            break;
        got += (size_t)more;
    }
    *ret_got = got;
    return GSN_OK;
}

int gsn_torn_compare(const struct gsn_store *store, const char *torn, const char *whole,
                     int *ret_is_torn, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) a = gsn_alloc(PIECE);
    gsn_auto_mem(uint8_t) b = gsn_alloc(PIECE);
    gsn_auto_fd torn_fd = -1, whole_fd = -1;
    bool differ = false, behind = false; /* bytes of the first behind the stretch that differs */
    int r;

    if (!a || !b)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for two pictures of one name");
    r = open_object(store, torn, &torn_fd, err);
    if (r >= 0)
        r = open_object(store, whole, &whole_fd, err);
    for (off_t at = 0; r >= 0; at += PIECE) {
        size_t had = 0, has = 0;

        r = read_piece(torn_fd, at, a, &had, err);
        if (r >= 0)
            r = read_piece(whole_fd, at, b, &has, err);
        if (r < 0)
            return r;
        if (had == 0)
            break;
        for (size_t i = 0; i < had; i++) {
            if (i < has && a[i] == b[i]) {
                behind = behind || (differ && a[i] != 0);
                continue;
            }
            if (a[i] != 0 || behind) {
                *ret_is_torn = 0;
                return GSN_OK;
            }
            differ = true;
        }
    }
    if (r >= 0)
        *ret_is_torn = 1;
    return r;
}

/* What was the panel is a picture of its own now, so that its object is read again and kept. */
static int keep_torn(struct gsn_store *store, const struct gsn_panel_row *torn, int64_t now,
                     struct gsn_error *err)
{
    static const char reason[] = "a torn beginning of the picture that came under this name later";
    int64_t changed = 0;
    const int r = gsn_sql_run(store,
                              "UPDATE scan SET state = 'kept', reason = ?3, panel_id = NULL "
                              "WHERE panel_id = ?1 AND sha256 = ?2",
                              SQL_ARGS(SQL_INT(torn->id), SQL_TEXT(torn->sha256), SQL_TEXT(reason)),
                              &changed, err);

    if (r < 0 || changed > 0)
        return r;
    return gsn_sql_run(store,
                       "INSERT INTO scan (source, device, name, key, subject, sha256, size, facts, "
                       "state, reason, arrived) SELECT 'import', '', ?1, '', 'panel', ?2, ?3, '', "
                       "'kept', ?4, ?5 WHERE NOT EXISTS (SELECT 1 FROM scan WHERE source = "
                       "'import' AND name = ?1 AND sha256 = ?2)",
                       SQL_ARGS(SQL_TEXT(torn->file_name), SQL_TEXT(torn->sha256),
                                SQL_INT(torn->size), SQL_TEXT(reason), SQL_INT(now)),
                       NULL, err);
}

static int put_in_place(struct gsn_store *store, const struct gsn_panel_row *torn,
                        const struct gsn_panel_row *whole, int64_t now, const char *actor,
                        struct gsn_error *err)
{
    gsn_auto_mem(char) text = gsn_format("%s was a torn beginning of %s, which takes its place; "
                                         "both are kept",
                                         torn->sha256, whole->sha256);
    int64_t job = 0;
    int r = text ? keep_torn(store, torn, now, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory for the audit log");

    if (r >= 0)
        r = gsn_sql_run(
            store,
            "UPDATE panel SET sha256 = ?2, size = ?3, state = 'waiting', code = '', message = '', "
            "width = 0, height = 0, px_um = NULL, mirrored = NULL, quarters = NULL, "
            "turn_note = '' WHERE id = ?1",
            SQL_ARGS(SQL_INT(torn->id), SQL_TEXT(whole->sha256), SQL_INT(whole->size)), NULL, err);
    if (r >= 0)
        r = gsn_sql_run(store, "DELETE FROM section WHERE " SECTIONS_OF("?1"),
                        SQL_ARGS(SQL_INT(torn->id)), NULL, err);
    if (r >= 0)
        r = gsn_queue_ask(store, torn->specimen_id, torn->id, &job, err);
    if (r >= 0)
        r = gsn_queue_ask(store, torn->specimen_id, 0, &job, err);
    return r < 0 ? r : gsn_event_append(store, now, actor, "torn", whole->file_name, text, err);
}

int gsn_torn_replace(struct gsn_store *store, const struct gsn_panel_row *whole, int64_t now,
                     const char *actor, int64_t *ret_panel, struct gsn_error *err)
{
    gsn_auto(gsn_panel_row) there = NULL;
    struct gsn_error quiet = { 0 };
    int64_t id = 0;
    int is_torn = 0;
    int r = gsn_sql_int(
        store,
        "SELECT id FROM panel WHERE specimen_id = ?1 AND file_name = ?2 AND "
        "NOT EXISTS (SELECT 1 FROM panel WHERE specimen_id = ?1 AND sha256 = ?3) "
        "ORDER BY id DESC LIMIT 1",
        SQL_ARGS(SQL_INT(whole->specimen_id), SQL_TEXT(whole->file_name), SQL_TEXT(whole->sha256)),
        &id, err);

    *ret_panel = 0;
    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r >= 0)
        r = gsn_panel_get(store, id, &there, err);
    if (r < 0)
        return r;
    r = gsn_torn_compare(store, there->sha256, whole->sha256, &is_torn, &quiet);
    /* An object that cannot be read says nothing; who reads it next will say so. */
    if (r < 0 || !is_torn)
        return r == GSN_E_NOMEM ? gsn_fail(err, r, "%s", quiet.text) : GSN_OK;
    r = put_in_place(store, there, whole, now, actor, err);
    if (r >= 0)
        *ret_panel = id;
    return r;
}
