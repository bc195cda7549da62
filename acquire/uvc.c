/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The descriptors of a USB Video Class camera (1.0 to 1.5), read before anybody opens it.
 *
 * Steps. The configuration is walked descriptor by descriptor (USB 2.0, 9.5): the camera terminal
 * and the processing unit of the VideoControl interface say which controls there are
 * (UVC 1.5, 3.7.2.3 and 3.7.2.5); the VideoStreaming interface says formats and frame sizes with
 * their shortest interval. A camera can be locked when automatic exposure and white balance can be
 * switched off and their values and the gain be set.
 *
 * How it fails: GSN_E_INPUT for a descriptor that is shorter than what it must hold,
 * GSN_E_UNSUPPORTED for a device that is no camera. Lengths are the device's and are not trusted.
 */
#include "acquire/uvc.h"

#include <stdbool.h>
#include <stdio.h>
#include <string.h>

/* USB 2.0, table 9-5; USB Video Class 1.5, annex A. */
enum { DEVICE = 1, CONFIGURATION = 2, INTERFACE = 4, ENDPOINT = 5, CLASS_SPECIFIC = 0x24 };
enum { CLASS_VIDEO = 14, SUBCLASS_CONTROL = 1, SUBCLASS_STREAMING = 2 };
enum { VC_HEADER = 1, VC_INPUT_TERMINAL = 2, VC_PROCESSING_UNIT = 5, ITT_CAMERA = 0x0201 };
enum {
    VS_FORMAT_UNCOMPRESSED = 4,
    VS_FRAME_UNCOMPRESSED = 5,
    VS_FORMAT_MJPEG = 6,
    VS_FRAME_MJPEG = 7,
    VS_FORMAT_FRAME_BASED = 0x10,
    VS_FRAME_FRAME_BASED = 0x11,
};
enum { ISOCHRONOUS = 1, BULK = 2 };

/* bmControls: bits of the camera terminal and of the processing unit. */
enum { CT_AE_MODE = 1, CT_EXPOSURE_ABSOLUTE = 3 };
enum { PU_WHITE_BALANCE = 6, PU_GAIN = 9, PU_WHITE_BALANCE_AUTO = 12 };

struct walk {
    const uint8_t *bytes;
    size_t size, at;
    unsigned subclass; /* of the video interface we are in; 0: another interface */
    uint8_t interface;
    bool has_control;
    unsigned left; /* sizes the present format has still to list */
    struct gsn_uvc *uvc;
};

static unsigned get_u16(const uint8_t *at)
{
    return at[0] | (unsigned)at[1] << 8;
}

static uint32_t get_u32(const uint8_t *at)
{
    return get_u16(at) | (uint32_t)get_u16(at + 2) << 16;
}

static int too_short(const struct walk *walk, const char *what, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT, "the %s at byte %zu of the descriptors is cut short", what,
                    walk->at);
}

/* Up to three bytes of bits, least significant first, from at on. */
static uint32_t bits_of(const uint8_t *at, unsigned size)
{
    uint32_t bits = 0;

    for (unsigned i = 0; i < size && i < 4; i++)
        bits |= (uint32_t)at[i] << 8 * i;
    return bits;
}

static int read_control(struct walk *walk, const uint8_t *at, size_t length, struct gsn_error *err)
{
    switch (at[2]) {
    case VC_HEADER:
        if (length < 12)
            return too_short(walk, "header of the control interface", err);
        walk->uvc->version = (uint16_t)get_u16(at + 3);
        walk->has_control = true;
        return GSN_OK;
    case VC_INPUT_TERMINAL:
        if (length < 8)
            return too_short(walk, "input terminal", err);
        if (get_u16(at + 4) != ITT_CAMERA)
            return GSN_OK;
        if (length < 15 || length < 15U + at[14])
            return too_short(walk, "camera terminal", err);
        walk->uvc->terminal |= bits_of(at + 15, at[14]);
        return GSN_OK;
    case VC_PROCESSING_UNIT:
        if (length < 8 || length < 8U + at[7])
            return too_short(walk, "processing unit", err);
        walk->uvc->processing |= bits_of(at + 8, at[7]);
        return GSN_OK;
    default:
        return GSN_OK;
    }
}

/* A GUID that names a FourCC: XXXXXXXX-0000-0010-8000-00AA00389B71. */
static void name_guid(const uint8_t *guid, char ret_name[5])
{
    static const uint8_t rest[12] = { 0, 0, 0x10, 0, 0x80, 0, 0, 0xaa, 0, 0x38, 0x9b, 0x71 };

    memcpy(ret_name, "????", 5);
    if (memcmp(guid + 4, rest, sizeof rest) != 0)
        return;
    for (unsigned i = 0; i < 4; i++)
        ret_name[i] = guid[i] >= ' ' && guid[i] <= '~' ? (char)guid[i] : '?';
}

