/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A scanner or camera that speaks PTP as a source: "ptp:SERIAL", "ptp:VVVV:PPPP",
 * "ptp:VVVV:PPPP:SERIAL" or "ptp:any".
 *
 * The listing is the truth. Each look lists all storages and walks all folders; events only say
 * that a look is worth while. An object is ready when two looks at least settle_ms apart found it
 * the same and not empty; when its last byte has been read it is looked at once more. What the
 * device refuses to give is set aside, with the reason, and tried again after 30 s, 1 min, ... 1 h.
 *
 * The interface is claimed and the session stays open while the source is: events and handles exist
 * in a session alone. Between transfers nothing is under way, so what a technician does at the
 * device is not disturbed. When the device goes, poll fails with GSN_E_NOTFOUND, reading with
 * GSN_E_IO (a copy can go on later); the next poll looks for the device again, and objects that
 * have a key keep their item. Keys are made only where the device states a serial number and a date
 * of capture that its clock may have known; two objects that would share one get none.
 *
 * Its one setting, Record=FILE (a whole path), writes down what crosses the bus, pictures and all,
 * for a bug report or a test: acquire/ptp_transport.h. */
#ifndef GSN_ACQUIRE_PTP_SOURCE_H
#define GSN_ACQUIRE_PTP_SOURCE_H

#include "acquire/ptp_transport.h"
#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const struct gsn_source_ops gsn_ptp_source_ops;

/* Where the device is found, each time it has to be. open gives a transport, or fails as
 * gsn_source_open() does. */
struct gsn_ptp_opener {
    int (*open)(void *context, struct gsn_ptp_transport **ret_transport, struct gsn_error *err);
    void *context; /* keeps */
};

/* gives: what gsn_ptp_source_ops.close() releases. */
int gsn_ptp_source_new(const struct gsn_ptp_opener *opener,
                       const struct gsn_source_options *options, void **ret_self,
                       struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
