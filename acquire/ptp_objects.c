/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The table of a PTP device's objects: who each is, whether it is ready, what the caller has not
 * heard.
 *
 * Steps of one look.
 * 1. The tree of folders is listed from the root, each folder once, 4096 at most; handles are put
 * in order by session and number.
 * 2. What is new, not settled, or was named by an event is described (ObjectInfo). Because events
 * may be missing, 32 of the others are described in turn, too.
 * 3. An object described twice alike, at least settle_ms apart, with bytes in it, is ready.
 * 4. When all folders are known each object gets a key (serial number, storage, path, size, date),
 * by which it is met again in a later session; two that look the same get none.
 * 5. Objects that were not in the listing are gone.
 * 6. Pending events are emitted: ready, waiting, notices, gone.
 *
 * How it fails: an object that cannot be described or read is set aside alone, for 30 s, 1 min, ...
 * 1 h. A responder may measure an object once a session: one that stays empty, or was read to its
 * end and is not whole, calls for a new session, ever more rarely. */
#include "acquire/ptp_objects.h"

#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "acquire/source.h"

enum {
    EMPTY_MS = 5 * 1000, /* an object that is empty for so long may have been measured too early */
    MOST_DOUBTS = 16,
};

/* The table of objects. */

static void free_texts(struct gsn_ptp_object *object)
{
    gsn_free(object->name);
    gsn_free(object->key);
    object->name = object->key = NULL;
}

void gsn_ptp_table_done(struct gsn_ptp_table *table)
{
    for (size_t i = 0; i < table->count; i++)
        free_texts(&table->at[i]);
    gsn_free(table->at);
    table->at = NULL;
    table->count = table->room = 0;
}

struct gsn_ptp_object *gsn_ptp_table_find(struct gsn_ptp_table *table, uint64_t item)
{
    for (size_t i = 0; i < table->count; i++) {
        if (table->at[i].item == item && table->at[i].state == GSN_PTP_READY && !table->at[i].gone)
            return &table->at[i];
    }
    return NULL;
}

/* Where the handle of this session is, or belongs. */
static size_t find_place(const struct gsn_ptp_table *table, unsigned session, uint32_t handle,
                         bool *ret_found)
{
    size_t low = 0, high = table->count;

    while (low < high) {
        const size_t middle = low + (high - low) / 2;
        const struct gsn_ptp_object *const there = &table->at[middle];

        if (there->session < session || (there->session == session && there->handle < handle))
            low = middle + 1;
        else
            high = middle;
    }
    *ret_found =
        low < table->count && table->at[low].session == session && table->at[low].handle == handle;
    return low;
}

/* borrows: the object with this handle, or NULL. */
static struct gsn_ptp_object *find_handle(struct gsn_ptp_table *table, unsigned session,
                                          uint32_t handle)
{
    bool found;
    const size_t place = find_place(table, session, handle, &found);

    return found ? &table->at[place] : NULL;
}

/* It is empty, for twice as long as when it was doubted last. */
static bool is_long_empty(const struct gsn_ptp_object *object, int64_t now_ms)
{
    return object->state == GSN_PTP_WAITING && object->name && object->size == 0 &&
           object->doubts < MOST_DOUBTS &&
           now_ms - object->since_ms >= (int64_t)EMPTY_MS << object->doubts;
}

bool gsn_ptp_table_doubt(struct gsn_ptp_table *table, int64_t now_ms)
{
    bool any = false;

    for (size_t i = 0; i < table->count; i++) {
        struct gsn_ptp_object *const object = &table->at[i];

        if (!object->key || !object->key[0] || object->gone)
            continue;
        if (is_long_empty(object, now_ms)) {
            object->doubtful = true;
            object->doubts++;
        }
        any |= object->doubtful &&
               (object->state == GSN_PTP_READY || object->state == GSN_PTP_WAITING);
    }
    return any;
}

void gsn_ptp_table_sweep(struct gsn_ptp_table *table)
{
    size_t kept = 0;

    for (size_t i = 0; i < table->count; i++) {
        if (table->at[i].gone)
            free_texts(&table->at[i]);
        else
            table->at[kept++] = table->at[i];
    }
    table->count = kept;
}

enum { FIRST_RETRY_MS = 30 * 1000, LAST_RETRY_MS = 60 * 60 * 1000 };

static const char unsettled[] = "a second look has yet to find it unchanged";

/* ptp_object.c */
/* One object. */

