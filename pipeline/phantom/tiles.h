/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* tiles.bin, embedded by embed.cmake: T1 (180 x 170) and then T2 (300 x 430), one signed byte per
 * texel, row by row, 40 steps to one standard deviation. README.md says where they come from. */
#ifndef GSN_PHANTOM_TILES_H
#define GSN_PHANTOM_TILES_H

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

enum { GSN_PHANTOM_TILES_SIZE = 159600 };

extern const int8_t gsn_phantom_tiles[GSN_PHANTOM_TILES_SIZE];

#ifdef __cplusplus
}
#endif
#endif
