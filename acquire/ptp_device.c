/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a source of pictures asks a PTP device, and the ways around what devices refuse.
 *
 * Steps.
 * 1. DeviceInfo inside a session, for some responders refuse it outside.
 * 2. Listing: storage by storage; all storages at once only where the device names none; the root
 *    where it insists on a folder. A card that is out is an empty storage.
 * 3. ObjectInfo; sizes beyond 32 bits by the MTP property ObjectSize.
 * 4. Reading a piece: GetPartialObject while the piece ends below 4 GiB, else the 64-bit one, else
 * out of one stream of the whole object, which is wound forward. An operation that is refused is
 * not asked for again, and firmware that falls silent gets pieces of 64 KiB instead of 1 MiB.
 *
 * How it fails: GSN_E_INPUT with the device's code for a refusal; other codes are the session's. */
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

static int judge_response(const char *what, const struct gsn_ptp_response *response,
                          uint16_t *ret_code, struct gsn_error *err)
{
    char words[80];

    *ret_code = response->code;
    if (response->code == GSN_PTP_OK)
        return GSN_OK;
    gsn_ptp_describe(response->code, words, sizeof words);
    return gsn_fail(err, GSN_E_INPUT, "the device refuses %s: %s", what, words);
}

/* A question whose data are a dataset. gives: ret_bytes. */
static int fetch_dataset(struct gsn_ptp_device *device, const struct gsn_ptp_request *request,
                         const char *what, size_t limit, uint8_t **ret_bytes, size_t *ret_size,
                         uint16_t *ret_code, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_ptp_response response = { 0 };
    int r = gsn_ptp_fetch(device->session, request, limit, &bytes, ret_size, &response, err);

    if (r >= 0)
        r = judge_response(what, &response, ret_code, err);
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
    r = fetch_dataset(device, &request, "to say what it is", MOST_DATASET, &bytes, &size, &code,
                      err);
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

/* Listing and describing. */

static int list_once(struct gsn_ptp_device *device, uint32_t storage, uint32_t folder,
                     struct gsn_ptp_handles *handles, uint16_t *ret_code, struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT_HANDLES,
                                             3,
                                             { storage, 0, folder } };
    gsn_auto_mem(uint8_t) bytes = NULL;
    uint32_t count = 0;
    size_t size = 0;
    int r = fetch_dataset(device, &request, "to list what it holds", MOST_LIST, &bytes, &size,
                          ret_code, err);

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
    int r = fetch_dataset(device, &request, "to name its storages", MOST_DATASET, &bytes, &size,
                          ret_code, err);

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
    int r =
        fetch_dataset(device, &request, "to tell a size", MOST_DATASET, &bytes, &size, &code, err);

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
    r = fetch_dataset(device, &request, "to describe an object", MOST_DATASET, &bytes, &size,
                      ret_code, err);
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
    return r < 0 ? r : judge_response("to delete its copy", &response, ret_code, err);
}

enum { TRIES = 2 };

/* Reading pieces of an object, by whichever operation the device offers. */

static int ask_partial(struct gsn_ptp_device *device, const struct gsn_ptp_request *request,
                       void *buffer, size_t size, size_t *ret_got, uint16_t *ret_code,
                       struct gsn_error *err)
{
    for (int tries = 1;; tries++) {
        struct gsn_ptp_response response = { 0 };
        size_t got = 0;
        int r = gsn_ptp_ask(device->session, request, buffer, size, &got, &response, err);

        if (r >= 0)
            r = judge_response("to give it", &response, ret_code, err);
        if (r < 0)
            return r;
        /* The response counts the bytes as well; devices that do not count say 0. */
        if (got > 0 &&
            (response.count == 0 || response.parameter[0] == 0 || response.parameter[0] == got)) {
            *ret_got = got;
            return GSN_OK;
        }
        if (got == 0)
            return gsn_fail(err, GSN_E_LIMIT, "the device has no more bytes of it");
        if (tries == TRIES)
            return gsn_fail(err, GSN_E_IO, "the device says that it gave %lu bytes, and gave %zu",
                            (unsigned long)response.parameter[0], got);
    }
}

static int read_partial(struct gsn_ptp_device *device, uint32_t handle, uint64_t offset,
                        void *buffer, size_t size, size_t *ret_got, uint16_t *ret_code,
                        struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_PARTIAL_OBJECT,
                                             3,
                                             { handle, (uint32_t)offset, (uint32_t)size } };

    return ask_partial(device, &request, buffer, size, ret_got, ret_code, err);
}

static int read_partial_64(struct gsn_ptp_device *device, uint32_t handle, uint64_t offset,
                           void *buffer, size_t size, size_t *ret_got, uint16_t *ret_code,
                           struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_PARTIAL_OBJECT_64,
                                             4,
                                             { handle, (uint32_t)offset, (uint32_t)(offset >> 32),
                                               (uint32_t)size } };

    return ask_partial(device, &request, buffer, size, ret_got, ret_code, err);
}

/* Makes the stream stand at offset: from its beginning, or on from where it is. */
static int wind_stream(struct gsn_ptp_device *device, uint32_t handle, uint64_t offset,
                       void *buffer, size_t size, struct gsn_error *err)
{
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT, 1, { handle } };
    struct gsn_ptp_stream *const stream = &device->stream;
    int r = GSN_OK;

    if (!gsn_ptp_stream_is_on(device->session) || stream->handle != handle || stream->at > offset) {
        *stream = (struct gsn_ptp_stream){ .handle = handle };
        r = gsn_ptp_stream_start(device->session, &request, err);
    }
    while (r >= 0 && stream->at < offset) {
        const uint64_t left = offset - stream->at;
        size_t got = 0;

        r = gsn_ptp_stream_read(device->session, buffer, left < size ? (size_t)left : size, &got,
                                err);
        if (r >= 0 && got == 0)
            return GSN_OK;
        stream->at += got;
    }
    return r;
}

