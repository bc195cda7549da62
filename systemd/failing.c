/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/failing.h"

#include <errno.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>

#include "storage/bench.h"

enum { FIRST_DELAY_MS = 1000, LONGEST_DELAY_MS = 600000 };

void gsn_failing_done(struct gsn_failing *list)
{
    for (size_t i = 0; i < list->count; i++) {
        gsn_free(list->at[i].name);
        gsn_free(list->at[i].reason);
    }
    gsn_free(list->at);
}

static struct gsn_failing_entry *find(const struct gsn_failing *list, const char *name)
{
    for (size_t i = 0; i < list->count; i++)
        if (strcmp(list->at[i].name, name) == 0)
            return &list->at[i];
    return NULL;
}

static int append(struct gsn_failing *list, const char *name, struct gsn_failing_entry **ret_entry,
                  struct gsn_error *err)
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
            r = append(list, rows->at[i].name, &entry, err);
            if (r >= 0)
                r = note_reason(entry, rows->at[i].reason, err);
        }
    return r;
}

int gsn_failing_rests(const struct gsn_failing *list, const char *name, int64_t now_ms)
{
    const struct gsn_failing_entry *const entry = find(list, name);

    return entry && now_ms < entry->next_ms;
}

int gsn_failing_rests_for(const struct gsn_failing *list, const char *name, const char *reason,
                          int64_t now_ms)
{
    const struct gsn_failing_entry *const entry = find(list, name);

    return entry && now_ms < entry->next_ms && entry->reason && strcmp(entry->reason, reason) == 0;
}

int gsn_failing_add(struct gsn_failing *list, const char *name, const char *reason,
                    const char *action, int64_t now_ms, int *ret_new, struct gsn_error *err)
{
    const struct gsn_trouble_row row = {
        .source = list->source, .name = name, .reason = reason, .action = action
    };
    struct gsn_failing_entry *entry = find(list, name);
    int r = GSN_OK;

    *ret_new = !entry || !entry->reason || strcmp(entry->reason, reason) != 0;
    if (!entry)
        r = append(list, name, &entry, err);
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
    struct gsn_failing_entry *const entry = find(list, name);

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
