/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/ptp_model.h"

#include <stdlib.h>
#include <string.h>

#include "tests/device/blob.h"
#include "tests/device/ptp_answers.h"
#include "tests/device/wire.h"

/* Numbers of ISO 15740, of MTP 1.1 and of Android's extension. */
enum {
    GET_DEVICE_INFO = 0x1001,
    OPEN_SESSION = 0x1002,
    CLOSE_SESSION = 0x1003,
    GET_STORAGE_IDS = 0x1004,
    GET_STORAGE_INFO = 0x1005,
    GET_NUM_OBJECTS = 0x1006,
    GET_OBJECT_HANDLES = 0x1007,
    GET_OBJECT_INFO = 0x1008,
    GET_OBJECT = 0x1009,
    GET_THUMB = 0x100a,
    DELETE_OBJECT = 0x100b,
    GET_PARTIAL_OBJECT = 0x101b,
    GET_PARTIAL_OBJECT_64 = 0x95c1,
    GET_OBJECT_PROP_VALUE = 0x9803,

    OK = 0x2001,
    SESSION_NOT_OPEN = 0x2003,
    NOT_SUPPORTED = 0x2005,
    INVALID_STORAGE = 0x2008,
    STORE_NOT_AVAILABLE = 0x2013,
    INVALID_HANDLE = 0x2009,
    WRITE_PROTECTED = 0x200d,
    NO_THUMBNAIL = 0x2010,
    PARTIAL_DELETION = 0x2012,
    BUSY = 0x2019,
    INVALID_PARAMETER = 0x201d,
    SESSION_ALREADY_OPEN = 0x201e,
    CANCELLED = 0x201f,
    INVALID_PROPERTY = 0xa801,
    GENERAL_ERROR = 0x2002,

    OBJECT_ADDED = 0x4002,
    OBJECT_REMOVED = 0x4003,
    OBJECT_INFO_CHANGED = 0x4007,

    PROPERTY_NAME = 0xdc07,
    PROPERTY_SIZE = 0xdc04,
    MOST_KINDS = 32,
};

struct held {
    struct ptp_object object;
    uint32_t handle;
    bool growing, removed;
    unsigned looks;
    uint64_t measured; /* in this session (measures_once) */
    bool is_measured;
};

struct event {
    uint16_t code;
    uint32_t parameter;
    unsigned times;
};

struct ptp_model {
    struct ptp_faults faults;
    struct usb_model usb;
    char *serial;
    struct ptp_answers *answers;
    struct held **object;
    size_t object_count;
    struct event *event;
    size_t event_count;
    uint32_t last_handle, session, transaction;
    unsigned transactions, busy, cancelling;
    bool gone, crashed, hung;
    int64_t now_ms;
    struct {
        uint16_t operation;
        unsigned times;
    } asked[MOST_KINDS];
};

/* A question, and its answer while it is made. */
struct question {
    uint16_t operation;
    uint32_t parameter[5];
    struct ptp_answer answer;
    struct blob data;
    struct ptp_payload payload;
};

static const uint8_t device_descriptor[] = {
    18, 1, WIRE16(0x0200), 0, 0, 0, 64, WIRE16(0x1209), WIRE16(0x0001), WIRE16(0x0100), 1, 2, 3, 1,
};
static void *grow(void *old, size_t count, size_t size)
{
    void *const larger = reallocarray(old, count, size);

    if (!larger)
        abort();
    return larger;
}

/* Objects */

static struct held *find(const struct ptp_model *model, uint32_t handle)
{
    for (size_t i = 0; i < model->object_count; i++)
        if (model->object[i]->handle == handle && !model->object[i]->removed)
            return model->object[i];
    return NULL;
}

static uint32_t storage_of(const struct held *held)
{
    return (held->object.storage + 1) << 16 | 1;
}

