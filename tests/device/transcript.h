/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A device played from the record of one (acquire/ptp_transport.h): it answers each question as the
 * recorded device did, packet boundaries and all, under the transaction number of who asks now.
 *
 * A question that was asked several times gets its answers in turn, and then the last one again.
 * Pieces of an object need not be those of the record: whatever is asked for is made of the bytes
 * that the record has. Other questions are not supported (0x2005). Stalls and silence of the record
 * are not played. */
#ifndef GSN_TESTS_DEVICE_TRANSCRIPT_H
#define GSN_TESTS_DEVICE_TRANSCRIPT_H

#include "tests/device/usb_model.h"

struct transcript;

/* gives: the device; NULL when the text is no record. Keeps nothing of it. */
struct transcript *transcript_new(const char *text, size_t size);
void transcript_free(struct transcript *transcript);
const struct usb_model *transcript_usb(struct transcript *transcript);

/* Questions of the record; and those that were asked and had no answer in it. */
size_t transcript_questions(const struct transcript *transcript);
unsigned transcript_unanswered(const struct transcript *transcript);

#endif
