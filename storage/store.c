/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The store: one SQLite database beside the original bytes, opened, migrated and committed here.
 *
 * Steps of opening.
 * 1. The directory is judged: our application id in the database's header, and a version that we
 * know.
 * 2. Connection: WAL mode with synchronous=FULL and foreign keys on, both read back, because what a
 * commit promises rests on them; the WAL files stay after the last writer (persistent WAL). Pages
 * get their checksums by the VFS of pagesum.h.
 * 3. Migration: schema/NNN_*.sql one after the other in a transaction, the version read again under
 * its lock. Runs of a store older than the seals are sealed.
 * 4. What a crash left in the staging table is committed.
 * A transaction nests by savepoints; only the outermost commit reaches the disk. It begins with
 * committing what lies in the staging table (ledger.c), and ends by writing down where the audit
 * log ends (audit.c). So both stand below this file and write by the parts of transaction.h alone;
 * whoever begins a transaction stands above it.
 *
 * How it fails: each failure of SQLite becomes one of our codes and one sentence
 * (gsn_store_failed); after a disk error SQLite has rolled back by itself, and what follows does
 * not start anew. Cost: a commit is one fsync of the WAL. */
#include "storage/store.h"

#include <assert.h>
#include <errno.h>
#include <sqlite3.h>
#include <stdbool.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "storage/audit.h"
#include "storage/audit_log.h"
#include "storage/pagesum.h"
#include "storage/panel_log.h"
#include "storage/scan.h"
#include "storage/sql.h"
#include "storage/transaction.h"

enum { LONGEST_NAME = 150 }; /* with the digest below the 255 bytes a file system allows */

/* Paths. */

static bool is_plain(char c, bool first)
{
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' ||
           c == '-' || (c == '.' && !first);
}

/* Writes at most room - 1 characters and a zero; whole escapes only. Returns false when cut. */
static bool escape_name(const char *name, char *to, size_t room)
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
    const bool whole = escape_name(said, name, sizeof name);
    char *path;
    int r = GSN_OK;

    if (!whole)
        r = gsn_sha256(said, strlen(said), &digest, err);
    if (r < 0)
        return r;
    /* '~' is never plain, so a cut name cannot be mistaken for a whole one. */
    path =
        gsn_format("%s/%s/%s%s%s", gsn_store_dir(store), room, name, whole ? "" : "~", digest.hex);
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

enum {
    BUSY_MS = 10000,
    APPLICATION = 0x67736e31, /* "gsn1": tells our databases from others' */
    SYNCHRONOUS_FULL = 2,
};

static const char *const schemas[] = { gsn_schema_001, gsn_schema_002, gsn_schema_003,
                                       gsn_schema_004, gsn_schema_005, gsn_schema_006,
                                       gsn_schema_007, gsn_schema_008, gsn_schema_009 };

enum { NEWEST = sizeof schemas / sizeof schemas[0], SEALED_FROM = 9 };

/* Transactions. */

static int execute_sql(struct gsn_store *store, const char *sql, struct gsn_error *err)
{
    if (sqlite3_exec(store->db, sql, NULL, NULL, NULL) != SQLITE_OK) /* door */
        return gsn_store_failed(store, err);
    return GSN_OK;
}

static int begin_change(struct gsn_store *store, struct gsn_error *err)
{
    int r;

    if (store->depth == 0)
        store->log_grew = 0;
    /* After a disk error SQLite rolls back by itself; what follows must not start anew. */
    if (store->depth > 0 && sqlite3_get_autocommit(store->db))
        return gsn_fail(err, GSN_E_STORE, "%s/gieson.db: the transaction was lost", store->dir);
    r = gsn_sql_run(store, store->depth == 0 ? "BEGIN IMMEDIATE" : "SAVEPOINT inner", SQL_NO_ARGS,
                    NULL, err);
    if (r >= 0)
        store->depth++;
    return r;
}

int gsn_store_begin(struct gsn_store *store, struct gsn_error *err)
{
    int r = begin_change(store, err);

    if (r < 0 || store->depth > 1)
        return r;
    r = gsn_scan_commit_all_staged(store, err);
    if (r < 0)
        gsn_store_rollback(store);
    return r;
}

void gsn_store_rollback(struct gsn_store *store)
{
    assert(store->depth > 0);
    store->depth--;
    if (sqlite3_get_autocommit(store->db))
        return;
    (void)execute_sql(store, store->depth == 0 ? "ROLLBACK" : "ROLLBACK TO inner; RELEASE inner",
                      NULL);
}

