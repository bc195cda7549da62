/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_source_parts.h"

#include <stdio.h>

enum {
    DELETE_AGAIN_MS = 30 * 1000,
    LOOK_TRIES = 3,      /* when it begins anew in the middle */
    RENEW_GAP_MS = 2000, /* a session is not given up for a new one more often */
};

static void name_device(struct gsn_ptp_source *source)
{
    const char *const serial = gsn_ptp_device_serial(source->device);

    (void)snprintf(source->name, sizeof source->name, "%04x:%04x%s%.200s",
                   source->device->transport->vendor, source->device->transport->product,
                   serial[0] ? " " : "", serial);
}

static void sign_of_life(void *context)
{
    const struct gsn_ptp_source *const source = context;
    const struct gsn_source_options *const options = &source->table.options;

    if (options->on_read)
        (void)options->on_read(options->context, 0, 0, GSN_OK);
}

int gsn_ptp_source_connect(struct gsn_ptp_source *source, struct gsn_error *err)
{
    struct gsn_ptp_transport *transport = NULL;
    int r;

    if (source->device)
        return GSN_OK;
    r = source->door.open(source->door.context, &transport, err);
    if (r >= 0)
        r = gsn_ptp_device_new(transport, &source->device, err);
    if (r < 0)
        return r;
    transport->alive = sign_of_life;
    transport->alive_context = source;
    gsn_ptp_session_count_from(source->device->session, source->sessions);
    name_device(source);
    source->looked = false;
    return GSN_OK;
}

void gsn_ptp_source_disconnect(struct gsn_ptp_source *source)
{
    source->sessions = gsn_ptp_session_number(source->device->session);
    gsn_ptp_device_free(source->device);
    source->device = NULL;
}

bool gsn_ptp_source_is_hinted(const struct gsn_ptp_source *source)
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
static int look(struct gsn_ptp_source *source, int64_t now_ms, struct gsn_error *err)
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
    source->next_look_ms = now_ms + GSN_PTP_LOOK_GAP_MS;
    source->busy_told = false;
    return GSN_OK;
}

void gsn_ptp_source_delete(struct gsn_ptp_source *source, struct gsn_ptp_object *object)
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
            gsn_ptp_source_delete(source, object);
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

int gsn_ptp_source_ask(struct gsn_ptp_source *source, int64_t now_ms, struct gsn_error *err)
{
    struct gsn_error why = { 0 };
    int r = take_hints(source, &why);

    if (r >= 0)
        r = renew_session(source, now_ms, &why);
    if (r >= 0 && (!source->looked || now_ms >= source->next_look_ms)) {
        r = look(source, now_ms, &why);
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
