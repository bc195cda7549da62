/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/serving.h"

#include <errno.h>
#include <stdbool.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/inotify.h>
#include <time.h>
#include <unistd.h>

#include "storage/bench.h"

enum {
    BREATH_MS = 10000, /* at rest; a third of the patience when that is shorter */
    HURRY_MS = 1000,   /* between two looks while something keeps changing in the store */
};

static int answer(struct gsn_serving *serving, const struct gsn_request_row *request,
                  struct gsn_error *err)
{
    static const struct {
        const char *kind;
        enum gsn_source_subject subject;
    } kinds[] = { { "capture-panel", GSN_SUBJECT_PANEL },
                  { "capture-blank", GSN_SUBJECT_BLANK },
                  { "capture-dark", GSN_SUBJECT_DARK } };
    const struct gsn_log_about what = gsn_serving_about(serving, NULL);
    struct gsn_error why = { 0 };
    size_t i = 0;
    int r;

    while (i + 1 < sizeof kinds / sizeof kinds[0] && strcmp(kinds[i].kind, request->kind) != 0)
        i++;
    r = gsn_source_capture(serving->source, kinds[i].subject, &why);
    gsn_log(r < 0 ? LOG_WARNING : LOG_INFO, &what, "%s, asked for by %s: %s", request->kind,
            request->actor, r < 0 ? why.text : "done");
    serving->next_look_ms = 0;
    return gsn_request_answer(serving->store, request->id, r < 0 ? why.text : NULL, time(NULL),
                              err);
}

int gsn_serving_answer(struct gsn_serving *serving, struct gsn_error *err)
{
    for (;;) {
        gsn_auto(gsn_request_row) request = NULL;
        int r = gsn_request_next(serving->store, serving->config->name, &request, err);

        if (r == GSN_E_NOTFOUND || gsn_lifeline_is_over(serving->line))
            return GSN_OK;
        if (r >= 0)
            r = answer(serving, request, err);
        if (r < 0)
            return r;
    }
}

int gsn_serving_open_wake(struct gsn_serving *serving, struct gsn_error *err)
{
    struct epoll_event event = { .events = EPOLLIN };
    const char *const dir = gsn_store_dir(serving->store);

    serving->wake = epoll_create1(EPOLL_CLOEXEC);
    if (serving->wake < 0 ||
        epoll_ctl(serving->wake, EPOLL_CTL_ADD, gsn_lifeline_fd(serving->line), &event) < 0)
        return gsn_fail(err, GSN_E_IO, "epoll: %s", strerror(errno));
    /* Only who can be asked for a picture must hear of it at once. */
    if (!serving->is_device)
        return GSN_OK;
    serving->changes = inotify_init1(IN_CLOEXEC | IN_NONBLOCK);
    if (serving->changes < 0 || inotify_add_watch(serving->changes, dir, IN_MODIFY) < 0 ||
        epoll_ctl(serving->wake, EPOLL_CTL_ADD, serving->changes, &event) < 0)
        return gsn_fail(err, GSN_E_IO, "%s cannot be watched: %s", dir, strerror(errno));
    return GSN_OK;
}

/* True when somebody wrote to the store since. */
static bool drain_changes(const struct gsn_serving *serving)
{
    _Alignas(struct inotify_event) char events[4096];
    bool any = false;

    while (serving->changes >= 0 && read(serving->changes, events, sizeof events) > 0)
        any = true;
    return any;
}

static int breath_ms(const struct gsn_serving *serving)
{
    const int64_t third = serving->config->patience_s * 1000 / 3;

    return (int)(third < BREATH_MS ? third : BREATH_MS);
}

int gsn_serving_wait(struct gsn_serving *serving, struct gsn_error *err)
{
    while (!gsn_lifeline_is_over(serving->line)) {
        const int64_t began = gsn_now_ms();
        const int64_t left = serving->next_look_ms - began;
        int64_t pause = breath_ms(serving);
        int r;

        gsn_lifeline_breathe(serving->line, GSN_READY);
        if (left <= 0)
            return GSN_OK;
        pause = left < pause ? left : pause;
        r = gsn_source_wait(serving->source, (int)pause, serving->wake, err);
        if (r < 0)
            return r;
        if (drain_changes(serving)) {
            r = gsn_serving_answer(serving, err);
            if (r < 0)
                return r;
            /* The same moment may have brought a hint of the source. */
            if (serving->next_look_ms > began + HURRY_MS)
                serving->next_look_ms = began + HURRY_MS;
        } else if (gsn_now_ms() - began + 5 < pause) {
            return GSN_OK;
        }
    }
    return GSN_OK;
}
