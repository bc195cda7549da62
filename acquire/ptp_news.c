/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_news.h"

#include <stdio.h>

static bool has_news(const struct gsn_ptp_object *object, struct gsn_source_event *ret_event)
{
    *ret_event = (struct gsn_source_event){ .item = object->item, .reason = object->reason };
    if (object->gone) {
        ret_event->what = GSN_SOURCE_GONE;
        ret_event->reason = "vanished before it was taken";
        return object->state == GSN_PTP_WAITING || object->state == GSN_PTP_READY;
    }
    switch (object->state) {
    case GSN_PTP_READY:
        ret_event->what = GSN_SOURCE_READY;
        ret_event->size = object->size;
        ret_event->key = object->key;
        return true;
    case GSN_PTP_WAITING:
        ret_event->what = GSN_SOURCE_WAITING;
        return !object->told;
    case GSN_PTP_LEFT:
    case GSN_PTP_FOLDER:
        ret_event->what = GSN_SOURCE_NOTICE;
        ret_event->item = 0;
        return !object->told && object->reason[0];
    default:
        return false;
    }
}

static int tell_event(const struct gsn_ptp_object *object, const struct gsn_ptp_device *device,
                      struct gsn_source_event *event, struct gsn_source_events *events,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) facts = NULL;
    char handle[32];

    (void)snprintf(handle, sizeof handle, "object %08lX", (unsigned long)object->handle);
    event->name = object->name ? object->name : handle;
    if (event->what == GSN_SOURCE_READY && device) {
        facts = gsn_ptp_object_facts(object, device);
        if (!facts)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for an event");
    }
    event->facts = facts;
    return gsn_source_tell(events, event, err);
}

static int tell_object(const struct gsn_ptp_object *object, const struct gsn_ptp_device *device,
                       struct gsn_source_events *events, struct gsn_error *err)
{
    struct gsn_source_event event;
    int r = GSN_OK;

    if (has_news(object, &event))
        r = tell_event(object, device, &event, events, err);
    if (r >= 0 && object->notice[0]) {
        event = (struct gsn_source_event){ .what = GSN_SOURCE_NOTICE, .reason = object->notice };
        r = tell_event(object, device, &event, events, err);
    }
    return r;
}

int gsn_ptp_tell_objects(const struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
                         struct gsn_source_events *events, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < table->count; i++)
        r = tell_object(&table->at[i], device, events, err);
    return r;
}
