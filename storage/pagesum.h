/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A checksum in every page of the database, so that a disk that changes a bit is noticed wherever
 * the bit lies. Private to this folder, and to tests that must know the format. */
#ifndef GSN_STORAGE_PAGESUM_H
#define GSN_STORAGE_PAGESUM_H

#include "pipeline/core/error.h"

#include <stddef.h>
#include <stdint.h>

enum { GSN_PAGESUM_BYTES = 8 }; /* at the end of every page, which SQLite leaves alone */

/* The name under which SQLite opens files with page checksums; NULL when memory ran out. */
const char *gsn_pagesum_vfs(void);

/* What gsn_pagesum_check() saw. */
struct gsn_pagesum_verdict {
    int64_t pages;
    int64_t damaged; /* how many are not what was written */
    int64_t without; /* how many another program wrote back; they have no checksum to compare */
};

/* Reads the database file itself, past SQLite. damaged: told of each page, counted from 1, whose
 * bytes are not those that were written. Fails with GSN_E_STORE when the file does not say that its
 * pages have checksums, GSN_E_NOTFOUND, GSN_E_IO, GSN_E_NOMEM. */
int gsn_pagesum_check(const char *path, void (*damaged)(void *context, int64_t page), void *context,
                      struct gsn_pagesum_verdict *ret_verdict, struct gsn_error *err);

/* The checksum that the size bytes of a page in front of it have. */
void gsn_pagesum(const uint8_t *page, size_t size, uint8_t ret_sum[GSN_PAGESUM_BYTES]);

#endif
