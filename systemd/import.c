/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/import.h"

#include "pipeline/core/file.h"
#include "storage/catalog.h"
#include "storage/panel_log.h"
#include "storage/queue.h"
#include "systemd/import_parts.h"

#include <string.h>
#include <time.h>
#include <unistd.h>

enum { MOST_JOB_BYTES = 1 << 20 };

/* Space that must stay free, so that the database can always finish what it began. */
static const uint64_t RESERVE_BYTES = (uint64_t)64 << 20;

static int put_specimen(struct gsn_import_work *in, const struct gsn_protocol *protocol,
                        const char *text, struct gsn_error *err)
{
    static const char *const kinds[] = { "sections", "volume", "tile" };
    const struct gsn_specimen_row row = { .name = protocol->specimen,
                                          .study = protocol->study,
                                          .group = protocol->group,
                                          .animal = protocol->animal,
                                          .week = protocol->week,
                                          .kind = kinds[protocol->kind],
                                          .baseline = protocol->baseline,
                                          .job_json = text,
                                          .job_sha256 = "" };

    return gsn_specimen_put(in->import->store, &row,
                            in->import->replace ? GSN_SPECIMEN_REPLACE : GSN_SPECIMEN_REFUSE,
                            in->import->actor, time(NULL), &in->specimen, err);
}

/* New settings can change what is found on every panel that came before. */
static int ask_again(struct gsn_import_work *in, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) panels = NULL;
    int64_t job;
    int r = gsn_panel_list(in->import->store, in->specimen, &panels, err);

    for (size_t i = 0; r >= 0 && i < panels->count; i++)
        r = gsn_queue_add(in->import->store, in->specimen, panels->at[i].id, &job, err);
    return r;
}

/* Panels and attachments that are new have asked for it; importing a folder again in which nothing
 * is new must not. */
static int ask_for_report(struct gsn_import_work *in, struct gsn_error *err)
{
    int64_t job;

    if (in->import->replace)
        return gsn_queue_add(in->import->store, in->specimen, 0, &job, err);
    return gsn_queue_add_first(in->import->store, in->specimen, err);
}

static int take_everything(struct gsn_import_work *in, const struct gsn_protocol *protocol,
                           const char *text, struct gsn_error *err)
{
    int r = gsn_import_check_files(in->import, protocol, err);

    in->protocol = protocol;
    if (r >= 0)
        r = gsn_import_check_job(in->import, protocol, err);
    if (r >= 0)
        r = put_specimen(in, protocol, text, err);
    if (r >= 0 && in->import->replace)
        r = ask_again(in, err);
    if (r >= 0)
        r = gsn_import_attach_files(in, protocol, err);
    if (r >= 0 && protocol->kind == GSN_KIND_SECTIONS)
        r = gsn_import_take_panels(in, err);
    if (r >= 0)
        r = gsn_import_forget_left(in, err);
    if (r >= 0)
        r = ask_for_report(in, err);
    return r >= 0 ? gsn_import_tell_job(in, err) : r;
}

static void work_done(struct gsn_import_work *in)
{
    for (unsigned i = 0; i < in->counts.left_out; i++)
        gsn_free(in->left[i]);
    gsn_free(in->left);
}

int gsn_import_folder(const struct gsn_import *import, char **ret_specimen,
                      struct gsn_import_counts *ret_counts, struct gsn_error *err)
{
    __attribute__((cleanup(work_done))) struct gsn_import_work in = { .import = import };
    gsn_auto(gsn_spool) spool = NULL;
    gsn_auto(gsn_protocol) protocol = NULL;
    gsn_auto_mem(uint8_t) file = NULL;
    gsn_auto_mem(char) name = NULL;
    const char *text = import->job_text;
    size_t size = text ? strlen(text) : 0;
    int r = GSN_OK;

    if (!text) {
        gsn_auto_fd fd = -1;

        r = gsn_file_open_in(import->dir, "job.json", &fd, err);
        if (r >= 0)
            r = gsn_file_read_open(fd, "job.json", MOST_JOB_BYTES, &file, &size, err);
        text = (const char *)file;
    }
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(
            err, r,
            access(import->dir, F_OK) < 0
                ? "there is no folder %s"
                : "%s has no job.json: it says whose sections these are (see man gieson-job)",
            import->dir);
    if (r >= 0)
        r = gsn_protocol_parse(text, size, &protocol, err);
    if (r >= 0)
        r = gsn_spool_open(gsn_store_dir(import->store), RESERVE_BYTES, &spool, err);
    if (r < 0)
        return r;
    in.spool = spool;
    name = gsn_strdup(protocol->specimen);
    if (!name)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = take_everything(&in, protocol, text, err);
    if (r < 0)
        return r;
    *ret_specimen = gsn_steal(&name);
    *ret_counts = in.counts;
    return GSN_OK;
}
