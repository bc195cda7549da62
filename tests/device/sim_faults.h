/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The faults of the models by name: "stall_at=3", "no_events=1". */
#ifndef GSN_TESTS_DEVICE_SIM_FAULTS_H
#define GSN_TESTS_DEVICE_SIM_FAULTS_H

#include "tests/device/ptp_model.h"
#include "tests/device/uvc_model.h"

/* -1 when there is none of this name, or no number behind it. */
int sim_ptp_fault(const char *text, struct ptp_faults *faults);
int sim_uvc_fault(const char *text, struct uvc_faults *faults);

#endif
