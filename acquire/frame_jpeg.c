/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/frame_jpeg.h"

#include <string.h>

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

/* Behind the entropy-coded bytes that begin at at: the offset of the marker that ends them. */
static size_t skip_scan(const uint8_t *bytes, size_t size, size_t at)
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

static int truncated(const struct gsn_frame *frame, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT, "the frame ends after %zu bytes, before the JPEG's EOI",
                    frame->size);
}

/* A start of frame states the size of the picture. */
static int check_size(const struct gsn_frame *frame, const uint8_t *segment, size_t length,
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

int gsn_jpeg_stream_check(const struct gsn_frame *frame, struct gsn_jpeg_stream *ret_stream,
                          struct gsn_error *err)
{
    const uint8_t *const bytes = frame->bytes;
    struct gsn_jpeg_stream stream = { 0 };
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
            return truncated(frame, err);
        if (is_start_of_frame(marker))
            r = check_size(frame, bytes + at + 2, length, err);
        if (r < 0)
            return r;
        sized = sized || is_start_of_frame(marker);
        stream.has_tables = stream.has_tables || marker == DHT;
        at += 2 + length;
        if (marker == SOS)
            at = skip_scan(bytes, frame->size, at);
    }
    if (at + 2 > frame->size || bytes[at] != 0xff || bytes[at + 1] != EOI)
        return truncated(frame, err);
    if (!sized)
        return gsn_fail(err, GSN_E_INPUT, "the JPEG ends before it has begun a picture");
    stream.end = at + 2;
    *ret_stream = stream;
    return GSN_OK;
}

static uint8_t *put(uint8_t *to, const void *bytes, size_t size)
{
    memcpy(to, bytes, size);
    return to + size;
}

int gsn_jpeg_stream_keep(const struct gsn_frame *frame, const struct gsn_jpeg_stream *stream,
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
    to = put(to, head, sizeof head);
    to = put(to, lines, length);
    to = put(to, standard_tables, tables);
    (void)put(to, frame->bytes + 2, stream->end - 2);
    *ret_bytes = file;
    *ret_size = size;
    return GSN_OK;
}
