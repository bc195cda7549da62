/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What every verb of `gieson` shares: where the store is, how to speak, how to start a helper.
 *
 * Data goes to stdout, words to stderr. A mistake gets one line. */
#ifndef GSN_UI_UI_H
#define GSN_UI_UI_H

#include "pipeline/core/error.h"
#include "storage/store.h"

#include <jansson.h>
#include <stdint.h>
#include <sys/types.h>
#include <sysexits.h>

struct gsn_ui {
    const char *store_dir; /* NULL when not given */
    int json;
    int out_tty, err_tty; /* stdout, stderr are terminals */
    int colour;           /* stdout is a terminal and NO_COLOR is not set */
    int width;            /* columns of stdout's terminal; INT_MAX when it is none */
};

/* One verb: argv[0] is the verb itself. Returns the exit status. */
typedef int gsn_verb(const struct gsn_ui *ui, int argc, char **argv);

gsn_verb gsn_cmd_status, gsn_cmd_top, gsn_cmd_show, gsn_cmd_import, gsn_cmd_run, gsn_cmd_retry,
    gsn_cmd_report, gsn_cmd_verify, gsn_cmd_check, gsn_cmd_demo, gsn_cmd_phantom, gsn_cmd_file,
    gsn_cmd_expect, gsn_cmd_capture, gsn_cmd_check_config, gsn_cmd_devices, gsn_cmd_night,
    gsn_cmd_scrub, gsn_cmd_register, gsn_cmd_decide, gsn_cmd_new, gsn_cmd_backup, gsn_cmd_restore,
    gsn_cmd_study, gsn_cmd_plan, gsn_cmd_index, gsn_cmd_model, gsn_cmd_trace;

/* Prints a line, or a text wrapped to the terminal and set in by indent, as advice
 * (storage/advice.h). */
void gsn_ui_say(const struct gsn_ui *ui, const char *format, ...)
    __attribute__((format(printf, 2, 3)));
void gsn_ui_wrap(const struct gsn_ui *ui, int indent, const char *text);

/* "    next: ACTION", and what may stand behind it. */
void gsn_ui_next(const struct gsn_ui *ui, const char *action, const char *behind);

/* "gieson: sentence" on stderr, as advice; returns the exit status for the code. */
int gsn_ui_complain(const struct gsn_ui *ui, const struct gsn_error *err, int code);
/* The same with a sentence and a status of sysexits.h; returns status. */
int gsn_ui_fail(const struct gsn_ui *ui, int status, const char *format, ...)
    __attribute__((format(printf, 3, 4)));
/* A mistake on the command line. */
#define gsn_ui_usage(ui, ...) gsn_ui_fail(ui, EX_USAGE, __VA_ARGS__)

/* Opens the store for reading; complains and returns NULL when there is none, with the exit status
 * in *ret_status. */
struct gsn_store *gsn_ui_store(const struct gsn_ui *ui, enum gsn_store_mode mode, int *ret_status);

/* Columns of the terminal behind a descriptor; 80 when it does not say. */
int gsn_ui_columns(int fd);

/* A whole number of decimal digits from least to most: 1, and the number; else 0. */
int gsn_ui_whole(const char *text, int64_t least, int64_t most, int64_t *ret_number);
void gsn_ui_pause_ms(long ms);

/* Prints and releases root; its texts for people as advice. */
void gsn_ui_print_json(const struct gsn_ui *ui, json_t *root);
/* gives: the number, or null for NaN. */
json_t *gsn_ui_number(double value);

/* Starts a program of ours that stands beside gieson or in libexec, with "--store DIR", "--json"
 * (when asked for) in front of args (NULL-terminated; args[0] is its first argument). with_store 0
 * leaves those out. Returns the child, or -1 after a complaint. */
pid_t gsn_ui_start(const struct gsn_ui *ui, const char *program, int with_store,
                   const char *const args[]);
/* Starts it and waits; the exit status. */
int gsn_ui_call(const struct gsn_ui *ui, const char *program, int with_store,
                const char *const args[]);

/* What gieson-work is asked for when it works the queue: "--threads N" of the verb's arguments, as
 * far as they are given, then "work". Complains about any other argument, by what the verb takes,
 * and returns a status. */
int gsn_ui_threads(const struct gsn_ui *ui, const char *takes, int argc, char **argv,
                   const char *ret_args[4]);
/* Starts one worker after the other until the queue is empty, or, when it is shared with others,
 * until they are at all that is left; the exit status. */
int gsn_ui_work_queue(const struct gsn_ui *ui, struct gsn_store *store, const char *const args[],
                      int shared);
/* How a specimen ended, in a line. */
struct gsn_snapshot_row;
void gsn_ui_print_end(const struct gsn_ui *ui, const struct gsn_snapshot_row *row);

#endif
