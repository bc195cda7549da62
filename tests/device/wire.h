/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Little-endian numbers as they lie on the bus. The models have their own, so that a mistake in the
 * product's is seen. */
#ifndef GSN_TESTS_DEVICE_WIRE_H
#define GSN_TESTS_DEVICE_WIRE_H

#include <stdint.h>

static inline void wire_put16(uint8_t *at, uint32_t value)
{
    at[0] = (uint8_t)value;
    at[1] = (uint8_t)(value >> 8);
}

static inline void wire_put32(uint8_t *at, uint32_t value)
{
    wire_put16(at, value);
    wire_put16(at + 2, value >> 16);
}

static inline uint16_t wire_get16(const uint8_t *at)
{
    return (uint16_t)(at[0] | at[1] << 8);
}

static inline uint32_t wire_get32(const uint8_t *at)
{
    return wire_get16(at) | (uint32_t)wire_get16(at + 2) << 16;
}

/* The same in a constant descriptor. */
#define WIRE16(value) (uint8_t)(value), (uint8_t)((value) >> 8)
#define WIRE32(value) WIRE16(value), WIRE16((value) >> 16)

#endif
