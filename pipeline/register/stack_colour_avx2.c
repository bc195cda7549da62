/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Four voxels at a time, two in each half of a register; what is done to each is said in
 * stack_colour_sse4.c. */
#include "pipeline/register/stack_colour.h"

#include <immintrin.h>
#include <string.h>

gsn_colour_row_run gsn_colour_row_sse4, gsn_colour_row_avx2;

enum { VOXELS = 4 };

static inline __m256i places(int64_t at, int64_t apart)
{
    return _mm256_setr_epi64x(at, at + apart, at + 2 * apart, at + 3 * apart);
}

/* In each half the weights of both pixels of a pair, of two voxels. */
static inline __m256i weights(__m256i at)
{
    const __m256i t = _mm256_and_si256(_mm256_srli_epi64(at, 18), _mm256_set1_epi64x(16383));

    return _mm256_or_si256(_mm256_slli_epi64(t, 16),
                           _mm256_sub_epi64(_mm256_set1_epi64x(16384), t));
}

static inline int64_t pair_at(const uint8_t *from)
{
    int64_t bytes;

    memcpy(&bytes, from, sizeof bytes);
    return bytes;
}

/* Of the upper or the lower two pixels of each voxel. */
static inline __m256i pairs_at(const uint8_t *from, const int64_t at[VOXELS])
{
    return _mm256_setr_epi64x(pair_at(from + at[0]), pair_at(from + at[1]), pair_at(from + at[2]),
                              pair_at(from + at[3]));
}

/* The light of one of the two voxels of each half. */
static inline __m256i light_of(__m256i upper, __m256i lower, __m256i order, __m256i wx, __m256i wy)
{
    const __m256i top =
        _mm256_srli_epi32(_mm256_madd_epi16(_mm256_shuffle_epi8(upper, order), wx), 7);
    const __m256i low =
        _mm256_srli_epi32(_mm256_madd_epi16(_mm256_shuffle_epi8(lower, order), wx), 7);

    return _mm256_srli_epi32(
        _mm256_madd_epi16(_mm256_or_si256(top, _mm256_slli_epi32(low, 16)), wy), 16);
}

static inline void put(uint64_t light, const uint8_t *code, uint8_t *to)
{
    to[0] = code[light & 0xffff];
    to[1] = code[light >> 16 & 0xffff];
    to[2] = code[light >> 32 & 0xffff];
}

void gsn_colour_row_avx2(const struct gsn_colour_row *row)
{
    const uint8_t *samples = row->image->samples, *code = row->light->code;
    const int64_t stride = 3 * (int64_t)row->image->width;
    const __m256i first = _mm256_broadcastsi128_si256(
        _mm_setr_epi8(0, -1, 3, -1, 1, -1, 4, -1, 2, -1, 5, -1, -1, -1, -1, -1));
    const __m256i second = _mm256_broadcastsi128_si256(
        _mm_setr_epi8(8, -1, 11, -1, 9, -1, 12, -1, 10, -1, 13, -1, -1, -1, -1, -1));
    const __m256i dx = _mm256_set1_epi64x(VOXELS * row->dx);
    const __m256i dy = _mm256_set1_epi64x(VOXELS * row->dy);
    __m256i x = places(row->x, row->dx), y = places(row->y, row->dy);
    struct gsn_colour_row rest = *row;
    uint8_t *to = row->to;
    size_t i = 0;

    for (; i + VOXELS <= row->count; i += VOXELS, to += 3 * VOXELS) {
        const __m256i columns = _mm256_srli_epi64(x, 32), rows = _mm256_srli_epi64(y, 32);
        const __m256i wx = weights(x), wy = weights(y);
        int64_t at[VOXELS];
        uint64_t light[VOXELS];
        __m256i upper, lower, a, b;

        _mm256_storeu_si256((void *)at,
                            _mm256_add_epi64(_mm256_mul_epu32(rows, _mm256_set1_epi64x(stride)),
                                             _mm256_mul_epu32(columns, _mm256_set1_epi64x(3))));
        for (int k = 0; k < VOXELS; k++)
            _mm_prefetch(samples + at[k] + row->ahead, _MM_HINT_T0);
        upper = pairs_at(samples, at);
        lower = pairs_at(samples + stride, at);
        a = light_of(upper, lower, first, _mm256_shuffle_epi32(wx, 0x00),
                     _mm256_shuffle_epi32(wy, 0x00));
        b = light_of(upper, lower, second, _mm256_shuffle_epi32(wx, 0xaa),
                     _mm256_shuffle_epi32(wy, 0xaa));
        _mm256_storeu_si256((void *)light, _mm256_packus_epi32(a, b));
        for (int k = 0; k < VOXELS; k++)
            put(light[k], code, to + 3 * k);
        x = _mm256_add_epi64(x, dx);
        y = _mm256_add_epi64(y, dy);
    }
    rest.x += (int64_t)i * row->dx;
    rest.y += (int64_t)i * row->dy;
    rest.to = to;
    rest.count -= i;
    gsn_colour_row_sse4(&rest);
}
