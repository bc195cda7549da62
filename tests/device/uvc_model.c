/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/uvc_model.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "tests/device/blob.h"
#include "tests/device/wire.h"

/* Linux reads bulk payloads in requests of at most 32 packets, 16 KiB at high speed: with a larger
 * payload several requests would share one header, and uvcvideo delivers nothing. */
enum { PAYLOAD = 16384, HEADER = 2, PACKET = 512, PROBE = 34 };

enum { FRAME_ID = 0x01, END_OF_FRAME = 0x02, FAILED = 0x40, END_OF_HEADER = 0x80 };

enum { STREAMING = 1 /* interface */, OUTPUT = 3, VS_PROBE = 1, VS_COMMIT = 2, ERROR_CODE = 2 };

/* Requests, and why one was refused. */
enum {
    SET_CUR = 0x01,
    GET_CUR = 0x81,
    GET_MIN,
    GET_MAX,
    GET_RES,
    GET_LEN,
    GET_INFO,
    GET_DEF,
    WRONG_STATE = 2,
    OUT_OF_RANGE = 4,
    INVALID_CONTROL = 6,
    INVALID_REQUEST = 7,
};

struct control {
    uint8_t entity, selector, size;
    int32_t min, max, step, normal, now;
};

enum { AE_MODE, AE_PRIORITY, EXPOSURE, BRIGHTNESS, GAIN, WHITE, WHITE_AUTO, CONTROLS };

/* The step of the exposure mode is the set of modes there are. */
static const struct control all_controls[CONTROLS] = {
    [AE_MODE] = { UVC_CAMERA, UVC_CAMERA_AE_MODE, 1, 0, 0, 1 | 8, 8, 8 },
    [AE_PRIORITY] = { UVC_CAMERA, UVC_CAMERA_AE_PRIORITY, 1, 0, 1, 1, 0, 0 },
    [EXPOSURE] = { UVC_CAMERA, UVC_CAMERA_EXPOSURE, 4, 1, 10000, 1, 156, 156 },
    [BRIGHTNESS] = { UVC_PROCESSING, UVC_PROCESSING_BRIGHTNESS, 2, -64, 64, 1, 0, 0 },
    [GAIN] = { UVC_PROCESSING, UVC_PROCESSING_GAIN, 2, 0, 255, 1, 64, 64 },
    [WHITE] = { UVC_PROCESSING, UVC_PROCESSING_WHITE, 2, 2800, 6500, 10, 4600, 4600 },
    [WHITE_AUTO] = { UVC_PROCESSING, UVC_PROCESSING_WHITE_AUTO, 1, 0, 1, 1, 1, 1 },
};

struct frame {
    const uint8_t *bytes;
    size_t size;
};

struct uvc_model {
    struct usb_model usb;
    struct uvc_faults faults;
    struct blob config;
    char *serial;
    unsigned width, height, interval_ms;
    struct frame *frame[2];
    size_t frame_count[2];
    struct control control[CONTROLS];
    uint8_t formats[2]; /* by index - 1 */
    unsigned format_count;
    uint8_t probe[PROBE];
    uint8_t refusal;
    bool streaming, halted, gone;
    uint8_t frame_id;
    unsigned begun, begun_in_stream, transfers;
    size_t at; /* in the frame under way */
    uint64_t given;
    int64_t now_ms, next_ms;
};

static const uint8_t device_descriptor[] = {
    18, 1, WIRE16(0x0200), 0xef, 2, 1, 64, WIRE16(0x1209), WIRE16(0x0002), WIRE16(0x0100), 1, 2,
    3,  1,
};

/* Descriptors */

static void add(struct blob *config, const uint8_t *bytes, size_t size)
{
    memcpy(blob_extend(config, size), bytes, size);
}
#define ADD(config, ...)                                                                           \
    add(config, (const uint8_t[]){ __VA_ARGS__ }, sizeof((const uint8_t[]){ __VA_ARGS__ }))

