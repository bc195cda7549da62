/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What gieson-work is asked for on its command line, and how its verbs answer. */
#ifndef GSN_SYSTEMD_WORKER_WORK_REQUEST_H
#define GSN_SYSTEMD_WORKER_WORK_REQUEST_H

#include "pipeline/core/error.h"

#include <jansson.h>
#include <stdio.h>

/* The command line; what was not said is 0 or NULL. */
struct gsn_work_request {
    const char *store_dir, *verb;
    char **rest;
    int rest_count, json, csv, quiet, replace, served, by_tissue, quick, whole, translucent,
        true_colour, perspective, preview;
    unsigned threads, minutes;
    const char *volume, *tile, *reference, *specimen, *spacing_unit, *marks, *px_um, *radius,
        *journal, *because, *difference, *sd, *power, *step, *box, *plane, *points, *publish,
        *surface, *cells, *view, *size, *window;
    json_t *thresholds, *levels;
};

/* To a terminal or a file, without what moves a cursor. */
void gsn_work_print(FILE *to, const char *format, ...) __attribute__((format(printf, 2, 3)));
/* A line: what stands before the text, and the text as advice (storage/advice.h). */
void gsn_work_print_advice(const struct gsn_work_request *request, FILE *to, const char *before,
                           const char *text);
/* Says what failed; returns its exit status. */
int gsn_work_complain(const struct gsn_work_request *request, const struct gsn_error *err,
                      int code);
/* Says what was asked wrongly; returns EX_USAGE. */
int gsn_work_usage(const struct gsn_work_request *request, const char *sentence);
/* gives: a text that may hold any bytes; the second as advice. */
json_t *gsn_work_text(const char *text);
json_t *gsn_work_advice(const struct gsn_work_request *request, const char *text);
/* A decimal number of the command line, through the parser that reads every other number. gives;
 * NULL when it is none. */
json_t *gsn_work_number(const char *text);
/* So many finite numbers with commas between them and nothing else: 1, and the numbers; else 0. */
int gsn_work_numbers(const char *text, size_t count, double *ret_number);

#endif
