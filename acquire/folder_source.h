/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* A folder as a source: the honest interface of most slide scanners.
 *
 * A file is ready when two looks agree on its size, mtime and ctime and its container is whole.
 * Sub-folders and files that neither look nor are called like a picture are not delivered and get
 * one notice. A link, a file that may not or cannot be read, and a picture that keeps the name of a
 * transfer (a dot in front, ".part" behind) are barred: each is told with what to do, tried again
 * at every look, and stands in no other file's way.
 *
 * Waiting ends early when the kernel tells of a file that began, was closed or moved here. It does
 * not tell of what other machines do on a network share, so the caller's timeout decides there. */
#ifndef GSN_ACQUIRE_FOLDER_SOURCE_H
#define GSN_ACQUIRE_FOLDER_SOURCE_H

#include "acquire/source.h"

#ifdef __cplusplus
extern "C" {
#endif

/* How long a file in dir must keep still, where settle_ms is what was asked for. On a file system
 * that asks another machine (NFS, SMB, FUSE) sizes and times may be some seconds old: nfs(5) caches
 * those of a file that changes for acregmin = 3 s, so there it is twice that at least. */
int64_t gsn_folder_settle_ms(const char *dir, int64_t settle_ms);
/* The same by the file system's magic number, as statfs(2) gives it. */
int64_t gsn_folder_settle_on(long type, int64_t settle_ms);

extern const struct gsn_source_ops gsn_hot_folder_ops;    /* "hot:DIR" */
extern const struct gsn_source_ops gsn_replay_folder_ops; /* "replay:DIR" */

#ifdef __cplusplus
}
#endif
#endif