static void add_control_interface(struct blob *config)
{
    ADD(config, 8, 11, 0, 2, 14, 3, 0, 2);   /* association */
    ADD(config, 9, 4, 0, 0, 0, 14, 1, 0, 2); /* interface 0 */
    ADD(config, 13, 0x24, 1, WIRE16(0x0110), WIRE16(52), WIRE32(48000000), 1, STREAMING);
    ADD(config, 18, 0x24, 2, UVC_CAMERA, WIRE16(0x0201), 0, 0, WIRE16(0), WIRE16(0), WIRE16(0), 3,
        0x0e, 0, 0); /* exposure: mode, priority, time */
    ADD(config, 12, 0x24, 5, UVC_PROCESSING, UVC_CAMERA, WIRE16(0), 2, WIRE16(0x1241), 0,
        0); /* brightness, white balance, gain, automatic white balance */
    ADD(config, 9, 0x24, 3, OUTPUT, WIRE16(0x0101), 0, UVC_PROCESSING, 0);
}

static size_t largest(const struct uvc_model *model)
{
    return (size_t)model->width * model->height * 2;
}

static void add_frame_size(const struct uvc_model *model, struct blob *config, uint8_t subtype)
{
    const uint32_t size = (uint32_t)largest(model), interval = model->interval_ms * 10000;
    const uint32_t rate = size * 8 / (model->interval_ms ? model->interval_ms : 1) * 1000;

    ADD(config, 30, 0x24, subtype, 1, 0, WIRE16(model->width), WIRE16(model->height), WIRE32(rate),
        WIRE32(rate), WIRE32(size), WIRE32(interval), 1, WIRE32(interval));
}

static void add_format(const struct uvc_model *model, struct blob *config, uint8_t index,
                       enum uvc_format format)
{
    if (format == UVC_YUY2) {
        ADD(config, 27, 0x24, 4, index, 1, 'Y', 'U', 'Y', '2', 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0,
            0x38, 0x9b, 0x71, 16, 1, 0, 0, 0, 0);
        add_frame_size(model, config, 5);
    } else {
        ADD(config, 11, 0x24, 6, index, 1, 1, 1, 0, 0, 0, 0);
        add_frame_size(model, config, 7);
    }
}

static void add_streaming_interface(struct uvc_model *model, struct blob *config)
{
    const uint8_t count = (uint8_t)model->format_count;
    const size_t start = config->size + 9;

    ADD(config, 9, 4, STREAMING, 0, 1, 14, 2, 0, 2);
    ADD(config, (uint8_t)(13 + count), 0x24, 1, count, 0, 0, 0x81, 0, OUTPUT, 0, 0, 0, 1);
    blob_extend(config, count);
    for (uint8_t i = 0; i < count; i++)
        add_format(model, config, (uint8_t)(i + 1), model->formats[i]);
    wire_put16(config->bytes + start + 4, (uint32_t)(config->size - start));
    ADD(config, 7, 5, 0x81, 2, WIRE16(PACKET), 0);
}

static void describe(struct uvc_model *model)
{
    struct blob *const config = &model->config;

    for (unsigned format = UVC_YUY2; format <= UVC_MJPEG; format++)
        if (model->frame_count[format] > 0)
            model->formats[model->format_count++] = (uint8_t)format;
    ADD(config, 9, 2, 0, 0, 2, 1, 0, 0xc0, 50);
    add_control_interface(config);
    add_streaming_interface(model, config);
    wire_put16(config->bytes + 2, (uint32_t)config->size);
}

/* Controls */

static bool is_automatic(const struct uvc_model *model, size_t which)
{
    return (which == EXPOSURE && model->control[AE_MODE].now != 1) ||
           (which == WHITE && model->control[WHITE_AUTO].now != 0);
}

static long refuse(struct uvc_model *model, uint8_t why)
{
    model->refusal = why;
    return USB_MODEL_STALL;
}

static long give(uint8_t *in, size_t in_size, uint32_t value, size_t size)
{
    uint8_t bytes[4];

    wire_put32(bytes, value);
    if (size > in_size)
        size = in_size;
    memcpy(in, bytes, size);
    return (long)size;
}

static int32_t read_value(const uint8_t *out, const struct control *control)
{
    const uint32_t raw = control->size == 4   ? wire_get32(out)
                         : control->size == 2 ? wire_get16(out)
                                              : out[0];

    return control->size == 2 ? (int16_t)raw : (int32_t)raw;
}

static long set_control(struct uvc_model *model, size_t which, const uint8_t *out, size_t out_size)
{
    struct control *const control = &model->control[which];

    if (out_size < control->size)
        return refuse(model, INVALID_REQUEST);
    if (is_automatic(model, which))
        return refuse(model, WRONG_STATE);
    const int32_t value = read_value(out, control);

    if (which == AE_MODE ? value != 1 && value != 8 : value < control->min || value > control->max)
        return refuse(model, OUT_OF_RANGE);
    if (model->faults.always_automatic &&
        ((which == AE_MODE && value == 1) || (which == WHITE_AUTO && value == 0)))
        return refuse(model, WRONG_STATE);
    if (which != GAIN || !model->faults.forgets_gain)
        control->now = value;
    return 0;
}

