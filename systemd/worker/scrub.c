/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A scrub: the store is asked whether it is still what it was, before anybody needs it.
 *
 * 1. The audit (systemd/worker/audit.h): pages of the database, tables, audit log, runs, report
 * files, what rows and log and folders say of one another. Minutes at most.
 * 2. Unless it is to be quick, every object is read from the disk and hashed, in the order of the
 *    digests. DIR/scrub.json keeps how far it came, so that a round may take many nights.
 *
 * A finding is told at once, then written down as a trouble and an event; a database that cannot
 * take that any more has been told of by then. */
#include "systemd/worker/scrub.h"

#include <errno.h>
#include <fcntl.h>
#include <jansson.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include "pipeline/core/calendar.h"
#include "pipeline/core/file.h"
#include "pipeline/core/hash.h"
#include "storage/audit_log.h"
#include "storage/bench.h"
#include "storage/catalog.h"

enum {
    AT_ONCE = 256,     /* rows */
    KEEP_EVERY_S = 10, /* a power cut costs this much of a round */
    MOST_KEPT_BYTES = 4096,
};

/* The name under which troubles stand that were found here. */
static const char SOURCE[] = "store";

/* A round on its way. */
struct round {
    const struct gsn_scrub *scrub;
    struct gsn_scrub_counts counts;
    struct gsn_trouble_rows *troubles; /* as they were at the start */
    json_t *found;                     /* by the audit: what -> sentence */
    char after[65];                    /* the last object that was read */
    int64_t kept;                      /* seconds: when that was written down */
};

/* ---- where a round stands ---------------------------------------------------------------- */

static char *progress_path(const struct round *round)
{
    return gsn_format("%s/scrub.json", gsn_store_dir(round->scrub->store));
}

/* A file that cannot be understood begins a new round. */
static int read_progress(struct round *round, struct gsn_error *err)
{
    gsn_auto_mem(char) path = progress_path(round);
    gsn_auto_mem(uint8_t) text = NULL;
    struct gsn_error quiet = { 0 };
    const char *after;
    json_t *root;
    size_t size;
    int r;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = gsn_file_read(path, MOST_KEPT_BYTES, &text, &size, &quiet);
    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", quiet.text);
    root = r >= 0 ? json_loadb((const char *)text, size, 0, NULL) : NULL;
    after = json_string_value(json_object_get(root, "after"));
    if (after && strlen(after) == sizeof round->after - 1) {
        (void)snprintf(round->after, sizeof round->after, "%s", after);
        round->counts.round_checked = json_integer_value(json_object_get(root, "checked"));
        round->counts.round_damaged = json_integer_value(json_object_get(root, "damaged"));
    }
    json_decref(root);
    return GSN_OK;
}

