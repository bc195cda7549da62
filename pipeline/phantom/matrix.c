/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/phantom/matrix.h"

#include <dmtx.h>
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
