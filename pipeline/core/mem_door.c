/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The one call of the system's allocator, which the tests replace when they link (ld --wrap) to
 * make the n-th allocation fail. */
#include "pipeline/core/mem.h"

#include <stdlib.h>

/* Alone in its file: the linker can only wrap a symbol that is used from elsewhere. */
void *gsn_mem_door(void *old, size_t size, int zeroed)
{
    return zeroed ? calloc(1, size) : realloc(old, size); /* door */
}
