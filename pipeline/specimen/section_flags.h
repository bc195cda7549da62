/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is said of a section in one word each: a bit set, and the words in the order they were said.
 *
 * Decisions ask the set, never a text. The words stand in report.json and in the store; a word that
 * this version does not know is dropped when a store is read. */
#ifndef GSN_SPECIMEN_SECTION_FLAGS_H
#define GSN_SPECIMEN_SECTION_FLAGS_H

#include <stddef.h>
#include <stdint.h>

enum gsn_flag {
    /* what its panel alone shows, and what a person decided there */
    GSN_FLAG_TOUCHING,
    GSN_FLAG_PARTED,
    GSN_FLAG_BETWEEN_SLOTS,
    GSN_FLAG_OVER_EDGE,
    GSN_FLAG_SCRAP,
    GSN_FLAG_TWO_MARKS,
    GSN_FLAG_MIRRORED,
    GSN_FLAG_AMBIGUOUS_MARKS,
    GSN_FLAG_NO_MARKS,
    GSN_FLAG_DECIDED,
    GSN_FLAG_DECISION_VOID,
    /* its pose */
    GSN_FLAG_NO_PANEL,
    GSN_FLAG_RESIDUAL,
    GSN_FLAG_TISSUE_DISAGREES,
    GSN_FLAG_BY_TISSUE,
    GSN_FLAG_FLIPPED,
    GSN_FLAG_TURNED,
    GSN_FLAG_TISSUE_UNSURE,
    GSN_FLAG_NO_TISSUE_FITS,
    /* its picture */
    GSN_FLAG_CLIPPED, /* number: per cent of its tissue */
    GSN_FLAG_DUPLICATE_SERIAL,
    GSN_FLAG_THICK,
    GSN_FLAG_THIN,
    /* its order; number and second: panel and slot of the other, from 1 */
    GSN_FLAG_SWAPPED_WITH,
    GSN_FLAG_SAME_AS,
    GSN_FLAG_DEFECT, /* + the bit of a defect (stain/artefact/detection.h): it has some */
};

enum { GSN_FLAGS_MOST = 20, GSN_FLAG_WORD = 40, GSN_FLAGS_TEXT = 160 };

struct gsn_section_flags {
    uint64_t set; /* of 1 << enum gsn_flag */
    size_t count;
    struct {
        unsigned flag, number, second;
    } at[GSN_FLAGS_MOST]; /* in the order they were said */
};

/* More than GSN_FLAGS_MOST words are not kept. */
void gsn_flags_add(struct gsn_section_flags *flags, unsigned flag);
void gsn_flags_add_number(struct gsn_section_flags *flags, unsigned flag, unsigned number,
                          unsigned second);
int gsn_flags_has(const struct gsn_section_flags *flags, unsigned flag);

/* The i-th word as report.json has it. */
void gsn_flags_word(const struct gsn_section_flags *flags, size_t i, char ret_word[GSN_FLAG_WORD]);
/* All words with one space between; whole words, as many as fit. */
void gsn_flags_text(const struct gsn_section_flags *flags, char ret_text[GSN_FLAGS_TEXT]);
/* The flags of such a text that says what a panel alone shows. */
struct gsn_section_flags gsn_flags_of_text(const char *text);

/* Why a section with this flag is left out, and what to do about it. Static; NULL: the flag leaves
 * no section out. */
const char *gsn_flag_reason(unsigned flag);

#endif
