/* SPDX-License-Identifier: AGPL-3.0-or-later */
#include "systemd/config_file.h"

#include <ctype.h>
#include <dirent.h>
#include <errno.h>
#include <ini.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "pipeline/core/file.h"

enum {
    MOST_BYTES = 1 << 20,
    MOST_LINE = 196, /* inih cuts what is longer */
};

void gsn_config_mistake(struct gsn_config_lines *lines, const char *file, unsigned number,
                        const char *format, ...)
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

static void line_done(struct gsn_config_line *line)
{
    gsn_free(line->section);
    gsn_free(line->key);
    gsn_free(line->value);
}

void gsn_config_lines_done(struct gsn_config_lines *lines)
{
    for (size_t i = 0; i < lines->count; i++)
        line_done(&lines->at[i]);
    for (size_t i = 0; i < lines->file_count; i++)
        gsn_free(lines->file[i]);
    gsn_free(lines->at);
    gsn_free(lines->file);
}

static int out_of_memory(struct gsn_error *err)
{
    return gsn_fail(err, GSN_E_NOMEM, "out of memory for the configuration");
}

/* Where the reader is. */
struct place {
    struct gsn_config_lines *lines;
    const char *file;
    unsigned number;
    char section[MOST_LINE + 1];
    bool is_lost; /* behind a wrong heading, whose keys nobody can judge */
    bool no_memory;
};

static int append(struct place *place, const char *key, const char *value)
{
    struct gsn_config_lines *const lines = place->lines;
    struct gsn_config_line line = { .file = place->file,
                                    .number = place->number,
                                    .section = gsn_strdup(place->section),
                                    .key = key ? gsn_strdup(key) : NULL,
                                    .value = value ? gsn_strdup(value) : NULL };
    struct gsn_config_line *at = gsn_realloc_array(lines->at, lines->count + 1, sizeof *lines->at);

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
    return append(place, name, value);
}

static void take_heading(struct place *place, const char *line, size_t length)
{
    place->is_lost = length <= 2 || line[length - 1] != ']';
    if (place->is_lost) {
        gsn_config_mistake(place->lines, place->file, place->number,
                           "a heading must be like [source NAME], on a line of its own");
        return;
    }
    (void)snprintf(place->section, sizeof place->section, "%.*s", (int)(length - 2), line + 1);
    (void)append(place, NULL, NULL);
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
        gsn_config_mistake(place->lines, place->file, place->number,
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
            gsn_config_mistake(place->lines, place->file, place->number,
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
    return place->no_memory ? out_of_memory(err) : GSN_OK;
}

/* takes: path. */
static int keep_name(struct gsn_config_lines *lines, char *path, struct gsn_error *err)
{
    char **file = path ? gsn_realloc_array(lines->file, lines->file_count + 1, sizeof *file) : NULL;

    if (!file) {
        gsn_free(path);
        return out_of_memory(err);
    }
    lines->file = file;
    file[lines->file_count++] = path;
    return GSN_OK;
}

static int read_file(struct gsn_config_lines *lines, const char *path, struct gsn_error *err)
{
    gsn_auto_mem(uint8_t) bytes = NULL;
    struct place place = { .lines = lines };
    struct gsn_error why = { 0 };
    size_t size = 0;
    int r = gsn_file_read(path, MOST_BYTES, &bytes, &size, &why);

    if (r == GSN_E_NOTFOUND)
        return GSN_OK;
    if (r == GSN_E_NOMEM)
        return out_of_memory(err);
    r = keep_name(lines, gsn_strdup(path), err);
    if (r < 0)
        return r;
    place.file = lines->file[lines->file_count - 1];
    if (bytes)
        return read_text(&place, (const char *)bytes, size, err);
    gsn_config_mistake(lines, path, 0, "cannot be read: %.300s", why.text);
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

static int read_drop_ins(struct gsn_config_lines *lines, const char *dir, struct gsn_error *err)
{
    struct dirent **entries = NULL;
    const int count = scandir(dir, &entries, is_drop_in, by_name);
    int r = GSN_OK;

    if (count < 0 && errno == ENOMEM)
        return out_of_memory(err);
    if (count < 0 && errno != ENOENT && errno != ENOTDIR)
        gsn_config_mistake(lines, dir, 0, "cannot be read: %s", strerror(errno));
    for (int i = 0; i < count; i++) {
        gsn_auto_mem(char) path = gsn_format("%s/%s", dir, entries[i]->d_name);

        if (r >= 0)
            r = path ? read_file(lines, path, err) : out_of_memory(err);
        free(entries[i]); /* door */
    }
    free(entries); /* door */
    return r;
}

int gsn_config_lines_read(const char *path, struct gsn_config_lines *lines, struct gsn_error *err)
{
    const char *const slash = strrchr(path, '/');
    gsn_auto_mem(char) dir =
        slash ? gsn_format("%.*s/conf.d", (int)(slash - path), path) : gsn_strdup("conf.d");
    const int r = dir ? read_file(lines, path, err) : out_of_memory(err);

    return r < 0 ? r : read_drop_ins(lines, dir, err);
}
