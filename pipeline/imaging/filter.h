/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Linear filters of float planes. */
#ifndef GSN_IMAGING_FILTER_H
#define GSN_IMAGING_FILTER_H

#include "pipeline/core/image.h"

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the mean over (2 radius + 1)^2 pixels, fewer at the border. No value may be NaN. */
int gsn_box_mean(const struct gsn_plane *plane, uint32_t radius, struct gsn_plane **ret_mean,
                 struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
