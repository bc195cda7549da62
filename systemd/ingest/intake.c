/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One picture from its source into the store, and the pictures that failed and are tried again.
 *
 * Steps for a picture that is ready.
 * 1. Room: below the reserve of disk nothing is taken.
 * 2. Its bytes go through the spool (acquire/spool.h): hashed, synced, named by their hash.
 * 3. The half picture of a device is asked for again until it stays the same for the source's
 *    patience; then it is taken as it is, with its container's reason.
 * 4. Its row is put into the staging table (storage/scan.h), durable; only then is the source told,
 * and it may delete its copy where the configuration says so, after the object was read back. A
 * picture that failed has a row of trouble and a time before which it is not tried again: 1 s,
 * doubled to 10 minutes; another sentence begins anew.
 *
 * How it fails: the fault says whose it was (this picture, its size, the disk, the store), which
 * decides whether others go on. */
#include "systemd/ingest/intake.h"

#include <errno.h>
#include <stdio.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#include "acquire/container.h"
#include "pipeline/core/file.h"
#include "storage/bench.h"
#include "storage/panel_log.h"

enum { FIRST_DELAY_MS = 1000, LONGEST_DELAY_MS = 600000 };

void gsn_failing_done(struct gsn_failing *list)
{
    for (size_t i = 0; i < list->count; i++) {
        gsn_free(list->at[i].name);
        gsn_free(list->at[i].reason);
    }
    gsn_free(list->at);
}

/* Pictures that failed. */

static struct gsn_failing_entry *find_entry(const struct gsn_failing *list, const char *name)
{
    for (size_t i = 0; i < list->count; i++)
        if (strcmp(list->at[i].name, name) == 0)
            return &list->at[i];
    return NULL;
}

static int append_entry(struct gsn_failing *list, const char *name,
                        struct gsn_failing_entry **ret_entry, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(name);
    struct gsn_failing_entry *at =
        copy ? gsn_realloc_array(list->at, list->count + 1, sizeof *at) : NULL;

    if (!at)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the list of troubles");
    list->at = at;
    at[list->count] = (struct gsn_failing_entry){ .name = gsn_steal(&copy) };
    *ret_entry = &at[list->count++];
    return GSN_OK;
}

static int note_reason(struct gsn_failing_entry *entry, const char *reason, struct gsn_error *err)
{
    char *const copy = gsn_strdup(reason);

    if (!copy)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the list of troubles");
    gsn_free(entry->reason);
    entry->reason = copy;
    return GSN_OK;
}

int gsn_failing_load(struct gsn_failing *list, struct gsn_error *err)
{
    gsn_auto(gsn_trouble_rows) rows = NULL;
    struct gsn_failing_entry *entry = NULL;
    int r = gsn_trouble_list(list->store, &rows, err);

    for (size_t i = 0; r >= 0 && i < rows->count; i++)
        if (strcmp(rows->at[i].source, list->source) == 0) {
            r = append_entry(list, rows->at[i].name, &entry, err);
            if (r >= 0)
                r = note_reason(entry, rows->at[i].reason, err);
        }
    return r;
}

int gsn_failing_is_early(const struct gsn_failing *list, const char *name, int64_t now_ms)
{
    const struct gsn_failing_entry *const entry = find_entry(list, name);

    return entry && now_ms < entry->next_ms;
}

int gsn_failing_is_early_for(const struct gsn_failing *list, const char *name, const char *reason,
                             int64_t now_ms)
{
    const struct gsn_failing_entry *const entry = find_entry(list, name);

    return entry && now_ms < entry->next_ms && entry->reason && strcmp(entry->reason, reason) == 0;
}

