/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_source.h"

#include <errno.h>
#include <poll.h>
#include <stdlib.h>
#include <string.h>

#include "acquire/natural.h"
#include "acquire/ptp_news.h"
#include "acquire/ptp_record.h"
#include "acquire/ptp_source_parts.h"
#include "acquire/usb_transport.h"

static int by_name(const void *a, const void *b)
{
    const struct gsn_source_event *const x = a, *const y = b;
    const int order = gsn_natural_compare(x->name, y->name);

    return order != 0 ? order : x->item < y->item ? -1 : x->item > y->item;
}

static int tell(struct gsn_ptp_source *source, struct gsn_source_events *events,
                struct gsn_error *err)
{
    int r = gsn_ptp_tell_objects(&source->table, source->device, events, err);

    if (r >= 0 && source->busy[0]) {
        const struct gsn_source_event event = { .what = GSN_SOURCE_NOTICE,
                                                .name = source->name,
                                                .reason = source->busy };

        r = gsn_source_tell(events, &event, err);
    }
    if (r < 0)
        return r;
    if (events->count > 1)
        qsort(events->at, events->count, sizeof *events->at, by_name);
    return GSN_OK;
}

/* Only now that every event is in the caller's list: a poll that fails has told nothing. */
static void forget_news(struct gsn_ptp_source *source)
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
    int r = gsn_ptp_source_connect(source, err);

    if (r < 0)
        return r;
    source->now_ms = now_ms;
    r = gsn_ptp_source_ask(source, now_ms, err);
    if (r == GSN_E_NOTFOUND)
        gsn_ptp_source_disconnect(source);
    if (r >= 0)
        r = tell(source, events, err);
    if (r < 0)
        return r;
    forget_news(source);
    *ret_ended = 0;
    return GSN_OK;
}

static int no_item(uint64_t item, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "item %llu is not ready", (unsigned long long)item);
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
        return no_item(item, err);
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

static int finish(struct gsn_ptp_source *source, uint64_t item, bool delete_there,
                  struct gsn_error *err)
{
    struct gsn_ptp_object *const object = gsn_ptp_table_find(&source->table, item);

    if (!object)
        return no_item(item, err);
    object->state = GSN_PTP_TAKEN;
    object->failures = 0;
    object->delete_due = delete_there;
    if (object->delete_due)
        gsn_ptp_source_delete(source, object);
    return GSN_OK;
}

static int ptp_acknowledge(void *self, uint64_t item, struct gsn_error *err)
{
    struct gsn_ptp_source *const source = self;

    return finish(source, item, source->table.options.delete_there != 0, err);
}

static int ptp_keep(void *self, uint64_t item, struct gsn_error *err)
{
    return finish(self, item, false, err);
}

static int ptp_wait(void *self, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    struct gsn_ptp_source *const source = self;
    struct pollfd stop = { .fd = stop_fd, .events = POLLIN };

    /* What was hinted at already waits only until the device may be listed again. */
    if (gsn_ptp_source_is_hinted(source) && (timeout_ms < 0 || timeout_ms > GSN_PTP_LOOK_GAP_MS))
        timeout_ms = GSN_PTP_LOOK_GAP_MS;
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

int gsn_ptp_source_new(const struct gsn_ptp_door *door, const struct gsn_source_options *options,
                       void **ret_self, struct gsn_error *err)
{
    struct gsn_ptp_source *const source = gsn_alloc_array(1, sizeof *source);
    int r;

    if (!source)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PTP source");
    source->door = *door;
    source->table.options = *options;
    r = gsn_ptp_source_connect(source, err);
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
    const struct gsn_ptp_door door = { open_usb, place };
    void *self = NULL;
    int r;

    if (!place)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PTP source");
    r = gsn_ptp_source_new(&door, options, &self, err);
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
