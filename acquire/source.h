/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where panels come from: a folder today, a scanner or a camera behind the same few verbs.
 *
 * A source lists items (whole pictures, as files would be). An item is READY when all its bytes
 * can be read; the caller reads them, makes them durable, and only then acknowledges. An item that
 * was not acknowledged is offered again by the next poll; nothing is ever deleted at the source.
 * Events of a device are hints, its listing is the truth, so poll looks at everything each time.
 *
 * Times are milliseconds of any clock that never goes back, and come from the caller. A source
 * belongs to one thread at a time. */
#ifndef GSN_ACQUIRE_SOURCE_H
#define GSN_ACQUIRE_SOURCE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_source_what {
    GSN_SOURCE_READY,   /* can be read now; told at every poll until acknowledged */
    GSN_SOURCE_WAITING, /* seen, not ready; told when first seen and when the reason changes */
    GSN_SOURCE_GONE,    /* vanished before it was acknowledged; told once */
    GSN_SOURCE_NOTICE,  /* about something that will not be delivered, or the source; told once */
};

struct gsn_source_event {
    enum gsn_source_what what;
    uint64_t item;      /* for read and acknowledge; 0 with a notice */
    const char *name;   /* as the source calls it, without folder */
    const char *reason; /* a sentence without full stop; empty when READY and whole */
    uint64_t size;      /* bytes, when READY */
    int incomplete;     /* READY after the patience ran out on a container that is not whole */
};

struct gsn_source_events {
    size_t count;
    struct gsn_source_event *at;
};

void gsn_source_events_free(struct gsn_source_events *events);
GSN_DEFINE_AUTO(gsn_source_events);

struct gsn_source_options {
    int64_t settle_ms;   /* two looks must agree over at least this long */
    int64_t patience_ms; /* an unchanged item that is not whole is delivered after this long */
};

struct gsn_source;

/* Opens "hot:DIR" (a folder that is looked at for ever) or "replay:DIR" (what is in it at the first
 * poll, then the end). gives: the source. Fails with GSN_E_UNSUPPORTED for another kind,
 * GSN_E_NOTFOUND, GSN_E_IO. */
int gsn_source_open(const char *address, const struct gsn_source_options *options,
                    struct gsn_source **ret_source, struct gsn_error *err);
void gsn_source_free(struct gsn_source *source);
GSN_DEFINE_AUTO(gsn_source);

/* Looks. gives: what there is to tell, READY items in natural order of their names (1, 2, 10).
 * ret_ended is 1 when nothing will ever follow. After GSN_E_IO (the folder or device is away) the
 * source stays usable: poll again later. */
int gsn_source_poll(struct gsn_source *source, int64_t now_ms,
                    struct gsn_source_events **ret_events, int *ret_ended, struct gsn_error *err);

/* Copies up to size bytes of a READY item from offset; ret_got is 0 at its end.
 * Fails with GSN_E_BUSY when the item changed since it was told (it will be WAITING again),
 * GSN_E_NOTFOUND when it is gone or no such item is READY, GSN_E_IO. */
int gsn_source_read(struct gsn_source *source, uint64_t item, uint64_t offset, void *buffer,
                    size_t size, size_t *ret_got, struct gsn_error *err);

/* The bytes of this READY item are safe: do not offer it again, unless it changes.
 * Fails with GSN_E_NOTFOUND when no such item is READY. */
int gsn_source_acknowledge(struct gsn_source *source, uint64_t item, struct gsn_error *err);

/* borrows: what the source is, as in its address. Valid as long as the source. */
const char *gsn_source_address(const struct gsn_source *source);

/* One row per kind of source, for those who write one. self is what open gave; the functions obey
 * the contract of their namesakes above, and further:
 *   open         rest is the address behind "kind:".
 *   poll         fills a list the caller made empty, through gsn_source_tell().
 *   acknowledge  must not fail for a lack of memory: the bytes are already safe.
 *   close        accepts NULL. */
struct gsn_source_ops {
    const char *kind;
    int (*open)(const char *rest, const struct gsn_source_options *options, void **ret_self,
                struct gsn_error *err);
    int (*poll)(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                struct gsn_error *err);
    int (*read)(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                size_t *ret_got, struct gsn_error *err);
    int (*acknowledge)(void *self, uint64_t item, struct gsn_error *err);
    void (*close)(void *self);
};

/* Appends a copy of event (its texts are copied too) to the list. Fails with GSN_E_NOMEM. */
int gsn_source_tell(struct gsn_source_events *events, const struct gsn_source_event *event,
                    struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
