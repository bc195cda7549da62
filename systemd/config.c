/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/config.h"

#include <ctype.h>
#include <errno.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "systemd/config_file.h"

enum {
    SETTLE_MS = 1500,
    PATIENCE_S = 60,
    FOLDER_SWEEP_S = 2, /* inotify is silent on SMB and NFS */
    DEVICE_SWEEP_S = 10,
    MOST_NAME = 64,
    MOST_FOLDER = 180,
};
static const uint64_t MiB = (uint64_t)1 << 20;

/* Where a source was told of, to name the line. */
struct seen {
    const struct gsn_config_line *heading, *address;
};

struct reading {
    struct gsn_config_lines lines;
    struct gsn_config *config;
    struct seen *seen; /* one per source */
};

static void source_done(struct gsn_config_source *source)
{
    for (size_t i = 0; i < source->setting_count; i++) {
        gsn_free((char *)source->setting[i].key);
        gsn_free((char *)source->setting[i].value);
    }
    gsn_free(source->setting);
    gsn_free(source->name);
    gsn_free(source->address);
    gsn_free(source->specimen);
}

void gsn_config_free(struct gsn_config *config)
{
    if (!config)
        return;
    for (size_t i = 0; i < config->source_count; i++)
        source_done(&config->source[i]);
    gsn_free(config->source);
    gsn_free(config->store_dir);
    gsn_free(config);
}

static int out_of_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the configuration");
}

static int set_text(char **to, const char *value, struct gsn_error *err)
{
    char *const copy = gsn_strdup(value);

    if (!copy)
        return out_of_memory(err);
    gsn_free(*to);
    *to = copy;
    return GSN_OK;
}

const struct gsn_config_source *gsn_config_find(const struct gsn_config *config, const char *name)
{
    for (size_t i = 0; i < config->source_count; i++)
        if (strcmp(config->source[i].name, name) == 0)
            return &config->source[i];
    return NULL;
}

/* ---- values ------------------------------------------------------------------------------ */

static void wrong(struct reading *reading, const struct gsn_config_line *line, const char *what)
{
    gsn_config_mistake(&reading->lines, line->file, line->number, "%s=%.80s: %s", line->key,
                       line->value, what);
}

/* A whole number from least to most; 0 and a mistake when it is none. */
static bool read_number(struct reading *reading, const struct gsn_config_line *line, int64_t least,
                        int64_t most, int64_t *to)
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

static void read_yes_no(struct reading *reading, const struct gsn_config_line *line, int *to)
{
    if (strcmp(line->value, "yes") == 0)
        *to = 1;
    else if (strcmp(line->value, "no") == 0)
        *to = 0;
    else
        wrong(reading, line, "must be yes or no");
}

/* ---- [store] and [work] ------------------------------------------------------------------ */

static int take_store(struct reading *reading, const struct gsn_config_line *line,
                      struct gsn_error *err)
{
    int64_t number;

    if (strcmp(line->key, "Directory") == 0) {
        if (line->value[0] == '/')
            return set_text(&reading->config->store_dir, line->value, err);
        wrong(reading, line, "must be a path that begins with /");
    } else if (strcmp(line->key, "ReserveMiB") == 0) {
        if (read_number(reading, line, 0, 1 << 30, &number))
            reading->config->reserve_bytes = (uint64_t)number * MiB;
    } else {
        wrong(reading, line, "[store] has no such key; it has Directory and ReserveMiB");
    }
    return GSN_OK;
}

static int take_work(struct reading *reading, const struct gsn_config_line *line)
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

/* ---- [source NAME] ----------------------------------------------------------------------- */

static bool is_name(const char *name)
{
    const size_t length = strlen(name);

    for (size_t i = 0; i < length; i++)
        if (!isalnum((unsigned char)name[i]) && !strchr("-_.", name[i]))
            return false;
    return length > 0 && length <= MOST_NAME && name[0] != '.' && name[0] != '-';
}

static int new_source(struct gsn_config *config, const char *name,
                      struct gsn_config_source **ret_source, struct gsn_error *err)
{
    struct gsn_config_source *more =
        gsn_realloc_array(config->source, config->source_count + 1, sizeof *more);
    struct gsn_config_source *source;

    if (!more)
        return out_of_memory(err);
    config->source = more;
    source = &more[config->source_count];
    *source = (struct gsn_config_source){ .name = gsn_strdup(name),
                                          .address = gsn_strdup(""),
                                          .specimen = gsn_strdup(""),
                                          .settle_ms = SETTLE_MS,
                                          .patience_s = PATIENCE_S };
    config->source_count++;
    if (!source->name || !source->address || !source->specimen)
        return out_of_memory(err);
    *ret_source = source;
    return GSN_OK;
}

/* The source of a section "source NAME"; NULL when that is a mistake, told at its heading. */
static int find_source(struct reading *reading, const struct gsn_config_line *line,
                       struct gsn_config_source **ret_source, struct gsn_error *err)
{
    const char *const name = line->section + strlen("source ");
    struct gsn_config_source *source = NULL;
    struct seen *seen;
    int r;

