/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/specimen_folders.h"

#include <dirent.h>
#include <stdbool.h>
#include <string.h>
#include <unistd.h>

enum { FIRST_DELAY_MS = 2000, LONGEST_DELAY_MS = 120000 };

struct specimen {
    char *path;
    const char *name; /* in path */
    struct gsn_source *source;
    struct gsn_source_events *events; /* of the last look */
    size_t waiting_count;
    char **waiting; /* names that were told as WAITING and not as anything else since */
    uint64_t ready_bytes;
    size_t ready;
    int64_t next_ms, delay_ms;
};

struct gsn_specimen_folders {
    char *root;
    struct gsn_source_options options;
    size_t count;
    struct specimen *at;
};

static int out_of_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the folders of specimens");
}

static void specimen_done(struct specimen *specimen)
{
    gsn_source_events_free(specimen->events);
    gsn_source_free(specimen->source);
    for (size_t i = 0; i < specimen->waiting_count; i++)
        gsn_free(specimen->waiting[i]);
    gsn_free(specimen->waiting);
    gsn_free(specimen->path);
}

void gsn_specimen_folders_free(struct gsn_specimen_folders *folders)
{
    for (size_t i = 0; folders && i < folders->count; i++)
        specimen_done(&folders->at[i]);
    if (folders) {
        gsn_free(folders->at);
        gsn_free(folders->root);
    }
    gsn_free(folders);
}

int gsn_specimen_folders_new(const char *root, int64_t settle_ms, int64_t patience_ms,
                             struct gsn_specimen_folders **ret_folders, struct gsn_error *err)
{
    gsn_auto(gsn_specimen_folders) folders = gsn_alloc_array(1, sizeof *folders);

    if (folders)
        folders->root = gsn_strdup(root);
    if (!folders || !folders->root)
        return out_of_memory(err);
    folders->options =
        (struct gsn_source_options){ .settle_ms = settle_ms, .patience_ms = patience_ms };
    *ret_folders = gsn_steal(&folders);
    return GSN_OK;
}

static bool is_known(const struct gsn_specimen_folders *folders, const char *name)
{
    for (size_t i = 0; i < folders->count; i++)
        if (strcmp(folders->at[i].name, name) == 0)
            return true;
    return false;
}

static int add(struct gsn_specimen_folders *folders, const char *name, struct gsn_error *err)
{
    gsn_auto_mem(char) path = gsn_format("%s/%s", folders->root, name);
    gsn_auto_mem(char) address = gsn_format("hot:%s/%s", folders->root, name);
    gsn_auto(gsn_source) source = NULL;
    struct specimen *more;
    int r;

    if (!path || !address)
        return out_of_memory(err);
    r = gsn_source_open(address, &folders->options, &source, err);
    if (r < 0)
        return r;
    more = gsn_realloc_array(folders->at, folders->count + 1, sizeof *more);
    if (!more)
        return out_of_memory(err);
    folders->at = more;
    more[folders->count] = (struct specimen){ .path = path,
                                              .name = path + strlen(folders->root) + 1,
                                              .source = gsn_steal(&source) };
    folders->count++;
    (void)gsn_steal(&path);
    return GSN_OK;
}

/* Folders with a job.json that are new. One that cannot be opened is looked at again next time. */
static int find_new(struct gsn_specimen_folders *folders, struct gsn_error *err)
{
    DIR *const dir = opendir(folders->root);
    const struct dirent *entry;
    int r = GSN_OK;

    while (dir && r != GSN_E_NOMEM && (entry = readdir(dir))) {
        gsn_auto_mem(char) job = NULL;

        if (entry->d_name[0] == '.' || entry->d_type == DT_REG || is_known(folders, entry->d_name))
            continue;
        job = gsn_format("%s/%s/job.json", folders->root, entry->d_name);
        if (!job)
            r = out_of_memory(err);
        else if (access(job, R_OK) == 0)
            r = add(folders, entry->d_name, err);
    }
    if (dir)
        (void)closedir(dir);
    return r == GSN_E_NOMEM ? r : GSN_OK;
}

