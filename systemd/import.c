/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/import.h"

#include "acquire/source.h"
#include "acquire/spool.h"
#include "pipeline/core/file.h"
#include "pipeline/protocol.h"
#include "storage/attachment.h"
#include "storage/catalog.h"
#include "storage/event.h"
#include "storage/panel_log.h"
#include "storage/panel_name.h"
#include "storage/queue.h"

#include <ctype.h>
#include <math.h>
#include <stdio.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

enum {
    MOST_JOB_BYTES = 1 << 20,
    MOST_ATTACHED_BYTES = 1 << 30,
    SETTLE_MS = 150, /* two looks at the folder, this far apart, must agree */
    MOST_LOOKS = 100,
};

/* Space that must stay free, so that the database can always finish what it began. */
static const uint64_t RESERVE_BYTES = (uint64_t)64 << 20;

static void notice(const struct gsn_import *import, const char *name, const char *sentence)
{
    if (import->notice)
        import->notice(import->context, name, sentence);
}

/* ---- files the job names ----------------------------------------------------------------- */

struct intake {
    const struct gsn_import *import;
    const struct gsn_protocol *protocol;
    struct gsn_spool *spool;
    int64_t specimen;
    struct gsn_import_counts counts;
};

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
    gsn_auto_mem(char) path = gsn_format("%s/%s", import->dir, name);
    const int r = check_name(name, err);

    if (r < 0)
        return r;
    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (access(path, F_OK) < 0)
        return gsn_fail(err, GSN_E_INPUT, "job.json names \"%s\": there is no such file in %s",
                        name, import->dir);
    return GSN_OK;
}

