/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What is in a watched folder and what became of it from look to look. Private to the folder
 * source. */
#ifndef GSN_ACQUIRE_FOLDER_LOOK_H
#define GSN_ACQUIRE_FOLDER_LOOK_H

#include "acquire/source.h"

#include <stdbool.h>
#include <stdint.h>
#include <sys/types.h>
#include <time.h>

/* What must not change while a file settles. */
struct gsn_folder_stamp {
    dev_t device;
    ino_t inode;
    off_t size;
    struct timespec modified, changed;
};

enum gsn_folder_state {
    GSN_FILE_WAITING,
    GSN_FILE_READY,
    GSN_FILE_DONE,    /* acknowledged */
    GSN_FILE_SKIPPED, /* not for us, as long as it does not change */
    GSN_FILE_BARRED,  /* cannot be had as it is; tried again at every look */
    GSN_FILE_HIDDEN,  /* the name of a transfer, until it has kept still for long */
};

struct gsn_folder_file {
    char *name;
    uint64_t item;
    struct gsn_folder_stamp stamp;
    char key[128];  /* the stamp as a text; empty for what is no regular file or has no date */
    bool unsettled; /* the stamp is worth nothing: the file changed under a reader */
    int64_t since_ms;
    enum gsn_folder_state state;
    bool incomplete, present;
    bool told;                     /* what the reason says was told, or need not be */
    char reason[480], action[480]; /* action: where a person has to do something, else empty */
};

struct gsn_folder {
    char *dir;
    struct gsn_source_options options;
    int64_t settle_ms;   /* of the options, or what the file system needs */
    int inotify, watch;  /* -1: nobody tells us of changes */
    bool replay, listed; /* listed: the first look is over */
    uint64_t last_item;
    size_t count, room;
    struct gsn_folder_file *at; /* in natural order of names */
};

/* Looks at everything once: what is new, what changed, what kept still and is whole. */
int gsn_folder_look(struct gsn_folder *folder, int64_t now_ms, struct gsn_error *err);

/* A reason is told once, and again when it becomes another. */
void gsn_folder_set_state(struct gsn_folder_file *file, enum gsn_folder_state state,
                          const char *reason);

int gsn_folder_open_file(const struct gsn_folder *folder, const struct gsn_folder_file *file,
                         int *ret_fd, struct gsn_error *err);
/* Whether the open file is still the one that was told. */
bool gsn_folder_is_as_told(int fd, const struct gsn_folder_file *file);

#endif
