/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "acquire/source.h"

#include <assert.h>
#include <errno.h>
#include <poll.h>
#include <stdio.h>
#include <string.h>

#include "acquire/folder_source.h"
#include "acquire/libcamera_source.h"
#include "acquire/ptp_source.h"
#include "acquire/v4l2_source.h"

/* The kinds of source there are. */
static const struct gsn_source_ops *const kinds[] = {
    &gsn_hot_folder_ops,  &gsn_replay_folder_ops,    &gsn_ptp_source_ops,
    &gsn_v4l2_source_ops, &gsn_libcamera_source_ops,
};

struct gsn_source {
    const struct gsn_source_ops *ops;
    void *self;
    char *address;
    int (*on_read)(void *context, uint64_t item, uint64_t offset, int r);
    void *context;
};

static const struct gsn_source_ops *find_kind(const char *address)
{
    const char *const colon = strchr(address, ':');

    for (size_t i = 0; colon && i < sizeof kinds / sizeof kinds[0]; i++) {
        const size_t length = (size_t)(colon - address);

        if (strlen(kinds[i]->kind) == length && memcmp(kinds[i]->kind, address, length) == 0)
            return kinds[i];
    }
    return NULL;
}

static int check_keys(const struct gsn_source_ops *ops, const struct gsn_source_options *options,
                      struct gsn_error *err)
{
    for (size_t i = 0; i < options->setting_count; i++) {
        const char *const *known = ops->settings;

        while (known && *known && strcmp(*known, options->setting[i].key) != 0)
            known++;
        if (!known || !*known)
            return gsn_fail(err, GSN_E_INPUT, "a source of kind %s has no setting \"%.100s\"",
                            ops->kind, options->setting[i].key);
    }
    return GSN_OK;
}

/* "give hot:FOLDER, replay:FOLDER or ptp:DEVICE", from the table. */
static int name_kinds(const char *address, struct gsn_error *err)
{
    const size_t count = sizeof kinds / sizeof kinds[0];
    char list[200] = "";

    for (size_t i = 0; i < count; i++) {
        const char *const joint = i == 0 ? "" : i + 1 < count ? ", " : " or ";
        const size_t used = strlen(list);

        (void)snprintf(list + used, sizeof list - used, "%s%s:%s", joint, kinds[i]->kind,
                       kinds[i]->subsystem ? "DEVICE" : "FOLDER");
    }
    return gsn_fail(err, GSN_E_UNSUPPORTED, "\"%.200s\" names no source: give %s", address, list);
}

static int check(const char *address, const struct gsn_source_options *options,
                 const struct gsn_source_ops **ret_ops, struct gsn_error *err)
{
    const struct gsn_source_ops *const ops = find_kind(address);
    int r;

    if (!ops)
        return name_kinds(address, err);
    r = check_keys(ops, options, err);
    if (r >= 0 && ops->check)
        r = ops->check(strchr(address, ':') + 1, options, err);
    if (r >= 0)
        *ret_ops = ops;
    return r;
}

int gsn_source_check(const char *address, const struct gsn_source_options *options,
                     struct gsn_error *err)
{
    const struct gsn_source_ops *ops;

    return check(address, options, &ops, err);
}

int gsn_source_make(const struct gsn_source_ops *ops, void *self, const char *address,
                    const struct gsn_source_options *options, struct gsn_source **ret_source,
                    struct gsn_error *err)
{
    struct gsn_source *const source = gsn_alloc_array(1, sizeof *source);
    char *const copy = gsn_strdup(address);

    if (!source || !copy) {
        gsn_free(source);
        gsn_free(copy);
        ops->close(self);
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for a source");
    }
    *source = (struct gsn_source){ ops, self, copy, options->on_read, options->context };
    *ret_source = source;
    return GSN_OK;
}

int gsn_source_open(const char *address, const struct gsn_source_options *options,
                    struct gsn_source **ret_source, struct gsn_error *err)
{
    const struct gsn_source_ops *ops = NULL;
    void *self = NULL;
    int r = check(address, options, &ops, err);

    if (r >= 0)
        r = ops->open(strchr(address, ':') + 1, options, &self, err);
    return r < 0 ? r : gsn_source_make(ops, self, address, options, ret_source, err);
}

void gsn_source_free(struct gsn_source *source)
{
    if (!source)
        return;
    source->ops->close(source->self);
    gsn_free(source->address);
    gsn_free(source);
}