static unsigned storage_count(const struct ptp_model *model)
{
    unsigned most = 0;

    for (size_t i = 0; i < model->object_count; i++)
        if (model->object[i]->object.storage > most)
            most = model->object[i]->object.storage;
    return most + 1;
}

/* What the device says the size is: while it grows, never all of it. */
static uint64_t size_now(const struct held *held)
{
    const uint64_t size = held->is_measured ? held->measured : held->object.size;
    const uint64_t missing = size / (held->looks + 1);

    return !held->growing || size == 0 ? size : size - (missing ? missing : 1);
}

/* Events */

static void tell(struct ptp_model *model, uint16_t code, uint32_t parameter, unsigned times)
{
    if (model->faults.no_events || model->session == 0 || model->gone || times == 0)
        return;
    model->event = grow(model->event, model->event_count + 1, sizeof *model->event);
    model->event[model->event_count++] = (struct event){ code, parameter, times };
}

static long give_event(struct ptp_model *model, uint8_t *buffer, size_t size)
{
    struct event *const first = model->event;

    if (model->event_count == 0)
        return USB_MODEL_NAK;
    if (size < 16)
        return USB_MODEL_BABBLE;
    wire_put32(buffer, 16);
    wire_put16(buffer + 4, 4);
    wire_put16(buffer + 6, first->code);
    wire_put32(buffer + 8, model->transaction);
    wire_put32(buffer + 12, first->parameter);
    if (--first->times == 0)
        memmove(first, first + 1, --model->event_count * sizeof *first);
    return 16;
}

/* Operations: each fills the question's answer; what it does not fill is OK without data. */

static void refuse(struct question *q, uint16_t code)
{
    q->answer.code = code;
}

static bool offers(const struct ptp_model *model, uint16_t operation)
{
    const struct ptp_faults *const faults = &model->faults;

    return !(operation == GET_STORAGE_IDS && faults->no_storage_ids) &&
           !(operation == GET_PARTIAL_OBJECT && faults->no_partial) &&
           !(operation == GET_PARTIAL_OBJECT_64 && faults->no_partial64) &&
           !(operation == GET_OBJECT_PROP_VALUE && faults->no_properties);
}

static void say_operations(const struct ptp_model *model, struct blob *data)
{
    static const uint16_t all[] = {
        GET_DEVICE_INFO,
        OPEN_SESSION,
        CLOSE_SESSION,
        GET_STORAGE_IDS,
        GET_STORAGE_INFO,
        GET_NUM_OBJECTS,
        GET_OBJECT_HANDLES,
        GET_OBJECT_INFO,
        GET_OBJECT,
        GET_THUMB,
        DELETE_OBJECT,
        GET_PARTIAL_OBJECT,
        GET_OBJECT_PROP_VALUE,
        GET_PARTIAL_OBJECT_64,
    };
    uint16_t offered[sizeof all / sizeof *all];
    size_t count = 0;

    for (size_t i = 0; i < sizeof all / sizeof *all; i++)
        if (offers(model, all[i]))
            offered[count++] = all[i];
    blob_array16(data, offered, count);
}

static void get_device_info(struct ptp_model *model, struct question *q)
{
    static const uint16_t events[] = { OBJECT_ADDED, OBJECT_REMOVED, OBJECT_INFO_CHANGED };
    static const uint16_t formats[] = { PTP_TIFF, PTP_JPEG, PTP_FOLDER };
    const bool extended = !model->faults.no_properties || !model->faults.no_partial64;

    if (model->session == 0 && model->faults.info_needs_session) {
        refuse(q, SESSION_NOT_OPEN);
        return;
    }
    blob_u16(&q->data, 100);
    blob_u32(&q->data, extended ? 6 : 0);
    blob_u16(&q->data, 100);
    blob_string(&q->data, extended ? "microsoft.com: 1.0; android.com: 1.0;" : "");
    blob_u16(&q->data, 0);
    say_operations(model, &q->data);
    blob_array16(&q->data, events, model->faults.hidden_events ? 0 : 3);
    blob_array16(&q->data, NULL, 0); /* device properties */
    blob_array16(&q->data, NULL, 0); /* capture formats */
    blob_array16(&q->data, formats, 3);
    blob_string(&q->data, model->usb.strings[1]);
    blob_string(&q->data, model->usb.strings[2]);
    blob_string(&q->data, "1.0");
    blob_string(&q->data, model->serial);
}

