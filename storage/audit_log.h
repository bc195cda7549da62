/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The audit log: who did what, when and why. Rows are only ever added, and each carries the SHA-256
 * of itself and of the one before, so a change of history shows.
 *
 * The hash covers the previous hash, the id, the time and the four texts, each preceded by its
 * length. Cutting off the end leaves a shorter but sound chain: its end is remembered
 * outside (audit.h). */
#ifndef GSN_STORAGE_AUDIT_LOG_H
#define GSN_STORAGE_AUDIT_LOG_H

#include "pipeline/core/hash.h"
#include "storage/store.h"

#include <stdint.h>
#include <sys/types.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_event_row {
    int64_t id; /* 1, 2, 3, ... without a gap */
    int64_t time;
    const char *actor;   /* who: a user's name or a program */
    const char *kind;    /* one word: "import", "replace", "run", "retry", ... */
    const char *subject; /* what it is about: a specimen's name, a file, ... or empty */
    const char *text;
    const char *hash; /* 64 hexadecimal digits */
};

struct gsn_event_rows {
    size_t count;
    struct gsn_event_row *at;
};

void gsn_event_rows_free(struct gsn_event_rows *rows);

GSN_DEFINE_AUTO(gsn_event_rows);

int gsn_event_add(struct gsn_store *store, int64_t now, const char *actor, const char *kind,
                  const char *subject, const char *text, struct gsn_error *err);

/* gives: the last most events (0: all), oldest first. */
int gsn_event_list(struct gsn_store *store, size_t most, struct gsn_event_rows **ret_rows,
                   struct gsn_error *err);

/* The hash of the last event; 64 zeros when there is none. */
int gsn_event_head(struct gsn_store *store, struct gsn_digest *ret_head, struct gsn_error *err);

/* What gsn_event_verify() found. */
struct gsn_event_verdict {
    int64_t count;     /* events there are */
    int64_t broken;    /* id of the first that does not fit the chain; 0: none */
    int head_is_there; /* 1: the head asked for belongs to the chain, before any broken row */
};

/* Recomputes the chain. known_head: a head printed earlier, or NULL to ask for none. A broken
 * chain is a verdict, not an error. */
int gsn_event_verify(struct gsn_store *store, const char *known_head,
                     struct gsn_event_verdict *ret_verdict, struct gsn_error *err);

/* Who asks, for the audit log and the report: what the kernel knows, not what the environment says.
 *
 * The login uid is given once, when somebody logs in, and stays through sudo and su; where there is
 * none (a service, a container) the real uid stands alone. SUDO_USER, which anybody can set, is
 * only a remark behind. */

struct gsn_actor {
    char name[200]; /* "mueller", "mueller as root", "root (SUDO_USER says mueller)" */
};

struct gsn_actor gsn_actor_now(void);

/* login: (uid_t)-1 for none. claimed: what SUDO_USER says, or NULL. */
struct gsn_actor gsn_actor_of(uid_t login, uid_t real, const char *claimed);

#ifdef __cplusplus
}
#endif
#endif