const char *gsn_source_address(const struct gsn_source *source)
{
    return source->address;
}

int gsn_source_poll(struct gsn_source *source, int64_t now_ms,
                    struct gsn_source_events **ret_events, int *ret_ended, struct gsn_error *err)
{
    gsn_auto(gsn_source_events) events = gsn_alloc_array(1, sizeof *events);
    int ended = 0, r;

    if (!events)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for events");
    r = source->ops->poll(source->self, now_ms, events, &ended, err);
    if (r < 0)
        return r;
    *ret_ended = ended;
    *ret_events = gsn_steal(&events);
    return GSN_OK;
}

int gsn_source_read(struct gsn_source *source, uint64_t item, uint64_t offset, void *buffer,
                    size_t size, size_t *ret_got, struct gsn_error *err)
{
    size_t got = 0;
    const int r = source->ops->read(source->self, item, offset, buffer, size, &got, err);

    if (source->on_read && source->on_read(source->context, item, offset + got, r) && r >= 0)
        return gsn_fail(err, GSN_E_BUSY, "the copy was broken off");
    if (r >= 0)
        *ret_got = got;
    return r;
}

int gsn_source_acknowledge(struct gsn_source *source, uint64_t item, struct gsn_error *err)
{
    return source->ops->acknowledge(source->self, item, err);
}

int gsn_source_keep(struct gsn_source *source, uint64_t item, struct gsn_error *err)
{
    return source->ops->keep ? source->ops->keep(source->self, item, err)
                             : gsn_source_acknowledge(source, item, err);
}

int gsn_source_wait(struct gsn_source *source, int timeout_ms, int stop_fd, struct gsn_error *err)
{
    struct pollfd stop = { .fd = stop_fd, .events = POLLIN };

    if (source->ops->wait)
        return source->ops->wait(source->self, timeout_ms, stop_fd, err);
    if (poll(&stop, 1, timeout_ms) < 0 && errno != EINTR)
        return gsn_fail(err, GSN_E_IO, "waiting: %s", strerror(errno));
    return GSN_OK;
}

int gsn_source_capture(struct gsn_source *source, enum gsn_source_subject subject,
                       struct gsn_error *err)
{
    if (!source->ops->capture)
        return gsn_fail(err, GSN_E_UNSUPPORTED, "%.300s: pictures come by themselves here",
                        source->address);
    return source->ops->capture(source->self, subject, err);
}

const char *gsn_source_device(const struct gsn_source *source)
{
    return source->ops->device ? source->ops->device(source->self) : "";
}

const char *gsn_source_subsystem(const char *address)
{
    const struct gsn_source_ops *const ops = find_kind(address);

    return ops ? ops->subsystem : NULL;
}

int gsn_source_tell(struct gsn_source_events *events, const struct gsn_source_event *event,
                    struct gsn_error *err)
{
    gsn_auto_mem(char) name = gsn_strdup(event->name);
    gsn_auto_mem(char) reason = gsn_strdup(event->reason);
    gsn_auto_mem(char) action = gsn_strdup(event->action ? event->action : "");
    gsn_auto_mem(char) key = gsn_strdup(event->key ? event->key : "");
    gsn_auto_mem(char) facts = gsn_strdup(event->facts ? event->facts : "");
    struct gsn_source_event *at;

    assert(event->name && event->reason);
    if (!name || !reason || !action || !key || !facts)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an event");
    at = gsn_realloc_array(events->at, events->count + 1, sizeof *at);
    if (!at)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for an event");
    events->at = at;
    at[events->count] = *event;
    at[events->count].name = gsn_steal(&name);
    at[events->count].reason = gsn_steal(&reason);
    at[events->count].action = gsn_steal(&action);
    at[events->count].key = gsn_steal(&key);
    at[events->count].facts = gsn_steal(&facts);
    events->count++;
    return GSN_OK;
}

void gsn_source_events_free(struct gsn_source_events *events)
{
    for (size_t i = 0; events && i < events->count; i++) {
        gsn_free((void *)events->at[i].name);
        gsn_free((void *)events->at[i].reason);
        gsn_free((void *)events->at[i].action);
        gsn_free((void *)events->at[i].key);
        gsn_free((void *)events->at[i].facts);
    }
    if (events)
        gsn_free(events->at);
    gsn_free(events);
}
