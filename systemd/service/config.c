/* SPDX-License-Identifier: AGPL-3.0-or-later */

/* The configuration of a bench: lines are read, applied, and judged; every mistake is told with its
 * line.
 *
 * Steps.
 * 1. Read: the file and the *.conf files of conf.d beside it, in order of their names (inih),
 * become a list of lines "[section] Key=Value" that know their file and number.
 * 2. Apply, line by line: each section has its keys with their ranges. Of a key that several files
 *    give, the last one counts; twice in one file is a mistake.
 * 3. Judge each source: its address and settings are held against the kind's own check
 *    (gsn_source_check), and what that refuses is blamed on the line it came from.
 * 4. One source is written as a text that reads back as this source alone: it is handed to its
 * process, and two equal texts mean that nothing changed for it.
 *
 * How it fails: GSN_E_INPUT after all mistakes were told, with their number and the first; nothing
 * is taken on trust, and a configuration with one mistake is not used at all. */
#include "systemd/service/config.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <ini.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/core/error.h"
#include "pipeline/core/file.h"
#include "pipeline/core/nearest.h"

/* One "Key=Value", or, with key NULL, the "[section]" itself. */
struct config_line {
    const char *file; /* borrowed from the list */
    unsigned number;
    char *section, *key, *value;
};

struct config_lines {
    size_t count, file_count;
    struct config_line *at;
    char **file;
    const struct gsn_config_ear *ear;
    size_t mistakes;
    char first[400]; /* the first mistake's sentence */
};

#define GSN_MIB ((uint64_t)1 << 20)

enum {
    NAME_BYTES = 64,    /* bytes of a source's name */
    FOLDER_SWEEP_S = 2, /* inotify is silent on SMB and NFS */
};

/* Where a source was told of, to name the line. */
struct seen_lines {
    const struct config_line *heading, *address;
};

struct config_reading {
    struct config_lines lines;
    struct gsn_config *config;
    struct seen_lines *seen; /* one per source */
};

enum {
    MOST_BYTES = 1 << 20,
    MOST_LINE = 196, /* inih cuts what is longer */
};

static int fail_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the configuration");
}

static int set_text(char **to, const char *value, struct gsn_error *err)
{
    char *const copy = gsn_strdup(value);

    if (!copy)
        return fail_memory(err);
    gsn_free(*to);
    *to = copy;
    return GSN_OK;
}

/* Counts a mistake and tells it. */
__attribute__((format(printf, 4, 5))) static void
note_mistake(struct config_lines *lines, const char *file, unsigned number, const char *format, ...)
{
    char sentence[sizeof lines->first], text[sizeof lines->first + 200];
    va_list arguments;

    va_start(arguments, format);
    (void)vsnprintf(sentence, sizeof sentence, format, arguments);
    va_end(arguments);
    if (number)
        (void)snprintf(text, sizeof text, "%.180s:%u: %s", file, number, sentence);
    else
        (void)snprintf(text, sizeof text, "%.180s: %s", file, sentence);
    if (lines->mistakes++ == 0)
        (void)snprintf(lines->first, sizeof lines->first, "%.399s", text);
    if (lines->ear && lines->ear->say)
        lines->ear->say(lines->ear->context, text);
}

static void line_done(struct config_line *line)
{
    gsn_free(line->section);
    gsn_free(line->key);
    gsn_free(line->value);
}

static void lines_done(struct config_lines *lines)
{
    for (size_t i = 0; i < lines->count; i++)
        line_done(&lines->at[i]);
    for (size_t i = 0; i < lines->file_count; i++)
        gsn_free(lines->file[i]);
    gsn_free(lines->at);
    gsn_free(lines->file);
}

/* Where the reader is. */
struct place {
    struct config_lines *lines;
    const char *file;
    unsigned number;
    char section[MOST_LINE + 1];
    bool is_lost; /* behind a wrong heading, whose keys nobody can judge */
    bool no_memory;
};

