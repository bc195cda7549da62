/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/material_parts.h"

#include "pipeline/core/file.h"
#include "pipeline/decode/volume.h"
#include "systemd/panel_job.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

enum { MOST_VOLUME_BYTES = 1 << 30 };

static const char *attached(const struct gsn_material *m, const char *name)
{
    for (size_t i = 0; name && i < m->attachments->count; i++)
        if (strcmp(m->attachments->at[i].name, name) == 0)
            return m->attachments->at[i].sha256;
    return NULL;
}

/* Headers name their data file, so the attached files get their own names again for a moment: as
 * links in a folder of their own. gives: the folder. */
static int lay_out(const struct gsn_material *m, char **ret_folder, struct gsn_error *err)
{
    const char *tmp = getenv("TMPDIR");
    gsn_auto_mem(char) folder = gsn_format("%s/gieson.XXXXXX", tmp && tmp[0] ? tmp : "/tmp");

    if (!folder)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (!mkdtemp(folder))
        return gsn_fail(err, GSN_E_IO, "%s: %s", folder, strerror(errno));
    for (size_t i = 0; i < m->attachments->count; i++) {
        gsn_auto_mem(char) path = NULL;
        gsn_auto_mem(char) whole = NULL;
        gsn_auto_mem(char) link = gsn_format("%s/%s", folder, m->attachments->at[i].name);
        int r = gsn_store_object_path(m->store, m->attachments->at[i].sha256, &path, err);

        if (r < 0)
            return r;
        whole = realpath(path, NULL);
        if (!link || !whole || symlink(whole, link) < 0)
            return gsn_fail(err, GSN_E_IO, "the file %s of this specimen: %s",
                            m->attachments->at[i].name, strerror(errno));
    }
    *ret_folder = gsn_steal(&folder);
    return GSN_OK;
}

static void sweep(const struct gsn_material *m, const char *folder)
{
    for (size_t i = 0; i < m->attachments->count; i++) {
        gsn_auto_mem(char) link = gsn_format("%s/%s", folder, m->attachments->at[i].name);

        if (link)
            (void)unlink(link);
    }
    (void)rmdir(folder);
}

static int read_volumes(struct gsn_material *m, const char *folder, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;
    const double unit_um = p->spacing_unit == GSN_SPACING_MM ? 1000 : 1;
    int r = GSN_OK;

    if (p->region.file) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, p->region.file);

        r = path ? gsn_volume_read_mask(path, MOST_VOLUME_BYTES, unit_um, &m->region, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");
    }
    if (r >= 0 && p->kind == GSN_KIND_VOLUME) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, p->file);

        r = path ? gsn_volume_read_grid(path, MOST_VOLUME_BYTES, unit_um, &m->volume, err)
                 : gsn_fail(err, GSN_E_NOMEM, "out of memory");
    }
    return r;
}

static int find_calibrations(struct gsn_material *m, struct gsn_error *err)
{
    const struct gsn_protocol *p = m->protocol;

    m->calibration_sha256 =
        gsn_alloc_array(p->calibration_count + 1, sizeof *m->calibration_sha256);
    if (!m->calibration_sha256)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the calibration panels");
    for (size_t i = 0; i < p->calibration_count; i++)
        m->calibration_sha256[i] = attached(m, p->calibration[i].file);
    m->specimen.calibration_sha256 = m->calibration_sha256;
    return GSN_OK;
}

int gsn_material_take_files(struct gsn_material *m, struct gsn_error *err)
{
    gsn_auto_mem(char) folder = NULL;
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < m->attachments->count; i++) {
        gsn_auto_mem(uint8_t) bytes = NULL;
        size_t size;

        r = gsn_object_read(m->store, m->attachments->at[i].sha256, &bytes, &size, err);
    }
    if (r < 0)
        return r;
    if (m->protocol->region.file || m->protocol->kind == GSN_KIND_VOLUME) {
        r = lay_out(m, &folder, err);
        if (r >= 0)
            r = read_volumes(m, folder, err);
        if (folder)
            sweep(m, folder);
    }
    m->specimen.region = m->region;
    m->specimen.volume = m->volume;
    if (m->protocol->kind == GSN_KIND_TILE)
        m->specimen.picture_sha256 = attached(m, m->protocol->file);
    if (m->protocol->kind == GSN_KIND_TILE && m->protocol->reference[0])
        m->specimen.reference_sha256 = attached(m, m->protocol->reference);
    return r < 0 ? r : find_calibrations(m, err);
}