static int write_progress(struct round *round, struct gsn_error *err)
{
    gsn_auto_mem(char) path = progress_path(round);
    gsn_auto_mem(char) text =
        gsn_format("{\"after\": \"%s\", \"checked\": %lld, \"damaged\": %lld}\n", round->after,
                   (long long)round->counts.round_checked, (long long)round->counts.round_damaged);

    if (!path || !text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    round->kept = gsn_now_ms() / 1000;
    return gsn_file_write(path, text, strlen(text), err);
}

/* ---- one object -------------------------------------------------------------------------- */

/* From the disk and not from memory, and without pushing out what others keep there. */
static int hash_object(struct round *round, const char *path, struct gsn_digest *ret_digest,
                       struct gsn_error *err)
{
    int64_t size = 0;
    int fd = -1;
    int r = gsn_file_open(path, &fd, err);

    if (r < 0)
        return r;
    (void)posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
    r = gsn_sha256_file(fd, path, ret_digest, &size, err);
    round->counts.bytes += r >= 0 ? size : 0;
    (void)posix_fadvise(fd, 0, 0, POSIX_FADV_DONTNEED);
    (void)close(fd);
    return r;
}

/* Fails with GSN_E_INPUT, GSN_E_NOTFOUND or GSN_E_IO when the object is not what its name says. */
static int check_object(struct round *round, const struct gsn_object_row *object,
                        struct gsn_error *err)
{
    const char *const sha256 = object->sha256;
    const int64_t before = round->counts.bytes;
    gsn_auto_mem(char) path = NULL;
    struct gsn_digest digest;
    int r = gsn_store_object_path(round->scrub->store, sha256, &path, err);

    if (r >= 0)
        r = hash_object(round, path, &digest, err);
    if (r >= 0 && strcmp(digest.hex, sha256) != 0)
        r = gsn_fail(err, GSN_E_INPUT, "%s: its bytes are no longer those that came in", path);
    if (r >= 0 && round->counts.bytes - before != object->size)
        r = gsn_fail(err, GSN_E_INPUT, "%s: the row says it came in with %lld bytes", path,
                     (long long)object->size);
    return r;
}

/* ---- what is found ----------------------------------------------------------------------- */

/* gives: "P03.tif of R07-left and 2 more". */
static int who_rests(struct gsn_store *store, const char *sha256, char **ret_who,
                     struct gsn_error *err)
{
    gsn_auto(gsn_object_use_rows) uses = NULL;
    gsn_auto_mem(char) first = NULL;
    const int r = gsn_object_uses(store, sha256, &uses, err);

    if (r < 0)
        return r;
    /* Its row went while it was read. */
    if (uses->count == 0)
        first = gsn_strdup("nothing");
    else
        first = gsn_format("%.200s%s%.200s", uses->at[0].name,
                           uses->at[0].specimen[0] ? " of " : "", uses->at[0].specimen);
    if (!first)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    *ret_who =
        uses->count > 1 ? gsn_format("%s and %zu more", first, uses->count - 1) : gsn_steal(&first);
    return *ret_who ? GSN_OK : gsn_fail(err, GSN_E_NOMEM, "out of memory");
}

static int record_damage(struct round *round, const char *sha256, const char *reason,
                         struct gsn_error *err)
{
    static const char action[] = "import the original again, or put the file back from a backup; "
                                 "then `gieson scrub`";
    const struct gsn_scrub *scrub = round->scrub;
    struct gsn_trouble_row trouble = { .source = SOURCE, .name = sha256, .action = action };
    gsn_auto_mem(char) who = NULL;
    gsn_auto_mem(char) sentence = NULL;
    int r = who_rests(scrub->store, sha256, &who, err);

    if (r < 0)
        return r;
    sentence = gsn_format("%s rests on it: %s", who, reason);
    if (!sentence)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    trouble.reason = sentence;
    round->counts.damaged++;
    round->counts.round_damaged++;
    r = gsn_event_add(scrub->store, time(NULL), scrub->actor, "damaged", sha256, sentence, err);
    if (r >= 0)
        r = gsn_trouble_put(scrub->store, &trouble, time(NULL), err);
    if (scrub->damaged) {
        gsn_auto_mem(char) whole = gsn_format("%s; %s", sentence, action);

        if (!whole)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory");
        scrub->damaged(scrub->context, sha256, whole);
    }
    return r;
}

static int was_damaged(const struct round *round, const char *sha256)
{
    for (size_t i = 0; i < round->troubles->count; i++)
        if (strcmp(round->troubles->at[i].source, SOURCE) == 0 &&
            strcmp(round->troubles->at[i].name, sha256) == 0)
            return 1;
    return 0;
}

static int scrub_object(struct round *round, const struct gsn_object_row *object,
                        struct gsn_error *err)
{
    const char *const sha256 = object->sha256;
    const struct gsn_scrub *scrub = round->scrub;
    struct gsn_error why = { 0 };
    int r = check_object(round, object, &why);

    if (r == GSN_E_NOMEM)
        return gsn_fail(err, r, "%s", why.text);
    round->counts.checked++;
    round->counts.round_checked++;
    if (r < 0)
        r = record_damage(round, sha256, why.text, err);
    else if (was_damaged(round, sha256))
        r = gsn_trouble_clear(scrub->store, SOURCE, sha256, scrub->actor, time(NULL), err);
    (void)snprintf(round->after, sizeof round->after, "%s", sha256);
    if (r >= 0 && gsn_now_ms() / 1000 - round->kept >= KEEP_EVERY_S)
        r = write_progress(round, err);
    return r;
}

/* ---- the audit ---------------------------------------------------------------------------- */

static void note_finding(void *context, const char *what, const char *sentence)
{
    struct round *const round = context;
    const struct gsn_scrub *const scrub = round->scrub;

    round->counts.findings++;
    (void)json_object_set_new(round->found, what, json_string(sentence));
    if (scrub->found)
        scrub->found(scrub->context, what, sentence);
}

static int is_object(const char *name)
{
    return strlen(name) == sizeof((struct gsn_digest *)NULL)->hex - 1 &&
           strspn(name, "0123456789abcdef") == strlen(name);
}

/* Each finding is a trouble, until it is not found any more. */
static int write_findings(struct round *round, struct gsn_error *err)
{
    struct gsn_store *const store = round->scrub->store;
    const char *const actor = round->scrub->actor;
    const char *what;
    json_t *sentence;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < round->troubles->count; i++) {
        const struct gsn_trouble_row *const t = &round->troubles->at[i];

        if (strcmp(t->source, SOURCE) == 0 && !is_object(t->name) &&
            !json_object_get(round->found, t->name))
            r = gsn_trouble_clear(store, SOURCE, t->name, actor, time(NULL), err);
    }
    json_object_foreach(round->found, what, sentence)
    {
        const struct gsn_trouble_row trouble = {
            .source = SOURCE,
            .name = what,
            .reason = json_string_value(sentence),
            .action =
                "compare with a backup (`gieson backup` makes one), put back what is damaged; "
                "then `gieson scrub`"
        };

        if (r >= 0)
            r = gsn_event_add(store, time(NULL), actor, "damaged", what, trouble.reason, err);
        if (r >= 0)
            r = gsn_trouble_put(store, &trouble, time(NULL), err);
    }
    return r;
}