static void open_session(struct ptp_model *model, struct question *q)
{
    if (q->parameter[0] == 0) {
        refuse(q, INVALID_PARAMETER);
    } else if (model->session) {
        refuse(q, SESSION_ALREADY_OPEN);
        q->answer.count = 1;
        q->answer.parameter[0] = model->session;
    } else {
        model->session = q->parameter[0];
        for (size_t i = 0; i < model->object_count; i++)
            model->object[i]->is_measured = false;
    }
}

static void close_session(struct ptp_model *model, struct question *q)
{
    (void)q;
    model->session = 0;
    model->event_count = 0;
}

static void get_storage_ids(struct ptp_model *model, struct question *q)
{
    const unsigned count = storage_count(model);

    blob_u32(&q->data, count);
    for (unsigned i = 1; i <= count; i++)
        blob_u32(&q->data, i << 16 | 1);
}

static bool is_storage(const struct ptp_model *model, uint32_t id)
{
    return (id & 0xffff) == 1 && id >> 16 >= 1 && id >> 16 <= storage_count(model);
}

static void get_storage_info(struct ptp_model *model, struct question *q)
{
    if (!is_storage(model, q->parameter[0])) {
        refuse(q, INVALID_STORAGE);
        return;
    }
    blob_u16(&q->data, 4); /* removable RAM */
    blob_u16(&q->data, 2); /* a hierarchy of folders */
    blob_u16(&q->data, model->faults.no_delete ? 1 : 2);
    blob_u64(&q->data, UINT64_C(1) << 40);
    blob_u64(&q->data, UINT64_C(1) << 39);
    blob_u32(&q->data, UINT32_MAX);
    blob_string(&q->data, "scans");
    blob_string(&q->data, "");
}

/* Parameters: storage (all ones: every), format (0: every), folder (0: every, all ones: none). */
static bool is_listed(const struct held *held, const uint32_t parameter[5])
{
    const uint32_t folder = parameter[2] == UINT32_MAX ? 0 : parameter[2];

    return !held->removed && (parameter[0] == UINT32_MAX || storage_of(held) == parameter[0]) &&
           (parameter[1] == 0 || held->object.format == parameter[1]) &&
           (parameter[2] == 0 || held->object.parent == folder);
}

static bool may_list(struct ptp_model *model, struct question *q)
{
    const bool all = q->parameter[0] == UINT32_MAX;
    const uint32_t folder = q->parameter[2];

    model->crashed = model->hung;
    if (all ? model->faults.no_list_of_all : !is_storage(model, q->parameter[0])) {
        refuse(q, INVALID_STORAGE);
        model->hung = all;
    } else if (!all && q->parameter[0] >> 16 == model->faults.closed_storage) {
        refuse(q, STORE_NOT_AVAILABLE);
    }
    if (q->answer.code == OK && folder != 0 && folder != UINT32_MAX && !find(model, folder))
        refuse(q, INVALID_HANDLE);
    return q->answer.code == OK;
}

static void get_object_handles(struct ptp_model *model, struct question *q)
{
    uint32_t count = 0;

    if (!may_list(model, q))
        return;
    blob_u32(&q->data, 0);
    for (size_t i = 0; i < model->object_count; i++) {
        if (!is_listed(model->object[i], q->parameter))
            continue;
        blob_u32(&q->data, model->object[i]->handle);
        count++;
    }
    wire_put32(q->data.bytes, count);
}

