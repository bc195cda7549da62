/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the specimens of a study have in the cells of the base mesh, from the tables that their runs
 * kept. */
#ifndef GSN_SYSTEMD_WORKER_STUDY_CELLS_H
#define GSN_SYSTEMD_WORKER_STUDY_CELLS_H

#include "pipeline/study/study.h"
#include "storage/catalog.h"

/* Tables that were read, for specimens that share a baseline. */
struct gsn_cell_tables;
/* gives; NULL when memory runs out. */
struct gsn_cell_tables *gsn_cell_tables_new(void);
void gsn_cell_tables_free(struct gsn_cell_tables *tables);
GSN_DEFINE_AUTO(gsn_cell_tables);

/* gives: the density of each cell in order: a control's own; of any other (1 - loss) times that of
 * its baseline's specimens there, which is its density in their stain, where both are known. None
 * where its last run, or one of its baseline's, kept no such table, or one that is not what it
 * wrote: those cost their share of the map alone. Fails with GSN_E_NOMEM, and as the store does. */
int gsn_study_places(struct gsn_cell_tables *tables, struct gsn_store *store,
                     const struct gsn_specimen_row *row, struct gsn_study_place **ret_place,
                     size_t *ret_count, struct gsn_error *err);

#endif
