/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Where panels come from: a folder, a scanner or a camera behind the same few verbs.
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

/* What a picture is of. Blank glass and dark frames are taken on purpose, by request. */
enum gsn_source_subject { GSN_SUBJECT_PANEL, GSN_SUBJECT_BLANK, GSN_SUBJECT_DARK, GSN_SUBJECTS };

enum gsn_source_what {
    GSN_SOURCE_READY,   /* can be read now; told at every poll until acknowledged */
    GSN_SOURCE_WAITING, /* seen, not ready; told when first seen and when the reason changes */
    GSN_SOURCE_GONE,    /* vanished before it was acknowledged; told once */
    GSN_SOURCE_NOTICE,  /* about something that will not be delivered, or the source; told once */
    GSN_SOURCE_BARRED, /* would be delivered, were it not for what a person must change: reason says
                          why, action what; told at every poll until that is so */
};

struct gsn_source_event {
    enum gsn_source_what what;
    uint64_t
        item; /* for read and acknowledge; a notice ends the waiting for its item, 0: for none */
    const char *name;   /* as the source calls it, without folder */
    const char *reason; /* a sentence without full stop; empty when READY and whole */
    const char *action; /* when BARRED: what to do about it, likewise; else empty */
    uint64_t size;      /* bytes, when READY */
    int incomplete;     /* READY after the patience ran out on a container that is not whole */
    enum gsn_source_subject subject;
    /* Who the device says this object is (device, place, name, size, date), so that it need not be
     * copied twice and a broken copy can go on; empty when the device cannot tell two apart. */
    const char *key;
    /* What the device stated and what was read back from it, as a JSON object; empty for none. */
    const char *facts;
};

struct gsn_source_events {
    size_t count;
    struct gsn_source_event *at;
};

void gsn_source_events_free(struct gsn_source_events *events);

GSN_DEFINE_AUTO(gsn_source_events);

/* One "Key=Value" of the source's section in the configuration. */
struct gsn_source_setting {
    const char *key, *value;
};

struct gsn_source_options {
    int64_t settle_ms;   /* two looks must agree over at least this long */
    int64_t patience_ms; /* an unchanged item that is not whole is delivered after this long */
    int delete_there;    /* acknowledged items are deleted on the device */
    /* Whether an item with this key was taken before; NULL: none was. */
    int (*is_known)(void *context, const char *key);
    /* Told of every piece of an item as it was read: the offset behind it, and the code of the
     * read. It is a sign of life, and says whose failure a broken copy is. An answer other than 0
     * breaks the copy off: gsn_source_read() fails with GSN_E_BUSY. NULL: nobody wants to know. A
     * source that is busy otherwise (listing, skipping through an object, waking a silent device)
     * tells item 0 now and then; the answer means nothing there.
     */
    int (*on_read)(void *context, uint64_t item, uint64_t offset, int r);
    void *context;
    size_t setting_count;
    const struct gsn_source_setting *setting; /* keeps */
    /* The facts of the picture of each subject that was taken from this source last, by whichever
     * process; NULL: none was, or it is not known. borrows, while the source is opened. A camera
     * knows by them what still lies on its stage. */
    const char *last_facts[GSN_SUBJECTS];
};

struct gsn_source;

/* Opens an address "kind:rest"; each kind's header says what its rest is. gives: the source.
 *
 * Fails with GSN_E_UNSUPPORTED for another kind, GSN_E_INPUT for a setting or a rest that is wrong,
 * GSN_E_NOTFOUND when the folder or device is away, GSN_E_BUSY when another program holds it (the
 * sentence says which, where that can be found out), GSN_E_IO. */
int gsn_source_open(const char *address, const struct gsn_source_options *options,
                    struct gsn_source **ret_source, struct gsn_error *err);

void gsn_source_free(struct gsn_source *source);

GSN_DEFINE_AUTO(gsn_source);

/* Judges address and settings as open does, without touching a folder or a device. */
int gsn_source_check(const char *address, const struct gsn_source_options *options,
                     struct gsn_error *err);

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

/* The bytes of this READY item are safe: do not offer it again, unless it changes. Where
 * delete_there was asked for, the device deletes its copy now; a device that refuses is told of by
 * the next poll. Fails with GSN_E_NOTFOUND when no such item is READY. */
