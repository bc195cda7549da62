/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* store_faults [STEP]: what opens a store and looks it over, with the N-th call of the system
 * failing, once or for ever, or the process ending there, for every STEP-th N:
 *   - a store of each older version, while it is brought up to this one;
 *   - a store whose last writer died with pictures in the log and in the inbox, while it recovers;
 *   - a scrub;
 *   - a backup of a store with a report, and a restore, which is a backup of the backup;
 *   - a report made again and compared (verify).
 * Whatever happened: no crash, a sentence that names the fault, and without faults the next one
 * finds every row and every object as they were. A folder that has the name of a backup's database
 * is a whole backup. What could not be read is told as that, and never as forged. */
#include <errno.h>
#include <ftw.h>
#include <signal.h>
#include <sqlite3.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/audit_log.h"
#include "storage/result.h"
#include "storage/scan.h"
#include "storage/sql.h"
#include "storage/store.h"
#include "systemd/worker/backup.h"
#include "systemd/worker/import.h"
#include "systemd/worker/job.h"
#include "systemd/worker/scrub.h"
#include "systemd/worker/verify.h"
#include "tests/specimen/drawn_panel.h"
#include "tests/power/bench.h"
#include "tests/power/fault.h"
#include "tests/power/ingest.h"

enum { PICTURES = 3, SENTENCE = 600, VERSIONS = 9, APPLICATION = 0x67736e31 };

/* Told by the process that meets the faults; it lies in memory both see. */
struct told {
    long calls;
    int code;
    bool ended; /* it came to its end, well or not */
    char sentence[SENTENCE];
    bool named;             /* a finding named the fault */
    char accused[SENTENCE]; /* a finding that does not name it; "": none */
};

static struct told *told;

static const struct gsn_job_options job_options = { .mesher = GSN_MESHER,
                                                    .owner = "test",
                                                    .threads = 1 };

/* Whether a sentence says that a call failed, in libc's words or SQLite's. */
static bool names_fault(const char *sentence)
{
    return strstr(sentence, strerror(EIO)) || strstr(sentence, "disk I/O error") ||
           strstr(sentence, strerror(ENOSPC)) || strstr(sentence, "disk is full") ||
           strstr(sentence, "unable to open database file") ||
           strstr(sentence, "cannot be opened for writing") ||
           strstr(sentence, "or cannot be looked at") || strstr(sentence, "database is locked") ||
           strstr(sentence, "locking protocol");
}

/* What an audit found: with a fault about, only the fault. */
static void accuse(void *context, const char *what, const char *sentence)
{
    (void)context;
    if (names_fault(sentence))
        told->named = true;
    else if (!told->accused[0])
        (void)snprintf(told->accused, SENTENCE, "%s: %s", what, sentence);
}

/* ---- a store to begin with, copied for each run ---- */

struct places {
    const struct power_bench *bench;
    char made[256]; /* the store as it was made */
    int version;    /* of that, where it is an older one */
};

static const char *copy_from, *copy_to; /* for nftw(), which hands nothing on */

static int copy_one(const char *path, const struct stat *st, int what, struct FTW *walk)
{
    gsn_auto_mem(char) to = gsn_format("%s%s", copy_to, path + strlen(copy_from));
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_error err = { 0 };
    size_t size = 0;

    (void)walk;
    if (!to)
        return -1;
    if (what == FTW_D)
        return mkdir(to, 0755);
    if (what == FTW_SL) {
        char target[256] = ""; /* of the last report: a folder's name */

        return readlink(path, target, sizeof target - 1) < 0 ? -1 : symlink(target, to);
    }
    if (gsn_file_read(path, (size_t)st->st_size, &bytes, &size, &err) < 0)
        power_give_up(err.text);
    FILE *const file = fopen(to, "wb"); /* door: SQLite's files must not be renamed into place */

    if (!file || fwrite(bytes, 1, size, file) != size || fclose(file) != 0)
        power_give_up(to);
    return 0;
}

