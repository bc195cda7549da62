/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A backup, in an order that leaves nothing half done that looks whole.
 *
 * 1. The database is copied by SQLite's backup interface as gieson.db.part, whole pages of one
 *    moment, while the service goes on. What it names is what is copied below; what comes in
 *    meanwhile is for the next backup.
 * 2. Objects go through the spool (acquire/spool.h): written, synced, named by the hash of what was
 *    written, which must be the one they had.
 * 3. The files of the reports' folders are copied and read back.
 * 4. The copy is audited (systemd/worker/audit.h): pages, tables, log, seals, hashes of reports,
 * sizes of objects. Then the database gets its name. A folder without gieson.db is no backup.
 *
 * A restore is a backup of the backup. Costs reading everything twice. */
#include "systemd/worker/backup.h"

#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "acquire/spool.h"
#include "pipeline/core/file.h"
#include "storage/audit_log.h"
#include "storage/catalog.h"
#include "storage/result.h"
#include "systemd/worker/audit.h"

enum { MOST_FILE_BYTES = 0x7fffffff, AT_ONCE = 256 };

struct backup {
    struct gsn_store *store;
    const char *dir;
    gsn_audit_found *found;
    void *context;
    struct gsn_spool *spool;
    struct gsn_store *copy;
    struct gsn_backup_counts counts;
    int64_t damaged;
};

static int no_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for a backup");
}

static int check_empty(const char *dir, struct gsn_error *err)
{
    gsn_auto_dir folder = opendir(dir);

    if (!folder)
        return errno == ENOENT ? gsn_file_mkdir(dir, err)
                               : gsn_fail(err, GSN_E_IO, "%s: %s", dir, strerror(errno));
    for (const struct dirent *e; (e = readdir(folder));)
        if (strcmp(e->d_name, ".") != 0 && strcmp(e->d_name, "..") != 0)
            return gsn_fail(err, GSN_E_INPUT,
                            "%s is not empty (%s): nothing is ever written over; name a new folder",
                            dir, e->d_name);
    return GSN_OK;
}

static void hear_finding(void *context, const char *what, const char *sentence)
{
    struct backup *const b = context;

    b->damaged++;
    if (b->found)
        b->found(b->context, what, sentence);
}

/* ---- the originals ------------------------------------------------------------------------ */

