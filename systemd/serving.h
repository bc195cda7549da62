/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One source while it is served: what its loop (serve_source.c), its taking in (serve_take.c) and
 * its waiting (serve_wait.c) share. Private to these three. */
#ifndef GSN_SYSTEMD_SERVING_H
#define GSN_SYSTEMD_SERVING_H

#include <stdbool.h>
#include <stdint.h>

#include "acquire/source.h"
#include "systemd/config.h"
#include "systemd/failing.h"
#include "systemd/intake.h"
#include "systemd/lifeline.h"
#include "systemd/log.h"
#include "systemd/source_row.h"
#include "systemd/specimen_folders.h"

/* The address of a folder that specimens' folders may lie in begins so. */
#define GSN_SERVING_HOT "hot:"

struct gsn_serving {
    struct gsn_store *store;
    const struct gsn_config_source *config;
    struct gsn_lifeline *line;
    struct gsn_intake intake;
    struct gsn_spool *spool;
    struct gsn_source *source;
    struct gsn_specimen_folders *folders; /* NULL: no hot folder */
    struct gsn_specimen_ear ear;
    struct gsn_failing failing;
    struct gsn_source_row row;
    bool is_device; /* it can go away by itself */
    int wake;       /* readable: time to stop, or somebody wrote to the store; an epoll */
    int changes;    /* an inotify on the store's files; -1: none */
    /* the copy that goes on */
    const char *item;
    uint64_t item_size;
    int64_t item_began_ms;
    /* what this round found */
    char blame[480], blamed[300]; /* an item that failed and why, until the source answers again */
    unsigned store_failures;
    int64_t next_look_ms;
};

/* Who speaks, in the log. id: of the message, or NULL. */
struct gsn_log_about gsn_serving_about(const struct gsn_serving *serving, const char *id);

/* How long what comes must keep still: as configured, or what its file system needs. */
int64_t gsn_serving_settle_ms(const struct gsn_serving *serving);

/* Called by the spool and the intake while bytes come: the process lives, and how far it is. */
int gsn_serving_on_copy(void *context, uint64_t offset);
void gsn_serving_on_piece(void *context);

/* Takes everything that is ready, until something stops it. Fails only where nothing more can be
 * taken in this round. */
int gsn_serving_take_all(struct gsn_serving *serving, const struct gsn_source_events *events,
                         struct gsn_error *err);
/* The device still answers: what failed before is the item's own trouble, and becomes a row. */
int gsn_serving_settle_blame(struct gsn_serving *serving, struct gsn_error *err);
/* For the ear: what a person must change is a row of trouble until it is over. */
int gsn_serving_bar(void *serving, const char *name, const char *reason, const char *action,
                    struct gsn_error *err);
int gsn_serving_unbar(void *serving, const char *name, struct gsn_error *err);
/* Has every folder of a specimen that is due taken in by gieson-work. */
int gsn_serving_import_all(struct gsn_serving *serving, struct gsn_error *err);

/* Does what people asked of the source, such as to take a picture now. */
int gsn_serving_answer(struct gsn_serving *serving, struct gsn_error *err);
/* What wakes the process: the end, and for devices also somebody who writes to the store. */
int gsn_serving_open_wake(struct gsn_serving *serving, struct gsn_error *err);
/* Until it is time for another look; breathes meanwhile. */
int gsn_serving_wait(struct gsn_serving *serving, struct gsn_error *err);

#endif
