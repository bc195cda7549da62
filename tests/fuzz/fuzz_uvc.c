/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Any bytes as a camera's descriptors: lists within their bounds, names that end, and an answer to
 * whether it can be locked. */
#include "acquire/uvc.h"

#include <string.h>

#include "tests/fuzz/hold.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    gsn_auto(gsn_uvc) uvc = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_uvc_parse(bytes, size, &uvc, &err);
    char reason[120] = "";

    HOLD((r >= 0) == (uvc != NULL) && (r >= 0 || (err.code == r && err.text[0])));
    if (r < 0)
        return 0;
    HOLD(uvc->format_count <= GSN_UVC_MOST_FORMATS && uvc->size_count <= GSN_UVC_MOST_SIZES);
    for (size_t i = 0; i < uvc->format_count; i++)
        HOLD(strlen(uvc->format[i].name) == 4);
    for (size_t i = 0; i < uvc->size_count; i++)
        HOLD(uvc->size[i].format < uvc->format_count);
    HOLD(!gsn_uvc_can_be_locked(uvc, reason, sizeof reason) == (reason[0] != '\0'));
    return 0;
}