static long ask_control(struct uvc_model *model, size_t which, uint8_t request, uint8_t *in,
                        size_t in_size)
{
    const struct control *const control = &model->control[which];

    switch (request) {
    case GET_CUR:
        return give(in, in_size, (uint32_t)control->now, control->size);
    case GET_MIN:
        return give(in, in_size, (uint32_t)control->min, control->size);
    case GET_MAX:
        return give(in, in_size, (uint32_t)control->max, control->size);
    case GET_RES:
        return give(in, in_size, (uint32_t)control->step, control->size);
    case GET_DEF:
        return give(in, in_size, (uint32_t)control->normal, control->size);
    case GET_LEN:
        return give(in, in_size, control->size, 2);
    case GET_INFO: /* can be got and set; set by the camera itself just now */
        return give(in, in_size, is_automatic(model, which) ? 3 | 4 : 3, 1);
    default:
        return refuse(model, INVALID_REQUEST);
    }
}

static long entity_request(struct uvc_model *model, const uint8_t setup[8], const uint8_t *out,
                           size_t out_size, uint8_t *in, size_t in_size)
{
    const uint8_t entity = setup[5], selector = setup[3];

    if (entity == 0 && selector == ERROR_CODE && setup[1] == GET_CUR)
        return give(in, in_size, model->refusal, 1);
    for (size_t i = 0; i < CONTROLS; i++) {
        if (model->control[i].entity != entity || model->control[i].selector != selector)
            continue;
        return setup[1] == SET_CUR ? set_control(model, i, out, out_size)
                                   : ask_control(model, i, setup[1], in, in_size);
    }
    return refuse(model, INVALID_CONTROL);
}

/* Streaming */

static void fill_probe(struct uvc_model *model)
{
    uint8_t *const probe = model->probe;

    if (probe[2] < 1 || probe[2] > model->format_count)
        probe[2] = 1;
    probe[3] = 1;
    wire_put32(probe + 4, model->interval_ms * 10000);
    wire_put32(probe + 18, (uint32_t)largest(model));
    wire_put32(probe + 22, PAYLOAD);
    wire_put32(probe + 26, 48000000);
    probe[30] = 3; /* frame id and end of frame are told */
}

static long set_probe(struct uvc_model *model, uint8_t selector, const uint8_t *out, size_t size)
{
    if (size < 26)
        return USB_MODEL_STALL;
    model->probe[2] = out[2];
    fill_probe(model);
    if (selector == VS_COMMIT) {
        model->streaming = true;
        model->at = 0;
        model->begun_in_stream = 0;
        model->next_ms = model->now_ms;
    }
    return 0;
}

static long streaming_request(struct uvc_model *model, const uint8_t setup[8], const uint8_t *out,
                              size_t out_size, uint8_t *in, size_t in_size)
{
    const uint8_t selector = setup[3];

    if (selector != VS_PROBE && selector != VS_COMMIT)
        return USB_MODEL_STALL;
    fill_probe(model);
    switch (setup[1]) {
    case SET_CUR:
        return set_probe(model, selector, out, out_size);
    case GET_CUR:
    case GET_MIN:
    case GET_MAX:
    case GET_DEF:
        if (in_size > PROBE)
            in_size = PROBE;
        memcpy(in, model->probe, in_size);
        return (long)in_size;
    case GET_LEN:
        return give(in, in_size, PROBE, 2);
    case GET_INFO:
        return give(in, in_size, 3, 1);
    default:
        return USB_MODEL_STALL;
    }
}

/* Clearing the halt of an endpoint that is not halted is how a host ends a bulk stream. */
static long clear_halt(struct uvc_model *model)
{
    if (!model->halted)
        model->streaming = false;
    model->halted = false;
    return 0;
}

static long uvc_control(void *self, const uint8_t setup[8], const uint8_t *out, size_t out_size,
                        uint8_t *in, size_t in_size)
{
    struct uvc_model *const model = self;

    if (model->gone)
        return USB_MODEL_GONE;
    if (setup[0] == 0x02 && setup[1] == 1)
        return clear_halt(model);
    if (setup[0] == 0x01 && setup[1] == 11) /* SET_INTERFACE */
        return 0;
    if (setup[0] != 0x21 && setup[0] != 0xa1)
        return USB_MODEL_STALL;
    return setup[4] == STREAMING ? streaming_request(model, setup, out, out_size, in, in_size)
                                 : entity_request(model, setup, out, out_size, in, in_size);
}

