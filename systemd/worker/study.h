/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A study of the store: its specimens' latest reports become one page (pipeline/study).
 *
 * Who is excluded, whether names are hidden and when the analysis was frozen are events of the
 * audit log, which nobody can take back unseen; they are read from there each time. */
#ifndef GSN_SYSTEMD_WORKER_STUDY_H
#define GSN_SYSTEMD_WORKER_STUDY_H

#include "pipeline/study/study.h"
#include "storage/store.h"

/* What is said of a study or a specimen, each an event of this kind. */
#define GSN_STUDY_EXCLUDE "exclude" /* subject: a specimen; text: why */
#define GSN_STUDY_INCLUDE "include" /* subject: a specimen: takes the exclusion back */
#define GSN_STUDY_BLIND "blind"     /* subject: a study */
#define GSN_STUDY_FREEZE "freeze"   /* subject: a study; text: SHA-256 of what it rests on */
#define GSN_STUDY_UNBLIND "unblind" /* subject: a study */

struct gsn_study_files; /* the records of a study and the texts they borrow */

void gsn_study_files_free(struct gsn_study_files *files);
GSN_DEFINE_AUTO(gsn_study_files);

/* gives: what the store has of a study. Reports that are not what their run wrote are left out,
 * with the reason. Fails with GSN_E_NOTFOUND when no specimen is in it; its sentence names the
 * studies there are. */
int gsn_study_gather(struct gsn_store *store, const char *name, struct gsn_study_files **ret_files,
                     struct gsn_error *err);

/* Adds what each specimen that takes part has in the cells of the base mesh, for the maps of the
 * losses; of a blind study nothing, for it has no controls. */
int gsn_study_read_cells(struct gsn_study_files *files, struct gsn_store *store,
                         struct gsn_error *err);

/* borrows: valid as long as files. */
const struct gsn_study_input *gsn_study_files_input(const struct gsn_study_files *files);
/* SHA-256 of the specimens, their runs and who is left out: what a freeze keeps. */
const char *gsn_study_files_digest(const struct gsn_study_files *files);
int gsn_study_is_frozen(const struct gsn_study_files *files);

/* Writes DIR/studies/NAME/index.html, study.json, animals.csv, loss-cells.csv.
 * gives: that folder. */
int gsn_study_write(struct gsn_store *store, const struct gsn_study *study, char **ret_folder,
                    struct gsn_error *err);

/* gives: a path from the store's folder as a link there: a '%' of the path is one in the link too.
 * NULL when memory runs out. */
char *gsn_study_link(const char *path);

/* The names of all studies that have specimens, in order, without the empty one. */
struct gsn_study_names {
    size_t count;
    char **at;
};
void gsn_study_names_free(struct gsn_study_names *names);
GSN_DEFINE_AUTO(gsn_study_names);
/* gives. */
int gsn_study_list(struct gsn_store *store, struct gsn_study_names **ret_names,
                   struct gsn_error *err);

#endif
