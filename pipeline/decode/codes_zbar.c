/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/codes.h"

#include <zbar.h>

static double turn_of(const zbar_symbol_t *symbol)
{
    switch (zbar_symbol_get_orientation(symbol)) {
    case ZBAR_ORIENT_RIGHT:
        return 90;
    case ZBAR_ORIENT_DOWN:
        return 180;
    case ZBAR_ORIENT_LEFT:
        return -90;
    default:
        return 0;
    }
}

int gsn_codes_zbar(const struct gsn_code_page *page, struct gsn_picture *picture,
                   struct gsn_error *err)
{
    zbar_image_scanner_t *scanner = zbar_image_scanner_create();
    zbar_image_t *image = zbar_image_create();
    const zbar_symbol_t *symbol = NULL;

    if (scanner && image) {
        zbar_image_set_format(image, zbar_fourcc('Y', '8', '0', '0'));
        zbar_image_set_size(image, page->width, page->height);
        zbar_image_set_data(image, page->grey, (unsigned long)page->width * page->height, NULL);
        if (zbar_scan_image(scanner, image) > 0)
            symbol = zbar_image_first_symbol(image);
    }
    for (; symbol; symbol = zbar_symbol_next(symbol)) {
        struct gsn_printed *code =
            gsn_codes_add(picture, zbar_get_symbol_name(zbar_symbol_get_type(symbol)),
                          zbar_symbol_get_data(symbol), zbar_symbol_get_data_length(symbol));

        if (code)
            code->turn_deg = turn_of(symbol);
    }
    if (image)
        zbar_image_destroy(image);
    if (scanner)
        zbar_image_scanner_destroy(scanner);
    return scanner && image ? GSN_OK
                            : gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
}
