/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A file that is put together in memory before it is written whole.
 *
 * Running out of memory sticks: later additions do nothing, and writing it fails. */
#ifndef GSN_PHANTOM_BUFFER_H
#define GSN_PHANTOM_BUFFER_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Starts as { 0 }; gsn_phantom_buffer_done() releases it. */
struct gsn_phantom_buffer {
    uint8_t *bytes;
    size_t size, room;
    int failed;
};

void gsn_phantom_buffer_done(struct gsn_phantom_buffer *buffer);

/* Puts size bytes at offset at; what lies between the old end and it becomes 0. Returns 0, or -1
 * when memory ran out. */
int gsn_phantom_buffer_put(struct gsn_phantom_buffer *buffer, size_t at, const void *bytes,
                           size_t size);

void gsn_phantom_buffer_print(struct gsn_phantom_buffer *buffer, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* Writes the file folder/name. Fails with GSN_E_NOMEM (sticky) or GSN_E_IO. */
int gsn_phantom_buffer_write(const struct gsn_phantom_buffer *buffer, const char *folder,
                             const char *name, struct gsn_error *err);

#define gsn_auto_phantom_buffer                                                                    \
    __attribute__((cleanup(gsn_phantom_buffer_done))) struct gsn_phantom_buffer

#ifdef __cplusplus
}
#endif
#endif