int gsn_store_commit(struct gsn_store *store, struct gsn_error *err)
{
    struct gsn_event_tail tail = { 0 };
    int r = GSN_OK, grew;

    assert(store->depth > 0);
    grew = store->depth == 1 && store->log_grew;
    if (grew)
        r = gsn_audit_may_write_head(store, store->head, &grew, err);
    if (r >= 0 && grew)
        r = gsn_event_tail(store, &tail, err);
    if (r >= 0)
        r = gsn_sql_run(store, store->depth == 1 ? "COMMIT" : "RELEASE inner", SQL_NO_ARGS, NULL,
                        err);
    if (r < 0) {
        gsn_store_rollback(store);
        return r;
    }
    store->depth--;
    /* Behind the commit, so that the file never knows of more than the database has; quietly, for
     * what it tells of is durable already, and the next commit writes it again. */
    if (grew)
        (void)gsn_audit_write_head(store->head, &tail, NULL);
    return r;
}

int gsn_sql_end(struct gsn_store *store, int r, struct gsn_error *err)
{
    if (r >= 0)
        return gsn_store_commit(store, err);
    gsn_store_rollback(store);
    return r;
}

/* One change as a transaction of its own. */

int gsn_scan_commit_staged(struct gsn_store *store, struct gsn_error *err)
{
    bool empty = false;
    int r = gsn_scan_is_none_staged(store, &empty, err);

    if (r >= 0 && !empty)
        r = gsn_store_begin(store, err);
    if (r >= 0 && !empty)
        r = gsn_sql_end(store, gsn_scan_commit_all_staged(store, err), err);
    if (r >= 0)
        gsn_store_staging(store)->uncommitted = gsn_store_staging(store)->count = 0;
    return r;
}

int gsn_event_add(struct gsn_store *store, int64_t now, const char *actor, const char *kind,
                  const char *subject, const char *text, struct gsn_error *err)
{
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_event_append(store, now, actor, kind, subject, text, err);
    return gsn_sql_end(store, r, err);
}

int gsn_panel_put(struct gsn_store *store, const struct gsn_panel_row *panel, int64_t *ret_id,
                  int *ret_again, struct gsn_error *err)
{
    int64_t id = 0;
    int again = 0;
    int r = gsn_store_begin(store, err);

    if (r < 0)
        return r;
    r = gsn_sql_end(store, gsn_panel_insert(store, panel, &id, &again, err), err);
    if (r < 0)
        return r;
    *ret_id = id;
    *ret_again = again;
    return GSN_OK;
}

int gsn_section_replace(struct gsn_store *store, int64_t panel_id,
                        const struct gsn_section_row *sections, size_t count, struct gsn_error *err)
{
    const int r = gsn_store_begin(store, err);

    return r < 0 ? r
                 : gsn_sql_end(store,
                               gsn_section_insert_all(store, panel_id, sections, count, err), err);
}

/* The connection. */

void gsn_store_set_busy_timeout(struct gsn_store *store, int patience_ms)
{
    (void)sqlite3_busy_timeout(store->db, patience_ms);
}

static int no_store(const char *dir, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "%s is not a gieson store; `gieson import` makes one",
                    dir);
}

static int read_pragma(struct gsn_store *store, const char *sql, int64_t *ret_value,
                       struct gsn_error *err)
{
    return gsn_sql_int(store, sql, SQL_NO_ARGS, ret_value, err);
}

int gsn_store_change(struct gsn_store *store, int64_t *ret_change, struct gsn_error *err)
{
    return read_pragma(store, "PRAGMA data_version", ret_change, err);
}

/* Opening. */

/* What a commit promises rests on these two, so they are read back. */
static int configure_connection(struct gsn_store *store, struct gsn_error *err)
{
    int64_t synchronous = 0, keys = 0;
    int keep_wal = 1, r;

    if (sqlite3_busy_timeout(store->db, BUSY_MS) != SQLITE_OK ||
        sqlite3_file_control(store->db, "main", SQLITE_FCNTL_PERSIST_WAL, &keep_wal) != SQLITE_OK)
        return gsn_store_failed(store, err);
    r = execute_sql(store, "PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON", err);
    if (r >= 0)
        r = read_pragma(store, "PRAGMA synchronous", &synchronous, err);
    if (r >= 0)
        r = read_pragma(store, "PRAGMA foreign_keys", &keys, err);
    if (r >= 0 && (synchronous != SYNCHRONOUS_FULL || keys != 1))
        r = gsn_fail(err, GSN_E_STORE, "%s/gieson.db: SQLite does not promise durable commits",
                     store->dir);
    return r;
}

