/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "pipeline/decode/codes.h"

#include <stdio.h>
#include <string.h>

/* A module of the smallest label is 0.15 mm; on a panel of 75 mm this leaves it five pixels. */
enum { LONGEST = 2500 };

struct gsn_printed *gsn_codes_add(struct gsn_picture *picture, const char *kind, const void *text,
                                  size_t size)
{
    const char *from = text;
    struct gsn_printed *code;

    if (picture->code_count == GSN_CODES)
        return NULL;
    code = &picture->code[picture->code_count++];
    *code = (struct gsn_printed){ .turn_deg = 0 };
    (void)snprintf(code->kind, sizeof code->kind, "%s", kind);
    for (size_t i = 0; i < size && i + 1 < sizeof code->text; i++)
        code->text[i] = from[i];
    for (size_t i = 0; code->text[i]; i++)
        if (code->text[i] < ' ' || code->text[i] > '~')
            code->text[i] = '?';
    return code;
}

/* The mean over a cell of the brightest channel. */
static uint8_t brightest(const struct gsn_image *image, uint32_t x0, uint32_t y0, unsigned step)
{
    unsigned sum = 0;

    for (unsigned k = 0; k < step * step; k++) {
        unsigned most = 0;

        for (unsigned c = 0; c < image->channels; c++) {
            const unsigned code = gsn_image_at(image, x0 + k % step, y0 + k / step, c);

            most = code > most ? code : most;
        }
        sum += image->bits == 8 ? most : most >> 8;
    }
    return (uint8_t)(sum / (step * step));
}

int gsn_codes_read(struct gsn_picture *picture, struct gsn_error *err)
{
    const struct gsn_image *image = picture->image;
    const uint32_t longest = image->width > image->height ? image->width : image->height;
    const unsigned step = (longest + LONGEST - 1) / LONGEST;
    struct gsn_code_page page = { .width = image->width / step,
                                  .height = image->height / step,
                                  .step = step };
    gsn_auto_mem(uint8_t) grey = NULL;
    int r;

    if (page.width < 16 || page.height < 16)
        return GSN_OK;
    grey = gsn_alloc((size_t)page.width * page.height);
    if (!grey)
        return gsn_fail(err, GSN_E_NOMEM, "out of memory while reading codes");
    for (uint32_t y = 0; y < page.height; y++)
        for (uint32_t x = 0; x < page.width; x++)
            grey[(size_t)y * page.width + x] = brightest(image, x * step, y * step, step);
    page.grey = grey;
    r = gsn_codes_dmtx(&page, picture, err);
    return r < 0 ? r : gsn_codes_zbar(&page, picture, err);
}
