/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* An audit of the store by itself.
 *
 * 1. Pages: each has a checksum (pagesum.c), so a flipped bit is found wherever it lies.
 * 2. Tables: `PRAGMA integrity_check` and `foreign_key_check`.
 * 3. Log: the hash chain is computed anew (event.c), which finds what was changed, put in, left out
 *    or put elsewhere. A chain that was cut, or made anew from some event on, is whole in itself;
 * so its end is remembered outside (Schneier and Kelsey, "Secure audit logs to support computer
 *    forensics", ACM TISSEC 2, 1999): an event of that number must have that hash. Whoever can
 * write all of the store can write DIR/audit.head and the file beside each report too; the journal
 * is the system's.
 * 4. Runs: SHA-256 over the rows of run, measure, pose and stain_batch in the order of their ids,
 *    each column as its type ('i', 'f', 't', 'n') and its value: eight bytes, least first, or the
 *    length in eight bytes and the text. It must be the one that was sealed, and sealed once.
 * 5. Ledger: a scan, an imported panel and an answer is a row and an event; each without the other
 *    is a finding. What only says how work stands (jobs, sources, troubles, requests, expectations)
 *    is no evidence and is not sealed.
 *
 * Costs one pass over the database and one over the log. */
#include "storage/audit.h"

#include <errno.h>
#include <inttypes.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/audit_log.h"
#include "storage/pagesum.h"
#include "storage/sql.h"
#include "storage/transaction.h"

enum {
    HEAD_LINE = 19 + 1 + 64 + 1
}; /* of DIR/audit.head: always as long, so that it is replaced */

static void report_finding(gsn_audit_found *found, void *context, const char *what,
                           const char *sentence)
{
    if (found)
        found(context, what, sentence);
}

/* ---- pages and tables --------------------------------------------------------------------- */

struct page_teller {
    gsn_audit_found *found;
    void *context;
};

static void report_page(void *context, int64_t page)
{
    const struct page_teller *const teller = context;
    char what[64];

    (void)snprintf(what, sizeof what, "gieson.db, page %" PRId64, page);
    report_finding(
        teller->found, teller->context, what,
        "its bytes are not those that gieson wrote: the disk changed them, or another program did");
}

int gsn_audit_pages(const char *dir, gsn_audit_found *found, void *context, int64_t *ret_without,
                    struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/gieson.db", dir);
    struct page_teller teller = { found, context };
    struct gsn_pagesum_verdict verdict;
    const int r = path ? gsn_pagesum_check(path, report_page, &teller, &verdict, err)
                       : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0 && ret_without)
        *ret_without = verdict.without;
    return r;
}

struct finding {
    const char *what, *sentence;
};
static const struct gsn_sql_field finding_fields[] = {
    { GSN_SQL_TEXT, offsetof(struct finding, what) },
    { GSN_SQL_TEXT, offsetof(struct finding, sentence) },
};
static const struct gsn_sql_shape finding_shape = SQL_SHAPE(struct finding, finding_fields);

/* A question whose answers are findings: what, and the sentence. */
static int ask_findings(struct gsn_store *store, const char *sql, gsn_audit_found *found,
                        void *context, struct gsn_error *err)
{
    void *rows = NULL;
    size_t count = 0;
    const int r = gsn_sql_rows(store, &finding_shape, sql, SQL_NO_ARGS, &rows, &count, err);
    const struct finding *const at = rows;

    for (size_t i = 0; r >= 0 && i < count; i++)
        report_finding(found, context, at[i].what, at[i].sentence);
    if (r >= 0)
        gsn_sql_free_rows(&finding_shape, rows, count);
    return r;
}

/* integrity_check takes a page that the disk does not give for a damaged one. */
struct table_teller {
    gsn_audit_found *found;
    void *context;
    int unread;
};

static void report_table(void *context, const char *what, const char *sentence)
{
    struct table_teller *const teller = context;
    const char *const code = strstr(sentence, "unable to get the page. error code=");

    if (code && (atoi(strchr(code, '=') + 1) & 0xff) == SQLITE_IOERR) /* door */
        teller->unread = 1;
    else
        report_finding(teller->found, teller->context, what, sentence);
}

