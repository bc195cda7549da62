/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_table_parts.h"

#include <stdlib.h>
#include <string.h>

enum {
    CHECKS_A_LOOK = 32,  /* taken objects that are described again at each listing */
    MOST_FOLDERS = 4096, /* walked in one listing; too_many_folders says the number */
};

static const char too_many_folders[] = "is a folder that is not looked into, for the device has "
                                       "more than 4096 of them: empty or delete "
                                       "old folders there";

/* An object that silenced the device when it was described is known by its handle alone; after the
 * reset it stays set aside. */
static void inherit_silence(const struct gsn_ptp_table *table, struct gsn_ptp_object *object)
{
    for (size_t i = 0; table->has_silent && i < table->count; i++) {
        const struct gsn_ptp_object *const old = &table->at[i];

        if (old->session == object->session || old->handle != object->handle || old->name ||
            old->failures <= object->failures)
            continue;
        object->state = GSN_PTP_WAITING;
        object->failures = old->failures;
        object->retry_ms = old->retry_ms;
        memcpy(object->reason, old->reason, sizeof object->reason);
        object->told = old->told;
    }
}

/* What is right in a folder that is not listed is not gone because of that; but why it is not is
 * told. */
static void leave_folder(struct gsn_ptp_table *table, unsigned session, uint32_t folder,
                         const char *reason)
{
    for (size_t i = 0; i < table->count; i++) {
        struct gsn_ptp_object *const object = &table->at[i];

        if (object->session == session && object->parent == folder)
            object->last_look = table->looks;
        if (object->session == session && object->handle == folder)
            gsn_ptp_object_set_state(object, GSN_PTP_FOLDER, reason);
    }
}

/* The handle was listed. ret_seen: it was so in this listing already. */
static int see(struct gsn_ptp_table *table, unsigned session, uint32_t handle, bool *ret_seen,
               struct gsn_error *err)
{
    bool found;
    const size_t place = gsn_ptp_table_place(table, session, handle, &found);

    if (!found && table->count == table->room) {
        const size_t room = table->room ? 2 * table->room : 16;
        struct gsn_ptp_object *at = gsn_realloc_array(table->at, room, sizeof *at);

        if (!at)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu objects", room);
        table->at = at;
        table->room = room;
    }
    if (!found) {
        memmove(&table->at[place + 1], &table->at[place],
                (table->count - place) * sizeof *table->at);
        table->count++;
        table->at[place] = (struct gsn_ptp_object){
            .handle = handle, .session = session, .item = ++table->last_item, .told = true
        };
        inherit_silence(table, &table->at[place]);
    }
    *ret_seen = found && table->at[place].last_look == table->looks;
    table->at[place].last_look = table->looks;
    table->at[place].gone = false;
    return GSN_OK;
}

static void mark_checks(struct gsn_ptp_table *table, unsigned session,
                        const struct gsn_ptp_hints *hints)
{
    for (size_t i = 0; i < hints->changed_count; i++) {
        struct gsn_ptp_object *const object =
            gsn_ptp_table_handle(table, session, hints->changed[i]);

        if (object)
            object->check = true;
    }
    for (size_t i = 0; hints->all_changed && i < table->count; i++)
        table->at[i].check = true;
    /* No event is to be relied on: in turn, everybody is looked at again. */
    for (size_t i = 0; i < CHECKS_A_LOOK && i < table->count; i++) {
        table->next_check = (table->next_check + 1) % table->count;
        table->at[table->next_check].check = true;
    }
}

static int by_number(const void *a, const void *b)
{
    const uint32_t x = *(const uint32_t *)a, y = *(const uint32_t *)b;

    return x < y ? -1 : x > y;
}