int gsn_failing_add(struct gsn_failing *list, const char *name, const char *reason,
                    const char *action, int64_t now_ms, int *ret_new, struct gsn_error *err)
{
    const struct gsn_trouble_row row = {
        .source = list->source, .name = name, .reason = reason, .action = action
    };
    struct gsn_failing_entry *entry = find_entry(list, name);
    int r = GSN_OK;

    *ret_new = !entry || !entry->reason || strcmp(entry->reason, reason) != 0;
    if (!entry)
        r = append_entry(list, name, &entry, err);
    if (r >= 0 && *ret_new)
        r = note_reason(entry, reason, err);
    if (r < 0)
        return r;
    entry->delay_ms = entry->delay_ms ? 2 * entry->delay_ms : FIRST_DELAY_MS;
    if (entry->delay_ms > LONGEST_DELAY_MS)
        entry->delay_ms = LONGEST_DELAY_MS;
    entry->next_ms = now_ms + entry->delay_ms;
    return gsn_trouble_put(list->store, &row, time(NULL), err);
}

int gsn_failing_over(struct gsn_failing *list, const char *name, struct gsn_error *err)
{
    struct gsn_failing_entry *const entry = find_entry(list, name);

    if (!entry)
        return GSN_OK;
    gsn_free(entry->name);
    gsn_free(entry->reason);
    *entry = list->at[--list->count];
    return gsn_trouble_clear(list->store, list->source, name, "gieson-intake", time(NULL), err);
}

int gsn_failing_forget_gone(struct gsn_failing *list, const char *folder, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = list->count; r >= 0 && i-- > 0;) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", folder, list->at[i].name);
        gsn_auto_mem(char) name = gsn_strdup(list->at[i].name);
        struct stat st;

        if (!path || !name)
            return gsn_fail(err, GSN_E_NOMEM, "out of memory for the list of troubles");
        if (lstat(path, &st) < 0 && (errno == ENOENT || errno == ENOTDIR))
            r = gsn_failing_over(list, name, err);
    }
    return r;
}

/* Taking a picture. */

int gsn_intake_is_known(void *context, const char *key)
{
    const struct gsn_intake *const intake = context;
    struct gsn_error quiet = { 0 };
    int known = 0;

    /* A store that cannot answer now gets the picture again, and recognises it. */
    if (gsn_scan_is_known(intake->store, key, &known, &quiet) < 0)
        return 0;
    return known;
}

int gsn_intake_on_read(void *context, uint64_t item, uint64_t offset, int r)
{
    struct gsn_intake *const intake = context;

    if (item != 0) {
        intake->read_code = r;
        intake->read_nothing = r >= 0 && offset == intake->read_to;
        intake->read_to = offset;
    }
    return intake->on_copy ? intake->on_copy(intake->context, intake->read_to) : 0;
}

static const char *name_of_subject(enum gsn_source_subject subject)
{
    static const char *const names[] = { "panel", "blank", "dark" };

    return names[subject];
}

int gsn_intake_recall(struct gsn_store *store, const char *name, struct gsn_intake_past *past,
                      struct gsn_source_options *options, struct gsn_error *err)
{
    *past = (struct gsn_intake_past){ { NULL } };
    for (int i = 0; i < GSN_SUBJECTS; i++) {
        const char *const subject = name_of_subject((enum gsn_source_subject)i);
        const int r = gsn_scan_newest(store, name, subject, &past->scan[i], err);

        if (r < 0 && r != GSN_E_NOTFOUND)
            return r;
        options->last_facts[i] = past->scan[i] ? past->scan[i]->facts : NULL;
    }
    return GSN_OK;
}

void gsn_intake_past_done(struct gsn_intake_past *past)
{
    for (int i = 0; i < GSN_SUBJECTS; i++)
        gsn_scan_row_free(past->scan[i]);
}

/* A folder's names are given by people; a device's count its pictures. */
static unsigned number_in_name(const struct gsn_source *source, const char *name)
{
    return gsn_source_subsystem(gsn_source_address(source)) ? gsn_panel_number_called(name, 0)
                                                            : gsn_panel_number(name, 0);
}

/* Walks what is in the store now as a container. */
static int look_into(const struct gsn_intake *intake, const struct gsn_spooled *spooled,
                     struct gsn_container *ret_container, struct gsn_error *err)
{
    gsn_auto_mem(char) path = NULL;
    int fd = -1;
    int r = gsn_store_object_path(intake->store, spooled->digest.hex, &path, err);

    if (r >= 0)
        r = gsn_file_open(path, &fd, err);
    if (r < 0)
        return r;
    r = gsn_container_check_fd(fd, ret_container, err);
    (void)close(fd);
    return r;
}

