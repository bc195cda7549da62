/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The writing on a panel's label: its Data Matrix (ISO/IEC 16022, ECC 200) by libdmtx in one scheme
 * and one size, so that no version of the library chooses another symbol, and 5 x 7 letters. */
#include "pipeline/phantom/label.h"

#include <dmtx.h>
#include <stddef.h>
#include <string.h>

static void encoder_done(DmtxEncode **encoder)
{
    if (*encoder)
        dmtxEncodeDestroy(encoder);
}

int gsn_phantom_matrix_make(const char *text, struct gsn_phantom_matrix *ret_matrix,
                            struct gsn_error *err)
{
    enum { SIDE = GSN_PHANTOM_MATRIX_SIDE, MOST_LETTERS = 24 };
    __attribute__((cleanup(encoder_done))) DmtxEncode *encoder = NULL;
    unsigned char letters[MOST_LETTERS];
    const size_t length = strlen(text);

    if (length == 0 || length > MOST_LETTERS)
        return gsn_fail(err, GSN_E_LIMIT, "\"%s\" does not fit a Data Matrix of %d x %d", text,
                        SIDE, SIDE);
    encoder = dmtxEncodeCreate();
    if (!encoder)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory for the Data Matrix of %s", text);
    memcpy(letters, text, length);
    /* One scheme and one size, so that no version of the library chooses another symbol. */
    dmtxEncodeSetProp(encoder, DmtxPropScheme, DmtxSchemeAscii);
    dmtxEncodeSetProp(encoder, DmtxPropSizeRequest, DmtxSymbol16x16);
    if (dmtxEncodeDataMatrix(encoder, (int)length, letters) != DmtxPass)
        return gsn_fail(err, GSN_E_LIMIT, "\"%s\" does not fit a Data Matrix of %d x %d", text,
                        SIDE, SIDE);
    /* The library counts rows from the bottom. */
    for (int row = 0; row < SIDE; row++)
        for (int column = 0; column < SIDE; column++)
            ret_matrix->dark[row][column] =
                (dmtxSymbolModuleStatus(encoder->message, DmtxSymbol16x16, SIDE - 1 - row, column) &
                 DmtxModuleOnRed) != 0;
    return GSN_OK;
}

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
