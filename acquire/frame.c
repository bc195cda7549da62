/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A camera's frame as a file that says how it was taken.
 *
 * Steps.
 * 1. The table of pixel formats says what each layout becomes: bytes as they are, 16-bit words with
 * the high byte first, packed CSI-2 samples taken apart, NV12 row by row, JPEG as it is.
 * 2. Raw layouts become a PAM whose comment lines hold device, format, colours and each control,
 * locked or not; the samples are those of the payload, bit for bit.
 * 3. A frame of Motion JPEG is walked (ITU T.81) to its EOI and becomes a JPEG that stands alone: a
 *    comment segment with the same lines, and the standard Huffman tables (K.3 to K.6), which
 * Motion JPEG leaves out.
 * 4. The same facts as JSON go beside the panel's row.
 *
 * How it fails: GSN_E_INPUT for a payload that is short or of another size than was agreed. Text
 * that runs out of memory says so at its end, not at each piece. */
#include "acquire/frame.h"

#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

/* Text that grows. */

/* Room for size more characters and the zero behind them. */
static bool make_text_room(struct gsn_text *text, size_t size)
{
    const size_t room = 2 * (text->used + size + 1);
    char *at;

    if (!text->starved && text->room < text->used + size + 1) {
        at = gsn_realloc_array(text->at, room, 1);
        text->starved = !at;
        text->at = at ? at : text->at;
        text->room = at ? room : text->room;
    }
    return !text->starved;
}

void gsn_text_add(struct gsn_text *text, const char *format, ...)
{
    va_list args, again;
    int size;

    va_start(args, format);
    va_copy(again, args);
    size = vsnprintf(NULL, 0, format, args);
    if (size >= 0 && make_text_room(text, (size_t)size)) {
        (void)vsnprintf(text->at + text->used, (size_t)size + 1, format, again);
        text->used += (size_t)size;
    }
    va_end(again);
    va_end(args);
}

static char plain_character(char c)
{
    return c >= ' ' && c <= '~' ? c : '?';
}

/* One line of what a device said: control characters and bytes that are no ASCII become '?'. */
static void add_line(struct gsn_text *text, const char *key, const char *value)
{
    gsn_text_add(text, "# %s: ", key);
    for (size_t i = 0; value[i]; i++)
        gsn_text_add(text, "%c", plain_character(value[i]));
    gsn_text_add(text, "\n");
}

/* A JSON string with its quotes. Bytes that are no ASCII become '?'. */
static void add_json_string(struct gsn_text *text, const char *value)
{
    gsn_text_add(text, "\"");
    for (size_t i = 0; value[i]; i++) {
        const char c = plain_character(value[i]);

        gsn_text_add(text, c == '"' || c == '\\' ? "\\%c" : "%c", c);
    }
    gsn_text_add(text, "\"");
}

/* libcamera names a layout as DRM does, from the high byte of a little-endian word: its BGR888 has
 * the bytes R, G, B. V4L2 and libcamera agree about the letters of Bayer patterns: first row first.
 */
