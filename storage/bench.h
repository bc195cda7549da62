/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The bench as people see it: the state of each source, what could not be taken in, and requests
 * for pictures. */
#ifndef GSN_STORAGE_BENCH_H
#define GSN_STORAGE_BENCH_H

#include "pipeline/core/error.h"
#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_bench_source {
    const char *name, *address, *device;
    const char *state;   /* "away", "ready", "receiving", "paused", "failed" or "off" */
    const char *message; /* a sentence, or empty */
    const char *item;    /* what is being received, or empty */
    int64_t done, total; /* bytes of it */
    const char *expects; /* the specimen it delivers, or empty; not read by put */
    int64_t changed;
};

struct gsn_bench_sources {
    size_t count;
    struct gsn_bench_source *at;
};

void gsn_bench_sources_free(struct gsn_bench_sources *rows);

GSN_DEFINE_AUTO(gsn_bench_sources);

/* Writes a source's row; one that says the same already is not written again. */
int gsn_bench_put(struct gsn_store *store, const struct gsn_bench_source *source, int64_t now,
                  struct gsn_error *err);

/* Sources that are not among these names become "off". */
int gsn_bench_keep(struct gsn_store *store, const char *const *names, size_t count, int64_t now,
                   struct gsn_error *err);

/* gives: by name. */
int gsn_bench_list(struct gsn_store *store, struct gsn_bench_sources **ret_rows,
                   struct gsn_error *err);

struct gsn_trouble_row {
    const char *source, *name;
    const char *reason; /* a sentence */
    const char *action; /* what to do next, in words */
    int64_t tries, since, last;
};

struct gsn_trouble_rows {
    size_t count;
    struct gsn_trouble_row *at;
};

void gsn_trouble_rows_free(struct gsn_trouble_rows *rows);

GSN_DEFINE_AUTO(gsn_trouble_rows);

/* Says that something could not be taken in; a second time counts the tries. A new one is a line in
 * the audit log. */
int gsn_trouble_put(struct gsn_store *store, const struct gsn_trouble_row *trouble, int64_t now,
                    struct gsn_error *err);

/* It came in after all, or is dismissed: removed; with an event in the audit log when it was there.
 */
int gsn_trouble_clear(struct gsn_store *store, const char *source, const char *name,
                      const char *actor, int64_t now, struct gsn_error *err);

/* gives: oldest first. */
int gsn_trouble_list(struct gsn_store *store, struct gsn_trouble_rows **ret_rows,
                     struct gsn_error *err);

struct gsn_request_row {
    int64_t id, time;
    const char *actor;
    const char *kind; /* "capture-panel", "capture-blank" or "capture-dark" */
    const char *source;
    const char *state;   /* "waiting", "done" or "refused" */
    const char *message; /* why refused, or empty */
};

void gsn_request_row_free(struct gsn_request_row *row);

GSN_DEFINE_AUTO(gsn_request_row);

/* Fails with GSN_E_NOTFOUND when there is no such source. */
int gsn_request_add(struct gsn_store *store, const char *source, const char *kind,
                    const char *actor, int64_t now, int64_t *ret_id, struct gsn_error *err);

/* gives: the oldest waiting one for this source. Fails with GSN_E_NOTFOUND. */
int gsn_request_next(struct gsn_store *store, const char *source, struct gsn_request_row **ret_row,
                     struct gsn_error *err);

/* gives. Fails with GSN_E_NOTFOUND. */
int gsn_request_get(struct gsn_store *store, int64_t id, struct gsn_request_row **ret_row,
                    struct gsn_error *err);

/* message NULL: done; else refused because of it. A line in the audit log. */
int gsn_request_answer(struct gsn_store *store, int64_t id, const char *message, int64_t now,
                       struct gsn_error *err);

/* Who serves a store: locks on DIR/giesond.lock that end with the process that took them.
 *
 * A service that was killed leaves no lock, so readers can say whether panels come in and whether
 * the queue is worked; and no two services take in the same panels. */

enum gsn_service {
    GSN_SERVICE_INTAKE, /* panels come in */
    GSN_SERVICE_QUEUE,  /* jobs are worked */
};

/* gives: a descriptor; the service is there until it is closed or its process ends. Programs that
 * the process starts do not hold it.
 *
 * Fails with GSN_E_BUSY when another process is that service, GSN_E_IO. */
int gsn_service_take(const char *dir, enum gsn_service service, int *ret_lock,
                     struct gsn_error *err);

/* Whether somebody is that service now; takes no lock itself. Fails with GSN_E_IO. */
int gsn_service_is_there(const char *dir, enum gsn_service service, int *ret_there,
                         struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
