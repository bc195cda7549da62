/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/ptp_wire.h"

#include <stdlib.h>
#include <string.h>

#include "tests/check.h"
#include "tests/device/blob.h"

/* The DeviceInfo of a Canon PowerShot SX200, shortened, as its bytes were recorded: version 100,
 * extension 6, two operations, no further lists, and four texts. */
static void write_device_info(struct blob *blob, size_t operations)
{
    blob_u16(blob, 100);
    blob_u32(blob, 6);
    blob_u16(blob, 100);
    blob_string(blob, "");
    blob_u16(blob, 0);
    blob_u32(blob, (uint32_t)operations);
    for (size_t i = 0; i < operations; i++)
        blob_u16(blob, 0x1001 + (uint32_t)i);
    blob_array16(blob, (const uint16_t[]){ 0x4002, 0x4003 }, 2);
    for (int i = 0; i < 3; i++)
        blob_array16(blob, NULL, 0);
    blob_string(blob, "Canon Inc.");
    blob_string(blob, "Canon PowerShot SX200 IS");
    blob_string(blob, "1-6.0.1.0");
    blob_string(blob, "C767F1C714174C309255F70E4A7B2EE2");
}

TEST(device_info_is_read)
{
    struct blob blob = { 0 };
    struct gsn_ptp_device_info info;
    struct gsn_error err = { 0 };

    write_device_info(&blob, 2);
    CHECK_OK(gsn_ptp_read_device_info(blob.bytes, blob.size, &info, &err), err);
    CHECK(info.operation_count == 2 && gsn_ptp_offers(&info, GSN_PTP_OPEN_SESSION));
    CHECK(!gsn_ptp_offers(&info, GSN_PTP_GET_PARTIAL_OBJECT));
    CHECK(strcmp(info.maker, "Canon Inc.") == 0);
    CHECK(strcmp(info.model, "Canon PowerShot SX200 IS") == 0);
    CHECK(strcmp(info.version, "1-6.0.1.0") == 0);
    CHECK(strcmp(info.serial, "C767F1C714174C309255F70E4A7B2EE2") == 0);
    free(blob.bytes);
}

TEST(more_operations_than_are_kept_do_no_harm)
{
    struct blob blob = { 0 };
    struct gsn_ptp_device_info info;
    struct gsn_error err = { 0 };

    write_device_info(&blob, 3 * GSN_PTP_OPERATIONS);
    CHECK_OK(gsn_ptp_read_device_info(blob.bytes, blob.size, &info, &err), err);
    CHECK(info.operation_count == GSN_PTP_OPERATIONS);
    CHECK(strcmp(info.maker, "Canon Inc.") == 0);
    free(blob.bytes);
}

/* The text fields may be missing at the end, but no field may break off. */
TEST(every_cut_of_device_info_is_refused_or_ends_between_its_last_texts)
{
    struct blob blob = { 0 };
    const struct gsn_ptp_device_info before = { .operation_count = 77 };
    size_t whole = 0;

    write_device_info(&blob, 2);
    for (size_t size = 0; size < blob.size; size++) {
        uint8_t *const cut = malloc(size + 1); /* so that ASan sees the first byte too many */
        uint8_t *const exact = realloc(cut, size ? size : 1);
        struct gsn_ptp_device_info info = before;
        struct gsn_error err = { 0 };

        memcpy(exact, blob.bytes, size);
        if (gsn_ptp_read_device_info(exact, size, &info, &err) >= 0) {
            whole++;
        } else {
            CHECK(err.code == GSN_E_INPUT && err.text[0]);
            CHECK(memcmp(&info, &before, sizeof info) == 0);
        }
        free(exact);
    }
    CHECK(whole == 4);
    free(blob.bytes);
}

/* GetObjectInfo of IMG_0001.JPG, with its header, as a Canon PowerShot SX200 was recorded. */
static const char recorded[] =
    "82000000020008100C0000000100010001380000560A010008386F0A0000A00000007800000080020000"
    "E00100000000000000009001000001000000000000000D49004D0047005F0030003000300031002E004A"
    "00500047000000123200300031003300300038003200320054003000370030003800330030002E003000"
    "00000000";

