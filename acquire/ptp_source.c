/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A scanner or camera that speaks PTP, as a source: the device is followed, its objects are
 * emitted.
 *
 * Steps of a poll.
 * 1. Connect, where the device is away. Its handles mean something within one session alone.
 * 2. Take in events as hints; renew the session where the table of objects doubts what it was told.
 * 3. List the device, at most every 250 ms; one that falls back into a new session meanwhile is
 * listed again, three times at most. What was taken and is due is deleted there, once each.
 * 4. Emit what is pending, in natural order of names.
 * Reading checks after the last piece that the object is still what it was.
 *
 * How it fails: GSN_E_NOTFOUND when the device went (the next poll looks for it again), GSN_E_IO
 * for a read that can go on later; a busy device is no failure and is said once. */
#include "acquire/ptp_source.h"

#include <errno.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "acquire/ptp_objects.h"
#include "acquire/ptp_transport.h"
#include "acquire/source.h"
#include "acquire/usb_transport.h"

struct gsn_ptp_source {
    struct gsn_ptp_opener opener;
    void *place;                   /* the opener's context, where this source made it */
    struct gsn_ptp_device *device; /* NULL while it is away */
    struct gsn_ptp_table table;
    struct gsn_ptp_hints hints;
    unsigned sessions; /* of devices that went */
    int64_t now_ms;    /* of the last poll */
    int64_t next_look_ms, next_renewal_ms;
    bool looked, busy_told;
    char busy[200]; /* to be told once */
    char name[300];
};

enum {
    LOOK_GAP_MS = 250, /* a device is not listed more often */
    DELETE_AGAIN_MS = 30 * 1000,
    LOOK_TRIES = 3,      /* when it begins anew in the middle */
    RENEW_GAP_MS = 2000, /* a session is not given up for a new one more often */
};

/* The device. */

static void name_device(struct gsn_ptp_source *source)
{
    const char *const serial = gsn_ptp_device_serial(source->device);

    (void)snprintf(source->name, sizeof source->name, "%04x:%04x%s%.200s",
                   source->device->transport->vendor, source->device->transport->product,
                   serial[0] ? " " : "", serial);
}

static void report_alive(void *context)
{
    const struct gsn_ptp_source *const source = context;
    const struct gsn_source_options *const options = &source->table.options;

    if (options->on_read)
        (void)options->on_read(options->context, 0, 0, GSN_OK);
}

/* Finds the device where it is away. Fails as the opener and gsn_ptp_device_new() do. */
static int connect_device(struct gsn_ptp_source *source, struct gsn_error *err)
{
    struct gsn_ptp_transport *transport = NULL;
    int r;

    if (source->device)
        return GSN_OK;
    r = source->opener.open(source->opener.context, &transport, err);
    if (r >= 0)
        r = gsn_ptp_device_new(transport, &source->device, err);
    if (r < 0)
        return r;
    transport->alive = report_alive;
    transport->alive_context = source;
    gsn_ptp_session_count_from(source->device->session, source->sessions);
    name_device(source);
    source->looked = false;
    return GSN_OK;
}

/* The device went; its handles mean nothing to the next one. */
static void disconnect_device(struct gsn_ptp_source *source)
{
    source->sessions = gsn_ptp_session_number(source->device->session);
    gsn_ptp_device_free(source->device);
    source->device = NULL;
}

/* Whether the device said that a look is worth while. */
static bool is_hinted(const struct gsn_ptp_source *source)
{
    return source->hints.any || source->hints.all_changed || source->hints.changed_count > 0;
}

static void add_hints(struct gsn_ptp_hints *to, const struct gsn_ptp_hints *more)
{
    const size_t room = sizeof to->changed / sizeof to->changed[0];

    to->any |= more->any;
    to->all_changed |= more->all_changed;
    for (size_t i = 0; i < more->changed_count; i++) {
        if (to->changed_count == room)
            to->all_changed = 1;
        else
            to->changed[to->changed_count++] = more->changed[i];
    }
}

static int take_hints(struct gsn_ptp_source *source, struct gsn_error *err)
{
    struct gsn_ptp_hints hints = { 0 };
    const int r = gsn_ptp_session_hints(source->device->session, &hints, err);

    if (r >= 0)
        add_hints(&source->hints, &hints);
    return r;
}

