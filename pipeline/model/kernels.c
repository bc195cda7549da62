/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which version of the inner loops runs: the widest whose instructions the processor has (CPUID).
 */
#include "pipeline/model/kernels.h"

const struct gsn_kernels *gsn_kernels_for(enum gsn_isa isa)
{
    switch (isa) {
    case GSN_ISA_SCALAR:
        return &gsn_kernels_scalar;
#ifdef __x86_64__
    case GSN_ISA_AVX2:
        return __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? &gsn_kernels_avx2
                                                                               : NULL;
    case GSN_ISA_AVX512:
        return __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq")
                   ? &gsn_kernels_avx512
                   : NULL;
#endif
    default:
        return NULL;
    }
}

const struct gsn_kernels *gsn_kernels_best(void)
{
    const struct gsn_kernels *best = NULL;

    for (int isa = GSN_ISA_COUNT - 1; !best; isa--)
        best = gsn_kernels_for((enum gsn_isa)isa);
    return best;
}

const struct gsn_kernels *gsn_kernels_careful(void)
{
    return &gsn_kernels_with_care;
}
