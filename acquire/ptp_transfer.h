/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* One transfer of a bulk pipe into the exchange's buffer; for the files of acquire/ptp_exchange.h
 * alone. */
#ifndef GSN_ACQUIRE_PTP_TRANSFER_H
#define GSN_ACQUIRE_PTP_TRANSFER_H

#include "acquire/ptp_exchange.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_PTP_LARGEST_READ = 65536, GSN_PTP_LARGEST_PACKET = 1024 };

/* One transfer, put behind what is there. A halted pipe is cleared and read once more. */
int gsn_ptp_transfer_receive(struct gsn_ptp_exchange *exchange, size_t size, unsigned timeout_ms,
                             struct gsn_error *err);
/* Reads packets until that many bytes are there: a header may come in parts. */
int gsn_ptp_transfer_need(struct gsn_ptp_exchange *exchange, size_t size, unsigned timeout_ms,
                          struct gsn_error *err);
void gsn_ptp_transfer_forget(struct gsn_ptp_exchange *exchange);
/* Gives a sign of life, and r. */
int gsn_ptp_transfer_alive(const struct gsn_ptp_exchange *exchange, int r);
/* Fails with GSN_E_IO: what the device does. */
int gsn_ptp_transfer_broken(const char *what, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
