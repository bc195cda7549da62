/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What all kinds of source share: the one function through which every call of a kind passes,
 * events, names.
 *
 * A source is made of a kind's operations and its own state; its calls are handed on. Each piece
 * that was read is reported to on_read, the sign of life of whoever watches
 * (systemd/service/heartbeat.h). An event is copied into the caller's list; names are put in
 * natural order, where digits count by their number. A call that a kind does not offer has an
 * answer that does no harm. */
#include "acquire/source.h"

#include <assert.h>
#include <errno.h>
#include <poll.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>
#include <strings.h>

/* Names. */

static bool is_digit(char c)
{
    return c >= '0' && c <= '9';
}

/* Compares the numbers both begin with, and moves behind them. */
static int compare_numbers(const char **a, const char **b)
{
    size_t la, lb;
    int order;

    *a += strspn(*a, "0");
    *b += strspn(*b, "0");
    la = strspn(*a, "0123456789");
    lb = strspn(*b, "0123456789");
    order = la != lb ? (la < lb ? -1 : 1) : memcmp(*a, *b, la);
    *a += la;
    *b += lb;
    return order;
}

int gsn_natural_compare(const char *a, const char *b)
{
    const char *x = a, *y = b;

    while (*x && *y) {
        int order = (unsigned char)*x - (unsigned char)*y;

        if (is_digit(*x) && is_digit(*y)) {
            order = compare_numbers(&x, &y);
        } else {
            x++;
            y++;
        }
        if (order != 0)
            return order;
    }
    if (*x || *y)
        return *x ? 1 : -1;
    return strcmp(a, b);
}

int gsn_name_is_picture(const char *name)
{
    static const char *const endings[] = { "jpg", "jpeg", "png", "tif", "tiff", "btf",  "tf8",
                                           "svs", "ndpi", "scn", "bmp", "gif",  "webp", "jp2",
                                           "pam", "pnm",  "ppm", "pgm", "heic" };
    const char *const dot = strrchr(name, '.');

    for (size_t i = 0; dot && i < sizeof endings / sizeof endings[0]; i++) {
        if (strcasecmp(dot + 1, endings[i]) == 0)
            return 1;
    }
    return 0;
}

struct gsn_source {
    const struct gsn_source_ops *ops;
    void *self;
    char *address;
    int (*on_read)(void *context, uint64_t item, uint64_t offset, int r);
    void *context;
};

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

int gsn_source_no_item(uint64_t item, struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOTFOUND, "item %llu is not ready", (unsigned long long)item);
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

int gsn_source_emit(struct gsn_source_events *events, const struct gsn_source_event *event,
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