static void get_num_objects(struct ptp_model *model, struct question *q)
{
    if (!may_list(model, q))
        return;
    q->answer.count = 1;
    for (size_t i = 0; i < model->object_count; i++)
        q->answer.parameter[0] += is_listed(model->object[i], q->parameter);
}

static struct held *asked_for(const struct ptp_model *model, struct question *q)
{
    struct held *const held = find(model, q->parameter[0]);

    if (!held)
        refuse(q, INVALID_HANDLE);
    return held;
}

static void get_object_info(struct ptp_model *model, struct question *q)
{
    struct held *const held = asked_for(model, q);
    struct blob *const data = &q->data;

    if (!held)
        return;
    const uint64_t size = size_now(held);

    held->looks++;
    held->is_measured = model->faults.measures_once;
    held->measured = size;
    blob_u32(data, storage_of(held));
    blob_u16(data, held->object.format);
    blob_u16(data, 0);
    blob_u32(data, size > UINT32_MAX ? UINT32_MAX : (uint32_t)size);
    blob_extend(data, 2 + 6 * 4); /* no thumbnail; width, height and depth unknown */
    blob_u32(data, held->object.parent);
    blob_u16(data, held->object.format == PTP_FOLDER);
    blob_extend(data, 4 + 4);
    blob_string(data, held->object.name);
    blob_string(data, held->object.date);
    blob_string(data, held->object.date);
    blob_string(data, "");
}

static void get_object_prop_value(struct ptp_model *model, struct question *q)
{
    const struct held *const held = asked_for(model, q);

    if (!held)
        return;
    if (q->parameter[1] == PROPERTY_SIZE)
        blob_u64(&q->data, size_now(held));
    else if (q->parameter[1] == PROPERTY_NAME)
        blob_string(&q->data, held->object.name);
    else
        refuse(q, INVALID_PROPERTY);
}

static bool is_bad(const struct ptp_model *model, const struct held *held)
{
    const unsigned nth = model->faults.bad_object;

    return nth > 0 && nth <= model->object_count && model->object[nth - 1] == held;
}

/* The bytes from offset on, most of them. */
static void give_bytes(struct ptp_model *model, struct question *q, uint64_t offset, uint64_t most)
{
    const struct held *const held = asked_for(model, q);

    if (!held)
        return;
    const uint64_t size = size_now(held);

    if (is_bad(model, held) || held->object.format == PTP_FOLDER) {
        refuse(q, is_bad(model, held) ? GENERAL_ERROR : INVALID_HANDLE);
        return;
    }
    if (offset > size) {
        refuse(q, INVALID_PARAMETER);
        return;
    }
    q->payload = (struct ptp_payload){ .size = size - offset < most ? size - offset : most,
                                       .read = held->object.read,
                                       .context = held->object.context,
                                       .offset = offset };
    if (!held->object.read && held->object.bytes)
        q->payload.bytes = held->object.bytes + offset;
    q->answer.payload = &q->payload;
}

static void get_object(struct ptp_model *model, struct question *q)
{
    give_bytes(model, q, 0, UINT64_MAX);
}

static void give_part(struct ptp_model *model, struct question *q, uint64_t offset, uint32_t most)
{
    if (model->faults.crash_above && most > model->faults.crash_above) {
        model->crashed = true;
        return;
    }
    give_bytes(model, q, offset, most);
    q->answer.count = q->answer.code == OK;
    q->answer.parameter[0] = (uint32_t)q->payload.size;
}

static void get_partial_object(struct ptp_model *model, struct question *q)
{
    give_part(model, q, q->parameter[1], q->parameter[2]);
}

static void get_partial_object_64(struct ptp_model *model, struct question *q)
{
    give_part(model, q, q->parameter[1] | (uint64_t)q->parameter[2] << 32, q->parameter[3]);
}

static void get_thumb(struct ptp_model *model, struct question *q)
{
    if (asked_for(model, q))
        refuse(q, NO_THUMBNAIL);
}