static int copy_object(struct backup *b, const char *sha256, struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    struct gsn_error why = { 0 };
    struct gsn_spooled spooled;
    gsn_auto_fd fd = -1;
    int r = gsn_store_object_path(b->store, sha256, &path, err);

    if (r < 0)
        return r;
    r = gsn_file_open(path, &fd, &why);
    if (r == GSN_E_NOTFOUND) {
        hear_finding(b, path, why.text);
        return GSN_OK;
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    r = gsn_spool_take_fd(b->spool, fd, path, &spooled, err);
    if (r < 0 && r != GSN_E_INPUT)
        return r;
    if (r < 0 || strcmp(spooled.digest.hex, sha256) != 0) {
        hear_finding(b, path, "its bytes are no longer those that came in");
        return GSN_OK;
    }
    b->counts.objects++;
    b->counts.bytes += (int64_t)spooled.size;
    return GSN_OK;
}

static int copy_objects(struct backup *b, struct gsn_error *err)
{
    char after[65] = "";

    for (;;) {
        gsn_auto(gsn_object_rows) rows = NULL;
        int r = gsn_object_list(b->copy, after, AT_ONCE, &rows, err);

        if (r < 0 || rows->count == 0)
            return r;
        for (size_t i = 0; r >= 0 && i < rows->count; i++) {
            r = copy_object(b, rows->at[i].sha256, err);
            (void)snprintf(after, sizeof after, "%s", rows->at[i].sha256);
        }
        if (r < 0)
            return r;
    }
}

/* ---- the reports -------------------------------------------------------------------------- */

static int copy_file(struct backup *b, const char *relative, struct gsn_error *err)
{
    gsn_auto_mem(char) from = gsn_format("%s/%s", gsn_store_dir(b->store), relative);
    gsn_auto_mem(char) to = gsn_format("%s/%s", b->dir, relative);
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_digest was, is;
    gsn_auto_fd fd = -1;
    size_t size = 0;
    int r = from && to ? gsn_file_read(from, MOST_FILE_BYTES, &bytes, &size, err) : no_memory(err);

    if (r >= 0)
        r = gsn_sha256(bytes, size, &was, err);
    if (r >= 0)
        r = gsn_file_write(to, bytes, size, err);
    if (r >= 0)
        r = gsn_file_open(to, &fd, err);
    if (r >= 0)
        r = gsn_sha256_file(fd, to, &is, NULL, err);
    if (r >= 0 && strcmp(was.hex, is.hex) != 0)
        r = gsn_fail(err, GSN_E_IO, "%s: reads back as other bytes than were written", to);
    b->counts.files += r >= 0;
    return r;
}

/* The folder of one run: reports/SPECIMEN/KEY. */
static int copy_folder(struct backup *b, const char *relative, struct gsn_error *err)
{
    gsn_auto_mem(char) from = gsn_format("%s/%s", gsn_store_dir(b->store), relative);
    gsn_auto_mem(char) to = gsn_format("%s/%s", b->dir, relative);
    gsn_auto_dir folder = from ? opendir(from) : NULL;
    int r = from && to ? gsn_file_mkdir(to, err) : no_memory(err);

    for (const struct dirent *e; r >= 0 && folder && (e = readdir(folder));) {
        gsn_auto_mem(char) name = gsn_format("%s/%s", relative, e->d_name);

        if (!name)
            r = no_memory(err);
        else if (e->d_name[0] != '.')
            r = copy_file(b, name, err);
    }
    return r;
}

static int copy_reports(struct backup *b, struct gsn_error *err)
{
    gsn_auto(gsn_run_rows) runs = NULL;
    int r = gsn_run_list(b->copy, 0, &runs, err);

    for (size_t i = 0; r >= 0 && i < runs->count; i++) {
        const char *const path = runs->at[i].json_path;
        const char *const end = strrchr(path, '/');
        gsn_auto_mem(char) folder = end ? gsn_format("%.*s", (int)(end - path), path) : NULL;
        gsn_auto_mem(char) there = folder ? gsn_format("%s/%s", b->dir, path) : NULL;

        /* Several runs of the same inputs have one folder. */
        if (folder && there && access(there, F_OK) < 0)
            r = copy_folder(b, folder, err);
    }
    return r;
}

/* ---- the whole ---------------------------------------------------------------------------- */

/* The database of one moment, in a folder of its own until all that it names is there. */
static int copy_database(struct backup *b, const char *part, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/gieson.db", part);
    int r = path ? gsn_file_mkdir(part, err) : no_memory(err);

    if (r >= 0)
        r = gsn_store_copy(b->store, path, err);
    return r < 0 ? r : gsn_store_open(part, GSN_STORE_WRITE, &b->copy, err);
}

/* The copy of the database gets its name, and what SQLite put beside it goes. */
static int name_database(struct backup *b, const char *part, struct gsn_error *err)
{
    static const char *const beside[] = { "gieson.db-wal", "gieson.db-shm", "audit.head" };
    gsn_auto_mem(char) from = gsn_format("%s/gieson.db", part);
    gsn_auto_mem(char) to = gsn_format("%s/gieson.db", b->dir);

    gsn_store_free(gsn_steal(&b->copy));
    if (!from || !to)
        return no_memory(err);
    for (size_t i = 0; i < sizeof beside / sizeof *beside; i++) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", part, beside[i]);

        if (!path)
            return no_memory(err);
        if (unlink(path) < 0 && errno != ENOENT)
            return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    }
    if (rename(from, to) < 0 || rmdir(part) < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", to, strerror(errno));
    return gsn_file_sync_dir(b->dir, err);
}

/* What was copied as a store: is it one that says what it was told? */
static int read_back(struct backup *b, const char *actor, struct gsn_error *err)
{
    gsn_auto(gsn_store) copy = NULL;
    gsn_auto_heads heads = { .count = 0 };
    int r = gsn_audit_pages(b->dir, hear_finding, b, NULL, err);

    if (r >= 0)
        r = gsn_store_open(b->dir, GSN_STORE_WRITE, &copy, err);
    if (r >= 0)
        r = gsn_audit_store(copy, &heads, 1, hear_finding, b, &b->counts.events, err);
    if (r < 0 || b->damaged > 0)
        return r;
    r = gsn_event_add(copy, time(NULL), actor, "copy", "", gsn_store_dir(b->store), err);
    /* No commit comes that would write it again. */
    return r < 0 ? r : gsn_audit_renew_head(copy, err);
}

static int make_backup(struct backup *b, const char *actor, struct gsn_error *err)
{
    gsn_auto_mem(char) part = gsn_format("%s/part", b->dir);
    gsn_auto_mem(char) database = gsn_format("%s/gieson.db", b->dir);
    int r = part && database ? copy_database(b, part, err) : no_memory(err);

    if (r >= 0)
        r = gsn_spool_open(b->dir, 0, &b->spool, err);
    if (r >= 0)
        r = copy_objects(b, err);
    if (r >= 0)
        r = copy_reports(b, err);
    if (r >= 0)
        r = copy_file(b, GSN_AUDIT_HEAD, err);
    if (r >= 0 && b->damaged == 0)
        r = name_database(b, part, err);
    if (r >= 0 && b->damaged == 0)
        r = read_back(b, actor, err);
    if (r >= 0 && b->damaged == 0)
        return GSN_OK;
    /* A folder without it is no backup. */
    if (database)
        (void)unlink(database);
    return r < 0 ? r
                 : gsn_fail(err, GSN_E_INPUT,
                            "%s: no backup was made, for %lld things in it are damaged: mend them "
                            "first, or keep the whole folder as it is",
                            gsn_store_dir(b->store), (long long)b->damaged);
}

int gsn_backup_make(struct gsn_store *store, const char *dir, const char *actor,
                    gsn_audit_found *found, void *context, struct gsn_backup_counts *ret_counts,
                    struct gsn_error *err)
{
    struct backup b = { .store = store, .dir = dir, .found = found, .context = context };
    int r = check_empty(dir, err);

    if (r >= 0)
        r = make_backup(&b, actor, err);
    gsn_store_free(b.copy);
    gsn_spool_free(b.spool);
    if (r >= 0)
        *ret_counts = b.counts;
    return r;
}
