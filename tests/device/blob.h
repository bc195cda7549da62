/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Bytes that grow: the datasets of a PTP responder. */
#ifndef GSN_TESTS_DEVICE_BLOB_H
#define GSN_TESTS_DEVICE_BLOB_H

#include <stddef.h>
#include <stdint.h>

struct blob {
    uint8_t *bytes; /* free() */
    size_t size, room;
};

/* Room for size more bytes, zeroed, at its end; never NULL: a test without memory is over. */
uint8_t *blob_extend(struct blob *blob, size_t size);
void blob_u8(struct blob *blob, uint32_t value);
void blob_u16(struct blob *blob, uint32_t value);
void blob_u32(struct blob *blob, uint32_t value);
void blob_u64(struct blob *blob, uint64_t value);
/* A PTP string (ISO 15740, 5.3.4): a count with the final zero in it, then UTF-16 from UTF-8. */
void blob_string(struct blob *blob, const char *text);
/* A PTP array: a count, then the values. */
void blob_array16(struct blob *blob, const uint16_t *values, size_t count);

#endif