/* The data are over: what does the device say about them? */
static int end_stream(struct gsn_ptp_device *device, uint64_t object_size, uint16_t *ret_code,
                      struct gsn_error *err)
{
    struct gsn_ptp_response response = { 0 };
    uint8_t one_more;
    size_t got = 0;
    int r = gsn_ptp_stream_read(device->session, &one_more, 1, &got, err);

    if (r >= 0 && got > 0)
        return gsn_fail(err, GSN_E_LIMIT, "the device gives more bytes than it told of");
    if (r >= 0)
        r = gsn_ptp_stream_end(device->session, &response, err);
    if (r >= 0)
        r = judge_response("to give it", &response, ret_code, err);
    if (r >= 0 && device->stream.at < object_size)
        r = gsn_fail(err, GSN_E_IO, "the device ended it after %llu bytes",
                     (unsigned long long)device->stream.at);
    return r;
}

static int read_stream_once(struct gsn_ptp_device *device, uint32_t handle, uint64_t object_size,
                            uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                            uint16_t *ret_code, struct gsn_error *err)
{
    struct gsn_ptp_stream *const stream = &device->stream;
    size_t got = 0;
    int r = wind_stream(device, handle, offset, buffer, size, err);

    if (r >= 0)
        r = gsn_ptp_stream_read(device->session, buffer, size, &got, err);
    if (r < 0)
        return r;
    stream->at += got;
    /* The last piece counts only when the device says that all went well. */
    if (got == 0 || stream->at == object_size)
        r = end_stream(device, object_size, ret_code, err);
    if (r >= 0)
        *ret_got = got;
    return r;
}

static int read_stream(struct gsn_ptp_device *device, uint32_t handle, uint64_t object_size,
                       uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                       uint16_t *ret_code, struct gsn_error *err)
{
    int r = GSN_OK;

    for (int tries = 0; tries < TRIES; tries++) {
        r = read_stream_once(device, handle, object_size, offset, buffer, size, ret_got, ret_code,
                             err);
        if (r != GSN_E_IO)
            return r;
        /* Over from the start, in the order it was asked for. */
        device->stream = (struct gsn_ptp_stream){ .at = UINT64_MAX };
    }
    return r;
}

/* The way that is offered for a piece that ends there. */
static uint16_t choose_operation(const struct gsn_ptp_device *device, uint64_t end)
{
    if (end <= UINT32_MAX && !device->no_partial &&
        gsn_ptp_offers(&device->info, GSN_PTP_GET_PARTIAL_OBJECT))
        return GSN_PTP_GET_PARTIAL_OBJECT;
    if (!device->no_partial_64 && gsn_ptp_offers(&device->info, GSN_PTP_GET_PARTIAL_OBJECT_64))
        return GSN_PTP_GET_PARTIAL_OBJECT_64;
    return GSN_PTP_GET_OBJECT;
}

static int read_once(struct gsn_ptp_device *device, uint16_t way, uint32_t handle,
                     uint64_t object_size, uint64_t offset, void *buffer, size_t size,
                     size_t *ret_got, uint16_t *ret_code, struct gsn_error *err)
{
    if (way == GSN_PTP_GET_PARTIAL_OBJECT)
        return read_partial(device, handle, offset, buffer, size, ret_got, ret_code, err);
    if (way == GSN_PTP_GET_PARTIAL_OBJECT_64)
        return read_partial_64(device, handle, offset, buffer, size, ret_got, ret_code, err);
    return read_stream(device, handle, object_size, offset, buffer, size, ret_got, ret_code, err);
}

/* Whether another way, or a smaller piece, is worth a try after this failure. */
static bool adapt_request(struct gsn_ptp_device *device, uint16_t way, int r, uint16_t code)
{
    if (way == GSN_PTP_GET_OBJECT)
        return false;
    if (r == GSN_E_INPUT && code == GSN_PTP_OPERATION_NOT_SUPPORTED) {
        device->no_partial |= way == GSN_PTP_GET_PARTIAL_OBJECT;
        device->no_partial_64 |= way == GSN_PTP_GET_PARTIAL_OBJECT_64;
        return true;
    }
    /* Silent after all mending: firmware that large requests crash. */
    if (r != GSN_E_IO || device->piece == GSN_PTP_SMALLEST_PIECE)
        return false;
    device->piece = GSN_PTP_SMALLEST_PIECE;
    return true;
}

int gsn_ptp_device_read(struct gsn_ptp_device *device, uint32_t handle, uint64_t object_size,
                        uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                        uint16_t *ret_code, struct gsn_error *err)
{
    for (;;) {
        const uint64_t left = object_size - offset;
        size_t now = size < device->piece ? size : device->piece;
        uint16_t way;
        int r;

        if (now > left)
            now = (size_t)left;
        way = choose_operation(device, offset + now);
        *ret_code = 0;
        r = read_once(device, way, handle, object_size, offset, buffer, now, ret_got, ret_code,
                      err);
        if (r >= 0 || !adapt_request(device, way, r, *ret_code))
            return r;
    }
}
