/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Memory: counts times sizes are checked for overflow before the one door (mem_door.c) is asked,
 * and a zeroed array that holds two pages of 2 MiB or more asks the kernel for such pages (madvise,
 * MADV_HUGEPAGE). A formatted text is measured by vsnprintf() first. Failure: NULL; the caller says
 * for what. */
#include "pipeline/core/mem.h"

#include <stdarg.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>

void *gsn_alloc(size_t size)
{
    return gsn_mem_door(NULL, size ? size : 1, 0);
}

/* A picture's worth of memory is touched for the first time in pages of 2 MiB where the system has
 * them: in pages of 4 KiB that costs as much as decoding it. */
static void ask_for_large_pages(void *memory, size_t size)
{
    const uintptr_t page = (uintptr_t)2 << 20, at = (uintptr_t)memory;
    const uintptr_t first = (at + page - 1) & ~(page - 1), end = (at + size) & ~(page - 1);

    if (end > first && end - first >= 2 * page)
        (void)madvise((char *)memory + (first - at), end - first, MADV_HUGEPAGE);
}

void *gsn_alloc_array(size_t count, size_t size)
{
    void *memory;

    if (size && count > SIZE_MAX / size)
        return NULL;
    memory = gsn_mem_door(NULL, count && size ? count * size : 1, 1);
    if (memory)
        ask_for_large_pages(memory, count * size);
    return memory;
}

void *gsn_realloc_array(void *old, size_t count, size_t size)
{
    if (size && count > SIZE_MAX / size)
        return NULL;
    return gsn_mem_door(old, count && size ? count * size : 1, 0);
}

void *gsn_memdup(const void *bytes, size_t size)
{
    void *copy = gsn_alloc(size);

    if (copy && size)
        memcpy(copy, bytes, size);
    return copy;
}

char *gsn_strdup(const char *text)
{
    return gsn_memdup(text, strlen(text) + 1);
}

char *gsn_format(const char *format, ...)
{
    va_list args, again;
    char *text = NULL;
    int length;

    va_start(args, format);
    va_copy(again, args);
    length = vsnprintf(NULL, 0, format, args);
    if (length >= 0)
        text = gsn_alloc((size_t)length + 1);
    if (text)
        (void)vsnprintf(text, (size_t)length + 1, format, again);
    va_end(again);
    va_end(args);
    return text;
}

void gsn_free(void *memory)
{
    free(memory); /* door */
}
