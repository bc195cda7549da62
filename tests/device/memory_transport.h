/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The pipes of a PTP device as calls of a model: no bus, no threads, and a clock that only moves
 * when somebody waits. */
#ifndef GSN_TESTS_DEVICE_MEMORY_TRANSPORT_H
#define GSN_TESTS_DEVICE_MEMORY_TRANSPORT_H

#include "acquire/ptp_transport.h"
#include "tests/device/usb_model.h"

#ifdef __cplusplus
extern "C" {
#endif

struct memory_bus {
    const struct usb_model *model; /* keeps */
    int64_t now_ms;
    int no_cancel;                                      /* the device refuses to cancel anything */
    unsigned transfers, halts_cleared, cancels, resets; /* so far, for tests */
};

/* gives: a transport, to be closed by its close(). keeps: the bus.
 * Fails with GSN_E_NOTFOUND when the model is unplugged. */
int memory_transport_open(struct memory_bus *bus, struct gsn_ptp_transport **ret_transport,
                          struct gsn_error *err);
/* For a struct gsn_ptp_opener; context is the bus. */
int memory_opener(void *bus, struct gsn_ptp_transport **ret_transport, struct gsn_error *err);

/* Lets time pass. */
void memory_bus_sleep(struct memory_bus *bus, int64_t ms);

#ifdef __cplusplus
}
#endif
#endif
