/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_device.h"

#include <string.h>

enum {
    MOST_DATASET = 64 << 10,         /* bytes of DeviceInfo, ObjectInfo, StorageIDs */
    MOST_LIST = 4 * ((1 << 17) + 1), /* bytes of a list of 131072 handles */
};

int gsn_ptp_device_new(struct gsn_ptp_transport *transport, struct gsn_ptp_device **ret_device,
                       struct gsn_error *err)
{
    gsn_auto(gsn_ptp_device) device = gsn_alloc_array(1, sizeof *device);
    int r;

    if (!device) {
        transport->ops->close(transport->self);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a PTP device");
    }
    device->transport = transport;
    device->piece = GSN_PTP_LARGEST_PIECE;
    r = gsn_ptp_session_new(transport, &device->session, err);
    if (r < 0)
        return r;
    *ret_device = gsn_steal(&device);
    return GSN_OK;
}

void gsn_ptp_device_free(struct gsn_ptp_device *device)
{
    if (!device)
        return;
    if (device->session)
        gsn_ptp_session_close(device->session);
    gsn_ptp_session_free(device->session);
    device->transport->ops->close(device->transport->self);
    gsn_free(device);
}

const char *gsn_ptp_device_serial(const struct gsn_ptp_device *device)
{
    return device->transport->serial[0] ? device->transport->serial : device->info.serial;
}

static int judge(const char *what, const struct gsn_ptp_response *response, uint16_t *ret_code,
                 struct gsn_error *err)
{
    char words[80];

    *ret_code = response->code;
    if (response->code == GSN_PTP_OK)
        return GSN_OK;
    gsn_ptp_describe(response->code, words, sizeof words);
    return gsn_fail(err, GSN_E_INPUT, "the device refuses %s: %s", what, words);
}

/* A question whose data are a dataset. gives: ret_bytes. */
static int fetch(struct gsn_ptp_device *device, const struct gsn_ptp_request *request,
                 const char *what, size_t limit, uint8_t **ret_bytes, size_t *ret_size,
                 uint16_t *ret_code, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_ptp_response response = { 0 };
    int r = gsn_ptp_fetch(device->session, request, limit, &bytes, ret_size, &response, err);

    if (r >= 0)
        r = judge(what, &response, ret_code, err);
    if (r >= 0)
        *ret_bytes = gsn_steal(&bytes);
    return r;
}

int gsn_ptp_device_greet(struct gsn_ptp_device *device, struct gsn_error *err)
{
    const struct gsn_ptp_request request = { .operation = GSN_PTP_GET_DEVICE_INFO };
    gsn_auto_mem(uint8_t) bytes = NULL;
    uint16_t code = 0;
    size_t size = 0;
    int r;

    if (device->greeted)
        return GSN_OK;
    /* Some responders refuse to introduce themselves outside a session, so it comes first. */
    r = fetch(device, &request, "to say what it is", MOST_DATASET, &bytes, &size, &code, err);
    if (r >= 0)
        r = gsn_ptp_read_device_info(bytes, size, &device->info, err);
    device->greeted = r >= 0;
    return r;
}

int gsn_ptp_handles_add(struct gsn_ptp_handles *handles, uint32_t handle, struct gsn_error *err)
{
    if (handles->count == handles->room) {
        const size_t room = handles->room ? 2 * handles->room : 16;
        uint32_t *at = gsn_realloc_array(handles->at, room, sizeof *at);

        if (!at)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for %zu handles", room);
        handles->at = at;
        handles->room = room;
    }
    handles->at[handles->count++] = handle;
    return GSN_OK;
}

static int list_once(struct gsn_ptp_device *device, uint32_t storage, uint32_t folder,
                     struct gsn_ptp_handles *handles, uint16_t *ret_code, struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT_HANDLES,
                                             3,
                                             { storage, 0, folder } };
    gsn_auto_mem(uint8_t) bytes = NULL;
    uint32_t count = 0;
    size_t size = 0;
    int r =
        fetch(device, &request, "to list what it holds", MOST_LIST, &bytes, &size, ret_code, err);

    if (r >= 0)
        r = gsn_ptp_read_list(bytes, size, &count, err);
    for (uint32_t i = 0; r >= 0 && i < count; i++)
        r = gsn_ptp_handles_add(handles, gsn_ptp_get32(bytes + 4 + 4 * (size_t)i), err);
    return r;
}

static bool was_refused(int r, uint16_t code)
{
    return r == GSN_E_INPUT && code != 0 && code != GSN_PTP_OK;
}