static const struct gsn_pixel_format formats[] = {
    { "YUYV", "YUYV", GSN_PACKING_BYTES, 2, 8, "YUYV", 0, 2 },
    { "UYVY", "UYVY", GSN_PACKING_BYTES, 2, 8, "UYVY", 1, 2 },
    { "NV12", "NV12", GSN_PACKING_NV12, 1, 8, "NV12", 0, 1 },
    { "RGB3", "BGR888", GSN_PACKING_BYTES, 3, 8, "RGB", 1, 3 },
    { "BGR3", "RGB888", GSN_PACKING_BYTES, 3, 8, "BGR", 1, 3 },
    { "GREY", "R8", GSN_PACKING_BYTES, 1, 8, "GRAYSCALE", 0, 1 },
    { "Y10 ", "R10", GSN_PACKING_WORDS, 1, 10, "GRAYSCALE", 0, 0 },
    { "Y12 ", "R12", GSN_PACKING_WORDS, 1, 12, "GRAYSCALE", 0, 0 },
    { "Y16 ", "R16", GSN_PACKING_WORDS, 1, 16, "GRAYSCALE", 0, 0 },
    { "BA81", "SBGGR8", GSN_PACKING_BYTES, 1, 8, "BAYER_BGGR", 0, 1 },
    { "GBRG", "SGBRG8", GSN_PACKING_BYTES, 1, 8, "BAYER_GBRG", 0, 1 },
    { "GRBG", "SGRBG8", GSN_PACKING_BYTES, 1, 8, "BAYER_GRBG", 0, 1 },
    { "RGGB", "SRGGB8", GSN_PACKING_BYTES, 1, 8, "BAYER_RGGB", 0, 1 },
    { "BG10", "SBGGR10", GSN_PACKING_WORDS, 1, 10, "BAYER_BGGR", 0, 0 },
    { "GB10", "SGBRG10", GSN_PACKING_WORDS, 1, 10, "BAYER_GBRG", 0, 0 },
    { "BA10", "SGRBG10", GSN_PACKING_WORDS, 1, 10, "BAYER_GRBG", 0, 0 },
    { "RG10", "SRGGB10", GSN_PACKING_WORDS, 1, 10, "BAYER_RGGB", 0, 0 },
    { "BG12", "SBGGR12", GSN_PACKING_WORDS, 1, 12, "BAYER_BGGR", 0, 0 },
    { "GB12", "SGBRG12", GSN_PACKING_WORDS, 1, 12, "BAYER_GBRG", 0, 0 },
    { "BA12", "SGRBG12", GSN_PACKING_WORDS, 1, 12, "BAYER_GRBG", 0, 0 },
    { "RG12", "SRGGB12", GSN_PACKING_WORDS, 1, 12, "BAYER_RGGB", 0, 0 },
    { "BYR2", "SBGGR16", GSN_PACKING_WORDS, 1, 16, "BAYER_BGGR", 0, 0 },
    { "GB16", "SGBRG16", GSN_PACKING_WORDS, 1, 16, "BAYER_GBRG", 0, 0 },
    { "GR16", "SGRBG16", GSN_PACKING_WORDS, 1, 16, "BAYER_GRBG", 0, 0 },
    { "RG16", "SRGGB16", GSN_PACKING_WORDS, 1, 16, "BAYER_RGGB", 0, 0 },
    { "pBAA", "SBGGR10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_BGGR", 0, 0 },
    { "pGAA", "SGBRG10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_GBRG", 0, 0 },
    { "pgAA", "SGRBG10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_GRBG", 0, 0 },
    { "pRAA", "SRGGB10_CSI2P", GSN_PACKING_CSI10, 1, 10, "BAYER_RGGB", 0, 0 },
    { "pBCC", "SBGGR12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_BGGR", 0, 0 },
    { "pGCC", "SGBRG12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_GBRG", 0, 0 },
    { "pgCC", "SGRBG12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_GRBG", 0, 0 },
    { "pRCC", "SRGGB12_CSI2P", GSN_PACKING_CSI12, 1, 12, "BAYER_RGGB", 0, 0 },
    { "MJPG", "MJPEG", GSN_PACKING_JPEG, 0, 8, "", 0, 0 },
};

enum { COUNT = sizeof formats / sizeof formats[0] };

/* Pixel formats. */

uint32_t gsn_pixel_format_code(const struct gsn_pixel_format *format)
{
    uint32_t code = 0;

    for (unsigned i = 0; i < 4; i++)
        code |= (uint32_t)(unsigned char)format->fourcc[i] << 8 * i;
    return code;
}

const struct gsn_pixel_format *gsn_pixel_format_named(const char *fourcc)
{
    const size_t length = strlen(fourcc);

    for (size_t i = 0; i < COUNT; i++) {
        const char *const rest = formats[i].fourcc + length;

        if (length > 0 && length <= 4 && memcmp(formats[i].fourcc, fourcc, length) == 0 &&
            strspn(rest, " ") == strlen(rest))
            return &formats[i];
    }
    return NULL;
}

const char *gsn_pixel_format_list(void)
{
    return "YUYV, UYVY, NV12, RGB3, BGR3, GREY, Y10, Y12, Y16, MJPG, raw Bayer of 8, 10, 12 or 16 "
           "bit (BA81, BG10, RG12, ...; pRAA, pRCC, ... packed)";
}

