/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The verbs of gieson-work, a file each; gieson_work.c reads the command line and calls one. They
 * print, and return the program's exit status. */
#ifndef GSN_SYSTEMD_WORKER_WORK_VERBS_H
#define GSN_SYSTEMD_WORKER_WORK_VERBS_H

#include "systemd/worker/work_request.h"

int gsn_work_import(const struct gsn_work_request *request);
/* Claims one job; EX_NOINPUT when there is none, EX_TEMPFAIL while another is at it. */
int gsn_work_next(const struct gsn_work_request *request);
int gsn_work_verify(const struct gsn_work_request *request);
int gsn_work_changed(const struct gsn_work_request *request);
int gsn_work_scrub(const struct gsn_work_request *request);
/* Both: from the store into a folder, and from a folder into a store that is not there yet. */
int gsn_work_backup(const struct gsn_work_request *request);
int gsn_work_restore(const struct gsn_work_request *request);
int gsn_work_check(const struct gsn_work_request *request);
int gsn_work_register(const struct gsn_work_request *request);
int gsn_work_study(const struct gsn_work_request *request);
int gsn_work_plan(const struct gsn_work_request *request);
int gsn_work_export(const struct gsn_work_request *request);
int gsn_work_render(const struct gsn_work_request *request);
int gsn_work_probe(const struct gsn_work_request *request);
int gsn_work_line(const struct gsn_work_request *request);
int gsn_work_integral(const struct gsn_work_request *request);
int gsn_work_index(const struct gsn_work_request *request);

#endif