/* A device that falls back into a new session while it is listed is listed again. */
static int list_device(struct gsn_ptp_source *source, int64_t now_ms, struct gsn_error *err)
{
    int r = gsn_ptp_device_greet(source->device, err);

    for (int tries = 0; r >= 0 && tries < LOOK_TRIES; tries++) {
        const unsigned session = gsn_ptp_session_number(source->device->session);

        r = gsn_ptp_table_look(&source->table, source->device, &source->hints, now_ms, err);
        if (r != GSN_E_IO || session == gsn_ptp_session_number(source->device->session))
            break;
        r = tries + 1 < LOOK_TRIES ? GSN_OK : r;
    }
    if (r < 0)
        return r;
    name_device(source);
    source->hints = (struct gsn_ptp_hints){ 0 };
    source->looked = true;
    source->next_look_ms = now_ms + LOOK_GAP_MS;
    source->busy_told = false;
    return GSN_OK;
}

/* Deletes what was taken and is still due, once each: it must be the object that was taken. */
static void delete_object(struct gsn_ptp_source *source, struct gsn_ptp_object *object)
{
    struct gsn_error why = { 0 };
    uint16_t code = 0;
    int r;

    if (!source->device || object->session != gsn_ptp_session_number(source->device->session))
        return;
    r = gsn_ptp_table_confirm(&source->table, source->device, object, source->now_ms, &why);
    if (r >= 0)
        r = gsn_ptp_device_delete(source->device, object->handle, &code, &why);
    /* Trouble with the bus leaves it for a later look; what changed is not deleted at all. */
    object->retry_ms = source->now_ms + DELETE_AGAIN_MS;
    if (r < 0 && r != GSN_E_INPUT && object->state == GSN_PTP_TAKEN)
        return;
    object->delete_due = false;
    if (r == GSN_E_INPUT && code != GSN_PTP_INVALID_OBJECT_HANDLE)
        (void)snprintf(object->notice, sizeof object->notice,
                       "was taken, but %.150s; delete it there by hand", why.text);
}

static void delete_all_due(struct gsn_ptp_source *source)
{
    for (size_t i = 0; i < source->table.count; i++) {
        struct gsn_ptp_object *const object = &source->table.at[i];

        if (object->delete_due && object->state == GSN_PTP_TAKEN &&
            source->now_ms >= object->retry_ms)
            delete_object(source, object);
    }
}

/* A device that stays busy is no failure: it is said once, and what was known stands. */
static void note_busy(struct gsn_ptp_source *source, const struct gsn_error *why)
{
    if (!source->busy_told)
        (void)snprintf(source->busy, sizeof source->busy, "%.190s", why->text);
    source->busy_told = true;
}

/* What was read to its end and is still not acknowledged was not whole, and what stays empty may
 * not be so: in a new session, a device that measured it too early measures it again. */
static int renew_session(struct gsn_ptp_source *source, int64_t now_ms, struct gsn_error *err)
{
    if (now_ms < source->next_renewal_ms || !gsn_ptp_table_doubt(&source->table, now_ms))
        return GSN_OK;
    gsn_ptp_session_close(source->device->session);
    source->next_renewal_ms = now_ms + RENEW_GAP_MS;
    source->hints = (struct gsn_ptp_hints){ 0 }; /* of handles that are no more */
    source->looked = false;
    return gsn_ptp_session_open(source->device->session, err);
}

/* What the device has to say, as far as it is time to ask; what is due there is deleted. One that
 * stays busy is no failure. Fails with GSN_E_NOTFOUND when it went, GSN_E_IO, GSN_E_NOMEM. */
static int ask_device(struct gsn_ptp_source *source, int64_t now_ms, struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    int r = take_hints(source, &why);

    if (r >= 0)
        r = renew_session(source, now_ms, &why);
    if (r >= 0 && (!source->looked || now_ms >= source->next_look_ms)) {
        r = list_device(source, now_ms, &why);
        if (r >= 0)
            delete_all_due(source);
    }
    if (r == GSN_E_BUSY) {
        note_busy(source, &why);
        return GSN_OK;
    }
    if (r == GSN_E_INPUT)
        r = GSN_E_IO;
    return r < 0 ? gsn_fail(err, r, "%s", why.text) : GSN_OK;
}

/* The source. */

static int by_name(const void *a, const void *b)
{
    const struct gsn_source_event *const x = a, *const y = b;
    const int order = gsn_natural_compare(x->name, y->name);

    return order != 0 ? order : x->item < y->item ? -1 : x->item > y->item;
}

static int emit_events(struct gsn_ptp_source *source, struct gsn_source_events *events,
                       struct gsn_error *err)
{
    int r = gsn_ptp_table_emit(&source->table, source->device, events, err);

