/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One PTP source: the device is followed (ptp_follow.c), and what it holds is told and given
 * (ptp_source.c). For the files of acquire/ptp_source.h alone. */
#ifndef GSN_ACQUIRE_PTP_SOURCE_PARTS_H
#define GSN_ACQUIRE_PTP_SOURCE_PARTS_H

#include "acquire/ptp_source.h"
#include "acquire/ptp_table.h"

#include <stdbool.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_PTP_LOOK_GAP_MS = 250 }; /* a device is not listed more often */

struct gsn_ptp_source {
    struct gsn_ptp_door door;
    void *place;                   /* the door's context, where this source made it */
    struct gsn_ptp_device *device; /* NULL while it is away */
    struct gsn_ptp_table table;
    struct gsn_ptp_hints hints;
    unsigned sessions; /* of devices that went */
    int64_t now_ms;    /* of the last poll */
    int64_t next_look_ms, next_renewal_ms;
    bool looked, busy_told;
    char busy[200]; /* to be told once */
    char name[300];
};

/* Finds the device where it is away. Fails as the door and gsn_ptp_device_new() do. */
int gsn_ptp_source_connect(struct gsn_ptp_source *source, struct gsn_error *err);
/* The device went; its handles mean nothing to the next one. */
void gsn_ptp_source_disconnect(struct gsn_ptp_source *source);
/* What the device has to say, as far as it is time to ask; what is due there is deleted. One that
 * stays busy is no failure. Fails with GSN_E_NOTFOUND when it went, GSN_E_IO, GSN_E_NOMEM. */
int gsn_ptp_source_ask(struct gsn_ptp_source *source, int64_t now_ms, struct gsn_error *err);
/* Whether the device said that a look is worth while. */
bool gsn_ptp_source_is_hinted(const struct gsn_ptp_source *source);
/* Deletes what was taken and is still due, once each: it must be the object that was taken. */
void gsn_ptp_source_delete(struct gsn_ptp_source *source, struct gsn_ptp_object *object);

#ifdef __cplusplus
}
#endif
#endif
