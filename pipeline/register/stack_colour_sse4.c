/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A pixel of three codes and its neighbour are six bytes in a row, so two loads bring all four
 * pixels of a voxel and two multiplications of pairs mix them. */
#include "pipeline/register/stack/resample_colour.h"

#include <smmintrin.h>

gsn_colour_row_run gsn_colour_row_sse4;

void gsn_colour_row_sse4(const struct gsn_colour_row *row)
{
    const uint8_t *samples = row->image->samples, *code = row->light->code;
    const size_t stride = 3 * (size_t)row->image->width;
    const __m128i pairs = _mm_setr_epi8(0, -1, 3, -1, 1, -1, 4, -1, 2, -1, 5, -1, -1, -1, -1, -1);
    int64_t x = row->x, y = row->y;
    uint8_t *to = row->to;

    for (size_t i = 0; i < row->count; i++, x += row->dx, y += row->dy, to += 3) {
        const uint8_t *upper = samples + (size_t)(y >> 32) * stride + 3 * (size_t)(x >> 32);
        const int tx = (int)(x >> 18 & 16383), ty = (int)(y >> 18 & 16383);
        const __m128i wx = _mm_set1_epi32(tx << 16 | (16384 - tx));
        const __m128i wy = _mm_set1_epi32(ty << 16 | (16384 - ty));
        const __m128i a = _mm_loadl_epi64((const __m128i *)(const void *)upper);
        const __m128i b = _mm_loadl_epi64((const __m128i *)(const void *)(upper + stride));
        const __m128i top = _mm_srli_epi32(_mm_madd_epi16(_mm_shuffle_epi8(a, pairs), wx), 7);
        const __m128i low = _mm_srli_epi32(_mm_madd_epi16(_mm_shuffle_epi8(b, pairs), wx), 7);
        const __m128i both = _mm_or_si128(top, _mm_slli_epi32(low, 16));
        const __m128i light = _mm_srli_epi32(_mm_madd_epi16(both, wy), 16);

        _mm_prefetch(upper + row->ahead, _MM_HINT_T0);
        to[0] = code[_mm_extract_epi16(light, 0)];
        to[1] = code[_mm_extract_epi16(light, 2)];
        to[2] = code[_mm_extract_epi16(light, 4)];
    }
}
