/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One picture's way from its source into the store, in the order that loses nothing: room on the
 * disk -> bytes durable -> its row in the staging table durable -> (where the device is to delete
 * its copy: the object read again, and found to be a whole picture) -> the source is told. A crash
 * anywhere leaves a picture that is offered again and recognised. gsn_scan_commit_staged() does the
 * rest, when it is called or by whoever writes to the store next: ledger, panel, job and audit log.
 */
#ifndef GSN_SYSTEMD_INGEST_INTAKE_H
#define GSN_SYSTEMD_INGEST_INTAKE_H

#include "acquire/source.h"
#include "acquire/spool.h"
#include "storage/scan.h"
#include "storage/store.h"

#include <stdint.h>

/* keeps: everything in it. */
struct gsn_intake {
    const char *name; /* of the source, in the configuration */
    struct gsn_store *store;
    struct gsn_spool *spool;
    struct gsn_source *source;
    int delete_there;
    /* For so long the half picture of a device is asked for again, as long as it stays the same,
     * before it is taken as it is; 0: it is taken at once. Folders wait by themselves. */
    int64_t patience_s;
    struct gsn_intake_half *half; /* owned; what is waited for: gsn_intake_done() */
    /* Told how far a copy is; another answer than 0 breaks it off. May be NULL. */
    int (*on_copy)(void *context, uint64_t offset);
    void *context;
    /* Of the source's last read, for gsn_intake_take(): its code, where it ended, and whether
     * nothing came any more. */
    int read_code, read_nothing;
    uint64_t read_to;
};

/* Frees what the intake owns; the rest is the caller's. */
void gsn_intake_done(struct gsn_intake *intake);

/* For gsn_source_options, with the intake as their context. */
int gsn_intake_is_known(void *intake, const char *key);

int gsn_intake_on_read(void *intake, uint64_t item, uint64_t offset, int r);

/* What was taken from the source last, one scan for each subject; NULL where there is none. owned:
 * the scans. */
struct gsn_intake_past {
    struct gsn_scan_row *scan[GSN_SUBJECTS];
};

/* Reads the ledger, and lets the options tell the source of it. keeps: the past, in the options.
 * gives: its scans, for gsn_intake_past_done(). */
int gsn_intake_recall(struct gsn_store *store, const char *name, struct gsn_intake_past *past,
                      struct gsn_source_options *options, struct gsn_error *err);

void gsn_intake_past_done(struct gsn_intake_past *past);

/* Whose failure it was, which is what decides what to do next. */
enum gsn_intake_fault {
    GSN_FAULT_NONE,
    GSN_FAULT_ITEM,  /* this picture cannot be had; others may */
    GSN_FAULT_SIZE,  /* this picture does not fit; others may */
    GSN_FAULT_LATER, /* it changed or vanished, or the copy was broken off: the next poll tells */
    GSN_FAULT_ROOM,  /* the disk is below its reserve: nothing can be taken */
    GSN_FAULT_STORE, /* the store or its disk refuses: nothing can be taken */
};

struct gsn_intake_taken {
    int64_t scan;
    int again; /* it was in the ledger before */
    struct gsn_spooled spooled;
    char kept[200]; /* why the device keeps its copy though it was to delete it; empty: no such case
                     */
};

/* Takes one READY item. ret_taken is set on success, ret_fault always. An empty item is a fault of
 * its own, and acknowledged where nothing is deleted for it. */
int gsn_intake_take(struct gsn_intake *intake, const struct gsn_source_event *ready, int64_t now,
                    struct gsn_intake_taken *ret_taken, enum gsn_intake_fault *ret_fault,
                    struct gsn_error *err);

/* The pictures of a source that could not be taken in, and when each is tried again: at once, then
 * later each time. What is in the list has its row in the store. */

struct gsn_failing_entry {
    char *name, *reason; /* reason: as it was told last, or NULL */
    int64_t next_ms, delay_ms;
};

/* keeps: store and source (its name). */
struct gsn_failing {
    struct gsn_store *store;
    const char *source;
    size_t count;
    struct gsn_failing_entry *at;
};

/* Reads the rows that an earlier process left; those are tried at once. */
int gsn_failing_load(struct gsn_failing *list, struct gsn_error *err);

void gsn_failing_done(struct gsn_failing *list);

/* Whether it is too early to try this one again. */
int gsn_failing_is_early(const struct gsn_failing *list, const char *name, int64_t now_ms);

/* The same, and that is why. */
int gsn_failing_is_early_for(const struct gsn_failing *list, const char *name, const char *reason,
                             int64_t now_ms);

/* It failed (once more). ret_new: 1 when it was in no trouble before, or in another one. */
int gsn_failing_add(struct gsn_failing *list, const char *name, const char *reason,
                    const char *action, int64_t now_ms, int *ret_new, struct gsn_error *err);

/* It came in, or is none of ours any more. */
int gsn_failing_over(struct gsn_failing *list, const char *name, struct gsn_error *err);

/* What does not lie in this folder any more is in no trouble. */
int gsn_failing_forget_gone(struct gsn_failing *list, const char *folder, struct gsn_error *err);

#endif
