/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What it costs to log a scan durably, against bare SQLite in the same folder. Ours is from the
 * picture's fields to the commit that its source may be told of, and every 256th first settles
 * the ones before it, which the service does when a burst is over: ledger, panel, job and diary. */
#include "tests/bench/folder.h"
#include "tests/bench/log_peer.h"

#include <jansson.h>
#include <sqlite3.h>
#include <stdio.h>
#include <string.h>

#include "pipeline/core/hash.h"
#include "storage/catalog.h"
#include "storage/scan.h"
#include "storage/store.h"

/* The first are not timed: so many that every log has been written round, because one that only
 * grows costs each sync the file's new length too, and flatters whoever writes more. */
enum { WARM = 1000, SCANS = 2000, QUICK_WARM = 260, QUICK_SCANS = 8, PANELS = 20, SETTLED = 256 };

/* S1, S2, ...: as many as the scans need when each has so many panels. */
static void put_specimen(struct gsn_store *store, size_t number)
{
    char name[20];
    const struct gsn_specimen_row specimen = { .name = name,
                                               .study = "study",
                                               .group = "group",
                                               .animal = "animal",
                                               .week = 1,
                                               .kind = "sections",
                                               .baseline = "",
                                               .job_json = "{}",
                                               .job_sha256 = "" };
    struct gsn_error err = { 0 };
    int64_t id = 0;

    (void)snprintf(name, sizeof name, "S%zu", number);
    bench_need(gsn_specimen_put(store, &specimen, GSN_SPECIMEN_REFUSE, "bench", 1, &id, &err), &err,
               "specimen");
}

/* One table without an index, in one prepared statement: as bare as it goes. The last column holds
 * what else our transaction writes: the texts of panel, job and diary. */
static sqlite3_stmt *open_bare(const struct folder *folder, sqlite3 **ret_db)
{
    char path[100];
    sqlite3_stmt *insert = NULL;

    (void)snprintf(path, sizeof path, "%s/bare.db", folder->path);
    need(sqlite3_open(path, ret_db) == SQLITE_OK &&
             sqlite3_exec(*ret_db,
                          "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; CREATE TABLE scan "
                          "(id INTEGER PRIMARY KEY, source, device, name, key, subject, sha256, "
                          "size, facts, state, reason, panel_id, arrived, rest)",
                          NULL, NULL, NULL) == SQLITE_OK &&
             sqlite3_prepare_v2(*ret_db,
                                "INSERT INTO scan (source, device, name, key, subject, sha256, "
                                "size, facts, state, reason, panel_id, arrived, rest) VALUES "
                                "(?1, ?2, ?3, ?4, ?5, ?6, ?7, ?8, ?9, ?10, ?11, ?12, ?13)",
                                -1, &insert, NULL) == SQLITE_OK,
         "bare SQLite");
    return insert;
}

static void insert_bare(sqlite3_stmt *insert, const struct gsn_scan_row *scan)
{
    const char *const texts[] = { scan->source, scan->device,  scan->name,
                                  scan->key,    scan->subject, scan->sha256,
                                  scan->facts,  "filed",       "by its name" };
    static const int columns[] = { 1, 2, 3, 4, 5, 6, 8, 9, 10 };
    char rest[500];

    (void)snprintf(rest, sizeof rest,
                   "%s %s waiting panel waiting gieson-intake scan %s %s, from %s, filed: by its "
                   "name %s",
                   scan->name, scan->sha256, scan->name, scan->sha256, scan->source, scan->sha256);

    for (size_t i = 0; i < sizeof columns / sizeof *columns; i++)
        need(sqlite3_bind_text(insert, columns[i], texts[i], -1, SQLITE_STATIC) == SQLITE_OK,
             "bind");
    need(sqlite3_bind_int64(insert, 7, scan->size) == SQLITE_OK &&
             sqlite3_bind_int64(insert, 11, 1) == SQLITE_OK &&
             sqlite3_bind_int64(insert, 12, 1) == SQLITE_OK &&
             sqlite3_bind_text(insert, 13, rest, -1, SQLITE_STATIC) == SQLITE_OK &&
             sqlite3_step(insert) == SQLITE_DONE && sqlite3_reset(insert) == SQLITE_OK,
         "bare SQLite");
}

/* The very rows that a scan leaves, in a store of the same schema, by SQLite alone: what our own
 * code adds is the difference. */
enum bare_row {
    BARE_BEGIN,
    BARE_PANEL,
    BARE_JOB,
    BARE_AGAIN,
    BARE_SCAN,
    BARE_EVENT,
    BARE_END,
    BARE_ROWS
};

struct same {
    sqlite3 *db;
    sqlite3_stmt *row[BARE_ROWS];
};

