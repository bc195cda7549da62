/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Four voxels at a time, two in each half of a register; what is done to each is said in
 * stack_colour_sse4.c. */
#include "pipeline/register/stack/resample_colour.h"

#include <immintrin.h>
#include <string.h>

gsn_colour_row_run gsn_colour_row_sse4, gsn_colour_row_avx2;

/* At a time; and in each of three loops, so that no number is wanted right after it was stored. */
enum { VOXELS = 4, BLOCK = 64 };

static inline __m256i places(int64_t at, int64_t apart)
{
    return _mm256_setr_epi64x(at, at + apart, at + 2 * apart, at + 3 * apart);
}

/* Of each x and of the y beside it: below the pixel, in 2^-32. */
static inline __m256i fractions(__m256i x, __m256i y)
{
    return _mm256_blend_epi32(x, _mm256_slli_epi64(y, 32), 0xaa);
}

/* The weights of both pixels of a pair, side by side, of each x and each y. */
static inline __m256i weights(__m256i at)
{
    const __m256i t = _mm256_srli_epi32(at, 18);

    return _mm256_sub_epi32(_mm256_add_epi32(_mm256_slli_epi32(t, 16), _mm256_set1_epi32(16384)),
                            t);
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
        _mm256_slli_epi32(_mm256_madd_epi16(_mm256_shuffle_epi8(lower, order), wx), 9);

    return _mm256_srli_epi32(_mm256_madd_epi16(_mm256_blend_epi16(top, low, 0xaa), wy), 16);
}

/* Where the pixels of a block begin, in bytes. */
static void addresses(const struct gsn_colour_row *row, int64_t at[BLOCK])
{
    const __m256i stride = _mm256_set1_epi64x(3 * (int64_t)row->image->width),
                  three = _mm256_set1_epi64x(3);
    const __m256i dx = _mm256_set1_epi64x(VOXELS * row->dx),
                  dy = _mm256_set1_epi64x(VOXELS * row->dy);
    __m256i x = places(row->x, row->dx), y = places(row->y, row->dy);

    for (size_t i = 0; i < BLOCK; i += VOXELS) {
        _mm256_storeu_si256((void *)(at + i),
                            _mm256_add_epi64(_mm256_mul_epu32(_mm256_srli_epi64(y, 32), stride),
                                             _mm256_mul_epu32(_mm256_srli_epi64(x, 32), three)));
        x = _mm256_add_epi64(x, dx);
        y = _mm256_add_epi64(y, dy);
    }
}

/* Four numbers a voxel, the fourth idle. */
static void mix(const struct gsn_colour_row *row, const int64_t at[BLOCK],
                uint16_t light[4 * BLOCK])
{
    const uint8_t *upper_row = row->image->samples;
    const uint8_t *lower_row = upper_row + 3 * (size_t)row->image->width;
    const __m256i first = _mm256_broadcastsi128_si256(
        _mm_setr_epi8(0, -1, 3, -1, 1, -1, 4, -1, 2, -1, 5, -1, -1, -1, -1, -1));
    const __m256i second = _mm256_broadcastsi128_si256(
        _mm_setr_epi8(8, -1, 11, -1, 9, -1, 12, -1, 10, -1, 13, -1, -1, -1, -1, -1));
    const __m256i step =
        fractions(_mm256_set1_epi64x(VOXELS * row->dx), _mm256_set1_epi64x(VOXELS * row->dy));
    __m256i part = fractions(places(row->x, row->dx), places(row->y, row->dy));

    for (size_t i = 0; i < BLOCK; i += VOXELS) {
        const __m256i upper = pairs_at(upper_row, at + i), lower = pairs_at(lower_row, at + i);
        const __m256i w = weights(part);
        const __m256i a = light_of(upper, lower, first, _mm256_shuffle_epi32(w, 0x00),
                                   _mm256_shuffle_epi32(w, 0x55));
        const __m256i b = light_of(upper, lower, second, _mm256_shuffle_epi32(w, 0xaa),
                                   _mm256_shuffle_epi32(w, 0xff));

        _mm256_storeu_si256((void *)(light + 4 * i), _mm256_packus_epi32(a, b));
        part = _mm256_add_epi32(part, step);
    }
}

/* All voxels but the last are written with a byte too many, which the next one overwrites. */
static void put(const uint16_t light[4 * BLOCK], const uint8_t *code, uint8_t to[3 * BLOCK])
{
    for (size_t k = 0; k < BLOCK; k++) {
        const uint16_t *const of = light + 4 * k;
        const uint32_t rgb =
            (uint32_t)code[of[0]] | (uint32_t)code[of[1]] << 8 | (uint32_t)code[of[2]] << 16;

        memcpy(to + 3 * k, &rgb, k + 1 < BLOCK ? 4 : 3);
    }
}

void gsn_colour_row_avx2(const struct gsn_colour_row *row)
{
    const uint8_t *const ahead = (const uint8_t *)row->image->samples + row->ahead;
    struct gsn_colour_row rest = *row;
    int64_t at[BLOCK];
    uint16_t light[4 * BLOCK];

    for (; rest.count >= BLOCK; rest.count -= BLOCK) {
        addresses(&rest, at);
        /* The rows beside ask for what is in between. */
        for (size_t k = 0; k < BLOCK; k += 2)
            _mm_prefetch(ahead + at[k], _MM_HINT_T0);
        mix(&rest, at, light);
        put(light, row->light->code, rest.to);
        rest.x += BLOCK * rest.dx;
        rest.y += BLOCK * rest.dy;
        rest.to += 3 * BLOCK;
    }
    gsn_colour_row_sse4(&rest);
}