static int append_line(struct place *place, const char *key, const char *value)
{
    struct config_lines *const lines = place->lines;
    struct config_line line = { .file = place->file,
                                .number = place->number,
                                .section = gsn_strdup(place->section),
                                .key = key ? gsn_strdup(key) : NULL,
                                .value = value ? gsn_strdup(value) : NULL };
    struct config_line *at = gsn_realloc_array(lines->at, lines->count + 1, sizeof *lines->at);

    if (at)
        lines->at = at;
    if (!at || !line.section || (key && !line.key) || (value && !line.value)) {
        line_done(&line);
        place->no_memory = true;
        return 0;
    }
    at[lines->count++] = line;
    return 1;
}

/* inih calls this with what it made of one line. */
static int take_pair(void *user, const char *section, const char *name, const char *value)
{
    struct place *const place = user;

    (void)section; /* each line is read by itself: the section is ours to remember */
    if (!name[0])
        return 0;
    return append_line(place, name, value);
}

static void take_heading(struct place *place, const char *line, size_t length)
{
    place->is_lost = length <= 2 || line[length - 1] != ']';
    if (place->is_lost) {
        note_mistake(place->lines, place->file, place->number,
                     "a heading must be like [source NAME], on a line of its own");
        return;
    }
    (void)snprintf(place->section, sizeof place->section, "%.*s", (int)(length - 2), line + 1);
    (void)append_line(place, NULL, NULL);
}

static void take_line(struct place *place, const char *line, size_t length)
{
    char text[MOST_LINE + 1];

    while (length > 0 && isspace((unsigned char)line[length - 1]))
        length--;
    while (length > 0 && isspace((unsigned char)*line)) {
        line++;
        length--;
    }
    if (length == 0 || *line == '#' || *line == ';')
        return;
    if (length > MOST_LINE || memchr(line, '\0', length)) {
        note_mistake(place->lines, place->file, place->number,
                     length > MOST_LINE ? "the line is longer than %d bytes"
                                        : "the line holds a zero byte (of %d at most)",
                     MOST_LINE);
        return;
    }
    if (*line == '[') {
        take_heading(place, line, length);
        return;
    }
    if (place->is_lost)
        return;
    (void)snprintf(text, sizeof text, "%.*s", (int)length, line);
    if (!strchr(text, '=') || ini_parse_string(text, take_pair, place) != 0) {
        if (!place->no_memory)
            note_mistake(place->lines, place->file, place->number,
                         "\"%.60s\" is neither [section] nor Key=Value", text);
    }
}

static int read_text(struct place *place, const char *text, size_t size, struct gsn_error *err)
{
    static const char mark[] = "\xef\xbb\xbf"; /* some editors begin a file with it */
    const char *const end = text + size;

    if (size >= 3 && memcmp(text, mark, 3) == 0)
        text += 3;
    while (text < end && !place->no_memory) {
        const char *stop = memchr(text, '\n', (size_t)(end - text));

        stop = stop ? stop : end;
        place->number++;
        take_line(place, text, (size_t)(stop - text));
        text = stop + 1;
    }
    return place->no_memory ? fail_memory(err) : GSN_OK;
}

/* takes: path. */
static int keep_name(struct config_lines *lines, char *path, struct gsn_error *err)
{
    char **file = path ? gsn_realloc_array(lines->file, lines->file_count + 1, sizeof *file) : NULL;

    if (!file) {
        gsn_free(path);
        return fail_memory(err);
    }
    lines->file = file;
    file[lines->file_count++] = path;
    return GSN_OK;
}

static int read_file(struct config_lines *lines, const char *path, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct place place = { .lines = lines };
    struct gsn_error why = { 0 };
    size_t size = 0;
    int r = gsn_file_read(path, MOST_BYTES, &bytes, &size, &why);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r == GSN_E_NOMEM)
        return fail_memory(err);
    r = keep_name(lines, gsn_strdup(path), err);
    if (r < 0)
        return r;
    place.file = lines->file[lines->file_count - 1];
    if (bytes)
        return read_text(&place, (const char *)bytes, size, err);
    note_mistake(lines, path, 0, "cannot be read: %.300s", why.text);
    return GSN_OK;
}

