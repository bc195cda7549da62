/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/storage/bench.h"

#include <signal.h>
#include <sqlite3.h>
#include <stdio.h>
#include <string.h>
#include <sys/resource.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/audit_log.h"
#include "storage/sql.h"

/* SQLite calls these two and finds ours first. */
static unsigned wal_syncs;

static void count_sync(int fd)
{
    char link[64], path[4096];
    ssize_t length;

    (void)snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    length = readlink(link, path, sizeof path - 1);
    if (length < 4)
        return;
    path[length] = '\0';
    if (strcmp(path + length - 4, "-wal") == 0)
        wal_syncs++;
}

int fdatasync(int fd)
{
    count_sync(fd);
    return (int)syscall(SYS_fdatasync, fd);
}

int fsync(int fd)
{
    count_sync(fd);
    return (int)syscall(SYS_fsync, fd);
}

TEST(every_commit_syncs_the_log)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    for (int i = 0; i < 10; i++) {
        const unsigned before = wal_syncs;

        CHECK_OK(gsn_event_add(store, NOON, "a", "b", "c", "d", &err), err);
        CHECK(wal_syncs > before);
    }
}

static int64_t ask(struct gsn_store *store, const char *sql)
{
    struct gsn_error err = { 0 };
    int64_t value = -1;

    CHECK_OK(gsn_sql_int(store, sql, SQL_NO_ARGS, &value, &err), err);
    return value;
}

TEST(every_way_of_opening_promises_durability_and_whole_references)
{
    static const enum gsn_store_mode modes[] = { GSN_STORE_CREATE, GSN_STORE_WRITE,
                                                 GSN_STORE_READ };
    scratch_auto scratch = gsn_scratch_new();

    for (size_t i = 0; i < 3; i++) {
        gsn_auto(gsn_store) store = bench_open(&scratch, modes[i]);

        CHECK(ask(store, "PRAGMA synchronous") == 2);
        CHECK(ask(store, "PRAGMA foreign_keys") == 1);
        CHECK(ask(store, "SELECT journal_mode = 'wal' FROM pragma_journal_mode") == 1);
        CHECK(ask(store, "PRAGMA user_version") == 9);
        CHECK(strcmp(gsn_store_dir(store), scratch.dir) == 0);
    }
}

TEST(all_tables_are_strict)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);

    CHECK(ask(store, "SELECT count(*) FROM pragma_table_list "
                     "WHERE schema = 'main' AND type = 'table' AND name NOT LIKE 'sqlite%' "
                     "AND strict = 0") == 0);
    CHECK(ask(store, "SELECT count(*) FROM pragma_table_list "
                     "WHERE schema = 'main' AND strict = 1") == 20);
}

/* How many steps of this kind SQLite takes for a statement. */
static int count_steps(struct gsn_store *store, const char *sql, const char *kind)
{
    gsn_auto_mem(char) explain = gsn_format("EXPLAIN %s", sql);
    sqlite3_stmt *statement = NULL;
    int count = 0;

    CHECK(sqlite3_prepare_v2(gsn_store_handle(store), explain, -1, &statement, NULL) == SQLITE_OK);
    while (sqlite3_step(statement) == SQLITE_ROW)
        count += strcmp((const char *)sqlite3_column_text(statement, 1), kind) == 0;
    CHECK(sqlite3_finalize(statement) == SQLITE_OK);
    return count;
}

TEST(no_row_needs_a_table_of_its_own_to_be_checked)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    static const char *const tables[] = { "specimen", "panel", "section", "job",
                                          "run",      "event", "source",  "scan" };

    for (size_t i = 0; i < sizeof tables / sizeof *tables; i++) {
        gsn_auto_mem(char) insert = gsn_format("INSERT INTO %s DEFAULT VALUES", tables[i]);

        CHECK(count_steps(store, insert, "OpenEphemeral") == 0);
    }
    CHECK(count_steps(store, "SELECT 1 WHERE ?1 IN ('a', 'b', 'c')", "OpenEphemeral") == 1);
}