static void copy_tree(const char *from, const char *to)
{
    copy_from = from;
    copy_to = to;
    if (nftw(from, copy_one, 8, FTW_PHYS) != 0)
        power_give_up(to);
}

/* Published schemas are never changed, so an old store is what they make up to its version. */
static void make_old(struct places *places)
{
    static const char rows[] =
        "INSERT INTO study VALUES (1, 'st'); INSERT INTO study_group VALUES (1, 1, 'g');"
        "INSERT INTO animal VALUES (1, 1, 'rat');"
        "INSERT INTO specimen VALUES (1, 'S1', 1, 1, 1, 4, 'sections', '', '{}', "
        "printf('%064d', 1));"
        "INSERT INTO panel VALUES (1, 1, 1, 'P1.tif', printf('%064d', 1), 9, 'registered', '', '', "
        "10, 10, 12), (2, 1, 2, 'P2.tif', printf('%064d', 2), 9, 'refused', 'input', 'torn', 0, 0, "
        "NULL);"
        "INSERT INTO section (id, panel_id, slot, serial, state, flags) VALUES "
        "(1, 1, 1, 1, 'found', ''), (2, 1, 2, 2, 'needs-eye', 'marks');"
        "INSERT INTO marker VALUES (1, 1, 1, 5, 6, 2, 1, 0, 1, 9), (1, 2, 0, NULL, NULL, NULL, "
        "NULL, NULL, NULL, NULL);"
        "INSERT INTO job (kind, specimen_id, panel_id) VALUES ('panel', 1, 2);";
    static const char *const schemas[VERSIONS - 1] = { gsn_schema_001, gsn_schema_002,
                                                       gsn_schema_003, gsn_schema_004,
                                                       gsn_schema_005, gsn_schema_006,
                                                       gsn_schema_007, gsn_schema_008 };
    gsn_auto_mem(char) path = gsn_format("%s/gieson.db", places->made);
    gsn_auto_mem(char) stamp = gsn_format("PRAGMA application_id = %d; PRAGMA user_version = %d",
                                          (int)APPLICATION, places->version);
    struct gsn_error err = { 0 };
    sqlite3 *db = NULL;
    int r;

    if (!path || !stamp || gsn_file_mkdir(places->made, &err) < 0)
        power_give_up(err.text);
    r = sqlite3_open(path, &db); /* door */
    for (int v = 0; r == SQLITE_OK && v < places->version; v++) {
        r = sqlite3_exec(db, schemas[v], NULL, NULL, NULL); /* door */
        if (r == SQLITE_OK && v == 0)
            r = sqlite3_exec(db, rows, NULL, NULL, NULL); /* door */
    }
    if (r == SQLITE_OK)
        r = sqlite3_exec(db, stamp, NULL, NULL, NULL); /* door */
    if (r != SQLITE_OK)
        power_give_up(sqlite3_errmsg(db));
    (void)sqlite3_close(db);
}

static void ingest_and_die(const struct places *places)
{
    const struct power_ingest all = { .store = places->made, .address = places->bench->address };
    const struct gsn_scan_row late = { .source = "folder",
                                       .device = "",
                                       .name = "late.jpg",
                                       .key = "",
                                       .subject = "panel",
                                       .sha256 =
                                           "00000000000000000000000000000000000000000000000000"
                                           "000000000000ab",
                                       .size = 7,
                                       .facts = "" };
    struct gsn_store *store = NULL;
    struct gsn_error err = { 0 };
    unsigned taken = 0;
    int64_t id;
    int again;

    /* It is never closed, so the log is not written back, and the last picture lies in the inbox.
     */
    if (power_ingest(&all, &taken, &err) < 0 || taken != PICTURES ||
        gsn_store_open(places->made, GSN_STORE_WRITE, &store, &err) < 0 ||
        gsn_scan_stage(store, &late, 1, 1800000000, &id, &again, &err) < 0)
        power_give_up(err.text);
    _exit(0);
}