static void delete_object(struct ptp_model *model, struct question *q)
{
    struct held *const held = asked_for(model, q);

    if (!held)
        return;
    if (model->faults.no_delete) {
        refuse(q, WRITE_PROTECTED);
        return;
    }
    for (size_t i = 0; i < model->object_count; i++)
        if (!model->object[i]->removed && model->object[i]->object.parent == held->handle)
            refuse(q, PARTIAL_DELETION); /* a folder with something in it */
    held->removed = q->answer.code == OK;
}

static const struct {
    uint16_t operation;
    void (*answer)(struct ptp_model *model, struct question *q);
} operations[] = {
    { GET_DEVICE_INFO, get_device_info },
    { OPEN_SESSION, open_session },
    { CLOSE_SESSION, close_session },
    { GET_STORAGE_IDS, get_storage_ids },
    { GET_STORAGE_INFO, get_storage_info },
    { GET_NUM_OBJECTS, get_num_objects },
    { GET_OBJECT_HANDLES, get_object_handles },
    { GET_OBJECT_INFO, get_object_info },
    { GET_OBJECT, get_object },
    { GET_THUMB, get_thumb },
    { DELETE_OBJECT, delete_object },
    { GET_PARTIAL_OBJECT, get_partial_object },
    { GET_OBJECT_PROP_VALUE, get_object_prop_value },
    { GET_PARTIAL_OBJECT_64, get_partial_object_64 },
};

/* The bus */

static void count_question(struct ptp_model *model, uint16_t operation)
{
    for (size_t i = 0; i < MOST_KINDS; i++) {
        if (model->asked[i].times > 0 && model->asked[i].operation != operation)
            continue;
        model->asked[i].operation = operation;
        model->asked[i].times++;
        return;
    }
}

static void perform(struct ptp_model *model, struct question *q)
{
    const size_t count = sizeof operations / sizeof *operations;
    const bool outside = q->operation == GET_DEVICE_INFO || q->operation == OPEN_SESSION;
    size_t i = 0;

    if (!outside && model->session == 0) {
        refuse(q, SESSION_NOT_OPEN);
        return;
    }
    if (!outside && model->busy > 0) {
        model->busy--;
        refuse(q, BUSY);
        return;
    }
    while (i < count && operations[i].operation != q->operation)
        i++;
    if (i < count && offers(model, q->operation))
        operations[i].answer(model, q);
    else
        refuse(q, NOT_SUPPORTED);
}

static void answer(struct ptp_model *model, struct question *q)
{
    q->answer.operation = q->operation;
    q->answer.transaction = model->transaction;
    q->answer.code = OK;
    q->answer.nth = ++model->transactions;
    ptp_answers_release(model->answers);
    perform(model, q);
    if (q->data.size > 0) {
        q->payload = (struct ptp_payload){ .size = q->data.size,
                                           .bytes = q->data.bytes,
                                           .owned = q->data.bytes };
        q->answer.payload = &q->payload;
    }
    if (!model->crashed && q->answer.nth != model->faults.silent_at)
        ptp_answers_add(model->answers, &q->answer, model->now_ms);
    else
        free(q->data.bytes);
}

static long ptp_out(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    struct ptp_model *const model = self;
    struct question q = { 0 };

    if (model->gone)
        return USB_MODEL_GONE;
    if (endpoint != 0x02 || size < 12 || wire_get32(bytes) != size)
        return USB_MODEL_STALL;
    if (wire_get16(bytes + 4) == 2)
        return (long)size; /* data of an operation that was refused */
    if (wire_get16(bytes + 4) != 1 || size > 32 || size % 4 != 0)
        return USB_MODEL_STALL;
    q.operation = wire_get16(bytes + 6);
    for (size_t i = 0; 12 + 4 * i < size; i++)
        q.parameter[i] = wire_get32(bytes + 12 + 4 * i);
    count_question(model, q.operation);
    if (model->crashed)
        return USB_MODEL_NAK;
    model->transaction = wire_get32(bytes + 8);
    answer(model, &q);
    return (long)size;
}