/* One row in each table that has a state. */
#define A_ROW_EACH                                                                                 \
    "INSERT INTO study VALUES (1, 'st'); INSERT INTO study_group VALUES (1, 1, 'g'); "             \
    "INSERT INTO animal VALUES (1, 1, 'rat'); INSERT INTO specimen VALUES (1, 'S', 1, 1, 1, 4, "   \
    "'sections', '', '{}', printf('%064d', 0)); INSERT INTO panel VALUES (1, 1, 3, 'P', "          \
    "printf('%064d', 3), 9, 'waiting', '', '', 0, 0, NULL, NULL, NULL, ''); "                      \
    "INSERT INTO section (id, panel_id, "                                                          \
    "slot, serial, state, flags) VALUES (4097, 1, 1, 1, 'found', ''); INSERT INTO job (kind, "     \
    "specimen_id, "                                                                                \
    "panel_id) VALUES ('panel', 1, 1); INSERT INTO run (specimen_id, key, version, inputs_json, "  \
    "parameters_json, state, started) VALUES (1, '', '', '', '', 'running', 1); "                  \
    "INSERT INTO source (name, address, state, changed) VALUES ('s', '', 'away', 1); "             \
    "INSERT INTO scan (source, device, name, key, subject, sha256, size, facts, state, reason, "   \
    "arrived) VALUES ('', '', '', '', 'panel', printf('%064d', 3), 9, '', 'filed', '', 1); "       \
    "INSERT INTO request (time, actor, kind, source) VALUES (1, '', 'capture-dark', '')"

TEST(a_column_of_words_takes_its_words_and_no_others)
{
    static const struct {
        const char *table, *column, *words[7];
    } columns[] = {
        { "specimen", "kind", { "volume", "tile", "sections" } },
        { "panel", "state", { "registered", "refused", "held", "waiting" } },
        { "section", "state", { "empty", "needs-eye", "missing", "held", "found" } },
        { "job", "state", { "running", "done", "failed", "waiting" } },
        { "source", "state", { "ready", "receiving", "paused", "failed", "off", "away" } },
        { "scan", "subject", { "blank", "dark", "panel" } },
        { "scan", "state", { "unfiled", "kept", "filed" } },
        { "request", "kind", { "capture-panel", "capture-blank", "capture-dark" } },
        { "request", "state", { "done", "refused", "waiting" } },
        { "run", "state", { "running", "reported" } }, /* which it keeps */
    };
    scratch_auto scratch = gsn_scratch_new();

    gsn_store_free(bench_open(&scratch, GSN_STORE_CREATE));
    CHECK(bench_raw(&scratch, A_ROW_EACH) == SQLITE_OK);
    for (size_t i = 0; i < sizeof columns / sizeof *columns; i++) {
        gsn_auto_mem(char) none =
            gsn_format("UPDATE %s SET %s = 'none of them'", columns[i].table, columns[i].column);

        CHECK(bench_raw(&scratch, none) == SQLITE_CONSTRAINT);
        for (const char *const *word = columns[i].words; *word; word++) {
            gsn_auto_mem(char) good =
                gsn_format("UPDATE %s SET %s = '%s'", columns[i].table, columns[i].column, *word);

            CHECK(bench_raw(&scratch, good) == SQLITE_OK);
        }
    }
}

TEST(the_log_stays_in_place_for_readers)
{
    scratch_auto scratch = gsn_scratch_new();

    gsn_store_free(bench_open(&scratch, GSN_STORE_CREATE));
    CHECK(access(gsn_scratch_path(&scratch, "gieson.db-wal"), F_OK) == 0);
    CHECK(access(gsn_scratch_path(&scratch, "gieson.db-shm"), F_OK) == 0);
    CHECK(access(gsn_scratch_path(&scratch, "objects"), F_OK) == 0);
    CHECK(access(gsn_scratch_path(&scratch, "reports"), F_OK) == 0);
}

static void refuses(const char *dir, enum gsn_store_mode mode, int code, const char *sentence)
{
    struct gsn_store *store = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_store_open(dir, mode, &store, &err);

    if (r != code || !strstr(err.text, sentence))
        fail_msg("opening gave %d (%s), not %d (... %s ...)", r, err.text, code, sentence);
    CHECK(store == NULL);
}

TEST(a_directory_without_a_store_is_named)
{
    scratch_auto scratch = gsn_scratch_new();
    const char *const words = "is not a gieson store; `gieson import` makes one";

    refuses("/nowhere/at/all", GSN_STORE_READ, GSN_E_NOTFOUND, words);
    refuses(scratch.dir, GSN_STORE_READ, GSN_E_NOTFOUND, words);
    refuses(scratch.dir, GSN_STORE_WRITE, GSN_E_NOTFOUND, words);
    CHECK(access(gsn_scratch_path(&scratch, "gieson.db"), F_OK) < 0);
}