int gsn_pixel_format_is_yuv(const struct gsn_pixel_format *format)
{
    return format->packing == GSN_PACKING_NV12 || strstr(format->tupltype, "YUY") != NULL ||
           strstr(format->tupltype, "UYVY") != NULL;
}

int gsn_pixel_format_is_raw(const struct gsn_pixel_format *format)
{
    return strncmp(format->tupltype, "BAYER", 5) == 0 || strcmp(format->tupltype, "GRAYSCALE") == 0;
}

uint64_t gsn_pixel_format_row(const struct gsn_pixel_format *format, uint32_t width)
{
    switch (format->packing) {
    case GSN_PACKING_BYTES:
        return (uint64_t)width * format->depth;
    case GSN_PACKING_WORDS:
        return (uint64_t)width * 2;
    case GSN_PACKING_CSI10:
        return ((uint64_t)width * 5 + 3) / 4;
    case GSN_PACKING_CSI12:
        return ((uint64_t)width * 3 + 1) / 2;
    case GSN_PACKING_NV12:
        return width;
    default:
        return 0;
    }
}

enum {
    RST0 = 0xd0,
    RST7 = 0xd7,
    SOI = 0xd8,
    EOI = 0xd9,
    SOS = 0xda,
    DHT = 0xc4,
    COM = 0xfe,
    SOF0 = 0xc0,
    SOF15 = 0xcf,
    JPG = 0xc8,
    DAC = 0xcc,
    MOST_COMMENT = 65533
};

/* ITU T.81, tables K.3 to K.6: how many codes there are of each length, then their symbols. */
static const uint8_t standard_tables[] = {
    0xff, 0xc4, 0x01, 0xa2, /* marker and length: 418 bytes */
    /* K.3: luminance, DC */
    0x00, 0, 1, 5, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, /* counts */
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11,
    /* K.5: luminance, AC */
    0x10, 0, 2, 1, 3, 3, 2, 4, 3, 5, 5, 4, 4, 0, 0, 1, 0x7d, /* counts */
    0x01, 0x02, 0x03, 0x00, 0x04, 0x11, 0x05, 0x12, 0x21, 0x31, 0x41, 0x06, 0x13, 0x51, 0x61, 0x07,
    0x22, 0x71, 0x14, 0x32, 0x81, 0x91, 0xa1, 0x08, 0x23, 0x42, 0xb1, 0xc1, 0x15, 0x52, 0xd1, 0xf0,
    0x24, 0x33, 0x62, 0x72, 0x82, 0x09, 0x0a, 0x16, 0x17, 0x18, 0x19, 0x1a, 0x25, 0x26, 0x27, 0x28,
    0x29, 0x2a, 0x34, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48, 0x49,
    0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68, 0x69,
    0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x83, 0x84, 0x85, 0x86, 0x87, 0x88, 0x89,
    0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5, 0xa6, 0xa7,
    0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3, 0xc4, 0xc5,
    0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda, 0xe1, 0xe2,
    0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf1, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
    0xf9, 0xfa,
    /* K.4: chrominance, DC */
    0x01, 0, 3, 1, 1, 1, 1, 1, 1, 1, 1, 1, 0, 0, 0, 0, 0, /* counts */
    0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11,
    /* K.6: chrominance, AC */
    0x11, 0, 2, 1, 2, 4, 4, 3, 4, 7, 5, 4, 4, 0, 1, 2, 0x77, /* counts */
    0x00, 0x01, 0x02, 0x03, 0x11, 0x04, 0x05, 0x21, 0x31, 0x06, 0x12, 0x41, 0x51, 0x07, 0x61, 0x71,
    0x13, 0x22, 0x32, 0x81, 0x08, 0x14, 0x42, 0x91, 0xa1, 0xb1, 0xc1, 0x09, 0x23, 0x33, 0x52, 0xf0,
    0x15, 0x62, 0x72, 0xd1, 0x0a, 0x16, 0x24, 0x34, 0xe1, 0x25, 0xf1, 0x17, 0x18, 0x19, 0x1a, 0x26,
    0x27, 0x28, 0x29, 0x2a, 0x35, 0x36, 0x37, 0x38, 0x39, 0x3a, 0x43, 0x44, 0x45, 0x46, 0x47, 0x48,
    0x49, 0x4a, 0x53, 0x54, 0x55, 0x56, 0x57, 0x58, 0x59, 0x5a, 0x63, 0x64, 0x65, 0x66, 0x67, 0x68,
    0x69, 0x6a, 0x73, 0x74, 0x75, 0x76, 0x77, 0x78, 0x79, 0x7a, 0x82, 0x83, 0x84, 0x85, 0x86, 0x87,
    0x88, 0x89, 0x8a, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x98, 0x99, 0x9a, 0xa2, 0xa3, 0xa4, 0xa5,
    0xa6, 0xa7, 0xa8, 0xa9, 0xaa, 0xb2, 0xb3, 0xb4, 0xb5, 0xb6, 0xb7, 0xb8, 0xb9, 0xba, 0xc2, 0xc3,
    0xc4, 0xc5, 0xc6, 0xc7, 0xc8, 0xc9, 0xca, 0xd2, 0xd3, 0xd4, 0xd5, 0xd6, 0xd7, 0xd8, 0xd9, 0xda,
    0xe2, 0xe3, 0xe4, 0xe5, 0xe6, 0xe7, 0xe8, 0xe9, 0xea, 0xf2, 0xf3, 0xf4, 0xf5, 0xf6, 0xf7, 0xf8,
    0xf9, 0xfa
};

