/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The audit log: who did what when, each event chained to the one before by SHA-256.
 *
 * Hash of an event: SHA-256 over the hash before it, its time, actor, kind, subject and text, each
 * with its length. So what was changed, put in, left out or put elsewhere breaks the chain from
 * there on; where the chain ends is remembered outside of the database (audit.h).
 *
 * The actor is the account that acts: credentials(7) for the real uid, proc(5) for
 * /proc/self/loginuid, which pam_loginuid(8) writes and audit relies on: without CAP_AUDIT_CONTROL
 * nobody changes it. A uid without a name is told as a number. A claim of the environment is cut,
 * and what a terminal would obey in it is shown as '?'.
 *
 * How it fails: an event is appended within the transaction of what it tells of, or neither is
 * there. */
#include "storage/audit_log.h"

#include <inttypes.h>
#include <pwd.h>
#include <sqlite3.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "pipeline/core/file.h"
#include "storage/sql.h"
#include "storage/transaction.h"

static const uid_t NOBODY_LOGGED_IN = (uid_t)-1;

struct name {
    char text[48];
};

/* Who acts. */

static struct name name_of(uid_t uid)
{
    struct name name;
    struct passwd entry, *found = NULL;
    char buffer[4096];

    if (getpwuid_r(uid, &entry, buffer, sizeof buffer, &found) == 0 && found)
        (void)snprintf(name.text, sizeof name.text, "%s", found->pw_name);
    else
        (void)snprintf(name.text, sizeof name.text, "uid %lu", (unsigned long)uid);
    return name;
}

static struct name tame_name(const char *claimed)
{
    struct name name;

    (void)snprintf(name.text, sizeof name.text, "%s", claimed);
    for (char *at = name.text; *at; at++)
        if (*at < ' ' || *at > '~' || *at == '(' || *at == ')')
            *at = '?';
    return name;
}

static uid_t login_uid(void)
{
    char text[32] = "";
    gsn_auto_fd fd = -1;
    ssize_t got = -1;

    if (gsn_file_open("/proc/self/loginuid", &fd, NULL) >= 0)
        got = read(fd, text, sizeof text - 1);
    return got > 0 ? (uid_t)strtoul(text, NULL, 10) : NOBODY_LOGGED_IN;
}

struct gsn_actor gsn_actor_of(uid_t login, uid_t real, const char *claimed)
{
    const struct name who = name_of(login == NOBODY_LOGGED_IN ? real : login);
    const struct name became = name_of(real);
    const struct name said = tame_name(claimed ? claimed : "");
    const int is_other = login != NOBODY_LOGGED_IN && login != real;
    const int is_claimed = said.text[0] && strcmp(said.text, who.text) != 0;
    struct gsn_actor actor;

    (void)snprintf(actor.name, sizeof actor.name, "%s%s%s%s%s%s", who.text, is_other ? " as " : "",
                   is_other ? became.text : "", is_claimed ? " (SUDO_USER says " : "",
                   is_claimed ? said.text : "", is_claimed ? ")" : "");
    return actor;
}

struct gsn_actor gsn_actor_now(void)
{
    return gsn_actor_of(login_uid(), getuid(), getenv("SUDO_USER"));
}

#define FIELD(type, name)                                                                          \
    {                                                                                              \
        GSN_SQL_##type, offsetof(struct gsn_event_row, name)                                       \
    }
static const struct gsn_sql_field event_fields[] = {
    FIELD(INT, id),       FIELD(INT, time),  FIELD(TEXT, actor), FIELD(TEXT, kind),
    FIELD(TEXT, subject), FIELD(TEXT, text), FIELD(TEXT, hash),
};
#define COLUMNS "id, time, actor, kind, subject, text, hash"

static const struct gsn_sql_shape event_shape = SQL_SHAPE(struct gsn_event_row, event_fields);

SQL_DEFINE_ROWS(event);

static const struct gsn_digest no_event = {
    "0000000000000000000000000000000000000000000000000000000000000000"
};

/* The chain. */

/* The length in front keeps "ab" + "c" and "a" + "bc" apart. */
static int hash_text(struct gsn_hash *hash, const char *text, struct gsn_error *err)
{
    const size_t length = strlen(text);
    char digits[24];
    size_t at = sizeof digits, rest = length;
    int r;

    digits[--at] = ':';
    do {
        digits[--at] = (char)('0' + rest % 10);
        rest /= 10;
    } while (rest > 0);
    r = gsn_hash_add(hash, digits + at, sizeof digits - at, err);
    return r >= 0 ? gsn_hash_add(hash, text, length, err) : r;
}

static int hash_event(struct gsn_store *store, const char *previous,
                      const struct gsn_event_row *event, struct gsn_digest *ret_digest,
                      struct gsn_error *err)
{
    struct gsn_hash *hash = NULL;
    char numbers[64];
    const char *const texts[] = { previous,    numbers,        event->actor,
                                  event->kind, event->subject, event->text };
    int r = gsn_store_hash(store, &hash, err);

    (void)snprintf(numbers, sizeof numbers, "%" PRId64 " %" PRId64, event->id, event->time);
    for (size_t i = 0; r >= 0 && i < sizeof texts / sizeof texts[0]; i++)
        r = hash_text(hash, texts[i], err);
    return r >= 0 ? gsn_hash_end(hash, ret_digest, err) : r;
}