static long ptp_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    struct ptp_model *const model = self;
    long got;

    if (model->gone)
        return USB_MODEL_GONE;
    if (endpoint == 0x83)
        return give_event(model, buffer, size);
    if (endpoint != 0x81)
        return USB_MODEL_STALL;
    got = ptp_answers_give(model->answers, buffer, size, model->now_ms);
    if (got == USB_MODEL_GONE)
        ptp_model_unplug(model);
    return got;
}

static void restart(struct ptp_model *model)
{
    ptp_answers_clear(model->answers);
    model->event_count = 0;
    model->crashed = model->hung = false;
}

/* Get Device Status (0x67): the endpoint that is halted is named. */
static long get_status(struct ptp_model *model, uint8_t *in, size_t size)
{
    const bool halted = ptp_answers_halted(model->answers);
    uint8_t status[8] = { 0 };
    const size_t length = halted ? 8 : 4;

    wire_put16(status, (uint32_t)length);
    wire_put16(status + 2, halted ? CANCELLED : model->cancelling ? BUSY : OK);
    wire_put32(status + 4, 0x81);
    model->cancelling = 0;
    memcpy(in, status, size < length ? size : length);
    return (long)(size < length ? size : length);
}

/* One status after a cancel is "busy", as the class's definition has it. */
static long cancel(struct ptp_model *model, const uint8_t *out, size_t size)
{
    if (size != 6 || wire_get16(out) != 0x4001)
        return USB_MODEL_STALL;
    if (!model->crashed)
        ptp_answers_clear(model->answers);
    model->cancelling = 1;
    return 0;
}

static long ptp_control(void *self, const uint8_t setup[8], const uint8_t *out, size_t out_size,
                        uint8_t *in, size_t in_size)
{
    struct ptp_model *const model = self;

    if (model->gone)
        return USB_MODEL_GONE;
    if ((setup[0] & 0x60) == 0x20 && setup[4] != 0) /* not of its one interface */
        return USB_MODEL_STALL;
    if (setup[0] == 0xa1 && setup[1] == 0x67)
        return get_status(model, in, in_size);
    if (setup[0] == 0x21 && setup[1] == 0x64)
        return cancel(model, out, out_size);
    if (setup[0] == 0x21 && setup[1] == 0x66) {
        restart(model);
        ptp_answers_clear_halt(model->answers);
        model->session = 0;
        return 0;
    }
    if (setup[0] == 0x02 && setup[1] == 1) { /* CLEAR_FEATURE of an endpoint */
        if (setup[4] == 0x81)
            ptp_answers_clear_halt(model->answers);
        return 0;
    }
    return setup[0] == 0x01 && setup[1] == 11 ? 0 : USB_MODEL_STALL; /* SET_INTERFACE */
}

static void ptp_tick(void *self, int64_t now_ms)
{
    struct ptp_model *const model = self;

    model->now_ms = now_ms;
}

/* The bench's side */

struct ptp_model *ptp_model_new(const char *serial, const struct ptp_faults *faults)
{
    struct ptp_model *const model = grow(NULL, 1, sizeof *model);

    *model = (struct ptp_model){ .serial = strdup(serial) };
    model->answers = ptp_answers_new(&model->faults);
    if (!model->serial || !model->answers)
        abort();
    model->usb = (struct usb_model){ .device = device_descriptor,
                                     .config = ptp_config_descriptor,
                                     .config_size = PTP_CONFIG,
                                     .strings = { NULL, "gieson", "Slide Scanner", model->serial },
                                     .self = model,
                                     .control = ptp_control,
                                     .out = ptp_out,
                                     .in = ptp_in,
                                     .tick = ptp_tick };
    ptp_model_set_faults(model, faults);
    return model;
}

