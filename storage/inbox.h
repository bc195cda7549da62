/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a handle remembers of the pictures that it took into the inbox itself, so that it need not
 * look through them for each new one. Private to this folder. */
#ifndef GSN_STORAGE_INBOX_H
#define GSN_STORAGE_INBOX_H

#include <stdint.h>

/* So many lie in the inbox of one handle at most: enough that settling them adds little to each,
 * few enough that it takes some milliseconds. */
enum { GSN_INBOX_MOST = 256 };

/* The rows first, first + 1, ... in the order of their tags; those of another handle never lie
 * between. count 0: nothing is remembered. */
struct gsn_inbox {
    unsigned unsettled; /* taken in and not settled by this handle */
    unsigned count;
    int64_t first;
    uint64_t tag[GSN_INBOX_MOST];
};

#endif
