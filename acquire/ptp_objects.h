/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a PTP device holds, as its listing says: who each object is, and whether it is ready.
 *
 * A handle means something within one session alone. In a new session objects are met again by
 * their key; those without one are new, except that a bad one stays set aside. */
#ifndef GSN_ACQUIRE_PTP_OBJECTS_H
#define GSN_ACQUIRE_PTP_OBJECTS_H

#include "acquire/ptp_device.h"
#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_ptp_state {
    GSN_PTP_NEW, /* not described yet */
    GSN_PTP_WAITING,
    GSN_PTP_READY,
    GSN_PTP_TAKEN,
    GSN_PTP_LEFT, /* no picture */
    GSN_PTP_FOLDER,
};

struct gsn_ptp_object {
    uint32_t handle;
    unsigned session; /* the one the handle is of */
    uint64_t item;
    enum gsn_ptp_state state;
    /* As described last; what must not change while an object settles. */
    uint32_t storage, parent;
    uint16_t format;
    uint64_t size;
    char *name; /* NULL until described */
    char *key;  /* who it is; empty where that cannot be told, NULL until all folders are known */
    char captured[64], modified[64];
    unsigned last_look; /* the listing that it was in */
    int64_t since_ms;   /* when it was first described as it is now */
    unsigned failures;  /* in a row; set aside until retry_ms */
    int64_t retry_ms;
    bool told, gone;
    bool check;      /* it is described again although it was taken */
    bool fresh;      /* it may be one of an earlier session */
    bool doubtful;   /* the device may have measured it too early in this session */
    unsigned doubts; /* so often it was measured anew because it is empty */
    bool delete_due;
    char notice[200]; /* to be told once */
    char reason[200];
};

struct gsn_ptp_table {
    struct gsn_source_options options;
    size_t count, room;
    struct gsn_ptp_object *at; /* by session, then handle */
    unsigned looks;            /* listings so far */
    uint64_t last_item;
    bool has_silent;   /* an object silenced the device when it was described */
    size_t next_check; /* among those taken, who is described again */
};

void gsn_ptp_table_done(struct gsn_ptp_table *table);

/* Lists the device and describes what is new or not settled. On failure the table holds what it
 * held, and perhaps more; nothing is gone because of it. */
int gsn_ptp_table_look(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
                       const struct gsn_ptp_hints *hints, int64_t now_ms, struct gsn_error *err);

/* The object with this item number that is READY; NULL. */
struct gsn_ptp_object *gsn_ptp_table_find(struct gsn_ptp_table *table, uint64_t item);

/* Describes it again: GSN_E_BUSY when it is not what it was (and then it waits), GSN_E_NOTFOUND
 * when there is no such object any more. */
int gsn_ptp_table_confirm(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
                          struct gsn_ptp_object *object, int64_t now_ms, struct gsn_error *err);

/* Whether a new session is called for: some responders measure an object once a session, and one
 * that was not whole, or is empty for long, may be larger by now; of an empty one this is so ever
 * more rarely. Only objects with a key are known again in the next session, so others do not call
 * for it. */
bool gsn_ptp_table_doubt(struct gsn_ptp_table *table, int64_t now_ms);

/* It waits, for this reason, from now on. */
void gsn_ptp_object_wait(struct gsn_ptp_object *object, const char *reason);

/* It could not be read, for this reason: others go first, and it is tried again rarely. */
void gsn_ptp_object_set_aside(struct gsn_ptp_object *object, const char *reason, int64_t now_ms);

/* Removes those that are gone, once that was told. */
void gsn_ptp_table_sweep(struct gsn_ptp_table *table);

/* Appends an event for each object that is ready, began to wait, is left or went, and for each
 * notice. device: NULL while it is away. Fails with GSN_E_NOMEM. */
int gsn_ptp_table_emit(const struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
                       struct gsn_source_events *events, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
