/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/label.h"

#include <stddef.h>
#include <string.h>

enum { WIDE = 5, HIGH = 7, ADVANCE = 6 };

static const double CELL_UM = 48;

struct glyph {
    char letter;
    char cell[WIDE * HIGH + 1]; /* row by row, '#' is ink */
};

static const struct glyph GLYPH[] = {
    { '-', "     "
           "     "
           "     "
           "#####"
           "     "
           "     "
           "     " },
    { '0', " ### "
           "#   #"
           "#  ##"
           "# # #"
           "##  #"
           "#   #"
           " ### " },
    { '1', "  #  "
           " ##  "
           "  #  "
           "  #  "
           "  #  "
           "  #  "
           " ### " },
    { '2', " ### "
           "#   #"
           "    #"
           "   # "
           "  #  "
           " #   "
           "#####" },
    { '3', " ### "
           "#   #"
           "    #"
           "  ## "
           "    #"
           "#   #"
           " ### " },
    { '4', "   # "
           "  ## "
           " # # "
           "#  # "
           "#####"
           "   # "
           "   # " },
    { '5', "#####"
           "#    "
           "#### "
           "    #"
           "    #"
           "#   #"
           " ### " },
    { '8', " ### "
           "#   #"
           "#   #"
           " ### "
           "#   #"
           "#   #"
           " ### " },
    { 'C', " ### "
           "#   #"
           "#    "
           "#    "
           "#    "
           "#   #"
           " ### " },
    { 'D', "#### "
           "#   #"
           "#   #"
           "#   #"
           "#   #"
           "#   #"
           "#### " },
    { 'G', " ### "
           "#   #"
           "#    "
           "# ###"
           "#   #"
           "#   #"
           " ### " },
    { 'N', "#   #"
           "##  #"
           "# # #"
           "#  ##"
           "#   #"
           "#   #"
           "#   #" },
    { 'P', "#### "
           "#   #"
           "#   #"
           "#### "
           "#    "
           "#    "
           "#    " },
    { 'S', " ####"
           "#    "
           "#    "
           " ### "
           "    #"
           "    #"
           "#### " },
    { 'T', "#####"
           "  #  "
           "  #  "
           "  #  "
           "  #  "
           "  #  "
           "  #  " },
    { 'U', "#   #"
           "#   #"
           "#   #"
           "#   #"
           "#   #"
           "#   #"
           " ### " },
    { 'V', "#   #"
           "#   #"
           "#   #"
           "#   #"
           "#   #"
           " # # "
           "  #  " },
};

int gsn_phantom_label_has(const char *text, double x_um, double y_um)
{
    const double x = x_um / CELL_UM, y = y_um / CELL_UM;
    size_t letter, column;

    if (x < 0 || y < 0 || y >= HIGH || x >= (double)(strlen(text) * ADVANCE))
        return 0;
    letter = (size_t)x / ADVANCE;
    column = (size_t)x % ADVANCE;
    if (column >= WIDE)
        return 0;
    for (size_t i = 0; i < sizeof GLYPH / sizeof *GLYPH; i++)
        if (GLYPH[i].letter == text[letter])
            return GLYPH[i].cell[(size_t)y * WIDE + column] == '#';
    return 0;
}
