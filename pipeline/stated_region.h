/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What job.json says of regions: a mask file, a shape, or a band about a body. */
#ifndef GSN_PIPELINE_STATED_REGION_H
#define GSN_PIPELINE_STATED_REGION_H

#include "pipeline/region.h"

#ifdef __cplusplus
extern "C" {
#endif

struct json_t;

/* Reads a shape out of an object; key: what the sentence calls it. Fails with GSN_E_INPUT. */
int gsn_stated_shape_read(const struct json_t *shape_of, const char *key, struct gsn_region *region,
                          struct gsn_error *err);
/* Reads the key "region" of a job; region is left alone when it is absent. gives:
 * region->file. Fails with GSN_E_INPUT, GSN_E_NOMEM. */
int gsn_stated_region_read(const struct json_t *job, struct gsn_region *region,
                           struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