void ptp_model_free(struct ptp_model *model)
{
    if (!model)
        return;
    for (size_t i = 0; i < model->object_count; i++) {
        free((void *)model->object[i]->object.name);
        free((void *)model->object[i]->object.date);
        free(model->object[i]);
    }
    ptp_answers_free(model->answers);
    free(model->object);
    free(model->event);
    free(model->serial);
    free(model);
}

const struct usb_model *ptp_model_usb(const struct ptp_model *model)
{
    return &model->usb;
}

uint32_t ptp_model_add(struct ptp_model *model, const struct ptp_object *object, int announce)
{
    struct held *const held = grow(NULL, 1, sizeof *held);

    *held = (struct held){ .object = *object, .handle = ++model->last_handle };
    held->object.name = strdup(object->name);
    held->object.date = strdup(object->date ? object->date : "");
    if (!held->object.name || !held->object.date)
        abort();
    held->growing = announce && model->faults.size_zero_first;
    model->object = grow(model->object, model->object_count + 1, sizeof *model->object);
    model->object[model->object_count++] = held;
    if (announce) {
        tell(model, OBJECT_ADDED, 0x7fff0000 + held->handle, model->faults.wrong_event_handle);
        tell(model, OBJECT_ADDED, held->handle, 1);
        tell(model, OBJECT_INFO_CHANGED, held->handle, model->faults.changed_flood);
    }
    return held->handle;
}

void ptp_model_write(struct ptp_model *model, uint32_t handle, uint64_t size)
{
    struct held *const held = find(model, handle);

    if (!held)
        return;
    held->object.size = size;
    tell(model, OBJECT_INFO_CHANGED, handle, 1);
}

void ptp_model_complete(struct ptp_model *model, uint32_t handle)
{
    struct held *const held = find(model, handle);

    if (!held || !held->growing)
        return;
    held->growing = false;
    tell(model, OBJECT_INFO_CHANGED, handle, 1);
}

void ptp_model_remove(struct ptp_model *model, uint32_t handle)
{
    struct held *const held = find(model, handle);

    if (!held)
        return;
    held->removed = true;
    tell(model, OBJECT_REMOVED, handle, 1);
}

int ptp_model_has(const struct ptp_model *model, uint32_t handle)
{
    return find(model, handle) != NULL;
}

size_t ptp_model_count(const struct ptp_model *model)
{
    size_t count = 0;

    for (size_t i = 0; i < model->object_count; i++)
        count += !model->object[i]->removed;
    return count;
}

void ptp_model_set_faults(struct ptp_model *model, const struct ptp_faults *faults)
{
    model->faults = faults ? *faults : (struct ptp_faults){ 0 };
    model->busy = model->faults.busy_count;
}

void ptp_model_unplug(struct ptp_model *model)
{
    model->gone = true;
    restart(model);
}

/* The n-th object keeps its place, so that bad_object means the same one. */
static void renumber(struct ptp_model *model)
{
    const uint32_t past = model->last_handle;

    for (size_t i = 0; i < model->object_count; i++) {
        model->object[i]->handle += past;
        if (model->object[i]->object.parent)
            model->object[i]->object.parent += past;
    }
    model->last_handle += past;
}

void ptp_model_replug(struct ptp_model *model)
{
    restart(model);
    ptp_answers_restart(model->answers);
    model->gone = false;
    model->transactions = model->cancelling = 0;
    model->busy = model->faults.busy_count;
    if (!model->faults.session_stays_open)
        model->session = 0;
    if (model->faults.new_handles)
        renumber(model);
}

unsigned ptp_model_asked(const struct ptp_model *model, uint16_t operation)
{
    for (size_t i = 0; i < MOST_KINDS; i++)
        if (model->asked[i].times > 0 && model->asked[i].operation == operation)
            return model->asked[i].times;
    return 0;
}

uint64_t ptp_model_given(const struct ptp_model *model)
{
    return ptp_answers_given(model->answers);
}