static int migrate_from(struct gsn_store *store, int64_t version, struct gsn_error *err)
{
    gsn_auto_mem(char) stamp = gsn_format("PRAGMA application_id = %d; PRAGMA user_version = %d",
                                          (int)APPLICATION, (int)NEWEST);
    int r = GSN_OK;

    if (!stamp)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", store->dir);
    for (int64_t next = version; r >= 0 && next < NEWEST; next++)
        r = execute_sql(store, schemas[next], err);
    if (r >= 0 && version > 0 && version < SEALED_FROM)
        r = gsn_audit_seal_old_runs(store, err);
    return r >= 0 ? execute_sql(store, stamp, err) : r;
}

static int migrate_schema(struct gsn_store *store, struct gsn_error *err)
{
    int64_t version = 0;
    int r = begin_change(store, err);

    if (r < 0)
        return r;
    /* Read again under the lock: another process may have been first. */
    r = read_pragma(store, "PRAGMA user_version", &version, err);
    if (r >= 0)
        r = migrate_from(store, version, err);
    return gsn_sql_end(store, r, err);
}

/* What a database says of itself. */
struct label {
    int64_t application, version, tables;
};

/* In one transaction, or another process might create the store between two questions. */
static int read_label(struct gsn_store *store, struct label *label, struct gsn_error *err)
{
    int r = execute_sql(store, "BEGIN", err);

    if (r < 0)
        return r;
    r = read_pragma(store, "PRAGMA user_version", &label->version, err);
    if (r >= 0)
        r = read_pragma(store, "PRAGMA application_id", &label->application, err);
    if (r >= 0)
        r = read_pragma(store, "SELECT count(*) FROM sqlite_schema", &label->tables, err);
    (void)execute_sql(store, "ROLLBACK", NULL);
    return r;
}

/* 0 means empty, which is what a crash while creating leaves. */
static int read_version(struct gsn_store *store, int64_t *ret_version, struct gsn_error *err)
{
    struct label label = { 0 };
    const int r = read_label(store, &label, err);

    if (r < 0)
        return r;
    if (label.application != APPLICATION &&
        (label.application != 0 || label.version != 0 || label.tables != 0))
        return gsn_fail(err, GSN_E_STORE, "%s/gieson.db is another program's database", store->dir);
    if (label.version > NEWEST)
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "%s was made by a newer gieson (schema %lld, this one knows %d)",
                        store->dir, (long long)label.version, (int)NEWEST);
    *ret_version = label.version;
    return GSN_OK;
}

/* SQLite's own waiting does not cover this change, which two creators may make at once. */
static int switch_journal(struct gsn_store *store, const char *sql, struct gsn_error *err)
{
    enum { NAP_MS = 10 };
    int r = execute_sql(store, sql, err);

    for (int waited = 0; r == GSN_E_BUSY && waited < BUSY_MS; waited += NAP_MS) {
        (void)sqlite3_sleep(NAP_MS);
        r = execute_sql(store, sql, err);
    }
    return r;
}

static int use_wal(struct gsn_store *store, struct gsn_error *err)
{
    int64_t wal = 0;
    int r = switch_journal(store, "PRAGMA journal_mode = WAL", err);

    if (r >= 0)
        r = read_pragma(store, "SELECT journal_mode = 'wal' FROM pragma_journal_mode", &wal, err);
    if (r >= 0 && !wal)
        r = gsn_fail(err, GSN_E_STORE, "%s/gieson.db: this file system allows no WAL", store->dir);
    return r;
}

static int reserve_bytes(struct gsn_store *store, struct gsn_error *err)
{
    int bytes = GSN_PAGESUM_BYTES;

    return sqlite3_file_control(store->db, "main", SQLITE_FCNTL_RESERVE_BYTES, &bytes) == SQLITE_OK
               ? GSN_OK
               : gsn_store_failed(store, err);
}

/* -1: the file does not say. */
static int reserved_bytes(struct gsn_store *store)
{
    int bytes = -1;

    return sqlite3_file_control(store->db, "main", SQLITE_FCNTL_RESERVE_BYTES, &bytes) == SQLITE_OK
               ? bytes
               : -1;
}

/* A store of an older gieson has no place for checksums in its pages: each is written anew, in one
 * transaction, which needs the store for itself and the log out of the way. */
static int make_room_for_sums(struct gsn_store *store, struct gsn_error *err)
{
    int r = switch_journal(store, "PRAGMA journal_mode = DELETE", err);

    if (r >= 0)
        r = reserve_bytes(store, err);
    return r >= 0 ? execute_sql(store, "VACUUM", err) : r;
}

