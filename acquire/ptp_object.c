/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_table_parts.h"

#include <stdio.h>
#include <string.h>

#include "acquire/natural.h"

enum { FIRST_RETRY_MS = 30 * 1000, LAST_RETRY_MS = 60 * 60 * 1000 };

static const char unsettled[] = "a second look has yet to find it unchanged";

void gsn_ptp_object_free_texts(struct gsn_ptp_object *object)
{
    gsn_free(object->name);
    gsn_free(object->key);
    object->name = object->key = NULL;
}

void gsn_ptp_object_set_state(struct gsn_ptp_object *object, enum gsn_ptp_state state,
                              const char *reason)
{
    if (object->state != state || strcmp(object->reason, reason) != 0)
        object->told = false;
    object->state = state;
    (void)snprintf(object->reason, sizeof object->reason, "%.190s", reason);
}

void gsn_ptp_object_wait(struct gsn_ptp_object *object, const char *reason)
{
    gsn_ptp_object_set_state(object, GSN_PTP_WAITING, reason);
}

void gsn_ptp_object_set_aside(struct gsn_ptp_object *object, const char *reason, int64_t now_ms)
{
    int64_t delay = FIRST_RETRY_MS;

    for (unsigned i = 0; i < object->failures && delay < LAST_RETRY_MS; i++)
        delay *= 2;
    object->failures++;
    object->retry_ms = now_ms + (delay < LAST_RETRY_MS ? delay : LAST_RETRY_MS);
    gsn_ptp_object_set_state(object, GSN_PTP_WAITING, reason);
}

static bool is_picture(const struct gsn_ptp_object *object)
{
    if (object->format >= GSN_PTP_FORMAT_FIRST_IMAGE && object->format <= GSN_PTP_FORMAT_LAST_IMAGE)
        return true;
    /* Many responders call everything undefined; 0xB000 and above are a vendor's own. */
    return (object->format == GSN_PTP_FORMAT_UNDEFINED || object->format >= 0xB000) &&
           gsn_name_is_picture(object->name);
}

static bool is_as_before(const struct gsn_ptp_object *object,
                         const struct gsn_ptp_object_info *info, uint64_t size)
{
    return object->name && object->storage == info->storage && object->parent == info->parent &&
           object->format == info->format && object->size == size &&
           strcmp(object->name, info->name) == 0 && strcmp(object->captured, info->captured) == 0 &&
           strcmp(object->modified, info->modified) == 0;
}

/* A name that is there, and without what would make it a path. */
static void tidy(char *name, size_t room)
{
    if (!name[0])
        (void)snprintf(name, room, "unnamed");
    for (; *name; name++) {
        if (*name == '/')
            *name = '_';
    }
}

/* Takes over what the device says it is now; its key is made when all folders are known. On
 * failure it is what it was. */
static int redescribe(struct gsn_ptp_object *object, const struct gsn_ptp_object_info *info,
                      uint64_t size, struct gsn_error *err)
{
    char *const name = gsn_strdup(info->name);

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an object");
    object->fresh = object->fresh || !object->name;
    gsn_ptp_object_free_texts(object);
    object->name = name;
    object->storage = info->storage;
    object->parent = info->parent;
    object->format = info->format;
    object->size = size;
    memcpy(object->captured, info->captured, sizeof object->captured);
    memcpy(object->modified, info->modified, sizeof object->modified);
    return GSN_OK;
}

static bool is_known(const struct gsn_ptp_table *table, const struct gsn_ptp_object *object)
{
    return table->options.is_known && object->key && object->key[0] &&
           table->options.is_known(table->options.context, object->key);
}

/* It is another than at the last look. */
static void start_waiting(struct gsn_ptp_table *table, struct gsn_ptp_object *object,
                          int64_t now_ms)
{
    /* Another content under a known handle is another item. */
    if (object->state == GSN_PTP_TAKEN)
        object->item = ++table->last_item;
    object->since_ms = now_ms;
    object->failures = 0;
    object->retry_ms = now_ms;
    object->delete_due = object->doubtful = false;
    object->doubts = 0;
    if (object->format == GSN_PTP_FORMAT_ASSOCIATION)
        gsn_ptp_object_set_state(object, GSN_PTP_FOLDER, "");
    else if (!is_picture(object))
        gsn_ptp_object_set_state(object, GSN_PTP_LEFT, "is no picture and is left alone");
    else
        gsn_ptp_object_set_state(object, GSN_PTP_WAITING, unsettled);
}

