/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* PTP as bytes: containers, texts and datasets of ISO 15740 in the form that USB carries (little
 * endian, PIMA 15740, annex D).
 *
 * Steps. A reader walks over the bytes that are there: each number and text is taken only when it
 * is all there. Texts are UTF-16 with a count; pairs of surrogates become UTF-8, a lone one and
 * control characters U+FFFD. Lists of codes are kept as far as there is room for them, and passed
 * by their length beyond that.
 *
 * How it fails: a dataset that breaks off is GSN_E_INPUT and leaves the outputs untouched. A last
 * text may be missing altogether, as of many responders. tests/fuzz gives it strangers' bytes. */
#include "acquire/ptp_wire.h"

#include <assert.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

uint16_t gsn_ptp_get16(const uint8_t *bytes)
{
    return (uint16_t)(bytes[0] | bytes[1] << 8);
}

uint32_t gsn_ptp_get32(const uint8_t *bytes)
{
    return gsn_ptp_get16(bytes) | (uint32_t)gsn_ptp_get16(bytes + 2) << 16;
}

static void put_u16(uint8_t *bytes, uint16_t value)
{
    bytes[0] = (uint8_t)value;
    bytes[1] = (uint8_t)(value >> 8);
}

static void put_u32(uint8_t *bytes, uint32_t value)
{
    put_u16(bytes, (uint16_t)value);
    put_u16(bytes + 2, (uint16_t)(value >> 16));
}

struct gsn_ptp_header gsn_ptp_read_header(const uint8_t bytes[GSN_PTP_HEADER])
{
    return (struct gsn_ptp_header){ gsn_ptp_get32(bytes), gsn_ptp_get16(bytes + 4),
                                    gsn_ptp_get16(bytes + 6), gsn_ptp_get32(bytes + 8) };
}

size_t gsn_ptp_write_command(const struct gsn_ptp_request *request, uint32_t transaction,
                             uint8_t ret_bytes[GSN_PTP_LONGEST_RESPONSE])
{
    const size_t size = GSN_PTP_HEADER + 4 * (size_t)request->count;

    assert(request->count <= GSN_PTP_PARAMETERS);
    put_u32(ret_bytes, (uint32_t)size);
    put_u16(ret_bytes + 4, GSN_PTP_COMMAND_BLOCK);
    put_u16(ret_bytes + 6, request->operation);
    put_u32(ret_bytes + 8, transaction);
    for (size_t i = 0; i < request->count && i < GSN_PTP_PARAMETERS; i++)
        put_u32(ret_bytes + GSN_PTP_HEADER + 4 * i, request->parameter[i]);
    return size;
}

struct gsn_ptp_response gsn_ptp_read_response(const uint8_t *bytes, size_t size)
{
    struct gsn_ptp_response response = { .code = gsn_ptp_get16(bytes + 6) };

    for (size_t at = GSN_PTP_HEADER; at + 4 <= size && response.count < GSN_PTP_PARAMETERS; at += 4)
        response.parameter[response.count++] = gsn_ptp_get32(bytes + at);
    return response;
}

void gsn_ptp_describe(uint16_t code, char *ret_text, size_t size)
{
    static const char *const names[] = { /* from 0x2001 on */
                                         "OK",
                                         "General Error",
                                         "Session Not Open",
                                         "Invalid TransactionID",
                                         "Operation Not Supported",
                                         "Parameter Not Supported",
                                         "Incomplete Transfer",
                                         "Invalid StorageID",
                                         "Invalid ObjectHandle",
                                         "DeviceProp Not Supported",
                                         "Invalid ObjectFormatCode",
                                         "Store Full",
                                         "Object WriteProtected",
                                         "Store Read-Only",
                                         "Access Denied",
                                         "No Thumbnail Present",
                                         "SelfTest Failed",
                                         "Partial Deletion",
                                         "Store Not Available",
                                         "Specification By Format Unsupported",
                                         "No Valid ObjectInfo",
                                         "Invalid Code Format",
                                         "Unknown Vendor Code",
                                         "Capture Already Terminated",
                                         "Device Busy",
                                         "Invalid ParentObject",
                                         "Invalid DeviceProp Format",
                                         "Invalid DeviceProp Value",
                                         "Invalid Parameter",
                                         "Session Already Open",
                                         "Transaction Cancelled",
                                         "Specification of Destination Unsupported"
    };
    const size_t n = (size_t)code - GSN_PTP_OK;
    const char *const name =
        code >= GSN_PTP_OK && n < sizeof names / sizeof names[0] ? names[n] : "a vendor's answer";

    (void)snprintf(ret_text, size, "%s (0x%04X)", name, code);
}

