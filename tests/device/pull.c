/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/device/pull.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { PIECE = 100000, MOST_LOOKS = 20 };

static int take(struct pull *pull, struct gsn_source *source, const struct gsn_source_event *event,
                struct gsn_error *err)
{
    struct pulled *const to = &pull->at[pull->count];
    size_t got = 1;

    if (pull->count == PULL_MOST)
        return gsn_fail(err, GSN_E_LIMIT, "more items than expected");
    to->size = 0;
    to->bytes = malloc((size_t)event->size + PIECE);
    (void)snprintf(to->name, sizeof to->name, "%s", event->name);
    while (got > 0 && to->size <= event->size) {
        const int r =
            gsn_source_read(source, event->item, to->size, to->bytes + to->size, PIECE, &got, err);

        if (r < 0) {
            free(to->bytes);
            return r;
        }
        to->size += got;
    }
    pull->count++;
    return gsn_source_acknowledge(source, event->item, err);
}

int pull_look(struct pull *pull, struct gsn_source *source, struct gsn_error *err)
{
    gsn_auto(gsn_source_events) events = NULL;
    int ended, r;

    pull->now_ms += 1000;
    r = gsn_source_poll(source, pull->now_ms, &events, &ended, err);
    for (size_t i = 0; r >= 0 && i < events->count; i++)
        if (events->at[i].what == GSN_SOURCE_READY)
            r = take(pull, source, &events->at[i], err);
    return r;
}

int pull_until(struct pull *pull, struct gsn_source *source, size_t count, struct gsn_error *err)
{
    for (int look = 0; look < MOST_LOOKS && pull->count < count; look++) {
        const int r = pull_look(pull, source, err);

        if (r < 0)
            return r;
    }
    return pull->count >= count
               ? GSN_OK
               : gsn_fail(err, GSN_E_NOTFOUND, "%zu items came, not %zu", pull->count, count);
}

const struct pulled *pull_find(const struct pull *pull, const char *name)
{
    for (size_t i = 0; i < pull->count; i++)
        if (strcmp(pull->at[i].name, name) == 0)
            return &pull->at[i];
    return NULL;
}

void pull_free(struct pull *pull)
{
    for (size_t i = 0; i < pull->count; i++)
        free(pull->at[i].bytes);
    pull->count = 0;
}
