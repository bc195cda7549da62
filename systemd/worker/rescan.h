/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whether two scans show one glass.
 *
 * Two files of one scan have one hash; two scans of one glass do not, but their marks lie on the
 * glass as they did, and so does their tissue. Marks alone do not tell: a jig mounts the sections
 * of every glass alike. A label that says the panel's own number settles it without either. */
#ifndef GSN_SYSTEMD_WORKER_RESCAN_H
#define GSN_SYSTEMD_WORKER_RESCAN_H

#include "pipeline/specimen/panel_analysis.h"
#include "storage/panel_log.h"

struct gsn_rescan {
    int same;
    size_t marks;    /* that both show */
    double apart_um; /* how far apart these are after one motion, root mean square */
    double texture;  /* correlation of what the tissue shows finer than half a millimetre; NaN: not
                        compared, as the marks differ */
};

/* Compares two panels that were looked at. rows: all sections of the specimen; decoder: as for
 * gsn_decode_apart(). Fails as gsn_scan_survey() and the store do. */
int gsn_rescan_compare(struct gsn_store *store, struct gsn_decoder *decoder,
                       const struct gsn_protocol *protocol, const struct gsn_section_rows *rows,
                       const struct gsn_panel_row *a, const struct gsn_panel_row *b,
                       struct gsn_rescan *ret_rescan, struct gsn_error *err);

/* Looks among the registered panels of the specimen for one of another number that shows the glass
 * of the findings.
 *
 * Fails with GSN_E_WITHHELD and a sentence that names both when there is one, else as above. */
int gsn_rescan_check(struct gsn_store *store, struct gsn_decoder *decoder,
                     const struct gsn_protocol *protocol, const struct gsn_panel_row *panel,
                     const struct gsn_panel_findings *findings, struct gsn_error *err);

#endif
