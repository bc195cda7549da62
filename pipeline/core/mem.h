/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Memory, and who owns it.
 *
 * Every byte of ours comes through one door, gsn_mem_door(), so that the tests can make the n-th
 * allocation fail. Locals own with gsn_auto(type) x = NULL; and hand over with gsn_steal(&x). */
#ifndef GSN_CORE_MEM_H
#define GSN_CORE_MEM_H

#include <stddef.h>

#ifdef __cplusplus
extern "C" {
#endif

/* gives: size bytes, uninitialised; NULL when memory runs out. A size of 0 is taken as 1. */
void *gsn_alloc(size_t size);
/* gives: count zeroed items; NULL when memory runs out or count * size overflows. */
void *gsn_alloc_array(size_t count, size_t size);
/* Resizes to count items, takes old and gives the result; NULL leaves old as it was. */
void *gsn_realloc_array(void *old, size_t count, size_t size);
/* gives: a copy. */
char *gsn_strdup(const char *text);
void *gsn_memdup(const void *bytes, size_t size);
/* gives: formatted text. */
char *gsn_format(const char *format, ...) __attribute__((format(printf, 1, 2)));
void gsn_free(void *memory);

/* The one place that asks the system. Same contract as realloc(), or with zeroed and no old as
 * calloc(), which knows what memory comes from the system as zeros; tests wrap it at link time. */
void *gsn_mem_door(void *old, size_t size, int zeroed);

/* For struct NAME with a NAME_free(). */
#define GSN_DEFINE_AUTO(name)                                                                      \
    static inline void gsn_auto_##name(struct name **owned)                                        \
    {                                                                                              \
        name##_free(*owned);                                                                       \
    }                                                                                              \
    struct gsn_auto_##name##_needs_a_semicolon

#define gsn_auto(name) __attribute__((cleanup(gsn_auto_##name))) struct name *

/* Plain memory of any type: gsn_auto_mem(double) x = gsn_alloc_array(...); */
static inline void gsn_auto_release(void *owned)
{
    gsn_free(*(void **)owned);
}
#define gsn_auto_mem(type) __attribute__((cleanup(gsn_auto_release))) type *

#define gsn_steal(owned)                                                                           \
    __extension__({                                                                                \
        __typeof__(*(owned)) stolen_ = *(owned);                                                   \
        *(owned) = NULL;                                                                           \
        stolen_;                                                                                   \
    })

#ifdef __cplusplus
}
#endif
#endif
