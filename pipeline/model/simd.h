/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Several points at once: the few vector operations that the kernels are written in.
 *
 * A file that includes this is compiled once per instruction set. Every operation rounds alike in
 * each of them, the fused multiply-add included, so that a lane holds the same bits whether eight,
 * four or one of them are computed together, and a report does not depend on the processor. */
#ifndef GSN_MODEL_SIMD_H
#define GSN_MODEL_SIMD_H

#include <math.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#if defined(__AVX512F__) && defined(__AVX512DQ__)

#include <immintrin.h>

enum { GSN_SIMD_WIDTH = 8 };
typedef __m512d gsn_simd;

static inline gsn_simd gsn_simd_load(const double *from)
{
    return _mm512_loadu_pd(from);
}

static inline void gsn_simd_store(double *to, gsn_simd a)
{
    _mm512_storeu_pd(to, a);
}

/* The first count lanes, or all of them; 0 in the others. */
static inline gsn_simd gsn_simd_load_some(const double *from, size_t count)
{
    return count < 8 ? _mm512_maskz_loadu_pd((__mmask8)((1u << count) - 1), from)
                     : _mm512_loadu_pd(from);
}

static inline void gsn_simd_store_some(double *to, gsn_simd a, size_t count)
{
    if (count < 8)
        _mm512_mask_storeu_pd(to, (__mmask8)((1u << count) - 1), a);
    else
        _mm512_storeu_pd(to, a);
}

static inline gsn_simd gsn_simd_all(double a)
{
    return _mm512_set1_pd(a);
}

static inline gsn_simd gsn_simd_fma(gsn_simd a, gsn_simd b, gsn_simd c)
{
    return _mm512_fmadd_pd(a, b, c);
}

static inline gsn_simd gsn_simd_max(gsn_simd a, gsn_simd b)
{
    return _mm512_max_pd(a, b);
}

static inline gsn_simd gsn_simd_min(gsn_simd a, gsn_simd b)
{
    return _mm512_min_pd(a, b);
}

static inline gsn_simd gsn_simd_ceil(gsn_simd a)
{
    return _mm512_ceil_pd(a);
}

static inline gsn_simd gsn_simd_floor(gsn_simd a)
{
    return _mm512_floor_pd(a);
}

/* min(a, |b|) for a >= 0. */
static inline gsn_simd gsn_simd_least(gsn_simd a, gsn_simd b)
{
    return _mm512_range_pd(a, b, 2 | 2 << 2);
}

/* The lanes of keep, a bit each, one behind the other as whole numbers, which they must be. Writes
 * as many numbers as there are lanes. */
static inline void gsn_simd_squeeze(int32_t *to, gsn_simd a, unsigned keep)
{
    _mm256_storeu_si256((__m256i *)to,
                        _mm512_cvttpd_epi32(_mm512_maskz_compress_pd((__mmask8)keep, a)));
}

/* A bit per lane: a < b. */
static inline unsigned gsn_simd_below(gsn_simd a, gsn_simd b)
{
    return _mm512_cmp_pd_mask(a, b, _CMP_LT_OQ);
}

/* A bit per lane: not a > bound. */
static inline unsigned gsn_simd_not_above(gsn_simd a, double bound)
{
    return _mm512_cmp_pd_mask(a, _mm512_set1_pd(bound), _CMP_NGT_UQ);
}

/* value where the signs of a, b, c, d alternate, 0 elsewhere. */
static inline gsn_simd gsn_simd_where_signs_alternate(gsn_simd a, gsn_simd b, gsn_simd c,
                                                      gsn_simd d, double value)
{
    /* (a ^ b) & (b ^ c), then & (c ^ d). */
    const __m512i abc = _mm512_ternarylogic_epi64(_mm512_castpd_si512(a), _mm512_castpd_si512(b),
                                                  _mm512_castpd_si512(c), 0x24);
    const __m512i all =
        _mm512_ternarylogic_epi64(abc, _mm512_castpd_si512(c), _mm512_castpd_si512(d), 0x60);

    return _mm512_maskz_mov_pd(_mm512_movepi64_mask(all), _mm512_set1_pd(value));
}

#elif defined(__AVX2__) && defined(__FMA__)

#include <immintrin.h>

enum { GSN_SIMD_WIDTH = 4 };
typedef __m256d gsn_simd;

static inline gsn_simd gsn_simd_load(const double *from)
{
    return _mm256_loadu_pd(from);
}

static inline void gsn_simd_store(double *to, gsn_simd a)
{
    _mm256_storeu_pd(to, a);
}

static inline __m256i gsn_simd_some(size_t count)
{
    return _mm256_cmpgt_epi64(_mm256_set1_epi64x((long long)count), _mm256_setr_epi64x(0, 1, 2, 3));
}

static inline gsn_simd gsn_simd_load_some(const double *from, size_t count)
{
    return _mm256_maskload_pd(from, gsn_simd_some(count));
}