int gsn_ptp_read_event(const uint8_t *bytes, size_t size, struct gsn_ptp_event *ret_event,
                       struct gsn_error *err)
{
    if (size < GSN_PTP_HEADER || gsn_ptp_get16(bytes + 4) != GSN_PTP_EVENT_BLOCK)
        return gsn_fail(err, GSN_E_INPUT, "%zu bytes came that are no event", size);
    *ret_event = (struct gsn_ptp_event){ .code = gsn_ptp_get16(bytes + 6),
                                         .parameter = size >= GSN_PTP_HEADER + 4
                                                          ? gsn_ptp_get32(bytes + GSN_PTP_HEADER)
                                                          : 0 };
    return GSN_OK;
}

/* Reads on from `at`; what would go beyond the end reads as 0 and is remembered. */
struct reader {
    const uint8_t *at;
    size_t left;
    bool broken;
};

static const uint8_t *take_bytes(struct reader *reader, size_t size)
{
    const uint8_t *const bytes = reader->at;

    if (reader->broken || reader->left < size) {
        reader->broken = true;
        return NULL;
    }
    reader->at += size;
    reader->left -= size;
    return bytes;
}

static uint16_t take_u16(struct reader *reader)
{
    const uint8_t *const bytes = take_bytes(reader, 2);

    return bytes ? gsn_ptp_get16(bytes) : 0;
}

static uint32_t take_u32(struct reader *reader)
{
    const uint8_t *const bytes = take_bytes(reader, 4);

    return bytes ? gsn_ptp_get32(bytes) : 0;
}

enum { REPLACEMENT = 0xFFFD };

/* One character from unit n on; an unpaired surrogate is replaced. Moves *n behind it. */
static uint32_t take_character(const uint8_t *units, size_t count, size_t *n)
{
    const uint32_t unit = gsn_ptp_get16(units + 2 * (*n)++);
    uint32_t low;

    if (unit < 0xD800 || unit > 0xDFFF)
        return unit;
    if (unit > 0xDBFF || *n == count)
        return REPLACEMENT;
    low = gsn_ptp_get16(units + 2 * *n);
    if (low < 0xDC00 || low > 0xDFFF)
        return REPLACEMENT;
    (*n)++;
    return 0x10000 + ((unit - 0xD800) << 10) + (low - 0xDC00);
}

static size_t encode_utf8(uint32_t c, char bytes[4])
{
    if (c < 0x80) {
        bytes[0] = (char)c;
        return 1;
    }
    if (c < 0x800) {
        bytes[0] = (char)(0xC0 | c >> 6);
        bytes[1] = (char)(0x80 | (c & 0x3F));
        return 2;
    }
    if (c < 0x10000) {
        bytes[0] = (char)(0xE0 | c >> 12);
        bytes[1] = (char)(0x80 | (c >> 6 & 0x3F));
        bytes[2] = (char)(0x80 | (c & 0x3F));
        return 3;
    }
    bytes[0] = (char)(0xF0 | c >> 18);
    bytes[1] = (char)(0x80 | (c >> 12 & 0x3F));
    bytes[2] = (char)(0x80 | (c >> 6 & 0x3F));
    bytes[3] = (char)(0x80 | (c & 0x3F));
    return 4;
}

static bool is_control(uint32_t c)
{
    return c < 0x20 || (c >= 0x7F && c < 0xA0);
}

/* A text of at most 255 UTF-16 units, ended by a zero that some devices forget. What does not fit
 * into text is cut between characters. */
static void take_text(struct reader *reader, char *text, size_t room)
{
    const uint8_t *const length = take_bytes(reader, 1);
    const size_t count = length ? *length : 0;
    const uint8_t *const units = take_bytes(reader, 2 * count);
    size_t used = 0;

    for (size_t n = 0; units && n < count;) {
        char bytes[4];
        uint32_t c = take_character(units, count, &n);
        size_t size;

        if (c == 0)
            break;
        size = encode_utf8(is_control(c) ? REPLACEMENT : c, bytes);
        if (used + size >= room)
            break;
        memcpy(text + used, bytes, size);
        used += size;
    }
    text[used] = '\0';
}