static void wander(struct uvc_model *model)
{
    static const int32_t step[] = { 3, 1, -2, 4, -5, -1 };
    const int32_t by = step[model->begun % (sizeof step / sizeof *step)];

    if (is_automatic(model, EXPOSURE))
        model->control[EXPOSURE].now += by;
    if (is_automatic(model, WHITE))
        model->control[WHITE].now += by * 10;
}

static void begin_frame(struct uvc_model *model)
{
    model->begun++;
    model->begun_in_stream++;
    wander(model);
}

static const struct frame *frame_now(const struct uvc_model *model)
{
    const enum uvc_format format = model->formats[model->probe[2] - 1];
    const size_t count = model->frame_count[format];

    return &model->frame[format][(model->begun_in_stream - 1) % count];
}

static void end_frame(struct uvc_model *model)
{
    model->at = 0;
    model->frame_id ^= FRAME_ID;
    model->next_ms = model->now_ms + model->interval_ms;
}

/* One payload: a header of two bytes, and what fits of the frame. */
static long give_payload(struct uvc_model *model, uint8_t *buffer, size_t size)
{
    const struct uvc_faults *const faults = &model->faults;
    size_t whole, n = size < PAYLOAD ? size - HEADER : PAYLOAD - HEADER;

    if (model->at == 0)
        begin_frame(model);
    whole = model->begun == faults->short_frame_at ? frame_now(model)->size / 2
                                                   : frame_now(model)->size;
    if (n > whole - model->at)
        n = whole - model->at;
    memcpy(buffer + HEADER, frame_now(model)->bytes + model->at, n);
    buffer[0] = HEADER;
    buffer[1] = END_OF_HEADER | model->frame_id;
    if (model->begun == faults->error_at)
        buffer[1] |= FAILED;
    model->at += n;
    if (model->at == whole) {
        buffer[1] |= END_OF_FRAME;
        end_frame(model);
    }
    return (long)(n + HEADER);
}

static bool is_silent(const struct uvc_model *model)
{
    const unsigned after = model->faults.silent_after;

    return !model->streaming || (model->at == 0 && model->now_ms < model->next_ms) ||
           (after && model->at == 0 && model->begun_in_stream >= after);
}

static long uvc_in(void *self, uint8_t endpoint, uint8_t *buffer, size_t size)
{
    struct uvc_model *const model = self;
    const struct uvc_faults *const faults = &model->faults;
    long got;

    if (model->gone)
        return USB_MODEL_GONE;
    if (endpoint != 0x81 || model->halted)
        return USB_MODEL_STALL;
    if (is_silent(model) || size <= HEADER)
        return USB_MODEL_NAK;
    if (++model->transfers == faults->stall_at) {
        model->halted = true;
        return USB_MODEL_STALL;
    }
    got = give_payload(model, buffer, size);
    model->given += (uint64_t)got;
    if (faults->unplug_at_byte && model->given >= faults->unplug_at_byte) {
        uvc_model_unplug(model);
        return USB_MODEL_GONE;
    }
    return got;
}

static long uvc_out(void *self, uint8_t endpoint, const uint8_t *bytes, size_t size)
{
    const struct uvc_model *const model = self;

    (void)endpoint;
    (void)bytes;
    (void)size;
    return model->gone ? USB_MODEL_GONE : USB_MODEL_STALL;
}

static void uvc_tick(void *self, int64_t now_ms)
{
    struct uvc_model *const model = self;

    model->now_ms = now_ms;
}

/* The bench's side */

struct uvc_model *uvc_model_new(const char *serial, unsigned width, unsigned height,
                                unsigned interval_ms, const struct uvc_faults *faults)
{
    struct uvc_model *const model = calloc(1, sizeof *model);

    if (!model)
        abort();
    model->serial = strdup(serial);
    if (!model->serial)
        abort();
    model->width = width;
    model->height = height;
    model->interval_ms = interval_ms;
    memcpy(model->control, all_controls, sizeof all_controls);
    uvc_model_set_faults(model, faults);
    return model;
}

