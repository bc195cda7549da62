/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The flags of a section: one table of words and reasons, a bit set, and the order they were said
 * in.
 *
 * A word is fixed, or it has numbers in it: the per cent that is clipped, the panel and slot of
 * another section. Words of defects are those of stain/artefact/detection.h. Adding and asking cost
 * nothing; texts are made for reports and for the store alone. */
#include "pipeline/specimen/section_flags.h"

#include "pipeline/stain/artefact/detection.h"

#include <stdio.h>
#include <string.h>

static const struct {
    const char *word;   /* numbers follow it */
    const char *reason; /* why it is left out: what to do; NULL: it is not, for this */
} TABLE[GSN_FLAG_DEFECT] = {
    [GSN_FLAG_TOUCHING] = { "touching", NULL },
    [GSN_FLAG_PARTED] = { "parted", NULL },
    [GSN_FLAG_BETWEEN_SLOTS] = { "between-slots", NULL },
    [GSN_FLAG_OVER_EDGE] = { "over-edge", NULL },
    [GSN_FLAG_SCRAP] = { "scrap", NULL },
    [GSN_FLAG_TWO_MARKS] = { "two-marks", NULL },
    [GSN_FLAG_MIRRORED] = { "mirrored", NULL },
    [GSN_FLAG_AMBIGUOUS_MARKS] = { "ambiguous-marks",
                                   "more than one choice of marks fits the triangle: look at it" },
    [GSN_FLAG_NO_MARKS] = { "no-marks", NULL },
    [GSN_FLAG_DECIDED] = { "decided", NULL },
    [GSN_FLAG_DECISION_VOID] = { "decision-void", NULL },
    [GSN_FLAG_NO_PANEL] = { "no-panel", "its panel is not there or was refused; the gap is "
                                        "kept at its place" },
    [GSN_FLAG_RESIDUAL] = { "residual-too-large", NULL },
    [GSN_FLAG_TISSUE_DISAGREES] = { "tissue-disagrees", NULL },
    [GSN_FLAG_BY_TISSUE] = { "by-tissue", NULL },
    [GSN_FLAG_FLIPPED] = { "flipped", NULL },
    [GSN_FLAG_TURNED] = { "turned", NULL },
    [GSN_FLAG_TISSUE_UNSURE] = { "tissue-unsure",
                                 "its tissue fits its neighbours' in more ways than one, or only "
                                 "that of sections that do: look at it and at those beside it" },
    [GSN_FLAG_NO_TISSUE_FITS] = { "no-tissue-fits",
                                  "its tissue fits none of the three sections before and after it: "
                                  "look at it" },
    [GSN_FLAG_CLIPPED] = { "clipped", "too much of it is clipped: scan its panel again with "
                                      "another exposure" },
    [GSN_FLAG_DUPLICATE_SERIAL] = { "duplicate-serial",
                                    "another section already has this serial number: rename the "
                                    "panel or approve one" },
    [GSN_FLAG_THICK] = { "thick", NULL },
    [GSN_FLAG_THIN] = { "thin", NULL },
    [GSN_FLAG_SWAPPED_WITH] = { "swapped-with", NULL },
    [GSN_FLAG_SAME_AS] = { "same-as", NULL },
};

void gsn_flags_add_number(struct gsn_section_flags *flags, unsigned flag, unsigned number,
                          unsigned second)
{
    flags->set |= UINT64_C(1) << flag;
    if (flags->count == GSN_FLAGS_MOST)
        return;
    flags->at[flags->count].flag = flag;
    flags->at[flags->count].number = number;
    flags->at[flags->count++].second = second;
}

void gsn_flags_add(struct gsn_section_flags *flags, unsigned flag)
{
    gsn_flags_add_number(flags, flag, 0, 0);
}

int gsn_flags_has(const struct gsn_section_flags *flags, unsigned flag)
{
    return flags->set >> flag & 1;
}

void gsn_flags_word(const struct gsn_section_flags *flags, size_t i, char ret_word[GSN_FLAG_WORD])
{
    const unsigned flag = flags->at[i].flag, number = flags->at[i].number;

    if (flag >= GSN_FLAG_DEFECT)
        (void)snprintf(ret_word, GSN_FLAG_WORD, "%s", gsn_defect_word(flag - GSN_FLAG_DEFECT));
    else if (flag == GSN_FLAG_CLIPPED)
        (void)snprintf(ret_word, GSN_FLAG_WORD, "%s-%u%%", TABLE[flag].word, number);
    else if (flag == GSN_FLAG_SWAPPED_WITH || flag == GSN_FLAG_SAME_AS)
        (void)snprintf(ret_word, GSN_FLAG_WORD, "%s-%u.%u?", TABLE[flag].word, number,
                       flags->at[i].second);
    else
        (void)snprintf(ret_word, GSN_FLAG_WORD, "%s", TABLE[flag].word);
}

void gsn_flags_text(const struct gsn_section_flags *flags, char ret_text[GSN_FLAGS_TEXT])
{
    size_t used = 0;

    ret_text[0] = '\0';
    for (size_t i = 0; i < flags->count; i++) {
        char word[GSN_FLAG_WORD];

        gsn_flags_word(flags, i, word);
        if (used + strlen(word) + 2 > GSN_FLAGS_TEXT)
            return;
        used +=
            (size_t)snprintf(ret_text + used, GSN_FLAGS_TEXT - used, "%s%s", used ? " " : "", word);
    }
}

struct gsn_section_flags gsn_flags_of_text(const char *text)
{
    struct gsn_section_flags flags = { .set = 0 };

    while (*text) {
        const size_t length = strcspn(text, " ");

        for (unsigned flag = 0; flag <= GSN_FLAG_DECISION_VOID; flag++)
            if (strlen(TABLE[flag].word) == length && memcmp(TABLE[flag].word, text, length) == 0)
                gsn_flags_add(&flags, flag);
        text += length + (text[length] == ' ');
    }
    return flags;
}

const char *gsn_flag_reason(unsigned flag)
{
    return flag < GSN_FLAG_DEFECT ? TABLE[flag].reason : NULL;
}