int gsn_audit_tables(struct gsn_store *store, gsn_audit_found *found, void *context,
                     struct gsn_error *err)
{
    struct table_teller teller = { .found = found, .context = context };
    const int r = ask_findings(store,
                               "SELECT 'gieson.db', 'SQLite says: ' || integrity_check "
                               "FROM pragma_integrity_check WHERE integrity_check <> 'ok'",
                               report_table, &teller, err);

    if (r >= 0 && teller.unread)
        return gsn_fail(err, GSN_E_IO,
                        "%s/gieson.db: disk I/O error: a page could not be read, so that nobody "
                        "knows whether it is damaged; see what the kernel says of the disk (dmesg)",
                        gsn_store_dir(store));
    return r < 0
               ? r
               : ask_findings(
                     store,
                     "SELECT 'table ' || \"table\", 'row ' || coalesce(rowid, '') || ' rests on a "
                     "row of ' || parent || ' that is not there' FROM pragma_foreign_key_check",
                     found, context, err);
}

/* ---- where the log ended ------------------------------------------------------------------ */

int gsn_audit_write_head(const char *path, const struct gsn_event_tail *tail, struct gsn_error *err)
{
    char line[HEAD_LINE + 1];
    gsn_auto_fd fd = -1;
    int r = gsn_file_open_lock(path, &fd, err);

    (void)snprintf(line, sizeof line, "%019" PRId64 " %s\n", tail->id, tail->head.hex);
    if (r >= 0 && pwrite(fd, line, HEAD_LINE, 0) != HEAD_LINE) {
        r = gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
        /* Half a line would speak of an end that never was. */
        (void)!ftruncate(fd, 0);
    }
    return r;
}

int gsn_audit_renew_head(struct gsn_store *store, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/" GSN_AUDIT_HEAD, gsn_store_dir(store));
    struct gsn_event_tail tail;
    const int r =
        path ? gsn_event_tail(store, &tail, err) : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    return r < 0 ? r : gsn_audit_write_head(path, &tail, err);
}

/* GSN_E_NOTFOUND: there is none, or none of ours. What the disk does not give is GSN_E_IO. */
static int read_head_line(const char *path, struct gsn_event_tail *ret_tail, struct gsn_error *err)
{
    char line[HEAD_LINE + 2] = "";
    gsn_auto_fd fd = -1;
    struct gsn_event_tail tail;
    const int r = gsn_file_open(path, &fd, err);
    ssize_t got;

    if (r < 0)
        return r;
    got = pread(fd, line, HEAD_LINE + 1, 0);
    if (got < 0)
        return gsn_fail(err, GSN_E_IO, "%s: %s", path, strerror(errno));
    if (got != HEAD_LINE || sscanf(line, "%" SCNd64 " %64[0-9a-f]", &tail.id, tail.head.hex) != 2 ||
        tail.id <= 0 || strlen(tail.head.hex) != sizeof tail.head.hex - 1)
        return GSN_E_NOTFOUND;
    *ret_tail = tail;
    return GSN_OK;
}

int gsn_audit_may_write_head(struct gsn_store *store, const char *path, int *ret_may,
                             struct gsn_error *err)
{
    struct gsn_event_tail tail;
    int64_t is = 0;
    int r = read_head_line(path, &tail, err);

    if (r >= 0)
        r = gsn_sql_int(store, "SELECT hash = ?2 FROM event WHERE id = ?1",
                        SQL_ARGS(SQL_INT(tail.id), SQL_TEXT(tail.head.hex)), &is, err);
    else if (r == GSN_E_NOTFOUND)
        is = 1;
    *ret_may = is == 1;
    return r == GSN_E_NOTFOUND ? GSN_OK : r;
}

int gsn_audit_tail(struct gsn_store *store, struct gsn_audit_head *ret_head, struct gsn_error *err)
{
    struct gsn_event_tail tail;
    const int r = gsn_event_tail(store, &tail, err);

    if (r >= 0)
        *ret_head = (struct gsn_audit_head){ .events = tail.id, .head = tail.head };
    return r;
}