static const struct gsn_sql_field head_fields[] = {
    FIELD(INT, id),
    FIELD(TEXT, hash),
};

#undef FIELD
static const struct gsn_sql_shape head_shape = SQL_SHAPE(struct gsn_event_row, head_fields);

int gsn_event_tail(struct gsn_store *store, struct gsn_event_tail *ret_tail, struct gsn_error *err)
{
    void *row = NULL;
    const struct gsn_event_row *event;
    const int r =
        gsn_sql_row(store, &head_shape, "SELECT id, hash FROM event ORDER BY id DESC LIMIT 1",
                    SQL_NO_ARGS, &row, err);

    if (r < 0 && r != GSN_E_NOTFOUND)
        return r;
    event = row;
    ret_tail->id = event ? event->id : 0;
    ret_tail->head = no_event;
    if (event)
        (void)snprintf(ret_tail->head.hex, sizeof ret_tail->head.hex, "%s", event->hash);
    gsn_sql_free_rows(&head_shape, row, event ? 1 : 0);
    return GSN_OK;
}

int gsn_event_append_to(struct gsn_store *store, struct gsn_event_tail *tail, int64_t now,
                        const char *actor, const char *kind, const char *subject, const char *text,
                        struct gsn_error *err)
{
    struct gsn_event_row event = { .id = tail->id + 1,
                                   .time = now,
                                   .actor = actor,
                                   .kind = kind,
                                   .subject = subject,
                                   .text = text };
    struct gsn_sql_value values[sizeof event_fields / sizeof event_fields[0]];
    struct gsn_digest digest;
    int r = hash_event(store, tail->head.hex, &event, &digest, err);

    if (r < 0)
        return r;
    event.hash = digest.hex;
    r = gsn_sql_run(store, "INSERT INTO event (" COLUMNS ") VALUES (?1, ?2, ?3, ?4, ?5, ?6, ?7)",
                    gsn_sql_fields(&event_shape, &event, values), NULL, err);
    if (r < 0)
        return r;
    tail->id = event.id;
    tail->head = digest;
    gsn_store_log_grew(store);
    return GSN_OK;
}

int gsn_event_append(struct gsn_store *store, int64_t now, const char *actor, const char *kind,
                     const char *subject, const char *text, struct gsn_error *err)
{
    struct gsn_event_tail tail;
    const int r = gsn_event_tail(store, &tail, err);

    return r < 0 ? r : gsn_event_append_to(store, &tail, now, actor, kind, subject, text, err);
}

int gsn_event_list(struct gsn_store *store, size_t most, struct gsn_event_rows **ret_rows,
                   struct gsn_error *err)
{
    const int64_t limit = most == 0 || most > INT64_MAX ? INT64_MAX : (int64_t)most;

    return event_rows(store,
                      "SELECT * FROM (SELECT " COLUMNS " FROM event ORDER BY id DESC LIMIT ?1) "
                      "ORDER BY id",
                      SQL_ARGS(SQL_INT(limit)), ret_rows, err);
}

int gsn_event_head(struct gsn_store *store, struct gsn_digest *ret_head, struct gsn_error *err)
{
    struct gsn_event_tail tail;
    const int r = gsn_event_tail(store, &tail, err);

    if (r >= 0)
        *ret_head = tail.head;
    return r;
}

static const char *text_of(sqlite3_stmt *row, int column)
{
    const unsigned char *const text = sqlite3_column_text(row, column);

    return text ? (const char *)text : "";
}

/* Row by row: a log of years need not fit into memory. */
int gsn_event_verify(struct gsn_store *store, const char *known_head,
                     struct gsn_event_verdict *ret_verdict, struct gsn_error *err)
{
    gsn_auto_statement row = NULL;
    struct gsn_event_verdict verdict = { 0 };
    struct gsn_digest digest, previous = no_event;
    int step = SQLITE_DONE, r = GSN_OK;

    if (sqlite3_prepare_v2(gsn_store_handle(store), "SELECT " COLUMNS " FROM event ORDER BY id", -1,
                           &row, NULL) != SQLITE_OK)
        return gsn_store_failed(store, err);
    verdict.head_is_there = known_head && strcmp(known_head, no_event.hex) == 0;
    for (; r >= 0 && (step = sqlite3_step(row)) == SQLITE_ROW; verdict.count++) {
        const struct gsn_event_row event = { .id = sqlite3_column_int64(row, 0),
                                             .time = sqlite3_column_int64(row, 1),
                                             .actor = text_of(row, 2),
                                             .kind = text_of(row, 3),
                                             .subject = text_of(row, 4),
                                             .text = text_of(row, 5),
                                             .hash = text_of(row, 6) };

        if (verdict.broken)
            continue;
        r = hash_event(store, previous.hex, &event, &digest, err);
        if (r >= 0 && strcmp(event.hash, digest.hex) != 0)
            verdict.broken = event.id;
        else if (r >= 0 && known_head && strcmp(known_head, digest.hex) == 0)
            verdict.head_is_there = 1;
        previous = digest;
    }
    if (r >= 0 && step != SQLITE_DONE)
        r = gsn_store_failed(store, err);
    if (r >= 0)
        *ret_verdict = verdict;
    return r;
}