static size_t from_hex(const char *hex, uint8_t *bytes)
{
    size_t n = 0;

    for (; hex[2 * n] && hex[2 * n + 1]; n++) {
        const char two[3] = { hex[2 * n], hex[2 * n + 1], '\0' };

        bytes[n] = (uint8_t)strtoul(two, NULL, 16);
    }
    return n;
}

TEST(object_info_of_a_recorded_camera_is_read)
{
    uint8_t bytes[256];
    struct gsn_ptp_object_info info;
    struct gsn_error err = { 0 };
    const size_t size = from_hex(recorded, bytes);

    CHECK(size == gsn_ptp_get32(bytes));
    CHECK_OK(gsn_ptp_read_object_info(bytes + GSN_PTP_HEADER, size - GSN_PTP_HEADER, &info, &err),
             err);
    CHECK(info.storage == 0x00010001 && info.format == 0x3801 && info.size == 68182);
    CHECK(info.parent == 0x01900000);
    CHECK(strcmp(info.name, "IMG_0001.JPG") == 0);
    CHECK(strcmp(info.captured, "20130822T070830.0") == 0);
}

static int read_name(const uint8_t *units, size_t count, size_t claimed, char *ret_name)
{
    struct blob blob = { 0 };
    struct gsn_ptp_object_info info;
    int r;

    blob_extend(&blob, 52);
    blob_u8(&blob, (uint32_t)claimed);
    if (count > 0)
        memcpy(blob_extend(&blob, 2 * count), units, 2 * count);
    r = gsn_ptp_read_object_info(blob.bytes, blob.size, &info, NULL);
    if (r >= 0)
        memcpy(ret_name, info.name, sizeof info.name);
    free(blob.bytes);
    return r;
}

TEST(texts_become_utf_8)
{
    static const struct {
        uint8_t units[16];
        size_t count;
        const char *text;
    } cases[] = {
        { { 'P', 0, '1', 0, 0, 0 }, 3, "P1" },
        { { 'P', 0, '1', 0 }, 2, "P1" }, /* the final zero is forgotten */
        { { 0xE4, 0, 0xAC, 0x20, 0, 0 }, 3, "\xC3\xA4\xE2\x82\xAC" },
        { { 0x3D, 0xD8, 0x2C, 0xDD, 0, 0 }, 3, "\xF0\x9F\x94\xAC" },   /* a microscope */
        { { 0x3D, 0xD8, 'x', 0, 0, 0 }, 3, "\xEF\xBF\xBDx" },          /* half of one */
        { { 0x2C, 0xDD, 0x3D, 0xD8 }, 2, "\xEF\xBF\xBD\xEF\xBF\xBD" }, /* halves, swapped */
        { { '\n', 0, 0x1B, 0, 0x9B, 0, 0, 0 }, 4, "\xEF\xBF\xBD\xEF\xBF\xBD\xEF\xBF\xBD" },
        { { 0, 0, 'x', 0 }, 2, "" },
    };

    for (size_t i = 0; i < sizeof cases / sizeof cases[0]; i++) {
        char name[GSN_PTP_TEXT];

        CHECK(read_name(cases[i].units, cases[i].count, cases[i].count, name) >= 0);
        CHECK(strcmp(name, cases[i].text) == 0);
    }
}

TEST(the_longest_text_fits)
{
    uint8_t units[2 * 255];
    char name[GSN_PTP_TEXT];

    for (size_t i = 0; i < 255; i++) {
        units[2 * i] = 0xAC;
        units[2 * i + 1] = 0x20;
    }
    CHECK(read_name(units, 255, 255, name) >= 0);
    CHECK(strlen(name) == 3 * 255);
}