static bool ended_well(pid_t child)
{
    int status = 0;

    if (child < 0 || waitpid(child, &status, 0) < 0)
        power_give_up("a child");
    return WIFEXITED(status) && (WEXITSTATUS(status) == 0 || WEXITSTATUS(status) == FAULT_DIED);
}

static void make_hot(struct places *places)
{
    const pid_t child = fork();

    if (child == 0)
        ingest_and_die(places);
    if (!ended_well(child))
        power_give_up("a store to recover");
}

/* With all objects, and closed as it should be. */
static void make_whole(struct places *places)
{
    const struct power_ingest all = { .store = places->made, .address = places->bench->address };
    struct gsn_error err = { 0 };
    unsigned taken = 0;

    if (power_ingest(&all, &taken, &err) < 0 || taken != PICTURES)
        power_give_up(err.text);
}

/* With a report on two panels. */
static void make_reported(struct places *places)
{
    static const char job[] = "{\"specimen\": \"S1\", \"px_um\": 24, \"layout\": [2, 2], "
                              "\"panels\": 2, \"transfer\": \"linear\", \"thresholds\": [0.5], "
                              "\"markers_um\": " DRAWN_MARKS_JSON "}";
    gsn_auto_mem(char) folder = gsn_format("%s/specimen", places->bench->dir);
    gsn_auto_mem(char) written = gsn_format("%s/job.json", folder);
    gsn_auto_mem(char) specimen = NULL;
    struct gsn_import import = { .dir = folder, .actor = "test" };
    struct gsn_import_counts counts;
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };
    int r = gsn_file_mkdir(folder, &err);

    if (r >= 0)
        r = gsn_file_write(written, job, sizeof job - 1, &err);
    for (unsigned number = 1; r >= 0 && number <= 2; number++) {
        const struct drawn_panel panel = drawn_panel_of(number, 24, 0.1);
        gsn_auto_mem(char) path = gsn_format("%s/P%02u.png", folder, number);
        size_t size;
        gsn_auto_mem(uint8_t) png = drawn_panel_png(&panel, &size);

        r = gsn_file_write(path, png, size, &err);
    }
    if (r >= 0)
        r = gsn_store_open(places->made, GSN_STORE_CREATE, &store, &err);
    import.store = store;
    if (r >= 0)
        r = gsn_import_folder(&import, &specimen, &counts, &err);
    while (r >= 0)
        r = gsn_job_next(store, &job_options, &err);
    if (r != GSN_E_NOTFOUND) /* nothing more to do */
        power_give_up(err.text);
}

/* ---- what is done with it ---- */

static int open_it(const char *dir, struct gsn_error *err)
{
    gsn_auto(gsn_store) store = NULL;

    return gsn_store_open(dir, GSN_STORE_WRITE, &store, err);
}

static int scrub_it(const char *dir, struct gsn_error *err)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_scrub_counts counts;
    struct gsn_scrub scrub = { .actor = "test" };
    int r = gsn_store_open(dir, GSN_STORE_WRITE, &store, err);

    scrub.store = store;
    return r < 0 ? r : gsn_scrub_run(&scrub, &counts, err);
}

/* Beside the store: it must not lie in it. gives. */
static char *backup_place(const char *dir)
{
    char *const place = gsn_format("%s-copy", dir);

    if (!place)
        power_give_up("memory");
    return place;
}

static int back_up(const char *dir, struct gsn_error *err)
{
    gsn_auto_mem(char) place = backup_place(dir);
    gsn_auto(gsn_store) store = NULL;
    struct gsn_backup_counts counts;
    int r = gsn_store_open(dir, GSN_STORE_READ, &store, err);

    return r < 0 ? r : gsn_backup_make(store, place, "test", accuse, NULL, &counts, err);
}