/* A reason is told once, and again when it becomes another. */
static void set_state(struct gsn_ptp_object *object, enum gsn_ptp_state state, const char *reason)
{
    if (object->state != state || strcmp(object->reason, reason) != 0)
        object->told = false;
    object->state = state;
    (void)snprintf(object->reason, sizeof object->reason, "%.190s", reason);
}

void gsn_ptp_object_wait(struct gsn_ptp_object *object, const char *reason)
{
    set_state(object, GSN_PTP_WAITING, reason);
}

void gsn_ptp_object_set_aside(struct gsn_ptp_object *object, const char *reason, int64_t now_ms)
{
    int64_t delay = FIRST_RETRY_MS;

    for (unsigned i = 0; i < object->failures && delay < LAST_RETRY_MS; i++)
        delay *= 2;
    object->failures++;
    object->retry_ms = now_ms + (delay < LAST_RETRY_MS ? delay : LAST_RETRY_MS);
    set_state(object, GSN_PTP_WAITING, reason);
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
static void tidy_name(char *name, size_t room)
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
static int take_description(struct gsn_ptp_object *object, const struct gsn_ptp_object_info *info,
                            uint64_t size, struct gsn_error *err)
{
    char *const name = gsn_strdup(info->name);

    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an object");
    object->fresh = object->fresh || !object->name;
    free_texts(object);
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
        set_state(object, GSN_PTP_FOLDER, "");
    else if (!is_picture(object))
        set_state(object, GSN_PTP_LEFT, "is no picture and is left alone");
    else
        set_state(object, GSN_PTP_WAITING, unsettled);
}

/* It is as it was: has it been so for long enough? */
static void settle_object(struct gsn_ptp_table *table, struct gsn_ptp_object *object,
                          int64_t now_ms)
{
    if (object->state != GSN_PTP_WAITING || !object->key ||
        now_ms - object->since_ms < table->options.settle_ms || now_ms < object->retry_ms)
        return;
    if (object->size == 0)
        set_state(object, GSN_PTP_WAITING, "is empty as yet");
    else if (object->size == UINT64_MAX)
        set_state(object, GSN_PTP_WAITING,
                  "is larger than 4 GiB, and the device does not tell how large");
    else if (is_known(table, object))
        set_state(object, GSN_PTP_TAKEN, "");
    else
        set_state(object, GSN_PTP_READY, "");
}

/* Asks for it and judges it. An object that cannot be described is set aside alone. */
static int describe_object(struct gsn_ptp_table *table, struct gsn_ptp_device *device,
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
    tidy_name(info.name, sizeof info.name);
    if (is_as_before(object, &info, size)) {
        settle_object(table, object, now_ms);
        return GSN_OK;
    }
    r = take_description(object, &info, size, err);
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
    tidy_name(info.name, sizeof info.name);
    if (is_as_before(object, &info, size))
        return GSN_OK;
    /* The next look describes it as it is now; what was taken stays so, and this is another. */
    if (object->state == GSN_PTP_TAKEN)
        object->item = ++table->last_item;
    object->since_ms = now_ms;
    set_state(object, GSN_PTP_WAITING, "changed while it was read");
    return gsn_fail(err, GSN_E_BUSY, "%s changed while it was read", object->name);
}

/* Whether it is time to describe it. */
static bool is_due(const struct gsn_ptp_object *object, int64_t now_ms)
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
static char *quote_json(const char *text)
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

/* gives: its facts as JSON; NULL when memory runs out. */
static char *make_facts(const struct gsn_ptp_object *object, const struct gsn_ptp_device *device)
{
    gsn_auto_mem(char) maker = quote_json(device->info.maker);
    gsn_auto_mem(char) model = quote_json(device->info.model);
    gsn_auto_mem(char) serial = quote_json(gsn_ptp_device_serial(device));
    gsn_auto_mem(char) name = quote_json(object->name);
    gsn_auto_mem(char) captured = quote_json(object->captured);

    if (!maker || !model || !serial || !name || !captured)
        return NULL;
    return gsn_format("{\"vendor\":\"%04x\",\"product\":\"%04x\",\"maker\":\"%s\",\"model\":\"%s\","
                      "\"serial\":\"%s\",\"storage\":\"0x%08lx\",\"handle\":\"0x%08lx\","
                      "\"name\":\"%s\",\"format\":\"0x%04x\",\"size\":%llu,\"captured\":\"%s\"}",
                      device->transport->vendor, device->transport->product, maker, model, serial,
                      (unsigned long)object->storage, (unsigned long)object->handle, name,
                      object->format, (unsigned long long)object->size, captured);
}

enum { MOST_DEPTH = 16 };
/* of folders in a path */

/* Keys: who an object is, in this session and the next. */

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
        const struct gsn_ptp_object *const folder = find_handle(table, object->session, parent);
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

/* All folders are known, so everybody's path is, and who was met in an earlier session.
 * Fails with GSN_E_NOMEM. */
static int make_keys(struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
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

enum {
    CHECKS_A_LOOK = 32,  /* taken objects that are described again at each listing */
    MOST_FOLDERS = 4096, /* walked in one listing; too_many_folders says the number */
};

static const char too_many_folders[] = "is a folder that is not looked into, for the device has "
                                       "more than 4096 of them: empty or delete "
                                       "old folders there";

/* Listing the device. */

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
            set_state(object, GSN_PTP_FOLDER, reason);
    }
}

