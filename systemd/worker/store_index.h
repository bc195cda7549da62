/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The front page of a store, and a copy of its pages for people who have no account here.
 *
 *     DIR/index.html                    every specimen and study (pipeline/study/index_page.h)
 *     DIR/reports/SPECIMEN/latest       a link to the folder of its last report
 *
 * All of it can be made again from the store at any time. */
#ifndef GSN_SYSTEMD_WORKER_STORE_INDEX_H
#define GSN_SYSTEMD_WORKER_STORE_INDEX_H

#include "storage/store.h"

/* Writes both. A report that is damaged costs its specimen's row only. Fails as the store does,
 * and with GSN_E_IO. */
int gsn_store_index_write(struct gsn_store *store, struct gsn_error *err);

/* reports/SPECIMEN/latest leads to the folder of this report; report_path is as in the run's row.
 * Fails with GSN_E_NOMEM or GSN_E_IO. */
int gsn_store_link_latest(struct gsn_store *store, const char *report_path, struct gsn_error *err);

/* Copies index.html, the pages of all studies and the reports they link to (report.html and
 * report.json) into a folder, by the same names, so that its links hold: a share or a web root. The
 * folder is there; nothing in it is removed. Files that are alike are left as they are.
 * Fails with GSN_E_IO or GSN_E_DENIED, naming the file. */
int gsn_store_publish(struct gsn_store *store, const char *folder, struct gsn_error *err);

#endif
