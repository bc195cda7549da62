/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A text that grows, and the few ways in which a report writes into it.
 *
 * Running out of memory is remembered, not returned: write everything, then look at `failed` once.
 * After a failure nothing more is added. */
#ifndef GSN_REPORT_TEXT_H
#define GSN_REPORT_TEXT_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_report_text {
    char *bytes; /* with a zero byte behind the last, once something was added */
    size_t size, room;
    int failed;
};

/* Releases the bytes; the text is empty again. */
void gsn_report_text_done(struct gsn_report_text *text);
#define gsn_auto_report_text __attribute__((cleanup(gsn_report_text_done))) struct gsn_report_text

/* gives: the bytes; the text is empty again. The caller has looked at `failed`. */
void gsn_report_text_give(struct gsn_report_text *text, char **ret_bytes, size_t *ret_size);

void gsn_report_text_bytes(struct gsn_report_text *text, const void *bytes, size_t size);
/* Trusted text as it stands: our own markup. */
void gsn_report_text_raw(struct gsn_report_text *text, const char *markup);
void gsn_report_text_print(struct gsn_report_text *text, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
/* Somebody else's text for HTML, in an element or a quoted attribute: & < > " ' are escaped;
 * what is not UTF-8, control characters and the marks that turn the direction of writing become
 * U+FFFD. NULL is empty. */
void gsn_report_text_escape(struct gsn_report_text *text, const char *said);
/* The same with only the first `most` characters and an ellipsis behind them. */
void gsn_report_text_escape_short(struct gsn_report_text *text, const char *said, size_t most);
/* Somebody else's text as UTF-8: wrong bytes become U+FFFD, everything else stays. */
void gsn_report_text_utf8(struct gsn_report_text *text, const char *said);
/* Somebody else's text as a field of a CSV (RFC 4180): in quotes, as UTF-8; one that a spreadsheet
 * would take for a formula gets an apostrophe in front. */
void gsn_report_text_field(struct gsn_report_text *text, const char *said);
/* RFC 4648, section 4. */
void gsn_report_text_base64(struct gsn_report_text *text, const void *bytes, size_t size);

/* A number for people: with so many decimals, a true minus sign, a narrow space between groups of
 * three digits; a dash when it is not finite. */
void gsn_report_text_number(struct gsn_report_text *text, double value, int decimals);
/* With so many significant digits (1..12); with a power of ten from 1e9 on and below 1e-3. */
void gsn_report_text_digits(struct gsn_report_text *text, double value, int digits);
/* As short as nine significant digits allow, for settings: 0.05, 120, 1 x 10^-6. */
void gsn_report_text_plain(struct gsn_report_text *text, double value);
void gsn_report_text_count(struct gsn_report_text *text, size_t count);

/* The next character of a zero-terminated text and how many bytes it takes; U+FFFD and 1 for a byte
 * that begins no character. 0 at the end. */
uint32_t gsn_utf8_next(const char *said, size_t *ret_length);

#ifdef __cplusplus
}
#endif
#endif