/* Whether the event that was the last then is the same now. */
static int check_head(struct gsn_store *store, const struct gsn_audit_head *head,
                      gsn_audit_found *found, void *context, struct gsn_error *err)
{
    char sentence[512];
    int64_t is = 0;
    int r;

    if (head->events == 0)
        return GSN_OK;
    r = gsn_sql_int(store, "SELECT hash = ?2 FROM event WHERE id = ?1",
                    SQL_ARGS(SQL_INT(head->events), SQL_TEXT(head->head.hex)), &is, err);
    if (r == GSN_E_NOTFOUND)
        (void)snprintf(sentence, sizeof sentence,
                       "its newest events are gone: by %s there were %" PRId64, head->where,
                       head->events);
    else if (r >= 0 && !is)
        (void)snprintf(sentence, sizeof sentence,
                       "it was written anew: by %s its event %" PRId64 " was another one",
                       head->where, head->events);
    else
        return r;
    report_finding(found, context, "audit log", sentence);
    return GSN_OK;
}

/* Asked before the log is read, for that may grow meanwhile and never shrinks. */
static int read_head_file(struct gsn_store *store, struct gsn_audit_head *head,
                          gsn_audit_found *found, void *context, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/" GSN_AUDIT_HEAD, gsn_store_dir(store));
    struct gsn_event_tail tail;
    int64_t events = 0;
    int r;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = read_head_line(path, &tail, err);
    if (r >= 0) {
        head->events = tail.id;
        head->head = tail.head;
        return GSN_OK;
    }
    if (r != GSN_E_NOTFOUND)
        return r;
    r = gsn_sql_int(store, "SELECT count(*) FROM event", SQL_NO_ARGS, &events, err);
    if (r >= 0 && events > 0)
        report_finding(
            found, context, GSN_AUDIT_HEAD,
            "the file that says where the audit log ends is missing or damaged; the next event "
            "writes it anew");
    return r;
}

int gsn_audit_log(struct gsn_store *store, const struct gsn_audit_head *heads, size_t count,
                  gsn_audit_found *found, void *context, int64_t *ret_events, struct gsn_error *err)
{
    struct gsn_audit_head file = { .where = GSN_AUDIT_HEAD };
    struct gsn_event_verdict verdict = { 0 };
    char sentence[160];
    int r = read_head_file(store, &file, found, context, err);

    if (r >= 0)
        r = gsn_event_verify(store, NULL, &verdict, err);
    if (r >= 0 && verdict.broken) {
        (void)snprintf(sentence, sizeof sentence,
                       "event %" PRId64 " does not follow from the one before: it, or what stood "
                       "before it, was changed",
                       verdict.broken);
        report_finding(found, context, "audit log", sentence);
    }
    if (r >= 0)
        r = check_head(store, &file, found, context, err);
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = check_head(store, &heads[i], found, context, err);
    if (r >= 0)
        r = ask_findings(
            store,
            "SELECT 'audit log', 'it does not hold the event it ended with when run ' || r.id || "
            "' began to be written' FROM run r LEFT JOIN event e ON e.hash = r.event_head "
            "WHERE length(r.event_head) = 64 AND ltrim(r.event_head, '0') <> '' "
            "AND e.id IS NULL",
            found, context, err);
    if (r >= 0 && ret_events)
        *ret_events = verdict.count;
    return r;
}

/* ---- the rows of a run -------------------------------------------------------------------- */

static int hash_number(struct gsn_hash *hash, char type, uint64_t number, struct gsn_error *err)
{
    uint8_t bytes[9] = { (uint8_t)type };

    for (int i = 0; i < 8; i++)
        bytes[1 + i] = (uint8_t)(number >> 8 * i);
    return gsn_hash_add(hash, bytes, sizeof bytes, err);
}

