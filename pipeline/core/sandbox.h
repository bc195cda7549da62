/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A process that gives up everything but thinking.
 *
 * Code that reads hostile bytes (the decoder) or that nobody vouches for (the mesher) runs in a
 * process of its own, and that process enters the sandbox before it reads. Behind the door it can
 * read and write the descriptors it has, ask for memory, compute and end. It cannot open, name or
 * even look at a file, talk to a network or another process, start a program, a process or a
 * thread, map code, or write a file longer. Whoever tries is killed on the spot by signal SIGSYS.
 *
 * Three walls, so that one may have a hole: no new privileges and limits of files, processes and
 * core dumps; Landlock, which takes the whole file system away; a seccomp list of the system calls
 * that are left. A kernel without Landlock is worked with (the list has no call that names a file),
 * a kernel without seccomp is not. */
#ifndef GSN_CORE_SANDBOX_H
#define GSN_CORE_SANDBOX_H

#include "pipeline/core/error.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Closes every descriptor above last_fd and enters. With may_receive it can still be handed
 * descriptors, one at a time, over a socket that is its stdin; what it may do with them is no more
 * than with those it has. There is no way back. Call it while the process
 * has one thread, and end with _exit(): the exit handlers of libraries were written for outside.
 * Fails with GSN_E_PROCESS where the kernel refuses; then nobody should go on. */
int gsn_sandbox_enter(int last_fd, int may_receive, struct gsn_error *err);

/* The second wall alone: from now on nothing can be opened, made, moved or removed, and from
 * version 4 on no TCP port be bound or connected to. Does nothing where the kernel has no Landlock.
 */
int gsn_sandbox_leave_files(struct gsn_error *err);

/* The version of Landlock that this kernel offers; 0: none, and somebody should be told. */
int gsn_sandbox_landlock(void);

#ifdef __cplusplus
}
#endif
#endif