int gsn_source_acknowledge(struct gsn_source *source, uint64_t item, struct gsn_error *err);

/* The same, but the device keeps its copy whatever delete_there says. */
int gsn_source_keep(struct gsn_source *source, uint64_t item, struct gsn_error *err);

/* Sleeps until the source has a hint that a poll is worth while, timeout_ms have passed, or
 * stop_fd (-1: none) can be read. Hints may be missing or false. */
int gsn_source_wait(struct gsn_source *source, int timeout_ms, int stop_fd, struct gsn_error *err);

/* Takes one picture now, of this subject: it becomes READY at a later poll.
 * Fails with GSN_E_UNSUPPORTED where pictures only come by themselves. */
int gsn_source_capture(struct gsn_source *source, enum gsn_source_subject subject,
                       struct gsn_error *err);

/* borrows: what the source is, as in its address. Valid as long as the source. */
const char *gsn_source_address(const struct gsn_source *source);

/* borrows: which device answers ("04a9:31c0 SN0001", a camera's name), for people and rows; empty
 * for a folder. Valid until the next call. */
const char *gsn_source_device(const struct gsn_source *source);

/* borrows: the kernel's subsystem whose arrivals are worth another try at opening this address
 * ("usb", "video4linux"), NULL for a folder or an unknown kind. */
const char *gsn_source_subsystem(const char *address);

/* One row per kind of source, for those who write one. self is what open gave; the functions obey
 * the contract of their namesakes above, and further:
 *   settings     the keys it understands, NULL at the end; the table refuses others.
 *   check        may be NULL: any rest and value will do.
 *   open         rest is the address behind "kind:".
 *   poll         fills a list the caller made empty, through gsn_source_emit().
 *   acknowledge  must not fail for a lack of memory: the bytes are already safe.
 *   keep         may be NULL, where acknowledging deletes nothing.
 *   wait         may be NULL: the table waits for stop_fd and the time alone.
 *   capture      may be NULL: unsupported.
 *   device       may be NULL: a folder.
 *   close        accepts NULL. */
struct gsn_source_ops {
    const char *kind;
    const char *subsystem;
    const char *const *settings;
    int (*check)(const char *rest, const struct gsn_source_options *options, struct gsn_error *err);
    int (*open)(const char *rest, const struct gsn_source_options *options, void **ret_self,
                struct gsn_error *err);
    int (*poll)(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                struct gsn_error *err);
    int (*read)(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                size_t *ret_got, struct gsn_error *err);
    int (*acknowledge)(void *self, uint64_t item, struct gsn_error *err);
    int (*keep)(void *self, uint64_t item, struct gsn_error *err);
    int (*wait)(void *self, int timeout_ms, int stop_fd, struct gsn_error *err);
    int (*capture)(void *self, enum gsn_source_subject subject, struct gsn_error *err);
    const char *(*device)(const void *self);
    void (*close)(void *self);
};

/* Fails with GSN_E_NOTFOUND: read, acknowledge and keep of an item that is not READY. */
int gsn_source_no_item(uint64_t item, struct gsn_error *err);

/* A source that its maker opened himself (a device behind a bus of the maker's own). address is
 * only told again; takes: self, also on failure. gives: the source. */
int gsn_source_make(const struct gsn_source_ops *ops, void *self, const char *address,
                    const struct gsn_source_options *options, struct gsn_source **ret_source,
                    struct gsn_error *err);

/* Appends a copy of event (its texts are copied too; NULL stands for an empty action, key or facts)
 * to the list. Fails with GSN_E_NOMEM. */
int gsn_source_emit(struct gsn_source_events *events, const struct gsn_source_event *event,
                    struct gsn_error *err);

/* Names of files as people read them: in which order they count, and what they call a picture. */

/* Natural order: runs of digits compare as numbers of any length, the rest as bytes; names that
 * are equal so far (1, 01) fall back to bytes. Returns < 0, 0, > 0; 0 only for equal names. */
int gsn_natural_compare(const char *a, const char *b);

/* Whether a file of this name is called like a picture ("P01.TIF"). */
int gsn_name_is_picture(const char *name);

#ifdef __cplusplus
}
#endif
#endif