/* A format may not begin before the one before it has listed its sizes. */
static int end_format(const struct walk *walk, struct gsn_error *err)
{
    const struct gsn_uvc *const uvc = walk->uvc;

    if (walk->left == 0)
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT, "format %s of interface %u states %u sizes and lists %u",
                    uvc->format[uvc->format_count - 1].name,
                    uvc->format[uvc->format_count - 1].interface,
                    uvc->format[uvc->format_count - 1].sizes,
                    uvc->format[uvc->format_count - 1].sizes - walk->left);
}

static int read_format(struct walk *walk, const uint8_t *at, size_t length, struct gsn_error *err)
{
    struct gsn_uvc *const uvc = walk->uvc;
    struct gsn_uvc_format *const format = &uvc->format[uvc->format_count];
    const bool has_guid = at[2] != VS_FORMAT_MJPEG;
    const int r = end_format(walk, err);

    if (r < 0)
        return r;
    if (length < (has_guid ? 27 : 11))
        return too_short(walk, "format", err);
    if (uvc->format_count == GSN_UVC_MOST_FORMATS)
        return gsn_fail(err, GSN_E_LIMIT, "the camera lists more than %d formats",
                        GSN_UVC_MOST_FORMATS);
    *format = (struct gsn_uvc_format){
        .name = "MJPG", .index = at[3], .interface = walk->interface, .sizes = at[4]
    };
    if (has_guid)
        name_guid(at + 5, format->name);
    uvc->format_count++;
    walk->left = format->sizes;
    return GSN_OK;
}

/* The shortest of the intervals from at on: that many, or (none stated) a range from the first. */
static int shortest_of(const struct walk *walk, const uint8_t *at, size_t room, unsigned count,
                       uint32_t *ret_shortest, struct gsn_error *err)
{
    const size_t needed = 4 * (size_t)(count ? count : 3);

    if (room < needed)
        return too_short(walk, "list of intervals", err);
    *ret_shortest = get_u32(at);
    for (unsigned i = 1; i < count; i++)
        *ret_shortest = get_u32(at + 4 * (size_t)i) < *ret_shortest ? get_u32(at + 4 * (size_t)i)
                                                                    : *ret_shortest;
    return GSN_OK;
}

static int read_size(struct walk *walk, const uint8_t *at, size_t length, struct gsn_error *err)
{
    const size_t count_at = at[2] == VS_FRAME_FRAME_BASED ? 21 : 25;
    struct gsn_uvc *const uvc = walk->uvc;
    struct gsn_uvc_size size = { 0 };
    int r;

    if (length < 26)
        return too_short(walk, "frame size", err);
    if (walk->left == 0)
        return gsn_fail(err, GSN_E_INPUT,
                        "a frame size at byte %zu belongs to no format, or is one more than that "
                        "states",
                        walk->at);
    if (uvc->size_count == GSN_UVC_MOST_SIZES)
        return gsn_fail(err, GSN_E_LIMIT, "the camera lists more than %d sizes",
                        GSN_UVC_MOST_SIZES);
    size.format = uvc->format_count - 1;
    size.width = get_u16(at + 5);
    size.height = get_u16(at + 7);
    if (!size.width || !size.height)
        return gsn_fail(err, GSN_E_INPUT, "a frame of %u x %u pixels at byte %zu", size.width,
                        size.height, walk->at);
    r = shortest_of(walk, at + 26, length - 26, at[count_at], &size.shortest, err);
    if (r < 0)
        return r;
    uvc->size[uvc->size_count++] = size;
    walk->left--;
    return GSN_OK;
}

static int read_streaming(struct walk *walk, const uint8_t *at, size_t length,
                          struct gsn_error *err)
{
    switch (at[2]) {
    case VS_FORMAT_UNCOMPRESSED:
    case VS_FORMAT_MJPEG:
    case VS_FORMAT_FRAME_BASED:
        return read_format(walk, at, length, err);
    case VS_FRAME_UNCOMPRESSED:
    case VS_FRAME_MJPEG:
    case VS_FRAME_FRAME_BASED:
        return read_size(walk, at, length, err);
    default:
        return GSN_OK;
    }
}

static int read_interface(struct walk *walk, const uint8_t *at, size_t length,
                          struct gsn_error *err)
{
    if (length < 9)
        return too_short(walk, "interface", err);
    walk->subclass = at[5] == CLASS_VIDEO ? at[6] : 0;
    walk->interface = at[2];
    return end_format(walk, err);
}