/* Motion JPEG: frames are judged, and made picture files that stand alone. */

struct jpeg_stream {
    size_t end;      /* behind the EOI; what the camera sent after it is padding */
    bool has_tables; /* Huffman tables are among the segments */
};

/* Behind the entropy-coded bytes that begin at at: the offset of the marker that ends them. */
static size_t skip_jpeg_scan(const uint8_t *bytes, size_t size, size_t at)
{
    while (at + 1 < size) {
        const bool is_marker = bytes[at] == 0xff && bytes[at + 1] != 0 && bytes[at + 1] != 0xff &&
                               !(bytes[at + 1] >= RST0 && bytes[at + 1] <= RST7);

        if (is_marker)
            return at;
        at++;
    }
    return size;
}

static int fail_truncated(const struct gsn_frame *frame, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT, "the frame ends after %zu bytes, before the JPEG's EOI",
                    frame->size);
}

/* A start of frame states the size of the picture. */
static int check_jpeg_size(const struct gsn_frame *frame, const uint8_t *segment, size_t length,
                           struct gsn_error *err)
{
    const unsigned height = length >= 7 ? (unsigned)segment[3] << 8 | segment[4] : 0;
    const unsigned width = length >= 7 ? (unsigned)segment[5] << 8 | segment[6] : 0;

    if (width != frame->width || height != frame->height)
        return gsn_fail(err, GSN_E_INPUT, "the JPEG states %u x %u pixels, the camera %u x %u",
                        width, height, frame->width, frame->height);
    return GSN_OK;
}

static bool is_start_of_frame(unsigned marker)
{
    return marker >= SOF0 && marker <= SOF15 && marker != DHT && marker != JPG && marker != DAC;
}

/* Walks the segments. Fails with GSN_E_INPUT when the frame begins with no SOI, ends before its
 * EOI, or is of another size than the format says. */
static int check_jpeg(const struct gsn_frame *frame, struct jpeg_stream *ret_stream,
                      struct gsn_error *err)
{
    const uint8_t *const bytes = frame->bytes;
    struct jpeg_stream stream = { 0 };
    bool sized = false;
    size_t at = 2;

    if (frame->size < 4 || bytes[0] != 0xff || bytes[1] != SOI)
        return gsn_fail(err, GSN_E_INPUT, "the frame begins with no JPEG's SOI");
    while (at + 4 <= frame->size && !(bytes[at] == 0xff && bytes[at + 1] == EOI)) {
        const size_t length = (size_t)bytes[at + 2] << 8 | bytes[at + 3];
        const unsigned marker = bytes[at + 1];
        int r = GSN_OK;

        if (bytes[at] != 0xff)
            return gsn_fail(err, GSN_E_INPUT, "no JPEG marker at byte %zu of the frame", at);
        if (marker == 0xff) {
            at++;
            continue;
        }
        if (length < 2 || length > frame->size - at - 2)
            return fail_truncated(frame, err);
        if (is_start_of_frame(marker))
            r = check_jpeg_size(frame, bytes + at + 2, length, err);
        if (r < 0)
            return r;
        sized = sized || is_start_of_frame(marker);
        stream.has_tables = stream.has_tables || marker == DHT;
        at += 2 + length;
        if (marker == SOS)
            at = skip_jpeg_scan(bytes, frame->size, at);
    }
    if (at + 2 > frame->size || bytes[at] != 0xff || bytes[at + 1] != EOI)
        return fail_truncated(frame, err);
    if (!sized)
        return gsn_fail(err, GSN_E_INPUT, "the JPEG ends before it has begun a picture");
    stream.end = at + 2;
    *ret_stream = stream;
    return GSN_OK;
}

