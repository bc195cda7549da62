/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A PTP device at the other end, and the questions a source of pictures asks it.
 *
 * Responders differ in what they offer and in what they refuse; the ways around live here. A
 * question that the device refused fails with GSN_E_INPUT and *ret_code says how; all other codes
 * are those of gsn_ptp_ask(). */
#ifndef GSN_ACQUIRE_PTP_DEVICE_H
#define GSN_ACQUIRE_PTP_DEVICE_H

#include "acquire/ptp_session.h"

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_ptp_piece_sizes {
    GSN_PTP_LARGEST_PIECE = 1 << 20, /* some firmware crashes when it is asked for more */
    GSN_PTP_SMALLEST_PIECE = 1 << 16,
};

/* A long answer under way, of devices that give objects only in whole. */
struct gsn_ptp_stream {
    uint32_t handle;
    uint64_t at; /* bytes read of it */
};

struct gsn_ptp_device {
    struct gsn_ptp_transport *transport;
    struct gsn_ptp_session *session;
    struct gsn_ptp_device_info info;
    bool greeted;                   /* info is known */
    size_t piece;                   /* bytes asked for at once */
    bool no_partial, no_partial_64; /* offered, but refused when asked */
    struct gsn_ptp_stream stream;
};

/* takes: the transport, also on failure. Does not talk to the device. gives: the device. */
int gsn_ptp_device_new(struct gsn_ptp_transport *transport, struct gsn_ptp_device **ret_device,
                       struct gsn_error *err);
/* Closes the session as far as the device listens, and the transport. */
void gsn_ptp_device_free(struct gsn_ptp_device *device);
GSN_DEFINE_AUTO(gsn_ptp_device);

/* A session is open and DeviceInfo known. */
int gsn_ptp_device_greet(struct gsn_ptp_device *device, struct gsn_error *err);

/* borrows: the serial number, of the USB descriptor or else of DeviceInfo; empty for none. */
const char *gsn_ptp_device_serial(const struct gsn_ptp_device *device);

struct gsn_ptp_handles {
    size_t count, room;
    uint32_t *at;
};

int gsn_ptp_handles_add(struct gsn_ptp_handles *handles, uint32_t handle, struct gsn_error *err);

/* Adds the handles in this folder, or all that the device lists by itself for folder 0: those in
 * the root at least, of every storage. */
int gsn_ptp_device_list(struct gsn_ptp_device *device, uint32_t storage, uint32_t folder,
                        struct gsn_ptp_handles *handles, uint16_t *ret_code, struct gsn_error *err);

/* ret_size: in 64 bits; UINT64_MAX when it is over 4 GiB and the device does not tell. */
int gsn_ptp_device_describe(struct gsn_ptp_device *device, uint32_t handle,
                            struct gsn_ptp_object_info *ret_info, uint64_t *ret_size,
                            uint16_t *ret_code, struct gsn_error *err);

/* Reads a piece of an object of this size: by GetPartialObject, where its offset ends by the 64-bit
 * one, else out of a stream of the whole object, for which offsets best rise. At least 1 byte, or
 * it fails: with GSN_E_LIMIT when the object turns out to be of another size. */
int gsn_ptp_device_read(struct gsn_ptp_device *device, uint32_t handle, uint64_t object_size,
                        uint64_t offset, void *buffer, size_t size, size_t *ret_got,
                        uint16_t *ret_code, struct gsn_error *err);

int gsn_ptp_device_delete(struct gsn_ptp_device *device, uint32_t handle, uint16_t *ret_code,
                          struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