static inline void gsn_simd_store_some(double *to, gsn_simd a, size_t count)
{
    _mm256_maskstore_pd(to, gsn_simd_some(count), a);
}

static inline gsn_simd gsn_simd_all(double a)
{
    return _mm256_set1_pd(a);
}

static inline gsn_simd gsn_simd_fma(gsn_simd a, gsn_simd b, gsn_simd c)
{
    return _mm256_fmadd_pd(a, b, c);
}

static inline gsn_simd gsn_simd_max(gsn_simd a, gsn_simd b)
{
    return _mm256_max_pd(a, b);
}

static inline gsn_simd gsn_simd_min(gsn_simd a, gsn_simd b)
{
    return _mm256_min_pd(a, b);
}

static inline gsn_simd gsn_simd_ceil(gsn_simd a)
{
    return _mm256_ceil_pd(a);
}

static inline gsn_simd gsn_simd_floor(gsn_simd a)
{
    return _mm256_floor_pd(a);
}

static inline gsn_simd gsn_simd_least(gsn_simd a, gsn_simd b)
{
    return _mm256_min_pd(a, _mm256_andnot_pd(_mm256_set1_pd(-0.0), b));
}

static inline void gsn_simd_squeeze(int32_t *to, gsn_simd a, unsigned keep)
{
    int32_t whole[4];

    _mm_storeu_si128((__m128i *)whole, _mm256_cvttpd_epi32(a));
    for (unsigned i = 0, kept = 0; i < 4; i++) {
        to[kept] = whole[i];
        kept += keep >> i & 1;
    }
}

static inline unsigned gsn_simd_below(gsn_simd a, gsn_simd b)
{
    return (unsigned)_mm256_movemask_pd(_mm256_cmp_pd(a, b, _CMP_LT_OQ));
}

static inline unsigned gsn_simd_not_above(gsn_simd a, double bound)
{
    return (unsigned)_mm256_movemask_pd(_mm256_cmp_pd(a, _mm256_set1_pd(bound), _CMP_NGT_UQ));
}

static inline gsn_simd gsn_simd_where_signs_alternate(gsn_simd a, gsn_simd b, gsn_simd c,
                                                      gsn_simd d, double value)
{
    const __m256d all =
        _mm256_and_pd(_mm256_and_pd(_mm256_xor_pd(a, b), _mm256_xor_pd(b, c)), _mm256_xor_pd(c, d));

    return _mm256_blendv_pd(_mm256_setzero_pd(), _mm256_set1_pd(value), all);
}

#else

enum { GSN_SIMD_WIDTH = 1 };
typedef double gsn_simd;

static inline gsn_simd gsn_simd_load(const double *from)
{
    return *from;
}

static inline void gsn_simd_store(double *to, gsn_simd a)
{
    *to = a;
}

static inline gsn_simd gsn_simd_load_some(const double *from, size_t count)
{
    return count ? *from : 0;
}

static inline void gsn_simd_store_some(double *to, gsn_simd a, size_t count)
{
    if (count)
        *to = a;
}

static inline gsn_simd gsn_simd_all(double a)
{
    return a;
}

static inline gsn_simd gsn_simd_fma(gsn_simd a, gsn_simd b, gsn_simd c)
{
    return fma(a, b, c);
}

static inline gsn_simd gsn_simd_max(gsn_simd a, gsn_simd b)
{
    return a > b ? a : b;
}

static inline gsn_simd gsn_simd_min(gsn_simd a, gsn_simd b)
{
    return a < b ? a : b;
}

static inline gsn_simd gsn_simd_ceil(gsn_simd a)
{
    return ceil(a);
}

static inline gsn_simd gsn_simd_floor(gsn_simd a)
{
    return floor(a);
}

static inline gsn_simd gsn_simd_least(gsn_simd a, gsn_simd b)
{
    return fmin(a, fabs(b));
}

static inline void gsn_simd_squeeze(int32_t *to, gsn_simd a, unsigned keep)
{
    (void)keep;
    *to = (int32_t)a;
}

static inline unsigned gsn_simd_below(gsn_simd a, gsn_simd b)
{
    return a < b;
}

static inline unsigned gsn_simd_not_above(gsn_simd a, double bound)
{
    return !(a > bound);
}

static inline unsigned gsn_simd_sign(double a)
{
    uint64_t bits;

    memcpy(&bits, &a, sizeof bits);
    return (unsigned)(bits >> 63);
}

static inline gsn_simd gsn_simd_where_signs_alternate(gsn_simd a, gsn_simd b, gsn_simd c,
                                                      gsn_simd d, double value)
{
    const unsigned p = gsn_simd_sign(a), q = gsn_simd_sign(b), r = gsn_simd_sign(c),
                   s = gsn_simd_sign(d);

    return (p ^ q) & (q ^ r) & (r ^ s) ? value : 0;
}

#endif
#endif
