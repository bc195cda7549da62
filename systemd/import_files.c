/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/import_parts.h"

#include "pipeline/core/file.h"
#include "storage/attachment.h"
#include "storage/queue.h"

#include <ctype.h>
#include <string.h>
#include <unistd.h>

/* A name that stays in the folder: the job must not reach elsewhere. */
static int check_name(const char *name, struct gsn_error *err)
{
    if (!name[0] || strchr(name, '/') || name[0] == '.')
        return gsn_fail(err, GSN_E_INPUT,
                        "job.json names \"%s\": a file must lie beside job.json, without folders",
                        name);
    return GSN_OK;
}

static int check_file(const struct gsn_import *import, const char *name, struct gsn_error *err)
{
    gsn_auto_fd fd = -1;
    struct gsn_error why = { 0 };
    int r = check_name(name, err);

    if (r < 0)
        return r;
    r = gsn_file_open_in(import->dir, name, &fd, &why);
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, GSN_E_INPUT, "job.json names \"%s\": there is no such file in %s",
                        name, import->dir);
    return r < 0 ? gsn_fail(err, r, "job.json names \"%s\": %.300s", name, why.text) : GSN_OK;
}

int gsn_import_check_files(const struct gsn_import *import, const struct gsn_protocol *protocol,
                           struct gsn_error *err)
{
    const char *const names[] = {
        protocol->region.file,
        protocol->kind == GSN_KIND_SECTIONS ? NULL : protocol->file,
        protocol->reference[0] ? protocol->reference : NULL,
    };

    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < sizeof names / sizeof names[0]; i++)
        r = names[i] ? check_file(import, names[i], err) : GSN_OK;
    for (size_t i = 0; r >= 0 && i < protocol->calibration_count; i++)
        r = check_file(import, protocol->calibration[i].file, err);
    return r;
}

/* What rests on an attachment is asked for together with its change. */
static int log_attachment(struct gsn_import_work *in, const struct gsn_attachment_row *row,
                          struct gsn_error *err)
{
    int64_t job = 0;
    int again = 0, r = gsn_store_begin(in->import->store, err);

    if (r < 0)
        return r;
    r = gsn_attachment_put(in->import->store, in->specimen, row, &again, err);
    if (r >= 0 && !again)
        r = gsn_queue_add(in->import->store, in->specimen, 0, &job, err);
    if (r < 0) {
        gsn_store_rollback(in->import->store);
        return r;
    }
    return gsn_store_commit(in->import->store, err);
}

static int attach_one(struct gsn_import_work *in, const char *name, uint8_t **ret_bytes,
                      size_t *ret_size, struct gsn_error *err)
{
    gsn_auto_fd fd = -1;
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_spooled spooled;
    size_t size;
    int r = check_name(name, err);

    if (r >= 0)
        r = gsn_file_open_in(in->import->dir, name, &fd, err);
    if (r >= 0)
        r = gsn_file_read_open(fd, name, GSN_SPOOL_MOST_BYTES, &bytes, &size, err);
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, GSN_E_INPUT, "a header names \"%s\": there is no such file in %s",
                        name, in->import->dir);
    if (r >= 0)
        r = gsn_spool_take(in->spool, bytes, size, name, &spooled, err);
    if (r >= 0) {
        const struct gsn_attachment_row row = { .name = name,
                                                .sha256 = spooled.digest.hex,
                                                .size = (int64_t)size };

        r = log_attachment(in, &row, err);
    }
    if (r < 0)
        return r;
    in->counts.attached++;
    if (ret_bytes) {
        *ret_bytes = gsn_steal(&bytes);
        *ret_size = size;
    }
    return GSN_OK;
}

/* The value of "key = value" or "key: value" in a volume's header, or NULL. gives. */
static char *header_value(const char *text, size_t size, const char *key)
{
    const char *end = text + (size > 65536 ? 65536 : size);
    const size_t key_length = strlen(key);

    for (const char *line = text; line < end;) {
        const char *stop = memchr(line, '\n', (size_t)(end - line));
        const char *at = line + key_length;

        stop = stop ? stop : end;
        if (stop - line > (ptrdiff_t)key_length && strncmp(line, key, key_length) == 0) {
            while (at < stop && strchr(" \t=:", *at))
                at++;
            while (stop > at && isspace((unsigned char)stop[-1]))
                stop--;
            return gsn_format("%.*s", (int)(stop - at), at);
        }
        line = stop + 1;
    }
    return NULL;
}

/* A mask or volume, and the file its header keeps the voxels in. */
static int attach_volume(struct gsn_import_work *in, const char *name, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    gsn_auto_mem(char) data = NULL;
    size_t size;
    int r = attach_one(in, name, &bytes, &size, err);

    if (r < 0)
        return r;
    data = header_value((const char *)bytes, size, "ElementDataFile");
    if (!data)
        data = header_value((const char *)bytes, size, "data file");
    if (!data || strcmp(data, "LOCAL") == 0)
        return GSN_OK;
    return attach_one(in, data, NULL, NULL, err);
}

int gsn_import_attach_files(struct gsn_import_work *in, const struct gsn_protocol *protocol,
                            struct gsn_error *err)
{
    int r = GSN_OK;

    if (protocol->region.file)
        r = attach_volume(in, protocol->region.file, err);
    if (r >= 0 && protocol->kind == GSN_KIND_VOLUME)
        r = attach_volume(in, protocol->file, err);
    if (r >= 0 && protocol->kind == GSN_KIND_TILE)
        r = attach_one(in, protocol->file, NULL, NULL, err);
    if (r >= 0 && protocol->reference[0])
        r = attach_one(in, protocol->reference, NULL, NULL, err);
    for (size_t i = 0; r >= 0 && i < protocol->calibration_count; i++)
        r = attach_one(in, protocol->calibration[i].file, NULL, NULL, err);
    return r;
}
