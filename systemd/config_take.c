/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/config_parts.h"

#include <ctype.h>
#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void wrong(struct gsn_config_reading *reading, const struct gsn_config_line *line,
                  const char *what)
{
    gsn_config_mistake(&reading->lines, line->file, line->number, "%s=%.80s: %s", line->key,
                       line->value, what);
}

/* A whole number from least to most; 0 and a mistake when it is none. */
static bool read_number(struct gsn_config_reading *reading, const struct gsn_config_line *line,
                        int64_t least, int64_t most, int64_t *to)
{
    char *end = NULL;
    char sentence[120];
    long long value;

    errno = 0;
    value = strtoll(line->value, &end, 10);
    if (isdigit((unsigned char)line->value[0]) && !*end && errno == 0 && value >= least &&
        value <= most) {
        *to = value;
        return true;
    }
    (void)snprintf(sentence, sizeof sentence, "must be a whole number from %lld to %lld",
                   (long long)least, (long long)most);
    wrong(reading, line, sentence);
    return false;
}

static void read_yes_no(struct gsn_config_reading *reading, const struct gsn_config_line *line,
                        int *to)
{
    if (strcmp(line->value, "yes") == 0)
        *to = 1;
    else if (strcmp(line->value, "no") == 0)
        *to = 0;
    else
        wrong(reading, line, "must be yes or no");
}

static int take_store(struct gsn_config_reading *reading, const struct gsn_config_line *line,
                      struct gsn_error *err)
{
    int64_t number;

    if (strcmp(line->key, "Directory") == 0) {
        if (line->value[0] == '/')
            return gsn_config_set_text(&reading->config->store_dir, line->value, err);
        wrong(reading, line, "must be a path that begins with /");
    } else if (strcmp(line->key, "ReserveMiB") == 0) {
        if (read_number(reading, line, 0, 1 << 30, &number))
            reading->config->reserve_bytes = (uint64_t)number * GSN_MIB;
    } else {
        wrong(reading, line, "[store] has no such key; it has Directory and ReserveMiB");
    }
    return GSN_OK;
}

static int take_work(struct gsn_config_reading *reading, const struct gsn_config_line *line)
{
    const struct {
        const char *key;
        int64_t least, most;
        unsigned *to;
    } keys[] = { { "Workers", 1, 64, &reading->config->workers },
                 { "Threads", 0, 64, &reading->config->threads },
                 { "MemoryMiB", 0, 1 << 24, &reading->config->memory_mib },
                 { "TimeMinutes", 1, 10080, &reading->config->minutes } };
    int64_t number;

    for (size_t i = 0; i < sizeof keys / sizeof keys[0]; i++) {
        if (strcmp(line->key, keys[i].key) != 0)
            continue;
        if (read_number(reading, line, keys[i].least, keys[i].most, &number))
            *keys[i].to = (unsigned)number;
        return GSN_OK;
    }
    wrong(reading, line,
          "[work] has no such key; it has Workers, Threads, MemoryMiB and TimeMinutes");
    return GSN_OK;
}

static bool is_name(const char *name)
{
    const size_t length = strlen(name);

    for (size_t i = 0; i < length; i++)
        if (!isalnum((unsigned char)name[i]) && !strchr("-_.", name[i]))
            return false;
    return length > 0 && length <= GSN_CONFIG_NAME && name[0] != '.' && name[0] != '-';
}

/* The source of a section "source NAME"; NULL when that is a mistake, told at its heading. */
static int find_source(struct gsn_config_reading *reading, const struct gsn_config_line *line,
                       struct gsn_config_source **ret_source, struct gsn_error *err)
{
    const char *const name = line->section + strlen("source ");
    struct gsn_config_source *source = NULL;
    struct gsn_config_seen *seen;
    int r;

    *ret_source = NULL;
    if (!is_name(name)) {
        if (!line->key)
            gsn_config_mistake(&reading->lines, line->file, line->number,
                               "[%.80s]: a source's name is made of letters, digits, - _ and ., at "
                               "most %d",
                               line->section, GSN_CONFIG_NAME);
        return GSN_OK;
    }
    *ret_source = (struct gsn_config_source *)gsn_config_find(reading->config, name);
    if (*ret_source)
        return GSN_OK;
    r = gsn_config_new_source(reading->config, name, &source, err);
    if (r < 0)
        return r;
    seen = gsn_realloc_array(reading->seen, reading->config->source_count, sizeof *seen);
    if (!seen)
        return gsn_config_no_memory(err);
    reading->seen = seen;
    seen[reading->config->source_count - 1] = (struct gsn_config_seen){ .heading = line };
    *ret_source = source;
    return GSN_OK;
}