/* One storage: everything, or the root where the device insists on a folder. */
static int list_storage(struct gsn_ptp_device *device, uint32_t storage,
                        struct gsn_ptp_handles *handles, uint16_t *ret_code, struct gsn_error *err)
{
    int r = list_once(device, storage, 0, handles, ret_code, err);

    if (was_refused(r, *ret_code) && *ret_code != GSN_PTP_STORE_NOT_AVAILABLE)
        r = list_once(device, storage, gsn_ptp_every, handles, ret_code, err);
    /* The card is out, or locked: nothing is there, and the others have a say all the same. */
    return was_refused(r, *ret_code) && *ret_code == GSN_PTP_STORE_NOT_AVAILABLE ? GSN_OK : r;
}

/* gives: ret_bytes, the identifiers of ret_count storages. */
static int name_storages(struct gsn_ptp_device *device, uint8_t **ret_bytes, uint32_t *ret_count,
                         uint16_t *ret_code, struct gsn_error *err)
{
    const struct gsn_ptp_request request = { .operation = GSN_PTP_GET_STORAGE_IDS };
    gsn_auto_mem(uint8_t) bytes = NULL;
    size_t size = 0;
    int r =
        fetch(device, &request, "to name its storages", MOST_DATASET, &bytes, &size, ret_code, err);

    if (r >= 0)
        r = gsn_ptp_read_list(bytes, size, ret_count, err);
    if (r >= 0)
        *ret_bytes = gsn_steal(&bytes);
    return r;
}

/* Storage by storage. To ask for all storages at once is allowed, but not every responder survives
 * it: umtp-responder refuses, and then hangs at the next listing. So that is asked only of a device
 * that does not name its storages. */
int gsn_ptp_device_list(struct gsn_ptp_device *device, uint32_t storage, uint32_t folder,
                        struct gsn_ptp_handles *handles, uint16_t *ret_code, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    uint32_t count = 0;
    int r;

    *ret_code = 0;
    if (folder != 0)
        return list_once(device, storage, folder, handles, ret_code, err);
    r = name_storages(device, &bytes, &count, ret_code, err);
    if (was_refused(r, *ret_code))
        return list_once(device, gsn_ptp_every, 0, handles, ret_code, err);
    for (uint32_t i = 0; r >= 0 && i < count; i++) {
        const uint32_t id = gsn_ptp_get32(bytes + 4 + 4 * (size_t)i);

        /* Without a logical part there is a slot and no card in it. */
        if ((id & 0xFFFF) != 0)
            r = list_storage(device, id, handles, ret_code, err);
    }
    return r;
}

/* The size of an object that 32 bits do not hold. */
static int ask_size(struct gsn_ptp_device *device, uint32_t handle, uint64_t *ret_size,
                    struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT_PROP_VALUE,
                                             2,
                                             { handle, gsn_ptp_object_size } };
    gsn_auto_mem(uint8_t) bytes = NULL;
    uint16_t code = 0;
    size_t size = 0;
    int r = fetch(device, &request, "to tell a size", MOST_DATASET, &bytes, &size, &code, err);

    if (r >= 0)
        r = gsn_ptp_read_u64(bytes, size, ret_size, err);
    if (r != GSN_E_INPUT)
        return r;
    *ret_size = UINT64_MAX;
    return GSN_OK;
}

int gsn_ptp_device_describe(struct gsn_ptp_device *device, uint32_t handle,
                            struct gsn_ptp_object_info *ret_info, uint64_t *ret_size,
                            uint16_t *ret_code, struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT_INFO, 1, { handle } };
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_ptp_object_info info;
    uint64_t long_size = 0;
    size_t size = 0;
    int r;

    *ret_code = 0;
    r = fetch(device, &request, "to describe an object", MOST_DATASET, &bytes, &size, ret_code,
              err);
    if (r >= 0)
        r = gsn_ptp_read_object_info(bytes, size, &info, err);
    if (r >= 0 && info.size == gsn_ptp_every)
        r = ask_size(device, handle, &long_size, err);
    if (r < 0)
        return r;
    *ret_size = info.size == gsn_ptp_every ? long_size : info.size;
    *ret_info = info;
    return GSN_OK;
}

int gsn_ptp_device_delete(struct gsn_ptp_device *device, uint32_t handle, uint16_t *ret_code,
                          struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_DELETE_OBJECT, 2, { handle, 0 } };
    struct gsn_ptp_response response = { 0 };
    size_t got;
    int r;

    *ret_code = 0;
    r = gsn_ptp_ask(device->session, &request, NULL, 0, &got, &response, err);
    return r < 0 ? r : judge("to delete its copy", &response, ret_code, err);
}
