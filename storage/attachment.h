/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The files a specimen's job names beside its panels: region masks, volumes, reference maps. Their
 * bytes are objects; a row says which name stands for which. */
#ifndef GSN_STORAGE_ATTACHMENT_H
#define GSN_STORAGE_ATTACHMENT_H

#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_attachment_row {
    const char *name;   /* as the job writes it, unique in the specimen */
    const char *sha256; /* names the object */
    int64_t size;       /* bytes */
};

struct gsn_attachment_rows {
    size_t count;
    struct gsn_attachment_row *at;
};

void gsn_attachment_rows_free(struct gsn_attachment_rows *rows);
GSN_DEFINE_AUTO(gsn_attachment_rows);

/* Inserts the row, or lets an existing name stand for these bytes from now on. ret_again: 1 when it
 * stood for them already.
 * Fails with GSN_E_INPUT when the specimen is unknown or the digest is none. */
int gsn_attachment_put(struct gsn_store *store, int64_t specimen_id,
                       const struct gsn_attachment_row *row, int *ret_again, struct gsn_error *err);

/* gives: one specimen's attachments, by name. */
int gsn_attachment_list(struct gsn_store *store, int64_t specimen_id,
                        struct gsn_attachment_rows **ret_rows, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
