/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What the fuzz targets share: an entry point as libFuzzer calls it, and a claim that ends the
 * process when it is untrue, in every build. */
#ifndef GSN_TESTS_FUZZ_HOLD_H
#define GSN_TESTS_FUZZ_HOLD_H

#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t size);

#define HOLD(claim)                                                                                \
    do {                                                                                           \
        if (!(claim)) {                                                                            \
            (void)fprintf(stderr, "%s:%d: not true: %s\n", __FILE__, __LINE__, #claim);            \
            abort();                                                                               \
        }                                                                                          \
    } while (0)

#endif