/* Half a picture keeps no key: a scanner that told the whole size from the start has the whole one
 * under the same key later, and the next process must not take that for known. */
static const char *key_of(const struct gsn_source_event *ready,
                          const struct gsn_container *container)
{
    return container->complete || container->kind == GSN_CONTAINER_UNKNOWN ? ready->key : "";
}

static int log_scan(const struct gsn_intake *intake, const struct gsn_source_event *ready,
                    const struct gsn_container *container, int64_t now,
                    struct gsn_intake_taken *taken, struct gsn_error *err)
{
    const struct gsn_scan_row row = { .source = intake->name,
                                      .device = gsn_source_device(intake->source),
                                      .name = ready->name,
                                      .key = key_of(ready, container),
                                      .subject = name_of_subject(ready->subject),
                                      .sha256 = taken->spooled.digest.hex,
                                      .size = (int64_t)taken->spooled.size,
                                      .facts = ready->facts };

    return gsn_scan_stage(intake->store, &row, number_in_name(intake->source, ready->name), now,
                          &taken->scan, &taken->again, err);
}

/* The source failed, or has more or fewer bytes than it announced; what the spool's own disk
 * refuses is not the picture's failure. */
static int is_source_to_blame(const struct gsn_intake *intake, uint64_t size)
{
    return intake->read_code < 0 || intake->read_to > size ||
           (intake->read_nothing && intake->read_to < size);
}

static enum gsn_intake_fault fault_of_copy(const struct gsn_intake *intake, uint64_t size, int r)
{
    switch (r) {
    case GSN_E_LIMIT:
        return GSN_FAULT_ROOM;
    case GSN_E_BUSY:
    case GSN_E_NOTFOUND:
        return GSN_FAULT_LATER;
    case GSN_E_INPUT:
    case GSN_E_UNSUPPORTED:
        return GSN_FAULT_ITEM;
    default:
        return is_source_to_blame(intake, size) ? GSN_FAULT_ITEM : GSN_FAULT_STORE;
    }
}

static int copy_item(struct gsn_intake *intake, const struct gsn_source_event *ready,
                     struct gsn_spooled *spooled, enum gsn_intake_fault *ret_fault,
                     struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };
    int r = gsn_spool_check_size(ready->size, ready->name, err);

    if (r < 0) {
        *ret_fault = GSN_FAULT_SIZE;
        return r;
    }
    r = gsn_spool_has_space(intake->spool, ready->size, err);
    if (r < 0) {
        /* Where a small file would go in, this one is too large and the disk is not full. */
        *ret_fault = r != GSN_E_LIMIT                                          ? GSN_FAULT_STORE
                     : gsn_spool_has_space(intake->spool, 0, &quiet) == GSN_OK ? GSN_FAULT_SIZE
                                                                               : GSN_FAULT_ROOM;
        return r;
    }
    intake->read_code = GSN_OK;
    intake->read_nothing = 0;
    intake->read_to = 0;
    r = gsn_spool_take_item(intake->spool, intake->source, ready, spooled, err);
    if (r < 0)
        *ret_fault = fault_of_copy(intake, ready->size, r);
    return r;
}

/* A picture that was not whole when it was read, since when. */
struct gsn_intake_half {
    struct gsn_intake_half *next;
    char *name;
    struct gsn_digest digest;
    int64_t since;
};

static void forget_half(struct gsn_intake *intake, const char *name)
{
    for (struct gsn_intake_half **at = &intake->half; *at; at = &(*at)->next) {
        struct gsn_intake_half *const half = *at;

        if (strcmp(half->name, name) != 0)
            continue;
        *at = half->next;
        gsn_free(half->name);
        gsn_free(half);
        return;
    }
}

void gsn_intake_done(struct gsn_intake *intake)
{
    while (intake->half)
        forget_half(intake, intake->half->name);
}

static int note_half(struct gsn_intake *intake, const char *name, const struct gsn_digest *digest,
                     int64_t now, struct gsn_error *err)
{
    struct gsn_intake_half *const half = gsn_alloc_array(1, sizeof *half);

    if (half)
        half->name = gsn_strdup(name);
    if (!half || !half->name) {
        gsn_free(half);
        return gsn_fail(err, GSN_E_NOMEM, "%.200s: out of memory", name);
    }
    half->digest = *digest;
    half->since = now;
    half->next = intake->half;
    intake->half = half;
    return GSN_OK;
}