static int is_drop_in(const struct dirent *entry)
{
    const size_t length = strlen(entry->d_name);

    return entry->d_name[0] != '.' && length > 5 &&
           strcmp(entry->d_name + length - 5, ".conf") == 0;
}

static int by_name(const struct dirent **a, const struct dirent **b)
{
    return strcmp((*a)->d_name, (*b)->d_name);
}

static int read_drop_ins(struct config_lines *lines, const char *dir, struct gsn_error *err)
{
    struct dirent **entries = NULL;
    const int count = scandir(dir, &entries, is_drop_in, by_name);
    int r = GSN_OK;

    if (count < 0 && errno == ENOMEM)
        return fail_memory(err);
    if (count < 0 && errno != ENOENT && errno != ENOTDIR)
        note_mistake(lines, dir, 0, "cannot be read: %s", strerror(errno));
    for (int i = 0; i < count; i++) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", dir, entries[i]->d_name);

        if (r >= 0)
            r = path ? read_file(lines, path, err) : fail_memory(err);
        free(entries[i]); /* door */
    }
    free(entries); /* door */
    return r;
}

/* Reads path and conf.d beside it; what is no line at all is told as a mistake.
 * Fails with GSN_E_NOMEM. The list is to be freed in any case. */
static int read_lines(const char *path, struct config_lines *lines, struct gsn_error *err)
{
    const char *const slash = strrchr(path, '/');
    gsn_auto_mem(char) dir =
        slash ? gsn_format("%.*s/conf.d", (int)(slash - path), path) : gsn_strdup("conf.d");
    const int r = dir ? read_file(lines, path, err) : fail_memory(err);

    return r < 0 ? r : read_drop_ins(lines, dir, err);
}

enum { SETTLE_MS = 1500, PATIENCE_S = 60, MOST_FOLDER = 180 };

/* Sources. */

const struct gsn_config_source *gsn_config_find(const struct gsn_config *config, const char *name)
{
    for (size_t i = 0; i < config->source_count; i++)
        if (strcmp(config->source[i].name, name) == 0)
            return &config->source[i];
    return NULL;
}

/* One more source, with what holds where nothing is said. It stays in the
 * configuration on failure too. Fails with GSN_E_NOMEM. */
static int add_source(struct gsn_config *config, const char *name,
                      struct gsn_config_source **ret_source, struct gsn_error *err)
{
    struct gsn_config_source *more =
        gsn_realloc_array(config->source, config->source_count + 1, sizeof *more);
    struct gsn_config_source *source;

    if (!more)
        return fail_memory(err);
    config->source = more;
    source = &more[config->source_count];
    *source = (struct gsn_config_source){ .name = gsn_strdup(name),
                                          .address = gsn_strdup(""),
                                          .specimen = gsn_strdup(""),
                                          .settle_ms = SETTLE_MS,
                                          .patience_s = PATIENCE_S };
    config->source_count++;
    if (!source->name || !source->address || !source->specimen)
        return fail_memory(err);
    *ret_source = source;
    return GSN_OK;
}

/* The folder's own name, with what no source's name may hold made '-'. */
static void name_of_folder(const char *folder, unsigned number, char name[NAME_BYTES + 1])
{
    size_t end = strlen(folder), begin, length = 0;

    while (end > 1 && folder[end - 1] == '/')
        end--;
    for (begin = end; begin > 0 && folder[begin - 1] != '/';)
        begin--;
    for (size_t i = begin; i < end && length < NAME_BYTES - 8; i++)
        name[length++] = folder[i];
    name[length] = '\0';
    for (size_t i = 0; i < length; i++)
        if (!isalnum((unsigned char)name[i]) && (!strchr("-_.", name[i]) || i == 0))
            name[i] = '_';
    if (length == 0)
        length = (size_t)snprintf(name, NAME_BYTES, "folder");
    if (number > 1)
        (void)snprintf(name + length, NAME_BYTES - length, "-%u", number);
}