static void forget_waiting(struct specimen *specimen, const char *name)
{
    size_t kept = 0;

    for (size_t i = 0; i < specimen->waiting_count; i++) {
        if (strcmp(specimen->waiting[i], name) == 0)
            gsn_free(specimen->waiting[i]);
        else
            specimen->waiting[kept++] = specimen->waiting[i];
    }
    specimen->waiting_count = kept;
}

static int note_waiting(struct specimen *specimen, const char *name, struct gsn_error *err)
{
    gsn_auto_mem(char) copy = gsn_strdup(name);
    char **more;

    forget_waiting(specimen, name);
    more = copy ? gsn_realloc_array(specimen->waiting, specimen->waiting_count + 1, sizeof *more)
                : NULL;
    if (!more)
        return out_of_memory(err);
    specimen->waiting = more;
    more[specimen->waiting_count++] = gsn_steal(&copy);
    return GSN_OK;
}

static int look(struct specimen *specimen, int64_t now_ms, struct gsn_error *err)
{
    struct gsn_source_events *events = NULL;
    int ended = 0;
    int r = gsn_source_poll(specimen->source, now_ms, &events, &ended, err);

    if (r < 0)
        return r;
    gsn_source_events_free(specimen->events);
    specimen->events = events;
    specimen->ready = 0;
    specimen->ready_bytes = 0;
    for (size_t i = 0; r >= 0 && i < events->count; i++) {
        const struct gsn_source_event *const event = &events->at[i];

        /* That job.json is no picture is never told. */
        if (event->what == GSN_SOURCE_WAITING && strcmp(event->name, "job.json") != 0)
            r = note_waiting(specimen, event->name, err);
        else
            forget_waiting(specimen, event->name);
        if (event->what == GSN_SOURCE_READY) {
            specimen->ready++;
            specimen->ready_bytes += event->size;
        }
    }
    return r;
}

static void drop(struct gsn_specimen_folders *folders, size_t index)
{
    specimen_done(&folders->at[index]);
    folders->count--;
    memmove(&folders->at[index], &folders->at[index + 1],
            (folders->count - index) * sizeof *folders->at);
}

int gsn_specimen_folders_next(struct gsn_specimen_folders *folders, int64_t now_ms, long after,
                              struct gsn_specimen_due *ret_due, struct gsn_error *err)
{
    int r = after < 0 ? find_new(folders, err) : GSN_OK;

    ret_due->path = NULL;
    for (size_t i = (size_t)(after + 1); r >= 0 && i < folders->count;) {
        struct specimen *const specimen = &folders->at[i];
        const int looked = look(specimen, now_ms, err);

        if (looked == GSN_E_NOMEM)
            return looked;
        if (looked < 0) {
            drop(folders, i);
            continue;
        }
        if (specimen->ready > 0 && specimen->waiting_count == 0 && now_ms >= specimen->next_ms) {
            *ret_due = (struct gsn_specimen_due){ .path = specimen->path,
                                                  .name = specimen->name,
                                                  .bytes = specimen->ready_bytes,
                                                  .index = i };
            return GSN_OK;
        }
        i++;
    }
    return r;
}

void gsn_specimen_folders_done(struct gsn_specimen_folders *folders, size_t index)
{
    struct specimen *const specimen = &folders->at[index];
    struct gsn_error quiet = { 0 };

    for (size_t i = 0; i < specimen->events->count; i++)
        if (specimen->events->at[i].what == GSN_SOURCE_READY)
            (void)gsn_source_acknowledge(specimen->source, specimen->events->at[i].item, &quiet);
    specimen->ready = 0;
    specimen->delay_ms = 0;
    specimen->next_ms = 0;
}

void gsn_specimen_folders_failed(struct gsn_specimen_folders *folders, size_t index, int64_t now_ms)
{
    struct specimen *const specimen = &folders->at[index];

    specimen->delay_ms = specimen->delay_ms ? 2 * specimen->delay_ms : FIRST_DELAY_MS;
    if (specimen->delay_ms > LONGEST_DELAY_MS)
        specimen->delay_ms = LONGEST_DELAY_MS;
    specimen->next_ms = now_ms + specimen->delay_ms;
}

int gsn_specimen_folders_is_busy(const struct gsn_specimen_folders *folders)
{
    for (size_t i = 0; i < folders->count; i++)
        if (folders->at[i].waiting_count > 0 || folders->at[i].ready > 0)
            return 1;
    return 0;
}
