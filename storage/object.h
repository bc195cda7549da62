/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The objects that rows rest on: which there must be, and whose they are. */
#ifndef GSN_STORAGE_OBJECT_H
#define GSN_STORAGE_OBJECT_H

#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_object_row {
    const char *sha256;
    int64_t size; /* bytes */
};

struct gsn_object_rows {
    size_t count;
    struct gsn_object_row *at;
};

void gsn_object_rows_free(struct gsn_object_rows *rows);
GSN_DEFINE_AUTO(gsn_object_rows);

/* gives: at most most objects of panels, scans and attachments, each once, by digest, behind this
 * one (empty: from the first on). */
int gsn_object_list(struct gsn_store *store, const char *after, size_t most,
                    struct gsn_object_rows **ret_rows, struct gsn_error *err);

/* What rests on an object. */
struct gsn_object_use_row {
    const char *specimen; /* its name; empty for a scan that has none */
    const char *name;     /* of the file */
};

struct gsn_object_use_rows {
    size_t count;
    struct gsn_object_use_row *at;
};

void gsn_object_use_rows_free(struct gsn_object_use_rows *rows);
GSN_DEFINE_AUTO(gsn_object_use_rows);

/* gives: panels and attachments first, then scans that are no panel. */
int gsn_object_uses(struct gsn_store *store, const char *sha256,
                    struct gsn_object_use_rows **ret_rows, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
