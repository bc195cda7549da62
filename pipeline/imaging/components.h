/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Connected components of a set of pixels, with box, area, centre, axes and the list of pixels. */
#ifndef GSN_IMAGING_COMPONENTS_H
#define GSN_IMAGING_COMPONENTS_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct gsn_component {
    int x, y, width, height; /* box */
    size_t first, area;      /* its pixels in the list, and how many */
    double cx, cy;           /* centre of area, pixel centres at +0.5 */
    double length, breadth;  /* 4 standard deviations along and across its axis, in pixels */
    double along_x, along_y; /* unit vector of that axis */
};

struct gsn_components {
    uint32_t width; /* of the set's rows */
    size_t count;
    struct gsn_component *component;
    uint32_t *pixel; /* indices of pixels, component by component, each from top left on */
};

void gsn_components_free(struct gsn_components *components);
GSN_DEFINE_AUTO(gsn_components);

/* gives: what hangs together over 8 neighbours where set (width * height bytes) is not 0, in the
 * order in which the first pixels come. Fails with GSN_E_NOMEM. */
int gsn_components_find(const uint8_t *set, uint32_t width, uint32_t height,
                        struct gsn_components **ret_components, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