/* The pages first: a database that is damaged may not be able to answer the rest, and what was
 * found until then has been told. */
static int audit_store(struct round *round, struct gsn_error *err)
{
    gsn_auto_heads none = { .count = 0 };
    struct gsn_audit_heads *const heads = round->scrub->heads ? round->scrub->heads : &none;
    struct gsn_store *const store = round->scrub->store;
    int r = gsn_audit_pages(gsn_store_dir(store), note_finding, round, &round->counts.without, err);

    if (r >= 0)
        r = gsn_audit_store(store, heads, round->scrub->quick, note_finding, round,
                            &round->counts.events, err);
    return r < 0 ? r : write_findings(round, err);
}

/* ---- a round ----------------------------------------------------------------------------- */

static int end_round(struct round *round, struct gsn_error *err)
{
    gsn_auto_mem(char) path = progress_path(round);
    gsn_auto_mem(char) text =
        gsn_format("%lld objects read again, %lld damaged", (long long)round->counts.round_checked,
                   (long long)round->counts.round_damaged);

    if (!path || !text)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    round->counts.complete = 1;
    (void)unlink(path);
    return gsn_event_add(round->scrub->store, time(NULL), round->scrub->actor, "scrub", "", text,
                         err);
}

static int go_round(struct round *round, struct gsn_error *err)
{
    const unsigned minutes = round->scrub->minutes;
    const int64_t end = gsn_now_ms() / 1000 + 60 * (int64_t)minutes;

    for (;;) {
        gsn_auto(gsn_object_rows) objects = NULL;
        int r = gsn_object_list(round->scrub->store, round->after, AT_ONCE, &objects, err);

        if (r >= 0 && objects->count == 0)
            return end_round(round, err);
        for (size_t i = 0; r >= 0 && i < objects->count; i++) {
            if (minutes && gsn_now_ms() / 1000 >= end)
                return write_progress(round, err);
            r = scrub_object(round, &objects->at[i], err);
        }
        if (r < 0)
            return r;
    }
}

int gsn_scrub_run(const struct gsn_scrub *scrub, struct gsn_scrub_counts *ret_counts,
                  struct gsn_error *err)
{
    struct round round = { .scrub = scrub, .kept = gsn_now_ms() / 1000, .found = json_object() };
    int r = round.found ? read_progress(&round, err) : gsn_fail(err, GSN_E_NOMEM, "out of memory");

    if (r >= 0)
        r = gsn_trouble_list(scrub->store, &round.troubles, err);
    if (r >= 0)
        r = audit_store(&round, err);
    if (r >= 0 && !scrub->quick)
        r = go_round(&round, err);
    gsn_trouble_rows_free(round.troubles);
    json_decref(round.found);
    if (r >= 0)
        *ret_counts = round.counts;
    return r;
}