static int read_endpoint(struct walk *walk, const uint8_t *at, size_t length, struct gsn_error *err)
{
    if (length < 7)
        return too_short(walk, "endpoint", err);
    if (walk->subclass != SUBCLASS_STREAMING)
        return GSN_OK;
    walk->uvc->is_isochronous |= (at[3] & 3) == ISOCHRONOUS;
    walk->uvc->is_bulk |= (at[3] & 3) == BULK;
    return GSN_OK;
}

static int read_one(struct walk *walk, const uint8_t *at, size_t length, struct gsn_error *err)
{
    switch (at[1]) {
    case INTERFACE:
        return read_interface(walk, at, length, err);
    case ENDPOINT:
        return read_endpoint(walk, at, length, err);
    case CLASS_SPECIFIC:
        if (length < 3 || !walk->subclass)
            return GSN_OK;
        if (walk->subclass == SUBCLASS_CONTROL)
            return read_control(walk, at, length, err);
        return walk->subclass == SUBCLASS_STREAMING ? read_streaming(walk, at, length, err)
                                                    : GSN_OK;
    default:
        return GSN_OK;
    }
}

static int begin_walk(struct walk *walk, struct gsn_error *err)
{
    const uint8_t *const config = walk->bytes + 18;
    size_t total;

    if (walk->size < 18 + 9 || walk->bytes[0] != 18 || walk->bytes[1] != DEVICE || config[0] < 9 ||
        config[1] != CONFIGURATION)
        return gsn_fail(err, GSN_E_INPUT,
                        "no device descriptor and configuration of USB at the beginning");
    total = get_u16(config + 2);
    if (total < config[0] || total > walk->size - 18)
        return gsn_fail(err, GSN_E_INPUT, "the configuration states %zu bytes, %zu are there",
                        total, walk->size - 18);
    walk->uvc->vendor = (uint16_t)get_u16(walk->bytes + 8);
    walk->uvc->product = (uint16_t)get_u16(walk->bytes + 10);
    walk->at = 18 + (size_t)config[0];
    walk->size = 18 + total; /* a second configuration is not in use */
    return GSN_OK;
}

static int walk_all(struct walk *walk, struct gsn_error *err)
{
    int r = begin_walk(walk, err);

    while (r >= 0 && walk->at < walk->size) {
        const uint8_t *const at = walk->bytes + walk->at;
        const size_t left = walk->size - walk->at;

        if (left < 2 || at[0] < 2 || at[0] > left)
            return gsn_fail(err, GSN_E_INPUT,
                            "the descriptor at byte %zu states %u bytes, %zu are left", walk->at,
                            at[0], left);
        r = read_one(walk, at, at[0], err);
        walk->at += at[0];
    }
    return r < 0 ? r : end_format(walk, err);
}

int gsn_uvc_parse(const void *bytes, size_t size, struct gsn_uvc **ret_uvc, struct gsn_error *err)
{
    gsn_auto(gsn_uvc) uvc = gsn_alloc_array(1, sizeof *uvc);
    struct walk walk = { .bytes = bytes, .size = size, .uvc = uvc };
    int r;

    if (!uvc)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a camera's descriptors");
    r = walk_all(&walk, err);
    if (r < 0)
        return r;
    if (!walk.has_control)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "%04x:%04x is no camera of the USB Video Class",
                        uvc->vendor, uvc->product);
    if (uvc->size_count == 0)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "%04x:%04x is a video device that lists no picture",
                        uvc->vendor, uvc->product);
    *ret_uvc = gsn_steal(&uvc);
    return GSN_OK;
}

void gsn_uvc_free(struct gsn_uvc *uvc)
{
    gsn_free(uvc);
}

static void add_reason(char *reason, size_t size, bool has, const char *what)
{
    const size_t used = strlen(reason);

    if (!has && used < size)
        (void)snprintf(reason + used, size - used, "%s%s", used ? "; " : "", what);
}

int gsn_uvc_can_be_locked(const struct gsn_uvc *uvc, char *ret_reason, size_t size)
{
    const uint32_t ct = uvc->terminal, pu = uvc->processing;

    ret_reason[0] = '\0';
    add_reason(ret_reason, size, ct >> CT_AE_MODE & 1,
               "its automatic exposure cannot be switched off");
    add_reason(ret_reason, size, ct >> CT_EXPOSURE_ABSOLUTE & 1, "no exposure time");
    add_reason(ret_reason, size, pu >> PU_GAIN & 1, "no gain");
    add_reason(ret_reason, size, pu >> PU_WHITE_BALANCE & 1, "no white balance");
    add_reason(ret_reason, size, pu >> PU_WHITE_BALANCE_AUTO & 1,
               "its automatic white balance cannot be switched off");
    return ret_reason[0] == '\0';
}