static int prepare_schema(struct gsn_store *store, enum gsn_store_mode mode, struct gsn_error *err)
{
    int64_t version = 0;
    int r = read_version(store, &version, err);

    if (r < 0)
        return r;
    if (version == 0 && mode != GSN_STORE_CREATE)
        return no_store(store->dir, err);
    if (version < NEWEST && mode == GSN_STORE_READ)
        return gsn_fail(err, GSN_E_UNSUPPORTED,
                        "%s was made by an older gieson; any command that writes brings it up",
                        store->dir);
    if (version == 0)
        r = reserve_bytes(store, err);
    else if (version < SEALED_FROM && reserved_bytes(store) != GSN_PAGESUM_BYTES)
        r = make_room_for_sums(store, err);
    if (r >= 0 && mode != GSN_STORE_READ)
        r = use_wal(store, err);
    if (r >= 0 && version < NEWEST)
        r = migrate_schema(store, err);
    return r;
}

static int open_database(struct gsn_store *store, const char *path, enum gsn_store_mode mode,
                         struct gsn_error *err)
{
    const int flags = SQLITE_OPEN_NOMUTEX |
                      (mode == GSN_STORE_READ     ? SQLITE_OPEN_READONLY
                       : mode == GSN_STORE_CREATE ? SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE
                                                  : SQLITE_OPEN_READWRITE);
    int r;

    if (sqlite3_open_v2(path, &store->db, flags, gsn_pagesum_vfs()) != SQLITE_OK) /* door */
        return store->db ? gsn_store_failed(store, err)
                         : gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", path);
    /* SQLite falls back to reading when it may not write; we want the sentence now. */
    if (mode != GSN_STORE_READ && sqlite3_db_readonly(store->db, "main") == 1)
        return gsn_fail(err, GSN_E_IO, "%s: it cannot be opened for writing: %s", path,
                        access(path, W_OK) < 0 ? strerror(errno) : "the disk did not say why");
    r = configure_connection(store, err);
    if (r >= 0)
        r = prepare_schema(store, mode, err);
    /* What a crash left in the staging table. Who cannot commit it now can when it writes. */
    if (r >= 0 && mode != GSN_STORE_READ)
        (void)gsn_scan_commit_staged(store, NULL);
    return r;
}

static int make_dirs(const char *dir, struct gsn_error *err)
{
    static const char *const inside[] = { "objects", "reports" };

    for (size_t i = 0; i < sizeof inside / sizeof inside[0]; i++) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", dir, inside[i]);
        int r;

        if (!path)
            return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
        r = gsn_file_mkdir(path, err);
        if (r < 0)
            return r;
    }
    return gsn_file_sync_dir(dir, err);
}

int gsn_store_open(const char *dir, enum gsn_store_mode mode, struct gsn_store **ret_store,
                   struct gsn_error *err)
{
    gsn_auto(gsn_store) store = gsn_alloc_array(1, sizeof *store);
    gsn_auto_mem(char) path = gsn_format("%s/gieson.db", dir);
    int r = GSN_OK;

    if (store) {
        store->dir = gsn_strdup(dir);
        store->head = gsn_format("%s/" GSN_AUDIT_HEAD, dir);
    }
    if (!store || !path || !store->dir || !store->head)
        return gsn_fail(err, GSN_E_NOMEM, "%s: out of memory", dir);
    if (mode == GSN_STORE_CREATE)
        r = make_dirs(dir, err);
    else if (access(path, F_OK) < 0)
        r = errno == ENOENT || errno == ENOTDIR
                ? no_store(dir, err)
                : gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (r >= 0)
        r = open_database(store, path, mode, err);
    if (r < 0)
        return r;
    *ret_store = gsn_steal(&store);
    return GSN_OK;
}

int gsn_store_copy(struct gsn_store *store, const char *path, struct gsn_error *err)
{
    sqlite3_backup *backup;
    sqlite3 *to = NULL;
    int r = GSN_OK,
        is = sqlite3_open_v2(path, &to, /* door */
                             SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE, gsn_pagesum_vfs());

    backup = is == SQLITE_OK ? sqlite3_backup_init(to, "main", store->db, "main") : NULL;
    if (backup) {
        (void)sqlite3_backup_step(backup, -1);
        is = sqlite3_backup_finish(backup);
    } else if (to) {
        is = sqlite3_errcode(to);
    }
    if (is != SQLITE_OK || !backup)
        r = gsn_fail(err, gsn_sql_code(is), "%s: the database could not be copied: %s", path,
                     to ? sqlite3_errmsg(to) : "out of memory");
    (void)sqlite3_close(to);
    return r;
}

void gsn_store_free(struct gsn_store *store)
{
    if (!store)
        return;
    gsn_hash_free(store->hash);
    gsn_kept_done(&store->kept);
    (void)sqlite3_close(store->db);
    gsn_free(store->dir);
    gsn_free(store->head);
    gsn_free(store);
}
