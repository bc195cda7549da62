/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* Which disks a power cut may leave, and one of them at random.
 *
 * The model is as bad as a disk under ext4 may get, and in places worse:
 *
 *   Bytes. A file's writes and changes of size up to its last completed sync are on the disk.
 *   Of later ones any may be, whole or in part: each 512-byte sector of each write by itself,
 *   in any order. The size is that of any moment since the sync, whatever became of the bytes:
 *   sectors that were not written read as zeros. A call that was running at the cut counts as a
 *   later one.
 *
 *   Names. What was made, renamed or removed in a directory before its last completed sync is so on
 *   the disk. A sync of the file itself does not make its name durable (on ext4 it does). Later
 *   changes: by a journal, all up to some moment and none after it; or each directory up to a
 * moment of its own; or each change by itself, so that a rename may leave both names or none.
 *
 *   Files written through memory (SQLite's index of its log) hold anything.
 *
 * Not in the model: sectors that read as garbage or fail, a disk that lies about its flush. */
#ifndef GSN_TESTS_POWER_DISK_H
#define GSN_TESTS_POWER_DISK_H

#include "tests/power/trace.h"

struct power_disk;

/* keeps trace. */
struct power_disk *power_disk_new(const struct power_trace *trace);
void power_disk_free(struct power_disk *disk);

/* Makes, in the existing directory dir, the disk after a cut at this step: those before it came
 * back, it was running. The same seed is the same disk. */
void power_disk_make(const struct power_disk *disk, size_t cut, uint64_t seed, const char *dir);
/* Makes the disk of a program that ended in peace, with everything as it was last. */
void power_disk_make_all(const struct power_disk *disk, const char *dir);

#endif
