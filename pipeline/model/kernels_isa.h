/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The versions of kernels_isa.c. Ask gsn_kernels_for(), which knows what the processor can do. */
#ifndef GSN_MODEL_KERNELS_ISA_H
#define GSN_MODEL_KERNELS_ISA_H

#include "pipeline/model/kernels.h"

extern const struct gsn_kernels gsn_kernels_scalar, gsn_kernels_avx2, gsn_kernels_avx512,
    gsn_kernels_with_care;

#endif