int gsn_config_add_folder(struct gsn_config *config, const char *folder, struct gsn_error *err)
{
    char name[NAME_BYTES + 1];
    gsn_auto_mem(char) address = gsn_format("hot:%s", folder);
    struct gsn_config_source *source;
    unsigned number = 1;
    int r;

    if (!address)
        return fail_memory(err);
    /* What is written for the source's own process must be read back as it is. */
    if (strlen(folder) > MOST_FOLDER || strchr(folder, '\n') || strstr(folder, " ;"))
        return gsn_fail(err, GSN_E_INPUT,
                        "%.200s cannot be watched: a path of at most %d bytes without line breaks "
                        "and \" ;\" can",
                        folder, MOST_FOLDER);
    name_of_folder(folder, number, name);
    while (gsn_config_find(config, name))
        name_of_folder(folder, ++number, name);
    r = add_source(config, name, &source, err);
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
        (unsigned long long)(config->reserve_bytes / GSN_MIB), source->name, source->address,
        (long long)source->settle_ms, (long long)source->patience_s, (long long)source->sweep_s,
        source->delete_after_copy ? "yes" : "no", source->specimen);

    for (size_t i = 0; text && i < source->setting_count; i++) {
        char *const more =
            gsn_format("%s%s=%s\n", text, source->setting[i].key, source->setting[i].value);

        gsn_free(text);
        text = more;
    }
    if (!text)
        return fail_memory(err);
    *ret_text = gsn_steal(&text);
    return GSN_OK;
}

/* Applying a line. */

static void note_wrong(struct config_reading *reading, const struct config_line *line,
                       const char *what)
{
    note_mistake(&reading->lines, line->file, line->number, "%s=%.80s: %s", line->key, line->value,
                 what);
}

/* A whole number from least to most; 0 and a mistake when it is none. */
static bool read_number(struct config_reading *reading, const struct config_line *line,
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
    note_wrong(reading, line, sentence);
    return false;
}

static void read_yes_no(struct config_reading *reading, const struct config_line *line, int *to)
{
    if (strcmp(line->value, "yes") == 0)
        *to = 1;
    else if (strcmp(line->value, "no") == 0)
        *to = 0;
    else
        note_wrong(reading, line, "must be yes or no");
}

static int take_store(struct config_reading *reading, const struct config_line *line,
                      struct gsn_error *err)
{
    int64_t number;

    if (strcmp(line->key, "Directory") == 0) {
        if (line->value[0] == '/')
            return set_text(&reading->config->store_dir, line->value, err);
        note_wrong(reading, line, "must be a path that begins with /");
    } else if (strcmp(line->key, "ReserveMiB") == 0) {
        if (read_number(reading, line, 0, 1 << 30, &number))
            reading->config->reserve_bytes = (uint64_t)number * GSN_MIB;
    } else {
        note_wrong(reading, line, "[store] has no such key; it has Directory and ReserveMiB");
    }
    return GSN_OK;
}

static int take_work(struct config_reading *reading, const struct config_line *line)
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
    note_wrong(reading, line,
               "[work] has no such key; it has Workers, Threads, MemoryMiB and TimeMinutes");
    return GSN_OK;
}

static bool is_name(const char *name)
{
    const size_t length = strlen(name);

    for (size_t i = 0; i < length; i++)
        if (!isalnum((unsigned char)name[i]) && !strchr("-_.", name[i]))
            return false;
    return length > 0 && length <= NAME_BYTES && name[0] != '.' && name[0] != '-';
}

/* The source of a section "source NAME"; NULL when that is a mistake, told at its heading. */
static int find_source(struct config_reading *reading, const struct config_line *line,
                       struct gsn_config_source **ret_source, struct gsn_error *err)
{
    const char *const name = line->section + strlen("source ");
    struct gsn_config_source *source = NULL;
    struct seen_lines *seen;
    int r;

