/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Who was cut: studies with their groups and animals, and the specimens taken from them.
 *
 * Names are data: any bytes but a zero, of any length. A specimen's name is unique in the store, a
 * group's and an animal's within their study. */
#ifndef GSN_STORAGE_CATALOG_H
#define GSN_STORAGE_CATALOG_H

#include "storage/store.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* Texts may be empty but never NULL. */
struct gsn_specimen_row {
    int64_t id;
    const char *name;
    const char *study, *group, *animal;
    double week;            /* NaN: not told */
    const char *kind;       /* "sections", "volume" or "tile" */
    const char *baseline;   /* a specimen's name, else a group of the same study, else empty */
    const char *job_json;   /* the operator's text, byte for byte */
    const char *job_sha256; /* of job_json; 64 hexadecimal digits */
};

struct gsn_specimen_rows {
    size_t count;
    struct gsn_specimen_row *at;
};

void gsn_specimen_row_free(struct gsn_specimen_row *row);

GSN_DEFINE_AUTO(gsn_specimen_row);

void gsn_specimen_rows_free(struct gsn_specimen_rows *rows);

GSN_DEFINE_AUTO(gsn_specimen_rows);

enum gsn_specimen_clash {
    GSN_SPECIMEN_REFUSE,  /* an existing name with another job text is an error */
    GSN_SPECIMEN_REPLACE, /* the row takes the new text; an event keeps the old one */
};

/* Inserts a specimen (its id and job_sha256 are not read), with its study, group and animal.
 *
 * One of the same name and the same job text is left as it is and its id returned. Fails with
 * GSN_E_INPUT when the name is empty, the kind is none of the three, or the name exists with
 * another job text and clash is GSN_SPECIMEN_REFUSE. actor and now go into the event. */
int gsn_specimen_put(struct gsn_store *store, const struct gsn_specimen_row *specimen,
                     enum gsn_specimen_clash clash, const char *actor, int64_t now, int64_t *ret_id,
                     struct gsn_error *err);

/* gives. Fails with GSN_E_NOTFOUND "there is no specimen X". */
int gsn_specimen_get(struct gsn_store *store, const char *name,
                     struct gsn_specimen_row **ret_specimen, struct gsn_error *err);

int gsn_specimen_get_by_id(struct gsn_store *store, int64_t id,
                           struct gsn_specimen_row **ret_specimen, struct gsn_error *err);

/* gives: all, in order of id. */
int gsn_specimen_list(struct gsn_store *store, struct gsn_specimen_rows **ret_rows,
                      struct gsn_error *err);

/* gives: the specimens a baseline text stands for, seen from this study, in order of id: the one
 * of that name, else all of that group. None is an empty list. */
int gsn_specimen_baseline(struct gsn_store *store, const char *study, const char *baseline,
                          struct gsn_specimen_rows **ret_rows, struct gsn_error *err);

/* gives: the specimens whose baseline stands for this one (by its name or its group), in order of
 * id, never itself: their figures change when this one's do. */
int gsn_specimen_dependents(struct gsn_store *store, int64_t specimen_id,
                            struct gsn_specimen_rows **ret_rows, struct gsn_error *err);

/* The files a specimen's job names beside its panels: region masks, volumes, reference maps. Their
 * bytes are objects; a row says which name stands for which. */

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

/* The objects that rows rest on: which there must be, and whose they are. */

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

/* gives: the bytes of an object, after its hash was compared with its name.
 * Fails with GSN_E_NOTFOUND, GSN_E_IO "... is damaged". */
int gsn_object_read(struct gsn_store *store, const char *sha256, uint8_t **ret_bytes,
                    size_t *ret_size, struct gsn_error *err);

/* gives: a descriptor to close(), of an object whose bytes were just found to have this hash. */
int gsn_object_open(struct gsn_store *store, const char *sha256, int *ret_fd,
                    struct gsn_error *err);

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