/* Lists a folder and keeps the handles that were not met before in this look. */
static int see_all(struct gsn_ptp_table *table, struct gsn_ptp_device *device, uint32_t storage,
                   uint32_t folder, struct gsn_ptp_handles *new_handles, struct gsn_error *err)
{
    struct gsn_ptp_handles handles = { 0 };
    struct gsn_ptp_object *self;
    gsn_auto_mem(uint32_t) owned = NULL;
    uint16_t code = 0;
    int r = gsn_ptp_device_list(device, storage, folder, &handles, &code, err);
    size_t kept = 0;

    owned = handles.at;
    /* A folder that cannot be listed does not keep the others from it. */
    if (r == GSN_E_INPUT && folder != 0) {
        leave_folder(table, gsn_ptp_session_number(device->session), folder,
                     "is a folder that the device does not list; it is asked again by itself");
        return GSN_OK;
    }
    self = gsn_ptp_table_handle(table, gsn_ptp_session_number(device->session), folder);
    if (r >= 0 && self)
        gsn_ptp_object_set_state(self, GSN_PTP_FOLDER, "");
    /* In order, each is put behind the last one. */
    if (r >= 0 && handles.count > 1)
        qsort(handles.at, handles.count, sizeof *handles.at, by_number);
    for (size_t i = 0; r >= 0 && i < handles.count; i++) {
        bool seen = false;

        r = see(table, gsn_ptp_session_number(device->session), handles.at[i], &seen, err);
        if (r >= 0 && !seen)
            handles.at[kept++] = handles.at[i];
    }
    if (r < 0)
        return r;
    handles.count = kept;
    *new_handles = handles;
    owned = NULL;
    return GSN_OK;
}

/* Describes those that were just listed and are due, and appends the folders among them. */
static int describe_all(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
                        const struct gsn_ptp_handles *handles, struct gsn_ptp_handles *folders,
                        int64_t now_ms, struct gsn_error *err)
{
    const unsigned session = gsn_ptp_session_number(device->session);

    for (size_t i = 0; i < handles->count; i++) {
        struct gsn_ptp_object *const object = gsn_ptp_table_handle(table, session, handles->at[i]);
        int r = GSN_OK;

        if (object && gsn_ptp_object_is_due(object, now_ms))
            r = gsn_ptp_object_describe(table, device, object, now_ms, err);
        if (r < 0)
            return r;
        if (gsn_ptp_session_number(device->session) != session)
            return gsn_fail(err, GSN_E_IO, "the device began anew while it was listed");
        if (object && object->state == GSN_PTP_FOLDER)
            r = gsn_ptp_handles_add(folders, handles->at[i], err);
        if (r < 0)
            return r;
    }
    return GSN_OK;
}

/* One folder and what is right in it; 0: what the device lists by itself. */
static int look_into(struct gsn_ptp_table *table, struct gsn_ptp_device *device, uint32_t storage,
                     uint32_t folder, struct gsn_ptp_handles *folders, int64_t now_ms,
                     struct gsn_error *err)
{
    struct gsn_ptp_handles handles = { 0 };
    int r = see_all(table, device, storage, folder, &handles, err);

    if (r >= 0)
        r = describe_all(table, device, &handles, folders, now_ms, err);
    gsn_free(handles.at);
    return r;
}

/* The tree from the root; a folder is never walked twice, whatever the device says of parents. */
static int walk(struct gsn_ptp_table *table, struct gsn_ptp_device *device, int64_t now_ms,
                struct gsn_error *err)
{
    const unsigned session = gsn_ptp_session_number(device->session);
    struct gsn_ptp_handles folders = { 0 };
    int r = look_into(table, device, 0, 0, &folders, now_ms, err);

    for (size_t i = 0; r >= 0 && i < folders.count; i++) {
        struct gsn_ptp_object *const folder = gsn_ptp_table_handle(table, session, folders.at[i]);

        if (folder && i >= MOST_FOLDERS) {
            leave_folder(table, session, folders.at[i], too_many_folders);
        } else if (folder) {
            r = look_into(table, device, folder->storage ? folder->storage : gsn_ptp_every,
                          folders.at[i], &folders, now_ms, err);
        }
    }
    gsn_free(folders.at);
    return r;
}

/* The listing is whole: who was not in it is gone. */
static void find_gone(struct gsn_ptp_table *table)
{
    for (size_t i = 0; i < table->count; i++) {
        if (table->at[i].last_look != table->looks)
            table->at[i].gone = true;
    }
}

int gsn_ptp_table_look(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
                       const struct gsn_ptp_hints *hints, int64_t now_ms, struct gsn_error *err)
{
    int r;

    table->looks++;
    mark_checks(table, gsn_ptp_session_number(device->session), hints);
    r = walk(table, device, now_ms, err);
    if (r >= 0)
        r = gsn_ptp_table_make_keys(table, device, err);
    if (r >= 0)
        find_gone(table);
    return r;
}