/* Texts at the end of a dataset that some devices leave out. */
static void take_last_text(struct reader *reader, char *text, size_t room)
{
    text[0] = '\0';
    if (reader->left > 0)
        take_text(reader, text, room);
}

/* A list of 16-bit codes; keeps the first `most` of them. */
static size_t take_codes(struct reader *reader, uint16_t *codes, size_t most)
{
    const size_t count = take_u32(reader);
    const uint8_t *const bytes = count <= reader->left / 2 ? take_bytes(reader, 2 * count) : NULL;

    if (!bytes) {
        reader->broken = true;
        return 0;
    }
    for (size_t i = 0; i < count && i < most; i++)
        codes[i] = gsn_ptp_get16(bytes + 2 * i);
    return count < most ? count : most;
}

static int fail_broken(const char *what, size_t size, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_INPUT, "the device's %s breaks off after %zu bytes", what, size);
}

int gsn_ptp_read_device_info(const uint8_t *bytes, size_t size,
                             struct gsn_ptp_device_info *ret_info, struct gsn_error *err)
{
    struct reader reader = { bytes, size, false };
    struct gsn_ptp_device_info info = { 0 };
    char extension[GSN_PTP_TEXT];

    (void)take_bytes(&reader, 2 + 4 + 2); /* version, the vendor's extension and its version */
    take_text(&reader, extension, sizeof extension);
    (void)take_bytes(&reader, 2); /* functional mode */
    info.operation_count = take_codes(&reader, info.operation, GSN_PTP_OPERATIONS);
    /* Events (not believed anyway), device properties, formats captured and kept. */
    for (int i = 0; i < 4; i++)
        (void)take_codes(&reader, NULL, 0);
    take_last_text(&reader, info.maker, sizeof info.maker);
    take_last_text(&reader, info.model, sizeof info.model);
    take_last_text(&reader, info.version, sizeof info.version);
    take_last_text(&reader, info.serial, sizeof info.serial);
    if (reader.broken)
        return fail_broken("DeviceInfo", size, err);
    *ret_info = info;
    return GSN_OK;
}

int gsn_ptp_offers(const struct gsn_ptp_device_info *info, uint16_t operation)
{
    for (size_t i = 0; i < info->operation_count; i++) {
        if (info->operation[i] == operation)
            return 1;
    }
    return 0;
}

int gsn_ptp_read_object_info(const uint8_t *bytes, size_t size,
                             struct gsn_ptp_object_info *ret_info, struct gsn_error *err)
{
    struct reader reader = { bytes, size, false };
    struct gsn_ptp_object_info info = { 0 };

    info.storage = take_u32(&reader);
    info.format = take_u16(&reader);
    (void)take_bytes(&reader, 2); /* protection */
    info.size = take_u32(&reader);
    (void)take_bytes(&reader, 2 + 4 * 3 + 4 * 3); /* thumbnail; width, height and depth */
    info.parent = take_u32(&reader);
    (void)take_bytes(&reader, 2 + 4 + 4); /* association; sequence number */
    take_text(&reader, info.name, sizeof info.name);
    take_last_text(&reader, info.captured, sizeof info.captured);
    take_last_text(&reader, info.modified, sizeof info.modified);
    if (reader.broken)
        return fail_broken("ObjectInfo", size, err);
    *ret_info = info;
    return GSN_OK;
}

int gsn_ptp_read_list(const uint8_t *bytes, size_t size, uint32_t *ret_count, struct gsn_error *err)
{
    struct reader reader = { bytes, size, false };
    const uint32_t count = take_u32(&reader);

    if (reader.broken || count > reader.left / 4)
        return gsn_fail(err, GSN_E_INPUT, "the device's list of %lu breaks off after %zu bytes",
                        (unsigned long)count, size);
    *ret_count = count;
    return GSN_OK;
}

int gsn_ptp_read_u64(const uint8_t *bytes, size_t size, uint64_t *ret_value, struct gsn_error *err)
{
    if (size < 8)
        return fail_broken("property", size, err);
    *ret_value = gsn_ptp_get32(bytes) | (uint64_t)gsn_ptp_get32(bytes + 4) << 32;
    return GSN_OK;
}