static struct same open_same(const char *store)
{
    static const char *const sql[BARE_ROWS] = {
        "BEGIN IMMEDIATE",
        "INSERT INTO panel (specimen_id, number, file_name, sha256, size, state, code, message, "
        "width, height, px_um) VALUES (?1, ?2, ?3, ?4, 12345678, 'waiting', '', '', 0, 0, NULL)",
        "INSERT INTO job (kind, specimen_id, panel_id) VALUES ('panel', ?1, last_insert_rowid())",
        "INSERT INTO job (kind, specimen_id) VALUES ('specimen', ?1) ON CONFLICT DO NOTHING",
        "INSERT INTO scan (source, device, name, key, subject, sha256, size, facts, state, reason, "
        "panel_id, arrived) VALUES ('scanner', '04a9:31c0 SN0001', ?3, ?5, 'panel', ?4, 12345678, "
        "?6, 'filed', 'by its name', (SELECT max(id) FROM panel), 1)",
        "INSERT INTO event (id, time, actor, kind, subject, text, hash) VALUES ((SELECT "
        "coalesce(max(id), 0) + 1 FROM event), 1, 'gieson-intake', 'scan', ?3, ?4 || ', from "
        "scanner, filed: its name begins with it', ?4)",
        "COMMIT",
    };
    struct same same = { 0 };
    char path[200];

    (void)snprintf(path, sizeof path, "%s/gieson.db", store);
    need(sqlite3_open(path, &same.db) == SQLITE_OK &&
             sqlite3_exec(same.db, "PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON", NULL,
                          NULL, NULL) == SQLITE_OK,
         "bare SQLite");
    for (int i = 0; i < BARE_ROWS; i++)
        need(sqlite3_prepare_v2(same.db, sql[i], -1, &same.row[i], NULL) == SQLITE_OK, sql[i]);
    return same;
}

static void close_same(struct same *same)
{
    for (int i = 0; i < BARE_ROWS; i++)
        (void)sqlite3_finalize(same->row[i]);
    (void)sqlite3_close(same->db);
}

static void insert_same(const struct same *same, const struct gsn_scan_row *scan, size_t number)
{
    for (int i = 0; i < BARE_ROWS; i++) {
        sqlite3_stmt *const row = same->row[i];
        const char *const texts[] = { scan->name, scan->sha256, scan->key, scan->facts };
        const int parameters = sqlite3_bind_parameter_count(row);

        for (int k = 0; k < 4 && k + 3 <= parameters; k++)
            need(sqlite3_bind_text(row, k + 3, texts[k], -1, SQLITE_STATIC) == SQLITE_OK, "bind");
        if (parameters >= 1)
            need(sqlite3_bind_int64(row, 1, (int64_t)(number / PANELS + 1)) == SQLITE_OK, "bind");
        if (parameters >= 2)
            need(sqlite3_bind_int64(row, 2, (int64_t)(number % PANELS + 1)) == SQLITE_OK, "bind");
        need(sqlite3_step(row) == SQLITE_DONE && sqlite3_reset(row) == SQLITE_OK,
             sqlite3_errmsg(same->db));
    }
}

enum { OURS, SAME, BARE, PEER, LOGS };

struct logs {
    struct gsn_store *store;
    struct same same;
    sqlite3_stmt *insert;
    struct log_peer peer;
    size_t warm, count;
    double wall[LOGS][SCANS], cpu[LOGS];
    /* Of ours, those that settle and those that do not. */
    double settling[SCANS], plain[SCANS];
    size_t settlings, plains;
};

static void note(struct logs *logs, int which, size_t timed, double wall)
{
    logs->wall[which][timed] = wall;
    if (which != OURS)
        return;
    if ((logs->warm + timed) % SETTLED == 0)
        logs->settling[logs->settlings++] = wall;
    else
        logs->plain[logs->plains++] = wall;
}

static void time_log(struct logs *logs, int which, const struct gsn_scan_row *scan, size_t number)
{
    const double cpu = seconds(CLOCK_PROCESS_CPUTIME_ID), start = seconds(CLOCK_MONOTONIC);
    struct gsn_error err = { 0 };
    int64_t id = 0;
    int again = 0;

    if (which == OURS)
        bench_need(gsn_scan_stage(logs->store, scan, 0, 1, &id, &again, &err), &err, "scan");
    else if (which == SAME)
        insert_same(&logs->same, scan, number);
    else if (which == BARE)
        insert_bare(logs->insert, scan);
    else
        log_peer_slices(&logs->peer, number, 1);
    if (number < logs->warm)
        return;
    note(logs, which, number - logs->warm, seconds(CLOCK_MONOTONIC) - start);
    logs->cpu[which] += seconds(CLOCK_PROCESS_CPUTIME_ID) - cpu;
}