static uint8_t *put_bytes(uint8_t *to, const void *bytes, size_t size)
{
    memcpy(to, bytes, size);
    return to + size;
}

/* gives: SOI, a comment segment with lines, the standard tables where they are missing, the rest.
 */
static int keep_jpeg(const struct gsn_frame *frame, const struct jpeg_stream *stream,
                     const char *lines, uint8_t **ret_bytes, size_t *ret_size,
                     struct gsn_error *err)
{
    const size_t length = strlen(lines) < MOST_COMMENT ? strlen(lines) : MOST_COMMENT;
    const size_t tables = stream->has_tables ? 0 : sizeof standard_tables;
    const uint8_t head[6] = {
        0xff, SOI, 0xff, COM, (uint8_t)((length + 2) >> 8), (uint8_t)(length + 2)
    };
    const size_t size = sizeof head + length + tables + stream->end - 2;
    uint8_t *const file = gsn_alloc(size);
    uint8_t *to = file;

    if (!file)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a frame");
    to = put_bytes(to, head, sizeof head);
    to = put_bytes(to, lines, length);
    to = put_bytes(to, standard_tables, tables);
    (void)put_bytes(to, frame->bytes + 2, stream->end - 2);
    *ret_bytes = file;
    *ret_size = size;
    return GSN_OK;
}

/* The file and its facts. */

const char *gsn_frame_subject(enum gsn_source_subject subject)
{
    static const char *const names[] = { "panel", "blank", "dark" };

    return names[subject];
}

const char *gsn_frame_name(const struct gsn_frame *frame)
{
    static const char *const names[3][2] = { { "panel.pam", "panel.jpg" },
                                             { "blank.pam", "blank.jpg" },
                                             { "dark.pam", "dark.jpg" } };

    return names[frame->subject][frame->format->packing == GSN_PACKING_JPEG];
}

static void add_controls(struct gsn_text *text, const struct gsn_frame *frame)
{
    for (size_t i = 0; i < frame->control_count; i++) {
        const struct gsn_frame_control *const control = &frame->control[i];

        if (control->is_known)
            gsn_text_add(text, "# %s: %lld%s%s, %s\n", control->name, (long long)control->value,
                         control->unit[0] ? " " : "", control->unit,
                         control->unlock ? "not locked" : "locked");
        else
            gsn_text_add(text, "# %s: not known\n", control->name);
    }
}

static void add_optional(struct gsn_text *text, const char *key, const char *value)
{
    if (value)
        add_line(text, key, value);
}

static void add_lines(struct gsn_text *text, const struct gsn_frame *frame)
{
    gsn_text_add(text, "# gieson frame 1\n");
    add_line(text, "device", frame->device);
    add_line(text, "interface", frame->interface);
    add_line(text, "format", frame->format->fourcc);
    gsn_text_add(text, "# size: %u x %u\n", frame->width, frame->height);
    add_optional(text, "colorspace", frame->colorspace);
    add_optional(text, "matrix", frame->matrix);
    add_optional(text, "range", frame->range);
    add_optional(text, "transfer", frame->transfer);
    add_line(text, "subject", gsn_frame_subject(frame->subject));
    add_controls(text, frame);
    add_optional(text, "not to be measured", frame->withheld);
}

/* The header of a PAM that holds this frame. */
static void add_header(struct gsn_text *text, const struct gsn_frame *frame)
{
    const struct gsn_pixel_format *const format = frame->format;
    const uint32_t rows =
        format->packing == GSN_PACKING_NV12 ? frame->height / 2 * 3 : frame->height;

    gsn_text_add(text, "P7\n");
    add_lines(text, frame);
    gsn_text_add(text, "WIDTH %u\nHEIGHT %u\nDEPTH %u\nMAXVAL %u\nTUPLTYPE %s\nENDHDR\n",
                 frame->width, rows, format->depth, (1U << format->bits) - 1, format->tupltype);
}