static int hash_column(struct gsn_hash *hash, sqlite3_stmt *row, int column, struct gsn_error *err)
{
    const double real = sqlite3_column_double(row, column);
    uint64_t bits;
    int r;

    switch (sqlite3_column_type(row, column)) {
    case SQLITE_INTEGER:
        return hash_number(hash, 'i', (uint64_t)sqlite3_column_int64(row, column), err);
    case SQLITE_FLOAT:
        memcpy(&bits, &real, sizeof bits);
        return hash_number(hash, 'f', bits, err);
    case SQLITE_NULL:
        return gsn_hash_add(hash, "n", 1, err);
    default:
        bits = (uint64_t)sqlite3_column_bytes(row, column);
        r = hash_number(hash, 't', bits, err);
        return r < 0 ? r : gsn_hash_add(hash, sqlite3_column_text(row, column), (size_t)bits, err);
    }
}

static int hash_rows(struct gsn_store *store, const char *sql, int64_t run, struct gsn_hash *hash,
                     struct gsn_error *err)
{
    gsn_auto_statement statement = NULL;
    int step, r = GSN_OK;

    if (sqlite3_prepare_v2(gsn_store_handle(store), sql, -1, &statement, NULL) != SQLITE_OK ||
        sqlite3_bind_int64(statement, 1, run) != SQLITE_OK)
        return gsn_store_failed(store, err);
    while ((step = sqlite3_step(statement)) == SQLITE_ROW)
        for (int i = 0; r >= 0 && i < sqlite3_column_count(statement); i++)
            r = hash_column(hash, statement, i, err);
    return r >= 0 && step != SQLITE_DONE ? gsn_store_failed(store, err) : r;
}

static int digest_run(struct gsn_store *store, int64_t run, struct gsn_digest *ret_digest,
                      struct gsn_error *err)
{
    static const char *const rows[] = {
        "SELECT * FROM run WHERE id = ?1",
        "SELECT * FROM measure WHERE run_id = ?1 ORDER BY id",
        "SELECT * FROM pose WHERE run_id = ?1 ORDER BY id",
        "SELECT * FROM stain_batch WHERE run_id = ?1 ORDER BY id",
    };
    gsn_auto(gsn_hash) hash = NULL;
    int r = gsn_hash_new(&hash, err);

    for (size_t i = 0; r >= 0 && i < sizeof rows / sizeof *rows; i++)
        r = hash_rows(store, rows[i], run, hash, err);
    return r < 0 ? r : gsn_hash_end(hash, ret_digest, err);
}

/* Who seals the runs of an older gieson. */
#define LATE "gieson-upgrade"

static int seal_run(struct gsn_store *store, int64_t run, int64_t now, const char *actor,
                    struct gsn_error *err)
{
    struct gsn_digest digest;
    char subject[32];
    const int r = digest_run(store, run, &digest, err);

    (void)snprintf(subject, sizeof subject, "run %" PRId64, run);
    return r < 0 ? r : gsn_event_append(store, now, actor, "seal", subject, digest.hex, err);
}

int gsn_audit_seal(struct gsn_store *store, int64_t run, int64_t now, struct gsn_error *err)
{
    return seal_run(store, run, now, "gieson-work", err);
}

struct sealed {
    int64_t run, seals;
    const char *state, *text;
};
static const struct gsn_sql_field sealed_fields[] = {
    { GSN_SQL_INT, offsetof(struct sealed, run) },
    { GSN_SQL_INT, offsetof(struct sealed, seals) },
    { GSN_SQL_TEXT, offsetof(struct sealed, state) },
    { GSN_SQL_TEXT, offsetof(struct sealed, text) },
};
static const struct gsn_sql_shape sealed_shape = SQL_SHAPE(struct sealed, sealed_fields);

int gsn_audit_seal_old_runs(struct gsn_store *store, struct gsn_error *err)
{
    const struct sealed *at;
    void *rows = NULL;
    size_t count = 0;
    int64_t now = 0;
    int r = gsn_sql_int(store, "SELECT unixepoch()", SQL_NO_ARGS, &now, err);

    if (r >= 0)
        r = gsn_sql_rows(store, &sealed_shape,
                         "SELECT id, 0, state, '' FROM run WHERE state <> 'running' ORDER BY id",
                         SQL_NO_ARGS, &rows, &count, err);
    at = rows;
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = seal_run(store, at[i].run, now, LATE, err);
    gsn_sql_free_rows(&sealed_shape, rows, count);
    return r;
}