/* In turns, scan by scan, so that all meet the same disk; there and back, so that none always comes
 * after the one who leaves most behind. */
static void race_logs(struct logs *logs)
{
    for (size_t i = 0; i < logs->warm + logs->count; i++) {
        struct gsn_error err = { 0 };
        struct gsn_digest digest;
        char name[40], key[100];
        struct gsn_scan_row scan = { .source = "scanner",
                                     .device = "04a9:31c0 SN0001",
                                     .name = name,
                                     .key = key,
                                     .subject = "panel",
                                     .size = 12345678,
                                     .facts =
                                         "{\"Format\":\"JPEG\",\"Date\":\"20260101T120000\"}" };

        (void)snprintf(name, sizeof name, "S%zu-P%02zu.jpg", i / PANELS + 1, i % PANELS + 1);
        (void)snprintf(key, sizeof key, "SN0001/00010001/%s/12345678/20260101T120000", name);
        bench_need(gsn_sha256(name, strlen(name), &digest, &err), &err, "digest");
        scan.sha256 = digest.hex;
        scan.size += (int64_t)(i * 7919 % 1000000); /* no two pictures compress alike */
        for (size_t turn = 0; turn < LOGS; turn++)
            time_log(logs, (int)((i / 2 + (i % 2 ? LOGS - turn : turn)) % LOGS), &scan, i);
    }
}

/* ratio: of the means, to which our settling and both sides' checkpoints belong. ratio_until_safe:
 * the same up to when the source may be told, so without those that settle. ratio_of_typical: of
 * the peer's median and ours with our median settling shared out; a checkpoint is in neither, and
 * neither is what other programs do to the disk. */
static void say_log(struct logs *logs, int against, const char *name)
{
    const double ours = mean(logs->wall[OURS], logs->count);
    const double peer = mean(logs->wall[against], logs->count);
    const double safe = mean(logs->plain, logs->plains);
    const double middle = median(logs->wall[against], logs->count);
    const double plain = median(logs->plain, logs->plains);
    const double settling = median(logs->settling, logs->settlings);
    const double typical = plain + (settling > plain ? settling - plain : 0) / SETTLED;

    bench_say("ingest_log", ours * 1e3, "ms/scan", name, peer / ours,
              json_pack("{s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:f, s:I}", "ratio_until_safe",
                        peer / safe, "ratio_of_typical", middle / typical, "ratio_of_medians",
                        middle / plain, "peer_ms", peer * 1e3, "median_ms", plain * 1e3,
                        "peer_median_ms", middle * 1e3, "settling_ms", settling * 1e3, "cpu_ms",
                        logs->cpu[OURS] * 1e3 / (double)logs->count, "peer_cpu_ms",
                        logs->cpu[against] * 1e3 / (double)logs->count, "scans",
                        (json_int_t)logs->count));
}

static struct gsn_store *new_store(const struct folder *folder, const char *name, size_t count,
                                   char dir[static 100])
{
    struct gsn_store *store = NULL;
    struct gsn_error err = { 0 };

    (void)snprintf(dir, 100, "%s/%s", folder->path, name);
    bench_need(gsn_store_open(dir, GSN_STORE_CREATE, &store, &err), &err, "store");
    for (size_t i = 0; i <= (count - 1) / PANELS; i++)
        put_specimen(store, i + 1);
    return store;
}

void bench_log(void)
{
    struct folder folder = folder_new();
    struct logs *const logs = bench_alloc(1, sizeof *logs);
    char dir[100];
    sqlite3 *db = NULL;

    logs->warm = bench_quick ? QUICK_WARM : WARM;
    logs->count = bench_quick ? QUICK_SCANS : SCANS;
    gsn_store_free(new_store(&folder, "same", logs->warm + logs->count, dir));
    logs->same = open_same(dir);
    logs->store = new_store(&folder, "store", logs->warm + logs->count, dir);
    logs->insert = open_bare(&folder, &db);
    logs->peer = log_peer_open(folder.path, "slice.db");
    race_logs(logs);
    say_log(logs, SAME, "the same rows by SQLite alone, each scan's when it comes");
    say_log(logs, BARE, "one INSERT of the same texts into one table without an index");
    say_log(logs, PEER, "one INSERT of a slice's row, unique by specimen and number");
    close_same(&logs->same);
    log_peer_close(&logs->peer);
    (void)sqlite3_finalize(logs->insert);
    (void)sqlite3_close(db);
    gsn_store_free(logs->store);
    gsn_free(logs);
    folder_done(&folder);
}
