/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A made-up report that has everything in it: 5 panels of 12 slots, doubtful and missing sections,
 * drawings as pictures. For the tests, and for looking at the page (report_sample). */
#ifndef GSN_TESTS_REPORT_SAMPLE_H
#define GSN_TESTS_REPORT_SAMPLE_H

#include "pipeline/report/report.h"

struct sample;

/* gives; NULL when memory runs out. Pictures have this width; 0: there are none. */
struct sample *sample_new(enum gsn_report_kind kind, unsigned picture_width);
void sample_free(struct sample *sample);
/* borrows: may be changed by the test. */
struct gsn_report *sample_report(struct sample *sample);

/* gives: a PNG of 8-bit RGB samples, stored without compression. */
int sample_png(const uint8_t *rgb, unsigned width, unsigned height, struct gsn_report_png *ret_png,
               struct gsn_error *err);

#endif
