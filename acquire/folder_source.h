/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A folder as a source: the honest interface of most slide scanners.
 *
 * A file is ready when two looks agree on its size, mtime and ctime and its container is whole.
 * Sub-folders, names that begin with a dot (transfers under way) and files that neither look nor
 * are called like a picture are not delivered; all but the dot names and job.json get one notice.
 *
 * Waiting ends early when the kernel tells of a file that began, was closed or moved here. It does
 * not tell of what other machines do on a network share, so the caller's timeout decides there. */
#ifndef GSN_ACQUIRE_FOLDER_SOURCE_H
#define GSN_ACQUIRE_FOLDER_SOURCE_H

#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

extern const struct gsn_source_ops gsn_hot_folder_ops;    /* "hot:DIR" */
extern const struct gsn_source_ops gsn_replay_folder_ops; /* "replay:DIR" */

#ifdef __cplusplus
}
#endif
#endif