static void take_words(const uint8_t *from, uint8_t *to, uint32_t width)
{
    for (size_t i = 0; i < (size_t)width * 2; i += 2) {
        to[i] = from[i + 1];
        to[i + 1] = from[i];
    }
}

static void put_word(uint8_t *to, unsigned sample)
{
    to[0] = (uint8_t)(sample >> 8);
    to[1] = (uint8_t)sample;
}

static void take_csi10(const uint8_t *from, uint8_t *to, uint32_t width)
{
    for (uint32_t x = 0; x < width; x++) {
        const uint8_t *const group = from + (size_t)x / 4 * 5;

        put_word(to + (size_t)x * 2, (unsigned)group[x % 4] << 2 | (group[4] >> 2 * (x % 4) & 3U));
    }
}

static void take_csi12(const uint8_t *from, uint8_t *to, uint32_t width)
{
    for (uint32_t x = 0; x < width; x++) {
        const uint8_t *const pair = from + (size_t)x / 2 * 3;

        put_word(to + (size_t)x * 2, (unsigned)pair[x % 2] << 4 | (pair[2] >> 4 * (x % 2) & 15U));
    }
}

/* A word that says more than its bits can: the camera shifts its samples, or sends rubbish. */
static int check_words(const struct gsn_frame *frame, const uint8_t *row, uint32_t y,
                       struct gsn_error *err)
{
    const unsigned most = (1U << frame->format->bits) - 1;

    for (uint32_t x = 0; x < frame->width; x++) {
        const unsigned sample = (unsigned)row[2 * (size_t)x] << 8 | row[2 * (size_t)x + 1];

        if (sample > most)
            return gsn_fail(err, GSN_E_INPUT,
                            "sample (%u, %u) is %u, but %.4s has %u bits: the camera delivers "
                            "another format than it states",
                            x, y, sample, frame->format->fourcc, frame->format->bits);
    }
    return GSN_OK;
}

static int take_row(const struct gsn_frame *frame, uint32_t y, uint8_t *to, struct gsn_error *err)
{
    const uint8_t *const from = frame->bytes + (size_t)y * frame->stride;

    switch (frame->format->packing) {
    case GSN_PACKING_WORDS:
        take_words(from, to, frame->width);
        return check_words(frame, to, y, err);
    case GSN_PACKING_CSI10:
        take_csi10(from, to, frame->width);
        return GSN_OK;
    case GSN_PACKING_CSI12:
        take_csi12(from, to, frame->width);
        return GSN_OK;
    default:
        memcpy(to, from, (size_t)gsn_pixel_format_row(frame->format, frame->width));
        return GSN_OK;
    }
}

static int check_payload(const struct gsn_frame *frame, uint64_t rows, struct gsn_error *err)
{
    const uint64_t row = gsn_pixel_format_row(frame->format, frame->width);
    const uint64_t needed = rows ? (rows - 1) * frame->stride + row : 0;
    const uint32_t odd = frame->format->packing == GSN_PACKING_NV12
                             ? frame->width % 2 | frame->height % 2
                             : (frame->format->depth == 2 ? frame->width % 2 : 0);

    if (!row || !rows || frame->stride < row)
        return gsn_fail(err, GSN_E_INPUT, "%u x %u pixels of %.4s do not fit into rows of %u bytes",
                        frame->width, frame->height, frame->format->fourcc, frame->stride);
    if (odd)
        return gsn_fail(err, GSN_E_INPUT,
                        "%.4s has no pictures of %u x %u pixels: U and V are "
                        "shared by two",
                        frame->format->fourcc, frame->width, frame->height);
    if (frame->size < needed)
        return gsn_fail(err, GSN_E_INPUT,
                        "the frame has %zu bytes where %u x %u pixels of %.4s need %llu",
                        frame->size, frame->width, frame->height, frame->format->fourcc,
                        (unsigned long long)needed);
    return GSN_OK;
}