TEST(a_creation_cut_short_is_no_store_and_is_taken_up_again)
{
    scratch_auto scratch = gsn_scratch_new();

    gsn_scratch_append(gsn_scratch_path(&scratch, "gieson.db"), "", 0);
    refuses(scratch.dir, GSN_STORE_WRITE, GSN_E_NOTFOUND, "is not a gieson store");
    gsn_store_free(bench_open(&scratch, GSN_STORE_CREATE));
    gsn_store_free(bench_open(&scratch, GSN_STORE_READ));
}

TEST(a_store_of_a_newer_version_is_refused_untouched)
{
    scratch_auto scratch = gsn_scratch_new();

    gsn_store_free(bench_open(&scratch, GSN_STORE_CREATE));
    CHECK(bench_raw(&scratch, "PRAGMA user_version = 10") == SQLITE_OK);
    refuses(scratch.dir, GSN_STORE_READ, GSN_E_UNSUPPORTED, "newer gieson (schema 10, this one");
    refuses(scratch.dir, GSN_STORE_WRITE, GSN_E_UNSUPPORTED, "newer gieson");
    refuses(scratch.dir, GSN_STORE_CREATE, GSN_E_UNSUPPORTED, "newer gieson");
    CHECK(bench_raw(&scratch, "PRAGMA user_version = 9") == SQLITE_OK);
    gsn_store_free(bench_open(&scratch, GSN_STORE_WRITE));
}

TEST(the_database_of_another_program_is_refused)
{
    scratch_auto scratch = gsn_scratch_new();

    CHECK(bench_raw(&scratch, "CREATE TABLE bookmark (url)") == SQLITE_OK);
    refuses(scratch.dir, GSN_STORE_CREATE, GSN_E_STORE, "another program's");
    refuses(scratch.dir, GSN_STORE_READ, GSN_E_STORE, "another program's");
}

TEST(a_damaged_database_is_refused)
{
    scratch_auto scratch = gsn_scratch_new();
    char noise[8192];

    memset(noise, 'x', sizeof noise);
    gsn_scratch_append(gsn_scratch_path(&scratch, "gieson.db"), noise, sizeof noise);
    refuses(scratch.dir, GSN_STORE_READ, GSN_E_STORE, "not a database");
    refuses(scratch.dir, GSN_STORE_CREATE, GSN_E_STORE, "not a database");
}

static int in_child(int as_nobody, int (*body)(void *context), void *context)
{
    struct gsn_scratch_child child = gsn_scratch_start(as_nobody, body, context);

    return gsn_scratch_wait(&child);
}

static int opening_fails_with_io(void *context)
{
    struct gsn_store *store = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_store_open(context, GSN_STORE_CREATE, &store, &err);

    return r == GSN_E_IO && store == NULL && strlen(err.text) > strlen(context) ? 0 : 1;
}

TEST(a_directory_without_permission_gives_a_sentence)
{
    scratch_auto scratch = gsn_scratch_new();
    char full[200];

    (void)snprintf(full, sizeof full, "%s/full", scratch.dir);
    CHECK(mkdir(full, 0755) == 0);
    {
        struct gsn_scratch inner;

        (void)snprintf(inner.dir, sizeof inner.dir, "%.120s", full);
        gsn_store_free(bench_open(&inner, GSN_STORE_CREATE));
        CHECK(chmod(gsn_scratch_path(&inner, "gieson.db"), 0444) == 0);
    }
    CHECK(chmod(full, 0555) == 0 && chmod(scratch.dir, 0555) == 0);
    CHECK(in_child(1, opening_fails_with_io, full) == 0);
    (void)snprintf(full, sizeof full, "%s/new", scratch.dir);
    CHECK(in_child(1, opening_fails_with_io, full) == 0);
    CHECK(chmod(scratch.dir, 0755) == 0);
    (void)snprintf(full, sizeof full, "%s/full", scratch.dir);
    CHECK(chmod(full, 0755) == 0);
}