    *ret_source = NULL;
    if (!is_name(name)) {
        if (!line->key)
            note_mistake(&reading->lines, line->file, line->number,
                         "[%.80s]: a source's name is made of letters, digits, - _ and ., at "
                         "most %d",
                         line->section, NAME_BYTES);
        return GSN_OK;
    }
    *ret_source = (struct gsn_config_source *)gsn_config_find(reading->config, name);
    if (*ret_source)
        return GSN_OK;
    r = add_source(reading->config, name, &source, err);
    if (r < 0)
        return r;
    seen = gsn_realloc_array(reading->seen, reading->config->source_count, sizeof *seen);
    if (!seen)
        return fail_memory(err);
    reading->seen = seen;
    seen[reading->config->source_count - 1] = (struct seen_lines){ .heading = line };
    *ret_source = source;
    return GSN_OK;
}

/* What the table of kinds will judge, once all files are read. */
static int keep_setting(struct gsn_config_source *source, const struct config_line *line,
                        struct gsn_error *err)
{
    struct gsn_source_setting *at;
    gsn_auto_mem(char) key = gsn_strdup(line->key);
    gsn_auto_mem(char) value = gsn_strdup(line->value);

    if (!key || !value)
        return fail_memory(err);
    for (size_t i = 0; i < source->setting_count; i++) {
        if (strcmp(source->setting[i].key, key) != 0)
            continue;
        gsn_free((char *)source->setting[i].value);
        source->setting[i].value = gsn_steal(&value);
        return GSN_OK;
    }
    at = gsn_realloc_array(source->setting, source->setting_count + 1, sizeof *at);
    if (!at)
        return fail_memory(err);
    source->setting = at;
    at[source->setting_count++] = (struct gsn_source_setting){ gsn_steal(&key), gsn_steal(&value) };
    return GSN_OK;
}

