/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How a responder's answers cross the bus: a queue of data blocks and responses, cut into packets
 * and transfers, with the faults that happen there. What the answers say is not its matter. */
#ifndef GSN_TESTS_DEVICE_PTP_ANSWERS_H
#define GSN_TESTS_DEVICE_PTP_ANSWERS_H

#include "tests/device/ptp_model.h"

enum { PTP_PACKET = 512, PTP_CONFIG = 39 };

/* One configuration: interface 06/01/01 with bulk in 0x81, bulk out 0x02, interrupt in 0x83. */
extern const uint8_t ptp_config_descriptor[PTP_CONFIG];

struct ptp_answers;

/* Where a data block's bytes come from: memory (kept or owned), or made when asked for. */
struct ptp_payload {
    uint64_t size;
    const uint8_t *bytes;
    uint8_t *owned; /* free()d after use; may be NULL */
    void (*read)(void *context, uint64_t offset, uint8_t *buffer, size_t size);
    void *context;
    uint64_t offset; /* what read is asked for begins here */
};

struct ptp_answer {
    uint16_t operation;
    uint32_t transaction;
    const struct ptp_payload *payload; /* NULL: no data phase */
    uint16_t code;
    unsigned count; /* of the response's parameters */
    uint32_t parameter[5];
    unsigned nth; /* which transaction this is, for the faults */
};

/* faults: keeps; they may change at any time. */
struct ptp_answers *ptp_answers_new(const struct ptp_faults *faults);
void ptp_answers_free(struct ptp_answers *answers);

/* Takes the payload's owned bytes, also when the answer is never given. */
void ptp_answers_add(struct ptp_answers *answers, const struct ptp_answer *answer, int64_t now_ms);
/* Bytes as they are, responses and all: a part ends with a short packet at each of these offsets,
 * which rise; there is at least one. Takes bytes. */
void ptp_answers_add_raw(struct ptp_answers *answers, uint8_t *bytes, const size_t *ends,
                         size_t count);
/* What was held back until another question came may go now. */
void ptp_answers_release(struct ptp_answers *answers);
/* Forgets what was not given. */
void ptp_answers_clear(struct ptp_answers *answers);
/* And begins to count anew. */
void ptp_answers_restart(struct ptp_answers *answers);

/* One bulk-in transfer: bytes, or one of USB_MODEL_. */
long ptp_answers_give(struct ptp_answers *answers, uint8_t *buffer, size_t size, int64_t now_ms);
int ptp_answers_halted(const struct ptp_answers *answers);
void ptp_answers_clear_halt(struct ptp_answers *answers);
/* Bytes given since it was made. */
uint64_t ptp_answers_given(const struct ptp_answers *answers);

#endif
