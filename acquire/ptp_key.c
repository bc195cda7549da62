/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_table_parts.h"

#include <string.h>

enum { MOST_DEPTH = 16 }; /* of folders in a path */

/* A date that a clock which was never set would not show; such a clock names pictures alike, and
 * stands at the first second of some day of its maker's. */
static bool is_trusted_date(const char *date)
{
    size_t digits = 0;

    while (digits < 8 && date[digits] >= '0' && date[digits] <= '9')
        digits++;
    return digits == 8 && strlen(date) >= 15 && date[8] == 'T' && strncmp(date, "2001", 4) >= 0 &&
           strncmp(date + 9, "000000", 6) != 0;
}

/* gives: "100SCANS/P01.TIF"; names alone where the folders are not known. */
static char *make_path(struct gsn_ptp_table *table, const struct gsn_ptp_object *object)
{
    char *path = gsn_strdup(object->name);
    uint32_t parent = object->parent;

    for (int depth = 0; path && parent != 0 && depth < MOST_DEPTH; depth++) {
        const struct gsn_ptp_object *const folder =
            gsn_ptp_table_handle(table, object->session, parent);
        char *longer;

        if (!folder || !folder->name)
            break;
        longer = gsn_format("%s/%s", folder->name, path);
        gsn_free(path);
        path = longer;
        parent = folder->parent;
    }
    return path;
}

/* gives: who it is, or an empty text where the device cannot tell two objects apart. */
static char *make_key(struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
                      const struct gsn_ptp_object *object)
{
    const char *const serial = gsn_ptp_device_serial(device);
    gsn_auto_mem(char) path = NULL;

    if (!serial[0] || !is_trusted_date(object->captured))
        return gsn_strdup("");
    path = make_path(table, object);
    if (!path)
        return NULL;
    return gsn_format("ptp %04x:%04x %s/%08lx/%s/%llu/%s", device->transport->vendor,
                      device->transport->product, serial, (unsigned long)object->storage, path,
                      (unsigned long long)object->size, object->captured);
}

/* The old one was doubted, and this is what it is by now. */
static bool is_measured_anew(const struct gsn_ptp_object *old, const struct gsn_ptp_object *object)
{
    return old->doubtful && old->storage == object->storage && old->size != object->size &&
           strcmp(old->name, object->name) == 0;
}

/* The same object in an earlier session, which this one then stands for. A bad one without a key
 * is at least not tried again at once. */
static void meet_again(struct gsn_ptp_table *table, struct gsn_ptp_object *object)
{
    for (size_t i = 0; i < table->count && table->at[i].session < object->session; i++) {
        struct gsn_ptp_object *const old = &table->at[i];

        if (!old->name || old->gone)
            continue;
        if (object->key[0] && old->key && strcmp(old->key, object->key) == 0) {
            object->item = old->item;
            object->told = old->told;
            object->state = old->state;
            object->since_ms = old->since_ms;
            object->doubts = old->doubts;
            object->delete_due = old->delete_due;
            memcpy(object->reason, old->reason, sizeof object->reason);
            /* The old entry stands for nobody now, and nobody is told. */
            old->state = GSN_PTP_NEW;
            old->gone = true;
        } else if (is_measured_anew(old, object)) {
            old->state = GSN_PTP_NEW;
            old->gone = true;
            continue;
        } else if (old->failures == 0 || old->size != object->size ||
                   strcmp(old->name, object->name) != 0) {
            continue;
        }
        object->failures = old->failures;
        object->retry_ms = old->retry_ms;
        return;
    }
}

/* Two objects that look the same to us are not told apart by keys. */
static void drop_twins(struct gsn_ptp_table *table, struct gsn_ptp_object *object)
{
    for (size_t i = 0; object->key[0] && i < table->count; i++) {
        struct gsn_ptp_object *const other = &table->at[i];

        if (other != object && other->session == object->session && other->key &&
            other->size == object->size && strcmp(other->key, object->key) == 0)
            other->key[0] = object->key[0] = '\0';
    }
}

int gsn_ptp_table_make_keys(struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
                            struct gsn_error *err)
{
    for (size_t i = 0; i < table->count; i++) {
        struct gsn_ptp_object *const object = &table->at[i];

        if (!object->name || object->key)
            continue;
        object->key = make_key(table, device, object);
        if (!object->key)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for an object");
        drop_twins(table, object);
        if (object->fresh)
            meet_again(table, object);
        object->fresh = false;
    }
    return GSN_OK;
}