void uvc_model_free(struct uvc_model *model)
{
    if (!model)
        return;
    free(model->frame[UVC_YUY2]);
    free(model->frame[UVC_MJPEG]);
    free(model->config.bytes);
    free(model->serial);
    free(model);
}

void uvc_model_add(struct uvc_model *model, enum uvc_format format, const uint8_t *bytes,
                   size_t size)
{
    const size_t count = model->frame_count[format];
    struct frame *const frames = reallocarray(model->frame[format], count + 1, sizeof *frames);

    if (!frames)
        abort();
    frames[count] = (struct frame){ bytes, size };
    model->frame[format] = frames;
    model->frame_count[format]++;
}

/* Where the JPEG that begins here ends: before the next that begins right after an end. */
static size_t jpeg_size(const uint8_t *bytes, size_t size)
{
    static const uint8_t seam[] = { 0xff, 0xd9, 0xff, 0xd8 };

    for (size_t i = 2; i + sizeof seam <= size; i++)
        if (memcmp(bytes + i, seam, sizeof seam) == 0)
            return i + 2;
    return size;
}

/* The header of a PAM (netpbm's P7) with a YUYV picture of the model's size; 0 for anything else.
 */
static size_t pam_header(const struct uvc_model *model, const uint8_t *bytes, size_t size)
{
    static const char start[] = "P7\n", end[] = "\nENDHDR\n";
    const uint8_t *const found = memmem(bytes, size, end, sizeof end - 1);
    char lines[3][40], text[4096];
    size_t length;

    if (size < sizeof start || memcmp(bytes, start, sizeof start - 1) != 0 || !found)
        return 0;
    length = (size_t)(found - bytes) + sizeof end - 1;
    if (length >= sizeof text)
        return 0;
    memcpy(text, bytes, length);
    text[length] = '\0';
    (void)snprintf(lines[0], sizeof lines[0], "\nWIDTH %u\n", model->width);
    (void)snprintf(lines[1], sizeof lines[1], "\nHEIGHT %u\n", model->height);
    (void)snprintf(lines[2], sizeof lines[2], "\nTUPLTYPE YUYV\n");
    for (size_t i = 0; i < 3; i++)
        if (!strstr(text, lines[i]))
            return 0;
    return length;
}

size_t uvc_model_add_file(struct uvc_model *model, const uint8_t *bytes, size_t size)
{
    const bool jpeg = size >= 4 && bytes[0] == 0xff && bytes[1] == 0xd8;
    const size_t raw = largest(model);
    size_t count = 0;

    for (size_t at = 0; at < size; count++) {
        const size_t header = jpeg ? 0 : pam_header(model, bytes + at, size - at);
        const size_t n = jpeg ? jpeg_size(bytes + at, size - at) : raw;

        if (n == 0 || header + n > size - at)
            return 0;
        uvc_model_add(model, jpeg ? UVC_MJPEG : UVC_YUY2, bytes + at + header, n);
        at += header + n;
    }
    return count;
}

const struct usb_model *uvc_model_usb(struct uvc_model *model)
{
    if (model->config.size == 0) {
        describe(model);
        fill_probe(model);
    }
    model->usb =
        (struct usb_model){ .device = device_descriptor,
                            .config = model->config.bytes,
                            .config_size = model->config.size,
                            .strings = { NULL, "gieson", "Specimen Camera", model->serial },
                            .self = model,
                            .control = uvc_control,
                            .out = uvc_out,
                            .in = uvc_in,
                            .tick = uvc_tick };
    return &model->usb;
}

void uvc_model_set_faults(struct uvc_model *model, const struct uvc_faults *faults)
{
    model->faults = faults ? *faults : (struct uvc_faults){ 0 };
}

void uvc_model_unplug(struct uvc_model *model)
{
    model->gone = true;
}

/* A camera that lost its power forgets what was set. */
void uvc_model_replug(struct uvc_model *model)
{
    memcpy(model->control, all_controls, sizeof all_controls);
    model->gone = model->streaming = model->halted = false;
    model->begun = model->transfers = 0;
    model->given = 0;
    model->at = 0;
}

int32_t uvc_model_value(const struct uvc_model *model, unsigned entity, unsigned selector)
{
    for (size_t i = 0; i < CONTROLS; i++)
        if (model->control[i].entity == entity && model->control[i].selector == selector)
            return model->control[i].now;
    return INT32_MIN;
}

unsigned uvc_model_frames(const struct uvc_model *model)
{
    return model->begun;
}