static int verify_it(const char *dir, struct gsn_error *err)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_verdict verdict;
    struct gsn_verify verify = { .run = 1, .options = &job_options, .found = accuse };
    int r = gsn_store_open(dir, GSN_STORE_WRITE, &store, err);

    verify.store = store;
    return r < 0 ? r : gsn_verify_run(&verify, &verdict, err);
}

/* ---- whether all is there afterwards ---- */

static bool is(struct gsn_store *store, const char *sql, int64_t expected, char text[SENTENCE])
{
    struct gsn_error err = { 0 };
    int64_t value = -1;

    if (gsn_sql_int(store, sql, SQL_NO_ARGS, &value, &err) >= 0 && value == expected)
        return true;
    (void)snprintf(text, SENTENCE, "%s: %lld, not %lld %s", sql, (long long)value,
                   (long long)expected, err.text);
    return false;
}

static bool is_sound(struct gsn_store *store, char text[SENTENCE])
{
    struct gsn_event_verdict verdict = { .broken = -1 };
    struct gsn_error err = { 0 };

    if (gsn_event_verify(store, NULL, &verdict, &err) < 0 || verdict.broken != 0) {
        (void)snprintf(text, SENTENCE, "the audit log is broken at %lld: %s",
                       (long long)verdict.broken, err.text);
        return false;
    }
    return is(store, "SELECT integrity_check = 'ok' FROM pragma_integrity_check", 1, text) &&
           is(store, "SELECT count(*) FROM pragma_foreign_key_check", 0, text);
}

static bool old_is_fine(struct gsn_store *store, char text[SENTENCE])
{
    return is(store, "SELECT count(*) FROM panel WHERE size = 9", 2, text) &&
           is(store, "SELECT count(*) FROM section WHERE panel_id = 1", 2, text) &&
           is(store,
              "SELECT mark1_x_px = 5 AND mark1_y_px = 6 AND mark2_x_px IS NULL FROM section "
              "WHERE slot = 1",
              1, text) &&
           is(store, "SELECT count(*) FROM job WHERE state = 'waiting' AND panel_id = 2", 1, text);
}

static bool hot_is_fine(struct gsn_store *store, char text[SENTENCE])
{
    return is(store, "SELECT count(*) FROM scan", PICTURES + 1, text) &&
           is(store, "SELECT count(*) FROM inbox", 0, text) &&
           is(store, "SELECT count(*) FROM scan WHERE name = 'late.jpg'", 1, text);
}

static bool scrubbed_is_fine(struct gsn_store *store, char text[SENTENCE])
{
    struct gsn_scrub_counts counts = { 0 };
    const struct gsn_scrub scrub = { .store = store, .actor = "test" };
    struct gsn_error err = { 0 };
    int r = gsn_scrub_run(&scrub, &counts, &err);

    /* A round that was broken off is finished first; then one that sees everything. */
    if (r >= 0)
        r = gsn_scrub_run(&scrub, &counts, &err);
    if (r < 0 || counts.damaged != 0 || !counts.complete || counts.round_checked != PICTURES) {
        (void)snprintf(text, SENTENCE, "the scrub afterwards: %lld of %lld damaged: %s",
                       (long long)counts.damaged, (long long)counts.round_checked, err.text);
        return false;
    }
    return is(store, "SELECT count(*) FROM scan", PICTURES, text) &&
           is(store, "SELECT count(*) FROM trouble", 0, text);
}

static void refuse(void *context, const char *what, const char *sentence)
{
    if (!((char *)context)[0])
        (void)snprintf(context, SENTENCE, "%s: %s", what, sentence);
}

static bool has_report(struct gsn_store *store, char text[SENTENCE])
{
    return is(store, "SELECT count(*) FROM panel WHERE state = 'registered'", 2, text) &&
           is(store, "SELECT count(*) FROM run WHERE json_sha256 <> ''", 1, text);
}