/* What the table of kinds will judge, once all files are read. */
static int keep_setting(struct gsn_config_source *source, const struct gsn_config_line *line,
                        struct gsn_error *err)
{
    struct gsn_source_setting *at;
    gsn_auto_mem(char) key = gsn_strdup(line->key);
    gsn_auto_mem(char) value = gsn_strdup(line->value);

    if (!key || !value)
        return gsn_config_no_memory(err);
    for (size_t i = 0; i < source->setting_count; i++) {
        if (strcmp(source->setting[i].key, key) != 0)
            continue;
        gsn_free((char *)source->setting[i].value);
        source->setting[i].value = gsn_steal(&value);
        return GSN_OK;
    }
    at = gsn_realloc_array(source->setting, source->setting_count + 1, sizeof *at);
    if (!at)
        return gsn_config_no_memory(err);
    source->setting = at;
    at[source->setting_count++] = (struct gsn_source_setting){ gsn_steal(&key), gsn_steal(&value) };
    return GSN_OK;
}

static int take_source(struct gsn_config_reading *reading, const struct gsn_config_line *line,
                       struct gsn_error *err)
{
    struct gsn_config_source *source;
    const int r = find_source(reading, line, &source, err);

    if (r < 0 || !source || !line->key)
        return r;
    if (strcmp(line->key, "Address") == 0) {
        reading->seen[source - reading->config->source].address = line;
        return gsn_config_set_text(&source->address, line->value, err);
    }
    if (strcmp(line->key, "Specimen") == 0)
        return gsn_config_set_text(&source->specimen, line->value, err);
    if (strcmp(line->key, "SettleMs") == 0)
        (void)read_number(reading, line, 0, 600000, &source->settle_ms);
    else if (strcmp(line->key, "PatienceS") == 0)
        (void)read_number(reading, line, 1, 86400, &source->patience_s);
    else if (strcmp(line->key, "SweepS") == 0)
        (void)read_number(reading, line, 1, 3600, &source->sweep_s);
    else if (strcmp(line->key, "DeleteAfterCopy") == 0)
        read_yes_no(reading, line, &source->delete_after_copy);
    else
        return keep_setting(source, line, err);
    return GSN_OK;
}

/* Two values for one key in one file: one of them was not meant. */
static void check_once(struct gsn_config_reading *reading, size_t i)
{
    const struct gsn_config_line *const line = &reading->lines.at[i];

    for (size_t k = 0; k < i; k++) {
        const struct gsn_config_line *const other = &reading->lines.at[k];

        if (other->key && strcmp(other->file, line->file) == 0 &&
            strcmp(other->section, line->section) == 0 && strcmp(other->key, line->key) == 0) {
            gsn_config_mistake(&reading->lines, line->file, line->number,
                               "%s stands in [%.80s] already, in line %u", line->key, line->section,
                               other->number);
            return;
        }
    }
}

int gsn_config_take_line(struct gsn_config_reading *reading, size_t i, struct gsn_error *err)
{
    const struct gsn_config_line *const line = &reading->lines.at[i];

    if (line->key)
        check_once(reading, i);
    if (strncmp(line->section, "source ", strlen("source ")) == 0)
        return take_source(reading, line, err);
    if (!line->section[0]) {
        gsn_config_mistake(&reading->lines, line->file, line->number,
                           "%s stands before the first [section]", line->key);
        return GSN_OK;
    }
    if (strcmp(line->section, "store") == 0)
        return line->key ? take_store(reading, line, err) : GSN_OK;
    if (strcmp(line->section, "work") == 0)
        return line->key ? take_work(reading, line) : GSN_OK;
    if (!line->key)
        gsn_config_mistake(
            &reading->lines, line->file, line->number,
            "there is no section [%.80s]; there are [store], [work] and [source NAME]",
            line->section);
    return GSN_OK;
}
