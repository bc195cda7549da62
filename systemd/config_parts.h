/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The configuration while it is read; for the files of systemd/config.h alone. */
#ifndef GSN_SYSTEMD_CONFIG_PARTS_H
#define GSN_SYSTEMD_CONFIG_PARTS_H

#include "systemd/config.h"
#include "systemd/config_file.h"

#include <stdint.h>

#define GSN_MIB ((uint64_t)1 << 20)

enum {
    GSN_CONFIG_NAME = 64,   /* bytes of a source's name */
    GSN_FOLDER_SWEEP_S = 2, /* inotify is silent on SMB and NFS */
};

/* Where a source was told of, to name the line. */
struct gsn_config_seen {
    const struct gsn_config_line *heading, *address;
};

struct gsn_config_reading {
    struct gsn_config_lines lines;
    struct gsn_config *config;
    struct gsn_config_seen *seen; /* one per source */
};

/* config.c */

int gsn_config_no_memory(struct gsn_error *err);
int gsn_config_set_text(char **to, const char *value, struct gsn_error *err);

/* config_take.c: what line number i says goes into the configuration; mistakes are told. Fails with
 * GSN_E_NOMEM. */
int gsn_config_take_line(struct gsn_config_reading *reading, size_t i, struct gsn_error *err);

/* config_judge.c: whether source number i is what its kind understands; mistakes are told. */
void gsn_config_judge_source(struct gsn_config_reading *reading, size_t i);

/* config_source.c: one more source, with what holds where nothing is said. It stays in the
 * configuration on failure too. Fails with GSN_E_NOMEM. */
int gsn_config_new_source(struct gsn_config *config, const char *name,
                          struct gsn_config_source **ret_source, struct gsn_error *err);

#endif
