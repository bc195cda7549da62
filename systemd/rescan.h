/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether a panel is another scan of glass that is there already.
 *
 * Two files of one scan have one hash; two scans of one glass do not, but their marks lie on the
 * glass as they did: no two panels are mounted by hand alike to a pixel. A label that says the
 * panel's own number settles it without the marks. */
#ifndef GSN_SYSTEMD_RESCAN_H
#define GSN_SYSTEMD_RESCAN_H

#include "pipeline/examine.h"
#include "storage/panel_log.h"

/* Looks among the registered panels of the specimen for one whose marks agree with the findings
 * after one common motion of the glass.
 *
 * Fails with GSN_E_WITHHELD and a sentence that names both when there is one, else as the store
 * does. */
int gsn_rescan_check(struct gsn_store *store, const struct gsn_panel_row *panel,
                     const struct gsn_panel_findings *findings, struct gsn_error *err);

/* Whether two registered panels show the same glass: how many marks they share, and how far apart
 * these are after one motion, root mean square in um. rows: all sections of the specimen. Fails
 * with GSN_E_NOMEM. */
int gsn_rescan_compare(const struct gsn_section_rows *rows, const struct gsn_panel_row *a,
                       const struct gsn_panel_row *b, int *ret_same, size_t *ret_marks,
                       double *ret_apart_um, struct gsn_error *err);

#endif