/* Before anything is written: a job that must be corrected leaves no specimen of its name. */
static int check_files(const struct gsn_import *import, const struct gsn_protocol *protocol,
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
static int log_attachment(struct intake *in, const struct gsn_attachment_row *row,
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

static int attach_one(struct intake *in, const char *name, uint8_t **ret_bytes, size_t *ret_size,
                      struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", in->import->dir, name);
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct gsn_spooled spooled;
    size_t size;
    int r = check_name(name, err);

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (r >= 0)
        r = gsn_file_read(path, MOST_ATTACHED_BYTES, &bytes, &size, err);
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
static int attach_volume(struct intake *in, const char *name, struct gsn_error *err)
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

static int attach_files(struct intake *in, const struct gsn_protocol *protocol,
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

/* ---- panels ------------------------------------------------------------------------------ */

/* Held panels are looked at again: the one that stood in their way may have a new name. */
static int release_held(struct intake *in, struct gsn_error *err)
{
    gsn_auto(gsn_panel_rows) rows = NULL;
    int r = gsn_panel_list(in->import->store, in->specimen, &rows, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++) {
        int64_t job;

        if (strcmp(rows->at[i].state, "held") != 0)
            continue;
        r = gsn_panel_set_state(in->import->store, rows->at[i].id, "waiting", NULL, NULL, err);
        if (r >= 0)
            r = gsn_queue_add(in->import->store, in->specimen, rows->at[i].id, &job, err);
    }
    return r;
}

/* Bytes that are known under another name: a held panel takes the new one, which is how a person
 * answers what it was held for. */
static int rename_panel(struct intake *in, int64_t panel, const struct gsn_panel_row *now,
                        struct gsn_error *err)
{
    gsn_auto(gsn_panel_row) was = NULL;
    int r = gsn_panel_get(in->import->store, panel, &was, err);

    if (r < 0 || strcmp(was->state, "held") != 0 || strcmp(was->file_name, now->file_name) == 0)
        return r;
    r = gsn_panel_set_name(in->import->store, panel, now->number, now->file_name, err);
    if (r >= 0)
        r = gsn_event_add(in->import->store, time(NULL), in->import->actor, "rename",
                          now->file_name, was->file_name, err);
    return r < 0 ? r : release_held(in, err);
}

static int log_panel(struct intake *in, const struct gsn_source_event *item,
                     const struct gsn_spooled *spooled, struct gsn_error *err)
{
    const unsigned number = gsn_panel_number(item->name, 0);
    const struct gsn_panel_row row = { .specimen_id = in->specimen,
                                       .number = number,
                                       .file_name = item->name,
                                       .sha256 = spooled->digest.hex,
                                       .size = (int64_t)spooled->size,
                                       .state = "waiting",
                                       .code = "",
                                       .message = "",
                                       .px_um = NAN };
    int64_t panel, job;
    int again, r;

    r = gsn_store_begin(in->import->store, err);
    if (r < 0)
        return r;
    r = gsn_panel_put(in->import->store, &row, &panel, &again, err);
    if (r >= 0 && again)
        r = rename_panel(in, panel, &row, err);
    if (r >= 0 && !again)
        r = gsn_queue_add(in->import->store, in->specimen, panel, &job, err);
    if (r >= 0 && !again)
        r = gsn_event_add(in->import->store, time(NULL), in->import->actor, "panel", item->name,
                          spooled->digest.hex, err);
    if (r < 0) {
        gsn_store_rollback(in->import->store);
        return r;
    }
    r = gsn_store_commit(in->import->store, err);
    if (r < 0)
        return r;
    if (again) {
        in->counts.again++;
        notice(in->import, item->name, "the same bytes are in the store already");
    } else {
        in->counts.taken++;
        if (number == 0) {
            in->counts.held++;
            notice(in->import, item->name, "its name holds no panel number");
        }
    }
    return GSN_OK;
}

/* It lies beside the panels and is none. */
static int is_calibration(const struct gsn_protocol *protocol, const char *name)
{
    for (size_t i = 0; i < protocol->calibration_count; i++)
        if (strcmp(protocol->calibration[i].file, name) == 0)
            return 1;
    return 0;
}

static int take_item(struct intake *in, struct gsn_source *source,
                     const struct gsn_source_event *item, struct gsn_error *err)
{
    struct gsn_spooled spooled;
    int r;

    if (is_calibration(in->protocol, item->name))
        return gsn_source_acknowledge(source, item->item, err);
    if (item->incomplete)
        notice(in->import, item->name, item->reason);
    r = gsn_spool_take_item(in->spool, source, item, &spooled, err);
    /* An empty file cannot become an object; it is named and left where it is. */
    if (r == GSN_E_INPUT && item->size == 0) {
        notice(in->import, item->name, "the file is empty");
        return gsn_source_acknowledge(source, item->item, err);
    }
    if (r >= 0)
        r = log_panel(in, item, &spooled, err);
    return r < 0 ? r : gsn_source_acknowledge(source, item->item, err);
}

static int64_t milliseconds(void)
{
    struct timespec now;

    (void)clock_gettime(CLOCK_MONOTONIC, &now);
    return (int64_t)now.tv_sec * 1000 + now.tv_nsec / 1000000;
}

static int take_panels(struct intake *in, struct gsn_error *err)
{
    const struct gsn_source_options options = { .settle_ms = SETTLE_MS, .patience_ms = SETTLE_MS };
    const struct timespec pause = { .tv_nsec = (SETTLE_MS + 20) * 1000000L };
    gsn_auto_mem(char) address = gsn_format("replay:%s", in->import->dir);
    gsn_auto(gsn_source) source = NULL;
    int ended = 0;
    int r;

    if (!address)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    r = gsn_source_open(address, &options, &source, err);
    for (int look = 0; r >= 0 && !ended && look < MOST_LOOKS; look++) {
        gsn_auto(gsn_source_events) events = NULL;

        if (look > 0)
            (void)nanosleep(&pause, NULL);
        r = gsn_source_poll(source, milliseconds(), &events, &ended, err);
        for (size_t i = 0; r >= 0 && i < events->count; i++) {
            const struct gsn_source_event *event = &events->at[i];

            if (event->what == GSN_SOURCE_READY)
                r = take_item(in, source, event, err);
        }
    }
    if (r >= 0 && !ended)
        return gsn_fail(err, GSN_E_BUSY, "%s keeps changing: import it when the copy is done",
                        in->import->dir);
    return r;
}

/* ---- the specimen ------------------------------------------------------------------------ */

static int put_specimen(struct intake *in, const struct gsn_protocol *protocol, const char *text,
                        struct gsn_error *err)
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
static int ask_again(struct intake *in, struct gsn_error *err)
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
static int ask_for_report(struct intake *in, struct gsn_error *err)
{
    int64_t job;

    if (in->import->replace)
        return gsn_queue_add(in->import->store, in->specimen, 0, &job, err);
    return gsn_queue_add_first(in->import->store, in->specimen, err);
}

static int take_everything(struct intake *in, const struct gsn_protocol *protocol, const char *text,
                           struct gsn_error *err)
{
    int r = check_files(in->import, protocol, err);

    in->protocol = protocol;
    if (r >= 0)
        r = put_specimen(in, protocol, text, err);
    if (r >= 0 && in->import->replace)
        r = ask_again(in, err);
    if (r >= 0)
        r = attach_files(in, protocol, err);
    if (r >= 0 && protocol->kind == GSN_KIND_SECTIONS)
        r = take_panels(in, err);
    if (r >= 0)
        r = ask_for_report(in, err);
    return r;
}

int gsn_import_folder(const struct gsn_import *import, char **ret_specimen,
                      struct gsn_import_counts *ret_counts, struct gsn_error *err)
{
    struct intake in = { .import = import };
    gsn_auto(gsn_spool) spool = NULL;
    gsn_auto(gsn_protocol) protocol = NULL;
    gsn_auto_mem(char) path = gsn_format("%s/job.json", import->dir);
    gsn_auto_mem(uint8_t) file = NULL;
    gsn_auto_mem(char) name = NULL;
    const char *text = import->job_text;
    size_t size = text ? strlen(text) : 0;
    int r = GSN_OK;

    if (!path)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory");
    if (!text) {
        r = gsn_file_read(path, MOST_JOB_BYTES, &file, &size, err);
        text = (const char *)file;
    }
    if (r == GSN_E_NOTFOUND)
        return gsn_fail(err, r,
                        "%s has no job.json: it says whose sections these are (see docs/job.md)",
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
