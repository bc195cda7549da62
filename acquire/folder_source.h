/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A folder as a source: the honest interface of most slide scanners.
 *
 * A file is ready when two looks agree on its size, mtime and ctime and its container is whole.
 * Sub-folders, names that begin with a dot (transfers under way) and files that neither look nor
 * are called like a picture are not delivered; all but the dot names and job.json get one notice.
 */
#ifndef GSN_ACQUIRE_FOLDER_SOURCE_H
#define GSN_ACQUIRE_FOLDER_SOURCE_H

#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const struct gsn_source_ops gsn_hot_folder_ops;    /* "hot:DIR" */
extern const struct gsn_source_ops gsn_replay_folder_ops; /* "replay:DIR" */

/* Natural order: runs of digits compare as numbers of any length, the rest as bytes; names that
 * are equal so far (1, 01) fall back to bytes. Returns < 0, 0, > 0; 0 only for equal names. */
int gsn_natural_compare(const char *a, const char *b);

/* Whether a file of this name is called like a picture ("P01.TIF"). */
int gsn_name_is_picture(const char *name);

#ifdef __cplusplus
}
#endif
#endif