int gsn_audit_sealed(struct gsn_store *store, int64_t run, struct gsn_digest *ret_digest,
                     int *ret_late, struct gsn_error *err)
{
    const struct sealed *row;
    void *rows = NULL;
    const int r =
        gsn_sql_row(store, &sealed_shape,
                    "SELECT ?1, actor = '" LATE "', '', text FROM event WHERE kind = 'seal' AND "
                    "subject = 'run ' || ?1 ORDER BY id LIMIT 1",
                    SQL_ARGS(SQL_INT(run)), &rows, err);

    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, r, "the audit log has no seal of run %" PRId64, run);
    if (r < 0)
        return r;
    row = rows;
    (void)snprintf(ret_digest->hex, sizeof ret_digest->hex, "%s", row->text);
    *ret_late = row->seals != 0;
    gsn_sql_free_rows(&sealed_shape, rows, 1);
    return GSN_OK;
}

static int check_seal(struct gsn_store *store, const struct sealed *row, gsn_audit_found *found,
                      void *context, struct gsn_error *err)
{
    struct gsn_digest digest;
    char what[32];
    int r = GSN_OK;

    (void)snprintf(what, sizeof what, "run %" PRId64, row->run);
    if (!row->state[0])
        report_finding(found, context, what, "the audit log has its seal, and the run is gone");
    else if (row->seals == 0)
        report_finding(found, context, what, "it has ended and the audit log has no seal of it");
    else if (row->seals > 1)
        report_finding(found, context, what, "it was sealed more than once");
    else
        r = digest_run(store, row->run, &digest, err);
    if (r >= 0 && row->seals == 1 && row->state[0] && strcmp(digest.hex, row->text) != 0)
        report_finding(
            found, context, what,
            "its figures, poses, colours or what it says of itself are not those it ended with");
    return r;
}

int gsn_audit_runs(struct gsn_store *store, int64_t run, gsn_audit_found *found, void *context,
                   struct gsn_error *err)
{
    const struct sealed *at;
    void *rows = NULL;
    size_t count = 0;
    int r = gsn_sql_rows(
        store, &sealed_shape,
        "WITH seal AS (SELECT CAST(substr(subject, 5) AS INTEGER) AS run, count(*) AS seals, "
        "min(text) AS text FROM event WHERE kind = 'seal' AND subject GLOB 'run [0-9]*' "
        "GROUP BY 1) "
        "SELECT r.id, coalesce(s.seals, 0), r.state, coalesce(s.text, '') FROM run r "
        "LEFT JOIN seal s ON s.run = r.id WHERE r.state <> 'running' AND ?1 IN (0, r.id) "
        "UNION ALL SELECT s.run, s.seals, '', s.text FROM seal s LEFT JOIN run r ON r.id = s.run "
        "WHERE r.id IS NULL AND ?1 IN (0, s.run) ORDER BY 1",
        SQL_ARGS(SQL_INT(run)), &rows, &count, err);

    at = rows;
    for (size_t i = 0; r >= 0 && i < count; i++)
        r = check_seal(store, &at[i], found, context, err);
    gsn_sql_free_rows(&sealed_shape, rows, count);
    return r;
}

/* ---- rows and log ------------------------------------------------------------------------- */

/* What was answered last about each place, as the log has it: "panel 3, slot 2: cut, instead of
 * hold; why". */
#define ANSWERS                                                                                    \
    "WITH told AS (SELECT max(id) AS id, subject, substr(text, 1, instr(text, ': ') - 1) AS "      \
    "place, "                                                                                      \
    "substr(text, instr(text, ': ') + 2) AS answer FROM event WHERE kind = 'decide' "              \
    "GROUP BY subject, place), "                                                                   \
    "held AS (SELECT s.name AS subject, 'panel ' || d.number || "                                  \
    "iif(d.slot = 0, '', ', slot ' || d.slot) AS place, d.* FROM decision d "                      \
    "JOIN specimen s ON s.id = d.specimen_id) "