    *ret_source = NULL;
    if (!is_name(name)) {
        if (!line->key)
            gsn_config_mistake(&reading->lines, line->file, line->number,
                               "[%.80s]: a source's name is made of letters, digits, - _ and ., at "
                               "most %d",
                               line->section, MOST_NAME);
        return GSN_OK;
    }
    *ret_source = (struct gsn_config_source *)gsn_config_find(reading->config, name);
    if (*ret_source)
        return GSN_OK;
    r = new_source(reading->config, name, &source, err);
    if (r < 0)
        return r;
    seen = gsn_realloc_array(reading->seen, reading->config->source_count, sizeof *seen);
    if (!seen)
        return out_of_memory(err);
    reading->seen = seen;
    seen[reading->config->source_count - 1] = (struct seen){ .heading = line };
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
        return out_of_memory(err);
    for (size_t i = 0; i < source->setting_count; i++) {
        if (strcmp(source->setting[i].key, key) != 0)
            continue;
        gsn_free((char *)source->setting[i].value);
        source->setting[i].value = gsn_steal(&value);
        return GSN_OK;
    }
    at = gsn_realloc_array(source->setting, source->setting_count + 1, sizeof *at);
    if (!at)
        return out_of_memory(err);
    source->setting = at;
    at[source->setting_count++] = (struct gsn_source_setting){ gsn_steal(&key), gsn_steal(&value) };
    return GSN_OK;
}

static int take_source(struct reading *reading, const struct gsn_config_line *line,
                       struct gsn_error *err)
{
    struct gsn_config_source *source;
    const int r = find_source(reading, line, &source, err);

    if (r < 0 || !source || !line->key)
        return r;
    if (strcmp(line->key, "Address") == 0) {
        reading->seen[source - reading->config->source].address = line;
        return set_text(&source->address, line->value, err);
    }
    if (strcmp(line->key, "Specimen") == 0)
        return set_text(&source->specimen, line->value, err);
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

/* ---- judgement of the whole -------------------------------------------------------------- */

/* Two values for one key in one file: one of them was not meant. */
static void check_once(struct reading *reading, size_t i)
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

static int take_line(struct reading *reading, size_t i, struct gsn_error *err)
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

static int judge_settings(const struct gsn_config_source *source, size_t from, size_t count,
                          struct gsn_error *err)
{
    const struct gsn_source_options options = { .settle_ms = source->settle_ms,
                                                .patience_ms = source->patience_s * 1000,
                                                .delete_there = source->delete_after_copy,
                                                .setting_count = count,
                                                .setting = source->setting + from };

    return gsn_source_check(source->address, &options, err);
}

static const struct gsn_config_line *
line_of(const struct reading *reading, const struct gsn_config_source *source, const char *key)
{
    for (size_t i = reading->lines.count; i-- > 0;) {
        const struct gsn_config_line *const line = &reading->lines.at[i];

        if (line->key && strcmp(line->key, key) == 0 &&
            strncmp(line->section, "source ", strlen("source ")) == 0 &&
            strcmp(line->section + strlen("source "), source->name) == 0)
            return line;
    }
    return NULL;
}

/* Whether the sentence is about this setting: they begin with "Key=value". */
static bool is_about(const char *sentence, const char *key)
{
    const size_t length = strlen(key);

    return strncmp(sentence, key, length) == 0 && sentence[length] == '=';
}

/* Names the line of every setting that is wrong: of one that is wrong by itself, and of the one
 * that `whole` is about. What is said of no setting at all, `none`, is no setting's fault (a camera
 * needs several at once). True when there was one. */
static bool blame_settings(struct reading *reading, const struct gsn_config_source *source,
                           const char *none, const char *whole)
{
    bool blamed = false;

    for (size_t i = 0; i < source->setting_count; i++) {
        const char *const key = source->setting[i].key;
        const struct gsn_config_line *const line = line_of(reading, source, key);
        const char *sentence = whole;
        struct gsn_error why = { 0 };

        if (judge_settings(source, i, 1, &why) < 0 && strcmp(why.text, none) != 0)
            sentence = why.text;
        else if (!is_about(whole, key))
            continue;
        if (!line)
            continue;
        gsn_config_mistake(&reading->lines, line->file, line->number, "%.380s", sentence);
        blamed = true;
    }
    return blamed;
}

static void judge_source(struct reading *reading, size_t i)
{
    struct gsn_config_source *const source = &reading->config->source[i];
    const struct seen *const seen = &reading->seen[i];
    struct gsn_error none = { 0 }, whole = { 0 };

    if (source->sweep_s == 0)
        source->sweep_s = gsn_source_subsystem(source->address) ? DEVICE_SWEEP_S : FOLDER_SWEEP_S;
    if (!seen->address) {
        gsn_config_mistake(&reading->lines, seen->heading->file, seen->heading->number,
                           "[source %s] has no Address", source->name);
        return;
    }
    if (judge_settings(source, 0, source->setting_count, &whole) >= 0)
        return;
    (void)judge_settings(source, 0, 0, &none);
    if (strcmp(none.text, whole.text) == 0)
        gsn_config_mistake(&reading->lines, seen->address->file, seen->address->number, "%.380s",
                           whole.text);
    else if (!blame_settings(reading, source, none.text, whole.text))
        gsn_config_mistake(&reading->lines, seen->heading->file, seen->heading->number,
                           "[source %s]: %.300s", source->name, whole.text);
}

static int judge(struct reading *reading, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < reading->lines.count; i++)
        r = take_line(reading, i, err);
    if (r < 0)
        return r;
    for (size_t i = 0; i < reading->config->source_count; i++)
        judge_source(reading, i);
    if (reading->lines.mistakes == 0)
        return GSN_OK;
    return gsn_fail(err, GSN_E_INPUT, "the configuration has %zu mistake%s: %.390s",
                    reading->lines.mistakes, reading->lines.mistakes == 1 ? "" : "s",
                    reading->lines.first);
}