/* Runs where the log cannot grow. */
static int a_full_disk_rolls_back(void *context)
{
    const struct rlimit small = { 1 << 20, 1 << 20 };
    struct gsn_error err = { 0 };
    struct gsn_store *const store = context;
    char *const text = gsn_alloc_array(1, 2 << 20);

    memset(text, 't', (2 << 20) - 1);
    (void)signal(SIGXFSZ, SIG_IGN);
    if (setrlimit(RLIMIT_FSIZE, &small) < 0)
        return 2;
    if (gsn_event_add(store, NOON, "a", "b", "c", text, &err) != GSN_E_IO || !*err.text)
        return 3;
    if (gsn_event_add(store, NOON, "a", "b", "c", "small", &err) != GSN_OK)
        return 4;
    return ask(store, "SELECT count(*) FROM event") == 1 ? 0 : 5;
}

static int a_full_disk_in_a_new_process(void *context)
{
    struct gsn_store *store = NULL;

    if (gsn_store_open(context, GSN_STORE_WRITE, &store, NULL) < 0)
        return 1;
    return a_full_disk_rolls_back(store);
}

TEST(a_full_disk_loses_nothing_and_says_so)
{
    scratch_auto scratch = gsn_scratch_new();

    gsn_store_free(bench_open(&scratch, GSN_STORE_CREATE));
    CHECK(in_child(0, a_full_disk_in_a_new_process, scratch.dir) == 0);
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_READ);
    CHECK(ask(store, "SELECT count(*) FROM event") == 1);
    CHECK(ask(store, "SELECT integrity_check = 'ok' FROM pragma_integrity_check") == 1);
}

static int count_specimens_elsewhere(void *context)
{
    gsn_auto(gsn_specimen_rows) rows = NULL;
    gsn_auto(gsn_store) store = NULL;

    if (gsn_store_open(context, GSN_STORE_READ, &store, NULL) < 0 ||
        gsn_specimen_list(store, &rows, NULL) < 0)
        return 100;
    return (int)rows->count;
}

TEST(another_process_reads_what_is_committed_while_one_writes)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_scratch_child early = gsn_scratch_start(0, count_specimens_elsewhere, scratch.dir);
    struct gsn_scratch_child late = gsn_scratch_start(0, count_specimens_elsewhere, scratch.dir);
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    (void)bench_add_specimen(store, "one", "g", "");
    CHECK_OK(gsn_store_begin(store, &err), err);
    (void)bench_add_specimen(store, "two", "g", "");
    CHECK(gsn_scratch_wait(&early) == 1);
    CHECK_OK(gsn_store_commit(store, &err), err);
    CHECK(gsn_scratch_wait(&late) == 2);
}

static int write_elsewhere(void *context)
{
    gsn_auto(gsn_store) store = NULL;

    if (gsn_store_open(context, GSN_STORE_WRITE, &store, NULL) < 0)
        return 1;
    return gsn_event_add(store, NOON, "a", "b", "c", "d", NULL) < 0 ? 2 : 0;
}

TEST(a_second_writer_waits_for_the_first)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_scratch_child second = gsn_scratch_start(0, write_elsewhere, scratch.dir);
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    int status = -1;

    CHECK_OK(gsn_store_begin(store, &err), err);
    gsn_scratch_open_gate(&second);
    CHECK(usleep(200000) == 0);
    CHECK(waitpid(second.pid, &status, WNOHANG) == 0);
    CHECK_OK(gsn_store_commit(store, &err), err);
    CHECK(gsn_scratch_wait(&second) == 0);
}

static int create_here(void *context)
{
    gsn_auto(gsn_store) store = NULL;
    struct gsn_error err = { 0 };

    if (gsn_store_open(context, GSN_STORE_CREATE, &store, &err) < 0) {
        print_error("%s\n", err.text);
        return 1;
    }
    return 0;
}

TEST(several_processes_may_create_the_store_at_once)
{
    enum { CHILDREN = 6, ROUNDS = 12 };
    struct gsn_scratch_child child[CHILDREN];
    scratch_auto scratch = gsn_scratch_new();
    char dir[200];

    for (int round = 0; round < ROUNDS; round++) {
        (void)snprintf(dir, sizeof dir, "%s/store%d", scratch.dir, round);
        for (int i = 0; i < CHILDREN; i++)
            child[i] = gsn_scratch_start(0, create_here, dir);
        for (int i = 0; i < CHILDREN; i++)
            gsn_scratch_open_gate(&child[i]);
        for (int i = 0; i < CHILDREN; i++)
            CHECK(gsn_scratch_wait(&child[i]) == 0);
    }
}

