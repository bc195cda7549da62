/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What PTP says, as bytes: containers, texts and datasets of ISO 15740 in the form that USB carries
 * (little endian, PIMA 15740 Annex D).
 *
 * Everything read here comes from a device and is taken as hostile: every length is checked against
 * the bytes that are there, and a dataset that breaks off is GSN_E_INPUT with the outputs
 * untouched. Texts become UTF-8 that is always valid and free of control characters. */
#ifndef GSN_ACQUIRE_PTP_WIRE_H
#define GSN_ACQUIRE_PTP_WIRE_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_ptp_container {
    GSN_PTP_COMMAND_BLOCK = 1,
    GSN_PTP_DATA_BLOCK = 2,
    GSN_PTP_RESPONSE_BLOCK = 3,
    GSN_PTP_EVENT_BLOCK = 4,
};

/* Operations; the last two are those of MTP and of its extension by Android. */
enum gsn_ptp_operation {
    GSN_PTP_GET_DEVICE_INFO = 0x1001,
    GSN_PTP_OPEN_SESSION = 0x1002,
    GSN_PTP_CLOSE_SESSION = 0x1003,
    GSN_PTP_GET_STORAGE_IDS = 0x1004,
    GSN_PTP_GET_OBJECT_HANDLES = 0x1007,
    GSN_PTP_GET_OBJECT_INFO = 0x1008,
    GSN_PTP_GET_OBJECT = 0x1009,
    GSN_PTP_DELETE_OBJECT = 0x100B,
    GSN_PTP_GET_PARTIAL_OBJECT = 0x101B,
    GSN_PTP_GET_OBJECT_PROP_VALUE = 0x9803,
    GSN_PTP_GET_PARTIAL_OBJECT_64 = 0x95C1,
};

enum gsn_ptp_code {
    GSN_PTP_OK = 0x2001,
    GSN_PTP_GENERAL_ERROR = 0x2002,
    GSN_PTP_SESSION_NOT_OPEN = 0x2003,
    GSN_PTP_INVALID_TRANSACTION_ID = 0x2004,
    GSN_PTP_OPERATION_NOT_SUPPORTED = 0x2005,
    GSN_PTP_INCOMPLETE_TRANSFER = 0x2007,
    GSN_PTP_INVALID_STORAGE_ID = 0x2008,
    GSN_PTP_INVALID_OBJECT_HANDLE = 0x2009,
    GSN_PTP_STORE_NOT_AVAILABLE = 0x2013,
    GSN_PTP_DEVICE_BUSY = 0x2019,
    GSN_PTP_SESSION_ALREADY_OPEN = 0x201E,
};

enum gsn_ptp_event_code {
    GSN_PTP_OBJECT_ADDED = 0x4002,
    GSN_PTP_OBJECT_REMOVED = 0x4003,
    GSN_PTP_OBJECT_INFO_CHANGED = 0x4007,
};

enum gsn_ptp_format {
    GSN_PTP_FORMAT_UNDEFINED = 0x3000,
    GSN_PTP_FORMAT_ASSOCIATION = 0x3001, /* a folder */
    GSN_PTP_FORMAT_FIRST_IMAGE = 0x3800,
    GSN_PTP_FORMAT_LAST_IMAGE = 0x3FFF,
};

enum gsn_ptp_limits {
    GSN_PTP_HEADER = 12, /* bytes before a container's payload */
    GSN_PTP_PARAMETERS = 5,
    GSN_PTP_LONGEST_RESPONSE = GSN_PTP_HEADER + 4 * GSN_PTP_PARAMETERS,
    GSN_PTP_TEXT = 768, /* 254 UTF-16 units as UTF-8, and the zero */
    GSN_PTP_OPERATIONS = 512,
};

static const uint32_t gsn_ptp_every = 0xFFFFFFFF;   /* all storages, the root, a size untold */
static const uint32_t gsn_ptp_object_size = 0xDC04; /* MTP property: the size in 64 bits */
static const uint32_t gsn_ptp_no_transaction = 0;   /* outside a session */
static const uint32_t gsn_ptp_last_transaction = 0xFFFFFFFE;

uint16_t gsn_ptp_get16(const uint8_t *bytes);
uint32_t gsn_ptp_get32(const uint8_t *bytes);

struct gsn_ptp_header {
    uint32_t length; /* as the device claims; 0xFFFFFFFF where 32 bits do not hold it */
    uint16_t type, code;
    uint32_t transaction;
};

/* From GSN_PTP_HEADER bytes. Judges nothing. */
struct gsn_ptp_header gsn_ptp_read_header(const uint8_t bytes[GSN_PTP_HEADER]);

struct gsn_ptp_request {
    uint16_t operation;
    unsigned count; /* of parameters */
    uint32_t parameter[GSN_PTP_PARAMETERS];
};

/* Writes the command container; returns its size, at most GSN_PTP_LONGEST_RESPONSE. */
size_t gsn_ptp_write_command(const struct gsn_ptp_request *request, uint32_t transaction,
                             uint8_t ret_bytes[GSN_PTP_LONGEST_RESPONSE]);

struct gsn_ptp_response {
    uint16_t code;
    unsigned count;
    uint32_t parameter[GSN_PTP_PARAMETERS];
};

/* From a container that is there in whole; parameters beyond the fifth are dropped. */
struct gsn_ptp_response gsn_ptp_read_response(const uint8_t *bytes, size_t size);

/* "General Error (0x2002)", for sentences; "a vendor's answer (0xA123)". Keeps within size. */
void gsn_ptp_describe(uint16_t code, char *ret_text, size_t size);

struct gsn_ptp_event {
    uint16_t code;
    uint32_t parameter; /* the first: an object's handle or a storage; 0 when there is none */
};

int gsn_ptp_read_event(const uint8_t *bytes, size_t size, struct gsn_ptp_event *ret_event,
                       struct gsn_error *err);

/* What the events told since the last call: hints, for they may be missing or wrong. */
struct gsn_ptp_hints {
    int any;
    size_t changed_count; /* handles of ObjectInfoChanged; more of them than fit: all_changed */
    uint32_t changed[16];
    int all_changed;
};

struct gsn_ptp_device_info {
    size_t operation_count;
    uint16_t operation[GSN_PTP_OPERATIONS]; /* those beyond are dropped */
    char maker[GSN_PTP_TEXT], model[GSN_PTP_TEXT], version[GSN_PTP_TEXT], serial[GSN_PTP_TEXT];
};

int gsn_ptp_read_device_info(const uint8_t *bytes, size_t size,
                             struct gsn_ptp_device_info *ret_info, struct gsn_error *err);
int gsn_ptp_offers(const struct gsn_ptp_device_info *info, uint16_t operation);

struct gsn_ptp_object_info {
    uint32_t storage, parent; /* parent 0: in the root */
    uint16_t format;
    uint32_t size; /* gsn_ptp_every: look into the property */
    char name[GSN_PTP_TEXT];
    char captured[64], modified[64]; /* "20260101T120000.0", or empty */
};

int gsn_ptp_read_object_info(const uint8_t *bytes, size_t size,
                             struct gsn_ptp_object_info *ret_info, struct gsn_error *err);

/* A list of storages or of handles: the count it claims, when that many are there. The n-th of them
 * is gsn_ptp_get32(bytes + 4 + 4 * n). */
int gsn_ptp_read_list(const uint8_t *bytes, size_t size, uint32_t *ret_count,
                      struct gsn_error *err);

/* A property's value of 64 bits. */
int gsn_ptp_read_u64(const uint8_t *bytes, size_t size, uint64_t *ret_value, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