/* No folder, one without a database, which is no backup, or a whole one. */
static bool is_no_or_whole_backup(const char *place, bool must_be, char text[SENTENCE])
{
    gsn_auto_mem(char) database = gsn_format("%s/gieson.db", place);
    gsn_auto(gsn_store) copy = NULL;
    struct gsn_audit_heads heads = { .count = 0 };
    struct gsn_error err = { 0 };
    int r;

    if (!database || access(database, F_OK) < 0) {
        (void)snprintf(text, SENTENCE, "it ended well and there is no backup");
        return !must_be;
    }
    text[0] = '\0';
    r = gsn_store_open(place, GSN_STORE_WRITE, &copy, &err);
    if (r >= 0)
        r = gsn_audit_store(copy, &heads, 1, refuse, text, NULL, &err);
    gsn_audit_heads_done(&heads);
    if (r < 0)
        (void)snprintf(text, SENTENCE, "its backup: %s", err.text);
    return r >= 0 && !text[0] && has_report(copy, text);
}

static bool backed_up_is_fine(struct gsn_store *store, char text[SENTENCE])
{
    gsn_auto_mem(char) place = backup_place(gsn_store_dir(store));
    bool fine = has_report(store, text) &&
                is_no_or_whole_backup(place, told->ended && told->code >= 0, text);
    struct gsn_backup_counts counts = { 0 };
    struct gsn_error err = { 0 };

    power_remove_tree(place);
    if (fine && gsn_backup_make(store, place, "test", NULL, NULL, &counts, &err) < 0) {
        (void)snprintf(text, SENTENCE, "a backup afterwards: %s", err.text);
        fine = false;
    }
    fine = fine && is_no_or_whole_backup(place, true, text);
    power_remove_tree(place);
    return fine;
}

/* The calls are those of reading; what it would take to change a row is swept elsewhere. */
static bool verified_is_fine(struct gsn_store *store, char text[SENTENCE])
{
    struct gsn_audit_heads heads = { .count = 0 };
    struct gsn_error err = { 0 };

    text[0] = '\0';
    if (gsn_audit_store(store, &heads, 1, refuse, text, NULL, &err) < 0)
        (void)snprintf(text, SENTENCE, "the audit afterwards: %s", err.text);
    gsn_audit_heads_done(&heads);
    return !text[0] && has_report(store, text);
}

struct act {
    const char *what;
    void (*make)(struct places *places);
    int (*run)(const char *dir, struct gsn_error *err);
    bool (*is_fine)(struct gsn_store *store, char text[SENTENCE]);
};

/* ---- the sweep ---- */

struct tally {
    size_t runs, failed, died, crashed, mute, accused, bad;
};

static bool meets(const struct places *places, const struct act *act, const struct fault *fault)
{
    pid_t child;

    memset(told, 0, sizeof *told);
    child = fork();
    if (child == 0) {
        struct gsn_error err = { 0 };

        (void)alarm(120);
        fault_arm(fault);
        told->code = act->run(places->bench->store, &err);
        told->calls = fault_disarm();
        told->ended = true;
        (void)snprintf(told->sentence, SENTENCE, "%s", err.text);
        _exit(0);
    }
    return ended_well(child);
}

/* In a process of its own too: what it opens is closed with it. */
static bool is_fine_afterwards(const struct places *places, const struct act *act,
                               char text[SENTENCE])
{
    const pid_t child = fork();

    if (child == 0) {
        struct gsn_store *store = NULL;
        struct gsn_error err = { 0 };
        bool fine = gsn_store_open(places->bench->store, GSN_STORE_WRITE, &store, &err) >= 0;

        (void)snprintf(told->sentence, SENTENCE, "it cannot be opened: %s", err.text);
        fine = fine && is_sound(store, told->sentence) && act->is_fine(store, told->sentence);
        gsn_store_free(store);
        _exit(fine ? 0 : 1);
    }
    if (ended_well(child))
        return true;
    (void)snprintf(text, SENTENCE, "%s", told->sentence);
    return false;
}

