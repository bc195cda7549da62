/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The lines of the configuration's files, before anybody judges what they mean; for the files of
 * systemd/config.h alone. */
#ifndef GSN_SYSTEMD_CONFIG_FILE_H
#define GSN_SYSTEMD_CONFIG_FILE_H

#include "pipeline/core/error.h"
#include "systemd/config.h"

#include <stddef.h>

/* One "Key=Value", or, with key NULL, the "[section]" itself. */
struct gsn_config_line {
    const char *file; /* borrowed from the list */
    unsigned number;
    char *section, *key, *value;
};

struct gsn_config_lines {
    size_t count, file_count;
    struct gsn_config_line *at;
    char **file;
    const struct gsn_config_ear *ear;
    size_t mistakes;
    char first[400]; /* the first mistake's sentence */
};

/* Reads path and conf.d beside it; what is no line at all is told as a mistake.
 * Fails with GSN_E_NOMEM. The list is to be freed in any case. */
int gsn_config_lines_read(const char *path, struct gsn_config_lines *lines, struct gsn_error *err);
void gsn_config_lines_done(struct gsn_config_lines *lines);

/* Counts a mistake and tells it. */
void gsn_config_mistake(struct gsn_config_lines *lines, const char *file, unsigned number,
                        const char *format, ...) __attribute__((format(printf, 4, 5)));

#endif
