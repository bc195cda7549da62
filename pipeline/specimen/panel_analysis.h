/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What can be seen on one panel alone: which slot holds which section, and where its marks are.
 *
 * This is the work of one panel job. It is kept as rows, so that the specimen's own job starts from
 * it and a panel that is refused costs only itself. */
#ifndef GSN_SPECIMEN_PANEL_ANALYSIS_H
#define GSN_SPECIMEN_PANEL_ANALYSIS_H

#include "pipeline/core/progress.h"
#include "pipeline/register/fiducial/fiducial.h"
#include "pipeline/register/panel/slots.h"
#include "pipeline/specimen/candidates.h"
#include "pipeline/specimen/protocol.h"
#include "pipeline/specimen/scan.h"
#include "pipeline/specimen/section_flags.h"
#include "pipeline/stain/artefact/dust.h"

#include <limits.h>

enum gsn_sighting {
    GSN_SIGHT_FOUND,     /* tissue with three marks */
    GSN_SIGHT_NEEDS_EYE, /* tissue, but marks are missing or could be others */
    GSN_SIGHT_MISSING,   /* no tissue where the protocol expects a section: a gap */
    GSN_SIGHT_EMPTY,     /* no tissue, and none expected */
    GSN_SIGHT_HELD, /* tissue that a person must deal with: grown together with another section,
                       or a scrap that belongs to no slot */
};

/* The serial number of what belongs to no slot; one more is 0, which means none. */
#define GSN_NO_SERIAL UINT_MAX

/* One slot of a panel; boxes and marks in pixels of the upright picture. */
struct gsn_panel_section {
    unsigned serial; /* 0-based in the block, or GSN_NO_SERIAL */
    unsigned slot;   /* 0-based in the order of mounting; scraps are counted on behind the slots */
    enum gsn_sighting sighting;
    struct gsn_section_flags flags;
    int x, y, width, height;
    double area_px;
    struct gsn_fiducial mark[GSN_FIDUCIALS];
    struct gsn_candidates candidates; /* of a section whose marks could be others, or of which a
                                         person chose: laid in the block or in the panel's own
                                         triangle, errors not predicted */
};

/* What a person decided about one panel, where its picture does not tell. */
enum gsn_panel_said {
    GSN_SAID_CUT,       /* the sections in this slot and the one it touches: cut them as proposed */
    GSN_SAID_HOLD,      /* the same: hold them, whatever the neck is like */
    GSN_SAID_SEAT,      /* this piece is the section of slot to */
    GSN_SAID_DISMISS,   /* this piece is nothing */
    GSN_SAID_FIRST,     /* the section nearest to the top left, row by row, is that of slot to */
    GSN_SAID_POSE,      /* the marks of this section are where choice says */
    GSN_SAID_AS_SET,    /* the panel lies as it was set upright, whatever its marks say */
    GSN_SAID_AS_MARKED, /* it lies as its marks say */
};
struct gsn_panel_answer {
    enum gsn_panel_said said;
    unsigned slot;          /* 0-based; scraps are counted on behind the slots */
    unsigned to;            /* 0-based */
    struct gsn_point at_px; /* of a scrap: a place inside its box */
    struct gsn_candidate_choice choice;
    int elsewhere; /* said of another scan of this panel, so of other pixels: never applied */
};
struct gsn_panel_answers {
    size_t count;
    const struct gsn_panel_answer *at;
};

struct gsn_panel_findings {
    uint32_t width, height;
    double px_um;
    struct gsn_orientation upright;
    struct gsn_dust_turn against; /* how it lies by its marks, once it is set upright otherwise */
    char note[1024];              /* what was assumed or odd on this panel, "; " between */
    char label[64]; /* the text of its code, when that ends in a panel's number ("...-P03") */
    unsigned label_number;  /* that number; 0: no such code was read */
    char label_subject[64]; /* what stands before it: "GVP-D-S01" */
    size_t count;
    struct gsn_panel_section *section; /* one per slot, in slot order; then one per scrap */
};

/* "found", "needs-eye", "missing", "empty", "held". */
const char *gsn_sighting_name(enum gsn_sighting sighting);

/* gives. number: of the panel, 1-based; answers: NULL when nothing was decided; decoder: as for
 * gsn_decode_apart(). An answer that the panel does not ask for changes nothing; a pose
 * that was chosen and is not there any more is said in the note, and its section is flagged
 * "decision-void". One that is there makes its section found, flagged "decided". Fails as
 * gsn_scan_open() and gsn_panel_split() do, and with GSN_E_WITHHELD when the marks say that the
 * pixels are not as large as stated, or that the panel lies otherwise than it was set upright and
 * nobody decided. borrows: everything. */
int gsn_panel_analyse(struct gsn_decoder *decoder, int picture_fd,
                      const struct gsn_protocol *protocol, unsigned number,
                      const struct gsn_panel_answers *answers, unsigned threads,
                      const struct gsn_progress *progress, struct gsn_panel_findings **ret_findings,
                      struct gsn_error *err);
void gsn_panel_findings_free(struct gsn_panel_findings *findings);
GSN_DEFINE_AUTO(gsn_panel_findings);

#endif