/* The handle was listed. ret_seen: it was so in this listing already. */
static int see_handle(struct gsn_ptp_table *table, unsigned session, uint32_t handle,
                      bool *ret_seen, struct gsn_error *err)
{
    bool found;
    const size_t place = find_place(table, session, handle, &found);

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
        struct gsn_ptp_object *const object = find_handle(table, session, hints->changed[i]);

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
static int list_folder(struct gsn_ptp_table *table, struct gsn_ptp_device *device, uint32_t storage,
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
    self = find_handle(table, gsn_ptp_session_number(device->session), folder);
    if (r >= 0 && self)
        set_state(self, GSN_PTP_FOLDER, "");
    /* In order, each is put behind the last one. */
    if (r >= 0 && handles.count > 1)
        qsort(handles.at, handles.count, sizeof *handles.at, by_number);
    for (size_t i = 0; r >= 0 && i < handles.count; i++) {
        bool seen = false;

        r = see_handle(table, gsn_ptp_session_number(device->session), handles.at[i], &seen, err);
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
        struct gsn_ptp_object *const object = find_handle(table, session, handles->at[i]);
        int r = GSN_OK;

        if (object && is_due(object, now_ms))
            r = describe_object(table, device, object, now_ms, err);
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
    int r = list_folder(table, device, storage, folder, &handles, err);

    if (r >= 0)
        r = describe_all(table, device, &handles, folders, now_ms, err);
    gsn_free(handles.at);
    return r;
}

/* The tree from the root; a folder is never walked twice, whatever the device says of parents. */
static int walk_tree(struct gsn_ptp_table *table, struct gsn_ptp_device *device, int64_t now_ms,
                     struct gsn_error *err)
{
    const unsigned session = gsn_ptp_session_number(device->session);
    struct gsn_ptp_handles folders = { 0 };
    int r = look_into(table, device, 0, 0, &folders, now_ms, err);

    for (size_t i = 0; r >= 0 && i < folders.count; i++) {
        struct gsn_ptp_object *const folder = find_handle(table, session, folders.at[i]);

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
static void mark_gone(struct gsn_ptp_table *table)
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
    r = walk_tree(table, device, now_ms, err);
    if (r >= 0)
        r = make_keys(table, device, err);
    if (r >= 0)
        mark_gone(table);
    return r;
}

/* Pending events. */

static bool has_pending_event(const struct gsn_ptp_object *object,
                              struct gsn_source_event *ret_event)
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

static int emit_event(const struct gsn_ptp_object *object, const struct gsn_ptp_device *device,
                      struct gsn_source_event *event, struct gsn_source_events *events,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) facts = NULL;
    char handle[32];

    (void)snprintf(handle, sizeof handle, "object %08lX", (unsigned long)object->handle);
    event->name = object->name ? object->name : handle;
    if (event->what == GSN_SOURCE_READY && device) {
        facts = make_facts(object, device);
        if (!facts)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for an event");
    }
    event->facts = facts;
    return gsn_source_emit(events, event, err);
}

static int emit_object(const struct gsn_ptp_object *object, const struct gsn_ptp_device *device,
                       struct gsn_source_events *events, struct gsn_error *err)
{
    struct gsn_source_event event;
    int r = GSN_OK;

    if (has_pending_event(object, &event))
        r = emit_event(object, device, &event, events, err);
    if (r >= 0 && object->notice[0]) {
        event = (struct gsn_source_event){ .what = GSN_SOURCE_NOTICE, .reason = object->notice };
        r = emit_event(object, device, &event, events, err);
    }
    return r;
}

int gsn_ptp_table_emit(const struct gsn_ptp_table *table, const struct gsn_ptp_device *device,
                       struct gsn_source_events *events, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < table->count; i++)
        r = emit_object(&table->at[i], device, events, err);
    return r;
}
