/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "tests/specimen/drawn_label.h"

#include "pipeline/decode/codes.h"

#include <string.h>

/* What is wrapped below is called without a context of ours. */
static struct {
    int mirrored, fails;
    double turn_deg;
    unsigned asked;
} label;

int __wrap_gsn_codes_read(struct gsn_picture *picture, struct gsn_error *err);

int __wrap_gsn_codes_read(struct gsn_picture *picture, struct gsn_error *err)
{
    static const char TEXT[] = "a label";
    struct gsn_printed *code;

    label.asked++;
    if (label.fails)
        return gsn_fail(err, GSN_E_LIMIT, "the reader of codes takes too long");
    code = gsn_codes_add(picture, "Data Matrix", TEXT, strlen(TEXT));
    code->mirrored = label.mirrored;
    code->turn_deg = label.turn_deg;
    return GSN_OK;
}

void drawn_label_lies(int mirrored, int quarters)
{
    label.mirrored = mirrored;
    label.fails = 0;
    /* Mirrored back, what was turned clockwise is turned the other way. */
    label.turn_deg = (mirrored ? -90.0 : 90.0) * quarters;
    label.asked = 0;
}

void drawn_label_fails(void)
{
    label.fails = 1;
}

unsigned drawn_label_asked(void)
{
    return label.asked;
}