/* It is as it was: has it been so for long enough? */
static void settle(struct gsn_ptp_table *table, struct gsn_ptp_object *object, int64_t now_ms)
{
    if (object->state != GSN_PTP_WAITING || !object->key ||
        now_ms - object->since_ms < table->options.settle_ms || now_ms < object->retry_ms)
        return;
    if (object->size == 0)
        gsn_ptp_object_set_state(object, GSN_PTP_WAITING, "is empty as yet");
    else if (object->size == UINT64_MAX)
        gsn_ptp_object_set_state(object, GSN_PTP_WAITING,
                                 "is larger than 4 GiB, and the device does not tell how large");
    else if (is_known(table, object))
        gsn_ptp_object_set_state(object, GSN_PTP_TAKEN, "");
    else
        gsn_ptp_object_set_state(object, GSN_PTP_READY, "");
}

int gsn_ptp_object_describe(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
                            struct gsn_ptp_object *object, int64_t now_ms, struct gsn_error *err)
{
    struct gsn_ptp_object_info info;
    struct gsn_error why = { 0 };
    uint16_t code = 0;
    uint64_t size = 0;
    int r = gsn_ptp_device_describe(device, object->handle, &info, &size, &code, &why);

    if (r == GSN_E_INPUT) {
        /* Listed and yet not there: the next listing will know. */
        if (code != GSN_PTP_INVALID_OBJECT_HANDLE)
            gsn_ptp_object_set_aside(object, why.text, now_ms);
        return GSN_OK;
    }
    if (r == GSN_E_IO && !object->name) {
        gsn_ptp_object_set_aside(object, why.text, now_ms);
        table->has_silent = true;
    }
    if (r < 0)
        return gsn_fail(err, r, "%s", why.text);
    object->check = false;
    tidy(info.name, sizeof info.name);
    if (is_as_before(object, &info, size)) {
        settle(table, object, now_ms);
        return GSN_OK;
    }
    r = redescribe(object, &info, size, err);
    if (r >= 0)
        start_waiting(table, object, now_ms);
    return r;
}

int gsn_ptp_table_confirm(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
                          struct gsn_ptp_object *object, int64_t now_ms, struct gsn_error *err)
{
    struct gsn_ptp_object_info info;
    uint16_t code = 0;
    uint64_t size = 0;
    int r = gsn_ptp_device_describe(device, object->handle, &info, &size, &code, err);

    if (r == GSN_E_INPUT)
        return gsn_fail(err, GSN_E_NOTFOUND, "%s is no longer on the device", object->name);
    if (r < 0)
        return r;
    tidy(info.name, sizeof info.name);
    if (is_as_before(object, &info, size))
        return GSN_OK;
    /* The next look describes it as it is now; what was taken stays so, and this is another. */
    if (object->state == GSN_PTP_TAKEN)
        object->item = ++table->last_item;
    object->since_ms = now_ms;
    gsn_ptp_object_set_state(object, GSN_PTP_WAITING, "changed while it was read");
    return gsn_fail(err, GSN_E_BUSY, "%s changed while it was read", object->name);
}

bool gsn_ptp_object_is_due(const struct gsn_ptp_object *object, int64_t now_ms)
{
    switch (object->state) {
    case GSN_PTP_NEW:
    case GSN_PTP_WAITING:
        return object->failures == 0 || now_ms >= object->retry_ms;
    case GSN_PTP_READY:
        return true;
    case GSN_PTP_TAKEN:
    case GSN_PTP_LEFT:
        return object->check;
    default:
        return false;
    }
}

/* gives: the text as a JSON string without its quotes. Control characters do not occur. */
static char *quote(const char *text)
{
    char *const quoted = gsn_alloc(2 * strlen(text) + 1);
    size_t n = 0;

    for (; quoted && *text; text++) {
        if (*text == '"' || *text == '\\')
            quoted[n++] = '\\';
        quoted[n++] = (unsigned char)*text < 0x20 ? ' ' : *text;
    }
    if (quoted)
        quoted[n] = '\0';
    return quoted;
}

char *gsn_ptp_object_facts(const struct gsn_ptp_object *object, const struct gsn_ptp_device *device)
{
    gsn_auto_mem(char) maker = quote(device->info.maker);
    gsn_auto_mem(char) model = quote(device->info.model);
    gsn_auto_mem(char) serial = quote(gsn_ptp_device_serial(device));
    gsn_auto_mem(char) name = quote(object->name);
    gsn_auto_mem(char) captured = quote(object->captured);

    if (!maker || !model || !serial || !name || !captured)
        return NULL;
    return gsn_format("{\"vendor\":\"%04x\",\"product\":\"%04x\",\"maker\":\"%s\",\"model\":\"%s\","
                      "\"serial\":\"%s\",\"storage\":\"0x%08lx\",\"handle\":\"0x%08lx\","
                      "\"name\":\"%s\",\"format\":\"0x%04x\",\"size\":%llu,\"captured\":\"%s\"}",
                      device->transport->vendor, device->transport->product, maker, model, serial,
                      (unsigned long)object->storage, (unsigned long)object->handle, name,
                      object->format, (unsigned long long)object->size, captured);
}