static int take_source(struct config_reading *reading, const struct config_line *line,
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

/* Two values for one key in one file: one of them was not meant. */
static void check_once(struct config_reading *reading, size_t i)
{
    const struct config_line *const line = &reading->lines.at[i];

    for (size_t k = 0; k < i; k++) {
        const struct config_line *const other = &reading->lines.at[k];

        if (other->key && strcmp(other->file, line->file) == 0 &&
            strcmp(other->section, line->section) == 0 && strcmp(other->key, line->key) == 0) {
            note_mistake(&reading->lines, line->file, line->number,
                         "%s stands in [%.80s] already, in line %u", line->key, line->section,
                         other->number);
            return;
        }
    }
}

/* What line number i says goes into the configuration; mistakes are told. Fails with
 * GSN_E_NOMEM. */
static int apply_line(struct config_reading *reading, size_t i, struct gsn_error *err)
{
    const struct config_line *const line = &reading->lines.at[i];

    if (line->key)
        check_once(reading, i);
    if (strncmp(line->section, "source ", strlen("source ")) == 0)
        return take_source(reading, line, err);
    if (!line->section[0]) {
        note_mistake(&reading->lines, line->file, line->number,
                     "%s stands before the first [section]", line->key);
        return GSN_OK;
    }
    if (strcmp(line->section, "store") == 0)
        return line->key ? take_store(reading, line, err) : GSN_OK;
    if (strcmp(line->section, "work") == 0)
        return line->key ? take_work(reading, line) : GSN_OK;
    if (!line->key)
        note_mistake(&reading->lines, line->file, line->number,
                     "there is no section [%.80s]; there are [store], [work] and [source NAME]",
                     line->section);
    return GSN_OK;
}

enum { DEVICE_SWEEP_S = 10 };

/* Judging a source. */

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

static const struct config_line *line_of(const struct config_reading *reading,
                                         const struct gsn_config_source *source, const char *key)
{
    for (size_t i = reading->lines.count; i-- > 0;) {
        const struct config_line *const line = &reading->lines.at[i];

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
static bool blame_settings(struct config_reading *reading, const struct gsn_config_source *source,
                           const char *none, const char *whole)
{
    bool blamed = false;

    for (size_t i = 0; i < source->setting_count; i++) {
        const char *const key = source->setting[i].key;
        const struct config_line *const line = line_of(reading, source, key);
        const char *sentence = whole;
        struct gsn_error why = { 0 };

        if (judge_settings(source, i, 1, &why) < 0 && strcmp(why.text, none) != 0)
            sentence = why.text;
        else if (!is_about(whole, key))
            continue;
        if (!line)
            continue;
        note_mistake(&reading->lines, line->file, line->number, "%.380s", sentence);
        blamed = true;
    }
    return blamed;
}

/* Names the line of every key that is one slip away from one of ours. A kind's own keys are not
 * judged: without an address nobody knows the kind. True when there was one. */
static bool blame_spelling(struct config_reading *reading, const struct gsn_config_source *source)
{
    static const char *const ours[] = { "Address",   "Specimen", "SettleMs",
                                        "PatienceS", "SweepS",   "DeleteAfterCopy" };
    bool blamed = false;

    for (size_t i = 0; i < source->setting_count; i++) {
        const char *const key = source->setting[i].key;
        const char *const near = gsn_nearest(key, ours, sizeof ours / sizeof ours[0]);
        const struct config_line *const line = line_of(reading, source, key);

        if (!near || !line)
            continue;
        note_mistake(&reading->lines, line->file, line->number,
                     "%s: there is no such key: did you mean %s?", key, near);
        blamed |= strcmp(near, "Address") == 0;
    }
    return blamed;
}

/* Whether source number i is what its kind understands; mistakes are told. */
static void judge_source(struct config_reading *reading, size_t i)
{
    struct gsn_config_source *const source = &reading->config->source[i];
    const struct seen_lines *const seen = &reading->seen[i];
    struct gsn_error none = { 0 }, whole = { 0 };

    if (source->sweep_s == 0)
        source->sweep_s = gsn_source_subsystem(source->address) ? DEVICE_SWEEP_S : FOLDER_SWEEP_S;
    if (!seen->address) {
        if (blame_spelling(reading, source))
            return;
        note_mistake(&reading->lines, seen->heading->file, seen->heading->number,
                     "[source %s] has no Address", source->name);
        return;
    }
    if (judge_settings(source, 0, source->setting_count, &whole) >= 0)
        return;
    (void)judge_settings(source, 0, 0, &none);
    if (strcmp(none.text, whole.text) == 0)
        note_mistake(&reading->lines, seen->address->file, seen->address->number, "%.380s",
                     whole.text);
    else if (!blame_settings(reading, source, none.text, whole.text))
        note_mistake(&reading->lines, seen->heading->file, seen->heading->number,
                     "[source %s]: %.300s", source->name, whole.text);
}

/* The configuration. */

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

static int judge_lines(struct config_reading *reading, struct gsn_error *err)
{
    int r = GSN_OK;

    for (size_t i = 0; r >= 0 && i < reading->lines.count; i++)
        r = apply_line(reading, i, err);
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

static void reading_done(struct config_reading *reading)
{
    lines_done(&reading->lines);
    gsn_config_free(reading->config);
    gsn_free(reading->seen);
}

int gsn_config_read(const char *path, const struct gsn_config_ear *ear,
                    struct gsn_config **ret_config, struct gsn_error *err)
{
    __attribute__((cleanup(reading_done))) struct config_reading reading = { .lines = { .ear =
                                                                                            ear } };
    int r;

    reading.config = gsn_alloc_array(1, sizeof *reading.config);
    if (!reading.config)
        return fail_memory(err);
    *reading.config = (struct gsn_config){ .store_dir = gsn_strdup(""),
                                           .reserve_bytes = 256 * GSN_MIB,
                                           .workers = 1,
                                           .memory_mib = 8192,
                                           .minutes = 120 };
    if (!reading.config->store_dir)
        return fail_memory(err);
    r = read_lines(path, &reading.lines, err);
    if (r >= 0)
        r = judge_lines(&reading, err);
    if (r < 0)
        return r;
    *ret_config = gsn_steal(&reading.config);
    return GSN_OK;
}
