/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/import_parts.h"

#include "acquire/source.h"
#include "storage/event.h"
#include "storage/panel_log.h"
#include "storage/panel_name.h"
#include "storage/queue.h"
#include "storage/torn.h"

#include <math.h>
#include <string.h>
#include <time.h>

enum {
    SETTLE_MS = 150, /* two looks at the folder, this far apart, must agree */
    MOST_LOOKS = 100,
};

static void notice(const struct gsn_import *import, const char *name, const char *sentence)
{
    if (import->notice)
        import->notice(import->context, name, sentence);
}

/* Held panels are looked at again: the one that stood in their way may have a new name. */
static int release_held(struct gsn_import_work *in, struct gsn_error *err)
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
static int rename_panel(struct gsn_import_work *in, int64_t panel, const struct gsn_panel_row *now,
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

static int log_panel(struct gsn_import_work *in, const struct gsn_source_event *item,
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
    int64_t panel = 0, job, mended = 0;
    int again = 0, r;

    r = gsn_store_begin(in->import->store, err);
    if (r < 0)
        return r;
    r = gsn_torn_replace(in->import->store, &row, time(NULL), in->import->actor, &mended, err);
    if (r >= 0 && !mended)
        r = gsn_panel_put(in->import->store, &row, &panel, &again, err);
    if (r >= 0 && again)
        r = rename_panel(in, panel, &row, err);
    if (r >= 0 && !again && !mended)
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
        if (mended)
            notice(in->import, item->name,
                   "what came under this name before was a torn beginning of it; both are kept");
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

static int take_item(struct gsn_import_work *in, struct gsn_source *source,
                     const struct gsn_source_event *item, struct gsn_error *err)
{
    struct gsn_spooled spooled;
    struct gsn_error why = { 0 };
    int r;

    if (is_calibration(in->protocol, item->name))
        return gsn_source_acknowledge(source, item->item, err);
    if (gsn_spool_check_size(item->size, item->name, &why) < 0) {
        r = gsn_import_leave_out(in, item->name, why.text, "take it out of the folder", err);
        return r < 0 ? r : gsn_source_acknowledge(source, item->item, err);
    }
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

int gsn_import_take_panels(struct gsn_import_work *in, struct gsn_error *err)
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
            else if (event->what == GSN_SOURCE_BARRED && ended)
                r = gsn_import_leave_out(in, event->name, event->reason, event->action, err);
        }
    }
    if (r >= 0 && !ended)
        return gsn_fail(err, GSN_E_BUSY, "%s keeps changing: import it when the copy is done",
                        in->import->dir);
    return r;
}
