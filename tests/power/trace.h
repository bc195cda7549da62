/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* What a program did to the files below one directory, call by call, with all bytes: written by the
 * recorder, which is loaded before the program's libraries, and read by the rebuilder.
 *
 *     GSN_POWER_ROOT=DIR GSN_POWER_TRACE=FILE LD_PRELOAD=libgsn_power_recorder.so PROGRAM
 *
 * A record stands in the trace after its call came back, so a sync in the trace is a sync that
 * ended. FILE must be outside of DIR. */
#ifndef GSN_TESTS_POWER_TRACE_H
#define GSN_TESTS_POWER_TRACE_H

#include <stddef.h>
#include <stdint.h>

enum power_op {
    POWER_CREATE, /* a new file: name, inode */
    POWER_MKDIR,
    POWER_UNLINK, /* a file or an empty directory */
    POWER_RENAME, /* name to other */
    POWER_LINK,
    POWER_WRITE, /* bytes at offset */
    POWER_SIZE,  /* cut or grown to offset bytes */
    POWER_MODE,
    POWER_SYNC,     /* a file */
    POWER_SYNC_DIR, /* name */
    POWER_MAPPED,   /* written through memory: its bytes are unknown from now on */
    POWER_MARK,     /* the program says something to the reader */
};

/* Followed by the bytes of name and other (below the root, without zeros) and the data. */
struct power_record {
    uint32_t op, mode;
    uint64_t inode, offset, data;
    uint32_t name, other;
};

/* What a program under the recorder calls; nothing without one. */
void power_mark(const char *text) __attribute__((weak));

/* A record in memory, its texts ended by zeros. */
struct power_step {
    enum power_op op;
    unsigned mode;
    uint64_t inode, offset, size;
    char *name, *other;
    const uint8_t *data; /* into the trace's bytes */
};

struct power_trace {
    size_t count;
    struct power_step *at;
    uint8_t *bytes;
};

/* Ends the program with a sentence when the file is no trace. */
struct power_trace power_trace_read(const char *path);
void power_trace_done(struct power_trace *trace);

#endif
