/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A child process that answers one question: bytes in on stdin, bytes out on stdout.
 *
 * Foreign code that aborts, hangs or leaks (the mesher, the decoders) runs in one, under limits of
 * memory and time, so that a crash costs one question and never the program that asked. A child
 * does not outlive the thread that asked, however that one ends. */
#ifndef GSN_CORE_PROCESS_H
#define GSN_CORE_PROCESS_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>
#include <sys/types.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_process_limits {
    uint64_t memory_bytes; /* address space; 0: no limit */
    unsigned cpu_s;        /* processor seconds; 0: no limit */
    unsigned wall_s;       /* seconds of the clock; 0: no limit */
    size_t answer_bytes;   /* most that is read from the child's stdout */
};

/* Runs argv[0] with argv (NULL-terminated) and no signal blocked, feeds question, gives the answer.
 *
 * Fails with GSN_E_PROCESS when the child cannot be started, dies, exits other than 0 or is killed
 * at a limit; the sentence then ends with the first line it wrote on stderr, if any. Fails with
 * GSN_E_LIMIT when the answer is too long. The child never outlives the call. Several threads may
 * ask at once. gives: ret_answer, with one zero byte behind it, not counted. */
int gsn_process_ask(const char *const argv[], const struct gsn_process_limits *limits,
                    const void *question, size_t question_size, uint8_t **ret_answer,
                    size_t *ret_answer_size, struct gsn_error *err);

/* How a child came to its end. */
struct gsn_process_end {
    int code;            /* its exit status; -1 when a signal ended it */
    int signal;          /* that signal, or 0 */
    int late;            /* it was killed when its time was over */
    char complaint[200]; /* the first line it wrote on stderr, or empty */
};

/* A child that answers many questions, by a way of its own: its stdin is the descriptor fd. */
struct gsn_process;

/* Starts argv[0] with argv (NULL-terminated) and no signal blocked. What it prints on stdout is
 * dropped; on stderr it may complain. It dies with the thread that started it.
 * Fails with GSN_E_PROCESS or GSN_E_NOMEM. gives: ret_process, for gsn_process_close(). */
int gsn_process_open(const char *const argv[], int fd, struct gsn_process **ret_process,
                     struct gsn_error *err);

/* From now on it may hold so much address space, but no more than we may ourselves. Fails with
 * GSN_E_PROCESS. */
int gsn_process_allow(const struct gsn_process *process, uint64_t memory_bytes,
                      struct gsn_error *err);

/* Waits until fd, our end of that way, has something to read or is closed, and listens to
 * complaints meanwhile. Returns 1, or 0 when wall_s seconds (0: no limit) have gone by. */
int gsn_process_await(struct gsn_process *process, int fd, unsigned wall_s);

/* Waits for its end, some seconds at most, then kills it; with at_once, or when it was late, kills
 * it now. Frees process. ret_end may be NULL. */
void gsn_process_close(struct gsn_process *process, int at_once, struct gsn_process_end *ret_end);

/* Starts argv[0] with our own stdin, stdout and stderr and with no signal blocked.
 * Fails with GSN_E_PROCESS. The caller waits for the child. */
int gsn_process_start(const char *const argv[], pid_t *ret_child, struct gsn_error *err);
/* Waits for its end: the exit status, or 128 + N when signal N killed it. With block 0 returns -1
 * at once while it runs. */
int gsn_process_wait(pid_t child, int block);

/* gives: the path of a program that stands beside the running one ("<dir of this exe>/name") or,
 * when there is none there, in libexec. Fails with GSN_E_NOTFOUND. */
int gsn_process_sibling(const char *name, char **ret_path, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