static int encode_pam(const struct gsn_frame *frame, struct gsn_text *header, uint8_t **ret_bytes,
                      size_t *ret_size, struct gsn_error *err)
{
    const struct gsn_pixel_format *const format = frame->format;
    const uint32_t rows =
        format->packing == GSN_PACKING_NV12 ? frame->height / 2 * 3 : frame->height;
    const size_t row = (size_t)frame->width * format->depth * (format->bits > 8 ? 2 : 1);
    gsn_auto_mem(uint8_t) file = NULL;
    int r = check_payload(frame, rows, err);

    if (r < 0)
        return r;
    add_header(header, frame);
    if (!header->starved)
        file = gsn_alloc(header->used + rows * row);
    if (!file)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a frame");
    memcpy(file, header->at, header->used);
    for (uint32_t y = 0; y < rows && r >= 0; y++)
        r = take_row(frame, y, file + header->used + y * row, err);
    if (r < 0)
        return r;
    *ret_size = header->used + rows * row;
    *ret_bytes = gsn_steal(&file);
    return GSN_OK;
}

static int encode_jpeg(const struct gsn_frame *frame, struct gsn_text *lines, uint8_t **ret_bytes,
                       size_t *ret_size, struct gsn_error *err)
{
    struct jpeg_stream stream = { 0 };
    const int r = check_jpeg(frame, &stream, err);

    if (r < 0)
        return r;
    add_lines(lines, frame);
    if (!stream.has_tables)
        add_line(lines, "Huffman tables", "the standard ones, put in");
    if (lines->starved)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a frame");
    return keep_jpeg(frame, &stream, lines->at, ret_bytes, ret_size, err);
}

int gsn_frame_encode(const struct gsn_frame *frame, uint8_t **ret_bytes, size_t *ret_size,
                     struct gsn_error *err)
{
    struct gsn_text text = { 0 };
    const int r = frame->format->packing == GSN_PACKING_JPEG
                      ? encode_jpeg(frame, &text, ret_bytes, ret_size, err)
                      : encode_pam(frame, &text, ret_bytes, ret_size, err);

    gsn_free(text.at);
    return r;
}

static void add_member(struct gsn_text *text, const char *key, const char *value)
{
    if (!value)
        return;
    gsn_text_add(text, ",\"%s\":", key);
    add_json_string(text, value);
}

static void add_control_members(struct gsn_text *text, const struct gsn_frame_control *control)
{
    gsn_text_add(text, "{\"name\":");
    add_json_string(text, control->name);
    if (control->is_known)
        gsn_text_add(text, ",\"value\":%lld", (long long)control->value);
    if (control->unit[0])
        add_member(text, "unit", control->unit);
    gsn_text_add(text, ",\"locked\":%s", control->unlock ? "false" : "true");
    add_member(text, "reason", control->unlock);
    gsn_text_add(text, "}");
}

int gsn_frame_facts(const struct gsn_frame *frame, unsigned damaged, const char *thumbnail,
                    char **ret_json, struct gsn_error *err)
{
    struct gsn_text text = { 0 };

    gsn_text_add(&text, "{\"device\":");
    add_json_string(&text, frame->device);
    add_member(&text, "interface", frame->interface);
    add_member(&text, "format", frame->format->fourcc);
    gsn_text_add(&text, ",\"width\":%u,\"height\":%u,\"stride\":%u", frame->width, frame->height,
                 frame->stride);
    add_member(&text, "colorspace", frame->colorspace);
    add_member(&text, "matrix", frame->matrix);
    add_member(&text, "range", frame->range);
    add_member(&text, "transfer", frame->transfer);
    add_member(&text, "subject", gsn_frame_subject(frame->subject));
    gsn_text_add(&text, ",\"damaged_before\":%u,\"controls\":[", damaged);
    for (size_t i = 0; i < frame->control_count; i++) {
        gsn_text_add(&text, i ? "," : "");
        add_control_members(&text, &frame->control[i]);
    }
    gsn_text_add(&text, "],\"quantify\":%s", frame->withheld ? "false" : "true");
    add_member(&text, "reason", frame->withheld);
    add_member(&text, "thumbnail", thumbnail);
    gsn_text_add(&text, "}");
    if (text.starved) {
        gsn_free(text.at);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the facts of a frame");
    }
    *ret_json = text.at;
    return GSN_OK;
}
