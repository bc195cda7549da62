/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/power/ingest.h"

#include <sqlite3.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

#include "acquire/spool.h"
#include "storage/catalog.h"
#include "systemd/ingest/intake.h"

enum { NOW = 1700000000 };

struct session {
    const struct power_ingest *ingest;
    struct gsn_intake intake;
    unsigned taken;
};

static int put_specimen(struct gsn_store *store, struct gsn_error *err)
{
    const struct gsn_specimen_row specimen = {
        .name = "S1",
        .study = "study",
        .group = "group",
        .animal = "animal",
        .week = 1,
        .kind = "sections",
        .baseline = "",
        .job_json = "{\"specimen\": \"S1\", \"study\": \"study\", \"group\": \"group\", "
                    "\"animal\": \"animal\", \"week\": 1}",
        .job_sha256 = ""
    };
    int64_t id = 0;

    return gsn_specimen_put(store, &specimen, GSN_SPECIMEN_REFUSE, "t", NOW, &id, err);
}

/* By the door of SQLite itself: what another program that closes its handle would do. */
static void checkpoint(const struct session *session)
{
    static const int how[] = { SQLITE_CHECKPOINT_PASSIVE, SQLITE_CHECKPOINT_RESTART,
                               SQLITE_CHECKPOINT_TRUNCATE };
    const unsigned every = session->ingest->checkpoint_every;
    char path[512];
    sqlite3 *db = NULL;

    if (every == 0 || session->taken % every != 0)
        return;
    (void)snprintf(path, sizeof path, "%s/gieson.db", session->ingest->store);
    if (sqlite3_open_v2(path, &db, SQLITE_OPEN_READWRITE, NULL) == SQLITE_OK)
        (void)sqlite3_wal_checkpoint_v2(db, NULL, how[session->taken / every % 3], NULL, NULL);
    (void)sqlite3_close(db);
}

static int take(struct session *session, const struct gsn_source_event *ready,
                struct gsn_error *err)
{
    struct gsn_intake_taken taken;
    enum gsn_intake_fault fault;
    const int r = gsn_intake_take(&session->intake, ready, NOW, &taken, &fault, err);

    if (r < 0)
        return r;
    if (session->ingest->acknowledged)
        session->ingest->acknowledged(session->ingest->context, ready->name,
                                      taken.spooled.digest.hex);
    session->taken++;
    checkpoint(session);
    return GSN_OK;
}

static bool is_over(const struct session *session, int ended)
{
    return ended || (session->ingest->most && session->taken >= session->ingest->most);
}

static int run(struct session *session, struct gsn_error *err)
{
    int ended = 0, r = GSN_OK;

    for (int64_t now = 0; r >= 0 && !is_over(session, ended); now++) {
        gsn_auto(gsn_source_events) events = NULL;

        r = gsn_source_poll(session->intake.source, now, &events, &ended, err);
        for (size_t i = 0; r >= 0 && i < events->count && !is_over(session, 0); i++) {
            if (events->at[i].what == GSN_SOURCE_READY)
                r = take(session, &events->at[i], err);
        }
        if (r >= 0)
            r = gsn_scan_commit_staged(session->intake.store, err);
    }
    return r;
}

int power_ingest(const struct power_ingest *ingest, unsigned *ret_taken, struct gsn_error *err)
{
    struct session session = { .ingest = ingest, .intake.name = "t" };
    const struct gsn_source_options options = { .patience_ms = 1,
                                                .is_known = gsn_intake_is_known,
                                                .on_read = gsn_intake_on_read,
                                                .context = &session.intake };
    gsn_auto(gsn_source) source = NULL;
    gsn_auto(gsn_store) store = NULL;
    gsn_auto(gsn_spool) spool = NULL;
    int r = gsn_store_open(ingest->store, GSN_STORE_CREATE, &store, err);

    if (r >= 0)
        r = put_specimen(store, err);
    if (r >= 0)
        r = gsn_spool_open(ingest->store, 0, &spool, err);
    if (r >= 0)
        r = gsn_source_open(ingest->address, &options, &source, err);
    if (r < 0)
        return r;
    session.intake.source = source;
    session.intake.store = store;
    session.intake.spool = spool;
    r = run(&session, err);
    *ret_taken = session.taken;
    return r;
}