static void reading_done(struct reading *reading)
{
    gsn_config_lines_done(&reading->lines);
    gsn_config_free(reading->config);
    gsn_free(reading->seen);
}

int gsn_config_read(const char *path, const struct gsn_config_ear *ear,
                    struct gsn_config **ret_config, struct gsn_error *err)
{
    __attribute__((cleanup(reading_done))) struct reading reading = { .lines = { .ear = ear } };
    int r;

    reading.config = gsn_alloc_array(1, sizeof *reading.config);
    if (!reading.config)
        return out_of_memory(err);
    *reading.config = (struct gsn_config){ .store_dir = gsn_strdup(""),
                                           .reserve_bytes = 256 * MiB,
                                           .workers = 1,
                                           .memory_mib = 8192,
                                           .minutes = 120 };
    if (!reading.config->store_dir)
        return out_of_memory(err);
    r = gsn_config_lines_read(path, &reading.lines, err);
    if (r >= 0)
        r = judge(&reading, err);
    if (r < 0)
        return r;
    *ret_config = gsn_steal(&reading.config);
    return GSN_OK;
}

/* ---- sources that have no section, and sources as text ------------------------------------ */

/* The folder's own name, with what no source's name may hold made '-'. */
static void name_of_folder(const char *folder, unsigned number, char name[MOST_NAME + 1])
{
    size_t end = strlen(folder), begin, length = 0;

    while (end > 1 && folder[end - 1] == '/')
        end--;
    for (begin = end; begin > 0 && folder[begin - 1] != '/';)
        begin--;
    for (size_t i = begin; i < end && length < MOST_NAME - 8; i++)
        name[length++] = folder[i];
    name[length] = '\0';
    for (size_t i = 0; i < length; i++)
        if (!isalnum((unsigned char)name[i]) && (!strchr("-_.", name[i]) || i == 0))
            name[i] = '_';
    if (length == 0)
        length = (size_t)snprintf(name, MOST_NAME, "folder");
    if (number > 1)
        (void)snprintf(name + length, MOST_NAME - length, "-%u", number);
}

int gsn_config_add_folder(struct gsn_config *config, const char *folder, struct gsn_error *err)
{
    char name[MOST_NAME + 1];
    gsn_auto_mem(char) address = gsn_format("hot:%s", folder);
    struct gsn_config_source *source;
    unsigned number = 1;
    int r;

    if (!address)
        return out_of_memory(err);
    /* What is written for the source's own process must be read back as it is. */
    if (strlen(folder) > MOST_FOLDER || strchr(folder, '\n') || strstr(folder, " ;"))
        return gsn_fail(err, GSN_E_INPUT,
                        "%.200s cannot be watched: a path of at most %d bytes without line breaks "
                        "and \" ;\" can",
                        folder, MOST_FOLDER);
    name_of_folder(folder, number, name);
    while (gsn_config_find(config, name))
        name_of_folder(folder, ++number, name);
    r = new_source(config, name, &source, err);
    if (r < 0)
        return r;
    source->sweep_s = FOLDER_SWEEP_S;
    return set_text(&source->address, address, err);
}

int gsn_config_write_source(const struct gsn_config *config, const struct gsn_config_source *source,
                            char **ret_text, struct gsn_error *err)
{
    gsn_auto_mem(char) text = gsn_format(
        "[store]\nReserveMiB=%llu\n[source %s]\nAddress=%s\nSettleMs=%lld\nPatienceS=%lld\n"
        "SweepS=%lld\nDeleteAfterCopy=%s\nSpecimen=%s\n",
        (unsigned long long)(config->reserve_bytes / MiB), source->name, source->address,
        (long long)source->settle_ms, (long long)source->patience_s, (long long)source->sweep_s,
        source->delete_after_copy ? "yes" : "no", source->specimen);

    for (size_t i = 0; text && i < source->setting_count; i++) {
        char *const more =
            gsn_format("%s%s=%s\n", text, source->setting[i].key, source->setting[i].value);

        gsn_free(text);
        text = more;
    }
    if (!text)
        return out_of_memory(err);
    *ret_text = gsn_steal(&text);
    return GSN_OK;
}