/* What came through a folder or took the place of its torn beginning: "A was a torn beginning of B,
 * which ...". */
#define IMPORTED                                                                                   \
    "(SELECT text AS sha256, subject, id FROM event WHERE kind = 'panel' UNION ALL "               \
    "SELECT substr(text, 89, 64), subject, id FROM event WHERE kind = 'torn') "

static const char *const ledger[] = {
    "SELECT 'scan ' || s.id, s.name || ' from ' || s.source || ' is in the ledger as the audit log "
    "does not have it' FROM scan s LEFT JOIN (SELECT subject, substr(text, 1, 64) AS sha256, "
    "substr(text, 65) AS rest FROM event WHERE kind = 'scan') e ON e.subject = s.name AND "
    "e.sha256 = s.sha256 AND instr(e.rest, ', from ' || s.source || ', ') = 1 "
    "LEFT JOIN " IMPORTED "i ON i.sha256 = s.sha256 AND s.source = 'import' "
    "WHERE e.subject IS NULL AND i.sha256 IS NULL",

    "SELECT 'audit log', 'event ' || e.id || ' says that ' || e.subject || ' came in, and the "
    "ledger "
    "does not have it' FROM (SELECT id, subject, substr(text, 1, 64) AS sha256 FROM event "
    "WHERE kind = 'scan') e LEFT JOIN scan s ON s.name = e.subject AND s.sha256 = e.sha256 "
    "WHERE s.id IS NULL",

    "SELECT 'panel ' || p.file_name, 'it is among the panels of ' || m.name || ', and the audit "
    "log "
    "does not say how it came' FROM panel p JOIN specimen m ON m.id = p.specimen_id "
    "LEFT JOIN " IMPORTED "i ON i.sha256 = p.sha256 LEFT JOIN scan s ON s.sha256 = p.sha256 "
    "WHERE i.sha256 IS NULL AND s.id IS NULL",

    "SELECT 'audit log', 'event ' || i.id || ' says that panel ' || i.subject || ' came in, and it "
    "is "
    "not there' FROM " IMPORTED "i LEFT JOIN panel p ON p.sha256 = i.sha256 "
    "LEFT JOIN scan s ON s.sha256 = i.sha256 WHERE p.id IS NULL AND s.id IS NULL",

    ANSWERS "SELECT h.subject || ', ' || h.place, 'the answer \"' || substr(h.answer, 1, 80) || "
            "'\" is not what the audit log says was answered last, by whom, when and why' "
            "FROM held h LEFT JOIN told t ON t.subject = h.subject AND t.place = h.place "
            "LEFT JOIN event e ON e.id = t.id WHERE t.id IS NULL OR NOT (e.time = h.time AND "
            "e.actor = h.actor AND substr(t.answer, 1, length(h.answer)) = h.answer AND "
            "substr(t.answer || ';', length(h.answer) + 1, 1) IN (';', ',') AND (h.reason = '' OR "
            "substr(t.answer, -length(h.reason)) = h.reason))",

    ANSWERS
    "SELECT t.subject || ', ' || t.place, 'by the audit log it was answered (event ' || t.id "
    "|| '), and the answer is gone' FROM told t LEFT JOIN held h ON h.subject = t.subject "
    "AND h.place = t.place WHERE h.place IS NULL AND t.answer NOT GLOB 'taken back*'",
};

int gsn_audit_ledger(struct gsn_store *store, gsn_audit_found *found, void *context,
                     struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < sizeof ledger / sizeof *ledger; i++)
        r = ask_findings(store, ledger[i], found, context, err);
    return r;
}

int gsn_audit_file(struct gsn_store *store, const char *relative, const char *sha256,
                   struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", gsn_store_dir(store), relative);
    struct gsn_digest digest;
    gsn_auto_fd fd = -1;
    int r = path ? gsn_file_open(path, &fd, err) : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = gsn_sha256_file(fd, path, &digest, NULL, err);
    if (r >= 0 && strcmp(digest.hex, sha256) != 0)
        r = gsn_fail(err, GSN_E_INPUT, "%s: its bytes are not those that the run wrote", path);
    return r;
}
