/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Any bytes as job.json: a protocol whose numbers are what docs/user/job.md allows, or a
 * sentence. */
#include "pipeline/specimen/protocol.h"

#include <math.h>
#include <string.h>

#include "tests/fuzz/hold.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size)
{
    struct gsn_protocol *protocol = NULL;
    struct gsn_error err = { 0 };
    const int r = gsn_protocol_parse((const char *)bytes, size, &protocol, &err);

    HOLD((r >= 0) == (protocol != NULL));
    if (r < 0) {
        HOLD(err.code == r && err.text[0]);
        return 0;
    }
    HOLD(protocol->specimen[0] != '\0');
    HOLD(protocol->threshold_count <= sizeof protocol->threshold / sizeof protocol->threshold[0]);
    for (size_t i = 0; i < protocol->threshold_count; i++)
        HOLD(isfinite(protocol->threshold[i]));
    HOLD(!isinf(protocol->tolerance) && protocol->kind <= GSN_KIND_TILE);
    gsn_protocol_free(protocol);
    return 0;
}
