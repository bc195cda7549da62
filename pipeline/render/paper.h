/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Sheets of paper as a PDF: what is put on them flows down the page and on to the next.
 *
 * Pages are A4 with a margin that Letter has too, lengths are points of 1/72 inch. Texts are UTF-8.
 * Failures are remembered: put everything on, then look at what gsn_paper_finish() returns. The
 * same calls give the same bytes: no date is written. */
#ifndef GSN_RENDER_PAPER_H
#define GSN_RENDER_PAPER_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_paper;

/* gives: an empty first page; title is the document's, foot stands below each page beside its
 * number. Fails with GSN_E_NOMEM, or GSN_E_NOTFOUND without the fonts (lettering.h). */
int gsn_paper_new(const char *title, const char *foot, struct gsn_paper **ret_paper,
                  struct gsn_error *err);
void gsn_paper_free(struct gsn_paper *paper);
GSN_DEFINE_AUTO(gsn_paper);

enum gsn_paper_style {
    GSN_PAPER_TITLE,
    GSN_PAPER_HEADING,    /* of a section; never the last on its page */
    GSN_PAPER_SUBHEADING, /* likewise */
    GSN_PAPER_BIG,        /* the figure that the page is about */
    GSN_PAPER_BODY,
    GSN_PAPER_SOFT, /* grey: what explains */
};

/* A paragraph; a newline begins another line. */
void gsn_paper_text(struct gsn_paper *paper, enum gsn_paper_style style, const char *text);

/* A picture as a file: PNG, or JPEG, which is kept as it is. */
struct gsn_paper_picture {
    const uint8_t *bytes;
    size_t size;
    int is_jpeg;
    unsigned width, height; /* px */
};

/* One cell of a table or of a grid. */
struct gsn_paper_cell {
    const char *text;
    int is_head;  /* bold; a first row of such cells is said again on each page */
    int is_right; /* numbers stand at the right */
    struct gsn_paper_picture picture; /* of a grid; size 0: none */
};

/* A table of count cells, row by row; columns are as wide as their texts need, or wrapped. */
void gsn_paper_table(struct gsn_paper *paper, const struct gsn_paper_cell *cell, size_t count,
                     size_t columns);

/* Cells of one width, each a picture with its text below, the text's first line bold; a row of them
 * is kept together. */
void gsn_paper_grid(struct gsn_paper *paper, const struct gsn_paper_cell *cell, size_t count,
                    size_t columns);

/* A picture as wide as the page, or with its caption beside it where it is less wide than high. */
void gsn_paper_figure(struct gsn_paper *paper, const struct gsn_paper_picture *picture,
                      const char *title, const char *caption);

/* gives: the file; nothing more may be put on. Fails with GSN_E_NOMEM, or GSN_E_INPUT where a
 * picture is none. */
int gsn_paper_finish(struct gsn_paper *paper, uint8_t **ret_bytes, size_t *ret_size,
                     struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