static void complain(size_t *count, const char *what, long at, const char *text)
{
    if ((*count)++ < 3)
        printf("%s, call %ld: %s\n", what, at, text);
}

static int sweep(const struct places *places, const struct act *act, const char *how,
                 struct fault fault, long step)
{
    gsn_auto_mem(char) what = gsn_format("%s, %s", act->what, how);
    struct tally tally = { 0 };
    bool reached = true;

    for (fault.at = 1; what && reached; fault.at += step) {
        char text[SENTENCE] = "";
        bool alive;

        copy_tree(places->made, places->bench->store);
        alive = meets(places, act, &fault);
        reached = !alive || !told->ended || told->calls >= fault.at;
        tally.runs++;
        tally.died += alive && !told->ended;
        tally.failed += told->code < 0;
        if (!alive)
            complain(&tally.crashed, what, fault.at, "the process died");
        else if (told->code < 0 && !told->named && !names_fault(told->sentence))
            complain(&tally.mute, what, fault.at, told->sentence);
        if (told->accused[0])
            complain(&tally.accused, what, fault.at, told->accused);
        if (!is_fine_afterwards(places, act, text))
            complain(&tally.bad, what, fault.at, text);
        power_remove_tree(places->bench->store);
    }
    printf("%-44s %5zu runs: %5zu failed and said why, %5zu ended there; %zu crashes, %zu "
           "not saying why, %zu false findings, %zu with something lost\n",
           what ? what : "", tally.runs, tally.failed - tally.mute, tally.died, tally.crashed,
           tally.mute, tally.accused, tally.bad);
    (void)fflush(stdout);
    return tally.crashed || tally.mute || tally.accused || tally.bad || tally.runs == 0;
}

static int try_all(const struct places *places, const struct act *act, long step)
{
    static const struct {
        const char *how;
        struct fault fault;
    } faults[] = {
        { "EIO once", { .error = EIO } },
        { "EIO for ever", { .error = EIO, .for_ever = true } },
        { "ENOSPC for ever", { .error = ENOSPC, .only_changes = true, .for_ever = true } },
        { "killed", { .dies = true } },
    };
    int bad = 0;

    for (size_t i = 0; i < sizeof faults / sizeof faults[0]; i++)
        bad |= sweep(places, act, faults[i].how, faults[i].fault, step);
    return bad;
}

int main(int argc, char **argv)
{
    static const struct act others[] = {
        { "recovery", make_hot, open_it, hot_is_fine },
        { "a scrub", make_whole, scrub_it, scrubbed_is_fine },
        { "a backup", make_reported, back_up, backed_up_is_fine },
        { "a verify", make_reported, verify_it, verified_is_fine },
    };
    const struct power_bench bench = power_bench_new(PICTURES);
    const long step = argc > 1 ? atol(argv[1]) : 1; /* door */
    struct places places = { .bench = &bench };
    int bad = 0;

    told = mmap(NULL, sizeof *told, PROT_READ | PROT_WRITE, MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    if (told == MAP_FAILED || step < 1)
        power_give_up("memory");
    for (places.version = 1; places.version < VERSIONS; places.version++) {
        gsn_auto_mem(char) what = gsn_format("version %d brought up", places.version);
        const struct act act = { what, make_old, open_it, old_is_fine };

        (void)snprintf(places.made, sizeof places.made, "%s/old-%d", bench.dir, places.version);
        make_old(&places);
        bad |= try_all(&places, &act, step);
    }
    for (size_t i = 0; i < sizeof others / sizeof others[0]; i++) {
        (void)snprintf(places.made, sizeof places.made, "%s/made-%zu", bench.dir, i);
        others[i].make(&places);
        bad |= try_all(&places, &others[i], step);
    }
    power_bench_done(&bench);
    return bad;
}