TEST(a_text_that_claims_more_than_there_is_is_refused)
{
    static const uint8_t units[4] = { 'P', 0, '1', 0 };
    char name[GSN_PTP_TEXT];

    CHECK(read_name(units, 2, 3, name) == GSN_E_INPUT);
    CHECK(read_name(units, 2, 255, name) == GSN_E_INPUT);
}

TEST(a_list_holds_what_it_claims)
{
    static const uint8_t list[] = { 2, 0, 0, 0, 1, 0, 1, 0, 2, 0, 1, 0 };
    static const uint8_t huge[] = { 0xFF, 0xFF, 0xFF, 0xFF, 1, 0, 1, 0 };
    struct gsn_error err = { 0 };
    uint32_t count = 77;

    CHECK(gsn_ptp_read_list(list, 11, &count, &err) == GSN_E_INPUT && count == 77);
    CHECK(gsn_ptp_read_list(huge, sizeof huge, &count, &err) == GSN_E_INPUT && count == 77);
    CHECK(gsn_ptp_read_list(list, 3, &count, &err) == GSN_E_INPUT && count == 77);
    CHECK_OK(gsn_ptp_read_list(list, sizeof list, &count, &err), err);
    CHECK(count == 2 && gsn_ptp_get32(list + 8) == 0x00010002);
}

TEST(a_command_is_the_bytes_a_camera_was_recorded_with)
{
    /* GetObjectHandles, transaction 4, of the recorded session. */
    static const uint8_t truth[] = { 0x18, 0, 0, 0, 1, 0, 0x07, 0x10, 4,    0,    0,    0,
                                     1,    0, 1, 0, 0, 0, 0,    0,    0xFF, 0xFF, 0xFF, 0xFF };
    const struct gsn_ptp_request request = { GSN_PTP_GET_OBJECT_HANDLES,
                                             3,
                                             { 0x00010001, 0, gsn_ptp_every } };
    uint8_t bytes[GSN_PTP_LONGEST_RESPONSE];

    CHECK(gsn_ptp_write_command(&request, 4, bytes) == sizeof truth);
    CHECK(memcmp(bytes, truth, sizeof truth) == 0);
}

TEST(codes_are_words)
{
    char text[80], little[8];

    gsn_ptp_describe(0x2001, text, sizeof text);
    CHECK(strcmp(text, "OK (0x2001)") == 0);
    gsn_ptp_describe(0x2019, text, sizeof text);
    CHECK(strcmp(text, "Device Busy (0x2019)") == 0);
    gsn_ptp_describe(0x2020, text, sizeof text);
    CHECK(strcmp(text, "Specification of Destination Unsupported (0x2020)") == 0);
    gsn_ptp_describe(0xA801, text, sizeof text);
    CHECK(strcmp(text, "a vendor's answer (0xA801)") == 0);
    gsn_ptp_describe(0x0000, text, sizeof text);
    CHECK(strcmp(text, "a vendor's answer (0x0000)") == 0);
    gsn_ptp_describe(0x2002, little, sizeof little);
    CHECK(strcmp(little, "General") == 0);
}

TEST(an_event_is_read_and_what_is_none_is_refused)
{
    static const uint8_t added[] = { 16, 0, 0, 0, 4, 0, 0x02, 0x40, 9, 0, 0, 0, 7, 0, 0, 0 };
    struct gsn_ptp_event event = { 1, 2 };
    struct gsn_error err = { 0 };
    uint8_t data[16];

    CHECK_OK(gsn_ptp_read_event(added, 16, &event, &err), err);
    CHECK(event.code == GSN_PTP_OBJECT_ADDED && event.parameter == 7);
    CHECK_OK(gsn_ptp_read_event(added, 12, &event, &err), err);
    CHECK(event.parameter == 0);
    CHECK(gsn_ptp_read_event(added, 11, &event, &err) == GSN_E_INPUT);
    memcpy(data, added, sizeof data);
    data[4] = 3;
    CHECK(gsn_ptp_read_event(data, 16, &event, &err) == GSN_E_INPUT);
    CHECK(event.code == GSN_PTP_OBJECT_ADDED);
}