    if (r >= 0 && source->busy[0]) {
        const struct gsn_source_event event = { .what = GSN_SOURCE_NOTICE,
                                                .name = source->name,
                                                .reason = source->busy };

        r = gsn_source_emit(events, &event, err);
    }
    if (r < 0)
        return r;
    if (events->count > 1)
        qsort(events->at, events->count, sizeof *events->at, by_name);
    return GSN_OK;
}

/* Only now that every event is in the caller's list: a poll that fails has told nothing. */
static void forget_pending_events(struct gsn_ptp_source *source)
{
    for (size_t i = 0; i < source->table.count; i++) {
        source->table.at[i].told = true;
        source->table.at[i].notice[0] = '\0';
    }
    gsn_ptp_table_sweep(&source->table);
    source->busy[0] = '\0';
}

static int ptp_poll(void *self, int64_t now_ms, struct gsn_source_events *events, int *ret_ended,
                    struct gsn_error *err)
{
    struct gsn_ptp_source *const source = self;
    int r = connect_device(source, err);

    if (r < 0)
        return r;
    source->now_ms = now_ms;
    r = ask_device(source, now_ms, err);
    if (r == GSN_E_NOTFOUND)
        disconnect_device(source);
    if (r >= 0)
        r = emit_events(source, events, err);
    if (r < 0)
        return r;
    forget_pending_events(source);
    *ret_ended = 0;
    return GSN_OK;
}

/* A piece of it, and after the last piece the question whether it is still the same. A device that
 * began anew meanwhile may have given the handle to another object. */
static int read_piece(struct gsn_ptp_source *source, struct gsn_ptp_object *object, uint64_t offset,
                      void *buffer, size_t size, size_t *ret_got, uint16_t *ret_code,
                      struct gsn_error *err)
{
    struct gsn_ptp_device *const device = source->device;
    size_t got = 0;
    int r = gsn_ptp_device_read(device, object->handle, object->size, offset, buffer, size, &got,
                                ret_code, err);
    const unsigned session = gsn_ptp_session_number(device->session);

    if (r >= 0 && (offset + got == object->size || session != object->session))
        r = gsn_ptp_table_confirm(&source->table, device, object, source->now_ms, err);
    if (r < 0)
        return r;
    object->doubtful = offset + got == object->size;
    *ret_got = got;
    return GSN_OK;
}

/* What a failed read means for the object and for the caller. */
static int judge_failure(struct gsn_ptp_source *source, struct gsn_ptp_object *object, int r,
                         uint16_t code, const struct gsn_error *why, struct gsn_error *err)
{
    switch (r) {
    case GSN_E_NOTFOUND: /* the device, or the object: the next poll will tell */
        return gsn_fail(err, GSN_E_IO, "%.100s: %.300s", object->name, why->text);
    case GSN_E_INPUT:
        if (code == GSN_PTP_INVALID_OBJECT_HANDLE) {
            source->looked = false;
            return gsn_fail(err, GSN_E_NOTFOUND, "%.100s is no longer on the device", object->name);
        }
        break;
    case GSN_E_BUSY:
        gsn_ptp_object_wait(object, why->text);
        return gsn_fail(err, GSN_E_BUSY, "%.100s: %.300s", object->name, why->text);
    case GSN_E_NOMEM:
        return gsn_fail(err, r, "%s", why->text);
    default:
        break;
    }
    gsn_ptp_object_set_aside(object, why->text, source->now_ms);
    return gsn_fail(err, GSN_E_IO, "%.100s: %.300s", object->name, why->text);
}

static int ptp_read(void *self, uint64_t item, uint64_t offset, void *buffer, size_t size,
                    size_t *ret_got, struct gsn_error *err)
{
    struct gsn_ptp_source *const source = self;
    struct gsn_ptp_object *const object = gsn_ptp_table_find(&source->table, item);
    struct gsn_error why = { 0 };
    uint16_t code = 0;
    size_t got = 0;
    int r;

    if (!object)
        return gsn_source_no_item(item, err);
    if (!source->device)
        return gsn_fail(err, GSN_E_IO, "%.100s: the device is away", object->name);
    if (offset >= object->size || size == 0) {
        *ret_got = 0;
        return GSN_OK;
    }
    r = read_piece(source, object, offset, buffer, size, &got, &code, &why);
    if (r < 0)
        return judge_failure(source, object, r, code, &why, err);
    *ret_got = got;
    return GSN_OK;
}

static int finish_item(struct gsn_ptp_source *source, uint64_t item, bool delete_there,
                       struct gsn_error *err)
{
    struct gsn_ptp_object *const object = gsn_ptp_table_find(&source->table, item);

    if (!object)
        return gsn_source_no_item(item, err);
    object->state = GSN_PTP_TAKEN;
    object->failures = 0;
    object->delete_due = delete_there;
    if (object->delete_due)
        delete_object(source, object);
    return GSN_OK;
}

