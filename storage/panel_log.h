/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What came from the bench and what was seen on it: panels, their sections, the three marks of
 * each section.
 *
 * Pixels are those of the upright image with centres at +0.5. Numbers not known are NaN, numbers
 * of things not known are 0. */
#ifndef GSN_STORAGE_PANEL_LOG_H
#define GSN_STORAGE_PANEL_LOG_H

#include "storage/store.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_ROW_MARKS = 3 };

/* Code of a panel that is held because another scan of the same glass is used: nothing is asked. */
#define GSN_PANEL_SPARE "spare"

/* Texts may be empty but never NULL. */
struct gsn_panel_row {
    int64_t id, specimen_id;
    int64_t number;        /* as counted by the operator, from 1; 0: unknown */
    const char *file_name; /* as delivered, without folder */
    const char *sha256;    /* names the object */
    int64_t size;          /* bytes */
    const char *state;     /* "waiting", "registered", "refused", "held" */
    const char *code;      /* gsn_code_name() of the refusal, or empty */
    const char *message;   /* the sentence of the refusal, or empty */
    int64_t width, height; /* pixels; 0 until decoded */
    double px_um;          /* NaN until known */
    int64_t turn_known;    /* 0: how its picture was set upright is not, and the rest is 0 */
    int64_t mirrored;      /* 1: left to right, and that first */
    int64_t quarters;      /* clockwise, 0 to 3 */
    const char *turn_note; /* what is to be said of that, or empty */
};

struct gsn_panel_rows {
    size_t count;
    struct gsn_panel_row *at;
};

void gsn_panel_row_free(struct gsn_panel_row *row);

GSN_DEFINE_AUTO(gsn_panel_row);

void gsn_panel_rows_free(struct gsn_panel_rows *rows);

GSN_DEFINE_AUTO(gsn_panel_rows);

/* Inserts a panel (id and how its picture was turned are not read). The same bytes for the same
 * specimen are the same panel, whatever the file is called: ret_again becomes 1 and ret_id the row
 * that was there. Fails with GSN_E_INPUT when the specimen is unknown, the digest or the state is
 * none. */
int gsn_panel_put(struct gsn_store *store, const struct gsn_panel_row *panel, int64_t *ret_id,
                  int *ret_again, struct gsn_error *err);

/* gives. Fails with GSN_E_NOTFOUND. */
int gsn_panel_get(struct gsn_store *store, int64_t id, struct gsn_panel_row **ret_panel,
                  struct gsn_error *err);

/* gives: one specimen's panels by number, unknown numbers last, then by id. */
int gsn_panel_list(struct gsn_store *store, int64_t specimen_id, struct gsn_panel_rows **ret_rows,
                   struct gsn_error *err);

/* code and message: NULL stands for empty. Fails with GSN_E_NOTFOUND, GSN_E_INPUT. */
int gsn_panel_set_state(struct gsn_store *store, int64_t id, const char *state, const char *code,
                        const char *message, struct gsn_error *err);

/* A file that was delivered again under another name: what it is called now counts. */
int gsn_panel_set_name(struct gsn_store *store, int64_t id, int64_t number, const char *file_name,
                       struct gsn_error *err);

/* What the decoder found. */
int gsn_panel_set_size(struct gsn_store *store, int64_t id, int64_t width, int64_t height,
                       double px_um, struct gsn_error *err);

/* How its picture was set upright when what is known of its sections was found. Fails with
 * GSN_E_NOTFOUND, GSN_E_INPUT. */
int gsn_panel_set_turn(struct gsn_store *store, int64_t id, int64_t mirrored, int64_t quarters,
                       const char *note, struct gsn_error *err);

struct gsn_fiducial_row {
    int64_t found; /* 0: the rest is not read, and reads back as NaN */
    double x_px, y_px, radius_px;
    double cov_xx, cov_xy, cov_yy; /* of the position, px^2 */
    double score;
};

/* One slot of a panel. */
struct gsn_section_row {
    int64_t panel_id;
    int64_t slot;                          /* place on the panel in the layout's order, from 1 */
    int64_t serial;                        /* number in the block, from 1; 0: unknown */
    const char *state;                     /* "found", "empty", "needs-eye", "missing", "held" */
    const char *flags;                     /* words separated by one space, or empty */
    double bbox_x, bbox_y, bbox_w, bbox_h; /* pixels */
    double area_px;
    struct gsn_fiducial_row marker[GSN_ROW_MARKS]; /* marks 1, 2, 3 */
};

struct gsn_section_rows {
    size_t count;
    struct gsn_section_row *at;
};

void gsn_section_rows_free(struct gsn_section_rows *rows);

GSN_DEFINE_AUTO(gsn_section_rows);

/* Puts these in place of all sections of the panel, marks included, in one transaction; their
 * panel_id is not read. Fails with GSN_E_NOTFOUND (no such panel) or GSN_E_INPUT (an unknown state,
 * a slot twice), and then the old ones are still there. */
int gsn_section_replace(struct gsn_store *store, int64_t panel_id,
                        const struct gsn_section_row *sections, size_t count,
                        struct gsn_error *err);

/* gives: all sections of a specimen's panels, by serial number (unknown ones last), panel, slot. */
int gsn_section_list(struct gsn_store *store, int64_t specimen_id,
                     struct gsn_section_rows **ret_rows, struct gsn_error *err);

/* What a scan's name says about the panel it shows. */

/* The panel number in a file name: the last number that is called a panel ("P03", "panel 3"), else
 * the last number at all; 0 when there is none or it is beyond 10000. The first skip bytes and the
 * extension are not read. */
unsigned gsn_panel_number(const char *name, size_t skip);

/* The same, but only a number that is called a panel: cameras count their pictures in names, and
 * that count is no panel's number. */
unsigned gsn_panel_number_called(const char *name, size_t skip);

#ifdef __cplusplus
}
#endif
#endif