TEST(an_inner_rollback_undoes_the_inner_part_alone)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_store_begin(store, &err), err);
    (void)bench_add_specimen(store, "kept", "g", "");
    CHECK_OK(gsn_store_begin(store, &err), err);
    (void)bench_add_specimen(store, "undone", "g", "");
    gsn_store_rollback(store);
    (void)bench_add_specimen(store, "kept too", "g", "");
    CHECK_OK(gsn_store_commit(store, &err), err);
    CHECK(ask(store, "SELECT count(*) FROM specimen") == 2);
    CHECK(ask(store, "SELECT count(*) FROM specimen WHERE name = 'undone'") == 0);
}

TEST(closing_a_store_rolls_back)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_store *writer = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };

    CHECK_OK(gsn_store_begin(writer, &err), err);
    (void)bench_add_specimen(writer, "lost", "g", "");
    gsn_store_free(writer);
    CHECK(count_specimens_elsewhere(scratch.dir) == 0);
}

static int open_once(const char *dir, struct gsn_error *err)
{
    gsn_auto(gsn_store) store = NULL;

    return gsn_store_open(dir, GSN_STORE_CREATE, &store, err);
}

TEST(running_out_of_memory_leaks_nothing)
{
    scratch_auto scratch = gsn_scratch_new();
    struct gsn_error err = { 0 };

    CHECK_EVERY_OOM(open_once(scratch.dir, &err), err);
}

TEST(an_object_lies_under_the_first_two_digits_of_its_digest)
{
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    gsn_auto_mem(char) path = NULL;
    struct gsn_error err = { 0 };
    const char *hex = "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a";

    CHECK_OK(gsn_store_object_path(store, hex, &path, &err), err);
    CHECK(strcmp(path, gsn_scratch_path(&scratch, "objects/44/136fa355b3678a1146ad16f7e8649e94"
                                                  "fb4fc21fe77e8310c060f61caaff8a")) == 0);
}

TEST(what_is_no_digest_names_no_object)
{
    static const char *const wrong[] = {
        "",
        "44",
        "../../etc/passwd",
        "44136FA355B3678A1146AD16F7E8649E94FB4FC21FE77E8310C060F61CAAFF8A",
        "44136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8a0",
        "../136fa355b3678a1146ad16f7e8649e94fb4fc21fe77e8310c060f61caaff8"
    };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    char *path = NULL;

    for (size_t i = 0; i < sizeof wrong / sizeof wrong[0]; i++) {
        CHECK(gsn_store_object_path(store, wrong[i], &path, &err) == GSN_E_INPUT);
        CHECK(path == NULL);
    }
}

TEST(no_name_of_a_specimen_leaves_the_reports_or_meets_another)
{
    enum { LONG = 400, NAMES = 16 };
    static char long_a[LONG + 1], long_b[LONG + 1], long_c[LONG + 1];
    const char *const names[NAMES] = { "S00",     "s00",           ".",      "..",
                                       "...",     "a/b",           "a%2Fb",  "/",
                                       "../../x", "M\xc3\xbcller", "\xff\n", "a b",
                                       "-rf",     long_a,          long_b,   long_c };
    scratch_auto scratch = gsn_scratch_new();
    gsn_auto(gsn_store) store = bench_open(&scratch, GSN_STORE_CREATE);
    struct gsn_error err = { 0 };
    char *path[NAMES] = { 0 };
    const size_t before = strlen(scratch.dir) + strlen("/reports/");

    memset(long_a, 'a', LONG);
    memset(long_b, 'a', LONG);
    long_b[LONG - 1] = 'b';
    memset(long_c, '/', LONG);
    for (size_t i = 0; i < NAMES; i++) {
        CHECK_OK(gsn_store_report_dir(store, names[i], &path[i], &err), err);
        CHECK(strncmp(path[i], gsn_scratch_path(&scratch, "reports/"), before) == 0);
        CHECK(strchr(path[i] + before, '/') == NULL);
        CHECK(path[i][before] != '.' && path[i][before] != '\0');
        CHECK(strlen(path[i] + before) <= 255);
        for (size_t j = 0; j < i; j++)
            CHECK(strcmp(path[i], path[j]) != 0);
    }
    CHECK(strcmp(path[0] + before, "S00") == 0);
    CHECK(strcmp(path[9] + before, "M%C3%BCller") == 0);
    for (size_t i = 0; i < NAMES; i++)
        gsn_free(path[i]);
}
