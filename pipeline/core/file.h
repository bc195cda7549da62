/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Whole files: read with a limit, written so that a power cut leaves the old file or the new one.
 * (file.c is the one door to open().) */
#ifndef GSN_CORE_FILE_H
#define GSN_CORE_FILE_H

#include "pipeline/core/error.h"
#include "pipeline/core/mem.h"

#include <dirent.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

/* gives: the content and one zero byte behind it, not counted in size.
 * Fails with GSN_E_NOTFOUND, GSN_E_IO, GSN_E_INPUT (a directory, a device, a pipe), or GSN_E_LIMIT
 * (checked before anything is allocated). */
int gsn_file_read(const char *path, size_t limit, uint8_t **ret_bytes, size_t *ret_size,
                  struct gsn_error *err);

/* temp file beside it -> fsync -> rename -> fsync of the directory. */
int gsn_file_write(const char *path, const void *bytes, size_t size, struct gsn_error *err);

/* For those who read a large file in pieces. gives: a descriptor to close(); what it stands for
 * (a directory, a device) is for the caller to check. Fails with GSN_E_NOTFOUND, GSN_E_IO. */
int gsn_file_open(const char *path, int *ret_fd, struct gsn_error *err);

/* A regular file in a folder that others write to, and never one outside of it: no part of name is
 * a link or "..". This is the way in for everything that lies in a scan folder. gives: a descriptor
 * to close().
 *
 * Fails with GSN_E_NOTFOUND; GSN_E_INPUT for what is refused as it is (a link, a directory, a
 * device, a name that leads elsewhere); GSN_E_DENIED when this user may not read it; GSN_E_IO. The
 * sentence names the file and why, without the folder. */
int gsn_file_open_in(const char *folder, const char *name, int *ret_fd, struct gsn_error *err);

/* For a descriptor on the stack: closed when it goes out of scope; -1: none. */
void gsn_fd_close(int *fd);
#define gsn_auto_fd __attribute__((cleanup(gsn_fd_close))) int

/* For an open folder on the stack, in the same way; NULL: none. */
void gsn_dir_close(DIR **dir);
#define gsn_auto_dir __attribute__((cleanup(gsn_dir_close))) DIR *

/* The content of an open regular file, wherever its position is, as gsn_file_read() gives it. name:
 * for the sentence. */
int gsn_file_read_open(int fd, const char *name, size_t limit, uint8_t **ret_bytes,
                       size_t *ret_size, struct gsn_error *err);

/* A file to be locked, made when it is missing. gives: a descriptor to close(). Fails with
 * GSN_E_IO. */
int gsn_file_open_lock(const char *path, int *ret_fd, struct gsn_error *err);

/* The same, to go on writing a file that exists. */
int gsn_file_reopen(const char *path, int *ret_fd, struct gsn_error *err);

/* Until the file's bytes are on the disk; a signal in between does not end it. */
int gsn_file_sync(int fd, const char *path, struct gsn_error *err);

/* After this the names in the directory survive a power cut. */
int gsn_file_sync_dir(const char *dir, struct gsn_error *err);

/* Makes a directory and its parents, each durable before the next; one that exists is fine. Fails
 * with GSN_E_IO, also when a file has that name. */
int gsn_file_mkdir(const char *path, struct gsn_error *err);

#ifdef __cplusplus
}
#endif
#endif