static int ptp_acknowledge(void *self, uint64_t item, struct gsn_error *err)
{
    struct gsn_ptp_source *const source = self;

    return finish_item(source, item, source->table.options.delete_there != 0, err);
}

static int ptp_keep(void *self, uint64_t item, struct gsn_error *err)
{
    return finish_item(self, item, false, err);
}

static int ptp_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    struct gsn_ptp_source *const source = self;
    struct pollfd stop = { .fd = stop_fd, .events = POLLIN };

    /* What was hinted at already waits only until the device may be listed again. */
    if (is_hinted(source) && (timeout_ms < 0 || timeout_ms > LOOK_GAP_MS))
        timeout_ms = LOOK_GAP_MS;
    if (source->device)
        return source->device->transport->ops->wait(source->device->transport->self, timeout_ms,
                                                    stop_fd, err);
    if (poll(&stop, 1, timeout_ms) < 0 && errno != EINTR)
        return gsn_fail(err, GSN_E_IO, "waiting: %s", strerror(errno));
    return GSN_OK;
}

static const char *ptp_device(const void *self)
{
    return ((const struct gsn_ptp_source *)self)->name;
}

static void ptp_close(void *self)
{
    struct gsn_ptp_source *const source = self;

    if (!source)
        return;
    gsn_ptp_device_free(source->device);
    gsn_ptp_table_done(&source->table);
    gsn_free(source->place);
    gsn_free(source);
}

int gsn_ptp_source_new(const struct gsn_ptp_opener *opener,
                       const struct gsn_source_options *options, void **ret_self,
                       struct gsn_error *err)
{
    struct gsn_ptp_source *const source = gsn_alloc_array(1, sizeof *source);
    int r;

    if (!source)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PTP source");
    source->opener = *opener;
    source->table.options = *options;
    r = connect_device(source, err);
    if (r < 0) {
        ptp_close(source);
        return r;
    }
    *ret_self = source;
    return GSN_OK;
}

/* Where libusb finds the device, and what is to be written down of the talk with it. */
struct usb_place {
    const char *record; /* of the settings; NULL: nothing */
    char rest[];
};

static int open_usb(void *context, struct gsn_ptp_transport **ret_transport, struct gsn_error *err)
{
    const struct usb_place *const place = context;
    struct gsn_ptp_transport *transport = NULL;
    int r = gsn_ptp_usb_open(place->rest, &transport, err);

    if (r >= 0 && place->record)
        r = gsn_ptp_record(transport, place->record, &transport, err);
    if (r >= 0)
        *ret_transport = transport;
    return r;
}

/* gives. */
static struct usb_place *make_place(const char *rest, const struct gsn_source_options *options)
{
    const size_t size = strlen(rest) + 1;
    struct usb_place *const place = gsn_alloc(sizeof *place + size);

    if (!place)
        return NULL;
    memcpy(place->rest, rest, size);
    place->record = NULL;
    for (size_t i = 0; i < options->setting_count; i++) /* Record is the only one there is */
        place->record = options->setting[i].value;
    return place;
}

static int ptp_open(const char *rest, const struct gsn_source_options *options, void **ret_self,
                    struct gsn_error *err)
{
    gsn_auto_mem(struct usb_place) place = make_place(rest, options);
    const struct gsn_ptp_opener opener = { open_usb, place };
    void *self = NULL;
    int r;

    if (!place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PTP source");
    r = gsn_ptp_source_new(&opener, options, &self, err);
    if (r < 0)
        return r;
    ((struct gsn_ptp_source *)self)->place = gsn_steal(&place);
    *ret_self = self;
    return GSN_OK;
}

static int ptp_check(const char *rest, const struct gsn_source_options *options,
                     struct gsn_error *err)
{
    for (size_t i = 0; i < options->setting_count; i++)
        if (options->setting[i].value[0] != '/')
            return gsn_fail(err, GSN_E_INPUT, "Record=%.200s: give the whole path of a file",
                            options->setting[i].value);
    return gsn_ptp_usb_check(rest, err);
}

static const char *const ptp_settings[] = { "Record", NULL };

const struct gsn_source_ops gsn_ptp_source_ops = {
    .kind = "ptp",
    .subsystem = "usb",
    .settings = ptp_settings,
    .check = ptp_check,
    .open = ptp_open,
    .poll = ptp_poll,
    .read = ptp_read,
    .acknowledge = ptp_acknowledge,
    .keep = ptp_keep,
    .wait = ptp_wait,
    .device = ptp_device,
    .close = ptp_close,
};
