/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* How a function says that it failed, and why, in one sentence.
 *
 * A function that can fail returns GSN_OK or a negative enum gsn_code and takes a struct gsn_error
 * last. Who detects the failure writes the sentence with gsn_fail(); callers only add a place in
 * front with gsn_fail_at(). The error may be NULL where nobody wants the sentence. */
#ifndef GSN_CORE_ERROR_H
#define GSN_CORE_ERROR_H

#ifdef __cplusplus
extern "C" {
#endif

enum gsn_code {
    GSN_OK = 0,
    GSN_E_NOMEM = -1,       /* memory ran out */
    GSN_E_INPUT = -2,       /* the bytes or values given are wrong or damaged */
    GSN_E_UNSUPPORTED = -3, /* well formed, but of a kind we do not read */
    GSN_E_LIMIT = -4,       /* larger than a stated limit */
    GSN_E_IO = -5,          /* the file system or a device refused */
    GSN_E_NOTFOUND = -6,    /* the named thing does not exist */
    GSN_E_MARKERS = -7,     /* laser marks missing, coinciding or contradicting each other */
    GSN_E_STAIN = -8,       /* the colours do not allow a collagen density */
    GSN_E_MESH = -9,        /* no tetrahedral domain could be made */
    GSN_E_FIT = -10,        /* the least-squares problem has no usable solution */
    GSN_E_STORE = -11,      /* the database refused */
    GSN_E_BUSY = -12,       /* somebody else holds it; try again later */
    GSN_E_PROCESS = -13,    /* a child process died, timed out or could not be started */
    GSN_E_WITHHELD = -14,   /* a figure exists but its evidence is too thin to print it */
    GSN_E_DENIED = -15,     /* the file system forbids it to this user */
};

struct gsn_error {
    int code;
    char text[480];
};

/* Writes the sentence and returns code. Longer text is cut, never overrun. */
int gsn_fail(struct gsn_error *err, int code, const char *format, ...)
    __attribute__((format(printf, 3, 4)));

/* Puts "<place>: " before the sentence already in err; returns err's code. Who may have been given
 * no err returns the code it has instead: without one this can only say GSN_E_INPUT. */
int gsn_fail_at(struct gsn_error *err, const char *format, ...)
    __attribute__((format(printf, 2, 3)));

/* A code as the word used in rows and JSON: "nomem", "input", ... */
const char *gsn_code_name(int code);

/* The exit status a program ends with after this code: 0 for GSN_OK, otherwise that of sysexits.h
 * which says the same (65 bad data, 66 no such input, 69 a helper failed, 71 no memory, 74 input or
 * output, 75 busy: try again). */
int gsn_code_exit(int code);

#ifdef __cplusplus
}
#endif
#endif