/* Some responders measure an object before it is written to its end, and some scanners rest in the
 * middle of one: half a picture is read again until it is whole, or has stayed the same for the
 * patience. Fails with GSN_E_BUSY while it is to be waited for. */
static int wait_for_whole(struct gsn_intake *intake, const struct gsn_source_event *ready,
                          const struct gsn_spooled *spooled, const struct gsn_container *container,
                          int64_t now, struct gsn_error *err)
{
    struct gsn_intake_half *half = intake->half;
    int r = GSN_OK;

    if (intake->patience_s == 0 || ready->incomplete || container->complete ||
        container->kind == GSN_CONTAINER_UNKNOWN ||
        !gsn_source_subsystem(gsn_source_address(intake->source))) {
        forget_half(intake, ready->name);
        return GSN_OK;
    }
    while (half && strcmp(half->name, ready->name) != 0)
        half = half->next;
    if (half && strcmp(half->digest.hex, spooled->digest.hex) == 0) {
        /* A clock that was set back must not make it wait for as long as that. */
        half->since = now < half->since ? now : half->since;
        if (now - half->since >= intake->patience_s) {
            forget_half(intake, ready->name);
            return GSN_OK;
        }
    } else {
        forget_half(intake, ready->name);
        r = note_half(intake, ready->name, &spooled->digest, now, err);
    }
    return r < 0 ? r
                 : gsn_fail(err, GSN_E_BUSY, "%.200s is not whole yet: %s; it is read again",
                            ready->name, container->reason);
}

static int refuse_empty(const struct gsn_intake *intake, const struct gsn_source_event *ready,
                        enum gsn_intake_fault *ret_fault, struct gsn_error *err)
{
    struct gsn_error quiet = { 0 };

    *ret_fault = GSN_FAULT_ITEM;
    if (!intake->delete_there)
        (void)gsn_source_acknowledge(intake->source, ready->item, &quiet);
    return gsn_fail(err, GSN_E_INPUT, "%.200s is empty", ready->name);
}

int gsn_intake_take(struct gsn_intake *intake, const struct gsn_source_event *ready, int64_t now,
                    struct gsn_intake_taken *ret_taken, enum gsn_intake_fault *ret_fault,
                    struct gsn_error *err)
{
    struct gsn_intake_taken taken = { 0 };
    struct gsn_container container;
    int r;

    *ret_fault = GSN_FAULT_NONE;
    if (ready->size == 0)
        return refuse_empty(intake, ready, ret_fault, err);
    r = copy_item(intake, ready, &taken.spooled, ret_fault, err);
    if (r < 0)
        return r;
    r = look_into(intake, &taken.spooled, &container, err);
    if (r >= 0)
        r = wait_for_whole(intake, ready, &taken.spooled, &container, now, err);
    if (r == GSN_E_BUSY) {
        *ret_fault = GSN_FAULT_ITEM;
        return r;
    }
    if (r >= 0)
        r = log_scan(intake, ready, &container, now, &taken, err);
    if (r >= 0 && intake->delete_there)
        r = gsn_spool_verify(intake->spool, &taken.spooled.digest, err);
    /* A scanner that rests in the middle of a file, for longer than it takes to settle, would lose
     * what it has yet to write: the original goes only where a whole picture is here. */
    if (r >= 0 && intake->delete_there && !container.complete)
        (void)snprintf(taken.kept, sizeof taken.kept,
                       "was taken in as it is, but not deleted there: %s", container.reason);
    if (r < 0) {
        *ret_fault = GSN_FAULT_STORE;
        return r;
    }
    r = taken.kept[0] ? gsn_source_keep(intake->source, ready->item, err)
                      : gsn_source_acknowledge(intake->source, ready->item, err);
    if (r < 0) {
        *ret_fault = GSN_FAULT_LATER;
        return r;
    }
    *ret_taken = taken;
    return GSN_OK;
}
