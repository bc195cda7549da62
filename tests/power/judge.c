/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/power/judge.h"

#include <dirent.h>
#include <sqlite3.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "acquire/spool.h"
#include "storage/audit_log.h"
#include "storage/queue.h"
#include "storage/scan.h"
#include "storage/store.h"
#include "tests/power/ingest.h"

const char *power_verdict_name(enum power_verdict verdict)
{
    static const char *const names[POWER_VERDICTS] = {
        "fine",
        "stores that do not open",
        "damaged databases",
        "acknowledged slices lost",
        "rows without their exact object",
        "objects under a false name",
        "intakes that do not finish",
        "slices missing or doubled afterwards",
        "temporaries left",
        "crashes",
    };

    return names[verdict];
}

struct judge {
    const char *dir;
    struct gsn_store *store;
    struct gsn_spool *spool;
    char *text;
    struct gsn_error err;
};

static enum power_verdict found(struct judge *judge, enum power_verdict verdict, const char *what)
{
    (void)snprintf(judge->text, 600, "%s: %.100s %.400s", power_verdict_name(verdict), what,
                   judge->err.text);
    return verdict;
}

static int count_row(void *context, int columns, char **values, char **names)
{
    (void)columns;
    (void)names;
    (void)snprintf(context, 100, "%s", values[0] ? values[0] : "");
    return 0;
}

static bool asks(const struct judge *judge, const char *sql, char answer[static 100])
{
    char path[512];
    sqlite3 *db = NULL;
    int r;

    (void)snprintf(path, sizeof path, "%s/gieson.db", judge->dir);
    r = sqlite3_open_v2(path, &db, SQLITE_OPEN_READWRITE, NULL);
    answer[0] = '\0';
    if (r == SQLITE_OK)
        r = sqlite3_exec(db, sql, count_row, answer, NULL);
    (void)sqlite3_close(db);
    return r == SQLITE_OK;
}

static enum power_verdict judge_database(struct judge *judge)
{
    struct gsn_event_verdict diary;
    char answer[100] = "";

    if (!asks(judge, "PRAGMA integrity_check", answer) || strcmp(answer, "ok") != 0)
        return found(judge, POWER_DAMAGED, answer);
    if (gsn_event_verify(judge->store, NULL, &diary, &judge->err) < 0 || diary.broken)
        return found(judge, POWER_DAMAGED, "the diary");
    return POWER_FINE;
}

static enum power_verdict judge_rows(struct judge *judge, const char *const *safe, size_t count)
{
    gsn_auto(gsn_scan_rows) rows = NULL;

    if (gsn_scan_list(judge->store, NULL, 0, &rows, &judge->err) < 0)
        return found(judge, POWER_DAMAGED, "the ledger");
    for (size_t i = 0; i < rows->count; i++) {
        struct gsn_digest digest;

        (void)snprintf(digest.hex, sizeof digest.hex, "%s", rows->at[i].sha256);
        if (gsn_spool_verify(judge->spool, &digest, &judge->err) < 0)
            return found(judge, POWER_ROW_ALONE, rows->at[i].name);
    }
    for (size_t i = 0; i < count; i++) {
        size_t j = 0;

        while (j < rows->count && !(strncmp(safe[i], rows->at[j].sha256, 64) == 0 &&
                                    strcmp(safe[i] + 65, rows->at[j].name) == 0))
            j++;
        if (j == rows->count)
            return found(judge, POWER_LOST, safe[i] + 65);
    }
    return POWER_FINE;
}

/* Calls back for each object; false ends it. */
static bool each_object(const struct judge *judge, bool (*see)(struct judge *, const char *hex),
                        struct judge *context)
{
    bool good = true;

    for (unsigned shelf = 0; good && shelf < 256; shelf++) {
        const struct dirent *entry;
        char path[600];
        DIR *dir;

        (void)snprintf(path, sizeof path, "%s/objects/%02x", judge->dir, shelf);
        dir = opendir(path);
        while (good && dir && (entry = readdir(dir))) {
            char hex[300];

            (void)snprintf(hex, sizeof hex, "%02x%s", shelf, entry->d_name);
            good = entry->d_name[0] == '.' || see(context, hex);
        }
        if (dir)
            (void)closedir(dir);
    }
    return good;
}

static bool is_true(struct judge *judge, const char *hex)
{
    struct gsn_digest digest;

    (void)snprintf(digest.hex, sizeof digest.hex, "%.64s", hex);
    return gsn_spool_verify(judge->spool, &digest, &judge->err) >= 0;
}

/* Parts of copies that their source broke off may stay for its next offer. */
static bool is_empty(const struct judge *judge, bool but_parts)
{
    const struct dirent *entry;
    char path[600];
    bool empty = true;
    DIR *dir;

    (void)snprintf(path, sizeof path, "%s/objects/tmp", judge->dir);
    dir = opendir(path);
    while (dir && (entry = readdir(dir)))
        empty &=
            entry->d_name[0] == '.' || (but_parts && strncmp(entry->d_name, "partial-", 8) == 0);
    if (dir)
        (void)closedir(dir);
    return dir && empty;
}

static enum power_verdict judge_again(struct judge *judge, const char *address, size_t pictures)
{
    const struct power_ingest ingest = { .store = judge->dir, .address = address };
    char answer[100] = "", expected[100];
    unsigned taken = 0;

    if (power_ingest(&ingest, &taken, &judge->err) < 0)
        return found(judge, POWER_NOT_AGAIN, "");
    (void)snprintf(expected, sizeof expected, "%zu %zu %zu %zu", pictures, pictures, pictures,
                   pictures + 1);
    if (!asks(judge,
              "SELECT (SELECT count(*) FROM scan) || ' ' || (SELECT count(DISTINCT name) FROM "
              "scan WHERE state = 'filed') || ' ' || (SELECT count(*) FROM panel) || ' ' || "
              "(SELECT count(*) FROM job)",
              answer) ||
        strcmp(answer, expected) != 0)
        return found(judge, POWER_NOT_ONCE, answer);
    return is_empty(judge, false) ? POWER_FINE : found(judge, POWER_LEFT_OVER, "");
}

enum power_verdict power_judge(const char *store, const char *address, const char *const *safe,
                               size_t count, size_t pictures, char text[static 600])
{
    gsn_auto(gsn_store) opened = NULL;
    gsn_auto(gsn_spool) spool = NULL;
    struct judge judge = { .dir = store, .text = text };
    enum power_verdict verdict;

    if (gsn_store_open(store, GSN_STORE_CREATE, &opened, &judge.err) < 0 ||
        gsn_spool_open(store, 0, &spool, &judge.err) < 0)
        return found(&judge, POWER_CLOSED, "");
    judge.store = opened;
    judge.spool = spool;
    verdict = judge_database(&judge);
    if (verdict == POWER_FINE)
        verdict = judge_rows(&judge, safe, count);
    if (verdict == POWER_FINE && !each_object(&judge, is_true, &judge))
        verdict = found(&judge, POWER_FALSE_NAME, "");
    if (verdict == POWER_FINE && !is_empty(&judge, true))
        verdict = found(&judge, POWER_LEFT_OVER, "after opening");
    return verdict == POWER_FINE ? judge_again(&judge, address, pictures) : verdict;
}
